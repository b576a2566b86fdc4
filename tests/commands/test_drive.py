"""`python -m sim.drive`: roads of every kind, metrics beside predictions, logs, and bad input."""

import itertools
import json

import pandas
import pytest

from models.common.printed import percent, three_digits
from models.common.table import find_table
from models.common.units import TIME
from models.roads.road import Bump
from models.vehicle.vehicle import read_vehicle
from sim.drive.__main__ import main
from sim.runs.report import signal_table
from sim.runs.run import run_controllers, sample_times
from tests.support.commands import answer, main_of, prose
from tests.support.shared import designed


def test_class_c(capsys, tmp_path):
    """Controller I over class C: agreement until the wheel lifts, every metric thrice, logs that are there."""
    result = answer(
        capsys, main, "--controller", "I", "--class", "c", "--speed", "20", "--duration", "4", "--logs", str(tmp_path)
    )
    (run,) = result["runs"]
    assert run["agrees"]
    assert result["road"]["class"] == "C"
    assert result["road"]["roughness"] == 256e-6
    for name in ("sprung_acceleration_weighted", "suspension_deflection_rms", "dynamic_load", "control_force_rms"):
        metric = run["metrics"][name]
        assert metric["mujoco"] == pytest.approx(metric["linear"], rel=0.05)  # it lifts off for moments, if at all
        assert abs(metric["mujoco"] - metric["expected"]) < 4 * metric["spread"]
    assert result["measured_from"] == pytest.approx(1.865, abs=1e-3)  # ln(100) / 2 over the slowest pole, 1.235 rad/s
    assert sorted(result["logs"].values()) == sorted(str(path) for path in tmp_path.iterdir())


def test_linear_roads_are_linear(capsys):
    """Over class A no wheel lifts, and every metric in MuJoCo is that of the linear response over the same road."""
    result = answer(capsys, main, "--controller", "passive", "--controller", "II", "--class", "A", "--duration", "4", "--no-logs")
    for run in result["runs"]:
        assert run["lift_off"] == []
        for metric in run["metrics"].values():
            assert metric["mujoco"] == pytest.approx(metric["linear"], rel=1e-4, abs=1e-9)  # RK4's 1e-6, and powers nearly cancel


@pytest.mark.parametrize("command", ["bump", "drive"])
def test_csv(command, tmp_path, capsys):
    """The table has every signal in MuJoCo and the analysis, bit for bit, as the project's reader and pandas read it."""
    path, names, road = tmp_path / "signals.csv", ("passive", "I"), ("--road", "bump") if command == "drive" else ()
    options = (*road, "--speed", "12.5", "--duration", "0.3", "--no-logs", "--csv", str(path), "--json")
    assert main_of(f"sim.{command}")(["--controller", "passive", "--controller", "I", *options]) == 0
    assert json.loads(capsys.readouterr().out)["csv"] == str(path)
    vehicle = read_vehicle("quarter_car")
    runs = run_controllers(vehicle, [designed(vehicle, name) for name in names], Bump(), sample_times(vehicle, 0.3, 1e-3))
    table = find_table(path.read_text(), "")
    headings, (numbers, _) = table.headings(TIME), table.numbers()
    assert [(one.name, one.unit) for one in headings[:2]] == [("time", "s"), ("road_displacement passive mujoco", "m")]
    frame = pandas.read_csv(path).set_index("time [s]")
    assert frame.shape == (301, 2 * 2 * len(vehicle.kind.signals)) == (len(numbers), len(headings) - 1)
    for run in runs:
        for signal, source in itertools.product(vehicle.kind.signals, ("mujoco", "sampled")):
            response = run.physics if source == "mujoco" else run.sampled
            heading = f"{signal.name} {run.controller.name} {source} [{signal.unit}]"
            column = [one.text for one in headings].index(heading)
            assert frame[heading].tolist() == numbers[:, column].tolist() == response[signal.name].tolist()


def test_seed(capsys):
    """Another seed is another road, the same seed the same numbers."""
    roads = [
        answer(capsys, main, "--controller", "passive", "--duration", "1", "--no-logs", "--seed", seed)["runs"]
        for seed in ("1", "1", "2")
    ]
    assert roads[0] == roads[1] != roads[2]


@pytest.mark.parametrize(
    "road", ["bump:height=0.03", "watts_hump:height=0.05", "step:height=-0.02", "pothole:depth=0.02", "sweep"]
)
def test_obstacles(capsys, road):
    """Every obstacle is driven, agrees, and is measured without an expectation, as it has no spectrum."""
    result = answer(capsys, main, "--controller", "I", "--road", road, "--speed", "10", "--duration", "1", "--no-logs")
    assert result["road"]["type"] == road.split(":")[0]
    metric = result["runs"][0]["metrics"]["suspension_deflection_peak"]
    assert metric["expected"] is None
    assert metric["mujoco"] > 0


@pytest.mark.parametrize(
    ("duration", "said"),
    [
        (2.0, ""),
        (1.0, "The run covers 50 % of the road; --duration 2 covers the whole road"),
        (
            2.5,
            "the road has points for only 2 s of the 2.5-s run. The straight road after its last point lowers every rms value; "
            "--duration 2 ends the run at the road's last point",
        ),
    ],
)
def test_a_road_that_ends_before_its_run_or_after_it(capsys, tmp_path, duration, said):
    """A run that is longer than the points of its road, or shorter, says so: a straight end lowers the ride unseen."""
    path = tmp_path / "road.csv"
    path.write_text("distance,height\n" + "".join(f"{0.1 * i},{0.01 * ((i // 7) % 2)}\n" for i in range(201)))
    arguments = ["--controller", "passive", "--road", str(path), "--speed", "10", "--duration", str(duration), "--no-logs"]
    result = answer(capsys, main, *arguments)
    assert result["road"]["points"] == 201
    assert result["road_ends"] == (2.0 if duration > 2 else None)
    main(arguments)
    out = prose(capsys.readouterr().out)
    assert said in out
    below = "from 0 s on; after 2 s, the road has no points and is straight." if duration > 2 else "from 0 s on."
    assert f"Worst point of the vehicle in MuJoCo, {below}" in out  # under the ride
    assert ("--duration" in out) == bool(said)


def test_verdict_before_a_wheel_lifts(capsys):
    """If a wheel lifts within a moment, the time before it agrees, though the body turns: later says nothing of that."""
    arguments = ["--vehicle", "half_car", "--controller", "II", "--class", "D", "--speed", "25", "--seed", "1"]
    result = answer(capsys, main, *arguments, "--duration", "1.5", "--no-logs")
    assert result["runs"][0]["agrees"]
    assert result["runs"][0]["lift_off"][0][0] < 1.0


def test_a_run_that_ends_early_has_no_metrics(capsys):
    """On a flat tyre a run breaks off: what and when is said, no number of it is printed as a metric, and JSON has nulls."""
    arguments = ["--controller", "I", "--road", "step:height=1", "--duration", "1", "--no-logs"]
    result = answer(capsys, main, *arguments)
    (run,) = result["runs"]
    assert run["broke_off"]["by"] == "flat tyre"
    assert all(metric["mujoco"] is None and metric["linear"] is None for metric in run["metrics"].values())
    assert main([*arguments, "-v"]) == 0
    out, when = capsys.readouterr().out, f"{run['broke_off']['at']:.4g} s"
    assert f"This run has no metrics: flat tyre at {when}." in out
    assert f"flat: a tyre is compressed by more than 0.25 m at {when}; no later step is compared" in prose(out)
    assert not any(line.split()[:1] == ["dynamic_load"] for line in out.splitlines())


def test_what_metrics_rest_on_is_said(capsys):
    """The output shows how settled the run is when measuring begins, and which metrics are approximate."""
    arguments = ["--controller", "passive", "--class", "C", "--duration", "4", "--no-logs"]
    result = answer(capsys, main, *arguments)
    (run,) = result["runs"]
    assert run["broke_off"] is None
    assert run["settled"]["signal"] == "suspension_deflection"
    assert 0.7 < run["settled"]["share"] < 0.9  # half of the run, 2 s, is a third of its settling time
    assert run["expected_error"] < 1e-4
    main([*arguments, "-v"])
    table = capsys.readouterr().out
    assert f"the variance of suspension_deflection is {percent(run['settled']['share'])} of its final value" in prose(table)
    metrics, iri = run["metrics"], result["iri"]["iri"]
    (expected,) = [line.split() for line in table.splitlines() if "passive, expected" in line]
    (spread,) = [line.split() for line in table.splitlines() if "passive, +- by road" in line]
    assert expected[2] == three_digits(metrics["sprung_acceleration_weighted"]["expected"])
    assert spread[4] == three_digits(metrics["sprung_acceleration_weighted"]["spread"])
    assert next(one for one in expected if "~" in one) == f"~{1e3 * metrics['suspension_deflection_peak']['expected']:.3g}"
    assert "~: peaks are up to 23 % too high; +-: up to 45 % too large in short runs." in prose(table)
    numbers = " +- ".join(three_digits(iri[key]) for key in ("expected", "spread"))
    assert f"Roughness of this road [m/km]: iri {three_digits(iri['road'])} (expected {numbers})." in prose(table)
    for name, metric in run["metrics"].items():
        assert metric["approximate"] == name.endswith(("vdv", "mtvv", "crest", "peak"))
    main(arguments)
    ride = run["metrics"]["sprung_acceleration_weighted"]
    expected = f"passive {ride['expected']:.3g} +- {ride['spread']:.3g}."
    assert f"Expected ride over all such roads [m/s²], with its standard deviation between roads: {expected}" in prose(
        capsys.readouterr().out
    )


def test_what_linear_numbers_have_not_is_said(capsys, tmp_path):
    """For limits, and of noise on what is measured, a sentence says that only MuJoCo's numbers have them."""
    text = read_vehicle("quarter_car").text + "\n[limits]\nsuspension_stroke = 0.08\nstop_stiffness = 1e5\n[implementation]\n"
    (tmp_path / "built.toml").write_text(text + "noise = { sprung_velocity = 1e-3 }\n")
    main(["--vehicle", str(tmp_path / "built.toml"), "--controller", "I", "--class", "B", "--duration", "2", "--no-logs", "-v"])
    out = prose(capsys.readouterr().out)
    assert "Expected values are for a vehicle without bump stops" in out
    assert "Only MuJoCo's values include the noise of the measurements." in out


@pytest.mark.parametrize(("height", "shares"), [(0.0, False), (0.1, True)])
def test_a_flat_road_changes_nothing(paper, designer, height, shares):
    """Over a flat road nothing moves, and there is no share of what rounding leaves."""
    controllers = [designer.design("passive"), designer.design("I")]
    passive, run = run_controllers(paper, controllers, Bump(height=height), sample_times(paper, 1.0, 1e-3))
    table = signal_table(run, passive.physics)
    changes = [cell for row in table.rows for head, cell in zip(table.headings, row, strict=True) if "change" in head]
    assert len(changes) == 12
    assert any(cell != "-" for cell in changes) == shares
