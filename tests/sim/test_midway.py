"""Ride is read midway where held forces leap, and so hardly depends on how often it is read."""

import numpy as np
import pytest

from models.roads.iso8608 import Iso8608
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.studies.ride.expected import expect
from sim.studies.ride.metrics import measure
from synth.vehicle.designer import Designer
from tests.conftest import LAGGED
from tests.support.analysed import simulate
from tests.support.commands import in_the_suite

HOLDING = "\n[implementation]\nsample_period = 0.01\n"
STEPS = (1e-2, 5e-3, 2.5e-3, 2.5e-4)
RIDE = ("_rms", "_weighted")  # endings of the metrics of every acceleration


def ride_of(found):
    """The ride among metrics."""
    return {name: value for name, value in found.items() if "acceleration" in name and name.endswith(RIDE)}


@pytest.fixture
def slow_road():
    """A road whose waves are 20 Hz and below: that it is held over a timestep hardly matters."""
    return Iso8608("B", 0, 20.0, length=777.0, highest=1.0)


def check_second_order(*coarse, fine):
    """Numbers read every 10, 5 and 2.5 ms come to those read every 0.25 ms with about the square of that."""
    for metric, exact in fine.items():
        errors = np.array([abs(one[metric] / exact - 1) for one in coarse])
        # A quarter each time were it only for the leaps; the beginning and the end of the window count once.
        assert np.all(errors < (0.05, 0.05 / 3, 0.05 / 9)), metric


HELD = [("quarter_car", "", "I"), ("quarter_car_semi_active", "", "sky"), ("half_car", "", "I"), ("quarter_car", LAGGED, "I")]


@pytest.mark.parametrize(("name", "reality", "controller"), in_the_suite(HELD[1:2], HELD[1:]))
def test_how_often_it_is_read(slow_road, name, reality, controller):
    """For forces and coefficients held for 10 ms, MuJoCo's ride read once a sample is that read forty times; else 15 % off."""
    vehicle = parse_vehicle(read_vehicle(name).text + reality + HOLDING)
    designed, found = Designer(vehicle).design(controller), []
    for h in STEPS:
        run = simulate([vehicle], [designed], [slow_road], np.arange(round(4 / h) + 1) * h).response.run(0)
        found.append(ride_of(measure(vehicle, run, 0)))
    check_second_order(*found[:-1], fine=found[-1])


def test_what_is_expected(slow_road):
    """And so does the ride that is expected."""
    vehicle = parse_vehicle(read_vehicle("half_car").text + HOLDING)
    designed, found = Designer(vehicle).design("I"), []
    for h in STEPS:
        expected = expect(vehicle, designed, slow_road.spectrum, h, 6.0)
        assert expected is not None
        found.append(ride_of(expected.mean))
    check_second_order(*found[:-1], fine=found[-1])
