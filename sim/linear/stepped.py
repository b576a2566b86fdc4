"""Response of a vehicle that is linear except for its suspension forces, computed in steps of RK4 like those of MuJoCo.

The state xi is defined in `sim.linear.sampled_response`. The vector f contains the forces of `SuspensionForces`, and the matrix
E their effect on the states:

    xi' = A xi + B u + (A J + Br) z_r + Bh l + E f(d, v, u, z),    x = xi + J z_r,

The deflections d, their rates v and the states z of parts depend linearly on the state x. If the states of parts obey nonlinear
equations, f also contains the nonlinear terms of their rates. If a motion ratio changes an inertance by b(d) from the value
that A contains, f also contains b(d) v' with v' = V xi'. The force u, the road height z_r and the loads l are constant during
each step. Only f is nonlinear. The four stages of a step are therefore products with matrices that are computed in advance, and
only f is evaluated in each stage.

Actuator forces and the coefficients of semi-active dampers are computed at each stage, with their lag and with the present
motion ratio. At every sample, a law requests forces, and each semi-active damper applies the allowed coefficient whose force is
closest to the requested force. Limits of suspension travel and of actuator force are not included.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import error_in
from models.kinds.linear_model import LinearModel
from models.kinds.signals import kept_signals
from models.laws.anti_windup import anti_windup_gain
from models.laws.linear import LinearLaw
from models.parts.damper_range import CoefficientRange, range_of
from models.roads.road import RoadInput
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.suspension_forces import MotionRatios, SuspensionForces
from models.vehicle.vehicle import Vehicle
from sim.drive.recursion import SHARES, WEIGHTS, lag_rates, recursion
from sim.drive.response import Response
from sim.linear.dampers import damper_signals, stretching_rates
from sim.linear.linear_motion import suspensions_of
from sim.linear.outputs import forces_ahead, response_of, with_linear_sides
from synth.controller.controller import Controller


class Stepper:
    """Computes the RK4 steps of N runs of a vehicle with m inputs. Inputs, road heights and loads are constant during each
    step.

    Attributes:
        model: linear model with n states; the last states are the inputs behind a lag. Damping coefficients are also inputs,
            but have no effect in this model.
    """

    def __init__(self, vehicle: Vehicle, timestep: float) -> None:
        """Prepares the steps. `timestep` is in s."""
        self._vehicle = vehicle
        self.model, acting, at_once = _with_lags(vehicle)
        self._forces = SuspensionForces([vehicle], whole=False, contacts=False)
        linear, model = vehicle.linear_model, self.model
        rows, of_road, push, shown = suspensions_of(vehicle, linear, vehicle.force_effects, self._forces.acts)
        (n, m), s, own = model.B.shape, shown.shape[1], self._forces.states if self._forces.moves else 0
        self._n, self._s, self._own, self.shown, self.ratios = n, s, own, shown, MotionRatios([vehicle])
        V = np.pad(rows[s:], ((0, 0), (0, n - rows.shape[1]))) if self._forces.inertial else np.zeros((0, n))
        self._response = V[:, : len(push)] @ push  # change of the velocities' derivative v' per newton of each force
        # the last states of the linear model are those of the vehicle's parts
        push = np.hstack([push, np.eye(len(push), own, own - len(push))])
        w = s + own
        felt = bool(vehicle.dampers or self.ratios.over_travel)
        self._stretching = stretching_rates(vehicle) if vehicle.dampers else np.zeros((m, n))
        self._still = None if felt else np.zeros((1, m))  # zeros that replace the inputs if no force depends on them
        rows, of_inputs = np.pad(rows, ((0, 0), (0, n - rows.shape[1]))), np.zeros((2 * s, m))
        of_road = of_road + rows @ model.jump
        if felt:
            rows, of_inputs = np.vstack([rows, acting]), np.vstack([of_inputs, at_once])
            of_road = np.pad(of_road, ((0, m), (0, 0)))
        if own:
            rows = np.vstack([rows, np.eye(own, n, len(push) - own)])
            of_inputs, of_road = (np.pad(one, ((0, own), (0, 0))) for one in (of_inputs, of_road))
        self._acting, self._at_once = acting.T, at_once.T
        self._rows = np.vstack([rows, V @ model.A]).T
        self._of_road = np.vstack([of_road, V @ (model.A @ model.jump + model.Br)]).T
        self._of_inputs, self._of_held = np.vstack([of_inputs, V @ model.B]).T, V @ model.Bh
        # Matrices that advance the state by a whole step. Their columns are for states, inputs, road, loads, and the forces at
        # the four stages of RK4.
        held = np.hstack([model.B, model.A @ model.jump + model.Br, model.Bh])
        forces = n + held.shape[1]
        start = total = np.eye(n, forces + 4 * w)
        rate, stages = np.zeros_like(start), list[Array]()
        argument = np.hstack([np.zeros((len(rows), n)), of_inputs, of_road, np.zeros((len(rows), model.Bh.shape[1] + 4 * w))])
        for i, (share, weight) in enumerate(zip(SHARES, WEIGHTS, strict=True)):
            at = start + share * timestep * rate
            moved = rows @ at + argument
            rate = model.A @ at
            rate[:, n:forces] += held
            stages.append(np.vstack([moved, V @ rate]))
            rate[: len(push), forces + i * w : forces + (i + 1) * w] += push
            total = total + weight * timestep * rate
        every = np.vstack([total, *stages]).T
        self._of_states, self.by_inputs, self._outside = (
            np.ascontiguousarray(every[begin:end]) for begin, end in ((0, n), (n, n + m), (n + m, forces))
        )
        self._pushed = np.ascontiguousarray(total[:, forces:].T)
        self._later = [np.ascontiguousarray(one[:, forces : forces + i * w].T) for i, one in enumerate(stages)]
        width = len(rows) + len(V)
        self._stages = [slice(n + i * width, n + (i + 1) * width) for i in range(len(stages))]

    def outside(self, inputs: Sequence[RoadInput]) -> Array:
        """Returns the contribution of roads and loads to each step of N runs, shape (T, N, k)."""
        wheels, pushed = inputs[0].midway.shape[1], any(road.has_held_inputs for road in inputs)
        parts = ("midway", "held_inputs") if pushed else ("midway",)
        held = np.stack([np.hstack([getattr(road, name) for name in parts]) for road in inputs], axis=1)
        return held @ (self._outside if pushed else self._outside[:wheels])

    def __call__(self, xi: Array, added: Array) -> Array:
        """Returns the state xi after a step, shape (N, n).

        Args:
            xi: state xi of the vehicle before the step, shape (N, n).
            added: contribution of road, loads and inputs to the present step, shape (N, k), see `outside` and `by_inputs`.
        """
        known, s, w = xi.dot(self._of_states), self._s, self._s + self._own
        known += added
        pulls = np.empty((len(xi), 4 * w))
        for i, (stage, later) in enumerate(zip(self._stages, self._later, strict=True)):
            y = known[:, stage]
            if i:
                y = y + pulls[:, : i * w].dot(later)
            at, free = self._at(y)
            pulls[:, i * w : i * w + s] = self._pulls(at, free)
            if self._own:
                pulls[:, i * w + s : (i + 1) * w] = self._forces.rates(*at)
        return known[:, : self._n] + pulls.dot(self._pushed)

    def pulls(self, xi: Array, heights: Array, inputs: Array, held: Array | None = None) -> Array:
        """Returns the forces of the suspensions [N], shape (..., N, s).

        Args:
            xi: state xi of the vehicle, which does not jump when the road height jumps, shape (..., N, n).
            heights: road heights [m], shape (..., N, r).
            inputs: requested forces, or damping coefficients of semi-active dampers, shape (..., N, m).
            held: external loads on the body, shape (..., N, l), followed by road velocities if tyres have damping, shape (...,
                N, l + r); None if all are zero.
        """
        y = xi @ self._rows + heights @ self._of_road + inputs @ self._of_inputs
        if held is not None and len(self._of_held):
            y[..., -self._s :] += held @ self._of_held.T
        return self._pulls(*self._at(y))

    def _at(self, y: Array) -> tuple[tuple[Array, Array, Array, Any], Array]:
        """Returns the arguments of `SuspensionForces` at a stage of RK4, and the velocities' derivatives v' without these
        suspension forces.
        """
        s, last = self._s, y.shape[-1] - len(self._response)
        end = last - self._own
        inputs = y[..., 2 * s : end] if self._still is None else self._still
        return (y[..., :s], y[..., s : 2 * s], inputs, y[..., end:last] if self._own else None), y[..., last:]

    def _pulls(self, at: tuple[Array, Array, Array, Any], free: Array) -> Array:
        """Returns the suspension forces, including the forces of inertial parts [N], shape (..., N, s); the arguments are those
        that `_at` returns.
        """
        f = self._forces(*at)
        if not len(self._response):
            return f
        b = self._forces.inertance(at[0])
        held = np.eye(self._s) - b[..., None] * self._response
        return np.linalg.solve(held, (f + b * free)[..., None])[..., 0]

    def speeds(self, xi: Array, heights: Array) -> Array:
        """Returns the extension rates of semi-active dampers [m/s], shape (..., m). The arguments are those of `pulls`."""
        travels = (xi @ self._rows + heights @ self._of_road)[..., : self._s]
        x = (xi + heights @ self.model.jump.T)[..., : len(self._vehicle.linear_model.states)]
        return x @ self._stretching.T * self.ratios.turns(travels)

    def closing(self, of: CoefficientRange, xi: Array, heights: Array) -> Array:
        """Returns the closing velocities and states that `CoefficientRange.closing` defines. The arguments are those of
        `pulls`.
        """
        travels = (xi @ self._rows + heights @ self._of_road)[..., : self._s] if of.elements else xi[..., : self._s]
        last = len(self._vehicle.linear_model.states)
        return of.closing(self.speeds(xi, heights), travels, xi[..., last - self._own : last])

    def response(self, road: RoadInput, xi: Array, inputs: Array, missing: Array) -> Array:
        """Returns the values of all signals of a run, shape (T, S).

        Args:
            xi, inputs: states xi at the samples, shape (T, n), and inputs, which are constant from sample to sample, shape (T,
                m).
            missing: parts of the requested forces that semi-active dampers do not supply [N], shape (T, m); (T, 0) without
                semi-active dampers.
        """
        vehicle, model, beside, x = self._vehicle, self.model, None, xi + road.heights @ self.model.jump.T
        held = road.in_signals[:, None] if road.has_held_inputs else None
        beyond = self.pulls(xi[:, None], road.heights[:, None], inputs[:, None], held)[:, 0] @ self.shown.T
        if road.has_held_inputs:
            beyond = beyond + road.in_signals @ model.Dh.T
        if vehicle.dampers:
            coefficients = xi @ self._acting + inputs @ self._at_once
            speeds = self.speeds(xi, road.heights)
            beside = damper_signals(vehicle, coefficients, missing)
            for one in vehicle.parts.adjustable:
                j = vehicle.linear_model.inputs.index(one.force)
                beside[one.force] = -coefficients[:, j] * one.shape(speeds[:, j])
            of = range_of([vehicle])
            if of.elements:
                given = of.forces(coefficients, self.closing(of, xi, road.heights))
                beside |= {model.inputs[one.column]: given[:, one.column] for one in of.elements}
        response = response_of(model, road, x, inputs, beyond, beside)
        # damper forces may contribute to the output signals
        for name, parts in vehicle.kind.combined.items() if vehicle.dampers else ():
            total = sum((share * response[part] for part, share in parts.items()), np.zeros(len(xi)))
            response.values[:, response.names.index(name)] = total
        return response.values


def _with_lags(vehicle: Vehicle) -> tuple[LinearModel, Array, Array]:
    """Returns the linear model with the lags of actuators and valves, and the gains from states and inputs to the inputs behind
    the lags.

    The gains from states have shape (m, n), and those from inputs have shape (m, m).
    """
    model, rates = vehicle.linear_model, lag_rates(vehicle)
    pushing, m = ~np.isin(model.inputs, list(vehicle.dampers)), len(rates)
    behind = replace(model, B=model.B * pushing, D=model.D * pushing).behind_lag(rates)
    acting = np.hstack([np.zeros((m, len(model.A))), np.eye(m)[:, rates > 0]])
    return behind, acting, np.diag(rates == 0).astype(float)


class _Laws:
    """Linear control laws of N runs; each law measures q signals at the samples of the controller. Laws with fewer states than
    others are padded with zeros.
    """

    def __init__(self, controllers: Sequence[Controller], inputs: Sequence[RoadInput], steps: Stepper, period: int) -> None:
        """Prepares the laws. `period` is the number of time steps in a sample period of the laws."""
        model, different, laws = steps.model, {id(one): one for one in controllers}, dict[int, LinearLaw]()
        for key, one in different.items():
            with error_in(f"controller {one.name!r}:"):
                laws[key] = one.law.sampled(period * inputs[0].timestep)
        self.states, self._forces = max(law.states for law in laws.values()), model.B.shape[1]
        self.idle = not (self.states or any(one.law.acts or one.preview is not None for one in controllers))
        measured = [*dict.fromkeys(name for one in different.values() for name in one.measured)]
        rows = [model.outputs.index(name) for name in measured]
        self.feels, self._readings = bool(steps.shown[rows].any()), np.hstack([model.C, model.D, steps.shown])[rows].T
        outside = np.hstack([model.C @ model.jump + model.Cr, model.Dh])[rows].T
        self._outside = np.stack([np.hstack([one.heights, one.in_readings])[::period] @ outside for one in inputs], axis=1)
        gains, windups = dict[int, Array](), dict[int, Array]()
        for key, law in laws.items():
            own, idle = [measured.index(name) for name in different[key].measured], self.states - law.states
            D, B = np.zeros((self._forces, len(rows))), np.zeros((law.states, len(rows)))
            D[:, own], B[:, own] = law.D, law.B
            gains[key] = np.pad(np.block([[D, law.C], [B, law.A]]), ((0, idle), (0, idle))).T
            windups[key] = np.pad(anti_windup_gain(law), ((0, idle), (0, 0))).T
        self._gains, self.windup = (np.stack([each[id(one)] for one in controllers]) for each in (gains, windups))
        self._ahead = np.zeros((*self._outside.shape[:2], self._forces + self.states))
        for i, (one, road) in enumerate(zip(controllers, inputs, strict=True)):
            if one.preview is not None:
                self._ahead[:, i, : self._forces] = forces_ahead(one.preview, road, period)[::period]

    def __call__(self, sample: int, xi: Array, inputs: Array, pulls: Array, law_states: Array) -> list[Array]:
        """Returns the forces that the laws request at a sample, shape (N, m), and the states of the laws after this sample,
        shape (N, k).

        Args:
            sample: index of the sample, counted from 0.
            xi, inputs, pulls: states, inputs and suspension forces of the vehicle at the sample. The array `inputs` contains
                the inputs that have acted until the sample.
            law_states: states of the laws before the sample, shape (N, k).
        """
        y = np.concatenate([xi, inputs, pulls], axis=1) @ self._readings + self._outside[sample]
        return np.split(
            np.vecmat(np.concatenate([y, law_states], axis=1), self._gains) + self._ahead[sample], [self._forces], axis=1
        )


@dataclass(frozen=True, eq=False)
class SteppedRuns:
    """Results of N runs over T time steps.

    Attributes:
        steps: object that computes the steps of the vehicle.
        inputs: road inputs of the N runs.
        states: states xi at the samples, shape (T, N, n).
        given_forces: inputs of the vehicle (forces or damping coefficients), constant from each sample to the next, shape (T,
            N, m).
        missing_forces: parts of the requested forces that semi-active dampers do not supply [N], shape (T, N, m); (T, N, 0)
            without semi-active dampers.
        law_states: states of the control laws, each at the law's last sample, shape (N, T, k).
    """

    steps: Stepper
    inputs: Sequence[RoadInput]
    states: Array
    given_forces: Array
    missing_forces: Array
    law_states: Array

    @property
    def response(self) -> Response:
        """Response with the signals of the vehicle, followed by the states of the control laws; its values have shape (N, T,
        S).
        """
        each = (self.states, self.given_forces, self.missing_forces)
        runs = [self.steps.response(road, *(one[:, i] for one in each)) for i, road in enumerate(self.inputs)]
        response = Response(self.inputs[0].time, self.inputs[0].vehicle.kind.signals, np.stack(runs))
        law_states = self.law_states.shape[-1]
        return response.with_signals(kept_signals(range(1, law_states + 1)), self.law_states) if law_states else response

    @property
    def single(self) -> Response:
        """Response of the first run, including the values on both sides of the road's vertical edges."""
        return with_linear_sides(self.response.run(0), self.inputs[0], True)

    @property
    @np.errstate(over="ignore", invalid="ignore")
    def finer(self) -> Response:
        """Response from which the estimated error of RK4 is removed.

        The error of a step is estimated by comparison with two steps of half the length, which are computed for all steps
        together. The error is assumed to propagate as in the linear model without the controller.
        """
        h, model = self.inputs[0].timestep, self.steps.model
        half = Stepper(self.inputs[0].vehicle, h / 2)
        added = half.outside(self.inputs) + self.given_forces @ half.by_inputs
        start, added = (one.reshape(-1, one.shape[-1]) for one in (self.states, added))
        end = half(half(start, added), added).reshape(self.states.shape)
        local = np.zeros_like(self.states)
        local[:-1] = 16 / 15 * (end[:-1] - self.states[1:])  # error estimate for a method of order 4
        error = np.moveaxis(recursion(linalg.expm(model.A * h), np.moveaxis(local, 1, 0)), 0, 1)
        return replace(self, states=self.states + error).response


@np.errstate(over="ignore", invalid="ignore")  # the signals of an unstable loop overflow; the run records this
def stepped_runs(controllers: Sequence[Controller], inputs: Sequence[RoadInput]) -> SteppedRuns:
    """Simulates the sampled loops of N runs, starting in equilibrium. For control laws with fewer states than others, the last
    entries of `law_states` are 0.

    Args:
        controllers: linear controllers of the N runs. Noise is not added to the measurements of these controllers.
        inputs: road inputs of the N runs, for the same vehicle and at the same sample times.
    """
    vehicle, time, h = inputs[0].vehicle, inputs[0].time, inputs[0].timestep
    how, of = vehicle.implementation, range_of([vehicle]) if vehicle.dampers else None
    period = steps_per_sample(how, h)
    steps, late = Stepper(vehicle, h), round(how.delay * period)
    laws = _Laws(controllers, inputs, steps, period)
    (n, m), count, samples = steps.model.B.shape, len(inputs), len(time)
    heights, added = np.stack([road.heights for road in inputs], axis=1), steps.outside(inputs)
    readings = np.stack([one.in_readings for one in inputs], axis=1) if any(one.has_held_inputs for one in inputs) else None
    states, given, missing = (np.zeros((samples, count, width)) for width in (n, m, m if of else 0))
    kept_along = np.zeros((len(range(0, samples, period)), count, laws.states))
    xi, law_states, now = (np.zeros((count, width)) for width in (n, laws.states, m))
    if (start := vehicle.start_state) is not None:
        xi[:, : len(start)] = start
    waiting = dict[int, Sequence[Array]]()
    lost, by_inputs, unfelt = np.zeros((count, missing.shape[2])), None, np.zeros((count, steps.shown.shape[1]))
    for k in range(samples):
        states[k] = xi
        if not laws.idle:
            if k % period == 0:  # the forces that have acted until now affect the measurement
                kept_along[k // period] = law_states
                pulls = steps.pulls(xi, heights[k], now, None if readings is None else readings[k]) if laws.feels else unfelt
                requested, law_states = laws(k // period, xi, now, pulls, law_states)
                waiting[k + late] = (requested, lost)
                if of is not None:
                    closing = steps.closing(of, xi, heights[k])
                    if laws.states:
                        law_states = law_states + np.vecmat(of.clipped_off(requested, closing), laws.windup)
                    waiting[k + late] = np.split(of.commands(np.concatenate([requested, closing], axis=1)), 2, axis=1)
            if k in waiting:
                now, lost = waiting.pop(k)
                by_inputs = now @ steps.by_inputs
            given[k], missing[k] = now, lost
        xi = steps(xi, added[k] if by_inputs is None else added[k] + by_inputs)
    factors = np.array([one.law.of_state(period * h) for one in controllers])[:, None, None]
    kept_along = factors * np.moveaxis(kept_along, 0, 1)[:, np.arange(samples) // period]
    return SteppedRuns(steps, inputs, states, given, missing, kept_along)


@np.errstate(over="ignore", invalid="ignore")
def forced_run(forces: Array, road: RoadInput) -> SteppedRuns:
    """Simulates one run, starting in equilibrium, with known requested forces at every sample [N], shape (T, m)."""
    steps = Stepper(road.vehicle, road.timestep)
    added, states = steps.outside([road]) + (forces @ steps.by_inputs)[:, None], np.zeros((len(road.time), 1, len(steps.model.A)))
    if (start := road.vehicle.start_state) is not None:
        states[0, :, : len(start)] = start
    for k in range(len(states) - 1):
        states[k + 1] = steps(states[k], added[k])
    given = np.asarray(forces)[:, None]
    return SteppedRuns(steps, [road], states, given, np.zeros_like(given), np.zeros((1, len(states), 0)))
