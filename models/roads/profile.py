"""Measured roads: heights over distance, and the smooth curve through them."""

import io
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.common.checks import check_fields, check_shape
from models.common.errors import InputError
from models.roads.road import LIMITS, Road, check_numbers

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

GAP = 10.0  # largest spacing over the median one; in a wider gap the curve would be invented
HIGHEST = 100.0  # m, largest height over the first point
FEWEST = 4  # points


@dataclass(frozen=True, eq=False)
class Profile(Road):
    """Cubic spline through measured heights, with its exact derivative.

    The road begins at the first point, from its height there, and stays level after the last. Slopes are zero at both ends.

    Attributes:
        distance: ascending [m], shape (P,).
        heights: of the left and the right track [m], shape (P, 2). A vehicle with one track drives on the left one.
        speed: V [m/s].
        source: the file.

    Raises:
        InputError: distances that do not ascend or leave a gap, numbers that are not finite, absurd heights, too few points.
    """

    distance: Array
    heights: Array
    speed: float = 20.0
    source: str = field(default="")

    def __post_init__(self) -> None:
        check_fields(self)
        check_numbers("profile", self, {"speed": LIMITS["speed"]})
        check_points(self.distance, self.heights)

    @property
    def duration(self) -> float:
        """Time from the first point to the last [s]."""
        return float(self.distance[-1] - self.distance[0]) / self.speed

    def displacement(self, t: Array, side: str = "") -> Array:
        """Returns the spline, from its height at the first point."""
        return self._track(side)(np.clip(np.asarray(t) * self.speed, 0.0, self._end))

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the spline's own derivative."""
        x = np.asarray(t) * self.speed
        on = (x >= 0) & (x <= self._end)
        return np.where(on, self.speed * self._track(side)(np.clip(x, 0.0, self._end), 1), 0.0)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Both ends. At the other points only the third derivative jumps: a step's quadrature does not see it."""
        return (0.0, self.duration)

    @property
    def points(self) -> bytes:
        """Its points to the last bit, as a CSV file: distance, left, right [m]."""
        rows = np.column_stack([self.distance, self.heights]).tolist()
        return ("distance,left,right\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows)).encode()

    def describe(self) -> dict[str, float | str]:
        """File, points, length, roughest height, speed."""
        return {
            "type": "profile",
            "source": self.source,
            "points": len(self.distance),
            "length": self._end,
            "lowest": float(self.heights.min()),
            "highest": float(self.heights.max()),
            "speed": self.speed,
        }

    def scaled(self, factor: float) -> "Profile":
        """Returns the profile higher or lower."""
        return replace(self, heights=factor * self.heights)

    @property
    def _end(self) -> float:
        return float(self.distance[-1] - self.distance[0])

    @cached_property
    def _splines(self) -> "tuple[CubicSpline, CubicSpline]":
        from scipy.interpolate import CubicSpline  # half a second

        x, z = self.distance - self.distance[0], self.heights - self.heights[0]
        return CubicSpline(x, z[:, 0], bc_type="clamped"), CubicSpline(x, z[:, 1], bc_type="clamped")

    def _track(self, side: str) -> "CubicSpline":
        return self._splines[side == "right"]


def check_points(distance: Array, heights: Array, where: Callable[[int], str] = lambda i: f"point {i + 1}") -> None:
    """Checks that points make a profile.

    Args:
        distance: [m], shape (P,).
        heights: of the left and the right track [m], shape (P, 2).
        where: index -> what a message calls the point.

    Raises:
        InputError: distances that do not ascend or leave a gap, numbers that are not finite, absurd heights, too few points.
    """
    check_shape("heights", heights, (len(distance), 2), "as there are so many distances, and a left and a right track")
    check_ascending("profile", distance, heights, where, "distance", "m")
    rises = heights - heights[0]  # a road begins at its first height, be that of the sea or of the bench
    for i in np.flatnonzero(np.abs(rises).max(axis=1) > HIGHEST)[:1]:
        raise InputError(
            f"{where(i)} lies {np.abs(rises[i]).max():g} m from the height of the first; {HIGHEST:g} m are allowed. Heights in "
            "mm? then say :height_unit=mm"
        )


def check_ascending(what: str, x: Array, heights: Array, where: Callable[[int], str], axis: str, unit: str) -> None:
    """Checks that points are enough, finite, and ascend without a gap.

    Args:
        what: what they make, for messages.
        x: distance or time, shape (P,); axis: which of them; unit: its unit.
        heights: [m], shape (P, K).
        where: index -> what a message calls the point.

    Raises:
        InputError: they are not.
    """
    if len(x) < FEWEST:
        raise InputError(f"a {what} needs at least {FEWEST} points, and has {len(x)}; give more")
    for i in np.flatnonzero(~np.isfinite(x) | ~np.all(np.isfinite(heights), axis=1))[:1]:
        raise InputError(f"{where(i)} is not finite: {axis} {x[i]:g}, heights {' '.join(f'{z:g}' for z in heights[i][:8])}")
    steps = np.diff(x)
    for i in np.flatnonzero(steps <= 0)[:1]:
        there = f"{axis} falls or repeats, {x[i]:g} {unit}, then {x[i + 1]:g} {unit} ({where(i)} and {where(i + 1)})"
        raise InputError(f"{there}; sort the points")
    usual = float(np.median(steps))
    for i in np.flatnonzero(steps > GAP * usual)[:1]:
        there = f"there is a gap from {x[i]:g} {unit} to {x[i + 1]:g} {unit} ({where(i)} and {where(i + 1)})"
        raise InputError(f"{there}: more than {GAP:g} times the usual step of {usual:g} {unit}; fill it, or cut the {what} there")


def from_csv(content: bytes, speed: float, source: str) -> Profile:
    """Returns a profile from `Profile.points`, to the last bit.

    Raises:
        InputError: the content is wrong.
    """
    names, table = read_points(content, "road")
    if len(names) != 3:
        raise InputError(f"points of a road in {len(names)} column(s); distance, left and right are three")
    return Profile(table[:, 0], table[:, 1:], speed, source)


def read_points(content: bytes, what: str) -> tuple[list[str], Array]:
    """Returns the names and the numbers of `Road.points`, to the last bit.

    Raises:
        InputError: the content is wrong.
    """
    head, _, rest = content.partition(b"\n")
    if rest.count(b"\n") < FEWEST:
        raise InputError(f"no points of a {what}")
    try:
        names, table = (
            head.decode().split(","),
            np.loadtxt(io.BytesIO(rest), delimiter=",", ndmin=2, comments=None, encoding="utf-8"),
        )
    except ValueError as error:
        raise InputError(f"no points of a {what} ({str(error).splitlines()[0]})") from error
    if table.shape[1] != len(names):
        raise InputError(f"points of a {what} in {table.shape[1]} column(s) below {len(names)} name(s)")
    return names, table
