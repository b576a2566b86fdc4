"""Stability and norms of a whole box of constant errors: proofs by multipliers, and by an X that moves with the errors."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from models.vehicle.vehicle import read_vehicle
from synth.analysis.uncertainty_box import Box, ScaledGain
from synth.design.uncertainty.multipliers import MultiplierInterval, bound_in_band, stable_in_box, stable_with_errors
from synth.design.uncertainty.parameter_dependent_kyp import proof_in_band
from synth.design.uncertainty.parameter_dependent_lyapunov import bound_throughout, moving_x, stable_throughout
from synth.design.uncertainty.problem import box_of, scaled_gain
from synth.design.uncertainty.worst_case import WorstCaseNormFunction, local_maximum
from synth.plant.generalized import GeneralizedPlant
from synth.vehicle.designer import Designer
from tests.support.commands import attacks
from tests.support.shared import made

PRINTED_I = np.array([[10824.0, -2071.0]])
EDGE = 0.2102735  # errors of both readings at which printed controller I is lost: by bisection over the corner


def _car() -> GeneralizedPlant:
    designer = Designer(read_vehicle("quarter_car"))
    return designer.problem(("suspension_deflection", "sprung_velocity")).plant


def _random(seed: int, slack: float = 1.5, force: float = 0.2) -> ScaledGain:
    """A random loop in odd units, whose measurements contain noise and, for odd seeds, a share of the forces."""
    generator = np.random.default_rng(seed)
    n, m, q, r, d = 3 + seed % 2, 1 + seed % 2, 2, 2, 2
    shapes = ((n, n), (n, m), (n, r), (d, n), (q, n), (d, m), (d, r), (q, r), (m, q), (q, m))
    A, B, Bw, C, Cy, D, Dw, Dyw, K, through = (generator.standard_normal(shape) for shape in shapes)
    through *= force * (seed % 2)
    acting = np.linalg.solve(np.eye(m) - K @ through, K)
    A -= (np.linalg.eigvals(A + B @ acting @ Cy).real.max() + slack) * np.eye(n)
    units, pace = 10.0 ** generator.uniform(-3, 3, n), 10.0 ** generator.uniform(-2, 2)
    A, B, Bw = (pace * part / units[:, None] for part in (A * units, B, Bw))
    return scaled_gain(GeneralizedPlant(A, B, Bw, C * units, D, Dw).measured(Cy * units, Dyw, through), K)


def _loops(gain: ScaledGain, box: Box, count: int):
    """The loops at the corners of a box and at points in it."""
    inside = box.low + (box.high - box.low) * np.random.default_rng(7).random((count, len(box.low)))
    return gain.loops(np.concatenate([box.vertices, inside]))


def _gains(gain: ScaledGain, box: Box, omega: np.ndarray, count: int) -> float:
    """The largest gain at some frequencies, at the corners of a box and at points in it."""
    loops, largest = _loops(gain, box, count), 0.0
    for one in omega:
        through = np.linalg.solve(1j * one * np.eye(loops.A.shape[-1]) - loops.A, loops.Bw)
        largest = max(largest, float(np.linalg.norm(loops.C @ through + loops.Dw, 2, axis=(-2, -1)).max()))
    return largest


def test_proved_up_to_the_edge():
    """Printed controller I is proved to be stable up to a thousandth below the errors at which it is lost, and not beyond."""
    gain = scaled_gain(_car(), PRINTED_I)
    inside, beyond = (box_of(gain, share * EDGE, 0.0) for share in (0.999, 1.0001))
    proof = stable_in_box(gain, inside)
    assert proof is not None
    assert proof.holds(gain, inside)
    assert not proof.holds(gain, beyond)
    assert stable_in_box(gain, beyond) is None
    assert stable_throughout(gain, beyond) is None


@pytest.mark.parametrize(("left", "proved"), [(1e-3, True), (1e-16, False)])
def test_rounding_counts(left, proved):
    """A loop whose slowest pole is left of the axis by less than rounding may have taken is not proved to be stable."""
    plant = _car()
    poles = np.linalg.eigvals(plant.closed_loop(PRINTED_I @ plant.Cy).A)
    moved = replace(plant, A=plant.A - (poles.real.max() + left * np.abs(poles).max()) * np.eye(4))
    assert stable_with_errors(moved, PRINTED_I, np.zeros(2), np.zeros(1)) == proved


def test_random_boxes():
    """What is proved by an X that moves is stable at every sample of the box, and what is stable by a hundredth of its fastest
    rate at every sample is proved in nine of ten cases: in odd units of length and of time."""
    proved, stable = 0, 0
    for seed in range(24):
        generator = np.random.default_rng(seed)
        gain = _random(seed, generator.uniform(0.05, 0.5), 0.0)
        box = box_of(gain, generator.uniform(0, 0.5), generator.uniform(0, 0.2))
        poles = np.linalg.eigvals(_loops(gain, box, 300).A)
        parts, slowest = stable_throughout(gain, box), poles.real.max() / np.abs(poles).max()
        assert parts is None or slowest < 0
        if slowest < -0.01:
            stable += 1
            proved += parts is not None
    assert stable > 5  # enough to speak of
    assert proved >= 0.9 * stable


@pytest.mark.parametrize(("seed", "low", "high"), [(1, 0.5, 2.0), *attacks(((0, 0.5, 2.0), (2, 0.0, 1.0), (5, 1.0, np.inf)))])
def test_no_sample_exceeds_a_bound(seed, low, high):
    """In odd units no sample of the errors of a random plant exceeds what is proved in a band, close above the largest."""
    gain = _random(seed)
    box = box_of(gain, 0.1, 0.05)
    pace = float(np.abs(np.linalg.eigvals(gain.loops(box.middle).A)).max())
    low, high = low * pace, high * pace
    largest = _gains(gain, box, np.linspace(low, min(high, 30 * pace), 60), 100)
    proof = bound_in_band(gain, box, low, high, largest)
    assert proof is not None
    assert largest <= proof.gamma <= 1.03 * largest  # a hundredth or two, and between the samples


def _everywhere():
    """Printed controller I, its errors, what multipliers prove at all frequencies, and the largest norm found by ascent."""
    gain = scaled_gain(_car(), PRINTED_I)
    box, heights = box_of(gain, 0.1, 0.05), WorstCaseNormFunction(gain)
    local_maximum(heights, box)
    proof = bound_in_band(gain, box, 0.0, np.inf, heights.highest)
    assert proof is not None
    return gain, box, proof, heights.highest


def _in_band(low: float, high: float):
    """Printed controller I, its errors, what an X that moves proves in a band [Hz], and the largest gain found there."""
    gain = scaled_gain(_car(), PRINTED_I)
    box, (low, high) = box_of(gain, 0.1, 0.05), (2 * np.pi * low, 2 * np.pi * high)
    largest = _gains(gain, box, np.linspace(low, min(high, 2 * np.pi * 40), 60), 80)
    proof = proof_in_band(gain, box, low, high, largest)
    assert proof is not None
    return gain, box, proof, largest


def test_the_paper_s_car_at_all_frequencies():
    """The worst norm of printed controller I with errors of 10 and 5 %, 7.88926 by ascent, is proved to a hundredth twice."""
    gain, box, proof, largest = made(_everywhere)
    assert largest == pytest.approx(7.88926, rel=1e-5)
    assert largest <= proof.gamma <= 1.01 * largest
    assert largest <= bound_throughout(gain, box, largest) <= 1.01 * largest


@pytest.mark.parametrize(("low", "high", "loose"), [(4.0, 8.0, 0.01), *attacks([(0.0, 2.0, 0.25), (6.0, np.inf, 0.05)])])
def test_a_norm_in_a_band_with_errors(low, high, loose):
    """In a band with two ends or one, no sample of the errors exceeds what is proved, and that lies within a hundredth of it;
    in a band without end within a twentieth, and about the slow mode that twice the errors lose within a quarter."""
    _, _, proof, largest = made(_in_band, low, high)
    assert largest <= proof.gamma <= (1 + loose) * largest


@pytest.mark.parametrize("which", ["multipliers", "moving X", "moving X in a band"])
def test_a_damaged_proof_proves_nothing(which):
    """A lower bound, other matrices, too few corners, a gap between intervals, or a wider box is no proof."""
    proof: Any
    gain, box, proof, largest = made(_in_band, 4.0, 8.0) if which == "moving X in a band" else made(_everywhere)
    wider = box_of(gain, 0.22, 0.05)  # in it a loop is unstable
    if which == "multipliers":
        parts = proof.parts
        forged = [
            replace(proof, gamma=0.99 * largest),
            replace(proof, parts=tuple(part._replace(D=-part.D) for part in parts)),
            replace(proof, parts=tuple(part._replace(D=2 * part.D) for part in parts)),
            replace(proof, parts=tuple(part._replace(G=-part.G) for part in parts)),
            replace(proof, parts=(parts[0]._replace(low=1.0), *parts[1:])),
            replace(proof, parts=(*parts[:-1], parts[-1]._replace(high=1e9))),
            replace(proof, parts=(MultiplierInterval(0.0, np.inf, parts[0].D, parts[0].G),)),
        ]
    elif which == "moving X":
        proof = moving_x(gain, box)
        assert proof is not None
        turned, skew = proof.X.copy(), np.triu(np.ones((4, 4)), 1) - np.tril(np.ones((4, 4)), -1)
        turned[3] *= -1
        forged = [replace(proof, G=0 * proof.G), replace(proof, X=turned), replace(proof, X=proof.X[:4])]
        forged += [replace(proof, F=-proof.F)]
        backwards = replace(gain, plant=replace(gain.plant, A=-gain.plant.A, B=-gain.plant.B))  # in time: every loop is unstable
        assert not replace(proof, X=-proof.X, F=-proof.F).holds(backwards, box)  # though it satisfies the inequality
        forged += [replace(proof, X=proof.X + 1e-9 * np.abs(proof.X).max() * skew)]  # the inequality knows no difference
    else:
        tilted = replace(proof, P=proof.P + 1e-3 * np.abs(proof.P).max() * 1j * np.eye(4))
        forged = [replace(proof, gamma=0.98 * largest), tilted, replace(proof, Q=-proof.Q), replace(proof, W=0 * proof.W)]
        forged += [replace(proof, P=proof.P[:4], Q=proof.Q[:4])]
    assert proof.holds(gain, box)
    assert not any(one.holds(gain, box) for one in forged)
    assert not proof.holds(gain, wider)


@pytest.mark.parametrize("seed", [0, *attacks([1])])
def test_random_norms_with_errors(seed):
    """For random plants in odd units no sample of the errors exceeds what an X that moves proves, close above the largest."""
    gain = _random(2000 + seed, 0.5, 0.0)
    box, heights = box_of(gain, 0.1, 0.05), WorstCaseNormFunction(gain)
    local_maximum(heights, box)
    bound = bound_throughout(gain, box, heights.highest)
    assert heights.highest < bound or np.isinf(heights.highest)
    assert _gains(gain, box, np.abs(np.linalg.eigvals(gain.plant.A)), 100) <= bound
    if np.isinf(heights.highest):
        assert moving_x(gain, box, 1e3) is None


def test_eight_errors_of_a_half_car():
    """A half-car's gain per corner, with six readings off by 10 % and both forces by 5 %, is proved to a hundredth in a band.

    Two other routes are from below: 256 corners and 2000 points between them at 60 frequencies, and ascent from the corners.
    """
    signals = ("suspension_deflection", "sprung_velocity", "unsprung_velocity")
    designer = Designer(read_vehicle("half_car"))
    K = np.kron([[10000.0, -2500.0, 500.0]], np.eye(2))
    names = tuple(f"{name}_{corner}" for name in signals for corner in ("front", "rear"))
    gain = scaled_gain(designer.problem(names).plant, K)
    box, low, high = box_of(gain, 0.1, 0.05), np.pi, 6 * np.pi
    largest = _gains(gain, box, np.linspace(low, high, 60), 2000)
    proof = bound_in_band(gain, box, low, high, largest)
    assert proof is not None
    assert largest <= proof.gamma <= 1.01 * largest
    assert stable_in_box(gain, box) is not None
