"""Effect of rounding on the signals of a run.

Rounding moves signals whatever the road. MuJoCo holds a vehicle up by lengths of about a metre, rounded to 1e-16 of it, and
by balanced forces of its whole weight. The error of a signal is the same over a bump of a decimetre and of a micrometre. The
model of it: every length among the states moves by a few roundings, every velocity by that times the vehicle's fastest rate.
The outputs follow from the linear model.
"""

import numpy as np

from models.common.arrays import Array
from models.common.extensions import FEATURES
from models.laws.linear import LinearLaw
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import AnyController

LENGTH = 16 * float(np.finfo(float).eps)  # m or rad; measured over roads of 1e-9 m: up to 5e-16 m, in 20000 steps
LENGTHS = ("m", "rad")
RATES = 400  # number of frequencies at which a law's gain is evaluated


def roundings(vehicle: Vehicle, controller: AnyController | None) -> dict[str, float]:
    """Bounds the effect of rounding on every output signal [the signal's unit]; without a linear one, under given forces."""
    model = vehicle.linear_model
    rate, moved_states = effect_on_states(vehicle)
    pushed = np.zeros(len(model.inputs))
    if vehicle.dampers:  # the force of a damper is rounded as its velocity is
        pushed[[model.inputs.index(one.force) for one in vehicle.parts.adjustable]] = [
            one.steepest_slope for one in vehicle.parts.adjustable
        ]
        pushed *= np.abs(FEATURES.load("dampers in linear analysis").stretching_rates(vehicle)) @ moved_states
    if controller is None or controller.linear is False:
        return dict(zip(model.outputs, (np.abs(model.C) @ moved_states + np.abs(model.D) @ pushed).tolist(), strict=True))
    gain = _largest_gain(controller.law_on_states(vehicle), rate) @ np.abs(model.rows(controller.measured)[0])
    if controller.law.states:  # its forces may far exceed those of a static gain, and move the states
        moved_states = moved_states + np.abs(model.B) @ (gain @ moved_states) / rate
    moved = np.abs(model.C) @ moved_states + np.abs(model.D) @ (pushed + gain @ moved_states)
    return dict(zip(model.outputs, moved.tolist(), strict=True))


def effect_on_states(vehicle: Vehicle) -> tuple[float, Array]:
    """Returns the fastest rate [rad/s], and the effect of rounding on every state, shape (n,)."""
    model, kind = vehicle.linear_model, vehicle.kind
    rate = float(np.abs(np.linalg.eigvals(model.A)).max())
    n = len(model.states) - len(kind.of_parts)
    moved_states = np.array([LENGTH if kind.signal(name).unit in LENGTHS else rate * LENGTH for name in model.states[:n]])
    of_parts = np.abs(model.A[n:, :n]) @ moved_states / (rate or 1.0)  # in any unit
    return rate, np.concatenate([moved_states, of_parts])


def _largest_gain(law: LinearLaw, fastest: float) -> Array:
    """Returns a law's largest gain on each measurement, at rates up to twice that of the vehicle [rad/s], shape (m, q).

    The lowest rate is a wave of minutes, longer than a run, as the gain of an integrator below it does not matter in a run.
    """
    if not law.states:
        return np.abs(law.D)
    s = 1j * np.geomspace(1e-4, 2.0, RATES)[:, None, None] * fastest
    moving = np.linalg.solve(s * np.eye(law.states) - law.A, np.broadcast_to(law.B.astype(complex), (RATES, *law.B.shape)))
    return np.abs(law.C @ moving + law.D).max(axis=0)
