"""Margins of loops drawn at random: none disagrees, and long runs from rest grow or decay on both sides of every edge."""

import dataclasses
import math

import numpy as np
import pytest

from models.laws.linear import LinearLaw, static_law
from models.roads.road import Bump, RoadInput
from models.vehicle.limits_and_implementation import Implementation, Limits
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.studies.stability.margin_search import find_all, implemented_searches, loops_of, searches
from synth.controller.loop_of import loop_of, radius
from synth.vehicle.designer import certify_given, design
from tests.support.analysed import simulate_inputs as simulate
from tests.support.commands import attacks

TIMESTEP = 2e-3
FULL = """
[implementation]
noise = { suspension_deflection = 0.0005, sprung_acceleration = 0.05 }
[controllers.c]
measured = ["suspension_deflection", "sprung_acceleration"]
order = "full"
noise = true
"""


def drawn_law(rng, names, forces):
    """A sky damper with a share of the wheels' velocity, a PID controller or a law with states, on all corners alike."""
    size = 10 ** rng.uniform(2.5, 3.8)
    kind = rng.integers(3)
    if kind == 0:
        body, wheel = rng.uniform(-1, 0.2), rng.uniform(-0.3, 0.5)
        measured = tuple(f"{one}{name}" for name in names for one in ("sprung_velocity", "unsprung_velocity"))
        return measured, static_law(size * np.kron(np.eye(forces), [[body, wheel]]))
    measured, fast = tuple(f"suspension_deflection{name}" for name in names), 10 ** rng.uniform(1, 2.5)
    if kind == 1:
        kp, kd = size * rng.uniform(-1, 1), 0.1 * size * rng.uniform(-1, 0.3)
        B, C, D = np.eye(forces), -(fast**2) * kd * np.eye(forces), (kp + fast * kd) * np.eye(forces)
        return measured, LinearLaw(-fast * np.eye(forces), B, C, D)
    A = np.array([[-fast * rng.uniform(0.2, 1), fast], [-fast, -fast * rng.uniform(0.2, 1)]])
    B, C = rng.standard_normal((2, 1)), size * fast * rng.standard_normal((1, 2))
    A, B, C, D = (np.kron(np.eye(forces), part) for part in (A, B, C, np.zeros((1, 1))))
    return measured, LinearLaw(A, B, C, D)


def drawn_loop(seed):
    """A stable loop of a quarter-car or half-car: lagged, sampled and delayed by turns."""
    rng = np.random.default_rng(seed)
    while True:
        kind = "half_car" if seed % 5 == 4 else "quarter_car"
        own = read_vehicle(kind)
        vehicle = own.with_parameters(
            **{name: value * math.exp(rng.uniform(-0.4, 0.4)) for name, value in own.parameters.items()}
        )
        lag = 10 ** rng.uniform(1.5, 2.5) if rng.random() < 0.4 else None
        how = Implementation(sample_period=rng.choice([4e-3, 6e-3, 10e-3]), delay=int(rng.integers(3)))
        vehicle = dataclasses.replace(vehicle, limits=Limits(actuator_bandwidth=lag), implementation=how)
        if seed % 20 == 0:
            nominal = parse_vehicle(own.text + FULL)
            vehicle, controller = dataclasses.replace(nominal, limits=vehicle.limits, implementation=how), design(nominal, "c")
        else:
            names = [""] if kind == "quarter_car" else ["_front", "_rear"]
            controller = certify_given(vehicle, "c", *drawn_law(rng, names, len(names)))
        ideal = dataclasses.replace(vehicle, implementation=Implementation())
        radii = [radius(loop_of(each, controller, TIMESTEP)) for each in (vehicle, ideal)]
        if controller.certificate.stable and max(radii) < 1 - 1e-6:
            return vehicle, ideal, controller


def sides(edge):
    """Amounts off an edge, by no more than moves the slowest mode in a second or so; none if it moves too slowly everywhere."""
    for end, way in ((edge.stable, -1), (edge.unstable, 1)):
        for share in (0.02, 0.05, 0.1, 0.2, 0.4):
            amount = end * (1 + way * share)
            if edge.multiple:
                amount = max(1, round(amount / edge.multiple)) * edge.multiple
            rate = edge.loop(amount).rate
            if way * rate > 0.3:
                yield amount, rate
                break


@pytest.mark.parametrize("seed", [1, *attacks(range(200))])
def test_drawn_loops_agree_and_every_edge_is_one(seed):
    """No margin of a drawn loop disagrees. After a bump, runs of ten time constants decay below each edge and grow above it."""
    vehicle, ideal, controller = drawn_loop(seed)
    cut = loops_of(vehicle)[""]
    margins = [searches(ideal, controller, cut, TIMESTEP), implemented_searches(vehicle, controller, cut, TIMESTEP)]
    find_all(margins)
    assert all(one.agrees for one in margins)
    edges = [each for one in margins for each in (one.gain.search, one.gain_lower.search, one.delay, one.sample_period)]
    trials = [
        (edge.trial(amount), rate, edge.loop(amount))
        for edge in edges
        if edge.searched and edge.stable > 0 and math.isfinite(edge.unstable)
        for amount, rate in sides(edge)
    ]
    assert all(math.isfinite(one.gain.search.unstable) == math.isfinite(one.gain.sampled[0]) for one in margins)
    for trial, rate, loop in trials:
        seconds = max(10 / abs(rate), 60 * loop.loop.period * (loop.delay + 1), 2.0)
        time = np.arange(round(seconds / TIMESTEP) + 1) * TIMESTEP
        bump = Bump(height=1e-6, length=20.0, speed=100.0, track="left")  # soon over
        run = simulate([trial.controller], [RoadInput(trial.vehicle, bump, time)]).run(0)
        size = np.abs(np.stack([run[name] for name in trial.vehicle.linear_model.states]))
        diverged, quarter = bool(np.isnan(size).any()), len(time) // 4
        before, after = ((size[:, k * quarter : (k + 1) * quarter].max(axis=1) / np.nanmax(size, axis=1)).max() for k in (2, 3))
        assert (diverged or after > before) == (rate > 0), f"rate {rate:.3g} 1/s"
