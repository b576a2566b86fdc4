"""A static gain is one of full order, too: the full-order design is no worse, and there is one wherever one stabilises."""

import numpy as np
import pytest

from models.laws.linear import static_law
from synth.analysis.certificate import FASTEST
from synth.analysis.norm import hinf_norm
from synth.analysis.stability import stability
from synth.design.full_order.full_order import FullOrderDesign, full_order_design
from synth.design.full_order.riccati import WITHIN
from synth.plant.augmented import on_larger_plant
from synth.plant.generalized import GeneralizedPlant
from synth.plant.units import speed
from tests.commands import attacks

GRID = np.concatenate([-np.logspace(-3, 3, 60), [0.0], np.logspace(-3, 3, 60)])
BEATEN = 2e-3  # relative; full order ends within 0.1 % of the best it can follow, and rounds as much again on the way


def best_on_the_grid(plant: GeneralizedPlant, Cy: np.ndarray, Dyw: np.ndarray) -> float:
    """The smallest norm of the grid's static gains whose loops are stable, and not faster than what full order may be."""
    norms, own = [np.inf], speed(plant)[0]
    for K in GRID:
        larger, gain = on_larger_plant(plant, Cy, static_law(np.array([[K]])), Dyw)
        loop = larger.closed_loop(gain)
        if stability(loop.A, loop.dt).stable and np.abs(np.linalg.eigvals(loop.differences.A)).max() <= FASTEST * own:
            norms.append(hinf_norm(loop).value)
    return min(norms)


def holds(found: FullOrderDesign) -> None:
    """Returns what is claimed of every design."""
    assert not found.certificate.failures
    assert found.certificate.lower_bound is not None
    assert found.certificate.lower_bound <= found.certificate.norm.value
    assert ("above" in found.remark) == (found.certificate.norm.value > found.certificate.lower_bound * (1 + WITHIN))


def first_order(a: float, noise: float, dt: float | None = 1.0) -> tuple[GeneralizedPlant, np.ndarray, np.ndarray]:
    """x' (or x+) = a x + u + w, z = [x; 0.1 u], y = x + noise v."""
    A, one = np.array([[a]]), np.eye(1)
    plant = GeneralizedPlant(
        A, one, np.array([[1.0, 0]]), np.array([[1.0], [0]]), np.array([[0], [0.1]]), np.zeros((2, 2)), dt=dt
    )
    return plant, one, np.array([[0, noise]])


def any_noisy(seed: int, dt: float | None) -> tuple[GeneralizedPlant, np.ndarray, np.ndarray]:
    """A random plant of one to three states with one noisy measurement, stable or not, and a force that costs something."""
    rng = np.random.default_rng([17, seed])
    n = int(rng.integers(1, 4))
    A = rng.standard_normal((n, n))
    if dt is not None:
        A *= rng.uniform(0.3, 1.2) / np.abs(np.linalg.eigvals(A)).max()
    Bw = np.hstack([rng.standard_normal((n, 1)), np.zeros((n, 1))])
    C, D = np.vstack([rng.standard_normal((1, n)), np.zeros((1, n))]), np.array([[0.0], [10 ** rng.uniform(-2, 0)]])
    plant = GeneralizedPlant(A, rng.standard_normal((n, 1)), Bw, C, D, np.zeros((2, 2)), dt=dt)
    return plant, rng.standard_normal((1, n)), np.array([[0, 10 ** rng.uniform(-2, 0)]])


def no_grid_beats(plant: GeneralizedPlant, Cy: np.ndarray, Dyw: np.ndarray) -> FullOrderDesign:
    """Checks what the tests below claim, and returns the design that it is claimed of."""
    found = full_order_design(plant, Cy, Dyw)
    holds(found)
    assert found.certificate.norm.value <= best_on_the_grid(plant, Cy, Dyw) * (1 + BEATEN)
    return found


@pytest.mark.parametrize(("a", "dt"), [(0.5, 1.0), *attacks([(-0.5, None)])])
def test_static_gain_next_to_the_bound(a, dt):
    """If the central law needs a pole a thousand times as fast, what is left of it without that pole is as near, and taken."""
    found = no_grid_beats(*first_order(a, 0.1, dt))
    assert found.remark == ""
    assert found.certificate.speed_up < FASTEST


@pytest.mark.parametrize(
    ("seed", "dt"),
    [
        (1, None),
        *attacks(((2, None), (12, None), (2, 0.1), (12, 0.1))),
        *(pytest.param(seed, dt, marks=pytest.mark.attack) for seed in range(100, 102) for dt in (None, 0.1)),
    ],
)
def test_no_static_gain_is_better(seed, dt):
    """For random plants no static gain of a grid beats full order by more than 0.2 %."""
    no_grid_beats(*any_noisy(seed, dt))


@pytest.mark.parametrize(
    ("side", "distance"),
    [
        (-1, 1e-13),
        (1, 0.0),
        *attacks([(-1, 0.0), (1, 1e-8)]),
        *(pytest.param(-1, each, marks=pytest.mark.attack) for each in (1e-6, 1e-11, 1e-15)),
        *(pytest.param(1, each, marks=pytest.mark.attack) for each in (1e-3, 1e-6)),
    ],
)
def test_poles_next_to_the_unit_circle_at_real_points(side, distance):
    """With a pole next to z = -1, where the map has no place for it, or next to 1 a law is as near as the best static gain."""
    found = full_order_design(*first_order(side * (1 - distance), 0.0))
    holds(found)
    assert found.certificate.norm.value <= 1.00499 * (1 + BEATEN)  # what a grid's best static gain has of each
