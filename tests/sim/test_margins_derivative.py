"""The derivative of MuJoCo's own step: loops from sample to sample, runs that start in their slowest mode, implemented loops."""

import dataclasses
import json
import math
import re

import control
import numpy as np
import pytest

from models.common.errors import InputError
from models.laws.linear import LinearLaw, static_law
from models.vehicle.limits_and_implementation import Implementation, Limits
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.linear.nonlinear_elements import at_rest
from sim.margins import main
from sim.studies.stability import edge
from sim.studies.stability.edge import rates_of_runs
from sim.studies.stability.margin_search import find_all, implemented_searches, loops_of
from sim.studies.stability.simulated_loop import LoopCase, simulated_loop
from sim.studies.stability.step_derivative import step_derivative
from synth.controller.stability_margins import margins
from synth.plant.loop import HoldInterval, Loop
from synth.plant.state_space import StateSpace
from synth.vehicle.designer import certify_given
from tests.support.analysed import sampled_radius
from tests.support.shared import designed

FILTERED = LinearLaw(np.array([[-40.0]]), np.array([[1.0, 0.02]]), np.array([[-4000.0]]), np.array([[-500.0, -8.0]]))


@pytest.mark.parametrize("lag", [None, 60.0])
@pytest.mark.parametrize("how", [{}, {"delay": 70}, {"sample_period": 0.01, "delay": 2.4}, {"sample_period": 0.06}])
def test_the_simulated_loop_is_the_implemented_one(paper, lag, how):
    """MuJoCo's loop grows as the linear loop does, and so does a run that starts in its slowest mode.

    The law has a state and measures an acceleration, which contains the force of the step before. With 70 pending forces, the
    rate is that of the map over a whole delay.
    """
    vehicle = dataclasses.replace(paper, limits=Limits(actuator_bandwidth=lag), implementation=Implementation(**how))
    controller = certify_given(vehicle, "c", ["sprung_velocity", "sprung_acceleration"], FILTERED)
    loop = simulated_loop(step_derivative(vehicle, 2e-3), LoopCase(vehicle, controller))
    expected = math.log(sampled_radius(vehicle, controller, 2e-3)) / 2e-3
    assert loop.rate == pytest.approx(expected, rel=1e-5)  # RK4's, of a wheel at 65 rad/s
    (rate,) = rates_of_runs([LoopCase(vehicle, controller)], [loop])
    assert rate == pytest.approx(loop.rate, rel=1e-6)  # geometry and rounding


@pytest.mark.parametrize(("actuators", "how"), [([0], {"delay": 30}), ([1], {"sample_period": 0.02}), ([0, 1], {"delay": 30})])
def test_some_forces_are_delayed(actuators, how):
    """A run of two controllers, of which one is delayed or sampled, starts in the mode of their loop and stays in it."""
    vehicle = dataclasses.replace(read_vehicle("half_car"), implementation=Implementation(**how))
    controller, mine = designed(vehicle, "I"), np.isin([0, 1], actuators)
    delayed, rest = (dataclasses.replace(controller, law=controller.law.only(part)) for part in (mine, ~mine))
    trial = LoopCase(vehicle, delayed, None if all(mine) else rest)
    loop = simulated_loop(step_derivative(vehicle, 2e-3), trial)
    assert rates_of_runs([trial], [loop]) == [pytest.approx(loop.rate, rel=1e-6)]


def test_a_run_that_is_not_the_loop_is_seen(paper, designer):
    """A run that is a sample later than its loop does not keep the rate of the mode from which it starts: nor its sign, here."""
    late = [dataclasses.replace(paper, implementation=Implementation(delay=delay)) for delay in (173, 174)]
    trials, step = [LoopCase(vehicle, designer.design("II")) for vehicle in late], step_derivative(paper, 5e-4)
    loops = [simulated_loop(step, trial) for trial in trials]
    assert [loop.grows for loop in loops] == [False, True]
    assert [rate > 0 for rate in rates_of_runs(trials, loops)] == [False, True]
    assert rates_of_runs(trials[1:], loops[:1])[0] > 0


def test_a_run_that_contradicts_its_loop_is_no_agreement(paper, designer, monkeypatch):
    """Margins do not agree if MuJoCo's runs decay where its derivative grows; if they move too little, nothing is found."""
    for rates, confirmed, decided in (([-1.0, -1.0], False, True), ([math.nan, math.nan], True, False)):
        monkeypatch.setattr(edge, "rates_of_runs", lambda trials, loops, rates=rates: rates)
        one = implemented_searches(
            dataclasses.replace(paper, implementation=Implementation(sample_period=0.01)), designer.design("I"), [0], 1e-3
        )
        edge.search_and_run([one.delay])
        assert (one.delay.confirmed, one.delay.decided) == (confirmed, decided)
        assert one.agrees == confirmed
        assert math.isnan(one.found_delay) != decided


LATE = 'sample_period = 0.01\ndelay = 2\n\n[controllers.V]\nmeasured = ["sprung_velocity", "unsprung_velocity"]\n'


def test_margins_are_those_of_the_loop_as_built(paper, tmp_path, capsys):
    """A loop that bears any gain without its computer is lost above 1.273 with 10 ms and two samples of delay."""
    file = tmp_path / "late.toml"
    file.write_text(f"{paper.text}\n[implementation]\n{LATE}gain = [[-3000.0, 900.0]]\n")
    assert main(["--vehicle", str(file), "--controller", "V", "--timestep", "1e-3", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["gain"]["predicted"] == pytest.approx(1.27321, abs=5e-6)
    assert result["gain"]["found"] == pytest.approx(1.27321, rel=1e-5)
    assert result["ideal"]["gain"]["predicted"] is None
    vehicle = read_vehicle(file)
    controller = designed(vehicle, "V")
    for side in (1 - 1e-6, 1 + 1e-6):
        scaled = dataclasses.replace(controller, law=controller.law.scaled(side * result["gain"]["predicted"]))
        assert (sampled_radius(vehicle, scaled, 1e-3) > 1) == (side > 1)
    file.write_text(f"{paper.text}\n[implementation]\n{LATE}gain = [[-6000.0, 1800.0]]\n")
    with pytest.raises(
        InputError, match="implemented loop is not stable \\(a sample every 10 ms, forces that act 2 samples late\\)"
    ):
        main(["--vehicle", str(file), "--controller", "V"])


def test_sampled_margins_are_those_of_python_control():
    """Gain, phase and disk margin of a sampled loop are those of python-control for the same transfer function in z."""
    A, B, K = np.array([[-1.0, 1.0], [-1.0, -1.6]]), np.array([[0.0], [9.0]]), np.array([[-1.0, -0.2]])
    plant = StateSpace(A, B, np.eye(2), np.zeros((2, 1)), ("u",), ("x1", "x2"))
    found = margins(Loop(plant, static_law(K), plant.outputs, ("u",), hold=(HoldInterval(0.1, 1),)))  # a sample late
    loop = control.sample_system(control.ss(A, B, -K, 0), 0.1) * control.ss(0, 1, 1, 0, 0.1)
    gain, phase, _, _, frequency, _ = control.stability_margins(loop)
    assert found.gain == pytest.approx(gain, rel=1e-6)
    assert min(found.smallest_phase, found.lead) == pytest.approx(math.radians(abs(phase)), rel=1e-6)
    assert found.frequency == pytest.approx(frequency, rel=1e-6)
    omega = np.linspace(0, math.pi / 0.1, 20_001)
    assert found.disk.size == pytest.approx(control.disk_margins(loop, omega)[0], rel=1e-5)  # of its grid


def test_loops_of_several_forces_as_built():
    """Each loop of a half-car as implemented has its own gain margin, at least that of both; the delay is that of both."""
    vehicle = dataclasses.replace(read_vehicle("half_car"), implementation=Implementation(sample_period=0.01, delay=1.5))
    controller = designed(vehicle, "I")
    margins = {name: implemented_searches(vehicle, controller, cut, 1e-3) for name, cut in loops_of(vehicle).items()}
    find_all([*margins.values()])
    assert all(one.agrees for one in margins.values())
    assert min(one.predicted.gain for one in margins.values()) == margins[""].predicted.gain
    assert margins[""].found_delay == margins[""].predicted_delay
    assert all(math.isnan(one.found_delay) for name, one in margins.items() if name)


def test_a_kink_at_equilibrium_has_no_derivative(paper):
    """A damper whose characteristic bends at equilibrium has no derivative there: that is the message. Its line has one."""
    kinked = "[curves]\nsuspension_damping = { velocity = [-1, 0, 1], force = [-500, 0, 900] }\n"
    vehicle = parse_vehicle(re.sub("suspension_damping = 400.*", "", paper.text) + kinked)
    with pytest.raises(InputError, match="no derivative at equilibrium"):
        step_derivative(vehicle, 1e-3)
    assert np.isfinite(step_derivative(at_rest(vehicle), 1e-3).A).all()
