"""The sampled loop that a run of MuJoCo is to be: how fast it grows, and what it makes of the run's own past."""

import functools
import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse.linalg import ArpackError

from models.common.arrays import Array
from models.laws.linear import LinearLaw
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.linear.sampled_response import taylor4
from sim.studies.stability.delayed import rate_from_sample_to_sample, slowest_from_sample_to_sample
from synth.controller.controller import Controller
from synth.controller.loop_transfer import sampled_loop_transfer


@dataclass(frozen=True, eq=False)
class LateLoop:
    """Loop with delayed forces: x[k+1] = Phi x[k] + Gamma G x[i], where i is the last sample that is at least `delay` steps old.

    Attributes:
        Phi: transition with the undelayed forces closed, shape (n, n).
        Gamma: input matrix of the delayed forces, shape (n, m).
        G: gain to the requested forces, shape (m, n).
        delay: delay in steps; 0 if the controller samples less often than every step.
        held: steps from sample to sample.
        timestep: timestep of the physics [s].
    """

    Phi: Array
    Gamma: Array
    G: Array
    delay: int
    held: int
    timestep: float

    @functools.cached_property
    def rate(self) -> float:
        """Rate of the slowest mode [1/s], positive if it grows; NaN if the iteration does not find it."""
        try:
            return rate_from_sample_to_sample(*self._over_sample, self.G, self.delay) / (self.held * self.timestep)
        except ArpackError:
            return math.nan

    @functools.cached_property
    def _over_sample(self) -> tuple[Array, Array]:
        """Phi and Gamma from sample to sample."""
        moved, pushed = self.Phi, self.Gamma
        for _ in range(self.held - 1):
            moved, pushed = self.Phi @ moved, self.Phi @ pushed + self.Gamma
        return moved, pushed

    def slowest_mode(self, states: Array, first: int) -> tuple[float, float]:
        """Returns the rate of a run's slowest mode [1/s], and the distance of that mode from the loop's own at the end of the
        run.

        With z and w of `slowest_from_sample_to_sample` the mode is a[k] = w' (x[k] + Gamma G sum over j = 1 .. delay of
        z^(j - 1 - delay) x[k-j]), and a[k+1] = z a[k] however loud the others are.

        Args:
            states: states of the run, shape (n, T).
            first: sample after which the run is free.

        Returns:
            The second is relative to the change of the mode's size, infinite for a mode that is not in the run.
        """
        moved, pushed = self._over_sample
        try:
            z, w = slowest_from_sample_to_sample(moved, pushed, self.G, self.delay)
        except ArpackError:
            return math.nan, math.inf
        samples = states[:, :: self.held]
        asked = (w @ pushed) @ (self.G @ samples)

        def mode(k: int) -> complex:
            late = np.arange(1, min(self.delay, k) + 1)
            return complex(w @ samples[:, k] + (z ** (late - 1.0 - self.delay) * asked[k - late]).sum())

        start, end = first // self.held, samples.shape[1] - 1
        z = np.complex128(z)  # a mode that grows fast overflows to infinity, where Python's complex numbers raise
        with np.errstate(over="ignore", invalid="ignore"):
            began, ended, expected = mode(start), mode(end), z ** (end - start)
        change = abs(abs(expected) - 1)
        if not (began and ended and change and np.isfinite([began, ended, expected]).all()):
            return math.nan, math.inf
        rate = math.log(abs(ended / began)) / ((end - start) * self.held * self.timestep)
        return rate, abs(ended / began - expected) / change

    def goes_on(self, states: Array, first: int) -> Array:
        """Predicts all later states from a run's states up to a step, which must be a sample, shape (n, T).

        Args:
            states: states of the run, shape (n, T).
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

    For a controller whose states change only at samples several steps apart, a step of the loop is a sample.
    Returns None if the first controller is late by part of a sample, or has no states, samples seldom and is late. Also returns
    None if there is a second controller, unless neither has states, or both are parts of one that samples every step.
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
    parts = None if undelayed is None else _parts(controller.law, undelayed.law)
    if parts is not None:
        whole, mine = parts
        together = replace(controller, law=whole)
        Phi, Gamma, G = sampled_loop_transfer(vehicle, together, timestep, np.flatnonzero(mine).tolist(), exponential)
        return LateLoop(Phi, Gamma, G, int(how.delay), steps, timestep)
    Phi, Gamma, G = sampled_loop_transfer(vehicle, controller, timestep, exponential=exponential)
    if undelayed is not None:
        others = sampled_loop_transfer(vehicle, undelayed, timestep, exponential=taylor4)[2]
        if memory or others.shape != G.shape:
            return None
        Phi = Phi + Gamma @ others
    acts = np.any(G, axis=1)
    return LateLoop(Phi, Gamma[:, acts], G[acts], int(how.delay), steps, timestep)


def _parts(law: LinearLaw, beside: LinearLaw) -> tuple[LinearLaw, Array] | None:
    """Returns the law with states of which two laws are parts, and the first's; None if they are not parts of one law.

    Their states are the same, as both read the same.
    """
    mine, others = (np.any(np.hstack([one.C, one.D]), axis=1) for one in (law, beside))
    one = law.states and all(np.array_equal(getattr(law, name), getattr(beside, name)) for name in ("A", "B"))
    if not one or np.any(mine & others) or law.sample_period != beside.sample_period:
        return None
    return replace(law, C=law.C + beside.C, D=law.D + beside.D), mine
