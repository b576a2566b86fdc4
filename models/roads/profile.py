"""Measured roads: points of height against distance, joined by straight lines or by a spline."""

import io
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated

import numpy as np

from models.common.arrays import Array
from models.common.checks import check_fields, check_shape
from models.common.errors import InputError
from models.common.schema import Choice
from models.roads.road import MeasuredRoad, Speed
from models.vehicle.vehicle import Vehicle

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

# Largest distance between points, relative to the median distance; in a wider gap, points may be missing, and a spline would
# invent heights
GAP = 10.0
SHORT = 5.0  # a gap of at most this length [m] is not suspicious
# Plausible range of the rms slope of a profile; the best runways have 1e-3, and the roughest class of ISO 8608 has 0.5
SMOOTHEST, STEEPEST = 3e-5, 1.0
CHORD = 0.25  # the slope of a profile is computed over this length [m], as in ASTM E1926
FEWEST = 4  # a spline needs at least this number of points
OFTEN = 0.05  # if more than this share of the points is in the wrong order, the column of distance may be a coordinate
# The mean slope over this distance [m] determines the inclination at the start, as for the golden car (ASTM E1926)
START = 11.0
# Rounding error of a height and of the slope at the start, relative to the largest height
ROUNDING = 8 * float(np.finfo(float).eps)
JOINS = ("straight", "smooth")
Join = Annotated[str, Choice("how points are joined", JOINS)]


@dataclass(frozen=True, eq=False)
class Profile(MeasuredRoad):
    """Measured road: points of height against distance, joined by straight lines (ASTM E1926) or by a cubic spline.

    Before the first point, the road is the plane on which the vehicle starts. The plane passes through the first heights, and
    its slope is the mean slope of the first 11 m of both tracks. For a vehicle with one track, the slope is that of the track
    on which the vehicle drives. After the last point, the road continues with the slope of the last 11 m.

    Attributes:
        distance: distances of the points [m], ascending, shape (P,).
        heights: heights of the left and the right track [m], shape (P, 2). A vehicle with one track drives on the left track of
            the road.
        speed: vehicle speed V [m/s].
        source: name of the file.
        join: "straight" to join the points by lines, or "smooth" to join them by a cubic spline.
        note: remark about the columns of the file, a phrase; empty without a remark.

    Raises:
        InputError: distances do not ascend, a number is not finite, or there are too few points. The error is also raised if
            `join` is unknown, or if a spline has a gap.
    """

    distance: Array
    heights: Array
    speed: Speed = 20.0
    source: str = field(default="")
    join: Join = JOINS[0]
    note: str = ""

    def __post_init__(self) -> None:
        check_fields(self)
        check_points(self.distance, self.heights, smooth=self.join == "smooth")

    def check(self, vehicle: Vehicle, time: Array) -> None:
        """Checks the profile like any road, and checks that the driven part is not steeper than real roads.

        Raises:
            InputError: the road is too steep, for example because of wrong units.
        """
        super().check(vehicle, time)
        x, z = self._driven(self.speed * float(time[-1]))
        slope = float(np.sqrt(np.mean((np.diff(z, axis=0) / np.diff(x)[:, None]) ** 2)))
        if slope > STEEPEST:
            raise InputError(
                f"the road is {x[-1] - x[0]:.4g} m long in steps of {np.median(np.diff(x)):.3g} m, with heights from "
                f"{z.min():.4g} to {z.max():.4g} m. Its rms slope of {slope:.3g} is steeper than that of real roads; "
                "give the right units, as in :distance_unit=km or :height_unit=mm"
            )

    def remark(self, length: float) -> str:
        """Returns remarks about the columns of the file, about the widest gap between points, and about improbable heights.

        Args:
            length: driven length [m].
        """
        return "; ".join(filter(None, (self.note, self._doubt(length))))

    def _doubt(self, length: float) -> str:
        """Returns a remark about the widest gap between points, or about improbable heights; empty without a remark.

        Args:
            length: driven length [m].
        """
        x, z = self._driven(length)
        steps = np.diff(x)
        i, usual = int(steps.argmax()), float(np.median(steps))
        if steps[i] > max(GAP * usual, SHORT):
            return (
                f"there is no point between {x[i]:g} m and {x[i + 1]:g} m, but other points are {usual:g} m apart; the road is "
                "straight in this gap, so check that no points are missing"
            )
        chord = max(CHORD, usual)
        at = np.arange(x[0], x[-1] + chord / 2, chord)  # slopes over this length do not show the texture of the surface
        rough = max(float(np.diff(np.interp(at, x, track)).std()) / chord for track in z.T) if len(at) > 1 else 0.0
        smooth = ROUNDING * max(1.0, float(np.abs(z).max())) / usual < rough < SMOOTHEST
        said = "no road is so smooth: check the units of heights and distances"
        return f"the slope varies by {round(rough, 8):g} rms; {said}" if smooth else ""

    def _driven(self, length: float) -> tuple[Array, Array]:
        """Returns distances and heights of the points up to and including the first point beyond a driven length [m]."""
        points = max(2, int(np.searchsorted(self._x, length)) + 1)
        return self.distance[:points], self.heights[:points]

    @property
    def duration(self) -> float:
        """Time from the first point to the last point [s]."""
        return self._end / self.speed

    def start(self, side: str) -> tuple[float, float]:
        """Returns the height [m] of the plane at time 0 and its rate of change [m/s]."""
        first = self.heights[0]
        return float(first[int(side == "right")] - first.mean()) if side else 0.0, self._slope(side, 0) * self.speed

    def departure(self, t: Array, side: str = "") -> Array:
        """Returns the height above the plane [m]."""
        x, z = self._x, self._over_plane[side]
        at = np.asarray(t) * self.speed
        on = np.interp(at, x, z) if self.join == "straight" else self._splines[side](np.clip(at, 0.0, self._end))
        return on + (self._slope(side, 1) - self._slope(side, 0)) * np.maximum(at - self._end, 0.0)

    def departure_rate(self, t: Array, side: str = "") -> Array:
        """Returns the time derivative of `departure` [m/s]; at a point, the derivative of the line after the point."""
        x, z = self._x, self._over_plane[side]
        at, after = np.asarray(t) * self.speed, self._slope(side, 1) - self._slope(side, 0)
        if self.join == "straight":
            slopes = np.concatenate([[0.0], np.diff(z) / np.diff(x), [after]])
            return self.speed * slopes[np.searchsorted(x, at, side="right")]
        on = self._splines[side](np.clip(at, 0.0, self._end), 1)
        return self.speed * np.where(at < 0, 0.0, np.where(at > self._end, after, on))

    @property
    def knots(self) -> Array:
        """Times of all points [s]."""
        return self._x / self.speed

    @property
    def points(self) -> bytes:
        """All points as the text of a CSV file with exact numbers: distance, left height and right height [m]."""
        rows = np.column_stack([self.distance, self.heights]).tolist()
        return ("distance,left,right\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows)).encode()

    def describe(self) -> dict[str, float | str]:
        """Returns a description: file, number of points, first distance, length, lowest and highest height, speed and join."""
        return {
            "type": "profile",
            "source": self.source,
            "points": len(self.distance),
            "from": float(self.distance[0]),
            "length": self._end,
            "lowest": float(self.heights.min()),
            "highest": float(self.heights.max()),
            "speed": self.speed,
            "join": self.join,
        }

    def begun_at(self, start: float) -> "Profile":
        """Returns the part of the profile after a distance [m]; see `begun_at`."""
        distance, heights = begun_at(start, self.distance, self.heights)
        return replace(self, distance=distance, heights=heights)

    def turned(self, length: float) -> "Profile | None":
        """Returns the beginning of the profile, rotated by half a turn about the first point, so that the result ends at this
        point.

        Args:
            length: length of the beginning [m].

        Returns:
            The rotated profile; None if it would have too few points.
        """
        points = int(np.searchsorted(self._x, length, side="right"))
        if points < (2 if self.join == "straight" else FEWEST):
            return None
        distance, heights = self.distance[:points][::-1], self.heights[:points][::-1]
        return replace(self, distance=2 * self.distance[0] - distance, heights=2 * self.heights[0] - heights)

    def scaled(self, factor: float) -> "Profile":
        """Returns the profile with heights multiplied by a factor."""
        return replace(self, heights=factor * self.heights)

    @property
    def _end(self) -> float:
        return float(self.distance[-1] - self.distance[0])

    @cached_property
    def _x(self) -> Array:
        return self.distance - self.distance[0]

    @cached_property
    def _chords(self) -> Array:
        """Mean slopes of both tracks over the first and the last 11 m, shape (2, 2): a row for each end, a column per track."""
        reach = min(START, self._end)
        ends = np.array([[np.interp(at, self._x, z) for z in self.heights.T] for at in (0, reach, self._end - reach, self._end)])
        return (ends[1::2] - ends[::2]) / reach

    def _slope(self, side: str, end: int) -> float:
        """Returns the slope of the plane before the first point (`end` 0), or after the last point (`end` 1)."""
        return float(self._chords[end].mean() if side else self._chords[end, 0])

    @cached_property
    def _over_plane(self) -> dict[str, Array]:
        """Heights of the points above the plane of the start [m], by side; rounding errors are replaced by 0."""
        rounding = ROUNDING * np.abs(self.heights).max() * (1 + self._x / min(START, self._end))
        over = {}
        for side in ("", "left", "right"):
            z = self.heights[:, int(side == "right")]
            rise = z - z[0] - self._slope(side, 0) * self._x
            over[side] = np.where(np.abs(rise) <= rounding, 0.0, rise)
        return over

    @cached_property
    def _splines(self) -> "dict[str, CubicSpline]":
        from scipy.interpolate import CubicSpline  # this import is delayed, because it takes 0.5 s

        ends = {side: ((1, 0.0), (1, self._slope(side, 1) - self._slope(side, 0))) for side in self._over_plane}
        return {
            side: CubicSpline(self._x, z, bc_type=ends[side])  # pyright: ignore[reportArgumentType] - a tuple, says scipy
            for side, z in self._over_plane.items()
        }


def begun_at(start: float, distance: Array, heights: Array) -> tuple[Array, Array]:
    """Returns the part of a road's points that follows a distance, preceded by an interpolated point at this distance.

    Args:
        start: distance at which the road starts [m].
        distance: distances of the points [m], ascending, shape (P,).
        heights: heights of the points [m], shape (P, K).

    Raises:
        InputError: the road does not contain the distance `start`.
    """
    rest = distance > start
    if not distance[0] <= start < distance[-1]:
        first, last = distance[0], distance[-1]
        raise InputError(f"from = {start:g} m is not on the road; start at a distance from {first:g} m to less than {last:g} m")
    here = [np.interp(start, distance, track) for track in heights.T]
    return np.concatenate([[start], distance[rest]]), np.concatenate([[here], heights[rest]])


def check_points(
    distance: Array, heights: Array, where: Callable[[int], str] = lambda i: f"point {i + 1}", smooth: bool = False
) -> None:
    """Checks that points are a valid profile.

    Args:
        distance: distances of the points [m], shape (P,).
        heights: heights of the left and the right track [m], shape (P, 2).
        where: function from the index of a point to its name in messages.
        smooth: True for a spline, which needs more points and must not have gaps.

    Raises:
        InputError: distances do not ascend, a number is not finite, there are too few points, or a spline has a gap.
    """
    check_shape("heights", heights, (len(distance), 2), "one row for each distance, and columns for left and right")
    check_ascending("smooth profile" if smooth else "profile", distance, heights, where, "distance", "m", smooth)


def check_ascending(
    what: str, x: Array, heights: Array, where: Callable[[int], str], axis: str, unit: str, smooth: bool = True
) -> None:
    """Checks that there are enough points, that they are finite and ascending, and that a spline has no gap.

    Args:
        what: name of the road, for messages.
        x: distances or times of the points, shape (P,).
        heights: heights of the points [m], shape (P, K).
        where: function from the index of a point to its name in messages.
        axis: name of the quantity `x`, for messages.
        unit: unit of `x`.
        smooth: True for a spline.

    Raises:
        InputError: there are too few points, a point is not finite or not ascending, or a spline has a gap.
    """
    fewest = FEWEST if smooth else 2
    if len(x) < fewest:
        raise InputError(f"a {what} needs at least {fewest} points, but this one has {len(x)}; add more points")
    for i in np.flatnonzero(~np.isfinite(x) | ~np.all(np.isfinite(heights), axis=1))[:1]:
        raise InputError(
            f"{where(i)} contains a number that is not finite: {axis} {x[i]:g}, heights "
            f"{' '.join(f'{z:g}' for z in heights[i][:8])}; give finite numbers"
        )
    steps = np.diff(x)
    for i in np.flatnonzero(steps <= 0)[:1]:
        if steps[i] == 0:
            raise InputError(
                f"{axis} {x[i]:.12g} {unit} is repeated ({where(i)} and {where(i + 1)}); keep only one of the two points"
            )
        there = f"{axis} falls from {x[i]:.12g} {unit} to {x[i + 1]:.12g} {unit} ({where(i)} and {where(i + 1)})"
        if (steps < 0).all():
            raise InputError(f"{there}, and also between all other points; reverse the order of the points")
        both = "; if this column is a map coordinate, give the other coordinate, too" if np.mean(steps < 0) > OFTEN else ""
        raise InputError(f"{there}; sort the points by {axis}{both}")
    usual = float(np.median(steps))
    for i in np.flatnonzero(smooth & (steps > GAP * usual))[:1]:
        there = f"there is a gap from {x[i]:g} {unit} to {x[i + 1]:g} {unit} ({where(i)} and {where(i + 1)})"
        raise InputError(
            f"{there}, which is more than {GAP:g} times the usual step of {usual:g} {unit}; fill this gap with points, "
            f"or split the {what} into two at the gap"
        )


def from_csv(content: bytes, speed: float, source: str, join: str) -> Profile:
    """Returns the profile that a text from `Profile.points` contains, with exact numbers.

    Raises:
        InputError: the content of the text is not valid.
    """
    names, table = read_points(content, "road")
    if len(names) != 3:
        raise InputError(f"the road's points have {len(names)} column(s); give the three columns distance, left and right")
    return Profile(table[:, 0], table[:, 1:], speed, source, join)


def read_points(content: bytes, what: str) -> tuple[list[str], Array]:
    """Returns the column names and the exact numbers in the text `Road.points`.

    Raises:
        InputError: the content of the text is not valid.
    """
    head, _, rest = content.partition(b"\n")
    if rest.count(b"\n") < 2:
        raise InputError(f"the points of the {what} are missing")
    try:
        names, table = (
            head.decode().split(","),
            np.loadtxt(io.BytesIO(rest), delimiter=",", ndmin=2, comments=None, encoding="utf-8"),
        )
    except ValueError as error:
        raise InputError(f"the points of the {what} cannot be read ({str(error).splitlines()[0]})") from error
    if table.shape[1] != len(names):
        raise InputError(
            f"the points of the {what} have {table.shape[1]} column(s) of numbers, but {len(names)} name(s); give one "
            "name for each column"
        )
    return names, table
