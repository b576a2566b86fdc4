"""Measured logs: one reader for every dialect, units from headings, gaps that stay gaps, and bad files in one line."""

import numpy as np
import pytest
from scipy.io import savemat

from models.common.logs.measured_log import read_measured_log
from tests.support.commands import refused

UNITS = {"sprung_acceleration": "m/s2", "suspension_deflection_front_left": "m", "control_force": "N", "damping": "N s/m"}
TIME = np.arange(8) / 250
RISE = np.sin(np.arange(8))  # m/s2
TRAVEL = np.cos(np.arange(8)) * 1e-2  # m
LABVIEW = """LabVIEW Measurement\t
Separator\tTab
Decimal_Separator\t,
X_Columns\t{columns}
Time\t09:51:39,1970510124996275989
***End_of_Header***\t
\t
Channels\t2\t\t
Y_Unit_Label\t{units}
X_Dimension\tTime\t{gap}Time
X0\t0,0\t{gap}0,0
Delta_X\t{step}\t{gap}{step}
***End_of_Header***\t\t\t
X_Value\tSprung Acceleration{clock}\tFL suspension_deflection\tComment
"""


def rows(mark: str, decimal: str, *columns) -> str:
    """Returns columns of numbers as text."""
    return "".join(
        mark.join(repr(float(cell)).replace(".", decimal) for cell in row) + "\n" for row in zip(*columns, strict=True)
    )


def labview(columns: str) -> str:
    """Returns a LabVIEW file with the three kinds of time, in two segments, with a comment."""
    multi = columns == "Multi"
    head = LABVIEW.format(
        columns=columns,
        units="g\t\tmm" if multi else "g\tmm",
        gap="\t" * multi,
        step="4,0E-3",
        clock="\tX_Value" * multi,
    )
    used = {"One": (TIME, RISE / 9.80665, TRAVEL * 1e3), "Multi": (TIME, RISE / 9.80665, TIME, TRAVEL * 1e3)}
    lines = rows("\t", ",", *used.get(columns, used["One"][1:])).splitlines()
    lines = [f"\t{line}" if columns == "No" else line for line in lines]
    again = head[head.index("Channels") :] if columns != "Multi" else ""
    return (
        head + lines[0] + "\tAcquired by C:\\rig.vi; 1\n" + "\n".join(lines[1:5]) + "\n\n" + again + "\n".join(lines[5:]) + "\n"
    )


LOGS: dict[str, str | bytes] = {
    "german.csv": (
        "Prüfstand 3\nZeit [ms]; Sprung Acceleration (m/s²); Temp [°C]; FL Suspension-Deflection / mm\n"
        + rows(";", ",", TIME * 1e3, RISE, TIME, TRAVEL * 1e3)
    ).encode("cp1252"),
    "units_below.csv": "\ufefftime,SprungAcceleration,suspension_deflection_front_left\ns,g,mm\n"
    + rows(",", ".", TIME, RISE / 9.80665, TRAVEL * 1e3),
    "stamps.csv": "Timestamp;sprung_acceleration [mps2];front_left_suspension_deflection_cm\n"
    + "".join(f"2024-05-01 23:59:59.{4 * i:03d};{a};{d * 100}\n" for i, (a, d) in enumerate(zip(RISE, TRAVEL, strict=True))),
    "one.lvm": labview("One"),
    "no.lvm": labview("No"),
    "multi.lvm": labview("Multi"),
    "plain.lvm": "X_Value\tsprung_acceleration (g)\tsuspension_deflection_fl (mm)\n"
    + rows("\t", ".", TIME, RISE / 9.80665, TRAVEL * 1e3),
}


@pytest.mark.parametrize("name", [*LOGS, "log.mat"])
def test_every_dialect_is_the_same_log(name, tmp_path):
    """Separators, decimal marks, encodings, units beside and below names, LabVIEW and MATLAB: the same signals in SI units."""
    path = tmp_path / name
    if name == "log.mat":
        savemat(path, {"t_s": TIME, "sprungAcceleration_g": RISE / 9.80665, "suspension_deflection_fl_mm": TRAVEL * 1e3})
    else:
        content = LOGS[name]
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    log = read_measured_log(path, UNITS)
    np.testing.assert_allclose(log.time, TIME, atol=1e-12)
    np.testing.assert_allclose(log.signals["sprung_acceleration"], RISE, atol=1e-12)
    np.testing.assert_allclose(log.signals["suspension_deflection_front_left"], TRAVEL, atol=1e-12)
    assert [*log.signals] == ["sprung_acceleration", "suspension_deflection_front_left"]
    assert len(log.remarks) == (name in ("german.csv", "plain.lvm")), "on a column that is left out, and on times without a unit"


def test_gaps_stay_gaps(tmp_path):
    """Missing cells and missing rows are not filled, samples need not be even, and nothing is known outside the log."""
    path = tmp_path / "gaps.csv"
    cells = ["1", "2", "", "4", "NaN", "6", "#N/A", "8", "9", "10"]
    times = [0, 1.1, 1.9, 3, 4, 5, 6, 7, 8, 20]
    path.write_text("t [s],b,sprung_acceleration [m/s2]\n" + "".join(f"{t},x,{c}\n" for t, c in zip(times, cells, strict=True)))
    log = read_measured_log(path, UNITS)
    asked = np.array([-0.1, 0, 0.55, 1.5, 3, 3.5, 5, 7.5, 8, 14, 20, 20.1])
    expected = [np.nan, 1, 1.5, np.nan, 4, np.nan, 6, 8.5, 9, np.nan, 10, np.nan]
    np.testing.assert_allclose(log.at("sprung_acceleration", asked), expected)


def test_columns_with_other_names_and_a_sample_rate(tmp_path):
    """A heading is given for a signal, in any case, with a unit if the file has none; times follow from a rate."""
    path = tmp_path / "log.csv"
    for unit, heading in ((" [g]", "acc body (front)"), (" [g]", "ACC body (front) [g]"), ("", "ACC body (front) [g]")):
        path.write_text(f"ACC body (front){unit};travel\n1;2\n3;4\n5;6\n")
        log = read_measured_log(path, UNITS, rate=200.0, columns={"sprung_acceleration": heading})
        np.testing.assert_allclose(log.signals["sprung_acceleration"], [9.80665, 29.41995, 49.03325])
        np.testing.assert_array_equal(log.time, [0, 0.005, 0.01])


HEAD = "time [s];sprung_acceleration [m/s2]\n"
WRONG = [  # the text of a file, settings, words of the message
    ("t [s];sprung_acc [m/s2]\n0;1\n1;2\n2;3\n", {}, ("'sprung_acc [m/s2]'", "names of signals are sprung_acceleration")),
    ("t [s];sprung_acceleration [mm]\n0;1\n1;2\n2;3\n", {}, ("column 2 (", "the signal sprung_acceleration needs m/s2",)),
    ("t [m];sprung_acceleration [m/s2]\n0;1\n1;2\n2;3\n", {}, ("no column is called time", "'t [m]'", "sample rate")),
    (HEAD + "0;1\n2;2\n1;3\n", {}, ("time falls from 2 to 1 s at line 4",)),
    (HEAD + "0;1\n1;x\n2;3\n", {}, ("line 3, column 2: 'x' is not a finite number",)),
    (HEAD + "0;1\n1;\n2;\n", {}, ("column 2 ('sprung_acceleration [m/s2]') has fewer than 3 numbers",)),
    (HEAD + "0;1\n1;2\n", {}, ("2 sample(s), but at least 3",)),
    (HEAD + "0;1\n1;2\n2;3\n", {"rate": 10.0}, ("column 1 ('time [s]') contains times, which already determine the",)),
    ("a [N];b\n0;1\n1;2\n2;3\n", {"rate": 0.0, "columns": {"control_force": "a"}}, ("0 Hz", "above 0")),
    (HEAD + "0;1\n1;2\n2;3\n", {"columns": {"control_force": "u"}}, ("no column is called 'u'", "'sprung_acceleration [m/s2]'")),
    (HEAD + "0;1\n1;2\n2;3\n", {"columns": {"force": "u"}}, ("no signal 'force'", "control_force")),
    ("t [s];Control-Force [N];control force [kN]\n0;1;1\n1;2;2\n2;3;3\n", {}, ("columns 2 (", "3 (", "all have the name of "
        "the signal control_force")),
    ("LabVIEW Measurement\n1\t2\n", {}, ("no line ***End_of_Header***",)),
    (labview("Multi").replace("Delta_X\t4,0E-3", "Delta_X\t5,0E-3"), {}, ("different X0 or Delta_X",)),
    (labview("One").replace("Dimension\tTime", "Dimension\tFrequency"), {}, ("X_Dimension is 'Frequency'",)),
    ("", {}, ("the file is empty",)),
]  # fmt: skip


@pytest.mark.parametrize(("text", "settings", "words"), WRONG, ids=range(len(WRONG)))
def test_bad_logs_are_refused_in_one_line(text, settings, words, tmp_path):
    """The message has the file, what was found, and what to do."""
    path = tmp_path / "log.csv"
    path.write_text(text)
    with refused(f"measured log {path}: ", *words):
        read_measured_log(path, UNITS, **settings)


def test_matlab_7_3_is_refused(tmp_path):
    """HDF5 is not read."""
    path = tmp_path / "new.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM" + b"\x89HDF\r\n\x1a\n")
    with refused("version 7.3", "-v7"):
        read_measured_log(path, UNITS)
