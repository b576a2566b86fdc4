"""Where a log comes from: versions, command line, vehicle file, MJCF."""

import datetime
import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from models.common.versions import versions
from models.mjcf import mjcf_text
from models.own.python_law import Programmed
from models.signals import is_kept
from models.vehicle import Vehicle
from sim.acting.diagram import diagrams, pulled
from sim.acting.loads import pushed
from sim.linear.dampers import command_names
from sim.recording.drawing import scene_of
from sim.recording.format import CONTINUOUS, DAMPERS, FORMAT, LOADS, MUJOCO, SAMPLED, check_keys
from sim.recording.run_log import RunLog
from sim.runs.energy import energy_object
from sim.runs.forces import written_forces
from sim.runs.run import Run
from sim.runs.words import controller_object, events, half_step_object, summary, verdict
from synth.certificate.record import to_record
from synth.controller import Controller
from synth.implemented.claims import norm_if_implemented, norm_record


def stem(command: str, vehicle: Vehicle, controllers: Sequence[str]) -> str:
    """Name of a log: what was run, and when (UTC)."""
    now = datetime.datetime.now(datetime.UTC).strftime("%Y%m%dT%H%M%SZ")
    which = "_".join(controllers) if len(controllers) <= 3 else f"{len(controllers)}_controllers"
    return f"{command}-{vehicle.kind.name}-{which}-{now}"


def common_metadata(command_line: str, vehicle: Vehicle, timestep: float) -> dict[str, str]:
    """What all runs of a log share.

    Args:
        command_line: `python -m sim.COMMAND ...`, which does the same again.
        vehicle: as it was read.
        timestep: [s].
    """
    return {
        "format": str(FORMAT),
        "command": command_of(command_line),
        "command_line": command_line,
        "vehicle": vehicle.source,
        "vehicle_type": vehicle.kind.name,
        "timestep": repr(timestep),
        "versions": json.dumps(versions()),
    }


def command_of(command_line: str) -> str:
    """The name of the command of a line `python -m sim.NAME ...`; empty where it is none."""
    found = re.match(r"python -m sim\.(\w+)( |$)", command_line)
    return found[1] if found else ""


def attachments(vehicle: Vehicle, timestep: float, result: Mapping[str, Any]) -> dict[str, tuple[str, bytes]]:
    """The vehicle file, the exact MJCF, and the result as `--json` prints it."""
    return {
        "vehicle.toml": ("application/toml", vehicle.text.encode()),
        "model.xml": ("application/xml", mjcf_text(vehicle, timestep).encode()),
        "result.json": ("application/json", json.dumps(result, allow_nan=False).encode()),
    }


def record_runs(
    folder: Path,
    command_line: str,
    vehicle: Vehicle,
    controllers: Sequence[str],
    runs: Mapping[str, Run],
    result: Mapping[str, Any],
) -> dict[str, str]:
    """Records what a command has run, as `sim.recording.files.record` does.

    Args:
        folder: where to.
        command_line: see `common_metadata`.
        vehicle: as it was read.
        controllers: names of those that were run.
        runs: by the names that they have in the log.
        result: as `--json` prints it.

    Returns:
        The files' paths: `mcap` and `rerun`.

    Raises:
        InputError: the folder cannot be written, or the result is none of the command's (`sim.recording.format`).
    """
    from sim.recording.files import record  # it imports Rerun

    check_keys(command_of(command_line), result)
    logs = [run_log(run, name) for name, run in runs.items()]
    time = logs[0].responses[MUJOCO].time
    timestep = float(time[1] - time[0])
    paths = record(
        folder,
        stem(command_of(command_line), vehicle, controllers),
        logs,
        common_metadata(command_line, vehicle, timestep),
        attachments(vehicle, timestep, result) | {name: file for log in logs for name, file in log.files.items()},
    )
    return {name: str(path) for name, path in paths.items()}


def _named(what: str, suffix: str, content: bytes) -> str:
    """The name of an attachment: by its content, so that runs share those that are alike."""
    return f"{what}-{hashlib.sha256(content).hexdigest()[:16]}.{suffix}"


def run_log(run: Run, name: str) -> RunLog:
    """One run as it is written down, under a name."""
    vehicle, road, controller, agreement = run.vehicle, run.road, run.controller, run.agreement
    assert run.qpos is not None, "what is written down MuJoCo has run"
    files: dict[str, tuple[str, bytes]] = {}
    named: dict[str, str] = {}
    points = road.points
    if points is not None:
        named["road_file"] = _named("road", "csv", points)
        files[named["road_file"]] = ("text/csv", points)
    proved: dict[str, Any] = {}
    if isinstance(controller, Programmed):
        for what, suffix, media_type, content in (
            ("law", "py", "text/x-python", controller.text.encode()),
            ("forces", "csv", "text/csv", written_forces(command_names(vehicle), run.prediction.asked)),
        ):
            named[f"{what}_file"] = _named(what, suffix, content)
            files[named[f"{what}_file"]] = (media_type, content)
    elif isinstance(controller, Controller):
        certificate = controller.certificate
        norm = norm_if_implemented(vehicle, controller, run.prediction.timestep)
        proved = {
            "designed": controller.designed,
            "stable": certificate.stable,
            "poles": [[float(pole.real), float(pole.imag)] for pole in certificate.poles],
            "certificate": to_record(certificate) | norm_record(norm),
        }
    claims = {
        **controller_object(controller),
        "samples": len(run.physics.time),
        "road": road.describe(),
        "limits": vehicle.limits.record,
        "implementation": asdict(vehicle.implementation),
        **proved,
        "agrees": agreement.agrees,
        "energy": energy_object(run.energy) if run.energy is not None else None,
        "half_step": half_step_object(run),
        "lift_off": [list(interval) for interval in agreement.lift_off],
        "errors": {name: signal.sampled if math.isfinite(signal.sampled) else None for name, signal in agreement.signals.items()},
    }
    claims |= named
    acting = {LOADS: pushed(vehicle, road, run.physics.time), DAMPERS: pulled(vehicle, run.physics)}
    return RunLog(
        name=name,
        responses={MUJOCO: run.physics, SAMPLED: run.sampled, CONTINUOUS: run.continuous},
        metadata={key: value if isinstance(value, str) else json.dumps(value) for key, value in claims.items()},
        events=events(run),
        summary=summary(run),
        scene=scene_of(vehicle, road, run.physics, run.qpos),
        verdict=verdict(run),
        files=files,
        acting={name: one for name, one in acting.items() if one is not None},
        diagrams=tuple(diagrams(vehicle)),
        active=_active(run),
    )


def _active(run: Run) -> tuple[str, ...]:
    """Its controller's states, the one that asks for most at any moment first, as the sampled response has it."""
    if not isinstance(run.controller, Controller):
        return ()
    names = [signal.name for signal in run.sampled.signals if is_kept(signal)]
    asks = np.abs(run.controller.law.C).max(axis=0, initial=0.0)
    with np.errstate(over="ignore", invalid="ignore"):  # of an unstable loop
        most = [float(np.nan_to_num(ask * run.sampled.peak(name), nan=np.inf)) for ask, name in zip(asks, names, strict=True)]
    return tuple(names[i] for i in np.argsort(-np.array(most), kind="stable"))
