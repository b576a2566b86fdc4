"""Runs beside a measured log: its start is found, the fit is one that numpy computes, and a log of the run proves it."""

import json

import numpy as np
import pytest

from models.common.logs.measured_log import MeasuredLog
from models.roads.choice import choose_road
from sim.inspect.log import read_log
from sim.inspect.proof import prove
from sim.recording.run_log import MEASURED_TOPIC
from sim.runs.run import run_controllers, sample_times
from sim.runs.time_histories import history_figure
from sim.studies.validity.measured_log import compare_log
from tests.support.commands import answer, attacks, main_of, refused
from tests.support.rewriting import contents, written
from tests.support.shared import designed

SIGNALS = ("sprung_acceleration", "suspension_deflection")


def driven(vehicle, *names, duration=4.0):
    """Returns runs over a random road."""
    time = sample_times(vehicle, duration, 1e-3)
    road = choose_road("iso8608:class=B").build(vehicle, 20.0, 1, 20.0 * duration)
    return run_controllers(vehicle, [designed(vehicle, name) for name in names], road, time)


@pytest.fixture(scope="module")
def runs(request):
    """Runs of the passive vehicle and of controller I."""
    from models.vehicle.vehicle import read_vehicle

    return driven(read_vehicle("quarter_car"), "passive", "I")


def measured(run, time, start, noise=0.0, gain=1.0, offset=0.0):
    """Returns what sensors would have logged at some times, had the run begun at `start`; before and after it, a quiet car."""
    generator, signals = np.random.default_rng(5), {}
    for name in SIGNALS:
        values = np.interp(time - start, run.physics.time, run.physics[name], left=0.0, right=0.0)
        signals[name] = gain * values + noise * run.physics.rms(name) * generator.standard_normal(len(time)) + offset
    return MeasuredLog("rig.csv", time, signals)


def fit(run, log, start):
    """The fits by numpy alone: at the run's samples within a faster log, or at a slower log's."""
    t, at = run.physics.time, log.time - start
    slow = np.median(np.diff(at)) > t[1] - t[0]
    shared = at[(at >= 0) & (at <= t[-1])] if slow else t[(t >= at[0]) & (t <= at[-1])]
    m, r = ([np.interp(shared, x, one[name]) for name in SIGNALS] for x, one in ((at, log.signals), (t, run.physics)))
    return [1 - np.linalg.norm(a - b) / np.linalg.norm(a) for a, b in zip(m, r, strict=True)]


UNEVEN = np.sort(np.arange(0, 9, 0.02) + np.random.default_rng(1).uniform(-0.004, 0.004, 450))
CASES = {  # times of the log, and the time of the run's start in its clock
    "the run's samples": (np.arange(4001) * 1e-3, 0.0),
    "earlier, faster": (np.arange(0, 9, 1 / 5000), 1.23456),
    "earlier, slower": (np.arange(0, 9, 1 / 60), 2.5),
    "uneven": (UNEVEN, 3.3),
    "a part of the run": (100 + np.arange(0, 2.5, 1 / 500), 99.3),
    "later and longer": (np.arange(0, 20, 1 / 1000), -0.4567),
}


@pytest.mark.parametrize("case", CASES)
def test_start_and_fit(case, runs):
    """The run that was measured is recognised among others, its start is found, and each fit is that of numpy."""
    time, start = CASES[case]
    log = measured(runs[1], time, start, noise=0.02, gain=0.95)
    one = compare_log(log, runs)
    assert one.start == pytest.approx(start, abs=5e-4)
    for run, fits in zip(runs, one.fits, strict=True):
        assert [fits[name].fit for name in SIGNALS] == pytest.approx(fit(run, log, one.start), rel=1e-9)
    worse, better = (fits["suspension_deflection"].fit for fits in one.fits[:2])
    assert worse is not None
    assert better is not None
    assert better > 0.9 > worse
    assert one.response.time[0] >= 0
    assert one.response.time[-1] <= runs[0].physics.time[-1]
    given = compare_log(log, runs, start=start + 0.05)
    assert [given.fits[1][name].fit for name in SIGNALS] == pytest.approx(fit(runs[1], log, start + 0.05), rel=1e-9)


def test_equal_signals_fit_exactly(runs):
    """A log of the run itself begins at its start, and fits with 1, also beside a signal that nothing moves."""
    log = measured(runs[1], runs[1].physics.time, 0.0)
    still = MeasuredLog("rig.csv", log.time, {**log.signals, "control_force": np.zeros(4001)})
    one = compare_log(still, runs)
    assert (one.start, one.fits[1]["sprung_acceleration"].fit, one.fits[1]["control_force"].fit) == (0.0, 1.0, None)


def test_offsets_and_signs_are_remarked(runs):
    """An offset does not move the start; it is remarked, and removed on request. So is a column of the opposite sign."""
    log = measured(runs[1], CASES["earlier, faster"][0], 1.23456, offset=9.80665)
    one, without = compare_log(log, runs), compare_log(log, runs, remove_offsets=True)
    assert one.start == without.start == pytest.approx(1.23456, abs=5e-4)
    assert any("sprung_acceleration has an offset of 9.81; the fit is 0.99" in doubt for doubt in one.warnings)
    assert without.offsets["sprung_acceleration"] == pytest.approx(9.80665, rel=1e-5)
    assert without.fits[1]["sprung_acceleration"].fit == pytest.approx(one.fits[1]["sprung_acceleration"].fit_without_offset)
    flipped = measured(runs[1], CASES["earlier, faster"][0], 1.23456, gain=-1.0)
    assert sum("opposite sign" in doubt for doubt in compare_log(flipped, runs[1:]).warnings) == 2


def test_without_common_time(runs):
    """A start that leaves no common time is refused."""
    with refused("covers 60 to 64 s of the run, which lasts 4 s"):
        compare_log(measured(runs[1], np.arange(4001) * 1e-3, 0.0), runs, start=-60.0)


def test_the_picture_shows_the_log(runs):
    """Each measured signal is drawn in its panel, within the axis."""
    one = compare_log(measured(runs[1], CASES["earlier, slower"][0], 2.5, gain=3.0), runs)
    figure = history_figure(runs, "a road", one.response)
    assert figure is not None
    for panel, name in zip(figure.panels[::2], SIGNALS, strict=False):
        (curve,) = [each for each in panel.curves if each.label == "measured"]
        np.testing.assert_array_equal(curve.y, one.response[name])
        assert panel.ylim is not None
        assert panel.ylim[0] < curve.y.min() < curve.y.max() < panel.ylim[1]


@pytest.mark.parametrize("command", ["bump", *attacks(["drive"])])
def test_command(command, capsys, tmp_path, monkeypatch):
    """Both commands print the fits, log the measured signals, and prove them; a changed fit is found."""
    monkeypatch.chdir(tmp_path)
    road = ("--road", "bump", "--speed", "12.5") if command == "drive" else ()
    options = ("--controller", "I", *road, "--duration", "0.4")
    main_of(f"sim.{command}")([*options, "--no-logs", "--csv", "run.csv"])
    text = (tmp_path / "run.csv").read_text()
    (tmp_path / "rig.csv").write_text(text.replace("suspension_deflection I mujoco", "Suspension Deflection"))
    options = (*options, "--beside", "rig.csv", "--beside-column", "sprung_acceleration=sprung_acceleration I mujoco [m/s2]")
    result = answer(capsys, main_of(f"sim.{command}"), *options, "--logs", "logs")
    assert {name: fit["fit"] for name, fit in result["runs"][0]["beside"].items()} == dict.fromkeys(SIGNALS[::-1], 1.0)
    assert (result["beside"]["file"], result["beside"]["start"], result["beside"]["last"]) == ("rig.csv", 0.0, 0.4)
    assert main_of(f"sim.{command}")([*options, "--no-logs"]) == 0
    assert "fit = 1 - rms(measured - MuJoCo) / rms(measured), from 0 to 0.4 s" in capsys.readouterr().out
    (path,) = tmp_path.glob("logs/*.mcap")
    log = read_log(path)
    assert log.runs[0].responses[MEASURED_TOPIC].names == SIGNALS[::-1]
    assert prove(log).holds
    said = json.dumps(result["runs"][0]["beside"]["sprung_acceleration"]).encode()
    changed = contents(path).with_attachment(
        "result.json", lambda data: data.replace(said, said.replace(b'"fit": 1.0', b'"fit": 0.9'))
    )
    (tmp_path / "changed.mcap").write_bytes(written(changed))
    assert prove(read_log(tmp_path / "changed.mcap")).broken == ["result of I"]


def test_a_vehicle_without_the_signals(tmp_path):
    """Among several vehicles, one may lack all measured signals; the logs of both still prove."""
    log, logs = tmp_path / "log.csv", tmp_path / "logs"
    log.write_text("time [s];suspension_deflection [mm]\n" + "".join(f"{0.01 * i:.2f};{i % 7}\n" for i in range(60)))
    vehicles = ("--vehicle", "quarter_car", "--vehicle", "half_car", "--duration", "0.3", "--timestep", "0.002")
    main_of("sim.bump")([*vehicles, "--controller", "passive", "--beside", str(log), "--logs", str(logs)])
    assert [prove(read_log(path)).holds for path in logs.glob("*.mcap")] == [True, True]


def test_options_need_the_log(tmp_path):
    """An option of the log without a log, an unreadable assignment, and an output over the log are refused before any run."""
    drive = main_of("sim.drive")
    (tmp_path / "log.csv").write_text("time [s];sprung_acceleration [m/s2]\n0;1\n1;2\n2;3\n")
    beside = ("--controller", "I", "--beside", str(tmp_path / "log.csv"))
    with refused("--beside-start", "give the file of the log with --beside"):
        drive(["--controller", "I", "--beside-start", "2"])
    with refused("--beside-column sprung_acceleration", "SIGNAL=HEADING"):
        drive([*beside, "--beside-column", "sprung_acceleration"])
    with refused("is an input file"):
        drive([*beside, "--csv", str(tmp_path / "log.csv")])
