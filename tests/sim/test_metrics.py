"""Ride metrics: the weighting, and what is measured of signals that are known."""

import dataclasses
import functools

import numpy as np
import pytest
from scipy import signal

from models.common.extensions import METRICS
from models.roads.iso8608 import Iso8608
from models.roads.road import Bump
from models.vehicle.limits_and_implementation import Limits
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.drive.response import Response
from sim.runs.run import run_controllers, sample_times
from sim.studies.ride.metrics import Metric, measure, metrics_of
from sim.studies.ride.weighting import sampled_wk, wk
from synth.vehicle.designer import Designer
from tests.conftest import BUILT, LAGGED
from tests.support.analysed import energy, simulate

# |W_k| of ISO 2631-1, table 3, in thousandths.
TABLE = {0.5: 418, 1: 482, 2: 531, 4: 967, 5: 1039, 8: 1036, 10: 988, 16: 769, 31.5: 405, 80: 132}


def test_weighting_is_the_standards():
    """W_k has the values of the standard's table, and 0.7718 at 100 rad/s."""
    for frequency, thousandths in TABLE.items():
        assert 1000 * abs(wk(np.array(2 * np.pi * frequency))) == pytest.approx(thousandths, abs=0.5)  # half a digit
    assert abs(wk(np.array(100.0))) == pytest.approx(0.7718, abs=5e-5)


@pytest.mark.parametrize(
    ("timestep", "allowed"), [(1e-3, 5e-6), (2e-3, 1e-4), (5e-3, 0.06)]
)  # as `sim/studies/ride/weighting.py` says
def test_sampled_weighting(timestep, allowed):
    """On samples it is the analog one, from 0.1 to 80 Hz."""
    omega = 2 * np.pi * np.geomspace(0.1, 80, 200)
    assert np.abs(np.abs(sampled_wk(timestep).response(omega, timestep)) / np.abs(wk(omega)) - 1).max() < allowed


def sine(vehicle, amplitudes, omega, time):
    """A response in which every signal is a sine of its own amplitude, complex for a phase."""
    names = [signal.name for signal in vehicle.kind.signals]
    values = np.stack([np.imag(amplitudes.get(name, 0.0) * np.exp(1j * omega * time)) for name in names], axis=-1)
    return Response(time, vehicle.kind.signals, values)


def test_metrics_of_a_sine(paper):
    """For sinusoidal signals every metric is what a page of algebra says."""
    vehicle = dataclasses.replace(paper, limits=Limits(suspension_stroke=0.05, stop_stiffness=1e5))
    omega, time = 2 * np.pi * 4, np.arange(40_001) * 1e-3
    static = vehicle.kind.static_tyre_deflection(vehicle.parameters)["tyre_deflection"]
    amplitudes = {
        "sprung_acceleration": 2.0,
        "suspension_deflection": -0.1j,  # whose velocity is in phase with the force
        "tyre_deflection": static / 2,
        "control_force": 100.0,
    }
    found = measure(vehicle, sine(vehicle, amplitudes, omega, time), 20_001)  # whole periods
    later = sine(vehicle, amplitudes, omega, time)
    assert measure(vehicle, dataclasses.replace(later, time=time + 7.0), 20_001) == pytest.approx(found, rel=1e-9)
    weighted = 2 * abs(wk(np.array(omega)))
    running = weighted * np.sqrt(0.5 + 0.5 / np.hypot(1, 2 * omega))  # of an exponential mean over 1 s at twice the frequency
    expected = {
        "sprung_acceleration_rms": 2 / np.sqrt(2),
        "sprung_acceleration_weighted": weighted / np.sqrt(2),
        "sprung_acceleration_vdv": weighted * (3 / 8 * 20) ** 0.25,
        "sprung_acceleration_mtvv": running,
        "sprung_acceleration_crest": np.sqrt(2),
        "suspension_deflection_rms": 0.1 / np.sqrt(2),
        "suspension_deflection_peak": 0.1,
        "suspension_deflection_at_stops": 2 / 3,  # |cos| above a half
        "dynamic_load": 0.5 / np.sqrt(2),
        "off_ground": 0.0,
        "control_force_rms": 100 / np.sqrt(2),
        "control_force_peak": 100.0,
        "control_power": 100 * 0.1 * omega / 2,
        "control_energy": 100 * 0.1 * omega / 2 * 20,
    }
    assert list(expected) == [metric.name for metric in metrics_of(vehicle)]
    for name, value in expected.items():
        allowed = 1e-2 if name.endswith("at_stops") else 2e-3  # counted in 250 samples a period; the start of the 1 s mean
        assert found[name] == pytest.approx(value, rel=allowed, abs=1e-12), name


def test_off_the_ground(paper):
    """A tyre stretched beyond its static squeeze carries nothing: that time is counted, and the load is no less than 0."""
    time, static = np.arange(20_001) * 1e-3, paper.kind.static_tyre_deflection(paper.parameters)["tyre_deflection"]
    found = measure(paper, sine(paper, {"tyre_deflection": 2 * static}, 2 * np.pi, time), 1)
    assert found["off_ground"] == pytest.approx(1 / 3, rel=2e-3)  # sin above a half
    angle = np.linspace(0, 2 * np.pi, 100_000, endpoint=False)
    assert found["dynamic_load"] == pytest.approx(np.sqrt(np.mean(np.minimum(2 * np.sin(angle), 1) ** 2)), rel=1e-3)


@pytest.mark.parametrize(
    ("kind", "reality"),
    [("quarter_car", ""), ("half_car", BUILT.format(delay=1)), ("quarter_car", LAGGED)],
    ids=["plain", "built", "lagged"],
)
def test_power_is_the_actuators_work(kind, reality):
    """Mean power times time is what the balance of energy has found of the actuators' work, whatever holds up their force."""
    vehicle, h = parse_vehicle(read_vehicle(kind).text + reality), 1e-3
    designed, road, time = Designer(vehicle).design("I"), Iso8608("C", 0, 20.0), np.arange(3001) * h
    runs = simulate([vehicle], [designed], [road], time)
    found = measure(vehicle, runs.response.run(0), 0)
    work = sum(value for name, value in found.items() if name.startswith("control_power")) * 3000 * h
    balance = energy(vehicle, runs, 0, road)
    # A held force's is exact; of one that lags within a step both rules are of second order: (60 rad/s h)^2 / 12 = 3e-4
    moved = sum(value for name, value in found.items() if name.startswith("control_energy"))
    assert work == pytest.approx(balance.actuators, abs=(1e-3 if reality == LAGGED else 1e-9) * moved)
    assert abs(work) > 1e-2 * moved  # there is some


@pytest.mark.parametrize("first", [0, 100])
def test_the_whole_window_of_a_run_that_ends_in_motion_counts(paper, first):
    """Weighted rms and VDV of 0.3 s over a bump are those of SciPy's analog filter, on the exact response at 50 us."""
    f1, f2, f3, f5, f6, q4, q5, q6 = 0.4, 100.0, 12.5, 2.37, 3.35, 0.63, 0.91, 0.91  # ISO 2631-1, table A.1
    w1, w2, w3, w5, w6 = (2 * np.pi * f for f in (f1, f2, f3, f5, f6))
    zeros = np.polymul([1 / w3, 1], [1 / w5**2, 1 / (q5 * w5), 1]) * w2**2 * (w5 / w6) ** 2
    below = [[1, w * 2**0.5, w**2] for w in (w1, w2)] + [[1 / w3**2, 1 / (q4 * w3), 1], [1 / w6**2, 1 / (q6 * w6), 1]]
    analog = signal.StateSpace(*signal.tf2ss(np.polymul([1, 0, 0], zeros), functools.reduce(np.polymul, below)))
    passive, road = [Designer(paper).design("passive")], Bump(height=0.05)
    coarse, fine = (run_controllers(paper, passive, road, sample_times(paper, 0.3, h))[0] for h in (1e-3, 5e-5))
    _, weighted, _ = signal.lsim(analog, fine.continuous["sprung_acceleration"], fine.prediction.time)
    weighted, found = weighted[20 * first :: 20], measure(paper, coarse.physics, first)  # a sample stands for a step
    # The filter's error, and a straight line through the last samples; without the last three, up to 1.5 % is missing.
    assert found["sprung_acceleration_weighted"] == pytest.approx(np.mean(weighted**2) ** 0.5, rel=2e-4)
    assert found["sprung_acceleration_vdv"] == pytest.approx((np.sum(weighted**4) * 1e-3) ** 0.25, rel=2e-4)


def test_a_metric_without_a_rule_is_refused(monkeypatch):
    """A metric says how it is combined over runs: one that does not is no metric, and never a mean by default."""
    monkeypatch.setattr(Metric, "what", "number", raising=False)
    monkeypatch.setattr(Metric, "unit", "-", raising=False)
    monkeypatch.setattr(Metric, "of", "tyres", raising=False)
    monkeypatch.setitem(METRICS, "number", "sim.studies.ride.metrics:Metric")
    with pytest.raises(TypeError, match=r"metric 'number': sim\.studies\.ride\.metrics:Metric has no over_runs"):
        METRICS.load_all()
