"""The expected ride metrics are those measured over many random roads, in linear responses and in MuJoCo."""

import numpy as np
import pytest

from models.roads.iso8608 import Iso8608, long_enough
from models.roads.road import track_width
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.studies.ride.expected import expect, settling_time
from sim.studies.ride.metrics import Meter
from synth.vehicle.designer import Designer
from tests.conftest import BUILT, LAGGED
from tests.support.analysed import sampled_responses, simulate
from tests.support.commands import attacks


@pytest.mark.parametrize("reality", [BUILT.format(delay=1), LAGGED], ids=["built", "lagged"])
def test_expected_power_is_that_of_responses(reality):
    """Over many roads the mean of linear responses' power and energy is the expected one, held or lagging."""
    vehicle = parse_vehicle(read_vehicle("quarter_car").text + reality)
    found, expected = linear_metrics(vehicle, Designer(vehicle).design("I"), "C", 5e-3, 8.0, range(64))
    for name in ("control_power", "control_energy"):
        # Three deviations of the mean of 64; a start with 1 % missing
        allowed = 3 * found[name].std(ddof=1) / 8 + 0.01 * abs(expected.mean[name])
        assert abs(found[name].mean() - expected.mean[name]) < allowed
        assert allowed < 0.2 * abs(expected.mean[name])


def linear_metrics(vehicle, designed, road_class, h, window, seeds, **more):
    """The metrics of linear responses over roads of these seeds, shape (N,) each, and what is expected of them."""
    first = round(settling_time(vehicle, designed) / h)
    time = np.arange(first + round(window / h)) * h
    length = long_enough(20.0 * float(time[-1]))
    roads = [Iso8608(road_class, seed, 20.0, track_width(vehicle), length, **more) for seed in seeds]
    meter = Meter([vehicle] * len(roads), h, first)
    meter.update(np.moveaxis(sampled_responses(vehicle, designed, roads, time).values, 0, -1))
    expected = expect(vehicle, designed, roads[0].spectrum, h, window)
    assert expected is not None
    return meter.result(), expected


@pytest.mark.parametrize(
    ("name", "controller", "road_class", "more"),
    [
        ("quarter_car", "I", "E", {}),
        *attacks(
            [
                ("quarter_car", "passive", "D", {}),
                ("half_car", "II", "E", {}),
                ("full_car", "passive", "E", {"waviness": 2.5, "lowest": 0.02, "highest": 5.0}),
            ]
        ),
    ],
)
def test_linear_response_over_many_seeds(name, controller, road_class, more):
    """On roads that tyres leave, too, mean squares of linear responses are those expected, within the spread that is expected."""
    vehicle = read_vehicle(name)
    found, expected = linear_metrics(vehicle, Designer(vehicle).design(controller), road_class, 4e-3, 8.0, range(64), **more)
    for metric, mean in expected.mean.items():
        if metric in expected.spread and mean:
            # The spread of a mean square is twice that of its root. 3.5 of the mean's: 99.95 %; a start with 1 % missing
            allowed = 3.5 * 2 * expected.spread[metric] * mean / np.sqrt(64) + 0.01 * mean**2
            assert abs((found[metric] ** 2).mean() - mean**2) < allowed, metric
            assert allowed < 0.25 * mean**2
            assert found[metric].std(ddof=1) == pytest.approx(expected.spread[metric], rel=0.35)  # of 64: 9 %, four times
        elif metric.startswith("off_ground"):
            assert found[metric].mean() == pytest.approx(mean, rel=0.1)
        elif metric.endswith(("_vdv", "_mtvv", "_crest", "_peak")) and mean:
            # As `sim/studies/ride/expected.py` says (VDV: of 10 % from road to road), and three deviations of the mean of 64
            kind = metric.rsplit("_", 1)[1]
            off = {"vdv": 0.02, "mtvv": 0.025, "crest": 0.05, "peak": 0.11 if (name, controller) == CASES[0][:2] else 0.07}[kind]
            assert abs(found[metric].mean() - mean) < off * mean + 3 * found[metric].std(ddof=1) / 8, metric
            if name == "quarter_car" and kind in ("crest", "peak"):  # beyond a deviation of the mean, as measured over 120 roads
                small = kind == "crest" and controller == "I"
                assert (mean < found[metric].mean()) == small, metric


@pytest.mark.attack
def test_one_track_and_two():
    """A full car's two sides fare alike; the further apart its tracks are, the less they cohere and the less it heaves."""
    vehicle = read_vehicle("full_car")
    passive = Designer(vehicle).design("passive")
    found = [expect(vehicle, passive, Iso8608("C", 0, 20.0, width).spectrum, 1e-3, 10.0) for width in (0.0, 1.5, 10.0)]
    heaves = []
    for one in found:
        assert one is not None
        heaves.append(one.mean["heave_acceleration_rms"])
        left, right = (one.mean[f"sprung_acceleration_front_{side}_rms"] for side in ("left", "right"))
        assert left == pytest.approx(right, rel=1e-9)
    assert heaves[0] > heaves[1] > heaves[2]
    assert heaves[2] == pytest.approx(heaves[0] / np.sqrt(2), rel=0.05)  # all but independent tracks


CASES = [("quarter_car", "passive", 20), ("half_car", "I", 24), ("full_car", "I", 16)]


@pytest.mark.attack
@pytest.mark.parametrize(("name", "controller", "seeds"), CASES)
def test_physics_over_many_seeds(textbook, name, controller, seeds):
    """MuJoCo's mean squares over seeds are those predicted, within their confidence interval; its largest values within 10 %."""
    vehicle = textbook if controller == "passive" else read_vehicle(name)
    designed, h = Designer(vehicle).design(controller), 2e-3
    roads = [Iso8608("A", seed, 20.0, track_width(vehicle)) for seed in range(1000, 1000 + seeds)]
    first = round(settling_time(vehicle, designed) / h)
    time = np.arange(first + 3000) * h
    values = simulate([vehicle] * seeds, [designed] * seeds, roads, time, threads=0).response.values
    meter = Meter([vehicle] * seeds, h, first)
    meter.update(np.moveaxis(values, 0, -1))
    found, expected = meter.result(), expect(vehicle, designed, roads[0].spectrum, h, 6.0)
    assert expected is not None
    widths = []
    for metric in expected.mean:
        mean, measured = expected.mean[metric], found[metric]
        if metric in expected.spread and mean:
            squares = measured**2
            error = squares.std(ddof=1) / np.sqrt(seeds)
            assert abs(squares.mean() - mean**2) < 3.5 * error, metric  # 99.95 %: some 30 metrics, most of them akin
            widths.append(error / mean**2)
            assert measured.std(ddof=1) == pytest.approx(expected.spread[metric], rel=0.6)  # of so few seeds
        elif metric.endswith(("_vdv", "_mtvv", "_crest", "_peak")) and mean:
            assert measured.mean() == pytest.approx(mean, rel=0.1), metric
        elif metric.startswith("control_energy") and mean:
            assert measured.mean() == pytest.approx(mean, rel=0.15), metric
    assert np.median(widths) < 0.05  # the interval could tell a factor of 1.2
