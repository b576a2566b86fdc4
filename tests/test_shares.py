"""Runs shared out among threads: the same numbers, and none that steps on when nobody waits for it."""

import _thread
import threading
from collections import deque
from dataclasses import replace

import numpy as np
import pytest

from models.reality import Implementation
from models.vehicle import read_vehicle
from sim.physics.blocks import in_blocks
from sim.physics.simulate import simulate
from sim.roads.road import Bump
from synth.designer import Designer


def times(timestep: float, duration: float) -> np.ndarray:
    return np.arange(round(duration / timestep) + 1) * timestep


@pytest.mark.parametrize("kind", ["quarter_car", "full_car"])
def test_threads_change_no_bit(kind):
    """Whatever computers, noise and second controllers the runs have: one that has none rounds as it does beside one that has."""
    vehicle, time = read_vehicle(kind), times(1e-3, 0.3)
    controllers = [Designer(vehicle).design(name) for name in ("passive", "I")]
    noise = dict.fromkeys(controllers[1].measured, 1e-3)
    built = [
        Implementation(),
        Implementation(sample_period=3e-3, delay=1),
        Implementation(noise=noise, quantisation=noise, seed=3),
    ]
    # Four that need no sensor, four that are a gain and no more, and four with all there is.
    vehicles = [vehicle] * 8 + [replace(vehicle, implementation=built[i % 3]) for i in range(4)]
    given, beside = [controllers[0]] * 4 + [controllers[1]] * 8, [None] * 9 + [controllers[1]] * 3
    roads = [Bump(height=0.01 * (1 + i)) for i in range(12)]
    together, *shared = [simulate(vehicles, given, roads, time, threads, beside) for threads in (1, 2, 3)]
    for runs in shared:
        for name in ("qpos", "qvel", "diverged"):
            np.testing.assert_array_equal(getattr(runs, name), getattr(together, name))
        np.testing.assert_array_equal(runs.response.values, together.response.values)


def test_runs_stop_when_no_more_of_them_is_wanted(paper, designer):
    """Who leaves the runs, as by Ctrl-C, leaves no thread behind that steps on."""
    time = times(1e-3, 300.0)  # minutes of work
    heights = np.zeros((len(time), 8, 1))
    before = threading.active_count()
    blocks = in_blocks([paper] * 8, [designer.design("I")] * 8, heights, heights, 1e-3, 2, 100)
    next(blocks)
    assert threading.active_count() == before + 2
    interrupted = threading.Timer(0.2, _thread.interrupt_main)
    interrupted.start()
    with pytest.raises(KeyboardInterrupt):
        deque(blocks, maxlen=0)
    assert threading.active_count() <= before + 1  # the timer's own may still be there
