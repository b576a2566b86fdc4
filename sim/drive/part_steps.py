"""MuJoCo steps for vehicles with force elements that MuJoCo itself cannot simulate.

`Batch` does not run Python callbacks, so this module evaluates each stage of RK4 itself. The forces of the parts are computed
from the present deflections and velocities of the suspensions. A motor on the tendon of each suspension applies the part
forces, and MuJoCo computes the accelerations. The stages of RK4 are combined as in MuJoCo's function `mj_RungeKutta`. MuJoCo
itself computes all forces except those of the parts.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's Python bindings have no type stubs.

import copy
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch

from models.common.arrays import Array
from models.parts.native import MOTOR
from models.vehicle.mjcf import FITTED_PREFIX
from models.vehicle.suspension_forces import SuspensionForces
from sim.drive.recursion import SHARES, WEIGHTS

AT_VELOCITIES = int(mujoco.mjtStage.mjSTAGE_VEL)
AT_ACCELERATIONS = int(mujoco.mjtStage.mjSTAGE_ACC)
STAGE_WEIGHTS = np.reshape(WEIGHTS, (-1, 1, 1))
# N; force that is applied to find how accelerations respond to a force. The response is linear, and a large force reduces
# rounding errors.
UNIT = 1024.0
# s; time over which the change of lever arms is computed along the present velocities; the error is proportional to its square
NEARBY = 1e-5


class PartBatch(Batch):
    """Batch of N vehicles that have force elements (parts) at the same suspensions.

    Attributes:
        z: internal states of the parts, initially 0, shape (N, k).
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        tendons: Sequence[str],
        pulls: SuspensionForces,
        count: int,
        models: Sequence[mujoco.MjModel] = (),
    ) -> None:
        """Prepares N runs.

        Args:
            tendons: names of the tendons of the s suspensions.
            pulls: object that computes the forces of the parts; these forces act at the suspensions whose tendon has a motor in
                the model.
            count: number N of runs.
            models: MuJoCo model of each run; empty if all runs share `model`.
        """
        super().__init__(model, count, 1, persistent=True)  # an evaluation keeps the sensor values of the previous evaluation
        if models:
            self.set_models(models)
        # The later stages of a step are evaluated in a separate batch. The sensors keep their values at the beginning of the
        # step, as after `mj_step`.
        stages = Batch(model, count, 1)
        silent = {id(one): copy.copy(one) for one in models or [model]}
        for one in silent.values():
            one.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        stages.set_models([silent[id(one)] for one in models] if models else silent[id(model)])
        self._here, self._there = _Bound(self), _Bound(stages)
        self._pulls, self.z, self._h = pulls, np.zeros((count, pulls.states)), float(model.opt.timestep)
        motors = {model.actuator(i).name: i for i in range(model.nu)}
        names = [f"{FITTED_PREFIX}{MOTOR}{name}" for name in tendons]
        pulled = [i for i, name in enumerate(names) if name in motors]
        self._pulled, self._motors = _span(pulled), _span([motors[names[i]] for i in pulled])
        self._inputs = _Inputs(model, models or [model])
        # A suspension without a tendon in the model has the index -1, which refers to the last tendon. This is harmless,
        # because such a suspension has no motor either, so no force acts through the wrong tendon.
        indices = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TENDON, name) for name in tendons]
        self._lengths = _Lengths(model, indices, models or [model])
        self._response: Array | None = None
        # end index (exclusive) of each section of the state array: qpos, qvel, act, z
        ends = np.cumsum([model.nq, model.nv, model.na, pulls.states])
        self._begin, self._x = _State(count, ends), _State(count, ends)
        self._rates = np.zeros((len(SHARES), count, ends[-1]))
        # views of the rates, one for each section of the state array
        self._parts = [np.split(rates, ends[:-1], axis=1) for rates in self._rates]

    def forward(self, ids: Any = None, stage: int = AT_ACCELERATIONS) -> None:
        """See `Batch.forward`."""
        if stage > AT_VELOCITIES:
            self._start()
        else:
            super().forward(ids, stage)

    def step(self, ids: Any = None, nstep: int = 1, stage: int = 0) -> None:
        """Advances all runs by one time step; see `Batch.step`."""
        begin, x, rates = self._begin, self._x, self._rates
        self._start()
        self._there.batch.state[:] = self.state
        for i in range(1, len(SHARES)):
            np.multiply(rates[i - 1], SHARES[i] * self._h, out=x.all)
            x.all += begin.all
            self._there.motion[:] = x.motion
            self._evaluate(self._there, x, i)
        rates *= STAGE_WEIGHTS
        np.add.reduce(rates, axis=0, out=x.all)
        x.all *= self._h
        x.all += begin.all
        self._here.motion[:], self.z[:] = x.motion, x.own
        self.state[:, 0] += self._h  # the first entry of the state is the time
        if stage:
            self.forward(stage=stage)

    def deflections(self) -> Array:
        """Returns the present deflections of the suspensions [m], shape (N, s)."""
        self._there.batch.state[:] = self.state
        self._x.motion[:] = self._here.motion
        return self._lengths(self._there, self._x)[0]

    def _start(self) -> None:
        """Evaluates the present state of all runs, including the sensors."""
        self._begin.motion[:], self._begin.own[:] = self._here.motion, self.z
        self._evaluate(self._here, self._begin, 0)

    def _evaluate(self, bound: "_Bound", x: "_State", i: int) -> None:
        """Sets the motors of a batch for the present state x, and computes the derivatives of the state in stage i of RK4."""
        d, v = self._lengths(bound, x)
        inputs, z = self._inputs(bound), x.own
        pulls, own = self._pulls(d, v, inputs, z), self._pulls.rates(d, v, inputs, z)
        bound.controls[:, self._motors] = pulls[:, self._pulled]
        Batch.forward(bound.batch)
        if self._pulls.inertial:
            self._accelerate(bound, self._pulls.inertance(d)[:, self._pulled])
        for rate, now in zip(self._parts[i], (x.velocities, bound.qacc, bound.act_dot, own), strict=True):
            rate[:] = now

    def _accelerate(self, bound: "_Bound", b: Array) -> None:
        """Computes the accelerations again, now including the forces of inertial parts.

        The force p = b l'' of an inerter with inertance b depends on l'', the second time derivative of the inerter's length.
        Let a be the value that l'' would have without inertial parts. The inerter forces p change l'' to a + R p, where R is
        the response to unit forces; therefore p = b (a + R p).
        """
        controls, qacc = bound.controls, np.array(bound.qacc)
        J, turning = self._lengths.jacobian(bound)
        pulls, free = np.array(controls[:, self._motors]), np.matvec(J, qacc)[:, self._pulled]
        if self._response is None or not self._lengths.steady:
            columns = []
            for motor in np.arange(self.model.nu)[self._motors]:
                controls[:, motor] += UNIT
                Batch.forward(bound.batch)
                columns.append((np.matvec(J, bound.qacc)[:, self._pulled] - free) / UNIT)
                controls[:, self._motors] = pulls
            self._response = np.stack(columns, axis=-1)
        free += turning[:, self._pulled]
        held = np.eye(b.shape[1]) - b[..., None] * self._response
        controls[:, self._motors] = pulls + np.linalg.solve(held, (b * free)[..., None])[..., 0]
        Batch.forward(bound.batch)


def _span(indices: Sequence[int]) -> slice | Array:
    """Returns consecutive indices as a slice, because NumPy reads and writes slices faster."""
    first, count = indices[0], len(indices)
    return slice(first, first + count) if list(indices) == [*range(first, first + count)] else np.array(indices)


class _State:
    """State of N runs as one array `all`, shape (N, nq + nv + na + k), with attributes that are views of sections of this
    array.
    """

    def __init__(self, count: int, ends: Array) -> None:
        """Allocates the array for the state.

        Args:
            count: number N of runs.
            ends: indices in the last axis at which qpos, qvel, act and the states of the parts end.
        """
        self.all = np.zeros((count, ends[-1]))
        _, self.velocities, _, self.own = np.split(self.all, ends[:-1], axis=1)
        self.motion = self.all[:, : ends[2]]
        self.moved = self.all[:, : ends[1]].reshape(count, 2, -1).swapaxes(0, 1)  # view of qpos and qvel


class _Bound:
    """NumPy views of a MuJoCo batch's state, controls and computed quantities."""

    def __init__(self, batch: Batch) -> None:
        model = batch.model
        self.batch = batch
        # a state of MuJoCo contains the time, followed by qpos, qvel and act
        self.motion = batch.state[:, 1 : 1 + model.nq + model.nv + model.na]
        self.controls, self.activations = batch.bind("ctrl"), batch.bind("act")
        # MuJoCo only fills arrays that were bound before the evaluation
        self.qacc, self.act_dot = batch.bind("qacc"), batch.bind("act_dot")
        self.lengths, self.speeds, self.levers = (batch.bind(name) for name in ("ten_length", "ten_velocity", "ten_J"))


class _Inputs:
    """Computes the actuator inputs of N runs that act after MuJoCo has applied the limits on controls and forces."""

    def __init__(self, model: mujoco.MjModel, models: Sequence[mujoco.MjModel]) -> None:
        own = [i for i in range(model.nu) if not model.actuator(i).name.startswith(FITTED_PREFIX)]
        self._own, adr = slice(0, len(own)), model.actuator_actadr[own]
        self._lagging, self._states = adr >= 0, adr[adr >= 0]
        self._controls, self._forces = (
            self._ranges(
                getattr(model, f"actuator_{name}limited")[own], [getattr(one, f"actuator_{name}range")[own] for one in models]
            )
            for name in ("ctrl", "force")
        )

    def __call__(self, bound: _Bound) -> Array:
        """Returns the actuator inputs that act within the limits, shape (N, m)."""
        u = bound.controls[:, self._own]
        if self._controls is not None:
            u = np.minimum(np.maximum(u, self._controls[0]), self._controls[1])
        if len(self._states):
            u = np.array(u)
            u[:, self._lagging] = bound.activations[:, self._states]
        return u if self._forces is None else np.minimum(np.maximum(u, self._forces[0]), self._forces[1])

    @staticmethod
    def _ranges(limited: Array, ranges: Sequence[Array]) -> tuple[Array, Array] | None:
        """Returns the smallest and the largest allowed actuator inputs, shape (N, m) or (1, m); None if no input is limited."""
        low, high = np.where(limited[:, None], ranges, [-np.inf, np.inf]).transpose(2, 0, 1)
        return (low, high) if limited.any() else None


class _Lengths:
    """Computes the lengths of s tendons in N runs, relative to the lengths in equilibrium.

    Attributes:
        linear: True if the tendon lengths are linear functions of the positions.
        steady: True if the lengths are linear and the mass matrix is constant, so that a force always causes the same
            acceleration.
    """

    def __init__(self, model: mujoco.MjModel, tendons: Sequence[int], models: Sequence[mujoco.MjModel]) -> None:
        self._tendons, self._velocities = tendons, slice(model.nq, model.nq + model.nv)
        self._rest = np.array([one.tendon_length0[tendons] for one in models])
        rows, starts = model.ten_J_rownnz[tendons], model.ten_J_rowadr[tendons]
        self._entries = np.concatenate([np.arange(start, start + count) for start, count in zip(starts, rows, strict=True)])
        self._places = np.repeat(np.arange(len(tendons)), rows), model.ten_J_colind[self._entries]
        wraps = [model.wrap_type[one : one + n] for one, n in zip(model.tendon_adr, model.tendon_num, strict=True)]
        self.linear = all(np.all(wraps[i] == mujoco.mjtWrap.mjWRAP_JOINT) for i in tendons)
        self.steady = self.linear and bool(np.all(model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE))
        if self.linear:
            data = {id(one): mujoco.MjData(one) for one in models}
            for one in models:
                mujoco.mj_forward(one, data[id(one)])
            self._constant = self._dense(np.array([data[id(one)].ten_J for one in models]))

    def __call__(self, bound: _Bound, x: _State) -> tuple[Array, Array]:
        """Returns the suspensions' deflections [m] and velocities [m/s] in the present state x of a batch, each of shape (N,
        s).
        """
        if self.linear:
            d, v = np.matvec(self._constant, x.moved)
            return d, v
        Batch.forward(bound.batch, stage=AT_VELOCITIES)
        return bound.lengths[:, self._tendons] - self._rest, bound.speeds[:, self._tendons]

    def jacobian(self, bound: _Bound) -> tuple[Array, Array]:
        """Returns the Jacobian J of the tendon lengths, shape (N, s, nv) or (1, s, nv), and J' qvel [m/s2], shape (N, s).

        The Jacobian J belongs to the state in which the batch was last evaluated. The time derivative J' of the Jacobian is
        computed by a central difference.
        """
        if self.linear:
            return self._constant, np.zeros((len(bound.qacc), len(self._tendons)))
        J, x = self._dense(bound.levers), np.array(bound.motion)
        speeds = []
        for side in (NEARBY, -NEARBY):
            bound.motion[:, : self._velocities.start] += side * x[:, self._velocities]
            Batch.forward(bound.batch, stage=AT_VELOCITIES)
            speeds.append(np.array(bound.speeds[:, self._tendons]))
            bound.motion[:] = x
        return J, (speeds[0] - speeds[1]) / (2 * NEARBY)

    def _dense(self, levers: Array) -> Array:
        """Converts MuJoCo's sparse Jacobian of the tendons, shape (N, nJten), to a dense array of shape (N, s, nv)."""
        J = np.zeros((len(levers), len(self._tendons), self._velocities.stop - self._velocities.start))
        J[:, *self._places] = levers[:, self._entries]
        return J
