"""Check of a log: repeats the runs, and compares responses, certificates and claims with those in the log."""

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from models.common.errors import InputError
from models.vehicle.limits_and_implementation import Implementation, Limits
from models.vehicle.names import logged_variant
from models.vehicle.vehicle import Vehicle
from sim.drive.response import Response
from sim.inspect.findings import FAILS, HOLDS, MISSING, NOTE, SAME, Finding, different, is_number, largest_difference, leaves
from sim.inspect.log import Log, RecordedRun
from sim.inspect.replay import (
    as_response,
    controller_states,
    recorded_controller,
    recorded_vehicle,
    replay,
    with_implementation_of,
)
from sim.observers.results import ALLOWED_DIFFERENCE, DIFFERENCE
from sim.recording.run_log import CONTINUOUS, MEASURED_TOPIC, MUJOCO, SAMPLED, WHOLE
from sim.recording.run_records import claims_of
from sim.runs.agreement import ROUNDING
from sim.runs.record import HALF_STEP, RUN
from sim.runs.report import claims, reasons
from sim.runs.run import Run
from sim.studies.ride.metrics import DEFINITIONS, LATE_WINDOW, ONE_SIDED
from synth.analysis.record import false_claims
from synth.controller.controller import Controller
from synth.controller.report import LOWER_BOUND, NORM, norm_if_implemented
from synth.controller.sampled_report import failures_of_sampled_loop, false_norm, notes_on_sampled_loop

# Key of earlier versions with the predicted effect of rounding in exported code; ignored, because the effect is now measured
PREDICTED_KEY = "rounding"
REPLAY_TOLERANCE = 1e-7  # difference that is allowed between MuJoCo runs on two machines, relative to the peak of a signal
OF_CERTIFICATE = ("certificate", "peak_frequency", "poles")  # metadata keys that `_check_certificate` checks
# exceptions that Python raises if a number or a key in a logged run is invalid
WRONG = (ValueError, ArithmeticError, TypeError, LookupError)
GOALS = "the log does not prove the controller's goals in vehicle.toml ({goals}); check the goals with roadproof synth"
EARLIER = "an earlier version with other numbers for semi-active laws wrote the log; inspect the log with that version"
NOT_RUN = "the attached law was not executed; the logged forces were applied"


@dataclass(frozen=True, eq=False)
class InspectedRun:
    """Result of the check of a logged run.

    Attributes:
        recorded_run: the checked run, as it is in the log.
        findings: findings about all claims that the log makes about the run.
        again: the repeated run; None if the run could not be repeated.
    """

    recorded_run: RecordedRun
    findings: tuple[Finding, ...]
    again: Run | None


@dataclass(frozen=True, eq=False)
class Proof:
    """Result of the check of a log.

    Attributes:
        log: the checked log.
        vehicle: vehicle that the attached vehicle file describes; None if the file cannot be read.
        findings: findings that concern the whole log, not a single run.
        runs: results of the checks of all logged runs.
    """

    log: Log
    vehicle: Vehicle | None
    findings: tuple[Finding, ...]
    runs: tuple[InspectedRun, ...]

    @property
    def broken(self) -> list[str]:
        """Names of the parts of the log with a claim that fails or is not proved, such as "certificate of I"."""
        wrong = [f"the {one.part}" for one in self.findings if not one.proved]
        wrong += [f"{one.part} of {run.recorded_run.name}" for run in self.runs for one in run.findings if not one.proved]
        return list(dict.fromkeys(wrong))

    @property
    def holds(self) -> bool:
        """True if the log contains at least one run and proves all its claims."""
        return bool(self.runs) and not self.broken


@np.errstate(all="ignore")  # the signals of an unstable loop overflow
def prove(log: Log, kinds: Path | None = None) -> Proof:
    """Checks all claims of a log.

    Args:
        log: log to check.
        kinds: folder of custom vehicle types, see `recorded_vehicle`.
    """
    findings = [Finding("file", HOLDS, f"{log.messages} messages, all checksums are correct")]
    findings += [] if log.runs else [Finding("runs", MISSING, "the log contains no run")]
    try:
        vehicle = recorded_vehicle(log, kinds)
    except InputError as error:
        findings.append(Finding("vehicle", MISSING, str(error)))
        return Proof(log, None, tuple(findings), tuple(InspectedRun(run, (), None) for run in log.runs))
    return Proof(log, vehicle, tuple(findings), tuple(_inspect(log, vehicle, run) for run in log.runs))


def _inspect(log: Log, vehicle: Vehicle, recorded: RecordedRun) -> InspectedRun:
    """Checks all claims that a log makes about one run. If a check fails, the checks that depend on its result are omitted."""
    try:
        own = with_implementation_of(vehicle, recorded)
        controller = recorded_controller(log, own, recorded)
    except WRONG as error:
        return InspectedRun(recorded, (Finding("controller", FAILS, str(error)),), None)
    findings: list[Finding] = []
    there, here = vars(vehicle.implementation), vars(own.implementation)
    if other := ", ".join(f"{key} {here[key]}" for key in here if here[key] != there[key]):
        findings.append(Finding("implementation", NOTE, f"the run differs from vehicle.toml in: {other}"))
    if controller.linear is True:
        findings += _findings("certificate", _check_certificate(own, controller, recorded, log.timestep))
        if (entry := vehicle.controllers.get(controller.name)) is not None and entry.goals is not None:
            findings.append(Finding("goals", NOTE, GOALS.format(goals=", ".join(entry.goals.record))))
    else:
        replayed = f"; {NOT_RUN}" if controller.user_code else ""
        findings.append(Finding("certificate", NOTE, f"{claims(controller)}{replayed}"))
    try:
        again, physics = replay(log, recorded, own, controller)
    except WRONG as error:
        findings.append(Finding("responses", MISSING, f"the run cannot be repeated: {error}"))
        return InspectedRun(recorded, tuple(findings), None)
    findings += _findings("responses", _check_responses(recorded, again, physics))
    if not again.prediction.is_linear and any(error is not None for error in recorded.claim("errors").values()):
        return InspectedRun(recorded, (*findings, Finding("claims", MISSING, EARLIER)), again)
    findings += _findings("claims", _check_claims(recorded, again))
    findings += _findings("result", _check_result(log, recorded, again))
    return InspectedRun(recorded, tuple(findings), again)


def _findings(part: str, check: Iterator[Finding]) -> list[Finding]:
    """Returns the findings that a check yields. If the check raises an error, the only finding is this error."""
    try:
        return list(check)
    except WRONG as error:
        return [Finding(part, FAILS, str(error))]


def _check_certificate(vehicle: Vehicle, controller: Controller, recorded: RecordedRun, h: float) -> Iterator[Finding]:
    """Checks the logged certificate against the control law and its proof, and checks the norm of the implemented
    (sampled-data) loop.

    Args:
        vehicle: vehicle with the implementation (such as sample period and delay) that the run used.
        controller: controller of the run.
        recorded: the run as it is in the log.
        h: timestep with which the run was simulated [s].
    """
    certificate, record = controller.certificate, recorded.claim("certificate")
    norm = norm_if_implemented(vehicle, controller, h)
    wrong = [*false_claims(record or {}, certificate), *false_norm(record, vehicle, lambda: norm)]
    judged = certificate.failures if controller.designed or certificate.bound is not None else ()
    wrong += failures_of_sampled_loop(vehicle, certificate, judged, norm)
    peak, there = recorded.claim("peak_frequency"), math.isfinite(certificate.norm.peak_frequency)
    if not (certificate.peaks_at(float(peak)) if there and peak is not None else peak is None and not there):
        wrong.append("the peak frequency of the norm differs from the logged frequency")
    said = np.array(recorded.claim("poles"), dtype=float).reshape(len(certificate.poles), 2)
    far = np.abs(certificate.poles[:, None] - (said[:, 0] + 1j * said[:, 1])).min(axis=0).max()
    if not far <= SAME * np.abs(certificate.poles).max():
        wrong.append("the poles of the loop differ from the logged poles")
    for text in wrong:
        yield Finding("certificate", FAILS, text)
    if wrong:
        return
    if record is None:
        yield Finding("certificate", MISSING, "the log does not contain the certificate of the controller")
        return
    sampled = f", sampled norm {NORM.digits(norm.value)}" if norm is not None and norm.stable else ""
    if not certificate.stable:
        without = notes_on_sampled_loop(vehicle, certificate, norm)
        yield Finding("certificate", HOLDS, f"{(*without, certificate.stability.words)[0]}; the log claims the same{sampled}")
        return
    below = f", lower bound {LOWER_BOUND.cell(certificate)}" if certificate.lower_bound is not None else ""
    yield Finding("certificate", HOLDS, f"stable, {claims(controller)}{below}{sampled}")


def _check_responses(recorded: RecordedRun, run: Run, physics: Response) -> Iterator[Finding]:
    """Compares the logged responses (of MuJoCo, of the sampled and of the continuous loop, including the road) with those of
    the repeated run.
    """
    states, end = controller_states(run.controller), run.broke_off[1] if run.broke_off else math.inf
    new = {MUJOCO: physics, SAMPLED: run.prediction.sampled, CONTINUOUS: run.prediction.continuous}
    new = {topic: response for topic, response in new.items() if topic == MUJOCO or not np.isnan(response.values).all()}
    wrong, worst = [], 0.0
    for topic, response in new.items():
        logged = as_response(run.vehicle, recorded, topic, run.prediction.timestep, states)
        logged = logged.only([name for name in logged.names if name in response.names])
        until = end if topic == MUJOCO else math.inf
        if len(logged.time) != len(response.time):
            yield Finding("responses", MISSING, f"{topic} has {len(logged.time)} samples instead of {len(response.time)}")
            return
        far, signal = largest_difference(logged.until(until), response.until(until))
        worst = max(worst, far)
        if not far <= (REPLAY_TOLERANCE if topic == MUJOCO else ROUNDING):
            wrong.append(f"{signal} ({topic}) differs from the repeated run by {DIFFERENCE.digits(far)} of its peak")
    for text in wrong:
        yield Finding("responses", FAILS, text)
    if not wrong:
        how = f"to {ALLOWED_DIFFERENCE.digits(worst)} of a peak" if worst else "bit for bit"
        which = ", ".join({MUJOCO: "MuJoCo", SAMPLED: "sampled", CONTINUOUS: "continuous"}[topic] for topic in new)
        yield Finding("responses", HOLDS, f"the repeated responses ({which}) equal the logged ones {how}")


def _check_claims(recorded: RecordedRun, run: Run) -> Iterator[Finding]:
    """Compares the claims of a logged run with the claims of the repeated run."""
    claims, _ = claims_of(run)
    now = json.loads(json.dumps({key: value for key, value in claims.items() if key not in OF_CERTIFICATE}))
    logged = {
        key: text if isinstance(now.get(key), str) else json.loads(text)
        for key, text in recorded.claims.items()
        if key not in OF_CERTIFICATE
    }
    # A key that did not yet exist when the log was written has its default.
    for section, default in (("limits", Limits().record), ("implementation", asdict(Implementation()))):
        if isinstance(said := logged.get(section), dict):
            logged[section] = default | said
    holds = [one.text for one in reasons(run)]
    yield from _compare_lines("claims", "the log", logged, now, "claims", holds)


def _check_result(log: Log, recorded: RecordedRun, run: Run) -> Iterator[Finding]:
    """Compares the entry of a logged run in the attached result.json with the repeated run.

    The comparison is omitted if result.json depends on runs that the log does not contain.
    """
    result, command = json.loads(log.attachments["result.json"]), log.metadata.get("command", "")
    if command not in WHOLE:
        yield Finding("result", NOTE, "result.json depends on runs that the log does not contain; it is not recomputed")
        return
    names = [f"{one['controller']['name']}{logged_variant(one.get('without', ''))}" for one in result.get("runs", [])]
    mine = [one for one, name in zip(result.get("runs", []), names, strict=True) if name == recorded.name]
    if len(mine) != 1:
        yield Finding("result", FAILS, "result.json must contain this run once")
        return
    known = (DEFINITIONS, LATE_WINDOW, *(() if run.vehicle.dampers else (ONE_SIDED,)))
    if command == "drive" and result.get("definitions") not in known:
        yield Finding("result", MISSING, "its metrics have other definitions; use the version of Roadproof that wrote the log")
        return
    now = RUN(run) | {"half_step": run.half_step and HALF_STEP(run.half_step)}
    now |= {"road": recorded.claim("road"), "timestep": run.prediction.timestep}
    said = {key: value for key, value in mine[0].items() if key not in ("vehicle", "without", PREDICTED_KEY)}
    said |= {"road": result.get("road"), "timestep": result.get("timestep")}
    if command == "drive":
        from sim.studies.ride.run_metrics import driven_roughness, measure_run, record, roughness

        h, end = log.timestep, result.get("measured_until")
        samples = round(result["measured_from"] / h), None if end is None else round(end / h) + 1
        measured, logged = record(run, measure_run(run, *samples)), mine[0].get("metrics", {})
        # Metrics that did not yet exist when the log was written are omitted
        now |= measured | {"metrics": {name: one for name, one in measured["metrics"].items() if name in logged}}
        now |= {"iri": roughness(driven_roughness(run.vehicle, run.road, run.prediction.time))}
        said |= {"iri": result.get("iri")}
    if MEASURED_TOPIC in recorded.responses:
        from sim.studies.validity.measured_log import fits, until_end

        logged = recorded.responses[MEASURED_TOPIC]
        signals = tuple(one for name in logged.names for one in run.physics.signals if one.name == name)
        measured = fits(Response(1e-9 * logged.times, signals, logged.values), until_end(run))
        now |= {"beside": {name: one.record for name, one in measured.items()}}
    now = json.loads(json.dumps(now))
    holds = f"result.json: {sum(is_number(value) for _, value in leaves(now))} numbers equal those of the repeated run"
    yield from _compare_lines("result", "result.json", said, now, "numbers of the result", [holds])


def _compare_lines(part: str, source: str, said: Any, now: Any, what: str, holds: Sequence[str]) -> Iterator[Finding]:
    """Compares logged values with recomputed values.

    Args:
        part: part of the log to which the findings belong.
        source: words that state, in the text of a finding, where the logged values come from.
        said: logged values, as a JSON value.
        now: recomputed values, as a JSON value.
        what: plural noun with which the text of a finding counts further differences.
        holds: texts of the findings that are yielded if no value differs.

    Yields:
        A finding about the first difference, with the number of further differences; if no value differs, a finding for each of
        `holds`.
    """
    wrong = list(different(said, now))
    if wrong:
        more = f" (and {len(wrong) - 1} more {what}, such as {wrong[1]})" if len(wrong) > 1 else ""
        yield Finding(part, FAILS, f"{source} differs from the repeated run: {wrong[0]}{more}")
        return
    yield from (Finding(part, HOLDS, text) for text in holds)
