"""Data classes for the design problem of any plant and for the result of a design.

Every method of `synth.design.methods` receives a `DesignProblem` and returns a `DesignResult`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.extensions import FEATURES
from models.common.printed import digits
from models.document.document import Document
from models.document.text import ShownResult, facts
from models.laws.design_methods import STATIC
from models.laws.design_request import LawStructure
from models.laws.linear import LinearLaw, gain_text, states_text
from synth.analysis.certificate import Certificate
from synth.analysis.stability import is_stable
from synth.plant.generalized import Plant

if TYPE_CHECKING:
    from models.document.figure import Figure
    from models.laws.preview import RoadPreview
    from synth.analysis.lower_bounds.lower_bound import LowerBound, SampledBound
    from synth.analysis.sampled_loop import SampledDataProblem
    from synth.design.descent.landscape import Work
    from synth.design.multi_objective.problem import MultiObjectiveProblem
    from synth.design.uncertainty.structured_loop import StructuredPlant
    from synth.lmi.central_path import CentralPoint


SEEN = 1e-6  # smallest relative difference that is visible in a table with seven digits
LARGEST_GAIN = 1e5  # largest magnitude of a gain entry K_ij if the search has no other limit
# criteria by which designs are compared
NORM, SAMPLED_NORM, H2_NORM, MU = "norm", "sampled norm", "H2 norm", "robust performance"
TWO_STEPS, DESCENT = "the two steps", "descent on the norm"  # names of the two methods for static gains
FEW = 4  # a law with more states than this is shown without its matrices
Progress = Callable[[float, bool], None]


def as_designed(law: LinearLaw) -> LinearLaw:
    """Returns the law unchanged: it is executed as it was designed."""
    return law


def quiet(value: float, within: bool) -> None:
    """Callback that ignores the progress of a design."""


@dataclass(frozen=True, eq=False)
class WellPosedProblem:
    """Problem (22) of a plant, regularised if (22) is degenerate.

    Attributes:
        plant: plant for which the controller is designed; this is the given plant unless the problem of the given plant is
            degenerate.
        case: description of the degeneracy of the given problem; empty if the problem is not degenerate.
        best: state gain that is known to be optimal, shape (m, n); None if no such gain is known.
        best_case: description of the degeneracy that makes `best` optimal.
        regular: True if w acts on a state, and every state affects z, both without control and with the gain -D^+ C. If
            `regular` is True, no mode can be hidden from z. Even if `regular` is True, (22) may have no optimum because a force
            has no weight.
    """

    plant: Plant
    case: str = ""
    best: Array | None = None
    best_case: str = ""
    regular: bool = False

    def __post_init__(self) -> None:
        if self.best is not None:
            self.best.flags.writeable = False


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """Design problem of a controller. The plant contains the measurements; measurement noise is part of w.

    Attributes:
        plant: plant with n states, m inputs and q measurements y = C_y x + Dyw w.
        order: "static" for a gain, or "full" for a law with as many states as the plant. If `structure` is given, the order of
            this structure is used instead.
        structure: structure of a law with fewer states than the plant; None if no structure is required.
        design: name in `DESIGNS`, such as "h2" to minimise the mean square of z. If the name is empty, the H-infinity norm is
            minimised.
        method: name in `METHODS` of the only method to use. If the name is empty, `choose` selects the methods.
        stable: True if the law itself must be stable.
        fastest_pole: largest magnitude of the loop's poles [rad/s]; None if there is no limit.
        largest_gain: largest allowed |K_ij| of a static gain.
        noise: rms of the white noise of each measurement for "lqg", shape (q,); None if there is no noise.
        preview: time by which w is known in advance [s].
        sampled: sampled-data problem, in which w does not contain the measurement noise; None to design for the ideal
            continuous loop.
        sampled_bound: lower bound on the norm of the sampled-data loop, if it is known.
        known: laws from which a search starts. For a static gain of the sampled-data loop, these laws are gains designed for
            the ideal loop.
        near: estimate of the norm of the sampled-data loop, from which the search for this norm starts.
        goals: norm to minimise and bounds to fulfil in the design of a static gain; None for a design without goals.
        errors: plant with frequency-weighted uncertainties, for a design of robust performance; None for other designs.
        alternatives: True to compute a lower bound for a static gain, and to continue the design if the two steps end above
            this bound. If `alternatives` is True, another method is also used if Riccati equations fail. For a vehicle file,
            `alternatives` is False, so that the result of the two steps is not changed.
        thorough: True to compute the lower bound of a sampled-data loop, and to report which properties are not proved for a
            family of plants.
        lower_bound: lower bound on the norm of every controller that uses the measurements, if known.
        states: names of the states, used in error messages.
        path: function that returns the central path of (22) if it is known, or raises a DesignError.
        as_run: function that converts a designed law to the law that is executed, for example to a law that subtracts forces
            from its measurements.
        certify: function that returns the certificate of a law in the form in which it is executed. Default: the certificate of
            the closed loop of the law and the plant.
        work: counter of the computing work of all searches. Default: each search has its own counter.
        start: result of the previous method, from which the next method continues; None for the first method.
        failure: error that the previous method raised, if it found no controller.
    """

    plant: Plant
    order: str = STATIC
    structure: LawStructure | None = None
    design: str = ""
    method: str = ""
    stable: bool = False
    fastest_pole: float | None = None
    largest_gain: float = LARGEST_GAIN
    noise: Sequence[float] | None = None
    preview: float = 0.0
    sampled: "SampledDataProblem | None" = None
    sampled_bound: "SampledBound | None" = None
    known: Sequence[LinearLaw] = ()
    near: float = 1.0
    goals: "MultiObjectiveProblem | None" = None
    errors: "StructuredPlant | None" = None
    alternatives: bool = True
    thorough: bool = True
    lower_bound: "LowerBound | None" = None
    states: Sequence[str] = ()
    path: "Callable[[], Sequence[CentralPoint]]" = tuple
    as_run: Callable[[LinearLaw], LinearLaw] = as_designed
    certify: Callable[[LinearLaw], Certificate] | None = None
    work: "Work | None" = None
    start: "DesignResult | None" = None
    failure: Exception | None = None

    def starting(self, start: "DesignResult") -> "DesignProblem":
        """Returns the problem, extended by the result from which the next method continues."""
        return replace(self, start=start)

    def certified(self, law: LinearLaw) -> Certificate:
        """Returns the certificate of a law for the ideal loop.

        Raises:
            ValueError, LinAlgError: a discrete law has no counterpart in continuous time.
        """
        if self.certify is not None:
            return self.certify(law)

        return FEATURES.load("bounds by Riccati equations").certify_law(self.plant, law.continuous(), self.lower_bound)


@dataclass(frozen=True, eq=False, repr=False)
class DesignResult(ShownResult):
    """Controller of a plant with its certificate, and the method that designed it.

    Attributes:
        law: law from the q measurements to the m forces, with matrices A, B, C, D: x_c' = A x_c + B y, u = C x_c + D y, without
            a minus sign. A static law is u = K y. If the law has a sample period, x_c' is replaced by x_c at the next sample.
        certificate: certificate of the closed loop, in continuous time or for a discrete plant; measurement noise is part of w.
        method: name of the design method.
        why: reason why this method was chosen, as text.
        remarks: notes on the gap to the optimum, on assumptions, and on unused measurements.
        value: value of the minimised objective. Default: the norm in the certificate.
        criterion: name of the minimised objective: "norm", "sampled norm", "H2 norm", or a goal.
        sampled_lower_bound: lower bound on the sampled norm of controllers of any order, for the sample period and delay of the
            problem. None if there is no sample period, or if no bound is proved.
        level: upper bound on the sampled norm that the LMI of the two-step method gives; None for other designs.
        redundant: indices of the measurements that are linear combinations of other measurements. The gain on redundant
            measurements is zero.
        case: description of the degeneracy of (22), for which no gain or every gain is optimal; empty if (22) is not
            degenerate.
        instead: text with the name of the fallback method, and the reason why the two steps found no gain; empty if they found
            a gain.
        state_step_gap: relative gap in gamma between the optimum of (22) and the point of the central path whose X gives L
            (14). The gap is 0 at the limit of the path. The gap is larger if the second problem has no solution for the X at
            the limit.
        optimum_gap: relative gap in gamma between the gain and the optimum of its own problem. The gap is 0 at the limit of the
            central path. The gap is larger if gains near the optimum have poles that are too fast for an actuator.
        moved: last change of the gain along its central path, relative to the largest entry of the gain. The last change is
            about a hundred times the distance to the limit of the path. The last change is at most 4e-5 for the built-in cars,
            and for the two steps of a chain of 40 states. For chains of 26 and 40 states, however, the state-feedback gain
            still grows a hundredfold if the path parameter mu decreases by a factor of a hundred. The norm of the
            state-feedback gain is proved, but no digit of this gain agrees with the optimal gain.
        origin: description of the starting point from which the search found the law; empty if there was no search.
        two_steps: result of the two steps, if the search for a static gain also started from this result; otherwise None.
        starts: number of other stable points from which the search for a static gain started.
        preview: force that is computed from the road ahead and added to the force of the law; None if there is no preview.
        without: value that the objective would have without preview.
        trade: Pareto front of the norm and the speed of full-order laws, the slowest first. The front is empty if the law is
            close to the lower bound and not fast. For a discrete plant, the laws belong to its continuous counterpart.
        details: additional result of the method: a `MultiObjectiveDesign` for a design with goals, otherwise None.
    """

    law: LinearLaw
    certificate: Certificate
    method: str = ""
    why: str = ""
    remarks: tuple[str, ...] = ()
    value: float = np.nan
    criterion: str = NORM
    sampled_lower_bound: float | None = None
    level: float | None = None
    redundant: tuple[int, ...] = ()
    case: str = ""
    instead: str = ""
    state_step_gap: float = 0.0
    optimum_gap: float = 0.0
    moved: float = 0.0
    origin: str = ""
    two_steps: "DesignResult | None" = None
    starts: int = 0
    preview: "RoadPreview | None" = None
    without: float = np.nan
    trade: tuple[Any, ...] = ()
    details: Any = None

    def __post_init__(self) -> None:
        if np.isnan(self.value) and self.criterion == NORM:
            object.__setattr__(self, "value", self.certificate.norm.value)

    @property
    def remark(self) -> str:
        """All notes in `remarks`, joined to one text."""
        return "; ".join(self.remarks)

    @property
    def stable(self) -> bool:
        """True if the law itself is stable.

        The states of an unstable law grow when the loop is open, for example while a force is saturated.
        """
        return is_stable(self.law.A, self.law.sample_period)

    @property
    def sampled_norm(self) -> float | None:
        """L2 gain of the sampled-data loop, see `synth.sampled_norm`; None if there is no sample period."""
        return self.value if self.criterion == SAMPLED_NORM else None

    @property
    def h2_norm(self) -> float:
        """Rms of z for white noise w and the noise of LQG, without the effect of Dw; NaN for a law with another criterion."""
        return self.value if self.criterion == H2_NORM else np.nan

    @property
    def gain(self) -> Array:
        """Gain matrix K of a static law, shape (m, q).

        Raises:
            InputError: the law has states.
        """
        if self.law.states:
            raise InputError(
                f"the law has {states_text(self.law)} , so it is not only a gain; use the attribute `law` of the design"
            )
        return self.law.D

    @property
    def summary(self) -> Document:
        """Returns law, method, reason and certificate as text."""
        law = _law_shown(self.law) if self.law.states else {"gain": gain_text(self.law.D)}
        value = {self.criterion: digits(self.value)} if self.criterion != NORM else {}
        value |= {"sampled lower bound": digits(self.sampled_lower_bound)} if self.sampled_lower_bound is not None else {}
        words = {"why": self.why, "remark": self.remark, "case": self.case}
        how = f"feedback by {self.method}" if self.method else "design"
        return facts(f"{how}, {self.certificate.summary.title}", {**law, **value, **self.certificate.claims, **words})

    @property
    def figures(self) -> "tuple[Figure, ...]":
        """Plot of the largest singular value of the closed loop against frequency."""
        return self.certificate.figures


def _law_shown(law: LinearLaw) -> dict[str, str]:
    """Returns a law with states as text: the number of states, whether the law itself is stable, and small matrices."""
    stable = is_stable(law.A, law.sample_period)
    matrices = {name: gain_text(getattr(law, name)) for name in "ABCD"} if law.states <= FEW else {}
    return {"law": f"{states_text(law)}; {'' if stable else 'not '}stable by itself"} | matrices
