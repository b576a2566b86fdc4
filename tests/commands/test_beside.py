"""Processes that do pieces of a report beside the one that was asked for it."""

import os
from functools import partial

import pytest

from models.common.errors import InputError
from models.vehicle.vehicle import read_vehicle
from sim.report.contents import report, report_object
from sim.report.scope import Subject
from sim.report.worker_processes import WorkerPool
from synth.vehicle.designer import Designer


def nothing() -> Subject:
    """Returns what pieces of these tests are about."""
    paper = read_vehicle("quarter_car")
    return Subject(paper, Designer(paper), (), 1e-3, True, print)


def where(scope: Subject) -> int:
    return os.getpid()


def ends_elsewhere(scope: Subject, process: int) -> str:
    if os.getpid() != process:
        os._exit(3)
    return "done here"


def fails(scope: Subject) -> str:
    raise InputError("correct it")


@pytest.mark.attack
def test_the_page_is_the_same(paper):
    """A report says the same whether this process does all of it or another one does what it can."""
    designer, told = Designer(paper), []
    controllers = (designer.design("passive"), designer.design("I"))
    scope = Subject(paper, designer, controllers, 4e-3, True, told.append)
    pages = []
    for count in (0, 1):
        with WorkerPool(count) as pool:
            pages.append(report(scope, {}, pool.begin))
    alone, shared = (report_object(one) for one in pages)
    assert alone == shared
    assert told[: len(told) // 2] == told[len(told) // 2 :], "and names its stages in the same order"


def test_what_a_process_leaves_undone_is_done_here():
    """A piece is done elsewhere; where its process ends, or it fails, it is done here, and says what is wrong as ever."""
    scope, ends = nothing(), partial(ends_elsewhere, process=os.getpid())
    with WorkerPool(1) as pool:
        (first,) = pool.begin(scope, {("where", ""): where})().values()
        assert pool.begin(scope, {("ends", "of I"): ends})() == {("ends", "of I"): "done here"}
        with pytest.raises(InputError, match="correct it"):
            pool.begin(scope, {("fails", ""): fails})()
    assert first not in (os.getpid(), 0)
