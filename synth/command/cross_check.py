"""A cross-check of (22) and (25) by a second solver, Clarabel. Designs come from the central path (`lmi/central_path.py`).

Many gains attain the optimum, so two solvers agree in gamma but not in the gain. A second problem therefore has our gain fixed.
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from models.document.field import Field
from synth.controller.controller import Controller
from synth.controller.report import BOUND
from synth.design.two_step import independently_measured, l_matrix, nullspace, r_matrix, well_posed
from synth.lmi.sdp import solve_lmi
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError
from synth.plant.units import own_units, reachable, size
from synth.vehicle.designer import Designer

TOLERANCE = 1e-5  # relative in gamma: Clarabel stops at 1e-8 in eta against entries of X that may be a thousand times as large


@dataclass(frozen=True)
class CrossCheck:
    """The comparison of a design with Clarabel's solution.

    Attributes:
        problem: "(22)" or "(25)".
        ours: the optimal gamma by the central path.
        optimum_gap: relative distance of our gain from that optimum.
        theirs: the optimal gamma by Clarabel; None if it failed.
        attained: level that is attained with our gain fixed; None if that solution failed.
        said: the solver's status if it did not solve both problems, or empty.
    """

    problem: str
    ours: float
    optimum_gap: float
    theirs: float | None
    attained: float | None
    said: str

    @property
    def apart(self) -> float | None:
        """Relative excess of their optimum over ours."""
        return self.theirs / self.ours - 1 if self.theirs is not None else None

    @property
    def above(self) -> float | None:
        """Relative excess of our gain's gamma over their optimum."""
        return self.attained / self.theirs - 1 if self.attained is not None and self.theirs is not None else None

    @property
    def record(self) -> dict[str, Any]:
        """The comparison as JSON."""
        return {**asdict(self), "apart": self.apart, "above": self.above}

    @property
    def failures(self) -> tuple[str, ...]:
        """The disagreements, in words."""
        failed, theirs = [], f"Clarabel's optimal gamma of problem {self.problem}, {BOUND.digits(self.theirs)}"
        if self.apart is not None and abs(self.apart) > TOLERANCE:
            failed.append(f"{theirs}, differs from the optimal gamma of this design, {BOUND.digits(self.ours)}")
        if self.above is not None and not -TOLERANCE <= self.above <= self.optimum_gap + TOLERANCE:
            failed.append(f"with Clarabel the designed gain attains gamma {BOUND.digits(self.attained)}, not {theirs}")
        return tuple(failed)

    @property
    def text(self) -> str:
        """The result in words."""
        if self.theirs is None:
            return f"no cross-check: {self.said}"
        text = f"Clarabel's gamma for {self.problem} is {BOUND.digits(self.theirs)}, {SHARE.digits(self.apart)} from this design"
        attained = f"the designed gain attains it within {SHARE.digits(abs(self.above))}" if self.above is not None else ""
        return "; ".join(filter(None, (text, attained, self.said)))


SHARE = Field[CrossCheck]("difference", lambda one: one.apart, ".0e")


def cross_check(designer: Designer, controller: Controller, zero_l: bool = False) -> CrossCheck | None:
    """Clarabel's answer to the problem that a controller comes from, or None for one that comes from none.

    Args:
        controller: controller as designed, not refined.
        zero_l: True for a problem with L = 0.
    """
    bound, steps = controller.certificate.bound, controller.steps
    shared = designer.shared(controller.hardware)
    problem = well_posed(shared.plant)
    if (
        steps is None
        or controller.fallback_method
        or controller.law.states
        or shared.plant.weights  # with filters (25) has rates too far apart for Clarabel, whose answers are then off
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
    # In the coordinates of (12) and in units in which all numbers have size one: else Clarabel gives up on a full car.
    a, T = Q.shape[1], np.hstack([Q, R])
    plant = units.into(problem.plant).in_coordinates(T)
    scaling = reachable(plant, a)
    plant, eye = plant.in_coordinates(scaling), np.eye(len(T))
    rate, output_unit = size(plant.A), 1 / size(plant.C)
    input_unit, disturbance_unit = rate / size(plant.B), rate / size(plant.Bw)
    plant = Plant(
        A=plant.A / rate,
        B=plant.B * input_unit / rate,
        Bw=plant.Bw * disturbance_unit / rate,
        C=plant.C * output_unit,
        D=plant.D * output_unit * input_unit,
        Dw=plant.Dw * output_unit * disturbance_unit,
    )
    optima: list[float | None] = [None, None]
    remarks = []
    for i, gain in enumerate((None, K @ scaling[a:, a:] / input_unit)):
        what = "" if gain is None else " with the designed gain"
        try:
            solved = solve_lmi(plant, eye[:, :a], eye[:, a:], gain)
        except DesignError as error:
            remarks.append(f"problem {which}{what}: {error}")
            continue
        optima[i] = solved.gamma / (disturbance_unit * output_unit)
        if solved.status != "optimal":
            remarks.append(f"for problem {which}{what} Clarabel reports {solved.status!r}")
    return CrossCheck(which, bound / (1 + steps.optimum_gap), steps.optimum_gap, optima[0], optima[1], "; ".join(remarks))
