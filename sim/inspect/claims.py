"""Checks of a log's claims about a run, each against the value that follows from the same log."""

import json
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.printed import finite
from models.kinds.signals import is_kept
from models.laws.combinations import PREVIEW, QUADRATIC
from models.vehicle.controllers import ControllerEntry
from models.vehicle.names import logged_variant
from models.vehicle.vehicle import Vehicle
from sim.inspect.findings import (
    FAILS,
    HOLDS,
    MISSING,
    NOTE,
    SAME,
    Finding,
    count,
    different,
    equal,
    exceeds,
    largest_difference,
    merge_repeats,
)
from sim.inspect.log import Recorded, RecordedRun, read_json
from sim.inspect.reproduction import FEWEST, as_response, kept
from sim.recording.run_log import CONTINUOUS, RESULTS, SAMPLED, WHOLE
from sim.response.response import Response
from sim.runs.agreement import ROUNDING
from sim.runs.prediction import Prediction
from sim.runs.report import energy_lines, energy_object, half_step_object, run_object, verdict_lines
from sim.runs.run import Run
from sim.studies.ride.metrics import DEFINITIONS
from synth.analysis.record import false_claims, to_record
from synth.controller.controller import Controller
from synth.controller.report import failures_of_sampled_loop, false_norm, norm_if_implemented, notes_on_sampled_loop
from synth.design.full_order.quadratic import ASSUMED
from synth.vehicle.quadratic import h2_norm_of, preview_optimum, quadratic_optimum


def claimed_samples(recorded: RecordedRun, otherwise: int) -> int:
    """Returns the claimed number of samples, or `otherwise` for logs of older versions, which lack that claim."""
    said = recorded.claim("samples") if "samples" in recorded.claims else otherwise
    if isinstance(said, bool) or not isinstance(said, int):
        raise InputError("its number of samples is no number")
    return said


def check_samples(recorded: RecordedRun, samples: int, h: float) -> Iterator[Finding]:
    """Reports missing or extra samples of a run."""
    said, there = claimed_samples(recorded, samples), max((len(r.times) for r in recorded.responses.values()), default=0)
    if samples < said:
        end = f"it ends at {(samples - 1) * h:.6g} s of {(said - 1) * h:.6g} s: " if samples else ""
        yield Finding("samples", MISSING, f"{end}{said - samples} of {said} samples are missing")
    elif samples > said:
        yield Finding("samples", FAILS, f"there are {samples}, and {said} were recorded")
    if there > samples:
        yield Finding("samples", MISSING, f"up to {there - samples} more lie behind a gap; they are not compared")
    if samples < FEWEST:
        yield Finding("samples", MISSING, "too few to compare anything")


def check_certificate(
    vehicle: Vehicle, controller: Controller, recorded: RecordedRun, h: float, current: bool
) -> Iterator[Finding]:
    """The certificate, from the gain and its proof; and the norm of the loop as it was implemented."""
    certificate, record = controller.certificate, recorded.claim("certificate")
    norm = norm_if_implemented(vehicle, controller, h)
    wrong = [*false_claims(record, certificate), *false_norm(record, vehicle, lambda: norm)]
    absent = [key for key in to_record(certificate) if key not in record]
    if current and absent:
        wrong.append(f"it claims no {absent[0]}, which its proof gives")
    judged = certificate.failures if controller.designed or certificate.bound is not None else ()
    wrong += failures_of_sampled_loop(vehicle, certificate, judged, norm)
    if recorded.claim("stable") is not certificate.stable:
        wrong.append(f"the log says otherwise, but it is {certificate.stability.words}")
    for key, now in {"norm": certificate.norm.value, "bound": certificate.bound}.items():
        if not equal(recorded.claim(key), finite(now), ROUNDING, 0.0):
            wrong.append(f"its {key} is not what was claimed")
    peak, there = recorded.claim("peak_frequency"), math.isfinite(certificate.norm.peak_frequency)
    number = isinstance(peak, (int, float)) and not isinstance(peak, bool)
    if not (number and peak >= 0 and certificate.peaks_at(float(peak)) if there else peak is None):
        wrong.append("its peak frequency is not what was claimed")
    said = _matrix(recorded.claim("poles"), (len(certificate.poles), 2))
    far = np.abs(certificate.poles[:, None] - (said[:, 0] + 1j * said[:, 1])).min(axis=0).max()
    if not far <= SAME * np.abs(certificate.poles).max():
        wrong.append("its poles are not those claimed")
    for text in wrong:
        yield Finding("certificate", FAILS, text)
    if wrong:
        return
    sampled = f", sampled norm {norm.value:.7g}" if norm is not None and norm.stable else ""
    if not certificate.stable:
        without = notes_on_sampled_loop(vehicle, certificate, norm)
        yield Finding("certificate", HOLDS, f"{(*without, certificate.stability.words)[0]}; as was claimed{sampled}")
        return
    bound = f", bound {certificate.bound:.7g} by LMI (20)" if certificate.bound is not None else ""
    below = f", lower bound {certificate.lower_bound:.7g}" if certificate.lower_bound is not None else ""
    at = f" at {certificate.norm.peak_frequency:.5g} rad/s" if math.isfinite(certificate.norm.peak_frequency) else ""
    yield Finding("certificate", HOLDS, f"stable, norm {certificate.norm.value:.7g}{at}{bound}{below}{sampled}")


def check_design(vehicle: Vehicle, controller: Controller) -> Iterator[Finding]:
    """Checks that a law is its section's design, if that needs no search: the best in the mean, LQR, LQG, H2 or preview LQ.

    Laws are compared by their frequency responses around their poles, which do not depend on the coordinates of their states.

    Args:
        vehicle: of the vehicle file; for its `[implementation]` it was designed.
        controller: its law is the logged one.
    """
    entry = vehicle.controllers.get(controller.name)
    if entry is None or entry.law is not None or entry.design not in (*QUADRATIC, PREVIEW):
        return
    if entry.design == PREVIEW:
        yield _preview_design(vehicle, controller, entry)
        return
    best, design = quadratic_optimum(vehicle, entry), f'design = "{entry.design}" of vehicle.toml'
    logged, now = controller.law, best.law
    rates = np.abs(np.linalg.eigvals(now.A))
    slowest, fastest = rates[rates > 0].min(initial=1.0), rates.max(initial=1.0)
    omega = np.geomspace(0.1 * slowest, 10 * fastest, 3 * now.states + 1).tolist()
    answers = np.stack([now.response(each) for each in omega])
    far = exceeds(np.stack([logged.response(each) for each in omega]), answers) if logged.states == now.states else math.inf
    if far <= SAME:
        how = f"to {far:.0e}" if far else "to the last bit"
        yield Finding("design", HOLDS, f"it is the law that {design} comes to, {how}")
        return
    mean = h2_norm_of(vehicle, entry, controller.law) if controller.certificate.stable else math.inf
    text = f"it is not the law that {design} comes to: H2 norm {mean:.7g}, and that has {best.h2_norm:.7g}"
    # What was assumed is a share of the plant's own units, which are powers of two, and rounding may decide which.
    near = best.remark and logged.states == now.states and mean <= best.h2_norm * (1 + ASSUMED)
    yield Finding("design", NOTE, f"{text}; {best.remark}") if near else Finding("design", FAILS, text)


def _preview_design(vehicle: Vehicle, controller: Controller, entry: ControllerEntry) -> Finding:
    """Checks that feedback and preview are those that its section comes to."""
    best = preview_optimum(vehicle, entry, controller.problem(vehicle))
    far, design = exceeds(controller.law.D, best.law.D), f'design = "{PREVIEW}" of vehicle.toml'
    if controller.preview is not None and best.preview is not None:
        far = max(far, controller.preview.difference(best.preview))
    if far <= SAME:
        how = f"to {far:.0e}" if far else "to the last bit"
        return Finding("design", HOLDS, f"feedback and preview are what {design} comes to, {how}")
    return Finding("design", FAILS, f"feedback and preview are not what {design} comes to: {far:.1e} of their largest off")


def check_goals(vehicle: Vehicle, controller: Controller) -> Iterator[Finding]:
    """Notes that the log makes no claim about the controller's goals.

    Args:
        controller: its law is the logged one.
    """
    entry = vehicle.controllers.get(controller.name)
    if entry is not None and entry.goals is not None:
        goals = ", ".join(entry.goals.record)
        text = f"vehicle.toml has goals for it ({goals}), of which the log claims nothing: whether it keeps them was not checked"
        yield Finding("goals", NOTE, f"{text}; python -m synth says, of a vehicle file")


def check_linear(again: Prediction, recorded: RecordedRun, samples: int) -> Iterator[Finding]:
    """The logged sampled and continuous responses, road included, against those that follow from gain and road."""
    worst, states = 0.0, kept(again.controller)
    for topic, name, response in ((SAMPLED, "sampled", again.sampled), (CONTINUOUS, "continuous", again.continuous)):
        far, signal = largest_difference(as_response(again.vehicle, recorded, topic, samples, again.timestep, states), response)
        worst = max(worst, far)
        if not far <= ROUNDING:
            yield Finding("linear response", FAILS, f"{signal} of the {name} response is {far:.1e} of its peak off")
    if worst <= ROUNDING:
        how = f"to {worst:.0e} of a peak" if worst else "to the last bit"
        yield Finding("linear response", HOLDS, f"sampled and continuous come out as they were logged, {how}")


def check_physics(recorded: RecordedRun, run: Run, whole: bool) -> Iterator[Finding]:
    """The verdict on the logged physics against the one that was claimed."""
    wrong = []
    for wheel in run.vehicle.kind.wheels:
        for signal in (wheel.road_displacement, wheel.road_velocity):
            far = exceeds(run.physics.until(run.diverged)[signal], run.sampled.until(run.diverged)[signal])
            if not far <= ROUNDING:
                wrong.append(f"{signal} is not that of the road: {far:.1e} of its peak off")
    agreement = run.agreement
    if recorded.claim("agrees") is not agreement.agrees:
        wrong.append("the log says otherwise, but: " + verdict_lines(run)[-1])
    if whole:
        claimed = [[a, b] for a, b in agreement.lift_off]
        if not equal(recorded.claim("lift_off"), claimed, SAME, ROUNDING):
            wrong.append("the tyres are off the road at other times than claimed")
        half, said = half_step_object(run), recorded.claims.get("half_step")
        if said is not None and list(different({"half_step": read_json(said, "half_step")}, {"half_step": half}, exact=True)):
            wrong.append("what half the step changes is not what was claimed")
        now = {name: finite(signal.sampled) for name, signal in agreement.signals.items()}
        others = list(different(recorded.claim("errors"), now, exact=True))
        if others:
            wrong.append(f"the error of {merge_repeats(others, 'errors')} is not what was claimed")
    for text in wrong:
        yield Finding("physics", FAILS, text)
    if not wrong:
        yield from (Finding("physics", HOLDS, text) for text in verdict_lines(run))


def check_states(run: Run, anew: Response | None) -> Iterator[Finding]:
    """Checks the states of the law in the logged physics against those that follow from its measurements.

    Args:
        run: with the physics of the log.
        anew: the run recomputed by MuJoCo and the law, or None if it is not known.
    """
    states, logged = kept(run.controller), [signal.name for signal in run.physics.signals if is_kept(signal)]
    if not states:
        return
    if not logged:
        yield Finding("states", NOTE, "the log is older than the states of laws are logged")
    elif anew is None:
        yield Finding("states", MISSING, "they follow from the whole run")
    else:
        end = run.broke_off[1] if run.broke_off else math.inf
        far, name = largest_difference(run.physics.only(logged).until(end), anew.until(end))
        how = f"to {far:.0e} of a peak" if far else "to the last bit"
        named = logged[0] if len(logged) == 1 else f"{logged[0]} to {logged[-1]}"
        if far <= SAME:
            yield Finding("states", HOLDS, f"{named} follow from what the law measures, {how}")
        else:
            yield Finding("states", FAILS, f"{name} does not follow from what the law measures: {far:.1e} of its peak off")


def check_energy(recorded: RecordedRun, run: Run, anew: Response, current: bool) -> Iterator[Finding]:
    """The logged physics against MuJoCo's own, run anew, also where there is no analysis of it; and the energy that this has.

    A balance rests on every position and speed of the model, and the log holds signals: so it is that of the run made anew.
    """
    end = run.broke_off[1] if run.broke_off else math.inf
    vehicle = [signal.name for signal in run.vehicle.kind.signals]
    far, signal = largest_difference(run.physics.only(vehicle).until(end), anew.until(end))
    if not far <= SAME:
        yield Finding("energy", FAILS, f"MuJoCo makes another run of it now: {signal} is {far:.1e} of its peak off")
        return
    if run.energy is None or ("energy" not in recorded.claims and not current):
        yield Finding("energy", NOTE, "MuJoCo makes the same run again; the log claims no balance")
        return
    wrong = list(different(recorded.claim("energy"), energy_object(run.energy), exact=current))
    if wrong:
        yield Finding("energy", FAILS, f"its {merge_repeats(wrong, 'numbers of the balance')} is not what was claimed")
    if not wrong:
        how = f"to {far:.0e} of a peak" if far else "to the last bit"
        (balance,) = energy_lines(run)
        yield Finding("energy", HOLDS, f"MuJoCo makes the same run again, {how}; {balance}")


def check_result(log: Recorded, recorded: RecordedRun, run: Run, current: bool) -> Iterator[Finding]:
    """The attached result of the command, where it is of the logged runs alone."""
    try:
        result = log.result
    except InputError as error:
        yield Finding("result", MISSING, str(error))
        return
    command, runs = log.metadata.get("command"), result.get("runs")
    if (command in RESULTS and command not in WHOLE) or (not current and "runs" not in result):
        yield Finding("result", NOTE, "result.json rests on more runs than the log holds; it is not computed again")
        return
    if not isinstance(runs, list):
        yield Finding("result", MISSING, "the runs of result.json are no list")
        return
    mine = [one for one in runs if isinstance(one, dict) and logged_as(one) == recorded.name]
    if len(mine) != 1:
        yield Finding("result", FAILS, "result.json does not have this run once")
        return
    logged = {one.name for one in log.runs}
    if any(not isinstance(one, dict) or logged_as(one) not in logged for one in runs):
        yield Finding("result", MISSING, "result.json has runs that the log does not hold")
        return
    now: dict[str, Any] = json.loads(json.dumps(run_object(run) | {"half_step": half_step_object(run)}))
    now["road"], now["timestep"] = recorded.claim("road"), run.prediction.timestep
    said = {key: value for key, value in mine[0].items() if key not in ("vehicle", "without")}
    said |= {"road": result.get("road"), "timestep": result.get("timestep")}
    measured = "metrics" in said or (current and command == "drive")
    if measured and result.get("definitions") == DEFINITIONS:
        now |= json.loads(json.dumps(_metrics(run, result.get("measured_from"), result.get("measured_until"))))
    elif measured:
        text = "its metrics are of other definitions than this version's; the version that wrote the log computes them again"
        yield Finding("result", MISSING, text)
        return
    wrong = list(different(said, now, exact=current))
    if wrong:
        yield Finding("result", FAILS, f"result.json says otherwise: {merge_repeats(wrong, 'numbers of the result')}")
    else:
        yield Finding("result", HOLDS, f"result.json: {count(now)} numbers as computed again")


def _metrics(run: Run, start: Any, end: Any) -> dict[str, Any]:
    """Ride metrics, and what they rest on, between the samples at which the log says that measuring began and ended."""
    from sim.studies.ride.run_metrics import measure_run, metrics_object

    last, h = float(run.physics.time[-1]), run.prediction.timestep
    until = last if end is None else end
    if (
        any(isinstance(one, bool) or not isinstance(one, (int, float)) for one in (start, until))
        or not 0 <= start < until <= last
    ):
        raise InputError("result.json does not say from when, or until when, its metrics were measured")
    return metrics_object(run, measure_run(run, round(start / h), None if end is None else round(end / h) + 1))


def _matrix(value: Any, shape: tuple[int, int]) -> Array:
    try:
        return np.array(value, dtype=float).reshape(shape)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"not {shape[0]} x {shape[1]} numbers") from None


def logged_as(one: Mapping[str, Any]) -> str | None:
    """Returns the name in the log of a run of the result; None of a run without a controller's name."""
    controller = one.get("controller")
    name = controller.get("name") if isinstance(controller, dict) else None
    return f"{name}{logged_variant(str(one.get('without', '')))}" if isinstance(name, str) else None
