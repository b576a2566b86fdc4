"""A damper's force as a function of velocity v and deflection d, as a table with bilinear interpolation.

Velocity and deflection are positive in extension, as in `models.characteristics.curve`. Outside its range of velocities, the
table is extrapolated linearly with the slopes at its ends. Outside its range of deflections, the table keeps the values of its
first or last column. The ratio r of damper travel to suspension travel is given at each deflection and interpolated linearly.
The force in the direction of the suspension's deflection is

    F(v, d) = r(d) G(r(d) v, d),    G(u, d) = a + b u + (c + e u) d    in each cell of the table.

Linear analysis uses the derivative of the force with respect to velocity at v = 0 and d = 0.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from models.characteristics.curve import STRAIGHT, ForceCurve, slope_at_rest
from models.common.arrays import Array

# Number of points for the mean over normally distributed deflections, and half the range of these points in standard deviations
NODES, WIDTH = 400, 6.0


@dataclass(frozen=True, eq=False)
class ForceSurface(ForceCurve):
    """A damper's force against velocity and deflection. Where a `ForceCurve` is expected, this object represents the force at
    deflection 0.

    Attributes:
        velocities: velocities u of the table [m/s], ascending, with 0 between the first and the last, shape (n,).
        deflections: deflections of the table [m], ascending, shape (k,).
        table: force G of the damper [N] for each velocity (row) and deflection (column), 0 at velocity 0, shape (n, k).
        ratio: motion ratio r at the deflections, above 0, shape (k,).
    """

    velocities: Array = field(kw_only=True)
    deflections: Array = field(kw_only=True)
    table: Array = field(kw_only=True)
    ratio: Array = field(kw_only=True)

    def along(self, velocity: Array, deflection: Array) -> Array:
        """Returns the force F at velocities and deflections of the suspension [N], shape (...)."""
        j = self.deflections.searchsorted(deflection)
        constant, steep = self.ratios
        r = constant.take(j) + steep.take(j) * deflection
        u = r * velocity
        i = self.velocities.searchsorted(u)
        # NumPy's `take` is faster than indexing an array with two indices
        a, b, c, e = self.cells.reshape(4, -1).take(i * len(constant) + j, axis=1)
        return r * (a + b * u + (c + e * u) * deflection)

    def beyond(self, velocity: Array, deflection: Array) -> Array:
        """Returns the deviation of the force F from its linearisation [N], shape (...)."""
        return self.along(velocity, deflection) - self.slope * np.asarray(velocity)

    def scaled(self, factor: float) -> "ForceSurface":
        scaled = {name: factor * getattr(self, name) for name in ("force", "slope", "table")}
        return self if factor == 1 else replace(self, **scaled)

    def at_wheel(self, ratio: float) -> "ForceSurface":
        parts = {name: getattr(self, name) / ratio for name in ("velocities", "deflections", "x")}
        parts |= {name: ratio * getattr(self, name) for name in ("table", "force")}
        return self if ratio == 1 else replace(self, slope=ratio**2 * self.slope, **parts)

    def mean(self, centre: float, deviation: float) -> ForceCurve:
        """Returns the mean of the force F over normally distributed deflections, at the velocities of the table.

        Deflections and velocities are assumed to be statistically independent.

        Args:
            centre: mean of the deflections [m].
            deviation: standard deviation of the deflections [m].
        """
        z = WIDTH * np.linspace(-1.0, 1.0, NODES) if deviation else np.zeros(1)
        weight = np.exp(-(z**2) / 2)
        x = self.velocities / np.interp(centre, self.deflections, self.ratio)
        force = self.along(x[:, None], centre + deviation * z) @ (weight / weight.sum())
        return ForceCurve(x, force, slope_at_rest(x, force), self.words)

    together = None  # pyright: ignore[reportAssignmentType]  # every surface has its own cells, so surfaces cannot be combined

    @cached_property
    def is_nonlinear(self) -> bool:
        v = self.velocities[:, None] / self.ratio  # suspension velocities at the points of the table
        return bool((np.abs(self.beyond(v, self.deflections)) > STRAIGHT * self.range).any())

    @property
    def slope_range(self) -> tuple[float, float]:
        steep = np.diff(self.table, axis=0) / np.diff(self.velocities)[:, None] * self.ratio**2
        return float(steep.min()), float(steep.max())

    @cached_property
    def range(self) -> float:
        return float(np.abs(self.ratio * self.table).max())

    @cached_property
    def cells(self) -> Array:
        """Coefficients a, b, c and e of the force in every cell, also in the cells beyond the table, shape (4, n + 1, k + 1)."""
        u, d, slope = self.velocities, self.deflections, np.diff(self.table, axis=0) / np.diff(self.velocities)[:, None]
        slope = np.vstack([slope[:1], slope, slope[-1:]])
        first = np.concatenate([[0], np.arange(len(u))])  # each row of cells is linear about the point with this index
        # Sums a + c d and b + e d of the coefficients of each cell, at the deflections d of the table
        ends = np.stack([self.table[first] - slope * u[first, None], slope])
        return np.concatenate(_lines(d, ends))

    @cached_property
    def ratios(self) -> Array:
        """Constants and slopes of the straight lines that give the motion ratio r between and beyond the deflections, shape (2,
        k + 1).
        """
        return np.stack(_lines(self.deflections, self.ratio))


def _lines(d: Array, values: Array) -> tuple[Array, Array]:
    """Returns the constants and slopes of straight lines that join the values at the deflections d, shapes (..., k + 1).

    Before the first and after the last deflection, the lines are horizontal.

    Args:
        d: arguments, ascending, shape (k,).
        values: values at the deflections, shape (..., k).
    """
    flat = np.zeros_like(values[..., :1])
    slope = np.concatenate([flat, np.diff(values) / np.diff(d), flat], axis=-1)
    first = np.concatenate([[0], np.arange(len(d))])
    return values[..., first] - slope * d[first], slope


def surface_of(velocities: Array, deflections: Array, table: Array, words: str, ratio: Array | None = None) -> ForceSurface:
    """Returns the `ForceSurface` of a table, and computes the characteristic at deflection 0. If `ratio` is None, the motion
    ratio is 1.
    """
    r = np.ones(len(deflections)) if ratio is None else ratio
    at_rest = float(np.interp(0.0, deflections, r))
    x = velocities / at_rest
    force = at_rest * np.array([np.interp(0.0, deflections, row) for row in table])
    return ForceSurface(
        x, force, slope_at_rest(x, force), words, velocities=velocities, deflections=deflections, table=table, ratio=r
    )
