"""The metrics of a run: MuJoCo's, the sampled response's over the same road, those expected of all such roads; in words too."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.printed import Column, cells, finite, json_object, percent, table, titles
from models.roads.iri import TRACKS, Roughness, roughness_of
from models.roads.road import Road, track_width
from models.vehicle.vehicle import Vehicle
from sim.runs.run import Run
from sim.studies.ride.expected import APPROXIMATE, EXACT, Expected, Settled, expect, settled, settling_time
from sim.studies.ride.metrics import measure, metrics_of, static_angles
from sim.studies.ride.statistical_linearisation import Equivalent, line_object, line_words
from synth.controller.controller import Controller, Driver

UNIT = "m/km"
ABOUT_IRI = "iri is of the road alone, all of it that the first wheel meets, at 80 km/h whatever the speed"


def driven_roughness(vehicle: Vehicle, road: Road, time: Array) -> tuple[Roughness, ...]:
    """Every IRI of what a vehicle drives over in a run.

    Args:
        road: of a distance, or of time.
        time: of the samples, from 0 [s], shape (T,).
    """
    return roughness_of(road, vehicle, road.speed * float(time[-1]))


def roughness_object(found: Sequence[Roughness]) -> dict[str, Any]:
    """Returns a road's IRI as JSON has it; empty for a road that has none."""
    return {_name(one, found): {"unit": UNIT, "road": one.iri, "expected": one.expected, "spread": one.spread} for one in found}


def roughness_names(vehicle: Vehicle) -> tuple[str, ...]:
    """Returns the names of the IRIs of a road under a vehicle: one per track, or a single one."""
    return tuple(f"iri_{track}" for track in TRACKS) if track_width(vehicle) else ("iri",)


def _name(one: Roughness, found: Sequence[Roughness]) -> str:
    return f"iri_{one.name}" if len(found) > 1 else "iri"


@dataclass(frozen=True)
class MetricComparison:
    """Values of one metric of one run: in physics, predicted and expected.

    Attributes:
        unit: SI.
        mujoco: of the physics, or None if the run broke off.
        sampled: of the exact sampled response over the same road, or None if the run broke off.
        expected: over all roads of this kind, from their spectrum, or None without a spectrum, a stable linear loop or a formula.
        spread: standard deviation from road to road, or None if it is unknown.
        approximate: True if the expectation is approximate.
    """

    unit: str
    mujoco: float | None
    sampled: float | None
    expected: float | None
    spread: float | None
    approximate: bool


METRIC: tuple[Column[MetricComparison], ...] = (
    Column("unit", lambda one: one.unit, key="unit"),
    Column("MuJoCo", lambda one: one.mujoco, ".4g", key="mujoco"),
    Column("sampled", lambda one: one.sampled, ".4g", key="linear"),  # in files it is called so, see `sim.recording.run_log`
    Column("expected", lambda one: one.expected, ".4g", key="expected"),
    Column("+- by road", lambda one: one.spread, ".4g", key="spread"),
)


@dataclass(frozen=True)
class RunMetrics:
    """All metrics of one run, with the basis of their expectations.

    Attributes:
        metrics: by name.
        settled: remaining transient of the variances when measuring begins, or None for roads without a spectrum, unstable loops,
            and laws in Python.
        error: largest relative error of the expectations' integrals, or None without expectations.
        line: the linear vehicle of the expectations, or None.
        static: angles of the linear loop at rest under the final loads [deg]. None without loads; empty without such a loop, or
            without a rest.
    """

    metrics: Mapping[str, MetricComparison]
    settled: Settled | None
    error: float | None
    line: Equivalent | None = None
    static: Mapping[str, float] | None = None


def first_sample(vehicle: Vehicle, controllers: Sequence[Driver], road: Road, duration: float, timestep: float) -> int:
    """The sample from which is measured: when a random road's vehicle has forgotten its start, half of the run at the latest.

    How long a law in Python takes for that is not known: half of the run.
    """
    if road.spectrum is None:
        return 0
    settled = max(settling_time(vehicle, one) if isinstance(one, Controller) else math.inf for one in controllers)
    return round(min(settled, duration / 2) / timestep)


def measure_run(run: Run, first: int) -> RunMetrics:
    """Returns the ride, travel and grip of a run: MuJoCo's, the exact response's, and those expected of all such random roads.

    Args:
        run: the run.
        first: index of the sample with which measuring begins; 0 for all of it.

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
    expected: Expected | None = None
    begun: Settled | None = None
    controller = run.controller
    if (spectrum := road.spectrum) is not None and isinstance(controller, Controller):
        expected = expect(vehicle, controller, spectrum, timestep, (len(time) - first) * timestep)
        begun = settled(
            expected.line.vehicle if expected else vehicle.straight, controller, spectrum, timestep, float(time[first])
        )
    mujoco: Mapping[str, float] = {}
    sampled: Mapping[str, float] = {}
    if run.broke_off is None:
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable loop overflows
            mujoco, sampled = (measure(vehicle, response, first, road.loaded) for response in (run.physics, run.sampled))
    metrics = {
        metric.name: MetricComparison(
            metric.unit,
            mujoco.get(metric.name),
            sampled.get(metric.name),
            expected.mean.get(metric.name) if expected else None,
            expected.spread.get(metric.name) if expected else None,
            expected is not None and (metric.name.endswith(APPROXIMATE) or expected.line.rounds > 0),
        )
        for metric in metrics_of(vehicle, road.loaded)
    }
    static = None
    if road.loaded:
        static = static_angles(vehicle, controller, road, float(time[-1])) if isinstance(controller, Controller) else {}
    return RunMetrics(metrics, begun, expected.error if expected else None, expected.line if expected else None, static)


def beside(vehicle: Vehicle) -> list[str]:
    """Describes the effects in MuJoCo's metrics that sampled and expected ones leave out."""
    lines = []
    if vehicle.limits.stops(vehicle.kind.suspensions) or vehicle.limits.actuator_force is not None:
        lines.append("sampled and expected numbers are of a vehicle without bump stops and with forces of any size")
    if blur := vehicle.implementation.blur:
        lines.append(f"MuJoCo's numbers have the {blur} of what is measured in them, sampled and expected ones have not")
    return lines


def metric_lines(run: Run, found: RunMetrics, start: float, end: float, roughness: Sequence[Roughness]) -> list[str]:
    """The metrics of a run and its road as a table, and what they rest on in sentences."""
    measured, notes = found.metrics, []
    if run.broke_off is not None:
        notes.append(f"no metrics of this run: {run.broke_off[0]} at {run.broke_off[1]:.4g} s, and what follows is no vehicle's")
    if found.settled is not None:
        notes.append(
            f"when measuring begins, the variance of {found.settled.signal} is {percent(found.settled.share)} of what it "
            "comes to; of no other signal in this table is it further off"
        )
    if found.error is not None:
        notes.append(
            "~ is approximate: mtvv to 7 %, crest to 10 %, peaks to 20 %; vdv is the fourth root of a mean; of short or lightly "
            "damped runs the +- is up to 45 % too large"
        )
    notes += line_words(run.vehicle, found.line) if found.line is not None else []
    if found.static:
        rests = ", ".join(f"{name} {value:.4g} deg" for name, value in found.static.items())
        notes.append(
            f"under the loads of the end the linear loop rests at {rests}; pitch is positive nose down, roll right side down"
        )
    notes += beside(run.vehicle)
    if found.error is not None and found.error > EXACT:
        notes.append(
            f"expected values may be off by {min(found.error, 1.0):.1g}: a resonance is too narrow for the lines of this road, "
            "or for the integral over them"
        )
    if run.broke_off is not None and not any(one.expected is not None for one in measured.values()):
        return [f"  {note}" for note in notes]
    random = any(one.expected is not None for one in measured.values())
    shown = METRIC if random else METRIC[:-2]
    rows: list[Sequence[str] | str] = [("", *titles(shown))]
    source = ""
    if roughness:
        roads = [
            (_name(one, roughness), MetricComparison(UNIT, one.iri, one.iri, one.expected, one.spread, False))
            for one in roughness
        ]
        rows += ["road", *(_row(name, one, shown) for name, one in roads)]
        notes.append(ABOUT_IRI)
    for metric in metrics_of(run.vehicle, run.road.loaded):
        if metric.source != source:
            rows.append(source := metric.source)
        rows.append(_row(metric.what, measured[metric.name], shown))
    return [f"  measured from {start:.4g} to {end:.4g} s", *table(rows), *(f"  {note}" for note in notes)]


def _row(name: str, one: MetricComparison, columns: Sequence[Column[MetricComparison]]) -> tuple[str, ...]:
    """Returns a row of the table of metrics; ~ stands before approximate values, and an unknown spread is left out."""
    said = dict(zip(titles(columns), cells(columns, [one])[0], strict=True))
    if one.approximate and one.expected:
        said["expected"] = f"~{said['expected']}"
    if one.spread is None and "+- by road" in said:
        said["+- by road"] = ""
    return f"  {name}", *said.values()


def metrics_object(run: Run, found: RunMetrics) -> dict[str, Any]:
    """The same as JSON has it: None for what is infinite or does not exist."""
    broke = run.broke_off
    whole: dict[str, Any] = {
        "broke_off": {"by": broke[0], "at": broke[1]} if broke else None,
        "settled": {"share": found.settled.share, "signal": found.settled.signal} if found.settled else None,
        "expected_error": finite(found.error),
        "metrics": {name: json_object(METRIC, one) | {"approximate": one.approximate} for name, one in found.metrics.items()},
    }
    if found.line is not None and found.line.rounds:
        whole["expected_line"] = line_object(run.vehicle, found.line)
    if found.static is not None:
        whole["static_angles"] = dict(found.static)
    return whole
