"""Gains on velocities that nobody measures: the leaky integrator, which is how it is done in practice.

A body's velocity is had from an accelerometer, integrated with a leak, so that its offset and drift do not grow for ever:

    x_v' = a - omega_c x_v,        that is        x_v = s / (s + omega_c) v,

which is the velocity itself above the corner frequency, and nothing at rest. It is the high-pass half of a complementary filter
(Higgins 1975); the low half needs another sensor of that velocity, which a suspension has not. (Skyhook laws are run so: Savaresi
et al. 2010, Semi-Active Suspension Control Design for Vehicles, section 6.)
"""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.linear import LinearLaw
from synth.plant.generalized import real_matrix


def leaky_integrator_law(gain: Array, integrated: Sequence[int], corner: float) -> LinearLaw:
    """A static gain with some of its signals, velocities, replaced by their accelerometers, each with a leaky integrator.

    Of a quarter car's gain on (suspension_deflection, sprung_velocity) with `integrated` (1,) it is the law on
    (suspension_deflection, sprung_acceleration).

    Args:
        gain: K, shape (m, q) [N per measured unit].
        integrated: which of the q signals are velocities that are to be had from accelerations, in place of which these stand.
        corner: omega_c [rad/s]; below it a velocity fades out.

    Returns:
        A law of as many states as signals are integrated.

    Raises:
        InputError: the gain is no matrix of numbers, a signal is not one of its columns or named twice, or the corner is not
            above zero.
    """
    K = real_matrix(gain, "gain", "(m, q)")
    q, chosen = K.shape[1], list(integrated)
    if len(set(chosen)) < len(chosen) or not set(chosen) <= set(range(q)):
        raise InputError(f"integrated = {chosen} are not different columns of a gain on {q} signals; give indices below {q}")
    if not 0 < corner < np.inf:
        raise InputError(f"corner = {corner!r} rad/s is not allowed; give a number above 0, as 0.5: without a leak offsets grow")
    k = len(chosen)
    into = np.zeros((k, q))
    into[np.arange(k), chosen] = 1.0
    return LinearLaw(-corner * np.eye(k), into, K[:, chosen], K * (1 - into.sum(axis=0)))
