"""Result of an inspection: in lines for the terminal, and as JSON."""

import json
from collections.abc import Sequence
from typing import Any

from models.common.printed import Whole, wrapped
from sim.inspect.findings import HOLDS, NOTE, Finding
from sim.inspect.proof import Inspected, Proof
from sim.runs.report import claims, controller_object, run_object, verdict
from synth.controller.controller import Controller
from synth.controller.report import law_lines, preview_lines

FEW = 2  # runs that are told with road and law where not every finding is


def proof_object(proof: Proof) -> dict[str, Any]:
    """Returns the result as in JSON: SI units, None for missing values."""
    log = proof.log
    return {
        "log": str(log.path),
        "proves": proof.holds,
        "command_line": log.metadata.get("command_line"),
        "vehicle": log.metadata.get("vehicle"),
        "vehicle_type": proof.vehicle.kind.name if proof.vehicle else None,
        "timestep": log.timestep,
        "versions": json.loads(log.metadata.get("versions", "{}")),
        "findings": [vars(finding) for finding in proof.findings],
        "runs": [_run_object(run) for run in proof.runs],
    }


def _run_object(one: Inspected) -> dict[str, Any]:
    again = one.again
    return {
        "name": one.recorded.name,
        "samples": max((len(response.times) for response in one.recorded.responses.values()), default=0),
        "findings": [vars(finding) for finding in one.findings],
        "controller": controller_object(again.run.controller) if again else None,
        "road": json.loads(one.recorded.claims.get("road", "null")),
        "again": run_object(again.run) if again else None,
    }


def proof_lines(proof: Proof, full: bool = True) -> list[str]:
    """Returns the result in lines for the terminal.

    Args:
        full: True for every finding in words, and versions and gains; else what holds is named in a line.
    """
    log, vehicle = proof.log, proof.vehicle
    about = {
        "command": log.metadata.get("command_line"),
        "vehicle": vehicle.kind.name if vehicle else "unknown",
        "from": log.metadata.get("vehicle", "a file of no name"),
        "versions": ", ".join(f"{name} {version}" for name, version in json.loads(log.metadata.get("versions", "{}")).items()),
    }
    about = about if full else {key: about[key] for key in ("command", "vehicle")}
    lines = [Whole(log.path)]
    for key, text in about.items():
        lines += wrapped(text, f"  {key:10}", 12) if text else []
    lines += _lines(proof.findings, full)
    brief = not full and len(proof.runs) > FEW
    for one in proof.runs:
        run = one.again.run if one.again else None
        if brief or run is None:
            verdict_text = f": {verdict(run)}" if run else ""
            lines += [*wrapped(f"run {one.recorded.name}{verdict_text}", hang=4), *_lines(one.findings, full)]
            continue
        time, controller = run.prediction.time, run.controller
        lines += ["", f"run {one.recorded.name}: {len(time)} samples to {time[-1]:.6g} s at {log.timestep:g} s"]
        lines += wrapped(run.road.words, f"  {'road':10}", 12)
        lines += wrapped(f"{controller.name} measures {', '.join(controller.measured) or 'nothing'}", f"  {'law':10}", 12)
        if not full:
            lines += wrapped(claims(controller), f"  {'design':10}", 12)
        if not isinstance(controller, Controller):
            lines += wrapped(controller.text, f"  {'':10}", 12)
        elif controller.measured and full:
            lines += law_lines(controller.law, f"  {'gain':10}", f"  {'':10}")
            lines += preview_lines(controller, f"  {'':10}")
        if not full:
            lines += wrapped(verdict(run), f"  {'verdict':10}", 12)
        lines += _lines(one.findings, full)
    fails = f"the log DOES NOT PROVE what it claims: {broken_text(proof)}"
    goals = any(finding.part == "goals" for one in proof.runs for finding in one.findings)
    holds = f"the log still proves what it claims{', and of goals it claims nothing' if goals else ''}"
    return [*lines, *([] if full else ["-v has every finding in words"]), "", holds if proof.holds else fails]


def broken_text(proof: Proof) -> str:
    """Returns the parts of a log of which something is not proved; empty without any."""
    broken = [f"the {name}" for name in _broken(proof.findings)]
    return ", ".join([*broken, *(f"{name} of {one.recorded.name}" for one in proof.runs for name in _broken(one.findings))])


def _lines(findings: Sequence[Finding], full: bool) -> list[str]:
    """Findings in columns, or the names of those that hold in a line and the others in columns."""
    if not full:
        held = ", ".join(dict.fromkeys(one.part for one in findings if one.verdict == HOLDS))
        others = [one for one in findings if one.verdict != HOLDS]
        return [*(wrapped(held, f"  {HOLDS:8}", 10) if held else []), *_lines(others, full=True)]
    return [line for one in findings for line in wrapped(f"{one.part}: {one.text}", f"  {one.verdict:8}", 12)]


def _broken(findings: Sequence[Finding]) -> list[str]:
    """The parts of which something is not proved, each once."""
    return list(dict.fromkeys(finding.part for finding in findings if finding.verdict not in (HOLDS, NOTE)))
