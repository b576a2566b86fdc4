"""Designs along a trade-off front by continuation: first at the ends of the front, then along rays between the ends.

A ray goes from the origin through a point u of the plane through the ends of the front. The design on the ray through u
minimises the largest v_k / u_k, where v_k is the norm on axis k (Chebyshev's scalarisation). Every point of the front lies on a
ray, whether the front is convex or not. Each gain is optimised by the same descent (numerical minimisation) as in a design for
goals. Each descent starts at the known design that is best for the ray, so that few iterations are necessary.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from synth.design.descent.minimax import BOUND_TOLERANCE, MinimaxProblem, descend
from synth.design.descent.starts import survey
from synth.design.descent.terms import NormTerm
from synth.design.multi_objective.band_norm import BandLandscape
from synth.design.multi_objective.search import RANK, UNSTABLE, MinimaxSearch
from synth.plant.numerics import DesignError

GROWTH = 5.0  # largest gain entry if the user gives no limit, as a multiple of the largest entry of the first starting gain
# At an end of the trade-off, the norm of the end's axis may exceed its smallest value by this relative amount. The other norms
# may then be smaller
NEARLY = 1e-3
TIGHTER = 1e-7  # relative amount by which the limit on a norm is tightened, to allow for rounding
SETTLED_STEP = 1e-7  # a descent ends if the predicted relative decrease is smaller than this
ROUNDS = 60  # largest number of rounds of a descent
TIMES = 6  # largest number of descents to an end of the trade-off; each descent starts where the previous one ended
NOTHING = 1e-9  # a value of an axis counts as zero if it is below this multiple of the other values of the axis


@dataclass(frozen=True, eq=False)
class EvaluatedGain:
    """Gain of a controller, with the norms on all axes that it yields.

    Attributes:
        x: coordinates that represent the gain in the landscape, shape (N,).
        values: norms on the K axes, shape (K,).
        excess: relative violation of the bound that is violated most; see `Evaluation`.
    """

    x: Array
    values: Array
    excess: float


class FrontContinuation:
    """Continuation of designs along the trade-off front of one design problem.

    Attributes:
        met: all stabilising gains with finite norms that were evaluated at the start or the end of a descent.
    """

    def __init__(self, search: MinimaxSearch, axes: Sequence[Sequence[BandLandscape]], starts: Sequence[Array]) -> None:
        """Evaluates the starting points of the continuation.

        Args:
            search: search object, which contains the bounds, the structure of the gain and starting points; the goal in it is
                not used.
            axes: landscapes (norms as functions of the gain) for each axis; the value on the axis is the largest of these
                norms.
            starts: starting gains, each of shape (m, q).

        Raises:
            DesignError: no starting gain stabilises the loop or satisfies the bounds.
        """
        self.search, self.axes, self.met = search, axes, list[EvaluatedGain]()
        points = search.points(starts)
        size = float(max((np.abs(x).max(initial=0.0) for x in points[:1]), default=0.0)) or 1.0
        if search.problem.gain is None:
            search.minimax.limit = np.full(search.full.scale.size, GROWTH * size)
        limit, mask = search.minimax.limit, search.problem.structure.ravel()
        points += [0.5 * x for x in points] + [np.zeros(len(limit))]
        points += [np.where(mask, x, 0.0) for x in survey(search.full, limit)]
        for x in points:
            self.evaluate(np.clip(x, -limit, limit))
        if not self.met:
            for x in points:
                self.evaluate(search.stabilised(x))
        if not self.met:
            raise DesignError(UNSTABLE)
        if min(each.excess for each in self.met) > BOUND_TOLERANCE:
            x, _ = search.restore_feasibility(min(self.met, key=lambda each: each.excess).x)
            self.evaluate(x)
            if self.met[-1].excess > BOUND_TOLERANCE:
                raise DesignError(search.explain_infeasibility(x))

    def evaluate(self, x: Array) -> EvaluatedGain | None:
        """Evaluates and stores the gain at the point `x`. Returns None if the loop with this gain is unstable."""
        values = np.array([max(landscape.norm(x)[0] for landscape in of) for of in self.axes])
        if not np.all(np.isfinite(values)):
            return None
        excess = max((term.value(x) - 1 for term in self.search.minimax.bounds), default=-1.0)
        self.met.append(EvaluatedGain(x, values, excess))
        return self.met[-1]

    def gain(self, evaluated: EvaluatedGain) -> Array:
        """Returns the gain K of an evaluated point, shape (m, q)."""
        return self.search.full.gain(evaluated.x)

    def ends(self) -> Array:
        """Returns the norms at the ends of the front, shape (K, K).

        Row k contains the norms at the end where the norm on axis k is within 0.1 % of its smallest value.
        """
        return np.array([self._end(k).values for k in range(len(self.axes))])

    def step_along(self, unit: Array) -> EvaluatedGain:
        """Returns the best design on the ray through the point `unit`, whose entries are not negative, shape (K,)."""
        unit = np.maximum(unit, NOTHING * np.max([each.values for each in self.met], axis=0))
        start = min(self.met, key=lambda each: float(np.max(each.values / unit)) * (1 + RANK * max(each.excess, 0.0)))
        return self._descend(start, {k: float(unit[k]) for k in range(len(unit))}, {})

    def _end(self, k: int) -> EvaluatedGain:
        """Returns the design at that end of the front where the norm on axis k is smallest."""
        start = min((each for each in self.met if each.excess <= BOUND_TOLERANCE), key=lambda each: float(each.values[k]))
        for _ in range(TIMES):
            if start.values[k] <= NOTHING * max(each.values[k] for each in self.met):
                return start
            end = self._descend(start, {k: 1.0}, {})
            done = end.values[k] > start.values[k] * (1 - 1e-5)
            start = min(start, end, key=lambda each: (each.excess > BOUND_TOLERANCE, float(each.values[k])))
            if done:
                break
        most = float(start.values[k]) * (1 + NEARLY)
        inside = [each for each in self.met if each.excess <= BOUND_TOLERANCE and each.values[k] <= most]
        others = {j: float(start.values[j]) for j in range(len(self.axes)) if j != k}
        start = min(inside, key=lambda each: max(each.values[j] / unit for j, unit in others.items()))
        for _ in range(TIMES):
            end = self._descend(start, {j: float(start.values[j]) or 1.0 for j in others}, {k: most})
            if end.values[k] > most or end.excess > BOUND_TOLERANCE:
                break
            done = all(end.values[j] > start.values[j] * (1 - 1e-5) for j in others)
            start = end
            if done:
                break
        return start

    def _descend(self, start: EvaluatedGain, goals: dict[int, float], bounds: dict[int, float]) -> EvaluatedGain:
        """Minimises the largest norm among some axes, each norm divided by the axis's entry in `goals`, with bounds on the
        other axes.

        Returns:
            The gain at the end of the descent; `start` if the loop with this gain is unstable.
        """
        terms = {k: [NormTerm(landscape, unit) for landscape in self.axes[k]] for k, unit in goals.items()}
        bounding = [NormTerm(landscape, most * (1 - TIGHTER)) for k, most in bounds.items() for landscape in self.axes[k]]
        minimax = self.search.minimax
        ground = MinimaxProblem([each for some in terms.values() for each in some], [*minimax.bounds, *bounding], minimax.limit)
        x, _ = descend(ground, start.x, self.search.coordinates(start.x), ROUNDS, settled=SETTLED_STEP)
        return self.evaluate(x) or start


def rays(ends: Array, count: int) -> Iterator[Array]:
    """Yields about `count` points of the plane through the ends of the front. Successive points are neighbours.

    Args:
        ends: norms at the ends of the front, one row per end, shape (K, K), where K is 2 or 3.
        count: requested number of points. For three ends, the nearest number of points that form a triangular lattice is used.
    """
    if len(ends) == 2:
        for share in np.linspace(0, 1, count):
            yield (1 - share) * ends[0] + share * ends[1]
        return
    sides = _sides(count)
    for i in range(sides + 1):
        row = range(sides - i + 1)
        for j in row if i % 2 == 0 else reversed(row):
            yield np.array([sides - i - j, j, i]) / sides @ ends


def rays_of(axes: int, count: int) -> int:
    """Returns the number of rays that is possible for two or three axes and closest to the requested count."""
    return count if axes == 2 else (_sides(count) + 1) * (_sides(count) + 2) // 2


def _sides(count: int) -> int:
    """Returns the number of intervals on each side of a triangular lattice with about `count` points."""
    return max(1, round((np.sqrt(8 * count + 1) - 3) / 2))


def undominated_rows(values: Array) -> Array:
    """Returns a mask of the designs (rows) that no other design dominates, shape (N,). The mask includes only the first of
    several equal rows.

    Args:
        values: values of N designs on K axes, shape (N, K).
    """
    if not len(values):
        return np.zeros(0, dtype=bool)
    no_worse = np.all(values[:, None] <= values[None], axis=-1)  # True at [i, j] if row i exceeds row j on no axis
    alike = no_worse & no_worse.T
    better = (no_worse & ~alike) | (alike & (np.arange(len(values))[:, None] < np.arange(len(values))))
    return ~np.any(better, axis=0)
