"""Anti-roll bars: a torsion spring between body and axle, in the equations as in MuJoCo."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import dataclasses

import mujoco
import numpy as np
import pytest

from models.roads.road import Bump
from models.vehicle.mjcf import build_model
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.physics.sensor_readout import reads_out
from sim.runs.run import run_controllers, sample_times
from synth.vehicle.designer import Designer
from tests import test_cars
from tests.analysed import energy, simulate
from tests.commands import in_the_suite

FRONT, REAR = 24000.0, 9000.0  # N m/rad, of a passenger car


@pytest.fixture(scope="module")
def barred():
    """The full car with two bars."""
    text = read_vehicle("full_car").text.replace(
        "[performance]", f"anti_roll_stiffness_front = {FRONT}\nanti_roll_stiffness_rear = {REAR}\n\n[performance]", 1
    )
    return parse_vehicle(text)


@pytest.mark.parametrize("index", in_the_suite((0, 1), range(4)))
def test_equations_are_the_physics(barred, index):
    """Found by differences in MuJoCo, a car with bars obeys its A, B, Bw and Br, to 1e-7."""
    test_cars.test_linearisation_is_the_hand_derived_one(barred, index)


def test_bars_are_stiff_against_roll_alone(barred):
    """A body that rolls over its axles by an angle meets a moment of both bars' stiffness times it; one that heaves, pitches, or
    rolls with its axles meets none."""
    plain = read_vehicle("full_car")
    with_bars, without = (build_model(one, 1e-3) for one in (barred, plain))

    def push(model, motion):
        data = mujoco.MjData(model)
        for joint, value in motion.items():
            data.joint(joint).qpos[0] = value
        mujoco.mj_forward(model, data)
        return data.qfrc_passive.copy()

    roll, side = 0.01, plain.parameters["track"] / 2 * 0.01
    wheels = {f"unsprung_{axle}_{name}": sign * side for axle in ("front", "rear") for name, sign in (("left", 1), ("right", -1))}
    for motion, moment in (({"roll": roll}, FRONT + REAR), ({"heave": 0.02, "pitch": 0.01}, 0), ({"roll": roll, **wheels}, 0)):
        extra = push(with_bars, motion) - push(without, motion)
        found = dict(zip([with_bars.joint(i).name for i in range(with_bars.njnt)], extra, strict=True))
        assert found["roll"] == pytest.approx(-moment * roll, abs=1e-9)  # rounding of 460 N m beside the weight
        assert found["heave"] == found["pitch"] == pytest.approx(0.0, abs=1e-9)
        assert found["unsprung_front_left"] == pytest.approx(FRONT * roll / (2 * side) * roll if moment else 0.0, abs=1e-9)


def test_without_bars_nothing_changes(barred):
    """A file that says nothing of bars has none: its model is bit for bit that of a file that says 0, without a tendon."""
    plain = read_vehicle("full_car")
    zero = dataclasses.replace(barred, parameters={**barred.parameters} | dict.fromkeys(list(barred.parameters)[-2:], 0.0))
    assert plain.parameters == zero.parameters
    assert plain.parameters["anti_roll_stiffness_front"] == 0.0
    models = [build_model(one, 1e-3) for one in (plain, zero, barred)]
    assert [model.ntendon for model in models] == [8, 8, 10]
    for name in ("A", "B", "Bw", "Br", "C", "D", "Cr"):
        np.testing.assert_array_equal(getattr(plain.linear_model, name), getattr(zero.linear_model, name))


@pytest.mark.attack
def test_physics_agrees_and_energy_balances(barred):
    """Over a bump under the left wheels MuJoCo agrees with the analysis of a car with bars; no energy is lost."""
    time, road = sample_times(barred, 2.0, 1e-3), Bump(height=0.05, track="left")
    (run,) = run_controllers(barred, [Designer(barred).design("passive")], road, time)
    assert run.agreement.agrees
    assert run.energy is not None
    assert run.energy.residual < 1e-6  # RK4's share; measured 2e-7


def test_error_goes_with_the_amplitude(barred):
    """At 1 mm the difference from the exact sampled response is RK4's own and rounding, not a thousandth of a bump's."""
    controller, time = Designer(barred).design("passive"), sample_times(barred, 1.0, 1e-3)
    runs = [run_controllers(barred, [controller], Bump(height=height, track="left"), time)[0] for height in (0.05, 1e-3)]
    errors = [max(one.sampled for one in run.agreement.signals.values()) for run in runs]
    assert errors[1] < 2e-6  # measured 5e-7, as without bars
    assert errors[1] < errors[0] / 1000  # measured 1.1e-3 there: geometry


def test_vehicles_with_and_without_bars_are_not_stepped_side_by_side(barred):
    """A batch of MuJoCo's has one number of tendons: a car without bars reads out otherwise than one with them."""
    plain, softer = (
        read_vehicle("full_car"),
        dataclasses.replace(barred, parameters={**barred.parameters, "anti_roll_stiffness_front": 1.0}),
    )
    keys = [reads_out(one, 1e-3) for one in (plain, barred, softer)]
    assert keys[0] != keys[1] == keys[2]
    passive = Designer(barred).design("passive")
    time, road = sample_times(barred, 0.2, 1e-3), Bump(height=0.05, track="left")
    together = simulate([barred, softer] * 2, [passive] * 4, [road] * 4, time).response.values
    alone = simulate([softer] * 2, [passive] * 2, [road] * 2, time).response.values
    np.testing.assert_array_equal(together[1], alone[0])


def test_a_bar_is_energy_of_its_own(barred):
    """The energy balance finds a bar that is 10 % off in physics: it would be work that nobody has done."""
    run = simulate([barred], [Designer(barred).design("passive")], [Bump(track="left")], sample_times(barred, 1.0, 1e-3))
    off = dataclasses.replace(barred, parameters={**barred.parameters, "anti_roll_stiffness_front": 1.1 * FRONT})
    assert energy(barred, run, 0, Bump(track="left")).balances
    assert not energy(off, run, 0, Bump(track="left")).balances


def test_derivative_is_of_these_signals(barred):
    """The bar's tendon is no signal: nothing that is measured changes by its being there."""
    plain = read_vehicle("full_car")
    of = [test_cars.derivative(one, build_model(one, 1e-3), "qpos", 7) for one in (barred, plain)]
    kinematic = [i for i, name in enumerate(plain.linear_model.outputs) if "deflection" in name]
    np.testing.assert_array_equal(of[0][kinematic], of[1][kinematic])
