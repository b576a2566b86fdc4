"""Bump stops, as `[limits]` of a vehicle file says: equal or unequal in bump and rebound, linear or progressive.

A stop begins at the end of its stroke and pushes back with x (k_1 + k_2 x + k_3 x^2) where it is squeezed by x: a rubber stop's
stiffness grows. One number is a linear stop; a list of up to three a progressive one; {bump, rebound} what differs both ways.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from models.common.errors import InputError, quoted

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
