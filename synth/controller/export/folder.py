"""The folder of an exported controller: code, tables, test vectors, certificate and manifest, all from one vehicle file."""

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from models.laws.python_law import sha256
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller, Driver
from synth.controller.export.c_law import NUMBERS, ExportedLaw, PythonStep, random_inputs
from synth.controller.export.c_source import FLAGS, CSource

VECTORS, SEED = 1000, 20261126
TABLES = ("A", "B", "C", "D", "anti_windup")
CERTIFICATE, MANIFEST, VEHICLE = "certificate.json", "MANIFEST.sha256", "vehicle.toml"
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
    }


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
    source = CSource(law, sha256(record))
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
    for seen in random_inputs(law, VECTORS, SEED):
        rows.append(",".join(_digits(law, value) for value in [*seen, *step(seen)]))
    return "\n".join(rows) + "\n"


def _digits(law: ExportedLaw, value: Any) -> str:
    return np.format_float_scientific(NUMBERS[law.numbers](value), unique=True, trim="0")


def _readme(vehicle: Vehicle, driver: Driver, law: ExportedLaw) -> str:
    p, how, tick = law.name, vehicle.implementation, "`"
    about = zip(law.inputs, law.units, law.meanings, strict=True)
    rows = "".join(f"| `{name}` | {unit} | {meaning} |\n" for name, unit, meaning in about)
    meaning = "coefficient of the damper" if law.dampers else "force, positive where it pushes body and wheel apart"
    outs = "".join(f"| `{name}` | {unit} | {meaning} |\n" for name, unit in zip(law.outputs, law.output_units, strict=True))
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
        f"It keeps {law.states} states, zero at the start." if law.states else "It keeps no states.",
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
- Compile with `{FLAGS}`. A compiler that fuses multiplication and addition rounds otherwise, and gives other last bits.
- `test/main.c` holds the code against `test/vectors.csv` back to back: every output must have the bits of the file.

```sh
cc {FLAGS} {p}.c test/main.c -o back_to_back && ./back_to_back test/vectors.csv
```

- `{p}_certificate` is the SHA-256 of `{CERTIFICATE}`. `python -m synth --check` with this folder says if anything was changed.
"""


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
