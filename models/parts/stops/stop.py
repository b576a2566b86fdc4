"""Bump stops in `[limits]` of a vehicle file: linear or progressive, equal or different in bump and rebound, for each corner or
axle.

A stop makes contact when the suspension has travelled the stop's stroke. A stop that is compressed by x pushes back with the
force x (k_1 + k_2 x + k_3 x^2), because the stiffness of rubber grows with compression. A single number in the file is the
stiffness of a linear stop. A list of up to three numbers describes a progressive stop, and a table contains the force at each
compression. The form {bump, rebound} gives a value for each side; an omitted side has no stop.

If the file gives a stroke for a side, the table contains the force as a function of the compression of the stop. If the file
gives no stroke, the table contains the force against the compression of the suspension; the force is 0 up to the stop. For the
rebound stop, the negative compressions in the table are used, if the table has any.

The name of a section in `[limits]` is the name of a corner, or the common beginning of several names. For example, `rear` means
rear_left and rear_right. If a key is missing in a section, its value is taken from a section that applies to more corners. For
example, `[limits.rear]` may define a stroke for the rear axle, and use the common stiffness.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from models.characteristics import SIDES, STOP_KEYS, STOP_NAMES
from models.common.arrays import Array
from models.common.errors import InputError, error_in, list_names
from models.common.schema import HERE, read
from models.parts.stops.section import MOST, StopPair, StopSection

if TYPE_CHECKING:
    from models.characteristics.curve import ForceCurve

SLACK = 1e3  # largest allowed stroke [m]; no suspension has more travel than this
ROUNDING = 1e-9  # a force below this share of the largest force of its table counts as 0


@dataclass(frozen=True)
class StopTable:
    """Table of the force of a stop against compression. The force is interpolated linearly, and extrapolated with the slope at
    the end of the table.

    Attributes:
        compression: compression of the stop or of the suspension, ascending [m].
        force: force at each compression [N], positive if the force resists compression.
        fit_error: largest error of an approximation of the table with fewer points, relative to the largest force; None for the
            default.
        note: phrase with a remark about the table.
    """

    compression: tuple[float, ...]
    force: tuple[float, ...]
    fit_error: float | None = None
    note: str = ""

    def __str__(self) -> str:
        return f"table of {len(self.force)} points up to {max(map(abs, self.force)):g} N"

    @cached_property
    def curve(self) -> "ForceCurve":
        """The table of the force against the compression of the stop; the force is 0 before the first point."""
        from models.characteristics.curve import ForceCurve
        from models.characteristics.curve_reading import as_lines

        x, force, words = as_lines(np.array(self.compression), np.array(self.force), self.fit_error)
        return ForceCurve(np.array([-1.0, *x]), np.array([0.0, *force]), 0.0, words)


@lru_cache(maxsize=64)
def stop_of(table: StopTable, sign: float, stroke: float | None) -> "Stop | None":
    """Returns the stop that a table describes for one side; None if no stroke is given and the table contains no force on this
    side.

    Args:
        table: table of the force against the compression of the stop or, without a stroke, of the suspension.
        sign: sign of the suspension's deflection on the side of the stop.
        stroke: travel to the contact with the stop [m]; None if the table contains this travel.

    Raises:
        InputError: the stop makes contact in equilibrium or at a travel that differs from the stroke, or pulls instead of
            pushing.
    """
    u, force = np.array(table.compression), np.array(table.force)
    if sign > 0 and (stroke is None or (force < 0)[u < 0].any()):
        u, force = -u[::-1], -force[::-1]
    if u[0] < 0 < u[-1] and 0.0 not in u:
        i = int(np.searchsorted(u, 0.0))
        u, force = np.insert(u, i, 0.0), np.insert(force, i, np.interp(0.0, u, force))
    force = np.where(np.abs(force) <= ROUNDING * np.abs(force).max(), 0.0, force)[u >= 0]
    u = u[u >= 0]
    for i in np.flatnonzero(force < 0)[:1].tolist():
        raise InputError(
            f"its table gives a pulling force of {-force[i]:.6g} N at {u[i]:g} m, but a stop can only push; give "
            "forces that push back"
        )
    if not force.any():
        if stroke is None:
            return None
        raise InputError(
            "every force of its table at positive compression is 0, so the stop would never push back; give forces "
            "above 0 at positive compression of the stop"
        )
    first = int(np.flatnonzero(force)[0]) - 1
    if first < 0 or (stroke is None and not u[first]):
        raise InputError(
            f"its table pushes back with {force[first + 1]:.6g} N at {u[first + 1]:g} m, but has no point where "
            "contact begins; begin with 0 N at contact. If the stop touches at rest, add its table to "
            "suspension_stiffness, as in [22e3, { ... }]"
        )
    if stroke is not None and u[first]:
        raise InputError(
            f"its table begins with a gap of {u[first]:g} m, but suspension_stroke already gives a gap of {stroke:g} "
            "m; omit one of the two gaps"
        )
    if force[-1] < force[-2]:
        raise InputError(
            f"its table ends with a falling force, {force[-1]:.6g} N, and the force would continue to fall beyond the "
            "table; make the last slope zero or positive"
        )
    gap, u, force = float(u[first]), u[first:] - u[first], force[first:]
    cut = StopTable(tuple(u.tolist()), tuple(force.tolist()), table.fit_error, table.note)
    return Stop(gap if stroke is None else stroke, cut)


Stiffness = float | tuple[float, ...] | StopTable


@dataclass(frozen=True)
class Stop:
    """Bump stop on one side of a suspension.

    Attributes:
        stroke: travel from equilibrium to the contact with the stop [m]; infinity without a stop.
        stiffness: k_1, k_2 and k_3 [N/m, N/m2, N/m3], or the table of the stop's force.
    """

    stroke: float
    stiffness: tuple[float, float, float] | StopTable

    @property
    def pushes(self) -> bool:
        """True if the stop gives any force."""
        return isinstance(self.stiffness, StopTable) or any(self.stiffness)

    def at_wheel(self, ratio: float) -> "Stop":
        """Returns the equivalent stop at the wheel for the motion ratio r: its force is r F(r x) if this stop has the force
        F(x).
        """
        law = self.stiffness
        if isinstance(law, StopTable):
            both = (law.compression, 1 / ratio), (law.force, ratio)
            compression, force = (tuple(factor * x for x in values) for values, factor in both)
            return Stop(self.stroke / ratio, replace(law, compression=compression, force=force))
        first, second, third = law
        return Stop(self.stroke / ratio, (first * ratio**2, second * ratio**3, third * ratio**4))

    def acts(self, beyond: Array) -> Array:
        """Returns the force of the stop [N] at a compression [m], shape (...)."""
        if isinstance(self.stiffness, StopTable):
            return self.stiffness.curve(beyond)
        first, second, third = self.stiffness
        return beyond * (first + beyond * (second + beyond * third))

    def work(self, beyond: Array) -> Array:
        """Returns the energy stored in the stop [J] at a compression [m], shape (...)."""
        if isinstance(self.stiffness, StopTable):
            return self.stiffness.curve.work(beyond)
        first, second, third = self.stiffness
        return beyond**2 * (first / 2 + beyond * (second / 3 + beyond * third / 4))


BumpAndRebound = tuple[Stop, Stop]  # stops in bump and rebound; the stroke of a side without a stop is infinite


def pair_words(pair: BumpAndRebound) -> str:
    """Describes the strokes in bump and rebound, and the type of the stops of a suspension."""
    bump, rebound = pair
    given = [(sign, side, stop) for sign, side, stop in zip((-1.0, 1.0), SIDES, pair, strict=True) if math.isfinite(stop.stroke)]
    if bump.stroke == rebound.stroke:
        where = f"±{bump.stroke:g} m"
    else:
        where = " and ".join(f"{sign * stop.stroke:+g} m in {side}" for sign, side, stop in given)
    laws = [stop.stiffness for *_, stop in given]
    if tables := [law for law in laws if isinstance(law, StopTable)]:
        notes = "".join(f", {law.note}" for law in dict.fromkeys(tables) if law.note)
        return f"bump stops with tables at {where}{notes}"
    progressive = any(law[1:] != (0.0, 0.0) for law in laws if not isinstance(law, StopTable))
    return f"{'progressive ' * progressive}bump stops at {where}"


def stops(stroke: float | StopPair | None, stiffness: Stiffness | StopPair) -> BumpAndRebound:
    """Returns the stops of a suspension in bump and rebound.

    Args:
        stroke: one stroke for both sides, or a stroke for each side [m].
        stiffness: one stiffness, list of coefficients or table for both sides, or a separate stiffness, list or table for each
            side.

    Raises:
        InputError: a table is not valid for a stop; see `stop_of`.
    """
    both = []
    for side, sign in zip(SIDES, (-1.0, 1.0), strict=True):
        length, spring = _of_side(stroke, side), _of_side(stiffness, side)
        stop = None
        if isinstance(spring, StopTable):
            with error_in(f"{side}:"):
                stop = stop_of(spring, sign, length)
                if stop is None and isinstance(stiffness, StopPair):
                    here, there = ("compression", "extension")[:: -int(sign)]
                    own = ", or give suspension_stroke if the table is a function of the compression of the stop"
                    raise InputError(
                        f"its table has forces only in {there}, and every force in {here} is 0; give forces in "
                        f"{here}{own if sign > 0 else ''}"
                    )
        elif isinstance(stiffness, StopPair) and isinstance(stroke, StopPair) and (length is None) != (spring is None):
            has, other = STOP_KEYS[:: 1 if spring is None else -1]
            raise InputError(f"{side}: {has} is given without {other}; give both for {side}, or neither")
        elif length is not None and spring is not None:
            first, second, third = (*(spring if isinstance(spring, tuple) else (spring,)), 0.0, 0.0)[:MOST]
            stop = Stop(length, (first, second, third))
        both.append(stop or Stop(math.inf, (0.0, 0.0, 0.0)))
    return both[0], both[1]


def _of_side(value: Any, side: str) -> Any:
    return getattr(value, side) if isinstance(value, StopPair) else value


def read_stop_table(value: Mapping[str, Any]) -> StopTable:
    """Returns the table of a stop in a vehicle file. Messages about the table of a stop contain `HERE` instead of its key."""
    from models.characteristics.curve_reading import StopTableSection

    given = read(HERE, StopTableSection, value)
    x, force = (-values[::-1] for values in given.points)
    if not force.any():
        raise InputError(f"{HERE} has a table in which every force is 0; give forces that resist bump or rebound")
    if x[-1] < 0 and not force[-1]:
        x, force = np.append(x, 0.0), np.append(force, 0.0)  # the table of a rebound stop begins where the stop makes contact
    table = StopTable(tuple(x.tolist()), tuple(force.tolist()), given.fit_error, given.note)
    with error_in(f"{HERE}:"):
        # This line raises an InputError if too many segments are needed to approximate the table
        _ = table.curve if x[-1] >= 0 else None
    return table


def holds(place: str, corner: str) -> bool:
    """Returns True if a corner belongs to a place: a corner, an axle, or all corners if the name of the place is empty."""
    return not place or f"{corner}_".startswith(f"{place}_")


def read_places(common: StopSection, own: Mapping[str, Any], corners: Sequence[str]) -> dict[str, StopSection]:
    """Returns the sections of corners and axles that contain keys of bump stops, by name.

    Args:
        common: keys of bump stops for all suspensions.
        own: sections of `[limits]` for corners and axles.
        corners: names of the corners that have suspensions; one empty name for a single suspension.

    Raises:
        InputError: a section or key is unknown, a value is not allowed, or a corner has only one of stroke and stiffness.
    """
    known, places = places_of(corners), {"": common}
    for name, value in own.items():
        if name not in known:
            has = f"the sections {list_names(known)}" if known else "no sections, because there is only one suspension"
            raise InputError(
                f"[limits.{name}] is not a suspension of this vehicle; omit {'or rename ' * bool(known)}this section. "
                f"[limits] allows the keys {list_names(STOP_NAMES)}, and {has}"
            )
        places[name] = read(f"[limits.{name}]", StopSection, value)
    for corner in corners:
        stroke, stiffness = (_corner_key(places, corner, key) for key in STOP_KEYS)
        polynomial = any(not isinstance(_of_side(stiffness, side), StopTable | None) for side in SIDES)
        if stiffness is None if stroke is not None else polynomial:
            where = f" of {corner}" if corner and len(places) > 1 else ""
            raise InputError(
                f"[limits] a bump stop needs both suspension_stroke [m] and stop_stiffness [N/m]{where}; give both or neither"
            )
        with error_in(f"[limits] stop{f' of {corner}' if corner else ''}"):
            if stiffness is not None:
                stops(stroke, stiffness)
    return {name: one for name, one in places.items() if one is not common}


def places_of(corners: Sequence[str]) -> tuple[str, ...]:
    """Returns the names that sections may have: the corners, and the common beginnings of their names."""
    parts = [corner.split("_") for corner in corners if corner]
    return tuple(dict.fromkeys("_".join(part[:k]) for part in parts for k in range(1, len(part) + 1)))


def stops_at(places: Mapping[str, StopSection], corner: str) -> BumpAndRebound | None:
    """Returns the stops of a corner, or None if it has no stops. A stop for which no stiffness is given has no force."""
    stroke, stiffness = (_corner_key(places, corner, key) for key in STOP_KEYS)
    pair = stops(stroke, stiffness or 0.0)
    return pair if any(math.isfinite(stop.stroke) for stop in pair) else None


def stop_words(by_corner: Mapping[str, BumpAndRebound | None]) -> list[str]:
    """Describes stops, with one phrase for all corners that have equal stops."""
    alike: dict[BumpAndRebound, list[str]] = {}
    for corner, stops in by_corner.items():
        if stops is not None:
            alike.setdefault(stops, []).append(corner)
    return [pair_words(stops) + _where(corners, list(by_corner)) for stops, corners in alike.items()]


def _where(corners: Sequence[str], corners_of_vehicle: Sequence[str]) -> str:
    """Returns the shortest names of places that contain exactly the specified corners."""
    if len(corners) == len(corners_of_vehicle):
        return ""
    names = []
    for name in places_of(corners_of_vehicle):
        members = [corner for corner in corners_of_vehicle if holds(name, corner)]
        if {*members} <= {*corners} and not any(holds(other, name) for other in names):
            names.append(name)
    return f" ({', '.join(names)})"


def _corner_key(places: Mapping[str, StopSection], corner: str, key: str) -> Any:
    """Returns the value that a key of bump stops has for a corner; None if no section has the key.

    If several sections contain the key, the value in the section for the fewest corners is used.
    """
    values = {name: value for name, one in places.items() if holds(name, corner) and (value := getattr(one, key)) is not None}
    return values.get(max(values, key=len, default=""))
