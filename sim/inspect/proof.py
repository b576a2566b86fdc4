"""Proof of a log: its runs are made again, and responses, certificates and claims are compared."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from models.common.errors import InputError
from models.laws.python_law import Programmed
from models.vehicle.vehicle import Vehicle
from sim.inspect import claims
from sim.inspect.findings import FAILS, HOLDS, MISSING, NOTE, Finding
from sim.inspect.log import Log, RecordedRun
from sim.inspect.replay import Replay, implemented, recorded_controller, recorded_vehicle, replay
from sim.runs.report import NO_CLAIM, NO_CLAIM_OF_SWITCHING
from synth.controller.controller import Controller

WRONG = (ValueError, ArithmeticError, TypeError, LookupError)  # what numbers and keys that are not a run's come to
NOT_RUN = "its attached text was not run: it applies the forces that the log has"


@dataclass(frozen=True, eq=False)
class Inspected:
    """A run of a log, checked.

    Attributes:
        recorded: the run in the log.
        findings: findings about every claim.
        again: the run made again, or None if that was not possible.
    """

    recorded: RecordedRun
    findings: tuple[Finding, ...]
    again: Replay | None


@dataclass(frozen=True, eq=False)
class Proof:
    """A log, checked.

    Attributes:
        log: log that was read.
        vehicle: vehicle of the attached file, or None.
        findings: findings about the file as a whole.
        runs: runs of the log.
    """

    log: Log
    vehicle: Vehicle | None
    findings: tuple[Finding, ...]
    runs: tuple[Inspected, ...]

    @property
    def holds(self) -> bool:
        """Returns True if the log proves everything that it claims."""
        findings = [*self.findings, *(finding for run in self.runs for finding in run.findings)]
        return bool(self.runs) and all(finding.verdict in (HOLDS, NOTE) for finding in findings)


@np.errstate(all="ignore")  # an unstable loop overflows
def prove(log: Log, kinds: Path | None = None) -> Proof:
    """Checks a log.

    Args:
        kinds: folder of vehicle types of the user's own; see `recorded_vehicle`.
    """
    findings = [Finding("file", HOLDS, f"{log.messages} messages, every checksum right")]
    if not log.runs:
        findings.append(Finding("runs", MISSING, "the log has no run"))
    try:
        vehicle = recorded_vehicle(log, kinds)
    except InputError as error:
        findings.append(Finding("vehicle", MISSING, str(error)))
        return Proof(log, None, tuple(findings), tuple(Inspected(run, (), None) for run in log.runs))
    return Proof(log, vehicle, tuple(findings), tuple(_inspect(log, vehicle, run) for run in log.runs))


def _inspect(log: Log, vehicle: Vehicle, recorded: RecordedRun) -> Inspected:
    """Checks every claim of one run. A step that fails ends what depends on it."""
    findings: list[Finding] = []
    try:
        own = implemented(vehicle, recorded)
        controller = recorded_controller(log, own, recorded)
    except WRONG as error:
        return Inspected(recorded, (Finding("controller", FAILS, str(error)),), None)
    if own.implementation != vehicle.implementation:
        there, here = vars(vehicle.implementation), vars(own.implementation)
        text = ", ".join(f"{key} {here[key]}" for key in here if here[key] != there[key])
        findings.append(Finding("implementation", NOTE, f"not that of vehicle.toml: {text}"))
    if isinstance(controller, Controller):
        findings += _findings("certificate", lambda: claims.check_certificate(own, controller, recorded, log.timestep))
        findings += _findings("goals", lambda: claims.check_goals(vehicle, controller))
    elif isinstance(controller, Programmed):
        findings.append(Finding("certificate", NOTE, f"{NO_CLAIM.format(kind=controller.kind)}; {NOT_RUN}"))
    else:
        findings.append(Finding("certificate", NOTE, NO_CLAIM_OF_SWITCHING))
    try:
        again = replay(log, recorded, own, controller)
    except WRONG as error:
        findings.append(Finding("responses", MISSING, f"the run cannot be made again: {error}"))
        return Inspected(recorded, tuple(findings), None)
    findings += _findings("responses", lambda: claims.check_responses(recorded, again))
    findings += _findings("claims", lambda: claims.check_claims(recorded, again))
    findings += _findings("result", lambda: claims.check_result(log, recorded, again.run))
    return Inspected(recorded, tuple(findings), again)


def _findings(part: str, check: Callable[[], Iterator[Finding]]) -> list[Finding]:
    """Returns the findings of a check; an error that stops it is one, too."""
    findings: list[Finding] = []
    try:
        findings.extend(check())
    except WRONG as error:
        findings.append(Finding(part, FAILS, str(error)))
    return findings
