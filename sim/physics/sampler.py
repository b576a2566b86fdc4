"""The controller as it would be built: its own states and sample period, a computation delay, noisy, quantised measurements."""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.reality import Implementation, steps_per_sample


class Sampler:
    """N controllers that each sample, compute and hold as an `[implementation]` says.

    A measurement is read as quantisation * round((signal + noise) / quantisation), and the force computed from it acts `delay`
    samples later. Before the first one arrives the force is zero. Its own states are never late.
    """

    def __init__(
        self, how: Sequence[Implementation], gain: Array, memory: Array, names: Sequence[str], timestep: float, samples: int
    ) -> None:
        """For laws [u; x_c] from the signals of these names, shape (N, m + k, S), and from x_c, shape (N, m + k, k)."""
        self.gain, self.memory = gain, memory if memory.shape[2] else None
        self.forces = gain.shape[1] - memory.shape[2]
        self.kept = np.zeros((len(how), memory.shape[2]))
        self.period = np.array([steps_per_sample(one, timestep) for one in how])
        self.delay = np.array([one.delay for one in how])
        self.resolution = np.array([[one.quantisation.get(name, 0.0) for name in names] for one in how])
        rms = np.array([[one.noise.get(name, 0.0) for name in names] for one in how])
        self.noise = np.zeros((samples if np.any(rms) else 0, *rms.shape))
        for i, one in enumerate(how):
            if np.any(rms[i]):
                self.noise[:, i] = rms[i] * np.random.default_rng(one.seed).standard_normal((samples, len(names)))
        self.coarse = bool(np.any(self.resolution))
        self.queue = np.zeros((int(self.delay.max()) + 1, len(how), self.forces))  # forces by sample, in a ring
        self.force = np.zeros((len(how), self.forces))
        self.all = np.arange(len(how))
        self.together = bool(np.all(self.period == 1))

    def __call__(self, k: int, signals: Array) -> Array:
        """The forces of step k, shape (N, m), from the signals at its start, shape (N, S)."""
        # This runs between any two steps of the physics, where a call of numpy costs as much as stepping a run: no call in vain.
        due = self.all if self.together else (k % self.period == 0).nonzero()[0]
        if len(due) == len(self.all):
            self._sample(slice(None), due, k, signals)
        elif len(due):
            self._sample(due, due, k, signals[due])
        return self.force

    def _sample(self, due: Array | slice, which: Array, k: int, seen: Array) -> None:
        """Those that are due measure, and take the force that is."""
        if len(self.noise):
            seen = seen + self.noise[k, due]
        if self.coarse:
            resolution = self.resolution[due]
            steps = np.where(resolution > 0, resolution, 1.0)
            seen = np.where(resolution > 0, steps * np.round(seen / steps), seen)
        computed = np.matvec(self.gain[due], seen)
        if self.memory is not None:
            computed += np.matvec(self.memory[due], self.kept[due])
            self.kept[due] = computed[:, self.forces :]
            computed = computed[:, : self.forces]
        if len(self.queue) == 1:
            self.force[due] = computed
            return
        sample = k // self.period[due]
        self.queue[sample % len(self.queue), which] = computed
        # Before the first force arrives it is a place in the ring that is still zero.
        self.force[due] = self.queue[(sample - self.delay[due]) % len(self.queue), which]
