"""Ride metrics: the weighting, what is measured of signals that are known, and the linear predictions by three routes."""

import dataclasses

import numpy as np
import pytest
from scipy import linalg

import sim.expected
from models.reality import Limits
from models.vehicle import read_vehicle
from sim.expected import expect, settling_time
from sim.iso8608 import Iso8608
from sim.linear import driven
from sim.metrics import Meter, measure, metrics_of
from sim.physics import simulate
from sim.response import Response
from sim.road import track_width
from sim.weighting import sampled_wk, wk
from synth.controller import Designer

# |W_k| of ISO 2631-1, table 3, in thousandths.
TABLE = {0.5: 418, 1: 482, 2: 531, 4: 967, 5: 1039, 8: 1036, 10: 988, 16: 769, 31.5: 405, 80: 132}
CLOSED = {
    "sprung_mass": 300,
    "unsprung_mass": 60,
    "suspension_stiffness": 16000,
    "suspension_damping": 1000,
    "tyre_stiffness": 190000,
}


@pytest.fixture(scope="module")
def textbook(paper):
    """A quarter-car with a damper as cars have it."""
    return dataclasses.replace(paper, parameters={name: float(value) for name, value in CLOSED.items()})


@pytest.mark.parametrize(("frequency", "thousandths"), TABLE.items())
def test_weighting_is_the_standards(frequency, thousandths):
    """W_k has the values of the standard's table."""
    assert 1000 * abs(wk(np.array(2 * np.pi * frequency))) == pytest.approx(thousandths, abs=0.5)  # half a digit


def test_weighting_between_table_values():
    """And 0.7718 at 100 rad/s."""
    assert abs(wk(np.array(100.0))) == pytest.approx(0.7718, abs=5e-5)


@pytest.mark.parametrize(
    ("timestep", "allowed"), [(1e-3, 1e-3), (2e-3, 2e-2)]
)  # (omega h)^4 / 240 at 80 Hz: 3e-4, 4e-3, and images
def test_sampled_weighting(timestep, allowed):
    """On samples it is the analog one, from 0.1 to 80 Hz."""
    omega = 2 * np.pi * np.geomspace(0.1, 80, 200)
    assert np.abs(np.abs(sampled_wk(timestep).response(omega, timestep)) / np.abs(wk(omega)) - 1).max() < allowed


def sine(vehicle, amplitudes, omega, time):
    """A response in which every signal is a sine of its own amplitude."""
    names = [signal.name for signal in vehicle.kind.signals]
    values = np.stack([amplitudes.get(name, 0.0) * np.sin(omega * time) for name in names], axis=-1)
    return Response(time, vehicle.kind.signals, values)


def test_metrics_of_a_sine(paper):
    """Of sinusoidal signals every metric is what a page of algebra says."""
    vehicle = dataclasses.replace(paper, limits=Limits(suspension_stroke=0.05, stop_stiffness=1e5))
    omega, time = 2 * np.pi * 4, np.arange(40_001) * 1e-3
    static = vehicle.kind.static_tyre_deflection(vehicle.parameters)["tyre_deflection"]
    amplitudes = {
        "sprung_acceleration": 2.0,
        "suspension_deflection": 0.1,
        "tyre_deflection": static / 2,
        "sprung_velocity": 0.4,
        "unsprung_velocity": 0.1,
        "control_force": 100.0,
    }
    found = measure(vehicle, sine(vehicle, amplitudes, omega, time), 20_001)  # whole periods
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
        "suspension_deflection_at_stops": 2 / 3,  # |sin| above a half
        "dynamic_load": 0.5 / np.sqrt(2),
        "off_ground": 0.0,
        "control_force_rms": 100 / np.sqrt(2),
        "control_force_peak": 100.0,
        "control_power": 100 * 0.3 / 2,
        "control_energy": 100 * 0.3 / 2 * 20,
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


def test_blocks_and_neighbours_do_not_matter(paper):
    """To the last bit, a run's metrics do not depend on what runs beside it, and a block's length only on its rounding."""
    rng = np.random.default_rng(1)
    values = rng.standard_normal((700, len(paper.kind.signals), 5))

    def metrics(runs, block):
        meter = Meter([paper] * len(runs), 1e-3, 123)
        for start in range(0, 700, block):
            meter.update(values[start : start + block][..., runs])
        return meter.result()

    together, alone, blocks = metrics([0, 1, 2, 3, 4], 100), metrics([3], 100), metrics([3], 37)
    for name, value in together.items():
        assert value[3] == alone[name][0]
        assert value[3] == pytest.approx(blocks[name][0], rel=1e-12)  # sums in another order


@pytest.fixture
def wide_band(monkeypatch):
    """Roads with spectra from 1e-6 to 10 000 cycles/m, so that white velocity is white."""
    monkeypatch.setattr(sim.expected, "LOWEST", 1e-6)
    monkeypatch.setattr(sim.expected, "HIGHEST", 1e4)
    monkeypatch.setattr(sim.expected, "LINES", 25_000)


def closed_forms(p, intensity):
    """Variances of a passive quarter-car on white road velocity of this two-sided intensity: stroke and acceleration."""
    m_s, m_u = p["sprung_mass"], p["unsprung_mass"]
    k_s, c_s, k_u = p["suspension_stiffness"], p["suspension_damping"], p["tyre_stiffness"]
    stroke = intensity * (m_s + m_u) / (2 * c_s)
    return stroke, intensity / 2 * ((m_s + m_u) * k_s**2 / (c_s * m_s**2) + k_u * c_s / m_s**2)


def white_covariance(vehicle, controller, road):
    """State covariance on white road velocity that every wheel meets later than the first, by Lyapunov equations.

    The response to an impulse of the road grows by one wheel's share at each delay and moves freely between them, so the
    covariance is a sum of finite Gramians; the integral of exp(A t) Q exp(A' t) over 0..d is X - exp(A d) X exp(A' d), A X + X A'
    = -Q.
    """
    model, G = driven(vehicle, controller)
    A, p = model.A + model.B @ G, vehicle.parameters
    delays = np.array([wheel.behind(p) / road.speed for wheel in vehicle.kind.wheels])
    kick, total, before = np.zeros((len(A), 1)), 0.0, 0.0
    for delay in np.unique(delays):
        grown = linalg.expm(A * (delay - before))
        X = linalg.solve_continuous_lyapunov(A, -kick @ kick.T)
        total = total + X - grown @ X @ grown.T
        kick, before = grown @ kick + model.Bw[:, delays == delay].sum(axis=1, keepdims=True), delay
    return model, G, total + linalg.solve_continuous_lyapunov(A, -kick @ kick.T)


def test_closed_forms(textbook, wide_band):
    """The spectral integral agrees with the closed forms, and with the numbers of the field: 0.3147 m/s2, 3.372 mm, 0.0735."""
    passive, road = Designer(textbook).design("passive"), Iso8608("A", 0, 20.0)
    found = expect(textbook, passive, road, 1e-6, 10.0)
    assert found is not None
    intensity = (2 * np.pi * 0.1) ** 2 * 16e-6 * 20 / 2
    stroke, acceleration = np.sqrt(closed_forms(CLOSED, intensity))
    assert found.mean["suspension_deflection_rms"] == pytest.approx(stroke, rel=1e-4)  # the band's ends
    assert found.mean["sprung_acceleration_rms"] == pytest.approx(acceleration, rel=1e-4)
    assert found.mean["sprung_acceleration_rms"] == pytest.approx(0.3147, abs=5e-5)
    assert found.mean["suspension_deflection_rms"] == pytest.approx(3.372e-3, abs=5e-7)
    assert found.mean["dynamic_load"] == pytest.approx(0.0735, abs=5e-5)
    assert found.mean["off_ground"] < 1e-9
    four_times = expect(textbook, passive, dataclasses.replace(road, road_class="C"), 1e-6, 10.0)
    assert four_times is not None
    for name in found.spread:
        assert four_times.mean[name] == pytest.approx(4 * found.mean[name])


@pytest.mark.parametrize("name", ["quarter_car", "half_car"])
@pytest.mark.parametrize("controller", ["passive", "I"])
def test_lyapunov(name, controller, wide_band):
    """With any controller, and with rear wheels that come later, the spectral integral is the Lyapunov equation's covariance."""
    vehicle = read_vehicle(name)
    designed, road = Designer(vehicle).design(controller), Iso8608("C", 0, 15.0)
    found = expect(vehicle, designed, road, 1e-6, 10.0)
    assert found is not None
    model, G, P = white_covariance(vehicle, designed, road)
    rows = model.C + model.D @ G
    P *= (2 * np.pi * 0.1) ** 2 * 256e-6 * 15 / 2
    rms = dict(zip(model.outputs, np.sqrt(np.einsum("si,ij,sj->s", rows, P, rows)), strict=True))
    static = vehicle.kind.static_tyre_deflection(vehicle.parameters)
    checked = 0
    for metric in metrics_of(vehicle):
        if metric.name.endswith("_rms") or metric.name.startswith("dynamic_load"):
            expected = rms[metric.source] / static.get(metric.source, 1.0)
            assert found.mean[metric.name] == pytest.approx(expected, rel=2e-4, abs=1e-12), metric.name  # the band's ends
            checked += 1
        if metric.name.startswith("control_power") and controller != "passive":
            ends = [metric.source.replace("control_force", end) for end in ("sprung_velocity", "unsprung_velocity")]
            u, top, bottom = (rows[model.outputs.index(signal)] for signal in (metric.source, *ends))
            size = rms[metric.source] * np.sqrt((top - bottom) @ P @ (top - bottom))
            assert found.mean[metric.name] == pytest.approx(u @ P @ (top - bottom), abs=2e-4 * size)
            checked += 1
    assert checked > 3


def test_one_track_and_two(wide_band):
    """A full car's two sides fare alike; the further apart its tracks are, the less they cohere and the less it heaves."""
    vehicle = read_vehicle("full_car")
    passive = Designer(vehicle).design("passive")
    found = [expect(vehicle, passive, Iso8608("C", 0, 20.0, width), 1e-6, 10.0) for width in (0.0, 1.5, 10.0)]
    heaves = []
    for one in found:
        assert one is not None
        heaves.append(one.mean["heave_acceleration_rms"])
        left, right = (one.mean[f"sprung_acceleration_front_{side}_rms"] for side in ("left", "right"))
        assert left == pytest.approx(right, rel=1e-9)
    assert heaves[0] > heaves[1] > heaves[2]
    assert heaves[2] == pytest.approx(heaves[0] / np.sqrt(2), rel=0.05)  # all but independent tracks


CASES = [("quarter_car", "passive", 20), ("quarter_car", "II", 40), ("half_car", "I", 24), ("full_car", "I", 16)]


@pytest.mark.slow
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
    found, expected = meter.result(), expect(vehicle, designed, roads[0], h, 6.0)
    assert expected is not None
    widths = []
    for metric in (metric.name for metric in metrics_of(vehicle)):
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
