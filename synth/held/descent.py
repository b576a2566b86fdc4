"""Descent on the exact norm of a held loop, for what the two steps do not reach.

The norm over the gain has several valleys where a period turns a mode of the plant by more than a fraction of a turn, and a loop
of a good gain at a fast rate may be unstable at a slow one. So the descent starts where the norm is least along the line through
what is known, to either side of no control at all, and from what else is known.
"""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from synth.errors import TooLargeError
from synth.held.problem import HeldProblem
from synth.sampled.norm import sampled_norm
from synth.search.refine import refine

DESCENTS = 8
WORTH = 1e-4  # relative; a descent that gains less is the last
SHARES = 2.0 ** -np.arange(11)  # of a known gain, on either side: the least that counts here is a thousandth
STARTS = 3  # the best of them
MOST_STATES = 100  # of a level's plant: a descent takes ten seconds


def norm_of(problem: HeldProblem, K: Array, near: float) -> float:
    """The exact norm of a gain, shape (m, q); infinite where its loop is not stable."""
    return sampled_norm(problem.loop(K), near).value


def descended(problem: HeldProblem, known: Sequence[Array], near: float) -> tuple[Array, float]:
    """The best gain that descent finds, and its norm, infinite where no start is stable.

    Args:
        problem: what is designed for.
        known: gains to start from, shapes (m, q); the line through the first is searched.
        near: a guess of the norm.
    """
    nothing = np.zeros((problem.plant.B.shape[1], len(problem.Cy)))
    line = [sign * share * K for K in known[:1] for sign, shares in ((-1, SHARES), (1, SHARES[::-1])) for share in shares]
    line.insert(len(line) // 2, nothing)
    norms = [norm_of(problem, K, near) for K in line]
    padded = [np.inf, *norms, np.inf]
    starts = [(norms[i], K) for i, K in enumerate(line) if norms[i] <= min(padded[i], padded[i + 2])]
    starts += [(norm_of(problem, K, near), K) for K in known[1:]]
    best = sorted(starts, key=lambda start: start[0])[:STARTS]
    return min(
        (_down(problem, K, norm) for norm, K in best if np.isfinite(norm)), key=lambda end: end[1], default=(nothing, np.inf)
    )


def _down(problem: HeldProblem, K: Array, norm: float) -> tuple[Array, float]:
    """From a stable K as `refine` goes: below a level is a norm below 1 of its plant."""
    for _ in range(DESCENTS):
        plant = problem.at(norm)
        if plant is None:
            break
        moved = refine(plant, problem.rows, K).gain
        reached = norm_of(problem, moved, norm)
        if not reached < norm:
            break
        enough = reached > norm * (1 - WORTH)
        K, norm = moved, reached
        if enough:
            break
    return K, norm


def check_size(problem: HeldProblem) -> None:
    """Raises a TooLargeError for a loop whose forces on their way are too many states."""
    (n, m), late = problem.plant.B.shape, problem.remembered
    if n + m * late > MOST_STATES:
        raise TooLargeError(
            f"forces of {late} samples on their way make it {n + m * late} states, and the sampled loop is designed for with at "
            f"most {MOST_STATES}; leave sampled = true out, for the continuous design runs at any delay, or give a longer sample "
            "period or a shorter delay"
        )
