"""The linear vehicle with the curves of its dampers and springs: what physics is held against where these are not straight.

With xi as in `sim.linear.loop` and y what the curves' forces are over, the velocities and deflections of suspensions,

    xi' = A xi + B u + (A Bw + Br) z_r + E g(y),    y = Y x,    x = xi + Bw z_r,

where g is what a curve has beyond its line (`models.curves`), and E what a force of that size, which pulls together, does to the
states. Over a step u and z_r are held.

Exact. Between two knots of its curves this is linear, and a Taylor series ends below rounding. Where a y passes a knot the step
is cut there, at the root of its polynomial. What would turn round beyond a knot between two of `LOOKS` looks at a step is passed
over: that moves a wheel's velocity by 1e-8 of itself.

As RK4 makes it. Stage by stage, so that it is MuJoCo's own arithmetic, to rounding, of a vehicle that has no geometry.

An adjustable damper may lie beside a curve: its coefficient less the nominal one, held over the step, is one more slope.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize

from models.common.arrays import Array
from models.curves.curve import Curve
from models.curves.reading import VELOCITY
from models.linear_model import LinearModel
from models.vehicle import Vehicle

LOOKS = 8  # at a step, for knots that are passed
MOST_CUTS = 64  # of a step; where a run has gone wild, its knots no longer matter
SERIES = 1.0  # of a step times the vehicle's rates: where it is more, the step is done in parts


@dataclass(frozen=True, eq=False)
class Elements:
    """What has curves, or a coefficient of its own, e of them, on a linear model of n states and p outputs.

    Attributes:
        curves: None for an element whose curve is straight.
        rows, of_road: from the states, and from the road's heights, to what each force is over, shapes (e, n) and (e, r).
        push: what each, as it pulls together, does to the states, shape (n, e).
        outputs: and to the output signals, shape (p, e).
    """

    curves: tuple[Curve | None, ...]
    rows: Array
    of_road: Array
    push: Array
    outputs: Array


def is_curved(vehicle: Vehicle) -> bool:
    """Whether a suspension of the vehicle has a curve that is not straight."""
    return any(len(one.curve.pieces.slope) for one in vehicle.fitted)


def elements(vehicle: Vehicle, model: LinearModel, dampers: bool = False) -> Elements:
    """The curves of a vehicle on its linear model, or on a larger one with the same outputs, whose first states are its own.

    Args:
        vehicle: the vehicle.
        model: the linear model.
        dampers: whether, before them, every suspension whose damper has no curve has an element, too, straight and over velocity,
            in the order of the kind's suspensions; its velocity has to be a signal of the vehicle.
    """
    kind, curved = vehicle.kind, [one for one in vehicle.fitted if len(one.curve.pieces.slope)]
    with_curve = {one.deflection for one in curved if one.over is VELOCITY}
    plain = [one for one in kind.suspensions if dampers and one.deflection not in with_curve]
    velocities = {one.deflection: one.velocity.name for one in kind.suspensions}
    over = [velocities[one.deflection] for one in plain]
    over += [velocities[one.deflection] if one.over is VELOCITY else one.deflection for one in curved]
    index = [model.outputs.index(name) for name in over]
    at = [one.deflection for one in (*plain, *curved)]
    push, outputs = _pulls(vehicle, at)
    push = np.vstack([push, np.zeros((len(model.A) - len(push), len(at)))])
    rows = model.C[index]
    return Elements(
        (*(None for _ in plain), *(one.curve for one in curved)), rows, model.Cr[index] + rows @ model.Bw, push, outputs
    )


def _pulls(vehicle: Vehicle, deflections: list[str]) -> tuple[Array, Array]:
    """What forces that pull suspensions together do to states and outputs, shapes (n, e) and (p, e).

    That of a suspension without an actuator follows from what a parameter of its spring or damper does.
    """
    model, kind = vehicle.linear_model, vehicle.kind
    of = {one.deflection: one for one in kind.suspensions}
    push, outputs = np.zeros((len(model.A), len(deflections))), np.zeros((len(model.C), len(deflections)))
    for j, name in enumerate(deflections):
        force = of[name].force
        if force in model.inputs:
            i = model.inputs.index(force)
            push[:, j], outputs[:, j] = -model.B[:, i], -model.D[:, i]
            continue
        parameter = of[name].stiffness
        stretched = [one.deflection for one in kind.suspensions if one.stiffness == parameter]
        more = kind.model({**vehicle.parameters, parameter: 2 * vehicle.parameters[parameter]})
        by = np.linalg.pinv(model.rows(stretched)[0]) / vehicle.parameters[parameter]
        push[:, j] = ((more.A - model.A) @ by)[:, stretched.index(name)]
        outputs[:, j] = ((more.C - model.C) @ by)[:, stretched.index(name)]
    outputs[[model.outputs.index(name) for name in model.inputs]] = 0.0  # of which the curve's is none
    return push, outputs


class CurvedSteps:
    """Steps of N runs of a vehicle with curves, over which forces and the road are held."""

    def __init__(self, vehicle: Vehicle, model: LinearModel, timestep: float, exact: bool, dampers: bool = False) -> None:
        """For a linear model whose first states are the vehicle's; exactly, or as RK4 makes them.

        Args:
            vehicle: the vehicle.
            model: n states, m inputs.
            timestep: [s].
            exact: whether exactly.
            dampers: see `elements`.
        """
        self.elements, self.exact, self.timestep = elements(vehicle, model, dampers), exact, timestep
        one = self.elements
        self.stacked = np.ascontiguousarray(np.vstack([model.A, one.rows]).T)
        self.n, self.push = len(model.A), np.ascontiguousarray(one.push.T)
        self.of_inputs, self.of_road = model.B.T, (model.A @ model.Bw + model.Br).T
        self.jump = model.Bw.T
        self._tabulate(one.curves)
        self.parts, self.order = _series(model.A, one, timestep)
        looks = np.arange(1, LOOKS + 1) / LOOKS
        self.looks = looks, looks[:, None] ** np.arange(self.order + 1)

    def _tabulate(self, curves: tuple[Curve | None, ...]) -> None:
        """Knots and slopes beyond the line of every element, shapes (e, K) and (e, K + 1), and the pieces, all of one width."""
        knots = [np.zeros(0) if curve is None else curve.x for curve in curves]
        slopes = [np.zeros(1) if curve is None else curve.slopes - curve.slope for curve in curves]
        at_knots = [np.zeros(0) if curve is None else curve.pieces.force(curve.x) for curve in curves]
        width = max((len(one) for one in knots), default=0)
        self.knots = np.full((len(curves), width), np.inf)
        self.low, self.high = np.full((len(curves), width + 1), -np.inf), np.full((len(curves), width + 1), np.inf)
        self.slopes, self.offsets = np.zeros((len(curves), width + 1)), np.zeros((len(curves), width + 1))
        most = max((len(curve.pieces.slope) for curve in curves if curve is not None), default=0)
        self.pieces = np.zeros((4, len(curves), most))
        for i, (x, slope, force, curve) in enumerate(zip(knots, slopes, at_knots, curves, strict=True)):
            if curve is None:
                continue
            count = len(x)
            self.knots[i, :count] = x
            self.high[i, :count], self.low[i, 1 : count + 1] = x, x
            self.slopes[i, : count + 1] = slope
            first = np.concatenate([[0], np.arange(count)])
            self.offsets[i, : count + 1] = force[first] - slope * x[first]
            one = curve.pieces
            self.pieces[:, i, : len(one.slope)] = one.slope, one.start, one.low, one.high

    def beyond(self, states: Array, heights: Array) -> Array:
        """What the curves add to the output signals, shape (..., p).

        Args:
            states: x, shape (..., n).
            heights: of the road [m], shape (..., r).
        """
        return self._force(self.over(states, heights)) @ self.elements.outputs.T

    def over(self, states: Array, heights: Array) -> Array:
        """What the forces are over, shape (..., e), from the same."""
        one = self.elements
        return (states - heights @ self.jump) @ one.rows.T + heights @ one.of_road.T

    def _force(self, y: Array) -> Array:
        slope, start, low, high = self.pieces
        return np.clip(slope * (y[..., None] - start), low, high).sum(axis=-1)

    def __call__(
        self, xi: Array, inputs: Array, heights: Array, coefficients: Array | None = None, pushed: Array | None = None
    ) -> Array:
        """xi after a step, shape (N, n).

        Args:
            xi: before it, shape (N, n).
            inputs: held, shape (N, m).
            heights: of the road, held [m], shape (N, r).
            coefficients: of every element, held, to its slope [N s/m], shape (N, e); None for none.
            pushed: what loads, held, add to xi', shape (N, n); None for nothing.
        """
        constant, offset = inputs @ self.of_inputs + heights @ self.of_road, heights @ self.elements.of_road.T
        if pushed is not None:
            constant = constant + pushed
        if self.exact:
            for _ in range(self.parts):
                xi = self._exactly(xi, constant, offset, coefficients)
            return xi
        return self._rk4(xi, constant, offset, coefficients)

    def _rk4(self, xi: Array, constant: Array, offset: Array, coefficients: Array | None) -> Array:
        def rate(at: Array) -> Array:
            both = at @ self.stacked
            y = both[:, self.n :] + offset
            force = self._force(y) if coefficients is None else self._force(y) + coefficients * y
            return both[:, : self.n] + constant + force @ self.push

        h = self.timestep
        k1 = rate(xi)
        k2 = rate(xi + h / 2 * k1)
        k3 = rate(xi + h / 2 * k2)
        k4 = rate(xi + h * k3)
        return xi + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    def _exactly(self, xi: Array, constant: Array, offset: Array, coefficients: Array | None) -> Array:
        """Over one part of a step."""
        y = xi @ self.stacked[:, self.n :] + offset
        where = (y[..., None] > self.knots).sum(axis=-1)
        every = np.arange(where.shape[1])
        left, some = np.full(len(xi), self.timestep / self.parts), np.arange(len(xi))
        result = np.array(xi)
        for _ in range(MOST_CUTS):
            at, more = where[some], None if coefficients is None else coefficients[some]
            series, values = self._expand(result[some], constant[some], offset[some], at, left[some], more)
            low, high = self.low[every, at], self.high[every, at]
            looks, powers = self.looks
            seen = np.tensordot(powers, values, axes=1)
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

    def _expand(
        self, xi: Array, constant: Array, offset: Array, where: Array, length: Array, coefficients: Array | None
    ) -> tuple[Array, Array]:
        """Taylor series in shares of these lengths of time [s], (order + 1, N, n) of xi and (order + 1, N, e) of y."""
        every = np.arange(where.shape[1])
        slopes, offsets = self.slopes[every, where], self.offsets[every, where]
        if coefficients is not None:
            slopes = slopes + coefficients
        series, values = np.empty((self.order + 1, *xi.shape)), np.empty((self.order + 1, *where.shape))
        series[0], step = xi, length[:, None]
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
            series[i + 1] = (rate + force @ self.push) * (step / (i + 1))
        return series, values


def _series(A: Array, one: Elements, timestep: float) -> tuple[int, int]:
    """In how many parts a step is done, and after how many terms its series ends below rounding."""
    steepest = np.array([0.0 if curve is None else np.abs(curve.slopes - curve.slope).max() for curve in one.curves])
    worst = np.abs(A) + np.abs(one.push) @ (steepest[:, None] * np.abs(one.rows))
    balanced = np.asarray(linalg.matrix_balance(worst, permute=False)[0])
    size = float(np.linalg.norm(balanced, 2)) * timestep
    parts = max(1, math.ceil(size / SERIES))
    order = next(k for k in range(2, 40) if (size / parts) ** (k + 1) / math.factorial(k + 1) < 1e-17)
    return parts, order


def _first_leave(values: Array, out: Array, looks: Array, low: Array, high: Array) -> tuple[float, int, int]:
    """When, as a share of the time, an element first leaves its segment, which it is, and on which side."""
    first = int(out.any(axis=1).argmax())
    found = (2.0, 0, 0)
    for element in np.flatnonzero(out[first]).tolist():
        line = values[::-1, element]
        end = float(looks[first])
        side = 1 if np.polyval(line, end) > high[element] else -1
        bound = high[element] if side > 0 else low[element]
        share = _root(line, float(looks[first - 1]) if first else 0.0, end, float(bound), side)
        found = min(found, (share, element, side))
    return found


def _root(line: Array, start: float, end: float, bound: float, side: int) -> float:
    """Where a polynomial, its highest power first, passes a bound between two places, at the first of which it may be on it."""

    def past(at: float) -> float:
        return side * (float(np.polyval(line, at)) - bound)

    return start if past(start) >= 0 else optimize.root_scalar(past, bracket=(start, end), method="brentq", xtol=1e-15).root
