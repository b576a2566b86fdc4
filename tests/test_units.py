"""The same plant in other units has the same verdict and the same norm: no unit decides a rank, a path or where it rests."""

import numpy as np
import pytest

from synth.design import state_design, state_path, two_step_design
from synth.errors import DesignError
from synth.lmi.central import AT_REST, CENTRED, FIRST, LAST
from synth.plant import GeneralizedPlant
from synth.scaling import own_units


def a_plant(seed: int) -> tuple[GeneralizedPlant, np.ndarray]:
    """A random plant and what it measures; of some the optimum lies at infinite gain, and all states are measured."""
    rng = np.random.default_rng(seed)
    n, m, r, d = int(rng.integers(2, 5)), int(rng.integers(1, 3)), int(rng.integers(1, 3)), int(rng.integers(1, 4))
    A, C = rng.standard_normal((n, n)), np.vstack([rng.standard_normal((d, n)), np.zeros((m, n))])
    D = np.vstack([np.zeros((d, m)), (0.1 if seed % 3 else 1e-3) * np.eye(m)])
    plant = GeneralizedPlant(A, rng.standard_normal((n, m)), rng.standard_normal((n, r)), C, D, np.zeros((d + m, r)))
    return plant, np.eye(n) if seed % 2 else rng.standard_normal((max(n - 1, 1), n))


def in_other_units(plant: GeneralizedPlant, Cy: np.ndarray, seed: int) -> tuple[GeneralizedPlant, np.ndarray, float]:
    """The same in units by powers of ten, of states, inputs, measurements, w, z, time, and what a norm of one counts in them."""
    rng = np.random.default_rng([7, seed])
    (x, u, y), (w, z, t) = (
        (10.0 ** rng.integers(-5, 6, k) for k in (len(plant.A), plant.B.shape[1], len(Cy))),
        10.0 ** rng.integers(-3, 4, 3),
    )
    moved = GeneralizedPlant(
        t * plant.A * x / x[:, None],
        t * plant.B * u / x[:, None],
        t * w * plant.Bw / x[:, None],
        z * plant.C * x,
        z * plant.D * u,
        z * w * plant.Dw,
    )
    return moved, Cy * x * y[:, None], z * w


def outcomes(plant: GeneralizedPlant, Cy: np.ndarray, unit: float) -> list[float | str]:
    """The norms of both designs in the first plant's units, or the kind of error."""
    found: list[float | str] = []
    for design in (lambda: state_design(plant), lambda: two_step_design(plant, Cy)):
        try:
            found.append(design().certificate.norm.value / unit)
        except DesignError as error:
            found.append(f"{type(error).__name__}: {str(error)[:40]}")
    return found


@pytest.mark.parametrize("seed", range(12))
def test_units_change_neither_verdict_nor_norm(seed):
    """Both designs of random plants, or why there is none, are the same in units up to ten orders of magnitude apart."""
    plant, Cy = a_plant(seed)
    here = outcomes(plant, Cy, 1.0)
    for again in range(2):
        there = outcomes(*in_other_units(plant, Cy, 100 * seed + again))
        for one, other in zip(here, there, strict=True):
            assert one == (pytest.approx(other, rel=1e-6) if isinstance(other, float) else other)  # AT_REST, where gains grow


def test_a_force_that_costs_nothing_is_named_in_any_units():
    """z weighs no force: that is said, whatever the units."""
    plant = GeneralizedPlant(
        np.array([[0.3, 1.0], [-1.0, 0.2]]),
        np.eye(2),
        np.ones((2, 1)),
        np.array([[1.0, 0.5]]),
        np.zeros((1, 2)),
        np.zeros((1, 1)),
    )
    for seed in range(4):
        moved, Cy, _ = in_other_units(plant, np.eye(2)[:1], seed)
        for design in (lambda p=moved: state_design(p), lambda p=moved, y=Cy: two_step_design(p, y)):
            with pytest.raises(DesignError, match="some control force costs nothing"):
                design()


def test_a_path_rests_at_the_same_points_in_any_units():
    """From FIRST to LAST mu over eta is a power of ten, and the gamma there is the same."""
    plant, Cy = a_plant(3)
    moved, _, unit = in_other_units(plant, Cy, 1)
    here, there = ({round(np.log10(p.mu), 4): p.gamma for p in state_path(each)} for each in (plant, moved))
    for exponent in range(int(np.log10(LAST)), int(np.log10(FIRST)) + 1):
        # Where the path is followed by Newton's method to a decrement, which is eta's error over mu.
        assert there[exponent] / unit == pytest.approx(here[exponent], rel=AT_REST + CENTRED * 10.0**exponent)


def test_own_units_are_no_units():
    """A plant in its own units is nearly the same whatever units it came in, and on the way there and back nothing is rounded."""
    plant, Cy = a_plant(1)
    for seed in range(5):
        moved, Cy_moved, _ = in_other_units(plant, Cy, seed)
        own = own_units(moved, Cy_moved)
        for name in ("A", "B", "Bw", "C", "D"):
            np.testing.assert_array_equal(getattr(own.back(own.into(moved)), name), getattr(moved, name))
        # Each unit is a power of two: what is left of ten orders of magnitude is a factor of two each way.
        ratio = np.abs(own.into(moved).A / own_units(plant, Cy).into(plant).A)
        assert ratio.max() / ratio.min() < 4.01**2
