"""Lower bounds: proved by numpy, below every controller, close to the best one."""

import numpy as np
import pytest
from scipy import linalg

from synth.analysis.invariant_point import invariant_limit, limit_at
from synth.analysis.lower_bound import DualCertificate, LowerBound, prove_lower_bound
from synth.analysis.norm import hinf_norm
from synth.analysis.synthesis_inequality import SynthesisInequality, shown, steered
from synth.lmi import full_order_bound as full_order
from synth.lmi.full_order_bound import find_lower_bound
from synth.lmi.output_feedback import state_feedback
from synth.plant.generalized import GeneralizedPlant
from tests.test_static import random_plant


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


def test_paper_bound(designer):
    """On the paper's car the dual proves gamma* to 6e-5, and the invariant limit proves it to rounding."""
    best = designer.state_feedback.gamma
    dual = prove_lower_bound(designer.plant, at_the_end(designer.plant))
    assert best * (1 - 6e-5) < dual.gamma < best  # (2 n + d) mu / 2 = 6e-5
    found = invariant_limit(designer.plant)
    assert found is not None
    limit, at = found
    assert limit == pytest.approx(7.83645764, rel=1e-8)  # gamma*, given with 9 digits
    assert at == pytest.approx(63.757, abs=1e-3)  # where the norm of the printed G_s peaks


@pytest.mark.parametrize("feedthrough", [0.0, 0.2])
@pytest.mark.parametrize("seed", range(4))
def test_random_plants(seed, feedthrough):
    """On random plants the dual bound is within 2e-4 of the optimum of (22), from below, and above the invariant limit's."""
    plant, _ = random_plant(seed, feedthrough=feedthrough)
    best = state_feedback(plant, 1e-7)[-1].gamma
    bound = prove_lower_bound(plant, at_the_end(plant))
    assert best * (1 - 2e-4) < bound.gamma <= best * (1 + 1e-9)  # (2 n + d) mu / 2 = 7e-5, and the projection
    limit = invariant_limit(plant)
    assert limit is None or limit[0] <= best * (1 + 1e-9)


@pytest.mark.parametrize("seed", [6, 7, 8, 10])  # of most others the limit at rest says more
def test_output_feedback_of_any_order(seed):
    """The bound for output feedback lies above that for state feedback, and a full-order controller comes within 0.1 % of it.

    The controller is the central one of the two Riccati equations, for y with a little noise, without which they are singular.
    """
    rng = np.random.default_rng(seed)
    n = 4
    A = rng.standard_normal((n, n))
    plant = GeneralizedPlant(
        A=A - (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(n),
        B=rng.standard_normal((n, 1)),
        Bw=rng.standard_normal((n, 2)),
        C=np.vstack([rng.standard_normal((1, n)), np.zeros((1, n))]),
        D=np.array([[0.0], [1.0]]),
        Dw=np.zeros((2, 2)),
    )
    Cy = rng.standard_normal((1, n))
    bound = find_lower_bound(plant, Cy)
    assert bound.gamma >= find_lower_bound(plant).gamma
    assert bound.observer is not None
    reached = min(
        full_order_norm(plant, Cy, bound.gamma * factor, noise)
        for factor in (1.0005, 1.005, 1.05)
        for noise in (1e-2, 1e-3, 1e-4)
    )
    assert bound.gamma * (1 - 1e-9) < reached
    assert reached < bound.gamma * 1.02  # the noise, and gamma above its infimum


def test_what_derivatives_show(designer):
    """Deflection and body velocity show, with their derivatives, all of the paper's state: no bound beyond state feedback's."""
    assert shown(designer.plant, np.eye(4)[[0, 2]]).shape == (4, 4)
    noisy = GeneralizedPlant(
        A=np.array([[0.0, 1.0], [0.0, 0.0]]),
        B=np.array([[0.0], [1.0]]),
        Bw=np.eye(2),
        C=np.eye(2),
        D=np.zeros((2, 1)),
        Dw=np.zeros((2, 2)),
    )
    assert shown(noisy, np.array([[1.0, 0.0]])).shape == (1, 2)  # its derivative holds w
    assert steered(noisy).shape == (2, 1)  # u acts on x2 at no cost, but x2 is weighed
    assert len(SynthesisInequality.of(noisy).J) == 1


def test_a_witness_of_nothing_proves_nothing(designer):
    """A pair that does not satisfy (21), or is far from the path, proves 0, which is always true."""
    good = at_the_end(designer.plant)
    assert prove_lower_bound(designer.plant, DualCertificate(-good.X, good.eta)).gamma == 0
    assert prove_lower_bound(designer.plant, DualCertificate(good.X, 4 * good.eta)).gamma <= designer.state_feedback.gamma
    assert (
        prove_lower_bound(designer.plant, DualCertificate(np.diag(np.diagonal(good.X)), good.eta)).gamma
        <= designer.state_feedback.gamma
    )


@pytest.mark.parametrize("name", ["passive", "state", "I", "II"])
def test_no_controller_beats_the_limit_anywhere(designer, paper, name):
    """At every frequency every controller's gain is above what no control force changes."""
    omega = np.geomspace(0.1, 1e3, 100)
    loop = designer.plant.closed_loop(designer.design(name).state_gain(paper))
    gains = np.linalg.norm(loop.frequency_response(omega), 2, axis=(1, 2))
    unchanged = [limit_at(designer.plant, each) for each in omega.tolist()]
    assert np.all(np.array(unchanged) > 0)
    assert np.all(gains >= np.array(unchanged) * (1 - 1e-9))  # rounding of the gains


@pytest.mark.parametrize("kind", ["half_car", "full_car"])
def test_limit_of_the_other_cars(kind):
    """Their best state feedback reaches the invariant limit too, which the dual proves to 2e-4."""
    from models.vehicle.vehicle import read_vehicle
    from synth.vehicle.designer import Designer

    designer = Designer(read_vehicle(kind))
    best = designer.state_feedback.gamma
    limit = invariant_limit(designer.plant)
    assert limit is not None
    assert limit[0] == pytest.approx(best, rel=2e-9)  # where the path ends, 1e-9
    assert prove_lower_bound(designer.plant, at_the_end(designer.plant)).gamma == pytest.approx(
        best, rel=2.5e-4
    )  # (2 n + d) mu / 2


def test_too_large_for_the_joint_path(monkeypatch):
    """Beyond its limit of unknowns output feedback has the bound of state feedback, which holds for it, too."""
    rng = np.random.default_rng(8)  # of most others the joint problem proves no more than that of the state
    A = rng.standard_normal((4, 4))
    plant = GeneralizedPlant(
        A=A - (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(4),
        B=rng.standard_normal((4, 1)),
        Bw=rng.standard_normal((4, 2)),
        C=np.vstack([rng.standard_normal((1, 4)), np.zeros((1, 4))]),
        D=np.array([[0.0], [1.0]]),
        Dw=np.zeros((2, 2)),
    )
    Cy, nothing = rng.standard_normal((1, 4)), LowerBound(0.0)  # an invariant point's bound is not what is asked for
    joint, state = (find_lower_bound(plant, y, beyond_control=nothing) for y in (Cy, None))
    monkeypatch.setattr(full_order, "MOST", 10 + 1)  # of state feedback they are 10 + 1 at most
    found = find_lower_bound(plant, Cy, beyond_control=nothing)
    assert joint.observer is not None
    assert found.observer is None
    assert 0 < found.gamma == state.gamma <= joint.gamma


@pytest.mark.parametrize("base", [None, 1.0, 3.7])
@pytest.mark.parametrize("seed", range(4))
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
        assert prove_lower_bound(plant, found.state, Cy, found.observer).gamma == found.gamma
