"""Laws that one would tune by hand: skyhook, skyhook with feedback of travel, semi-active laws, and another damper or spring.

The skyhook of a car of any type: each force damps the body's velocity over its own suspension. Velocities are those of sensors,
or integrals of accelerometers with a corner frequency, as coefficients of the body's modes by least squares:

    xi' = a - w_c xi,    v = J G^+ (velocities, xi),    u = -c S v - m_v S J G^+ a.

J are the velocities over the suspensions by those of the body, G what each sensor measures of them, and S the share of each
suspension in the static load. m_v is a virtual mass. With travel d, the law has c_d times its filtered derivative and k d, too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.laws.linear import LinearLaw
from models.laws.semi_active import LAWS, MODES, SemiActive, SemiActiveLaw
from models.vehicle.vehicle import Vehicle
from sim.studies.recommend.optimal import uncertified
from sim.studies.recommend.task import Candidate, Task

EXACT = 1e-6  # relative: of a sensor that is a sum of the body's velocities, or of their rates
BODY = ("sprung_velocity", *MODES)
RATE, CORNER = 10.0, 1.0  # rad/s: usual damping over mass, and corner frequency of an integral
MASS, SIDE_DAMPING, STIFFNESS = 0.1, 0.1, 0.25  # usual virtual mass, damping and stiffness over mass, over RATE, over RATE^2
FASTEST = 200.0  # rad/s, of the filtered derivative of travel
DAMPER, SPRING = (0.5, 2.0), (0.7, 1.5)  # range of factors on the passive damper and spring
SKY = (0.15, 0.3, 0.6, 1.0, 1.5)  # sky damping over the largest coefficient
MIX, CROSSOVER = (0.5, 0.75, 0.9), (8.0, 12.0, 20.0)


@dataclass(frozen=True, eq=False)
class BodySensors:
    """Sensors of the body's velocity.

    Attributes:
        velocities, accelerations: names of q velocity sensors and p accelerometers.
        over: velocities over the suspensions by those of the sensors and integrals, shape (m, q + p).
        travels: deflections that are measured, by index of the force.
    """

    velocities: tuple[str, ...]
    accelerations: tuple[str, ...]
    over: Array
    travels: Mapping[int, str]


def body_sensors(task: Task) -> BodySensors | None:
    """Returns the sensors of the body's velocity; None if the file has none."""
    model, kind = task.line.linear_model, task.line.kind
    moving = [i for i, name in enumerate(model.states) if name in BODY]
    others = np.setdiff1d(np.arange(len(model.A)), moving)
    place = {one.force: one.deflection for one in kind.suspensions}
    if not moving or not all(force in place for force in model.inputs):
        return None
    J = (model.rows([place[force] for force in model.inputs])[0] @ model.A)[:, moving]
    rates = np.hstack([model.A, model.B])[moving]
    velocities, accelerations, rows, more = list[str](), list[str](), list[Array](), list[Array]()
    for name in task.sensors:
        C, D = (one[0] for one in model.rows([name]))
        if np.abs(C[moving]).max() > EXACT and np.abs(C[others]).max(initial=0.0) <= EXACT and not D.any():
            velocities.append(name)
            rows.append(C[moving])
            continue
        both = np.concatenate([C, D])
        share = np.linalg.lstsq(rates.T, both)[0]
        if D.any() and np.abs(share @ rates - both).max() <= EXACT * np.abs(both).max():
            accelerations.append(name)
            more.append(share)
    if not rows and not more:
        return None
    over = J @ np.linalg.pinv(np.array([*rows, *more]))
    travels = {i: place[force] for i, force in enumerate(model.inputs) if place[force] in task.sensors}
    return BodySensors(tuple(velocities), tuple(accelerations), over, travels)


def skyhook(task: Task, sensors: BodySensors, name: str, x: Sequence[float], with_travel: bool) -> Candidate:
    """Returns the skyhook of a point of the search.

    Args:
        x: logarithms of damping, corner frequency and virtual mass over the usual ones; with travel also its damping and
            stiffness over the usual ones.
    """
    q, p = len(sensors.velocities), len(sensors.accelerations)
    masses = np.array([load / 9.81 for load in task.static_loads.values()])[:, None]
    damping, corner, mass = (float(np.exp(min(one, 6.0))) for one in x[:3])
    over = masses * sensors.over
    m, measured = len(masses), [*sensors.velocities, *sensors.accelerations]
    A, B = -CORNER * corner * np.eye(p), np.hstack([np.zeros((p, q)), np.eye(p)])
    C, D = -RATE * damping * over[:, q:], np.hstack([-RATE * damping * over[:, :q], -MASS * mass * over[:, q:]])
    text = f"c {RATE * damping * masses.mean():.0f} N s/m"
    if p:
        text += f", corner {CORNER * corner:.2g} rad/s, virtual mass {MASS * mass * masses.mean():.0f} kg"
    if with_travel:
        own = SIDE_DAMPING * RATE * masses[:, 0] * x[3]
        stiffness = STIFFNESS * RATE**2 * masses[:, 0] * x[4]
        k = len(sensors.travels)
        into, direct, states = np.zeros((p + k, q + p + k)), np.zeros((m, q + p + k)), np.zeros((m, p + k))
        into[:p, : q + p], direct[:, : q + p], states[:, :p] = B, D, C
        for j, i in enumerate(sensors.travels):  # the derivative FASTEST (d - FASTEST eta) of eta' = d - FASTEST eta
            into[p + j, q + p + j] = 1.0
            direct[i, q + p + j] = -own[i] * FASTEST - stiffness[i]
            states[i, p + j] = own[i] * FASTEST**2
        A = np.block([[A, np.zeros((p, k))], [np.zeros((k, p)), -FASTEST * np.eye(k)]])
        B, C, D, measured = into, states, direct, [*measured, *sensors.travels.values()]
        text += f", travel {own.mean():.0f} N s/m and {stiffness.mean():.0f} N/m"
    controller = uncertified(task, name, measured, LinearLaw(A, B, C, D))
    return Candidate(name, name, controller, task.vehicle, text)


def changed_passive(task: Task, name: str, x: Sequence[float]) -> Candidate:
    """Returns the passive car with another damper and spring.

    Args:
        x: logarithms of the factors on every damper and, if given, every spring.
    """
    factors = [float(np.clip(np.exp(one), *ends)) for one, ends in zip(x, (DAMPER, SPRING), strict=False)]
    damper, spring = (*factors, 1.0)[:2]
    text = f"damper x {damper:.2f}" + (f", spring x {spring:.2f}" if len(factors) > 1 else "")
    return Candidate(name, "passive", task.passive, with_factors(task.vehicle, damper, spring), text)


def with_factors(vehicle: Vehicle, damper: float, spring: float) -> Vehicle:
    """Returns a vehicle with factors on its dampers and springs."""
    factors = dict[str, float]()
    for one in vehicle.kind.suspensions:
        factors |= {key: factor for key, factor in ((one.damping, damper), (one.stiffness, spring)) if key}
    parameters = {name: value * factors.get(name, 1.0) for name, value in vehicle.parameters.items()}
    curves = {name: curve.scaled(factors.get(name, 1.0)) for name, curve in vehicle.curves.items()}
    return replace(vehicle, parameters=parameters, curves=curves)


def semi_active(task: Task) -> list[Candidate]:
    """Returns semi-active laws with several values of their keys, for a vehicle with adjustable dampers."""
    vehicle, found = task.vehicle, list[Candidate]()
    endings = [one.ending for force in vehicle.linear_model.inputs for one in vehicle.kind.suspensions if one.force == force]
    modes = tuple(mode for mode in MODES if mode in vehicle.linear_model.outputs)
    largest = max((getattr(one, "c_max", 0.0) for one in vehicle.dampers.values()), default=0.0)
    for name, (_, _, own) in LAWS.items():
        sky = [{"sky_damping": share * largest} for share in SKY]
        values: list[dict[str, float]] = [{}]
        if name == "hybrid":
            values = [{"sky_damping": share * largest, "mix": mix} for share in SKY[1:4] for mix in MIX]
        elif "sky_damping" in own:
            values = sky
        elif "crossover" in own:
            values = [{"crossover": one} for one in CROSSOVER]
        if name == "skyhook_modal" and not modes:
            continue
        for one in values:
            law = SemiActiveLaw(name, tuple(one.items()), tuple(endings), modes if name == "skyhook_modal" else ())
            if all(signal in vehicle.linear_model.outputs for signal in law.measured):
                text = ", ".join(f"{key} {value:g}" for key, value in one.items())
                found.append(Candidate(name, name, SemiActive(name, law), vehicle, text))
    return found
