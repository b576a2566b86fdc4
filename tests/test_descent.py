"""The descent of static gains: never worse than its parts, always proved, and at home in narrow valleys."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from scipy import linalg

from synth.analysis.bounding import certify_tightly
from synth.analysis.certificate import certify
from synth.design.descent import starts as sampling
from synth.design.descent import symmetry
from synth.design.descent.coordinates import balanced_coordinates
from synth.design.descent.landscape import Landscape
from synth.design.descent.minimax import along_edges, lowest_point
from synth.design.descent.refine import refine
from synth.design.descent.starts import CLOSER, lowest, projected_starts, survey
from synth.design.descent.symmetry import Symmetry
from synth.design.static import WORTH, Candidate, GainSearch, static_output_feedback
from synth.design.two_step import two_step_design
from synth.lmi.full_order_bound import find_lower_bound
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError
from tests.benchmarks.states import chain
from tests.commands import attacks
from tests.shared import nothing_shared
from tests.test_bounds_hold import of_lists
from tests.test_static import random_plant

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


def integrator_with_leak() -> tuple[GainSearch, Callable[[float], Candidate]]:
    """The search for x' = -x + u + w, y = z = x, whose norm is 1 / (1 - k), and its candidate at k."""
    one = np.eye(1)
    search = GainSearch(GeneralizedPlant(-one, one, one, one, 0 * one, 0 * one), one, LARGEST, 0.0)
    return search, lambda k: Candidate(np.array([k]), 1 / (1 - k), str(k))


def test_what_still_falls_stays_in_the_race():
    """A heat keeps the best, whatever fell below half of its norm in it, and one of those at the same minimum."""
    search, at = integrator_with_leak()
    led = {-20.0: -20.0, -10.0: -10.0, -9.0: -10.0, 0.0: -4.0, -1.0: -2.0}
    kept = search.heat([at(k) for k in led], lambda x, _: np.array([led[float(x[0])]]), 1, keep=1)
    assert [float(each.x[0]) for each in kept] == [-20.0, -4.0]  # 0 came to a fifth of its norm, -1 to two thirds
    kept = search.heat([at(k) for k in led], lambda x, _: np.array([led[float(x[0])]]), 1, keep=5)
    assert [float(each.x[0]) for each in kept] == [-20.0, -10.0, -4.0, -2.0]


def test_a_heat_ends_where_nothing_is_left():
    """Once one candidate is at what no controller beats, no other is looked at."""
    search, at = integrator_with_leak()
    search.beaten_by_none = 1 / 11
    asked = []

    def down(x: np.ndarray, _: int) -> np.ndarray:
        asked.append(float(x[0]))
        return np.array([-10.0])

    kept = search.heat([at(-1.0), at(-2.0), at(-3.0)], down, 1, keep=3)
    assert asked == [-3.0]
    assert [float(each.x[0]) for each in kept] == [-10.0]


def test_long_valley_is_followed_to_its_end(monkeypatch):
    """A candidate is followed as long as a turn of both descents gains WORTH, and no longer."""
    search, at = integrator_with_leak()
    monkeypatch.setattr(search, "edges", lambda x, _: np.maximum(x - 1, -107.0))
    monkeypatch.setattr(search, "whitened", lambda x, _: x)
    assert search.followed(at(-100.0)).norm == pytest.approx(1 / 108)  # by a hundredth at a time
    turns = []
    monkeypatch.setattr(search, "edges", lambda x, _: turns.append(x) or x * (1 + 0.5 * WORTH))
    search.followed(at(-100.0))
    assert len(turns) == 1


@pytest.mark.attack
def test_same_gain_again():
    """The same plant gives the same gain, to the last bit."""
    plant, Cy = random_plant(3, n=3, m=1)
    with nothing_shared():
        np.testing.assert_array_equal(static_output_feedback(plant, Cy).gain, static_output_feedback(plant, Cy).gain)


def test_gains_that_make_the_same_loop():
    """The unit of a controller's memory changes the gain, not the norm; the smallest of these gains is found from any of them."""
    plant, Cy = follower()
    landscape = Landscape(plant, Cy)
    alike = Symmetry(landscape)
    sizes = []
    for unit in (1e-3, 1.0, 1e3):
        K = lead(1e3, 10.0, 100.0) * np.outer([1.0, unit], [1.0, 1.0, 1 / unit])
        found = alike.smallest(landscape.point(K))
        assert landscape.norm(found)[0] == pytest.approx(landscape.norm(landscape.point(K))[0], rel=1e-9)  # what it accepts
        sizes.append(np.abs(landscape.gain(found)).max())
    np.testing.assert_allclose(sizes, 1e3, rtol=1e-3)  # its stiffness, which no unit changes
    other, its_Cy = random_plant(0)
    point = np.ones(4)
    np.testing.assert_array_equal(Symmetry(Landscape(other, its_Cy)).smallest(point), point)


@pytest.mark.parametrize(("wide", "small"), [(1, 16), (2, 0), *attacks([(0, 16), (0, 0), (1, 0), (2, 16)])])
def test_all_gains_that_make_the_same_loop_are_known(monkeypatch, wide, small):
    """R and S of the reduced equations span what the null space of all n^2 + m^2 + q^2 unknowns does; 60 states take no time."""
    monkeypatch.setattr(symmetry, "SMALL", small)
    plant, Cy = follower() if small else random_plant(0, n=4, m=2)
    own = 1 if small else 0  # the unit of the follower's memory
    rng = np.random.default_rng(wide)
    k, n = wide, len(plant.A) + wide  # states that z does not see and w does not drive, measured
    T = rng.standard_normal((n, n))
    plant = GeneralizedPlant(
        np.block([[plant.A, np.zeros((n - k, k))], [np.zeros((k, n - k)), -3.0 * np.eye(k)]]),
        np.vstack([plant.B, np.zeros((k, 2))]),
        np.vstack([plant.Bw, np.zeros((k, plant.Bw.shape[1]))]),
        np.hstack([plant.C, np.zeros((len(plant.C), k))]),
        plant.D,
        plant.Dw,
    ).in_coordinates(T)
    Cy = np.asarray(linalg.block_diag(Cy, np.eye(k))) @ T
    landscape = Landscape(plant, Cy)
    found = Symmetry(landscape)
    A, B, Cy, C, Bw = (
        each / np.linalg.norm(each, 2) for each in (landscape.A, landscape.B, landscape.Cy, landscape.C, landscape.Bw)
    )
    m, q, one = 2, len(Cy), np.eye
    of_T = np.vstack(
        [
            np.kron(one(n), A.T) - np.kron(A, one(n)),
            np.kron(one(n), B.T),
            np.kron(Cy, one(n)),
            np.kron(C, one(n)),
            np.kron(one(n), Bw.T),
        ]
    )
    of_R, of_S = np.zeros((len(of_T), m * m)), np.zeros((len(of_T), q * q))
    of_R[n * n : n * (n + m)], of_S[n * (n + m) : n * (n + m + q)] = -np.kron(B, one(m)), -np.kron(one(q), Cy.T)
    expected = linalg.null_space(np.hstack([of_T, of_R, of_S]), 1e-10)[n * n :].T
    spanned = np.hstack([found.R.reshape(len(found.R), m * m), found.S.reshape(len(found.S), q * q)])
    assert len(spanned) == len(expected) == own + wide**2
    projected = [each.T @ np.linalg.pinv(each.T) for each in (spanned, expected)]
    np.testing.assert_allclose(projected[0], projected[1], atol=1e-8)  # rounding of null spaces of random coordinates
    assert not len(Symmetry(Landscape(*chain(60))).R)


def test_samples_of_large_plants_cost_no_more(monkeypatch):
    """Up to 30 states a decade has 1000 samples; with more the poles of all cost what they do there, and 20 are always drawn."""
    drawn = {}
    monkeypatch.setattr(sampling, "lowest", lambda landscape, points: drawn.setdefault(len(landscape.A), len(points)) and None)
    for states in (4, 30, 60, 200):
        landscape = Landscape(*chain(states))
        assert sampling.around(landscape, np.ones(landscape.scale.size), np.ones(landscape.scale.size), 0.1, 0) is None
        assert survey(landscape, np.full(landscape.scale.size, 1e3)) == []
    assert drawn == {4: 1000, 30: 1000, 60: 125, 200: 20}


def covariance(A, B, C) -> np.ndarray:
    """Returns the covariance of C x, where white noise drives x' = A x + B v: the integral of its density over frequency."""
    frequencies = np.concatenate([-np.geomspace(1e-7, 1e5, 20001)[::-1], np.geomspace(1e-7, 1e5, 20001)])
    answers = np.array([C @ np.linalg.solve(1j * w * np.eye(len(A)) - A, B) for w in frequencies])
    return np.trapezoid(np.real(answers @ answers.conj().transpose(0, 2, 1)), frequencies, axis=0) / (2 * np.pi)


@pytest.mark.attack
def test_directions_count_alike():
    """In the coordinates that `alike` gives, every direction of the gain feeds as much power from w to z, and no two the same."""
    plant, Cy = follower()
    landscape = Landscape(plant, Cy)
    x = landscape.point(lead(1e3, 10.0, 100.0))
    A, C = landscape.loop(x)
    measured, forced = covariance(A, landscape.Bw, landscape.Cy), covariance(A.T, C.T, landscape.B.T)
    changes = balanced_coordinates(landscape, x).T.reshape(6, 2, 3) * landscape.scale
    power = np.array([[np.trace(one.T @ forced @ other @ measured) for other in changes] for one in changes])
    np.testing.assert_allclose(power / power[0, 0], np.eye(6), atol=0.02)  # the trapezoids over twelve decades, the ends cut off


def test_the_bound_counts_where_gains_are_smallest():
    """A largest entry that is the same in all gains that are alike does not keep the others from being made smaller."""
    plant, Cy = follower()
    landscape = Landscape(plant, Cy)
    K = lead(1e3, 10.0, 1e4) * np.outer([1.0, 3.0], [1.0, 1.0, 1 / 3.0])  # the memory's own rate, 1e4, is the same in every unit
    found = landscape.gain(Symmetry(landscape).smallest(landscape.point(K)))
    assert np.abs(found).max() == pytest.approx(1e4, rel=1e-9)
    assert np.sum(found**2) < 0.9 * np.sum(K**2)  # measured 0.63


def test_samples_are_stable():
    """Every sample that the search starts from makes a stable loop, within the bound."""
    plant, Cy = random_plant(0)
    landscape = Landscape(plant, Cy)
    limit = landscape.point(np.full(landscape.shape, 1e3))
    samples = survey(landscape, limit)
    assert len(samples) >= 3
    for x in samples:
        assert np.linalg.eigvals(landscape.loop(x)[0]).real.max() < 0
        assert np.all(np.abs(x) <= limit)


def test_lowest_of_the_first_stable_samples():
    """For many points the one with the smallest norm of the first 24 stable ones, however rare those are."""
    plant, Cy = random_plant(0)
    landscape = Landscape(plant, Cy)
    for seed, size in ((0, 1.0), (1, 0.2)):
        points = size * np.random.default_rng(seed).standard_normal((400, 4))
        stable = [x for x in points if np.linalg.eigvals(landscape.loop(x)[0]).real.max() < 0][:CLOSER]
        found = lowest(landscape, points)
        assert stable
        assert found is not None
        np.testing.assert_array_equal(found, min(stable, key=lambda x: landscape.norm(x)[0]))


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


@pytest.mark.parametrize("states", [20, 60])
def test_projected_starts_are_good(states):
    """On a chain of masses they are stable, within a third of the best gain known; u = 0 is more than five times as high."""
    plant, Cy = chain(states)
    landscape = Landscape(plant, Cy)
    norms = [landscape.norm(x)[0] for x in projected_starts(landscape)]
    best_known = {20: 1.70, 60: 1.376}[states]  # by the two steps, and by descent
    assert min(norms) < 4 / 3 * best_known
    assert landscape.norm(np.zeros(Cy.shape[0]))[0] > 5 * best_known


def test_projected_starts_of_states_that_are_all_measured():
    """For x' = u - x, z = x and y = x they are the optimal gains 1 - sqrt(2 + 1 / r) where u^2 costs a share r of x^2, too."""
    one, none = np.eye(1), np.zeros((1, 1))
    landscape = Landscape(GeneralizedPlant(-one, one, one, one, none, none), one)
    for x, r in zip(projected_starts(landscape), (1e-8, 1e-4, 1e-2), strict=True):
        # x^2 costs 1 + r, so that 2 p + p^2 / r = 1 + r, and u = -p / r x.
        assert landscape.gain(x)[0, 0] == pytest.approx(1 - (2 + 1 / r) ** 0.5, rel=1e-9)  # rounding of the Riccati equation


# --- its steps --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [0, 1])
def test_a_model_without_a_cut_has_no_lowest_point(count):
    """No cut at all, as where rounding leaves none that comes near the norm, or one that is not finite."""
    one = np.eye(2)
    with pytest.raises(np.linalg.LinAlgError):
        lowest_point(np.full(count, np.nan), np.zeros((count, 2)), one, one, np.zeros(2), np.ones(2))


def test_a_descent_ends_where_rounding_leaves_no_model(monkeypatch):
    """A descent without a model stays where it is, and its norm is the one that it had: what was reached is never lost."""
    plant = of_lists([[-1, 1], [0, -2]], [[0], [1]], [[1], [1]], [[1, 0], [0, 0]], [[0], [0.1]])
    landscape = Landscape(plant, np.eye(2))
    x, limit = np.zeros(2), np.full(2, 1e3)
    reached, norm = along_edges(landscape, x, limit, 30)
    assert norm < landscape.norm(x)[0]
    monkeypatch.setattr(
        Landscape, "heights", lambda self, x, cuts: (np.full(len(cuts.omega), -9.0), np.zeros((len(cuts.omega), 2)))
    )
    assert np.array_equal(along_edges(landscape, reached, limit, 30)[0], reached)


def test_gains_that_leave_floats_are_not_stable():
    """For a point whose loop is not finite the norm is infinite, and so is the real part of its last pole."""
    plant = of_lists([[-1.0]], [[1.0]], [[1.0]], [[1.0]], [[1.0]])
    landscape = Landscape(plant, np.eye(1))
    for far in (np.inf, np.nan):
        assert landscape.norm(np.array([far]))[0] == np.inf
        assert landscape.abscissa(np.array([far]))[0] == np.inf


@pytest.mark.parametrize(("force", "reading"), [(8.0, 1.0), (1.0, 8.0)])
def test_steps_of_a_search_do_not_depend_on_units(force, reading):
    """If forces or readings have another unit, a search's coordinates are the same gains, also where a reading is a force."""
    plant = of_lists([[-1, 2], [0, -3]], [[0], [5]], [[1], [1]], [[1, 0]], [[0]])
    Cy, through = np.diag([1.0, 0.0]), np.array([[0.0], [1.0]])
    own = Landscape(plant, Cy, through=through)
    other = Landscape(
        dataclasses.replace(plant, B=plant.B * force, D=plant.D * force), reading * Cy, None, force * reading * through
    )
    assert other.scale * force * reading == pytest.approx(own.scale, rel=1e-12)
    assert own.scale[0, 1] == pytest.approx(1.0)  # a force that is read is as large as one that acts


def test_a_norm_of_zero_has_its_smallest_gain():
    """If w does not reach z the norms of all gains that are alike are zero, and the smallest of them is found as elsewhere."""
    plant = of_lists([[-1, 0], [0, -1]], [[1, 0], [0, 1]], [[1], [0]], [[0, 0]], [[0, 0]])
    landscape = Landscape(plant, np.eye(2))
    assert landscape.norm(np.zeros(4))[0] == 0
    x = np.array([-1.0, 0.0, 0.0, -1.0])
    assert np.all(np.isfinite(Symmetry(landscape).smallest(x)))
