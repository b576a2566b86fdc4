"""Linear systems with named inputs, states and outputs: a vehicle alone, and with its controller, as others import them."""

from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.kinds.signals import Signal, kept_signals, load_signal
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller
from synth.controller.loop_of import with_lag


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """The system x' = A x + B u, y = C x + D u, measured from static equilibrium.

    Attributes:
        A, B, C, D: shapes (n, n), (n, m), (p, n), (p, m).
        inputs: m signals: the roads' velocities, loads, then forces where no law gives them.
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
    whole, forces = _all_signals(vehicle), vehicle.linear_model.inputs
    kept = [i for i, one in enumerate(whole.outputs) if one.name not in forces]
    outputs = tuple(whole.outputs[i] for i in kept)
    return replace(whole, C=whole.C[kept], D=whole.D[kept], outputs=outputs)


def loop_system(vehicle: Vehicle, controller: Controller) -> LinearSystem:
    """Returns a vehicle with a controller, in continuous time, as a system from roads and loads to its signals and forces.

    Raises:
        InputError: a discrete law has no continuous counterpart, or its loop through the measurements no solution.
    """
    whole, m = _all_signals(vehicle), len(vehicle.linear_model.inputs)
    names = [one.name for one in whole.outputs]
    measured = [names.index(name) for name in controller.measured]
    n, outside, B, D = len(whole.A), slice(-m), whole.B[:, -m:], whole.D[:, -m:]
    law = controller.law.continuous().fed_back(D[measured])
    Cy, Dy, k = whole.C[measured], whole.D[measured, outside], law.states
    force, of_force = np.hstack([law.D @ Cy, law.C]), law.D @ Dy
    return LinearSystem(
        np.block([[whole.A, np.zeros((n, k))], [law.B @ Cy, law.A]]) + np.vstack([B, np.zeros((k, m))]) @ force,
        np.vstack([whole.B[:, outside] + B @ of_force, law.B @ Dy]),
        np.hstack([whole.C, np.zeros((len(whole.C), k))]) + D @ force,
        whole.D[:, outside] + D @ of_force,
        whole.inputs[:-m],
        (*whole.states, *kept_signals(range(1, k + 1))),
        whole.outputs,
    )


def _all_signals(vehicle: Vehicle) -> LinearSystem:
    """Returns a vehicle as a system to all its signals, forces included. Where the roads' heights act they are states."""
    model, kind, wheels = with_lag(vehicle), vehicle.kind, vehicle.kind.wheels
    n, p, r = len(model.A), len(model.C), len(wheels)
    forces = [kind.signal(name) for name in model.inputs]
    lagged = [
        replace(one, name=name) for one, name in zip(forces, model.states[len(vehicle.linear_model.states) :], strict=False)
    ]
    A, C, Bw, states = model.A, model.C, model.Bw, [kind.signal(name) for name in vehicle.linear_model.states] + lagged
    B, loads = np.hstack([model.Bl.reshape(n, -1), model.B]), [load_signal(name) for name in model.loads]
    if np.any(model.Br) or np.any(model.Cr):
        A, C, Bw = np.block([[A, model.Br], [np.zeros((r, n + r))]]), np.hstack([C, model.Cr]), np.vstack([Bw, np.eye(r)])
        B = np.vstack([B, np.zeros((r, B.shape[1]))])
        states += [kind.signal(wheel.road_displacement) for wheel in wheels]
    return LinearSystem(
        A,
        np.hstack([Bw, B]),
        C,
        np.hstack([model.Dw, model.Dl.reshape(p, -1), model.D]),
        (*(kind.signal(wheel.road_velocity) for wheel in wheels), *loads, *forces),
        tuple(states),
        tuple(kind.signal(name) for name in model.outputs),
    )
