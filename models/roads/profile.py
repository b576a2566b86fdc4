"""Measured roads: heights over distance, and the smooth curve through them."""

import io
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
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
    if len(distance) < FEWEST:
        raise InputError(f"a profile of {len(distance)} points is none; give at least {FEWEST}")
    for i in np.flatnonzero(~np.isfinite(distance) | ~np.all(np.isfinite(heights), axis=1))[:1]:
        raise InputError(f"{where(i)} is not finite: distance {distance[i]:g}, heights {heights[i, 0]:g} and {heights[i, 1]:g}")
    spacing = np.diff(distance)
    for i in np.flatnonzero(spacing <= 0)[:1]:
        raise InputError(
            f"distance falls or repeats, {distance[i]:g} m, then {distance[i + 1]:g} m ({where(i)} and {where(i + 1)}); sort the "
            "points"
        )
    usual = float(np.median(spacing))
    for i in np.flatnonzero(spacing > GAP * usual)[:1]:
        raise InputError(
            f"there is a gap from {distance[i]:g} m to {distance[i + 1]:g} m ({where(i)} and {where(i + 1)}): more than {GAP:g} "
            f"times the usual spacing of {usual:g} m; fill it, or cut the profile there"
        )
    rises = heights - heights[0]  # a road begins at its first height, be that of the sea or of the bench
    for i in np.flatnonzero(np.abs(rises).max(axis=1) > HIGHEST)[:1]:
        raise InputError(
            f"{where(i)} lies {np.abs(rises[i]).max():g} m from the height of the first; {HIGHEST:g} m are allowed. Heights in "
            "mm? then say :height_unit=mm"
        )


def from_csv(content: bytes, speed: float, source: str) -> Profile:
    """Returns a profile from `Profile.points`, to the last bit.

    Raises:
        InputError: the content is wrong.
    """
    if content.count(b"\n") <= FEWEST:
        raise InputError("no points of a road")
    try:
        table = np.loadtxt(io.BytesIO(content), delimiter=",", skiprows=1, ndmin=2, comments=None, encoding="utf-8")
    except ValueError as error:
        raise InputError(f"no points of a road ({str(error).splitlines()[0]})") from error
    if table.shape[1] != 3:
        raise InputError(f"points of a road in {table.shape[1]} column(s); distance, left and right are three")
    return Profile(table[:, 0], table[:, 1:], speed, source)
