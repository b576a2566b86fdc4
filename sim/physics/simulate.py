"""The MuJoCo response of one run or ten thousand, kept whole or in blocks.

It agrees with the analysis to the integrator's own error (RK4's, to the fourth power of the step), because

- the road is a mocap body that MuJoCo holds over a step, so it is put at `RoadInput.midway`: its height midway through the
  step, and of a measured road the mean height over the step;
- signals are read with the road's height at the sample;
- loads on the body are held over a step at `RoadInput.held_loads`, as the road is, and signals are read with the load there;
- the controller is sampled: it reads the signals once a step, and its force is held.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.common.threads import cores, side_by_side
from models.kinds.signals import Signal, kept_signals
from models.roads.road import Departure, RoadInput, under_wheels
from models.vehicle.limits_and_implementation import steps_per_sample
from sim.physics.driver import Failure, RunDriver, steps_ahead
from sim.physics.run_blocks import BatchInputs, Block, in_blocks, in_shares
from sim.response.jumps import Jumps
from sim.response.regime import BLOCK, EndDetector
from sim.response.response import Response

FEWEST = 4  # runs per thread: with fewer, numpy between the steps, one thread at a time, takes as long as the steps


@dataclass(frozen=True, eq=False)
class PhysicsRuns:
    """N runs of MuJoCo.

    Attributes:
        response: every signal, values of shape (N, T, S); NaN from a run's divergence on.
        qpos: generalized positions, shape (N, T, nq), to draw a run.
        qvel: generalized velocities, shape (N, T, nv).
        diverged: time at which each run diverged [s], shape (N,), or infinity.
        ran_away: True for each run that diverged by the states of its law alone, see `Block.ran_away`, shape (N,).
        requested_force: requested forces at every sample [N], shape (N, T, m).
        kept: states of each controller at its last sample, shape (N, T, k), with the largest k of any; from a run's divergence on
            infinite where they ran away, else NaN.
        states: the signals of each controller's states.
        measured: signals at the controllers' samples, see `Block.measured`, shape (N, T, s).
        names: names of `measured`.
    """

    response: Response
    qpos: Array
    qvel: Array
    diverged: Array
    ran_away: Array
    requested_force: Array
    kept: Array
    states: Sequence[tuple[Signal, ...]]
    measured: Array
    names: tuple[str, ...]

    def run(self, index: int) -> Response:
        """Returns one run: the vehicle's signals, then the states of its controller."""
        states = self.states[index]
        return self.response.run(index).beside(states, self.kept[index, :, : len(states)])

    def commanded(self, index: int) -> "Commanded":
        """Returns what the controller of one run measured and commanded."""
        kept = self.kept[index, :, : len(self.states[index])]
        return Commanded(dict(zip(self.names, self.measured[index].T, strict=True)), self.requested_force[index], kept)


@dataclass(frozen=True, eq=False)
class Commanded:
    """What the controller of one run measured and commanded.

    Attributes:
        measured: each signal, and closing velocity, at the controller's samples, see `Block.measured`, shape (T,).
        commands: commands of the actuators at every timestep, see `sim.physics.actuators`, shape (T, m) or (T, 2 m).
        states: states of a linear law at its last sample, shape (T, k).
    """

    measured: Mapping[str, Array]
    commands: Array
    states: Array


def simulate(controllers: Sequence[RunDriver], inputs: Sequence[RoadInput], threads: int = 1) -> PhysicsRuns:
    """Runs N vehicles of one kind, each with its own parameters, controller and road, from rest.

    The numbers of a run are the same bit for bit, whatever other runs of its controller are beside it.

    Args:
        controllers: N controllers.
        inputs: vehicles of the same kind with their roads, all at the same sample times from 0 [s], shape (T,). Vehicles that
            differ only in the controller's implementation share one model.
        threads: largest number of threads, with `FEWEST` runs or more each; results do not depend on it. 0 means one per core.
    """
    vehicles, time, timestep = [road.vehicle for road in inputs], inputs[0].time, inputs[0].timestep
    signals, wheels = vehicles[0].kind.signals, vehicles[0].kind.wheels
    once = met_alike(inputs)
    now, midway = (np.stack([getattr(road, name) for road in once], axis=1) for name in ("heights", "midway"))
    ahead = steps_ahead(vehicles, controllers, timestep)
    beyond = np.stack([road.ahead(ahead) for road in once], axis=1) if ahead else None
    shares = shared(len(vehicles), 1 if any(one.serial for one in controllers) else threads or cores())
    edges = (0, len(time))
    jumps = [road.vertical_edges() for road in once]
    sides = {k: now[k].copy() for one in jumps for k in one}
    for i, one in enumerate(jumps):
        for k, edge in one.items():
            sides[k][i] += edge.change
    held = held_on(inputs)
    course = BatchInputs(
        vehicles,
        controllers,
        now,
        midway,
        timestep,
        edges,
        beyond=beyond,
        held=held,
        beyond_edges=sides,
        effects=effects_on(inputs),
    )
    block = _whole(in_shares(course, shares))

    recorded, names = block.values, [signal.name for signal in signals]
    velocity = np.stack([road.velocities for road in once], axis=1)
    recorded[:, [names.index(wheel.road_velocity) for wheel in wheels]] = np.moveaxis(velocity, 1, 2)
    diverged = block.diverged(time)
    for i, road in enumerate(inputs):
        if (steady := road.steady_signals(time)) is not None:
            recorded[..., i] += steady
    recorded[np.broadcast_to((time[:, None] >= diverged)[:, None], recorded.shape)] = np.nan
    qpos, qvel = block.qpos.swapaxes(0, 1), block.qvel.swapaxes(0, 1)
    response, requested = Response(time, signals, np.moveaxis(recorded, 2, 0)), block.requested_force.swapaxes(0, 1)
    if vehicles[0].dampers:
        of_forces = Jumps(vehicles, vehicles[0].linear_model.outputs)(recorded)
        response = replace(response, before={name: response[name] - jump for name, jump in of_forces.items()})
    if block.others:
        response = response.with_sides({k: other.T for k, other in block.others.items()})
    states = [kept_signals(range(1, one.states + 1)) for one in controllers]
    periods = [steps_per_sample(vehicle.implementation, timestep) * timestep for vehicle in vehicles]
    scales = [one.state_scale(period) for one, period in zip(controllers, periods, strict=True)]
    kept = block.kept.swapaxes(0, 1) * np.array(scales)[:, None, None]
    kept[time >= diverged[:, None]] = np.nan
    kept[(time >= diverged[:, None]) & block.ran_away[:, None]] = np.inf
    measured = block.measured.swapaxes(0, 1)
    return PhysicsRuns(response, qpos, qvel, diverged, block.ran_away, requested, kept, states, measured, block.names)


def shared(count: int, threads: int) -> list[slice]:
    """Splits runs evenly among threads."""
    shares = max(1, min(threads, count // FEWEST))
    edges = [count * i // shares for i in range(shares + 1)]
    return [slice(*pair) for pair in itertools.pairwise(edges)]


def _whole(parts: Sequence[Callable[[Callable[[], bool]], Iterator[Block]]]) -> Block:
    """Joins the blocks of all shares to one."""
    if len(parts) == 1:
        return next(parts[0](lambda: False))
    pieces = [lambda stopped, part=part: next(part(stopped), None) for part in parts]
    with closing(side_by_side(pieces, len(parts))) as done:
        blocks = [block for _, block in sorted(done, key=lambda one: one[0]) if block is not None]
    values, most = np.concatenate([block.values for block in blocks], axis=2), max(block.kept.shape[2] for block in blocks)
    blocks = [replace(one, kept=np.pad(one.kept, ((0, 0), (0, 0), (0, most - one.kept.shape[2])))) for one in blocks]
    names = ("qpos", "qvel", "largest", "overflowed", "requested_force", "kept", "measured")
    arrays = {name: np.concatenate([getattr(block, name) for block in blocks], axis=1) for name in names}
    others = {k: np.concatenate([block.others[k] for block in blocks], axis=1) for k in blocks[0].others}
    return Block(0, values, **arrays, names=blocks[0].names, others=others)


def met_alike(inputs: Sequence[RoadInput]) -> list[RoadInput]:
    """Replaces each road input by the first one with equal heights under its wheels, so that these are computed once."""
    keys = [(*road.vehicle.parameters.values(), id(road.road)) for road in inputs]
    first = dict(zip(reversed(keys), reversed(inputs), strict=True))
    return [first[key] for key in keys]


def held_on(inputs: Sequence[RoadInput]) -> Array | None:
    """Returns `RoadInput.held` of all runs, shape (T, N, l) or (T, N, l + r); None if nothing is held in any."""
    return np.stack([road.held for road in inputs], axis=1) if any(road.pushed for road in inputs) else None


def effects_on(inputs: Sequence[RoadInput]) -> tuple[Array, Array] | None:
    """Returns `RoadInput.in_signals` and `RoadInput.in_readings` of all runs, each as `held_on`; None without loads."""
    if not any(road.loaded for road in inputs):
        return None
    return np.stack([road.in_signals for road in inputs], axis=1), np.stack([road.in_readings for road in inputs], axis=1)


class MonitoredBatch:
    """N runs from rest over a road each, whose divergence and end of the linear regime are detected block by block.

    Attributes:
        now: heights of the roads under the wheels at the samples [m], shape (T, N, r).
        midway: heights at which MuJoCo holds them over the steps.
        ends: detector of the ends of their linear regime in the blocks so far.
        held, effects: see `BatchInputs`.
        beyond: heights of the roads at the samples after the last, as far as controllers preview them.
        failures: failures of laws in Python by run; such a run continues without forces.
        diverged: time at which each diverged in the blocks so far [s], shape (N,), or infinity.
        ran_away: True for each of these that diverged by the states of its law alone, see `Block.ran_away`, shape (N,).
    """

    def __init__(self, controllers: Sequence[RunDriver], inputs: Sequence[RoadInput]) -> None:
        """Takes N controllers, and vehicles that read out alike with their roads, all at the same sample times from 0 [s]."""
        vehicles, time = [road.vehicle for road in inputs], inputs[0].time
        self.vehicles, self.controllers, self.time, self.inputs = vehicles, controllers, time, inputs
        ahead = steps_ahead(vehicles, controllers, self.timestep)
        halves = np.arange(2 * (len(time) + ahead)) * (self.timestep / 2)
        heights = np.empty((len(halves), len(vehicles), len(vehicles[0].kind.wheels)))
        for i, road in enumerate(inputs):
            heights[:, i] = under_wheels(road.felt.displacement, road.felt, road.vehicle, halves)
            if isinstance(road.felt, Departure):
                heights[1::2, i] = road.held_heights(halves[1::2])
        self.now, self.midway = heights[: 2 * len(time) : 2], heights[1 : 2 * len(time) : 2]
        self.held, self.effects = held_on(inputs), effects_on(inputs)
        self.velocities: Array | None = None
        if any(vehicle.linear_model.tyres_damp for vehicle in vehicles):  # their forces decide when they leave the road
            self.velocities = np.stack([road.velocities for road in inputs], axis=2)
        self.beyond, self.failures = heights[2 * len(time) :: 2], dict[int, Failure]()
        self.ends = EndDetector(vehicles, time, anti_windup=[one.has_anti_windup for one in controllers])
        self.diverged = np.full(len(vehicles), np.inf)
        self.ran_away = np.zeros(len(vehicles), dtype=bool)

    @property
    def timestep(self) -> float:
        """Returns the timestep of the runs [s]."""
        return float(self.time[1] - self.time[0])

    @property
    def until(self) -> Array:
        """Returns the time before which each run is linear [s], shape (N,), or infinity."""
        return np.minimum(self.ends.first, self.diverged)

    def steady(self, samples: slice) -> Iterator[tuple[int, Array]]:
        """Yields every run that does not start from rest at 0, by index, with its signals in steady motion, shape (B, S)."""
        for i, road in enumerate(self.inputs):
            if (steady := road.steady_signals(self.time[samples])) is not None:
                yield i, steady

    def blocks(self) -> Iterator[Block]:
        """Yields every block in its turn; the values of runs that have diverged are clipped."""
        edges = [*range(0, len(self.time), BLOCK), len(self.time)]
        course = BatchInputs(
            self.vehicles,
            self.controllers,
            self.now,
            self.midway,
            self.timestep,
            edges,
            beyond=self.beyond,
            failures=self.failures,
            held=self.held,
            effects=self.effects,
        )
        for block in in_blocks(course):
            self.ran_away |= block.ran_away & np.isinf(self.diverged)
            self.diverged = np.minimum(self.diverged, block.diverged(self.time))
            if np.isfinite(self.diverged).any():
                block.clip(np.isfinite(self.diverged))
            if self.velocities is not None:
                names = [signal.name for signal in self.vehicles[0].kind.signals]
                roads = [names.index(wheel.road_velocity) for wheel in self.vehicles[0].kind.wheels]
                block.values[:, roads] = self.velocities[block.start : block.start + len(block.values)]
            for i, steady in self.steady(slice(block.start, block.start + len(block.values))):
                block.values[..., i] += steady
            self.ends.update(block.start, block.values)
            yield block
