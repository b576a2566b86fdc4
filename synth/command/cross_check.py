"""Cross-check of the designs from problems (22) and (25) with a second solver, Clarabel.

The designs themselves come from the central path (`lmi/central_path.py`). Many gains attain the optimum, so the two solvers
agree in gamma, but not in the gain. A second problem therefore checks the designed gain: in this problem, the gain is fixed to
the designed gain.
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from models.document.field import Field
from synth.controller.controller import Controller
from synth.controller.report import BOUND
from synth.design.two_step import independently_measured, l_matrix, nullspace, r_matrix, well_posed
from synth.lmi.central_path import PathPoint
from synth.lmi.sdp import solve_lmi
from synth.plant.numerics import DesignError
from synth.plant.units import own_units
from synth.vehicle.designer import Designer

# Allowed relative difference between the two values of gamma. Clarabel stops when the error of eta is 1e-8 relative to the
# entries of X, and these entries may be a thousand times larger than eta.
TOLERANCE = 1e-5


@dataclass(frozen=True)
class CrossCheck:
    """Comparison of a design with the solution that Clarabel finds.

    Attributes:
        problem: number of the problem in the paper, "(22)" or "(25)".
        ours: optimal gamma that the central path gives.
        optimum_gap: relative gap between the gamma of the designed gain and the optimal gamma `ours`.
        theirs: optimal gamma from Clarabel; None if Clarabel failed.
        attained: gamma that Clarabel finds if the gain is fixed to the designed gain; None if Clarabel failed.
        said: error messages or solver statuses of the problems that Clarabel did not solve accurately; empty if Clarabel solved
            both problems.
    """

    problem: str
    ours: float
    optimum_gap: float
    theirs: float | None
    attained: float | None
    said: str

    @property
    def apart(self) -> float | None:
        """Relative amount by which Clarabel's optimal gamma exceeds the optimal gamma from the central path."""
        return self.theirs / self.ours - 1 if self.theirs is not None else None

    @property
    def above(self) -> float | None:
        """Relative amount by which the gamma of the designed gain exceeds Clarabel's optimal gamma."""
        return self.attained / self.theirs - 1 if self.attained is not None and self.theirs is not None else None

    @property
    def record(self) -> dict[str, Any]:
        """Comparison as JSON."""
        return {**asdict(self), "apart": self.apart, "above": self.above}

    @property
    def failures(self) -> tuple[str, ...]:
        """Descriptions of the disagreements between Clarabel and the design."""
        failed, theirs = [], f"Clarabel's optimal gamma of problem {self.problem}, {BOUND.digits(self.theirs)}"
        if self.apart is not None and abs(self.apart) > TOLERANCE:
            failed.append(f"{theirs}, differs from the optimal gamma of this design, {BOUND.digits(self.ours)}")
        if self.above is not None and not -TOLERANCE <= self.above <= self.optimum_gap + TOLERANCE:
            failed.append(f"with Clarabel the designed gain attains gamma {BOUND.digits(self.attained)}, not {theirs}")
        return tuple(failed)

    @property
    def text(self) -> str:
        """Result of the cross-check as text."""
        if self.theirs is None:
            return f"no cross-check: {self.said}"
        text = f"Clarabel's gamma for {self.problem} is {BOUND.digits(self.theirs)}, {SHARE.digits(self.apart)} from this design"
        attained = f"the designed gain attains it within {SHARE.digits(abs(self.above))}" if self.above is not None else ""
        return "; ".join(filter(None, (text, attained, self.said)))


SHARE = Field[CrossCheck]("difference", lambda one: one.apart, ".0e")


def cross_check(designer: Designer, controller: Controller, zero_l: bool = False) -> CrossCheck | None:
    """Solves the design problem of a controller once more, with Clarabel. Returns None if the design did not solve (22) or
    (25).

    Args:
        designer: designer of the vehicle.
        controller: designed controller before refinement.
        zero_l: True if the design used L = 0 for the matrix L of (14).
    """
    bound, steps = controller.certificate.bound, controller.steps
    shared = designer.shared(controller.hardware)
    problem = well_posed(shared.plant)
    if (
        steps is None
        or controller.fallback_method
        or controller.law.states
        # With filters, the rates in (25) differ so much that Clarabel's results are inaccurate
        or shared.plant.weights
        or controller.specifications
        or bound is None
        or (problem.best is not None and problem.best_case in controller.degeneracy)
    ):
        return None
    plant_problem = designer.problem(controller.measured, controller.hardware).plant
    _, few, kept = independently_measured(shared.plant.measured(plant_problem.Cy))
    units = own_units(few, measured=True)
    rows, measured = units.rows(few.Cy)
    K = controller.gain[:, kept] @ measured / units.inputs[:, None]
    if controller.name == "state":
        which, Q, R = "(22)", np.zeros((len(rows), 0)), np.linalg.inv(rows)
    else:
        which, Q = "(25)", nullspace(rows)
        path = shared.state_path
        start = min(path, key=lambda point: abs(point.gamma / path[-1].gamma - 1 - steps.state_step_gap))
        X = start.X / np.outer(units.states, units.states)
        R = r_matrix(rows, Q, np.zeros((Q.shape[1], len(rows))) if zero_l else l_matrix(X, rows, Q))
    # The problem is written in the coordinates of (12) and in units that make all numbers similar to 1. In other coordinates
    # and units, Clarabel fails for a full car.
    own, eye = PathPoint(units.into(problem.plant), Q, R, 0.0), np.eye(len(Q))
    a = Q.shape[1]
    optima: list[float | None] = [None, None]
    remarks = []
    for i, gain in enumerate((None, own.inputs.T @ K @ own.block_start / own.input_unit)):
        what = "" if gain is None else " with the designed gain"
        try:
            solved = solve_lmi(own.plant, eye[:, :a], eye[:, a:], gain)
        except DesignError as error:
            remarks.append(f"problem {which}{what}: {error}")
            continue
        optima[i] = solved.gamma / (own.disturbance_unit * own.output_unit)
        if solved.status != "optimal":
            remarks.append(f"for problem {which}{what} Clarabel reports {solved.status!r}")
    return CrossCheck(which, bound / (1 + steps.optimum_gap), steps.optimum_gap, optima[0], optima[1], "; ".join(remarks))
