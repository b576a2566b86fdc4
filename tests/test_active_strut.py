"""Purely active struts, `suspension_stiffness = 0` and no damper: on every car, under laws that hold it."""

import re

import numpy as np
import pytest

from models.roads.choice import choose_road
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.runs.run import run_controllers, sample_times
from synth.vehicle.designer import Designer
from tests.commands import attacks


def active(kind: str):
    """A car without springs and dampers, under its LQR."""
    text = re.sub(r"^(suspension_(?:stiffness|damping)\w* = ).*$", r"\g<1>0.0", read_vehicle(kind).text, flags=re.M)
    return parse_vehicle(f'{text}\n[controllers.lqr]\ndesign = "lqr"\n')


@pytest.mark.parametrize("kind", ["quarter_car", "half_car", *attacks(["full_car"])])
def test_physics_agrees(kind):
    """MuJoCo holds the weight by a constant force, and its steps are those of the equations; its energy balances."""
    vehicle = active(kind)
    road = choose_road("bump:height=0.03").build(vehicle, 12.5, 0, 0.8)
    (run,) = run_controllers(vehicle, [Designer(vehicle).design("lqr")], road, sample_times(vehicle, 0.8, 1e-3))
    assert run.passed
    assert run.agreement.steps is not None
    assert run.agreement.steps.error < 1e-10
    assert run.energy is not None
    assert run.energy.balances
    assert all(np.isinf(when) for when in run.agreement.ended.values())


def test_the_optimum_is_thompsons():
    """The four gains of Thompson's strut, by a Riccati equation of an own plant: 1 / sqrt(0.8e-9) is the spring, exactly."""
    text = read_vehicle("models/gallery/thompson/car.toml").text
    gain = Designer(parse_vehicle(text)).design("lqr").law.D[0]
    own = [-35355.33905933, 21878.65376721, -4826.50789578, 1385.70230169]
    assert gain == pytest.approx(own, rel=1e-9)


def test_a_passive_car_without_springs_has_no_norm():
    """It floats: nothing decays, and nothing is claimed of it."""
    vehicle = active("quarter_car")
    assert not Designer(vehicle).design("passive").certificate.stability.stable
