"""Adjustable dampers: what they can give, their exact response, and what of what was asked is missing."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from models.roads.choice import choose_road
from models.roads.iso8608 import Iso8608
from models.roads.load import Lift
from models.roads.loaded import RoadWithLoads
from models.roads.road import Bump, Road, RoadInput
from models.vehicle.vehicle import parse_vehicle
from sim.linear.dampers import scaled_commands
from sim.linear.forced_response import forced_response
from sim.linear.sampled_response import largest_timestep
from sim.runs.prediction import NEAR
from sim.runs.report import energy_lines, run_object, verdict, verdict_lines
from sim.runs.run import compare_runs, run_controllers, sample_times
from sim.studies.ride.expected import expect
from synth.controller.controller import Controller
from synth.vehicle.designer import design
from tests.support.analysed import energy, predict_replayed, predict_switched, sampled_response, simulate, switched
from tests.support.commands import attacks, refused

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


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"damper"', '"valve"', r"kind = 'valve' is not known; known: damper, force"),
        ("c_min = 300.0", "", "c_min is missing; a semi-active damper has c_min and c_max"),
        ("c_min = 300.0", "c_min = 4000.0", r"c_min = 4000 N s/m is not below c_max = 4000 N s/m; give a smaller"),
        ("c_min = 300.0", "c_min = nan", r"c_min = nan is not allowed; give a number from 0 to"),
        ("c_min = 300.0", "c_min = 1100.0", "suspension_damping = 1000 N s/m, which acts if no force is commanded, is not among"),
        ("c_max = 4000.0", "c_max = 4000.0\nbandwidth = 0", r"bandwidth = 0 is not allowed; give a number from 1e-06 .* rad/s"),
        ("c_max = 4000.0", "c_max = 4000.0\nfast = true", r"\[actuators\] unknown key 'fast'"),
        (
            "c_max = 4000.0",
            "c_max = 4000.0\n[actuators.front]\nc_min = 1",
            "is not a suspension of this vehicle",
        ),
        ('kind = "damper"\n', "", r'has c_min without kind = "damper"'),
        ("[actuators]", "[limits]\nactuator_force = 900.0\n[actuators]", r"\[limits\] actuator_force is for force actuators"),
    ],
)
def test_bad_dampers(old, new, said):
    """A mistake in [actuators] is said in one line."""
    with refused(match=said):
        parse_vehicle(QUARTER + DAMPER.replace(old, new))


def test_one_for_all_and_for_one():
    """The keys of [actuators] go for every suspension that has no section, and for what its section leaves out."""
    text = HALF[: HALF.index("[actuators.front]")] + DAMPER + "[actuators.rear]\nc_max = 2500.0\nbandwidth = 80.0\n"
    front, rear = parse_vehicle(text).adjustable
    assert front.force == "control_force_front"
    assert (front.damper.c_min, front.damper.c_max, front.damper.bandwidth) == (300, 4000, None)
    assert (rear.force, rear.damper.c_min, rear.damper.c_max, rear.damper.bandwidth) == ("control_force_rear", 300, 2500, 80)
    (only,) = parse_vehicle(MIXED).adjustable
    assert (only.force, only.coefficient, only.missing) == ("control_force_front", "damping_front", "missing_force_front")
    (other,) = parse_vehicle(text.replace("c_max = 2500.0\nbandwidth = 80.0", 'kind = "force"')).adjustable
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


@pytest.mark.parametrize(
    ("name", "more"),
    [
        *attacks([("sky", "")]),
        *attacks([("sky", "bandwidth = 100.0\n"), ("sky", LATE), ("leaky", "")]),
        ("leaky", "bandwidth = 100.0\n" + LATE),
    ],
    ids=["static", "static, lag", "static, late", "states", "states, both"],
)
def test_the_exact_response(name, more):
    """Under a lift MuJoCo is within 1e-6 of a peak of the exact response that decides for itself, and within 1e-9 of RK4's own.

    1e-6: RK4's error at 1 ms is 2e-7 to 7e-7; it follows no decision of physics. 1e-9: rounding, over 800 steps.
    """
    lifted = RoadWithLoads(BUMP, (Lift(start=0.1, rise=0.1),))
    (run,) = runs(QUARTER + DAMPER + more, name, road=lifted)
    assert not run.prediction.otherwise
    assert not run.prediction.played
    assert run.agreement.agrees
    assert run.energy is not None
    assert run.energy.balances
    for signal in run.vehicle.linear_model.outputs:
        peak = float(run.sampled.peak(signal))
        assert np.abs(run.physics[signal] - run.sampled[signal]).max() < 1e-6 * peak
        assert np.abs(run.physics[signal] - run.prediction.integrated[signal]).max() < 1e-9 * peak
    assert np.abs(run.physics["damping"] - run.sampled["damping"]).max() < 4.0  # N s/m: a thousandth of the range, where v is 0
    kept = [signal for signal in run.physics.names if signal not in [one.name for one in run.vehicle.kind.signals]]
    assert len(kept) == (name == "leaky")
    for signal in kept:
        assert np.abs(run.physics[signal] - run.sampled[signal]).max() < 1e-6 * float(run.sampled.peak(signal))


@pytest.mark.attack
@pytest.mark.parametrize("text", [pytest.param(MIXED, marks=pytest.mark.attack), BOTH], ids=["front only", "both, one lags"])
def test_a_car(text):
    """If a body turns, all but geometry is exact: at a millimetre of bump every signal is within 1e-5 of its peak.

    Geometry is in proportion to the bump: 1e-3 of a peak at 0.1 m, 1e-5 at 1 mm.
    """
    (run,) = runs(text, "sky", road=Bump(0.001, 5.0, 12.5))
    assert run.agreement.agrees
    assert run.energy is not None
    assert run.energy.balances
    for signal in run.vehicle.linear_model.outputs:
        assert np.abs(run.physics[signal] - run.sampled[signal]).max() < 1e-5 * run.sampled.scale(signal)
    (whole,) = runs(text, "sky", duration=0.5, road=Bump(0.05, 5.0, 12.5))
    assert verdict(whole).startswith("agrees to first order throughout")


def test_a_force_beside_a_damper_of_which_nothing_is_asked():
    """An axle's force moves a car as if the other axle's damper were a plain one, while that one is left as it is."""
    vehicle, time = parse_vehicle(MIXED), np.arange(200) * 1e-3
    commands = np.zeros((200, 4))
    commands[:, 1] = 800.0 * np.sin(30 * time)
    found = switched(vehicle, BUMP, time, None, commands).states
    linear = forced_response(commands[:, :2], RoadInput(vehicle, BUMP, time))
    for column, name in zip(found.T, vehicle.linear_model.states, strict=True):
        assert np.abs(column - linear[name]).max() < 1e-9 * linear.peak(name), name


@pytest.mark.parametrize("change", ["c_max", *attacks(("bandwidth", "nominal"))])
def test_another_damper_is_found(change):
    """Physics of a damper that is 1 % off does not agree with the exact response: that follows nothing that it cannot be."""
    vehicle = parse_vehicle(QUARTER + DAMPER + ("bandwidth = 100.0" if change == "bandwidth" else ""))
    controller, time = design(vehicle, "sky"), sample_times(vehicle, 0.5, 1e-3)
    (one,) = vehicle.dampers.values()
    if change == "nominal":
        other = replace(vehicle, parameters={**vehicle.parameters, "suspension_damping": 1010.0})
    else:
        other = replace(vehicle, dampers={"control_force": replace(one, **{change: 1.01 * getattr(one, change)})})
    made = simulate([other], [controller], [BUMP], time)
    prediction = predict_replayed(vehicle, controller, BUMP, time, made.run(0), made.requested_force[0])
    (run,) = compare_runs([prediction], [made.run(0)])
    assert not run.agreement.agrees
    assert "DOES NOT AGREE" in verdict(run)


@pytest.mark.attack
def test_physics_is_followed_where_rounding_decides():
    """A coefficient that physics could have set for rounding is played from there on, and said; one that it could not is not."""
    vehicle = parse_vehicle(QUARTER + DAMPER)
    controller, time = design(vehicle, "sky"), sample_times(vehicle, 1.0, 1e-3)
    made = simulate([vehicle], [controller], [BUMP], time)
    physics = made.run(0)
    v = np.abs(physics["sprung_velocity"] - physics["unsprung_velocity"])
    moving = np.abs(physics["control_force"] + physics["missing_force"]) > 100.0
    nearest = int(np.argmin(np.where(moving, v, np.inf)))
    for k, followed in ((nearest, 1), (int(np.argmax(v)), 0)):
        column = physics.names.index("damping")
        changed = physics.values.copy()
        changed[k, column] = 4300.0 - changed[k, column]
        tampered = replace(physics, values=changed)
        near = max(NEAR, 20 * v[k] / v.max()) if followed else NEAR
        prediction = predict_switched(vehicle, controller, BUMP, time, tampered, near)
        assert [one.time for one in prediction.otherwise[:1]] == [float(time[k])] * followed
        assert bool(prediction.sampled["damping"][k] == tampered["damping"][k]) == followed
        here = {name: float(prediction.sampled[name][k]) for name in prediction.sampled.names}
        asked = -3000.0 * here["sprung_velocity"] + 500.0 * here["unsprung_velocity"]
        assert here["control_force"] + here["missing_force"] == pytest.approx(asked, abs=1e-9)
        if followed:
            (run,) = compare_runs([prediction], [physics])
            (line,) = [line for line in verdict_lines(run) if "decision" in line]
            assert f"from those of the exact response, first of damping at {time[k]:.4g} s" in line


def test_nothing_but_rounding_agrees():
    """On a flat road noise alone makes decisions of a damper, whose force is its coefficient times a velocity of rounding."""
    noise = "[implementation]\nnoise = { unsprung_velocity = 1e-3 }\n"
    vehicle = parse_vehicle(QUARTER + DAMPER + noise + '[controllers.linear]\nsemi_active = "skyhook_linear"\n')
    flat = choose_road("flat").build(vehicle, 15.0, 0, 10.0)
    (run,) = run_controllers(vehicle, [vehicle.controllers["linear"].driver()], flat, sample_times(vehicle, 0.3, 1e-3))
    assert 0 < run.physics.peak("control_force") < 1e-9
    assert run.agrees


@pytest.mark.attack
def test_a_ratio_of_what_is_rounded_can_be_any():
    """Where a car stands still a law may ask for the ratio of two velocities that are rounding alone; a valve remembers it."""
    damper = DAMPER.replace("c_min = 300.0", "c_min = 300.0\nbandwidth = 50.0")
    vehicle = parse_vehicle(QUARTER + damper + '[controllers.both]\nsemi_active = "hybrid"\n')
    road = choose_road("flat + payload:mass=60").build(vehicle, 15.0, 0, 10.0)
    (run,) = run_controllers(vehicle, [vehicle.controllers["both"].driver()], road, sample_times(vehicle, 0.65, 1e-3))
    assert any(one.time > 0.45 for one in run.prediction.otherwise)  # the load begins at 0.5 s
    assert run.agrees


def test_a_damper_takes_energy():
    """The power of a damper is never below zero in physics, and one that gave energy would not balance."""
    (run,) = runs(QUARTER + DAMPER, "sky")
    assert run.energy is not None
    assert run.energy.least is not None
    assert run.energy.least >= 0.0
    assert energy_lines(run)[0].startswith("energy balances")
    worse = replace(run, energy=replace(run.energy, least=-1e-3))
    assert not worse.passed
    assert "a semi-active damper supplied energy, 1.0e-03 of the most that it took" in energy_lines(worse)[0]
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
    found = run_object(run)["dampers"]["shortfall"]["control_force"]
    assert found.pop("late") is None
    assert found == pytest.approx({"rms": rms, "time": share, "softest": 300.0, "hardest": 4000.0}, rel=1e-9)
    first = float(physics.time[np.argmax(np.abs(physics["missing_force"]) > 1e-3)])
    lines = verdict_lines(run)
    assert any(line.startswith("damper: ") and f"at {first:.4g} s" in line for line in lines)
    assert any(f"{100 * rms:.2g} % (rms) cannot be given, at {100 * share:.2g} % of the samples" in line for line in lines)
    assert run.agreement.until == np.inf
    assert run.agreement.ended["damper"] == first
    (none,) = runs(QUARTER + DAMPER, "passive")
    assert "dampers" in run_object(none)
    assert not [line for line in verdict_lines(none) if "damp" in line]
    assert "dampers" not in run_object(runs(QUARTER, "passive", duration=0.1)[0])


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
    found = run_object(run)["dampers"]["shortfall"]["control_force"]
    assert found["late"] == pytest.approx(left, rel=1e-4)  # RK4's own exponential, and where v is 0
    assert found["late"] > found["rms"]


def test_the_linear_response_foretells_the_first_force_missing():
    """Until a force is missing the vehicle is linear, so the linear response says when that is, to a sample."""
    (run,) = runs(QUARTER + DAMPER, "sky")
    assert isinstance(run.controller, Controller)
    linear = sampled_response(run.vehicle, run.controller, BUMP, run.physics.time)
    first = linear.time[np.argmax(np.abs(linear["missing_force"]) > 1e-3)]
    assert abs(first - run.agreement.ended["damper"]) < 1.5e-3


def test_runs_side_by_side():
    """Runs of dampers that differ, in ranges and lags' rates, are those of each by itself, to the last bit."""
    vehicle = parse_vehicle(QUARTER + DAMPER + "bandwidth = 100.0")
    (one,) = vehicle.dampers.values()
    ranges = ((2000, 100), (4000, 50))
    others = [replace(vehicle, dampers={"control_force": replace(one, c_max=c, bandwidth=b)}) for c, b in ranges]
    controller, time = design(vehicle, "sky"), sample_times(vehicle, 0.5, 1e-3)
    together = simulate(others, [controller] * 2, [BUMP] * 2, time)
    for i, other in enumerate(others):
        pair = simulate([other] * 2, [controller] * 2, [BUMP] * 2, time)
        assert np.array_equal(together.response.values[i], pair.response.values[0])
        assert together.run(i)["damping"].max() <= others[i].dampers["control_force"].c_max


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


def test_over_a_share_of_a_road_forces_shrink_and_coefficients_stay():
    """Over a hundredth of a road coefficients of dampers are as they were; forces, missing ones too, are a hundredth."""
    dampers, actuators = parse_vehicle(QUARTER + DAMPER), parse_vehicle(QUARTER)
    commands = np.array([[1500.0, -40.0], [300.0, 0.0]])
    np.testing.assert_array_equal(scaled_commands(dampers, commands, 0.01), [[1500.0, -0.4], [300.0, 0.0]])
    np.testing.assert_array_equal(scaled_commands(actuators, commands[:, :1], 0.01), [[15.0], [3.0]])
