"""Sampled-data loops: a continuous plant with sampled measurements and held inputs, lifted to a discrete plant.

During a sample period of T seconds, z and w are functions of time. For a level gamma of the L2 gain, there is a discrete plant
with the same number of states as the continuous plant,

    x[k+1] = Ad x[k] + Bd w_d[k],    z_d[k] = Cd x[k].

Consider any controller that acts only at the samples. The L2 gain from w to z is below gamma if and only if the l2 gain from
w_d to z_d is below 1 (Bamieh, Pearson 1992; Kabamba, Hara 1993). If the held inputs are constant states of the plant, and w is
in units of gamma, the matrices of the discrete plant are

    H = [A + Bw R Dw' C, Bw R Bw'; -C' (I + Dw R Dw') C, -A' - C' Dw R Bw'],    R = (I - Dw' Dw)^-1,    S = exp(T H),

    Ad = S22^-T,    Bd Bd' = S12 S22^-1,    Cd' Cd = -S22^-1 S21,

if the matrix S22 is invertible at all times in (0, T]. If S22 is singular at some time in (0, T], the gain within one period is
at least gamma, before any force can respond to w.

The entries of S grow without bound as the period T grows. Therefore, Ad, Bd Bd' and Cd' Cd are first computed for a short time
interval, whose length is then doubled repeatedly. For two consecutive intervals 1 and 2, the matrices of the combined interval
are

    Ad = Ad2 M Ad1,    Bd Bd' = Bd2 Bd2' + Ad2 M Bd1 Bd1' Ad2',    Cd' Cd = Cd1' Cd1 + Ad1' Cd2' Cd2 M Ad1,

where M = (I - Bd1 Bd1' Cd2' Cd2)^-1. The matrices of the combined interval exist if and only if both intervals have them and
all eigenvalues of Bd1 Bd1' Cd2' Cd2 are below 1. Doubling the time in this way loses no digits by cancellation. The code
computes the difference Ad - I instead of Ad, because the difference is small if the sample rate is high.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np

from models.common.arrays import Array
from models.common.checks import AT_LEAST_ONE, CheckedFields, Matrix, NotNegative, PositiveTime, check_arguments, check_shape
from synth.analysis.stability import balance
from synth.plant.generalized import Plant, check_states
from synth.plant.loop import HoldInterval, hold_intervals
from synth.plant.state_space import StateSpace

SHORT = 0.5  # largest norm of H times the short time; S22 then differs from I by at most 0.65 and is therefore invertible
TERMS = 14  # number of terms in the series of S; the first omitted term is 0.5^15 / 15!, which is below 1e-16


@dataclass(frozen=True, eq=False)
class LiftedPlant:
    """Discrete plant that is equivalent to a continuous plant for one level of the L2 gain. The states of the discrete plant
    are the n plant states and the k held inputs.

    Attributes:
        increment: Ad - I, for the state matrix Ad of the discrete plant, shape (n + k, n + k).
        BdBd: Bd Bd', for the input matrix Bd, shape (n + k, n + k).
        CdCd: Cd' Cd, for the output matrix Cd, shape (n + k, n + k).
    """

    increment: Array
    BdBd: Array
    CdCd: Array

    @property
    def Ad(self) -> Array:
        """State matrix Ad, shape (n + k, n + k)."""
        return np.eye(len(self.increment)) + self.increment

    @property
    def Bd(self) -> Array:
        """Input matrix Bd, computed as a square root of `BdBd`, shape (n + k, n + k)."""
        return _root(self.BdBd)

    @property
    def Cd(self) -> Array:
        """Output matrix Cd, computed as a square root of `CdCd`, shape (n + k, n + k)."""
        return _root(self.CdCd).T

    def followed_by(self, later: "LiftedPlant") -> "LiftedPlant | None":
        """Returns the discrete plant over an interval that joins this interval and the next one.

        The result is None if the gain within the combined interval is at least the level.
        """
        product = self.BdBd @ later.CdCd
        # No eigenvalue exceeds the norm, and the norm is fast to compute, so the norm is tried first.
        if not (np.linalg.norm(product) < 1 or np.abs(np.linalg.eigvals(product)).max(initial=0.0) < 1):
            return None
        # computes the matrices M - I and M Bd1 Bd1'
        more = np.linalg.solve(np.eye(len(product)) - product, np.hstack([product, self.BdBd]))
        between, reached = more[:, : len(product)], more[:, len(product) :]
        first, second = self.Ad, later.Ad
        increment = self.increment + later.increment + later.increment @ self.increment + second @ between @ first
        cost = later.CdCd + later.CdCd @ between
        return LiftedPlant(
            increment, later.BdBd + second @ _symmetric(reached) @ second.T, self.CdCd + first.T @ _symmetric(cost) @ first
        )


def lift_plant(plant: Plant, pieces: Sequence[tuple[float, Array]], gamma: float) -> LiftedPlant | None:
    """Returns the discrete plant for a level gamma over one period; None if the gain within the period is at least gamma.

    Args:
        plant: plant in continuous time with m inputs.
        pieces: duration [s] of each part of the period, and the matrix, shape (m, k), that selects the m acting inputs from the
            k held inputs.
        gamma: level of the L2 gain for which the discrete plant is equivalent to the continuous plant.
    """
    if gamma <= np.linalg.norm(plant.Dw, 2):
        return None
    whole: LiftedPlant | None = None
    for duration, acting in pieces:
        piece = _piece(plant, duration, acting, gamma)
        if piece is None:
            return None
        whole = piece if whole is None else whole.followed_by(piece)
        if whole is None:
            return None
    assert whole is not None, "a period has a piece"
    return whole


def with_inputs(plant: Plant, acting: Array) -> tuple[Array, Array, Array]:
    """Returns A, Bw and C of the plant with k held inputs as additional states.

    `acting`, shape (m, k), selects the m inputs that act on the plant.
    """
    n, k = len(plant.A), acting.shape[1]
    A, Bw = np.zeros((n + k, n + k)), np.zeros((n + k, plant.Bw.shape[1]))
    A[:n, :n], A[:n, n:], Bw[:n] = plant.A, plant.B @ acting, plant.Bw
    return A, Bw, np.hstack([plant.C, plant.D @ acting])


def _piece(plant: Plant, duration: float, acting: Array, gamma: float) -> LiftedPlant | None:
    """Returns the discrete plant over one part of the period; a short time is doubled repeatedly until it covers this part."""
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
    change = step  # the matrix S - I, computed from the series of S
    for term in range(TERMS, 1, -1):
        change = step + step @ change / term
    inverse = np.linalg.inv(np.eye(n) + change[n:, n:])
    whole: LiftedPlant | None = LiftedPlant(
        -(inverse @ change[n:, n:]).T, _symmetric(change[:n, n:] @ inverse), _symmetric(-inverse @ change[n:, :n])
    )
    for _ in range(doublings):
        assert whole is not None
        whole = whole.followed_by(whole)
        if whole is None:
            return None
    assert whole is not None
    return LiftedPlant(
        whole.increment * scale[:, None] / scale, whole.BdBd * np.outer(scale, scale), whole.CdCd / np.outer(scale, scale)
    )


def in_own_units(A: Array, Bw: Array, C: Array, n: int) -> tuple[Array, Array, Array, Array]:
    """Returns A, Bw and C in state units that make the Hamiltonian matrix H small, and these units, shape (N,).

    Only the first n states have dynamics; the other states are constant.
    """
    scale = np.ones(len(A))
    _, scale[:n] = balance(A[:n, :n])
    driven, seen = np.linalg.norm(Bw[:n] / scale[:n, None]), np.linalg.norm(C[:, :n] * scale[:n])
    if driven and seen:
        scale[:n] *= math.sqrt(driven / seen)
    largest = max(float(np.linalg.norm(A[:n, :n] * scale[:n] / scale[:n, None])), float(np.sqrt(driven * seen)))
    # the unit of a held input is chosen so small that the input's entries do not exceed the other entries
    for i in range(n, len(A)):
        size = max(float(np.linalg.norm(A[:n, i] / scale[:n])), float(np.linalg.norm(C[:, i])))
        scale[i] = largest / size if size else 1.0
    return A * scale / scale[:, None], Bw / scale[:, None], C * scale, scale


def _symmetric(matrix: Array) -> Array:
    return (matrix + matrix.T) / 2


def _root(matrix: Array) -> Array:
    """Returns L with L L' = matrix.

    The matrix to be decomposed must be positive semidefinite up to rounding. The rows of this matrix may have different units.
    """
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    unit = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(matrix / np.outer(unit, unit))
    return unit[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))


@dataclass(frozen=True, eq=False)
class SampledLoop(CheckedFields):
    """Closed loop of a continuous plant and a discrete controller, with sampled measurements.

    At a sample, let x be the states of the plant, s the states of the controller, and p = [x; s]. Then

        u = K p,    s+ = A_register p + B_register u_a,

    where u_a denotes the force that acts at the end of the period. The measurement noise is a sequence e. The energy of e is
    the sum of the squared values of e. The matrix `noise` times the vector e is added to the computed forces u and the next
    controller states s+.

    Attributes:
        plant: plant in continuous time with n states and m inputs.
        pieces: parts of the sample period in which the acting forces are constant, in order of time.
        K: gain from p to the computed forces, shape (m, n + k).
        A_register: matrix from p to the next controller states, shape (k, n + k).
        B_register: matrix from the acting force u_a to the next controller states, shape (k, m).
        noise: matrix from the noise to the computed forces and the next controller states, shape (m + k, j); None without
            noise.
    """

    plant: Plant
    pieces: Annotated[tuple[HoldInterval, ...], AT_LEAST_ONE]
    K: Matrix
    A_register: Matrix
    B_register: Matrix
    noise: Matrix | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        (n, m), k = self.plant.B.shape, len(self.A_register)
        check_states(n)
        check_shape("K", self.K, (m, n + k), f"as the plant has {n} states and {m} inputs, and A_register has {k} rows")
        check_shape("A_register", self.A_register, (k, n + k), f"as A_register has {k} rows and the plant has {n} states")
        check_shape("B_register", self.B_register, (k, m), f"as A_register has {k} rows and the plant has {m} inputs")
        if self.noise is not None:
            expected = (m + k, self.noise.shape[1])
            check_shape("noise", self.noise, expected, f"one row for each of the {m} inputs and the {k} rows of A_register")

    @classmethod
    @check_arguments
    def of_gain(cls, plant: Plant, K: Matrix, Cy: Matrix, sample_period: PositiveTime, delay: NotNegative = 0.0) -> "SampledLoop":
        """Returns the sampled-data loop of a static gain, with u = K y at every sample.

        Args:
            plant: plant in continuous time with n states and m inputs.
            K: gain, shape (m, q).
            Cy: matrix of the measurements y = C_y x, shape (q, n).
            sample_period: sample period [s].
            delay: delay [samples] from a measurement to the force that is computed from this measurement; may be fractional.

        Returns:
            Sampled-data loop.

        Raises:
            InputError: a matrix does not fit the plant.
        """
        (n, m), q = plant.B.shape, len(Cy)
        check_shape("Cy", Cy, (q, n), f"one column for each of the {n} states of the plant")
        check_shape("K", K, (m, q), f"as the plant has {m} inputs, and Cy has {q} rows")
        return cls.of_law(replace(plant.unmeasured, Cy=Cy), K, hold_intervals(sample_period, delay), np.zeros((q, 0)))

    @classmethod
    def of_law(cls, plant: Plant, law: Array, pieces: tuple[HoldInterval, ...], noise: Array) -> "SampledLoop":
        """Returns the sampled-data loop of a static gain, or of a discrete control law with k states.

        Args:
            plant: plant with n states, m inputs and q measurements y = C_y x + Dyu u + `noise` e. In y = C_y x + Dyu u +
                `noise` e, u is the force just before the sample at which y is measured.
            law: matrix [D, C; B, A] of the law, shape (m + k, q + k); for k = 0, the gain itself.
            pieces: parts of the sample period with constant forces, in order of time.
            noise: matrix from the noise signals to the measurements, shape (q, j); j may be 0.
        """
        (n, m), q = plant.B.shape, len(plant.Cy)
        k, previous = len(law) - m, m if np.any(plant.Dyu) else 0
        rows = np.hstack([plant.Cy, np.zeros((q, k)), plant.Dyu[:, :previous]])
        computed = law[:, :q] @ rows
        computed[:, n : n + k] += law[:, q:]
        memory = np.vstack([computed[m:], np.zeros((previous, n + k + previous))])
        heard = np.vstack([law[:, :q] @ noise, np.zeros((previous, noise.shape[1]))])
        return cls(plant, pieces, computed[:m], memory, np.eye(k + previous, m, -k), heard if heard.size else None)

    @property
    def period(self) -> float:
        """Sample period [s]."""
        return sum(piece.duration for piece in self.pieces)

    @property
    def largest_delay(self) -> int:
        """Largest delay of any force [samples]."""
        return max(piece.delay_samples for piece in self.pieces)

    @property
    def states(self) -> int:
        """Number N of states of the loop: plant states x, controller states s, and delayed forces."""
        return self.K.shape[1] + self.largest_delay * len(self.K)

    @cached_property
    def input_selections(self) -> list[tuple[float, Array]]:
        """Duration [s] of each of the p parts of the period, and the matrix, shape (m, m p), that selects the inputs that act
        in this part.

        Each part of the period has held inputs that act only during this part.
        """
        m, count = len(self.K), len(self.pieces)
        return [(piece.duration, np.kron(np.eye(count)[i], np.eye(m))) for i, piece in enumerate(self.pieces)]

    @cached_property
    def increment(self) -> Array:
        """Transition matrix of [x; held inputs] over one period without disturbance, minus the identity, shape (n + i, n + i)."""
        total = np.zeros((0, 0))
        for duration, acting in self.input_selections:
            A, _, _ = with_inputs(self.plant, acting)
            n = len(A)
            # exp(A t) - I is the integral of exp(A s) A. This integral is computed like the effect of a held input with the
            # input matrix A, which avoids cancellation.
            piece = StateSpace(A, A, A[:0], A[:0]).hold_matrices(duration)[1]
            total = piece if not len(total) else piece + total + piece @ total
            assert len(total) == n
        return total

    @cached_property
    def with_noise(self) -> tuple[Array, Array]:
        """`K` and `A_register`, each with one more column for each noise signal, shapes (m, n + k + j) and (k, n + k + j)."""
        m = len(self.K)
        noise = np.zeros((m + len(self.A_register), 0)) if self.noise is None else self.noise
        return np.hstack([self.K, noise[:m]]), np.hstack([self.A_register, noise[m:]])

    def closed(self, increment: Array) -> tuple[Array, Array]:
        """Returns the transition matrix of the loop minus the identity, and the matrix from the states of the loop to [x; held
        inputs].

        Args:
            increment: transition matrix of [x; held inputs] over one period minus the identity, shape (n + i, n + i).

        Returns:
            The transition matrix minus the identity, shape (N, N + j), and the matrix from the N states to [x; held inputs],
            shape (n + i, N + j). The last j columns belong to the noise signals. Delayed forces are sorted by the time at which
            they act.
        """
        n, (m, known), late = len(self.plant.A), self.K.shape, self.largest_delay
        gain, memory = (np.insert(matrix, [known] * late * m, 0.0, axis=1) for matrix in self.with_noise)
        columns = gain.shape[1]
        forces = [
            np.eye(m, columns, known + (late - one.delay_samples) * m) if one.delay_samples else gain for one in self.pieces
        ]
        start = np.vstack([np.eye(n, columns), *forces])
        shifted = np.eye(max(late - 1, 0) * m, columns, known + m)
        rest = np.vstack([memory + self.B_register @ forces[-1], shifted, *[gain] * (late > 0)])
        return np.vstack([increment[:n] @ start, rest - np.eye(len(rest), columns, n)]), start

    def at_angles(self, increment: Array, angles: Array) -> tuple[Array, Array]:
        """Returns the matrices of the loop at points zeta = exp(j angle) on the unit circle.

        At these points of the unit circle, a delay is a multiplication by a power of zeta, so delayed forces need no states.

        Args:
            increment: transition matrix of [x; held inputs] over one period minus the identity, as in `closed`.
            angles: angles on the unit circle [rad], shape (F,).

        Returns:
            zeta I minus the transition matrix of p, shape (F, n + k, n + k + j), and the matrix from p to [x; held inputs],
            shape (F, n + i, n + k + j). The last j columns belong to the noise signals.
        """
        n, known, turned, (gain, memory) = len(self.plant.A), self.K.shape[1], np.exp(1j * angles), self.with_noise
        columns = gain.shape[1]
        forces = [gain * (turned**-piece.delay_samples)[:, None, None] for piece in self.pieces]
        start = np.concatenate([np.broadcast_to(np.eye(n, columns), (len(angles), n, columns)), *forces], axis=1)
        matrix = np.empty((len(angles), known, columns), dtype=complex)
        step = 2j * np.sin(angles / 2) * np.exp(0.5j * angles)  # the value zeta - 1, computed without cancellation
        matrix[:, :n] = step[:, None, None] * np.eye(n, columns) - increment[:n] @ start
        matrix[:, n:] = turned[:, None, None] * np.eye(known - n, columns, n) - memory - self.B_register @ forces[-1]
        return matrix, start


@dataclass(frozen=True, eq=False)
class SampledDataProblem:
    """Plant whose m forces are held between samples and delayed by a number of samples.

    For a level of the L2 gain, the states of the discrete plant are the plant's states and those previous forces that are
    delayed or measured. The latest of these forces comes first. A static gain feeds back only measurements, not the previous
    forces. A controller that uses its previous output must be given as a control law with states.

    Measurement noise of rms s has the same weight as a road velocity w of 1 m/s. If measurement noise of rms s is held over T
    seconds, its energy is T s^2 in units of w. The noise of a measurement is therefore modelled as s / sqrt(T) times a sequence
    whose energy is the sum of its squared values.

    Attributes:
        plant: plant in continuous time with n states and q measurements. The matrix Dyu of the plant describes the effect on y
            of the force that acts just before a sample.
        pieces: parts of the sample period with constant forces; there are two parts if the delay includes a fraction of a
            period.
        rms: rms noise of each measurement, in the unit of the measurement, shape (q,); None without noise.
    """

    plant: Plant
    pieces: tuple[HoldInterval, ...]
    rms: Array | None = None

    @property
    def period(self) -> float:
        """Sample period [s]."""
        return sum(piece.duration for piece in self.pieces)

    @property
    def before(self) -> int:
        """Age of the force that acts just before a sample: the number of samples since this force was computed."""
        return self.pieces[-1].delay_samples + 1

    @cached_property
    def stored_forces(self) -> int:
        """Number of previous forces of each input that are states of the discrete plant."""
        return max(self.pieces[0].delay_samples, self.before if np.any(self.plant.Dyu) else 0)

    @cached_property
    def rows(self) -> Array:
        """Matrix C_y extended to all states of the discrete plant, shape (q, n + k m), with k = `stored_forces`."""
        (q, m), k = self.plant.Dyu.shape, self.stored_forces
        past = np.zeros((q, k * m))
        if np.any(self.plant.Dyu):
            past[:, (self.before - 1) * m : self.before * m] = self.plant.Dyu
        return np.hstack([self.plant.Cy, past])

    @property
    def without_delay(self) -> "SampledDataProblem":
        """Copy of this problem in which there is no delay and the forces have no effect on the measurements."""
        return replace(self, plant=self.plant.without_feedthrough, pieces=(HoldInterval(self.period, 0),))

    @cached_property
    def noise(self) -> Array:
        """Matrix from a noise sequence of energy 1 to the measurements, shape (q, j), with one column for each noisy
        measurement.
        """
        if self.rms is None:
            return np.zeros((len(self.plant.Cy), 0))
        return np.diag(self.rms)[:, self.rms > 0] / math.sqrt(self.period)

    def of(self, kept: Sequence[int]) -> "SampledDataProblem":
        """Returns the same problem with only those measurements whose indices are in `kept`."""
        rms = None if self.rms is None else self.rms[kept]
        return replace(self, plant=self.plant.rows(kept), rms=rms)

    def loop(self, K: Array) -> SampledLoop:
        """Returns the sampled-data loop of a static gain or discrete law `K`, which is the `law` of `SampledLoop.of_law`."""
        return SampledLoop.of_law(self.plant, K, self.pieces, self.noise)

    def at(self, gamma: float) -> Plant | None:
        """Returns the discrete plant of the level gamma; None if the gain within one period is already at least gamma.

        The norm of a loop with the discrete plant is below 1 if and only if the L2 gain is below gamma. The measurements of the
        returned plant are the matrix `rows` times the states of this plant, plus the noise.
        """
        (n, m), k = self.plant.B.shape, self.stored_forces
        count = len(self.pieces)
        intervals = [(piece.duration, np.eye(m, count * m, i * m)) for i, piece in enumerate(self.pieces)]
        lifted_loop = lift_plant(self.plant, intervals, gamma)
        if lifted_loop is None:
            return None
        # this matrix maps the states and the new force to [x; acting forces]
        start = np.zeros((n + count * m, n + (k + 1) * m))
        start[:n, :n] = np.eye(n)
        for i, piece in enumerate(self.pieces):
            acts = n + ((piece.delay_samples or k + 1) - 1) * m  # the last columns belong to the new force
            start[n + i * m : n + (i + 1) * m, acts : acts + m] = np.eye(m)
        moved = np.zeros((n + k * m, n + (k + 1) * m))
        moved[:n] = lifted_loop.Ad[:n] @ start
        if k:
            moved[n : n + m, n + k * m :] = np.eye(m)
            moved[n + m :, n : n + (k - 1) * m] = np.eye((k - 1) * m)
        seen, driven = lifted_loop.Cd @ start, np.zeros((n + k * m, lifted_loop.Bd.shape[1] + self.noise.shape[1]))
        driven[:n, : lifted_loop.Bd.shape[1]] = lifted_loop.Bd[:n]
        states = n + k * m
        return Plant(
            A=moved[:, :states],
            B=moved[:, states:],
            Bw=driven,
            C=seen[:, :states],
            D=seen[:, states:],
            Dw=np.zeros((len(seen), driven.shape[1])),
            dt=self.period,
            Cy=self.rows,
            Dyw=np.hstack([np.zeros((len(self.rows), lifted_loop.Bd.shape[1])), self.noise / gamma]),
        )
