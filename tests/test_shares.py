"""Runs shared out among threads: the same numbers, and none that steps on when nobody waits for it."""

import _thread
import threading
from collections import deque
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from models.common.side_by_side import AHEAD, side_by_side
from models.reality import Implementation
from models.roads.road import Bump
from models.vehicle import read_vehicle
from sim.physics.blocks import Course, in_blocks, in_shares
from sim.physics.simulate import simulate
from synth.designer import Designer

HALVES = [slice(0, 4), slice(4, 8)]


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
    course = Course([paper] * 8, [designer.design("I")] * 8, heights, heights, 1e-3, (0, 10, len(time)))
    shares = in_shares(course, HALVES)
    begun = [threading.Event() for _ in shares]

    def run(number: int, stopped: Callable[[], bool]) -> int:
        for _ in shares[number](stopped):
            begun[number].set()
        return number

    def interrupt() -> None:
        for event in begun:
            event.wait()
        _thread.interrupt_main()

    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt), closing(side_by_side([partial(run, 0), partial(run, 1)], 2)) as done:
        deque(done, maxlen=0)
    assert all(event.is_set() for event in begun)
    assert threading.active_count() <= before + 1  # the timer's own may still be there


def test_a_run_that_is_not_wanted_stays_where_it_is(paper, designer):
    """What is left of the runs goes on as it would have beside the others, and those that are not wanted do not move."""
    time = times(1e-3, 0.3)
    heights = np.sin(20 * time)[:, None, None] * np.linspace(0.01, 0.03, 3)[:, None]
    vehicles = [paper, replace(paper, implementation=Implementation(sample_period=4e-3, delay=2)), paper]
    course, going = (
        Course(vehicles, [designer.design("I")] * 3, heights, heights, 1e-3, (0, 100, 200, len(time))),
        np.full(3, True),
    )
    whole, left = in_blocks(course), in_blocks(replace(course, going=going))
    for k in range(3):
        all_of_them, some = next(whole), next(left)
        np.testing.assert_array_equal(some.values[:, :, going], all_of_them.values[:, :, going])
        np.testing.assert_array_equal(some.qpos[1:, ~going], np.broadcast_to(some.qpos[:1, ~going], some.qpos[1:, ~going].shape))
        going[k] = False


def test_work_is_taken_as_threads_become_free():
    """Every result comes with its piece's number, none is begun far ahead of being asked for, and a failure is handed on."""
    taken = []

    def pieces():
        for number in range(10):
            taken.append(number)
            yield lambda stopped, number=number: number**2

    with closing(side_by_side(pieces(), 2)) as done:
        results = [next(done)]
        assert len(taken) <= 2 * AHEAD
        results += done
    assert sorted(results) == [(number, number**2) for number in range(10)]
    with pytest.raises(ZeroDivisionError), closing(side_by_side([lambda stopped: 1 / 0], 2)) as done:
        next(done)
