"""The folder of an exported controller: code, tables, test vectors, certificate and manifest, all from one vehicle file."""

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from models.common.errors import InputError
from models.common.files import read_text
from models.laws.python_law import sha256
from models.vehicle.vehicle import Vehicle, parse_vehicle
from synth.controller.controller import SUFFIX, Controller, Driver
from synth.controller.export.c_law import GIVEN, NUMBERS, ExportedLaw, PythonStep, exported_law, proved_ranges, random_inputs
from synth.controller.export.c_source import FLAGS
from synth.controller.export.compiled import ExportedCode, driven_by
from synth.controller.export.fixed_source import source_of

VECTORS, SEED = 1000, 20261126
INVALID = 50  # test vectors from one with an input that is not finite to the next
TABLES = ("A", "B", "C", "D", "anti_windup")
CERTIFICATE, MANIFEST, VEHICLE = "certificate.json", "MANIFEST.sha256", "vehicle.toml"
MOST = 10_000_000  # bytes of a file of the folder
NEAR = 1e-6  # relative: a peak that is proved anew is as near
SAME = 1e-9  # relative: tables that another machine computes are as near


def certificate(vehicle: Vehicle, driver: Driver, law: ExportedLaw) -> dict[str, Any]:
    """Returns what certificate.json holds: the law, its tables as they are run, and the claims of the vehicle file."""
    claims = vehicle.controllers[driver.name].certificate if driver.name in vehicle.controllers else None
    tables = {name: getattr(law, name) for name in TABLES}
    return {
        "name": law.name,
        "numbers": law.numbers,
        "controller": driver.record,
        "sample_period": law.period,
        "tables": {name: None if table is None else table.tolist() for name, table in tables.items()},
        "claims": None if claims is None else dict(claims),
    } | _record_of_ranges(law)


def _record_of_ranges(law: ExportedLaw) -> dict[str, Any]:
    if law.ranges is None:
        return {}
    ranges = dict(zip(law.inputs, law.ranges.tolist(), strict=True))
    return {"ranges": ranges, "range_sources": dict(zip(law.inputs, law.range_sources, strict=True))}


def with_tables(law: ExportedLaw, tables: Mapping[str, Any]) -> ExportedLaw | None:
    """Returns a law with the tables of a certificate, or None if they are not its own."""
    given = {}
    for name in TABLES:
        own, table = getattr(law, name), tables.get(name)
        if (own is None) != (table is None):
            return None
        if own is not None:
            try:
                matrix = np.array(table, dtype=float).reshape(own.shape)
            except (TypeError, ValueError):
                return None
            if not np.allclose(matrix, own, rtol=SAME, atol=SAME * np.abs(own).max(initial=0.0)):
                return None
            given[name] = matrix
    return replace(law, **given)


def files(vehicle: Vehicle, driver: Driver, law: ExportedLaw) -> dict[str, str]:
    """Returns the text of every file, by its path in the folder."""
    record = json.dumps(certificate(vehicle, driver, law), indent=1, allow_nan=False) + "\n"
    source = source_of(law, sha256(record))
    texts = {
        f"{law.name}.h": source.header(),
        f"{law.name}.c": source.source(),
        f"{law.name}_data.h": source.data(),
        "CMakeLists.txt": source.cmake(),
        "test/main.c": source.main(),
        "test/vectors.csv": vectors(law),
        CERTIFICATE: record,
        VEHICLE: vehicle.text,
        "README.md": _readme(vehicle, driver, law),
    }
    texts[MANIFEST] = "".join(f"{sha256(text)}  {name}\n" for name, text in sorted(texts.items()))
    return texts


def vectors(law: ExportedLaw) -> str:
    """Returns test/vectors.csv: inputs of random samples, and the outputs that the code must give for them."""
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


def _readme(vehicle: Vehicle, driver: Driver, law: ExportedLaw) -> str:
    p, how, tick = law.name, vehicle.implementation, "`"
    source = source_of(law, "")
    about = zip(law.inputs, source.in_units, law.meanings, strict=True)
    rows = "".join(f"| `{name}` | {unit} | {meaning} |\n" for name, unit, meaning in about)
    meaning = "coefficient of the damper" if law.dampers else "force, positive where it pushes body and wheel apart"
    outs = "".join(f"| `{name}` | {unit} | {meaning} |\n" for name, unit in zip(law.outputs, source.out_units, strict=True))
    period = (
        f"every {1e3 * law.period:g} ms" if law.period is not None else "at any period that is short against the vehicle's motion"
    )
    steps = [f"{tick}{name}{tick} in steps of {how.quantisation[name]:g}" for name in law.inputs if how.quantisation.get(name)]
    does = [
        f"It rounds its readings: {', '.join(steps)}." if steps else "",
        f"It limits every force to ±{law.limit:g} N." if law.limit is not None else "",
        f"What it computes goes out {law.delay} sample(s) later." if law.delay else "",
        "Its states follow the forces that are given where these are limited (anti-windup)."
        if law.anti_windup is not None
        else "",
        f"It keeps {law.states} state{'s' * (law.states > 1)}, zero at the start." if law.states else "It keeps no states.",
    ]
    return f"""# Controller {driver.name} as C99

{driver.text}

```c
{p}_state state;
{p}_in in;
{p}_out out;

{p}_init(&state);               /* once */
{p}_step(&state, &in, &out);    /* {period} */
```

| input | unit | meaning |
|---|---|---|
{rows}
| output | unit | meaning |
|---|---|---|
{outs}
All readings are measured from static equilibrium, upwards positive. {" ".join(filter(None, does))}

## What is certified

{_claims(vehicle, driver, law)}

## The code

- Numbers are `{law.numbers}`. Sums go from the first column to the last. There is no heap, no recursion and no library.
{_whole_numbers(law)}{_faults(law)}- Compile with `{FLAGS}`.
- A compiler that fuses multiplication and addition of floating-point numbers rounds otherwise, and gives other last bits.
- `test/main.c` holds the code against `test/vectors.csv` back to back: every output must have the bits of the file.

```sh
cc {FLAGS} {p}.c test/main.c -o back_to_back && ./back_to_back test/vectors.csv
```

- `{p}_certificate` is the SHA-256 of `{CERTIFICATE}`. `python -m synth --check` with this folder says if anything was changed.
"""


def _whole_numbers(law: ExportedLaw) -> str:
    """Returns what README.md says of fixed point."""
    if law.ranges is None:
        return ""
    each = zip(law.inputs, law.ranges, law.units, law.range_sources, strict=True)
    ranges = "; ".join(f"`{name}` ±{most:g} {unit}, {source}" for name, most, unit, source in each)
    return (
        "- Inputs and outputs are whole numbers of the steps above: multiply by a step to have the unit. Arithmetic saturates.\n"
        f"- The ranges of the readings: {ranges}. Within them the peaks of states and forces are proved by the law.\n"
    )


def _faults(law: ExportedLaw) -> str:
    """Returns the lines of README.md about inputs that are not finite numbers."""
    if law.fixed is not None:
        return (
            "- Integers cannot hold NaN or infinity. If a sensor fails, give the last valid integer. Inputs are clipped at\n"
            f"  ±{law.fixed.largest} steps.\n"
        )
    safe = "the nominal coefficient" if law.dampers else "0 N"
    return (
        "- If an input is NaN or infinite, the step uses the last finite value of this input. Before the first one it uses 0.\n"
        f"  If a sum overflows, the output is {safe} and the state starts again at 0. No output is ever NaN.\n"
        "- `state.faults` counts the inputs, sums and states of the last step that were not finite. 0 means none. Read it after\n"
        "  each step, and decide how long to drive on held inputs.\n"
    )


def _claims(vehicle: Vehicle, driver: Driver, law: ExportedLaw) -> str:
    if not isinstance(driver, Controller):
        return "No linear claim is made of a semi-active law. `python -m sim.drive` says what it does on a road."
    entry = vehicle.controllers.get(driver.name)
    scalars = {name: value for name, value in (entry.certificate or {}).items() if isinstance(value, float)} if entry else {}
    words = "".join(f"- `{name}` = {value:.9g}\n" for name, value in scalars.items())
    left = ["limits", "quantisation", "rounding of its numbers"] + (["the dampers' range"] if law.dampers else [])
    return (
        f"`{VEHICLE}` holds the law, the vehicle and the certificate of their closed loop in continuous time:\n\n"
        f"{words or '- no certificate was saved with it'}\n\n"
        f"Not certified: {', '.join(left)}."
    ).replace("\n\n\n", "\n\n")


@dataclass(frozen=True, eq=False)
class ExportedFolder:
    """An exported folder as it is found.

    Attributes:
        folder: its path.
        vehicle, driver: of its vehicle file.
        law: the law, with the tables of the folder if these are the law's.
        failures: the files that are not as they were exported, in words.
    """

    folder: Path
    vehicle: Vehicle
    driver: Driver
    law: ExportedLaw
    failures: tuple[str, ...]


def read_folder(folder: Path, driver_of: Callable[[Vehicle, str], Driver]) -> ExportedFolder:
    """Returns an exported folder, with every file compared with what is exported now.

    Args:
        driver_of: returns a controller of a vehicle.

    Raises:
        InputError: the folder is no exported controller.
    """
    try:
        about = json.loads(read_text(folder / CERTIFICATE, "certificate", "name a folder of --export"))
        name, numbers, prefix = about["controller"]["name"], about["numbers"], about["name"]
        tables, ranges, sources = about["tables"], about.get("ranges"), dict(about.get("range_sources", {}))
    except InputError:
        raise
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{folder / CERTIFICATE}: is not as --export writes it ({error}); export the controller again"
        ) from error
    text = read_text(folder / VEHICLE, "vehicle file", "name a folder of --export")
    try:
        vehicle = parse_vehicle(text, folder=folder)
        driver = driver_of(vehicle, name)
        law = exported_law(vehicle, driver, numbers, prefix, ranges, sources)
    except (InputError, KeyError, TypeError) as error:
        raise InputError(
            f"{folder / VEHICLE}: {error}; it is changed, or {CERTIFICATE} is: export the controller again"
        ) from error
    failures = list[str]()
    exact = with_tables(law, tables)
    if exact is None:
        failures.append(f"{CERTIFICATE}: its tables are not those of the law in {VEHICLE}")
    failures += _unproved(driver, law)
    wanted = files(vehicle, driver, exact or law)
    there = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    for path in sorted({*wanted, *there}):
        if path not in there:
            failures.append(f"{path}: is missing")
        elif path not in wanted:
            failures.append(f"{path}: was not exported")
        elif (folder / path).read_bytes() != wanted[path].encode():
            failures.append(f"{path}: is changed")
    failures += [one for one in _unlike_manifest(folder, there) if one not in failures]
    return ExportedFolder(folder, vehicle, driver, exact or law, tuple(failures))


def _unproved(driver: Driver, law: ExportedLaw) -> list[str]:
    """Returns the ranges that are said to be from a proved peak, and are not."""
    if law.ranges is None:
        return []
    proved, wrong = proved_ranges(driver), list[str]()
    for name, most, source in zip(law.inputs, law.ranges.tolist(), law.range_sources, strict=True):
        range_, words = proved.get(name, (math.inf, ""))
        if source != GIVEN and (source != words or abs(most - range_) > NEAR * range_):
            wrong.append(f"{CERTIFICATE}: the range of {name} is from no peak that is proved")
    return wrong


def _unlike_manifest(folder: Path, there: set[str]) -> list[str]:
    """Returns the files whose checksum is not the manifest's."""
    if MANIFEST not in there:
        return []
    lines = [line.partition("  ") for line in (folder / MANIFEST).read_text("utf-8", errors="replace").splitlines()]
    sums = {name: digest for digest, _, name in lines}
    found = {path: hashlib.sha256((folder / path).read_bytes()).hexdigest() for path in there & set(sums)}
    return [f"{path}: is changed" for path, digest in sorted(found.items()) if digest != sums[path]]


def as_exported(found: ExportedFolder, vehicle: Vehicle, drivers: list[Driver]) -> list[Driver]:
    """Returns controllers of a vehicle, of which the code of a folder drives the one that was exported.

    Raises:
        InputError: a file of the folder is changed, or it is of another controller or vehicle.
    """
    folder, law = found.folder, found.law
    if found.failures:
        raise InputError(f"--as {folder}: {found.failures[0]}; export the controller again")
    fits = [i for i, one in enumerate(drivers) if one.name in (law.controller, law.controller.removesuffix(SUFFIX))]
    if not fits:
        names = ", ".join(one.name for one in drivers)
        raise InputError(f"--as {folder}: is of controller {law.controller!r}, and --controller gives {names}; name that one")
    driver = drivers[fits[0]]
    if why := _another(found.vehicle, vehicle):
        raise InputError(f"--as {folder}: is of a vehicle with {why}; export controller {driver.name!r} of this one")
    if not is_law_of(law, vehicle, driver):
        raise InputError(f"--as {folder}: is of another law than that of controller {driver.name!r} now; export it again")
    texts = {name: (folder / name).read_text("utf-8") for name in (f"{law.name}.c", f"{law.name}.h", f"{law.name}_data.h")}
    code = ExportedCode(law, texts, sha256((folder / MANIFEST).read_text("utf-8")))
    code.library  # noqa: B018 - what cannot be built is said before the long work
    return [*drivers[: fits[0]], driven_by(driver, code), *drivers[fits[0] + 1 :]]


def is_law_of(law: ExportedLaw, vehicle: Vehicle, driver: Driver) -> bool:
    """Returns True if a controller of a vehicle, exported with the name, numbers and ranges of a law, is that law."""
    ranges = None if law.ranges is None else dict(zip(law.inputs, law.ranges.tolist(), strict=True))
    try:
        return not _differs(law, exported_law(vehicle, driver, law.numbers, law.name, ranges))
    except InputError:  # it cannot be exported so
        return False


def _differs(law: ExportedLaw, other: ExportedLaw) -> bool:
    """Returns True if two laws compute something else, but for the rounding of their tables."""
    same = ("inputs", "outputs", "limit", "delay", "dampers", "semi_active", *["period"] * (law.states > 0))
    if any(getattr(law, name) != getattr(other, name) for name in same) or not np.array_equal(law.resolution, other.resolution):
        return True
    return with_tables(other, {name: getattr(law, name) for name in TABLES}) is None


def _another(exported: Vehicle, vehicle: Vehicle) -> str:
    """Returns the first thing in which the vehicle of a folder is another one, in words; empty if it is the same."""
    if exported.kind.name != vehicle.kind.name:
        return f"another kind, {exported.kind.name}"
    for name, value in exported.parameters.items():
        if value != vehicle.parameters.get(name):
            return f"{name} = {value:g}, and not {vehicle.parameters.get(name, float('nan')):g}"
    for section, (theirs, ours) in {
        "implementation": (vars(exported.implementation), vars(vehicle.implementation)),
        "limits": (vars(exported.limits), vars(vehicle.limits)),
    }.items():
        for name, value in theirs.items():
            if name != "seed" and value != ours[name]:
                return f"[{section}] {name} = {value}, and not {ours[name]}"
    ranges = [[(one.force, one.nominal, one.low, one.high) for one in of.adjustable] for of in (exported, vehicle)]
    if ranges[0] != ranges[1]:
        return "other [actuators]"
    if dict(exported.curves) != dict(vehicle.curves):
        return "other [curves]"
    return ""
