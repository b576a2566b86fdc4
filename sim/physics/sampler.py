"""The controller as it would be built: its own sample period, a computation delay, noisy and quantised measurements."""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.reality import steps_per_sample
from models.vehicle import Vehicle


class Sampler:
    """N controllers that each sample, compute and hold as the `[implementation]` of their vehicle says.

    A measurement is read as quantisation * round((signal + noise) / quantisation), and the force computed from it acts `delay`
    samples later. Before the first one arrives the force is zero.
    """

    def __init__(
        self, vehicles: Sequence[Vehicle], gain: Array, undelayed: Array, names: Sequence[str], timestep: float, samples: int
    ) -> None:
        """For gains of shape (N, m, S) on the signals of these names; `undelayed` are others, free of any implementation."""
        how = [vehicle.implementation for vehicle in vehicles]
        self.gain, self.undelayed = gain, undelayed if np.any(undelayed) else None
        self.period = np.array([steps_per_sample(one, timestep) for one in how])
        self.delay = np.array([one.delay for one in how])
        self.resolution = np.array([[one.quantisation.get(name, 0.0) for name in names] for one in how])
        rms = np.array([[one.noise.get(name, 0.0) for name in names] for one in how])
        self.noise = np.zeros((samples if np.any(rms) else 0, *rms.shape))
        for i, one in enumerate(how):
            if np.any(rms[i]):
                self.noise[:, i] = rms[i] * np.random.default_rng(one.seed).standard_normal((samples, len(names)))
        self.coarse = bool(np.any(self.resolution))
        self.queue = np.zeros((int(self.delay.max()) + 1, *gain.shape[:2]))  # forces by sample, in a ring
        self.force = np.zeros(gain.shape[:2])
        self.all = np.arange(len(how))
        self.together = bool(np.all(self.period == 1))

    def __call__(self, k: int, signals: Array) -> Array:
        """The forces of step k, shape (N, m), from the signals at its start, shape (N, S)."""
        # This runs between any two steps of the physics, where a call of numpy costs as much as stepping a run: no call in vain.
        due = self.all if self.together else (k % self.period == 0).nonzero()[0]
        if len(due) == len(self.all):
            self._sample(slice(None), due, k, signals, self.gain)
        elif len(due):
            self._sample(due, due, k, signals[due], self.gain[due])
        return self.force if self.undelayed is None else self.force + np.matvec(self.undelayed, signals)

    def _sample(self, due: Array | slice, which: Array, k: int, seen: Array, gain: Array) -> None:
        """Those that are due measure, and take the force that is."""
        if len(self.noise):
            seen = seen + self.noise[k, due]
        if self.coarse:
            resolution = self.resolution[due]
            steps = np.where(resolution > 0, resolution, 1.0)
            seen = np.where(resolution > 0, steps * np.round(seen / steps), seen)
        if len(self.queue) == 1:
            self.force[due] = np.matvec(gain, seen)
            return
        sample = k // self.period[due]
        self.queue[sample % len(self.queue), which] = np.matvec(gain, seen)
        # Before the first force arrives it is a place in the ring that is still zero.
        self.force[due] = self.queue[(sample - self.delay[due]) % len(self.queue), which]
