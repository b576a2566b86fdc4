"""Removes the stable states that are unobservable in z from the LMI problems, and later adds these states to the solution
again.

A gain F may make states unobservable in z: if the loop with u = F x starts in such a state, z = (C + D F) x remains 0.
If these states decay, the matrix X of (22) and (25) may grow without limit along these states, without an effect on the
objective. In this case, the problem has no central path, and the gains on these states are arbitrary. The unobservable states
are therefore removed. The problem for the remaining states has the same optimum, and its solution gives the gain on the
remaining states. The gain on the removed states is F; this gain is zero if z weights the force separately.

In (25), X and Y must satisfy (12). In the coordinates of [Q R], the space of removed states is therefore the sum of a part in
Q, on which F is zero, and a part in R.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.analysis.certificate import bounded_real_matrix
from synth.lmi.output_nulling import RANK, complement, in_balanced_coordinates, output_nulling_gains, output_nulling_subspace
from synth.plant.generalized import Plant
from synth.plant.units import own_units

ROUNDING = 1e-15  # relative rounding error, after a few rotations, of an entry that should be zero
# variance that is added to the unobservable states, relative to the mean variance; without it, states that no disturbance
# reaches would have the variance 0
UNDRIVEN = 1e-6


@dataclass(frozen=True, eq=False)
class UnobservableReduction:
    """Plant without those stable states that are unobservable in z, and the transformation back to the whole plant.

    Attributes:
        rest: plant of the k remaining states.
        Q: matrix Q of the remaining plant, shape (k, a').
        R: matrix R of the remaining plant, shape (k, q').
        Z: coordinates of the whole plant, with the remaining states first, shape (n, n).
        whole: whole plant in the coordinates Z, with the loop closed by F.
        narrow: matrix from the coordinates that R of the whole plant spans to the coordinates that R of the remaining plant
            spans, shape (q', q).
        F: gain on the coordinates that R spans, shape (m, q).
        step: sample period of a discrete plant [s]; 0 for a continuous plant.
    """

    rest: Plant
    Q: Array
    R: Array
    Z: Array
    whole: Plant
    narrow: Array
    F: Array
    step: float = 0.0

    def gain(self, K: Array) -> Array:
        """Returns the gain for the whole plant that follows from a gain K for the remaining plant, shape (m, q)."""
        return K @ self.narrow + self.F

    def completed_x(self, K: Array, X: Array, eta: float) -> Array:
        """Returns an X for the whole plant that follows from an X for the remaining plant, shape (n, n).

        The result is the covariance of all states of the closed loop, if white noise gives the remaining states the covariance
        X.
        """
        loop, k = self._loop(K), len(X)
        A, follows, A2 = loop.A[:k, :k], loop.A[k:, :k], loop.A[k:, k:]
        Bw, Bw2 = loop.Bw[:k], loop.Bw[k:]
        X12 = linalg.solve_sylvester(A, A2.T, -(X @ follows.T + eta * Bw @ Bw2.T)) if k else np.zeros((0, len(A2)))
        X22 = linalg.solve_continuous_lyapunov(A2, -(follows @ X12 + X12.T @ follows.T + eta * Bw2 @ Bw2.T))
        decay = linalg.solve_continuous_lyapunov(A2, -np.eye(len(A2)))
        spread = float(np.trace(X) + np.trace(X22)) / len(loop.A) or 1.0
        X22 += UNDRIVEN * spread * len(A2) / np.trace(decay) * decay
        return self.Z @ np.block([[X, X12], [X12.T, (X22 + X22.T) / 2]]) @ self.Z.T

    def proof(self, K: Array, X: Array, eta: float) -> Array:
        """Returns an X for the whole plant that proves the same bound, in which the part for the removed states is large
        enough.
        """
        loop, k = self._loop(K), len(X)
        inside = np.linalg.inv(self.Z)
        whole = inside @ self.completed_x(K, X, eta) @ inside.T
        M = bounded_real_matrix(loop, whole, np.zeros_like(loop.B.T), eta)
        n = len(loop.A)
        kept = np.r_[0:k, n : len(M)]
        missing = M[k:n, k:n] - M[k:n][:, kept] @ np.linalg.solve(M[np.ix_(kept, kept)], M[kept][:, k:n])
        needed = max(float(np.linalg.eigvalsh((missing + missing.T) / 2)[-1]), 0.0) + np.trace(whole[k:, k:]) * RANK
        whole[k:, k:] += 2 * needed * linalg.solve_continuous_lyapunov(loop.A[k:, k:], -np.eye(n - k))
        return self.Z @ whole @ self.Z.T

    def _loop(self, K: Array) -> Plant:
        """Returns the closed loop in the coordinates of Z; for a discrete plant, its bilinear image, which has the same X."""
        from synth.plant.discrete import from_differences

        gain = np.hstack([K @ self.R.T, np.zeros((len(K), len(self.whole.A) - len(self.rest.A)))])
        return from_differences(self.whole.closed_loop(gain), self.step)


def remove_unobservable(plant: Plant, Q: Array, R: Array, step: float) -> UnobservableReduction | None:
    """Removes those states that can be made unobservable in z without violating (12). Returns None if no states can be made
    unobservable.

    Args:
        plant: plant with n states, without measurements.
        Q: matrix of shape (n, n - q).
        R: matrix of shape (n, q) for which [Q R] is invertible.
        step: sample period of a discrete plant [s]; 0 for a continuous plant.
    """
    a = Q.shape[1]
    T = np.hstack([Q, R])
    moved, lengths = in_balanced_coordinates(plant, T)
    for F in output_nulling_gains(moved):
        V = output_nulling_subspace(moved, F, step)[0]
        in_q, in_r = _invariant_bases(moved, F, V, a)
        out_q, out_r = complement(in_q[:a]), complement(in_r[a:])
        k, left = out_q.shape[1], in_q.shape[1] + in_r.shape[1]
        if not left:
            continue
        # In dimensionless units, the remaining states are orthogonal to the removed states, so the result does not depend on
        # units.
        own = T / lengths / own_units(plant).exact[0][:, None]
        kept_q, kept_r = _dual_basis(out_q, own[:, :a]), _dual_basis(out_r, own[:, a:])
        Z = np.hstack([np.asarray(linalg.block_diag(kept_q, kept_r)), in_q, in_r])
        F_r = F @ in_r @ in_r.T
        whole = moved.closed_loop(F_r).in_coordinates(Z)
        n = len(whole.A) - left
        # If A should be zero, a rounding error in A would look like a rate of the plant.
        turned = np.linalg.norm(moved.A) + np.linalg.norm(moved.B) * np.linalg.norm(F_r)
        A = np.where(np.abs(whole.A[:n, :n]) > ROUNDING * turned, whole.A[:n, :n], 0.0)
        rest = Plant(A, whole.B[:n], whole.Bw[:n], whole.C[:, :n], whole.D, whole.Dw)
        kept = np.eye(n)
        narrow, F_k = out_r.T * lengths[a:], F_r[:, a:] * lengths[a:]
        return UnobservableReduction(rest, kept[:, :k], kept[:, k:], T / lengths @ Z, whole, narrow, F_k, step)
    return None


def _invariant_bases(plant: Plant, F: Array, V: Array, a: int) -> tuple[Array, Array]:
    """Returns bases of the spaces V_q and V_r, whose sum is the largest (A + B F)-invariant subspace of V with the following
    structure.

    V_q lies in the first `a` coordinates and satisfies F V_q = 0. V_r lies in the remaining coordinates.
    """
    loop, size = plant.closed_loop(F) if F.any() else plant, float(np.linalg.norm(plant.A)) or 1.0
    in_q, in_r = V @ _null(V[a:]), V @ _null(V[:a])
    in_q = in_q @ _null(F @ in_q / (np.linalg.norm(F) or 1.0))
    while True:
        both = np.hstack([in_q, in_r])
        less_q, less_r = (part @ _null((loop.A @ part - both @ (both.T @ loop.A @ part)) / size) for part in (in_q, in_r))
        if less_q.shape == in_q.shape and less_r.shape == in_r.shape:
            return in_q, in_r
        in_q, in_r = less_q, less_r


def _null(M: Array) -> Array:
    """Returns an orthonormal basis of the nullspace of M, with the tolerance RANK, shape (columns, k)."""
    _, sizes, directions = np.linalg.svd(M)
    return directions[int(np.sum(sizes > RANK)) :].T


def _dual_basis(out: Array, T: Array) -> Array:
    """Returns the dual basis of the columns of `out`, shape (n, k).

    In the coordinates T x, the dual basis is orthogonal to the complement of `out`.

    Args:
        out: matrix with orthonormal columns, shape (n, k).
        T: coordinate transformation, shape (N, n).
    """
    if not out.shape[1]:
        return out
    _, low = np.linalg.qr(T)
    across = np.linalg.solve(low, np.linalg.solve(low.T, out))
    return across @ np.linalg.inv(out.T @ across)
