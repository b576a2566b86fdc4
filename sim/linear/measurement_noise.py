"""Effect of measurement noise and quantisation on the signals of the sampled loop, in a run from rest.

The loop is time-invariant from sample to sample, and between samples its state follows from the sampled state and the held
inputs. A disturbance of the measurements at one sample therefore has a response h that depends only on the time since. White
noise of standard deviation sigma gives an output the variance sum |h|^2 sigma^2. Rounding to a resolution q is not white, but
never more than q / 2: it moves an output by at most sum |h| q / 2. Sums are over the samples so far: they converge in a stable
loop and grow in an unstable one.
"""

import math

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.analysis.stability import sampled_growth
from synth.controller.open_loop import LoopModel, SampledClosedLoop
from synth.plant.discrete import held_inputs

DECAYED = 1e-12  # of a response to one sample's disturbance: the rest is neglected
BEYOND = 1e100  # of such a response: above it squares would overflow, and the sums are set to infinity


def noise_rms(loop: LoopModel, samples: int) -> Array:
    """Returns the standard deviation of every output signal under the measurement noise, at every timestep, shape (T, p)."""
    noise = loop.vehicle.implementation.noise
    rms = np.array([noise.get(name, 0.0) for name in loop.controller.measured])
    return np.sqrt(summed(loop, loop.open_loop.reading * rms, 2, samples))


def most_quantised(loop: LoopModel, samples: int) -> Array:
    """Returns a bound on every output signal's error by quantised measurements. Arguments and shape as for `noise_rms`."""
    resolution = loop.vehicle.implementation.quantisation
    half = np.array([resolution.get(name, 0.0) / 2 for name in loop.controller.measured])
    return summed(loop, loop.open_loop.reading * half, 1, samples)


@np.errstate(over="ignore", invalid="ignore")  # an unstable loop overflows
def summed(model: LoopModel, read: Array, power: int, samples: int) -> Array:
    """Returns sums of |response|^power to disturbances at every sample, by timestep, shape (T, p).

    Args:
        read: gain from each disturbance of a sample, by its size, to the inputs computed there, shape (m + k, j).
    """
    loop, steps, p = model.closed_loop, model.steps, len(model.open_loop.model.outputs)
    sums = np.zeros((-(-samples // steps), steps, p))
    if not read.any():
        return sums.reshape(-1, p)[:samples]
    rows, direct = between(loop, read, model.timestep)
    response, total, at_once = loop.added @ read, np.zeros(steps * p), _sum(direct, power)
    lasts = _lasts(loop.transition)
    for k in range(len(sums)):
        sums[k] = (total + at_once).reshape(steps, p)
        if k >= lasts:
            sums[k:] = sums[k]
            break
        if not np.all(np.abs(response) < BEYOND):
            sums[k:] = np.inf
            break
        total = total + _sum(rows @ response, power)
        response = loop.transition @ response
    return sums.reshape(-1, p)[:samples]


def between(loop: SampledClosedLoop, read: Array, timestep: float) -> tuple[Array, Array]:
    """Maps the loop's state, and the readings, to the outputs at every timestep up to the next sample, shape (steps p, ...)."""
    model = loop.open_loop.model
    Phi, Gamma = held_inputs(model.A, timestep, linalg.expm, model.B)
    of_state, from_readings = np.eye(len(model.A), len(loop.transition)), np.zeros((len(model.A), read.shape[1]))
    rows, direct = [], []
    for part in loop.by_step:
        inputs = part.feedthrough @ read
        rows.append(model.C @ of_state + model.D @ part.inputs)
        direct.append(model.C @ from_readings + model.D @ inputs)
        of_state, from_readings = Phi @ of_state + Gamma @ part.inputs, Phi @ from_readings + Gamma @ inputs
    return np.concatenate(rows), np.concatenate(direct)


def _lasts(transition: Array) -> float:
    """Returns the number of samples after which a response has decayed; infinite if the loop does not decay."""
    growth = sampled_growth(transition)
    if growth >= 1:
        return math.inf
    return len(transition) + (math.log(DECAYED) / math.log(growth) if growth else 0)


def _sum(responses: Array, power: int) -> Array:
    """Returns the sum of |response|^power over disturbances, shape (c,) from (c, q)."""
    return np.sum(np.abs(responses) ** power, axis=1)
