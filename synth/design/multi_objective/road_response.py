"""Exact response of a closed loop to a road, and the largest value of a signal on this road.

The road heights under the wheels are z, and w = z' is the road velocity. The substitution x = xi + Bw z turns x' = A x + Bw w +
Br z into xi' = A xi + (A Bw + Br) z. The road velocity, which jumps at a kink and is infinite at a vertical edge, does not
appear in the equation for xi. The convolution integral over each time step is computed by a quadrature of order 16. A step with
a kink is split into intervals that become shorter towards the kink, from both sides. Between two times, the signal is
approximated by the cubic polynomial with the values and derivatives at both times.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.plant.generalized import Plant

NODES = 8  # number of quadrature nodes in a step
SMALLER = 24  # a step is halved this many times on the way to a kink
NEXT = 1e-6  # a kink counts as being at the end of a step if it is closer to the end than this share of the step
FINE = 0.01  # timestep, given as the phase angle [rad] by which the motion of the fastest pole with control advances in a step
MOST_FINE = 60_000  # largest number of steps on the road and shortly after it
BLOCK, BLOCKS = 4096, 100  # number of steps in a block of the free motion after the road, and largest number of blocks
BEND = 2.0  # safety factor on the curvature between two times; the curvature is estimated from the derivatives at these times
ILL_CONDITIONED = 1e7  # if the eigenvectors have a larger condition number, the recursion is computed step by step


@dataclass(frozen=True, eq=False)
class RoadExcitation:
    """Road under the wheels of a vehicle as a function of time, from time 0 to the end of the road.

    Attributes:
        heights: function of times [s], shape (T,), that returns road heights [m], shape (T, r).
        rates: function of times [s] that returns the derivatives of the heights [m/s], shape (T, r); the value at a kink is
            arbitrary.
        kinks: times at which a derivative jumps [s], ascending.
        end: time after which the road heights are constant [s].
    """

    heights: Callable[[Array], Array]
    rates: Callable[[Array], Array]
    kinks: Array
    end: float


@dataclass(frozen=True, eq=False)
class RoadLoop:
    """Plant on a road, with one bounded signal.

    The equations are x' = A x + B u + Bw z' + Br z and y = C_y x + Dyu u. The signal is C x + D u + f z.

    Attributes:
        plant: plant with n states, m inputs and r wheels. C and D have a single row, for the signal.
        Br: effect of the road heights on the states, shape (n, r).
        f: effect of the road heights on the signal, shape (r,).
        drive: road heights as functions of time.
        name: description of the signal and the road.
    """

    public_name = "a plant on a road"

    plant: Plant
    Br: Array
    f: Array
    drive: RoadExcitation
    name: str = "a peak"

    def loop(self, K: Array) -> tuple[Array, Array]:
        """Returns the closed-loop matrices A + B G and C + D G with G = (I - K Dyu)^-1 K C_y, shapes (n, n) and (n,)."""
        G, plant = self.after(K) @ K @ self.plant.Cy, self.plant
        return plant.A + plant.B @ G, plant.C[0] + plant.D[0] @ G

    def after(self, K: Array) -> Array:
        """Returns the matrix (I - K Dyu)^-1, shape (m, m); NaN if the inverse does not exist."""
        try:
            return np.linalg.inv(np.eye(len(K)) - K @ self.plant.Dyu)
        except np.linalg.LinAlgError:
            return np.full((len(K), len(K)), np.nan)


@dataclass(frozen=True, eq=False)
class QuadratureInterval:
    """Interval within a time step.

    Attributes:
        step: index of the time step.
        start, length: start and length of the interval [s].
        nodes: road heights at the nodes of the quadrature, shape (NODES, r).
        at_kink: True if one of the ends of the interval is a kink.
    """

    step: int
    start: float
    length: float
    nodes: Array
    at_kink: bool


class RoadResponse:
    """Motion of one plant on one road, with different gains, at equidistant times.

    Attributes:
        h: time between two computed points of the motion [s].
        time: times of the computed motion, beginning with 0 [s], shape (T,).
        pieces: intervals into which steps with a kink are split, in order of time.
    """

    def __init__(self, driven: RoadLoop, step: float, length: float) -> None:
        """Args:
        driven: plant, road that excites the plant, and bounded signal.
        step: time step [s].
        length: approximate duration of the computed motion [s].
        """
        self.driven, self.h = driven, step
        drive, count = driven.drive, max(2, int(np.ceil(length / step)))
        self.time = step * np.arange(count + 1)
        s, w = np.polynomial.legendre.leggauss(NODES)
        self.s, self.w = (s + 1) / 2, w / 2
        self.at_nodes = self._nodes(self.time[:-1], np.full(count, step))
        self.z, self.rates = drive.heights(self.time), drive.rates(self.time)
        self.pieces: list[QuadratureInterval] = []
        # a kink between two steps belongs to both steps
        beside = np.concatenate([drive.kinks / step - NEXT, drive.kinks / step + NEXT])
        for k in np.unique(np.floor(beside).astype(int)):
            if 0 <= k < count:
                self.pieces += self._split(int(k))
        ends = np.array([piece.start + piece.length for piece in self.pieces])
        self.z_ends = drive.heights(ends) if len(ends) else np.zeros((0, self.z.shape[1]))
        self.piece_lengths = np.array([piece.length for piece in self.pieces])
        self.piece_nodes = np.array([piece.nodes for piece in self.pieces]).reshape(len(ends), *self.at_nodes.shape[1:])
        self.piece_steps = np.array([piece.step for piece in self.pieces], dtype=int)
        self.piece_ends = ends - self.time[self.piece_steps]  # times relative to the beginning of the steps

    def _split(self, k: int) -> list[QuadratureInterval]:
        """Splits a time step that contains kinks into intervals."""
        start, end = float(self.time[k]), float(self.time[k]) + self.h
        kinks = self.driven.drive.kinks
        kinks = np.clip(kinks[(kinks >= start - NEXT * self.h) & (kinks <= end + NEXT * self.h)], start, end)
        edges = {start, end, *map(float, kinks)}
        for kink in kinks:
            for side in (-1, 1):
                edges |= {float(kink) + side * self.h * 0.5**i for i in range(1, SMALLER)}
        ordered = sorted(edge for edge in edges if start <= edge <= end)
        intervals = []
        for left, right in pairwise(ordered):
            nodes = self._nodes(np.array([left]), np.array([right - left]))[0]
            intervals.append(QuadratureInterval(k, left, right - left, nodes, left in kinks or right in kinks))
        return intervals

    def _nodes(self, starts: Array, lengths: Array) -> Array:
        """Returns the road heights at the quadrature nodes of the given time steps, shape (T, NODES, r)."""
        times = starts[:, None] + lengths[:, None] * self.s
        return self.driven.drive.heights(times.ravel()).reshape(len(starts), NODES, -1)

    def motion(self, A: Array) -> tuple[Array, Array]:
        """Returns the motion xi for the loop matrix A at all times, shape (T, n), and at the ends of intervals, shape (P, n)."""
        # `np.linalg.eig` returns real arrays if all poles are real
        values, vectors = (np.asarray(part, complex) for part in np.linalg.eig(A))
        E = A @ self.driven.plant.Bw + self.driven.Br
        try:
            inverse = np.linalg.inv(vectors)
            sound = np.linalg.norm(vectors) * np.linalg.norm(inverse) < ILL_CONDITIONED
        except np.linalg.LinAlgError:
            sound, inverse = False, vectors
        if not sound:
            return self._step_by_step(A, E)
        from scipy.signal import lfilter  # this import takes half a second

        # Only one mode of each conjugate pair is computed; its contribution is doubled.
        mask = np.imag(values) >= 0
        twice = np.where(np.imag(values[mask]) > 0, 2.0, 1.0)
        values, vectors, driven = values[mask], vectors[:, mask] * twice, inverse[mask] @ E
        forcing = self._modal(values, driven)
        ends, state, into = np.zeros((len(self.pieces), len(values)), complex), np.zeros(len(values), complex), -1
        decays = np.exp(self.piece_lengths[:, None] * values)
        kernel = self.piece_lengths[:, None, None] * self._kernel(values, self.piece_lengths[:, None, None])
        of_road = ((self.piece_nodes @ driven.T) * kernel).sum(axis=1)
        # this motion starts from zero at the beginning of the step; the effect of the previous motion is added later
        for i, step in enumerate(self.piece_steps):
            if step != into:
                into, state = step, np.zeros(len(values), complex)
            ends[i] = forcing[step] = state = decays[i] * state + of_road[i]
        modes = np.zeros((len(self.time), len(values)), complex)
        for i, factor in enumerate(np.exp(values * self.h)):
            modes[1:, i] = lfilter([1.0], [1.0, -factor], forcing[:, i])
        ends += np.exp(self.piece_ends[:, None] * values) * modes[self.piece_steps]
        return _real_product(modes, vectors.T), _real_product(ends, vectors.T)

    def _kernel(self, values: Array, lengths: Array | float) -> Array:
        """Returns the weight of each quadrature node in each mode, for steps of given lengths, shape (..., NODES, n)."""
        return self.w[:, None] * np.exp(lengths * values * (1 - self.s[:, None]))

    def _modal(self, values: Array, driven: Array) -> Array:
        """Returns the contribution of the road to the modes in every step, shape (T, n), as one product of real matrices."""
        weights = self.h * self._kernel(values, self.h)[:, None, :] * driven.T  # weight of each road height at each node
        flat, weights = self.at_nodes.reshape(len(self.at_nodes), -1), weights.reshape(-1, len(values))
        return flat @ weights.real + 1j * (flat @ weights.imag)

    def _step_by_step(self, A: Array, E: Array) -> tuple[Array, Array]:
        """Returns the same motion as `motion`, but computed step by step, for loops whose modal form is too inaccurate."""

        def kernels(length: float) -> Array:
            return np.stack([w * length * linalg.expm(A * length * (1 - s)) @ E for s, w in zip(self.s, self.w, strict=True)])

        forcing = np.einsum("tqk,qnk->tn", self.at_nodes, kernels(self.h), optimize=True)
        Phi, states, ends = linalg.expm(A * self.h), np.zeros((len(self.time), len(A))), np.zeros((len(self.pieces), len(A)))
        split: dict[int, list[int]] = {}
        for i, piece in enumerate(self.pieces):
            split.setdefault(piece.step, []).append(i)
        for k, each in enumerate(forcing):
            state = states[k]
            for i in split.get(k, []):
                piece = self.pieces[i]
                state = linalg.expm(A * piece.length) @ state + np.einsum("qk,qnk->n", piece.nodes, kernels(piece.length))
                ends[i] = state
            states[k + 1] = state if k in split else Phi @ states[k] + each
        return states, ends

    def signal(self, A: Array, c: Array, motion: tuple[Array, Array]) -> tuple[Array, Array, Array]:
        """Returns a signal and its derivative at all times, shapes (T,), and the signal at the ends of intervals, shape (P,)."""
        states, ends = motion
        driven = self.driven
        Bw = driven.plant.Bw
        direct = c @ Bw + driven.f
        slopes = (states @ A.T + self.z @ (A @ Bw + driven.Br).T) @ c + _finite(self.rates @ direct)
        return states @ c + self.z @ direct, slopes, ends @ c + self.z_ends @ direct

    def between(self, values: Array, slopes: Array) -> tuple[Array, Array]:
        """Returns the maxima of the cubics between neighbouring times, and their positions, each of shape (T-1,).

        A position is a number of steps from time 0. In a step with a kink, only the two ends of the step are considered.


        Args:
            values: values of the signal at all times, shape (T,).
            slopes: time derivatives of the signal at all times, shape (T,).
        """
        c1, c2, c3 = self._cubics(values, slopes)
        with np.errstate(all="ignore"):
            root = np.sqrt(np.maximum(c2 * c2 - 3 * c3 * c1, 0.0))
            stationary = (-c1 / (c2 - root), (-c2 - root) / (3 * c3))  # this form of the sum loses no digits by cancellation
        best, where = values[:-1].copy(), np.zeros(len(c1))
        smooth = np.ones(len(c1), dtype=bool)
        smooth[[piece.step for piece in self.pieces]] = False
        for s in (np.ones(len(c1)), *stationary):
            s = np.where(np.isfinite(s) & (s > 0) & (s < 1) & smooth, s, 1.0)
            there = np.where(s < 1, values[:-1] + s * (c1 + s * (c2 + s * c3)), values[1:])
            best, where = np.where(there > best, there, best), np.where(there > best, s, where)
        return best, where + np.arange(len(c1))

    def at(self, values: Array, slopes: Array, steps: float) -> float:
        """Returns the value of the cubic at a position, which is given in steps from time 0."""
        k = min(int(steps), len(values) - 2)
        s, (c1, c2, c3) = steps - k, self._cubics(values[k : k + 2], slopes[k : k + 2])
        return float(values[k] + s * (c1[0] + s * (c2[0] + s * c3[0])))

    def _cubics(self, values: Array, slopes: Array) -> tuple[Array, Array, Array]:
        """Returns c1, c2, c3 of the cubics y = values + c1 s + c2 s^2 + c3 s^3, with s from 0 to 1 between neighbouring times."""
        rise, p, q = np.diff(values), slopes[:-1] * self.h, slopes[1:] * self.h
        return p, 3 * rise - 2 * p - q, p + q - 2 * rise


def _real_product(a: Array, b: Array) -> Array:
    """Returns the real part of a product of complex matrices. Real products are much faster if one matrix is narrow."""
    return np.real(a) @ np.real(b) - np.imag(a) @ np.imag(b)


def _finite(rates: Array) -> Array:
    """Returns the derivatives of the road heights, with infinite values replaced by zero.

    Infinite derivatives occur at vertical edges of the road, where cubics are not used.
    """
    return np.where(np.isfinite(rates), rates, 0.0)


def step_for(rate: float, share: float, end: float) -> float:
    """Returns a time step that is short enough for the fastest motion and for the road.

    In one step, the phase of the fastest motion advances by `share`. If the road is short, the step is reduced to 1/200 of the
    road's duration, but at most by a factor of 8.

    Args:
        rate: magnitude of the fastest pole [rad/s].
        share: phase of the fastest motion per step [rad].
        end: time at which the road ends [s].
    """
    step = share / rate
    return min(step, max(end / 200, step / 8))


def homogeneous_response(A: Array, x: Array, h: float, count: int) -> Array:
    """Returns the states exp(A k h) x at the times k h for k = 0, 1, ..., computed by repeated doubling, shape (count, n)."""
    responses, power = x[None], linalg.expm(A * h)
    while len(responses) < count:
        responses = np.concatenate([responses, responses @ power.T])
        power = power @ power
    return responses[:count]
