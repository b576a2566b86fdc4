"""Exact frequency responses to the road velocity, of the sampled loop that MuJoCo simulates and of the continuous loop.

A road z_r(t) = Z exp(j omega t) under the wheels has the velocity W = j omega Z. All frequency responses are relative to the
road velocity W. In continuous time, the road height Z and the road velocity W are inputs of the loop that
`synth/controller/loop_of.py` defines.

In the sampled loop, the road height at sample time t_k is Z exp(j omega t_k). During each step of length h, the road stays at
its mid-step height, which is exp(j omega h/2) times the height at the sample. If tyres have damping, the road velocity is also
constant during each step, at its mean over the step. The control force is also constant during each step. At the samples, the
response to a sinusoid is then exactly a sinusoid. If the sample period of the controller is several steps, the response also
contains frequencies other than omega. The computed frequency response contains only the component at omega, which is computed
from all steps of a sample period.

Preview adds to the requested forces a sum over the coming samples i, at intervals T: the preview weights times exp(j omega i
T). In continuous time, preview adds the integral of F(s) exp(j omega s) over the preview time s, where F(s) are the preview
weights.

A suspension force F exp(j omega t) may act in addition to the road. Like the road, the suspension force is constant during each
step, at its mid-step value. A jump of the suspension force causes no jump of a state. The responses to the suspension force,
per newton, are appended to the responses to the road.
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
from synth.plant.harmonic_response import frequency_response, stepwise_response
from synth.plant.loop import Loop

# lowest frequency [rad/s] and number of points of the grid that is searched for the peak, up to the Nyquist frequency
LOWEST, GRID = 1e-2, 3000
PULL = "pull_"  # prefix for the names of inputs that are suspension forces


def continuous_frequency_response(vehicle: Vehicle, controller: Controller, omega: Array) -> Array:
    """Returns the frequency response of the continuous loop from each wheel's road velocity to each output.

    The result is a complex array of shape (F, p, r).


    Args:
        vehicle: vehicle with p outputs and r wheels.
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
    """Returns the frequency response of the sampled loop with hold, delay and lag, complex, shape (F, p, r).

    Args:
        vehicle: vehicle with p outputs and r wheels.
        omega: angular frequencies above 0 and below pi / timestep [rad/s], shape (F,).
        timestep: time step h [s].
        exponential: function that computes the matrix exponential; with `taylor4`, the result is that of RK4.
        pulls: names of the e suspension deflections along which additional forces act. The responses to the additional forces,
            per newton, are appended to the responses to the road; the shape is then (F, p, r + e).
    """
    loop, drive = driven_loop(vehicle, controller, omega, timestep, exponential, pulls)
    return frequency_response(loop, vehicle.linear_model.outputs, drive, np.asarray(omega, dtype=float))


def stepwise_frequency_response(
    vehicle: Vehicle, controller: Controller, omega: Array, timestep: float, pulls: Sequence[str] = ()
) -> tuple[Array, Array]:
    """Returns the response from the road velocities to the outputs at every time step of a controller's sample period.

    The responses at step i are exact for a road exp(j omega t), where the time t begins at the start of the sample period.
    Between samples, a constant force causes components at frequencies other than omega. `sampled_frequency_response` contains
    only the component at omega.

    The arguments are those of `sampled_frequency_response`.

    Returns:
        Complex responses at every time step, shape (steps + 1, F, p, r + e). The last entry is the response at the start of the
        next sample period. The second array contains the jumps of the outputs at the instants when the force changes, shape
        (steps, F, p, r + e). Outputs on which the force acts only through a lag do not jump.
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
    """Returns the sampled loop, and the loop's inputs for road velocities exp(j omega t) and for suspension forces.

    The inputs are a mapping from names to arrays of shape (F, r + e).

    The arguments are those of `sampled_frequency_response`.
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
    # The road's mean velocity is held during each step. A measurement is taken before the mean velocity of the next step acts.
    if model.tyres_damp:
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
    """The sinusoidal road with the largest L2 gain from the road to the weighted output z.

    The gain is relative to the road velocity or, if the road has a filter, to the filter's input w.

    Attributes:
        gain: ||z|| / ||w||. For a vehicle with one wheel, the largest gain is the H-infinity norm. For a vehicle with several
            wheels, the gain is a lower bound on the norm, because all wheels follow the same road.
        omega: angular frequency of the sinusoid [rad/s].
    """

    gain: float
    omega: float


def sinusoid_gains(vehicle: Vehicle, response: Array, omega: Array, speed: float) -> Array:
    """Returns the gain from a sinusoidal road under the wheels to the performance output z at each frequency, shape (F,).

    Args:
        response: frequency response of p outputs to the road under r wheels at the frequencies `omega`, complex, shape (F, p,
            r).
        omega: angular frequencies [rad/s], shape (F,).
        speed: forward speed [m/s].
    """
    wheel_roads = as_met(vehicle, omega, speed)
    z = vehicle.weights(omega) * vehicle.summed(
        np.einsum("fpr,fr->fp", response, vehicle.road_shape(omega)[:, None] * wheel_roads)
    )
    return np.linalg.norm(z, axis=1) / np.linalg.norm(wheel_roads, axis=1)


def worst_sinusoid(vehicle: Vehicle, response: Callable[[Array], Array], highest: float, speed: float) -> WorstSinusoid:
    """Returns the largest gain from the road under the wheels to the performance output z, and the frequency of this gain.

    By Parseval's theorem, the returned gain is the largest L2 gain for all roads whose frequencies are below `highest`. For a
    vehicle with one wheel, the returned gain is the H-infinity norm.

    Args:
        response: function that returns the frequency response, shape (F, p, r), at angular frequencies [rad/s], shape (F,).
        highest: highest frequency of the search [rad/s]: the Nyquist frequency pi / h, where h is the time step.
        speed: forward speed [m/s].
    """

    def gain(omega: Array) -> Array:
        return sinusoid_gains(vehicle, response(omega), omega, speed)

    # Poles with little damping cause narrow peaks. The peaks of a vehicle are wider than the spacing of the grid, 0.4 %, and
    # the search refines each peak.
    omega = np.geomspace(LOWEST, 0.99 * highest, GRID)
    gains = gain(omega)
    best = WorstSinusoid(float(gains.max()), float(omega[gains.argmax()]))
    peaks = 1 + np.flatnonzero((gains[1:-1] >= gains[:-2]) & (gains[1:-1] >= gains[2:]) & (gains[1:-1] > 0.9 * best.gain))
    from scipy import optimize  # imported here because the import takes half a second

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
