"""Bounds on norms of a box of constant errors, and its stability, by multipliers."""

from dataclasses import replace

import numpy as np
import pytest

from models.vehicle.vehicle import parse_vehicle, read_vehicle
from synth.analysis.uncertainty_box import Box, ScaledGain
from synth.design.uncertainty.multipliers import (
    MultiplierInterval,
    MultiplierProof,
    bound_in_band,
    cut_loop,
    stable_in_box,
)
from synth.design.uncertainty.problem import box_of, scaled_gain
from synth.design.uncertainty.worst_case import WorstCaseNormFunction, local_maximum
from synth.plant.generalized import GeneralizedPlant
from synth.vehicle.designer import Designer
from tests.commands import attacks
from tests.shared import made

PRINTED_I = np.array([[10824.0, -2071.0]])
EDGE = 0.2102735  # errors of both readings at which printed controller I is lost: by bisection over the corner


def _car() -> ScaledGain:
    designer = Designer(read_vehicle("quarter_car"))
    return scaled_gain(designer.plant, designer.problem(("suspension_deflection", "sprung_velocity")).Cy, PRINTED_I)


def _random(seed: int) -> ScaledGain:
    """A random loop in odd units, whose measurements contain noise and, for odd seeds, forces."""
    generator = np.random.default_rng(seed)
    n, m, q, r, d = 3 + seed % 2, 1 + seed % 2, 2, 2, 2
    shapes = ((n, n), (n, m), (n, r), (d, n), (q, n), (d, m), (d, r), (q, r), (m, q), (q, m))
    A, B, Bw, C, Cy, D, Dw, Dyw, K, through = (generator.standard_normal(shape) for shape in shapes)
    through *= 0.2 * (seed % 2)
    acting = np.linalg.solve(np.eye(m) - K @ through, K)
    A -= (np.linalg.eigvals(A + B @ acting @ Cy).real.max() + 1.5) * np.eye(n)
    units, pace = 10.0 ** generator.uniform(-3, 3, n), 10.0 ** generator.uniform(-2, 2)
    A, B, Bw = (pace * part / units[:, None] for part in (A * units, B, Bw))
    return scaled_gain(GeneralizedPlant(A, B, Bw, C * units, D, Dw), Cy * units, K, Dyw, through)


def _gains(gain: ScaledGain, box: Box, omega: np.ndarray, count: int) -> float:
    """The largest gain at some frequencies, at the corners of a box and at points in it."""
    inside = box.low + (box.high - box.low) * np.random.default_rng(7).random((count, len(box.low)))
    loops, largest = gain.loops(np.concatenate([box.vertices, inside])), 0.0
    for one in omega:
        through = np.linalg.solve(1j * one * np.eye(loops.A.shape[-1]) - loops.A, loops.Bw)
        largest = max(largest, float(np.linalg.norm(loops.C @ through + loops.Dw, 2, axis=(-2, -1)).max()))
    return largest


@pytest.mark.parametrize("seed", [0, 1])
def test_the_cut_loop_is_the_loop(seed):
    """With its errors put back, the cut loop has the frequency response of the loop with these errors."""
    gain = _random(seed)
    box, s = box_of(gain, 0.3, 0.2), 1j * np.abs(np.linalg.eigvals(gain.plant.A)).max()
    cut = cut_loop(gain, box)
    T, k = cut.C @ np.linalg.solve(s * np.eye(len(cut.A)) - cut.A, cut.B) + cut.D, cut.errors
    for delta in np.random.default_rng(seed).uniform(-1, 1, (4, k)):
        factors = box.middle
        factors[box.uncertain] += delta * ((box.high - box.low) / 2)[box.uncertain]
        A, Bw, C, Dw = gain.loops(factors)
        expected = C @ np.linalg.solve(s * np.eye(len(A)) - A, Bw) + Dw
        back = T[k:, :k] @ np.linalg.solve(np.eye(k) - delta[:, None] * T[:k, :k], delta[:, None] * T[:k, k:])
        np.testing.assert_allclose(T[k:, k:] + back, expected, rtol=0, atol=1e-11 * np.abs(expected).max())  # of some inverses


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


def _everywhere() -> tuple[ScaledGain, Box, MultiplierProof, float]:
    """Printed controller I, its errors, what is proved of all frequencies, and the largest norm found by ascent."""
    gain = _car()
    box, heights = box_of(gain, 0.1, 0.05), WorstCaseNormFunction(gain)
    local_maximum(heights, box)
    proof = bound_in_band(gain, box, 0.0, np.inf, heights.highest)
    assert proof is not None
    return gain, box, proof, heights.highest


def test_the_paper_s_car_at_all_frequencies():
    """The worst norm of printed controller I with errors of 10 and 5 %, 7.88926 by ascent, is proved to a hundredth."""
    _, _, proof, largest = made(_everywhere)
    assert largest == pytest.approx(7.88926, rel=1e-5)
    assert largest <= proof.gamma <= 1.01 * largest


def test_a_damaged_proof_proves_nothing():
    """A lower bound, other multipliers, a gap between intervals, or a wider box is no proof."""
    gain, box, proof, largest = made(_everywhere)
    assert proof.holds(gain, box)
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
    assert not any(one.holds(gain, box) for one in forged)
    assert not proof.holds(gain, box_of(gain, 0.15, 0.05))


def test_stability_up_to_the_edge():
    """Printed controller I is proved to be stable with errors up to a thousandth below those at which it is lost."""
    gain = _car()
    below = stable_in_box(gain, box_of(gain, 0.999 * EDGE, 0.0))
    assert below is not None
    assert below.holds(gain, box_of(gain, 0.999 * EDGE, 0.0))
    assert not below.holds(gain, box_of(gain, 1.0001 * EDGE, 0.0))
    assert stable_in_box(gain, box_of(gain, 1.0001 * EDGE, 0.0)) is None


def test_eight_errors_of_a_half_car():
    """A half-car's gain per corner, with six readings off by 10 % and both forces by 5 %, is proved to a hundredth in a band.

    Two other routes are from below: 256 corners and 2000 points between them at 60 frequencies, and ascent from the corners.
    """
    corners = ("front", "rear")
    names = [
        f"{name}_{corner}" for name in ("suspension_deflection", "sprung_velocity", "unsprung_velocity") for corner in corners
    ]
    designer = Designer(parse_vehicle(read_vehicle("half_car").text))
    K = np.kron([[10000.0, -2500.0, 500.0]], np.eye(2))
    gain = scaled_gain(designer.plant, designer.problem(tuple(names)).Cy, K)
    box, low, high = box_of(gain, 0.1, 0.05), np.pi, 6 * np.pi
    largest = _gains(gain, box, np.linspace(low, high, 60), 2000)
    proof = bound_in_band(gain, box, low, high, largest)
    assert proof is not None
    assert largest <= proof.gamma <= 1.01 * largest
    assert stable_in_box(gain, box) is not None
