"""The L2 gain of loops that a computer closes: known numbers, two routes, its limits, and gains in MuJoCo."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import linalg, signal

import sim.studies.frequency.sweep
from models.common.errors import InputError
from models.laws.filter import Filter
from models.roads.road import Bump
from models.vehicle.limits_and_implementation import Implementation, Limits
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.studies.frequency.identification import l2_gain
from sim.studies.frequency.sweep import failures
from sim.sweep import main
from synth.analysis.sampled_loop import HoldInterval, SampledLoop
from synth.analysis.sampled_norm import reached_gain, sampled_norm
from synth.analysis.stability import sampled_growth
from synth.controller.implementation_norm import norm_as_implemented, sampled_loop
from synth.controller.loop_of import loop_of
from synth.plant.generalized import GeneralizedPlant
from synth.vehicle.designer import design
from tests.support.analysed import simulate
from tests.support.commands import attacks

PROVED = 2e-8  # relative: the levels on either side of the norm are 1.1e-8 apart


def of_the_paper(period: float, *, late: int = 0) -> SampledLoop:
    """The loop of the paper's controller I, as it is designed here."""
    vehicle = read_vehicle("quarter_car")
    return sampled_loop(replace(vehicle, implementation=Implementation(period, late)), design(vehicle, "I"))


def any_loop(rng: np.random.Generator) -> SampledLoop:
    """A stable loop of some size, with or without a law with states, Dw, a delay and a fraction of one."""
    n, m, r, d, k = (int(rng.integers(low, high)) for low, high in ((1, 6), (1, 3), (1, 4), (1, 4), (0, 3)))
    A = rng.standard_normal((n, n)) * 10 ** rng.uniform(-1, 2)
    A -= (np.linalg.eigvals(A).real.max() + 10 ** rng.uniform(-2, 1)) * np.eye(n)
    Dw = rng.standard_normal((d, r)) * rng.choice([0.0, 0.1])
    B, Bw, C, D = (rng.standard_normal(shape) for shape in ((n, m), (n, r), (d, n), (d, m)))
    plant = GeneralizedPlant(A, B, Bw, C, D, Dw)
    period, late, fraction = 10 ** rng.uniform(-3, 0), int(rng.integers(0, 4)), rng.choice([0.0, rng.uniform(0.05, 0.95)])
    pieces = (
        (HoldInterval(fraction * period, late + 1), HoldInterval((1 - fraction) * period, late))
        if fraction
        else (HoldInterval(period, late),)
    )
    memory = np.hstack(
        [rng.standard_normal((k, n)), 0.5 * np.linalg.qr(rng.standard_normal((k, k)))[0] if k else np.zeros((0, 0))]
    )
    asked, from_force = rng.standard_normal((m, n + k)), 0.1 * rng.standard_normal((k, m))
    for _ in range(60):
        loop = SampledLoop(plant, pieces, asked, memory, from_force)
        if sampled_norm(loop).stable:
            return loop
        asked, from_force = asked / 2, from_force / 2
    raise AssertionError("without a force it is stable")


@pytest.mark.parametrize(("period", "expected"), [(1e-3, 7.8440), (1e-2, 7.8651), (5e-2, 8.3668)])
def test_controller_i(period, expected):
    """Controller I at 1, 10 and 50 ms has the norms that were found before."""
    assert sampled_norm(of_the_paper(period)).value == pytest.approx(expected, rel=1e-5)  # of five digits


@pytest.mark.parametrize(("period", "expected"), [(0.75, "3.7912"), (0.2, "1.0047")])
def test_example_of_a_manual(period, expected):
    """The example of MATLAB's sdhinfnorm: [1; 1] p [1 1], p = 30 / (s (s + 30)), under -k, k = 4 / (s + 4) held, as printed."""
    A, B, C = np.array([[0.0, 1.0], [0.0, -30.0]]), np.array([[0.0], [30.0]]), np.array([[1.0, 0.0]])
    law: Any = signal.cont2discrete((-4 * np.eye(1), 4 * np.eye(1), np.eye(1), np.zeros((1, 1))), period)
    Ak, Bk, Ck, Dk, _ = law
    plant = GeneralizedPlant(A, B, B, C, np.zeros((1, 1)), np.zeros((1, 1)))
    loop = SampledLoop(plant, (HoldInterval(period, 0),), -np.hstack([Dk @ C, Ck]), np.hstack([Bk @ C, Ak]), np.zeros((1, 1)))
    assert f"{sampled_norm(loop).value:.5g}" == expected


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_order_of_the_second_route(degree):
    """The gain of polynomials over parts of the period falls short by the power 2 (degree + 1) of the parts' length."""
    loop = of_the_paper(5e-2)
    norm = sampled_norm(loop)
    short = [1 - reached_gain(loop, norm.angle, parts, degree) / norm.value for parts in (4, 8)]
    assert min(short) > 0
    assert math.log2(short[0] / short[1]) == pytest.approx(2 * (degree + 1), rel=0.03)  # of the next order, at h |A| = 0.8


@pytest.mark.parametrize(
    ("seed", "noisy"), [(0, False), (1, True), (2, True), (3, False), *attacks((i, i % 2 > 0) for i in range(100, 130))]
)
def test_two_routes_meet(seed, noisy):
    """For any loop, with noise or without, an actual disturbance reaches the norm, and no other angle gains more."""
    rng = np.random.default_rng(seed)
    loop = quiet = any_loop(rng)
    if noisy:
        loop = replace(loop, noise=rng.standard_normal((len(loop.K) + len(loop.A_register), 2)))
    norm = sampled_norm(loop)
    assert norm.value >= sampled_norm(quiet).value * (1 - PROVED)
    assert norm.lower < norm.value < norm.upper < norm.value * (1 + PROVED)
    if norm.inside:
        return
    assert norm.gap < 1e-7 or loop.period * np.linalg.norm(loop.plant.A, 2) > 50  # as many time constants, by polynomials
    if noisy:
        return
    others = [reached_gain(loop, angle, 4) for angle in (0.0, math.pi, *rng.uniform(0, math.pi, 20))]
    assert max(others) < norm.upper


def in_other_units(loop: SampledLoop, rng: np.random.Generator) -> SampledLoop:
    """The same loop, its time, states, forces and memory in units of many sizes; its gain is the same number."""
    plant, time = loop.plant, 10 ** rng.uniform(-6, 6)
    of_x, of_s, of_u = (10 ** rng.uniform(-4, 4, size) for size in (len(plant.A), len(loop.A_register), len(loop.K)))
    p, root = np.concatenate([of_x, of_s]), math.sqrt(time)
    changed = GeneralizedPlant(
        plant.A * of_x[:, None] / of_x / time,
        plant.B * of_x[:, None] / of_u / time,
        plant.Bw * of_x[:, None] / root,
        plant.C / of_x / root,
        plant.D / of_u / root,
        plant.Dw,
    )
    pieces = tuple(HoldInterval(piece.duration * time, piece.delay_samples) for piece in loop.pieces)
    memory, from_force = loop.A_register * of_s[:, None] / p, loop.B_register * of_s[:, None] / of_u
    return SampledLoop(changed, pieces, loop.K * of_u[:, None] / p, memory, from_force)


@pytest.mark.parametrize("seed", [*range(3), *attacks(range(100, 110))])
def test_units(seed):
    """In whatever units of time, states and forces a loop is, its norm is one number, and nothing is reached above it."""
    rng = np.random.default_rng(seed)
    loop = any_loop(rng)
    own, norm = sampled_norm(loop), sampled_norm(in_other_units(loop, rng))
    assert norm.value == pytest.approx(own.value, rel=PROVED)
    assert norm.reached <= norm.upper
    assert norm.reached <= norm.value * (1 + 1e-9)  # rounding; 2e-11 was seen
    assert norm.reached == pytest.approx(own.reached, rel=1e-7)  # parts may be doubled once more


def test_a_car_whose_energies_lie_far_apart():
    """The share that a road reaches of a full car's norm is no more than the norm, in however many parts of the period."""
    vehicle = replace(read_vehicle("full_car"), implementation=Implementation(0.03, 1))
    loop = sampled_loop(vehicle, design(vehicle, "I"))
    norm = sampled_norm(loop)
    for parts in (8, 12):
        assert reached_gain(loop, norm.angle, parts) == pytest.approx(norm.value, rel=1e-11)  # the norm is found to 1e-11


@pytest.mark.attack
def test_nothing_exceeds_it():
    """No disturbance that is simulated, random over parts of many periods, gains more than the norm; the worst comes near."""
    rng, loop = np.random.default_rng(5), of_the_paper(5e-2)
    plant, norm, parts = loop.plant, sampled_norm(loop), 10
    h = loop.period / parts
    step = linalg.expm(h * np.block([[plant.A, plant.B, plant.Bw], [np.zeros((2, 6))]]))
    best = 0.0
    for shape in (*rng.standard_normal((20, 3000)), np.cos(norm.angle * (np.arange(3000) + 0.5) / parts)):
        x, u, energy = np.zeros(4), np.zeros(1), 0.0
        for i, w in enumerate(shape):
            if i % parts == 0:
                u = loop.K @ x
            energy += h * float(np.sum((plant.C @ x + plant.D @ u) ** 2))
            x = step[:4] @ np.concatenate([x, u, [w]])
        best = max(best, math.sqrt(energy / (h * float(shape @ shape))))
    # Energy by rectangles of 5 ms: a hundredth. The worst road has a second tone beside this one.
    assert 0.6 * norm.value < best < 1.01 * norm.value


def test_tends_to_the_continuous_norm():
    """At 100 to 25 kHz the norm leaves the continuous one with the first power of the period: digits are kept there."""
    ideal = design(read_vehicle("quarter_car"), "II").certificate.norm.value
    vehicle, controller = read_vehicle("quarter_car"), design(read_vehicle("quarter_car"), "II")
    off = [
        norm_as_implemented(replace(vehicle, implementation=Implementation(period)), controller).value / ideal - 1
        for period in (1e-5, 2e-5, 4e-5)
    ]
    assert [off[1] / off[0], off[2] / off[1]] == pytest.approx([2, 2], rel=5e-3)  # of the second power, at 63 rad/s and 40 us


@pytest.mark.parametrize("name", ["quarter_car", "half_car", "full_car"])
def test_without_a_force_it_is_the_continuous_norm(name):
    """A computer that asks for nothing changes nothing: the norm of `passive` is the continuous one, however it is built."""
    vehicle = read_vehicle(name)
    built = replace(vehicle, implementation=Implementation(7e-3, 2), limits=Limits(actuator_bandwidth=200.0))
    passive = design(vehicle, "passive")
    norm = norm_as_implemented(built, passive)
    assert norm.value == pytest.approx(passive.certificate.norm.value, rel=PROVED)


def test_a_late_force_held_in_pieces():
    """A period cut in pieces under one force is the period; a fraction of a sample lies between the whole ones."""
    loop = of_the_paper(2e-2, late=1)
    whole = sampled_norm(loop).value
    cut = replace(loop, pieces=(HoldInterval(0.007, 1), HoldInterval(0.013, 1)))
    assert sampled_norm(cut).value == pytest.approx(whole, rel=PROVED)
    by_fraction = [
        sampled_norm(replace(loop, pieces=(HoldInterval(2e-2 * share, 2), HoldInterval(2e-2 * (1 - share), 1)))).value
        for share in (1e-9, 1 - 1e-9)
    ]
    assert by_fraction == pytest.approx([whole, sampled_norm(of_the_paper(2e-2, late=2)).value], rel=1e-7)


def test_where_it_decides():
    """If z is w itself, and a state that no force moves is no part of it, the norm is what happens within a period."""
    one = np.eye(1)
    plant = GeneralizedPlant(-one, one, one, 0 * one, 0 * one, 3 * one)
    norm = sampled_norm(SampledLoop.of_gain(plant, -one, one, 0.1))
    assert norm.inside
    assert [norm.value, norm.reached] == pytest.approx([3.0, 3.0], rel=PROVED)


def test_the_loop_is_the_one_that_runs():
    """Lag, states of a law, a measured acceleration and a delay: from sample to sample it grows as the loop that `sim` runs."""
    vehicle = read_vehicle("quarter_car_accelerometer")
    for lag in (None, 300.0):
        for late in (0, 2, 1.4):
            built = replace(vehicle, implementation=Implementation(5e-3, late), limits=Limits(actuator_bandwidth=lag))
            controller = design(vehicle, "accelerometer")
            loop = sampled_loop(built, controller)
            change, _ = loop.closed(loop.increment)
            growth = sampled_growth(np.eye(len(change)) + change)
            expected = sampled_growth(loop_of(built, controller, 1e-3).closed_loop.A)
            assert growth == pytest.approx(expected, rel=1e-9)  # rounding of eigenvalues
            assert sampled_norm(loop).gap < 1e-9


# --- in MuJoCo -----------------------------------------------------------------------------------------------------------


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


@pytest.mark.attack
@pytest.mark.parametrize("delay", [1.0, 1.5])
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
    assert "the prediction is" in failures(off)[0]


def test_no_multiple_of_the_timestep(tmp_path):
    """Physics cannot hold a force for a part of a step; one line says so."""
    car = tmp_path / "car.toml"
    car.write_text(read_vehicle("quarter_car").text + "\n[implementation]\nsample_period = 0.0105\n")
    with pytest.raises(InputError, match=r"sample_period = 0.0105 s is not a multiple of the timestep 0.001 s"):
        main(["--vehicle", str(car), "--controller", "I"])
