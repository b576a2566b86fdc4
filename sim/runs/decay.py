"""Free decay: frequencies and damping ratios of a vehicle that is released on a flat road.

In a linear loop, the modes determine the motion from sample to sample. A constant matrix therefore maps the state signals at a
few successive samples to the same signals one sample later. This constant matrix is found by least squares. The eigenvalues of
the matrix give the frequencies and damping ratios of the modes. Singular values at the level of rounding errors are removed, so
that modes without motion have no effect. With characteristics or large angles, the result is the linear loop that fits the
whole decay best.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.document.field import Field, plain
from sim.drive.response import Response
from sim.linear.rounding import effect_on_states
from sim.runs.result import RunResult

PER_PERIOD = 8  # number of samples per period of the vehicle's fastest mode; the decay is analysed at these samples
LATER = 3  # number of successive samples in one block; a block also contains the effect of states that are not signals
SMALLEST = 1e-6  # singular values below this multiple of the largest singular value are removed
SHARE = 0.01  # a mode with a smaller fraction of the decay's energy is not reported
FEWEST = 40  # smallest number of samples from which a decay is analysed

FREQUENCY = Field[float]("frequency", float, ".4g", unit="Hz")
DAMPING = Field[float]("damping ratio", float, ".3f")
TIME = Field[float]("time constant", float, ".3g", unit="s")


@dataclass(frozen=True)
class Mode:
    """Mode of oscillation or decay that a free decay contains.

    Attributes:
        frequency: undamped natural frequency |s| / (2 pi) [Hz].
        damping_ratio: -Re s / |s|; 1 for a mode that does not oscillate.
        share: fraction of the signals' energy that is due to this mode, where each signal is divided by its peak.
    """

    frequency: float
    damping_ratio: float
    share: float

    @property
    def words(self) -> str:
        """Frequency and damping ratio of the mode as text; for a mode that does not oscillate, the time constant."""
        if abs(self.damping_ratio) >= 1:
            growing = " growth" if self.damping_ratio < 0 else ""
            return f"aperiodic{growing}, time constant {TIME.text(1 / (2 * math.pi * self.frequency))}"
        return f"{FREQUENCY.text(self.frequency)}, damping ratio {DAMPING.text(self.damping_ratio)}"


def is_free(run: RunResult) -> bool:
    """Returns True if a run begins from specified deflections and velocities, on a flat road and without loads."""
    on = run.prediction.input
    return bool(run.vehicle.start) and not on.heights.any() and not on.loaded


def modes_of(run: RunResult, response: Response) -> tuple[Mode, ...]:
    """Returns the modes of a free decay in a response of a run after the last landing of a tyre, slow modes first."""
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
    states = sizes[:rank, None] * V[:rank]  # state of each block, as its coordinates along the first singular vectors
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
    """Returns a sentence about the modes of a free decay in MuJoCo; empty if the run is not a free decay."""
    if not is_free(run) or not (modes := modes_of(run, run.physics)):
        return ""
    return f"free decay: {'; '.join(one.words for one in modes)}"


def record(run: RunResult) -> dict[str, Any]:
    """Returns the modes of a free decay as a JSON object: from MuJoCo and, if linear analysis applies, from linear analysis."""
    if not is_free(run):
        return {}
    linear = modes_of(run, run.sampled) if run.prediction.is_linear and not run.agreement.lift_off else ()
    return {"decay": plain({"mujoco": modes_of(run, run.physics), "linear": linear})}
