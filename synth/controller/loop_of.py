"""Loop of a vehicle and its controller, with named inputs and outputs. This module defines the inputs that act on a vehicle.

In continuous time, the disturbances are the road velocities (`road_velocity`), the road heights (`road_velocity.height`), and
loads.

In a sampled-data loop, the disturbances are constant during each step. The following state xi = x - J z_r does not jump if a
held road height jumps:

    xi' = A xi + B u + (A J + Br) z_m + Bh f,    signals = C xi + D u + (C J + Cr) z_r + Dh f_s,

where z_m is the road height in the middle of a step (`.midway`), and z_r is the road height at the sample (`.height`). The
vector f (`.held`) contains the loads and, with tyre damping, the mean road velocities, which are constant during each step. The
loads and velocities act on the signals as f_s (`.signal`), and on the measurements as f_r (`.read`). Measurements also contain
noise (`.noise`).

The outputs are the signals of the vehicle, the measurements (`body_acceleration.read`) and the commanded forces of the
actuators (`.held`).
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import error_in
from models.kinds.linear_model import LinearModel
from models.vehicle.limits_and_implementation import hold_intervals
from models.vehicle.vehicle import Vehicle
from synth.analysis.stability import sampled_growth
from synth.controller.controller import Controller
from synth.plant.loop import HoldInterval, Loop
from synth.plant.state_space import StateSpace

HEIGHT, MIDWAY, HELD, SIGNAL, READ, NOISE = ".height", ".midway", ".held", ".signal", ".read", ".noise"


def with_lag(vehicle: Vehicle) -> LinearModel:
    """Returns the linear model, with actuator lag if the vehicle file specifies a lag. With actuator lag, the last states of
    the model are the forces after the lag.
    """
    return vehicle.linear_model.behind_lag(vehicle.limits.actuator_bandwidth)


def with_ending(names: Iterable[str], ending: str) -> tuple[str, ...]:
    """Returns names with the suffix `ending` appended to each name."""
    return tuple(f"{name}{ending}" for name in names)


def pushes(model: LinearModel) -> tuple[str, ...]:
    """Returns the names of the inputs that are constant during each step, apart from road heights: loads and, with tyre
    damping, road velocities.
    """
    return (*model.loads, *(model.disturbances if model.tyres_damp else ()))


def loop_of(
    vehicle: Vehicle,
    controller: Controller,
    timestep: float | None = None,
    exponential: Callable[[Array], Array] = linalg.expm,
) -> Loop:
    """Returns the loop of a vehicle and a controller with actuator lag, in continuous time or sampled as `[implementation]`
    specifies.

    Args:
        vehicle: vehicle of the controller.
        controller: linear controller. The force of the controller's preview is an input of the loop.
        timestep: timestep of the simulation [s]; None for continuous time without delay.
        exponential: function that computes the matrix exponential. With `taylor4`, the loop predicts what an RK4 integrator
            computes.

    Raises:
        InputError: the sample period or the delay is not a multiple of the timestep, or the law cannot be sampled.
    """
    hold = ()
    if timestep is not None:
        hold = tuple(HoldInterval(steps * timestep, late) for steps, late in hold_intervals(vehicle.implementation, timestep))
    plant, measured = plant_of(vehicle, controller.measured, bool(hold)), with_ending(controller.measured, READ)
    loop = Loop(plant, controller.law, measured, vehicle.linear_model.inputs, hold, timestep, exponential)
    with error_in(f"controller {controller.name!r}:"):
        _ = loop.acting_law
    return loop


def plant_of(vehicle: Vehicle, measured: Sequence[str] = (), sampled: bool = False) -> StateSpace:
    """Returns the plant from which `loop_of` builds the loop, from forces and disturbances to signals, measurements and
    commanded forces.

    Args:
        vehicle: vehicle of the plant.
        measured: names of the measured signals.
        sampled: True if the disturbances are constant during each step.

    Raises:
        InputError: the vehicle does not have a measured signal.
    """
    model = with_lag(vehicle)
    C, _ = model.rows(measured)
    rows = [model.outputs.index(name) for name in measured]
    if sampled:
        jump, held = model.C @ model.jump + model.Cr, pushes(model)
        inputs = [
            (model.inputs, model.B, model.D, model.D),
            (with_ending(model.disturbances, MIDWAY), model.A @ model.jump + model.Br, 0 * jump, 0 * jump),
            (with_ending(model.disturbances, HEIGHT), 0 * model.Br, jump, jump),
            (with_ending(held, HELD), model.Bh, 0 * model.Dh, 0 * model.Dh),
            (with_ending(held, SIGNAL), 0 * model.Bh, model.Dh, 0 * model.Dh),
            (with_ending(held, READ), 0 * model.Bh, 0 * model.Dh, model.Dh),
        ]
    else:
        inputs = [
            (model.inputs, model.B, model.D, model.D),
            (model.disturbances, model.Bw, model.Dw, model.Dw),
            (with_ending(model.disturbances, HEIGHT), model.Br, model.Cr, model.Cr),
            (model.loads, model.Bl, model.Dl, model.Dl),
        ]
    names, B, D, D_read = zip(*inputs, strict=True)
    given = np.eye(len(model.inputs), sum(len(one) for one in names))
    plant = StateSpace(
        model.A,
        np.hstack(B),
        np.vstack([model.C, C, np.zeros_like(model.B.T)]),
        np.vstack([np.hstack(D), np.hstack(D_read)[rows], given]),
        sum(names, ()),
        (*model.outputs, *with_ending(measured, READ), *with_ending(model.inputs, HELD)),
        states=model.states,
    )
    noise = np.eye(len(plant.outputs), len(measured), -len(model.outputs))
    return plant.with_inputs(with_ending(measured, NOISE), np.zeros((len(model.A), len(measured))), noise)


def radius(loop: Loop) -> float:
    """Returns the factor by which the motion of a sampled-data loop grows per timestep: above 1 if unstable, exactly 1 if
    marginal.
    """
    return sampled_growth(loop.closed_loop.A) ** (1 / len(loop.by_step))


def road_inputs(model: LinearModel, controller: Controller, omega: Array) -> dict[str, Array]:
    """Returns the inputs of a continuous loop for r roads; on each road, one wheel has the road velocity exp(j omega t).

    Args:
        model: linear model of the vehicle.
        controller: linear controller, whose preview adds forces.
        omega: angular frequencies above 0 [rad/s], shape (F,).

    Returns:
        The complex amplitude of each input, by name, shape (F, r).
    """
    each = np.eye(len(model.disturbances))
    drive = {name: np.broadcast_to(row, (len(omega), len(each))) for name, row in zip(model.disturbances, each, strict=True)}
    if model.Br.any() or model.Cr.any():
        drive |= {f"{name}{HEIGHT}": drive[name] / (1j * omega[:, None]) for name in model.disturbances}
    if controller.preview is not None:
        drive |= dict(zip(model.inputs, np.moveaxis(controller.preview.response(omega), 1, 0), strict=True))
    return drive
