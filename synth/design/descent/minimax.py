"""Descent on a nonsmooth function: minimises the largest of several terms, within bounds on further terms.

- `descend` is sequential quadratic programming for a minimax problem. The model for a step is the maximum of linear functions
  that bound the terms from below, plus a quadratic term for their curvature. The step leads to the minimum of the model. If a
  step is too long, the linear functions at the end of the step are added to the model, as in bundle methods. If the curvature
  is unknown or has the wrong sign, the step length is measured in coordinates in which all directions have equal weight
  (`balanced_coordinates`).
- While a bound is exceeded, a multiple of the excess is added to the function that is minimised (an exact penalty). If the
  multiple exceeds the Lagrange multipliers of the bounds, the penalised function has the same minimum as the constrained
  problem. The sum of two maxima equals the maximum of the sums of all pairs of functions, so the penalised model has the same
  form.
- `descend_norm` applies `descend` to one norm, in stages that each have their own coordinates and curvature.
- `quasi_newton` is BFGS with a weak Wolfe line search; this method also works on nonsmooth functions in practice (Lewis,
  Overton 2013). BFGS is fast far from a minimum, but it stalls where the function has an edge.
"""

# pyright: reportAttributeAccessIssue=false
# scipy.linalg.lapack is made by f2py and has no type stubs.

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import optimize
from scipy.linalg import lapack

from models.common.arrays import Array
from synth.design.descent.landscape import Landscape, balanced_coordinates
from synth.design.descent.terms import Linearisation, NormTerm, Term
from synth.plant.numerics import up_to_rounding

# the descent has stalled if a function with values near one decreases by less than this over seven rounds
STALLED_DECREASE = 1e-4

STAGE = 30  # number of rounds in a stage of the descent
WORTH_A_STAGE = 3e-5  # another stage follows only if the norm decreased by at least this relative amount in the last stage
ENDING_DECREASE = 1e-5  # a stage ends if the norm decreases by less than this relative amount over `OVER` rounds

# at first, a subproblem includes a limit only if the entry is closer to the limit than this fraction of the limit
NEAR = 0.7

# a bound that is exceeded by less than this relative amount counts as fulfilled. The bounds were tightened by more than this
# amount
BOUND_TOLERANCE = 1e-9
POINTS = 3  # number of points whose values are stored: the last point and the points of trial steps

Function = Callable[[Array], tuple[float, Array]]


def quasi_newton(function: Function, x: Array, rounds: int, target: float = -np.inf) -> tuple[Array, float]:
    """Minimises a function by BFGS from x, until the value is below the target or no longer decreases.

    Returns:
        The last point and its value.

    Args:
        function: function that returns the value and the slope at a point. The value is infinite if the matrices of the closed
            loop are not finite.
        target: value below which the minimisation ends.
        x: starting point, with a finite value.
        rounds: largest number of iterations.
    """
    value, slope = function(x)
    inverse = np.eye(len(x)) * 0.1 / max(float(np.linalg.norm(slope)), 1e-300)
    recent = [value]
    for turn in range(rounds):
        if value < target or (len(recent) > 8 and recent[-8] - value < STALLED_DECREASE):
            break
        direction = -inverse @ slope
        fall = float(slope @ direction)
        if not fall < 0:
            break
        low, high, length, accepted = 0.0, np.inf, 1.0, None
        for _ in range(15):
            allowed = value + 1e-4 * length * fall
            there, its_slope = function(x + length * direction)
            if not there <= allowed:
                high = length
            else:
                accepted = (length, there, its_slope)
                if its_slope @ direction >= 0.5 * fall:
                    break
                low = length
            length = (low + high) / 2 if np.isfinite(high) else 2 * length
        if accepted is None:
            break
        length, there, its_slope = accepted
        step, change = length * direction, its_slope - slope
        curvature = float(step @ change)
        if curvature > 0:
            if turn == 0:
                inverse = np.eye(len(x)) * curvature / float(change @ change)
            shift = np.eye(len(x)) - np.outer(step, change) / curvature
            inverse = shift @ inverse @ shift.T + np.outer(step, step) / curvature
        x, value, slope = x + step, there, its_slope
        recent.append(value)
    return x, value


@dataclass(frozen=True)
class Evaluation:
    """Value of the goal and violation of the bounds at a point.

    Attributes:
        goal: largest value of all goals; infinite if a loop is unstable.
        excess: relative violation of the most violated bound; negative if all bounds are fulfilled.
        worst: indices of the largest goal and of the most violated bound.
    """

    goal: float
    excess: float
    worst: tuple[int, int] = (0, 0)

    @property
    def within(self) -> bool:
        """True if all bounds are fulfilled."""
        return self.excess <= BOUND_TOLERANCE


# functions that approximate the terms near a point, each with the index of the term that it approximates
Model = list[tuple[int, Linearisation]]
Cuts = list[tuple[int, Any]]  # data from which the functions are identified, with the index of the term that they approximate


class MinimaxProblem:
    """Minimisation of the largest of several terms, with bounds on further terms.

    Attributes:
        goals: terms of which the largest is minimised.
        bounds: terms that must not exceed 1.
        limit: largest absolute value of each entry of a point, shape (N,).
    """

    def __init__(self, goals: Sequence[Term], bounds: Sequence[Term], limit: Array) -> None:
        self.goals, self.bounds, self.limit = list(goals), list(bounds), limit
        self._known: dict[bytes, dict[tuple[int, float], float]] = {}  # stored values of terms at points

    def value(self, term: Term, x: Array, above: float = np.inf) -> float:
        """Returns `Term.value` of a term at a point. The values at the last points are cached."""
        known = self._known.setdefault(x.tobytes(), {})
        if len(self._known) > POINTS:
            del self._known[next(iter(self._known))]
        key = (id(term), term.unit)
        if key not in known:
            value = term.value(x, above)
            if not value <= above:
                return value
            known[key] = value
        return known[key]

    def evaluate(self, x: Array, above: float = np.inf, penalty: float = 0.0) -> Evaluation:
        """Returns the value of the largest goal and the violation of the bounds at a point.

        Args:
            above: limit; the evaluation ends early if the product of `goal` and (1 + penalty excess) exceeds this limit.
            penalty: factor that multiplies the violation `excess`.
        """
        goal, excess, i, j = 0.0, -1.0, 0, 0
        for k, term in enumerate(self.goals):
            value = self.value(term, x, above)
            goal, i = (value, k) if value > goal or np.isnan(value) else (goal, i)
            if goal > above:
                return Evaluation(goal, excess, (i, j))
        for k, term in enumerate(self.bounds):
            most = above / goal - 1 if goal > 0 else np.inf  # limit on the product of the penalty and the excess
            beyond = self.value(term, x, 1 + most / penalty if penalty > 0 else np.inf) - 1
            excess, j = (beyond, k) if beyond > excess else (excess, j)
            if penalty * excess > most:
                break
        return Evaluation(goal, excess, (i, j))

    @property
    def terms(self) -> list[Term]:
        """All terms: the goals, followed by the bounds."""
        return [*self.goals, *self.bounds]

    def cut(self, x: Array, evaluation: Evaluation) -> Cuts:
        """Returns the cuts of the largest goal and of the most violated bound, at the last point that was evaluated."""
        i, j = evaluation.worst
        bounds = [(len(self.goals) + j, self.bounds[j].cut(x, 1 + evaluation.excess))] if evaluation.excess > 0 else []
        return [(i, self.goals[i].cut(x, evaluation.goal)), *bounds]

    def passed(self, x: Array) -> dict[str, float]:
        """Returns the relative violations of the violated bounds at a point, by name, in descending order."""
        excess: dict[str, float] = {}
        for term in sorted(self.bounds, key=lambda term: -term.value(x)):
            excess.setdefault(term.name, term.value(x) - 1)
        return {name: share for name, share in excess.items() if share > BOUND_TOLERANCE}

    def model(self, x: Array, evaluation: Evaluation, depth: float) -> Model:
        """Returns linear functions that approximate the goals close to the largest goal, and the bounds that are nearly
        reached.
        """
        model, level = Model(), evaluation.goal * (1 - depth)
        for i, term in enumerate(self.terms):
            value, goal = self.value(term, x), i < len(self.goals)
            if value >= (level if goal else 1 - 3 * depth):
                model.append((i, term.support(x, value, 1 - level / value if goal and value > 0 else depth)))
        return model

    def of_cuts(self, x: Array, cuts: Cuts) -> Model:
        """Returns the smooth functions that the given cuts identify, evaluated at a point."""
        terms = self.terms
        return [(i, terms[i].reevaluate(x, each)) for i, each in cuts]


# initial and largest penalty. A relative violation v of a bound counts as much as a relative increase of the goals by v times
# the penalty
FIRST, LARGEST = 4.0, 1e6
FLAT = 1e-7  # the descent ends if the relative decrease over `OVER` rounds is smaller than this
OVER = 10
MOST_PAIRS = 400
LITTLE = 1e-3  # a function whose weight is smaller than this does not contribute to the curvature


def descend_norm(landscape: Landscape, x: Array, limit: Array, rounds: int, enough: float = 0.0) -> tuple[Array, float]:
    """Minimises the norm, starting at a stable point x, subject to |x_i| <= limit_i.

    The descent ends if the norm is at most `enough`, or if a stage hardly lowers the norm. Every stage computes its own
    coordinates, and starts without information about the curvature. Information about the curvature from the previous stage
    belongs to other edges of the norm, and would only shorten the steps.

    Returns:
        The final point, and its norm.
    """
    minimax = MinimaxProblem([NormTerm(landscape)], [], limit)
    norm = minimax.evaluate(x).goal
    for done in range(0, rounds, STAGE):
        with up_to_rounding():
            M, before = balanced_coordinates(landscape, x), norm
            x, there = descend(minimax, x, M, min(STAGE, rounds - done), enough=enough, flat=ENDING_DECREASE)
            norm = there.goal
            if enough < norm <= before * (1 - WORTH_A_STAGE) and not landscape.work.over:
                continue
        break
    return x, norm


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
    """Minimises the largest goal by descent from a point at which all loops are stable.

    The result fulfils the bounds if the starting point fulfils them, or if the descent finds a point that fulfils them.


    Args:
        M: matrix of coordinates in which all directions have equal weight, shape (N, N).
        rounds: largest number of iterations.
        on_progress: callback that receives every new point and its evaluation.
        enough: value of the goal at which the descent ends.
        settled: predicted relative decrease of the goal below which the descent ends immediately, without another refinement of
            the model.
        flat: relative decrease of the goal over `OVER` rounds below which the descent ends.

    Returns:
        The final point, and its evaluation.
    """
    walk = _Walk(minimax, x, M, settled, flat)
    with up_to_rounding():  # rounding errors may end the descent if a loop is at the stability limit
        for _ in range(rounds):
            if walk.evaluation.goal <= enough or not walk.step():
                break
            on_progress(walk.x, walk.evaluation)
    return walk.x, walk.evaluation


class _Walk:
    """Current state of one descent: its point, coordinates, penalty and curvature."""

    def __init__(self, minimax: MinimaxProblem, x: Array, M: Array, settled: float, flat: float) -> None:
        self.minimax, self.x, self.M, self.settled, self.flat = minimax, x, M, settled, flat
        self.evaluation = minimax.evaluate(x)
        # t is scaled so that a typical step has the size one
        if np.isfinite(self.evaluation.goal) and self.evaluation.goal > 0:
            (_, s), (_, w) = self.linear(minimax.model(x, self.evaluation, 1e-3))
            self.M = M / (float(np.linalg.norm(np.vstack([s, w]), axis=1).max(initial=0.0)) or 1.0)
        self.penalty, self.depth, self.damping = FIRST, 0.1, 1e-2
        self.hessian = 0.1 * np.eye(M.shape[1])
        self.kept_cuts = Cuts()
        self.failures, self.recent = 0, [self.merit(self.evaluation)]

    def merit(self, evaluation: Evaluation) -> float:
        """Returns the largest goal, multiplied by the penalty for violated bounds."""
        return evaluation.goal * (1 + self.penalty * max(evaluation.excess, 0.0))

    def lowest(self, goals: tuple[Array, Array], bounds: tuple[Array, Array]) -> tuple[Array, Array, Array, float]:
        """Returns the step that minimises the model, the weights of goals and bounds, and the predicted decrease."""
        (v, s), (c, w) = goals, bounds
        values = np.append(0.0, self.penalty * c)  # the first value stands for the case that no bound is violated
        slopes = np.vstack([np.zeros((1, s.shape[1])), self.penalty * w])
        pairs = (v[:, None] + values).ravel()
        along = (s[:, None] + slopes).reshape(len(pairs), -1)
        order = np.argsort(-pairs)[:MOST_PAIRS]
        t, some = solve_subproblem(pairs[order], along[order], self.hessian, self.M, self.x, self.minimax.limit)
        weights = np.zeros(len(pairs))
        weights[order] = some / (some.sum() or 1.0)
        table = weights.reshape(len(v), -1)
        now = max(float(values.max()), 0.0)
        return t, table.sum(axis=1), self.penalty * table[:, 1:].sum(axis=0), now - float(np.max(pairs + along @ t))

    def linear(self, model: Model) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        """Returns linear functions for the goals and for the bounds, as relative values in the coordinates of the descent."""
        empty, count, goal = np.zeros((0, len(self.x))), len(self.minimax.goals), self.evaluation.goal
        goals, bounds = ([each for i, each in model if (i < count) == which] for which in (True, False))
        (v, s), (c, w) = (
            (np.concatenate([empty[:, 0], *(each.values for each in some)]), np.vstack([empty, *(each.slopes for each in some)]))
            for some in (goals, bounds)
        )
        return (v / goal - 1, s @ self.M / goal), (c - 1, w @ self.M)

    def step(self) -> bool:
        """Performs one iteration of the descent. Returns True if another iteration may follow."""
        minimax, x, M = self.minimax, self.x, self.M
        if self.failures > 8 or self.evaluation.goal <= 1e-300:
            return False
        if len(self.recent) > OVER and self.recent[-1 - OVER] - self.recent[-1] < self.flat * self.recent[-1]:
            return False
        fresh = minimax.model(x, self.evaluation, self.depth)
        goals, bounds = self.linear(fresh + minimax.of_cuts(x, self.kept_cuts))
        _, of_goals, of_bounds, _ = self.lowest(goals, bounds)
        curvature = self.curvature(fresh, of_goals, of_bounds)
        if np.any(curvature):
            self.hessian = convex(M.T @ curvature @ M, self.damping)
        t, of_goals, of_bounds, fall = self.lowest(goals, bounds)
        while of_bounds.sum() > 0.8 * self.penalty and self.penalty < LARGEST and np.max(bounds[0] + bounds[1] @ t) > 1e-9:
            self.penalty *= 4  # the step violates a bound, but a step with a larger penalty would fulfil the bound
            t, of_goals, of_bounds, fall = self.lowest(goals, bounds)
        if fall < self.settled:
            return False
        here = self.merit(self.evaluation)
        if not fall > 1e-10:
            self.depth, self.failures = self.depth / 4, self.failures + 1
            return True
        move, length, beyond, corrected = M @ t, 1.0, Cuts(), False
        while length > 1e-3:
            allowed = here * (1 - 1e-2 * length * fall)
            there = self.at(x + length * move, allowed)
            if self.merit(there) <= allowed:
                break
            if np.isfinite(self.merit(there)):  # the model does not contain the functions that are largest at this point
                beyond += minimax.cut(x + length * move, there)
                if not corrected:
                    # The edges of the function are curved. The model therefore uses the linearised functions at the end of the
                    # step (second-order correction).
                    corrected = True
                    better = self.corrected(x + move, t)
                    there = self.at(x + better, allowed)
                    if self.merit(there) <= allowed:
                        move = better
                        break
            length *= 0.3
        else:
            self.damping, self.failures, self.hessian = 10 * self.damping, self.failures + 1, 10 * self.hessian
            self.kept_cuts += beyond
            return True
        # longer steps are tried, because the minimum may be far away or at infinity
        while length >= 1 and np.all(np.abs(x + 3 * length * move) <= minimax.limit):
            needed = self.merit(there) - 0.1 * length * fall * here
            further = self.at(x + 3 * length * move, needed)
            if self.merit(further) > needed:
                break
            length, there = 3 * length, further
        self.failures, self.kept_cuts = (0 if length > 0.05 else self.failures), beyond
        self.damping = max(self.damping / 4, 1e-8) if length >= 1 else self.damping * 2
        self.x = np.clip(x + length * move, -minimax.limit, minimax.limit)
        self.evaluation = minimax.evaluate(self.x)
        self.recent.append(self.merit(self.evaluation))
        return True

    def at(self, x: Array, allowed: float) -> Evaluation:
        """Evaluates a point; the evaluation stops as soon as it is certain that the point cannot be accepted."""
        return self.minimax.evaluate(x, allowed, self.penalty)

    def corrected(self, end: Array, t: Array) -> Array:
        """Returns a corrected step t, shape (N,). The corrected step is computed with the function values at the end of the
        uncorrected step.
        """
        goal, depth = self.evaluation.goal, self.depth
        count = len(self.minimax.goals)
        model = [(i, term.support(end, goal if i < count else 1.0, depth)) for i, term in enumerate(self.minimax.terms)]
        (v, s), (c, w) = self.linear(model)
        if not len(v) or not np.isfinite(v).all() or not np.isfinite(c).all():
            return self.M @ t
        return self.M @ self.lowest((v - s @ t, s), (c - w @ t, w))[0]

    def curvature(self, fresh: Model, of_goals: Array, of_bounds: Array) -> Array:
        """Returns the curvature of those functions that are active at the current point.

        Functions whose cuts come from earlier points do not contribute.
        """
        total, terms, count = np.zeros((len(self.x), len(self.x))), self.minimax.terms, len(self.minimax.goals)
        share = of_goals[: sum(len(each.values) for i, each in fresh if i < count)].sum()
        start = [0, 0]
        for i, support in fresh if share >= LITTLE else ():
            bound, length = i >= count, len(support.values)
            own = (of_bounds if bound else of_goals)[start[bound] : start[bound] + length]
            start[bound] += length
            if length and own.max() > LITTLE:
                total += terms[i].curvature(self.x, support, own) / (share if bound else share * self.evaluation.goal)
        return total


def solve_subproblem(values: Array, slopes: Array, hessian: Array, M: Array, x: Array, limit: Array) -> tuple[Array, Array]:
    """Solves the quadratic subproblem for one step of the descent.

    The step t minimises max_i (values_i + slopes_i t) + t' hessian t / 2, subject to |x + M t| <= limit.

    The subproblem is solved as a least-distance problem, by non-negative least squares (Lawson, Hanson 1974, chapter 23). Let h
    be the maximum of the linear functions, and y the step in coordinates with unit Hessian. Up to a negligible term, minimising
    h + |y|^2 / 2 then means minimising the distance from a point far down the h axis. The first solution includes only the
    limits on entries that are already close to their limits. Limits that the first solution violates are then added.

    Returns:
        The step t, and the weights of the linear functions.

    Raises:
        LinAlgError: there is no cut, or rounding prevents a solution.
    """
    if not len(values) or not all(np.isfinite(each).all() for each in (values, slopes, hessian, M, x)):
        raise np.linalg.LinAlgError("no cut is left")
    root = np.linalg.cholesky(hessian).T
    inverse = lapack.dtrtrs(root, np.eye(len(root)))[0]
    far = 10.0
    rows = np.hstack([-slopes @ inverse / far, np.ones((len(values), 1))])
    bounds = (values - values.max()) / far + far
    moves = np.vstack([M, -M]) @ inverse  # the distances to the upper limits are followed by the distances to the lower limits
    room = np.concatenate([limit - x, limit + x])
    at_limit = room < NEAR * np.tile(limit, 2)
    while True:
        inward = np.hstack([-moves[at_limit], np.zeros((int(at_limit.sum()), 1))])
        all_rows, all_bounds = np.vstack([rows, inward]), np.append(bounds, -room[at_limit])
        sizes = np.linalg.norm(all_rows, axis=1)
        matrix = np.vstack([all_rows.T / sizes, all_bounds / sizes])
        target = np.append(np.zeros(len(root) + 1), 1.0)
        weights = _non_negative(matrix, target)
        residual = matrix @ weights - target
        y = -residual[:-2] / residual[-1]
        broken = ~at_limit & (moves @ y > room + 1e-9 * np.tile(limit, 2))
        if not broken.any():
            return inverse @ y, (weights / sizes)[: len(values)]
        at_limit |= broken


def _non_negative(matrix: Array, target: Array) -> Array:
    """Solves a non-negative least-squares problem with a matrix of shape (N, k). Returns the solution, shape (k,)."""
    try:
        return optimize.nnls(matrix, target, maxiter=30 * matrix.shape[1])[0]
    except (ValueError, RuntimeError) as error:  # the input is not finite, or the iteration does not converge
        raise np.linalg.LinAlgError(str(error)) from error


def convex(curvature: Array, damping: float) -> Array:
    """Returns a positive definite matrix: the curvature with the absolute values of its eigenvalues, plus `damping`."""
    values, vectors = np.linalg.eigh(curvature)
    return (vectors * (np.clip(np.abs(values), 1e-8, 1e8) + damping)) @ vectors.T
