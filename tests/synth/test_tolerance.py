"""Worst norms of laws whose readings and forces are off: what is met, and what is proved of the whole box."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from models.common.arrays import Array
from models.laws.linear import LinearLaw
from models.vehicle.vehicle import read_vehicle
from synth.analysis.certificate import eta_of
from synth.analysis.norm import hinf_norm
from synth.analysis.uncertainty_box import BoxProof, lmi, proves
from synth.design.uncertainty.problem import box_of, scaled_gain
from synth.design.uncertainty.worst_case import WorstCaseNormFunction, WorstNorm, norm_at, worst_norm
from synth.plant.generalized import GeneralizedPlant
from synth.vehicle.designer import Designer
from tests.support.commands import in_the_suite, refused

PRINTED_I = np.array([[10824.0, -2071.0]])
MINIMAX_I = np.array([[4915.0, -7715.0]])
CLOSE = 1.01e-4  # relative; bounds are tried a ten-thousandth above the largest norm met, and rounded
Car = tuple[GeneralizedPlant, Array]


@pytest.fixture(scope="module")
def car() -> Car:
    """The quarter-car's plant and what controller I measures of it."""
    problem = Designer(read_vehicle("quarter_car")).problem(("suspension_deflection", "sprung_velocity"))
    return problem.plant.unmeasured, problem.plant.Cy


@pytest.mark.parametrize(
    ("gain", "delta", "found", "at_most"),
    [
        (PRINTED_I, 0.0, 7.84319, 7.844),  # by SLICOT
        (PRINTED_I, 0.1, 7.8676, 7.8686),
        (PRINTED_I, 0.2, 29.3623, 29.98),
        (MINIMAX_I, 0.2, 7.8677, 7.871),
    ],
)
def test_the_paper_s_car(car: Car, gain, delta, found, at_most):
    """Controller I, printed, and the gain of least worst norm: with both readings off, the worst norm found and a bound above."""
    worst = worst_norm(*car, gain, delta)
    assert worst.found == pytest.approx(found, abs=5e-5)  # as many digits as are written here; vertices by another program
    assert worst.found <= worst.proved <= at_most  # bounds with one X by an LMI solver
    assert worst.gap <= CLOSE


def test_where_it_is_unstable(car: Car):
    """Printed controller I is unstable with its deflection read 21.1 % too large: the errors say so, and no bound is proved."""
    worst = worst_norm(*car, PRINTED_I, np.array([0.211, 0.0]))
    assert worst.unstable
    assert worst.proof is None
    assert np.isinf(worst.proved)
    assert worst.readings == pytest.approx([0.211, 0.0], abs=1e-15)  # a corner, to rounding
    assert not worst_norm(*car, PRINTED_I, np.array([0.2099, 0.0])).unstable


def _plant(seed: int, n: int, m: int, q: int, dt: float | None = None):
    """A random plant in odd units whose loop with its gain is stable; of an odd seed, with noise in what is measured."""
    generator = np.random.default_rng(seed)
    d, r = generator.integers(1, 4, 2)
    A = generator.standard_normal((n, n))
    B, Bw, C = generator.standard_normal((n, m)), generator.standard_normal((n, r)), generator.standard_normal((d, n))
    D, Dw = generator.standard_normal((d, m)), generator.standard_normal((d, r)) * (seed % 3 == 0)
    Cy, K = generator.standard_normal((q, n)), generator.standard_normal((m, q))
    loop = A + B @ K @ Cy
    if dt is None:
        A = A - (np.linalg.eigvals(loop).real.max() + generator.uniform(0.05, 1)) * np.eye(n)
    else:
        factor = generator.uniform(0.5, 0.95) / np.abs(np.linalg.eigvals(loop)).max()
        A, B = A * factor, B * factor
    units, forces, rows = (10.0 ** generator.uniform(-4, 4, k) for k in (n, m, q))
    A, B, Bw, C = A / units[:, None] * units, B / units[:, None] * forces, Bw / units[:, None], C * units
    plant = GeneralizedPlant(A, B, Bw, C, D * forces, Dw, dt=dt)
    Dyw = 0.1 * generator.standard_normal((q, r)) * rows[:, None] if seed % 2 else None
    return plant, Cy * units * rows[:, None], K / forces[:, None] / rows, Dyw, generator


def _law_with_states(K, generator) -> LinearLaw:
    """A gain behind a lag of its own, which is a law of two states."""
    own = generator.standard_normal((2, K.shape[1])) / np.linalg.norm(K, axis=0)
    return LinearLaw(-np.diag([3.0, 40.0]), own * np.abs(K).max(), 0.3 * K @ np.linalg.pinv(own) / np.abs(K).max(), 0.7 * K)


def _sampled(worst: WorstNorm, loop, count, generator, d, e) -> None:
    """Norms of laws with random errors, at the ends of the box as often as within, none of which may exceed what is proved."""
    for _ in range(count):
        a, b = (np.clip(generator.uniform(-1.5, 1.5, len(width)), -1, 1) * width for width in (d, e))
        assert loop(1 + a, 1 + b) <= worst.proved


@pytest.mark.parametrize("seed", in_the_suite((0, 1, 200), (*range(6), 200, 201, 1001, 1003)))
def test_nothing_in_the_box_exceeds_what_is_proved(seed):
    """For random plants in odd units, with noise or without, continuous or discrete: the loop with any errors stays below the
    bound, by a norm that is computed from the plant and the scaled gain alone; if a measurement has the force in it, too."""
    forces = 1 if seed >= 200 and seed < 1000 else 1 + seed % 2
    plant, Cy, K, Dyw, generator = _plant(seed, 3 + seed % 3, forces, 2, 0.1 if seed % 4 == 3 else None)
    through = np.array([[0.3], [0.0]]) / K[0, 0] if 200 <= seed < 1000 else np.zeros((2, forces))
    d, e = generator.uniform(0.0, 0.1, 2), generator.uniform(0.0, 0.1, len(K)) * (seed % 3 > 0)
    worst = worst_norm(plant, Cy, K, d, e, Dyw, through)

    def loop(readings, forces) -> float:
        scaled = forces[:, None] * K * readings
        gain = np.linalg.solve(np.eye(len(K)) - scaled @ through, scaled)
        noise = np.zeros((len(Cy), plant.Bw.shape[1])) if Dyw is None else Dyw
        moved = replace(plant, Bw=plant.Bw + plant.B @ gain @ noise, Dw=plant.Dw + plant.D @ gain @ noise)
        return hinf_norm(moved.closed_loop(gain @ Cy)).value

    at = loop(1 + worst.readings, 1 + worst.forces)
    if worst.unstable:
        assert np.isinf(at)  # with the errors that it names
        return
    assert at == pytest.approx(worst.found, rel=1e-8)  # two ways to close one loop, in units eight decades apart
    assert worst.found <= worst.proved
    gain = scaled_gain(plant.measured(Cy, Dyw, through), K)
    assert worst.proof is None or worst.proof.holds(gain, box_of(gain, d, e))
    _sampled(worst, loop, 40, generator, d, e)


@pytest.mark.parametrize("seed", in_the_suite((0, 3), range(4)))
def test_a_law_with_states_stands_between_its_errors(seed):
    """For a law with states the readings and the forces are off, not its states: its scaled matrices say what its norm is."""
    plant, Cy, K, Dyw, generator = _plant(100 + seed, 3, 1 + seed % 2, 2)
    law = _law_with_states(K, generator)
    d, e = np.full(2, 0.08), np.full(len(K), 0.05)
    worst = worst_norm(plant, Cy, law, d, e, Dyw)

    def loop(readings, forces) -> float:
        off = LinearLaw(law.A, law.B * readings, forces[:, None] * law.C, forces[:, None] * law.D * readings)
        gain = scaled_gain(plant.measured(Cy, Dyw), off)
        return norm_at(gain, np.ones(sum(gain.K.shape)))

    same = replace(law, B=law.B * (1 + d), D=law.D * (1 + d)).scaled(1 + e)
    for found, expected in ((same.B, law.B * (1 + d)), (same.C, law.C * (1 + e[0])), (same.D, law.D * (1 + d) * (1 + e[0]))):
        np.testing.assert_allclose(found, expected, rtol=1e-12)  # of products in another order
    assert worst.unstable == np.isinf(loop(1 + worst.readings, 1 + worst.forces))
    if not worst.unstable:
        assert loop(1 + worst.readings, 1 + worst.forces) == pytest.approx(worst.found, rel=1e-8)  # the same loop, rounded twice
        _sampled(worst, loop, 30, generator, d, e)


def test_a_maximum_inside_is_found():
    """A spring whose stiffness is fed back, behind a filter: the norm peaks where both resonate alike, between corners. One X
    proves nothing close in so wide a box; multipliers do, and the proof names them."""
    A = np.array([[0.0, 1.0, 0.0, 0.0], [-0.5, -0.2, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, -1.0, -0.2]])
    B, Bw = np.array([[0.0], [1.0], [0.0], [0.0]]), np.array([[0.0], [0.0], [0.0], [1.0]])
    C = np.array([[1.0, 0.0, 0.0, 0.0]])
    plant, K = GeneralizedPlant(A, B, Bw, C, np.zeros((1, 1)), np.zeros((1, 1))), np.array([[-0.5]])
    line = [hinf_norm(plant.closed_loop((1 + a) * K @ C)).value for a in np.linspace(-0.6, 0.6, 121)]
    assert max(line) > 1.1 * max(line[0], line[-1])  # or this is no such plant
    worst = worst_norm(plant, C, K, 0.6)
    assert max(line) <= worst.found <= max(line) * (1 + 1e-4)  # the line has steps of 1e-2 about a flat top
    assert worst.found <= worst.proved <= worst.found * (1 + 3.1e-4)
    assert worst.proof is not None
    assert worst.proof.kind == "multipliers, computed twice"


def test_a_proof_is_of_its_box_and_its_bound(car: Car):
    """A proof holds for its box; not for a lower bound, a larger box, another gain, nor with a part or half of one missing."""
    gain = scaled_gain(car[0].measured(car[1]), PRINTED_I)
    box = box_of(gain, 0.2, 0.0)
    proof = worst_norm(*car, PRINTED_I, 0.2).proof
    assert isinstance(proof, BoxProof)
    assert len(proof.parts) == 2
    assert proof.holds(gain, box)
    assert not replace(proof, eta=eta_of(29.3)).holds(gain, box)  # below the norm at a corner
    assert not proof.holds(gain, box_of(gain, 0.2001, 0.0))
    assert not proof.holds(scaled_gain(car[0].measured(car[1]), 1.01 * PRINTED_I), box)
    assert not replace(proof, parts=proof.parts[1:]).holds(gain, box)
    first, X = proof.parts[0]
    axis = int(first.uncertain[0])
    assert not replace(proof, parts=[(first.bisect(axis)[0], X), *proof.parts[1:]]).holds(gain, box)
    assert not BoxProof(proof.eta, [(part, -X) for part, X in proof.parts]).holds(gain, box)


def _definite(M: list[list[Fraction]]) -> bool:
    """True if a symmetric matrix of rational numbers is positive definite: all pivots of its elimination are."""
    for k in range(len(M)):
        if not M[k][k] > 0:
            return False
        for i in range(k + 1, len(M)):
            factor = M[i][k] / M[k][k]
            M[i] = [x - factor * y for x, y in zip(M[i], M[k], strict=True)]
    return True


def test_an_exact_proof_holds_in_rational_numbers(car: Car):
    """At every corner of the parts of a box X > 0 and (20) < 0 without any rounding, from the plant's and the gain's numbers."""
    problem, (K,) = car[0].measured(car[1]), [[*map(Fraction, row)] for row in PRINTED_I.tolist()]
    proof = worst_norm(*car, PRINTED_I, 0.2).proof
    assert isinstance(proof, BoxProof)
    assert proof.kind == "common X, exact"
    exact = np.vectorize(Fraction, otypes=[object])
    A, B, Bw, C, D, Dw, Cy = (exact(getattr(problem, name)) for name in ("A", "B", "Bw", "C", "D", "Dw", "Cy"))
    W, eta = np.vstack([Bw, Dw]), Fraction(proof.eta)
    for part, X in proof.parts:
        assert _definite(exact(X).tolist())
        for corner in part.vertices:
            law = np.array([[k * f * exact(corner)[2] for k, f in zip(K, exact(corner), strict=False)]]) @ Cy
            left = np.vstack([A + B @ law, C + D @ law]) @ exact(X)
            F = eta * W @ W.T
            F[:, :4] += left
            F[:4] += left.T
            F[4:, 4:] -= exact(np.eye(len(C)))
            assert _definite((-F).tolist())


@pytest.mark.parametrize(
    ("K", "d", "e", "said"),
    [
        (PRINTED_I, -0.1, 0, "0 to 1"),
        (PRINTED_I, 1.1, 0, "0 to 1"),
        (PRINTED_I, [0.1] * 3, 0, "a single number for all, or 2"),
        (PRINTED_I, 0, [0, 0], "forces"),
    ],
)
def test_bad_tolerances(car: Car, K, d, e, said):
    """A tolerance that is none, or a gain for other signals, is refused in one line that says what is allowed."""
    with refused(match=said):
        worst_norm(*car, K, d, e)


def test_no_answer_inside_the_box_is_no_proof():
    """A force that comes back 0.95 times in its own reading comes back whole with an error of 5.3 %: nothing is proved there."""
    plant = GeneralizedPlant(-np.eye(1), np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)))
    Cy, K, through = np.array([[-1.0]]), np.array([[1.0]]), np.array([[0.95]])
    gain = scaled_gain(plant.measured(Cy, None, through), K)
    assert gain.well_posed(box_of(gain, 0.05, 0.0))
    assert not gain.well_posed(box_of(gain, 0.06, 0.0))
    near = worst_norm(plant, Cy, K, 0.05, 0.0, None, through)
    assert near.found <= near.proved < np.inf
    assert np.isinf(worst_norm(plant, Cy, K, 0.06, 0.0, None, through).proved)


def test_on_the_verge_is_no_proof():
    """X = 1 makes (20) singular for x' = -x + w, z = x, of norm 1: that proves nothing, a billionth above does.

    x' = x has an X below zero that satisfies (20): it proves nothing.
    """
    one = np.ones((1, 1))
    plant = GeneralizedPlant(-one, one, one, one, 0 * one, 0 * one)
    gain = scaled_gain(plant.measured(one), 0 * one)
    box = box_of(gain, 0.1, 0.0)
    assert not proves(gain, box, one, 1.0)
    assert proves(gain, box, one, eta_of(1 + 1e-9))
    unstable = scaled_gain(replace(plant, A=one).measured(one), 0.1 * one)
    box = box_of(unstable, 0.5, 0.0)
    assert np.linalg.eigvalsh(lmi(unstable.loops(box.vertices), -one, 1e-2)).max() < 0  # or this is no such X
    assert not proves(unstable, box, -one, 1e-2)


def test_a_discrete_plant_with_a_pole_at_minus_one():
    """If the plant is mapped under a gain of its own, errors are those of the gain, and not of that one."""
    plant = GeneralizedPlant(
        np.array([[-1.0, 0.2], [0.0, 0.5]]),
        np.array([[1.0], [0.5]]),
        np.array([[0.3], [1.0]]),
        np.eye(2),
        np.zeros((2, 1)),
        np.zeros((2, 1)),
        dt=0.1,
    )
    Cy, K = np.eye(2), np.array([[0.5, -0.1]])
    assert np.any(scaled_gain(plant.measured(Cy), K).before)  # or it is mapped as it is
    worst = worst_norm(plant, Cy, K, 0.2)
    assert hinf_norm(plant.closed_loop(K * (1 + worst.readings))).value == pytest.approx(worst.found, rel=1e-9)  # two ways
    generator = np.random.default_rng(0)
    _sampled(worst, lambda a, b: hinf_norm(plant.closed_loop(K * a)).value, 60, generator, np.full(2, 0.2), np.zeros(1))


def test_slopes_are_those_of_differences():
    """The slope that the search climbs by is that of the norm, with a force in a reading, noise, and two forces, too."""
    plant, Cy, K, Dyw, generator = _plant(301, 4, 2, 2)
    through = 0.2 * generator.standard_normal((2, 2)) / np.outer(np.abs(K).max(axis=0), np.abs(K).max(axis=1)) * np.abs(K).max()
    heights = WorstCaseNormFunction(scaled_gain(plant.measured(Cy, Dyw, through), K))
    at, step = 1 + generator.uniform(-0.02, 0.02, 4), 1e-6
    ends = [[heights.norm(at + sign * step * unit) for sign in (1, -1)] for unit in np.eye(4)]
    assert np.all(np.isfinite(ends))  # or there is no slope
    differences = np.array([(up - down) / (2 * step) for up, down in ends])
    assert heights.slope(at) == pytest.approx(differences, rel=1e-4, abs=1e-4 * np.abs(differences).max())  # of differences
