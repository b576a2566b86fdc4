"""The margins of a loop, predicted from its transfer function and found in MuJoCo (`edge.py`)."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.common.checks import Positive
from models.roads.road import Bump
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import Vehicle
from sim.linear.sampled_response import taylor4
from sim.physics.step_derivative import StepDerivative, step_derivative
from sim.runs.run import sample_times
from sim.studies.stability.edge import SLOWEST, StabilityEdge, no_progress, search_and_run, smallest_unstable
from sim.studies.stability.simulated_loop import Trial
from synth.controller.controller import Controller, check_fits
from synth.controller.loop_transfer import loop_transfer
from synth.controller.open_loop import LoopModel
from synth.controller.stability_margins import Margins, margins, sampled_gain_crossings, sampled_margins

BUMP = Bump(height=2e-5, length=20.0, speed=100.0, track="left")  # of recorded runs: soon over, lifts no wheel
LONGEST = 2.0  # s; the longest delay and sample period that are tried where none is predicted to matter
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
    search: StabilityEdge
    finer: StabilityEdge

    @property
    def tried(self) -> list[tuple[float, StabilityEdge]]:
        """Returns the searches that were run, each with the margin predicted for the sampled loop at its timestep."""
        return [(at, one) for at, one in zip(self.sampled, (self.search, self.finer), strict=True) if one.searched]

    @property
    def doubtful(self) -> bool:
        """Returns True if the margin found at the timestep is not the loop's own."""
        return not _close(self.own, self.search.found, AGREES * self.own)

    @property
    def found(self) -> float:
        """Returns the margin extrapolated to timestep zero; infinite if it grows as the step shrinks, and so is the sampling's
        alone.
        """
        if not self.finer.searched:
            return self.search.found
        coarse, fine = self.search.found, self.finer.found
        return math.inf if fine > WITHOUT_END * coarse or math.isinf(fine) else 2 * fine - coarse

    @property
    def extrapolated(self) -> bool:
        """Returns True if the margin found is the limit of two runs' margins."""
        return self.finer.searched and math.isfinite(self.found)

    @property
    def agrees(self) -> bool:
        """Returns True if physics has the predicted margins, at each step that it ran with and extrapolated.

        The extrapolation is off by a second power of the step: by less than half of the change by halving.
        """
        here = all(_close(at, search.found, AGREES * at) and search.confirmed for at, search in self.tried)
        moved = abs(self.finer.found - self.search.found) if self.finer.searched else 0.0
        return here and _close(self.own, self.found, max(moved / 2, AGREES * self.own))


@dataclass(frozen=True, eq=False)
class LoopMargins:
    """The margins of one loop, predicted and found.

    Attributes:
        predicted: margins from the loop transfer function.
        gain: search for the largest gain factor.
        gain_lower: search for the smallest factor, as its inverse.
        delay: search for the delay; beyond its own for an implemented loop.
        sample_period: search for the sample period; not run for an implemented loop.
        timestep: timestep of the physics [s].
        predicted_delay: smallest unstable delay of the linear loop [s].
    """

    predicted: Margins
    gain: GainMargin
    gain_lower: GainMargin
    delay: StabilityEdge
    sample_period: StabilityEdge
    timestep: float
    predicted_delay: float

    @property
    def found_gain_lower(self) -> float:
        """The largest factor below 1 that grows; 0 where none does."""
        return 1 / self.gain_lower.found

    @property
    def found_sample_period(self) -> float:
        """Returns the longest period before the first that grows [s]; infinite if all are stable, NaN if no run decides it."""
        edge = self.sample_period
        return edge.unstable - self.timestep if _is_seen(edge, self.predicted.sample_period) else math.nan

    @property
    def found_delay(self) -> float:
        """Smallest unstable delay [s]; infinite if all are stable, NaN if no run decides it."""
        return self.delay.unstable if _is_seen(self.delay, self.predicted_delay) else math.nan

    @property
    def found_phase(self) -> float:
        """Returns the phase of the found delay at the crossover [rad]."""
        return self.found_delay * self.predicted.frequency if math.isfinite(self.found_delay) else self.found_delay

    @property
    def agrees(self) -> bool:
        """Returns True if every margin is as predicted: a gain to 0.5 %, a delay and a sample period to a timestep."""
        return (
            self.gain.agrees
            and self.gain_lower.agrees
            and self.delay.confirmed
            and self.sample_period.confirmed
            and _close(self.predicted_delay, self.found_delay, self.timestep)
            and _close(self.predicted.sample_period, self.found_sample_period, self.timestep)
        )


def _is_seen(edge: StabilityEdge, predicted: float) -> bool:
    """Returns True if an edge was searched and runs decide it: they are long enough for what is predicted [s]."""
    within = math.isinf(predicted) or predicted < SLOWEST or math.isfinite(edge.unstable)
    return edge.searched and edge.decided and within


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
    margins = {name: searches(vehicle, controller, actuators, timestep) for name, actuators in loops_of(vehicle).items()}
    find_all(list(margins.values()), progress)
    return margins


def loops_of(vehicle: Vehicle) -> dict[str, list[int]]:
    """Returns the actuators of all loops together, under "", and of each loop of several, by its force."""
    names = vehicle.linear_model.inputs
    return {"": list(range(len(names)))} | ({name: [i] for i, name in enumerate(names)} if len(names) > 1 else {})


def find_all(loops: Sequence[LoopMargins], progress: Callable[[str], None] = no_progress) -> None:
    """Runs the searches of any loops, of several controllers too, with the runs of a timestep in one batch."""
    gains = [gain for one in loops for gain in (one.gain, one.gain_lower)]
    others = [search for one in loops for search in (one.delay, one.sample_period) if search.most]
    search_and_run([*(gain.search for gain in gains), *others], progress)
    search_and_run([gain.finer for gain in gains if gain.doubtful], progress)


def searches(vehicle: Vehicle, controller: Controller, actuators: Sequence[int], timestep: float) -> LoopMargins:
    """The predicted margins of the loop cut at some actuators, and the searches for them, not yet run."""
    predicted = margins(loop_transfer(vehicle, controller, actuators))
    mine = np.isin(np.arange(len(vehicle.linear_model.inputs)), actuators)
    cut_out, rest = (replace(controller, law=controller.law.only(part)) for part in (mine, ~mine))
    loop = cut_out, rest if rest.law.acts else None
    steps = step_derivative(vehicle, timestep), step_derivative(vehicle, timestep / 2)

    def delayed(amount: float) -> Trial:
        return Trial(replace(vehicle, implementation=Implementation(delay=round(amount / timestep))), *loop)

    def sampled_at(period: float) -> Trial:
        on = replace(vehicle, implementation=Implementation(sample_period=period))
        return Trial(on, controller) if predicted.all_sampled else Trial(on, *loop)

    prompt = replace(vehicle, implementation=Implementation())
    loops = [LoopModel(prompt, controller, step.timestep, taylor4) for step in steps]
    sampled = [sampled_gain_crossings(*loop.cut(actuators)) for loop in loops]
    late = max(predicted.delay - timestep / 2, timestep)  # half a sample is in the hold
    period = predicted.sample_period
    return LoopMargins(
        predicted,
        *_gain_margins(vehicle, controller, mine, predicted, steps, sampled),
        delay=StabilityEdge(steps[0], delayed, late if late < SLOWEST else math.inf, LONGEST, timestep),
        sample_period=StabilityEdge(steps[0], sampled_at, period if period < SLOWEST else math.inf, LONGEST, timestep),
        timestep=timestep,
        predicted_delay=predicted.delay,
    )


def implemented_searches(vehicle: Vehicle, controller: Controller, actuators: Sequence[int], timestep: float) -> LoopMargins:
    """Returns the same for the loop with its sample period and delay. The delay is searched if the loop is cut at all actuators.

    Raises:
        InputError: the sample period or the delay is not a multiple of the timestep.
    """
    how = vehicle.implementation.without_noise
    loop = LoopModel(replace(vehicle, implementation=how), controller, timestep)
    mine = np.isin(np.arange(len(vehicle.linear_model.inputs)), actuators)
    predicted = sampled_margins(*loop.cut(actuators), loop.period)
    step = step_derivative(replace(vehicle, implementation=Implementation()), timestep)

    def later(amount: float) -> Trial:
        steps = round(how.delay * loop.steps) + round(amount / timestep)
        return Trial(replace(vehicle, implementation=replace(how, delay=steps / loop.steps)), controller)

    def grows(amount: float) -> bool:
        return LoopModel(later(amount).vehicle, controller, timestep).radius > 1

    late = math.inf  # the hold is not delayed as a phase is: near half the sample rate, that is not the same
    if mine.all() and predicted.delay < SLOWEST:
        late = smallest_unstable(grows, predicted.delay, LONGEST, timestep)[1]
    factors = [factor for factor in (predicted.gain, predicted.gain_lower) if 0 < factor < math.inf]
    return LoopMargins(
        predicted,
        *_gain_margins(loop.vehicle, controller, mine, predicted, (step, step), [factors, factors]),
        delay=StabilityEdge(step, later, late - timestep / 2, LONGEST if mine.all() else 0.0, timestep),
        sample_period=StabilityEdge(step, later, math.inf, 0.0),
        timestep=timestep,
        predicted_delay=late if math.isfinite(late) else predicted.delay,
    )


def _gain_margins(
    vehicle: Vehicle,
    controller: Controller,
    mine: Array,
    predicted: Margins,
    steps: tuple[StepDerivative, StepDerivative],
    sampled: Sequence[Sequence[float]],
) -> Iterator[GainMargin]:
    """Yields the gain margin of some forces and the lower one; `sampled` has the factors at which the sampled loops change."""

    def with_gain(factor: float) -> Trial:
        return Trial(vehicle, replace(controller, law=controller.law.scaled(np.where(mine, factor, 1.0))))

    for power, own in ((1, predicted.gain), (-1, predicted.gain_lower)):
        # A factor to this power is an amount above 1: how many times more gain, or how many times less.
        coarse, fine = (min((factor**power for factor in factors if factor**power > 1), default=math.inf) for factors in sampled)
        pairs = zip(steps, (coarse, fine), strict=True)
        ends = (StabilityEdge(step, lambda amount, k=power: with_gain(amount**k), at, AMPLE) for step, at in pairs)
        yield GainMargin(own**power if own else math.inf, (coarse, fine), *ends)
