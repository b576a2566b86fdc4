"""Runs shared out among threads: the same numbers, and none that steps on when nobody waits for it."""

import _thread
import signal
import threading
from contextlib import closing
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from models.common.threads import AHEAD, one_thread, side_by_side
from models.roads.obstacles import Flat
from models.roads.road import Bump
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import read_vehicle
from sim.drive.case import Batch, Case
from sim.drive.drive import drive
from sim.drive.loop import Block
from sim.observers.recorder import record
from tests.support.analysed import simulate
from tests.support.shared import designed

# Ctrl-C as POSIX sends it, which wakes a thread that waits.
MAIN = threading.main_thread().ident or 0
SEND = partial(signal.pthread_kill, MAIN, signal.SIGINT) if hasattr(signal, "pthread_kill") else None


def times(timestep: float, duration: float) -> np.ndarray:
    return np.arange(round(duration / timestep) + 1) * timestep


def test_a_block_has_one_thread_of_blas():
    """BLAS has one thread within blocks, nested or not, and after the last one as many as before."""

    def counts() -> set[int]:
        return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}

    with threadpool_limits(limits=2, user_api="blas"):
        before = counts()
        with one_thread():
            assert counts() <= {1}
            with one_thread():
                pass
            assert counts() <= {1}
        assert counts() == before


@pytest.mark.parametrize("kind", ["quarter_car", pytest.param("full_car", marks=pytest.mark.attack)])
def test_no_bit_depends_on_threads_or_on_runs_of_a_controller_beside(kind):
    """Whatever computers, delays and noise the runs have: one that has none rounds as it does beside one that has, and alone."""
    vehicle, time = read_vehicle(kind), times(1e-3, 0.3)
    passive, active = [designed(vehicle, name) for name in ("passive", "I")]
    noise = dict.fromkeys(active.measured, 1e-3)
    built = [
        Implementation(),
        Implementation(sample_period=3e-3),
        Implementation(sample_period=3e-3, delay=1),
        Implementation(sample_period=4e-3, delay=0.5),
        Implementation(sample_period=4e-3, delay=2.25),
        Implementation(noise=noise, quantisation=noise, seed=3),
    ]
    # Four that need no sensor, four that are a gain and no more, and two with each computer.
    vehicles = [vehicle] * 8 + [replace(vehicle, implementation=how) for how in built * 2]
    given = [passive] * 4 + [active] * 16
    roads = [Bump(height=0.01 * (1 + i)) for i in range(20)]
    together, *shared = [simulate(vehicles, given, roads, time, threads) for threads in (1, 2, 3)]
    for runs in shared:
        for name in ("qpos", "qvel", "diverged"):
            np.testing.assert_array_equal(getattr(runs, name), getattr(together, name))
        np.testing.assert_array_equal(runs.response.values, together.response.values)
    for i in (5, 8, 9, 10, 11, 12, 13):
        alone = simulate(vehicles[i : i + 1], given[i : i + 1], roads[i : i + 1], time)
        np.testing.assert_array_equal(alone.response.values[0], together.response.values[i])


def test_one_call_drives_cars_of_any_kind():
    """Cars that cannot be stepped side by side are driven in groups. Each run is that of the car alone, in the order of cases."""
    cars = [read_vehicle(kind) for kind in ("half_car", "quarter_car", "half_car_roll", "quarter_car", "full_car")]
    cases = [Case(car, designed(car, "passive"), Bump(height=0.02)) for car in cars]
    for one, case in zip(record(cases, times(1e-3, 0.2)), cases, strict=True):
        (alone,) = record([case], times(1e-3, 0.2))
        assert one.vehicle is case.vehicle
        np.testing.assert_array_equal(one.response.values, alone.response.values)


def test_runs_stop_when_no_more_of_them_is_wanted(paper, designer):
    """Who leaves the runs, as by Ctrl-C, leaves no thread behind that steps on."""
    time = times(1e-3, 300.0)  # half a minute of work
    before, begun = threading.active_count(), [threading.Event() for _ in range(2)]

    class Watch:
        def __init__(self, batch: Batch) -> None:
            self.number = batch.numbers[0] // 4

        def take(self, block: Block) -> None:
            begun[self.number].set()

        def result(self) -> list[None]:
            raise AssertionError("the runs are not at their end")

    def interrupt() -> None:
        for event in begun:
            event.wait()
        (SEND or _thread.interrupt_main)()

    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt):
        drive([Case(paper, designer.design("I"), Flat())] * 8, time, Watch, threads=2, streamed=True)
    assert all(event.is_set() for event in begun)
    assert threading.active_count() <= before + 1  # the timer's own may still be there


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


def test_pieces_that_wait_are_abandoned():
    """A caller that stops early ends what its running pieces wait for."""
    hanging = threading.Event()
    pieces = [lambda stopped: None, *[lambda stopped: hanging.wait(60)] * 2]
    with closing(side_by_side(pieces, 3, hanging.set)) as done:
        assert next(done) == (0, None)
        assert not hanging.is_set()
    assert hanging.is_set()
