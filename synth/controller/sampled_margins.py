"""Margins of the loop as implemented: how much more gain and delay its forces bear, between the computer and the actuators.

From sample to sample the loop is x[k+1] = T x[k] + Gamma u[k], u[k] = F x[k]; the implementation's delay is among its states. A
factor on the forces changes the eigenvalues of T + factor Gamma F. A delay d turns an eigenvalue of F (z I - T)^-1 Gamma at
z = exp(j w h), with the sample period h, by w d. Where that has magnitude 1, its angle over w is a delay at which the loop is
marginal; the shortest one is the margin. A delay of part of a sample changes the hold, too: it is refined on the loop itself. A
lead is the rest of a whole turn.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller
from synth.controller.open_loop import LoopModel

MOST_FACTOR = 1e3  # a loop that bears this much more gain bears any; of less gain its inverse
FACTORS = np.geomspace(1.0, MOST_FACTOR, 500)[1:]
FREQUENCIES = 3000  # from 0.1 rad/s on
SLOWEST = 0.1  # rad/s
EXACT = 1e-10  # relative
MOST_STATES = 300  # of a loop whose delay is refined on its own eigenvalues


@dataclass(frozen=True)
class SampledMargins:
    """Margins of a loop as implemented; infinite if any amount is stable.

    Attributes:
        gain: smallest factor above 1 on all forces at which the loop is unstable.
        gain_lower: largest factor below 1 at which it is unstable; 0 without one.
        delay: shortest delay of all forces, added to that of the implementation, at which it is unstable [s].
        frequency: oscillation of the loop that is then marginal [rad/s]; NaN without one.
        lead: smallest phase lead of all forces, at every frequency alike, at which it is unstable [rad].
    """

    gain: float
    gain_lower: float
    delay: float
    frequency: float
    lead: float

    @property
    def phase(self) -> float:
        """The lag of the delay at its frequency [rad]."""
        return math.inf if math.isinf(self.delay) else self.delay * self.frequency


def sampled_margins(vehicle: Vehicle, controller: Controller, timestep: float) -> SampledMargins | None:
    """Returns the margins of all loops together, or None if the loop is not stable.

    Raises:
        InputError: the sample period or the delay is not a multiple of the timestep [s].
    """
    loop = LoopModel(vehicle, controller, timestep)
    if loop.radius >= 1:
        return None
    closed = loop.closed_loop
    Gamma = closed.added[:, : loop.open_loop.forces]
    F = np.hstack([loop.open_loop.asked, np.zeros((len(Gamma[0]), len(Gamma) - loop.open_loop.asked.shape[1]))])
    open_, pushed = closed.transition - Gamma @ F, Gamma @ F
    crossed = _crossovers(open_, Gamma, F, loop.period)
    frequency, lag = min(crossed, key=lambda one: one[1] / one[0], default=(math.nan, math.inf))
    delay = lag / frequency if crossed else math.inf
    return SampledMargins(
        _first_growing(open_, pushed, FACTORS),
        _first_growing(open_, pushed, 1 / FACTORS) or 0.0,
        delay if loop.steps == 1 else _refined(loop, delay),
        frequency,
        min((2 * np.pi - lag for _, lag in crossed), default=math.inf),
    )


def _first_growing(open_: Array, pushed: Array, factors: Array) -> float:
    """Returns the factor nearest to 1 at which the loop grows; beyond all these infinity, or below them 0."""

    def grows(factor: float) -> bool:
        return bool(np.abs(np.linalg.eigvals(open_ + factor * pushed)).max() >= 1)

    radii = np.abs(np.linalg.eigvals(open_ + factors[:, None, None] * pushed)).max(axis=1)
    growing = np.flatnonzero(radii >= 1)
    if not len(growing):
        return math.inf if factors[-1] > 1 else 0.0
    stable, unstable = float(factors[growing[0] - 1]) if growing[0] else 1.0, float(factors[growing[0]])
    while abs(unstable - stable) > EXACT * stable:
        middle = (stable + unstable) / 2
        stable, unstable = (stable, middle) if grows(middle) else (middle, unstable)
    return unstable


def _crossovers(open_: Array, Gamma: Array, F: Array, period: float) -> list[tuple[float, float]]:
    """Returns the frequency and the lag of every crossover."""

    def eigenvalues(omega: Array) -> Array:
        z = np.exp(1j * omega * period)[:, None, None]
        resolvent = np.linalg.solve(
            z * np.eye(len(open_)) - open_, np.broadcast_to(Gamma.astype(complex), (len(omega), *Gamma.shape))
        )
        return np.linalg.eigvals(F @ resolvent)

    grid = np.union1d(
        np.geomspace(SLOWEST, np.pi / period, FREQUENCIES, endpoint=False), np.linspace(SLOWEST, np.pi / period, FREQUENCIES)
    )
    crossed: list[tuple[float, float]] = []
    for i in _crossings(eigenvalues(grid)):
        low, high = grid[i], grid[i + 1]
        for _ in range(4):
            finer = np.linspace(low, high, 40)
            found = _crossings(eigenvalues(finer))
            if not len(found):
                break
            low, high = finer[found[0]], finer[found[0] + 1]
        omega = (low + high) / 2
        (values,) = eigenvalues(np.array([omega]))
        turned = float(np.angle(values[np.argmin(np.abs(np.log(np.abs(values))))]) % (2 * np.pi))
        crossed.append((float(omega), turned))
    return crossed


def _crossings(values: Array) -> Array:
    """Returns the indices behind which another number of eigenvalues is above 1 in magnitude."""
    return np.flatnonzero(np.diff(np.sum(np.abs(values) > 1, axis=1)))


def _refined(loop: LoopModel, delay: float) -> float:
    """Returns the delay at which the loop itself grows [s], between two multiples of the timestep, from a delay near it."""
    how, h = loop.vehicle.implementation, loop.timestep
    largest = loop.open_loop.forces * (delay / loop.period + how.delay)
    if not math.isfinite(delay) or largest > MOST_STATES:
        return delay

    def growth(steps: int) -> float:
        late = replace(how, delay=how.delay + steps / loop.steps)
        return math.log(LoopModel(replace(loop.vehicle, implementation=late), loop.controller, h).radius)

    steps = max(1, round(delay / h))
    while growth(steps) < 0 and steps < 2 * delay / h + 2:
        steps += 1
    while steps > 1 and growth(steps - 1) >= 0:
        steps -= 1
    before, after = growth(steps - 1), growth(steps)
    if not before < 0 <= after:  # the near one was none of this loop
        return delay
    return h * (steps - 1 + before / (before - after))
