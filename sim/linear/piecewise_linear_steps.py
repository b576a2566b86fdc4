"""Steps of the linear vehicle with the curves of its dampers and springs: the reference of physics where these bend.

With xi as in `sim.linear.sampled_response`, y the arguments of the forces of `sim.linear.nonlinear_elements`, and E their effect
on the states,

    xi' = A xi + B u + (A Bw + Br) z_r + E f(y),    y = Y x,    x = xi + Bw z_r.

Over a step u and z_r are held.

Exact. Between two knots of its curves this is linear, and a Taylor series ends below rounding. In a cell of a damper's force over
velocity and deflection it is a product of such series. Where a y passes a knot the step is cut there, at the root of its
polynomial. A y that passes a knot and returns between two of `LOOKS` looks at a step is missed: that moves a wheel's velocity by
1e-8 of itself.

RK4. Stage by stage: MuJoCo's own arithmetic, to rounding, for a vehicle without geometry.

A motion ratio r(d) that changes with travel is held over a step, too: a force u pushes with r(d) u, d being that at its start.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy import linalg

from models.characteristics.curve import ForceCurve
from models.characteristics.surface import ForceSurface
from models.common.arrays import Array
from models.kinds.linear_model import LinearModel
from models.vehicle.vehicle import Vehicle
from sim.linear.nonlinear_elements import Elements, elements

LOOKS = 8  # per step, evenly spaced, at which passed knots are noticed
MOST_CUTS = 64  # per step; only diverging runs need more, and their knots no longer matter
SERIES = 1.0  # step times the vehicle's fastest rate: longer steps are done in parts


class CurvedSteps:
    """Steps of N runs of a vehicle with curves, over which forces and the road are held."""

    def __init__(self, vehicle: Vehicle, model: LinearModel, timestep: float, exact: bool) -> None:
        """Prepares the steps for a linear model whose first states are the vehicle's.

        Args:
            timestep: [s].
            exact: True for exact steps, False for those of RK4.
        """
        self.elements = nonlinear = elements(vehicle, model)
        self.exact, self.timestep, self.count = exact, timestep, len(nonlinear.curves)
        # Behind the arguments of all curves are the deflections of surfaces, which push nothing by themselves.
        self.surfaces = [i for i, one in enumerate(nonlinear.curves) if isinstance(one, ForceSurface)]
        self.alike = _alike(nonlinear.curves)
        self.rows = np.vstack([nonlinear.rows, nonlinear.travels])
        self.stacked = np.ascontiguousarray(np.vstack([model.A, self.rows]).T)
        self.arguments_of_road = np.vstack([nonlinear.of_road, nonlinear.travels_of_road]).T
        self.n, self.push = len(model.A), np.vstack([nonlinear.push.T, np.zeros((len(self.surfaces), len(model.A)))])
        self.of_inputs, self.of_road = model.B.T, (model.A @ model.jump + model.Br).T
        self.jump = model.jump.T
        # Forces through a motion ratio that changes with travel, each with its row of the outputs, and that of the deflection.
        pushed = [(name, vehicle.kind.pushed(name)) for name in vehicle.linear_model.inputs]
        pushed = [(name, travel) for name, travel in pushed if travel in vehicle.ratio_tables]
        self.ratios = [(vehicle.ratio_tables[travel], vehicle.motion_ratios[name]) for name, travel in pushed]
        forces, travels = ([model.outputs.index(pair[k]) for pair in pushed] for k in (0, 1))
        self.force_rows, self.force_inputs = model.C[forces], model.D[forces].T
        self.travel_rows, self.travels_of_road = model.C[travels].T, model.Cr[travels].T
        push, self.pulled = (one.T for one in vehicle.pulls_on([travel for _, travel in pushed]))
        self.pulled_states = np.hstack([push, np.zeros((len(push), self.n - push.shape[1]))])
        self._tabulate(nonlinear)
        steepest = np.abs(self.slopes).max(axis=1, initial=0.0)
        for surface, i, k in self.alike:
            steepest[i], steepest[self.count + k] = surface.steepest
        turned = [float(np.abs(table.ratio - at_rest).max()) for table, at_rest in self.ratios]
        pushed_by_lag = np.abs(self.pulled_states.T) * turned @ np.abs(self.force_rows)
        self.parts, self.order = _series(np.abs(model.A) + pushed_by_lag, nonlinear, steepest, timestep)
        looks = np.arange(1, LOOKS + 1) / LOOKS
        self.looks = looks, looks[:, None] ** np.arange(self.order + 1)

    def _tabulate(self, nonlinear: Elements) -> None:
        """Stores knots and slopes of every element, shapes (e, K) and (e, K + 1), and the pieces, padded to one width."""
        count, curves = self.count + len(self.surfaces), nonlinear.curves
        knots = [one.velocities if isinstance(one, ForceSurface) else one.x for one in curves]
        knots += [one.deflections for one in curves if isinstance(one, ForceSurface)]
        width = max((len(x) for x in knots), default=0)
        self.knots = np.full((count, width), np.inf)
        self.low, self.high = np.full((count, width + 1), -np.inf), np.full((count, width + 1), np.inf)
        self.slopes, self.offsets = np.zeros((count, width + 1)), np.zeros((count, width + 1))
        self.pieces = np.zeros((4, self.count, max((len(curve.pieces.slope) for curve in curves), default=0)))
        for i, x in enumerate(knots):
            k = len(x)
            self.knots[i, :k] = x
            self.high[i, :k], self.low[i, 1 : k + 1] = x, x
        for i, curve in enumerate(curves):
            if isinstance(curve, ForceSurface):
                continue
            x, slope, force, pieces = curve.x, curve.slopes - curve.slope, curve.pieces.force(curve.x), curve.pieces
            k = len(x)
            self.slopes[i, : k + 1] = slope
            first = np.concatenate([[0], np.arange(k)])
            self.offsets[i, : k + 1] = force[first] - slope * x[first]
            self.pieces[:, i, : len(pieces.slope)] = pieces.slope, pieces.start, pieces.low, pieces.high

    def beyond(self, states: Array, heights: Array, inputs: Array) -> Array:
        """Returns the contribution of curves, and of motion ratios beyond those at rest, to the output signals, shape (..., p).

        Args:
            states: x, shape (..., n).
            heights: road heights [m], shape (..., r).
            inputs: inputs that act, shape (..., m).
        """
        curves = self._force(self.over(states, heights)) @ self.elements.outputs.T
        if not self.ratios:
            return curves
        forces = states @ self.force_rows.T + inputs @ self.force_inputs
        return curves + (self._turned(states, heights) * forces) @ self.pulled

    def _turned(self, states: Array, heights: Array) -> Array:
        """Returns by how much the motion ratio of each force in `ratios` is below that at rest, shape (..., g)."""
        d = states @ self.travel_rows + heights @ self.travels_of_road
        return np.stack([at_rest - table(d[..., k]) for k, (table, at_rest) in enumerate(self.ratios)], axis=-1)

    def over(self, states: Array, heights: Array) -> Array:
        """Returns the arguments y of the forces, then the deflections of surfaces, shape (..., e + s). Arguments as for
        `beyond`.
        """
        return (states - heights @ self.jump) @ self.rows.T + heights @ self.arguments_of_road

    def _force(self, y: Array) -> Array:
        slope, start, low, high = self.pieces
        x = y[..., : self.count, None]
        force = np.minimum(np.maximum(slope * (x - start), low), high).sum(axis=-1)  # `np.clip` takes twice as long
        for surface, i, k in self.alike:
            force[..., i] = surface.beyond(y[..., i], y[..., self.count + k])
        return force

    def __call__(self, xi: Array, inputs: Array, heights: Array, pushed: Array | None = None) -> Array:
        """Returns xi after a step, shape (N, n).

        Args:
            xi: xi before the step, shape (N, n).
            inputs: held inputs, shape (N, m).
            heights: held road heights [m], shape (N, r).
            pushed: contribution of held loads to xi', shape (N, n), or None.
        """
        constant, offset = inputs @ self.of_inputs + heights @ self.of_road, heights @ self.arguments_of_road
        if pushed is not None:
            constant = constant + pushed
        A = self.stacked[:, : self.n]
        if self.ratios:  # forces that lag are states
            turned = self._turned(xi + heights @ self.jump, heights)
            constant = constant + (turned * (inputs @ self.force_inputs)) @ self.pulled_states
            A = A + (self.force_rows.T * turned[:, None]) @ self.pulled_states
        if self.exact:
            for _ in range(self.parts):
                xi = self._exactly(xi, A, constant, offset)
            return xi
        return self._rk4(xi, A, constant, offset)

    def _rk4(self, xi: Array, A: Array, constant: Array, offset: Array) -> Array:
        def rate(at: Array) -> Array:
            both = at @ self.stacked
            linear = both[:, : self.n] if A.ndim == 2 else (at[:, None] @ A)[:, 0]
            return linear + constant + self._force(both[:, self.n :] + offset) @ self.push[: self.count]

        h = self.timestep
        k1 = rate(xi)
        k2 = rate(xi + h / 2 * k1)
        k3 = rate(xi + h / 2 * k2)
        k4 = rate(xi + h * k3)
        return xi + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def _exactly(self, xi: Array, A: Array, constant: Array, offset: Array) -> Array:
        """Returns xi after a part of a step; the transposed A may be of each run, shape (n, n) or (N, n, n)."""
        y = xi @ self.stacked[:, self.n :] + offset
        for surface, i, k in self.alike:  # a table's velocity is that of its damper
            d = y[:, self.count + k]
            ratio, steep = surface.ratios[:, np.searchsorted(surface.deflections, d)]
            y[:, i] *= ratio + steep * d
        where = (y[..., None] > self.knots).sum(axis=-1)
        every, length = np.arange(where.shape[1]), self.timestep / self.parts
        left, some = np.full(len(xi), length), np.arange(len(xi))
        result = np.array(xi)
        for _ in range(MOST_CUTS):
            at = where[some]
            own = A if A.ndim == 2 else A[some]
            series, values = self._expand(result[some], own, constant[some], offset[some], at, left[some])
            low, high = self.low[every, at], self.high[every, at]
            looks, powers = self.looks
            seen = (powers @ values.reshape(len(values), -1)).reshape(len(looks), *at.shape)
            out = (seen < low) | (seen > high)
            leaving = out.any(axis=(0, 2))
            result[some] = series.sum(axis=0)
            if not leaving.any():
                break
            for k in np.flatnonzero(leaving):
                share, element, side = _first_leave(values[:, k], out[:, k], looks, low[k], high[k])
                i = some[k]
                result[i] = (share ** np.arange(len(series))) @ series[:, k]
                where[i, element] += side
                left[i] *= 1 - share
            some = some[leaving]
        return result

    def _expand(self, xi: Array, A: Array, constant: Array, offset: Array, where: Array, length: Array) -> tuple[Array, Array]:
        """Returns Taylor series in shares of these lengths of time [s]: xi, shape (order + 1, N, n), and y, shape (order + 1, N,
        e + s), with the velocities of surfaces' tables among them.
        """
        every = np.arange(where.shape[1])
        slopes, offsets = self.slopes[every, where], self.offsets[every, where]
        series, values = np.empty((self.order + 1, *xi.shape)), np.empty((self.order + 1, *where.shape))
        series[0], step = xi, length[:, None]
        # On these segments xi' is M xi + c, with one matrix of the vehicle and all slopes.
        rows = self.stacked[:, self.n :]
        M = A + (rows * slopes[:, None]) @ self.push
        c = constant + (slopes * offset + offsets) @ self.push
        products = self._products(where) if self.surfaces else None
        for i in range(self.order):
            rate = (series[i, :, None] @ M)[:, 0]
            if products is not None:
                y = series[i] @ rows + (offset if i == 0 else 0.0)
                rate += products.next(y[:, self.surfaces], y[:, self.count :]) @ self.push[self.surfaces]
            series[i + 1] = (rate + c if i == 0 else rate) * (step / (i + 1))
        np.matmul(series, rows, out=values)
        values[0] += offset
        if products is not None:
            products.next(values[-1][:, self.surfaces], values[-1, :, self.count :])
            values[..., self.surfaces] = products.u
        return series, values

    def _products(self, where: Array) -> "_Products":
        """Returns the products of the cells that N runs are in, by their segments, shape (N, e + s)."""
        shape = len(where), len(self.surfaces)
        cells, ratios, lines = np.empty((4, *shape)), np.empty((2, *shape)), np.empty(shape[1])
        for surface, i, k in self.alike:
            column = where[:, self.count + k]
            cells[..., k], ratios[..., k], lines[k] = (
                surface.cells[:, where[:, i], column],
                surface.ratios[:, column],
                surface.slope,
            )
        return _Products(cells, ratios, lines, self.order)


class _Products:
    """Taylor series of surfaces' forces beyond their lines, from those of velocity and deflection: s of them in N runs."""

    def __init__(self, cells: Array, ratios: Array, lines: Array, order: int) -> None:
        """Takes the coefficients of a cell and of r for each, shapes (4, N, s) and (2, N, s), and the slopes of the lines."""
        self._cells, self._ratios, self._lines, self._i = cells, ratios, lines, 0
        self._v, self._d, self._r, self._g, self.u = np.empty((5, order + 1, *cells.shape[1:]))

    def next(self, v: Array, d: Array) -> Array:
        """Returns the next coefficients of the forces [N], from those of velocities and deflections, shape (N, s)."""
        i, (a, b, c, e), (ratio, steep) = self._i, self._cells, self._ratios
        self._i, first = i + 1, i == 0
        self._v[i], self._d[i], self._r[i] = v, d, steep * d + ratio if first else steep * d
        self.u[i] = (self._r[: i + 1] * self._v[i::-1]).sum(axis=0)
        g = b * self.u[i] + c * d + e * (self.u[: i + 1] * self._d[i::-1]).sum(axis=0)
        self._g[i] = g + a if first else g
        return (self._r[: i + 1] * self._g[i::-1]).sum(axis=0) - self._lines * v


def _alike(curves: Sequence[ForceCurve]) -> list[tuple[ForceSurface, Array, Array]]:
    """Returns every surface with its indices among the curves, and among the surfaces."""
    surfaces = [(i, one) for i, one in enumerate(curves) if isinstance(one, ForceSurface)]
    groups: dict[bytes, list[tuple[int, int]]] = {}
    for k, (i, one) in enumerate(surfaces):
        groups.setdefault(one.key, []).append((i, k))
    return [(surfaces[pairs[0][1]][1], *np.array(pairs).T) for pairs in groups.values()]


def _series(A: Array, nonlinear: Elements, steepest: Array, timestep: float) -> tuple[int, int]:
    """Returns the number of parts of a step, and the order at which the series of a part ends below rounding.

    Args:
        steepest: largest ratio of force to argument of each element, then to the deflection of each surface, shape (e + s,).
        timestep: [s].
    """
    both = steepest[:, None] * np.abs(np.vstack([nonlinear.rows, nonlinear.travels]))
    on = [i for i, one in enumerate(nonlinear.curves) if isinstance(one, ForceSurface)]
    worst = np.abs(A) + np.abs(nonlinear.push[:, [*range(len(nonlinear.curves)), *on]]) @ both
    balanced = np.asarray(linalg.matrix_balance(worst, permute=False)[0])
    size = float(np.linalg.norm(balanced, 2)) * timestep
    parts = max(1, math.ceil(size / SERIES))
    order = next(k for k in range(2, 40) if (size / parts) ** (k + 1) / math.factorial(k + 1) < 1e-17)
    return parts, order


def _first_leave(values: Array, out: Array, looks: Array, low: Array, high: Array) -> tuple[float, int, int]:
    """Returns the first departure of an element from its segment: the share of the time, the element and the side."""
    first = int(out.any(axis=1).argmax())
    first_departure = (2.0, 0, 0)
    for element in np.flatnonzero(out[first]).tolist():
        line = values[::-1, element]
        end = float(looks[first])
        side = 1 if np.polyval(line, end) > high[element] else -1
        bound = high[element] if side > 0 else low[element]
        share = _root(line, float(looks[first - 1]) if first else 0.0, end, float(bound), side)
        first_departure = min(first_departure, (share, element, side))
    return first_departure


def _root(line: Array, start: float, end: float, bound: float, side: int) -> float:
    """Returns the point at which a polynomial, highest power first, crosses a bound between two points; the first may lie on
    it."""

    coefficients = line.tolist()

    def past(at: float) -> float:
        value = 0.0
        for coefficient in coefficients:
            value = value * at + coefficient
        return side * (value - bound)

    if past(start) >= 0:
        return start
    from scipy import optimize  # half a second

    return optimize.root_scalar(past, bracket=(start, end), method="brentq", xtol=1e-15).root
