"""The numbers of a report are true: every headline, table and sentence against the commands' own JSON, with the same
parameters."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

from models.common.errors import InputError
from models.figures.figure import styles
from models.roads.road import Bump
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.bump import main as bump
from sim.drive import main as drive
from sim.envelope import main as envelope
from sim.margins import main as margins
from sim.report.__main__ import main as report
from sim.report.agreement import bump_section, energy_table
from sim.report.headline import over_the_bump, worst
from sim.report.ride import SEEDS, SPEED, WINDOW, OverRoads, ride_section, ride_text
from sim.report.scope import Scope
from sim.runs.run import run_controllers, sample_times
from sim.studies.ride.standing import digits
from sim.sweep import main as sweep
from synth.__main__ import main as synth
from synth.vehicle.designer import Designer
from tests import shared
from tests.commands import attacks
from tests.pages import site
from tests.reading import PageRead, number
from tests.test_report import QUICK

pytest.importorskip("jinja2", reason="a report needs the extra [report]")

REALITY, *_ = site("Limits").blocks("toml")
NAMES = ("passive", "state", "I", "II")
STEP = ("--timestep", "0.0025")  # that of `QUICK`
COARSE = ("--timestep", "0.005")  # where a page is not held against others


def printed(capsys, command, *arguments) -> dict:
    """Returns what a command prints with --json."""
    capsys.readouterr()
    command([*arguments, "--json"])
    return json.loads(capsys.readouterr().out)


def page(folder: Path, *arguments: str, step: tuple[str, str] = STEP) -> PageRead:
    """The page of a report, read."""
    path = folder / "report.html"
    assert report(["--quick", *step, "--out", str(path), *arguments]) == 0
    return PageRead(path)


def vehicle_file(folder: Path, extra: str, kind: str = "quarter_car") -> str:
    """A vehicle that ships, with more sections."""
    path = folder / f"{kind}.toml"
    path.write_text(read_vehicle(kind).text + "\n" + extra)
    return str(path)


@pytest.fixture(scope="module")
def plain() -> PageRead:
    """A report of the paper's vehicle as it ships."""
    return PageRead(shared.printed("sim.report", *QUICK).folder / "report.html")


@pytest.fixture(scope="module")
def real_file(tmp_path_factory) -> str:
    """The README's example: limits, a sample period, a delay, noise and quantisation."""
    return vehicle_file(tmp_path_factory.mktemp("real"), REALITY)


@pytest.fixture(scope="module")
def real() -> PageRead:
    """A report of that vehicle."""
    files = {"quarter_car.toml": read_vehicle("quarter_car").text + "\n" + REALITY}
    return PageRead(shared.printed("sim.report", *QUICK, "--vehicle", "quarter_car.toml", files=files).folder / "report.html")


def test_norms(plain, capsys):
    """The norms at the top and the table of designs are what `synth` says."""
    found = {one["name"]: one for one in printed(capsys, synth)["controllers"]}
    for name in NAMES:
        row, one = plain.row("designs", controller=name), found[name]
        assert row["norm"] == f"{one['norm']:.7g}"
        assert row["peak [Hz]"] == f"{one['peak_frequency'] / (2 * np.pi):.5g}"
        assert row["bound"] == (f"{one['bound']:.7g}" if one["bound"] else "-")
        assert f"{name} {one['norm']:.4g}" in plain.answer[0]
    norms = [found[name]["norm"] for name in NAMES]
    assert f"{100 * (1 - min(norms) / norms[0]):.0f} % below the passive" in plain.answer[0]


@pytest.mark.parametrize("which", ["plain", *attacks(["real"])])
def test_summary(which, request):
    """The page's summary agrees with what it says below: norms, what the body feels over the bump, the end of the linear
    regime."""
    read = request.getfixturevalue(which)
    for name in NAMES:
        row, norm = read.row("summary", controller=name), float(read.row("designs", controller=name)["norm"])
        assert row["H-infinity norm"] == f"{norm:.4g}"
        over = read.row("bump", controller=name, signal="sprung acceleration")
        assert float(row["sprung acceleration, rms [m/s²], predicted"]) == pytest.approx(float(over["rms, sampled"]), rel=5e-3)
        assert float(row["in MuJoCo"]) == pytest.approx(float(over["rms, MuJoCo"]), rel=5e-3)  # 3 digits
        ends = read.row("regime", controller=name)
        stays, leaves = float(ends["MuJoCo stays linear at [m]"]), float(ends["and not at [m]"])
        (height,) = [value for heading, value in row.items() if heading.startswith("analysis true up to")]
        assert height == f"{(stays + leaves) / 2:.3g} m"
        until = float(over["linear until [s]"])
        assert row["over the paper's bump"] == ("agrees throughout" if until == 3 else f"agrees until {until:.3g} s")
    norms = {name: float(read.row("designs", controller=name)["norm"]) for name in NAMES}
    below = 100 * (1 - norms["state"] / norms["passive"])
    assert any(f"has the least norm ({norms['state']:.4g}, {below:.0f} % below)" in said for said in read.lead)


def test_the_first_screen_answers(plain):
    """Who is best at what, by how much against passive, and what that costs, is what the table says, in words and in bars."""
    rows = {row["controller"]: row for row in plain.tables["compared"]}
    for heading, verb in (
        ("ride [m/s²]", "rides best"),
        ("dynamic load [-]", "holds the road best"),
        ("peak travel [mm]", "travels least"),
    ):
        unit = heading.partition("[")[2].rstrip("]").replace("-", "")
        less = f"{heading.split(' [')[0].removeprefix('peak ').replace('dynamic', 'tyre')}, %"
        changes = {name: f" {row[less].replace('-', '−')} %" if row[less] != "-" else "" for name, row in rows.items()}
        bars = [f"{name}: {row[heading].rstrip('*')}{changes[name]}{' ★' * ('*' in row[heading])}" for name, row in rows.items()]
        assert f"{'. '.join(bars)}." in plain.text
        for name in [name for name, row in rows.items() if row[heading].endswith("*")]:
            (said,) = [said for said in plain.lead if said.startswith((f"{name} ", f"{name},"))]
            change = rows[name][less]
            size = f"{rows[name][heading].rstrip('*')} {unit}".rstrip()
            assert f"{verb} ({size}{f', {change[1:]} % below' if change != '-' else ''})" in said
            if name != "passive":
                assert f"forces of up to {rows[name]['force, peak [N]'].rstrip('*')} N" in said
    assert plain.headline.startswith("I rides best, ")


@pytest.mark.attack
def test_dive_is_what_a_drive_says(tmp_path, capsys):
    """The dive of a car under 0.5 g stands on the first screen, as `sim.drive` measures it."""
    read = page(tmp_path, "--vehicle", "half_car", "--controller", "passive", "--controller", "II", step=COARSE)
    road = ("--road", "flat", "--load", "brake:g=0.5", "--duration", "3", "--no-logs", *COARSE)
    runs = printed(capsys, drive, "--vehicle", "half_car", "--controller", "passive", "--controller", "II", *road)["runs"]
    for run in runs:
        row = read.row("compared", controller=run["controller"]["name"])
        assert float(row["dive under 0.5 g [deg]"]) == pytest.approx(
            run["metrics"]["pitch_angle_dive"]["mujoco"], rel=0.03
        )  # 2 digits
    turned = [row for row in read.tables["agreement"] if row["allowed"] == "geometry"]
    # What bodies that turn make of a difference does not go with the step, so of none of it an order is printed.
    assert turned
    assert {(row["its order"], row["order of that"]) for row in turned} == {("-", "-")}


def test_requirements_stand_first(tmp_path, real):
    """What the vehicle file asks for stands before all else, with who keeps it: limits by the run, goals by their proof."""
    assert next(iter(real.tables)) == "requirements"
    for row in real.tables["requirements"]:
        until = float(real.row("bump", controller=row["controller"], signal="control force")["linear until [s]"])
        kept = row["result"] == "✓ not reached"
        assert kept or float(row["result"].removeprefix("✗ at ").removesuffix(" s")) >= until  # of several ends, the first
        assert kept or until < 3
    assert any(row["result"].startswith("✗") for row in real.tables["requirements"])
    assert "requirements" not in PageRead(shared.printed("sim.report", *QUICK).folder / "report.html").tables


def test_who_is_best_is_what_a_bump_says(plain, capsys):
    """A quick report compares controllers as `sim.bump` does over the paper's bump, on its page and in `--json`."""
    said = printed(capsys, bump, *(f"--controller={name}" for name in NAMES), "--duration", "3", "--no-logs", *STEP)["compared"]
    assert shared.printed("sim.report", *QUICK).json["compared"] == said
    passive = said["controllers"][0]
    for one in said["controllers"]:
        row, name = plain.row("compared", controller=one["controller"]), one["controller"]
        assert row["peak travel [mm]"] == f"{digits(1e3 * one['peak_travel'])}{'*' * (name in said['best']['peak_travel'])}"
        assert row["ride [m/s²]"] == f"{digits(one['ride'])}{'*' * (name in said['best']['ride'])}"
        assert row["ride, %"] == (f"{100 * (one['ride'] / passive['ride'] - 1):+.0f}" if one is not passive else "-")


def test_one_unit_of_frequency(plain, real):
    """Frequencies are in Hz; only what stands in the vehicle file in rad/s is quoted so, beside its Hz."""
    said = "a bandwidth in rad/s. All other frequencies on this page are in Hz."
    for read in (plain, real):
        assert said in read.text
    assert plain.text.replace(said, "").count("rad/s") == 0
    rest = real.text.replace(said, "").replace("lag from 9.549 Hz on (60 rad/s)", "")
    assert rest.count("rad/s") == 0
    assert rest != real.text


@pytest.mark.parametrize("which", ["plain", *attacks(["real"])])
def test_bump_table(which, request, real_file, capsys):
    """Peaks, rms and differences over the paper's bump are what `sim.bump` says."""
    read = request.getfixturevalue(which)
    vehicle = ["--vehicle", real_file] if which == "real" else []
    asked = [part for name in NAMES for part in ("--controller", name)]
    result = printed(capsys, bump, *asked, *vehicle, *STEP, "--no-logs")
    rows = 0
    for run in result["runs"]:
        name = run["controller"]["name"]
        for signal, one in run["signals"].items():
            agreement = read.row("agreement", controller=name, signal=signal.replace("_", " "))
            assert agreement["to sampled"] == f"{one['error']['sampled']:.1e}"
            assert agreement["to continuous"] == f"{one['error']['continuous']:.1e}"
            if signal in read_vehicle("quarter_car").performance:
                row = read.row("bump", controller=name, signal=signal.replace("_", " "))
                for kind in ("peak", "rms"):
                    for mine, theirs in (("MuJoCo", "mujoco"), ("sampled", "sampled"), ("continuous", "continuous")):
                        assert row[f"{kind}, {mine}"] == f"{one[kind][theirs]:.5g}"
                rows += 1
    assert rows == len(read.tables["bump"]) == 16


@pytest.mark.parametrize("which", attacks(["plain", "real"]))
def test_frequency_responses(which, request, real_file, capsys):
    """The errors of the lines, and the headline's bound on them, are what `sim.sweep` says."""
    read = request.getfixturevalue(which)
    vehicle = ["--vehicle", real_file, "--controller", "II"] if which == "real" else []
    asked = vehicle or ["--controller", "passive", "--controller", "I"]
    result = printed(capsys, sweep, *asked, *STEP)
    errors = []
    for one in result["sweeps"]:
        row = read.row("frequency-responses", controller=one["controller"])
        largest = {key: max(signal["error"][key] for signal in one["signals"].values()) for key in ("sampled", "continuous")}
        assert row["error to sampled"] == f"{largest['sampled']:.1e}"
        assert row["to continuous"] == f"{largest['continuous']:.1e}"
        assert row["order of the two"] == (f"{one['order']:.2f}" if one["order"] is not None else "-")
        errors.append(largest["sampled"])
        if which == "real":
            # The sweep's road is held over every step of 2.5 ms, which takes what is above 10 Hz by (0.08)^2 / 24.
            built = float(read.row("norms", controller=one["controller"])["norm, as built"])
            assert built == pytest.approx(one["norm"]["sampled"], rel=0.1)
    (bound,) = re.findall(r"Every frequency response in MuJoCo is within (\S+) of the exact", " ".join(read.answer))
    bound = number(bound)
    assert max(errors) <= bound
    largest = max(float(row["error to sampled"]) for row in read.tables["frequency-responses"])
    assert bound <= 1.1 * max(largest, *errors)


@pytest.mark.parametrize("which", ["plain", *attacks(["real"])])
def test_end_of_the_linear_regime(which, request, real_file, tmp_path, capsys):
    """The height at the top is the table's, and on either side of it the other commands see nothing break, and that break."""
    read = request.getfixturevalue(which)
    (headline,) = [text for text in read.answer if "m at 12.5 m/s" in text]
    said = re.findall(r"(\w+) ([\d.]+) m \(([a-z -]+)\)", headline)
    assert [name for name, *_ in said] == list(NAMES)
    noiseless = vehicle_file(tmp_path, re.sub(r"(?m)^(noise|quantisation).*\n", "", REALITY))
    vehicle = ["--vehicle", noiseless] if which == "real" else []
    for name, height, end in said:
        row = read.row("regime", controller=name)
        stays, leaves = float(row["MuJoCo stays linear at [m]"]), float(row["and not at [m]"])
        assert height == f"{(stays + leaves) / 2:.3g}"
        assert stays < float(row["at [m]"]) < leaves < 1.0025 * stays
        assert row["predicted end"] == row["ended by"] == end
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
    """A box is green where the comparison held throughout, and says so; amber where it ended, and says when and why."""
    assert plain.state == "holds"
    assert "throughout its 3 s for passive, state, I and II" in plain.text
    assert real.state == "ends"
    for name in NAMES:
        row = real.row("bump", controller=name, signal="tyre deflection")
        until = float(row["linear until [s]"])
        assert until < 0.2
        sentence = (
            f"{name} agrees with the linear analysis of the loop as built until {until:.3g} s of 3 s: a suspension meets its bump"
        )
        assert sentence in " ".join(real.answer)
        assert f"{name}: bump stop: a suspension is at the end of its stroke first at {until:.4g} s." in real.text
        # What ended over 0.1 m has to end below 0.1 m.
        assert float(real.row("regime", controller=name)["MuJoCo stays linear at [m]"]) < 0.1


def test_every_number_names_its_loop(plain, real):
    """With limits and an implementation the page says what is of which loop, and lists their values."""
    assert "The ideal loop is continuous, with no limits and no computer" in real.answer[0]
    for words in (
        "±0.08 m",
        "±2000 N",
        "60 rad/s",
        "every 5 ms",
        "1 sample late",
        "0.005 rms on sprung_velocity",
        "steps of 0.001",
    ):
        assert words in real.answer[0]
    assert real.answer[1].startswith("H-infinity norms of the ideal loop: passive 35.07")
    assert "As built, without its noise and quantisation, at a step of 2.5 ms: passive 35.07" in real.answer[1]
    listed = {row["parameter [SI]"]: row["value"] for row in real.tables["vehicle"]}
    assert listed["[limits] suspension_stroke"] == "0.08"
    assert listed["[limits] stop_stiffness"] == "100000"
    assert listed["[limits] actuator_force"] == "2000"
    assert listed["[limits] actuator_bandwidth"] == "60"
    assert listed["[implementation] sample_period"] == "0.005"
    assert listed["[implementation] delay"] == "1"
    assert listed["[implementation] noise of sprung_velocity"] == "0.005"
    assert listed["[implementation] quantisation of sprung_velocity"] == "0.001"
    listed = {row["parameter [SI]"]: row["value"] for row in plain.tables["vehicle"]}
    assert listed["[limits]"] == listed["[implementation]"] == "none"
    assert "as built" not in plain.text


def test_no_sentence_stands_above_noise(plain, real):
    """The effect of RK4 and the step is said of runs without noise only; seeds are listed where something is random."""
    assert plain.row("provenance", what="seeds")["value"] == "none: nothing is random"
    assert real.row("provenance", what="seeds")["value"] == "0, of the noise on measurements"
    for row in real.tables["agreement"]:
        assert (row["its order"] == "-") or row["controller"] == "passive"
    assert "tends to the continuous one with order 1" in plain.text
    assert "tends to the continuous one with order 1" not in real.text
    assert "does not tend to the continuous one" in real.text
    assert "held to six of the standard deviations" in real.text
    assert "standard deviations that the noise" not in plain.text
    (bumps,) = [caption for caption in real.captions if "Response to the bump" in caption]
    assert "Lines: linear analysis of the loop as it runs, a sample every 5 ms, forces that act 1 sample late" in bumps


@pytest.mark.attack
def test_what_blurs_is_left_out_in_words_only(real, tmp_path, capsys):
    """Wherever runs are made without noise and quantisation, that is said, with the names of what the file has of them."""
    assert "of the loop as built, without its noise and quantisation." in " ".join(real.answer)
    assert "As built, without its noise and quantisation, at a step of" in real.answer[1]
    assert "analysis true up to, without its noise and quantisation" in real.tables["summary"][0]
    (swept,) = [caption for caption in real.captions if "response to road velocity" in caption]
    assert "identified without its noise and quantisation on roads" in " ".join(swept.split())
    for part in ("Bumps of 5 m at 12.5 m/s, over 3 s at 2.5 ms", "on roads of 0.1 mm"):
        assert f"{part}, without its noise and quantisation:" in real.text
    assert "or noise or quantisation, so where" in real.text

    file = vehicle_file(tmp_path, "[implementation]\nquantisation = { sprung_velocity = 0.05 }\n")
    arguments = ("--vehicle", file, "--controller", "II", "--timestep", "0.005")
    (one,) = printed(capsys, sweep, *arguments)["sweeps"]
    assert one["without"] == "quantisation"
    sweep(list(arguments))
    text = capsys.readouterr().out
    assert "its loop as built, but without its quantisation" in text
    assert "II  agrees without its quantisation: every line" in text


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
    assert ("For I no height is claimed" in read.text) == bool(wrong)


def test_orders(plain):
    """MuJoCo is the sampled response to order 4, and that the continuous one to order 1, or 2 without a force."""
    for row in plain.tables["agreement"]:
        if row["its order"] != "-":
            assert float(row["its order"]) == pytest.approx(4, abs=0.15)
        if row["order of that"] != "-":
            expected = 2 if row["controller"] == "passive" else 1
            # At 2.5 ms the wheel's velocity still has a good part of its difference from the road, of order 2.
            assert expected - 0.2 < float(row["order of that"]) < 2.2
        assert float(row["to sampled"]) <= float(row["allowed"])


def test_sample_period_is_checked_first(tmp_path, monkeypatch):
    """A timestep that does not divide the controller's sample period is refused in a line, before any design."""
    monkeypatch.setattr("synth.vehicle.designer.Designer.design", None)
    file = vehicle_file(tmp_path, "[implementation]\nsample_period = 0.005\n")
    with pytest.raises(InputError, match=r"sample_period = 0\.005 s is no multiple of the timestep, 0\.002 s"):
        report(["--vehicle", file, "--timestep", "0.002", "--out", str(tmp_path / "r.html")])


@pytest.mark.attack
def test_unstable_as_built(tmp_path):
    """A loop that only its computer makes unstable is named at the top, and is no reason not to write the rest."""
    file = vehicle_file(tmp_path, "[implementation]\ndelay = 30\n")  # 150 ms at 5 ms; II bears 87
    read = page(tmp_path, "--vehicle", file, "--controller", "passive", "--controller", "II", step=COARSE)
    assert read.state == "ends"
    assert "II is stable ideally and UNSTABLE as built" in read.text
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
def test_whole_report_of_the_readme_example(tmp_path, real_file, capsys):
    """The whole report of the README's example finishes, and its margins and its map are what the commands say."""
    path = tmp_path / "report.html"
    assert report(["--vehicle", real_file, "--controller", "II", "--out", str(path), *COARSE]) == 0
    read = PageRead(path)
    assert read.state == "ends", read.answer
    assert len(path.read_bytes()) < 500_000
    ride = read.row("ride", controller="II", metric="sprung acceleration weighted", **{"class": "C"})
    summary = read.row("summary", controller="II")
    assert float(summary["in MuJoCo"]) == pytest.approx(float(ride["MuJoCo"]), rel=5e-3)  # 3 digits
    assert read.row("compared", controller="II")["ride [m/s²]"] == f"{digits(float(ride['MuJoCo']))}*"
    assert float(read.row("compared", controller="passive")["ride [m/s²]"]) > float(ride["MuJoCo"])
    assert "Ride over roads of the classes A, very good, to D, poor" in " ".join(read.captions)
    found = printed(capsys, margins, "--controller", "II", "--vehicle", real_file)
    for name, key, factor in (
        ("delay [ms]", "delay", 1e3),
        ("sample period [ms]", "sample_period", 1e3),
        ("phase lag [rad]", "phase", 1),
    ):
        row = read.row("margins", controller="II", margin=name)
        for mine, theirs in (("predicted", "predicted"), ("MuJoCo", "found")):
            assert row[mine] == f"{factor * found[key][theirs]:.5g}"
    assert read.row("robustness", controller="II")["worst norm"] == f"{found['robustness']['worst_norm']:.5g}"

    axes = ("--vary", "height:0.02:0.3:20", "--vary", "speed:3:30:20", *COARSE)
    noiseless = vehicle_file(tmp_path, re.sub(r"(?m)^(noise|quantisation).*\n", "", REALITY))
    cells = printed(capsys, envelope, "--controller", "II", "--vehicle", noiseless, *axes)["cells"]
    row = read.row("validity", controller="II")
    assert row["linear analysis holds"] == f"{100 * np.mean([cell['holds'] for cell in cells]):.1f} %"
    assert row["nothing breaks"] == f"{100 * np.mean([cell['broke_first'] is None for cell in cells]):.1f} %"
    for end in ("lift-off", "bump stop", "force saturation", "flat tyre"):
        assert row[f"{end} first"] == f"{100 * np.mean([cell['broke_first'] == end for cell in cells]):.1f} %"
    assert row["as predicted"] == f"{100 * np.mean([cell['agrees'] for cell in cells]):.2f} %"
    assert (
        "each run in MuJoCo at 5 ms, without its noise and quantisation: what" in read.text
    )  # twice the step does not divide 5 ms


@pytest.mark.parametrize(
    ("more", "left_out"),
    [
        ("", None),
        ("[limits]\nactuator_bandwidth = 60.0\n[implementation]\nsample_period = 0.005\ndelay = 1\n", None),
        ("[limits]\nactuator_force = 2000.0\nactuator_bandwidth = 60.0\n", "forces up to ±2000 N"),
        ("[implementation]\ndelay = 1\nnoise = { sprung_velocity = 0.005 }\n", "noise of 0.005 rms on sprung_velocity"),
    ],
)
def test_ride_says_what_its_prediction_leaves_out(paper, more, left_out):
    """The text over the ride table names what the linear loop does not have, and nothing that it does have."""
    said = re.search(r"sampled linear loop(.*?)\. Both", ride_text(parse_vehicle(paper.text + more)))
    assert said is not None
    assert said[1] == (f", which leaves out {left_out}" if left_out else "")


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


@pytest.mark.attack
def test_a_norm_as_built(tmp_path, plain, capsys):
    """The norm as built is what `synth` says, never below what no controller can beat, and how far it is from the ideal one."""
    file = vehicle_file(tmp_path, "[implementation]\nsample_period = 0.005\ndelay = 1\n")
    read = page(tmp_path, "--vehicle", file, "--controller", "passive", "--controller", "I", step=COARSE)
    row, said = (
        read.row("norms", controller="I"),
        printed(capsys, synth, "--vehicle", file, "--controller", "I")["controllers"][0],
    )
    assert row["norm, as built"] == row["reached by a road"] == f"{said['sampled_norm']:.7g}"
    assert float(row["norm, as built"]) > float(read.row("designs", controller="I")["lower bound"])
    assert row["that is"] == f"{100 * (said['sampled_norm'] / said['norm'] - 1):.2g} % above"
    assert read.row("norms", controller="passive")["that is"] == "equal to"
    assert "norms" not in plain.tables


def test_a_report_over_a_road_is_that_of_sim_drive(tmp_path, capsys):
    """With --class or --road the first table, the metrics and the verdict are of that road, as `sim.drive` has them."""
    options = (
        "--controller",
        "passive",
        "--controller",
        "I",
        "--class",
        "B",
        "--seed",
        "3",
        "--speed",
        "15",
        "--duration",
        "4",
        *STEP,
    )
    whole = printed(capsys, report, "--quick", "--out", str(tmp_path / "report.html"), *options)
    found = printed(capsys, drive, "--no-logs", *options)
    assert whole["compared"] == found["compared"]
    rows = {(row["metric"], row["controller"]): row for row in whole["tables"]["road"]}
    for run in found["runs"]:
        for name, one in run["metrics"].items():
            row = rows[name.replace("_", " "), run["controller"]["name"]]
            assert (row["MuJoCo"], row["expected"]) == tuple(
                "-" if value is None else f"{value:.4g}" for value in (one["mujoco"], one["expected"])
            )
    read = PageRead(tmp_path / "report.html")
    assert f"MuJoCo, iso8608:class=B at 15 m/s, seed 3, from {found['measured_from']:.4g} s on" in read.lead[-1]
    assert "Over the road MuJoCo agrees with the linear analysis throughout its 4 s for passive and I" in read.text
    assert "MuJoCo agrees with the analysis, over the road throughout" in read.text
    assert not any("paper's bump" in said for said in (*read.lead, *read.answer))


def test_a_report_without_a_road_has_no_speed(tmp_path):
    """Speed, seed and duration of a road that is not given are refused, as are two roads, before the work."""
    for options, words in (
        (("--speed", "9"), "--speed is of a road, and none is given"),
        (("--class", "B", "--road", "flat"), "not both"),
    ):
        with pytest.raises(InputError, match=words):
            report(["--quick", "--out", str(tmp_path / "no.html"), *options])


def test_energy_table(plain, capsys):
    """The report's energies are those of the command, and leave over what it says, of what it allows."""
    for name in NAMES:
        found = printed(capsys, bump, "--controller", name, "--no-logs", *STEP)["runs"][0]["energy"]
        row = plain.row("energy", controller=name)
        for key in ("road", "actuators", "stored", "dissipated"):
            assert row[f"{key} [J]"] == f"{found[key]:.5g}"
        assert row["turned over [J]"] == f"{found['turnover']:.5g}"
        assert row["left over"] == f"{found['residual']:.1e}"
        assert row["allowed"] == f"{found['allowed']:.1e}"


def test_energy_that_does_not_balance_makes_the_box_red(paper, designer):
    """A run whose energy is not found again fails in the answer, and only there, although it agrees with the analysis."""
    time = sample_times(paper, 0.5, 1e-3)
    (run,) = run_controllers(paper, [designer.design("I")], Bump(), time)
    scope = Scope(paper, designer, (designer.design("I"),), 1e-3, True, print)
    assert worst(over_the_bump(scope, [run])) == "holds"
    assert run.energy is not None
    lost = dataclasses.replace(run, energy=dataclasses.replace(run.energy, residual=2e-3))
    assert (run.passed, lost.passed, lost.agreement.agrees) == (True, False, True)
    said = over_the_bump(scope, [lost])
    assert worst(said) == "fails"
    assert said[-1].text == "Over the paper's bump energy DOES NOT BALANCE for `I`: see the table of energy."
    # What half the step leaves may allow more of a run than is usual: the table says how much of which.
    kept = dataclasses.replace(lost, energy=dataclasses.replace(run.energy, residual=2e-3, allowed=3e-3))
    assert worst(over_the_bump(scope, [kept])) == "holds"
    assert [row[-2:] for row in energy_table([run, kept], scope.where).rows] == [
        (f"{one.residual:.1e}", f"{one.allowed:.1e}") for one in (run.energy, kept.energy) if one is not None
    ]


def test_an_unstable_controller_leaves_the_others_to_be_seen():
    """Beside a loop that grows without bound the axes of the bump are of the others' size; it is drawn, too."""
    vehicle = parse_vehicle(
        read_vehicle("quarter_car").text + '\n[controllers.bad]\nmeasured = ["sprung_velocity"]\ngain = [[60000.0]]\n',
        source="bad",
    )
    designer = Designer(vehicle)
    controllers = tuple(designer.design(name) for name in ("passive", "I_printed", "bad"))
    scope, time = Scope(vehicle, designer, controllers, 1e-3, True, print), sample_times(vehicle, 3.0, 1e-3)
    runs = run_controllers(vehicle, controllers, Bump(), time)
    assert runs[2].broke_off is not None
    (figure,) = bump_section(scope, runs, Bump()).figures
    for panel in figure.panels:
        assert panel.ylim is not None
        others = [curve.y for curve in panel.curves if len(curve.y) and "bad" not in curve.label + curve.name]
        least, most = (float(end(np.concatenate(others))) for end in (np.min, np.max))
        assert panel.ylim[0] < least < most < panel.ylim[1]
        assert panel.ylim[1] - panel.ylim[0] < 3.3 * (most - least)  # as much above and below, and the room at either end
        bad = [curve for curve in panel.curves if "bad" in curve.label + curve.name]
        assert bad
        assert all(curve.x.max() < runs[2].broke_off[1] for curve in bad)
    assert "leaves the axis: `bad` at " in figure.panels[0].title


def test_the_headline_says_what_holds_throughout(plain):
    """The green box confirms "throughout" of the paper's bump alone: elsewhere the linear regime ends, as it says below."""
    assert plain.state == "holds"
    assert "MuJoCo agrees with the analysis, over the paper's bump throughout" in plain.text
