"""The MuJoCo response: one function for one run or ten thousand.

What makes it agree with the analysis to the integrator's own error (RK4's, to the fourth power of the step):

- the road is a mocap body that MuJoCo holds over a step, so it is put at its height midway through the step;
- but signals are read with the road where it is at the sample;
- the controller is sampled: it reads the signals once a step, and its force is held.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.common.cores import cores
from models.common.side_by_side import side_by_side
from models.vehicle import Vehicle
from sim.physics.blocks import Block, in_shares
from sim.response.response import Response
from sim.roads.road import Road, under_wheels
from synth.controller import Controller

FEWEST = 4  # runs to a thread: of fewer the numpy between their steps, which one thread at a time can do, takes as long


@dataclass(frozen=True, eq=False)
class PhysicsRuns:
    """What MuJoCo made of N runs.

    Attributes:
        response: every signal, values of shape (N, T, S). From where a run diverged on, its values are NaN.
        qpos: generalized positions, shape (N, T, nq), to draw a run.
        qvel: generalized velocities, shape (N, T, nv).
        diverged: when each run diverged [s], shape (N,); infinite where it did not.
    """

    response: Response
    qpos: Array
    qvel: Array
    diverged: Array


def simulate(
    vehicles: Sequence[Vehicle],
    controllers: Sequence[Controller],
    roads: Sequence[Road],
    time: Array,
    threads: int = 1,
    undelayed: Sequence[Controller | None] | None = None,
) -> PhysicsRuns:
    """Runs N vehicles of one kind, each with its own parameters, controller and road, from rest.

    Args:
        vehicles: N vehicles of the same kind. Where they differ in the controller's implementation only, one model serves them.
        controllers: N controllers.
        roads: N roads.
        time: equidistant sample times [s], shape (T,), from 0; their distance is the timestep.
        threads: how many threads share the runs at most, `FEWEST` or more each; results do not depend on it. 0 is one for every
            core.
        undelayed: second controllers, whose forces come to those of the first and know no `[implementation]`; None for none.
    """
    timestep, signals, wheels = float(time[1] - time[0]), vehicles[0].kind.signals, vehicles[0].kind.wheels
    now = on_each(vehicles, roads, "displacement", time)
    midway = on_each(vehicles, roads, "displacement", time + timestep / 2)
    shares = shared(len(vehicles), threads or cores())
    block = _whole(in_shares(vehicles, controllers, now, midway, timestep, (0, len(time)), shares, undelayed))

    recorded, names = block.values, [signal.name for signal in signals]
    velocity = on_each(vehicles, roads, "velocity", time)
    recorded[:, [names.index(wheel.road_velocity) for wheel in wheels]] = np.moveaxis(velocity, 1, 2)
    diverged = block.diverged(time)
    recorded[np.broadcast_to((time[:, None] >= diverged)[:, None], recorded.shape)] = np.nan
    qpos, qvel = block.qpos.swapaxes(0, 1), block.qvel.swapaxes(0, 1)
    return PhysicsRuns(Response(time, signals, np.moveaxis(recorded, 2, 0)), qpos, qvel, diverged)


def shared(count: int, threads: int) -> list[slice]:
    """Runs shared out among threads, as many to each as to the others."""
    shares = max(1, min(threads, count // FEWEST))
    edges = [count * i // shares for i in range(shares + 1)]
    return [slice(*pair) for pair in itertools.pairwise(edges)]


def _whole(parts: Sequence[Callable[[Callable[[], bool]], Iterator[Block]]]) -> Block:
    """The one block of every share, put together."""
    if len(parts) == 1:
        return next(parts[0](lambda: False))
    pieces = [lambda stopped, part=part: next(part(stopped), None) for part in parts]
    with closing(side_by_side(pieces, len(parts))) as done:
        blocks = [block for _, block in sorted(done, key=lambda one: one[0]) if block is not None]
    values = np.concatenate([block.values for block in blocks], axis=2)
    others = (np.concatenate([getattr(block, name) for block in blocks], axis=1) for name in ("qpos", "qvel", "largest"))
    return Block(0, values, *others)


def on_each(vehicles: Sequence[Vehicle], roads: Sequence[Road], what: str, time: Array) -> Array:
    """Heights of the roads [m], or their rates, under the wheels of all runs, shape (T, N, r); of runs that share both, once.

    Args:
        vehicles: N vehicles of the same kind.
        roads: N roads.
        what: `displacement` or `velocity`.
        time: shape (T,).
    """
    keys = [(*vehicle.parameters.values(), id(road)) for vehicle, road in zip(vehicles, roads, strict=True)]
    one_of = dict(zip(keys, zip(vehicles, roads, strict=True), strict=True))
    once = {key: under_wheels(getattr(road, what), road, vehicle, time) for key, (vehicle, road) in one_of.items()}
    return np.stack([once[key] for key in keys], axis=1)
