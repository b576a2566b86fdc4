"""A law without the states that do next to nothing: those that answer at once, and those that cancel.

- *Fast modes* follow their input at once: they are left at rest, and what they feed through joins D_c (residualised; Kokotovic,
  Khalil, O'Reilly 1986, Singular Perturbation Methods in Control, section 1.3).
- *Modes that cancel*, which the measurements hardly reach or the forces hardly show, have small Hankel singular values and are
  cut off (balanced truncation; Moore 1981), where they decay: of those that do not, every one is kept.

Neither promises anything of the loop: whoever reduces a law looks at its loop again.
"""

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.law import LinearLaw

CANCELS = 1e-6  # of the largest Hankel singular value: a smaller one is next to nothing; half of all digits go into their roots


def reduced_law(law: LinearLaw, fast: float) -> LinearLaw:
    """A law without its fast modes and those that cancel; itself where it has none.

    Args:
        law: continuous, in units in which its numbers have a like size.
        fast: magnitude [rad/s] from which on a mode that decays counts as fast.

    Raises:
        LinAlgError: rounding leaves no such parts.
    """
    slow, quick = _parted(law, lambda real, imag: real >= 0 or np.hypot(real, imag) < fast)
    at_once = quick.C @ np.linalg.solve(quick.A, quick.B) if quick.states else np.zeros_like(law.D)
    growing, decaying = _parted(slow, lambda real, imag: real >= 0)
    kept = _truncated(decaying)
    if growing.states + kept.states == law.states:
        return law
    return LinearLaw(
        A=np.asarray(linalg.block_diag(growing.A, kept.A)),
        B=np.vstack([growing.B, kept.B]),
        C=np.hstack([growing.C, kept.C]),
        D=law.D - at_once,
    )


def _parted(law: LinearLaw, first: object) -> tuple[LinearLaw, LinearLaw]:
    """The modes that belong to the first part, and the others, side by side: without D, which belongs to both."""
    none = np.zeros_like(law.D)
    if not law.states:
        return LinearLaw(law.A, law.B, law.C, none), LinearLaw(law.A, law.B, law.C, none)
    triangle, basis, k = linalg.schur(law.A, sort=first)  # pyright: ignore[reportAssignmentType, reportArgumentType]
    B, C, n = basis.T @ law.B, law.C @ basis, law.states
    one, other = triangle[:k, :k], triangle[k:, k:]
    X = linalg.solve_sylvester(one, -other, -triangle[:k, k:]) if 0 < k < n else np.zeros((k, n - k))
    return LinearLaw(one, B[:k] - X @ B[k:], C[:, :k], none), LinearLaw(other, B[k:], C[:, k:] + C[:, :k] @ X, none)


def _truncated(law: LinearLaw) -> LinearLaw:
    """A stable law without what its Hankel singular values say is next to nothing (square-root method)."""
    if not law.states:
        return law
    reached, seen = _root(law.A, law.B), _root(law.A.T, law.C.T)
    left, sizes, right = np.linalg.svd(seen.T @ reached)
    k = int(np.sum(sizes > CANCELS * sizes[0])) if sizes[0] > 0 else 0
    if k == law.states:
        return law
    into, out = seen @ left[:, :k] / np.sqrt(sizes[:k]), reached @ right[:k].T / np.sqrt(sizes[:k])
    return LinearLaw(into.T @ law.A @ out, into.T @ law.B, law.C @ out, law.D)


def _root(A: Array, B: Array) -> Array:
    """L with L L' the Gramian of A and B."""
    gramian = linalg.solve_continuous_lyapunov(A, -B @ B.T)
    sizes, directions = np.linalg.eigh((gramian + gramian.T) / 2)
    return directions * np.sqrt(np.maximum(sizes, 0.0))
