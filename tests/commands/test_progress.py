"""Progress of long work is said on a terminal's stderr, and nowhere else."""

import io
import sys
import threading
import time

import pytest

from models.common import printed
from models.common.printed import WIDEST, Stages
from tests.support.commands import main_of


class Terminal(io.StringIO):
    """A stream that says it is one."""

    def isatty(self) -> bool:
        """Returns True."""
        return True


def terminal(monkeypatch):
    """Makes stderr a terminal, within a test, as pytest sets it for each; reads its lines as they were shown."""
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    return lambda: [line.rstrip() for line in screen.getvalue().split("\r") if line]


def test_stages_are_counted(monkeypatch):
    """A stage is named with its number and how many there are; how far it is follows its name; the end clears the line."""
    shown = terminal(monkeypatch)
    stage = Stages("designs", "margins", "picture")
    stage("designs")
    stage("margins")
    stage("31 runs of 12 s to go")
    stage("")
    done = stage.counted("picture", 124, "cells")
    done(31)
    stage.end()
    assert shown() == [
        "[1/3] designs",
        "[2/3] margins",
        "[2/3] margins: 31 runs of 12 s to go",
        "[2/3] margins",
        "[3/3] picture",
        "[3/3] picture: 31 of 124 cells",
        "",
    ]


def test_a_line_that_lasts_counts_its_seconds(monkeypatch):
    """A long design shows its time once a second until the next line; no thread is left when the line is cleared."""
    shown = terminal(monkeypatch)
    monkeypatch.setattr(printed, "LONG_STAGE", 0.05)
    printed.show("[1/2] controller slow")
    time.sleep(0.3)
    printed.show("")
    time.sleep(0.05)
    assert shown() == ["[1/2] controller slow", "[1/2] controller slow (0 s)", ""]
    assert [one.name for one in threading.enumerate() if one.name.startswith("progress")] == []


def test_a_line_stays_one_line(monkeypatch, capsys):
    """However much is shown, it fits the line that the next one overwrites; a file or a pipe is shown nothing."""
    Stages("runs")("runs")
    assert capsys.readouterr().err == ""
    shown = terminal(monkeypatch)
    stage = Stages("runs")
    stage("runs")
    stage("x" * 300)
    _, line = shown()
    assert len(line) == WIDEST


@pytest.mark.parametrize(
    ("line", "stages"),
    [
        ("sim.envelope --controller I --vary height:0.02:0.1:2 --vary speed:5:20:2 --timestep 4e-3", ["design", "map"]),
        ("synth --controller I", ["controller I", "limits for every controller"]),
    ],
)
def test_commands_name_their_stages(line, stages, tmp_path, monkeypatch, capsys):
    """On a terminal a command names its stages in their order, numbered without a gap, and leaves none of them standing."""
    monkeypatch.chdir(tmp_path)
    command, *arguments = line.split()
    shown = terminal(monkeypatch)
    assert main_of(command)(arguments) == 0
    lines = shown()
    names = [one.partition("] ")[2].partition(":")[0] for one in lines if one]
    assert not lines[-1]
    assert [name for name in dict.fromkeys(names) if name in stages] == stages
    numbers = [int(one[1:].partition("/")[0]) for one in lines if one]
    assert sorted(set(numbers)) == list(range(1, max(numbers) + 1))
    assert numbers == sorted(numbers)
    assert capsys.readouterr().out
