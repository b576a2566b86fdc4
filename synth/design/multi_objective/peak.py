"""Largest magnitude of a signal on a road: its peaks and their derivatives for a descent, and a proved bound."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.analysis.stability import balance, is_stable
from synth.design.descent.terms import Linearisation, Term
from synth.design.multi_objective.road_response import (
    BEND,
    BLOCK,
    BLOCKS,
    FINE,
    MOST_FINE,
    RoadLoop,
    RoadResponse,
    homogeneous_response,
    step_for,
)

# Timestep, given as the phase angle [rad] by which the motion of the fastest pole without control advances in a step. If the
# signal is a cubic polynomial near its peak, the relative error of the peak is then below 1e-6
STEP = 0.1
# peaks are also searched for this many periods after the end of the road; the period is the longest period without control
CYCLES = 2
MOST = 20_000  # largest number of timesteps for which a response is computed
SPARE = 1 + 1e-5  # initial factor by which a bound is tightened, because the signal between two timesteps is unknown


class RoadPeak(Term):
    """Largest magnitude of a signal on a road, divided by its bound."""

    def __init__(self, driven: RoadLoop, scale: Array, unit: float) -> None:
        """Args:
        driven: plant, road that excites the plant, and bounded signal.
        scale: scale of each entry of the gain, as in a landscape, shape (m, q).
        unit: largest allowed magnitude of the signal, by which all values of the term are divided.
        """
        self.driven, self.scale, self.name = driven, scale, driven.name
        self.spare = SPARE
        self.unit = unit / self.spare
        poles = np.linalg.eigvals(driven.plant.A)
        fastest = float(np.abs(poles).max()) or 1.0
        moving = np.abs(np.imag(poles))
        slowest = float(moving[moving > 1e-3 * fastest].min(initial=fastest))
        step = step_for(fastest, STEP, driven.drive.end)
        length = driven.drive.end + CYCLES * 2 * np.pi / slowest
        self.response = RoadResponse(driven, max(step, length / MOST), length)
        self.last: tuple[bytes, tuple[Array, Array, Array, Array]] | None = None

    def value(self, x: Array, above: float = np.inf) -> float:
        """Returns the largest magnitude of the signal on the road and for some periods after the road, divided by the bound."""
        _, y, slopes, ends = self._signal(x)
        if not np.all(np.isfinite(y)):
            return np.inf
        highest = max(float(self.response.between(sign * y, sign * slopes)[0].max()) for sign in (1, -1))
        return max(highest, float(np.abs(ends).max(initial=0.0))) / self.unit

    def support(self, x: Array, value: float, depth: float) -> Linearisation:
        """Returns the signal at the times of its peaks, multiplied by the sign of each peak."""
        _, y, slopes, ends = self._signal(x)
        touching, floor = [], (1 - max(depth, 0.2)) * value * self.unit
        for sign in (1, -1):
            heights, where = self.response.between(sign * y, sign * slopes)
            around = np.concatenate([[0.0], heights, [0.0]])
            top = np.flatnonzero((heights >= floor) & (heights >= around[:-2]))
            top = top[heights[top] > around[top + 2]]
            touching += [(sign, float(where[k]), float(heights[k])) for k in top]
        if len(ends) and np.abs(ends).max() >= floor:  # the highest peak is at a kink of the signal
            i = int(np.abs(ends).argmax())
            piece = self.response.pieces[i]
            touching.append((int(np.sign(ends[i])), (piece.start + piece.length) / self.response.h, abs(float(ends[i]))))
        return self._made(x, touching, touching=True)

    def reevaluate(self, x: Array, cuts: Sequence[tuple[int, float, float]]) -> Linearisation:
        """Returns the signal for another gain, at the times that `cuts` contains."""
        _, y, slopes, _ = self._signal(x)
        again = [(sign, at, sign * self.response.at(y, slopes, at)) for sign, at, _ in cuts]
        return self._made(x, again, touching=False)

    def _made(self, x: Array, peaks: Sequence[tuple[int, float, float]], touching: bool) -> Linearisation:
        """Returns the values of the signal at given times, and their derivatives with respect to the entries of the gain."""
        slopes = np.zeros((len(peaks), *self.scale.shape))
        for row, (sign, at, _) in zip(slopes, peaks, strict=True):
            k = min(int(at), len(self.response.time) - 2)
            row += sign * ((1 - at + k) * self._moved(x, k) + (at - k) * self._moved(x, k + 1))
        values = np.array([height for _, _, height in peaks]) / self.unit
        slopes = (slopes * self.scale / self.unit).reshape(len(peaks), self.scale.size)
        return Linearisation(values, slopes, np.full(len(peaks), touching), list(peaks))

    def _moved(self, x: Array, k: int) -> Array:
        """Returns the derivatives of the signal at one time with respect to the entries of K, shape (m, q)."""
        states, _, _, _ = self._signal(x)
        K, plant, h = self._gain(x), self.driven.plant, self.response.h
        (A, c), after = self.driven.loop(K), self.driven.after(K)
        measured = states[: k + 1] @ (plant.Cy + plant.Dyu @ after @ K @ plant.Cy).T
        # Derivatives of the signal with respect to the state at every earlier time, shape (k + 1, n).
        seen = homogeneous_response(A.T, c, h, k + 1)[::-1]
        weights = np.full(k + 1, h)
        weights[[0, -1]] /= 2
        return after.T @ (((seen * weights[:, None]) @ plant.B).T @ measured + np.outer(plant.D[0], measured[k]))

    def _gain(self, x: Array) -> Array:
        return x.reshape(self.scale.shape) * self.scale

    def _signal(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """Returns the states, the signal and its time derivative at all times, and the signal next to kinks of the road.

        The last result is cached.
        """
        key = x.tobytes()
        if self.last is None or self.last[0] != key:
            A, c = self.driven.loop(self._gain(x))
            motion = self.response.motion(A)
            states = motion[0] + self.response.z @ self.driven.plant.Bw.T
            self.last = key, (states, *self.response.signal(A, c, motion))
        return self.last[1]


@dataclass(frozen=True)
class Peak:
    """Largest magnitude of a signal on a road.

    Attributes:
        value: largest magnitude.
        time: time after the start of the road at which the largest magnitude occurs [s].
        proved: proved upper bound on the magnitude; infinite if no bound is known.
    """

    value: float
    time: float
    proved: float


def peak_over_road(driven: RoadLoop, K: Array) -> Peak:
    """Returns the largest magnitude of the signal y at all times after the start of the road; infinite if the loop is unstable.

    Between two times a step h apart, the distance of the signal from the straight line through both ends is at most h^2 / 8 max
    |y''|. Next to a kink of the road, the times are only a millionth of a step apart. Next to a kink, the distance of the
    signal from the line is bounded by the change of the signal from one time to the next. The free motion after the road is
    computed until a bound shows that all later motion is smaller.

    Args:
        driven: plant, road that excites the plant, and bounded signal.
        K: gain, shape (m, q).
    """
    A, c = driven.loop(K)
    if not is_stable(A):
        return Peak(np.inf, np.nan, np.inf)
    poles = np.linalg.eigvals(A)
    step = step_for(float(np.abs(poles).max()), FINE, driven.drive.end)
    length = driven.drive.end + min(3 / float(-np.real(poles).max()), 0.5 * step * MOST_FINE)
    step = max(step, length / MOST_FINE)
    response = RoadResponse(driven, step, length)
    motion = response.motion(A)
    y, slopes, at_ends = response.signal(A, c, motion)
    value, time = 0.0, 0.0
    for sign in (1, -1):
        heights, where = response.between(sign * y, sign * slopes)
        k = int(heights.argmax())
        if heights[k] > value:
            value, time = float(heights[k]), float(where[k]) * step
    for end, piece in zip(at_ends, response.pieces, strict=True):
        if abs(end) > value:
            value, time = abs(float(end)), piece.start + piece.length
    smooth = np.ones(len(y) - 1, dtype=bool)
    smooth[[piece.step for piece in response.pieces]] = False
    bend = np.where(smooth, np.abs(np.diff(slopes)), 0.0) / step
    near = np.maximum(np.abs(y[:-1]), np.abs(y[1:])) + BEND * step**2 / 8 * bend
    proved = max(value, float(near[smooth].max(initial=0.0)), _beside_kinks(response, y, at_ends))
    later = _later(driven, A, c, motion[0][-1], step, max(value, proved))
    if later.value > value:
        value, time = later.value, response.time[-1] + later.time
    return Peak(value, float(time), max(proved, later.proved, value))


def _beside_kinks(response: RoadResponse, y: Array, at_ends: Array) -> float:
    """Returns a bound on the magnitude of the signal within the steps that contain a kink."""
    highest, before, into = 0.0, 0.0, -1
    slope = 0.0
    for end, piece in zip(at_ends, response.pieces, strict=True):
        if piece.step != into:
            into, before, slope = piece.step, float(y[piece.step]), np.nan
        change = float(end) - before
        now = change / piece.length
        # Away from a kink, the time derivative of the signal changes little from one interval to the next. Next to a kink, the
        # bound allows for the whole change of the signal.
        over = abs(change) if piece.at_kink or np.isnan(slope) else min(abs(change), BEND * abs(now - slope) * piece.length / 4)
        highest = max(highest, max(abs(before), abs(float(end))) + over)
        before, slope = float(end), np.nan if piece.at_kink else now
    return highest


def _later(driven: RoadLoop, A: Array, c: Array, xi: Array, step: float, known: float) -> Peak:
    """Returns the peak of the free motion after the last time step, if it is the highest peak so far, and a bound on this
    motion.
    """
    z = driven.drive.heights(np.array([driven.drive.end + 1.0]))[0]  # height of the road after its end
    rest = np.linalg.solve(A, -(A @ driven.plant.Bw + driven.Br) @ z)
    level = float(c @ rest + (c @ driven.plant.Bw + driven.f) @ z)
    balanced, scale = balance(A)
    Q = linalg.solve_continuous_lyapunov(balanced.T, -np.eye(len(A))) / np.outer(scale, scale)
    reach = float(np.sqrt(c @ np.linalg.solve(Q, c)))
    left, value, time, proved = xi - rest, 0.0, 0.0, 0.0
    for block in range(BLOCKS):
        bound = abs(level) + reach * float(np.sqrt(max(left @ Q @ left, 0.0)))
        if bound <= max(known, value):
            return Peak(value, time, max(value, proved))
        states = homogeneous_response(A, left, step, BLOCK + 1)
        signal, slopes = level + states @ c, states @ A.T @ c
        k = int(np.abs(signal).argmax())
        if abs(signal[k]) > value:
            value, time = abs(float(signal[k])), (block * BLOCK + k) * step
        bend = float(np.abs(np.diff(slopes)).max()) / step
        proved = max(proved, abs(float(signal[k])) + BEND * step**2 / 8 * bend)
        left = states[-1]
    return Peak(value, time, max(proved, abs(level) + reach * float(np.sqrt(max(left @ Q @ left, 0.0)))))
