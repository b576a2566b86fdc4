"""A norm is what exact arithmetic says, also where a huge gain leaves floats few digits, and rounding is known where it acts."""

from fractions import Fraction

import numpy as np
import pytest

from synth.analysis.certificate import certify
from synth.analysis.norm import gain_at, hinf_norm
from synth.plant import double_double as extended
from synth.plant.double_double import added, multiplied, product
from synth.plant.generalized import GeneralizedPlant
from tests import exactly


def test_what_rounding_takes_is_kept():
    """high + low is the sum or the product, exactly; of a product of matrices to twice the digits of what is summed."""
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal((2, 500)) * 10.0 ** rng.uniform(-30, 30, (2, 500))
    for pair, whole in ((added(a, b), lambda x, y: x + y), (multiplied(a, b), lambda x, y: x * y)):
        for x, y, high, low in zip(a, b, *pair, strict=True):
            assert Fraction(float(high)) + Fraction(float(low)) == whole(Fraction(float(x)), Fraction(float(y)))
    left, right = rng.standard_normal((2, 3, 7)), rng.standard_normal((7, 4))
    left[..., 1:] *= 1e8  # so that sums cancel
    high, low = product(left, right)
    for i in range(2):
        for row, highs, lows in zip(left[i], high[i], low[i], strict=True):
            for column, h, e in zip(right.T, highs, lows, strict=True):
                terms = [Fraction(float(x)) * Fraction(float(y)) for x, y in zip(row, column, strict=True)]
                size = sum(map(abs, terms))
                assert abs(Fraction(float(h)) + Fraction(float(e)) - sum(terms)) <= 2 * 49 * Fraction(2) ** -106 * size


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


@pytest.mark.parametrize("seed", [*range(8), *(pytest.param(seed, marks=pytest.mark.attack) for seed in range(8, 16))])
def test_norms_of_huge_gains(seed):
    """Exact rational arithmetic on the plant and the gain as they stand gives the norm at its peak, and nowhere near more."""
    plant, G = stiff(seed)
    loop = plant.closed_loop(G)
    norm = hinf_norm(loop)
    assert np.isfinite(norm.value)
    assert norm.rounding < 1e-8
    A = exactly.plus(exactly.exact(plant.A), exactly.times(exactly.exact(plant.B), exactly.exact(G)))
    Bw = exactly.exact(plant.Bw)
    C = exactly.plus(exactly.exact(plant.C), exactly.times(exactly.exact(plant.D), exactly.exact(G)))
    peak = norm.peak_frequency
    reached = float(exactly.gain_squared(A, Bw, C, peak)) ** 0.5
    assert norm.value == pytest.approx(reached, rel=1.01 * norm.rounding + 1e-15)  # as claimed
    assert gain_at(loop, peak) == pytest.approx(reached, rel=1e-13)
    poles = np.linalg.eigvals(loop.A)
    near = np.concatenate([np.abs(pole.imag) + np.abs(pole.real) * np.linspace(-1, 1, 5) for pole in poles])
    for omega in {*np.abs(near), peak * (1 + 1e-3), peak * (1 - 1e-3), 0.0}:
        assert float(exactly.gain_squared(A, Bw, C, float(omega))) ** 0.5 <= norm.value * (1 + 1e-8)  # SEEN, and a flat top


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
    monkeypatch.setattr(extended, "MOST_TURNS", 1)
    (said,) = certify(plant, G).failures
    assert said.startswith("rounding may have changed the norm by ")
