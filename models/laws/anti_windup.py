"""Anti-windup of a linear law: its states follow the forces that are given, where these are not the requested ones.

A law as a computer runs it is x_c[i+1] = A x_c[i] + B y[i], u[i] = C x_c[i] + D y[i]. Its next states get L (clip(u[i]) - u[i])
on top: back-calculation (Astrom, Wittenmark 1997, Computer-Controlled Systems, chapter 9). While nothing is clipped that is zero,
to the last bit. While all is clipped the states go by A - L C, whatever A is.

L is the smallest gain with which all of these decay by exp(-rate T) or faster in a sample of T seconds. States that do so by
themselves are left alone; other poles are mirrored at that circle. It is the Kalman filter of that degree of stability whose
corrections are dear (Anderson, Moore 1971, Linear Optimal Control), the same in all units of the states.
"""

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.lean_scipy import linalg
from models.laws.linear import LinearLaw

SLACK = 1e-6  # a pole further beyond the circle is there since rounding has taken the gain


def anti_windup_gain(law: LinearLaw) -> Array:
    """Returns L of a discrete law, shape (k, m); zero without anti-windup.

    Args:
        law: as it is run, see `LinearLaw.sampled`.

    Raises:
        InputError: a state that is too slow acts on no force, or hardly.
    """
    k, m = law.C.shape[1], len(law.C)
    if law.anti_windup is None or not k:
        return np.zeros((k, m))
    assert law.sample_period is not None, "it is discrete"
    circle = float(np.exp(-law.anti_windup * law.sample_period))
    try:
        gain = _mirroring(law.A, law.C, circle)
        if np.abs(np.linalg.eigvals(law.A - gain @ law.C)).max() <= circle + SLACK:
            return gain
    except (np.linalg.LinAlgError, ValueError):
        pass
    raise InputError(
        f"anti_windup = {law.anti_windup:g}: a state of this law that is slower than that shows in no force, or hardly, so that "
        "nothing tells it what is clipped; take it out of the law, or give a smaller rate"
    )


def _mirroring(A: Array, C: Array, circle: float) -> Array:
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
