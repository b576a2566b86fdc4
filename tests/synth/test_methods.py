"""One problem, one result, a table of methods: what reads as the paper, what runs for it, and what can be taken away."""

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from models.common.errors import InputError
from models.laws.design_methods import BY_OTHER_KEYS, DESIGNS, METHODS
from models.vehicle.controllers import ControllerEntry
from models.vehicle.vehicle import read_vehicle, shipped_vehicles
from synth.analysis import stabilisability
from synth.design import degenerate
from synth.design.methods import design
from synth.design.problem import DesignProblem
from synth.vehicle.designer import Designer
from tests.support.commands import ROOT, in_the_suite

PAPER = {
    *range(1, 15),
    *range(22, 28),
}  # equations of section 2 that a design consists of; the others are of plant, norm and LMI
MOST_FUNCTIONS = 220  # of the project, for one design of the paper: 207 before; 57 of them certify, 57 follow the central path


def test_the_two_steps_read_as_the_paper():
    """Each equation of the method stands at one line of code of `two_step.py`, in front of what is not of the paper."""
    text = (ROOT / "synth/design/two_step.py").read_text(encoding="utf-8")
    code = re.sub(r'"""[^"]*"""|"[^"\n]*"', "", text)
    numbers = [int(number) for line in code.splitlines() if "#" in line for number in re.findall(r"\((\d+)\)", line)]
    formulas = [number for number in numbers if number in PAPER]
    assert sorted(formulas) == sorted(PAPER)


def problem_of(name: str = "quarter_car", controller: str = "I") -> DesignProblem:
    """The design problem of a controller of a vehicle that ships."""
    designer = Designer(read_vehicle(name))
    entry = designer.vehicle.linear_entry(controller)
    problem = designer.problem(entry.measured, entry.hardware)
    return designer.design_problem(entry, problem, designer.lower_bound(entry.measured, entry.hardware))


def test_few_functions_design_the_paper_s_controller():
    """From its problem to its result a design of the paper runs no more functions of the project than the ceiling."""
    problem, called = replace(problem_of(), path=tuple), set()

    def note(frame, event, argument):
        code = frame.f_code
        path = Path(code.co_filename)
        if event == "call" and path.is_relative_to(ROOT) and path.relative_to(ROOT).parts[0] in ("models", "synth", "sim"):
            called.add((code.co_filename, code.co_qualname))

    sys.setprofile(note)
    try:
        result = design(problem)
    finally:
        sys.setprofile(None)
    print(f"{len(called)} functions")
    assert result.gain[0] == pytest.approx([10825.177, -2069.505], abs=1e-3)
    assert len(called) <= MOST_FUNCTIONS


def is_two_step(entry: ControllerEntry) -> bool:
    """True for a controller of the two steps."""
    return entry.source.request is not None and entry.request.two_steps and entry.goals is None


@pytest.mark.parametrize("name", in_the_suite(["quarter_car", "half_car"], shipped_vehicles()))
def test_no_shipped_car_is_degenerate(name, monkeypatch):
    """The two steps of a vehicle that ships enter nothing that is for plants without an optimum."""
    monkeypatch.setattr(degenerate, "regularise_problem", None)
    monkeypatch.setattr(degenerate, "check_marginal_modes", None)
    vehicle = read_vehicle(name)
    static = [name for name, one in vehicle.controllers.items() if is_two_step(one)]
    for controller in static:
        assert Designer(vehicle).design(controller).certificate.failures == ()


def test_every_method_is_a_function_of_a_problem():
    """Each line of the table names a function of a problem and a callback; a name that is none gives the nearest in one line."""
    assert {*BY_OTHER_KEYS, *DESIGNS} == {*METHODS}
    assert all(METHODS.load(name).__code__.co_varnames[:2] == ("problem", "progress") for name in METHODS)
    with pytest.raises(InputError, match="design method 'h_2' is not known; give one of h2, "):
        METHODS.load("h_2")


def test_a_static_problem_is_checked_for_stabilisability_once(monkeypatch):
    """The modes of an unstable plant are examined once for all methods that its static gain leads to; a stable plant's never."""
    calls, examine = list[str](), stabilisability.stabilisability_failures
    monkeypatch.setattr(stabilisability, "stabilisability_failures", lambda *given: calls.append("") or examine(*given))
    problem = replace(problem_of(), alternatives=True, lower_bound=None, path=tuple)
    assert design(problem).method.startswith("the two steps")
    assert not calls
    unstable = replace(problem.plant, A=problem.plant.A + 4.0 * np.eye(len(problem.plant.A)))
    assert design(replace(problem, plant=unstable)).method.startswith("the two steps")
    assert len(calls) == 1
