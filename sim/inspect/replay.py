"""A logged run made again: its vehicle, controller and road, the linear prediction, and MuJoCo's run.

Nothing is designed, and no solver is needed: a certificate is checked from its proof, and a linear response follows from the law.
The code of a law in Python is not run: the forces that it requested are in the log.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, listing
from models.kinds.signals import Signal, kept_signals
from models.laws.linear import MATRICES, LinearLaw, static_law
from models.laws.python_law import Programmed, PythonLaw
from models.laws.semi_active import SemiActive
from models.roads.description import described_road
from models.roads.road import Road, RoadInput
from models.vehicle.controllers import RESERVED, ControllerEntry
from models.vehicle.limits_and_implementation import read_implementation, read_limits
from models.vehicle.names import logged_part
from models.vehicle.vehicle import Vehicle, parse_vehicle
from models.vehicle.vehicle import kinds as kind_names
from sim.inspect.log import Log, RecordedRun
from sim.linear.dampers import command_names
from sim.linear.sampled_response import largest_timestep
from sim.physics.simulate import simulate
from sim.recording.run_log import MUJOCO
from sim.response.response import Response
from sim.runs.forces import read_forces
from sim.runs.prediction import Prediction, predict, predict_replayed
from sim.runs.run import Run, compare_runs, driver_again, with_energy_balance
from synth.analysis.specification import SAMPLED_NORM
from synth.controller.controller import Controller, Driver, verify_record
from synth.controller.open_loop import LoopModel
from synth.controller.problem import problem

MOST_STATES = 1000  # of a loop with all its delayed forces; its eigenvalues take seconds
MOST_DELAY = 1000  # samples; `sim.margins` logs runs on either side of a delay margin
FEWEST = 3  # samples that make a run


@dataclass(frozen=True, eq=False)
class Replay:
    """A logged run, made again.

    Attributes:
        run: the logged physics, compared with the new prediction; its energy balance is the new run's.
        physics: MuJoCo's new run.
    """

    run: Run
    physics: Response

    @property
    def prediction(self) -> Prediction:
        """Returns the new prediction."""
        return self.run.prediction


def recorded_vehicle(log: Log, kinds: Path | None) -> Vehicle:
    """Returns the vehicle of the attached file.

    Args:
        kinds: folder of vehicle types of the user's own, whose Python is run; None for those that ship alone.

    Raises:
        InputError: the log has no such file, or it is not a vehicle file.
    """
    vehicle_type = log.metadata.get("vehicle_type")
    if kinds is None and vehicle_type is not None and vehicle_type not in kind_names():
        raise InputError("it is of a kind that does not ship; give --kinds with the folder of that kind's .py and .xml")
    if "vehicle.toml" not in log.attachments:
        raise InputError("vehicle.toml is not attached")
    text = log.attachments["vehicle.toml"].decode("utf-8", errors="replace")
    vehicle = parse_vehicle(text, source="vehicle.toml in the log", folder=kinds)
    if vehicle_type != vehicle.kind.name:
        raise InputError(f"vehicle.toml is of a {vehicle.kind.name}, and the log is of a {vehicle_type}")
    return vehicle


def implemented(vehicle: Vehicle, run: RecordedRun) -> Vehicle:
    """Returns the vehicle with the implementation of a run, which may have a delay that the vehicle file lacks.

    Raises:
        InputError: the logged implementation is wrong, or the logged limits are not those of the vehicle file.
    """
    name = run.claims.get("name", "")
    if part := logged_part(run.name, name):
        vehicle = vehicle.without(part)
    limits = read_limits(_given(run.claim("limits")), vehicle.kind.suspensions)
    beside_forces = name in RESERVED and limits != vehicle.limits  # passive and state, with controllers that push
    vehicle = vehicle.with_force_actuators if vehicle.dampers and beside_forces else vehicle.driven_by(name)
    if limits != vehicle.limits:
        raise InputError("its [limits] are not those of vehicle.toml")
    how = read_implementation(_given(run.claim("implementation")), vehicle.linear_model.measurable, MOST_DELAY)
    return replace(vehicle, implementation=how)


def recorded_controller(log: Log, vehicle: Vehicle, run: RecordedRun) -> Driver:
    """Returns the controller of a run, driven by its exported code if the log says so; the code is made anew.

    Raises:
        InputError: it is not a controller of this vehicle, or there is no such code of it.
    """
    controller = recorded_law(log, vehicle, run)
    if "code" not in run.claims:
        return controller
    from synth.controller.export.compiled import code_again, driven_by

    return driven_by(controller, code_again(vehicle, controller, run.claim("code")))


def recorded_law(log: Log, vehicle: Vehicle, run: RecordedRun) -> Driver:
    """Returns the controller of a run, with a certificate computed anew from its law and the proof in the log.

    A law in Python is the attached text.

    Raises:
        InputError: it is not a controller of this vehicle, its law is not the vehicle file's, or its proof is not a proof.
    """
    name, measured = run.claims.get("name", ""), run.claim("measured")
    if name not in vehicle.controller_names:
        raise InputError(f"vehicle.toml has no such controller; it has {listing(vehicle.controller_names)}")
    expected = {"passive": (), "state": vehicle.linear_model.states}
    signals = expected[name] if name in expected else vehicle.controllers[name].measured
    if measured != list(signals):
        raise InputError(f"what it measures is not what vehicle.toml says: {', '.join(signals) or 'nothing'}")
    entry = vehicle.controllers.get(name)
    if entry is not None and entry.python is not None:
        return _programmed(log, run, entry.name, signals, entry.python)
    if entry is not None and entry.semi_active is not None:
        controller = SemiActive(entry.name, entry.semi_active)
        record = controller.law.record
        if {key: run.claims.get(key) if key == "semi_active" else run.claim(key) for key in record} != record:
            raise InputError("its semi-active law is not that of vehicle.toml")
        return controller
    law = _law(run, len(vehicle.linear_model.inputs), len(signals))
    none = static_law(np.zeros_like(law.D))
    given = none if name == "passive" else None if name == "state" else vehicle.controllers[name].law
    if given is not None and law.record != given.record:
        raise InputError("its gain or law is not that of vehicle.toml")
    if entry is not None and law.states and law.anti_windup != entry.anti_windup:
        raise InputError("its anti-windup is not that of vehicle.toml")
    record = run.claim("certificate")
    only_sampled = SAMPLED_NORM in record and "norm" not in record  # its computer alone makes its loop stable
    if given is None and "X" not in record and not only_sampled:
        raise InputError("it was designed, and its certificate proves no bound")
    preview = None
    if entry is not None and entry.preview:
        from models.laws.preview import preview_of

        preview = preview_of({"preview": run.claim("preview")})
        shape = len(vehicle.linear_model.inputs), len(vehicle.linear_model.disturbances)
        if preview is None or (len(preview.C), preview.B.shape[1]) != shape or preview.seconds != entry.preview:
            raise InputError("its preview of the road is not that of vehicle.toml")
    hardware = vehicle.hardware(name)
    certificate, _ = verify_record(
        problem(vehicle, signals, hardware), ControllerEntry(name, tuple(signals), law, record, hardware=hardware)
    )
    return Controller(name, signals, law, given is None, certificate, hardware=hardware, preview=preview)


def _programmed(log: Log, run: RecordedRun, name: str, signals: Sequence[str], law: PythonLaw) -> Programmed:
    """Returns the law in Python of a run, with the attached text."""
    content = log.attachments.get(run.claims.get("law_file", ""))
    if content is None:
        raise InputError(f"the text of its {law.kind} is not attached")
    programmed = Programmed(name, tuple(signals), law, content.decode("utf-8", errors="replace"))
    if run.claims.get("sha256") != programmed.sha256:
        raise InputError(f"the text of its {law.kind} is not the one whose checksum the log has")
    return programmed


def replay(log: Log, run: RecordedRun, vehicle: Vehicle, controller: Driver) -> Replay:
    """Makes a run again: predicts it by linear analysis, and runs MuJoCo. A law in Python applies the forces in the log.

    Args:
        vehicle: its vehicle, see `implemented`.
        controller: its controller, see `recorded_controller`.

    Raises:
        InputError: the road or the timestep is wrong, or responses or forces are not in the log.
    """
    timestep, logged = log.timestep, run.responses.get(MUJOCO)
    if logged is None or len(logged.times) < FEWEST:
        raise InputError("the log has no samples of MuJoCo's response")
    if not timestep <= largest_timestep(vehicle):
        raise InputError(f"the timestep of {timestep:g} s is one with which RK4 is unstable on this vehicle")
    time = np.arange(len(logged.times)) * timestep
    if not np.array_equal(np.round(time * 1e9), logged.times):
        raise InputError(f"its samples are not {timestep:g} s apart from 0 on")
    road = RoadInput(vehicle, recorded_road(log, run), time)
    physics = as_response(vehicle, run, MUJOCO, timestep, kept(controller))
    if isinstance(controller, Controller) and not vehicle.dampers:
        prediction = predict(LoopModel(vehicle, controller, road.timestep), road, MOST_STATES)
    else:
        forces = np.zeros((0, 0))
        if isinstance(controller, Programmed):
            content = log.attachments.get(run.claims.get("forces_file", ""))
            if content is None:
                raise InputError(f"the forces of its {controller.law.kind} are not attached")
            forces = read_forces(content, command_names(vehicle), len(time))
        prediction = predict_replayed(controller, road, physics, forces)
    (compared,) = compare_runs([prediction], [physics])
    again = simulate([driver_again(prediction, time)], [RoadInput(vehicle, compared.road, time)])
    (compared,) = with_energy_balance([compared], again)
    return Replay(compared, again.run(0))


def recorded_road(log: Log, run: RecordedRun) -> Road:
    """Returns the road of a run.

    Raises:
        InputError: the log does not describe it completely.
    """
    description = run.claim("road")
    if not isinstance(description, dict):
        raise InputError("its description of the road is not an object")
    return described_road(description, log.attachments.get(run.claims.get("road_file", "")))


def kept(controller: Driver) -> tuple[Signal, ...]:
    """Returns the signals of a controller's states."""
    return kept_signals(range(1, controller.states + 1))


def as_response(vehicle: Vehicle, run: RecordedRun, name: str, timestep: float, states: tuple[Signal, ...]) -> Response:
    """Returns a logged response with the vehicle's signals, in their order, and those of its controller's states.

    Raises:
        InputError: it is not in the log, or has other signals.
    """
    logged = run.responses.get(name)
    if logged is None:
        raise InputError(f"the {name} response is missing")
    signals = vehicle.kind.signals
    if len(logged.names) != len(signals):
        signals = (*signals, *states)
    if {*logged.names} != {signal.name for signal in signals}:
        raise InputError(f"the {name} response has other signals than a {vehicle.kind.name}: {listing(s.name for s in signals)}")
    columns = [logged.names.index(signal.name) for signal in signals]
    return Response(np.arange(len(logged.times)) * timestep, signals, logged.values[:, columns])


def _given(section: Any) -> Mapping[str, Any]:
    """Returns a logged section as in a vehicle file, without the absent keys, which are None in the log."""
    return {key: value for key, value in section.items() if value is not None}


def _law(run: RecordedRun, m: int, q: int) -> LinearLaw:
    """Returns the law that a run records: a gain, or the matrices of one with states."""
    if "A" not in run.claims:
        return static_law(_matrix(run.claim("gain"), "gain", (m, q)))
    k = len(run.claim("A"))
    shapes = zip(MATRICES, ((k, k), (k, q), (m, k), (m, q)), strict=True)
    period, rate = (run.claim(name) if name in run.claims else None for name in ("sample_period", "anti_windup"))
    return LinearLaw(*(_matrix(run.claim(name), name, shape) for name, shape in shapes), sample_period=period, anti_windup=rate)


def _matrix(value: Any, name: str, shape: tuple[int, int]) -> Array:
    try:
        return np.array(value, dtype=float).reshape(shape)
    except (TypeError, ValueError):
        raise InputError(f"its {name} is not a matrix of {shape[0]} x {shape[1]} numbers") from None
