"""A measured road: heights over distance from a file, and the smooth curve through them."""

import csv
import io
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from models.arrays import Array
from models.errors import InputError
from models.read_file import TABLE, read_text
from sim.road import LIMITS, Road, check_numbers

GAP = 10.0  # times the median spacing; more is a gap, and what a curve does there is invented
HIGHEST = 100.0  # m
FEWEST = 4  # points

FORMAT = "give two columns, distance and height [m], or three, distance, left and right"


@dataclass(frozen=True, eq=False)
class Profile(Road):
    """The cubic spline through measured heights: they are met exactly, and the derivative is that of the spline.

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
        if len(self.distance) < FEWEST:
            raise InputError(f"a profile of {len(self.distance)} points is none; give at least {FEWEST}")
        for row in np.flatnonzero(~np.isfinite(self.distance) | ~np.all(np.isfinite(self.heights), axis=1))[:1]:
            raise InputError(f"point {row + 1} is not finite: distance {self.distance[row]:g} m, heights {self.heights[row]} m")
        spacing = np.diff(self.distance)
        for row in np.flatnonzero(spacing <= 0)[:1]:
            a, b = self.distance[row], self.distance[row + 1]
            raise InputError(
                f"distance falls or repeats, {a:g} m, then {b:g} m (points {row + 1} and {row + 2}); sort the points"
            )
        usual = float(np.median(spacing))
        for row in np.flatnonzero(spacing > GAP * usual)[:1]:
            a, b = self.distance[row], self.distance[row + 1]
            raise InputError(
                f"there is a gap from {a:g} m to {b:g} m (points {row + 1} and {row + 2}): more than {GAP:g} times the usual "
                f"spacing of {usual:g} m; fill it, or cut the profile there"
            )
        for row in np.flatnonzero(np.abs(self.heights).max(axis=1) > HIGHEST)[:1]:
            raise InputError(f"point {row + 1} has heights {self.heights[row]} m; metres within {HIGHEST:g} are allowed")

    @property
    def duration(self) -> float:
        """From the first point to the last [s]."""
        return float(self.distance[-1] - self.distance[0]) / self.speed

    def displacement(self, t: Array, side: str = "") -> Array:
        """The spline, from its height at the first point."""
        return self._track(side)(np.clip(np.asarray(t) * self.speed, 0.0, self._end))

    def velocity(self, t: Array, side: str = "") -> Array:
        """The spline's own derivative."""
        x = np.asarray(t) * self.speed
        on = (x >= 0) & (x <= self._end)
        return np.where(on, self.speed * self._track(side)(np.clip(x, 0.0, self._end), 1), 0.0)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Both ends. At the other points only the third derivative jumps: a step's quadrature does not see it."""
        return (0.0, self.duration)

    def to_csv(self) -> str:
        """Its points to the last bit, as a file that `read_profile` reads: distance, left, right [m]."""
        rows = np.column_stack([self.distance, self.heights]).tolist()
        return "distance,left,right\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows)

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
        """The same profile, higher or lower."""
        return replace(self, heights=factor * self.heights)

    @property
    def _end(self) -> float:
        return float(self.distance[-1] - self.distance[0])

    @cached_property
    def _splines(self) -> tuple[CubicSpline, CubicSpline]:
        x, z = self.distance - self.distance[0], self.heights - self.heights[0]
        return CubicSpline(x, z[:, 0], bc_type="clamped"), CubicSpline(x, z[:, 1], bc_type="clamped")

    def _track(self, side: str) -> CubicSpline:
        return self._splines[side == "right"]


def read_profile(path: Path, speed: float) -> Profile:
    """A profile from a CSV file: distance and height, or distance, left and right height [m]; a line of headings may come first.

    Raises:
        InputError: the file cannot be read, a line has no such numbers, or they make no profile. The message names the file.
    """
    text = read_text(path, "road file", TABLE, FORMAT)
    try:
        lines = [(number, row) for number, row in enumerate(csv.reader(text.splitlines()), 1) if any(map(str.strip, row))]
    except csv.Error as error:
        raise InputError(f"road file {path}: not a CSV file ({error}); {FORMAT}") from error
    if lines and not _is_number(lines[0][1][0]):
        lines = lines[1:]
    columns = len(lines[0][1]) if lines else 2
    if columns not in (2, 3):
        raise InputError(f"road file {path}: {columns} column(s); {FORMAT}")
    points = []
    for number, row in lines:
        if len(row) != columns or not all(_is_number(cell) for cell in row):
            raise InputError(f"road file {path}, line {number}: {','.join(row)!r} is not {columns} numbers; {FORMAT}")
        points.append([float(cell) for cell in row])
    table = np.array(points, dtype=float).reshape(len(points), columns)
    try:
        return Profile(table[:, 0], table[:, [1, -1]], speed, str(path))
    except InputError as error:
        raise InputError(f"road file {path}: {error}") from error


def from_csv(content: bytes, speed: float, source: str) -> Profile:
    """A profile from what `Profile.to_csv` wrote, to the last bit.

    Raises:
        InputError: it is not that.
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


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
