"""A part of a suspension: a force between body and wheel, with all its properties that analysis and simulation need.

The force F(d, v, z, u) of a part pulls the ends of its suspension together if it is positive. The arguments are the extension d
of the suspension from equilibrium, its rate v (positive if the suspension extends), the part's internal states z, and its
inputs u. Linear analysis uses the following linearisation of F at equilibrium,

    F = k d + c v + b v' + C z + g u,    z' = A z + (rows for d, v and u),

and all simulations add the difference between the force and its linearisation. A new part is a class in a file of the folder
`models/parts`, or a force element of `[parts]` in a file of its subfolder `elements`. A new part also needs a line in
`EXTENSIONS` of `models.common.extensions`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from models.characteristics import LEAVES, SIDES
from models.common.arrays import Array
from models.common.extensions import FEATURES

if TYPE_CHECKING:
    from models.characteristics.adjustable_range import Damper
    from models.characteristics.curve import ForceCurve
    from models.characteristics.curve_reading import Argument
    from models.characteristics.surface import ForceSurface
    from models.kinds.kind import Suspension
    from models.kinds.signals import Signal
    from models.parts.native import Tendon

Number = float | Array  # an array of shape (N,) has one number for each of N simultaneous runs
Quantity = Literal["deflection", "velocity", "force"]
POINTS = 401  # a figure shows a characteristic with this number of points, including the point at equilibrium
STEP = 1e-200  # size of a complex step; derivatives that are computed with this step are exact except for rounding errors
# A force has a kink if, for a motion about equilibrium with this amplitude [m or m/s], it differs from its linearisation by at
# least the share KINKED.
SMALL, KINKED = 1e-6, 1e-3
CURVE, BUMP_STOP = "curve", "bump stop"  # linear analysis no longer applies after these events


@dataclass(frozen=True, eq=False)
class Line:
    """Linearisation of a part with n internal states about equilibrium.

    The part pulls with k d + c v + b v' + C z + g u; the rates of its internal states z are also linear.

    Attributes:
        stiffness: k [N/m].
        damping: c [N s/m].
        gain: gain g, the force per unit of the input; 0 for a part without an input.
        of_preload: contribution to k of a preload that acts through a motion ratio that changes with travel [N/m].
        inertance: b [kg].
        of_states: gains C from the internal states to the force, shape (..., n); None for a part without states.
        rates: gains from (z, d, v, u) to the rates z' of the internal states, shape (..., n, n + 3); None for a part without
            states.
    """

    stiffness: Number = 0.0
    damping: Number = 0.0
    gain: Number = 0.0
    of_preload: Number = 0.0
    inertance: Number = 0.0
    of_states: Array | None = None
    rates: Array | None = None

    def __eq__(self, other: object) -> bool:
        names = [one.name for one in fields(self)]
        return isinstance(other, Line) and all(np.array_equal(getattr(self, name), getattr(other, name)) for name in names)

    @property
    def sloped(self) -> bool:
        """True if the linearised force can differ from 0 while the input is 0."""
        return self.of_states is not None or bool(self.stiffness or self.damping or self.inertance)

    def __call__(self, d: Array, v: Array, u: Array | float = 0.0, z: Array | None = None) -> Array:
        """Returns the linearised force without the force of the inertance [N], shape (...).

        If the internal states `z` are omitted, they count as 0.
        """
        total: Any = None
        for slope, x in ((self.stiffness, d), (self.damping, v), (self.gain, u)):
            # This shortcut exists because the code runs in each stage of a time step, and most parts have only one coefficient
            # that is not 0
            if not isinstance(slope, float) or slope:
                total = slope * x if total is None else total + slope * x
        total = 0.0 if total is None else total
        return total if z is None or self.of_states is None else total + (self.of_states * z).sum(axis=-1)

    def rate(self, d: Array, v: Array, z: Array, u: Array | float = 0.0) -> Array:
        """Returns the linearised rates of the internal states, shape (..., n)."""
        assert self.rates is not None, "a part with states"
        return np.matvec(self.rates, np.concatenate([z, np.stack(np.broadcast_arrays(d, v, u), axis=-1)], axis=-1))


@dataclass(frozen=True)
class Limit:
    """Limit of a quantity, beyond which linear analysis is not valid because of a part.

    Attributes:
        end: name of the event that occurs when the quantity reaches the limit, as in `sim.drive.regime`.
        of: the limited quantity: deflection or velocity of the suspension, or the difference between the force and its
            linearisation.
        sign: sign of the quantity on the side that has the limit; 0 if both sides have the limit.
        value: limit of the quantity's magnitude [m, m/s or N].
    """

    end: str
    of: Quantity
    sign: float
    value: float


class Part(ABC):
    """Force along a suspension.

    Every part is a frozen dataclass. The numbers of a part may be arrays of shape (N,), for N simultaneous runs (`Stack`).
    Arrays of deflections, velocities and forces have any shape (...). Arrays of internal states have one additional axis, the
    last.
    """

    # Signals of the part's internal states, which are 0 in equilibrium; in a vehicle, their names also contain the element and
    # the corner
    states: ClassVar[tuple["Signal", ...]] = ()
    inputs: ClassVar[int] = 0
    # Smallest and largest value that a controller can give to the part's input; None if no controller sets the input
    settable: ClassVar[tuple[Number, Number] | None] = None
    # Parameter of the suspension that a characteristic in `[curves]` replaces, and variable on which the characteristic depends
    replaces: ClassVar[tuple[str, "Argument"] | None] = None
    reach: ClassVar[float] = np.inf  # the part is valid up to this magnitude of its argument [m/s or m]
    # True for a part whose force acts only beyond a limit of the linear range; nonlinear reference solutions omit this force
    contact: ClassVar[bool] = False
    stores: ClassVar[bool] = False  # True for a part that stores energy and does not dissipate any
    argument: ClassVar[Quantity | None] = None  # argument of the force, if the force depends on one quantity only
    # Largest rate of the part's internal states at 2 m/s [1/s], if this rate grows with velocity
    fastest: ClassVar[float] = 0.0
    native: ClassVar[bool] = False  # True if the method `write` can represent the nonlinear force by MuJoCo's own elements

    @abstractmethod
    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """Returns the force that pulls body and wheel together [N], shape (...).

        Args:
            d: extension of the suspension from equilibrium [m], shape (...).
            v: rate of the suspension's extension [m/s], shape (...).
            z: n internal states of the part, shape (..., n).
            u: input, shape (...).
        """

    def rate(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """Returns the rates of the part's internal states, shape (..., n). For the arguments, see `pull`."""
        return np.zeros((*np.shape(d), 0))

    def divisor(self, u: Array | float) -> Any:
        """Returns a positive divisor that is linear in the input u:

        the product of `pull` and the divisor is a quadratic function of the input.
        """
        return 1.0

    def stored(self, d: Array, z: Any = None) -> Array:
        """Returns the energy stored in the part [J], shape (...)."""
        return np.zeros(np.shape(d))

    def inertance_at(self, d: Array) -> Number:
        """Returns the inertance b of an additional force b v' [kg], shape () or (...). The kinetic energy of the inertance is b
        v^2 / 2.
        """
        return 0.0

    def centrifugal(self, d: Array, v: Array) -> Array | float:
        """Returns the contribution to `pull` of an inertance b that changes with travel d, (db/dd) v^2 / 2 [N], shape (...)."""
        return 0.0

    @cached_property
    def line(self) -> Line:
        """Linearisation of the part at equilibrium, computed by complex steps."""
        step, at = np.array(STEP * 1j), np.array(0j)
        along = ((step, at, at), (at, step, at), (at, at, step))[: 2 + self.inputs]
        n, inertance = len(self.states), self.inertance_at(np.zeros(()))
        slopes: Any = (np.imag(self.pull(d, v, np.zeros(n), u)) / STEP for d, v, u in along)
        if not n:
            return Line(*slopes, inertance=inertance)
        rows = STEP * 1j * np.eye(n + 3)  # each row contains a complex step of one internal state z, or of d, v or u
        pulls = [np.imag(self.pull(at, at, row[:n], at)) / STEP for row in rows[:n]]
        rates = [np.imag(self.rate(row[n], row[n + 1], row[:n], row[n + 2])) / STEP for row in rows]
        return Line(*slopes, inertance=inertance, of_states=np.stack(pulls, axis=-1), rates=np.stack(rates, axis=-1))

    def beyond(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """Returns the force of the part minus its linearisation, without inertance [N], shape (...).

        For the arguments, see `pull`.
        """
        return self.pull(d, v, z, u) - self.line(d, v, u, z)

    def rate_beyond(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """Returns the rates of the internal states minus their linearisation, shape (..., n).

        For the arguments, see `pull`.
        """
        return self.rate(d, v, z, u) - self.line.rate(d, v, z, u)

    def stored_beyond(self, d: Array, z: Any = None) -> Array:
        """Returns the energy stored in the part, minus the energy of the linearised stiffness [J], shape (...)."""
        return self.stored(d, z) - self.line.stiffness * np.square(d) / 2

    @property
    def is_nonlinear(self) -> bool:
        """False if the force of the part equals its linearisation everywhere."""
        return True

    @property
    def range(self) -> float:
        """Magnitude of the largest force for which the part is valid [N]; infinity if this force is unknown."""
        return np.inf if self.curve is None else self.curve.range

    @property
    def acts(self) -> bool:
        """False if the force of the part never differs from its linearisation."""
        return self.is_nonlinear or bool(self.inputs)

    @property
    def kinked_at_rest(self) -> bool:
        """True if the force has a kink at equilibrium, so that linear analysis is not valid even for the smallest motion."""
        d, v = SMALL * np.array([[1, -1, 0, 0], [0, 0, 1, -1]])
        at = d, v, np.zeros((4, len(self.states)))
        bent = bool(np.any(np.abs(self.beyond(*at)) > KINKED * np.abs(self.pull(*at))))
        return bent or (bool(self.states) and bool(np.any(np.abs(self.rate_beyond(*at)) > KINKED * np.abs(self.rate(*at)))))

    def limits(self) -> Sequence[Limit]:
        """Returns the limits of the part's linear range.

        By default, the linear range ends if the force differs from its linearisation by the share `LEAVES` of the largest
        force.
        """
        return (Limit(CURVE, "force", 0.0, LEAVES * self.range),) if self.is_nonlinear and np.isfinite(self.range) else ()

    @cached_property
    def curve(self) -> "ForceCurve | None":
        """Characteristic of the force as a function of its only argument, at `POINTS` points up to `reach`.

        The characteristic is None if the force has several arguments, or if `reach` is infinite.
        """
        if self.argument is None or not np.isfinite(self.reach):
            return None

        x, line = np.linspace(-self.reach, self.reach, POINTS), self.line
        force = self.pull(*((0 * x, x) if self.argument == "velocity" else (x, 0 * x)))
        slope = line.damping if self.argument == "velocity" else line.stiffness
        return FEATURES.load("curves").ForceCurve(x, force, float(slope), self.words)

    def own_motion(self, d: Array, v: Array) -> tuple[Array, Array]:
        """Converts travel [m] and velocity [m/s] at the wheel to the travel and velocity between the part's own ends, shapes
        (...).
        """
        return d, v

    def at_wheel(self, ratio: float) -> "Part | None":
        """Returns the equivalent part at the wheel for a constant motion ratio; None if an `AtRatio` must represent the part."""
        return self if ratio == 1 else None

    def write(self, tendon: "Tendon") -> None:
        """Writes the part's nonlinear force into an MjSpec, with MuJoCo's own elements."""
        raise NotImplementedError(f"{type(self).__name__} has no form native to MuJoCo")

    def write_input(self, tendon: "Tendon", by_motor: bool) -> None:
        """Writes the effect of the input's actuator into an MjSpec.

        Args:
            tendon: tendon of the suspension.
            by_motor: True if a motor already applies the nonlinear force.
        """
        return  # most parts have no input, so this default writes nothing

    @property
    def words(self) -> str:
        """Phrase that describes the part."""
        return type(self).__name__

    @classmethod
    def of(cls, vehicle: Any, place: "Suspension") -> Iterator[tuple["Part", str]]:
        """Yields the parts of a suspension that are described by sections other than `[parts]`, before their motion ratio is
        applied.

        Each part is paired with the parameter that contains its linearisation, or with an empty text.
        """
        yield from ()


@dataclass(frozen=True, eq=False)
class SuspensionPart:
    """Part of a suspension, together with its place in a vehicle.

    Attributes:
        place: suspension on which the part acts.
        part: the equivalent part that acts at the wheel, after the motion ratio is applied.
        parameter: parameter of the vehicle that contains the linearisation of the part; empty for an element of `[parts]`.
        ratio: motion ratio of the part in equilibrium.
        element: name of the section of `[parts]`; empty for a part from a different section.
    """

    place: "Suspension"
    part: Part
    parameter: str
    ratio: float
    element: str = ""

    @property
    def name(self) -> str:
        """The name of the parameter that contains the linearisation of the part, or the name of the section of `[parts]`."""
        return self.parameter or self.element

    @property
    def deflection(self) -> str:
        """Name of the suspension's deflection signal."""
        return self.place.deflection

    @property
    def tendon(self) -> str:
        """Name of the suspension's tendon in the MJCF."""
        return self.place.tendon

    @cached_property
    def added_line(self) -> Line:
        """Linearisation of the part; zero if a parameter of the vehicle already contains the linearisation."""
        return Line() if self.parameter else self.part.line

    @cached_property
    def states(self) -> "tuple[Signal, ...]":
        """Signals of the part's internal states."""
        return state_signals(self.part, self.element, self.place)

    @property
    def native(self) -> bool:
        """True if MuJoCo's own elements can represent everything that the part adds to the linear springs and dampers."""
        return self.part.native and not self.added_line.sloped

    @property
    def acts(self) -> bool:
        """True if the part adds a force to the vehicle's linear springs and dampers."""
        return self.part.acts or self.added_line.sloped

    @property
    def damps(self) -> bool:
        """True if the characteristic of the part is a function of velocity."""
        return self.part.argument != "deflection"

    @property
    def argument(self) -> str:
        """Name of the signal that is the argument of the part's characteristic."""
        return self.place.velocity.name if self.damps else self.place.deflection

    @property
    def curve(self) -> "ForceCurve":
        """The characteristic of the part; the part must have one."""
        assert self.part.curve is not None, "a part with a curve"
        return self.part.curve

    @property
    def surface(self) -> "ForceSurface | None":
        """The characteristic of a damper as a function of velocity and deflection; None if the force has only one argument."""

        curve: Any = self.part.curve
        return curve if isinstance(curve, FEATURES.load("surfaces").ForceSurface) else None


def state_signals(part: Part, element: str, place: "Suspension") -> "tuple[Signal, ...]":
    """Returns the signals of the part's internal states, for a part that is an element of a suspension."""
    signals = (
        replace(one, name=f"{element}_{one.name}", symbol=f"{one.symbol} {element}", meaning=f"{one.meaning}, {element}")
        for one in part.states
    )
    return tuple(one.at(place.corner) if place.corner else one for one in signals)


@dataclass(frozen=True)
class SettablePart(Part):
    """Damper whose coefficient a valve sets. The input of the damper is its coefficient minus the nominal coefficient [N s/m].

    The control force that the damper replaces is defined relative to the force of the nominal damper. Numbers, forces and
    velocities are those of the damper itself, before its motion ratio is applied. Only the methods of `Part` use forces and
    velocities at the wheel.

    Attributes:
        force: name of the control force that the damper replaces.
        ending: suffix of the signal names at the suspension of the damper.
        damper: semi-active damper of the vehicle file, with the limits of its coefficient.
        nominal: coefficient of the damper in the linear model [N s/m].
        ratio: motion ratio of the part in equilibrium.
        nominal_curve: characteristic of the nominal damper, including a characteristic in parallel; None if both are straight.
    """

    inputs = 1

    force: str
    ending: str
    damper: "Damper"
    nominal: float
    ratio: float = 1.0
    nominal_curve: "ForceCurve | None" = None

    @property
    def coefficient(self) -> str:
        """Name of the signal with the damper's actual coefficient."""
        return f"damping{self.ending}"

    @property
    def missing(self) -> str:
        """Name of the signal that contains the requested force minus the force that the damper can give."""
        return f"missing_force{self.ending}"

    @property
    def low(self) -> float:
        """Smallest coefficient of the damper minus the nominal coefficient [N s/m]."""
        return self.damper.c_min - self.nominal

    @property
    def high(self) -> float:
        """Largest coefficient of the damper minus the nominal coefficient [N s/m]."""
        return self.damper.c_max - self.nominal

    @property
    def slopes(self) -> tuple[float, float]:
        """Smallest coefficient and steepest slope of the damper, both minus the nominal coefficient [N s/m]."""
        return self.low, self.steepest_slope - self.nominal

    @property
    def steepest_slope(self) -> float:
        """Steepest slope of the damper's force at any setting [N s/m], without a characteristic that acts in parallel."""
        pair = self.damper.pair
        return self.damper.c_max if pair is None else float(max(pair.soft.slopes.max(), pair.hard.slopes.max()))

    def shape(self, v: Array) -> Array:
        """Returns h, the force per unit of the coefficient [m/s], at velocities between the damper's own ends [m/s], shape
        (...).
        """
        return np.asarray(v) if self.damper.pair is None else self.damper.pair.shape(v)

    def force_at(self, v: Array, beyond: Array | float) -> Array:
        """Returns the damper's force [N], shape (...).

        Args:
            v: velocities between the damper's own ends [m/s], shape (...).
            beyond: coefficients minus the nominal coefficient [N s/m], shape (...).
        """
        still = self.nominal * np.asarray(v) if self.nominal_curve is None else self.nominal_curve(v)
        return still + beyond * self.shape(v)


class Parts(tuple[SuspensionPart, ...]):
    """Parts of a vehicle, ordered by suspension."""

    @cached_property
    def with_curve(self) -> tuple[SuspensionPart, ...]:
        """Parts of the vehicle that have a characteristic."""
        return tuple(one for one in self if one.part.curve is not None)

    @cached_property
    def nonlinear(self) -> bool:
        """True if the force of a part differs from its linearisation while no bump stop or other contact acts."""
        return any(one.part.is_nonlinear and not one.part.contact for one in self)

    @cached_property
    def adjustable(self) -> tuple[SettablePart, ...]:
        """Semi-active dampers of the vehicle, each with its motion ratio in equilibrium."""
        own = ((getattr(one.part, "part", one.part), one.ratio) for one in self)
        return tuple(replace(part, ratio=ratio) for part, ratio in own if isinstance(part, SettablePart))

    @cached_property
    def strokes(self) -> Mapping[str, Mapping[str, float]]:
        """Travel at the wheel from equilibrium to every bump stop [m], by deflection signal and side (`bump` or `rebound`)."""
        strokes = dict[str, dict[str, float]]()
        for one in self:
            for limit in one.part.limits() if one.part.contact else ():
                if limit.end == BUMP_STOP:
                    strokes.setdefault(one.deflection, {})[SIDES[limit.sign > 0]] = limit.value
        return strokes


@dataclass(frozen=True)
class Straight(Part):
    """Part whose force is the linearisation of the force of another part. The linearised part and the other part have the same
    signals for their internal states.
    """

    at_rest: Line
    own: "tuple[Signal, ...]" = ()

    @property
    def states(self) -> "tuple[Signal, ...]":  # pyright: ignore[reportIncompatibleVariableOverride]
        """See `Part.states`."""
        return self.own

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        return self.at_rest(d, v, u, z)

    def rate(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        return self.at_rest.rate(d, v, z, u) if self.own else super().rate(d, v)

    def stored(self, d: Array, z: Any = None) -> Array:
        return self.at_rest.stiffness * np.square(d) / 2

    def inertance_at(self, d: Array) -> Number:
        return self.at_rest.inertance

    @cached_property
    def line(self) -> Line:
        return self.at_rest

    @property
    def is_nonlinear(self) -> bool:
        return False


class Stack:
    """Parts of N runs at k suspensions, evaluated together if they differ only in their numbers."""

    def __init__(self, parts: Sequence[Sequence[Part]], line: bool = False) -> None:
        """Groups the parts.

        Args:
            parts: k parts for each run, or k parts that all runs share. All runs have the same types of parts, with
                different numbers.
            line: True to include the linearised force of the parts, except the force of their inputs.
        """
        groups: list[tuple[list[Part], list[int]]] = []
        for i, row in enumerate(parts):
            for members, rows in groups:
                if all(alike(members[0], part) for part in row):
                    members += row
                    rows.append(i)
                    break
            else:
                groups.append(([*row], [i]))
        self._line, self.columns = line, len(parts[0])
        shapes = ((len(rows), self.columns) if len(parts) > 1 else (self.columns,) for _, rows in groups)
        together = (merge_parts(members, shape) for (members, _), shape in zip(groups, shapes, strict=True))
        self._groups = [(part, np.array(rows)) for part, (_, rows) in zip(together, groups, strict=True) if part is not None]

    def beyond(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """Returns `Part.beyond` of all parts, for arrays of shape (..., N, k)."""
        if len(self._groups) == 1 and not self._line:  # this shortcut exists because the code runs in each stage of a time step
            return self._groups[0][0].beyond(d, v, z, u)
        if not self._line:
            return self._rows(lambda part, *at: part.beyond(*at), d, v, z, u)
        return self._rows(lambda part, d, v, z, u: part.beyond(d, v, z, u) + part.line(d, v, 0.0, z), d, v, z, u)

    def inertance(self, d: Array) -> Array:
        """Returns the inertances minus the linearised inertances or, if `line` is True, the whole inertances [kg].

        The shape is (..., N, k).
        """
        least = 0.0 if self._line else 1.0
        return self._rows(lambda part, d, *_: part.inertance_at(d) - least * part.line.inertance, d, d, None, 0.0)

    def rate(self, d: Array, v: Array, z: Any, u: Any = 0.0) -> Array:
        """Returns the rates of the internal states; if `line` is not True, the linearised rates are subtracted.

        Arrays of deflections and velocities have the shape (..., N, k); arrays of states have the shape (..., N, k, n).
        """
        return self._rows(lambda part, *at: part.rate(*at) if self._line else part.rate_beyond(*at), d, v, z, u, z.shape)

    def _rows(self, of: Callable[..., Array], d: Array, v: Array, z: Any, u: Any, shape: tuple[int, ...] = ()) -> Array:
        """Evaluates a function of (part, d, v, z, u) for every group of parts, and returns the results of all parts."""
        if len(self._groups) == 1:
            return of(self._groups[0][0], d, v, z, u)
        total, at = np.empty(shape or np.shape(d)), (slice(None),) * (np.ndim(d) - 2)
        for part, rows in self._groups:
            own, inputs = None if z is None else z[*at, rows], u if np.ndim(u) == 0 else u[*at, rows]
            total[*at, rows] = of(part, d[*at, rows], v[*at, rows], own, inputs)
        return total


def choose_runs(part: Any, which: Array | slice) -> Any:
    """Returns a part for selected runs, from a part of N runs whose numbers may be arrays of shape (N,)."""
    if isinstance(which, slice):
        return part
    own = object.__new__(type(part))
    for one in fields(part):
        value = getattr(part, one.name)
        of_runs = isinstance(value, np.ndarray) and value.ndim
        vars(own)[one.name] = value[which] if of_runs else choose_runs(value, which) if isinstance(value, Part) else value
    return own


def alike(one: Part, other: Part) -> bool:
    """Returns True if two parts differ only in their numbers."""
    return merge_parts([one, other], (2,)) is not None


def merge_parts(parts: Sequence[Part], shape: tuple[int, ...]) -> Part | None:
    """Combines parts that differ only in their numbers into one part, whose numbers are arrays of the specified shape.

    Returns None if the parts differ in more than their numbers.
    """
    first = parts[0]
    if all(part is first for part in parts):
        return first
    if any(type(part) is not type(first) for part in parts):
        return None
    changed: dict[str, Any] = {}
    for one in fields(first):  # pyright: ignore[reportArgumentType]
        values = [getattr(part, one.name) for part in parts]
        if all(value is values[0] for value in values):
            continue
        if isinstance(values[0], Part):
            changed[one.name] = merge_parts(values, shape)
            if changed[one.name] is None:
                return None
        elif all(isinstance(value, float) for value in values):
            if any(value != values[0] for value in values):
                changed[one.name] = np.reshape(values, shape)
        elif (together := getattr(type(values[0]), "together", None)) is not None:
            if any(type(value) is not type(values[0]) for value in values):
                return None
            changed[one.name] = together(values, shape)
        elif any(bool(np.any(value != values[0])) for value in values):
            return None
    if not changed:
        return first
    # The object is created without `__post_init__`, because that method has already checked each part, and can only check
    # single numbers
    together = object.__new__(type(first))
    vars(together).update({one.name: changed.get(one.name, getattr(first, one.name)) for one in fields(first)})  # pyright: ignore[reportArgumentType]
    return together
