"""Nothing that a command is given breaks it: one line and exit code 2, or it runs. Its benchmark has a thousand inputs."""

import sys

import pytest

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="each case is forked, and pipes and links are POSIX's")


@POSIX
@pytest.mark.attack
@pytest.mark.parametrize("first", [0, 10_000])
def test_hostile_inputs(first):
    """Of four hundred inputs, by kind of damage over all commands and files, none gives a traceback, hangs, or fills memory."""
    from tests.benchmarks.hostile_inputs import attack

    assert attack(first, 200) == {}
