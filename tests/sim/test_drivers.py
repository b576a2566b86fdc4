"""Every driver, by its registry, and a driver of the user's own: a controller like any other, whose commands are checked."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from models import Bump, InputError, parse_vehicle, read_vehicle
from models.laws.python_law import of_function
from models.roads.road import RoadInput
from sim import run
from sim.drive.driver import RecordedForces
from sim.drive.drivers.registry import DRIVERS
from sim.linear.prediction import predict_run
from sim.runs.agreement import compare
from sim.runs.report import reasons, verdict
from sim.runs.run import compare_runs, sample_times, with_energy_balance
from synth.vehicle.designer import driver_of
from tests.commands.test_export import BUILT, COMPILER, LAW, needs_cc
from tests.sim.test_code_in_the_loop import WIDE, coded
from tests.support.analysed import simulate_inputs as simulate

ROAD = Bump(height=0.05)
DAMPER = '\n[actuators]\nkind = "damper"\nc_min = 300.0\nc_max = 4000.0\n'
TEXT = read_vehicle("quarter_car").text


def in_python(sample, state):
    """A law with a state of its own."""
    state = 0.9 * (state or 0.0) + sample["sprung_velocity"]
    return -200.0 * state, state


def met(vehicle, height=0.03) -> RoadInput:
    return RoadInput(vehicle, Bump(height), sample_times(vehicle, 0.2, 1e-3))


def repeated(vehicle) -> RecordedForces:
    return RecordedForces((), simulate([driver_of(vehicle, "I_printed")], [met(vehicle)]).recordings[0].commands)


DRIVEN = {  # the vehicle of each driver, and what makes a controller that it drives
    "linear": (TEXT + LAW + BUILT + WIDE, lambda vehicle: driver_of(vehicle, "law")),
    "semi_active": (f'{TEXT}{DAMPER}[controllers.sky]\nsemi_active = "skyhook_add"\n', lambda vehicle: driver_of(vehicle, "sky")),
    "python": (TEXT, lambda vehicle: of_function(in_python, ("sprung_velocity",))),
    "recorded": (TEXT, repeated),
    "code": (TEXT + LAW + BUILT + WIDE, lambda vehicle: coded(vehicle, driver_of(vehicle, "law"), "double")),
}


@cache
def driven_by(name: str):
    """A vehicle and the controller of a driver."""
    text, make = DRIVEN[name]
    vehicle = parse_vehicle(text)
    return vehicle, make(vehicle)


def test_every_driver_has_a_row():
    assert {*DRIVEN} == {*DRIVERS}
    assert all(driven_by(name)[1].driver_key[0] == name for name in DRIVEN if name != "code" or COMPILER)


@pytest.mark.parametrize("name", [pytest.param(name, marks=needs_cc) if name == "code" else name for name in DRIVEN])
def test_a_run_agrees_and_other_commands_are_found(name):
    """Unlike runs side by side are those alone, to the last bit; they agree, but not with commands that are 1e-5 off."""
    vehicle, driver = driven_by(name)
    inputs = [met(vehicle), met(vehicle.with_parameters(sprung_mass=450.0)), met(vehicle, 0.05)]
    first, *others = simulate([driver] * 3, inputs).recordings
    for on, one in zip(inputs, (first, *others), strict=True):
        assert np.array_equal(one.response.values, simulate([driver], [on]).run(0).values)
    assert not np.array_equal(first.response.values, others[0].response.values)
    if name == "recorded":
        again = simulate([driver_of(vehicle, "I_printed")], inputs[:1]).run(0)
        assert np.array_equal(first.response.values[:, : again.values.shape[1]], again.values)
        return
    prediction = predict_run(driver, inputs[0], first.commands)
    assert with_energy_balance(compare_runs([prediction], [first]), [first])[0].passed
    found = compare(prediction, replace(first, commands=1.00001 * first.commands))
    assert [one.agrees for one in (found.steps, found.commands) if one is not None] == [False, False]


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
    assert "there is no comparison with linear analysis, which applies only until 0 s (" in verdict(one).text


class Timed(Proportional):
    """Requests a force that depends on time alone."""

    def __init__(self, force) -> None:
        self.force = force

    def start(self, vehicles, timestep):
        self.timestep = timestep
        return super().start(vehicles, timestep)

    def step(self, k, y, ahead, state):
        return np.full((len(y), 1), self.force(k * self.timestep)), state


def rated(*lines: str):
    """The paper's car with actuators whose force changes by 20 kN/s at most."""
    return parse_vehicle("\n".join([read_vehicle("quarter_car").text, "[limits]", 'force_rate = "20 kN/s"', *lines]))


@pytest.mark.parametrize(("period", "delay", "most"), [(1, 0, 1500.0), (5, 0, 1030.0), (5, 2, 1030.0)])
@pytest.mark.parametrize("lag", [None, 60.0])
def test_a_step_request_becomes_a_ramp(period, delay, most, lag):
    """A request of 1500 N from 0.1 s on gives a ramp of 20 kN/s up to the largest force, held from sample to sample, and a lag
    follows this ramp. The linear regime ends at the first sample of the ramp, where the rate is reached.
    """
    lines = [f"actuator_force = {most}", *([f"actuator_bandwidth = {lag}"] if lag else [])]
    lines += ["[implementation]", f"sample_period = {1e-3 * period}", f"delay = {delay}"]
    [one] = run(rated(*lines), Timed(lambda t: 1500.0 * (t > 0.0999)), ROAD, 0.4)
    assert one.passed
    k, z = np.arange(401), 1e-3 * (lag or 0.0)
    ramp = np.clip(20.0 * period * ((k - 100) // period - delay + 1), 0.0, most)
    force, way = np.zeros(401), z * (1 - z / 2 * (1 - z / 3 * (1 - z / 4)))  # of RK4
    for i in range(400 if lag else 0):
        force[i + 1] = force[i] + way * (ramp[i] - force[i])
    np.testing.assert_allclose(one.physics["control_force"], force if lag else ramp, rtol=0, atol=1e-9)
    assert one.agreement.end_times["rate limit"] == one.agreement.until == pytest.approx(0.1 + 1e-3 * period * delay)
    assert any("rate limit: a command first changes as fast as force_rate allows at" in line.text for line in reasons(one))


def test_a_fast_sine_becomes_a_triangle():
    """A sine of 8 Hz with slopes up to 75 kN/s gives a triangle with slopes of 20 kN/s and the peak 20 kN/s / 32 Hz."""
    [one] = run(rated(), Timed(lambda t: 1500.0 * np.sin(2 * np.pi * 8 * t)), ROAD, 1.0)
    force = one.physics["control_force"][500:]  # periods of 125 ms
    assert one.passed
    assert np.abs(np.diff(force)).max() <= 20.0 * (1 + 1e-12)
    assert np.mean(np.abs(np.diff(force)) > 19.999) > 0.9
    assert force.max() == pytest.approx(20e3 / (4 * 8), abs=20.0)
    np.testing.assert_allclose(force[125:], force[:-125], rtol=0, atol=1e-9)


def test_a_rate_that_is_never_reached_changes_no_bit():
    """A run with a rate limit that is not reached has the numbers of one without, and both are linear."""
    [free] = run(read_vehicle("quarter_car"), Proportional(), ROAD, 0.5)
    [one] = run(rated(), Proportional(), ROAD, 0.5)
    np.testing.assert_array_equal(one.physics.values, free.physics.values)
    assert np.isinf([one.agreement.until, free.agreement.until]).all()


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (
            ['limit = "force"', "actuator_force = 1e3", "actuator_bandwidth = 60"],
            r"with force_rate, actuator_force also limits the commands",
        ),
        (["[limits.front]", "force_rate = 1e3"], r"\[limits.front\]"),
        (["[actuators]", 'kind = "damper"', "c_min = 300", "c_max = 4e3"], r"force_rate"),
    ],
)
def test_where_a_rate_limit_is_refused(lines, said):
    with pytest.raises(InputError, match=said):
        rated(*lines)


def test_requests_of_another_shape_are_refused():
    class Flat(Proportional):
        def step(self, k, y, ahead, state):
            return self.gain * y[0], state

    with pytest.raises(
        InputError,
        match=r"driver Flat: step returns forces of shape \(1,\); return the shape \(1, 1\), with one row for each run",
    ):
        run(read_vehicle("quarter_car"), Flat(), ROAD, 1.0)
