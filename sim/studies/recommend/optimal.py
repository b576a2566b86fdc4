"""Optimal control laws for a vehicle's sensors: LQG, H-infinity (full order, fixed order, static), and preview.

The plant is the linear vehicle with a first-order lag in each control force. The time constant of the lag accounts for
actuator, delay and hold: 1 / bandwidth + (delay + 1/2) sample periods. The road velocity is modelled as white noise with the
intensity of the road. Vertical accelerations of the ride points are filtered by W_k.

Weights are expressed as powers of e relative to typical values, so the search needs no units. The typical value of a weight is
the passive vehicle's rms acceleration, divided by a third of the range of the weighted signal. The range of a signal is the
suspension stroke, the static tyre deflection or the largest force.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from models.common.extensions import METHODS
from models.laws.design_methods import PREVIEW
from models.laws.design_request import DesignRequest, LawStructure
from models.laws.filter import WEIGHTINGS, Filter
from models.laws.linear import LinearLaw
from models.vehicle.controllers import ControllerEntry, DesignConditions
from models.vehicle.performance import WeightedSum
from models.vehicle.vehicle import Vehicle
from sim.studies.recommend.task import Task
from synth.analysis.lower_bounds.lower_bound import LowerBound
from synth.controller.controller import Controller, on_readings
from synth.controller.problem import Problem, problem
from synth.design.descent.landscape import Work
from synth.design.fixed_order.reduction import reductions
from synth.design.full_order.quadratic import lqg_law
from synth.design.full_order.riccati import LARGEST, RiccatiSearch
from synth.design.problem import DesignProblem, quiet
from synth.plant.numerics import DesignError
from synth.vehicle.designer import Designer

LQG, PREVIEW_TIME = "lqg", 0.2  # s, time for which the road ahead is known
WK = Filter(WEIGHTINGS["iso2631_wk"], "iso2631_wk")
# exponents of the usual weights, which are powers of e
USUAL: Mapping[str, float] = {"ride": -1.0, "travel": -1.5, "tyre": -2.5, "force": -1.0, "load": -2.0, "noise": 0.0}
# for each goal, the weight that is fixed at 1 and not searched for
FIXED = {"ride": "ride", "holding": "tyre", "travel": "travel"}
Weights = Mapping[str, float]
# The H-infinity design adds noise and cost to the plant, as a share of the plant's own terms; without them, its Riccati
# equations may have no solution. A larger share leads to larger stability margins.
SHARE, SHARES = "share", (-1.0, 2.0)  # name of the variable s that determines the share, which is 10^(-1 - 2 s), and range of s
ABOVE = 1.2  # level of an H-infinity law relative to the smallest level at which a law exists
NORMS = 200  # largest number of norms that the search for a law with fewer states computes


def searched(task: Task) -> list[str]:
    """Returns the names of the weights that the search varies for the goal of a task."""
    return [name for name in USUAL if name != FIXED[task.goal]]


def weighted_vehicle(task: Task, weights: Weights, delayed: bool = True) -> Vehicle:
    """Returns the linear vehicle with these weights and the lag of the actuators; `delayed` adds a lag that accounts for delay
    and hold.
    """
    line, how, lag = task.line, task.line.implementation, task.line.limits.actuator_bandwidth
    late = (how.delay + 0.5) * (how.sample_period or task.timestep) if delayed and not how.undelayed else 0.0
    bandwidth = 1 / (late + (1 / lag if lag else 0.0)) if late or lag else None
    points, factors = line.ride_points.worst_of, {name: math.exp(one) for name, one in weights.items()}
    comfort, sums = max((task.rms[name] for name in points), default=1.0), tuple[WeightedSum, ...]()
    tyres = line.kind.static_tyre_deflection(line.parameters)
    sizes = {name: (min(stroke), "travel") for name, stroke in task.strokes.items()}
    sizes |= {name: (static, "tyre") for name, static in tyres.items()}
    sizes |= {name: (one, "force") for name, one in task.forces.items()}
    performance = {name: factors.get(what, 1.0) * 3 * comfort / size for name, (size, what) in sizes.items()}
    # orthogonal combinations of the points' accelerations have the same sum of squares, so that each mode of the body is
    # filtered only once
    if points:
        turned, shares, _ = np.linalg.svd(np.hstack(line.linear_model.rows(points)), full_matrices=False)
        rows = turned.T[shares > 1e-9 * shares[0]].tolist()
        terms = [dict(zip(points, row, strict=True)) for row in rows]
        sums = tuple(WeightedSum(f"ride_{i + 1}", factors.get("ride", 1.0), one, WK) for i, one in enumerate(terms))
    limits = replace(line.limits, actuator_bandwidth=bandwidth)
    return replace(line, performance=performance, filters={}, road_filter=None, sums=sums, sampled=False, limits=limits)


def design(task: Task, name: str, measured: Sequence[str], weights: Weights, method: str | int = LQG) -> Controller:
    """Returns the controller that a design method finds for a set of weights.

    Args:
        weights: natural logarithm of each weight, relative to its typical value, and `SHARE` for H-infinity, by name.
        method: `LQG`, "full" (full-order H-infinity), "" (static, by the two-step method), the order of a fixed-order law, or
            "preview".

    Raises:
        DesignError, InputError: no controller can be designed for these weights.
    """
    car = weighted_vehicle(task, weights)
    bandwidth, size = car.limits.actuator_bandwidth, math.exp(weights["load"]) * sum(task.static_loads.values())
    if method == PREVIEW:  # preview needs measurements of all states, but no sensor measures the states of a filter
        car = replace(car, sums=tuple(replace(one, filter=None) for one in car.sums))
        request = DesignRequest(design=PREVIEW, preview=PREVIEW_TIME)
        entry = ControllerEntry(name, tuple(measured), request, hardware=DesignConditions(bandwidth=bandwidth))
        return replace(Designer(replace(car, controllers={name: entry}), search=False).design(name), hardware=own_hardware(task))
    loads = tuple((load, size) for load in car.linear_model.loads if "wheel" not in load)
    noise = tuple((math.exp(weights["noise"]) * task.noise_of(measured)).tolist())
    disturbed = DesignConditions(() if method == LQG else noise, bandwidth, loads)
    posed = problem(car, measured, disturbed if method else DesignConditions(bandwidth=bandwidth))
    law = _law(posed, method, [noise[i] for i in posed.state_measurements], weights.get(SHARE, 0.0))
    return uncertified(task, name, measured, on_readings(law, posed))


def _law(posed: Problem, method: str | int, noise: Sequence[float], share: float) -> LinearLaw:
    """Returns the law that a method designs, using the measurements that depend on states; `method` and `share` as for
    `design`.
    """
    plant, given = posed.of_states, DesignProblem(posed.of_states, lower_bound=LowerBound(0.0), alternatives=False)
    if method == LQG:
        return lqg_law(plant, noise)
    if method == "":
        return METHODS.load("two_steps")(given, quiet).law
    search, share = RiccatiSearch(plant, 0.0), 10.0 ** (SHARES[0] - SHARES[1] * share)
    full = search.traded(share, ABOVE * search.smallest(share, LARGEST))
    if full is None:
        raise DesignError("its Riccati equations have no solution")
    if not isinstance(method, int):
        return full.law
    start = replace(given, structure=LawStructure(method), known=[*reductions(plant, full.law, method)], work=Work(NORMS))
    return METHODS.load("structured")(start, quiet).law


def own_hardware(task: Task) -> DesignConditions:
    """Returns the design conditions for certificates, which include only the lag of the vehicle's actuators."""
    return DesignConditions(bandwidth=task.pushed.limits.actuator_bandwidth)


def uncertified(task: Task, name: str, measured: Sequence[str], law: LinearLaw) -> Controller:
    """Returns a controller that applies a law. The controller carries the certificate of the passive vehicle until `certified`
    replaces this certificate.

    To certify every candidate would take most of the time of a search.
    """
    return Controller(name, tuple(measured), law, True, task.passive.certificate, hardware=own_hardware(task))


def certified(task: Task, one: Controller) -> Controller:
    """Returns a controller together with its certificate for the weights of the vehicle file."""
    designer = Designer(task.vehicle.with_force_actuators if task.vehicle.dampers else task.vehicle, search=False)
    return replace(designer.certify(one.name, one.measured, one.law, own_hardware(task)), designed=True)
