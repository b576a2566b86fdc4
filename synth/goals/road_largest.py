"""The largest magnitude of a signal over a road, from its start on, for ever: what it reaches, and what it never exceeds."""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.certificate.stability import balance, is_stable
from synth.goals.road_response import BEND, BLOCK, BLOCKS, FINE, MOST_FINE, Driven, Response, free, step_for


@dataclass(frozen=True)
class Peak:
    """The largest magnitude of a signal over a road.

    Attributes:
        value: it reaches.
        time: after the road's start [s].
        proved: it never exceeds; infinite where that is not known.
    """

    value: float
    time: float
    proved: float


def largest_over_road(driven: Driven, K: Array) -> Peak:
    """The largest |y| from the road's start on, for ever; infinite where the loop is unstable.

    Between two times a signal is within h^2 / 8 max |y''| of the line through both ends, and beside a kink of the road, where the
    times are a millionth of a step apart, within the change from one to the next. The free motion after the road is looked at
    until what follows is known to be less.

    Args:
        driven: the plant on its road, and the signal.
        K: shape (m, q).
    """
    A, c = driven.loop(K)
    if not is_stable(A):
        return Peak(np.inf, np.nan, np.inf)
    poles = np.linalg.eigvals(A)
    step = step_for(float(np.abs(poles).max()), FINE, driven.drive.end)
    length = driven.drive.end + min(3 / float(-np.real(poles).max()), 0.5 * step * MOST_FINE)
    step = max(step, length / MOST_FINE)
    response = Response(driven, step, length)
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


def _beside_kinks(response: Response, y: Array, at_ends: Array) -> float:
    """What the signal does not exceed within the steps that have a kink."""
    highest, before, into = 0.0, 0.0, -1
    slope = 0.0
    for end, piece in zip(at_ends, response.pieces, strict=True):
        if piece.step != into:
            into, before, slope = piece.step, float(y[piece.step]), np.nan
        change = float(end) - before
        now = change / piece.length
        # Away from a kink the slope changes little from piece to piece; beside one the whole change is allowed for.
        over = abs(change) if piece.beside or np.isnan(slope) else min(abs(change), BEND * abs(now - slope) * piece.length / 4)
        highest = max(highest, max(abs(before), abs(float(end))) + over)
        before, slope = float(end), np.nan if piece.beside else now
    return highest


def _later(driven: Driven, A: Array, c: Array, xi: Array, step: float, known: float) -> Peak:
    """The free motion from the last time on: its own peak, if that is larger than what is known, and what it never exceeds."""
    z = driven.drive.heights(np.array([driven.drive.end + 1.0]))[0]  # as it stays
    rest = np.linalg.solve(A, -(A @ driven.Bw + driven.Br) @ z)
    level = float(c @ rest + (c @ driven.Bw + driven.f) @ z)
    balanced, scale = balance(A)
    Q = linalg.solve_continuous_lyapunov(balanced.T, -np.eye(len(A))) / np.outer(scale, scale)
    reach = float(np.sqrt(c @ np.linalg.solve(Q, c)))
    left, value, time, proved = xi - rest, 0.0, 0.0, 0.0
    for block in range(BLOCKS):
        bound = abs(level) + reach * float(np.sqrt(max(left @ Q @ left, 0.0)))
        if bound <= max(known, value):
            return Peak(value, time, max(value, proved))
        states = free(A, left, step, BLOCK + 1)
        signal, slopes = level + states @ c, states @ A.T @ c
        k = int(np.abs(signal).argmax())
        if abs(signal[k]) > value:
            value, time = abs(float(signal[k])), (block * BLOCK + k) * step
        bend = float(np.abs(np.diff(slopes)).max()) / step
        proved = max(proved, abs(float(signal[k])) + BEND * step**2 / 8 * bend)
        left = states[-1]
    return Peak(value, time, max(proved, abs(level) + reach * float(np.sqrt(max(left @ Q @ left, 0.0)))))
