"""What slower computers cost a controller: the exact norm of its loop over the sample period, at once and late; and its end."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.controllers import IDEAL, ControllerEntry
from models.law import static_law
from models.reality import Implementation
from models.vehicle import Vehicle
from synth.controller import Controller
from synth.designs.sampled import held_problem
from synth.designs.shared import Shared
from synth.errors import DesignError
from synth.held.design import held_design
from synth.implemented.norm import norm_in_continuous_time, sampled_loop
from synth.rates.lost import lost_from
from synth.sampled.norm import SampledNorm, sampled_norm


@dataclass(frozen=True)
class AtRate:
    """A controller on one computer.

    Attributes:
        period: of its samples [s].
        prompt: the norm of the loop whose forces act at the sample.
        late: of the one whose forces act `Cost.delay` samples late.
        designed: of the one that is designed for this rate instead, at once; None where none is.
        undesigned: why none is, where one was asked for; empty otherwise.
    """

    period: float
    prompt: SampledNorm
    late: SampledNorm
    designed: SampledNorm | None = None
    undesigned: str = ""


@dataclass(frozen=True, eq=False)
class Cost:
    """A controller on computers of several rates.

    Attributes:
        controller: the controller.
        ideal: the norm of its continuous loop, with its actuators' lag and without noise; infinite where that is not stable.
        lower_bound: a norm that no controller with these measurements beats, whatever its rate; None where none is known. It is
            proved for time-invariant controllers, and no time-varying one does better (Khargonekar, Poolla 1986).
        delay: in samples, of the forces that are late.
        rates: ascending by period.
        lost: the shortest sample period at which the loop is not stable [s], see `lost_from`.
        lost_late: the same where forces are late.
    """

    controller: Controller
    ideal: float
    lower_bound: float | None
    delay: float
    rates: tuple[AtRate, ...]
    lost: float
    lost_late: float

    def loss(self, norm: SampledNorm) -> float:
        """By how much a norm is above the continuous loop's, relative; below 0 where it is less, infinite where it is lost."""
        return norm.value / self.ideal - 1 if 0 < self.ideal < np.inf else np.nan if norm.stable else np.inf


def cost(
    vehicle: Vehicle,
    controller: Controller,
    periods: Sequence[float],
    designs: Collection[float] = (),
    done: Callable[[int], None] = lambda count: None,
) -> Cost:
    """What these sample periods cost a controller.

    Args:
        vehicle: its `[implementation]` says how many samples forces are late, one if it says nothing of that, and no more.
        controller: its controller.
        periods: ascending [s].
        designs: those of them for which the same is also designed anew, where it was designed in two steps.
        done: told how many periods are done.
    """
    delay, ideal = vehicle.implementation.delay or 1, norm_in_continuous_time(vehicle, controller)
    near, found = [ideal if 0 < ideal < np.inf else 1.0] * 2, []
    for i, period in enumerate(periods):
        both = []
        for k, samples in enumerate((0, delay)):
            norm = norm_at(vehicle, controller, period, samples, near[k])
            near[k] = norm.value if norm.stable and norm.value else near[k]  # the next is not far
            both.append(norm)
        prompt, late = both
        again = period in designs and _in_two_steps(vehicle, controller)
        designed, why = _designed(vehicle, controller, period, near[0]) if again else (None, "")
        found.append(AtRate(period, prompt, late, designed, why))
        done(i + 1)
    lost, lost_late = (lost_from(vehicle, controller, samples) for samples in (0, delay))
    return Cost(controller, ideal, _lower_bound(vehicle, controller), delay, tuple(found), lost, lost_late)


def norm_at(vehicle: Vehicle, controller: Controller, period: float, delay: float, near: float) -> SampledNorm:
    """The norm of a loop at another sample period [s] and delay [samples] than the vehicle file says; it is near a guess."""
    built = replace(vehicle, implementation=Implementation(period, delay))
    return sampled_norm(sampled_loop(built, controller), near)


def _in_two_steps(vehicle: Vehicle, controller: Controller) -> bool:
    """Whether there is such a design for a sampled loop, too: of static gains without noise."""
    entry = vehicle.controllers.get(controller.name)
    own = entry is None or (entry.law is None and not entry.design)
    return own and controller.law.acts and not any(controller.hardware.noise)


def _designed(vehicle: Vehicle, controller: Controller, period: float, near: float) -> tuple[SampledNorm | None, str]:
    """The norm of a gain on the same measurements that is designed for a rate; where none is found None, and why."""
    built = replace(vehicle, implementation=Implementation(period))
    entry = ControllerEntry(controller.name, controller.measured)
    try:
        gain = held_design(held_problem(built, entry), near, [controller.law.D]).gain
    except DesignError as error:
        return None, str(error)
    return norm_at(vehicle, replace(controller, law=static_law(gain)), period, 0, near), ""


def _lower_bound(vehicle: Vehicle, controller: Controller) -> float | None:
    """What no controller beats that acts at once on what is: of those one that is late, or lags, is one."""
    if controller.hardware == IDEAL:
        return controller.certificate.lower_bound
    return Shared(vehicle).lower_bound(controller.measured).gamma or None
