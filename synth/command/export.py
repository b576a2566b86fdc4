"""`python -m synth --export DIR` and `--check DIR`: a controller as C99, and if it still is the one that was certified."""

import hashlib
import json
import shutil
import subprocess
import tempfile
from argparse import Namespace
from pathlib import Path

from models.common.command import one_chosen
from models.common.errors import InputError
from models.common.files import made_folder, read_text
from models.common.printed import say
from models.vehicle.vehicle import Vehicle, parse_vehicle
from synth.command.save import SUFFIX, saved_text
from synth.controller.controller import Controller, Driver
from synth.controller.export.c_law import ExportedLaw, PythonStep, c_name, exported_law, random_inputs
from synth.controller.export.c_source import FLAGS
from synth.controller.export.folder import CERTIFICATE, MANIFEST, SEED, VEHICLE, files, with_tables
from synth.vehicle.designer import Designer

MOST = 10_000_000  # bytes of a file of the folder
FEW = 50  # samples on a simulated processor


def export(vehicle: Vehicle, options: Namespace) -> int:
    """Writes the folder of one controller and prints what is in it; returns the exit code.

    Raises:
        InputError: there is no such controller, it cannot be exported, or the folder is not empty.
    """
    names = [name for name in vehicle.controller_names if name != "passive"]
    given = options.controller or []
    if len(given) > 1:
        raise InputError(f"--export writes one controller; give --controller with one of: {', '.join(names)}")
    name, folder = one_chosen(names, given[0] if given else None), options.export
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"--export {folder}: is there already, and not empty; name another folder, or remove it")
    prefix = c_name(name)
    saved, own = saved_with_law(vehicle, name)
    texts = _texts(saved, own, options.numbers, prefix)
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
        print(
            json.dumps({"folder": str(folder), "name": prefix, "controller": own, "numbers": options.numbers, "files": [*texts]})
        )
        return 0
    say(
        [
            f"controller {own} as C99 in {options.numbers}, with the prefix {prefix}",
            *(f"  {path}" for path in texts),
            "",
            f"written to {folder}; its README.md says how to call it, and python -m synth --check {folder} if it is changed",
        ]
    )
    return 0


def saved_with_law(vehicle: Vehicle, name: str) -> tuple[Vehicle, str]:
    """Returns the vehicle whose file holds the controller's law, and the controller's name in it."""
    entry = vehicle.controllers.get(name)
    if entry is not None and (entry.law is not None or entry.semi_active is not None or entry.python is not None):
        return vehicle, name
    controller = Designer(vehicle).design(name)
    if not isinstance(controller, Controller) or not controller.designed:
        return vehicle, name
    folder = Path(vehicle.source).parent
    text = saved_text(folder / VEHICLE, vehicle, [controller])
    return parse_vehicle(text, folder=folder), name + SUFFIX


def _texts(vehicle: Vehicle, name: str, numbers: str, prefix: str) -> dict[str, str]:
    driver = driver_of(vehicle, name)
    return files(vehicle, driver, exported_law(vehicle, driver, numbers, prefix))


def driver_of(vehicle: Vehicle, name: str) -> Driver:
    """Returns the controller of that name, whose law the vehicle file gives."""
    if name in vehicle.linear_names:
        return Designer(vehicle, search=False).design(name)
    return vehicle.controllers[name].driver()


def check_folder(folder: Path, options: Namespace) -> int:
    """Says which files of an exported folder are not what was exported, and if its controller's certificate holds.

    Returns:
        0 if nothing is changed, every claim holds, and the code gives the outputs of the test vectors; else 1.

    Raises:
        InputError: the folder is no exported controller.
    """
    try:
        about = json.loads(read_text(folder / CERTIFICATE, "certificate", MOST, "name a folder of --export"))
        name, numbers, prefix = about["controller"]["name"], about["numbers"], about["name"]
        tables = about["tables"]
    except InputError:
        raise
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{folder / CERTIFICATE}: is not as --export writes it ({error}); export the controller again"
        ) from error
    text = read_text(folder / VEHICLE, "vehicle file", MOST, "name a folder of --export")
    try:
        vehicle = parse_vehicle(text, folder=folder)
        driver = driver_of(vehicle, name)
        law = exported_law(vehicle, driver, numbers, prefix)
    except (InputError, KeyError) as error:
        raise InputError(
            f"{folder / VEHICLE}: {error}; it is changed, or {CERTIFICATE} is: export the controller again"
        ) from error
    failures = list[str]()
    exact = with_tables(law, tables)
    if exact is None:
        failures.append(f"{CERTIFICATE}: its tables are not those of the law in {VEHICLE}")
    wanted = files(vehicle, driver, exact or law)
    there = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    for path in sorted({*wanted, *there}):
        if path not in there:
            failures.append(f"{path}: is missing")
        elif path not in wanted:
            failures.append(f"{path}: was not exported")
        elif (folder / path).read_bytes() != wanted[path].encode():
            failures.append(f"{path}: is changed")
    said = _manifest(folder, there)
    failures += [one for one in said if one not in failures]
    claims = _claims(vehicle, name)
    ran, same = _back_to_back(folder, prefix) if not failures else ("the code was not run", True)
    failures += [] if same else [ran]
    if options.cortex_m4:
        elsewhere, same = _on_cortex_m4(exact or law)
        ran = f"{ran}; {elsewhere}"
        failures += [] if same else [elsewhere]
    verdict = f"NOT AS EXPORTED: {'; '.join(failures)}" if failures else "nothing is changed"
    verdict += "" if isinstance(claims, str) else f"; ITS CLAIMS FAIL: {'; '.join(claims)}"
    failures += [] if isinstance(claims, str) else claims
    if options.json:
        print(json.dumps({"folder": str(folder), "controller": name, "failures": failures, "back_to_back": ran}))
    else:
        say(
            [
                f"controller {name} as C99 in {numbers}",
                f"  {claims if isinstance(claims, str) else 'its claims do not hold'}",
                f"  {ran}",
                "",
                verdict,
            ]
        )
    return 1 if failures else 0


def _on_cortex_m4(law: ExportedLaw) -> tuple[str, bool]:
    """Returns what a simulated Cortex-M4 makes of random samples, and False if it is not what this machine makes of them."""
    from synth.controller.export.cortex_m4 import run

    samples, step = list(random_inputs(law, FEW, SEED)), PythonStep(law)
    found = run(law, samples)
    differ = sum([float(value) for value in step(row)] != given for row, given in zip(samples, found.outputs, strict=True))
    counts = f"{found.least} to {found.most} instructions a step, {found.stack} bytes of stack, {found.size} of code and tables"
    return f"Cortex-M4: {FEW} samples, {differ} differ; {counts}", differ == 0


def _manifest(folder: Path, there: set[str]) -> list[str]:
    """Returns the files whose checksum is not the manifest's."""
    if MANIFEST not in there:
        return []
    lines = [line.partition("  ") for line in (folder / MANIFEST).read_text("utf-8", errors="replace").splitlines()]
    sums = {name: digest for digest, _, name in lines}
    found = {path: hashlib.sha256((folder / path).read_bytes()).hexdigest() for path in there & set(sums)}
    return [f"{path}: is changed" for path, digest in sorted(found.items()) if digest != sums[path]]


def _claims(vehicle: Vehicle, name: str) -> str | list[str]:
    from synth.command.check import check

    if name not in vehicle.linear_names or vehicle.controllers[name].law is None:
        return "no claim is made of a semi-active law"
    (row,) = check(Designer(vehicle), [name])
    return list(row.failures) if row.failures else row.notes[-1]


def _back_to_back(folder: Path, prefix: str) -> tuple[str, bool]:
    """Returns what the compiled code says of the test vectors, or that there is no compiler; and False if it is wrong."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        return "no C compiler is here: the code was not run", True
    with tempfile.TemporaryDirectory() as beside:
        program = str(Path(beside) / "back_to_back")
        sources = [str(folder / f"{prefix}.c"), str(folder / "test" / "main.c")]
        built = subprocess.run([compiler, *FLAGS.split(), *sources, "-o", program], capture_output=True, text=True, check=False)
        if built.returncode:
            why = "; ".join(built.stderr.splitlines()[:1])
            return f"the compiler {Path(compiler).name} refuses the code: {why}", False
        ran = subprocess.run([program, str(folder / "test" / "vectors.csv")], capture_output=True, text=True, check=False)
    said = ran.stdout.strip() or "it crashed"
    return f"back to back: {said}", ran.returncode == 0
