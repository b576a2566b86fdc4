"""The ride that a design leads to, beside its norm: what `python -m synth` expects on an average road, and a comfort template."""

import json

import numpy as np
import pytest

from models.roads.iso8608 import Iso8608
from models.roads.road import RoadInput, track_width
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.runs.run import sample_times
from sim.studies.ride.expected import expect
from sim.studies.ride.metrics import measure
from synth.__main__ import main
from synth.vehicle.designer import Designer, design
from synth.vehicle.expected_ride import expected_ride
from tests.support.analysed import simulate_inputs as simulate
from tests.support.commands import prose
from tests.support.curved import curved_text, with_curves
from tests.support.pages import site


@pytest.mark.parametrize("name", ["quarter_car", "half_car", "full_car"])
def test_it_is_what_a_drive_expects(name):
    """The expected ride is `sim.drive`'s expectation of the loop that a computer runs, for short steps: half as far at half a
    step."""
    vehicle = read_vehicle(name)
    spectrum = Iso8608("C", speed=20.0, track_width=track_width(vehicle)).spectrum
    if name == "quarter_car":
        vehicle = parse_vehicle(vehicle.text + '\n[controllers.ahead]\ndesign = "preview"\npreview = 0.02\n')
    designer = Designer(vehicle, search=False)

    def apart(controller, timestep: float) -> float:
        found, ride = expect(vehicle, controller, spectrum, timestep, 10.0), expected_ride(vehicle, controller)
        assert found is not None
        assert ride is not None
        return max(value for metric, value in found.mean.items() if metric.endswith("_weighted")) / ride - 1

    controller = designer.design("passive")
    assert abs(apart(controller, 1e-3)) < 5e-4  # MuJoCo holds the road over a step
    # A preview smooths a road's jolts, and leaves those of the steps.
    for controller, step, most in (("I", 1e-3, 0.01), *([("ahead", 2e-4, 0.04)] if name == "quarter_car" else [])):
        coarse, fine = (apart(designer.design(controller), each) for each in (step, step / 2))
        assert 0 < coarse < most
        assert fine == pytest.approx(coarse / 2, rel=0.1)  # of first order in the step


def test_a_friction_like_damper_rides_as_in_mujoco(tmp_path, capsys):
    """The expected ride of `synth` and of `sim.drive` is that in MuJoCo over long roads."""
    v = np.linspace(-2.0, 2.0, 401)
    force = 900 * np.tanh(v / 0.06) + 600 * v
    table = f"{{ velocity = {v.tolist()}, force = {force.tolist()}, fit_error = 0.01 }}"
    vehicle = with_curves(
        suspension_stiffness="{ deflection = [-1, 0, 1], force = [-19600, 0, 19600] }", suspension_damping=table
    )
    controller, road = design(vehicle, "passive"), Iso8608("C", 0, 20.0, length=850.0)
    time = sample_times(vehicle, 40.0, 4e-3)
    run = simulate([controller], [RoadInput(vehicle, road, time)]).run(0)
    truth = measure(vehicle, run, 500)["sprung_acceleration_weighted"]  # +- 1 % by road
    assert expected_ride(vehicle, controller) == pytest.approx(truth, rel=0.04)  # measured 2 % over 6 roads of 55 s
    expected = expect(vehicle, controller, road.spectrum, 4e-3, 40.0)
    assert expected is not None
    assert expected.mean["sprung_acceleration_weighted"] == pytest.approx(truth, rel=0.04)  # as much; -10 % with the remainder
    at_rest = expected_ride(vehicle.linearised, controller)
    assert at_rest is not None
    assert at_rest > 1.6 * truth
    (tmp_path / "car.toml").write_text(vehicle.text)
    assert main(["--vehicle", str(tmp_path / "car.toml"), "--controller", "passive"]) == 0
    said = prose(capsys.readouterr().out)
    assert f"by statistical linearisation [m/s2]: passive {expected_ride(vehicle, controller):.3g}" in said


def test_without_a_consistent_line_there_is_a_reason(tmp_path, capsys):
    """A law that cancels a softening spring leaves no line that is consistent with a stable loop: null, with the reason."""
    soft = "{ deflection = [-0.3, -0.02, 0, 0.02, 0.3], force = [-960, -400, 0, 400, 960] }"
    cancels = '\n[controllers.cancels]\nmeasured = ["suspension_deflection"]\ngain = [[15000.0]]\n'
    (tmp_path / "car.toml").write_text(curved_text(more=cancels, suspension_stiffness=soft))
    assert main(["--vehicle", str(tmp_path / "car.toml"), "--controller", "cancels", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["controllers"][0]["expected_ride"] is None
    assert "no linear approximation" in found["expected_ride"]["without"]["cancels"]


def test_a_worse_ride_is_said(tmp_path, capsys):
    """A design whose norm falls while its ride gets worse is named; the numbers printed are those of `--json`."""
    text = read_vehicle("quarter_car_semi_active").text
    (tmp_path / "car.toml").write_text(text.replace("control_force = 1e-3", "control_force = 4e-3"))  # with 1e-3 both ride better
    options = ["--vehicle", str(tmp_path / "car.toml"), "--controller", "state", "--controller", "I"]
    assert main([*options, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    passive, rows = found["expected_ride"]["passive"], {row["name"]: row["expected_ride"] for row in found["controllers"]}
    assert rows["I"] < passive < rows["state"]
    assert main(options) == 0
    printed = capsys.readouterr().out
    assert "The ride is WORSE than passive: state. " in prose(printed)
    assert f"passive {passive:.3g}; state {rows['state']:.3g} (+" in prose(printed)
    assert printed.splitlines()[-1].startswith("every claim holds")


def test_no_ride_of_a_loop_that_is_lost():
    """A loop that is not stable has no expected ride."""
    wild = '\n[controllers.wild]\nmeasured = ["sprung_velocity"]\ngain = [[1e5]]\n'
    designer = Designer(parse_vehicle(read_vehicle("quarter_car").text + wild))
    assert expected_ride(designer.vehicle, designer.design("wild")) is None


@pytest.mark.attack
def test_the_comfort_template():
    """The template of the page rides as much better than the passive car as is said there, for the tyre load said there."""
    page = site("Weights for comfort")
    weights, controller = page.blocks("toml")[0].split("\n\n")
    text = read_vehicle("quarter_car").text
    start = text.index("[performance]")
    designer = Designer(parse_vehicle(text[:start] + weights + text[text.index("\n\n", start) :] + controller))
    assert designer.vehicle.filters["sprung_acceleration"].name == "iso2631_wk"
    passive, comfort = (designer.design(name) for name in ("passive", "comfort"))
    ride = {each.name: expected_ride(designer.vehicle, each) for each in (passive, comfort)}
    assert f"falls from {ride['passive']:.3g} (passive) to {ride['comfort']:.3g} m/s2" in prose(page.text)
    spectrum = Iso8608("C", speed=20.0).spectrum
    found = [expect(designer.vehicle, each, spectrum, 1e-3, 10.0) for each in (comfort, passive)]
    loads = [one.mean["dynamic_load"] for one in found if one is not None]
    assert f"the dynamic tyre load rises by {100 * (loads[0] / loads[1] - 1):.0f} %" in prose(page.text)
