"""A complaint is one line of a sensible length that a terminal can show, whatever it quotes."""

import numpy as np
import pytest

from models.common.errors import LONGEST, LONGEST_VALUE, one_line, short_repr
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from tests.support.commands import refused


def test_one_line():
    """Nothing in a message breaks the line, moves the cursor or changes a colour, and no message is longer than allowed."""
    assert one_line("a\nb\r\nc\x1b[2J \udcff é Ж") == r"a b c\x1b[2J \udcff é Ж"
    assert len(one_line("many words " * 1000)) == LONGEST


@pytest.mark.parametrize("value", ["x" * 9000, np.ones((50, 50)), {"X": [[1.0] * 40] * 40}, 10**4000])
def test_values(value):
    """A value of any size is quoted by its begin and its end."""
    assert len(short_repr(value)) <= LONGEST_VALUE


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
    with refused(said, match=r"\A.{,300}\Z"):
        parse_vehicle(text.replace("[controllers.I]", f"{new}[controllers.I]", 1))
