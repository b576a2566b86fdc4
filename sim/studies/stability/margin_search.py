"""The margins of a loop, predicted from its transfer function and found in MuJoCo (`edge.py`)."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from models.common.checks import PositiveTime
from models.roads.road import Bump
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import Vehicle
from sim.linear.sampled_response import taylor4
from sim.runs.run import sample_times
from sim.studies.stability.delayed import slowest_from_sample_to_sample
from sim.studies.stability.edge import SLOWEST, StabilityEdge, no_progress, search_and_run, smallest_unstable
from sim.studies.stability.simulated_loop import LoopCase
from sim.studies.stability.step_derivative import step_derivative
from synth.controller.controller import Controller, check_fits
from synth.controller.loop_of import loop_of, radius
from synth.controller.sample_period_margin import sampled_growth_at, sampled_part
from synth.controller.stability_margins import LARGEST_FACTOR, Margins, gain_crossings, margins
from synth.plant.state_space import StateSpace

BUMP = Bump(height=2e-5, length=20.0, speed=100.0, track="left")  # of recorded runs: soon over, lifts no wheel
LONGEST = 2.0  # s; the longest delay and sample period that are tried where none is predicted to matter
AGREES = 5e-3  # relative, of a gain; a search ends at 0.2 %, and what two of them tend to is known to 0.3 %
ENDS = 1.5e-3  # relative, of a gain found, so that twice the one minus another is known to 0.3 %
HALVINGS = 9  # of the timestep; runs at finer steps take minutes
WITHOUT_END = 1.5  # times as much at half the step: it goes with the step's inverse, where a loop's own end stays


@dataclass(frozen=True, eq=False)
class GainMargin:
    """Gain margin of a loop, upwards or downwards, predicted and found; infinite if any factor is stable.

    Physics holds the force over a step, and so runs the sampled loop, whose margin tends to the loop's own with the first power
    of the timestep, once the step is small enough. If the margin found at one step is not the loop's own, two steps, the second
    half of the first, allow to extrapolate. `at_prediction` chooses them.

    Attributes:
        own: margin predicted for the loop itself, without sampling.
        sampled: margins predicted for the sampled loop, as RK4 integrates it, at the timesteps of the searches.
        search: search for the margin at the timestep.
        finer: search at half of the timestep, or at a smaller step; not run if it is not needed.
        coarser: search at twice the step of `finer`; None if that is `search`.
    """

    own: float
    sampled: tuple[float, ...]
    search: StabilityEdge
    finer: StabilityEdge
    coarser: StabilityEdge | None = None

    @classmethod
    def at_prediction(
        cls,
        own: float,
        sampled: Callable[[float], float],
        timestep: float,
        derivative: Callable[[float], StateSpace],
        trial: Callable[[float], LoopCase],
        most: float,
    ) -> "GainMargin":
        """Returns a margin with its searches, not yet run, at the timestep and at finer ones that show the loop's own.

        Args:
            own: margin predicted for the loop itself.
            sampled: timestep -> margin predicted for the sampled loop.
            timestep: timestep of the physics [s].
            derivative: timestep -> derivative of MuJoCo's step.
            trial, most: see `StabilityEdge`.
        """
        steps = [timestep, timestep / 2]
        amounts = [sampled(step) for step in steps]
        while len(steps) <= HALVINGS and not cls.shown_by(own, *amounts[-2:]):
            steps.append(steps[-1] / 2)
            amounts.append(sampled(steps[-1]))
        tried = sorted({0, len(steps) - 2, len(steps) - 1})
        search, *coarser, finer = (StabilityEdge(derivative(steps[i]), trial, amounts[i], most) for i in tried)
        return cls(own, tuple(amounts[i] for i in tried), search, finer, *coarser)

    @property
    def searches(self) -> tuple[StabilityEdge, ...]:
        """The searches by decreasing timestep."""
        return (self.search, self.finer) if self.coarser is None else (self.search, self.coarser, self.finer)

    @property
    def tried(self) -> list[tuple[float, StabilityEdge]]:
        """Returns the searches that were run, each with the margin predicted for the sampled loop at its timestep."""
        return [(at, one) for at, one in zip(self.sampled, self.searches, strict=True) if one.searched]

    @staticmethod
    def limit(coarse: float, fine: float) -> float:
        """Returns the margin at timestep zero from those at a step and at half of it; infinite if it grows without end."""
        return math.inf if fine > WITHOUT_END * coarse or math.isinf(fine) else 2 * fine - coarse

    @staticmethod
    def shown_by(own: float, coarse: float, fine: float) -> bool:
        """Returns True if margins of the sampled loop at a step and at half of it allow to extrapolate to the loop's own."""
        within = max(abs(fine - coarse) / 2, AGREES * own)
        return all(_close(own, GainMargin.limit(coarse, share * fine), within) for share in (1 - ENDS, 1 + ENDS))

    @property
    def doubtful(self) -> bool:
        """Returns True if the margin found at the timestep is not the loop's own."""
        return not _close(self.own, self.search.found, AGREES * self.own)

    @property
    def found(self) -> float:
        """Returns the margin extrapolated to timestep zero; infinite if it grows as the step shrinks, and so is the sampling's
        alone; NaN if it still grows at the smallest step, towards a larger one of the loop's own.
        """
        if not self.finer.searched:
            return self.search.found
        if self.sampled[-1] < self.own < math.inf and math.isinf(self.limit(*self.sampled[-2:])):
            return math.nan
        return self.limit(*(one.found for one in self.searches[-2:]))

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
        coarse, fine = (one.found for one in self.searches[-2:])
        moved = abs(fine - coarse) if self.finer.searched else 0.0
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
        late_grows, slow_grows: delay or sample period, a multiple of the timestep [s] -> True if the linear loop is unstable.
    """

    predicted: Margins
    gain: GainMargin
    gain_lower: GainMargin
    delay: StabilityEdge
    sample_period: StabilityEdge
    timestep: float
    predicted_delay: float
    late_grows: Callable[[float], bool] | None = None
    slow_grows: Callable[[float], bool] | None = None

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
            and (_close(self.predicted_delay, self.found_delay, self.timestep) or _passed_over(self.delay, self.late_grows))
            and (
                _close(self.predicted.sample_period, self.found_sample_period, self.timestep)
                or _passed_over(self.sample_period, self.slow_grows)
            )
        )


def _passed_over(edge: StabilityEdge, grows: Callable[[float], bool] | None) -> bool:
    """Returns True if the linear loop, too, is unstable as late as MuJoCo at multiples of the timestep.

    The loop is then unstable where it is predicted to be, but for less than a timestep.
    """
    if grows is None or not edge.unstable > edge.expected:
        return False
    return edge.unstable == smallest_unstable(grows, edge.expected, edge.most, edge.multiple)[1]


def _is_seen(edge: StabilityEdge, predicted: float) -> bool:
    """Returns True if an edge was searched and runs decide it: they are long enough for what is predicted [s]."""
    within = math.isinf(predicted) or predicted < SLOWEST or math.isfinite(edge.unstable)
    return edge.searched and edge.decided and within


def _close(predicted: float, measured: float, within: float) -> bool:
    """Returns whether a margin is as predicted; NaN, which no run decides, contradicts nothing."""
    return predicted == measured or math.isnan(measured) or abs(predicted - measured) <= within < math.inf


def find_margins(
    vehicle: Vehicle, controller: Controller, timestep: PositiveTime, progress: Callable[[str], None] = no_progress
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
    finer = [one for gain in gains if gain.doubtful for one in gain.searches[1:]]
    for timestep in sorted({one.timestep for one in finer}, reverse=True):
        search_and_run([one for one in finer if one.timestep == timestep], progress)


def searches(vehicle: Vehicle, controller: Controller, actuators: Sequence[int], timestep: float) -> LoopMargins:
    """The predicted margins of the loop cut at some actuators, and the searches for them, not yet run."""
    continuous, forces = loop_of(vehicle, controller), [vehicle.linear_model.inputs[i] for i in actuators]
    predicted = margins(continuous, forces)
    mine = np.isin(np.arange(len(vehicle.linear_model.inputs)), actuators)
    cut_out, rest = (replace(controller, law=controller.law.only(part)) for part in (mine, ~mine))
    loop = cut_out, rest if rest.law.acts else None
    derivative = partial(step_derivative, vehicle)

    def delayed(amount: float) -> LoopCase:
        return LoopCase(replace(vehicle, implementation=Implementation(delay=round(amount / timestep))), *loop)

    def sampled_at(period: float) -> LoopCase:
        on = replace(vehicle, implementation=Implementation(sample_period=period))
        return LoopCase(on, controller) if predicted.all_sampled else LoopCase(on, *loop)

    prompt = replace(vehicle, implementation=Implementation())

    def late_grows(delay: float) -> bool:
        cut = loop_of(prompt, controller, timestep).cut(forces)
        return abs(slowest_from_sample_to_sample(cut, round(delay / timestep))) > 1

    late = max(predicted.delay - timestep / 2, timestep)  # half a sample is in the hold
    late, period = (amount if amount < SLOWEST else math.inf for amount in (late, predicted.sample_period))
    return LoopMargins(
        predicted,
        *_gain_margins(prompt, controller, actuators, predicted, timestep, derivative),
        delay=StabilityEdge(derivative(timestep), delayed, late, LONGEST, timestep),
        sample_period=StabilityEdge(derivative(timestep), sampled_at, period, LONGEST, timestep),
        timestep=timestep,
        predicted_delay=predicted.delay,
        late_grows=late_grows,
        slow_grows=lambda period: sampled_growth_at(sampled_part(continuous, forces), period) > 0,
    )


def implemented_searches(vehicle: Vehicle, controller: Controller, actuators: Sequence[int], timestep: float) -> LoopMargins:
    """Returns the same for the loop with its sample period and delay. The delay is searched if the loop is cut at all actuators.

    Raises:
        InputError: the sample period or the delay is not a multiple of the timestep.
    """
    how = vehicle.implementation.without_noise
    built = replace(vehicle, implementation=how)
    loop, forces = loop_of(built, controller, timestep), [vehicle.linear_model.inputs[i] for i in actuators]
    mine = np.isin(np.arange(len(vehicle.linear_model.inputs)), actuators)
    predicted, steps_of_period = margins(loop, forces), len(loop.by_step)
    derivative = partial(step_derivative, replace(vehicle, implementation=Implementation()))

    def later(amount: float) -> LoopCase:
        steps = round(how.delay * steps_of_period) + round(amount / timestep)
        return LoopCase(replace(vehicle, implementation=replace(how, delay=steps / steps_of_period)), controller)

    def grows(amount: float) -> bool:
        return radius(loop_of(later(amount).vehicle, controller, timestep)) > 1

    late = math.inf  # the hold is not delayed as a phase is: near half the sample rate, that is not the same
    if mine.all() and predicted.delay < SLOWEST:
        late = smallest_unstable(grows, predicted.delay, LONGEST, timestep)[1]
    return LoopMargins(
        predicted,
        *_gain_margins(built, controller, actuators, predicted, timestep, derivative),
        delay=StabilityEdge(derivative(timestep), later, late - timestep / 2, LONGEST if mine.all() else 0.0, timestep),
        sample_period=StabilityEdge(derivative(timestep), later, math.inf, 0.0),
        timestep=timestep,
        predicted_delay=late if math.isfinite(late) else predicted.delay,
    )


def _gain_margins(
    vehicle: Vehicle,
    controller: Controller,
    actuators: Sequence[int],
    predicted: Margins,
    timestep: float,
    derivative: Callable[[float], StateSpace],
) -> Iterator[GainMargin]:
    """Yields the gain margin of some forces and the lower one.

    Args:
        derivative: timestep -> derivative of MuJoCo's step.
    """
    mine = np.isin(np.arange(len(vehicle.linear_model.inputs)), actuators)

    @cache
    def sampled(timestep: float) -> list[float]:
        forces = [vehicle.linear_model.inputs[i] for i in actuators]
        return gain_crossings(loop_of(vehicle, controller, timestep, taylor4).cut(forces))

    def with_gain(factor: float) -> LoopCase:
        return LoopCase(vehicle, replace(controller, law=controller.law.scaled(np.where(mine, factor, 1.0))))

    for power, own in ((1, predicted.gain), (-1, predicted.gain_lower)):
        # A factor to this power is an amount above 1: how many times more gain, or how many times less.
        def amount(step: float, k: int = power) -> float:
            return min((factor**k for factor in sampled(step) if factor**k > 1), default=math.inf)

        def trial(amount: float, k: int = power) -> LoopCase:
            return with_gain(amount**k)

        yield GainMargin.at_prediction(own**power if own else math.inf, amount, timestep, derivative, trial, LARGEST_FACTOR)
