"""Tables in text files: roads, rigs, curves, loads and families are read by one reader, in every dialect alike."""

import itertools

import numpy as np
import pytest

from models.common.errors import InputError
from models.common.files import parse_toml
from models.common.table import BOTH, find_table
from models.common.units import LENGTH
from models.roads.choice import choose_road
from models.roads.load_choice import parse_history
from models.vehicle.in_place import with_contents
from tests.commands import in_the_suite

SEPARATORS = {"comma": ",", "comma and space": ", ", "semicolon": ";", "tab": "\t", "space": " ", "spaces": "   "}
ENDS = {"plain": ("", "\n"), "Windows": ("\ufeff", "\r\n"), "Macs": ("", "\r")}
NUMBERS = np.outer(np.arange(6), [0.25, 3.0, -2.125]) + [0, 0.5, 7]  # begins at 0 and ascends, with up to three decimals
CALLERS = {"road": ("distance", "left", "right"), "rig": ("time", "front", "rear"), "load": ("time", "heave", "pitch")}
CALLERS |= {"curve": ("velocity", "force"), "family": ("sprung_mass", "tyre_stiffness", "sprung_inertia")}
UNITS: dict[str, str] = dict(zip(("distance", "left", "right", "time", "front", "rear", "heave", "pitch", "velocity", "force"),
                 ("ft", "mm", "cm", "ms", "in", "mm", "kN", "kN m", "mm/s", "kN"), strict=True))  # fmt: skip
IN_SI = {"ft": 0.3048, "mm": 1e-3, "cm": 1e-2, "ms": 1e-3, "in": 0.0254, "kN": 1e3, "kN m": 1e3, "mm/s": 1e-3, "": 1.0}


def written(caller: str, mark: str, decimal: str, quotes: str, comments: bool, units: str) -> list[str]:
    """The lines of one table of numbers, in a dialect."""
    names = CALLERS[caller]
    above = [[name + (f" [{UNITS[name]}]" if units == "beside" and name in UNITS else "") for name in names]]
    if units == "below" and caller != "family":
        above.append([f"[{UNITS[name]}]" for name in names])
    rows = [[repr(float(cell)).replace(".", decimal) for cell in row] for row in NUMBERS[:, : len(names)].tolist()]
    lines = [mark.join(quotes + cell + quotes for cell in row) for row in (*above, *rows)]
    if comments:
        lines = ["# measured by hand", "", *(line + "  # as it is" * (i > len(above)) for i, line in enumerate(lines)), "#, end"]
    return lines


def read(caller: str, text: str, folder) -> np.ndarray:
    """Returns what a caller makes of it, in SI units, as columns."""
    (folder / "table.csv").write_bytes(text.encode())
    if caller == "road":
        profile = choose_road("table.csv", folder).profile
        assert profile is not None
        return np.column_stack([profile.distance, profile.heights])
    if caller == "rig":
        rig = choose_road("rig:file=table.csv", folder).rig
        assert rig is not None
        return np.column_stack([rig.time, rig.heights])
    if caller == "load":
        load = parse_history(text.lstrip("\ufeff"), "table.csv")
        return np.column_stack([load.time, *load.columns.values()])
    if caller == "curve":
        whole, _ = with_contents('[curves]\nsuspension_damping = { file = "table.csv" }\n', folder)
        return np.column_stack([parse_toml(whole)["curves"]["suspension_damping"][name] for name in CALLERS[caller]])
    whole, _ = with_contents('[controllers.I]\nfamily = "table.csv"\n', folder)
    return np.array([[member[name] for name in CALLERS[caller]] for member in parse_toml(whole)["controllers"]["I"]["family"]])


@pytest.mark.parametrize("caller", in_the_suite(("rig", "family"), CALLERS))
def test_every_dialect_is_the_same_table(caller, tmp_path):
    """Separators, decimal commas, quotes, comments, line ends, a BOM, units beside or below names: the same floats, every bit."""
    scales = [IN_SI[UNITS.get(name, "")] for name in CALLERS[caller]]
    expected, seen = NUMBERS[:, : len(scales)] * scales, 0
    for mark, decimal, quotes, comments, units, (bom, end) in itertools.product(
        SEPARATORS.values(), ".,", ("", '"'), (False, True), ("beside", "below"), ENDS.values()
    ):
        if decimal == "," and mark.strip() == "," and not quotes:
            continue  # 0,25,3,0: nobody can tell
        text = bom + end.join(written(caller, mark, decimal, quotes, comments, units)) + end
        np.testing.assert_array_equal(read(caller, text, tmp_path), expected, err_msg=repr(text))
        seen += 1
    assert seen == 264


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time [s];heave [N]\n0;1\n1;2,5,3\n", "line 3, column 2: '2,5,3' is no finite number; give"),
        ("time [s];heave [N]\n0;1\n1;1.234,5\n", f"{BOTH}: line 3 has '1.234,5'; write 1234,5"),
        ("time [s]\theave [N]\n0\t1\n1\t1,300.0\n", f"{BOTH}: line 3 has '1,300.0'; write 1300.0"),
        ("time [s] heave [N]\n1.300,0 1\n1400 2\n", f"{BOTH}: line 2 has '1.300,0'; write 1300,0"),
        ('time [s],heave [N]\n"0,5","-1.350"\n', f"{BOTH}: line 2 has '0,5', and line 2 has '-1.350'; write -1350 or -1,35"),
        ("time [s];heave [N]\n0;1.250\n1;2,5\n", f"{BOTH}: line 3 has '2,5', and line 2 has '1.250'; write 1250 or 1,25"),
        ("time [s];heave [N]\nx;1\n1;2\n", "line 2, column 1: 'x' is no number; give"),
        ("survey\ntime [s],heave [N],pitch [N m]\n0,1\n1,2\n", "no line above line 3 names its 2 column(s); give"),
        ("0,1\n1,2\n", "no line above line 1 names its 2 column(s)"),
        ("time,heave\ns,furlong\n0,1\n1,2\n", "line 2, column 2: 'furlong' is no number"),
        ("time [s],heave [N]\nms,N\n0,1\n1,2\n", "the headings 'time [s]' and 'ms' of column 1 contradict each other"),
        ("time [s],heave [N]\n0,1\n1\n", "line 3 has 1 column(s), and line 2 has 2"),
    ],
)
def test_wrong_tables(text, said):
    """A message names the line and the column, what was found there and what is allowed."""
    with pytest.raises(InputError) as error:
        parse_history(text, "push.csv")
    assert str(error.value).startswith("load file push.csv: ")
    assert said in str(error.value)


@pytest.mark.parametrize("caller", CALLERS)
def test_one_decimal_mark(caller, tmp_path):
    """A dot beside decimal commas may separate thousands: every caller refuses it, wherever it stands."""
    text = "\n".join(written(caller, ";", ",", "", False, "beside")).replace("12,5", "1.250")
    with pytest.raises(InputError, match=f"{BOTH}: line . has '[0-9],[0-9]+', and line . has '1.250'; write 1250 or 1,25$"):
        read(caller, text, tmp_path)


def test_long_lines():
    """Endless lines above the numbers take no time that grows with their square."""
    for line in ("[" * 10**5, " " * 10**5 + "x", "a " * 10**5, '"' * 10**5, "x (" * 10**5, ";" * 10**5):
        table = find_table(f"a b\n{line}\n1 2\n3 4\n", "give numbers")
        assert table.numbers()[0].tolist() == [[1.0, 2.0], [3.0, 4.0]]
        assert len(table.above) >= 1
        assert [heading.name for heading in table.headings(LENGTH)][:1] == ["a"]
