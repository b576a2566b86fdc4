"""Bounds on all loops of a box of constant errors by multipliers, each constant in an interval of frequencies.

Cut at the errors, p_k = delta_k q_k with a real |delta_k| <= 1, a loop is one plant from [p; w] to [q; z]. For D >= 0 and any G,
both diagonal,

    q* D q - p* D p >= 0,    j (p* G q - q* G p) = 0.

So the norm from w to z is at most gamma at a frequency at which, for all p and w,

    |z|^2 - gamma^2 |w|^2 + q* D q - p* D p + j (p* G q - q* G p)  <=  0

(Fan, Tits, Doyle 1991, Robustness in the presence of mixed parametric uncertainty and unmodeled dynamics, IEEE Transactions on
Automatic Control 36). Where the same form without w and z is negative at all frequencies, no pole crosses the axis: if the middle
of the box is stable, all of it is.

The proof divides the frequencies into intervals, each with constant D and G. Within one, the frequencies at which the form is
singular show that it is negative everywhere, as in `structured_bound.py`: nothing is sampled, and the search for multipliers is
not believed. The number of unknowns grows with the number of errors, not with that of the corners of their box.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from models.common.arrays import Array
from models.laws.linear import LinearLaw
from synth.analysis.stability import is_stable
from synth.analysis.uncertainty_box import MOST, Box, ScaledGain
from synth.design.uncertainty.parameter_dependent_lyapunov import stable_throughout
from synth.design.uncertainty.problem import box_of, scaled_gain
from synth.lmi.barrier import Barrier, newton
from synth.plant.generalized import Plant

NEAR = 3e-3  # relative; how far the bound lies above the best multipliers' peak
EXACT = 1e-6  # relative: of p* D p and gamma^2 so much is left unused, for rounding
FASTER, CENTRES, CLOSE = 8.0, 12, 1e-2  # of the path, as in `worst_case.py`
LARGEST = 1e6  # of D and G, where p, q and z have size one
MOST_PARTS, MOST_PEAKS = 100, 40
SHORTEST = 1e-4  # relative; of a step in frequency
ENOUGH = 0.99  # of gamma^2: the search for the least one ends below that


class CutLoop(NamedTuple):
    """The loop of a box's middle, cut at its errors: a system from [p; w] to [q; z], and the number k of errors."""

    system: Plant
    errors: int

    def responses(self, omega: Array) -> Array:
        """Returns T(j omega), shape (F, k + d, k + r), for finite frequencies [rad/s] of shape (F,)."""
        return self.system.frequency_response(omega)


def cut_loop(gain: ScaledGain, box: Box) -> CutLoop:
    """Returns the loop that is cut at the errors of a box.

    Raises:
        LinAlgError: the middle loop through the measurements is not well-posed.
    """
    plant, K, q, m = gain.plant, gain.K, gain.K.shape[1], len(gain.K)
    middle, half = box.middle, (box.high - box.low) / 2
    of_y, of_u = box.uncertain[box.uncertain < q], box.uncertain[box.uncertain >= q] - q
    # u = S K (S y + H_y p_y) + H_u p_u - K0 y, y = C_y x + Dyw w + Dyu u.
    acting = gain.acting(middle)
    closing = np.linalg.inv(gain.return_difference(gain.scaled(middle)))
    into_y = half[of_y] * np.eye(q)[:, of_y]
    u_x, u_w = acting @ plant.Cy, acting @ plant.Dyw
    u_p = closing @ np.hstack([middle[q:, None] * K @ into_y, half[q:][of_u] * np.eye(m)[:, of_u]])
    y_x, y_p, y_w = plant.Cy + plant.Dyu @ u_x, plant.Dyu @ u_p, plant.Dyw + plant.Dyu @ u_w
    asked_p = K @ (middle[:q, None] * y_p + np.hstack([into_y, np.zeros((q, len(of_u)))]))
    asked_x, asked_w = K @ (middle[:q, None] * y_x), K @ (middle[:q, None] * y_w)
    A, B, C, D = plant.A, plant.B, plant.C, plant.D
    whole = Plant.without_inputs(
        A + B @ u_x,
        np.hstack([B @ u_p, plant.Bw + B @ u_w]),
        np.vstack([y_x[of_y], asked_x[of_u], C + D @ u_x]),
        np.block([[y_p[of_y], y_w[of_y]], [asked_p[of_u], asked_w[of_u]], [D @ u_p, plant.Dw + D @ u_w]]),
    )
    return CutLoop(whole, len(box.uncertain))


def without_performance(loop: CutLoop) -> CutLoop:
    """Returns the loop from p to q alone, which decides stability."""
    M, k = loop.system, loop.errors
    return CutLoop(Plant.without_inputs(M.A, M.Bw[:, :k], M.C[:k], M.Dw[:k, :k]), k)


@dataclass(frozen=True, eq=False)
class MultiplierForm:
    """The Hermitian form of a loop for one choice of multipliers.

    Attributes:
        loop: the loop.
        D, G: diagonals, shapes (k,).
        square: gamma^2; no matter without w and z.
    """

    loop: CutLoop
    D: Array
    G: Array
    square: float

    @property
    def weights(self) -> tuple[Array, Array, Array]:
        """Returns W, L and R of the form [T; I]* [W, L; L*, R] [T; I]: diagonals of W and R, and L, shape (k + d, k + r)."""
        (rows, columns), k = self.loop.system.Dw.shape, self.loop.errors
        L = np.zeros((rows, columns), dtype=complex)
        L[np.arange(k), np.arange(k)] = -1j * self.G
        unused = 1 - EXACT
        return np.append(self.D, np.ones(rows - k)), L, -unused * np.append(self.D, np.full(columns - k, self.square))

    def at(self, T: Array) -> Array:
        """Returns the largest eigenvalue for each of some frequency responses, shape (F,) for (F, k + d, k + r)."""
        W, L, R = self.weights
        adjoint = T.conj().swapaxes(-1, -2)
        across = adjoint @ L
        M = adjoint @ (W[:, None] * T) + across + across.conj().swapaxes(-1, -2) + np.diag(R)
        size = 1 / np.sqrt(-R)
        return np.linalg.eigvalsh(size[:, None] * M * size)[:, -1]

    def singular(self) -> Array:
        """Returns the frequencies at which the form may be singular [rad/s], and others, ascending.

        They are the eigenvalues of a Hamiltonian matrix; all their imaginary parts are taken, on the axis or not.
        """
        M = self.loop.system
        A, B, C, D = M.A, M.Bw, M.C, M.Dw
        W, L, R = self.weights
        rest = W[:, None] * D + L
        into = D.T @ (W[:, None] * C) + L.conj().T @ C
        closing = np.linalg.solve(D.T @ rest + L.conj().T @ D + np.diag(R), np.hstack([into, B.T]))
        n = len(A)
        H = np.zeros((2 * n, 2 * n), dtype=complex)
        H[:n, :n], H[n:, :n], H[n:, n:] = A, -C.T @ (W[:, None] * C), -A.T
        H -= np.vstack([B, -C.T @ rest]) @ closing
        omega = np.linalg.eigvals(H).imag
        return np.unique(omega[omega > 0])

    def negative(self, low: float, high: float) -> bool:
        """Returns True if the form is negative in an interval of frequencies [rad/s], its lower end included.

        Between two frequencies at which it may be singular it is negative everywhere or nowhere.
        """
        singular = self.singular()
        inside = singular[(singular > low) & (singular < high)]
        last = 2 * max(low, float(inside.max(initial=0.0)), float(np.abs(np.linalg.eigvals(self.loop.system.A)).max()))
        ends = np.concatenate([[low], inside, [high if np.isfinite(high) else last]])
        tried = np.concatenate([ends[:1], (ends[:-1] + ends[1:]) / 2])
        responses = self.loop.responses(tried)
        if np.isinf(high):
            responses = np.concatenate([responses, self.loop.system.Dw[None].astype(complex)])
        return bool(np.all(self.at(responses) < 0))

    def reach(self, omega: float) -> float:
        """Returns the end of the interval above a frequency in which the form is negative [rad/s]."""
        above = self.singular()
        above = above[above > omega]
        for i, end in enumerate(above):
            following = (end + above[i + 1]) / 2 if i + 1 < len(above) else 2 * end
            if not self.at(self.loop.responses(np.array([following])))[0] < 0:
                return float(end)
        return np.inf if self.at(self.loop.system.Dw[None].astype(complex))[0] < 0 else omega


class MultiplierInterval(NamedTuple):
    """An interval of frequencies [rad/s] with its multipliers, shapes (k,)."""

    low: float
    high: float
    D: Array
    G: Array


@dataclass(frozen=True, eq=False)
class MultiplierProof:
    """A proof for all loops of a box, by intervals that fill a band.

    Attributes:
        low, high: the band [rad/s].
        parts: the intervals, ascending.
        gamma: the bound on the norm in the band; infinite for stability alone.
    """

    low: float
    high: float
    parts: tuple[MultiplierInterval, ...]
    gamma: float

    def holds(self, gain: ScaledGain, box: Box) -> bool:
        """Returns True if the parts prove the bound for all loops of a box, stable or not; or else their stability."""
        ends = [self.low, *(part.high for part in self.parts)]
        if not self.parts or any(part.low > end for part, end in zip(self.parts, ends, strict=False)) or ends[-1] < self.high:
            return False
        if not gain.well_posed(box) or any(not np.all(part.D > 0) for part in self.parts):
            return False
        loop = cut_loop(gain, box)
        if np.isinf(self.gamma):
            loop = without_performance(loop)
            if (self.low, self.high) != (0.0, np.inf) or not is_stable(loop.system.A):
                return False
        return all(MultiplierForm(loop, part.D, part.G, self.gamma**2).negative(part.low, part.high) for part in self.parts)


def stable_with_errors(plant: Plant, K: Array | LinearLaw, d: Array, e: Array) -> bool:
    """Returns True if the loop is proved stable for all errors, by either proof; arguments as for `worst_norm`."""
    gain = scaled_gain(replace(plant, Dyw=None), K)
    return all_stable(gain, box_of(gain, d, e))


def all_stable(gain: ScaledGain, box: Box) -> bool:
    """Returns True if all loops of a box are proved stable, by multipliers or by a matrix that moves with the errors."""
    return stable_in_box(gain, box) is not None or stable_throughout(gain, box) is not None


def bound_in_band(gain: ScaledGain, box: Box, low: float, high: float, found: float) -> MultiplierProof | None:
    """Returns the proof of about the least bound on a norm in a band for a whole box, or None if none is found.

    The bound does not imply stability.

    Args:
        gain: loops of the gain, in continuous time, the middle one stable.
        low, high: the band [rad/s]; `high` may be infinite.
        found: the largest norm found, from which the search begins.
    """
    if not 0 < found < np.inf or not len(box.uncertain) or not gain.well_posed(box):
        return None
    search, parts, gamma = _Search(cut_loop(gain, box), found), list[MultiplierInterval](), found * (1 + NEAR)
    for _ in range(MOST_PEAKS):
        try:
            higher = search.cover(parts, low, high, gamma)
        except np.linalg.LinAlgError:  # rounding leaves no answer
            return None
        if higher is None:
            proof = MultiplierProof(low, high, tuple(parts), gamma)
            return proof if proof.holds(gain, box) else None
        if not higher < np.inf:
            return None
        gamma = max(higher, gamma) * (1 + NEAR)
    return None


def stable_in_box(gain: ScaledGain, box: Box) -> MultiplierProof | None:
    """Returns a proof that all loops of a box are stable, or None if none is found."""
    if not len(box.uncertain) or not gain.well_posed(box):
        return None
    tried = box.vertices if len(box.uncertain) <= MOST else box.middle
    if not np.all(np.linalg.eigvals(gain.loops(tried).A).real < 0):
        return None
    parts = list[MultiplierInterval]()
    try:
        if _Search(without_performance(cut_loop(gain, box)), 1.0).cover(parts, 0.0, np.inf, np.inf) is not None:
            return None
    except np.linalg.LinAlgError:  # rounding leaves no answer
        return None
    proof = MultiplierProof(0.0, np.inf, tuple(parts), np.inf)
    return proof if proof.holds(gain, box) else None


class _Search:
    """The search for multipliers of a loop."""

    def __init__(self, loop: CutLoop, unit: float) -> None:
        self.loop, self.unit = loop, unit
        self.fastest = float(np.abs(np.linalg.eigvals(loop.system.A)).max())

    def cover(self, parts: list[MultiplierInterval], low: float, high: float, gamma: float) -> float | None:
        """Adds intervals that prove a bound, to those that prove a lower one, until they fill a band, and returns None.

        At a frequency where the least bound is higher, it returns that; without any, or beyond so many intervals, infinity.
        """
        here = parts[-1].high if parts else low
        step = max(here, low, self.fastest / 100) / 4
        while len(parts) < MOST_PARTS:
            if here >= high:
                return None
            ahead = min(here + step, high)
            for at in (ahead, (here + ahead) / 2, here + (ahead - here) / 8, here):
                least, D, G = self.multipliers(at, gamma)
                if D is None or G is None:
                    return least
                form = MultiplierForm(self.loop, D, G, gamma**2)
                if at == here or form.negative(here, at):
                    break
            end = min(form.reach(at), high)
            if not end > here * (1 + SHORTEST):
                return np.inf
            parts.append(MultiplierInterval(here, end, D, G))
            here, step = end, 2 * max(at - here, (end - here) / 2) if np.isfinite(end) else 1.0
        return np.inf

    def multipliers(self, omega: float, gamma: float) -> tuple[float, Array | None, Array | None]:
        """Returns D and G in the middle of those that prove a bound at a frequency; or else the least bound, and None twice."""
        T = self.loop.responses(np.array([omega]))[0]
        k = self.loop.errors
        start = k if np.isfinite(gamma) else 0  # without w and z the errors alone decide
        T[k:] /= self.unit
        into, seen = np.linalg.norm(T[start:, :k], axis=0), np.linalg.norm(T[:k, start:], axis=1)
        size = np.sqrt(np.where((into > 0) & (seen > 0), into / np.where(seen > 0, seen, 1.0), 1.0))
        T[:k] *= size[:, None]
        T[:, :k] /= size
        least, D, G = _multipliers(T, k, (gamma / self.unit) ** 2)
        if D is None or G is None:
            return self.unit * least**0.5, None, None
        of_both = (self.unit * size) ** 2
        return self.unit * least**0.5, of_both * D, of_both * G


def _multipliers(T: Array, k: int, square: float) -> tuple[float, Array | None, Array | None]:
    """Returns a gamma^2 that is proved of a response, and D and G in the middle of those that prove a given one.

    If the given one is too low, it is the least one, infinite without any, and D and G are None.
    """
    columns = T.shape[1]
    N = 2 * k + 1
    F = np.zeros((N, columns, columns), dtype=complex)  # of -M
    for i in range(k):
        F[i] = -np.outer(T[i].conj(), T[i])
        F[i, i, i] += 1
        row = np.zeros((columns, columns), dtype=complex)
        row[i] = -1j * T[i]
        F[k + i] = row + row.conj().T
    F0 = -T[k:].conj().T @ T[k:]
    limits = np.zeros((N, 4 * k, 4 * k))
    for i in range(k):
        limits[i, i, i], limits[i, k + i, k + i] = 1, -1
        limits[k + i, 2 * k + i, 2 * k + i], limits[k + i, 3 * k + i, 3 * k + i] = 1, -1
    bounds = np.diag(np.repeat([0.0, LARGEST, LARGEST, LARGEST], k))
    # First without w and z.
    own = F[:, :k, :k].copy()
    own[-1] = np.eye(k)
    p = np.append(np.ones(k), np.zeros(k + 1))
    p[-1] = 1.0 + max(0.0, -float(np.linalg.eigvalsh(np.tensordot(p, own, 1))[0]))
    p = _along(Barrier([(np.zeros((2 * k, 2 * k)), _real(own)), (bounds, limits)]), p, lambda p: p[-1] < 0)
    if not p[-1] < 0:
        return np.inf, None, None
    if np.isinf(square):
        return np.inf, p[:k], p[k : 2 * k]
    of_w = np.arange(k, columns)
    F[-1, of_w, of_w] = 1
    p[-1] = 0.0
    M = F0 + np.tensordot(p, F, 1)
    inner = np.linalg.solve(M[:k, :k], M[:k, k:])
    p[-1] = 1.0 + 2 * max(0.0, -float(np.linalg.eigvalsh(M[k:, k:] - M[k:, :k] @ inner)[0]))
    blocks = [(_real(F0[None])[0], _real(F)), (bounds, limits)]
    p = _along(Barrier(blocks), p, lambda p: p[-1] < ENOUGH * square, square)
    if not p[-1] < square:
        return float(p[-1]), None, None
    last = np.zeros((N, 1, 1))
    last[-1] = -1
    p, _, _ = newton(Barrier([*blocks, (np.array([[square]]), last)]), p, np.zeros(N), CLOSE)
    return float(p[-1]), p[:k], p[k : 2 * k]


def _along(barrier: Barrier, p: Array, leave: Callable[[Array], bool], floor: float = 0.0) -> Array:
    """Returns the point at which the last unknown is least, on the central path, or one at which to leave the path."""
    c, weight = np.zeros(len(p)), 1.0 / max(p[-1] - floor, 1e-3)
    for _ in range(CENTRES):
        c[-1] = weight
        p, _, _ = newton(barrier, p, c, CLOSE, leave)
        if leave(p):
            break
        weight *= FASTER
    return p


def _real(M: Array) -> Array:
    """Returns the real symmetric matrices that are positive definite if and only if Hermitian ones are, shape (..., 2 k, 2 k)."""
    real, imaginary = np.real(M), np.imag(M)
    upper, lower = (np.concatenate(pair, axis=-1) for pair in ((real, -imaginary), (imaginary, real)))
    return np.concatenate([upper, lower], axis=-2)
