"""Bump stops of `[limits]` in a vehicle file: linear or progressive, equal or unequal in bump and rebound, per corner or axle.

A stop begins at the end of its stroke and pushes back with x (k_1 + k_2 x + k_3 x^2) if compressed by x: the stiffness of
rubber grows. One number is a linear stop, a list of up to three numbers a progressive one, and {bump, rebound} has one for each
side. An omitted side has no stop.

A section has the name of a corner, or the common beginning of several names: `rear` is rear_left and rear_right. A key that it
leaves out is taken from the section with more corners. So `[limits.rear]` may have its own stroke and the common stiffness.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.checks import number_within
from models.common.errors import InputError, listing, quoted
from models.suspension import STOP_KEYS

SIDES = ("bump", "rebound")  # the suspension squeezed, and stretched
MOST = 3  # coefficients, as MuJoCo's polynomial springs have
SLACK = 1e3  # m; larger strokes are refused, as no suspension is that long
SMALLEST, LARGEST = 1e-6, 1e12  # SI, of numbers above 0

Stiffness = float | tuple[float, ...]


@dataclass(frozen=True)
class StopPair:
    """Different values for bump and rebound; None of a side without a stop."""

    bump: Any
    rebound: Any


@dataclass(frozen=True)
class Stop:
    """Bump stop of one side.

    Attributes:
        stroke: travel from rest to its beginning [m]; infinite without a stop.
        stiffness: k_1, k_2 and k_3 [N/m, N/m2, N/m3].
    """

    stroke: float
    stiffness: tuple[float, float, float]

    def acts(self, beyond: Array) -> Array:
        """Returns its force [N] at a compression [m], shape (...)."""
        first, second, third = self.stiffness
        return beyond * (first + beyond * (second + beyond * third))

    def work(self, beyond: Array) -> Array:
        """Returns its stored energy [J] at a compression [m], shape (...)."""
        first, second, third = self.stiffness
        return beyond**2 * (first / 2 + beyond * (second / 3 + beyond * third / 4))


@dataclass(frozen=True)
class Stops:
    """Bump stops of a suspension, one for each side."""

    bump: Stop
    rebound: Stop

    @property
    def sides(self) -> dict[str, tuple[float, Stop]]:
        """Returns sign of the deflection and stop of each side that has one, by `SIDES`."""
        both = zip(SIDES, ((-1.0, self.bump), (1.0, self.rebound)), strict=True)
        return {side: (sign, stop) for side, (sign, stop) in both if math.isfinite(stop.stroke)}

    def at_wheel(self, ratio: float) -> "Stops":
        """Returns the stops that act so at the wheel, through a motion ratio."""
        if ratio == 1:
            return self
        powers = ratio ** np.arange(2, 2 + MOST)
        both = (self.bump, self.rebound)
        return Stops(*(Stop(one.stroke / ratio, tuple((powers * one.stiffness).tolist())) for one in both))

    @property
    def acts(self) -> bool:
        """True if they push back at all."""
        return any(any(stop.stiffness) for stop in (self.bump, self.rebound))

    @property
    def alike(self) -> bool:
        """True if one spring with a dead band replaces both: its force is odd, without x^2."""
        return self.bump.stiffness == self.rebound.stiffness and not self.bump.stiffness[1]

    def pull(self, deflection: Array) -> Array:
        """Returns the force that pulls body and wheel together [N], at deflections from rest [m], shape (...)."""
        return sum((sign * stop.acts(beyond) for sign, stop, beyond in self._squeezed(deflection)), np.zeros_like(deflection))

    def work(self, deflection: Array) -> Array:
        """Returns the energy that they store at deflections from rest [J], shape (...)."""
        return sum((stop.work(beyond) for _, stop, beyond in self._squeezed(deflection)), np.zeros_like(deflection))

    def _squeezed(self, deflection: Array) -> tuple[tuple[float, Stop, Array], ...]:
        """Returns sign, stop and how far it is compressed [m] for each side that has one."""
        return tuple((sign, stop, np.maximum(sign * deflection - stop.stroke, 0.0)) for sign, stop in self.sides.values())

    def springs(self, rest: float) -> dict[str, tuple[tuple[float, float], tuple[float, float, float]]]:
        """Returns the springs by name: the ends of the dead band, and the coefficients, f = -(a x + b x^2 + c x^3).

        Args:
            rest: length of the suspension at rest [m].
        """
        low, high = rest - self.bump.stroke, rest + self.rebound.stroke
        if self.alike:
            return {"stop": ((low, high), self.bump.stiffness)}
        first, second, third = self.bump.stiffness
        # Beyond the bump's end the spring's x is below 0.
        both = {
            "stop_bump": ((low, SLACK), (first, -second, third)),
            "stop_rebound": ((-SLACK, high), self.rebound.stiffness),
        }
        return {name: both[name] for side in self.sides if (name := f"stop_{side}")}

    @property
    def words(self) -> str:
        """Both strokes and the type of the stops."""
        if self.bump.stroke == self.rebound.stroke:
            where = f"±{self.bump.stroke:g} m"
        else:
            where = " and ".join(f"{sign * stop.stroke:+g} m in {side}" for side, (sign, stop) in self.sides.items())
        progressive = any(stop.stiffness[1:] != (0.0, 0.0) for stop in (self.bump, self.rebound))
        return f"{'progressive ' * progressive}bump stops at {where}"


def read_stroke(where: str, value: Any) -> float | StopPair:
    """Reads a stroke, or one for each side [m].

    Raises:
        InputError: the value is not allowed.
    """
    return _of_sides(where, value, lambda where, stroke: number_within(where, stroke, SMALLEST, LARGEST, "m"))


def read_stiffness(where: str, value: Any) -> Stiffness | StopPair:
    """Reads a stiffness [N/m], up to three coefficients, or these for each side.

    Raises:
        InputError: the value is not allowed.
    """
    return _of_sides(where, value, _stiffness)


def stops(stroke: float | StopPair, stiffness: Stiffness | StopPair) -> Stops:
    """Returns the stops of a suspension, from the results of `read_stroke` and `read_stiffness`."""
    lengths = [getattr(stroke, side) if isinstance(stroke, StopPair) else stroke for side in SIDES]
    springs = [getattr(stiffness, side) if isinstance(stiffness, StopPair) else stiffness for side in SIDES]
    return Stops(
        *(
            Stop(math.inf, (0.0, 0.0, 0.0)) if length is None or spring is None else Stop(length, _coefficients(spring))
            for length, spring in zip(lengths, springs, strict=True)
        )
    )


def _coefficients(stiffness: Stiffness) -> tuple[float, float, float]:
    first, second, third = (*(stiffness if isinstance(stiffness, tuple) else (stiffness,)), 0.0, 0.0)[:MOST]
    return first, second, third


def _of_sides(where: str, value: Any, read: Any) -> Any:
    if not isinstance(value, Mapping):
        return read(where, value)
    given = {side: one for side, one in value.items() if one is not None}  # a log has null for a side without a stop
    if not given or not set(given) <= set(SIDES):
        raise InputError(
            f"{where} = {quoted(dict(value))} is of no side; give {{ bump = ..., rebound = ... }}, one of these, or a number"
        )
    return StopPair(*(read(f"{where} {side}", given[side]) if side in given else None for side in SIDES))


def _stiffness(where: str, value: Any) -> Stiffness:
    if not isinstance(value, (list, tuple)):
        return number_within(where, value, SMALLEST, LARGEST, "N/m")
    if not 1 <= len(value) <= MOST:
        raise InputError(
            f"{where} = {quoted(list(value))} has {len(value)} coefficients; give 1 to {MOST}: of a stop compressed by x they "
            "push back with k_1 x + k_2 x^2 + k_3 x^3"
        )
    units = ("N/m", "N/m2", "N/m3")
    least = (SMALLEST, 0.0, 0.0)
    return tuple(number_within(f"{where}[{i}]", k, least[i], LARGEST, units[i]) for i, k in enumerate(value))


READERS: Mapping[str, Callable[[str, Any], Any]] = dict(zip(STOP_KEYS, (read_stroke, read_stiffness), strict=True))


@dataclass(frozen=True)
class Place:
    """Keys of the stops of a corner, an axle, or all corners.

    Attributes:
        name: name of the corner or axle; empty for all.
        suspension_stroke: travel either way before the bump stop [m], or one for each or one side; None: that of more corners.
        stop_stiffness: stiffness of the stop [N/m], or the coefficients of a progressive one, or these for each side; likewise.
    """

    name: str
    suspension_stroke: float | StopPair | None = None
    stop_stiffness: Stiffness | StopPair | None = None

    def holds(self, corner: str) -> bool:
        """Returns True if a corner belongs to the place."""
        return not self.name or f"{corner}_".startswith(f"{self.name}_")


def read_places(section: Mapping[str, Any], corners: Sequence[str]) -> tuple[Place, ...]:
    """Returns the stops of `[limits]`: first those of all suspensions, without a name, then those of sections of their own.

    Args:
        section: section of the file, of stops alone.
        corners: names of the suspensions' corners; empty for a single suspension.

    Raises:
        InputError: a section or key is unknown, a value is not allowed, or a corner has only one of stroke and stiffness.
    """
    if section and not corners:
        raise InputError(f"[limits] {next(iter(section))}: this vehicle type has no suspension to stop; omit the key")
    common, known = {name: value for name, value in section.items() if name in STOP_KEYS}, places_of(corners)
    places = [_place("[limits]", "", common)]
    for name, value in section.items():
        if name in STOP_KEYS:
            continue
        if name not in known:
            has = f"sections {listing(known)}" if known else "no sections, for there is one suspension"
            raise InputError(f"[limits.{name}] is not a suspension of this vehicle; it has {has}, and keys {listing(STOP_KEYS)}")
        for key in value:
            if key not in STOP_KEYS:
                raise InputError(
                    f"[limits.{name}] unknown key {key!r}; known: {listing(STOP_KEYS)}; the rest is of all suspensions"
                )
        places.append(_place(f"[limits.{name}]", name, value))
    for corner in corners:
        stroke, stiffness = (_said(places, corner, key) for key in STOP_KEYS)
        if (stroke is None) != (stiffness is None):
            where = f" of {corner}" if corner and len(places) > 1 else ""
            raise InputError(
                f"[limits] suspension_stroke [m] and stop_stiffness [N/m]{where} make a bump stop together; give both or neither"
            )
        if isinstance(stroke, StopPair) and isinstance(stiffness, StopPair):
            for side in SIDES:
                if getattr(stroke, side) is not None and getattr(stiffness, side) is None:
                    where = f" of {corner}" if corner else ""
                    raise InputError(f"[limits] suspension_stroke{where} has {side}, stop_stiffness does not; give it there, too")
    return tuple(places)


def places_of(corners: Sequence[str]) -> tuple[str, ...]:
    """Returns the possible names of sections: corners, and common beginnings of their names."""
    parts = [corner.split("_") for corner in corners if corner]
    return tuple(dict.fromkeys("_".join(part[:k]) for part in parts for k in range(1, len(part) + 1)))


def stops_at(places: Sequence[Place], corner: str) -> Stops | None:
    """Returns the stops of a corner, or None if it has no stroke. Without a stiffness they push back with nothing."""
    stroke, stiffness = (_said(places, corner, key) for key in STOP_KEYS)
    return None if stroke is None else stops(stroke, stiffness or 0.0)


def stop_words(by_corner: Mapping[str, Stops | None]) -> list[str]:
    """Describes stops by corner, with one phrase for all corners with equal stops."""
    alike: dict[Stops, list[str]] = {}
    for corner, stops in by_corner.items():
        if stops is not None:
            alike.setdefault(stops, []).append(corner)
    return [stops.words + _where(corners, list(by_corner)) for stops, corners in alike.items()]


def _where(corners: Sequence[str], corners_of_vehicle: Sequence[str]) -> str:
    """Names some corners by the shortest names that fit them alone."""
    if len(corners) == len(corners_of_vehicle):
        return ""
    names = []
    for name in places_of(corners_of_vehicle):
        members = [corner for corner in corners_of_vehicle if Place(name).holds(corner)]
        if {*members} <= {*corners} and not any(Place(other).holds(name) for other in names):
            names.append(name)
    return f" ({', '.join(names)})"


def _place(where: str, name: str, section: Mapping[str, Any]) -> Place:
    said = f"{where} " if name else ""
    return Place(name, **{key: READERS[key](f"{said}{key}", value) for key, value in section.items()})


def _said(places: Sequence[Place], corner: str, key: str) -> Any:
    """Returns a key of a corner's stops, from the section with the fewest corners that has it, or None if no section has it."""
    places_with_key = [place for place in places if place.holds(corner) and getattr(place, key) is not None]
    return getattr(max(places_with_key, key=lambda place: len(place.name)), key) if places_with_key else None
