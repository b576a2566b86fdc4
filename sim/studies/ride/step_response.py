"""Metrics of the response to a step of the road: peak, overshoot, settling time, and integrals of the absolute error.

The final value of a height is the height of the step. The final value of any other signal is zero. If a law with `study = true`
measures heights, a constant force can remain after the step. If a constant force remains after the step, all signals except
velocities and accelerations can have different final values. The error of a signal is its distance from the final value. Time
is counted from the moment when the first wheel reaches the step.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.printed import as_name
from models.document.document import Block, Document, Table, notes
from models.document.field import Field, Record
from models.roads.obstacles import Step
from models.roads.road import Road
from sim.drive.response import loudest_alike
from sim.runs.run import Run
from synth.controller.loop_of import HEIGHT, with_ending

if TYPE_CHECKING:
    from sim.studies.ride.between_samples import Pieces

BAND = 2.0  # %, half the width of the band in which a signal counts as settled, unless the user gives another value
BANDS = (1e-6, 99.0)  # %, smallest and largest allowed half width of this band
# a signal counts as zero (by symmetry) if its peak is smaller than this, relative to the largest signal with the same unit
SILENT = 1e-9
SETTLED, NOT_SETTLED, NEVER_OUTSIDE = "settled", "not settled", "never outside"


@dataclass(frozen=True)
class StepMetrics:
    """Metrics of the step response of one signal.

    Attributes:
        peak: largest value of the signal in the direction of the final value. If the final value is zero, `peak` is the value
            with the largest magnitude.
        peak_time: time at which the peak occurs [s].
        overshoot: excess of the peak over the final value, relative to the final value. If the final value is zero, `overshoot`
            is the largest value of the opposite sign after the peak, relative to the peak.
        settling_time: time after which the error stays within the band until the end of the run [s]; None if there is no such
            time.
        settled: "settled"; "not settled" if the run ends outside the band; "never outside" if the error never leaves the band.
        iae: integral of the absolute error over the run [signal unit times s].
        itae: integral of time multiplied by the absolute error over the run [signal unit times s2].
    """

    peak: float
    peak_time: float
    overshoot: float
    settling_time: float | None
    settled: str
    iae: float
    itae: float


COLUMNS: tuple[Field[StepMetrics], ...] = (
    Field("peak", lambda one: one.peak, ".5g", key="peak"),
    Field("at", lambda one: one.peak_time, ".5g", key="peak_time", unit="s"),
    Field("overshoot", lambda one: one.overshoot, ".4g", 100.0, "overshoot", "%"),
    Field("settled after", lambda one: one.settled if one.settling_time is None else one.settling_time, ".5g", unit="s"),
    Field("IAE", lambda one: one.iae, ".4g", key="iae"),
    Field("ITAE", lambda one: one.itae, ".4g", key="itae"),
)


@dataclass(frozen=True)
class SignalSteps:
    """Step metrics of one signal in MuJoCo and in linear analysis.

    Attributes:
        unit: SI unit of the signal.
        final: final value of the signal after the step.
        half_band: half of the width of the settling band, in the unit of the signal.
        mujoco: metrics of the MuJoCo response, interpolated between samples; None if the run was aborted.
        sampled: metrics of the exact sampled response, interpolated between samples.
        continuous: metrics of the continuous-time linear response, exact between samples; None with semi-active dampers.
    """

    unit: str
    final: float
    half_band: float
    mujoco: StepMetrics | None
    sampled: StepMetrics | None
    continuous: StepMetrics | None


def step_of(road: Road) -> Step | None:
    """Returns the road if it is a step without loads; otherwise None."""
    return road if isinstance(road, Step) and road.height else None


def check_band(road: Road, percent: float, given: bool) -> None:
    """Checks the width of the band that defines settling times.

    Args:
        road: road of the run.
        percent: half of the width of the settling band [%].
        given: True if the user chose the width of the band; False for the default width.

    Raises:
        InputError: the width of the band is out of range, or a width is supplied although the road is not a step.
    """
    low, high = BANDS
    if not low <= percent <= high:
        raise InputError(f"--band {percent:g} % is not allowed; give {low:g} to {high:g} %")
    if given and step_of(road) is None:
        raise InputError(
            "--band applies only to the response to a step of the road, with no loads on the vehicle; give --road step and "
            "no loads, or omit --band"
        )


def step_metrics(pieces: "Pieces", final: float, height: bool, half_band: float) -> StepMetrics:
    """Returns the step metrics of a signal.

    Args:
        pieces: the signal over the run, as polynomials between the samples.
        final: final value of the signal after the step.
        height: True if the final value of the signal is not zero, for example for a height.
        half_band: half of the width of the settling band, in the unit of the signal.
    """
    error = pieces.less(final)
    if height:
        side = math.copysign(1.0, final)
        most, peak_time = pieces.times(side).largest()
        peak, overshoot = side * most, max(most - abs(final), 0.0) / abs(final)
    else:
        (up, at_up), (down, at_down) = pieces.largest(), pieces.times(-1.0).largest()
        peak, peak_time = (up, at_up) if up >= down else (-down, at_down)
        side = math.copysign(1.0, peak)
        behind = pieces.since(peak_time)
        overshoot = max(behind.times(-side).largest()[0], 0.0) / abs(peak) if peak and len(behind.start) else 0.0
    last = error.last_above(half_band)
    settled = NEVER_OUTSIDE if last is None else NOT_SETTLED if last == math.inf else SETTLED
    iae, itae = error.integral_of_size()
    return StepMetrics(peak, peak_time, overshoot, last if settled == SETTLED else None, settled, iae, itae)


@np.errstate(over="ignore", invalid="ignore")  # the signals of an unstable loop overflow
def measure_step(run: Run, percent: float = BAND, continuous: "Mapping[str, Pieces] | None" = None) -> dict[str, SignalSteps]:
    """Returns the step metrics of all output signals that move, by name.

    Args:
        run: run over a `Step`.
        percent: half of the width of the settling band [%], relative to the final value. If the final value is zero, the width
            is relative to the peak of the continuous response, or else to that of the sampled response.
        continuous: signals of the continuous-time response, exact between samples; None if they have not been computed yet.

    Raises:
        InputError: the road is not a step, or the width of the band is out of range.
    """
    step = step_of(run.road)
    check_band(run.road, percent, True)
    assert step is not None, "a band has been checked"
    model = run.vehicle.linear_model
    finals = dict(zip(model.outputs, (_lasting_outputs(run) * step.height).tolist(), strict=True))
    units = {name: run.vehicle.kind.signal(name).unit for name in model.outputs}
    peaks = np.array([run.sampled.peak(name) for name in model.outputs])
    loudest = loudest_alike(peaks, list(units.values()))
    names = tuple(name for name, silent in zip(model.outputs, peaks <= SILENT * loudest, strict=True) if not silent)
    from sim.studies.ride.between_samples import exact, interpolated_signals  # imported here because only steps need it

    routes = {
        "sampled": interpolated_signals(run, run.sampled, names),
        "continuous": exact(run, names) if continuous is None else continuous,
    }
    if run.broke_off is None:
        routes["mujoco"] = interpolated_signals(run, run.physics, names)
    edges = run.prediction.input.vertical_edges()
    metrics, start = {}, float(run.prediction.time[min(edges)]) if edges else step.start  # in MuJoCo, the road jumps at a sample
    for name in names:
        known = {route: by[name] for route, by in routes.items() if name in by and np.isfinite(by[name].values).all()}
        pieces = {route: one.counted_from(step.start if route == "continuous" else start) for route, one in known.items()}
        final = finals[name] if abs(finals[name]) > SILENT * abs(step.height) else 0.0
        if not pieces:
            continue
        whole = pieces.get("continuous") or pieces.get("sampled") or pieces["mujoco"]
        half_band = percent / 100 * (abs(final) or max(whole.largest()[0], whole.times(-1.0).largest()[0]))
        by_route = {
            route: step_metrics(pieces[route], final, bool(final), half_band) if route in pieces else None
            for route in ("mujoco", "sampled", "continuous")
        }
        metrics[name] = SignalSteps(units[name], final, half_band, **by_route)
    return metrics


def _lasting_outputs(run: Run) -> Array:
    """Returns the final values of all output signals after a step of 1 m under all wheels, shape (p,).

    For an unstable loop, the final values are computed without a control force.
    """
    model, loop = run.vehicle.linear_model, run.prediction.loop
    usual = model.Cr.sum(axis=1)
    if loop is None or not model.over_datum(run.controller.measured):
        return usual
    closed = loop.closed_loop.part(model.outputs, with_ending(model.disturbances, HEIGHT))
    if not np.linalg.eigvals(closed.A).real.max() < 0:
        return usual
    return closed.response(np.zeros(1))[0].sum(axis=1)


ROUTE = Record[StepMetrics](*COLUMNS, settling_time=lambda one: one.settling_time, settled=lambda one: one.settled)
RECORD = Record[SignalSteps](
    "unit",
    "final",
    "half_band",
    mujoco=ROUTE.all("mujoco"),
    linear=ROUTE.all("sampled"),  # files use the key "linear"
    continuous=ROUTE.all("continuous"),
)


def describe(runs: Sequence[Run], measured: Sequence[Mapping[str, SignalSteps]], percent: float) -> Document:
    """Returns the printed document about step responses.

    The first table compares the MuJoCo runs by one signal, which is a height or, if no height is available, the suspension
    travel. With `-v`, the document has an additional table of all signals for each run.

    Args:
        runs: runs over the step.
        measured: step metrics of each run, by name of the signal.
        percent: half of the width of the settling band [%].
    """
    heights = runs[0].vehicle.linear_model.heights
    common = [name for name in measured[0] if all(name in each for each in measured)] or [*measured[0]]
    one = next((name for name in common if measured[0][name].final and name in heights), common[0])
    known = [metrics.get(one) for metrics in measured]
    pairs = [(run.controller.name, each and each.mujoco) for run, each in zip(runs, known, strict=True)]
    title = f"Response to the step: {one} [{measured[0][one].unit}]"
    blocks: list[Block] = [Table.of("step", title, _columns("controller"), pairs)]
    for run, metrics in zip(runs, measured, strict=True):
        rows = [
            (f"{name} [{each.unit}]", what, by)
            for name, each in metrics.items()
            for what, by in (("MuJoCo", each.mujoco), ("sampled", each.sampled), ("exact", each.continuous))
            if by is not None
        ]
        caption = f"All signals with {as_name(run.controller.name)}."
        table = Table.of(f"step-{run.controller.name}", caption, _columns("signal", "response"), rows, 2)
        blocks.append(Document(run.controller.name, (table,), "full"))
    about = (
        "IAE is the integral of the absolute distance from the final value (unit of the signal times s). ITAE is the integral of "
        "the same distance multiplied by time (unit times s²).",
        f"A signal has settled when it stays within {percent:g} % of its final value, or of its peak if it returns to zero.",
        "Overshoot is relative to the final value. If the final value is zero, overshoot is measured on the side opposite the "
        "peak, relative to the peak.",
        "Exact values are those of the continuous linear response. Cubics interpolate MuJoCo's signals between samples.",
    )
    return Document(title, (*blocks, *notes(*about, detail="full")))


def _columns(*names: str) -> list[Field[Any]]:
    """Returns the columns of a table in which each row contains a text for each of `names`, followed by step metrics or None."""
    words = [Field[Any](name, lambda row, i=i: row[i]) for i, name in enumerate(names)]
    return [*words, *(replace(one, value=lambda row, one=one: row[-1] and one.value(row[-1])) for one in COLUMNS)]
