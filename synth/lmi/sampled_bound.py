"""The search for the lower bound of a sampled loop: the highest level whose discrete plant no controller brings below 1.

For any controller at the samples, the L2 gain is below a level if and only if the l2 gain of the level's discrete plant is
below 1 (`synth/analysis/sampled_loop.py`). Forces on their way are states of that plant, and the noise of the readings is one of
its disturbances. So where no controller of any order brings the norm of that plant below 1, the level is a lower bound.
"""

import contextlib
import math

from models.common.errors import InputError
from synth.analysis.lower_bound import LowerBound, SampledBound
from synth.analysis.sampled_loop import SampledDataProblem
from synth.lmi.full_order_bound import find_lower_bound
from synth.plant.numerics import numerics

AIM = 3e-7  # relative; how far above 1 the bound of the level's plant is aimed at
ENOUGH = 1e-6  # relative; a level this close to the highest that is proved counts as it
ROUNDS = 40  # limit of a search, which takes five or so


@numerics()
def find_sampled_bound(problem: SampledDataProblem, near: float) -> SampledBound | None:
    """Returns the highest level that is proved to be a lower bound; None if none is.

    Args:
        near: a level to start from, such as the lower bound of the ideal loop.
    """
    below, above, level, best = 0.0, math.inf, near, None
    last: tuple[float, float] | None = None
    for _ in range(ROUNDS):
        plant = problem.at(level)
        if plant is None:  # no force answers within a period
            reached, discrete = math.inf, LowerBound(0.0)
        else:
            discrete = LowerBound(0.0)
            with contextlib.suppress(InputError):  # next to a level at which the plant has no image
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
