"""Problems of goals for plants: errors, norms, bounds and a structure; and the terms of a problem for some errors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Annotated

import numpy as np

from models.common.arrays import Array
from models.common.checks import AT_LEAST_ONE, Bound, Checked, Index, Matrix, NotNegative, Positive, Vector, check_shape
from models.common.errors import InputError
from models.laws.linear import static_law
from synth.analysis.band_norm import check_band
from synth.design.descent.landscape import Landscape
from synth.design.multi_objective.band_norm import EVERYWHERE, Band, BandLandscape
from synth.design.multi_objective.objectives import BoundedSignal, Decay, EnergyPeak, NormObjective, Objective
from synth.design.multi_objective.peak import RoadPeak
from synth.design.multi_objective.road_response import RoadLoop
from synth.plant.generalized import GeneralizedPlant


@dataclass(frozen=True, eq=False)
class NormSpecification(Checked):
    """Norm in a band, minimised or bounded.

    Attributes:
        which: index of the plant among a member's `posed`.
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


@dataclass(frozen=True, eq=False)
class MeasuredPlant(Checked):
    """Plant with one z, and its measurements.

    Attributes:
        plant: n states, m inputs.
        Cy: shape (q, n).
        Dyw: shape (q, r); None without noise.
        through: feedthrough from forces to measurements, shape (q, m); None without it.

    Raises:
        InputError: a matrix does not fit the plant.
    """

    plant: GeneralizedPlant
    Cy: Matrix
    Dyw: Matrix | None = None
    through: Matrix | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_shape("Cy", self.Cy, (len(self.Cy), len(self.plant.A)), "a column for each state of the plant")
        if self.Dyw is not None:
            check_shape("Dyw", self.Dyw, (len(self.Cy), self.plant.Bw.shape[1]), "rows of Cy by columns of Bw")
        if self.through is not None:
            check_shape("through", self.through, (len(self.Cy), self.plant.B.shape[1]), "rows of Cy by inputs of the plant")

    def acting(self, K: Array) -> Array:
        """Returns the gain on C_y x + Dyw w that acts as K on the measurements, (I - K through)^-1 K, shape (m, q).

        Raises:
            InputError: the loop has no solution.
        """
        return K if self.through is None else static_law(K).fed_back(self.through).D

    def on_readings(self, G: Array) -> Array:
        """Returns the gain on readings that acts as G acts on C_y x + Dyw w: the inverse of `acting`."""
        return G if self.through is None else static_law(G).fed_back(-self.through).D

    @property
    def without_weighting(self) -> "MeasuredPlant":
        """The plant without its filters, whose states are the last: a gain decides the stability of this part alone."""
        plant, own = self.plant, slice(len(self.plant.A) - self.plant.weights)
        alone = replace(plant, A=plant.A[own, own], B=plant.B[own], Bw=plant.Bw[own], C=plant.C[:, own], weights=0)
        return MeasuredPlant(alone, self.Cy[:, own], self.Dyw, self.through)


@dataclass(frozen=True, eq=False)
class FamilyMember(Checked):
    """A plant of a family, with its signals.

    Attributes:
        posed: the plant with the z of each norm.
        driven_by: the plant on roads, each with its bounded signal.
        signals: signals of the first of `posed` with a bound for roads of given energy.
    """

    posed: Annotated[tuple[MeasuredPlant, ...], AT_LEAST_ONE]
    driven_by: tuple[RoadLoop, ...] = ()
    signals: tuple[BoundedSignal, ...] = ()


@dataclass(frozen=True, eq=False)
class GainErrors(Checked):
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

    def on(self, posed: MeasuredPlant) -> MeasuredPlant:
        """Returns a plant with these errors, and its measurements."""
        u, y, plant = 1 + self.forces, 1 + self.sensors, posed.plant
        if np.all(u == 1) and np.all(y == 1):
            return posed
        plant = replace(plant, B=plant.B * u, D=plant.D * u)
        Dyw = None if posed.Dyw is None else y[:, None] * posed.Dyw
        return MeasuredPlant(plant, y[:, None] * posed.Cy, Dyw, None if posed.through is None else y[:, None] * posed.through * u)


@dataclass(frozen=True, eq=False)
class MultiObjectiveProblem(Checked):
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
        plant, Cy = self.members[0].posed[0].plant, self.members[0].posed[0].Cy
        m, q = plant.B.shape[1], len(Cy)
        if not m or not q:
            raise InputError(f"the plants of the family have {m} inputs and {q} measurements; give at least one of each")
        check_shape("structure", self.structure, (m, q), "a row for each input, and a column for each measured signal")
        check_shape("tolerance.sensors", self.tolerance.sensors, (q,), "one for each measured signal")
        check_shape("tolerance.forces", self.tolerance.forces, (m,), "one for each input")
        for name, members in (("peaks", [len(member.driven_by) for member in self.members]), ("bests", [len(self.members)])):
            given = getattr(self, name)
            if given is not None and any(len(given) != count for count in members):
                raise InputError(f"{name} has {len(given)} numbers; expected {members[0]}, one for each peak or member")
        fewest = min(len(member.posed) for member in self.members)
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
        posed = errors.on(self.members[i].posed[which])
        return BandLandscape(posed.plant, posed.Cy, posed.Dyw, band, like, posed.through)

    def nominal(self) -> BandLandscape:
        """Returns the landscape of the first member without errors, which defines the points of all."""
        return self.landscape(0, self.minimise.which, self.minimise.band, self.no_errors, None)


TIGHTER = 1e-7  # relative: margin by which bounds are kept, for rounding
AND_FOR_ERRORS = 0.02  # relative margin of a decay with errors: at the bound itself nothing can be proved for a whole box


def objectives_of(
    problem: MultiObjectiveProblem, full: BandLandscape, errors: Sequence[GainErrors], rate: float
) -> tuple[list[Objective], list[Objective]]:
    """Returns the goals and the bounds of a problem for some errors.

    Args:
        full: the landscape that defines the points of all terms.
        errors: errors of the gain, each of which applies to norms and decay; peaks are without errors.
        rate: the required decay [rad/s]; 0 for none.
    """
    goals: list[Objective] = []
    bounds: list[Objective] = []
    which, band = problem.minimise.which, problem.minimise.band
    for i, member in enumerate(problem.members):
        unit = problem.bests[i] if problem.bests is not None else 1.0
        for each in errors:
            minimised = problem.landscape(i, which, band, each, full)
            goals.append(NormObjective(minimised, unit))
            for norm in problem.norms:
                landscape = problem.landscape(i, norm.which, norm.band, each, full)
                bounds.append(NormObjective(landscape, norm.at_most * (1 - TIGHTER), norm.name))
            if rate:
                bounds.append(decay(problem, minimised, rate))  # of the same loop, whose poles are known then
        for signal in member.signals:
            landscape = problem.landscape(i, which, band, problem.no_errors, full)
            bounds.append(EnergyPeak(landscape, signal, signal.at_most * (1 - TIGHTER)))
        for driven, most in zip(member.driven_by, problem.peaks, strict=True):
            bounds.append(RoadPeak(driven, full.scale, most))
    return goals, bounds


def decay(problem: MultiObjectiveProblem, landscape: BandLandscape, rate: float) -> Decay:
    """Returns the bound on the slowest pole of a loop."""
    return Decay(landscape, rate * (1 + (AND_FOR_ERRORS if problem.has_errors else TIGHTER)))
