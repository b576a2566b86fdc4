"""Ctrl-C in the middle of a command's work, as a user sends it: what it ends with, and what it keeps."""

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


def test_an_interrupted_map_is_kept(tmp_path):
    """Ctrl-C in the middle of a map ends it at once, with exit code 130; what is done is printed and written, the same cells."""
    arguments = ["--controller", "I", "--vary", "height:0.02:0.2:100", "--vary", "speed:5:20:100", "--csv", "map.csv", "--json"]
    command = [sys.executable, "-c", CHILD, *arguments]
    process = subprocess.Popen(
        command, cwd=tmp_path, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    assert process.stderr.readline() == "some are done\n"
    process.send_signal(signal.SIGINT)
    sent = time.monotonic()
    out, err = process.communicate(timeout=ENOUGH)
    assert time.monotonic() - sent < AT_ONCE
    assert process.returncode == 130
    result = json.loads(out)
    assert not result["complete"]
    assert 0 < result["done"] == len(result["cells"]) < 10_000
    assert len((tmp_path / "map.csv").read_text().splitlines()) == 1 + result["done"]
    assert err == f"roadproof: interrupted after {result['done']} of 10000 cells; they are kept\n"


@pytest.mark.parametrize(
    "where",
    [
        "raise KeyboardInterrupt",
        "exec('raise KeyboardInterrupt')",  # as in `dataclass`: Python remembers that, and would end by the signal
        "import turned",  # as in a compiled module
    ],
)
def test_wherever_it_is_heard(tmp_path, where):
    """Ctrl-C ends a command with one line and exit code 130, also where Python or a library makes something else of it."""
    (tmp_path / "turned.py").write_text(TURNED)
    (tmp_path / "child.py").write_text(
        f"import sim\nfrom models.common.command import run_command\n\ndef main():\n    {where}\n\nrun_command(main)\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "child"],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "roadproof: interrupted\n")


def test_none_is_lost_where_work_goes_on(tmp_path):
    """A Ctrl-C in the moment in which a file gets its name is heard when it has it, if there is more work to do."""
    (tmp_path / "child.py").write_text(GOES_ON)
    done = subprocess.run([sys.executable, "child.py"], cwd=tmp_path, env=environment(), capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "named\nnamed\nheard\nafter one more\n"


GOES_ON = """
import signal
from models.common.interrupt import finishing

with finishing():
    signal.raise_signal(signal.SIGINT)
    print("named")
try:
    with finishing(work_goes_on=True):
        with finishing():
            signal.raise_signal(signal.SIGINT)
            print("named")
    print("lost")
except KeyboardInterrupt:
    print("heard")
with finishing():
    pass
print("after one more")
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

def bar(total, what):
    told = []
    def update(done):
        if not told:
            told.append(done)
            print("some are done", file=sys.stderr, flush=True)
    return update

sim.envelope.bar = bar
sys.argv[0] = "envelope"
run_command(sim.envelope.main)
"""
