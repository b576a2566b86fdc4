"""Frequency responses from the road's velocity, exact in two ways: of the sampled loop that MuJoCo runs, and the continuous one.

A road z_r(t) = Z exp(j omega t) under the wheels has the velocity W = j omega Z. All that follows is per unit of W.

Continuous.    x = (j omega - A_G)^-1 (Bw W + Br Z),    A_G = A + B K C_y.

Sampled, in the notation of `sim/linear/sampled_response.py`: at the samples the road is Z exp(j omega t_k), over a step it is
held at its midpoint, exp(j omega h/2) times as much, and the force is held. The recursion there then is solved by xi[k] = xi
exp(j omega h k) with

    (exp(j omega h) - Phi - Gamma_u G) xi = Gamma_r exp(j omega h/2) Z + Gamma_u G Bw Z,    x = xi + Bw Z,

without any approximation: a sampled sinusoid stays one. Where the controller's own sample period is several steps, it does not:
then the response is its share at omega itself, over all the steps of a period.

A preview adds to the requested forces the sum of its weights times exp(j omega i T), over the coming samples of every T seconds,
and continuous the integral of F(s) exp(j omega s).

A force in a suspension that is F exp(j omega t), held over a step at its midpoint as the road is, is one more Z, which moves no
state at once. Responses to such forces follow those to the wheels' roads, per newton.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.kinds.linear_model import LinearModel
from models.roads.spectrum import as_met
from models.vehicle.limits_and_implementation import Implementation, steps_held, steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.linear.nonlinear_elements import Elements
from synth.controller.controller import Controller
from synth.controller.open_loop import OpenLoop, continuous, heights_read, readings_of_road, sampled
from synth.plant.discrete import held_inputs

LOWEST, GRID = 1e-2, 3000  # rad/s, points: grid of the peak search, which ends at the Nyquist frequency


def continuous_frequency_response(vehicle: Vehicle, controller: Controller, omega: Array) -> Array:
    """Returns the frequency response of the continuous loop from each wheel's road velocity to each output, complex, shape (F, p,
    r).

    Args:
        vehicle: p outputs, r wheels.
        omega: angular frequencies above 0 [rad/s], shape (F,).
    """
    cut = continuous(vehicle, controller)
    model, G = cut.model, cut.G
    s = 1j * np.asarray(omega, dtype=float)[:, None, None]
    felt = readings_of_road(cut, controller)
    if controller.preview is not None:
        felt = felt + _on_inputs(controller.preview.response(omega), cut)
    x = np.linalg.solve(s * np.eye(len(model.A)) - model.A - model.B @ G, model.Bw + model.B @ felt + model.Br / s)
    return (model.C + model.D @ G) @ x + model.Dw + model.D @ felt + model.Cr / s


def _on_inputs(forces: Array, cut: OpenLoop) -> Array:
    """Returns responses of the forces, shape (F, m, r), as those of all inputs, (F, m + k, r)."""
    return np.concatenate([forces, np.zeros((len(forces), len(cut.hold), forces.shape[2]))], axis=1)


def sampled_frequency_response(
    vehicle: Vehicle,
    controller: Controller,
    omega: Array,
    timestep: float,
    exponential: Callable[[Array], Array] = linalg.expm,
    pulls: Elements | None = None,
) -> Array:
    """Returns the same for the sampled loop as it is implemented (held, delayed, lagged), complex, shape (F, p, r).

    Args:
        vehicle: p outputs, r wheels.
        omega: angular frequencies above 0 and below pi / timestep [rad/s], shape (F,).
        timestep: h [s].
        exponential: the matrix exponential; `taylor4` to predict an RK4 integrator.
        pulls: e forces, responses to which follow, per newton, shape (F, p, r + e).
    """
    cut, _, mean_x, inputs = _harmonic(vehicle, controller, omega, timestep, exponential, pulls)
    model, outside = cut.model, _outside(cut, vehicle, controller, pulls, omega, timestep)
    return (model.C @ mean_x + model.D @ inputs + outside.outputs) / outside.per(omega)


def sampled_states(vehicle: Vehicle, controller: Controller, omega: Array, timestep: float) -> Array:
    """Returns the response from each wheel's road velocity to the states of a `LoopModel` at the controller's samples, shape (F,
    s, r).

    Arguments as for `sampled_frequency_response`.
    """
    s = 1j * np.asarray(omega, dtype=float)[:, None, None]
    how = vehicle.implementation
    cut, x, _, _ = _harmonic(vehicle, controller, omega, timestep, linalg.expm)
    period = timestep * steps_per_sample(how, timestep)
    felt, asked = _outside(cut, vehicle, controller, None, omega, timestep).through_readings, cut.asked @ x
    asked = asked if felt is None else asked + felt[..., : cut.forces, :]
    waiting = [np.exp(-s * period * late) * asked for late in range(how.pending_forces, 0, -1)]
    return np.concatenate([x, *waiting], axis=1) / s


def stepwise_frequency_response(
    vehicle: Vehicle, controller: Controller, omega: Array, timestep: float, pulls: Elements | None = None
) -> Array:
    """Returns the response from each wheel's road velocity to the outputs at every timestep of a controller period.

    The values at step i are exact for a road exp(j omega t) with t from the period's start. Between samples a held force adds
    other frequencies, of which `sampled_frequency_response` has only the share at omega.

    Arguments as for `sampled_frequency_response`.

    Returns:
        Shape (steps + 1, F, p, r + e), complex; the last is the first of the next period.
    """
    s = 1j * np.asarray(omega, dtype=float)[:, None, None]
    how, h = vehicle.implementation, timestep
    cut, x, _, _ = _harmonic(vehicle, controller, omega, timestep, linalg.expm, pulls)
    model, steps, outside = cut.model, steps_per_sample(how, h), _outside(cut, vehicle, controller, pulls, omega, h)
    Phi, Gamma, Gamma_r = outside.held(model, linalg.expm)
    by_step, xi, responses, per = (
        _inputs_by_step(cut, how, s, h, x, outside.through_readings),
        x - outside.jump,
        [],
        outside.per(omega),
    )
    for i in range(steps + 1):
        road = np.exp(s * h * i)
        inputs = by_step[i] if i < steps else by_step[0] * road
        responses.append((model.C @ (xi + outside.jump * road) + model.D @ inputs + outside.outputs * road) / per)
        xi = Phi @ xi + Gamma @ inputs + Gamma_r * np.exp(s * h * (i + 0.5))
    return np.stack(responses)


def leaps_by_step(
    vehicle: Vehicle, controller: Controller, omega: Array, timestep: float, pulls: Elements | None = None
) -> Array:
    """Returns the jumps of the outputs at every timestep of a controller period, where the next held force begins.

    Inputs as for `stepwise_frequency_response`. Behind a lag nothing jumps.

    Returns:
        Shape (steps, F, p, r + e), complex.
    """
    s = 1j * np.asarray(omega, dtype=float)[:, None, None]
    how, h = vehicle.implementation, timestep
    cut, x, _, _ = _harmonic(vehicle, controller, omega, timestep, linalg.expm, pulls)
    outside, turn = _outside(cut, vehicle, controller, pulls, omega, h), np.exp(-s * h * steps_per_sample(how, h))
    by_step, per = _inputs_by_step(cut, how, s, h, x, outside.through_readings), outside.per(omega)
    before = [by_step[-1] * turn, *by_step[:-1]]
    return np.stack([cut.model.D @ (now - last) / per for now, last in zip(by_step, before, strict=True)])


@dataclass(frozen=True, eq=False)
class _Outside:
    """Disturbances exp(j omega t), c in number: the roads under r wheels, then suspension forces.

    Attributes:
        jump: direct effect on the states, shape (n, c).
        rates: effect on the rates of the continuous states xi, shape (n, c).
        outputs: direct effect on the output signals, shape (p, c), or (F, p, c) if tyres damp.
        through_readings: effect on all inputs by measured accelerations and preview, shape (m + k, c) or (F, m + k, c); None for
            no effect.
        wheels: r.
        omega: angular frequencies [rad/s], shape (F,).
        timestep: h [s].
    """

    jump: Array
    rates: Array
    outputs: Array
    through_readings: Array | None
    wheels: int
    omega: Array
    timestep: float

    def held(self, model: LinearModel, exponential: Callable[[Array], Array]) -> tuple[Array, Array, Array]:
        """Returns exp(A h) and the effects of inputs and disturbances held over a step: (n, n), (n, m) and (n, c) or (F, n, c).

        A road held at exp(j omega h/2) has the mean velocity exp(j omega h/2) 2j sin(omega h/2) / h over the step.
        """
        h = self.timestep
        if not model.tyres_damp:
            Phi, Gamma, Gamma_r = held_inputs(model.A, h, exponential, model.B, self.rates)
            return Phi, Gamma, Gamma_r
        Phi, Gamma, Gamma_r, Gamma_t = held_inputs(model.A, h, exponential, model.B, self.rates, model.Bt)
        rate = 2j * np.sin(self.omega * h / 2)[:, None, None] / h
        more = np.zeros((len(Gamma_t), self.jump.shape[1] - self.wheels))
        return Phi, Gamma, Gamma_r + rate * np.hstack([Gamma_t, more])

    def per(self, omega: Array) -> Array:
        """Returns the unit of each response: road velocity or newton, shape (F, 1, c), or (F, 1, 1) if there are only roads."""
        s = 1j * np.asarray(omega, dtype=float)[:, None, None]
        forces = self.jump.shape[1] - self.wheels
        return np.concatenate([*([s] * self.wheels), *([np.ones_like(s)] * forces)], axis=-1) if forces else s


def _outside(cut: OpenLoop, vehicle: Vehicle, controller: Controller, pulls: Elements | None, omega: Array, h: float) -> _Outside:
    """Returns the disturbances by the roads under the wheels and by suspension forces."""
    model, omega = cut.model, np.asarray(omega, dtype=float)
    rates, wheels = model.A @ model.jump + model.Br, model.Bw.shape[1]
    outputs, felt = model.Cr, None
    if model.tyres_damp:  # held at the mean velocity of the step; a reading is taken before the next step's acts
        turn = np.exp(1j * omega * h)[:, None, None]
        outputs = outputs + model.Dw * (turn - 1) / h
        felt = readings_of_road(cut, controller) * (1 - 1 / turn) / h if readings_of_road(cut, controller).any() else None
    if (of_heights := heights_read(cut, controller)).any():
        felt = of_heights if felt is None else felt + of_heights
    if controller.preview is not None:
        period = h * steps_per_sample(vehicle.implementation, h)
        ahead = _on_inputs(controller.preview.sampled_response(omega, period), cut)
        felt = ahead if felt is None else felt + ahead
    if pulls is None:
        return _Outside(model.jump, rates, outputs, felt, wheels, omega, h)
    count = pulls.outputs.shape[1]
    push = np.vstack([pulls.push, np.zeros((len(model.A) - len(pulls.push), count))])
    measured = cut.reading @ pulls.outputs[[model.outputs.index(name) for name in controller.measured]]
    through_readings = None
    if np.any(measured) or felt is not None:
        of_road = np.zeros((len(measured), wheels)) if felt is None else felt
        through_readings = _beside(of_road, measured)
    jump = np.hstack([model.jump, np.zeros((len(model.A), count))])
    return _Outside(jump, np.hstack([rates, push]), _beside(outputs, pulls.outputs), through_readings, wheels, omega, h)


def _beside(first: Array, second: Array) -> Array:
    """Returns two matrices side by side, shape (..., k, a + b), of shapes (..., k, a) and (k, b)."""
    return np.concatenate([first, np.broadcast_to(second, (*first.shape[:-1], second.shape[-1]))], axis=-1)


def _inputs_by_step(
    cut: OpenLoop, how: Implementation, s: Array, h: float, x: Array, through_readings: Array | None
) -> list[Array]:
    """Returns all inputs at every timestep of a period that begins with state x, per unit of Z."""
    intervals, steps = steps_held(how, h), steps_per_sample(how, h)
    requested, state_rates = cut.asked @ x, cut.kept @ x
    if through_readings is not None:
        requested = requested + through_readings[..., : cut.forces, :]
        state_rates = state_rates + through_readings[..., cut.forces :, :]
    forces = [np.exp(-s * h * steps * late) * requested for _, late in intervals]
    parts = [cut.inputs(force, state_rates, forces[-1]) for force in forces]
    return [part for (count, _), part in zip(intervals, parts, strict=True) for _ in range(count)]


def _harmonic(
    vehicle: Vehicle,
    controller: Controller,
    omega: Array,
    timestep: float,
    exponential: Callable[[Array], Array],
    pulls: Elements | None = None,
) -> tuple[OpenLoop, Array, Array, Array]:
    """Returns the open loop, and per unit of Z the state at its samples and the components at omega of state and inputs."""
    how, h = vehicle.implementation, timestep
    s = 1j * np.asarray(omega, dtype=float)[:, None, None]
    steps = steps_per_sample(how, h)
    cut = sampled(vehicle, controller, steps * h)
    model, outside = cut.model, _outside(cut, vehicle, controller, pulls, omega, h)
    jump = outside.jump
    Phi, Gamma, Gamma_r = outside.held(model, exponential)

    # From xi at a sample of the controller and Z to xi after i steps, P xi + Q Z, under the inputs F (xi + Bw Z) + E Z.
    intervals = steps_held(how, h)
    turns = [np.exp(-s * h * steps * late) for _, late in intervals]
    forces = [turn * cut.asked for turn in turns]
    of_parts: list[Array] = [cut.inputs(force, last=forces[-1]) for force in forces]
    from_readings: list[Array | float] = [0.0 for _ in intervals]
    if outside.through_readings is not None:
        felt = outside.through_readings
        requested, state_rates = felt[..., : cut.forces, :], felt[..., cut.forces :, :]
        from_readings = [
            cut.inputs(turn * requested, np.broadcast_to(state_rates, (len(s), *state_rates.shape[-2:])), turns[-1] * requested)
            for turn in turns
        ]
    P, Q = np.broadcast_to(np.eye(len(model.A)), (len(s), *model.A.shape)), np.zeros((len(s), *jump.shape))
    # Components at omega of P, Q and the held forces.
    mean_P, mean_Q, mean_held = 0.0, 0.0, [np.zeros_like(s) for _ in intervals]
    for i, part in enumerate(part for part, (count, _) in enumerate(intervals) for _ in range(count)):
        turn, F = np.exp(-s * h * i) / steps, of_parts[part]
        mean_P, mean_Q, mean_held[part] = mean_P + turn * P, mean_Q + turn * Q, mean_held[part] + turn
        pushed = Gamma @ F @ jump if outside.through_readings is None else Gamma @ (F @ jump + from_readings[part])
        P, Q = Phi @ P + Gamma @ F, Phi @ Q + pushed + Gamma_r * np.exp(s * h * (i + 0.5))
    xi = np.linalg.solve(np.exp(s * h * steps) * np.eye(len(model.A)) - P, Q)
    parts = zip(mean_held, of_parts, from_readings, strict=True)
    mean_inputs = sum(mean * (F @ (xi + jump) + reading) for mean, F, reading in parts)
    return cut, xi + jump, mean_P @ xi + mean_Q + jump, np.asarray(mean_inputs)


@dataclass(frozen=True)
class WorstSinusoid:
    """Sinusoidal road of the largest gain from its height, or from w if it has a filter, to the weighted output z, both in L2.

    Attributes:
        gain: ||z|| / ||w||. The H-infinity norm with one wheel, a lower bound on it with more: all wheels follow one road.
        omega: frequency of the sinusoid [rad/s].
    """

    gain: float
    omega: float


def sinusoid_gains(vehicle: Vehicle, response: Array, omega: Array, speed: float) -> Array:
    """Returns the gains from sinusoidal roads under the wheels to z, shape (F,).

    Args:
        response: frequency response at these frequencies, shape (F, p, r).
        omega: angular frequencies, shape (F,).
        speed: forward velocity [m/s].
    """
    wheel_roads = as_met(vehicle, omega, speed)
    z = vehicle.weights(omega) * vehicle.summed(
        np.einsum("fpr,fr->fp", response, vehicle.road_shape(omega)[:, None] * wheel_roads)
    )
    return np.linalg.norm(z, axis=1) / np.linalg.norm(wheel_roads, axis=1)


def worst_sinusoid(vehicle: Vehicle, response: Callable[[Array], Array], highest: float, speed: float) -> WorstSinusoid:
    """Returns the largest gain from the road under the wheels to z, and its frequency.

    By Parseval it is the largest L2 gain of any road below `highest`: the H-infinity norm if there is one wheel.

    Args:
        response: angular frequencies (F,) -> frequency response (F, p, r).
        highest: end of the search [rad/s], the Nyquist frequency pi / h.
        speed: forward velocity [m/s].
    """

    def gain(omega: Array) -> Array:
        return sinusoid_gains(vehicle, response(omega), omega, speed)

    # Lightly damped poles make narrow peaks; those of a vehicle are wider than the grid's 0.4 %, and each is refined.
    omega = np.geomspace(LOWEST, 0.99 * highest, GRID)
    gains = gain(omega)
    best = WorstSinusoid(float(gains.max()), float(omega[gains.argmax()]))
    peaks = 1 + np.flatnonzero((gains[1:-1] >= gains[:-2]) & (gains[1:-1] >= gains[2:]) & (gains[1:-1] > 0.9 * best.gain))
    from scipy import optimize  # half a second

    for i in peaks:
        refined: Any = optimize.minimize_scalar(
            lambda log_omega: -gain(np.exp([log_omega]))[0],
            bounds=np.log(omega[[i - 1, i + 1]]),
            method="bounded",
            options={"xatol": 1e-10},
        )
        if -refined.fun > best.gain:
            best = WorstSinusoid(float(-refined.fun), float(np.exp(refined.x)))
    return best
