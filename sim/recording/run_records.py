"""Conversion of a run to a `RunLog`: versions, command line, vehicle file, MuJoCo model, results and scene."""

import datetime
import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from models.common.command import versions
from models.common.extensions import FEATURES
from models.document.text import markdown
from models.kinds.signals import is_kept
from models.vehicle.mjcf import mjcf_text
from models.vehicle.vehicle import Vehicle
from sim.drive.response import Response
from sim.recording.run_log import CONTINUOUS, DAMPERS, FORMAT, LOADS, MEASURED_TOPIC, MUJOCO, SAMPLED, SIGNALS, RunLog, RunName
from sim.recording.scene import scene_of
from sim.runs.record import BALANCE, HALF_STEP, controller_record
from sim.runs.report import describe_run, events, verdict
from sim.runs.run import Run
from synth.controller.report import norm_if_implemented, norm_record

if TYPE_CHECKING:
    from sim.runs.force_diagram import Diagram


LONGEST = 60  # largest number of letters of the vehicle file's name that are used in the name of a log


def record_runs(
    folder: Path,
    command_line: str,
    vehicle: Vehicle,
    controllers: Sequence[str],
    runs: Mapping[str, Run],
    result: Mapping[str, Any],
    measured: Response | None = None,
) -> dict[str, str]:
    """Records the runs of a command with `sim.recording.files.record`.

    The name of each file consists of the command, the vehicle file, the controllers and the time (UTC).

    Args:
        command_line: command line `roadproof COMMAND ...` that repeats the runs.
        vehicle: vehicle of the runs.
        controllers: names of the controllers, which become part of the file names.
        runs: runs to record, by their names in the log.
        result: result of the command, as `--json` prints it.
        measured: signals of a measured log during the time of the runs; None without a measured log.

    Returns:
        Paths of the recorded files, as `sim.recording.files.record` returns them.

    Raises:
        InputError: the folder cannot be written.
    """
    from sim.recording.files import record

    logs = [run_log(run, name, measured) for name, run in runs.items()]
    time = logs[0].responses[MUJOCO].time
    timestep, match = float(time[1] - time[0]), re.match(r"(?:roadproof |python -m sim\.)(\w+)( |$)", command_line)
    metadata = {
        "format": str(FORMAT),
        "signals": str(SIGNALS),
        "command": match[1] if match else "",
        "command_line": command_line,
        "vehicle": vehicle.source,
        "vehicle_type": vehicle.kind.name,
        "timestep": repr(timestep),
        "versions": json.dumps(versions()),
    }
    attachments = {
        "vehicle.toml": ("application/toml", vehicle.text.encode()),
        "model.xml": ("application/xml", mjcf_text(vehicle, timestep).encode()),
        "result.json": ("application/json", json.dumps(result, allow_nan=False).encode()),
        **{name: file for log in logs for name, file in log.files.items()},
    }
    now = datetime.datetime.now(datetime.UTC).strftime("%Y%m%dT%H%M%SZ")
    which = "_".join(controllers) if len(controllers) <= 3 else f"{len(controllers)}_controllers"
    name = re.sub(r"[^\w-]+", "_", Path(vehicle.source).stem) if vehicle.source else vehicle.kind.name
    paths = record(folder, f"{metadata['command']}-{name[:LONGEST]}-{which}-{now}", logs, metadata, attachments)
    return {name: str(path) for name, path in paths.items()}


def _attachment_name(what: str, suffix: str, content: bytes) -> str:
    """Returns the name of an attachment. The name contains a hash of the content, so runs with equal attachments share one
    attachment.
    """
    return f"{what}-{hashlib.sha256(content).hexdigest()[:16]}.{suffix}"


def claims_of(run: Run) -> tuple[dict[str, Any], dict[str, tuple[str, bytes]]]:
    """Returns a run's properties and results, which `sim.inspect` verifies, and their attachments as (media type, content)."""
    vehicle, road, controller, agreement = run.vehicle, run.road, run.controller, run.agreement
    files: dict[str, tuple[str, bytes]] = {}
    named: dict[str, str] = {}
    points = road.points
    if points is not None:
        named["road_file"] = _attachment_name("road", "csv", points)
        files[named["road_file"]] = ("text/csv", points)
    proved: dict[str, Any] = {}
    if controller.user_code is True:
        command_names = FEATURES.load("dampers in linear analysis").command_names
        written_forces = FEATURES.load("forces of parts").written_forces
        for what, suffix, media_type, content in (
            ("law", "py", "text/x-python", controller.source.encode()),
            ("forces", "csv", "text/csv", written_forces(command_names(vehicle), run.prediction.requested_force)),
        ):
            named[f"{what}_file"] = _attachment_name(what, suffix, content)
            files[named[f"{what}_file"]] = (media_type, content)
    elif controller.linear is True:
        certificate = controller.certificate
        norm = norm_if_implemented(vehicle, controller, run.prediction.timestep)
        records = FEATURES.load_if_known("certificates as data")
        proved = {
            "designed": controller.designed,
            "stable": certificate.stable,
            "poles": [[float(pole.real), float(pole.imag)] for pole in certificate.poles],
            "certificate": None if records is None else records.to_record(certificate) | norm_record(norm),
        }
    claims = {
        **controller_record(controller),
        "samples": len(run.physics.time),
        "road": road.describe(),
        "limits": vehicle.limits.record,
        "implementation": asdict(vehicle.implementation),
        **({"start": dict(vehicle.start)} if vehicle.start else {}),
        **proved,
        "agrees": agreement.agrees,
        "energy": BALANCE(run.energy) if run.energy is not None else None,
        "half_step": run.half_step and HALF_STEP(run.half_step),
        "lift_off": [list(interval) for interval in agreement.lift_off],
        "errors": {name: signal.sampled if math.isfinite(signal.sampled) else None for name, signal in agreement.signals.items()},
    }
    return claims | named, files


def run_log(run: Run, name: RunName, measured: Response | None = None) -> RunLog:
    """Converts a run to the data that `sim.record` writes.

    Args:
        run: run that MuJoCo has simulated, not a run from a log.
        name: name of the run in the log.
        measured: signals of a measured log during the time of the run; None without a measured log. Measured signals that the
            vehicle does not have are omitted.

    Returns:
        Responses, metadata, events, scene and verdict of the run.

    Raises:
        InputError: the name contains characters other than letters, digits, '_' and '-', or more than 120 characters.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from models import Bump, read_vehicle
        >>> from sim import record, run, run_log
        >>> from synth import design_controllers
        >>> vehicle = read_vehicle("quarter_car")
        >>> [passive] = run(vehicle, design_controllers(vehicle, ["passive"]), Bump(height=0.05), duration=0.5)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     paths = record(Path(folder), "mine", [run_log(passive, "passive")], metadata={}, attachments={})
        ...     paths["mcap"].name, paths["rerun"].name
        ('mine.mcap', 'mine.rrd')
    """
    vehicle, road = run.vehicle, run.road
    assert run.qpos is not None, "the run was computed by MuJoCo"
    claims, files = claims_of(run)
    acting: dict[str, Response | None] = {}
    drawn: tuple[Diagram, ...] = ()
    responses = {MUJOCO: run.physics, SAMPLED: run.sampled, CONTINUOUS: run.continuous}
    if road.loaded:
        acting[LOADS] = FEATURES.load("forces of parts").load_histories(vehicle, road, run.physics.time)
    if vehicle.parts.with_curve or vehicle.parts.adjustable:
        force_diagram = FEATURES.load("force diagrams")
        acting[DAMPERS], drawn = force_diagram.diagram_signals(vehicle, run.physics), tuple(force_diagram.diagrams(vehicle))
    if measured is not None and (names := [one for one in measured.names if one in run.physics.names]):
        acting[MEASURED_TOPIC] = measured.only(names)
    return RunLog(
        name=name,
        responses={name: one for name, one in responses.items() if name == MUJOCO or not np.isnan(one.values).all()},
        metadata={key: value if isinstance(value, str) else json.dumps(value) for key, value in claims.items()},
        events=events(run),
        summary=markdown(describe_run(run), 1),
        scene=scene_of(run.prediction.input, run.physics, run.qpos),
        verdict=verdict(run).text,
        files=files,
        other_signals={name: one for name, one in acting.items() if one is not None},
        diagrams=drawn,
        active=_active(run),
    )


def _active(run: Run) -> tuple[str, ...]:
    """Returns the names of a controller's states, sorted by their largest contribution to the force in the sampled response."""
    if run.controller.linear is False:
        return ()
    names = [signal.name for signal in run.sampled.signals if is_kept(signal)]
    gains = np.abs(run.controller.law.C).max(axis=0, initial=0.0)
    with np.errstate(over="ignore", invalid="ignore"):  # signals of an unstable loop may overflow
        peaks = [float(np.nan_to_num(gain * run.sampled.peak(name), nan=np.inf)) for gain, name in zip(gains, names, strict=True)]
    return tuple(names[i] for i in np.argsort(-np.array(peaks), kind="stable"))
