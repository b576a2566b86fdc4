"""`python -m sim.bump`: its numbers, its JSON, its exit codes, and what it says when something is wrong."""

import itertools
import json
import math
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from models.common.errors import InputError
from models.roads.iso8608 import Iso8608
from models.roads.road import Bump
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.bump import main
from sim.runs.agreement import ROUNDING, LinearComparison
from sim.runs.run import run_controllers, sample_times
from sim.runs.time_histories import history_figure
from synth.vehicle.designer import Designer
from tests.support.analysed import predict, simulate
from tests.support.commands import answer, attacks, environment, prose
from tests.support.shared import printed, ran

ROOT = Path(__file__).parents[2]
VEHICLE = (ROOT / "models" / "quarter_car.toml").read_text()
CONTROLLERS = ["passive", "state", "I", "II", "state_printed", "I_printed", "II_printed"]

UNITS = {
    "suspension_deflection": "m",
    "tyre_deflection": "m",
    "sprung_velocity": "m/s",
    "unsprung_velocity": "m/s",
    "sprung_acceleration": "m/s2",
    "control_force": "N",
}


def vehicle_with(folder, gain, measured="sprung_velocity"):
    """A vehicle file with one more controller, `mine`."""
    path = folder / "mine.toml"
    path.write_text(f'{VEHICLE}\n[controllers.mine]\nmeasured = ["{measured}"]\ngain = [[{gain}]]\n')
    return str(path)


@pytest.fixture(scope="module")
def everything():
    """Returns what `--controller all --json` prints."""
    done = printed("sim.bump", "--controller", "all", "--no-logs", "--json")
    assert (done.code, done.err, list(done.folder.iterdir())) == (0, "", [])
    return done.json


def test_json_of_every_controller(everything):
    """`all` is every controller, once, in order; nothing ends the comparison and signals have their units."""
    assert everything["road"] == {"type": "bump", "height": 0.1, "length": 5.0, "speed": 12.5, "track": "both"}  # (62)
    assert everything["timestep"] == 1e-3
    assert everything["logs"] == {"mcap": None, "layout": None, "rerun": None}
    assert [run["controller"]["name"] for run in everything["runs"]] == CONTROLLERS
    for run in everything["runs"]:
        assert run["cause"] == "RK4's own error"  # without geometry, noise and rounding
        assert (run["until"], run["half_step"], run["lift_off"], run["agrees"]) == (None, None, [], True)
        assert {name: entry["unit"] for name, entry in run["signals"].items()} == UNITS


def test_json_says_what_was_proved(everything):
    """A designed controller comes with a bound above its norm, a given gain with its norm alone and as the file has it."""
    by_name = {run["controller"]["name"]: run["controller"] for run in everything["runs"]}
    for name in ("state", "I", "II"):
        assert by_name[name]["norm"] <= by_name[name]["bound"]
    for name in ("passive", "state_printed", "I_printed", "II_printed"):
        assert by_name[name]["bound"] is None
    assert by_name["I_printed"]["gain"] == [[10824.0, -2071.0]]
    assert by_name["I_printed"]["measured"] == ["suspension_deflection", "sprung_velocity"]
    assert by_name["passive"]["gain"] == [[]]
    assert by_name["II_printed"]["norm"] == pytest.approx(7.906789, abs=5e-7)  # SLICOT, written down with 7 digits
    assert by_name["II_printed"]["peak_frequency"] == pytest.approx(64.221, abs=1e-3)  # a flat top; SLICOT's to 5 digits


def test_logs_are_written_and_named(capsys, tmp_path):
    """`--logs DIR` makes the folder for an MCAP file, its layout and a Rerun file; above the verdict it says how to open them."""
    folder = tmp_path / "deep" / "down"
    assert main(["--controller", "passive", "--controller", "II", "--duration", "0.1", "--logs", str(folder), "-v"]) == 0
    *above, said = capsys.readouterr().out.split("\n\n")
    *_, opens, first = "\n".join(above).splitlines()
    layout, mcap, rrd = sorted(folder.iterdir())
    assert opens == f"  rerun {rrd}"
    assert first.strip() == str(mcap)
    assert prose(said) == "passive, II: MuJoCo agrees with the model; linear analysis applies over the whole run; energy balances"
    assert layout.name.endswith(".layout.json")
    with mcap.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    # Runs; responses and the difference, samples; shapes; frames of the scene at 60 a second, twice. Nothing else happened.
    assert summary.statistics.message_count == 2 * (4 * 101 + 1 + 2 * 6)
    assert rrd.read_bytes()[:3] == b"RRF"


def test_a_design_that_fails_writes_nothing(tmp_path, monkeypatch):
    """A controller that cannot be designed is bad input too: no logs folder is left behind."""
    monkeypatch.chdir(tmp_path)
    # Without a damper, forces from a deflection alone conserve energy: no gain stabilises that.
    undamped = VEHICLE.replace("suspension_damping = 400.0", "suspension_damping = 0.0")
    Path("mine.toml").write_text(undamped + '[controllers.mine]\nmeasured = ["suspension_deflection"]\n')
    with pytest.raises(InputError, match="no static gain on these measurements stabilises"):
        main(["--controller", "mine", "--vehicle", "mine.toml"])
    assert list(tmp_path.iterdir()) == [tmp_path / "mine.toml"]


def test_another_vehicles_prediction_does_not_agree(paper, designer):
    """The verdict notices a prediction whose height is off by a millionth."""
    passive, moment = designer.design("passive"), sample_times(paper, 0.5, 2e-4)
    physics = run_controllers(paper, [passive], Bump(), moment)[0].physics
    # RK4's own error at this step is 1e-9 of a peak, as the rounding that is allowed.
    predictions = [predict(paper, passive, Bump(height), moment) for height in (0.1, 0.1 * (1 + 1e-6))]
    right, wrong = (LinearComparison(one, physics, math.inf) for one in predictions)
    assert right.agrees
    assert not wrong.agrees
    assert max(entry.allowed for entry in right.signals.values()) < 10 * ROUNDING


@pytest.mark.parametrize(
    "options",
    [
        ["--height", "0.12", "--length", "1.5"],
        ["--height", "-0.3", "--length", "1.5", "--timestep", "2e-3"],
        # Within a step the held road falls away before the samples say so.
        pytest.param(["--height", "1.0"], marks=pytest.mark.attack),
    ],
    ids=" ".join,
)
def test_lift_off_is_reported_and_no_disagreement(capsys, options):
    """A wheel that leaves the road is reported with when and for how long; until then physics and analysis agree."""
    result = answer(capsys, main, "--controller", "I", "--no-logs", "--duration", "1", *options)
    (run,) = result["runs"]
    assert run["agrees"] is True
    assert run["lift_off"]
    for start, end in run["lift_off"]:
        assert 0 < start <= end <= 1.0
    for entry in run["signals"].values():
        assert entry["error"]["sampled"] < 1e-5  # RK4's own: 5e-7 at 1 ms, 6.2e-6 at 2 ms
    # Over the whole run they are far apart: it was the comparison that stopped, not the physics.
    tyre = run["signals"]["tyre_deflection"]["peak"]
    assert abs(tyre["mujoco"] - tyre["sampled"]) > 0.1 * tyre["sampled"]


def test_a_mildly_unstable_gain_is_run_and_called_unstable(capsys, tmp_path):
    """Positive feedback of the body's velocity that outweighs the damper: no norm, run, and exit code 1 unless it is allowed."""
    vehicle = vehicle_with(tmp_path, 450.0)
    result = answer(capsys, main, "--controller", "mine", "--no-logs", "--vehicle", vehicle, code=1)
    (run,) = result["runs"]
    assert result["unstable"] == ["mine"]
    assert run["agrees"] is True
    assert (run["controller"]["norm"], run["controller"]["peak_frequency"]) == (None, None)
    both = ["--controller", "mine", "--controller", "passive", "--duration", "0.5", "--no-logs", "--vehicle", vehicle, "--brief"]
    assert main(both) == 1
    text = prose(capsys.readouterr().out)
    assert "mine: UNSTABLE loop; MuJoCo agrees" in text
    assert text.endswith("exit code 1, because a closed loop is unstable (mine); --allow-unstable permits this")
    assert main([*both, "--allow-unstable"]) == 0
    assert "exit code" not in capsys.readouterr().out
    assert main(both[2:]) == 0  # the passive vehicle alone


@pytest.mark.parametrize(("gain", "continuous_is_stable"), [("-1e7", True), ("1e12", False), *attacks([("1e5", False)])])
def test_a_diverging_run_stops_cleanly(tmp_path, monkeypatch, capfd, gain, continuous_is_stable):
    """A wildly unstable gain: JSON has nulls for physics, the table dashes, stderr nothing, and no file is left but logs."""
    monkeypatch.chdir(tmp_path)
    arguments = ["--controller", "mine", "--vehicle", vehicle_with(tmp_path, gain)]
    assert main([*arguments, "--no-logs", "--json"]) == 1
    out, err = capfd.readouterr()  # what MuJoCo itself writes is in it
    (run,) = json.loads(out, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))["runs"]
    # Until it diverged, MuJoCo did what the analysis says, unless it did so at once: then nothing was compared.
    assert run["agrees"] == (run["until"] > 0)
    assert (run["controller"]["norm"] is not None) == continuous_is_stable  # -1e7 is too fast for the sampling only
    assert {entry["peak"]["mujoco"] for entry in run["signals"].values()} == {None}
    logged = gain == "1e5"
    assert main([*arguments, *(["--logs", "."] if logged else ["--no-logs"]), "-v", "--allow-unstable"]) == (run["until"] == 0)
    out, more = capfd.readouterr()
    rows = re.findall(r"^  \w+ \[\S+\] +(\S+) +(\S+) +(\S+) +(\S+) +\S+ +\S+$", out, re.M)
    assert len(rows) >= 5
    assert {*rows} == {("-", "-", "-", "-")}
    assert "diverged: MuJoCo was stopped at" in out
    assert "nan" not in out
    assert err == more == ""
    assert len([*tmp_path.iterdir()]) == (4 if logged else 1)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_output_that_cannot_be_written(tmp_path):
    """A full disk behind stdout is one line on stderr; a reader that has gone, as `head`, is no error."""
    words = [sys.executable, "-m", "sim"]  # it ends as all commands do, and needs no numpy
    with open("/dev/full", "w") as full:
        done = subprocess.run(words, cwd=tmp_path, env=environment(), stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    assert "No space left on device" in done.stderr
    assert done.stderr.count("\n") == 1

    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(words, cwd=tmp_path, env=environment(), stdout=write, stderr=subprocess.PIPE, text=True)
    os.close(write)
    assert (done.returncode, done.stderr) == (0, "")


def test_help_shows_units_and_defaults(capsys):
    """`--help` gives the unit and the default of every number, and the exit codes."""
    with pytest.raises(SystemExit):
        main(["--help"])
    out = prose(capsys.readouterr().out)
    for line in ("[m] (default: 0.1)", "[m/s] (default: 12.5)", "[s] (default: 3)", "[s] (default: 0.001)", "exit code: 0"):
        assert line in out


def test_negative_numbers_are_no_options(capsys):
    """A hole is a bump of negative height, with or without an exponent, and the linear response is its mirror image."""
    options = ("--controller", "passive", "--no-logs", "--duration", "0.6", "--height")
    results = [answer(capsys, main, *options, height) for height in ("-2e-2", "0.02")]
    hole, bump = (result["runs"][0]["signals"] for result in results)
    assert results[0]["road"]["height"] == -0.02
    for name in UNITS:
        assert hole[name]["peak"]["continuous"] == bump[name]["peak"]["continuous"]


@pytest.mark.parametrize("controller", [*attacks(["I_printed"]), "passive"])
def test_how_far_the_physics_holds_after_lift_off(capsys, controller):
    """The change at half the step is within a factor of three of what physics at an eighth of the step makes of it."""
    arguments = ["--controller", controller, "--height", "0.1", "--length", "1", "--duration", "1", "--no-logs"]
    found = answer(capsys, main, *arguments)["runs"][0]["half_step"]
    vehicle = read_vehicle("quarter_car")
    held = replace(vehicle, implementation=replace(vehicle.implementation, sample_period=1e-3))
    designed, road = Designer(vehicle).design(controller), Bump(height=0.1, length=1.0)
    coarse, fine = (simulate([held], [designed], [road], np.arange(1000 * n + 1) * 1e-3 / n).response.run(0) for n in (1, 8))
    names = [name for name in vehicle.linear_model.outputs if coarse.scale(name)]
    error = max(np.abs(coarse[name] - fine[name][::8]).max() / coarse.scale(name) for name in names)
    assert 1e-4 < error < 1e-2
    assert 1 / 3 < found["difference"] / error < 3


def test_with_noise_it_is_not_said_how_far_the_physics_holds(capsys, tmp_path):
    """At half the step noise would be another: then there is no number, except for a controller that measures nothing."""
    (tmp_path / "noisy.toml").write_text(f"{VEHICLE}\n[implementation]\nnoise = {{ sprung_velocity = 1e-4 }}\n")
    arguments = ["--vehicle", str(tmp_path / "noisy.toml"), "--controller", "I_printed", "--controller", "passive"]
    result = answer(capsys, main, *arguments, "--height", "0.1", "--length", "1", "--duration", "0.5", "--no-logs")
    assert all(run["lift_off"] for run in result["runs"])
    assert [run["half_step"] is None for run in result["runs"]] == [True, False]


def test_a_picture_is_of_the_signals():
    """Every weighed signal has a panel: each curve has its response's values, MuJoCo's peaks are marked, the axis holds all.

    An unstable loop is drawn until it leaves the axis, as the title says, and a silent signal is not drawn.
    """
    wild = parse_vehicle(f'{VEHICLE}\n[controllers.wild]\nmeasured = ["sprung_velocity"]\ngain = [[9e4]]\n')
    runs = ran(wild, "passive", "I_printed", "wild", road=Bump(height=0.2, speed=20.0), duration=0.6)
    figure = history_figure(runs, "a bump")
    assert figure is not None
    assert figure.finding.startswith("`I_printed` has the lowest peak of sprung acceleration, ")
    assert runs[2].broke_off is not None
    assert figure.title.endswith(f". `wild` ended early, at {runs[2].broke_off[1]:.4g} s (flat tyre)")
    assert "leaves the axis: `wild` at " in figure.panels[0].title
    weighed = [name for name, weight in wild.performance.items() if weight > 0]
    assert [panel.title.partition(",")[0] for panel in figure.panels] == [name.replace("_", " ") for name in weighed]
    for (panel, name), run in itertools.product(zip(figure.panels, weighed, strict=True), runs):
        assert panel.ylim is not None
        who, until = run.controller.name, run.agreement.until
        own = [curve for curve in panel.curves if who in (curve.label, curve.name.partition(",")[0])]
        assert bool(own) == ((name, who) != ("control_force", "passive"))
        for curve in own:
            response = run.physics if curve.name.endswith("MuJoCo") else run.sampled
            np.testing.assert_array_equal(curve.y, response[name][np.searchsorted(response.time, curve.x)])
            if who != "wild":
                assert panel.ylim[0] <= curve.y.min() <= curve.y.max() <= panel.ylim[1]
                if curve.marker:
                    assert (curve.x >= until).all() if curve.filled else (curve.x < until).all()
        marked = np.concatenate([np.zeros(0), *(curve.y for curve in own if curve.marker)])
        if own and who != "wild":
            assert np.ptp(panel.ylim) < 10 * np.ptp(run.physics[name])  # others are not squeezed by one that grows
            assert [marked.min(), marked.max()] == [run.physics[name].min(), run.physics[name].max()]


def test_a_long_road_is_drawn_whole_and_near():
    """Beside each panel of a long random road stands its hardest stretch, with its peak."""
    runs = ran(read_vehicle("quarter_car"), "passive", road=Iso8608("C", seed=0, speed=20.0), duration=6.0)
    figure = history_figure(runs, "a road")
    assert figure is not None
    for whole, near in zip(figure.panels[::2], figure.panels[1::2], strict=True):
        assert near.title.startswith(whole.title + ", from ")
        assert whole.xlim == (0.0, 6.0)
        assert near.xlim is not None
        assert near.xlim[1] - near.xlim[0] < 3.0
    (marked,) = (curve for curve in figure.panels[1].curves if curve.marker)
    assert np.abs(marked.y).max() == runs[0].physics.peak("sprung_acceleration")
    (line,) = (curve for curve in figure.panels[0].curves if not curve.marker)
    drawn, own = np.interp(runs[0].sampled.time, line.x, line.y), runs[0].sampled["sprung_acceleration"]
    peaks = 1 + np.flatnonzero((own[1:-1] > own[:-2]) & (own[1:-1] > own[2:]) & (own[1:-1] > own.std()))
    assert np.abs(drawn - own)[peaks].max() < 0.1 * own.max()  # of two peaks within ten samples the lower may be cut
