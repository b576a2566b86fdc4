"""`python -m sim.inspect`: what logs are, and whether they still prove what they claim; each from the log alone."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from models.common.command import Parser, complain, run_command
from models.common.errors import InputError
from models.common.printed import Whole, say, wrapped
from models.figures.outputs import check_outputs
from sim.inspect.findings import HOLDS, NOTE, Finding
from sim.inspect.log import Recorded, RecordedRun, read_json, read_log
from sim.inspect.proof import Inspected, Proof, prove
from sim.inspect.table import write_signals
from sim.runs.words import controller_object, law_text, run_object
from synth.controller import Controller
from synth.words import law_lines

LONGEST = 400  # characters of a text from a log on the terminal

EPILOG = """
exit code: 0 the log still proves what it claims, 1 it does not, and the text says where, 2 bad input; of several logs the worst

The log is not trusted: nothing in it is run, loaded or used as a path. What it cannot show is who wrote it.

examples:
  python -m sim.inspect logs/bump-quarter_car-I-20261121T072417Z.mcap
  python -m sim.inspect logs/*.mcap
  python -m sim.inspect LOG.mcap --csv signals.csv
  python -m sim.inspect LOG.mcap --json
  python -m sim.inspect hopper.mcap --kinds my_vehicles
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options, or a single file that is no log of ours.
    """
    options = _parser().parse_args(arguments)
    if options.kinds is not None and not options.kinds.is_dir():
        raise InputError(f"kinds {options.kinds}: there is no such folder; give one with the .py and .xml of a kind of vehicle")
    if len(options.logs) > 1:
        if options.csv is not None:
            raise InputError(
                f"--csv writes the signals of one log, and {len(options.logs)} were named; give one, or leave it out"
            )
        return _several(options.logs, options.kinds, options.json)
    (path,) = options.logs
    kinds = [file for ending in ("py", "xml") for file in options.kinds.glob(f"*.{ending}")] if options.kinds is not None else []
    check_outputs({"csv": options.csv}, [path, *kinds], options.json)
    log = read_log(path)
    proof = prove(log, options.kinds)
    if options.csv is not None:
        write_signals(options.csv, proof)
    if options.json:
        print(json.dumps(proof_object(proof) | {"csv": str(options.csv) if options.csv else None}, allow_nan=False))
    else:
        csv = ["csv", Whole(f"  {options.csv}"), ""] if options.csv is not None else []
        say([*csv, *_text(proof)])
    return 0 if proof.holds else 1


def _several(paths: Sequence[Path], kinds: Path | None, as_json: bool) -> int:
    """Inspects logs in turn, and keeps none; a file that is no log is said, and the others are inspected all the same.

    Returns:
        The worst exit code.
    """
    objects, code = [], 0
    for path in paths:
        try:
            proof = prove(read_log(path), kinds)
        except InputError as error:
            code = 2
            objects.append({"log": str(path), "proves": False, "error": str(error)})
            complain(str(error))
            continue
        code = max(code, 0 if proof.holds else 1)
        objects.append(proof_object(proof))
        if not as_json:
            say([*_text(proof), ""])
    hold = sum(one["proves"] for one in objects)
    if as_json:
        print(json.dumps({"logs": objects, "proves": hold == len(paths)}, allow_nan=False))
    else:
        print(f"{hold} of {len(paths)} logs still prove{'s' * (hold == 1)} what {'it claims' if hold == 1 else 'they claim'}")
    return code


def proof_object(proof: Proof) -> dict[str, Any]:
    """What was found, as JSON has it: SI units, None for what does not exist."""
    log = proof.log
    return {
        "log": str(log.path),
        "proves": proof.holds,
        "command_line": log.metadata.get("command_line"),
        "vehicle": log.metadata.get("vehicle"),
        "vehicle_type": proof.vehicle.kind.name if proof.vehicle else None,
        "timestep": proof.timestep if math.isfinite(proof.timestep) else None,
        "versions": _versions(log),
        "findings": [vars(finding) for finding in proof.findings],
        "runs": [_run_object(run) for run in proof.runs],
    }


def _run_object(one: Inspected) -> dict[str, Any]:
    again = one.again
    return {
        "name": one.recorded.name,
        "samples": one.samples,
        "findings": [vars(finding) for finding in one.findings],
        "controller": controller_object(again.controller) if again else None,
        "road": _road(one.recorded),
        "again": run_object(one.run) if one.run else None,
    }


def _text(proof: Proof) -> list[str]:
    log, vehicle = proof.log, proof.vehicle
    about = {
        "command": log.metadata.get("command_line"),
        "vehicle": vehicle.kind.name if vehicle else "unknown",
        "from": log.metadata.get("vehicle", "a file of no name"),
        "versions": ", ".join(f"{name} {version}" for name, version in _versions(log).items()),
    }
    lines = [Whole(log.path)]
    for key, text in about.items():
        lines += wrapped(_shown(text), f"  {key:10}", 12) if text else []
    lines += _lines(proof.findings)
    for one in proof.runs:
        end = f" to {(one.samples - 1) * proof.timestep:.6g} s at {proof.timestep:g} s" if one.samples else ""
        lines += ["", f"run {one.recorded.name}: {one.samples} samples{end}"]
        if one.again:
            controller = one.again.controller
            lines += wrapped(_shown(one.again.road.words), f"  {'road':10}", 12)
            lines += wrapped(f"{controller.name} measures {', '.join(controller.measured) or 'nothing'}", f"  {'law':10}", 12)
            if not isinstance(controller, Controller):
                lines += wrapped(_shown(law_text(controller)), f"  {'':10}", 12)
            elif controller.measured:
                lines += law_lines(controller.law, f"  {'gain':10}", f"  {'':10}")
        lines += _lines(one.findings)
    broken = [f"the {name}" for name in _broken(proof.findings)]
    broken += [f"{name} of {one.recorded.name}" for one in proof.runs for name in _broken(one.findings)]
    fails = f"the log DOES NOT PROVE what it claims: {', '.join(broken)}"
    goals = any(finding.part == "goals" for one in proof.runs for finding in one.findings)
    holds = f"the log still proves what it claims{', and of goals it claims nothing' if goals else ''}"
    return [*lines, "", holds if proof.holds else fails]


def _lines(findings: Sequence[Finding]) -> list[str]:
    """Findings in columns."""
    return [line for one in findings for line in wrapped(f"{one.part}: {_shown(one.text)}", f"  {one.verdict:8}", 12)]


def _broken(findings: Sequence[Finding]) -> list[str]:
    """The parts of which something is not proved, each once."""
    return list(dict.fromkeys(finding.part for finding in findings if finding.verdict not in (HOLDS, NOTE)))


def _road(recorded: RecordedRun) -> dict[str, Any] | None:
    """The description of a run's road; None where there is none."""
    try:
        road = recorded.claim("road")
    except InputError:
        return None
    return road if isinstance(road, dict) else None


def _versions(log: Recorded) -> dict[str, str]:
    """What the log was written with."""
    try:
        found = read_json(log.metadata.get("versions", "{}"), "versions")
    except InputError:
        return {}
    return {str(name): str(version) for name, version in found.items()} if isinstance(found, dict) else {}


def _shown(text: str) -> str:
    """Text from a log as a terminal may have it: on one line, without what would steer the terminal, and not endless."""
    short = text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in short)


def _parser() -> Parser:
    parser = Parser(
        "sim.inspect",
        "Says what logs are, and by computing it anew from what each holds, whether it still proves what it claims.",
        EPILOG,
    )
    parser.add_argument("logs", type=Path, nargs="+", metavar="LOG", help="an .mcap file that a run has written; several in turn")
    parser.add_argument(
        "--csv", type=Path, metavar="FILE", help="write MuJoCo's, the logged and the recomputed signals of one log"
    )
    parser.add_argument(
        "--kinds", type=Path, metavar="DIR", help="folder of a kind of vehicle of your own; its Python is run (default: none)"
    )
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object and nothing else; of several logs {logs, proves}"
    )
    return parser


if __name__ == "__main__":
    run_command(main)
