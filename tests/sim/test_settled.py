"""The share of the final variance when measuring begins."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from models.laws.linear import static_law
from models.roads.iso8608 import Iso8608
from models.roads.road import Road, track_width
from models.vehicle.vehicle import read_vehicle
from sim.linear.frequency_response import stepwise_frequency_response
from sim.studies.ride.expected import expect, remaining_transient, settled_shares, sources
from synth.vehicle.designer import Designer, certify_given
from tests.support.analysed import sampled_responses
from tests.support.commands import attacks


class Line:
    """One line of a random road, from its own height at the start."""

    kinks, speed, loaded = (0.0,), 20.0, Road.loaded
    track_of, delay_of, from_start, held_height = Road.track_of, Road.delay_of, Road.from_start, Road.held_height

    def __init__(self, height, omega):
        self.height, self.omega = height, omega

    def displacement(self, t, side=""):
        return np.where(t >= 0, np.real(self.height * (np.exp(1j * self.omega * t) - 1)), 0.0)

    def velocity(self, t, side=""):
        return np.where(t >= 0, np.real(self.height * 1j * self.omega * np.exp(1j * self.omega * t)), 0.0)


@pytest.mark.parametrize(
    ("name", "controller", "how"),
    [
        ("quarter_car", "I", {}),  # its force follows the body's slow velocity, and has more at 0.5 s than it comes to
        *attacks([("quarter_car", "II", {"sample_period": 8e-3, "delay": 1.5}), ("half_car", "passive", {})]),
    ],
)
def test_how_much_of_the_variance_is_there_when_measuring_begins(name, controller, how):
    """At any time it is what the responses to all lines of the road have, each at two phases, of what that comes to."""
    vehicle, h = read_vehicle(name), 4e-3
    vehicle = dataclasses.replace(vehicle, implementation=dataclasses.replace(vehicle.implementation, **how))
    designed, road = Designer(vehicle).design(controller), Iso8608("C", 0, 20.0, length=100.0)
    omega = 2 * np.pi * road.speed * road.n
    lines: Any = [Line(phase / w, w) for w in omega for phase in (1, 1j)]
    responses = sampled_responses(vehicle, designed, lines, np.arange(260) * h)
    comes_to = expect(vehicle, designed, road.spectrum, h, 10.0)
    white = (2 * np.pi * 0.1) ** 2 * 256e-6 * road.speed * road.speed / road.length
    assert comes_to is not None
    values, leaps = (
        one @ sources(vehicle, road.spectrum, omega) for one in stepwise_frequency_response(vehicle, designed, omega, h)
    )
    by_step = values[:-1]
    sides = [np.moveaxis(np.sum(np.abs(one) ** 2, axis=(1, 3)), 1, 0) for one in (by_step, by_step - leaps / 2)]
    by_step, midway = (dict(zip(vehicle.linear_model.outputs, one, strict=True)) for one in sides)
    for start in (0.056, 0.2, 0.504, 1.0):  # s; the half car's rear wheel comes at 0.13 s
        shares = settled_shares(vehicle, designed, road.spectrum, h, start)
        for signal in {*shares} & {metric.removesuffix("_rms") for metric in comes_to.mean}:
            at_samples = comes_to.mean[f"{signal}_rms"] ** 2 * by_step[signal][0]  # when it begins
            at_samples /= (midway if "acceleration" in signal else by_step)[signal].mean()
            there = white * np.sum(responses[signal][:, round(start / h)] ** 2) / at_samples
            # A sum is no integral for 1 rad/s of lines as far apart; measured 2.5e-2, and 1e-3 with lines a quarter as far
            assert shares[signal] == pytest.approx(there, abs=0.03)
        found = remaining_transient(vehicle, designed, road.spectrum, h, start)
        assert found is not None
        assert abs(found.share - 1) == max(abs(share - 1) for share in shares.values())
    if controller == "I":
        slow = settled_shares(vehicle, designed, Iso8608("C", 0, 20.0).spectrum, h, 0.504)
        assert slow["control_force"] == pytest.approx(1.12, abs=0.01)  # over 400 seeds 1.17 +- 0.08


@pytest.mark.parametrize(
    ("name", "law"), [("quarter_car", 6e4), ("quarter_car_semi_active", -1500.0)], ids=["unstable", "damper"]
)
def test_no_share_is_known_of_a_loop_without_a_linear_course(name, law):
    """A loop that grows, and one whose adjustable dampers do not give every force, have no final variance."""
    vehicle = read_vehicle(name)
    controller = certify_given(vehicle, "mine", ["sprung_velocity"], static_law(np.array([[law]])))
    assert remaining_transient(vehicle, controller, Iso8608("C", 0, 20.0).spectrum, 4e-3, 1.0) is None


def test_in_the_end_all_of_the_variance_is_there():
    """Long after the start every share is 1, on two tracks and four wheels, too; at the start no suspension has moved."""
    vehicle = read_vehicle("full_car")
    passive, road = Designer(vehicle).design("passive"), Iso8608("C", 0, 20.0, track_width(vehicle))
    shares = settled_shares(vehicle, passive, road.spectrum, 4e-3, 25.0)  # of the slowest mode exp(-9) is left
    assert len(shares) == 5 + 4 + 4  # vertical accelerations, suspensions, tyres; no force acts
    assert all(share == pytest.approx(1.0, abs=1e-6) for share in shares.values())
    start = settled_shares(vehicle, passive, road.spectrum, 4e-3, 0.0)
    assert all(start[name] < 1e-9 for name in start if name.startswith(("suspension", "tyre")))
