"""Motion ratio that changes with travel: a table r(d) over the deflection d at the wheel, straight between its points.

Beyond its points the ratio is constant. The travel D of an element's own ends is the integral of r from rest. The forces of an
element at a ratio are those of `models.parts.ratio`.
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

TRIALS = 12  # of the search for a deflection, which is exact after one within a part of constant ratio
FARTHEST, HALVINGS = 1.0, 60  # m, of the search for a rest
COLUMNS = 41  # of a position-dependent damper: the error between them is the square of their distance, times r' / 8
PLACES = 9  # decimal places of a deflection [m] at which tables have a point


@dataclass(frozen=True, eq=False)
class RatioTable:
    """Motion ratio over the deflection of a suspension.

    Attributes:
        x: deflections [m], ascending, with rest among the inner ones, shape (n,).
        ratio: r at these, shape (n,).
        straight: True for the tangent of springs and dampers at rest, of linear analysis, instead of the table.
    """

    x: Array
    ratio: Array
    straight: bool = False

    def __call__(self, deflection: Array) -> Array:
        """Returns r at deflections [m], shape (...)."""
        return np.interp(deflection, self.x, self.ratio)

    @cached_property
    def at_rest(self) -> float:
        """r(0)."""
        return float(self(np.zeros(())))

    @cached_property
    def relative_slope(self) -> float:
        """r'(0) over r(0) [1/m], the mean of both sides of rest."""
        i = int(np.searchsorted(self.x, 0.0))
        x = np.insert(self.x, i, 0.0) if 0.0 not in self.x else self.x
        return slope_at_rest(x, self(x)) / self.at_rest

    def scaled(self, at_rest: float) -> "RatioTable":
        """Returns the table times a factor, with another ratio at rest."""
        return replace(self, ratio=self.ratio * (at_rest / self.at_rest))

    def shifted_to(self, rest: float) -> "RatioTable":
        """Returns the table over deflections from another rest [m].

        Raises:
            InputError: the table ends before.
        """
        if not self.x[0] < rest < self.x[-1]:
            raise InputError(
                f"the equilibrium moves beyond the table, which goes from {self.x[0]:g} to {self.x[-1]:g} m; extend the table"
            )
        return replace(self, x=self.x - rest)

    def rest_at_load(self, rate: float, load: float, other: float) -> float:
        """Returns the deflection at which a spring of a rate [N/m] that carries a load at rest carries another one [N]."""
        low, high = -FARTHEST, FARTHEST
        for _ in range(HALVINGS):
            d = (low + high) / 2
            short = self(np.array(d)) * (load / self.at_rest - rate * self.travel(np.array(d))) < other
            low, high = (low, d) if short else (d, high)
        return (low + high) / 2

    @cached_property
    def _segments(self) -> Array:
        """Start, travel there, ratio there and its slope of each segment and of the constant ends, shape (4, n + 1)."""
        x, r = self.x, self.ratio
        at = np.concatenate([[0.0], np.cumsum((r[1:] + r[:-1]) / 2 * np.diff(x))])
        rest = int(np.searchsorted(x, 0.0, side="right")) - 1
        at -= at[rest] + (r[rest] + self.at_rest) / 2 * -x[rest]
        first, slope = np.concatenate([[0], np.arange(len(x))]), np.concatenate([[0.0], np.diff(r) / np.diff(x), [0.0]])
        return np.stack([x[first], at[first], r[first], slope])

    def ratio_and_travel(self, deflection: Array) -> tuple[Array, Array]:
        """Returns r, and D [m], at deflections [m], shapes (...)."""
        start, travel, ratio, slope = self._segments[:, self.x.searchsorted(deflection)]
        s = deflection - start
        turned = slope * s
        return ratio + turned, travel + s * (ratio + turned / 2)

    def slope(self, deflection: Array) -> Array:
        """Returns r' at deflections [1/m], shape (...); at a point of the table that below the point."""
        return self._segments[3][self.x.searchsorted(deflection)]

    def travel(self, deflection: Array) -> Array:
        """Returns D [m] at deflections [m], shape (...)."""
        return self.ratio_and_travel(deflection)[1]

    def deflection(self, travel: Array) -> Array:
        """Returns the deflections [m] at travels [m] of the element, shape (...), by Newton's method: D rises everywhere."""
        d = travel / self.at_rest
        for _ in range(TRIALS):
            d = d - (self.travel(d) - travel) / self(d)
        return d

    def damper(self, curve: ForceCurve) -> ForceSurface:
        """Returns the force of a damper at the wheel over velocity and deflection.

        One that is position-dependent has the forces of its table at the deflections of both tables and at `COLUMNS` more, and is
        straight between.
        """
        d, v, table = self.x, curve.x, np.repeat(curve.force[:, None], len(self.x), axis=1)
        if isinstance(curve, ForceSurface):
            ends, v = self.deflection(curve.deflections), curve.velocities
            d = np.unique(np.round([0.0, *self.x, *ends, *np.linspace(ends[0], ends[-1], COLUMNS)], PLACES))
            table = curve.along(v[:, None], self.travel(d))
        surface = surface_of(v, d, table, f"{curve.words}, at its motion ratio", self(d))
        return replace(surface, slope=self.at_rest**2 * curve.slope)


def line(slope: float, low: float, high: float) -> ForceCurve:
    """Returns a straight characteristic, whose largest force is that at the ends of a range."""
    x = np.array([low, 0.0, high])
    return ForceCurve(x, slope * x, slope, "a line")


@dataclass(frozen=True)
class RatioSection(TableSection):
    """Motion ratio over travel."""

    arguments: ClassVar[tuple[str, ...]] = (DEFLECTION.name,)
    of: ClassVar[str] = RATIO

    deflection: Annotated[tuple[float, ...], DEFLECTION] | None = None
    ratio: Annotated[tuple[float, ...], replace(FORCE, meaning="motion ratio at each of these", each=SI("1"))] | None = None


def ratio_table(where: str, entry: Any, check: Callable[[float], object]) -> RatioTable:
    """Returns a motion ratio from its table in a vehicle file; `check` raises an InputError for a ratio that is not allowed."""
    x, ratio = read(where, RatioSection, entry).points
    with error_in(f"{where}:"):
        if not x[0] < 0 < x[-1]:
            raise InputError(f"deflection goes from {x[0]:g} to {x[-1]:g} m; give both sides of rest: below 0 in compression")
        for one in ratio.tolist():
            check(one)
    return RatioTable(x, ratio)
