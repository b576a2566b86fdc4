"""Laws in MATLAB files: read exactly, written into everything that is recorded, and refused in one line if something is wrong."""

import io
import json
import re

import numpy as np
import pytest
from scipy.io import savemat
from scipy.sparse import csc_array

from models.common.errors import InputError
from models.laws.linear import LinearLaw
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.bump import main as bump
from sim.campaign.__main__ import main as campaign
from sim.inspect.__main__ import main as inspect
from synth.__main__ import main as synth
from tests.support.commands import refused

A, B, C, D = (
    np.array([[-3.0, 1.0], [0.0, -40.0]]),
    np.array([[0.0, 1.0], [2.0, 0.1]]),
    np.array([[30.0, 1 / 3]]),
    np.zeros((1, 2)),
)
LAW = {"A": A, "B": B, "C": C, "D": D}
RECORD = {name: value.tolist() for name, value in LAW.items()}
MEASURED = 'measured = ["suspension_deflection", "sprung_velocity"]'
CELLS = np.array([1, "a"], dtype=object)


def mat(variables, **how) -> bytes:
    """Returns a MATLAB file of these variables."""
    stream = io.BytesIO()
    savemat(stream, variables, **how)
    return stream.getvalue()


def vehicle_with(folder, content: bytes, more: str = ""):
    """Writes a law's file and a vehicle file that names it, whose path is returned."""
    (folder / "mine.mat").write_bytes(content)
    text = read_vehicle("quarter_car").text
    (folder / "car.toml").write_text(f'{text}\n[controllers.mine]\n{MEASURED}\nfile = "mine.mat"  # of MATLAB\n{more}')
    return folder / "car.toml"


def law_in(folder, content: bytes, more: str = "") -> LinearLaw:
    """Returns the law that a vehicle with this file has."""
    law = read_vehicle(vehicle_with(folder, content, more)).controllers["mine"].law
    assert law is not None
    return law


@pytest.mark.parametrize("how", [{}, {"do_compression": True}, {"format": "4"}], ids=["5", "7", "4"])
def test_a_law_is_read_to_the_last_bit(tmp_path, how):
    """A, B, C, D are read exactly from every version of file, separate or in a struct, whatever else is in the file."""
    rng = np.random.default_rng(3)
    law = {name: rng.standard_normal(each.shape) * 10.0 ** rng.uniform(-9, 9, each.shape) for name, each in LAW.items()}
    others = {"note": "of today", "data": rng.standard_normal((300, 40))}
    assert law_in(tmp_path, mat(LAW | {"A": csc_array((2, 2))}, **how)).record == RECORD | {"A": [[0.0, 0.0], [0.0, 0.0]]}
    for variables in [law, *([] if how.get("format") == "4" else [{"any": law, "c": CELLS, "f": {"x": "y"}}])]:
        found = law_in(tmp_path, mat(variables | others, **how))
        for name, each in law.items():
            np.testing.assert_array_equal(getattr(found, name), each)


@pytest.mark.parametrize(
    "variables",
    [
        {"K": [[7.0, 8.0]]},
        {"D": [[7.0, 8.0]]},
        {"K": csc_array([[7.0, 8.0]])},
        {"K": np.array([[7 + 0j, 8]])},
        {"s": {"K": np.array([[7, 8]], dtype="int16")}},
        {"A": np.zeros((0, 0)), "B": np.zeros((0, 2)), "C": np.zeros((1, 0)), "D": np.array([[7.0, 8.0]])},
    ],
)
def test_a_gain_of_any_type(tmp_path, variables):
    """K or D alone is a static gain, of any type of numbers, and so is a law whose A is empty, as MATLAB writes it."""
    assert law_in(tmp_path, mat(variables)).record == {"gain": [[7.0, 8.0]]}


def test_a_sample_period_comes_with_it(tmp_path):
    """Ts is the law's sample period, 0 for a continuous law. The vehicle file may give it if the MATLAB file does not."""
    slow = "sample_period = 0.004\n[implementation]\nsample_period = 0.004\n"
    for variables, more, period in (
        (LAW | {"Ts": 0.0}, "", None),
        (LAW | {"Ts": 0.004}, slow.partition("\n")[2], 0.004),
        (LAW, slow, 0.004),
        (LAW | {"Ts": 0.004}, slow, 0.004),
    ):
        assert law_in(tmp_path, mat(variables), more).sample_period == period
    with pytest.raises(
        InputError, match=r"the law in the file has a sample period of 0.002 s, but the section has sample_period = 0.004; omit"
    ):
        law_in(tmp_path, mat(LAW | {"Ts": 0.002}), slow)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"E": np.array([[2.0, 0.0], [0.0, 1.0]])}, "E is not the identity"),
        ({"InputDelay": np.array([[0.0, 0.1]])}, "InputDelay is above 0, but a law in a file cannot have a delay"),
        ({"OutputDelay": 0.1, "IODelay": np.array([[0.1, 0.0]])}, "OutputDelay, IODelay is above 0"),
        ({"TimeUnit": "minutes"}, "TimeUnit is 'minutes' instead of seconds; in MATLAB"),
        ({"A": "ab"}, "A is text"),
    ],
)
def test_other_fields_of_a_system(tmp_path, more, said):
    """Fields of a struct made by get(sys) that would change the law are refused; the others are allowed."""
    nothing = {"E": np.zeros((0, 0)), "InputDelay": np.zeros((2, 1)), "OutputDelay": 0.0, "TimeUnit": "seconds", "Name": "mine"}
    for usual in (nothing, {"E": np.eye(2), "TimeUnit": ""}):
        assert law_in(tmp_path, mat({"s": LAW | usual})).record == RECORD
    with pytest.raises(InputError, match=said):
        law_in(tmp_path, mat({"s": LAW | nothing | more}))


def test_what_is_recorded_is_whole(tmp_path, capsys):
    """Logs, saved files and JSON have the matrices, with a comment that names the source, and do not need the file again."""
    file = vehicle_with(tmp_path, mat(LAW))
    vehicle = read_vehicle(file)
    assert "file =" not in vehicle.text
    assert re.search(r"# from 'mine.mat', \d+ bytes, SHA-256 [0-9a-f]{64}\nA = .*  # of MATLAB\nB = ", vehicle.text)
    assert tmp_path / "mine.mat" in vehicle.files
    with pytest.raises(InputError, match="is an input file"):
        synth(["--vehicle", str(file), "--controller", "I", "--save", str(tmp_path / "mine.mat")])
    options = ["--vehicle", str(file), "--controller", "mine"]
    assert bump([*options, "--duration", "0.2", "--logs", str(tmp_path), "-v"]) == 0
    (tmp_path / "other").mkdir()
    capsys.readouterr()
    assert synth([*options, "--controller", "I", "--save", str(tmp_path / "other" / "car.toml"), "--json"]) == 0
    row = json.loads(capsys.readouterr().out)["controllers"][0]
    (tmp_path / "mine.mat").unlink()
    saved = read_vehicle(tmp_path / "other" / "car.toml")
    for again in (parse_vehicle(vehicle.text), saved):
        law = again.controllers["mine"].law
        assert law is not None
        assert law.record == {name: row[name] for name in LAW} == RECORD
    (log,) = tmp_path.glob("*.mcap")
    assert inspect([str(log)]) == 0, capsys.readouterr().out


def test_only_a_vehicle_file_names_files(tmp_path, monkeypatch):
    """For a text from elsewhere, such as from a log, no file is opened."""
    file = vehicle_with(tmp_path, mat(LAW))
    monkeypatch.chdir(tmp_path)
    for folder in (None, tmp_path):
        with pytest.raises(
            InputError, match="the key file refers to a file next to the vehicle file, but this vehicle is read from text"
        ):
            parse_vehicle(file.read_text(), folder=folder)


def test_names_of_text_books(tmp_path):
    """Ak, Bk, Ck, Dk are A, B, C, D; num and den have the frequency response of their ratio, a constant of its number."""
    assert law_in(tmp_path, mat({f"{name}k": value for name, value in LAW.items()})).record == RECORD
    num, den, s = np.array([2.0, 3.0, 5.0]), np.array([4.0, 1.0, 6.0]), 1.7j
    for numerator, denominator in ((num, den), (num[1:], den), (num[2:] * 3, den[1:])):
        file = vehicle_with(tmp_path, mat({"num": numerator, "den": denominator}))
        file.write_text(
            file.read_text().replace(f"[controllers.mine]\n{MEASURED}", '[controllers.mine]\nmeasured = ["sprung_velocity"]')
        )
        law = read_vehicle(file).controllers["mine"].law
        assert law is not None
        A, B, C, D = (np.array(law.record[name]) for name in "ABCD")
        response = (C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D).item()
        assert response == pytest.approx(np.polyval(numerator, s) / np.polyval(denominator, s), rel=1e-12)


@pytest.mark.parametrize(
    ("variables", "said"),
    [
        (LAW | {"Ak": A}, "the file has both Ak and A; keep only one of the two"),
        ({"num": 1.0}, "has a transfer function without den; give only num and den"),
        ({"num": np.ones(3), "den": np.ones(2)}, "num has 3 coefficients, but den has only 2"),
        ({"A": A}, "B, C, D is missing in the file"),
        (LAW | {"K": 1.0}, "the file has both K and A, B, C, D; keep"),
        ({"one": LAW, "two": LAW}, "contains several controllers, in the struct one and the struct two"),
        ({"x": 1.0}, "contains x, but neither K nor the matrices A, B, C and D;"),
        ({}, "contains nothing, but neither K nor the matrices A, B, C and D;"),
        (LAW | {"A": 1j * A}, "A has complex entries"),
        (LAW | {"B": B * np.nan}, "B has an entry that is not finite"),
        (LAW | {"A": "text"}, "A is text"),
        (LAW | {"A": CELLS}, "A is a cell array"),
        ({"K": np.ones((2, 2, 2))}, "K has shape (2, 2, 2); expected a matrix"),
        (LAW | {"B": B.T[:1]}, "give 2 row(s) of 2 number(s), because A has 2 row(s)"),
        (LAW | {"A": -np.eye(201), "B": np.ones((201, 2)), "C": np.ones((1, 201))}, "a controller with 201 states is too large"),
        (LAW | {"A": 1e300 * A}, "A has an entry with a magnitude above 1e+15; use units"),
        (LAW | {"Ts": -1.0}, "Ts = [[-1.0]] is not a sample period"),
        (LAW | {"Ts": 0.1, "sample_period": 0.2}, "two different sample periods"),
    ],
)
def test_a_file_without_a_controller(tmp_path, variables, said):
    """A file that does not contain exactly one controller is refused in one line with the reason."""
    with refused("[controllers.mine]", said):
        law_in(tmp_path, mat(variables))


# K = ss(...), saved by MATLAB: a header, and an element that is an object of the class ss.
OBJECT = b"\6\0\0\0\x08\0\0\0\x11\0\0\0\0\0\0\0\1\0\1\0K\0\0\0\1\0\4\0MCOS\1\0\2\0ss\0\0"
OBJECT += b"\x0e\0\0\0\x28\0\0\0\6\0\0\0\x08\0\0\0\x0d\0\0\0\0\0\0\0\5\0\0\0\x08\0\0\0\1\0\0\0\1\0\0\0\1\0\0\0\0\0\0\0"
OBJECT = OBJECT[:-8] + b"\1\0\0\0\0\0\0\0" + b"\6\0\4\0\1\0\0\0"
HEADER = b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (
            HEADER + b"\x0e\0\0\0" + len(OBJECT).to_bytes(4, "little") + OBJECT,
            "K is a MATLAB object of class ss, which only MATLAB can read; for",
        ),
        (
            b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM" + bytes(500),
            "the file has MATLAB version 7.3 (HDF5), which cannot be read; save the file",
        ),
        (b"# Created by Octave 9.2\n# name: K\n# type: matrix\n", "this is not a MATLAB file, or it is damaged ("),
        (b"", "this is not a MATLAB file, or it is damaged ("),
        (mat(LAW)[:-100], "this is not a MATLAB file, or it is damaged ("),
        (mat(LAW, do_compression=True)[:-60], "this is not a MATLAB file, or it is damaged ("),
    ],
    ids=["object", "7.3", "text", "empty", "cut", "cut, compressed"],
)
def test_a_file_that_cannot_be_read(tmp_path, content, said):
    """Objects, files of version 7.3, of other programs and incomplete ones are refused with the call that writes one."""
    with pytest.raises(InputError, match=f"{re.escape(said)}.*'-v7'"):
        law_in(tmp_path, content)


@pytest.mark.parametrize(
    ("file", "said"),
    [
        ('"other.mat"', "there is no such file"),
        ("3", "is not the name of a file"),
        ('"mine.mat"\ngain = [[1.0, 2.0]]', "has both file and gain"),
    ],
)
def test_a_file_that_is_not_there(tmp_path, file, said):
    """A missing file, another value than a name, and a second law are refused."""
    vehicle = vehicle_with(tmp_path, mat(LAW))
    vehicle.write_text(vehicle.read_text().replace('"mine.mat"  # of MATLAB', file))
    with pytest.raises(InputError, match=said):
        read_vehicle(vehicle)


def test_a_campaign_is_of_the_matrices(tmp_path, monkeypatch, capsys):
    """A campaign drives a law from a file like any other; with other matrices in the file it is another campaign."""
    vehicle_with(tmp_path, mat(LAW))
    monkeypatch.chdir(tmp_path)
    text = 'vehicles = ["car.toml"]\ncontrollers = ["mine"]\nroads = ["iso8608:class=A"]\nspeeds = [10.0]\nseeds = 1\n'
    (tmp_path / "many.toml").write_text(f"{text}duration = 1.0\ntimestep = 2e-3\n")
    line = ["many.toml", "--results", "found", "--workers", "1", "--json"]
    assert campaign(line) == 0
    assert campaign(line) == 0  # resumed, with the law that the folder contains
    assert campaign(["--verify", "found"]) == 0
    (tmp_path / "mine.mat").write_bytes(mat(LAW | {"C": 1.01 * C}))
    with pytest.raises(InputError, match="another campaign"):
        campaign(line)
