"""The two steps for the sampled-data loop, followed by descent on its exact norm.

For every level of the loop's L2 gain there is a discrete plant (`synth/analysis/sampled_loop.py`). A step reaches the level for
whose plant its optimum is a norm of 1, found by secants over the logarithms in a few problems. State feedback (22) has one such
level, and the X of its optimum makes L (14). The second step (25) has another. Every optimum is the limit of a central path, and
so is the gain: it is unique, and depends on no solver and no unit. Its norm is then computed exactly, without any of this
(`synth/analysis/sampled_norm.py`).

Delayed forces are states that no measurement contains. An L that makes them follow the state feedback may leave the second step
without a solution; an L that makes them follow an equally good gain may not. Descent on the exact norm then starts from the
results and from the continuous design, and the lowest end is taken. The gain of the two steps stays if descent gains next to
nothing. If they find no gain, or if no control does better, descent starts from whatever is known, with a remark. The two steps
ignore noise of the measurements; descent includes it.

The norm has several valleys if a mode of the plant turns by more than a fraction of a turn in a period, and a good gain for a
fast rate may be unstable at a slow one. So descent starts where the norm is smallest along the line through the known gains, on
either side of no control. If it ends more than 1 % above a lower bound, or finds nothing, the search for static gains
(`static.py`) continues for the plant of one level.
"""

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.printed import digits, percent
from models.laws.linear import LinearLaw, static_law
from synth.analysis.lower_bound import SampledBound
from synth.analysis.sampled_loop import SampledDataProblem
from synth.analysis.sampled_norm import sampled_norm
from synth.analysis.stability import stabilisability_failures, static_feedback_obstructions
from synth.design.descent.landscape import Landscape, Work
from synth.design.descent.refine import Refinement, from_some, lowered, refine
from synth.design.problem import LARGEST_GAIN, SAMPLED_NORM, DesignProblem, DesignResult, Progress
from synth.design.static import GainSearch, bounded_work
from synth.design.two_step import NO_GAIN, NO_SECOND_STEP, independent_rows, no_gain, nullspace, output_feedback, state_path
from synth.lmi.central_path import CentralPoint, fits
from synth.lmi.full_order_bound import bound_beyond_control, find_lower_bound
from synth.plant.generalized import Plant, on_all_rows
from synth.plant.numerics import DesignError, InfeasibleError, NoSolutionError, TooLargeError, numerics
from synth.plant.units import own_units

DESCENTS = 8
WORTH = 1e-4  # relative; a descent that gains less is the last, for what each leaves is the square of that
KEPT = 5e-5  # relative; the gain of the two steps stays where descent gains less
SHARES = 2.0 ** -np.arange(11)  # of a known gain, on either side: the least that counts here is a thousandth
STARTS = 3  # the best of them
WORTH_ANOTHER = 1e-3  # relative; a gain of another valley is taken where it gains more
LITTLE = 1e-2  # relative; a norm this close to a lower bound is left at that
BOUNDED = 20  # states; of more a lower bound takes minutes, and a search, too
FURTHEST = 5  # powers of FAR times a guess of the norm: levels that are tried
MOST_STATES = 100  # of a level's plant: a descent takes ten seconds


def norm_of(problem: SampledDataProblem, K: Array, near: float) -> float:
    """The exact norm of a gain, shape (m, q); infinite where its loop is not stable."""
    return sampled_norm(problem.loop(K), near).value


def descended(problem: SampledDataProblem, known: Sequence[Array], near: float, work: Work) -> tuple[Array, float]:
    """The best gain that descent finds, and its norm, infinite where no start is stable.

    Args:
        known: gains to start from, shapes (m, q); the line through the first is searched.
        near: a guess of the norm.
        work: counts the norms.
    """
    nothing = np.zeros((problem.plant.B.shape[1], len(problem.plant.Cy)))
    line = [sign * share * K for K in known[:1] for sign, shares in ((-1, SHARES), (1, SHARES[::-1])) for share in shares]
    line.insert(len(line) // 2, nothing)
    norms = [norm_of(problem, K, near) for K in line]
    padded = [np.inf, *norms, np.inf]
    starts = [(norms[i], K) for i, K in enumerate(line) if norms[i] <= min(padded[i], padded[i + 2])]
    starts += [(norm_of(problem, K, near), K) for K in known[1:]]
    best = sorted(starts, key=lambda start: start[0])[:STARTS]
    return min(
        (down(problem, K, norm, work) for norm, K in best if np.isfinite(norm)), key=lambda end: end[1], default=(nothing, np.inf)
    )


def searched(problem: SampledDataProblem, level: float, known: Array | None, work: Work) -> tuple[Array, float]:
    """The best gain that the search of static gains finds for the plant of one level, and descents from there; its norm.

    Args:
        level: level near the norm, or far above it: then the plant's norm is nearly proportional to that of the loop.
        known: a stabilising gain, which the search starts from, too.
        work: counts the norms.
    """
    plant = problem.at(level)
    assert plant is not None
    search = GainSearch(plant, LARGEST_GAIN, 0.0, work=work)
    candidates = search.starts()
    if known is not None:
        candidates += search.admitted(search.landscape.point(known), "a known gain")
    if not candidates:
        return np.zeros(search.landscape.shape), np.inf
    K = search.landscape.gain(search.best(candidates).x)
    norm = norm_of(problem, K, level)
    return down(problem, K, norm, work) if np.isfinite(norm) else (K, norm)


def down(problem: SampledDataProblem, K: Array, norm: float, work: Work | None = None) -> tuple[Array, float]:
    """Descends from a stable K on the plants of falling levels, as `refine` does, until the work is over."""
    for _ in range(DESCENTS):
        plant = problem.at(norm)
        if plant is None:
            break
        moved = lowered(Landscape(plant, work=work), plant, K).gain
        reached = norm_of(problem, moved, norm)
        if not reached < norm:
            break
        enough = reached > norm * (1 - WORTH)
        K, norm = moved, reached
        if enough:
            break
    return K, norm


def refined_further(problem: SampledDataProblem, K: Array, near: float) -> Refinement:
    """Lowers the exact norm from a stabilising gain on all measurements, shape (m, q), as far as it is worth a larger gain.

    Raises:
        DesignError: the loop of K is not stable, or a force answers at no level near its norm.
    """
    before = norm_of(problem, K, near)
    plant = problem.at(before) if np.isfinite(before) else None
    if plant is None:
        raise DesignError("a gain whose sampled loop is unstable, or has its norm within one period, cannot be refined")
    rows = independent_rows(plant)
    few = problem.of(rows)
    start = from_some(K, np.hstack([problem.plant.Cy, problem.plant.Dyu]), rows)
    moved, after = down(few, start, before)
    last = problem.at(after)
    refused = refine(last, None, moved).refused if last is not None else None
    landscape = Landscape(plant.rows(rows))
    sizes = [float(np.abs(landscape.point(each)).max()) for each in (start, moved)]
    gain = np.zeros_like(K)
    gain[:, rows] = moved
    growth = sizes[1] / sizes[0] if sizes[0] else 1.0
    return Refinement(gain, before, after, growth, refused, "the sampled norm")


def check_size(problem: SampledDataProblem) -> None:
    """Raises a TooLargeError for a loop whose forces on their way are too many states."""
    (n, m), late = problem.plant.B.shape, problem.remembered
    if n + m * late > MOST_STATES:
        raise TooLargeError(
            f"a delay of {late} samples gives the loop {n + m * late} states, and sampled designs allow at most {MOST_STATES}; "
            "omit sampled = true (a continuous design runs with any delay), or give a longer sample period or a shorter delay"
        )


DESCENT_SAMPLED, NO_BOUND = "descent on the sampled norm", "no lower bound is proved"
CLOSE = 1e-9  # relative: so near to 1 a norm is it
GROW = 1.05  # of a level, where there is no solution; the square of it the next time
FAR = 1e3  # times where the search for a level starts
ROUNDS = 60  # five or so do
MOST = 260  # unknowns of (22) for a level, 21 states with one input: a dozen or two of such problems take half a minute
ROUNDING = 1e-7  # relative; how far a norm may lie above a level that is reached at a limit of central paths


@dataclass(frozen=True, eq=False)
class SampledDesign:
    """A gain or a discrete law for the loop that a computer closes.

    Attributes:
        law: law from the measurements to the forces; a static one, or one in discrete time.
        norm: the L2 gain of its loop, exact.
        level: level of the LMI of a gain of the two steps; None for others.
        kept: measurements that a gain uses, by index; the others follow from these.
        instead: reason why the two steps did not lead to this gain, in words; empty if they did.
        remark: distance from the bound, in words; empty if it is small.
    """

    law: LinearLaw
    norm: float
    level: float | None = None
    kept: tuple[int, ...] = ()
    instead: str = ""
    remark: str = ""

    @property
    def gain(self) -> Array:
        """K of a static law, shape (m, q)."""
        return self.law.D

    def result(self, problem: DesignProblem, **more: Any) -> DesignResult:
        """Returns the design with the certificate of its ideal loop.

        Raises:
            DesignError: the law has no counterpart in continuous time.
        """
        try:
            certificate = problem.certified(self.law)
        except (ValueError, np.linalg.LinAlgError) as error:
            raise DesignError(f"the law designed for the sampled loop cannot be converted to continuous time: {error}") from error
        return DesignResult(self.law, certificate, value=self.norm, criterion=SAMPLED_NORM, **more)


def bound_of(problem: DesignProblem, near: float) -> SampledBound | None:
    """Returns the lower bound of the sampled loop of a problem; None if none is proved."""
    if not problem.thorough:
        return problem.sampled_bound
    from synth.lmi.sampled_bound import find_sampled_bound

    assert problem.sampled is not None, "a sampled loop"
    return find_sampled_bound(problem.sampled, near)


def sampled(problem: DesignProblem, progress: Progress) -> DesignResult:
    """Designs a static gain for the loop that a computer closes."""
    assert problem.sampled is not None, "a sampled loop"
    found, remarks, level = held_design(problem.sampled, problem.near, problem.ideal, problem.work), (), None
    if problem.thorough:
        bound = bound_of(problem, problem.near)
        level = None if bound is None else bound.level
        remarks = (f"norm {percent(found.norm / level - 1)} above the lower bound of the sampled loop" if level else NO_BOUND,)
    if found.instead:
        method, why = DESCENT_SAMPLED, f"the two-step method was not used: {found.instead}"
    else:
        method, why = "the two steps for the sampled loop", "the two-step method finds a gain of this sampled norm"
    return replace(
        found.result(problem, method=method, why=why, remarks=remarks, sampled_lower_bound=level),
        level=found.level,
        instead=found.instead,
        redundant=tuple(i for i in range(len(problem.sampled.plant.Cy)) if i not in found.kept),
    )


@numerics()
def held_design(problem: SampledDataProblem, near: float, known: Sequence[Array] = (), work: Work | None = None) -> SampledDesign:
    """Runs the two steps, or the first alone if all states are measured.

    Args:
        near: level to start from, for example the norm of the continuous design.
        known: gains from the same measurements, shapes (m, q), for example the continuous design's; the result is not worse.
        work: counts the norms of the search; `bounded_work` if it is not given.

    Raises:
        InfeasibleError: no static gain from what is measured stabilises the loop; the message names the mode.
        TooLargeError: too many forces are delayed at the same time.
        DesignError: no gain was found; the message lists what was tried.
    """
    check_size(problem)
    far, slow = near, None
    for _ in range(FURTHEST):
        far *= FAR
        if (slow := problem.at(far)) is not None:
            break
    if slow is None:
        within = f"within {1000.0 * problem.period:g} ms without a new force the gain from w is above {far:g}"
        raise DesignError(f"{NO_GAIN}; give a shorter sample period: {within}")
    rows = independent_rows(slow)
    few = problem.of(rows)
    of_kept = [from_some(K, np.hstack([problem.plant.Cy, problem.plant.Dyu]), rows) for K in known]
    try:
        K, norm, level, instead = _gain(few, near, of_kept, far, bounded_work(problem.plant) if work is None else work)
    except DesignError as error:
        slow = slow.rows(rows)
        if reasons := "; ".join(stabilisability_failures(slow) or static_feedback_obstructions(slow)):
            raise InfeasibleError(reasons) from error
        raise
    gain = on_all_rows(K, rows, len(problem.plant.Cy))
    return SampledDesign(static_law(gain), norm, level, tuple(rows), instead)


def _gain(
    problem: SampledDataProblem, near: float, known: Sequence[Array], far: float, work: Work
) -> tuple[Array, float, float | None, str]:
    """K from independent measurements, its norm, its level, and why it is not by the two steps where it is not.

    Args:
        far: a level far above the norm, which has a plant.
        work: counts the norms of the search.
    """
    undelayed = failure = K = level = None
    norm, quiet = np.inf, replace(problem, rms=None)
    if problem.remembered:
        with contextlib.suppress(DesignError):
            undelayed, _ = two_steps(quiet.at_once, near, None)
    try:
        K, level = two_steps(quiet, near, undelayed)
        norm = norm_of(problem, K, near)
    except DesignError as error:
        failure = error
    nothing = np.zeros((problem.plant.B.shape[1], len(problem.plant.Cy)))
    others = {"the continuous design": known, "no control": [nothing]}
    least, which = min((norm_of(problem, other, near), name) for name, some in others.items() for other in some)
    if K is not None and np.isfinite(norm):
        moved, reached = K, norm
        for start in (K, *known):
            height = norm_of(problem, start, near)
            if np.isfinite(height) and not _at_the_limit(problem, reached):
                moved, reached = min((moved, reached), down(problem, start, height, work), key=lambda end: end[1])
        if least < reached:
            moved, reached = min((moved, reached), descended(problem, [*known, K], near, work), key=lambda end: end[1])
        if _may_fall(problem, reached):
            moved, reached = _lower(problem, moved, reached, far, work)
        quietly = not problem.noise.size
        if quietly and norm <= min(least * (1 + ROUNDING), reached * (1 + KEPT)):
            return K, norm, level, ""
        further = f"{which} reaches {digits(least)}" if least < norm else f"descent from there reaches {digits(reached)}"
        why = f"the two-step method reaches {digits(norm)}, and {further}" if quietly else "the two-step method ignores noise"
    else:
        if K is not None:
            failure = DesignError("rounding leaves no stable loop with the gain that was found")
        moved, reached = descended(problem, [start for start in (*known, undelayed, K) if start is not None], near, work)
        if _may_fall(problem, reached):
            moved, reached = _lower(problem, moved, reached, far, work)
        if not np.isfinite(reached):
            tried = f"descent on the sampled norm, but no start was stable; the two-step method: {failure}"
            raise DesignError(no_gain(tried, "give a shorter sample period or delay, ")) from failure
        why = NO_SECOND_STEP if isinstance(failure, NoSolutionError) else str(failure)
    why += f"; {work.text}" if work.over else ""
    # The norm of a gain depends, in its ninth digit, on the guess that it is found from: it is to be that of `near`.
    return moved, norm_of(problem, moved, near), None, why


def _at_the_limit(problem: SampledDataProblem, norm: float) -> bool:
    """Returns True if a norm is next to what no control force changes."""
    plant = problem.at(norm * (1 - KEPT))
    return plant is None or bound_beyond_control(plant).gamma >= 1


def _lower(problem: SampledDataProblem, K: Array, norm: float, far: float, work: Work) -> tuple[Array, float]:
    """A gain and its norm, or those of a search where they are lower by so much that another valley is worth it.

    Args:
        norm: infinite for a gain that does not stabilise the loop.
        far: a level far above the norm, which has a plant.
    """
    stable = bool(np.isfinite(norm))
    level = norm if stable and problem.at(norm) is not None else far
    end = searched(problem, level, K if stable else None, work)
    return end if end[1] < norm * (1 - WORTH_ANOTHER) else (K, norm)


def _may_fall(problem: SampledDataProblem, norm: float) -> bool:
    """Returns True if no lower bound is known that a norm is within 1 % of, and the loop is of few states."""
    if len(problem.rows[0]) > BOUNDED:
        return False
    plant = problem.at(norm * (1 - LITTLE)) if np.isfinite(norm) else None
    if plant is None:
        return bool(np.isinf(norm))
    with contextlib.suppress(InputError, np.linalg.LinAlgError):
        return find_lower_bound(plant).gamma < 1
    return True


def two_steps(problem: SampledDataProblem, near: float, undelayed: Array | None) -> tuple[Array, float]:
    """Returns K by the two steps, which know no noise, and its level.

    Args:
        problem: problem without noise, with independent measurements.
        near: a level to start from.
        undelayed: a gain without delay, shape (m, q): L (14) is also chosen so that delayed forces follow it.

    Raises:
        DesignError: a step has no solution, or a path could not be followed.
    """
    rows, (n, m) = problem.rows, problem.plant.B.shape
    size = n + m * problem.remembered
    fits(size * (size + 1) // 2 + m * size + 1, MOST, "the two-step method for sampled loops")
    level, path = _level(problem, state_path, near)
    if len(rows) == size:
        return np.linalg.solve(rows.T, path[-1].K.T).T, level
    tries = _Tries(problem, level)
    tries.add(_follows(path[-1].X, rows))
    if undelayed is not None:
        _, of_state = _level(problem.at_once, state_path, level)
        both = np.vstack([_follows(of_state[-1].X, problem.plant.Cy), *[undelayed] * problem.remembered])
        tries.add(both @ np.linalg.inv(rows @ both))
    for start in reversed(path[:-1]):
        if not tries.found:
            tries.add(_follows(start.X, rows))
    for reached, point in sorted(tries.found, key=lambda pair: pair[0]):
        if norm_of(problem, point.K, near) <= reached * (1 + ROUNDING):
            return point.K, reached
        tries.failures.insert(0, DesignError(f"rounding leaves no loop that keeps the level {digits(reached)}"))
    raise tries.failures[0]


class _Tries:
    """Second steps with one R after another: what they reach, and why those that reach nothing do not."""

    def __init__(self, problem: SampledDataProblem, level: float) -> None:
        self.problem, self.level = problem, level
        self.found = list[tuple[float, CentralPoint]]()
        self.failures = list[DesignError]()

    def add(self, R: Array) -> None:
        """Adds the level that the second step reaches with an R, or the failure."""
        try:
            level, (point,) = _level(self.problem, lambda plant: [_second(plant, R)], self.level)
            self.found.append((level, point))
        except DesignError as error:
            self.failures.append(error)


def _follows(X: Array, rows: Array) -> Array:
    """Returns R (9) with the L (14) of an X, an estimate of the states from the measurements, shape (n, q)."""
    return X @ rows.T @ np.linalg.inv(rows @ X @ rows.T)


def _second(plant: Plant, R: Array) -> CentralPoint:
    """The second step (25) with an R, of which C_y R = I."""
    units = own_units(plant, measured=True)
    basis, measured = units.rows(plant.Cy)
    own = units.into(plant).measured(basis)
    Q = nullspace(basis)
    L = np.linalg.pinv(Q) @ (R @ measured / units.states[:, None])
    return output_feedback(own, L, Q)[-1].in_units(units.states, units.inputs, measured)


def _level(
    problem: SampledDataProblem, path: Callable[[Plant], list[CentralPoint]], start: float
) -> tuple[float, list[CentralPoint]]:
    """The level for whose plant a path ends at a norm of 1, and that path.

    Where it ends below 1 at every level above what happens within one period, that is the level. What has no solution at a level
    far above has none below.
    """
    below, above, level, grow = 0.0, math.inf, start, GROW
    seen = list[tuple[float, float]]()
    best: tuple[float, list[CentralPoint]] | None = None
    for _ in range(ROUNDS):
        plant, failure, followed = problem.at(level), None, list[CentralPoint]()
        if plant is not None:
            try:
                followed = path(plant)
            except DesignError as error:
                failure = error
        if not followed:
            if (
                isinstance(failure, NoSolutionError | InfeasibleError)
                and not below
                and (loosest := problem.at(FAR * start)) is not None
            ):
                try:
                    path(loosest)
                except (NoSolutionError, InfeasibleError):
                    raise
                except DesignError:  # rounding, which says nothing of the levels between
                    pass
            below = max(below, level)
            if level > FAR * start:
                raise failure or DesignError("no level of the L2 gain of the loop was found")
            level, grow = (level * grow, grow**2) if math.isinf(above) else (math.sqrt(level * above), grow)
        else:
            norm = followed[-1].gamma
            if abs(math.log(norm)) <= CLOSE:
                return level * norm, followed
            if norm < 1:
                above, best = level, (level, followed)
            else:
                below = max(below, level)
            seen = [*seen[-2:], (math.log(norm), math.log(level))]
            guesses = (_crossing(seen[-count:]) for count in (3, 2, 1))
            # With one end alone the last guess, of one pair, lies beyond it.
            level = next((guess for guess in guesses if below < guess < above), math.sqrt(below * above))
        if best is not None and above <= below * (1 + CLOSE):
            return best
    raise DesignError(
        f"the norm of the sampled loop did not converge in {ROUNDS} rounds: it is between {below:.7g} and {above:.7g}"
    )


def _crossing(seen: Sequence[tuple[float, float]]) -> float:
    """Returns the level where the norm is 1, by a polynomial of log level over log norm; NaN without a slope.

    For a single pair the norm is assumed to fall as the level rises.
    """
    at, level = (np.array(each) for each in zip(*seen, strict=True))
    if len(seen) == 1:
        return math.exp(at[0] + level[0])
    apart = at[:, None] - at + np.eye(len(at))
    with np.errstate(all="ignore"):
        weights = np.prod(np.where(np.eye(len(at)) > 0, 1.0, -at / apart), axis=1)
        return float(np.exp(weights @ level))
