"""The shortest sample period at which a loop is unstable.

The forces at which the loop is cut are sampled by a copy of the law. The others are in continuous time, by a copy of their own.
Each copy has the states of the law that its forces depend on.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy import linalg, optimize

from models.common.arrays import Array
from models.laws.linear import LinearLaw
from synth.plant.loop import HoldInterval, Loop
from synth.plant.state_space import spectral_radius

DECAYS = 1e-9  # of the fastest of a law: a mode that decays as slowly does not
FINER = 0.05  # radian that a pole turns by from one sample period that is tried to the next
TOGETHER = 128  # sample periods of one batch
MOST_SQUARINGS = 4  # times that a transition is, to see it contract
CONTRACTS = 0.4  # norm of a power that does: no eigenvalue comes near the unit circle within a step
SHALLOW = 0.2  # of the parabola's rise over a step: a minimum that lies higher is none of an instability
SMALL = 1e-3  # of a step: to so much a minimum is looked for
WIDEST = 1.0  # s; the largest step from one sample period to the next, where nothing turns any more
LONGEST = 100.0  # s; the longest sample period that is looked at where the vehicle does not settle without the loop


def all_sampled(loop: Loop, forces: Sequence[str]) -> bool:
    """Returns True if all forces are sampled: if all are cut, if forces are measured, or if two copies would drift apart.

    Copies drift apart if both have a mode that does not decay, as an integrator has: nothing measures their difference.
    """
    law, mine = loop.acting_law, np.isin(loop.forces, forces)
    if mine.all() or loop.plant.part(loop.measured, loop.forces).D.any():
        return True
    both = _needed_states(law, mine) & _needed_states(law, ~mine)
    return bool(np.any(np.linalg.eigvals(law.A[np.ix_(both, both)]).real >= -DECAYS * np.abs(law.A).max(initial=0.0)))


def sampled_part(loop: Loop, forces: Sequence[str]) -> Loop:
    """Returns the loop of the forces that are sampled, in continuous time, around all that is not."""
    plant, law, mine = loop.plant.part(loop.measured, loop.forces), loop.acting_law, np.isin(loop.forces, forces)
    if all_sampled(loop, forces):
        return replace(loop, plant=plant)
    own, others = (tuple(np.array(loop.forces)[each].tolist()) for each in (mine, ~mine))
    rest = Loop(plant, _part(law, ~mine), loop.measured, others).closed_loop.part(loop.measured, own)
    return Loop(rest, _part(law, mine), loop.measured, own)


def sampled_growth_at(loop: Loop, period: float) -> float:
    """Returns the spectral radius of a loop if it is sampled every period [s], less 1."""
    return spectral_radius(replace(loop, hold=(HoldInterval(period, 0),)).closed_loop.A) - 1


def transitions(loop: Loop, start: float, step: float, count: int) -> Array:
    """Returns the transitions of a loop if it is sampled, by powers of one exponential, shape (count, N, N).

    The periods are start + step, start + 2 step and so on [s]. A discrete law counts as its continuous counterpart here, at its
    own sample period, too.
    """
    plant, law = loop.plant.part(loop.measured, loop.forces), loop.acting_law
    (n, m), (k, q), C, D = plant.B.shape, law.B.shape, plant.C, plant.D
    held = _powers(np.vstack([np.hstack([plant.A, plant.B]), np.zeros((m, n + m))]), start, step, count)
    # As in `LinearLaw.sampled`, but for the ramp, which is not over the period yet.
    chain = np.zeros((k + 2 * q, k + 2 * q))
    chain[:k, :k], chain[:k, k : k + q], chain[k : k + q, k + q :] = law.A, law.B, np.eye(q)
    periods = start + step * np.arange(1, count + 1)
    powers = _powers(chain, start, step, count)
    A, ramp = powers[:, :k, :k], powers[:, :k, k + q :] / periods[:, None, None]
    B, through = powers[:, :k, k : k + q] - ramp + A @ ramp, law.D + law.C @ ramp
    # From [x; x_c; previous forces], which are states only where they are measured.
    previous = m if np.any(D) else 0
    seen = np.hstack([C, np.zeros((q, k)), D[:, :previous]])
    forces = through @ seen
    forces[:, :, n : n + k] += law.C
    moved = np.zeros((count, n + k + previous, n + k + previous))
    moved[:, :n] = held[:, :n, n:] @ forces
    moved[:, :n, :n] += held[:, :n, :n]
    moved[:, n : n + k] = B @ seen
    moved[:, n : n + k, n : n + k] += A
    moved[:, n + k :] = forces[:, :previous]
    return moved


def _needed_states(law: LinearLaw, forces: Array) -> Array:
    """Returns the mask of the states that some forces depend on, directly or through other states, shape (k,)."""
    needed = np.any(law.C[forces] != 0, axis=0)
    for _ in range(law.states):
        needed = needed | np.any(law.A[needed] != 0, axis=0)
    return needed


def _part(law: LinearLaw, forces: Array) -> LinearLaw:
    """Returns the law of some forces, with the states that they depend on."""
    kept = _needed_states(law, forces)
    return LinearLaw(law.A[np.ix_(kept, kept)], law.B[kept], law.C[np.ix_(forces, kept)], law.D[forces])


def _powers(A: Array, start: float, step: float, count: int) -> Array:
    """exp(A t) at t = start + step, start + 2 step and so on, shape (count, n, n)."""
    by, now = linalg.expm(A * step), linalg.expm(A * start)
    made = np.empty((count, *A.shape))
    with np.errstate(over="ignore", invalid="ignore"):  # an unstable law's own growth in long periods
        for i in range(count):
            now = now @ by
            made[i] = now
    return made


def largest_sample_period(loop: Loop, forces: Sequence[str] | None = None) -> float:
    """Returns the shortest sample period at which a continuous loop is unstable [s], with some forces sampled, or infinity.

    The search takes steps that turn no pole by more than a twentieth of a radian, until all motion has decayed. In between, the
    product of 1 - z_i z_j over all pairs of eigenvalues is smooth, and negative where the loop is unstable: its minima show
    instabilities over less than a step. The result is 0 if a force comes back as large through its own measurement.
    """
    forces = loop.forces if forces is None else tuple(forces)
    cut, part = loop.cut(forces), sampled_part(loop, forces)
    if cut.feedthrough_radius >= 1:
        return 0.0
    growth = partial(sampled_growth_at, part)
    poles = np.linalg.eigvals(cut.A)
    start = 0.0
    while start < LONGEST:
        alive = np.abs(poles[-poles.real * start < 25])  # of the others e^-25 is left
        if len(alive) == 0:
            break
        h = FINER / max(float(alive.max()), FINER / WIDEST)  # an integrator's pole at 0 turns nothing
        begun = max(start - 2 * h, 0.0)  # for minima between two batches
        count = min(TOGETHER, math.ceil((LONGEST - begun) / h))
        products = _products(transitions(part, begun, h, count))
        for i in range(count):
            first = begun + h * (1 + i)
            if products[i] > 0:
                low = 0 < i < count - 1 and np.inf > products[i - 1] > products[i] <= products[i + 1] < np.inf
                first = _dip(part, first, h, products[i - 1 : i + 2]) if low else None
            if first is not None and growth(first) > 0:  # not by rounding alone
                before = max(first - h, 1e-3 * h)  # at zero itself every period is on the verge
                if growth(before) >= 0:  # a loop far faster than the plant: its rounding, or unstable before
                    return before
                refined: Any = optimize.brentq(growth, before, first, xtol=1e-13)
                return float(refined)
        start = begun + count * h
    return math.inf


def _dip(loop: Loop, period: float, h: float, products: Array) -> float | None:
    """Returns the period next to one [s] at which the product is least, or None if the parabola through three is far above 0."""
    bend = products[0] - 2 * products[1] + products[2]
    lowest = products[1] - (products[2] - products[0]) ** 2 / (8 * bend)
    if not lowest < SHALLOW * bend:
        return None

    def product(at: float) -> float:
        return max(float(_products(transitions(loop, 0.0, at, 1))[0]), -bend)

    minimum: Any = optimize.minimize_scalar(
        product, bounds=(period - h, period + h), method="bounded", options={"xatol": SMALL * h}
    )
    return float(minimum.x)


def _products(transitions: Array) -> Array:
    """Returns the product of 1 - z_i z_j over all pairs i <= j of eigenvalues; infinite if the transition contracts soon.

    It is minus infinity if an eigenvalue lies outside the unit circle, and NaN if entries are not finite.
    """
    # A power that is smaller than 1 in norm has no such eigenvalue, and costs less than these.
    left, power = np.arange(len(transitions)), transitions
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(MOST_SQUARINGS):
            open_ = ~(np.linalg.norm(power, axis=(1, 2)) < CONTRACTS)
            left, power = left[open_], power[open_]
            power = power @ power
    products = np.full(len(transitions), np.inf)
    whole = np.isfinite(transitions[left]).all(axis=(1, 2))
    products[left[~whole]] = np.nan
    z = np.linalg.eigvals(transitions[left[whole]])
    i, j = np.triu_indices(z.shape[-1])
    outside = np.abs(z).max(axis=1, initial=0.0) > 1
    products[left[whole]] = np.where(outside, -np.inf, (1 - z[:, i] * z[:, j]).prod(axis=1).real)
    return products
