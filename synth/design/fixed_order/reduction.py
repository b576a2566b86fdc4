"""Reduction of a law: laws with fewer states and nearly the same response, from several methods. The search continues by
descent from the best reduced law.

- Balanced truncation (Moore 1981) of the stable part of the law. The unstable part is kept unchanged.
- Truncation after balancing in the closed loop (Enns 1984; the loop acts as frequency weights). The Gramians describe how w
  excites the states of the law, and how these states affect z. The law itself may be unstable.
- Both truncation methods with singular perturbation (Liu, Anderson 1989): the omitted states are assumed to be in equilibrium
  instead of being zero.

No reduction method guarantees a stable loop, so the caller must check the loop.
"""

import contextlib
import warnings
from collections.abc import Iterator

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.linear import LinearLaw
from synth.design.full_order.full_order import bilinear
from synth.design.full_order.riccati import split_modes
from synth.plant.generalized import Plant


def reductions(plant: Plant, law: LinearLaw, k: int) -> Iterator[LinearLaw]:
    """Yields laws with k states, reduced from a law with k or more states.

    A law with at most k states is returned unchanged.
    """
    if law.states <= k:
        yield law
        return
    with contextlib.suppress(InputError, np.linalg.LinAlgError, ValueError):
        loop, own = plant.closed(law), slice(len(plant.A), None)
        reached = _gramian(loop.A, loop.Bw, loop.dt)[own, own]
        seen = _gramian(loop.A.T, loop.C.T, loop.dt)[own, own]
        yield from _cut(law, reached, seen, k)
    with contextlib.suppress(InputError, np.linalg.LinAlgError, ValueError):
        slow = law.continuous()
        growing, decaying = split_modes(slow, lambda real, imag: real >= 0)
        left = k - growing.states
        if left >= 0:
            decaying = LinearLaw(decaying.A, decaying.B, decaying.C, np.zeros_like(law.D))
            parts = (
                _cut(decaying, _gramian(decaying.A, decaying.B, None), _gramian(decaying.A.T, decaying.C.T, None), left)
                if left < decaying.states
                else iter([decaying])
            )
            for part in parts:
                whole = LinearLaw(
                    np.asarray(linalg.block_diag(growing.A, part.A)),
                    np.vstack([growing.B, part.B]),
                    np.hstack([growing.C, part.C]),
                    slow.D + part.D,
                )
                yield whole if law.sample_period is None else bilinear(whole, law.sample_period)


def _gramian(A: Array, B: Array, dt: float | None) -> Array:
    square = B @ B.T
    with warnings.catch_warnings():
        # poles that nearly cancel give a poor reduced law, but other reduction methods are tried afterwards
        warnings.simplefilter("ignore", RuntimeWarning)
        gramian = linalg.solve_continuous_lyapunov(A, -square) if dt is None else linalg.solve_discrete_lyapunov(A, square)
    return (gramian + gramian.T) / 2


def _cut(law: LinearLaw, reached: Array, seen: Array, k: int) -> Iterator[LinearLaw]:
    """Yields two reduced laws: the states with small balanced Gramians are set to zero in one, and kept in equilibrium in the
    other.
    """
    roots = [directions * np.sqrt(np.maximum(sizes, 0.0)) for sizes, directions in map(np.linalg.eigh, (reached, seen))]
    left, sizes, right = np.linalg.svd(roots[1].T @ roots[0])
    kept = np.maximum(sizes, 1e-14 * sizes[0] if sizes[0] > 0 else 1.0)
    into, out = (roots[1] @ left / np.sqrt(kept)).T, roots[0] @ right.T / np.sqrt(kept)
    A, B, C = into @ law.A @ out, into @ law.B, law.C @ out
    yield LinearLaw(A[:k, :k], B[:k], C[:, :k], law.D, law.sample_period)
    rest = (0.0 if law.sample_period is None else 1.0) * np.eye(law.states - k) - A[k:, k:]
    settled = np.linalg.solve(rest, np.hstack([A[k:, :k], B[k:]]))
    states, inputs = settled[:, :k], settled[:, k:]
    yield LinearLaw(
        A[:k, :k] + A[:k, k:] @ states,
        B[:k] + A[:k, k:] @ inputs,
        C[:, :k] + C[:, k:] @ states,
        law.D + C[:, k:] @ inputs,
        law.sample_period,
    )
