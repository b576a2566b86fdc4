"""Result of an inspection: in lines for the terminal, as JSON, and the signals as a table."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from models.common.errors import InputError
from models.common.printed import Whole, wrapped
from sim.inspect.findings import HOLDS, Finding
from sim.inspect.proof import Proof
from sim.inspect.replay import as_response, kept
from sim.recording.run_log import MUJOCO, SAMPLED
from sim.runs.report import controller_object, run_object, verdict
from sim.runs.signal_table import run_columns, write_columns
from synth.controller.controller import Controller
from synth.controller.report import law_lines, preview_lines


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
        "versions": log.versions,
        "findings": [vars(finding) for finding in proof.findings],
        "runs": [
            {
                "name": one.recorded.name,
                "samples": max((len(response.times) for response in one.recorded.responses.values()), default=0),
                "findings": [vars(finding) for finding in one.findings],
                "controller": controller_object(one.again.controller) if one.again else None,
                "road": json.loads(one.recorded.claims.get("road", "null")),
                "again": run_object(one.again) if one.again else None,
            }
            for one in proof.runs
        ],
    }


def proof_lines(proof: Proof, full: bool = True) -> list[str]:
    """Returns the result in lines for the terminal.

    Args:
        full: True for every finding in words, and versions and gains; else what holds is named in a line.
    """
    log, vehicle = proof.log, proof.vehicle
    about = {"command": log.metadata.get("command_line"), "vehicle": vehicle.kind.name if vehicle else "unknown"}
    if full:
        about["from"] = log.metadata.get("vehicle", "a file of no name")
        about["versions"] = ", ".join(f"{name} {version}" for name, version in log.versions.items())
    lines = [Whole(log.path)]
    for key, text in about.items():
        lines += wrapped(text, f"  {key:10}", 12) if text else []
    lines += _lines(proof.findings, full)
    for one in proof.runs:
        run, name = one.again, f"run {one.recorded.name}"
        if run is None or not full:
            lines += [*wrapped(f"{name}: {verdict(run)}" if run else name, hang=4), *_lines(one.findings, full)]
            continue
        time, controller = run.prediction.time, run.controller
        lines += ["", f"{name}: {len(time)} samples to {time[-1]:.6g} s at {log.timestep:g} s"]
        lines += wrapped(run.road.words, f"  {'road':10}", 12)
        lines += wrapped(f"{controller.name} measures {', '.join(controller.measured) or 'nothing'}", f"  {'law':10}", 12)
        if not isinstance(controller, Controller):
            lines += wrapped(controller.text, f"  {'':10}", 12)
        elif controller.measured:
            lines += law_lines(controller.law, f"  {'gain':10}", f"  {'':10}")
            lines += preview_lines(controller, f"  {'':10}")
        lines += _lines(one.findings, full)
    fails = f"the log DOES NOT PROVE what it claims: {', '.join(proof.broken)}"
    goals = any(finding.part == "goals" for one in proof.runs for finding in one.findings)
    holds = f"the log still proves what it claims{', and of goals it claims nothing' if goals else ''}"
    return [*lines, *([] if full else ["-v has every finding in words"]), "", holds if proof.holds else fails]


def short_line(proof: Proof) -> list[str]:
    """Returns a line on a log among several, and what of it is not proved."""
    if proof.holds:
        return [Whole(f"still proves    {proof.log.path}")]
    return [Whole(f"DOES NOT PROVE  {proof.log.path}"), *wrapped(", ".join(proof.broken), "  ", 4)]


def _lines(findings: Sequence[Finding], full: bool) -> list[str]:
    """Findings in columns, or the names of those that hold in a line and the others in columns."""
    if not full:
        held = ", ".join(dict.fromkeys(one.part for one in findings if one.verdict == HOLDS))
        others = [one for one in findings if one.verdict != HOLDS]
        return [*(wrapped(held, f"  {HOLDS:8}", 10) if held else []), *_lines(others, full=True)]
    return [line for one in findings for line in wrapped(f"{one.part}: {one.text}", f"  {one.verdict:8}", 12)]


def write_signals(path: Path, proof: Proof) -> None:
    """Writes the signals of all runs of a log, as `sim.bump --csv` does.

    Raises:
        InputError: the log has no signals of a known vehicle, or the file cannot be written.
    """
    if proof.vehicle is None:
        raise InputError("--csv: there are no signals of a known vehicle in the log to write; omit --csv")
    columns, longest, timestep = [], 0, proof.log.timestep
    for one in proof.runs:
        states = kept(one.again.controller) if one.again else ()
        sources = {"mujoco": MUJOCO, "sampled": SAMPLED}.items()
        responses = {source: as_response(proof.vehicle, one.recorded, name, timestep, states) for source, name in sources}
        responses |= {"recomputed": one.again.prediction.sampled} if one.again else {}
        columns += run_columns(one.recorded.name, responses)
        longest = max(longest, *(len(response.time) for response in responses.values()))
    write_columns(path, np.arange(longest) * timestep, columns)
