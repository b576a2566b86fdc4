"""What a plant does from one sample to the next while its inputs are held and its disturbance goes on, as a discrete plant.

Over a period of T seconds z is a function, and so is w. For a level gamma there is a discrete plant with as many states,

    x[k+1] = Ad x[k] + Bd w_d[k],    z_d[k] = Cd x[k],

such that whatever loop is closed around either at the samples, the L2 gain from w to z is below gamma exactly where the l2 gain
from w_d to z_d is below 1 (Bamieh, Pearson 1992; Kabamba, Hara 1993). With the held inputs v as states that stand still, and w in
units of gamma,

    H = [A + Bw R Dw' C, Bw R Bw'; -C' (I + Dw R Dw') C, -A' - C' Dw R Bw'],    R = (I - Dw' Dw)^-1,    S = exp(T H),

    Ad = S22^-T,    Bd Bd' = S12 S22^-1,    Cd' Cd = -S22^-1 S21,

where S22 is regular for all times in (0, T]. Where it is not, w gains gamma or more within one period, between two samples, where
no force answers it.

S itself grows with the period without end. So the three are computed of a short time, and doubled: of two stretches of time,

    Ad = Ad2 M Ad1,    Bd Bd' = Bd2 Bd2' + Ad2 M Bd1 Bd1' Ad2',    Cd' Cd = Cd1' Cd1 + Ad1' Cd2' Cd2 M Ad1,

with M = (I - Bd1 Bd1' Cd2' Cd2)^-1, and the whole is regular exactly where both parts are and Bd1 Bd1' Cd2' Cd2 has no eigenvalue
of 1 or more: what the first part can bring about is worth less than it costs. Nothing cancels, and Ad - I is computed by itself,
as it is small at a fast sample.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from synth.certificate.stability import balance
from synth.plant import GeneralizedPlant

SHORT = 0.5  # of H times the short time: S22 is then within 0.65 of I, and regular
TERMS = 14  # of the series of S: the next is 0.5^15 / 15!, below 1e-16


@dataclass(frozen=True, eq=False)
class Lifted:
    """The discrete plant of a level; its states are the plant's and the inputs that are held over the period.

    Attributes:
        moved: Ad - I, shape (n + k, n + k).
        reached: Bd Bd', shape (n + k, n + k).
        cost: Cd' Cd, shape (n + k, n + k).
    """

    moved: Array
    reached: Array
    cost: Array

    @property
    def Ad(self) -> Array:
        """Shape (n + k, n + k)."""
        return np.eye(len(self.moved)) + self.moved

    @property
    def Bd(self) -> Array:
        """A root of Bd Bd', shape (n + k, n + k)."""
        return _root(self.reached)

    @property
    def Cd(self) -> Array:
        """A root of Cd' Cd, shape (n + k, n + k)."""
        return _root(self.cost).T

    def then(self, later: "Lifted") -> "Lifted | None":
        """This stretch of time and a later one as one; None where w gains the level or more within it."""
        product = self.reached @ later.cost
        # No eigenvalue is larger than the norm, which costs little.
        if not (np.linalg.norm(product) < 1 or np.abs(np.linalg.eigvals(product)).max(initial=0.0) < 1):
            return None
        more = np.linalg.solve(np.eye(len(product)) - product, np.hstack([product, self.reached]))  # M - I, M Bd1 Bd1'
        between, reached = more[:, : len(product)], more[:, len(product) :]
        first, second = self.Ad, later.Ad
        moved = self.moved + later.moved + later.moved @ self.moved + second @ between @ first
        cost = later.cost + later.cost @ between
        return Lifted(
            moved,
            later.reached + second @ _symmetric(reached) @ second.T,
            self.cost + first.T @ _symmetric(cost) @ first,
        )


def lifted(plant: GeneralizedPlant, pieces: Sequence[tuple[float, Array]], gamma: float) -> Lifted | None:
    """The discrete plant of a level over one period; None where w gains gamma or more within it.

    Args:
        plant: n states, m inputs.
        pieces: of the period: how long [s], and which of the k held inputs act meanwhile, shape (m, k).
        gamma: the level.
    """
    if gamma <= np.linalg.norm(plant.Dw, 2):
        return None
    whole: Lifted | None = None
    for duration, acting in pieces:
        piece = _piece(plant, duration, acting, gamma)
        if piece is None:
            return None
        whole = piece if whole is None else whole.then(piece)
        if whole is None:
            return None
    assert whole is not None, "a period has a piece"
    return whole


def with_inputs(plant: GeneralizedPlant, acting: Array) -> tuple[Array, Array, Array]:
    """A, Bw and C of a plant whose states are its own and k held inputs, of which those act that a matrix (m, k) says."""
    n, k = len(plant.A), acting.shape[1]
    A, Bw = np.zeros((n + k, n + k)), np.zeros((n + k, plant.Bw.shape[1]))
    A[:n, :n], A[:n, n:], Bw[:n] = plant.A, plant.B @ acting, plant.Bw
    return A, Bw, np.hstack([plant.C, plant.D @ acting])


def _piece(plant: GeneralizedPlant, duration: float, acting: Array, gamma: float) -> Lifted | None:
    """The same of one piece, by doubling a short time."""
    A, Bw, C = with_inputs(plant, acting)
    A, Bw, C, scale = in_own_units(A, Bw / gamma, C, len(plant.A))
    n = len(A)
    if np.any(plant.Dw):
        Dw = plant.Dw / gamma
        R = np.linalg.inv(np.eye(Dw.shape[1]) - Dw.T @ Dw)
        A, driven, seen = A + Bw @ R @ Dw.T @ C, Bw @ R @ Bw.T, C.T @ (np.eye(len(Dw)) + Dw @ R @ Dw.T) @ C
    else:
        driven, seen = Bw @ Bw.T, C.T @ C
    H = np.block([[A, driven], [-seen, -A.T]])
    doublings = max(0, math.ceil(math.log2(max(duration * float(np.linalg.norm(H, 1)) / SHORT, 1e-300))))
    step = duration / 2**doublings * H
    change = step  # S - I, by its series
    for term in range(TERMS, 1, -1):
        change = step + step @ change / term
    inverse = np.linalg.inv(np.eye(n) + change[n:, n:])
    found: Lifted | None = Lifted(
        -(inverse @ change[n:, n:]).T, _symmetric(change[:n, n:] @ inverse), _symmetric(-inverse @ change[n:, :n])
    )
    for _ in range(doublings):
        assert found is not None
        found = found.then(found)
        if found is None:
            return None
    assert found is not None
    return Lifted(
        found.moved * scale[:, None] / scale, found.reached * np.outer(scale, scale), found.cost / np.outer(scale, scale)
    )


def in_own_units(A: Array, Bw: Array, C: Array, n: int) -> tuple[Array, Array, Array, Array]:
    """The same with states, of which the first n move, in units in which H is small; and those units."""
    scale = np.ones(len(A))
    _, scale[:n] = balance(A[:n, :n])
    driven, seen = np.linalg.norm(Bw[:n] / scale[:n, None]), np.linalg.norm(C[:, :n] * scale[:n])
    if driven and seen:
        scale[:n] *= math.sqrt(driven / seen)
    largest = max(float(np.linalg.norm(A[:n, :n] * scale[:n] / scale[:n, None])), float(np.sqrt(driven * seen)))
    for i in range(n, len(A)):  # a held input's unit: small enough that it does not count
        size = max(float(np.linalg.norm(A[:n, i] / scale[:n])), float(np.linalg.norm(C[:, i])))
        scale[i] = largest / size if size else 1.0
    return A * scale / scale[:, None], Bw / scale[:, None], C * scale, scale


def _symmetric(matrix: Array) -> Array:
    return (matrix + matrix.T) / 2


def _root(matrix: Array) -> Array:
    """L with L L' a matrix that is symmetric and positive semidefinite, but for rounding; each row has its own unit."""
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    unit = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(matrix / np.outer(unit, unit))
    return unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
