"""The errors that make a loop worst, looked for: from vertex to vertex of their box, one error at a time."""

from collections.abc import Iterator

import numpy as np

from models.common.arrays import Array
from synth.goals.problem import Errors, GoalProblem, NormGoal
from synth.goals.terms import Decay
from synth.search.landscape import Landscape

TURNS = 4  # through all errors
NOT_STABLE = 1e6  # what a bound counts as that an unstable loop passes


def worst_errors(problem: GoalProblem, like: Landscape, x: Array, goal: float) -> Iterator[tuple[float, Errors]]:
    """For every member, and for what is minimised and every bound on a norm: how far the worst errors met are beyond, and they.

    Beyond 1 lies what is worse than the goal that is known, or than the bound.

    Args:
        problem: it says how large errors may be.
        like: whose points these are.
        x: the point.
        goal: what is known.
    """
    for i in range(len(problem.members)):
        unit = problem.bests[i] if problem.bests is not None else 1.0
        yield _worst(problem, i, problem.minimise, unit * goal, like, x)
        for norm in problem.norms:
            yield _worst(problem, i, norm, norm.at_most, like, x)
        if problem.decay is not None:
            yield _worst(problem, i, None, problem.decay, like, x)


def worst_of_norm(problem: GoalProblem, i: int, norm: NormGoal | None, unit: float, K: Array) -> tuple[float, Errors]:
    """The largest value met of one member in a unit, of a norm or, for None, of the decay, and the errors; of a gain (m, q)."""
    like = problem.nominal()
    return _worst(problem, i, norm, unit, like, like.point(K))


def _worst(problem: GoalProblem, i: int, norm: NormGoal | None, unit: float, like: Landscape, x: Array) -> tuple[float, Errors]:
    """The largest value met in a unit, of a norm or, for None, of the decay."""
    m, q = problem.shape
    sides = np.concatenate([problem.tolerance.sensors, problem.tolerance.forces])

    def at(signs: Array) -> tuple[float, Errors]:
        errors = Errors((signs * sides)[:q], (signs * sides)[q:])
        asked = norm or problem.minimise
        landscape = problem.landscape(i, asked.which, asked.band, errors, like)
        value = Decay(landscape, unit).value(x) if norm is None else landscape.norm(x)[0] / unit
        return min(value, NOT_STABLE), errors

    best = at(np.zeros(m + q))
    for start in (1.0, -1.0):
        signs = np.full(m + q, start)
        value, errors = at(signs)
        for _ in range(TURNS):
            changed = False
            for k in np.flatnonzero(sides):
                signs[k] = -signs[k]
                there, those = at(signs)
                if there > value:
                    value, errors, changed = there, those, True
                else:
                    signs[k] = -signs[k]
            if not changed:
                break
        if value > best[0]:
            best = value, errors
    return best
