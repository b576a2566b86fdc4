"""Upper bound on the structured singular value of a loop at all frequencies, found by scales and proved by level sets.

For errors Delta, a full block from z to w among them, mu(M) <= |D M D^-1| for any positive scales D of the errors (Doyle 1982;
Packard, Doyle 1993, The complex structured singular value, Automatica 29). Errors of size below 1 / mu leave a loop stable. With
the performance block, mu <= gamma also bounds the norm from w to z by gamma, for all errors of size 1 / gamma.

The proof divides the frequencies into intervals, each with constant scales. Within an interval the level sets of the scaled loop
show that no frequency exceeds gamma, as in `analysis/band_norm.py`. So nothing is sampled, and the search for scales is not
believed. With scales that are best at one frequency, an interval reaches to the next crossings of the level on either side; so
does the next one, from its end. Where no scales are below the level, the level is too low, and that frequency is a higher peak.

The largest singular value is convex in the logarithms of the scales. Its Schatten norm is smooth, likewise convex, and tends to
it.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import optimize

from models.common.arrays import Array
from synth.analysis.band_norm import exceeds
from synth.analysis.norm import Gain, largest_singular_values, level_crossings
from synth.analysis.stability import is_stable
from synth.design.uncertainty.structured_loop import StructuredLoop

NEAR = 5e-4  # relative; how far the bound lies above the best scales' peak
EXACT = 1e-6  # relative; what is proved lies this far above the level of the search, where intervals end
POWERS = (64, 4096)  # of Schatten norms, one after the other
ALONE = 1e-6  # share of the other singular values in a Schatten norm, which then is the largest one and has its minimum
FURTHEST = 16.0  # of the logarithm of a scale, from the loop's own units
AHEAD = 4  # frequencies tried ahead of an interval's end, before the end itself
EASY = 0.9  # of the level; scales below that are not bettered
MOST_STEPS = 60  # with one Schatten norm
CLOSE = 1e-7  # of the logarithm of a single scale
TRIED = 4  # peaks of the loop in its units that are climbed first
WIDEST, NARROWEST, SAME = 0.1, 1e-4, 1e-7  # relative; of steps in frequency to a peak, and of the rise that is worth one
SMALLEST = 1e-12  # bound; a loop that does not reach its errors has mu = 0
MOST_PARTS, MOST_PEAKS = 2000, 60


class Part(NamedTuple):
    """An interval of frequencies [rad/s] with its scales, shape (k,)."""

    low: float
    high: float
    scales: Array


@dataclass(frozen=True, eq=False)
class StructuredBound:
    """A bound on the structured singular value at all frequencies, with its proof.

    Attributes:
        gamma: the bound; infinite if the loop without errors is not stable.
        peak_frequency: frequency at which the best scales are highest [rad/s].
        parts: intervals from 0 to infinity, each with scales.
    """

    gamma: float
    peak_frequency: float
    parts: tuple[Part, ...]

    def holds(self, structured: StructuredLoop) -> bool:
        """Returns True if the parts prove the bound for a loop, by level sets of each."""
        ends = [0.0, *(part.high for part in self.parts)]
        if not self.parts or ends[-1] != np.inf or any(part.low > end for part, end in zip(self.parts, ends, strict=False)):
            return False
        if not is_stable(structured.loop.A):
            return False
        return not any(exceeds(Gain(structured.scaled(scales), low, high), self.gamma) for low, high, scales in self.parts)


def structured_bound(structured: StructuredLoop) -> StructuredBound:
    """Returns a bound on the structured singular value of a loop, next to the peak of the best scales."""
    if not is_stable(structured.loop.A):
        return StructuredBound(np.inf, np.nan, ())
    search = _Search(structured)
    peak, at = max((SMALLEST, 0.0), *(search.climb(omega) for omega in search.first))
    parts: list[Part] = []
    for _ in range(MOST_PEAKS):
        higher = search.cover(parts, peak * (1 + NEAR))
        if higher is None:
            return StructuredBound(peak * (1 + NEAR) * (1 + EXACT), at, tuple(parts))
        peak, at = max((peak * (1 + NEAR), at), search.climb(higher))
    return StructuredBound(np.inf, at, ())


def best_scales(M: Array, errors: int, start: Array | None = None, enough: float = 0.0) -> tuple[float, Array]:
    """Returns the least |D M D^-1| and the logarithms of its scales, shape (k,).

    Args:
        M: matrix, complex, shape (d + k, r + k).
        errors: k.
        start: logarithms of scales to begin with; zero by default.
        enough: scales below it need not be the best.
    """
    k = errors
    x = np.zeros(k) if start is None else np.clip(start, -FURTHEST, FURTHEST)
    first = int(len(M) == k)  # without a performance block a common factor of all scales does nothing
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
    """The search for scales of a loop, in its own units."""

    def __init__(self, structured: StructuredLoop) -> None:
        self.structured, self.units = structured, structured.units
        self.last = np.zeros(structured.errors)

    def scales(self, omega: float, enough: float = 0.0) -> tuple[float, Array]:
        """Returns the bound of the best scales at a frequency, and these scales; see `best_scales`."""
        k = self.structured.errors
        M = self.structured.at(np.array([omega]))[0]
        M[-k:] *= self.units[:, None]
        M[:, -k:] /= self.units
        value, self.last = best_scales(M, k, self.last, enough)
        return value, self.units * np.exp(self.last)

    @property
    def first(self) -> list[float]:
        """The frequencies of the grid where the loop in its units is highest [rad/s], local peaks and 0."""
        grid = self.structured.grid
        gains = Gain(self.structured.scaled(self.units)).at(grid)
        inner = np.flatnonzero((gains[1:-1] >= gains[:-2]) & (gains[1:-1] >= gains[2:])) + 1
        return [0.0, *grid[inner[gains[inner].argsort()[-TRIED:]]].tolist()]

    def climb(self, omega: float) -> tuple[float, float]:
        """Returns a local peak of the best scales near a frequency, and its frequency [rad/s]."""
        best, width = (self.scales(omega)[0], omega), WIDEST
        while omega > 0 and width > NARROWEST:
            near = [best[1] * (1 - width), best[1] * (1 + width)]
            value, at = max((self.scales(one)[0], one) for one in near)
            if value > best[0] * (1 + SAME):
                best = value, at
            else:
                width /= 3
        return best

    def cover(self, parts: list[Part], level: float) -> float | None:
        """Adds intervals that prove a level, to those that prove a lower one, until there are all. Returns None.

        Or it returns the frequency where no scales are below the level.
        """
        here = parts[-1].high if parts else 0.0
        step = here - parts[-1].low if parts else self.structured.grid[0]
        while len(parts) < MOST_PARTS:
            for k in range(AHEAD, -1, -1):
                c = here + step * (k / AHEAD) ** 2
                value, scales = self.scales(c, EASY * level)
                if value >= level:
                    return c
                low, high = _interval(Gain(self.structured.scaled(scales)), level, c)
                if low <= here < high:
                    break
            else:
                return here
            parts.append(Part(here, high, scales))
            if high == np.inf:
                return None
            here, step = high, max(high - here, 1e-9 * high)
        return here


def _interval(gain: Gain, level: float, omega: float) -> tuple[float, float]:
    """Returns the interval around a frequency within which the gain does not exceed a level [rad/s].

    The gain at the frequency is below the level. Between two crossings the gain lies above the level everywhere or nowhere.
    """
    crossings = level_crossings(gain.system, level)
    last = max(2 * crossings[-1], 2 * omega)
    ends = np.append(crossings, last)
    below = gain.at((ends[:-1] + ends[1:]) / 2) <= level
    below[-1] &= gain.at_infinity <= level
    i = int(np.searchsorted(crossings, omega, side="right")) - 1
    first = after = i
    while first > 0 and below[first - 1]:
        first -= 1
    while after + 1 < len(below) and below[after + 1]:
        after += 1
    unbounded = after + 1 == len(below) and gain.at_infinity <= level
    high = np.inf if unbounded else float(crossings[after + 1]) if after + 1 < len(below) else omega
    return float(crossings[first]), high
