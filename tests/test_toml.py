"""A TOML text of a few kilobytes takes neither minutes nor gigabytes, whoever wrote it; and what is no bomb is read."""

import time
import tomllib

import pytest

from models.common.errors import InputError
from models.common.files import MOST_DOTS, parse_toml
from models.vehicle.vehicle import read_vehicle
from sim.campaign.file import read_campaign

PARTS = {"bare": "a", "quoted": '"a.b\\"c"', "literal": "'a.b'", "spaced": " a\t"}
PLACES = {
    "a key": "{key} = 1",
    "a section": "[{key}]",
    "a list of sections": "[[{key}]]",
    "an inline table": "x = {{ y = 1, {key} = 1 }}",
    "behind a comment": "# it's \"\n{key} = 1",
    "behind a string": 'x = {{ y = "\\"\\\\", {key} = 1 }}',
    "behind a literal": "x = {{ y = '\\', {key} = 1 }}",
    "behind a long string": 'x = {{ y = """a\n\\""" # """, {key} = 1 }}',
    "behind a quotation": 'x = {{ y = """"a"\n"b"""", {key} = 1 }}',
    "behind a long literal": "x = {{ y = '''a\n'' # ''', {key} = 1 }}",
    "behind a literal quotation": "x = {{ y = ''''a'\n'b'''', {key} = 1 }}",
}


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("place", PLACES)
def test_many_dots_are_refused(place, part):
    """A key of more dots than allowed is refused wherever it stands and however it is written; one dot fewer is TOML."""
    allowed = PLACES[place].format(key=".".join([PARTS[part]] * (MOST_DOTS + 1)))
    assert parse_toml(allowed) == tomllib.loads(allowed)
    with pytest.raises(InputError, match=rf"^a key has {MOST_DOTS + 1} dots, and at most {MOST_DOTS} are allowed"):
        parse_toml(PLACES[place].format(key=".".join([PARTS[part]] * (MOST_DOTS + 2))))


@pytest.mark.parametrize(
    "text",
    [
        f"# {'.' * 100}\na = 1",
        f"a = '{'.' * 100}'",
        f'a = "{"." * 100}\\""',
        'a = """' + ".\n" * 100 + '"""',
        f"a = [{'1.5, ' * 100}]",
        f"a = {'[' * 100}1.5{']' * 100}",
        "a = 1.5\n" + "\n".join(f"b{i}.c = 1.5" for i in range(100)),
    ],
)
def test_other_dots_are_not_counted(text):
    """Dots of comments, texts, numbers and many keys are no dots of one key."""
    assert parse_toml(text) == tomllib.loads(text)


def test_a_number_beyond_floats_is_named():
    """A whole number that no float holds is refused by its key, wherever it stands."""
    for text in ("a.b = {c}", "a = {{b = [1, {c}]}}", "[a]\nb = -{c}"):
        with pytest.raises(InputError, match=r"^a\.b is a number of 401 digits"):
            parse_toml(text.format(c="1" * 401))
    assert parse_toml(f"a = {'9' * 308}")["a"] == int("9" * 308)


@pytest.mark.parametrize("text", [".".join("a" * 20_000) + " = 1", "'" * 10**6, '"' + '\\"' * 10**6, '"""' + '""a' * 10**6])
def test_it_takes_no_time(text):
    """A reading that grows with the square of the text is never begun: less than 2 s each, where the first took 19 s and 1.7
    GB."""
    begin = time.process_time()
    with pytest.raises(InputError, match=r"^a key has 19999 dots|^not TOML"):
        parse_toml(text)
    assert time.process_time() - begin < 2  # measured: 0.2 s at most


def test_every_file_comes_through_the_door(tmp_path):
    """Vehicle files, those that a campaign names, and campaign files are refused so, by name."""
    vehicle, campaign = tmp_path / "bomb.toml", tmp_path / "campaign.toml"
    vehicle.write_text(".".join("a" * 20_000) + " = 1\n")
    campaign.write_text("vehicles = ['bomb.toml']\n")
    with pytest.raises(InputError, match=r"^vehicle file .*bomb\.toml: a key has 19999 dots"):
        read_vehicle(vehicle)
    with pytest.raises(InputError, match=r"^campaign file .*: vehicle file .*bomb\.toml: a key has 19999 dots"):
        read_campaign(campaign)
    with pytest.raises(InputError, match=r"^campaign file .*bomb\.toml: a key has 19999 dots"):
        read_campaign(vehicle)
