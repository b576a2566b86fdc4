"""Margin of a loop for errors of its readings and forces: predicted, proved, and confirmed in MuJoCo along the worst of them."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from models.common.arrays import Array
from models.vehicle.vehicle import Vehicle
from sim.studies.stability.edge import no_progress, search_and_run
from sim.studies.stability.margin_search import GainMargin
from sim.studies.stability.simulated_loop import Trial
from sim.studies.stability.step_derivative import step_derivative
from synth.analysis.certificate import Certificate
from synth.analysis.uncertainty_box import ScaledGain
from synth.controller.controller import Controller
from synth.controller.loop_of import loop_of
from synth.controller.problem import problem
from synth.design.uncertainty.fragility import Fragility, fragility, rounding
from synth.design.uncertainty.problem import scaled_gain

MOST = 1.0  # the largest error that is tried: a reading that is missing, or twice as large
GRID = 64  # amounts up to it at which the sampled loop is looked at
EXACT = 1e-6  # relative; how closely its own edge is found
STILL = 1e-8  # 1/s; an integrator's pole is 1 but for rounding


class FragilityEdge(GainMargin):
    """The error at which a loop is lost, which is a gain margin but for how it tends to the loop's own as the timestep shrinks.

    A difference of 0.1 is small for a factor of 1.1, but as large as an error of 10 %.
    """

    @classmethod
    def limit(cls, coarse: float, fine: float) -> float:
        """Returns the margin extrapolated to timestep zero; infinite if the loop with a finer step is stable."""
        return math.inf if math.isinf(fine) else 2 * fine - coarse

    @classmethod
    def shown_by(cls, own: float, coarse: float, fine: float) -> bool:
        """See `GainMargin.shown_by`; an infinite margin is the loop's own, if only sampling makes the loop unstable."""
        return math.isinf(own) or super().shown_by(own, coarse, fine)

    @property
    def found(self) -> float:
        """Returns the margin extrapolated to timestep zero; infinite if only sampling makes the loop unstable."""
        return math.inf if self.finer.searched and math.isinf(self.own) else super().found


@dataclass(frozen=True, eq=False)
class FragilityFound:
    """The errors that a loop tolerates.

    Attributes:
        gain: the loop with factors on its measurements and requested forces.
        predicted: tolerance that is predicted for that loop.
        edge: size of the worst errors at which it becomes unstable, predicted and found.
        vehicle, controller: the loop.
    """

    gain: ScaledGain
    predicted: Fragility
    edge: FragilityEdge
    vehicle: Vehicle
    controller: Controller

    @cached_property
    def rounding(self) -> dict[str, Certificate]:
        """Returns the certificate of the law with rounded numbers, by format."""
        ideal = self.controller.problem(self.vehicle.without_integrals)
        if ideal.of_heights is not None:
            return {}
        return rounding(self.controller.law, ideal.closed_loop, ideal.plant)

    @property
    def agrees(self) -> bool:
        """Returns True if the worst errors make the loop unstable in MuJoCo at their predicted size."""
        return self.edge.agrees


def find_fragility(
    vehicle: Vehicle, controller: Controller, timestep: float, progress: Callable[[str], None] = no_progress
) -> FragilityFound:
    """The errors that a loop bears, with an actuator's lag if the vehicle's have one; physics runs along the worst of them."""
    lag = replace(controller.hardware, bandwidth=vehicle.limits.actuator_bandwidth or controller.hardware.bandwidth)
    posed, law = problem(vehicle.without_integrals, controller.measured, lag), controller.law.continuous()
    gain = scaled_gain(posed.plant, law)
    predicted = fragility(gain, posed.of_heights is None)

    def trial(amount: float) -> Trial:
        return Trial(vehicle, with_errors(controller, predicted, amount))

    own, sampled = _inside(predicted.stable.smallest_violation), partial(_sampled_edge, vehicle, controller, predicted)
    edge = FragilityEdge.posed(own, sampled, timestep, partial(step_derivative, vehicle), trial, MOST)
    search_and_run([edge.search], progress)
    for one in edge.searches[1:] if edge.doubtful else ():
        search_and_run([one], progress)
    return FragilityFound(gain, predicted, edge, vehicle, controller)


def with_errors(controller: Controller, predicted: Fragility, amount: float) -> Controller:
    """A controller whose readings and forces are off as in the worst errors, so far at most."""
    worst = predicted.stable
    size = amount / min(worst.smallest_violation, MOST)
    return replace(controller, law=controller.law.read_as(1 + size * worst.readings).scaled(1 + size * worst.forces))


def _inside(edge: float) -> float:
    """Returns an edge, or infinity if it is that of the errors themselves.

    Without its readings the loop of a law that integrates, or of a car without dampers, neither grows nor decays; with any that
    are left it decays.
    """
    return edge if edge < MOST * (1 - 2 * EXACT) else math.inf


def _sampled_edge(vehicle: Vehicle, controller: Controller, predicted: Fragility, timestep: float) -> float:
    """Returns the margin of the loop that is sampled every timestep; infinite if it exceeds `MOST`."""
    # Errors of readings and forces multiply, so that the transition is of second order in their amount.
    ends = [loop_of(vehicle, with_errors(controller, predicted, amount), timestep) for amount in (0.0, MOST / 2, MOST)]
    start, middle, end = (loop.closed_loop.A for loop in ends)
    first, second = 4 * middle - 3 * start - end, 2 * (start + end) - 4 * middle

    def grows(amount: Array) -> Array:
        share = amount[:, None, None] / MOST
        radius = np.abs(np.linalg.eigvals(start + share * first + share**2 * second)).max(axis=1)
        return np.log(radius) > STILL * timestep

    amounts = np.linspace(0.0, MOST, GRID + 1)
    lost = grows(amounts)
    if not lost.any():
        return math.inf
    low, high = (float(amounts[lost.argmax() + i]) for i in (-1, 0))
    while high - low > EXACT * high:
        middle = (low + high) / 2
        low, high = (low, middle) if grows(np.array([middle]))[0] else (middle, high)
    return _inside(high)
