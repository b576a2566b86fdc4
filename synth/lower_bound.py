"""What no controller can beat: lower bounds on the norm, proved by dual solutions and recomputed with numpy.

**State feedback**, problem (22). Any positive semidefinite Z with [B' D'] Z[:, :n] = 0 and
H = A' Z11 + Z11 A + C' Z21 + Z12 C >= 0 pairs with (21) to

    0 >= <Z, F(X, Y, eta)> = -tr Z22 + <H, X> + eta <Z, E>,     E = [Bw; Dw] [Bw; Dw]',

so eta <= tr Z22 / <Z, E>. A controller that knows x and more, dynamic or nonlinear, does no better (Khargonekar, Petersen, Rotea
1988): the bound holds for every controller.

**Inputs that cost nothing**, D v = 0, let X grow without bound along B v, and along A B v, ... as far as C does not see it
(`steered`, an orthonormal F). Of X remains M'X = X1 M' + X2 F', M a basis of the complement: (21) again, for the `reduced_plant`
whose states are M'x and whose inputs are u and F'x, with X1 and Y = [M'Y.., X2] in their places.

**Output feedback** of any order from y = C_y x. By Gahinet and Apkarian (1994) gamma is reached only if there are R, S with
[R I; I S] >= 0, of which R solves (21) and S the same inequality of the transposed plant, both without the controller's terms.
As y is free of w, the same reduction, transposed, leaves N'S = S11 N' + S12 N_y', N_y what y shows (`shown`): (21) for the
`observer_plant` of the states that y does not show, with X = S11 / gamma^2. The two are coupled by [S11 N'M; M'N X1] >= 0. Each
has dual matrices Z as above, and with V = H of each and the best off-diagonal block, <V, [S11 N'M; M'N X1]> >= 0 gives

    gamma^2 >= largest eigenvalue of [ e1 / t1, . ; f (e1 / t2)^1/2 / t1, (f^2 / t1 + e2) / t2 ],

e = <Z, E>, t = tr Z22, f the sum of the singular values of H2^1/2 N'M H1^1/2. The first entry is the bound for state feedback.

On the central path (-F)^-1 is such a Z: stationarity in Y is the first condition, and H > 0 the second. What rounding and an
early stop leave of the first is taken out by a projection, and numpy computes the bound from what is left.
"""

from dataclasses import dataclass

import numpy as np

from models.arrays import Array
from synth.bounded_real import bounded_real_matrix
from synth.plant import GeneralizedPlant

RANK = 1e-9  # relative; a direction that is smaller counts as none


@dataclass(frozen=True, eq=False)
class Witness:
    """A strictly feasible point of (21) whose inverse matrix is the dual solution.

    Attributes:
        X: shape (n, n).
        K: shape (m, n).
        eta: gamma^-2.
    """

    X: Array
    K: Array
    eta: float


@dataclass(frozen=True, eq=False)
class LowerBound:
    """No controller of a kind reaches a smaller norm.

    Attributes:
        gamma: the bound; 0, which is always true, where nothing is proved.
        state: witness of (21) for the `reduced_plant`; None where the limit alone proves the bound.
        observer: witness for the `observer_plant`; None where the bound is that of state feedback.
        limit_at: frequency [rad/s] where `limit.uncontrolled` proves the bound; None where the witnesses do.
    """

    gamma: float
    state: Witness | None = None
    observer: Witness | None = None
    limit_at: float | None = None


def lower_bound(plant: GeneralizedPlant, state: Witness, Cy: Array | None = None, observer: Witness | None = None) -> LowerBound:
    """The bound that witnesses prove. Short of the limit of the path it is weaker, by (2 n + d) mu, and rounds less.

    Args:
        plant: n states, m inputs.
        state: of the `reduced_plant`.
        Cy: shape (q, n); given with an observer.
        observer: of the `observer_plant`.
    """
    first = _dual(reduced_plant(plant), state)
    if first is None:
        return LowerBound(0.0, state, observer)
    alone = first.e / first.t
    if observer is None or Cy is None:
        return LowerBound(alone**0.5, state)
    second = _dual(observer_plant(plant, Cy), observer)
    if second is None:
        return LowerBound(alone**0.5, state)
    joined = second.root.T @ meeting(plant, Cy, second.T, first.T) @ first.root
    f = float(np.linalg.svd(joined, compute_uv=False).sum())
    corner = f * (first.e / second.t) ** 0.5 / first.t
    both = np.array([[alone, corner], [corner, (f**2 / first.t + second.e) / second.t]])
    return LowerBound(float(np.linalg.eigvalsh(both)[-1]) ** 0.5, state, observer)


def meeting(plant: GeneralizedPlant, Cy: Array, observer: Array, state: Array) -> Array:
    """N'M in other coordinates of the observer's states and of the state's: T_o^-1 N'M T_s^-T."""
    N, M = complement(shown(plant, Cy)), complement(steered(plant))
    return np.linalg.solve(observer, np.linalg.solve(state, M.T @ N).T)


def shown(plant: GeneralizedPlant, Cy: Array) -> Array:
    """What y and those of its derivatives show that are free of w: orthonormal rows, shape (q' >= q, n).

    G C_y Bw = 0 makes G y' = G C_y A x + (known) another measurement, and so on.
    """
    return _closed(Cy, plant.A, plant.Bw)


def steered(plant: GeneralizedPlant) -> Array:
    """F': what inputs steer at no cost, and what they steer through it, likewise: orthonormal rows, shape (f, n)."""
    strengths, directions = np.linalg.svd(plant.D)[1:]
    costly = int(np.sum(strengths > RANK * strengths.max(initial=0.0)))
    return _closed((plant.B @ directions[costly:].T).T, plant.A.T, plant.C.T)


def _closed(rows: Array, A: Array, Bw: Array) -> Array:
    """The smallest row space that holds rows and, with any g of it for which g Bw = 0, also g A. Orthonormal, shape (k, n).

    A direction too many by rounding only weakens a bound.
    """
    n = len(A)
    while True:
        lengths = np.linalg.norm(rows, axis=1)
        rows = rows[lengths > 0] / lengths[lengths > 0, None]
        if not len(rows):
            return np.zeros((0, n))
        _, sizes, directions = np.linalg.svd(rows)
        rows = directions[: int(np.sum(sizes > RANK * sizes[0]))]
        if len(rows) == n:
            return rows
        left, sizes, _ = np.linalg.svd(rows @ Bw)
        free = left[:, int(np.sum(sizes > RANK * np.linalg.norm(Bw))) :].T
        more = free @ rows @ A
        more = more - more @ rows.T @ rows
        more = more[np.linalg.norm(more, axis=1) > RANK * np.linalg.norm(A)]
        if not len(more):
            return rows
        rows = np.vstack([rows, more])


def complement(rows: Array) -> Array:
    """An orthonormal basis of the nullspace of orthonormal rows of shape (k, n), shape (n, n - k), by numpy alone."""
    return np.linalg.svd(rows)[2][len(rows) :].T if len(rows) else np.eye(rows.shape[1])


def reduced_plant(plant: GeneralizedPlant) -> GeneralizedPlant:
    """The plant of the states that are not steered at no cost; those that are act as inputs, beside u."""
    rows = steered(plant)
    M = complement(rows)
    reduced = GeneralizedPlant(
        A=M.T @ plant.A @ M,
        B=np.hstack([M.T @ plant.B, M.T @ plant.A @ rows.T]),
        Bw=M.T @ plant.Bw,
        C=plant.C @ M,
        D=np.hstack([plant.D, plant.C @ rows.T]),
        Dw=plant.Dw,
    )
    return reduced.with_inputs(reduced.independent_inputs()) if len(rows) else plant


def observer_plant(plant: GeneralizedPlant, Cy: Array) -> GeneralizedPlant:
    """The transposed plant of the states that y = C_y x does not show; its inputs are corrections by what y shows."""
    rows = shown(plant, Cy)
    N = complement(rows)
    observer = GeneralizedPlant(
        A=(N.T @ plant.A @ N).T,
        B=(rows @ plant.A @ N).T,
        Bw=(plant.C @ N).T,
        C=(N.T @ plant.Bw).T,
        D=(rows @ plant.Bw).T,
        Dw=plant.Dw.T,
    )
    return observer.with_inputs(observer.independent_inputs())


@dataclass(frozen=True, eq=False)
class _Dual:
    """e = <Z, E>, t = tr Z22, and H = T^-T root root' T^-1."""

    e: float
    t: float
    root: Array
    T: Array


def _dual(plant: GeneralizedPlant, witness: Witness) -> _Dual | None:
    """What a witness proves; None where it proves nothing."""
    n = len(plant.A)
    try:
        # In the coordinates of the witness X is I, Y is 0 and on the path H is I: there a projection leaves H positive.
        T = np.linalg.cholesky(witness.X)
        moved = plant.closed_loop(witness.K).in_coordinates(T)
        S = -bounded_real_matrix(moved, np.eye(n), np.zeros_like(witness.K), witness.eta)
        if np.diagonal(S).min() <= 0:
            return None
        size = 1 / np.sqrt(np.diagonal(S))
        Z = size[:, None] * np.linalg.inv(size[:, None] * S * size) * size
        # Z loses its part along the inputs in its own metric, a Schur complement: the rest stays positive semidefinite.
        inputs = np.vstack([moved.B, moved.D])
        along = np.linalg.qr(inputs / np.maximum(np.linalg.norm(inputs, axis=0), 1e-300))[0]
        Z = Z - Z @ along @ np.linalg.solve(along.T @ Z @ along, along.T @ Z)
        Z = (Z + Z.T) / 2
        H = moved.A.T @ Z[:n, :n] + Z[:n, n:] @ moved.C
        root = np.linalg.cholesky(H + H.T)
    except np.linalg.LinAlgError:
        return None
    disturbance = np.vstack([moved.Bw, moved.Dw])
    e, t = float(np.sum(disturbance * (Z @ disturbance))), float(np.trace(Z[n:, n:]))
    return _Dual(e, t, root, T) if e >= 0 and t > 0 and np.isfinite(e / t) else None
