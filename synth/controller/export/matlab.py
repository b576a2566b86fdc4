"""Controllers and their vehicle for MATLAB: a file of structs (version 5), and a script that creates `ss` objects from these
structs.
"""

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from models.kinds.signals import Signal
from models.vehicle.vehicle import Vehicle
from synth.analysis.record import to_record
from synth.controller.controller import Controller, check_feedback_alone
from synth.controller.export.c_law import c_name
from synth.controller.export.linear_system import signals_of, vehicle_system
from synth.controller.report import study_notes

VEHICLE, QUOTE = "vehicle", "'"
TITLE = b"MATLAB 5.0 MAT-file of Roadproof"  # the text contains no date, so that the same content always gives the same bytes
LONGEST = 63  # largest number of characters in a name, both in MATLAB and in a file of version 5
RESERVED_WORDS = {  # words that MATLAB reserves, and names of the script's own variables
    *("break", "case", "catch", "classdef", "continue", "else", "elseif", "end", "for", "function", "global", "if", "otherwise"),
    *("parfor", "persistent", "return", "spmd", "switch", "try", "while", "file", "loop", "plant"),
}


def struct_names(controllers: Sequence[Controller]) -> dict[str, str]:
    """Returns the name of the struct for each controller. All names are different, and none is the name of the vehicle's
    struct.
    """
    names, taken = dict[str, str](), {VEHICLE, *RESERVED_WORDS}
    for one in controllers:
        plain = c_name(one.name)[: LONGEST - 4]
        name = next(name for name in (plain, *(f"{plain}_{i}" for i in range(2, 10_000))) if name not in taken)
        taken.add(name)
        names[one.name] = name
    return names


def mat_file(vehicle: Vehicle, controllers: Sequence[Controller]) -> bytes:
    """Returns the bytes of a MAT-file with a struct for each controller, and the struct `vehicle` with the plant.

    The struct of a controller contains A, B, C, D, Ts (0 if continuous) and the names and units of its inputs and outputs. The
    struct also contains `gain`, which is the feedthrough, and `certificate`, which contains the norm, bound, lower bound and X.
    If the vehicle file has a sample period, `sampled` contains the matrices of the discrete implementation.
    """
    for one in controllers:
        check_feedback_alone(one, "a file for MATLAB")
    from scipy.io import savemat

    system, period = vehicle_system(vehicle), vehicle.implementation.sample_period
    matrices = {name: getattr(system, name) for name in "ABCD"}
    signals = {name: signals_of(vehicle, getattr(system, name)) for name in ("inputs", "states", "outputs")}
    model = (
        matrices | {"Ts": 0.0} | {name: value for key, some in signals.items() for name, value in _cell_arrays(key, some).items()}
    )
    content: dict[str, Any] = {VEHICLE: {"kind": vehicle.kind.name, "model": model}}
    for one in controllers:
        law = one.law
        read, given = ([vehicle.kind.signal(name) for name in some] for some in (one.measured, vehicle.linear_model.inputs))
        struct = {name: getattr(law, name) for name in "ABCD"} | {"Ts": law.sample_period or 0.0, "gain": law.D}
        struct |= (
            _cell_arrays("inputs", read) | _cell_arrays("outputs", given) | {"certificate": _plain(to_record(one.certificate))}
        )
        if law.anti_windup is not None:
            struct["anti_windup"] = law.anti_windup
        if period is not None:
            run = law.sampled(period)
            struct["sampled"] = {name: getattr(run, name) for name in "ABCD"} | {"Ts": period}
        content[struct_names(controllers)[one.name]] = struct
    file = io.BytesIO()
    savemat(file, content, format="5", long_field_names=True, oned_as="row")
    return TITLE.ljust(116) + file.getvalue()[116:]


def _cell_arrays(what: str, signals: Sequence[Signal]) -> dict[str, Any]:
    """Returns names, units and meanings of signals as MATLAB cell arrays."""
    columns = {what: "name", f"{what}_units": "unit", f"{what}_meanings": "meaning"}
    return {key: _cell([getattr(one, attribute) for one in signals]) for key, attribute in columns.items()}


def _cell(texts: Sequence[str]) -> Any:
    cell = np.empty((len(texts), 1), dtype=object)
    cell[:, 0] = texts
    return cell


def _plain(record: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the numbers of a certificate as arrays."""
    return {key: np.asarray(value, dtype=float) for key, value in record.items() if key == "X" or isinstance(value, float)}


def script(file: str, vehicle: Vehicle, controllers: Sequence[Controller]) -> str:
    """Returns MATLAB code that creates `ss` objects of the plant and of each controller, and connects these objects by signal
    names.
    """
    names = struct_names(controllers)
    lines = [
        f"% Creates ss objects of the plant and of each controller from {file}; needs the Control System Toolbox.",
        "% All signals are in SI units and measured from static equilibrium. Feedback is positive: u = K y.",
        f"file = load('{file.replace(QUOTE, 2 * QUOTE)}');",
        *_ss("plant", f"file.{VEHICLE}.model"),
    ]
    for one in controllers:
        lines += [f"% {one.name}: {text}" for text in study_notes(vehicle, one)]
        lines += [f"% {one.name}: {one.kind} from {', '.join(one.measured)}", *_ss(names[one.name], f"file.{names[one.name]}")]
    roads = [wheel.road_velocity for wheel in vehicle.kind.wheels]
    listed = ", ".join(f"'{name}'" for name in roads)
    example = names[controllers[0].name]
    lines += [
        "% Closed loop from the roads to all outputs of the vehicle, if plant and controller are continuous:",
        f"% loop = connect(plant, {example}, {{{listed}}}, file.{VEHICLE}.model.outputs);",
    ]
    return "\n".join(lines) + "\n"


def _ss(name: str, where: str) -> list[str]:
    return [
        f"{name} = ss({where}.A, {where}.B, {where}.C, {where}.D, {where}.Ts, ...",
        f"    'InputName', {where}.inputs, 'InputUnit', {where}.inputs_units, ...",
        f"    'OutputName', {where}.outputs, 'OutputUnit', {where}.outputs_units);",
    ]
