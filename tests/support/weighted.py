"""The closed loop to the weighted output z of a vehicle, for python-control."""

import control

from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller
from synth.vehicle.state_space import loop_to


def weighted_loop(vehicle: Vehicle, controller: Controller) -> control.StateSpace:
    """The loop to z (34), called `z[signal]`: its norm is the certificate's."""
    return loop_to(vehicle, controller, [f"z[{row.name}]" for row in vehicle.weighted])
