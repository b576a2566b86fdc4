"""Tyres that damp: their frequency response, lift-off, metrics, and measurements that jump with the road's velocity."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import dataclasses
import re
from functools import cache

import numpy as np
import pytest

from models.common.errors import InputError
from models.roads.choice import choose_road
from models.roads.iso8608 import Iso8608
from models.roads.spectrum import sources
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.drive.regime import LIFT_OFF
from sim.linear.frequency_response import continuous_frequency_response
from sim.runs.run import Run, run_controllers, sample_times
from sim.studies.ride.expected import expect
from sim.studies.ride.metrics import measure
from synth.controller.controller import Controller
from synth.controller.export.linear_system import loop_system
from synth.controller.implementation_norm import norm_as_implemented
from synth.vehicle.designer import Designer
from synth.vehicle.expected_ride import WEIGHTING_FILTER, expected_ride
from tests.support.commands import in_the_suite

KINDS = ("quarter_car", "half_car", "full_car")
CORNERS = {
    "quarter_car": ("",),
    "half_car": ("_front", "_rear"),
    "full_car": tuple(f"_{a}_{s}" for a in ("front", "rear") for s in ("left", "right")),
}
DAMPING = {"": 1500.0, "_front": 900.0, "_rear": 1400.0}  # N s/m; the axles differ, so that none stands in for another
HELD = {"quarter_car": "sprung_velocity", "half_car": "heave_velocity", "full_car": "heave_velocity"}


@cache
def damped(kind: str, more: str = "") -> Vehicle:
    """A vehicle that ships, with tyres that damp and a given gain `held`."""
    text = re.sub(
        r"^tyre_stiffness(\w*) = .*$",
        lambda m: f"{m[0]}\ntyre_damping{m[1]} = {DAMPING[m[1]]}",
        read_vehicle(kind).text,
        flags=re.M,
    )
    gain = [[-1500.0]] * len(CORNERS[kind])
    return parse_vehicle(f'{text}\n[controllers.held]\nmeasured = ["{HELD[kind]}"]\ngain = {gain}\n{more}')


def driven(vehicle: Vehicle, name: str, text: str, duration: float = 1.0, step: float = 1e-3) -> Run:
    road = choose_road(text).build(vehicle, 12.5, 0, duration)
    return run_controllers(vehicle, [Designer(vehicle).design(name)], road, sample_times(vehicle, duration, step))[0]


def test_a_tyre_leaves_the_road_where_its_whole_force_ends():
    """The instant of lift-off is that of k t + c t' = k static, earlier than the deflection says.

    In the air the tyre has no force, step by step as the equations have it.
    """
    vehicle = damped("quarter_car")
    run = driven(vehicle, "passive", "bump:height=0.2:length=2", 0.4)
    p, physics = vehicle.parameters, run.physics
    static = (p["sprung_mass"] + p["unsprung_mass"]) * 9.81
    closing = physics["unsprung_velocity"] - physics["road_velocity"]
    force = static - p["tyre_stiffness"] * physics["tyre_deflection"] - p["tyre_damping"] * closing
    off = physics.time[(force <= 0).argmax()]
    assert run.agreement.end_times[LIFT_OFF.name] == off > 0
    deflected = physics.time[(physics["tyre_deflection"] >= static / p["tyre_stiffness"]).argmax()]
    assert off < deflected
    assert run.passed
    assert run.agreement.steps is not None
    assert run.agreement.steps.error < 1e-10


def test_metrics_of_the_tyre_are_of_its_whole_force():
    """Dynamic load and time off the ground, of physics and expected: by k t + c t', written out."""
    vehicle = damped("quarter_car")
    p = vehicle.parameters
    run = driven(vehicle, "passive", "iso8608:class=C", 2.0)
    got = measure(vehicle, run.physics, 500)
    static = (p["sprung_mass"] + p["unsprung_mass"]) * 9.81
    r = run.physics
    force = p["tyre_stiffness"] * r["tyre_deflection"] + p["tyre_damping"] * (r["unsprung_velocity"] - r["road_velocity"])
    assert got["dynamic_load"] == pytest.approx(np.sqrt(np.mean(np.minimum(force[500:], static) ** 2)) / static, rel=1e-12)
    road = choose_road("iso8608:class=B").build(vehicle, 12.5, 0, 10.0)
    passive = Designer(vehicle).design("passive")
    assert road.spectrum is not None
    expected = expect(vehicle, passive, road.spectrum, 1e-3, 10.0)
    assert expected is not None
    omega = np.linspace(*road.spectrum.band, 100_001)
    response = continuous_frequency_response(vehicle, passive, omega)[:, :, 0]
    row = dict(zip(vehicle.linear_model.outputs, response.T, strict=True))
    t = p["tyre_stiffness"] * row["tyre_deflection"] + p["tyre_damping"] * (row["unsprung_velocity"] - 1)
    power = road.spectrum.density * np.trapezoid(np.abs(t) ** 2, omega / (2 * np.pi))
    # The expectation is of the sampled loop at 1 ms, which differs by the square of the step from the continuous one.
    assert expected.mean["dynamic_load"] == pytest.approx(np.sqrt(power) / static, rel=2e-4)


def reading_the_wheel() -> tuple[Vehicle, Controller, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """A quarter-car whose law reads the wheel's acceleration, and its loop from the road's velocity to all signals, by hand."""
    vehicle = damped(
        "quarter_car",
        '[controllers.felt]\nmeasured = ["sprung_velocity", "unsprung_acceleration"]\ngain = [[-2000.0, -30.0]]',
    )
    model, row = vehicle.linear_model, "unsprung_acceleration"
    controller, i = Designer(vehicle).design("felt"), model.outputs.index(row)
    Cy = np.vstack([model.C[model.outputs.index("sprung_velocity")], model.C[i]])
    share = 1 / (1 + 30.0 * model.D[i, 0])  # u = ... - 30 D u
    K, k = share * np.array([[-2000.0, -30.0]]) @ Cy, share * -30.0 * model.Dw[i]
    loop = (
        model.A + model.B @ K,
        model.Bw + np.outer(model.B[:, 0], k),
        model.C + model.D @ K,
        model.Dw + np.outer(model.D[:, 0], k),
    )
    return vehicle, controller, loop


def test_the_expected_ride_counts_the_road_in_a_reading():
    """The accelerometer of a wheel on a tyre that damps reads the road's velocity, which the force follows at once.

    By a sum over 40000 frequencies, that is right to 1e-4; without that reading the ride is 4 % off.
    """
    vehicle, controller, (A, B, C, D) = reading_the_wheel()
    road = Iso8608("C", speed=20.0).spectrum
    omega = np.geomspace(*road.band, 40_000)
    i, own = vehicle.linear_model.outputs.index("sprung_acceleration"), np.eye(len(A))
    response = (C[i] @ np.linalg.solve(1j * omega[:, None, None] * own - A, B))[:, 0] + D[i, 0]
    weighted = np.abs(WEIGHTING_FILTER.response(omega) * response * sources(vehicle, road, omega)[:, 0, 0]) ** 2
    ride = np.sqrt(road.density * np.trapezoid(weighted, omega) / (2 * np.pi))
    assert expected_ride(vehicle, controller) == pytest.approx(ride, rel=1e-3)


def test_the_sampled_norm_counts_the_road_in_a_reading():
    """With fast sampling the norm as implemented tends to that of the continuous loop, whose peak is found by hand.

    At 10 us the difference is of the order of the period times 65 rad/s; without that reading it is 3 %.
    """
    vehicle, controller, (A, B, C, D) = reading_the_wheel()
    weights = np.array([vehicle.performance.get(name, 0.0) for name in vehicle.linear_model.outputs])
    omega = np.geomspace(0.1, 1e3, 20_000)
    z = weights * ((C @ np.linalg.solve(1j * omega[:, None, None] * np.eye(len(A)) - A, B))[:, :, 0] + D[:, 0])
    peak = np.linalg.norm(z, axis=1).max()
    assert controller.certificate.norm.value == pytest.approx(peak, rel=1e-5)
    assert norm_as_implemented(vehicle, controller, 1e-5).value == pytest.approx(peak, rel=1e-3)


def test_a_sampled_design_refuses_a_reading_of_the_road():
    """No energy of the road bounds its velocity at an instant, which such a reading samples."""
    vehicle = damped(
        "quarter_car",
        '[implementation]\nsample_period = 0.005\n[controllers.felt]\nmeasured = ["unsprung_acceleration"]\nsampled = true',
    )
    with pytest.raises(InputError, match="'unsprung_acceleration' contains the road's velocity"):
        Designer(vehicle).design("felt")


@pytest.mark.parametrize("kind", in_the_suite(("quarter_car", "half_car"), KINDS))
def test_an_exported_vehicle_reads_the_road_as_its_wheels_do(kind):
    """The system of FMUs and MATLAB files has the response of the linear analysis, in accelerations of wheels too."""
    weighed = "".join(f"unsprung_acceleration{end} = 0.1\n" for end in CORNERS[kind])
    vehicle = parse_vehicle(damped(kind).text.replace("[performance]\n", f"[performance]\n{weighed}"))
    omega, controllers = np.array([0.3, 5.0, 70.0, 2000.0]), [Designer(vehicle).design(name) for name in ("passive", "held")]
    for controller in controllers:
        system = loop_system(vehicle, controller)
        roads = slice(len(CORNERS[kind]))
        response = np.array(
            [system.C @ np.linalg.solve(1j * w * np.eye(len(system.A)) - system.A, system.B) + system.D for w in omega]
        )
        expected = continuous_frequency_response(vehicle, controller, omega)
        assert response[..., roads] == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())


def test_the_open_loop_of_the_bus_has_the_poles_that_ctms_prints():
    """CTMS, bus suspension: -23.9758 +- 35.1869i and -0.1098 +- 5.2504i, all printed digits."""
    bus = {"sprung_mass": 2500.0, "unsprung_mass": 320.0, "suspension_stiffness": 80000.0, "suspension_damping": 350.0}
    bus |= {"tyre_stiffness": 500000.0, "tyre_damping": 15020.0}
    vehicle = dataclasses.replace(read_vehicle("quarter_car"), parameters=bus)
    poles = sorted((p for p in np.linalg.eigvals(vehicle.linear_model.A) if p.imag > 0), key=lambda p: p.real)
    assert np.allclose(np.round(poles, 4), [-23.9758 + 35.1869j, -0.1098 + 5.2504j], atol=1e-12)
