"""Loops as MuJoCo runs them, from one sample to the next: the derivative of MuJoCo's own step about equilibrium, and the law.

The law is the one that runs execute (`sim.drive.drivers.linear`). Forces are held over a sample, and those of the last samples
are still pending where they act late.
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

STANDS = 1e-6  # 1/s; a mode that moves less stands still: the differences are exact to a tenth of it
SMALL = 1e-6  # m or rad, of the largest coordinate of a mode from which a run starts
FREE = 1e-2  # of the force limit, which such a run does not reach
ACTING_STATE = "acting_{}"  # names of the states that are acting forces


@dataclass(frozen=True, eq=False)
class LoopCase:
    """Loop in MuJoCo.

    Attributes:
        vehicle: vehicle with its implementation of the controller.
        controller: the controller.
        undelayed_controller: second controller, whose forces act at every timestep without delay, or None.
    """

    vehicle: Vehicle
    controller: Controller
    undelayed_controller: Controller | None = None


@dataclass(frozen=True, eq=False)
class SimulatedLoop:
    """Loop from sample to sample, of a delay by whole samples and a loop with the rest of it.

    The states of the loop are those of `_held_forces`, of the law and, for a delay with a fraction of a sample, the force that
    acts at the start of a sample.

    Attributes:
        loop: the loop, but for its whole samples of delay.
        delay: whole samples of delay.
        lagging: number of lagging forces.
    """

    loop: Loop
    delay: int
    lagging: int

    @cached_property
    def cut(self) -> StateSpace:
        """The loop that is cut at all forces."""
        return self.loop.cut(self.loop.forces)

    @cached_property
    def _over_delay(self) -> complex:
        acts = [name for name, row in zip(self.cut.outputs, self.cut.C, strict=True) if np.any(row)]
        inputs = [name.removesuffix(REQUESTED) for name in acts]
        return slowest_from_sample_to_sample(self.cut.part(acts, inputs), self.delay)

    @cached_property
    def slowest(self) -> tuple[complex, Array]:
        """The eigenvalue z with the largest magnitude, and its vector in the state, complex, shape (n,)."""
        return mode(self.cut, self.delay, self._over_delay)

    @property
    def rate(self) -> float:
        """Rate of the slowest mode [1/s], positive if it grows; NaN if the iteration does not find it."""
        try:
            return math.log(max(abs(self._over_delay), 1e-300)) / max(self.delay, 1) / self.loop.period
        except ArpackError:
            return math.nan

    @property
    def grows(self) -> bool:
        """Returns True if the loop is unstable."""
        return self.rate > STANDS

    def start(self, limit: float | None) -> State:
        """Returns the start of a run in the slowest mode alone, which stays below a force limit [N]."""
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
    """Returns a loop of the vehicle of this step, see `step_derivative`.

    Raises:
        InputError: the sample period or the delay is not a multiple of the timestep.
    """
    how, timestep = trial.vehicle.implementation, step.dt
    assert timestep is not None
    delay = math.floor(how.delay)
    hold = tuple(HoldInterval(steps * timestep, late - delay) for steps, late in hold_intervals(how, timestep))
    plant = _held_forces(step, trial.undelayed_controller)
    loop = Loop(plant, trial.controller.law, trial.controller.measured, step.inputs, hold, timestep)
    return SimulatedLoop(loop, delay, sum(name in step.inputs for name in step.states))


def _held_forces(step: StateSpace, undelayed: Controller | None) -> StateSpace:
    """Returns the step under forces that are held; its states are [z; acting forces; states of the undelayed controller]."""
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
