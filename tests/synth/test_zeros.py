"""Zeros in the right half plane: what they prove is what the best controllers come to, and nothing that is not true."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from models.common.errors import InputError
from synth.analysis.certificate import certify
from synth.analysis.lower_bounds.exact_algebra import radius_of_solution
from synth.analysis.lower_bounds.interpolation import limit_at_zeros, zero_limit
from synth.analysis.lower_bounds.lower_bound import LowerBound
from synth.analysis.record import read_proof, to_record
from synth.design.two_step import state_feedback
from synth.lmi.full_order_bound import find_lower_bound
from synth.plant.generalized import GeneralizedPlant
from tests.claims.test_lower_bound import full_order_norm
from tests.claims.test_no_controller_beats_a_bound import a_plant, in_other_units
from tests.support.commands import attacks

KIND = "as many of each"


def two_by_two() -> GeneralizedPlant:
    """z = w / (s + 2) + (1 - s) / (s + 1) u: a zero at 1 from u to z."""
    B, Bw, C = np.array([[0.0], [1.0]]), np.array([[1.0], [0.0]]), np.array([[1.0, 2.0]])
    return GeneralizedPlant(np.diag([-2.0, -1.0]), B, Bw, C, -np.eye(1), np.zeros((1, 1)))


def unstable() -> tuple[GeneralizedPlant, np.ndarray]:
    """One z, u, w and y: a zero at 1.5 from u to z, others at 0.7 and 4 from w to y, and two unstable poles."""
    A = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [-2.0, 0.5, 1.3, 1.7]])
    C = np.array([[-3.9, 1.1, 1.0, 0.0]])  # (s - 1.5) (s + 2.6)
    Cy = np.array([[2.8, -4.7, 1.0, 0.0]])  # (s - 0.7) (s - 4)
    one = np.eye(4)[:, 3:]
    return GeneralizedPlant(A, one, one, C, np.zeros((1, 1)), np.zeros((1, 1))), Cy


def test_a_zero_by_hand():
    """At the zero u does nothing: the norm is at least that of 1 / (s + 2) there, a third, whatever the controller and units."""
    plant = two_by_two()
    _, (of_z, of_y) = zero_limit(plant)
    for unit in (1.0, 2.0**-30, 2.0**30):
        of_unit = replace(plant, C=unit * plant.C, D=unit * plant.D)
        assert zero_limit(of_unit)[0] == pytest.approx(unit / 3, rel=1e-8)  # SHORT
        assert zero_limit(of_unit)[0] < unit / 3
    assert of_z == (pytest.approx(1.0, abs=1e-12),)
    assert of_y == ()


def test_a_zero_of_more_outputs_or_of_forces_that_do_nothing():
    """A second z counts with its answer at the zero, by hand; a force into a state that z never sees changes nothing."""
    plant = two_by_two()
    C, D = np.vstack([plant.C, [[1.0, 0.0]]]), np.vstack([plant.D, [[0.0]]])  # 1 / (s + 2) again
    taller = GeneralizedPlant(plant.A, plant.B, plant.Bw, C, D, np.zeros((2, 1)))
    assert zero_limit(taller)[0] == pytest.approx(2**0.5 / 3, rel=1e-8)  # SHORT
    A, B = np.diag([*np.diag(plant.A), 0.0]), np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    C, D = np.hstack([plant.C, [[0.0]]]), np.hstack([plant.D, [[0.0]]])
    wider = GeneralizedPlant(A, B, np.vstack([plant.Bw, [[1.0]]]), C, D, np.zeros((1, 1)))
    assert zero_limit(wider)[0] == pytest.approx(1 / 3, rel=1e-8)  # its pencil has no rank anywhere
    eye = np.eye(2)
    assert zero_limit(GeneralizedPlant(-eye, eye, eye, eye, eye, 0 * eye))[0] == 0  # a zero at -2


@pytest.mark.parametrize("seed", [0, 1, 2, 6])
def test_zeros_are_all_there_is_to_state_feedback(seed):
    """For as many forces as outputs, each weighed, the zeros from u to z prove the optimum of (22): by quite another route."""
    rng = np.random.default_rng([3, seed])
    n, m = int(rng.integers(2, 6)), int(rng.integers(1, 3))
    A, B, C, D = rng.standard_normal((n, n)), rng.standard_normal((n, m)), rng.standard_normal((m, n)), np.eye(m)
    zeros = np.linalg.eigvals(A - B @ C)
    plant = GeneralizedPlant(A, B, rng.standard_normal((n, 2)), C, D, np.zeros((m, 2)))
    assert np.any(zeros.real > 0), "another seed"
    gamma, _ = zero_limit(plant)
    best = state_feedback(plant, 1e-8)[-1].gamma
    assert gamma <= best
    assert gamma == pytest.approx(best, rel=2e-6)  # (2 n + d) mu / 2, and the second of SHORT


def test_zeros_of_both_kinds_are_all_there_is_to_output_feedback():
    """For one z, u, w, y the zeros of both kinds prove what central controllers of full order come to; either alone much less."""
    plant, Cy = unstable()
    gamma, (of_z, of_y) = zero_limit(plant.measured(Cy))
    assert limit_at_zeros(plant.measured(Cy), (of_z, of_y)) == gamma  # to the last bit: so says a record
    assert len(of_z) == 1
    assert len(of_y) == 2
    alone = [limit_at_zeros(plant.measured(Cy), some) for some in ((of_z, ()), ((), of_y))]
    assert max(alone) < 0.5 * gamma
    assert find_lower_bound(plant, Cy).gamma == gamma  # stable zeros leave the dual no point inside
    reached = []
    for small in (1e-3, 1e-4):  # of the force's weight, and of the noise: without either there is no such controller
        wider = GeneralizedPlant(
            plant.A, plant.B / small, plant.Bw, np.vstack([plant.C, np.zeros((1, 4))]), np.array([[0.0], [1.0]]), np.zeros((2, 1))
        )
        for factor in (1.02, 1.05, 1.08, 1.1, 1.3):
            try:
                reached.append(full_order_norm(wider, Cy, factor * gamma, small))
            except (np.linalg.LinAlgError, ValueError):
                continue
    assert gamma < min(reached) < 1.1 * gamma  # the price of the weight and the noise; with less rounding leaves no controller


def test_what_every_zero_says_alike_is_the_norm():
    """z = 0.7 w + (1 - s) / (s + 1) u, y = (2 - s) / ((s + 3) (s + 4)) w: u = 0 gives 0.7, and zeros of both kinds prove it."""
    plant = GeneralizedPlant(
        np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -12.0, -7.0]]),
        np.array([[1.0], [0.0], [0.0]]),
        np.array([[0.0], [0.0], [1.0]]),
        np.array([[2.0, 0.0, 0.0]]),
        -np.eye(1),
        np.array([[0.7]]),
    )
    Cy = np.array([[0.0, 2.0, -1.0]])
    left, right = (1 + 0j,), (2 + 0j,)
    for which in ((left, right), (left, ()), ((), right)):
        gamma = limit_at_zeros(plant.measured(Cy), which)
        assert gamma < 0.7
        assert gamma == pytest.approx(0.7, rel=2e-6)  # the second of SHORT


@pytest.mark.parametrize("seed", [0, 3, *attacks([1, 2, *range(4, 12)])])
def test_what_points_prove_is_no_more(seed):
    """Whatever points are named as zeros, none proves more than the zeros do where all are there, in any units."""
    plant, Cy = a_plant(KIND, seed)
    gamma, zeros = zero_limit(plant.measured(Cy))
    moved, Cy_moved = in_other_units(plant, Cy, seed)
    assert zero_limit(moved.measured(Cy_moved))[0] == pytest.approx(gamma, rel=1e-6)  # two of SHORT
    best = find_lower_bound(plant, Cy).gamma
    assert best >= gamma
    rng = np.random.default_rng(seed)
    for _ in range(5):
        some = [complex(a, b) for a, b in rng.standard_normal((4, 2)) * 10.0 ** rng.integers(-3, 4)]
        assert limit_at_zeros(plant.measured(Cy), (some[:2], some[2:])) <= best * (1 + 1e-6)
    for bad in (0j, complex(np.inf), complex(np.nan, 1), 1e300 + 0j):
        assert limit_at_zeros(plant.measured(Cy), ((bad, *zeros[0]), (*zeros[1], bad))) <= best * (1 + 1e-6)


def test_a_solution_is_enclosed_just_where_the_worst_equation_has_one():
    """x = e + c x + k x^2 / 2, the worst of its kind, settles from 0 within the radius, and nowhere if there is none."""
    rng = np.random.default_rng(0)
    c, share = rng.uniform(0, 0.6, 1000), rng.choice([1e-6, 0.5, 0.99, 1.01, 1.5, 3.0], 1000)
    e = 10 ** rng.uniform(-12, 3, 1000)
    k = share * (1 - c) ** 2 / (2 * e)  # a tangent at a share of 1
    x = before = np.zeros(1000)
    with np.errstate(all="ignore"):
        for _ in range(1000):
            x, before = e + c * x + k * x**2 / 2, x
    settled = np.isfinite(x) & (x <= before * (1 + 1e-6))
    assert 300 < settled.sum() < 700
    for i in range(1000):
        radius = radius_of_solution(float(e[i]), float(c[i]), float(k[i]))
        assert (radius is not None) == (settled[i] and c[i] < 0.5)
        assert radius is None or x[i] <= radius
    for nothing in ((1e-9, 1.0, 1.0), (np.nan, 0.0, 1.0), (1e-9, np.nan, 1.0), (1e-9, 0.0, np.nan)):
        assert radius_of_solution(*nothing) is None


def test_a_zero_that_is_not_one_is_not_enclosed():
    """Left of the axis, on it, double, or everywhere: no bound comes of it."""
    for zero in (-1.0, 0.0):
        A, B = np.array([[0.0, 1.0], [-2.0, -3.0]]), np.array([[0.0], [1.0]])
        plant = GeneralizedPlant(A, B, np.eye(2), np.array([[-zero, 1.0]]), np.zeros((1, 1)), np.zeros((1, 2)))
        assert limit_at_zeros(plant, ((complex(zero),), ())) == 0
    one, none = np.ones((1, 2)), np.zeros((2, 1))
    everywhere = GeneralizedPlant(np.diag([1.0, 2.0]), none, np.eye(2), one, np.zeros((1, 1)), np.zeros((1, 2)))
    assert limit_at_zeros(everywhere, ((1 + 0j,), ())) == 0
    A, C = linalg.companion(np.poly([1.0, 1.0, -1.0])), np.array([[1.0, 2.0, 3.0]])  # A are its zeros, where D = 1
    B = np.eye(3)[:, :1]
    plant = GeneralizedPlant(A + B @ C, B, np.eye(3), C, np.eye(1), np.zeros((1, 3)))
    assert limit_at_zeros(plant, ((1 + 0j,), ())) <= state_feedback(plant, 1e-7)[-1].gamma


def test_the_record_of_zeros():
    """A record of a bound by zeros is confirmed from the zeros alone, and one that claims more is not."""
    plant, Cy = unstable()
    plant = plant.measured(Cy)
    gamma, zeros = zero_limit(plant)
    certificate = certify(plant, np.zeros((1, 4)), lower_bound=LowerBound(gamma, zeros=zeros))
    record = to_record(certificate)
    assert record["zeros"] == [[[zero.real, zero.imag] for zero in kind] for kind in zeros]
    assert read_proof(record, plant)[2].gamma == gamma
    for change in ([], [[1.0, 2.0]], [[[1.0]], []], [[["x", 0]], []], [[[float("nan"), 0]], []], 3):
        with pytest.raises(InputError, match="zeros"):
            read_proof({**record, "zeros": change}, plant)
    assert read_proof({**record, "zeros": [[[99.0, 0.0]], []]}, plant)[2].gamma < gamma
