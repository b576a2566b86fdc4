"""The largest magnitude of a signal over a road as a term: its value, and how its peaks move with the gain."""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from synth.goals.road_response import Driven, Response, free, step_for
from synth.goals.terms import Support, Term

STEP = 0.1  # rad of the fastest pole without control; a cubic then misses a peak by less than 1e-6 of it
CYCLES = 2  # of the slowest oscillation without control, after the road: how long is looked for peaks
MOST = 20_000  # steps
SPARE = 1 + 1e-5  # how much tighter a bound is drawn at first, for what is not known of a signal between two times


class RoadPeak(Term):
    """The largest magnitude of a signal over a road, by the bound on it."""

    def __init__(self, driven: Driven, scale: Array, unit: float) -> None:
        """Args:
        driven: the plant on its road, and the signal.
        scale: of a gain's entries, as a landscape has them, shape (m, q).
        unit: the bound.
        """
        self.driven, self.scale, self.name = driven, scale, driven.name
        self.spare = SPARE
        self.unit = unit / self.spare
        poles = np.linalg.eigvals(driven.A)
        fastest = float(np.abs(poles).max()) or 1.0
        moving = np.abs(np.imag(poles))
        slowest = float(moving[moving > 1e-3 * fastest].min(initial=fastest))
        step = step_for(fastest, STEP, driven.drive.end)
        length = driven.drive.end + CYCLES * 2 * np.pi / slowest
        self.response = Response(driven, max(step, length / MOST), length)
        self.last: tuple[bytes, tuple[Array, Array, Array, Array]] | None = None

    def value(self, x: Array, above: float = np.inf) -> float:
        """The largest |y| over the road and some cycles after it."""
        _, y, slopes, ends = self._signal(x)
        if not np.all(np.isfinite(y)):
            return np.inf
        highest = max(float(self.response.between(sign * y, sign * slopes)[0].max()) for sign in (1, -1))
        return max(highest, float(np.abs(ends).max(initial=0.0))) / self.unit

    def support(self, x: Array, value: float, depth: float) -> Support:
        """The signal at the times of its peaks, each with its sign."""
        _, y, slopes, ends = self._signal(x)
        found, floor = [], (1 - max(depth, 0.2)) * value * self.unit
        for sign in (1, -1):
            heights, where = self.response.between(sign * y, sign * slopes)
            around = np.concatenate([[0.0], heights, [0.0]])
            top = np.flatnonzero((heights >= floor) & (heights >= around[:-2]))
            top = top[heights[top] > around[top + 2]]
            found += [(sign, float(where[k]), float(heights[k])) for k in top]
        if len(ends) and np.abs(ends).max() >= floor:  # the highest at a kink
            i = int(np.abs(ends).argmax())
            piece = self.response.pieces[i]
            found.append((int(np.sign(ends[i])), (piece.start + piece.length) / self.response.h, abs(float(ends[i]))))
        return self._made(x, found, touching=True)

    def again(self, x: Array, support: Support) -> Support:
        """The signal at the same times."""
        _, y, slopes, _ = self._signal(x)
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
        states, _, _, _ = self._signal(x)
        (A, c), driven, h = self.driven.loop(self._gain(x)), self.driven, self.response.h
        measured = states[: k + 1] @ driven.Cy.T
        seen = free(A.T, c, h, k + 1)[::-1]  # of it by a state at each time before, shape (k + 1, n)
        weights = np.full(k + 1, h)
        weights[[0, -1]] /= 2
        return ((seen * weights[:, None]) @ driven.B).T @ measured + np.outer(driven.g, measured[k])

    def _gain(self, x: Array) -> Array:
        return x.reshape(self.scale.shape) * self.scale

    def _signal(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """States, the signal and its slope over time, and the signal beside kinks; the last ones are remembered."""
        key = x.tobytes()
        if self.last is None or self.last[0] != key:
            A, c = self.driven.loop(self._gain(x))
            motion = self.response.motion(A)
            states = motion[0] + self.response.z @ self.driven.Bw.T
            self.last = key, (states, *self.response.signal(A, c, motion))
        return self.last[1]
