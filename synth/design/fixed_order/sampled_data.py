"""A law of a given order or structure for the loop that a computer closes: by descent on the discrete plants of falling levels.

As in `full_order/sampled_data.py`, every level of the loop's L2 gain has a discrete plant, and the norm of the loop is exact.
The first law is sought at a level near the lower bound. Further descents start from it, at the level that it has.
"""

from collections.abc import Sequence

import numpy as np

from models.common.printed import percent
from models.laws.law_structure import LawStructure
from models.laws.linear import LinearLaw
from synth.analysis.lower_bound import SampledBound
from synth.analysis.sampled_loop import SampledDataProblem
from synth.analysis.sampled_norm import sampled_norm
from synth.design.descent.landscape import Work
from synth.design.fixed_order.fixed_order import fixed_order_design
from synth.design.problem import DesignProblem, DesignResult, Progress
from synth.design.sampled_data import DESCENT_SAMPLED, SampledDesign, bound_of
from synth.design.static import bounded_work
from synth.plant.generalized import law_gain
from synth.plant.numerics import DesignError, InfeasibleError, numerics

NEAR = 1.1  # times the lower bound: the first level, where the plant of a level has a norm above one that says where to go
WORTH = 1e-4  # relative; a descent that gains less is the last
ROUNDS = 4  # levels, at most


@numerics()
def sampled_fixed_order(
    problem: SampledDataProblem,
    bound: SampledBound | None,
    near: float,
    states: Sequence[str],
    stable: bool,
    structure: LawStructure,
    work: Work | None = None,
) -> SampledDesign:
    """Designs a law of a structure for the sampled loop; arguments as for `sampled_full_order`.

    Args:
        work: counts the norms of all descents; `bounded_work` if it is not given.

    Raises:
        InputError: the order is more than the plant's.
        InfeasibleError: no such law stabilises the loop; the message names the mode.
        DesignError: no law was found.
    """
    goal = bound.level if bound is not None else 0.0
    level, law, remark, norm, failure = NEAR * (goal or near), None, "", np.inf, None
    names = (*states, *(f"force_{k + 1}_of_{problem.remembered}_before" for k in range(problem.remembered))) if states else ()
    work = bounded_work(problem.plant) if work is None else work
    for _ in range(ROUNDS):
        if work.over:
            break
        plant = problem.at(level)
        if plant is None:
            level *= NEAR
            continue
        try:
            known: list[LinearLaw] = [] if law is None or structure.kind else [law]
            found = fixed_order_design(plant, structure, None, names, stable, known=known, work=work)
            reached = sampled_norm(problem.loop(law_gain(found.law)), level).value
        except InfeasibleError:
            raise
        except (DesignError, np.linalg.LinAlgError) as error:
            failure, level = error, level * NEAR
            continue
        enough = reached > norm * (1 - WORTH)
        if reached < norm:
            law, remark, norm = found.law, found.remark, reached
        if enough or not np.isfinite(reached):
            break
        level = norm
    if law is None:
        raise DesignError(str(failure) if failure else "no law with a stable sampled loop was found")
    remarks = [f"{percent(norm / goal - 1)} above the lower bound of the sampled loop" if goal else "no lower bound is proved"]
    return SampledDesign(law, norm, remark="; ".join([*remarks, *[remark] * bool(remark)]))


def sampled_structured(problem: DesignProblem, progress: Progress) -> DesignResult:
    """Designs a law of a given order or structure for the loop that a computer closes."""
    assert problem.sampled is not None, "a sampled loop"
    assert problem.structure is not None, "a structure"
    bound = bound_of(problem, problem.near)
    given = problem.sampled, bound, problem.near, problem.states, problem.stable, problem.structure, problem.work
    found, why = sampled_fixed_order(*given), f"for {problem.structure.text}"
    remarks, level = (found.remark,) if found.remark else (), None if bound is None else bound.level
    return found.result(problem, method=DESCENT_SAMPLED, why=why, remarks=remarks, sampled_lower_bound=level)
