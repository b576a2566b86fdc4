"""The MuJoCo response: one function for one run or ten thousand.

What makes it agree with the analysis to the integrator's own error (RK4's, to the fourth power of the step):

- the road is a mocap body that MuJoCo holds over a step, so it is put at its height midway through the step;
- but signals are read with the road where it is at the sample;
- the controller is sampled: it reads the signals once a step, and its force is held.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.vehicle import Vehicle
from sim.physics.blocks import in_blocks
from sim.response.response import Response
from sim.roads.road import Road, under_wheels
from synth.controller import Controller


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
    now = _on_each(vehicles, roads, "displacement", time)
    midway = _on_each(vehicles, roads, "displacement", time + timestep / 2)
    (block,) = in_blocks(vehicles, controllers, now, midway, timestep, threads, len(time), undelayed)

    recorded, names = block.values, [signal.name for signal in signals]
    velocity = _on_each(vehicles, roads, "velocity", time)
    recorded[:, [names.index(wheel.road_velocity) for wheel in wheels]] = np.moveaxis(velocity, 1, 2)
    diverged = block.diverged(time)
    recorded[np.broadcast_to((time[:, None] >= diverged)[:, None], recorded.shape)] = np.nan
    qpos, qvel = block.qpos.swapaxes(0, 1), block.qvel.swapaxes(0, 1)
    return PhysicsRuns(Response(time, signals, np.moveaxis(recorded, 2, 0)), qpos, qvel, diverged)


def _on_each(vehicles: Sequence[Vehicle], roads: Sequence[Road], what: str, time: Array) -> Array:
    """Heights of the roads [m], or their rates, under the wheels of all runs, shape (T, N, r); of runs that share both, once."""
    once: dict[tuple[int, int], Array] = {}
    for vehicle, road in zip(vehicles, roads, strict=True):
        if (id(vehicle), id(road)) not in once:
            once[id(vehicle), id(road)] = under_wheels(getattr(road, what), road, vehicle, time)
    return np.stack([once[id(vehicle), id(road)] for vehicle, road in zip(vehicles, roads, strict=True)], axis=1)
