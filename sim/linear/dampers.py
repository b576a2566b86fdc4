"""What adjustable dampers have of signals in a linear response, and what was asked of them in one of physics."""

import numpy as np

from models.common.arrays import Array
from models.suspension.damper_range import range_of
from models.vehicle.vehicle import Vehicle
from sim.response.response import Response
from synth.controller.controller import Controller


def stretching(vehicle: Vehicle) -> Array:
    """V: how fast the suspension of every force is stretched, from the state, shape (m, n); 0 of an actuator that pushes.

    Raises:
        ValueError: a suspension's deflection is no state of the linear model, or jumps with the road.
    """
    model, rows = vehicle.linear_model, []
    for force in model.inputs:
        row = np.zeros(len(model.states))
        if force in vehicle.dampers:
            at = model.states.index(vehicle.kind.pushed(force))
            if np.any(model.B[at]) or np.any(model.Bw[at]) or np.any(model.Br[at]):
                raise ValueError(f"the rate of {model.states[at]} has a force or the road in it")
            row = model.A[at]
        rows.append(row)
    return np.stack(rows)


def is_linear(vehicle: Vehicle, controller: Controller) -> bool:
    """Whether a run of them is linear until something ends that: not where adjustable dampers are asked for forces."""
    return not vehicle.dampers or not controller.law.acts


def bent_velocities(vehicle: Vehicle, velocities: Array) -> Array:
    """What coefficients of adjustable dampers are times, to be forces, from the velocities of the suspensions, shape (..., m)."""
    of = range_of([vehicle.adjustable], vehicle.linear_model.inputs)
    return velocities if of.bent is None else -of.felt(-velocities[..., None, :])[..., 0, :]


def damper_signals(vehicle: Vehicle, beyond: Array, missing: Array) -> dict[str, Array]:
    """The signals of the adjustable dampers, by name.

    Args:
        vehicle: the vehicle.
        beyond: coefficients that act beyond the nominal ones [N s/m], shape (T, m).
        missing: forces that are asked for and not given [N], shape (T, m).
    """
    found, forces = {}, vehicle.linear_model.inputs
    for one in vehicle.adjustable:
        j = forces.index(one.force)
        found |= {one.coefficient: one.nominal + beyond[:, j], one.missing: missing[:, j]}
    return found


def linear_signals(vehicle: Vehicle, states: Array, inputs: Array) -> dict[str, Array]:
    """The same of a linear response, whose forces are all given: what dampers would be for them, and what they would leave out.

    Args:
        vehicle: the vehicle.
        states: of the vehicle, shape (T, n).
        inputs: the forces that act [N], shape (T, m).
    """
    of = range_of([vehicle.adjustable], vehicle.linear_model.inputs)
    closing = of.at_rest - states @ stretching(vehicle).T
    m = inputs.shape[1]
    commands = of.commands(np.concatenate([inputs, closing], axis=-1)[:, None])[:, 0]
    return damper_signals(vehicle, commands[:, :m], commands[:, m:])


def commands_of(vehicle: Vehicle, physics: Response) -> Array:
    """What was asked of the actuators in physics, from its signals, shape (T, 2 m), see `Range.commands`; 0 where it diverged.

    RK4 takes a coefficient that lags to what is asked by its own share, from which that follows.
    """
    forces, h = vehicle.linear_model.inputs, float(physics.time[1] - physics.time[0])
    m = len(forces)
    commands = np.zeros((len(physics.time), 2 * m))
    for j, force in enumerate(forces):
        commands[:, j] = physics[force]
    for one in vehicle.adjustable:
        j = forces.index(one.force)
        acting = physics[one.coefficient] - one.nominal
        commands[:, j], commands[:, m + j] = acting, physics[one.missing]
        if one.damper.bandwidth is not None:
            z = one.damper.bandwidth * h
            share = z * (1 - z / 2 * (1 - z / 3 * (1 - z / 4)))
            commands[:-1, j] = acting[:-1] + np.diff(acting) / share
    return np.nan_to_num(commands, nan=0.0, posinf=0.0, neginf=0.0)


def command_names(vehicle: Vehicle) -> tuple[str, ...]:
    """What a law in Python can ask for of a vehicle, by name: forces, and with adjustable dampers `Range.commands`."""
    forces, coefficients = vehicle.linear_model.inputs, {one.force: one.coefficient for one in vehicle.adjustable}
    if not coefficients:
        return forces
    beyond = (f"{coefficients[force]}_beyond_nominal" if force in coefficients else force for force in forces)
    return (*beyond, *(f"missing_{force}" for force in forces))


def scaled_commands(vehicle: Vehicle, asked: Array, share: float) -> Array:
    """What was asked for over a road, where road and forces are only a share of it: coefficients are the same.

    Args:
        vehicle: the vehicle.
        asked: forces, shape (T, m), or with adjustable dampers commands, shape (T, 2 m).
        share: of the road.
    """
    forces = vehicle.linear_model.inputs
    factors = [1.0 if i < len(forces) and forces[i] in vehicle.dampers else share for i in range(asked.shape[1])]
    return asked * np.array(factors)
