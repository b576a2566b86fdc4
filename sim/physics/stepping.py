"""The simulation loop: read, control, move the road, step. In a batch of MuJoCo's, or for a single run, a fifth faster per
step."""

import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import mujoco
import numpy as np
from mujoco import mj_step, mjtStage
from mujoco.batch import Batch

from models.common.arrays import Array

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.


_POSITIONS = (mujoco.mj_fwdPosition, mujoco.mj_sensorPos)
_STAGES = {
    int(mjtStage.mjSTAGE_NONE): (),
    int(mjtStage.mjSTAGE_POS): _POSITIONS,
    int(mjtStage.mjSTAGE_VEL): (*_POSITIONS, mujoco.mj_fwdVelocity, mujoco.mj_sensorVel),
    int(mjtStage.mjSTAGE_ACC): (mujoco.mj_forward,),
}


class Alone:
    """Single run with the interface of a batch; its numbers are those of a batch bit for bit."""

    def __init__(self, model: mujoco.MjModel) -> None:
        """Starts at rest."""
        self.model, self.nsim, self._data = model, 1, mujoco.MjData(model)

    def bind(self, name: str) -> Array:
        """Returns a live view of a field, shape (1, ...)."""
        return getattr(self._data, name)[None]

    def forward(self, ids: Array | None = None, stage: int = int(mjtStage.mjSTAGE_ACC)) -> None:
        """Computes the stages up to one, by default all."""
        for compute in _STAGES[stage]:
            compute(self.model, self._data)

    def stepper(self, stage: int) -> Callable[[], None]:
        """Returns a function that makes a step, then computes the stages up to one at the new state."""
        step, computed = functools.partial(mj_step, self.model, self._data), _STAGES[stage]
        if not computed:
            return step  # a wrapper function would cost a twentieth of a step

        def steps() -> None:
            step()
            for compute in computed:
                compute(self.model, self._data)

        return steps


# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.


class Setting(Protocol):
    """Interface that sets the adjustable dampers of N runs.

    Attributes:
        actuators: number m of each run's actuators, force actuators included.
        flat: True if the signals of a single run have shape (d,).
    """

    actuators: int
    flat: bool

    def set(self, seen: Array, acting: Array) -> None:
        """Writes the commands of every actuator, shape (N, m), from the signals that decide them, shape (N, d)."""
        ...

    def commands(self, seen: Array) -> Array:
        """Returns commands and missing forces of some samples, see `CoefficientRange.commands`: (B, N, 2 m) from (B, N, d)."""
        ...


@dataclass(frozen=True, eq=False)
class Reading:
    """Readings of N controllers of m forces and k states, and the controllers' gains on them.

    Attributes:
        gain: gain from the reading to [forces; next states], shape (N, m + k, r). The reading is (qpos, qvel) and some of
            `sensordata`.
        memory: gain from their states, shape (N, m + k, k).
        offset: further contribution to [forces; next states], shape (T, N, m + k).
        sensors: part of `sensordata` in the reading; empty without a stage.
        stage: mjtStage up to which sensors are evaluated before a step.
        fresh: True to evaluate sensors apart, with the road at the samples, so that accelerations are right.
        once: True to record from that evaluation, too: accelerations and forces are then those just before the sample.
        damped: setting of adjustable dampers, or None if all actuators push; the gain then has rows for its inputs.
        lagging: True to record the activations.
        held: number of steps for which commands are held, if there is no law beside the gains.
        ramps: input of every actuator that makes ramps of dampers' curves, shape (k,); these actuators are the last ones.
        anti_windup: returns what is added to the controllers' next states, shape (N, k), from their commands; None for nothing.
    """

    gain: Array
    memory: Array
    offset: Array
    sensors: slice
    stage: int
    fresh: bool
    once: bool
    damped: Setting | None = None
    lagging: bool = False
    held: int = 1
    ramps: Array | None = None
    anti_windup: Callable[[Array], Array] | None = None


@dataclass(frozen=True, eq=False)
class Push:
    """Loads on the bodies of N runs, and velocities of the road under tyres that damp, held over every step.

    Attributes:
        dofs: l degrees of freedom along which the loads act.
        midway: forces [N] and moments [N m] during the steps, shape (T, N, l).
        tyres: actuators of the t tyres that damp.
        velocities: road velocities under them during the steps [m/s], shape (T, N, t).
    """

    dofs: list[int]
    midway: Array
    tyres: list[int]
    velocities: Array


class Law(Protocol):
    """N controllers that are not ideal, or known forces."""

    @property
    def used(self) -> Array:
        """Returns the k states at the last sample, shape (N, k)."""
        ...

    def __call__(self, k: int, reading: Array) -> Array:
        """Returns the commands of step k from the reading, shape (N, r): forces, shape (N, m), or as `step_batch` yields them."""
        ...


def step_batch(
    batch: Batch | Alone,
    mocap: list[int],
    reading: Reading,
    midway: Array,
    at_samples: Array | None,
    law: Law | None,
    edges: Sequence[int],
    going: Array | None,
    stopped: Callable[[], bool],
    push: Push | None,
) -> Iterator[tuple[int, Array, Array, Array, Array, Array, Array]]:
    """Steps a batch through all samples.

    Args:
        batch: N runs.
        mocap: mocap index of every wheel's road.
        reading: measurements before a step, with the gains of ideal controllers.
        midway: road heights during the steps, shape (T, N, r).
        at_samples: road heights at the samples, shape (T, N, r), if sensors are to be evaluated there on top; else None.
        law: law of controllers that are not ideal, or None for ideal ones.
        edges: edges of the blocks, see `in_blocks`.
        going: True for each run that is still stepped, shape (N,), read at the beginning of every block, or None for all.
        stopped: returns True to stop.
        push: the loads, or None.

    Yields:
        For every block its first sample, and `sensordata`, shape (B, nsensordata, N): with `at_samples` that of the samples;
        otherwise up to the stage from before the step, the rest from inside it. Then qpos, shape (B, N, nq), qvel, shape
        (B, N, nv), the requested forces, shape (B, N, m), the states of the controllers at their last sample, shape (B, N, k),
        and the activations, shape (B, N, na), or (0, N, na) if none lags. With adjustable dampers the requested forces are
        commands, shape (B, N, 2 m): coefficients beyond the nominal ones, or forces of force actuators, then missing forces.
    """
    gain, offset, stage, fresh = reading.gain, reading.offset, reading.stage, reading.fresh
    (count, known), kept = offset.shape[1:], reading.memory.shape[2]
    commands, damped = known - kept, reading.damped
    m = commands if damped is None else damped.actuators
    # The motors come first in ctrl, in the order of the linear model's inputs; fitted elements have no command.
    # Ramps of dampers' curves come last, with the commands of their dampers.
    ramps = None if reading.ramps is None else batch.bind("ctrl")[:, -len(reading.ramps) :]
    acting, heights, sensors = batch.bind("ctrl")[:, :m], batch.bind("mocap_pos")[:, :, 2], batch.bind("sensordata")
    pushed = batch.bind("qfrc_applied") if push is not None else None
    controls = batch.bind("ctrl") if push is not None and push.tyres else None
    qpos, qvel, measured, sensed_now = batch.bind("qpos"), batch.bind("qvel"), sensors[:, reading.sensors], sensors.T
    positions, moved, width = qpos.shape[1], qpos.shape[1] + qvel.shape[1], gain.shape[2]
    early = np.repeat(batch.model.sensor_needstage, batch.model.sensor_dim) <= stage
    batch.forward(stage=stage)

    # A numpy call costs a tenth of a step, so there are few: known parts of the forces lie beside the reading, with unit gain.
    # For controllers with states, the states lie there instead: in a batch the gains have to come from memory.
    beside = kept or commands
    known_beside = reading.memory if kept else np.broadcast_to(np.eye(commands), (count, commands, commands))
    # By columns in memory: a product with a few rows then takes half the time.
    gain = np.concatenate([gain, known_beside], axis=-1).swapaxes(1, 2).copy().swapaxes(1, 2)
    states, asks = np.zeros((count, kept)), np.empty((count, known))
    # For a single run the product of a matrix and a vector has the same result at a third of the cost.
    alone = count == 1 and law is None and not kept and (damped is None or damped.flat)
    last, used = np.zeros(commands), states
    ask = gain[0].dot if alone else functools.partial(np.matvec, gain)
    activations = batch.bind("act")
    acts = np.zeros((0, *activations.shape))
    for start, end in itertools.pairwise(edges):
        block, length = slice(start, end), end - start
        some = None if going is None or going.all() else np.flatnonzero(going)
        after = 0 if fresh else stage
        step = batch.stepper(after) if isinstance(batch, Alone) else functools.partial(batch.step, some, stage=after)
        seen = np.empty((length, count, width + beside))
        if not kept:
            seen[..., width:] = offset[block]
        roads = np.zeros((length, *heights.shape))
        roads[..., mocap] = midway[block]
        sensed, requested = np.empty((length + 1, *sensed_now.shape)), np.empty((length, count, commands))
        sensed[0] = sensed_now
        if reading.lagging:
            acts = np.empty((length, *activations.shape))
        parts = (seen[..., :positions], seen[..., positions:moved], seen[..., moved:width])
        whole = (seen[:, 0], requested[:, 0]) if alone else (seen, requested)
        rows: Any = zip(*whole, *parts, roads, sensed[1:], strict=True)
        for k, (all_seen, forces, positions_now, velocities_now, sensing, road, result) in enumerate(rows, start):
            if stopped():
                return
            positions_now[...] = qpos
            velocities_now[...] = qvel
            if fresh and at_samples is not None:
                heights[:, mocap] = at_samples[k]
                batch.forward(some)
            if stage:
                sensing[...] = measured
            if law is None and k % reading.held:
                forces[...] = last
                if kept:
                    all_seen[:, width:] = used
            elif law is None and not kept:
                ask(all_seen, forces)
                last = forces
            elif law is None:
                all_seen[:, width:] = states
                ask(all_seen, asks)
                asks += offset[k]
                forces[...], states = asks[:, :commands], asks[:, commands:]
                if reading.anti_windup is not None:
                    states = states + reading.anti_windup(forces)
                last, used = forces, all_seen[:, width:]
            else:
                forces[...] = law(k, all_seen[:, :width])
                if kept:
                    all_seen[:, width:] = law.used
            if damped is not None and law is None:
                damped.set(forces, acting)
            else:
                acting[...] = forces if m == commands else forces[:, :m]
            if ramps is not None:
                ramps[...] = acting[:, reading.ramps]
            if reading.lagging:
                acts[k - start] = activations
            if push is not None and pushed is not None:
                pushed[:, push.dofs] = push.midway[k]
                if controls is not None:
                    controls[:, push.tyres] = push.velocities[k]
            if at_samples is not None:
                if not reading.once:
                    heights[:, mocap] = at_samples[k]
                    batch.forward(some)
                result[...] = sensed_now
            heights[...] = road
            step()
            if at_samples is None:
                result[...] = sensed_now
        if stage and at_samples is None:
            # The evaluation after a step has overwritten the step's own readings with those before the next step.
            sensed[1:, early] = sensed[:-1, early]
        if damped is not None and law is None:
            requested = damped.commands(requested)
        yield (
            start,
            sensed[1:],
            seen[..., :positions],
            seen[..., positions:moved],
            requested,
            seen[..., width : width + kept],
            acts,
        )
