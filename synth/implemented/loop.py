"""The loop as it is implemented, from one sample of its controller to the next: held, lagged, delayed."""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.reality import steps_held, steps_per_sample
from models.vehicle import Vehicle
from synth.certificate.stability import sampled_growth
from synth.controller import Controller
from synth.implemented.controlled import Controlled, sampled
from synth.sampled.hold import held_inputs


@dataclass(frozen=True, eq=False)
class Held:
    """A part of the period over which one force is held.

    Attributes:
        steps: how many timesteps it lasts.
        inputs: all inputs of `ImplementedLoop.cut` meanwhile, from the loop's state, shape (m + k, s).
        at_once: what they are more by what is added to those that are computed at the sample, shape (m + k, m + k).
    """

    steps: int
    inputs: Array
    at_once: Array


@dataclass(frozen=True, eq=False)
class ImplementedLoop:
    """The loop from one sample of the controller to the next.

    Its s states are those of `controlled.sampled`, and beside them the forces on their way, the next to act first.

    Attributes:
        cut: the vehicle and what its controller keeps, before the loop is closed.
        transition: shape (s, s).
        added: what is added to the inputs that are computed at a sample does to the next state, shape (s, m + k).
        parts: of the period, in their order; one, but for a delay of a fraction of a sample.
    """

    cut: Controlled
    transition: Array
    added: Array
    parts: tuple[Held, ...]

    @property
    def by_step(self) -> list[Held]:
        """What is held at every timestep of the period."""
        return [part for part in self.parts for _ in range(part.steps)]


def sampled_radius(vehicle: Vehicle, controller: Controller, timestep: float) -> float:
    """Growth per timestep of the sampled closed loop, as it is implemented: above 1 it is unstable, at exactly 1 marginal."""
    loop = implemented_loop(vehicle, controller, timestep).transition
    return sampled_growth(loop) ** (1 / steps_per_sample(vehicle.implementation, timestep))


def implemented_loop(vehicle: Vehicle, controller: Controller, timestep: float) -> ImplementedLoop:
    """The loop of a vehicle and its controller as it is implemented."""
    how = vehicle.implementation
    held = steps_held(how, timestep)
    cut = sampled(vehicle, controller, sum(steps for steps, _ in held) * timestep)
    n, m, k = len(cut.model.A), cut.forces, len(cut.hold)
    force, rate = np.eye(m, m + k), np.eye(m + k)[m:]
    size, rest = n + how.waiting * m, how.waiting * m
    asked, kept = np.hstack([cut.asked, np.zeros((m, rest))]), np.hstack([cut.kept, np.zeros((k, rest))])
    acting = [np.eye(m, size, n + (how.waiting - late) * m) if late else asked for _, late in held]
    now = [np.zeros_like(force) if late else force for _, late in held]
    parts = tuple(
        Held(steps, cut.inputs(acts, kept, acting[-1]), cut.inputs(at_once, rate, now[-1]))
        for (steps, _), acts, at_once in zip(held, acting, now, strict=True)
    )
    transition, added = np.zeros((size, size)), np.zeros((size, m + k))
    transition[:n] = np.eye(n, size)
    for part in parts:
        Phi, Gamma = held_inputs(cut.model.A, part.steps * timestep, linalg.expm, cut.model.B)
        transition[:n] = Phi @ transition[:n] + Gamma @ part.inputs
        added[:n] = Phi @ added[:n] + Gamma @ part.at_once
    if rest:
        transition[n : size - m, n + m :] = np.eye(rest - m)
        transition[size - m :, :n] = cut.asked
        added[size - m :] = force
    return ImplementedLoop(cut, transition, added, parts)
