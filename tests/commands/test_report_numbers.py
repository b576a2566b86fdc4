"""The numbers of a report are true: its sentences and tables against independent results."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

from models.document.figure import styles
from models.roads.road import Bump
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.bump import main as bump
from sim.drive.__main__ import main as drive
from sim.envelope import main as envelope
from sim.report.__main__ import main as report
from sim.report.agreement import energy_table
from sim.runs.report import verdict
from sim.runs.run import run_controllers, sample_times
from sim.studies.ride.over_roads import WINDOW, OverRoads, ride_section, ride_texts
from sim.studies.subject import SEEDS, SPEED
from tests.commands.golden import REALITY, golden
from tests.support.commands import attacks
from tests.support.reading import PageRead, read_report

pytest.importorskip("jinja2", reason="a report needs the extra [report]")

NAMES = {"plain": ("passive", "state", "I", "II"), "real": ("passive", "I")}  # of each report
STEP = ("--timestep", "0.0025")  # that of `QUICK`
COARSE = ("--timestep", "0.005")  # where a page is not held against others


def printed(capsys, command, *arguments) -> dict:
    """Returns what a command prints with --json."""
    capsys.readouterr()
    command([*arguments, "--json"])
    return json.loads(capsys.readouterr().out)


def page(folder: Path, *arguments: str, step: tuple[str, str] = STEP) -> PageRead:
    """The page of a report, read."""
    return read_report(folder / "report.html", "--quick", *step, *arguments)


def vehicle_file(folder: Path, extra: str, kind: str = "quarter_car") -> str:
    """A vehicle that ships, with more sections."""
    path = folder / f"{kind}.toml"
    path.write_text(read_vehicle(kind).text + "\n" + extra)
    return str(path)


@pytest.fixture(scope="module")
def plain() -> PageRead:
    """A report of the paper's vehicle as it ships."""
    done = golden("sim.report", "plain")
    return PageRead(done.folder / "report.html", done.json)


@pytest.fixture(scope="module")
def real_file(tmp_path_factory) -> str:
    """The README's example: limits, a sample period, a delay, noise and quantisation."""
    return vehicle_file(tmp_path_factory.mktemp("real"), REALITY)


@pytest.fixture(scope="module")
def real() -> PageRead:
    """A report of that vehicle."""
    done = golden("sim.report", "limits")
    return PageRead(done.folder / "report.html", done.json)


@pytest.mark.attack
def test_dive_is_what_a_drive_says(tmp_path, capsys):
    """The dive of a car under 0.5 g stands on the first screen, as `sim.drive` measures it."""
    read = page(tmp_path, "--vehicle", "half_car", "--controller", "passive", "--controller", "II", step=COARSE)
    road = ("--road", "flat", "--load", "brake:g=0.5", "--duration", "3", "--no-logs", *COARSE)
    runs = printed(capsys, drive, "--vehicle", "half_car", "--controller", "passive", "--controller", "II", *road)["runs"]
    for run in runs:
        row = read.row("compared", controller=run["controller"]["name"])
        dive = run["metrics"]["pitch_angle_dive"]["mujoco"]
        assert float(row["dive under 0.5 g [deg]"]) == pytest.approx(dive, rel=0.03)  # 2 digits


def test_requirements_stand_first(plain, real):
    """What the vehicle file asks for stands before all else, with who keeps it: limits by the run, goals by their proof."""
    assert next(iter(real.tables)) == "requirements"
    for row in real.tables["requirements"]:
        until = float(real.row("bump", controller=row["controller"], signal="control force")["linear until [s]"])
        kept = row["result"] == "✓ not reached"
        assert kept or float(row["result"].removeprefix("✗ at ").removesuffix(" s")) >= until  # of several ends, the first
        assert kept or until < 3
    assert any(row["result"].startswith("✗") for row in real.tables["requirements"])
    assert "requirements" not in plain.tables


@pytest.mark.parametrize("which", ["plain", *attacks(["real"])])
def test_end_of_the_linear_regime(which, request, real_file, tmp_path, capsys):
    """The height at the top is the table's, and on either side of it the other commands see nothing break, and that break."""
    read = request.getfixturevalue(which)
    (headline,) = [text for text in read.answer if "m at 12.5 m/s" in text]
    said = re.findall(r"(\w+) ([\d.]+) m \(([a-z -]+)\)", headline)
    assert [name for name, *_ in said] == list(NAMES[which])
    noiseless = vehicle_file(tmp_path, re.sub(r"(?m)^(noise|quantisation).*\n", "", REALITY))
    vehicle = ["--vehicle", noiseless] if which == "real" else []
    for name, height, end in said:
        row = read.row("regime", controller=name)
        stays, leaves = float(row["MuJoCo stays linear at [m]"]), float(row["and not at [m]"])
        assert height == f"{(stays + leaves) / 2:.4g}"
        assert f"{height} m" in read.row("summary", controller=name).values()
        assert stays < float(row["at [m]"]) < leaves < 1.0025 * stays
        assert row["predicted end"] == row["ended by"] == end
        if name in ("passive", "state"):
            continue
        # The linear prediction of another command, at heights that the page does not have, at the page's very speed.
        axes = ("--vary", f"height:{0.995 * stays}:{1.005 * leaves}:2", "--vary", "speed:12.5:13:2")
        cells = printed(capsys, envelope, "--controller", name, *axes, *STEP, *vehicle)["cells"]
        below, above = (cell for cell in cells if cell["speed"] == 12.5)
        assert (below["broke_first"], below["predicted"]) == (None, None)
        assert (above["broke_first"], above["predicted"]) == (end, end)


def test_passive_by_hand(plain, capsys):
    """The height at which the passive car lifts off is its static tyre deflection over that of a bump of a metre."""
    result = printed(capsys, bump, "--controller", "passive", "--height", "0.2", "--no-logs", *STEP)
    (run,) = result["runs"]
    # Its tyre is longest, not shortest, at its peak: 6.42 mm against 6.13 mm over the paper's bump.
    per_metre = run["signals"]["tyre_deflection"]["peak"]["sampled"] / 0.2
    static = (504.5 + 62.0) * 9.81 / 252000.0
    assert float(plain.row("regime", controller="passive")["at [m]"]) == pytest.approx(static / per_metre, rel=1e-4)


def test_green_only_throughout(plain, real):
    """The box is green where the comparison held throughout; amber where it ended, with when and why."""
    assert (plain.state, real.state) == ("holds", "ends")
    assert "MuJoCo agrees, and every claim holds throughout" in plain.text
    assert all("linear analysis applies until" in said for said in real.answer if said.startswith("Over the paper's bump, "))
    for name in NAMES["real"]:
        until = float(real.row("bump", controller=name, signal="tyre deflection")["linear until [s]"])
        assert until < 0.2
        # What ended over 0.1 m has to end below 0.1 m.
        assert float(real.row("regime", controller=name)["MuJoCo stays linear at [m]"]) < 0.1


def test_every_number_names_its_loop(plain, real):
    """With limits and an implementation the page says what is of which loop, and lists their values, frequencies in Hz."""
    for words in ("±0.08 m", "±2000 N", "60 rad/s", "every 5 ms", "1 sample late", "0.005 rms on sprung_velocity"):
        assert words in real.answer[0]
    norms = real.row("norms", controller="I")
    assert norms["norm, as built"] == norms["reached by a road"]
    assert float(norms["norm, as built"]) > float(real.row("designs", controller="I")["lower bound"])
    assert real.row("norms", controller="passive")["that is"] == "equal to"
    assert "norms" not in plain.tables
    listed = {row["parameter [SI]"]: row["value"] for row in real.tables["vehicle"]}
    limits = {"suspension_stroke": "0.08", "stop_stiffness": "100000", "actuator_force": "2000", "actuator_bandwidth": "60"}
    assert {f"[limits] {name}": value for name, value in limits.items()}.items() <= listed.items()
    built = {"sample_period": "0.005", "delay": "1", "noise of sprung_velocity": "0.005"}
    built |= {"quantisation of sprung_velocity": "0.001"}
    assert {f"[implementation] {name}": value for name, value in built.items()}.items() <= listed.items()
    listed = {row["parameter [SI]"]: row["value"] for row in plain.tables["vehicle"]}
    assert listed["[limits]"] == listed["[implementation]"] == "none"


@pytest.mark.attack
def test_no_height_is_claimed_where_the_analysis_is_not_true(tmp_path):
    """Who does not agree over the paper's bump has no height below which the analysis is true, wherever the page says one."""
    extra = "[implementation]\nquantisation = { sprung_velocity = 0.05, suspension_deflection = 0.01 }\n"
    read = page(tmp_path, "--vehicle", vehicle_file(tmp_path, extra), "--controller", "I", "--controller", "passive", step=COARSE)
    wrong = {name for name in ("I", "passive") if "NOT AGREE" in read.row("summary", controller=name)["over the paper's bump"]}
    assert wrong <= {"I"}  # passive measures nothing
    (said,) = [text for text in read.answer if text.startswith("Over bumps of 5 m")]
    heights = said.split("height of: ")[1].split(".  MuJoCo")[0]
    for name in ("I", "passive"):
        height = read.row("summary", controller=name)["analysis true up to, without its quantisation"]
        assert (height == "none claimed") == (f"{name} 0." not in heights) == (name in wrong)
    assert ("For I, no height is claimed" in read.text) == bool(wrong)


def test_orders(plain, real):
    """MuJoCo is the sampled response to order 4, which is the continuous one to order 1, or 2 without a force.

    Seeds are listed where something is random.
    """
    for row in plain.tables["agreement"]:
        if row["its order"] != "-":
            assert float(row["its order"]) == pytest.approx(4, abs=0.15)
        if row["order of that"] != "-":
            expected = 2 if row["controller"] == "passive" else 1
            # At 2.5 ms the wheel's velocity still has a good part of its difference from the road, of order 2.
            assert expected - 0.2 < float(row["order of that"]) < 2.2
        assert float(row["to sampled"]) <= float(row["allowed"])
    for row in real.tables["agreement"]:
        assert (row["its order"] == "-") or row["controller"] == "passive"
    assert plain.row("provenance", what="seeds")["value"] == "none: nothing is random"
    assert real.row("provenance", what="seeds")["value"] == "0, of the noise on measurements"


@pytest.mark.attack
def test_unstable_as_built(tmp_path):
    """A loop that only its computer makes unstable is named at the top, and is no reason not to write the rest."""
    file = vehicle_file(tmp_path, "[implementation]\ndelay = 30\n")  # 150 ms at 5 ms; II bears 87
    read = page(tmp_path, "--vehicle", file, "--controller", "passive", "--controller", "II", step=COARSE)
    assert read.state == "ends"
    assert "II is stable ideally and UNSTABLE as implemented" in read.text
    assert {row["controller"] for row in read.tables["frequency-responses"]} == {"passive"}
    assert {row["controller"] for row in read.tables["regime"]} == {"passive"}


def test_nothing_stable(tmp_path):
    """A report of nothing but an unstable loop is written, and says so."""
    file = vehicle_file(tmp_path, '[controllers.bad]\nmeasured = ["sprung_velocity"]\ngain = [[1e5]]\n')
    read = page(tmp_path, "--vehicle", file, "--controller", "bad")
    assert "The loop of bad is UNSTABLE" in read.text
    assert read.state == "ends"
    assert "frequency-responses" not in read.tables


@pytest.mark.attack
def test_whole_report_of_the_readme_example(tmp_path, real_file):
    """The whole report of the README's example finishes, with margins and maps."""
    path = tmp_path / "report.html"
    read = read_report(path, "--vehicle", real_file, "--controller", "II", *COARSE)
    assert read.state == "ends", read.answer
    assert len(path.read_bytes()) < 500_000
    assert {"margins", "validity"} <= set(read.tables)


@pytest.mark.parametrize(
    ("more", "left_out"),
    [
        ("", None),
        ("[limits]\nactuator_bandwidth = 60.0\n[implementation]\nsample_period = 0.005\ndelay = 1\n", None),
        ("[limits]\nactuator_force = 2000.0\n", "forces up to ±2000 N"),
        ("[implementation]\ndelay = 1\nnoise = { sprung_velocity = 0.005 }\n", "noise of 0.005 rms on sprung_velocity"),
    ],
)
def test_ride_says_what_its_prediction_leaves_out(paper, more, left_out):
    """The text over the ride table names what the linear loop does not have, and nothing that it does have."""
    said = " ".join(ride_texts(parse_vehicle(paper.text + more)))
    assert f"the sampled linear loop{f', without {left_out}' if left_out else ''}." in said


@pytest.mark.attack
def test_ride_is_what_drive_says(paper, designer, capsys):
    """A row of the ride table is the mean of `python -m sim.drive` over its roads, and its prediction that command's."""
    section_table, _ = ride_section(paper, [*OverRoads(paper, designer.design("I"), 1e-3).rides()], styles(("I",))).tables
    rows = {row[2]: row for row in section_table.rows if row[0] == "C"}
    options = ("--controller", "I", "--class", "C", "--speed", f"{SPEED}", "--no-logs")
    start = printed(capsys, drive, *options, "--seed", "0", "--duration", "20")["measured_from"]
    length = ("--duration", f"{start + WINDOW}")
    runs = [printed(capsys, drive, *options, *length, "--seed", f"{seed}")["runs"][0] for seed in SEEDS]
    for metric in ("sprung_acceleration_weighted", "suspension_deflection_rms", "dynamic_load", "control_force_rms"):
        row, found = rows[metric.replace("_", " ")], [run["metrics"][metric] for run in runs]
        assert float(row[4]) == pytest.approx(np.sqrt(np.mean([one["mujoco"] ** 2 for one in found])), rel=1e-3), (
            metric
        )  # 4 digits
        assert float(row[5]) == pytest.approx(found[0]["expected"], rel=1e-3), metric


def test_a_report_over_a_road_is_that_of_sim_drive(tmp_path, capsys):
    """With --class or --road the comparison and the verdict are of that road, as in `sim.drive`."""
    options = (
        *["--controller", "passive", "--controller", "I", "--class", "B", "--seed", "3", "--speed", "15", "--duration", "1"],
        *STEP,
    )
    whole = printed(capsys, report, "--quick", "--out", str(tmp_path / "report.html"), *options)
    found = printed(capsys, drive, "--no-logs", *options)
    assert whole["compared"] == found["compared"]
    read = PageRead(tmp_path / "report.html", whole)
    assert f"MuJoCo, iso8608:class=B at 15 m/s, seed 3, from {found['measured_from']:.4g} s on" in read.text
    assert not any("paper's bump" in said for said in read.answer)


def test_energy_that_does_not_balance_makes_the_box_red(paper, designer):
    """A run whose energy is not found again fails, although it agrees with the analysis; the table has what is allowed."""
    (run,) = run_controllers(paper, [designer.design("I")], Bump(), sample_times(paper, 0.5, 1e-3))
    assert run.energy is not None
    lost = dataclasses.replace(run, energy=dataclasses.replace(run.energy, residual=2e-3))
    # What half the step leaves may allow more of a run than is usual.
    kept = dataclasses.replace(lost, energy=dataclasses.replace(run.energy, residual=2e-3, allowed=3e-3))
    assert [verdict(one).state for one in (run, lost, kept)] == ["holds", "fails", "holds"]
    assert lost.agreement.agrees
    assert verdict(lost).text.endswith("; energy DOES NOT BALANCE")
    assert [row[-2:] for row in energy_table([kept], "").rows] == [("2.0e-03", "3.0e-03")]
