"""Cost of a low sample rate: the exact norm of a loop over the sample period, undelayed and delayed, and its stability limit.

The end is where, from the fastest computer on, the sampled loop is lost. Stability is that of the sampled loop itself. Between
neighbouring periods no mode of the vehicle or of the law turns by more than a tenth of a radian, as long as anything is left of
it. Between the last that is stable and the first that is not the interval is halved until it is nothing.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.laws.combinations import goes
from models.vehicle.controllers import NOMINAL, ControllerEntry
from models.vehicle.limits_and_implementation import LONGEST_PERIOD, Implementation
from models.vehicle.vehicle import Vehicle
from synth.analysis.sampled_norm import sampled_norm, stable
from synth.analysis.specification import SampledNorm
from synth.controller.controller import Controller
from synth.controller.implementation_norm import held_problem, norm_in_continuous_time, sampled_loop
from synth.controller.loop_of import with_lag
from synth.controller.report import has_sampled_norm
from synth.design.methods import design
from synth.design.problem import DesignProblem
from synth.plant.numerics import DesignError
from synth.vehicle.designer import SharedDesignData

SHORTEST = 1e-5  # s; a computer of 100 kHz is the fastest that is asked about
TURN = 0.1  # rad that a mode turns by from one period that is tried to the next
TIME_CONSTANTS = 25.0  # time constants, after which e^-25 is left of a mode
CLOSE = 1e-12  # relative, of two periods


def smallest_unstable_period(vehicle: Vehicle, controller: Controller, delay: float) -> float:
    """Returns the shortest sample period at which a loop is not stable [s]; infinite if it is stable up to `LONGEST_PERIOD`.

    Args:
        vehicle: the vehicle; sample period and delay of its `[implementation]` do not count.
        delay: delay from a measurement to the force computed from it, in samples.

    Returns:
        0 if the loop is unstable even at the highest rate.
    """

    def kept(period: float) -> bool:
        return stable(sampled_loop(replace(vehicle, implementation=Implementation(period, delay)), controller))

    if not kept(SHORTEST):
        return 0.0
    modes, before = _modes(vehicle, controller), SHORTEST
    while before < LONGEST_PERIOD:
        alive = modes[-np.real(modes) * before < TIME_CONSTANTS]
        fastest = float(np.abs(alive).max(initial=1 / LONGEST_PERIOD))
        after = min(before + TURN / fastest / (1 + delay), LONGEST_PERIOD)
        if not kept(after):
            return _between(kept, before, after)
        before = after
    return np.inf


def _between(kept: Callable[[float], bool], before: float, after: float) -> float:
    """Bisects the period of stability loss between a stable and an unstable period."""
    while after - before > CLOSE * after:
        middle = (before + after) / 2
        before, after = (middle, after) if kept(middle) else (before, middle)
    return after


def _modes(vehicle: Vehicle, controller: Controller) -> Array:
    """Poles of the vehicle, its actuators and the law, by themselves [rad/s]."""
    return np.concatenate([np.linalg.eigvals(A) for A in (with_lag(vehicle).A, controller.law.continuous().A)])


@dataclass(frozen=True)
class AtRate:
    """The norms of a controller at one sample rate.

    Attributes:
        period: sample period [s].
        undelayed_norm: norm of the loop without delay.
        delayed_norm: norm of the loop with the delay `Cost.delay`.
        designed_norm: norm without delay of a controller designed for this rate; None without such a design.
        design_failure: reason if that design was requested and failed, or empty.
    """

    period: float
    undelayed_norm: SampledNorm
    delayed_norm: SampledNorm
    designed_norm: SampledNorm | None = None
    design_failure: str = ""


@dataclass(frozen=True, eq=False)
class Cost:
    """The norms of a controller at several sample rates.

    Attributes:
        controller: the controller.
        ideal: norm of its continuous loop, with its actuators' lag and without noise; infinite if that is not stable.
        lower_bound: lower bound on the norm with these measurements at any rate; None if unknown. It is proved for time-invariant
            controllers, and no time-varying one does better (Khargonekar, Poolla 1986).
        delay: delay of the late forces, in samples.
        rates: norms at the rates, ascending by period.
        unstable_period: the shortest sample period at which the loop is not stable [s], see `smallest_unstable_period`.
        lost_late: shortest sample period at which the loop with late forces is not stable [s].
    """

    controller: Controller
    ideal: float
    lower_bound: float | None
    delay: float
    rates: tuple[AtRate, ...]
    unstable_period: float
    lost_late: float

    @property
    def redesigned(self) -> bool:
        """True if a design for any rate was made or tried."""
        return any(at.designed_norm is not None or at.design_failure for at in self.rates)

    def loss(self, norm: SampledNorm) -> float:
        """Returns the relative excess of a norm over the continuous loop's; negative if it is less, infinite if unstable."""
        return norm.value / self.ideal - 1 if 0 < self.ideal < np.inf else np.nan if norm.stable else np.inf


def cost(
    vehicle: Vehicle,
    controller: Controller,
    periods: Sequence[float],
    designs: Collection[float] = (),
    done: Callable[[int], None] = lambda count: None,
) -> Cost:
    """Computes the norms of a controller at these sample periods.

    Args:
        vehicle: vehicle, of whose `[implementation]` only the delay in samples counts; default one.
        periods: ascending [s].
        designs: periods for which a controller designed in two steps is designed again.
        done: callback that receives the number of finished periods.

    Raises:
        DesignError: a law for study has no norm at any rate.
    """
    if not has_sampled_norm(vehicle, controller):
        raise DesignError("the loop has no finite norm at any rate, as a permanent height of the road shows in z")
    delay, ideal = vehicle.implementation.delay or 1, norm_in_continuous_time(vehicle, controller)
    near, rates = [ideal if 0 < ideal < np.inf else 1.0] * 2, []
    for i, period in enumerate(periods):
        both = []
        for k, samples in enumerate((0, delay)):
            norm = norm_at(vehicle, controller, period, samples, near[k])
            near[k] = norm.value if norm.stable and norm.value else near[k]  # the next is not far
            both.append(norm)
        prompt, late = both
        again = period in designs and _in_two_steps(vehicle, controller)
        designed, why = _norm_at_rate(vehicle, controller, period, near[0]) if again else (None, "")
        rates.append(AtRate(period, prompt, late, designed, why))
        done(i + 1)
    lost, lost_late = (smallest_unstable_period(vehicle, controller, samples) for samples in (0, delay))
    return Cost(controller, ideal, _lower_bound(vehicle, controller), delay, tuple(rates), lost, lost_late)


def norm_at(vehicle: Vehicle, controller: Controller, period: float, delay: float, near: float) -> SampledNorm:
    """The norm of a loop at another sample period [s] and delay [samples] than the vehicle file says; it is near a guess."""
    built = replace(vehicle, implementation=Implementation(period, delay))
    return sampled_norm(sampled_loop(built, controller.without_noise), near)


def _in_two_steps(vehicle: Vehicle, controller: Controller) -> bool:
    """Returns True if the controller can be designed for a sampled loop, too: a static gain without noise."""
    entry = vehicle.controllers.get(controller.name)
    own = entry is None or goes("rates", entry.parts)
    return own and not controller.law.states and controller.law.acts and not any(controller.hardware.noise)


def _norm_at_rate(vehicle: Vehicle, controller: Controller, period: float, near: float) -> tuple[SampledNorm | None, str]:
    """Returns the norm of a gain on the same measurements designed for a rate; without one None, and the reason."""
    built = replace(vehicle, implementation=Implementation(period))
    entry = ControllerEntry(controller.name, controller.measured)
    try:
        held = held_problem(built, entry)
        law = design(DesignProblem(held.plant, sampled=held, near=near, known=[controller.law], thorough=False)).law
    except DesignError as error:
        return None, str(error)
    return norm_at(vehicle, replace(controller, law=law), period, 0, near), ""


def _lower_bound(vehicle: Vehicle, controller: Controller) -> float | None:
    """Returns the lower bound for undelayed controllers. It also holds for delayed or lagging ones, which are a subset.

    None if z weighs an integral, which the norms leave out.
    """
    if vehicle.integrals:
        return None
    if controller.hardware == NOMINAL:
        return controller.certificate.lower_bound
    return SharedDesignData(vehicle).lower_bound(controller.measured).gamma or None
