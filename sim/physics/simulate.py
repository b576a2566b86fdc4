"""The MuJoCo response: one function for one run or ten thousand.

What makes it agree with the analysis to the integrator's own error (RK4's, to the fourth power of the step):

- the road is a mocap body that MuJoCo holds over a step, so it is put at its height midway through the step;
- but signals are read with the road where it is at the sample;
- loads on the body are held over a step as they are midway through it, and signals are under the load that is held from then on;
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
from models.law import LinearLaw
from models.own.python_law import Programmed
from models.reality import steps_per_sample
from models.roads.road import Road, under_wheels
from models.signals import Signal, kept_signals
from models.vehicle import Vehicle
from sim.physics.blocks import Block, Course, in_shares
from sim.physics.python_laws import Driven, steps_ahead
from sim.response.response import Response
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
        asked: forces that were asked for at every sample [N], shape (N, T, m).
        kept: what the states of each controller were at its last sample, shape (N, T, k), with the k of the one that has most.
        states: the signals of those of each.
    """

    response: Response
    qpos: Array
    qvel: Array
    diverged: Array
    asked: Array
    kept: Array
    states: Sequence[tuple[Signal, ...]]

    def run(self, index: int) -> Response:
        """One run: the vehicle's signals, and after them the states of its controller."""
        states = self.states[index]
        return self.response.run(index).beside(states, self.kept[index, :, : len(states)])


def simulate(
    vehicles: Sequence[Vehicle],
    controllers: Sequence[Driven],
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
    kinds = [type(one) for one in controllers]
    if len(set(kinds)) > 1:
        return _by_kind(kinds, vehicles, controllers, roads, time, threads)
    timestep, signals, wheels = float(time[1] - time[0]), vehicles[0].kind.signals, vehicles[0].kind.wheels
    now = on_each(vehicles, roads, "displacement", time)
    midway = on_each(vehicles, roads, "displacement", time + timestep / 2)
    beyond = None
    if ahead := steps_ahead(vehicles, controllers, timestep):
        beyond = on_each(vehicles, roads, "displacement", time[-1] + timestep * np.arange(1, ahead + 1))
    shares = shared(len(vehicles), 1 if Programmed in kinds else threads or cores())  # Python is run by one thread at a time
    edges = (0, len(time))
    loads = loads_on(vehicles, roads, time + timestep / 2)
    course = Course(vehicles, controllers, now, midway, timestep, edges, undelayed, beyond=beyond, loads=loads)
    block = _whole(in_shares(course, shares))

    recorded, names = block.values, [signal.name for signal in signals]
    velocity = on_each(vehicles, roads, "velocity", time)
    recorded[:, [names.index(wheel.road_velocity) for wheel in wheels]] = np.moveaxis(velocity, 1, 2)
    diverged = block.diverged(time)
    recorded[np.broadcast_to((time[:, None] >= diverged)[:, None], recorded.shape)] = np.nan
    qpos, qvel = block.qpos.swapaxes(0, 1), block.qvel.swapaxes(0, 1)
    response, asked = Response(time, signals, np.moveaxis(recorded, 2, 0)), block.asked.swapaxes(0, 1)
    laws = [one.law if isinstance(one, Controller) else None for one in controllers]
    states = [kept_signals(range(1, law.states + 1)) if law else () for law in laws]
    scales = [1.0 if law is None else _of_state(law, vehicle, timestep) for law, vehicle in zip(laws, vehicles, strict=True)]
    kept = block.kept.swapaxes(0, 1) * np.array(scales)[:, None, None]
    kept[time >= diverged[:, None]] = np.nan
    return PhysicsRuns(response, qpos, qvel, diverged, asked, kept, states)


def _of_state(law: LinearLaw, vehicle: Vehicle, timestep: float) -> float:
    """What makes the law's own states of those that it is run with."""
    return law.of_state(steps_per_sample(vehicle.implementation, timestep) * timestep)


def _by_kind(
    kinds: Sequence[type],
    vehicles: Sequence[Vehicle],
    controllers: Sequence[Driven],
    roads: Sequence[Road],
    time: Array,
    threads: int,
) -> PhysicsRuns:
    """`simulate` of runs some of which a linear law drives and some another: each as it is without the others."""
    which, made = [], []
    for kind in dict.fromkeys(kinds):
        some = [i for i, one in enumerate(kinds) if one is kind]
        which += some
        made.append(
            simulate([vehicles[i] for i in some], [controllers[i] for i in some], [roads[i] for i in some], time, threads)
        )
    order = np.argsort(which)
    values = np.concatenate([one.response.values for one in made])[order]
    response = Response(time, made[0].response.signals, values)
    qpos, qvel, diverged, asked = (
        np.concatenate([getattr(one, name) for one in made])[order] for name in ("qpos", "qvel", "diverged", "asked")
    )
    most = max(one.kept.shape[2] for one in made)
    kept = np.concatenate([np.pad(one.kept, ((0, 0), (0, 0), (0, most - one.kept.shape[2]))) for one in made])[order]
    states = [signals for one in made for signals in one.states]
    return PhysicsRuns(response, qpos, qvel, diverged, asked, kept, [states[i] for i in order])


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
    names = ("qpos", "qvel", "largest", "asked", "kept")
    return Block(0, values, *(np.concatenate([getattr(block, name) for block in blocks], axis=1) for name in names))


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


def loads_on(vehicles: Sequence[Vehicle], roads: Sequence[Road], time: Array) -> Array | None:
    """What loads push the bodies of all runs with [N, N m], shape (T, N, l); None where no run has any.

    Arguments as for `on_each`.
    """
    if not any(road.loaded for road in roads):
        return None
    return np.stack([road.loads(vehicle, time) for vehicle, road in zip(vehicles, roads, strict=True)], axis=1)
