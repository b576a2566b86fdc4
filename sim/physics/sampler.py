"""The controller as it would be built: its own sample period, a computation delay, noisy and quantised measurements."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from models.common.arrays import Array
from models.reality import Implementation, steps_per_sample


class Laws(Protocol):
    """What N controllers make of what they measure.

    Attributes:
        forces: m, or how many commands there are for them.
    """

    forces: int

    @property
    def used(self) -> Array:
        """What their states were at their last sample, shape (N, k)."""
        ...

    def __call__(self, due: Array | slice, which: Array, k: int, seen: Array) -> Array:
        """The forces of step k of those that are due, shape (d, m), from the signals as they read them, shape (d, S).

        Args:
            due: which of the N they are; a slice for all.
            which: the same as indices, ascending, shape (d,).
            k: the step.
            seen: the signals.
        """
        ...


class LinearLaws:
    """N linear laws."""

    def __init__(self, gain: Array, memory: Array) -> None:
        """From the signals to [u; x_c], shape (N, m + k, S), and from x_c, shape (N, m + k, k)."""
        self.gain, self.memory = gain, memory if memory.shape[2] else None
        self.forces = gain.shape[1] - memory.shape[2]
        self.kept, self.used = (np.zeros((len(gain), memory.shape[2])) for _ in range(2))

    def __call__(self, due: Array | slice, which: Array, k: int, seen: Array) -> Array:
        """See `Laws`."""
        computed = np.matvec(self.gain[due], seen)
        if self.memory is not None:
            self.used[due] = self.kept[due]
            computed += np.matvec(self.memory[due], self.used[due])
            self.kept[due] = computed[:, self.forces :]
            computed = computed[:, : self.forces]
        return computed


class Sampler:
    """N controllers that each sample, compute and hold as an `[implementation]` says.

    A measurement is read as quantisation * round((signal + noise) / quantisation), and the force computed from it acts `delay`
    samples later, between two of them where that is a fraction. Before the first one arrives the force is zero. Its own states
    are never late.
    """

    def __init__(self, how: Sequence[Implementation], laws: Laws, names: Sequence[str], timestep: float, samples: int) -> None:
        """For laws on the signals of these names."""
        self.laws = laws
        self.period = np.array([steps_per_sample(one, timestep) for one in how])
        self.late = np.array([round(one.delay * steps) for one, steps in zip(how, self.period, strict=True)])  # steps
        self.resolution = np.array([[one.quantisation.get(name, 0.0) for name in names] for one in how])
        rms = np.array([[one.noise.get(name, 0.0) for name in names] for one in how])
        self.noise = np.zeros((samples if np.any(rms) else 0, *rms.shape))
        for i, one in enumerate(how):
            if np.any(rms[i]):
                self.noise[:, i] = rms[i] * np.random.default_rng(one.seed).standard_normal((samples, len(names)))
        self.coarse = bool(np.any(self.resolution))
        self.queue = np.zeros((max(one.waiting for one in how) + 1, len(how), laws.forces))  # forces by sample, in a ring
        self.force = np.zeros((len(how), laws.forces))
        self.all = np.arange(len(how))
        self.together = bool(np.all(self.period == 1))
        self.between = (self.late % self.period).nonzero()[0]  # those whose forces change between their samples

    def __call__(self, k: int, signals: Array) -> Array:
        """The forces of step k, shape (N, m), from the signals at its start, shape (N, S)."""
        # This runs between any two steps of the physics, where a call of numpy costs as much as stepping a run: no call in vain.
        due = self.all if self.together else (k % self.period == 0).nonzero()[0]
        if len(due) == len(self.all):
            self._sample(slice(None), due, k, signals)
        elif len(due):
            self._sample(due, due, k, signals[due])
        if len(self.between):
            some = self.between[(k - self.late[self.between]) % self.period[self.between] == 0]
            self._act(some, some, k)
        return self.force

    def _sample(self, due: Array | slice, which: Array, k: int, seen: Array) -> None:
        """Those that are due measure, and take the force that is."""
        if len(self.noise):
            seen = seen + self.noise[k, due]
        if self.coarse:
            resolution = self.resolution[due]
            steps = np.where(resolution > 0, resolution, 1.0)
            seen = np.where(resolution > 0, steps * np.round(seen / steps), seen)
        computed = self.laws(due, which, k, seen)
        if len(self.queue) == 1:
            self.force[due] = computed
            return
        self.queue[(k // self.period[due]) % len(self.queue), which] = computed
        if not len(self.between):
            self._act(due, which, k)
        else:
            some = which[self.late[which] % self.period[which] == 0]
            self._act(some, some, k)

    def _act(self, due: Array | slice, which: Array, k: int) -> None:
        """The forces of those act whose time is come; before the first arrives it is a place in the ring that is still zero."""
        self.force[due] = self.queue[(k - self.late[due]) // self.period[due] % len(self.queue), which]
