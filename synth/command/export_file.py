"""`python -m synth --export FILE.mat`: controllers as one file for a program that reads it."""

import json
from argparse import Namespace
from pathlib import Path

from models.common.command import ALL, chosen
from models.common.errors import InputError, listing
from models.common.files import together, whole_file
from models.common.printed import say
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller
from synth.controller.export.c_law import c_name
from synth.vehicle.designer import Designer

SUFFIXES = (".mat",)


def export_file(vehicle: Vehicle, options: Namespace) -> int:
    """Writes the file of --export, and prints what is in it; returns the exit code.

    Raises:
        InputError: a controller is unknown or not linear, or the file cannot be written.
    """
    return _mat(vehicle, options)


def _mat(vehicle: Vehicle, options: Namespace) -> int:
    """Writes a file for MATLAB, and a script beside it."""
    from synth.controller.export.matlab import mat_file, script, struct_names

    if "numbers" in options.given:
        raise InputError("--numbers is of code, and a file for MATLAB has double numbers; leave it out")
    linear = [name for name in vehicle.linear_names if name != "passive"]
    own = [name for name in linear if name in vehicle.controllers]
    names = own if options.controller in (None, [ALL]) else chosen(vehicle.controller_names, options.controller, own)
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
                f"  {structs[one.name]}: {one.states or 'no'} states, from {', '.join(one.measured)}; norm "
                f"{one.certificate.norm.value:.7g}"
                for one in controllers
            ),
            "",
            f"{beside} makes ss objects of them in MATLAB",
        ]
    )
    return 0
