"""Effect of the rounding of exported code on the signals of the sampled loop, predicted from its response without rounding.

The errors of each sample (`synth.controller.export.rounding`) go through the loop as disturbances of readings, forces and states.
What coefficients do is the response to a known disturbance. Rounding is noise of the mean square over the run; its worst case
is that every error has its bound over the run, and the sign that adds up.

A limit that clips, or another loop than the linear one, is not in it.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from sim.linear.measurement_noise import between, summed
from sim.response.response import Response
from synth.controller.export.c_law import ExportedLaw
from synth.controller.export.rounding import entering, local_errors
from synth.controller.open_loop import LoopModel


@dataclass(frozen=True, eq=False)
class RoundingEffect:
    """Difference of a run with exported code from one with exact arithmetic, by output signal.

    Attributes:
        rms: predicted, over the run.
        most: bound at every sample, shape (T,).
        beyond: readings that leave their range in fixed point, where they are clipped; neither number holds then.
    """

    rms: Mapping[str, float]
    most: Mapping[str, Array]
    beyond: tuple[str, ...] = ()


@np.errstate(over="ignore", invalid="ignore")  # an unstable loop overflows
def rounding_effect(loop: LoopModel, law: ExportedLaw, sampled: Response) -> RoundingEffect:
    """Returns the predicted effect of rounding on a run.

    Args:
        loop: at the timestep of the run.
        law: the exported law of its controller.
        sampled: response of the loop, with all measurements of the law.
    """
    steps, names, samples = loop.steps, loop.vehicle.linear_model.outputs, len(sampled.time)
    y = np.stack([sampled[name][::steps] for name in loop.controller.measured], axis=1)
    errors, q, closed = local_errors(law, y), law.readings, loop.closed_loop
    into = entering(loop, law)
    noise = summed(loop, into * np.sqrt(errors.square.mean(axis=0)), 2, samples)
    most = summed(loop, into * errors.most.max(axis=0), 1, samples)

    rows, direct = between(closed, into[:, q:], loop.timestep)
    state, known = np.zeros(len(closed.transition)), np.zeros((len(y), len(rows)))
    added = closed.added @ into[:, q:]
    for i, now in enumerate(errors.known):
        known[i] = rows @ state + direct @ now
        state = closed.transition @ state + added @ now
    square = known.reshape(-1, len(names))[:samples] ** 2 + noise
    rms = np.sqrt(square.mean(axis=0)).tolist()
    far = np.zeros(q, dtype=bool) if law.ranges is None else np.abs(y).max(axis=0) > law.ranges
    beyond = tuple(name for name, out in zip(loop.controller.measured, far, strict=True) if out)
    return RoundingEffect(dict(zip(names, rms, strict=True)), dict(zip(names, most.T, strict=True)), beyond)
