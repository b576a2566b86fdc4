"""Bump stops, as `[limits]` of a vehicle file says: equal or unequal in bump and rebound, linear or progressive, and where.

A stop begins at the end of its stroke and pushes back with x (k_1 + k_2 x + k_3 x^2) where it is squeezed by x: a rubber stop's
stiffness grows. One number is a linear stop; a list of up to three a progressive one; {bump, rebound} what differs both ways.

A section is named as corners are, or as all whose names begin so: `rear` is of rear_left and rear_right. What it leaves out is
what is said of more corners, so that `[limits.rear]` may have a stroke of its own and the stiffness of all.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from models.common.errors import InputError, listing, quoted
from models.suspension import STOP_KEYS

SIDES = ("bump", "rebound")  # the suspension squeezed, and stretched
MOST = 3  # coefficients, as MuJoCo's polynomial springs have
SLACK = 1e3  # m; no suspension is that long
SMALLEST, LARGEST = 1e-6, 1e12  # SI, of numbers above 0

Stiffness = float | tuple[float, ...]


@dataclass(frozen=True)
class Sides:
    """What differs between bump and rebound, each as it would be given for both."""

    bump: Any
    rebound: Any


@dataclass(frozen=True)
class Stop:
    """A bump stop of one side.

    Attributes:
        stroke: travel from rest to where it begins [m].
        stiffness: k_1, k_2 and k_3 [N/m, N/m2, N/m3].
    """

    stroke: float
    stiffness: tuple[float, float, float]


@dataclass(frozen=True)
class Stops:
    """The stops of a suspension, one to each side."""

    bump: Stop
    rebound: Stop

    @property
    def push(self) -> bool:
        """Whether they push back at all."""
        return any(any(one.stiffness) for one in (self.bump, self.rebound))

    @property
    def alike(self) -> bool:
        """Whether one spring with a dead band is both: its force is odd, so has no x^2 in it."""
        return self.bump.stiffness == self.rebound.stiffness and not self.bump.stiffness[1]

    def springs(self, rest: float) -> dict[str, tuple[tuple[float, float], tuple[float, float, float]]]:
        """The springs that they are, by name: where each is slack, from and to, and its coefficients, f = -(a x + b x^2 + c x^3).

        Args:
            rest: length of the suspension at rest [m].
        """
        low, high = rest - self.bump.stroke, rest + self.rebound.stroke
        if self.alike:
            return {"stop": ((low, high), self.bump.stiffness)}
        first, second, third = self.bump.stiffness
        # Beyond the bump's end the spring's x is below 0.
        return {"stop_bump": ((low, SLACK), (first, -second, third)), "stop_rebound": ((-SLACK, high), self.rebound.stiffness)}

    @property
    def words(self) -> str:
        """Both strokes and what the stops are like."""
        if self.bump.stroke == self.rebound.stroke:
            where = f"±{self.bump.stroke:g} m"
        else:
            where = f"-{self.bump.stroke:g} m in bump and +{self.rebound.stroke:g} m in rebound"
        progressive = any(one.stiffness[1:] != (0.0, 0.0) for one in (self.bump, self.rebound))
        return f"{'progressive ' * progressive}bump stops at {where}"


def read_stroke(where: str, value: Any) -> float | Sides:
    """A stroke, or one for each side [m].

    Raises:
        InputError: it is none.
    """
    return _of_sides(where, value, lambda where, one: _number(where, one, "m", SMALLEST))


def read_stiffness(where: str, value: Any) -> Stiffness | Sides:
    """A stiffness [N/m], up to three coefficients, or these for each side.

    Raises:
        InputError: it is none.
    """
    return _of_sides(where, value, _stiffness)


def stops(stroke: float | Sides, stiffness: Stiffness | Sides) -> Stops:
    """The stops of a suspension, from what `read_stroke` and `read_stiffness` give."""
    lengths = [getattr(stroke, side) if isinstance(stroke, Sides) else stroke for side in SIDES]
    springs = [getattr(stiffness, side) if isinstance(stiffness, Sides) else stiffness for side in SIDES]
    return Stops(*(Stop(length, _coefficients(spring)) for length, spring in zip(lengths, springs, strict=True)))


def _coefficients(stiffness: Stiffness) -> tuple[float, float, float]:
    first, second, third = (*(stiffness if isinstance(stiffness, tuple) else (stiffness,)), 0.0, 0.0)[:MOST]
    return first, second, third


def _of_sides(where: str, value: Any, read: Any) -> Any:
    if not isinstance(value, Mapping):
        return read(where, value)
    if set(value) != set(SIDES):
        raise InputError(
            f"{where} = {quoted(dict(value))} is not for both sides; give {{ bump = ..., rebound = ... }}, or one for both"
        )
    return Sides(*(read(f"{where} {side}", value[side]) for side in SIDES))


def _stiffness(where: str, value: Any) -> Stiffness:
    if not isinstance(value, (list, tuple)):
        return _number(where, value, "N/m", SMALLEST)
    if not 1 <= len(value) <= MOST:
        raise InputError(
            f"{where} = {quoted(list(value))} has {len(value)} coefficients; give 1 to {MOST}: of a stop squeezed by x they push "
            "back with k_1 x + k_2 x^2 + k_3 x^3"
        )
    units = ("N/m", "N/m2", "N/m3")
    found = tuple(_number(f"{where}[{i}]", one, unit, 0.0) for i, (one, unit) in enumerate(zip(value, units, strict=False)))
    if not found[0] >= SMALLEST:
        raise InputError(f"{where}[0] = {found[0]:g} is not allowed; give a number from {SMALLEST:g} to {LARGEST:g} N/m")
    return found


def _number(where: str, value: Any, unit: str, smallest: float) -> float:
    allowed = f"a number from {smallest:g} to {LARGEST:g} {unit}"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"{where} = {quoted(value)} is not a number; give {allowed}")
    if not (math.isfinite(value) and smallest <= value <= LARGEST):
        raise InputError(f"{where} = {quoted(value)} is not allowed; give {allowed}")
    return float(value)


READERS: Mapping[str, Callable[[str, Any], Any]] = dict(zip(STOP_KEYS, (read_stroke, read_stiffness), strict=True))


@dataclass(frozen=True)
class Place:
    """What is said of the stops of an axle, or of a corner.

    Attributes:
        name: of it.
        suspension_stroke: travel either way before the bump stop [m], or one for each side; None: that of more corners.
        stop_stiffness: stiffness of the stop [N/m], or the coefficients of a progressive one, or these for each side; likewise.
    """

    name: str
    suspension_stroke: float | Sides | None = None
    stop_stiffness: Stiffness | Sides | None = None

    def holds(self, corner: str) -> bool:
        """Whether a corner is of it; every one is of the place without a name."""
        return not self.name or f"{corner}_".startswith(f"{self.name}_")


def read_places(section: Mapping[str, Any], corners: Sequence[str]) -> tuple[Place, ...]:
    """The stops of `[limits]`: first those of all suspensions, without a name, then those of sections of their own.

    Args:
        section: as it was read, of stops alone.
        corners: names of the suspensions' corners; empty for one that is alone.

    Raises:
        InputError: a section or key that is unknown, a value that is not allowed, a corner with a stroke and no stiffness or the
            other way round.
    """
    if section and not corners:
        raise InputError(f"[limits] {next(iter(section))}: this kind of vehicle has no suspension to stop; leave it out")
    common, known = {name: value for name, value in section.items() if name in STOP_KEYS}, places_of(corners)
    found = [_place("[limits]", "", common)]
    for name, value in section.items():
        if name in STOP_KEYS:
            continue
        if name not in known:
            has = f"sections {listing(known)}" if known else "no sections, for there is one suspension"
            raise InputError(f"[limits.{name}] is no suspension of this vehicle; it has {has}")
        for key in value:
            if key not in STOP_KEYS:
                raise InputError(
                    f"[limits.{name}] unknown key {key!r}; known: {listing(STOP_KEYS)}; the rest is of all suspensions"
                )
        found.append(_place(f"[limits.{name}]", name, value))
    for corner in corners:
        stroke, stiffness = (_said(found, corner, key) for key in STOP_KEYS)
        if (stroke is None) != (stiffness is None):
            where = f" of {corner}" if corner and len(found) > 1 else ""
            raise InputError(
                f"[limits] suspension_stroke [m] and stop_stiffness [N/m]{where} make a bump stop together; give both or neither"
            )
    return tuple(found)


def places_of(corners: Sequence[str]) -> tuple[str, ...]:
    """The names that sections may have: of corners, and of all that begin alike."""
    parts = [corner.split("_") for corner in corners if corner]
    return tuple(dict.fromkeys("_".join(part[:k]) for part in parts for k in range(1, len(part) + 1)))


def stops_at(places: Sequence[Place], corner: str) -> Stops | None:
    """The stops of a corner; None where it has none. Those of a stroke alone, of which nothing is run, push back with nothing."""
    stroke, stiffness = (_said(places, corner, key) for key in STOP_KEYS)
    return None if stroke is None else stops(stroke, stiffness or 0.0)


def stop_words(found: Mapping[str, Stops | None]) -> list[str]:
    """Stops in words, by corner, a phrase for all that are alike."""
    alike: dict[Stops, list[str]] = {}
    for corner, one in found.items():
        if one is not None:
            alike.setdefault(one, []).append(corner)
    return [one.words + _where(corners, list(found)) for one, corners in alike.items()]


def _where(corners: Sequence[str], every: Sequence[str]) -> str:
    """Some corners in words: the shortest names that are theirs alone."""
    if len(corners) == len(every):
        return ""
    names = []
    for name in places_of(every):
        held = [corner for corner in every if Place(name).holds(corner)]
        if {*held} <= {*corners} and not any(Place(other).holds(name) for other in names):
            names.append(name)
    return f" ({', '.join(names)})"


def _place(where: str, name: str, section: Mapping[str, Any]) -> Place:
    said = f"{where} " if name else ""
    return Place(name, **{key: READERS[key](f"{said}{key}", value) for key, value in section.items()})


def _said(places: Sequence[Place], corner: str, key: str) -> Any:
    """What is said of a corner, by the section of fewest corners that says it; None where none does."""
    said = [one for one in places if one.holds(corner) and getattr(one, key) is not None]
    return getattr(max(said, key=lambda one: len(one.name)), key) if said else None
