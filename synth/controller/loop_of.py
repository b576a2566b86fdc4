"""The loop of a vehicle and its controller, by names: the one place that knows what acts on a vehicle, and what it shows.

In continuous time the disturbances are the road's velocities (`road_velocity`), its heights (`road_velocity.height`), and loads.

A sampled loop holds them over every step. Its states are xi = x - J z_r, as they do not jump where a held road does,

    xi' = A xi + B u + (A J + Br) z_m + Bh f,    signals = C xi + D u + (C J + Cr) z_r + Dh f_s,

with z_m the height midway (`.midway`) and z_r that at the sample (`.height`). The loads and, if tyres damp, the road's mean
velocities are f over a step (`.held`), f_s in signals (`.signal`) and f_r in readings (`.read`), which have noise (`.noise`).

Outputs are the vehicle's signals, the readings (`body_acceleration.read`) and the forces that the actuators are given (`.held`).
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
    """Returns the linear model with its actuators' lag, if they have one: then the acting forces are its last states."""
    return vehicle.linear_model.behind_lag(vehicle.limits.actuator_bandwidth)


def with_ending(names: Iterable[str], ending: str) -> tuple[str, ...]:
    """Returns names with an ending."""
    return tuple(f"{name}{ending}" for name in names)


def pushes(model: LinearModel) -> tuple[str, ...]:
    """Returns the names of what is held over a step beside the road's heights: loads and, if tyres damp, road velocities."""
    return (*model.loads, *(model.disturbances if model.tyres_damp else ()))


def loop_of(
    vehicle: Vehicle,
    controller: Controller,
    timestep: float | None = None,
    exponential: Callable[[Array], Array] = linalg.expm,
) -> Loop:
    """Returns the loop of a vehicle with its actuators' lag: in continuous time, or sampled as in `[implementation]`.

    Args:
        controller: linear controller; its preview is a known force.
        timestep: timestep of the run [s]; None for continuous time without delay.
        exponential: the matrix exponential; `taylor4` to predict an RK4 integrator.

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
    """Returns the plant of `loop_of`: from forces and disturbances to signals, readings and the given forces.

    Args:
        measured: names of the measured signals.
        sampled: True for disturbances that are held over steps.

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
    """Returns the growth per timestep of a sampled loop: above 1 it is unstable, at exactly 1 marginal."""
    return sampled_growth(loop.closed_loop.A) ** (1 / len(loop.by_step))


def road_inputs(model: LinearModel, controller: Controller, omega: Array) -> dict[str, Array]:
    """Returns the inputs of a continuous loop under roads of velocity exp(j omega t), one at each wheel, by name, (F, r) each.

    Args:
        omega: angular frequencies above 0 [rad/s], shape (F,).
    """
    each = np.eye(len(model.disturbances))
    drive = {name: np.broadcast_to(row, (len(omega), len(each))) for name, row in zip(model.disturbances, each, strict=True)}
    if model.Br.any() or model.Cr.any():
        drive |= {f"{name}{HEIGHT}": drive[name] / (1j * omega[:, None]) for name in model.disturbances}
    if controller.preview is not None:
        drive |= dict(zip(model.inputs, np.moveaxis(controller.preview.response(omega), 1, 0), strict=True))
    return drive
