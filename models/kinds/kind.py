"""A kind of vehicle: what `models/<name>.py` must say so that everything after it works unchanged, its parameters among it."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from models.common.errors import InputError, listing, quoted
from models.common.printed import Shown
from models.kinds.linear_model import LinearModel
from models.kinds.signals import CONTROL_FORCE, SUSPENSION_DEFLECTION, SUSPENSION_VELOCITY, Signal

SMALLEST, LARGEST = 1e-6, 1e12  # SI; beyond these a parameter is a slip of the pen, and rounding decides


@dataclass(frozen=True)
class Variation:
    """How far other vehicles of a kind may be from the one that a controller was designed for.

    Attributes:
        name: of what varies, in words. Parameters with the same variation vary together.
        smallest, largest: factors on the parameter, at most 1 and at least 1.

    Raises:
        InputError: they are none.
    """

    name: str
    smallest: float
    largest: float

    def __post_init__(self) -> None:
        if not (0 < self.smallest <= 1 <= self.largest <= LARGEST and self.smallest < self.largest):
            raise InputError(
                f"{self.name} varies by factors from {self.smallest:g} to {self.largest:g}; give one above 0 and at most 1, and "
                "a larger one that is at least 1"
            )

    def __str__(self) -> str:
        low, high = (100 * (factor - 1) for factor in (self.smallest, self.largest))
        return f"{self.name} {low:+.4g} to {high:+.4g} %"


@dataclass(frozen=True)
class Parameter:
    """One number of a vehicle file.

    Attributes:
        name: key under `[parameters]`.
        unit: SI unit.
        meaning: one line.
        positive: whether zero is refused too. Negative, infinite, NaN and absurdly large values always are.
        varied: how far it varies where a controller's robustness is asked for; None where it is taken as it is.
        largest: that is allowed.
        usual: what it is where a vehicle file does not say; None where every file must.
    """

    name: str
    unit: str
    meaning: str
    positive: bool = True
    varied: Variation | None = None
    largest: float = LARGEST
    usual: float | None = None

    def check(self, value: Any) -> float:
        """The value as a float.

        Raises:
            InputError: not a number of the allowed range.
        """
        smallest = SMALLEST if self.positive else 0.0
        allowed = f"a number from {smallest:g} to {self.largest:g} {self.unit}"
        if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
            raise InputError(f"{self.name} = {quoted(value)} is not a number; give {allowed}")
        if not smallest <= value <= self.largest:  # NaN is in no range
            raise InputError(f"{self.name} = {quoted(value)} is not allowed; give {allowed}")
        return float(value)


def is_number(value: Any) -> bool:
    """Whether it is a number that a vehicle file may hold."""
    return is_within(value, LARGEST)


def is_within(value: Any, most: float) -> bool:
    """Whether it is a number of at most that size."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and -most <= value <= most  # NaN is not


HERE = Path(__file__).parent.parent  # where the kinds that ship lie
GRAVITY = 9.81  # m/s2, written into every MJCF
MOST_SQUEEZE = 0.25  # m; no tyre survives it
LOWEST_HUB = 0.26  # m above the road, at rest, at least: until the end of a step a tyre may be squeezed by more than that

Parameters = Mapping[str, float]


@dataclass(frozen=True)
class Wheel:
    """A point where a road acts on the vehicle.

    Attributes:
        road_body: MJCF mocap body that carries the road under this wheel.
        road_displacement: signal of the road's height under it.
        road_velocity: signal of the road's vertical velocity under it, a disturbance of the linear model.
        tyre_deflection: signal of its tyre.
        behind: parameters -> how far it runs behind the first wheel [m].
        side: the track it runs in, "left" or "right"; empty where the vehicle has only one.
        lateral: parameters -> how far it runs left of the vehicle's middle [m].
    """

    road_body: str
    road_displacement: str
    road_velocity: str
    tyre_deflection: str
    behind: Callable[[Parameters], float] = lambda p: 0.0
    side: str = ""
    lateral: Callable[[Parameters], float] = lambda p: 0.0


@dataclass(frozen=True)
class Suspension:
    """What holds the body on a wheel.

    Attributes:
        deflection: signal of how far it is stretched.
        tendon: MJCF tendon that it is; its bump stop lies beside it.
        force: input that pushes along it; empty where none does.
        stiffness, damping: parameters of its spring and its damper, which curves can stand in for; empty where there is none.
    """

    deflection: str
    tendon: str
    force: str = ""
    stiffness: str = ""
    damping: str = ""

    @property
    def ending(self) -> str:
        """Of the names of what lies at its corner."""
        return self.deflection.removeprefix(SUSPENSION_DEFLECTION.name)

    @property
    def corner(self) -> str:
        """Name of its corner; empty for one that is alone."""
        return self.ending.removeprefix("_")

    @property
    def velocity(self) -> Signal:
        """The signal of how fast it is stretched."""
        common = self.deflection.startswith(SUSPENSION_DEFLECTION.name)
        corner = self.ending.removeprefix("_") if common else self.deflection
        return SUSPENSION_VELOCITY.at(corner) if corner else SUSPENSION_VELOCITY


@dataclass(frozen=True)
class BodyLoad:
    """A way in which something from outside pushes the body.

    Attributes:
        name: of the linear model's load: `heave_load` [N], `pitch_load` or `roll_load` [N m].
        joint: MJCF slide or hinge along which it pushes, in the load's direction.
    """

    name: str
    joint: str


@dataclass(frozen=True)
class Invariant:
    """A transmissibility, from the road's displacement under every wheel, that no suspension force can change.

    Attributes:
        name: of which quantity, as in "z_s/z_r".
        signals: whose sum that quantity is.
        omega: parameters -> at which frequency [rad/s].
        magnitude: parameters -> the transmissibility there, above 0.
    """

    name: str
    signals: tuple[str, ...]
    omega: Callable[[Parameters], float]
    magnitude: Callable[[Parameters], float]


@dataclass(frozen=True)
class VehicleKind:
    """The equations of a kind of vehicle. Every function takes the parameters as a mapping from name to SI value.

    Attributes:
        name: `type` in a vehicle file, and the stem of the `.py`, `.xml` and `.toml` files.
        parameters: what a vehicle file must give, and may.
        signals: of every vehicle of the kind: outputs of the linear model and, by the same names, sensors of the MJCF.
        wheels: in the order of the linear model's disturbances.
        linear_model: parameters -> LinearModel, of all signals, those on demand too; a vehicle's own is `model`.
        static_tyre_deflection: parameters -> how far each tyre is squeezed at rest [m], by tyre deflection signal. A tyre
            deflection above it means that the wheel is off the road.
        write_mjcf: writes the parameters into an `MjSpec` of the kind's `.xml`. It edits what it is given: no import of MuJoCo.
        folder: where its `.xml` lies.
        check_together: raises InputError where parameters, each fine by itself, make no vehicle together.
        combined: signals that are no sensor but a sum of others, as {name: {other signal: factor}}.
        suspended: its suspensions. None: one for every signal `suspension_deflection...`, whose tendon is `suspension...` and
            whose force is `control_force...`, if there is one, all of one ending.
        invariants: what no suspension force can change.
        on_demand: signals that only a vehicle has whose file names them: outputs and sensors like the others, which cost nothing
            where nobody asks for them.
        loads: how its body can be pushed from outside, in the order of the linear model's loads.
        angles: parameters -> the body's angles over level ground [rad] as sums of signals, {"pitch_angle": {signal: factor}},
            `roll_angle` likewise; of those that it has.
        lacking: what somebody may look for and it cannot have, as {beginning of a parameter's name: why}.
    """

    name: str
    parameters: tuple[Parameter, ...]
    signals: tuple[Signal, ...]
    wheels: tuple[Wheel, ...]
    linear_model: Callable[[Parameters], LinearModel]
    static_tyre_deflection: Callable[[Parameters], Mapping[str, float]]
    write_mjcf: Callable[[Any, Parameters], None]
    folder: Path = HERE
    check_together: Callable[[Parameters], None] = lambda p: None
    combined: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    suspended: tuple[Suspension, ...] | None = None
    invariants: tuple[Invariant, ...] = ()
    on_demand: tuple[Signal, ...] = ()
    loads: tuple[BodyLoad, ...] = ()
    angles: Callable[[Parameters], Mapping[str, Mapping[str, float]]] = lambda p: {}
    lacking: Mapping[str, str] = field(default_factory=dict)

    def naming(self, names: Collection[str]) -> "VehicleKind":
        """The kind whose vehicles have those of the signals on demand that are named, after their other signals."""
        known = {signal.name for signal in self.signals}
        more = (*self.on_demand, *(one.velocity for one in self.suspensions))
        named = tuple(signal for signal in more if signal.name in names and signal.name not in known)
        return replace(self, signals=(*self.signals, *named)) if named else self

    @property
    def unnamed(self) -> tuple[str, ...]:
        """The signals on demand that its vehicles do not have."""
        return tuple(signal.name for signal in self.on_demand if signal not in self.signals)

    def model(self, parameters: Parameters) -> LinearModel:
        """The linear model of a vehicle of the kind: of the signals that it has."""
        names = {signal.name for signal in self.signals}
        return self._with_rates(self.linear_model(parameters).without(self.unnamed), names)

    def whole_model(self, parameters: Parameters) -> LinearModel:
        """The linear model with all signals that a vehicle of the kind may have: those on demand, and suspensions' velocities."""
        model = self.linear_model(parameters)
        return self._with_rates(model, {one.velocity.name for one in self.suspensions if model.has_rate(one.deflection)})

    def _with_rates(self, model: LinearModel, names: Collection[str]) -> LinearModel:
        """The model with the velocities of suspensions that are named, where it has not got them itself."""
        rates = {one.velocity.name: one.deflection for one in self.suspensions}
        return model.with_rates({name: of for name, of in rates.items() if name in names and name not in model.outputs})

    @property
    def suspensions(self) -> tuple[Suspension, ...]:
        """Its suspensions, those of `suspended` or of the common names."""
        if self.suspended is not None:
            return tuple(self.suspended)
        names = [signal.name for signal in self.signals]
        found = []
        for name in names:
            if name.startswith(SUSPENSION_DEFLECTION.name):
                ending = name.removeprefix(SUSPENSION_DEFLECTION.name)
                force = f"{CONTROL_FORCE.name}{ending}"
                parameters = (self._of_corner(part, ending) for part in ("suspension_stiffness", "suspension_damping"))
                found.append(Suspension(name, f"suspension{ending}", force if force in names else "", *parameters))
        return tuple(found)

    def _of_corner(self, parameter: str, ending: str) -> str:
        """The parameter at a corner, or of the axle that it is on, or of all alike; empty where there is none."""
        corners, names = ending.split("_"), {one.name for one in self.parameters}
        beginnings = ("_".join((parameter, *corners[1:count])) for count in range(len(corners), 0, -1))
        return next((name for name in beginnings if name in names), "")

    def pushed(self, force: str) -> str:
        """The suspension deflection that a force pushes along; empty where it has none, and pushes against something else."""
        return next((one.deflection for one in self.suspensions if one.force == force), "")

    @property
    def corners(self) -> dict[str, str]:
        """Of every force of a suspension, the ending of the names of what lies at its corner."""
        return {one.force: one.ending for one in self.suspensions if one.force}

    @property
    def variations(self) -> dict[Variation, tuple[str, ...]]:
        """What varies from vehicle to vehicle of this kind, and the parameters that do, in their order."""
        varied = dict.fromkeys(one.varied for one in self.parameters if one.varied is not None)
        return {each: tuple(one.name for one in self.parameters if one.varied == each) for each in varied}

    @property
    def mjcf(self) -> Path:
        """Path of the kind's MJCF."""
        return self.folder / f"{self.name}.xml"

    def check(self, parameters: Mapping[str, Any]) -> dict[str, float]:
        """All parameters, checked, in the kind's order.

        Raises:
            InputError: one is missing, unknown or not allowed, or together they squeeze a tyre flat at rest.
        """
        names = [parameter.name for parameter in self.parameters]
        for name in parameters:
            if name not in names:
                why = "".join(f" ({said})" for beginning, said in self.lacking.items() if name.startswith(beginning))
                raise InputError(f"unknown parameter {name!r}; a {self.name} has {listing(names)}{why}")
        parameters = {one.name: one.usual for one in self.parameters if one.usual is not None} | dict(parameters)
        for parameter in self.parameters:
            if parameter.name not in parameters:
                raise InputError(f"parameter {parameter.name!r} [{parameter.unit}] is missing: {parameter.meaning}")
        checked = {parameter.name: parameter.check(parameters[parameter.name]) for parameter in self.parameters}
        self.check_together(checked)
        for tyre, squeeze in self.static_tyre_deflection(checked).items():
            if squeeze > MOST_SQUEEZE:
                raise InputError(
                    f"{tyre} at rest is {squeeze:.3g} m, the masses' weight over the tyre's stiffness; at most {MOST_SQUEEZE} m "
                    "is allowed: lower the masses or raise the stiffness"
                )
        return checked

    def signal(self, name: str) -> Signal:
        """The signal of that name, which this kind has."""
        return next(signal for signal in self.signals if signal.name == name)


class ShownVehicle(Shown):
    """What a vehicle of some kind shows of what it has."""

    kind: VehicleKind
    parameters: Mapping[str, float]
    performance: Mapping[str, float]
    controllers: Mapping[str, Any]
    source: str

    @property
    def shown(self) -> tuple[str, dict[str, str]]:
        """Its kind and file, then what it is made of."""
        units = {parameter.name: parameter.unit for parameter in self.kind.parameters}
        return f"vehicle: {self.kind.name}{f', {self.source}' if self.source else ''}", {
            "parameters": ", ".join(
                f"{name} {value:g} {units.get(name, '')}".rstrip() for name, value in self.parameters.items()
            ),
            "weights": ", ".join(f"{name} {weight:g}" for name, weight in self.performance.items() if weight),
            "controllers": ", ".join(("passive", "state", *self.controllers)),
        }
