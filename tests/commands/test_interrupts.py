"""The ends of a command: bad input, Ctrl-C, a reader that has gone, an error of ours; each is one line and an exit code."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.support.commands import ROOT, environment, wait_for_processor_time

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Ctrl-C as POSIX sends it")

ENDS = [  # how `main` ends, the exit code, and stderr
    ("return 1", 1, ""),
    ("raise InputError('what is wrong; what to do')", 2, "roadproof: what is wrong; what to do\n"),
    ("raise KeyboardInterrupt", 130, "roadproof: interrupted\n"),
    ("raise KeyboardInterrupt('interrupted: 3 runs are kept')", 130, "roadproof: interrupted: 3 runs are kept\n"),
    ("import models.common.command; exec('raise KeyboardInterrupt')", 130, "roadproof: interrupted\n"),  # as in a dataclass
    ("import turned", 130, "roadproof: interrupted\n"),  # compiled code turns it into an error of its own
    ("from synth.plant.numerics import DesignError; raise DesignError('no gain; do this')", 1, "roadproof: no gain; do this\n"),
    ("import finalised; finalised.wait()", 130, "roadproof: interrupted\n"),  # while a finaliser runs, where Python forgets it
    ("1 / 0", 1, "roadproof: child failed with an unexpected ZeroDivisionError: division by zero; --traceback shows where\n"),
    ("open('missing')", 1, "roadproof: child failed with an unexpected FileNotFoundError: [Errno 2] No such file or directory: "),
    ("raise BrokenPipeError", 0, ""),
    ("import numpy; numpy.zeros(1) / 0", 0, ""),  # the command says in words what overflows
]
TURNED = """
import signal

try:
    signal.raise_signal(signal.SIGINT)
except KeyboardInterrupt:
    pass
raise TypeError("a compiled function forgets why it failed")
"""
FINALISED = """
import signal, time

class Finalised:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)

def wait():
    Finalised()
    for _ in range(1000): time.sleep(0.01)
    raise AssertionError("the interrupt is lost")
"""


def child(folder: Path, body: str, *options: str) -> tuple[int, str, str]:
    """Runs a command whose `main` has this body; returns its exit code, stdout and stderr."""
    (folder / "turned.py").write_text(TURNED)
    (folder / "finalised.py").write_text(FINALISED)
    (folder / "child.py").write_text(f"from models.common.errors import InputError\n\ndef main():\n    {body}\n    return 0\n")
    (folder / "start.py").write_text("from models.common.cli import run; run('child')")
    command = [sys.executable, "-m", "start", *options]
    done = subprocess.run(command, cwd=folder, env=environment(), capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(("body", "code", "said"), ENDS)
def test_every_end_is_one_line(tmp_path, body, code, said):
    """Whatever ends a command, stderr has one line at most, without a traceback, and the exit code says what it was."""
    ended, out, err = child(tmp_path, body)
    assert (ended, out) == (code, "")
    assert err == said if said.endswith("\n") else err.startswith(said)
    assert err.count("\n") == bool(said)


@pytest.mark.parametrize("body", ["1 / 0", "raise InputError('wrong')"])
def test_a_traceback_on_request(tmp_path, body):
    """With --traceback an error is raised as Python does it, with the line that raised it."""
    code, _, err = child(tmp_path, body, "--traceback")
    assert code == 1
    assert 'child.py", line 4, in main' in err


RECORDS = """
import signal
import sim.recording.files
from sim.bump import main

write = sim.recording.files.write_mcap

def write_and_interrupt(*arguments):
    write(*arguments)
    signal.raise_signal(signal.SIGINT)

sim.recording.files.write_mcap = write_and_interrupt
"""


def test_nothing_is_left_of_a_recording(tmp_path):
    """Ctrl-C while a recording is written leaves no file and no folder."""
    (tmp_path / "child.py").write_text(RECORDS)
    options = ["--controller", "passive", "--duration", "0.5", "--logs", "logs/of/today"]
    command = [sys.executable, "-c", "from models.common.cli import run; run('child')", *options]
    done = subprocess.run(command, cwd=tmp_path, env=environment(), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "roadproof: interrupted\n")
    assert [path.name for path in tmp_path.iterdir() if path.name != "__pycache__"] == ["child.py"]


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
EARLY = 4.0  # s; what comes later in a long command is more of the same
INTERRUPTS = 18


def start(command: str, folder: Path) -> subprocess.Popen:
    """Starts a command in a process group of its own, as a terminal does."""
    arguments = [sys.executable, "-m", command, *COMMANDS[command]]
    pipe = subprocess.PIPE
    return subprocess.Popen(arguments, cwd=folder, env=environment(), stdout=pipe, stderr=pipe, text=True, start_new_session=True)


def leftovers(folder: Path) -> list[str]:
    """Returns what no command may leave in a folder: hidden or empty files, half a recording, a page without its end."""
    wrong = []
    for path in (each for each in folder.rglob("*") if each.is_file() and each.name not in (".lock", "campaign.toml")):
        end = {".html": "</html>", ".svg": "</svg>", ".csv": "\n", ".json": "}", ".toml": "\n"}.get(path.suffix)
        if any(part.startswith(".") for part in path.relative_to(folder).parts) or not path.stat().st_size:
            wrong.append(f"{path.name} is left over")
        elif end and not path.read_text("utf-8").rstrip(" ").rstrip("\n" if end != "\n" else "").endswith(end):
            wrong.append(f"{path.name} is cut")
    stems = [{path.name.removesuffix(suffix) for path in folder.rglob(f"logs/*{suffix}")} for suffix in (".mcap", ".rrd")]
    return wrong if stems[0] == stems[1] else [*wrong, "half a recording"]


def before_our_first_line(err: str) -> bool:
    """Returns True if a traceback comes from Python's own start, or from the import of `models.common.cli`."""
    files = [Path(file) for file in re.findall(r'^  File "(.*?)", line', err, re.M)]
    own = [file.relative_to(ROOT).as_posix() for file in files if file.is_relative_to(ROOT) and "site-packages" not in file.parts]
    doors = {"models/__init__.py", "synth/__init__.py", "sim/__init__.py", "models/common/cli.py", "models/common/lazy.py"}
    return err.endswith("KeyboardInterrupt\n") and {*own} <= doors


@pytest.mark.attack
def test_interrupts_at_random_times(tmp_path):
    """Ctrl-C at a random time of any command ends it with one line and 130, and leaves nothing half-written."""
    whole, durations = tmp_path / "whole", {}
    whole.mkdir()
    (whole / "campaign.toml").write_text(CAMPAIGN)
    for command in COMMANDS:
        before = os.times()
        process = start(command, whole)
        out, err = process.communicate(timeout=ENOUGH)
        after = os.times()
        durations[command] = after.children_user + after.children_system - before.children_user - before.children_system
        assert process.returncode == 0, (command, err)
        assert isinstance(json.loads(out), dict)
        if command == "sim.bump":
            next(whole.glob("logs/bump*.mcap")).rename(whole / "log.mcap")
            shutil.rmtree(whole / "logs")
    assert leftovers(whole) == []
    rng, faults, ended = np.random.default_rng(20261121), [], 0
    for number in range(INTERRUPTS):
        command, folder = list(COMMANDS)[number % len(COMMANDS)], tmp_path / str(number)
        folder.mkdir()
        (folder / "campaign.toml").write_text(CAMPAIGN)
        os.link(whole / "log.mcap", folder / "log.mcap")
        process, delay = start(command, folder), rng.uniform(0.0, min(durations[command], EARLY))
        wait_for_processor_time(process, delay)
        os.killpg(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=ENOUGH)
        wrong = leftovers(folder)
        if process.returncode == 0:  # it was done
            wrong += [] if isinstance(json.loads(out), dict) and not err else [f"says {err!r}"]
        elif not before_our_first_line(err):
            one_line = err.startswith("roadproof: interrupted") and err.count("\n") == 1
            wrong += [] if process.returncode == 130 and one_line and not out else [f"{process.returncode}, {err[-500:]!r}"]
        faults += [f"{command} after {delay:.3f} s: {'; '.join(wrong)}"] if wrong else []
        ended += process.returncode != 0
    assert faults == []
    assert ended > INTERRUPTS / 2  # or the times say nothing
