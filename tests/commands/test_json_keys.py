"""The keys of `--json` are an interface: each command has those of `json_keys.txt`.

`python -m tests.commands.test_json_keys --write` writes that file again. Each of its lines is `command: path`. There `[]` is a
list, and `*` is the name of a signal, a parameter or a controller. If only some cases have a path, their names follow.
"""

import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from models.vehicle.vehicle import read_vehicle
from tests.commands.test_report_numbers import QUICK, REALITY
from tests.support import shared
from tests.support.commands import in_the_suite

FILE = Path(__file__).with_name("json_keys.txt")
CAMPAIGN = """
vehicles = ["quarter_car"]
controllers = ["passive", "I_printed"]
roads = ["iso8608:class=B", "bump:height=0.02"]
speeds = [10.0]
duration = 0.2
timestep = 5e-3
"""
VEHICLE = read_vehicle("quarter_car")
LOG = "time [s];sprung_acceleration [g]\n" + "".join(f"{0.01 * i:.2f};{i % 5}\n" for i in range(21))
FILES = {"log.csv": LOG, "campaign.toml": CAMPAIGN, "quarter_car.toml": f"{VEHICLE.text}\n{REALITY}"}
LIMITS, DAMPER = ("--vehicle", "quarter_car.toml"), ("--vehicle", "quarter_car_semi_active", "--controller", "skyhook")
ONE, STEP = ("--controller", "I"), ("--timestep", "0.005")
SHORT = (*STEP, "--duration", "0.2", "--no-logs")
LIFTS = ("--height", "0.3", "--speed", "25", *STEP, "--duration", "0.4", "--logs", "logs")  # with a log for `sim.inspect`
MAP = ("--vary", "height:0.02:0.3:2", *STEP)
CASES = {  # the cases of each command: their names and options
    "synth": {
        "plain": (),
        "limits": (*ONE, *LIMITS),
        "damper": (*ONE, *DAMPER[:2]),
        "fragility": (*ONE, "--fragility"),
        "rates": (*ONE, "--rates", "5"),
        "export": (*ONE, "--export", "ecu"),
        "check": ("--check", "quarter_car.toml"),
        "front": (*ONE, "--front", "ride:travel"),
        "goals": ("--vehicle", "quarter_car_goals"),
    },
    "sim.new": {"plain": ("car.toml", "--schema")},
    "sim.bump": {"plain": (*ONE, *LIFTS), "limits": (*ONE, *SHORT, *LIMITS), "damper": (*DAMPER, *SHORT)},
    "sim.drive": {
        "plain": (*ONE, *SHORT),
        "limits": (*ONE, *SHORT, *LIMITS),
        "damper": (*DAMPER, *SHORT),
        "measured": (*ONE, *SHORT, "--beside", "log.csv", "--beside-remove-offset"),
    },
    "sim.sweep": {"plain": (*ONE, *STEP), "limits": (*ONE, *STEP, *LIMITS)},
    "sim.margins": {"plain": (*ONE, *STEP), "limits": (*ONE, *STEP, *LIMITS)},
    "sim.envelope": {"plain": (*ONE, *MAP), "plane": (*ONE, *MAP, "--vary", "speed:10:20:2")},
    "sim.campaign": {"plain": ("campaign.toml",)},
    "sim.inspect": {"plain": ()},
    "sim.gallery": {"plain": ("textbook",)},
    "sim.report": {"plain": QUICK, "limits": (*QUICK, *LIMITS)},
}
LONG = {("synth", "front"), ("synth", "goals"), ("synth", "rates"), ("sim.sweep", "limits"), ("sim.margins", "limits")}
EVERY = [(command, case) for command, cases in CASES.items() for case in cases]
NAMES = "|".join([*VEHICLE.parameters, *(signal.name for signal in VEHICLE.kind.signals), "(?<=^gain-).*"])


def paths(found: Any, at: str = "") -> Iterator[str]:
    """Yields the path of each value of a JSON object."""
    if isinstance(found, list):
        for each in found or [None]:
            yield from paths(each, f"{at}[]")
    elif isinstance(found, dict) and found:
        for key, each in found.items():
            yield from paths(each, f"{at}.{re.sub(NAMES, '*', key.replace(' ', '_'))}")
    else:
        yield at.removeprefix(".")


def keys(command: str, case: str) -> set[str]:
    """Returns the paths that a command prints with `--json`."""
    options = CASES[command][case]
    if command == "sim.inspect":
        bump = shared.printed("sim.bump", *CASES["sim.bump"]["plain"], "--json")
        options = (str(bump.folder / bump.json["logs"]["mcap"]),)
    files = {name: text for name, text in FILES.items() if name in options}
    return set(paths(shared.printed(command, *options, *(() if "--json" in options else ("--json",)), files=files).json))


def write() -> None:
    """Writes the file."""
    lines = []
    for command, cases in CASES.items():
        found = {case: keys(command, case) for case in cases}
        for path in sorted(set().union(*found.values())):
            those = [case for case in cases if path in found[case]]
            lines.append(f"{command}: {path}" + (f"  ({' '.join(those)})" if len(those) < len(cases) else ""))
    FILE.write_text("\n".join(lines) + "\n", encoding="utf-8")


@pytest.mark.parametrize(("command", "case"), in_the_suite(set(EVERY) - LONG, EVERY))
def test_keys(command, case):
    """`--json` has the keys that it had: none is renamed, lost or added without a line in the file."""
    lines = [line.partition(": ")[2] for line in FILE.read_text(encoding="utf-8").splitlines() if line.startswith(f"{command}: ")]
    split = [line.partition("  (") for line in lines]
    assert keys(command, case) == {path for path, _, cases in split if not cases or case in cases.rstrip(")").split()}


if __name__ == "__main__" and "--write" in sys.argv:
    with tempfile.TemporaryDirectory() as folder:
        shared.keep_in(Path(folder, "made"))
        write()
