"""Lower bounds: proved by numpy, below every controller, close to the best one."""

from dataclasses import replace
from fractions import Fraction
from typing import Any

import control
import numpy as np
import pytest
from scipy import linalg

from models.vehicle.vehicle import read_vehicle
from synth.analysis.lower_bounds.exact_algebra import span_all
from synth.analysis.lower_bounds.interpolation import limit_at_zeros
from synth.analysis.lower_bounds.invariant_point import invariant_limit, limit_at, limit_at_infinity
from synth.analysis.lower_bounds.lower_bound import DualCertificate, LowerBound, prove_lower_bound
from synth.analysis.norm import hinf_norm
from synth.design.two_step import state_feedback
from synth.lmi import full_order_bound as full_order
from synth.lmi.full_order_bound import find_lower_bound
from synth.plant.generalized import GeneralizedPlant
from synth.vehicle.designer import Designer
from tests.synth.test_static import random_plant


def at_the_end(plant: GeneralizedPlant, mu: float = 1e-5) -> DualCertificate:
    point = state_feedback(plant, mu)[-1]
    return DualCertificate(point.X, point.eta)


def full_order_norm(plant: GeneralizedPlant, Cy: np.ndarray, gamma: float, noise: float) -> float:
    """The norm that the central full-order controller for gamma reaches, y = C_y x + noise (Doyle et al. 1989).

    For C' D = 0, D' D = I, Bw = [B1 0] and a noise of its own: the plants of `noisy`.
    """
    n, g2 = len(plant.A), gamma**-2
    X = linalg.solve_continuous_are(
        plant.A,
        np.hstack([plant.B, plant.Bw]),
        plant.C.T @ plant.C,
        np.diag([1.0] * plant.B.shape[1] + [-(gamma**2)] * plant.Bw.shape[1]),
    )
    Cn = Cy / noise
    Y = linalg.solve_continuous_are(
        plant.A.T, np.hstack([Cn.T, plant.C.T]), plant.Bw @ plant.Bw.T, np.diag([1.0] * len(Cn) + [-(gamma**2)] * len(plant.C))
    )
    F, L = -plant.B.T @ X, -Y @ Cn.T
    Z = np.linalg.inv(np.eye(n) - g2 * Y @ X)
    Ak = plant.A + g2 * plant.Bw @ plant.Bw.T @ X + plant.B @ F + Z @ L @ Cn
    A = np.block([[plant.A, plant.B @ F], [-Z @ L @ Cn, Ak]])
    Bw = np.vstack([plant.Bw, np.zeros((n, plant.Bw.shape[1]))])
    C = np.hstack([plant.C, plant.D @ F])
    loop = GeneralizedPlant(A, np.zeros((2 * n, 1)), Bw, C, np.zeros((len(C), 1)), plant.Dw)
    return hinf_norm(loop).value


@pytest.mark.parametrize("kind", ["quarter_car", "half_car", "full_car"])
def test_cars(kind):
    """A car's best state feedback reaches the invariant limit, which proves it to rounding; the dual proves it to 2e-4."""
    designer = Designer(read_vehicle(kind))
    best, found = designer.state_feedback.gamma, invariant_limit(designer.plant)
    dual = prove_lower_bound(designer.plant, at_the_end(designer.plant))
    assert found is not None
    assert found[0] == pytest.approx(best, rel=2e-9)  # where the path ends, 1e-9
    assert best * (1 - 2.5e-4) < dual.gamma < best  # (2 n + d) mu / 2
    if kind == "quarter_car":
        assert found == (pytest.approx(7.83645764, rel=1e-8), pytest.approx(63.757, abs=1e-3))  # nine digits; G_s' peak


@pytest.mark.parametrize("feedthrough", [0.0, 0.2])
@pytest.mark.parametrize("seed", range(2))
def test_random_plants(seed, feedthrough):
    """On random plants the dual bound is within 2e-4 of the optimum of (22), from below, and above the invariant limit's."""
    plant, _ = random_plant(seed, feedthrough=feedthrough)
    best = state_feedback(plant, 1e-7)[-1].gamma
    bound = prove_lower_bound(plant, at_the_end(plant))
    assert best * (1 - 2e-4) < bound.gamma <= best * (1 + 1e-9)  # (2 n + d) mu / 2 = 7e-5, and the projection
    limit = invariant_limit(plant)
    assert limit is None or limit[0] <= best * (1 + 1e-9)


def joint(seed: int) -> tuple[GeneralizedPlant, np.ndarray]:
    """A random stable plant with one force, and what is measured of it."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((4, 4))
    plant = GeneralizedPlant(
        A=A - (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(4),
        B=rng.standard_normal((4, 1)),
        Bw=rng.standard_normal((4, 2)),
        C=np.vstack([rng.standard_normal((1, 4)), np.zeros((1, 4))]),
        D=np.array([[0.0], [1.0]]),
        Dw=np.zeros((2, 2)),
    )
    return plant, rng.standard_normal((1, 4))


@pytest.mark.parametrize("seed", [6, 7, 8, 10])  # of most others the limit at rest says more
def test_output_feedback_of_any_order(seed):
    """The bound for output feedback lies above that for state feedback, and a full-order controller comes within 0.1 % of it.

    The controller is the central one of the two Riccati equations, for y with a little noise, without which they are singular.
    """
    plant, Cy = joint(seed)
    bound = find_lower_bound(plant, Cy)
    assert bound.gamma >= find_lower_bound(plant).gamma
    assert bound.observer is not None or bound.zeros is not None
    reached = min(
        full_order_norm(plant, Cy, bound.gamma * factor, noise)
        for factor in (1.0005, 1.005, 1.05)
        for noise in (1e-2, 1e-3, 1e-4)
    )
    assert bound.gamma * (1 - 1e-9) < reached
    assert reached < bound.gamma * 1.02  # the noise, and gamma above its infimum


def test_a_witness_of_nothing_proves_nothing(designer):
    """A pair that does not satisfy (21), or is far from the path, proves 0, which is always true."""
    good = at_the_end(designer.plant)
    assert prove_lower_bound(designer.plant, DualCertificate(-good.X, good.eta)).gamma == 0
    assert prove_lower_bound(designer.plant, DualCertificate(good.X, 4 * good.eta)).gamma <= designer.state_feedback.gamma
    assert (
        prove_lower_bound(designer.plant, DualCertificate(np.diag(np.diagonal(good.X)), good.eta)).gamma
        <= designer.state_feedback.gamma
    )


def test_no_controller_beats_the_limit_anywhere(designer, paper):
    """At every frequency every controller's gain is above what no control force changes."""
    omega = np.geomspace(0.1, 1e3, 60)
    unchanged = np.array([limit_at(designer.plant, each) for each in omega.tolist()])
    assert np.all(unchanged > 0)
    for name in ("passive", "state", "I", "II"):
        loop = designer.plant.closed_loop(designer.design(name).state_gain(paper))
        gains = np.linalg.norm(loop.frequency_response(omega), 2, axis=(1, 2))
        assert np.all(gains >= unchanged * (1 - 1e-9)), name  # rounding of the gains


def test_too_large_for_the_joint_path(monkeypatch):
    """Beyond its limit of unknowns output feedback has the bound of state feedback, which holds for it, too."""
    plant, Cy = joint(8)  # of most others the joint problem proves no more than that of the state
    nothing = LowerBound(0.0)  # an invariant point's bound is not what is asked for
    monkeypatch.setattr(full_order, "limit_at", lambda plant, omega: 0.0)  # nor that of the transposed plant
    both, state = (find_lower_bound(plant, y, beyond_control=nothing) for y in (Cy, None))
    monkeypatch.setattr(full_order, "MOST", 10 + 1)  # of state feedback they are 10 + 1 at most
    found = find_lower_bound(plant, Cy, beyond_control=nothing)
    assert both.observer is not None
    assert found.observer is None
    assert 0 < found.gamma == state.gamma <= both.gamma


UNFELT = {  # A, B, Bw, C, D, Dw, Cy, and the least norm
    "velocity of an oscillator": (
        [[0, 1], [-4, -0.1]],
        [[0], [1]],
        [[0], [1]],
        [[1, 0], [0, 0]],
        [[0], [0.1]],
        0,
        [[0, 1]],
        0.25,
    ),
    "velocities of two masses": (
        [[0, 0, 1, 0], [0, 0, 0, 1], [-2, 1, -0.1, 0], [1, -1, 0, -0.1]],
        [[0], [0], [1], [0]],
        [[0], [0], [0], [1]],
        [[0, 1, 0, 0], [0, 0, 0, 0]],
        [[0], [0.1]],
        0,
        [[0, 0, 1, 0], [0, 0, 0, 1]],
        2.0,
    ),
    "at once": ([[0.8807]], [[1]], [[1]], [[1], [0]], [[0], [0.1]], [[0.9], [0.48]], [[0.3554]], 1.02),
}


@pytest.mark.parametrize("name", UNFELT)
def test_what_no_measurement_feels(name):
    """A static load leaves velocities at rest, and a late y feels no step at once: no controller changes z's response to them."""
    A, B, Bw, C, D, Dw, Cy = (np.array(each, dtype=float) for each in UNFELT[name][:-1])
    plant = GeneralizedPlant(A, B, Bw, C, D, Dw if Dw.ndim else np.zeros((2, 1)))
    found = find_lower_bound(plant, Cy)
    assert found.gamma == pytest.approx(UNFELT[name][-1], rel=1e-14)  # exact, rounded down once
    assert found.zeros is not None
    assert limit_at_zeros(plant.measured(Cy), found.zeros) == found.gamma
    noise = np.full((len(Cy), 1), 1e-3)
    assert find_lower_bound(plant, Cy, Dyw=noise).gamma < found.gamma * (1 - 1e-3)  # felt now


def test_what_no_force_moves_at_once():
    """Mixed sensitivity without a weight on the force: at infinite frequency the norm is that of the weight, 2/3.

    An output that a force moves at once takes nothing from it, and a force that moves all outputs leaves no bound.
    """
    G: Any = control.ss(control.tf([1, 1], [1, 0.5, 4]))
    W: Any = control.ss(control.tf([2, -2.2, 1], [3, 0.2, 0.01]))
    A, Bw = np.block([[G.A, np.zeros((2, 2))], [-W.B @ G.C, W.A]]), np.vstack([np.zeros((2, 1)), W.B])
    C, Cy, one = np.hstack([-W.D @ G.C, W.C]), np.hstack([-G.C, np.zeros((1, 2))]), np.ones((1, 1))
    plant = GeneralizedPlant(A, np.vstack([G.B, np.zeros((2, 1))]), Bw, C, 0 * one, W.D).measured(Cy, one)
    found = find_lower_bound(plant)
    assert found.gamma == pytest.approx(2 / 3, rel=1e-14)
    assert found.zeros is not None
    assert limit_at_zeros(plant, found.zeros) == found.gamma
    also = replace(plant, C=np.vstack([C, 0 * C]), D=np.array([[0.0], [1.0]]), Dw=np.vstack([W.D, 5 * one]))
    assert limit_at_infinity(also) == pytest.approx(2 / 3, rel=1e-14)
    assert limit_at_infinity(replace(plant, D=one)) == 0


CANCELLED = [(0.3, -0.7, 1.0), (-0.04746341883039531, -1.0474634188303953, 0.1), (-1.1812498740229496, -2.1812498740229493, 0.1)]


@pytest.mark.parametrize(("a", "c", "dt"), CANCELLED)
def test_a_zero_beside_one(a, c, dt):
    """u = -c x - w makes z zero, and its pole a - c lies inside the circle by less than rounding: nothing is proved."""
    one = np.ones((1, 1))
    plant = GeneralizedPlant(a * one, one, 2 * one, c * one, one, one, dt=dt)
    assert 0 < Fraction(a) - Fraction(c) < 1
    known = np.array([[1.0], [0.0]]), np.array([[0.0], [1.0]])
    assert find_lower_bound(plant, known[0], Dyw=known[1]).gamma == 0
    marginal = GeneralizedPlant(0.5 * one, one, 2 * one, -0.5 * one, one, one, dt=dt)
    assert find_lower_bound(marginal, known[0], Dyw=known[1]).gamma == pytest.approx(1.0, rel=1e-15)  # rounded down once


def random_loop(seed: int) -> tuple[GeneralizedPlant, np.ndarray, np.ndarray]:
    """A plant, C_y and Dyw: continuous or discrete, y clean or noisy, with Dw or without, of any numbers of signals."""
    rng = np.random.default_rng(seed)
    n, m, r, d = (int(rng.integers(1, most)) for most in (5, 3, 3, 3))
    q = int(rng.integers(1, n + 1))
    plant = GeneralizedPlant(
        A=0.7 * rng.standard_normal((n, n)),
        B=rng.standard_normal((n, m)),
        Bw=rng.standard_normal((n, r)),
        C=np.vstack([rng.standard_normal((d, n)), np.zeros((m, n))]),
        D=np.vstack([np.zeros((d, m)), 0.3 * np.eye(m)]),
        Dw=0.5 * rng.standard_normal((d + m, r)) * (seed % 3 == 0),
        dt=None if seed % 2 else 1.0,
    )
    return plant, rng.standard_normal((q, n)), 0.3 * rng.standard_normal((q, r)) * (seed % 4 > 1)


def full_order_optimum(plant: GeneralizedPlant, Cy: np.ndarray, Dyw: np.ndarray) -> float:
    """The least norm of any controller by another solver: both LMIs of Gahinet and Apkarian (1994), as printed, by Clarabel."""
    import cvxpy as cp

    A, Bw, C, Dw = plant.A, plant.Bw, plant.C, plant.Dw
    n = len(A)
    X, Y, gamma = cp.Variable((n, n), symmetric=True), cp.Variable((n, n), symmetric=True), cp.Variable()

    def inequality(A, Bw, C, Dw, X, free):
        r, d = Bw.shape[1], len(C)
        wide = np.hstack([A, Bw])
        keep = np.hstack([np.eye(n), np.zeros((n, r))])
        discrete = plant.dt is not None
        states = wide.T @ X @ wide - keep.T @ X @ keep if discrete else keep.T @ X @ wide + wide.T @ X @ keep
        weighed = states - gamma * np.diag(np.r_[np.zeros(n), np.ones(r)])
        out = np.hstack([C, Dw])
        M = cp.bmat([[free.T @ weighed @ free, free.T @ out.T], [out @ free, -gamma * np.eye(d)]])
        return (M + M.T) / 2 << 0

    one = inequality(A, Bw, C, Dw, X, linalg.null_space(np.hstack([Cy, Dyw])))
    two = inequality(A.T, C.T, Bw.T, Dw.T, Y, linalg.null_space(np.hstack([plant.B.T, plant.D.T])))
    problem = cp.Problem(cp.Minimize(gamma), [one, two, cp.bmat([[Y, np.eye(n)], [np.eye(n), X]]) >> 0])
    problem.solve(solver="CLARABEL", tol_gap_abs=1e-7, tol_gap_rel=1e-7, tol_feas=1e-7)
    return float(problem.value) if problem.status == "optimal" else np.nan  # pyright: ignore[reportArgumentType]


OWN = 1e-4  # relative; Clarabel's optimum moves by as much between tolerances of 1e-7 and 1e-9


def gaps(seeds: range) -> np.ndarray:
    """The bound over the optimum, of plants for which Clarabel has one."""
    ratios = []
    for seed in seeds:
        plant, Cy, Dyw = random_loop(seed)
        best = full_order_optimum(plant, Cy, Dyw)
        if np.isfinite(best):
            ratios.append(find_lower_bound(plant, Cy, Dyw=Dyw).gamma / best)
    return np.array(ratios)


@pytest.mark.attack
def test_the_bound_is_sharp():
    """On 60 random plants no bound lies above the full-order optimum by another solver, and 95 % of them within 0.1 % of it.

    Stable zeros of what is measured, and those at infinity of a discrete plant, take nothing from it.
    """
    ratios = gaps(range(60))
    assert len(ratios) > 54
    assert np.all(ratios < 1 + OWN)
    assert np.mean(ratios > 0.999) >= 0.95


@pytest.mark.parametrize("base", [None, 1.0, 3.7])
@pytest.mark.parametrize("seed", range(2))
def test_what_knows_less_has_no_lower_bound(seed, base):
    """No bound for output feedback lies below that for state feedback of the same plant, also where the joint path breaks off.

    It does where y does not show a mode that does not decay: no controller of y stabilises that, whatever its norm.
    """
    rng = np.random.default_rng(seed)
    n = 5
    A = np.zeros((n, n))
    for i, omega in ((0, 0.6), (2, 23.5)):
        A[i, i + 1], A[i + 1, i] = 1, -(omega**2)
    A[4, 4] = -2.45
    B, Bw = rng.standard_normal((2, n, 1))
    C = np.vstack([np.diag(rng.uniform(0.5, 9, n)), np.zeros((1, n))])
    D = np.eye(6)[:, 5:]
    Cy = np.eye(n)[3:4] if base else rng.standard_normal((2, n))
    plant = GeneralizedPlant(A, B, Bw, C, D, np.zeros((6, 1)))
    units = (base or 1.0) ** rng.integers(-4, 5, n)
    plant, Cy = plant.in_coordinates(np.diag(units)), Cy * units
    state = find_lower_bound(plant)
    found = find_lower_bound(plant, Cy)
    assert 0 < state.gamma <= found.gamma
    if found.state is not None:  # and it is proved by what it brings
        assert prove_lower_bound(plant.measured(Cy), found.state, found.observer).gamma == found.gamma


@pytest.mark.parametrize("seed", range(4))
def test_what_z_shows(seed):
    """Rows and their images span everything modulo a prime only if they do in floats, too: with a hidden state they do not."""
    rng = np.random.default_rng(seed)
    n = 6
    A, C = rng.integers(-9, 10, (n, n)), rng.integers(-9, 10, (1, n))
    if seed % 2:
        A[:-1, -1] = C[0, -1] = 0  # nothing shows the last state
    krylov = np.vstack([C @ np.linalg.matrix_power(A, k) for k in range(n)]).astype(float)
    rank = np.linalg.matrix_rank(krylov / np.linalg.norm(krylov, axis=1, keepdims=True))
    assert span_all(C.astype(object), A.astype(object)) == (rank == n)
    assert (rank == n) == (seed % 2 == 0)
