"""A claim on u = K y is true of it in exact arithmetic, however much of K C_y cancels."""

from fractions import Fraction

import numpy as np
import pytest

from synth.analysis.bounding import certify_tightly
from synth.analysis.certificate import Certificate, bounded_real_exactly, certify
from synth.design.two_step import two_step_design
from synth.plant.generalized import Feedback, GeneralizedPlant
from tests.exactly import bounded_real, exact, gain_squared, largest_eta, plus, stable, times
from tests.test_bounds_hold import of_lists


def drawn(seed: int, n: int, gain: float, apart: float) -> tuple[GeneralizedPlant, Feedback]:
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
    G = times(exact(u.K), exact(u.Cy))
    loop = plus(exact(plant.A), times(exact(plant.B), G))
    assert certificate.stable == stable(loop)
    norm, Bw = certificate.norm, exact(plant.Bw)
    at_peak = gain_squared(loop, Bw, plus(exact(plant.C), times(exact(plant.D), G)), norm.peak_frequency)
    # The norm is the gain at its peak but for the rounding that is stated, and a square root of floats.
    assert abs(float(Fraction(norm.value) ** 2 / at_peak) ** 0.5 - 1) <= norm.rounding + 4 * np.finfo(float).eps
    if certificate.proof is not None:
        eta = largest_eta(plant, u, certificate.proof.X)
        assert eta is not None
        assert Fraction(certificate.proof.eta) < eta
    of_floats = plant.closed_loop(u.K @ u.Cy)
    T = of_floats.C @ np.linalg.solve(1j * norm.peak_frequency * np.eye(len(of_floats.A)) - of_floats.A, of_floats.Bw)
    return abs(float(np.linalg.norm(T)) / norm.value - 1)


@pytest.mark.parametrize("seed", range(8))
def test_a_gain_that_weighs_differences(seed):
    """A gain of 1e11 on rows 1e-9 apart: poles, norm and bound are those of u = K y, not of the floats nearest to K C_y."""
    plant, u = drawn(seed, 2 + seed % 3, 1e11, 1e-9)
    certificate = certify_tightly(plant, u)
    assert certificate.failures == ()
    assert certificate.bound is not None
    off = refuse_what_is_not_true(certificate, plant, u)
    assert off > 1e-9  # measured 2e-7 to 2e-4: what the nearest floats would claim, so that this test can fail
    assert certificate.norm.rounding < 1e-9


@pytest.mark.attack
def test_gains_of_all_sizes():
    """So of a hundred and fifty, from rows that are far apart to such that differ in their last three digits."""
    for seed in range(150):
        rng = np.random.default_rng(seed)
        apart = 10.0 ** rng.uniform(-13, 0)
        plant, u = drawn(seed, int(rng.integers(1, 6)), 10.0 ** rng.uniform(0, 3) / apart, apart)
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


@pytest.mark.parametrize("seed", range(4))
def test_the_matrix_of_the_proof_is_of_the_exact_gain(seed):
    """Every entry of (20) is the float nearest to that of K and C_y as they stand."""
    plant, u = drawn(seed, 3, 1e11, 1e-9)
    X = np.eye(3)
    found, true = bounded_real_exactly(plant, u, X, 0.0), bounded_real(plant, u, X)
    assert found.tolist() == [[float(entry) for entry in row] for row in true]
    assert np.any(found != bounded_real_exactly(plant, u.K @ u.Cy, X, 0.0))
