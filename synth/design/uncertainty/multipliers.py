"""Bounds for all loops in a box of constant gain errors, proved by multipliers that are constant over intervals of frequency.

A loop with gain errors is opened at the errors, where p_k = delta_k q_k with real delta_k and |delta_k| <= 1. The opened loop
is one plant from [p; w] to [q; z]. For any diagonal matrices D >= 0 and G, the errors satisfy

    q* D q - p* D p >= 0,    j (p* G q - q* G p) = 0.

At a given frequency, the norm from w to z is therefore at most gamma if, for all p and w,

    |z|^2 - gamma^2 |w|^2 + q* D q - p* D p + j (p* G q - q* G p)  <=  0

(Fan, Tits, Doyle 1991, Robustness in the presence of mixed parametric uncertainty and unmodeled dynamics, IEEE Transactions on
Automatic Control 36). If the left side, without w and z, is negative at all frequencies, no errors in the box move a pole
across the imaginary axis. If the loop is then stable for the middle of the box, the loop is stable for the whole box.

The proof divides the frequencies into intervals with constant D and G. Frequencies at which the form is singular show whether
the form is negative in the whole interval, as in `structured_bound.py`. The proof needs no grid of frequencies and does not
depend on how the multipliers were found. The number of optimisation variables grows with the number of errors, not with the
number of corners of the box. Multipliers give tight bounds for constant errors. In contrast, a common X for all corners
(`worst_case.py`) is also valid for errors that vary with time.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, NamedTuple

import numpy as np

from models.common.arrays import Array
from synth.analysis.stability import is_stable
from synth.analysis.uncertainty_box import MOST, Box, ScaledGain
from synth.design.uncertainty.structured_loop import StructuredLoop
from synth.lmi.barrier import Barrier, Block, newton
from synth.lmi.least_unknown import LOOSE_DECREMENT, lowest_last
from synth.plant.generalized import Plant

NEAR = 3e-4  # relative gap between the proved bound and the peak that the best multipliers give
EXACT = 1e-6  # share of p* D p and of gamma^2 that is kept as a margin for rounding
CLOSE = 1e-5  # relative accuracy with which the smallest gamma^2 at one frequency is computed
LARGEST = 1e6  # limit on the entries of D and G, after p, q and z have been scaled to size one
MOST_PARTS, MOST_PEAKS = 100, 40
SHORTEST = 1e-4  # length of the shortest frequency interval, relative to the lowest frequency in the interval
# the search for the smallest gamma^2 at a frequency ends as soon as gamma^2 is below this multiple of the given gamma^2
ENOUGH = 0.9997


def cut_loop(gain: ScaledGain, box: Box) -> StructuredLoop:
    """Returns the loop at the middle of a box, opened at the errors of the box.

    Raises:
        LinAlgError: the loop at the middle of the box is not well-posed.
    """
    plant, K, q, m = gain.plant, gain.K, gain.K.shape[1], len(gain.K)
    middle, half = box.middle, (box.high - box.low) / 2
    of_y, of_u = box.uncertain[box.uncertain < q], box.uncertain[box.uncertain >= q] - q
    # The loop is u = S K (S y + H_y p_y) + H_u p_u - K0 y with y = C_y x + Dyw w + Dyu u.
    acting = gain.acting(middle)
    closing = np.linalg.inv(gain.return_difference(gain.scaled(middle)))
    into_y = half[of_y] * np.eye(q)[:, of_y]
    u_x, u_w = acting @ plant.Cy, acting @ plant.Dyw
    u_p = closing @ np.hstack([middle[q:, None] * K @ into_y, half[q:][of_u] * np.eye(m)[:, of_u]])
    y_x, y_p, y_w = plant.Cy + plant.Dyu @ u_x, plant.Dyu @ u_p, plant.Dyw + plant.Dyu @ u_w
    law_p = K @ (middle[:q, None] * y_p + np.hstack([into_y, np.zeros((q, len(of_u)))]))
    law_x, law_w = K @ (middle[:q, None] * y_x), K @ (middle[:q, None] * y_w)
    A, B, C, D = plant.A, plant.B, plant.C, plant.D
    loop = Plant.without_inputs(
        A + B @ u_x,
        np.hstack([plant.Bw + B @ u_w, B @ u_p]),
        np.vstack([C + D @ u_x, y_x[of_y], law_x[of_u]]),
        np.block([[plant.Dw + D @ u_w, D @ u_p], [y_w[of_y], y_p[of_y]], [law_w[of_u], law_p[of_u]]]),
    )
    return StructuredLoop(loop, len(box.uncertain))


@dataclass(frozen=True, eq=False)
class MultiplierForm:
    """Hermitian form in p and w that must be negative to prove a bound for a loop, for one choice of multipliers.

    Attributes:
        loop: closed loop, opened at its k gain errors.
        D, G: diagonals of the multiplier matrices D and G, shapes (k,).
        square: gamma^2, for the bound gamma on the norm; not used if the loop has neither w nor z.
        of_errors: 1 / |delta|^2, where |delta| is the largest size of an error for which the bound is proved.
    """

    loop: StructuredLoop
    D: Array
    G: Array
    square: float
    of_errors: float = 1.0

    @property
    def weights(self) -> tuple[Array, Array, Array]:
        """Weights in the form [T; I]* [W, L; L*, R] [T; I]: the diagonals of W and R, and L of shape (d + k, r + k)."""
        (rows, columns), k = self.loop.loop.Dw.shape, self.loop.errors
        L = np.zeros((rows, columns), dtype=complex if np.any(self.G) else float)
        L[np.arange(rows - k, rows), np.arange(columns - k, columns)] = -1j * self.G if np.any(self.G) else 0.0
        return (
            np.append(np.ones(rows - k), self.D),
            L,
            (EXACT - 1) * np.append(np.full(columns - k, self.square), self.of_errors * self.D),
        )

    def at(self, T: Array) -> Array:
        """Returns the largest eigenvalue of the form, shape (F,), for each frequency response in T, shape (F, d + k, r + k)."""
        W, L, R = self.weights
        adjoint = T.conj().swapaxes(-1, -2)
        across = adjoint @ L
        M = adjoint @ (W[:, None] * T) + across + across.conj().swapaxes(-1, -2) + np.diag(R)
        size = 1 / np.sqrt(-R)
        return np.linalg.eigvalsh(size[:, None] * M * size)[:, -1]

    def singular(self) -> Array:
        """Returns all frequencies at which the form is singular [rad/s], in ascending order, and possibly other frequencies.

        The frequencies are imaginary parts of eigenvalues of a Hamiltonian matrix, including eigenvalues off the imaginary axis.
        """
        M = self.loop.loop
        A, B, C, D = M.A, M.Bw, M.C, M.Dw
        W, L, R = self.weights
        rest = W[:, None] * D + L
        into = D.T @ (W[:, None] * C) + L.conj().T @ C
        closing = np.linalg.solve(D.T @ rest + L.conj().T @ D + np.diag(R), np.hstack([into, B.T]))
        n = len(A)
        H = np.zeros((2 * n, 2 * n), dtype=L.dtype)
        H[:n, :n], H[n:, :n], H[n:, n:] = A, -C.T @ (W[:, None] * C), -A.T
        H -= np.vstack([B, -C.T @ rest]) @ closing
        omega = np.linalg.eigvals(H).imag
        return np.unique(omega[omega > 0])

    def negative(self, low: float, high: float) -> bool:
        """Returns True if the form is negative in an interval of frequencies [rad/s], including the lower end.

        Between two neighbouring singular frequencies, the form is negative either at all frequencies or at none.
        """
        singular = self.singular()
        inside = singular[(singular > low) & (singular < high)]
        last = 2 * max(low, float(inside.max(initial=0.0)), float(np.abs(np.linalg.eigvals(self.loop.loop.A)).max()))
        ends = np.concatenate([[low], inside, [high if np.isfinite(high) else last]])
        responses = self.loop.at(np.concatenate([ends[:1], (ends[:-1] + ends[1:]) / 2]))
        if np.isinf(high):
            responses = np.concatenate([responses, self.loop.loop.Dw[None].astype(complex)])
        return bool(np.all(self.at(responses) < 0))

    def reach(self, omega: float) -> float:
        """Returns the upper end of the interval that begins at a given frequency and in which the form is negative [rad/s]."""
        above = self.singular()
        above = above[above > omega]
        for i, end in enumerate(above):
            following = (end + above[i + 1]) / 2 if i + 1 < len(above) else 2 * end
            if not self.at(self.loop.at(np.array([following])))[0] < 0:
                return float(end)
        return np.inf if self.at(self.loop.loop.Dw[None].astype(complex))[0] < 0 else omega


class MultiplierInterval(NamedTuple):
    """Interval of frequencies [rad/s], and the diagonals of its multipliers, shapes (k,)."""

    low: float
    high: float
    D: Array
    G: Array


def fill(parts: Sequence[MultiplierInterval], low: float, high: float) -> bool:
    """Returns True if the intervals cover a frequency band without gaps."""
    ends = [low, *(part.high for part in parts)]
    return bool(parts) and not any(part.low > end for part, end in zip(parts, ends, strict=False)) and ends[-1] >= high


@dataclass(frozen=True, eq=False)
class MultiplierProof:
    """Proof of a bound for all loops of a box, by multipliers for intervals that cover a frequency band.

    If the band contains all frequencies, the proof includes stability.

    Attributes:
        low, high: lower and upper end of the band [rad/s].
        parts: intervals with their multipliers, ascending.
        bound: proved bound on the norm in the band; infinite if only stability is proved.
    """

    kind: ClassVar[str] = "multipliers, computed twice"

    low: float
    high: float
    parts: tuple[MultiplierInterval, ...]
    bound: float

    def holds(self, gain: ScaledGain, box: Box) -> bool:
        """Verifies the proof for a box. Returns True if the intervals prove the bound or, for an infinite bound, stability."""
        whole = (self.low, self.high) == (0.0, np.inf)
        if (
            not fill(self.parts, self.low, self.high)
            or not gain.well_posed(box)
            or any(not np.all(part.D > 0) for part in self.parts)
        ):
            return False
        loop = cut_loop(gain, box)
        if (whole and not is_stable(loop.loop.A)) or (np.isinf(self.bound) and not whole):
            return False
        loop = loop.of_errors if np.isinf(self.bound) else loop
        return all(MultiplierForm(loop, part.D, part.G, self.bound**2).negative(part.low, part.high) for part in self.parts)


def bound_in_band(
    gain: ScaledGain, box: Box, low: float, high: float, first: float, tries: int = MOST_PEAKS
) -> MultiplierProof | None:
    """Returns a proof of a bound for a whole box of errors, close to the largest norm in a band; None if no proof is found.

    A bound for only some frequencies does not imply stability.

    Args:
        gain: loops with factors on measurements and forces, in continuous time; the loop at the middle of the box is stable.
        low, high: lower and upper end of the band [rad/s]; `high` may be infinite.
        first: first bound to try, just above the largest norm that was found.
        tries: number of bounds that are tried.
    """
    if not 0 < first < np.inf or not len(box.uncertain) or not gain.well_posed(box):
        return None
    search, parts, gamma = _Search(cut_loop(gain, box), first), list[MultiplierInterval](), first
    for _ in range(tries):
        try:
            higher = search.cover(parts, low, high, gamma)
        except np.linalg.LinAlgError:  # rounding prevents the solution
            return None
        if higher is None:
            proof = MultiplierProof(low, high, tuple(parts), gamma)
            return proof if proof.holds(gain, box) else None
        if not higher < np.inf:
            return None
        gamma = max(higher, gamma) * (1 + NEAR)
    return None


def stable_in_box(gain: ScaledGain, box: Box) -> MultiplierProof | None:
    """Returns a proof that the loop is stable for all errors in a box; None if no proof is found."""
    if not len(box.uncertain) or not gain.well_posed(box):
        return None
    if not gain.stable(box.vertices if len(box.uncertain) <= MOST else box.middle):
        return None
    parts = list[MultiplierInterval]()
    try:
        if _Search(cut_loop(gain, box).of_errors, 1.0).cover(parts, 0.0, np.inf, np.inf) is not None:
            return None
    except np.linalg.LinAlgError:  # rounding prevents the solution
        return None
    proof = MultiplierProof(0.0, np.inf, tuple(parts), np.inf)
    return proof if proof.holds(gain, box) else None


def cover(
    parts: list[MultiplierInterval],
    band: tuple[float, float],
    step: float,
    multipliers: Callable[[float], tuple[float, Array | None]],
    form: Callable[[Array], MultiplierForm],
    most: int = MOST_PARTS,
) -> tuple[float, float] | None:
    """Adds intervals in which a bound is proved, until the intervals cover a frequency band. Returns None if the band is
    covered.

    If the band is not covered, returns the smallest provable bound and the frequency where the proof fails. The bound is
    infinite if no bound can be proved, or if more than `most` intervals are needed.

    Args:
        parts: intervals that were found for a smaller bound, in ascending order from the lower end of the band.
        band: lower and upper end of the band [rad/s].
        step: length of the first interval that is tried [rad/s].
        multipliers: function that returns the smallest provable bound at a frequency and, if this bound is low enough, [D, G].
        form: function that returns the Hermitian form for the multipliers [D, G]; this form must be negative.
        most: largest number of intervals.
    """
    low, high = band
    here = parts[-1].high if parts else low
    while len(parts) < most:
        if here >= high:
            return None
        ahead = min(here + step, high)
        for at in (ahead, (here + ahead) / 2, here + (ahead - here) / 8, here):
            least, found = multipliers(at)
            if found is None:
                return least, at
            if at == here or form(found).negative(here, at):
                break
        end = min(form(found).reach(at), high)
        if not end > here * (1 + SHORTEST):
            return np.inf, here
        parts.append(MultiplierInterval(here, end, *np.split(found, 2)))
        here, step = end, 2 * max(at - here, (end - here) / 2) if np.isfinite(end) else 1.0
    return np.inf, here


class _Search:
    """Search for the multipliers of a loop."""

    def __init__(self, loop: StructuredLoop, unit: float) -> None:
        self.loop, self.unit = loop, unit
        self.last: Array | None = None
        self.fastest = float(np.abs(np.linalg.eigvals(loop.loop.A)).max())

    def cover(self, parts: list[MultiplierInterval], low: float, high: float, gamma: float) -> float | None:
        """Adds intervals in which a bound is proved; see the function `cover`.

        Returns None if the band is covered, otherwise the smallest provable bound.
        """
        step = max(parts[-1].high if parts else low, low, self.fastest / 100) / 4
        higher = cover(parts, (low, high), step, partial(self.multipliers, gamma=gamma), partial(self.form, gamma=gamma))
        return None if higher is None else higher[0]

    def form(self, found: Array, gamma: float) -> MultiplierForm:
        """Returns the Hermitian form for the multipliers [D, G]."""
        D, G = np.split(found, 2)
        return MultiplierForm(self.loop, D, G, gamma**2)

    def multipliers(self, omega: float, gamma: float) -> tuple[float, Array | None]:
        """Returns a bound at a frequency, and central multipliers [D, G] that prove a given bound; see `_multipliers`."""
        T, k = self.loop.at(np.array([omega]))[0], self.loop.errors
        d, r = (size - k for size in T.shape)
        T[:d] /= self.unit
        # without w and z, the gain errors alone determine the scales
        of_z, of_w = (slice(d), slice(r)) if self.loop.performance else (slice(None), slice(None))
        into, seen = np.linalg.norm(T[of_z, r:], axis=0), np.linalg.norm(T[d:, of_w], axis=1)
        size = np.sqrt(np.where((into > 0) & (seen > 0), into / np.where(seen > 0, seen, 1.0), 1.0))
        T[d:] *= size[:, None]
        T[:, r:] /= size
        of_both, square = np.tile((self.unit * size) ** 2, 2), (gamma / self.unit) ** 2
        try:
            least, found = _multipliers(T, k, square, None if self.last is None else self.last / of_both)
        except np.linalg.LinAlgError:  # the multipliers of the previous frequency are a poor starting point
            least, found = _multipliers(T, k, square, None)
        if found is None:
            return self.unit * least**0.5, None
        self.last = of_both * found
        return self.unit * least**0.5, self.last


def _multipliers(T: Array, k: int, square: float, start: Array | None) -> tuple[float, Array | None]:
    """Returns a provable gamma^2 for a frequency response, and central multipliers [D, G] for a given gamma^2, shape (2 k,).

    If the given gamma^2 is too low for this response, the result is the smallest provable gamma^2, and None for D and G. The
    smallest provable gamma^2 is infinite if nothing can be proved.

    Args:
        start: [D, G] of a similar frequency response; None if unknown.
    """
    d, r = (size - k for size in T.shape)
    N = 2 * k + 1
    F = np.zeros((N, r + k, r + k), dtype=complex)  # coefficients of the matrix -M
    for i in range(k):
        F[i] = -np.outer(T[d + i].conj(), T[d + i])
        F[i, r + i, r + i] += 1
        row = np.zeros((r + k, r + k), dtype=complex)
        row[r + i] = -1j * T[d + i]
        F[k + i] = row + row.conj().T
    F0 = -T[:d].conj().T @ T[:d]
    one, each = np.ones((1, 1)), np.eye(N)[:, :, None, None]
    bounds = [(0 * one, each[i]) for i in range(k)]  # limits on the entries of D and G
    bounds += [(LARGEST * one, sign * each[i]) for i in range(2 * k) for sign in ((-1, 1) if i >= k else (-1,))]
    # The first problem omits w and z, so that only the gain errors matter.
    own = F[:, r:, r:].copy()
    own[-1] = np.eye(k)

    def above(DG: Array) -> float:
        return -float(np.linalg.eigvalsh(np.tensordot(DG, own[:-1], 1))[0])

    p = np.append(np.zeros(2 * k) if start is None else start, 0.0)
    if start is None or not above(start) < 0 or not np.abs(start).max() < LARGEST / 2:
        p[: 2 * k] = np.repeat([1.0, 0.0], k)
        p[-1] = 1.0 + max(0.0, above(p[:-1]))
        p = _lowest([(np.zeros((2 * k, 2 * k)), _real(own)), *bounds], p, 0.0)
        if not p[-1] < 0:
            return np.inf, None
    if np.isinf(square):
        return np.inf, p[:-1]
    of_w = np.arange(r)
    F[-1, of_w, of_w] = 1
    p[-1] = 0.0
    M = F0 + np.tensordot(p, F, 1)
    inner = np.linalg.solve(M[r:, r:], M[r:, :r])
    p[-1] = square + 2 * max(0.0, -float(np.linalg.eigvalsh(M[:r, :r] - M[:r, r:] @ inner)[0]))
    blocks = [(_real(F0[None])[0], _real(F)), *bounds]
    p = _lowest(blocks, p, ENOUGH * square, CLOSE * square)
    if not p[-1] < square:
        return float(p[-1]), None
    last = np.zeros((N, 1, 1))
    last[-1] = -1
    p, _, _ = newton(Barrier([*blocks, (np.array([[square]]), last)]), p, np.zeros(N), LOOSE_DECREMENT)
    return float(p[-1]), p[:-1]


def _lowest(blocks: Sequence[Block], p: Array, enough: float, close: float = np.inf) -> Array:
    return lowest_last(Barrier(blocks), p, sum(len(F0) for F0, _ in blocks), enough, close)


def _real(M: Array) -> Array:
    """Returns real symmetric matrices, shape (..., 2 k, 2 k), which are positive definite if the Hermitian matrices M are."""
    real, imaginary = np.real(M), np.imag(M)
    upper, lower = (np.concatenate(pair, axis=-1) for pair in ((real, -imaginary), (imaginary, real)))
    return np.concatenate([upper, lower], axis=-2)
