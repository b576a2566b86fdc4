"""Options that contradict one another, or have no effect together, are refused; so are outputs that cannot be written.

Both before any work: nothing is designed, nothing is left behind.
"""

import os
import shlex
from pathlib import Path

import pytest

from models.common.errors import InputError
from models.vehicle.vehicle import read_vehicle
from synth.vehicle.designer import Designer
from tests.support.commands import main_of, refused
from tests.support.pages import hopper

MAP = "--vary height:0.1:0.2:2 --vary speed:5:10:2"
COMMANDS = {  # with the least that each needs
    "sim.bump": ("--controller", "I", "--duration", "1"),
    "sim.drive": ("--controller", "I", "--duration", "1"),
    "sim.sweep": (),
    "sim.envelope": ("--controller", "I", *MAP.split()),
    "sim.margins": ("--controller", "I"),
    "sim.report": ("--quick",),
    "synth": (),
}
OUTPUTS = {
    "sim.bump": ("--picture", "--logs"),
    "sim.drive": ("--picture", "--logs"),
    "sim.sweep": ("--picture", "--logs"),
    "sim.envelope": ("--csv", "--picture", "--logs"),
    "sim.margins": ("--picture", "--logs"),
    "sim.report": ("--out", "--figures"),
    "synth": ("--save", "--picture"),
}
FOLDERS = ("--logs", "--figures")
NAMES = {"--picture": "out.png", "--out": "out.html", "--csv": "out.csv", "--save": "out.toml"}


def tree(folder: Path) -> list[str]:
    """Everything below a folder."""
    return sorted(str(path) for path in folder.rglob("*"))


@pytest.fixture
def nothing_designed(monkeypatch):
    """A design would fail the test."""

    design = Designer.design

    def begun(self, name, *arguments):
        assert name == "passive", "the work was begun"  # which is no work
        return design(self, name)

    monkeypatch.setattr(Designer, "design", begun)


RIG = "sim.drive --vehicle half_car --controller passive --road"
QUOTES = "put quotes around a value that contains spaces, as in"
REFUSED = [
    ("sim.drive --controller I --speed 90 km/h", "unrecognized argument 'km/h'", f"{QUOTES} --speed '90 km/h'"),
    ("sim.drive --controller I --road bump:height=60 mm", f"{QUOTES} --road 'bump:height=60 mm'"),
    ("sim.bump --controller I II", "repeat --controller for several values, as in --controller I --controller II, or put quotes"),
    ("sim.bump --controller=I II", "as in --controller I --controller II, or put quotes"),
    ("sim.bump --no-logs I II", "argument 'I'; give every value after its option, as in --controller I"),
    ("sim.report car.toml", "argument 'car.toml'; give every value after its option, as in --vehicle car.toml"),
    ("sim.report page.html", "argument 'page.html'; give every value after its option; see"),
    ("synth --controller I --json II", "argument 'II'; give every value after its option, as in --controller II"),
    ("sim.new my car.toml", f"{QUOTES} 'my car.toml'"),
    ("sim.bump --controller all --controller I", "all already selects every controller"),
    ("sim.bump --controller I --controller II --controller I", "--controller I is given twice"),
    ("sim.bump --controller I --no-logs --logs x", "--logs: not allowed with argument --no-logs"),
    ("sim.bump --controller I --serve --no-logs", "--no-logs writes no recording"),
    ("sim.bump --controller I --track left", "needs a vehicle with a left and a right track"),
    ("sim.drive --controller I --class C --road step", "--class and --road cannot be combined"),
    ("sim.drive --controller I --road watts_hump --seed 0", "--seed selects a random road"),
    ("sim.sweep --speed 12.5", "--speed affects only rear wheels"),
    ("sim.envelope --controller I MAP --height 0.1", "--height and --vary height set the same quantity"),
    ("sim.envelope --controller I --controller II MAP", "--controller: is given twice"),
    ("sim.envelope --controller all MAP", "all is not allowed, because this command takes only one controller"),
    ("sim.envelope --controller I MAP --csv car.toml --vehicle car.toml", "is an input file"),
    ("sim.envelope --controller I MAP --csv hard.csv --vehicle car.toml", "is an input file"),
    ("sim.envelope --controller I MAP --csv a.csv --picture a.svg", "is the file of --csv, too"),
    ("sim.sweep --picture hopper.svg --vehicle hopper.toml", "is an input file"),
    ("synth --save x.toml --picture x.svg", "--save x.toml is the file of --picture, too"),
    ("synth --save /dev/stdout --json", "both write to standard output"),
    ("synth --front ride:travel --csv hump.csv --vehicle bounded.toml", "--csv hump.csv is an input file"),
    ("sim.report --figures . --vehicle bounded.toml", "--figures . contains the input file fleet.csv"),
    ("sim.inspect car.mcap --csv kind.csv --kinds .", "--csv kind.csv is an input file"),
    ("synth --check car.toml --vehicle quarter_car", "--check verifies the claims of the given file"),
    ("synth --check car.toml --controller I", "'I' has no gain"),
    ("synth --refine --controller passive", "--refine: the passive vehicle has no gain"),
    ("synth --zero-l --vehicle given.toml", "--zero-l applies only to two-step designs"),
    ("synth --save x.toml --controller passive", "--save has nothing to write"),
    ("sim.bump --controller III", "'III'", "I, II, II_printed, I_printed, passive, state, state_printed"),
    ("sim.bump --controller ''", "--controller", "is empty"),
    ("sim.bump --controller I,II", "unknown controller 'I,II'", "; repeat the option, as in --controller I --controller II"),
    ("sim.bump --controller I --controller 'a\nb'", "'a\\nb'"),
    ("sim.bump --controller I --colour", "--colour", "--help"),
    ("sim.bump --controller I --height 1 --height 2", "--height", "is given twice"),
    ("sim.bump --controller I --vehicle mine.toml", "mine.toml", "no such file", "quarter_car"),
    ("sim.bump --controller I --height high", "--height", "'high' is not a number"),
    ("sim.bump --controller I --height nan", "--height", "'nan' is not a finite number"),
    ("sim.bump --controller I --length 0.02", "0.0016 s", "two timesteps of 0.001 s"),
    ("sim.bump --controller I --timestep 0", "timestep = 0.0", "above 0"),
    ("sim.bump --controller I --timestep 0.05", "timestep = 0.05", "above 0.0444 s"),
    ("sim.bump --controller I --timestep 1e-300", "samples are too many; give a shorter duration", "1000000"),
    ("sim.bump --controller I --duration 0.0015", "duration = 0.0015", "two timesteps"),
    ("sim.bump --controller I --logs /dev/null", "/dev/null", "folder"),
    ("sim.drive --controller I --seed 1.5", "'1.5' is not an integer"),
    ("sim.drive --controller I --seed -1", "seed = -1"),
    ("sim.sweep --controller passive --timestep 0.02", "is too large for frequencies up to 25 Hz"),
    ("sim.sweep --controller passive --amplitude 0", "amplitude"),
    ("sim.envelope --controller I --vary height:0.02:0.3:1 --vary speed:3:30:20", "2 or more"),
    ("sim.envelope --controller I", "--vary is given 0 times"),
    ("sim.envelope --controller I --vary height:0.02:0.3:20 --vary height:0.02:0.3:20", "twice"),
    ("sim.envelope --controller I --vary width:0.02:0.3:20 --vary speed:3:30:20", "unknown quantity"),
    ("sim.envelope --controller I --vary height:0.02:0.3 --vary speed:3:30:20", "NAME:LOW:HIGH:COUNT"),
    ("sim.envelope --controller I --vary height:0.3:0.02:20 --vary speed:3:30:20", "LOW below HIGH"),
    ("sim.envelope --controller I --vary height:0.02:0.3:1000 --vary speed:3:30:1000", "the map has 1000000 cells"),
    ("sim.envelope --controller I --vary height:0.02:0.3:20 --vary speed:0.5:30:20", "longer --duration"),
    ("sim.margins --controller passive", "'passive'", "no force", "no stability margin"),
    ("sim.margins --controller II --timestep 1", "timestep", "RK4"),
    ("synth --zero-l --controller state", "--zero-l applies only to two-step designs, but 'state' is not one"),
    ("synth --vehicle /no/such/file", "there is no such file"),
    ("synth --refine --cross-check", "--refine moves the gain away from the optima of these problems; omit"),
    ("synth --controller passive --cross-check", "needs a controller that is designed without filters, by LMI (22)"),
    ("synth --check half.toml", "contains no gain or law"),
    ("synth --front ride", "has 1 axis"),
    ("synth --front ride:ride", "contains ride twice"),
    ("synth --front ride:speed", "there is no axis 'speed'"),
    ("synth --front band=8-4:travel", "band=8-4 is not a band"),
    ("synth --front tolerance=200:travel", "tolerance=200 is not a valid error"),
    ("synth --front ride:travel --controller passive", "the passive vehicle measures nothing"),
    ("synth --front ride:travel --controller I --controller II", "of a single controller, but --controller names 2 controllers"),
    ("synth --front ride:travel --refine", "--front designs a trade-off"),
    ("synth --front ride:travel --point 3", "--point chooses the designs that --save writes"),
    ("synth --csv a.csv", "--csv writes the designs of --front"),
    ("synth --point 3", "--point chooses designs of --front"),
    ("synth --rates 0", "--rates 0 ms is not allowed; give sample periods from 0.01 to 1000 ms"),
    ("synth --rates nan", "'nan' is not a finite number"),
    ("synth --rates 5 6 5", "--rates 5 ms is given twice"),
    ("synth --rates", "expected at least one argument"),
    (f"synth --rates {' '.join(str(1 + k / 100) for k in range(1001))}", "at most 1000"),
    ("synth --rates 5 --refine", "--rates compares designs at other sample periods"),
    ("sim.drive --controller passive --load brake", "brake", "pitches", "a quarter_car only moves vertically"),
    ("sim.drive --controller passive --vehicle half_car --load corner", "rolls", "half_car only moves vertically and pitches"),
    ("sim.drive --controller passive --load push:g=1", "unknown load 'push:g=1'", "brake, corner, payload, lift, gust"),
    ("sim.drive --controller passive --load nowhere.csv", "nowhere.csv"),
    ("sim.drive --controller passive --load payload --road flat --seed 3", "--seed"),
    ("sim.drive --controller I --without noise", "no vehicle file gives this part"),
    ("sim.drive --controller I --csv signals.txt", "a table is written as CSV"),
    ("sim.bump --controller I --csv signals.txt", "a table is written as CSV"),
    ("sim.bump --controller I --brief --json", "--json", "--brief"),
    ("sim.new", "FILE is missing; give the name of the file to write"),
    (f"{RIG} rig", "a test rig needs a file with the heights of its posts"),
    (f"{RIG} rig:depth=2", "a test rig needs a file with the heights of its posts"),
    (f"{RIG} rig:file=drive.rsp", "RPC III files (.rsp, .drv) cannot be read, so export their channels as text"),
    (f"{RIG} rig:file=none.csv", "drive file none.csv: there is no such file"),
    (f"{RIG} rig:file=drive.csv:speed=2", "the name 'speed' in 'speed=2' is unknown; give one of"),
    (
        f"{RIG} rig:file=drive.csv:height_unit=m",
        "column 2, 'front [mm]', has a heading with the unit mm, but height_unit = m gives",
    ),
    (f"{RIG} rig:file=drive.csv --speed 10", "--speed does not apply to a test rig, on which"),
    (f"{RIG} rig:file=drive.csv --seed 1", "--seed selects a random road"),
    (f"{RIG} drive.csv", "for heights of a rig's posts over time, give rig:file="),
    ("sim.drive --controller passive --class C --from 5", "--from applies only to a road that is read from a file"),
    ("sim.drive --controller passive --road bump --from 5", "--from applies only to a road that is read from a file"),
    (f"{RIG} rig:file=drive.csv --from 5", "--from applies only to a road that is read from a file"),
    ("sim.drive --controller passive --road hump.csv:from=3 --from 5", "from is given twice, as '3' and as '5.0'"),
    ("synth --controller I --numbers float", "--numbers is for exported code"),
    ("synth --controller I --export ecu --fmi 3", "--fmi is for an FMU"),
    ("synth --controller I --part vehicle --export x.fmu", "--part vehicle exports the vehicle without a controller"),
    ("synth --part vehicle --numbers float --export x.fmu", "--numbers applies only to C code"),
    ("synth --controller I --numbers int16 --export x.fmu", "the variables of an FMU are floating-point numbers"),
    ("synth --vehicle quarter_car_semi_active --controller skyhook --part loop --export x.fmu", "skyhook"),
    ("synth --vehicle quarter_car_semi_active --controller skyhook --export x.mat", "skyhook", "no law with matrices"),
    ("synth --export x.mat --numbers float", "--numbers applies only to C code"),
    ("sim.margins --controller I --vary sprung_mass:0.8:1.2", "--vary is gone", "family", "campaign"),
]


@pytest.fixture(scope="module")
def places(tmp_path_factory):
    """A folder of input files, some with second names, as outputs may not be."""
    folder, text = tmp_path_factory.mktemp("places"), read_vehicle("quarter_car").text
    (folder / "car.toml").write_text(text)
    (folder / "given.toml").write_text(
        text[: text.index("[controllers")] + '[controllers.mine]\nmeasured = ["sprung_velocity"]\ngain = [[-9000.0]]\n'
    )
    (folder / "half.toml").write_text(read_vehicle("half_car").text)
    hopper(folder)
    (folder / "fleet.csv").write_text("sprung_mass\n1.1\n")
    (folder / "hump.csv").write_text("0,0\n1,0.01\n2,0\n")
    (folder / "drive.csv").write_text("time [s],front [mm],rear [mm]\n0,0,0\n1,1,1\n2,2,2\n3,3,3\n")
    bound = '{ peak = "suspension_deflection", road = "hump.csv", at_most = 0.09 }'
    goal = f'[controllers.goal]\nmeasured = ["sprung_velocity"]\nbounds = [{bound}]\nfamily = "fleet.csv"\n'
    (folder / "bounded.toml").write_text(f"{text}\n{goal}")
    for pair in ("car.toml hard.csv", "hopper.xml hopper.svg", "hopper.xml kind.csv", "a.csv a.svg", "x.toml x.svg"):
        one, other = pair.split()
        (folder / one).touch()
        os.link(folder / one, folder / other)
    return folder


@pytest.mark.parametrize("row", REFUSED, ids=[f"{row[0].split()[0]} {row[1]}" for row in REFUSED])
def test_bad_options_are_refused(row, places, monkeypatch, capsys, nothing_designed):
    """One line says what was found and what is allowed, before the work; nothing is printed, nothing is left behind."""
    line, *words = row
    name, *arguments = shlex.split(line.replace("MAP", MAP))
    monkeypatch.chdir(places)
    before = tree(places)
    with refused(*words):
        main_of(name)(arguments)
    assert capsys.readouterr().out == ""
    assert tree(places) == before


@pytest.mark.parametrize(("name", "option"), [(name, option) for name, options in OUTPUTS.items() for option in options])
def test_an_output_that_cannot_be_written_is_said_before_the_work(name, option, tmp_path, monkeypatch, nothing_designed):
    """For every output of every command, whatever stands in its way; and what can be written leaves nothing until it is.

    Nor is anything written under a name that says that it is something else.
    """
    monkeypatch.chdir(tmp_path)
    plain = NAMES.get(option, "out")
    ending = Path(plain).suffix
    (tmp_path / "file").touch()
    (tmp_path / f"folder{ending}").mkdir()
    ways = ["file/below"] if option in FOLDERS else [f"nowhere/{plain}", f"file/{plain}", f"folder{ending}"]
    before = tree(tmp_path)
    for way in ways:
        with pytest.raises(InputError) as caught:
            main_of(name)([*COMMANDS[name], option, way])
        assert way in str(caught.value), caught.value
        assert "give a name that ends in" not in str(caught.value)
    for other in ("out", "out.txt", f"out{ending}.json") if option not in FOLDERS else ():
        with pytest.raises(InputError, match=rf"{other}: .*; give a name that ends in .*\{ending}"):
            main_of(name)([*COMMANDS[name], option, other])
    with pytest.raises(AssertionError, match="the work was begun"):
        main_of(name)([*COMMANDS[name], option, "out" if option in FOLDERS else plain])
    assert tree(tmp_path) == before
