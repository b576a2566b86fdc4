"""Exported code drives the runs: it has the bits of the law, and its difference from the law's run is measured."""

import dataclasses
import hashlib
import importlib.util
import json
import shutil

import numpy as np
import pytest

from models.common.errors import InputError
from models.roads.choice import choose_road
from models.roads.road import Bump, RoadInput
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.bump import main as bump
from sim.campaign.__main__ import main as campaign
from sim.command.comparison import controllers_of
from sim.inspect.__main__ import main as inspect
from sim.report.exported import exported_section
from sim.report.page import requests_of
from sim.runs.code_effect import code_notes
from sim.runs.report import reasons
from sim.runs.run import run_controllers, sample_times
from sim.studies.subject import Subject
from sim.sweep import main as sweep
from synth.__main__ import main as synth
from synth.controller.controller import AnyController, Controller
from synth.controller.export.c_law import exported_law
from synth.controller.export.c_source import CSource
from synth.controller.export.compiled import ExportedCode
from synth.vehicle.designer import Designer
from tests.commands.test_export import BUILT, LAW, needs_cc
from tests.commands.test_export import _given as given
from tests.support.analysed import simulate_inputs as simulate
from tests.support.commands import attacks, prose

STEP = 1e-3
WIDE = "[limits]\nactuator_force = 50000.0\n"  # never reached
LIMITED = """delay = 2
noise = {sprung_velocity = 0.001}
quantisation = {suspension_deflection = 1e-4}
[limits]
actuator_force = 150.0
"""


def coded(vehicle: Vehicle, driver: AnyController, numbers: str, ranges: dict[str, float] | None = None) -> AnyController:
    """Returns a controller that its exported code drives."""
    law = exported_law(vehicle, driver, numbers, "law", ranges)
    return dataclasses.replace(driver, code=ExportedCode(law, CSource(law, "0" * 64).files, numbers))


def road_under(vehicle: Vehicle, seconds: float, seed: int) -> RoadInput:
    """Returns a vehicle on a rough road."""
    road = choose_road("iso8608:class=C").build(vehicle, 20.0, seed, 20.0 * seconds)
    return RoadInput(vehicle, road, sample_times(vehicle, seconds, STEP))


@needs_cc
@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("law", LAW + BUILT + LIMITED + "force_rate = 2000.0\n"),
        *attacks([("law", LAW + BUILT + LIMITED), ("law", LAW + BUILT + WIDE), ("I", ""), ("skyhook_linear", None)]),
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
    assert both[0].agreement.agrees == both[1].agreement.agrees
    ours, code = simulate([driver], [on]), simulate([coded(vehicle, driver, "double")], [on])
    scale = np.abs(ours.response.values).max(axis=1)
    off = np.abs(ours.response.values - code.response.values).max(axis=1)
    assert np.all(off <= 1e-7 * scale + 1e-12)  # a reading on the edge of a step may go the other way: 1e-9 was found
    assert code.requested_force == pytest.approx(ours.requested_force, abs=1e-6 * np.abs(ours.requested_force).max())
    states = [one.recordings[0].law_states for one in (ours, code)]
    assert states[1] == pytest.approx(states[0], abs=1e-6 * np.abs(states[0]).max(initial=1e-9))


@needs_cc
@pytest.mark.parametrize("numbers", ["double", "int16", *attacks(["float", "int32"])])
def test_what_the_code_changes_is_measured(numbers):
    """The effect of the code is the difference of two runs in MuJoCo, is less in finer numbers, and the run agrees with it."""
    vehicle = read_vehicle("quarter_car")
    law, on = given(vehicle, "I"), road_under(vehicle, 1.0, 1)
    driver = coded(vehicle, law, numbers, {"suspension_deflection": 0.2, "sprung_velocity": 2.0})
    (run,) = run_controllers(vehicle, [driver], on.road, on.time)
    ours, code = (simulate([one], [on]).response.run(0) for one in (law, driver))
    effect = run.agreement.code_effect
    assert effect is not None
    for name in vehicle.linear_model.outputs:
        apart = np.abs(code[name] - ours[name])
        assert (effect.peak(name), effect.rms(name)) == (apart.max(), pytest.approx(np.sqrt(np.mean(apart**2))))
    low, high = {"double": (0, 1e-9), "float": (1e-9, 1e-5), "int32": (1e-12, 1e-6), "int16": (1e-5, 1e-2)}[numbers]
    assert low <= effect.share < high
    assert run.passed


@needs_cc
@pytest.mark.parametrize("numbers", ["float", *attacks(["double"])])
def test_code_of_another_law_does_not_agree(numbers):
    """Code with a fiftieth more gain than its law moves signals by more than is allowed, and the run says so."""
    vehicle = read_vehicle("quarter_car")
    law, on = given(vehicle, "I"), road_under(vehicle, 1.0, 1)
    wrong = coded(vehicle, dataclasses.replace(law, law=law.law.scaled(1.02)), numbers)
    code = dataclasses.replace(coded(vehicle, law, numbers).code, texts=wrong.code.texts)
    (run,) = run_controllers(vehicle, [dataclasses.replace(law, code=code)], on.road, on.time)
    assert not run.passed
    assert "DOES NOT AGREE: exported code changes" in prose(" ".join([one.text for one in reasons(run)]))


@needs_cc
def test_geometry_and_ranges_have_their_words():
    """A half-car with code in int16 agrees, and the cause of its distance from linear analysis is named; so is clipping."""
    vehicle, time = read_vehicle("half_car"), sample_times(read_vehicle("half_car"), 1.0, STEP)
    law = given(vehicle, "I")
    for most, words in ((2.0, "geometry and rounding to int16"), (0.01, "exceeds its range on this road, and is clipped")):
        (run,) = run_controllers(vehicle, [coded(vehicle, law, "int16", dict.fromkeys(law.measured, most))], Bump(), time)
        assert run.passed == (most > 1)
        effect = run.agreement.code_effect
        assert effect is not None
        assert words in prose(" ".join([*code_notes(effect, vehicle), *(one.text for one in reasons(run))]))


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
def test_the_command_says_what_drives(folders, numbers, tmp_path, capsys):
    """sim.bump with --as agrees, says which numbers drive, and how far the run is from that of the law.

    From its log the code is made again, and MuJoCo makes the same run with it, to the last bit.
    """
    options = ["--vehicle", str(folders / "car.toml"), "--controller", "law", "--as", str(folders / numbers), "--duration", "0.5"]
    capsys.readouterr()
    assert bump([*options, "--no-logs"]) == 0
    out = capsys.readouterr().out
    assert len(out.splitlines()) <= 24
    said = f"the controller runs as compiled code in {numbers}; with the control law itself, control_force differs by"
    assert said in prose(out)
    assert "law: MuJoCo agrees with the model; linear analysis applies over the whole run" in prose(out)
    assert bump([*options, "--logs", str(tmp_path), "--json"]) == 0
    (run,) = json.loads(capsys.readouterr().out)["runs"]
    assert run["controller"]["code"]["numbers"] == numbers
    force = run["code_difference"]["control_force"]
    assert 0 < force["rms"] < force["peak"] < (1 if numbers == "float" else 1e-6)
    assert inspect([*map(str, tmp_path.glob("*.mcap")), "-v"]) == 0
    said = prose(capsys.readouterr().out)
    assert ("the difference comes from rounding to float" in said) == (numbers == "float")
    assert "equal the logged ones bit for bit" in said


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
    assert "controllers that run as compiled code: law in double" in capsys.readouterr().out
    assert campaign(["--verify", str(folders / "code")]) == 0
    with pytest.raises(InputError, match="this folder was started without this exported controller"):
        campaign([*command, str(folders / "code"), "--as", str(folders / "float")])


@pytest.mark.parametrize(
    ("vehicle", "controller", "said"),
    [
        (LAW + BUILT + WIDE, "I", "contains code of 'law', but --controller gives I"),
        (LAW.replace("4000.0", "4001.0") + BUILT + WIDE, "law", "the law of controller 'law' has changed since the export"),
        (LAW.replace("sample_period = 0.005\nanti_windup = 5.0\n", "") + WIDE, "law", "sample_period = 0.005 instead of None"),
        (LAW + BUILT + "delay = 2\n" + WIDE, "law", "delay = 0 instead of 2"),
        (LAW + BUILT + "[limits]\nactuator_force = 9.0\n", "law", "actuator_force = 50000.0 instead of 9"),
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


@pytest.mark.parametrize("file", ["law.c", "law_data.h", "README.md"])
def test_a_changed_file_is_refused(folders, file, tmp_path):
    """A folder with a changed file drives nothing."""
    shutil.copytree(folders / "double", tmp_path / "copy")
    (tmp_path / "copy" / file).write_text((tmp_path / "copy" / file).read_text().replace("0", "1", 1))
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
    with pytest.raises(InputError, match="there is no C compiler on this machine; install cc, or"):
        bump([*options, "--as", str(folders / "double")])


@pytest.mark.attack
@needs_cc
def test_the_section_of_a_report(folders):
    """The page has the folder, its checksum, and the measured effect of the code on every signal."""
    vehicle, folder = read_vehicle(str(folders / "car.toml")), folders / "float"
    designer = Designer(vehicle, search=False)
    own, driver = (controllers_of(vehicle, ["law"], designer.design, of)[0] for of in (None, folder))
    assert isinstance(own, Controller)
    scope = Subject(vehicle, designer, (own,), STEP, True, exported_controller=driver)
    assert ("exported", "") in requests_of(scope)
    section = exported_section(scope)
    facts, changes = (dict(zip(*list(zip(*table.rows, strict=True))[:2], strict=True)) for table in section.tables)
    assert (
        facts["SHA-256 of its manifest, which every file matches"]
        == hashlib.sha256((folder / "MANIFEST.sha256").read_bytes()).hexdigest()
    )
    assert facts["format"] == "C99 in float, law_step every 5 ms"
    assert changes["control force"] == "N"
    assert section.state == "holds"


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
    assert ("linear analysis omits rounding to int16" in said) == (numbers == "int16")
