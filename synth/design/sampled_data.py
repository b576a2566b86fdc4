"""Designs for the sampled-data loop, which apply the methods for ideal loops to a discrete plant.

For every value of the L2 gain of the sampled-data loop, called a level, there is a discrete plant
(`synth/analysis/sampled_loop.py`). The states of the discrete plant include the delayed forces, and its disturbances include
the measurement noise. A law for the discrete plant therefore takes into account the delay, the hold and the motion between
samples. `by_levels` searches for the lowest level. A method designs a law at one level. The exact norm of the sampled-data loop
with the designed law (`synth/analysis/sampled_norm.py`) becomes the next level.

- Full order: Riccati equations. The first level, found by bisection, is the lowest level at which the Riccati equations have a
  solution.
- A given order or structure: descent. The first level is near the lower bound. At each later level, descent starts from the
  law found at the previous level.
- A static gain: the paper's two steps, followed by descent. Each step searches for the level at which the optimal norm of the
  discrete plant is 1, by the secant method in logarithms. The X of the state feedback (22) at the level of the first step gives
  L (14). The second step (25) has its own level. Every optimum is the limit of a central path. The gain is therefore unique,
  and depends neither on a solver nor on units.

The delayed forces are states that no measurement contains. The matrix L determines how the delayed forces are estimated. If L
is based on the optimal state feedback, the second step may have no solution. A solution may still exist if L is based on
another gain that is equally good. Descent on the exact norm then starts from the gains of the two steps and of the continuous
design. The gain with the lowest norm is used. The gain of the two steps is kept if descent hardly lowers its norm. If the two
steps find no gain, or if the plant without control has a lower norm, descent starts from all known gains. A remark in the
result then gives the reason. The two steps ignore measurement noise, but descent takes the noise into account.

The norm has several local minima if the phase of a mode of the plant advances by a considerable part of a turn within a sample
period. A gain that is good for a short period may make the loop unstable for a long period. Descent therefore starts at the
minima of the norm along the line through zero and a known gain, on both sides of zero. If descent ends more than 1 % above a
lower bound, or finds no gain, the search for static gains (`static.py`) follows for the plant of one level.
"""

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.printed import digits, percent
from models.laws.design_methods import FULL
from models.laws.linear import LinearLaw, static_law
from synth.analysis.lower_bounds.lower_bound import LowerBound, SampledBound
from synth.analysis.sampled_loop import SampledDataProblem
from synth.analysis.sampled_norm import sampled_norm
from synth.analysis.stabilisability import stabilisability_failures, static_feedback_obstructions
from synth.design.descent.landscape import Landscape, Work
from synth.design.descent.refine import Refinement, from_some, lower_norm, refine
from synth.design.full_order.full_order import discrete_law
from synth.design.full_order.riccati import RiccatiSearch
from synth.design.methods import design
from synth.design.problem import LARGEST_GAIN, SAMPLED_NORM, DesignProblem, DesignResult, Progress
from synth.design.static import GainSearch, bounded_work
from synth.design.two_step import NO_GAIN, NO_SECOND_STEP, independent_rows, no_gain, nullspace, output_feedback, state_path
from synth.lmi.central_path import CentralPoint, fits
from synth.lmi.full_order_bound import bound_beyond_control, find_lower_bound
from synth.plant.discrete import continuous_image
from synth.plant.generalized import Plant, law_gain, on_all_rows
from synth.plant.numerics import DesignError, InfeasibleError, NoSolutionError, TooLargeError
from synth.plant.units import own_units

DESCENT_SAMPLED, NO_BOUND = "descent on the sampled norm", "no lower bound is proved"
WITHIN = 1e-3  # the search ends if the relative gap between norm and lower bound is smaller than this
# The search ends if a new level lowers the norm by less than this relative amount. The remaining relative distance from the
# limit is then about the square of the last decrease
WORTH = 1e-4
# Largest number of levels: by default, for laws that must themselves be stable (with one descent per level), and in `down`
LEVELS, STABLE_LEVELS, DESCENTS = 4, 2, 8
# First level of a descent, as a multiple of the lower bound. At this level, the plant's norm exceeds one, so the gradient of
# the norm is useful
NEAR = 1.1
# factor from one level to the next if no law is found; the larger factor is used if the law itself must be stable
HIGHER = {False: 1.01, True: 1.1}
# largest number of bisections that find the lowest level with a solution, and relative accuracy of this level
LOWEST, BRACKETED = 40, 1e-4
COSTS = (1e-3, 1e-5)  # relative amounts of measurement noise and control cost that are added to the plants in this bisection
# relative amount by which the first level exceeds a lower bound that follows from the motion within one sample period
ABOVE = 1e-4

WORTHWHILE_GAIN = 5e-5  # if descent lowers the norm by less than this relative amount, the gain of the two steps is kept
# Factors that multiply a known gain, with both signs. A gain below a thousandth of the known gain counts as zero
SHARES = 2.0 ** -np.arange(11)
STARTS = 3  # number of points on the line from which a descent starts: the points with the lowest norms
WORTH_ANOTHER = 1e-3  # the gain of another local minimum is used if it lowers the norm by more than this relative amount
LITTLE = 1e-2  # a norm is not lowered further if its relative gap to a lower bound is smaller than this
# largest number of states for which a lower bound and a second search are computed; with more states, both take minutes
LARGEST_BOUNDED = 20
# the highest level is an estimate of the norm, multiplied by a power of `FAR`; this is the number of powers that are tried
FURTHEST = 5
MOST_STATES = 100  # largest number of states of the discrete plant for which a descent is run; it then takes ten seconds
CLOSE = 1e-9  # a norm counts as 1 if its relative distance from 1 is smaller than this
GROW = 1.05  # a level without a solution is multiplied by this factor, which is squared after each further failure
FAR = 1e3  # ratio of the highest level that is tried to the level at which the search starts
ROUNDS = 60  # largest number of rounds; a search usually needs about five
# Largest number of variables of (22) at a level (21 states, one input). Solving (22) about two dozen times takes half a minute
MOST = 260
ROUNDING = 1e-7  # the norm of a gain may exceed the level of the central path that gave the gain by this relative amount


LawWithRemarks = tuple[LinearLaw, tuple[str, ...]]  # a law, and the remarks about this law


class SampledLaw(NamedTuple):
    """Law that was designed, exact norm of the sampled-data loop with this law, and remarks on the design."""

    law: LinearLaw
    norm: float
    remarks: tuple[str, ...] = ()


def norm_of(held: SampledDataProblem, K: Array, near: float) -> float:
    """Returns the exact norm of the sampled-data loop with a gain or a law [D, C; B, A]; infinite if the loop is not stable."""
    return sampled_norm(held.loop(K), near).value


def by_levels(
    held: SampledDataProblem,
    level: float,
    method: Callable[[Plant, float, LinearLaw | None], LawWithRemarks],
    ended: Callable[[float, float, float], bool],
    best: SampledLaw | None = None,
    levels: int = LEVELS,
    higher: float = NEAR,
    work: Work | None = None,
) -> tuple[SampledLaw, bool]:
    """Designs a law at one level after another.

    Returns the law with the lowest sampled-data norm, and True if the function `ended` stopped the search.

    Args:
        level: first level. Each later level is the norm of the sampled-data loop with the law that was designed at the previous
            level.
        method: function that designs a law for the plant of a level, starting from the best law so far. The function returns
            the law and remarks.
        ended: function of three values: the norm that a law reaches, the level at which it was designed, and the lowest earlier
            norm. The function `ended` returns True if another level would bring no improvement.
        best: best law that is already known; None if no law is known.
        levels: largest number of levels.
        higher: factor by which the level is multiplied if no law was found.
        work: counter of the computing work that is spent on norms; no new level begins after its limit is exceeded.

    Raises:
        InfeasibleError: no law stabilises the plant.
        InputError: no law was found.
    """
    failure: Exception = DesignError("no law with a stable sampled loop was found")
    for _ in range(levels):
        if work is not None and work.over:
            break
        found, plant, before = None, held.at(level), best.norm if best else np.inf
        if plant is not None:
            try:
                law, remarks = method(plant, level, best.law if best else None)
                found = SampledLaw(law, norm_of(held, law_gain(law), level), remarks)
            except InfeasibleError:
                raise
            except (InputError, np.linalg.LinAlgError) as error:
                failure = error
        if found is None or not np.isfinite(found.norm):
            level *= higher
            continue
        best = found if best is None or found.norm < before else best
        if ended(found.norm, level, before):
            return best, True
        level = found.norm
    if best is None:
        raise failure if isinstance(failure, InputError) else DesignError(str(failure))
    return best, False


def _falls_no_more(norm: float, level: float, before: float) -> bool:
    """Returns True if a norm is hardly lower than the lowest earlier norm."""
    return norm > before * (1 - WORTH)


def design_sampled(problem: DesignProblem, progress: Progress) -> DesignResult:
    """Designs a gain or a law for the sampled-data loop."""
    assert problem.sampled is not None, "a sampled loop"
    if problem.structure is None and problem.order != FULL:
        return _static(problem)
    near, full = problem.near, problem.structure is None
    if full and problem.thorough:
        near = lowest_level(problem.sampled, near, 0.0)[0]
    bound = _bound(problem, near)
    found, remark = (_full if full else _design_structured)(problem, problem.sampled, bound, near)
    method = "Riccati equations for the sampled loop" if full else DESCENT_SAMPLED
    why = f"for {problem.structure.text}" if problem.structure is not None else ""
    return _result(problem, found, bound, method=method, why=why, remarks=(remark,) if remark else ())


def _bound(problem: DesignProblem, near: float) -> SampledBound | None:
    """Returns the lower bound on the sampled-data norm for a problem; None if no bound is proved."""
    if not problem.thorough:
        return problem.sampled_bound
    from synth.lmi.sampled_bound import find_sampled_bound

    assert problem.sampled is not None, "a sampled loop"
    return find_sampled_bound(problem.sampled, near)


def _result(problem: DesignProblem, found: SampledLaw, bound: SampledBound | None, **more: Any) -> DesignResult:
    """Returns the design result for a law, with the certificate of the ideal loop with this law.

    Raises:
        DesignError: the law has no counterpart in continuous time.
    """
    try:
        certificate = problem.certified(found.law)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise DesignError(f"the law designed for the sampled loop cannot be converted to continuous time: {error}") from error
    level = None if bound is None else bound.level
    return DesignResult(found.law, certificate, value=found.norm, criterion=SAMPLED_NORM, sampled_lower_bound=level, **more)


def _design_at_level(problem: DesignProblem, held: SampledDataProblem, plant: Plant, **more: Any) -> LawWithRemarks:
    """Designs a law for the plant of a level, as for any discrete plant. Returns the law, and remarks on the design."""
    m, states = held.plant.B.shape[1], problem.states
    if states:
        states = *states, *(f"force_{k + 1}_of_{held.stored_forces}_before" for k in range(held.stored_forces) for _ in range(m))
    found = design(
        replace(
            problem,
            plant=plant,
            sampled=None,
            states=states,
            thorough=False,
            alternatives=False,
            certify=None,
            fastest_pole=None,
            **more,
        )
    )
    return found.law, found.remarks


def _full(problem: DesignProblem, held: SampledDataProblem, bound: SampledBound | None, near: float) -> tuple[SampledLaw, str]:
    """Returns a full-order law with a norm within 0.1 % of the lower bound or, with a remark, the law whose norm is closest to
    this bound.
    """
    goal = bound.level if bound is not None else 0.0
    least, first = lowest_level(held, goal * (1 + ABOVE * bound.inside) if bound is not None else near, goal)

    def method(plant: Plant, level: float, law: LinearLaw | None) -> LawWithRemarks:
        as_run = partial(_as_run, image=continuous_image(plant), period=held.period)
        return _design_at_level(problem, held, plant, lower_bound=LowerBound(least / level), as_run=as_run)

    def ended(norm: float, level: float, before: float) -> bool:
        return min(norm, before) <= least * (1 + WITHIN) or norm <= level * (1 + WORTH)

    levels = STABLE_LEVELS if problem.stable else LEVELS
    best, over = by_levels(held, first, method, ended, levels=levels, higher=HIGHER[problem.stable])
    if goal and best.norm <= goal * (1 + WITHIN):
        return best, ""
    stopped = "" if over else f"; the search stopped after {levels} levels"
    return best, f"{_above(best, goal)}: no law that was tried comes closer{stopped}"


def _design_structured(
    problem: DesignProblem, held: SampledDataProblem, bound: SampledBound | None, near: float
) -> tuple[SampledLaw, str]:
    """Designs a law of a given order or structure by descent. Returns the law and a remark."""
    goal, work = bound.level if bound is not None else 0.0, problem.work or bounded_work(held.plant)

    def method(plant: Plant, level: float, law: LinearLaw | None) -> LawWithRemarks:
        known = [law] if law is not None and problem.structure and not problem.structure.kind else []
        return _design_at_level(problem, held, plant, lower_bound=None, known=known, work=work)

    best, _ = by_levels(held, NEAR * (goal or near), method, _falls_no_more, work=work)
    return best, "; ".join([_above(best, goal), *best.remarks])


def _above(found: SampledLaw, goal: float) -> str:
    """Describes the gap between a law's norm and the lower bound."""
    return f"{percent(found.norm / goal - 1)} above the lower bound of the sampled loop" if goal else NO_BOUND


def _as_run(law: LinearLaw, image: tuple[Plant, Array], period: float) -> LinearLaw:
    """Converts a law for the continuous counterpart of a plant to a discrete law. A discrete law is returned unchanged."""
    return discrete_law(law, *image, period) if law.sample_period is None else law


def lowest_level(held: SampledDataProblem, start: float, below: float) -> tuple[float, float]:
    """Returns a level at which no law exists, and a slightly higher level at which a law exists."""
    low, high, level = below, np.inf, start
    for _ in range(LOWEST):
        if _solvable(held.at(level)):
            high = level
        else:
            low = level
        if high <= low * (1 + BRACKETED):
            break
        level = 2 * low if high == np.inf else (low * high) ** 0.5 if low else high / 2
    return (low, high) if high < np.inf else (below, start)


def _solvable(plant: Plant | None) -> bool:
    """Returns True if Riccati equations give a law with which the discrete plant of a level has a norm below one."""
    if plant is not None:
        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            search = RiccatiSearch(continuous_image(plant)[0], 0.0)
            return any(search.traded(share, search.own.norm) is not None for share in COSTS)
    return False


def _static(problem: DesignProblem) -> DesignResult:
    """Designs a static gain by the two steps, or by the first step alone if all states are measured, followed by descent.

    Raises:
        InfeasibleError: no static gain from the measurements stabilises the loop; the message describes the mode that cannot be
            stabilised.
        TooLargeError: the delay is so long that too many forces must be stored.
        DesignError: no gain was found; the message lists what was tried.
    """
    held = problem.sampled
    assert held is not None, "a sampled loop"
    (n, m), late = held.plant.B.shape, held.stored_forces
    if n + m * late > MOST_STATES:
        raise TooLargeError(
            f"a delay of {late} samples gives the loop {n + m * late} states, and sampled designs allow at most {MOST_STATES}; "
            "omit sampled = true (a continuous design runs with any delay), or give a longer sample period or a shorter delay"
        )
    levels = [problem.near * FAR ** (k + 1) for k in range(FURTHEST)]
    far, slow = next(((each, plant) for each in levels if (plant := held.at(each)) is not None), (levels[-1], None))
    if slow is None:
        within = f"within one period of {1000.0 * held.period:g} ms, in which no new force acts, the gain from w exceeds {far:g}"
        raise DesignError(f"{NO_GAIN}; give a shorter sample period: {within}")
    rows, given = independent_rows(slow), np.hstack([held.plant.Cy, held.plant.Dyu])
    known, work = [from_some(law.D, given, rows) for law in problem.known], problem.work or bounded_work(held.plant)
    try:
        K, norm, level, instead = _gain(held.of(rows), problem.near, known, far, work)
    except DesignError as error:
        slow = slow.rows(rows)
        if reasons := "; ".join(stabilisability_failures(slow) or static_feedback_obstructions(slow)):
            raise InfeasibleError(reasons) from error
        raise
    found, bound, remarks = SampledLaw(static_law(on_all_rows(K, rows, len(given))), norm), None, ()
    if problem.thorough:
        bound = _bound(problem, problem.near)
        remarks = (f"norm {_above(found, bound.level)}" if bound is not None else NO_BOUND,)
    method, why = "the two steps for the sampled loop", "the two-step method finds a gain of this sampled norm"
    if instead:
        method, why = DESCENT_SAMPLED, f"the two-step method was not used: {instead}"
    redundant = tuple(i for i in range(len(given)) if i not in rows)
    more = {"level": level, "instead": instead, "redundant": redundant}
    return _result(problem, found, bound, method=method, why=why, remarks=remarks, **more)


End = tuple[Array, float]  # gain, shape (m, q), and norm of the sampled-data loop with this gain


def lowest(ends: Sequence[End]) -> End:
    """Returns the gain with the lowest norm among several gains, and this norm."""
    return min(ends, key=lambda end: end[1])


def down(held: SampledDataProblem, K: Array, norm: float, work: Work | None = None) -> End:
    """Lowers the norm by descent from a stabilising gain K, as `refine` does, on the plants of decreasing levels, until `work`
    reaches its limit.
    """

    def method(plant: Plant, level: float, law: LinearLaw | None) -> LawWithRemarks:
        return static_law(lower_norm(Landscape(plant, work=work), plant, law.D if law else K).gain), ()

    found, _ = by_levels(held, norm, method, _falls_no_more, SampledLaw(static_law(K), norm), DESCENTS, 1.0)
    return found.law.D, found.norm


def best_descent(held: SampledDataProblem, known: Sequence[Array], near: float, work: Work) -> End:
    """Returns the best gain that descent finds, and its norm; the norm is infinite if no starting point is stable.

    Args:
        known: gains from which descents start, shapes (m, q). The line through zero and the first gain is searched for starting
            points.
        near: estimate of the norm, from which the computation of the norm starts.
        work: counter of the computing work of the search.
    """
    nothing = np.zeros((held.plant.B.shape[1], len(held.plant.Cy)))
    line = [sign * share * K for K in known[:1] for sign, shares in ((-1, SHARES), (1, SHARES[::-1])) for share in shares]
    line.insert(len(line) // 2, nothing)
    norms = [norm_of(held, K, near) for K in line]
    padded = [np.inf, *norms, np.inf]
    starts = [(K, norms[i]) for i, K in enumerate(line) if norms[i] <= min(padded[i], padded[i + 2])]
    starts += [(K, norm_of(held, K, near)) for K in known[1:]]
    best = sorted(starts, key=lambda start: start[1])[:STARTS]
    return lowest([*(down(held, *start, work) for start in best if np.isfinite(start[1])), (nothing, np.inf)])


def better_valley(held: SampledDataProblem, end: End, far: float, work: Work) -> End:
    """Continues the search for a better gain, for the discrete plant of one level.

    Returns the new gain if its norm is at least 0.1 % lower, otherwise the given gain.

    Args:
        end: best gain so far, and the norm with this gain. The norm is infinite if the gain does not stabilise the loop.
        far: a level far above the norm, for which a discrete plant exists. The norm of the discrete plant is nearly
            proportional to the norm of the sampled-data loop.
        work: counter of the computing work of the search.
    """
    K, norm = end
    plant, level = held.at(norm) if np.isfinite(norm) else None, norm
    if plant is None:
        plant, level = held.at(far), far
    assert plant is not None, "the level has a plant"
    search = GainSearch(plant, LARGEST_GAIN, 0.0, work=work)
    candidates = search.starts()
    if np.isfinite(norm):
        candidates += search.feasible_candidates(search.landscape.point(K), "a known gain")
    if not candidates:
        return end
    other = search.landscape.gain(search.best(candidates).x)
    reached = norm_of(held, other, level)
    other, reached = down(held, other, reached, work) if np.isfinite(reached) else (other, reached)
    return (other, reached) if reached < norm * (1 - WORTH_ANOTHER) else end


def refined_further(held: SampledDataProblem, K: Array, near: float) -> Refinement:
    """Lowers the exact norm by descent from a stabilising gain, as long as the decrease justifies a larger gain.

    Args:
        held: sampled-data problem.
        K: gain on all measurements, shape (m, q).
        near: estimate of the norm, from which the computation of the norm starts.

    Raises:
        DesignError: the loop with K is not stable, or the norm is determined by the motion within one period, in which no force
            can react.
    """
    before = norm_of(held, K, near)
    plant = held.at(before) if np.isfinite(before) else None
    if plant is None:
        raise DesignError("this gain cannot be refined: its sampled loop is unstable, or its norm arises within one period")
    rows = independent_rows(plant)
    few = held.of(rows)
    start = from_some(K, np.hstack([held.plant.Cy, held.plant.Dyu]), rows)
    moved, after = down(few, start, before)
    last = few.at(after)
    refused = refine(last, None, moved).refused_stage if last is not None else None
    landscape = Landscape(plant.rows(rows))
    sizes = [float(np.abs(landscape.point(each)).max()) for each in (start, moved)]
    growth = sizes[1] / sizes[0] if sizes[0] else 1.0
    return Refinement(on_all_rows(moved, rows, len(plant.Cy)), before, after, growth, refused, "the sampled norm")


def _gain(
    held: SampledDataProblem, near: float, known: Sequence[Array], far: float, work: Work
) -> tuple[Array, float, float | None, str]:
    """Returns the gain K for independent measurements, its norm, its level, and the reason if K does not come from the two
    steps.

    Args:
        far: a level far above the norm, for which a discrete plant exists.
        work: counter of the computing work of the search.
    """
    undelayed = failure = K = level = None
    norm, quiet = np.inf, replace(held, rms=None)
    if held.stored_forces:
        with contextlib.suppress(DesignError):
            undelayed, _ = two_steps(quiet.without_delay, near, None)
    try:
        K, level = two_steps(quiet, near, undelayed)
        norm = norm_of(held, K, near)
    except DesignError as error:
        failure = error
    nothing = np.zeros((held.plant.B.shape[1], len(held.plant.Cy)))
    others = {"the continuous design": known, "no control": [nothing]}
    least, which = min((norm_of(held, other, near), name) for name, some in others.items() for other in some)
    if K is not None and np.isfinite(norm):
        end = K, norm
        for start in (K, *known):
            height = norm_of(held, start, near)
            if np.isfinite(height) and not _at_the_limit(held, end[1]):
                end = lowest([end, down(held, start, height, work)])
        if least < end[1]:
            end = lowest([end, best_descent(held, [*known, K], near, work)])
    else:
        failure = failure or DesignError("rounding leaves no stable loop with the gain that was found")
        end = best_descent(held, [start for start in (*known, undelayed, K) if start is not None], near, work)
    moved, reached = better_valley(held, end, far, work) if _may_fall(held, end[1]) else end
    if failure is None:
        assert K is not None, "without a failure it is found"
        if held.noise.size:
            why = "the two-step method ignores noise"
        elif norm <= min(least * (1 + ROUNDING), reached * (1 + WORTHWHILE_GAIN)):
            return K, norm, level, ""
        else:
            further = f"{which} reaches {digits(least)}" if least < norm else f"descent from there reaches {digits(reached)}"
            why = f"the two-step method reaches {digits(norm)}, and {further}"
    elif np.isfinite(reached):
        why = NO_SECOND_STEP if isinstance(failure, NoSolutionError) else str(failure)
    else:
        tried = f"descent on the sampled norm, but no start was stable; the two-step method: {failure}"
        raise DesignError(no_gain(tried, "give a shorter sample period or delay, ")) from failure
    why += f"; {work.text}" if work.over else ""
    # The ninth digit of a norm depends on the estimate from which its computation starts. The final norm is computed from the
    # estimate `near`.
    return moved, norm_of(held, moved, near), None, why


def _at_the_limit(held: SampledDataProblem, norm: float) -> bool:
    """Returns True if a norm is close to the part of the L2 gain that no control force can change."""
    plant = held.at(norm * (1 - WORTHWHILE_GAIN))
    return plant is None or bound_beyond_control(plant).gamma >= 1


def _may_fall(held: SampledDataProblem, norm: float) -> bool:
    """Returns True if a search for a lower norm pays: no lower bound within 1 % is known, and the loop has few states."""
    if len(held.rows[0]) > LARGEST_BOUNDED:
        return False
    plant = held.at(norm * (1 - LITTLE)) if np.isfinite(norm) else None
    if plant is None:
        return bool(np.isinf(norm))
    with contextlib.suppress(InputError, np.linalg.LinAlgError):
        return find_lower_bound(plant).gamma < 1
    return True


def two_steps(held: SampledDataProblem, near: float, undelayed: Array | None) -> tuple[Array, float]:
    """Designs a gain K by the two steps, which ignore measurement noise. Returns K and its level.

    Args:
        held: sampled-data problem without noise, with independent measurements.
        near: level at which the search starts.
        undelayed: gain of a design without delay, shape (m, q). If `undelayed` is given, a second L (14) is tried, under the
            assumption that this gain computed the delayed forces.

    Raises:
        DesignError: one of the steps has no solution, or a central path could not be followed.
    """
    rows, (n, m) = held.rows, held.plant.B.shape
    size = n + m * held.stored_forces
    fits(size * (size + 1) // 2 + m * size + 1, MOST, "the two-step method for sampled loops")
    level, path = _level(held, state_path, near)
    if len(rows) == size:
        return np.linalg.solve(rows.T, path[-1].K.T).T, level
    ends, failures = list[tuple[float, CentralPoint]](), list[DesignError]()

    def second_step(R: Array) -> None:
        try:
            reached, (point,) = _level(held, lambda plant: [_second(plant, R)], level)
            ends.append((reached, point))
        except DesignError as error:
            failures.append(error)

    second_step(_follows(path[-1].X, rows))
    if undelayed is not None:
        _, of_state = _level(held.without_delay, state_path, level)
        both = np.vstack([_follows(of_state[-1].X, held.plant.Cy), *[undelayed] * held.stored_forces])
        second_step(both @ np.linalg.inv(rows @ both))
    for start in reversed(path[:-1]):
        if not ends:
            second_step(_follows(start.X, rows))
    for reached, point in sorted(ends, key=lambda pair: pair[0]):
        if norm_of(held, point.K, near) <= reached * (1 + ROUNDING):
            return point.K, reached
        failures.insert(0, DesignError(f"rounding leaves no loop that keeps the level {digits(reached)}"))
    raise failures[0]


def _follows(X: Array, rows: Array) -> Array:
    """Returns the matrix R of (9) for the L (14) that belongs to a given X, shape (n, q). The product R y is an estimate of the
    states from the measurements y.
    """
    return X @ rows.T @ np.linalg.inv(rows @ X @ rows.T)


def _second(plant: Plant, R: Array) -> CentralPoint:
    """Solves the second step (25) for a given R that fulfils C_y R = I."""
    units = own_units(plant, measured=True)
    basis, measured = units.rows(plant.Cy)
    own = units.into(plant).measured(basis)
    Q = nullspace(basis)
    L = np.linalg.pinv(Q) @ (R @ measured / units.states[:, None])
    return output_feedback(own, L, Q)[-1].in_units(units.states, units.inputs, measured)


def _level(
    problem: SampledDataProblem, path: Callable[[Plant], list[CentralPoint]], start: float
) -> tuple[float, list[CentralPoint]]:
    """Returns the level for which the central path of the discrete plant ends at a norm of 1, and the central path for this
    level.

    If the path ends at a norm below 1 for every level above the largest gain within one period, the level is equal to this
    gain. If a problem has no solution at a level far above the norm, it has no solution at lower levels either.
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
                except DesignError:  # the failure is due to a rounding error, so it proves nothing about lower levels
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
            guesses = (_crossing_level(seen[-count:]) for count in (3, 2, 1))
            # If only one bound on the level is known, the last guess lies beyond this bound, because this guess uses only one
            # pair of values.
            level = next((guess for guess in guesses if below < guess < above), math.sqrt(below * above))
        if best is not None and above <= below * (1 + CLOSE):
            return best
    raise DesignError(
        f"the norm of the sampled loop did not converge in {ROUNDS} rounds: it is between {below:.7g} and {above:.7g}"
    )


def _crossing_level(seen: Sequence[tuple[float, float]]) -> float:
    """Returns the level at which the norm is 1, from a polynomial for log level as a function of log norm; NaN if two norms are
    equal.

    If only one pair of norm and level is known, the norm is assumed to be inversely proportional to the level.
    """
    at, level = (np.array(each) for each in zip(*seen, strict=True))
    if len(seen) == 1:
        return math.exp(at[0] + level[0])
    apart = at[:, None] - at + np.eye(len(at))
    with np.errstate(all="ignore"):
        weights = np.prod(np.where(np.eye(len(at)) > 0, 1.0, -at / apart), axis=1)
        return float(np.exp(weights @ level))
