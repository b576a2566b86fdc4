"""A complaint is one line of a sensible length that a terminal can show, whatever it quotes."""

import dataclasses

import numpy as np
import pytest

from models.common.errors import LONGEST, LONGEST_VALUE, InputError, one_line, quoted
from models.roads.iso8608 import Iso8608
from models.roads.load import LOADS
from models.roads.obstacles import OBSTACLES
from models.vehicle.vehicle import parse_vehicle, read_vehicle

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
        if name in (field.name for field in dataclasses.fields(kind)) and not (kind is Iso8608 and name in ("lowest", "highest")):
            with pytest.raises(
                InputError, match=rf"{name} = -1e\+12 is not allowed; give a number from \S+ to \S+{unit and ' ' + unit}$"
            ):
                kind(**{name: -1e12})  # pyright: ignore[reportArgumentType]


def test_one_line():
    """Nothing in a message breaks the line, moves the cursor or changes a colour, and no message is longer than allowed."""
    assert one_line("a\nb\r\nc\x1b[2J \udcff é Ж") == r"a b c\x1b[2J \udcff é Ж"
    assert len(one_line("many words " * 1000)) == LONGEST


@pytest.mark.parametrize("value", ["x" * 9000, np.ones((50, 50)), {"X": [[1.0] * 40] * 40}, 10**4000])
def test_values(value):
    """A value of any size is quoted by its begin and its end."""
    assert len(quoted(value)) <= LONGEST_VALUE


@pytest.mark.parametrize(
    ("new", "said"),
    [
        ('[controllers.own]\nmeasured = ["control_force_rear_left"]\norder = []\n',
         "[controllers.own] order = [] is unknown; give one of full, static"),
        ("[implementation]\nquantisation = { heave_acc = 1.0 }\n",
         "[implementation] quantisation: unknown signal 'heave_acc'; give one of heave_acceleration, "),
    ],
)  # fmt: skip
def test_the_cause_is_named_shortly(new, said):
    """The message about a value of a wrong type, or about a wrong signal among dozens, has less than 300 characters."""
    text = read_vehicle("full_car").text
    with pytest.raises(InputError) as error:
        parse_vehicle(text.replace("[controllers.I]", f"{new}[controllers.I]", 1))
    assert said in str(error.value)
    assert len(str(error.value)) < 300
