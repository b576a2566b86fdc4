"""Cost of a low sample rate: exact norm of a loop as a function of the sample period, and the shortest period at which the loop
is unstable.

The stability limit is the shortest sample period at which the sampled-data loop is unstable. The search for the stability limit
starts at the fastest sample rate. Successive tested periods are so close that the phase of each mode of vehicle and control law
advances by at most 0.1 rad. Modes that decay completely within one sample period are ignored. The stability limit is then found
by bisection between the last stable and the first unstable period.
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
from synth.controller.sampled_report import has_sampled_norm
from synth.design.methods import design
from synth.design.problem import DesignProblem
from synth.plant.numerics import DesignError
from synth.vehicle.designer import SharedDesignData

SHORTEST = 1e-5  # shortest sample period that is tested [s]; it corresponds to 100 kHz
TURN = 0.1  # largest angle by which the phase of a mode may advance between two successive tested periods [rad]
TIME_CONSTANTS = 25.0  # a mode counts as decayed after this many time constants (to e^-25)
CLOSE = 1e-12  # the bisection ends if the relative difference between two periods is smaller than this


def smallest_unstable_period(vehicle: Vehicle, controller: Controller, delay: float) -> float:
    """Returns the shortest sample period at which a loop is not stable [s]; infinite if the loop is stable up to
    `LONGEST_PERIOD`.

    Args:
        vehicle: vehicle to which the controller belongs; the sample period and the delay in `[implementation]` are not used.
        controller: linear controller of the vehicle.
        delay: delay from a measurement to the force that is computed from this measurement [samples].

    Returns:
        Shortest sample period at which the loop is unstable [s]; 0 if the loop is unstable even at the highest sample rate.
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
    """Returns the stability limit [s], which is found by bisection between a stable and an unstable sample period."""
    while after - before > CLOSE * after:
        middle = (before + after) / 2
        before, after = (middle, after) if kept(middle) else (before, middle)
    return after


def _modes(vehicle: Vehicle, controller: Controller) -> Array:
    """Returns the poles of the vehicle including its actuators, followed by the poles of the control law itself [rad/s]."""
    return np.concatenate([np.linalg.eigvals(A) for A in (with_lag(vehicle).A, controller.law.continuous().A)])


@dataclass(frozen=True)
class AtRate:
    """Norms of a controller at one sample rate.

    Attributes:
        period: sample period [s].
        undelayed_norm: norm of the loop without delay.
        delayed_norm: norm of the loop with the delay `Cost.delay`.
        designed_norm: norm, without delay, of a controller that was designed for this sample rate; None if there is no such
            design.
        design_failure: reason why the design for this sample rate failed; empty if no design failed.
    """

    period: float
    undelayed_norm: SampledNorm
    delayed_norm: SampledNorm
    designed_norm: SampledNorm | None = None
    design_failure: str = ""


@dataclass(frozen=True, eq=False)
class Cost:
    """Norms of a controller at several sample rates.

    Attributes:
        controller: controller to which the norms belong.
        ideal: norm of the continuous loop with actuator lag and without noise; infinite if the continuous loop is not stable.
        lower_bound: lower bound on the norm for any controller with the same measurements at any sample rate; None if no bound
            is known. The bound is proved for time-invariant controllers, but also holds for time-varying controllers, which
            cannot be better (Khargonekar, Poolla 1986).
        delay: delay of the control forces, for `delayed_norm` and `lost_late` [samples].
        rates: norms at each sample rate, in ascending order of the sample period.
        unstable_period: shortest sample period at which the loop is not stable [s]; see `smallest_unstable_period`.
        lost_late: shortest sample period at which the loop with the delay `delay` is not stable [s].
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
        """True if a design for any of the sample rates was made or attempted."""
        return any(at.designed_norm is not None or at.design_failure for at in self.rates)

    def loss(self, norm: SampledNorm) -> float:
        """Returns the relative amount by which a norm exceeds the norm of the continuous loop; infinite for an unstable loop."""
        return norm.value / self.ideal - 1 if 0 < self.ideal < np.inf else np.nan if norm.stable else np.inf


def cost(
    vehicle: Vehicle,
    controller: Controller,
    periods: Sequence[float],
    designs: Collection[float] = (),
    done: Callable[[int], None] = lambda count: None,
) -> Cost:
    """Computes the norms of a controller at several sample periods.

    Args:
        vehicle: vehicle to which the controller belongs. Only the delay in `[implementation]` is used; without this key, the
            delay is 1 sample.
        controller: linear controller.
        periods: sample periods in ascending order [s].
        designs: sample periods for which a static controller is also redesigned [s].
        done: function that is called with the number of sample periods that are finished.

    Raises:
        DesignError: the loop has no finite norm at any sample rate, because a constant road height affects the output z.
    """
    if not has_sampled_norm(vehicle, controller):
        raise DesignError("the loop has no finite norm at any rate, because a constant road height affects z")
    delay, ideal = vehicle.implementation.delay or 1, norm_in_continuous_time(vehicle, controller)
    near, rates = [ideal if 0 < ideal < np.inf else 1.0] * 2, []
    for i, period in enumerate(periods):
        both = []
        for k, samples in enumerate((0, delay)):
            norm = norm_at(vehicle, controller, period, samples, near[k])
            near[k] = norm.value if norm.stable and norm.value else near[k]  # the norm at the next period is probably similar
            both.append(norm)
        prompt, late = both
        again = period in designs and _in_two_steps(vehicle, controller)
        designed, why = _norm_at_rate(vehicle, controller, period, near[0]) if again else (None, "")
        rates.append(AtRate(period, prompt, late, designed, why))
        done(i + 1)
    lost, lost_late = (smallest_unstable_period(vehicle, controller, samples) for samples in (0, delay))
    return Cost(controller, ideal, _lower_bound(vehicle, controller), delay, tuple(rates), lost, lost_late)


def norm_at(vehicle: Vehicle, controller: Controller, period: float, delay: float, near: float) -> SampledNorm:
    """Returns the norm of a loop for a sample period [s] and a delay [samples]; the search for the norm starts at the estimate
    `near`.
    """
    built = replace(vehicle, implementation=Implementation(period, delay))
    return sampled_norm(sampled_loop(built, controller.without_noise), near)


def _in_two_steps(vehicle: Vehicle, controller: Controller) -> bool:
    """Returns True if the controller could also be designed for a sampled-data loop, for example a static gain without noise."""
    entry = vehicle.controllers.get(controller.name)
    own = entry is None or goes("rates", entry.parts)
    return own and not controller.law.states and controller.law.acts and not any(controller.hardware.noise)


def _norm_at_rate(vehicle: Vehicle, controller: Controller, period: float, near: float) -> tuple[SampledNorm | None, str]:
    """Returns the norm of a gain that is designed for a sample period [s]; if the design fails, returns None and the reason."""
    built = replace(vehicle, implementation=Implementation(period))
    entry = ControllerEntry(controller.name, controller.measured)
    try:
        held = held_problem(built, entry)
        law = design(DesignProblem(held.plant, sampled=held, near=near, known=[controller.law], thorough=False)).law
    except DesignError as error:
        return None, str(error)
    return norm_at(vehicle, replace(controller, law=law), period, 0, near), ""


def _lower_bound(vehicle: Vehicle, controller: Controller) -> float | None:
    """Returns the lower bound on the norm for controllers without delay; the bound also holds if there is a delay or an
    actuator lag.

    The result is None if the output z contains an integral, because the norms at the sample rates do not include this integral.
    """
    if vehicle.integrals:
        return None
    if controller.hardware == NOMINAL:
        return controller.certificate.lower_bound
    return SharedDesignData(vehicle).lower_bound(controller.measured).gamma or None
