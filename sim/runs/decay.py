"""Free decay: frequencies and damping ratios of a vehicle that is released on a flat road.

The motion of a linear loop from sample to sample is that of its modes. Signals of the states, and those of some samples later,
therefore follow from their values before by a matrix, which least squares give. Its eigenvalues are those of the modes. Singular
values that rounding leaves are taken off, so that motionless modes do not matter. With curves or large angles the results are
those of the linear loop that fits the whole decay best.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.document.field import Field, plain
from sim.drive.response import Response
from sim.linear.rounding import effect_on_states
from sim.runs.result import RunResult

PER_PERIOD = 8  # samples in a period of the fastest mode of the vehicle
LATER = 3  # samples side by side, so that states that are no signals count, too
SMALLEST = 1e-6  # singular value that counts, over the largest
SHARE = 0.01  # of the decay's energy; a mode with less is not told
FEWEST = 40  # samples of a decay

FREQUENCY = Field[float]("frequency", float, ".4g", unit="Hz")
DAMPING = Field[float]("damping ratio", float, ".3f")
TIME = Field[float]("time constant", float, ".3g", unit="s")


@dataclass(frozen=True)
class Mode:
    """Mode of a free decay.

    Attributes:
        frequency: undamped natural frequency |s| / (2 pi) [Hz].
        damping_ratio: -Re s / |s|; 1 for a mode that does not oscillate.
        share: share of the energy of the signals that it has, each over its peak.
    """

    frequency: float
    damping_ratio: float
    share: float

    @property
    def words(self) -> str:
        """Frequency and damping ratio in words, or the time constant of a mode that does not oscillate."""
        if abs(self.damping_ratio) >= 1:
            growing = " growth" if self.damping_ratio < 0 else ""
            return f"aperiodic{growing}, time constant {TIME.text(1 / (2 * math.pi * self.frequency))}"
        return f"{FREQUENCY.text(self.frequency)}, damping ratio {DAMPING.text(self.damping_ratio)}"


def is_free(run: RunResult) -> bool:
    """Returns True for a run from a given start over a flat road, without loads."""
    on = run.prediction.input
    return bool(run.vehicle.start) and not on.heights.any() and not on.loaded


def modes_of(run: RunResult, response: Response) -> tuple[Mode, ...]:
    """Returns the modes of a free decay in a response of a run, slow ones first, after the last tyre has landed."""
    landed = max((end for _, end in run.agreement.lift_off), default=-1.0)
    ends = run.broke_off[1] if run.broke_off is not None else math.inf
    whole = response.until(ends)
    whole, h = whole.samples(whole.time > landed), run.prediction.timestep
    rate, _ = effect_on_states(run.vehicle)
    every = max(1, int(2 * np.pi / (PER_PERIOD * rate * h))) if rate else 1
    kept = [signal.name for signal in whole.signals[len(run.vehicle.kind.signals) :]]
    signals = np.stack([whole[name][::every] for name in (*run.vehicle.linear_model.states, *kept)])
    if signals.shape[1] < FEWEST:
        return ()
    size = np.abs(signals).max(axis=1, keepdims=True)
    signals = np.divide(signals, size, out=np.zeros_like(signals), where=size > 0)
    count = signals.shape[1] - LATER
    blocks = np.concatenate([signals[:, i : i + count] for i in range(LATER)])
    U, sizes, V = np.linalg.svd(blocks, full_matrices=False)
    rank = int((sizes > SMALLEST * sizes[0]).sum())
    states = sizes[:rank, None] * V[:rank]  # of the blocks, by the first singular vectors
    step = np.linalg.lstsq(states[:, :-1].T, states[:, 1:].T)[0].T
    values, vectors = np.linalg.eig(step)
    along = np.linalg.lstsq(vectors, states.astype(complex))[0]
    shapes = U[: len(signals), :rank] @ vectors
    energy = np.sum(np.abs(shapes) ** 2, axis=0) * np.sum(np.abs(along) ** 2, axis=1)
    with np.errstate(divide="ignore"):
        s = np.log(values.astype(complex)) / (every * h)
    found = []
    for i, one in enumerate(s):
        pair = 2.0 if one.imag > 0 else 1.0
        share = float(pair * energy[i] / energy.sum())
        if one.imag >= 0 and share > SHARE and abs(one) > 0:
            found.append(Mode(float(abs(one) / (2 * np.pi)), float(-one.real / abs(one)), share))
    return tuple(sorted(found, key=lambda one: one.frequency))


def decay_words(run: RunResult) -> str:
    """Returns a sentence on the modes of a free decay in MuJoCo; empty without one."""
    if not is_free(run) or not (modes := modes_of(run, run.physics)):
        return ""
    return f"free decay: {'; '.join(one.words for one in modes)}"


def record(run: RunResult) -> dict[str, Any]:
    """Returns the modes of a free decay as a JSON object: in MuJoCo, and by linear analysis if that applies."""
    if not is_free(run):
        return {}
    linear = modes_of(run, run.sampled) if run.prediction.is_linear and not run.agreement.lift_off else ()
    return {"decay": plain({"mujoco": modes_of(run, run.physics), "linear": linear})}
