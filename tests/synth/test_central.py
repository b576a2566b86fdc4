"""The central path: its limit depends on nothing but the problem, and its bound is the solver's."""

import dataclasses

import numpy as np
import pytest

from synth.design.two_step import l_matrix, nullspace, output_feedback, r_matrix, state_feedback, state_path, two_step_design
from synth.lmi.central_path import central_path
from synth.lmi.sdp import solve_lmi
from tests.conftest import plant_with_feedthrough

CY = {"I": np.eye(4)[[0, 2]], "II": np.eye(4)[[2]]}


def two_steps(plant, Cy):
    X = state_feedback(plant)[-1].X
    Q = nullspace(Cy)
    return output_feedback(plant.measured(Cy), l_matrix(X, Cy, Q), Q)[-1]


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


@pytest.mark.parametrize("name", ["I", "II"])
def test_first_x_has_the_form_of_the_second(designer, name):
    """With L (14) the X of step 1 is Q X_Q Q' + R X_R R' (12), with X_R = C_y X C_y' and X_Q > 0."""
    X, Cy, Q = designer.state_feedback.X, CY[name], nullspace(CY[name])
    R, X_R = r_matrix(Cy, Q, l_matrix(X, Cy, Q)), Cy @ X @ Cy.T
    X_Q = Q.T @ (X - R @ X_R @ R.T) @ Q
    np.testing.assert_allclose(Q @ X_Q @ Q.T + R @ X_R @ R.T, X, atol=1e-13 * np.abs(X).max())  # rounding
    assert np.linalg.eigvalsh(X_Q).min() > 0


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
    """For several inputs, outputs, disturbances and a D_w the bounds of both steps are Clarabel's, and the certificate holds."""
    plant, Cy = plant_with_feedthrough(seed), np.random.default_rng(seed).standard_normal((3, 5))
    solved = solve_lmi(plant, np.zeros((5, 0)), np.eye(5))
    assert state_feedback(plant)[-1].gamma == pytest.approx(solved.gamma, rel=2e-5)  # where Clarabel stops; up to 1.3e-5 off
    plant = dataclasses.replace(plant, A=plant.A - (np.linalg.eigvals(plant.A).real.max() + 0.2) * np.eye(5))
    path = state_path(plant)
    design, Q = two_step_design(plant, Cy, path), nullspace(Cy)
    assert design.certificate.failures == ()
    assert design.certificate.bound is not None
    if design.state_step_gap == design.optimum_gap == 0:
        second = solve_lmi(plant, Q, r_matrix(Cy, Q, l_matrix(path[-1].X, Cy, Q)))
        assert design.certificate.bound == pytest.approx(second.gamma, rel=2e-5)  # likewise
