"""Margins of controllers, predicted and found in MuJoCo, as a result that can be printed, written as JSON and plotted."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import Vehicle
from sim.linear.nonlinear_elements import at_rest
from sim.studies.stability.edge import no_progress
from sim.studies.stability.margin_search import LoopMargins, find_all, implemented_searches, loops_of, searches
from synth.controller.controller import Controller


@dataclass(frozen=True, eq=False)
class StabilityMargins:
    """Stability margins of one controller.

    Attributes:
        vehicle: vehicle that is defined by the vehicle file.
        controller: controller that closes the loop.
        loops: margins of the ideal loop, by the force at which the loop is cut; the key "" denotes a cut at all actuators.
        implemented_loops: margins of the implemented loop, with the keys of `loops`; empty if the loop has neither sample
            period nor delay.
    """

    vehicle: Vehicle
    controller: Controller
    loops: dict[str, LoopMargins]
    implemented_loops: dict[str, LoopMargins]

    @property
    def wrong(self) -> list[str]:
        """Names of the loops for which MuJoCo contradicts the prediction of a margin."""
        loops = [(f"{name or 'the loop'} as implemented", one) for name, one in self.implemented_loops.items()]
        loops += [(name or "the loop", one) for name, one in self.loops.items()]
        return [name for name, one in loops if not one.agrees]

    @property
    def agrees(self) -> bool:
        """True if MuJoCo confirms all predicted margins."""
        return not self.wrong


def stability_margins(
    vehicle: Vehicle,
    controllers: Sequence[Controller],
    timestep: float,
    progress: Callable[[str], None] = no_progress,
    each_loop: bool = True,
) -> list[StabilityMargins]:
    """Computes the margins of controllers for the vehicle in equilibrium, and searches for these margins in MuJoCo.

    Args:
        vehicle: vehicle that the controllers control.
        controllers: controllers with stable loops.
        timestep: timestep of the simulation [s].
        progress: callback that receives the name of each stage, or a line about the progress of a stage.
        each_loop: True to include, for each actuator, the loop that is cut only at this actuator.
    """
    progress("margins")
    built = at_rest(vehicle)
    ideal, parts = replace(built, implementation=Implementation()), loops_of(vehicle)
    parts = parts if each_loop else {"": parts[""]}
    loops = [{name: searches(ideal, one, cut, timestep) for name, cut in parts.items()} for one in controllers]
    late = {} if vehicle.implementation.undelayed else parts
    implemented = [{name: implemented_searches(built, one, cut, timestep) for name, cut in late.items()} for one in controllers]
    find_all([margins for each in (*loops, *implemented) for margins in each.values()], progress)
    return [StabilityMargins(vehicle, *of) for of in zip(controllers, loops, implemented, strict=True)]
