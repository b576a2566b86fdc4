"""Steps of the linear vehicle with the curves of its dampers and springs: the reference of physics where these bend.

With xi as in `sim.linear.sampled_response`, y the arguments of the forces of `sim.linear.nonlinear_elements`, and E their effect
on the states,

    xi' = A xi + B u + (A Bw + Br) z_r + E f(y),    y = Y x,    x = xi + Bw z_r.

Over a step u and z_r are held.

Exact. Between two knots of its curves this is linear, and a Taylor series ends below rounding. Where a y passes a knot the step
is cut there, at the root of its polynomial. A y that passes a knot and returns between two of `LOOKS` looks at a step is missed:
that moves a wheel's velocity by 1e-8 of itself. The weight of an adjustable damper whose valve lags is a power series, too, and
its force the product of two.

RK4. Stage by stage: MuJoCo's own arithmetic, to rounding, for a vehicle without geometry. Weights that lag are further states.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.kinds.linear_model import LinearModel
from models.suspension.damper_range import range_of
from models.vehicle.vehicle import Vehicle
from sim.linear.nonlinear_elements import Elements, adjustable_inputs, elements, with_dampers

LOOKS = 8  # per step, evenly spaced, at which passed knots are noticed
MOST_CUTS = 64  # per step; only diverging runs need more, and their knots no longer matter
SERIES = 1.0  # step times the vehicle's fastest rate: longer steps are done in parts


@dataclass(frozen=True, eq=False)
class Weights:
    """Coefficients of k adjustable dampers beyond their nominal ones, for N runs over a step.

    Attributes:
        now: coefficients that act at the step's start [N s/m], shape (N, k).
        set_to: coefficients that are commanded [N s/m], shape (N, k), equal to `now` if no valve lags.
    """

    now: Array
    set_to: Array


class CurvedSteps:
    """Steps of N runs of a vehicle with curves, over which forces and the road are held."""

    def __init__(self, vehicle: Vehicle, model: LinearModel, timestep: float, exact: bool, dampers: bool = False) -> None:
        """Prepares the steps for a linear model whose first states are the vehicle's.

        Args:
            timestep: timestep of the steps [s].
            exact: True for exact steps, False for those of RK4.
            dampers: True if the vehicle's adjustable dampers have weights, in its order; the model must then be its own.
        """
        nonlinear = elements(vehicle, model)
        self.elements = nonlinear = with_dampers(nonlinear, vehicle) if dampers else nonlinear
        self.exact, self.timestep = exact, timestep
        adjusted = vehicle.adjustable if dampers else ()
        self.fixed = len(nonlinear.curves) - len(adjusted)
        self.rates = np.array([adjustable.damper.bandwidth or 0.0 for adjustable in adjusted])
        self.stacked = np.ascontiguousarray(np.vstack([model.A, nonlinear.rows]).T)
        self.n, self.push = len(model.A), np.ascontiguousarray(nonlinear.push.T)
        self.of_inputs, self.of_road = model.B.T, (model.A @ model.jump + model.Br).T
        self.jump = model.jump.T
        self._tabulate(nonlinear)
        steepest = np.abs(self.slopes).max(axis=1, initial=0.0)
        if dampers:
            of, some = range_of([adjusted], model.inputs), adjustable_inputs(vehicle)
            steepest[self.fixed :] *= np.maximum(-of.low[0, some], of.high[0, some])
        self.parts, self.order = _series(model.A, nonlinear, steepest, float(self.rates.max(initial=0.0)), timestep)
        looks = np.arange(1, LOOKS + 1) / LOOKS
        self.looks = looks, looks[:, None] ** np.arange(self.order + 1)

    def _tabulate(self, nonlinear: Elements) -> None:
        """Stores knots and slopes of every element, shapes (e, K) and (e, K + 1), and the pieces, padded to one width."""
        count, curves = len(nonlinear.curves), [curve for curve in nonlinear.curves if curve is not None]
        width = max((len(curve.x) for curve in curves), default=0)
        self.knots = np.full((count, width), np.inf)
        self.low, self.high = np.full((count, width + 1), -np.inf), np.full((count, width + 1), np.inf)
        self.slopes, self.offsets = np.tile(nonlinear.lines[:, None], width + 1), np.zeros((count, width + 1))
        self.pieces = np.zeros((4, count, max((len(curve.pieces.slope) for curve in curves), default=0)))
        for i, curve in enumerate(nonlinear.curves):
            if curve is None:
                continue
            x, slope, force, pieces = curve.x, curve.slopes - curve.slope, curve.pieces.force(curve.x), curve.pieces
            k = len(x)
            self.knots[i, :k] = x
            self.high[i, :k], self.low[i, 1 : k + 1] = x, x
            self.slopes[i, : k + 1] += slope
            first = np.concatenate([[0], np.arange(k)])
            self.offsets[i, : k + 1] = force[first] - slope * x[first]
            self.pieces[:, i, : len(pieces.slope)] = pieces.slope, pieces.start, pieces.low, pieces.high

    def beyond(self, states: Array, heights: Array) -> Array:
        """Returns the curves' contribution to the output signals, shape (..., p).

        Args:
            states: x, shape (..., n).
            heights: road heights [m], shape (..., r).
        """
        return self._force(self.over(states, heights)) @ self.elements.outputs.T

    def over(self, states: Array, heights: Array) -> Array:
        """Returns the arguments y of the forces, shape (..., e). Arguments as for `beyond`."""
        nonlinear = self.elements
        return (states - heights @ self.jump) @ nonlinear.rows.T + heights @ nonlinear.of_road.T

    def _force(self, y: Array) -> Array:
        slope, start, low, high = self.pieces
        return np.minimum(np.maximum(slope * (y[..., None] - start), low), high).sum(axis=-1)  # `np.clip` takes twice as long

    def __call__(
        self, xi: Array, inputs: Array, heights: Array, pushed: Array | None = None, weights: Weights | None = None
    ) -> Array:
        """Returns xi after a step, shape (N, n).

        Args:
            xi: xi before the step, shape (N, n).
            inputs: inputs, held over the step, shape (N, m).
            heights: heights of the road, held over the step [m], shape (N, r).
            pushed: contribution of held loads to xi', shape (N, n), or None.
            weights: weights of the adjustable dampers, if any.
        """
        constant, offset = inputs @ self.of_inputs + heights @ self.of_road, heights @ self.elements.of_road.T
        if pushed is not None:
            constant = constant + pushed
        if self.exact:
            for part in range(self.parts):
                xi = self._exactly(xi, constant, offset, weights, part * self.timestep / self.parts)
            return xi
        return self._rk4(xi, constant, offset, weights)

    def after(self, weights: Weights) -> Array:
        """Returns the weights at the end of a step, shape (N, k)."""
        if self.exact:
            return weights.set_to + (weights.now - weights.set_to) * np.exp(-self.rates * self.timestep)
        z = self.rates * self.timestep
        return weights.now + z * (1 - z / 2 * (1 - z / 3 * (1 - z / 4))) * (weights.set_to - weights.now)

    def _stages(self, weights: Weights | None) -> list[Array | None]:
        """Returns the weights of every element in the four stages of RK4, shapes (N, e), or None for weights of 1."""
        if weights is None:
            return [None] * 4
        h, now, stages = self.timestep, weights.now, []
        for share in (0.5, 0.5, 1.0, 0.0):
            stages.append(np.concatenate([np.ones((len(now), self.fixed)), now], axis=1))
            now = weights.now + share * h * self.rates * (weights.set_to - now)
        return stages

    def _rk4(self, xi: Array, constant: Array, offset: Array, weights: Weights | None) -> Array:
        def rate(at: Array, weight: Array | None) -> Array:
            both = at @ self.stacked
            y = both[:, self.n :] + offset
            force = self._force(y) if weight is None else (self._force(y) + self.elements.lines * y) * weight
            return both[:, : self.n] + constant + force @ self.push

        h, (one, two, three, four) = self.timestep, self._stages(weights)
        k1 = rate(xi, one)
        k2 = rate(xi + h / 2 * k1, two)
        k3 = rate(xi + h / 2 * k2, three)
        k4 = rate(xi + h * k3, four)
        return xi + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def _exactly(self, xi: Array, constant: Array, offset: Array, weights: Weights | None, start: float) -> Array:
        """Returns xi after the part of a step that begins at `start` [s]."""
        y = xi @ self.stacked[:, self.n :] + offset
        where = (y[..., None] > self.knots).sum(axis=-1)
        every, length = np.arange(where.shape[1]), self.timestep / self.parts
        left, some = np.full(len(xi), length), np.arange(len(xi))
        result = np.array(xi)
        for _ in range(MOST_CUTS):
            at = where[some]
            moving = None if weights is None else self._moving(weights, some, start + length - left[some], left[some])
            series, values = self._expand(result[some], constant[some], offset[some], at, left[some], moving)
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

    def _moving(self, weights: Weights, some: Array, since: Array, length: Array) -> Array:
        """Returns the weights of every element as power series in shares of these lengths of time, shape (order + 1 or 1, N, e).

        Args:
            some: indices of the N runs.
            since: start of their series after the step's start [s], shape (N,).
            length: length of the step [s], shape (N,).
        """
        far = (weights.now - weights.set_to)[some] * np.exp(-self.rates * since[:, None])
        count = self.order + 1 if self.rates.any() else 1
        series = np.zeros((count, len(some), len(self.elements.curves)))
        series[0, :, : self.fixed], series[0, :, self.fixed :] = 1.0, weights.set_to[some] + far
        for j in range(1, count):
            far = far * (-self.rates * length[:, None] / j)
            series[j, :, self.fixed :] = far
        return series

    def _expand(
        self, xi: Array, constant: Array, offset: Array, where: Array, length: Array, weights: Array | None
    ) -> tuple[Array, Array]:
        """Returns Taylor series in shares of these lengths of time [s]: xi, shape (order + 1, N, n), and y, shape (order + 1, N,
        e).
        """
        every = np.arange(where.shape[1])
        slopes, offsets = self.slopes[every, where], self.offsets[every, where]
        series, values = np.empty((self.order + 1, *xi.shape)), np.empty((self.order + 1, *where.shape))
        series[0], step = xi, length[:, None]
        if weights is None:  # on these segments xi' is M xi + c, with one matrix of the vehicle and all slopes
            rows = self.stacked[:, self.n :]
            M = self.stacked[:, : self.n] + (rows * slopes[:, None]) @ self.push
            c = constant + (slopes * offset + offsets) @ self.push
            for i in range(self.order):
                rate = (series[i, :, None] @ M)[:, 0]
                series[i + 1] = (rate + c if i == 0 else rate) * (step / (i + 1))
            np.matmul(series, rows, out=values)
            values[0] += offset
            return series, values
        unweighted = np.empty_like(values)
        for i in range(self.order + 1):
            both = series[i] @ self.stacked
            values[i] = both[:, self.n :]
            if i == 0:
                values[0] += offset
            if i == self.order:
                break
            force = slopes * values[i]
            rate = both[:, : self.n]
            if i == 0:
                rate, force = rate + constant, force + offsets
            unweighted[i] = force
            force = (weights[: i + 1] * unweighted[i::-1][: len(weights)]).sum(axis=0)
            series[i + 1] = (rate + force @ self.push) * (step / (i + 1))
        return series, values


def _series(A: Array, nonlinear: Elements, steepest: Array, rate: float, timestep: float) -> tuple[int, int]:
    """Returns the number of parts of a step, and the order at which the series of a part ends below rounding.

    Args:
        steepest: largest ratio of force to argument of each element, shape (e,).
        rate: rate of the fastest valve [rad/s].
        timestep: timestep of the series [s].
    """
    worst = np.abs(A) + np.abs(nonlinear.push) @ (steepest[:, None] * np.abs(nonlinear.rows))
    balanced = np.asarray(linalg.matrix_balance(worst, permute=False)[0])
    size = (float(np.linalg.norm(balanced, 2)) + rate) * timestep
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
