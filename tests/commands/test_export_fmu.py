"""FMUs: FMPy, libcosim, CasADi and fmutool take them; a controller has our bits, and the vehicle is our exact response."""

import ctypes
import io
import itertools
import re
import shutil
import subprocess
import sys
import zipfile
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from models.common.arrays import Array
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from synth.__main__ import main
from synth.controller.export import fmu
from synth.controller.export.c_law import PythonStep, exported_law, random_inputs
from synth.controller.export.fmu import HERE, ZIG, _universal, zip_files
from synth.controller.export.fmu_description import BASE
from synth.controller.export.linear_system import loop_system, vehicle_system
from synth.plant.state_space import StateSpace
from synth.vehicle.designer import Designer
from tests.commands.test_export import BUILT, LAW
from tests.support.commands import attacks, in_the_suite, prose

COMPILER = shutil.which("cc")
pytestmark = pytest.mark.skipif(COMPILER is None and find_spec(ZIG) is None, reason="no C compiler is here")
LIMITS = "\n[limits]\nactuator_force = 500.0\n"
TEXT = read_vehicle("quarter_car").text + LAW + BUILT + "delay = 2\nquantisation = { sprung_velocity = 0.001 }\n" + LIMITS
PERIOD, OK, DISCARD, ERROR = 0.005, 0, 2, 3
VERSIONS = [2, 3]


class Slave:
    """An initialized instance for co-simulation under FMPy, of either version, with the lines that it logged."""

    def __init__(self, file: Path) -> None:
        fmpy, simulation = (pytest.importorskip(name, reason="needs FMPy") for name in ("fmpy", "fmpy.simulation"))
        self.description, self.logged = fmpy.read_model_description(str(file)), list[str]()
        folder = file.with_suffix("")
        if not folder.exists():
            fmpy.extract(str(file), str(folder))
        log = {"logger": lambda *said: self.logged.append(said[-1].decode())}
        self.instance = simulation.instantiate_fmu(str(folder), self.description, "CoSimulation", **log)
        variables, kinds = self.description.modelVariables, ("input", "output")
        self.references = {kind: [one.valueReference for one in variables if one.causality == kind] for kind in kinds}
        number = "Real" if self.description.fmiVersion == "2.0" else "Float64"
        self.read, self.write = (getattr(self.instance, f"{of}{number}") for of in ("get", "set"))
        self.initialize()

    def __getattr__(self, name: str):
        return getattr(self.instance, name)

    def initialize(self) -> None:
        """Goes through the initialization of a new instance, or after a reset."""
        if self.description.fmiVersion == "2.0":
            self.instance.setupExperiment(startTime=0.0)
        self.instance.enterInitializationMode()
        self.instance.exitInitializationMode()

    @property
    def outputs(self) -> list[float]:
        """The outputs as they are."""
        return list(self.read(self.references["output"]))

    def step(self, k: int, inputs: list[float], h: float = PERIOD) -> list[float]:
        """Returns the outputs after the step from k h with some inputs."""
        self.write(self.references["input"], inputs)
        self.instance.doStep(k * h, h)
        return self.outputs


@pytest.fixture(scope="module", autouse=True)
def by_cc():
    """Lets the system's compiler build FMUs, if there is one: Zig takes seconds for each, and minutes for its first."""
    with pytest.MonkeyPatch.context() as patch:
        if COMPILER is not None:
            patch.setattr(fmu, "ZIG", "no_such_package")
        yield


EXPORTED = {
    **{f"law{version}": ["--controller", "law", "--fmi", str(version)] for version in VERSIONS},
    **{f"car{version}": ["--part", "vehicle", "--fmi", str(version)] for version in VERSIONS},
    "float2": ["--controller", "law", "--numbers", "float"],
    "full2": ["--vehicle", "full_car", "--part", "vehicle"],
    "loop2": ["--controller", "I_printed", "--part", "loop"],
}


@dataclass(frozen=True)
class Exported:
    """A folder whose FMUs are exported when they are first asked for: each takes most of a second."""

    path: Path

    def __truediv__(self, name: str) -> Path:
        file, options = self.path / name, EXPORTED.get(name.removesuffix(".fmu"), [])
        if name.endswith(".fmu") and options and not file.exists():
            vehicle = ["--vehicle", str(self.path / "car.toml")] if "law" in options else []
            assert main([*vehicle, *options, "--export", str(file)]) == 0
        return file


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Exported:
    """Returns a folder with the FMUs of a law with states, of vehicles, and of a loop, of both versions."""
    folder = Exported(tmp_path_factory.mktemp("fmu"))
    (folder / "car.toml").write_text(TEXT)
    return folder


def _law(numbers: str = "double") -> PythonStep:
    vehicle = parse_vehicle(TEXT)
    return PythonStep(exported_law(vehicle, Designer(vehicle, search=False).design("law"), numbers, "law"))


@pytest.mark.extra
@pytest.mark.attack
@pytest.mark.parametrize("name", ["law2", "car3"])
def test_fmutool_finds_nothing(folder, name):
    """Nor does fmutool, of either version."""
    tool = shutil.which("fmutool", path=str(Path(sys.executable).parent))
    if tool is None:
        pytest.skip("needs fmutool")
    ran = subprocess.run([tool, "-input", str(folder / f"{name}.fmu"), "-check"], capture_output=True, text=True, check=False)
    said = ran.stdout + ran.stderr
    assert "seems to be compliant with FMI" in said
    assert "No semantic error" in said


@pytest.mark.extra
@pytest.mark.parametrize("name", in_the_suite(("law2", "car3"), EXPORTED))
def test_validators_find_nothing(folder, name):
    """FMPy finds no problem in any of them."""
    pytest.importorskip("fmpy", reason="needs FMPy")
    assert import_module("fmpy.validation").validate_fmu(str(folder / f"{name}.fmu")) == []


def test_base_units_are_those_of_the_name():
    """What an FMU says that a unit is made of is what its name says, with N = kg m/s2."""
    for unit, parts in BASE.items():
        found: dict[str, int] = {}
        for side, sign in zip(unit.split("/"), (1, -1), strict=False):
            for name, power in re.findall(r"([A-Za-z]+)(\d?)", side):
                for base, exponent in (("kg", 1), ("m", 1), ("s", -2)) if name == "N" else ((name, 1),):
                    found[base] = found.get(base, 0) + sign * int(power or 1) * exponent
        assert {base: exponent for base, exponent in found.items() if exponent} == parts, unit


@pytest.mark.extra
def test_a_description_has_names_units_and_signs(folder):
    """Names, units and the sign of every variable stand in the description."""
    fmpy = pytest.importorskip("fmpy", reason="needs FMPy")
    description = fmpy.read_model_description(str(folder / "law2.fmu"))
    about = {one.name: (one.causality, one.unit) for one in description.modelVariables}
    assert about == {
        "suspension_deflection": ("input", "m"),
        "sprung_velocity": ("input", "m/s"),
        "control_force": ("output", "N"),
    }
    assert "positive if it lifts the body" in description.modelVariables[2].description
    assert description.coSimulation.canHandleVariableCommunicationStepSize is False


@pytest.mark.extra
@pytest.mark.parametrize("name", ["law2", "law3", *attacks(["float2"])])
def test_a_controller_has_our_bits(folder, name):
    """Of two instances, stepped in turn, every output is ours to the last bit; after a reset one begins anew."""
    numbers = "float" if name == "float2" else "double"
    first, second, ours, others = Slave(folder / f"{name}.fmu"), Slave(folder / f"{name}.fmu"), _law(numbers), _law(numbers)
    rows = list(random_inputs(ours.law, 1001, 3))
    for k, (one, other) in enumerate(itertools.pairwise(rows)):
        assert first.step(k, one) == [float(value) for value in ours(one)]
        assert second.step(k, other) == [float(value) for value in others(other)]
    first.reset()
    first.initialize()
    again = _law(numbers)
    for k, one in enumerate(rows[:20]):
        assert first.step(k, one) == [float(value) for value in again(one)]
    assert first.logged == second.logged == []


@pytest.mark.extra
@pytest.mark.parametrize("version", VERSIONS)
def test_a_state_goes_back(folder, version):
    """A copy of the state, and its bytes, bring an instance back to where it was."""
    one, ours = Slave(folder / f"law{version}.fmu"), _law()
    rows = list(random_inputs(ours.law, 20, 3))
    for k, row in enumerate(rows[:10]):
        one.step(k, row)
    get, put, keep, load = (
        ("getFMUstate", "setFMUstate", "serializeFMUstate", "deSerializeFMUstate")
        if version == 2
        else ("getFMUState", "setFMUState", "serializeFMUState", "deserializeFMUState")
    )
    state = getattr(one, get)()
    bytes_of_it = getattr(one, keep)(state)
    after = [one.step(10 + k, row) for k, row in enumerate(rows[10:])]
    getattr(one, put)(getattr(one, load)(bytes_of_it))
    assert [one.step(10 + k, row) for k, row in enumerate(rows[10:])] == after
    getattr(one, put)(state)
    assert [one.step(10 + k, row) for k, row in enumerate(rows[10:])] == after


@pytest.mark.extra
@pytest.mark.parametrize("version", VERSIONS)
def test_what_is_refused_is_said(folder, version):
    """Another step is discarded; a hole in time and an unknown variable are errors: a line each."""
    one = Slave(folder / f"law{version}.fmu")
    of_another = one.getInteger if version == 2 else one.getInt32
    before = one.outputs
    for act, status, said in (
        (lambda: one.doStep(0.0, 0.01), DISCARD, "a step of 0.01 s is not the sample period of this law, 0.005 s"),
        (lambda: one.doStep(0.0, 0.0), ERROR, "longer than 0 s"),
        (lambda: one.doStep(0.5, 0.005), ERROR, "the last one ended at 0 s"),
        (lambda: one.write([2], [1.0]), ERROR, "the variable with the value reference 2 cannot be set"),
        (lambda: one.read([99]), ERROR, "no variable with the value reference 99"),
        (lambda: of_another([0]), ERROR, "there are none of another type"),
    ):
        one.logged.clear()
        with pytest.raises(Exception, match=str(status)):
            act()
        assert len(one.logged) == 1
        assert said in one.logged[0]
    assert one.outputs == before
    library = ctypes.CDLL(next((folder / f"law{version}").glob("binaries/*linux*/*.so")))
    if version == 2:
        library.fmi2Instantiate.restype = ctypes.c_void_p
        assert library.fmi2Instantiate(b"x", 1, b"{another}", None, None, 0, 0) is None
    else:
        library.fmi3InstantiateModelExchange.restype = ctypes.c_void_p
        assert library.fmi3InstantiateModelExchange(b"x", b"{another}", None, False, False, None, None) is None


@pytest.mark.extra
@pytest.mark.parametrize("version", VERSIONS)
def test_a_sensor_that_fails_is_held(folder, version):
    """A law steps on with the last finite input and warns in a line; a vehicle refuses an input that is not finite."""
    other = Slave(folder / f"law{version}.fmu")
    broken = [[np.nan, 0.1], [0.01, 0.2], [0.02, np.inf], [np.nan, -np.inf], [0.03, -0.1]]
    held = [[0.0, 0.1], [0.01, 0.2], [0.02, 0.2], [0.02, 0.2], [0.03, -0.1]]
    given = [other.step(k, row) for k, row in enumerate(held)]
    one = Slave(folder / f"law{version}.fmu")  # FMPy calls the logger of the last instance
    assert [one.step(k, row) for k, row in enumerate(broken)] == given
    assert [said.split(";")[0] for said in one.logged] == [
        f"{count} value(s) were not finite at {time:g} s" for count, time in ((1, 0), (1, 0.01), (2, 0.015))
    ]
    assert other.logged == []
    car = Slave(folder / f"car{version}.fmu")
    with pytest.raises(Exception, match=str(ERROR)):
        car.step(0, [np.nan] * len(car.references["input"]))
    assert "is not a finite number; the step was not done" in car.logged[0]


@pytest.mark.extra
@pytest.mark.skipif(COMPILER is None, reason="no C compiler is here")
@pytest.mark.parametrize("version", [3, pytest.param(2, marks=pytest.mark.attack)])
def test_every_function_is_the_standards(folder, version, tmp_path):
    """Every function of the standard is exported, with the declaration of its headers; no compiler warns of the sources."""
    pytest.importorskip("fmpy", reason="needs FMPy")
    headers = Path(str(import_module("fmpy").__file__)).parent / "c-code"
    for part in ("law", "car"):
        file = folder / f"{part}{version}.fmu"
        with zipfile.ZipFile(file) as archive:
            archive.extractall(tmp_path / part)
        sources = sorted((tmp_path / part / "sources").glob("*.c"))
        flags = "-std=c99 -pedantic -Wall -Wextra -Wconversion -Wshadow -Wstrict-prototypes -Werror -c"
        for more in ([], ["-DFMU_STANDARD_HEADERS", f"-I{headers}"]):
            if more:
                flags = flags.replace("-Wstrict-prototypes ", "")  # the standard's own headers have ()
            command = [str(COMPILER), *flags.split(), *more, *map(str, sources)]
            ran = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
            assert (ran.returncode, ran.stderr) == (0, "")
        Slave(file)
        library = ctypes.CDLL(next((folder / f"{part}{version}").glob("binaries/*linux*/*.so")))
        names = re.findall(rf"FMI{version}_Export\s+\w+TYPE\s+(\w+);", (headers / f"fmi{version}Functions.h").read_text())
        assert len(names) == {2: 44, 3: 75}[version]
        assert [name for name in names if not hasattr(library, name)] == []


@pytest.mark.extra
@pytest.mark.attack
@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_compiles_and_simulates_it(folder, version, tmp_path):
    """From the sources alone FMPy builds and simulates it, and finds our outputs to the last bit."""
    fmpy = pytest.importorskip("fmpy", reason="needs FMPy")
    build_platform_binary = import_module("fmpy.build").build_platform_binary

    with zipfile.ZipFile(folder / f"law{version}.fmu") as archive:
        archive.extractall(tmp_path, [name for name in archive.namelist() if not name.startswith("binaries/")])
    build_platform_binary(tmp_path)
    ours = _law()
    rows = list(random_inputs(ours.law, 100, 3))
    kind = [("time", float), *((name, float) for name in ours.law.inputs)]
    given = np.array([(k * PERIOD, *row) for k, row in enumerate(rows)], dtype=kind)
    found = fmpy.simulate_fmu(
        str(tmp_path), stop_time=100 * PERIOD, input=given, output_interval=PERIOD, output=["control_force"]
    )
    assert found["control_force"].tolist() == [0.0, *(ours(row)[0] for row in rows)]


LIBCOSIM = """
import sys
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimManipulator import CosimManipulator
from libcosimpy.CosimObserver import CosimObserver
from libcosimpy.CosimSlave import CosimLocalSlave
run = CosimExecution.from_step_size(step_size=5_000_000)
law = run.add_local_slave(CosimLocalSlave(fmu_path=sys.argv[1], instance_name="law"))
observer, manipulator = CosimObserver.create_last_value(), CosimManipulator.create_override()
run.add_observer(observer)
run.add_manipulator(manipulator)
for line in open(sys.argv[2]):
    manipulator.slave_real_values(law, [0, 1], [float(word) for word in line.split()])
    run.step()
    print("given", observer.last_real_values(law, [2])[0])
"""


@pytest.mark.extra
def test_libcosim_runs_it(folder, tmp_path):
    """libcosim, in a process of its own, finds our outputs to the last bit."""
    if find_spec("libcosimpy") is None:
        pytest.skip("needs libcosimpy")
    ours = _law()
    rows = list(random_inputs(ours.law, 100, 3))
    (tmp_path / "rows").write_text("".join(f"{a!r} {b!r}\n" for a, b in rows))
    command = [sys.executable, "-c", LIBCOSIM, str(folder / "law2.fmu"), str(tmp_path / "rows")]
    ran = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    found = [float(line.split()[1]) for line in ran.stdout.splitlines() if line.startswith("given ")]
    assert found == [ours(row)[0] for row in rows]


def _held(system: StateSpace, h: float) -> tuple[Array, Array]:
    """Returns the maps of states and held inputs to the states after a step."""
    n, m = system.B.shape
    held = expm(h * np.block([[system.A, system.B], [np.zeros((m, n + m))]]))
    return held[:n, :n], held[:n, n:]


@pytest.mark.extra
@pytest.mark.parametrize("name", in_the_suite(("car2", "loop2"), ("car2", "car3", "full2", "loop2")))
def test_a_step_is_the_exact_response(folder, name):
    """In co-simulation with random inputs, held over steps of any length, the outputs are those of the matrix exponential."""
    vehicle, one = read_vehicle("full_car" if name == "full2" else "quarter_car"), Slave(folder / f"{name}.fmu")
    loop = loop_system(vehicle, Designer(vehicle, search=False).design("I_printed")) if name == "loop2" else None
    system = loop or vehicle_system(vehicle)
    rng, x, at = np.random.default_rng(1), np.zeros(len(system.A)), 0.0
    for h in [0.002] * 50 + [0.3, 0.01] * 5:
        u = rng.standard_normal(len(system.inputs))
        one.write(one.references["input"], u.tolist())
        one.doStep(at, h)
        at, (Phi, Gamma) = at + h, _held(system, h)
        x = Phi @ x + Gamma @ u
        expected = system.C @ x + system.D @ u
        assert one.outputs == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(expected).max())  # two exponentials


@pytest.mark.extra
def test_a_master_closes_our_sampled_loop(folder):
    """The controller's FMU and the vehicle's, stepped in turn, are the loop that our own step closes around the exact vehicle."""
    law, car, ours = Slave(folder / "law2.fmu"), Slave(folder / "car2.fmu"), _law()
    vehicle = parse_vehicle(TEXT)
    system = vehicle_system(vehicle)
    names = list(system.outputs)
    read = [names.index(name) for name in ours.law.inputs]
    (Phi, Gamma), n = _held(system, PERIOD), len(system.A)
    x, velocities = np.zeros(n), 3.0 * np.random.default_rng(2).standard_normal(200)
    values = car.outputs
    largest = 0.0
    for k, w in enumerate(velocities):
        force = law.step(k, [values[i] for i in read])
        expected = ours((system.C @ x)[read])
        # One step of quantisation (0.001 m/s) may fall the other way; none did.
        assert force == pytest.approx(expected, rel=1e-9, abs=1e-9)
        largest = max(largest, abs(force[0]))
        values = car.step(k, [w, 0.0, *force], PERIOD)
        x = Phi @ x + Gamma @ np.array([w, 0.0, *expected])
        assert values[:n] == pytest.approx(x, rel=1e-9, abs=1e-9)
    assert largest == 500.0


@pytest.mark.extra
@pytest.mark.parametrize("version", VERSIONS)
def test_casadi_reads_the_vehicle(folder, version, tmp_path):
    """CasADi reads it for model exchange, and finds our matrices in its equations and their derivatives, by their references."""
    casadi = pytest.importorskip("casadi", reason="needs CasADi")
    with zipfile.ZipFile(folder / f"car{version}.fmu") as archive:
        archive.extractall(tmp_path)
    system = vehicle_system(read_vehicle("quarter_car"))
    equations = casadi.DaeBuilder("car", str(tmp_path)).create("f", ["x", "u"], ["ode", "y"])
    rng = np.random.default_rng(1)
    x, u = rng.standard_normal(4), rng.standard_normal(3)
    derivatives, outputs = (np.array(one).ravel() for one in equations(x, u))
    assert derivatives == pytest.approx(system.A @ x + system.B @ u, rel=1e-12)  # rounding of sums in another order
    assert outputs == pytest.approx(system.C @ x + system.D @ u, rel=1e-12)
    slopes = [np.array(one) for one in equations.jacobian()(x, u, *equations(x, u))]
    for found, matrix in zip(slopes, (system.A, system.B, system.C, system.D), strict=True):
        assert np.array_equal(found, matrix)


@pytest.mark.extra
@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_integrates_the_vehicle(folder, version):
    """By model exchange, FMPy's integrator finds the free response of the matrix exponential, from a state that is set."""
    fmpy = pytest.importorskip("fmpy", reason="needs FMPy")
    system, start = vehicle_system(read_vehicle("quarter_car")), np.array([0.01, 0.0, -0.2, 0.0])
    names = list(system.states)
    given = {f"state.{name}": value for name, value in zip(names, start, strict=True)}
    options = {"fmi_type": "ModelExchange", "stop_time": 1.0, "output_interval": 0.1, "relative_tolerance": 1e-8}
    found = fmpy.simulate_fmu(str(folder / f"car{version}.fmu"), start_values=given, output=names, **options)
    for row in found:
        expected = expm(system.A * row["time"]) @ start
        # CVode's own error; in each state relative to its unit's size.
        assert [row[name] for name in names] == pytest.approx(expected, rel=0, abs=1e-5)


@pytest.mark.extra
def test_laws_without_states(tmp_path):
    """A static gain without a sample period takes any step; a semi-active law begins with the damper's nominal coefficient."""
    assert main(["--controller", "I_printed", "--export", str(tmp_path / "gain.fmu")]) == 0
    one, vehicle = Slave(tmp_path / "gain.fmu"), read_vehicle("quarter_car")
    ours = PythonStep(exported_law(vehicle, Designer(vehicle, search=False).design("I_printed"), "double", "gain"))
    at = 0.0
    for h, row in zip((0.001, 0.5, 0.02), random_inputs(ours.law, 3, 1), strict=True):
        one.write(one.references["input"], row)
        one.doStep(at, h)
        at += h
        assert one.outputs == ours(row)
    car, semi_active = "quarter_car_semi_active", tmp_path / "sky.fmu"
    assert main(["--vehicle", car, "--controller", "skyhook", "--export", str(semi_active)]) == 0
    other, dampers = Slave(semi_active), read_vehicle(car)
    law = PythonStep(exported_law(dampers, dampers.controllers["skyhook"].driver(), "double", "sky"))
    assert other.outputs == [law.law.dampers[0][0]]
    h = law.law.period or 0.001
    for k, row in enumerate(random_inputs(law.law, 50, 1)):
        assert other.step(k, row, h) == law(row)


@pytest.mark.parametrize("lag", ["", "actuator_bandwidth = 50.0\n"])
def test_the_loop_with_states_is_the_analysis(lag):
    """With a law of states, and with a lag, the loop's matrices have the frequency response of the analysis, by another route."""
    from sim.linear.frequency_response import continuous_frequency_response

    vehicle = parse_vehicle(TEXT + lag)
    assert list(vehicle_system(vehicle).states[4:]) == ["lagged_control_force"] * bool(lag)
    plain = replace(vehicle, implementation=replace(vehicle.implementation, sample_period=None, delay=0, quantisation={}))
    controller, omega = Designer(plain, search=False).design("law"), np.array([3.0, 30.0])
    system = loop_system(plain, controller)
    for w, expected in zip(omega, continuous_frequency_response(plain, controller, omega), strict=True):
        found = system.C @ np.linalg.solve(1j * w * np.eye(len(system.A)) - system.A, system.B[:, :1]) + system.D[:, :1]
        assert found.ravel() == pytest.approx(expected.reshape(-1)[: len(found)], rel=1e-9)  # rounding of a solve


def test_the_same_content_has_the_same_bytes(folder, tmp_path, capsys):
    """Exported again, every byte is the same; with another content the token is another, too."""
    assert main(["--part", "vehicle", "--export", str(tmp_path / "again.fmu")]) == 0
    assert (tmp_path / "again.fmu").read_bytes() == (folder / "car2.fmu").read_bytes()
    tokens = set()
    for name in ("law2", "car2", "car3", "float2"):
        text = zipfile.ZipFile(folder / f"{name}.fmu").read("modelDescription.xml").decode()
        tokens.add(re.findall(r'(?:guid|instantiationToken)="({[0-9a-f-]{36}})"', text)[0])
    assert len(tokens) == 4
    folder_of_law = tmp_path / "law"
    with zipfile.ZipFile(folder / "law2.fmu") as archive:
        archive.extractall(folder_of_law)
    capsys.readouterr()
    assert main(["--check", str(folder_of_law / "resources")]) == 0
    assert "all files are as exported" in prose(capsys.readouterr().out)


def test_parts_of_a_universal_file_are_found():
    """A file for both of a Mac's processors begins as one, and each part lies where its header says."""
    parts = [b"a" * 100, b"b" * 20_000]
    whole = _universal(["x86_64-macos", "aarch64-macos"], parts)
    words = np.frombuffer(whole[:48], dtype=">u4").tolist()
    assert words[:2] == [0xCAFEBABE, 2]
    for i, part in enumerate(parts):
        _, _, at, size, align = words[2 + 5 * i : 7 + 5 * i]
        assert at % 2**align == 0
        assert whole[at : at + size] == part
    assert zipfile.ZipFile(io.BytesIO(zip_files({"x": b"1"}))).read("x") == b"1"


@pytest.mark.extra
@pytest.mark.attack
@pytest.mark.skipif(find_spec(ZIG) is None, reason="needs the extra [export]")
@pytest.mark.parametrize("version", VERSIONS)
def test_binaries_for_other_platforms(version, tmp_path, monkeypatch):
    """With the extra, one machine builds for Linux, Windows and macOS: each is a library of that system; ours has our bits."""
    monkeypatch.setattr(fmu, "ZIG", ZIG)
    (tmp_path / "car.toml").write_text(TEXT)
    law = ["--vehicle", str(tmp_path / "car.toml"), "--controller", "law"]
    assert main([*law, "--export", str(tmp_path / "law.fmu"), "--fmi", str(version)]) == 0
    begins = {"so": b"\x7fELF", "dll": b"MZ", "dylib": b"\xca\xfe\xba\xbe" if version == 2 else b"\xcf\xfa\xed\xfe"}
    archive = zipfile.ZipFile(tmp_path / "law.fmu")
    found = [name for name in archive.namelist() if name.startswith("binaries/")]
    assert len(found) == {2: 3, 3: 5}[version]
    for name in found:
        content = archive.read(name)
        assert content.startswith(begins[name.rpartition(".")[2]])
        assert f"fmi{version}DoStep".encode() in content
    one, ours = Slave(tmp_path / "law.fmu"), _law()
    for k, row in enumerate(random_inputs(ours.law, 200, 3)):
        assert one.step(k, row) == ours(row)


def test_the_sources():
    """The folder of the sources has these files."""
    assert {path.name for path in HERE.iterdir()} == {"fmi.c", "fmu.h", "linear.c"}


def test_a_discrete_law_is_called_discrete(tmp_path, capsys):
    """The description of a sampled controller, and the title of a loop that replaces a discrete law, contain this."""
    text = read_vehicle("quarter_car").text.partition("[controllers")[0]
    law = "A = [[0.9]]\nB = [[0.1]]\nC = [[-900.0]]\nD = [[0.0]]\nsample_period = 4e-3\n"
    text += f'[implementation]\nsample_period = 4e-3\n[controllers.mine]\nmeasured = ["sprung_velocity"]\n{law}'
    (tmp_path / "car.toml").write_text(text)
    for part, words in (
        ("controller", "The law is discrete: each step must last 0.004 s"),
        ("loop", "continuous counterpart (Tu"),
    ):
        file = tmp_path / f"{part}.fmu"
        assert main(["--vehicle", str(tmp_path / "car.toml"), "--export", str(file), "--part", part, "--controller", "mine"]) == 0
        assert words in zipfile.ZipFile(file).read("modelDescription.xml").decode()
        assert "continuous time" not in prose(capsys.readouterr().out)
