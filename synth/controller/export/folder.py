"""Folder of an exported controller: code, tables, test vectors, certificate and checksums, all from one vehicle file."""

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.files import read_text
from models.laws.linear import MATRICES
from models.laws.python_law import sha256
from models.vehicle.vehicle import Vehicle, parse_vehicle
from synth.analysis.specification import SAMPLED_NORM
from synth.controller.controller import SUFFIX, AnyController
from synth.controller.export.c_law import NUMBERS, ExportedLaw, PythonStep, exported_law, random_inputs
from synth.controller.export.c_source import FLAGS, CSource
from synth.controller.export.compiled import ExportedCode
from synth.controller.report import study_notes

VECTORS, SEED = 1000, 20261126
INVALID = 50  # one in this many test vectors has an input that is not finite
CERTIFICATE, MANIFEST, VEHICLE = "certificate.json", "MANIFEST.sha256", "vehicle.toml"
CERTIFICATES = "certificates"  # name of the folder with the LMI certificates
SAME = 1e-9  # allowed relative difference between two tables from different computers, which may round differently


def certificate(vehicle: Vehicle, driver: AnyController, law: ExportedLaw) -> dict[str, Any]:
    """Returns the content of certificate.json: the law, the tables of its code, and the claims of the vehicle file."""
    claims = vehicle.controllers[driver.name].certificate if driver.name in vehicle.controllers else None
    tables = {name: getattr(law.law, name) for name in MATRICES} | {"anti_windup": law.anti_windup}
    found: dict[str, Any] = {
        "name": law.name,
        "numbers": law.numbers,
        "controller": driver.record,
        "sample_period": law.period,
        "tables": {name: None if table is None else table.tolist() for name, table in tables.items()},
        "claims": None if claims is None else dict(claims),
    }
    if law.ranges is not None:
        found["ranges"] = law.largest
        found["range_sources"] = dict(zip(law.inputs, law.range_sources, strict=True))
    return found


def files(vehicle: Vehicle, driver: AnyController, law: ExportedLaw, certificates: Mapping[str, str]) -> dict[str, str]:
    """Returns the text of every file in the folder, by path in the folder.

    Args:
        vehicle: vehicle whose file is in the folder.
        driver: controller of this vehicle.
        law: law in its exported form.
        certificates: LMI certificates and the programs that check them, by file name; may be empty.
    """
    record = json.dumps(certificate(vehicle, driver, law), indent=1, allow_nan=False) + "\n"
    source = CSource(law, sha256(record))
    texts = {
        **source.files,
        "CMakeLists.txt": source.cmake(),
        "test/main.c": source.main(),
        "test/vectors.csv": vectors(law),
        CERTIFICATE: record,
        VEHICLE: vehicle.text,
        "README.md": _readme(vehicle, driver, law, certificates),
        **{f"{CERTIFICATES}/{name}": text for name, text in certificates.items()},
    }
    texts[MANIFEST] = "".join(f"{sha256(text)}  {name}\n" for name, text in sorted(texts.items()))
    return texts


def vectors(law: ExportedLaw) -> str:
    """Returns the text of test/vectors.csv: random inputs, and the outputs that the code must compute for them."""
    step, rows = PythonStep(law), [", ".join([*law.inputs, *law.outputs])]
    for k, seen in enumerate(random_inputs(law, VECTORS, SEED)):
        if law.fixed is None and k % INVALID == INVALID - 1:
            seen[k // INVALID % len(seen)] = (math.nan, math.inf, -math.inf)[k // INVALID % 3]
        rows.append(",".join(_digits(law, value) for value in [*seen, *step(seen)]))
    return "\n".join(rows) + "\n"


def _digits(law: ExportedLaw, value: Any) -> str:
    if law.fixed is not None:
        return str(value)
    return np.format_float_scientific(NUMBERS[law.numbers](value), unique=True, trim="0")


def _readme(vehicle: Vehicle, driver: AnyController, law: ExportedLaw, certificates: Mapping[str, str]) -> str:
    how, tick = vehicle.implementation, "`"
    source = CSource(law, "")
    about = zip(law.inputs, source.in_units, law.meanings, strict=True)
    rows = "".join(f"| `{name}` | {unit} | {meaning} |\n" for name, unit, meaning in about)
    meaning = "coefficient of the damper" if law.dampers else "force, positive if it pushes body and wheel apart"
    outs = "".join(f"| `{name}` | {unit} | {meaning} |\n" for name, unit in zip(law.outputs, source.out_units, strict=True))
    period = (
        f"every {1e3 * law.period:g} ms"
        if law.period is not None
        else "at any period that is short compared with the vehicle's motion"
    )
    steps = [f"{tick}{name}{tick} in steps of {how.quantisation[name]:g}" for name in law.inputs if how.quantisation.get(name)]
    does = [
        f"It rounds its measurements: {', '.join(steps)}." if steps else "",
        f"It limits every force to ±{law.limit:g} N." if law.limit is not None else "",
        f"It changes every force by at most {law.change:g} N from sample to sample." if law.change is not None else "",
        f"Its outputs are delayed by {law.delay} sample(s)." if law.delay else "",
        "When forces are limited, its states follow the limited forces (anti-windup)." if law.anti_windup is not None else "",
        f"It keeps {law.states} state{'s' * (law.states > 1)}, zero at the start." if law.states else "It keeps no states.",
    ]
    studied = "".join(f"\n{text[0].upper()}{text[1:]}.\n" for text in study_notes(vehicle, driver))
    words = {
        "CONTROLLER": driver.name,
        "LAW": driver.text,
        "STUDIED": studied,
        "PERIOD": period,
        "INPUTS": rows,
        "OUTPUTS": outs,
        "DOES": " ".join(filter(None, does)),
        "CLAIMS": _claims(vehicle, driver, law) + _lmi_certificates(certificates),
        "NUMBERS": law.numbers,
        "FAULTS": _whole_numbers(law) + _faults(law),
        "FLAGS": FLAGS,
        "CERTIFICATE": CERTIFICATE,
    }
    return source.template("README.template", **words)


def _lmi_certificates(certificates: Mapping[str, str]) -> str:
    """Returns the part of README.md about LMI certificates."""
    if not certificates:
        return ""
    file = next(iter(certificates))
    return (
        f"\n\n`{CERTIFICATES}/{file}` contains plant, gain and proofs as exact numbers. Check it without Roadproof:\n\n"
        f"```sh\npython {CERTIFICATES}/check_certificate.py {CERTIFICATES}/{file}\n```\n\n"
        f"`{CERTIFICATES}/check_certificate.html` does the same in a browser."
    )


def _whole_numbers(law: ExportedLaw) -> str:
    """Returns the part of README.md about fixed-point numbers."""
    if law.ranges is None:
        return ""
    each = zip(law.inputs, law.ranges, law.units, law.range_sources, strict=True)
    ranges = "; ".join(f"`{name}` ±{most:g} {unit}, {source}" for name, most, unit, source in each)
    return (
        "- Inputs and outputs count the steps in the tables above: multiply them by a step to get the unit. Arithmetic "
        f"saturates.\n- Ranges of the measurements: {ranges}. Within these ranges the peaks of states and forces are proved.\n"
    )


def _faults(law: ExportedLaw) -> str:
    """Returns the part of README.md about inputs that are not finite."""
    if law.fixed is not None:
        return (
            "- Integers cannot hold NaN or infinity. If a sensor fails, give the last valid integer. Inputs are clipped at\n"
            f"  ±{law.fixed.largest} steps.\n"
        )
    safe = "the nominal coefficient" if law.dampers else "0 N"
    return (
        "- If an input is NaN or infinite, the step uses the last finite value of this input, or 0 before it.\n"
        f"  If a sum overflows, the output is {safe} and the state starts again at 0. No output is ever NaN.\n"
        "- `state.faults` counts the inputs, sums and states of the last step that were not finite. 0 means none. Read it after\n"
        "  each step, and decide how long the vehicle may drive with held inputs.\n"
    )


def _claims(vehicle: Vehicle, driver: AnyController, law: ExportedLaw) -> str:
    if driver.linear is False:
        return "A semi-active law has no certificate. `roadproof drive` simulates it on a road."
    entry = vehicle.controllers.get(driver.name)
    scalars = {name: value for name, value in (entry.certificate or {}).items() if isinstance(value, float)} if entry else {}
    words = "".join(f"- `{name}` = {value:.9g}\n" for name, value in scalars.items())
    left = ["limits", "quantisation", "rounding of its numbers"] + (["the dampers' range"] if law.dampers else [])
    replaced = ", in which a continuous counterpart (Tustin's method) replaces the discrete law"
    counterpart = replaced if driver.law.states and driver.law.sample_period is not None else ""
    sampled = ". `sampled_norm` is the norm of the sampled-data loop" if SAMPLED_NORM in scalars else ""
    return (
        f"`{VEHICLE}` contains the law, the vehicle and the certificate of their closed loop in continuous "
        f"time{counterpart}{sampled}:\n\n{words or '- no certificate was saved with it'}\n\nNot certified: {', '.join(left)}."
    ).replace("\n\n\n", "\n\n")


@dataclass(frozen=True, eq=False)
class ExportedFolder:
    """Exported folder that was read and checked.

    Attributes:
        folder: path of the folder.
        vehicle: vehicle from the vehicle file in the folder.
        law: exported law, which is computed again from this vehicle file.
        failures: one-line text for each file that is missing or changed.
    """

    folder: Path
    vehicle: Vehicle
    law: ExportedLaw
    failures: tuple[str, ...]


def read_folder(folder: Path, driver_of: Callable[[Vehicle, str], AnyController]) -> ExportedFolder:
    """Reads an exported folder, and compares every file in its manifest with its checksum.

    Args:
        folder: path of the folder.
        driver_of: function that takes a vehicle and the name of a controller, and returns the controller.

    Raises:
        InputError: the folder is not an exported controller.
    """
    give, failures = "give a folder of --export", list[str]()
    for line in read_text(folder / MANIFEST, "manifest", give).splitlines():
        digest, _, name = line.partition("  ")
        if not (folder / name).is_file():
            failures.append(f"{name}: is missing, but {MANIFEST} lists it")
        elif hashlib.sha256((folder / name).read_bytes()).hexdigest() != digest:
            failures.append(f"{name}: is changed, as its checksum differs from {MANIFEST}")
    text, record = (read_text(folder / name, "exported controller", give) for name in (VEHICLE, CERTIFICATE))
    try:
        about = json.loads(record)
        vehicle = parse_vehicle(text, folder=folder)
        driver = driver_of(vehicle, about["controller"]["name"])
        sources = about.get("range_sources", {})
        law = exported_law(vehicle, driver, about["numbers"], about["name"], about.get("ranges"), sources)
    except (InputError, AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{folder}: {'; '.join(failures) or error}; export the controller again") from error
    return ExportedFolder(folder, vehicle, law, tuple(failures))


def as_exported(found: ExportedFolder, vehicle: Vehicle, drivers: list[AnyController]) -> list[AnyController]:
    """Returns the controllers of a vehicle. The exported controller uses the code in the folder.

    Args:
        found: exported folder.
        vehicle: vehicle to be simulated.
        drivers: controllers of this vehicle.

    Raises:
        InputError: a file of the folder was changed, or the folder belongs to another controller or vehicle.
    """
    folder, law = found.folder, found.law
    if found.failures:
        raise InputError(f"--as {folder}: {found.failures[0]}; export the controller again")
    fits = [i for i, one in enumerate(drivers) if one.name in (law.controller, law.controller.removesuffix(SUFFIX))]
    if not fits:
        names = ", ".join(one.name for one in drivers)
        raise InputError(
            f"--as {folder} contains code of {law.controller!r}, but --controller gives {names}; give --controller "
            f"{law.controller}"
        )
    driver, theirs, ours = drivers[fits[0]], _facts(found.vehicle), _facts(vehicle)
    other = [f"{name} = {value} instead of {ours.get(name)}" for name, value in theirs.items() if value != ours.get(name)]
    if other:
        raise InputError(
            f"--as {folder} contains code for a different vehicle, with {other[0]}; export controller {driver.name!r} of the "
            "vehicle of this run"
        )
    if not is_law_of(law, vehicle, driver):
        raise InputError(
            f"--as {folder}: the law of controller {driver.name!r} has changed since the export; export the controller again"
        )
    texts = {name: (folder / name).read_text("utf-8") for name in (f"{law.name}.c", f"{law.name}.h", f"{law.name}_data.h")}
    code = ExportedCode(law, texts, sha256((folder / MANIFEST).read_text("utf-8")))
    code.start()  # this call raises an error before the simulations start if the code cannot be built
    return [*drivers[: fits[0]], replace(driver, code=code), *drivers[fits[0] + 1 :]]


def is_law_of(law: ExportedLaw, vehicle: Vehicle, driver: AnyController) -> bool:
    """Returns True if a controller, exported with the name, number format and ranges of `law`, gives the same law again."""
    try:
        other = exported_law(vehicle, driver, law.numbers, law.name, law.largest)
    except InputError:  # this controller cannot be exported with these options
        return False
    same = ("inputs", "outputs", "limit", "change", "delay", "dampers", "semi_active", *["period"] * (law.states > 0))
    tables = [(getattr(law.law, name), getattr(other.law, name)) for name in MATRICES]
    tables += [(law.resolution, other.resolution), (law.anti_windup, other.anti_windup)]
    return all(getattr(law, name) == getattr(other, name) for name in same) and all(_near(*both) for both in tables)


def _near(one: Array | None, other: Array | None) -> bool:
    """Returns True if two tables are equal, apart from rounding that differs between machines."""
    if one is None or other is None:
        return one is other
    return one.shape == other.shape and np.allclose(one, other, rtol=SAME, atol=SAME * np.abs(other).max(initial=0.0))


def _facts(vehicle: Vehicle) -> dict[str, Any]:
    """Returns the properties of a vehicle on which an exported controller depends, by name."""
    facts: dict[str, Any] = {"type": vehicle.kind.name, **vehicle.parameters}
    for section, of in (("implementation", vehicle.implementation), ("limits", vehicle.limits)):
        facts |= {f"[{section}] {name}": value for name, value in vars(of).items() if name != "seed"}
    facts["[actuators]"] = [(one.force, one.nominal, one.low, one.high) for one in vehicle.parts.adjustable]
    return facts | {"[curves]": dict(vehicle.curves)}
