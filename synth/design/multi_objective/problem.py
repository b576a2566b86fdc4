"""Multi-objective design problem with norms, bounds, gain errors and a structure, and its terms for given gain errors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from models.common.checks import (
    AT_LEAST_ONE,
    Bound,
    CheckedFields,
    Index,
    Matrix,
    NotNegative,
    Positive,
    Vector,
    accept_former_names,
    check_shape,
)
from models.common.errors import InputError
from synth.analysis.band_norm import check_band
from synth.analysis.uncertainty_box import Box
from synth.design.descent.landscape import EVERYWHERE, Band, Landscape
from synth.design.descent.terms import NormTerm, Term
from synth.design.multi_objective.band_norm import BandLandscape
from synth.design.multi_objective.objectives import BoundedSignal, Decay, EnergyPeak
from synth.design.multi_objective.peak import RoadPeak
from synth.design.multi_objective.road_response import RoadLoop
from synth.plant.generalized import Plant


@dataclass(frozen=True, eq=False)
class NormSpecification(CheckedFields):
    """Norm in a frequency band that is minimised or bounded.

    Attributes:
        which: index of the plant in the attribute `plants` of a member.
        band: lower and upper frequency [rad/s].
        at_most: largest allowed norm; infinite for the norm that is minimised.
        name: description of the norm, used in error messages.

    Raises:
        InputError: the band is empty, or a field is not allowed.
    """

    which: Index = 0
    band: Band = EVERYWHERE
    at_most: Bound = np.inf
    name: str = "norm"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_band(*self.band)


def MeasuredPlant(plant: Plant, Cy: Matrix, Dyw: Matrix | None = None, through: Matrix | None = None) -> Plant:
    """Returns a plant with the measurements y = Cy x + Dyw w + `through` u.

    Args:
        plant: generalised plant with n states and m inputs.
        Cy: measurement matrix, shape (q, n).
        Dyw: direct effect of w on the measurements, shape (q, r); zero by default.
        through: direct effect of the forces on the measurements, shape (q, m); zero by default.

    Returns:
        A copy of the plant, with y as its measurements.

    Raises:
        InputError: a matrix does not fit the plant.

    Example:
        >>> from synth import GeneralizedPlant, MeasuredPlant
        >>> plant = GeneralizedPlant(A=[[0, 1], [-4, -1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0]], D=[[0]], Dw=[[0]])
        >>> MeasuredPlant(plant, Cy=[[0, 1]]).Dyw.shape
        (1, 1)
    """
    return replace(plant, Cy=Cy, Dyw=Dyw, Dyu=through)


@accept_former_names(posed="plants")
@dataclass(frozen=True, eq=False)
class FamilyMember(CheckedFields):
    """Member of a family of plants, with its bounded signals.

    Attributes:
        plants: copies of the plant with its measurements, one for each norm; z of each copy contains the signals of its norm.
        driven_by: plant, road and bounded signal, for each bound on a peak.
        signals: signals of the first plant in `plants` that are bounded for disturbances of a given energy.
    """

    plants: Annotated[tuple[Plant, ...], AT_LEAST_ONE]
    driven_by: tuple[RoadLoop, ...] = ()
    signals: tuple[BoundedSignal, ...] = ()


@dataclass(frozen=True, eq=False)
class GainErrors(CheckedFields):
    """Relative gain errors: the controller receives (1 + sensors) y, and the plant receives (1 + forces) u.

    Attributes:
        sensors: relative error of each measurement, shape (q,).
        forces: relative error of each force, shape (m,).
    """

    sensors: Vector
    forces: Vector

    @property
    def key(self) -> bytes:
        """Dictionary key that is the same for two equal sets of gain errors."""
        return self.sensors.tobytes() + self.forces.tobytes()

    def on(self, plant: Plant) -> Plant:
        """Returns the plant with the gain errors in its measurements and forces."""
        u, y = 1 + self.forces, 1 + self.sensors[:, None]
        if np.all(u == 1) and np.all(y == 1):
            return plant
        measured = {"Cy": y * plant.Cy, "Dyu": y * plant.Dyu * u, "Dyw": y * plant.Dyw}
        return replace(plant, B=plant.B * u, D=plant.D * u, **measured)


@dataclass(frozen=True, eq=False)
class MultiObjectiveProblem(CheckedFields):
    """Problem of finding the gain K that minimises the largest norm over all members and gain errors, with bounds on other
    quantities.

    Attributes:
        members: members of the family; a single member for one plant.
        minimise: norm whose largest value over all members and gain errors is minimised.
        norms: bounds on norms.
        decay: required decay rate [rad/s], so that all poles have a real part below -decay; None requires only stability.
        peaks: largest allowed magnitude of each signal in `driven_by`.
        gain: largest allowed |K_ij|; None if there is no limit.
        tolerance: largest relative gain errors that the loop must tolerate.
        structure: mask of the entries of K that may be nonzero, shape (m, q).
        bests: individual optima of the members, to minimise the largest ratio of a norm to its individual optimum; None to
            minimise the largest norm.

    Raises:
        InputError: the plants, norms, errors and structure do not fit together.
    """

    members: Annotated[tuple[FamilyMember, ...], AT_LEAST_ONE]
    minimise: NormSpecification
    tolerance: GainErrors
    structure: Matrix
    norms: tuple[NormSpecification, ...] = ()
    decay: NotNegative | None = None
    peaks: tuple[Bound, ...] = ()
    gain: Positive | None = None
    bests: tuple[Positive, ...] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        q, m = self.members[0].plants[0].Dyu.shape
        if not m or not q:
            raise InputError(
                f"the plants of the family have {m} inputs and {q} measurements; give at least one input and one measurement"
            )
        check_shape("structure", self.structure, (m, q), "a row for each input, and a column for each measured signal")
        check_shape("tolerance.sensors", self.tolerance.sensors, (q,), "one for each measured signal")
        check_shape("tolerance.forces", self.tolerance.forces, (m,), "one for each input")
        for name, members in (("peaks", [len(member.driven_by) for member in self.members]), ("bests", [len(self.members)])):
            given = getattr(self, name)
            if given is not None and any(len(given) != count for count in members):
                raise InputError(
                    f"{name} has {len(given)} numbers; give {members[0]} numbers: one for each peak, or one for each member "
                    "of the family"
                )
        fewest = min(len(member.plants) for member in self.members)
        for goal in (self.minimise, *self.norms):
            if goal.which >= fewest:
                raise InputError(
                    f"norm {goal.name!r} applies to the plant with the index which = {goal.which}, but one member of "
                    f"the family has only {fewest} plants; give a smaller index in which"
                )

    @property
    def shape(self) -> tuple[int, int]:
        """Shape (m, q) of K."""
        return self.structure.shape

    @property
    def has_errors(self) -> bool:
        """True if some gain error must be tolerated."""
        return bool(np.any(self.tolerance.sensors) or np.any(self.tolerance.forces))

    @property
    def no_errors(self) -> GainErrors:
        """Gain errors that are all zero."""
        m, q = self.shape
        return GainErrors(np.zeros(q), np.zeros(m))

    def corners(self, most: int) -> list[GainErrors]:
        """Returns the vertices of the box of gain errors; an empty list if the box has more than `most` vertices."""
        sides = np.concatenate([self.tolerance.sensors, self.tolerance.forces])
        if not 0 < np.count_nonzero(sides) <= np.log2(most):
            return []
        return [GainErrors(*np.split(errors, [self.shape[1]])) for errors in Box(-sides, sides).vertices]

    def alone(self, i: int) -> "MultiObjectiveProblem":
        """Returns the problem for a single member of the family."""
        return replace(self, members=(self.members[i],), bests=None)

    def landscape(self, i: int, which: int, band: Band, errors: GainErrors, like: Landscape | None) -> BandLandscape:
        """Returns the landscape of the norm for one plant of a member, with given gain errors."""
        return BandLandscape(errors.on(self.members[i].plants[which]), band, like)

    def nominal(self) -> BandLandscape:
        """Returns the landscape of the first member without gain errors, whose scales define the points of all landscapes."""
        return self.landscape(0, self.minimise.which, self.minimise.band, self.no_errors, None)


TIGHTER = 1e-7  # relative amount by which bounds are tightened, to allow for rounding
# The required decay rate is raised by this relative amount if the gain has errors. At the required rate itself, nothing can be
# proved for a whole box of errors
AND_FOR_ERRORS = 0.02


def objectives_of(
    problem: MultiObjectiveProblem, full: BandLandscape, errors: Sequence[GainErrors], rate: float
) -> tuple[list[Term], list[Term]]:
    """Returns the goals and the bounds of a problem for given gain errors, as terms.

    Args:
        full: landscape whose scales define the points of all terms.
        errors: gain errors, which apply to the norms and to the decay rate; peaks are computed without errors.
        rate: required decay rate [rad/s]; 0 if there is no requirement.
    """
    goals: list[Term] = []
    bounds: list[Term] = []
    which, band = problem.minimise.which, problem.minimise.band
    for i, member in enumerate(problem.members):
        unit = problem.bests[i] if problem.bests is not None else 1.0
        for each in errors:
            minimised = problem.landscape(i, which, band, each, full)
            goals.append(NormTerm(minimised, unit))
            for norm in problem.norms:
                landscape = problem.landscape(i, norm.which, norm.band, each, full)
                bounds.append(NormTerm(landscape, norm.at_most * (1 - TIGHTER), norm.name))
            if rate:
                # the decay bound uses the same loop, whose poles have already been computed
                bounds.append(decay(problem, minimised, rate))
        for signal in member.signals:
            landscape = problem.landscape(i, which, band, problem.no_errors, full)
            bounds.append(EnergyPeak(landscape, signal, signal.at_most * (1 - TIGHTER)))
        for driven, most in zip(member.driven_by, problem.peaks, strict=True):
            bounds.append(RoadPeak(driven, full.scale, most))
    return goals, bounds


def decay(problem: MultiObjectiveProblem, landscape: Any, rate: float) -> Decay:
    """Returns the term that bounds the slowest pole of the loop of a `BandLandscape`."""
    return Decay(landscape, rate * (1 + (AND_FOR_ERRORS if problem.has_errors else TIGHTER)))
