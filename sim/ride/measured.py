"""The metrics of a run: MuJoCo's, the sampled response's over the same road, those expected of all such roads; in words too."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.numbers import cell, finite, percent
from models.common.printed import table
from models.damping.laws import SemiActive
from models.own.python_law import Programmed
from models.roads.iri import Roughness
from models.roads.road import Road
from models.vehicle import Vehicle
from sim.ride.attitude import static_angles
from sim.ride.equivalent import Equivalent, line_object, line_words
from sim.ride.expected import APPROXIMATE, EXACT, Expected, expect, settling_time
from sim.ride.metrics import measure, metrics_of
from sim.ride.roughness import ABOUT_IRI, roughness_rows
from sim.ride.settled import Settled, settled
from sim.runs.run import Run
from synth.controller import Controller


@dataclass(frozen=True)
class Measured:
    """One metric of one run, thrice.

    Attributes:
        unit: SI.
        mujoco: of the physics; None where the run broke off.
        sampled: of the exact sampled response over the same road; None where the run broke off.
        expected: over all roads of this kind, from their spectrum; None where the road has none, the loop is unstable or none
            that is linear, or nobody has worked it out.
        spread: its standard deviation from road to road; None where it is not known.
        approximate: whether what is expected is.
    """

    unit: str
    mujoco: float | None
    sampled: float | None
    expected: float | None
    spread: float | None
    approximate: bool


@dataclass(frozen=True)
class RunMetrics:
    """All metrics of one run, and what they rest on.

    Attributes:
        metrics: by name.
        settled: how far a variance is from its own when measuring begins; None for roads without a spectrum, unstable loops, and
            laws in Python.
        error: what the expectations' integrals are off, relative, at most; None where there are none.
        line: the linear vehicle that is expected; None where there is no expectation.
        static: where the linear loop rests under the loads of the end, by angle [deg]; None without loads, and empty where there
            is no such loop, or no rest.
    """

    metrics: Mapping[str, Measured]
    settled: Settled | None
    error: float | None
    line: Equivalent | None = None
    static: Mapping[str, float] | None = None


def first_sample(
    vehicle: Vehicle, controllers: Sequence[Controller | Programmed | SemiActive], road: Road, duration: float, timestep: float
) -> int:
    """The sample from which is measured: when a random road's vehicle has forgotten its start, half of the run at the latest.

    How long a law in Python takes for that is not known: half of the run.
    """
    if road.spectrum is None:
        return 0
    settled = max(settling_time(vehicle, one) if isinstance(one, Controller) else math.inf for one in controllers)
    return round(min(settled, duration / 2) / timestep)


def measure_run(run: Run, first: int) -> RunMetrics:
    """The metrics of a run from sample `first` on, beside their predictions."""
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
        metric.name: Measured(
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
    """What MuJoCo's metrics have in them, and sampled and expected ones have not."""
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
    rows: list[Sequence[str] | str] = [("", "unit", "MuJoCo", "sampled", *(("expected", "+- by road") if random else ()))]
    source = ""
    if roughness:
        rows += ["road", *roughness_rows(roughness, random)]
        notes.append(ABOUT_IRI)
    for metric in metrics_of(run.vehicle, run.road.loaded):
        if metric.source != source:
            rows.append(source := metric.source)
        one = measured[metric.name]
        spread = cell(one.spread, ".4g") if one.spread is not None else ""
        expected = ("~" if one.approximate and one.expected else "") + cell(one.expected, ".4g")
        numbers = (cell(one.mujoco, ".4g"), cell(one.sampled, ".4g"))
        rows.append((f"  {metric.what}", one.unit, *numbers, *((expected, spread) if random else ())))
    return [f"  measured from {start:.4g} to {end:.4g} s", *table(rows), *(f"  {note}" for note in notes)]


def metrics_object(run: Run, found: RunMetrics) -> dict[str, Any]:
    """The same as JSON has it: None for what is infinite or does not exist."""
    broke = run.broke_off
    whole: dict[str, Any] = {
        "broke_off": {"by": broke[0], "at": broke[1]} if broke else None,
        "settled": {"share": found.settled.share, "signal": found.settled.signal} if found.settled else None,
        "expected_error": finite(found.error),
        "metrics": _metrics(found.metrics),
    }
    if found.line is not None and found.line.rounds:
        whole["expected_line"] = line_object(run.vehicle, found.line)
    if found.static is not None:
        whole["static_angles"] = dict(found.static)
    return whole


def _metrics(measured: Mapping[str, Measured]) -> dict[str, Any]:
    return {
        name: {
            "unit": one.unit,
            "mujoco": finite(one.mujoco),
            "linear": finite(one.sampled),  # in files it is called so, see `sim.recording.format`
            "expected": finite(one.expected),
            "spread": finite(one.spread),
            "approximate": one.approximate,
        }
        for name, one in measured.items()
    }
