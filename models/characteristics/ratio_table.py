"""Motion ratio that changes with travel: a table of the ratio r against the deflection d at the wheel, with linear
interpolation.

Beyond the first and the last point of the table, the motion ratio is constant. The element's own travel D, the change of the
distance between its two ends, is the integral of the ratio r over the deflection d, starting from equilibrium.
`models.parts.ratio` computes the forces of an element with a motion ratio.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np

from models.characteristics import RATIO
from models.characteristics.curve import ForceCurve, slope_at_rest
from models.characteristics.curve_reading import DEFLECTION, FORCE, TableSection
from models.characteristics.surface import ForceSurface, surface_of
from models.common.arrays import Array
from models.common.errors import InputError, error_in
from models.common.schema import SI, read

TRIALS = 12  # number of iterations in the search for a deflection; with a constant motion ratio, one iteration is exact
FARTHEST, HALVINGS = 1.0, 60  # range in which the equilibrium deflection is searched [m], and number of bisections
# Number of deflections in the table of a position-dependent damper; between two deflections, the error is the slope of the
# motion ratio, divided by 8, times the square of their distance
COLUMNS = 41
PLACES = 9  # the deflections of a table's points are rounded to this number of decimal places [m]


@dataclass(frozen=True, eq=False)
class RatioTable:
    """Motion ratio as a function of the deflection of a suspension.

    Attributes:
        x: deflections [m], ascending, with 0 between the first and the last, shape (n,).
        ratio: motion ratio r at each deflection, shape (n,).
        straight: True if springs and dampers with this ratio are replaced by their linearisations in equilibrium, so that the
            table has no effect.
    """

    x: Array
    ratio: Array
    straight: bool = False

    def __call__(self, deflection: Array) -> Array:
        """Returns the motion ratio r at deflections d [m], shape (...)."""
        return np.interp(deflection, self.x, self.ratio)

    @cached_property
    def at_rest(self) -> float:
        """r(0), the motion ratio in equilibrium."""
        return float(self(np.zeros(())))

    @cached_property
    def relative_slope(self) -> float:
        """Relative slope r'(0) / r(0) of the motion ratio [1/m], where r'(0) is the mean of the slopes on both sides of 0."""
        i = int(np.searchsorted(self.x, 0.0))
        x = np.insert(self.x, i, 0.0) if 0.0 not in self.x else self.x
        return slope_at_rest(x, self(x)) / self.at_rest

    def scaled(self, at_rest: float) -> "RatioTable":
        """Returns the table multiplied by a factor, so that the motion ratio in equilibrium becomes `at_rest`."""
        return replace(self, ratio=self.ratio * (at_rest / self.at_rest))

    def shifted_to(self, rest: float) -> "RatioTable":
        """Returns the table with deflections that are measured from a new equilibrium.

        Args:
            rest: deflection at the new equilibrium [m].

        Raises:
            InputError: the table does not contain the new equilibrium.
        """
        if not self.x[0] < rest < self.x[-1]:
            raise InputError(
                f"the static deflection is outside the table, which goes from {self.x[0]:g} to {self.x[-1]:g} m; extend the table"
            )
        return replace(self, x=self.x - rest)

    def rest_at_load(self, rate: float, load: float, other: float) -> float:
        """Returns the deflection at which a spring carries the load `other`.

        Args:
            rate: stiffness of the spring [N/m].
            load: load that the spring carries at deflection 0 [N].
            other: load that the spring carries at the returned deflection [N].
        """
        low, high = -FARTHEST, FARTHEST
        for _ in range(HALVINGS):
            d = (low + high) / 2
            short = self(np.array(d)) * (load / self.at_rest - rate * self.travel(np.array(d))) < other
            low, high = (low, d) if short else (d, high)
        return (low + high) / 2

    @cached_property
    def _segments(self) -> Array:
        """Segments within and beyond the table: the deflection, travel and ratio at the start of each segment, and the slope of
        the ratio, shape (4, n + 1).
        """
        x, r = self.x, self.ratio
        at = np.concatenate([[0.0], np.cumsum((r[1:] + r[:-1]) / 2 * np.diff(x))])
        rest = int(np.searchsorted(x, 0.0, side="right")) - 1
        at -= at[rest] + (r[rest] + self.at_rest) / 2 * -x[rest]
        first, slope = np.concatenate([[0], np.arange(len(x))]), np.concatenate([[0.0], np.diff(r) / np.diff(x), [0.0]])
        return np.stack([x[first], at[first], r[first], slope])

    def ratio_and_travel(self, deflection: Array) -> tuple[Array, Array]:
        """Returns the motion ratio r and the element's travel D [m] at deflections d [m], shapes (...)."""
        start, travel, ratio, slope = self._segments[:, self.x.searchsorted(deflection)]
        s = deflection - start
        turned = slope * s
        return ratio + turned, travel + s * (ratio + turned / 2)

    def slope(self, deflection: Array) -> Array:
        """Returns the slope r' of the motion ratio [1/m] at deflections d [m], shape (...).

        At a point of the table, the slope is that of the segment below the point.
        """
        return self._segments[3][self.x.searchsorted(deflection)]

    def travel(self, deflection: Array) -> Array:
        """Returns the element's travel D [m] at deflections d [m], shape (...)."""
        return self.ratio_and_travel(deflection)[1]

    def deflection(self, travel: Array) -> Array:
        """Returns the deflections [m] for travels [m] of the element, shape (...), by Newton's method. The travel always
        increases with the deflection.
        """
        d = travel / self.at_rest
        for _ in range(TRIALS):
            d = d - (self.travel(d) - travel) / self(d)
        return d

    def damper(self, curve: ForceCurve) -> ForceSurface:
        """Returns the force of a damper at the wheel as a function of velocity and deflection.

        The force of a position-dependent damper is computed at the deflections of its own table and of the ratio table, and at
        `COLUMNS` more deflections. The force is interpolated linearly between neighbouring deflections.
        """
        d, v, table = self.x, curve.x, np.repeat(curve.force[:, None], len(self.x), axis=1)
        if isinstance(curve, ForceSurface):
            ends, v = self.deflection(curve.deflections), curve.velocities
            d = np.unique(np.round([0.0, *self.x, *ends, *np.linspace(ends[0], ends[-1], COLUMNS)], PLACES))
            table = curve.along(v[:, None], self.travel(d))
        surface = surface_of(v, d, table, f"{curve.words}, at its motion ratio", self(d))
        return replace(surface, slope=self.at_rest**2 * curve.slope)


def line(slope: float, low: float, high: float) -> ForceCurve:
    """Returns a straight characteristic with points at 0 and at both ends of travel, so that its attribute `range` is the
    largest force within the travel.
    """
    x = np.array([low, 0.0, high])
    return ForceCurve(x, slope * x, slope, "a line")


@dataclass(frozen=True)
class RatioSection(TableSection):
    """Section with the table of a motion ratio as a function of travel."""

    arguments: ClassVar[tuple[str, ...]] = (DEFLECTION.name,)
    of: ClassVar[str] = RATIO

    deflection: Annotated[tuple[float, ...], DEFLECTION] | None = None
    ratio: Annotated[tuple[float, ...], replace(FORCE, meaning="motion ratio at each deflection", each=SI("1"))] | None = None


def ratio_table(where: str, entry: Any, check: Callable[[float], object]) -> RatioTable:
    """Returns a motion ratio whose table is in a vehicle file. `check` raises an InputError for a ratio that is not allowed."""
    x, ratio = read(where, RatioSection, entry).points
    with error_in(f"{where}:"):
        if not x[0] < 0 < x[-1]:
            raise InputError(
                f"deflection goes from {x[0]:g} to {x[-1]:g} m, but both sides of equilibrium are needed; give values "
                "below 0 for compression and above 0 for extension"
            )
        for one in ratio.tolist():
            check(one)
    return RatioTable(x, ratio)
