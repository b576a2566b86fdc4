"""How far a vehicle from rest is from what it comes to on a random road, when measuring begins.

Every line of the road, from its own height at the start, moves the sampled loop as a sinusoid that has always been, less what
that would have left behind at the moment when a wheel came onto the road. With the states X_j that wheel j makes oscillate per
unit of road velocity, x0_j those of a loop at rest with that wheel raised by 1, L the loop over one sample and wheel j on the
road for k_j samples, a signal of gain C at time t is

    A exp(j omega t) - B,    A = sum over j of (C X_j + Cr_j / j omega) e_j,
    B = sum over j of (C L^k_j (X_j - x0_j / j omega) + (C x0_j + Cr_j) / j omega) e_j at the start,

of the wheels that are on it. The lines' phases are independent, so the variance is the integral over the road's band of

    |A|^2 + |B|^2 - 2 Re A conj(B) exp(j omega t).

It may be more than it comes to: a loop that is slower than the road's lowest line answers the start, which has all frequencies.
"""

from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.reality import steps_per_sample
from models.roads.spectrum import Spectrum
from models.vehicle import Vehicle
from sim.linear.dampers import is_linear
from sim.linear.frequency import as_met, sampled_states
from sim.ride.band import longest_panel, loop_poles, power_of, tracks
from sim.ride.metrics import points
from sim.ride.quadrature import sample_band
from synth.controller import Controller
from synth.implemented.loop import implemented_loop, sampled_radius

STILL = 1e-12  # of the largest variance in its unit: a signal that does not move


@dataclass(frozen=True)
class Settled:
    """The variance of a signal when measuring begins.

    Attributes:
        share: of what it comes to; below or above 1.
        signal: the measured signal of which that is furthest from 1.
    """

    share: float
    signal: str


def settled(vehicle: Vehicle, controller: Controller, road: Spectrum, timestep: float, start: float) -> Settled | None:
    """The measured signal that is furthest from its final variance when measuring begins; None for an unstable loop.

    Args:
        vehicle: the vehicle.
        controller: its controller.
        road: the spectrum of the road; how rough it is does not matter.
        timestep: of the sampled loop [s].
        start: when measuring begins [s]; rounded to a sample of the controller, as is when a rear wheel comes onto the road.
    """
    shares = settled_shares(vehicle, controller, road, timestep, start)
    if not shares:
        return None
    furthest = max(shares, key=lambda name: abs(shares[name] - 1))
    return Settled(shares[furthest], furthest)


def settled_shares(vehicle: Vehicle, controller: Controller, road: Spectrum, timestep: float, start: float) -> dict[str, float]:
    """The same of every measured signal that moves, by name; empty for an unstable loop."""
    if not is_linear(vehicle, controller) or sampled_radius(vehicle, controller, timestep) >= 1:
        return {}
    implemented = implemented_loop(vehicle, controller, timestep)
    loop, cut, model = implemented.transition, implemented.cut, implemented.cut.model
    C = np.hstack([model.C, np.zeros((len(model.C), len(loop) - model.C.shape[1]))]) + model.D @ implemented.parts[0].inputs
    raised = -np.linalg.solve(model.A + model.B @ cut.inputs(cut.asked), model.Br)
    raised = np.vstack([raised, *([cut.asked @ raised] * vehicle.implementation.waiting)])

    period = timestep * steps_per_sample(vehicle.implementation, timestep)
    sample = round(start / period)
    late = np.array([round(wheel.behind(vehicle.parameters) / road.speed / period) for wheel in vehicle.kind.wheels])
    here = late <= sample
    left_behind = {k: C @ np.linalg.matrix_power(loop, sample - k) for k in set(late[here].tolist())}

    def amplitudes(omega: Array) -> Array:
        """A and B by source, shape (F, 2 p, 2)."""
        X, s = sampled_states(vehicle, controller, omega, timestep), 1j * omega[:, None, None]
        steady, left = C @ X + model.Cr / s, np.zeros((len(omega), len(C), len(late)), dtype=complex)
        for j in np.flatnonzero(here):
            left[..., j] = (left_behind[int(late[j])] @ (X - raised / s) + (C @ raised + model.Cr) / s)[..., j]
        shares, met = tracks(vehicle, road, omega), as_met(vehicle, omega, road.speed)[..., None]
        return np.concatenate([steady[..., here] @ (met * shares)[:, here], left @ shares], axis=1)

    def final(omega: Array) -> Array:
        """What the variance comes to, per Hz, shape (F, p): with all wheels on the road."""
        X, s = sampled_states(vehicle, controller, omega, timestep), 1j * omega[:, None, None]
        met = as_met(vehicle, omega, road.speed)[..., None] * tracks(vehicle, road, omega)
        return power_of((C @ X + model.Cr / s) @ met)

    low, high = road.band
    poles, _ = loop_poles(vehicle, controller, timestep, high)
    band = sample_band(amplitudes, lambda _, both: power_of(both), low, high, poles, longest_panel(vehicle, road.speed))
    A, B = np.split(band.values, 2, axis=1)
    # A is taken from time 0 on, so B, whose phase is that of the start, turns back with it.
    cross = np.real(band.turning(sample * period) @ np.sum(A * np.conj(B), axis=-1))
    now = band.share @ (power_of(A) + power_of(B)) - 2 * cross
    comes_to = band.share @ (power_of(A) if here.all() else final(band.omega))

    where, units = points(vehicle), [vehicle.kind.signal(name).unit for name in model.outputs]
    measured = {*where.accelerations, *where.suspensions, *where.tyres, *(name for name, *_ in where.actuators)}
    loudest = np.array([max(v for v, u in zip(comes_to, units, strict=True) if u == unit) for unit in units])
    return {
        name: max(float(now[i] / comes_to[i]), 0.0)
        for i, name in enumerate(model.outputs)
        if name in measured and comes_to[i] > STILL * loudest[i]
    }
