"""Design goals in a controller's section: objective, bounds, tolerances, family and structure.

minimise = { signals = "performance", band = [4.0, 8.0], over = "worst" }
bounds = [{ norm = 8.6 }, { peak = "suspension_deflection", road = "bump", at_most = 0.09 }, { decay = 1.2 }, { gain = 2e4 }]
tolerance = { suspension_deflection = 0.1, sprung_velocity = 0.1, force = 0.05 }
family = [{ sprung_mass = 0.7 }, {}, { sprung_mass = 1.4, tyre_stiffness = 1.25 }]
structure = "corner"
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Annotated, Any

from models.common.checks import is_finite
from models.common.errors import InputError, alike, list_names, short_repr
from models.common.schema import (
    HERE,
    NUMBER,
    PAIR,
    SI,
    TEXT,
    BySignal,
    Choice,
    ListedValues,
    ReadBy,
    Section,
    Subsection,
    Text,
    read,
)
from models.common.units import in_unit
from models.laws.design_methods import PATTERNS, PI, PID
from models.laws.filter import Filter, FilterSection

EVERYWHERE = (0.0, float("inf"))
WORST, REGRET = "worst", "regret"
CORNER = "corner"
PERFORMANCE = "performance"
FORCE = "force"  # key of the table `tolerance` for gain errors of all actuators
SMALLEST = 1e-9
HIGHEST = 1e6  # largest frequency of a band [Hz], far above all dynamics of a vehicle
OVER = (
    f'; "{WORST}" is the largest norm in the family, "{REGRET}" the largest ratio of a vehicle\'s norm to its own smallest norm'
)
EITHER = " as a relative error (0.1 is 10 %), or a table { weight = ... } for an error that depends on frequency"
# The relative gain error of a sensor is limited, because a sensor with a relative error of 1 would carry no information
ERROR = SI("1", "", 0.0, 0.9, EITHER)
COEFFICIENTS = ", or numerator and denominator as coefficients in descending powers of s"
WEIGHT = SI("1", "", 1e-6, 1e6, COEFFICIENTS)  # weight of a gain error that is the same at all frequencies


def _weighted_signals(value: Any, context: Mapping[str, Any]) -> dict[str, float] | None:
    """Returns the weight of each signal in a norm; if the file lists signals without weights, all weights are 1.

    The result is None if the norm applies to the output z of `[performance]`.
    """
    if value == PERFORMANCE:
        return None
    names = [value] if isinstance(value, str) else value
    if isinstance(names, list | tuple):
        if len(names) != len({*map(repr, names)}):
            raise InputError(f"{HERE} contains a signal twice; list each signal once")
        value = {name if isinstance(name, str) else short_repr(name): 1.0 for name in names}
    if not isinstance(value, Mapping) or not value:
        raise InputError(
            f'{HERE} = {short_repr(names)} is not allowed; give "{PERFORMANCE}", or a table of signals and weights, as in '
            "{ sprung_acceleration = 1.0 }"
        )
    return BySignal(low=SMALLEST, unit="1").read(value, context)


def _band(value: Any, context: Mapping[str, Any]) -> tuple[float, float]:
    """Returns the lowest and the highest frequency of a frequency band [Hz]."""
    ends = [in_unit(one, "Hz", HERE) for one in value] if isinstance(value, list | tuple) else []
    if len(ends) != 2 or not all(map(is_finite, ends)) or not 0 <= ends[0] < ends[1] <= HIGHEST:
        raise InputError(
            f"{HERE} = {short_repr(value)} is not allowed; give the lowest and highest frequency, up to {HIGHEST:g} Hz, as "
            "in band = [4.0, 8.0], or omit band for all frequencies"
        )
    return float(ends[0]), float(ends[1])


@dataclass(frozen=True)
class NormOf(Section):
    """Norm of the response from the road to weighted signals."""

    signals: Annotated[Mapping[str, float], ReadBy("weights by signal, or `performance`", _weighted_signals)] | None = None
    band: Annotated[
        tuple[float, float],
        ReadBy("lowest and highest frequency; default: all", _band, "Hz", PAIR),
    ] = EVERYWHERE

    @property
    def narrow(self) -> bool:
        """True if the norm covers only a frequency band, False if it covers all frequencies."""
        return self.band != EVERYWHERE

    @property
    def rates(self) -> tuple[float, float]:
        """Lowest and highest angular frequency of the band [rad/s]."""
        low, high = self.band
        return 2 * math.pi * low, 2 * math.pi * high

    @property
    def text(self) -> str:
        """Text that describes the norm: its signals and its band."""
        low, high = self.band
        where = "" if not self.narrow else f" from {low:g} Hz up" if high == float("inf") else f" from {low:g} to {high:g} Hz"
        of = "" if self.signals is None else f" of {', '.join(self.signals)}"
        return f"norm{of}{where}"


@dataclass(frozen=True)
class Minimise(NormOf):
    """The norm that is minimised, and the rule that combines the norms of a vehicle family."""

    over: Annotated[str, Choice("what is minimised over a family of vehicles", (WORST, REGRET), OVER)] = WORST


def _signal(value: Any, context: Mapping[str, Any]) -> str:
    """Returns the name of an output signal."""
    if not isinstance(value, str) or value not in context["signals"]:
        raise InputError(f"{HERE}: unknown signal {short_repr(value)}; give one of {alike(value, context['signals'])}")
    return value


def _magnitude(value: Any, context: Mapping[str, Any]) -> float:
    """Returns the largest magnitude that a bound of a vehicle file allows for a signal [SI]. The vehicle file gives the largest
    magnitude in the unit of the signal.
    """
    signal = context.get("peak", context.get("energy_peak"))
    return SI(context["signals"].get(signal, "1"), low=SMALLEST).number(HERE, value)


AtMost = Annotated[float, ReadBy("largest allowed magnitude, in the unit of the signal", _magnitude, allowed=NUMBER)]


@dataclass(frozen=True, kw_only=True)
class NormBound(NormOf):
    """Upper bound on a norm."""

    norm: Annotated[float, SI("1", "upper bound on a norm", SMALLEST)]


@dataclass(frozen=True)
class PeakBound(Section):
    """Upper bound on the peak magnitude of a signal over a road."""

    peak: Annotated[str, ReadBy("signal whose largest magnitude over a road has a bound", _signal, allowed=TEXT)]
    at_most: AtMost
    road: Annotated[str, Text("road, as for `roadproof drive --road`", ', as in "bump:height=0.08"')] = "bump"
    speed: Annotated[float, SI("m/s", "speed of the vehicle; 12.5 m/s without this key", 0.1, 200.0)] | None = None


@dataclass(frozen=True)
class EnergyBound(Section):
    """Upper bound on the peak magnitude of a signal for all roads with a given energy."""

    energy_peak: Annotated[
        str, ReadBy("signal whose largest magnitude over all roads of a given energy has a bound", _signal, allowed=TEXT)
    ]
    at_most: AtMost
    energy: Annotated[
        float, SI("m2/s", "energy of the road: integral of its squared velocity, summed over all wheels", SMALLEST)
    ] = 1.0


@dataclass(frozen=True)
class DecayBound(Section):
    """Bound on the poles: the real parts of all poles are below minus the decay rate."""

    decay: Annotated[float, SI("rad/s", "smallest rate of decay of the loop", SMALLEST)]


@dataclass(frozen=True)
class GainBound(Section):
    """Upper bound on the magnitude of all entries of the gain matrix."""

    gain: Annotated[float, SI("1", "largest magnitude of an entry of the gain", SMALLEST)]


Bound = NormBound | PeakBound | EnergyBound | DecayBound | GainBound
BOUNDS = (NormBound, PeakBound, EnergyBound, DecayBound, GainBound)
EXAMPLES = (
    "a bound, one of { norm = 8.6 }, { peak = SIGNAL, road = ROAD, at_most = 0.09 }, "
    "{ energy_peak = SIGNAL, energy = 0.02, at_most = 0.09 } (m2/s), { decay = 1.2 } (rad/s), { gain = 2e4 }"
)


def _tolerance(value: Any, context: Mapping[str, Any]) -> dict[str, float | Filter]:
    """Returns the relative uncertainties of measured signals and forces by name: numbers, or frequency-dependent weights."""
    measured = context.get("measured", ())
    if not isinstance(value, Mapping):
        raise InputError(
            f"{HERE} = {short_repr(value)} is not a table; give the largest relative error of each sensor, as in tolerance = "
            f"{{ {next(iter(measured), FORCE)} = 0.1 }} for 10 %"
        )
    forces = [force for force in context["corners"] if force not in measured]
    if wrong := [name for name in value if name not in (*measured, *forces, FORCE)]:
        allowed = list_names((*measured, *forces, FORCE))
        raise InputError(f"{HERE}: unknown key {short_repr(wrong[0])}; give {allowed} ({FORCE} stands for all forces)")
    if FORCE in value and any(force in value for force in forces):
        raise InputError(f"{HERE} has both {FORCE}, which stands for all forces, and a single force; give only one of the two")
    return {name: _error(f"{HERE}.{name}", one) for name, one in value.items()}


def _error(where: str, given: Any) -> float | Filter:
    """Returns the relative uncertainty of a signal; if the uncertainty depends on frequency, returns its weight."""
    if not isinstance(given, Mapping):
        return ERROR.number(where, given)
    if set(given) != {"weight"}:
        raise InputError(
            f"{where} = {short_repr(dict(given))} is not allowed; give the largest relative error (0.1 for 10 %), or "
            "{ weight = { numerator = [...], denominator = [...] } } with coefficients in descending powers of s"
        )
    weight = given["weight"]
    if not isinstance(weight, Mapping):
        return Filter((((WEIGHT.number(f"{where}.weight", weight),), (1.0,)),))
    return read(f"{where}.weight", FilterSection, weight).shape


def _structure(value: Any, context: Mapping[str, Any]) -> str | tuple[tuple[bool, ...], ...]:
    """Returns a row for each force, with True for each measurement that may act on this force, or the name of a law structure."""
    measured, corners = context.get("measured", ()), context["corners"]
    if value in PATTERNS:
        return value
    if value == CORNER:
        return corner_rows(f'{HERE} = "{CORNER}"', measured, corners)
    fits = isinstance(value, list | tuple) and len(value) == len(corners) and all(isinstance(row, list | tuple) for row in value)
    if not fits or not all(len(row) == len(measured) and all(entry in (0, 1) for entry in row) for row in value):
        raise InputError(
            f'{HERE} = {short_repr(value)} is not allowed; give "{CORNER}", "{PI}", "{PID}", or a list of '
            f"{len(corners)} row(s) (one for each force), each with {len(measured)} number(s) (one for each measured "
            "signal), where every number is 0 or 1"
        )
    if not any(any(row) for row in value):
        raise InputError(
            f"{HERE} has only zeros, so every entry of the gain would be 0; give a 1 where a signal may act on a force"
        )
    return tuple(tuple(bool(entry) for entry in row) for row in value)


def corner_rows(what: str, measured: Sequence[str], corners: Mapping[str, str]) -> tuple[tuple[bool, ...], ...]:
    """Returns a row for each force, with True for each measurement at the corner of the force.

    Args:
        what: name of the key in the vehicle file, for use in messages.
        measured: names of the measured signals.
        corners: suffix of the signal names at the suspension on which each force acts.

    Raises:
        InputError: a signal belongs to no corner, or a corner has no signal.
    """
    rows = tuple(tuple(not ending or signal.endswith(ending) for signal in measured) for ending in corners.values())
    for signal, used in zip(measured, zip(*rows, strict=True), strict=True):
        if not any(used):
            raise InputError(
                f"{what}, but the signal {signal!r} belongs to no corner; measure only signals whose names have the "
                f"same ending as one of the forces {list_names(corners)}, or give structure as a list with a row of 0 "
                "and 1 for each force"
            )
    for force, row in zip(corners, rows, strict=True):
        if not any(row):
            raise InputError(
                f"{what}, but no measured signal belongs to the corner of {force!r}; measure a signal of this corner"
            )
    return rows


FAMILY = "factors by which each vehicle changes parameters"
FACTORS = ListedValues("", BySignal("", "parameters", 0.1, 10.0, "1"), f", {FAMILY}, as in [{{}}, {{ sprung_mass = 1.4 }}]")


@dataclass(frozen=True, kw_only=True)
class Goals(Section):
    """Goals of one controller, given as keys of its section.

    In a vehicle file, `tolerance` may also contain weights of uncertainties, and `structure` may also be the structure of a
    dynamic law.
    """

    minimise: Annotated[
        Minimise, Subsection("norm that is minimised", (Minimise,), "a table, as in { band = [4.0, 8.0] } with frequencies in Hz")
    ] = field(default_factory=Minimise)
    bounds: Annotated[
        tuple[Bound, ...],
        ListedValues(
            "bounds that hold for all vehicles and errors", Subsection("", BOUNDS, EXAMPLES), ", as in [{ norm = 8.6 }]", 0
        ),
    ] = ()
    tolerance: Annotated[
        Mapping[str, Any], ReadBy("largest relative errors of measured signals and forces, by name", _tolerance)
    ] = field(default_factory=dict)
    family: Annotated[tuple[Mapping[str, float], ...], ReadBy(f"{FAMILY}, or a file with them", FACTORS.read)] = ()
    structure: Annotated[Any, ReadBy("a row of 0 and 1 for each force, or `corner`, `pi` or `pid`", _structure)] = None

    def __post_init__(self) -> None:
        if self.over == REGRET and not self.family:
            raise InputError(
                'minimise has over = "regret", which is computed over a family of vehicles, but no family is given; '
                "add family = [{ ... }, ...], or omit over"
            )

    @property
    def goals(self) -> "Goals":
        """The goals that also apply to a static gain: no frequency-dependent uncertainties, no structures of dynamic laws."""
        own: dict[str, Any] = {one.name: getattr(self, one.name) for one in fields(Goals)}
        own["tolerance"] = {name: one for name, one in self.tolerance.items() if not isinstance(one, Filter)}
        own["structure"] = None if self.structure in PATTERNS else self.structure
        return Goals(**own)

    @property
    def over(self) -> str:
        """Rule that combines the norms of a vehicle family into the value that is minimised."""
        return self.minimise.over

    @property
    def signals(self) -> tuple[str, ...]:
        """Signals that are minimised or bounded, in addition to the signals in `[performance]`."""
        norms = (self.minimise, *(bound for bound in self.bounds if isinstance(bound, NormBound)))
        peaks = [bound.peak for bound in self.bounds if isinstance(bound, PeakBound)]
        peaks += [bound.energy_peak for bound in self.bounds if isinstance(bound, EnergyBound)]
        return (*(name for norm in norms for name in norm.signals or ()), *peaks)

    def force_error(self, force: str) -> float:
        """Returns the relative uncertainty of an actuator's force.

        If a controller measures the force, the key with the name of the force gives the uncertainty of this measurement. The
        key `force` then gives the uncertainty of the actuator.
        """
        return self.tolerance.get(FORCE, self.tolerance.get(force, 0.0))

    @property
    def roads(self) -> tuple[str, ...]:
        """Names of the roads that occur in the bounds."""
        return tuple(bound.road for bound in self.bounds if isinstance(bound, PeakBound))

    @property
    def record(self) -> dict[str, Any]:
        """The goals as keys of a controller's section."""
        section = {key: value for key, value in super().record.items() if value}
        if self.structure is not None:
            section["structure"] = [[int(allowed) for allowed in row] for row in self.structure]
        return section or {"minimise": {}}
