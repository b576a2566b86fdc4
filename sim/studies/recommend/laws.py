"""Candidates that are usually tuned by hand: skyhook with or without travel feedback, semi-active laws, and passive cars with
other dampers and springs.

Each skyhook force u damps the velocity of the body above the suspension on which the force acts. The law uses measured
velocities, or integrals xi of the measured accelerations a with a corner frequency w_c:

    xi' = a - w_c xi,    u = -c S J G^+ (velocities, xi) - m_v S J G^+ a.

J maps the velocities of the body to the velocities above the suspensions, and G maps the velocities of the body to the measured
velocities. G^+ is the pseudo-inverse of G. The diagonal of S contains the static load of each suspension divided by gravity. c
is the damping rate, and m_v is a virtual mass. With travel feedback, the law also adds the travel d multiplied by k, and the
filtered derivative of d multiplied by c_d.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from models.common.arrays import Array
from models.common.printed import about, brief
from models.kinds.kind import GRAVITY
from models.laws.linear import LinearLaw
from models.laws.semi_active import LAWS, MODES, SemiActive, SemiActiveLaw
from sim.studies.recommend.optimal import uncertified
from sim.studies.recommend.task import Contender, Task

EXACT = 1e-6  # largest relative error with which a sensor counts as a combination of the body's accelerations
BODY = ("sprung_velocity", *MODES)
# Typical parameters of the laws, each divided by the mass: c [1/s], m_v [1], c_d [1/s] and k [1/s2]
RATE, MASS, SIDE_DAMPING, STIFFNESS = 10.0, 0.1, 1.0, 25.0
FASTEST = 200.0  # rad/s, corner frequency of the filtered derivative of the travel
DAMPER, SPRING = (0.5, 2.0), (0.7, 1.5)  # ranges of the factors that multiply the passive damper and spring
# Values to try: skyhook damping relative to c_max, mix of skyhook and groundhook [1], and crossover frequency [rad/s]
SKY, MIX, CROSSOVER = (0.15, 0.3, 0.6, 1.0, 1.5), (0.5, 0.75, 0.9), (8.0, 12.0, 20.0)


class BodySensors(NamedTuple):
    """Sensors from which the velocity of the body can be determined.

    Attributes:
        velocities, accelerations: names of q velocity sensors and of p accelerometers.
        over: matrix that maps measured velocities and integrated accelerations to the velocities above the suspensions, shape
            (m, q + p).
        travels: name of the measured suspension deflection at each force; an empty name for a force without this measurement.
    """

    velocities: list[str]
    accelerations: list[str]
    over: Array
    travels: list[str]


def body_sensors(task: Task) -> BodySensors | None:
    """Returns the sensors of the body's velocity; None if the vehicle file contains no such sensors."""
    model, place = task.line.linear_model, {one.force: one.deflection for one in task.line.kind.suspensions}
    moving = [i for i, name in enumerate(model.states) if name in BODY]
    if not moving or not {*model.inputs} <= {*place}:
        return None
    J = (model.rows([place[force] for force in model.inputs])[0] @ model.A)[:, moving]
    rates, sensors = np.hstack([model.A, model.B])[moving], ([], [], [], [])
    for name in task.sensors:
        C, D = (one[0] for one in model.rows([name]))
        both = np.concatenate([C, D])
        share = np.linalg.lstsq(rates.T, both)[0]
        accelerates = bool(D.any() and np.abs(share @ rates - both).max() <= EXACT * np.abs(both).max())
        if accelerates or (C[moving].any() and not np.delete(both, moving).any()):
            sensors[accelerates].append(name)
            sensors[2 + accelerates].append(share if accelerates else C[moving])
    velocities, accelerations, rows, more = sensors
    if not rows and not more:
        return None
    travels = [place[force] if place[force] in task.sensors else "" for force in model.inputs]
    return BodySensors(velocities, accelerations, J @ np.linalg.pinv(np.array([*rows, *more])), travels)


def skyhook(task: Task, sensors: BodySensors, name: str, x: Sequence[float], travel: bool) -> Contender:
    """Returns the skyhook candidate for a point of the search.

    Args:
        x: logarithms of c / `RATE`, w_c [rad/s] and m_v / `MASS`; with travel feedback, also c_d / `SIDE_DAMPING` and k /
            `STIFFNESS`.
    """
    q, p = len(sensors.velocities), len(sensors.accelerations)
    masses = np.array([load / GRAVITY for load in task.static_loads.values()])
    c, corner, mass = (math.exp(min(one, 6.0)) for one in x[:3])
    over, measured = masses[:, None] * sensors.over, [*sensors.velocities, *sensors.accelerations]
    A, B = -corner * np.eye(p), np.eye(p, q + p, q)
    C, D = -RATE * c * over[:, q:], np.hstack([-RATE * c * over[:, :q], -MASS * mass * over[:, q:]])
    text = f"c {brief(RATE * c * masses.mean())} N s/m"
    text += f", corner {about(corner)} rad/s, virtual mass {about(MASS * mass * masses.mean())} kg" if p else ""
    if travel:
        there = [i for i, deflection in enumerate(sensors.travels) if deflection]
        at, k, c_d, spring = np.eye(len(masses))[:, there], len(there), SIDE_DAMPING * x[3], STIFFNESS * x[4]
        # The filtered derivative of the travel d is FASTEST (d - FASTEST eta), where the filter state eta has the rate d -
        # FASTEST eta.
        A = np.block([[A, np.zeros((p, k))], [np.zeros((k, p)), -FASTEST * np.eye(k)]])
        B = np.block([[B, np.zeros((p, k))], [np.zeros((k, q + p)), np.eye(k)]])
        C = np.hstack([C, c_d * FASTEST**2 * masses[:, None] * at])
        D = np.hstack([D, -(c_d * FASTEST + spring) * masses[:, None] * at])
        measured += [sensors.travels[i] for i in there]
        text += f", travel {about(c_d * masses.mean())} N s/m and {about(spring * masses.mean())} N/m"
    return Contender(name, uncertified(task, name, measured, LinearLaw(A, B, C, D)), task.vehicle, text)


def changed_passive(task: Task, name: str, x: Sequence[float]) -> Contender:
    """Returns the passive car after its dampers and springs were multiplied by two factors; x contains the logarithms of these
    factors.
    """
    factors, vehicle = dict[str, float](), task.vehicle
    damper, spring = (*(float(np.clip(math.exp(one), *ends)) for one, ends in zip(x, (DAMPER, SPRING), strict=False)), 1.0)[:2]
    for one in vehicle.kind.suspensions:
        factors |= {one.damping: damper, one.stiffness: spring}
    parameters = {key: value * factors.get(key, 1.0) for key, value in vehicle.parameters.items()}
    curves = {key: curve.scaled(factors.get(key, 1.0)) for key, curve in vehicle.curves.items()}
    text = f"damper x {about(damper)}" + f", spring x {about(spring)}" * (len(x) > 1)
    return Contender(name, task.passive, replace(vehicle, parameters=parameters, curves=curves), text)


def semi_active(task: Task) -> list[Contender]:
    """Returns semi-active laws, each with several sets of parameter values; empty if the vehicle has no semi-active dampers."""
    model, candidates = task.vehicle.linear_model, list[Contender]()
    places = {one.force: one.ending for one in task.vehicle.kind.suspensions}
    most = max((getattr(one, "c_max", 0.0) for one in task.vehicle.dampers.values()), default=0.0)
    for name, (_, _, own) in LAWS.items() if task.vehicle.dampers else ():
        values = [{"sky_damping": share * most} for share in SKY] if "sky_damping" in own and most else [{}]
        values = [one | {"mix": mix} for one in values for mix in MIX] if "mix" in own else values
        values = [{"crossover": one} for one in CROSSOVER] if "crossover" in own else values
        modal = name == "skyhook_modal"
        of_body = tuple(mode for mode in MODES if modal and mode in model.outputs)
        for one in values:
            law = SemiActiveLaw(name, tuple(one.items()), tuple(places.get(force, "") for force in model.inputs), of_body)
            if {*law.measured} <= {*model.outputs} and (of_body or not modal):
                text = ", ".join(f"{key} {brief(value)}" for key, value in one.items())
                candidates.append(Contender(f"{name} law", SemiActive(name, law), task.vehicle, text))
    return candidates
