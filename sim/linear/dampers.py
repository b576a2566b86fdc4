"""Computes signals and commands of semi-active dampers from a linear response or from a simulated run."""

import numpy as np

from models.common.arrays import Array
from models.parts.damper_range import range_of
from models.vehicle.suspension_forces import MotionRatios
from models.vehicle.vehicle import Vehicle
from sim.drive.recursion import way_in_step
from sim.drive.response import Response

MOST_SQUARED = 1e150  # N; forces are clipped to this magnitude, so that their squares are finite


def stretching_rates(vehicle: Vehicle) -> Array:
    """Returns the matrix V that maps the state to the extension rate of each semi-active damper, shape (m, n).

    Rows of V that belong to active actuators are zero.

    Raises:
        ValueError: a suspension's deflection is not a state of the linear model, or jumps when the road height jumps.
    """
    model, rows = vehicle.linear_model, []
    for force in model.inputs:
        row = np.zeros(len(model.states))
        if force in vehicle.dampers:
            at = model.states.index(vehicle.kind.deflection_of(force))
            if np.any(model.B[at]) or np.any(model.jump[at]) or np.any(model.Br[at]):
                raise ValueError(f"the rate of {model.states[at]} depends directly on a force or on the road")
            row = vehicle.motion_ratios[force] * model.A[at]
        rows.append(row)
    return np.stack(rows)


def closing_velocities(vehicle: Vehicle, physics: Response) -> Array:
    """Returns the closing velocity of each damper at the samples [m/s], shape (T, m + c); the value is 1 for active actuators.

    The last c columns contain travels and states of voltage-controlled elements, see `CoefficientRange.closing`.
    """
    of = range_of([vehicle])
    states = np.stack([physics[name] for name in vehicle.linear_model.states], axis=-1)
    travels = np.stack([physics[part.deflection] for part in vehicle.kind.suspensions], axis=-1)
    own = states[..., len(vehicle.linear_model.states) - len(vehicle.kind.of_parts) :]
    return of.closing(states @ stretching_rates(vehicle).T * MotionRatios([vehicle]).turns(travels), travels, own)


def damper_signals(vehicle: Vehicle, beyond: Array, missing: Array) -> dict[str, Array]:
    """Returns the signals of the semi-active dampers by name.

    Args:
        beyond: damping coefficients minus the nominal coefficients [N s/m], shape (T, m).
        missing: requested forces minus actual forces [N], shape (T, m).
    """
    signals, forces = {}, vehicle.linear_model.inputs
    for damper in vehicle.parts.adjustable:
        j = forces.index(damper.force)
        signals |= {damper.coefficient: damper.nominal + beyond[:, j], damper.missing: missing[:, j]}
    return signals


def linear_signals(vehicle: Vehicle, states: Array, inputs: Array) -> dict[str, Array]:
    """Returns the damper signals for a linear response in which all requested forces act.

    The returned damping coefficients would produce the requested forces. The returned missing forces are the parts of the
    requested forces that a real damper could not supply, because its range is limited.

    Args:
        states: states of the vehicle at the samples, shape (T, n).
        inputs: forces that act at the samples [N], shape (T, m).
    """
    of = range_of([vehicle])
    model, own = vehicle.linear_model, len(vehicle.kind.of_parts)
    travels = states @ np.array([np.isin(model.states, one.deflection) for one in vehicle.kind.suspensions], dtype=float).T
    closing = of.closing(states @ stretching_rates(vehicle).T, travels, states[:, len(model.states) - own :])
    commands = of.commands(np.concatenate([inputs, closing], axis=-1)[:, None])[:, 0]
    return damper_signals(vehicle, *np.split(commands, 2, axis=-1))


def commands_of(vehicle: Vehicle, physics: Response) -> Array:
    """Returns the commands of the actuators in a simulated run, shape (T, 2 m); 0 after the run diverged.

    See `CoefficientRange.commands`. The command of a lagging coefficient is computed from the coefficient's change in a step,
    because RK4 covers a known fraction of the distance to the command.
    """
    forces, h = vehicle.linear_model.inputs, float(physics.time[1] - physics.time[0])
    m = len(forces)
    commands = np.zeros((len(physics.time), 2 * m))
    for j, force in enumerate(forces):
        commands[:, j] = physics[force]
    for adjustable in vehicle.parts.adjustable:
        j = forces.index(adjustable.force)
        acting = physics[adjustable.coefficient] - adjustable.nominal
        commands[:, j], commands[:, m + j] = acting, physics[adjustable.missing]
        if adjustable.damper.bandwidth is not None:
            commands[:-1, j] = acting[:-1] + np.diff(acting) / way_in_step(adjustable.damper.bandwidth * h)
    return np.nan_to_num(commands, nan=0.0, posinf=0.0, neginf=0.0)


def squarable(forces: Array) -> Array:
    """Returns requested forces [N], clipped to a magnitude whose square is finite.

    The forces of unstable laws may be too large to be squared.
    """
    return np.clip(forces, -MOST_SQUARED, MOST_SQUARED)


def command_names(vehicle: Vehicle) -> tuple[str, ...]:
    """Returns the names of a Python law's commands: forces or, with semi-active dampers, `CoefficientRange.commands`."""
    forces, coefficients = vehicle.linear_model.inputs, {one.force: one.coefficient for one in vehicle.parts.adjustable}
    if not coefficients:
        return forces
    beyond = (f"{coefficients[force]}_beyond_nominal" if force in coefficients else force for force in forces)
    return (*beyond, *(f"missing_{force}" for force in forces))
