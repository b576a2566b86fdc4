"""A run made again from its log alone: its vehicle, controller, road and responses, and MuJoCo's run of them.

Nothing is designed, and no solver is needed: a certificate is checked from its proof, and a linear response follows from a gain.
What the log gives is bounded before it is used, so that no file of a few bytes can ask for hours or gigabytes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, listing
from models.common.files import TEXT
from models.kinds.signals import Signal, kept_signals
from models.laws.linear import MATRICES, LinearLaw, static_law
from models.laws.linear import MOST_STATES as MOST_OF_A_LAW
from models.laws.python_law import MOST_TEXT, Programmed, PythonLaw
from models.laws.semi_active import SemiActive
from models.roads.description import described_road
from models.roads.road import Road, RoadInput
from models.vehicle.controllers import LARGEST, RESERVED, ControllerEntry
from models.vehicle.limits_and_implementation import read_implementation, read_limits
from models.vehicle.names import logged_part
from models.vehicle.vehicle import Vehicle, parse_vehicle
from models.vehicle.vehicle import kinds as kind_names
from sim.inspect.log import RESPONSES, Recorded, RecordedRun
from sim.linear.dampers import command_names
from sim.linear.sampled_response import largest_timestep
from sim.physics.simulate import simulate
from sim.recording.run_log import MUJOCO, RunLog
from sim.recording.run_records import run_log
from sim.response.response import Response
from sim.runs.forces import read_forces
from sim.runs.prediction import Prediction, predict, predict_replayed
from sim.runs.run import Run, driver_again, with_energy_balance
from synth.analysis.specification import SAMPLED_NORM
from synth.controller.controller import Controller, Driver, verify_record
from synth.controller.open_loop import LoopModel
from synth.controller.problem import problem

MOST_VEHICLE = TEXT  # bytes of a vehicle file: what a command reads, its log may hold
MOST_STATES = 1000  # of a loop with all its delayed forces; its eigenvalues take seconds
MOST_DELAY = 1000  # samples; `sim.margins` logs runs on either side of a delay margin
FEWEST = 3  # samples that make a run


def recorded_vehicle(log: Recorded, kinds: Path | None) -> Vehicle:
    """Returns the vehicle of the attached file.

    Args:
        kinds: folder of kinds of vehicle of the user's own, whose Python is run, or None for those that ship alone.

    Raises:
        InputError: there is no such file, or it is no vehicle file.
    """
    shipped, said = kind_names(), log.metadata.get("vehicle_type")
    if kinds is None and said is not None and said not in shipped:
        raise InputError("it is of a kind that does not ship; give --kinds with the folder of that kind's .py and .xml")
    content = log.attachments.get("vehicle.toml")
    if content is None:
        raise InputError("vehicle.toml is not attached")
    if len(content) > MOST_VEHICLE:
        raise InputError(f"vehicle.toml has {len(content)} bytes; {MOST_VEHICLE} are allowed")
    try:
        vehicle = parse_vehicle(content.decode("utf-8"), source="vehicle.toml in the log", folder=kinds)
    except (ValueError, ArithmeticError) as error:  # numbers beyond everything fail in many ways
        raise InputError(f"vehicle.toml is no vehicle file: {error}") from error
    if log.metadata.get("vehicle_type", vehicle.kind.name) != vehicle.kind.name:
        raise InputError(f"vehicle.toml is of a {vehicle.kind.name}, and the log says another")
    return vehicle


def implemented(vehicle: Vehicle, run: RecordedRun) -> Vehicle:
    """Returns the vehicle with the implementation of this run, which may have a delay that the vehicle file lacks.

    Raises:
        InputError: the logged implementation is invalid, or its limits are not those of the vehicle file.
    """
    name = run.claims.get("name", "")
    if part := logged_part(run.name, name):
        vehicle = vehicle.without(part)
    limits = read_limits(_given(run.claim("limits"), "limits"), vehicle.kind.suspensions)
    beside_forces = name in RESERVED and limits != vehicle.limits  # passive and state, with controllers that push
    vehicle = vehicle.with_force_actuators if vehicle.dampers and beside_forces else vehicle.driven_by(name)
    if limits != vehicle.limits:
        raise InputError("its [limits] are not those of vehicle.toml")
    measurable = vehicle.linear_model.measurable
    section = _given(run.claim("implementation"), "implementation")
    return replace(vehicle, implementation=read_implementation(section, measurable, MOST_DELAY))


def recorded_controller(log: Recorded, vehicle: Vehicle, run: RecordedRun) -> Driver:
    """The controller of a run, driven by its exported code if the log says so, which is made again; see `recorded_law`.

    Raises:
        InputError: it is no controller of this vehicle, or there is no such code of it.
    """
    controller = recorded_law(log, vehicle, run)
    if "code" not in run.claims:
        return controller
    record = run.claim("code")
    if not isinstance(record, dict):
        raise InputError("its exported code is none")
    from synth.controller.export.compiled import code_again, driven_by

    return driven_by(controller, code_again(vehicle, controller, record))


def recorded_law(log: Recorded, vehicle: Vehicle, run: RecordedRun) -> Driver:
    """The controller of a run, with a certificate computed anew from its gain and the proof in the log; numpy and scipy alone.

    A law in Python is the text that is attached. Nobody runs it.

    Raises:
        InputError: it is no controller of this vehicle, its gain is not the vehicle file's, or its proof is no proof.
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
        return _semi_active(run, SemiActive(entry.name, entry.semi_active))
    law = _law(run, len(vehicle.linear_model.inputs), len(signals))
    none = static_law(np.zeros_like(law.D))
    given = none if name == "passive" else None if name == "state" else vehicle.controllers[name].law
    if given is not None and law.record != given.record:
        raise InputError("its gain or law is not that of vehicle.toml")
    if entry is not None and law.states and law.anti_windup != entry.anti_windup:
        raise InputError("its anti-windup is not that of vehicle.toml")

    record = run.claim("certificate")
    if not isinstance(record, dict):
        raise InputError("its certificate is none")
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


def _programmed(log: Recorded, run: RecordedRun, name: str, signals: Sequence[str], law: PythonLaw) -> Programmed:
    """A law in Python of a run, its text as it is attached."""
    content = log.attachments.get(run.claims.get("law_file", ""))
    if content is None or len(content) > MOST_TEXT:
        raise InputError(f"the text of its {law.kind} is not attached")
    try:
        programmed = Programmed(name, tuple(signals), law, content.decode("utf-8"))
    except UnicodeDecodeError:
        raise InputError(f"what is attached as its {law.kind} is no text") from None
    if run.claims.get("sha256") != programmed.sha256:
        raise InputError(f"the text of its {law.kind} is not the one whose checksum the log has")
    _check_unclaimed(run, law.with_article)
    return programmed


def _semi_active(run: RecordedRun, controller: SemiActive) -> SemiActive:
    """A law that ships, as vehicle.toml has it."""
    record = controller.law.record
    if {key: run.claims.get(key) if key == "semi_active" else run.claim(key) for key in record} != record:
        raise InputError("its semi-active law is not that of vehicle.toml")
    _check_unclaimed(run, "a semi-active law")
    return controller


def _check_unclaimed(run: RecordedRun, what: str) -> None:
    claimed = [key for key in ("bound", "norm", "peak_frequency") if run.claim(key) is not None]
    if claimed:
        raise InputError(f"it claims a {claimed[0]}, and linear analysis says nothing of {what}")


def recorded_road(log: Recorded, run: RecordedRun, samples: int) -> Road:
    """The road of a run.

    Args:
        samples: how many are to be computed on it.

    Raises:
        InputError: it is not described whole, or is absurdly long for the run.
    """
    description = run.claim("road")
    if not isinstance(description, dict):
        raise InputError("its description is none")
    return described_road(description, log.attachments.get(run.claims.get("road_file", "")))


def predicted_again(
    log: Recorded, run: RecordedRun, vehicle: Vehicle, controller: Driver, samples: int, timestep: float
) -> Prediction:
    """Recomputes the prediction of a run by linear analysis; for a law in Python, under the attached forces.

    Args:
        vehicle: its vehicle, see `implemented`.
        controller: its controller, see `recorded_controller`.
        timestep: [s].

    Raises:
        InputError: no run could have had this timestep, the road cannot be driven with it, noise goes through a loop with too
            many delayed forces, or the forces are not there.
    """
    if not timestep <= largest_timestep(vehicle):
        raise InputError(f"the timestep of {timestep:g} s is one with which RK4 is unstable on this vehicle")
    road = RoadInput(vehicle, recorded_road(log, run, samples), np.arange(samples) * timestep)
    if isinstance(controller, Controller) and not vehicle.dampers:
        return predict(LoopModel(vehicle, controller, road.timestep), road, MOST_STATES)
    forces = np.zeros((0, 0))
    if isinstance(controller, Programmed):
        content = log.attachments.get(run.claims.get("forces_file", ""))
        if content is None:
            raise InputError(f"the forces of its {controller.law.kind} are not attached")
        forces = read_forces(content, command_names(vehicle), samples)
    physics = as_response(vehicle, run, MUJOCO, samples, timestep, kept(controller))
    return predict_replayed(controller, road, physics, forces)


def usable_samples(run: RecordedRun, timestep: float) -> int:
    """Returns the number of samples that all responses of a run have, from the first on and without a gap."""
    counts = []
    for logged in run.responses.values():
        due = np.round(np.arange(len(logged.times)) * timestep * 1e9)
        wrong = logged.times.astype(float) != due
        counts.append(int(wrong.argmax()) if wrong.any() else len(wrong))
    return min(counts, default=0)


def kept(controller: Driver) -> tuple[Signal, ...]:
    """The signals of a controller's states."""
    return kept_signals(range(1, controller.states + 1))


def as_response(
    vehicle: Vehicle, run: RecordedRun, name: str, samples: int, timestep: float, states: tuple[Signal, ...]
) -> Response:
    """A logged response with the vehicle's signals, in their order, and those of its controller's states.

    Logs that are older than states are logged have none of them.

    Raises:
        InputError: it was not logged, or not with these signals.
    """
    logged = run.responses.get(name)
    if logged is None:
        raise InputError(f"the {name} response is missing")
    signals = vehicle.kind.signals
    if len(logged.names) != len(signals):
        signals = (*signals, *states)
    absent = [signal.name for signal in signals if signal.name not in logged.names]
    if absent or len(logged.names) != len(signals):
        raise InputError(f"the {name} response has other signals than a {vehicle.kind.name}: {listing(s.name for s in signals)}")
    for signal in signals:
        if logged.units.get(signal.name) != signal.unit:
            raise InputError(f"{signal.name} of the {name} response is not in {signal.unit}, as it says")
    columns = [logged.names.index(signal.name) for signal in signals]
    return Response(np.arange(samples) * timestep, signals, logged.values[:samples, columns])


def _given(section: Any, what: str) -> Mapping[str, Any]:
    """Returns a logged section as a vehicle file would have it: the log contains absent keys as well."""
    if not isinstance(section, dict):
        raise InputError(f"its {what} are none")
    return {key: value for key, value in section.items() if value is not None}


def _law(run: RecordedRun, m: int, q: int) -> LinearLaw:
    """The law that a run records: a gain, or the matrices of one with states."""
    if "A" not in run.claims:
        gain = _matrix(run.claim("gain"), "gain", (m, q))
        if not np.all(np.abs(gain) <= LARGEST):
            raise InputError(f"its gain has numbers beyond {LARGEST:g}")
        return static_law(gain)
    A = run.claim("A")
    period, rate = (run.claim(name) if name in run.claims else None for name in ("sample_period", "anti_windup"))
    k = len(A) if isinstance(A, list) else 0
    shapes = zip(MATRICES, ((k, k), (k, q), (m, k), (m, q)), strict=True)
    if not 0 < k <= MOST_OF_A_LAW or not all(number is None or isinstance(number, float) for number in (period, rate)):
        raise InputError(f"its law is none of 1 to {MOST_OF_A_LAW} states")
    matrices = (_matrix(run.claim(name), name, shape) for name, shape in shapes)
    return LinearLaw(*matrices, sample_period=period, anti_windup=rate)


def _matrix(value: Any, name: str, shape: tuple[int, int]) -> Array:
    try:
        return np.array(value, dtype=float).reshape(shape)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"its {name} is no matrix of {shape[0]} x {shape[1]} numbers") from None


def balanced_again(run: Run) -> tuple[Run, Response]:
    """A run with the energy balance of what MuJoCo makes of it now, and what half the step changes; and that physics.

    A law in Python is not run: the forces that it asked for are.
    """
    time = run.prediction.time
    physics = simulate([driver_again(run.prediction, time)], [RoadInput(run.vehicle, run.road, time)])
    (run,) = with_energy_balance([run], physics)
    return run, physics.run(0)


def written_again(recorded: RecordedRun, run: Run, samples: int) -> RunLog:
    """A run as it would be written now, with the responses that were logged."""
    timestep, states = run.prediction.timestep, kept(run.controller)
    responses = {name: as_response(run.vehicle, recorded, name, samples, timestep, states) for name in RESPONSES}
    return replace(run_log(run, recorded.name), responses=responses)
