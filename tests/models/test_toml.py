"""TOML: texts of users keep their comments, order and blank lines when keys are replaced, and mistakes are named in one line."""

import tomllib

import pytest

from models.common.errors import InputError
from models.common.files import parse_toml
from models.common.toml_edit import Replacement, section_lines, toml_value, with_replacements
from models.vehicle.vehicle import read_vehicle
from sim.campaign.file import read_campaign

VALUES = {"A": [[-1.0, 2e-300], [0.0, 0.1]], "K": [[1.0]]}
COMMENT = "# from 'mine.mat'"
LINES = f"{COMMENT}\nA = [[-1.0, 2e-300], [0.0, 0.1]]\nK = [[1.0]]\n"
INLINE = "A = [[-1.0, 2e-300], [0.0, 0.1]], K = [[1.0]]"
# Texts before and after `file` of the controller `mine` is replaced by these values.
EDITS = {
    "section": (
        '# a\n[controllers.mine]  # b\nfile = "m"\n\n\n# c\n[limits]\n',
        f"# a\n[controllers.mine]  # b\n{LINES}\n\n# c\n[limits]\n",
    ),
    "last line": ("[controllers.mine]\nfile = 'm'", f"[controllers.mine]\n{LINES[:-1]}"),
    "comment": (
        '[controllers.mine]\n  file = "m"  # of MATLAB\nx = 1\n',
        "[controllers.mine]\n  " + LINES.replace("\n", "\n  ").replace("0.1]]", "0.1]]  # of MATLAB")[:-2] + "x = 1\n",
    ),
    "inline table": (
        "[controllers]\nmine = { x = 1, file = 'm' }  # a\nother = {file=3}\n",
        f"[controllers]\n{COMMENT}\nmine = {{ x = 1, {INLINE} }}  # a\nother = {{file=3}}\n",
    ),
    "inline tables": (
        "controllers = {mine = {file = 'm', x = 1}, y = 2}\n",
        f"{COMMENT}\ncontrollers = {{mine = {{{INLINE}, x = 1}}, y = 2}}\n",
    ),
    "dotted keys": (
        "[controllers]\nmine.x = 1\nmine.file = 'm'\nmine.y = 2\n",
        "[controllers]\nmine.x = 1\n" + LINES.replace("\nA", "\nmine.A").replace("\nK", "\nmine.K") + "mine.y = 2\n",
    ),
    "quoted": ("['controllers' . \"mine\"]\n'file'   = 'm'\n", f"['controllers' . \"mine\"]\n{LINES}"),
    "sections apart": (
        "[controllers.mine.certificate]\nx = 1\n[limits]\n[controllers.mine]\nfile = 'm'\n[controllers.other]\nfile = 'm'\n",
        f"[controllers.mine.certificate]\nx = 1\n[limits]\n[controllers.mine]\n{LINES}[controllers.other]\nfile = 'm'\n",
    ),
    "arrays": (
        "[controllers.mine]\nx = [ # one\n  1,\n  2, # file = 'm'\n]\nfile = '''\nm'''\n[[controllers.mine.bounds]]\ny = 1\n",
        f"[controllers.mine]\nx = [ # one\n  1,\n  2, # file = 'm'\n]\n{LINES}[[controllers.mine.bounds]]\ny = 1\n",
    ),
}


@pytest.mark.parametrize(("before", "after"), EDITS.values(), ids=EDITS)
def test_only_the_key_is_replaced(before, after):
    """Whatever the style of a text, all of it but the replaced key stays as it is, byte for byte, and it has the values."""
    replacement = Replacement(("controllers", "mine", "file"), VALUES, COMMENT)
    assert with_replacements(before, [replacement]) == after
    assert tomllib.loads(after)["controllers"]["mine"].items() >= VALUES.items()
    assert with_replacements(before, []) == before


def test_a_text_that_cannot_be_edited():
    """If an edit would not give exactly the values, one line asks for a line of its own."""
    with pytest.raises(
        InputError,
        match=r"^Roadproof cannot replace a\.b\.file in the file as these keys are written now; write each key on its own line",
    ):
        with_replacements("a = { b.file = 'm' }\n", [Replacement(("a", "b", "file"), VALUES)])


def test_values_are_written_as_they_are_read():
    """Numbers, texts and tables of any content are the same after writing and reading; a section has a line for each."""
    values = {"x": [1, -0.1, 5e-324, float("inf"), True], "ö k": {"a.b": '"\\\n\x7f\U0001d6fe', "c": [{"d": []}]}}
    assert parse_toml(f"y = {toml_value(values)}") == {"y": values}
    lines = section_lines(("a", "b c"), values, "# d")
    assert lines[0] == '[a."b c"]    # d'
    assert parse_toml("\n".join(lines)) == {"a": {"b c": values}}
    assert len(lines) == 3


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("mass is 3", "Expected '='"),
        ("mass = 504,5", "write 504.5 for 504,5"),
        (f"mass = {'9' * 5000}", "4300 digits"),
        (f"mass = {'[' * 5000}", "recursion"),
    ],
)
def test_a_text_that_is_not_toml(tmp_path, text, said):
    """Vehicle and campaign files that are not TOML are refused by name in one line."""
    file = tmp_path / "mine.toml"
    file.write_text(text)
    for read, what in ((read_vehicle, "vehicle"), (read_campaign, "campaign")):
        with pytest.raises(InputError, match=f"^{what} file {file}: this is not valid TOML: .*{said}"):
            read(file)
