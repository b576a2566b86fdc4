"""The worst road of a loop that a computer closes: MuJoCo reaches the exact norm on it, and nothing exceeds that."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import sim.frequency.periodic
import sim.frequency.sweep
from models.common.errors import InputError
from models.reality import Implementation, Limits
from models.roads.road import Bump, under_wheels
from models.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.frequency.apart import Apart
from sim.frequency.gain import l2_gain
from sim.frequency.periodic import worst_road
from sim.frequency.sweep import DRIVEN, REACHED
from sim.physics.simulate import simulate
from sim.sweep import main
from synth.designer import design
from synth.implemented.norm import norm_as_implemented
from tests.commands import prose

SAMPLED = "\n[implementation]\nsample_period = 0.01\n"


def driven(vehicle: Vehicle, name: str):
    controller = design(vehicle, name)
    norm = norm_as_implemented(vehicle, controller)
    road = worst_road(vehicle, controller, norm, 1e-4, 1e-3)
    assert road is not None
    assert not road.ended
    return norm.value, road


@pytest.mark.parametrize(
    ("car", "name", "how", "bandwidth"),
    [
        ("quarter_car", "I", Implementation(1e-2), None),
        ("quarter_car", "state", Implementation(5e-2), None),
        ("quarter_car", "II", Implementation(1e-2, 1), 60.0),
        ("quarter_car", "I", Implementation(delay=1), None),
        ("quarter_car_accelerometer", "accelerometer", Implementation(1e-2), None),
        ("quarter_car", "state", Implementation(2e-2, 1.3), None),
        ("half_car", "I", Implementation(1e-2, 1), None),
        ("half_car", "state", Implementation(1e-2), None),
        pytest.param("half_car", "state", Implementation(5e-2), None, marks=pytest.mark.slow),  # it turns by pi
        pytest.param("full_car", "I", Implementation(1e-2), None, marks=pytest.mark.slow),
    ],
)
def test_physics_reaches_the_norm(car, name, how, bandwidth):
    """On its worst road the loop gains in MuJoCo what is predicted, the norm to a thousandth, and no more."""
    vehicle = replace(read_vehicle(car), implementation=how, limits=Limits(actuator_bandwidth=bandwidth))
    norm, road = driven(vehicle, name)
    assert road.gain == pytest.approx(road.predicted, rel=1e-6)  # free motion that is left
    assert norm * (1 - REACHED) <= road.gain <= norm * (1 + DRIVEN)
    assert road.timestep <= (how.sample_period or 1e-3) / 8


def test_filters_are_in_it():
    """Where weights of z and of the road are filters, the gain is from what comes into the road's."""
    weights = 'sprung_acceleration = { weight = 1.0, filter = "iso2631_wk" }\n'
    weights += "road = { numerator = [30.0], denominator = [1.0, 30.0] }"
    text = read_vehicle("quarter_car").text
    assert "sprung_acceleration = 1.0" in text
    vehicle = parse_vehicle(text.replace("sprung_acceleration = 1.0", weights) + SAMPLED)
    controller = design(vehicle, "II")
    norm = norm_as_implemented(vehicle, controller).value
    found = worst_road(vehicle, controller, norm_as_implemented(vehicle, controller), 1e-4, 1e-3)
    assert found is not None
    assert found.gain == pytest.approx(found.predicted, rel=1e-6)
    assert norm * (1 - REACHED) <= found.gain <= norm * (1 + DRIVEN)


def test_nothing_exceeds_it(monkeypatch):
    """Of the same sinusoids no other combination gains as much in MuJoCo, one under each wheel of a half-car."""
    vehicle = replace(read_vehicle("half_car"), implementation=Implementation(1e-2))
    norm, best = driven(vehicle, "I")
    worst, rng = sim.frequency.periodic._worst, np.random.default_rng(3)

    def other(*arguments):
        predicted, waves, omega = worst(*arguments)
        found = waves + 0.1 * np.abs(waves).max() * (rng.standard_normal(waves.shape) + 1j * rng.standard_normal(waves.shape))
        return predicted, found / np.linalg.norm(found) * np.linalg.norm(waves), omega

    monkeypatch.setattr(sim.frequency.periodic, "_worst", other)
    for _ in range(3):
        _, road = driven(vehicle, "I")
        assert 0.3 * norm < road.gain < best.gain


def test_energy_between_leaps():
    """The gain of a run with a slow controller is the same, to the square of the step, at half the step."""
    vehicle = replace(read_vehicle("quarter_car"), implementation=Implementation(2e-2))
    controller, gains = design(vehicle, "state"), []
    for h in (2e-3, 1e-3, 5e-4):
        time = np.arange(round(3 / h) + 1) * h
        run = simulate([vehicle], [controller], [Bump(height=1e-4)], time).response.run(0)
        gains.append(l2_gain(vehicle, run))
    assert gains[0] - gains[1] == pytest.approx(4 * (gains[1] - gains[2]), rel=0.2)  # of order 2, with the ends of the bump


def test_a_road_under_each_wheel():
    """Every wheel of a full car has sinusoids of its own, from height zero, whose velocity is the derivative."""
    vehicle, rng = read_vehicle("full_car"), np.random.default_rng(0)
    omega, waves = np.array([3.0, -40.0]), rng.standard_normal((2, 4)) + 1j * rng.standard_normal((2, 4))
    road, time = Apart.under(vehicle, omega, waves, 5.0).scaled(2.0), np.linspace(0, 5, 4001)
    heights, rates = (under_wheels(one, road, vehicle, time) for one in (road.displacement, road.velocity))
    expected = 2 * np.real(np.exp(1j * np.multiply.outer(time, omega)) @ waves)
    assert rates == pytest.approx(expected, abs=1e-9)
    assert heights[0] == pytest.approx(np.zeros(4), abs=1e-12)
    slopes = np.gradient(heights, time, axis=0)
    assert slopes[1:-1] == pytest.approx(rates[1:-1], abs=3e-3)  # (40 * 1.25e-3)^2 / 6 of a rate of about 5
    assert road.highest(time) == pytest.approx(np.abs(heights).max(), rel=1e-9)


def sweep(capsys, tmp_path, text: str, *arguments: str) -> tuple[int, dict, str]:
    car = tmp_path / "car.toml"
    car.write_text(text)
    code = main(["--vehicle", str(car), *arguments, "--json"])
    found = json.loads(capsys.readouterr().out)["sweeps"]
    assert main(["--vehicle", str(car), *arguments]) == code
    return code, found[0], prose(capsys.readouterr().out)


def test_it_is_printed(capsys, tmp_path):
    """A sweep of a slower computer says gain and norm on a line of its own, and no gain is above the norm."""
    code, found, printed = sweep(capsys, tmp_path, read_vehicle("quarter_car").text + SAMPLED, "--controller", "I")
    assert code == 0
    road, norm = found["worst_road"], found["sampled_norm"]
    assert norm == pytest.approx(7.8651, rel=1e-5)  # of five digits
    assert f"worst road of the sampled loop: gain {road['gain']:.7g}, norm {norm:.7g}" in printed
    assert max(found["gains"].values()) < norm
    assert printed.endswith("I agrees: every line, the invariants, and the norm as the largest gain")


def test_without_an_implementation_there_is_none(capsys, tmp_path):
    """Of a file that says nothing of its computer nothing is said of it."""
    _, found, printed = sweep(capsys, tmp_path, read_vehicle("quarter_car").text, "--controller", "I")
    assert "worst_road" not in found
    assert "worst road" not in printed


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (0.99, "only; the norm of the sampled loop is 7.865064"),
        pytest.param(1.001, "above the norm 7.865064 of the", marks=pytest.mark.slow),
    ],
)
def test_a_false_norm_is_said(capsys, tmp_path, monkeypatch, factor, words):
    """A gain that is not what is predicted, below the norm or above it, is a disagreement."""
    monkeypatch.setattr(
        sim.frequency.periodic, "mean_square", lambda *a, true=sim.frequency.periodic.mean_square: factor**2 * true(*a)
    )
    code, found, printed = sweep(capsys, tmp_path, read_vehicle("quarter_car").text + SAMPLED, "--controller", "I")
    assert code == 1
    assert len(found["failures"]) == 2
    assert f"DOES NOT AGREE: {found['failures'][0]}" in printed
    assert words in found["failures"][1]
    assert math.isclose(found["worst_road"]["gain"], factor * found["worst_road"]["predicted"], rel_tol=1e-6)


def test_no_multiple_of_the_timestep(tmp_path):
    """Physics cannot hold a force for a part of a step; one line says so."""
    car = tmp_path / "car.toml"
    car.write_text(read_vehicle("quarter_car").text + "\n[implementation]\nsample_period = 0.0105\n")
    with pytest.raises(InputError, match=r"sample_period = 0.0105 s is no multiple of the timestep, 0.001 s"):
        main(["--vehicle", str(car), "--controller", "I"])
