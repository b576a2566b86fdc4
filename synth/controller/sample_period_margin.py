"""Sample-period margin: the shortest sample period at which a loop is unstable.

The loop is cut at some forces, which one copy of the law computes in discrete time. A second copy computes the other forces in
continuous time. Each copy contains only the states of the law on which its forces depend.
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

DECAYS = 1e-9  # a mode counts as undamped if its decay rate, relative to the fastest rate of the law, is smaller than this
FINER = 0.05  # largest angle by which a discrete pole may turn between two successive tested sample periods [rad]
TOGETHER = 128  # number of sample periods that are computed together
MOST_SQUARINGS = 4  # largest number of squarings of a transition matrix to prove that it is a contraction
# no eigenvalue can reach the unit circle within one step if a power of the transition matrix has a norm below this value
CONTRACTS = 0.4
# a minimum of the product is ignored if it exceeds this multiple of the rise of the fitted parabola over one step
SHALLOW = 0.2
SMALL = 1e-3  # accuracy with which a minimum is located, relative to one step
WIDEST = 1.0  # largest step between two tested sample periods if no pole turns [s]
LONGEST = 100.0  # longest sample period that is tested if the vehicle does not settle without control [s]


def all_sampled(loop: Loop, forces: Sequence[str]) -> bool:
    """Returns True if all forces must be sampled: the loop is cut at all forces, some are measured, or two copies of the law
    diverge.

    Two copies diverge from each other if both have a mode that does not decay, such as an integrator, because no measurement
    contains their difference.
    """
    law, mine = loop.acting_law, np.isin(loop.forces, forces)
    if mine.all() or loop.plant.part(loop.measured, loop.forces).D.any():
        return True
    both = _needed_states(law, mine) & _needed_states(law, ~mine)
    return bool(np.any(np.linalg.eigvals(law.A[np.ix_(both, both)]).real >= -DECAYS * np.abs(law.A).max(initial=0.0)))


def sampled_part(loop: Loop, forces: Sequence[str]) -> Loop:
    """Returns the continuous loop through the sampled forces.

    The plant of the continuous loop includes the feedback of the forces that are not sampled.
    """
    plant, law, mine = loop.plant.part(loop.measured, loop.forces), loop.acting_law, np.isin(loop.forces, forces)
    if all_sampled(loop, forces):
        return replace(loop, plant=plant)
    own, others = (tuple(np.array(loop.forces)[each].tolist()) for each in (mine, ~mine))
    rest = Loop(plant, _part(law, ~mine), loop.measured, others).closed_loop.part(loop.measured, own)
    return Loop(rest, _part(law, mine), loop.measured, own)


def sampled_growth_at(loop: Loop, period: float) -> float:
    """Returns the spectral radius, minus 1, of a loop that is sampled with the given period [s]."""
    return spectral_radius(replace(loop, hold=(HoldInterval(period, 0),)).closed_loop.A) - 1


def transitions(loop: Loop, start: float, step: float, count: int) -> Array:
    """Returns the transition matrices of a loop for several sample periods, shape (count, N, N).

    The matrices are powers of one matrix exponential.

    The sample periods are start + step, start + 2 step and so on [s]. A discrete law is replaced by its continuous counterpart,
    even at its own sample period.
    """
    plant, law = loop.plant.part(loop.measured, loop.forces), loop.acting_law
    (n, m), (k, q), C, D = plant.B.shape, law.B.shape, plant.C, plant.D
    held = _powers(np.vstack([np.hstack([plant.A, plant.B]), np.zeros((m, n + m))]), start, step, count)
    # The matrices are computed as in `LinearLaw.sampled`, except that the ramp is divided by the period later.
    chain = np.zeros((k + 2 * q, k + 2 * q))
    chain[:k, :k], chain[:k, k : k + q], chain[k : k + q, k + q :] = law.A, law.B, np.eye(q)
    periods = start + step * np.arange(1, count + 1)
    powers = _powers(chain, start, step, count)
    A, ramp = powers[:, :k, :k], powers[:, :k, k + q :] / periods[:, None, None]
    B, through = powers[:, :k, k : k + q] - ramp + A @ ramp, law.D + law.C @ ramp
    # The matrix acts on [x; x_c; previous forces]. The previous forces are states only if they are measured.
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
    """Returns a mask of the states on which the given forces depend, directly or through other states, shape (k,)."""
    needed = np.any(law.C[forces] != 0, axis=0)
    for _ in range(law.states):
        needed = needed | np.any(law.A[needed] != 0, axis=0)
    return needed


def _part(law: LinearLaw, forces: Array) -> LinearLaw:
    """Returns the part of the law that computes the given forces; this part has only the states on which these forces depend."""
    kept = _needed_states(law, forces)
    return LinearLaw(law.A[np.ix_(kept, kept)], law.B[kept], law.C[np.ix_(forces, kept)], law.D[forces])


def _powers(A: Array, start: float, step: float, count: int) -> Array:
    """Returns the transition matrices exp(A t) at t = start + step, start + 2 step and so on, shape (count, n, n)."""
    by, now = linalg.expm(A * step), linalg.expm(A * start)
    made = np.empty((count, *A.shape))
    with np.errstate(over="ignore", invalid="ignore"):  # an unstable law may overflow if the sample period is long
        for i in range(count):
            now = now @ by
            made[i] = now
    return made


def largest_sample_period(loop: Loop, forces: Sequence[str] | None = None) -> float:
    """Returns the shortest sample period of the given forces at which a continuous loop becomes unstable [s]; may be infinite.

    The search increases the sample period until all motion decays within one period, in steps so short that no pole turns by
    more than 0.05 rad. The product of 1 - z_i z_j over all pairs of eigenvalues z is a smooth function of the sample period,
    and it is negative where the loop becomes unstable. The minima of the product reveal ranges of unstable sample periods that
    are shorter than one step. The result is 0 if a force acts undiminished, through its own measurement, on itself.

    Args:
        loop: loop that is stable in continuous time.
        forces: names of the forces that are sampled, while the other forces stay continuous. Default: all forces.
    """
    forces = loop.forces if forces is None else tuple(forces)
    cut, part = loop.cut(forces), sampled_part(loop, forces)
    if cut.feedthrough_radius >= 1:
        return 0.0
    growth = partial(sampled_growth_at, part)
    poles = np.linalg.eigvals(cut.A)
    start = 0.0
    while start < LONGEST:
        alive = np.abs(poles[-poles.real * start < 25])  # poles whose motion has not yet decayed to e^-25
        if len(alive) == 0:
            break
        h = FINER / max(float(alive.max()), FINER / WIDEST)  # the pole of an integrator is 0, so it does not turn
        begun = max(start - 2 * h, 0.0)  # batches overlap, so that a minimum between two batches is found
        count = min(TOGETHER, math.ceil((LONGEST - begun) / h))
        products = _products(transitions(part, begun, h, count))
        for i in range(count):
            first = begun + h * (1 + i)
            if products[i] > 0:
                low = 0 < i < count - 1 and np.inf > products[i - 1] > products[i] <= products[i + 1] < np.inf
                first = _dip(part, first, h, products[i - 1 : i + 2]) if low else None
            # this test ensures that the loop is actually unstable, and that the sign is not just a rounding error of the
            # product
            if first is not None and growth(first) > 0:
                # the period must be above 0, because every loop is at the stability limit for a period of 0
                before = max(first - h, 1e-3 * h)
                # The loop is far faster than the plant. Either the sign is a rounding error, or the loop is unstable at a
                # shorter period
                if growth(before) >= 0:
                    return before
                refined: Any = optimize.brentq(growth, before, first, xtol=1e-13)
                return float(refined)
        start = begun + count * h
    return math.inf


def _dip(loop: Loop, period: float, h: float, products: Array) -> float | None:
    """Returns the sample period near `period` at which the product of 1 - z_i z_j over all pairs of eigenvalues z is smallest
    [s].

    The result is None if the parabola through three values of this product has its minimum far above 0.
    """
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
    """Returns the product of 1 - z_i z_j over all pairs i <= j of eigenvalues z; infinite if a power of the matrix proves that
    the loop is stable.

    The product is minus infinity if an eigenvalue is outside the unit circle, and NaN if entries are not finite.
    """
    # If a power of the matrix has a norm below 1, no eigenvalue is outside the unit circle. Powers take less time than
    # eigenvalues.
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
