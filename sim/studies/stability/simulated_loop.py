"""Discrete-time model of a loop as MuJoCo simulates it: the derivative of MuJoCo's step at equilibrium, closed with the control
law.

The control law is evaluated as in runs (`sim.drive.drivers.linear`). Control forces are constant during each sample period.
With a delay, the state also contains the pending forces, which were computed at the last samples but do not act yet.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse.linalg import ArpackError

from models.common.arrays import Array
from models.laws.linear import static_law
from models.vehicle.limits_and_implementation import hold_intervals
from models.vehicle.vehicle import Vehicle
from sim.drive.case import State
from sim.studies.stability.delayed import mode, slowest_from_sample_to_sample
from synth.controller.controller import Controller
from synth.plant.loop import REQUESTED, HoldInterval, Loop
from synth.plant.state_space import StateSpace

STANDS = 1e-6  # 1/s; a growth rate below this counts as 0, because finite differences cause an error of a tenth of this value
SMALL = 1e-6  # m or rad; size of the largest coordinate in the initial state of a run
FREE = 1e-2  # largest force in a run that starts in the slowest mode, as a share of the force limit
ACTING_STATE = "acting_{}"  # pattern for the names of the states that are the forces acting at present


@dataclass(frozen=True, eq=False)
class LoopCase:
    """A loop that MuJoCo simulates.

    Attributes:
        vehicle: vehicle, with the sample period and the delay of the controller.
        controller: controller that closes the loop.
        undelayed_controller: second controller, whose forces are updated at every timestep without delay; None if there is no
            second controller.
    """

    vehicle: Vehicle
    controller: Controller
    undelayed_controller: Controller | None = None


@dataclass(frozen=True, eq=False)
class SimulatedLoop:
    """Discrete-time model of a loop. The delay is an integer number of samples plus a fraction of a sample.

    The states of `loop` are the states of the model from `_held_forces`, followed by the states of the control law. If the
    delay contains a fraction of a sample, the force that acts at the start of a sample is also a state.

    Attributes:
        loop: loop whose delay is only the fraction of a sample.
        delay: integer part of the delay, in samples.
        lagging: number of states that are forces of actuators with a lag.
    """

    loop: Loop
    delay: int
    lagging: int

    @cached_property
    def cut(self) -> StateSpace:
        """Loop, cut at all control forces."""
        return self.loop.cut(self.loop.forces)

    @cached_property
    def _over_delay(self) -> complex:
        acts = [name for name, row in zip(self.cut.outputs, self.cut.C, strict=True) if np.any(row)]
        inputs = [name.removesuffix(REQUESTED) for name in acts]
        return slowest_from_sample_to_sample(self.cut.part(acts, inputs), self.delay)

    @cached_property
    def slowest(self) -> tuple[complex, Array]:
        """Eigenvalue z of the loop with the largest magnitude, and its complex eigenvector, shape (n,)."""
        return mode(self.cut, self.delay, self._over_delay)

    @property
    def rate(self) -> float:
        """Growth rate of the loop's slowest mode [1/s], positive if the mode grows; NaN if no eigenvalue is found."""
        try:
            return math.log(max(abs(self._over_delay), 1e-300)) / max(self.delay, 1) / self.loop.period
        except ArpackError:
            return math.nan

    @property
    def grows(self) -> bool:
        """True if the loop is unstable."""
        return self.rate > STANDS

    def start(self, limit: float | None) -> State:
        """Returns an initial state that contains only the slowest mode, with a size such that forces stay below a limit [N]."""
        (z, vector), states = self.slowest, self.loop.plant.states
        moving = states.index(ACTING_STATE.format(0)) - self.lagging
        ends = np.cumsum([moving, self.lagging, len(self.loop.forces)])
        vector = vector * SMALL / np.abs(vector[:moving]).max()
        pending = [self.cut.C @ vector * z**-j for j in range(self.delay, 0, -1)]
        motion, lagging, acting, rest, law, first = np.split(vector, [*ends, len(states), len(states) + self.loop.law.states])
        largest = max(np.abs(force).max(initial=0.0) for force in (acting, lagging, self.cut.C @ vector, *pending))
        scale = 1.0 if limit is None else min(1.0, FREE * limit / max(largest, FREE * limit))
        forces = np.array([*([first] if len(first) else []), *pending]).reshape(-1, len(acting))
        parts = np.concatenate([motion, lagging]), acting, law, rest, forces
        return State(*(np.real(scale * part) for part in parts))


def simulated_loop(step: StateSpace, trial: LoopCase) -> SimulatedLoop:
    """Returns the discrete-time model of a loop.

    Args:
        step: derivative of MuJoCo's step for the vehicle, see `step_derivative`.
        trial: loop to model, with the vehicle and the controller of this loop.

    Raises:
        InputError: the sample period or the delay is not an integer multiple of the timestep.
    """
    how, timestep = trial.vehicle.implementation, step.dt
    assert timestep is not None
    delay = math.floor(how.delay)
    hold = tuple(HoldInterval(steps * timestep, late - delay) for steps, late in hold_intervals(how, timestep))
    plant = _held_forces(step, trial.undelayed_controller)
    loop = Loop(plant, trial.controller.law, trial.controller.measured, step.inputs, hold, timestep)
    return SimulatedLoop(loop, delay, sum(name in step.inputs for name in step.states))


def _held_forces(step: StateSpace, undelayed: Controller | None) -> StateSpace:
    """Returns the model of a step during which the forces are held.

    The state of this model is [z; acting forces; states of the undelayed controller].

    Args:
        step: derivative of MuJoCo's step, whose state is z.
        undelayed: controller whose forces act without delay; None if there is no such controller.
    """
    n, m = step.B.shape
    seen = np.hstack([step.C, step.D])
    law = static_law(np.zeros((m, 0))) if undelayed is None else undelayed.law.sampled(step.dt or 0.0)
    y = seen[step.rows(() if undelayed is None else undelayed.measured)]
    acting = np.hstack([law.D @ y, law.C, np.eye(m)])
    moved = np.vstack([step.B @ acting, acting, np.hstack([law.B @ y, law.A, np.zeros((law.states, m))])])
    moved[:n, :n] += step.A
    names = (*step.states, *(ACTING_STATE.format(i) for i in range(m)), *(f"undelayed_{i}" for i in range(law.states)))
    C = np.hstack([seen, np.zeros((len(seen), law.states))])
    return StateSpace(moved[:, :-m], moved[:, -m:], C, np.zeros((len(C), m)), step.inputs, step.outputs, step.dt, names)
