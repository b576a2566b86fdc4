"""Interface of a vehicle type, including its parameters. Each file `models/<name>.py` provides one vehicle type."""

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
    """Obsolete range of a parameter, which has no effect; vehicle types written for earlier versions may still contain one.

    Attributes:
        name: name of the varied quantity.
        smallest: smallest factor by which the parameter is multiplied.
        largest: largest factor by which the parameter is multiplied.

    Raises:
        InputError: a factor is not above 0.
    """

    name: str
    smallest: Positive
    largest: Positive


@dataclass(frozen=True)
class Parameter(CheckedFields):
    """Parameter of a vehicle type: a number in a vehicle file.

    Attributes:
        name: key in `[parameters]`.
        unit: SI unit of the number.
        meaning: description of the parameter in one line.
        positive: True if the value 0 is not allowed. Infinite, NaN and extremely large values are never allowed.
        varied: argument without effect, which vehicle types written for earlier versions may still contain.
        largest: largest allowed value.
        usual: default value; None for a parameter without a default.
        smallest: smallest allowed value; None means 0 or, if `positive` is True, the smallest positive value.
        optional: True if a vehicle file may omit the parameter. No value of an optional parameter has the same effect as the
            omission of the parameter.
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
        """Returns the value of the parameter as a float.

        Raises:
            InputError: the value is not a number in the allowed range.
        """
        return self.number.number(self.name, value)

    @property
    def number(self) -> SI:
        """Unit, meaning and range of the parameter, in the same form as for the keys in sections of a vehicle file."""
        least = self.smallest if self.smallest is not None else SMALLEST if self.positive else 0.0
        return SI(self.unit, self.meaning, least, self.largest)


def motion_ratio(name: str) -> Parameter:
    """Returns the parameter for the motion ratio of an axle or of the only suspension."""
    meaning = "r, travel of spring, damper, bump stop and actuator per wheel travel; 1 if they are at the wheel"
    return Parameter(name, "1", meaning, smallest=0.05, largest=5.0, optional=True)


def is_number(value: Any) -> bool:
    """Returns True if the value is a number that is allowed in a vehicle file."""
    return is_finite(value) and abs(value) <= LARGEST


HERE = Path(__file__).parent.parent  # folder that contains the built-in vehicle types
GRAVITY = 9.81  # gravitational acceleration [m/s2], which every generated MJCF contains
MOST_SQUEEZE = 0.25  # largest allowed static deflection of a tyre [m]; real tyres deflect less
# Smallest height of a hub above the road in equilibrium [m]. This is more than MOST_SQUEEZE, because a tyre deflection may
# exceed MOST_SQUEEZE before the time step ends.
LOWEST_HUB = 0.26
MOST_KEPT = 16  # a vehicle type caches this number of linear models, because a study uses the same vehicle many times

SEAT_POINTS = {
    "seat": "a seat has a section of its own: write [seat] with mass, stiffness and damping"
}  # built-in vehicle types have this value of `lacking`
# An acceleration below this value counts as a rounding error; the value is relative to the largest acceleration that a force
# causes
NEGLIGIBLE_ACCELERATION = 1e-12

Side = Annotated[str, Must("'left', 'right', or '' where there is only one track", lambda value: value in ("", "left", "right"))]
Parameters = Mapping[str, float]


# The default functions of a vehicle type have names, because pickle cannot find lambdas.
def nowhere_else(p: Parameters) -> float:
    """Returns a distance of 0 m, for a wheel that is not behind the first wheel, or that is on the vehicle's centre line."""
    return 0.0


def nothing(*_: Any) -> Any:
    """Returns an empty mapping: the default for functions that return loads or angles, or check the parameters of a vehicle."""
    return {}


@dataclass(frozen=True)
class Wheel(CheckedFields):
    """Wheel: a point where a road acts on the vehicle.

    Attributes:
        road_body: MJCF mocap body that represents the road under the wheel.
        road_displacement: signal of the road height under the wheel.
        road_velocity: signal of the vertical road velocity under the wheel, a disturbance of the linear model.
        tyre_deflection: signal of the deflection of the wheel's tyre.
        behind: function of the parameters that returns the distance of the wheel behind the first wheel [m].
        side: track of the wheel, "left" or "right"; empty if the vehicle has only one track.
        lateral: function of the parameters that returns the distance of the wheel to the left of the vehicle's centre line [m].
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
    """Tyre with stiffness k and damping c.

    The tyre force is k times the equivalent deflection t + (c / k) (z_u' - z_r'), where t is the tyre deflection.

    Attributes:
        hub: signal of the hub velocity z_u'.
        road: signal of the road velocity z_r'.
        time: c / k [s].
    """

    hub: str
    road: str
    time: float


@dataclass(frozen=True)
class Suspension(CheckedFields):
    """Suspension between the body and a wheel.

    Attributes:
        deflection: signal of the suspension's extension.
        tendon: name of the MJCF tendon of the suspension. A bump stop of the suspension acts in parallel with the tendon.
        force: name of the input that acts along the suspension; empty for a passive suspension.
        stiffness: name of the parameter of the spring; empty without a spring. A characteristic of the spring in `[curves]` can
            replace the parameter.
        damping: name of the parameter of the damper; empty without a damper. A characteristic of the damper in `[curves]` can
            replace the parameter.
        ratio: name of the parameter of the motion ratio, which is the travel of all elements of the suspension divided by the
            wheel travel. The name `ratio` is empty if the spring, damper and actuator act directly at the wheel. The equations
            of a vehicle type assume that all elements act at the wheel; `VehicleKind.at_wheels` converts the parameters
            accordingly.
    """

    deflection: Name
    tendon: Name
    force: str = ""
    stiffness: str = ""
    damping: str = ""
    ratio: str = ""

    def motion_ratio(self, parameters: Parameters) -> float:
        """Returns the motion ratio of the suspension."""
        return parameters.get(self.ratio, 1.0)

    @property
    def ending(self) -> str:
        """Suffix in the names of signals and parameters at the corner of the suspension."""
        return self.deflection.removeprefix(SUSPENSION_DEFLECTION.name)

    @property
    def corner(self) -> str:
        """Name of the corner; empty for a vehicle with a single suspension."""
        return self.ending.removeprefix("_")

    @property
    def velocity(self) -> Signal:
        """Signal of the suspension's extension rate."""
        common = self.deflection.startswith(SUSPENSION_DEFLECTION.name)
        corner = self.corner if common else self.deflection
        return SUSPENSION_VELOCITY.at(corner) if corner else SUSPENSION_VELOCITY


@dataclass(frozen=True)
class BodyLoad(CheckedFields):
    """Direction in which an external load acts on the body.

    Attributes:
        name: name of the load in the linear model: `heave_load` [N], `pitch_load` or `roll_load` [N m], or `wheel_load_...`
            [N].
        joint: slide or hinge joint of the MJCF along which the load acts. The load and the joint have the same positive
            direction.
    """

    name: str
    joint: str


@dataclass(frozen=True)
class Invariant(CheckedFields):
    """Transmissibility that no suspension force can change, at one frequency.

    The input is a road displacement that is equal under all wheels.

    Attributes:
        name: name of the transmissibility, such as "z_s/z_r".
        signals: signals whose sum is the output of the transmissibility.
        omega: function of the parameters that returns the angular frequency [rad/s].
        magnitude: function of the parameters that returns the magnitude of the transmissibility at the frequency `omega`, above
            0.
    """

    name: str
    signals: tuple[str, ...]
    omega: Callable[[Parameters], float]
    magnitude: Callable[[Parameters], float]


@dataclass(frozen=True)
class RidePoints:
    """Points at which the ride is measured, each identified by the signal of its vertical acceleration.

    Attributes:
        people: points at which a person sits or stands; may be empty. If the vehicle type does not name points for people, the
            masses above the body are used.
        others: remaining points of the body at which the ride is measured.
        named: True if the vehicle type gives names to the points at which a person sits or stands.
    """

    people: tuple[str, ...]
    others: tuple[str, ...]
    named: bool

    @property
    def all(self) -> tuple[str, ...]:
        """All points. In the list of points, those at which a person sits or stands come first."""
        return (*self.people, *self.others)

    @property
    def worst_of(self) -> tuple[str, ...]:
        """Points that determine the ride: those at which a person sits or stands or, if there is no person, all points."""
        return self.people or self.others


@dataclass(frozen=True)
class VehicleKind(CheckedFields):
    """Vehicle type: equations of motion, parameters, signals and MuJoCo model.

    All functions in the list of attributes take the parameters as a mapping from name to SI value.

    Attributes:
        name: value of `type` in a vehicle file, and file name of the type's `.py`, `.xml` and `.toml` files without the
            extension.
        parameters: all parameters of a vehicle file.
        signals: signals that every vehicle of the type has: outputs of the linear model, and sensors of the MJCF with the same
            names.
        wheels: wheels in the order of the linear model's disturbances.
        linear_model: function of the parameters that returns the `LinearModel` of all signals, including the signals on demand.
            The method `model` returns the linear model with only the outputs in `signals`.
        static_tyre_deflection: function of the parameters that returns the compression of each tyre in equilibrium [m], by tyre
            deflection signal. A wheel leaves the ground if its tyre deflection (for a `DampedTyre`, the equivalent deflection)
            exceeds the compression in equilibrium.
        write_mjcf: function that takes an `MjSpec` and the parameters. The function writes the parameters into the `MjSpec`,
            which is read from the type's `.xml` file, without importing MuJoCo.
        folder: folder of the `.xml` file.
        check_together: function of the parameters that raises InputError if values that are valid individually are not a valid
            vehicle in combination.
        combined: signals without a sensor that are weighted sums of other signals, as {name: {other signal: factor}}.
        suspended: suspensions of the type. If `suspended` is None, there is one suspension for each signal
            `suspension_deflection...`. The suspension's tendon `suspension...` and its force `control_force...`, if it exists,
            have the same suffix as the deflection signal.
        invariants: transmissibilities that no suspension force can change.
        on_demand: signals that a vehicle has only if its vehicle file names them. Signals on demand are outputs and sensors
            like other signals, but take no computing time if the file does not name them.
        loads: external loads on the body, in the order of the linear model's loads. If the vehicle has loads on its wheels, the
            linear model contains the wheel loads after the loads on the body.
        wheel_loads: function of the parameters that returns the loads on the wheels due to suspension links and wheel inertia,
            if the vehicle file describes them.
        carried: function that returns the loads that suspension links and wheel inertia cause in addition to the moment of a
            force on the body. The arguments of `carried` are the parameters, the direction, the force [N] and the acceleration
            of the wheels [m/s2]. The direction is "roll_load" for a force to the right, or "pitch_load" for a forward force.
        angles: function of the parameters that returns the angles of the body relative to level ground [rad], each as a
            weighted sum of signals. The function returns a mapping of the form {"pitch_angle": {signal: factor}, "roll_angle":
            {signal: factor}}.
        motion: function of the parameters that returns exact equations of motion, independent of the MJCF. If the type has no
            exact equations, `motion` is None and MuJoCo is compared only with the linear model.
        static_loads: function of the parameters that returns the weight of the body on each suspension [N], by deflection
            signal; empty if the weights are unknown.
        ratios: `models.characteristics.ratio_table.RatioTable` of each motion ratio that changes with travel, by the name of
            the ratio's parameter. The mapping is empty, except in the copy of the type that belongs to a vehicle whose motion
            ratios change with travel.
        people: signals of the accelerations [m/s2] at points where a person sits or stands, the most important point first.
            If `people` is None, the signals of the masses above the body are used, if the vehicle has masses above the body. If
            `people` is an empty tuple, no person is on the vehicle.
        of_parts: signals of the internal states of force elements. The signals of internal states are also part of `signals`,
            but have no sensors. The tuple is empty, except in the copy of the type that belongs to a vehicle whose force
            elements have internal states.
        lacking: parameters that the type does not have although a user may expect them, as {beginning of the name: reason}.
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
        """Returns a text with the name of the type, and its numbers of parameters, signals and wheels."""
        return (
            f"VehicleKind {self.name}: {len(self.parameters)} parameters, {len(self.signals)} signals, {len(self.wheels)} wheels"
        )

    def __reduce_ex__(self, protocol: SupportsIndex) -> Any:
        if self.folder == HERE:
            return super().__reduce_ex__(protocol)
        import cloudpickle  # the functions of a custom vehicle type are not part of an importable module

        return _from_pickle, (cloudpickle.dumps({part.name: getattr(self, part.name) for part in fields(self)}),)

    def __deepcopy__(self, memo: dict[int, Any]) -> "VehicleKind":
        return self  # this object is immutable, so no copy is needed

    def naming(self, names: Collection[str]) -> "VehicleKind":
        """Returns the vehicle type with the signals on demand that are in `names` added after the other signals."""
        more = [*self.possible.values()][len(self.signals) :]
        named = tuple(signal for signal in more if signal.name in names)
        return replace(self, signals=(*self.signals, *named)) if named else self

    def with_states(self, of_parts: tuple[Signal, ...]) -> "VehicleKind":
        """Returns the vehicle type after replacing its signals of the internal states of force elements.

        Args:
            of_parts: signals of the internal states, which replace the present signals.

        Raises:
            InputError: the name of a new signal is already used.
        """
        others = tuple(signal for signal in self.signals if signal not in self.of_parts)
        taken = [*names_of(others), *(name for name in self.possible if name not in names_of(self.signals))]
        for i, one in enumerate(names_of(of_parts)):
            if one in taken or one in names_of(of_parts)[:i]:
                raise InputError(
                    f"[parts] a state of an element would be called {one!r}, which is already the name of a signal; rename "
                    "the section of this element"
                )
        return self if of_parts == self.of_parts else replace(self, signals=(*others, *of_parts), of_parts=of_parts)

    @cached_property
    def possible(self) -> dict[str, Signal]:
        """All signals that a vehicle of the type can have, by name, including signals on demand and suspension velocities."""
        velocities = (part.velocity for part in self.suspensions)
        return {one.name: one for one in (*self.signals, *self.on_demand, *velocities)}

    def with_wheel_loads(self, parameters: Parameters) -> "VehicleKind":
        """Returns the vehicle type; its loads include wheel loads if a vehicle with the supplied parameters has loads on its
        wheels.
        """
        loads = tuple(dict.fromkeys((*self.loads, *self.wheel_loads(parameters))))
        return self if loads == self.loads else replace(self, loads=loads)

    @cached_property
    def unnamed(self) -> tuple[str, ...]:
        """Names of the signals on demand that vehicles of the type do not have."""
        # A comparison of sets is fast; comparing the signals one by one would take longer than compiling a model
        known = set(self.signals)
        return tuple(signal.name for signal in self.on_demand if signal not in known)

    def at_wheels(self, parameters: Parameters) -> Parameters:
        """Returns the parameters with spring and damper rates at the wheel: k r^2 and c r^2, where r is the motion ratio.

        If a motion ratio changes with travel, the preload of the spring also contributes to the stiffness at the wheel. In the
        returned parameters, constant motion ratios are 1, and motion ratios from tables are omitted.
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
        """Returns the `RatioTable` of a suspension whose motion ratio changes with travel; otherwise None."""
        table = self.ratios.get(place.ratio)
        return None if table is None or table.straight else table

    def _rates_of_preload(self, parameters: Parameters) -> dict[str, float]:
        """Returns the contribution of preloads to the wheel rates of springs [N/m]; the keys are the names of the stiffness
        parameters.

        Preloads contribute only at suspensions whose motion ratio changes with travel.

        Raises:
            InputError: the load of a spring is unknown, or springs with the same parameter carry different loads.
        """
        rates, loads = dict[str, float](), self.static_loads(parameters) if self.ratios else {}
        for part in self.suspensions:
            if part.ratio not in self.ratios or part.stiffness not in parameters:
                continue
            if part.deflection not in loads:
                raise InputError(
                    f"{part.ratio} changes with travel, so the static load of the suspension is needed, but "
                    f"static_loads returns no load for {part.deflection}; add this load to the result of static_loads"
                )
            rate = -self.ratios[part.ratio].relative_slope * loads[part.deflection]
            if not np.isclose(rates.setdefault(part.stiffness, rate), rate, rtol=1e-9, atol=0):
                raise InputError(
                    f"the suspensions that share the parameter {part.stiffness} carry different static loads, so "
                    f"their wheel rates would differ, because {part.ratio} changes with travel; give each suspension "
                    "its own parameter"
                )
        return rates

    def motion_ratios(self, parameters: Parameters, forces: Iterable[str]) -> dict[str, float]:
        """Returns the motion ratio of the suspension along which each force acts; 1 for forces that act elsewhere."""
        ratios = {part.force: part.motion_ratio(parameters) for part in self.suspensions}
        return {force: ratios.get(force, 1.0) for force in forces}

    def model(self, parameters: Parameters) -> LinearModel:
        """Returns the linear model whose outputs are the signals of the vehicle type. Recently computed linear models are
        cached.
        """
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
        """Returns the linear model with all possible signals, in which every element acts through its motion ratio.

        The signals include the signals on demand, and the suspension velocities that `linear_model` does not return.
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
        """All suspensions: those in `suspended` or, if `suspended` is None, one for each signal `suspension_deflection...`."""
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
        """Returns the name of a parameter for a corner, for its axle, or for the whole vehicle; empty if the parameter does not
        exist.

        Args:
            parameter: name of the parameter without a suffix.
            ending: suffix of the parameter names at the corner.
        """
        names = {known.name for known in self.parameters}
        while ending and f"{parameter}{ending}" not in names:
            ending = ending.rpartition("_")[0]
        return f"{parameter}{ending}" if f"{parameter}{ending}" in names else ""

    def invariants_of(self, parameters: Parameters) -> tuple[Invariant, ...]:
        """Returns the invariants of the vehicle type for the supplied parameters; empty if a tyre has damping.

        For a wheel with the mass m_u on a tyre with the stiffness k and no damping, m_u s^2 + k = 0 at one frequency. At the
        frequency of the wheel mass m_u on the tyre stiffness k, the suspension force does not change the transmissibility. With
        the tyre damping c, m_u s^2 + c s + k is not zero at any frequency.
        """
        return () if self.damped_tyres(parameters) else self.invariants

    def damped_tyres(self, parameters: Parameters) -> "Mapping[str, DampedTyre]":
        """Returns the tyres with damping, by their deflection signals; empty for custom vehicle types."""
        tyres = {}
        for wheel in self.wheels if self.folder == HERE else ():
            ending = wheel.tyre_deflection.removeprefix(TYRE_DEFLECTION.name)
            c, k = (parameters.get(self.of_corner(part, ending), 0.0) for part in ("tyre_damping", "tyre_stiffness"))
            if c:
                tyres[wheel.tyre_deflection] = DampedTyre(f"{UNSPRUNG_VELOCITY.name}{ending}", wheel.road_velocity, c / k)
        return tyres

    def deflection_of(self, force: str) -> str:
        """Returns the deflection signal of the suspension along which a force acts; empty if the force acts elsewhere."""
        return next((part.deflection for part in self.suspensions if part.force == force), "")

    @property
    def corners(self) -> dict[str, str]:
        """Suffix of the signal and parameter names at each suspension that has a control force, by the name of this force."""
        return {part.force: part.ending for part in self.suspensions if part.force}

    @property
    def mjcf(self) -> Path:
        """Path of the vehicle type's MJCF file."""
        return self.folder / f"{self.name}.xml"

    def check_each(self, parameters: Mapping[str, Any]) -> dict[str, float]:
        """Returns all parameters in the order of the vehicle type, after checking each parameter separately.

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
        """Returns all parameters in the order of the vehicle type, after checking each parameter and their combination.

        Raises:
            InputError: `check_each` raises an InputError, or the combination of the parameters is not a valid vehicle.
                InputError is also raised if, in equilibrium, a tyre is fully compressed or has no contact with the road.
        """
        checked = self.check_each(parameters)
        at_wheels = self.at_wheels(checked)
        for part in self.suspensions if self.ratios else ():
            if at_wheels.get(part.stiffness, 0.0) < 0:
                raise InputError(
                    f"{part.ratio} changes so fast with travel that the preload of the spring makes the wheel rate "
                    f"negative ({at_wheels[part.stiffness]:.4g} N/m); give a stiffer spring, or a ratio that changes "
                    "less with travel"
                )
        self.check_together(at_wheels)
        for tyre, squeeze in self.static_tyre_deflection(checked).items():
            if squeeze <= 0:
                raise InputError(
                    f"{tyre}: at rest, this wheel carries no load and does not touch the road; move mass towards this wheel"
                )
            if squeeze > MOST_SQUEEZE:
                raise InputError(
                    f"{tyre} at rest is {squeeze:.3g} m (weight divided by tyre stiffness), but at most "
                    f"{MOST_SQUEEZE} m is allowed. Check that masses are in kg and stiffness in N/m; lower the masses "
                    "or raise the stiffness"
                )
        return checked

    def ride_points(self, model: LinearModel) -> RidePoints:
        """Returns the points at which the ride is measured, for a vehicle with the supplied linear model.

        A mass counts as above the body if no force that acts on a wheel also acts directly on this mass.
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
        """Returns the signal with the name `name`. The vehicle type must have a signal with this name."""
        return next(signal for signal in self.signals if signal.name == name)


def _from_pickle(content: bytes) -> VehicleKind:
    """Returns a custom vehicle type from its pickled fields."""
    return VehicleKind(**pickle.loads(content))
