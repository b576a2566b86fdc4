"""How far rounding moves the signals of a vehicle in MuJoCo, whatever the road.

MuJoCo holds a vehicle up by lengths of about a metre, rounded to 1e-16 of it, and forces of its whole weight that balance. What
that makes of a signal is the same over a bump of a decimetre and over one of a micrometre. It is as if every length among the
states were shaken by a few roundings: then velocities are by that times the vehicle's fastest rate, and what is read out of both
follows from the linear model.
"""

import numpy as np

from models.vehicle import Vehicle
from synth.controller import Controller

LENGTH = 16 * float(np.finfo(float).eps)  # m or rad; measured over roads of 1e-9 m: up to 5e-16 m, in 20000 steps
LENGTHS = ("m", "rad")


def roundings(vehicle: Vehicle, controller: Controller) -> dict[str, float]:
    """How far rounding moves every output signal [the signal's unit], at most."""
    model, kind = vehicle.linear_model, vehicle.kind
    rate = float(np.abs(np.linalg.eigvals(model.A)).max())
    shaken = np.array([LENGTH if kind.signal(name).unit in LENGTHS else rate * LENGTH for name in model.states])
    moved = np.abs(model.C) @ shaken + np.abs(model.D) @ (np.abs(controller.state_gain(vehicle)) @ shaken)
    return dict(zip(model.outputs, moved.tolist(), strict=True))
