"""Ctrl-C, or another signal to end, at any time ends any command with one line and its code, and leaves nothing half-written."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from models.common.interrupt import WORDS
from tests.commands import ROOT, environment, wait_for_processor_time

FIRST = ("sim/__init__.py", "synth/__init__.py", "models/__init__.py")

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Ctrl-C as POSIX sends it")

CAMPAIGN = 'vehicles = ["quarter_car"]\ncontrollers = ["I"]\nroads = ["bump"]\nspeeds = [5.0, 10.0]\nduration = 1.0\n'
MAP = ("--vary", "height:0.02:0.2:6", "--vary", "speed:5:20:6", "--timestep", "0.004")
COMMANDS = {  # the shortest run of each that writes all that it can
    "sim.bump": ("--controller", "I", "--duration", "0.5", "--json"),
    "sim.drive": ("--controller", "I", "--duration", "1", "--json"),
    "sim.sweep": ("--controller", "passive", "--timestep", "0.004", "--logs", "logs", "--json"),
    "sim.envelope": ("--controller", "I", *MAP, "--csv", "map.csv", "--json"),
    "sim.margins": ("--controller", "I", "--timestep", "0.008", "--logs", "logs", "--json"),
    "sim.report": ("--quick", "--controller", "passive", "--timestep", "0.005", "--figures", "figures", "--json"),
    "sim.campaign": ("campaign.toml", "--json"),
    "sim.inspect": ("log.mcap", "--csv", "signals.csv", "--json"),
    "synth": ("--controller", "I", "--save", "mine.toml", "--json"),
}
ENOUGH = 120.0  # s that a command may take on a busy machine
AT_ONCE = 20.0  # s to end after Ctrl-C on a busy machine; a second on an idle one
EARLY = 6.0  # s; what comes later in a long command is more of the same
SHARES, INTERRUPTS = 1, 10  # every command at least once
BARE = 1.0  # s; Python may take as long, on a busy machine, until our first line


def prepare(folder: Path) -> None:
    """Returns what the commands read."""
    folder.mkdir()
    (folder / "campaign.toml").write_text(CAMPAIGN)


def start(command: str, folder: Path) -> subprocess.Popen:
    """A command in a process group of its own, as a terminal's."""
    arguments = [sys.executable, "-m", command, *COMMANDS[command]]
    return subprocess.Popen(
        arguments,
        cwd=folder,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def left(folder: Path) -> list[str]:
    """What lies in a folder that no command may leave: hidden or empty files, half a recording, a page without its end."""
    wrong = []
    for path in (each for each in folder.rglob("*") if each.is_file() and each.name not in (".lock", "campaign.toml")):
        ends = {".html": "</html>", ".svg": "</svg>", ".csv": "\n", ".json": "}", ".toml": "\n"}
        end = ends.get(path.suffix)
        if any(part.startswith(".") for part in path.relative_to(folder).parts) or not path.stat().st_size:
            wrong.append(f"{path.name} is left over")
        elif end and not path.read_text("utf-8").rstrip(" ").rstrip("\n" if end != "\n" else "").endswith(end):
            wrong.append(f"{path.name} is cut")
    stems = {suffix: {path.name.removesuffix(suffix) for path in folder.rglob(f"logs/*{suffix}")} for suffix in (".mcap", ".rrd")}
    if stems[".mcap"] != stems[".rrd"]:
        wrong.append("half a recording")
    return wrong


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    """A folder with a log to inspect, and what each command has of the processors there [s]."""
    folder, took = tmp_path_factory.mktemp("whole") / "folder", {}
    prepare(folder)
    for command in COMMANDS:
        before = os.times()
        process = start(command, folder)
        out, err = process.communicate(timeout=ENOUGH)
        after = os.times()
        took[command] = after.children_user + after.children_system - before.children_user - before.children_system
        assert process.returncode == 0, (command, err)
        assert isinstance(json.loads(out), dict)
        if command == "sim.bump":
            next(folder.glob("logs/bump*.mcap")).rename(folder / "log.mcap")
            for other in folder.glob("logs/*"):
                other.unlink()
    assert left(folder) == []
    return folder, took


def ours(file: str) -> bool:
    """Whether a file is the project's and not of an environment in its folder, whose finders Python imports as it starts."""
    return Path(file).is_relative_to(ROOT) and not {"site-packages", "dist-packages"} & set(Path(file).parts)


def started_by_python(err: str) -> bool:
    """Whether a traceback is of Python's own start, or of the few imports before our first statement, which asks for quiet."""
    files = re.findall(r'^  File "(.*?)", line', err, re.M)
    return (
        err.endswith("KeyboardInterrupt\n")
        and "interrupted" not in err
        and not any(ours(file) and Path(file).relative_to(ROOT).as_posix() not in FIRST for file in files)
    )


def test_what_python_imports_as_it_starts_is_not_ours():
    """The finder of an editable installation runs before any line of ours, also from an environment in our folder."""
    traceback = 'Traceback (most recent call last):\n  File "{}", line 1, in <module>\nKeyboardInterrupt\n'
    finder = ROOT / ".venv" / "lib" / "python3.11" / "site-packages" / "__editable___roadproof_finder.py"
    assert started_by_python(traceback.format(finder))
    assert started_by_python(traceback.format(ROOT / FIRST[0]))
    assert not started_by_python(traceback.format(ROOT / "synth" / "report.py"))


def interrupted(command: str, folder: Path, after: float, by: signal.Signals) -> tuple[str, bool]:
    """Returns what is wrong with a command that is told to end, in words, and whether it was; `after` is processor time [s]."""
    process = start(command, folder)
    wait_for_processor_time(process, after)
    os.killpg(process.pid, by)
    sent = time.monotonic()
    out, err = process.communicate(timeout=ENOUGH)
    wrong, ended = left(folder), time.monotonic() - sent
    lines = err.splitlines()
    if process.returncode == 128 + by:
        if (
            not lines
            or WORDS[by.name] not in lines[-1]
            or len(lines) > 2
            or not all(line.startswith("roadproof: ") for line in lines)
        ):
            wrong.append(f"says {err[-500:]!r}")
        if ended > AT_ONCE:
            wrong.append(f"ends {ended:.1f} s later")
        if out and not out.endswith("}\n"):
            wrong.append(f"prints {out[-100:]!r}")
    elif process.returncode in (-signal.SIGINT, 1) and started_by_python(err):
        pass
    elif process.returncode == -by and not err and not out and after < BARE:
        pass  # Python's own start, and nothing else handles these
    elif process.returncode != 0 or lines or not isinstance(json.loads(out), dict):
        wrong.append(f"exit code {process.returncode}, says {err[-500:]!r}")
    return (f"{command}, {by.name} after {after:.3f} s: {'; '.join(wrong)}" if wrong else ""), process.returncode != 0


@pytest.mark.attack
@pytest.mark.parametrize("share", range(SHARES))
def test_interrupts_at_random_times(share, template, tmp_path):
    """Some ten over all commands, from their start to their end."""
    whole, took = template
    rng, faults, heard = np.random.default_rng([20261121, share]), [], 0
    for number in range(INTERRUPTS):
        command = list(COMMANDS)[number % len(COMMANDS)]
        folder = tmp_path / str(number)
        prepare(folder)
        os.link(whole / "log.mcap", folder / "log.mcap")
        by = getattr(signal, str(rng.choice(["SIGINT", "SIGINT", "SIGTERM", "SIGHUP"])))
        fault, was = interrupted(command, folder, rng.uniform(0.0, min(took[command], EARLY)), by)
        faults += [fault] if fault else []
        heard += was
    assert faults == []
    assert heard > INTERRUPTS / 2  # or the times say nothing
