"""Residuals of all experiments, which are the predicted minus the measured signals divided by the noise, and derivatives of
these residuals.

The vector x contains all unknowns: the free parameters, the sensor delays [s], and the starting state and offsets of each
experiment. A parameter is represented by the logarithm of its ratio to the initial value, or by the ratio itself if the
parameter may be zero.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from models.common.arrays import Array
from sim.studies.identification.estimation.problem import IdentificationProblem
from sim.studies.identification.experiment import Channel, Experiment
from sim.studies.identification.prediction import PredictedSignals

FURTHEST = 9.0  # largest change of the logarithm of a parameter: a factor of 8000
BLOCK = 50_000  # largest number of samples whose derivatives are kept in memory at the same time


class Residuals:
    """Residuals for one choice of free parameters.

    Attributes:
        problem: parameters to identify, and experiments; parameters that are not free keep their initial values.
        free: names of the p free parameters.
        delayed: index in x of each estimated delay, by signal.
        starts: indices in x of the starting state of each experiment; empty if the vehicle starts in equilibrium.
        offsets: indices in x of the estimated offsets of each experiment, by index of the channel.
        size: number of unknowns in x.
        measured: measured signals of each experiment, shape (T, q).
    """

    def __init__(self, problem: IdentificationProblem, free: Sequence[str]) -> None:
        """Prepares the indices of the unknowns in x."""
        self.problem, self.free = problem, tuple(free)
        self.delayed = {name: len(self.free) + i for i, name in enumerate(problem.delayed)}
        self.size, self.starts, self.offsets = len(self.free) + len(self.delayed), list[slice](), list[dict[int, int]]()
        for one, prediction in zip(problem.experiments, problem.predictions, strict=True):
            last = self.size + (0 if one.from_rest else len(prediction.states(problem.first)))
            estimated = [i for i, channel in enumerate(one.channels) if channel.offset_estimated]
            self.starts.append(slice(self.size, last))
            self.offsets.append({channel: last + k for k, channel in enumerate(estimated)})
            self.size = last + len(estimated)
        self.measured = [np.stack([channel.values for channel in one.channels], axis=-1) for one in problem.experiments]
        self._at, self._predicted = None, list[PredictedSignals]()

    def values(self, x: Array) -> dict[str, float]:
        """Returns the values of all parameters of the vehicle."""
        values = dict(self.problem.first)
        for name, number in zip(self.free, x.tolist(), strict=False):
            values[name] = self.value(name, number)
        return values

    def value(self, name: str, unknown: float) -> float:
        """Returns the value of a parameter, computed from the unknown that represents the parameter; inverse of `coordinate`."""
        if name in self.problem.from_zero:
            return self.problem.first[name] * max(unknown, 0.0)
        return self.problem.first[name] * math.exp(min(max(unknown, -FURTHEST), FURTHEST))

    def within(self, x: Array) -> Array:
        """Returns the unknowns with each logarithm limited to `FURTHEST`; the values of the parameters stay the same."""
        limited = x.copy()
        for i, name in enumerate(self.free):
            if name not in self.problem.from_zero:
                limited[i] = min(max(limited[i], -FURTHEST), FURTHEST)
        return limited

    def at_limit(self, x: Array) -> list[str]:
        """Returns the names of the free parameters that the search changed as far as it may, by a factor of 8000."""
        logarithms = zip(self.free, x.tolist(), strict=False)
        return [name for name, one in logarithms if name not in self.problem.from_zero and abs(one) >= FURTHEST]

    def coordinate(self, name: str, value: float) -> float:
        """Returns the unknown that represents a parameter: the parameter's ratio to its initial value if it may be zero,
        otherwise the logarithm of this ratio.
        """
        ratio = value / self.problem.first[name]
        return ratio if name in self.problem.from_zero else math.log(ratio)

    def sizes(self, values: Mapping[str, float]) -> dict[str, float]:
        """Returns the derivative of each free parameter with respect to the unknown that represents the parameter, by name."""
        return {name: (self.problem.first if name in self.problem.from_zero else values)[name] for name in self.free}

    def delays(self, x: Array, experiment: Experiment) -> list[float]:
        """Returns the sensor delay of each channel of an experiment [s]."""
        return [float(x[self.delayed[one.signal]]) if one.signal in self.delayed else one.delay for one in experiment.channels]

    def start(self, x: Array, i: int) -> Array | None:
        """Returns the state of the vehicle at the start of an experiment; None if the vehicle starts in equilibrium."""
        return None if self.problem.experiments[i].from_rest else x[self.starts[i]]

    def shifts(self, x: Array, i: int) -> Array:
        """Returns the estimated offset of each channel of an experiment, shape (q,)."""
        shifts = np.zeros(len(self.problem.experiments[i].channels))
        shifts[list(self.offsets[i])] = x[list(self.offsets[i].values())]
        return shifts

    def predicted(self, x: Array) -> list[PredictedSignals]:
        """Returns the predicted signals of all experiments, including sensor offsets. The last result is cached and is used
        again if x does not change.
        """
        if self._at is None or not np.array_equal(self._at, x):
            values, each = self.values(x), list[PredictedSignals]()
            for i, one in enumerate(self.problem.predictions):
                signals = one(values, self.sizes(values), self.start(x, i), self.delays(x, one.experiment))
                each.append(replace(signals, values=signals.values + self.shifts(x, i)))
            self._at, self._predicted = x.copy(), each
        return self._predicted

    def differences(self, x: Array) -> list[Array]:
        """Returns predicted minus measured signals of each experiment, shape (T, q); NaN where a measured value is missing."""
        return [one.values - measured for one, measured in zip(self.predicted(x), self.measured, strict=True)]

    def channels(self, x: Array) -> Iterator[tuple[Channel, Array]]:
        """Yields, for each channel of each experiment, the predicted minus the measured values, without missing values."""
        for one, difference in zip(self.problem.experiments, self.differences(x), strict=True):
            for channel, values in zip(one.channels, difference.T, strict=True):
                yield channel, values[np.isfinite(values)]

    def channel_columns(self, x: Array, noise: Mapping[str, float], i: int, channel: int, part: slice = slice(None)) -> Array:
        """Returns the derivatives of an experiment's residuals in one channel, with a column for each unknown, shape (T,
        unknowns).
        """
        signals, name = self.predicted(x)[i], self.problem.experiments[i].signals[channel]
        columns, size = np.zeros((len(signals.values[part]), self.size)), noise[name]
        for j, scale in enumerate(self.sizes(self.values(x)).values()):
            columns[:, j] = signals.by_parameter[j, part, channel] * (scale / size)
        if name in self.delayed:
            columns[:, self.delayed[name]] = signals.by_delay[part, channel] / size
        columns[:, self.starts[i]] = signals.by_start[:, part, channel].T / size
        if channel in self.offsets[i]:
            columns[:, self.offsets[i][channel]] = 1 / size
        return columns

    def whole(self, x: Array, noise: Mapping[str, float], most: int) -> tuple[Array, Array]:
        """Returns the derivatives of all residuals, shape (N, unknowns), and the residuals, shape (N,), ordered by channel.

        Args:
            most: largest number of samples that are used from each experiment.
        """
        each = [*self._blocks(x, noise, most), (self.known_columns(x), self._known(self.values(x)))]
        return np.concatenate([J for J, _ in each]), np.concatenate([residuals for _, residuals in each])

    def reduced(self, x: Array, noise: Mapping[str, float]) -> tuple[Array, Array]:
        """Returns the matrix R and the vector c of a small least-squares problem with the same solution as the whole problem,
        by QR decomposition.

        The derivatives of a long log are never all in memory at the same time. R has the shape (unknowns + 1, unknowns), and c
        the shape (unknowns + 1,).
        """
        whole = np.column_stack([self.known_columns(x), self._known(self.values(x))])
        for J, residuals in self._blocks(x, noise):
            whole = np.linalg.qr(np.vstack([whole, np.column_stack([J, bounded(residuals)])])).R
        whole = np.pad(whole, ((0, max(0, whole.shape[1] - len(whole))), (0, 0)))
        return whole[:, :-1], whole[:, -1]

    def _blocks(self, x: Array, noise: Mapping[str, float], most: int | None = None) -> Iterator[tuple[Array, Array]]:
        for i, (each, one) in enumerate(zip(self.differences(x), self.problem.experiments, strict=True)):
            for channel, name in enumerate(one.signals):
                for first in range(0, len(each[:most]), BLOCK):
                    part = slice(first, min(first + BLOCK, most or len(each)))
                    values = each[part, channel]
                    counted = np.isfinite(values)
                    yield self.channel_columns(x, noise, i, channel, part)[counted], values[counted] / noise[name]

    def known_columns(self, x: Array) -> Array:
        """Returns the derivatives of the known combinations, each divided by its standard deviation, shape (k, unknowns)."""
        values, base = self.values(x), np.zeros((len(self.problem.known), self.size))
        for j, (name, size) in enumerate(self.sizes(values).items() if self.problem.known else ()):
            base[:, j] = (self._known({**values, name: values[name] + 1e-6 * size}) - self._known(values)) / 1e-6
        return base

    def _known(self, values: Mapping[str, float]) -> Array:
        if not self.problem.known:
            return np.zeros(0)
        vehicle = self.problem.change(self.problem.vehicle, values)
        return np.array([(one.of(vehicle) - one.value) / one.deviation for one in self.problem.known])

    def noise(self, x: Array) -> dict[str, float]:
        """Returns the noise rms of each signal: the supplied value or, if none was supplied, the rms of the signal's
        residuals.
        """
        squares, counts, given = dict[str, float](), dict[str, int](), dict[str, float]()
        for channel, values in self.channels(x):
            squares[channel.signal] = squares.get(channel.signal, 0.0) + float(values @ values)
            counts[channel.signal] = counts.get(channel.signal, 0) + len(values)
            if channel.noise is not None:
                given[channel.signal] = channel.noise
        return {name: given.get(name) or max(math.sqrt(squares[name] / counts[name]), 1e-9 * self.scale[name]) for name in counts}

    def deviance(self, x: Array, noise: Mapping[str, float]) -> float:
        """Returns -2 log likelihood of the unknowns, up to a constant."""
        known = self._known(self.values(x))
        total = float(known @ known)
        for channel, values in self.channels(x):
            residuals = bounded(values / noise[channel.signal])
            total += float(residuals @ residuals) + 2 * len(values) * math.log(noise[channel.signal])
        return total

    @cached_property
    def scale(self) -> dict[str, float]:
        """Rms of each measured signal about its mean."""
        own = dict[str, list[Array]]()
        for one in self.problem.experiments:
            for channel in one.channels:
                own.setdefault(channel.signal, []).append(channel.values[channel.counted])
        return {name: float(np.concatenate(each).std()) or 1.0 for name, each in own.items()}

    def fits(self, x: Array) -> list[dict[str, float]]:
        """Returns, for each experiment, the fit of each signal: 1 - rms of the residuals / standard deviation of the signal."""
        each = list[dict[str, float]]()
        for one, difference in zip(self.problem.experiments, self.differences(x), strict=True):
            each.append({})
            for channel, values in zip(one.channels, difference.T, strict=True):
                counted = np.isfinite(values)
                spread = float(channel.values[counted].std()) if counted.any() else 0.0
                each[-1][channel.signal] = 1 - float(np.sqrt(np.mean(values[counted] ** 2))) / spread if spread else 0.0
        return each


def bounded(residuals: Array) -> Array:
    """Returns the residuals, where large numbers replace overflows, so that the search turns back from unstable vehicles."""
    return np.nan_to_num(np.clip(residuals, -1e12, 1e12), nan=1e12)
