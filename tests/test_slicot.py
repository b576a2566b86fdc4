"""SLICOT's solvers as witnesses, where slycot is installed: designs and norms are theirs, or better by what is known."""

from typing import Any

import control
import numpy as np
import pytest

from synth.design.full_order.full_order import full_order_design
from synth.design.full_order.quadratic import h2_design
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
