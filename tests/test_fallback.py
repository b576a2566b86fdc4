"""If the two steps cannot be gone to their end, descent goes on, and it is said in the table and in JSON."""

import dataclasses
import json

import numpy as np
import pytest

from models.vehicle.vehicle import read_vehicle
from synth.__main__ import main
from synth.analysis.certificate import certify
from synth.command.cross_check import cross_check
from synth.controller.report import notes
from synth.design import static
from synth.design import two_step as design
from synth.design.descent.landscape import Landscape
from synth.design.descent.starts import projected_starts
from synth.design.fallback import two_steps_or_descent
from synth.design.static import static_output_feedback
from synth.design.two_step import state_path, two_step_design
from synth.lmi import central_path as central
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError, InfeasibleError, NoSolutionError, TooLargeError
from synth.vehicle.designer import Designer
from tests.benchmarks.states import chain
from tests.commands import attacks, prose

TOO_LARGE = (
    "the LMI problem has 15 unknowns, and the two steps are gone with at most 14; take states out of the model"  # 10 + 4 + 1
)


def test_too_large_is_said_and_descent_goes_on(capsys, monkeypatch):
    """Beyond the limit of unknowns the table and JSON say how many there are, and give what descent finds, proved."""
    monkeypatch.setattr(design, "MOST", 14)
    assert main(["--controller", "I", "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["controllers"]
    note = next(note for note in row["notes"] if note.startswith("not by the two steps but by descent on the norm from "))
    assert note.endswith(TOO_LARGE)
    assert row["failures"] == []
    assert row["lower_bound"] <= row["norm"] <= row["bound"]
    assert row["norm"] < 7.843188  # the two steps' own, which descent improves upon
    assert main(["--controller", "I", "-v"]) == 0
    assert note in prose(capsys.readouterr().out)


def test_at_the_limit_the_two_steps_are_gone(designer, monkeypatch):
    """15 unknowns fit a limit of 15: nothing is done instead."""
    monkeypatch.setattr(design, "MOST", 15)
    monkeypatch.setattr(central, "MOST", 15)
    controller = Designer(designer.vehicle).design("I")
    assert controller.fallback_method == ""
    np.testing.assert_array_equal(controller.gain, designer.design("I").gain)
    assert central.unknowns(designer.plant) == central.Basis.of(designer.plant, 0).size == 15
    assert central.unknowns(designer.plant, 2) == central.Basis.of(designer.plant, 2).size


def test_too_large_for_a_path(designer, monkeypatch):
    """State feedback has a limit of its own, and nothing to go on with."""
    monkeypatch.setattr(central, "MOST", 14)
    with pytest.raises(TooLargeError, match="the LMI problem has 15 unknowns, and the central path is followed with at most 14"):
        state_path(designer.plant)
    with pytest.raises(TooLargeError, match="controller 'state': the LMI problem has 15 unknowns"):
        Designer(designer.vehicle).design("state")
    assert "the central path is followed with at most 14" in Designer(designer.vehicle).design("I").fallback_method


@pytest.mark.parametrize(
    ("performance", "reason", "best"),
    [
        *attacks([({"suspension_deflection": 1.0}, "some control force costs nothing", 0.1044)]),
        ({"sprung_acceleration": 1.0}, "z does not see the mode at 0 rad/s", 7.836),  # with a weight on the force: 7.8364
    ],
)
def test_where_there_is_no_path_descent_goes_on(performance, reason, best):
    """A force that costs nothing, or a mode that z does not see: I is what descent on the norm finds, proved, and said."""
    designer = Designer(dataclasses.replace(read_vehicle("quarter_car"), performance=performance))
    controller = designer.design("I")
    certificate = controller.certificate
    assert certificate.failures == ()
    assert certificate.bound is not None
    assert designer.lower_bound(controller.measured).gamma * (1 - 1e-9) <= certificate.norm.value < best  # rounding
    assert np.abs(controller.gain).max() <= 1e5 * (1 + 1e-12)  # rounding of the scales
    note = notes(controller)[0]
    assert note.startswith("not by the two steps but by descent on the norm from ")
    assert f"no gain larger than 100000, for {reason}" in note
    assert cross_check(designer, controller) is None  # Clarabel would solve another problem
    with pytest.raises(DesignError, match=f"controller 'state': {reason}") as caught:
        designer.design("state")
    assert not isinstance(caught.value, InfeasibleError)


def test_a_gain_without_a_proof_is_said_to_be(designer, monkeypatch):
    """If rounding leaves no proof of a bound the gain comes with its norm, and that there is no bound is said."""
    monkeypatch.setattr(design, "MOST", 14)
    monkeypatch.setattr(static, "certify_tightly", lambda plant, G, below, by_itself: certify(plant, G, lower_bound=below))
    found = Designer(designer.vehicle).design("II")
    assert found.certificate.bound is None
    assert found.certificate.failures == ()
    assert (
        "rounding leaves no proof of a bound, the norm is what two routes agree on, for the LMI problem" in found.fallback_method
    )


def test_what_has_no_solution_is_not_searched_for():
    """If problem (25) has no solution from any X, that is the answer; x'' = x + u from x' has no static gain."""
    C, D = np.vstack([np.eye(2), np.zeros((1, 2))]), np.array([[0.0], [0.0], [1.0]])
    plant = GeneralizedPlant(
        np.array([[0.0, 1.0], [1.0, 0.0]]), np.array([[0.0], [1.0]]), np.ones((2, 1)), C, D, np.zeros((3, 1))
    )
    with pytest.raises(InfeasibleError, match=r"whose mode at 1 1/s does not decay"):
        two_steps_or_descent(plant, np.array([[0.0, 1.0]]))


def test_one_broken_path_is_no_proof(monkeypatch, designer):
    """If (25) has no solution from some X and its path breaks off from another, there may be a gain: no InfeasibleError."""
    turns = iter([NoSolutionError("no solution"), DesignError("broke off")])

    def fails(*_):
        raise next(turns, NoSolutionError("no solution"))

    monkeypatch.setattr(design, "output_feedback", fails)
    with pytest.raises(DesignError, match="broke off") as caught:
        two_step_design(designer.plant, np.eye(4)[[0, 2]], designer.state_path)
    assert not isinstance(caught.value, InfeasibleError)


@pytest.mark.attack
def test_why_there_are_no_two_steps_is_kept(designer, monkeypatch):
    """The strategy for any plant says what its two steps came to."""
    monkeypatch.setattr(design, "MOST", 14)
    found = static_output_feedback(designer.plant, np.eye(4)[[0, 2]])
    assert found.two_steps is None
    assert found.without == TOO_LARGE


@pytest.mark.parametrize("states", [20, 60])
def test_projected_starts_are_good(states):
    """On a chain of masses they are stable, within a third of the best gain known; u = 0 is more than five times as high."""
    plant, Cy = chain(states)
    landscape = Landscape(plant, Cy)
    norms = [landscape.norm(x)[0] for x in projected_starts(landscape)]
    best_known = {20: 1.70, 60: 1.376}[states]  # by the two steps, and by descent
    assert min(norms) < 4 / 3 * best_known
    assert landscape.norm(np.zeros(Cy.shape[0]))[0] > 5 * best_known


def test_projected_starts_of_states_that_are_all_measured():
    """For x' = u - x, z = x and y = x they are the optimal gains 1 - sqrt(2 + 1 / r) where u^2 costs a share r of x^2, too."""
    one, none = np.eye(1), np.zeros((1, 1))
    landscape = Landscape(GeneralizedPlant(-one, one, one, one, none, none), one)
    for x, r in zip(projected_starts(landscape), (1e-8, 1e-4, 1e-2), strict=True):
        # x^2 costs 1 + r, so that 2 p + p^2 / r = 1 + r, and u = -p / r x.
        assert landscape.gain(x)[0, 0] == pytest.approx(1 - (2 + 1 / r) ** 0.5, rel=1e-9)  # rounding of the Riccati equation


@pytest.mark.attack
def test_a_large_plant(monkeypatch):
    """A chain too large for the two steps has a gain by descent; that is said, and where rounding leaves no proof of a bound."""
    assert central.unknowns(chain(46)[0]) > design.MOST == 1100
    plant, Cy = chain(16)
    two_steps = two_step_design(plant, Cy)
    monkeypatch.setattr(design, "MOST", 135)
    found = two_steps_or_descent(plant, Cy)
    certificate = found.certificate
    assert certificate.failures == ()
    assert (certificate.bound is None) == ("rounding leaves no proof of a bound" in found.instead)
    assert certificate.norm.value < 1.001 * two_steps.certificate.norm.value
    assert "unknowns, and the two steps are gone with at most 135" in found.instead
