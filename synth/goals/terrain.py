"""A problem as one function of the gain: the largest of its goals, and by how much the worst of its bounds is passed.

While bounds are passed, a share of the excess is added (an exact penalty): at a factor larger than what a bound costs, the least
of the sum is the least of the goals within the bounds. A sum of two maxima is the maximum over pairs, so that the model of a
step is the one of `synth.search.descent`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from synth.goals.terms import Support, Term

KEPT = 1e-9  # relative: what is passed by less is kept, as bounds are drawn tighter than that


@dataclass(frozen=True)
class Height:
    """Where a point stands.

    Attributes:
        goal: the largest value of a goal; infinite where a loop is unstable.
        excess: by how much the worst bound is passed, relative; negative within all.
    """

    goal: float
    excess: float

    @property
    def within(self) -> bool:
        """Whether all bounds are kept."""
        return self.excess <= KEPT


@dataclass(frozen=True, eq=False)
class Model:
    """Supports of all terms that may count near a point.

    Attributes:
        goals: of the goals, each with the index of its term.
        bounds: of the bounds, likewise.
    """

    goals: tuple[tuple[int, Support], ...]
    bounds: tuple[tuple[int, Support], ...]


class Terrain:
    """The terms of a problem.

    Attributes:
        goals: what is minimised is the largest of them.
        bounds: none of them may exceed 1.
        limit: the largest entries of a point, shape (N,).
    """

    def __init__(self, goals: Sequence[Term], bounds: Sequence[Term], limit: Array) -> None:
        self.goals, self.bounds, self.limit = list(goals), list(bounds), limit
        self._known: tuple[bytes, dict[tuple[int, float], float]] = b"", {}  # values at one point, by term and unit

    def value(self, term: Term, x: Array, above: float = np.inf) -> float:
        """Of a term at a point, as `Term.value` has it; those of the last point are remembered."""
        at = x.tobytes()
        if self._known[0] != at:
            self._known = at, {}
        known, key = self._known[1], (id(term), term.unit)
        if key not in known:
            value = term.value(x, above)
            if not value <= above:
                return value
            known[key] = value
        return known[key]

    def height(self, x: Array, above: float = np.inf, penalty: float = 0.0) -> Height:
        """Of a point.

        Args:
            x: the point.
            above: the search ends early where goal (1 + penalty excess) is known to exceed this.
            penalty: see above.
        """
        goal, excess = 0.0, -1.0
        for term in self.goals:
            goal = max(goal, self.value(term, x, above))
            if goal > above:
                return Height(goal, excess)
        for term in self.bounds:
            most = above / goal - 1 if goal > 0 else np.inf  # of penalty times excess
            excess = max(excess, self.value(term, x, 1 + most / penalty if penalty > 0 else np.inf) - 1)
            if penalty * excess > most:
                break
        return Height(goal, excess)

    def passed(self, x: Array) -> dict[str, float]:
        """The bounds that a point passes, by name, and by how much, relative, the worst first."""
        excess: dict[str, float] = {}
        for term in sorted(self.bounds, key=lambda term: -term.value(x)):
            excess.setdefault(term.name, term.value(x) - 1)
        return {name: share for name, share in excess.items() if share > KEPT}

    def model(self, x: Array, height: Height, depth: float) -> Model:
        """What supports the goals within a share of the largest, and the bounds that are near."""
        goals, bounds = [], []
        for i, term in enumerate(self.goals):
            value = self.value(term, x)
            if value >= height.goal * (1 - depth):
                goals.append((i, term.support(x, value, 1 - height.goal * (1 - depth) / value if value > 0 else depth)))
        for i, term in enumerate(self.bounds):
            value = self.value(term, x)
            if value >= 1 - 3 * depth:
                bounds.append((i, term.support(x, value, depth)))
        return Model(tuple(goals), tuple(bounds))

    def again(self, x: Array, model: Model) -> Model:
        """The same functions at another point."""
        return Model(
            tuple((i, self.goals[i].again(x, support)) for i, support in model.goals),
            tuple((i, self.bounds[i].again(x, support)) for i, support in model.bounds),
        )


def stacked(supports: Sequence[tuple[int, Support]], count: int) -> tuple[Array, Array]:
    """Values, shape (F,), and slopes, shape (F, N), of supports one after another."""
    if not supports:
        return np.zeros(0), np.zeros((0, count))
    return np.concatenate([each.values for _, each in supports]), np.concatenate([each.slopes for _, each in supports])
