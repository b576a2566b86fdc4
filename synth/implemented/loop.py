"""The loop as it is implemented, from one sample of its controller to the next: held, lagged, delayed."""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.reality import steps_per_sample
from models.vehicle import Vehicle
from synth.certificate.stability import sampled_growth
from synth.controller import Controller
from synth.implemented.controlled import Controlled, sampled
from synth.sampled.hold import held_inputs


def sampled_radius(vehicle: Vehicle, controller: Controller, timestep: float) -> float:
    """Growth per timestep of the sampled closed loop, as it is implemented: above 1 it is unstable, at exactly 1 marginal."""
    loop = implemented_loop(vehicle, controller, timestep).transition
    return sampled_growth(loop) ** (1 / steps_per_sample(vehicle.implementation, timestep))


@dataclass(frozen=True, eq=False)
class ImplementedLoop:
    """The loop from one sample of the controller to the next.

    Its s states are those of `controlled.sampled`, and beside them the forces on their way, the next to act first.

    Attributes:
        cut: the vehicle and what its controller keeps, before the loop is closed.
        transition: shape (s, s).
        inputs: all inputs of `cut`, held until the next sample, from the state, shape (m + k, s).
        added: what is added to the inputs that are computed at a sample does to the next state, shape (s, m + k).
        at_once: what of it acts until then, shape (m + k, m + k).
    """

    cut: Controlled
    transition: Array
    inputs: Array
    added: Array
    at_once: Array


def implemented_loop(vehicle: Vehicle, controller: Controller, timestep: float) -> ImplementedLoop:
    """The loop of a vehicle and its controller as it is implemented."""
    how = vehicle.implementation
    period = steps_per_sample(how, timestep) * timestep
    cut = sampled(vehicle, controller, period)
    Phi, Gamma = held_inputs(cut.model.A, period, linalg.expm, cut.model.B)
    n, m, k = len(Phi), cut.forces, len(cut.hold)
    force, rate = np.eye(m, m + k), np.eye(m + k)[m:]
    if how.delay == 0:
        G, at_once = cut.inputs(cut.asked), cut.inputs(force, rate)
        return ImplementedLoop(cut, Phi + Gamma @ G, G, Gamma @ at_once, at_once)
    size, rest = n + how.delay * m, how.delay * m
    on_their_way = np.hstack([np.zeros((m, n)), np.eye(m, rest)])
    inputs = cut.inputs(on_their_way, np.hstack([cut.kept, np.zeros((k, rest))]))
    at_once = np.vstack([np.zeros_like(force), rate])
    transition, added = np.zeros((size, size)), np.zeros((size, m + k))
    transition[:n, :n] = Phi
    transition[:n] += Gamma @ inputs
    transition[n : size - m, n + m :] = np.eye(rest - m)
    transition[size - m :, :n] = cut.asked
    added[:n], added[size - m :] = Gamma @ at_once, force
    return ImplementedLoop(cut, transition, inputs, added, at_once)
