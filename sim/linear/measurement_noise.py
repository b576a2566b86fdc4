"""How far noise and quantisation of the measurements move the signals of the sampled loop, in a run from rest.

From one sample to the next the loop is time-invariant, and between them its state follows from that at the sample and what is
held. So what a disturbance of the measurements at one sample does to an output is a response h of the time since. White noise
adds in squares: at any moment an output has the variance sum |h|^2 sigma^2. What rounding to a resolution q makes is not white,
but never more than q / 2: it moves an output by at most sum |h| q / 2, whatever it is. Sums are over the samples so far: of a
stable loop they come to an end, of an unstable one they grow with it.
"""

import math

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.analysis.stability import sampled_growth
from synth.controller.open_loop import ImplementedLoop, LoopModel
from synth.plant.discrete import held_inputs

DECAYED = 1e-12  # of a response to one sample's disturbance: nothing comes after it
BEYOND = 1e100  # of such a response: its squares overflow soon, and there is no vehicle any more


def noise_rms(loop: LoopModel, samples: int) -> Array:
    """Standard deviation of every output signal under the noise of the measurements, at every timestep, shape (T, p).

    Args:
        loop: of the vehicle and its controller.
        samples: T.
    """
    noise = loop.vehicle.implementation.noise
    rms = np.array([noise.get(name, 0.0) for name in loop.controller.measured])
    return np.sqrt(_summed(loop, rms, 2, samples))


def most_quantised(loop: LoopModel, samples: int) -> Array:
    """How far quantisation of the measurements moves every output signal at most. Arguments and shape as for `noise_rms`."""
    resolution = loop.vehicle.implementation.quantisation
    half = np.array([resolution.get(name, 0.0) / 2 for name in loop.controller.measured])
    return _summed(loop, half, 1, samples)


@np.errstate(over="ignore", invalid="ignore")  # an unstable loop overflows
def _summed(model: LoopModel, size: Array, power: int, samples: int) -> Array:
    """Sums of |response|^power to disturbances of the measurements of these sizes, by timestep, shape (T, p)."""
    loop, steps, p = model.closed_loop, model.steps, len(model.open_loop.model.outputs)
    found = np.zeros((-(-samples // steps), steps, p))
    if not size.any():
        return found.reshape(-1, p)[:samples]
    read = loop.cut.reading * size
    rows, direct = _between(loop, read, model.timestep)
    response, total, at_once = loop.added @ read, np.zeros(steps * p), _sum(direct, power)
    lasts = _lasts(loop.transition)
    for k in range(len(found)):
        found[k] = (total + at_once).reshape(steps, p)
        if k >= lasts:
            found[k:] = found[k]
            break
        if not np.all(np.abs(response) < BEYOND):
            found[k:] = np.inf
            break
        total = total + _sum(rows @ response, power)
        response = loop.transition @ response
    return found.reshape(-1, p)[:samples]


def _between(loop: ImplementedLoop, read: Array, timestep: float) -> tuple[Array, Array]:
    """The outputs at every timestep up to the next sample, shape (steps p, ...), from the loop's state, and from what is read."""
    model = loop.cut.model
    Phi, Gamma = held_inputs(model.A, timestep, linalg.expm, model.B)
    of_state, of_held = np.eye(len(model.A), len(loop.transition)), np.zeros((len(model.A), read.shape[1]))
    rows, direct = [], []
    for part in loop.by_step:
        held = part.at_once @ read
        rows.append(model.C @ of_state + model.D @ part.inputs)
        direct.append(model.C @ of_held + model.D @ held)
        of_state, of_held = Phi @ of_state + Gamma @ part.inputs, Phi @ of_held + Gamma @ held
    return np.concatenate(rows), np.concatenate(direct)


def _lasts(transition: Array) -> float:
    """For how many samples a response goes on; infinite of a loop that does not decay."""
    growth = sampled_growth(transition)
    if growth >= 1:
        return math.inf
    return len(transition) + (math.log(DECAYED) / math.log(growth) if growth else 0)


def _sum(responses: Array, power: int) -> Array:
    """Over disturbances: the sum of |response|^power, shape (c,) from (c, q)."""
    return np.sum(np.abs(responses) ** power, axis=1)
