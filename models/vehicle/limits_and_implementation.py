"""What a real car has and the analysis has not: `[limits]` and `[implementation]` of a vehicle file, each off where absent."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

from models.common.errors import InputError, listing, quoted
from models.kinds.kind import Parameter
from models.suspension import STOP_KEYS

if TYPE_CHECKING:
    from models.kinds.kind import Suspension
    from models.suspension.bump_stops import Place, Sides, Stiffness, Stops

LIMITS = (
    Parameter("actuator_force", "N", "largest force of every actuator, either way"),
    Parameter("actuator_bandwidth", "rad/s", "corner frequency of every actuator, a first-order lag"),
)

LONGEST_PERIOD = 1.0  # s, of a sampled controller
MOST_DELAY = 1000  # sample periods; each is a state of the sampled loop, whose eigenvalues then take a minute
MOST_SEED = 100_000


@dataclass(frozen=True)
class Limits:
    """Where the hardware ends. None means: no such limit.

    Attributes:
        suspension_stroke: travel either way before the bump stop [m], or one for each side.
        stop_stiffness: stiffness of the bump stop [N/m], or the coefficients of a progressive one, or these for each side.
        actuator_force: largest force [N].
        actuator_bandwidth: corner frequency of the first-order lag from the force asked for to the force [rad/s].
        places: the axles and corners whose stops are others.
    """

    suspension_stroke: "float | Sides | None" = None
    stop_stiffness: "Stiffness | Sides | None" = None
    actuator_force: float | None = None
    actuator_bandwidth: float | None = None
    places: "tuple[Place, ...]" = ()

    @property
    def stopped(self) -> bool:
        """Whether there is anything of bump stops."""
        return self.suspension_stroke is not None or self.stop_stiffness is not None or bool(self.places)

    def stops_at(self, corner: str) -> "Stops | None":
        """The bump stops of a corner; None where it has none."""
        if not self.stopped:
            return None
        from models.suspension.bump_stops import Place, stops_at

        return stops_at((Place("", self.suspension_stroke, self.stop_stiffness), *self.places), corner)

    def stops(self, suspensions: "Sequence[Suspension]") -> "dict[str, Stops]":
        """The bump stops of a vehicle's suspensions, by deflection, of those that have some."""
        found = {one.deflection: self.stops_at(one.corner) for one in suspensions}
        return {deflection: one for deflection, one in found.items() if one is not None}

    @property
    def written(self) -> dict[str, str]:
        """What there is of them as a vehicle file has it, by key; of both sides apart by `key.side`."""
        given = {name: value for name, value in vars(self).items() if value is not None and name != "places"}
        if not self.stopped:
            return {name: f"{value:g}" for name, value in given.items()}
        from models.suspension.bump_stops import Sides

        for place in self.places:
            given |= {f"{place.name}.{key}": getattr(place, key) for key in STOP_KEYS if getattr(place, key) is not None}
        flat = {}
        for name, value in given.items():
            flat |= {f"{name}.{side}": one for side, one in vars(value).items()} if isinstance(value, Sides) else {name: value}
        return {
            name: f"[{', '.join(f'{k:g}' for k in one)}]" if isinstance(one, tuple) else f"{one:g}" for name, one in flat.items()
        }

    @property
    def record(self) -> dict[str, Any]:
        """What `read_limits` reads as the same limits, None for what there is not."""
        found = asdict(self)
        return found | {one.pop("name"): {key: v for key, v in one.items() if v is not None} for one in found.pop("places")}

    @property
    def of_actuators(self) -> tuple[str, ...]:
        """The keys that limit actuators."""
        return tuple(name for name in ("actuator_force", "actuator_bandwidth") if getattr(self, name) is not None)

    def words(self, suspensions: "Sequence[Suspension]") -> tuple[str, ...]:
        """What there is of them on a vehicle with these suspensions, a phrase each."""
        found = []
        if self.stopped:
            from models.suspension.bump_stops import stop_words

            found += stop_words({one.corner: self.stops_at(one.corner) for one in suspensions})
        if self.actuator_force is not None:
            found.append(f"forces up to ±{self.actuator_force:g} N")
        if self.actuator_bandwidth is not None:
            found.append(
                f"actuators that lag from {self.actuator_bandwidth / (2 * math.pi):.4g} Hz on ({self.actuator_bandwidth:g} rad/s)"
            )
        return tuple(found)


def samples(count: float) -> str:
    """So many samples, in words: the number as it is printed says whether it is one."""
    number = f"{count:g}"
    return f"{number} sample{'s' * (number != '1')}"


def samples_late(delay: float) -> str:
    """How late forces act [samples], in words."""
    return f"{samples(delay)} late"


@dataclass(frozen=True)
class Implementation:
    """The controller as it would be built.

    Attributes:
        sample_period: of the controller [s], a multiple of the timestep; None: the timestep itself.
        delay: from a measurement to the force computed from it, in samples of the controller; a whole number of them is an int.
        noise: rms of the white noise on a measured signal, by signal, in its unit.
        quantisation: resolution of a measured signal, by signal, in its unit.
        seed: of the noise.
    """

    sample_period: float | None = None
    delay: float = 0
    noise: Mapping[str, float] = field(default_factory=dict)
    quantisation: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0

    @property
    def ideal(self) -> bool:
        """Whether the controller acts at every timestep, at once, on what is."""
        return self.prompt and not self.blurred

    @property
    def prompt(self) -> bool:
        """Whether the controller acts at every timestep, at once."""
        return self.sample_period is None and self.delay == 0

    @property
    def waiting(self) -> int:
        """How many forces that are computed have not acted yet when another is, at most."""
        return math.ceil(self.delay)

    @property
    def held(self) -> tuple[tuple[float, int], ...]:
        """The parts of a sample period, each under one force: its share of the period, and by how many samples that is late."""
        late = math.floor(self.delay)
        share = self.delay - late
        return ((share, late + 1), (1 - share, late)) if share else ((1.0, late),)

    @property
    def blurred(self) -> bool:
        """Whether it measures with noise, or in steps."""
        return bool(self.blur)

    @property
    def blur(self) -> str:
        """What stands between a signal and its measurement, in words: noise, quantisation or both; empty where nothing does."""
        kinds = {"noise": self.noise, "quantisation": self.quantisation}
        return " and ".join(name for name, values in kinds.items() if any(values.values()))

    @property
    def clear(self) -> "Implementation":
        """The same without noise and quantisation: what of it is linear, and so has a frequency response."""
        return replace(self, noise={}, quantisation={})

    def scaled(self, factor: float) -> "Implementation":
        """The same where all signals are so many times as large: its noise and its resolution are, too."""
        noise = {name: factor * rms for name, rms in self.noise.items()}
        return replace(self, noise=noise, quantisation={name: factor * step for name, step in self.quantisation.items()})

    @property
    def words(self) -> tuple[str, ...]:
        """What there is of it, a phrase each."""
        found = []
        if self.sample_period is not None:
            found.append(f"a sample every {1e3 * self.sample_period:g} ms")
        if self.delay:
            found.append(f"forces that act {samples_late(self.delay)}")
        found += [f"noise of {rms:g} rms on {name}" for name, rms in self.noise.items() if rms]
        found += [f"{name} read in steps of {step:g}" for name, step in self.quantisation.items() if step]
        return tuple(found)


def read_limits(section: Mapping[str, Any], suspensions: "Sequence[Suspension]") -> Limits:
    """`[limits]`, checked.

    Args:
        suspensions: of the vehicle, at which its stops are.

    Raises:
        InputError: a key or section that is unknown, a value that is not allowed, a stroke without a stiffness or the other way
            round.
    """
    of_actuators = {parameter.name: parameter for parameter in LIMITS}
    for name, value in section.items():
        if name not in of_actuators and name not in STOP_KEYS and not isinstance(value, Mapping):
            raise InputError(f"[limits] unknown key {name!r}; known: {listing((*STOP_KEYS, *of_actuators))}")
    of_stops = {name: value for name, value in section.items() if name not in of_actuators}
    found = Limits()
    if of_stops:
        from models.suspension.bump_stops import read_places

        common, *places = read_places(of_stops, [one.corner for one in suspensions])
        found = Limits(common.suspension_stroke, common.stop_stiffness, places=tuple(places))
    return replace(found, **{name: one.check(section[name]) for name, one in of_actuators.items() if name in section})


def read_implementation(section: Mapping[str, Any], measurable: tuple[str, ...]) -> Implementation:
    """`[implementation]`, checked.

    Args:
        measurable: the signals that a controller of this vehicle can measure.

    Raises:
        InputError: a key or signal that is unknown, a value that is not allowed.
    """
    keys = ("sample_period", "delay", "noise", "quantisation", "seed", "sampled")
    for name in section:
        if name not in keys:
            raise InputError(f"[implementation] unknown key {name!r}; known: {listing(keys)}")
    found: dict[str, Any] = {}
    if "sample_period" in section:
        period = Parameter("sample_period", "s", "of the controller", largest=LONGEST_PERIOD).check(section["sample_period"])
        found["sample_period"] = period
    for name, most, kinds, what in (("delay", MOST_DELAY, (int, float), "number"), ("seed", MOST_SEED, (int,), "whole number")):
        value = section.get(name, 0)
        if isinstance(value, bool) or not isinstance(value, kinds) or not 0 <= value <= most:
            raise InputError(f"[implementation] {name} = {quoted(value)} is not allowed; give a {what} from 0 to {most}")
        found[name] = int(value) if value == int(value) else value
    for name in ("noise", "quantisation"):
        values = section.get(name, {})
        if not isinstance(values, dict):
            raise InputError(f"[implementation] {name} is not a table; write {name} = {{ signal = value }}")
        for signal in values:
            if signal not in measurable:
                raise InputError(f"[implementation] {name} of unknown signal {signal!r}; measured can be {listing(measurable)}")
        found[name] = {
            signal: Parameter(f"{name} of {signal}", "of its unit", "", positive=False).check(value)
            for signal, value in values.items()
        }
    return Implementation(**found)


def steps_per_sample(implementation: Implementation, timestep: float) -> int:
    """How many timesteps the controller holds its force.

    Raises:
        InputError: the sample period is no multiple of the timestep, or the delay none.
    """
    period, delay = implementation.sample_period, implementation.delay
    steps = 1 if period is None else round(period / timestep)
    if period is not None and (steps < 1 or abs(steps * timestep / period - 1) > 1e-9):
        raise InputError(f"sample_period = {period:g} s is no multiple of the timestep, {timestep:g} s; give such a one")
    if abs(delay * steps - round(delay * steps)) > 1e-6:
        raise InputError(
            f"delay = {samples(delay)}, {delay * steps * timestep:g} s, is no multiple of the timestep, {timestep:g} s, and no "
            f"force changes within a step; give a multiple of {timestep:g} s or a smaller timestep"
        )
    return steps


def steps_held(implementation: Implementation, timestep: float) -> tuple[tuple[int, int], ...]:
    """The parts of a sample period, each under one force: its timesteps, and how many samples late that force is."""
    steps = steps_per_sample(implementation, timestep)
    return tuple((round(share * steps), late) for share, late in implementation.held)


def check_period(name: str, period: float | None, implementation: Implementation) -> None:
    """Whether a controller whose law has a sample period of its own is built with that one.

    Args:
        period: its law's [s]; None where it has none.

    Raises:
        InputError: it is not.
    """
    if period is not None and implementation.sample_period != period:
        raise InputError(
            f"[controllers.{name}] has a sample period of {period!r} s of its own, and [implementation] says "
            f"{implementation.sample_period or 'none'}; give [implementation] sample_period = {period!r}"
        )
