"""Responses: named signals over time, for one run or many, from linear analysis or from simulation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from models.common.arrays import Array
from models.common.checks import check_arguments, check_fields, plain
from models.common.errors import InputError, list_names, short_repr
from models.document.document import Document
from models.document.text import ShownResult, facts
from models.kinds.signals import Signal, is_kept
from models.vehicle.vehicle import Vehicle

if TYPE_CHECKING:
    import control
    import pandas as pd


SAME_VALUE = 1e-9  # largest difference, relative to a signal's peak, that counts as rounding
SILENT = 1e-3  # smallest scale of a signal, relative to the largest signal with the same unit
# angles times 1 m that are smaller than this multiple of the displacements are rounding errors of a symmetrical vehicle; the
# same applies to their rates
STILL = 1e-6
# unit of an angle or its rates, and the unit of the motion that it causes at a distance from the axis of rotation
ALONG = {"rad": "m", "rad/s": "m/s", "rad/s2": "m/s2"}


def loudest_alike(sizes: Array, units: Sequence[str], still: float = STILL) -> Array:
    """Returns, for each signal, the size of the largest signal with the same unit, shape (..., p).

    Symmetry may keep all angles at zero, for example the roll of a half-car in the roll plane over a bump under both tracks.
    If all angles are zero, the size of the largest displacement is used for angles; an angle then corresponds to a displacement
    at 1 m.

    Args:
        sizes: size of each of p signals, for example its peak, shape (..., p).
        units: units of the p signals.
        still: ratio of angles to displacements below which angles count as zero: `STILL`, or the square of `STILL` if the sizes
            are squares.
    """
    largest = {unit: sizes[..., np.array(units) == unit].max(axis=-1) for unit in {*units}}
    for turned, along in ALONG.items():
        if turned in largest and along in largest:
            still_now = largest[turned] <= still * largest[along]
            largest[turned] = np.where(still_now, largest[along], largest[turned])
    return np.stack([largest[unit] for unit in units], axis=-1)


@dataclass(frozen=True, eq=False, repr=False)
class Response(ShownResult):
    """Signals over time, relative to static equilibrium.

    Attributes:
        time: sample times [s], shape (T,).
        signals: the S signals, with their units, in the order of the last axis of `values`.
        values: values of the signals, shape (..., T, S). The leading axes correspond to runs.
        before: values just before decisions (`sim.drive.jumps`), and on the other side of vertical edges of the road, by name
            of the signal, shape (..., T) each. The mapping `before` contains only signals that jump.

    Raises:
        InputError: the shapes of the arrays `time`, `signals` and `values` are inconsistent.
    """

    time: Array
    signals: tuple[Signal, ...]
    values: Array
    before: Mapping[str, Array] = field(default_factory=dict[str, Array])

    def __post_init__(self) -> None:
        check_fields(self)
        expected = (len(self.time), len(self.signals))
        if self.values.shape[-2:] != expected:
            raise InputError(
                f"the last two axes of values have the lengths {self.values.shape[-2:]}, but the numbers of times and signals "
                f"are {expected}; give values whose last axes have these lengths"
            )

    @property
    def summary(self) -> Document:
        """Document that states the number of samples and runs, and lists the signals with their units."""
        times = f", {self.time[0]:g} to {self.time[-1]:g} s" if len(self.time) else ""
        runs = f", {' x '.join(map(str, self.values.shape[:-2]))} runs" if self.values.ndim > 2 else ""
        signals = ", ".join(f"{signal.name} [{signal.unit}]" for signal in self.signals)
        return facts(f"response: {len(self.time)} samples{times}{runs}", {"signals": signals})

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the signals."""
        return tuple(signal.name for signal in self.signals)

    def __getitem__(self, signal: str) -> Array:
        """Returns the values of a signal over time, shape (..., T).

        Raises:
            InputError: the signal does not exist; the message lists the signals of the response.
        """
        return self.values[..., self._column(signal)]

    def _column(self, signal: str) -> int:
        if signal not in self.names:
            raise InputError(f"the response has no signal {short_repr(signal)}; give one of: {list_names(self.names)}")
        return self.names.index(signal)

    @check_arguments
    def run(self, index: int) -> "Response":
        """Returns the response of a single run, selected by index.

        Raises:
            InputError: there is no run with this index.
        """
        if self.values.ndim < 3:
            raise InputError(f"values of the shape {self.values.shape} belong to a single run; use this response as it is")
        if not -len(self.values) <= index < len(self.values):
            raise InputError(
                f"index = {index} selects no run, because the values have the shape {self.values.shape}; give an index that "
                "exists on the first axis, which counts the runs"
            )
        before = {name: values[index] for name, values in self.before.items()}
        return Response(self.time, self.signals, self.values[index], before)

    def with_signals(self, signals: tuple[Signal, ...], values: Array) -> "Response":
        """Returns the response with k additional signals, whose values have shape (..., T, k).

        If there are no additional signals, the response itself is returned.
        """
        if not signals:
            return self
        return replace(self, signals=(*self.signals, *signals), values=np.concatenate([self.values, values], axis=-1))

    def with_sides(self, others: Mapping[int, Array]) -> "Response":
        """Adds the signal values on the other side of the road's vertical edges to `before`.

        Args:
            others: values of all signals on the other side of each vertical edge, shape (..., S) each, by index of the sample
                at the edge.
        """
        before = dict(self.before)
        for i, name in enumerate(self.names):
            known, scale = self[name], SAME_VALUE * np.abs(self[name]).max(initial=0.0)
            if any(np.any(np.abs(other[..., i] - known[..., k]) > scale) for k, other in others.items()):
                before[name] = before.get(name, known).copy()
                for k, other in others.items():
                    before[name][..., k] = other[..., i]
        return replace(self, before=before)

    def only(self, names: Sequence[str]) -> "Response":
        """Returns the response with only the selected signals."""
        columns = [self._column(name) for name in names]
        before = {name: self.before[name] for name in names if name in self.before}
        return Response(self.time, tuple(self.signals[i] for i in columns), self.values[..., columns], before)

    def until(self, time: float) -> "Response":
        """Returns the part of the response before a time [s]."""
        return self.samples(slice(int(np.searchsorted(self.time, time))))

    def samples(self, which: slice | Array) -> "Response":
        """Returns the response at those samples that a slice or a mask selects."""
        before = {name: values[..., which] for name, values in self.before.items()}
        return Response(self.time[which], self.signals, self.values[..., which, :], before)

    @property
    def diverged(self) -> float:
        """Time of the first sample with a value that is not finite, for a single run [s]; infinity if all values are finite."""
        broken = ~np.all(np.isfinite(self.values), axis=-1)
        return float(self.time[broken.argmax()]) if broken.any() else np.inf

    @property
    def law_diverged(self) -> bool:
        """True if the response is that of a single simulated run that ended because states of the control law diverged; see
        `Recording.response`.
        """
        return bool(np.isinf(self.values[:, [is_kept(signal) for signal in self.signals]]).any())

    def peak(self, signal: str) -> Any:
        """Returns the largest magnitude of a signal, including the values on both sides of jumps; NaN if a run ended early.

        For a single run, the result is a float; for several runs, it is an array of shape (...,).
        """
        return plain(self._peaks[..., self._column(signal)])

    @cached_property
    def _peaks(self) -> Array:
        """Peaks of all signals, shape (..., S); these peaks are cached, because `scale` often needs them."""
        peaks = np.maximum(np.abs(self.values.max(axis=-2)), np.abs(self.values.min(axis=-2)))
        for name, values in self.before.items():
            peaks[..., self._column(name)] = np.maximum(peaks[..., self._column(name)], np.abs(values).max(axis=-1))
        return peaks

    @cached_property
    def _loudest(self) -> Array:
        """For each signal, the largest peak of all signals with the same unit, shape (..., S)."""
        return loudest_alike(self._peaks, [signal.unit for signal in self.signals])

    def scale(self, signal: str) -> float:
        """Returns the reference value for relative differences of a signal in a single run, usually the signal's peak.

        A signal may remain zero because of symmetry, for example the roll angle over a bump under both tracks. The reference
        value is therefore at least a thousandth of the peak of the largest signal with the same unit, see `loudest_alike`.
        """
        return max(self.peak(signal), SILENT * float(self._loudest[self._column(signal)]))

    def rms(self, signal: str) -> Any:
        """Returns the root mean square of a signal over the whole response, including the values on both sides of jumps.

        For a single run, the result is a float; for several runs, it is an array of shape (...,).
        """
        after = self[signal] ** 2
        return plain(np.sqrt(np.mean((after + self.before[signal] ** 2) / 2 if signal in self.before else after, axis=-1)))

    def to_pandas(self) -> "pd.DataFrame":
        """Converts one run to a DataFrame with a column per signal, the time [s] as index, and the units in `attrs["units"]`.

        Raises:
            InputError: the response contains several runs; select one with `run`.
        """
        import pandas as pd

        self._check_single()
        frame = pd.DataFrame(self.values, index=pd.Index(self.time, name="time"), columns=list(self.names))
        frame.attrs["units"] = {signal.name: signal.unit for signal in self.signals}
        return frame

    @check_arguments
    def to_control(self, vehicle: Vehicle) -> "control.TimeResponseData":
        """Converts one run to a time response of python-control, whose outputs are the vehicle's outputs and whose inputs are
        the road velocities.

        Raises:
            InputError: the response contains several runs; select one with `run`.
        """
        import control

        self._check_single()
        outputs = vehicle.linear_model.outputs
        roads = tuple(wheel.road_velocity for wheel in vehicle.kind.wheels)
        return control.TimeResponseData(
            self.time,
            np.stack([self[name] for name in outputs]),
            inputs=np.stack([self[name] for name in roads]),
            output_labels=list(outputs),
            input_labels=list(roads),
            issiso=False,
        )

    def _check_single(self) -> None:
        if self.values.ndim != 2:
            raise InputError(
                f"the response contains several runs (shape {self.values.shape[:-2]}), but one is needed; select one run, "
                "as in response.run(0)"
            )


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # signals of an unstable loop may overflow
def difference(physics: Response, sampled: Response) -> Response:
    """Returns the difference from the exact sampled response over time, relative to the peaks of the sampled response. The
    verdict on a run uses the largest difference over time.

    Args:
        sampled: exact sampled response, at the same sample times as the simulated response.

    Returns:
        Difference between the simulated and the sampled response over time, for each signal of the vehicle. The road signals
        are omitted, because the road is the same in both responses.
    """
    outputs = tuple(signal for signal in sampled.signals if not signal.name.startswith("road_"))
    columns: list[Array] = []
    for signal in outputs:
        scale = sampled.scale(signal.name) or 1.0  # the scale is 1 for a vehicle that nothing moves
        apart = (physics[signal.name] - sampled[signal.name]) / scale
        # every NaN has the same bit pattern, because logs are compared byte by byte
        columns.append(np.where(np.isnan(apart), np.nan, apart))
    about = "MuJoCo minus linear, over the peak"  # this text must not change, because existing logs contain it
    signals = tuple(replace(s, symbol=f"({s.symbol}) / peak", unit="1", meaning=f"{about}: {s.meaning}") for s in outputs)
    return Response(sampled.time, signals, np.stack(columns, axis=-1) if columns else np.zeros((len(sampled.time), 0)))
