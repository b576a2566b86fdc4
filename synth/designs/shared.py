"""What the designs of one vehicle share: its plant, the path of (22) to its optimum, and what no controller beats."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

from models.controllers import IDEAL, Hardware
from models.vehicle import Vehicle
from synth.certificate.lower_bound import LowerBound
from synth.design import state_path
from synth.errors import DesignError
from synth.lmi.central import CentralPoint
from synth.lmi.full_order import bound_beyond_control, find_lower_bound
from synth.problem.problem import Problem, generalized_plant, plant_states, problem


class Shared:
    """Of one vehicle with one kind of actuators; all of it is done when first needed.

    Attributes:
        plant: the plant, without noise.
        states: names of its states.
    """

    def __init__(self, vehicle: Vehicle, hardware: Hardware = IDEAL) -> None:
        """Args:
        vehicle: the vehicle.
        hardware: its actuators' lag, and its loads.
        """
        self.vehicle, self.hardware, bandwidth = vehicle, hardware, hardware.bandwidth
        self.plant, self.states = generalized_plant(vehicle, bandwidth, loads=hardware.loads), plant_states(vehicle, bandwidth)
        self._bounds: dict[tuple[tuple[str, ...], tuple[float, ...]], LowerBound] = {}

    @cached_property
    def state_path(self) -> list[CentralPoint]:
        """The central path of (22). Noise on what is measured is nothing to one who knows the state."""
        return state_path(self.plant, self.states)

    @cached_property
    def beyond_control(self) -> LowerBound:
        """What no control force changes, whatever is measured, and however well."""
        return bound_beyond_control(self.plant)

    def problem(self, measured: Sequence[str], noise: tuple[float, ...] = ()) -> Problem:
        """What a controller that measures these signals with that noise is designed for.

        Raises:
            InputError: a signal this vehicle has not.
        """
        return problem(self.vehicle, measured, replace(self.hardware, noise=noise), self.plant)

    def lower_bound(self, measured: Sequence[str], noise: tuple[float, ...] = ()) -> LowerBound:
        """What no controller that measures these signals with that noise beats, of whatever order; of none, state feedback."""
        key = tuple(measured), noise
        if key not in self._bounds:
            posed = self.problem(*key)
            Cy, Dyw = posed.rows(posed.of_state)
            everything = not len(Cy) or (key[0] == self.states and Dyw is None)
            try:
                path = self.state_path
            except DesignError:  # what cannot be designed may be checked
                path = []
            self._bounds[key] = find_lower_bound(posed.plant, None if everything else Cy, path, self.beyond_control, Dyw)
        return self._bounds[key]
