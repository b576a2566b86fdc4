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

from tests.commands.golden import CASES, VEHICLE, golden
from tests.support import shared
from tests.support.commands import in_the_suite

FILE = Path(__file__).with_name("json_keys.txt")
LONG = {("synth", "front"), ("synth", "goals"), ("synth", "rates"), ("sim.sweep", "limits"), ("sim.margins", "limits")}
LONG |= {("sim recommend", "plain"), ("sim.report", "limits")}
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
    return set(paths(golden(command, case).json))


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
