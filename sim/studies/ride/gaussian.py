"""Statistics of a Gaussian signal with zero mean over a window of duration T, computed from the spectrum of the signal.

The signal is stationary or cyclostationary. Some statistics are exact: mean squares (also of the clipped signal min(x, s)),
fourth powers, shares of time beyond a threshold, and mean positive parts of products. For example, let a = s / sigma, phi the
density of the normal distribution, and Q its tail probability. Then

    E min(x, s)^2 = sigma^2 (1 - Q(a) - a phi(a) + a^2 Q(a)).

For a cyclostationary signal, the exact statistics are averaged over the steps of a period. All other statistics are computed
from the mean spectrum.

The formula for the variance of a mean square is asymptotic: it applies to a window much longer than the correlation time. The
function min(x, s)^2 is a sum of Hermite polynomials of x / sigma. Let rho be the autocorrelation of the signal. The term of
degree k with coefficient c_k contributes (2 / T) c_k^2 times the integral of rho^k from 0 to infinity. Without clipping, only
c_2 is nonzero, and the variance of the mean square is the integral of S^2 df / T.

The statistics of largest values are approximate. The largest magnitude has Vanmarcke's distribution for a double barrier (E. H.
Vanmarcke (1975), J. Appl. Mech. 42, 215-220). The variance of the running mean square is exact. The distribution of the running
mean square is assumed to be a gamma distribution. The fluctuations of the running mean square are assumed to resemble those of
a Gaussian signal with the same spectrum.
"""

import math
import statistics
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy  # `scipy.special` is imported only when it is used, because the import takes a tenth of a second

from models.common.arrays import Array

# levels of a signal relative to its standard deviation sigma; no run is long enough to exceed the largest level
LEVELS = np.linspace(0.0, 12.0, 1201)
BIN = 1 / 64  # width of a bin of the coarse spectrum [Hz], fine enough for a running mean over 1 s
DEGREES = (2, 3, 4, 5, 6)  # degrees of the Hermite polynomials that represent the square of a clipped signal


@dataclass(frozen=True, eq=False)
class Gaussian:
    """A Gaussian signal, defined by its one-sided spectrum S at frequencies with quadrature weights.

    Attributes:
        by_step: spectrum S [unit^2/Hz] at each step of the signal's period, shape (steps, F).
        omega: ascending frequencies [rad/s], shape (F,).
        share: weight of each frequency when a spectrum is integrated over frequency [Hz], shape (F,).
    """

    by_step: Array
    omega: Array
    share: Array

    @cached_property
    def spectrum(self) -> Array:
        """Mean of the spectrum over the steps of a period [unit^2/Hz], shape (F,)."""
        return self.by_step.mean(axis=0)

    @cached_property
    def sigma(self) -> float:
        """Standard deviation of the signal, computed from the mean spectrum over all steps."""
        return float(self.share @ self.spectrum) ** 0.5

    @cached_property
    def sigmas(self) -> list[float]:
        """Standard deviation of the signal at each step of a period."""
        return [float(self.share @ spectrum) ** 0.5 for spectrum in self.by_step]

    @property
    def mean_fourth_power(self) -> float:
        """Mean of the signal's fourth power, E x^4."""
        return 3 * statistics.fmean(sigma**4 for sigma in self.sigmas)

    def beyond(self, threshold: float) -> float:
        """Returns the share of time in which the signal is above a threshold."""
        return statistics.fmean(float(scipy.special.ndtr(-threshold / sigma)) if sigma else 0.0 for sigma in self.sigmas)

    def clipped_mean_square(self, clip: float) -> float:
        """Returns E min(x, clip)^2 for a positive limit `clip`, which may be infinite."""
        if not self.sigma or math.isinf(clip):
            return self.sigma**2
        return statistics.fmean(_clipped_square(sigma, clip) for sigma in self.sigmas)

    def mean_square_variance(self, window: float, clip: float) -> float:
        """Returns the variance of the mean of min(x, clip)^2 over a window [s]; this variance never exceeds the variance at one
        instant.
        """
        if not self.sigma:
            return 0.0
        square = float(self.share @ self.spectrum**2) / (4 * self.sigma**4)  # integral of rho^2 from 0 to infinity
        if math.isinf(clip):
            return self.sigma**4 * min(4 * square / window, 2.0)
        correlation, step = self._correlation
        a = clip / self.sigma
        total, power = 0.0, correlation.copy()
        for k in DEGREES:
            # correlation^k, computed by repeated multiplication, which is a hundred times faster than a power
            power *= correlation
            memory = square if k == 2 else float(np.sum(power)) * step - step / 2
            total += _hermite_of_clipped_square(k, a) ** 2 / math.factorial(k) * min(2 * max(memory, 0.0) / window, 1.0)
        return self.sigma**4 * total

    def largest(self, window: float) -> float:
        """Returns the expected largest magnitude of the signal within a window [s], relative to the signal's standard
        deviation.
        """
        if not self.sigma:
            return 0.0
        m0, m1, m2 = (float(self.share @ (self.omega**k * self.spectrum)) for k in range(3))
        width = math.sqrt(max(1 - m1**2 / (m0 * m2), 0.0))
        crossings = math.sqrt(m2 / m0) / math.pi * window  # expected number of zero crossings in both directions
        eta = LEVELS[1:]
        clump = -np.expm1(-math.sqrt(math.pi / 2) * width**1.2 * eta)
        below = -np.expm1(-(eta**2) / 2) * np.exp(-crossings * clump / np.expm1(eta**2 / 2))
        return float(np.trapezoid(1 - np.concatenate([[0.0], below]), LEVELS))

    def largest_running(self, window: float, memory: float) -> float:
        """Returns the expected value of the largest running rms in a window.

        Args:
            window: duration of the window [s].
            memory: time constant of the exponential running mean [s].
        """
        if not self.sigma:
            return 0.0
        mass, apart = self._mass, np.arange(len(self._mass)) * BIN
        # Products of the variances at two frequencies, added up in `pairs` by the difference of the frequencies, and in `sums`
        # by their sum.
        pairs = 2 * np.fft.irfft(np.abs(np.fft.rfft(mass, _power_of_two(2 * len(mass)))) ** 2)[: len(mass)]
        pairs[0] /= 2
        low = 1 / (1 + (2 * np.pi * apart * memory) ** 2)
        slow = float(pairs @ low)
        # Frequencies up to 8 Hz suffice, because the running mean suppresses higher frequencies
        sums = np.convolve(mass[: 8 * 64], mass[: 8 * 64])
        quick = float(sums @ (1 / (1 + (2 * np.pi * (np.arange(len(sums)) + 1) * BIN * memory) ** 2)))
        variance = slow + quick
        # Rms of the slow part's derivative, relative to the rms of the slow part
        rate = math.sqrt(float(pairs @ (1 - low)) / slow) / memory
        shape = self.sigma**4 / variance
        # The mean square exceeds a level as often as a Gaussian signal with this rate exceeds the corresponding level u.
        u = np.linspace(-5, 8, 1301)
        below = scipy.special.ndtr(u) * np.exp(-rate / (2 * np.pi) * window * np.exp(-(u**2) / 2))
        levels = scipy.special.gammainccinv(shape, scipy.special.ndtr(-u)) / shape
        middle = (np.sqrt(levels[1:]) + np.sqrt(levels[:-1])) / 2
        return self.sigma * float(np.diff(below) @ middle + below[0] * math.sqrt(levels[0]))

    @cached_property
    def _mass(self) -> Array:
        """Variance of the signal in frequency bins of width `BIN`, starting at 0 Hz."""
        edges = (self.omega / (2 * np.pi))[:, None] + np.stack([-self.share / 2, self.share / 2], axis=-1)
        total = np.concatenate([[0.0], np.cumsum(self.share * self.spectrum)])
        at = np.concatenate([edges[:1, 0], (edges[1:, 0] + edges[:-1, 1]) / 2, edges[-1:, 1]])
        bins = np.arange(0.0, at[-1] + 2 * BIN, BIN)
        return np.diff(np.interp(bins, at, total))

    @cached_property
    def _correlation(self) -> tuple[Array, float]:
        """Autocorrelation rho of the signal from lag 0 on, and the spacing of the lags [s]."""
        rho = np.fft.hfft(self._mass, _power_of_two(4 * len(self._mass)))
        half = len(rho) // 2
        return rho[:half] / rho[0], 1 / (BIN * len(rho))


@dataclass(frozen=True, eq=False)
class RandomSignals:
    """The signals of a vehicle as random variables over all roads with the same spectrum.

    Attributes:
        signal: function that returns the Gaussian signal for a signal name.
        weighted_signal: function that returns the weighted acceleration for the name of an acceleration signal.
        window: duration of the measurement [s], over which metrics are computed.
        timestep: timestep of the signals [s].
        speed: speed of the vehicle [m/s].
        variance_share: factor that multiplies the variance from road to road; below 1 because a road has a finite length.
        mean: means of the signals with a nonzero mean, by name.
        static: static deflection of each tyre [m].
        strokes: strokes in bump and in rebound [m] of each suspension with stops; infinite on a side without a stop.
        works: expected work per step of each suspension actuator, and the expected positive part of this work [J].
    """

    signal: Callable[[str], Gaussian]
    weighted_signal: Callable[[str], Gaussian]
    window: float
    timestep: float
    speed: float
    variance_share: float
    mean: Mapping[str, float]
    static: Mapping[str, float]
    strokes: Mapping[str, tuple[float, float]]
    works: Mapping[str, tuple[float, float]]

    def offset(self, name: str) -> float:
        """Returns the mean of a signal; 0 if `mean` does not contain the signal."""
        return self.mean.get(name, 0.0)

    def rms(self, signal: Gaussian, clip: float = math.inf, scale: float = 1.0, offset: float = 0.0) -> tuple[float, float]:
        """Returns the square root of the expected mean square, and the standard deviation of the rms from road to road.

        Args:
            signal: Gaussian signal x with zero mean.
            clip: upper limit to which the signal is clipped.
            scale: factor that multiplies the result.
            offset: mean of the signal, which is added to x.
        """
        square = signal.clipped_mean_square(clip)
        whole = square + offset**2
        value = math.sqrt(whole) * scale
        # An rms has half the relative spread of its mean square.
        variance = signal.mean_square_variance(self.window, clip)
        return value, value * math.sqrt(self.variance_share * variance) / (2 * whole) if square else 0.0


def _power_of_two(count: int) -> int:
    """Returns the smallest power of two that is at least `count`, because Fourier transforms of other lengths are slower."""
    return 1 << (count - 1).bit_length()


def positive_part(covariance: float, x: float, y: float, mean: float = 0.0) -> float:
    """Returns the mean positive part E max(X Y, 0) of the product of two Gaussian variables X and Y.

    Args:
        covariance: covariance of X and Y.
        x, y: standard deviations of X and Y.
        mean: mean of X; Y has zero mean.
    """
    r = min(max(covariance / (x * y), -1.0), 1.0) if x * y else 0.0
    if not mean:
        return x * y * (math.sqrt(1 - r**2) + r * math.acos(-r)) / math.pi
    # If Y is z standard deviations, the conditional distribution of X is Gaussian with known mean and deviation, so its mean
    # positive part is known.
    z, left = LEVELS, max(x * math.sqrt(1 - r**2), 1e-9 * (x + abs(mean)))
    total = np.zeros_like(z)
    for side in (1.0, -1.0):
        at = (side * mean + r * x * z) / left
        total += left * (at * scipy.special.ndtr(at) + np.exp(-(at**2) / 2) / math.sqrt(2 * math.pi))
    return y * float(np.trapezoid(z * np.exp(-(z**2) / 2) / math.sqrt(2 * math.pi) * total, z))


def _clipped_square(sigma: float, clip: float) -> float:
    """Returns E min(x, clip)^2 for a Gaussian variable x with zero mean and standard deviation sigma."""
    if not sigma:
        return 0.0
    a = clip / sigma
    tail, density = float(scipy.special.ndtr(-a)), math.exp(-(a**2) / 2) / math.sqrt(2 * math.pi)
    return sigma**2 * (1 - tail - a * density + a**2 * tail)


def _hermite_of_clipped_square(k: int, a: float) -> float:
    """Returns E min(z, a)^2 He_k(z) for a standard normal variable z and k >= 2, obtained by integration by parts."""
    density = math.exp(-(a**2) / 2) / math.sqrt(2 * math.pi)

    def below(m: int) -> float:
        """Returns the integral of He_m(z) phi(z) from minus infinity to a."""
        return float(scipy.special.ndtr(a)) if m == 0 else -float(scipy.special.eval_hermitenorm(m - 1, a)) * density

    return 2 * (below(k) + (k - 1) * below(k - 2))
