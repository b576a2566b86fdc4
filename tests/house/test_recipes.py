"""The recipes of .github/CONTRIBUTING.md, done in a copy of it."""

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from models.vehicle.vehicle import read_vehicle
from synth.vehicle.designer import Designer
from tests.support.commands import in_the_suite, main_of
from tests.support.pages import ROOT, copied, page, sections
from tests.support.shared import made

EXTENSIONS = "models/common/extensions.py"
KNOWN = read_vehicle("quarter_car").controller_names
MARK = "\n\n# Types of road, with the names"

# Runs what each recipe made, in one process, and prints what each printed.
CODES = """
import contextlib, io, json, sys, traceback
found = {}
for recipe, code in json.load(sys.stdin).items():
    with contextlib.redirect_stdout(io.StringIO()) as out:
        try:
            exec(compile(code, recipe, "exec"), {"__name__": recipe})
        except BaseException:
            print(traceback.format_exc())
    found[recipe] = out.getvalue()
print(json.dumps(found))
"""
# Runs `python -m sim` several times, and prints the exit code and the output of each, or what went to stderr.
CALLS = """
import contextlib, io, json, pathlib, runpy, sys
found = []
for words in CALLS:
    sys.argv = ["sim", *words]
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        try:
            runpy.run_module("sim", run_name="__main__", alter_sys=True)
        except SystemExit as end:
            found.append((end.code, out.getvalue() or err.getvalue()))
print(json.dumps([*found, pathlib.Path("page.html").read_text(encoding="utf-8")]))
"""
MODES = (  # of the study of "Add a study"
    ["modes", "--controller", "I", "--json"],
    ["modes", "--controller", "I"],
    ["modes", "--controller", "away", "--vehicle", "away.toml"],
    ["modes"],
    ["modes", "--help"],
    ["--help"],
    ["report", "--quick", "--controller", "I", "--timestep", "0.005", "--out", "page.html", "--json"],
)
AWAY = "[controllers.away]\nmeasured = ['sprung_velocity']\ngain = [[9e4]]\n"


def register(root, sort, row):
    """Writes a row of a recipe into the table of extensions of a copy, as the first one of its sort."""
    path = root / EXTENSIONS
    source, count = re.subn(rf'(?m)^(    "{sort}": {{.*\n)', rf"\1{row}", path.read_text(encoding="utf-8"))
    assert count == 1
    path.write_text(source, encoding="utf-8", newline="\n")


def _key(root: Path, line: str) -> str:
    path = root / "models" / "vehicle" / "limits_and_implementation.py"
    source, last = path.read_text(encoding="utf-8"), '    seed: Annotated[int, Integer("seed of the noise")] = 0\n'
    assert source.count(last) == 1
    path.write_text(source.replace(last, last + line), encoding="utf-8", newline="\n")
    return """if True:
        from docs.generate import key_sections
        from models import read_vehicle
        from models.common.errors import InputError
        from models.vehicle.file_schema import file_schema
        from models.vehicle.vehicle import parse_vehicle

        def read(value):
            return parse_vehicle(f"{read_vehicle('quarter_car').text}\\n[implementation]\\nwarm_up = {value}").implementation

        print(read('"200 ms"').warm_up, read(0.2).record['warm_up'])
        try:
            read(11)
        except InputError as error:
            print(error)
        print(*[row for row in key_sections()["[implementation]"] if row[0] == "warm_up"])
        print(file_schema("half_car")["properties"]["implementation"]["properties"]["warm_up"]["description"])
    """


def _force_element(root: Path, file: str, line: str) -> str:
    (root / "models" / "parts" / "elements" / "cubic_damper.py").write_text(file, encoding="utf-8")
    register(root, "part", line)
    return """if True:
        from docs.generate import key_sections
        from models import Bump, parse_vehicle, read_vehicle
        from models.common.errors import InputError
        from models.vehicle.file_schema import file_schema
        from sim import run

        text = '[parts.valve]\\nkind = "cubic_damper"\\ndamping = 300\\ncubic = 2000\\n'
        for kind in ("quarter_car", "full_car"):
            car = parse_vehicle(read_vehicle(kind).text + "\\n" + text)
            stiff = parse_vehicle(read_vehicle(kind).text + "\\n" + text.replace("2000", "2100"))
            ((one,), (other,)) = (run(each, "passive", Bump(height=0.05), duration=0.3) for each in (car, stiff))
            print(one.passed, one.agreement.steps.error < 1e-11, abs(one.physics.values - other.physics.values).max() > 1e-5)
        try:
            parse_vehicle(read_vehicle("quarter_car").text + "\\n" + text.replace("300", "-1"))
        except InputError as error:
            print(error)
        print(*[row for row in key_sections()['[parts.NAME] with kind = "cubic_damper"'] if row[0] == "damping"])
        print(file_schema("half_car")["properties"]["parts"]["additionalProperties"]["anyOf"][0]["properties"]["kind"])
    """


def _method_of_design(root: Path, file: str, line: str) -> str:
    minimising = file.replace('of stability")', 'of stability", value=1.0, criterion="H2 norm")')
    (root / "synth" / "design" / "shifted_h2.py").write_text(minimising, encoding="utf-8")
    register(root, "design method", line)
    return """if True:
        from models import Bump, parse_vehicle, read_vehicle
        from models.common.errors import InputError
        from models.vehicle.file_schema import file_schema
        from sim import run
        from synth import Designer, design_feedback

        text = read_vehicle("quarter_car").text + "\\n[controllers.own]\\ndesign = 'shifted_h2'\\n"
        text += "measured = ['sprung_velocity']\\n"
        designer = Designer(parse_vehicle(text))
        own = designer.design("own")
        print(own.certificate.failures, own.certificate.loop.A.shape, own.certificate.stability.growth.max() < -0.5)
        (one,) = run(designer.vehicle, "own", Bump(height=0.05), duration=0.3)
        print(one.passed)
        plant = designer.problem(("sprung_velocity",)).plant
        print(abs(design_feedback(plant, design="shifted_h2").law.A - own.law.A).max() < 1e-9 * abs(own.law.A).max())
        try:
            parse_vehicle(text + "sampled = true")
        except InputError as error:
            print(error)
        schema = file_schema("quarter_car")["properties"]["controllers"]["additionalProperties"]["properties"]
        print("shifted_h2" in schema["design"]["enum"])
        loops = [design_feedback(plant, design="shifted_h2", noise=[rms]).certificate.loop for rms in (0, 0.1)]
        print(loops[1].Bw.shape[1] - loops[0].Bw.shape[1])
        heard = text + "noise = true\\n[implementation]\\nnoise = { sprung_velocity = 0.01 }"
        print(Designer(parse_vehicle(heard)).design("own").remarks[0][-32:])
    """


def _metric(root: Path, file: str, line: str) -> str:
    (root / "campaign.toml").write_text(
        'vehicles = ["quarter_car"]\ncontrollers = ["passive", "II_printed"]\nroads = ["iso8608:class=C"]\n'
        "speeds = [10, 30]\nseeds = 2\nduration = 2\ntimestep = 2e-3\n"
    )
    before = ["--controller", "passive", "--road", "iso8608:class=C", "--duration", "0.5", "--logs", str(root / "earlier")]
    assert main_of("sim.drive")(before) == 0
    (root / "sim" / "studies" / "ride" / "kinds" / "dose_per_km.py").write_text(file, encoding="utf-8")
    register(root, "metric", line)
    return """if True:
        import contextlib, io, json, pathlib
        import numpy as np
        import pyarrow.parquet as pq
        from docs.generate import metric_tables
        from sim.campaign.__main__ import main as campaign
        from sim.drive.__main__ import main as drive
        from sim.inspect.__main__ import main as inspect

        def told(main, *arguments):
            with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.suppress(SystemExit):
                main([*arguments])
            return out.getvalue()

        name, road = "sprung_acceleration_dose_per_km", ["--controller", "passive", "--road", "iso8608:class=C", "--speed", "20"]
        log = str(next(pathlib.Path("earlier").glob("*.mcap")))
        print("the log still proves what it claims" in told(inspect, log))
        result = json.loads(told(drive, *road, "--duration", "2", "--no-logs", "--json"))
        run, km = result["runs"][0]["metrics"], 20 * (2001 - 1000 * result["measured_from"]) / 1e6
        for key in ("mujoco", "expected"):
            print(abs(run[name][key] * km / run["sprung_acceleration_vdv"][key] ** 4 - 1) < 1e-9)
        same = result["compared"]["controllers"][0]["dose_per_km"] == run[name]["mujoco"]
        print(run[name]["unit"], run[name]["approximate"], same)
        print(told(drive, *road, "--duration", "0.5", "--no-logs", "-v").count("m⁴/s⁷/km"))
        best = json.loads(told(campaign, "campaign.toml", "--workers", "1", "--best", "dose_per_km", "--json"))
        table = pq.read_table("campaign-results/results.parquet")
        print(table.schema.field("expected_" + name).metadata[b"unit"].decode())
        own = np.array(table["controller"].to_pylist()) == "passive"
        vdv, speed = (table[key].to_numpy()[own] for key in ("sprung_acceleration_vdv", "speed"))
        compared = best["compared"][0]["controllers"][0]["dose_per_km"]
        print(abs(compared * 501 * 2e-3 * speed.sum() / 1000 / (vdv**4).sum() - 1) < 1e-9)
        least = min(one["dose_per_km"] for one in best["compared"][0]["controllers"])
        print(best["best"][0]["best"]["numbers"] == {"dose_per_km": least})
        print("dose_per_km" in told(campaign, "--help"), "divided by the distance" in metric_tables())
    """


def _driver(root: Path, file: str, line: str) -> str:
    (root / "sim" / "drive" / "drivers" / "relay.py").write_text(file, encoding="utf-8")
    register(root, "driver", line)
    return ""


def _observer(root: Path, file: str, line: str) -> str:
    (root / "sim" / "observers" / "peaks.py").write_text(file, encoding="utf-8")
    register(root, "observer", line)
    return """if True:
        import numpy as np
        from models import Bump, parse_vehicle, read_vehicle
        from sim.drive.case import Case
        from sim.drive.drive import drive
        from sim.drive.drivers.relay import Relay
        from models.common.extensions import OBSERVERS
        from sim.runs.run import run_controllers, sample_times

        text = read_vehicle("quarter_car").text + "\\n[implementation]\\nsample_period = 2e-3\\ndelay = 1\\n"
        vehicle, road = parse_vehicle(text), Bump(height=0.05)
        time, laws = sample_times(vehicle, 0.5, 1e-3), [Relay(f"{n} N", ("sprung_velocity",), n) for n in (100.0, 300.0)]
        runs = run_controllers(vehicle, laws, road, time)
        for one, law in zip(runs, laws):
            force = -law.force * np.sign(one.physics["sprung_velocity"][::2]).repeat(2)
            print(one.passed, np.array_equal(one.physics["control_force"][2:], force[: len(time) - 2]))
        for streamed in (False, True):
            (peaks,) = drive([Case(vehicle, law, road) for law in laws], time, OBSERVERS.load("peaks"), streamed=streamed)
            some = [signal.name != "road_velocity" for signal in runs[0].physics.signals]
            # Heights midway through steps are rounded otherwise in streamed batches.
            recorded = [abs(one.physics.values).max(axis=0) for one in runs]
            print([np.allclose(peak[some], one[some], rtol=1e-12, atol=0) for peak, one in zip(peaks, recorded)])
    """


def _recording(root: Path, file: str, line: str) -> str:
    (root / "sim" / "recording" / "npz_writer.py").write_text(file, encoding="utf-8")
    register(root, "recording", line)
    return """if True:
        import contextlib, io, json
        import numpy as np
        from models import Bump, read_vehicle
        from sim.bump import main
        from sim import run

        with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.suppress(SystemExit):
            main(["--controller", "passive", "--json", "--logs", "recorded"])
        logs = json.loads(out.getvalue())["logs"]
        print([*logs], {path.rpartition("/")[2].partition(".")[0] for path in logs.values()} == {logs["npz"][9:-4]})
        [one] = run(read_vehicle("quarter_car"), "passive", Bump())
        with np.load(logs["npz"]) as arrays:
            print(all(np.array_equal(arrays[f"passive/mujoco/{name}"], one.physics[name]) for name in one.physics.names))
            print(arrays["passive/linear/time"].shape == one.sampled.time.shape)
    """


def _study(root: Path, file: str, line: str) -> str:
    (root / "sim" / "studies" / "modes.py").write_text(file, encoding="utf-8")
    register(root, "study", line)
    (root / "away.toml").write_text(f"{read_vehicle('quarter_car').text}\n{AWAY}")
    return CALLS.replace("CALLS", repr(MODES))


RECIPES = {  # by their headings
    "Add a key to a vehicle file": _key,
    "Add a force element": _force_element,
    "Add a method of design": _method_of_design,
    "Add a driver": _driver,
    "Add an observer": _observer,
    "Add a file to a log": _recording,
    "Add a metric": _metric,
    "Add a study": _study,
}


def _done(*recipes: str) -> dict[str, str]:
    """Returns what the code of some recipes prints, all done in one copy."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        copied(root, "models", "synth", "sim", "tests", "docs")
        shutil.copy(ROOT / "pyproject.toml", root)
        found = {each.heading: each.blocks("python") for each in sections(".github/CONTRIBUTING.md")}
        codes = {recipe: RECIPES[recipe](root, *found[recipe]) for recipe in recipes}
        done = subprocess.run(
            [sys.executable, "-c", CODES],
            input=json.dumps(codes),
            cwd=root,
            env=os.environ | {"PYTHONPATH": folder},
            capture_output=True,
            text=True,
            check=True,
        )
    return json.loads(done.stdout)


@pytest.fixture(params=in_the_suite(["together"], ["together", "alone"]))
def done(request) -> Callable[[str], str]:
    """What the code of a recipe prints: in the suite of all in one copy, in the attacks of each in a copy of its own, too."""
    if request.param == "together":
        return lambda recipe: made(_done, *RECIPES)[recipe]
    return lambda recipe: _done(*(["Add a driver"] if recipe == "Add an observer" else []), recipe)[recipe]


@pytest.mark.attack  # four processes in a copy that has to be compiled
def test_add_a_road(tmp_path):
    """The recipe's road is driven, logged and inspected, and holds in every test of its kind."""
    (road,) = (
        block for each in sections(".github/CONTRIBUTING.md") if each.heading == "Add a road" for block in each.blocks("python")
    )
    copied(tmp_path, "models", "synth", "sim", "tests", "docs", "logs", ".github")
    for file in ("README.md", "pyproject.toml"):
        shutil.copy(ROOT / file, tmp_path)
    path = tmp_path / "models" / "roads" / "obstacles.py"
    source = path.read_text(encoding="utf-8")
    assert source.count(MARK) == 1
    changed = source.replace(MARK, f"\n\n{road}\n{MARK}").replace("WattsHump, Step, ", "WattsHump, Step, Ramp, ")
    path.write_text(changed, encoding="utf-8", newline="\n")
    names = tmp_path / "models" / "vehicle" / "names.py"
    named = names.read_text(encoding="utf-8").replace('"step", ', '"step", "ramp", ')
    names.write_text(named, encoding="utf-8", newline="\n")

    def run(*arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", *arguments],
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(tmp_path)},
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    driven = run("sim.drive", "--road", "ramp:height=0.05", "--duration", "2", "--controller", "I", "--logs", "logs")
    assert "ramp, height 0.05 m" in driven
    (log,) = (tmp_path / "logs").glob("*.mcap")
    assert "the log still proves what it claims" in run("sim.inspect", str(log))
    tested = run("pytest", "-k", "ramp or sizes", "tests/models/test_roads.py")
    assert int(re.findall(r"(\d+) passed", tested)[0]) >= 2  # its derivative, its description


def test_add_a_study(done):
    """The recipe's file and line alone make a study: a command with text, JSON, exit code and help, and a section of the page."""

    def poles(car: str, name: str) -> list[tuple[float, float]]:
        vehicle = read_vehicle(car)
        A = Designer(vehicle).design(name).loop(vehicle).A
        upper = sorted((p for p in np.linalg.eigvals(A) if p.imag >= 0), key=abs)
        return [(abs(p) / (2 * np.pi), -p.real / abs(p)) for p in upper]

    (code, out), (_, printed), (failed, _), missing, (_, its_help), (_, whole), (_, page), written = json.loads(
        done("Add a study")
    )
    modes = [(one["frequency"], one["damping"]) for one in json.loads(out)["modes"]]
    assert (code, modes) == (0, [pytest.approx(mode, rel=1e-9) for mode in poles("quarter_car", "I")])
    assert all(f"{frequency:.3f}" in printed for frequency, _ in modes)
    assert failed == 1
    others = [name for name in KNOWN if name != "I"]  # without an option, the first controller of the file
    assert missing[0] == 0
    assert missing[1].startswith(printed.rstrip())
    assert f"other controllers: {', '.join(others)}; choose one" in " ".join(missing[1].split())
    assert "usage: roadproof modes" in its_help
    assert "modes       list the modes of a closed loop\n" in whole
    shown = [(row["frequency [Hz]"], row["damping ratio"]) for row in json.loads(page)["tables"]["modes"]]
    assert shown == [(f"{frequency:.3f}", f"{damping:.3f}") for frequency, damping in modes]
    assert "Modes of the closed loop" in written


def test_add_a_key(done):
    """The recipe's line alone makes a key: read with its unit, refused in a line, recorded, documented, and known to editors."""
    printed = done("Add a key to a vehicle file")
    meaning = "time from the start in which the controller commands no force"
    assert printed.splitlines() == [
        "0.2 0.2",
        "[implementation] warm_up = 11 is not allowed; give a number from 0 to 10 s",
        f"('warm_up', 's', '{meaning}')",
        f"{meaning} [s]",
    ], printed


def test_add_a_force_element(done):
    """The recipe's file and line alone make an element: read and documented, right in MuJoCo, verdict, energy and expectation."""
    printed = done("Add a force element")
    assert printed.splitlines() == [
        "True True True",
        "True True True",
        "[parts.valve] damping = -1 is not allowed; give a number from 1e-06 to 1e+12 N s/m",
        "('damping', 'N s/m', 'c, damping at low velocity')",
        "{'const': 'cubic_damper'}",
    ], printed


def test_add_a_method_of_design(done):
    """The recipe's file and line alone make a method: for a vehicle and any plant, with a certificate and its own poles."""
    printed = done("Add a method of design")
    assert printed.splitlines() == [
        "() (8, 8) True",
        "True",
        "True",
        '[controllers.own] design = "shifted_h2" cannot be combined with sampled = true: a design for the sampled loop minimises '
        'the norm; choose design = "shifted_h2" (works with anti_windup, noise, lag, control_force) or sampled = true (works '
        'with the two-step design, order = "full", order = 2, structure = "pid")',
        "True",
        "1",
        ", with noise of w on the sensors",
    ], printed


def test_add_a_driver_and_an_observer(done):
    """The recipes' files and lines make both: relays agree with their law, and peaks are those of recordings."""
    printed = done("Add an observer")
    assert printed.splitlines() == ["True True"] * 2 + ["[True, True]"] * 2, printed


def test_add_a_file_to_a_log(done):
    """The recipe's file and line write another file of each log, with the numbers of the run, under a key of `--json`."""
    printed = done("Add a file to a log")
    assert printed.splitlines() == ["['mcap', 'npz', 'layout', 'rerun'] True", "True", "True"], printed


def test_add_a_metric(done):
    """The recipe's file and line alone make a metric: measured, expected, compared over runs by its own rule, an objective."""
    printed = done("Add a metric")
    assert printed.splitlines() == [
        "True",
        "True",
        "True",
        "m4/s7/km False True",
        "1",
        "m4/s7/km",
        "True",
        "True",
        "True True",
    ], printed


def test_recipes_name_what_there_is():
    """Every file that a recipe names is there, and every name of code stands in the code."""
    named = set(re.findall(r"`([\w./]+)`", page(".github/CONTRIBUTING.md")))
    files = {name for name in named if "/" in name}
    assert {name for name in files if "NAME" not in name and not (ROOT / name).exists()} == set()
    ours = [path for folder in ("models", "synth", "sim", "tests", "docs") for path in (ROOT / folder).rglob("*.py")]
    code = " ".join(path.read_text(encoding="utf-8") for path in ours)
    words = set(re.findall(r"\w+", code)) | {"pyright", ".ci/run"}
    assert {part for name in named - files for part in re.findall(r"\w+", name)} - words == set()
