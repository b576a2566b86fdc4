"""`python -m synth --export FILE.mat` and `FILE.fmu`: controllers, and the vehicle, as a file for another program."""

import json
from argparse import Namespace
from pathlib import Path

from models.common.command import ALL, chosen, one_chosen
from models.common.errors import InputError, listing
from models.common.files import together, whole_file
from models.common.printed import say
from models.laws.python_law import sha256
from models.vehicle.vehicle import Vehicle
from synth.command.export import driver_of, saved_with_law
from synth.command.save import left_out_lines
from synth.controller.controller import Controller
from synth.controller.export.c_law import c_name, exported_law
from synth.controller.export.fmu_model import FmuModel, check_floating, law_model, linear_model
from synth.controller.export.folder import CERTIFICATE, VEHICLE, files
from synth.controller.export.linear_system import loop_system, vehicle_system
from synth.vehicle.designer import Designer

SUFFIXES = (".mat", ".fmu")


def export_file(vehicle: Vehicle, options: Namespace) -> int:
    """Writes the file of --export, and prints what is in it; returns the exit code.

    Raises:
        InputError: a controller is unknown, or none that this file can hold, or the file cannot be written.
    """
    return _mat(vehicle, options) if options.export.suffix.lower() == ".mat" else _fmu(vehicle, options)


def _mat(vehicle: Vehicle, options: Namespace) -> int:
    """Writes a file for MATLAB, and a script beside it."""
    from synth.controller.export.matlab import mat_file, script, struct_names

    if "numbers" in options.given:
        raise InputError("--numbers is of code, and a file for MATLAB has double numbers; omit it")
    linear = [name for name in vehicle.linear_names if name != "passive"]
    own = [name for name in linear if name in vehicle.controllers]
    left_out = [] if options.controller not in (None, [ALL]) else [one for one in own if vehicle.controllers[one].preview]
    held = [name for name in own if name not in left_out] or own
    names = held if options.controller in (None, [ALL]) else chosen(vehicle.controller_names, options.controller, held)
    other = [name for name in names if name not in linear]
    if other:
        raise InputError(f"controller {other[0]!r} has no matrices; a file for MATLAB takes linear ones: {listing(linear)}")
    if not names:
        raise InputError(f"{vehicle.source} has no linear controller; a file for MATLAB needs one")
    designer = Designer(vehicle, search=False)
    controllers: list[Controller] = [designer.design(name) for name in names]
    file: Path = options.export
    beside = file.with_name(f"{c_name(file.stem)}_ss.m")
    with together():
        with whole_file(file, "export") as part:
            part.write_bytes(mat_file(vehicle, controllers))
        with whole_file(beside, "export") as part:
            part.write_text(script(file.name, vehicle, controllers), encoding="utf-8", newline="\n")
    structs = struct_names(controllers)
    if options.json:
        print(json.dumps({"files": [str(file), str(beside)], "structs": structs}))
        return 0
    say(
        [
            f"{file}: a struct for each controller, and vehicle with the plant",
            *(
                f"  {structs[one.name]}: {one.states or 'no'} state{'s' * (one.states != 1)}, from {', '.join(one.measured)}; "
                f"norm {one.certificate.norm.value:.7g}"
                for one in controllers
            ),
            *left_out_lines(left_out),
            "",
            f"{beside} makes ss objects of them in MATLAB",
        ]
    )
    return 0


def _fmu(vehicle: Vehicle, options: Namespace) -> int:
    """Writes an FMU: a controller, the vehicle, or both as one linear system."""
    from synth.controller.export.fmu import fmu

    if options.part != "controller" and "numbers" in options.given:
        raise InputError(f"--numbers is of a controller's code, and --part {options.part} is linear equations; omit it")
    model, resources, about = _controller(vehicle, options) if options.part == "controller" else _linear(vehicle, options)
    with whole_file(options.export, "export") as beside:
        made = fmu(model, options.fmi, resources, about)
        beside.write_bytes(made.content)
    if options.json:
        record = {"file": str(options.export), "fmi": options.fmi, "token": made.token, "platforms": made.platforms}
        print(
            json.dumps({**record, "inputs": [one.name for one in model.inputs], "outputs": [one.name for one in model.outputs]})
        )
        return 0
    kinds = "model exchange and co-simulation" if model.states else "co-simulation"
    say(
        [
            f"{options.export}: {model.title}, FMI {options.fmi}.0 for {kinds}",
            *(f"  in   {one.name} [{one.unit}]" for one in model.inputs),
            *(f"  out  {one.name} [{one.unit}]" for one in model.outputs),
            "",
            "it must be stepped " + (f"every {model.period:g} s" if model.period is not None else "with steps of any length"),
            f"binaries: {listing(made.platforms)}" if made.platforms else "",
            made.missing,
        ]
    )
    return 0


def _controller(vehicle: Vehicle, options: Namespace) -> tuple[FmuModel, dict[str, str], str]:
    """Returns a controller as the content of an FMU, with the exported folder as its resources."""
    check_floating(options.numbers)
    names, given = [name for name in vehicle.controller_names if name != "passive"], options.controller or []
    if len(given) > 1:
        raise InputError(f"--export writes one controller; give --controller with one of: {', '.join(names)}")
    name = one_chosen(names, given[0] if given else None)
    saved, own = saved_with_law(vehicle, name)
    plain, driver = c_name(name), driver_of(saved, own)
    prefix = plain if plain.startswith("law_") else f"law_{plain}"
    law = exported_law(saved, driver, options.numbers, prefix)
    texts = files(saved, driver, law)
    return law_model(saved, law, sha256(texts[CERTIFICATE])), texts, texts["README.md"]


def _linear(vehicle: Vehicle, options: Namespace) -> tuple[FmuModel, dict[str, str], str]:
    """Returns the linear vehicle, alone or with a controller, as the content of an FMU."""
    kind = f"{vehicle.kind.name}, linear"
    if options.part == "vehicle":
        if options.controller:
            raise InputError("--part vehicle has no controller in it; omit --controller, or request --part loop")
        model = linear_model(c_name(vehicle.kind.name), kind, vehicle_system(vehicle))
        return model, {VEHICLE: vehicle.text}, _about(model)
    linear, given = [name for name in vehicle.linear_names if name != "passive"], options.controller or []
    if len(given) > 1:
        raise InputError(f"--part loop closes one loop; give --controller with one of: {', '.join(linear)}")
    name = one_chosen(linear, given[0] if given else None)
    saved, own = saved_with_law(vehicle, name)
    controller = driver_of(saved, own)
    assert isinstance(controller, Controller), "its name is of a linear one"
    identifier = f"{c_name(vehicle.kind.name)}_{c_name(name)}"
    model = linear_model(identifier, f"{kind}, with controller {own} in continuous time", loop_system(saved, controller))
    return model, {VEHICLE: saved.text}, _about(model)


def _about(model: FmuModel) -> str:
    """Returns the documentation of a linear system."""
    named = [("input", one) for one in model.inputs] + [("output", one) for one in model.outputs]
    rows = "".join(f"{what:7} {one.name} [{one.unit}]: {one.meaning}\n" for what, one in named)
    return (
        f"{model.title}\n\n{rows}\nAll is measured from static equilibrium, upwards positive. Springs, dampers and tyres are\n"
        "linear, whatever curves or stops the vehicle file has. In co-simulation inputs are held over a step, and the step is\n"
        f"exact for that. {VEHICLE} in resources is the vehicle.\n"
    )
