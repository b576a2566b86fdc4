"""Frequency responses from the road's velocity, exact in two ways: of the sampled loop that MuJoCo runs, and the continuous one.

A road z_r(t) = Z exp(j omega t) under the wheels has the velocity W = j omega Z. All that follows is per unit of W. In continuous
time both act on the loop of `synth/controller/loop_of.py`.

Sampled, the road is Z exp(j omega t_k) at the samples. Over a step it is held at its midpoint, exp(j omega h/2) times as much,
and at its mean velocity where tyres damp. The force is held. A sampled sinusoid stays one, without any approximation. Where the
controller's own sample period is several steps, it does not: then the response is its share at omega itself, over all the steps
of a period.

A preview adds to the requested forces the sum of its weights times exp(j omega i T), over the coming samples of every T seconds,
and continuous the integral of F(s) exp(j omega s).

A force in a suspension that is F exp(j omega t), held over a step at its midpoint as the road is, moves no state at once.
Responses to such forces follow those to the wheels' roads, per newton.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.roads.spectrum import as_met
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller
from synth.controller.loop_of import HEIGHT, HELD, MIDWAY, READ, SIGNAL, loop_of, road_inputs, with_ending
from synth.plant.loop import Loop, frequency_response, stepwise_response

LOWEST, GRID = 1e-2, 3000  # rad/s, points: grid of the peak search, which ends at the Nyquist frequency
PULL = "pull_"  # begins the name of a suspension force among the inputs


def continuous_frequency_response(vehicle: Vehicle, controller: Controller, omega: Array) -> Array:
    """Returns the frequency response of the continuous loop from each wheel's road velocity to each output, complex, shape (F, p,
    r).

    Args:
        vehicle: p outputs, r wheels.
        omega: angular frequencies above 0 [rad/s], shape (F,).
    """
    loop, model, omega = loop_of(vehicle, controller), vehicle.linear_model, np.asarray(omega, dtype=float)
    return frequency_response(loop, model.outputs, road_inputs(model, controller, omega), omega)


def sampled_frequency_response(
    vehicle: Vehicle,
    controller: Controller,
    omega: Array,
    timestep: float,
    exponential: Callable[[Array], Array] = linalg.expm,
    pulls: Sequence[str] = (),
) -> Array:
    """Returns the same for the sampled loop as it is implemented (held, delayed, lagged), complex, shape (F, p, r).

    Args:
        vehicle: p outputs, r wheels.
        omega: angular frequencies above 0 and below pi / timestep [rad/s], shape (F,).
        timestep: h [s].
        exponential: the matrix exponential; `taylor4` to predict an RK4 integrator.
        pulls: e deflections along which forces pull, responses to which follow, per newton, shape (F, p, r + e).
    """
    loop, drive = driven_loop(vehicle, controller, omega, timestep, exponential, pulls)
    return frequency_response(loop, vehicle.linear_model.outputs, drive, np.asarray(omega, dtype=float))


def stepwise_frequency_response(
    vehicle: Vehicle, controller: Controller, omega: Array, timestep: float, pulls: Sequence[str] = ()
) -> tuple[Array, Array]:
    """Returns the response from each wheel's road velocity to the outputs at every timestep of a controller period, and jumps.

    The values at step i are exact for a road exp(j omega t) with t from the period's start. Between samples a held force adds
    other frequencies, of which `sampled_frequency_response` has only the share at omega.

    Arguments as for `sampled_frequency_response`.

    Returns:
        The values, shape (steps + 1, F, p, r + e), complex; the last is the first of the next period. Then the jumps of the
        outputs where the next held force begins, shape (steps, F, p, r + e). Behind a lag nothing jumps.
    """
    loop, drive = driven_loop(vehicle, controller, omega, timestep, linalg.expm, pulls)
    return stepwise_response(loop, vehicle.linear_model.outputs, drive, np.asarray(omega, dtype=float))


def driven_loop(
    vehicle: Vehicle,
    controller: Controller,
    omega: Array,
    timestep: float,
    exponential: Callable[[Array], Array] = linalg.expm,
    pulls: Sequence[str] = (),
) -> tuple[Loop, dict[str, Array]]:
    """Returns the sampled loop, and its inputs under roads of velocity exp(j omega t) and under pulls, by name, (F, r + e) each.

    Arguments as for `sampled_frequency_response`.
    """
    loop, model, h = loop_of(vehicle, controller, timestep, exponential), vehicle.linear_model, timestep
    s, roads, count = 1j * np.asarray(omega, dtype=float)[:, None], model.disturbances, len(pulls)
    if pulls:
        of_rates, of_outputs = vehicle.force_effects(pulls)
        forces, plant, n = tuple(f"{PULL}{i}" for i in range(count)), loop.plant, len(of_rates)
        push, shown = np.zeros((len(plant.A), count)), np.zeros((len(plant.outputs), count))
        rows = [model.outputs.index(name) for name in controller.measured]
        push[:n], shown[: len(model.outputs)], shown[plant.rows(loop.measured)] = of_rates, of_outputs, of_outputs[rows]
        plant = plant.with_inputs(with_ending(forces, MIDWAY), push, np.zeros_like(shown))
        loop = replace(loop, plant=plant.with_inputs(forces, np.zeros_like(push), shown))
    turn, each = np.exp(s * h), np.eye(len(roads) + count)
    amplitudes = {MIDWAY: np.exp(s * h / 2) / s, HEIGHT: 1 / s}
    if model.tyres_damp:  # held at the mean velocity of the step; a reading is taken before the next step's acts
        mean = (turn - 1) / (h * s)
        amplitudes |= {HELD: mean, SIGNAL: mean, READ: mean / turn}
    drive = {f"{name}{ending}": size * each[i] for i, name in enumerate(roads) for ending, size in amplitudes.items()}
    for i in range(count):
        drive |= {f"{PULL}{i}": np.ones_like(s) * each[len(roads) + i]}
        drive |= {f"{PULL}{i}{MIDWAY}": np.exp(s * h / 2) * each[len(roads) + i]}
    if controller.preview is not None:
        ahead = controller.preview.sampled_response(np.asarray(omega, dtype=float), loop.period) / s[..., None]
        ahead = np.concatenate([ahead, np.zeros((*ahead.shape[:2], count))], axis=2)
        drive |= dict(zip(loop.forces, np.moveaxis(ahead, 1, 0), strict=True))
    return loop, drive


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
