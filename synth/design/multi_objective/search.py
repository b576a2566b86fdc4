"""Search for the gain that minimises the goal and fulfils all bounds, from many starting points.

- Starting points that make all loops stable are ranked. From a few of the best points, the search descends for some rounds.
  From the best result, the search descends until it converges.
- If the gain has no limit, it grows in stages, as in `synth.design.descent.growth`, as long as the decrease of the goal
  justifies the growth.
- If the box of gain errors has few vertices, all vertices are taken into account ("active"). Otherwise, only the worst errors
  found so far are active. Only the certificate proves that no error in the box is worse than the active errors.
- At every starting point and at the end of every descent, the search looks for errors that make a loop unstable. If no decay
  rate is required, the slowest pole must keep a tenth of the decay rate that the best starting point has with gain errors.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from models.common.arrays import Array
from models.common.printed import percent
from synth.design.descent.growth import lower_by_growth, price
from synth.design.descent.landscape import directions
from synth.design.descent.minimax import BOUND_TOLERANCE, FLAT, Evaluation, MinimaxProblem, descend
from synth.design.descent.starts import lower_poles, survey
from synth.design.descent.terms import NormTerm
from synth.design.multi_objective.objectives import EnergyPeak
from synth.design.multi_objective.peak import RoadPeak, peak_over_road
from synth.design.multi_objective.problem import GainErrors, MultiObjectiveProblem, decay, objectives_of
from synth.design.multi_objective.worst_case import WorstCaseErrors
from synth.design.problem import Progress
from synth.plant.numerics import DesignError

LARGEST_GAIN = 1e5  # limit on the entries of a point while bounds are violated, if the problem does not limit the gain
# limit on the entries of a point while a goal is lowered; if the starting point has a larger entry, this entry is the limit
DEAREST = 32.0
MOST_VERTICES = 4  # if a box of gain errors has at most this many vertices, all vertices are active from the beginning
ENTERED_STARTS = 5  # number of starting points from which the search makes a short descent
GLANCE, ROUNDS = 15, 80  # number of rounds in a short descent and in a full descent
TURNS = 12  # largest number of descents; before each descent, more gain errors become active
TURNS_ON = 6  # number of short descents that `improvement` makes
MET_TOLERANCE = 1e-6  # gain errors that worsen a value by less than this relative amount are ignored
# A descent ends if the relative decrease is smaller than this. The first value is used while new gain errors still worsen the
# result, the second value for the final result
ROUGHLY, CLOSELY = 1e-3, 1e-6
SLOWER = 0.1  # if no decay rate is required, the result must keep this share of the best start's decay rate
UNSTABLE = (
    "no static gain was found that stabilises every loop of the goals; give a smaller tolerance, fewer vehicles, or more "
    "signals and entries of the gain"
)
RANK = 30.0  # weight of a violated bound when the starting points are ranked


class MinimaxSearch:
    """Search for the best gain of one problem."""

    def __init__(self, problem: MultiObjectiveProblem, on_progress: Progress) -> None:
        self.problem, self.full = problem, problem.nominal()
        self.on_progress = on_progress
        self.incumbent: tuple[Array, Evaluation] | None = None
        # last point at which all loops are stable with every gain error that has been found
        self.safe_point: Array | None = None
        self.worst = WorstCaseErrors(problem)
        self.stable_starts: list[Array] = []
        self.rate = problem.decay or 0.0  # required decay rate of the loops [rad/s]
        self.free = np.flatnonzero(problem.structure.ravel())
        self.active_errors = problem.corners(MOST_VERTICES)
        self.minimax = self.minimax_problem([problem.no_errors, *self.active_errors])
        self.settled = ROUGHLY if problem.has_errors else CLOSELY

    def result(self, starts: Iterable[Array], otherwise: Callable[[], Iterable[Array]]) -> tuple[Array, Evaluation, float | None]:
        """Runs the search. Returns the final point, its evaluation, and `rejected_improvement` of `MultiObjectiveDesign`."""
        x, evaluation = self.best(starts, otherwise)
        refused, rough = None, self.settled == ROUGHLY
        for turn in range(TURNS):
            if turn == TURNS // 2:
                self.settled = CLOSELY
            if not evaluation.within:
                x, evaluation = self.restore_feasibility(x)
            if rough and self.settled == CLOSELY and self.problem.gain is None:
                # The rough descents have shown how large a gain is worthwhile.
                self.minimax.limit = np.full(len(x), float(np.abs(x).max()) or 1.0)
                x, evaluation = self.converge(x, evaluation)
            else:
                x, evaluation, refused = self.staged_descent(x, evaluation)
            x, evaluation = self.best_of(x, evaluation)
            if not self.add_violating_errors(x, evaluation) and not self.tighten_peak_bounds(x):
                if self.settled == CLOSELY:
                    break
                self.settled = CLOSELY  # no further gain error worsens the result, so the result is now computed accurately
                continue
            self.incumbent = None  # the stored point was evaluated with fewer gain errors
            x, evaluation = self.nearest_stable_point(x)
        if not evaluation.within:
            x, evaluation = self.restore_feasibility(x)
        if not evaluation.within:
            raise DesignError(self.explain_infeasibility(x))
        if self.worst.unstable(self.full.gain(x)):  # even after the last descent, some gain errors make a loop unstable
            raise DesignError(UNSTABLE)
        return x, evaluation, refused

    def improvement(self, gain: Array, errors: Sequence[GainErrors]) -> tuple[Array, Evaluation] | None:
        """Lowers the goal by descent from a gain, for a fixed number of rounds. Returns the best point that fulfils all bounds;
        None if there is no such point.

        The number of rounds, `TURNS_ON` times `GLANCE`, is fixed. The search has no time limit, so the result is the same on
        every computer.

        Args:
            gain: gain with stable loops, shape (m, q).
            errors: gain errors that are taken into account from the beginning, in addition to the case without errors.
        """
        self.settled = ROUGHLY
        self.activate(self.new_errors(errors))
        (x,) = self.points([gain])
        if not self.rate:
            self.keep_decay(x)
        self.safe_point, best = x, None
        for _ in range(TURNS_ON):
            moved, evaluation = self.brief_descent(x)
            moved, evaluation = self.best_of(moved, evaluation)
            if self.add_violating_errors(moved, evaluation) or self.tighten_peak_bounds(moved):
                self.incumbent, evaluation = None, self.minimax.evaluate(moved)
            x = moved if np.isfinite(evaluation.goal) else x
            if evaluation.within and np.isfinite(evaluation.goal) and (best is None or evaluation.goal < best[1].goal):
                best = moved, evaluation
        return best

    def keep_decay(self, x: Array) -> None:
        """Requires that the decay rate stays above a fraction of the decay rate that the loops at a given point have with gain
        errors.
        """
        self.rate = -SLOWER * max(self.worst.slowest(i, self.full.gain(x))[0] for i in range(len(self.problem.members)))
        self.minimax.bounds += [decay(self.problem, term.landscape, self.rate) for term in self.norms()]
        self.incumbent = None  # the stored point may decay more slowly than the new rate

    def evaluate(self, x: Array) -> Evaluation:
        """Evaluates a point, and stores it if it is the best point so far that fulfils all bounds."""
        evaluation = self.minimax.evaluate(x)
        self.update_incumbent(x, evaluation)
        return evaluation

    def best_of(self, x: Array, evaluation: Evaluation) -> tuple[Array, Evaluation]:
        """Returns the stored point if it is better than the given point; otherwise, returns the given point."""
        if self.incumbent is not None and (not evaluation.within or self.cost(*self.incumbent) < self.cost(x, evaluation)):
            return self.incumbent
        return x, evaluation

    def update_incumbent(self, x: Array, evaluation: Evaluation) -> None:
        """Stores a point if it is the best point so far that fulfils all bounds."""
        if (
            evaluation.within
            and np.isfinite(evaluation.goal)
            and (self.incumbent is None or self.cost(x, evaluation) < self.cost(*self.incumbent))
        ):
            self.incumbent = x, evaluation

    def norms(self) -> list[NormTerm]:
        """Returns the norms that are minimised, one for each loop."""
        return [term for term in self.minimax.goals if isinstance(term, NormTerm)]

    def moved(self, x: Array, evaluation: Evaluation) -> None:
        """Stores and reports a new point of a descent."""
        self.update_incumbent(x, evaluation)
        self.on_progress(evaluation.goal, evaluation.within)

    def limit(self, gain: float | None) -> Array:
        """Returns the largest allowed absolute value of each entry of a point."""
        if gain is None:
            return np.full(self.full.scale.size, LARGEST_GAIN)
        return self.full.point(np.full(self.full.shape, gain))

    def minimax_problem(self, errors: Sequence[GainErrors]) -> MinimaxProblem:
        """Returns the minimax problem that contains the goals and bounds for given gain errors."""
        return MinimaxProblem(*objectives_of(self.problem, self.full, errors, self.rate), self.limit(self.problem.gain))

    def coordinates(self, x: Array) -> Array:
        """Returns the directions in which the structure allows the gain to change, as columns, scaled so that all directions
        have equal weight.
        """
        return directions(self.full, x, self.free)

    def best(self, starts: Iterable[Array], otherwise: Callable[[], Iterable[Array]]) -> tuple[Array, Evaluation]:
        """Returns the best result after some rounds of descent from the starting points."""
        points = self.points(starts)
        points += [0.5 * x for x in points] + [np.zeros(self.full.scale.size)]
        given = {x.tobytes() for x in points}
        points += [np.where(self.problem.structure.ravel(), x, 0.0) for x in survey(self.full, self.minimax.limit)]
        ranked = self.stable_with_errors(points, otherwise)
        self.stable_starts = ranked
        if not self.rate:
            # random gains may rank best only because their loops are slow
            self.keep_decay(next((x for x in ranked if x.tobytes() in given), ranked[0]))
        self.safe_point = ranked[0]
        return min((self.brief_descent(x) for x in ranked[:ENTERED_STARTS]), key=lambda each: self.cost(*each))

    def stable_with_errors(self, points: Sequence[Array], otherwise: Callable[[], Iterable[Array]]) -> list[Array]:
        """Returns the starting points whose loops are stable with all errors found so far, in ascending order of cost."""
        for _ in range(TURNS):
            ranked = self.ranked(points) or self.ranked([self.stabilised(x) for x in points])
            if not ranked:
                points = self.points(otherwise())
                ranked = self.ranked(points)
            if not ranked:
                break
            unstable = [self.worst.unstable(self.full.gain(x)) for x in ranked[: 2 * ENTERED_STARTS]]
            if kept := [x for x, errors in zip(ranked, unstable, strict=False) if not errors]:
                return kept + ranked[2 * ENTERED_STARTS :]
            fresh = self.new_errors(unstable[0])
            if not fresh:
                break
            self.activate(fresh)
            points = ranked
        raise DesignError(UNSTABLE)

    def points(self, gains: Iterable[Array]) -> list[Array]:
        """Returns the points of gains to which the structure and the limit on the entries are applied."""
        limit, mask = self.minimax.limit, self.problem.structure
        return [np.clip(self.full.point(np.where(mask, K, 0.0)), -limit, limit) for K in gains]

    def brief_descent(self, x: Array) -> tuple[Array, Evaluation]:
        """Lowers the objective for a few rounds, starting at x. If the gain has no limit, the largest entry of the gain may at
        most double.
        """
        whole = self.minimax.limit
        if self.problem.gain is None:
            self.minimax.limit = np.minimum(whole, 2 * float(np.abs(x).max()) or 1.0)
        try:
            return self.down(x, GLANCE)
        finally:
            self.minimax.limit = whole

    def cost(self, x: Array, evaluation: Evaluation) -> float:
        """Returns the cost by which points are ranked; if the gain has no limit, the cost includes a penalty for the size of
        the gain.
        """
        worth = price(max(float(np.abs(x).max()), 1e-3)) if self.problem.gain is None else 0.0
        return float(np.log(max(self.rank(evaluation), 1e-300)) + worth)

    def restore_feasibility(self, x: Array) -> tuple[Array, Evaluation]:
        """Returns a point that fulfils all bounds, or the point with the smallest violation that the search finds."""
        minimax = self.minimax
        minimax.limit = self.limit(self.problem.gain)
        bounds = MinimaxProblem(minimax.bounds, [], minimax.limit)
        others = sorted(self.stable_starts, key=lambda start: bounds.evaluate(start).goal)
        best, least = x, bounds.evaluate(x)
        for start in (x, *others[:ENTERED_STARTS]):
            for _ in range(3):
                start, near = descend(bounds, start, self.coordinates(start), ROUNDS, enough=1.0)
                if near.goal < least.goal:
                    best, least = start, near
                if near.goal <= 1:
                    return best, minimax.evaluate(best)
        return best, minimax.evaluate(best)

    def nearest_stable_point(self, x: Array) -> tuple[Array, Evaluation]:
        """Returns a point at which all loops are stable with all active errors: the given point, if possible."""
        sure = [] if self.safe_point is None else [self.safe_point]
        for move, starts in ((lambda x: x, [x]), (self.stabilised, [x]), (lambda x: x, [*sure, *self.stable_starts])):
            for start in starts:
                moved = move(start)
                evaluation = self.minimax.evaluate(moved)
                if np.isfinite(evaluation.goal):
                    return moved, evaluation
        raise DesignError(UNSTABLE)

    def rank(self, evaluation: Evaluation) -> float:
        """Returns the rank of a starting point; a smaller rank is better."""
        return evaluation.goal * (1 + RANK * max(evaluation.excess, 0.0))

    def ranked(self, points: Sequence[Array]) -> list[Array]:
        """Returns the stabilising points in ascending order of cost, without duplicates."""
        heights = [(self.cost(x, self.evaluate(x)), i) for i, x in enumerate(points)]
        stable = sorted((cost, i) for cost, i in heights if np.isfinite(cost))
        kept: list[tuple[float, Array]] = []
        for cost, i in stable:
            if all(abs(cost - other) > 1e-9 for other, _ in kept):
                kept.append((cost, points[i]))
        return [x for _, x in kept]

    def stabilised(self, x: Array) -> Array:
        """Lowers the largest real part of the poles of all loops, starting from a point. Returns the new point."""
        moved = lower_poles([term.landscape for term in self.norms()], x, self.free)
        return np.clip(moved, -self.minimax.limit, self.minimax.limit)

    def down(self, x: Array, rounds: int) -> tuple[Array, Evaluation]:
        """Performs a descent, and returns the final point with its evaluation."""
        return descend(self.minimax, x, self.coordinates(x), rounds, self.moved, flat=FLAT * self.settled / CLOSELY)

    def staged_descent(self, x: Array, evaluation: Evaluation) -> tuple[Array, Evaluation, float | None]:
        """Performs descents until convergence: in one stage if the gain has a limit, otherwise in stages with a growing gain."""
        if self.problem.gain is not None:
            return *self.converge(x, evaluation), None
        size = float(np.abs(x).max()) or 1.0
        dearest = max(size, DEAREST)

        def lower(x: Array, evaluation: Evaluation, largest: float) -> tuple[Array, Evaluation]:
            self.minimax.limit = np.full(len(x), min(largest, dearest))
            return self.converge(x, evaluation)

        def bought(evaluation: Evaluation, there: Evaluation) -> float:
            before = self.rank(evaluation)
            return np.inf if there.within != evaluation.within else 1 - self.rank(there) / before if before > 0 else 0.0

        x, evaluation, refused = lower_by_growth(x, evaluation, lower, bought, size)
        return x, evaluation, refused and refused[0]

    def converge(self, x: Array, evaluation: Evaluation) -> tuple[Array, Evaluation]:
        """Repeats the descent, each time in new coordinates, until the objective hardly decreases."""
        for _ in range(4):
            moved, there = self.down(x, ROUNDS)
            if not self.rank(there) < self.rank(evaluation) * (1 - self.settled):
                return (moved, there) if self.rank(there) < self.rank(evaluation) else (x, evaluation)
            x, evaluation = moved, there
        return x, evaluation

    def add_violating_errors(self, x: Array, evaluation: Evaluation) -> bool:
        """Searches for gain errors that increase a goal or violate a bound at a point, and activates them. Returns True if such
        gain errors are found.
        """
        if not self.problem.has_errors:
            return False
        worst = self.worst.beyond(self.full.gain(x), evaluation.goal, self.rate)
        fresh = self.new_errors(errors for beyond, errors in worst if beyond > 1 + MET_TOLERANCE)
        if not self.worst.unstable(self.full.gain(x)):
            self.safe_point = x
        self.activate(fresh)
        return bool(fresh)

    def new_errors(self, errors: Iterable[GainErrors]) -> list[GainErrors]:
        """Returns the given errors that are not yet active, without duplicates."""
        met = {each.key for each in self.active_errors}
        return list({each.key: each for each in errors if each.key not in met}.values())

    def activate(self, errors: Sequence[GainErrors]) -> None:
        """Activates gain errors: adds the goals and the bounds with these errors to the problem."""
        self.active_errors += errors
        goals, bounds = objectives_of(self.problem, self.full, errors, self.rate)
        self.minimax.goals += goals
        self.minimax.bounds += [bound for bound in bounds if not isinstance(bound, (RoadPeak, EnergyPeak))]

    def tighten_peak_bounds(self, x: Array) -> bool:
        """Computes the road peaks accurately, and tightens each bound that is exceeded. Returns True if a bound was exceeded."""
        tighter = False
        for term in self.minimax.bounds:
            if isinstance(term, RoadPeak) and term.value(x) <= 1 + BOUND_TOLERANCE:
                passed = peak_over_road(term.driven, self.full.gain(x)).proved / (term.unit * term.spare)
                if 1 < passed < 2:
                    term.unit, tighter = term.unit / passed, True
                    term.spare *= passed
        return tighter

    def explain_infeasibility(self, x: Array) -> str:
        """Returns a message with the bounds that the search could not fulfil, and their violations."""
        passed = " and ".join(f"{name} by {percent(share)}" for name, share in self.minimax.passed(x).items())
        return f"no gain was found that keeps all bounds; the nearest misses {passed}; relax these bounds, or measure more"
