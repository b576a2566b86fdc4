"""The descent of static gains: never worse than its parts, always proved, and at home in narrow valleys."""

import numpy as np
import pytest

from synth.analysis.bounding import certify_tightly
from synth.analysis.certificate import certify
from synth.design.descent.growth import WORTH, lower_by_growth
from synth.design.descent.landscape import Landscape
from synth.design.descent.minimax import descend_norm
from synth.design.descent.refine import refine
from synth.design.fixed_order.pattern import in_equal_units
from synth.design.static import static_output_feedback
from synth.design.two_step import two_step_design
from synth.lmi.full_order_bound import find_lower_bound
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError
from tests.claims.test_no_controller_beats_a_bound import of_lists
from tests.support.commands import attacks
from tests.support.shared import nothing_shared
from tests.synth.test_static import random_plant

LARGEST = 1e5


def follower() -> tuple[GeneralizedPlant, np.ndarray]:
    """A mass that is to follow a reference which wanders slowly, by a controller with one state of its own.

    States: position, speed, reference, memory. Inputs: force, and what the memory is fed. Measured: position, reference, memory.
    Only the difference of position and reference is small: gains may grow in it, and must cancel in all else to 1e-4.
    """
    A = np.zeros((4, 4))
    A[0, 1], A[2, 2] = 1.0, -1e-4
    B = np.zeros((4, 2))
    B[1, 0] = B[3, 1] = 1.0
    Bw = np.zeros((4, 2))
    Bw[1, 0], Bw[2, 1] = 1.0, 0.01
    plant = GeneralizedPlant(A, B, Bw, np.array([[1.0, 0.0, -1.0, 0.0]]), np.zeros((1, 2)), np.zeros((1, 2)))
    return plant, np.eye(4)[[0, 2, 3]]


def lead(stiffness: float, zero: float, pole: float) -> np.ndarray:
    """The gain of `follower` that a course in control teaches: -stiffness (s + zero) / (s + pole) of the error."""
    return np.array([[-stiffness, stiffness, stiffness], [pole - zero, zero - pole, -pole]])


@pytest.mark.parametrize(("seed", "n", "m"), [(3, 3, 1), *attacks([(0, 3, 1), (0, 5, 2), (1, 5, 2)])])
def test_not_worse_than_the_two_steps_refined(seed, n, m):
    """On random plants the strategy's gain is proved within 1e-4, in bounds, and no worse than the two steps refined."""
    plant, Cy = random_plant(seed, n=n, m=m)
    lower_bound = find_lower_bound(plant, Cy)
    try:
        design = static_output_feedback(plant, Cy, LARGEST, lower_bound)
    except DesignError:
        with pytest.raises(DesignError):
            two_step_design(plant, Cy)
        return
    certificate = design.certificate
    assert certificate.failures == ()
    assert certificate.bound is not None
    assert certificate.norm.value <= certificate.bound <= certificate.norm.value * (1 + 1e-4)  # the second of MARGINS
    assert np.abs(design.gain).max() <= LARGEST * (1 + 1e-12)  # rounding of the scales
    if design.two_steps is not None:
        refined = refine(plant, Cy, design.two_steps.gain)
        if np.abs(refined.gain).max() <= LARGEST:
            assert certificate.norm.value <= refined.after * (1 + 1e-8)  # where each norm stops


@pytest.mark.attack
def test_narrow_valley():
    """If gains must cancel to 1e-4 in all but one direction, the strategy beats the lead compensators of a textbook."""
    plant, Cy = follower()
    design = static_output_feedback(plant, Cy)
    norms = [
        certify(plant, lead(stiffness, ratio * stiffness**0.5 / 3, 3 * ratio * stiffness**0.5) @ Cy).norm.value
        for stiffness in np.geomspace(1e2, LARGEST, 7)
        for ratio in (0.5, 1.0, 2.0)
    ]
    assert design.certificate.failures == ()
    assert design.certificate.bound is not None
    assert design.certificate.norm.value <= min(norms)


@pytest.mark.attack
def test_same_gain_again():
    """The same plant gives the same gain, to the last bit."""
    plant, Cy = random_plant(3, n=3, m=1)
    with nothing_shared():
        np.testing.assert_array_equal(static_output_feedback(plant, Cy).gain, static_output_feedback(plant, Cy).gain)


def test_units_of_a_law_that_make_the_same_loop():
    """The unit of a law's state changes its gain, not the norm; the same balanced gain is found from any of them."""
    plant, Cy = follower()
    landscape = Landscape(plant.measured(Cy))
    norm, points = landscape.norm(landscape.point(lead(1e3, 10.0, 100.0)))[0], []
    for unit in (1e-3, 1.0, 1e3):
        x = landscape.point(lead(1e3, 10.0, 100.0) * np.outer([1.0, unit], [1.0, 1.0, 1 / unit]))
        points.append(in_equal_units(landscape, x, states=1))
        assert landscape.norm(points[-1])[0] == pytest.approx(norm, rel=1e-9)
    np.testing.assert_allclose(points, [points[0]] * 3, rtol=1e-9)


@pytest.mark.parametrize("stiffness", [1e2, 1e5])
def test_proof_of_stiff_and_slow(stiffness):
    """A loop whose poles are seven decades apart has its norm proved to a hundredth, by an X from a Riccati equation."""
    plant, Cy = follower()
    certificate = certify_tightly(plant, lead(stiffness, stiffness**0.5 / 3, 3 * stiffness**0.5) @ Cy)
    assert certificate.failures == ()
    assert certificate.bound is not None
    assert certificate.bound <= 1.01 * certificate.norm.value * (1 + 1e-9)  # the third of MARGINS


def test_norm_of_zero_is_proved():
    """If w does not reach z, an absolute bound is proved: a millionth of what the plant's matrices could do."""
    plant = GeneralizedPlant(
        np.diag([-1.0, -2.0]), np.eye(2), np.array([[1.0], [0.0]]), np.array([[0.0, 1.0]]), np.zeros((1, 2)), np.zeros((1, 1))
    )
    certificate = certify_tightly(plant, np.zeros((2, 2)))
    assert certificate.norm.value == 0
    assert certificate.failures == ()
    assert certificate.bound is not None
    assert certificate.bound <= 1e-6


# --- its steps --------------------------------------------------------------------------------------------------------------


def test_a_descent_ends_where_rounding_leaves_no_model(monkeypatch):
    """A descent without a model stays where it is, and its norm is the one that it had: what was reached is never lost."""
    plant = of_lists([[-1, 1], [0, -2]], [[0], [1]], [[1], [1]], [[1, 0], [0, 0]], [[0], [0.1]])
    landscape = Landscape(plant.measured(np.eye(2)))
    x, limit = np.zeros(2), np.full(2, 1e3)
    reached, norm = descend_norm(landscape, x, limit, 30)
    assert norm < landscape.norm(x)[0]
    monkeypatch.setattr(
        Landscape, "heights", lambda self, x, cuts: (np.full(len(cuts.omega), -9.0), np.zeros((len(cuts.omega), 2)))
    )
    assert np.array_equal(descend_norm(landscape, reached, limit, 30)[0], reached)


def test_gains_that_leave_floats_are_not_stable():
    """For a point whose loop is not finite the norm is infinite, and so is the real part of its last pole."""
    plant = of_lists([[-1.0]], [[1.0]], [[1.0]], [[1.0]], [[1.0]])
    landscape = Landscape(plant.measured(np.eye(1)))
    for far in (np.inf, np.nan):
        assert landscape.norm(np.array([far]))[0] == np.inf
        assert landscape.abscissa(np.array([far]))[0] == np.inf


@pytest.mark.parametrize("worth", [2 * WORTH, WORTH / 2])
def test_a_doubling_of_the_gain_has_its_price(worth):
    """Where each doubling buys a share up to a gain of 8, the gain grows to 8 if that is worth it, and else not at all."""

    def lower(x, value, largest):
        size = min(largest, 8.0)
        return np.array([size]), (1 - worth) ** np.log2(size)

    x, value, refused = lower_by_growth(np.array([1.0]), 1.0, lower, lambda before, after: 1 - after / before)
    if worth > WORTH:
        assert (x[0], value, refused) == (8.0, pytest.approx((1 - worth) ** 3), None)
    else:
        assert (x[0], value, refused) == (1.0, 1.0, (pytest.approx(worth), 2.0))
