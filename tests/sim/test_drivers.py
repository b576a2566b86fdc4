"""A driver of the user's own is a controller like any other, and its commands are checked."""

import numpy as np
import pytest

from models import Bump, InputError, parse_vehicle, read_vehicle
from sim import run
from sim.runs.report import verdict

ROAD = Bump(height=0.05)
DAMPER = '\n[actuators]\nkind = "damper"\nc_min = 300.0\nc_max = 4000.0\n'


class Proportional:
    """Requests in proportion to the body's velocity."""

    measured, ahead, requests = ("sprung_velocity",), 0, "forces"

    def __init__(self, gain: float = -2000.0) -> None:
        self.gain = gain

    def start(self, vehicles, timestep):
        return np.zeros((len(vehicles), 0))

    def step(self, k, y, ahead, state):
        return self.gain * y, state


def test_it_drives_as_the_gain_of_a_file_does():
    """A static gain in a driver and the same gain in the vehicle file make the same run."""
    text = read_vehicle("quarter_car").text + '\n[controllers.same]\nmeasured = ["sprung_velocity"]\ngain = [[-2000.0]]\n'
    own, ours = run(parse_vehicle(text), [Proportional(), "same"], ROAD, 1.0)
    assert own.passed
    np.testing.assert_array_equal(own.physics.values, ours.physics.values)


def test_it_sees_the_road_ahead():
    """The last of its heights is the road that the wheel meets `ahead - 1` samples later."""

    class Seeing(Proportional):
        ahead = 51

        def step(self, k, y, ahead, state):
            return 1e3 * ahead[:, 0, -1:], state

    [one] = run(read_vehicle("quarter_car"), Seeing(), ROAD, 1.0)
    np.testing.assert_allclose(one.physics["control_force"][:-50], 1e3 * one.physics["road_displacement"][50:], atol=1e-12)
    assert one.passed


def test_it_sets_coefficients_within_the_range_of_its_dampers():
    class Firm(Proportional):
        requests = "coefficients"

        def step(self, k, y, ahead, state):
            return np.full_like(y, 5000.0 if k < 300 else 1000.0), state

    [one] = run(parse_vehicle(read_vehicle("quarter_car").text + DAMPER), Firm(), ROAD, 1.0)
    assert one.passed
    assert set(one.physics["damping"].round(9)) == {4000.0, 1000.0}


def test_what_it_keeps_to_itself_is_said():
    """A driver that answers otherwise when it is started again is not called wrong, but not repeatable."""

    class Growing(Proportional):
        def start(self, vehicles, timestep):
            self.gain *= 1.1
            return super().start(vehicles, timestep)

    [one] = run(read_vehicle("quarter_car"), Growing(), ROAD, 1.0)
    assert one.passed
    assert one.agreement.commands is not None
    assert not one.agreement.commands.repeatable
    assert "no command is compared, because the control law is not repeatable" in verdict(one).text


def test_an_end_at_once_is_said_in_the_short_verdict():
    """If a force reaches its limit at the first sample, nothing is compared with linear analysis, and this is printed."""

    class Full(Proportional):
        def step(self, k, y, ahead, state):
            return np.full_like(y, 5000.0), state

    [one] = run(parse_vehicle(read_vehicle("quarter_car").text + "\n[limits]\nactuator_force = 100.0\n"), Full(), ROAD, 0.2)
    assert one.agreement.until == 0
    assert "nothing is compared with linear analysis, which applies until 0 s (" in verdict(one).text


def test_requests_of_another_shape_are_refused():
    class Flat(Proportional):
        def step(self, k, y, ahead, state):
            return self.gain * y[0], state

    with pytest.raises(InputError, match=r"driver Flat: step returns forces of shape \(1,\); expected \(1, 1\), a row per run"):
        run(read_vehicle("quarter_car"), Flat(), ROAD, 1.0)
