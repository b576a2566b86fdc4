"""The ride that a design leads to, beside its norm: what `python -m synth` expects on an average road, and a comfort template."""

import json

import pytest

from models.roads.iso8608 import Iso8608
from models.roads.road import track_width
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.studies.ride.expected import expect
from synth.__main__ import main
from synth.vehicle.designer import Designer
from synth.vehicle.expected_ride import expected_ride
from tests.support.commands import prose
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
