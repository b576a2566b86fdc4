"""Steps of MuJoCo for vehicles with dampers over velocity and deflection, of which MuJoCo has no product.

`Batch` runs no callbacks in Python. So each stage of RK4 is two evaluations here: positions and velocities, of which the table
gives the damper's force, and then the accelerations under that force, which a motor on the suspension's tendon pulls with. The
sum of the stages is that of `mj_RungeKutta`. All other forces are MuJoCo's.

Where a motion ratio changes with travel, the motor also pulls for bump stops, and for what the actuator or the semi-active damper
does beyond its ratio at rest. Their ratio is held over a step at its value at the start, as commands are.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import copy
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch

from models.common.arrays import Array
from models.parts import SURFACE
from models.vehicle.mjcf import FITTED
from models.vehicle.vehicle import Vehicle
from sim.response.recursion import SHARES, WEIGHTS

AT_VELOCITIES = int(mujoco.mjtStage.mjSTAGE_VEL)
AT_ACCELERATIONS = int(mujoco.mjtStage.mjSTAGE_ACC)


class SurfaceBatch(Batch):
    """Batch of N vehicles with surfaces at the same places."""

    def __init__(self, model: mujoco.MjModel, vehicles: Sequence[Vehicle], models: Sequence[mujoco.MjModel]) -> None:
        """Prepares the runs; `models` has one of each, or none if all share one."""
        super().__init__(model, len(vehicles), 1, persistent=True)  # an evaluation keeps the sensors of the one before
        # The later stages of a step are evaluated apart, so that the sensors stay those of its beginning, as after `mj_step`.
        self._stages = Batch(model, len(vehicles), 1)
        without = [copy.copy(one) for one in models or [model]]
        for one in without:
            one.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        self._stages.set_models(without if models else without[0])
        ranges = [(one.actuator_ctrlrange, one.actuator_forcerange) for one in models or [model]]
        surfaces = [i for i, one in enumerate(vehicles[0].fitted) if one.surface is not None]
        self._places = [_Place(model, vehicles, i, ranges) for i in surfaces]
        self._rest = np.array([one.tendon_length0 for one in models or [model]])
        self._h = float(model.opt.timestep)
        for batch in (self, self._stages):  # an evaluation fills only what was bound before
            for name in ("qacc", "act_dot", "ten_length", "ten_velocity"):
                batch.bind(name)

    def forward(self, ids: Any = None, stage: int = AT_ACCELERATIONS) -> None:
        """See `Batch.forward`."""
        if stage > AT_VELOCITIES:
            self._pull(self)
        super().forward(ids, stage)

    def step(self, ids: Any = None, nstep: int = 1, stage: int = 0) -> None:
        """See `Batch.step`; one step of all runs."""
        names = ("qpos", "qvel", "act")
        start = [np.array(self.bind(name)) for name in names]
        self.forward()
        rates = [start[1], np.array(self.bind("qacc")), np.array(self.bind("act_dot"))]
        total = [weight * one for weight, one in zip(WEIGHTS[:1] * len(rates), rates, strict=True)]
        self._stages.state[:] = self.state
        moving = [self._stages.bind(name) for name in names]
        for share, weight in zip(SHARES[1:], WEIGHTS[1:], strict=True):
            for now, begin, rate in zip(moving, start, rates, strict=True):
                now[...] = begin + self._h * (share * rate)
            self._pull(self._stages)
            self._stages.forward()
            rates = [np.array(moving[1]), self._stages.bind("qacc"), self._stages.bind("act_dot")]
            total = [one + weight * rate for one, rate in zip(total, rates, strict=True)]
        for name, begin, one in zip(names, start, total, strict=True):
            self.bind(name)[...] = begin + self._h * one
        self.bind("time")[...] += self._h
        if stage:
            self.forward(stage=stage)

    def ratios(self, forces: Sequence[str]) -> Array:
        """Returns the motion ratio of every force over that at rest, in the present state, shape (N, m)."""
        self._stages.state[:] = self.state
        Batch.forward(self._stages, stage=AT_VELOCITIES)
        ratios, lengths = np.ones((len(self._stages.state), len(forces))), self._stages.bind("ten_length")
        for place in self._places:
            if place.over_travel and place.force in forces:
                place.hold(lengths[:, place.tendon] - self._rest[:, place.tendon])
                ratios[:, forces.index(place.force)] = place.held / place.at_rest
        return ratios

    def _pull(self, batch: Batch) -> None:
        """Sets the controls of the surfaces' motors for the present state, and at a step's start its motion ratios."""
        Batch.forward(batch, stage=AT_VELOCITIES)
        lengths, speeds, controls = batch.bind("ten_length"), batch.bind("ten_velocity"), batch.bind("ctrl")
        for place in self._places:
            i = place.tendon
            d = lengths[:, i] - self._rest[:, i]
            pull = place.pulls(speeds[:, i], d)
            if place.over_travel:
                if batch is self:
                    place.hold(d)
                pull += place.pulls_over_travel(self.bind("ctrl"), batch.bind("act"), speeds[:, i], d)
            controls[:, place.motor] = pull


class _Place:
    """Surfaces of N vehicles at one place. Multiples of one table are evaluated together.

    Attributes:
        force: the input along its suspension; empty without one.
        over_travel: True if the motion ratio changes with travel.
        at_rest, held: motion ratio at rest and at the start of the step, shape (N,).
    """

    def __init__(
        self, model: mujoco.MjModel, vehicles: Sequence[Vehicle], number: int, ranges: Sequence[tuple[Array, Array]]
    ) -> None:
        """Finds the surfaces that are this one of the fitted curves; `ranges` has those of controls and forces of each model."""
        fitted = [vehicle.fitted[number] for vehicle in vehicles]
        self.tendon = int(model.tendon(fitted[0].tendon).id)
        self.motor = int(model.actuator(f"{FITTED}{SURFACE}{fitted[0].tendon}").id)
        surfaces = [one.surface for one in fitted if one.surface is not None]
        bases = [one.base or one for one in surfaces]
        factors = np.array([1.0 if one is base else one.slope / base.slope for one, base in zip(surfaces, bases, strict=True)])
        runs: dict[bytes, list[int]] = {}
        for i, base in enumerate(bases):
            runs.setdefault(base.key, []).append(i)
        self.groups = [(bases[some[0]], np.array(some), factors[some]) for some in runs.values()]
        self._deflection = fitted[0].deflection
        self.over_travel = self._deflection in vehicles[0].ratio_tables
        if not self.over_travel:
            return
        self.force = next(part.force for part in vehicles[0].kind.suspensions if part.deflection == self._deflection)
        self.at_rest = self.held = np.array([one.ratio for one in fitted])
        alike: dict[tuple[object, ...], list[int]] = {}
        for i, one in enumerate(vehicles):
            pair = self.force in one.dampers and one.dampers[self.force].pair
            alike.setdefault((one.ratio_tables[self._deflection].key, one.limits, id(pair)), []).append(i)
        self._alike = [(vehicles[some[0]], np.array(some)) for some in alike.values()]
        self._damper = next((i for i, one in enumerate(vehicles[0].adjustable) if one.force == self.force), None)
        if self.force:
            self._actuator = int(model.actuator(self.force).id)
            self._activation = int(model.actuator_actadr[self._actuator])
            limited = model.actuator_ctrllimited[self._actuator], model.actuator_forcelimited[self._actuator]
            limits = (np.array([one[self._actuator] for one in own]).T for own in zip(*ranges, strict=True))
            self._limits = [own if limit else np.array([[-np.inf], [np.inf]]) for limit, own in zip(limited, limits, strict=True)]

    def pulls(self, velocity: Array, deflection: Array) -> Array:
        """Returns the forces beyond their lines [N], shape (N,)."""
        pulls = np.empty(len(velocity))
        for base, runs, factors in self.groups:
            pulls[runs] = factors * base.beyond(velocity[runs], deflection[runs])
        return pulls

    def hold(self, deflection: Array) -> None:
        """Sets `held` at deflections [m], shape (N,)."""
        self.held = np.empty(len(deflection))
        for vehicle, runs in self._alike:
            self.held[runs] = vehicle.ratio_tables[self._deflection](deflection[runs])

    def pulls_over_travel(self, controls: Array, activations: Array, velocity: Array, deflection: Array) -> Array:
        """Returns the forces of stops, and of actuators beyond those at the ratio at rest [N], shape (N,).

        Args:
            controls, activations: MuJoCo's, shapes (N, nu) and (N, na).
        """
        pulls = np.zeros(len(velocity))
        for vehicle, runs in self._alike:
            if (stops := vehicle.stops.get(self._deflection)) is not None:
                pulls[runs] = stops.pull(deflection[runs])
        if not self.force:
            return pulls
        (low, high), (least, most) = self._limits
        acting = np.clip(controls[:, self._actuator], low, high)
        acting = np.clip(acting if self._activation < 0 else activations[:, self._activation], least, most)
        if self._damper is None:
            return pulls - (self.held - self.at_rest) * acting
        for vehicle, runs in self._alike:
            shape, ratio = vehicle.adjustable[self._damper].shape, self.held[runs]
            pulls[runs] += ratio * acting[runs] * shape(ratio * velocity[runs])
        return pulls
