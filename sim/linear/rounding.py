"""How far rounding moves the signals of a vehicle in MuJoCo, whatever the road.

MuJoCo holds a vehicle up by lengths of about a metre, rounded to 1e-16 of it, and forces of its whole weight that balance. What
that makes of a signal is the same over a bump of a decimetre and over one of a micrometre. It is as if every length among the
states were shaken by a few roundings: then velocities are by that times the vehicle's fastest rate, and what is read out of both
follows from the linear model.
"""

from collections.abc import Mapping

import numpy as np

from models.common.arrays import Array
from models.law import LinearLaw
from models.reality import steps_per_sample
from models.vehicle import Vehicle
from synth.controller import Controller
from synth.implemented.loop import implemented_loop

LENGTH = 16 * float(np.finfo(float).eps)  # m or rad; measured over roads of 1e-9 m: up to 5e-16 m, in 20000 steps
LENGTHS = ("m", "rad")
RATES = 400  # at which a law is asked what it makes of a measurement


def roundings(vehicle: Vehicle, controller: Controller | None) -> dict[str, float]:
    """How far rounding moves every output signal [the signal's unit], at most; without a controller, under given forces."""
    model = vehicle.linear_model
    rate, shaken = _shaken(vehicle)
    if controller is None:
        return dict(zip(model.outputs, (np.abs(model.C) @ shaken).tolist(), strict=True))
    gain = _most_asked(controller.law_on_states(vehicle), rate) @ np.abs(model.rows(controller.measured)[0])
    if controller.law.states:  # it may ask for far more than a static gain would, and what it asks for moves the states
        shaken = shaken + np.abs(model.B) @ (gain @ shaken) / rate
    moved = np.abs(model.C) @ shaken + np.abs(model.D) @ (gain @ shaken)
    return dict(zip(model.outputs, moved.tolist(), strict=True))


def grown(
    rounding: Mapping[str, float], vehicle: Vehicle, controller: Controller, timestep: float, samples: int
) -> dict[str, float]:
    """The same in a run of an unstable loop: rounding grows there, in each signal as far as the loop carries it.

    Args:
        rounding: see `roundings`.
        vehicle: the vehicle.
        controller: its controller.
        timestep: [s].
        samples: of the run.
    """
    loop = implemented_loop(vehicle, controller, timestep)
    model, shaken = loop.cut.model, _shaken(vehicle)[1]
    rows = np.eye(len(model.A), len(loop.transition))
    rows = model.C @ rows + model.D @ loop.parts[0].inputs
    state = np.eye(len(loop.transition), len(shaken)) * shaken
    most = np.zeros(len(rows))
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(samples // steps_per_sample(vehicle.implementation, timestep)):
            state = loop.transition @ state
            most = np.fmax(most, np.abs(rows @ state).sum(axis=1))
    return {name: max(far, float(more)) for (name, far), more in zip(rounding.items(), most, strict=True)}


def _shaken(vehicle: Vehicle) -> tuple[float, Array]:
    """The fastest rate [rad/s], and how far rounding shakes every state, shape (n,)."""
    model, kind = vehicle.linear_model, vehicle.kind
    rate = float(np.abs(np.linalg.eigvals(model.A)).max())
    return rate, np.array([LENGTH if kind.signal(name).unit in LENGTHS else rate * LENGTH for name in model.states])


def _most_asked(law: LinearLaw, fastest: float) -> Array:
    """The most that a law makes of each measurement, at whatever rate up to twice that of the vehicle [rad/s], shape (m, q)."""
    if not law.states:
        return np.abs(law.D)
    s = 1j * np.concatenate([[0.0], np.geomspace(1e-4, 2.0, RATES) * fastest])[:, None, None]
    steady = np.linalg.lstsq(-law.A, law.B)[0][None]  # an integrator asks for what it has come to
    moving = np.linalg.solve(s[1:] * np.eye(law.states) - law.A, np.broadcast_to(law.B.astype(complex), (RATES, *law.B.shape)))
    return np.abs(law.C @ np.concatenate([steady, moving]) + law.D).max(axis=0)
