"""Search for the lower bound of a sampled-data loop: the highest level for which no controller reaches a norm below 1.

Each level of the L2 gain has an equivalent discrete plant (`synth/analysis/sampled_loop.py`). For controllers that act at the
samples, the L2 gain is below the level if and only if the l2 gain with this plant is below 1. Delayed forces are states of the
discrete plant, and the measurement noise is one of its disturbances. If no controller of any order reduces the norm of the
discrete plant below 1, the level is a lower bound on the L2 gain.
"""

import contextlib
import math

from models.common.errors import InputError
from synth.analysis.lower_bounds.lower_bound import LowerBound, SampledBound
from synth.analysis.sampled_loop import SampledDataProblem
from synth.lmi.full_order_bound import find_lower_bound
from synth.plant.numerics import numerics

AIM = 3e-7  # the search aims at a level for which the plant has a bound that exceeds 1 by this relative amount
ENOUGH = 1e-6  # the search ends if its level is within this relative distance of the highest proved level
ROUNDS = 40  # largest number of iterations; most searches need about five


@numerics()
def find_sampled_bound(problem: SampledDataProblem, near: float) -> SampledBound | None:
    """Returns the highest level that is proved to be a lower bound on the L2 gain; None if no level is proved.

    Args:
        problem: sampled-data design problem, whose plant includes held and delayed forces.
        near: level at which the search starts, such as the lower bound of the ideal loop.
    """
    below, above, level, best = 0.0, math.inf, near, None
    last: tuple[float, float] | None = None
    for _ in range(ROUNDS):
        plant = problem.at(level)
        if plant is None:  # within one sample period, the gain reaches the level before a force can respond
            reached, discrete = math.inf, LowerBound(0.0)
        else:
            discrete = LowerBound(0.0)
            # close to this level, the discrete plant cannot be converted to a continuous plant
            with contextlib.suppress(InputError):
                discrete = find_lower_bound(plant)
            reached = discrete.gamma
        bound = SampledBound(level, discrete, inside=plant is None)
        if bound.holds:
            below, best = level, bound
        else:
            above = level
        if bound.holds and (reached <= 1 + ENOUGH or above <= below * (1 + ENOUGH)):
            return best
        if above <= below * (1 + ENOUGH / 10) or above < near / 1e6:
            return best
        there = (math.log(level), math.log(reached / (1 + AIM))) if 0 < reached < math.inf else None
        slope = (there[1] - last[1]) / (there[0] - last[0]) if there and last and there[0] != last[0] else -1.0
        level = math.exp(there[0] - there[1] / slope) if there and slope < 0 else math.nan
        if not below < level < above:
            level = 2 * below if math.isinf(above) else math.sqrt(below * above) if below else above / 2
        last = there
    return best
