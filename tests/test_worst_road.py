"""The worst road of a loop that a computer closes: MuJoCo reaches the exact norm on it, and nothing exceeds that."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import sim.studies.frequency.sweep
import sim.studies.frequency.worst_case_gain
from models.common.errors import InputError
from models.laws.filter import Filter
from models.roads.road import Bump, under_wheels
from models.vehicle.limits_and_implementation import Implementation, Limits
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.studies.frequency.identification import l2_gain
from sim.studies.frequency.sweep import DRIVEN, REACHED, failures
from sim.studies.frequency.worst_case_gain import PerWheelRoad, worst_road
from sim.sweep import main
from synth.analysis.sampled_norm import SampledNorm
from synth.controller.controller import Controller
from synth.controller.implementation_norm import norm_as_implemented
from synth.vehicle.designer import design
from tests.analysed import simulate
from tests.commands import attacks, once, prose
from tests.shared import made, share

SAMPLED = "\n[implementation]\nsample_period = 0.01\n"


def driven(vehicle: Vehicle, name: str):
    controller, norm = made(claimed, vehicle, name)
    road = worst_road(vehicle, controller, norm, 1e-4, 1e-3)
    assert road is not None
    assert not road.ended
    return norm.value, road


def claimed(vehicle: Vehicle, name: str) -> tuple[Controller, SampledNorm]:
    controller = design(vehicle, name)
    return controller, norm_as_implemented(vehicle, controller)


@pytest.mark.parametrize(
    ("car", "name", "how", "bandwidth"),
    [
        pytest.param("quarter_car", "state", Implementation(5e-2), None, marks=pytest.mark.attack),
        *attacks([("quarter_car", "II", Implementation(1e-2, 1.3), 60.0)]),
        pytest.param("quarter_car", "I", Implementation(delay=1), None, marks=pytest.mark.attack),
        pytest.param("quarter_car_accelerometer", "accelerometer", Implementation(1e-2), None, marks=pytest.mark.attack),
        pytest.param("half_car", "I", Implementation(1e-2, 1), None, marks=pytest.mark.attack),
        pytest.param("half_car", "state", Implementation(1e-2), None, marks=pytest.mark.attack),
        ("half_car", "state", Implementation(5e-2), None),  # it turns by pi
        pytest.param("full_car", "I", Implementation(1e-2), None, marks=pytest.mark.attack),
    ],
)
def test_physics_reaches_the_norm(car, name, how, bandwidth):
    """On its worst road the loop gains in MuJoCo what is predicted, the norm to a thousandth, and no more."""
    vehicle = replace(read_vehicle(car), implementation=how, limits=Limits(actuator_bandwidth=bandwidth))
    norm, road = driven(vehicle, name)
    assert road.gain == pytest.approx(road.predicted, rel=1e-6)  # free motion that is left
    assert norm * (1 - REACHED) <= road.gain <= norm * (1 + DRIVEN)
    assert road.timestep <= (how.sample_period or 1e-3) / 8


@pytest.mark.attack
def test_filters_are_in_it():
    """If weights of z and of the road are filters, the gain is from what comes into the road's."""
    weights = 'sprung_acceleration = { weight = 1.0, filter = "iso2631_wk" }\n'
    weights += "road = { numerator = [30.0], denominator = [1.0, 30.0] }"
    text = read_vehicle("quarter_car").text
    assert "sprung_acceleration = 1.0" in text
    vehicle = parse_vehicle(text.replace("sprung_acceleration = 1.0", weights) + SAMPLED)
    controller = design(vehicle, "II")
    sampled = norm_as_implemented(vehicle, controller)
    norm, found = sampled.value, worst_road(vehicle, controller, sampled, 1e-4, 1e-3)
    assert found is not None
    assert found.gain == pytest.approx(found.predicted, rel=1e-6)
    assert norm * (1 - REACHED) <= found.gain <= norm * (1 + DRIVEN)


@pytest.mark.attack
def test_nothing_exceeds_it(monkeypatch):
    """For the same sinusoids no other combination gains as much in MuJoCo, one under each wheel of a half-car."""
    vehicle = replace(read_vehicle("half_car"), implementation=Implementation(1e-2))
    norm, best = driven(vehicle, "I")
    worst, rng = sim.studies.frequency.worst_case_gain._worst, np.random.default_rng(3)

    def other(*arguments):
        predicted, waves, omega = worst(*arguments)
        found = waves + 0.1 * np.abs(waves).max() * (rng.standard_normal(waves.shape) + 1j * rng.standard_normal(waves.shape))
        return predicted, found / np.linalg.norm(found) * np.linalg.norm(waves), omega

    monkeypatch.setattr(sim.studies.frequency.worst_case_gain, "_worst", other)
    _, road = driven(vehicle, "I")
    assert 0.3 * norm < road.gain < best.gain


def test_energy_between_leaps():
    """The gain of a run with a slow controller is the same, to the square of the step, at half the step; and through a filter."""
    vehicle = replace(read_vehicle("quarter_car"), implementation=Implementation(2e-2))
    filtered = replace(vehicle, filters={"sprung_acceleration": Filter((((1.0, 0.5), (1.0, 30.0)),))})  # it passes on leaps
    controller, gains = design(vehicle, "state"), []
    for h in (2e-3, 1e-3, 5e-4):
        time = np.arange(round(3 / h) + 1) * h
        run = simulate([vehicle], [controller], [Bump(height=1e-4)], time).response.run(0)
        gains.append([l2_gain(one, run) for one in (vehicle, filtered)])
    for coarse, middle, fine in np.array(gains).T:
        assert coarse - middle == pytest.approx(4 * (middle - fine), rel=0.2)  # of order 2, with the ends of the bump


def test_a_road_under_each_wheel():
    """Every wheel of a full car has sinusoids of its own, from height zero, whose velocity is the derivative."""
    vehicle, rng = read_vehicle("full_car"), np.random.default_rng(0)
    omega, waves = np.array([3.0, -40.0]), rng.standard_normal((2, 4)) + 1j * rng.standard_normal((2, 4))
    road, time = PerWheelRoad.under(vehicle, omega, waves, 5.0).scaled(2.0), np.linspace(0, 5, 4001)
    heights, rates = (under_wheels(one, road, vehicle, time) for one in (road.displacement, road.velocity))
    expected = 2 * np.real(np.exp(1j * np.multiply.outer(time, omega)) @ waves)
    assert rates == pytest.approx(expected, abs=1e-9)
    assert heights[0] == pytest.approx(np.zeros(4), abs=1e-12)
    slopes = np.gradient(heights, time, axis=0)
    assert slopes[1:-1] == pytest.approx(rates[1:-1], abs=3e-3)  # (40 * 1.25e-3)^2 / 6 of a rate of about 5
    assert road.highest(time) == pytest.approx(np.abs(heights).max(), rel=1e-9)


@pytest.fixture
def of_one_sweep(monkeypatch):
    """Words and `--json` are of one sweep, and all sweeps of a vehicle of the same lines, sinusoids, loads, norm and road."""
    monkeypatch.setattr(sim.studies.frequency.sweep, "sweep", once(sim.studies.frequency.sweep.sweep))
    share(monkeypatch, sim.studies.frequency.sweep, "identify", "extremes", "minimum_loads", "norm_if_implemented", "worst_road")


@pytest.fixture(scope="module")
def car(tmp_path_factory):
    """The paper's vehicle with a slower computer, whose file is one for all."""
    path = tmp_path_factory.mktemp("cars") / "car.toml"
    path.write_text(read_vehicle("quarter_car").text + SAMPLED)
    return path


def sweep(capsys, car, *arguments: str, timestep: str = "2e-3") -> tuple[int, dict, str]:
    arguments = (*arguments, "--timestep", timestep)
    code = main(["--vehicle", str(car), *arguments, "--json"])
    found = json.loads(capsys.readouterr().out)["sweeps"]
    assert main(["--vehicle", str(car), *arguments]) == code
    return code, found[0], prose(capsys.readouterr().out)


@pytest.mark.attack
def test_it_is_printed(capsys, car, of_one_sweep):
    """A sweep of a slower computer says gain and norm on a line of its own, and no gain is above the norm."""
    code, found, printed = sweep(capsys, car, "--controller", "I")
    assert code == 0
    road, norm = found["worst_road"], found["sampled_norm"]
    assert norm == pytest.approx(7.8651, rel=1e-5)  # of five digits
    assert f"worst road of the sampled loop: gain {road['gain']:.7g}, norm {norm:.7g}" in printed
    assert max(found["gains"].values()) < norm
    assert printed.endswith("I agrees: every line, the invariants, and the norm as the largest gain")


def test_without_an_implementation_there_is_none(capsys, of_one_sweep):
    """For a file that says nothing of its computer nothing is said of it."""
    _, found, printed = sweep(capsys, "quarter_car", "--controller", "I", timestep="4e-3")
    assert "worst_road" not in found
    assert "worst road" not in printed


@pytest.mark.parametrize(
    ("factor", "words"),
    [*attacks([(0.99, "only; the norm of the sampled loop is 7.865064")]), (1.001, "above the norm 7.865064 of the")],
)
def test_a_false_norm_is_said(capsys, car, monkeypatch, of_one_sweep, factor, words):
    """A gain that is not what is predicted, below the norm or above it, is a disagreement."""

    def other(*arguments):
        found = made(worst_road, *arguments)
        assert found is not None
        return replace(found, gain=factor * found.gain)

    monkeypatch.setattr(sim.studies.frequency.sweep, "worst_road", other)
    code, found, printed = sweep(capsys, car, "--controller", "I", timestep="5e-3")
    assert code == 1
    assert len(found["failures"]) == 2
    assert f"DOES NOT AGREE: {found['failures'][0]}" in printed
    assert words in found["failures"][1]
    assert math.isclose(found["worst_road"]["gain"], factor * found["worst_road"]["predicted"], rel_tol=1e-6)


@pytest.mark.parametrize("delay", [*attacks([0.0, 1.5]), 1.0])
def test_gain_at_the_timestep(delay):
    """The worst sinusoid under a slow controller has the gain that is predicted at the run's step, which is above the norm."""
    text = (
        read_vehicle("quarter_car")
        .text.replace("13100.0", "22500.0")
        .replace("suspension_damping = 400.0", "suspension_damping = 1200.0")
    )
    vehicle = parse_vehicle(
        f"{text}\n[implementation]\nsample_period = 0.004\ndelay = {delay}\n"
        '[controllers.mine]\nmeasured = ["suspension_deflection", "sprung_velocity"]\ndesign = "h2"\n'
    )
    (found,) = sim.studies.frequency.sweep.sweep(vehicle, [design(vehicle, "mine")], 1e-4, 1e-3, 12.5)
    assert failures(found) == []
    assert found.sampled is not None
    (predicted, finer), gain = found.extremes.predicted, found.gains["worst sinusoid"]
    assert gain == pytest.approx(predicted, rel=1e-4)  # RK4 is 1e-5 off in the lines, and at a peak their phase counts
    assert gain > found.sampled.value * (1 + 5e-4)
    assert predicted + 4 / 3 * (finer - predicted) <= found.sampled.value * (1 + 1e-4)  # the fourth power of the step is left
    off = replace(found, extremes=replace(found.extremes, gains={"worst sinusoid": 1.0005 * gain}))
    assert "is predicted" in failures(off)[0]


def test_no_multiple_of_the_timestep(tmp_path):
    """Physics cannot hold a force for a part of a step; one line says so."""
    car = tmp_path / "car.toml"
    car.write_text(read_vehicle("quarter_car").text + "\n[implementation]\nsample_period = 0.0105\n")
    with pytest.raises(InputError, match=r"sample_period = 0.0105 s is no multiple of the timestep, 0.001 s"):
        main(["--vehicle", str(car), "--controller", "I"])
