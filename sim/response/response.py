"""A response: named signals over time, for one run or many. The linear analysis and the physics both make this."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.common.errors import listing
from models.signals import Signal

SILENT = 1e-3


@dataclass(frozen=True, eq=False)
class Response:
    """Signals over time, measured from static equilibrium.

    Attributes:
        time: sample times [s], shape (T,).
        signals: what the last axis of `values` holds, S of them, each with its unit.
        values: shape (..., T, S); leading axes are runs.

    Raises:
        ValueError: the shapes do not fit.
    """

    time: Array
    signals: tuple[Signal, ...]
    values: Array

    def __post_init__(self) -> None:
        expected = (len(self.time), len(self.signals))
        if self.values.shape[-2:] != expected:
            raise ValueError(f"values end in shape {self.values.shape[-2:]}; time and signals say {expected}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the signals."""
        return tuple(signal.name for signal in self.signals)

    def __getitem__(self, signal: str) -> Array:
        """One signal over time, shape (..., T).

        Raises:
            KeyError: there is no such signal; the message lists those there are.
        """
        if signal not in self.names:
            raise KeyError(f"no signal {signal!r}; this response has {listing(self.names)}")
        return self.values[..., self.names.index(signal)]

    def run(self, index: int) -> "Response":
        """One run of many."""
        return Response(self.time, self.signals, self.values[index])

    def beside(self, signals: tuple[Signal, ...], values: Array) -> "Response":
        """With more signals after its own, values of shape (..., T, k); it itself where there are none."""
        if not signals:
            return self
        return Response(self.time, (*self.signals, *signals), np.concatenate([self.values, values], axis=-1))

    def only(self, names: Sequence[str]) -> "Response":
        """Some of its signals."""
        columns = [self.names.index(name) for name in names]
        return Response(self.time, tuple(self.signals[i] for i in columns), self.values[..., columns])

    def until(self, time: float) -> "Response":
        """The samples before a time [s]."""
        count = int(np.searchsorted(self.time, time))
        return Response(self.time[:count], self.signals, self.values[..., :count, :])

    @property
    def diverged(self) -> float:
        """When a single run diverged [s], the first sample with a value that is no number; infinite where it did not."""
        broken = ~np.all(np.isfinite(self.values), axis=-1)
        return float(self.time[broken.argmax()]) if broken.any() else np.inf

    def peak(self, signal: str) -> Array:
        """Largest magnitude of a signal, shape (...,), NaN where a run broke off (see `sim.physics.simulate`)."""
        return np.max(np.abs(self[signal]), axis=-1)

    def scale(self, signal: str) -> float:
        """What a single run's differences in a signal are measured against: its peak.

        A signal that symmetry keeps silent, such as roll over a bump under both tracks, has no peak of its own: it counts a
        thousandth of the loudest signal of its unit.
        """
        unit = self.signals[self.names.index(signal)].unit
        loudest = max(float(self.peak(other.name)) for other in self.signals if other.unit == unit)
        return max(float(self.peak(signal)), SILENT * loudest)

    def rms(self, signal: str) -> Array:
        """Root mean square of a signal over the whole response, shape (...,)."""
        return np.sqrt(np.mean(self[signal] ** 2, axis=-1))
