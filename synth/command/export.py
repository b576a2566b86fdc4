"""`python -m synth --export` and `--check DIR`: write controllers as C99 code, an FMU or a MATLAB file, and check them."""

import math
import subprocess
import tempfile
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from models.common.command import ALL, chosen_controllers, one_chosen, print_json
from models.common.errors import InputError, list_names
from models.common.files import made_folder, together, whole_file
from models.common.printed import Whole, pasted_path, say, show
from models.laws.python_law import sha256
from models.vehicle.vehicle import Vehicle, parse_vehicle
from synth.command.certificates import write_certificates
from synth.command.save import SUFFIX, left_out_lines, saved_text
from synth.controller.controller import Controller, check_feedback_alone
from synth.controller.export.c_law import ExportedLaw, c_name, exported_law
from synth.controller.export.c_source import FLAGS
from synth.controller.export.compiled import compiler
from synth.controller.export.fmu_model import FmuModel, law_model, linear_model
from synth.controller.export.folder import CERTIFICATE, CERTIFICATES, VEHICLE, files, read_folder
from synth.controller.export.linear_system import loop_system, vehicle_system
from synth.controller.measured_heights import STUDY
from synth.controller.report import NORM
from synth.vehicle.designer import Designer, driver_of
from synth.vehicle.lmi_certificates import certificate_texts

RANGES = (1e-9, 1e9)  # smallest and largest allowed range; a range is the largest magnitude of a measurement in its SI unit


def export(vehicle: Vehicle, options: Namespace) -> int:
    """Writes the folder or the file that `--export` names, prints what it contains, and returns the exit code.

    Raises:
        InputError: a controller is unknown or cannot be exported in this form, or the folder or file cannot be written.
    """
    record, lines = {".mat": _mat, ".fmu": _fmu}.get(options.export.suffix.lower(), _folder)(vehicle, options)
    names = [name for name in vehicle.controllers if vehicle.controllers[name].study]
    studied = [name for name in names if options.controller in (None, [ALL]) or name in options.controller]
    if options.json:
        print_json(record)
    else:
        say([*lines, *(f"{name}: {STUDY}" for name in studied)])
    return 0


def _one(vehicle: Vehicle, options: Namespace, names: Sequence[str], what: str) -> tuple[str, Vehicle, str]:
    """Returns the requested controller, the vehicle whose file contains its law, and the controller's name in this file."""
    names, given = [name for name in names if name != "passive"], options.controller or []
    if len(given) > 1:
        raise InputError(f"{what}; give --controller with one of: {', '.join(names)}")
    name = one_chosen(names, given[0] if given else None)
    return name, *_saved_with_law(vehicle, name)


def _law(vehicle: Vehicle, options: Namespace, prefix: Callable[[str], str]) -> tuple[Vehicle, ExportedLaw, dict[str, str]]:
    """Returns the vehicle whose file contains the controller, the exported law, and the texts of the exported files."""
    name, saved, own = _one(vehicle, options, vehicle.controller_names, "--export writes one controller")
    driver = driver_of(saved, own)
    law = exported_law(saved, driver, options.numbers, prefix(c_name(name)), _ranges(options.ranges))
    certificates = certificate_texts(saved, [driver], law) if driver.linear is True else {}
    return saved, law, files(saved, driver, law, certificates)


def _folder(vehicle: Vehicle, options: Namespace) -> tuple[dict[str, Any], list[str]]:
    """Writes the folder of one controller. Returns the contents of the folder, both for JSON and as lines of text."""
    folder: Path = options.export
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"--export {folder} exists and is not empty; give a different folder, or remove this folder")
    _, law, texts = _law(vehicle, options, str)
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
    return {
        "folder": str(folder),
        "name": law.name,
        "controller": law.controller,
        "numbers": options.numbers,
        "files": [*texts],
    }, [
        f"controller {law.controller} as C99 code with {options.numbers} numbers; its names begin with {law.name}",
        *(f"  {path}" for path in texts),
        "",
        f"written to {folder}; its README.md shows how to call the code. This command verifies the files:",
        Whole(f"  roadproof synth --check {pasted_path(folder)}"),
    ]


def _mat(vehicle: Vehicle, options: Namespace) -> tuple[dict[str, Any], list[str]]:
    """Writes a MATLAB file with a script and LMI certificates in the same folder."""
    from synth.controller.export.matlab import mat_file, script, struct_names

    if "numbers" in options.given:
        raise InputError(
            "--numbers applies only to C code, but a MATLAB file always contains numbers in double precision; omit --numbers"
        )
    linear = [name for name in vehicle.linear_names if name != "passive"]
    own = [name for name in linear if name in vehicle.controllers]
    left_out = [] if options.controller not in (None, [ALL]) else [one for one in own if vehicle.controllers[one].request.preview]
    held = [name for name in own if name not in left_out] or own
    names = (
        held if options.controller in (None, [ALL]) else chosen_controllers(vehicle.controller_names, options.controller, held)
    )
    other = [name for name in names if name not in linear]
    if other:
        raise InputError(
            f"controller {other[0]!r} has no law with matrices to write to a MATLAB file; give a linear controller: "
            f"{list_names(linear)}"
        )
    if not names:
        raise InputError(
            f"{vehicle.source} contains no linear controller, but a MATLAB file can contain only linear controllers; add a "
            "linear controller to [controllers]"
        )
    designer = Designer(vehicle, search=False)
    controllers: list[Controller] = [designer.design(name) for name in names]
    file: Path = options.export
    beside = file.with_name(f"{c_name(file.stem)}_ss.m")
    with together():
        with whole_file(file, "export") as part:
            part.write_bytes(mat_file(vehicle, controllers))
        with whole_file(beside, "export") as part:
            part.write_text(script(file.name, vehicle, controllers), encoding="utf-8", newline="\n")
        proofs = file.with_name(f"{c_name(file.stem)}_certificates")
        certificates = write_certificates(proofs, vehicle, controllers)
    structs = struct_names(controllers)
    return {"files": [str(file), str(beside), *(str(proofs / name) for name in certificates)], "structs": structs}, [
        f"{file}: one struct for each controller, and the struct vehicle with the plant",
        *(
            f"  {structs[one.name]}: {one.states or 'no'} state{'s' * (one.states != 1)}, measures {', '.join(one.measured)}; "
            f"norm {NORM.cell(one.certificate)}"
            for one in controllers
        ),
        *left_out_lines(left_out),
        "",
        f"{beside}: a MATLAB script that makes an ss object from each struct",
        f"{proofs}: an LMI certificate of each controller, and programs that check them",
    ]


def _fmu(vehicle: Vehicle, options: Namespace) -> tuple[dict[str, Any], list[str]]:
    """Writes an FMU that contains a controller, the vehicle, or both as one linear system."""
    from synth.controller.export.fmu import fmu

    if options.part != "controller" and "numbers" in options.given:
        raise InputError(f"--numbers applies only to C code, but --part {options.part} exports linear equations; omit --numbers")
    parts = {"controller": _controller, "vehicle": _vehicle, "loop": _loop}
    model, resources, about = parts[options.part](vehicle, options)
    with whole_file(options.export, "export") as beside:
        made = fmu(model, options.fmi, resources, about)
        beside.write_bytes(made.content)
    kinds = "model exchange and co-simulation" if model.states else "co-simulation"
    return {
        "file": str(options.export),
        "fmi": options.fmi,
        "token": made.token,
        "platforms": made.platforms,
        "inputs": [one.name for one in model.inputs],
        "outputs": [one.name for one in model.outputs],
    }, [
        f"{options.export}: {model.title}, FMI {options.fmi}.0 for {kinds}",
        *(f"  in   {one.name} [{one.unit}]" for one in model.inputs),
        *(f"  out  {one.name} [{one.unit}]" for one in model.outputs),
        "",
        f"communication step size: {'any' if model.period is None else f'{model.period:g} s, the period of the discrete law'}",
        f"binaries: {list_names(made.platforms)}" if made.platforms else "",
        made.missing,
    ]


# the model, the additional files (text by file name), and the documentation
FmuContent = tuple[FmuModel, Mapping[str, str], str]


def _controller(vehicle: Vehicle, options: Namespace) -> FmuContent:
    """Returns the content of an FMU that contains a controller. The FMU includes the files that are exported to a folder."""
    if options.numbers not in ("double", "float"):
        raise InputError(
            f"an FMU cannot contain {options.numbers} numbers, because the variables of an FMU are floating-point numbers; "
            "give --numbers double or float"
        )
    saved, law, texts = _law(vehicle, options, lambda plain: plain if plain.startswith("law_") else f"law_{plain}")
    return law_model(saved, law, sha256(texts[CERTIFICATE])), texts, texts["README.md"]


def _vehicle(vehicle: Vehicle, options: Namespace) -> FmuContent:
    """Returns the content of an FMU that contains the linear vehicle."""
    if options.controller:
        raise InputError("--part vehicle exports the vehicle without a controller; omit --controller, or give --part loop")
    model = linear_model(c_name(vehicle.kind.name), f"{vehicle.kind.name}, linear", vehicle, vehicle_system(vehicle))
    return model, {VEHICLE: vehicle.text}, _about(model)


def _loop(vehicle: Vehicle, options: Namespace) -> FmuContent:
    """Returns the content of an FMU that contains the linear vehicle with a controller."""
    name, saved, own = _one(vehicle, options, vehicle.linear_names, "--part loop exports the loop of one controller")
    controller, kind = Designer(saved, search=False).design(own), vehicle.kind.name
    identifier = f"{c_name(kind)}_{c_name(name)}"
    law = f"controller {own} in continuous time"
    if controller.law.sample_period is not None:
        law = f"the continuous counterpart (Tustin's method) of the discrete controller {own}"
    title = f"{kind}, linear, with {law}"
    model = linear_model(identifier, title, saved, loop_system(saved, controller))
    certificates = {f"{CERTIFICATES}/{name}": text for name, text in certificate_texts(saved, [controller]).items()}
    return model, {VEHICLE: saved.text, **certificates}, _about(model)


def _about(model: FmuModel) -> str:
    """Returns the documentation that an FMU of a linear system contains."""
    named = [("input", one) for one in model.inputs] + [("output", one) for one in model.outputs]
    rows = "".join(f"{what:7} {one.name} [{one.unit}]: {one.meaning}\n" for what, one in named)
    return (
        f"{model.title}\n\n{rows}\nAll signals are measured from static equilibrium, and upwards is positive. Springs, dampers "
        "and\ntyres are linear: curves and stops of the vehicle file are ignored. In co-simulation the inputs are constant "
        f"during a\nstep, and the step is exact for such inputs. {VEHICLE} in resources is the vehicle file.\n"
    )


def _saved_with_law(vehicle: Vehicle, name: str) -> tuple[Vehicle, str]:
    """Returns the vehicle whose file contains the law of a controller, and the name of the controller in this file."""
    entry = vehicle.controllers.get(name)
    if vehicle.with_actuators_of(name) is not vehicle:
        raise InputError(
            f"--export: {name!r} commands force actuators, but [actuators] in the vehicle file describes semi-active dampers; "
            f"export {name!r} from a file without [actuators]"
        )
    if entry is not None and entry.source.request is None:
        return vehicle, name
    show(f"controller {name}")
    controller = Designer(vehicle).design(name)
    show("")
    if not controller.designed:
        return vehicle, name
    check_feedback_alone(controller, "an export")
    folder = Path(vehicle.source).parent
    text = saved_text(folder / VEHICLE, vehicle, [controller])
    return parse_vehicle(text, folder=folder), name + SUFFIX


def _ranges(given: Sequence[str]) -> dict[str, float]:
    """Returns, by signal name, the ranges that are given as `--range SIGNAL=NUMBER`.

    Raises:
        InputError: a range is not written as SIGNAL=NUMBER, its number is too small or too large, or a signal has two ranges.
    """
    ranges = {}
    for text in given:
        name, _, number = text.partition("=")
        if name in ranges:
            raise InputError(f"--range {text}: the range of {name} is given twice; give each range once")
        try:
            ranges[name] = float(number)
        except ValueError:
            ranges[name] = math.nan
        low, high = RANGES
        if not low <= ranges[name] <= high:
            raise InputError(
                f"--range {text} does not have the form SIGNAL=MAGNITUDE; give a magnitude from {low:g} to {high:g}, such "
                "as sprung_velocity=1.5"
            )
    return ranges


def check_folder(folder: Path, options: Namespace) -> int:
    """Checks an exported folder. Prints which files were changed, and whether the claims of the folder's certificate hold.

    Returns:
        Exit code: 0 if no file was changed, every claim holds, and the code computes the outputs of the test vectors; else 1.

    Raises:
        InputError: the folder does not contain an exported controller.
    """
    found = read_folder(folder, driver_of)
    vehicle, law, failures = found.vehicle, found.law, list(found.failures)
    name, prefix = law.controller, law.name
    claims = _claims(vehicle, name)
    ran, same = _back_to_back(folder, prefix) if not failures else ("the code was not run", True)
    failures += [] if same else [ran]
    verdict = f"NOT AS EXPORTED: {'; '.join(failures)}" if failures else "all files are as exported"
    verdict += "" if isinstance(claims, str) else f"; ITS CLAIMS FAIL: {'; '.join(claims)}"
    failures += [] if isinstance(claims, str) else claims
    if options.json:
        print_json({"folder": str(folder), "controller": name, "failures": failures, "back_to_back": ran})
    else:
        claimed = claims if isinstance(claims, str) else "claims of the certificate do not hold"
        say([f"controller {name} as C99 in {law.numbers}", f"  {claimed}", f"  {ran}", "", verdict])
    return 1 if failures else 0


def _claims(vehicle: Vehicle, name: str) -> str | list[str]:
    from synth.command.check import check

    if name not in vehicle.linear_names or vehicle.controllers[name].law is None:
        return "a semi-active law has no certificate"
    (row,) = check(Designer(vehicle), [name])
    return list(row.failures) if row.failures else row.notes[-1]


def _back_to_back(folder: Path, prefix: str) -> tuple[str, bool]:
    """Runs the compiled code with the test vectors. Returns the result of the run as text, and False if an output is wrong.

    Without a compiler, the code cannot be run; the check does not count this as a wrong output.
    """
    try:
        command = compiler()
    except InputError:
        return "the code was not run: there is no C compiler", True
    with tempfile.TemporaryDirectory() as beside:
        program = str(Path(beside) / "back_to_back")
        sources = [str(folder / f"{prefix}.c"), str(folder / "test" / "main.c")]
        built = subprocess.run([*command, *FLAGS.split(), *sources, "-o", program], capture_output=True, text=True, check=False)
        if built.returncode:
            why = "; ".join(built.stderr.splitlines()[:1])
            return f"the compiler {Path(command[0]).name} rejects the code: {why}", False
        ran = subprocess.run([program, str(folder / "test" / "vectors.csv")], capture_output=True, text=True, check=False)
    said = ran.stdout.strip() or "the code crashed"
    return f"back-to-back test: {said}", ran.returncode == 0
