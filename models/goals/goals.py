"""Goals of a design: what is minimised, within which bounds, for which errors and vehicles, with a gain of which structure."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

EVERYWHERE = (0.0, float("inf"))
WORST, REGRET = "worst", "regret"
CORNER = "corner"


@dataclass(frozen=True, eq=False)
class NormOf:
    """A norm from the road to weighted signals.

    Attributes:
        signals: weights by signal; None for z as `[performance]` weighs it.
        band: from and to [Hz].
    """

    signals: Mapping[str, float] | None = None
    band: tuple[float, float] = EVERYWHERE

    @property
    def record(self) -> dict[str, Any]:
        """As a table of a vehicle file has it."""
        signals = {"signals": dict(self.signals)} if self.signals is not None else {}
        return signals | ({"band": list(self.band)} if self.narrow else {})

    @property
    def narrow(self) -> bool:
        """Whether it is of a band, and not of all frequencies."""
        return self.band != EVERYWHERE

    @property
    def rates(self) -> tuple[float, float]:
        """The band [rad/s]."""
        low, high = self.band
        return 2 * math.pi * low, 2 * math.pi * high

    @property
    def text(self) -> str:
        """In words."""
        low, high = self.band
        where = "" if not self.narrow else f" from {low:g} Hz up" if high == float("inf") else f" from {low:g} to {high:g} Hz"
        of = "" if self.signals is None else f" of {', '.join(self.signals)}"
        return f"norm{of}{where}"


@dataclass(frozen=True, eq=False)
class NormBound:
    """A norm of at most so much."""

    norm: NormOf
    at_most: float


@dataclass(frozen=True)
class PeakBound:
    """A signal's largest magnitude over a road, of at most so much in the signal's unit.

    Attributes:
        signal: its name.
        road: as `--road` takes it.
        speed: [m/s]; None for the usual 12.5 m/s, whatever road it is.
        at_most: the bound.
    """

    signal: str
    road: str
    speed: float | None
    at_most: float


@dataclass(frozen=True)
class EnergyBound:
    """A signal's largest magnitude for all roads of given energy, of at most so much in the signal's unit.

    Attributes:
        signal: its name.
        energy: the integral of the squared velocity under all wheels together [m2/s].
        at_most: the bound.
    """

    signal: str
    energy: float
    at_most: float


@dataclass(frozen=True)
class DecayBound:
    """All poles left of -rate [rad/s]."""

    rate: float


@dataclass(frozen=True)
class GainBound:
    """No entry of the gain larger than this."""

    at_most: float


Bound = NormBound | PeakBound | EnergyBound | DecayBound | GainBound


@dataclass(frozen=True, eq=False)
class Goals:
    """Of one controller.

    Attributes:
        minimise: the norm whose largest value over all vehicles and errors is minimised.
        bounds: each is kept for all vehicles; norms and decay for all errors, too.
        tolerance: how far each measured signal, and each force, may be off, relative, independent of one another.
        family: the vehicles, each as factors on parameters, or as the name of a vehicle file; empty for the file's own alone.
        over: over the family "worst" minimises the largest norm, "regret" the largest ratio to a vehicle's own best.
        structure: which measurement may act on which force, a row a force; None for every one.
    """

    minimise: NormOf = field(default_factory=NormOf)
    bounds: tuple[Bound, ...] = ()
    tolerance: Mapping[str, float] = field(default_factory=dict)
    family: tuple[Mapping[str, float], ...] = ()
    over: str = WORST
    structure: tuple[tuple[bool, ...], ...] | None = None

    @property
    def record(self) -> dict[str, Any]:
        """As the section of a vehicle file has them."""
        minimise = self.minimise.record | ({"over": self.over} if self.over != WORST else {})
        found: dict[str, Any] = {"minimise": minimise} if minimise else {}
        if self.bounds:
            found["bounds"] = [_bound(bound) for bound in self.bounds]
        if self.tolerance:
            found["tolerance"] = dict(self.tolerance)
        if self.family:
            found["family"] = [dict(member) for member in self.family]
        if self.structure is not None:
            found["structure"] = [[int(each) for each in row] for row in self.structure]
        return found or {"minimise": {}}


def _bound(bound: Bound) -> dict[str, Any]:
    """A bound as a table of a vehicle file has it."""
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


def signals_of(goals: Goals | None) -> tuple[str, ...]:
    """The signals that are minimised or bounded, beside those of `[performance]`."""
    if goals is None:
        return ()
    norms = (goals.minimise, *(bound.norm for bound in goals.bounds if isinstance(bound, NormBound)))
    peaks = [bound.signal for bound in goals.bounds if isinstance(bound, (PeakBound, EnergyBound))]
    return (*(name for norm in norms for name in norm.signals or ()), *peaks)
