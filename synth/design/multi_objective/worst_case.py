"""Search for the worst gain errors: for a norm, at the vertices of the box of errors; for the slowest pole, in the whole box.

A loop with gain errors is the same as a loop without errors that has the gain (1 + forces) K (1 + sensors).
"""

from collections.abc import Iterator
from functools import cache

import numpy as np

from models.common.arrays import Array
from synth.analysis.uncertainty_box import Box
from synth.design.descent.landscape import Band
from synth.design.multi_objective.band_norm import BandLandscape
from synth.design.multi_objective.problem import GainErrors, MultiObjectiveProblem, NormSpecification

TURNS = 4  # largest number of passes over all gain errors
NOT_STABLE = 1e6  # upper limit on relative values, which replaces the infinite value of an unstable loop
# Largest number of gain errors for which all vertices of the box are tried. With more errors, 2^8 random vertices are tried to
# find the slowest pole
CORNERS = 8
INSIDE = 64  # number of random points inside the box of gain errors that are tried
SEED = 20261122


class WorstCaseErrors:
    """Search for the worst gain errors of a multi-objective problem."""

    def __init__(self, problem: MultiObjectiveProblem) -> None:
        self.problem = problem
        self.sides = np.concatenate([problem.tolerance.sensors, problem.tolerance.forces])
        self.free = np.flatnonzero(self.sides)
        self.landscape = cache(self._landscape)

    def beyond(self, K: Array, goal: float, rate: float) -> Iterator[tuple[float, GainErrors]]:
        """Yields, for every member, the worst errors found for the goal, for each bound on a norm, and for the decay rate.

        Each item contains the gain errors, and the value that they cause, divided by the known goal or by the bound. A value
        above 1 means that the gain errors of the item are worse than all known errors.

        Args:
            K: gain, shape (m, q).
            goal: largest value of the goal known so far.
            rate: required decay rate [rad/s]; 0 if there is no requirement.
        """
        problem = self.problem
        for i in range(len(problem.members)):
            unit = problem.bests[i] if problem.bests is not None else 1.0
            yield self.of_norm(i, problem.minimise, unit * goal, K)
            for norm in problem.norms:
                yield self.of_norm(i, norm, norm.at_most, K)
            if rate:
                yield self.of_decay(i, rate, K)

    def of_norm(self, i: int, norm: NormSpecification, unit: float, K: Array) -> tuple[float, GainErrors]:
        """Returns the largest norm of a member, divided by `unit`, and the gain errors that cause this norm.

        If there are few gain errors, all vertices of the box are tried. If there are many gain errors, the search changes one
        error at a time.
        """
        landscape = self.landscape(i, norm.which, norm.band)

        def at(signs: Array) -> float:
            return min(landscape.norm(landscape.point(self._acting(K, signs)))[0] / unit, NOT_STABLE)

        best, worst = at(np.zeros_like(self.sides)), np.zeros_like(self.sides)
        if len(self.free) <= CORNERS:
            for signs in self._vertices():
                if (value := at(signs)) > best:
                    best, worst = value, signs
            return best, self._errors(worst)
        for start in (1.0, -1.0):
            signs = np.full_like(self.sides, start)
            value = at(signs)
            for _ in range(TURNS):
                changed = False
                for k in self.free:
                    signs[k] = -signs[k]
                    there = at(signs)
                    if there > value:
                        value, changed = there, True
                    else:
                        signs[k] = -signs[k]
                if not changed:
                    break
            if value > best:
                best, worst = value, signs
        return best, self._errors(worst)

    def of_decay(self, i: int, rate: float, K: Array) -> tuple[float, GainErrors]:
        """Returns the value of `Decay` for the slowest pole of a member, and the gain errors that cause this value."""
        real, errors = self.slowest(i, K)
        return min(2 + real / rate, NOT_STABLE), errors

    def unstable(self, K: Array) -> list[GainErrors]:
        """Returns, for each member that gain errors can make unstable, the worst errors."""
        if not len(self.free):
            return []
        slowest_of = (self.slowest(i, K) for i in range(len(self.problem.members)))
        return [errors for real, errors in slowest_of if not real < 0]

    def slowest(self, i: int, K: Array) -> tuple[float, GainErrors]:
        """Returns the largest real part of the poles that the gain can change [rad/s], over all gain errors that were tried,
        and the worst errors.

        The value is infinite if a loop is ill-posed. For a discrete plant, the poles of its continuous counterpart are used.
        """
        count, rng = len(self.free), np.random.default_rng(SEED)
        if count > CORNERS:
            tried = np.zeros((2**CORNERS, len(self.sides)))
            tried[:, self.free] = rng.choice((-1.0, 1.0), (len(tried), count))
        else:
            tried = self._vertices()
        inside = np.zeros((INSIDE + 1, len(self.sides)))  # the first of these points is the loop without gain errors
        inside[1:, self.free] = rng.uniform(-1, 1, (INSIDE, count))
        tried = np.concatenate([tried, inside])
        best, worst = -np.inf, tried[0]
        while True:
            values = self._slowest(i, K, tried)
            k = int(np.argmax(values))
            if not values[k] > best:
                return best, self._errors(worst)
            best, worst = float(values[k]), tried[k]
            # one gain error at a time is moved to its lower or upper limit
            tried = np.repeat(worst[None], 2 * count, axis=0)
            tried[np.arange(2 * count), np.tile(self.free, 2)] = np.repeat((-1.0, 1.0), count)
            if not count:
                return best, self._errors(worst)

    def _vertices(self) -> Array:
        """Returns all vertices of the box of gain errors, as multiples of the half-widths of the box, shape (2^k, q + m)."""
        ends = np.sign(self.sides)
        return Box(-ends, ends).vertices

    def _slowest(self, i: int, K: Array, signs: Array) -> Array:
        """Returns the largest real parts of poles, shape (N,), for gain errors in units of the box, shape (N, q + m)."""
        landscape = self.landscape(i, self.problem.minimise.which, self.problem.minimise.band)
        points = (self._acting(K, signs) / landscape.scale).reshape(len(signs), -1)
        own, plant = slice(landscape.own), landscape.plant
        A = plant.A[own, own] + plant.B[own] @ landscape.acting(points) @ plant.Cy[:, own]
        sound, slowest = np.all(np.isfinite(A), axis=(1, 2)), np.full(len(A), np.inf)
        slowest[sound] = np.linalg.eigvals(A[sound]).real.max(axis=1)
        return slowest

    def _acting(self, K: Array, signs: Array) -> Array:
        """Returns (1 + forces) K (1 + sensors), shape (..., m, q), for errors in units of the box, shape (..., q + m)."""
        factors, q = 1 + signs * self.sides, self.problem.shape[1]
        return factors[..., q:, None] * K * factors[..., None, :q]

    def _errors(self, signs: Array) -> GainErrors:
        q = self.problem.shape[1]
        return GainErrors((signs * self.sides)[:q], (signs * self.sides)[q:])

    def _landscape(self, i: int, which: int, band: Band) -> BandLandscape:
        return self.problem.landscape(i, which, band, self.problem.no_errors, None)


def worst_of_norm(
    problem: MultiObjectiveProblem, i: int, norm: NormSpecification | None, unit: float, K: Array
) -> tuple[float, GainErrors]:
    """Returns the largest norm or decay term that the search finds for a member, and the errors that cause this value.

    Args:
        problem: multi-objective problem of the member.
        i: index of the member.
        norm: norm that is evaluated; None for the decay rate.
        unit: reference value by which the result is divided; for the decay rate, the required rate [rad/s].
        K: gain, shape (m, q).
    """
    worst = WorstCaseErrors(problem)
    return worst.of_decay(i, unit, K) if norm is None else worst.of_norm(i, norm, unit, K)
