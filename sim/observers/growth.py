"""Growth: the state of each run after a time of its own, by which a mode grows or decays."""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from sim.drive.case import Batch
from sim.drive.loop import Block


class Growth:
    """Takes the state of each run at one sample."""

    def __init__(self, samples: Sequence[int], batch: Batch) -> None:
        """Prepares the runs of a batch; `samples` are the samples of all cases."""
        self._samples = [samples[i] for i in batch.numbers]
        self._states: list[Array] = [np.zeros(0)] * len(self._samples)

    def take(self, block: Block) -> None:
        """Takes the next block."""
        for i, sample in enumerate(self._samples):
            if 0 <= (k := sample - block.start) < len(block.qpos):
                self._states[i] = np.concatenate([block.qpos[k, i], block.qvel[k, i]])

    def result(self) -> list[Array]:
        """Returns the positions and velocities of every run, shape (nq + nv,)."""
        return self._states
