"""`[actuators]` of a vehicle file: each suspension has a force actuator or a semi-active damper.

A valve sets the damping coefficient c of a semi-active damper to a value between c_min and c_max. The damper gives the force
-c v, where v is the velocity at which the damper's suspension extends. The linear model, equation (28) of the paper, contains
the nominal damping coefficient c_s. The control force u is the difference between the damper's force and the force with the
nominal coefficient:

    u = -(c - c_s) v.

If a controller commands a control force u*, the valve sets the coefficient that gives the force u*, between c_min and c_max:

    c = clip(c_s - u* / v, c_min, c_max).

For a damper with characteristics, the coefficient is c = clip(c_s - u* / h(v), c_min, c_max), where h(v) is defined below. At
each sample of the controller, the coefficient is computed from the damper's velocity, and then held until the next sample. If
the velocity v is 0 but the commanded force u* is not 0, v counts as slightly negative. If the velocity v and the commanded
force u* are both 0, the damper has the nominal coefficient.

Measured characteristics can replace c_min and c_max: the force against velocity at the softest setting, F_min, and at the
firmest setting, F_max (`models.parts`). At the valve setting s, a number from 0 (softest) to 1 (firmest), the damper pulls with
the force

    F = (1 - s) F_min(v) + s F_max(v) = F_min(v) + (c - c_min) h(v),    h = (F_max - F_min) / (c_max - c_min),

where the coefficients c_min and c_max are the slopes of the characteristics F_min and F_max at v = 0. Instead of s, the damping
coefficient at v = 0, c = c_min + s (c_max - c_min), can also define the valve setting. The function h(v) is a velocity, and its
derivative at v = 0 is 1. If the damper's characteristics are straight lines, h(v) = v and the force is F = c v; otherwise, h(v)
can be nonlinear.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np

from models.characteristics.curve import STRAIGHT, ForceCurve
from models.characteristics.curve_reading import VELOCITY, curve_of
from models.common.arrays import Array
from models.common.errors import InputError, error_in, list_names
from models.common.schema import HERE, SI, SMALLEST, Choice, ReadBy, Section, read

# Two characteristics count as touching if their forces differ by less than this share of the largest force
TOUCHING_DISTANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Envelope:
    """Softest and firmest characteristic of a semi-active damper.

    Attributes:
        soft: characteristic at the softest setting.
        hard: characteristic at the firmest setting.
    """

    soft: ForceCurve
    hard: ForceCurve

    @cached_property
    def knots(self) -> Array:
        """Velocities at which the softest or the firmest characteristic has a point [m/s], shape (n,)."""
        return np.unique(np.concatenate([self.soft.x, self.hard.x]))

    @cached_property
    def shape(self) -> ForceCurve:
        """The function h(v) [m/s] of the damper's velocity v [m/s], as defined in this module."""
        x = self.knots
        bent = (self.hard.pieces.force(x) - self.soft.pieces.force(x)) / (self.hard.slope - self.soft.slope)
        return ForceCurve(x, x + bent, 1.0, "the difference of the damper's settings")

    @property
    def line(self) -> float:
        """Slope of the function h(v) at velocity 0; if the slopes on the two sides of 0 differ, the smaller slope."""
        rest = int(np.searchsorted(self.knots, 0.0))
        return float(self.shape.slopes[rest : rest + 2].min())

    @property
    def ramps(self) -> tuple[tuple[float, float, int], ...]:
        """Ramps whose sum is the difference between h(v) and a straight line: for each ramp, the knot at which the ramp begins
        [m/s], the slope, and 1 or -1. A ramp with 1 acts at velocities above its knot, and a ramp with -1 acts at velocities
        below its knot.

        The slope of a ramp that begins at 0 is never negative, because MuJoCo would interpret the bias of the ramp's actuator
        as a damping ratio.
        """
        x, slopes = self.knots, self.shape.slopes
        rest = int(np.searchsorted(x, 0.0))
        ramps = [(0.0, float(slopes[rest + 1]) - self.line, 1), (0.0, float(slopes[rest]) - self.line, -1)]
        ramps += [(float(x[i]), float(slopes[i + 1] - slopes[i]), 1) for i in range(rest + 1, len(x))]
        ramps += [(float(x[i]), float(slopes[i] - slopes[i + 1]), -1) for i in range(rest)]
        return tuple(ramp for ramp in ramps if abs(ramp[1]) > STRAIGHT * np.abs(slopes).max())

    @property
    def straight(self) -> bool:
        """True if both characteristics of the damper are straight lines."""
        return not len(self.soft.pieces.slope) and not len(self.hard.pieces.slope)

    def same(self, other: "Envelope | None") -> bool:
        """Returns True if another pair of characteristics is equal to this pair."""
        if other is None:
            return False
        pairs = ((self.soft, other.soft), (self.hard, other.hard))
        return all(np.array_equal(a.x, b.x) and np.array_equal(a.force, b.force) for a, b in pairs)


def pair_of(soft: ForceCurve, hard: ForceCurve) -> Envelope:
    """Returns the softest and the firmest characteristic as one object, which limits the force of a semi-active damper.

    Args:
        soft: characteristic at the softest setting.
        hard: characteristic at the firmest setting.

    Raises:
        InputError: the firmest setting does not have a larger force than the softest setting at every velocity.
    """
    pair = Envelope(soft, hard)
    x, largest = pair.knots, max(soft.range, hard.range)
    low, high = (curve.slope * x + curve.pieces.force(x) for curve in (soft, hard))
    for i in np.flatnonzero((x != 0) & ((high - low) * np.sign(x) <= TOUCHING_DISTANCE * largest))[:1].tolist():
        raise InputError(
            f"at {x[i]:g} m/s, the force is {low[i]:g} N for c_min and {high[i]:g} N for c_max, but c_max must be the "
            "firmest setting; give c_max a larger force than c_min at every velocity"
        )
    if not soft.slope < hard.slope:
        raise InputError(
            f"at velocity 0, the slope is {soft.slope:g} N s/m for c_min and {hard.slope:g} N s/m for c_max, but "
            "c_max must be the firmest setting; give c_max the larger slope"
        )
    for end, side in ((0, "below the first points"), (-1, "beyond the last points")):
        if hard.slopes[end] < soft.slopes[end] - TOUCHING_DISTANCE * abs(soft.slopes[end]):
            raise InputError(
                f"{side}, c_min continues with a slope of {soft.slopes[end]:g} N s/m and c_max with a slope of "
                f"{hard.slopes[end]:g} N s/m, so the two curves cross; change the outermost points so that the curves "
                "do not cross"
            )
    return pair


KINDS = ("force", "damper")
CURVE_KEYS = ("c_min", "c_max")  # keys of an adjustable damper whose values may be tables


@dataclass(frozen=True)
class Damper:
    """Semi-active damper.

    Attributes:
        c_min: smallest damping coefficient [N s/m]; for a damper with characteristics, the slope of `soft` at velocity 0.
        c_max: largest damping coefficient [N s/m]; for a damper with characteristics, the slope of `hard` at velocity 0.
        bandwidth: corner frequency of the valve's first-order lag between commanded and actual coefficient [rad/s]; None for a
            valve that has no lag.
        pair: softest and firmest characteristic of the damper; None if both characteristics are straight lines.
        replaces: True if the semi-active damper replaces the suspension's own damper.
    """

    replaces: ClassVar[bool] = True

    c_min: float
    c_max: float
    bandwidth: float | None = None
    pair: Envelope | None = None

    def among(self, elements: Sequence[Any]) -> "Damper":
        """Returns the semi-active damper as it acts in a vehicle that also has the given elements of `[parts]`."""
        return self

    @property
    def words(self) -> str:
        """Description of the semi-active damper in a phrase."""
        lag = "" if self.bandwidth is None else f", with a valve of bandwidth {self.bandwidth:g} rad/s"
        between = "" if self.pair is None else " at velocity 0, between two curves"
        return f"a semi-active damper of {self.c_min:g} to {self.c_max:g} N s/m{between}{lag}"


def _coefficient(setting: str, low: float) -> ReadBy:
    """Returns the declaration of the key that gives a damper's coefficient, or its table of force against velocity, at one
    setting.
    """
    number = SI("N s/m", f"coefficient at the {setting} setting, or the table of its force", low)

    def read(value: Any, context: Mapping[str, Any]) -> float | ForceCurve:
        return curve_of(HERE, value, VELOCITY) if isinstance(value, Mapping) else number.read(value, context)

    return ReadBy(number.meaning, read, number.unit, {"anyOf": [number.json, {"type": "object"}]})


@dataclass(frozen=True)
class ActuatorSection(Section):
    """`[actuators]` of a vehicle file: keys for all suspensions, or for one suspension."""

    by_place: ClassVar[bool] = True

    kind: Annotated[str, Choice("`force` for actuators that push, `damper` for semi-active dampers", KINDS)] = KINDS[0]
    c_min: Annotated[Any, _coefficient("softest", 0.0)] = None
    c_max: Annotated[Any, _coefficient("firmest", SMALLEST)] = None
    bandwidth: Annotated[float, SI("rad/s", "corner frequency of the valve, a first-order lag of the coefficient")] | None = None

    def __post_init__(self) -> None:
        given = [name for name in (*CURVE_KEYS, "bandwidth") if getattr(self, name) is not None]
        if self.kind == KINDS[0]:
            if given:
                raise InputError(
                    f'has {given[0]}, which needs kind = "damper"; give kind = "damper", or, for force actuators, '
                    f"omit {given[0]} and give actuator_force and actuator_bandwidth in [limits]"
                )
            return
        if absent := [name for name in CURVE_KEYS if name not in given]:
            raise InputError(f"{absent[0]} is missing; give both c_min and c_max of the semi-active damper, in N s/m")
        tables = [name for name in CURVE_KEYS if isinstance(getattr(self, name), ForceCurve)]
        if len(tables) == 1:
            (other,) = {*CURVE_KEYS} - {*tables}
            raise InputError(
                f"{tables[0]} is a curve, but {other} is a number; give c_min and c_max as two curves, or as two numbers in N s/m"
            )
        if not tables and not self.c_min < self.c_max:
            raise InputError(
                f"c_min = {self.c_min:g} N s/m is not below c_max = {self.c_max:g} N s/m; give a smaller c_min, or a larger c_max"
            )

    @property
    def damper(self) -> Damper | None:
        """The semi-active damper; None for a force actuator.

        Raises:
            InputError: the characteristics are not valid for a damper.
        """
        if self.kind == KINDS[0]:
            return None
        if not isinstance(self.c_min, ForceCurve):
            return Damper(self.c_min, self.c_max, self.bandwidth)
        pair = pair_of(self.c_min, self.c_max)
        for name, low in (("c_min", 0.0), ("c_max", SMALLEST)):
            SI("N s/m", low=low).number(name, getattr(self, name).slope)
        return Damper(self.c_min.slope, self.c_max.slope, self.bandwidth, None if pair.straight else pair)


def read_actuators(section: Mapping[str, Any], corners: Mapping[str, str], limited: Sequence[str]) -> dict[str, Damper]:
    """Reads `[actuators]` and returns the semi-active dampers, by the name of the control force that each damper produces.

    Args:
        section: section `[actuators]` with keys for all dampers, and with sections for single dampers. The section of a single
            damper is named after the suffix of the damper's control force.
        corners: suffix of the name of each control force, including the underscore.
        limited: keys in `[limits]` of the file that limit force actuators.

    Raises:
        InputError: a key is unknown, a value is not allowed, or `[limits]` limits force actuators.
    """
    endings = {ending.removeprefix("_"): force for force, ending in corners.items() if ending}
    single = {name: value for name, value in section.items() if isinstance(value, Mapping) and name not in CURVE_KEYS}
    if unknown := [name for name in single if name not in endings]:
        known = f"give one of {list_names(endings)}" if endings else "omit the section, as there is only one suspension"
        raise InputError(f"[actuators.{unknown[0]}] is not a suspension of this vehicle; {known}")
    common = {name: value for name, value in section.items() if name not in single}
    if not corners and section:
        raise InputError("[actuators]: no suspension of this vehicle type has an actuator; omit the section [actuators]")
    dampers = {}
    for force, ending in corners.items():
        own = single.get(ending.removeprefix("_")) if ending else None
        where = "[actuators]" if own is None else f"[actuators{ending.replace('_', '.', 1)}]"
        usual = {} if own and own.get("kind") == KINDS[0] else common
        given = read(where, ActuatorSection, {**usual, **(own or {})})
        with error_in(f"{where}:"):
            damper = given.damper
        if damper is not None:
            dampers[force] = damper
    if dampers:
        check_unlimited(limited, "[actuators] has semi-active dampers")
    return dampers


def check_unlimited(limited: Sequence[str], what: str) -> None:
    """Checks that `[limits]` has no limits for force actuators. The argument `what` describes the dampers in the error message.

    Raises:
        InputError: a key of `[limits]` limits force actuators.
    """
    if limited:
        raise InputError(
            f"[limits] {limited[0]} applies only to force actuators, but {what}; omit {limited[0]}, or give actuators "
            '= "force" in the section of each controller that is to use force actuators'
        )
