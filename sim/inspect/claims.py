"""Checks of a log's claims about a run, each against the value that follows from the same log."""

import json
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

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
    largest_difference,
    merge_repeats,
)
from sim.inspect.log import Log, RecordedRun, read_json
from sim.inspect.replay import Replay, as_response, kept
from sim.recording.run_log import CONTINUOUS, MUJOCO, SAMPLED, WHOLE
from sim.recording.run_records import claims_of
from sim.runs.agreement import ROUNDING
from sim.runs.report import energy_lines, half_step_object, run_object, verdict_lines
from sim.runs.run import Run
from sim.studies.ride.metrics import DEFINITIONS
from synth.analysis.record import false_claims
from synth.controller.controller import Controller
from synth.controller.report import failures_of_sampled_loop, false_norm, norm_if_implemented, notes_on_sampled_loop

PREDICTED = "rounding"  # of exported code, in results of earlier versions: it is measured now
REPLAYED = 1e-7  # of a signal's peak: how far MuJoCo's new run on another machine may be from the logged one
OF_CERTIFICATE = ("certificate", "peak_frequency", "poles")  # claims that `check_certificate` checks


def check_certificate(vehicle: Vehicle, controller: Controller, recorded: RecordedRun, h: float) -> Iterator[Finding]:
    """Checks the certificate from the law and its proof, and the norm of the loop as implemented.

    Args:
        h: timestep of the run [s].
    """
    certificate, record = controller.certificate, recorded.claim("certificate")
    norm = norm_if_implemented(vehicle, controller, h)
    wrong = [*false_claims(record, certificate), *false_norm(record, vehicle, lambda: norm)]
    judged = certificate.failures if controller.designed or certificate.bound is not None else ()
    wrong += failures_of_sampled_loop(vehicle, certificate, judged, norm)
    peak, there = recorded.claim("peak_frequency"), math.isfinite(certificate.norm.peak_frequency)
    if not (certificate.peaks_at(float(peak)) if there and peak is not None else peak is None and not there):
        wrong.append("its peak frequency is not what was claimed")
    said = np.array(recorded.claim("poles"), dtype=float).reshape(len(certificate.poles), 2)
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


def check_goals(vehicle: Vehicle, controller: Controller) -> Iterator[Finding]:
    """Notes that the log makes no claim about the controller's goals.

    Args:
        controller: controller with the law from the log.
    """
    entry = vehicle.controllers.get(controller.name)
    if entry is not None and entry.goals is not None:
        goals = ", ".join(entry.goals.record)
        text = f"vehicle.toml has goals for it ({goals}), of which the log claims nothing: whether it keeps them was not checked"
        yield Finding("goals", NOTE, f"{text}; python -m synth says, of a vehicle file")


def check_responses(recorded: RecordedRun, replay: Replay) -> Iterator[Finding]:
    """Compares the logged responses with the new ones: MuJoCo's, the sampled and the continuous one, road included."""
    run, states = replay.run, kept(replay.run.controller)
    end = run.broke_off[1] if run.broke_off else math.inf
    new = {MUJOCO: replay.physics, SAMPLED: run.prediction.sampled, CONTINUOUS: run.prediction.continuous}
    wrong, worst = [], 0.0
    for topic, response in new.items():
        logged, until = as_response(run.vehicle, recorded, topic, run.prediction.timestep, states), math.inf
        if topic == MUJOCO:
            logged, until = logged.only([name for name in logged.names if name in response.names]), end
        if len(logged.time) != len(response.time):
            yield Finding("responses", MISSING, f"{topic} has {len(logged.time)} samples of {len(response.time)}")
            return
        far, signal = largest_difference(logged.until(until), response.until(until))
        worst = max(worst, far)
        if not far <= (REPLAYED if topic == MUJOCO else ROUNDING):
            wrong.append(f"{signal} of the {topic} response is {far:.1e} of its peak off")
    for text in wrong:
        yield Finding("responses", FAILS, text)
    if not wrong:
        how = f"to {worst:.0e} of a peak" if worst else "to the last bit"
        yield Finding("responses", HOLDS, f"MuJoCo's, sampled and continuous come out as they were logged, {how}")


def check_claims(recorded: RecordedRun, replay: Replay) -> Iterator[Finding]:
    """Compares the claims of a run with those that its replay makes."""
    run = replay.run
    claims, _ = claims_of(run)
    now = json.loads(json.dumps({key: value for key, value in claims.items() if key not in OF_CERTIFICATE}))
    texts = {key for key, value in claims.items() if isinstance(value, str)}
    logged = {
        key: value if key in texts else read_json(value, key)
        for key, value in recorded.claims.items()
        if key not in OF_CERTIFICATE
    }
    wrong = list(different(logged, now))
    if wrong:
        yield Finding("claims", FAILS, f"the log says otherwise: {merge_repeats(wrong, 'claims')}")
        return
    yield from (Finding("claims", HOLDS, text) for text in verdict_lines(run))
    yield from (Finding("claims", HOLDS, text) for text in energy_lines(run))


def check_result(log: Log, recorded: RecordedRun, run: Run) -> Iterator[Finding]:
    """Compares this run in the attached result of the command, if the result is of the logged runs alone."""
    result, command = log.result, log.metadata.get("command", "")
    if command not in WHOLE:
        yield Finding("result", NOTE, "result.json needs more runs than the log has; it is not computed again")
        return
    mine = [one for one in result.get("runs", []) if logged_as(one) == recorded.name]
    if len(mine) != 1:
        yield Finding("result", FAILS, "result.json does not have this run once")
        return
    now: dict[str, Any] = json.loads(json.dumps(run_object(run) | {"half_step": half_step_object(run)}))
    now |= {"road": recorded.claim("road"), "timestep": run.prediction.timestep}
    said = {key: value for key, value in mine[0].items() if key not in ("vehicle", "without", PREDICTED)}
    said |= {"road": result.get("road"), "timestep": result.get("timestep")}
    if command == "drive":
        if result.get("definitions") != DEFINITIONS:
            yield Finding(
                "result", MISSING, "its metrics are of other definitions; the version that wrote the log computes them again"
            )
            return
        now |= json.loads(json.dumps(_metrics(run, result["measured_from"], result.get("measured_until"))))
    wrong = list(different(said, now))
    if wrong:
        yield Finding("result", FAILS, f"result.json says otherwise: {merge_repeats(wrong, 'numbers of the result')}")
    else:
        yield Finding("result", HOLDS, f"result.json: {count(now)} numbers as computed again")


def _metrics(run: Run, start: float, end: float | None) -> dict[str, Any]:
    """Returns ride metrics, and what they rest on, between the times at which measuring began and ended in the log [s]."""
    from sim.studies.ride.run_metrics import measure_run, metrics_object

    h = run.prediction.timestep
    return metrics_object(run, measure_run(run, round(start / h), None if end is None else round(end / h) + 1))


def logged_as(one: Mapping[str, Any]) -> str:
    """Returns the name in the log of a run of the result."""
    return f"{one['controller']['name']}{logged_variant(one.get('without', ''))}"
