"""The frequency weightings W_k and W_d of ISO 2631-1, for vertical and for horizontal vibration of seated or standing people.

Constants of ISO 8041. With w_i = 2 pi f_i,

    H(s) = 1 / (1 + w1/(Q1 s) + (w1/s)^2) * 1 / (1 + s/(Q2 w2) + (s/w2)^2) * (1 + s/w3) / (1 + s/(Q4 w4) + (s/w4)^2)
           * (1 + s/(Q5 w5) + (s/w5)^2) / (1 + s/(Q6 w6) + (s/w6)^2) * (w5/w6)^2:

the band limits, the step from acceleration to velocity, and the upward step, which W_d has not.
"""

import numpy as np

F1, F2, F3, F4, F5, F6 = 0.4, 100.0, 12.5, 12.5, 2.37, 3.35  # Hz, of W_k
Q1, Q2, Q4, Q5, Q6 = 1 / np.sqrt(2), 1 / np.sqrt(2), 0.63, 0.91, 0.91
HORIZONTAL = 2.0  # Hz, in the place of f3 and f4 in W_d

Section = tuple[tuple[float, ...], tuple[float, ...]]  # numerator and denominator, by falling powers of s


def _limits() -> tuple[Section, Section]:
    low, high = 2 * np.pi * F1, 2 * np.pi * F2
    return ((1.0, 0.0, 0.0), (1.0, low / Q1, low**2)), ((high**2,), (1.0, high / Q2, high**2))


def _step(f3: float, f4: float) -> Section:
    w3, w4 = 2 * np.pi * f3, 2 * np.pi * f4
    return (w4**2 / w3, w4**2), (1.0, w4 / Q4, w4**2)


def _upward() -> Section:
    w5, w6 = 2 * np.pi * F5, 2 * np.pi * F6
    return (1.0, w5 / Q5, w5**2), (1.0, w6 / Q6, w6**2)


WEIGHTINGS: dict[str, tuple[Section, ...]] = {
    "iso2631_wk": (*_limits(), _step(F3, F4), _upward()),
    "iso2631_wd": (*_limits(), _step(HORIZONTAL, HORIZONTAL)),
}
