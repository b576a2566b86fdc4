"""Plants that hardly move by themselves: the two steps reach what there is to reach, however slow the slowest mode."""

import re

import numpy as np
import pytest

from synth.analysis.norm import hinf_norm
from synth.design.descent.refine import refine
from synth.design.two_step import two_step_design
from synth.lmi.full_order_bound import find_lower_bound
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError, NoSolutionError
from tests.commands import attacks


def scalar(pole: float, dt: float | None, state: float = 1.0, force: float = 1.0) -> GeneralizedPlant:
    """One state, pushed by u and w alike; z = [x, u]. `state` and `force` are what one of a unit counts in another."""
    column = np.array([[state]])
    return GeneralizedPlant(
        np.array([[pole]]),
        column * force,
        column,
        np.array([[1 / state], [0.0]]),
        np.array([[0.0], [force]]),
        np.zeros((2, 1)),
        dt=dt,
    )


def of_slow_modes(seed: int) -> tuple[GeneralizedPlant, np.ndarray]:
    """A discrete plant with one pole or all of them next to z = 1, in odd units, and what it measures."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    m, q = int(rng.integers(1, min(n, 2) + 1)), int(rng.integers(1, n + 1))
    poles = 1 - 10.0 ** -rng.permutation(np.arange(1, 9))[:n] * rng.choice([1, 1, -1], n)
    if rng.random() < 0.5:
        poles[1:] = rng.uniform(-0.9, 0.9, n - 1)
    V, states, forces = rng.normal(size=(n, n)), 10.0 ** rng.integers(-4, 5, n), 10.0 ** rng.integers(-4, 5, m)
    plant = GeneralizedPlant(
        A=(states[:, None] * (V * poles @ np.linalg.inv(V))) / states,
        B=states[:, None] * rng.normal(size=(n, m)) * forces,
        Bw=states[:, None] * rng.normal(size=(n, 1)),
        C=np.vstack([rng.normal(size=(1, n)) / states, np.zeros((m, n))]),
        D=np.vstack([np.zeros((1, m)), np.diag(forces)]),
        Dw=np.zeros((1 + m, 1)),
        dt=float(10.0 ** rng.integers(-3, 4)),
    )
    return plant, rng.normal(size=(q, n)) / states


def certified_or_infeasible(seed: int) -> None:
    """The claim of the tests below."""
    plant, Cy = of_slow_modes(seed)
    try:
        design = two_step_design(plant, Cy)
    except DesignError as error:
        # Of all states that grow or hardly decay, next to each other, rounding may leave (14) no inverse, and that is said.
        if len(Cy) == len(plant.A) and str(error).startswith("L (14) could not be computed: C_y X C_y' is singular"):
            return
        # Nor may it leave one input more modes next to each other than it can tell apart: they stay where they are.
        alike = np.sum(np.abs(np.linalg.eigvals(plant.A) - 1) < 1e-4) > plant.B.shape[1]
        if alike and re.match(r"its certificate fails: marginal: a pole at .* lies on the unit circle, to rounding", str(error)):
            return
        if not isinstance(error, NoSolutionError):
            raise
        # Of (25), but where one input tells several modes next to each other apart by no more than rounding.
        of_second = len(Cy) < len(plant.A) and str(error).startswith("problem (25) has no solution with eta > 0 for this L")
        if not of_second and not str(error).endswith("off the unit circle by more than rounding"):
            raise
        return
    certificate = design.certificate
    assert not certificate.failures
    norm = hinf_norm(plant.closed_loop(design.gain @ Cy))
    assert certificate.norm.value == pytest.approx(norm.value, rel=max(1e-9, norm.rounding))
    assert norm.value >= find_lower_bound(plant, Cy).gamma * (1 - 1e-9)  # rounding of the norm


@pytest.mark.parametrize("seed", [*range(4), *attacks(range(4, 8))])
def test_slow_discrete_plants(seed):
    """Poles 1 - 1e-1 to 1 - 1e-8, outside the circle too: a certified gain no better than the bound, or (25) has no solution."""
    certified_or_infeasible(seed)


@pytest.mark.attack
@pytest.mark.parametrize("first", [8, 183])  # one of the last has poles that rounding cannot tell apart
def test_many_slow_discrete_plants(first):
    """The same of fifty."""
    for seed in range(first, first + 25):
        certified_or_infeasible(seed)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("digits", [15, *attacks((1, 3, 6, 12))])
def test_one_slow_discrete_mode(digits, sign):
    """For a scalar plant the optimum has a formula, and the gain meets it, to the last pole that is not 1, in odd units."""
    pole = 1 - sign * 10.0**-digits
    design = two_step_design(scalar(pole, 0.1, state=1e3, force=1e-2), np.eye(1))
    # The norm of u = k x is hypot(1, k) / (1 - |pole + k|), least where the loop's pole is 0; the path ends within
    # (2 n + d) mu / 2 = 2e-9 of it.
    assert design.certificate.norm.value == pytest.approx(np.hypot(1, pole), rel=5e-9)
    assert not design.certificate.failures


@pytest.mark.parametrize("digits", [1, 6, 12, *attacks((2, 4, 9))])
def test_one_slow_continuous_mode(digits):
    """x' = -e x + u + w, z = [x, u] has the optimum 1 / sqrt(1 + e^2), at u = -x / e: as slow as it is, it is come near to."""
    slow = 10.0**-digits
    design = two_step_design(scalar(-slow, None, state=1e3, force=1e-2), np.eye(1))
    assert not design.certificate.failures
    assert design.certificate.norm.value >= 1 / np.hypot(1, slow) * (1 - 1e-9)
    # Gains beyond actuators are left out: what they would save is below the share that `optimum_gap` tells.
    assert design.certificate.norm.value <= (1 + design.optimum_gap) / np.hypot(1, slow) * (1 + 1e-6)
    assert design.optimum_gap < 0.01


@pytest.mark.parametrize("seed", [13, 16])  # of 13 the norm of the map is 1e-6 off
def test_what_a_refinement_says_is_the_norm(seed):
    """The norms that a refinement of a discrete plant tells are those of its own loop, not of the one it is mapped to."""
    plant, Cy = of_slow_modes(seed)
    K = two_step_design(plant, Cy).gain
    found = refine(plant, Cy, K)
    for gain, said in ((K, found.before), (found.gain, found.after)):
        assert said == pytest.approx(hinf_norm(plant.closed_loop(gain @ Cy)).value, rel=1e-10)  # the same number, rounded alike
