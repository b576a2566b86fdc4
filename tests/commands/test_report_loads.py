"""Loads, the workshop's plate and the roughness of roads in a report: as the commands have them that are about them."""

import json

import pytest

from models.roads.iri import roughness_of
from models.roads.iso8608 import Iso8608
from models.vehicle.vehicle import read_vehicle
from sim.drive.__main__ import main as drive
from sim.report.__main__ import main
from sim.studies.ride.over_roads import _roughness_row

pytest.importorskip("jinja2", reason="a report needs the extra [report]")

LOADS = ("--load", "brake:g=0.4", "--load", "payload:mass=80:x=-1.0")
CAR = ("--vehicle", "half_car", "--timestep", "4e-3")


@pytest.mark.attack
def test_loads_in_a_report_are_those_of_a_drive(tmp_path, capsys):
    """Dive, squat and travel under loads are what sim.drive measures, as they are said at the top and drawn over time."""
    page = tmp_path / "report.html"
    assert main([*CAR, "--quick", "--controller", "passive", "--out", str(page), "--json", *LOADS]) == 0
    found, text = json.loads(capsys.readouterr().out), page.read_text(encoding="utf-8")
    assert drive([*CAR, "--controller", "passive", "--duration", "5", "--no-logs", "--json", *LOADS]) == 0
    (run,) = json.loads(capsys.readouterr().out)["runs"]
    rows = {row["metric"]: row for row in found["tables"]["loads"]}
    for name in ("pitch_angle_dive", "pitch_angle_squat", "pitch_angle_at_end", "suspension_deflection_front_peak"):
        row, measured = rows[name.replace("_", " ")], run["metrics"][name]
        assert (row["MuJoCo"], row["sampled"]) == (f"{measured['mujoco']:.4g}", f"{measured['linear']:.4g}")
    assert rows["pitch angle at end"]["at rest, linear"] == f"{run['static_angles']['pitch_angle']:.4g}"
    (said,) = [line for line in found["answer"] if line.startswith("Under brake:g=0.4")]
    assert "`passive`: MuJoCo agrees" in said
    for title in ("heave load", "pitch load", "pitch angle", "suspension deflection rear"):
        assert title in text


def test_roads_of_the_ride_say_how_rough_they_are():
    """The IRI of each road that is driven stands beside that of all of its class."""
    vehicle = read_vehicle("full_car")
    name, tracks, expected, driven = _roughness_row(vehicle, "B")
    road = Iso8608("B", 0, 20.0, vehicle.parameters["track"])
    mean = next(one for one in roughness_of(road, vehicle, 200.0) if one.name == "mean")
    assert (name, tracks) == ("B", "mean of both")
    assert driven.split(", ")[0] == f"{mean.iri:.3g}"
    assert expected == f"{mean.expected:.3g} +- {mean.spread:.2g}"
