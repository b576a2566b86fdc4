"""Motion ratio that changes with travel: a table r(d) over the deflection d at the wheel, straight between its points.

Beyond its points the ratio is constant. An element with the pull F over its own travel D, which is the integral of r from rest,
and the preload N that carries the load W = r(0) N at rest, pulls at the wheel with

    P(d) = r(d) (F(D(d)) - N) + W,    P'(0) = r(0)^2 F'(0) - r'(0) N,

and a damper of force G over its velocity with r(d) G(r(d) d'). Where r' differs on both sides of rest, the linear model has its
mean. P is straight lines, as the curves of `models.suspension.curve_reading` are; the line about rest has the slope P'(0).

A bump stop has no preload and no lines. An actuator pushes with r(d) u, where r is that at the start of each time step; a
semi-active damper's coefficient acts through the same ratio.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, ClassVar

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, error_in
from models.common.schema import SI, read
from models.suspension import RATIO
from models.suspension.bump_stops import Stop, Stops
from models.suspension.curve import ForceCurve, slope_at_rest
from models.suspension.curve_lines import lines_from_rest
from models.suspension.curve_reading import DEFLECTION, FORCE, MOST_LINES, TableSection
from models.suspension.surface import ForceSurface, surface_of

# Of the lines, over the largest force: the first with as few lines as MuJoCo has for a curve.
ERRORS = (1e-5, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05)
TRIALS = 12  # of the search for a deflection, which is exact after one within a part of constant ratio
FARTHEST, HALVINGS = 1.0, 60  # m, of the search for a rest
FAST = 1.0  # m/s, of a straight damper, whose force there is its largest one
COLUMNS = 41  # of a position-dependent damper: the error between them is the square of their distance, times r' / 8
PLACES = 9  # decimal places of a deflection [m] at which tables have a point
FINE = 801  # points of P, of which the lines take some


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

    @property
    def at_rest(self) -> float:
        """r(0)."""
        return float(self(np.zeros(())))

    @cached_property
    def turn(self) -> float:
        """r'(0) over r(0) [1/m], the mean of both sides of rest."""
        i = int(np.searchsorted(self.x, 0.0))
        x = np.insert(self.x, i, 0.0) if 0.0 not in self.x else self.x
        return slope_at_rest(x, self(x)) / self.at_rest

    def scaled(self, at_rest: float) -> "RatioTable":
        """Returns the table times a factor, with another ratio at rest."""
        return replace(self, ratio=self.ratio * (at_rest / self.at_rest))

    def about(self, rest: float) -> "RatioTable":
        """Returns the table over deflections from another rest [m].

        Raises:
            InputError: the table ends before.
        """
        if not self.x[0] < rest < self.x[-1]:
            raise InputError(
                f"the equilibrium moves beyond the table, which goes from {self.x[0]:g} to {self.x[-1]:g} m; extend the table"
            )
        return replace(self, x=self.x - rest)

    def carrying(self, rate: float, load: float, other: float) -> float:
        """Returns the deflection at which a spring of a rate [N/m] that carries a load at rest carries another one [N]."""
        low, high = -FARTHEST, FARTHEST
        for _ in range(HALVINGS):
            d = (low + high) / 2
            short = self(np.array(d)) * (load / self.at_rest - rate * self.travel(np.array(d))) < other
            low, high = (low, d) if short else (d, high)
        return (low + high) / 2

    def travel(self, deflection: Array) -> Array:
        """Returns D [m] at deflections [m], shape (...)."""
        d = np.clip(deflection, self.x[0], self.x[-1])
        i = np.clip(np.searchsorted(self.x, d) - 1, 0, len(self.x) - 2)
        at = np.concatenate([[0.0], np.cumsum((self.ratio[1:] + self.ratio[:-1]) / 2 * np.diff(self.x))])
        within = at[i] + (self.ratio[i] + self(d)) / 2 * (d - self.x[i])
        rest = int(np.searchsorted(self.x, 0.0, side="right")) - 1
        to_rest = at[rest] + (self.ratio[rest] + self.at_rest) / 2 * -self.x[rest]
        return within - to_rest + self(d) * (deflection - d)

    def deflection(self, travel: Array) -> Array:
        """Returns the deflections [m] at travels [m] of the element, shape (...), by Newton's method: D rises everywhere."""
        d = travel / self.at_rest
        for _ in range(TRIALS):
            d = d - (self.travel(d) - travel) / self(d)
        return d

    def spring(self, curve: ForceCurve | None, rate: float, load: float) -> ForceCurve:
        """Returns P of a spring that carries a load W [N] at rest, by its curve, or None for one of a constant rate."""
        curve = curve or line(rate, *self.travel(self.x[[0, -1]]).tolist())
        preload = load / self.at_rest
        slope = self.at_rest**2 * curve.slope - self.turn * load
        reach = [*self.x, *self.deflection(curve.x)]
        # Twice as far all is straight.
        x = np.unique([0.0, *reach, *np.linspace(min(reach), max(reach), FINE), 2 * min(reach), 2 * max(reach)])

        def pull(d: Array) -> Array:
            return self(d) * (curve(self.travel(d)) - preload) + load

        force = pull(x)
        largest = float(np.abs(force[1:-1]).max())
        by_error = ((error, lines_from_rest(x, force, (slope, slope), error * largest / 2)) for error in ERRORS)
        error, lines = next((one for one in by_error if len(one[1][0]) <= MOST_LINES + 1), (0.0, (x, force)))
        if not error:
            raise InputError(f"the motion ratio turns this curve into more than {MOST_LINES} straight lines; smooth their tables")
        words = f"{curve.words}, at its motion ratio {len(lines[0]) - 1} straight lines within {100 * error:g} %"
        return ForceCurve(*lines, slope, words)

    def damper(self, curve: ForceCurve | None, rate: float) -> ForceSurface:
        """Returns the force of a damper at the wheel over velocity and deflection; arguments as for a spring.

        One that is position-dependent has the forces of its table at the deflections of both tables and at `COLUMNS` more, and is
        straight between.
        """
        curve = curve or line(rate, -FAST, FAST)
        d, v, table = self.x, curve.x, np.repeat(curve.force[:, None], len(self.x), axis=1)
        if isinstance(curve, ForceSurface):
            ends, v = self.deflection(curve.deflections), curve.velocities
            d = np.unique(np.round([0.0, *self.x, *ends, *np.linspace(ends[0], ends[-1], COLUMNS)], PLACES))
            table = curve.along(v[:, None], self.travel(d))
        surface = surface_of(v, d, table, f"{curve.words}, at its motion ratio", self(d))
        return replace(surface, slope=self.at_rest**2 * curve.slope)

    def stops(self, stops: Stops) -> Stops:
        """Returns bump stops as they act at the wheel."""
        both = {}
        for side, (sign, stop) in stops.sides.items():
            begins = abs(float(self.deflection(np.array(sign * stop.stroke))))
            both[side] = StopOverTravel(begins, stop.stiffness, sign, stop, self)
        return replace(stops, **both)

    @cached_property
    def key(self) -> bytes:
        """Equal for tables with the same ratios."""
        return self.x.tobytes() + self.ratio.tobytes()


@dataclass(frozen=True)
class StopOverTravel(Stop):
    """Bump stop at the wheel, through a motion ratio r(d) that changes with travel: r(d) F(D(d) - stroke).

    Attributes:
        sign: sign of its side's deflection.
        own: the stop itself.
        table: the motion ratio.
    """

    over_travel: ClassVar[bool] = True

    sign: float
    own: Stop
    table: RatioTable

    def acts(self, beyond: Array) -> Array:
        """See `Stop.acts`."""
        return self.table(self.sign * (self.stroke + beyond)) * self.own.acts(self._compressed(beyond))

    def work(self, beyond: Array) -> Array:
        """See `Stop.work`."""
        return self.own.work(self._compressed(beyond))

    def _compressed(self, beyond: Array) -> Array:
        """Returns the compression of the stop itself [m]."""
        travel = self.sign * self.table.travel(self.sign * (self.stroke + beyond))
        return np.where(beyond > 0, np.maximum(travel - self.own.stroke, 0.0), 0.0)


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
