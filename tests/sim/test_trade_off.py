"""The picture of a campaign: ride against road holding, points from MuJoCo, a line of constant dampers, crosses fully active."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from models.roads.choice import choose_road
from models.vehicle.vehicle import read_vehicle
from sim.campaign import summary
from sim.campaign.file import parse_campaign
from sim.campaign.plan import Plan
from sim.campaign.summary import CONSTANT, trade_off
from sim.studies.ride.expected import expect
from sim.studies.ride.scores import KEYS, Score
from synth.vehicle.designer import Designer
from tests.support.commands import main_of, refused

CAMPAIGN = """
vehicles = ["quarter_car_semi_active"]
controllers = ["passive", "I", "sky"]
roads = ["iso8608:class=B", "bump"]
speeds = [20.0]
seeds = 1
duration = 0.6
settle = 0.3
timestep = 2e-3
"""


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """A campaign that was run and drawn: its plan, what it came to, and the picture."""
    folder = tmp_path_factory.mktemp("campaign")
    (folder / "c.toml").write_text(CAMPAIGN, encoding="utf-8")
    campaign = parse_campaign(CAMPAIGN, folder / "c.toml")
    ((name, vehicle),) = campaign.vehicles.items()
    designer = Designer(vehicle)
    plan = Plan(campaign, {name: {one: designer.design(one) for one in campaign.controllers}})
    return folder, plan


def test_points_are_the_numbers_of_the_table(drawn, capsys):
    """Every point of the figure is a controller's ride and tyre load as `--json` has them, in the panel of its road."""
    folder, plan = drawn
    picture = folder / "t.svg"
    assert main_of("sim.campaign")([str(folder / "c.toml"), "--workers", "1", "--json", "--picture", str(picture)]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["picture"] == str(picture)
    assert picture.read_text(encoding="utf-8").count("constant dampers, expected") >= 1
    figure = trade_off(plan, result["summary"], {})
    assert figure is not None
    assert [panel.title for panel in figure.panels] == ["iso8608:class=B at 20 m/s", "bump at 20 m/s"]
    for panel, road in zip(figure.panels, ("iso8608:class=B", "bump"), strict=True):
        circles = {
            curve.label: (float(curve.x[0]), float(curve.y[0]))
            for curve in panel.curves
            if curve.label and not curve.label.endswith("expected")
        }
        said = {one["controller"]: (one["load"]["rms"], one["ride"]["rms"]) for one in result["summary"] if one["road"] == road}
        assert circles == said
    lines = [[curve.label for curve in panel.curves if curve.label.endswith("expected")] for panel in figure.panels]
    assert lines[0] == ["constant dampers, expected", "I, fully active, expected", "sky, fully active, expected"]
    assert lines[1] == []  # over a bump nothing is expected


def test_bars_are_two_standard_errors():
    """Through each point go bars whose half length is twice the standard error that a bootstrap finds; none of a single run."""
    rng = np.random.default_rng(0)
    values = rng.gamma(9.0, size=60)
    again = np.sqrt(np.mean(rng.choice(values, (20_000, 60)) ** 2, axis=1))
    error = summary._standard_error(values)
    assert error is not None
    assert error == pytest.approx(again.std(), rel=0.03)  # of 60 values the two differ by a share of 1/60, and some noise
    entry = {"controller": "I", "load": {"rms": 0.3, "standard_error": 0.01}, "ride": {"rms": 1.0, "standard_error": error}}
    (bars,) = summary._error_bars(entry, "#000000")
    assert (np.nanmin(bars.x), np.nanmax(bars.x)) == pytest.approx((0.28, 0.32))
    assert np.nanmax(bars.y) - np.nanmin(bars.y) == pytest.approx(4 * error)
    assert summary._standard_error(values[:1]) is None
    assert summary._error_bars(entry | {"load": {"rms": 0.3, "standard_error": None}}, "#000000") == []


def test_the_finding_names_the_best_of_each_vehicle_and_those_without_a_point(drawn):
    """The finding is who is best with each vehicle; the title names controllers without a point."""
    _, plan = drawn
    cars = {name: replace(read_vehicle("quarter_car"), text="") for name in ("one", "two")}
    nothing: dict[str, dict] = {name: {} for name in cars}
    several = replace(plan.campaign, vehicles=cars, samples=nothing, variants=nothing)
    entries = [
        {"vehicle": vehicle, "controller": name, "road": road, "speed": 20.0}
        | {key: {"rms": rms, "standard_error": 0.01} for key in ("load", "ride")}
        for vehicle in cars
        for road in ("iso8608:class=B", "bump")
        for name, rms in (("passive", 0.1), ("I", 0.2), ("sky", None))
    ]
    best: dict[Any, Any] = {name: Score(name, dict.fromkeys(KEYS, size)) for name, size in (("I", 1.0), ("passive", 2.0))}
    figure = trade_off(Plan(several, nothing), entries, {name: best for name in cars})
    assert figure is not None
    assert figure.finding == "one: `I` rides and holds the road best; two: `I` rides and holds the road best"
    assert "Controllers without both numbers are not drawn: sky, one; sky, two." in figure.title


def test_the_line_is_of_cars_with_those_dampers(drawn):
    """The ends of the line are what is expected of the same car with c_min and c_max for good, crosses of one whose actuators
    push: by vehicles that have no adjustable damper at all."""
    _, plan = drawn
    semi = read_vehicle("quarter_car_semi_active")
    damper = next(iter(semi.dampers.values()))
    plain = replace(semi, dampers={}, kind=read_vehicle("quarter_car").kind)
    entries = [
        {"vehicle": "quarter_car_semi_active", "controller": "passive", "road": "iso8608:class=B", "speed": 20.0}
        | {"load": {"rms": 0.1}, "ride": {"rms": 1.0}}
    ]
    figure = trade_off(plan, entries, {})
    assert figure is not None
    (panel,) = figure.panels
    curves = {curve.label: curve for curve in panel.curves}
    spectrum = choose_road("iso8608:class=B").build(plain, 20.0, 0, 20.0 * 3.0).spectrum

    assert spectrum is not None

    def expected(vehicle, controller) -> tuple[float, float]:
        found = expect(vehicle, controller, spectrum, 2e-3, 2.0)
        assert found is not None
        return found.mean["dynamic_load"], found.mean["sprung_acceleration_weighted"]

    line = curves["constant dampers, expected"]
    assert len(line.x) == CONSTANT
    for end, damping in ((0, damper.c_min), (-1, damper.c_max)):
        vehicle = replace(plain, parameters={**plain.parameters, "suspension_damping": damping})
        there = expected(vehicle, Designer(vehicle).design("passive"))
        assert (line.x[end], line.y[end]) == pytest.approx(there, rel=1e-9)  # rounding: the same formulas
    cross = curves["sky, fully active, expected"]
    assert (cross.x[0], cross.y[0]) == pytest.approx(expected(plain, Designer(plain).design("sky")), rel=1e-9)
    assert np.all(np.isfinite(line.x))


def test_bad_pictures(drawn, monkeypatch):
    """A picture of another kind is refused in one line before any work."""
    monkeypatch.chdir(drawn[0])
    with refused("this kind of picture cannot be written"):
        main_of("sim.campaign")(["c.toml", "--picture", "x.txt"])
