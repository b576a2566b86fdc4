"""Laws in Python in a report: what physics says of them, and a dash where only analysis would know."""

import json
from pathlib import Path

import pytest

from models.common.printed import percent
from models.roads.road import Bump
from models.vehicle.vehicle import read_vehicle
from sim.report.__main__ import main
from sim.runs.dampers import shortfalls
from sim.runs.run import run_controllers, sample_times
from sim.studies.ride import over_roads as report_ride
from synth.vehicle.designer import Designer
from tests.models.test_python_laws import vehicle_of

pytest.importorskip("jinja2", reason="a report needs the extra [report]")
pytest.importorskip("matplotlib", reason="a report needs the extra [report]")

STEP = 2e-3  # s
SKYHOOK = """
import numpy as np
def step(sample, state):
    body, wheel = sample["sprung_velocity"], sample["unsprung_velocity"]
    return np.where(body * (body - wheel) > 0, -3000.0 * body, 0.0)[:, None], state
step.vectorised = True
"""
MEASURED = ("sprung_velocity", "unsprung_velocity")


def report_of(folder: Path, capsys, *options: str, step: float = STEP) -> tuple[dict, Path]:
    """A report of a skyhook law: its JSON, and its vehicle file."""
    path, page = vehicle_of(folder, SKYHOOK, measured=MEASURED), folder / "report.html"
    arguments = ["--vehicle", str(path), "--timestep", str(step), "--out", str(page), "--json", *options]
    assert main(arguments) == 0
    return json.loads(capsys.readouterr().out), path


def rows_of(found: dict, table: str, name: str = "mine") -> list[dict]:
    """Returns those rows of a table that are of a controller."""
    return [row for row in found["tables"][table] if row["controller"] == name]


@pytest.mark.attack
def test_a_law_stands_beside_the_others(tmp_path, capsys):
    """A quick report has a law's agreement with RK4's order, and dashes, with a reason, for what nobody proves."""
    found, _ = report_of(tmp_path, capsys, "--quick", "--controller", "passive", "--controller", "mine")
    assert found["verdict"] == "holds"
    (design,) = rows_of(found, "designs")
    assert [design[key] for key in ("bound", "norm", "lower bound", "slowest pole [1/s]")] == ["-"] * 4
    assert design["certificate"] == "no linear claim (a law in Python)"
    assert any(said.startswith("Linear analysis does not apply to `mine` (a law in Python)") for said in found["answer"])
    orders = {row["its order"] for row in rows_of(found, "agreement")}
    assert all(abs(float(order) - 4) < 0.1 for order in orders - {"-"})  # RK4's, beside the response to its own forces
    (short,) = rows_of(found, "summary")
    assert (short["H-infinity norm"], short["analysis true up to"]) == ("-", "-")
    assert short["over the paper's bump"].startswith("MuJoCo agrees with the model; ")
    assert not rows_of(found, "regime")


@pytest.mark.attack
def test_a_report_of_nothing_else(tmp_path, capsys, monkeypatch):
    """A whole report of a law alone has its describing function and its ride from physics, and no margins, norms or map."""
    monkeypatch.setattr("sim.studies.frequency.describing_function.SINUSOIDS", 8)
    monkeypatch.setattr("sim.report.processes.processes", lambda *_: 0)  # these are of this process
    for name, value in {"CLASSES": "BC", "SEEDS": (0,), "WINDOW": 2.0, "LONGEST": 4.0}.items():
        monkeypatch.setattr(report_ride, name, value)
    found, _ = report_of(tmp_path, capsys, "--controller", "mine", step=2 * STEP)
    assert {"margins", "gains", "regime", "validity"}.isdisjoint(found["tables"])
    assert rows_of(found, "describing-functions")
    ride = rows_of(found, "ride")
    assert {row["predicted"] for row in ride} == {row["road to road"] for row in ride} == {"-"}
    load = [float(row["MuJoCo"]) for row in ride if row["metric"] == "dynamic load"]
    assert load[1] / load[0] == pytest.approx(2, rel=0.05)  # a class is twice as rough, and such a skyhook is homogeneous


@pytest.mark.attack
def test_dampers_that_are_short_of_force(tmp_path, capsys):
    """A report of a car with adjustable dampers says how much force they leave out, and which loop its linear claims are of."""
    page, vehicle = tmp_path / "report.html", read_vehicle("quarter_car_semi_active")
    arguments = ["--vehicle", "quarter_car_semi_active", "--quick", "--timestep", f"{STEP}", "--json", "--controller", "I"]
    assert main([*arguments, "--controller", "skyhook", "--out", str(page)]) == 0
    found = json.loads(capsys.readouterr().out)
    (run,) = run_controllers(vehicle, [Designer(vehicle).design("I")], Bump(), sample_times(vehicle, 3.0, STEP))
    (one,) = shortfalls(vehicle, run.physics).values()
    said = "`I`: norms and margins do not describe this run: a semi-active damper cannot supply "
    said += f"{percent(one.rms)} of the requested force"
    assert said in found["answer"]
    assert found["answer"][0].startswith("Linear analysis does not apply to `skyhook` (a semi-active law)")
    rows = {row["controller"]: row for row in found["tables"]["summary"]}
    assert rows["I"]["analysis true up to"].endswith(" m")
    (end,) = [row for row in found["tables"]["regime"] if row["controller"] == "I"]
    assert (end["predicted end"], end["ended by"]) == ("lift-off", "lift-off")
    assert float(end["off by, of a peak"]) < 1e-3  # RK4's at 2 ms, of the switched response; of the linear one it is 1
    bump = [row for row in found["tables"]["bump"] if row["controller"] == "I"]
    assert {row["linear until [s]"] for row in bump} == {f"{run.agreement.end_times['damper']:.4g}"}
    assert {row["to continuous"] for row in found["tables"]["agreement"]} == {"-"}
