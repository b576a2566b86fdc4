"""The central path: its limit depends on nothing but the problem, and its bound is the solver's."""

import dataclasses

import numpy as np
import pytest

from synth.lmi.barrier import Barrier, newton
from synth.lmi.central_path import central_path
from synth.lmi.output_feedback import l_matrix, nullspace, output_feedback, r_matrix, state_feedback
from synth.lmi.sdp import solve_lmi
from tests.conftest import plant_with_feedthrough

CY = {"I": np.eye(4)[[0, 2]], "II": np.eye(4)[[2]]}


def two_steps(plant, Cy):
    X = state_feedback(plant)[-1].X
    Q = nullspace(Cy)
    return output_feedback(plant, Cy, l_matrix(X, Cy, Q), Q)[-1]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", ["state", "I", "II"])
def test_gains_do_not_depend_on_coordinates(designer, name, seed):
    """Other state coordinates, mixed and in other units, give the same gain; `test_units.py` has all other units."""
    rng = np.random.default_rng(seed)
    T = np.diag(10.0 ** rng.uniform(-2, 2, 4)) @ np.linalg.qr(rng.standard_normal((4, 4)))[0]
    plant = designer.plant
    moved = plant.in_coordinates(T)
    if name == "state":
        gain = state_feedback(moved)[-1].K @ np.linalg.inv(T)
        expected = state_feedback(plant)[-1].K
    else:
        gain = two_steps(moved, CY[name] @ T).K
        expected = two_steps(plant, CY[name]).K
    np.testing.assert_allclose(gain, expected, rtol=1e-4)  # asked for; measured 3e-6, where the path is stopped


@pytest.mark.parametrize("name", ["state", "I", "II"])
def test_bound_is_the_solvers(designer, name):
    """Clarabel reaches the same bound on (22) and (25), by an algorithm that shares nothing with ours."""
    plant, n = designer.plant, 4
    if name == "state":
        Q, R = np.zeros((n, 0)), np.eye(n)
    else:
        Q = nullspace(CY[name])
        R = r_matrix(CY[name], Q, l_matrix(designer.state_feedback.X, CY[name], Q))
    solved, central = solve_lmi(plant, Q, R), central_path(plant, Q, R)[-1]
    assert central.gamma == pytest.approx(solved.gamma, rel=3e-5)  # Clarabel's tolerance of 1e-8 in badly scaled units
    assert central.gamma < solved.gamma * (1 + 1e-8)  # and ours is no worse


def test_norm_is_the_optimum_of_problem_27(designer):
    """For a given gain the optimum of (27) is the norm that the frequency response has."""
    loop = designer.plant.closed_loop(designer.design("I").state_gain(designer.vehicle))
    loop = dataclasses.replace(loop, B=np.zeros((4, 1)), D=np.zeros((len(loop.C), 1)))
    solved = solve_lmi(loop, np.zeros((4, 0)), np.eye(4))
    assert solved.gamma == pytest.approx(7.843188, rel=1e-4)  # Clarabel's tolerance in badly scaled units


def test_gain_converges_along_the_path(designer):
    """The gain converges linearly in mu: a tenth of mu leaves a tenth of the error, and the default leaves 3e-6."""
    limit = state_feedback(designer.plant, mu=1e-10)[-1].K
    errors = [np.abs(state_feedback(designer.plant, mu=mu)[-1].K / limit - 1).max() for mu in (1e-6, 1e-7, 1e-9)]
    assert errors[0] / errors[1] == pytest.approx(10, rel=0.15)  # the next order in mu, and the limit itself stops at 1e-10
    assert errors[2] < 3e-6


@pytest.mark.parametrize("seed", range(3))
def test_random_plants_with_feedthrough(seed):
    """On random plants with several inputs and feed-through from w to z, the bound is Clarabel's, and its point is no better.

    Clarabel's own point violates (24) by its tolerance. So it is moved towards a point well inside until it does not.
    """
    plant = plant_with_feedthrough(seed)
    path, solved = state_feedback(plant), solve_lmi(plant, np.zeros((5, 0)), np.eye(5))
    central, inside = path[-1], path[0]
    assert central.gamma == pytest.approx(solved.gamma, rel=2e-5)  # where Clarabel stops; it is up to 1.3e-5 off
    for share in np.geomspace(1e-9, 1e-2, 50):
        X = (1 - share) * solved.X + share * inside.X
        Y = (1 - share) * solved.Y + share * inside.K @ inside.X
        eta = (1 - share) * solved.eta + share * inside.eta
        if _satisfies_24(plant, X, Y, eta):
            assert central.gamma < eta**-0.5 * (1 + 1e-6)
            return
    pytest.fail("no point near Clarabel's satisfies (24)")


def _satisfies_24(plant, X, Y, eta):
    """Returns if X is positive and (24) negative, by eigenvalues."""
    top, low, w = plant.A @ X + plant.B @ Y, plant.C @ X + plant.D @ Y, np.vstack([plant.Bw, plant.Dw])
    F = np.block([[top + top.T, low.T], [low, -np.eye(len(low))]]) + eta * w @ w.T
    return np.linalg.eigvalsh(X)[0] > 0 > np.linalg.eigvalsh(F)[-1]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("slope", [1e150, 1e170, 1e190])
def test_a_step_too_far_is_no_warning(slope):
    """If a step of Newton's method leaves the range of floats its decrement says there is no centre; numpy is silent."""
    barrier = Barrier([(np.eye(2), np.array([np.diag([1e-150, 1.0]), np.diag([0.0, 1.0])]))])
    p, decrement, _ = newton(barrier, np.zeros(2), np.array([slope, -1.0]), 1e-6)
    assert np.all(np.isfinite(p))
    assert decrement > 0.5  # what callers ask
