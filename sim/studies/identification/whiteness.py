"""Whiteness of residuals: autocorrelation, the Ljung-Box test, and an autoregressive model for coloured residuals."""

from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array

LAGS = 25  # number of lags that the tests of whiteness use
LEAST = 0.001  # residuals do not count as white if the probability is smaller than this
MOST_ORDER = 40  # largest order of the autoregressive model


@dataclass(frozen=True, eq=False)
class Whiteness:
    """Whiteness of residuals.

    Attributes:
        correlations: autocorrelations of the residuals, beginning at lag 1, shape (LAGS,).
        bound: limit such that 95 % of the correlations of white residuals lie between -bound and bound.
        outside: share of the correlations that do not lie between -bound and bound.
        probability: probability that correlations of white residuals are at least as large as the correlations found (Ljung and
            Box, 1978).
        samples: number of residuals in the test.
    """

    correlations: Array
    bound: float
    outside: float
    probability: float
    samples: int

    @property
    def white(self) -> bool:
        """True if the test does not reject the hypothesis that the residuals are white."""
        return self.probability >= LEAST


def covariances(values: Array, lags: int) -> tuple[Array, Array]:
    """Returns the autocovariances of residuals at lags 0 to `lags`, and the number of complete pairs of values at each lag."""
    counted = np.isfinite(values)
    filled = np.where(counted, values, 0.0)
    size = 1 << (2 * len(values) - 1).bit_length()
    own, pairs = (np.fft.rfft(one, size) for one in (filled, counted.astype(float)))
    sums = np.fft.irfft(np.abs(own) ** 2, size)[: lags + 1]
    counts = np.maximum(np.round(np.fft.irfft(np.abs(pairs) ** 2, size)[: lags + 1]), 1.0)
    return sums / counts, counts


def whiteness(values: Array) -> Whiteness:
    """Tests whether residuals, shape (T,), are white; a missing residual is NaN."""
    from scipy.special import chdtrc

    n = int(np.isfinite(values).sum())
    lags = max(1, min(LAGS, n // 4))
    covariance, counts = covariances(values - np.nanmean(values), lags)
    correlations = covariance[1:] / max(covariance[0], np.finfo(float).tiny)
    statistic = (n + 2) * float(np.sum(counts[1:] / n * correlations**2 * n / np.maximum(n - np.arange(1, lags + 1), 1)))
    bound = 1.96 / np.sqrt(n)
    return Whiteness(correlations, bound, float(np.mean(np.abs(correlations) > bound)), float(chdtrc(lags, statistic)), n)


@dataclass(frozen=True, eq=False)
class Autoregressive:
    """Autoregressive model of residuals e: e[k] + a1 e[k-1] + ... = w[k] with white noise w.

    Attributes:
        coefficients: coefficients 1, a1, a2, ... of the model, shape (order + 1,).
        deviation: rms of the white noise w.
    """

    coefficients: Array
    deviation: float

    def sandwich(self, columns: Array) -> Array:
        """Returns J'RJ for a matrix J, shape (T, p), where R is the autocovariance of the residuals."""
        from scipy.signal import lfilter

        # The autocovariance of the residuals is R = s^2 (A'A)^-1. So J'RJ is s^2 M'M, where M contains the columns of J after the
        # filter 1/A, run backwards in time.
        behind = np.asarray(lfilter([1.0], self.coefficients, columns[::-1], axis=0)) * self.deviation
        return behind.T @ behind


def autoregressive(values: Array) -> Autoregressive:
    """Returns the autoregressive model of residuals whose order minimises the Schwarz criterion (BIC)."""
    n = int(np.isfinite(values).sum())
    most = max(0, min(MOST_ORDER, n // 10))
    covariance, _ = covariances(values, most)
    # The Levinson-Durbin recursion computes the model of each order from the previous one.
    a, error = np.ones(1), float(covariance[0])
    best, least = (a, error), n * np.log(max(error, 1e-300))
    for order in range(1, most + 1):
        reflection = -float(a @ covariance[order:0:-1]) / error
        a = np.append(a, 0.0)
        a = a + reflection * a[::-1]
        error *= 1 - reflection**2
        if error <= 0:
            break
        criterion = n * np.log(error) + order * np.log(n)
        if criterion < least:
            best, least = (a, error), criterion
    return Autoregressive(best[0], float(np.sqrt(best[1])))
