"""Growth and decay of MuJoCo's runs: the rate of the slowest mode, and the linear loop that confirms a run."""

import dataclasses
import math

import numpy as np
import pytest

from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.studies.stability import growth_test
from sim.studies.stability.bisection import Bisection
from sim.studies.stability.delayed import delayed_rate
from sim.studies.stability.growth_test import Growth, Trial, grows
from sim.studies.stability.late_loop import LateLoop, late_loop
from sim.studies.stability.margin_search import searches
from sim.studies.stability.slowest_mode import slowest_rate
from synth.controller.open_loop import LoopModel
from tests.support.analysed import sampled_radius
from tests.support.shared import designed


def test_a_faint_mode_that_creeps(monkeypatch):
    """Errors 0.7 % beyond those that a law with states bears make a mode grow in 100 s, which a bump hardly moves.

    The law's own states are in the run's record, so that the mode is told from all others within two seconds.
    """
    entry = '[controllers.best]\nmeasured = ["suspension_deflection", "sprung_acceleration", "control_force"]\norder = "full"\n'
    vehicle, timestep = parse_vehicle(read_vehicle("quarter_car").text + entry), 2e-3
    controller, signs = designed(vehicle, "best"), np.array([1, -1, -1])
    off = [dataclasses.replace(controller, law=controller.law.read_as(1 + size * signs)) for size in (0.110, 0.112)]
    rates = [math.log(LoopModel(vehicle, one, timestep).radius) / timestep for one in off]
    assert -0.02 < rates[0] < 0 < rates[1] < 0.02  # the other modes decay by 5 1/s
    monkeypatch.setattr("sim.studies.stability.growth_test._growth", lambda *rest: pytest.fail("it is not settled in time"))
    found = grows([Trial(vehicle, one) for one in off], timestep)
    assert [one.grows for one in found] == [False, True]
    assert [one.rate for one in found] == pytest.approx(rates, rel=0.1)  # of what geometry makes of a faint mode


@pytest.mark.parametrize("rate", [-1e-3, 1e-3])
def test_a_run_does_not_decide_a_mode_that_creeps(rate):
    """A run that does not show what moves by 3 % in 32 s does not contradict its loop; one that grows fast does."""
    loop = LateLoop(np.array([[math.exp(1e-3 * rate)]]), np.zeros((1, 1)), np.zeros((1, 1)), 0, 1, 1e-3)
    assert growth_test._creeps(loop, Growth(rate < 0, -5e-4 if rate > 0 else 5e-4))
    assert not growth_test._creeps(loop, Growth(rate > 0))
    assert not growth_test._creeps(loop, Growth(True, 0.1))
    search = Bisection(
        lambda amount: pytest.fail("it has run"), 1.0, 2.0, tried={0.999: Growth(False), 1.001: Growth(True, decided=False)}
    )
    assert math.isnan(search.found)


def test_a_run_of_which_nothing_is_left_decays():
    """A run is still if nothing is left in its last quarter, and in as many samples as a force may be on its way: it decays."""
    states = np.zeros((2, 4, 200))
    for i, until in enumerate((140, 160, 100, 120)):
        states[:, i, :until] = 1.0
    still = [growth_test._still(states[:, i], samples) for i, samples in enumerate((4, 4, 90, 90))]
    assert still == [True, False, True, False]
    assert [growth_test._grows(states[:, 2], math.nan, last) for last in (False, True)] == [False, False]


@pytest.mark.parametrize(
    ("rate", "follows", "grows"), [(0, True, False), (0, False, None), (2e-9, True, True), (-2e-9, True, False)]
)
def test_a_state_that_stands_does_not_grow(paper, designer, rate, follows, grows):
    """A state that stays, as of an integrator that nothing reads, does not grow if the run follows its loop; a slow mode may."""
    timestep, modes = 2e-3, np.array([rate, -3.0, -5.0])
    mixed = np.array([[1.0, 0.5, 0.2], [-0.3, 1.0, 0.4], [0.1, -0.6, 1.0]])
    loop = LateLoop(mixed * np.exp(modes * timestep) @ np.linalg.inv(mixed), np.zeros((3, 1)), np.zeros((1, 3)), 0, 1, timestep)
    time = np.arange(2000) * timestep
    states = mixed @ np.exp(modes[:, None] * time) + (1e-9 if follows else 0.2) * np.sin(700 * time)
    trial = Trial(paper, designer.design("I"))
    found = growth_test._confirmed(trial, loop, states, np.ones(3), np.zeros((0, 2000)), timestep, 4.0)
    assert (None if found is None else found.grows) is grows


def test_a_rate_is_read_before_a_wheel_may_lift():
    """The rate of a run that grows is that of its first course, however small: what is 25 times its first energy is left out."""
    time = np.arange(4000) * 1e-3
    lifts = 3.3  # s; the energy of its first second is 25 times as large at 3.16 s
    size = 1e-2 * np.exp(0.9 * np.minimum(time, lifts) - 3.0 * np.maximum(time - lifts, 0.0))
    states = size * np.stack([np.cos(8 * time), np.sin(8 * time)])
    assert growth_test._rate(states, 1e-3, 1) == pytest.approx(0.9, rel=1e-6)


@pytest.mark.parametrize("amount", [0.3, 0.9])
def test_points_of_the_picture_are_the_slowest_pole(paper, designer, amount):
    """The stated decay of a run of MuJoCo is the slowest pole of its sampled loop, not what the bump excites most."""
    controller, timestep = designer.design("II"), 1e-3
    one = searches(paper, controller, [0], timestep)
    for search, unit in ((one.gain.search, one.gain.sampled[0]), (one.delay, one.predicted.delay)):
        trial = search.trial(amount * unit if search is one.gain.search else round(amount * unit / timestep) * timestep)
        (growth,) = grows([trial], timestep)
        rate = math.log(sampled_radius(trial.vehicle, trial.controller, timestep)) / timestep
        assert growth.rate == pytest.approx(rate, rel=1e-3)  # what is left unexplained is below 1e-4 of the samples


@pytest.mark.parametrize(("kind", "name", "delay"), [("quarter_car", "I", 0), ("quarter_car", "I", 70), ("full_car", "II", 10)])
def test_a_delayed_loop_needs_no_eigenvalue_of_what_is_on_its_way(kind, name, delay):
    """The rate by the map over a whole delay is that of the loop from sample to sample, whichever of the two ways finds it."""
    vehicle, timestep = read_vehicle(kind), 5e-4
    controller = designed(vehicle, name)
    late = dataclasses.replace(vehicle, implementation=Implementation(delay=delay))
    expected = math.log(sampled_radius(late, controller, timestep)) / timestep
    found = delayed_rate(vehicle, controller, timestep, delay)
    assert found == pytest.approx(expected, abs=1e-7)  # rounding of the eigenvalues over a timestep; measured 2e-8


@pytest.mark.attack
def test_a_loop_that_is_not_the_runs_confirms_nothing(monkeypatch):
    """A run has the same end with its loop, without a loop, and with a loop that does the contrary."""
    vehicle, timestep = read_vehicle("half_car"), 4e-3
    one = searches(vehicle, designed(vehicle, "I"), [0], timestep)
    trials = [search.trial(amount) for search in (one.gain.search, one.delay, one.sample_period) for amount in search.next()[:2]]
    ends = []
    for what in (late_loop, lambda *asked: None, contrary):
        monkeypatch.setattr("sim.studies.stability.growth_test.late_loop", what)
        ends.append([each.grows for each in grows(trials, timestep)])
    assert {*ends[0]} == {True, False}
    assert ends[0] == ends[1] == ends[2]


def contrary(*asked):
    """A loop that grows where the trial's decays, and the other way round, by as much as it can be told apart."""
    loop = late_loop(*asked)
    assert loop is not None
    return dataclasses.replace(loop, Phi=loop.Phi * math.exp(-2.2 * loop.rate * loop.timestep))


@pytest.mark.parametrize(
    ("kind", "actuators", "how"),
    [
        ("quarter_car", [0], {}),
        ("half_car", [0, 1], {"delay": 40}),
        ("half_car", [0, 1], {"sample_period": 0.06}),
        ("half_car", [1], {"delay": 1}),
    ],
)
def test_late_loop(kind, actuators, how):
    """Its rate is that of the loop as it is implemented, and what it makes of its own past is its own future, mode and all."""
    vehicle, timestep = read_vehicle(kind), 2e-3
    controller = designed(vehicle, "I")
    mine = np.isin(np.arange(len(vehicle.linear_model.inputs)), actuators)
    late, rest = (dataclasses.replace(controller, law=controller.law.only(part)) for part in (mine, ~mine))
    vehicle = dataclasses.replace(vehicle, implementation=Implementation(**how))
    loop = late_loop(vehicle, late, rest if rest.law.acts else None, timestep)
    assert loop is not None
    if not rest.law.acts:
        expected = sampled_radius(vehicle, controller, timestep)
        assert loop.rate == pytest.approx(math.log(expected) / timestep, rel=1e-4)  # of RK4 and rounding
    run = loop.goes_on(np.ones((len(loop.Phi), 1)) * np.eye(1, 3000), 0)
    np.testing.assert_array_equal(loop.goes_on(np.where(np.arange(3000) > 600, np.nan, run), 600), run)
    rate, off = loop.slowest_mode(run, 240)  # a sample of each, after the longest delay
    assert off < 1e-6  # rounding, of what has grown or decayed over 5.5 s
    assert rate == pytest.approx(loop.rate, rel=1e-6)
    over = [np.linalg.norm(run[:, k : k + 500]) for k in (1000, 2500)]
    assert math.log(over[1] / over[0]) / (1500 * timestep) == pytest.approx(loop.rate, abs=1.0)  # what is left of it


def test_slowest_mode_of_known_modes():
    """A mode a millionth as loud as the others is found; noise is no mode; what grows beyond all linearity is left out."""
    time = np.arange(4000) * 1e-3
    modes = [np.exp(-3.0 * time) * np.cos(60 * time), np.exp(-2.0 * time) * np.sin(5 * time), 1e-6 * np.exp(-0.5 * time)]
    states = np.array([[1.0, 0.5, 1.0], [0.3, -1.0, 2.0], [0.1, 0.2, -1.0]]) @ np.array(modes)
    assert slowest_rate(states, 1e-3, 1) == pytest.approx(-0.5, rel=1e-6)
    assert slowest_rate(states, 1e-3, 300) == pytest.approx(-0.5, rel=1e-6)  # a controller that holds for long
    assert math.isnan(slowest_rate(np.random.default_rng(0).standard_normal((3, 4000)), 1e-3, 1))
