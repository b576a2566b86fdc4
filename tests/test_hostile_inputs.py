"""Nothing that a command is given breaks it: one line and exit code 2, or it runs. Its benchmark has a thousand inputs."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
POSIX = pytest.mark.skipif(sys.platform == "win32", reason="each case is forked, and pipes and links are POSIX's")


@POSIX
@pytest.mark.attack
def test_hostile_inputs():
    """For 60 inputs, by kind of damage over all commands and files, none gives a traceback, hangs, or fills memory."""
    # In a process of its own: each input is forked from it, and has its memory.
    asked = [sys.executable, "-m", "tests.benchmarks.hostile_inputs", "--first", "0", "--count", "60"]
    done = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
