"""The loop: read, control, move the road, step."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from mujoco.batch import Batch

from models.common.arrays import Array


class Setting(Protocol):
    """What sets the adjustable dampers of N runs.

    Attributes:
        actuators: m of each, those that push among them.
    """

    actuators: int

    def set(self, seen: Array, acting: Array) -> None:
        """Writes what every actuator is to be, shape (N, m), from what that is decided on, shape (N, d)."""
        ...

    def commands(self, seen: Array) -> Array:
        """The same of some samples, with what is missing, see `Range.commands`: shape (B, N, 2 m) from (B, N, d)."""
        ...


@dataclass(frozen=True, eq=False)
class Reading:
    """What N controllers of m forces and k states read, and what they make of it.

    Attributes:
        gain: from the reading to [forces; next states], shape (N, m + k, r). The reading is (qpos, qvel), and `sensordata` if
            there is a stage.
        memory: from their states, shape (N, m + k, k).
        offset: what else comes to them, shape (T, N, m + k).
        stage: mjtStage up to which sensors are evaluated before a step.
        fresh: whether they are evaluated there by themselves, with the road at the samples, so that accelerations count.
        once: whether what is recorded is read there, too, so that accelerations and forces are those until then.
        damped: what sets adjustable dampers, which the gain then gives rows for that it is decided on; None where all actuators
            push.
        lagging: whether the activations are recorded.
        ramps: of every actuator that makes ramps of dampers' curves, the last ones, with which input it goes, shape (k,).
    """

    gain: Array
    memory: Array
    offset: Array
    stage: int
    fresh: bool
    once: bool
    damped: Setting | None = None
    lagging: bool = False
    ramps: Array | None = None


@dataclass(frozen=True, eq=False)
class Push:
    """What pushes the bodies of N runs from outside, held over every step.

    Attributes:
        dofs: along which joints, l of them.
        midway: forces [N] and moments [N m] during the steps, shape (T, N, l).
    """

    dofs: list[int]
    midway: Array


class Law(Protocol):
    """What N controllers that are not ideal ask for, and what known forces are."""

    @property
    def used(self) -> Array:
        """What their k states were at their last sample, shape (N, k)."""
        ...

    def __call__(self, k: int, reading: Array) -> Array:
        """The commands of step k, from the reading, shape (N, r): forces, shape (N, m), or as `step_batch` yields them."""
        ...


def step_batch(
    batch: Batch,
    mocap: list[int],
    reading: Reading,
    midway: Array,
    at_samples: Array | None,
    law: Law | None,
    edges: Sequence[int],
    going: Array | None,
    stopped: Callable[[], bool],
    push: Push | None = None,
) -> Iterator[tuple[int, Array, Array, Array, Array, Array, Array]]:
    """All samples of a batch.

    Args:
        batch: N runs.
        mocap: mocap index of every wheel's road.
        reading: what is read before a step, and what ideal controllers make of it.
        midway: road heights during the steps, shape (T, N, r).
        at_samples: road heights at the samples, shape (T, N, r), if sensors are to be evaluated there on top; else None.
        law: of controllers that are not ideal; None for those that are.
        edges: of the blocks, see `in_blocks`.
        going: whether each run is still stepped, shape (N,), asked at the beginning of every block; None where all are.
        stopped: says whether to give up.
        push: what loads do; None where there are none.

    Yields:
        Of every block its first sample, and `sensordata`, shape (B, nsensordata, N): that of the samples; else up to the stage
        from before the step, the rest from inside it. Then qpos, shape (B, N, nq), qvel, shape (B, N, nv), the forces asked for,
        shape (B, N, m), the states of the controllers at their last sample, shape (B, N, k), and the activations, shape
        (B, N, na), or (0, N, na) where none lags. Of adjustable dampers, of which there is a range, the forces asked for are
        commands, shape (B, N, 2 m): coefficients beyond the nominal ones, or forces of what pushes, and then the forces that
        were asked for beyond what those give.
    """
    gain, offset, stage, fresh = reading.gain, reading.offset, reading.stage, reading.fresh
    (count, known), kept = offset.shape[1:], reading.memory.shape[2]
    commands, damped = known - kept, reading.damped
    m = commands if damped is None else damped.actuators
    # The motors come first in ctrl, in the order of the linear model's inputs; what is fitted beside them is not asked.
    # Ramps of dampers' curves come last, and are asked for what their dampers are.
    ramps = None if reading.ramps is None else batch.bind("ctrl")[:, -len(reading.ramps) :]
    acting, heights, sensors = batch.bind("ctrl")[:, :m], batch.bind("mocap_pos")[:, :, 2], batch.bind("sensordata").T
    pushed = batch.bind("qfrc_applied") if push is not None else None
    motion, width = _motion(batch), gain.shape[2]
    moved, positions = motion.shape[1], batch.bind("qpos").shape[1]
    early = np.repeat(batch.model.sensor_needstage, batch.model.sensor_dim) <= stage
    batch.forward(stage=stage)

    # A numpy call costs a tenth of a step, so there are few: what is known of the forces lies beside the reading, with unit gain.
    # Of controllers with states more is known, and they lie there instead: in a batch the gains have to come from memory.
    beside = kept or commands
    known_beside = reading.memory if kept else np.broadcast_to(np.eye(commands), (count, commands, commands))
    gain = np.concatenate([gain, known_beside], axis=-1)
    states, asks = np.zeros((count, kept)), np.empty((count, known))
    activations = batch.bind("act")
    acts = np.zeros((0, *activations.shape))
    for start, end in itertools.pairwise(edges):
        block, length = slice(start, end), end - start
        some = None if going is None or going.all() else np.flatnonzero(going)
        seen = np.empty((length, count, width + beside))
        if not kept:
            seen[..., width:] = offset[block]
        roads = np.zeros((length, *heights.shape))
        roads[..., mocap] = midway[block]
        sensed, asked = np.empty((length, *sensors.shape)), np.empty((length, count, commands))
        if reading.lagging:
            acts = np.empty((length, *activations.shape))
        rows: Any = zip(seen, seen[..., :moved], seen[..., moved:width], roads, sensed, asked, strict=True)
        for k, (all_seen, moving, sensing, road, result, forces) in enumerate(rows, start):
            if stopped():
                return
            moving[...] = motion
            if fresh and at_samples is not None:
                heights[:, mocap] = at_samples[k]
                batch.forward(some)
            if stage:
                sensing[...] = sensors.T
            if law is None and not kept:
                np.matvec(gain, all_seen, forces)
            elif law is None:
                all_seen[:, width:] = states
                np.matvec(gain, all_seen, asks)
                asks += offset[k]
                forces[...], states = asks[:, :commands], asks[:, commands:]
            else:
                forces[...] = law(k, all_seen[:, :width])
                if kept:
                    all_seen[:, width:] = law.used
            if damped is not None and law is None:
                damped.set(forces, acting)
            else:
                acting[...] = forces[:, :m]
            if ramps is not None:
                ramps[...] = acting[:, reading.ramps]
            if reading.lagging:
                acts[k - start] = activations
            if push is not None and pushed is not None:
                pushed[:, push.dofs] = push.midway[k]
            if at_samples is not None:
                if not reading.once:
                    heights[:, mocap] = at_samples[k]
                    batch.forward(some)
                result[...] = sensors
            heights[...] = road
            batch.step(some, stage=0 if fresh else stage)
            if at_samples is None:
                result[...] = sensors
        if stage and at_samples is None:
            # The evaluation after a step has overwritten what the step itself had sensed.
            sensed[:, early] = np.moveaxis(seen[..., moved:width][..., early], 1, 2)
        if damped is not None and law is None:
            asked = damped.commands(asked)
        yield start, sensed, seen[..., :positions], seen[..., positions:moved], asked, seen[..., width : width + kept], acts


def _motion(batch: Batch) -> Array:
    """(qpos, qvel) of every run as one view, shape (N, nq + nv): they lie side by side in a state row."""
    qpos, qvel = batch.bind("qpos"), batch.bind("qvel")
    start = (qpos.ctypes.data - batch.state.ctypes.data) // batch.state.itemsize
    motion = batch.state[:, start : start + qpos.shape[1] + qvel.shape[1]]
    assert motion[0, qpos.shape[1] :].ctypes.data == qvel.ctypes.data, "mjSTATE_QVEL follows mjSTATE_QPOS"
    return motion
