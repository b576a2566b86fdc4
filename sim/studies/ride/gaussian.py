"""Statistics of a Gaussian signal of zero mean, stationary or repeating step by step, from its spectrum, over a window of time T.

Exact: mean squares, also of min(x, s), fourth powers, shares of time beyond a threshold, mean positive parts of products. With
a = s / sigma, phi and Q the normal density and tail,

    E min(x, s)^2 = sigma^2 (1 - Q(a) - a phi(a) + a^2 Q(a)).

Where the variance repeats, it is the mean of that over its steps. What follows is of the mean spectrum.

Asymptotic, for windows much longer than the signal's memory: the variance of a mean square. min(x, s)^2 is a sum of Hermite
polynomials of x / sigma; that of degree k, c_k, gives the mean over T the variance (2 / T) c_k^2 times the integral of rho^k, the
autocorrelation, from 0 on. Without the clip only c_2 is there and the variance is the integral of S^2 df / T.

Approximations: the largest magnitude has Vanmarcke's distribution for both barriers; E. H. Vanmarcke (1975), J. Appl. Mech. 42,
215-220. The running mean square, whose variance is exact, is taken to be a gamma variate that comes and goes as a Gaussian signal
of its own spectrum.
"""

import math
import statistics
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import special

from models.common.arrays import Array

LEVELS = np.linspace(0.0, 12.0, 1201)  # over sigma; a largest value above them takes more time than any run has
BIN = 1 / 64  # Hz, of a coarse spectrum; 64 s later nothing is left of a mean over 1 s
DEGREES = (2, 3, 4, 5, 6)  # Hermite polynomials of a clipped square that count


@dataclass(frozen=True, eq=False)
class Gaussian:
    """A signal of one-sided spectrum S per Hz at angular frequencies omega, each of which stands for a share of the band.

    Attributes:
        by_step: S at every step of the period with which it repeats, shape (steps, F).
        omega, share: shape (F,); omega ascending [rad/s], share [Hz].
    """

    by_step: Array
    omega: Array
    share: Array

    @cached_property
    def spectrum(self) -> Array:
        """Mean of S over the steps, shape (F,)."""
        return self.by_step.mean(axis=0)

    @cached_property
    def sigma(self) -> float:
        """Standard deviation, over all steps."""
        return float(self.share @ self.spectrum) ** 0.5

    @cached_property
    def sigmas(self) -> list[float]:
        """Returns the standard deviation at every step."""
        return [float(self.share @ spectrum) ** 0.5 for spectrum in self.by_step]

    @property
    def mean_fourth_power(self) -> float:
        """E x^4."""
        return 3 * statistics.fmean(sigma**4 for sigma in self.sigmas)

    def beyond(self, threshold: float) -> float:
        """Share of time above a threshold."""
        return statistics.fmean(float(special.ndtr(-threshold / sigma)) if sigma else 0.0 for sigma in self.sigmas)

    def clipped_mean_square(self, clip: float) -> float:
        """E min(x, clip)^2, for a clip above 0; infinite for none."""
        if not self.sigma or math.isinf(clip):
            return self.sigma**2
        return statistics.fmean(_clipped_square(sigma, clip) for sigma in self.sigmas)

    def mean_square_variance(self, window: float, clip: float) -> float:
        """Variance of the mean of min(x, clip)^2 over a window [s]: that of a constant at most."""
        if not self.sigma:
            return 0.0
        square = float(self.share @ self.spectrum**2) / (4 * self.sigma**4)  # integral of rho^2 from 0 on
        if math.isinf(clip):
            return self.sigma**4 * min(4 * square / window, 2.0)
        correlation, step = self._correlation
        a = clip / self.sigma
        total, power = 0.0, correlation.copy()
        for k in DEGREES:
            power *= correlation  # to the k: a product costs less than a hundredth of a power
            memory = square if k == 2 else float(np.sum(power)) * step - step / 2
            total += _hermite_of_clipped_square(k, a) ** 2 / math.factorial(k) * min(2 * max(memory, 0.0) / window, 1.0)
        return self.sigma**4 * total

    def largest(self, window: float) -> float:
        """Expected largest magnitude within a window [s], over sigma."""
        if not self.sigma:
            return 0.0
        m0, m1, m2 = (float(self.share @ (self.omega**k * self.spectrum)) for k in range(3))
        width = math.sqrt(max(1 - m1**2 / (m0 * m2), 0.0))
        crossings = math.sqrt(m2 / m0) / math.pi * window  # of zero, either way
        eta = LEVELS[1:]
        clump = -np.expm1(-math.sqrt(math.pi / 2) * width**1.2 * eta)
        below = -np.expm1(-(eta**2) / 2) * np.exp(-crossings * clump / np.expm1(eta**2 / 2))
        return float(np.trapezoid(1 - np.concatenate([[0.0], below]), LEVELS))

    def largest_running(self, window: float, memory: float) -> float:
        """Expected root of the largest mean square in a window [s], of running exponential means with this memory [s]."""
        if not self.sigma:
            return 0.0
        mass, apart = self._mass, np.arange(len(self._mass)) * BIN
        pairs = 2 * np.fft.irfft(np.abs(np.fft.rfft(mass, 2 * len(mass))) ** 2)[: len(mass)]  # by their difference
        pairs[0] /= 2
        low = 1 / (1 + (2 * np.pi * apart * memory) ** 2)
        slow = float(pairs @ low)
        sums = np.convolve(mass[: 8 * 64], mass[: 8 * 64])  # by their sum; above 8 Hz none is left
        quick = float(sums @ (1 / (1 + (2 * np.pi * (np.arange(len(sums)) + 1) * BIN * memory) ** 2)))
        variance = slow + quick
        rate = math.sqrt(float(pairs @ (1 - low)) / slow) / memory  # of the slow part: rms of its derivative over its own
        shape = self.sigma**4 / variance
        # A Gaussian signal u of that rate stays below a level for the window; the mean square is as rare as u.
        u = np.linspace(-5, 8, 1301)
        below = special.ndtr(u) * np.exp(-rate / (2 * np.pi) * window * np.exp(-(u**2) / 2))
        levels = special.gammainccinv(shape, special.ndtr(-u)) / shape
        middle = (np.sqrt(levels[1:]) + np.sqrt(levels[:-1])) / 2
        return self.sigma * float(np.diff(below) @ middle + below[0] * math.sqrt(levels[0]))

    @cached_property
    def _mass(self) -> Array:
        """Variance in bins of `BIN` [Hz] from 0 on."""
        edges = (self.omega / (2 * np.pi))[:, None] + np.stack([-self.share / 2, self.share / 2], axis=-1)
        total = np.concatenate([[0.0], np.cumsum(self.share * self.spectrum)])
        at = np.concatenate([edges[:1, 0], (edges[1:, 0] + edges[:-1, 1]) / 2, edges[-1:, 1]])
        bins = np.arange(0.0, at[-1] + 2 * BIN, BIN)
        return np.diff(np.interp(bins, at, total))

    @cached_property
    def _correlation(self) -> tuple[Array, float]:
        """Autocorrelation rho from 0 on, and its step [s]."""
        spectrum = np.concatenate([self._mass, np.zeros(len(self._mass))])
        rho = np.fft.hfft(spectrum)
        half = len(rho) // 2
        return rho[:half] / rho[0], 1 / (BIN * len(rho))


def positive_part(covariance: float, x: float, y: float, mean: float = 0.0) -> float:
    """E max(x y, 0) of two Gaussians of this covariance and these standard deviations, x of a mean, and y of none."""
    r = min(max(covariance / (x * y), -1.0), 1.0) if x * y else 0.0
    if not mean:
        return x * y * (math.sqrt(1 - r**2) + r * math.acos(-r)) / math.pi
    # At y = z of them above and below 0, x is a Gaussian of the mean and deviation that are left, whose positive part is known.
    z, left = LEVELS, max(x * math.sqrt(1 - r**2), 1e-9 * (x + abs(mean)))
    total = np.zeros_like(z)
    for side in (1.0, -1.0):
        at = (side * mean + r * x * z) / left
        total += left * (at * special.ndtr(at) + np.exp(-(at**2) / 2) / math.sqrt(2 * math.pi))
    return y * float(np.trapezoid(z * np.exp(-(z**2) / 2) / math.sqrt(2 * math.pi) * total, z))


def _clipped_square(sigma: float, clip: float) -> float:
    """E min(x, clip)^2 of a Gaussian x."""
    if not sigma:
        return 0.0
    a = clip / sigma
    tail, density = float(special.ndtr(-a)), math.exp(-(a**2) / 2) / math.sqrt(2 * math.pi)
    return sigma**2 * (1 - tail - a * density + a**2 * tail)


def _hermite_of_clipped_square(k: int, a: float) -> float:
    """E min(z, a)^2 He_k(z) of a standard normal z, for k of 2 or more, by parts."""
    density = math.exp(-(a**2) / 2) / math.sqrt(2 * math.pi)

    def below(m: int) -> float:
        """E He_m(z) over z < a."""
        return float(special.ndtr(a)) if m == 0 else -float(special.eval_hermitenorm(m - 1, a)) * density

    return 2 * (below(k) + (k - 1) * below(k - 2))
