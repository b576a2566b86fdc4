"""Filters and how they are put together: at every frequency what is put together is what its parts say."""

from dataclasses import replace

import numpy as np
import pytest

from models.common.errors import InputError
from synth.plant.augmented import append, gain, series, transfer_function
from synth.plant.state_space import StateSpace

OMEGA = np.array([0.0, 0.3, 1.0, 7.0, 200.0])


def response(system: StateSpace) -> np.ndarray:
    """C (j omega - A)^-1 B + D, shape (F, p, k)."""
    s = 1j * OMEGA[:, None, None] * np.eye(len(system.A))
    return system.C @ np.linalg.solve(s - system.A, system.B.astype(complex)[None]) + system.D


def random_system(seed: int, p: int, k: int) -> StateSpace:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    A, B, C, D = (rng.standard_normal(shape) for shape in ((n, n), (n, k), (p, n), (p, k)))
    return StateSpace(A, B, C, D)


@pytest.mark.parametrize(
    ("above", "below"),
    [([3.0], [2.0, 1.0]), ([1.0, 50.0], [1.0, 500.0]), ([0.0, 0.0, 4.0], [0.0, 2.0]), ([1.0, 0, 2], [1, 3, 5.0])],
)
def test_transfer_function(above, below):
    """A filter is the ratio of its polynomials; leading zeros mean nothing."""
    s = 1j * OMEGA
    expected = np.polyval(above, s) / np.polyval(below, s)
    np.testing.assert_allclose(response(transfer_function(above, below))[:, 0, 0], expected, rtol=1e-12)  # rounding


def test_one_after_the_other_and_beside():
    """Series multiplies responses, append puts them on a diagonal, a part is by name; parts may have no state."""
    one, other, D = random_system(0, 2, 3), random_system(1, 4, 2), np.array([[1.0, -2.0]])
    np.testing.assert_allclose(response(series(one, other)), response(other) @ response(one), rtol=1e-12)
    np.testing.assert_allclose(response(series(one, gain(D))), D @ response(one), rtol=1e-12)
    both = response(append(one, gain(D), other))
    np.testing.assert_allclose(both[:, :2, :3], response(one), rtol=1e-12)
    np.testing.assert_allclose(both[:, 2:3, 3:5], np.broadcast_to(D, (len(OMEGA), 1, 2)))
    np.testing.assert_allclose(both[:, 3:, 5:], response(other), rtol=1e-12)
    assert not both[:, :2, 3:].any()
    assert not both[:, 2:, :3].any()
    named = replace(one, inputs=("a", "b", "c"), outputs=("x", "y"))
    np.testing.assert_allclose(response(named.part(["y"], ["c", "a"])), response(one)[:, [1]][:, :, [2, 0]], rtol=1e-12)


def test_refused():
    """A filter that is none, or does not fit, is refused in a line."""
    with pytest.raises(InputError, match="would differentiate"):
        transfer_function([1, 2], [3])
    with pytest.raises(InputError, match="denominator of a filter is zero"):
        transfer_function([1], [0, 0])
    with pytest.raises(InputError, match="not finite"):
        transfer_function([np.inf], [1])
    with pytest.raises(InputError, match="with 2 outputs cannot feed a system with 1 inputs"):
        series(gain(np.eye(2)), gain(1))
    with pytest.raises(InputError, match=r"B has shape \(1, 1\); expected \(1, 2\)"):
        StateSpace(np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 2)))
