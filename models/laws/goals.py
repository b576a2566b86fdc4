"""Goals of a design from a controller's section: objective, bounds, tolerances, family and structure.

minimise = { signals = "performance", band = [4.0, 8.0], over = "worst" }
bounds = [{ norm = 8.6 }, { peak = "suspension_deflection", road = "bump", at_most = 0.09 }, { decay = 1.2 }, { gain = 2e4 }]
tolerance = { suspension_deflection = 0.1, sprung_velocity = 0.1, force = 0.05 }
family = [{ sprung_mass = 0.7 }, {}, { sprung_mass = 1.4, tyre_stiffness = 1.25 }]
structure = "corner"
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from models.common.checks import check_keys, is_finite, number_within, table_within
from models.common.errors import InputError, listing, quoted

EVERYWHERE = (0.0, float("inf"))
WORST, REGRET = "worst", "regret"
CORNER = "corner"


@dataclass(frozen=True, eq=False)
class NormOf:
    """Norm from the road to weighted signals.

    Attributes:
        signals: weights by signal; None for z of `[performance]`.
        band: lower and upper frequency [Hz].
    """

    signals: Mapping[str, float] | None = None
    band: tuple[float, float] = EVERYWHERE

    @property
    def record(self) -> dict[str, Any]:
        """The norm as a table of a vehicle file has it."""
        signals = {"signals": dict(self.signals)} if self.signals is not None else {}
        return signals | ({"band": list(self.band)} if self.narrow else {})

    @property
    def narrow(self) -> bool:
        """True for a norm in a band, False for all frequencies."""
        return self.band != EVERYWHERE

    @property
    def rates(self) -> tuple[float, float]:
        """The band [rad/s]."""
        low, high = self.band
        return 2 * math.pi * low, 2 * math.pi * high

    @property
    def text(self) -> str:
        """The norm as text."""
        low, high = self.band
        where = "" if not self.narrow else f" from {low:g} Hz up" if high == float("inf") else f" from {low:g} to {high:g} Hz"
        of = "" if self.signals is None else f" of {', '.join(self.signals)}"
        return f"norm{of}{where}"


@dataclass(frozen=True, eq=False)
class NormBound:
    """Upper bound on a norm."""

    norm: NormOf
    at_most: float


@dataclass(frozen=True)
class PeakBound:
    """Upper bound on a signal's largest magnitude over a road, in the signal's unit.

    Attributes:
        signal: name of the signal.
        road: road in the form of `--road`.
        speed: vehicle speed [m/s]; None for 12.5 m/s on any road.
        at_most: the bound.
    """

    signal: str
    road: str
    speed: float | None
    at_most: float


@dataclass(frozen=True)
class EnergyBound:
    """Upper bound on a signal's largest magnitude over all roads of given energy, in the signal's unit.

    Attributes:
        signal: name of the signal.
        energy: the integral of the squared velocity under all wheels together [m2/s].
        at_most: the bound.
    """

    signal: str
    energy: float
    at_most: float


@dataclass(frozen=True)
class DecayBound:
    """Bound on the poles: all left of -rate [rad/s]."""

    rate: float


@dataclass(frozen=True)
class GainBound:
    """Upper bound on the size of the gain's entries."""

    at_most: float


Bound = NormBound | PeakBound | EnergyBound | DecayBound | GainBound


@dataclass(frozen=True, eq=False)
class Goals:
    """Goals of one controller.

    Attributes:
        minimise: the norm whose largest value over all vehicles and errors is minimised.
        bounds: bounds for all vehicles; norms and decay for all errors, too.
        tolerance: largest relative error of each measured signal, and each force, independent of one another, as in the file
            see `force_error`.
        family: the vehicles, each as factors on parameters, or as the name of a vehicle file; empty for the file's own alone.
        over: objective over a family: "worst" minimises the largest norm, "regret" the largest ratio to a vehicle's own best.
        structure: True if a measurement may act on a force, a row per force; None for no restriction.
    """

    minimise: NormOf = field(default_factory=NormOf)
    bounds: tuple[Bound, ...] = ()
    tolerance: Mapping[str, float] = field(default_factory=dict)
    family: tuple[Mapping[str, float], ...] = ()
    over: str = WORST
    structure: tuple[tuple[bool, ...], ...] | None = None

    @property
    def signals(self) -> tuple[str, ...]:
        """Signals that are minimised or bounded, beside those of `[performance]`."""
        norms = (self.minimise, *(bound.norm for bound in self.bounds if isinstance(bound, NormBound)))
        peaks = [bound.signal for bound in self.bounds if isinstance(bound, (PeakBound, EnergyBound))]
        return (*(name for norm in norms for name in norm.signals or ()), *peaks)

    def force_error(self, force: str) -> float:
        """Returns the largest relative error of an actuator's force.

        A force that is measured has its reading's error under its own name. `force` gives its actuator another one.
        """
        return self.tolerance.get(FORCE, self.tolerance.get(force, 0.0))

    @property
    def roads(self) -> tuple[str, ...]:
        """Names of the bounds' roads."""
        return tuple(bound.road for bound in self.bounds if isinstance(bound, PeakBound))

    @property
    def record(self) -> dict[str, Any]:
        """The goals as in the section of a vehicle file."""
        minimise = self.minimise.record | ({"over": self.over} if self.over != WORST else {})
        section: dict[str, Any] = {"minimise": minimise} if minimise else {}
        if self.bounds:
            section["bounds"] = [_described(bound) for bound in self.bounds]
        if self.tolerance:
            section["tolerance"] = dict(self.tolerance)
        if self.family:
            section["family"] = [dict(member) for member in self.family]
        if self.structure is not None:
            section["structure"] = [[int(allowed) for allowed in row] for row in self.structure]
        return section or {"minimise": {}}


def _described(bound: Bound) -> dict[str, Any]:
    """Returns a bound as a table of a vehicle file has it."""
    match bound:
        case NormBound(norm, at_most):
            return {"norm": at_most, **norm.record}
        case DecayBound(rate):
            return {"decay": rate}
        case GainBound(at_most):
            return {"gain": at_most}
        case EnergyBound(signal, energy, at_most):
            return {"energy_peak": signal, "energy": energy, "at_most": at_most}
        case PeakBound(signal, road, speed, at_most):
            driven = {"speed": speed} if speed is not None else {}
            return {"peak": signal, "road": road, **driven, "at_most": at_most}


PERFORMANCE = "performance"
FORCE = "force"  # in a tolerance: all actuators' forces
SMALLEST, LARGEST = 1e-9, 1e12
HIGHEST = 1e6  # Hz, of a band; no vehicle has anything there
LARGEST_TOLERANCE = 0.9  # relative: a sensor that may be off by its whole reading says nothing
LOWEST_FACTOR, HIGHEST_FACTOR = 0.1, 10.0  # of a parameter in a family

BOUND_KINDS = {  # further keys of a bound, and an example
    "norm": (("signals", "band"), "{ norm = 8.6 }"),
    "peak": (("road", "speed", "at_most"), "{ peak = SIGNAL, road = ROAD, at_most = 0.09 }"),
    "energy_peak": (("energy", "at_most"), "{ energy_peak = SIGNAL, energy = 0.02, at_most = 0.09 } (m2/s)"),
    "decay": ((), "{ decay = 1.2 } (rad/s)"),
    "gain": ((), "{ gain = 2e4 }"),
}


def read_goals(
    where: str,
    entry: Mapping[str, Any],
    measured: Sequence[str],
    outputs: Collection[str],
    corners: Mapping[str, str],
    parameters: Collection[str] = (),
) -> Goals:
    """Reads the goals of a section that has some.

    Args:
        where: the section, for messages.
        entry: entries of the controller's section.
        measured: names of the measured signals.
        outputs: names of all signals.
        corners: suffix of the names at a force's suspension, by force; empty for a single suspension.
        parameters: names of the parameters that a family can vary.

    Raises:
        InputError: a key or a number that is not allowed.
    """
    minimise, over = _minimise(where, entry.get("minimise", {}), outputs)
    family = _family(where, entry.get("family"), parameters)
    if over == REGRET and not family:
        raise InputError(
            f'{where} minimise has over = "regret", which needs a family; add family = [{{ ... }}, ...], or omit over'
        )
    return Goals(
        minimise,
        _bounds(where, entry.get("bounds", []), outputs),
        _tolerance(where, entry.get("tolerance", {}), measured, tuple(corners)),
        family,
        over,
        read_structure(where, entry.get("structure"), measured, corners),
    )


def _minimise(where: str, value: Any, outputs: Collection[str]) -> tuple[NormOf, str]:
    table_within(f"{where} minimise", value, "a table, as in minimise = { band = [4.0, 8.0] } with frequencies in Hz")
    check_keys(f"{where} minimise", value, ("signals", "band", "over"))
    over = value.get("over", WORST)
    if over not in (WORST, REGRET):
        raise InputError(
            f'{where} minimise has over = {quoted(over)}; give "{WORST}" for the largest norm in the family, or "{REGRET}" for '
            "the largest ratio of a vehicle's norm to its own smallest norm"
        )
    return _norm(f"{where} minimise", value, outputs), over


def _norm(where: str, value: Mapping[str, Any], outputs: Collection[str]) -> NormOf:
    signals, band = value.get("signals", PERFORMANCE), value.get("band")
    weights = None
    if isinstance(signals, str) and signals != PERFORMANCE:
        signals = [signals]
    if isinstance(signals, list):
        if len(signals) != len({*map(repr, signals)}):
            raise InputError(f"{where} contains a signal twice; list each signal once")
        signals = {name if isinstance(name, str) else quoted(name): 1.0 for name in signals}
    if isinstance(signals, dict):
        for name, weight in signals.items():
            if name not in outputs:
                raise InputError(f"{where} has the unknown signal {quoted(name)}; the signals are {listing(outputs)}")
            number_within(f"{where} the weight of {name}", weight, SMALLEST, LARGEST)
        weights = {name: float(weight) for name, weight in signals.items()}
    elif signals != PERFORMANCE:
        weights = {}
    if weights is not None and not weights:
        raise InputError(
            f'{where} signals = {quoted(value["signals"])} is not allowed; give "performance", or a table of signals and '
            "weights, as in { sprung_acceleration = 1.0 }"
        )
    if band is None:
        return NormOf(weights)
    fits = isinstance(band, list) and len(band) == 2 and all(is_finite(end) for end in band)
    if not fits or not 0 <= band[0] < band[1] <= HIGHEST:
        raise InputError(
            f"{where} band = {quoted(band)} is not allowed; give the lowest and highest frequency, up to {HIGHEST:g} Hz, as "
            "in band = [4.0, 8.0], or omit band for all frequencies"
        )
    ends = (float(band[0]), float(band[1]))
    return NormOf(weights, ends if ends != EVERYWHERE else EVERYWHERE)


def _bounds(where: str, value: Any, outputs: Collection[str]) -> tuple[Bound, ...]:
    if not isinstance(value, list) or not all(isinstance(bound, dict) for bound in value):
        raise InputError(f"{where} bounds = {quoted(value)} is not a list of tables; give one, as in bounds = [{{ norm = 8.6 }}]")
    return tuple(_bound(f"{where} bounds[{i}]", bound, outputs) for i, bound in enumerate(value))


def _bound(where: str, value: Mapping[str, Any], outputs: Collection[str]) -> Bound:
    kinds = [key for key in BOUND_KINDS if key in value]
    if len(kinds) != 1:
        raise InputError(
            f"{where} = {quoted(dict(value))} is not a bound; give one of {', '.join(text for _, text in BOUND_KINDS.values())}"
        )
    kind = kinds[0]
    check_keys(where, value, (kind, *BOUND_KINDS[kind][0]))
    if kind == "norm":
        return NormBound(_norm(where, value, outputs), number_within(f"{where} norm", value["norm"], SMALLEST, LARGEST))
    if kind == "decay":
        return DecayBound(number_within(f"{where} decay", value["decay"], SMALLEST, LARGEST, "rad/s"))
    if kind == "gain":
        return GainBound(number_within(f"{where} gain", value["gain"], SMALLEST, LARGEST))
    signal, road = value[kind], value.get("road", "bump")
    if signal not in outputs:
        raise InputError(f"{where} has the unknown signal {quoted(signal)}; the signals are {listing(outputs)}")
    if "at_most" not in value:
        raise InputError(f"{where} has no at_most; give the largest allowed magnitude of {signal} in SI units as at_most")
    at_most = number_within(f"{where} at_most", value["at_most"], SMALLEST, LARGEST)
    if kind == "energy_peak":
        return EnergyBound(signal, number_within(f"{where} energy", value.get("energy", 1.0), SMALLEST, LARGEST, "m2/s"), at_most)
    if not isinstance(road, str):
        raise InputError(f'{where} road = {quoted(road)} is not a road; give its name, as in road = "bump:height=0.08"')
    speed = number_within(f"{where} speed", value["speed"], 0.1, 200.0, "m/s") if "speed" in value else None
    return PeakBound(signal, road, speed, at_most)


def _tolerance(where: str, value: Any, measured: Sequence[str], forces: Sequence[str]) -> dict[str, float]:
    give = f"the largest relative error of each sensor, as in tolerance = {{ {measured[0]} = 0.1 }} for 10 %"
    table_within(f"{where} tolerance", value, give)
    allowed = (*measured, *(force for force in forces if force not in measured), FORCE)
    for name, share in value.items():
        if name not in allowed:
            raise InputError(f"{where} tolerance: unknown key {quoted(name)}; give {listing(allowed)} ({FORCE} is all forces)")
        more = " as a relative error (0.1 is 10 %), or a table { weight = ... } for an error that depends on frequency"
        number_within(f"{where} tolerance of {name}", share, 0.0, LARGEST_TOLERANCE, more=more)
    if FORCE in value and any(force in value for force in forces if force not in measured):
        raise InputError(f"{where} tolerance has both {FORCE}, which means all forces, and a single force; give one of the two")
    return {name: float(share) for name, share in value.items()}


def _family(where: str, value: Any, parameters: Collection[str]) -> tuple[Mapping[str, float], ...]:
    if value is None:
        return ()
    if not isinstance(value, list) or not value or not all(isinstance(member, dict) for member in value):
        raise InputError(
            f"{where} family = {quoted(value)} is not a list of vehicles; give each vehicle's factors on parameters, as in "
            "family = [{}, { sprung_mass = 1.4 }]"
        )
    for i, member in enumerate(value):
        for name, factor in member.items():
            if name not in parameters:
                raise InputError(f"{where} family[{i}] has no parameter {quoted(name)}; the parameters are {listing(parameters)}")
            number_within(f"{where} family[{i}] the factor on {name}", factor, LOWEST_FACTOR, HIGHEST_FACTOR)
    return tuple({name: float(factor) for name, factor in member.items()} for member in value)


def read_structure(
    where: str, value: Any, measured: Sequence[str], corners: Mapping[str, str]
) -> tuple[tuple[bool, ...], ...] | None:
    """Reads which measurement may act on which force, True where one may, a row per force; None if `value` is.

    Args:
        value: "corner", or rows of 0 and 1.
        corners: suffix of the names at a force's suspension, by force.

    Raises:
        InputError: the value is neither, or it omits a signal or a force.
    """
    if value is None:
        return None
    if value == CORNER:
        rows = tuple(tuple(not ending or signal.endswith(ending) for signal in measured) for ending in corners.values())
        for signal, used in zip(measured, zip(*rows, strict=True), strict=True):
            if not any(used):
                raise InputError(
                    f'{where} structure = "{CORNER}", but {signal!r} belongs to no corner; measure signals with the endings of '
                    f"the forces {listing(corners)}, or give structure as a list of rows of 0 and 1, one row for each force"
                )
        for force, row in zip(corners, rows, strict=True):
            if not any(row):
                raise InputError(
                    f'{where} structure = "{CORNER}", but no measured signal is from the corner of {force!r}; add one'
                )
        return rows
    fits = isinstance(value, list) and len(value) == len(corners) and all(isinstance(row, list) for row in value)
    if not fits or not all(len(row) == len(measured) and all(entry in (0, 1) for entry in row) for row in value):
        raise InputError(
            f'{where} structure = {quoted(value)} is not allowed; give "{CORNER}", or a list of {len(corners)} row(s), one for '
            f"each force, with {len(measured)} number(s) 0 or 1, one for each measured signal"
        )
    if not any(any(row) for row in value):
        raise InputError(f"{where} structure has only zeros, so the gain is 0; give a 1 where a signal may act on a force")
    return tuple(tuple(bool(entry) for entry in row) for row in value)
