"""Loops as MuJoCo runs them, from one sample to the next: the derivative of MuJoCo's own step about equilibrium, and the law.

The law is the one that is run (`sim.physics.driver.LinearDriver`). Forces are held over a sample, and those of the last samples
are still pending where they act late.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse.linalg import ArpackError

from models.common.arrays import Array
from models.laws.linear import LinearLaw
from models.vehicle.limits_and_implementation import steps_held
from models.vehicle.vehicle import Vehicle
from sim.physics.computer import InitialState
from sim.physics.step_derivative import StepDerivative
from sim.studies.stability.delayed import mode, slowest_from_sample_to_sample
from synth.controller.controller import Controller

STANDS = 1e-6  # 1/s; a mode that moves less stands still: the differences are exact to a tenth of it
SMALL = 1e-6  # m or rad, of the largest coordinate of a mode from which a run starts
FREE = 1e-2  # of the force limit, which such a run does not reach


@dataclass(frozen=True, eq=False)
class Trial:
    """Loop in MuJoCo.

    Attributes:
        vehicle: vehicle with its implementation of the controller.
        controller: the controller.
        undelayed: second controller, whose forces act at every timestep without delay, or None.
    """

    vehicle: Vehicle
    controller: Controller
    undelayed: Controller | None = None


@dataclass(frozen=True, eq=False)
class SimulatedLoop:
    """Loop from sample to sample, x[k+1] = Phi x[k] + Gamma v[k-delay] and v[k] = G x[k].

    Its state x has positions, velocities and own states of parts, lagging forces, acting forces, states of the second
    controller, states of the controller, and, for a delay with a fraction of a sample, the force that acts at the start of a
    sample.

    Attributes:
        Phi: shape (n, n).
        Gamma: shape (n, m).
        G: shape (m, n).
        delay: whole samples of delay.
        period: sample period [s].
        timestep: timestep of the physics [s].
        sizes: sizes of these six parts of the state.
    """

    Phi: Array
    Gamma: Array
    G: Array
    delay: int
    period: float
    timestep: float
    sizes: tuple[int, ...]

    @cached_property
    def _over_delay(self) -> complex:
        acts = np.any(self.G, axis=1)
        return slowest_from_sample_to_sample(self.Phi, self.Gamma[:, acts], self.G[acts], self.delay)

    @cached_property
    def slowest(self) -> tuple[complex, Array]:
        """The eigenvalue z with the largest magnitude, and its vector in the state, complex, shape (n,)."""
        return mode(self.Phi, self.Gamma, self.G, self.delay, self._over_delay)

    @property
    def rate(self) -> float:
        """Rate of the slowest mode [1/s], positive if it grows; NaN if the iteration does not find it."""
        try:
            return math.log(max(abs(self._over_delay), 1e-300)) / max(self.delay, 1) / self.period
        except ArpackError:
            return math.nan

    @property
    def grows(self) -> bool:
        """Returns True if the loop is unstable."""
        return self.rate > STANDS

    def start(self, limit: float | None) -> InitialState:
        """Returns the start of a run in the slowest mode alone, which stays below a force limit [N]."""
        z, vector = self.slowest
        vector = vector * SMALL / np.abs(vector[: self.sizes[0]]).max()
        pending = [self.G @ vector * z**-j for j in range(self.delay, 0, -1)]
        motion, lagging, acting, rest, law, first = np.split(vector, np.cumsum(self.sizes)[:-1])
        largest = max(np.abs(force).max(initial=0.0) for force in (acting, lagging, self.G @ vector, *pending))
        scale = 1.0 if limit is None else min(1.0, FREE * limit / max(largest, FREE * limit))
        forces = np.array([*([first] if len(first) else []), *pending]).reshape(-1, len(acting))
        parts = np.concatenate([motion, lagging]), acting, law, rest, forces
        return InitialState(*(np.real(scale * part) for part in parts))


def simulated_loop(step: StepDerivative, trial: Trial) -> SimulatedLoop:
    """Returns a loop of the vehicle of this step.

    Raises:
        InputError: the sample period or the delay is not a multiple of the timestep.
    """
    how, timestep, (n, m) = trial.vehicle.implementation, step.timestep, step.B.shape
    intervals = steps_held(how, timestep)
    steps, delay, late = sum(count for count, _ in intervals), math.floor(how.delay), len(intervals) > 1
    law, y = trial.controller.law.sampled(steps * timestep), step.rows(trial.controller.measured)
    one, others = _one_step(step, trial.undelayed)
    k, w = law.states, n + m + others
    size = w + k + m * late
    G, kept = np.zeros((m, size)), np.zeros((k, size))
    G[:, : n + m], G[:, w : w + k], kept[:, : n + m], kept[:, w : w + k] = law.D @ y, law.C, law.B @ y, law.A
    moved = np.eye(w, size + m)  # of the state and the force that arrives
    for count, age in intervals:
        acting = np.eye(m, size + m, size if age == delay else size - m)
        moved = (np.linalg.matrix_power(one, count) @ np.vstack([moved, acting]))[:w]
    Phi = np.vstack([moved[:, :size], kept, np.zeros((m * late, size))])
    Gamma = np.vstack([moved[:, size:], np.zeros((k, m)), np.eye(m * late, m)])
    sizes = (n - step.lagging, step.lagging, m, others, k, m * late)
    return SimulatedLoop(Phi, Gamma, G, delay, steps * timestep, timestep, sizes)


def _one_step(step: StepDerivative, undelayed: Controller | None) -> tuple[Array, int]:
    """Returns the step of [z; acting forces; states of the undelayed controller; force held], and the number of those states."""
    n, m = step.B.shape
    if undelayed is None:
        law, y = LinearLaw(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((m, 0)), np.zeros((m, 0))), np.zeros((0, n + m))
    else:
        law, y = undelayed.law.sampled(step.timestep), step.rows(undelayed.measured)
    k = law.states
    acting = np.hstack([law.D @ y, law.C, np.eye(m)])
    moved = step.B @ acting
    moved[:, :n] += step.A
    kept = np.hstack([law.B @ y, law.A, np.zeros((k, m))])
    return np.vstack([moved, acting, kept, np.eye(m, n + m + k + m, n + m + k)]), k
