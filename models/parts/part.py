"""A part of a suspension: a force between body and wheel, and all that the project asks of one.

A part pulls the ends of its suspension together with F(d, v, z, u): d is the extension from rest and v its rate, both positive
where the suspension stretches; z are states of the part's own, and u its inputs. Linear analysis has its line at rest,

    F = k d + c v + b v' + C z + g u,    z' = A z + (rows for d, v and u),

and everything that runs the vehicle adds what is beyond that line. A new part is a class in a file of this folder, a force
element of `[parts]` in a file of `elements`, and a line in `EXTENSIONS` of `models.common.extensions`.
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

Number = float | Array  # an array of shape (N,) for N runs side by side
Quantity = Literal["deflection", "velocity", "force"]
POINTS = 401  # of a drawn curve, rest among them
STEP = 1e-200  # of a complex step, whose derivative is exact to rounding
SMALL, KINKED = 1e-6, 1e-3  # m or m/s, a motion about rest; share of the force beyond the line there, of a force with a kink
CURVE, BUMP_STOP = "curve", "bump stop"  # ends of the linear regime


@dataclass(frozen=True, eq=False)
class Line:
    """Line of a part with n states at rest, for linear analysis.

    pull = k d + c v + b v' + C z + g u, and the rates of its states.

    Attributes:
        stiffness: k [N/m].
        damping: c [N s/m].
        gain: g, force per unit of the input; 0 without one.
        of_preload: part of k by a preload at a motion ratio over travel [N/m].
        inertance: b [kg].
        of_states: C, shape (..., n); None for a part without states.
        rates: gains from (z, d, v, u) to the rates z', shape (..., n, n + 3); None for a part without states.
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
        """True if it pulls without an input."""
        return self.of_states is not None or bool(self.stiffness or self.damping or self.inertance)

    def __call__(self, d: Array, v: Array, u: Array | float = 0.0, z: Array | None = None) -> Array:
        """Returns the pull of the line without its inertance [N], shape (...); without states given, these are 0."""
        total: Any = None
        for slope, x in ((self.stiffness, d), (self.damping, v), (self.gain, u)):
            if not isinstance(slope, float) or slope:  # this runs in each stage of a step, and most lines have one slope alone
                total = slope * x if total is None else total + slope * x
        total = 0.0 if total is None else total
        return total if z is None or self.of_states is None else total + (self.of_states * z).sum(axis=-1)

    def rate(self, d: Array, v: Array, z: Array, u: Array | float = 0.0) -> Array:
        """Returns the rates of the states by the line, shape (..., n)."""
        assert self.rates is not None, "a part with states"
        return np.matvec(self.rates, np.concatenate([z, np.stack(np.broadcast_arrays(d, v, u), axis=-1)], axis=-1))


@dataclass(frozen=True)
class Limit:
    """Limit at which a part ends the linear regime.

    Attributes:
        end: name of the end, as in `sim.drive.regime`.
        of: quantity with the limit: deflection or velocity of the suspension, or force beyond the line.
        sign: sign of the side with the limit; 0 for both.
        value: limit of that side, or of the magnitude [m, m/s or N].
    """

    end: str
    of: Quantity
    sign: float
    value: float


class Part(ABC):
    """Force along a suspension. Arrays have any shape (...); states and inputs are on a last axis of their own.

    A part is a frozen dataclass. Its numbers may be arrays of shape (N,), for N runs side by side (`stacked`).
    """

    states: ClassVar[tuple["Signal", ...]] = ()  # its own states, 0 at rest; the vehicle's signals have element and corner, too
    inputs: ClassVar[int] = 0
    settable: ClassVar[tuple[Number, Number] | None] = None  # least and largest input that a controller sets; None without
    replaces: ClassVar[tuple[str, "Argument"] | None] = None  # the suspension's parameter that a curve of `[curves]` replaces
    reach: ClassVar[float] = np.inf  # largest argument that it is made for, either way [m/s or m]
    contact: ClassVar[bool] = False  # True for a force without effect before an end of the linear regime: no reference has it
    stores: ClassVar[bool] = False  # True for a part that stores all energy and loses none
    argument: ClassVar[Quantity | None] = None  # of the force, if it depends on one alone
    fastest: ClassVar[float] = 0.0  # largest rate of its own states at 2 m/s [1/s], if it grows with the velocity
    native: ClassVar[bool] = False  # True if `write` has a form native to MuJoCo for what is beyond the line

    @abstractmethod
    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """Returns the force that pulls body and wheel together [N], shape (...).

        Args:
            d, v: extension of the suspension [m] and its rate [m/s], shape (...).
            z: n states of its own, shape (..., n).
            u: input, shape (...).
        """

    def rate(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """Returns the rates of its states, shape (..., n). Arguments as for `pull`."""
        return np.zeros((*np.shape(d), 0))

    def divisor(self, u: Array | float) -> Any:
        """Returns a positive number, linear in the input, by which `pull` times the number is a parabola in the input."""
        return 1.0

    def stored(self, d: Array, z: Any = None) -> Array:
        """Returns the stored energy [J], shape (...)."""
        return np.zeros(np.shape(d))

    def inertance_at(self, d: Array) -> Number:
        """Returns b of a further force b v' [kg], shape () or (...); the kinetic energy of the part is b v^2 / 2."""
        return 0.0

    def centrifugal(self, d: Array, v: Array) -> Array | float:
        """Returns the part of `pull` because b changes with travel, (db/dd) v^2 / 2 [N], shape (...)."""
        return 0.0

    @cached_property
    def line(self) -> Line:
        """Derivative at rest, by complex steps."""
        step, at = np.array(STEP * 1j), np.array(0j)
        along = ((step, at, at), (at, step, at), (at, at, step))[: 2 + self.inputs]
        n, inertance = len(self.states), self.inertance_at(np.zeros(()))
        slopes: Any = (np.imag(self.pull(d, v, np.zeros(n), u)) / STEP for d, v, u in along)
        if not n:
            return Line(*slopes, inertance=inertance)
        rows = STEP * 1j * np.eye(n + 3)  # over (z, d, v, u)
        pulls = [np.imag(self.pull(at, at, row[:n], at)) / STEP for row in rows[:n]]
        rates = [np.imag(self.rate(row[n], row[n + 1], row[:n], row[n + 2])) / STEP for row in rows]
        return Line(*slopes, inertance=inertance, of_states=np.stack(pulls, axis=-1), rates=np.stack(rates, axis=-1))

    def beyond(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """Returns the force beyond the line, without that of an inertance [N], shape (...). Arguments as for `pull`."""
        return self.pull(d, v, z, u) - self.line(d, v, u, z)

    def rate_beyond(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        """Returns the rates of its states beyond those of the line, shape (..., n). Arguments as for `pull`."""
        return self.rate(d, v, z, u) - self.line.rate(d, v, z, u)

    def stored_beyond(self, d: Array, z: Any = None) -> Array:
        """Returns the stored energy without that of the line [J], shape (...)."""
        return self.stored(d, z) - self.line.stiffness * np.square(d) / 2

    @property
    def is_nonlinear(self) -> bool:
        """False if the force is that of its line everywhere."""
        return True

    @property
    def range(self) -> float:
        """The largest force that it is made for, either way [N]; infinite if this is unknown."""
        return np.inf if self.curve is None else self.curve.range

    @property
    def acts(self) -> bool:
        """False if nothing is beyond the line."""
        return self.is_nonlinear or bool(self.inputs)

    @property
    def kinked_at_rest(self) -> bool:
        """True if no motion is small enough for the line."""
        d, v = SMALL * np.array([[1, -1, 0, 0], [0, 0, 1, -1]])
        at = d, v, np.zeros((4, len(self.states)))
        bent = bool(np.any(np.abs(self.beyond(*at)) > KINKED * np.abs(self.pull(*at))))
        return bent or (bool(self.states) and bool(np.any(np.abs(self.rate_beyond(*at)) > KINKED * np.abs(self.rate(*at)))))

    def limits(self) -> Sequence[Limit]:
        """Returns what ends the linear regime: a force beyond the line of `LEAVES` of its largest one."""
        return (Limit(CURVE, "force", 0.0, LEAVES * self.range),) if self.is_nonlinear and np.isfinite(self.range) else ()

    @cached_property
    def curve(self) -> "ForceCurve | None":
        """The force over its only argument, at `POINTS` up to `reach`; None if it depends on more, or has no reach."""
        if self.argument is None or not np.isfinite(self.reach):
            return None

        x, line = np.linspace(-self.reach, self.reach, POINTS), self.line
        force = self.pull(*((0 * x, x) if self.argument == "velocity" else (x, 0 * x)))
        slope = line.damping if self.argument == "velocity" else line.stiffness
        return FEATURES.load("curves").ForceCurve(x, force, float(slope), self.words)

    def own_motion(self, d: Array, v: Array) -> tuple[Array, Array]:
        """Returns travel [m] and velocity [m/s] between the part's own ends, shapes (...), from those at the wheel."""
        return d, v

    def at_wheel(self, ratio: float) -> "Part | None":
        """Returns the part that acts so at the wheel, through a constant motion ratio; None for an `AtRatio` of the part."""
        return self if ratio == 1 else None

    def write(self, tendon: "Tendon") -> None:
        """Writes what is beyond the line into an MjSpec, in a form native to MuJoCo."""
        raise NotImplementedError(f"{type(self).__name__} has no form native to MuJoCo")

    def write_input(self, tendon: "Tendon", by_motor: bool) -> None:
        """Writes what the actuator of its input does in an MjSpec.

        Args:
            by_motor: True if a motor pulls with what is beyond the line.
        """
        return  # most parts have no input

    @property
    def words(self) -> str:
        """The part in a phrase."""
        return type(self).__name__

    @classmethod
    def of(cls, vehicle: Any, place: "Suspension") -> Iterator[tuple["Part", str]]:
        """Yields the parts of a suspension that follow from other sections than `[parts]`, in their own travel.

        Each is with the parameter that is its line, or with an empty text.
        """
        yield from ()


@dataclass(frozen=True, eq=False)
class SuspensionPart:
    """Part at its place in a vehicle.

    Attributes:
        place: the suspension.
        part: the part at the wheel.
        parameter: parameter of the vehicle that is the part's line; empty for an element without one.
        ratio: motion ratio at rest.
        element: name of its section of `[parts]`; empty for a part of another section.
    """

    place: "Suspension"
    part: Part
    parameter: str
    ratio: float
    element: str = ""

    @property
    def name(self) -> str:
        """Its parameter, or the name of its section of `[parts]`."""
        return self.parameter or self.element

    @property
    def deflection(self) -> str:
        """Signal of the suspension."""
        return self.place.deflection

    @property
    def tendon(self) -> str:
        """Name of the suspension's tendon in the MJCF."""
        return self.place.tendon

    @cached_property
    def added_line(self) -> Line:
        """Its line beyond the vehicle's own springs and dampers, which have that of a parameter."""
        return Line() if self.parameter else self.part.line

    @cached_property
    def states(self) -> "tuple[Signal, ...]":
        """Signals of its own states."""
        return state_signals(self.part, self.element, self.place)

    @property
    def native(self) -> bool:
        """True if MuJoCo has a form of all that is beyond the vehicle's own springs and dampers."""
        return self.part.native and not self.added_line.sloped

    @property
    def acts(self) -> bool:
        """True if something is beyond the vehicle's own springs and dampers."""
        return self.part.acts or self.added_line.sloped

    @property
    def damps(self) -> bool:
        """True if the curve of the part is over velocity."""
        return self.part.argument != "deflection"

    @property
    def argument(self) -> str:
        """Name of the signal on which the curve of the part depends."""
        return self.place.velocity.name if self.damps else self.place.deflection

    @property
    def curve(self) -> "ForceCurve":
        """The curve of a part that has one."""
        assert self.part.curve is not None, "a part with a curve"
        return self.part.curve

    @property
    def surface(self) -> "ForceSurface | None":
        """The curve of a damper over velocity and deflection; None if it depends on one of them."""

        curve: Any = self.part.curve
        return curve if isinstance(curve, FEATURES.load("surfaces").ForceSurface) else None


def state_signals(part: Part, element: str, place: "Suspension") -> "tuple[Signal, ...]":
    """Returns the signals of a part's own states, as an element of a suspension."""
    signals = (
        replace(one, name=f"{element}_{one.name}", symbol=f"{one.symbol} {element}", meaning=f"{one.meaning}, {element}")
        for one in part.states
    )
    return tuple(one.at(place.corner) if place.corner else one for one in signals)


@dataclass(frozen=True)
class SettablePart(Part):
    """Damper whose coefficient a valve sets: its input is the coefficient beyond the nominal one [N s/m].

    Attributes:
        force: the input that it replaces, its force beyond the nominal damper's.
        ending: suffix of the names at its suspension.
        damper: limits of the coefficient.
        nominal: coefficient of the linear model [N s/m].
        ratio: motion ratio at rest. All other numbers, forces and velocities are the damper's own, not those at the wheel, but
            for those of `Part`.
        nominal_curve: curve of the nominal damper with the curve parallel to it; None if both are straight.
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
        """The signal of the acting coefficient."""
        return f"damping{self.ending}"

    @property
    def missing(self) -> str:
        """The signal of the requested force that it does not give."""
        return f"missing_force{self.ending}"

    @property
    def low(self) -> float:
        """The least coefficient beyond the nominal one [N s/m]."""
        return self.damper.c_min - self.nominal

    @property
    def high(self) -> float:
        """The largest coefficient beyond the nominal one [N s/m]."""
        return self.damper.c_max - self.nominal

    @property
    def slopes(self) -> tuple[float, float]:
        """The least and the steepest slope beyond the nominal one [N s/m]."""
        return self.low, self.steepest_slope - self.nominal

    @property
    def steepest_slope(self) -> float:
        """The steepest slope of the damper at any setting [N s/m], without a curve that acts in parallel."""
        pair = self.damper.pair
        return self.damper.c_max if pair is None else float(max(pair.soft.slopes.max(), pair.hard.slopes.max()))

    def shape(self, v: Array) -> Array:
        """Returns the force per coefficient, h [m/s], at velocities of the damper's own [m/s], shape (...)."""
        return np.asarray(v) if self.damper.pair is None else self.damper.pair.shape(v)

    def force_at(self, v: Array, beyond: Array | float) -> Array:
        """Returns the force at velocities of the damper's own and coefficients beyond the nominal one [N], shape (...)."""
        still = self.nominal * np.asarray(v) if self.nominal_curve is None else self.nominal_curve(v)
        return still + beyond * self.shape(v)


class Parts(tuple[SuspensionPart, ...]):
    """Parts of a vehicle, suspension by suspension."""

    @cached_property
    def with_curve(self) -> tuple[SuspensionPart, ...]:
        """Parts with a curve."""
        return tuple(one for one in self if one.part.curve is not None)

    @cached_property
    def nonlinear(self) -> bool:
        """True if a force differs from its line before a contact."""
        return any(one.part.is_nonlinear and not one.part.contact for one in self)

    @cached_property
    def adjustable(self) -> tuple[SettablePart, ...]:
        """Adjustable dampers, each with its motion ratio at rest."""
        own = ((getattr(one.part, "part", one.part), one.ratio) for one in self)
        return tuple(replace(part, ratio=ratio) for part, ratio in own if isinstance(part, SettablePart))

    @cached_property
    def strokes(self) -> Mapping[str, Mapping[str, float]]:
        """Travel from rest to every bump stop at the wheel [m], by deflection and by side, `bump` or `rebound`."""
        strokes = dict[str, dict[str, float]]()
        for one in self:
            for limit in one.part.limits() if one.part.contact else ():
                if limit.end == BUMP_STOP:
                    strokes.setdefault(one.deflection, {})[SIDES[limit.sign > 0]] = limit.value
        return strokes


@dataclass(frozen=True)
class Straight(Part):
    """Line of another part, with signals of that part's own states."""

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
    """Parts of N runs at k suspensions, evaluated together where they differ in numbers alone."""

    def __init__(self, parts: Sequence[Sequence[Part]], line: bool = False) -> None:
        """Takes k parts for each run, which differ in numbers alone, or of one run for any number of runs.

        Args:
            line: True adds the line's force without that of the input to what is beyond it.
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
        """See `Part.beyond`, for arrays of shape (..., N, k)."""
        if len(self._groups) == 1 and not self._line:  # in each stage of a step
            return self._groups[0][0].beyond(d, v, z, u)
        if not self._line:
            return self._rows(lambda part, *at: part.beyond(*at), d, v, z, u)
        return self._rows(lambda part, d, v, z, u: part.beyond(d, v, z, u) + part.line(d, v, 0.0, z), d, v, z, u)

    def inertance(self, d: Array) -> Array:
        """Returns the inertances beyond the line, or with those of the line [kg], shape (..., N, k)."""
        least = 0.0 if self._line else 1.0
        return self._rows(lambda part, d, *_: part.inertance_at(d) - least * part.line.inertance, d, d, None, 0.0)

    def rate(self, d: Array, v: Array, z: Any, u: Any = 0.0) -> Array:
        """Returns the rates of states, beyond the line unless it is added, for arrays (..., N, k) and states (..., N, k, n)."""
        return self._rows(lambda part, *at: part.rate(*at) if self._line else part.rate_beyond(*at), d, v, z, u, z.shape)

    def _rows(self, of: Callable[..., Array], d: Array, v: Array, z: Any, u: Any, shape: tuple[int, ...] = ()) -> Array:
        """Returns a function of part, d, v, z and u for the rows of each group."""
        if len(self._groups) == 1:
            return of(self._groups[0][0], d, v, z, u)
        total, at = np.empty(shape or np.shape(d)), (slice(None),) * (np.ndim(d) - 2)
        for part, rows in self._groups:
            own, inputs = None if z is None else z[*at, rows], u if np.ndim(u) == 0 else u[*at, rows]
            total[*at, rows] = of(part, d[*at, rows], v[*at, rows], own, inputs)
        return total


def choose_runs(part: Any, which: Array | slice) -> Any:
    """Returns a part of N runs for some of these, from a part whose numbers may be arrays of shape (N,)."""
    if isinstance(which, slice):
        return part
    own = object.__new__(type(part))
    for one in fields(part):
        value = getattr(part, one.name)
        of_runs = isinstance(value, np.ndarray) and value.ndim
        vars(own)[one.name] = value[which] if of_runs else choose_runs(value, which) if isinstance(value, Part) else value
    return own


def alike(one: Part, other: Part) -> bool:
    """Returns True for parts that differ in numbers alone."""
    return merge_parts([one, other], (2,)) is not None


def merge_parts(parts: Sequence[Part], shape: tuple[int, ...]) -> Part | None:
    """Returns parts that differ in numbers alone as one, whose numbers are arrays of a shape; None if they differ in more."""
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
    together = object.__new__(type(first))  # without `__post_init__`, whose rules hold for each and read single numbers
    vars(together).update({one.name: changed.get(one.name, getattr(first, one.name)) for one in fields(first)})  # pyright: ignore[reportArgumentType]
    return together
