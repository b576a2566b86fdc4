"""SLICOT's solvers as witnesses, where slycot is installed: designs and norms are theirs, or better by what is known."""

import contextlib
from typing import Any

import control
import numpy as np
import pytest

from models.laws.linear import LinearLaw
from synth.analysis.norm import hinf_norm
from synth.analysis.stability import is_stable
from synth.design.full_order.full_order import full_order_design
from synth.design.full_order.quadratic import h2_design, h2_norm
from synth.design.uncertainty.worst_case import worst_norm
from synth.plant.generalized import GeneralizedPlant

slycot = pytest.importorskip("slycot", reason="a witness that is not required")


def regular(seed: int) -> tuple[GeneralizedPlant, np.ndarray, np.ndarray, Any]:
    """A plant with noise and cost of full rank, as SLICOT asks for, and the same from [w; u] to [z; y]."""
    rng, n = np.random.default_rng(seed), 3
    A = rng.standard_normal((n, n))
    B, Bw = rng.standard_normal((n, 1)), np.hstack([rng.standard_normal((n, 1)), np.zeros((n, 1))])
    C, D = np.vstack([rng.standard_normal((1, n)), np.zeros((1, n))]), np.array([[0.0], [1.0]])
    Cy, Dyw = rng.standard_normal((1, n)), np.array([[0.0, 0.5]])
    whole = control.ss(A, np.hstack([Bw, B]), np.vstack([C, Cy]), np.block([[np.zeros((2, 2)), D], [Dyw, np.zeros((1, 1))]]))
    return GeneralizedPlant(A, B, Bw, C, D, np.zeros((2, 2))), Cy, Dyw, whole


@pytest.mark.parametrize("seed", [0, 1])
def test_h_infinity_is_as_good_as_hinfsyn(seed):
    """Full order comes within 0.1 % of SB10AD's least gamma, or says that it is further, and no lower bound lies above it."""
    plant, Cy, Dyw, whole = regular(seed)
    *_, gamma, _ = control.hinfsyn(whole, 1, 1)
    design = full_order_design(plant, Cy, Dyw)
    certificate = design.certificate
    assert certificate.lower_bound is not None
    assert design.remark or certificate.norm.value <= gamma * (1 + 1e-3)
    assert bool(design.remark) == (certificate.norm.value > certificate.lower_bound * (1 + 1e-3))
    assert certificate.lower_bound <= gamma * (1 + 1e-6)  # its bisection ends above what can be


KINDS = ("stable", "unstable", "accelerations in z", "uneven", "mechanical", "without noise")


def of_kind(seed: int) -> tuple[GeneralizedPlant, np.ndarray, np.ndarray]:
    """A random plant of 1 to 10 states, of one of these kinds; noise and cost are small."""
    rng, n, kind = np.random.default_rng([20261127, seed]), 1 + seed % 10, KINDS[seed // 10 % 6]
    m, q, r, d = rng.integers(1, 4, 4)
    A, B, Bw, z, y = (rng.standard_normal(shape) for shape in ((n, n), (n, m), (n, r), (d, n), (q, n)))
    if kind in ("stable", "uneven"):
        A = A - (0.1 + np.abs(np.linalg.eigvals(A).real.max())) * np.eye(n)
    if kind == "mechanical" and (k := n // 2):
        A, B[:k], Bw[:k] = np.zeros((n, n)), 0.0, 0.0
        springs, dampers = rng.standard_normal((2, k, k))
        A[:k, k : 2 * k], A[k : 2 * k, :k] = np.eye(k), -springs @ springs.T - 0.5 * np.eye(k)
        A[k : 2 * k, k : 2 * k], A[2 * k :, 2 * k :] = -0.05 * dampers @ dampers.T - 0.01 * np.eye(k), -1.0
    cost, noise = 10 ** rng.uniform(-2, 0), 10 ** rng.uniform(-3, 0)
    fed, felt = np.zeros((d, m)), np.zeros((d, r))
    if kind in ("accelerations in z", "mechanical"):
        z[0], fed[0], felt[0] = A[n // 2], B[n // 2], Bw[n // 2]
    Dyw = np.hstack([np.zeros((q, r)) if seed % 2 else 0.3 * rng.standard_normal((q, r)), noise * np.eye(q)])
    Dyw *= kind != "without noise"
    t, u, s = (10 ** rng.uniform(-3, 3, size) if kind == "uneven" else np.ones(size) for size in (n, m, q))
    C, D = np.vstack([z, np.zeros((m, n))]) * t, np.vstack([fed, cost * np.eye(m)]) * u
    Dw = np.zeros((d + m, r + q))
    Dw[:d, :r] = felt
    Bw = np.hstack([Bw, np.zeros((n, q))]) / t[:, None]
    return GeneralizedPlant(A * t / t[:, None], B * u / t[:, None], Bw, C, D, Dw), s[:, None] * y * t, s[:, None] * Dyw


@pytest.mark.extra
@pytest.mark.attack
@pytest.mark.parametrize("seed", range(60))
def test_random_plants(seed):
    """No full-order H-infinity or H2 design is more than 1 % behind SLICOT's, whose laws are far faster: by their loops."""
    plant, Cy, Dyw = of_kind(seed)
    q, m = len(Cy), plant.B.shape[1]
    shared = np.zeros_like(Dyw) if np.any(Dyw) else 1e-3 * np.eye(q, Dyw.shape[1], Dyw.shape[1] - q)  # SLICOT asks for noise
    through = np.block([[plant.Dw, plant.D], [Dyw + shared, np.zeros((q, m))]])
    whole = control.ss(plant.A, np.hstack([plant.Bw, plant.B]), np.vstack([plant.C, Cy]), through)

    def loop(law: Any) -> GeneralizedPlant:
        larger, G = plant.measured(Cy, Dyw).with_law(LinearLaw(law.A, law.B, law.C, law.D))
        return larger.closed_loop(G)

    found = full_order_design(plant, Cy, Dyw).certificate.norm.value
    theirs = None
    with contextlib.suppress(Exception):  # slycot's own errors: it says of some laws that they are not admissible
        theirs = loop(control.hinfsyn(whole, q, m)[0])
    if theirs is not None and is_stable(theirs.A):
        assert found <= hinf_norm(theirs).value * 1.01
    if np.any(Dyw) and not np.any(plant.Dw):
        assert h2_design(plant, Cy, Dyw).h2_norm <= h2_norm(loop(control.h2syn(whole, q, m))) * 1.01


@pytest.mark.parametrize("seed", [0, 1])
def test_h2_is_h2syn(seed):
    """The H2 norm is that of the loop of SB10HD's law."""
    plant, Cy, Dyw, whole = regular(seed)
    law = control.h2syn(whole, 1, 1)
    theirs = control.norm(whole.lft(law), 2)
    assert h2_design(plant, Cy, Dyw).h2_norm == pytest.approx(theirs, rel=1e-6)  # two Riccati solvers


def test_norms_with_errors_are_within_mu():
    """Where relative errors of readings leave a norm below gamma, SLICOT's upper bound of mu at every frequency agrees."""
    one = np.array([[0.0], [1.0]])
    plant = GeneralizedPlant(np.array([[0.0, 1.0], [-4.0, -0.4]]), one, one, np.eye(2), 0 * one, 0 * one)
    Cy, K, error = np.eye(2), np.array([[-1.0, -1.0]]), 0.2
    worst = worst_norm(plant, Cy, K, np.full(2, error), np.zeros(1))
    bound = 0.0
    for omega in np.geomspace(0.5, 8, 60):
        inverse = np.linalg.inv(1j * omega * np.eye(2) - plant.A - plant.B @ K @ Cy)
        seen = np.vstack([Cy, plant.C])
        M = seen @ inverse @ np.hstack([error * plant.B @ K, plant.Bw])
        low, high = 1e-3, 1e3
        for _ in range(40):
            gamma = np.sqrt(low * high)
            scaled = M.copy()
            scaled[2:] /= gamma
            square = np.hstack([scaled, np.zeros((4, 1))])  # z has two rows and w one column: one full block of two
            mu = slycot.ab13md(square, np.array([1, 1, 2]), np.array([1, 1, 2]))[0]
            low, high = (gamma, high) if mu > 1 else (low, gamma)
        bound = max(bound, high)
    assert worst.found <= bound * (1 + 1e-3)  # real errors are among those of mu; 60 frequencies miss so much of a peak
    assert worst.proved is not None
