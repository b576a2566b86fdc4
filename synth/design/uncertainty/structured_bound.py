"""Upper bound on the structured singular value mu of a loop at all frequencies, found with scales and proved with level sets.

The uncertainty Delta of the loop M includes a full block from z to w for performance. For any positive scales D of the errors,
mu(M) is at most the largest singular value of D M D^-1 (Doyle 1982; Packard, Doyle 1993, The complex structured singular value,
Automatica 29). A loop stays stable for all errors smaller than 1 / mu. With the performance block, mu <= gamma also means that
the norm from w to z is at most gamma for all errors of size 1 / gamma.

The proof is as in `multipliers.py`, for errors of size 1 / gamma. In the proof, D contains the squares of the scales, and G is
0 because errors that depend on frequency have a phase. If no scales give |D M D^-1| < gamma at some frequency, gamma is too
low, and a higher peak is near this frequency.

The largest singular value is a convex function of the logarithms of the scales. The Schatten norm of the matrix is also convex,
and it is smooth. As the exponent of the Schatten norm grows, this norm tends to the largest singular value.
"""

from dataclasses import dataclass

import numpy as np
from scipy import optimize

from models.common.arrays import Array
from synth.analysis.norm import Gain, largest_singular_values
from synth.analysis.stability import is_stable
from synth.design.uncertainty.multipliers import MultiplierForm, MultiplierInterval, cover, fill
from synth.design.uncertainty.structured_loop import StructuredLoop

NEAR = 5e-4  # relative gap between the bound and the peak that the best scales give
# relative gap between the proved bound and the level that the search has found; exactly at this level, no proof is possible
EXACT = 1e-6
POWERS = (64, 4096)  # exponents of the Schatten norms, which are used one after the other
# a Schatten norm counts as equal to the largest singular value if the share of the other singular values is smaller than this
ALONE = 1e-6
FURTHEST = 16.0  # limit on the logarithm of a scale, in the internal units of the loop
EASY = 0.9  # scales with a value below this multiple of the level are not improved further
MOST_STEPS = 60  # largest number of evaluations for each Schatten norm
CLOSE = 1e-7  # accuracy of the logarithm of a scale
REFINED_PEAKS = 4  # the search for the highest peak of the bound starts at this many of the highest gain peaks of the loop
# largest and smallest step in the search for a peak, relative to the frequency; and smallest increase of the peak that counts,
# relative to the peak
WIDEST, NARROWEST, SAME = 0.1, 1e-4, 1e-7
SMALLEST = 1e-12  # smallest bound; it is used if the errors have no effect on the loop (mu = 0)
MOST_PARTS, MOST_PEAKS = 2000, 60


@dataclass(frozen=True, eq=False)
class StructuredBound:
    """Bound on the structured singular value at all frequencies, with its proof.

    Attributes:
        gamma: proved bound; infinite if the loop without errors is not stable.
        peak_frequency: frequency at which the bound has its maximum, for the best scales at each frequency [rad/s].
        parts: intervals that cover all frequencies from 0 to infinity, each with its scales.
    """

    gamma: float
    peak_frequency: float
    parts: tuple[MultiplierInterval, ...]

    def holds(self, structured: StructuredLoop) -> bool:
        """Returns True if the intervals with their scales prove the bound for a loop, which is checked by level sets."""
        if not fill(self.parts, 0.0, np.inf) or not is_stable(structured.loop.A):
            return False
        return all(_form(structured, self.gamma, part.D).negative(part.low, part.high) for part in self.parts)


def _form(structured: StructuredLoop, gamma: float, D: Array) -> MultiplierForm:
    """Returns the Hermitian form that is negative if the scales, whose squares are D, prove a bound."""
    return MultiplierForm(structured, D, np.zeros_like(D), gamma**2, gamma**2)


def structured_bound(structured: StructuredLoop) -> StructuredBound:
    """Returns a bound on the structured singular value of a loop, just above the peak that the best scales give."""
    if not is_stable(structured.loop.A):
        return StructuredBound(np.inf, np.nan, ())
    search = _Search(structured)
    peak, at = max((SMALLEST, 0.0), *(search.climb(omega) for omega in search.first))
    parts: list[MultiplierInterval] = []
    for _ in range(MOST_PEAKS):
        level = peak * (1 + NEAR)
        gamma = level * (1 + EXACT)

        def squares(omega: float, level: float = level) -> tuple[float, Array | None]:
            value, scales = search.scales(omega, EASY * level)
            return value, np.append(scales**2, np.zeros_like(scales)) if value < level else None

        def form(found: Array, gamma: float = gamma) -> MultiplierForm:
            return _form(structured, gamma, found[: structured.errors])

        step = parts[-1].high - parts[-1].low if parts else structured.grid[0]
        higher = cover(parts, (0.0, np.inf), step, squares, form, MOST_PARTS)
        if higher is None:
            return StructuredBound(gamma, at, tuple(parts))
        peak, at = max((level, at), search.climb(higher[1]))
    return StructuredBound(np.inf, at, ())


def best_scales(M: Array, errors: int, start: Array | None = None, enough: float = 0.0) -> tuple[float, Array]:
    """Returns the smallest norm |D M D^-1| over all scales D, and the logarithms of the best scales, shape (k,).

    Args:
        M: matrix, complex, shape (d + k, r + k).
        errors: number k of errors.
        start: logarithms of the scales with which the search begins. Default: zero.
        enough: value of |D M D^-1| below which the search ends early.
    """
    k = errors
    x = np.zeros(k) if start is None else np.clip(start, -FURTHEST, FURTHEST)
    first = int(len(M) == k)  # without a performance block, a common factor of all scales has no effect
    N, up, down = M.copy(), np.ones(len(M)), np.ones(M.shape[1])
    rows, columns = (slice(count - k + first, None) for count in M.shape)

    def scaled(y: Array) -> Array:
        up[rows], down[columns] = np.exp(y), np.exp(-y)
        return np.multiply(np.multiply(M, up[:, None], out=N), down, out=N)

    def size(y: Array) -> float:
        return float(largest_singular_values(scaled(y)[None])[0])

    def smooth(y: Array, power: int) -> tuple[float, Array]:
        U, sizes, V = np.linalg.svd(scaled(y), full_matrices=False)
        if not sizes[0]:
            return -1e3, np.zeros_like(y)
        shares = (sizes / sizes[0]) ** power
        total = shares.sum()
        slope = (np.abs(U[rows]) ** 2 - np.abs(V[:, columns].T) ** 2) @ (shares / total)
        return float(np.log(sizes[0]) + np.log(total) / power), slope

    y = x[first:] - x[:1] if first else x
    best = size(y), y
    if len(y) == 1 and best[0] > enough:
        y = np.atleast_1d(optimize.fminbound(lambda scale: size(np.array([scale])), -FURTHEST, FURTHEST, xtol=CLOSE, disp=0))
        best = min(best, (size(y), y), key=lambda one: one[0])
    for power in POWERS if len(y) > 1 else ():
        if best[0] <= enough:
            break
        limits = [(-FURTHEST, FURTHEST)] * len(y)
        y = optimize.minimize(smooth, y, (power,), jac=True, method="L-BFGS-B", bounds=limits, options={"maxfun": MOST_STEPS}).x
        best = min(best, (size(y), y), key=lambda one: one[0])
        sizes = np.linalg.svd(scaled(y), compute_uv=False)
        if np.sum((sizes[1:] / sizes[:1]) ** power) < ALONE:
            break
    return best[0], np.append(np.zeros(first), best[1])


class _Search:
    """Search for the scales of a loop, in internal units."""

    def __init__(self, structured: StructuredLoop) -> None:
        self.structured, self.units = structured, structured.units
        self.last = np.zeros(structured.errors)

    def scales(self, omega: float, enough: float = 0.0) -> tuple[float, Array]:
        """Returns the bound on mu that the best scales give at a frequency, and the best scales; see `best_scales`."""
        k = self.structured.errors
        M = self.structured.at(np.array([omega]))[0]
        M[-k:] *= self.units[:, None]
        M[:, -k:] /= self.units
        value, self.last = best_scales(M, k, self.last, enough)
        return value, self.units * np.exp(self.last)

    @property
    def first(self) -> list[float]:
        """Frequencies [rad/s] at which the search for the highest peak starts: 0, and the highest peaks on the grid."""
        grid = self.structured.grid
        gains = Gain(self.structured.scaled(self.units)).at(grid)
        inner = np.flatnonzero((gains[1:-1] >= gains[:-2]) & (gains[1:-1] >= gains[2:])) + 1
        return [0.0, *grid[inner[gains[inner].argsort()[-REFINED_PEAKS:]]].tolist()]

    def climb(self, omega: float) -> tuple[float, float]:
        """Returns a local peak of the bound on mu with the best scales, near a given frequency, and the frequency of the peak
        [rad/s].
        """
        best, width = (self.scales(omega)[0], omega), WIDEST
        while omega > 0 and width > NARROWEST:
            near = [best[1] * (1 - width), best[1] * (1 + width)]
            value, at = max((self.scales(one)[0], one) for one in near)
            if value > best[0] * (1 + SAME):
                best = value, at
            else:
                width /= 3
        return best
