"""Signals on demand, as a wheel's acceleration: vehicles have them whose files name them, and to others they are nothing."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

from dataclasses import replace

import numpy as np
import pytest

from models.common.errors import InputError
from models.roads.road import Bump
from models.vehicle.mjcf import build_model, mjcf_text
from models.vehicle.vehicle import kinds, parse_vehicle, read_vehicle
from sim.runs.run import run_controllers, sample_times
from sim.studies.ride.metrics import metrics_of
from synth.analysis.certificate import certify
from synth.controller.problem import generalized_plant
from synth.vehicle.designer import Designer
from tests.models.test_cars import derivative

WHEEL = "unsprung_acceleration"
HUB = f"""
[controllers.hub]
measured = ["suspension_deflection", "{WHEEL}"]
A = [[-0.5]]
B = [[0.0, 1.0]]
C = [[600.0]]
D = [[9000.0, 5.0]]
[controllers.best]
measured = ["suspension_deflection", "{WHEEL}", "control_force"]
order = "full"
"""
NAMED = {
    "measured": '[controllers.hub]\nmeasured = ["{0}"]\ngain = {1}\n',
    "noise": "[implementation]\nnoise = {{ {0} = 0.1 }}\n",
    "quantisation": "[implementation]\nquantisation = {{ {0} = 0.1 }}\n",
}


def wheels(name):
    """A wheel's acceleration, by wheel, as a kind of vehicle calls it."""
    return [one.name for one in read_vehicle(name).kind.on_demand if WHEEL in one.name]


def weighing(name):
    """A vehicle that ships, whose file weighs its wheels' accelerations."""
    text = read_vehicle(name).text
    return parse_vehicle(text.replace("[performance]", "[performance]\n" + "".join(f"{one} = 0.01\n" for one in wheels(name))))


@pytest.fixture(scope="module")
def hub(tmp_path_factory):
    """The quarter-car's file with an accelerometer on its hub."""
    file = tmp_path_factory.mktemp("hub") / "car.toml"
    file.write_text(read_vehicle("quarter_car").text + HUB)
    return file


@pytest.mark.parametrize("name", kinds())
def test_rows_are_the_physics(name):
    """Its rows of C, D and Cr are the sensor's, found by differences, and those of z_u'' = d/dt of the wheel's velocity."""
    vehicle = weighing(name)
    model, linear = build_model(vehicle, 1e-3), vehicle.linear_model
    states = [linear.outputs.index(state) for state in linear.states]
    for wheel in wheels(name):
        row, speed = linear.outputs.index(wheel), linear.states.index(wheel.replace("acceleration", "velocity"))
        np.testing.assert_array_equal(linear.C[row], linear.A[speed])
        np.testing.assert_array_equal(linear.D[row], linear.B[speed])
        np.testing.assert_array_equal(linear.Cr[row], linear.Br[speed])
        assert not linear.Bw[speed].any(), "no tyre damps: the road's velocity is not in it"
        tolerance = {"atol": 1e-7 * np.abs(linear.C[row]).max()}  # h^2 times the third derivative, as in test_cars
        for which, count in {"qpos": model.nq, "qvel": model.nv, "road": len(vehicle.kind.wheels)}.items():
            found = derivative(vehicle, model, which, count)
            expected = linear.C[row] @ found[states] + (linear.Cr[row] if which == "road" else 0)
            np.testing.assert_allclose(found[row], expected, **tolerance)
        np.testing.assert_allclose(derivative(vehicle, model, "ctrl", model.nu)[row], linear.D[row], atol=1e-9)


@pytest.mark.parametrize("name", kinds())
def test_who_does_not_name_it_has_nothing_of_it(name):
    """Neither in the linear model nor in the MJCF; and with it, everything else stays as it was to the last bit."""
    plain, other = read_vehicle(name), weighing(name)
    assert WHEEL not in mjcf_text(plain, 1e-3)
    assert not any(WHEEL in signal for signal in (*plain.linear_model.outputs, *(one.name for one in plain.kind.signals)))
    assert other.kind.signals == (*plain.kind.signals, *(one for one in plain.kind.on_demand if WHEEL in one.name))
    count = len(plain.linear_model.outputs)
    assert other.linear_model.outputs == (*plain.linear_model.outputs, *wheels(name))
    for matrix in ("A", "B", "Bw", "Br"):
        np.testing.assert_array_equal(getattr(other.linear_model, matrix), getattr(plain.linear_model, matrix))
    for matrix in ("C", "D", "Cr"):
        np.testing.assert_array_equal(getattr(other.linear_model, matrix)[:count], getattr(plain.linear_model, matrix))
    lines = [line for line in mjcf_text(other, 1e-3).splitlines() if WHEEL not in line]
    assert lines == mjcf_text(plain, 1e-3).splitlines()
    assert [one for one in metrics_of(other) if WHEEL in one.name] == [], "nobody rides on a wheel"


@pytest.mark.parametrize(("where", "name"), [("measured", "half_car"), ("noise", "quarter_car"), ("quantisation", "half_car")])
def test_a_vehicle_has_what_its_file_names(name, where):
    """Wheels that are named have one, in what a controller measures, in a noise or a quantisation."""
    text, wheel, forces = read_vehicle(name).text, wheels(name)[-1], len(read_vehicle(name).linear_model.inputs)
    vehicle = parse_vehicle(text + NAMED[where].format(wheel, [[1.0]] * forces))
    assert [one for one in vehicle.linear_model.outputs if WHEEL in one] == [wheel]
    assert vehicle.kind.signal(wheel).unit == "m/s2"


def test_a_weight_given_in_python_names_it_too():
    """What `dataclasses.replace` weighs a checked vehicle has, and in its norm it is j omega times the wheel's velocity."""
    plain = read_vehicle("quarter_car")
    vehicle = replace(plain, performance={**plain.performance, WHEEL: 1.0}).checked()
    model, omega = plain.linear_model, np.linspace(60, 70, 20001)
    x = np.linalg.solve(1j * omega[:, None, None] * np.eye(4) - model.A, model.Bw)[..., 0].T
    weighted = [weight * model.rows([name])[0][0] @ x for name, weight in plain.performance.items()]
    z = np.linalg.norm([*weighted, 1j * omega * (model.rows(["unsprung_velocity"])[0][0] @ x)], axis=0)
    norm = certify(generalized_plant(vehicle), np.zeros((1, 4))).norm
    assert 60 < norm.peak_frequency < 70, "the wheel hops"
    assert norm.value == pytest.approx(z.max(), rel=1e-8)  # a grid of 5e-4 rad/s, at a peak 3 rad/s wide: (5e-4 / 2 / 3)^2


def test_a_full_car_does_not_measure_it():
    """There the road's twist acts on the wheels as a displacement, which no loop is closed through."""
    text, wheel = read_vehicle("full_car").text, wheels("full_car")[0]
    with pytest.raises(InputError, match=rf"'{wheel}' depends on the road's height"):
        parse_vehicle(f'{text}\n[controllers.hub]\nmeasured = ["{wheel}"]\n')


def test_physics_agrees_to_rk4s_own_error(hub):
    """For laws on the hub's accelerometer MuJoCo is within 1e-6 of peak of the sampled response."""
    vehicle = read_vehicle(hub)
    some = [Designer(vehicle).design(name) for name in ("hub", "best")]
    for run in run_controllers(vehicle, some, Bump(), sample_times(vehicle, 1.0, 1e-3)):
        assert run.passed
        assert run.agreement.signals[WHEEL].sampled > 0
        assert max(one.sampled for one in run.agreement.signals.values()) < 1e-6  # measured 4.7e-7
