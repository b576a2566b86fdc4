"""Paths of surveys: two horizontal coordinates of each point, on a map or as latitude and longitude, in driving order.

The distance of a point is the length of the path before it, in the horizontal plane. Steps in degrees become metres with the
radii of curvature of the ellipsoid WGS 84 (NIMA TR8350.2, 2000) at the latitude of the step.
"""

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, quoted
from models.common.quantities import Heading, columns_in_words
from models.common.table import NumberTable
from models.common.units import unit_size

DEGREES = ("longitude lon lng long längengrad länge longx", "latitude lat breitengrad breite laty")
PLANES = (  # words of coordinates to the east and to the north; a path has one column of each
    ("easting east rechtswert ostwert rw ost utmx", "northing north hochwert nordwert hw nord utmy"),
    ("e", "n"), ("x", "y"), DEGREES,
)  # fmt: skip
HEIGHTS = {"height", "left", "right"}
AXIS, FLATTENING = 6378137.0, 1 / 298.257223563  # of the ellipsoid: m, and a ratio
BLOCK = 5.0  # m of a path, over which positions are averaged
NOTABLE, NOISY = 0.01, 0.05  # relative lengthening of a path by noise: to be remarked, and to be refused
DIFFERENT, OTHER = 0.05, 2.5  # relative difference of two lengths to be remarked, and ratio of them to be refused
APART = 100.0  # m between the heights of two tracks
SLIGHT, DIVERGING = 2.0, 0.2  # change of that difference along a road: m, and over the distance


def coordinates(headings: Sequence[Heading], wanted: Sequence[int]) -> tuple[int, ...]:
    """Returns the columns of two horizontal coordinates, east and north, from 0; empty without these or without a height.

    Args:
        wanted: the columns that may be used, from 0; all if empty.
    """
    if len(wanted) == 2 or not (wanted or HEIGHTS & {one.quantity for one in headings}):
        return ()
    for words in PLANES:
        east, north = ([i for i, one in enumerate(headings) if one.words & {*names.split()}] for names in words)
        if len(east) == len(north) == 1 and east != north and (not wanted or {*east, *north} <= {*wanted}):
            return east[0], north[0]
    return ()


def path_of(table: NumberTable, headings: Sequence[Heading], option: str, ragged: bool) -> tuple[Array, str]:
    """Returns the length of a path before each point [m], shape (P,), and a remark.

    Args:
        headings: headings of the coordinates to the east and to the north.
        option: unit of lengths without a unit; empty for m.
        ragged: see `NumberTable.numbers`.

    Raises:
        InputError: a unit or a number is wrong, or noise makes the path longer than the road.
    """
    numbers, _ = table.numbers([one.column - 1 for one in headings], ragged)
    distance, noise = path_distance(path_steps(numbers, headings, option))
    columns = columns_in_words(headings)
    longer = f"the path through the points is {100 * noise:.2g} % longer than the path through mean positions of {BLOCK:g} m each"
    if noise > NOISY:
        raise InputError(
            f"{columns} are coordinates, but {longer}, because the positions are noisy or not in driving order; smooth or "
            "sort the points, or give a column of distance"
        )
    repeated = int(np.sum(np.diff(distance) <= 0))
    remarks = [f"{columns} are coordinates; the distance is the length of their path, {distance[-1]:.2f} m"]
    remarks += [f"{repeated} points have the position of the point before, and are left out"] if repeated else []
    return distance, "; ".join(remarks + ([f"{longer}: check the positions for noise"] if noise > NOTABLE else []))


def path_steps(numbers: Array, headings: Sequence[Heading], option: str) -> Array:
    """Returns the steps from point to point to the east and to the north [m], shape (P - 1, 2).

    Args:
        numbers: coordinates to the east and to the north, shape (P, 2).
        headings: headings of the coordinates.
        option: unit of lengths without a unit; empty for m.

    Raises:
        InputError: a unit is wrong, or degrees are out of range.
    """
    if not in_degrees(headings):
        return np.diff(numbers * [one.scale("distance", "distance_unit", option, "m") for one in headings], axis=0)
    degrees = numbers * [unit_size(one.unit or "deg", "deg") or 1.0 for one in headings]
    for one, column, limit in zip(headings, degrees.T, (360, 90), strict=True):
        if not (largest := np.abs(column).max()) <= limit:
            found = f"column {one.column}, {quoted(one.text)}, goes up to {largest:.6g}, and at most {limit} degrees are allowed"
            raise InputError(f"{found}; give decimal degrees")
    eccentricity = FLATTENING * (2 - FLATTENING)
    turn, latitude = np.deg2rad(np.diff(degrees, axis=0)), np.deg2rad((degrees[1:, 1] + degrees[:-1, 1]) / 2)
    across = AXIS / np.sqrt(1 - eccentricity * np.sin(latitude) ** 2)
    along = across**3 * (1 - eccentricity) / AXIS**2
    return np.stack([across * np.cos(latitude) * np.sin(turn[:, 0]), along * turn[:, 1]], axis=-1)


def path_distance(steps: Array) -> tuple[Array, float]:
    """Returns the length of a path before each point [m], shape (P,), and the share by which noise of the points lengthens it.

    Args:
        steps: steps from point to point to the east and to the north [m], shape (P - 1, 2).
    """
    position = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    distance = np.concatenate([[0.0], np.cumsum(np.hypot(*steps.T))])
    _, block = np.unique(distance // BLOCK, return_inverse=True)
    means = [np.bincount(block, values) / np.bincount(block) for values in (distance, *position.T)]
    smooth = np.hypot(*np.diff(means[1:])).sum()
    return distance, float(np.ptp(means[0]) / smooth - 1) if smooth else 0.0


def in_degrees(headings: Sequence[Heading]) -> bool:
    """Returns True for headings of longitude and latitude."""
    return any(one.words & {*DEGREES[1].split()} for one in headings)


def other_length(table: NumberTable, headings: Sequence[Heading], distance: Array, heading: Heading, ragged: bool) -> list[str]:
    """Returns a remark if a column of distance differs from the path through coordinates next to it, which may not be readable.

    Args:
        headings: headings of the coordinates to the east and to the north; empty if there are none.
        distance: the column [m], shape (P,), and its heading.
        ragged: see `NumberTable.numbers`.

    Raises:
        InputError: they differ by more than projections of maps do, as numbers of stations do.
    """
    own, length = float(np.ptp(distance)), 0.0
    with suppress(InputError):
        length = float(path_of(table, headings, "", ragged)[0][-1]) if headings else 0.0
    if not length or abs(length - own) <= DIFFERENT * own:
        return []
    found = (
        f"column {heading.column} ({quoted(heading.text)}) is {own:.6g} m long, but the path through {columns_in_words(headings)}"
    )
    if max(own, length) > OTHER * min(own, length):
        do = "remove one of them, or choose the columns of distance and height, as in :columns=3,4"
        raise InputError(f"{found} is {length:.6g} m long; {do}")
    return [f"{found} is {length:.6g} m long"]


def check_tracks(distance: Array, heights: Array, first: int) -> None:
    """Checks that three columns without headings are not two coordinates and a height.

    Args:
        distance: the first column [m], shape (P,).
        heights: the other columns [m], shape (P, 2).
        first: number of the first line.

    Raises:
        InputError: the columns are not the heights of two tracks of a road.
    """
    difference = heights[:, 0] - heights[:, 1]
    if (largest := np.abs(difference).max()) > APART or np.ptp(difference) > max(SLIGHT, DIVERGING * np.ptp(distance)):
        raise InputError(
            f"the columns have no headings, and the last two differ by up to {largest:.6g} m, so they are not the heights of two "
            f"tracks; write headings above line {first}, such as x [m], y [m], height [m] or distance [m], left [mm], right [mm]"
        )
