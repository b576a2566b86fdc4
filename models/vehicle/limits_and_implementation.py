"""`[limits]` and `[implementation]` of a vehicle file: properties of a real car that linear analysis ignores.

By default, the vehicle has no limits, and the implementation is ideal.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from models.characteristics import STOP, STOP_KEYS, STOP_NAMES
from models.common.arrays import Array
from models.common.checks import is_finite
from models.common.errors import InputError, short_repr
from models.common.extensions import FEATURES
from models.common.printed import rough
from models.common.schema import HERE, SI, BySignal, Choice, Flag, Integer, ReadBy, Section, read
from models.common.units import in_unit
from models.parts.stops.section import StopPair, StopSection

if TYPE_CHECKING:
    from models.kinds.kind import Suspension
    from models.parts.stops.stop import BumpAndRebound

ORDERS = ("force", "command")  # allowed values of the field `Limits.limit`
# An actuator with a force limit receives at most this request [N]; larger requests are reduced, because MuJoCo does not accept
# them
MOST_ASKED = 1e9

LONGEST_PERIOD = 1.0  # longest allowed sample period of a controller [s]
MOST_DELAY = 50  # longest allowed delay [sample periods]; each period adds states to the sampled loop
NO_PERIOD = (
    "has sampled = true, but [implementation] gives no sample period; give it in seconds, as in sample_period = 0.01, or omit "
    "sampled"
)


@dataclass(frozen=True)
class LimitsSection(StopSection):
    """Keys of `[limits]` in a vehicle file, without the sections for single axles and corners."""

    actuator_force: Annotated[float, SI("N", "largest force of every actuator, in both directions")] | None = None
    actuator_bandwidth: Annotated[float, SI("rad/s", "corner frequency of every actuator's first-order lag")] | None = None
    force_rate: Annotated[float, SI("N/s", "largest change of every actuator's command per second")] | None = None
    limit: (
        Annotated[str, Choice("`command` limits the command before the lag, and `force` limits the force after the lag", ORDERS)]
        | None
    ) = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.limit is not None and self.actuator_force is None:
            raise InputError(f"has limit = {self.limit!r}, but no actuator_force; give actuator_force [N], or omit limit")
        if self.limit == "force" and self.force_rate is not None and self.actuator_bandwidth is not None:
            raise InputError(
                'has limit = "force", so that actuator_force limits only the forces, but with force_rate, actuator_force '
                'also limits the commands; give limit = "command", or omit limit'
            )


@dataclass(frozen=True)
class Limits(LimitsSection):
    """Limits of the hardware. An attribute None means that the limit does not exist.

    Attributes:
        places: names of axles and corners with different bump stops, each with its section.
    """

    public_name = "limits, such as vehicle.limits"

    places: tuple[tuple[str, StopSection], ...] = ()

    @property
    def stopped(self) -> bool:
        """True if the vehicle file gives at least one key for bump stops."""
        return self.suspension_stroke is not None or self.stop_stiffness is not None or bool(self.places)

    def stops_at(self, corner: str) -> "BumpAndRebound | None":
        """Returns the bump stops of a corner, or None if the corner has no stops."""
        return FEATURES.load("stops").stops_at({"": self, **dict(self.places)}, corner) if self.stopped else None

    def stops(self, suspensions: "Sequence[Suspension]") -> "dict[str, BumpAndRebound]":
        """Returns the bump and rebound stops of a vehicle, by the deflection signal of the suspension. Suspensions without
        stops are omitted.
        """
        by_deflection = {suspension.deflection: self.stops_at(suspension.corner) for suspension in suspensions}
        return {deflection: stops for deflection, stops in by_deflection.items() if stops is not None}

    @property
    def written(self) -> dict[str, str]:
        """The limits that exist, as text by key, in the form of a vehicle file. A limit for one side (bump or rebound) has the
        key `key.side`.
        """
        given = {name: value for name, value in vars(self).items() if name != "places"}
        given |= {f"{place}.{key}": getattr(one, key) for place, one in self.places for key in STOP_KEYS}
        flat = dict[str, Any]()
        for name, value in given.items():
            one_each = isinstance(value, StopPair)
            flat |= {f"{name}.{side}": one for side, one in vars(value).items()} if one_each else {name: value}
        return {name: _text(value) for name, value in flat.items() if value is not None}

    @property
    def record(self) -> dict[str, Any]:
        """The limits in the form of a section that `read_limits` can read. Limits that the vehicle file does not give are None.

        If `limit`, `force_rate` or the stop table is not given, the section does not contain this key.
        """
        limits = asdict(self)
        places = {name: {key: one for key, one in place.items() if one is not None} for name, place in limits.pop("places")}
        optional = ("limit", "force_rate", STOP)
        return {name: one for name, one in limits.items() if one is not None or name not in optional} | places

    @property
    def of_actuators(self) -> tuple[str, ...]:
        """The keys of `[limits]` that the vehicle file contains and that limit actuators."""
        keys = ("actuator_force", "actuator_bandwidth", "force_rate", "limit")
        return tuple(name for name in keys if getattr(self, name) is not None)

    @property
    def limits_commands(self) -> bool:
        """True if commands are limited before the actuator lag, which is always the case with a rate limit."""
        return self.actuator_force is not None and (self.limit == "command" or self.force_rate is not None)

    @property
    def largest(self) -> tuple[float, float]:
        """The largest command before the actuator lag and the largest force after the lag [N]; infinite without a limit."""
        if self.actuator_force is None:
            return math.inf, math.inf
        return self.actuator_force if self.limits_commands else MOST_ASKED, self.actuator_force

    @property
    def without_actuators(self) -> "Limits":
        """The limits of the suspensions, without those of the actuators."""
        return replace(self, actuator_force=None, actuator_bandwidth=None, force_rate=None, limit=None)

    def without(self, part: str) -> "Limits":
        """Returns the limits without one part; see `Vehicle.without`."""
        if part == "limits":
            return Limits(actuator_bandwidth=self.actuator_bandwidth)
        return replace(self, actuator_bandwidth=None) if part == "lag" else self

    def phrases(self, suspensions: "Sequence[Suspension]") -> tuple[str, ...]:
        """Describes the limits of a vehicle with one phrase per limit; `suspensions` are the suspensions of the vehicle."""
        phrases = []
        if self.stopped:
            phrases += FEATURES.load("stops").stop_words({part.corner: self.stops_at(part.corner) for part in suspensions})
        if self.actuator_force is not None:
            phrases.append(f"{'commands' if self.limits_commands else 'forces'} up to ±{self.actuator_force:g} N")
        if self.force_rate is not None:
            phrases.append(f"commands that change by up to {self.force_rate:g} N/s")
        if self.actuator_bandwidth is not None:
            hertz = rough(self.actuator_bandwidth / (2 * math.pi))
            phrases.append(f"actuators with bandwidth {hertz} Hz ({self.actuator_bandwidth:g} rad/s)")
        return tuple(phrases)


def _text(value: Any) -> str:
    """Returns a value of `[limits]` as text, in the form that it has in a vehicle file."""
    if isinstance(value, tuple):
        return f"[{', '.join(f'{k:g}' for k in value)}]"
    return f"{value:g}" if isinstance(value, float | int) else str(value)


def samples(count: float) -> str:
    """Returns a number of samples as text, such as "2 samples" or "1 sample"."""
    number = f"{count:g}"
    return f"{number} sample{'s' * (number != '1')}"


def delay_text(delay: float) -> str:
    """Returns the delay of the forces [samples] as text."""
    return f"{samples(delay)} late"


def _delay(value: Any, context: Mapping[str, Any]) -> float:
    """Returns a delay in samples of the controller; the type is int if the number is an integer."""
    if not is_finite(value) or not 0 <= value <= MOST_DELAY:
        raise InputError(f"{HERE} = {short_repr(value)} is not allowed; give a number from 0 to {MOST_DELAY}")
    return int(value) if value == int(value) else value


@dataclass(frozen=True, eq=False)
class CommandLimiter:
    """Limiter of the commands of force actuators with a rate limit, for N runs. The commands of runs without a rate limit are
    not changed.

    Attributes:
        largest: largest command [N], shape (N, 1); infinity without a limit.
        change: largest change of a command between two samples [N], shape (N, 1); infinity without a limit.
    """

    largest: Array
    change: Array

    def __call__(self, requested: Array, last: Array) -> Array:
        """Returns the commands of a sample [N]: the requested forces, limited in magnitude and rate.

        Args:
            requested: requested forces [N], shape (N, m).
            last: commands that were applied at the previous sample [N], shape (N, m).
        """
        clipped = np.minimum(np.maximum(requested, -self.largest), self.largest)
        return np.minimum(np.maximum(clipped, last - self.change), last + self.change)


def command_limiter(vehicles: Sequence[Any], timestep: float) -> CommandLimiter | None:
    """Returns the limiter for the commands of N vehicles; None if none of the vehicles has a rate limit.

    Args:
        vehicles: the vehicles. If any of the vehicles has a rate limit, none of the vehicles may have semi-active dampers.
        timestep: sample period of controllers that do not define a sample period [s].
    """
    if all(vehicle.limits.force_rate is None for vehicle in vehicles):
        return None
    unlimited, both = (math.inf, math.inf), list[tuple[float, float]]()
    for limits, how in ((vehicle.limits, vehicle.implementation) for vehicle in vehicles):
        change = None if limits.force_rate is None else limits.force_rate * (how.sample_period or timestep)
        both.append(unlimited if change is None else (limits.largest[0], change))
    return CommandLimiter(*np.array(both).T[..., None])


LATE = "delay from a measurement to the force computed from it, in samples, or as a time"


@dataclass(frozen=True)
class Implementation(Section):
    """Implementation of the controller: sampling, delay, noise and quantisation."""

    public_name = "an implementation, such as vehicle.implementation"

    sample_period: (
        Annotated[
            float, SI("s", "time between two samples, a multiple of the timestep; default: the timestep", high=LONGEST_PERIOD)
        ]
        | None
    ) = None
    delay: Annotated[float, ReadBy(LATE, _delay, allowed=SI("s", low=0, high=MOST_DELAY).json)] = 0
    noise: Annotated[Mapping[str, float], BySignal("rms of the white noise on measured signals")] = field(default_factory=dict)
    quantisation: Annotated[Mapping[str, float], BySignal("resolution of measured signals")] = field(default_factory=dict)
    seed: Annotated[int, Integer("seed of the noise")] = 0

    @property
    def ideal(self) -> bool:
        """True if the controller acts at every timestep, without delay, on exact measurements."""
        return self.undelayed and not self.has_measurement_noise

    @property
    def undelayed(self) -> bool:
        """True if the controller acts at every timestep, without delay."""
        return self.sample_period is None and self.delay == 0

    @property
    def pending_forces(self) -> int:
        """Largest number of computed forces that are still waiting to act when the next force is computed."""
        return math.ceil(self.delay)

    @property
    def hold_intervals(self) -> tuple[tuple[float, int], ...]:
        """Intervals of constant force within a sample period, each with its share of the period and with the delay of its force
        [samples].
        """
        late = math.floor(self.delay)
        share = self.delay - late
        return ((share, late + 1), (1 - share, late)) if share else ((1.0, late),)

    @property
    def has_measurement_noise(self) -> bool:
        """True if the measurements of the controller have noise or quantisation."""
        return bool(self.noise_text)

    @property
    def noise_text(self) -> str:
        """Types of measurement errors as text: noise, quantisation or both; empty for exact measurements."""
        kinds = {"noise": self.noise, "quantisation": self.quantisation}
        return " and ".join(name for name, values in kinds.items() if any(values.values()))

    @property
    def without_noise(self) -> "Implementation":
        """The implementation without noise and quantisation.

        Without noise and quantisation, the implementation is linear, and therefore has a frequency response.
        """
        return replace(self, noise={}, quantisation={})

    def scaled(self, factor: float) -> "Implementation":
        """Returns the implementation with noise and quantisation multiplied by the same factor as the signals."""
        noise = {name: factor * rms for name, rms in self.noise.items()}
        return replace(self, noise=noise, quantisation={name: factor * step for name, step in self.quantisation.items()})

    @property
    def phrases(self) -> tuple[str, ...]:
        """Description of the implementation with one phrase for each property."""
        phrases = []
        if self.sample_period is not None:
            phrases.append(f"a sample every {1e3 * self.sample_period:g} ms")
        if self.delay:
            phrases.append(f"forces that act {delay_text(self.delay)}")
        phrases += [f"noise of {rms:g} rms on {name}" for name, rms in self.noise.items() if rms]
        phrases += [f"{name} quantised in steps of {step:g}" for name, step in self.quantisation.items() if step]
        return tuple(phrases)


def read_limits(section: Mapping[str, Any], suspensions: "Sequence[Suspension]") -> Limits:
    """Reads `[limits]`.

    Args:
        section: the section `[limits]`.
        suspensions: suspensions of the vehicle.

    Raises:
        InputError: a key or section is unknown, a value is not allowed, or only one of stroke and stiffness is given.
    """
    own = {name: one for name, one in section.items() if isinstance(one, Mapping) and name not in STOP_NAMES}
    common = read("[limits]", LimitsSection, {name: one for name, one in section.items() if name not in own})
    limits, corners = Limits(**vars(common)), [part.corner for part in suspensions]
    if not (own or limits.stopped):
        return limits
    if not corners:
        raise InputError(
            f"[limits] {next(iter(section))}: this vehicle type has no suspension, so it cannot have end stops; omit the key"
        )
    return replace(limits, places=tuple(FEATURES.load("stops").read_places(common, own, corners).items()))


@dataclass(frozen=True)
class ImplementationSection(Implementation):
    """Section `[implementation]` of a vehicle file."""

    sampled: Annotated[bool, Flag("design for the sampled-data loop, unless a controller's section sets another value")] = False

    def __post_init__(self) -> None:
        if self.sampled and self.sample_period is None:
            raise InputError(NO_PERIOD)

    @classmethod
    def prepared(cls, given: Mapping[str, Any]) -> Mapping[str, Any]:
        """Returns the section after converting a delay from a time to a number of samples, if the file gives a time."""
        delay, period = given.get("delay"), given.get("sample_period")
        if isinstance(delay, str) and (count := re.fullmatch(r"\s*(\d+\.?\d*) *samples?\s*", delay)):
            return {**given, "delay": float(count[1])}
        seconds = in_unit(delay, "s", "delay")
        if seconds is delay:
            return given
        period = in_unit(period, "s", "sample_period")
        if not is_finite(period) or not period > 0:
            raise InputError(
                f"delay = {short_repr(delay)} is a time, which cannot be converted to samples without a sample period above 0; "
                'give a sample period, as in sample_period = "5 ms", or give delay as a number of samples'
            )
        return {**given, "delay": round(seconds / period, 9)}

    @property
    def implementation(self) -> Implementation:
        """The implementation that the section describes."""
        return Implementation(*(getattr(self, one.name) for one in fields(Implementation)))


def steps_per_sample(implementation: Implementation, timestep: float) -> int:
    """Returns the number of timesteps for which the controller holds its force.

    Raises:
        InputError: the sample period or the delay is not a multiple of the timestep.
    """
    period, delay = implementation.sample_period, implementation.delay
    steps = 1 if period is None else round(period / timestep)
    if period is not None and (steps < 1 or abs(steps * timestep / period - 1) > 1e-9):
        raise InputError(
            f"sample_period = {period:g} s is not a multiple of the timestep {timestep:g} s; give a multiple of the timestep"
        )
    if abs(delay * steps - round(delay * steps)) > 1e-6:
        raise InputError(
            f"delay = {samples(delay)} ({delay * steps * timestep:g} s) is not a multiple of the timestep "
            f"{timestep:g} s, but forces can change only at the start of a timestep; give a multiple of {timestep:g} s, or "
            "a smaller timestep"
        )
    return steps


def hold_intervals(implementation: Implementation, timestep: float) -> tuple[tuple[int, int], ...]:
    """Returns the intervals of constant force within a sample period, each with its length [timesteps] and the delay of its
    force [samples].
    """
    steps = steps_per_sample(implementation, timestep)
    return tuple((round(share * steps), late) for share, late in implementation.hold_intervals)


def check_period(name: str, period: float | None, implementation: Implementation) -> None:
    """Checks that a law with a sample period of its own is implemented with the same sample period.

    Args:
        name: name of the controller, for the message.
        period: sample period of the law [s]; None for a law without a sample period.
        implementation: implementation of the vehicle.

    Raises:
        InputError: the sample period of the law differs from the sample period of the implementation.
    """
    if period is not None and implementation.sample_period != period:
        raise InputError(
            f"[controllers.{name}] has the sample period {period!r} s, but [implementation] has "
            f"{implementation.sample_period or 'none'}; give [implementation] sample_period = {period!r}"
        )
