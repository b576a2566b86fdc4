"""Logs of damper dynamometers: force and displacement against time. The velocity is computed from the displacement.

The displacement is differentiated by the filter of A. Savitzky and M. Golay, which has no delay. The 3 dB cut-off frequency of
this filter is given by R. W. Schafer (2011), What is a Savitzky-Golay filter?, IEEE Signal Processing Magazine 28, 111-117, eq.
(12). For a damper, the mean of force times velocity over full cycles is above 0. The sign of the mean power therefore shows
whether the log gives force and velocity with the same sign.
"""

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.printed import rough

CYCLES = 10  # only this number of cycles at the end of a log is evaluated
STROKE = 0.5  # a stroke that is shorter than this share of the displacement's range does not end a cycle
# Cut-off frequency of the smoothing filter, relative to the frequency of the cycles, and degree of the filter's polynomials
HARMONICS, ORDER = 12.0, 3
LEAST_SIDE = 3  # the smoothing filter uses at least this number of samples on each side of its centre
NEARLY = 0.05  # a cycle counts as complete if at most this share of the cycle is missing
SAMPLES = 25.0  # a cycle must have at least this number of samples
GAP = 10.0  # longest allowed time between two samples, relative to the mean time between samples
LEAST_CORRELATION = 0.05  # the force counts as independent of the velocity if the magnitude of their correlation is below this


def velocity_of(time: Array, displacement: Array, force: Array) -> tuple[Array, Array, str]:
    """Returns velocity [m/s] and force [N] of the last full cycles in a log, shapes (k,), and a phrase that describes the
    method.

    Args:
        time: times of the samples, ascending [s], shape (n,).
        displacement: displacement [m], shape (n,).
        force: force [N], shape (n,).

    Raises:
        InputError: the times do not ascend or have a gap, the log contains no full cycle, or a cycle has too few samples.
    """
    from scipy.signal import find_peaks, savgol_filter

    steps = np.diff(time)
    for i in np.flatnonzero((steps <= 0) | (steps > GAP * steps.mean()))[:1]:
        raise InputError(
            f"time goes from {time[i]:.9g} to {time[i + 1]:.9g} s at row {i + 2}, but times must rise in steps of "
            "similar length; give a log with a constant sample rate"
        )
    rate, even = 1 / float(steps.mean()), np.linspace(time[0], time[-1], len(time))
    x, force = (np.interp(even, time, values) for values in (displacement, force))
    tops, bottoms = (find_peaks(side * x, prominence=STROKE * np.ptp(x))[0] for side in (1.0, -1.0))
    if len(ends := max(tops, bottoms, key=len)) < 2:
        raise InputError(
            "the displacement has fewer than two maxima and fewer than two minima, so the log contains no full "
            "cycle; give a longer log"
        )
    period = float(np.diff(ends).mean())
    if period < SAMPLES:
        raise InputError(
            f"a cycle has {period:.3g} samples, but at least {SAMPLES:g} are needed; record the log at a higher sample rate"
        )
    last = min(len(x) - 1, round(max(*tops, *bottoms) + period / 2))
    whole = int(last / period + NEARLY)
    cycles = min(CYCLES, whole)
    which = slice(max(0, round(last - cycles * period)), last + 1)
    side = max(LEAST_SIDE, round(((ORDER + 1) * period / (2 * HARMONICS) + 4.6) / 3.2))
    cut_off = (ORDER + 1) / (3.2 * side - 4.6) * rate / 2
    velocity = np.asarray(savgol_filter(x, 2 * side + 1, ORDER, deriv=1, delta=1 / rate))
    words = (
        f"velocity from the displacement by a low-pass of {rough(cut_off)} Hz (Savitzky-Golay, order {ORDER}, {2 * side + 1} "
        f"samples), last {cycles} of {whole} cycles of {rough(rate / period)} Hz"
    )
    return velocity[which], force[which], words


def dissipation(velocity: Array, force: Array) -> float:
    """Returns the mean power that a damper dissipates, after subtracting its mean force [W].

    The mean power is above 0 if the log gives force and velocity with the same sign.

    Raises:
        InputError: the measured force does not depend on the velocity.
    """
    power = float(np.mean((velocity - velocity.mean()) * (force - force.mean())))
    if not abs(power) > LEAST_CORRELATION * float(velocity.std() * force.std()):
        raise InputError(
            "the force neither rises nor falls with velocity in this log; check that the columns of force and motion are "
            "not exchanged"
        )
    return power
