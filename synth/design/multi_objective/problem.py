"""Problems of goals for plants: errors, norms, bounds and a structure; and the terms of a problem for some errors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
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
from synth.design.descent.landscape import Landscape
from synth.design.descent.terms import NormTerm, Term
from synth.design.multi_objective.band_norm import EVERYWHERE, Band, BandLandscape
from synth.design.multi_objective.objectives import BoundedSignal, Decay, EnergyPeak
from synth.design.multi_objective.peak import RoadPeak
from synth.design.multi_objective.road_response import RoadLoop
from synth.plant.generalized import Plant


@dataclass(frozen=True, eq=False)
class NormSpecification(CheckedFields):
    """Norm in a band, minimised or bounded.

    Attributes:
        which: index of the plant among a member's `plants`.
        band: lower and upper frequency [rad/s].
        at_most: the bound; infinite for what is minimised.
        name: description.

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
    """Returns a plant with measurements y = Cy x + Dyw w + `through` u.

    Args:
        plant: n states, m inputs.
        Cy: shape (q, n).
        Dyw: shape (q, r); None without noise.
        through: feedthrough from forces to measurements, shape (q, m); None without it.

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
    """A plant of a family, with its signals.

    Attributes:
        plants: the plant with its measurements and the z of each norm.
        driven_by: the plant on roads, each with its bounded signal.
        signals: signals of the first of `plants` with a bound for roads of given energy.
    """

    plants: Annotated[tuple[Plant, ...], AT_LEAST_ONE]
    driven_by: tuple[RoadLoop, ...] = ()
    signals: tuple[BoundedSignal, ...] = ()


@dataclass(frozen=True, eq=False)
class GainErrors(CheckedFields):
    """Relative errors of sensors and actuators: y is read as (1 + sensors) y, and (1 + forces) u acts.

    Attributes:
        sensors: shape (q,).
        forces: shape (m,).
    """

    sensors: Vector
    forces: Vector

    @property
    def key(self) -> bytes:
        """Key that is equal for equal errors."""
        return self.sensors.tobytes() + self.forces.tobytes()

    def on(self, plant: Plant) -> Plant:
        """Returns a plant with these errors."""
        u, y = 1 + self.forces, 1 + self.sensors[:, None]
        if np.all(u == 1) and np.all(y == 1):
            return plant
        measured = {"Cy": y * plant.Cy, "Dyu": y * plant.Dyu * u, "Dyw": y * plant.Dyw}
        return replace(plant, B=plant.B * u, D=plant.D * u, **measured)


@dataclass(frozen=True, eq=False)
class MultiObjectiveProblem(CheckedFields):
    """The problem of minimising over K the largest norm over members and errors, within bounds.

    Attributes:
        members: members of the family; one without a family.
        minimise: the minimised norm.
        norms: bounds on norms.
        decay: all poles lie left of minus this [rad/s]; None for the open left half plane.
        peaks: the largest magnitude of each member's driven signals.
        gain: the largest entry of K; None if unbounded.
        tolerance: the largest errors.
        structure: mask of the entries of K that may be nonzero, shape (m, q).
        bests: individual optima of the members, to minimise the largest ratio to them; None to minimise the largest norm.

    Raises:
        InputError: the parts do not fit one another.
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
            raise InputError(f"the plants of the family have {m} inputs and {q} measurements; give at least one of each")
        check_shape("structure", self.structure, (m, q), "a row for each input, and a column for each measured signal")
        check_shape("tolerance.sensors", self.tolerance.sensors, (q,), "one for each measured signal")
        check_shape("tolerance.forces", self.tolerance.forces, (m,), "one for each input")
        for name, members in (("peaks", [len(member.driven_by) for member in self.members]), ("bests", [len(self.members)])):
            given = getattr(self, name)
            if given is not None and any(len(given) != count for count in members):
                raise InputError(f"{name} has {len(given)} numbers; expected {members[0]}, one for each peak or member")
        fewest = min(len(member.plants) for member in self.members)
        for goal in (self.minimise, *self.norms):
            if goal.which >= fewest:
                raise InputError(
                    f"norm {goal.name!r} has which = {goal.which}, but a member has {fewest} plants posed; give a smaller index"
                )

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of K."""
        return self.structure.shape

    @property
    def has_errors(self) -> bool:
        """True if the tolerance is not zero."""
        return bool(np.any(self.tolerance.sensors) or np.any(self.tolerance.forces))

    @property
    def no_errors(self) -> GainErrors:
        """No error at all."""
        m, q = self.shape
        return GainErrors(np.zeros(q), np.zeros(m))

    def corners(self, most: int) -> list[GainErrors]:
        """Returns the vertices of the box of errors; empty if there are too many."""
        m, q = self.shape
        sides = np.concatenate([self.tolerance.sensors, self.tolerance.forces])
        free = np.flatnonzero(sides)
        if not len(free) or 2 ** len(free) > most:
            return []
        vertices = []
        for signs in product((-1.0, 1.0), repeat=len(free)):
            error = np.zeros(m + q)
            error[free] = signs * sides[free]
            vertices.append(GainErrors(error[:q], error[q:]))
        return vertices

    def alone(self, i: int) -> "MultiObjectiveProblem":
        """Returns the same problem for one member alone."""
        return replace(self, members=(self.members[i],), bests=None)

    def landscape(self, i: int, which: int, band: Band, errors: GainErrors, like: Landscape | None) -> BandLandscape:
        """Returns the landscape of a member's plant with errors."""
        return BandLandscape(errors.on(self.members[i].plants[which]), band, like)

    def nominal(self) -> BandLandscape:
        """Returns the landscape of the first member without errors, which defines the points of all."""
        return self.landscape(0, self.minimise.which, self.minimise.band, self.no_errors, None)


TIGHTER = 1e-7  # relative: margin by which bounds are kept, for rounding
AND_FOR_ERRORS = 0.02  # relative margin of a decay with errors: at the bound itself nothing can be proved for a whole box


def objectives_of(
    problem: MultiObjectiveProblem, full: BandLandscape, errors: Sequence[GainErrors], rate: float
) -> tuple[list[Term], list[Term]]:
    """Returns the goals and the bounds of a problem for some errors.

    Args:
        full: the landscape that defines the points of all terms.
        errors: errors of the gain, each of which applies to norms and decay; peaks are without errors.
        rate: the required decay [rad/s]; 0 for none.
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
                bounds.append(decay(problem, minimised, rate))  # of the same loop, whose poles are known then
        for signal in member.signals:
            landscape = problem.landscape(i, which, band, problem.no_errors, full)
            bounds.append(EnergyPeak(landscape, signal, signal.at_most * (1 - TIGHTER)))
        for driven, most in zip(member.driven_by, problem.peaks, strict=True):
            bounds.append(RoadPeak(driven, full.scale, most))
    return goals, bounds


def decay(problem: MultiObjectiveProblem, landscape: Any, rate: float) -> Decay:
    """Returns the bound on the slowest pole of the loop of a `BandLandscape`."""
    return Decay(landscape, rate * (1 + (AND_FOR_ERRORS if problem.has_errors else TIGHTER)))
