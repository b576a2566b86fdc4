"""The two steps for the loop that a computer closes.

For every level of the loop's L2 gain there is a discrete plant (`problem.py`). The level that a step reaches is the one for whose
plant its optimum is a norm of 1: found by secants over the logarithms, in a handful of problems. State feedback (22) has one such
level, and the X of its optimum there makes L (14); the second step, with its slack variable (`lmi/slack.py`), has another. Every
optimum is the limit of a central path, and so is the gain: it is unique, and depends on no solver and no unit. What it gains is
then computed exactly, without any of this (`sampled/norm.py`).

Forces on their way are states that nothing measures, and that follow what was measured at once. An L that makes them follow the
state feedback may leave the second step without a solution; one that makes them follow a gain as good as that looked for need
not. Where there is none by either, or where the continuous design does better as it runs, or no control at all, descent on the
exact norm (`descent.py`) goes on from what is known, and the result says so.
"""

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from synth.design import state_path
from synth.errors import DesignError, InfeasibleError
from synth.held.descent import check_size, descended, norm_of
from synth.held.problem import HeldProblem
from synth.lmi.central import CentralPoint, fits
from synth.lmi.output_feedback import independent_rows, nullspace, output_feedback
from synth.lmi.slack import slack_path
from synth.modes import immovable, obstacles
from synth.numerics import numerics
from synth.plant import GeneralizedPlant
from synth.scaling import own_units
from synth.search.refine import from_some

CLOSE = 1e-9  # relative: so near to 1 a norm is it
GROW = 1.05  # of a level, where there is no solution; the square of it the next time
FAR = 1e3  # times where the search for a level starts
ROUNDS = 60  # five or so do
MOST = 260  # unknowns of (22) for a level, 21 states with one input: a dozen or two of such problems take half a minute
ROUNDING = 1e-7  # relative; how far a norm may lie above a level that is reached at a limit of central paths


@dataclass(frozen=True, eq=False)
class HeldDesign:
    """A gain for the loop that a computer closes.

    Attributes:
        gain: K, shape (m, q).
        norm: the L2 gain of its loop, exact.
        level: what the LMI says that is at most; None of a gain that was found by descent.
        kept: which of the q measurements do not follow from others; the gain of those that do is zero.
        instead: why the two steps did not lead to it, in words; empty where they did.
    """

    gain: Array
    norm: float
    level: float | None
    kept: tuple[int, ...]
    instead: str = ""


@numerics()
def held_design(problem: HeldProblem, near: float, known: Sequence[Array] = ()) -> HeldDesign:
    """The two steps, or the first alone where all states are measured.

    Args:
        problem: what is designed for.
        near: a level to start from, as the norm of the continuous design.
        known: gains from the same measurements, as the continuous design's, shapes (m, q): what is designed is not worse.

    Raises:
        InfeasibleError: no gain from what is measured stabilises the loop, or none is found by the second step.
        TooLargeError: too many forces are on their way.
        DesignError: a path could not be followed.
    """
    check_size(problem)
    slow = problem.at(FAR * near)
    if slow is None:
        raise InfeasibleError(f"within one period of {1e3 * problem.period:g} ms, where no force answers, w gains {FAR * near:g}")
    kept = independent_rows(slow, problem.rows)
    few = replace(problem, Cy=problem.Cy[kept], through=problem.through[kept])
    of_kept = [from_some(K, np.hstack([problem.Cy, problem.through]), kept) for K in known]
    try:
        K, norm, level, instead = _gain(few, near, of_kept)
    except DesignError as error:
        reasons = obstacles(slow, few.rows) or immovable(slow, few.rows)
        raise (InfeasibleError("; ".join(reasons)) if reasons else error) from error
    gain = np.zeros((len(K), len(problem.Cy)))
    gain[:, kept] = K
    return HeldDesign(gain, norm, level, tuple(kept), instead)


def _gain(problem: HeldProblem, near: float, known: Sequence[Array]) -> tuple[Array, float, float | None, str]:
    """K from independent measurements, its norm, its level, and why it is not by the two steps where it is not."""
    undelayed = failure = K = level = None
    norm = np.inf
    if problem.remembered:
        with contextlib.suppress(DesignError):
            undelayed, *_ = _gain(problem.at_once, near, known)
    try:
        K, level = _two_steps(problem, near, undelayed)
        norm = norm_of(problem, K, near)
    except DesignError as error:
        failure = error
    nothing = np.zeros((problem.plant.B.shape[1], len(problem.Cy)))
    others = {"the continuous design": known, "no control": [nothing]}
    least, which = min((norm_of(problem, other, near), name) for name, some in others.items() for other in some)
    if K is not None and not least < norm * (1 - ROUNDING):
        if np.isfinite(norm):
            return K, norm, level, ""
        failure = DesignError("the loop of the gain that was found is not stable: rounding leaves none that is")
    moved, reached = descended(problem, [start for start in (*known, undelayed, K) if start is not None], near)
    if not np.isfinite(reached):
        raise failure or DesignError("no start of a descent is stable")
    # The norm of a gain depends, in its ninth digit, on the guess that it is found from: it is to be that of `near`.
    return (
        moved,
        norm_of(problem, moved, near),
        None,
        str(failure) if failure else f"they come to {norm:.7g}, and {which} to {least:.7g}",
    )


def _two_steps(problem: HeldProblem, near: float, undelayed: Array | None) -> tuple[Array, float]:
    """K by the two steps and its level; L (14) also makes forces on their way follow a gain for forces that act at once.

    Raises:
        DesignError: there is none.
    """
    rows, (n, m) = problem.rows, problem.plant.B.shape
    size = n + m * problem.remembered
    fits(size * (size + 1) // 2 + m * size + 1, MOST, "the two steps of a sampled loop are gone")
    level, path = _level(problem, state_path, near)
    if len(rows) == size:
        return np.linalg.solve(rows.T, path[-1].K.T).T, level
    tries = _Tries(problem, level)
    tries.add(_follows(path[-1].X, rows))
    if undelayed is not None:
        _, of_state = _level(problem.at_once, state_path, level)
        both = np.vstack([_follows(of_state[-1].X, problem.Cy), *[undelayed] * problem.remembered])
        tries.add(both @ np.linalg.inv(rows @ both))
    for start in reversed(path[:-1]):
        if not tries.found:
            tries.add(_follows(start.X, rows))
    for reached, point in sorted(tries.found, key=lambda pair: pair[0]):
        if norm_of(problem, point.K, near) <= reached * (1 + ROUNDING):
            return point.K, reached
        tries.failures.insert(
            0, DesignError(f"the loop of its gain does not keep the level {reached:.7g}: rounding ends it there")
        )
    raise tries.failures[0]


class _Tries:
    """Second steps with one R after another: what they reach, and why those that reach nothing do not."""

    def __init__(self, problem: HeldProblem, level: float) -> None:
        self.problem, self.level = problem, level
        self.found = list[tuple[float, CentralPoint]]()
        self.failures = list[DesignError]()

    def add(self, R: Array) -> None:
        """With a slack variable and without: where rounding ends the former's path, as at a very fast sample, that is left."""
        for slack in (True, False):
            try:
                level, (point,) = _level(
                    self.problem, lambda plant, on=slack: [_second(plant, self.problem.rows, R, on)], self.level
                )
                self.found.append((level, point))
            except DesignError as error:
                self.failures.append(error)


def _follows(X: Array, rows: Array) -> Array:
    """R (9) with the L (14) of an X: what the states are as a rule where so much is measured, shape (n, q)."""
    return X @ rows.T @ np.linalg.inv(rows @ X @ rows.T)


def _second(plant: GeneralizedPlant, rows: Array, R: Array, slack: bool) -> CentralPoint:
    """The second step with an R, of which rows R = I: (25), and on from its path with a slack variable if that is wished."""
    units = own_units(plant, rows)
    own, (basis, measured) = units.into(plant), units.rows(rows)
    Q = nullspace(basis)
    L = np.linalg.pinv(Q) @ (R @ measured / units.states[:, None])
    path = output_feedback(own, basis, L, Q)
    return (slack_path(own, basis, path) if slack else path)[-1].in_units(units.states, units.inputs, measured)


def _level(
    problem: HeldProblem, path: Callable[[GeneralizedPlant], list[CentralPoint]], start: float
) -> tuple[float, list[CentralPoint]]:
    """The level for whose plant a path ends at a norm of 1, and that path.

    Where it ends below 1 at every level above what happens within one period, that is the level. What has no solution at a level
    far above has none below.

    Raises:
        DesignError: it ends at no level.
    """
    below, above, level, grow = 0.0, math.inf, start, GROW
    last: tuple[float, float] | None = None
    best: tuple[float, list[CentralPoint]] | None = None
    for _ in range(ROUNDS):
        plant, failure, found = problem.at(level), None, list[CentralPoint]()
        if plant is not None:
            try:
                found = path(plant)
            except DesignError as error:
                failure = error
        if not found:
            if isinstance(failure, InfeasibleError) and not below and (loosest := problem.at(FAR * start)) is not None:
                try:
                    path(loosest)
                except InfeasibleError:
                    raise
                except DesignError:  # rounding, which says nothing of the levels between
                    pass
            below = max(below, level)
            if level > FAR * start:
                raise failure or DesignError("the L2 gain of the loop has no level")
            level, grow = (level * grow, grow**2) if math.isinf(above) else (math.sqrt(level * above), grow)
        else:
            norm = found[-1].gamma
            if abs(math.log(norm)) <= CLOSE:
                return level * norm, found
            if norm < 1:
                above, best = level, (level, found)
            else:
                below = max(below, level)
            at = math.log(level), math.log(norm)
            slope = (at[1] - last[1]) / (at[0] - last[0]) if last is not None and at[0] != last[0] else -1.0
            last = at
            level = math.exp(at[0] - at[1] / slope) if slope < 0 else math.nan
            if not below < level < above:
                level = math.sqrt(below * above) if below and not math.isinf(above) else 2 * below if below else above / 2
        if best is not None and above <= below * (1 + CLOSE):
            return best
    raise DesignError(f"the level of the sampled loop was not found in {ROUNDS} rounds, between {below:.7g} and {above:.7g}")
