"""Records the state of each run at one chosen sample. The recorded state shows whether a mode has grown or decayed until the
chosen sample.
"""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from sim.drive.case import Batch
from sim.drive.loop import Block


class Growth:
    """Records the state of each run at one sample."""

    def __init__(self, samples: Sequence[int], batch: Batch) -> None:
        """Prepares the recording for the runs of a batch. The argument `samples` contains the index of the sample to record for
        each case.
        """
        self._samples = [samples[i] for i in batch.numbers]
        self._states: list[Array] = [np.zeros(0)] * len(self._samples)

    def take(self, block: Block) -> None:
        """Receives the next block of samples."""
        for i, sample in enumerate(self._samples):
            if 0 <= (k := sample - block.start) < len(block.qpos):
                self._states[i] = np.concatenate([block.qpos[k, i], block.qvel[k, i]])

    def result(self) -> list[Array]:
        """Returns the recorded positions and velocities of each run, shape (nq + nv,)."""
        return self._states
