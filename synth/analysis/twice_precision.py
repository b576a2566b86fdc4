"""Gains and norms with twice the precision, for loops in which rounding errors of floats could be seen."""

import numpy as np

from models.common.arrays import Array
from models.common.extensions import FEATURES
from synth.analysis.norm import Gain, Norm, by_level_sets, by_sweep, largest_singular_values
from synth.plant.generalized import Plant
from synth.plant.iterative_refinement import solve_closely, with_imaginary

CLOSE_ZOOMS = 8  # number of tenfold refinements of a frequency interval; the gain is then accurate to 1e-16
WITHIN = 1e-4  # frequency step with which a parabola is fitted to a peak, relative to the damping of the nearest pole


def _transfer_matrix(system: Plant, omega: Array) -> tuple[Array, Array]:
    """Returns the frequency response Dw + C (j omega - A)^-1 Bw (19), computed with twice the precision, and an estimate of its
    error.

    Args:
        system: system from w to z, including `beyond`, the low-order digits of its matrices.
        omega: angular frequencies [rad/s], shape (F,).

    Returns:
        The frequency response T, complex, shape (F, d, r), and the largest change of its entries in the last iteration, shape
        (F,).
    """
    n, Bw = len(system.A), system.Bw
    beyond = np.zeros((n + len(system.C), n)) if system.beyond is None else system.beyond
    turned = omega[:, None, None] * np.eye(n)
    high, low = with_imaginary(np.broadcast_to(-system.A, turned.shape), turned), with_imaginary(-beyond[:n], np.zeros((n, n)))
    T, moved = solve_closely(high, low, np.vstack([Bw, 0 * Bw]), system.C, beyond[n:])
    return T + system.Dw, moved


def precise_gains(gain: Gain, omega: Array) -> tuple[Array, Array]:
    """Returns the gains of `Gain.at`, computed with twice the precision, and bounds on their errors, both of shape (F,)."""
    T, missing = _transfer_matrix(gain.system, omega)
    return largest_singular_values(T), missing


def rounding_error(gain: Gain, omega: Array) -> float:
    """Returns the largest rounding error of the gains that `Gain.at` computes at some frequencies [rad/s], measured with twice
    the precision.
    """
    gains, missing = precise_gains(gain, omega)
    return float((np.abs(gain.at(omega) - gains) + missing).max())


def error_of_precise_gain(gain: Gain, at: float) -> float:
    """Returns the bound on the error that `precise_gains` has at the frequency `at` [rad/s]; 0 at infinite frequency."""
    return float(precise_gains(gain, np.array([at]))[1][0]) if np.isfinite(at) else 0.0


def missed_peak(gain: Gain, at: float) -> float:
    """Returns the bound of `Gain.grid_error`, computed with twice the precision.

    The result is needed if rounding may have moved the poles, so that the search may have missed a peak.

    Near a resonance, gain^-2 is a parabola in the frequency. The parabola is fitted through the gains at three frequencies.
    """
    if not (np.isfinite(at) and len(gain.poles)):
        return 0.0
    # the gain at the end of the interval is exact; peaks outside the interval do not count
    if at > 0 and at in (gain.low, gain.high):
        return gain.grid_error(at)
    step = max(float(np.spacing(at)), WITHIN * float(gain.width(np.array([at]))[0]))
    (below, here, above), _ = precise_gains(gain, np.array([at - step, at, at + step]))
    left, right = (here / below) ** 2, (here / above) ** 2
    bent, slope = left + right - 2, (right - left) / 2
    lowest = min(1 - slope**2 / (2 * bent) if bent > 0 else 1.0, left, right)
    return float(lowest**-0.5 - 1)


def refined_peak(gain: Gain, at: float) -> tuple[float, float]:
    """Returns the highest gain near `at` [rad/s] or near any pole, computed with twice the precision, and its frequency
    [rad/s].
    """
    omega = np.concatenate([[gain.low], np.abs(gain.poles), np.abs(np.imag(gain.poles)), [at] if np.isfinite(at) else []])
    omega = gain.within(omega)
    gains, _ = precise_gains(gain, omega)
    high = np.unique(omega[gains > 0.9 * gains.max()])
    there = gain.climbed(lambda near: precise_gains(gain, near)[0], high, gain.width(high), CLOSE_ZOOMS)
    best, there = float(precise_gains(gain, there)[0][0]), float(there[0])
    return gain.or_at_infinity(best, there)


def gain_at(system: Plant, omega: float) -> float:
    """Returns the largest singular value of the transfer matrix at the frequency omega [rad/s], computed with twice the
    precision.
    """
    if system.dt is not None:
        discrete = FEATURES.load("discrete plants")
        at = discrete.mapped_frequency(omega, system.dt) * system.dt / 2
        return float(np.linalg.norm(discrete.response_closely(system, at)[0], 2))
    return float(precise_gains(Gain(system), np.array([omega]))[0][0])


def discrete_by_both_routes(system: Plant, dt: float, gain: Gain) -> Norm:
    """Returns the largest gain of a discrete system, computed by both methods (level sets and frequency sweep).

    The bilinear transform maps the system to a continuous system, in which the methods search for frequencies with a large
    gain. The returned gain is computed from the discrete system at these frequencies.
    """
    norms, discrete = [], FEATURES.load("discrete plants")
    for route in (by_level_sets, by_sweep):
        value, at = route(gain)
        T, missing = discrete.response_closely(system, at * dt / 2)
        true = float(np.linalg.norm(T, 2))
        norms.append((true, at, (abs(true - value) + missing) / true if true else 0.0))
    (level, _, _), (sweep, _, _) = norms
    value, at, rounding = max(norms)
    return Norm(
        value, discrete.true_frequency(at, dt), level, sweep, rounding + gain.grid_error(at) + gain.last if value else 0.0
    )
