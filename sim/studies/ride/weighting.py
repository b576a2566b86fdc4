"""The frequency weighting W_k of ISO 2631-1 as a continuous-time filter and as a sampled filter.

The constants of the transfer function H(s) are in `models/laws/iso2631.py`. Controller designs can use the same frequency
weighting.

The sampled filter is exactly H with a first-order hold at the input. The sampled filter consists of parallel second-order
recursions, one for each pair of poles. The hold attenuates high frequencies by the factor d / (omega h)^2, where d = 2 - 2
cos(omega h), and h is the timestep. A filter with seven taps compensates for the attenuation that the hold causes. For d = 2 -
2 cos(omega h), the filter is 1 + d/12 + d^2/90 + d^3/560, the first terms of the series of the squared arcsine. The relative
error that remains is (omega h)^8 / 3150. At 80 Hz, the error is 3e-6 for a timestep of 1 ms, and 1e-4 for a timestep of 2 ms.
For a timestep of 5 ms, the error is 0.3 % at 40 Hz and 5 % at 100 Hz, the Nyquist frequency.
"""

from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array, recursion
from models.laws.iso2631 import F1, F2, F3, F4, F5, F6, Q1, Q2, Q4, Q5, Q6

DIFFERENCE = np.array([-1.0, 2.0, -1.0])  # filter with the response 2 - 2 cos(omega h), delayed by one sample
LATE = 3  # delay of the sampled filter, in samples
RESTORE = np.zeros(2 * LATE + 1)
for power, share in enumerate((1.0, 1 / 12, 1 / 90, 1 / 560)):
    taps = np.array([1.0])
    for _ in range(power):
        taps = np.convolve(taps, DIFFERENCE)
    RESTORE[LATE - power : LATE + 1 + power] += share * taps
POLES = ((F1, Q1), (F2, Q2), (F4, Q4), (F6, Q6))  # frequency [Hz] and quality factor of each pair of poles


def wk(omega: Array) -> Array:
    """Returns the complex frequency response of W_k at positive frequencies [rad/s], with the shape of `omega`."""
    s = 1j * np.asarray(omega, dtype=float)
    return _zeros(s) / np.prod([_pair(s, f, q) for f, q in POLES], axis=0)


def _zeros(s: Array) -> Array:
    """Returns the numerator of H(s), which has two zeros at 0, one zero at -w3, and a complex pair of zeros with frequency w5."""
    w2, w3, w4, w5, w6 = (2 * np.pi * f for f in (F2, F3, F4, F5, F6))
    return s**2 * (1 + s / w3) * (1 + s / (Q5 * w5) + (s / w5) ** 2) * (w5 / w6) ** 2 * (w2 * w4 * w6) ** 2


def _pair(s: Array, f: float, q: float) -> Array:
    """Returns one of the four factors of the denominator of H(s)."""
    w = 2 * np.pi * f
    return s**2 + s * w / q + w**2


@dataclass(frozen=True, eq=False)
class SampledWk:
    """The weighting W_k for sampled signals, as a sum of four parallel filters with a delay of three samples.

    Attributes:
        numerators: numerator coefficients of the four filters, by powers of 1/z, shape (4, 9).
        poles: pole of each of the four filters that has a positive imaginary part, shape (4,), complex.
    """

    numerators: Array
    poles: Array

    @property
    def denominators(self) -> Array:
        """Denominator coefficients of the four filters, by powers of 1/z, shape (4, 3)."""
        return np.stack([np.ones(len(self.poles)), -2 * np.real(self.poles), np.abs(self.poles) ** 2], axis=1)

    def __call__(self, signals: Array, memory: Array | None) -> tuple[Array, Array]:
        """Filters the next samples of N signals.

        Args:
            signals: the next T samples of each of N signals, shape (N, T).
            memory: filter memory that this function returned for the previous samples; None before the first sample.

        Returns:
            Weighted signals, shape (N, T), and the filter memory, which contains the last samples of the signals and the states
            of the filters, shape (N, 16).
        """
        count, taps = self.numerators.shape
        memory = np.zeros((len(signals), taps - 1 + 2 * count)) if memory is None else memory
        whole = np.concatenate([memory[:, : taps - 1], signals], axis=1)
        pushed = np.lib.stride_tricks.sliding_window_view(whole, taps, axis=1) @ self.numerators[:, ::-1].T
        # With q[k] = pole q[k-1] + pushed[k], the output of a filter is Im(pole q[k]) / Im(pole). The states are Re q and Im q.
        a, b = np.real(self.poles), np.imag(self.poles)
        real, imaginary = np.diag(a), np.diag(b)
        Phi = np.block([[real, -imaginary], [imaginary, real]])
        states = after_samples(Phi, np.pad(pushed, ((0, 0), (0, 0), (0, count))), memory[:, taps - 1 :])
        weighted = states @ np.concatenate([np.ones(count), a / b])
        return weighted, np.concatenate([whole[:, 1 - taps :], states[:, -1]], axis=1)

    def response(self, omega: Array, timestep: float) -> Array:
        """Returns the complex frequency response of the filter, with the shape of `omega` [rad/s]."""
        z = np.exp(-1j * np.asarray(omega) * timestep)
        return sum(
            (np.polyval(b[::-1], z) / np.polyval(a[::-1], z) for b, a in zip(self.numerators, self.denominators, strict=True)),
            start=np.zeros_like(z),
        )


def after_samples(Phi: Array, forcing: Array, start: Array) -> Array:
    """Returns the states x after each sample, where x[k+1] = Phi x[k] + forcing[k] and x[0] = `start`, shape (N, T, n)."""
    return recursion(Phi, np.concatenate([forcing, np.zeros_like(forcing[:, :1])], axis=1), start[:, None])[:, 1:]


def sampled_wk(timestep: float) -> SampledWk:
    """Returns the filter W_k for signals with a sample period of `timestep` [s]."""
    numerators, poles = [], []
    for f, q in POLES:
        w = 2 * np.pi * f
        pole = w * (-1 / (2 * q) + 1j * np.sqrt(1 - 1 / (4 * q**2)))
        others = np.prod([_pair(pole, *other) for other in POLES if other != (f, q)])
        residue = _zeros(pole) / others / (pole - np.conj(pole))
        # The exact solution of q' = pole q + u for piecewise linear u is q[k+1] = e q[k] + a u[k] + b u[k+1].
        e, x = np.exp(pole * timestep), pole * timestep
        b = (e - 1 - x) / (pole * x)
        a = (e - 1) / pole - b
        hold = 2 * np.real([residue * b, residue * (a - b * np.conj(e)), -residue * a * np.conj(e)])
        numerators.append(np.convolve(hold, RESTORE))
        poles.append(e)
    return SampledWk(np.array(numerators), np.array(poles))
