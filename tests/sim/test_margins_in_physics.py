"""Margins in MuJoCo: its runs turn from decay to growth where the loop transfer function predicts."""

import dataclasses
import json
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from models.document.field import cells
from models.laws.linear import LinearLaw, static_law
from models.vehicle.limits_and_implementation import Limits
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.margins import main
from sim.studies.stability.edge import StabilityEdge, search_and_run, smallest_unstable
from sim.studies.stability.margin_search import GainMargin, LoopMargins, find_margins, searches
from sim.studies.stability.margins import StabilityMargins
from sim.studies.stability.report import LOOP, MARGINS, _loop_rows
from synth.controller.controller import Controller
from synth.controller.loop_of import loop_of
from synth.controller.sample_period_margin import largest_sample_period
from synth.vehicle.designer import certify_given, design
from tests.conftest import recorded_runs
from tests.support.commands import attacks
from tests.support.shared import designed


@pytest.mark.parametrize("expected", [3.0, 17.0, 17.5, 18.0, 200.0, math.inf])
def test_search_does_not_believe_its_expectation(expected):
    """MuJoCo decides where a search ends; if the expectation is right, it looks at two amounts."""
    asked = []

    def grows(amount):
        asked.append(amount)
        return amount > 17.5

    assert smallest_unstable(grows, expected, 100.0, 1.0) == (17.0, 18.0)
    assert expected != 17.5 or sorted(asked) == [17.0, 18.0]
    assert smallest_unstable(lambda amount: False, math.inf, 10.0, 1.0) == (10.0, math.inf)
    stable, unstable = smallest_unstable(grows, expected, 100.0)
    assert stable <= 17.5 < unstable < stable * 1.0021


@pytest.mark.attack
def test_command(capsys, tmp_path):
    """The command agrees, draws the margins and records both sides of the delay margin; only sampling limits II's gain."""
    pytest.importorskip("matplotlib", reason="pictures are in the extra [report]")
    asked = ["--controller", "II", "--timestep", "3e-3", "--json"]
    assert main([*asked, "--picture", str(tmp_path / "m.svg"), "--logs", str(tmp_path)]) == 0
    captured = capsys.readouterr()
    result = json.loads(captured.out)
    assert captured.err == ""
    assert "</svg>" in (tmp_path / "m.svg").read_text()
    assert recorded_runs(result["logs"]["mcap"]) == {f"II_{late}_samples_late" for late in (28, 29)}
    assert (result["gain"]["predicted"], result["gain"]["found"]) == (None, None)
    coarse, fine = result["gain"]["sampled"]
    assert coarse["timestep"] == 2 * fine["timestep"] == 3e-3
    assert fine["found"] == pytest.approx(2 * coarse["found"], rel=2e-2)  # first order in the step
    assert result["delay"]["found"] == pytest.approx(0.0870, abs=1e-9)  # a sample less decays
    assert result["phase"]["found"] == pytest.approx(result["delay"]["found"] * result["phase"]["frequency"])


def told_of(vehicle: Vehicle, controller: Controller, one: LoopMargins) -> dict[str, str]:
    """Returns the rows of a loop's table by the name of the margin."""
    found = StabilityMargins(vehicle, controller, {"": one}, {})
    return {name: " ".join(rest) for name, *rest in cells(MARGINS, _loop_rows(found, one))}


def test_one_force_sampled_in_physics():
    """A lagging law's rear force alone bears a sample period of 85.4 ms, by 2.6 ms more than both do; so it is in MuJoCo."""
    vehicle = read_vehicle("half_car")
    controller, lags = designed(vehicle, "I"), np.diag([40.0, 60.0, 50.0, 70.0])
    lagging = dataclasses.replace(controller, law=LinearLaw(-lags, lags, controller.gain, np.zeros((2, 4))))
    assert largest_sample_period(loop_of(vehicle, lagging)) == pytest.approx(0.0828, abs=1e-4)
    one = searches(vehicle, lagging, [1], 2e-3)
    search_and_run([one.sample_period])
    assert one.predicted.sample_period == pytest.approx(0.0854, abs=1e-4)
    assert 0 <= one.predicted.sample_period - one.found_sample_period < 2e-3  # a timestep
    whole = dataclasses.replace(one, predicted=dataclasses.replace(one.predicted, all_sampled=True))
    told = ["all forces sampled" in told_of(vehicle, lagging, each)["sample period [ms]"] for each in (one, whole)]
    assert told == [False, True]


THROWN = {
    "sprung_mass": 511.5,
    "pitch_inertia": 798.2,
    "axle_distance_front": 1.158,
    "axle_distance_rear": 1.603,
    **{"unsprung_mass_front": 58.42, "suspension_stiffness_front": 22290.0, "suspension_damping_front": 767.7},
    **{"unsprung_mass_rear": 54.47, "suspension_stiffness_rear": 32400.0, "suspension_damping_rear": 759.5},
    **{"tyre_stiffness_front": 184500.0, "tyre_stiffness_rear": 159100.0},
}


def test_a_margin_is_that_of_wheels_on_the_road():
    """A force of 1.5 MN per metre at its rear axle lifts a wheel over 2 mm, and no such run grows or decays."""
    vehicle, timestep = read_vehicle("half_car").with_parameters(**THROWN), 1e-3
    law = static_law(np.array([[10278.0], [5003.0]]))
    gain = searches(vehicle, certify_given(vehicle, "c", ["suspension_deflection_front"], law), [1], timestep).gain
    search_and_run([gain.search])
    assert gain.search.found == pytest.approx(gain.sampled[0], rel=5e-3)  # asked for; the section ends at 0.2 %


@pytest.mark.parametrize(
    ("kind", "name", "actuators", "timestep"),
    [
        ("quarter_car", "I", [0], 1e-3),
        *attacks([("quarter_car", "state", [0], 2e-3)]),  # whose sample period is any
        ("half_car", "I", [0, 1], 3e-3),
        ("half_car", "I", [1], 3e-3),
    ],
)
def test_gain_delay_and_sample_period_in_physics(kind, name, actuators, timestep):
    """One actuator, two with a common factor or delay, and one of two: delay and period to a sample, the gain to 0.5 %."""
    vehicle = read_vehicle(kind)
    one = searches(vehicle, designed(vehicle, name), actuators, timestep)
    search_and_run([one.gain.search, one.delay, one.sample_period])
    assert abs(one.delay.unstable - one.predicted.delay) <= timestep
    assert one.found_sample_period == pytest.approx(one.predicted.sample_period, abs=timestep)
    assert one.gain.search.found == pytest.approx(one.gain.sampled[0], rel=5e-3)  # asked for; the section ends at 0.2 %


def test_a_delay_that_takes_hours_is_not_run(paper):
    """A slow integral bears minutes of delay: runs have 2 s at most, and what they do not decide is no disagreement."""
    pid = 'measured = ["suspension_deflection"]\npid = { kp = -500, ki = -50, kd = -50, filter = 0.02 }\n'
    vehicle = parse_vehicle(f"{paper.text}\n[controllers.slow]\n{pid}")
    controller = design(vehicle, "slow")
    one = find_margins(vehicle, controller, 4e-3)[""]
    assert one.predicted.delay > 60
    assert one.delay.stable == pytest.approx(2.0)
    assert one.agrees
    assert math.isnan(one.found_phase)
    assert "stable up to 2 s; above 8 s only predicted" in told_of(vehicle, controller, one)["delay [ms]"]


def test_infinite_margins_in_physics(paper):
    """If |L| < 1 everywhere no delay and no sample period destabilises, and no gain but the sampling's; nor in MuJoCo."""
    name, gain = "weak", -250.0
    text = f'{paper.text}\n[controllers.{name}]\nmeasured = ["sprung_velocity"]\ngain = [[{gain}]]\n'
    vehicle = parse_vehicle(text)
    found = find_margins(vehicle, design(vehicle, name), 16e-3)[""]
    assert found.predicted.delay == found.predicted.sample_period == found.predicted.gain == math.inf
    assert found.delay.unstable == found.sample_period.unstable == found.gain.found == found.found_phase == math.inf
    assert found.found_gain_lower == 0
    assert found.agrees


def search_that_found(amount: float) -> StabilityEdge:
    """A search that has ended there; nowhere if it is infinite."""
    ends = (1.0, math.inf) if math.isinf(amount) else (0.9995 * amount, 1.0005 * amount)
    step: Any = SimpleNamespace(dt=1e-3)
    trial: Any = float
    return StabilityEdge(step, trial, amount, 32.0, 0.0, *ends, searched=True)


@pytest.mark.parametrize(
    ("own", "sampled", "found", "agrees"),
    [
        (14.24, (13.62, 13.93), (13.62, 13.93), True),  # the hold's share goes with the step
        (14.24, (13.62, 13.93), (14.1, 14.17), False),  # tends to the loop's own, but is not the sampled loop
        (14.24, (13.62, 13.62), (13.62, 13.62), False),  # is the sampled loop, which does not tend to the loop's own
        (104.31, (81.46, 91.47), (81.46, 91.47), True),  # an actuator's lag: the hold's share has a second power of the step, too
        (108.0, (81.46, 91.47), (81.46, 91.47), False),  # by more than half of what the halving moved
        (math.inf, (225.0, 450.0), (225.0, 450.0), True),
        (math.inf, (225.0, 450.0), (225.0, 226.0), False),
        (math.inf, (math.inf, math.inf), (20.0, 20.0), False),  # no margin was predicted, and there is one
    ],
)
def test_gain_margin_is_held_against_both_loops(own, sampled, found, agrees):
    """The margin in physics must be the sampled loop's at every step, and tend to the loop's own: one is not enough."""
    search, finer = (search_that_found(amount) for amount in found)
    assert GainMargin(own, sampled, search, finer).agrees is agrees


@pytest.mark.parametrize("step", [False, True])
def test_a_limit_of_two_runs_is_no_run(paper, designer, step):
    """A gain that MuJoCo has at no step of its own is extrapolated, in words and in --json; one that it ran is not."""
    one = searches(paper, designer.design("I"), [0], 1e-3)
    coarse, fine = (search_that_found(one.predicted.gain + away) for away in ((-0.02, -0.01) if step else (0.0, 0.0)))
    fine = fine if step else dataclasses.replace(fine, searched=False)
    gain = GainMargin(one.predicted.gain, (coarse.found, fine.found), coarse, fine)
    lower = dataclasses.replace(one.gain_lower, search=search_that_found(math.inf))
    one = dataclasses.replace(one, gain=gain, gain_lower=lower)
    row = told_of(paper, designer.design("I"), one)["gain, factor"]
    assert gain.found == pytest.approx(one.predicted.gain, rel=1e-6)
    assert ("extrapolated" in row) == LOOP(one)["gain"]["extrapolated"] == step


@pytest.mark.parametrize(
    ("measured", "gain", "bandwidth", "timestep", "steps"),
    [
        *(
            (("suspension_deflection", "sprung_velocity"), (13100 / own, -1500.0), None, 4e-3, steps)
            for own, steps in ((290.0, 3), (400.0, 3), (9000.0, 3), (math.inf, 2))
        ),
        (("suspension_deflection",), (-2000.0,), 300.0, 8e-3, 3),  # the lag's share has higher powers of the step
        (("sprung_velocity",), (-3000.0,), 60.0, 16e-3, 3),
    ],
)
def test_a_margin_beyond_that_of_sampling(paper, measured, gain, bandwidth, timestep, steps):
    """Sampling alone is unstable from 168 times the gain on; finer steps show that the spring is cancelled at 290 to 9000."""
    vehicle = dataclasses.replace(paper, limits=Limits(actuator_bandwidth=bandwidth))
    controller = certify_given(vehicle, "own", measured, static_law(np.array([gain])))
    margin = searches(vehicle, controller, [0], timestep).gain
    if bandwidth is None:
        assert margin.own == pytest.approx(13100 / gain[0] if gain[0] else math.inf, rel=1e-6)
    for one in margin.searches:
        one.search()
    assert margin.search.found == pytest.approx(margin.sampled[0], rel=5e-3)
    assert margin.search.found < margin.own
    assert len(margin.searches) == steps
    assert margin.agrees
    assert margin.found == pytest.approx(margin.own, rel=5e-2 if bandwidth else 2e-3)


def test_an_instability_between_two_steps(paper):
    """Sampled every 43.2 to 46.7 ms this loop is unstable. Multiples of 8 ms pass over that, and the linear loop's, too."""
    parameters = {"sprung_mass": 857.2, "unsprung_mass": 36.84, "suspension_stiffness": 23277.0, "suspension_damping": 254.5}
    vehicle = paper.with_parameters(**parameters, tyre_stiffness=156441.0)
    A, B, C, D = (np.array([[number]]) for number in (-16.8184, 1.0, 682817.68, -25017.84))
    law = LinearLaw(A, B, C, D)
    one = searches(vehicle, certify_given(vehicle, "filtered", ("suspension_deflection",), law), [0], 8e-3)
    assert one.predicted.sample_period == pytest.approx(43.2e-3, abs=0.1e-3)
    for edge in (one.gain.search, one.gain_lower.search, one.delay, one.sample_period):
        edge.search()
    assert one.sample_period.unstable == math.inf
    assert one.agrees
    assert not dataclasses.replace(one, slow_grows=lambda period: period > 0.1).agrees
    fast = dataclasses.replace(one.sample_period, unstable=32e-3)
    assert not dataclasses.replace(one, sample_period=fast, slow_grows=lambda period: period >= 32e-3).agrees
