"""The READMEs' snippets and recipes work as they stand there, and what they list is what there is."""

import importlib
import json
import re
import subprocess
import sys

import numpy as np
import pytest
from scipy.io import savemat

from models.common.errors import InputError
from models.document.figure import styles
from models.roads.obstacles import Flat
from models.roads.road import Bump
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.__main__ import COMMANDS, OWN, VERBS
from sim.__main__ import main as commands_main
from sim.bump import main
from sim.campaign.file import read_campaign
from sim.linear.sampled_response import taylor4
from sim.runs.by_name import run
from sim.runs.run import sample_times
from sim.studies.command_name import command_of
from sim.studies.ride import over_roads as ride
from synth.design import fallback
from synth.vehicle.designer import Designer
from tests.support import pages
from tests.support.analysed import sampled_response, simulate
from tests.support.commands import main_of, prose
from tests.support.pages import ROOT, section, site


@pytest.fixture
def hopper(tmp_path):
    """The vehicle of "Add a custom vehicle type", its three files written to a folder of its own."""
    return pages.hopper(tmp_path)


def test_own_kind_of_vehicle(hopper, tmp_path, capsys):
    """Three files make a new kind of vehicle: designed, driven, found to agree, logged, by the command of the recipe."""
    assert main(["--vehicle", str(hopper), "--controller", "I", "--logs", str(tmp_path / "logs"), "-v"]) == 0
    assert "the difference comes from RK4's own error" in prose(capsys.readouterr().out)
    assert {path.suffix for path in (tmp_path / "logs").iterdir()} == {".mcap", ".json", ".rrd"}


def test_own_kind_of_vehicle_is_exact(hopper):
    """Its physics is RK4 on its linear model to rounding, as for those that ship."""
    vehicle = read_vehicle(hopper)
    controller, road = Designer(vehicle).design("I"), Bump(height=0.02)
    time = sample_times(vehicle, 1.0, 1e-3)
    physics = simulate([vehicle], [controller], [road], time).response.run(0)
    predicted = sampled_response(vehicle, controller, road, time, exponential=taylor4)
    for name in vehicle.linear_model.outputs:
        assert abs(physics[name] - predicted[name]).max() < 1e-11 * predicted.scale(name)  # rounding of 1000 steps


def test_own_kind_over_random_roads(hopper, monkeypatch, capsys):
    """A vehicle without a force along a suspension is driven over random roads and reported like any other."""
    road = ["--class", "B", "--duration", "2", "--timestep", "2e-3", "--no-logs", "--json"]
    assert main_of("sim.drive")(["--vehicle", str(hopper), "--controller", "I", *road]) in (0, 1)
    (run,) = json.loads(capsys.readouterr().out)["runs"]
    assert run["metrics"]["control_force_rms"]["expected"] > 0
    assert not {"control_power", "control_energy"} & set(run["metrics"])  # no suspension that the force would work on

    monkeypatch.setattr(ride, "CLASSES", "B")
    monkeypatch.setattr(ride, "SEEDS", (0,))
    monkeypatch.setattr(ride, "WINDOW", 1.0)
    vehicle = read_vehicle(hopper)
    rides = [*ride.OverRoads(vehicle, Designer(vehicle).design("I"), 2e-3).rides()]
    rows = ride.ride_section(vehicle, rides, styles(("I",))).tables[0].rows
    assert {"sprung acceleration weighted", "control force rms"} <= {row[2] for row in rows}


@pytest.mark.attack
def test_own_kind_is_reported(hopper):
    """A whole report of it is written."""
    page = hopper.with_name("r.html")
    assert main_of("sim.report")(["--vehicle", str(hopper), "--controller", "I", "--out", str(page), "--timestep", "8e-3"]) == 0
    assert page.read_text(encoding="utf-8").rstrip().endswith("</html>")


def test_unknown_kind_is_named(hopper):
    """A vehicle file whose kind lies nowhere says what is known, and where another would be looked for."""
    hopper.write_text(hopper.read_text().replace('"hopper"', '"hoper"'))
    with pytest.raises(
        ValueError,
        match=r"unknown vehicle type 'hoper'; known: full_car, half_car, half_car_roll, hopper, quarter_car.*hoper\.py",
    ):
        read_vehicle(hopper)


def test_any_plant(capsys):
    """The plant from matrices is designed and certified, in every way of the snippet."""
    (snippet,), (text,) = site("Design for any").blocks("python"), site("Design for any").blocks("text")
    exec(snippet, {})
    out = capsys.readouterr().out
    assert out.startswith(text)
    assert out.count("certificate: holds") == 4
    assert "law: 2 states; poles of 0.09271 to 177.6 rad/s; stable by itself\n  A: [[" in out


def test_a_certificate_is_checked_without_roadproof(tmp_path, monkeypatch, capsys):
    """The page's commands write a certificate, and the program beside it proves what the page shows."""
    one = section("docs/explanation/bound-norm-lower-bound.md", "Check a certificate yourself")
    write, check = one.blocks("sh")[0].splitlines()
    monkeypatch.chdir(tmp_path)
    assert main_of("synth")(write.split()[2:]) == 0
    capsys.readouterr()
    ran = subprocess.run([sys.executable, *check.split()[1:]], capture_output=True, text=True, check=False)
    assert ran.returncode == 0
    assert f"`{ran.stdout.strip()}`" in one.text


def test_plants_from_python(monkeypatch, capsys):
    """The sampled loop's norm is its design's, a discrete plant's is above its lower bound, and many vehicles have a gain."""
    exec(section("docs/how-to/sampled-data-design.md", "From Python").blocks("python")[0], {})
    norm, bound, _, same, *_ = map(float, capsys.readouterr().out.split())
    assert bound <= norm == pytest.approx(same, rel=1e-7)  # both to 1e-8
    with monkeypatch.context() as patch:
        patch.setattr(fallback, "FAR", np.inf)  # without the search from other gains, which ends above the bound, too
        exec(site("Discrete plants").blocks("python")[0], {})
    norm, bound = map(float, capsys.readouterr().out.split()[-2:])
    assert 0 < bound <= norm
    exec(site("Many vehicles").blocks("python")[0].replace("1.3, 100)", "1.3, 4)"), {})  # four of the hundred say as much
    assert capsys.readouterr().out.startswith("[[")
    exec(site("Bands and families").blocks("python")[0] + site("Design a preview").blocks("python")[0], {})
    worst, *proved, value, level, agrees, _ = capsys.readouterr().out.split()[1:]
    largest = max(float(bound.strip("[,]")) for bound in proved)
    assert (float(worst) < largest, float(value) < float(level), agrees) == (True, True, "True")


def test_laws_with_states(tmp_path, capsys):
    """The law in matrices, the one of a MATLAB file and the system of python-control are one controller, certified."""
    parts = (*pages.sections("docs/how-to/dynamic-controllers.md"), site("Load a MAT-file"))
    snippets = [block for part in parts for block in part.blocks("toml")]
    (tmp_path / "car.toml").write_text("\n".join([read_vehicle("quarter_car").text, *snippets]), encoding="utf-8")
    savemat(tmp_path / "mine.mat", {"A": -0.5, "B": [[0.0, 1.0]], "C": -2000.0, "D": [[11000.0, 0.0]], "Ts": 0.0})
    asked = ["--controller", "leaky", "--controller", "of_matlab"]
    assert main_of("synth")(["--vehicle", str(tmp_path / "car.toml"), *asked, "--json"]) == 0
    one, other = json.loads(capsys.readouterr().out)["controllers"]
    assert {**one, "name": ""} == {**other, "name": ""}

    snippet, _ = site("Convert python-control systems").blocks("python")
    exec(snippet, {})
    printed = capsys.readouterr().out
    assert float(printed.split()[0]) == one["norm"]
    assert printed.endswith("['suspension_deflection', 'sprung_acceleration']\n")


def test_functions_and_roads_from_python(capsys):
    """Laws and roads that are written in Python are driven and agree; a gain of python-control does as its certified one."""
    for snippet in (
        *section("docs/how-to/python-control-laws.md", "Pass a function").blocks("python"),
        *(block for one in pages.sections("docs/how-to/custom-roads.md") for block in one.blocks("python")),
        site("Convert python-control systems").blocks("python")[1],
    ):
        shorter = re.sub(r"duration=[\d.]+", "duration=0.5", snippet)
        exec(compile(shorter, "page", "exec"), {"__name__": "page"})
    *lines, _ = capsys.readouterr().out.splitlines()
    assert [line.split()[-2] for line in lines] == ["True"] * 9
    peaks = [float(line.split()[-1]) for line in lines]
    assert peaks[6] == pytest.approx(2.5 * peaks[5], rel=1e-3)  # a ramp as high; geometry is 1e-4 of so low a one
    assert peaks[7] == pytest.approx(peaks[8], rel=1e-9)  # rounding of another order of sums


@pytest.mark.parametrize("height", [lambda t: 0.0, lambda t: np.nan * t], ids=["of no time", "not finite"])
def test_a_road_that_gives_no_heights_is_named(height):
    """A road of one's own that returns other than a finite height for each time is refused by the name of its class."""
    Mine = type("Mine", (Flat,), {"displacement": lambda self, t, side="": height(t)})
    with pytest.raises(
        InputError, match=r"Mine\.displacement\(t\) returned a wrong result; return one finite height \[m\] for each time"
    ):
        run(read_vehicle("quarter_car"), "passive", Mine())


def test_vehicle_file_snippets():
    """The controllers, limits and implementation are accepted in a vehicle file."""
    snippets = [
        *section("docs/tutorials/your-own-car.md", "Add a controller").blocks("toml"),
        *site("Limits").blocks("toml"),
    ]
    vehicle = parse_vehicle(read_vehicle("quarter_car").text + "\n".join(snippets))
    assert {"soft", "mine"} < set(vehicle.controllers)
    assert vehicle.limits.actuator_force == 2000.0
    assert vehicle.implementation.delay == 1


def test_curves_snippet(tmp_path):
    """The curves are read where nothing else gives their parameters, and are what the text says of them."""
    (snippet,) = site("Write a characteristic").blocks("toml")
    (tmp_path / "spring.csv").write_text("deflection [mm], force [kN]\n-80, -1.4\n0, 0\n90, 1.2\n")
    lines = read_vehicle("quarter_car").text.splitlines()
    kept = [line for line in lines if not line.startswith(("suspension_damping =", "suspension_stiffness ="))]
    (tmp_path / "mine.toml").write_text("\n".join([*kept, snippet]))
    vehicle = read_vehicle(tmp_path / "mine.toml")
    assert {*vehicle.curves} == {"suspension_damping", "suspension_stiffness"}
    assert vehicle.parameters["suspension_stiffness"] == pytest.approx((1400 / 0.08 + 1200 / 0.09) / 2)  # the mean of both sides
    assert "suspension_velocity" in vehicle.linear_model.outputs


def test_campaign_snippet(tmp_path):
    """The campaign file is one."""
    (snippet,) = site("Simulate thousands of roads and vehicles").blocks("toml")
    (tmp_path / "campaign.toml").write_text(snippet)
    campaign = read_campaign(tmp_path / "campaign.toml")
    assert len(campaign.seeds) == 100
    assert len(campaign.samples["quarter_car"]) == 16
    assert campaign.settle == 5.0


def test_first_commands():
    """From `git clone` to a picture of one's own car there are five commands, in README.md and in the first tutorial.

    They stand in a block of zsh, so that whoever runs the first sh blocks runs the main job and the tests: `.ci/run` finds its
    three blocks in their order.
    """
    first, *_ = pages.sections("README.md")
    (block,) = first.blocks("zsh")
    assert pages.page("README.md").index(block) < 1400, "the commands are not on the first screen"
    assert [block] == next(iter(pages.sections("docs/tutorials/first-bump.md"))).blocks("zsh")
    clone, *_, new, drive = block.splitlines()
    assert len(block.splitlines()) == 5
    assert clone.startswith("git clone ")
    assert new.startswith("roadproof new ")
    assert drive.split()[-2] == "--picture"
    blocks = re.findall(r"^```(?:sh|bash|shell)[ \t]*\n(.*?)^```", pages.page("README.md"), re.M | re.S)
    assert [word for word, one in zip(("sim.bump", "pytest", "sphinx"), blocks, strict=False) if f"-m {word} " in one] == [
        "sim.bump",
        "pytest",
        "sphinx",
    ]


@pytest.mark.parametrize("page", ["README.md: Five lines of Python", "docs/index.md: First example"])
def test_first_scripts(page, capsys):
    """The first script of the README and of the home page drives and compares, and prints what stands below it."""
    one = section(*page.split(": "))
    (snippet,), (text,) = one.blocks("python"), one.blocks("text")
    exec(compile(snippet.replace("height=0.1)", "height=0.1), duration=0.5"), page, "exec"), {})
    assert capsys.readouterr().out == text


def commands_there_are() -> set[str]:
    """Every module that `python -m` runs, as it is called."""
    files = [path for floor in ("synth", "sim") for path in (ROOT / floor).rglob("*.py")]
    running = [path for path in files if "    from models.common.cli import run\n" in path.read_text(encoding="utf-8")]
    names = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__main__") for path in running}
    studies = {name for name in map(command_of, OWN) if name.startswith("sim ")}  # without a module of their own
    return names - {"sim"} | studies


def rows(text: str) -> list[list[str]]:
    """The cells of a page's tables."""
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("| `")]


def test_table_of_commands(capsys):
    """`python -m sim` names every command with its purpose, as README.md and the titles of the how-to pages do."""
    assert {name for name, _, _ in COMMANDS} == commands_there_are()
    assert commands_main([]) == 0
    printed = capsys.readouterr().out
    front = {row[0].strip("`"): row[1] for row in rows(section("README.md", "The commands").text)}
    headings = [one.heading for name in pages.SITE for one in pages.sections(name)]
    for verb, (_, purpose, options) in zip(VERBS, COMMANDS, strict=True):
        assert f"  {verb:10}  {purpose}\n" in printed
        assert f"  {'':10}  {options}\n" in printed
        assert front[f"roadproof {verb}"] == purpose
        assert f"{purpose} `roadproof {verb}`".lower() in [each.lower() for each in headings]
    assert all(len(line) <= 80 for line in printed.splitlines())


def test_every_room_has_a_line():
    """The pages name the rooms that there are."""
    for floor in ("models", "sim", "synth"):
        found = {row[0].strip("`/") for row in rows(section(f"{floor}/README.md", "The folders").text)}
        assert found == {path.parent.name for path in (ROOT / floor).glob("*/__init__.py")}


def test_equations():
    """Every place that synth/README.md names for an equation is there, and every equation of the method has one."""
    lines = section("synth/README.md", "Where").text.splitlines()
    table = [line.strip("|").split(" | ") for line in lines if line.startswith("| ")]
    equations = {int(number) for equation, *_ in table[1:] for number in re.findall(r"\((\d+)\)", equation)}
    assert {9, 12, 13, 14, 20, 21, 22, 25} <= equations
    for *_, where in table[1:]:
        place = where.strip().strip("`")
        if place.endswith(".toml"):
            assert (ROOT / place).exists()
            continue
        module, rest = place.rsplit(".", 1)
        if not (ROOT / (module.replace(".", "/") + ".py")).exists():
            module, owner = module.rsplit(".", 1)
            rest = f"{owner}.{rest}"
        found = importlib.import_module(module)
        for name in rest.split("."):
            found = getattr(found, name)
