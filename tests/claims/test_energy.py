"""The energy that road and actuators put into a run is found again: stored, or dissipated."""

import dataclasses

import numpy as np
import pytest

from models.roads.road import Bump
from models.vehicle.mjcf import build_spec
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.drive.response import Response
from sim.observers.results import Energy
from sim.runs.run import run_controllers, sample_times
from synth.vehicle.designer import design
from tests.claims.test_verdict import without_motion
from tests.models.test_vehicle_options import LINKS, TYRES, with_parameters, without_springs
from tests.support.analysed import energy, simulate
from tests.support.commands import ROOT, attacks
from tests.support.faults import built_with, places, scaled

LAG = "\n[limits]\nactuator_bandwidth = 60.0\n"
ALL = (
    "\n[limits]\nsuspension_stroke = 0.08\nstop_stiffness = 1e5\nactuator_force = 500.0\nactuator_bandwidth = 60.0\n"
    "[implementation]\nsample_period = 0.004\ndelay = 1\n"
)


def run(vehicle, controller, road, timestep, duration=1.5):
    """One run."""
    time = np.arange(round(duration / timestep) + 1) * timestep
    return simulate([vehicle], [controller], [road], time)


def balance(kind, reality, name, road, timestep) -> Energy:
    """The energy of a run of a vehicle that ships, with limits and implementation."""
    vehicle = parse_vehicle(read_vehicle(kind).text + reality)
    return energy(vehicle, run(vehicle, design(vehicle, name), road, timestep), 0, road)


@pytest.mark.parametrize(
    ("kind", "reality", "name", "track"),
    [
        *attacks([("half_car", "", "I", "both"), ("full_car", "", "I", "left")]),
        ("half_car", LAG, "I", "both"),
        ("half_car", "\n[implementation]\nsample_period = 0.004\ndelay = 2\n", "I", "both"),
    ],
)
def test_residual_is_of_the_integrators_order(kind, reality, name, track):
    """While every wheel is on the road the residual shrinks with the fourth power of the step, as RK4's error does."""
    coarse, fine = (balance(kind, reality, name, Bump(track=track), timestep) for timestep in (2e-3, 1e-3))
    assert coarse.residual < 1e-5  # measured up to 2.6e-6
    assert coarse.residual / fine.residual > 2**3.3  # order 4 as the step goes to 0; measured 13 to 15


def test_quarter_car(paper, designer):
    """The paper's run balances to 1e-7, and from 1 ms to 0.5 ms ten times better: two errors of order 4 partly cancel in it."""
    controller, road = designer.design("I"), Bump()
    coarse, fine = (energy(paper, run(paper, controller, road, h), 0, road) for h in (1e-3, 5e-4))
    assert coarse.balances
    assert coarse.residual < 1e-7  # measured 1.1e-8
    assert fine.residual < coarse.residual / 8  # measured 11.7


@pytest.mark.parametrize(
    ("kind", "reality", "road"),
    [
        ("quarter_car", "", Bump(height=0.2, speed=20.0)),
        ("half_car", ALL, Bump()),
    ],
)
def test_with_kinks_it_balances_to_less(kind, reality, road):
    """Tyres off the ground, bump stops, saturation, lag, hold and delay: it still balances, and better with a smaller step."""
    coarse, fine = (balance(kind, reality, "I", road, timestep) for timestep in (4e-3, 5e-4))
    assert coarse.balances
    assert fine.residual < 1e-5
    assert coarse.residual / fine.residual > 8  # at least first order over an eighth of the step
    for one in (coarse, fine):  # what is left over at the end is no more than at its largest
        left = one.road + one.actuators - one.stored - one.dissipated
        assert abs(left) <= one.residual * one.turnover * (1 + 1e-9)


def test_what_is_put_in_is_what_the_signals_say(paper, designer):
    """By another route: the controller's work is u times the suspension's stroke, the damper's c times its speed squared."""
    controller, road, timestep = designer.design("I"), Bump(), 1e-3
    runs = run(paper, controller, road, timestep, 3.0)
    found, response = energy(paper, runs, 0, road), runs.response.run(0)
    speed = response["sprung_velocity"] - response["unsprung_velocity"]
    by_force = float(np.sum(response["control_force"][:-1] * np.diff(response["suspension_deflection"])))
    lost = float(np.sum(paper.parameters["suspension_damping"] * speed**2) * timestep)
    assert found.dissipated == pytest.approx(lost, rel=1e-3)  # a sum of rectangles, from rest to rest
    assert found.actuators == pytest.approx(by_force, rel=1e-9)  # rounding
    work = response["control_force"][:-1] * np.diff(response["suspension_deflection"])
    kinetic = sum(
        paper.parameters[f"{mass}_mass"] * np.max(response[f"{mass}_velocity"] ** 2) / 2 for mass in ("sprung", "unsprung")
    )
    least = found.dissipated + np.abs(work).sum()
    assert least < found.turnover <= least + kinetic * (1 + 1e-9)  # the masses are not at their fastest at once


def hidden(tmp_path, paper, change):
    """The paper's quarter-car with another MJCF."""
    text = paper.kind.mjcf.read_text()
    changed = change(text)
    assert changed != text
    (tmp_path / "quarter_car.xml").write_text(changed)
    return dataclasses.replace(paper, kind=dataclasses.replace(paper.kind, folder=tmp_path))


FAULTS = {
    "a body that floats": lambda text: text.replace('<body name="sprung"', '<body name="sprung" gravcomp="0.01"'),
    "air that drags": lambda text: text.replace('gravity="0 0 -9.81"', 'gravity="0 0 -9.81" density="2000"'),
    "a force on the body alone": lambda text: text.replace(
        '<motor name="control_force" tendon="suspension"/>', '<motor name="control_force" joint="sprung"/>'
    ),
    "a gear of 1 %": lambda text: text.replace('tendon="suspension"/>', 'tendon="suspension" gear="1.01"/>'),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_hidden_forces_show(tmp_path, paper, designer, fault):
    """A force that is neither weight, spring, damper nor actuator is left over; without one the same run balances, as above."""
    road, vehicle = Bump(), hidden(tmp_path, paper, FAULTS[fault])
    assert not energy(vehicle, run(vehicle, designer.design("I"), road, 1e-3), 0, road).balances


PAYLOAD = "\n[payload]\nmass = 100.0\n"
KINDS = {kind: f"{TYRES[kind]}\n{LINKS.get(kind, '')}" for kind in ("quarter_car", "half_car", "full_car")}  # and their options


def added_body(spec):
    """A fault: a mass on the body, beyond its own."""
    spec.body("sprung").add_body(pos=[0.5, 0.0, 0.2], mass=10.0, inertia=[0.1] * 3, explicitinertial=True)


def rotor(spec):
    """A fault: a tendon of the suspension turns a rotor, which couples body and hub."""
    next(tendon for tendon in spec.tendons if tendon.name.startswith("suspension")).armature = 1.0


@pytest.mark.parametrize(("kind", "options"), [("quarter_car", False), ("half_car", True), *attacks([("full_car", True)])])
def test_a_wrong_mass_or_spring_of_the_compiled_model_shows(kind, options):
    """A mass, an inertia, a stiffness of the compiled model alone that is 2 % off, or a product term, does not balance.

    The options are tyre damping, roll and pitch centres, anti-roll bars and a payload. The inertia about an axis about which the
    body does not turn has no effect, and that about the vertical axis hardly any.
    """
    vehicle = parse_vehicle(with_parameters(kind, KINDS[kind]).text + PAYLOAD) if options else read_vehicle(kind)
    road, time = Bump(0.03, track="left" if kind == "full_car" else "both"), np.arange(201) * 1e-3
    turns = {"quarter_car": (), "half_car": (1,), "full_car": (0, 1)}[kind]
    numbers = [place for place in places(build_spec(vehicle, 1e-3)) if place[2] in ("mass", "stiffness")]
    faults = [scaled(place, 0.02) for place in [*numbers, *(("body", "sprung", "inertia", axis) for axis in turns)]]

    def found(fault):
        with built_with(fault):
            return energy(vehicle, simulate([vehicle], [design(vehicle, "passive")], [road], time), 0, road)

    assert found(lambda spec: None).balances
    assert len(faults) >= {"quarter_car": 3, "half_car": 6, "full_car": 11}[kind]
    for fault in (*faults, added_body, rotor):
        assert "DOES NOT BALANCE" in found(fault).summary.title


@pytest.mark.parametrize(("kind", "make"), [*((kind, with_parameters) for kind in KINDS), ("half_car", without_springs)])
def test_energy_of_the_equations_is_that_of_mujoco(kind, make):
    """Without equations of motion a vehicle type has the energy of its compiled model, and every energy is the same."""
    vehicle = make(kind, KINDS[kind]) if make is with_parameters else make(kind)
    own, road, time = without_motion(vehicle), Bump(0.2, track="left" if kind == "full_car" else "both"), np.arange(301) * 1e-3
    runs = simulate([vehicle], [design(vehicle, "passive")], [road], time)
    one, other = (dataclasses.asdict(energy(each, runs, 0, road)) for each in (vehicle, own))
    for name in ("road", "actuators", "stored", "dissipated", "turnover"):
        assert one[name] == pytest.approx(other[name], rel=0, abs=1e-11 * one["turnover"]), name
    assert one["residual"] == pytest.approx(other["residual"], abs=1e-11)


def test_stops_on_the_road_balance():
    """Bump stops of a vehicle type without wheels stand on the road, whose work on them counts."""
    file = ROOT / "models/gallery/simulink_half_car/car.toml"
    text = f"{file.read_text()}\n[limits]\nsuspension_stroke = 0.01\nstop_stiffness = 1e5\n"
    vehicle, road = parse_vehicle(text, folder=file.parent), Bump(0.05)
    found = energy(vehicle, run(vehicle, design(vehicle, "passive"), road, 1e-3, 0.5), 0, road)
    assert found.residual < 1e-5  # measured 7e-7; without the work on stops 0.5


LIGHT = """type = "quarter_car"
[parameters]
sprung_mass = 229.0
unsprung_mass = 7.1
suspension_stiffness = 2350.0
suspension_damping = 7.5
tyre_stiffness = 430e3
[performance]
sprung_acceleration = 1.0
"""


@pytest.mark.parametrize(("length", "height"), [(0.5, 0.05), (0.3, 0.003)], ids=["in the air", "on the road"])
def test_a_light_wheel_balances_in_view_of_half_the_step(tmp_path, length, height):
    """A wheel that is fast for the step leaves more over than others do, and less at half the step: that is no fault.

    A force that floats the body leaves as much at half the step, and is found as before.
    """
    light, road = parse_vehicle(LIGHT, source="mine"), Bump(height, length=length, speed=10.0)
    controller, time = design(light, "passive"), sample_times(light, 0.5, 1e-3)
    vehicles = (light, hidden(tmp_path, light, FAULTS["a body that floats"]))
    clean, found = (run_controllers(vehicle, [controller], road, time)[0] for vehicle in vehicles)
    alone = energy(light, run(light, controller, road, 1e-3, 0.5), 0, road)
    assert clean.energy is not None
    assert found.energy is not None
    assert not alone.balances
    assert clean.energy == dataclasses.replace(alone, allowed=clean.energy.allowed)
    assert clean.passed
    assert not found.energy.balances


def test_wrong_steps_forces_and_dampers_show(paper, designer):
    """Physics that ran with another step, actuator force or damper than it says does not balance."""
    road = Bump()
    runs = run(paper, designer.design("I"), road, 1e-3)
    response = runs.response
    assert energy(paper, runs, 0, road).balances
    slower = runs.with_response(Response(1.02 * response.time, response.signals, response.values))
    assert not energy(paper, slower, 0, Bump(speed=12.5 / 1.02)).balances
    values = response.values.copy()
    values[..., response.names.index("control_force")] *= 1.1
    stronger = runs.with_response(Response(response.time, response.signals, values))
    assert not energy(paper, stronger, 0, road).balances


@pytest.mark.parametrize(("kind", "name"), [("quarter_car", "passive"), ("half_car", "I"), ("full_car", "passive")])
def test_a_hundredth_of_a_damper_shows(kind, name):
    """Physics whose dampers are 1 % off what they are said to be does not balance, however much weight the road lifts."""
    vehicle, road = read_vehicle(kind), Bump()
    runs = run(vehicle, design(vehicle, name), road, 1e-3)
    dampers = {key: 1.01 * value for key, value in vehicle.parameters.items() if "suspension_damping" in key}
    assert dampers
    other = dataclasses.replace(vehicle, parameters={**vehicle.parameters, **dampers})
    assert energy(vehicle, runs, 0, road).balances
    assert not energy(other, runs, 0, road).balances


def test_at_rest_nothing_is_left_over(paper, designer):
    """On a flat road nothing is put in, and rounding is not taken for a fault."""
    found = energy(paper, run(paper, designer.design("I"), Bump(height=0.0), 1e-3), 0, Bump(height=0.0))
    assert found.turnover < 1e-9  # J; of 5 kJ at rest, rounded a thousand times
    assert found.balances
