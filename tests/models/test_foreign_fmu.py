"""FMUs of other tools as controllers: an FMU drives as its law does, and each mistake or failure is one line."""

import gc
import re
import shutil
import subprocess
import zipfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from models.laws.python_runtime import OwnLaw
from models.roads.road import Bump
from models.vehicle import foreign_fmu
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.runs.by_name import run
from sim.runs.report import claims
from synth.__main__ import main
from synth.controller.export.c_law import exported_law
from tests.commands.test_export import BUILT, LAW
from tests.support.commands import attacks, refused

WITHOUT = find_spec("fmpy") is None or shutil.which("cc") is None
THEIRS = '\n[controllers.theirs]\nmeasured = ["suspension_deflection", "sprung_velocity"]\nfmu = "their.fmu"\n'
TEXT = read_vehicle("quarter_car").text + LAW + BUILT + "\n[limits]\nactuator_force = 500.0\n"
DELAYED = TEXT.replace(BUILT, f"{BUILT}delay = 1\n")
# One library with as many faults as GUIDs.
SOURCE = """
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
typedef struct { void (*log)(void *, const char *, int, const char *, const char *, ...); } calls;
static const char *mode; static const calls *of;
void *fmi2Instantiate(const char *n, int k, const char *guid, const char *r, const calls *c, int v, int l)
{ of = c; mode = strdup(guid); return strcmp(guid, "none") ? (void *)mode : NULL; }
int fmi2GetReal(void *c, const unsigned *r, size_t n, double *v) { v[0] = strcmp(mode, "nan") ? 1.0 : NAN; return 0; }
int fmi2DoStep(void *c, double t, double h, int s)
{ if (!strcmp(mode, "crash")) abort(); if (strcmp(mode, "discard")) return 0; of->log(0, "x", 2, "x", "too long"); return 2; }
int fmi2Terminate(void *c) { FILE *file = fopen("terminated", "w"); return fclose(file); }
"""
DESCRIPTION = """<?xml version="1.0"?>
<fmiModelDescription fmiVersion="2.0" modelName="x" guid="GUID"><CoSimulation modelIdentifier="their"/>
<UnitDefinitions><Unit name="m"/><Unit name="m/s"/><Unit name="N"/></UnitDefinitions><ModelVariables>
<ScalarVariable name="sprung_velocity" valueReference="0" causality="input"><Real unit="m/s" start="0"/></ScalarVariable>
<ScalarVariable name="suspension_deflection" valueReference="1" causality="input"><Real unit="m" start="0"/></ScalarVariable>
<ScalarVariable name="control_force" valueReference="2" causality="output"><Real unit="N"/></ScalarVariable>
<ScalarVariable name="on" valueReference="3" causality="input" variability="discrete"><Boolean start="true"/></ScalarVariable>
</ModelVariables><ModelStructure><Outputs><Unknown index="3"/></Outputs></ModelStructure></fmiModelDescription>"""


@pytest.fixture(scope="module")
def library(tmp_path_factory) -> bytes:
    """Returns the library with faults, and with the functions that FMPy expects besides."""
    fmi2 = pytest.importorskip("fmpy.fmi2")
    folder = tmp_path_factory.mktemp("faults")
    others = {name for name in dir(fmi2.FMU2Slave) if name.startswith("fmi2")} - {*re.findall(r"fmi2\w+", SOURCE)}
    (folder / "x.c").write_text(SOURCE + "".join(f"int {name}(void) {{ return 0; }}\n" for name in sorted(others)))
    subprocess.run(["cc", "-shared", "-fPIC", "-w", "x.c", "-o", "x.so"], cwd=folder, check=True)
    return (folder / "x.so").read_bytes()


def needs_fmpy(test: Callable[..., None]) -> Callable[..., None]:
    """Marks a test that runs an FMU."""
    return pytest.mark.extra(pytest.mark.skipif(WITHOUT, reason="needs the extra [fmi] and a C compiler")(test))


def called(folder: Path) -> list[float]:
    """Returns the forces of the first call of the FMU in a folder, as a run makes it."""
    driver = parse_vehicle(TEXT + THEIRS, folder=folder).controllers["theirs"].driver()
    law = OwnLaw(driver, 1)  # pyright: ignore[reportArgumentType]
    return law(np.zeros(len(driver.measured)), 0.0, 0.005, None, {}).tolist()


def packed(file: Path, library: bytes, guid: str = "good", old: str = "GUID", new: str = "good") -> None:
    """Writes an FMU of the library, with one text replaced in its description and in the names of its files."""
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("modelDescription.xml", DESCRIPTION.replace("GUID", guid).replace(old, new))
        archive.writestr("binaries/linux64/their.so".replace(old, new), library)


@needs_fmpy
@pytest.mark.parametrize("version", [*attacks([2]), 3])  # below, the library is of version 2
def test_it_drives_as_its_law_does(version, tmp_path):
    """A law that was exported as an FMU drives MuJoCo as the law itself, to rounding. Its delay acts once."""
    (tmp_path / "car.toml").write_text(DELAYED)
    export = ["--controller", "law", "--export", str(tmp_path / "their.FMU"), "--fmi", str(version)]
    assert main(["--vehicle", str(tmp_path / "car.toml"), *export]) == 0
    (tmp_path / "both.toml").write_text(DELAYED + THEIRS.replace(".fmu", ".FMU"))
    vehicle = read_vehicle(str(tmp_path / "both.toml"))
    ours, theirs = run(vehicle, ["law", "theirs"], Bump(height=0.06), duration=0.4)
    assert abs(ours.physics["control_force"]).max() == 500.0
    for name in ("sprung_acceleration", "tyre_deflection", "control_force"):
        scale = ours.physics.scale(name)
        assert abs(ours.physics[name] - theirs.physics[name]).max() < 1e-9 * scale  # rounding of another order of summation
    assert claims(theirs.controller) == "linear analysis does not apply (an FMU)"
    later = parse_vehicle(vehicle.text.replace("delay = 1", "delay = 2.4"), folder=tmp_path)  # 1.4 samples are around the FMU
    ours, theirs = run(later, ["law", "theirs"], Bump(height=0.06), duration=0.2)
    assert abs(ours.physics["control_force"] - theirs.physics["control_force"]).max() < 1e-9 * 500


@needs_fmpy
@pytest.mark.parametrize(
    ("guid", "said"),
    [
        ("discard", r"^controller 'theirs', FMU their.fmu: fmi2DoStep failed with status 2 \(discard\): too long$"),
        ("crash", r"ends its process \(signal SIGABRT\) at 0 s"),
        ("nan", r"the returned force is not finite"),
        ("none", r"Failed to instantiate model"),
    ],
)
def test_a_fault_is_one_line(guid, said, library, tmp_path):
    """A step that is refused, crashes or gives no number, and a start that fails, are one line."""
    packed(tmp_path / "their.fmu", library, guid)
    with refused("controller 'theirs'", "their.fmu", match=said):
        run(parse_vehicle(TEXT + THEIRS, folder=tmp_path), ["theirs"], Bump(), duration=0.1)


@needs_fmpy
def test_it_is_terminated(library, tmp_path, monkeypatch):
    """An FMU without a fault gives its force; at the end of its run it is terminated, and its unpacked files are removed."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    packed(tmp_path / "their.fmu", library)
    assert called(tmp_path) == [1.0]
    gc.collect()
    assert {path.name for path in tmp_path.iterdir()} == {"their.fmu", "terminated"}


@needs_fmpy
@pytest.mark.parametrize(
    ("old", "new", "names"),
    [
        ('"sprung_velocity"', '"In1"', 'inputs = { In1 = "sprung_velocity" }'),
        ('"control_force"', '"Out1"', 'outputs = { Out1 = "control_force" }'),
    ],
)
def test_names_of_other_tools(old, new, names, library, tmp_path, monkeypatch):
    """Variables of other names are the signals that the vehicle file gives; without these, and with wrong ones, it is refused."""
    monkeypatch.chdir(tmp_path)  # its FMU writes a file at its end
    packed(tmp_path / "their.fmu", library, "good", old, new)
    driver = parse_vehicle(f"{TEXT}{THEIRS}{names}\n", folder=tmp_path).controllers["theirs"].driver()
    assert OwnLaw(driver, 1)(np.zeros(2), 0.0, 0.005, None, {}).tolist() == [1.0]  # pyright: ignore[reportArgumentType]
    assert names.partition(" ")[0] in driver.record
    for wrong, said in (("", names.partition(" ")[0]), (re.sub("(In|Out)1", "In2", names), "the FMU has no variable 'In2'")):
        with refused("controller 'theirs'", said):
            run(parse_vehicle(f"{TEXT}{THEIRS}{wrong}\n", folder=tmp_path), ["theirs"], Bump(), duration=0.1)


@needs_fmpy
@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("2.0", "1.0", "Failed to validate modelDescription.xml"),
        ("CoSimulation", "ModelExchange", "the FMU uses FMI 2.0, no co-simulation; give an FMU of FMI 2 or 3"),
        ('"m/s"', '"mm/s"', "sprung_velocity of the FMU has the unit 'mm/s' instead of m/s; export the variable in m/s"),
        ('"N"', '"kN"', "control_force of the FMU has the unit 'kN' instead of N; export the variable in N"),
        ('"sprung_velocity"', '"speed"', "the inputs speed, suspension_deflection, but the controller measures"),
        (
            '"control_force"',
            '"torque"',
            "the FMU has the outputs torque, but none of these names is the name of a force; rename the outputs to control_force",
        ),
        ("linux64", "other64", "the FMU has binaries for other64, but not for linux64; export the FMU for linux64"),
        ("</fmiModelDescription>", "", "give an FMU of FMI 2 or 3 for co-simulation"),
        ("", "", "File is not a zip file; give an FMU of FMI 2 or 3 for co-simulation"),
    ],
)
def test_what_does_not_fit_is_one_line(old, new, said, library, tmp_path):
    """Other files, versions, kinds, platforms, units and names, and a damaged description, are refused in one line each."""
    if old:
        packed(tmp_path / "their.fmu", library, "good", old, new)
    else:
        (tmp_path / "their.fmu").write_bytes(b"PK no zip")
    with refused("controller 'theirs'", said):
        called(tmp_path)


def test_without_fmpy(tmp_path, monkeypatch):
    """Without FMPy an FMU is refused in one line that says how to install it."""
    (tmp_path / "their.fmu").write_bytes(b"")
    monkeypatch.setattr(foreign_fmu, "find_spec", lambda _: None)
    with refused("controller 'theirs', FMU their.fmu: an FMU needs FMPy; run pip install 'roadproof[fmi]'"):
        called(tmp_path)


def test_what_is_not_done_with_an_fmu(tmp_path):
    """An FMU is not analysed or exported, and keeps its path."""
    (tmp_path / "their.fmu").write_bytes(b"")
    vehicle = parse_vehicle(TEXT + THEIRS, folder=tmp_path)
    driver = vehicle.controllers["theirs"].driver()
    assert f'fmu = "{tmp_path.name}/their.fmu"' in vehicle.text_for(tmp_path.parent / "elsewhere.toml")
    with refused("controller 'theirs' is an FMU, their.fmu, which has no linear loop"):
        vehicle.linear_entry("theirs")
    with refused("controller 'theirs' is an FMU, which is already code; export a linear or semi-active law"):
        exported_law(vehicle, driver, "double", "theirs")  # pyright: ignore[reportArgumentType]
    (tmp_path / "their.fmu").unlink()
    with refused("there is no such file"):
        called(tmp_path)
