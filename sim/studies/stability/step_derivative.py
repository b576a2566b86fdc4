"""Derivative of a MuJoCo step at equilibrium.

The state z contains positions, velocities, internal states of parts, and the forces of actuators with a lag. If the forces u
act, a step changes z to A z + B u. The sensors before the step measure C z + D u, where u contains the forces of the previous
step.
"""

from functools import lru_cache

import numpy as np

from models.common.errors import InputError
from models.vehicle.mjcf import quiet
from models.vehicle.vehicle import Vehicle
from sim.drive.sensor_readout import batch_of, prepared_readout, states_of_parts
from synth.plant.state_space import StateSpace

MOTION, FORCE = 1e-5, 1e-2  # steps of the finite differences [m or rad; N]; nonlinear geometry causes a relative error of 1e-9
SMOOTH = 1e-3  # largest relative difference that is allowed between forward and backward differences


@lru_cache(maxsize=16)
def step_derivative(vehicle: Vehicle, timestep: float) -> StateSpace:
    """Returns the derivative of a MuJoCo step at equilibrium on a flat road, by central differences.

    The states are positions, velocities, internal states of parts, and the forces of actuators with a lag. The states that are
    forces have the names of these forces. The outputs of the derivative are the signals of the vehicle.

    Args:
        vehicle: vehicle that MuJoCo simulates.
        timestep: timestep of the simulation [s].

    Raises:
        InputError: the step cannot be differentiated, because the characteristic of a spring or damper has a kink at
            equilibrium.
    """
    model, readout = prepared_readout(vehicle, timestep)
    own, m = readout.of_parts.shape[1], len(vehicle.linear_model.inputs)
    n = model.nq + model.nv + own + model.na
    sizes = np.concatenate([np.full(n - model.na, MOTION), np.full(model.na + m, FORCE)])
    batch = batch_of(model, [vehicle] * (2 * len(sizes) + 1))
    parts = [batch.bind("qpos"), batch.bind("qvel"), states_of_parts(batch), batch.bind("act")]
    away = np.concatenate([np.diag(sizes), -np.diag(sizes), np.zeros((1, n + m))])
    ends = np.cumsum([0, *(part.shape[1] for part in parts)])
    for part, start in zip(parts, ends, strict=False):
        part[:] = away[:, start : start + part.shape[1]]
    batch.bind("ctrl")[:, :m], sensors = away[:, n:], batch.bind("sensordata")
    with quiet():
        batch.forward()
        seen = sensors @ readout.of_sensors.T + parts[2] @ readout.of_parts.T
        batch.step()
    values = np.hstack([*parts, seen])
    up, down = values[: n + m] - values[-1], values[-1] - values[n + m : -1]
    slopes = (up + down) / (2 * sizes[:, None])
    if np.any(np.abs(up - down).max(axis=0) > SMOOTH * np.abs(up + down).max(axis=0)):
        raise InputError(
            "the equations of the vehicle have no derivative at equilibrium, because a curve has a kink there; first "
            "linearise the vehicle with sim.linear.nonlinear_elements.at_rest"
        )
    A, B, C, D = slopes[:n, :n].T, slopes[n:, :n].T, slopes[:n, n:].T, slopes[n:, n:].T
    forces = vehicle.linear_model.inputs
    states = (*(f"motion_{i}" for i in range(n - model.na)), *forces[: model.na])
    return StateSpace(A, B, C, D, forces, readout.names, timestep, states)
