"""Processes that do pieces of a report beside the one that was asked for it."""

import os
import signal
import subprocess
import sys
from functools import partial

import pytest

from models.common.errors import InputError
from models.vehicle.vehicle import read_vehicle
from sim.report.contents import report, report_object
from sim.report.scope import Scope
from sim.report.worker_processes import Beside
from synth.vehicle.designer import Designer
from tests.commands import environment

INTERRUPTED = """
import os, signal, threading
from models.common.threads import cores
from models.common.command import run_command
from models.vehicle.vehicle import read_vehicle
from sim.report.worker_processes import Beside, processes
from tests.test_beside import endless, nothing

def main():
    vehicle, others = read_vehicle("quarter_car"), cores() - 1
    assert [processes(vehicle, quick) for quick in (False, True)] == [min(others, 3), min(others, 1)]
    with Beside(1) as beside:
        results = beside.begin(nothing(), {("endless", ""): endless})
        print(beside._all[0].pid, flush=True)
        threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGTERM)).start()
        results()
    return 0

run_command(main)
"""


def nothing() -> Scope:
    """Returns what pieces of these tests are about."""
    paper = read_vehicle("quarter_car")
    return Scope(paper, Designer(paper), (), 1e-3, True, print)


def where(scope: Scope) -> int:
    return os.getpid()


def ends_elsewhere(scope: Scope, process: int) -> str:
    if os.getpid() != process:
        os._exit(3)
    return "done here"


def fails(scope: Scope) -> str:
    raise InputError("mend that")


def endless(scope: Scope) -> None:
    signal.pause()


@pytest.mark.attack
def test_the_page_is_the_same(paper):
    """A report says the same whether this process does all of it or another one does what it can."""
    designer, told = Designer(paper), []
    controllers = (designer.design("passive"), designer.design("I"))
    scope = Scope(paper, designer, controllers, 4e-3, True, told.append)
    pages = []
    for count in (0, 1):
        with Beside(count) as beside:
            pages.append(report(scope, {}, beside))
    alone, shared = (report_object(one) for one in pages)
    assert alone == shared
    assert told[: len(told) // 2] == told[len(told) // 2 :], "and names its stages in the same order"
    figures = [[panel for part in one.page.parts for figure in part.figures for panel in figure.panels] for one in pages]
    assert [[curve.y.tolist() for curve in panel.curves] for panel in figures[0]] == [
        [curve.y.tolist() for curve in panel.curves] for panel in figures[1]
    ]


def test_what_a_process_leaves_undone_is_done_here():
    """A piece is done elsewhere; where its process ends, or it fails, it is done here, and says what is wrong as ever."""
    scope, ends = nothing(), partial(ends_elsewhere, process=os.getpid())
    with Beside(1) as beside:
        (first,) = beside.begin(scope, {("where", ""): where})().values()
        assert beside.begin(scope, {("ends", "of I"): ends})() == {("ends", "of I"): "done here"}
        with pytest.raises(InputError, match="mend that"):
            beside.begin(scope, {("fails", ""): fails})()
    assert first not in (os.getpid(), 0)


@pytest.mark.attack
@pytest.mark.skipif(not hasattr(os, "killpg"), reason="a signal that is handled needs POSIX")
def test_an_interrupt_leaves_no_process(tmp_path):
    """Being told to end while another process works ends both, with one word and the signal's exit code."""
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, cwd=tmp_path, env=environment(), check=False
    )
    assert (done.returncode, done.stderr) == (143, "roadproof: terminated\n")
    with pytest.raises(ProcessLookupError):
        os.kill(int(done.stdout.split()[0]), 0)
