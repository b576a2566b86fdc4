"""Anti-windup of a linear law: its states follow the forces that are given, where these are not the requested ones.

A law as a computer runs it is x_c[i+1] = A x_c[i] + B y[i], u[i] = C x_c[i] + D y[i]. Its next states get L (clip(u[i]) - u[i])
on top: back-calculation (Astrom, Wittenmark 1997, Computer-Controlled Systems, chapter 9). While nothing is clipped, this
term is exactly zero. While all forces are clipped, the states go by A - L C, whatever A is.

With L all of these decay by exp(-rate T) or faster in a sample of T seconds. Poles within that circle stay where they are.
Slower ones are mirrored at it: an integrator then decays at twice the rate. L is the gain of a Kalman filter of that degree of
stability, in the limit of much measurement noise (Anderson, Moore 1971, Linear Optimal Control). It does the same in all units of
the states.
"""

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.linear import LinearLaw

SLACK = 1e-6  # a pole of A - L C further beyond the circle shows that rounding has spoilt L; smaller rates times T are refused


def anti_windup_gain(law: LinearLaw) -> Array:
    """Returns L of a discrete law, shape (k, m); zero without anti-windup.

    Args:
        law: law as implemented, see `LinearLaw.sampled`.

    Raises:
        InputError: the rate is too small for the sample period, or a state that is too slow acts on no force, or hardly.
    """
    k, m = law.C.shape[1], len(law.C)
    if law.anti_windup is None or not k:
        return np.zeros((k, m))
    assert law.sample_period is not None, "it is discrete"
    if law.anti_windup * law.sample_period < SLACK:
        raise InputError(
            f"anti_windup = {law.anti_windup:g} 1/s is too small for a sample period of {law.sample_period:g} s: its effect is "
            f"lost in rounding; give at least {SLACK / law.sample_period:.2g} 1/s"
        )
    circle = float(np.exp(-law.anti_windup * law.sample_period))
    try:
        gain = _mirroring_gain(law.A, law.C, circle)
        if np.abs(np.linalg.eigvals(law.A - gain @ law.C)).max() <= circle + SLACK:
            return gain
    except (np.linalg.LinAlgError, ValueError):
        pass
    raise InputError(
        f"anti_windup = {law.anti_windup:g} 1/s cannot be reached: a state of this law is slower and has almost no effect "
        "on the forces; remove this state from the law, or give a smaller anti_windup"
    )


def _mirroring_gain(A: Array, C: Array, circle: float) -> Array:
    """Returns the L with which A - L C has the poles of A, but for those beyond a circle, which are mirrored at it.

    One pole or pair is mirrored after another: all at once, next to each other, they leave no digits. Corrections so far make
    further ones dearer, so that the order does not matter.

    Raises:
        LinAlgError, ValueError: a pole beyond it does not show in C.
    """

    def beyond(real: float, imag: float) -> bool:
        return np.hypot(real, imag) > circle + SLACK / 2

    gain, dear = np.zeros_like(C.T), np.eye(len(C))
    for _ in range(len(A)):
        triangle, basis, slow = linalg.schur(A - gain @ C, sort=beyond)  # pyright: ignore[reportAssignmentType, reportArgumentType]
        if not slow:
            break
        one = slice(2 if slow > 1 and triangle[1, 0] else 1)
        F, G = triangle[one, one].T / circle, (C @ basis[:, one]).T
        inverse = np.linalg.inv(F)
        pushed = inverse @ G @ np.linalg.solve(dear, G.T) @ inverse.T
        W = np.linalg.solve(np.eye(len(F) ** 2) - np.kron(inverse, inverse), pushed.ravel()).reshape(F.shape)  # Lyapunov's
        XG = np.linalg.solve(W, G)
        dear = dear + G.T @ XG
        gain = gain + circle * basis[:, one] @ np.linalg.solve(dear, XG.T @ F).T
    return gain
