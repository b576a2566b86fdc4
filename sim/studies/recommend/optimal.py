"""Optimal laws of a vehicle's sensors: LQG, and H-infinity of full order and by the two steps, for weights of the search.

The plant of the design is the linear vehicle behind its actuators' lag. The computer's delay and hold are a part of this lag:
1 / bandwidth + (delay + 1/2) sample periods. The road's velocity is white in the road's own intensity, the vertical accelerations
of the ride points have the filter W_k, and the noise is that of the sensors.

Weights are powers of e times usual sizes, so that the search needs no units: 1 over a third of the stroke, of the static tyre
deflection and of the largest force, times the passive vehicle's acceleration.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.laws.design_methods import FULL
from models.laws.design_request import DesignRequest
from models.laws.filter import WEIGHTINGS, Filter
from models.laws.linear import LinearLaw
from models.vehicle.controllers import ControllerEntry, DesignConditions
from models.vehicle.sections import WeightedSum
from models.vehicle.vehicle import Vehicle
from sim.studies.recommend.task import Task, body_rows
from synth.controller.controller import Controller, on_readings
from synth.controller.problem import problem
from synth.design.full_order.quadratic import lqg_law
from synth.vehicle.designer import Designer

WK = Filter(WEIGHTINGS["iso2631_wk"], "iso2631_wk")
LQG = "lqg"
USUAL: Mapping[str, float] = {
    "ride": -1.0,
    "travel": -1.5,
    "tyre": -2.5,
    "force": -1.0,
    "load": -2.0,
    "noise": 0.0,
}  # powers of e
FREE = {"ride": "ride", "holding": "tyre", "travel": "travel"}  # the weight that a goal fixes at 1


@dataclass(frozen=True)
class Weights:
    """Weights of a design as powers of e on usual sizes.

    Attributes:
        ride, travel, tyre, force: weights of accelerations, deflections of suspensions and tyres, and forces.
        load: load on the body, as a share of the static load, that disturbs like the road.
        noise: factor on the noise of the sensors.
    """

    ride: float = 0.0
    travel: float = 0.0
    tyre: float = 0.0
    force: float = 0.0
    load: float = 0.0
    noise: float = 0.0


def searched(task: Task) -> tuple[str, ...]:
    """Returns the names of the weights that are searched for the goal."""
    return tuple(name for name in USUAL if name != FREE[task.goal])


def weights_of(task: Task, x: Sequence[float]) -> Weights:
    """Returns the weights of a point of the search."""
    return Weights(**dict(zip(searched(task), (float(one) for one in x), strict=True)))


def usual_point(task: Task) -> Array:
    """Returns the point at which the search of weights begins."""
    return np.array([USUAL[name] for name in searched(task)])


def effective_bandwidth(vehicle: Vehicle, timestep: float) -> float | None:
    """Returns the corner frequency of a lag that stands for actuators, delay and hold [rad/s]; None for an ideal loop."""
    how, own = vehicle.implementation, vehicle.limits.actuator_bandwidth
    late = (how.delay + 0.5) * (how.sample_period or timestep) if not how.undelayed else 0.0
    time = late + (1 / own if own else 0.0)
    return 1 / time if time else None


def weighted_vehicle(task: Task, weights: Weights) -> Vehicle:
    """Returns the linear vehicle with these weights and the lag of the design."""
    line, room = task.line, task.room
    points = line.ride_points.worst_of
    comfort = max(task.rms[name] for name in points) if points else 1.0
    performance = {}
    for one in line.kind.suspensions:
        performance[one.deflection] = np.exp(weights.travel) * 3 * comfort / min(room.strokes[one.deflection])
    for name, deflection in line.kind.static_tyre_deflection(line.parameters).items():
        performance[name] = np.exp(weights.tyre) * 3 * comfort / deflection
    for name, force in room.forces.items():
        performance[name] = np.exp(weights.force) * 3 * comfort / force
    rows = body_rows(line, points) if points else np.zeros((0, 0))
    sums = tuple(
        WeightedSum(f"ride_{i + 1}", float(np.exp(weights.ride)), dict(zip(points, row.tolist(), strict=True)), WK)
        for i, row in enumerate(rows)
    )
    bandwidth = effective_bandwidth(line, task.timestep)
    performance = {name: float(value) for name, value in performance.items()}
    return replace(
        line,
        performance=performance,
        filters={},
        road_filter=None,
        sums=sums,
        sampled=False,
        limits=replace(line.limits, actuator_bandwidth=bandwidth),
    )


def design(
    task: Task, name: str, measured: Sequence[str], weights: Weights, method: str = LQG, preview: float = 0.0
) -> Controller:
    """Returns the controller of a method for these weights, as the vehicle's own file has it.

    Args:
        method: `LQG`, "full" (H-infinity of full order), "" (the two steps), or "preview".
        preview: time by which the road is known ahead [s].

    Raises:
        DesignError, InputError: there is no such controller.
    """
    car = weighted_vehicle(task, weights)
    bandwidth, size = car.limits.actuator_bandwidth, float(np.exp(weights.load)) * sum(task.static_loads.values())
    loads = tuple((load, size) for load in car.linear_model.loads if "wheel" not in load)
    noise = tuple(float(np.exp(weights.noise)) * level / task.white for level in task.noise_of(measured))
    if method == LQG:
        posed = problem(car, measured, DesignConditions(bandwidth=bandwidth, loads=loads))
        law = lqg_law(posed.of_states, [noise[i] for i in posed.state_measurements])
        return uncertified(task, name, measured, on_readings(law, posed))
    conditions = DesignConditions(noise, bandwidth, loads) if method == FULL else DesignConditions(bandwidth=bandwidth)
    request = DesignRequest(design=method, preview=preview)
    entry = ControllerEntry(name, tuple(measured), request, hardware=conditions)
    found = Designer(replace(car, controllers={name: entry}), search=False).design(name)
    return replace(found, hardware=own_hardware(task))


def own_hardware(task: Task) -> DesignConditions:
    """Returns the conditions of certificates: the lag of the vehicle's own actuators."""
    return DesignConditions(bandwidth=task.pushed.limits.actuator_bandwidth)


def uncertified(task: Task, name: str, measured: Sequence[str], law: LinearLaw) -> Controller:
    """Returns the controller of a law for a search, in which certificates would take most of the time.

    It has the certificate of the passive vehicle until `certified` computes its own.
    """
    return Controller(name, tuple(measured), law, True, task.passive.certificate, hardware=own_hardware(task))


def certified(task: Task, controller: Controller) -> Controller:
    """Returns a controller with its certificate for the weights of the vehicle file.

    Raises:
        InputError: the law has no loop.
    """
    car = task.vehicle.with_force_actuators if task.vehicle.dampers else task.vehicle
    found = Designer(car, search=False).certify(controller.name, controller.measured, controller.law, own_hardware(task))
    return replace(found, designed=True)
