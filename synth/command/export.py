"""`python -m synth --export DIR` and `--check DIR`: a controller as C99, and if it still is the one that was certified."""

import json
import math
import subprocess
import tempfile
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from models.common.command import one_chosen
from models.common.errors import InputError
from models.common.files import made_folder
from models.common.printed import say
from models.vehicle.vehicle import Vehicle, parse_vehicle
from synth.command.save import SUFFIX, saved_text
from synth.controller.controller import Controller, Driver, check_feedback_alone
from synth.controller.export.c_law import c_name, exported_law
from synth.controller.export.c_source import FLAGS
from synth.controller.export.compiled import compiler
from synth.controller.export.folder import VEHICLE, files, read_folder
from synth.vehicle.designer import Designer

RANGES = (1e-9, 1e9)  # largest magnitudes of readings, SI


def export(vehicle: Vehicle, options: Namespace) -> int:
    """Writes the folder of one controller and prints what is in it; returns the exit code.

    Raises:
        InputError: the controller does not exist or cannot be exported, or the folder is not empty.
    """
    names = [name for name in vehicle.controller_names if name != "passive"]
    given = options.controller or []
    if len(given) > 1:
        raise InputError(f"--export writes one controller; give --controller with one of: {', '.join(names)}")
    name, folder = one_chosen(names, given[0] if given else None), options.export
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"--export {folder}: is there already, and not empty; give another folder, or remove it")
    prefix = c_name(name)
    saved, own = saved_with_law(vehicle, name)
    driver = driver_of(saved, own)
    law = exported_law(saved, driver, options.numbers, prefix, _ranges(options.ranges))
    texts = files(saved, driver, law)
    with (
        made_folder(folder.parent, "export"),
        tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}.") as beside,
    ):
        whole = Path(beside) / "whole"
        for path, text in texts.items():
            file = whole / path
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8", newline="\n")
        if folder.exists():
            folder.rmdir()
        whole.rename(folder)
    if options.json:
        found = {"folder": str(folder), "name": prefix, "controller": own, "numbers": options.numbers, "files": [*texts]}
        print(json.dumps(found, allow_nan=False))
        return 0
    say(
        [
            f"controller {own} as C99 in {options.numbers}, with the prefix {prefix}",
            *(f"  {path}" for path in texts),
            "",
            f"written to {folder}; its README.md shows how to call it, and python -m synth --check {folder} if it is changed",
        ]
    )
    return 0


def saved_with_law(vehicle: Vehicle, name: str) -> tuple[Vehicle, str]:
    """Returns the vehicle whose file holds the controller's law, and the controller's name in it."""
    entry = vehicle.controllers.get(name)
    if vehicle.driven_by(name) is not vehicle:
        raise InputError(
            f"--export: {name!r} drives actuators that push, in a file with adjustable dampers, and code is of one sort; export "
            "it from a file without [actuators]"
        )
    if entry is not None and (entry.law is not None or entry.semi_active is not None or entry.python is not None):
        return vehicle, name
    controller = Designer(vehicle).design(name)
    if not isinstance(controller, Controller) or not controller.designed:
        return vehicle, name
    check_feedback_alone(controller, "an export")
    folder = Path(vehicle.source).parent
    text = saved_text(folder / VEHICLE, vehicle, [controller])
    return parse_vehicle(text, folder=folder), name + SUFFIX


def _ranges(given: Sequence[str]) -> dict[str, float]:
    """Returns the ranges of `--range SIGNAL=NUMBER`, by signal.

    Raises:
        InputError: a range does not have this form, is out of range, or is given twice.
    """
    ranges = {}
    for text in given:
        name, _, number = text.partition("=")
        if name in ranges:
            raise InputError(f"--range {text}: {name} has a range already; give it once")
        try:
            ranges[name] = float(number)
        except ValueError:
            ranges[name] = math.nan
        low, high = RANGES
        if not low <= ranges[name] <= high:
            raise InputError(
                f"--range {text}: give a signal and its largest magnitude, {low:g} to {high:g}, as in --range sprung_velocity=1.5"
            )
    return ranges


def driver_of(vehicle: Vehicle, name: str) -> Driver:
    """Returns the controller of that name, whose law the vehicle file gives."""
    if name in vehicle.linear_names:
        return Designer(vehicle, search=False).design(name)
    return vehicle.controllers[name].driver()


def check_folder(folder: Path, options: Namespace) -> int:
    """Prints which files of an exported folder were changed, and whether its controller's certificate holds.

    Returns:
        0 if nothing is changed, every claim holds, and the code gives the outputs of the test vectors; else 1.

    Raises:
        InputError: the folder is not an exported controller.
    """
    found = read_folder(folder, driver_of)
    vehicle, law, failures = found.vehicle, found.law, list(found.failures)
    name, prefix = law.controller, law.name
    claims = _claims(vehicle, name)
    ran, same = _back_to_back(folder, prefix) if not failures else ("the code was not run", True)
    failures += [] if same else [ran]
    verdict = f"NOT AS EXPORTED: {'; '.join(failures)}" if failures else "nothing is changed"
    verdict += "" if isinstance(claims, str) else f"; ITS CLAIMS FAIL: {'; '.join(claims)}"
    failures += [] if isinstance(claims, str) else claims
    if options.json:
        print(json.dumps({"folder": str(folder), "controller": name, "failures": failures, "back_to_back": ran}))
    else:
        say(
            [
                f"controller {name} as C99 in {law.numbers}",
                f"  {claims if isinstance(claims, str) else 'its claims do not hold'}",
                f"  {ran}",
                "",
                verdict,
            ]
        )
    return 1 if failures else 0


def _claims(vehicle: Vehicle, name: str) -> str | list[str]:
    from synth.command.check import check

    if name not in vehicle.linear_names or vehicle.controllers[name].law is None:
        return "no claim is made of a semi-active law"
    (row,) = check(Designer(vehicle), [name])
    return list(row.failures) if row.failures else row.notes[-1]


def _back_to_back(folder: Path, prefix: str) -> tuple[str, bool]:
    """Returns what the compiled code says of the test vectors, or that there is no compiler; and False if it is wrong."""
    try:
        command = compiler()
    except InputError:
        return "no C compiler is here: the code was not run", True
    with tempfile.TemporaryDirectory() as beside:
        program = str(Path(beside) / "back_to_back")
        sources = [str(folder / f"{prefix}.c"), str(folder / "test" / "main.c")]
        built = subprocess.run([*command, *FLAGS.split(), *sources, "-o", program], capture_output=True, text=True, check=False)
        if built.returncode:
            why = "; ".join(built.stderr.splitlines()[:1])
            return f"the compiler {Path(command[0]).name} refuses the code: {why}", False
        ran = subprocess.run([program, str(folder / "test" / "vectors.csv")], capture_output=True, text=True, check=False)
    said = ran.stdout.strip() or "it crashed"
    return f"back to back: {said}", ran.returncode == 0
