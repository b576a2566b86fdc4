"""Observers: what is unknown of a run without one of them, and how many functions a run with all of them takes."""

import os
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from models import Bump, read_vehicle
from models.common.extensions import OBSERVERS
from sim import run
from sim.campaign.batch import run_batch
from sim.campaign.file import parse_campaign
from sim.campaign.plan import Plan
from sim.studies.stability.edge import search_and_run
from synth.vehicle.designer import driver_of
from tests.support.commands import ROOT

MOST_FUNCTIONS, MOST_FILES = 1031, 83  # of the project; the aim is 900 in 60
COUNT = """
import sys
from pathlib import Path
from models import Bump, read_vehicle
from sim import run
from synth import design_controllers

def note(frame, event, argument):
    if event == "call" and frame.f_code.co_flags & 1:  # CO_OPTIMIZED: no body of a class or module
        called.add(frame.f_code)

called = set()
sys.setprofile(note)
vehicle = read_vehicle("quarter_car")
[one] = run(vehicle, design_controllers(vehicle, ["I"]), Bump(height=0.1))
agrees = one.agrees
sys.setprofile(None)
root = Path(sys.argv[1])
paths = {code: Path(code.co_filename) for code in called}
ours = {
    code: path
    for code, path in paths.items()
    if path.is_relative_to(root) and path.relative_to(root).parts[0] in ("models", "synth", "sim")
}
print(agrees, len(ours), len({*ours.values()}))
"""


def test_few_functions_run_from_the_file_to_the_verdict():
    """A run of the paper's controller enters no more functions than the ceiling, with lambdas and comprehensions."""
    done = subprocess.run(
        [sys.executable, "-c", COUNT, str(ROOT)], env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, text=True
    )
    agrees, functions, files = done.stdout.split()
    print(f"{functions} functions in {files} files")
    assert agrees == "True"
    assert (int(functions) <= MOST_FUNCTIONS, int(files) <= MOST_FILES) == (True, True)


@pytest.mark.parametrize("name", ["energy", "steps", "commands"])
def test_a_run_without_an_observer_leaves_its_result_unknown(name, monkeypatch):
    """The result is None, every other one and all signals are the same to the last bit, and the verdict follows from the rest."""

    def of_run():
        (one,) = run(read_vehicle("quarter_car"), "I_printed", Bump(height=0.05), duration=0.5)
        return one, {"energy": one.energy, "steps": one.agreement.steps, "commands": one.agreement.commands}

    whole, known = of_run()
    monkeypatch.delitem(OBSERVERS, name)
    without, rest = of_run()
    assert OBSERVERS.load_if_known(name) is None
    assert rest == known | {name: None} != known
    assert whole.passed
    assert without.passed
    np.testing.assert_array_equal(without.physics.values, whole.physics.values)


def test_a_campaign_without_twins_has_no_linear_error(monkeypatch):
    """Every other column of a row stays, and those of the linear response are missing."""
    text = (
        'vehicles = ["quarter_car"]\ncontrollers = ["I_printed"]\nroads = ["bump:height=0.02"]\nspeeds = [10]\nduration = 0.2\n'
    )
    plan = Plan(parse_campaign(text, ROOT), {"quarter_car": {"I_printed": driver_of(read_vehicle("quarter_car"), "I_printed")}})
    (whole,) = run_batch(plan, 0, 1) or [{}]
    monkeypatch.delitem(OBSERVERS, "twin")
    (without,) = run_batch(plan, 0, 1) or [{}]
    assert whole["linear_error"] is not None
    linear = {name for name in whole if name.startswith("linear_")}
    assert without == {name: value for name, value in whole.items() if name not in linear} | {"linear_error": None}


def test_edges_of_margins_are_not_run_without_growth(monkeypatch):
    """The derivative of the step has decided an edge. Without the observer no run follows."""
    edge: Any = SimpleNamespace(stable=1.0, unstable=1.1, runs={}, search=lambda: None)  # no `trial`, which a run would take
    monkeypatch.delitem(OBSERVERS, "growth")
    search_and_run([edge])
    assert edge.runs == {}
