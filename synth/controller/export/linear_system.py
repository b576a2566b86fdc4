"""Linear systems for export: a vehicle without controller, and a vehicle with its controller.

All signals are relative to static equilibrium.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.kinds.signals import STATE_PREFIX, Signal, kept_signals, load_signal
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller
from synth.controller.loop_of import HEIGHT, loop_of, plant_of, with_ending, with_lag
from synth.plant.state_space import StateSpace


def vehicle_system(vehicle: Vehicle) -> StateSpace:
    """Returns the linear vehicle with actuator lag.

    The inputs are roads, loads and requested forces. The outputs are the signals of the vehicle.
    """
    model = vehicle.linear_model
    outputs = [name for name in model.outputs if name not in model.inputs]
    return _with_heights(vehicle, plant_of(vehicle)).part(outputs, (*model.disturbances, *model.loads, *model.inputs))


def loop_system(vehicle: Vehicle, controller: Controller) -> StateSpace:
    """Returns the closed loop of a vehicle and a controller in continuous time, from roads and loads to signals and forces.

    Raises:
        InputError: a discrete law has no continuous counterpart, or the algebraic loop through the measurements has no
            solution.
    """
    model, loop = vehicle.linear_model, loop_of(vehicle, controller)
    loop = replace(loop, plant=_with_heights(vehicle, loop.plant))
    states = (*loop.plant.states, *(f"{STATE_PREFIX}{i}" for i in range(1, loop.law.states + 1)))
    return replace(loop.closed_loop.part(model.outputs, (*model.disturbances, *model.loads)), states=states)


def signals_of(vehicle: Vehicle, names: Sequence[str]) -> tuple[Signal, ...]:
    """Returns signals for the inputs, states or outputs with the given names; each signal has a unit and a meaning."""
    model, kind = vehicle.linear_model, vehicle.kind
    known = {name: load_signal(name) for name in model.loads}
    lagged = zip(with_lag(vehicle).states[len(model.states) :], model.inputs, strict=False)
    known |= {name: replace(kind.signal(force), name=name) for name, force in lagged}
    known |= {
        one.name: one
        for name in names
        if name.startswith(STATE_PREFIX)
        for one in kept_signals([name.removeprefix(STATE_PREFIX)])
    }
    return tuple(known.get(name) or kind.signal(name) for name in names)


def _with_heights(vehicle: Vehicle, plant: StateSpace) -> StateSpace:
    """Returns the plant with additional states: the heights of the roads that act on the plant, which are integrals of the road
    velocities.
    """
    roads, heights = vehicle.linear_model.disturbances, plant.columns(with_ending(vehicle.linear_model.disturbances, HEIGHT))
    B, D, r = plant.B[:, heights], plant.D[:, heights], len(roads)
    if not B.any() and not D.any():
        return plant
    into = np.zeros((r, len(plant.inputs)))
    into[:, plant.columns(roads)] = np.eye(r)
    return replace(
        plant,
        A=np.block([[plant.A, B], [np.zeros((r, len(plant.A) + r))]]),
        B=np.vstack([plant.B, into]),
        C=np.hstack([plant.C, D]),
        states=(*plant.states, *(wheel.road_displacement for wheel in vehicle.kind.wheels)),
    )
