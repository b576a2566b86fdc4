"""Ctrl-C in the middle of a command's work, or another signal to end: what it ends with, and what it keeps."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from tests.commands import environment

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Ctrl-C as POSIX sends it")

ENOUGH = 120.0  # s that a command may take on a busy machine
AT_ONCE = 20.0  # s to end after Ctrl-C on a busy machine; a second on an idle one


ENDINGS = [("SIGINT", 130, "interrupted"), ("SIGTERM", 143, "terminated"), ("SIGHUP", 129, "hung up")]


@pytest.fixture(autouse=True, scope="module")
def heard():
    """Lets children hear SIGHUP, also if the suite runs under `nohup`, which has it ignored."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.attack
@pytest.mark.parametrize(("name", "code", "word"), ENDINGS[1:2])
def test_an_interrupted_map_is_kept(tmp_path, name, code, word):
    """A signal in the middle of a map ends it at once, with its exit code; what is done is printed and written."""
    arguments = ["--controller", "I", "--vary", "height:0.02:0.2:100", "--vary", "speed:5:20:100", "--csv", "map.csv", "--json"]
    arguments += ["--timestep", "0.004"]
    command = [sys.executable, "-c", CHILD, *arguments]
    process = subprocess.Popen(
        command, cwd=tmp_path, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    assert process.stderr.readline() == "some are done\n"
    process.send_signal(getattr(signal, name))
    sent = time.monotonic()
    out, err = process.communicate(timeout=ENOUGH)
    assert time.monotonic() - sent < AT_ONCE
    assert process.returncode == code
    result = json.loads(out)
    assert not result["complete"]
    assert 0 < result["done"] == len(result["cells"]) < 10_000
    assert len((tmp_path / "map.csv").read_text().splitlines()) == 1 + result["done"]
    assert err == f"roadproof: {word} after {result['done']} of 10000 cells; they are kept\n"


@pytest.mark.parametrize("stderr", [False, True])
@pytest.mark.parametrize(("name", "code", "word"), ENDINGS)
def test_who_reads_it_has_gone_too(name, code, word, stderr):
    """Output that can go nowhere any more, as when the terminal has ended, does not change the exit code."""
    gone, output = os.pipe()
    os.close(gone)
    child = f"print('some'); import signal; signal.raise_signal(signal.{name})"
    command = [sys.executable, "-c", f"from models.common.command import run_command\nrun_command(lambda: exec({child!r}))"]
    buffered = {key: value for key, value in environment().items() if key != "PYTHONUNBUFFERED"}
    done = subprocess.run(command, env=buffered, text=True, stdout=output, stderr=output if stderr else subprocess.PIPE)
    os.close(output)
    assert done.returncode == code
    assert stderr or done.stderr == f"roadproof: {word}\n"


@pytest.mark.parametrize(("name", "code", "word"), ENDINGS[1:2])
def test_nothing_is_left_of_a_recording(tmp_path, name, code, word):
    """A signal while a recording is written ends the command with one line and its exit code, and leaves no file, no folder."""
    (tmp_path / "child.py").write_text(RECORDS.format(signal=name))
    done = subprocess.run([sys.executable, "child.py"], cwd=tmp_path, env=environment(), capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", f"roadproof: {word}\n")
    assert [path.name for path in tmp_path.iterdir()] == ["child.py"]


@pytest.mark.parametrize(("name", "code", "word"), ENDINGS)
def test_before_anything_has_begun(tmp_path, name, code, word):
    """While a command is still being imported a signal ends it at once, with its word and exit code."""
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "__init__.py").write_text(f"import signal\nimport sim\n\nsignal.raise_signal(signal.{name})\n")
    (tmp_path / "package" / "child.py").write_text("print('too far')")
    done = subprocess.run(
        [sys.executable, "-m", "package.child"], cwd=tmp_path, env=environment(), capture_output=True, text=True
    )
    assert (done.returncode, done.stdout, done.stderr) == (code, "", f"roadproof: {word}\n")


@pytest.mark.parametrize("module", ["models.common", "models.common.command"])
@pytest.mark.parametrize("command", ["sim.bump", "sim.report", "synth", "roadproof"])
def test_while_our_first_module_is_imported(tmp_path, command, module):
    """Ctrl-C at the first import that a command does, as at a later one, ends it with one line and 130, without a traceback."""
    (tmp_path / "sitecustomize.py").write_text(HEARD_WHILE_IMPORTED.format(module=module))
    (tmp_path / "roadproof").write_text("from sim.__main__ import roadproof\nroadproof()\n")
    known = environment()
    known |= {"PYTHONPATH": os.pathsep.join([str(tmp_path), known["PYTHONPATH"]])}
    called = ["roadproof", "bump"] if command == "roadproof" else ["-m", command]
    done = subprocess.run([sys.executable, *called], cwd=tmp_path, env=known, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "roadproof: interrupted\n")


def test_what_is_to_be_ignored_is(tmp_path):
    """Under `nohup`, which has the end of the terminal ignored, a command goes on to its end."""
    (tmp_path / "child.py").write_text(
        "import signal\nsignal.signal(signal.SIGHUP, signal.SIG_IGN)\nimport sim\n"
        "from models.common.command import run_command\n\n"
        "def main():\n    signal.raise_signal(signal.SIGHUP)\n    print('done')\n    return 0\n\nrun_command(main)\n"
    )
    done = subprocess.run([sys.executable, "-m", "child"], cwd=tmp_path, env=environment(), capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "done\n", "")


@pytest.mark.parametrize(
    "where",
    [
        "raise KeyboardInterrupt",
        "exec('raise KeyboardInterrupt')",  # as in `dataclass`: Python remembers that, and would end by the signal
        "import turned",  # as in a compiled module
        "import mistaken",  # as where `ssl` imports a name of its compiled module
        "import dropped",  # as where numpy imports `datetime`: of the interrupt nothing is left
    ],
)
def test_wherever_it_is_heard(tmp_path, where):
    """Ctrl-C ends a command with one line and exit code 130, also where Python or a library makes something else of it."""
    (tmp_path / "turned.py").write_text(TURNED)
    (tmp_path / "dropped.py").write_text(DROPPED)
    (tmp_path / "mistaken.py").write_text(DROPPED.replace("ImportError", "TypeError"))
    (tmp_path / "child.py").write_text(
        f"import sim\nfrom models.common.command import run_command\n\ndef main():\n    {where}\n\nrun_command(main)\n"
    )
    done = subprocess.run([sys.executable, "-m", "child"], cwd=tmp_path, env=environment(), capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "roadproof: interrupted\n")


@pytest.mark.parametrize("interrupted", [False, True])
def test_what_it_cuts_short_does_not_complain(tmp_path, interrupted):
    """An object that Ctrl-C left half made may fail when it goes, and nothing of that is said; without Ctrl-C it is."""
    (tmp_path / "child.py").write_text(HALF_MADE)
    done = subprocess.run(
        [sys.executable, "-m", "child", *(["interrupted"] if interrupted else [])],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
    )
    if interrupted:
        assert (done.returncode, done.stdout, done.stderr) == (130, "", "roadproof: interrupted\n")
    else:
        assert (done.returncode, done.stdout) == (0, "done\n")
        assert "AttributeError: 'HalfMade' object has no attribute 'part'" in done.stderr


@pytest.mark.parametrize(("name", "code", "word"), ENDINGS[:1])
def test_a_table_of_finished_designs_is_kept(tmp_path, name, code, word):
    """Ctrl-C and SIGTERM alike, when the designs are done and the table is not, end `synth` with the whole table."""
    (tmp_path / "child.py").write_text(TABLE.format(signal=name))
    done = subprocess.run([sys.executable, "child.py"], cwd=tmp_path, env=environment(), capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (code, f"roadproof: {word}\n")
    assert [row["name"] for row in json.loads(done.stdout)["controllers"]] == ["passive", "II"]


def test_none_is_lost_where_work_goes_on(tmp_path):
    """A Ctrl-C in the moment in which a file gets its name is heard when it has it, if there is more work to do."""
    (tmp_path / "child.py").write_text(GOES_ON)
    done = subprocess.run([sys.executable, "child.py"], cwd=tmp_path, env=environment(), capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "named\nnamed\nheard 143\nafter one more\n"


HEARD_WHILE_IMPORTED = """
import _signal
import sys

class Finder:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name == "{module}":
            _signal.raise_signal(_signal.SIGINT)

sys.meta_path.insert(0, Finder)
"""

RECORDS = """
import signal
import sys
import sim.recording.files
from models.common.command import run_command
from sim.bump import main

write = sim.recording.files.write_mcap

def write_and_hear(*arguments):
    write(*arguments)
    signal.raise_signal(signal.{signal})

sim.recording.files.write_mcap = write_and_hear
sys.argv[:] = ["bump", "--controller", "passive", "--duration", "0.5", "--logs", "logs/of/today"]
run_command(main)
"""

TABLE = """
import signal
import sys
import synth.command.design_table as table
from models.common.command import run_command
from synth.__main__ import main

expected_ride, told = table.expected_ride, []

def heard(*arguments):
    if not told:
        told.append(signal.raise_signal(signal.{signal}))
    return expected_ride(*arguments)

table.expected_ride = heard
sys.argv[:] = ["synth", "--controller", "passive", "--controller", "II", "--json"]
run_command(main)
"""

GOES_ON = """
import signal
from models.common.interrupt import code, enable_interrupts, uninterrupted

enable_interrupts()
with uninterrupted():
    signal.raise_signal(signal.SIGINT)
    print("named")
try:
    with uninterrupted(work_goes_on=True):
        with uninterrupted():
            signal.raise_signal(signal.SIGTERM)
            print("named")
    print("lost")
except KeyboardInterrupt:
    print("heard", code())
with uninterrupted():
    pass
print("after one more")
"""

HALF_MADE = """
import signal
import sys
import sim
from models.common.command import run_command

class HalfMade:
    def __init__(self):
        if sys.argv[1:]:
            signal.raise_signal(signal.SIGINT)
    def __del__(self):
        self.part

def main():
    HalfMade()
    print("done")
    return 0

run_command(main)
"""

DROPPED = """
import signal
try:
    signal.raise_signal(signal.SIGINT)
except KeyboardInterrupt:
    pass
raise ImportError("could not import module 'datetime'")
"""
TURNED = """
try:
    raise KeyboardInterrupt
except KeyboardInterrupt as interruption:
    raise ImportError("initialization failed") from interruption
"""

CHILD = """
import sys
import sim.envelope
from models.common.command import run_command
from models.common.printed import Stages

def counted(stages, name, total, what):
    told = []
    def update(done):
        if not told:
            told.append(done)
            print("some are done", file=sys.stderr, flush=True)
    return update

Stages.counted = counted
sys.argv[0] = "envelope"
run_command(sim.envelope.main)
"""
