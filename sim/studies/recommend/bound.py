"""Lower bound on the ride of active controllers: LQG of the same sensors, whose force costs next to nothing.

LQG has the least mean square of all controllers. Its cost of force falls until the ride falls by less than `ENOUGH`; the
bound is lower than this ride by twice the last change. With several points, the worst one is at least their root mean square.
"""

import math
from dataclasses import replace

import numpy as np

from models.common.errors import InputError
from models.laws.design_request import DesignRequest
from models.vehicle.controllers import ControllerEntry, DesignConditions
from sim.studies.recommend.optimal import Weights, weighted_vehicle
from sim.studies.recommend.task import Task
from synth.design.full_order.quadratic import h2_norm
from synth.plant.numerics import DesignError
from synth.vehicle.designer import Designer

NEARLY_NONE = -9.0  # power of e of weights that only keep the problem regular
FORCES = (-3.0, -4.5, -6.0, -7.5, -9.0, -10.5)  # powers of e
ENOUGH = 5e-3  # relative


def lower_bound(task: Task) -> float | None:
    """Returns the expected ride that no controller of the same sensors falls below without limits [m/s2]; None if unknown."""
    points = task.line.ride_points.worst_of
    if not points:
        return None
    last, change = math.inf, math.inf
    for force in FORCES:
        try:
            ride = _ride(task, Weights(travel=NEARLY_NONE, tyre=NEARLY_NONE, force=force)) / math.sqrt(len(points))
        except (DesignError, InputError, np.linalg.LinAlgError):
            break
        change, last = last - ride, min(ride, last)
        if change < ENOUGH * last:
            break
    bound = last - 2 * change
    return bound if math.isfinite(bound) and bound > 0 else None


def _ride(task: Task, weights: Weights) -> float:
    """Returns the root of the least mean square of the weighted accelerations, with the noise of the sensors [m/s2]."""
    car = weighted_vehicle(task, weights)
    bandwidth = task.pushed.limits.actuator_bandwidth
    car = replace(car, limits=replace(car.limits, actuator_bandwidth=bandwidth))
    noise = tuple(level / task.white for level in task.noise_of(task.sensors))
    entry = ControllerEntry("bound", task.sensors, DesignRequest(design="h2"), hardware=DesignConditions(noise, bandwidth))
    controller = Designer(replace(car, controllers={"bound": entry}), search=False).design("bound")
    ride_alone = replace(car, performance=dict.fromkeys(car.performance, 0.0))
    return task.white * h2_norm(controller.loop(ride_alone))
