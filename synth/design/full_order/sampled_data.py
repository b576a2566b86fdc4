"""The full-order law for the loop that a computer closes: that of the discrete plant of a level next to the lower bound.

The plant of a level (`synth/analysis/sampled_loop.py`) has the forces on their way among its states, and the noise of the
readings among its disturbances. So a discrete law for it knows the delay, the hold and the motion between samples. The norm of
its loop is computed exactly (`synth/analysis/sampled_norm.py`).

The lowest level whose Riccati equations have a solution is bracketed first, which takes a law of each level, and no search. A law
is designed there. If the norm of its loop is not near that level, the level moves to the norm, and a law is designed again.
"""

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.printed import percent
from models.laws.linear import LinearLaw
from synth.analysis.lower_bound import LowerBound, SampledBound
from synth.analysis.sampled_loop import SampledDataProblem
from synth.analysis.sampled_norm import sampled_norm
from synth.design.full_order.full_order import discrete_law, full_order_design
from synth.design.full_order.riccati import RiccatiSearch
from synth.design.problem import DesignProblem, DesignResult, Progress
from synth.design.sampled_data import SampledDesign, bound_of
from synth.plant.discrete import mapped
from synth.plant.generalized import Plant, law_gain
from synth.plant.numerics import DesignError, InfeasibleError, numerics

WITHIN = 1e-3  # relative; so close to what no controller beats, nothing is left to gain
ABOVE = 1e-4  # relative; how far above a bound within a period the first level is
ROUNDS, STABLE_ROUNDS = (
    4,
    2,
)  # levels at which a law is designed, at most; one that is to be stable by itself takes a descent at each
HIGHER = {False: 1.01, True: 1.1}  # times a level without a law is the next, by whether it is to be stable by itself
SHARES = (1e-3, 1e-5)  # of noise and cost, with which the lowest level is bracketed
STEPS = 40  # of that, at most
CLOSE = 1e-4  # relative; how closely that level is bracketed


@numerics()
def sampled_full_order(
    problem: SampledDataProblem, bound: SampledBound | None, near: float, states: Sequence[str] = (), stable: bool = False
) -> SampledDesign:
    """Designs a law within 0.1 % of the lower bound, or the nearest that was found.

    Args:
        bound: lower bound of the loop; None if none is proved.
        near: a level to start from without a bound.
        states: names of the plant's states, for messages.
        stable: True for a law that is stable by itself.

    Raises:
        InfeasibleError: the plant cannot be stabilised from what is measured; the message names the mode.
        DesignError: no law was found.
    """
    best: SampledDesign | None = None
    failure: Exception | None = None
    goal = bound.level if bound is not None else 0.0
    least, level = lowest_level(problem, goal * (1 + ABOVE * bound.inside) if bound is not None else near, goal)
    names = (*states, *(f"force_{k + 1}_of_{problem.remembered}_before" for k in range(problem.remembered))) if states else ()
    rounds, ended = STABLE_ROUNDS if stable else ROUNDS, False
    for _ in range(rounds):
        plant = problem.at(level)
        if plant is None:
            level *= 1.1
            continue
        as_run = partial(_as_run, image=mapped(plant), period=problem.period)
        try:
            aim = LowerBound(least / level)
            law = full_order_design(plant, None, None, aim, names, stable=stable, as_run=as_run).law
            norm = sampled_norm(problem.loop(law_gain(law)), level).value
        except InfeasibleError:
            raise
        except (DesignError, InputError, np.linalg.LinAlgError) as error:
            failure, level = error, level * HIGHER[stable]
            continue
        if not np.isfinite(norm):
            level *= HIGHER[stable]
            continue
        if best is None or norm < best.norm:
            best = SampledDesign(law, norm)
        ended = best.norm <= least * (1 + WITHIN) or norm <= level * (1 + WITHIN / 10)
        if ended:
            break
        level = norm
    if best is None:
        raise DesignError(str(failure) if failure else "no law with a stable sampled loop was found")
    if goal and best.norm <= goal * (1 + WITHIN):
        return best
    above = f"{percent(best.norm / goal - 1)} above the lower bound of the sampled loop" if goal else "no lower bound is proved"
    stopped = "" if ended else f"; the search stopped after {rounds} levels"
    return replace(best, remark=f"{above}: no law that was tried comes closer{stopped}")


def sampled_full(problem: DesignProblem, progress: Progress) -> DesignResult:
    """Designs a law of full order for the loop that a computer closes."""
    assert problem.sampled is not None, "a sampled loop"
    near = lowest_level(problem.sampled, problem.near, 0.0)[0] if problem.thorough else problem.near
    bound = bound_of(problem, near)
    found = sampled_full_order(problem.sampled, bound, near, problem.states, problem.stable)
    remarks, level = (found.remark,) if found.remark else (), None if bound is None else bound.level
    return found.result(problem, method="Riccati equations for the sampled loop", remarks=remarks, sampled_lower_bound=level)


def _as_run(law: LinearLaw, image: tuple[Plant, Array], period: float) -> LinearLaw:
    """Returns the discrete law of one for the mapped plant."""
    return discrete_law(law, *image, period) if law.sample_period is None else law


def lowest_level(problem: SampledDataProblem, start: float, below: float) -> tuple[float, float]:
    """Returns a level at which no law was found, or one known to be too low, and the next above it at which there is a law."""
    low, high, level = below, np.inf, start
    for _ in range(STEPS):
        if _solvable(problem, level):
            high = level
        else:
            low = level
        if high <= low * (1 + CLOSE):
            break
        level = 2 * low if high == np.inf else (low * high) ** 0.5 if low else high / 2
    return (low, high) if high < np.inf else (below, start)


def _solvable(problem: SampledDataProblem, level: float) -> bool:
    """Returns True if a central law of the level's plant has a norm below one."""
    plant = problem.at(level)
    if plant is not None:
        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            search = RiccatiSearch(mapped(plant)[0], 0.0)
            return any(search.traded(share, search.own.norm) is not None for share in SHARES)
    return False
