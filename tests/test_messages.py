"""A complaint is one line of a sensible length that a terminal can show, whatever it quotes."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest

from models.common.errors import LONGEST, LONGEST_VALUE, LONGEST_WORD, InputError, middle_cut, one_line, quoted
from models.kinds.kind import HERE
from models.roads.choice import choose_road
from models.roads.iso8608 import Iso8608
from models.roads.load import LOADS
from models.roads.obstacles import OBSTACLES
from models.roads.profile_file import read_profile
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from synth.__main__ import main as synth
from synth.plant.numerics import DesignError

UNIT = {
    "m": "height length edge depth amplitude track_width x y",
    "m/s": "speed",
    "Hz": "lowest highest",
    "kg": "mass",
    "N": "force",
}
UNIT |= {"s": "start rise hold duration", "": "g factor"}


@pytest.mark.parametrize("kind", [*OBSTACLES.values(), Iso8608, *LOADS.values()], ids=lambda kind: kind.__name__)
def test_every_range_has_its_unit(kind):
    """A number of a road, a load or a vehicle that is not allowed is told its range in its unit, and a pure number in none."""
    for name, unit in ((name, unit) for unit, names in UNIT.items() for name in names.split()):
        if name in (field.name for field in dataclasses.fields(kind)):
            with pytest.raises(
                InputError, match=rf"{name} = -1e\+12 is not allowed; give a number from \S+ to \S+{unit and ' ' + unit}$"
            ):
                kind(**{name: -1e12})


def test_pure_numbers_have_no_unit():
    """A share is from -2 to 3, not from -2 to 3 1; nor has an error of any parameter such a unit."""
    for kind in ("quarter_car", "half_car", "full_car"):
        for parameter in read_vehicle(kind).kind.parameters:
            with pytest.raises(InputError) as said:
                parameter.check(-1e99)
            assert str(said.value).endswith(f"{parameter.largest:g} {parameter.unit}".removesuffix(" 1"))


@pytest.mark.parametrize("error", [InputError, DesignError])
def test_what_is_quoted_is_cut_in_the_middle(error):
    """A long path, value or text in quotes keeps its begin and its end; what is said around it stays whole."""
    for long in (
        "/" + "folder/" * 500 + "car.toml",
        "'" + "x y " * 900 + "end'",
        '"' + "9, " * 2000 + '9"',
        "[" + "1," * 3000 + "2]",
    ):
        said = str(error(f"vehicle file {long}: its own words stay; give another"))
        assert said.startswith(f"vehicle file {long[:70]}")
        assert said.endswith(f"{long[-70:]}: its own words stay; give another") or said.endswith(
            "its own words stay; give another"
        )
        assert len(said) <= LONGEST_WORD + 60
    words = "it's the user's own words, " * 20 + "that's all"
    assert str(error(words)) == words, "apostrophes are no quotation"


def test_one_line():
    """Nothing in a message breaks the line, moves the cursor or changes a colour, and no message is longer than allowed."""
    assert one_line("a\nb\r\nc\x1b[2J \udcff é Ж") == r"a b c\x1b[2J \udcff é Ж"
    assert len(one_line("many words " * 1000)) == LONGEST
    assert one_line(one_line("x" * 5000)) == one_line("x" * 5000), "an error within an error is cut once"


@pytest.mark.parametrize(
    "value", ["x" * 9000, [[1.234567890123] * 9] * 9, np.ones((50, 50)), {"X": [[1.0] * 40] * 40}, 10**4000, [[[[[[]]]]]]]
)
def test_values(value):
    """A value of any size is quoted by its begin and its end."""
    assert len(quoted(value)) <= LONGEST_VALUE


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        *(
            ("[controllers.I]", f'[controllers.own]\nmeasured = ["control_force_rear_left"]\norder = {value}\n[controllers.I]',
             f"[controllers.own] order = {value.title()} is not known; known: full, static")
            for value in ("true", "0.5", "[]")
        ),
        ("[controllers.I]", "[implementation]\nquantisation = { heave_acc = 1.0 }\n[controllers.I]",
         "[implementation] quantisation of unknown signal 'heave_acc'; measured can be heave_acceleration, "),
    ],
)  # fmt: skip
def test_the_cause_is_named_shortly(old, new, said):
    """A value of a wrong type and a wrong signal among dozens are each named in less than 300 characters."""
    text = read_vehicle("full_car").text
    with pytest.raises(InputError) as error:
        parse_vehicle(text.replace(old, new, 1))
    assert said in str(error.value)
    assert len(str(error.value)) < 300


@pytest.mark.parametrize("most", [10, 11, 60])
def test_the_middle(most):
    """A cut text has exactly the length that is allowed, its first characters and its last."""
    text = "".join(map(chr, range(48, 148)))
    cut = middle_cut(text, most)
    assert len(cut) == most
    begin, end = cut.split(" ... ")
    assert text.startswith(begin)
    assert text.endswith(end)


def test_files(tmp_path):
    """Messages from the doors: a certificate's X, a gain, a controller's name, a road, a cell, all of thousands of characters."""
    text = (HERE / "quarter_car.toml").read_text(encoding="utf-8")
    saved = tmp_path / "car.toml"
    assert synth(["--controller", "I", "--save", str(saved)]) == 0
    start = next(line for line in saved.read_text(encoding="utf-8").split("\n") if line.startswith("X = "))
    saved.write_text(saved.read_text(encoding="utf-8").replace(start, f"X = {[[1.23456789012345] * 30] * 30}"), encoding="utf-8")
    road = tmp_path / "road.csv"
    road.write_text("0 0\n1 0\n" + "9x" * 5000 + " 1\n", encoding="utf-8")
    for call in (
        lambda: synth(["--check", str(saved)]),
        lambda: parse_vehicle(f"{text}\n[controllers.long]\nmeasured = ['sprung_velocity']\ngain = [['{'x' * 9000}']]"),
        lambda: parse_vehicle(f"{text}\n[controllers.{'x' * 9000}]\nmeasured = ['sprung_velocity']"),
        lambda: parse_vehicle(text.replace("504.5", f"[{'1, ' * 3000}]")),
        lambda: read_vehicle("x/" * 2000),
        lambda: choose_road("bump:" + "x" * 9000),
        lambda: read_profile(road, 20.0),
    ):
        with pytest.raises(InputError) as caught:
            call()
        assert len(str(caught.value)) < 600


def test_a_command_says_it_in_one_line():
    """Messages of argparse are cut as well."""
    run = subprocess.run(
        [sys.executable, "-m", "synth", "x" * 5000], capture_output=True, text=True, encoding="utf-8", timeout=60
    )
    assert run.returncode == 2
    assert run.stderr.count("\n") == 1
    assert len(run.stderr) < 300
