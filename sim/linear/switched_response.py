"""The exact response of a vehicle with adjustable dampers: a linear system that is switched at samples.

While its coefficients are held the vehicle is linear. With d the coefficients beyond the nominal ones and V from the state to the
velocities of the suspensions, u = -d V x (-d h(V x) with two curves), so that over a step, as in `sim.linear.sampled_response`,

    xi' = (A - B diag(d) V) xi + (A Bw + Br) z_r,    x = xi + Bw z_r,

with the road held midway, and loads on the body as in `sim.linear.sampled_response`: a matrix exponential. At every sample the
controller decides d again, from this response alone. If a valve lags, d(t) approaches the decision exponentially, and xi is a
power series in time, taken to rounding. With curves of dampers and springs a step is as in `sim.linear.piecewise_linear_steps`.

A decision that is a switch can differ between physics and this response by rounding. The response then follows physics, if a
change of the compared signals within that rounding makes the controller decide so. Such samples are listed.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.laws.linear import LinearLaw
from models.laws.semi_active import SemiActive, SemiActiveLaw
from models.roads.road import RoadInput
from models.suspension.damper_range import range_of
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.semi_active_coefficients import numbers_at, numbers_of
from models.vehicle.vehicle import Vehicle
from sim.linear.dampers import bent_velocities, damper_signals, stretching
from sim.linear.nonlinear_elements import adjustable_inputs
from sim.linear.piecewise_linear_steps import CurvedSteps, Weights
from sim.linear.sampled_response import response_of, taylor4
from sim.response.response import Response
from synth.controller.controller import Controller
from synth.plant.discrete import held_inputs

OTHERWISE = 1e-4  # of a damper's range: coefficients that differ by more are different decisions
VELOCITY = "velocity"  # key of the suspensions' velocities, which are no signal
TOGETHER = 256  # random changes of all compared signals at once
NEAREST = 1e-13  # relative to the compared signals: the resolution of double precision


@dataclass(frozen=True)
class DecisionMismatch:
    """Sample at which physics and the reference decide differently, by rounding.

    Attributes:
        time: time of the sample [s].
        force: force of the damper.
        margin: smallest change of the compared signals, relative to their peaks, that reverses the decision.
    """

    time: float
    force: str
    margin: float


class Decisions:
    """Decisions of the controller of one run, sample by sample.

    Attributes:
        of: range of the dampers.
        kept: the states of the controller at its last sample, shape (k,).
    """

    def __init__(
        self, vehicle: Vehicle, controller: Controller | SemiActive, period: float, near: float, peaks: Callable[[str], float]
    ) -> None:
        """Prepares a controller that samples with this period.

        Args:
            period: sample period [s].
            near: largest margin that is attributed to rounding, see `DecisionMismatch.margin`.
            peaks: the peak of a signal, or of "velocity", that of the suspensions.
        """
        self.forces, self._near = vehicle.linear_model.inputs, near
        self.of = range_of([vehicle.adjustable], self.forces)
        self._law = controller.law.sampled(period) if isinstance(controller, Controller) else controller.law
        states, self._anti_windup = 0, None
        if isinstance(self._law, LinearLaw):
            states = self._law.states
            if self._law.anti_windup is not None:
                from models.laws.anti_windup import anti_windup_gain

                self._anti_windup = anti_windup_gain(self._law)
        self._nominal = np.array([adjustable.nominal for adjustable in vehicle.adjustable])
        self._numbers = numbers_of([self._law], [vehicle]) if isinstance(self._law, SemiActiveLaw) else None
        self.kept, self._next = np.zeros(states), np.zeros(states)
        self._scales = np.array([peaks(name) for name in controller.measured] + [peaks(VELOCITY)] * len(self.forces))
        self._largest = np.zeros(states)

    def __call__(self, y: Array, velocity: Array) -> Array:
        """Returns the commands (see `CoefficientRange.commands`) at the next sample, shape (2 m,).

        Args:
            y: measurements, shape (q,).
            velocity: velocities of the suspensions [m/s], shape (m,).
        """
        self.kept = self._next
        if isinstance(self._law, LinearLaw):
            self._next = self._law.A @ self.kept + self._law.B @ y
            if self._anti_windup is not None:
                requested = (self._law.D @ y + self._law.C @ self.kept)[None]
                self._next += self._anti_windup @ self.of.clipped_off(requested, self._closing(velocity[None]))[0]
        self._largest = np.maximum(self._largest, np.abs(self.kept))
        return self._decided(np.concatenate([y, velocity])[None], self.kept[None])[0]

    def nearness(self, y: Array, velocity: Array, other: Array) -> Array:
        """Returns each margin of the last decision, see `DecisionMismatch.margin`, shape (m,); infinite beyond the allowed one.

        Args:
            y, velocity: measurements and velocities of that decision.
            other: coefficients beyond the nominal ones, shape (m,).
        """
        seen, m = np.concatenate([y, velocity, self.kept]), len(self.forces)
        moves = np.concatenate([self._scales, self._largest])
        # Alone, and together: all are rounded at once, and a ratio of two that are nothing else can be any.
        rng, shape = np.random.default_rng(0), (TOGETHER, len(moves))
        together = rng.choice([-1.0, 1.0], shape) * 10 ** rng.uniform(-3.0, 0.0, shape)
        rows = np.concatenate([np.diag(moves), -np.diag(moves), together * moves])
        margins, epsilon = np.full(m, np.inf), NEAREST
        while epsilon <= self._near * (1 + 1e-9):
            tried = seen + epsilon * rows
            split = len(y) + m
            decided = self._decided(tried[:, :split], tried[:, split:])[:, :m]
            slack = OTHERWISE * np.where(self.of.adjustable, self.of.high[0] - self.of.low[0], 0.0)
            within = (decided.min(axis=0) - slack <= other) & (other <= decided.max(axis=0) + slack)
            margins = np.where(within & np.isinf(margins), epsilon, margins)
            epsilon *= 10
        return margins

    def _decided(self, seen: Array, kept: Array) -> Array:
        """Returns the commands from measurements and velocities, shape (P, q + m), and states, shape (P, k)."""
        m, which = len(self.forces), np.zeros(len(seen), dtype=int)
        closing = self._closing(seen[:, -m:])
        if not isinstance(self._law, LinearLaw):
            assert self._numbers is not None, "of a semi-active law"
            numbers = numbers_at(self._numbers.subset(which), self.of, closing, which)
            requested = self._law.coefficients(seen[:, :-m], numbers) - self._nominal
            return self.of.clip_coefficients(requested, closing, which)
        requested = seen[:, :-m] @ self._law.D.T + kept @ self._law.C.T
        return self.of.commands(np.concatenate([requested, closing], axis=-1), which)

    def _closing(self, velocity: Array) -> Array:
        """Returns the closing velocities of `CoefficientRange.commands` from the suspensions' velocities, shape (P, m)."""
        return np.where(self.of.adjustable, -velocity, 0.0) + self.of.at_rest


MOST_KEPT = 256  # cached matrices of steps, one per set of coefficients; a law that switches has few
MOST_TERMS = 60  # of a power series over a step, whose terms fall from the tenth on


@dataclass(frozen=True, eq=False)
class Switched:
    """Response of a vehicle with adjustable dampers.

    Attributes:
        states: states of the vehicle, shape (T, n).
        inputs: forces beyond those of the nominal dampers [N], shape (T, m).
        beyond: actual coefficients beyond the nominal ones [N s/m], 0 for force actuators, shape (T, m).
        missing: requested minus actual forces [N], shape (T, m).
        outside: contribution of curves and loads to the output signals, shape (T, p).
        kept: states of the controller at its last sample, shape (T, k).
        otherwise: samples at which the response follows a different decision of physics.
    """

    states: Array
    inputs: Array
    beyond: Array
    missing: Array
    outside: Array
    kept: Array
    otherwise: tuple[DecisionMismatch, ...]


def switched(
    road: RoadInput, decisions: Decisions | None, commands: Array, measured: tuple[str, ...], as_rk4: bool = False
) -> Switched:
    """Returns the response from rest.

    Args:
        decisions: decisions of the controller, or None if the commands are known.
        commands: commands if known, shape (T, 2 m), see `CoefficientRange.commands`; with decisions, those of physics.
        as_rk4: True for RK4's own arithmetic.
    """
    vehicle, time, h = road.vehicle, road.time, road.timestep
    model, how = vehicle.linear_model, vehicle.implementation
    period, m = steps_per_sample(how, h), len(model.inputs)
    late = round(how.delay * period)
    C, D = model.rows(measured)
    V, jump = stretching(vehicle), road.heights @ model.jump.T
    midway, loads = road.midway, road.held
    index = [model.outputs.index(name) for name in measured]
    load_outputs = np.concatenate([np.zeros_like(loads[:1]), loads[:-1]]) @ model.Dh[index].T
    bent = any(damper.pair is not None for damper in vehicle.dampers.values())
    step: _Steps = (_CurvedStep if bent or vehicle.is_curved else _Step)(
        vehicle, h, as_rk4, midway, loads if road.pushed else None
    )
    states, inputs, beyond, missing = (np.zeros((len(time), width)) for width in (len(model.A), m, m, m))
    kept = np.zeros((len(time), len(decisions.kept) if decisions is not None else 0))
    dampers = np.array([force in vehicle.dampers for force in model.inputs])
    waiting: list[tuple[int, Array]] = []
    otherwise: list[DecisionMismatch] = []
    xi, acting, command = np.zeros(len(model.A)), np.zeros(m), np.zeros(2 * m)
    for k in range(len(time)):
        x = xi + jump[k]
        v = V @ x
        moved = bent_velocities(vehicle, v) if bent else v
        if decisions is None:
            command = commands[k]
        else:
            if k % period == 0:
                y = C @ x + D @ np.where(
                    dampers, -acting * moved, command[:m]
                )  # a reading contains the forces that acted until then
                y = y + load_outputs[k] if road.pushed else y
                y = y if step.curves is None else y + step.curves.beyond(x, road.heights[k])[index]
                decided = decisions(y, v)
                if k + late < len(time):
                    decided = _followed(decisions, decided, y, v, moved, commands[k + late, :m], float(time[k]), otherwise)
                waiting.append((k + late, decided))
            while waiting and waiting[0][0] <= k:
                command = waiting.pop(0)[1]
            kept[k] = decisions.kept
        acting = np.where(step.lags, acting, command[:m])
        states[k], beyond[k], missing[k] = x, np.where(dampers, acting, 0.0), command[m:]
        inputs[k] = np.where(dampers, -acting * moved, command[:m])
        xi, acting = step(xi, acting, command[:m], k)
    outside = loads @ model.Dh.T if step.curves is None else loads @ model.Dh.T + step.curves.beyond(states, road.heights)
    return Switched(states, inputs, beyond, missing, outside, kept, tuple(otherwise))


def switched_response(controller: Controller | SemiActive, road: RoadInput) -> Response:
    """Returns the response of a vehicle with adjustable dampers on its own, without physics to follow.

    Unless there are curves or loads it is proportional to the road, as a force over a velocity decides a coefficient.

    Args:
        road: road under the vehicle; noise on its measurements is omitted.
    """
    road = replace(road, vehicle=replace(road.vehicle, implementation=road.vehicle.implementation.without_noise))
    vehicle, period = road.vehicle, steps_per_sample(road.vehicle.implementation, road.timestep) * road.timestep
    decisions = Decisions(vehicle, controller, period, near=0.0, peaks=lambda name: 0.0)
    unknown = np.full((len(road.time), 2 * len(vehicle.linear_model.inputs)), np.nan)
    response = switched(road, decisions, unknown, controller.measured)
    beside = damper_signals(vehicle, response.beyond, response.missing)
    return response_of(vehicle.linear_model, road, response.states, response.inputs, response.outside, beside)


def _followed(
    decisions: Decisions,
    decided: Array,
    y: Array,
    v: Array,
    moved: Array,
    other: Array,
    time: float,
    otherwise: list[DecisionMismatch],
) -> Array:
    """Returns the decision, or that of physics if both are within rounding of each other; such a sample is appended to
    `otherwise`.

    Args:
        decided: the commands, shape (2 m,).
        moved: factors from coefficients to forces, shape (m,).
        other: coefficients in physics, shape (m,).
        time: time of the sample [s].
    """
    of, m = decisions.of, len(other)
    apart = of.adjustable & ~(np.abs(decided[:m] - other) <= OTHERWISE * np.where(of.adjustable, of.high[0] - of.low[0], 1.0))
    if not apart.any() or not np.all(np.isfinite(other)):
        return decided
    margins = decisions.nearness(y, v, other)
    followed = decided.copy()
    for j in np.flatnonzero(apart & np.isfinite(margins)):
        otherwise.append(DecisionMismatch(time, decisions.forces[j], float(margins[j])))
        followed[j] = other[j]
        followed[m + j] += (other[j] - decided[j]) * moved[j]
    return followed


class _Steps(Protocol):
    """Steps of a vehicle with adjustable dampers, from the commands at their starts.

    Attributes:
        lags: True for each actuator whose valve lags behind its command, shape (m,).
        curves: steps of the vehicle's curves, or None if it has no curves.
    """

    lags: Array
    curves: CurvedSteps | None

    def __call__(self, xi: Array, acting: Array, set_to: Array, k: int) -> tuple[Array, Array]:
        """Returns the state after a step, and the coefficients then: the commands, except of dampers that lag.

        Args:
            xi: the state, shape (n,).
            acting: actual coefficients at its start, shape (m,).
            set_to: commands: coefficients, or forces of force actuators, shape (m,).
        """
        ...


class _CurvedStep:
    """Steps of a vehicle with curves."""

    def __init__(self, vehicle: Vehicle, h: float, as_rk4: bool, midway: Array, loads: Array | None) -> None:
        """Prepares T steps of h seconds over the road's heights, shape (T, r), under loads, shape (T, l)."""
        model = vehicle.linear_model
        self.curves: CurvedSteps | None = CurvedSteps(vehicle, model, h, exact=not as_rk4, dampers=True)
        self.midway, self.pushed = midway, None if loads is None else loads @ model.Bh.T
        self.some, self.lags = adjustable_inputs(vehicle), lagging(vehicle)
        self.dampers = np.isin(np.arange(len(model.inputs)), self.some)

    def __call__(self, xi: Array, acting: Array, set_to: Array, k: int) -> tuple[Array, Array]:
        """See `_Steps`."""
        assert self.curves is not None, "it has curves"
        weights = Weights(acting[None, self.some], set_to[None, self.some])
        pushed = None if self.pushed is None else self.pushed[k : k + 1]
        after, forces = set_to.copy(), np.where(self.dampers, 0.0, set_to)
        after[self.some] = self.curves.after(weights)[0]
        xi = self.curves(xi[None], forces[None], self.midway[k : k + 1], pushed, weights)[0]
        return xi, np.where(self.lags, after, set_to)


def lagging(vehicle: Vehicle) -> Array:
    """Returns True for every input that is an adjustable damper whose valve lags, shape (m,)."""
    slow = {force for force, damper in vehicle.dampers.items() if damper.bandwidth is not None}
    return np.array([force in slow for force in vehicle.linear_model.inputs])


class _Step:
    """Steps of a vehicle without curves."""

    def __init__(self, vehicle: Vehicle, h: float, as_rk4: bool, midway: Array, loads: Array | None) -> None:
        """Prepares T steps of h seconds over the road's heights, shape (T, r), under loads, shape (T, l)."""
        model = vehicle.linear_model
        self.curves: CurvedSteps | None = None
        self.h, self.as_rk4, self.A, self.B, self.V = h, as_rk4, model.A, model.B, stretching(vehicle)
        self.push = midway @ (model.A @ model.jump + model.Br).T
        if loads is not None:
            self.push += loads @ model.Bh.T
        self.dampers = np.array([force in vehicle.dampers for force in model.inputs])
        self.lags = lagging(vehicle)
        bandwidths = [vehicle.dampers[force].bandwidth if force in vehicle.dampers else None for force in model.inputs]
        self.rates = np.array([bandwidth or 0.0 for bandwidth in bandwidths])
        self._known: dict[bytes, list[Array]] = {}

    def __call__(self, xi: Array, acting: Array, set_to: Array, k: int) -> tuple[Array, Array]:
        """See `_Steps`."""
        push = self.push[k]
        if self.lags.any():
            push = push + self.B @ np.where(self.dampers, 0.0, set_to)
            return (self._stages if self.as_rk4 else self._series)(xi, acting, set_to, push)
        beyond = np.where(self.dampers, set_to, 0.0)
        key = beyond.tobytes()
        if key not in self._known:
            if len(self._known) >= MOST_KEPT:
                self._known.clear()
            exponential = taylor4 if self.as_rk4 else linalg.expm
            A = self.A - (self.B * beyond) @ self.V
            self._known[key] = held_inputs(A, self.h, exponential, self.B, np.eye(len(A)))
        Phi, Gamma, pushed = self._known[key]
        return Phi @ xi + Gamma @ np.where(self.dampers, 0.0, set_to) + pushed @ push, set_to

    def _rate(self, xi: Array, acting: Array, push: Array) -> Array:
        return self.A @ xi - self.B @ (np.where(self.dampers, acting, 0.0) * (self.V @ xi)) + push

    def _stages(self, xi: Array, acting: Array, set_to: Array, push: Array) -> tuple[Array, Array]:
        """Steps state and coefficients together by RK4, as MuJoCo does."""
        h, moves, changes = self.h, [], []
        at, now = xi, acting
        for share in (0.5, 0.5, 1.0, 0.0):
            moves.append(self._rate(at, now, push))
            changes.append(self.rates * (set_to - now))
            at, now = xi + share * h * moves[-1], acting + share * h * changes[-1]
        mean = [(k[0] + 2 * k[1] + 2 * k[2] + k[3]) / 6 for k in (moves, changes)]
        return xi + h * mean[0], np.where(self.lags, acting + h * mean[1], set_to)

    def _series(self, xi: Array, acting: Array, set_to: Array, push: Array) -> tuple[Array, Array]:
        """Steps state and coefficients by their power series, to rounding."""
        h, total, terms = self.h, xi.copy(), [xi]
        far = np.where(self.lags, acting - set_to, 0.0)
        coefficients = [np.where(self.dampers, set_to + far, 0.0)]
        for j in range(MOST_TERMS):
            forces = sum(d * (self.V @ x) for d, x in zip(coefficients, reversed(terms), strict=True))
            term = h / (j + 1) * (self.A @ terms[-1] - self.B @ forces + (push if j == 0 else 0.0))
            total += term
            terms.append(term)
            far = far * (-self.rates * h / (j + 1))
            coefficients.append(far)
            if j > 3 and np.abs(term).max() <= 1e-18 * np.abs(total).max() and np.abs(far).max() <= 1e-18 * np.abs(set_to).max():
                break
        return total, np.where(self.lags, set_to + (acting - set_to) * np.exp(-self.rates * h), set_to)
