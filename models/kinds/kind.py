"""Interface of a kind of vehicle, which `models/<name>.py` must provide, its parameters included."""

import pickle
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, SupportsIndex

import numpy as np

from models.common.checks import AT_LEAST_ONE, CheckedFields, Must, Name, Positive, is_finite
from models.common.errors import InputError, alike
from models.common.schema import LARGEST, SI, SMALLEST
from models.kinds.linear_model import LinearModel
from models.kinds.signals import (
    CONTROL_FORCE,
    SUSPENSION_DEFLECTION,
    SUSPENSION_VELOCITY,
    TYRE_DEFLECTION,
    UNSPRUNG_ACCELERATION,
    UNSPRUNG_VELOCITY,
    Signal,
    names_of,
)

if TYPE_CHECKING:
    from models.kinds.motion import Motion


@dataclass(frozen=True)
class Variation(CheckedFields):
    """Range of a parameter over vehicles of a kind, relative to the one that a controller was designed for.

    Attributes:
        name: the varying quantity, as text. Parameters with the same variation vary together.
        smallest, largest: factors on the parameter, at most 1 and at least 1.

    Raises:
        InputError: the factors are no such range.
    """

    name: str
    smallest: Positive
    largest: Positive

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (0 < self.smallest <= 1 <= self.largest <= LARGEST and self.smallest < self.largest):
            raise InputError(
                f"{self.name} varies by factors from {self.smallest:g} to {self.largest:g}; give one above 0 and at most 1, and "
                "a larger one that is at least 1"
            )

    def __str__(self) -> str:
        low, high = (100 * (factor - 1) for factor in (self.smallest, self.largest))
        return f"{self.name} {low:+.4g} to {high:+.4g} %"


@dataclass(frozen=True)
class Parameter(CheckedFields):
    """Number of a vehicle file.

    Attributes:
        name: key under `[parameters]`.
        unit: SI unit.
        meaning: description in one line.
        positive: True if zero is refused too. Infinite, NaN and absurdly large values always are.
        varied: accepted from vehicle types that were written for earlier versions, and without effect.
        largest: largest allowed value.
        usual: default value; None for a parameter without one.
        smallest: smallest allowed value; None for 0, or the least positive one.
        optional: True if a vehicle file may omit it, which is not the same as any value.
    """

    name: str
    unit: str
    meaning: str
    positive: bool = True
    varied: Variation | None = None
    largest: Positive = LARGEST
    usual: float | None = None
    smallest: float | None = None
    optional: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.usual is not None:
            self.check(self.usual)

    def check(self, value: Any) -> float:
        """Returns the value as a float.

        Raises:
            InputError: the value is not a number of the allowed range.
        """
        return self.number.number(self.name, value)

    @property
    def number(self) -> SI:
        """Unit, meaning and range, as those of a key of a section."""
        least = self.smallest if self.smallest is not None else SMALLEST if self.positive else 0.0
        return SI(self.unit, self.meaning, least, self.largest)


def motion_ratio(name: str) -> Parameter:
    """Returns the parameter of the motion ratio of an axle, or of the only suspension."""
    meaning = "r, travel of spring, damper, bump stop and actuator per wheel travel; 1 if they are at the wheel"
    return Parameter(name, "1", meaning, smallest=0.05, largest=5.0, optional=True)


def is_number(value: Any) -> bool:
    """Returns True if the value is a number that a vehicle file may hold."""
    return is_finite(value) and abs(value) <= LARGEST


HERE = Path(__file__).parent.parent  # folder of the shipped kinds
GRAVITY = 9.81  # m/s2, written into every MJCF
MOST_SQUEEZE = 0.25  # m; no tyre survives more
LOWEST_HUB = 0.26  # m above the road at rest, at least; above MOST_SQUEEZE, which a tyre may exceed before a time step ends
MOST_KEPT = 16  # linear models of a kind that are kept: a study asks for one vehicle again and again

SEAT_POINTS = {
    "seat": "a seat has a section of its own: write [seat] with mass, stiffness and damping"
}  # of built-in kinds, `lacking`
NEGLIGIBLE_ACCELERATION = 1e-12  # of the largest acceleration by a force: less is rounding

Side = Annotated[str, Must("'left', 'right', or '' where there is only one track", lambda value: value in ("", "left", "right"))]
Parameters = Mapping[str, float]


# The usual functions of a kind have names: pickle finds no function without one.
def nowhere_else(p: Parameters) -> float:
    """Returns 0 m: the wheel is at the first one, or in the vehicle's middle."""
    return 0.0


def nothing(*_: Any) -> Any:
    """Returns no loads, no angles and no objections."""
    return {}


@dataclass(frozen=True)
class Wheel(CheckedFields):
    """Point where a road acts on the vehicle.

    Attributes:
        road_body: MJCF mocap body that carries the road under this wheel.
        road_displacement: signal of the road's height under it.
        road_velocity: signal of the road's vertical velocity under it, a disturbance of the linear model.
        tyre_deflection: signal of its tyre.
        behind: parameters -> distance behind the first wheel [m].
        side: the track it runs in, "left" or "right"; empty if the vehicle has only one.
        lateral: parameters -> distance to the left of the vehicle's middle [m].
    """

    road_body: Name
    road_displacement: Name
    road_velocity: Name
    tyre_deflection: Name
    behind: Callable[[Parameters], float] = nowhere_else
    side: Side = ""
    lateral: Callable[[Parameters], float] = nowhere_else


@dataclass(frozen=True)
class DampedTyre:
    """Tyre whose force is that of its equivalent deflection t + (c / k) (z_u' - z_r') on its stiffness k, with its damping c.

    Attributes:
        hub, road: signals of the velocities z_u' and z_r'.
        time: c / k [s].
    """

    hub: str
    road: str
    time: float


@dataclass(frozen=True)
class Suspension(CheckedFields):
    """Suspension of the body on a wheel.

    Attributes:
        deflection: signal of its extension.
        tendon: name of the MJCF tendon; the bump stop is parallel to it.
        force: input that pushes along it; empty for a passive one.
        stiffness, damping: parameters of its spring and its damper, which curves can replace; empty if it has no such part.
        ratio: parameter of its motion ratio, travel of all its elements per wheel travel; empty for elements at the wheel. The
            equations of the kind are for elements at the wheel: `VehicleKind.at_wheels` converts.
    """

    deflection: Name
    tendon: Name
    force: str = ""
    stiffness: str = ""
    damping: str = ""
    ratio: str = ""

    def motion_ratio(self, parameters: Parameters) -> float:
        """Returns its motion ratio."""
        return parameters.get(self.ratio, 1.0)

    @property
    def ending(self) -> str:
        """Suffix of the names at its corner."""
        return self.deflection.removeprefix(SUSPENSION_DEFLECTION.name)

    @property
    def corner(self) -> str:
        """Name of its corner; empty for a single suspension."""
        return self.ending.removeprefix("_")

    @property
    def velocity(self) -> Signal:
        """The signal of its extension rate."""
        common = self.deflection.startswith(SUSPENSION_DEFLECTION.name)
        corner = self.corner if common else self.deflection
        return SUSPENSION_VELOCITY.at(corner) if corner else SUSPENSION_VELOCITY


@dataclass(frozen=True)
class BodyLoad(CheckedFields):
    """Direction in which an external load acts on the body.

    Attributes:
        name: name of the linear model's load: `heave_load` [N], `pitch_load` or `roll_load` [N m], or `wheel_load_...` [N].
        joint: MJCF slide or hinge along which it acts, in the load's direction.
    """

    name: str
    joint: str


@dataclass(frozen=True)
class Invariant(CheckedFields):
    """Transmissibility, from the road's displacement under every wheel, that no suspension force can change.

    Attributes:
        name: name of the quantity, as in "z_s/z_r".
        signals: signals whose sum is the quantity.
        omega: parameters -> frequency [rad/s].
        magnitude: parameters -> the transmissibility there, above 0.
    """

    name: str
    signals: tuple[str, ...]
    omega: Callable[[Parameters], float]
    magnitude: Callable[[Parameters], float]


@dataclass(frozen=True)
class RidePoints:
    """Vertical accelerations at which the ride is measured, by signal.

    Attributes:
        people: points with a person, named by the vehicle type or else the masses above the body; empty without any.
        others: other points of the body.
        named: True if the vehicle type names its points with a person.
    """

    people: tuple[str, ...]
    others: tuple[str, ...]
    named: bool

    @property
    def all(self) -> tuple[str, ...]:
        """Every point, those with a person first."""
        return (*self.people, *self.others)

    @property
    def worst_of(self) -> tuple[str, ...]:
        """Points whose largest value is the ride of the vehicle: those with a person, or all without any."""
        return self.people or self.others


@dataclass(frozen=True)
class VehicleKind(CheckedFields):
    """Equations of a vehicle type. Every function takes the parameters as a mapping from name to SI value.

    Attributes:
        name: `type` in a vehicle file, and the stem of the `.py`, `.xml` and `.toml` files.
        parameters: all parameters of a vehicle file.
        signals: signals of every vehicle of the kind: outputs of the linear model and, by the same names, sensors of the MJCF.
        wheels: wheels in the order of the linear model's disturbances.
        linear_model: parameters -> LinearModel, of all signals, those on demand too; a vehicle's own is `model`.
        static_tyre_deflection: parameters -> compression of each tyre at rest [m], by tyre deflection signal. The wheel is off
            the ground if its tyre deflection, or the equivalent one of a damping tyre (`DampedTyre`), exceeds it.
        write_mjcf: function that writes the parameters into an `MjSpec` of the kind's `.xml`, without an import of MuJoCo.
        folder: folder of its `.xml`.
        check_together: function that raises InputError if valid single parameters are not a vehicle together.
        combined: signals without a sensor that are sums of others, as {name: {other signal: factor}}.
        suspended: suspensions of the kind. None: one for every signal `suspension_deflection...`, with the tendon `suspension...`
            and, if present, the force `control_force...` of the same suffix.
        invariants: transmissibilities that no suspension force can change.
        on_demand: signals that a vehicle has only if its file names them: outputs and sensors like the others, without cost if
            they are not named.
        loads: external loads on its body, in the order of the linear model's loads; those on wheels follow in a vehicle that has
            some.
        wheel_loads: parameters -> loads on its wheels by links and by the wheels' own mass, if its vehicle file has these.
        carried: (parameters, way, force on the body [N], acceleration of the wheels [m/s2]) -> loads that links and the wheels'
            own mass add to the force's moment on the body. The way is `roll_load`, of a force to the right, or `pitch_load`, of
            one forwards.
        angles: parameters -> the body's angles over level ground [rad] as sums of signals, {"pitch_angle": {signal: factor}},
            `roll_angle` likewise.
        motion: parameters -> the exact equations of its motion, independent of the MJCF; None if there are none; physics is then
            compared with the linear model alone.
        static_loads: parameters -> the body's weight on each suspension [N], by deflection; empty if it is not known.
        ratios: `models.characteristics.ratio_table.RatioTable` of each motion ratio that changes with travel, by parameter; only
            in the kind of a vehicle that has some.
        people: accelerations [m/s2] of the points with a person, the most important one first. None: those of masses above the
            body, if it has some; empty for none.
        of_parts: signals of the own states of force elements, without sensors, among the signals; only in the kind of a vehicle
            that has some.
        lacking: parameters that users may expect but the kind cannot have, as {beginning of the name: reason}.
    """

    name: str
    parameters: tuple[Parameter, ...]
    signals: Annotated[tuple[Signal, ...], AT_LEAST_ONE]
    wheels: Annotated[tuple[Wheel, ...], AT_LEAST_ONE]
    linear_model: Callable[[Parameters], LinearModel]
    static_tyre_deflection: Callable[[Parameters], Mapping[str, float]]
    write_mjcf: Callable[[Any, Parameters], None]
    folder: Path = HERE
    check_together: Callable[[Parameters], None] = nothing
    combined: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    suspended: tuple[Suspension, ...] | None = None
    invariants: tuple[Invariant, ...] = ()
    on_demand: tuple[Signal, ...] = ()
    loads: tuple[BodyLoad, ...] = ()
    wheel_loads: Callable[[Parameters], tuple[BodyLoad, ...]] = nothing
    carried: Callable[[Parameters, str, float, float], Mapping[str, float]] = nothing
    angles: Callable[[Parameters], Mapping[str, Mapping[str, float]]] = nothing
    motion: Callable[[Parameters], "Motion"] | None = None
    static_loads: Callable[[Parameters], Mapping[str, float]] = nothing
    ratios: Mapping[str, Any] = field(default_factory=dict)
    people: tuple[str, ...] | None = None
    lacking: Mapping[str, str] = field(default_factory=dict)
    of_parts: tuple[Signal, ...] = ()

    def __repr__(self) -> str:
        """Returns its name and how much it has."""
        return (
            f"VehicleKind {self.name}: {len(self.parameters)} parameters, {len(self.signals)} signals, {len(self.wheels)} wheels"
        )

    def __reduce_ex__(self, protocol: SupportsIndex) -> Any:
        if self.folder == HERE:
            return super().__reduce_ex__(protocol)
        import cloudpickle  # no module has the functions of a user's own kind

        return _from_pickle, (cloudpickle.dumps({part.name: getattr(self, part.name) for part in fields(self)}),)

    def __deepcopy__(self, memo: dict[int, Any]) -> "VehicleKind":
        return self  # it is frozen

    def naming(self, names: Collection[str]) -> "VehicleKind":
        """Returns the kind with those of the signals on demand that are named, after its other signals."""
        more = [*self.possible.values()][len(self.signals) :]
        named = tuple(signal for signal in more if signal.name in names)
        return replace(self, signals=(*self.signals, *named)) if named else self

    def with_states(self, of_parts: tuple[Signal, ...]) -> "VehicleKind":
        """Returns the kind with signals of the own states of force elements, instead of those that it has.

        Raises:
            InputError: another signal has the name of such a signal.
        """
        others = tuple(signal for signal in self.signals if signal not in self.of_parts)
        taken = [*names_of(others), *(name for name in self.possible if name not in names_of(self.signals))]
        for i, one in enumerate(names_of(of_parts)):
            if one in taken or one in names_of(of_parts)[:i]:
                raise InputError(
                    f"[parts] an element has the state {one!r}, which is the name of another signal; rename the section"
                )
        return self if of_parts == self.of_parts else replace(self, signals=(*others, *of_parts), of_parts=of_parts)

    @cached_property
    def possible(self) -> dict[str, Signal]:
        """All signals that a vehicle of the kind can have, by name: its own, those on demand, and suspension velocities."""
        velocities = (part.velocity for part in self.suspensions)
        return {one.name: one for one in (*self.signals, *self.on_demand, *velocities)}

    def with_wheel_loads(self, parameters: Parameters) -> "VehicleKind":
        """Returns the kind with loads on the wheels, if vehicles of these parameters have some."""
        loads = tuple(dict.fromkeys((*self.loads, *self.wheel_loads(parameters))))
        return self if loads == self.loads else replace(self, loads=loads)

    @cached_property
    def unnamed(self) -> tuple[str, ...]:
        """The signals on demand that its vehicles do not have."""
        known = set(self.signals)  # to compare signals one by one took longer than to compile a model
        return tuple(signal.name for signal in self.on_demand if signal not in known)

    def at_wheels(self, parameters: Parameters) -> Parameters:
        """Returns the parameters with the rates of springs and dampers at the wheel, k r^2 and c r^2 at a motion ratio r.

        A ratio that changes with travel turns the preload: of its springs that is part of the rate. The ratios are then 1, or
        are left out if they are tables.
        """
        given = [part for part in self.suspensions if part.ratio in parameters]
        parts = [part for part in given if parameters[part.ratio] != 1 or part.ratio in self.ratios] if given else []
        if not parts:
            return parameters
        rates = dict(parameters)
        for part in parts:
            for name in (part.stiffness, part.damping):
                if name in parameters:
                    rates[name] = parameters[name] * parameters[part.ratio] ** 2
        for name, rate in self._rates_of_preload(parameters).items():
            rates[name] += rate
        rates |= dict.fromkeys((part.ratio for part in parts), 1.0)
        return {name: rate for name, rate in rates.items() if name not in self.ratios}

    def table_of(self, place: Suspension) -> Any:
        """Returns the `RatioTable` of a suspension whose motion ratio changes with travel, or None."""
        table = self.ratios.get(place.ratio)
        return None if table is None or table.straight else table

    def _rates_of_preload(self, parameters: Parameters) -> dict[str, float]:
        """Returns what motion ratios over travel add to the wheel rates of springs by their preload [N/m], by parameter.

        Raises:
            InputError: the load of a spring is unknown, or springs of one parameter carry different ones.
        """
        rates, loads = dict[str, float](), self.static_loads(parameters) if self.ratios else {}
        for part in self.suspensions:
            if part.ratio not in self.ratios or part.stiffness not in parameters:
                continue
            if part.deflection not in loads:
                raise InputError(f"{part.ratio} changes with travel, but static_loads has no {part.deflection}; add its load")
            rate = -self.ratios[part.ratio].relative_slope * loads[part.deflection]
            if not np.isclose(rates.setdefault(part.stiffness, rate), rate, rtol=1e-9, atol=0):
                raise InputError(
                    f"springs of {part.stiffness} carry different loads, so {part.ratio} over travel gives them different "
                    "wheel rates; give each suspension its own parameter"
                )
        return rates

    def motion_ratios(self, parameters: Parameters, forces: Iterable[str]) -> dict[str, float]:
        """Returns the motion ratio of each force."""
        ratios = {part.force: part.motion_ratio(parameters) for part in self.suspensions}
        return {force: ratios.get(force, 1.0) for force in forces}

    def model(self, parameters: Parameters) -> LinearModel:
        """Returns the linear model with the signals of this kind's vehicles, which the last few vehicles keep."""
        key, kept = tuple(parameters.items()), self._models
        if key not in kept:
            model = self.full_model(parameters).of(names_of(self.signals))
            if len(kept) >= MOST_KEPT:
                kept.clear()
            kept[key] = model
        return kept[key]

    @cached_property
    def _models(self) -> dict[tuple[tuple[str, float], ...], LinearModel]:
        return {}

    def full_model(self, parameters: Parameters) -> LinearModel:
        """Returns the linear model with all possible signals, its elements at their motion ratios.

        These are also the signals on demand, and the suspensions' velocities that it lacks.
        """
        at_wheels = self.at_wheels(parameters)
        model = self.linear_model(at_wheels)
        if at_wheels is not parameters:
            model = model.geared(np.array([*self.motion_ratios(parameters, model.inputs).values()]))
        rates = dict[str, str]()
        for part in self.suspensions:
            name = part.velocity.name
            if name not in model.outputs and (model.has_rate(part.deflection) or part.velocity in self.signals):
                rates[name] = part.deflection
        return model.with_rates(rates)

    @cached_property
    def suspensions(self) -> tuple[Suspension, ...]:
        """The suspensions, from `suspended` or from the usual names."""
        if self.suspended is not None:
            return tuple(self.suspended)
        names, suspensions = names_of(self.signals), []
        for name in names:
            ending = name.removeprefix(SUSPENSION_DEFLECTION.name)
            if ending != name:
                force = f"{CONTROL_FORCE.name}{ending}"
                one = Suspension(
                    deflection=name,
                    tendon=f"suspension{ending}",
                    force=force if force in names else "",
                    stiffness=self.of_corner("suspension_stiffness", ending),
                    damping=self.of_corner("suspension_damping", ending),
                    ratio=self.of_corner("motion_ratio", ending),
                )
                suspensions.append(one)
        return tuple(suspensions)

    def of_corner(self, parameter: str, ending: str) -> str:
        """Returns the parameter at a corner, or of its axle, or of the whole vehicle; empty if the kind has no such parameter."""
        names = {known.name for known in self.parameters}
        while ending and f"{parameter}{ending}" not in names:
            ending = ending.rpartition("_")[0]
        return f"{parameter}{ending}" if f"{parameter}{ending}" in names else ""

    def invariants_of(self, parameters: Parameters) -> tuple[Invariant, ...]:
        """Returns the invariants of a vehicle: those of its kind, or none if a tyre damps.

        With c s + k instead of k the whole mass no longer rests on the tyre at any frequency: m_u s^2 + c s + k is nowhere zero.
        """
        return () if self.damped_tyres(parameters) else self.invariants

    def damped_tyres(self, parameters: Parameters) -> "Mapping[str, DampedTyre]":
        """Returns the tyres that damp, by their deflection signals; none of a user's own kind."""
        tyres = {}
        for wheel in self.wheels if self.folder == HERE else ():
            ending = wheel.tyre_deflection.removeprefix(TYRE_DEFLECTION.name)
            c, k = (parameters.get(self.of_corner(part, ending), 0.0) for part in ("tyre_damping", "tyre_stiffness"))
            if c:
                tyres[wheel.tyre_deflection] = DampedTyre(f"{UNSPRUNG_VELOCITY.name}{ending}", wheel.road_velocity, c / k)
        return tyres

    def deflection_of(self, force: str) -> str:
        """Returns the suspension deflection along which a force acts; empty if it does not belong to a suspension."""
        return next((part.deflection for part in self.suspensions if part.force == force), "")

    @property
    def corners(self) -> dict[str, str]:
        """Suffix of the names at a suspension, by its force."""
        return {part.force: part.ending for part in self.suspensions if part.force}

    @property
    def mjcf(self) -> Path:
        """Path of the kind's MJCF."""
        return self.folder / f"{self.name}.xml"

    def check_each(self, parameters: Mapping[str, Any]) -> dict[str, float]:
        """Returns all parameters, each checked by itself, in the kind's order.

        Raises:
            InputError: a parameter is missing, unknown or not allowed.
        """
        names = [parameter.name for parameter in self.parameters]
        for name in parameters:
            if name not in names:
                why = "".join(f" ({said})" for beginning, said in self.lacking.items() if name.startswith(beginning))
                raise InputError(f"unknown parameter {name!r}; a {self.name} has {alike(name, names)}{why}")
        checked = dict[str, float]()
        for one in self.parameters:
            if one.name in parameters:
                checked[one.name] = one.check(parameters[one.name])
            elif one.usual is not None:
                checked[one.name] = float(one.usual)
            elif not one.optional:
                raise InputError(f"parameter {one.name!r} [{one.unit}] is missing: {one.meaning}")
        return checked

    def check(self, parameters: Mapping[str, Any]) -> dict[str, float]:
        """Returns all parameters, checked, in the kind's order.

        Raises:
            InputError: errors of `check_each`, or parameters that are not a vehicle together, or leave a tyre at rest
                fully compressed or off the road.
        """
        checked = self.check_each(parameters)
        at_wheels = self.at_wheels(checked)
        for part in self.suspensions if self.ratios else ():
            if at_wheels.get(part.stiffness, 0.0) < 0:
                raise InputError(
                    f"{part.ratio} changes so fast with travel that the preload makes the spring's wheel rate "
                    f"{at_wheels[part.stiffness]:.4g} N/m; give a stiffer spring, or a ratio that changes less with travel"
                )
        self.check_together(at_wheels)
        for tyre, squeeze in self.static_tyre_deflection(checked).items():
            if squeeze <= 0:
                raise InputError(f"{tyre}: this wheel is off the road at rest; move the masses that stand outside of the wheels")
            if squeeze > MOST_SQUEEZE:
                raise InputError(
                    f"{tyre} at rest is {squeeze:.3g} m, the masses' weight over the tyre's stiffness; at most {MOST_SQUEEZE} m "
                    "is allowed: check that masses are in kg and stiffness in N/m; lower the masses or raise the stiffness"
                )
        return checked

    def ride_points(self, model: LinearModel) -> RidePoints:
        """Returns the points of a vehicle with this linear model at which the ride is measured.

        A mass is above the body if no force acts on it directly that also acts on a wheel.
        """
        units = {signal.name: signal.unit for signal in self.signals}
        names = [one for one in model.outputs if units[one] == "m/s2" and not one.startswith(UNSPRUNG_ACCELERATION.name)]
        tyres = [model.outputs.index(wheel.tyre_deflection) for wheel in self.wheels]
        on_wheels = np.any(np.abs(model.C[tyres] @ model.A @ model.B) > 0, axis=0)
        gains = np.abs(model.D[[model.outputs.index(name) for name in names]][:, on_wheels]).max(axis=1, initial=0.0)
        above = gains <= NEGLIGIBLE_ACCELERATION * gains.max(initial=0.0) if gains.any() else np.zeros(len(names), dtype=bool)
        people = self.people if self.people is not None else tuple(np.array(names)[above].tolist())
        return RidePoints(people, tuple(name for name in names if name not in people), self.people is not None)

    def signal(self, name: str) -> Signal:
        """Returns the signal of that name, which this kind has."""
        return next(signal for signal in self.signals if signal.name == name)


def _from_pickle(content: bytes) -> VehicleKind:
    """Returns a kind of a user's own from its pickled fields."""
    return VehicleKind(**pickle.loads(content))
