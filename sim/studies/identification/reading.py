"""Reads experiments from log files: assigns columns to signals, and removes unusable samples and gaps."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, error_in, list_names, short_repr
from models.common.extensions import FEATURES
from models.common.logs.measured_log import MeasuredLog, read_measured_log
from models.common.printed import brief, percent, rough
from models.roads.iso8608 import Iso8608
from models.vehicle.vehicle import Vehicle
from sim.studies.identification.experiment import EXTENSION, FORCE, Channel, Experiment, signal_units
from sim.studies.identification.log_map import FLAT, HELD, LOGGED, REST, ROADS, UNKNOWN, LogKeys, LogMap, SensorSection
from sim.studies.identification.part_prediction import part_of

if TYPE_CHECKING:
    from models.roads.choice import RoadChoice

GAP = 5  # if more steps than this are missing, a new stretch of the log begins, with its own initial state
LEAST = 50  # smallest number of samples in a stretch of the log
SHORTEST = 8.0  # s, shortest stretch of a log of a random road
# if this many consecutive values are equal although the sensor's values otherwise change, the sensor counts as failed
FROZEN = 12
CLIPPED = 3  # if this many consecutive samples equal a signal's largest or smallest value, the signal counts as clipped
JITTER = 0.02  # times count as not equidistant if they deviate from a constant spacing by a larger share of a step than this
COARSE = 0.5  # a remark is printed if a smaller share of the road's motion is below half the Nyquist frequency
MOST_PHASE = 1.0  # rad, largest phase error that wrong times may cause at the typical frequency of the road
DEEP = 1.0  # m; a larger motion in a log cannot be right


@dataclass(frozen=True, eq=False)
class LogStretches:
    """The experiments of a log, and remarks on the log."""

    experiments: tuple[Experiment, ...]
    remarks: tuple[str, ...]


def read_experiments(path: Path, vehicle: Vehicle, log_map: LogMap) -> LogStretches:
    """Reads a log, which may be a table (.csv, .txt, .lvm, .mat, .xlsx, .parquet) or a log of `bump` or `drive` (.mcap).

    Raises:
        InputError: the log cannot be read, a column that the map requires is missing, or values are impossible.
    """
    keys, sensors = log_map.of(path), log_map.sensors
    units = signal_units(vehicle.kind)
    columns = {name: one.column for name, one in sensors.items() if one.column}
    own = path.suffix.lower() == ".mcap" and not columns
    log = _own_log(path, units) if own else read_measured_log(path, units, keys.rate or None, columns)
    if not own:
        sensors = {name: sensors.get(name, SensorSection()) for name in log.signals}
        log = replace(log, signals={name: sensors[name].sign * values for name, values in log.signals.items()})
    else:
        sensors = {name: replace(sensors.get(name, SensorSection()), offset=0.0) for name in log.signals}
        # over a step, the controller holds its forces, and MuJoCo holds the road heights
        keys = replace(keys, forces=HELD, heights=HELD)
    with error_in(f"log {path}:"):
        return _stretches(log, vehicle, keys, sensors)


def _own_log(path: Path, units: Mapping[str, str]) -> MeasuredLog:
    """Returns the signals that MuJoCo wrote to a log of `bump` or `drive`: measurable signals, road heights and control
    forces.
    """
    recorded = FEATURES.load("recorded logs")
    log = recorded.read_log(path)
    run = log.runs[-1]
    samples = run.responses[recorded.MUJOCO]
    time = (samples.times - samples.times[0]) * 1e-9
    driven = ("road_displacement", "control_force", "suspension_deflection", "sprung_acceleration")
    signals = {
        name: values
        for name, values in zip(samples.names, samples.values.T, strict=True)
        if name in units and name.startswith(driven)
    }
    remarks = (
        [f"the run {run.name!r} is used; the log contains the runs {list_names(one.name for one in log.runs)}"]
        if len(log.runs) > 1
        else []
    )
    return MeasuredLog(str(path), time, signals, tuple(remarks))


def _stretches(log: MeasuredLog, vehicle: Vehicle, keys: LogKeys, sensors: Mapping[str, SensorSection]) -> LogStretches:
    remarks = list(log.remarks)
    within = (log.time >= keys.first) & (log.time <= keys.last)
    if within.sum() < LEAST:
        raise InputError(
            f"only {int(within.sum())} samples are between the times first and last of the map, but at least {LEAST} "
            "are needed; change first or last"
        )
    within[np.flatnonzero(within)[np.arange(within.sum()) % keys.every > 0]] = False
    time = log.time[within]
    step, places, late, more = _grid(time)
    if log.rounded:
        late = max(late, _resolution(time) / 2)
        remarks.append(
            f"{log.rounded} samples have the same time as the previous sample, and are left out, because times are rounded"
        )
    remarks += more
    values = {name: np.full(places[-1] + 1, np.nan) for name in log.signals}
    for name, one in log.signals.items():
        values[name][places] = one[within]
    model, kind = vehicle.linear_model, vehicle.kind
    heights, acting, readable = [wheel.road_displacement for wheel in kind.wheels], model.inputs, model.outputs
    if keys.part:
        part_of(vehicle, keys.part)
        heights, acting, readable, keys = [EXTENSION], (), (FORCE,), replace(keys, road=LOGGED)
    random = _random_road(keys, vehicle)
    keys = keys if random is None else replace(keys, road=FLAT)
    driving = {name: values.pop(name) for name in (*heights, *acting) if name in values}
    for name in [name for name in values if name.startswith("road_velocity")]:
        values.pop(name)
        remarks.append(f"{name} is left out, because the heights of the road drive the vehicle")
    hubs = keys.road == UNKNOWN
    if hubs:
        heights = [f"unsprung_acceleration{wheel.road_displacement.removeprefix('road_displacement')}" for wheel in kind.wheels]
        driving |= {name: values.pop(name) for name in heights if name in values}
    count = places[-1] + 1
    road, origin = _road(keys, vehicle, driving, heights, time[0] + step * np.arange(count))
    forces = np.array([driving.get(name, np.zeros(count)) for name in acting]).reshape(len(acting), count).T
    if not values:
        raise InputError(f"the log has no measured signal; give a column of one of {list_names(readable[:6])}")
    unknown = [name for name in values if name not in readable]
    if unknown:
        raise InputError(f"the vehicle model does not predict {list_names(unknown)}; omit the column of this signal")
    for name in list(values):
        values[name], more = _counted(name, values[name], signal_units(kind)[name])
        remarks += more
        if np.isfinite(values[name]).sum() < LEAST:
            remarks.append(f"{name} is left out, because fewer than {LEAST} of its samples can be used")
            values.pop(name)
    inputs, more = _filled(np.hstack([road, forces]), [*heights, *acting])
    remarks += more + ([] if hubs or keys.part else _slow(inputs[:, : len(heights)], step, late))
    whole, least = np.isfinite(inputs).all(axis=1), LEAST
    if random is not None:
        if np.nan_to_num(forces).any():
            raise InputError(
                "control forces act in this log, but an estimate with a random road needs a passive vehicle; omit the "
                "columns of the forces"
            )
        filled, more = _filled(np.stack([*values.values()], axis=-1), [*values])
        values, remarks = dict(zip(values, filled.T, strict=True)), remarks + more
        whole, least = np.isfinite(filled).all(axis=1), max(LEAST, round(SHORTEST / step))
    experiments = list[Experiment]()
    for first, last in runs(np.asarray(whole)):
        if last - first < least:
            continue
        channels = tuple(_channel(name, values[name][first:last], sensors[name]) for name in values)
        channels = tuple(one for one in channels if one.counted.any())
        if not channels:
            continue
        name = Path(log.source).name
        rest = keys.start == REST and not first
        datum = inputs[first, : len(heights)] if not hubs and not origin else 0.0
        experiments.append(
            Experiment(
                name,
                step,
                inputs[first:last, : len(heights)] - datum,
                inputs[first:last, len(heights) :],
                channels,
                keys.added,
                rest,
                hubs,
                keys.forces == HELD,
                keys.heights == HELD and not hubs and not keys.part,
                keys.part,
                float(time[0] + step * first),
                random,
            )
        )
    if not experiments:
        what = "the road or the forces" if random is None else "a signal"
        raise InputError(
            f"the log has fewer than {least} successive samples without a gap in {what}; give a log with longer sections "
            "without gaps"
        )
    if len(experiments) > 1:
        names = (f"{one.name}, {rough(one.start)} s" for one in experiments)
        experiments = [replace(one, name=name) for one, name in zip(experiments, names, strict=True)]
        remarks.append(f"gaps divide the log into {len(experiments)} stretches, and each stretch has its own initial state")
    return LogStretches(tuple(experiments), tuple(f"{Path(log.source).name}: {one}" for one in remarks))


def _channel(name: str, values: Array, of: SensorSection) -> Channel:
    shifted = values if of.offset is None else values - of.offset
    return Channel(name, shifted, of.noise, of.delay or 0.0, of.delay is None, of.offset is None)


def _grid(time: Array) -> tuple[float, Array, float, list[str]]:
    """Returns the sample interval, the index of each sample, the largest deviation from equidistant times [s], and remarks."""
    diffs = np.diff(time)
    usual = float(np.median(diffs))
    places = np.concatenate([[0], np.cumsum(np.maximum(np.round(diffs / usual), 1))]).astype(int)
    # The time step is the slope of a straight line through all times, because rounded times have uneven differences.
    step = usual
    for _ in range(3):
        step = float(np.polyfit(places, time - time[0], 1)[0])
        again = np.round((time - time[0]) / step).astype(int)
        if np.all(np.diff(again) >= 1):
            places = again - again[0]
    deviation = float(np.abs(time - time[0] - step * places - np.median(time - time[0] - step * places)).max()) / step
    missing = int(places[-1] + 1 - len(places))
    remarks = []
    if deviation > JITTER:
        rounded = len(np.unique(np.round(diffs, 9))) <= 5
        remarks.append(
            f"times deviate by up to {percent(deviation)} of the step of {rough(1e3 * step)} ms from equidistant ones"
            f"{'; they look rounded' * rounded}: samples are treated as equidistant, which causes a phase error"
        )
    if missing:
        remarks.append(f"{missing} samples are missing, of {places[-1] + 1}")
    return step, places, deviation * step, remarks


def _resolution(time: Array) -> float:
    """Returns the largest power of ten [s] such that all times are multiples of this power."""
    return next((10.0**-k for k in range(10) if np.abs(time * 10**k - np.round(time * 10**k)).max() < 1e-4), 0.0)


def _road(keys: LogKeys, vehicle: Vehicle, driving: Mapping[str, Array], names: Sequence[str], time: Array) -> tuple[Array, bool]:
    """Returns road heights under the wheels or hub accelerations, shape (T, r), and True if the offsets of all heights are
    known.
    """
    if keys.road == FLAT:
        return np.zeros((len(time), len(names))), True
    if keys.road in ROADS:
        missing = [name for name in names if name not in driving]
        if missing:
            what = "the input is the acceleration of the hubs, but" if keys.road == UNKNOWN else 'road = "logged", but'
            raise InputError(
                f"{what} no column of the map gives {list_names(missing)}; add this column to the map, or give a different road: "
                "flat, unknown, or a file"
            )
        return np.stack([driving[name] for name in names], axis=-1), False
    from models.roads.choice import choose_road
    from models.roads.road import RoadInput

    choice = choose_road(keys.road)
    _check_speed(keys, choice)
    road = choice.build(vehicle, keys.speed, 0, keys.speed * float(time[-1] - time[0]) + 1.0)
    return RoadInput(vehicle, road, time - time[0]).heights, True


def _random_road(keys: LogKeys, vehicle: Vehicle) -> Iso8608 | None:
    """Returns the random road on which a log was recorded; None if the road is not random."""
    from models.roads.choice import choose_road

    if keys.part or keys.road in ROADS or not (road := choose_road(keys.road)).random:
        return None
    _check_speed(keys, road)
    if vehicle.parts.nonlinear:
        raise InputError(
            "an estimate with a random road needs linear springs and dampers; give the heights of the road, or a vehicle "
            "with linear springs and dampers"
        )
    built = road.build(vehicle, keys.speed, 0, 0.0)
    assert isinstance(built, Iso8608)
    return built


def _check_speed(keys: LogKeys, road: "RoadChoice") -> None:
    """Checks that the map gives the speed of the vehicle, unless the road is a drive file, which contains times.

    Raises:
        InputError: the map gives no speed.
    """
    from models.roads.rig import Rig

    if not keys.speed and not isinstance(road.road, Rig):
        raise InputError(f'road = {short_repr(keys.road)} needs the speed of the vehicle; add a line such as speed = "20 m/s"')


def _counted(name: str, values: Array, unit: str) -> tuple[Array, list[str]]:
    """Returns a signal in which frozen and clipped samples are replaced by NaN, and remarks.

    Raises:
        InputError: the values of the signal are too large for its unit.
    """
    remarks, counted = list[str](), np.isfinite(values)
    finite = values[counted]
    if unit == "m" and len(finite) and np.abs(finite - np.median(finite)).max() > DEEP:
        raise InputError(
            f"{name} moves by {np.abs(finite - np.median(finite)).max():.4g} m, which is too large; if the column is "
            'in mm, write its unit in the map, as in column = "HEADING [mm]"'
        )
    if len(finite) < 2 or np.ptp(finite) == 0:
        return np.full_like(values, np.nan), [f"{name} is constant, and is ignored"]
    same = np.concatenate([[False], (np.diff(values) == 0)])
    lengths = _lengths(same)
    usual = float(np.mean(same[counted]))
    if usual < 0.2:
        frozen = _blocks(lengths, FROZEN)
        if frozen.any():
            remarks.append(f"{name} is frozen for {int(frozen.sum())} samples, which are ignored")
            values = np.where(frozen, np.nan, values)
        for extreme, word in ((np.nanmax(values), "largest"), (np.nanmin(values), "smallest")):
            clipped = _blocks(np.where(values == extreme, lengths, 0), CLIPPED)
            if clipped.sum() >= 2 * CLIPPED:
                remarks.append(
                    f"{name} is clipped at its {word} value {rough(extreme)} {unit}: {int(clipped.sum())} samples are ignored"
                )
                values = np.where(clipped, np.nan, values)
    else:
        remarks.append(f"{name} keeps its value in {percent(usual)} of the samples: its resolution is coarse")
    return values, remarks


def _lengths(same: Array) -> Array:
    """Returns, for each sample, the number of consecutive equal values up to this sample."""
    lengths = np.ones(len(same), dtype=int)
    for i in np.flatnonzero(same):
        lengths[i] = lengths[i - 1] + 1
    return lengths


def _blocks(lengths: Array, least: int) -> Array:
    """Returns True for each sample that belongs to a sequence of at least `least` equal values."""
    blocks = np.zeros(len(lengths), dtype=bool)
    for end in np.flatnonzero(lengths >= least):
        blocks[end - lengths[end] + 1 : end + 1] = True
    return blocks


def _filled(inputs: Array, names: Sequence[str]) -> tuple[Array, list[str]]:
    """Returns the inputs after linear interpolation across short gaps, and remarks."""
    filled, remarks = inputs.copy(), list[str]()
    for column, name in zip(filled.T, names, strict=True):
        missing = ~np.isfinite(column)
        if not missing.any() or missing.all():
            continue
        number = 0
        for first, last in runs(missing):
            if last - first < GAP and first > 0 and last < len(column):
                column[first:last] = np.interp(np.arange(first, last), [first - 1, last], [column[first - 1], column[last]])
                number += last - first
        if number:
            remarks.append(f"{number} missing samples of {name} are replaced by straight lines")
    return filled, remarks


def runs(true: Array) -> list[tuple[int, int]]:
    """Returns the first index and the last index + 1 of each sequence of consecutive True values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _slow(road: Array, step: float, late: float) -> list[str]:
    """Returns a remark if most of the motion of the road is too fast for the sample rate of the log.

    Args:
        late: largest error of the sample times [s].

    Raises:
        InputError: the sample times are so inaccurate that the phase of the road is not known.
    """
    if not np.ptp(np.nan_to_num(road)):
        return []
    velocity = np.diff(np.nan_to_num(road), axis=0)
    power = np.abs(np.fft.rfft(velocity - velocity.mean(axis=0), axis=0)) ** 2
    usual = float(np.searchsorted(np.cumsum(power.sum(axis=1)), power.sum() / 2)) / (step * len(velocity))
    if 2 * np.pi * usual * late > MOST_PHASE:
        raise InputError(
            f"the times are wrong by up to {rough(1e3 * late)} ms, which is {rough(2 * np.pi * usual * late)} rad of phase "
            f"at the road's usual frequency of {rough(usual)} Hz (sampled at {rough(1 / step)} Hz), so this phase is "
            "unknown; export times with more digits, or sample faster"
        )
    slow = power[: max(1, math.ceil(len(power) / 2))].sum() / max(power.sum(), 1e-300)
    if slow >= COARSE:
        return []
    return [
        f"the log is sampled at {rough(1 / step)} Hz, but most of the road's motion is faster than {brief(0.25 / step)} Hz: the "
        "road between samples is not known, and the result is biased"
    ]
