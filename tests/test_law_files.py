"""Laws in files of their own: read whole, written into what is logged, and refused in one line whatever is wrong with them."""

import io
import json
import re
import struct
import time
import zlib

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from models.common.errors import InputError
from models.vehicle.in_place import NAMES
from models.vehicle.mat_file import MOST_INSIDE, read_mat
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.bump import main as bump
from sim.campaign.__main__ import main as campaign
from sim.inspect.__main__ import main as inspect
from synth.__main__ import main as synth

A, B, C, D = (
    np.array([[-3.0, 1.0], [0.0, -40.0]]),
    np.array([[0.0, 1.0], [2.0, 0.1]]),
    np.array([[30.0, 1 / 3]]),
    np.zeros((1, 2)),
)
LAW = {"A": A, "B": B, "C": C, "D": D}
MEASURED = 'measured = ["suspension_deflection", "sprung_velocity"]'


def mat(variables, **how) -> bytes:
    """A MATLAB file of these variables."""
    stream = io.BytesIO()
    savemat(stream, variables, **how)
    return stream.getvalue()


def vehicle_with(folder, content: bytes, more: str = ""):
    """A vehicle file beside a law's file."""
    (folder / "mine.mat").write_bytes(content)
    text = read_vehicle("quarter_car").text
    (folder / "car.toml").write_text(f'{text}\n[controllers.mine]\n{MEASURED}\nfile = "mine.mat"  # of MATLAB\n{more}')
    return folder / "car.toml"


@pytest.mark.parametrize("how", [{}, {"do_compression": True}, {"format": "4"}], ids=["5", "7", "4"])
@pytest.mark.parametrize("wrapped", [False, True])
def test_a_law_is_read_to_the_last_bit(tmp_path, how, wrapped):
    """A, B, C, D come out of every version of file, loose or in a struct, as they went in, other variables beside them or not."""
    if wrapped and how.get("format") == "4":
        return  # it has no structs
    rng = np.random.default_rng(3)
    law = {name: rng.standard_normal(each.shape) * 10.0 ** rng.uniform(-9, 9, each.shape) for name, each in LAW.items()}
    others = {"note": "of today", "data": rng.standard_normal((300, 40))}
    content = mat(({"any": law} if wrapped else law) | others, **how)
    found = read_vehicle(vehicle_with(tmp_path, content)).controllers["mine"].law
    assert found is not None
    for name, each in law.items():
        np.testing.assert_array_equal(getattr(found, name), each)
        if not wrapped:
            np.testing.assert_array_equal(getattr(found, name), loadmat(io.BytesIO(content))[name])


@pytest.mark.parametrize("variables", [{"K": [[7.0, 8.0]]}, {"D": [[7.0, 8.0]]}, {"s": {"K": np.array([[7, 8]], dtype="int16")}}])
def test_a_gain_is_one(tmp_path, variables):
    """K or D alone is a static gain, and so is a law whose A is empty, as MATLAB writes it."""
    empty = {"A": np.zeros((0, 0)), "B": np.zeros((0, 2)), "C": np.zeros((1, 0)), "D": np.array([[7.0, 8.0]])}
    for each in (variables, empty):
        law = read_vehicle(vehicle_with(tmp_path, mat(each))).controllers["mine"].law
        assert law is not None
        assert law.record == {"gain": [[7.0, 8.0]]}


def test_a_sample_period_comes_with_it(tmp_path):
    """Ts is the law's sample period, 0 says that it is continuous; one beside the file stands in for one that is not there."""
    slow = "sample_period = 0.004\n[implementation]\nsample_period = 0.004\n"
    for variables, more, period in (
        (LAW | {"Ts": 0.0}, "", None),
        (LAW | {"Ts": 0.004}, slow.partition("\n")[2], 0.004),
        (LAW, slow, 0.004),
        (LAW | {"Ts": 0.004}, slow, 0.004),
    ):
        law = read_vehicle(vehicle_with(tmp_path, mat(variables), more)).controllers["mine"].law
        assert law is not None
        assert law.sample_period == period
    with pytest.raises(InputError, match=r"has a sample period of 0.002 s, and sample_period = 0.004 is another"):
        read_vehicle(vehicle_with(tmp_path, mat(LAW | {"Ts": 0.002}), slow))


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"E": np.array([[2.0, 0.0], [0.0, 1.0]])}, "has an E that is not the identity"),
        ({"InputDelay": np.array([[0.0, 0.1]])}, "has InputDelay above 0, and a law has no delay"),
        ({"OutputDelay": 0.1, "IODelay": np.array([[0.1, 0.0]])}, "has OutputDelay, IODelay above 0"),
        ({"TimeUnit": "minutes"}, "TimeUnit is 'minutes'; give seconds"),
    ],
)
@pytest.mark.parametrize("compressed", [False, True])
def test_a_struct_of_a_system_says_more_than_its_matrices(tmp_path, more, said, compressed):
    """Fields of get(sys) beside A, B, C and D are read too: what changes the law is refused, what says nothing is not."""
    nothing = {"E": np.zeros((0, 0)), "InputDelay": np.zeros((2, 1)), "OutputDelay": 0.0, "TimeUnit": "seconds", "Name": "mine"}
    law = read_vehicle(vehicle_with(tmp_path, mat({"s": LAW | nothing}, do_compression=compressed))).controllers["mine"].law
    assert law is not None
    assert law.record == {name: value.tolist() for name, value in LAW.items()}
    read_vehicle(vehicle_with(tmp_path, mat({"s": LAW | {"E": np.eye(len(LAW["A"]))}})))
    with pytest.raises(InputError, match=said):
        read_vehicle(vehicle_with(tmp_path, mat({"s": LAW | nothing | more}, do_compression=compressed)))
    with pytest.raises(InputError, match="a struct whose A is text"):
        read_vehicle(vehicle_with(tmp_path, mat({"s": LAW | {"A": "ab"}}, do_compression=compressed)))


def test_what_is_recorded_is_whole(tmp_path, capsys):
    """The text that goes into logs has the matrices and says where they are from; the log proves itself when the file is gone."""
    file = vehicle_with(tmp_path, mat(LAW))
    vehicle = read_vehicle(file)
    assert "file =" not in vehicle.text
    assert re.search(r"# from 'mine.mat', \d+ bytes, SHA-256 [0-9a-f]{64}\n", vehicle.text)
    again = parse_vehicle(vehicle.text).controllers["mine"].law
    assert again is not None
    assert again.record == {name: value.tolist() for name, value in LAW.items()}
    assert tmp_path / "mine.mat" in vehicle.files  # and no option may write there
    assert bump(["--vehicle", str(file), "--controller", "mine", "--duration", "0.2", "--logs", str(tmp_path), "-v"]) == 0
    (tmp_path / "mine.mat").unlink()
    (log,) = tmp_path.glob("*.mcap")
    capsys.readouterr()
    assert inspect([str(log)]) == 0, capsys.readouterr().out


def test_only_a_vehicle_file_names_files(tmp_path, monkeypatch):
    """Text from elsewhere, as from a log, has no file opened for it, whatever lies in the folder."""
    file = vehicle_with(tmp_path, mat(LAW))
    monkeypatch.chdir(tmp_path)
    for folder in (None, tmp_path):
        with pytest.raises(InputError, match="its file is read beside a vehicle file, and this is text from elsewhere"):
            parse_vehicle(file.read_text(), folder=folder)


def test_the_file_is_not_overwritten(tmp_path):
    """A command that would write over a law refuses before it works."""
    file = vehicle_with(tmp_path, mat(LAW))
    with pytest.raises(InputError, match="is an input file"):
        synth(["--vehicle", str(file), "--controller", "I", "--save", str(tmp_path / "mine.mat")])


def test_what_is_saved_is_whole(tmp_path, capsys):
    """A vehicle file that --save writes elsewhere has the matrices of the laws that it was read with."""
    other = tmp_path / "other"
    other.mkdir()
    file = vehicle_with(tmp_path, mat(LAW))
    assert synth(["--vehicle", str(file), "--controller", "I", "--save", str(other / "car.toml"), "--json"]) == 0
    law = read_vehicle(other / "car.toml").controllers["mine"].law
    assert law is not None
    np.testing.assert_array_equal(law.A, A)


@pytest.mark.parametrize(
    ("variables", "said"),
    [
        ({"A": A}, "B, C, D is missing in the file"),
        (LAW | {"K": 1.0}, "the file has K beside A, B, C, D; keep"),
        ({"one": LAW, "two": LAW}, "holds more than one controller, in the struct one and the struct two"),
        ({"x": 1.0}, "holds no A, B, C, D, and no K; it has x, numbers:"),
        (LAW | {"A": 1j * A}, "A has complex entries"),
        (LAW | {"B": B * np.nan}, "B has an entry that is not finite"),
        (LAW | {"A": "text"}, "A is text"),
        (LAW | {"A": np.array([1, "a"], dtype=object)}, "A is a cell array"),
        ({"s": LAW | {"A": np.array([1, "a"], dtype=object)}}, "it has s, a struct whose A is a cell array"),
        ({"K": np.ones((2, 2, 2))}, "K has shape (2, 2, 2); expected a matrix"),
        (LAW | {"B": B.T[:1]}, "give 2 row(s) of 2 number(s), as A has 2 row(s)"),
        (LAW | {"A": -np.eye(201), "B": np.ones((201, 2)), "C": np.ones((1, 201))}, "a controller of 201 states is too large"),
        (LAW | {"A": 1e300 * A}, "A has an entry beyond 1e+15"),
        ({"A": np.ones((400, 400))}, "A is a matrix of 1.6e+05 numbers"),
        (LAW | {"Ts": -1.0}, "Ts = [[-1.0]] is no sample period"),
        (LAW | {"Ts": 0.1, "sample_period": 0.2}, "are two sample periods"),
    ],
)
def test_what_is_no_controller_is_refused(tmp_path, variables, said):
    """A file that holds no controller, or one that is none, is refused in one line that says what is in the way."""
    with pytest.raises(InputError) as caught:
        read_vehicle(vehicle_with(tmp_path, mat(variables)))
    assert said in str(caught.value)
    assert "[controllers.mine]" in str(caught.value)


def element(kind: int, content: bytes) -> bytes:
    """One element of a file of version 5."""
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def head(kind: int, rows: int, columns: int, name: bytes) -> bytes:
    """Returns what a variable begins with."""
    return element(6, struct.pack("<II", kind, 0)) + element(5, struct.pack("<ii", rows, columns)) + element(1, name)


START = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x100) + b"IM"
OBJECT = element(6, struct.pack("<II", 17, 0)) + element(1, b"K") + element(1, b"MCOS") + element(1, b"ss")


def nested(levels: int) -> bytes:
    """Cells in cells in a variable A."""
    inner, sizes = head(1, 1, 1, b""), [len(head(1, 1, 1, b""))]
    for _ in range(levels):
        sizes.append(sizes[-1] + 8 + len(inner))
    return START + element(14, head(1, 1, 1, b"A") + b"".join(struct.pack("<II", 14, size) + inner for size in reversed(sizes)))


def bomb(size: int) -> bytes:
    """A matrix A that grows to so many bytes when it is decompressed."""
    packer = zlib.compressobj(9)
    parts = head(6, size // 8, 1, b"A") + struct.pack("<II", 9, size)
    packed = packer.compress(struct.pack("<II", 14, len(parts) + size) + parts)
    for _ in range(0, size, 2**20):
        packed += packer.compress(bytes(2**20))
    packed += packer.flush()
    return START + struct.pack("<II", 15, len(packed)) + packed


HOSTILE = {
    "object": (START + element(14, OBJECT), "K is a MATLAB object of class ss, which only MATLAB reads; there, say [A,"),
    "7.3": (START.ljust(512) + b"\x89HDF\r\n\x1a\n" + bytes(100), "is of version 7.3, which is HDF5 and not read; save it"),
    "deep": (nested(50_000), "A is a cell array"),  # this ends scipy, and the process with it
    "wide": (START + element(14, head(1, 100_000, 10_000, b"A")), "A is a cell array"),  # it makes 8 GB of this
    "wide struct": (START + element(14, head(2, 100_000, 10_000, b"s")), "it has s, an array of structs"),
    "bomb": (bomb(2**25), "takes more than 8 MiB"),
    "claims": (START + struct.pack("<II", 14, 2**30) + head(6, 2**14, 2**13, b"A"), "longer than what holds it"),
    "claims 4": (struct.pack("<5i", 0, 2**30, 2**30, 0, 2) + b"A\0", "a variable is longer than the file"),
    "empty": (b"", "holds no A, B, C, D, and no K; it has nothing"),
    "no file of MATLAB": (b"\x7fELF" + bytes(1000), "is no MATLAB file"),
    "pickle": (b"\x80\x04\x95" + b"cos\nsystem\n" * 20, "is no MATLAB file"),
    "type": (START + element(14, head(6, 1, 1, b"A") + element(200, bytes(8))), "does not have the numbers"),  # this ends it, too
    "twice": (mat(LAW) + mat(LAW)[128:], "is there twice"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_what_is_made_to_harm_is_refused(tmp_path, name):
    """Files that end scipy, ask it for gigabytes, or are none, are refused in one line, at once."""
    content, said = HOSTILE[name]
    file, before = vehicle_with(tmp_path, content), time.process_time()
    with pytest.raises(InputError, match=re.escape(said)):
        read_vehicle(file)
    assert time.process_time() - before < 2  # s; a bomb is decompressed as far as is allowed, which takes 20 ms


def test_a_file_that_is_not_there(tmp_path):
    """So is one that is not there, no file, or not named as a file is."""
    file = vehicle_with(tmp_path, b"")
    text = file.read_text()
    for new, said in (
        ('"other.mat"', "there is no such file"),
        ('"."', "is a folder"),
        ("3", "is no file's name"),
        ('"mine.mat"\ngain = [[1.0, 2.0]]', "has a file and gain"),
    ):
        file.write_text(text.replace('"mine.mat"  # of MATLAB', new))
        with pytest.raises(InputError, match=said):
            read_vehicle(file)
    (tmp_path / "mine.mat").write_bytes(mat(LAW))
    plain = text.partition("[controllers.mine]")[0]
    file.write_text(f'{plain}[controllers]\nmine = {{ {MEASURED}, file = "mine.mat" }}\n')
    with pytest.raises(InputError, match=r"its file is not named on a line of its own"):
        read_vehicle(file)


def test_a_line_that_only_looks_like_one_stays(tmp_path):
    """Comments and texts that say `file = ...` are left as they are; a name in any letters comes out as a comment can hold it."""
    file = vehicle_with(tmp_path, mat(LAW))
    (tmp_path / "ö\x7f.mat").write_bytes(mat({"K": [[1.0, 2.0]]}))
    more = f'# file = "x"\n[controllers.other]\n{MEASURED}\nfile = "ö\\u007f.mat"\n'
    file.write_text(file.read_text() + more)
    vehicle = read_vehicle(file)
    assert '# file = "x"' in vehicle.text
    other = vehicle.controllers["other"].law
    assert other is not None
    assert other.record == {"gain": [[1.0, 2.0]]}
    assert len(vehicle.named_files) == 2


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """A file with some of its bytes gone, changed, doubled, or claiming what is not so."""
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 5))):
        at = int(rng.integers(len(data))) if data else 0
        what = int(rng.integers(5))
        if what == 0:
            del data[at:]
        elif what == 1 and data:
            data[at] ^= 1 << int(rng.integers(8))
        elif what == 2:
            claim = int(rng.choice([0, 1, 2, 3, 14, 15, 17, 2**16, 2**31 - 1, 2**31, 2**32 - 1]))
            data[at // 4 * 4 : at // 4 * 4 + 4] = struct.pack("<I", claim)
        elif what == 3:
            data[at:at] = data[at : at + int(rng.integers(1, 200))]
        else:
            del data[at : at + int(rng.integers(1, 64))]
    return bytes(data)


def packed(content: bytes) -> bytes:
    """The same with each variable compressed, so that damage within meets no checksum."""
    inside, at, whole = content[128:], 0, content[:128]
    while at + 8 <= len(inside):
        size = 8 + int.from_bytes(inside[at + 4 : at + 8], "little")
        body = zlib.compress(inside[at : at + size])
        whole += struct.pack("<II", 15, len(body)) + body
        at += size
    return whole


def attack(rng: np.random.Generator, count: int) -> int:
    """Reads damaged files. Returns how many were refused; of the others, what was read is numbers."""
    sound = [
        mat(LAW),
        mat({"K": LAW}),
        mat(LAW, do_compression=True),
        mat(LAW, format="4"),
        mat(LAW | {"x": "text", "c": [1, "a"]}),
    ]
    refused = 0
    for i in range(count):
        content = sound[i % len(sound)]
        content = damaged(content, rng)
        if i % 3 == 0:
            content = packed(content)
        try:
            found, _ = read_mat(content, NAMES)
        except InputError:
            refused += 1
            continue
        for value in found.values():
            for each in value.values() if isinstance(value, dict) else [value]:
                assert isinstance(each, np.ndarray), i
                assert each.nbytes <= MOST_INSIDE, i
    return refused


def test_damage_is_seen():
    """For a few hundred damaged files none gets through as what it is not, and some are still whole."""
    assert 100 < attack(np.random.default_rng(0), 300) < 300


@pytest.mark.attack
@pytest.mark.parametrize("seed", range(3))
def test_attack_on_files(seed):
    """And of thousands, none takes memory, time, or the process."""
    resource = pytest.importorskip("resource", reason="the most memory that a process had is POSIX's to tell")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert attack(np.random.default_rng(100 + seed), 10_000) > 3000
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # KiB: twenty times what a law may take


def test_a_campaign_is_of_the_matrices(tmp_path, monkeypatch, capsys):
    """A law of a file is driven over thousands like any other; with other matrices in the file it is another campaign."""
    vehicle_with(tmp_path, mat(LAW))
    monkeypatch.chdir(tmp_path)
    text = 'vehicles = ["car.toml"]\ncontrollers = ["mine"]\nroads = ["iso8608:class=A"]\nspeeds = [10.0]\nseeds = 1\n'
    (tmp_path / "many.toml").write_text(f"{text}duration = 1.0\ntimestep = 2e-3\n")
    line = ["many.toml", "--results", "found", "--workers", "1", "--json"]
    assert campaign(line) == 0
    assert campaign(line) == 0  # taken up again, with the law that the folder holds
    assert campaign(["--verify", "found"]) == 0
    (tmp_path / "mine.mat").write_bytes(mat(LAW | {"C": 1.01 * C}))
    with pytest.raises(InputError, match="another campaign"):
        campaign(line)


def test_json_is_of_the_matrices(tmp_path, capsys):
    """`python -m synth --json` gives the law's matrices, not its file."""
    file = vehicle_with(tmp_path, mat(LAW))
    synth(["--vehicle", str(file), "--controller", "mine", "--json"])
    (row,) = json.loads(capsys.readouterr().out)["controllers"]
    assert {name: row[name] for name in LAW} == {name: value.tolist() for name, value in LAW.items()}
