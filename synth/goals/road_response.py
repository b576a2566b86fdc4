"""The exact response of a loop to a road, and the largest value of a signal over it.

The road drives x' = (A + B K C_y) x + E d(t) with a function d of time that is known, from rest. Between equidistant times its
convolution is a quadrature of order 16, split at the road's kinks, so that the states at these times are exact to rounding. A
peak between two of them is that of the cubic through both ends and their slopes. After the road's end the loop only decays: what
is still to come is bounded by a quadratic form that falls.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.certificate.stability import balance

NODES = 8  # of the quadrature in one step
FINE = 0.01  # rad of the fastest pole with control
MOST_FINE = 200_000  # steps
LONGER = 12  # doublings of the time, until what follows is less
BEND = 2.0  # times the curvature seen between times, for what it is between them
ILL_CONDITIONED = 1e7  # of the eigenvectors, beyond which the recursion runs step by step


@dataclass(frozen=True, eq=False)
class Drive:
    """What a road does to a plant, d(t), shape (T, k) for times of shape (T,), from time 0 to its end.

    Attributes:
        at: times [s] -> d.
        kinks: times [s] at which d or a derivative of it jumps, ascending.
        end: after it d stays as it is [s].
    """

    at: Callable[[Array], Array]
    kinks: Array
    end: float


@dataclass(frozen=True, eq=False)
class Driven:
    """A plant on a road: x' = A x + B u + E d, y = C_y x, and the signal c x + g u + f d that is bounded.

    Attributes:
        A, B, Cy, E: shapes (n, n), (n, m), (q, n), (n, k).
        c, g, f: of the signal, shapes (n,), (m,), (k,).
        drive: the road.
        name: of the signal and the road, in words.
    """

    A: Array
    B: Array
    Cy: Array
    E: Array
    c: Array
    g: Array
    f: Array
    drive: Drive
    name: str = "a peak"


class Response:
    """The states of closed loops of one plant on one road, at equidistant times.

    Attributes:
        time: shape (T,), from 0 [s].
    """

    def __init__(self, driven: Driven, step: float, length: float) -> None:
        """Args:
        driven: the plant on its road.
        step: between times, about [s].
        length: the last time, about [s].
        """
        self.driven, self.h = driven, step
        count = max(2, int(np.ceil(length / step)))
        self.time = step * np.arange(count + 1)
        s, w = np.polynomial.legendre.leggauss(NODES)
        self.s, self.w = (s + 1) / 2, w / 2
        starts = self.time[:-1]
        self.at_nodes = self._nodes(starts, np.full(count, step))
        self.d = driven.drive.at(self.time)
        inside = np.floor(driven.drive.kinks / step).astype(int)
        self.split: list[tuple[int, list[tuple[float, float, Array]]]] = []
        for k in np.unique(inside[(inside >= 0) & (inside < count)]):
            kinks = driven.drive.kinks
            edges = [starts[k], *kinks[(kinks > starts[k]) & (kinks < starts[k] + step)], starts[k] + step]
            pieces = [(b - a, edges[-1] - b, self._nodes(np.array([a]), np.array([b - a]))[0]) for a, b in pairwise(edges)]
            self.split.append((int(k), pieces))

    def _nodes(self, starts: Array, lengths: Array) -> Array:
        """d at the nodes of steps, shape (T, NODES, k)."""
        times = starts[:, None] + lengths[:, None] * self.s
        return self.driven.drive.at(times.ravel()).reshape(len(starts), NODES, -1)

    def states(self, A: Array) -> Array:
        """x at all times for a loop matrix, shape (T, n)."""
        values, vectors = np.linalg.eig(A)
        E = self.driven.E
        try:
            inverse = np.linalg.inv(vectors)
            sound = np.linalg.norm(vectors) * np.linalg.norm(inverse) < ILL_CONDITIONED
        except np.linalg.LinAlgError:
            sound, inverse = False, vectors
        if not sound:
            return self._step_by_step(A)
        driven = inverse @ E
        forcing = self._modal(values, driven, self.at_nodes, self.h)
        for k, pieces in self.split:
            forcing[k] = sum(
                np.exp(values * later) * self._modal(values, driven, nodes[None], length)[0] for length, later, nodes in pieces
            )
        modes = np.zeros((len(self.time), len(A)), complex)
        from scipy.signal import lfilter  # half a second

        for i, factor in enumerate(np.exp(values * self.h)):
            modes[1:, i] = lfilter([1.0], [1.0, -factor], forcing[:, i])
        return np.real(modes @ vectors.T)

    def _modal(self, values: Array, driven: Array, nodes: Array, length: float) -> Array:
        """What d adds to the modes over steps of a length, shape (T, n)."""
        kernel = length * self.w[:, None] * np.exp(values * length * (1 - self.s[:, None]))
        return np.einsum("tqk,nk,qn->tn", nodes, driven, kernel, optimize=True)

    def _step_by_step(self, A: Array) -> Array:
        """The same where the modes lose too many digits."""
        E = self.driven.E

        def kernels(length: float) -> Array:
            return np.stack([w * length * linalg.expm(A * length * (1 - s)) @ E for s, w in zip(self.s, self.w, strict=True)])

        forcing = np.einsum("tqk,qnk->tn", self.at_nodes, kernels(self.h), optimize=True)
        for k, pieces in self.split:
            forcing[k] = sum(
                linalg.expm(A * later) @ np.einsum("qk,qnk->n", nodes, kernels(length)) for length, later, nodes in pieces
            )
        Phi, states = linalg.expm(A * self.h), np.zeros((len(self.time), len(A)))
        for k, each in enumerate(forcing):
            states[k + 1] = Phi @ states[k] + each
        return states

    def between(self, values: Array, slopes: Array) -> tuple[Array, Array]:
        """The maxima of the cubics from each time to the next, and where: shapes (T-1,), the second in steps from time 0.

        Args:
            values: of a signal at all times, shape (T,).
            slopes: likewise.
        """
        c1, c2, c3 = self._cubics(values, slopes)
        with np.errstate(all="ignore"):
            root = np.sqrt(np.maximum(c2 * c2 - 3 * c3 * c1, 0.0))
            stationary = (-c1 / (c2 - root), (-c2 - root) / (3 * c3))  # in the forms in which nothing cancels
        best, where = values[:-1].copy(), np.zeros(len(c1))
        for s in (np.ones(len(c1)), *stationary):
            s = np.where(np.isfinite(s) & (s > 0) & (s < 1), s, 1.0)
            there = values[:-1] + s * (c1 + s * (c2 + s * c3))
            best, where = np.where(there > best, there, best), np.where(there > best, s, where)
        return best, where + np.arange(len(c1))

    def at(self, values: Array, slopes: Array, steps: float) -> float:
        """The cubic between times, some steps from time 0."""
        k = min(int(steps), len(values) - 2)
        s, (c1, c2, c3) = steps - k, self._cubics(values[k : k + 2], slopes[k : k + 2])
        return float(values[k] + s * (c1[0] + s * (c2[0] + s * c3[0])))

    def _cubics(self, values: Array, slopes: Array) -> tuple[Array, Array, Array]:
        """c with y = values + c1 s + c2 s^2 + c3 s^3, s from 0 to 1, between each time and the next."""
        rise, p, q = np.diff(values), slopes[:-1] * self.h, slopes[1:] * self.h
        return p, 3 * rise - 2 * p - q, p + q - 2 * rise


@dataclass(frozen=True)
class Peak:
    """The largest magnitude of a signal over a road.

    Attributes:
        value: it reaches.
        time: after the road's start [s].
        proved: it never exceeds.
    """

    value: float
    time: float
    proved: float


def largest_over_road(driven: Driven, K: Array) -> Peak:
    """The largest |y| from the road's start on, for ever.

    Between times the signal is within h^2 / 8 max |y''| of the line through both ends; the times are as many as make that small,
    and until after the road what follows is known to be less. Infinite where the loop is unstable.

    Args:
        driven: the plant on its road, and the signal.
        K: shape (m, q).
    """
    G = K @ driven.Cy
    A, c = driven.A + driven.B @ G, driven.c + driven.g @ G
    poles = np.linalg.eigvals(A)
    if not np.real(poles).max() < 0:
        return Peak(np.inf, np.nan, np.inf)
    fastest, slowest = float(np.abs(poles).max()), float(-np.real(poles).max())
    final = driven.drive.at(np.array([driven.drive.end + 1.0]))[0]  # as it stays
    rest = np.linalg.solve(A, -driven.E @ final)
    Q = _falling(A)
    reach = float(np.sqrt(c @ np.linalg.solve(Q, c)))
    length = driven.drive.end + min(3 / slowest, 100.0)
    for turn in range(LONGER):
        step = max(min(FINE / fastest, driven.drive.end / 200), length / MOST_FINE)
        response = Response(driven, step, length)
        states = response.states(A)
        y = states @ c + response.d @ driven.f
        slopes = (states @ A.T + response.d @ driven.E.T) @ c + np.gradient(response.d @ driven.f, step)
        tops = [response.between(sign * y, sign * slopes) for sign in (1, -1)]
        heights, where = max(tops, key=lambda each: float(each[0].max()))
        k = int(heights.argmax())
        left = states[-1] - rest
        later = abs(float(c @ rest + driven.f @ final)) + reach * float(np.sqrt(left @ Q @ left))
        if later < heights[k] or turn == LONGER - 1:
            bend = np.abs(np.diff(slopes)).max() / step  # of the signal, as steep as it is between any two times
            value = float(heights[k])
            proved = max(value + BEND * step**2 / 8 * bend, later)
            return Peak(value, float(where[k]) * step, proved)
        length *= 2
    raise AssertionError("the last turn returns")


def _falling(A: Array) -> Array:
    """Q > 0 with A'Q + QA < 0, so that x'Qx falls."""
    balanced, scale = balance(A)
    Q = linalg.solve_continuous_lyapunov(balanced.T, -np.eye(len(A)))
    return Q / np.outer(scale, scale)
