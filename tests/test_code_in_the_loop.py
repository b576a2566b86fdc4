"""Exported code drives the runs: its bits are the law's, its runs are those of our law, and its rounding is as predicted."""

import dataclasses
import hashlib
import importlib.util
import json
import shutil

import numpy as np
import pytest
from sim.linear.rounding import rounding_effect
from sim.studies.stability.exported_margins import find_exported_margins
from synth.controller.export.rounding import SteadyRounding, steady_rounding
from synth.vehicle.exported_numbers import numbers_object, numbers_rows

from models.common.errors import InputError
from models.laws.linear import LinearLaw
from models.roads.choice import choose_road
from models.roads.road import RoadInput
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.bump import main as bump
from sim.campaign.__main__ import main as campaign
from sim.command.comparison import controllers_of, exported_lines
from sim.inspect.__main__ import main as inspect
from sim.linear.sampled_response import sampled_response
from sim.physics.exported_code import CodeInTheLoop
from sim.physics.simulate import simulate
from sim.report.__main__ import main as report
from sim.report.contents import EXPORTED, pieces_of
from sim.report.exported import exported_section
from sim.report.scope import Exported, Scope
from sim.runs.run import run_controllers, sample_times
from sim.sweep import main as sweep
from synth.__main__ import main as synth
from synth.controller.controller import Controller, Driver, code_of
from synth.controller.export.c_law import PythonStep, exported_law, random_inputs
from synth.controller.export.compiled import CompiledController, ExportedCode, driven_by
from synth.controller.export.fixed_source import source_of
from synth.controller.export.folder import is_law_of
from synth.controller.open_loop import LoopModel
from synth.vehicle.designer import Designer
from tests.commands import attacks, prose
from tests.test_export import BUILT, LAW, needs_cc
from tests.test_export import _given as given

STEP = 1e-3
KINDS = ("quarter_car", "half_car", "full_car")
WIDE = "[limits]\nactuator_force = 50000.0\n"  # never reached
LIMITED = """delay = 2
noise = {sprung_velocity = 0.001}
quantisation = {suspension_deflection = 1e-4}
[limits]
actuator_force = 150.0
"""


def coded(vehicle: Vehicle, driver: Driver, numbers: str, ranges: dict[str, float] | None = None) -> Driver:
    """Returns a controller that its exported code drives."""
    law = exported_law(vehicle, driver, numbers, "law", ranges)
    source = source_of(law, "0" * 64)
    texts = {"law.c": source.source(), "law.h": source.header(), "law_data.h": source.data()}
    return driven_by(driver, ExportedCode(law, texts, numbers))


def road_under(vehicle: Vehicle, seconds: float, seed: int) -> RoadInput:
    """Returns a vehicle on a rough road."""
    road = choose_road("iso8608:class=C").build(vehicle, 20.0, seed, 20.0 * seconds)
    return RoadInput(vehicle, road, sample_times(vehicle, seconds, STEP))


def random_loop(seed: int) -> LoopModel:
    """Returns a stable loop of a random law of high gain: 1 to 12 states, 1 to 4 outputs, 0 to 3 samples of delay."""
    rng, name = np.random.default_rng(seed), KINDS[seed % 3]
    vehicle, passive = read_vehicle(name), given(read_vehicle(name), "passive")
    k, m, signals = int(rng.integers(1, 13)), len(vehicle.linear_model.inputs), list(vehicle.linear_model.measurable)
    q = int(rng.integers(1, min(5, len(signals) + 1)))
    measured = tuple(rng.choice(signals, q, replace=False).tolist())
    A = rng.standard_normal((k, k))
    A *= rng.uniform(0.3, 0.98) / np.abs(np.linalg.eigvals(A)).max()
    B, C, D = rng.standard_normal((k, q)), rng.standard_normal((m, k)), rng.standard_normal((m, q))
    period, gain = float(rng.choice([0.002, 0.005, 0.01])), 1000.0
    how = dataclasses.replace(vehicle.implementation, sample_period=period, delay=int(rng.integers(4)))
    vehicle = dataclasses.replace(vehicle, implementation=how)
    while True:
        law = LinearLaw(A, B, gain * C, gain * D, period)
        loop = LoopModel(vehicle, dataclasses.replace(passive, name="law", measured=measured, law=law), STEP)
        if loop.radius < 0.9999:
            return loop
        gain /= 2


@needs_cc
@pytest.mark.parametrize("samples", [2000, *attacks([30_000])])
def test_the_loop_has_the_bits_of_the_law(samples):
    """What the harness sets in a run is, to the last bit and held between samples, what the exported law gives in Python."""
    vehicle = parse_vehicle(read_vehicle("quarter_car").text + LAW + BUILT + "delay = 1\n" + WIDE)
    driver = coded(vehicle, given(vehicle, "law"), "double")
    law = exported_law(vehicle, given(vehicle, "law"), "double", "law")
    setting, step, acting = CodeInTheLoop([driver], [vehicle], STEP, None), PythonStep(law), np.zeros((1, 1))
    rows, ours = list(random_inputs(law, samples, 3)), []
    for row in rows:
        ours += step(row)
        for _ in range(5):  # steps of 1 ms in a sample of 5 ms
            setting.set(np.array(row), acting)
            assert acting[0, 0] == ours[-1]
    assert np.array_equal(setting.commands(np.repeat(rows, 5, axis=0)[:, None])[::5, 0, 0], ours)


@needs_cc
@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("law", LAW + BUILT + LIMITED),
        *attacks([("law", LAW + BUILT + WIDE), ("I", ""), ("skyhook_linear", None)]),
        ("sky", None),
    ],
)
def test_a_run_is_that_of_our_law(name, text):
    """A run by compiled code is one by our law to rounding, force requests and states included, and has its verdict."""
    vehicle = read_vehicle("quarter_car_semi_active") if text is None else parse_vehicle(read_vehicle("quarter_car").text + text)
    driver = given(vehicle, name) if name in vehicle.linear_names else vehicle.controllers[name].driver()
    on = road_under(vehicle, 1.0, 0)
    both = run_controllers(vehicle, [driver, coded(vehicle, driver, "double")], on.road, on.time)
    assert [run.passed for run in both] == [True, True]
    assert both[0].agreement.verdict == both[1].agreement.verdict
    ours, code = simulate([driver], [on]), simulate([coded(vehicle, driver, "double")], [on])
    scale = np.abs(ours.response.values).max(axis=1)
    off = np.abs(ours.response.values - code.response.values).max(axis=1)
    assert np.all(off <= 1e-7 * scale + 1e-12)  # a reading on the edge of a step may go the other way: 1e-9 was found
    assert code.requested_force == pytest.approx(ours.requested_force, abs=1e-6 * np.abs(ours.requested_force).max())
    assert code.kept == pytest.approx(ours.kept, abs=1e-6 * np.abs(ours.kept).max(initial=1e-9))


@needs_cc
def test_runs_side_by_side_are_those_alone():
    """Code that drives several runs at once keeps a state of its own for each: their numbers are those of single runs."""
    vehicle = parse_vehicle(read_vehicle("quarter_car").text + LAW + BUILT + WIDE)
    driver, roads = coded(vehicle, given(vehicle, "law"), "double"), [road_under(vehicle, 0.5, seed) for seed in (1, 2)]
    together = simulate([driver] * 2, roads)
    for i, road in enumerate(roads):
        assert np.array_equal(together.response.values[i], simulate([driver], [road]).response.values[0])


def effects(numbers: str, seeds: range) -> tuple[list[float], list[float]]:
    """Returns predicted over observed rms, and the largest observed error over its bound, of every signal."""
    rms, share = [], []
    for seed in seeds:
        loop = random_loop(seed)
        on = road_under(loop.vehicle, 2.0, seed)
        response = sampled_response(loop, on)
        if not any(response.peak(name) for name in loop.controller.measured):
            continue  # a force is measured that nothing else moves: the law stays at rest, and rounds nothing
        ranges = {name: float(max(1.5 * response.peak(name), 1e-9)) for name in loop.controller.measured}
        both = [coded(loop.vehicle, loop.controller, each, ranges) for each in (numbers, "double")]
        runs = [simulate([one], [on]).response.run(0) for one in both]
        effect = rounding_effect(loop, exported_law(loop.vehicle, loop.controller, numbers, "law", ranges), response)
        for name in loop.vehicle.linear_model.outputs:
            off = np.abs(runs[0][name] - runs[1][name])
            if effect.rms[name] > 1e-13:  # beside what MuJoCo rounds in double
                rms.append(effect.rms[name] / float(np.sqrt(np.mean(off**2))))
                share.append(float(np.max(off / np.maximum(effect.most[name], 1e-300))))
    return rms, share


@needs_cc
@pytest.mark.parametrize(
    ("numbers", "seeds"),
    [("int16", range(2)), *attacks([("int16", range(2, 5)), ("float", range(5)), ("int32", range(5))])],
)
def test_rounding_is_predicted(numbers, seeds):
    """Rounding moves a signal by less than its bound, always, and in the median by a fifth to five times the predicted rms.

    It is far nearer: 0.27 to 2.6 in single cases of 200 laws in float, 0.99 in the median. Five is what was promised.
    """
    rms, share = effects(numbers, seeds)
    assert len(rms) > 5 * len(seeds)
    assert max(share) < 1
    assert 0.2 < np.median(rms) < 5


@pytest.mark.parametrize("seed", [1, 2])
def test_the_table_of_export_is_that_of_a_run(seed):
    """Rounding for ever, from covariances, is that of a run on a random road, from its own response; the worst case is above."""
    loop = random_loop(seed)
    law, on = exported_law(loop.vehicle, loop.controller, "float", "law"), road_under(loop.vehicle, 20.0, seed)
    steady, response = steady_rounding(LoopModel(loop.vehicle, loop.controller, loop.period), law), sampled_response(loop, on)
    effect, forces = rounding_effect(loop, law, response), loop.vehicle.linear_model.inputs
    assert steady is not None
    # The road of a run is one under both wheels, and not under each its own: it shakes bounce more than pitch.
    assert 0.5 < max(effect.rms[force] / response.rms(force) for force in forces) / steady.rms < 2
    assert max(effect.most[force].max() for force in forces) < steady.most * np.abs(on.velocities).max()


def steady_of(passive: Controller, slow: float, numbers: str, step: float) -> SteadyRounding:
    """Returns the rounding of a law of short coefficients, on a car that is slower by a power of two, with steps of a reading."""
    vehicle, powers = read_vehicle("quarter_car"), {"stiffness": 2, "damping": 1}
    scaled = {name: value / slow ** powers.get(name.split("_")[-1], 0) for name, value in vehicle.parameters.items()}
    period, steps = 0.005 * slow, {"suspension_deflection": step * slow} if step else {}
    how = Implementation(sample_period=period, delay=1, quantisation=steps)
    vehicle = dataclasses.replace(vehicle, parameters=scaled, implementation=how)
    B, D = np.array([[4.0 / slow, -0.5]]), np.array([[-2048.0 / slow**2, -1024.0 / slow]])
    law = LinearLaw(np.array([[0.5]]), B, np.array([[256.0 / slow]]), D, period)
    controller = dataclasses.replace(passive, name="law", measured=("suspension_deflection", "sprung_velocity"), law=law)
    found = steady_rounding(LoopModel(vehicle, controller, period), exported_law(vehicle, controller, numbers, "law"))
    assert found is not None
    return found


def test_rounding_depends_on_no_unit_of_time():
    """In a car four times as slow, of springs a sixteenth as stiff, the share of rounding is the same, and its bound a quarter.

    Its velocities stay, and its forces are a quarter. In double both are less by 29 binary digits; steps of a reading are beside.
    """
    passive, which = given(read_vehicle("quarter_car"), "passive"), ((1.0, "float"), (4.0, "float"), (1.0, "double"))
    one, slower, double = (steady_of(passive, *each, 0.0) for each in which)
    assert (slower.rms, slower.most) == pytest.approx((one.rms, one.most / 4), rel=1e-9)  # of two exponentials
    assert (double.rms, double.most) == pytest.approx((one.rms / 2**29, one.most / 2**29), rel=1e-9)
    coarse = [steady_of(passive, *each, 1e-6) for each in which]
    beside = [other.most - each.most for each, other in zip((one, slower, double), coarse, strict=True)]
    assert beside == pytest.approx([beside[0], beside[0] / 4, beside[0]], rel=1e-6)  # a difference
    assert beside[0] > one.most


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Returns a folder with a vehicle, and its law exported in double and float."""
    folder = tmp_path_factory.mktemp("loop")
    (folder / "car.toml").write_text(read_vehicle("quarter_car").text + LAW + BUILT + WIDE)
    for numbers in ("double", "float"):
        options = ["--controller", "law", "--numbers", numbers]
        assert synth(["--vehicle", str(folder / "car.toml"), *options, "--export", str(folder / numbers)]) == 0
    return folder


@needs_cc
@pytest.mark.parametrize("numbers", ["float", *attacks(["double"])])
def test_the_command_says_what_drives(folders, numbers, capsys):
    """sim.bump with --as agrees throughout, says which numbers drive, and in float what rounding is predicted to do."""
    options = ["--vehicle", str(folders / "car.toml"), "--controller", "law", "--as", str(folders / numbers), "--no-logs"]
    options += ["--duration", "0.5"]
    capsys.readouterr()
    assert bump(options) == 0
    out = capsys.readouterr().out
    said = prose(out)
    assert len(out.splitlines()) <= 24
    assert f"compiled code in {numbers} drives it" in said
    assert "law agrees throughout" in said
    assert ("rounding is predicted" in said) == (numbers == "float")
    assert bump([*options, "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    (run,), exported = printed["runs"], printed["exported"]
    assert run["controller"]["code"]["numbers"] == numbers
    assert [*exported["loops"]] == ["ideal", numbers]
    norm, same = f"{exported['loops'][numbers]['norm']:.7g}", f"in {numbers}: norm and margins are those of the law itself"
    assert (same if numbers == "double" else f"in {numbers}: norm as implemented {norm}, not") in said
    full = prose("\n".join(exported_lines(printed, full=True)))
    assert norm in full
    assert "delay margin, ms" in full
    if numbers == "float":
        force = run["rounding"]["control_force"]
        assert 0 < force["rms"] < force["most"] < 1


@needs_cc
def test_a_log_proves_such_a_run(folders, tmp_path, capsys):
    """From the log of a run in float its code is made again, and MuJoCo makes the same run with it, to the last bit."""
    options = ["--vehicle", str(folders / "car.toml"), "--controller", "law", "--as", str(folders / "float"), "--duration", "0.5"]
    assert bump([*options, "--logs", str(tmp_path)]) == 0
    capsys.readouterr()
    (log,) = tmp_path.glob("*.mcap")
    assert inspect([str(log), "-v"]) == 0
    said = prose(capsys.readouterr().out)
    assert "the spread that is predicted of its rounding to float" in said
    assert "come out as they were logged, to the last bit" in said


CAMPAIGN = """vehicles = ["car.toml"]
controllers = ["passive", "law"]
roads = ["bump"]
speeds = [12.5]
duration = 0.8
[samples]
count = 2
[samples.parameters]
sprung_mass = { uniform = [0.9, 1.1], relative = true }
"""


@pytest.mark.attack
@needs_cc
def test_a_campaign_is_driven_by_code(folders, capsys):
    """A campaign with --as has the results of one without, to rounding. It can be verified, and goes on with that code alone."""
    (folders / "campaign.toml").write_text(CAMPAIGN)
    command = [str(folders / "campaign.toml"), "--json", "--results"]
    found = []
    for name, options in {"ours": [], "code": ["--as", str(folders / "double")]}.items():
        assert campaign([*command, str(folders / name), *options]) == 0
        found.append(json.loads(capsys.readouterr().out)["summary"])
    for ours, code in zip(*found, strict=True):
        assert ours["controller"] == code["controller"]
        assert code["ride"]["rms"] == pytest.approx(ours["ride"]["rms"], rel=1e-9)  # orders of summation
    assert campaign([command[0], "--brief", "--results", str(folders / "code")]) == 0
    assert "compiled code drives law in double" in capsys.readouterr().out
    assert campaign(["--verify", str(folders / "code")]) == 0
    with pytest.raises(InputError, match="the campaign began without this code"):
        campaign([*command, str(folders / "code"), "--as", str(folders / "float")])


@pytest.mark.parametrize(
    ("vehicle", "controller", "said"),
    [
        (LAW + BUILT + WIDE, "I", "is of controller 'law', and --controller gives I"),
        (LAW.replace("4000.0", "4001.0") + BUILT + WIDE, "law", "is of another law than that of controller 'law'"),
        (LAW + BUILT + "delay = 2\n" + WIDE, "law", "delay = 0, and not 2"),
        (LAW + BUILT + "[limits]\nactuator_force = 9.0\n", "law", "actuator_force = 50000.0, and not 9"),
        (None, "law", "sprung_mass = "),
    ],
)
def test_another_folder_is_refused(folders, vehicle, controller, said, tmp_path):
    """Code of another controller, law, sample period, hardware or vehicle is refused in one line."""
    text = read_vehicle("quarter_car").text
    text = text + vehicle if vehicle else text.replace("sprung_mass = 504.5", "sprung_mass = 505.5") + LAW + BUILT + WIDE
    (tmp_path / "car.toml").write_text(text)
    with pytest.raises(InputError, match=said):
        bump(["--vehicle", str(tmp_path / "car.toml"), "--controller", controller, "--as", str(folders / "double"), "--no-logs"])


def test_a_law_that_cannot_be_exported_is_another():
    """A law with a state and no sample period is another than the gain of a folder, and not refused for itself."""
    section = '\n[controllers.law]\nmeasured = ["sprung_velocity"]\n'
    state = "A = [[-1.0]]\nB = [[1.0]]\nC = [[2.0]]\nD = [[3.0]]\n"
    gain, law = (parse_vehicle(read_vehicle("quarter_car").text + section + of) for of in ("gain = [[3.0]]\n", state))
    exported = exported_law(gain, given(gain, "law"), "double", "law")
    assert is_law_of(exported, gain, given(gain, "law"))
    assert not is_law_of(exported, law, given(law, "law"))


@pytest.mark.parametrize("file", ["law.c", "law_data.h", "README.md"])
def test_a_flipped_bit_is_refused(folders, file, tmp_path):
    """A folder in which any bit is flipped drives nothing."""
    shutil.copytree(folders / "double", tmp_path / "copy")
    content = bytearray((tmp_path / "copy" / file).read_bytes())
    content[len(content) // 2] ^= 1
    (tmp_path / "copy" / file).write_bytes(content)
    options = ["--vehicle", str(folders / "car.toml"), "--controller", "law", "--no-logs"]
    with pytest.raises(InputError, match=f"{file}: is changed"):
        bump([*options, "--as", str(tmp_path / "copy")])


def test_without_a_compiler_one_line_says_so(folders, monkeypatch):
    """Without any compiler one line names both ways to one."""
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    from synth.controller.export import compiled

    compiled._library.cache_clear()
    options = ["--vehicle", str(folders / "car.toml"), "--controller", "law", "--no-logs"]
    with pytest.raises(InputError, match="no C compiler is here; install cc, or"):
        bump([*options, "--as", str(folders / "double")])


@needs_cc
@pytest.mark.parametrize(
    ("numbers", "name", "kind"),
    [("float", "II", "quarter_car"), *attacks([("int16", "II", "quarter_car"), ("double", "I", "half_car")])],
)
def test_margins_with_the_code(numbers, name, kind):
    """MuJoCo, driven by the code, loses the loop at the factor and at the delay that are predicted with its numbers."""
    vehicle = parse_vehicle(read_vehicle(kind).text + "\n[implementation]\nsample_period = 0.01\ndelay = 1\n")
    driver = coded(vehicle, given(vehicle, name), numbers, {"sprung_velocity": 2.0})
    assert isinstance(driver, CompiledController)
    found = find_exported_margins(vehicle, driver, 2e-3)
    ideal, held = found.about["loops"].values()
    assert found.agrees
    assert held["margins"]["gain"] == pytest.approx(ideal["margins"]["gain"], rel=1e-5)  # coefficients have 15 bits
    assert held["margins"]["gain"] != ideal["margins"]["gain"] or numbers == "double"
    within = 2e-3 if numbers != "int16" else 0.05  # how closely is looked, see `Bisection` and `COARSE`
    assert found.gain.found == pytest.approx(found.predicted.gain, rel=within)
    assert 0 <= found.delay.unstable - found.predicted.delay <= found.delay.step


@needs_cc
@pytest.mark.attack
def test_a_wrong_margin_is_found_out():
    """Code with a hundredth more gain than its law loses the loop earlier than is predicted, and does not agree."""
    vehicle = read_vehicle("quarter_car")
    driver = coded(vehicle, given(vehicle, "I"), "double")
    assert isinstance(driver, CompiledController)
    assert driver.code is not None
    law = driver.code.law
    code = dataclasses.replace(driver.code, law=dataclasses.replace(law, D=law.D / 1.01))
    found = find_exported_margins(vehicle, dataclasses.replace(driver, code=code), 2e-3)
    assert not found.agrees
    assert found.gain.found == pytest.approx(found.predicted.gain / 1.01, rel=2e-3)  # how closely is looked


@pytest.mark.parametrize("order", [1, -1])
def test_margins_are_compared_where_both_loops_have_them(order):
    """If rounding makes a loop unstable, or stable, the table has its norm, and no margins to compare."""
    margins = dict.fromkeys(("gain", "gain_lower", "phase", "phase_lead", "delay"), 2.0)
    stable = {"norm": 8.0, "promises": 0, "kept": 0, "margins": margins}
    loops = [stable, stable | {"norm": None, "margins": None}][::order]
    rows = numbers_rows({"loops": dict(zip(("ideal", "float"), loops, strict=True)), "rounding": None, "why": ""})
    assert rows == [("norm as implemented", *("8", "infinite")[::order], "")]


def test_dampers_have_no_such_margins():
    """Code that sets coefficients has no margin of forces, and one line says so."""
    vehicle = read_vehicle("quarter_car_semi_active")
    driver = coded(vehicle, given(vehicle, "sky"), "double")
    assert isinstance(driver, CompiledController)
    with pytest.raises(InputError, match="its adjustable dampers get coefficients; leave out --as"):
        find_exported_margins(vehicle, driver, 2e-3)


@pytest.mark.attack
@needs_cc
@pytest.mark.parametrize("numbers", ["float", *attacks(["double"])])
def test_the_section_of_a_report(folders, numbers):
    """The page has the folder, its checksum, and for every signal what rounding does beside what is predicted of it."""
    vehicle, folder = read_vehicle(str(folders / "car.toml")), folders / numbers
    designer = Designer(vehicle, search=False)
    own, coded = (controllers_of(vehicle, ["law"], designer.design, of)[0] for of in (None, folder))
    assert isinstance(own, Controller)
    scope = Scope(vehicle, designer, (own,), STEP, True, print, exported=Exported(folder, coded))
    assert (EXPORTED, "") in pieces_of(scope)
    section, (finding,) = exported_section(scope)
    tables = {table.name: table for table in section.tables}
    facts = {row[0]: row[1] for row in tables["exported"].rows}
    assert facts["folder"] == str(folder)
    assert facts["SHA-256 of its manifest"] == hashlib.sha256((folder / "MANIFEST.sha256").read_bytes()).hexdigest()
    assert facts["format"] == f"C99 in {numbers}, law_step every 5 ms"
    assert finding.state == "holds"
    if numbers == "float":
        for _, _, rms, found, most, farthest in tables["exported-rounding"].rows:
            assert 0.2 < float(rms) / float(found) < 5  # see `test_rounding_is_predicted`
            assert 0 < float(farthest) < float(most)
    loop = {row[0]: row[1:] for row in tables["exported-loop"].rows}
    about = numbers_object(vehicle, own, code_of(coded).law, STEP)
    norms = [one["norm"] for one in about["loops"].values()]
    assert [float(cell) for cell in loop["norm as implemented"][:2]] == pytest.approx(norms, rel=1e-6)  # 7 digits
    assert float(loop["delay margin, ms"][1]) == pytest.approx(1e3 * about["loops"][numbers]["margins"]["delay"], rel=1e-5)


def test_no_folder_of_a_gallery(tmp_path):
    """The page of the gallery is of no vehicle file, and so of no folder."""
    with pytest.raises(InputError, match="--as is of a vehicle file's report"):
        report(["--gallery", "--as", str(tmp_path)])


@needs_cc
@pytest.mark.parametrize("numbers", ["double", "float", "int32", "int16"])
def test_the_loop_in_c_has_the_same_bits(numbers):
    """A single run, which is stepped in C, has the forces and states of one that is stepped by Python, to the last bit."""
    vehicle = parse_vehicle(read_vehicle("quarter_car").text + LAW + BUILT + WIDE)
    driver = coded(vehicle, given(vehicle, "law"), numbers, {"suspension_deflection": 0.05, "sprung_velocity": 0.5})
    seen = np.random.default_rng(0).standard_normal((1000, 2)) * [0.05, 0.5]  # a third leaves its range
    runs = []
    for longest in (0, 400):
        setting, acting, parts = CodeInTheLoop([driver], [vehicle], STEP, None, longest), np.zeros((1, 1)), []
        for start in range(0, 1000, 400):
            block, forces = seen[start : start + 400].copy(), []
            set_next = setting.in_c(block, acting) if setting.in_c else None
            for row in block:
                set_next() if set_next else setting.set(row, acting)
                forces.append(acting[0, 0])
            given_, kept = setting.commands(block[:, None])[:, 0, 0], setting.kept[:, 0]
            parts.append(np.column_stack([forces, given_, kept]))
        runs.append(np.concatenate(parts))
    assert np.array_equal(*runs)
    assert np.any(runs[0][:, 0] != 0)


@needs_cc
@pytest.mark.parametrize(("numbers", "code"), attacks([("int32", 0), ("int16", 1)]))
def test_a_sweep_is_driven_by_quantised_code(numbers, code, tmp_path, capsys):
    """On roads of a tenth of a millimetre a sweep agrees with code in int32; steps of int16 are too coarse there, as it says."""
    ranges = ["--range", "suspension_deflection=0.2", "--range", "sprung_velocity=2"]
    assert synth(["--controller", "I", "--numbers", numbers, *ranges, "--export", str(tmp_path / "ecu")]) == 0
    capsys.readouterr()
    assert sweep(["--controller", "I", "--timestep", "4e-3", "--as", str(tmp_path / "ecu"), "--json"]) == code
    (found,) = json.loads(capsys.readouterr().out)["sweeps"]
    said = "; ".join(found["failures"])
    assert ("rounding to int16 is not in that" in said) == (numbers == "int16")
