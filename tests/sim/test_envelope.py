"""The map of validity: what breaks first in MuJoCo is what one linear run predicts."""

import csv
import dataclasses
import json
import re

import numpy as np
import pytest

from models.common.errors import InputError
from models.common.printed import percent
from models.document.figure import Classes
from models.kinds.kind import MOST_SQUEEZE
from models.roads.loads.load import Brake
from models.roads.loads.road_with_loads import RoadWithLoads
from models.roads.road import Bump
from models.vehicle.limits_and_implementation import Limits
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.drive.regime import (
    END_NAMES,
    FLAT,
    REGIME_ENDS,
    scaled,
    utilisation,
)
from sim.envelope import main
from sim.inspect.__main__ import main as inspect
from sim.observers.recorder import record
from sim.runs.dampers import shortfalls
from sim.runs.run import run_controllers
from sim.studies.validity.edges import travel_texts
from sim.studies.validity.grid import grid, read_axes
from sim.studies.validity.regime_end import regime_ends
from sim.studies.validity.regime_map import WITHIN, validity
from sim.studies.validity.report import envelope_figure
from synth.vehicle.designer import Designer
from tests.conftest import recorded_runs
from tests.support.analysed import sampled_response
from tests.support.commands import answer, attacks, once, prose

TIME = np.arange(801) * 2e-3
LONG = np.arange(1501) * 2e-3  # of the attacks: every vehicle has come to rest
LIMITS = Limits(suspension_stroke=0.12, stop_stiffness=2e5, actuator_force=1400.0)  # near one another over a bump of 5 m
AXES = ("height:0.02:0.3:10", "speed:5:30:6")
SPEEDS = (12.0, 17.0, 22.0, 30.0)
BUILT = (
    read_vehicle("quarter_car").text
    + """
[limits]
suspension_stroke = 0.1
stop_stiffness = 2e5
actuator_force = 1200.0
actuator_bandwidth = 50.0
[implementation]
sample_period = 0.004
delay = 1
"""
)
FIXED = {"height": 0.1, "length": 5.0, "speed": 12.5}


@pytest.fixture
def of_one_map(monkeypatch):
    """Words and `--json` are of one map."""
    monkeypatch.setattr("sim.studies.validity.regime_map.validity", once(validity))


@pytest.fixture(scope="module")
def limited(paper):
    """The paper's quarter-car with hardware that ends."""
    return dataclasses.replace(paper, limits=LIMITS)


@pytest.fixture(scope="module")
def cells(limited, designer):
    """Its map over height and speed, every cell of which is run in MuJoCo."""
    return validity(limited, designer.design("I"), grid(read_axes(AXES), FIXED), TIME, every=True)


@pytest.mark.attack
def test_dampers_that_are_short_of_force(tmp_path, capsys, of_one_map):
    """A clipped controller's map says how much force is missing, cell by cell, and what ends the analysis with its dampers."""
    arguments = ["--vehicle", "quarter_car_semi_active", "--controller", "I", "--timestep", "2e-3", "--duration", "1.5"]
    arguments += ["--vary", "height:0.05:0.25:2", "--vary", "speed:6:18:3"]
    table = tmp_path / "map.csv"
    found = answer(capsys, main, *arguments, "--csv", str(table))
    assert {cell["broke_first"] for cell in found["cells"]} == {None, "lift-off"}
    assert all(cell["agrees"] and not cell["holds"] for cell in found["cells"])  # no boundary is as near as 1 % in this map
    vehicle = read_vehicle("quarter_car_semi_active")
    controller = Designer(vehicle, search=False).design("I")
    for cell in found["cells"][::3]:
        road = Bump(cell["height"], cell["length"], cell["speed"])
        (run,) = run_controllers(vehicle, [controller], road, np.arange(751) * 2e-3)
        (one,) = shortfalls(vehicle, run.physics).values()
        assert cell["missing_force"] == pytest.approx(one.rms, rel=1e-6)  # another way to what was asked for: rounding
    with table.open(newline="") as file:
        assert [float(row["missing_force"]) for row in csv.DictReader(file)] == [one["missing_force"] for one in found["cells"]]

    shares = [one["missing_force"] for one in found["cells"]]
    said = f"dampers cannot supply {percent(min(shares))} to {percent(max(shares))} (rms) of the commanded force"
    assert main(arguments) == 0
    printed = prose(capsys.readouterr().out)
    assert said in printed
    assert "damper first" not in printed


@pytest.mark.attack
def test_loads_over_every_bump(tmp_path, capsys):
    """Under a brake a map is of bumps and brake: what breaks first, and when, is as foretold, and is a run's; a log proves it."""
    arguments = ["--vehicle", "half_car", "--controller", "passive", "--timestep", "2e-3", "--duration", "1.5"]
    arguments += ["--vary", "height:0.02:0.2:2", "--vary", "speed:6:18:3", "--load", "brake:g=0.6:start=0.1"]
    found = answer(capsys, main, *arguments, "--logs", str(tmp_path))
    assert found["loads"] == ["brake:g=0.6:start=0.1"]
    assert {cell["broke_first"] for cell in found["cells"]} == {None, "lift-off"}
    vehicle = read_vehicle("half_car")
    for cell in found["cells"][::2]:
        road = RoadWithLoads(Bump(cell["height"], cell["length"], cell["speed"]), (Brake(g=0.6, start=0.1),))
        (run,) = run_controllers(vehicle, [Designer(vehicle, search=False).design("passive")], road, np.arange(751) * 2e-3)
        lifted = run.agreement.end_times["lift-off"]
        assert cell["at"] == (lifted if np.isfinite(lifted) else None)
        if cell["broke_first"] is None:
            assert cell["error"] < 5e-3  # what turning bodies make of it: measured 2e-3
    (log,) = tmp_path.glob("*.mcap")
    assert inspect([str(log)]) == 0
    capsys.readouterr()
    assert main(arguments) == 0
    assert "under brake:g=0.6:start=0.1" in prose(capsys.readouterr().out)


def test_an_unstable_loop_is_said(tmp_path, capsys):
    """A map of a loop that is unstable says so: up to some height nothing breaks within its runs all the same."""
    text = read_vehicle("quarter_car").text + '[controllers.unstable]\nmeasured = ["sprung_velocity"]\ngain = [[3000.0]]\n'
    (tmp_path / "car.toml").write_text(text, encoding="utf-8")
    arguments = ["--vehicle", str(tmp_path / "car.toml"), "--vary", "height:0.02:0.03:2", "--duration", "0.5", "--controller"]
    main([*arguments, "unstable"])
    assert "UNSTABLE loop; every run grows: a pole at " in prose(capsys.readouterr().out)
    main([*arguments, "passive"])
    assert "UNSTABLE" not in capsys.readouterr().out


def test_prediction(cells):
    """The first end, and its time, follow from one linear run per speed: cell by cell, but for the boundary.

    If nothing breaks, linear analysis holds to the integrator's own error; where it does not hold, something broke. Two runs
    enclose the end at each speed.
    """
    driven = [*cells.driven.values()]
    assert [*cells.driven] == [*range(60)]
    assert cells.agreement >= 0.99  # asked for; measured 1.0
    assert cells.unexplained == 0
    assert len({one.first for one in driven}) >= 3  # nothing, and at least two ends, come first somewhere
    # Until then physics is linear to RK4's 1e-5 of a peak, which moves a crossing by less than a step.
    both = [one.time - cells.predicted_time[i] for i, one in cells.driven.items() if one.first >= 0 and i not in cells.others]
    assert np.abs(both).max() <= 2.1e-3
    # RK4 at 2 ms makes 1e-5 of a peak; a tyre slack within a step, more
    assert max(one.error for one in driven if one.first < 0) < 2e-4
    assert all(one.first >= 0 for one in driven if one.error > 0.05)
    assert len(cells.ends) >= 4
    for end in cells.ends.values():
        assert end.confirmed
        assert end.stays < end.predicted < end.leaves <= end.stays * WITHIN**2 * (1 + 1e-9)


def run_steps(monkeypatch) -> list[int]:
    """Returns the timesteps of every run of the maps that follow."""
    steps: list[int] = []

    def counted(cases, time, threads=1):
        steps.append(len(cases) * len(time))
        return record(cases, time, threads)

    monkeypatch.setattr("sim.studies.validity.map_runs.record", counted)
    return steps


@pytest.mark.parametrize(
    ("name", "controller", "speeds"),
    [
        ("limited", "I", (6.0, 25.0)),
        *attacks([("limited", "II", SPEEDS), ("half_car", "II", SPEEDS), ("full_car", "I", SPEEDS[1:])]),
        *attacks([("quarter_car_semi_active", "I", SPEEDS), ("built", "I", SPEEDS)]),
    ],
)
def test_edges_are_those_of_a_dense_map(name, controller, speeds, limited, monkeypatch):
    """Edges of a map lie within 1 % of those of MuJoCo runs 0.5 % apart, and the map takes a tenth of the steps of all its cells.

    Also with bodies that rotate, which move an end by 1 % and more, with semi-active dampers, and with a slow computer and
    actuators that lag.
    """
    vehicle = limited if name == "limited" else parse_vehicle(BUILT) if name == "built" else read_vehicle(name)
    time, slowest = (TIME, 5) if (name, controller) == ("limited", "I") else (LONG, 3)
    design, steps = Designer(vehicle, search=False).design(controller), run_steps(monkeypatch)
    axes = read_axes(("height:0.02:0.3:20", f"speed:{slowest}:30:20"))
    found = validity(vehicle, design, grid(axes, FIXED), time)
    assert found.as_predicted
    assert len(found.ends) >= 5
    assert sum(steps) <= 400 * len(time) / 10
    for speed in speeds:
        at = min(found.ends, key=lambda i: abs(found.bumps[i].speed - speed))
        end, bump = found.ends[at], found.bumps[at]
        heights = end.found * np.linspace(0.97, 1.03, 13)
        dense = validity(vehicle, design, [dataclasses.replace(bump, height=height) for height in heights], time, every=True)
        ended = np.array([one.first >= 0 for one in dense.driven.values()])
        assert not ended[0]
        first = int(ended.argmax())
        assert ended[first:].all()
        assert end.found == pytest.approx((heights[first - 1] + heights[first]) / 2, rel=0.01)
        assert dense.driven[first].end in end.near


def test_a_loop_that_a_soft_spring_makes_unstable():
    """A spring that softens leaves its line at the predicted height, also where its loop is unstable over the bump at hand."""
    spring = (
        "[curves]\nsuspension_stiffness = { deflection = [-0.15, -0.02, 0, 0.02, 0.15], force = [-1800, -360, 0, 360, 1800] }"
    )
    limits = "[limits]\nsuspension_stroke = 0.15\nstop_stiffness = 1e5\n"
    text = read_vehicle("quarter_car").text.replace("suspension_stiffness", "#", 1)
    vehicle = parse_vehicle(f"{text}\n{spring}\n{limits}")
    state = Designer(vehicle).design("state")
    (end,) = regime_ends(vehicle, [state], Bump(height=0.12), TIME[:501])
    assert end is not None
    assert end.confirmed
    assert end.predicted == pytest.approx(0.0478, rel=0.01)  # in proportion to 0.12 m it would be at 0.012 m


def test_holes_break_as_predicted(limited, designer):
    """Over holes, bumps of negative height, what breaks first is what is predicted, bump stops and saturation among it."""
    bumps = [Bump(-height, 5.0, speed) for height in (0.02, 0.06, 0.1, 0.2) for speed in (6.0, 12.5, 25.0)]
    found = validity(limited, designer.design("I"), bumps, TIME, every=True)
    assert not found.others
    assert len({one.first for one in found.driven.values()}) >= 3


def test_a_tyre_is_flat_when_it_is(paper, designer):
    """While nothing else has ended the regime the linear response is exact, and MuJoCo's tyres are flat at its very sample.

    Also where the road goes through the hub within a step, though MuJoCo then reads a tyre that is long again. After a lift-off
    a linear tyre pulls, and says nothing: what counts is what physics does.
    """
    timestep, met = 2e-3, set()
    time = np.arange(251) * timestep
    bumps = [Bump(height, length) for height in (0.3, 0.5, 0.7, 1.0, 2.0, 5.0) for length in (0.5, 1.5, 5.0)]
    for bump in bumps:
        (run,) = run_controllers(paper, [designer.design("I")], bump, time)
        linear = scaled(paper, run.sampled, np.ones(1)).times[0, REGIME_ENDS.index(FLAT)]
        others = min(when for name, when in run.agreement.end_times.items() if name != FLAT.name)
        found = run.agreement.end_times[FLAT.name]
        if min(linear, found) < others:
            assert found == linear, bump
            met.add("first")
        else:
            squeezed = -float(run.physics["tyre_deflection"].min())
            assert (squeezed >= MOST_SQUEEZE) == np.isfinite(found), bump
            met.add("never" if linear < np.inf else "neither")
        if np.isfinite(found) and run.physics["tyre_deflection"][round(found / timestep)] > -MOST_SQUEEZE:
            met.add("through the hub")
    assert met == {"first", "never", "neither", "through the hub"}


def test_edges_along_the_height(capsys, tmp_path, paper, designer, cells):
    """One axis will do: words and --json say up to which height nothing breaks, and where one linear run has the end.

    How far a suspension moves is said where no stop ends it.
    """
    pytest.importorskip("matplotlib")
    arguments = ["--controller", "I", "--vary", "height:0.1:0.6:6", "--speed", "12.5", "--timestep", "0.002"]
    assert main([*arguments, "--picture", str(tmp_path / "line.svg")]) == 0
    printed = prose(capsys.readouterr().out)
    assert "First limit along the height, with a length of 5 m and a speed of 12.5 m/s" in printed
    assert "lift-off 0.5 0.4544 0.4526 to 0.4563" in printed  # cell, predicted, MuJoCo
    travel = re.search(r"travel reaches (\d+) mm; the vehicle file has no bump stops", printed)
    assert travel is not None
    (run,) = run_controllers(paper, [designer.design("I")], Bump(0.4, 5.0, 12.5), TIME)
    assert float(travel[1]) == pytest.approx(1e3 * run.physics.peak("suspension_deflection"), abs=0.5)  # of a rounded millimetre
    metre = sampled_response(paper, designer.design("I"), Bump(1.0, 5.0, 12.5), TIME)
    assert 1 / utilisation(paper, metre).max() == pytest.approx(0.4544, abs=5e-5)  # of four digits
    assert travel_texts(cells) == []
    assert (tmp_path / "line.svg").read_text().startswith("<?xml")
    assert main([*arguments[:2], "--vary", "height:0.3:0.6:2", "--vary", "speed:6:12:2", *arguments[-2:], "--json"]) == 0
    whole = capsys.readouterr().out
    found = json.loads(whole)["edges"]
    assert found["along"] == "height"
    assert [line["speed"] for line in found["lines"]] == [6.0, 12.0]
    slow, fast = found["lines"]
    assert [part["end"] for part in slow["breaks_first"]] == [None]
    assert [part["end"] for part in fast["breaks_first"]] == [None, "lift-off"]
    assert fast["breaks_first"][0]["to"] < fast["predicted_from"] < fast["breaks_first"][1]["from"]
    (enclosed,) = json.loads(whole)["edges"]["enclosed"]
    assert (enclosed["speed"], enclosed["ended_by"], enclosed["agrees"]) == (12.0, "lift-off", True)
    assert enclosed["predicted_from"] == pytest.approx(fast["predicted_from"], rel=1e-9)
    assert enclosed["linear_at"] < fast["predicted_from"] < enclosed["ended_at"]


def test_the_csv_is_the_cells(tmp_path, capsys, of_one_map):
    """Every line of the CSV is a cell of the JSON, and one run of each first limit is recorded."""
    pytest.importorskip("matplotlib")
    vehicle = tmp_path / "limited.toml"
    section = "".join(f"{name} = {value}\n" for name, value in LIMITS.record.items() if value is not None)
    vehicle.write_text(f"{read_vehicle('quarter_car').text}\n[limits]\n{section}")
    axes = ["--vary", "height:0.02:0.3:4", "--vary", "speed:5:30:3", "--duration", "1.6"]
    arguments = ["--vehicle", str(vehicle), "--controller", "I", *axes, "--timestep", "0.004"]
    result = answer(capsys, main, *arguments, "--picture", str(tmp_path / "map.svg"), "--logs", str(tmp_path))
    cells = result["cells"]
    assert (tmp_path / "map.svg").read_text().startswith("<?xml")
    assert main([*arguments, "--csv", str(tmp_path / "map.csv")]) == 0
    assert any(cell["simulated"] for cell in cells)
    firsts = [end for end in END_NAMES if end in {cell["predicted"] for cell in cells}]
    assert len(firsts) >= 2
    ends = {name.removeprefix("I_").replace("_", " ") for name in recorded_runs(result["logs"]["mcap"])}
    assert ends == {"nothing breaks", *(end.replace("-", " ") for end in firsts)}
    rows = list(csv.DictReader((tmp_path / "map.csv").open()))
    assert len(rows) == len(cells) == 12
    for row, cell in zip(rows, cells, strict=True):
        for name in ("height", "length", "speed", "error", "at", "predicted_at"):
            assert row[name] == ("" if cell[name] is None else repr(cell[name]))
        for name in ("broke_first", "predicted", "holds", "agrees", "simulated"):
            assert row[name] == ("" if cell[name] is None else str(cell[name]))
        assert cell["simulated"] or {cell[name] for name in ("error", "holds", "broke_first", "at", "agrees")} == {None}
        assert row["map_complete"] == "True"
        shares = {end: float(row[f"linear_share_of_{end.replace(' ', '_').replace('-', '_')}"]) for end in END_NAMES}
        assert (max(shares.values()) >= 1) == (cell["predicted"] is not None)
        assert cell["predicted"] is None or shares[cell["predicted"]] >= 1


def test_picture_is_the_cells(limited, designer):
    """Every cell of the picture has the colour of its predicted end, also if the speed was asked for first.

    Markers show which cells MuJoCo ran, and the ends that it encloses.
    """
    axes = read_axes(AXES[::-1])
    found = validity(limited, designer.design("I"), grid(axes, FIXED), TIME)
    figure = envelope_figure(found)
    (panel,) = figure.panels
    ground = panel.ground
    assert isinstance(ground, Classes)
    assert (panel.xlabel, panel.ylabel) == ("speed [m/s]", "bump height [m]")
    legend = dict(ground.legend)
    for bump, first in zip(found.bumps, found.predicted, strict=True):
        color = ground.colors[ground.kind[list(ground.y).index(bump.height), list(ground.x).index(bump.speed)]]
        (label,) = [text for text, its in legend.items() if its == color]
        assert label.startswith("no limit" if first < 0 else f"{END_NAMES[first]} first")
    assert "force saturation first (at ±1400 N)" in legend
    assert "Markers show MuJoCo in 10 of 60 cells, 100.0 % of them as predicted" in figure.title
    # The line lies where the linear share is one: at the height that the column's own linear run says.
    (line,) = [curve for curve in panel.curves if curve.label == "predicted limit"]
    for speed in ground.x[1:-1]:
        column = [i for i, bump in enumerate(found.bumps) if bump.speed == speed]
        end = found.bumps[column[0]].height / found.used[column[0]].max()
        heights = line.y[np.isclose(line.x, speed)]
        assert np.any(np.isclose(heights, end, rtol=0.02))  # between two cells the logarithm is taken to be straight
    marked = {curve.label: set(zip(curve.x.tolist(), curve.y.tolist(), strict=True)) for curve in panel.curves if curve.marker}
    enclosed = marked.pop("MuJoCo: height enclosed by two runs")
    assert enclosed == {(found.bumps[i].speed, end.found) for i, end in found.ends.items()}
    assert set().union(*marked.values()) == {(found.bumps[i].speed, found.bumps[i].height) for i in found.driven}
    assert sum(map(len, marked.values())) == len(found.driven) == 10


@pytest.mark.parametrize(
    ("refused", "allowed", "words"),
    [
        ("speed:12:834:2", "speed:12:833:2", "less than two timesteps"),  # 5 m in 6 ms, two timesteps of 3 ms
        ("speed:1.66:12:2", "speed:1.67:12:2", "but each run lasts only 3 s"),  # 5 m in 3 s
    ],
)
def test_bumps_fit_the_run(refused, allowed, words):
    """A bump of a little less than two timesteps, or a little more than the run, is refused; else it is not."""
    arguments = ["--controller", "passive", "--vary", "height:0.02:0.03:2", "--timestep", "0.003"]
    with pytest.raises(InputError, match=words):
        main([*arguments, "--vary", refused])
    assert main([*arguments, "--vary", allowed]) in (0, 1)
