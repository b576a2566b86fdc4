"""The golden car, whose response to a profile is the International Roughness Index (IRI).

M. W. Sayers (1995), "On the calculation of International Roughness Index from longitudinal road profile", Transportation Research
Record 1501, 1-12; ASTM E1926: a quarter-car of fixed numbers drives at 80 km/h over the heights h_i of one track, sampled every
`step`. Of them its tyre meets the moving average over 250 mm, so a slope that is constant from sample to sample:

    s_i = (h_(i+b) - h_i) / (b step),    b step = 250 mm, b at least 1.

It starts in motion along the mean slope of the first 11 m. IRI is the mean rectified slope of its suspension, |z_s' - z_u'| / V.
Held slopes are a state transition from sample to sample, which is exact. Here it is summed by the car's modes.
"""

import math
from functools import lru_cache

import numpy as np

from models.common.arrays import Array

SPEED = 80 / 3.6  # m/s
SPRING, TYRE, DAMPER, WHEEL = 63.3, 653.0, 6.0, 0.15  # k_s/m_s, k_u/m_s [1/s2], c/m_s [1/s], m_u/m_s
BASE = 0.25  # m, of the moving average
START = 11.0  # m, whose mean slope the car starts with
SETTLED = 100.0  # m, behind which 1e-5 is left of a start
FORGOTTEN = 1e-18  # of what was, relative; less is below rounding

# States are z_s, z_s', z_u, z_u', each over the distance as the profile's slope is, of which they are the response.
A = np.array(
    [
        [0.0, 1.0, 0.0, 0.0],
        [-SPRING, -DAMPER, SPRING, DAMPER],
        [0.0, 0.0, 0.0, 1.0],
        [SPRING / WHEEL, DAMPER / WHEEL, -(SPRING + TYRE) / WHEEL, -DAMPER / WHEEL],
    ]
)
B = np.array([0.0, 0.0, 0.0, TYRE / WHEEL])
C = np.array([1.0, 0.0, -1.0, 0.0])


def roughness_index(heights: Array, step: float) -> float:
    """The IRI of a profile [m/km].

    Args:
        heights: of one track [m], shape (P,), of 11 m at least.
        step: from one to the next [m].
    """
    return 1e3 * float(np.abs(suspension_slopes(heights, step)).mean())


def suspension_slopes(heights: Array, step: float) -> Array:
    """(z_s' - z_u') / V behind every sample [-], shape (P - b,).

    Args:
        heights: of one track [m], shape (P,).
        step: from one to the next [m].
    """
    base, first = _samples(step), min(max(round(START / step), 1), len(heights))
    slopes = (heights[base:] - heights[:-base]) / (base * step)
    start = (heights[first - 1] - heights[0]) / (step * first)  # as the listing of 1995 has it
    rates, of_slopes, of_start = _modes(step)
    # As far as it remembers; what it starts with is behind the first sample, too.
    remembered = min(len(slopes), math.ceil(math.log(FORGOTTEN) / np.real(rates).max()))
    powers = np.exp(np.outer(np.arange(remembered + 1), rates))
    answer, alone = np.real(powers[:-1] @ of_slopes), start * np.real(powers[1:] @ of_start)
    size = 1 << (len(slopes) + remembered - 1).bit_length()
    found = np.fft.irfft(np.fft.rfft(slopes, size) * np.fft.rfft(answer, size), size)[: len(slopes)]
    found[:remembered] += alone
    return found


def slope_response(n: Array, step: float) -> Array:
    """Of `suspension_slopes` to a profile's slope at spatial frequencies [cycle/m], shape like n, complex.

    Args:
        n: spatial frequencies, none of them 0.
        step: of the samples [m].
    """
    rates, of_slopes, _ = _modes(step)
    turn = np.exp(2j * np.pi * np.asarray(n) * step)
    averaged = (turn ** _samples(step) - 1) / (2j * np.pi * np.asarray(n) * _samples(step) * step)
    return averaged * sum(share / (1 - np.exp(rate) / turn) for rate, share in zip(rates, of_slopes, strict=True))


def missing(n: Array, variances: Array, step: float) -> Array:
    """How much of its final rms `suspension_slopes` lack as the car starts, added up over the way [m], every 250 mm.

    Args:
        n: spatial frequencies of a random road's lines [cycle/m], none of them 0, shape (F,).
        variances: of its slope, by line, shape (F,).
        step: of the samples [m].
    """
    rates, of_slopes, of_start = _modes(step)
    base, first, way = _samples(step), round(START / step), 2j * np.pi * n
    turn = np.exp(way * step)
    before = of_slopes / (1 - np.multiply.outer(1 / turn, np.exp(rates)))  # had it always been on its way, behind sample 0
    averaged = (turn**base - 1) / (way * base * step)
    start = (turn ** (first - 1) - 1) / (way * first * step)
    away = start[:, None] * of_start - (averaged / turn)[:, None] * before
    at = np.arange(0, math.ceil(SETTLED / step), base)
    answers = np.exp(np.outer(at + 1, rates)) @ away.T + np.exp(np.outer(at * step, way)) * (averaged * before.sum(axis=-1))
    rms, final = np.sqrt(np.abs(answers) ** 2 @ variances), math.sqrt(np.abs(averaged * before.sum(axis=-1)) ** 2 @ variances)
    return np.cumsum(1 - rms / final) * base * step


def _samples(step: float) -> int:
    """That the moving average goes over."""
    return max(round(BASE / step), 1)


@lru_cache(maxsize=16)
def _modes(step: float) -> tuple[Array, Array, Array]:
    """Of the car from sample to sample: rates of its modes, and their shares of the answer to a slope, and of the start's."""
    values, vectors = np.linalg.eig(A)
    time = step / SPEED
    shapes, start = C @ vectors, np.array([1.0, 0.0, 1.0, 0.0])
    held = np.expm1(values * time) / values * np.linalg.solve(vectors, B)
    return values * time, shapes * held, shapes * np.linalg.solve(vectors, start.astype(complex))
