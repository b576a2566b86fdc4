"""Repetition of a logged run: reads vehicle, controller and road, predicts the run by linear analysis, and simulates it.

The replay does not design controllers, so it does not need a solver. The log contains the proof of the certificate, and the
control law, from which the linear response is computed. A law in Python is not executed. MuJoCo applies the forces in the log
instead of those of the law.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from models.common.errors import InputError, list_names
from models.kinds.signals import Signal, kept_signals
from models.laws.design_request import DesignRequest
from models.laws.linear import MATRICES, law_of, static_law
from models.laws.preview import preview_of
from models.roads.description import described_road
from models.vehicle.controllers import RESERVED_NAMES, ControllerEntry
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.names import logged_part
from models.vehicle.vehicle import Vehicle, parse_vehicle
from models.vehicle.vehicle import kinds as kind_names
from sim.drive.case import Case
from sim.drive.driver import RecordedForces, RunDriver
from sim.drive.response import Response
from sim.inspect.log import Log, RecordedRun
from sim.linear.dampers import command_names
from sim.linear.prediction import predict_run
from sim.observers.recorder import record
from sim.recording.run_log import MUJOCO
from sim.runs.forces import read_forces
from sim.runs.run import Run, compare_runs, with_energy_balance
from synth.controller.controller import AnyController, Controller, verify_record
from synth.controller.problem import problem

# Largest number of states (including delayed forces) of a loop whose eigenvalues a replay computes. For this number, the
# computation takes seconds.
MOST_STATES = 1000
LAW = ("gain", *MATRICES, "sample_period")  # metadata keys that define the control law


def recorded_vehicle(log: Log, kinds: Path | None) -> Vehicle:
    """Returns the vehicle that the attached vehicle file describes.

    Args:
        log: log that contains the run or its vehicle file.
        kinds: folder of custom vehicle types, whose Python code is executed; None to allow only built-in types.

    Raises:
        InputError: the log contains no valid vehicle file, or its vehicle type is unknown.
    """
    vehicle_type = log.metadata.get("vehicle_type")
    if kinds is None and vehicle_type is not None and vehicle_type not in kind_names():
        raise InputError(
            f"the vehicle type {vehicle_type} is not built in; give --kinds with the folder of the type's .py and .xml files"
        )
    text = log.attachments["vehicle.toml"].decode("utf-8", errors="replace")
    return parse_vehicle(text, source="vehicle.toml in the log", folder=kinds)


def with_implementation_of(vehicle: Vehicle, run: RecordedRun) -> Vehicle:
    """Returns the vehicle with the actuators, initial state and implementation of a run.

    The actuators, initial state and implementation of a run may differ from those in the vehicle file. For example, the runs of
    `sim.margins` have an additional delay.
    """
    name = run.claims.get("name", "")
    if part := logged_part(run.name, name):
        vehicle = vehicle.without(part)
    # Next to controllers that request forces, the passive vehicle and state feedback were also run with force actuators.
    pushed = vehicle.dampers and name in RESERVED_NAMES and run.claim("limits") != json.loads(json.dumps(vehicle.limits.record))
    vehicle = vehicle.with_force_actuators if pushed else vehicle.with_actuators_of(name)
    start = run.claim("start") if "start" in run.claims else {}
    return replace(vehicle.starting(**start), implementation=Implementation(**run.claim("implementation")))


def recorded_controller(log: Log, vehicle: Vehicle, run: RecordedRun) -> AnyController:
    """Returns the controller of a logged run.

    The controller is read from the vehicle file. The log contains the proof of the certificate and, if the law was designed,
    the law itself. The text of a law in Python is attached to the log. If the run used exported code, the code is compiled
    again.

    Raises:
        InputError: the vehicle file does not contain the controller, or the proof or the exported code is invalid.
    """
    controller = _recorded_law(log, vehicle, run)
    if "code" not in run.claims:
        return controller
    from synth.controller.export.compiled import code_again

    return replace(controller, code=code_again(vehicle, controller, run.claim("code")))


def _recorded_law(log: Log, vehicle: Vehicle, run: RecordedRun) -> AnyController:
    name = run.claims.get("name", "")
    if name not in vehicle.controller_names:
        raise InputError(f"vehicle.toml has no controller {name!r}; it has {list_names(vehicle.controller_names)}")
    entry = vehicle.controllers.get(name)

    def linear(name: str) -> Controller:
        """Returns a linear controller. The control law is read from the vehicle file or, if it was designed, from the log."""
        request = DesignRequest() if entry is None else entry.request
        signals = entry.measured if entry is not None else vehicle.linear_model.states if name == "state" else ()
        given = static_law(np.zeros((len(vehicle.linear_model.inputs), 0))) if name == "passive" else entry.law if entry else None
        law = given or law_of({key: run.claim(key) for key in LAW if key in run.claims})
        preview = preview_of({"preview": run.claim("preview")}) if request.preview else None
        if given is None and law.states:
            law = replace(law, anti_windup=request.anti_windup)
        if preview is not None and preview.seconds != request.preview:
            raise InputError(f"the logged preview is {preview.seconds} s, but the preview in vehicle.toml is {request.preview} s")
        hardware = vehicle.hardware(name)
        recorded = ControllerEntry(name, tuple(signals), law, run.claim("certificate"), hardware)
        certificate, _ = verify_record(problem(vehicle, signals, hardware), recorded)
        return Controller(name, tuple(signals), law, given is None, certificate, hardware=hardware, preview=preview)

    return vehicle.driver(name, linear, lambda: log.attachments[run.claims["law_file"]].decode("utf-8", errors="replace"))


def replay(log: Log, run: RecordedRun, vehicle: Vehicle, controller: AnyController) -> tuple[Run, Response]:
    """Repeats a logged run: predicts it by linear analysis, and simulates it in MuJoCo.

    For a law in Python, the logged forces are applied.

    Args:
        log: log that contains the run or its vehicle file.
        run: logged run.
        vehicle: vehicle of the run; see `with_implementation_of`.
        controller: controller of the run; see `recorded_controller`.

    Returns:
        The repeated run with its verdict and energy balance, and MuJoCo's response in the repeated run.

    Raises:
        InputError: the logged road or timestep is invalid, or the log lacks responses or forces.
    """
    timestep, times = log.timestep, run.responses[MUJOCO].times
    time = np.arange(len(times)) * timestep
    if not np.array_equal(np.round(time * 1e9), times):
        raise InputError(f"the logged samples do not begin at 0 s, or are not {timestep:g} s apart")
    points = log.attachments[run.claims["road_file"]] if "road_file" in run.claims else None
    road = described_road(run.claim("road"), points)
    driver: RunDriver = controller
    if controller.user_code:
        forces = read_forces(log.attachments[run.claims["forces_file"]], command_names(vehicle), len(time))
        driver = RecordedForces(controller.measured, forces)
    (made,) = record([Case(vehicle, driver, road, earlier="signals" not in log.metadata)], time)
    prediction = replace(predict_run(controller, made.input, made.commands, MOST_STATES), replayed=driver is not controller)
    return with_energy_balance(compare_runs([prediction], [made]), [made])[0], made.response


def controller_states(controller: AnyController) -> tuple[Signal, ...]:
    """Returns the signals (names and units) that represent the states of a controller."""
    return kept_signals(range(1, controller.states + 1))


def as_response(vehicle: Vehicle, run: RecordedRun, name: str, timestep: float, states: tuple[Signal, ...]) -> Response:
    """Returns a logged response with the signals of the vehicle in their usual order, followed by the states of the controller.

    Args:
        vehicle: vehicle of the run.
        run: logged run.
        name: name of the response, one of `RESPONSES`.
        timestep: timestep of the run [s].
        states: signals that represent the states of the controller; see `controller_states`.

    Raises:
        InputError: the log does not contain the response, or the signals in the log are not those of the vehicle.
    """
    logged, signals = run.responses[name], vehicle.kind.signals
    if len(logged.names) != len(signals):
        signals = (*signals, *states)
    if {*logged.names} != {signal.name for signal in signals}:
        raise InputError(
            f"the signals of the logged {name} response are not the signals of a {vehicle.kind.name}, which are "
            f"{list_names(s.name for s in signals)}"
        )
    columns = [logged.names.index(signal.name) for signal in signals]
    return Response(np.arange(len(logged.times)) * timestep, signals, logged.values[:, columns])
