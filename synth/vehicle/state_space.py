"""Conversion of plants and controllers from and to `control.StateSpace` objects of python-control, with named signals.

The functions accept any object that has the attributes of a `control.StateSpace`.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, list_names, short_repr
from models.laws.linear import LinearLaw
from models.vehicle.controllers import NOMINAL, read_controllers
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller, check_feedback_alone, check_fits
from synth.plant.generalized import Plant
from synth.vehicle.designer import certify_given

if TYPE_CHECKING:
    import control

UNNAMED_SIGNAL = re.compile(r"[uy]\[\d+\]")  # default name of a signal in the package python-control


def from_state_space(
    system: Any, disturbances: Sequence[str], performance: Mapping[str, float], measured: Sequence[str]
) -> tuple[Plant, Array]:
    """Converts a system with named signals to a plant of the form (15), and the matrix C_y of the measurements.

    Args:
        system: `control.StateSpace`, or an object with A, B, C, D, input_labels and output_labels. If the system is discrete,
            `dt` is the sample period [s].
        disturbances: names of those inputs of the system that are disturbances w. All other inputs of the system are control
            inputs u.
        performance: weights of those outputs of the system that form the performance output z, by name.
        measured: names of the outputs that form the measurement vector y. Measured outputs must have no feedthrough from u or
            w.

    Returns:
        The plant (discrete if the system is discrete, otherwise continuous), and the matrix C_y of shape (q, n).

    Raises:
        InputError: a signal is unknown; disturbances, positive weights or measurements are missing; a discrete system has no
            sample period; or a measurement has a feedthrough from u or w.

    Example:
        >>> import control
        >>> from synth import from_state_space
        >>> A, B, C = [[0, 1], [-4, -0.1]], [[0, 0], [1, 1]], [[1, 0], [0, 1]]
        >>> system = control.ss(A, B, C, 0, inputs=["w", "u"], outputs=["x", "v"])
        >>> plant, Cy = from_state_space(system, disturbances=["w"], performance={"x": 1.0}, measured=["v"])
        >>> plant.C, Cy
        (array([[1., 0.]]), array([[0., 1.]]))
    """
    dt, (A, B, C, D) = _sample_period(system), _matrices(system)
    inputs, outputs = (list[str](getattr(system, labels, ())) for labels in ("input_labels", "output_labels"))
    for what, expected, there in (
        ("disturbance", disturbances, inputs),
        ("performance signal", performance, outputs),
        ("measured signal", measured, outputs),
    ):
        for name in expected:
            if name not in there:
                raise InputError(f"unknown {what} {name!r}; the system has {list_names(there)}")
    if not disturbances:
        raise InputError(f"no disturbance is given; choose at least one disturbance from the inputs {list_names(inputs)}")
    weights = {name: float(weight) for name, weight in performance.items() if weight != 0}
    if not weights:
        raise InputError(f"all weights are zero; give a weight above zero to at least one of the outputs {list_names(outputs)}")
    if not measured:
        raise InputError(f"no signal is measured; measure at least one of the outputs {list_names(outputs)}")
    w = [inputs.index(name) for name in disturbances]
    u = [i for i in range(len(inputs)) if i not in w]
    z, y = [outputs.index(name) for name in weights], [outputs.index(name) for name in measured]
    for name, row in zip(measured, D[y], strict=True):
        if np.any(row):
            raise InputError(
                f"measured signal {name!r} depends directly on an input, but a static controller can measure only "
                "states; measure a state"
            )
    weight = np.array(list(weights.values()))[:, None]
    direct = weight * D[z]
    return Plant(A, B[:, u], B[:, w], weight * C[z], direct[:, u], direct[:, w], dt=dt), C[y]


def _matrices(system: Any) -> list[Array]:
    try:
        return [np.asarray(getattr(system, matrix)) for matrix in "ABCD"]
    except AttributeError as error:
        raise InputError(f"system = {short_repr(system)} has no A, B, C and D; give a state-space system") from error


def _sample_period(system: Any) -> float | None:
    """Returns the sample period of a system [s]; None if the system is continuous."""
    period = getattr(system, "dt", None)
    if period is True:
        raise InputError("the system is discrete, but has no sample period (dt = True); give dt in seconds")
    return period or None


def controller_from(vehicle: Vehicle, name: str, measured: Sequence[str], system: Any) -> Controller:
    """Converts a linear system to a certified controller.

    The inputs of the system are the measurements, and the outputs of the system are the forces.

    Args:
        vehicle: vehicle to which the controller belongs.
        name: name of the controller.
        measured: names of the signals at the inputs of the system. If the inputs and outputs have names, they are assigned to
            signals and forces by name, otherwise by order.
        system: `control.StateSpace`, or an object with A, B, C and D. If the system is discrete, `dt` is the sample period [s].

    Returns:
        Controller with its certificate. The control law of the returned controller is the system itself, unchanged.

    Raises:
        InputError: a signal name, the shape or an entry of a matrix, or the sample period does not suit the vehicle.

    Example:
        >>> import control
        >>> from models import read_vehicle
        >>> from synth import controller_from
        >>> leaky = control.ss([[-0.5]], [[0, 1]], [[-2000]], [[11000, 0]])
        >>> measured = ["suspension_deflection", "sprung_acceleration"]
        >>> controller = controller_from(read_vehicle("quarter_car"), "leaky", measured, leaky)
        >>> controller.law.states, f"{controller.certificate.norm.value:.3f}"
        (1, '7.845')
    """
    # This call raises an error if the shapes of the matrices are inconsistent
    law = LinearLaw(*_matrices(system), sample_period=_sample_period(system))
    columns = _order(system, "input_labels", measured)
    rows = _order(system, "output_labels", vehicle.linear_model.inputs)
    if law.D.shape == (len(rows), len(columns)):
        law = LinearLaw(law.A, law.B[:, columns], law.C[rows], law.D[np.ix_(rows, columns)], law.sample_period)
    section = {name: {"measured": list(measured), **law.record}}
    entry = read_controllers(section, vehicle.linear_model, vehicle.limits, vehicle.implementation, vehicle.kind)[name]
    vehicle.check_entry(entry)
    return certify_given(vehicle, entry.name, entry.measured, law)


def law_system(vehicle: Vehicle, controller: Controller) -> "control.StateSpace":
    """Converts the law of a controller to a `control.StateSpace` with named signals, from measurements to forces.

    Args:
        vehicle: vehicle to which the controller belongs.
        controller: linear controller with at least one measurement.

    Returns:
        The control law as a `control.StateSpace`, which is discrete if the law is discrete, otherwise continuous.

    Raises:
        InputError: the controller has no measurements, or belongs to a different vehicle.

    Example:
        >>> from models import read_vehicle
        >>> from synth import design_controllers
        >>> vehicle = read_vehicle("quarter_car")
        >>> [controller] = design_controllers(vehicle, ["I"])
        >>> from synth import law_system
        >>> law_system(vehicle, controller).input_labels
        ['suspension_deflection', 'sprung_velocity']
    """
    check_fits(vehicle, controller)
    check_feedback_alone(controller, "a state-space system")
    from control import StateSpace, ss

    law = controller.law
    if not controller.measured:
        raise InputError(f"controller {controller.name!r} measures nothing; choose a controller with measurements")
    system = ss(
        law.A,
        law.B,
        law.C,
        law.D,
        law.sample_period or 0,
        name=controller.name,
        states=[f"controller_{k}" for k in range(1, law.states + 1)],
        inputs=list(controller.measured),
        outputs=list(vehicle.linear_model.inputs),
        remove_useless_states=False,
    )
    assert isinstance(system, StateSpace)
    return system


def _order(system: Any, labels: str, names: Sequence[str]) -> list[int]:
    """Returns the positions of signal names among the inputs or outputs of a system. If the inputs or outputs of the system
    have no names, the positions follow the order of the signal names.
    """
    given_names = list(getattr(system, labels, None) or names)
    if all(UNNAMED_SIGNAL.fullmatch(label) for label in given_names):
        return list(range(len(names)))
    if sorted(given_names) != sorted(names):
        raise InputError(
            f"the system has the {labels.replace('_', ' ')} {list_names(given_names)}; give {list_names(names)}, in any order"
        )
    return [given_names.index(name) for name in names]


def closed_loop(vehicle: Vehicle, controller: Controller) -> "control.StateSpace":
    """Returns the closed loop (16) as a continuous `control.StateSpace`, from the roads to every output of the vehicle.

    The sensors in the closed loop have no noise, and the actuators have no lag. Outputs that are heights above the datum of a
    flat road are omitted, because such heights are unbounded even for a bounded road velocity. The first inputs of the closed
    loop are the road velocities [m/s]. If the height of the road's warp has a direct effect, as in a full car, each warp is an
    additional input. A warp input is a velocity: the height of the warp times `twist_rate` of the linear model.

    Args:
        vehicle: vehicle in the loop; the outputs of the vehicle are the outputs of the loop.
        controller: controller with a linear law, either designed or contained in the vehicle file.

    Returns:
        The closed loop as a `control.StateSpace`. The outputs of the loop have the names and units of the vehicle's signals.

    Example:
        >>> from models import read_vehicle
        >>> from synth import design_controllers
        >>> vehicle = read_vehicle("quarter_car")
        >>> [controller] = design_controllers(vehicle, ["I"])
        >>> from synth import closed_loop
        >>> closed_loop(vehicle, controller).nstates
        4
    """
    outputs = [name for name in vehicle.linear_model.outputs if name not in vehicle.linear_model.heights]
    plain = replace(vehicle, performance=dict.fromkeys(outputs, 1.0), filters={}, road_filter=None, sums=())
    return loop_to(plain, replace(controller, hardware=NOMINAL), outputs)


def loop_to(vehicle: Vehicle, controller: Controller, outputs: Sequence[str]) -> "control.StateSpace":
    """Returns the closed loop of a vehicle from the disturbances to the performance output z. The entries of the performance
    output z have the names `outputs`.

    If the road has a filter, the inputs of the loop are those of the filter, named `w[road]`. If the design includes the noise
    of a sensor, this noise, divided by its rms, is an input named `noise[signal]`. A load is an input named `load[name]`,
    divided by the load that counts as w = 1 m/s.
    """
    check_feedback_alone(controller, "a state-space system")
    from control import StateSpace, ss

    judged, hardware = controller.problem(vehicle).judged(controller.law), controller.hardware
    loop, heights = judged.loop, [wheel.road_displacement for wheel in vehicle.kind.wheels] if judged.with_road_heights else []
    roads = [wheel.road_velocity for wheel in vehicle.kind.wheels]
    noise = [f"noise[{name}]" for name, rms in zip(controller.measured, hardware.noise, strict=bool(hardware.noise)) if rms]
    loads = [f"load[{name}]" for name, _ in hardware.loads]
    more = [f"road_twist_{k}" for k in range(1, loop.Bw.shape[1] - len(roads) - len(loads) - len(noise) + 1)]
    inputs = [*roads, *more]
    system = ss(
        loop.A,
        loop.Bw,
        loop.C,
        loop.Dw,
        name=f"{vehicle.kind.name}_{controller.name}",
        states=[*judged.states, *(f"controller_{k}" for k in range(1, judged.law_states + 1)), *heights],
        inputs=[*(inputs if vehicle.road_filter is None else [f"w[{name}]" for name in inputs]), *loads, *noise],
        outputs=list(outputs),
    )
    assert isinstance(system, StateSpace)
    return system
