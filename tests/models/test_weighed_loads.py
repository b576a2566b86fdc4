"""Loads that a design weighs: one norm, and one bound, from road and loads together to z."""

import dataclasses
import json

import numpy as np
import pytest

import synth.command.trade_off
from models.common.errors import InputError
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.studies.frequency.trade_off import measure
from sim.studies.subject import Subject
from synth.__main__ import main
from synth.controller.controller import Controller
from synth.vehicle.designer import Designer
from synth.vehicle.trade_off.front import front
from tests.support.commands import attacks, once, prose
from tests.support.weighted import weighted_loop

MEASURED = 'measured = ["suspension_deflection", "sprung_velocity"]'
CARRIED = f"\n[controllers.carried]\n{MEASURED}\nloads = {{ heave_load = 1000.0 }}\n"
FELT = (
    '\n[controllers.felt]\nmeasured = ["suspension_deflection", "sprung_acceleration", "control_force"]\norder = "full"\n'
    "loads = { heave_load = 1000.0 }\n"
)
OF_CAR = (
    '\n[controllers.carried]\nmeasured = ["suspension_deflection_front", "suspension_deflection_rear", "heave_velocity", '
    '"pitch_rate"]\nloads = { heave_load = 1000.0, pitch_load = 500.0 }\n'
)


def largest(vehicle, controller: Controller, loads) -> float:
    """The largest gain from [w; loads] to z over a fine grid of frequencies, from the vehicle's equations and the law alone."""
    model = vehicle.linear_model
    law = controller.law.continuous()
    weights = np.array([vehicle.performance.get(name, 0.0) for name in model.outputs])
    C, D = model.rows(controller.measured)
    Dl = model.Dl[[model.outputs.index(name) for name in controller.measured]]
    some, scale = [model.loads.index(name) for name in loads], np.array(list(loads.values()))
    Bd = np.hstack([model.Bw, model.Bl[:, some] * scale])
    Dd = np.hstack([np.zeros((len(model.C), model.Bw.shape[1])), model.Dl[:, some] * scale])
    Dy = np.hstack([np.zeros((len(C), model.Bw.shape[1])), Dl[:, some] * scale])
    found, peak = 0.0, controller.certificate.norm.peak_frequency
    for omega in [*np.geomspace(1e-3, 1e3, 1500), *(peak * np.linspace(0.98, 1.02, 201))]:
        s = 1j * omega
        K = law.D + law.C @ np.linalg.solve(s * np.eye(law.states) - law.A, law.B) if law.states else law.D
        free = np.linalg.inv(s * np.eye(len(model.A)) - model.A)
        # y = C x + D u + Dy d, x = free (B u + Bd d), u = K y.
        of_u, of_d = C @ free @ model.B + D, C @ free @ Bd + Dy
        u = np.linalg.solve(np.eye(len(K)) - K @ of_u, K @ of_d)
        z = weights[:, None] * (model.C @ free @ (model.B @ u + Bd) + model.D @ u + Dd)
        found = max(found, float(np.linalg.norm(z, 2)))
    return found


@pytest.mark.parametrize(
    ("kind", "text", "name", "loads"),
    [
        *attacks([("quarter_car", CARRIED, "carried", {"heave_load": 1000.0})]),
        *attacks([("quarter_car_accelerometer", FELT, "felt", {"heave_load": 1000.0})]),
        ("half_car", OF_CAR, "carried", {"heave_load": 1000.0, "pitch_load": 500.0}),
    ],
)
def test_norm_is_of_road_and_loads_together(kind, text, name, loads):
    """The norm is the largest gain of both together, found again from the equations, between lower bound and bound."""
    vehicle = parse_vehicle(read_vehicle(kind).text + text)
    controller = Designer(vehicle).design(name)
    certificate = controller.certificate
    assert certificate.stable
    assert certificate.norm.value == pytest.approx(largest(vehicle, controller, loads), rel=1e-5)  # of a grid next to the peak
    assert certificate.bound is not None
    assert certificate.bound >= certificate.norm.value
    assert certificate.below is not None
    assert certificate.below.gamma <= certificate.norm.value * (1 + 1e-9)  # the norm's own digits
    alone = largest(vehicle, controller, {})
    assert alone < certificate.norm.value


def test_a_heavier_load_counts_more_and_none_nothing():
    """The joint lower bound rises with the load, from that of the road alone."""
    found = []
    for scale in (1e-3, 100.0, 1000.0, 5000.0):
        vehicle = parse_vehicle(read_vehicle("quarter_car").text + CARRIED.replace("1000.0", str(scale)))
        designer = Designer(vehicle)
        found.append(designer.lower_bound(("suspension_deflection", "sprung_velocity"), vehicle.hardware("carried")).gamma)
    road = Designer(read_vehicle("quarter_car")).lower_bound(("suspension_deflection", "sprung_velocity")).gamma
    assert found[0] == pytest.approx(road, rel=1e-6)
    assert np.all(np.diff(found) > 0)


def test_designed_for_loads_it_bears_them_better():
    """A gain that was designed for the road alone has a larger joint norm than the one that was designed for both."""
    vehicle = parse_vehicle(read_vehicle("quarter_car").text + CARRIED.replace("1000.0", "4000.0"))
    designer = Designer(vehicle)
    carried, plain = designer.design("carried"), designer.design("II")
    given = CARRIED.replace("1000.0", "4000.0").replace("carried", "given").replace(MEASURED, 'measured = ["sprung_velocity"]')
    law = f"gain = {plain.gain.tolist()}\n"
    judged = Designer(parse_vehicle(vehicle.text + given + law)).design("given")
    assert judged.certificate.norm.value > carried.certificate.norm.value
    assert judged.certificate.norm.value == pytest.approx(largest(vehicle, plain, {"heave_load": 4000.0}), rel=1e-4)  # a grid


def test_what_is_printed_and_saved(tmp_path, capsys):
    """The table says what the norm is of; a saved design keeps that and is checked; python-control has its norm."""
    file, saved = tmp_path / "car.toml", tmp_path / "saved.toml"
    file.write_text(read_vehicle("quarter_car").text + CARRIED)
    assert main(["--vehicle", str(file), "--controller", "carried", "--save", str(saved), "-v"]) == 0
    printed = prose(capsys.readouterr().out)
    assert "bounds include loads: 1000 N of heave_load each count as much as 1 m/s of unfiltered road velocity" in printed
    assert main(["--check", str(saved)]) == 0
    again = read_vehicle(saved)
    assert again.hardware("carried_designed" if "carried_designed" in again.controllers else "carried").loads == (
        ("heave_load", 1000.0),
    )
    capsys.readouterr()
    assert main(["--vehicle", str(file), "--controller", "carried", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["controllers"][0]["loads"] == {"heave_load": 1000.0}
    vehicle = read_vehicle(file)
    controller = Designer(vehicle).design("carried")
    loop = weighted_loop(vehicle, controller)
    assert list(loop.input_labels) == ["road_velocity", "load[heave_load]"]
    at_peak = loop(1j * controller.certificate.norm.peak_frequency)
    assert np.linalg.norm(at_peak, 2) == pytest.approx(controller.certificate.norm.value, rel=1e-9)


@pytest.mark.attack
def test_a_front_is_of_road_and_loads_together(tmp_path, capsys, monkeypatch):
    """Designs like one that weighs loads, and all beside them, are judged under road and loads, by a sweep; and that is said."""
    monkeypatch.setattr(synth.command.trade_off, "DESIGNS", 6)
    monkeypatch.setattr(synth.command.trade_off, "front", once(front))
    file = tmp_path / "mine.toml"
    file.write_text(read_vehicle("quarter_car").text + CARRIED)
    asked = ["--vehicle", str(file), "--front", "ride:travel", "--controller", "carried"]
    assert main([*asked, "-v"]) == 0
    said = prose(capsys.readouterr().out)
    assert main([*asked, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["loads"] == {"heave_load": 1000.0}
    assert "norm and bounds include loads: 1000 N of heave_load each count as much as 1 m/s of unfiltered road velocity" in said
    vehicle, omega = read_vehicle("quarter_car"), np.geomspace(1e-3, 1e3, 10_000)
    model = vehicle.linear_model
    Bd = np.hstack([model.Bw, 1000.0 * model.Bl])
    assert {one["name"] for one in found["others"]} >= {"passive", "I", "II"}
    for one in (*found["points"], *found["others"]):
        C, _ = model.rows(one["measured"])
        K = np.reshape(one["gain"], (1, len(C)))
        free = np.linalg.inv(1j * omega[:, None, None] * np.eye(4) - model.A - model.B @ K @ C)
        for axis, name in (("ride", "sprung_acceleration"), ("travel", "suspension_deflection")):
            i = model.outputs.index(name)
            row = model.C[i] + model.D[i] @ K @ C
            gains = np.linalg.norm(row @ free @ Bd + np.append(0.0, 1000.0 * model.Dl[i]), axis=-1)
            assert one["values"][axis]["value"] == pytest.approx(gains.max(), rel=1e-4)  # of the grid; measured 5e-5
    read = parse_vehicle(file.read_text())
    designed = synth.command.trade_off.front()  # pyright: ignore[reportCallIssue] (the one that was found)
    scope = Subject(read, Designer(read), (), 1e-3, True)
    assert np.isnan(measure(scope, designed, 0, designed.axes[0]))  # no road alone reaches it


def test_a_peak_over_a_road_with_loads_is_refused():
    """A bound on a peak is over a road alone: one whose road has loads is refused, not judged without them."""
    bound = '{ peak = "suspension_deflection", road = "bump + payload", at_most = 1.0 }'
    text = f"\n[controllers.mine]\n{MEASURED}\nbounds = [{bound}]\n"
    vehicle = parse_vehicle(read_vehicle("quarter_car").text + text)
    with pytest.raises(InputError, match="has loads on the vehicle, but a bound on a peak can account only for the road"):
        Designer(vehicle).design("mine")


def test_without_loads_nothing_changes(paper, designer):
    """A plant without weighed loads is the paper's, bit for bit."""
    other = parse_vehicle(paper.text + CARRIED)
    plain, same = designer.plant, Designer(other).plant
    for field in dataclasses.fields(plain):
        if field.name in ("A", "B", "Bw", "C", "D", "Dw"):
            np.testing.assert_array_equal(getattr(plain, field.name), getattr(same, field.name))
