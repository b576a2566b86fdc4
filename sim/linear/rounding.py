"""Effect of rounding errors on the signals of a run.

Rounding errors do not depend on the road. In MuJoCo, lengths of about a metre have a rounding error of 1e-16 m, and large
forces balance the weight of the vehicle. A bump of one decimetre and a bump of one micrometre therefore cause the same rounding
error of a signal. The error model assumes that the error of each state that is a length is a few times the rounding error. The
error of each velocity is the error of a length times the vehicle's fastest rate. The effect of the state errors on the outputs
follows from the linear model.
"""

import numpy as np

from models.common.arrays import Array
from models.common.extensions import FEATURES
from models.laws.linear import LinearLaw
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import AnyController

# assumed rounding error of a length or angle [m or rad]; in 20000 steps over roads of 1e-9 m, at most 5e-16 m was observed
LENGTH = 16 * float(np.finfo(float).eps)
LENGTHS = ("m", "rad")
RATES = 400  # number of frequencies at which the gain of a law is evaluated


def roundings(vehicle: Vehicle, controller: AnyController | None) -> dict[str, float]:
    """Returns a bound on the rounding error of every output signal [unit of the signal].

    The forces that a nonlinear law requests are assumed to have no rounding errors.
    """
    model = vehicle.linear_model
    rate, moved_states = effect_on_states(vehicle)
    pushed = np.zeros(len(model.inputs))
    if vehicle.dampers:  # rounding of the velocity causes a rounding error of the damper's force
        pushed[[model.inputs.index(one.force) for one in vehicle.parts.adjustable]] = [
            one.steepest_slope for one in vehicle.parts.adjustable
        ]
        pushed *= np.abs(FEATURES.load("dampers in linear analysis").stretching_rates(vehicle)) @ moved_states
    if controller is None or controller.linear is False:
        return dict(zip(model.outputs, (np.abs(model.C) @ moved_states + np.abs(model.D) @ pushed).tolist(), strict=True))
    gain = _largest_gain(controller.law_on_states(vehicle), rate) @ np.abs(model.rows(controller.measured)[0])
    # a law with states may compute much larger forces than a static gain, and these forces affect the states of the vehicle
    if controller.law.states:
        moved_states = moved_states + np.abs(model.B) @ (gain @ moved_states) / rate
    moved = np.abs(model.C) @ moved_states + np.abs(model.D) @ (pushed + gain @ moved_states)
    return dict(zip(model.outputs, moved.tolist(), strict=True))


def effect_on_states(vehicle: Vehicle) -> tuple[float, Array]:
    """Returns the fastest rate of the vehicle [rad/s], and the rounding error of every state, shape (n,)."""
    model, kind = vehicle.linear_model, vehicle.kind
    rate = float(np.abs(np.linalg.eigvals(model.A)).max())
    n = len(model.states) - len(kind.of_parts)
    moved_states = np.array([LENGTH if kind.signal(name).unit in LENGTHS else rate * LENGTH for name in model.states[:n]])
    # effect of rounding on the internal states of parts, in the units of these states
    of_parts = np.abs(model.A[n:, :n]) @ moved_states / (rate or 1.0)
    return rate, np.concatenate([moved_states, of_parts])


def _largest_gain(law: LinearLaw, fastest: float) -> Array:
    """Returns the largest gain of a law from each measurement to each force, at frequencies up to twice the vehicle's fastest
    rate, shape (m, q).

    Args:
        law: control law in continuous time, from q measurements to m forces.
        fastest: fastest rate of the vehicle [rad/s].

    The lowest frequency that is evaluated has a period of minutes, which is longer than a run. The gain of an integrator at
    even lower frequencies has no effect in a run.
    """
    if not law.states:
        return np.abs(law.D)
    return np.abs(law.response(np.geomspace(1e-4, 2.0, RATES) * fastest)).max(axis=0)
