"""Returns True if two checkouts say the same numbers, to the last bit: `python -m tests.same_numbers OLD NEW`.

For changes that move code and are to change nothing. Every command runs in both with `--json`; logs that the old one wrote are
inspected by the new one. Exit code 0: all the same. 1: what differs is listed, by command and place in the object.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

CAMPAIGN = """
vehicles = ["quarter_car"]
controllers = ["passive", "I"]
roads = ["bump", "iso8608:class=C"]
speeds = [10.0]
seeds = 2
duration = 2.0
settle = 1.0
"""
COMMANDS = (
    ("synth",),
    ("synth", "--vehicle", "half_car"),
    ("synth", "--vehicle", "full_car"),
    ("synth", "--controller", "II", "--refine"),
    ("sim.bump", "--controller", "all"),
    ("sim.bump", "--controller", "I", "--height", "0.5"),
    ("sim.bump", "--controller", "all", "--vehicle", "half_car"),
    ("sim.bump", "--controller", "I", "--vehicle", "full_car", "--track", "left"),
    ("sim.drive", "--controller", "all", "--duration", "5"),
    ("sim.drive", "--controller", "I", "--vehicle", "full_car", "--duration", "2", "--class", "E"),
    ("sim.sweep", "--controller", "I", "--logs", "logs"),
    ("sim.margins", "--controller", "II", "--logs", "logs"),
    ("sim.envelope", "--controller", "I", "--vary", "height:0.02:0.4:5", "--vary", "speed:5:20:5", "--logs", "logs"),
    ("sim.campaign", "campaign.toml"),
    ("sim.report", "--quick"),
)
BAD_INPUT = 2
ELSEWHERE = {"logs", "seconds", "report", "results", "folder", "source"}  # keys of paths and times


def said(checkout: Path, folder: Path, command: tuple[str, ...]) -> tuple[int, Any]:
    """Exit code and JSON object of a command."""
    arguments = [sys.executable, "-m", *command, "--json"]
    environment = os.environ | {"PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(arguments, cwd=folder, env=environment, capture_output=True, text=True)
    return done.returncode, json.loads(done.stdout) if done.stdout else done.stderr


def differences(old: Any, new: Any, place: str = "") -> Iterator[str]:
    """If two objects differ."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in old.keys() | new.keys():
            if key not in ELSEWHERE:
                yield from differences(old.get(key), new.get(key), f"{place}.{key}")
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for i, pair in enumerate(zip(old, new, strict=True)):
            yield from differences(*pair, f"{place}[{i}]")
    elif old != new:
        yield f"{place}: {str(old)[:60]} is now {str(new)[:60]}"


def main() -> int:
    """Compares; returns the exit code."""
    old, new = (Path(path).resolve() for path in sys.argv[1:])
    code = 0
    with tempfile.TemporaryDirectory() as temporary:
        folders = [Path(temporary, name) for name in ("old", "new")]
        for folder in folders:
            folder.mkdir()
            (folder / "campaign.toml").write_text(CAMPAIGN)
        for command in COMMANDS:
            answers = [said(checkout, folder, command) for checkout, folder in zip((old, new), folders, strict=True)]
            found = [str(text) for text in differences([*answers[0]], [*answers[1]])]
            if answers[0][0] == BAD_INPUT:  # nothing was compared
                found.insert(0, f"the old one refuses it: {answers[0][1]}")
            print(f"{'DIFFERS' if found else 'same':8}{' '.join(command)}", *found[:5], sep="\n    ", flush=True)
            code |= bool(found)
        for log in sorted(folders[0].glob("logs/*.mcap")):
            status, _ = said(new, folders[1], ("sim.inspect", str(log)))
            print(f"{'proved' if status == 0 else 'NOT PROVED':12}{log.name}", flush=True)
            code |= status != 0
    return code


if __name__ == "__main__":
    sys.exit(main())
