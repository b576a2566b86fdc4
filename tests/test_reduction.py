"""Laws without the states that do next to nothing answer as they did, and keep every state that does something."""

import numpy as np
import pytest
from scipy import linalg

from models.laws.linear import LinearLaw
from synth.design.full_order.full_order import full_order_design
from synth.design.full_order.riccati import SAME, reduced_law
from synth.plant.generalized import GeneralizedPlant
from tests.test_bounds_hold import a_plant

S = 1j * np.array([0.0, 0.2, 1.0, 5.0])


def answers(law: LinearLaw) -> np.ndarray:
    """C_c (s - A_c)^-1 B_c + D_c, shape (F, m, q)."""
    return np.array([law.C @ np.linalg.solve(s * np.eye(law.states) - law.A, law.B.astype(complex)) + law.D for s in S])


def a_law(seed: int, idle: int, fast: int) -> tuple[LinearLaw, int]:
    """A law in mixed coordinates with idle states, unreached or unseen, and fast ones; and how many others it has."""
    rng = np.random.default_rng(seed)
    core = [np.array([[-1.0, 2.0], [-2.0, -1.0]]), np.array([[-0.3]]), *([np.array([[0.5]])] if seed % 2 else [])]
    A = np.asarray(
        linalg.block_diag(*core, *(-np.eye(1) * (2 + i) for i in range(idle)), *(-1e4 * np.eye(1) for _ in range(fast)))
    )
    k, n = sum(map(len, core)), len(A)
    B, C = rng.standard_normal((n, 2)), rng.standard_normal((2, n))
    B[n - fast :] *= 1e4  # what they feed through has size one
    for i in range(idle):
        (B if i % 2 else C.T)[k + i] = 0
    T = np.linalg.qr(rng.standard_normal((n, n)))[0]
    return LinearLaw(np.linalg.solve(T, A @ T), np.linalg.solve(T, B), C @ T, rng.standard_normal((2, 2))), k


@pytest.mark.parametrize("fast", [0, 1, 2])
@pytest.mark.parametrize("idle", [0, 1, 3])
@pytest.mark.parametrize("seed", range(4))
def test_reduced_law(seed, idle, fast):
    """Idle and fast states go, an unstable one stays, and what is slow is answered as before."""
    law, k = a_law(seed, idle, fast)
    found = reduced_law(law, 1e3)
    assert found.states == k
    np.testing.assert_allclose(
        answers(found), answers(law), atol=10 * 5 / 1e4
    )  # entries of 10 at most, omega over the fast poles
    if not idle and not fast:
        assert found is law


@pytest.mark.attack
def test_idle_states_of_a_design():
    """A mode that is undriven, unseen and decays by itself is no part of the controller; the norm is as without it."""
    plant, Cy = a_plant("undamped", 4)
    n = len(plant.A)
    beside = GeneralizedPlant(
        np.asarray(linalg.block_diag(plant.A, [[-1.0]])), np.vstack([plant.B, 0 * plant.B[:1]]),
        np.vstack([plant.Bw, 0 * plant.Bw[:1]]), np.hstack([plant.C, 0 * plant.C[:, :1]]), plant.D, plant.Dw,
    )  # fmt: skip
    short, longer = full_order_design(plant, Cy), full_order_design(beside, np.hstack([Cy, 0 * Cy[:, :1]]))
    assert short.law.states == n
    assert longer.law.states == n
    assert longer.certificate.norm.value == pytest.approx(short.certificate.norm.value, rel=1e-3 + SAME)  # both within 0.1 %
