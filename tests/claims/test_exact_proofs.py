"""Norms, stability and proofs of bounds against rational arithmetic: next to where they would fail, and if K C_y cancels."""

import contextlib
import dataclasses
from fractions import Fraction

import numpy as np
import pytest

from synth.analysis.bounding import bounding_x, certify_tightly
from synth.analysis.certificate import Certificate, LmiProof, bounded_real_exactly, certify, eta_of, prove_bound
from synth.analysis.norm import hinf_norm
from synth.analysis.rigorous import definiteness
from synth.design.two_step import two_step_design
from synth.plant import iterative_refinement
from synth.plant.generalized import Feedback, GeneralizedPlant
from tests.claims.test_no_controller_beats_a_bound import of_lists
from tests.support import exactly
from tests.support.commands import attacks


def differences(seed: int, n: int, gain: float, apart: float) -> tuple[GeneralizedPlant, Feedback]:
    """A stable loop of about unit size: rows of C_y that lie `apart` from one another, and a gain that weighs the differences."""
    rng = np.random.default_rng(seed)
    m, first = int(rng.integers(1, 3)), rng.standard_normal(n)
    Cy = first + apart * rng.standard_normal((3, n))
    K = gain * rng.standard_normal((m, 3))
    K[:, -1] = -K[:, 0] - K[:, 1]
    B = rng.standard_normal((n, m))
    closed = rng.standard_normal((n, n))
    closed -= (np.linalg.eigvals(closed).real.max() + 0.3) * np.eye(n)
    C, D = rng.standard_normal((2, n)), rng.standard_normal((2, m)) / gain / apart
    plant = GeneralizedPlant(closed - B @ K @ Cy, B, rng.standard_normal((n, 1)), C, D, np.zeros((2, 1)))
    return plant, Feedback(K, Cy)


def refuse_what_is_not_true(certificate: Certificate, plant: GeneralizedPlant, u: Feedback) -> float:
    """Stability, the norm at its peak and the bound against rational arithmetic; returns how far the floats' own gain is off."""
    G = exactly.times(exactly.exact(u.K), exactly.exact(u.Cy))
    loop = exactly.plus(exactly.exact(plant.A), exactly.times(exactly.exact(plant.B), G))
    assert certificate.stable == exactly.stable(loop)
    norm, Bw = certificate.norm, exactly.exact(plant.Bw)
    at_peak = exactly.gain_squared(
        loop, Bw, exactly.plus(exactly.exact(plant.C), exactly.times(exactly.exact(plant.D), G)), norm.peak_frequency
    )
    # The norm is the gain at its peak but for the rounding that is stated, and a square root of floats.
    assert abs(float(Fraction(norm.value) ** 2 / at_peak) ** 0.5 - 1) <= norm.rounding + 4 * np.finfo(float).eps
    if certificate.proof is not None:
        eta = exactly.largest_eta(plant, u, certificate.proof.X)
        assert eta is not None
        assert Fraction(certificate.proof.eta) < eta
    of_floats = plant.closed_loop(u.K @ u.Cy)
    T = of_floats.C @ np.linalg.solve(1j * norm.peak_frequency * np.eye(len(of_floats.A)) - of_floats.A, of_floats.Bw)
    return abs(float(np.linalg.norm(T)) / norm.value - 1)


def test_bound_is_rounded_upwards():
    """The bound that eta proves is never more than the bound that is claimed, to the last bit, both ways; nor is what it
    prints as one."""
    rng, any_ = np.random.default_rng(0), definiteness(np.eye(1))
    for bound in 10.0 ** rng.uniform(-60, 60, 300):
        eta = eta_of(bound)
        assert Fraction(bound) ** 2 * Fraction(eta) >= 1
        assert LmiProof(np.eye(1), eta, any_, any_).bound <= bound
        assert eta == pytest.approx(bound**-2, rel=1e-15)  # a few units in the last place


def of_all_sizes(n: int, m: int, r: int, d: int) -> tuple[GeneralizedPlant, np.ndarray]:
    """A plant and a gain whose entries differ by sixty orders of magnitude."""
    rng = np.random.default_rng([n, m, r, d])
    shapes = ((n, n), (n, m), (n, r), (d, n), (d, m), (d, r), (m, n))
    *parts, G = (rng.standard_normal(shape) * 10.0 ** rng.uniform(-30, 30, shape) for shape in shapes)
    A, B, Bw, C, D, Dw = parts
    return GeneralizedPlant(A, B, Bw, C, D, Dw), G


@pytest.mark.parametrize("dt", [None, 0.1])
@pytest.mark.parametrize(
    "case",
    [(1, 1, 1, 1), (4, 2, 1, 3), (3, 0, 2, 1), (2, 1, 1, 2), pytest.param(differences(0, 3, 1e11, 1e-9), id="differences")],
)
def test_matrix_of_the_proof(case, dt):
    """The judged matrix is that of (20) in rational arithmetic, rounded once, for any sizes and if K C_y cancels."""
    plant, G = of_all_sizes(*case) if isinstance(case[0], int) else case
    plant, X = dataclasses.replace(plant, dt=dt), np.random.default_rng(1).standard_normal((len(plant.A),) * 2)
    X, eta = X + X.T, 0.3
    still, turned = exactly.bounded_real(plant, G, X), exactly.disturbed(plant)
    expected = [[float(a + b * Fraction(eta)) for a, b in zip(*rows, strict=True)] for rows in zip(still, turned, strict=True)]
    assert bounded_real_exactly(plant, G, X, eta).tolist() == expected
    if isinstance(G, Feedback):
        assert np.any(bounded_real_exactly(plant, G.K @ G.Cy, X, eta) != expected)


def near_singular(rng, k: int, smallest: float) -> np.ndarray:
    """A symmetric matrix with rows of all sizes that is singular but for `smallest` and rounding."""
    V = np.linalg.qr(rng.standard_normal((k, k)))[0]
    values = 10.0 ** rng.uniform(-6, 0, k)
    values[0] = smallest
    M = (V * values) @ V.T
    scale = 10.0 ** rng.uniform(-20, 20, k)
    M = (M + M.T) / 2 * np.outer(scale, scale)
    return (M + M.T) / 2


def hold_to_the_truth(rng, count: int) -> int:
    """Holds `definiteness` against pivots in rational arithmetic, next to singularity. Returns how many were proved."""
    proved = 0
    for i in range(count):
        M = near_singular(rng, int(rng.integers(1, 9)), rng.choice([-1, 1]) * 10.0 ** rng.uniform(-18, -8))
        found = definiteness(M)
        true = exactly.positive_definite(exactly.exact(M))
        assert true or not found.proved, i
        assert found.proved or not true or found.smallest < 3 * found.rounding, i  # what lies well beyond rounding is proved
        proved += found.proved
    return proved


@pytest.mark.parametrize("count", [100, pytest.param(2000, marks=pytest.mark.attack)])
def test_definiteness(count):
    """A proof is true next to singularity, in rows of all sizes; and what is well beyond rounding is proved."""
    assert 0.2 < hold_to_the_truth(np.random.default_rng(2), count) / count < 0.8  # neither all nor none: the question was hard
    assert not definiteness(np.array([[1.0, np.nan], [np.nan, 1.0]])).proved
    assert not definiteness(np.array([[1.0, 0.0], [0.0, np.inf]])).proved
    assert not definiteness(np.array([[0.0]])).proved
    assert definiteness(np.array([[1e-150]])).proved
    assert definiteness(np.zeros((0, 0))).proved


def honest_pair(rng) -> tuple[GeneralizedPlant, np.ndarray, np.ndarray]:
    """A stable loop in units of all sizes, its gain, and a symmetric X > 0 that proves some bound of it."""
    n = int(rng.integers(2, 7))
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + 10.0 ** rng.uniform(-3, 0)) * np.eye(n)
    B, C, D, G = (rng.standard_normal(shape) for shape in ((n, 1), (2, n), (2, 1), (1, n)))
    plant = GeneralizedPlant(A - B @ G, B, rng.standard_normal((n, 1)), C - D @ G, D, np.zeros((2, 1)))
    units = 10.0 ** rng.uniform(-8, 8, n)
    plant, G = plant.in_coordinates(np.diag(units)), G * units
    loop = plant.closed_loop(G)
    X = bounding_x(loop, 1.1 * hinf_norm(loop).value, 0.01, 1e-6)
    return plant, G, (X + X.T) / 2


def beside(rng, edge: Fraction) -> float:
    """A float on either side of a number, a few of its last digits away or a few thousand."""
    return float(edge) * (1 + rng.choice([-1, 1]) * 2.0 ** rng.choice([rng.uniform(-53, -49), rng.uniform(-49, -30)]))


def attack_at_the_edge(rng, count: int) -> tuple[int, int]:
    """Holds proofs to the truth where rounding decides: eta next to the one that makes (20) singular, X next to singular.

    Returns:
        How many were proved, and how many a plain Cholesky decomposition would have believed that are false.
    """
    proved = fooled = 0
    for i in range(count):
        plant, G, X = honest_pair(rng)
        last = len(X) - 1
        if i % 2 and exactly.positive_definite(exactly.exact(X)):
            # One entry of the diagonal decides whether X is singular.
            unit = exactly.exact(np.eye(len(X))[:, last:])
            X[last, last] = beside(rng, Fraction(float(X[last, last])) - 1 / exactly.solved(exactly.exact(X), unit)[last][0])
            matrix, found = X, definiteness(X)
            true = exactly.positive_definite(exactly.exact(X))
        else:
            edge = exactly.largest_eta(plant, G, X)
            if edge is None or not 1e-150 < edge < 1e150:
                continue
            eta = beside(rng, edge)
            matrix, found = -bounded_real_exactly(plant, G, X, eta), prove_bound(plant, G, X, eta).negative
            true = Fraction(eta) < edge
        assert true or not found.proved, i
        proved += found.proved
        if not true:
            with contextlib.suppress(np.linalg.LinAlgError):
                np.linalg.cholesky(matrix)
                fooled += 1
    return proved, fooled


@pytest.mark.parametrize(
    ("seed", "count", "more", "some"), [(6, 100, 10, 0), pytest.param(7, 600, 80, 6, marks=pytest.mark.attack)]
)
def test_no_proof_at_the_edge_is_rounding(seed, count, more, some):
    """If the last digits of eta or of X decide, what is proved is true; without the allowance some of it would not be."""
    proved, fooled = attack_at_the_edge(np.random.default_rng(seed), count)
    assert proved > more
    assert fooled > some


@pytest.mark.parametrize("seed", range(8))
def test_a_gain_that_weighs_differences(seed):
    """A gain of 1e11 on rows 1e-9 apart: poles, norm and bound are those of u = K y, not of the floats nearest to K C_y."""
    plant, u = differences(seed, 2 + seed % 3, 1e11, 1e-9)
    certificate = certify_tightly(plant, u)
    assert certificate.failures == ()
    assert certificate.bound is not None
    off = refuse_what_is_not_true(certificate, plant, u)
    assert off > 1e-9  # measured 2e-7 to 2e-4: what the nearest floats would claim, so that this test can fail
    assert certificate.norm.rounding < 1e-9


@pytest.mark.attack
def test_gains_of_all_sizes():
    """The same for a hundred and fifty gains, from rows far apart to rows that differ in their last three digits."""
    for seed in range(150):
        rng = np.random.default_rng(seed)
        apart = 10.0 ** rng.uniform(-13, 0)
        plant, u = differences(seed, int(rng.integers(1, 6)), 10.0 ** rng.uniform(0, 3) / apart, apart)
        certificate = certify_tightly(plant, u) if seed % 3 == 0 else certify(plant, u)
        if certificate.stable and not certificate.failures:
            refuse_what_is_not_true(certificate, plant, u)


def test_a_design_is_certified_as_its_gain_acts():
    """The two steps from rows 1e-6 apart: the certificate is of K and C_y as they stand."""
    Cy = np.array([[1.0, 0.3, 0.0], [1.0, 0.3, 1e-6]])
    plant = of_lists(
        [[0, 1, 0], [-4, -0.1, 1], [0, 0, -3]], [[0], [1], [2]], [[0], [1], [1]], [[1, 0, 0], [0, 0, 0]], [[0], [0.1]]
    )
    design = two_step_design(plant, Cy)
    assert design.certificate.failures == ()
    refuse_what_is_not_true(design.certificate, plant, Feedback(design.gain, Cy))


def stiff(seed: int) -> tuple[GeneralizedPlant, np.ndarray]:
    """A plant with a resonance, and a stable gain from 1e3 to 1e14 that hardly touches it: slow poles beside fast ones."""
    rng = np.random.default_rng(seed)
    damping = 10.0 ** rng.uniform(-3, 0)
    size = 10.0 ** rng.uniform(3, 14 + np.log10(damping))  # more, and it would be marginal to rounding
    A = np.array([[0.0, 1.0, 0.0], [-4.0, -4 * damping, 0.0], [0.0, 0.0, -1.0]])
    T = rng.standard_normal((3, 3)) + 2 * np.eye(3)
    mixed = np.linalg.inv(T) @ A @ T
    B = np.linalg.inv(T) @ np.array([[0.0], [0.3], [1.0]])
    G = -size * np.array([[0.0, 0.0, 1.0]]) @ T
    one = np.ones((1, 1))
    return GeneralizedPlant(mixed, B, rng.standard_normal((3, 1)), rng.standard_normal((1, 3)), one, 0 * one), G


@pytest.mark.parametrize("seed", [*range(8), *attacks(range(8, 16))])
def test_norms_of_huge_gains(seed):
    """Exact rational arithmetic on the plant and a huge gain gives the norm at its peak, and nowhere near more."""
    plant, G = stiff(seed)
    certificate = certify(plant, G)
    norm, peak = certificate.norm, certificate.norm.peak_frequency
    assert norm.rounding < 1e-8
    refuse_what_is_not_true(certificate, plant, Feedback(G, np.eye(3)))
    A, Bw, C = (exactly.exact(part) for part in (plant.A, plant.Bw, plant.C))
    loop = exactly.plus(A, exactly.times(exactly.exact(plant.B), exactly.exact(G)))
    z = exactly.plus(C, exactly.times(exactly.exact(plant.D), exactly.exact(G)))
    near = [np.abs(pole.imag) + np.abs(pole.real) * np.linspace(-1, 1, 5) for pole in certificate.poles]
    for omega in {*np.abs(np.concatenate(near)), peak * (1 + 1e-3), peak * (1 - 1e-3), 0.0}:
        gain = float(exactly.gain_squared(loop, Bw, z, float(omega))) ** 0.5
        assert gain <= norm.value * (1 + 1e-8)  # SEEN, and a flat top


def test_a_loop_is_rounded_once():
    """A + B G is the float nearest to it, however much cancels, and what is left of it is kept."""
    rng = np.random.default_rng(3)
    A, B, G = rng.standard_normal((4, 4)), 1e6 * rng.standard_normal((4, 2)), 1e6 * rng.standard_normal((2, 4))
    A = A - B @ G
    plant = GeneralizedPlant(A, B, np.ones((4, 1)), rng.standard_normal((2, 4)), rng.standard_normal((2, 2)), np.zeros((2, 1)))
    loop = plant.closed_loop(G)
    true = exactly.plus(exactly.exact(A), exactly.times(exactly.exact(B), exactly.exact(G)))
    assert loop.beyond is not None
    for i in range(4):
        for j in range(4):
            assert loop.A[i, j] == float(true[i][j])
            off = Fraction(float(loop.A[i, j])) + Fraction(float(loop.beyond[i, j])) - true[i][j]
            assert abs(off) <= Fraction(2) ** -98 * 10**12  # twice the digits of terms of that size
    there = GeneralizedPlant(np.eye(4), B, np.ones((4, 1)), loop.C, plant.D, plant.Dw).closed_loop(G)
    np.testing.assert_array_equal(there.closed_loop(-G).A, np.eye(4))  # a loop of a loop forgets nothing


def test_a_norm_that_rounding_may_have_moved_is_said_so(monkeypatch):
    """If no digits are won in time the certificate fails, and says by how much the norm may be off."""
    plant, G = next((plant, G) for plant, G in map(stiff, range(40)) if np.abs(G).max() > 1e12)
    assert certify(plant, G).failures == ()
    monkeypatch.setattr(iterative_refinement, "MOST_TURNS", 1)
    (said,) = certify(plant, G).failures
    assert said.startswith("rounding may change the norm by ")
