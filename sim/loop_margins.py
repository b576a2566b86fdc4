"""The margins of a loop, predicted from its transfer function and found in MuJoCo."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.reality import Implementation
from models.vehicle import Vehicle
from sim.bisection import Search, run_searches
from sim.growth import Trial, grow, silent
from sim.linear import taylor4
from sim.loop import Margins, cut, margins, sampled_gain_crossings
from synth.controller import Controller

SLOWEST = 2.0  # s; the longest delay and sample period that are tried where none is predicted to matter
AMPLE = 32.0  # the largest gain that is tried where none is predicted to matter, not even for a sampled loop
AGREES = 5e-3  # relative, of a gain


@dataclass(frozen=True, eq=False)
class LoopMargins:
    """The margins of one loop, predicted and found.

    Attributes:
        predicted: from the loop transfer function.
        sampled_gain: the gain margin predicted for the sampled loop, as RK4 integrates it; infinite where it has none.
        gain, gain_lower, delay, sample_period: the searches.
        timestep: of the physics [s].
        bears: whether at half the timestep physics bears half as much gain again as it does at this one; None where not asked.
    """

    predicted: Margins
    sampled_gain: float
    gain: Search
    gain_lower: Search
    delay: Search
    sample_period: Search
    timestep: float
    bears: bool | None = None

    @property
    def found_gain(self) -> float:
        """A gain margin that grows as the timestep shrinks is the sampling's: the loop's own is infinite."""
        return math.inf if self.bears else self.gain.found

    @property
    def found_gain_lower(self) -> float:
        """The largest factor below 1 that grows; 0 where none does."""
        return 1 / self.gain_lower.found if math.isfinite(self.gain_lower.unstable) else 0.0

    @property
    def found_sample_period(self) -> float:
        """The longest sample period before the first that grows [s]."""
        return self.sample_period.unstable - self.timestep

    @property
    def found_phase(self) -> float:
        """What the delay makes of phase at the crossover [rad]."""
        if math.isinf(self.delay.unstable):
            return math.inf
        return self.delay.unstable * self.predicted.frequency

    @property
    def agrees(self) -> bool:
        """Whether every margin is found where it is predicted: a gain to 0.5 %, a delay and a sample period to a timestep."""
        checks = [
            _close(self.predicted.gain, self.found_gain, AGREES * self.predicted.gain),
            _close(self.predicted.gain_lower, self.found_gain_lower, AGREES * self.predicted.gain_lower),
            _close(self.sampled_gain, self.gain.found, AGREES * self.sampled_gain),
            _close(self.predicted.delay, self.delay.unstable, self.timestep),
            _close(self.predicted.sample_period, self.found_sample_period, self.timestep),
        ]
        return all(checks)


def _close(predicted: float, found: float, within: float) -> bool:
    return predicted == found or abs(predicted - found) <= within  # inf - inf is NaN, which is not


def find_margins(
    vehicle: Vehicle, controller: Controller, timestep: float, progress: Callable[[str], None] = silent, each: bool = True
) -> dict[str, LoopMargins]:
    """The margins of all loops at once, under ""; and, if asked for, of each with the others closed, by actuator."""
    names = vehicle.linear_model.inputs
    loops = {"": list(range(len(names)))}
    if each and len(names) > 1:
        loops |= {name: [i] for i, name in enumerate(names)}
    cuts = [searches(vehicle, controller, actuators, timestep) for actuators in loops.values()]
    return dict(zip(loops, find_all(cuts, timestep, progress), strict=True))


def find_all(loops: Sequence[LoopMargins], timestep: float, progress: Callable[[str], None] = silent) -> list[LoopMargins]:
    """Runs the searches of any loops, of several controllers too, to their ends: those of one round in one batch."""
    run_searches([s for one in loops for s in (one.gain, one.gain_lower, one.delay, one.sample_period)], timestep, progress)
    # Where only the sampling ends the gain, half the timestep lets it go twice as far. A loop's own end stays where it is.
    doubtful = [i for i, one in enumerate(loops) if math.isinf(one.predicted.gain) and math.isfinite(one.gain.unstable)]
    still = grow([loops[i].gain.trial(1.5 * loops[i].gain.found) for i in doubtful], timestep / 2) if doubtful else []
    bears = {i: not one.grows for i, one in zip(doubtful, still, strict=True)}
    return [replace(one, bears=bears[i]) if i in bears else one for i, one in enumerate(loops)]


def searches(vehicle: Vehicle, controller: Controller, actuators: Sequence[int], timestep: float) -> LoopMargins:
    """The predicted margins of the loop cut at some actuators, and the searches for them, not yet run."""
    loop = cut(vehicle, controller, actuators)
    predicted = margins(loop)
    mine = np.isin(np.arange(len(controller.gain)), actuators)[:, None]

    def with_gain(factor: float) -> Trial:
        return Trial(vehicle, replace(controller, gain=np.where(mine, factor, 1.0) * controller.gain))

    def built(how: Implementation) -> Trial:
        cut_out, rest = (replace(controller, gain=np.where(part, controller.gain, 0.0)) for part in (mine, ~mine))
        return Trial(replace(vehicle, implementation=how), cut_out, rest if np.any(rest.gain) else None)

    sampled = sampled_gain_crossings(loop, timestep, taylor4)
    upper = min((factor for factor in sampled if factor > 1), default=math.inf)
    lower = max((factor for factor in sampled if factor < 1), default=0.0)
    late = max(predicted.delay - timestep / 2, timestep)  # half a sample is in the hold
    return LoopMargins(
        predicted=predicted,
        sampled_gain=upper,
        gain=Search(with_gain, upper, most=AMPLE),
        gain_lower=Search(lambda amount: with_gain(1 / amount), 1 / lower if lower else math.inf, most=AMPLE),
        delay=Search(lambda amount: built(Implementation(delay=round(amount / timestep))), late, most=SLOWEST, step=timestep),
        sample_period=Search(
            lambda amount: built(Implementation(sample_period=amount)), predicted.sample_period, most=SLOWEST, step=timestep
        ),
        timestep=timestep,
    )
