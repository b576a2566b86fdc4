"""A proof of a bound is formed and judged without rounding: held against rational arithmetic, next to where it would fail."""

import contextlib
from fractions import Fraction

import numpy as np
import pytest

from synth.analysis.bounding import bounding_x
from synth.analysis.certificate import LmiProof, bounded_real_exactly, eta_of, prove_bound
from synth.analysis.norm import hinf_norm
from synth.analysis.rigorous import definiteness
from synth.plant.generalized import SHAPES, GeneralizedPlant
from tests import exactly


def test_bound_is_rounded_upwards():
    """The bound that eta proves is never more than the bound that is claimed, to the last bit, both ways; nor is what it
    prints as one."""
    rng, any_ = np.random.default_rng(0), definiteness(np.eye(1))
    for bound in 10.0 ** rng.uniform(-60, 60, 300):
        eta = eta_of(bound)
        assert Fraction(bound) ** 2 * Fraction(eta) >= 1
        assert LmiProof(np.eye(1), eta, any_, any_).bound <= bound
        assert eta == pytest.approx(bound**-2, rel=1e-15)  # a few units in the last place


def test_matrix_of_the_proof():
    """The judged matrix is that of (20) in rational arithmetic, whatever the sizes of its numbers, rounded once."""
    rng = np.random.default_rng(1)
    for n, m, r, d in ((1, 1, 1, 1), (4, 2, 1, 3), (3, 0, 2, 1), (2, 1, 1, 2)):
        shapes = {"A": (n, n), "B": (n, m), "Bw": (n, r), "C": (d, n), "D": (d, m), "Dw": (d, r)}
        drawn = {
            name: rng.standard_normal(shape) * 10.0 ** rng.uniform(-30, 30, shape)
            for name, shape in {**shapes, "G": (m, n), "X": (n, n)}.items()
        }
        G, X, eta = drawn.pop("G"), drawn.pop("X"), 0.3
        A, B, Bw, C, D, Dw = (drawn[name] for name in SHAPES)
        plant, X = GeneralizedPlant(A, B, Bw, C, D, Dw), X + X.T
        still, turned = exactly.bounded_real(plant, G, X), exactly.disturbed(plant)
        for i, j in np.ndindex(n + d, n + d):
            assert bounded_real_exactly(plant, G, X, eta)[i, j] == float(still[i][j] + turned[i][j] * Fraction(eta))


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
