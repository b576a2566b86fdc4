"""A design problem of any plant, and its result: what every method of `synth.design.methods` takes and returns."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
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
    from synth.analysis.lower_bound import LowerBound, SampledBound
    from synth.analysis.sampled_loop import SampledDataProblem
    from synth.design.descent.landscape import Work
    from synth.design.multi_objective.problem import MultiObjectiveProblem
    from synth.design.uncertainty.structured_loop import StructuredPlant
    from synth.lmi.central_path import CentralPoint


SEEN = 1e-6  # relative: what a table of seven digits shows
LARGEST_GAIN = 1e5  # of |K_ij| where a search has no bound of its own
NORM, SAMPLED_NORM, H2_NORM, MU = "norm", "sampled norm", "H2 norm", "robust performance"  # criteria
TWO_STEPS, DESCENT = "the two steps", "descent on the norm"  # methods, in words
FEW = 4  # states; of more the matrices of a law are not shown
Progress = Callable[[float, bool], None]


def as_designed(law: LinearLaw) -> LinearLaw:
    """Returns the law itself, which is run as it is designed."""
    return law


def quiet(value: float, within: bool) -> None:
    """Ignores what a design has reached."""


@dataclass(frozen=True, eq=False)
class WellPosedProblem:
    """A problem (22) that is not degenerate.

    Attributes:
        plant: plant to design for: the given plant, unless its problem is degenerate.
        case: degeneracy of the given problem, in words, or empty.
        best: an optimal state gain, shape (m, n), if one is known.
        best_case: degeneracy that makes that gain optimal, in words.
        regular: True if w acts on the state, and z contains every state without control and under the gain -D^+ C. No mode can
            then be hidden from z. A force without a weight may still leave (22) without an optimum.
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
    """Problem of a controller's design. The plant contains the measurements, and noise on them that counts as a part of w.

    Attributes:
        plant: n states, m inputs, q measurements y = C_y x + Dyw w.
        order: "static" for a gain, or "full" for as many states as the plant. A `structure` overrides the order.
        structure: structure of a law of fewer states; None without one.
        design: name in `DESIGNS`, such as "h2" for the least mean square of z; empty for the least norm.
        method: name in `METHODS` of the only method to use; empty for those that the problem leads to.
        stable: True for a law that is stable by itself.
        fastest_pole: largest magnitude of the loop's poles [rad/s]; None for no limit.
        largest_gain: bound on |K_ij| of a static gain.
        noise: white noise of each measurement for "lqg", shape (q,); None without noise.
        preview: time for which w is known ahead [s].
        sampled: the loop that a computer closes, without noise on the plant's w; None for the ideal loop.
        sampled_bound: lower bound of that loop, if it is known.
        known: laws that a search starts from; static gains of the ideal loop for a gain of the sampled loop.
        near: a level near the norm of the sampled loop.
        goals: goals of a static gain; None for the norm alone.
        errors: the plant with errors weighted by frequency, for a law of the least robust performance; None without errors.
        alternatives: True to find the lower bound of a static gain, to go on from two steps that end above that bound, and to use
            another design where Riccati equations fail. A vehicle file has the two steps as they are.
        thorough: True to find the lower bound of a sampled loop, and to tell what is not proved of a family.
        lower_bound: lower bound for any controller from these measurements, if known.
        states: names of the states, for messages.
        path: returns the central path of (22) if it is known, or raises a DesignError.
        as_run: returns a law as it is run, for a law that takes forces out of what it reads.
        certify: returns the certificate of a law as it is run; that of its loop with the plant if it is not given.
        work: counts the norms of searches; each has its own count if it is not given.
        start: result of the previous method, to start from; None for the first method.
        failure: error of the previous method, if that method found no controller.
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
        """Returns the problem with a result from which a method goes on."""
        return replace(self, start=start)

    def certified(self, law: LinearLaw) -> Certificate:
        """Returns the certificate of a law's ideal loop.

        Raises:
            ValueError, LinAlgError: a discrete law has no counterpart in continuous time.
        """
        if self.certify is not None:
            return self.certify(law)
        from synth.analysis.bounding import certify_law

        return certify_law(self.plant, law.continuous(), self.lower_bound)


@dataclass(frozen=True, eq=False, repr=False)
class DesignResult(ShownResult):
    """A controller of a plant, with its certificate, and the method that led to it.

    Attributes:
        law: law from the q measurements to the m forces, with A, B, C, D: x_c' = A x_c + B y, u = C x_c + D y, without a minus
            sign; a static one is u = K y. With a sample period the next x_c replaces x_c'.
        certificate: certificate of its loop, in continuous time or of the discrete plant. Noise is a part of w.
        method: method of the design.
        why: reason for that method, in words.
        remarks: distance from the optimum, assumptions and left-out measurements, in words.
        value: value of the objective that was minimised; the norm if it is not given.
        criterion: name of that value: "norm", "sampled norm", "H2 norm", or a goal.
        sampled_lower_bound: bound on the sampled norm that no controller of any order beats at this sample period and delay; None
            without a sample period, or if none is proved.
        level: upper bound on the sampled norm from the LMI of the two steps for the sampled loop; None for other designs.
        redundant: measurements that follow from others, by index; their gain is zero.
        case: degeneracy of (22) (no optimum, or every gain optimal), in words, or empty.
        instead: the fallback method, and the reason why the two steps found no gain, in words, or empty.
        state_step_gap: relative distance in gamma from the optimum of (22) at which X for L (14) was taken: 0 at the limit of the
            central path, more if the second problem is infeasible from there.
        optimum_gap: relative distance in gamma of the gain from the optimum of its own problem: 0 at the limit, more if only
            gains beyond any actuator reach the optimum.
        moved: last change of the gain along its path, relative to its largest entry: about a hundred times the distance to the
            limit. It is at most 4e-5 for the built-in cars, and for the two steps of a chain of 40 states. But the state feedback
            of chains of 26 and 40 states still grows a hundredfold as mu falls as much. The norm of such a gain is proved, but
            none of its digits is that of the optimum.
        origin: start of the search that led to the law, in words; empty without a search.
        two_steps: result of the two steps that the search of a static gain also started from; None without.
        starts: number of other stable starts of that search.
        preview: force from the road ahead, in addition to that of the law; None without.
        without: value of the objective if nothing is known ahead.
        trade: Pareto front of norm and speed of full-order laws, the slowest first; empty for a law that is near the bound and
            not fast. For a discrete plant they belong to its continuous image.
        details: result of its method alone: the `MultiObjectiveDesign` of a design for goals, else None.
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
        """Its remarks in one text."""
        return "; ".join(self.remarks)

    @property
    def stable(self) -> bool:
        """True if the law itself is stable; an unstable one grows while its loop is open, as when a force saturates."""
        return is_stable(self.law.A, self.law.sample_period)

    @property
    def sampled_norm(self) -> float | None:
        """L2 gain of the loop that the computer closes, see `synth.sampled_norm`; None without a sample period."""
        return self.value if self.criterion == SAMPLED_NORM else None

    @property
    def h2_norm(self) -> float:
        """Rms of z under white noise w and LQG's noise, Dw left out; NaN for a law of another criterion."""
        return self.value if self.criterion == H2_NORM else np.nan

    @property
    def gain(self) -> Array:
        """K of a static law, shape (m, q).

        Raises:
            InputError: the law has states.
        """
        if self.law.states:
            raise InputError(f"the law has {states_text(self.law)} and is not only a gain; use its attribute law")
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
        """The gain of the closed loop."""
        return self.certificate.figures


def _law_shown(law: LinearLaw) -> dict[str, str]:
    """Returns a law with states as text: how many, if they are stable by themselves, and its matrices if they are few."""
    stable = is_stable(law.A, law.sample_period)
    matrices = {name: gain_text(getattr(law, name)) for name in "ABCD"} if law.states <= FEW else {}
    return {"law": f"{states_text(law)}; {'' if stable else 'not '}stable by itself"} | matrices
