"""The full-order law for the loop that a computer closes: that of the discrete plant of a level next to the lower bound.

The plant of a level (`synth/analysis/sampled_loop.py`) has the forces on their way among its states, and the noise of the
readings among its disturbances. So a discrete law for it knows the delay, the hold and the motion between samples. The norm of
its loop is computed exactly (`synth/analysis/sampled_norm.py`). Where that is not near the bound, the level moves there, and a
law is designed anew.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.printed import percent
from models.laws.linear import LinearLaw
from synth.analysis.lower_bound import LowerBound, SampledBound
from synth.analysis.sampled_loop import SampledDataProblem
from synth.analysis.sampled_norm import sampled_norm
from synth.design.full_order.full_order import discrete_law, full_order_design
from synth.plant.discrete import mapped
from synth.plant.numerics import DesignError, InfeasibleError, numerics

WITHIN = 1e-3  # relative; so close to what no controller beats, nothing is left to gain
ABOVE = 1e-4  # relative; how far above a bound within a period the first level is
ROUNDS = 4  # levels at which a law is designed, at most
FAR = 1e3  # times where the search for a level starts


@dataclass(frozen=True, eq=False)
class SampledFullOrderDesign:
    """A discrete law for the loop that a computer closes.

    Attributes:
        law: discrete, from the readings to the forces.
        norm: the L2 gain of its loop, exact.
        remark: distance from the bound, in words; empty if it is within `WITHIN`.
    """

    law: LinearLaw
    norm: float
    remark: str


def law_gain(law: LinearLaw) -> Array:
    """Returns [D, C; B, A] of a law, for `SampledDataProblem.loop`."""
    return np.block([[law.D, law.C], [law.B, law.A]])


@numerics()
def sampled_full_order(
    problem: SampledDataProblem, bound: SampledBound | None, near: float, states: Sequence[str] = (), stable: bool = False
) -> SampledFullOrderDesign:
    """Designs a law within 0.1 % of what no controller beats, or the nearest that was found.

    Args:
        bound: lower bound of the loop; None if none is proved.
        near: a level to start from without a bound.
        states: names of the plant's states, for messages.
        stable: True for a law that is stable by itself.

    Raises:
        InfeasibleError: the plant cannot be stabilised from what is measured; the message names the mode.
        DesignError: no law was found.
    """
    best: SampledFullOrderDesign | None = None
    failure: Exception | None = None
    goal = bound.level if bound is not None else 0.0
    level = goal * (1 + ABOVE * bound.inside) if bound is not None else near
    names = (*states, *(f"force_{k + 1}_of_{problem.remembered}_before" for k in range(problem.remembered))) if states else ()
    for _ in range(ROUNDS):
        plant = problem.at(level)
        if plant is None:
            level *= 1.1
            continue
        Dyw = problem.Dyw(level)
        below = bound.proof if bound is not None and level == bound.level else LowerBound(goal / level)
        where = mapped(plant, problem.rows, Dyw)

        def as_run(law: LinearLaw, where=where) -> LinearLaw:
            return discrete_law(law, where, problem.period) if law.sample_period is None else law

        try:
            law = full_order_design(plant, problem.rows, Dyw, below, names, stable=stable, as_run=as_run).law
            norm = sampled_norm(problem.loop(law_gain(law)), level).value
        except InfeasibleError:
            raise
        except (DesignError, InputError, np.linalg.LinAlgError) as error:
            failure, level = error, level * 1.01
            continue
        if not np.isfinite(norm):
            level *= 1.01
            continue
        if best is None or norm < best.norm:
            best = SampledFullOrderDesign(law, norm, "")
        if best.norm <= goal * (1 + WITHIN) or norm <= level * (1 + WITHIN / 10):
            break
        level = norm
    if best is None:
        raise DesignError(str(failure) if failure else "no law was found whose sampled loop is stable")
    if goal and best.norm <= goal * (1 + WITHIN):
        return best
    above = f"{percent(best.norm / goal - 1)} above the lower bound of the sampled loop" if goal else "no lower bound is proved"
    return SampledFullOrderDesign(best.law, best.norm, f"{above}: none of the laws that were tried comes nearer")
