"""Stability margins of a loop, predicted from the loop transfer function and found in MuJoCo.

Start with `find_margins`. `edge.py` contains the search for stability limits in MuJoCo.
"""

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

# road on which recorded runs drive: short, and too low to lift a wheel
BUMP = Bump(height=2e-5, length=20.0, speed=100.0, track="left")
LONGEST = 2.0  # s; longest delay, and longest sample period, to try if linear analysis predicts no limit
# allowed relative difference between a gain margin in MuJoCo and its prediction; the error of a search is 0.2 %, and that of an
# extrapolation 0.3 %
AGREES = 5e-3
# largest relative error of a gain margin that a search finds; the error of an extrapolation depends on this error
ENDS = 1.5e-3
HALVINGS = 9  # largest number of times that the timestep is halved; runs at smaller steps take minutes
# A margin tends to infinity for small steps if halving the step increases the margin by more than this factor
WITHOUT_END = 1.5


@dataclass(frozen=True, eq=False)
class GainMargin:
    """Upper or lower gain margin of a loop, predicted and found in MuJoCo; infinite if no gain factor makes the loop unstable.

    MuJoCo holds the force during each timestep, so that the simulated loop is a sampled loop. For small timesteps, the margin
    of the sampled loop approaches that of the continuous loop with an error proportional to the timestep. If the margins of the
    sampled and the continuous loop differ at the requested timestep, two smaller timesteps h and h/2 are simulated. MuJoCo's
    margins at both timesteps are extrapolated to a timestep of 0. `at_prediction` chooses h.

    Attributes:
        own: predicted gain margin of the continuous loop.
        sampled: predicted gain margins of the sampled loop, as RK4 integrates it, at the timesteps of the searches.
        search: search for the gain margin in MuJoCo at the requested timestep.
        finer: search at half the timestep or less, which is run only if necessary.
        coarser: search at twice the timestep of `finer`; None if `search` has this timestep.
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
        """Prepares the searches for a margin at the requested timestep and at smaller timesteps, without running them.

        The smaller timesteps are chosen so that extrapolation of the last two margins gives the margin of the continuous loop.

        Args:
            own: predicted gain margin of the continuous loop.
            sampled: function of the timestep [s] that returns the predicted margin of the sampled loop.
            timestep: timestep of the simulation [s].
            derivative: function of the timestep [s] that returns the derivative of MuJoCo's step.
            trial, most: attributes of each search, see `StabilityEdge`.
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
        """All searches in order of decreasing timestep."""
        return (self.search, self.finer) if self.coarser is None else (self.search, self.coarser, self.finer)

    @property
    def tried(self) -> list[tuple[float, StabilityEdge]]:
        """Finished searches, each with the predicted margin of the sampled loop at the timestep of the search."""
        return [(at, one) for at, one in zip(self.sampled, self.searches, strict=True) if one.searched]

    @staticmethod
    def limit(coarse: float, fine: float) -> float:
        """Returns a margin extrapolated to a timestep of 0; infinite if the margin grows without limit.

        Args:
            coarse: margin at the longer timestep.
            fine: margin at half of the longer timestep.
        """
        return math.inf if fine > WITHOUT_END * coarse or math.isinf(fine) else 2 * fine - coarse

    @staticmethod
    def shown_by(own: float, coarse: float, fine: float) -> bool:
        """Returns True if extrapolation of the sampled loop's margins at two timesteps gives the margin of the continuous loop.

        Args:
            own: margin of the continuous loop.
            coarse: margin at the longer timestep.
            fine: margin at half of the longer timestep.
        """
        within = max(abs(fine - coarse) / 2, AGREES * own)
        return all(_close(own, GainMargin.limit(coarse, share * fine), within) for share in (1 - ENDS, 1 + ENDS))

    @property
    def doubtful(self) -> bool:
        """True if the margin that was found at the requested timestep differs from the predicted margin of the continuous
        loop.
        """
        return not _close(self.own, self.search.found, AGREES * self.own)

    @property
    def found(self) -> float:
        """Margin that was found in MuJoCo, extrapolated to a timestep of 0 if finer searches ran.

        The margin is infinite if it grows without limit as the timestep decreases, because in this case only sampling limits
        the gain. The margin is NaN if it still grows at the smallest timestep although the margin of the continuous loop is
        finite and larger.
        """
        if not self.finer.searched:
            return self.search.found
        if self.sampled[-1] < self.own < math.inf and math.isinf(self.limit(*self.sampled[-2:])):
            return math.nan
        return self.limit(*(one.found for one in self.searches[-2:]))

    @property
    def extrapolated(self) -> bool:
        """True if the margin was extrapolated from two timesteps."""
        return self.finer.searched and math.isfinite(self.found)

    @property
    def agrees(self) -> bool:
        """True if MuJoCo confirms the predicted margins of the sampled loop at each timestep, and the predicted margin of the
        continuous loop.

        The error of an extrapolated margin is of second order in the timestep. The error of an extrapolated margin is less than
        half of the difference between the margins at the two timesteps.
        """
        here = all(_close(at, search.found, AGREES * at) and search.confirmed for at, search in self.tried)
        coarse, fine = (one.found for one in self.searches[-2:])
        moved = abs(fine - coarse) if self.finer.searched else 0.0
        return here and _close(self.own, self.found, max(moved / 2, AGREES * self.own))


@dataclass(frozen=True, eq=False)
class LoopMargins:
    """Stability margins of one loop, predicted and found in MuJoCo.

    Attributes:
        predicted: margins that are computed from the loop transfer function.
        gain: upper gain margin, which is the largest stable gain factor.
        gain_lower: lower gain margin, which is the inverse of the smallest stable gain factor.
        delay: search for the smallest unstable delay; for an implemented loop, this delay is added to the delay that the loop
            already has.
        sample_period: search for the smallest unstable sample period, which is not run for an implemented loop.
        timestep: timestep of the simulation [s].
        predicted_delay: smallest delay for which the linear loop is unstable [s].
        late_grows, slow_grows: functions that return True if the linear loop is unstable with a delay (`late_grows`) or a sample
            period (`slow_grows`) [s], each a multiple of the timestep.
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
        """Largest gain factor below 1 that makes the loop unstable; 0 if all factors below 1 are stable."""
        return 1 / self.gain_lower.found

    @property
    def found_sample_period(self) -> float:
        """Longest stable sample period below the shortest unstable sample period [s]; infinite if all sample periods are
        stable, NaN if the limit is unknown.
        """
        edge = self.sample_period
        return edge.unstable - self.timestep if _is_seen(edge, self.predicted.sample_period) else math.nan

    @property
    def found_delay(self) -> float:
        """Smallest delay that makes the loop unstable [s]; infinite if all delays are stable, NaN if the runs are not
        decisive.
        """
        return self.delay.unstable if _is_seen(self.delay, self.predicted_delay) else math.nan

    @property
    def found_phase(self) -> float:
        """Phase lag at the crossover frequency that is due to the delay found in MuJoCo [rad]."""
        return self.found_delay * self.predicted.frequency if math.isfinite(self.found_delay) else self.found_delay

    @property
    def agrees(self) -> bool:
        """True if all margins agree with their predictions: gain margins to 0.5 %, delay and sample period to one timestep."""
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
    """Returns True if the linear loop, evaluated only at multiples of the timestep, has the same stability limit as MuJoCo.

    Args:
        edge: finished search for a stability limit.
        grows: function that returns True if the linear loop is unstable for an amount.
    """
    if grows is None or not edge.unstable > edge.expected:
        return False
    return edge.unstable == smallest_unstable(grows, edge.expected, edge.most, edge.multiple)[1]


def _is_seen(edge: StabilityEdge, predicted: float) -> bool:
    """Returns True if a search is finished, its runs are decisive, and the predicted limit [s] lies within the range of the
    search.
    """
    within = math.isinf(predicted) or predicted < SLOWEST or math.isfinite(edge.unstable)
    return edge.searched and edge.decided and within


def _close(predicted: float, measured: float, within: float) -> bool:
    """Returns True if a margin agrees with its prediction within a tolerance. An undecided margin (NaN) counts as agreement."""
    return predicted == measured or math.isnan(measured) or abs(predicted - measured) <= within < math.inf


def find_margins(
    vehicle: Vehicle, controller: Controller, timestep: PositiveTime, progress: Callable[[str], None] = no_progress
) -> dict[str, LoopMargins]:
    """Predicts the gain, phase and delay margins and the largest sample period of a loop, and measures them in MuJoCo.

    Args:
        vehicle: vehicle of the loop; its `[implementation]` section is ignored.
        controller: controller with a stable loop.
        timestep: timestep of the simulation [s].
        progress: callback that receives a line about the progress.

    Returns:
        Stability margins by name of the loop. The name "" denotes the loop that is cut at all actuators. For several actuators,
        the name of a force denotes the loop that is cut at this force while all other force loops are closed.

    Raises:
        InputError: the controller belongs to a different vehicle, or the timestep is invalid.

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
    """Returns the indices of the actuators at which each loop is cut, by name of the loop; `find_margins` explains these
    names.
    """
    names = vehicle.linear_model.inputs
    return {"": list(range(len(names)))} | ({name: [i] for i, name in enumerate(names)} if len(names) > 1 else {})


def find_all(loops: Sequence[LoopMargins], progress: Callable[[str], None] = no_progress) -> None:
    """Runs the searches for the margins of loops, which may belong to several controllers. Runs with the same timestep are
    simulated in one batch.
    """
    gains = [gain for one in loops for gain in (one.gain, one.gain_lower)]
    others = [search for one in loops for search in (one.delay, one.sample_period) if search.most]
    search_and_run([*(gain.search for gain in gains), *others], progress)
    finer = [one for gain in gains if gain.doubtful for one in gain.searches[1:]]
    for timestep in sorted({one.timestep for one in finer}, reverse=True):
        search_and_run([one for one in finer if one.timestep == timestep], progress)


def searches(vehicle: Vehicle, controller: Controller, actuators: Sequence[int], timestep: float) -> LoopMargins:
    """Returns the predicted margins of a loop, and searches for the same margins in MuJoCo that are prepared but not run.

    Args:
        vehicle: vehicle without sample period, delay and measurement noise.
        controller: controller of the loop.
        actuators: indices of the actuators at which the loop is cut.
        timestep: timestep of the simulation [s].
    """
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

    # a force that is held over a sample acts like a force delayed by half a sample
    late = max(predicted.delay - timestep / 2, timestep)
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
    """Returns predicted margins and searches as `searches` does, but for the loop with the sample period and the delay that the
    vehicle file defines.

    The search for the delay runs only if the loop is cut at all actuators.

    Raises:
        InputError: the sample period or the delay is not an integer multiple of the timestep.
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

    # Near half the sample rate, a delayed hold is not equivalent to a phase lag, so the delay is searched for in the linear
    # loop
    late = math.inf
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
    """Yields the upper and the lower gain margin of a loop.

    Args:
        vehicle: vehicle of the loop.
        controller: controller of the loop.
        actuators: indices of the actuators whose gain changes.
        predicted: margins of the loop, predicted from the loop transfer function.
        timestep: timestep of the simulation [s].
        derivative: function of the timestep [s] that returns the derivative of MuJoCo's step.
    """
    mine = np.isin(np.arange(len(vehicle.linear_model.inputs)), actuators)

    @cache
    def sampled(timestep: float) -> list[float]:
        forces = [vehicle.linear_model.inputs[i] for i in actuators]
        return gain_crossings(loop_of(vehicle, controller, timestep, taylor4).cut(forces))

    def with_gain(factor: float) -> LoopCase:
        return LoopCase(vehicle, replace(controller, law=controller.law.scaled(np.where(mine, factor, 1.0))))

    for power, own in ((1, predicted.gain), (-1, predicted.gain_lower)):
        # The amount is a factor above 1, by which the gain is multiplied (power 1) or divided (power -1).
        def amount(step: float, k: int = power) -> float:
            return min((factor**k for factor in sampled(step) if factor**k > 1), default=math.inf)

        def trial(amount: float, k: int = power) -> LoopCase:
            return with_gain(amount**k)

        yield GainMargin.at_prediction(own**power if own else math.inf, amount, timestep, derivative, trial, LARGEST_FACTOR)
