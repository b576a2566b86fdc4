"""What is expected over random roads of vehicles with curves: the line that does the same on average."""

import dataclasses
import itertools
import json

import numpy as np
import pytest
from scipy import integrate, stats

from models.roads.iso8608 import Iso8608
from models.vehicle import read_vehicle
from sim.drive import main
from sim.physics.simulate import simulate
from sim.ride.equivalent import averages, equivalent
from sim.ride.expected import expect
from sim.ride.metrics import measure
from sim.runs.run import sample_times
from synth.designer import design
from tests.commands import prose
from tests.curved import AXLES, DIGRESSIVE, PROGRESSIVE, curved_text, with_curves


@pytest.mark.parametrize(("mean", "deviation"), [(0.0, 0.3), (0.1, 0.02), (-0.4, 1.5), (0.2, 0.0)])
def test_averages_are_integrals(mean, deviation):
    """Mean force and mean slope over a Gaussian are the integrals of the curve, and the slope is the one of least squares."""
    curve = with_curves(suspension_damping=DIGRESSIVE).fitted[0].curve
    force, slope = averages(curve, mean, deviation)
    if not deviation:
        assert force == pytest.approx(float(curve(np.array(mean))))
        assert slope == pytest.approx((float(curve(np.array(mean + 0.01))) - force) / 0.01)
        return

    def average(function):
        ends = [mean - 12 * deviation, *(k for k in curve.x if abs(k - mean) < 12 * deviation), mean + 12 * deviation]
        pieces = itertools.pairwise(ends)
        return sum(integrate.quad(lambda x: function(x) * stats.norm.pdf(x, mean, deviation), *piece)[0] for piece in pieces)

    assert force == pytest.approx(average(lambda x: float(curve(np.array(x)))), rel=1e-9, abs=1e-9)
    least = average(lambda x: float(curve(np.array(x))) * (x - mean)) / deviation**2  # by parts the mean slope
    assert slope == pytest.approx(least, rel=1e-9)


def test_the_line_is_consistent_and_the_body_stands_lower():
    """The slopes that come out make the deviations of which they are the average; the springs hold the damper's mean force."""
    vehicle = with_curves(suspension_damping=DIGRESSIVE, suspension_stiffness=PROGRESSIVE)
    road = Iso8608("D", 0, 20.0).spectrum
    for name in ("passive", "I"):
        controller = design(vehicle, name)
        line, expected = equivalent(vehicle, controller, road, 1e-3), expect(vehicle, controller, road, 1e-3, 10.0)
        assert line is not None
        assert expected is not None
        assert 1 < line.rounds < (20 if name == "passive" else 100)
        plain = expect(line.vehicle, controller, road, 1e-3, 10.0)
        assert plain is not None
        shift, travel = line.mean["suspension_deflection"], "suspension_deflection_rms"
        assert shift < 0  # rebound is harder than bump
        assert expected.mean[travel] == pytest.approx(np.hypot(plain.mean[travel], shift), rel=1e-9)
        spring = next(one.curve for one in vehicle.fitted if one.parameter == "suspension_stiffness")
        force, slope = averages(spring, shift, plain.mean[travel])
        assert slope == pytest.approx(line.vehicle.parameters["suspension_stiffness"], rel=1e-5)  # rounds end at 1e-6
        if name == "passive":  # the damper's mean force, from its own line's deviation, is the spring's
            again = equivalent(vehicle, controller, road, 1e-3)
            assert again is not None
            damper = next(one.curve for one in vehicle.fitted if one.parameter == "suspension_damping")
            found = [averages(damper, 0.0, s) for s in np.linspace(0.01, 2, 4000)]
            forces, slopes = np.array(found).T
            met = np.interp(-line.vehicle.parameters["suspension_damping"], -slopes, forces)
            assert force == pytest.approx(-met, rel=1e-3)  # of the table of 4000


def test_without_curves_nothing_changes(paper):
    """A vehicle without curves is its own line, and so is one over a road that stays on the line at rest."""
    passive, road = design(paper, "passive"), Iso8608("C", 0, 20.0).spectrum
    line = equivalent(paper, passive, road, 1e-3)
    assert line is not None
    assert (line.vehicle, line.rounds, dict(line.mean)) == (paper, 0, {})
    flat = "{ velocity = [-9.0, -5.0, 0.0, 5.0, 9.0], force = [-2100, -2000, 0, 2000, 2100] }"
    line = equivalent(with_curves(suspension_damping=flat), passive, road, 1e-3)
    assert line is not None
    assert line.vehicle.parameters == pytest.approx(paper.parameters, rel=1e-12)


def test_it_says_so(tmp_path, capsys):
    """What is printed names slopes and mean deflections, as JSON has them."""
    (tmp_path / "mine.toml").write_text(curved_text("half_car", **AXLES))
    asked = ["--vehicle", str(tmp_path / "mine.toml"), "--controller", "passive", "--class", "C", "--duration", "4"]
    assert main([*asked, "--no-logs"]) == 0
    said = prose(capsys.readouterr().out)
    assert main([*asked, "--no-logs", "--json"]) == 0
    line = json.loads(capsys.readouterr().out)["runs"][0]["expected_line"]
    at_rest = read_vehicle(tmp_path / "mine.toml").parameters
    assert {*line["slopes"]} == {*AXLES}
    assert "expected numbers are by statistical linearisation" in said
    for name, slope in line["slopes"].items():
        assert f"{name} {slope:.4g}, not {at_rest[name]:.4g} as at rest" in said
    for name, mean in line["mean"].items():
        assert f"{name} is {1e3 * mean:.3g} mm on average" in said


METRICS = ("sprung_acceleration_rms", "sprung_acceleration_weighted", "suspension_deflection_rms", "dynamic_load")
SEEDS, SETTLED, WINDOW, STEP = 200, 3.0, 9.0, 2e-3


@pytest.mark.attack
@pytest.mark.parametrize("road_class", ["A", "B", "C"])
@pytest.mark.parametrize("name", ["passive", "II"])
def test_it_is_within_what_two_hundred_roads_say(road_class, name):
    """Over 200 roads in MuJoCo, ride, travel and load of a quarter-car with a digressive damper have the mean squares expected.

    The interval is of three standard errors: 24 comparisons, of which one in twenty would be outside of two.
    """
    vehicle = with_curves(suspension_damping=DIGRESSIVE)
    controller, time = design(vehicle, name), sample_times(vehicle, SETTLED + WINDOW, STEP)
    roads = [Iso8608(road_class, seed, 20.0) for seed in range(SEEDS)]
    response = simulate([vehicle] * SEEDS, [controller] * SEEDS, roads, time, threads=0).response
    first = round(SETTLED / STEP)
    found = [measure(vehicle, response.run(i), first) for i in range(SEEDS)]
    expected = expect(vehicle, controller, roads[0].spectrum, STEP, WINDOW)
    assert expected is not None
    at_rest = expect(dataclasses.replace(vehicle, curves={}), controller, roads[0].spectrum, STEP, WINDOW)
    assert at_rest is not None
    for metric in METRICS:
        squares = np.array([one[metric] for one in found]) ** 2
        error = 3 * squares.std() / np.sqrt(SEEDS)
        assert abs(expected.mean[metric] ** 2 - squares.mean()) < error, metric
        if road_class == "C" and name == "passive":  # where the line at rest would be far outside
            assert abs(at_rest.mean[metric] ** 2 - squares.mean()) > 2 * error, metric
