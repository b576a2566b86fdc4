"""Posts of a test rig: the height under each wheel against time, as in the drive file of a four-post rig."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.common.checks import check_fields, check_shape
from models.common.errors import InputError, list_names, short_repr
from models.common.quantities import CORNERS
from models.kinds.kind import Parameters, Wheel
from models.roads.profile import check_ascending, read_points
from models.roads.road import MeasuredRoad
from models.vehicle.vehicle import Vehicle

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

STROKE = 2.0  # largest distance that a post may move from its first height [m]


@dataclass(frozen=True, eq=False)
class Rig(MeasuredRoad):
    """Posts of a test rig: for each post, a cubic spline through its heights against time, with the exact time derivative.

    Before its first point, a post stays at its first height; after its last point, it stays at its last height. The slope of
    the spline is zero at the first and at the last point. The vehicle does not move forward, so all wheels are independent and
    the speed has no effect. The vehicle starts in equilibrium on the first heights of the posts; the mean of the first heights
    is the datum.

    Attributes:
        time: times of the points [s], ascending, shape (P,).
        heights: heights of the K posts [m], shape (P, K).
        posts: names of the wheels on the K posts, a name for each post. A name is that of the wheel's road signal or of the
            road's body in MJCF, or the suffix of one of these names.
        source: name of the file.

    Raises:
        InputError: times do not ascend or have a gap, a number is not finite, a stroke is too long, or there are too few
            points.
    """

    time: Array
    heights: Array
    posts: tuple[str, ...]
    source: str = ""

    speed = 0.0
    laid = False

    def __post_init__(self) -> None:
        check_fields(self)
        check_shape("heights", self.heights, (len(self.time), len(self.posts)), "one row for each time, one column for each post")
        check_posts(self.posts)
        check_history(self.time, self.heights)

    @property
    def duration(self) -> float:
        """Time from the first point to the last point [s]."""
        return float(self.time[-1] - self.time[0])

    def track_of(self, wheel: Wheel) -> str:
        """Returns the name of the post under a wheel.

        Raises:
            InputError: no post has a name of the wheel.
        """
        for post in self.posts:
            if post_name(post) in _names(wheel):
                return post
        raise InputError(
            f"no column is called {_names(wheel)[0]}, so the post of the wheel with this name has no heights; give one of "
            f"the columns {list_names(self.posts[:20])} this name"
        )

    def delay_of(self, wheel: Wheel, parameters: Parameters) -> float:
        """Returns 0, because the vehicle does not move forward."""
        return 0.0

    def start(self, side: str) -> tuple[float, float]:
        """Returns the first height of a post [m], and 0 for its rate of change; an empty name means the first post."""
        first = self.heights[0]
        return float(first[self._index(side)] - first.mean()), 0.0

    def departure(self, t: Array, side: str = "") -> Array:
        """Returns the height of a post relative to its first height [m], as given by the spline."""
        return self._splines[self._index(side)](np.clip(t, 0.0, self.duration))

    def departure_rate(self, t: Array, side: str = "") -> Array:
        """Returns the time derivative of the spline [m/s]."""
        t = np.asarray(t, dtype=float)
        on = (t >= 0) & (t <= self.duration)
        return np.where(on, self._splines[self._index(side)](np.clip(t, 0.0, self.duration), 1), 0.0)

    @property
    def knots(self) -> Array:
        """Times of all points [s]."""
        return self.time - self.time[0]

    @property
    def points(self) -> bytes:
        """All points as the text of a CSV file with exact numbers: time [s] and heights of the posts [m]."""
        rows = np.column_stack([self.time, self.heights]).tolist()
        return (",".join(["time", *self.posts]) + "\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows)).encode()

    def describe(self) -> dict[str, float | str]:
        """Returns a description: file, posts, number of points, duration, and lowest and highest height."""
        return {
            "type": "rig",
            "source": self.source,
            "posts": " ".join(self.posts),
            "points": len(self.time),
            "duration": self.duration,
            "lowest": float(self.heights.min()),
            "highest": float(self.heights.max()),
        }

    def check(self, vehicle: Vehicle, time: Array) -> None:
        """Checks the rig like any road, and checks that every wheel of the vehicle has a post."""
        posts = {self.track_of(wheel) for wheel in vehicle.kind.wheels}
        for post in self.posts:
            if post not in posts:
                names = [_names(wheel)[0] for wheel in vehicle.kind.wheels]
                raise InputError(
                    f"column {short_repr(post)} does not belong to a wheel of this vehicle; omit the column, or "
                    f"rename it to one of {list_names(names)}"
                )
        super().check(vehicle, time)

    def scaled(self, factor: float) -> "Rig":
        """Returns the rig with all heights multiplied by a factor."""
        return replace(self, heights=factor * self.heights)

    def _index(self, side: str) -> int:
        return self.posts.index(side) if side else 0

    @cached_property
    def _splines(self) -> "list[CubicSpline]":
        from scipy.interpolate import CubicSpline  # this import is delayed, because it takes 0.5 s

        rises = self.heights - self.heights[0]
        return [CubicSpline(self.time - self.time[0], rise, bc_type="clamped") for rise in rises.T]


def post_name(text: str) -> str:
    """Returns the normal form of a column's name.

    In its normal form, `Front Left`, `LF` and `road_displacement_front_left` are equal.
    """
    name = "_".join(text.lower().replace("-", " ").replace("_", " ").split())
    return CORNERS.get(name, name)


def _names(wheel: Wheel) -> tuple[str, ...]:
    """Returns the names that the post under a wheel may have, the usual name first."""
    signal, body = wheel.road_displacement, wheel.road_body
    ending = signal.removeprefix("road_displacement_")
    return tuple(dict.fromkeys(post_name(name) for name in (ending, signal, body)))


def check_history(time: Array, heights: Array, where: Callable[[int], str] = lambda i: f"point {i + 1}") -> None:
    """Checks that points are valid height histories of posts.

    Args:
        time: times of the heights [s], shape (P,).
        heights: heights of the posts [m], shape (P, K).
        where: function from the index of a point to its name in messages.

    Raises:
        InputError: times do not ascend or have a gap, a number is not finite, a stroke is too long, or there are too few
            points.
    """
    check_ascending("time history", time, heights, where, "time", "s")
    rises = np.abs(heights - heights[0])
    for i in np.flatnonzero(rises.max(axis=1) > STROKE)[:1]:
        raise InputError(
            f"{where(i)} differs by {rises[i].max():g} m from the first height of the same post, but at most {STROKE:g} m is "
            "allowed; if the heights are in mm, add the unit to the heading, as in front_left [mm]"
        )


def check_posts(posts: Sequence[str]) -> None:
    """Checks that the posts have different, valid names.

    Raises:
        InputError: two posts belong to the same wheel, a post has no name, or there are no posts.
    """
    if not posts:
        raise InputError("the drive file has no columns of heights; give one column of heights for each wheel")
    seen: dict[str, str] = {}
    for post in posts:
        name = post_name(post)
        if not name or "," in name:
            raise InputError(
                f"a column is called {short_repr(post)}, which is not the name of a wheel; give this column the name of "
                "the wheel on its post"
            )
        if name in seen:
            raise InputError(
                f"the columns {short_repr(seen[name])} and {short_repr(post)} belong to the same wheel; remove one of "
                "the two columns"
            )
        seen[name] = post


def rig_from_csv(content: bytes, source: str) -> Rig:
    """Returns the rig that a text from `Rig.points` contains, with exact numbers.

    Raises:
        InputError: the content of the text is not valid.
    """
    (_, *posts), table = read_points(content, "rig")
    return Rig(table[:, 0], table[:, 1:], tuple(posts), source)
