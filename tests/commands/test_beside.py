"""Processes that run requests of a page next to the command's own."""

import os
import signal
import subprocess
import sys
from argparse import Namespace

import pytest

from models.common.errors import InputError
from models.common.extensions import STUDIES
from sim.report.page import record, report
from sim.report.processes import Processes
from sim.studies.study import StudyRequest
from sim.studies.subject import Subject
from synth.vehicle.designer import Designer
from tests.support.commands import ROOT, environment


class Deadly(StudyRequest):
    """StudyRequest that ends every process that receives it."""

    def __reduce__(self):
        return os._exit, (3,)


def of_gallery(name: str, kind: type[StudyRequest] = StudyRequest) -> dict[tuple[str, str], StudyRequest]:
    """Returns the request of an entry of the gallery."""
    return {("gallery", name): kind(Namespace(name=[name]))}


@pytest.mark.attack
def test_the_page_is_the_same(paper):
    """A report says the same whether this process does all of it or other ones do what they can."""
    designer, told = Designer(paper), []
    controllers, pages = (designer.design("passive"), designer.design("I")), []
    for count in (0, 2):
        with Processes(count) as pool:
            pages.append(record(report(Subject(paper, designer, controllers, 4e-3, True), {}, pool.begin, told.append)))
    assert pages[0] == pages[1]
    stages = [one for one in told if one in STUDIES]
    assert sorted(stages[: len(stages) // 2]) == sorted(stages[len(stages) // 2 :]), "and names the same stages"


def test_what_a_process_leaves_undone_is_done_here():
    """An error of a request is raised here; a request whose process ends runs here."""
    with Processes(1) as pool:
        with pytest.raises(InputError, match="unknown entry 'nowhere'"):
            pool.begin(of_gallery("nowhere"), print)()
        ((entry, _),) = pool.begin(of_gallery("textbook", Deadly), print)()["gallery", "textbook"]
    assert entry.name == "textbook"


INTERRUPTED = """
import multiprocessing, os, sys, threading, time
from sim.report.processes import Processes
from tests.commands.test_beside import of_gallery

def main():
    with Processes(2) as pool:
        print(*(child.pid for child in multiprocessing.active_children()), flush=True)
        pool.begin({**of_gallery("mathworks"), **of_gallery("textbook")}, print)
        time.sleep(60)
"""


@pytest.mark.skipif(os.name == "nt", reason="Ctrl-C as POSIX sends it")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_no_process_outlives_the_command(how, tmp_path):
    """Ctrl-C, which a terminal sends to all processes, ends them in one line; they also end when the command is killed."""
    (tmp_path / "child.py").write_text(INTERRUPTED)
    code = "if __name__ == '__main__': from models.common.cli import run; run('child')"
    (tmp_path / "start.py").write_text(code)
    paths = os.pathsep.join([str(tmp_path), str(ROOT)])
    command = subprocess.Popen(
        [sys.executable, "-m", "start"],
        cwd=tmp_path,
        env=environment() | {"PYTHONPATH": paths},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert command.stdout is not None
    count = len(command.stdout.readline().split())
    os.killpg(command.pid, how) if how == signal.SIGINT else os.kill(command.pid, how)
    _, err = command.communicate(timeout=60)  # its pipes close when the last process ends
    assert count == 2
    if how == signal.SIGINT:
        assert (command.returncode, err) == (130, "roadproof: interrupted\n")
