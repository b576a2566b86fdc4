"""The largest magnitude of a signal over a road as a term: its value, and how its peaks move with the gain."""

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.goals.road_response import Driven, Response
from synth.goals.terms import Support, Term

STEP = 0.1  # rad of the fastest pole without control; a cubic then misses a peak by less than 1e-6 of it
CYCLES = 2  # of the slowest oscillation without control, after the road: how long is looked for peaks
MOST = 20_000  # steps


class RoadPeak(Term):
    """The largest magnitude of a signal over a road, by the bound on it."""

    def __init__(self, driven: Driven, scale: Array, unit: float) -> None:
        """Args:
        driven: the plant on its road, and the signal.
        scale: of a gain's entries, as a landscape has them, shape (m, q).
        unit: the bound.
        """
        self.driven, self.scale, self.unit, self.name = driven, scale, unit, driven.name
        poles = np.linalg.eigvals(driven.A)
        fastest = float(np.abs(poles).max()) or 1.0
        moving = np.abs(np.imag(poles))
        slowest = float(moving[moving > 1e-3 * fastest].min(initial=fastest))
        step = min(STEP / fastest, driven.drive.end / 100)
        length = driven.drive.end + CYCLES * 2 * np.pi / slowest
        self.response = Response(driven, max(step, length / MOST), length)
        self.last: tuple[bytes, tuple[Array, Array, Array]] | None = None

    def value(self, x: Array, above: float = np.inf) -> float:
        """The largest |y| over the road and some cycles after it."""
        _, y, slopes = self._signal(x)
        if not np.all(np.isfinite(y)):
            return np.inf
        return max(float(self.response.between(sign * y, sign * slopes)[0].max()) for sign in (1, -1)) / self.unit

    def support(self, x: Array, value: float, depth: float) -> Support:
        """The signal at the times of its peaks, each with its sign."""
        _, y, slopes = self._signal(x)
        found = []
        for sign in (1, -1):
            heights, where = self.response.between(sign * y, sign * slopes)
            around = np.concatenate([[0.0], heights, [0.0]])
            top = np.flatnonzero((heights >= (1 - max(depth, 0.2)) * value * self.unit) & (heights >= around[:-2]))
            top = top[heights[top] > around[top + 2]]
            found += [(sign, float(where[k]), float(heights[k])) for k in top]
        return self._made(x, found, touching=True)

    def again(self, x: Array, support: Support) -> Support:
        """The signal at the same times."""
        _, y, slopes = self._signal(x)
        again = [(sign, at, sign * self.response.at(y, slopes, at)) for sign, at, _ in support.cuts]
        return self._made(x, again, touching=False)

    def _made(self, x: Array, found: Sequence[tuple[int, float, float]], touching: bool) -> Support:
        """The functions, with their slopes: the integral of what a change of the gain does to the signal at a time."""
        slopes = np.zeros((len(found), *self.scale.shape))
        for row, (sign, at, _) in zip(slopes, found, strict=True):
            k = min(int(at), len(self.response.time) - 2)
            row += sign * ((1 - at + k) * self._moved(x, k) + (at - k) * self._moved(x, k + 1))
        values = np.array([height for _, _, height in found]) / self.unit
        slopes = (slopes * self.scale / self.unit).reshape(len(found), self.scale.size)
        return Support(values, slopes, np.full(len(found), touching), list(found))

    def _moved(self, x: Array, k: int) -> Array:
        """How the signal at a time moves with the entries of K, shape (m, q)."""
        states, _, _ = self._signal(x)
        (A, c), driven, h = self._loop(x), self.driven, self.response.h
        measured = states[: k + 1] @ driven.Cy.T
        seen = _free(A.T, c, h, k + 1)[::-1]  # of it by a state at each time before, shape (k + 1, n)
        weights = np.full(k + 1, h)
        weights[[0, -1]] /= 2
        return ((seen * weights[:, None]) @ driven.B).T @ measured + np.outer(driven.g, measured[k])

    def _loop(self, x: Array) -> tuple[Array, Array]:
        """A + B K C_y, and c + g K C_y."""
        G = (x.reshape(self.scale.shape) * self.scale) @ self.driven.Cy
        return self.driven.A + self.driven.B @ G, self.driven.c + self.driven.g @ G

    def _signal(self, x: Array) -> tuple[Array, Array, Array]:
        """States, the signal and its slope over time; the last ones are remembered."""
        key = x.tobytes()
        if self.last is None or self.last[0] != key:
            A, c = self._loop(x)
            states = self.response.states(A)
            d = self.response.d
            y = states @ c + d @ self.driven.f
            slopes = (states @ A.T + d @ self.driven.E.T) @ c + np.gradient(d @ self.driven.f, self.response.h)
            self.last = key, (states, y, slopes)
        return self.last[1]


def _free(A: Array, x: Array, h: float, count: int) -> Array:
    """exp(A k h) x for k = 0, 1, ..., shape (count, n), by doubling."""
    found, power = x[None], linalg.expm(A * h)
    while len(found) < count:
        found = np.concatenate([found, found @ power.T])
        power = power @ power
    return found[:count]
