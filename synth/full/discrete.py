"""A law for the continuous plant that a discrete one is mapped to (`discrete/bilinear.py`), as a law for the discrete one."""

import numpy as np

from models.law import LinearLaw
from synth.discrete.bilinear import Mapped
from synth.errors import DesignError

SINGULAR = 1e-12  # relative; what is this small is zero


def discrete_law(law: LinearLaw, where: Mapped, dt: float) -> LinearLaw:
    """The law on what is measured of a discrete plant, whose loop is that of a law on y = C_y x + Dyw w of the mapped one.

    What is measured of the mapped plant contains Dyu u, which the law takes out; then Tustin's map takes it back, and the gain
    that was closed before is joined to it.

    Args:
        law: continuous.
        where: the mapped plant.
        dt: seconds between samples.

    Raises:
        DesignError: at infinity, which is z = -1, it has no finite answer.
        LinAlgError: it has a pole at 2 / dt.
    """
    A, B, C, D = law.A, law.B, law.C, law.D
    at_once = np.eye(len(D)) + D @ where.Dyu
    if np.linalg.svd(at_once, compute_uv=False)[-1] <= SINGULAR * (1 + np.linalg.norm(D @ where.Dyu, 2)):
        raise DesignError(
            "the full-order law is infinite at z = -1, where the plant has a pole that is moved before it is mapped; take that "
            "pole out of the model, or design a static gain"
        )
    after = np.linalg.inv(at_once)
    taken = B @ where.Dyu @ after
    A, B, C, D = A - taken @ C, B - taken @ D, after @ C, after @ D
    turned = np.linalg.inv(np.eye(len(A)) - dt / 2 * A)
    out, into = C @ turned, turned @ B
    return LinearLaw(turned @ (np.eye(len(A)) + dt / 2 * A), dt * into, out, D + dt / 2 * C @ into + where.before, dt)
