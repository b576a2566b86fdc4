"""A seat with a person on built-in cars: its equations are those of a mass more, and its faults are found."""

import operator

import numpy as np
import pytest

from models.kinds.kind import GRAVITY
from models.roads.loads.load import Cornering
from models.roads.road import Bump
from models.vehicle.file_schema import file_schema
from models.vehicle.sketch import vehicle_sketch
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.runs.run import Run, run_controllers, sample_times
from synth.vehicle.designer import Designer
from synth.vehicle.expected_ride import expected_ride
from tests.support.commands import in_the_suite, refused
from tests.support.faults import built_with
from tests.support.mechanism import CORNERS, axle, places
from tests.support.shared import designed

SEAT = {"mass": 88.0, "stiffness": 16e3, "damping": 500.0}
QUARTER = {"sprung_mass": 270.0, "unsprung_mass": 60.0, "suspension_stiffness": 27e3} | {
    "suspension_damping": 2000.0,
    "tyre_stiffness": 2e5,
}
PLACES = {"quarter_car": {}, "half_car": {"x": 0.4}, "half_car_roll": {"y": 0.35}, "full_car": {"x": 0.2, "y": 0.35}}


def run(vehicle: Vehicle) -> Run:
    """A run over a bump without control."""
    return run_controllers(vehicle, [designed(vehicle, "passive")], Bump(0.05, speed=15.0), sample_times(vehicle, 0.3, 1e-3))[0]


def seated(name: str, more: str = "", **seat: float) -> Vehicle:
    """A built-in vehicle with a seat, and further sections."""
    text = "".join(f"{key} = {value}\n" for key, value in {**SEAT, **PLACES[name], **seat}.items())
    return parse_vehicle(f"{read_vehicle(name).text}\n[seat]\n{text}{more}")


def test_a_step_and_the_ride_of_the_person_have_their_closed_values():
    """A step of 50 mm gives the wheel 166.667 m/s2 and the tyre 50 mm; the person's ride without control, 0.7822, comes first."""
    vehicle = seated("quarter_car").with_parameters(**QUARTER)
    model = vehicle.linear_model
    assert vehicle.ride_points.all == ("seat_acceleration", "sprung_acceleration")
    assert expected_ride(vehicle, Designer(vehicle).design("passive")) == pytest.approx(0.7822, abs=5e-5)
    start = 0.05 * model.jump[:, 0]
    wheel = vehicle.kind.full_model(vehicle.parameters).of(["unsprung_acceleration"]).C @ start
    assert abs(wheel[0]) == pytest.approx(166.667, rel=1e-5)
    assert np.abs(start).max() == pytest.approx(0.05)


@pytest.mark.parametrize("name", in_the_suite(["quarter_car", "full_car"], PLACES))
def test_rest_energy_and_faults(name):
    """Tyres carry all weights; MuJoCo agrees and energy balances; a seat spring that is 2 % off is found."""
    vehicle = seated(name)
    p, tyres = vehicle.parameters, vehicle.kind.static_tyre_deflection(vehicle.parameters)
    forces = [deflection * p[f"tyre_stiffness{axle(end)}"] for deflection, end in zip(tyres.values(), CORNERS[name], strict=True)]
    hubs = [p[f"unsprung_mass{axle(end)}"] for end in CORNERS[name]]
    assert sum(forces) == pytest.approx(GRAVITY * (p["sprung_mass"] + p["seat_mass"] + sum(hubs)), rel=1e-12)
    x, y = places(vehicle)
    at = PLACES[name]
    for arm, lever in ((x, at.get("x", 0.0)), (y, at.get("y", 0.0))):  # balance of moments about the centre of mass
        moment = (np.array(forces) - GRAVITY * np.array(hubs)) @ arm
        assert moment == pytest.approx(GRAVITY * p["seat_mass"] * lever, abs=1e-8)
    right = run(vehicle)
    assert right.passed
    assert right.energy is not None
    assert right.energy.balances

    for fault in ("stiffness", "damping"):
        with built_with(lambda spec, fault=fault: operator.imul(getattr(spec.joint("seat"), fault), 1.02)):
            assert not run(vehicle).passed, fault


def test_a_seat_goes_with_all_else():
    """Payload, stops, elements, a curve and a semi-active damper: MuJoCo agrees; a payload moves the centre, not the seat."""
    more = "[payload]\nmass = 90.0\nx = -1.2\nz = 0.2\n[limits]\nsuspension_stroke = 0.03\nstop_stiffness = 1e5\n"
    more += '[parts.b]\nkind = "inerter"\ninertance = 12.0\n[parts.m]\nkind = "maxwell"\nstiffness = 2e4\ndamping = 500.0\n'
    car = seated("full_car", more).with_parameters(
        roll_centre_height_front=0.1, roll_centre_height_rear=0.15, pitch_centre_height=0.2
    )
    p = car.parameters
    assert p["seat_x"] + p["axle_distance_rear"] == pytest.approx(0.2 + read_vehicle("full_car").parameters["axle_distance_rear"])
    curve = "[curves]\nsuspension_stiffness = { deflection = [-0.1, 0.0, 0.1], force = [-1700.0, 0.0, 1100.0] }\n"
    lines = [line for line in seated("quarter_car").text.splitlines() if not line.startswith("suspension_stiffness = 1")]
    valve = '[actuators]\nkind = "damper"\nc_min = 200.0\nc_max = 4000.0\n'
    for vehicle in (car, parse_vehicle("\n".join([*lines, curve, valve]))):
        one = run(vehicle)
        assert one.passed
        assert one.energy is not None
        assert one.energy.balances


def test_a_steady_curve_has_the_weight_of_the_person():
    """Braking and cornering act on the person, too: the moment is that of both masses."""
    load = next(iter(Cornering(0.3).amplitudes(seated("full_car").parameters).values()))
    p = seated("full_car").parameters
    assert load == pytest.approx((p["sprung_mass"] + 88.0) * GRAVITY * 0.3 * p["centre_height"], rel=1e-12)


def test_keys_are_checked():
    """Wrong keys and places are refused in a line, and the JSON schema has the same keys."""
    for name, words, seat in (
        ("quarter_car", ("[seat] x", "does not pitch", "omit x"), {"x": 0.2}),
        ("half_car", ("[seat] y", "does not roll"), {"y": 0.2}),
        ("half_car_roll", ("[seat] x", "does not pitch"), {"x": 0.2}),
        ("full_car", ("[seat] 'z'", "centre of mass"), {"z": 0.2}),
        ("quarter_car", ("[seat] mass", "0 kg"), {"mass": -1.0}),
        ("half_car", ("does not touch the road",), {"x": 15.0, "mass": 500.0}),
    ):
        with refused(*words):
            seated(name, "", **seat)
    twice = seated("quarter_car").text.replace("[parameters]", "[parameters]\nseat_mass = 3.0")
    with refused("[parameters] seat_mass", "omit"):
        parse_vehicle(twice)
    with refused("[seat] mass is missing"):
        parse_vehicle(read_vehicle("half_car").text + "[seat]\n")
    with refused("unknown parameter 'seat_mass'", "write [seat]"):
        parse_vehicle(read_vehicle("half_car").text.replace("[parameters]", "[parameters]\nseat_mass = 3.0"))
    for stiffness in (16.0, 16e6):  # in N/mm or kN/m instead of N/m
        assert [one for one in seated("half_car", stiffness=stiffness).warnings if "stiffness in N/m" in one]
    views = vehicle_sketch(seated("full_car")).views
    assert [view.seat and view.seat.place for view in views] == pytest.approx([0.2 - 1.011, -0.35])
    for name, keys in (("quarter_car", "mass stiffness damping"), ("half_car_roll", "mass stiffness damping y")):
        assert [*file_schema(name)["properties"]["seat"]["properties"]] == keys.split()
