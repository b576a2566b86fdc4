"""Check of a log's command line against the log. The line is parsed as the command parses it, and never run."""

import contextlib
import io
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from models.common.errors import InputError
from models.kinds.kind import HERE
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import Vehicle, shipped
from sim.command import bump_options as bump
from sim.command import drive_options as drive
from sim.command import envelope_options as envelope
from sim.command import margins_options as margins
from sim.command import sweep_options as sweep
from sim.command.road_options import ExpectedLog, same_path
from sim.inspect.findings import FAILS, HOLDS, NOTE, Finding
from sim.inspect.log import Recorded
from sim.recording.run_log import RESULTS
from sim.recording.run_records import command_of

COMMANDS: Mapping[str, Any] = {"bump": bump, "drive": drive, "sweep": sweep, "margins": margins, "envelope": envelope}
MOST_LINE = 32_767  # characters; Windows starts no command with more, and shlex and argparse take the square of it


@dataclass(frozen=True)
class LoggedRun:
    """Data of one logged run: its name, its controller's, the implementation, the number of samples, the road."""

    name: str
    controller: Any
    implementation: Implementation
    samples: Any
    road: Any


def check_command(log: Recorded, vehicle: Vehicle, timestep: float, runs: Sequence[LoggedRun]) -> Iterator[Finding]:
    """The command, its line and the vehicle's file name, against vehicle, runs and result.

    Raises:
        InputError: the line cannot be read, or asks for what the command refuses.
    """
    line, command = log.metadata.get("command_line", ""), log.metadata.get("command", "")
    if len(line) > MOST_LINE:
        raise InputError(f"its line has {len(line)} characters, and a command's has at most {MOST_LINE}")
    if command not in RESULTS or command_of(line) != command:
        raise InputError(f"the command {command[:40]!r} and its line do not fit together; {', '.join(RESULTS)} record")
    options = _options(command, line)
    expected: ExpectedLog = COMMANDS[command].expected_log(vehicle, options)
    wrong = list(_wrong(log, expected, timestep, runs))
    source = log.metadata.get("vehicle", "")
    given = getattr(options, "vehicles", None) or (options.vehicle,)
    ships = next((one for one in given if one in shipped() and re.split(r"[\\/]", source)[-1] == f"{one}.toml"), "")
    if not ships and not any(same_path(source, one) for one in given):
        wrong.append(f"the vehicle file {', '.join(given)} is not the one that the log names")
    if options.logs is None:
        wrong.append("its line asks for no log")
    yield from (Finding("command", FAILS, text) for text in wrong)
    if wrong:
        return
    compared = "controllers, roads, samples and timestep" if expected.samples is not None else "controllers, roads and timestep"
    yield Finding("command", HOLDS, f"its line asks for the {compared} that were logged")
    if ships and (HERE / f"{ships}.toml").read_text(encoding="utf-8") != vehicle.text:
        yield Finding("command", NOTE, f"vehicle.toml is not the {ships} that ships with this version")


def _wrong(log: Recorded, expected: ExpectedLog, timestep: float, runs: Sequence[LoggedRun]) -> Iterator[str]:
    """Yields the differences between the options of the line and the log, in words."""
    names = [run.controller for run in runs]
    wanted = list(expected.controllers)
    if names != wanted and not (len(wanted) == 1 and set(names) == set(wanted)):
        yield f"its line asks for other controllers than were logged: {', '.join(wanted)}"
    if expected.timestep != timestep:
        yield f"its line asks for a timestep of {expected.timestep:g} s"
    if expected.samples is not None and any(run.samples != expected.samples for run in runs):
        yield f"its line asks for {expected.samples} samples"
    if not all(isinstance(run.road, dict) and expected.road(run.road) for run in runs):
        yield "its line asks for another road"
    if not all(expected.run(run.name, run.implementation) for run in runs):
        yield "its line asks for other runs, or another implementation of the controllers"
    result = log.result if expected.result else {}
    for key, value in expected.result.items():
        if result.get(key) != value:
            yield f"its line asks for another {key} than result.json has"


def _options(command: str, line: str) -> Any:
    """The options of a line, as the command's own parser reads them; no file is opened."""
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # --help would print
            arguments = shlex.split(line)[3:]
            return COMMANDS[command].parser().parse_args(arguments)
    except SystemExit:
        raise InputError("its line asks for help, and nothing more") from None
