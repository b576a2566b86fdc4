"""Comparison of simulated runs with a measured log: alignment in time by correlation, and the fit of each signal.

The fit is 1 - rms(measured - MuJoCo) / rms(measured); it is 1 for equal signals, and 0 if the simulated signal is zero. The
signals are compared at the sample times of the run or of the log, whichever has the longer sample period.
"""

from argparse import Namespace
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.logs.measured_log import LEAST, MeasuredLog, read_measured_log
from models.document.document import Document, Table, notes
from models.document.field import Field
from models.kinds.signals import Signal
from models.vehicle.vehicle import Vehicle
from sim.drive.response import Response
from sim.observers.results import WHEN
from sim.runs.result import RunResult

LEAST_OVERLAP = 0.5  # smallest overlap of log and run with which they are correlated, relative to the shorter of the two
MOST_SAMPLES = 2**21  # largest number of samples with which log and run are correlated
WEAK = 0.5  # if the correlation is smaller than this, a remark asks the user to check the start
OFFSET = 0.1  # a remark is printed if subtracting an offset improves the fit by more than this
# A wrong sign is suggested if a correlation is below OPPOSITE, and its magnitude exceeds the correlation with the given sign by
# the factor CLEARLY.
OPPOSITE, CLEARLY = -0.5, 1.1


@dataclass(frozen=True)
class SignalFit:
    """Comparison of a measured signal with a simulated run.

    Attributes:
        fit: value 1 - rms(measured - MuJoCo) / rms(measured); None if the measured signal is zero.
        fit_without_offset: value of `fit` after the offset is removed from the measured signal; None if the signal is then
            zero.
        correlation: correlation coefficient of the measured and the simulated signal; None if either of them is constant.
        offset: mean of the difference (measured - MuJoCo), in the SI unit of the signal.
        rms: rms of the measured signal, in the signal's SI unit.
        samples: number of samples that were compared.
    """

    fit: float | None
    fit_without_offset: float | None
    correlation: float | None
    offset: float
    rms: float
    samples: int

    @property
    def record(self) -> dict[str, float | int | None]:
        """Comparison of a signal with a run as a JSON object."""
        return asdict(self)


_Row = tuple[Signal, str, SignalFit]  # a signal, the name of a run, and the comparison of this signal with the log in this run


def requested_log(options: Namespace, vehicles: Iterable[Vehicle]) -> MeasuredLog | None:
    """Returns the measured log of the option `--beside`, limited to the signals of the compared vehicles; None if the option is
    not used.

    Raises:
        InputError: the log cannot be read (see `read_measured_log`), or an option that requires `--beside` is used without it.
    """
    if options.beside is None:
        for name in [*["beside_column"] * bool(options.beside_column), *sorted(options.given)]:
            if name.startswith("beside"):
                option = f"--{name}".replace("_", "-")
                raise InputError(
                    f"{option} has an effect only with a measured log; give the file of the log with --beside, or omit {option}"
                )
        return None

    columns = dict[str, str]()
    for text in options.beside_column:
        name, _, heading = text.partition("=")
        if not (name and heading) or name in columns:
            raise InputError(
                f"--beside-column {text}: a signal is given twice, or without its heading; give each signal once, as in "
                "SIGNAL=HEADING"
            )
        columns[name] = heading
    units = {signal.name: signal.unit for vehicle in vehicles for signal in vehicle.kind.signals}
    return read_measured_log(options.beside, units, options.beside_rate, columns)


def _fit_of(row: _Row) -> SignalFit:
    return row[2]


START = Field[float]("start", float, ".4f", unit="s")
RMS = Field[SignalFit]("measured rms", lambda one: one.rms, ".4g")
MEAN = Field[SignalFit]("offset", lambda one: one.offset, ".3g")
CORRELATION = Field[SignalFit]("correlation", lambda one: one.correlation, ".3f")
FIT = Field[SignalFit]("fit", lambda one: one.fit, ".3f")


@dataclass(frozen=True, eq=False)
class MeasuredComparison:
    """Comparison of a measured log with simulated runs.

    Attributes:
        log: measured log that is compared with the runs.
        start: time of the log [s] at which the runs start.
        correlation: correlation coefficient at the time `start`, averaged over all signals, for the run with the largest
            average.
        given: True if the user chose the start time.
        response: measured signals during the time of the runs; NaN within gaps.
        offsets: offset that was removed from each measured signal, in the SI unit of the signal; empty if no offset was
            removed.
        opposite: names of measured signals that would correlate better with the opposite sign.
        fits: comparison of each run with the log, by name of the signals that log and run have in common.
    """

    log: MeasuredLog
    start: float
    correlation: float
    given: bool
    response: Response
    offsets: Mapping[str, float]
    opposite: tuple[str, ...]
    fits: tuple[Mapping[str, SignalFit], ...]

    @property
    def record(self) -> dict[str, Any]:
        """Alignment of log and runs as a JSON object."""
        first, last = (float(self.response.time[i]) for i in (0, -1))
        return {
            "file": self.log.source,
            "start": self.start,
            "start_given": self.given,
            "correlation": self.correlation,
            "first": first,
            "last": last,
            "offsets": dict(self.offsets),
        }

    @property
    def warnings(self) -> Iterator[str]:
        """Remarks about the log and its columns, such as weak correlation, opposite sign, or offset."""
        about = f"measured log {self.log.source}: "
        yield from (f"{about}{remark}" for remark in self.log.remarks)
        if not self.given and self.correlation < WEAK:
            most = CORRELATION.digits(self.correlation)
            yield f"{about}the largest correlation with a run is only {most}; check the start, or give the start"
        for name in self.response.names:
            ones = [fits[name] for fits in self.fits if name in fits]
            best = max(ones, key=lambda one: one.correlation or 0.0)
            centred = best.fit_without_offset
            if name in self.opposite or (best.correlation or 0.0) < OPPOSITE:
                yield f"{about}{name} correlates better with the opposite sign; check the sign of its column"
            elif best.fit is not None and centred is not None and centred > max(best.fit, 0.0) + OFFSET:
                fit = FIT.digits(centred)
                yield f"{about}{name} has an offset of {MEAN.cell(best)}; the fit is {fit} with --beside-remove-offset"

    def describe(self, names: Sequence[str]) -> Document:
        """Returns a document with a table of the fits, and a note about the start time.

        Args:
            names: names of the simulated runs.
        """
        rows = [
            (signal, name, fits[signal.name])
            for signal in self.response.signals
            for name, fits in zip(names, self.fits, strict=True)
            if signal.name in fits
        ]
        several = len(names) > 1
        fields = (
            Field[_Row]("signal", lambda row: row[0].name),
            *([Field[_Row]("controller", lambda row: row[1])] if several else []),
            Field[_Row]("unit", lambda row: row[0].unit),
            *(one.of(_fit_of) for one in (RMS, MEAN, CORRELATION, FIT)),
        )
        caption = "fit = 1 - rms(measured - MuJoCo) / rms(measured)"
        first, last = (float(self.response.time[i]) for i in (0, -1))
        how = "as given" if self.given else "by correlation"
        start = f"{caption}, from {WHEN.digits(first)} to {WHEN.text(last)}. The runs start at {START.text(self.start)} of "
        start += f"{self.log.source} ({how}){'; the mean difference is removed from each signal' * bool(self.offsets)}"
        return Document("", (Table.of("measured", caption, fields, rows, words=2 + several), *notes(start)))


def compare_log(
    log: MeasuredLog, runs: Sequence[RunResult], start: float | None = None, remove_offsets: bool = False
) -> MeasuredComparison:
    """Aligns a measured log in time with runs of equal duration, and compares the log with each run.

    Args:
        log: measured log that is compared with the runs.
        runs: runs over the same road.
        start: time of the log at the start of the runs [s]; None to choose the start time with the largest correlation.
        remove_offsets: True to subtract from each measured signal its mean difference from the run with the largest
            correlation.

    Raises:
        InputError: log and runs do not overlap in time, or a signal of the log has no value during the overlap.
    """
    several = [until_end(run) for run in runs]
    if min(len(one.time) for one in several) < LEAST:
        raise InputError(
            f"measured log {log.source}: one run stopped at its first time step, so this run cannot be compared with "
            "the log; omit the controller whose run stopped"
        )
    given = start is not None
    starts = [(start, ())] * len(runs) if start is not None else [_best_start(log, one) for one in several]
    scores = [_score(log, one, at) for one, (at, _) in zip(several, starts, strict=True)]
    best = int(np.argmax(scores))
    (at, opposite), run = starts[best], several[best]
    signals = {signal.name: signal for one in several for signal in one.signals}
    response = _align_signals(log, run, at, [signals[name] for name in log.signals])
    finite = np.isfinite(response.values)
    if not finite.any(axis=0).all():
        first, last = (float(log.time[i] - at) for i in (0, -1))
        raise InputError(
            f"measured log {log.source}: a signal of the log has no value at any time of the run. The log covers "
            f"{first:.4g} to {last:.4g} s of the run, which lasts {run.time[-1]:.4g} s; give a different start time "
            "with --beside-start"
        )
    offsets = {name: one.offset for name, one in fits(response, run).items()} if remove_offsets else {}
    moved = replace(response, values=response.values - [offsets.get(name, 0.0) for name in response.names])
    return MeasuredComparison(log, at, scores[best], given, moved, offsets, opposite, tuple(fits(moved, one) for one in several))


def until_end(run: RunResult) -> Response:
    """Returns MuJoCo's response up to the time at which the run was aborted; the whole response if the run was not aborted."""
    return run.physics if run.broke_off is None else run.physics.until(run.broke_off[1])


def _align_signals(log: MeasuredLog, run: Response, start: float, signals: Sequence[Signal]) -> Response:
    """Returns measured signals during a run, at the sample times of the log or of the run, whichever has the longer sample
    period.

    Args:
        log: measured log that is compared with the runs.
        run: simulated response of the run.
        start: time of the log at the start of the run [s].
        signals: names of the signals to return.
    """
    relative = log.time - start
    if log.step > run.time[1] - run.time[0]:
        during = (relative >= 0) & (relative <= run.time[-1])
        time, values = relative[during], [log.signals[one.name][during] for one in signals]
    else:
        time = run.time[(run.time >= relative[0]) & (run.time <= relative[-1])]
        values = [log.at(one.name, time + start) for one in signals]
    return Response(time, tuple(signals), np.stack(values, axis=-1))


def fits(measured: Response, physics: Response) -> dict[str, SignalFit]:
    """Returns the fits of a simulated run to measured signals, by name, for all signals that run and log have in common.

    Signals are compared at the times of measurement during the run.
    """
    results: dict[str, SignalFit] = {}
    for name in measured.names:
        if name not in physics.names:
            continue
        m, r = measured[name], np.interp(measured.time, physics.time, physics[name], right=np.nan)
        both = np.isfinite(m) & np.isfinite(r)
        if not both.any():
            continue
        m, r = m[both], r[both]
        spread, offset = float(m.std() * r.std()), float(np.mean(m - r))
        correlation = float(np.mean((m - m.mean()) * (r - r.mean()))) / spread if spread else None
        results[name] = SignalFit(_fit(m, r), _fit(m - offset, r), correlation, offset, _rms(m), int(both.sum()))
    return results


def _fit(measured: Array, run: Array) -> float | None:
    return 1 - _rms(measured - run) / rms if (rms := _rms(measured)) else None


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _score(log: MeasuredLog, run: Response, start: float) -> float:
    """Returns the mean correlation of the signals that log and run have in common, if the run starts at the log's time `start`
    [s].
    """
    signals = [one for one in run.signals if one.name in log.signals]
    ones = fits(_align_signals(log, run, start, signals), run).values() if signals else ()
    known = [one.correlation for one in ones if one.correlation is not None]
    return sum(known) / max(len(known), 1)


def _best_start(log: MeasuredLog, run: Response) -> tuple[float, tuple[str, ...]]:
    """Finds the log's time at which a run starts, by the largest correlation of the signals that log and run have in common.

    Log and run are first correlated at one common sample rate. Means are removed. Each signal is divided by the rms of its
    values in the run and in the part of the log that the run covers. The start time is then refined to a fraction of the sample
    period.

    Returns:
        Time of the log at the start of the run [s], and the names of signals that would correlate better with the opposite
        sign.
    """
    from scipy.optimize import minimize_scalar
    from scipy.signal import correlate

    step = run.time[1] - run.time[0]
    step *= max(1.0, (log.time[-1] - log.time[0] + run.time[-1]) / step / MOST_SAMPLES)
    at = np.arange(log.time[0], log.time[-1] + step / 2, step)
    grid = np.arange(0.0, run.time[-1] + step / 2, step)
    total, opposite = np.zeros(len(at) + len(grid) - 1), list[str]()

    def sums(values: Array, weights: Array) -> Array:
        """Returns the sum of the products of the values of two signals, for each shift in time between them."""
        return np.asarray(correlate(values, weights, mode="full", method="fft"))

    for name in (name for name in log.signals if name in run.names):
        m, r = log.at(name, at), np.interp(grid, run.time, run[name])
        known = np.isfinite(m).astype(float)
        m = np.where(known > 0, m - np.nanmean(log.signals[name]), 0.0)
        r, ones = r - r.mean(), np.ones_like(r)
        count, sum_m, square = (sums(one, ones) for one in (known, m, m**2))
        enough = count >= max(LEAST_OVERLAP * min(known.sum(), len(r)), 2.0)
        count = np.maximum(count, 1.0)
        varied = square - sum_m**2 / count
        enough &= varied > 1e-9 * square.max()
        both = sums(m, r) - sum_m * sums(known, r) / count
        scale = np.sqrt(np.where(enough, varied, 1.0) * max(float(np.sum(r**2)), np.finfo(float).tiny))
        correlation = np.where(enough, both / scale, 0.0)
        opposite += [name] * bool(-correlation.min() > CLEARLY * correlation.max())
        total += np.where(enough, correlation, -1.0)
    shift = int(np.argmax(total)) - len(grid) + 1 if total.max() > 0 else 0
    coarse = float(log.time[0] + step * shift)
    room = max(step, log.step / 2)
    finer: Any = minimize_scalar(
        lambda start: -_score(log, run, start), bounds=(coarse - room, coarse + room), method="bounded", options={"xatol": 1e-7}
    )
    return float(finer.x) if -finer.fun > _score(log, run, coarse) + 1e-12 else coarse, tuple(opposite)
