"""Proof of a log: every claim is checked against the value that follows from the same log."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.common.errors import InputError
from models.laws.python_law import Programmed
from models.vehicle.vehicle import Vehicle
from sim.inspect import claims, reproduction
from sim.inspect.command_line import LoggedRun, check_command
from sim.inspect.contents import check_contents, check_whole_result
from sim.inspect.findings import FAILS, HOLDS, MISSING, NOTE, Finding
from sim.inspect.log import Recorded, RecordedRun, is_current, read_json, timestep
from sim.inspect.mcap_contents import McapContents
from sim.recording.run_log import MUJOCO, RunLog
from sim.runs.prediction import Prediction
from sim.runs.report import NO_CLAIM, NO_CLAIM_OF_SWITCHING
from sim.runs.run import Run, compare_runs
from synth.controller.controller import Controller

IN_SHORT = "who wrote it and when, with which versions"  # the first of these
UNCHECKED = (
    f"{IN_SHORT} and library, in which folders vehicle file and log lay, what a road file held "
    "before it was read, the index behind the data, which players ask, whether a controller keeps goals of its section"
)
NOT_RUN = "its text is attached and was not run: what follows is of the forces that it asked for, which are attached too"


@dataclass(frozen=True, eq=False)
class Inspected:
    """Checked run of a log.

    Attributes:
        recorded: as it was logged.
        samples: number of usable samples.
        findings: every claim.
        again: recomputed prediction, or None if that was not possible.
        run: run with the logged physics and a recomputed verdict, or None.
        made: the log that would be written now, with the logged responses, or None if the run is not whole.
    """

    recorded: RecordedRun
    samples: int
    findings: tuple[Finding, ...]
    again: Prediction | None
    run: Run | None
    made: RunLog | None = None


@dataclass(frozen=True, eq=False)
class Proof:
    """Checked log.

    Attributes:
        log: as it was read.
        vehicle: of the attached file, or None.
        timestep: [s], or NaN if it is unknown.
        findings: on the file as a whole.
        runs: its runs.
    """

    log: Recorded
    vehicle: Vehicle | None
    timestep: float
    findings: tuple[Finding, ...]
    runs: tuple[Inspected, ...]

    @property
    def holds(self) -> bool:
        """Returns True if the log still proves everything that it claims."""
        findings = [*self.findings, *(finding for run in self.runs for finding in run.findings)]
        return bool(self.runs) and all(finding.verdict in (HOLDS, NOTE) for finding in findings)


@np.errstate(all="ignore")  # an unstable loop overflows; and a log may hold any number
def prove(log: Recorded, kinds: Path | None = None) -> Proof:
    """Checks a log.

    Args:
        kinds: folder of kinds of vehicle of the user's own; see `recorded_vehicle`.
    """
    other: list[Finding] = []
    try:
        current = is_current(log)
    except InputError as error:
        other.append(Finding("format", FAILS, str(error)))
        current = True
    findings = [*_file(log.file, current), *other]
    if not log.runs:
        findings.append(Finding("runs", MISSING, "there is no run in it"))
    try:
        vehicle, h = reproduction.recorded_vehicle(log, kinds), timestep(log.metadata)
    except InputError as error:
        findings.append(Finding("vehicle", MISSING, str(error)))
        return Proof(log, None, math.nan, tuple(findings), tuple(Inspected(run, 0, (), None, None) for run in log.runs))
    findings.append(_model(log, vehicle, h))
    runs = tuple(_inspect(log, vehicle, run, h, current) for run in log.runs)
    findings += _beside(log, vehicle, h, runs, current)
    return Proof(log, vehicle, h, tuple(findings), runs)


def _file(file: McapContents, current: bool) -> list[Finding]:
    """Checks that the file is whole. Logs of the current format have all their checksums, older ones may lack some."""
    remarks = list(file.damage)
    if current and file.absent:
        remarks.append(f"{file.absent} of {file.right + file.absent} checksums not there; a run of ours writes them all")
    if remarks:
        return [Finding("file", FAILS, remark) for remark in remarks]
    sums = f"{file.right} checksums right, {file.absent} others not there" if file.absent else "every checksum right"
    return [Finding("file", HOLDS, f"{file.chunks} chunk(s), {file.messages} messages, {sums}")]


def _beside(log: Recorded, vehicle: Vehicle, h: float, runs: Sequence[Inspected], current: bool) -> Iterator[Finding]:
    """Checks the parts of a log beside its runs, and its format."""
    written, again = [run.made for run in runs if run.made], [run.again for run in runs if run.again]
    if len(written) < len(runs):
        absent = ", ".join(run.recorded.name for run in runs if not run.made)
        yield Finding("format", MISSING, f"nothing is compared that rests on all runs: {absent} could not be made again")
        return
    yield from _guarded("format", FAILS, lambda: check_contents(log, vehicle, h, written, current))
    if not current:
        yield Finding("command", NOTE, "the command line of a log older than formats is said, and not checked")
        return
    if again:
        yield from _guarded("result", FAILS, lambda: check_whole_result(log, again))
    yield from _guarded("command", FAILS, lambda: check_command(log, vehicle, h, [_held(one) for one in runs]))
    yield Finding("unchecked", NOTE, UNCHECKED)


def _held(one: Inspected) -> LoggedRun:
    """Returns the data of a run for the check of the command line."""
    assert one.again is not None, "the caller has asked"
    recorded, how = one.recorded, one.again.vehicle.implementation
    return LoggedRun(recorded.name, recorded.claims.get("name"), how, recorded.claim("samples"), recorded.claim("road"))


def _model(log: Recorded, vehicle: Vehicle, h: float) -> Finding:
    """The attached MJCF, as text. It is never loaded: it is written anew."""
    from models.common.command import versions
    from models.vehicle.mjcf import mjcf_text

    attached = log.attachments.get("model.xml")
    if attached is None:
        return Finding("model", MISSING, "model.xml is not attached")
    try:
        if attached == mjcf_text(vehicle, h).encode():
            return Finding("model", HOLDS, "model.xml is what vehicle.toml makes, to the letter")
    except (ValueError, RuntimeError) as error:
        return Finding("model", FAILS, f"vehicle.toml makes no model: {error}")
    try:
        then = read_json(log.metadata.get("versions", "{}"), "versions")
    except InputError:
        then = {}
    recorded, now = then.get("mujoco") if isinstance(then, dict) else None, versions()["mujoco"]
    if recorded != now:
        return Finding("model", NOTE, f"model.xml differs from what vehicle.toml makes now; MuJoCo was {recorded}, and is {now}")
    return Finding("model", FAILS, "model.xml is not what vehicle.toml makes")


def _inspect(log: Recorded, vehicle: Vehicle, recorded: RecordedRun, h: float, current: bool) -> Inspected:
    """Every claim of one run. A step that fails ends what rests on it, and no more."""
    findings = [Finding("responses", MISSING, remark) for remark in recorded.damage]
    samples = reproduction.usable_samples(recorded, h)
    findings += _guarded("samples", MISSING, lambda: claims.check_samples(recorded, samples, h))

    def inspected(again: Prediction | None = None, run: Run | None = None, made: RunLog | None = None) -> Inspected:
        return Inspected(recorded, samples, tuple(findings), again, run, made)

    try:
        own = reproduction.implemented(vehicle, recorded)
        if own.implementation != vehicle.implementation:
            findings.append(Finding("implementation", NOTE, f"not that of vehicle.toml: {_differing(vehicle, own)}"))
        controller = reproduction.recorded_controller(log, own, recorded)
    except (ValueError, ArithmeticError) as error:
        findings.append(Finding("controller", FAILS, str(error)))
        return inspected()
    if isinstance(controller, Controller):
        findings += _guarded("certificate", FAILS, lambda: claims.check_certificate(own, controller, recorded, h, current))
        findings += _guarded("design", FAILS, lambda: claims.check_design(vehicle, controller))
        findings += _guarded("goals", FAILS, lambda: claims.check_goals(vehicle, controller))
    else:
        said = (
            f"{NO_CLAIM.format(kind=controller.kind)}; {NOT_RUN}" if isinstance(controller, Programmed) else NO_CLAIM_OF_SWITCHING
        )
        findings.append(Finding("certificate", NOTE, said))
    if samples < reproduction.FEWEST:
        return inspected()
    try:
        again = reproduction.predicted_again(log, recorded, own, controller, samples, h)
    except (ValueError, ArithmeticError) as error:
        findings.append(Finding("road", MISSING, f"it cannot be driven again: {error}"))
        return inspected()
    findings += _guarded("linear response", MISSING, lambda: claims.check_linear(again, recorded, samples))
    try:
        response = reproduction.as_response(own, recorded, MUJOCO, samples, h, reproduction.kept(controller))
        (run,) = compare_runs([again], [response])
    except (ValueError, ArithmeticError, RuntimeError) as error:
        findings.append(Finding("physics", MISSING, str(error)))
        return inspected(again)
    whole, anew, made = _is_whole(recorded, samples), None, None
    stumbled = "it is of the whole run"
    if whole:
        try:
            run, anew = reproduction.balanced_again(run)
            made = reproduction.written_again(recorded, run, samples)
        except (ValueError, ArithmeticError, RuntimeError) as error:
            stumbled = str(error)
    findings += _guarded("physics", FAILS, lambda: claims.check_physics(recorded, run, whole))
    findings += claims.check_states(run, anew)
    if anew is not None and made is not None:
        findings += _guarded("energy", FAILS, lambda: claims.check_energy(recorded, run, anew, current))
        findings += _guarded("result", FAILS, lambda: claims.check_result(log, recorded, run, current))
    else:
        findings += [Finding(part, MISSING, stumbled) for part in ("energy", "result")]
    return inspected(again, run, made)


def _is_whole(recorded: RecordedRun, samples: int) -> bool:
    """Returns True if all samples are there; False if the claimed number cannot be read."""
    try:
        return samples == claims.claimed_samples(recorded, samples)
    except InputError:  # which `check_samples` says
        return False


def _guarded(part: str, verdict: str, check: Callable[[], Iterator[Finding]]) -> list[Finding]:
    """A check's findings; an error that stops it is one, too."""
    findings: list[Finding] = []
    try:
        findings.extend(check())
    except (ValueError, ArithmeticError) as error:
        findings.append(Finding(part, verdict, str(error)))
    return findings


def _differing(vehicle: Vehicle, own: Vehicle) -> str:
    """The implementation of a run where it is not that of the vehicle file."""
    there, here = vars(vehicle.implementation), vars(own.implementation)
    return ", ".join(f"{key} {here[key]}" for key in here if here[key] != there[key])
