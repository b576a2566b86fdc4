"""Lower bounds from invariant points: at every frequency some direction of z depends on w alone, whatever the control.

With z = Gw w + Gu u at a frequency, no controller, causal or not, changes the part of Gw w that is orthogonal to Gu. The norm of
that part is a lower bound. For a suspension it peaks at the invariant point of the wheel (Hedrick, Butsuen 1990).

Floats only propose the frequency and the direction. The proof is a pair (q, p) with

    [q; p]* [A - j omega, B; C, D] = 0,     so that     p* z = (q* Bw + p* Dw) w     at omega for every u and every x,

and it is exact: as many entries of q and p as there are independent equations follow from the others by integers. So no tolerance
decides if a pair exists at a resonance, near a zero of Gu, or if u can do all.

If a pole on the axis is unobservable in z, there are more such pairs at that pole than beside it: a stabilising controller holds
that mode, too, so the effect of w on it must vanish. An unobservable integrator is an example.
"""

import contextlib
from fractions import Fraction

import numpy as np

from models.common.arrays import Array
from synth.analysis.norm import largest_singular_values, transfer_matrix
from synth.analysis.rigorous import Nullspace, floats, identity, integers, product, root_below, without_factors
from synth.analysis.stability import balance, stability
from synth.plant.generalized import GeneralizedPlant, check_continuous
from synth.plant.units import own_units

PEAKS = 6  # local maxima that are refined
NONE = 1e-10  # relative; smaller singular values of Gu count as zero in a proposal
AWAY = 1e-9  # relative distance of a proposal from a pole on the axis
FURTHER = 10.0  # times AWAY if that is still a pole to rounding: a k-fold one reaches to the k-th root of rounding
ENOUGH = 1e-9  # relative; smallest expected gain over the best proof for which a proposal is tried


def invariant_limit(plant: GeneralizedPlant) -> tuple[float, float] | None:
    """Returns the largest norm that no control changes, and its frequency [rad/s]; None if control can change all."""
    rates = _rates(plant)
    largest = float(rates.max())
    smallest = float(rates[rates > 1e-6 * largest].min())
    omega = np.geomspace(1e-2 * smallest, 1e2 * largest, 500)
    left = largest_singular_values(_left(plant, omega))
    tops = np.flatnonzero((left[1:-1] >= left[:-2]) & (left[1:-1] >= left[2:])) + 1
    tops = np.unique([*tops[np.argsort(left[tops])[-PEAKS:]], left.argmax()])
    middle, height, width = omega[tops], left[tops], omega[1] / omega[0] - 1
    for _ in range(9):  # closer around the highest points, all at once
        near = middle * (1 + width * np.linspace(-1, 1, 11)[:, None])
        there = largest_singular_values(_left(plant, near.ravel())).reshape(near.shape)
        highest = there.argmax(axis=0)
        index = np.arange(len(middle))
        middle, height, width = near[highest, index], there[highest, index], width / 5
    middle, height = np.append(middle, 0.0), np.append(height, largest_singular_values(_left(plant, np.zeros(1))))
    best, at = max(((limit_at(plant, there), there) for there in _standing(plant)), default=(0.0, 0.0))
    for promised, there in sorted(zip(height.tolist(), middle.tolist(), strict=True), reverse=True):
        if promised > best * (1 + ENOUGH):
            best, at = max((best, at), (limit_at(plant, there), there))
    return (best, at) if best else None


@np.errstate(all="ignore")  # what is not finite proves nothing
def limit_at(plant: GeneralizedPlant, omega: float) -> float:
    """Returns a proved norm of a continuous plant at a frequency [rad/s] that no control changes; 0 if none is proved."""
    check_continuous(plant)
    n, d, m = len(plant.A), len(plant.C), plant.B.shape[1]
    still = plant.system_matrix[:, : n + m]
    turning = np.zeros_like(still)
    turning[np.arange(n), np.arange(n)] = -omega
    # Real and imaginary part of [q; p] below each other.
    solutions = Nullspace(integers(np.block([[still, turning], [turning, -still]]))[0])
    if not solutions.free:
        return 0.0
    answer, unit = integers(plant.system_matrix[:, n + m :])
    outputs = [*range(n, n + d), *range(2 * n + d, 2 * (n + d))]

    def proved(guess: Array) -> float:
        if not np.all(np.isfinite(guess)):
            return 0.0
        found = solutions.complete(integers(guess[:, None])[0])
        to_w = product(np.hstack([found[: n + d], found[n + d :]]).T, answer)
        own = int(np.sum(found[outputs] ** 2))
        with contextlib.suppress(OverflowError):
            return root_below(Fraction(int(np.sum(to_w**2)), unit**2 * own)) if own else 0.0
        return 0.0

    p, q = _guess(plant, omega)
    best = proved(np.concatenate([np.real(q), np.real(p), np.imag(q), np.imag(p)])[solutions.free])
    if not is_pole(plant, omega):
        return best
    whole, over = without_factors(solutions.complete(identity(len(solutions.free))))
    basis = floats(whole, Fraction(1, over))
    to_w = np.hstack([basis[: n + d].T, basis[n + d :].T]) @ np.kron(np.eye(2), plant.system_matrix[:, n + m :])
    return max(best, proved(basis[solutions.free] @ _strongest(basis[outputs].T, to_w)))


def is_pole(plant: GeneralizedPlant, omega: float) -> bool:
    """Returns True if j omega is a pole to the last digit, as 0 is for an integrator."""
    return bool(np.linalg.matrix_rank(balance(plant.A)[0] - 1j * omega * np.eye(len(plant.A))) < len(plant.A))


def _standing(plant: GeneralizedPlant) -> list[float]:
    """Returns the frequencies [rad/s] of the poles that lie on the axis to the last digit."""
    found = stability(plant.A)
    there = np.unique(np.append(np.abs(np.imag(found.poles[found.on_axis])), 0.0))
    return [omega for omega in there.tolist() if is_pole(plant, omega)]


def _strongest(own: Array, answer: Array) -> Array:
    """Returns the combination x with the largest |x' answer| / |x' own|, without directions in which x' own vanishes.

    Args:
        own: shape (k, d).
        answer: shape (k, r).
    """
    directions, sizes, _ = np.linalg.svd(own, full_matrices=False)
    kept = sizes > NONE * sizes.max(initial=0.0)
    directions = directions[:, kept] / sizes[kept]
    return directions @ np.linalg.svd(directions.T @ answer)[0][:, 0] if kept.any() else np.zeros(len(own))


def _rates(plant: GeneralizedPlant) -> Array:
    """Returns the positive magnitudes of the plant's poles [rad/s], or its own rate if all poles lie at 0.

    Rounding moves an n-fold pole at 0 by as much as its n-th root.
    """
    A, _ = balance(plant.A)
    poles = np.abs(np.linalg.eigvals(A))
    poles = poles[poles > 0]
    if len(poles) and poles.max() > np.finfo(float).eps ** (1 / len(A)) * np.linalg.norm(A):
        return poles
    return np.append(poles, own_units(plant).rate)


def _left(plant: GeneralizedPlant, omega: Array, away: float = AWAY) -> Array:
    """Returns the part of Gw that is orthogonal to Gu at frequencies [rad/s] of shape (F,): complex, shape (F, d, r)."""
    try:
        both = np.hstack([plant.Bw, plant.B]), np.hstack([plant.Dw, plant.D])
        from_w, from_u = np.split(transfer_matrix(plant.A, both[0], plant.C, both[1], omega), [plant.Bw.shape[1]], axis=2)
    except np.linalg.LinAlgError:  # a pole, to the last digit
        return _left(plant, _beside(plant, omega, away), FURTHER * away)
    columns = np.linalg.norm(from_u, axis=1, keepdims=True)
    directions, sizes, _ = np.linalg.svd(from_u / np.where(columns > 0, columns, 1.0), full_matrices=False)
    directions = directions * (sizes > NONE * sizes.max(axis=1, keepdims=True, initial=0.0))[:, None]
    return from_w - directions @ (directions.conj().swapaxes(1, 2) @ from_w)


def _guess(plant: GeneralizedPlant, omega: float, away: float = AWAY) -> tuple[Array, Array]:
    """Returns floats near the best (p, q) at a frequency [rad/s], complex, shapes (d,), (n,)."""
    p = np.linalg.svd(_left(plant, np.array([omega]))[0])[0][:, 0]
    try:
        return p, np.linalg.solve((1j * omega * np.eye(len(plant.A)) - plant.A).conj().T, plant.C.T @ p)
    except np.linalg.LinAlgError:
        return _guess(plant, float(_beside(plant, np.array([omega]), away)[0]), FURTHER * away)


def _beside(plant: GeneralizedPlant, omega: Array, away: float) -> Array:
    """Returns frequencies next to `omega`, of which some are poles to the last digit."""
    return omega * (1 + away) + away * _rates(plant).max() * (omega == 0)
