"""A shared object is made once, is found by content, and is nobody's to change."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from models.vehicle.vehicle import read_vehicle
from tests.support.shared import made, printed


@dataclass(frozen=True, eq=False)
class Pair:
    """Something with an array and a list."""

    array: np.ndarray
    names: list[str]


MADE = []


def pair(vehicle, length: float) -> Pair:
    MADE.append(length)
    array = np.full(3, length)
    array.flags.writeable = False
    return Pair(array, [vehicle.text])


def failing(vehicle) -> None:
    MADE.append(vehicle)
    raise ValueError("not this time")


def test_is_made_once(paper):
    """Equal arguments, one object or two, and whatever they cache, are one; another number is another."""
    MADE.clear()
    first, other = made(pair, paper, 1.0), made(pair, paper, 2.0)
    copy = read_vehicle("quarter_car")
    assert copy.linear_model is copy.linear_model  # cached from here on
    again = made(pair, copy, 1.0)
    heavier = made(pair, replace(paper, parameters={**paper.parameters, "sprung_mass": 505.0}), 1.0)
    assert MADE == [1.0, 2.0, 1.0]
    assert (first.array == again.array).all()
    assert (first.array != other.array).all()
    assert (first.array == heavier.array).all()


def test_everybody_has_a_copy(paper):
    """Changes of one test are seen by no other, and arrays that are read-only stay so."""
    made(pair, paper, 3.0).names.append("changed")
    again = made(pair, paper, 3.0)
    assert again.names == [paper.text]
    assert not again.array.flags.writeable


def test_what_raises_is_not_kept(paper):
    """A call that raises does so every time."""
    MADE.clear()
    for _ in range(2):
        with pytest.raises(ValueError, match="not this time"):
            made(failing, paper)
    assert len(MADE) == 2


def test_functions_are_told_apart_by_their_code():
    """Two of one name with other numbers in them, or around them, are two."""

    def times(factor: float):
        return lambda value: factor * value

    assert [made(times(factor), 2.0) for factor in (1.0, 3.0)] == [2.0, 6.0]


def test_a_command_runs_in_a_folder_with_its_files(paper):
    """Prints, files and exit code are kept with the folder; with other files it is run again."""
    light = paper.text.replace("504.5", "500.5")
    arguments = ("--controller", "state", "--vehicle", "car.toml", "--json", "--save", "out.toml")
    one, other = (printed("synth", *arguments, files={"car.toml": text}) for text in (paper.text, light))
    assert one.code == other.code == 0
    assert one.json["controllers"][0]["norm"] != other.json["controllers"][0]["norm"]
    assert {path.name for path in one.folder.iterdir()} == {"car.toml", "out.toml"}
    assert printed("synth", *arguments, files={"car.toml": paper.text}) == one
