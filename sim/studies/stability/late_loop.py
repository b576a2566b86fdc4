"""The sampled loop that a run of MuJoCo is to be: how fast it grows, and what it makes of the run's own past."""

import functools
import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.linalg import ArpackError

from models.common.arrays import Array
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.linear.sampled_response import taylor4
from sim.studies.stability.delayed import rate_from_sample_to_sample
from sim.studies.stability.loop_transfer import sampled_loop_transfer
from synth.controller.controller import Controller


@dataclass(frozen=True, eq=False)
class LateLoop:
    """Loop with delayed forces: x[k+1] = Phi x[k] + Gamma G x[i], where i is the last sample that is at least `delay` steps old.

    Attributes:
        Phi: with the undelayed forces closed, shape (n, n).
        Gamma: from the delayed forces, shape (n, m).
        G: to the requested forces, shape (m, n).
        delay: in steps; 0 if the controller samples less often than every step.
        held: steps from sample to sample.
        timestep: [s].
    """

    Phi: Array
    Gamma: Array
    G: Array
    delay: int
    held: int
    timestep: float

    @functools.cached_property
    def rate(self) -> float:
        """Rate of the slowest mode [1/s], above 0 where it grows; NaN where iterations do not find it."""
        moved, pushed = self.Phi, self.Gamma
        for _ in range(self.held - 1):
            moved, pushed = self.Phi @ moved, self.Phi @ pushed + self.Gamma
        try:
            return rate_from_sample_to_sample(moved, pushed, self.G, self.delay) / (self.held * self.timestep)
        except ArpackError:
            return math.nan

    def goes_on(self, states: Array, first: int) -> Array:
        """Predicts all later states from a run's states up to a step, which must be a sample, shape (n, T).

        Args:
            states: of the run, shape (n, T).
            first: the last step that is taken from the run.
        """
        expected = np.array(states)
        now, forces, Phi, Gamma = expected[:, first], np.zeros(len(self.Phi)), self.Phi, self.Gamma
        for k in range(first, states.shape[1] - 1):
            if k % self.held == 0 and k >= self.delay:
                forces = Gamma @ (self.G @ expected[:, k - self.delay])
            now = Phi @ now + forces
            expected[:, k + 1] = now
        return expected

    def scaled(self, scale: Array) -> "LateLoop":
        """The same with its states in these units, shape (n,)."""
        return replace(self, Phi=self.Phi * scale / scale[:, None], Gamma=self.Gamma / scale[:, None], G=self.G * scale)


def late_loop(vehicle: Vehicle, controller: Controller, undelayed: Controller | None, timestep: float) -> LateLoop | None:
    """Returns the loop of a vehicle, as MuJoCo integrates it, with an undelayed second controller.

    Of a controller with states that samples seldom, whose states change at samples alone, a step of the loop is a sample.
    Returns None if the first controller is late by part of a sample, or has no states, samples seldom and is late. Also returns
    None if there is a second controller and either has states.
    """
    how = vehicle.implementation
    steps = steps_per_sample(how, timestep)
    memory = controller.law.states > 0
    if how.delay % 1 or (steps > 1 and how.delay and not memory):
        return None
    if steps > 1 and memory:
        if undelayed is not None:
            return None
        timestep, held, steps = steps * timestep, steps, 1

        def exponential(M: Array) -> Array:
            return np.linalg.matrix_power(taylor4(M / held), held)
    else:
        exponential = taylor4
    Phi, Gamma, G = sampled_loop_transfer(vehicle, controller, timestep, exponential=exponential)
    if undelayed is not None:
        others = sampled_loop_transfer(vehicle, undelayed, timestep, exponential=taylor4)[2]
        if memory or others.shape != G.shape:
            return None
        Phi = Phi + Gamma @ others
    acts = np.any(G, axis=1)
    return LateLoop(Phi, Gamma[:, acts], G[acts], int(how.delay), steps, timestep)
