"""The height of a bump at which the linear regime ends: predicted by one linear run, and enclosed by MuJoCo on both sides.

Before anything breaks the response is proportional to the height, so the height is one over the use per metre. A body that turns
for real leaves that a little, so what counts is what MuJoCo did: the highest bump that breaks nothing, and the next that does.

With adjustable dampers, and with curves, it is the end of the analysis that has them: dampers leave a linear controller short at
any height, and a curve is off its line a little before it counts as left.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.roads.road import LIMITS, Bump, RoadInput
from models.vehicle.vehicle import Vehicle
from sim.linear.dampers import is_linear
from sim.linear.sampled_response import sampled_response
from sim.linear.switched_response import switched_response
from sim.response.regime import DAMPER, DIVERGENCE, END_NAMES, LAW_OVERFLOW, REGIME_ENDS, utilisation
from sim.runs.run import run_controllers
from sim.studies.validity.regime_map import validity
from synth.controller.controller import Controller, has_anti_windup
from synth.controller.open_loop import LoopModel

# Factors on the predicted height, either way, within which the end is looked for: the first is how closely it is to be known,
# the second what a turning body makes of it, the third more than any vehicle should need.
REACHES = (1.001, 1.03, 4.0)
POINTS = 9  # heights that are run side by side


@dataclass(frozen=True)
class RegimeEnd:
    """End of the linear regime of one controller, over bumps of one length and speed.

    Attributes:
        predicted: height of the end by linear analysis [m].
        predicted_end: name of the predicted end in `REGIME_ENDS`.
        near: names of the ends within the second of `REACHES` of that height: a body that turns may meet another one first.
        stays: highest bump in MuJoCo without an end [m]; 0 if every bump had one.
        error: largest difference of that run from the analysis, over any signal's peak; 0 without such a run.
        leaves: lowest bump in MuJoCo with an end [m], or infinity.
        end: first end there, of `REGIME_ENDS`; empty without an end.
    """

    predicted: float
    predicted_end: str
    near: tuple[str, ...]
    stays: float
    error: float
    leaves: float
    end: str

    @property
    def confirmed(self) -> bool:
        """Returns True if MuJoCo has an end, and it is the predicted one, or one as near."""
        return self.end in self.near and self.stays > 0


def regime_end(vehicle: Vehicle, controller: Controller, bump: Bump, time: Array) -> RegimeEnd | None:
    """Returns the end of the linear regime over bumps of this length, speed and track, or None if no allowed height has one.

    Args:
        controller: controller whose loop is stable.
        bump: a bump of any height.
        time: equidistant sample times from 0 [s].
    """
    metre, short = replace(bump, height=1.0), not is_linear(vehicle, controller)
    road = RoadInput(vehicle.linearised, metre, time)
    alone = (
        switched_response(controller, [RoadInput(vehicle, metre, time)]).run(0)
        if short
        else sampled_response(LoopModel(road.vehicle, controller, road.timestep), road)
    )
    used = utilisation(vehicle, alone, has_anti_windup(controller))
    if short:
        used[REGIME_ENDS.index(DAMPER)] = 0.0
    if used.max() * LIMITS["height"][1] < REACHES[-1]:
        return None
    predicted = float(1 / used.max())

    near = tuple(end for end, use in zip(END_NAMES, used, strict=True) if use * REACHES[1] >= used.max())
    ends = RegimeEnd(predicted, END_NAMES[int(used.argmax())], near, stays=0.0, error=0.0, leaves=math.inf, end="")
    for reach in REACHES:
        heights = predicted * np.geomspace(1 / reach, reach, POINTS if reach > REACHES[0] else 2)
        ends = _narrowed(ends, vehicle, controller, bump, heights, time)
        if ends.stays > 0 and ends.end:
            break
    while ends.stays > 0 and ends.leaves - ends.stays > 2.01 * (REACHES[0] - 1) * predicted and ends.end:
        heights = np.linspace(ends.stays, ends.leaves, POINTS)[1:-1]
        ends = _narrowed(ends, vehicle, controller, bump, heights, time)
    if ends.stays > 0 and vehicle.is_curved and not short:  # a map knows how far it is from a linear response only
        (run,) = run_controllers(vehicle, [controller], replace(bump, height=ends.stays), time)
        ends = replace(ends, error=max(signal.sampled for signal in run.agreement.signals.values()))
    return ends


def _narrowed(ends: RegimeEnd, vehicle: Vehicle, controller: Controller, bump: Bump, heights: Array, time: Array) -> RegimeEnd:
    """Returns the end narrowed by runs of more heights, ascending [m]."""
    cells = validity(vehicle, controller, [replace(bump, height=height) for height in heights.tolist()], time, foretold=False)
    breaks = (cells.first >= 0) | np.isinf(cells.error)
    first = int(breaks.argmax()) if breaks.any() else len(heights)
    if first > 0 and heights[first - 1] > ends.stays:
        ends = replace(ends, stays=float(heights[first - 1]), error=float(cells.error[first - 1]))
    if first < len(heights) and heights[first] < ends.leaves:
        end = END_NAMES[cells.first[first]] if cells.first[first] >= 0 else LAW_OVERFLOW if cells.ran_away[first] else DIVERGENCE
        ends = replace(ends, leaves=float(heights[first]), end=end)
    return ends
