"""Somebody else's FMU as a controller: it drives as its law does, and whatever is wrong with it is said in one line."""

import shutil
import subprocess
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from models.common.errors import InputError
from models.laws.python_runtime import OwnLaw
from models.roads.iso8608 import Iso8608
from models.roads.road import Bump
from models.vehicle import foreign_fmu
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.runs.by_name import run
from sim.runs.report import claims
from sim.studies.ride.run_metrics import measure_run
from synth.__main__ import main
from synth.controller.export.c_law import exported_law
from tests.commands import refused
from tests.test_export import BUILT, LAW

COMPILER = shutil.which("cc")
pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C compiler is here")
THEIRS = '\n[controllers.theirs]\nmeasured = ["suspension_deflection", "sprung_velocity"]\nfmu = "their.fmu"\n'
TEXT = read_vehicle("quarter_car").text + LAW + BUILT + "\n[limits]\nactuator_force = 500.0\n"
DELAYED = TEXT.replace(BUILT, f"{BUILT}delay = 1\n")
CORNER = """type = "quarter_car"
[parameters]
sprung_mass = 380.0
unsprung_mass = 42.0
suspension_stiffness = 22000.0
suspension_damping = 1500.0
tyre_stiffness = 190000.0
[performance]
sprung_acceleration = 1.0
suspension_deflection = 0.1
tyre_deflection = 0.2
control_force = 1e-4
[limits]
suspension_stroke = { bump = 0.07, rebound = 0.08 }
stop_stiffness = [1e5, 0, 4e8]
actuator_force = 3000.0
actuator_bandwidth = 50.3
[implementation]
sample_period = 0.005
delay = 1
noise = { suspension_deflection = 0.0005, sprung_acceleration = 0.05 }
[controllers.full]
measured = ["suspension_deflection", "sprung_acceleration"]
order = "full"
noise = true
sampled = true
lag = true
"""
# One library with as many faults as GUIDs.
SOURCE = """
#include <math.h>
#include <stdlib.h>
#include <string.h>
typedef struct { void (*log)(void *, const char *, int, const char *, const char *, ...); } calls;
static const char *mode; static const calls *of;
void *fmi2Instantiate(const char *n, int k, const char *guid, const char *r, const calls *c, int v, int l)
{ of = c; mode = strdup(guid); return strcmp(guid, "none") ? (void *)mode : NULL; }
int fmi2SetupExperiment(void *c, int a, double b, double d, int e, double f) { return 0; }
int fmi2EnterInitializationMode(void *c) { return 0; }
int fmi2ExitInitializationMode(void *c) { return 0; }
int fmi2SetReal(void *c, const unsigned *r, size_t n, const double *v) { return 0; }
int fmi2GetReal(void *c, const unsigned *r, size_t n, double *v) { v[0] = strcmp(mode, "nan") ? 1.0 : NAN; return 0; }
int fmi2DoStep(void *c, double t, double h, int s)
{
    if (!strcmp(mode, "discard")) { of->log(NULL, "x", 2, "logStatusDiscard", "too long a step"); return 2; }
    if (!strcmp(mode, "never")) for (;;) { }
    if (!strcmp(mode, "crash")) abort();
    if (!strcmp(mode, "exit")) exit(0);
    if (!strcmp(mode, "odd")) return 77;
    return 0;
}
"""
DESCRIPTION = """<?xml version="1.0"?>
<fmiModelDescription fmiVersion="2.0" modelName="x" guid="GUID"><CoSimulation modelIdentifier="their"/><ModelVariables>
<ScalarVariable name="sprung_velocity" valueReference="0" causality="input"><Real unit="m/s" start="0"/></ScalarVariable>
<ScalarVariable name="suspension_deflection" valueReference="1" causality="input"><Real unit="m" start="0"/></ScalarVariable>
<ScalarVariable name="control_force" valueReference="2" causality="output"><Real unit="N"/></ScalarVariable>
</ModelVariables></fmiModelDescription>"""


@pytest.fixture(scope="module")
def library(tmp_path_factory) -> bytes:
    """Returns the library with faults."""
    folder = tmp_path_factory.mktemp("faults")
    (folder / "x.c").write_text(SOURCE)
    subprocess.run([str(COMPILER), "-shared", "-fPIC", "-w", "x.c", "-o", "x.so"], cwd=folder, check=True)
    return (folder / "x.so").read_bytes()


def called(folder: Path, measured: str = '["suspension_deflection", "sprung_velocity"]') -> list[float]:
    """Returns the forces of the first call of the FMU in a folder, as a run makes it."""
    text = TEXT + THEIRS.replace('["suspension_deflection", "sprung_velocity"]', measured)
    driver = parse_vehicle(text, folder=folder).controllers["theirs"].driver()
    law = OwnLaw(driver, 1)  # pyright: ignore[reportArgumentType]
    return law(np.zeros(len(driver.measured)), 0.0, 0.005, None, {}).tolist()


def packed(file: Path, library: bytes, guid: str = "good", change: Callable[[str], str] = str, **more: bytes) -> None:
    """Writes an FMU of the library."""
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("modelDescription.xml", change(DESCRIPTION.replace("GUID", guid)))
        archive.writestr(more.pop("place", b"binaries/linux64/their.so").decode(), library)


def test_it_drives_as_its_law_does(tmp_path):
    """Our law comes back as an FMU, in a process of its own, and drives MuJoCo as the law does, to rounding: late once."""
    (tmp_path / "car.toml").write_text(DELAYED)
    assert main(["--vehicle", str(tmp_path / "car.toml"), "--controller", "law", "--export", str(tmp_path / "their.FMU")]) == 0
    (tmp_path / "both.toml").write_text(DELAYED + THEIRS.replace(".fmu", ".FMU"))
    vehicle = read_vehicle(str(tmp_path / "both.toml"))
    ours, theirs = run(vehicle, ["law", "theirs"], Bump(height=0.06), duration=1.0)
    assert abs(ours.physics["control_force"]).max() == 500.0
    for name in ("sprung_acceleration", "tyre_deflection", "control_force"):
        scale = ours.physics.scale(name)
        assert abs(ours.physics[name] - theirs.physics[name]).max() < 1e-9 * scale  # rounding of another order of summation
    text = vehicle.text_for(tmp_path.parent / "elsewhere.toml")
    assert f'fmu = "{tmp_path.name}/their.FMU"' in text
    assert theirs.controller.record["fmu"] == "their.FMU"
    with refused("controller 'theirs' is an FMU, their.FMU, which has no linear loop to analyse"):
        vehicle.linear_entry("theirs")
    with refused("controller 'theirs' is an FMU, and its own code; export a linear or semi-active one"):
        exported_law(vehicle, vehicle.controllers["theirs"].driver(), "double", "theirs")
    later = parse_vehicle(vehicle.text.replace("delay = 1", "delay = 2.4"), folder=tmp_path)  # 1.4 samples are around the FMU
    ours, theirs = run(later, ["law", "theirs"], Bump(height=0.06), duration=0.5)
    assert abs(ours.physics["control_force"] - theirs.physics["control_force"]).max() < 1e-9 * 500
    assert claims(theirs.controller) == "no linear claim: an FMU"


@pytest.mark.attack
def test_the_fmu_of_a_design_rides_as_the_design(tmp_path, capsys):
    """An FMU that was designed, exported and driven in a file with `delay = 1` has the ride of the design itself."""
    (tmp_path / "corner.toml").write_text(CORNER)
    assert main(["--vehicle", str(tmp_path / "corner.toml"), "--controller", "full", "--export", str(tmp_path / "full.fmu")]) == 0
    (tmp_path / "both.toml").write_text(CORNER + THEIRS.replace("velocity", "acceleration").replace("their.fmu", "full.fmu"))
    both = run(read_vehicle(tmp_path / "both.toml"), ["full", "theirs"], Iso8608("C", speed=25.0), duration=4.0)
    ours, theirs = (measure_run(one, 2000).metrics["sprung_acceleration_weighted"].mujoco for one in both)
    assert theirs == pytest.approx(ours, rel=1e-9)  # rounding of another order of summation


@pytest.mark.parametrize(
    ("guid", "said"),
    [
        (
            "discard",
            r"^controller 'theirs', FMU their.fmu: the step failed: fmi2DoStep returned fmi2Discard \(too long a step\)$",
        ),
        ("never", r"the step took longer than 0.5 s"),
        ("crash", r"the step ended the process of the FMU \(signal 6\)"),
        ("exit", r"the step ended the process of the FMU \(exit code 0\)"),
        ("odd", r"fmi2DoStep returned 77"),
        ("nan", r"its force is not finite"),
        ("none", r"the start failed: fmi2Instantiate returned no instance"),
    ],
)
def test_a_fault_is_one_line(guid, said, library, tmp_path, monkeypatch):
    """A step that is discarded, never ends, crashes, ends the process, or gives no number is one line; the process is gone."""
    monkeypatch.setattr(foreign_fmu, "LONGEST", 0.5)
    packed(tmp_path / "their.fmu", library, guid)
    before = time.monotonic()
    with refused("controller 'theirs'", "their.fmu", match=said):
        called(tmp_path)
    assert time.monotonic() - before < 10


def test_a_good_one_is_called(library, tmp_path):
    """The same library without a fault gives its force."""
    packed(tmp_path / "their.fmu", library)
    assert called(tmp_path) == [1.0]


@pytest.mark.parametrize(
    ("change", "place", "said"),
    [
        (str, "../binaries/linux64/their.so", "leads out of its folder"),
        (str, "/binaries/linux64/their.so", "leads out of its folder"),
        (str, "C:/binaries/linux64/their.so", "leads out of its folder"),
        (str, "binaries/win64/their.dll", "has binaries for win64, and none for linux64; export it for linux64"),
        (str, "sources/their.c", "has binaries for no platform, and none for linux64"),
        (lambda text: text.replace('fmiVersion="2.0"', 'fmiVersion="3.0"'), "", "its version is FMI '3.0'"),
        (lambda text: text.replace("CoSimulation", "ModelExchange"), "", "it is for model exchange only"),
        (
            lambda text: text.replace('identifier="their"', 'identifier="../their"').replace("their", "../x"),
            "",
            "is not a name in C",
        ),
        (
            lambda text: text.replace('unit="m/s"', 'unit="mm/s"'),
            "",
            "the unit of its sprung_velocity is 'mm/s'; export it in m/s",
        ),
        (lambda text: text.replace('unit="N"', 'unit="kN"'), "", "the unit of its control_force is 'kN'; export it in N"),
        (lambda text: text.replace('"sprung_velocity"', '"speed"'), "", "its inputs are speed"),
        (lambda text: text.replace('"control_force"', '"torque"'), "", "its outputs are torque"),
        (lambda text: text.replace("<?xml", "<!DOCTYPE x [<!ENTITY a 'b'>]><?xml"), "", "defines entities"),
        (lambda text: text[:-20], "", "is damaged"),
        (
            lambda text: text.replace("<CoSimulation", '<CoSimulation needsExecutionTool="true"'),
            "",
            "it needs the program that exported it",
        ),
    ],
)
def test_a_hostile_file_is_one_line(change, place, said, library, tmp_path):
    """Names that lead out, no binary for this machine, other units and names, and damaged descriptions are one line each."""
    packed(tmp_path / "their.fmu", library, change=change, place=(place or "binaries/linux64/their.so").encode())
    with refused("controller 'theirs'", said):
        called(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["their.fmu"]


def test_what_is_no_fmu(library, tmp_path):
    """A file that is no zip, one that lies elsewhere, and keys that do not go beside it are refused; a link in it is, too."""
    (tmp_path / "their.fmu").write_bytes(b"PK no zip")
    with refused("the file is not an FMU, or is damaged"):
        called(tmp_path)
    packed(tmp_path / "their.fmu", library)
    with zipfile.ZipFile(tmp_path / "their.fmu", "a") as archive:
        link = zipfile.ZipInfo("resources/link")
        link.external_attr = 0o120777 << 16
        archive.writestr(link, "/etc")
    with refused("it contains a link"):
        called(tmp_path)
    for wrong in ('fmu = "../their.fmu"', 'fmu = "/tmp/their.fmu"', 'fmu = "their.zip"', 'fmu = "their.fmu"\npreview = 1.0'):
        with pytest.raises(InputError, match="fmu"):
            parse_vehicle(TEXT + THEIRS.replace('fmu = "their.fmu"', wrong), folder=tmp_path)
    with refused("fmu", "gain"):
        parse_vehicle(TEXT + THEIRS + "gain = [[1.0, 2.0]]\n", folder=tmp_path)
    with refused("there is no such file"):
        (tmp_path / "their.fmu").unlink()
        called(tmp_path)
