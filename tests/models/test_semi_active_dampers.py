"""Adjustable dampers: the forces that they give, and the requested forces that are missing."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from models.roads.choice import choose_road
from models.roads.iso8608 import Iso8608
from models.roads.loads.load import Lift
from models.roads.loads.road_with_loads import RoadWithLoads
from models.roads.road import Bump, Road
from models.vehicle.vehicle import parse_vehicle
from sim.linear.sampled_response import largest_timestep
from sim.runs.record import RUN
from sim.runs.report import reasons, verdict
from sim.runs.run import run_controllers, sample_times
from sim.studies.ride.expected import expect
from synth.controller.controller import Controller
from synth.vehicle.designer import design
from tests.support.analysed import energy, sampled_response, simulate
from tests.support.commands import in_the_suite

QUARTER = """
type = "quarter_car"
[parameters]
sprung_mass = 504.5
unsprung_mass = 62.0
suspension_stiffness = 13100.0
suspension_damping = 1000.0
tyre_stiffness = 252000.0
[performance]
sprung_acceleration = 1.0
control_force = 1e-4
[controllers.sky]
measured = ["sprung_velocity", "unsprung_velocity"]
gain = [[-3000.0, 500.0]]
[controllers.leaky]
measured = ["suspension_deflection", "sprung_acceleration"]
A = [[-0.5]]
B = [[0.0, 1.0]]
C = [[-2000.0]]
D = [[11000.0, 0.0]]
"""
DAMPER = """
[actuators]
kind = "damper"
c_min = 300.0
c_max = 4000.0
"""
LATE = """
[implementation]
sample_period = 0.005
delay = 0.4
"""
HALF = """
type = "half_car"
[parameters]
sprung_mass = 690.0
pitch_inertia = 1222.0
axle_distance_front = 1.3
axle_distance_rear = 1.5
unsprung_mass_front = 40.0
unsprung_mass_rear = 45.0
suspension_stiffness_front = 18000.0
suspension_stiffness_rear = 22000.0
suspension_damping_front = 1000.0
suspension_damping_rear = 1000.0
tyre_stiffness_front = 200000.0
tyre_stiffness_rear = 200000.0
[performance]
heave_acceleration = 1.0
[actuators.front]
kind = "damper"
c_min = 300.0
c_max = 3000.0
[actuators.rear]
kind = "REAR"
[controllers.sky]
measured = ["heave_velocity", "pitch_rate"]
gain = [[-2000.0, 2600.0], [-2000.0, -3000.0]]
"""
MIXED = HALF.replace('"REAR"', '"force"')
BOTH = HALF.replace('"REAR"', '"damper"\nc_min = 400.0\nc_max = 2500.0\nbandwidth = 90.0')
BUMP = Bump(0.1, 5.0, 12.5)


@cache
def runs(text, *names, road: Road = BUMP, duration=0.8):
    """The runs of some controllers, which several tests look at."""
    vehicle = parse_vehicle(text)
    return run_controllers(vehicle, [design(vehicle, name) for name in names], road, sample_times(vehicle, duration, 1e-3))


def check_physics(run):
    """A run agrees to rounding, and its dampers dissipate energy at every sample."""
    assert run.passed
    assert run.agreement.steps is not None
    assert run.agreement.commands is not None
    assert max(run.agreement.steps.error, run.agreement.commands.error) < 1e-10
    assert run.energy is not None
    assert run.energy.least is not None
    assert run.energy.least >= 0.0


def test_one_for_all_and_for_one():
    """The keys of [actuators] go for every suspension that has no section, and for what its section leaves out."""
    text = HALF[: HALF.index("[actuators.front]")] + DAMPER + "[actuators.rear]\nc_max = 2500.0\nbandwidth = 80.0\n"
    front, rear = parse_vehicle(text).parts.adjustable
    assert front.force == "control_force_front"
    assert (front.damper.c_min, front.damper.c_max, front.damper.bandwidth) == (300, 4000, None)
    assert (rear.force, rear.damper.c_min, rear.damper.c_max, rear.damper.bandwidth) == ("control_force_rear", 300, 2500, 80)
    (only,) = parse_vehicle(MIXED).parts.adjustable
    assert (only.force, only.coefficient, only.missing) == ("control_force_front", "damping_front", "missing_force_front")
    (other,) = parse_vehicle(text.replace("c_max = 2500.0\nbandwidth = 80.0", 'kind = "force"')).parts.adjustable
    assert other.force == "control_force_front"


@pytest.mark.parametrize("name", ["passive", "sky", "leaky"])
def test_what_a_damper_gives(name):
    """At every sample u = -(c - c_s) v, with c the nearest to c_s - u*/v that there is, and what is missing is u* - u.

    All are products of the same doubles, so they are alike to rounding: 1e-9 N of some thousand.
    """
    (run,) = runs(QUARTER + DAMPER, name)
    physics = run.physics
    v = physics["sprung_velocity"] - physics["unsprung_velocity"]
    u, c = physics["control_force"], physics["damping"]
    asked = u + physics["missing_force"]
    assert np.abs(u + (c - 1000.0) * v).max() < 1e-9
    assert c.min() >= 300.0
    assert c.max() <= 4000.0
    moving = np.abs(v) > 1e-9
    assert np.allclose(c[moving], np.clip(1000.0 - asked[moving] / v[moving], 300.0, 4000.0), rtol=0, atol=1e-6)
    if name == "passive":
        assert np.all(c == 1000.0)
        assert not asked.any()
    elif name == "sky":
        assert np.abs(asked - (-3000.0 * physics["sprung_velocity"] + 500.0 * physics["unsprung_velocity"])).max() < 1e-9
        assert {300.0, 4000.0} <= set(c)


def test_passive_is_the_linear_vehicle():
    """A damper of which nothing is asked makes the run of the vehicle that has none, to the last bit."""
    (damper,), (none,) = runs(QUARTER + DAMPER, "passive"), runs(QUARTER, "passive")
    for name in none.physics.names:
        assert np.array_equal(damper.physics[name], none.physics[name])
    assert damper.qpos is not None
    assert none.qpos is not None
    assert np.array_equal(damper.qpos, none.qpos)


DRIVEN = {
    "states, lag, late": (QUARTER + DAMPER + "bandwidth = 100.0\n" + LATE, "leaky"),
    "static": (QUARTER + DAMPER, "sky"),
    "static, late": (QUARTER + DAMPER + LATE, "sky"),
    "a force behind": (MIXED, "sky"),
    "one of two lags": (BOTH, "sky"),
}


@pytest.mark.parametrize("of", in_the_suite(["states, lag, late"], DRIVEN))
def test_a_run_agrees(of):
    """Under a lift MuJoCo's steps are those of the equations to rounding, and its commands are those of the law."""
    text, name = DRIVEN[of]
    (run,) = runs(text, name, road=RoadWithLoads(BUMP, (Lift(start=0.1, rise=0.1),)))
    check_physics(run)
    assert verdict(run).text.startswith("MuJoCo agrees with the model; no linear analysis")


@pytest.mark.parametrize(
    ("law", "more", "road"),
    [
        ("skyhook_linear", "[implementation]\nnoise = { unsprung_velocity = 1e-3 }\n", "flat"),
        pytest.param("hybrid", "", "flat + payload:mass=60", marks=pytest.mark.attack),  # a ratio of two rounded velocities
    ],
)
def test_rounding_agrees(law, more, road):
    """If a car stands still, the velocities that a law compares are rounding alone, and its run agrees."""
    vehicle = parse_vehicle(f'{QUARTER}{DAMPER}{more}[controllers.law]\nsemi_active = "{law}"\n')
    on = choose_road(road).build(vehicle, 15.0, 0, 10.0)
    (run,) = run_controllers(vehicle, [vehicle.controllers["law"].driver()], on, sample_times(vehicle, 0.65, 1e-3))
    assert run.agrees
    assert road != "flat" or 0 < run.physics.peak("control_force") < 1e-9


def test_a_damper_takes_energy():
    """The power of a damper is never below zero in physics, and one that gave energy would not balance."""
    (run,) = runs(QUARTER + DAMPER, "sky")
    check_physics(run)
    assert run.energy is not None
    assert reasons(run)[-1].text.startswith("energy balances")
    worse = replace(run, energy=replace(run.energy, least=-1e-3))
    assert not worse.passed
    assert "a semi-active damper supplied energy, 1.0e-03 of the largest energy that it absorbed" in reasons(worse)[-1].text
    at_once = energy(run.vehicle, simulate([run.vehicle], [run.controller], [BUMP], run.physics.time[:3]), 0, BUMP, 0.0)
    assert (at_once.residual, at_once.least, at_once.loads) == (0.0, 0.0, None)  # of a run that breaks off at once
    (none,) = runs(QUARTER, "passive")
    assert none.energy is not None
    assert none.energy.least is None


def test_what_is_missing_is_said():
    """The verdict says when a force was first not given, and how much of all was not; and so does JSON."""
    (run,) = runs(QUARTER + DAMPER, "sky")
    physics = run.physics
    asked = physics["control_force"] + physics["missing_force"]
    rms, share = float(np.std(physics["missing_force"])), float(np.mean(np.abs(physics["missing_force"]) > 1e-3))
    rms = float(np.sqrt(np.mean(physics["missing_force"] ** 2)) / np.sqrt(np.mean(asked**2)))
    found = RUN(run)["dampers"]["shortfall"]["control_force"]
    assert found.pop("late") is None
    assert found == pytest.approx({"rms": rms, "time": share, "softest": 300.0, "hardest": 4000.0}, rel=1e-9)
    first = float(physics.time[np.argmax(np.abs(physics["missing_force"]) > 1e-3)])
    lines = [one.text for one in reasons(run)]
    assert any(line.startswith("damper: ") and f"at {first:.4g} s" in line for line in lines)
    said = f"{100 * rms:.2g} % (rms) of the requested force is missing, at {100 * share:.2g} % of the samples"
    assert any(said in line for line in lines)
    assert run.agreement.until == np.inf
    assert run.agreement.end_times["damper"] == first
    (none,) = runs(QUARTER + DAMPER, "passive")
    assert "dampers" in RUN(none)
    assert not any("damp" in line.text for line in reasons(none))
    assert "dampers" not in RUN(runs(QUARTER, "passive", duration=0.1)[0])


def test_what_a_valve_keeps_back_is_said():
    """A slow valve leaves out force within its range too: a single exponential, integrated apart, says how much."""
    (run,) = runs(QUARTER + DAMPER + "bandwidth = 2.0", "sky")
    physics, h = run.physics, 1e-3
    v = physics["sprung_velocity"] - physics["unsprung_velocity"]
    asked = -3000.0 * physics["sprung_velocity"] + 500.0 * physics["unsprung_velocity"]
    set_to = np.clip(np.divide(asked, -v, out=np.zeros_like(v), where=v != 0), 300.0 - 1000.0, 4000.0 - 1000.0)
    acting = np.zeros_like(v)
    for k in range(len(v) - 1):
        acting[k + 1] = set_to[k] + (acting[k] - set_to[k]) * np.exp(-2.0 * h)
    left = float(np.sqrt(np.mean((asked + acting * v) ** 2)) / np.sqrt(np.mean(asked**2)))
    found = RUN(run)["dampers"]["shortfall"]["control_force"]
    assert found["late"] == pytest.approx(left, rel=1e-4)  # RK4's own exponential, and where v is 0
    assert found["late"] > found["rms"]


def test_the_linear_response_foretells_the_first_force_missing():
    """Until a force is missing the vehicle is linear, so the linear response says when that is, to a sample."""
    (run,) = runs(QUARTER + DAMPER, "sky")
    assert isinstance(run.controller, Controller)
    linear = sampled_response(run.vehicle, run.controller, BUMP, run.physics.time)
    first = linear.time[np.argmax(np.abs(linear["missing_force"]) > 1e-3)]
    assert abs(first - run.agreement.end_times["damper"]) < 1.5e-3


def test_a_timestep_that_rk4_bears_with_every_coefficient():
    """The largest timestep is that of the hardest damper, and of its valve."""
    usual = largest_timestep(parse_vehicle(QUARTER))
    assert largest_timestep(parse_vehicle(QUARTER + DAMPER)) <= usual
    assert largest_timestep(parse_vehicle(QUARTER + DAMPER.replace("4000", "40000"))) < 0.5 * usual
    assert largest_timestep(parse_vehicle(QUARTER + DAMPER + "bandwidth = 5000.0")) == pytest.approx(2.785 / 5000.0, rel=0.01)


def test_nothing_is_expected_of_a_damper_that_is_asked():
    """Over random roads metrics are expected of passive suspensions, and of no controller that its damper leaves short."""
    vehicle = parse_vehicle(QUARTER + DAMPER)
    spectrum = Iso8608("C", 1, 10.0, 0.0, 100.0).spectrum
    assert expect(vehicle, design(vehicle, "passive"), spectrum, 1e-3, 10.0) is not None
    assert expect(vehicle, design(vehicle, "sky"), spectrum, 1e-3, 10.0) is None
    assert expect(vehicle.with_ideal_actuators, design(vehicle, "sky"), spectrum, 1e-3, 10.0) is not None


def test_a_delay_acts_on_the_coefficient():
    """Two samples late, the damper has the coefficient of the velocities of then, and its force is that of the velocity now."""
    late = "[implementation]\nsample_period = 4e-3\ndelay = 2\n"
    vehicle = parse_vehicle(f'{QUARTER}{DAMPER}{late}[controllers.law]\nsemi_active = "skyhook_linear"\n')
    (run,) = run_controllers(vehicle, [vehicle.controllers["law"].driver()], BUMP, sample_times(vehicle, 0.5, 1e-3))
    (damper,), nominal = vehicle.dampers.values(), vehicle.parameters["suspension_damping"]
    body, wheel, c = (run.physics[name] for name in ("sprung_velocity", "unsprung_velocity", "damping"))
    for k in range(8, 500, 4):  # c acts from sample k on, and was computed two samples before
        v = body[k - 8] - wheel[k - 8]
        asked = damper.c_max * body[k - 8] / v if body[k - 8] * v > 0 else damper.c_min
        assert c[k] == pytest.approx(np.clip(asked, damper.c_min, damper.c_max), rel=1e-9)
    assert run.physics["control_force"] == pytest.approx(-(c - nominal) * (body - wheel), abs=1e-6)
    assert "delay acts on the damping coefficient, not on the force" in " ".join(one.text for one in reasons(run))
