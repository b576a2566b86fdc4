"""Tables in text files: roads, rigs, curves, loads and families are read by one reader, in every dialect alike."""

import itertools

import numpy as np
import pytest

from models.common.files import parse_toml
from models.roads.choice import choose_road
from models.roads.loads.choice import parse_history
from models.roads.rig import Rig
from models.vehicle.in_place import with_contents
from tests.support.commands import in_the_suite, refused

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


def read(caller: str, text: str, folder, settings: str = "") -> np.ndarray:
    """Returns what a caller makes of it, in SI units, as columns."""
    (folder / "table.csv").write_bytes(text.encode())
    if caller == "road":
        profile = choose_road(f"table.csv{settings}", folder).profile
        assert profile is not None
        return np.column_stack([profile.distance, profile.heights])
    if caller == "rig":
        rig = choose_road("rig:file=table.csv", folder).road
        assert isinstance(rig, Rig)
        return np.column_stack([rig.time, rig.heights])
    if caller == "load":
        load = parse_history(text.lstrip("\ufeff"), "table.csv")
        return np.column_stack([load.time, *load.columns.values()])
    if caller == "curve":
        whole, _ = with_contents('[curves]\nsuspension_damping = { file = "table.csv" }\n', folder)
        return np.column_stack([parse_toml(whole)["curves"]["suspension_damping"][name] for name in CALLERS[caller]])
    whole, _ = with_contents('[controllers.I]\nfamily = "table.csv"\n', folder)
    return np.array([[member[name] for name in CALLERS[caller]] for member in parse_toml(whole)["controllers"]["I"]["family"]])


@pytest.mark.parametrize("caller", in_the_suite(("rig",), CALLERS))
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


WRONG = [  # the text of a file of a load, what the message says
    ("time [s];heave [N]\n0;1\n1;2,5,3\n", "line 3, column 2: '2,5,3' is not a finite number; give"),
    ("time [s];heave [N]\n0;1\n1;1.234,5\n", "numbers contain both a comma and a dot: line 3 has '1.234,5'; write"),
    ("time [s] heave [N]\n1.300,0 1\n1400 2\n", "line 2, column 2: '0 1' is not a finite number"),
    ('time [s],heave [N]\n"0,5","-1.350"\n', "line 2 has '0,5' and line 2 has '-1.350'; write"),
    ("time [s];heave [N]\n0;1.250\n1;2,5\n", "line 2 has '1.250' and line 3 has '2,5'; write"),
    ("time [s];heave [N]\nx;1\n1;2\n", "the heading of column 2 is '1', not a name; above the numbers, put # before each line"),
    (
        "survey\ntime [s],heave [N],pitch [N m]\n0,1\n1,2\n",
        "the numbers begin at line 3, but no line above them has one heading for each of the 2 column(s); give",
    ),
    ("0,1\n1,2\n", "the numbers begin at line 1, but no line above them has one heading for each of the 2 col"),
    ("time,heave\ns,furlong\n0,1\n1,2\n", "column 1 is called 's', which is not one of heave"),
    ("time [s],heave [N]\nms,N\n0,1\n1,2\n", "the headings 'time [s]' and 'ms' of column 1 contradict each other"),
    (f"time [s],heave [N]\n0,1\n1,{'1' * 140_000}\n", "is not a finite number; give"),
    ("time [s],heave [N]\n0,1\n1,nan\n", "line 3, column 2: 'nan' is not a finite number"),
    ("time [s],heave [N]\n# nothing\n", "no line of numbers; give"),
    ("time [s],heave [N]\n0,1\n1\n", "line 3 has 1 column(s), but line 2 has 2"),
    ("", "is empty", "time [s]"),
    ("time [s], pitch [N m], heave [N]\n5, 0, 1\n6, 0, 1\n", "begins at 5 s, but heave is not 0", "begin the file at 0 s"),
    ("time, pitch\n0, 0\n1, 1\n", "column 1, 'time', has no unit (allowed: ms, s); change the heading to time [s]"),
    ("time [s], pitch [N]\n0, 0\n1, 1\n", "column 2, 'pitch [N]', has the unit 'N' (allowed: N m, kN m"),
    (
        "time [s], yaw [N m]\n0, 0\n1, 1\n",
        "is called 'yaw [N m]', which is not one of heave (positive: up), pitch (positive: nose down)",
    ),
    ("time [s], pitch [N m], pitch [N m]\n0, 0, 0\n1, 1, 1\n", "two columns are called 'pitch'; remove or rename one"),
    ("pitch [N m], roll [N m]\n0, 0\n1, 1\n", "only the columns pitch, roll"),
    ("time [s], pitch [N m]\n0, 0\n2, 1\n1, 1\n", "line 4", "time 1 s is not after", "sort"),
    ("time [s], pitch [N m]\n" + "".join(f"{i}, 1\n" for i in range(20_001)), "20001 row(s)", "to 20000"),
]


@pytest.mark.parametrize("row", WRONG, ids=[row[1][:40] for row in WRONG])
def test_wrong_tables(row):
    """A message names the line and the column, what was found there and what is allowed."""
    with refused("load file push.csv: ", *row[1:]):
        parse_history(row[0], "push.csv")


@pytest.mark.parametrize("caller", CALLERS)
def test_one_decimal_mark(caller, tmp_path):
    """Every caller refuses decimal commas together with dots, which may separate thousands."""
    text = "\n".join(written(caller, ";", ",", "", False, "beside")).replace("12,5", "1.250")
    with refused("numbers contain both a comma and a dot: line", "and line"):
        read(caller, text, tmp_path)


TEXTS = {  # in the formats of public files and tools
    "generator": "Time (s);X (m);Y (m)\n0,0;0,0;-0,03\n0,005;0,083;-5,7e-06\n",
    "map": "X,Y,Distance (feet),Ground Elevation (feet)\n-130.78,403.47,0,1920.57\n-130.76,403.62,10,1921.57\n",
    "alignment": "0 100.23\n15 104.25 40.0\n30 102.5\n",
    "survey": "TBC Excel - Station,Offset,Elevation,Code\n20,-8.5,59.5,TIEL\n20.5,-3.5,62.75,CL\n",
    "lines in headings": '"Distance\n[m]";"Left\n[mm]";"Right\n[mm]"\r\n0;1,5;2\r\n0,25;3;-1,5\r\n;;\r\n',
    "MATLAB": "% MATLAB\n% distance [m]\televation [mm]\n0\t0\n0.5\t12\n",
    "remarks": "Distance\tElevation\tRemark\nm\tmm\t\n0\t0\t\n0.5\t12\tmanhole\n",
    "spreadsheet": "Date;01.02.2020\nBy;J. D.\n\nchainage / m;right / mm;left / mm;;\n0,00;1,5;2,5;;\n0,25;-1;3;;\n;;;;\n",
    "damper dyno": "Velocity [mm/sec];Force [N]\n-100;-350,5\n0;0\n250,5;900\n",
    "damper in tabs": "# TTX\nforce\tvelocity\nN\tmm/s\n-350\t-127\n400\t127\n\t\n",
    "rig": "Channels:\nTime\tFront\tRear\nsec\tmm\tmm\n0\t0\t2\n0.01\t1\t2\n0.02\t2\t2\n0.03\t3\t2\n",
}
FOOT = 0.3048
FIELD = [  # (name of the text, caller, settings, numbers in SI)
    ("generator", "road", ":columns=2,3", [[0, -0.03, -0.03], [0.083, -5.7e-6, -5.7e-6]]),
    ("map", "road", ":columns=3,4", [[0, 1920.57 * FOOT, 1920.57 * FOOT], [10 * FOOT, 1921.57 * FOOT, 1921.57 * FOOT]]),
    ("alignment", "road", ":columns=1,2", [[0, 100.23, 100.23], [15, 104.25, 104.25], [30, 102.5, 102.5]]),
    ("survey", "road", ":columns=1,3", [[20, 59.5, 59.5], [20.5, 62.75, 62.75]]),
    ("lines in headings", "road", "", [[0, 0.0015, 0.002], [0.25, 0.003, -0.0015]]),
    ("MATLAB", "road", "", [[0, 0, 0], [0.5, 0.012, 0.012]]),
    ("remarks", "road", "", [[0, 0, 0], [0.5, 0.012, 0.012]]),
    ("spreadsheet", "road", "", [[0, 0.0025, 0.0015], [0.25, 0.003, -0.001]]),
    ("damper dyno", "curve", "", [[-0.1, -350.5], [0, 0], [0.2505, 900]]),
    ("damper in tabs", "curve", "", [[-0.127, -350], [0.127, 400]]),
    ("rig", "rig", "", [[0, 0, 0.002], [0.01, 0.001, 0.002], [0.02, 0.002, 0.002], [0.03, 0.003, 0.002]]),
]


@pytest.mark.parametrize(("name", "caller", "settings", "numbers"), FIELD)
def test_files_of_other_tools(name, caller, settings, numbers, tmp_path):
    """Tables as road generators, maps, surveys, spreadsheets, MATLAB, damper and rig software write them are read bit for bit."""
    np.testing.assert_array_equal(read(caller, TEXTS[name], tmp_path, settings), numbers)
