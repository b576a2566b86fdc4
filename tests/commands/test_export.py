"""A controller as C99: the compiled code has the bits of the law, and a folder that is changed is found out."""

import ctypes
import dataclasses
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from models.common.errors import InputError
from models.kinds.kind import HERE
from models.laws.anti_windup import anti_windup_gain
from models.laws.linear import LinearLaw
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from synth.__main__ import main
from synth.controller.controller import Controller
from synth.controller.export.c_law import NUMBERS, SPARE, ExportedLaw, PythonStep, c_name, exported_law, random_inputs
from synth.controller.export.c_source import FLAGS, CSource
from synth.controller.export.compiled import CompiledStep, ExportedCode
from tests.support import cortex_m4
from tests.support.commands import attacks, prose

COMPILER = shutil.which("cc")
needs_cc = pytest.mark.skipif(COMPILER is None, reason="no C compiler is here")
STRICT = "-pedantic -Wall -Wextra -Wconversion -Wshadow -Wdouble-promotion -Wstrict-prototypes -Werror"
BUILT = "\n[implementation]\nsample_period = 0.005\n"
LAW = """
[controllers.law]
measured = ["suspension_deflection", "sprung_velocity"]
A = [[0.9, 0.05], [-0.02, 1.0]]
B = [[1.0, 0.3], [0.2, -0.1]]
C = [[900.0, -300.0]]
D = [[4000.0, -1500.0]]
sample_period = 0.005
anti_windup = 5.0
"""
WHOLE = ["--controller", "I", "--numbers", "int16"]
GROWING = """
[controllers.law]
measured = ["sprung_velocity"]
A = [[1.0]]
B = [[1.0]]
C = [[-900.0]]
D = [[-1500.0]]
sample_period = 0.005
"""
LIMITS = "\n[limits]\nactuator_force = 500.0\n"
TEXT = read_vehicle("quarter_car").text + LAW + BUILT + LIMITS
SEEN = ("suspension_deflection", "sprung_velocity")
RANGES = ["--range", "suspension_deflection=0.1", "--range", "sprung_velocity=1"]
SEMI_ACTIVE = ("skyhook", "skyhook_linear", "groundhook", "hybrid", "add", "pdd", "skyhook_add")


def started(law: ExportedLaw, folder: Path) -> CompiledStep:
    """Returns the code of a law at its start; a compiler that warns of much finds nothing in it."""
    texts = CSource(law, "0" * 64).files
    for name, text in texts.items():
        (folder / name).write_text(text)
    command = [str(COMPILER), *FLAGS.split(), *STRICT.split(), "-c", f"{law.name}.c"]
    ran = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    return ExportedCode(law, texts, "").start()


def stepped(code: CompiledStep, row: Sequence[float]) -> list[float]:
    """Returns the outputs of the code for the inputs of a sample."""
    code.seen[:] = row
    code.step()
    return code.given.tolist()


def differing(law: ExportedLaw, folder: Path, samples: int) -> int:
    """Returns the number of outputs in which compiled code and Python differ in any bit."""
    code, python, wrong = started(law, folder), PythonStep(law), 0
    for k, row in enumerate(random_inputs(law, samples, 7)):
        if law.fixed is None and k % 20 == 19:
            row[k % len(row)] = (np.nan, np.inf, -np.inf, float(np.finfo(NUMBERS[law.numbers]).max))[k // 20 % 4]
        wrong += sum(float(ours) != theirs for ours, theirs in zip(python(row), stepped(code, row), strict=True))
    return wrong


def random_law(rng: np.random.Generator, vehicle: Vehicle, numbers: str) -> ExportedLaw:
    """Returns a random law of a half-car's signals: 0 to 12 states, quantised, delayed, limited, with anti-windup.

    In fixed point its ranges are such that now and then a reading is clipped.
    """
    k, signals = int(rng.integers(13)), list(vehicle.linear_model.measurable)
    q, m = int(rng.integers(1, 5)), len(vehicle.linear_model.inputs)
    A = rng.standard_normal((k, k))
    A *= 0.98 / max(np.abs(np.linalg.eigvals(A)).max(initial=0.0), 1e-9)
    matrices = rng.standard_normal((k, q)), rng.standard_normal((m, k)), 1e3 * rng.standard_normal((m, q))
    law = LinearLaw(A, *matrices, 0.005, float(rng.uniform(0.1, 20)) if k and rng.random() < 0.5 else None)
    measured = tuple(rng.choice(signals, q, replace=False).tolist())
    steps = {name: float(10.0 ** rng.uniform(-4, -1)) for name in measured if rng.random() < 0.4}
    how = dataclasses.replace(vehicle.implementation, sample_period=0.005, delay=int(rng.integers(4)), quantisation=steps)
    limits = dataclasses.replace(vehicle.limits, actuator_force=float(rng.uniform(50, 2000)) if rng.random() < 0.5 else None)
    if rate := rng.random() < 0.5 and (limits.actuator_force is not None or law.anti_windup is None):
        limits = dataclasses.replace(limits, force_rate=float(rng.uniform(1e3, 1e6)))
    built = dataclasses.replace(vehicle, implementation=how, limits=limits)
    controller = dataclasses.replace(_given(vehicle, "passive"), name="law", measured=measured, law=law)
    double = exported_law(built, controller, "double", "law")
    if numbers in ("double", "float"):
        return exported_law(built, controller, numbers, "law")
    most = 1.5 * np.abs(list(random_inputs(double, 50, 1))).max(axis=0)
    ranges = dict(zip(measured, most.tolist(), strict=True))
    if rate:  # a share of the largest force
        free = dataclasses.replace(built, limits=dataclasses.replace(limits, force_rate=None))
        fixed = exported_law(free, controller, numbers, "law", ranges).fixed
        assert fixed is not None
        unit = 2 * fixed.given.max()  # with a rate limit
        change = max(16 * unit, float(rng.uniform(0.01, 0.5)) * min(unit * fixed.largest, limits.actuator_force or np.inf))
        built = dataclasses.replace(built, limits=dataclasses.replace(limits, force_rate=change / 0.005))
    return exported_law(built, controller, numbers, "law", ranges)


@needs_cc
@pytest.mark.parametrize("numbers", ["double", "float"])
def test_a_sensor_that_fails_is_held(numbers, tmp_path):
    """NaN or infinity acts as the last finite input and is counted; after a spike that overflows forces are within the limit."""
    vehicle = parse_vehicle(TEXT.replace("[limits]", "delay = 1\n[limits]"))
    law = exported_law(vehicle, _given(vehicle, "law"), numbers, "law")
    number = cortex_m4.C_TYPES[numbers]

    class State(ctypes.Structure):
        _fields_ = (
            ("x", number * 2),
            ("line", number),
            ("oldest", ctypes.c_int),
            ("valid", number * 2),
            ("faults", ctypes.c_int),
        )

    def driven(rows: list[list[float]]) -> list[tuple[float, int]]:
        code = started(law, tmp_path)
        state = State.from_address(code.state.ctypes.data)
        return [(stepped(code, row)[0], state.faults) for row in rows]

    broken = [[float("nan"), 0.1], [0.01, 0.2], [0.02, float("inf")], [float("nan"), float("-inf")], [0.03, -0.1]]
    held = [[0.0, 0.1], [0.01, 0.2], [0.02, 0.2], [0.02, 0.2], [0.03, -0.1]]
    assert driven(broken) == [(force, faults) for (force, _), faults in zip(driven(held), (1, 0, 1, 2, 0), strict=True)]
    most = float(np.finfo(NUMBERS[numbers]).max)
    forces, faults = zip(*driven([[most, -most], [most, most], *[[0.01, 0.1]] * 500]), strict=True)
    assert np.all(np.abs(forces) <= 500)
    assert faults[0] > 0


@needs_cc
@pytest.mark.parametrize("numbers", ["int16", "int32"])
def test_whole_numbers_take_any_law(numbers, tmp_path):
    """A gain beyond the largest integer is scaled: the force is the law's but for rounding, and any input is within the limit."""
    text = read_vehicle("quarter_car").text + BUILT + LIMITS
    text += '\n[controllers.law]\nmeasured = ["suspension_deflection", "sprung_velocity"]\ngain = [[-4e9, -2000.0]]\n'
    vehicle = parse_vehicle(text.replace("-4e9", "-40000.0") if numbers == "int16" else text)
    law = exported_law(vehicle, _given(vehicle, "law"), numbers, "law", dict.fromkeys(SEEN, 0.01))
    assert law.fixed is not None
    code, python = started(law, tmp_path), PythonStep(law)
    for y in ([0.002, 0.004], [-0.004, 0.01], [0.0, -0.007], [1e9, 1e9], [-1e9, -1e9], [1e9, 0.0]):
        seen = np.clip(np.rint(y / law.fixed.seen), -law.fixed.largest - 1, law.fixed.largest)
        given = stepped(code, seen.tolist())
        assert python(seen.tolist()) == given
        top = law.fixed.largest * law.fixed.seen
        ideal = float(np.clip(law.law.D[0] @ np.clip(y, -top, top), -500, 500))
        rounded = np.abs(law.law.D[0]) @ law.fixed.seen / 2 + law.fixed.given[0]  # of readings, then of the force and its limit
        assert abs(given[0] * law.fixed.given[0] - ideal) <= rounded + 1e-4 * abs(ideal)  # 1e-4: coefficients of 15 bits
        assert abs(given[0] * law.fixed.given[0]) <= 500


@pytest.mark.parametrize("numbers", ["int16", "int32"])
def test_whole_numbers_limit_the_rate(numbers):
    """Forces of integer code change by at most 8 N a sample, and differ from those of double code by rounding alone."""
    text = read_vehicle("quarter_car").text + BUILT + LIMITS + "force_rate = 1600.0\n"
    text += '\n[controllers.law]\nmeasured = ["suspension_deflection", "sprung_velocity"]\ngain = [[9000.0, -2000.0]]\n'
    vehicle = parse_vehicle(text)
    ranges: dict[str, float] = dict(zip(SEEN, (0.05, 0.5), strict=True))
    law = exported_law(vehicle, _given(vehicle, "law"), numbers, "law", ranges)
    fixed, rounded = law.fixed, PythonStep(law)
    assert fixed is not None
    exact = PythonStep(exported_law(vehicle, _given(vehicle, "law"), "double", "law"))
    y = [np.sin([0.07 * k, 0.2 * k]) * [0.04, 0.3] * (k < 300) for k in range(400)]
    given = np.array([rounded(np.rint(one / fixed.seen).tolist())[0] for one in y]) * fixed.given[0]
    ideal = np.array([exact(one.tolist())[0] for one in y])
    largest = np.abs(np.diff(ideal)).max()
    assert largest == pytest.approx(8.0) == np.abs(np.diff(given)).max()
    assert np.abs(given - ideal).max() <= np.abs(law.law.D[0]) @ fixed.seen / 2 + fixed.given[0] + 1e-4 * 500


@needs_cc
@pytest.mark.parametrize("seed", [5, *attacks([0, 1, 2, 3, 4])])  # 5: rate limit and anti-windup
def test_the_code_has_the_bits_of_the_law(seed, tmp_path):
    """For a random law every output of the compiled code is that of Python to the last bit, in floating and in fixed point."""
    for numbers in NUMBERS:
        law = random_law(np.random.default_rng(seed), read_vehicle("half_car"), numbers)
        folder = tmp_path / numbers
        folder.mkdir()
        assert differing(law, folder, 1000 if seed in (0, 5) else 5_000) == 0


@pytest.mark.attack
@needs_cc
@pytest.mark.parametrize("numbers", ["float", *attacks(["double"])])
def test_semi_active_laws_have_their_bits(tmp_path, numbers):
    """So has every semi-active law, and a linear one on an adjustable damper, whose coefficients stay within its range."""
    vehicle = read_vehicle("quarter_car_semi_active")
    for name in (*SEMI_ACTIVE, "sky"):
        driver = vehicle.controllers[name].driver() if name != "sky" else _given(vehicle, name)
        law = exported_law(vehicle, driver, numbers, c_name(name))
        assert differing(law, tmp_path, 1000) == 0
        step = PythonStep(law)
        given = [step(row)[0] for row in random_inputs(law, 300, 3)]
        assert 200.0 * (1 - 1e-6) <= min(given) < 500 < max(given) <= 1000.0 * (1 + 1e-6)  # rounding of float


def _given(vehicle: Vehicle, name: str) -> Controller:
    from synth.vehicle.designer import Designer

    return Designer(vehicle, search=False).design(name)


@pytest.mark.parametrize(("rate", "change"), [("", np.inf), ("force_rate = 1000.0\n", 5.0)])
def test_the_python_step_is_the_law(rate, change):
    """By matrices, without an order of summation: states, forces, limits, anti-windup and delay are those of the harness."""
    vehicle = parse_vehicle(
        read_vehicle("quarter_car").text + LAW + BUILT + "delay = 2\n\n[limits]\nactuator_force = 30.0\n" + rate
    )
    controller = _given(vehicle, "law")
    law, run = exported_law(vehicle, controller, "double", "law"), controller.law.sampled(0.005)
    step, x, line, L = PythonStep(law), np.zeros(2), [np.zeros(1)] * 2, anti_windup_gain(run)
    clipped, given = 0, np.zeros(1)
    for row in random_inputs(law, 500, 1):
        y = np.array(row)
        force = run.C @ x + run.D @ y
        given = np.clip(np.clip(force, -30.0, 30.0), given - change, given + change)
        x = run.A @ x + run.B @ y + L @ (given - force)
        line.append(given)
        clipped += bool(np.any(given != force))
        assert step(row) == pytest.approx(line.pop(0), rel=1e-11, abs=1e-11)  # rounding of another order
    assert 50 < clipped < 500


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> Path:
    """Returns the folder of a law with states, as the command writes it."""
    folder = tmp_path_factory.mktemp("export")
    (folder / "car.toml").write_text(read_vehicle("quarter_car").text + LAW + BUILT + "\n[limits]\nactuator_force = 500.0\n")
    assert main(["--vehicle", str(folder / "car.toml"), "--controller", "law", "--export", str(folder / "ecu")]) == 0
    return folder / "ecu"


def test_a_folder_proves_itself(exported, capsys, tmp_path):
    """Nothing is changed in what was written; the code runs back to back; a designed controller brings its certificate."""
    capsys.readouterr()
    assert main(["--check", str(exported)]) == 0
    said = prose(capsys.readouterr().out)
    assert "all files are as exported" in said
    assert ("1000 samples, 0 outputs differ" in said) == (COMPILER is not None)
    assert main(["--controller", "II", "--export", str(tmp_path / "two"), "--numbers", "float", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    found = {path.relative_to(tmp_path / "two").as_posix() for path in (tmp_path / "two").rglob("*") if path.is_file()}
    assert found == {*printed["files"]}
    assert main(["--check", str(tmp_path / "two")]) == 0
    assert "every claim of the saved certificate holds" in prose(capsys.readouterr().out)
    assert "`bound` = 7.9" in (tmp_path / "two" / "README.md").read_text()


def test_every_changed_file_is_named(exported, capsys, tmp_path):
    """A flipped bit of any file is named, and so is a file that is missing; the exit code is 1."""
    names = sorted(path.relative_to(exported).as_posix() for path in exported.rglob("*") if path.is_file())
    assert len(names) == 13
    for name in names:
        copy = tmp_path / name.replace("/", "_")
        shutil.copytree(exported, copy)
        content = bytearray((copy / name).read_bytes())
        place = len(content) // 2
        content[place] ^= 1
        (copy / name).write_bytes(content)
        try:
            code, said = main(["--check", str(copy)]), prose(capsys.readouterr().out)
        except InputError as error:  # what cannot be read any more is named, too
            code, said = 1, str(error)
        assert code == 1
        assert name.rpartition("/")[2] in said, said
    copy = tmp_path / "other"
    shutil.copytree(exported, copy)
    (copy / "law.c").rename(copy / "more.c")
    assert main(["--check", str(copy)]) == 1
    assert "law.c: is missing" in prose(capsys.readouterr().out)


@pytest.mark.parametrize(
    ("vehicle", "options", "said"),
    [
        (
            LAW.replace("sample_period = 0.005\n", "").replace("anti_windup = 5.0\n", ""),
            ["--controller", "law"],
            "needs a sample period",
        ),
        ("", ["--controller", "passive"], "unknown controller 'passive'"),
        ("", [], "no controller is given"),
        ("", ["--controller", "I", "--controller", "II"], "--export writes one controller"),
        ("", ["--controller", "I", "--refine"], "combine it only with --controller"),
        (BUILT + "delay = 0.5\n", ["--controller", "I"], "is not an integer"),
        (
            "[limits]\nforce_rate = 1e4\n",
            ["--controller", "I"],
            r"force_rate limits the change .* give sample_period in \[implementation\]",
        ),
        (BUILT + "[limits]\nforce_rate = 10\n", [*WHOLE, *RANGES], "too coarse for changes of 0.05 N per sample"),
        (LAW + BUILT + "[limits]\nforce_rate = 1e4\n", ["--controller", "law", *WHOLE[2:], *RANGES], "give actuator_force"),
        ("", [*WHOLE, "--range", "sprung_velocity=1"], "magnitude of suspension_deflection; give this magnitude with --range"),
        ("", [*WHOLE, "--range", "tyre_deflection=1"], "--range tyre_deflection: controller 'I_designed' measures"),
        (
            "",
            [*WHOLE, "--range", "sprung_velocity=1e300"],
            "--range sprung_velocity=1e300 does not have the form SIGNAL=MAGNITUDE",
        ),
        ("", [*WHOLE, "--range", "sprung_velocity=1", "--range", "sprung_velocity=2"], "is given twice; give each range once"),
        ("", [*WHOLE, "--range", "sprung_velocity=fast"], "--range sprung_velocity=fast does not have the form SIGNAL=MAGNITUDE"),
        ("", ["--controller", "I", "--range", "sprung_velocity=1"], "--range is for integer code"),
        (GROWING + BUILT, ["--controller", "law", *WHOLE[2:], "--range", "sprung_velocity=1"], "law does not decay"),
    ],
)
def test_what_is_not_exported(vehicle, options, said, tmp_path):
    """What cannot be code is refused in one line, and no folder is left."""
    (tmp_path / "car.toml").write_text((HERE / "quarter_car.toml").read_text() + vehicle)
    with pytest.raises(InputError, match=said):
        main(["--vehicle", str(tmp_path / "car.toml"), *options, "--export", str(tmp_path / "ecu")])
    assert [path.name for path in tmp_path.iterdir()] == ["car.toml"]


@needs_cc
def test_a_folder_in_fixed_point(capsys, tmp_path):
    """It says the step of every input and output and the given ranges, runs back to back, and a changed range is named."""
    ranges = ["--range", "suspension_deflection=0.12", "--range", "sprung_velocity=1.0"]
    assert main([*WHOLE, *ranges, "--export", str(tmp_path / "ecu")]) == 0
    capsys.readouterr()
    assert main(["--check", str(tmp_path / "ecu")]) == 0
    assert "1000 samples, 0 outputs differ" in prose(capsys.readouterr().out)
    page = (tmp_path / "ecu" / "README.md").read_text()
    assert "`sprung_velocity` ±1 m/s" in page
    assert "m, in steps of 3.814697265625e-06" in page  # 0.12 m over 32767 is a little less
    record = tmp_path / "ecu" / "certificate.json"
    record.write_text(record.read_text().replace("0.12", "0.13"))
    assert main(["--check", str(tmp_path / "ecu")]) == 1
    assert "certificate.json: is changed" in prose(capsys.readouterr().out)


GOALS = """
[controllers.goals]
measured = ["suspension_deflection", "sprung_velocity"]
gain = [[8000.0, -3000.0]]
bounds = [
    { peak = "suspension_deflection", road = "bump", at_most = 0.12 },
    { energy_peak = "suspension_deflection", energy = 0.001, at_most = 0.2 },
]
"""


def test_a_proved_peak_is_a_range(capsys, tmp_path):
    """The largest proved peak of a goal is the range of its signal, as the folder says; a range that no peak proves is named."""
    (tmp_path / "car.toml").write_text((HERE / "quarter_car.toml").read_text() + GOALS)
    command = ["--vehicle", str(tmp_path / "car.toml"), "--controller", "goals", "--numbers", "int32"]
    with pytest.raises(InputError, match="integer code needs the largest magnitude of sprung_velocity"):
        main([*command, "--export", str(tmp_path / "ecu")])
    assert main([*command, "--range", "sprung_velocity=2", "--export", str(tmp_path / "ecu")]) == 0
    record = json.loads((tmp_path / "ecu" / "certificate.json").read_text())
    peak, energy = _given(read_vehicle(str(tmp_path / "car.toml")), "goals").specifications[-2:]
    assert peak.proved is not None
    assert energy.proved is not None
    assert peak.proved > energy.proved
    assert record["ranges"] == {"suspension_deflection": pytest.approx(SPARE * peak.proved), "sprung_velocity": 2.0}
    assert record["range_sources"]["sprung_velocity"] == "given"
    said = record["range_sources"]["suspension_deflection"]
    assert said == f"1.1 times its peak over bump, proved to be at most {peak.proved:.4g} m"
    assert said in (tmp_path / "ecu" / "README.md").read_text()
    assert main(["--check", str(tmp_path / "ecu")]) == 0


def test_nothing_is_overwritten(exported):
    """A folder that holds something is left as it is."""
    with pytest.raises(InputError, match="exists and is not empty"):
        main(["--controller", "I", "--export", str(exported)])


@pytest.mark.extra
@pytest.mark.attack
@pytest.mark.parametrize("numbers", NUMBERS)
def test_another_processor_has_the_same_bits(numbers, tmp_path):
    """A Cortex-M4 without floating-point unit, simulated, gives every output to the last bit."""
    for package in cortex_m4.PACKAGES:
        pytest.importorskip(package, reason="needs the extra [export-test]")
    law = random_law(np.random.default_rng(1), read_vehicle("half_car"), numbers)
    rows, step = list(random_inputs(law, 1000, 5)), PythonStep(law)
    assert cortex_m4.outputs(law, rows, tmp_path) == [[float(value) for value in step(row)] for row in rows]


SOFT = re.compile(rb"__aeabi_(?:[ui]?l?2)?(d|f)[a-z0-9]+|__aeabi_[ui]?l?2(d|f)")  # routines for numbers of 64 and 32 bits


@pytest.mark.extra
@pytest.mark.parametrize("numbers", NUMBERS)
def test_an_arm_build_has_no_number_that_it_should_not(numbers, tmp_path):
    """Built for a processor without floating point, float needs no routine for double, and whole numbers need none at all."""
    pytest.importorskip("ziglang", reason="needs the extra [export]")
    law = random_law(np.random.default_rng(2), read_vehicle("quarter_car"), numbers)
    for name, text in CSource(law, "0" * 64).files.items():
        (tmp_path / name).write_text(text)
    target = (
        "-target thumb-freestanding-eabi -mcpu=cortex_m4+soft_float -std=c99 -O2 -ffp-contract=off -Wdouble-promotion -Werror"
    )
    command = [sys.executable, "-m", "ziglang", "cc", *target.split(), "-c", f"{law.name}.c", "-o", "law.o"]
    subprocess.run(command, cwd=tmp_path, check=True)
    found = {name for pair in SOFT.findall((tmp_path / "law.o").read_bytes()) for name in pair if name}
    assert found == {"double": {b"d"}, "float": {b"f"}}.get(numbers, set())
