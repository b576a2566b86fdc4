"""Anti-windup of a linear law: while the actual forces differ from the requested forces, the states follow the actual forces.

A law that a computer executes is x_c[i+1] = A x_c[i] + B y[i], u[i] = C x_c[i] + D y[i]. Anti-windup adds L (clip(u[i]) - u[i])
to x_c[i+1] (back-calculation: Astrom, Wittenmark 1997, Computer-Controlled Systems, chapter 9). While no force is clipped, the
anti-windup term is exactly zero. While all forces are clipped, the law with anti-windup has the state matrix A - L C.

The gain L is chosen so that, while all forces are clipped, the states decay at least by the factor exp(-rate T) in a sample
period of T seconds. Poles of A inside the circle with the radius exp(-rate T) are not moved by the anti-windup. Poles of A
outside the circle with the radius exp(-rate T) are mirrored at this circle. An integrator, for example, then decays at twice
the prescribed rate. The matrix L is the gain of a Kalman filter with a prescribed degree of stability, in the limit of large
measurement noise (Anderson, Moore 1971, Linear Optimal Control). The gain L does not depend on the units of the states.
"""

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.linear import LinearLaw

# A pole of A - L C that is outside the allowed circle by more than SLACK shows that rounding errors have made L useless. The
# product of the anti-windup rate and the sample period T must be at least SLACK.
SLACK = 1e-6


def anti_windup_gain(law: LinearLaw) -> Array:
    """Returns the anti-windup gain L of a discrete law, shape (k, m); zero without anti-windup.

    Args:
        law: law as a computer executes it; see `LinearLaw.sampled`.

    Raises:
        InputError: the rate is too small for the sample period, or a state that decays too slowly has almost no effect on the
            forces.
    """
    k, m = law.C.shape[1], len(law.C)
    if law.anti_windup is None or not k:
        return np.zeros((k, m))
    assert law.sample_period is not None, "it is discrete"
    if law.anti_windup * law.sample_period < SLACK:
        raise InputError(
            f"anti_windup = {law.anti_windup:g} 1/s is too small for a sample period of {law.sample_period:g} s, "
            f"because its effect would be lost in rounding; give at least {SLACK / law.sample_period:.2g} 1/s"
        )
    circle = float(np.exp(-law.anti_windup * law.sample_period))
    try:
        gain = _mirroring_gain(law.A, law.C, circle)
        if np.abs(np.linalg.eigvals(law.A - gain @ law.C)).max() <= circle + SLACK:
            return gain
    except (np.linalg.LinAlgError, ValueError):
        pass
    raise InputError(
        f"anti_windup = {law.anti_windup:g} 1/s cannot be achieved, because a state of this law decays more slowly "
        "and has almost no effect on the forces; remove this state from the law, or give a smaller anti_windup"
    )


def _mirroring_gain(A: Array, C: Array, circle: float) -> Array:
    """Returns the gain L for which A - L C has the poles of A, but with poles outside a circle mirrored at this circle.

    Poles are mirrored one after another, complex poles in pairs. If several close poles were mirrored together, rounding errors
    would be as large as the result. The weight `dear` of a pole includes the previous corrections, so the order of the poles
    does not matter.

    Raises:
        LinAlgError, ValueError: a pole outside the circle cannot be observed through C.
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
        # W is the solution of a Lyapunov equation
        W = np.linalg.solve(np.eye(len(F) ** 2) - np.kron(inverse, inverse), pushed.ravel()).reshape(F.shape)
        XG = np.linalg.solve(W, G)
        dear = dear + G.T @ XG
        gain = gain + circle * basis[:, one] @ np.linalg.solve(dear, XG.T @ F).T
    return gain
