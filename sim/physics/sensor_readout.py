"""Signals read out of MuJoCo, and the measurements, delays and holds of an implemented controller."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import mujoco
import numpy as np

from models.common.arrays import Array
from models.laws.linear import LinearLaw
from models.vehicle.limits_and_implementation import Implementation, steps_per_sample
from models.vehicle.mjcf import build_model, damped_tyres, mocap_indices, pushed_dofs
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller

if TYPE_CHECKING:
    from models.suspension.damper_range import CoefficientRange


class Laws(Protocol):
    """N controllers, from measurements to forces.

    Attributes:
        forces: m, or the number of commands.
    """

    forces: int

    @property
    def used(self) -> Array:
        """Returns the states at the last sample, shape (N, k)."""
        ...

    def __call__(self, due: Array | slice, which: Array, k: int, seen: Array) -> Array:
        """Returns the forces of the due controllers at step k, shape (d, m), from the signals as read, shape (d, S).

        Args:
            due: indices of the due controllers; a slice for all.
            which: indices of the runs, ascending, shape (d,).
        """
        ...


@dataclass(frozen=True, eq=False)
class AntiWindup:
    """Anti-windup of N linear laws, see `models.laws.anti_windup`.

    Attributes:
        gain: L of each, shape (N, k, m).
        of: range of their actuators.
    """

    gain: Array
    of: "CoefficientRange"

    def __call__(self, requested_force: Array, which: Array | slice = slice(None)) -> Array:
        """Returns the addition to the next states, shape (d, k).

        Args:
            requested_force: the requested forces, and with adjustable dampers the closing velocities behind them, shape (d, m) or
                (d, 2 m).
            which: indices among the N runs.
        """
        m = self.gain.shape[2]
        closing = requested_force[:, m:] if requested_force.shape[1] > m else None
        return np.matvec(self.gain[which], self.of.clipped_off(requested_force[:, :m], closing, which))


class LinearLaws:
    """N linear laws."""

    def __init__(self, gain: Array, memory: Array, anti_windup: "AntiWindup | None" = None, ahead: Array | None = None) -> None:
        """Takes the gains from the signals to [u; x_c], shape (N, m + k, S), and from x_c, shape (N, m + k, k), and the forces
        from the road ahead at every step, shape (T, N, m), or None.
        """
        self.gain, self.memory, self.anti_windup = gain, memory if memory.shape[2] else None, anti_windup
        self.ahead = ahead
        self.forces = gain.shape[1] - memory.shape[2]
        self.kept, self.used = (np.zeros((len(gain), memory.shape[2])) for _ in range(2))

    def __call__(self, due: Array | slice, which: Array, k: int, seen: Array) -> Array:
        """See `Laws`."""
        computed = np.matvec(self.gain[due], seen)
        if self.memory is not None:
            self.used[due] = self.kept[due]
            computed += np.matvec(self.memory[due], self.used[due])
            self.kept[due] = computed[:, self.forces :]
            computed = computed[:, : self.forces]
        return computed if self.ahead is None else computed + self.ahead[k, due]

    def follow(self, due: Array | slice, requested_force: Array) -> None:
        """Adds the anti-windup to the states of the due laws; `requested_force` is as for `AntiWindup`."""
        if self.anti_windup is not None:
            self.kept[due] += self.anti_windup(requested_force, due)


class Sampler:
    """N controllers that sample, compute and hold as their `[implementation]` says.

    A measurement is read as quantisation * round((signal + noise) / quantisation), and the force computed from it acts `delay`
    samples later, which may be a fraction. Before the first force arrives it is zero. The controller's own states are never late.
    """

    def __init__(self, how: Sequence[Implementation], laws: Laws, names: Sequence[str], timestep: float, samples: int) -> None:
        """Prepares laws on the signals of these names."""
        self.laws = laws
        self.period = np.array([steps_per_sample(one, timestep) for one in how])
        self.late = np.array([round(one.delay * steps) for one, steps in zip(how, self.period, strict=True)])  # steps
        self.resolution = np.array([[one.quantisation.get(name, 0.0) for name in names] for one in how])
        self.noise = measurement_noise(how, names, samples)
        self.coarse = bool(np.any(self.resolution))
        self.queue = np.zeros((max(one.pending_forces for one in how) + 1, len(how), laws.forces))  # forces by sample, in a ring
        self.force = np.zeros((len(how), laws.forces))
        self.all = np.arange(len(how))
        self.together = bool(np.all(self.period == 1))
        self.between = (self.late % self.period).nonzero()[0]  # indices of controllers whose forces change between samples

    def __call__(self, k: int, signals: Array) -> Array:
        """Returns the forces of step k, shape (N, m), from the signals at its start, shape (N, S)."""
        # This runs between any two steps of the physics, where a call of numpy costs as much as stepping a run: few calls.
        due = self.all if self.together else (k % self.period == 0).nonzero()[0]
        if len(due) == len(self.all):
            self._sample(slice(None), due, k, signals)
        elif len(due):
            self._sample(due, due, k, signals[due])
        if len(self.between):
            some = self.between[(k - self.late[self.between]) % self.period[self.between] == 0]
            self._act(some, some, k)
        return self.force

    def _sample(self, due: Array | slice, which: Array, k: int, seen: Array) -> None:
        """Measures for the due controllers, computes their forces and queues them."""
        if len(self.noise):
            seen = seen + self.noise[k, due]
        if self.coarse:
            resolution = self.resolution[due]
            steps = np.where(resolution > 0, resolution, 1.0)
            seen = np.where(resolution > 0, steps * np.round(seen / steps), seen)
        computed = self.laws(due, which, k, seen)
        if len(self.queue) == 1:
            self.force[due] = computed
            return
        self.queue[(k // self.period[due]) % len(self.queue), which] = computed
        if not len(self.between):
            self._act(due, which, k)
        else:
            some = which[self.late[which] % self.period[which] == 0]
            self._act(some, some, k)

    def _act(self, due: Array | slice, which: Array, k: int) -> None:
        """Applies the queued forces that are due; before the first arrives, their place in the ring is still zero."""
        self.force[due] = self.queue[(k - self.late[due]) // self.period[due] % len(self.queue), which]


def measurement_noise(how: Sequence[Implementation], names: Sequence[str], samples: int) -> Array:
    """Returns the noise of N controllers on signals of these names, shape (samples, N, S), or (0, N, S) without any."""
    rms = np.array([[one.noise.get(name, 0.0) for name in names] for one in how])
    noise = np.zeros((samples if np.any(rms) else 0, *rms.shape))
    for i, one in enumerate(how):
        if np.any(rms[i]):
            noise[:, i] = rms[i] * np.random.default_rng(one.seed).standard_normal((samples, len(names)))
    return noise


# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.


def reads_out(vehicle: Vehicle, timestep: float) -> bytes:
    """Returns a key that is equal for vehicles that can be stepped side by side: same geometry and number of elements."""
    model, readout = prepared(vehicle, timestep)
    # A model without a stop, a bar or a ramp cannot hold that of another vehicle.
    elements = np.array([model.ntendon, model.nwrap, model.nu, *model.actuator_gaintype, *model.actuator_trnid[:, 0]])
    used = np.where(readout.linear[:, None], readout.of_state, 0.0)
    return b"".join(
        part.tobytes()
        for part in (elements, readout.linear, readout.stage, used, readout.of_sensors, readout.of_road, readout.rest)
    )


@dataclass(frozen=True, eq=False)
class Readout:
    """Maps from MuJoCo's state and sensors to signals. A signal is its sensor, read along its `user` direction, from its value at
    rest.

    Attributes:
        names: names of the S signals.
        stage: mjtStage that each signal's sensor needs, shape (S,).
        linear: True for signals linear in (qpos, qvel), shape (S,). These are read from the state before a step: evaluating
            their sensors would cost a seventh of the step.
        of_state: linear signals from (qpos, qvel), shape (S, nq + nv).
        of_sensors: signals from `sensordata`, shape (S, nsensordata).
        of_road: derivative of the signals in the road heights, shape (S, r). They are linear in those.
        rest: values of `of_sensors` at rest, shape (S,).
        felt: True if an acceleration depends on the road directly; sensing it inside the step, road midway, is then not enough.
        mocap: mocap index of every wheel's road.
        stretching: map from qvel to the stretching rate of the inputs' actuators at equilibrium, shape (m, nv).
        lagging: index of each input's activation in the model, or -1 if it has none, shape (m,).
        pushed: degree of freedom along which each load pushes the body.
        damped_tyres: wheels whose tyres damp, and the actuator of each.
    """

    names: tuple[str, ...]
    stage: Array
    linear: Array
    of_state: Array
    of_sensors: Array
    of_road: Array
    rest: Array
    felt: bool
    mocap: list[int]
    stretching: Array
    lagging: Array
    pushed: list[int]
    damped_tyres: tuple[list[int], list[int]]


@functools.lru_cache(maxsize=16)
def prepared(vehicle: Vehicle, timestep: float) -> tuple[mujoco.MjModel, Readout]:
    """Returns model and readout of a vehicle, cached: a search runs one vehicle hundreds of times. `Batch` copies the model."""
    model = build_model(vehicle, timestep, drawn=False)
    return model, _readout(vehicle, model)


def _readout(vehicle: Vehicle, model: mujoco.MjModel) -> Readout:
    data = mujoco.MjData(model)
    mocap = mocap_indices(vehicle, model)
    names = vehicle.linear_model.outputs
    stage = np.zeros(len(names), dtype=int)
    of_sensors = np.zeros((len(names), model.nsensordata))
    for i, name in enumerate(names):
        for part, factor in vehicle.kind.combined.get(name, {name: 1.0}).items():
            sensor = model.sensor(part)
            start, dim = int(sensor.adr[0]), int(sensor.dim[0])
            of_sensors[i, start : start + dim] = factor * sensor.user[:dim]
            stage[i] = max(stage[i], int(sensor.needstage[0]))

    def read(motion: Array, heights: Array) -> Array:
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = motion[: model.nq], motion[model.nq :]
        data.mocap_pos[mocap, 2] = heights
        mujoco.mj_forward(model, data)
        return of_sensors @ data.sensordata

    # qpos = 0 is the static equilibrium of every MJCF here.
    still, flat = np.zeros(model.nq + model.nv), np.zeros(len(mocap))
    rest = np.round(read(still, flat), 12)  # in SI; an acceleration's rounding would differ with the masses
    small = 0.1  # metres and radians: a tyre's length is linear only while its road stays below the hub
    of_road = np.stack([read(still, height) - rest for height in small * np.eye(len(flat))], axis=-1) / small
    of_state = np.stack([read(move, flat) - rest for move in small * np.eye(len(still))], axis=-1) / small

    late = stage > int(mujoco.mjtStage.mjSTAGE_VEL)
    felt = bool(np.any(np.abs(of_road[late]) > 1e-9 * (1 + np.abs(rest[late, None]))))
    linear = ~late
    rng = np.random.default_rng(0)
    for _ in range(3):  # a signal counts as linear if it is at a few states far from the axes
        move, height = rng.uniform(-0.1, 0.1, len(still)), rng.uniform(-0.1, 0.1, len(flat))
        linear &= np.abs(read(move, height) - rest - of_state @ move - of_road @ height) < 1e-12
    inputs, stretching = len(vehicle.linear_model.inputs), []
    mujoco.mj_resetData(model, data)
    for speeds in np.eye(model.nv):
        data.qvel[:] = speeds
        mujoco.mj_forward(model, data)
        stretching.append(np.array(data.actuator_velocity[:inputs]))
    return Readout(
        names=names,
        stage=stage,
        linear=linear,
        of_state=of_state,
        of_sensors=of_sensors,
        of_road=np.where(late[:, None], 0.0, of_road),
        rest=rest,
        felt=felt,
        mocap=mocap,
        stretching=np.stack(stretching, axis=-1),
        lagging=np.array(model.actuator_actadr[:inputs]),
        pushed=pushed_dofs(vehicle, model),
        damped_tyres=damped_tyres(vehicle, model),
    )


def laws_on(
    signals: Sequence[str], vehicles: Sequence[Vehicle], controllers: Sequence[Controller | None], timestep: float
) -> tuple[Array, Array]:
    """Returns N controllers as they are run: [u; next x_c] from these signals and x_c, each sampled as its vehicle says.

    Args:
        signals: names of S signals; gains are 0 except on a controller's measurements.
        vehicles: N of them.
        controllers: N of them; None for no force.
        timestep: sample period of controllers without one of their own [s].

    Returns:
        From the signals, shape (N, m + k, S), and from x_c, shape (N, m + k, k), with the largest k of any.
    """
    once, which = _as_run(vehicles, controllers, timestep)
    m, k = len(vehicles[0].linear_model.inputs), max((law.states for _, law in once if law is not None), default=0)
    of_signals, of_states = np.zeros((len(once), m + k, len(signals))), np.zeros((len(once), m + k, k))
    for i, (one, law) in enumerate(once):
        if one is not None and law is not None:
            seen, end = [signals.index(name) for name in one.measured], m + law.states
            of_signals[i, :m, seen], of_signals[i, m:end, seen] = law.D.T, law.B.T
            of_states[i, :m, : law.states], of_states[i, m:end, : law.states] = law.C, law.A
    return of_signals[which], of_states[which]


def anti_windup_on(vehicles: Sequence[Vehicle], controllers: Sequence[Controller | None], timestep: float) -> Array | None:
    """Returns the anti-windup gains of N controllers as they are run, see `laws_on`, shape (N, k, m); None if none has any.

    Raises:
        InputError: a law has a slow state that shows in no force.
    """
    if all(one is None or one.law.anti_windup is None for one in controllers):
        return None
    from models.laws.anti_windup import anti_windup_gain

    once, which = _as_run(vehicles, controllers, timestep)
    gains = [np.zeros((0, 0)) if law is None else anti_windup_gain(law) for _, law in once]
    most = np.zeros((len(once), max(map(len, gains)), len(vehicles[0].linear_model.inputs)))
    for rows, gain in zip(most, gains, strict=True):
        rows[: len(gain)] = gain
    return most[which]


def _as_run(
    vehicles: Sequence[Vehicle], controllers: Sequence[Controller | None], timestep: float
) -> tuple[list[tuple[Controller | None, LinearLaw | None]], list[int]]:
    """Returns the distinct controllers with their sampled laws, and the index of each of the N among them."""
    of_vehicle = {id(vehicle): steps_per_sample(vehicle.implementation, timestep) * timestep for vehicle in vehicles}
    pairs = [(id(controller), of_vehicle[id(vehicle)]) for controller, vehicle in zip(controllers, vehicles, strict=True)]
    places = {pair: i for i, pair in enumerate(dict.fromkeys(pairs))}
    by_id = {id(one): one for one in controllers}
    once = [(by_id[one], period) for one, period in places]
    laws = [(one, None if one is None else one.law.sampled(period)) for one, period in once]
    return laws, [places[pair] for pair in pairs]


def measured_by(signals: Sequence[str], measured: Sequence[Sequence[str]]) -> tuple[Array, Array]:
    """Returns the matrices that pick the measurements of N controllers out of these signals, shape (N, q, S), with the largest q
    of any.

    The rows are in each controller's order. Also returns the (N, q, 0) that `laws_on` gives for laws without states.
    """
    picked = np.zeros((len(measured), max(map(len, measured)), len(signals)))
    for rows, names in zip(picked, measured, strict=True):
        rows[range(len(names)), [signals.index(name) for name in names]] = 1.0
    return picked, np.zeros((*picked.shape[:2], 0))


def stage_of(vehicle: Vehicle, controller: Controller, timestep: float) -> int:
    """Returns the mjtStage of sensors to evaluate before a step for the controller's measurements, or 0 if none is needed."""
    readout = prepared(vehicle, timestep)[1]
    of_signals, _ = laws_on(readout.names, [vehicle], [controller], timestep)
    return sensed_stage(readout, np.any(of_signals, axis=(0, 1)))


def sensed_stage(readout: Readout, used: Array) -> int:
    """Returns the mjtStage of sensors to evaluate before a step for the signals that are used, shape (S,)."""
    return int(max(readout.stage[used & ~readout.linear], default=0))


def force_from_road(gain: Array, road: Array, readout: Readout) -> Array:
    """Returns the known part of the forces, shape (T, N, m): a gain (N, m, S) on the part of the road that a reading lacks.

    A sensor's reading contains its value at rest, which is subtracted here; a reading from the state does not.
    """
    known = np.zeros((*road.shape[:2], gain.shape[1]))
    for m, s in np.argwhere(gain.any(axis=0)).tolist():
        unseen = np.full(road.shape[:2], 0.0 if readout.linear[s] else -readout.rest[s])
        for r in np.flatnonzero(readout.of_road[s]):
            unseen += readout.of_road[s, r] * road[..., r]
        known[..., m] += gain[:, m, s] * unseen
    return known


def signal_from_road(road: Array, readout: Readout, linear: bool) -> Array:
    """Returns that part of the signals, shape (T, N, S): those read from the state, or those read from sensors."""
    unseen = np.zeros((*road.shape[:2], len(readout.names)))
    for s in np.flatnonzero(readout.linear == linear):
        unseen[..., s] = 0.0 if linear else -readout.rest[s]
        for r in np.flatnonzero(readout.of_road[s]):
            unseen[..., s] += readout.of_road[s, r] * road[..., r]
    return unseen


def mix(matrix: Array, parts: Array, total: Array) -> None:
    """Adds weighted parts, shape (B, k, N), to totals, shape (B, S, N), by a matrix of shape (S, k), term by term."""
    for i, j in np.argwhere(matrix).tolist():
        total[:, i] += parts[:, j] if matrix[i, j] == 1 else matrix[i, j] * parts[:, j]
