"""Metrics of a run: measured in MuJoCo, computed from the sampled response over the same road, and expected over random roads.

Start with `measure_run`. `record` returns the metrics as JSON; `summary` and `basis` return them as text.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.checks import Index
from models.common.errors import InputError
from models.common.printed import FEW, as_name, percent, rough, three_digits
from models.document.document import Document, Table, notes
from models.document.field import OMITTED_KEY, Detail, Field, Record
from models.document.text import ShownResult, facts
from models.kinds.links import left_out
from models.roads.iri import TRACKS, Roughness, roughness_of, why_none
from models.roads.road import Road, delays, track_width
from models.vehicle.vehicle import Vehicle
from sim.observers.results import WHEN
from sim.runs.run import Run
from sim.studies.ride.expected import (
    EXACT,
    ExpectedMetrics,
    RemainingTransient,
    expect,
    passive_settling_time,
    remaining_transient,
    settling_time,
)
from sim.studies.ride.metrics import DEGREES, angles_of, compared_metrics, measure, metrics_of
from sim.studies.ride.statistical_linearisation import Equivalent, line_words
from sim.studies.ride.statistical_linearisation import record as of_line
from synth.controller.controller import AnyController
from synth.controller.loop_of import loop_of

UNIT = "m/km"
ABOUT_IRI = "iri is a property of the road under the first wheel, defined at 80 km/h for any speed of the vehicle"
NEARLY = 0.01  # a remark is printed if the durations of a run and of its road differ by a larger share than this
SETTLED = 0.1  # no remark is needed if the relative distance of a variance from its final value is smaller than this
NO_ANGLE = 1e-9  # deg; a smaller angle is a rounding error if symmetry keeps the angle at zero


def driven_roughness(vehicle: Vehicle, road: Road, time: Array) -> tuple[Roughness, ...]:
    """Returns the international roughness index of each track, for the part of a road that a vehicle drives in a run.

    Args:
        vehicle: the vehicle.
        road: road that the vehicle drives, defined over distance or over time.
        time: sample times that begin at 0 [s], shape (T,).
    """
    return roughness_of(road, vehicle, road.speed * float(time[-1]))


def roughness(found: Sequence[Roughness]) -> dict[str, Any]:
    """Returns the international roughness indices (IRI) of a road [m/km] by name, for JSON; empty for a road without an IRI."""
    return {_name(one, found): {"unit": UNIT, "road": one.iri, "expected": one.expected, "spread": one.spread} for one in found}


def roughness_names(vehicle: Vehicle) -> tuple[str, ...]:
    """Returns the names of a road's IRIs: one for each track, or only `iri` if the vehicle has no track width."""
    return tuple(f"iri_{track}" for track in TRACKS) if track_width(vehicle) else ("iri",)


def _name(one: Roughness, roughness: Sequence[Roughness]) -> str:
    return f"iri_{one.name}" if len(roughness) > 1 else "iri"


@dataclass(frozen=True)
class MetricComparison:
    """Values of one metric of a run: in MuJoCo, in linear analysis, and as expected over random roads.

    Attributes:
        unit: SI unit of the metric.
        mujoco: value of the metric in MuJoCo; None if the run was aborted.
        sampled: value of the metric in the exact sampled response over the same road; None if the run was aborted.
        expected: expected value of the metric over all random roads with the same spectrum. `expected` is None if the road has
            no spectrum, the loop is nonlinear or unstable, or the metric has no known expected value.
        spread: standard deviation of the metric from road to road; None if this deviation is unknown.
        approximate: True if the formula for the expected value is an approximation.
    """

    unit: str
    mujoco: float | None
    sampled: float | None
    expected: float | None
    spread: float | None
    approximate: bool


MUJOCO = Field[MetricComparison]("MuJoCo", lambda one: one.mujoco, ".4g", key="mujoco")
EXPECTED_VALUE = Field[MetricComparison]("expected", lambda one: one.expected, ".4g", key="expected")
ANGLE = Field[float | None]("angle", lambda one: one if one is None or abs(one) > NO_ANGLE else 0.0, ".3g")
RIDE = Field[MetricComparison]("expected ride", lambda one: one.expected, three_digits, unit="m/s²")
SPREAD = Field[MetricComparison]("+- by road", lambda one: one.spread, ".4g", key="spread")
ERROR = Field[float]("relative error", float, ".1g")
METRIC: tuple[Field[MetricComparison], ...] = (
    Field("unit", lambda one: one.unit, key="unit"),
    MUJOCO,
    Field("sampled", lambda one: one.sampled, ".4g", key="linear"),  # files use the key "linear", see `sim.recording.run_log`
    EXPECTED_VALUE,
    SPREAD,
)


@dataclass(frozen=True, repr=False)
class RunMetrics(ShownResult):
    """All metrics of one run, with information about the expected values.

    Attributes:
        metrics: values of each metric, by name of the metric.
        settled: part of the transient that remains when the measurement begins; None for a road without a spectrum, an unstable
            loop, or a law in Python.
        error: largest relative error of the integrals from which expected values are computed; None if there are no expected
            values.
        line: linear vehicle from which the expected values are computed; None if there are no expected values.
        static: body angles in the equilibrium of the linear loop under the final loads [deg], by name. `static` is None if no
            loads act, and empty if the loop is unstable or the law is nonlinear.
    """

    metrics: Mapping[str, MetricComparison]
    settled: RemainingTransient | None
    error: float | None
    line: Equivalent | None = None
    static: Mapping[str, float] | None = None

    @property
    def summary(self) -> Document:
        """Document that lists all metrics, each with its value in MuJoCo, its value in the sampled response, and its expected
        value.
        """
        rows = {
            name: ", ".join(f"{of.label} {of.cell(one)} {one.unit}" for of in METRIC[1:4] if of.value(one) is not None)
            for name, one in self.metrics.items()
        }
        rows = {name: text or "no value, because the run ended early" for name, text in rows.items()}
        return facts(f"metrics of a run: {len(rows)}", rows)


def measured_samples(
    driven: Sequence[tuple[Vehicle, AnyController]], road: Road, duration: float, timestep: float, settle: float | None = None
) -> tuple[int, int | None]:
    """Returns the index of the first measured sample, and the index after the last measured one (None for the end of the run).

    - On a random road, the measurement begins when the transient has decayed, but no later than at half of the run. The
      transient of a law in Python is unknown, so that the measurement begins at half of the run.
    - Over a single obstacle, the measurement covers the time in which the vehicle crosses the obstacle, and is the same for all
      controllers. The measurement of an obstacle begins when the first wheel reaches the obstacle. The measurement ends when
      the passive vehicle would have settled after its last wheel left the obstacle.
    - On other roads, and if loads act, the whole run is measured.

    Args:
        driven: pairs of vehicle and controller whose metrics are compared.
        road: road on which all runs are simulated.
        duration: duration of each run [s].
        timestep: timestep of the simulation [s].
        settle: time at which the measurement on a random road begins [s]; None to choose this time as described above.

    Raises:
        InputError: `settle` is longer than half of the run, or the road is not random.
    """
    if settle is not None and (road.spectrum is None or not 0 <= settle <= duration / 2):
        allowed = f"0 to {duration / 2:g} s, half of the run" if road.spectrum is not None else "it only for a random road"
        raise InputError(f"--settle {settle:g} s is not allowed; give {allowed}")
    if road.spectrum is not None:
        slowest = max(time for _, time in settling_times(driven))
        return round((min(slowest, duration / 2) if settle is None else settle) / timestep), None
    if road.loaded or road.points is not None or not math.isfinite(road.duration):
        return 0, None
    vehicles = {id(vehicle): vehicle for vehicle, _ in driven}.values()
    settled = road.duration + max(max(delays(road, one)) + passive_settling_time(one) for one in vehicles)
    first = round(min(*road.kinks, duration / 2) / timestep)
    return first, round(settled / timestep) + 1 if settled < duration else None


def settling_times(driven: Sequence[tuple[Vehicle, AnyController]]) -> list[tuple[str, float]]:
    """Returns the name of each controller with its settling time [s]. The settling time is infinite for a law in Python."""
    return [(one.name, settling_time(car, one)) for car, one in driven]


def start_reason(driven: Sequence[tuple[Vehicle, AnyController]], start: float, duration: float) -> str:
    """Returns a clause that explains why the measurement on a random road begins at the time `start`.

    Args:
        driven: pairs of vehicle and controller whose metrics are compared.
        start: time at which the measurement begins [s].
        duration: duration of each run [s].
    """
    last, slowest = max(settling_times(driven), key=lambda one: one[1])
    if start >= duration / 2 and slowest > start:
        return f", half of the run, as {as_name(last)} settles later"
    names = {one.name for _, one in driven}
    return ", when all controllers have settled" + (f" ({as_name(last)} last)" if len(names) > 1 else "")


def measured_words(time: Array, samples: tuple[int, int | None]) -> str:
    """Returns a text that describes which part of the run was measured, from the sample times [s] and the result of
    `measured_samples`.
    """
    first, end = samples
    begins = f"from {WHEN.digits(time[first])}"
    return f"{begins} s on" if end is None else f"{begins} to {WHEN.text(time[end - 1])}, while the vehicle crosses the obstacle"


def points_end(road: Road, duration: float) -> float | None:
    """Returns the time at which the points of a road file end [s]; None if they do not end before the run.

    Args:
        road: road of the run.
        duration: duration of each run [s].
    """
    ends = road.duration
    return ends if road.points is not None and ends < duration and not math.isclose(ends, duration, rel_tol=NEARLY) else None


def end_words(road: Road, duration: float) -> str:
    """Returns a clause that states that the points of a road file end before the run; empty for other roads.

    Args:
        road: road of the run.
        duration: duration of each run [s].
    """
    ends = points_end(road, duration)
    return "" if ends is None else f"; after {rough(ends)} s, the road has no points and is straight"


def measure_run(run: Run, first: Index, end: int | None = None) -> RunMetrics:
    """Measures ride, suspension travel, road holding and actuator effort of a run.

    Args:
        run: run to measure.
        first: index of the first measured sample; 0 to measure the whole run.
        end: index of the sample after the last measured sample; None for the end of the run.

    Returns:
        Metrics by name in SI units, with the values in MuJoCo and in the exact sampled response. On a random road, the result
        also contains the expected value of each metric over all roads with the same spectrum.

    Raises:
        InputError: the measured part of the run would have fewer than two samples.

    Example:
        >>> from models import Bump, read_vehicle
        >>> from sim import measure_run, run
        >>> from synth import design_controllers
        >>> vehicle = read_vehicle("quarter_car")
        >>> [driven] = run(vehicle, design_controllers(vehicle, ["I"]), Bump(height=0.05), duration=1.0)
        >>> metric = measure_run(driven, first=0).metrics["suspension_deflection_peak"]
        >>> f"{metric.mujoco:.4f} m"
        '0.0484 m'
    """
    vehicle, road, time, timestep = run.vehicle, run.road, run.prediction.time, run.prediction.timestep
    if first >= len(time[:end]) - 1:
        raise InputError(f"first = {first} leaves fewer than two of the run's {len(time[:end])} samples; give a smaller first")
    expected: ExpectedMetrics | None = None
    transient: RemainingTransient | None = None
    controller = run.controller
    if (spectrum := road.spectrum) is not None:
        expected = expect(vehicle, controller, spectrum, timestep, (len(time) - first) * timestep)
        line = expected.line.vehicle if expected else vehicle.linearised
        transient = remaining_transient(line, controller, spectrum, timestep, float(time[first]))
    mujoco, sampled = dict[str, float](), dict[str, float]()
    if run.broke_off is None:
        with np.errstate(over="ignore", invalid="ignore"):  # the signals of an unstable loop overflow
            mujoco, sampled = (
                measure(vehicle, response, first, road.loaded, end, run.prediction.input.earlier, road.speed)
                for response in (run.physics, run.sampled)
            )
    metrics, curved = {}, expected is not None and expected.line.rounds > 0
    mean, spread = (expected.mean, expected.spread) if expected else ({}, {})
    for metric in metrics_of(vehicle, road.loaded):
        found, linear, usual, off = (of.get(metric.name) for of in (mujoco, sampled, mean, spread))
        approximate = expected is not None and (curved or metric.approximate)
        metrics[metric.name] = MetricComparison(metric.unit, found, linear, usual, off, approximate)
    static = static_angles(vehicle, controller, road, float(time[-1])) if road.loaded else None
    return RunMetrics(metrics, transient, expected and expected.error, expected and expected.line, static)


def static_angles(vehicle: Vehicle, controller: AnyController, road: Road, time: float) -> dict[str, float]:
    """Returns the body angles [deg] by name, in the equilibrium of the linear loop under constant loads.

    The result is empty if the loop is unstable or the law is nonlinear.

    Args:
        vehicle: vehicle that the controller controls.
        controller: controller of this vehicle.
        road: road whose loads act on the body.
        time: time [s] at which the road's loads are evaluated; the loads are then kept constant.
    """
    if controller.linear is False:
        return {}
    model, load = vehicle.linear_model, road.loads(vehicle, np.array([time]))[0]
    closed = loop_of(vehicle, controller).closed_loop.part(model.outputs, model.loads)
    if np.linalg.eigvals(closed.A).real.max() >= 0:
        return {}
    outputs = dict(zip(model.outputs, closed.response(np.zeros(1))[0] @ load, strict=True))
    sums = angles_of(vehicle).items()
    return {angle: DEGREES * sum(share * float(outputs.get(name, 0.0)) for name, share in parts.items()) for angle, parts in sums}


def expected_cells(run: Run, metrics: RunMetrics) -> list[dict[str, str]]:
    """Returns two rows for the table of controllers, with expected values and with standard deviations, by column heading.

    Each cell shows the value of the wheel, suspension or actuator with the largest expected value. The result is empty if there
    are no expected values.
    """
    mean, spread = {"controller": f"{run.controller.name}, expected"}, {"controller": f"{run.controller.name}, +- by road"}
    for some in compared_metrics(run.vehicle).values():
        known = [one for each in some if (one := metrics.metrics[each.name]).expected is not None]
        if known and (column := some[0].column) is not None:
            worst = max(known, key=EXPECTED_VALUE.value)
            field = Field[float](column.label, float, three_digits, column.scale, unit=column.unit)
            mean[field.title] = f"{'~' if worst.approximate and worst.expected else ''}{field.digits(worst.expected)}"
            spread[field.title] = field.digits(worst.spread)
    return [mean, spread] if len(mean) > 1 else []


def roughness_sentence(run: Run) -> str:
    """Returns a sentence with the IRIs of the driven part of a road, or with the reason why there is no IRI; empty for a flat
    road.
    """
    known = driven_roughness(run.vehicle, run.road, run.prediction.time)
    if not any(one.iri or one.expected for one in known):  # on a flat road, the IRI is 0
        return why_none(run.road)
    texts = [
        f"{_name(one, known)} {three_digits(one.iri)}"
        + (f" (expected {three_digits(one.expected)} +- {three_digits(one.spread or 0.0)})" if one.expected else "")
        for one in known
    ]
    return f"Roughness of this road [{UNIT}]: {', '.join(texts)}."


def basis(run: Run, metrics: RunMetrics) -> list[str]:
    """Returns sentences about the accuracy of the expected values, and about effects that are neglected in these values.

    If the run was aborted, the first sentence states the reason.
    """
    vehicle, said = run.vehicle, broken_off_sentence(run)
    if (settled := metrics.settled) is not None and abs(settled.share - 1) > SETTLED:
        share = percent(settled.share)
        said.append(f"When the measurement begins, the variance of {settled.signal} is {share} of its final value.")
    if metrics.error is not None:
        known = {one.accuracy: one for one in metrics_of(vehicle) if one.accuracy and one.column is not None}
        shown = [text for text, one in known.items() if metrics.metrics[one.name].expected is not None]
        said.append("; ".join([*[f"~: {', '.join(shown)}"] * bool(shown), "+-: up to 45 % too large in short runs."]))
    said += line_words(vehicle, metrics.line) if metrics.line is not None else []
    if metrics.static:
        rests = ", ".join(f"{name} {MUJOCO.digits(ANGLE.value(value))} deg" for name, value in metrics.static.items())
        said.append(f"Under the final loads, the linear loop settles at {rests}.")
        said.append("Pitch is positive nose down, and roll right side down.")
        said += [f"{lacking[0].upper()}{lacking[1:]}." for lacking in [left_out(vehicle.parameters, metrics.static)] if lacking]
    if metrics.error is None:
        return said
    if vehicle.parts.strokes or vehicle.limits.actuator_force is not None or vehicle.limits.force_rate is not None:
        said.append("Expected values are for a vehicle without bump stops and force limits.")
    if blur := vehicle.implementation.noise_text:
        said.append(f"Only MuJoCo's values include the {blur} of the measurements.")
    if metrics.error > EXACT:
        said.append(
            f"Expected values can have a relative error of {ERROR.text(min(metrics.error, 1.0))}, because a resonance is too "
            "narrow for the spectral lines of this road, or for the integral over them."
        )
    return said


def broken_off_sentence(run: Run) -> list[str]:
    """Returns a list with one sentence that states why a run was aborted; otherwise an empty list."""
    if run.broke_off is None:
        return []
    end, at = run.broke_off
    return [f"This run has no metrics: {end} at {WHEN.text(at)}."]


def summary(runs: Sequence[Run], measured: Sequence[RunMetrics]) -> Document:
    """Returns the document with the largest body angles under loads, and with the expected ride over random roads.

    The expected ride of more than `FEW` runs is shown only with `-v`.
    """
    angles = [
        {
            one.name: value
            for one in metrics_of(run.vehicle, loaded=True)
            if one.loaded and (value := of_run.metrics[one.name].mujoco) is not None
        }
        for run, of_run in zip(runs, measured, strict=True)
        if of_run.static is not None
    ]
    names, tables = max(angles, key=len, default={}), []
    if names:
        columns: tuple[Field[tuple[Run, Mapping[str, float]]], ...] = (
            Field("angles [deg]", lambda row: row[0].controller.name),
            *(ANGLE.of(lambda row, name=name: row[1].get(name), name.replace("_angle", "").replace("_", " ")) for name in names),
        )
        tables = [Table.of("angles", "Largest angles of the body.", columns, zip(runs, angles, strict=False))]
    rides = [
        [of_run.metrics[one.name] for one in compared_metrics(run.vehicle).get("ride", ())]
        for run, of_run in zip(runs, measured, strict=True)
    ]
    known = [max((one for one in some if one.expected is not None), key=EXPECTED_VALUE.value, default=None) for some in rides]
    each = [
        f"{as_name(run.controller.name)} {RIDE.cell(one)}{f' +- {RIDE.digits(one.spread)}' if one.spread is not None else ''}"
        for run, one in zip(runs, known, strict=True)
        if one is not None
    ]
    said = f"Expected ride over all such roads [m/s²], with its standard deviation between roads: {', '.join(each)}."
    unknown = [as_name(run.controller.name) for run, one in zip(runs, known, strict=True) if one is None]
    said += f" It is not computed for {', '.join(unknown)}." if unknown else ""
    detail: Detail = "normal" if len(runs) <= FEW else "full"
    return Document("", (*tables, *notes(*([said] if each else []), detail=detail)))


OF_METRIC = Record[MetricComparison](*METRIC, approximate=lambda one: one.approximate)


def record(run: Run, metrics: RunMetrics) -> dict[str, Any]:
    """Returns the metrics of a run as a JSON object."""
    broke, line = run.broke_off, metrics.line
    return Record[RunMetrics](
        broke_off=lambda _: {"by": broke[0], "at": broke[1]} if broke else None,
        settled="settled",
        expected_error="error",
        metrics=OF_METRIC.all("metrics"),
        expected_line=lambda _: of_line(run.vehicle, line) if line is not None and line.rounds else OMITTED_KEY,
        static_angles=lambda of: OMITTED_KEY if of.static is None else of.static,
    )(metrics)
