"""Signals as polynomials between their samples, which give extrema, crossings and integrals without sampling errors.

A signal consists of pieces, each described by one polynomial. A piece is one timestep long, or shorter if the wheels pass kinks
of the road that are only a few steps apart. A linear response can be computed exactly at any time, so that each piece has
enough points for a polynomial of high degree. If a mode advances by 1 rad per step, a polynomial of degree 8 describes this
mode with an error of 1e-11. A MuJoCo signal is known only at its samples. Each piece of a MuJoCo signal is a cubic through the
four nearest samples; a held force is constant from one sample to the next. No polynomial extends across a vertical edge of the
road or a switching instant (`sim.drive.jumps`), because the signal may have two values there.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import chebyshev
from scipy.interpolate import barycentric_interpolate

from models.common.arrays import Array
from models.roads.road import RoadInput, delays, jumps_under_wheels
from sim.drive.response import SAME_VALUE, Response
from sim.linear.forced_response import forced_continuous_response
from sim.linear.sampled_response import continuous_response
from sim.runs.run import Run

DEGREE = 8  # degree of the polynomial in each piece
PER_GAP = 8  # smallest number of pieces between two adjacent kinks of the road
MOST_POINTS = 2_000_000  # largest number of points that represent a response; longer runs have polynomials of a lower degree
# largest amount by which a polynomial may exceed the points that it interpolates, relative to the range of the points
BULGE = 0.1
EARLY = 1e-6  # tolerance of times, as a share of a step
ROUNDING = 1e-13  # a change of sign counts only if both values exceed this share of the largest value


@dataclass(frozen=True, eq=False)
class Pieces:
    """Signal as K polynomials of degree d, one for each timestep or part of a timestep.

    Attributes:
        start: start of each piece [s], shape (K,).
        length: length of each piece [s], shape (K,).
        values: values of the signal at equidistant points of each piece, including both ends, shape (K, d + 1).
    """

    start: Array
    length: Array
    values: Array

    def less(self, value: float) -> "Pieces":
        """Returns the signal after a constant is subtracted."""
        return replace(self, values=self.values - value)

    def times(self, factor: float) -> "Pieces":
        """Returns the signal multiplied by a factor."""
        return replace(self, values=self.values * factor)

    def before(self, whole: "Pieces", steps: int) -> "Pieces":
        """Returns the pieces of this object, followed by all pieces of `whole` except its first `steps` pieces."""
        if self.values.shape[1] != whole.values.shape[1]:
            return whole
        both = ((getattr(self, name), getattr(whole, name)[steps:]) for name in ("start", "length", "values"))
        return Pieces(*map(np.concatenate, both))

    def since(self, time: float) -> "Pieces":
        """Returns the pieces of the signal that begin at a time [s] or later."""
        later = self.start >= time
        return replace(self, start=self.start[later], length=self.length[later], values=self.values[later])

    def counted_from(self, time: float) -> "Pieces":
        """Returns the pieces of the signal that begin at a time [s] or later; times in the result are relative to this time."""
        if not time:
            return self
        later = self.since(time - EARLY * float(self.length[0]))
        return replace(later, start=later.start - time)

    def rms(self) -> float:
        """Returns the root mean square of the signal over the duration of all pieces."""
        points = self.values.shape[1]
        nodes, weights = np.polynomial.legendre.leggauss(points)
        at_nodes = self.values @ (chebyshev.chebvander(nodes, points - 1) @ _fit(points)).T
        return float(np.sqrt(self.length @ (at_nodes**2 @ weights / 2) / self.length.sum()))

    def polynomial(self, k: int) -> Array:
        """Returns the Chebyshev coefficients of piece `k`, as a function of a variable from -1 to 1."""
        return _fit(self.values.shape[1]) @ self.values[k]

    def time(self, k: int, x: float) -> float:
        """Returns the time [s] of the point x in piece `k`; x is -1 at the start of the piece and 1 at its end."""
        return float(self.start[k] + self.length[k] * (x + 1) / 2)

    def at(self, times: Array) -> Array:
        """Returns the values of the signal at some times [s], with the shape of `times`."""
        after = np.searchsorted(self.start, times + ROUNDING * self.length[0], side="right")
        k = np.clip(after - 1, 0, len(self.start) - 1)
        x = 2 * (times - self.start[k]) / self.length[k] - 1
        points = self.values.shape[1]
        coefficients = self.values[k] @ _fit(points).T
        return (chebyshev.chebvander(x, points - 1) * coefficients).sum(axis=-1)

    def largest(self) -> tuple[float, float]:
        """Returns the largest value of the signal, and the time at which this value occurs [s]."""
        most, spread = self.values.max(axis=1), np.ptp(self.values, axis=1)
        floor, first = float(most.max()), int(most.argmax())
        possible = np.flatnonzero(most + BULGE * spread >= floor)
        found = floor, self.time(first, 2 * int(self.values[first].argmax()) / (self.values.shape[1] - 1) - 1)
        likeliest = possible[np.argsort(-(most + BULGE * spread)[possible])][:8].tolist()
        return max([found, *map(self._largest_in, likeliest)], key=lambda one: one[0])

    def last_above(self, value: float) -> float | None:
        """Returns the last time [s] at which the magnitude of the signal exceeds a threshold.

        The time is infinite if the magnitude exceeds the threshold at the end of the signal. The result is None if the
        magnitude never exceeds the threshold.
        """
        size = np.abs(self.values)
        outside = size.max(axis=1) > value
        last = int(np.flatnonzero(outside)[-1]) if outside.any() else -1
        bulging = np.flatnonzero(size.max(axis=1) + BULGE * np.ptp(self.values, axis=1) > value)
        for k in bulging[bulging > last][::-1].tolist():
            if max(self._largest_in(k)[0], self.times(-1.0)._largest_in(k)[0]) > value:
                last = k
                break
        if last < 0:
            return None
        if size[last, -1] > value:
            return np.inf if last == len(self.start) - 1 else self.time(last, 1.0)
        crossings = [x for side in (value, -value) for x in _roots(chebyshev.chebsub(self.polynomial(last), [side]))]
        return self.time(last, max(crossings, default=1.0))

    def integral_of_size(self) -> tuple[float, float]:
        """Returns the integral of the magnitude |x| of the signal, and the integral of t |x| with the time t, both over all
        pieces.
        """
        points = self.values.shape[1]
        weights, lengths = _integral(points) / 2, self.length[:, None]
        at = self.start[:, None] + lengths * (np.linspace(-1, 1, points) + 1) / 2
        plain, timed = (lengths * self.values) @ weights, (lengths * self.values * at) @ weights
        size, signed = np.abs(self.values), np.sign(self.values)
        turning = (size.min(axis=1) < BULGE * np.ptp(self.values, axis=1)) | (signed.min(axis=1) != signed.max(axis=1))
        turning &= size.max(axis=1) > ROUNDING * size.max(initial=0.0)
        plain, timed = np.abs(plain), np.abs(timed)
        nodes, node_weights = np.polynomial.legendre.leggauss(6)
        for k in np.flatnonzero(turning).tolist():
            coefficients = self.polynomial(k)
            edges = np.array([-1.0, *_roots(coefficients), 1.0])
            half = np.diff(edges) / 2
            x = (edges[:-1] + half)[:, None] + half[:, None] * nodes
            part = np.abs(chebyshev.chebval(x, coefficients)) * half[:, None] * node_weights * self.length[k] / 2
            plain[k] = part.sum()
            timed[k] = (part * (self.start[k] + self.length[k] * (x + 1) / 2)).sum()
        return float(plain.sum()), float(timed.sum())

    def _largest_in(self, k: int) -> tuple[float, float]:
        """Returns the largest value of the signal in piece `k`, and the time at which this value occurs [s]."""
        coefficients = self.polynomial(k)
        at = np.array([-1.0, *_roots(chebyshev.chebder(coefficients)), 1.0])
        values = chebyshev.chebval(at, coefficients)
        best = int(values.argmax())
        return float(values[best]), self.time(k, float(at[best]))


def exact(run: Run, signals: tuple[str, ...]) -> dict[str, Pieces]:
    """Returns signals of the continuous-time linear response of a run, exact between samples; empty if there is no such
    response.

    If the road velocity has a kink within a piece, the error of the polynomial is 1e-3 of the kink's effect on the signal. If
    kinks are only a few steps apart, the steps until the last wheel has passed all of these kinks are divided into shorter
    pieces.

    Args:
        run: run whose signals are computed.
        signals: names of the signals to return.
    """
    if run.vehicle.dampers:
        return {}
    (time, h), road = (run.prediction.time, run.prediction.timestep), run.road
    kinks = np.unique([kink + delay for kink in road.kinks for delay in delays(road, run.vehicle)])
    kinks = kinks[kinks < time[-1]]
    gap = min((one for one in np.diff(np.unique(road.kinks)) if one > 0), default=math.inf)
    cut = math.ceil(PER_GAP * h / gap * (1 - ROUNDING))
    whole = _exact_steps(run, signals, len(time) - 1, 1)
    if road.jumps:
        preview = run.controller.preview
        ahead = {0.0, preview.seconds if preview is not None else 0.0}
        jumps = {at - before for at, *_ in jumps_under_wheels(road, run.vehicle) for before in ahead}
        whole = {name: _cut_at(one, sorted(jumps), preview is None) for name, one in whole.items()}
    if cut <= 1 or not len(kinks) or not whole:
        return whole
    some = min(math.ceil(kinks[-1] / h) + 1, len(time) - 1)
    fine = _exact_steps(run, signals, some, min(cut, max(MOST_POINTS // (DEGREE * some), 1)))
    return {name: fine[name].before(one, some) for name, one in whole.items()}


def _exact_steps(run: Run, signals: tuple[str, ...], steps: int, cut: int) -> dict[str, Pieces]:
    """Returns signals of the continuous-time response over the first timesteps of a run.

    Args:
        run: run whose signals are computed.
        signals: names of the signals to return.
        steps: number of timesteps at the start of the run.
        cut: number of pieces per timestep.
    """
    prediction, model, h = run.prediction, run.vehicle.linear_model, run.prediction.timestep
    parts = max(min(DEGREE, MOST_POINTS // (steps * cut)), 2)
    every = parts * cut
    road = RoadInput(run.vehicle, run.road, np.arange(steps * every + 1) * (h / every))
    controller = prediction.controller
    if prediction.loop is not None and controller.linear is True:
        response = continuous_response(controller, road)
    elif controller.user_code:
        response = forced_continuous_response(np.repeat(prediction.requested_force, every, axis=0)[: steps * every + 1], road)
    else:
        return {}
    start = (prediction.time[:steps, None] + np.arange(cut) * (h / cut)).ravel()
    ats = [at for at, *_ in jumps_under_wheels(run.road, run.vehicle)]
    edges = [k for k in road.vertical_edges(held=False) if np.abs(road.time[k] - ats).min() <= EARLY * h]
    pieces = {}
    for name in signals:
        values = response[name]
        ends = values[parts::parts].copy()
        # A force that is held over a step changes only at the end of the step
        if prediction.loop is None and run.vehicle.limits.actuator_bandwidth is None:
            leaps = np.diff(prediction.requested_force[: steps + 1], axis=0) @ model.D[model.outputs.index(name)]
            ends[cut - 1 :: cut] -= leaps
        values = np.column_stack([values[:-1].reshape(-1, parts), ends])
        # Values at the start of the pieces that begin at an edge
        for k in (k for k in edges if name in response.before and k % parts == 0):
            values[k // parts, 0] = response.before[name][k]
        pieces[name] = Pieces(start, np.full(steps * cut, h / cut), values)
    return pieces


def _cut_at(pieces: Pieces, jumps: Sequence[float], behind: bool) -> Pieces:
    """Returns the pieces after division at jumps of the signal. Each polynomial uses only points on one side of the jump.

    Args:
        pieces: pieces of the signal. A point at the time of a jump contains the value before the jump.
        jumps: times at which the signal jumps [s], ascending.
        behind: True if a piece that begins at a jump already has the value after the jump at its first point.
    """
    for at in (one for one in jumps if 0 <= one < pieces.start[-1]):
        near = EARLY * pieces.length[0]
        k = int(np.searchsorted(pieces.start, at + near)) - 1
        rows, points = slice(max(k - 1, 0), k + 2), np.linspace(0, 1, pieces.values.shape[1])
        times, first = np.unique((pieces.start[rows, None] + pieces.length[rows, None] * points).round(12), return_index=True)
        values, left = pieces.values[rows].ravel()[first], times <= at + near
        start, length = pieces.start[k], pieces.length[k]
        if behind and at - start <= near:
            continue
        ends = [(start, at, left), (at, start + length, ~left)] if at - start > near else [(start, start + length, ~left)]
        new = []
        for begin, end, side in ends:
            some = np.flatnonzero(side)[-DEGREE:] if end == at else np.flatnonzero(side)[:DEGREE]
            new.append((begin, end - begin, barycentric_interpolate(times[some], values[some], begin + (end - begin) * points)))
        parts = zip((pieces.start, pieces.length, pieces.values), zip(*new, strict=True), strict=True)
        pieces = Pieces(*(np.concatenate([whole[:k], np.array(part), whole[k + 1 :]]) for whole, part in parts))
    return pieces


def interpolated_signals(run: Run, response: Response, signals: tuple[str, ...]) -> dict[str, Pieces]:
    """Interpolates signals that are known only at samples: held forces are constant during each timestep, other signals are
    cubics between jumps.

    Args:
        run: run whose signals are computed.
        response: response of a run, for example the MuJoCo response.
        signals: names of the signals to return.
    """
    time, h, road = response.time, run.prediction.timestep, run.prediction.input
    held = set() if run.vehicle.limits.actuator_bandwidth is not None else set(run.vehicle.linear_model.inputs)
    # an adjustable damper may hold its damping coefficient, but its force is not constant
    held -= {one.force for one in run.vehicle.parts.adjustable}
    edges, pieces = road.vertical_edges(), dict[str, Pieces]()
    early = [k for k, edge in edges.items() if not edge.behind]  # at these edges, `before` contains the values after the edge
    for name in signals:
        right, left, parts = response[name].copy(), response.before.get(name, response[name]).copy(), list[Array]()
        right[early], left[early] = left[early], right[early]
        jumps = np.flatnonzero(np.abs(right - left) > SAME_VALUE * response.peak(name)).tolist()
        for a, b in itertools.pairwise(sorted({0, *edges, *jumps, len(time) - 1})):
            part = np.append(right[a:b], left[b])
            parts.append(np.repeat(part[:-1, None], 2, axis=1) if name in held else _cubics(part))
        pieces[name] = Pieces(time[:-1], np.full(len(time) - 1, h), np.concatenate(parts))
    return pieces


def _cubics(values: Array) -> Array:
    """Returns four points of a cubic for each timestep, shape (T - 1, 4). The cubic goes through the four nearest samples."""
    count = len(values)
    near = min(count, 4)
    first = np.clip(np.arange(count - 1) - 1, 0, count - near)
    offset = np.arange(count - 1) - first
    grid = np.arange(float(near))
    coefficients = np.empty((count - 1, 4))
    for where in range(near - 1):  # `where` is the index of the step among the gaps between these four samples
        rows = np.flatnonzero(offset == where)
        x = where + np.arange(4.0) / 3
        lagrange = np.array([np.prod([(x - m) / (j - m) for m in grid if m != j], axis=0) for j in grid])
        coefficients[rows] = values[first[rows, None] + np.arange(near)] @ lagrange
    return coefficients


def _fit(points: int) -> Array:
    """Returns the matrix that converts the values of a polynomial at equidistant points to Chebyshev coefficients."""
    return np.linalg.inv(chebyshev.chebvander(np.linspace(-1, 1, points), points - 1))


def _integral(points: int) -> Array:
    """Returns weights for equidistant values; the weighted sum of the values is the integral from -1 to 1."""
    even = np.array([2 / (1 - j * j) if j % 2 == 0 else 0.0 for j in range(points)])
    return even @ _fit(points)


def _roots(coefficients: Array) -> list[float]:
    """Returns the real roots of a Chebyshev series between -1 and 1, in ascending order."""
    trimmed = chebyshev.chebtrim(coefficients, 1e-15 * float(np.abs(coefficients).max()))
    roots = chebyshev.chebroots(trimmed) if len(trimmed) > 1 else np.zeros(0)
    real = np.real(roots[np.abs(np.imag(roots)) < 1e-9])
    return np.sort(real[(real > -1) & (real < 1)]).tolist()
