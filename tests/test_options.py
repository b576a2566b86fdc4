"""Options that contradict one another, or have no effect together, are refused; so are outputs that cannot be written.

Both before any work: nothing is designed, nothing is left behind.
"""

import os
from pathlib import Path

import pytest

from models.common.errors import InputError
from models.vehicle.vehicle import read_vehicle
from synth.vehicle.designer import Designer
from tests.commands import main_of, refused
from tests.pages import hopper

MAP = ("--vary", "height:0.1:0.2:2", "--vary", "speed:5:10:2")
COMMANDS = {  # with the least that each needs
    "sim.bump": ("--controller", "I", "--duration", "1"),
    "sim.drive": ("--controller", "I", "--duration", "1"),
    "sim.sweep": (),
    "sim.envelope": ("--controller", "I", *MAP),
    "sim.margins": ("--controller", "I"),
    "sim.report": ("--quick",),
    "synth": (),
}
OUTPUTS = {
    "sim.bump": ("--logs",),
    "sim.drive": ("--logs",),
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

    def design(self, *arguments):
        raise AssertionError("the work was begun")

    monkeypatch.setattr(Designer, "design", design)


REFUSED = [
    ("sim.bump", ["--controller", "all", "--controller", "I"], "all includes every controller"),
    ("sim.bump", ["--controller", "I", "--controller", "II", "--controller", "I"], "--controller I is given twice"),
    ("sim.bump", ["--controller", "nobody"], "unknown controller 'nobody'"),
    ("sim.bump", ["--controller", "I", "--no-logs", "--logs", "x"], "--logs: not allowed with argument --no-logs"),
    ("sim.bump", ["--controller", "I", "--open", "--serve"], "--serve: not allowed with argument --open"),
    ("sim.bump", ["--controller", "I", "--serve", "--no-logs"], "--no-logs makes none"),
    ("sim.bump", ["--controller", "I", "--track", "left"], "only one track"),
    ("sim.drive", ["--controller", "I", "--class", "C", "--road", "step"], "--class or --road, not both"),
    ("sim.drive", ["--controller", "I", "--road", "watts_hump", "--seed", "0"], "--seed says which random road"),
    ("sim.drive", ["--controller", "I", "--controller", "all"], "all includes every controller"),
    ("sim.sweep", ["--speed", "12.5"], "--speed matters to rear wheels only"),
    ("sim.sweep", ["--controller", "I", "--controller", "I"], "--controller I is given twice"),
    ("sim.envelope", ["--controller", "I", *MAP, "--height", "0.1"], "--vary height varies it"),
    ("sim.envelope", ["--controller", "I", *MAP, "--speed", "12.5"], "--vary speed varies it"),
    ("sim.envelope", ["--controller", "I", "--controller", "II", *MAP], "--controller: is given twice"),
    ("sim.envelope", ["--controller", "all", *MAP], "all is not allowed, as this command takes one controller"),
    ("sim.envelope", MAP, "no controller is given"),
    ("sim.envelope", ["--controller", "I", *MAP, "--csv", "m.png", "--picture", "m.png"], "is the file of --csv, too"),
    ("sim.envelope", ["--controller", "I", *MAP, "--csv", "car.toml", "--vehicle", "car.toml"], "is an input file"),
    ("sim.envelope", ["--controller", "I", *MAP, "--csv", "hard.csv", "--vehicle", "car.toml"], "is an input file"),
    ("sim.envelope", ["--controller", "I", *MAP, "--csv", "a.csv", "--picture", "a.svg"], "is the file of --csv, too"),
    ("sim.sweep", ["--picture", "hopper.svg", "--vehicle", "hopper.toml"], "is an input file"),
    ("synth", ["--save", "hopper.xml", "--vehicle", "hopper.toml"], "is an input file"),
    ("synth", ["--save", "car.toml", "--vehicle", "car.toml"], "is an input file"),
    ("synth", ["--save", "x.toml", "--picture", "x.svg"], "--save x.toml is the file of --picture, too"),
    ("synth", ["--save", "/dev/stdout", "--json"], "both write to standard output"),
    ("synth", ["--front", "ride:travel", "--csv", "hard.csv", "--vehicle", "car.toml"], "is an input file"),
    ("synth", ["--front", "ride:travel", "--csv", "hump.csv", "--vehicle", "bounded.toml"], "--csv hump.csv is an input file"),
    ("synth", ["--front", "ride:travel", "--csv", "fleet.csv", "--vehicle", "bounded.toml"], "--csv fleet.csv is an input file"),
    ("sim.report", ["--figures", ".", "--vehicle", "bounded.toml"], "--figures . contains the input file fleet.csv"),
    ("sim.inspect", ["car.mcap", "--csv", "kind.csv", "--kinds", "."], "--csv kind.csv is an input file"),
    ("sim.envelope", ["--controller", "I", *MAP, "--csv", "/dev/stdout", "--json"], "both write to standard output"),
    ("sim.margins", ["--controller", "passive", "--controller", "I"], "--controller: is given twice"),
    ("sim.report", ["--controller", "all", "--controller", "I"], "all includes every controller"),
    ("sim.report", ["--controller", "nobody"], "unknown controller 'nobody'"),
    ("synth", ["--check", "car.toml", "--vehicle", "quarter_car"], "--check reads its own file"),
    ("synth", ["--check", "car.toml", "--refine"], "--check reads its own file"),
    ("synth", ["--check", "car.toml", "--save", "x.toml"], "--check reads its own file"),
    ("synth", ["--check", "car.toml", "--zero-l"], "--check reads its own file"),
    ("synth", ["--check", "car.toml", "--controller", "I"], "'I' has no gain"),
    ("synth", ["--refine", "--controller", "passive"], "--refine: passive has no gain"),
    ("synth", ["--zero-l", "--vehicle", "given.toml"], "--zero-l is of a design from measurements"),
    ("synth", ["--save", "x.toml", "--controller", "passive"], "--save has nothing to write"),
    ("synth", ["--save", "x.toml", "--controller", "state", "--controller", "state"], "--controller state is given twice"),
]


@pytest.mark.parametrize(("name", "arguments", "words"), REFUSED, ids=[f"{one[0]} {one[2]}" for one in REFUSED])
def test_what_makes_no_sense_together_is_refused(name, arguments, words, tmp_path, monkeypatch, nothing_designed):
    """One line that says what contradicts what, before the work; nothing is left behind."""
    text = read_vehicle("quarter_car").text
    (tmp_path / "car.toml").write_text(text)
    (tmp_path / "given.toml").write_text(
        text[: text.index("[controllers")] + '[controllers.mine]\nmeasured = ["sprung_velocity"]\ngain = [[-9000.0]]\n'
    )
    hopper(tmp_path)
    (tmp_path / "fleet.csv").write_text("sprung_mass\n1.1\n")
    (tmp_path / "hump.csv").write_text("0,0\n1,0.01\n2,0\n")
    bound = '{ peak = "suspension_deflection", road = "hump.csv", at_most = 0.09 }'
    goal = f'[controllers.goal]\nmeasured = ["sprung_velocity"]\nbounds = [{bound}]\nfamily = "fleet.csv"\n'
    (tmp_path / "bounded.toml").write_text(f"{text}\n{goal}")
    for one, other in (
        ("car.toml", "hard.csv"),
        ("hopper.xml", "hopper.svg"),
        ("hopper.xml", "kind.csv"),
        ("a.csv", "a.svg"),
        ("x.toml", "x.svg"),
    ):
        (tmp_path / one).touch()
        os.link(tmp_path / one, tmp_path / other)
    monkeypatch.chdir(tmp_path)
    before = tree(tmp_path)
    with refused(words):
        main_of(name)(list(arguments))
    assert tree(tmp_path) == before


@pytest.mark.parametrize(("name", "option"), [(name, option) for name, options in OUTPUTS.items() for option in options])
def test_an_output_that_cannot_be_written_is_said_before_the_work(name, option, tmp_path, monkeypatch, nothing_designed):
    """Of every output of every command, whatever stands in its way; and what can be written leaves nothing until it is.

    Nor is anything written under a name that says that it is something else.
    """
    monkeypatch.chdir(tmp_path)
    plain = NAMES.get(option, "out")
    ending = Path(plain).suffix
    loop, pipe = f"loop{ending}", f"pipe{ending}"
    (tmp_path / "file").touch()
    (tmp_path / f"folder{ending}").mkdir()
    (tmp_path / loop).symlink_to(loop)
    ways = ["file/below", loop] if option in FOLDERS else [f"nowhere/{plain}", f"file/{plain}", f"folder{ending}", loop]
    if hasattr(os, "mkfifo") and option not in FOLDERS:
        os.mkfifo(tmp_path / pipe)
        ways.append(pipe)
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


def test_a_road_class_in_small_letters_is_that_class(capsys):
    """`--class c` is `--class C`."""
    outputs = []
    for letter in "cC":
        main_of("sim.drive")(["--controller", "passive", "--class", letter, "--duration", "1", "--no-logs"])
        outputs.append(capsys.readouterr().out)
    assert outputs[0] == outputs[1]
