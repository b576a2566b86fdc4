"""The International Roughness Index: against what is published, the listing of 1995, and roads by the hundred."""

import json
import math

import numpy as np
import pytest
from scipy import integrate

import sim.command.comparison
from models.common.errors import InputError
from models.common.printed import three_digits
from models.roads.choice import choose_road
from models.roads.description import described_road
from models.roads.iri import (
    COUNTED_LINES,
    SPEED,
    STEP,
    A,
    B,
    C,
    Roughness,
    missing,
    roughness_index,
    roughness_of,
    slope_response,
    suspension_slopes,
)
from models.roads.iso8608 import Iso8608, roughness
from models.roads.profile import Profile
from models.roads.road import Bump, track_width
from models.vehicle.names import CLASSES
from models.vehicle.vehicle import read_vehicle
from sim.drive.__main__ import main
from sim.inspect.__main__ import main as inspect
from tests.support.commands import once, prose
from tests.support.rewriting import contents, written

QUARTER, CAR = read_vehicle("quarter_car"), read_vehicle("full_car")
# M. W. Sayers, T. D. Gillespie and W. D. O. Paterson (1986), World Bank Technical Paper 46, of samples 250 mm apart.
PUBLISHED = (
    [0.9966071, 0.01091514, -0.002083274, 0.0003190145],
    [-0.5563044, 0.9438768, -0.8324718, 0.05064701],
    [0.02153176, 0.002126763, 0.7508714, 0.008221888],
    [3.335013, 0.3376467, -39.12762, 0.4347564],
)
PUBLISHED_INPUT = [0.005476107, 1.388776, 0.2275968, 35.79262]


def heights_of(seed: int, step: float, count: int) -> np.ndarray:
    """A rough profile [m], shape (count,)."""
    return 0.01 * math.sqrt(step) * np.cumsum(np.random.default_rng(seed).standard_normal(count))


def theory(one: Roughness) -> tuple[float, float]:
    """Returns what is expected of one IRI, and its spread [m/km]."""
    assert one.expected is not None
    assert one.spread is not None
    return one.expected, one.spread


def transition(step: float) -> tuple[np.ndarray, np.ndarray]:
    """The state transition of the listing of 1995: Taylor series until nothing is added, and A^-1 (ST - 1) B."""
    time, total, term, order = step / SPEED, np.eye(4), np.eye(4), 0
    while np.any(total + term != total) or order < 4:
        order += 1
        term = term @ A * time / order
        total = total + term
    return total, np.linalg.solve(A, (total - np.eye(4)) @ B)


def listing(heights: np.ndarray, step: float, matrices: tuple[np.ndarray, np.ndarray] | None = None) -> float:
    """IRI of Sayers (1995), step by step as its listing goes [m/km]."""
    turn, push = matrices or transition(step)
    base, first = max(round(0.25 / step), 1), min(round(11 / step), len(heights))
    state = np.array([1.0, 0.0, 1.0, 0.0]) * (heights[first - 1] - heights[0]) / (step * first)
    total = 0.0
    for i in range(len(heights) - base):
        state = turn @ state + push * (heights[i + base] - heights[i]) / (step * base)
        total += abs(state[0] - state[2])
    return 1e3 * total / (len(heights) - base)


def test_published_coefficients():
    """The state transition that the World Bank printed in 1986 gives our IRI of 1 km of road."""
    heights = heights_of(1, 0.25, 4000)
    published = listing(heights, 0.25, (np.array(PUBLISHED), np.array(PUBLISHED_INPUT)))
    assert roughness_index(heights, 0.25) == pytest.approx(published, rel=1e-6)  # printed with 7 digits
    assert np.allclose(transition(0.25)[0], PUBLISHED, rtol=5e-7, atol=0)  # half of the last digit
    assert published > 1


@pytest.mark.parametrize("step", [0.025, 0.1524, 0.25, 0.3])
def test_listing(step):
    """At any sampling IRI is that of the listing of 1995, from 11 m of road to 500 m, with its start and its moving average."""
    for length in (11.5, 30.0, 500.0):
        heights = heights_of(2, step, math.ceil(length / step)) + 0.3 * step * np.arange(math.ceil(length / step))
        assert roughness_index(heights, step) == pytest.approx(listing(heights, step), rel=1e-10)  # rounding of 50 000 steps


def test_equations_of_motion():
    """The car is a quarter-car that is integrated anew: masses, springs, damper and tyre at 80 km/h, over held slopes."""
    step, sprung = 0.25, 700.0
    heights, (k_s, k_u, c, m_u) = heights_of(3, step, 200), sprung * np.array([63.3, 653.0, 6.0, 0.15])
    slopes = np.diff(heights) / step
    start = (heights[43] - heights[0]) / (step * 44)
    # In motion along that slope, without forces.
    state, found = np.array([0.0, start * SPEED, 0.0, start * SPEED, 0.0]), []

    def motion(_, x, rise):
        z_s, v_s, z_u, v_u, road = x
        push = k_s * (z_u - z_s) + c * (v_u - v_s)
        return [v_s, push / sprung, v_u, (k_u * (road - z_u) - push) / m_u, rise]

    for slope in slopes:
        done = integrate.solve_ivp(motion, (0, step / SPEED), state, args=(slope * SPEED,), rtol=1e-10, atol=1e-12)
        state = done.y[:, -1]
        found.append((state[1] - state[3]) / SPEED)
    assert np.allclose(suspension_slopes(heights, step), found, rtol=0, atol=1e-7 * np.abs(found).max())  # of 1e-10 by 200 steps


@pytest.mark.parametrize("wavelength", [0.6, 2.1, 5.0, 15.0, 60.0])
def test_sinusoid(wavelength):
    """IRI of a long sinusoid is 2/pi of its slope times the response of its spatial frequency, which is the car's own."""
    n, x = 1 / wavelength, np.arange(80_000) * STEP
    heights = np.sin(2 * np.pi * n * x) / (2 * np.pi * n)
    found = np.abs(suspension_slopes(heights, STEP))[8000:].mean()
    assert found == pytest.approx(2 / math.pi * abs(slope_response(np.array([n]), STEP)[0]), rel=2e-3)  # samples per wave
    s = 2j * np.pi * n * SPEED
    own = C @ np.linalg.solve(s * np.eye(4) - A, B) * np.sinc(0.25 * n)
    assert abs(slope_response(np.array([n]), STEP)[0]) == pytest.approx(abs(own), rel=4e-3)  # slopes are held for 25 mm


@pytest.mark.attack
@pytest.mark.parametrize(
    ("vehicle", "distance"),
    [pytest.param(CAR, 150.0, marks=pytest.mark.attack), (QUARTER, 1000.0), pytest.param(CAR, 1024.0, marks=pytest.mark.attack)],
    ids=["two tracks", "nearly all of it", "all of both tracks"],
)
def test_200_roads(vehicle, distance):
    """For 200 roads of class C the mean of every IRI lies within 3.5 standard errors of theory, and its spread is theory's.

    So it is over the whole length of a road, where its mean square is known, and what is left is a fifth of the spread.
    """
    roads = [Iso8608("C", seed, 20.0, track_width(vehicle)) for seed in range(200)]
    found = [roughness_of(road, vehicle, distance) for road in roads]
    assert [one.name for one in found[0]] == (["left", "right", "mean", "half_car"] if vehicle is CAR else ["left"])
    for i, one in enumerate(found[0]):
        values = np.array([each[i].iri for each in found])
        # 3.5: one of 2000 such means is further off. Spreads of 200 are 5 % off by chance.
        expected, spread = theory(one)
        assert abs(values.mean() - expected) < 3.5 * spread / math.sqrt(200), one.name
        assert values.std() == pytest.approx(spread, rel=0.15), one.name


def test_tracks_that_coincide():
    """Tracks a micrometre apart are one: each IRI of both has the mean and the spread of one track's, over a whole road too."""
    for distance in (200.0, 1024.0):
        one, *others = map(theory, roughness_of(Iso8608("C", track_width=1e-6), CAR, distance))
        assert len(others) == 3
        assert np.allclose(others, one, rtol=1e-8, atol=0)  # of coherency, and of a small difference


def test_start():
    """The cost of the car's start is that of lines of any phase, a cosine and a sine each; 0.95 m of white slopes."""
    lines, variances, x = np.array([10, 56, 2400]), np.array([2.0, 1.0, 0.5]), np.arange(8000) * STEP
    n = lines / COUNTED_LINES
    square = np.zeros(len(x) - 10)
    for each, variance in zip(n, variances, strict=True):
        for wave in (np.sin, np.cos):
            square += variance * suspension_slopes(wave(2 * np.pi * each * x) / (2 * np.pi * each), STEP) ** 2
    final = math.sqrt(np.abs(slope_response(n, STEP)) ** 2 @ variances)
    lost = np.cumsum(1 - np.sqrt(square[:4000:10]) / final) * 0.25
    assert np.allclose(missing(lines, variances)[:400], lost, rtol=0, atol=1e-9)  # m; rounding of 400 terms
    short, long = (theory(roughness_of(Iso8608("C", length=3e4), QUARTER, distance)[0])[0] for distance in (20.0, 1e4))
    assert (1 - short / long) * 20.0 == pytest.approx(0.95, abs=0.01)  # the long one lacks it, too, by 0.002


def test_theory_of_classes():
    """A class has twice the IRI of the one before it, class A 2.17 m/km: 2.2 is what the literature gives for 16e-6 m3."""
    expected = [theory(roughness_of(Iso8608(name), QUARTER, 1e3)[0])[0] for name in CLASSES]
    assert np.allclose(np.divide(expected[1:], expected[:-1]), 2, rtol=1e-12)
    assert expected[0] == pytest.approx(2.17, abs=5e-3)


def test_size_of_a_road():
    """`iso8608:iri=2.5` is the road of a class but for a factor, 2.5 m/km in the mean over long ways, and is described so."""
    road = choose_road("iso8608:iri=2.5").build(QUARTER, 20.0, 3, 400.0)
    assert isinstance(road, Iso8608)
    like, t = Iso8608("A", 3, 20.0), np.arange(50) * 0.013
    factor = math.sqrt(road.roughness / roughness("A"))
    assert np.allclose(road.displacement(t), factor * like.displacement(t), rtol=1e-12)
    long = choose_road("iso8608:iri=2.5").build(QUARTER, 20.0, 3, 1e4)
    assert roughness_of(long, QUARTER, 1e4)[0].expected == pytest.approx(2.5, rel=1e-4)  # it loses 0.9 m at its start
    assert roughness_of(long.scaled(2.0), QUARTER, 1e4)[0].expected == pytest.approx(5.0, rel=1e-4)
    description = json.loads(json.dumps(road.scaled(0.5).describe()))
    assert description["iri"] == 2.5
    assert "class" not in description
    assert described_road(description) == road.scaled(0.5)
    with pytest.raises(InputError, match="the log contains no value of class for this road"):
        described_road({key: value for key, value in description.items() if key != "iri"})


def test_measured_profiles():
    """A profile at even distances has the IRI of its own points, cut where the drive ends; at uneven ones that of lines."""
    heights = np.stack([heights_of(4, 0.25, 1200), heights_of(5, 0.25, 1200)], axis=-1)
    x = np.round(np.arange(1200) * 0.25 + 1e3, 3)
    own = {one.name: one.iri for one in roughness_of(Profile(x, heights), CAR, 1e9)}
    assert own["left"] == pytest.approx(listing(heights[:, 0], 0.25), rel=1e-9)
    assert own["right"] == pytest.approx(listing(heights[:, 1], 0.25), rel=1e-9)
    assert own["mean"] == pytest.approx((own["left"] + own["right"]) / 2, rel=1e-12)
    assert own["half_car"] == pytest.approx(listing(heights.mean(axis=1), 0.25), rel=1e-9)
    (part,) = roughness_of(Profile(x, heights), QUARTER, 100.0)
    assert part.iri == pytest.approx(listing(heights[:401, 0], 0.25), rel=1e-9)
    smooth = Iso8608("B", 1, 1.0)  # the same road, at uneven distances
    uneven = np.cumsum(np.random.default_rng(0).uniform(0.02, 0.06, 1500))
    points = np.repeat(smooth.displacement(uneven - uneven[0])[:, None], 2, axis=1)
    (found,) = roughness_of(Profile(uneven, points, join="smooth"), QUARTER, 50.0)
    assert found.iri == pytest.approx(roughness_of(smooth, QUARTER, 50.0)[0].iri, rel=2e-3)  # what is shorter than 0.1 m
    (lines,) = roughness_of(Profile(uneven, points), QUARTER, 50.0)
    even = np.interp(0.025 * np.arange(2001), uneven - uneven[0], points[:, 0])
    assert lines.iri == pytest.approx(listing(even, 0.025), rel=1e-9)
    assert lines.iri < 0.999 * found.iri


def test_no_iri():
    """A road shorter than its start of 11 m has none, nor one that was measured further apart than 0.3 m."""
    assert roughness_of(Bump(), QUARTER, 11.2) == ()
    assert len(roughness_of(Bump(), QUARTER, 11.4)) == 1
    coarse = Profile(0.31 * np.arange(100), np.zeros((100, 2)))
    assert roughness_of(coarse, QUARTER, 31.0) == ()


@pytest.mark.attack
def test_printed_and_logged(capsys, monkeypatch, tmp_path):
    """The table has every IRI beside its expectation, as JSON and log have it; a log with another one proves it no more."""
    arguments = [
        "--vehicle",
        "full_car",
        "--controller",
        "passive",
        "--road",
        "iso8608:iri=3",
        "--duration",
        "0.6",
        "--timestep",
        "4e-3",
    ]
    monkeypatch.setattr(sim.command.comparison, "run_named", once(sim.command.comparison.run_named))
    assert main([*arguments, "--no-logs", "-v"]) == 0
    out = capsys.readouterr().out
    assert main([*arguments, "--logs", str(tmp_path), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert list(result["iri"]) == ["iri_left", "iri_right", "iri_mean", "iri_half_car"]
    for name, one in result["iri"].items():
        road, expected, spread = (three_digits(one[key]) for key in ("road", "expected", "spread"))
        assert f"{name} {road} (expected {expected} +- {spread})" in prose(out)
    road = described_road(result["road"])
    assert result["iri"]["iri_left"]["road"] == roughness_of(road, CAR, 12.0)[0].iri
    (log,) = tmp_path.glob("*.mcap")
    assert inspect([str(log), "--json"]) == 0
    forged = tmp_path / "forged.mcap"
    said = f'"road": {result["iri"]["iri_mean"]["road"]}'.encode()
    changed = contents(log).with_attachment("result.json", lambda data: data.replace(said, b'"road": 1.5'))
    assert changed != contents(log)
    forged.write_bytes(written(changed))
    capsys.readouterr()
    assert inspect([str(forged), "--json"]) == 1
    assert "iri.iri_mean.road" in capsys.readouterr().out
