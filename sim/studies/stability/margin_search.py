"""The margins of a loop, predicted from its transfer function and found in MuJoCo."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.common.checks import Positive
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import Vehicle
from sim.linear.sampled_response import taylor4
from sim.runs.run import sample_times
from sim.studies.stability.bisection import Bisection, run_searches
from sim.studies.stability.growth_test import GONE, LONGEST, Trial, no_progress
from synth.controller.controller import Controller, check_fits
from synth.controller.loop_transfer import loop_transfer, sampled_loop_transfer
from synth.controller.open_loop import with_lag
from synth.controller.stability_margins import Margins, margins, sampled_gain_crossings

SLOWEST = 2.0  # s; the longest delay and sample period that are tried where none is predicted to matter
LATEST = 8.0  # s; a longer predicted delay is not run: it takes 24 times as long to grow, and more gigabytes than there are
AMPLE = 32.0  # the largest gain that is tried where none is predicted to matter, not even for a sampled loop
AGREES = 5e-3  # relative, of a gain; a search ends at 0.2 %, and what two of them tend to is known to 0.3 %
WITHOUT_END = 1.5  # times as much at half the step: it goes with the step's inverse, where a loop's own end stays


@dataclass(frozen=True, eq=False)
class GainMargin:
    """Gain margin of a loop, upwards or downwards, predicted and found; infinite if any factor is stable.

    Physics holds the force over a step, and so runs the sampled loop, whose margin tends to the loop's own with the first power
    of the timestep. If the margin found at one step is not the loop's own, half the step allows to extrapolate.

    Attributes:
        own: margin predicted for the loop itself, without sampling.
        sampled: margins predicted for the sampled loop, as RK4 integrates it, at the timestep and at half of it.
        search: search for the margin at the timestep.
        finer: search at half of the timestep; not run if it is not needed.
    """

    own: float
    sampled: tuple[float, float]
    search: Bisection
    finer: Bisection

    @property
    def doubtful(self) -> bool:
        """Returns True if the margin found at the timestep is not the loop's own."""
        return not _close(self.own, self.search.found, AGREES * self.own)

    @property
    def found(self) -> float:
        """Returns the margin extrapolated to timestep zero; infinite if it grows as the step shrinks, and so is the sampling's
        alone.
        """
        if not self.finer.tried:
            return self.search.found
        coarse, fine = self.search.found, self.finer.found
        return math.inf if fine > WITHOUT_END * coarse or math.isinf(fine) else 2 * fine - coarse

    @property
    def extrapolated(self) -> bool:
        """Returns True if the margin found is the limit of two runs' margins."""
        return bool(self.finer.tried) and math.isfinite(self.found)

    @property
    def agrees(self) -> bool:
        """Returns True if physics has the predicted margins, at each step that it ran with and extrapolated.

        The extrapolation is off by a second power of the step: by less than half of the change by halving.
        """
        tried = zip(self.sampled, (self.search, self.finer), strict=True)
        here = all(_close(at, search.found, AGREES * at) for at, search in tried if search.tried)
        moved = abs(self.finer.found - self.search.found) if self.finer.tried else 0.0
        return here and _close(self.own, self.found, max(moved / 2, AGREES * self.own))


@dataclass(frozen=True, eq=False)
class LoopMargins:
    """The margins of one loop, predicted and found.

    Attributes:
        predicted: margins from the loop transfer function.
        gain: search for the largest gain factor.
        gain_lower: search for the smallest factor, as its inverse.
        delay, sample_period: the searches.
        timestep: timestep of the physics [s].
        unseen: sample period from which the first sample after a bump misses it [s]; MuJoCo cannot confirm longer ones.
    """

    predicted: Margins
    gain: GainMargin
    gain_lower: GainMargin
    delay: Bisection
    sample_period: Bisection
    timestep: float
    unseen: float = math.inf

    @property
    def found_gain_lower(self) -> float:
        """The largest factor below 1 that grows; 0 where none does."""
        return 1 / self.gain_lower.found

    @property
    def found_sample_period(self) -> float:
        """The longest sample period before the first that grows [s]."""
        return self.sample_period.unstable - self.timestep if self.sample_period.decided else math.nan

    @property
    def sees_sample_period(self) -> bool:
        """Returns True if a run can confirm the predicted sample period: a sample sees what is left of the bump."""
        return math.isinf(self.predicted.sample_period) or self.predicted.sample_period < self.unseen

    @property
    def sees_delay(self) -> bool:
        """Returns True if runs are long enough to confirm the predicted delay."""
        return math.isinf(self.predicted.delay) or self.predicted.delay < LATEST

    @property
    def found_delay(self) -> float:
        """Smallest unstable delay [s]; infinite if all are stable, NaN if no run decides it."""
        seen = self.delay.decided and (self.sees_delay or math.isfinite(self.delay.unstable))
        return self.delay.unstable if seen else math.nan

    @property
    def found_phase(self) -> float:
        """Returns the phase of the found delay at the crossover [rad]."""
        return self.found_delay * self.predicted.frequency if math.isfinite(self.found_delay) else self.found_delay

    @property
    def agrees(self) -> bool:
        """Returns True if every margin is as predicted: a gain to 0.5 %, a delay and a sample period to a timestep.

        A sample period from `unseen` on agrees if no shorter one grows, and so does a delay that takes too long to run.
        """
        period = self.predicted.sample_period if self.sees_sample_period else math.inf
        return (
            self.gain.agrees
            and self.gain_lower.agrees
            and _close(self.predicted.delay, self.found_delay, self.timestep)
            and _close(period, self.found_sample_period, self.timestep)
        )


def _close(predicted: float, measured: float, within: float) -> bool:
    """Returns whether a margin is as predicted; NaN, which no run decides, contradicts nothing."""
    return predicted == measured or math.isnan(measured) or (math.isfinite(predicted) and abs(predicted - measured) <= within)


def find_margins(
    vehicle: Vehicle, controller: Controller, timestep: Positive, progress: Callable[[str], None] = no_progress
) -> dict[str, LoopMargins]:
    """Returns gain and delay margins and the largest sample period, as predicted and as found in MuJoCo.

    Args:
        vehicle: the vehicle; its `[implementation]` is ignored.
        controller: controller whose loop is stable.
        timestep: MuJoCo's timestep [s].
        progress: callback that receives a line on the progress.

    Returns:
        The margins of all loops together under ""; if there are several, also of each loop by its force, with the others closed.

    Raises:
        InputError: the controller is another vehicle's, or the timestep is not allowed.

    Example:
        >>> from models import read_vehicle
        >>> from sim import find_margins
        >>> from synth import design_controllers
        >>> vehicle = read_vehicle("quarter_car")
        >>> [controller] = design_controllers(vehicle, ["II"])
        >>> margins = find_margins(vehicle, controller, timestep=2e-3)
        >>> f"delay {margins[''].predicted.delay:.3f} s predicted, {margins[''].delay.unstable:.3f} s found"
        'delay 0.087 s predicted, 0.088 s found'
    """
    check_fits(vehicle, controller)
    sample_times(vehicle, LONGEST, timestep)
    names = vehicle.linear_model.inputs
    loops = {"": list(range(len(names)))}
    if len(names) > 1:
        loops |= {name: [i] for i, name in enumerate(names)}
    margins = {name: searches(vehicle, controller, actuators, timestep) for name, actuators in loops.items()}
    find_all(list(margins.values()), timestep, progress)
    return margins


def find_all(loops: Sequence[LoopMargins], timestep: float, progress: Callable[[str], None] = no_progress) -> None:
    """Runs the searches of any loops, of several controllers too, to their ends: those of one round in one batch."""
    gains = [gain for one in loops for gain in (one.gain, one.gain_lower)]
    others = [search for one in loops for search in (one.delay, one.sample_period)]
    run_searches([*(gain.search for gain in gains), *others], timestep, progress)
    run_searches([gain.finer for gain in gains if gain.doubtful], timestep / 2, progress)


def searches(vehicle: Vehicle, controller: Controller, actuators: Sequence[int], timestep: float) -> LoopMargins:
    """The predicted margins of the loop cut at some actuators, and the searches for them, not yet run."""
    loop = loop_transfer(vehicle, controller, actuators)
    predicted = margins(loop)
    mine = np.isin(np.arange(len(vehicle.linear_model.inputs)), actuators)

    def with_gain(factor: float) -> Trial:
        return Trial(vehicle, replace(controller, law=controller.law.scaled(np.where(mine, factor, 1.0))))

    def gain_margin(trial: Callable[[float], Trial], own: float, power: int) -> GainMargin:
        # A factor to this power is an amount above 1: how many times more gain, or how many times less.
        coarse, fine = (min((factor**power for factor in factors if factor**power > 1), default=math.inf) for factors in sampled)
        return GainMargin(own, (coarse, fine), Bisection(trial, coarse, most=AMPLE), Bisection(trial, fine, most=AMPLE))

    def sampled_at(period: float) -> Trial:
        how = Implementation(sample_period=period)
        return Trial(replace(vehicle, implementation=how), controller) if predicted.all_sampled else built(how)

    def built(how: Implementation) -> Trial:
        cut_out, rest = (replace(controller, law=controller.law.only(part)) for part in (mine, ~mine))
        return Trial(replace(vehicle, implementation=how), cut_out, rest if rest.law.acts else None)

    sampled = [
        sampled_gain_crossings(*sampled_loop_transfer(vehicle, controller, step, actuators, taylor4))
        for step in (timestep, timestep / 2)
    ]
    delay = predicted.delay if predicted.delay < LATEST else math.inf
    late = max(delay - timestep / 2, timestep)  # half a sample is in the hold
    unseen = _unseen(with_lag(vehicle).A if mine.all() else loop.A)
    period = predicted.sample_period if predicted.sample_period < unseen else math.inf
    return LoopMargins(
        predicted=predicted,
        gain=gain_margin(with_gain, predicted.gain, 1),
        gain_lower=gain_margin(
            lambda amount: with_gain(1 / amount), 1 / predicted.gain_lower if predicted.gain_lower else math.inf, -1
        ),
        delay=Bisection(lambda amount: built(Implementation(delay=round(amount / timestep))), late, most=SLOWEST, step=timestep),
        sample_period=Bisection(sampled_at, period, most=SLOWEST, step=timestep),
        timestep=timestep,
        unseen=unseen,
    )


def _unseen(A: Array) -> float:
    """Returns the time after which nothing is left of a bump without the controller [s]; infinite if its motion stays."""
    rate = -float(np.linalg.eigvals(A).real.max())
    return -math.log(GONE) / (2 * rate) if rate > 0 else math.inf
