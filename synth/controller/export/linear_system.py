"""Linear systems with named inputs, states and outputs: a vehicle alone, and with its controller, as others import them."""

from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.kinds.signals import Signal, kept_signals, load_signal
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller
from synth.controller.open_loop import with_lag


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """The system x' = A x + B u, y = C x + D u, measured from static equilibrium.

    Attributes:
        A, B, C, D: shapes (n, n), (n, m), (p, n), (p, m).
        inputs: m signals: the roads' velocities, their heights where these act, loads, then forces where no law gives them.
        states: n signals.
        outputs: p signals.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    inputs: tuple[Signal, ...]
    states: tuple[Signal, ...]
    outputs: tuple[Signal, ...]


def vehicle_system(vehicle: Vehicle) -> LinearSystem:
    """Returns a vehicle as a system from roads, loads and requested forces to its signals, with its actuators' lag."""
    model, kind, wheels = with_lag(vehicle), vehicle.kind, vehicle.kind.wheels
    signals = [kind.signal(wheel.road_velocity) for wheel in wheels]
    n, p, loads = len(model.A), len(model.C), [load_signal(name) for name in model.loads]
    columns, through = [model.Bw], [np.zeros((p, len(wheels)))]
    if np.any(model.Br) or np.any(model.Cr):
        signals += [kind.signal(wheel.road_displacement) for wheel in wheels]
        columns.append(model.Br)
        through.append(model.Cr)
    forces = [kind.signal(name) for name in model.inputs]
    kept = [i for i, name in enumerate(model.outputs) if name not in model.inputs]
    return LinearSystem(
        model.A,
        np.hstack([*columns, model.Bl.reshape(n, -1), model.B]),
        model.C[kept],
        np.hstack([*through, model.Dl.reshape(p, -1), model.D])[kept],
        (*signals, *loads, *forces),
        tuple(kind.signal(name) for name in model.states),
        tuple(kind.signal(model.outputs[i]) for i in kept),
    )


def loop_system(vehicle: Vehicle, controller: Controller) -> LinearSystem:
    """Returns a vehicle with a controller, in continuous time, as a system from roads and loads to its signals and forces.

    Raises:
        InputError: a discrete law has no continuous counterpart, or its loop through the measurements no solution.
    """
    model, whole = with_lag(vehicle), vehicle_system(vehicle)
    m, n = len(model.inputs), len(model.A)
    outside, measured = whole.B[:, :-m], [model.outputs.index(name) for name in controller.measured]
    direct = np.zeros((len(model.C), outside.shape[1]))
    direct[[model.outputs.index(one.name) for one in whole.outputs]] = whole.D[:, :-m]
    law = controller.law.continuous().fed_back(model.D[measured])
    Cy, Dy, k = model.C[measured], direct[measured], law.states
    force, of_force = np.hstack([law.D @ Cy, law.C]), law.D @ Dy
    return LinearSystem(
        np.block([[model.A, np.zeros((n, k))], [law.B @ Cy, law.A]]) + np.vstack([model.B, np.zeros((k, m))]) @ force,
        np.vstack([outside + model.B @ of_force, law.B @ Dy]),
        np.hstack([model.C, np.zeros((len(model.C), k))]) + model.D @ force,
        direct + model.D @ of_force,
        whole.inputs[:-m],
        (*whole.states, *kept_signals(range(1, k + 1))),
        tuple(vehicle.kind.signal(name) for name in model.outputs),
    )
