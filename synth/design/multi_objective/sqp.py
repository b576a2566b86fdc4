"""Descent on a minimax problem within its bounds: sequential quadratic programming with an exact penalty.

While bounds are exceeded, a multiple of the excess is added to the goal (an exact penalty). If the factor exceeds the
multipliers of the bounds, the minimum of the sum is the minimum of the goal within the bounds. A sum of two maxima is the maximum
over pairs, so the model of a step is that of `synth.design.descent.minimax`.

The descent is `synth.design.descent.minimax.along_edges`, over the terms of a problem instead of one norm. A step minimises the
largest of the linearised functions that bound the terms from below, plus their curvature. The functions found at the end of a
failed step join the model.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from synth.design.descent.minimax import convex, lowest_point
from synth.design.multi_objective.objectives import Linearisation, Objective
from synth.plant.numerics import up_to_rounding

KEPT = 1e-9  # relative: a bound that is exceeded by less counts as kept, as bounds have a larger margin


@dataclass(frozen=True)
class Evaluation:
    """Goal and violation of the bounds at a point.

    Attributes:
        goal: the largest value of a goal; infinite if a loop is unstable.
        excess: relative violation of the worst bound; negative if all are kept.
    """

    goal: float
    excess: float

    @property
    def within(self) -> bool:
        """True if all bounds are kept."""
        return self.excess <= KEPT


@dataclass(frozen=True, eq=False)
class LocalModel:
    """Supports of all terms that may count near a point.

    Attributes:
        goals: supports of the goals, each with the index of its term.
        bounds: supports of the bounds, each with the index of its term.
    """

    goals: tuple[tuple[int, Linearisation], ...]
    bounds: tuple[tuple[int, Linearisation], ...]


class MinimaxProblem:
    """Minimisation of the largest of some terms, under bounds on others.

    Attributes:
        goals: the largest of them is minimised.
        bounds: bounds of the problem, none of which may exceed 1.
        limit: the largest entries of a point, shape (N,).
    """

    def __init__(self, goals: Sequence[Objective], bounds: Sequence[Objective], limit: Array) -> None:
        self.goals, self.bounds, self.limit = list(goals), list(bounds), limit
        self._known: tuple[bytes, dict[tuple[int, float], float]] = b"", {}  # values at one point, by term and unit

    def value(self, term: Objective, x: Array, above: float = np.inf) -> float:
        """Returns `Term.value` of a term at a point; values of the last point are cached."""
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

    def evaluate(self, x: Array, above: float = np.inf, penalty: float = 0.0) -> Evaluation:
        """Returns the merit of a point.

        Args:
            above: the evaluation ends early if goal (1 + penalty excess) is known to exceed this.
            penalty: factor of the excess.
        """
        goal, excess = 0.0, -1.0
        for term in self.goals:
            goal = max(goal, self.value(term, x, above))
            if goal > above:
                return Evaluation(goal, excess)
        for term in self.bounds:
            most = above / goal - 1 if goal > 0 else np.inf  # limit of penalty times excess
            excess = max(excess, self.value(term, x, 1 + most / penalty if penalty > 0 else np.inf) - 1)
            if penalty * excess > most:
                break
        return Evaluation(goal, excess)

    def passed(self, x: Array) -> dict[str, float]:
        """Returns the bounds that a point exceeds, by name, with the relative excess, the worst first."""
        excess: dict[str, float] = {}
        for term in sorted(self.bounds, key=lambda term: -term.value(x)):
            excess.setdefault(term.name, term.value(x) - 1)
        return {name: share for name, share in excess.items() if share > KEPT}

    def model(self, x: Array, evaluation: Evaluation, depth: float) -> LocalModel:
        """Returns the linearisations of the goals near the largest, and of the bounds that are nearly active."""
        goals, bounds = [], []
        for i, term in enumerate(self.goals):
            value = self.value(term, x)
            if value >= evaluation.goal * (1 - depth):
                goals.append((i, term.support(x, value, 1 - evaluation.goal * (1 - depth) / value if value > 0 else depth)))
        for i, term in enumerate(self.bounds):
            value = self.value(term, x)
            if value >= 1 - 3 * depth:
                bounds.append((i, term.support(x, value, depth)))
        return LocalModel(tuple(goals), tuple(bounds))

    def reevaluate(self, x: Array, model: LocalModel) -> LocalModel:
        """Returns the same functions at another point."""
        return LocalModel(
            tuple((i, self.goals[i].reevaluate(x, support)) for i, support in model.goals),
            tuple((i, self.bounds[i].reevaluate(x, support)) for i, support in model.bounds),
        )


def stacked(supports: Sequence[tuple[int, Linearisation]], count: int) -> tuple[Array, Array]:
    """Returns the joined values, shape (F,), and slopes, shape (F, N), of supports."""
    if not supports:
        return np.zeros(0), np.zeros((0, count))
    return np.concatenate([each.values for _, each in supports]), np.concatenate([each.slopes for _, each in supports])


FIRST, LARGEST = 4.0, 1e6  # penalties: relative rise of the goals per relative excess over a bound
FLAT = 1e-7  # relative decrease over so many rounds that counts as none
OVER = 10
MOST_PAIRS = 400


def descend(
    minimax: MinimaxProblem,
    x: Array,
    M: Array,
    rounds: int,
    on_progress: Callable[[Array, Evaluation], None] = lambda x, evaluation: None,
    enough: float = 0.0,
    settled: float = -np.inf,
    flat: float = FLAT,
) -> tuple[Array, Evaluation]:
    """Descends from a point at which all loops are stable, within the bounds if the start is or a way there is found.

    Args:
        M: coordinates in which all directions have equal weight, shape (N, N).
        rounds: largest number of iterations.
        on_progress: callback that receives every new point.
        enough: value of the goal at which the descent ends.
        settled: predicted relative decrease below which the descent ends immediately, without another refinement of the model.
        flat: relative decrease over `OVER` rounds that counts as none.
    """
    walk = _Walk(minimax, x, M, settled, flat)
    with up_to_rounding():  # for a loop on the border of stability
        for _ in range(rounds):
            if walk.evaluation.goal <= enough or not walk.step():
                break
            on_progress(walk.x, walk.evaluation)
    return walk.x, walk.evaluation


class _Walk:
    """The state of one descent."""

    def __init__(self, minimax: MinimaxProblem, x: Array, M: Array, settled: float, flat: float) -> None:
        self.minimax, self.x, self.M, self.settled, self.flat = minimax, x, M, settled, flat
        self.evaluation = minimax.evaluate(x)
        if np.isfinite(self.evaluation.goal) and self.evaluation.goal > 0:  # a unit of t has the size of a step
            (_, s), (_, w) = self.linear(minimax.model(x, self.evaluation, 1e-3))
            self.M = M / (float(np.linalg.norm(np.vstack([s, w]), axis=1).max(initial=0.0)) or 1.0)
        self.penalty, self.depth, self.damping = FIRST, 0.1, 1e-2
        self.hessian = 0.1 * np.eye(M.shape[1])
        self.kept: LocalModel = LocalModel((), ())
        self.failures, self.recent = 0, [self.merit(self.evaluation)]

    def merit(self, evaluation: Evaluation) -> float:
        """Returns the goal with the penalty."""
        return evaluation.goal * (1 + self.penalty * max(evaluation.excess, 0.0))

    def lowest(self, goals: tuple[Array, Array], bounds: tuple[Array, Array]) -> tuple[Array, Array, Array, float]:
        """Returns the step that minimises the model, the weights of goals and bounds, and the promised decrease."""
        (v, s), (c, w) = goals, bounds
        values = np.append(0.0, self.penalty * c)  # no bound, or one of the bounds
        slopes = np.vstack([np.zeros((1, s.shape[1])), self.penalty * w])
        pairs = (v[:, None] + values).ravel()
        along = (s[:, None] + slopes).reshape(len(pairs), -1)
        order = np.argsort(-pairs)[:MOST_PAIRS]
        t, some = lowest_point(pairs[order], along[order], self.hessian, self.M, self.x, self.minimax.limit)
        if not some.sum() > 0:
            raise np.linalg.LinAlgError("no function of the model counts")
        weights = np.zeros(len(pairs))
        weights[order] = some / some.sum()
        table = weights.reshape(len(v), -1)
        now = max(float(values.max()), 0.0)
        return t, table.sum(axis=1), self.penalty * table[:, 1:].sum(axis=0), now - float(np.max(pairs + along @ t))

    def linear(self, model: LocalModel) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Returns the model's functions in the descent's coordinates, relative."""
        n, goal = len(self.x), self.evaluation.goal
        (v, s), (c, w) = stacked(model.goals, n), stacked(model.bounds, n)
        return (v / goal - 1, s @ self.M / goal), (c - 1, w @ self.M)

    def step(self) -> bool:
        """Performs one iteration. Returns True if another may follow."""
        minimax, x, M = self.minimax, self.x, self.M
        if self.failures > 8 or self.evaluation.goal <= 1e-300:
            return False
        if len(self.recent) > OVER and self.recent[-1 - OVER] - self.recent[-1] < self.flat * self.recent[-1]:
            return False
        fresh = minimax.model(x, self.evaluation, self.depth)
        old = minimax.reevaluate(x, self.kept)
        model = LocalModel(fresh.goals + old.goals, fresh.bounds + old.bounds)
        goals, bounds = self.linear(model)
        _, of_goals, of_bounds, _ = self.lowest(goals, bounds)
        curvature = self.curvature(fresh, of_goals, of_bounds)
        if np.any(curvature):
            self.hessian = convex(M.T @ curvature @ M, self.damping)
        t, of_goals, of_bounds, fall = self.lowest(goals, bounds)
        while of_bounds.sum() > 0.8 * self.penalty and self.penalty < LARGEST and np.max(bounds[0] + bounds[1] @ t) > 1e-9:
            self.penalty *= 4  # the step exceeds a bound that a step with a larger penalty keeps
            t, of_goals, of_bounds, fall = self.lowest(goals, bounds)
        if fall < self.settled:
            return False
        here = self.merit(self.evaluation)
        if not fall > 1e-10:
            self.depth, self.failures = self.depth / 4, self.failures + 1
            return True
        move, length, beyond_model, corrected = M @ t, 1.0, LocalModel((), ()), False
        while length > 1e-3:
            allowed = here * (1 - 1e-2 * length * fall)
            there = self.at(x + length * move, allowed)
            if self.merit(there) <= allowed:
                break
            if np.isfinite(there.goal) and not corrected:
                # The edges are curved, so their functions are modelled anew at the end of the step (a second-order correction).
                corrected = True
                whole = minimax.evaluate(x + move)
                if np.isfinite(whole.goal):
                    beyond = minimax.model(x + move, whole, self.depth)
                    beyond_model = beyond
                    better = M @ self.lowest(*self.shifted(beyond, t))[0]
                    there = self.at(x + better, allowed)
                    if self.merit(there) <= allowed:
                        move = better
                        break
            length *= 0.3
        else:
            self.damping, self.failures, self.hessian = 10 * self.damping, self.failures + 1, 10 * self.hessian
            self.kept = LocalModel((self.kept.goals + beyond_model.goals)[-6:], (self.kept.bounds + beyond_model.bounds)[-6:])
            return True
        while length >= 1 and np.all(np.abs(x + 3 * length * move) <= minimax.limit):  # a minimum far away, or at infinity
            needed = self.merit(there) - 0.1 * length * fall * here
            further = self.at(x + 3 * length * move, needed)
            if self.merit(further) > needed:
                break
            length, there = 3 * length, further
        self.failures, self.kept = (0 if length > 0.05 else self.failures), beyond_model
        self.damping = max(self.damping / 4, 1e-8) if length >= 1 else self.damping * 2
        self.x = np.clip(x + length * move, -minimax.limit, minimax.limit)
        self.evaluation = minimax.evaluate(self.x)
        self.recent.append(self.merit(self.evaluation))
        return True

    def at(self, x: Array, allowed: float) -> Evaluation:
        """Returns the evaluation of a point, which ends early if its result can no longer matter."""
        return self.minimax.evaluate(x, allowed, self.penalty)

    def shifted(self, model: LocalModel, t: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Returns functions made at the end of a step t, expressed from its start."""
        (v, s), (c, w) = self.linear(model)
        return (v - s @ t, s), (c - w @ t, w)

    def curvature(self, fresh: LocalModel, of_goals: Array, of_bounds: Array) -> Array:
        """Returns the curvature of the functions that are active at the point, with the weights of the model."""
        total = np.zeros((len(self.x), len(self.x)))
        for terms, supports, weights, unit in (
            (self.minimax.goals, fresh.goals, of_goals, self.evaluation.goal),
            (self.minimax.bounds, fresh.bounds, of_bounds, 1.0),
        ):
            start = 0
            for i, support in supports:
                own = weights[start : start + len(support.values)]
                start += len(support.values)
                if len(own) and own.max() > 1e-6:
                    total += terms[i].curvature(self.x, support, own) / unit
        return total
