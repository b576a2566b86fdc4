"""Discrete plants: norms, proofs, bounds, searches and designs are those of continuous ones, and tend to them."""

from dataclasses import replace

import control
import numpy as np
import pytest
from scipy import linalg, optimize

from models.common.errors import InputError
from synth.analysis.bounding import certify_tightly
from synth.analysis.certificate import Certificate, certify, prove_bound
from synth.analysis.lower_bounds.invariant_point import invariant_limit
from synth.analysis.norm import hinf_norm
from synth.analysis.stability import is_stable, stability
from synth.design.descent.refine import refine
from synth.design.full_order.full_order import full_order_design
from synth.design.static import static_output_feedback
from synth.design.two_step import l_matrix, nullspace, r_matrix, state_design, state_path, two_step_design, zero_l_design
from synth.lmi.full_order_bound import find_lower_bound
from synth.lmi.sdp import solve_lmi
from synth.plant.generalized import Feedback, GeneralizedPlant
from synth.plant.numerics import DesignError
from synth.vehicle.designer import Designer
from synth.vehicle.state_space import from_state_space
from tests.support.commands import attacks

EYE = np.eye(4)
MEASURED = {"state": EYE, "I": EYE[[0, 2]], "II": EYE[[2]]}


def held(plant: GeneralizedPlant, dt: float) -> GeneralizedPlant:
    """A continuous plant with u and w held over dt."""
    n, inputs = len(plant.A), np.hstack([plant.B, plant.Bw])
    m = plant.B.shape[1]
    exponent = np.block([[plant.A, inputs], [np.zeros((inputs.shape[1], n + inputs.shape[1]))]])
    E = linalg.expm(dt * exponent)
    return GeneralizedPlant(E[:n, :n], E[:n, n : n + m], E[:n, n + m :], plant.C, plant.D, plant.Dw, dt=dt)


def random_plant(seed: int, dt: float = 0.1, radius: float = 1.05) -> tuple[GeneralizedPlant, np.ndarray]:
    """A discrete plant, unstable for a radius above one, and what it measures."""
    rng = np.random.default_rng(seed)
    n, m, q, r, d = (int(rng.integers(*span)) for span in ((2, 6), *((1, 3),) * 4))
    A = rng.standard_normal((n, n))
    A *= radius * rng.uniform(0.5, 1) / np.abs(np.linalg.eigvals(A)).max()
    C, D = rng.standard_normal((d + m, n)), np.vstack([np.zeros((d, m)), np.eye(m)])
    Dw = rng.standard_normal((d + m, r)) * rng.integers(0, 2)
    plant = GeneralizedPlant(A, rng.standard_normal((n, m)), rng.standard_normal((n, r)), C, D, Dw, dt=dt)
    return plant, rng.standard_normal((q, n))


def bound(certificate: Certificate) -> float:
    """The bound that is proved."""
    assert certificate.bound is not None
    return certificate.bound


def highest(plant: GeneralizedPlant) -> float:
    """The largest gain over a dense grid of frequencies, refined about the best."""
    assert plant.dt is not None
    omega = np.linspace(0, np.pi / plant.dt, 4001)

    def gains(at: np.ndarray) -> np.ndarray:
        return np.linalg.norm(plant.frequency_response(at), 2, axis=(1, 2))

    best = omega[gains(omega).argmax()]
    low, high = max(best - omega[1], 0.0), min(best + omega[1], omega[-1])
    finest = optimize.fminbound(lambda at: -gains(np.array([at]))[0], low, high)
    return max(gains(np.array([finest]))[0], gains(np.array([low, best, high])).max())


def on_circle(loop: GeneralizedPlant, level: float) -> bool:
    """Whether a singular value of T(z) is the level somewhere on the circle: an eigenvalue of the symplectic pencil is there."""
    (n, r), d = loop.Bw.shape, len(loop.C)
    left, right = np.zeros((2 * n + r + d, 2 * n + r + d)), np.zeros((2 * n + r + d, 2 * n + r + d))
    # z x = A x + Bw w, p = z (A' p + C' v), level v = C x + Dw w, level w = Bw' p + Dw' v: w and v are singular vectors.
    left[:n, :n], left[:n, 2 * n : 2 * n + r], right[:n, :n] = loop.A, loop.Bw, np.eye(n)
    left[n : 2 * n, n : 2 * n], right[n : 2 * n, n : 2 * n], right[n : 2 * n, 2 * n + r :] = np.eye(n), loop.A.T, loop.C.T
    left[2 * n : 2 * n + d, :n], left[2 * n : 2 * n + d, 2 * n : 2 * n + r] = loop.C, loop.Dw
    left[2 * n : 2 * n + d, 2 * n + r :] = -level * np.eye(d)
    left[2 * n + d :, 2 * n : 2 * n + r], left[2 * n + d :, 2 * n + r :] = level * np.eye(r), -loop.Dw.T
    left[2 * n + d :, n : 2 * n] = -loop.Bw.T
    poles = linalg.eigvals(left, right)
    return bool(np.any(np.abs(np.abs(poles[np.isfinite(poles)]) - 1) < 1e-6))


@pytest.mark.parametrize("seed", range(12))
def test_the_norm_by_other_routes(seed):
    """The norm is the highest gain on the circle, where a grid finds it and a symplectic pencil has eigenvalues below it only."""
    plant, _ = random_plant(seed, dt=[1.0, 1e-3][seed % 2], radius=0.98)
    norm = hinf_norm(plant)
    # The search of the reference ends 1e-5 of a grid's step from the top.
    assert highest(plant) == pytest.approx(norm.value, rel=1e-9)
    gain = np.linalg.norm(plant.frequency_response(np.array([norm.peak_frequency]))[0], 2)
    assert gain == pytest.approx(norm.value, rel=1e-9)  # a peak is flat
    assert norm.rounding < 1e-9
    assert not on_circle(plant, norm.value * (1 + 1e-4))
    assert on_circle(plant, norm.value * (1 - 1e-4)) or norm.peak_frequency == 0


def test_a_norm_at_the_end_of_the_circle():
    """A peak at z = -1, where the mapped frequency is infinite, and one at z = 1 are found: 1 / (1 - 0.9) both."""
    for pole, at in ((-0.9, np.pi / 0.1), (0.9, 0.0)):
        one = np.array([[1.0]])
        norm = hinf_norm(GeneralizedPlant(np.array([[pole]]), one, one, one, one, 0 * one, dt=0.1))
        assert norm.value == pytest.approx(10, rel=1e-13)
        assert norm.peak_frequency == pytest.approx(at, abs=1e-6)  # flat


@pytest.mark.parametrize(("pole", "verdict"), [(1.0, "marginal"), (-1.0, "marginal"), (1.001, "unstable"), (-0.999, "stable")])
def test_stability_is_that_of_the_circle(pole, verdict):
    """A double pole on the circle is marginal, one beyond unstable, one within stable; the words name it."""
    A = np.array([[pole, 1.0], [0.0, pole]])
    found = stability(A, 0.1)
    assert found.verdict == verdict
    assert f"z = {pole:g}" in found.words


@pytest.mark.parametrize("seed", range(12))
def test_what_is_proved_of_a_gain(seed):
    """A stable loop has a bound within a millionth of its norm; no smaller one can be proved, nor any of another plant."""
    plant, Cy = random_plant(seed, radius=0.95)
    certificate = certify_tightly(plant, Feedback(np.zeros((plant.B.shape[1], len(Cy))), Cy))
    assert certificate.failures == ()
    assert certificate.norm.value < bound(certificate) <= certificate.norm.value * (1 + 2e-6)  # the first margin, rounded
    proof, G = certificate.proof, Feedback(np.zeros((plant.B.shape[1], len(Cy))), Cy)
    assert proof is not None
    assert not prove_bound(plant, G, proof.X, proof.eta * (1 + 4e-6)).holds
    assert not prove_bound(replace(plant, dt=None), G, proof.X, proof.eta).holds


@pytest.mark.parametrize("seed", range(3))
def test_state_feedback_by_another_solver(seed):
    """The path of the bordered LMI ends where Clarabel ends or lower, is proved, and not below the bound for all that know x."""
    plant, _ = random_plant(seed, radius=1.3)
    n = len(plant.A)
    design, solved = state_design(plant), solve_lmi(plant, np.zeros((n, 0)), np.eye(n))
    assert design.certificate.failures == ()
    # Clarabel's tolerance of eta; where the optimum has a large X it stops up to 3e-4 short of it.
    assert solved.gamma * (1 - 1e-3) < bound(design.certificate) < solved.gamma * (1 + 1e-5)
    assert find_lower_bound(plant).gamma <= design.certificate.norm.value


@pytest.mark.parametrize("name", ["I", "II"])
def test_the_second_step_by_another_solver(paper, name):
    """From the same L (14) Clarabel reaches the same bound (25) at 1 ms, and L = 0 leads to a worse one."""
    plant, Cy = held(Designer(paper).plant, 1e-3), MEASURED[name]
    X, Q = state_path(plant)[-1].X, nullspace(Cy)
    solved = solve_lmi(plant, Q, r_matrix(Cy, Q, l_matrix(X, Cy, Q)))
    found = two_step_design(plant, Cy)
    assert found.certificate.failures == ()
    # Its X is that of a discrete plant, too, and proves its bound but for the solver's tolerance.
    assert certify(plant, solved.Y @ np.linalg.inv(solved.X), solved.X, solved.eta * (1 - 1e-4)).failures == ()
    assert found.certificate.bound == pytest.approx(solved.gamma, rel=1e-5)  # Clarabel's tolerance of eta
    assert bound(zero_l_design(plant.measured(Cy)).certificate) > bound(found.certificate)


@pytest.mark.parametrize("name", MEASURED)
def test_designs_tend_to_the_continuous_ones(paper, name):
    """Gains and bounds of the plant with u and w held are those of the continuous one, but for a first power of the period."""
    plant, Cy = Designer(paper).plant, MEASURED[name]

    def designed(of: GeneralizedPlant):
        found = state_design(of) if name == "state" else two_step_design(of, Cy)
        return np.append(found.gain.ravel(), bound(found.certificate))

    aim = designed(plant)
    off = [designed(held(plant, dt)) - aim for dt in (1e-5, 1e-6)]
    # A tenth of the period is a tenth of the distance; 2 % of it is of second order at 10 us, and the path ends 3e-6 short.
    np.testing.assert_allclose(off[1], off[0] / 10, rtol=0.15, atol=2e-5 * np.abs(aim).max())
    assert np.abs(off[0] / aim).max() < 0.35
    assert np.abs(off[1] / aim).max() < 0.035


def test_conditioning_at_a_megahertz(paper):
    """If A is I to five digits designs are still proved, and refined ones, too."""
    plant, Cy = held(Designer(paper).plant, 1e-6), MEASURED["I"]
    design = two_step_design(plant, Cy)
    assert design.certificate.failures == ()
    assert design.certificate.norm.value == pytest.approx(7.84317, abs=3e-4)  # the continuous design's is 7.843188
    assert refine(plant, Cy, design.gain).after < design.certificate.norm.value


@pytest.mark.parametrize("seed", attacks((1, 5, *range(100, 105))))
def test_no_lower_bound_above_what_is_reached(seed):
    """Searched static gains and full-order laws of random plants are proved, and none lies below the lower bound.

    Some have an integrator, a delay, or a state that z does not see.
    """
    plant, Cy = random_plant(seed, radius=1.1)
    kind = np.random.default_rng(seed).integers(0, 4) if seed >= 100 else 3
    if kind < 3:
        A, C = plant.A.copy(), plant.C.copy()
        if kind < 2:
            A[0] = 0  # a delay
            A[0, 0] = 1 - kind  # or an integrator that only forces and w move
        else:
            A[1:, 0], C[:, 0], A[0, 0] = 0, 0, 0.4  # not seen
        plant = replace(plant, A=A, C=C)
    below = find_lower_bound(plant, Cy)
    law = full_order_design(plant, Cy, lower_bound=below)
    assert law.law.sample_period == plant.dt
    assert law.certificate.failures == ()
    assert law.certificate.norm.value >= below.gamma * (1 - 1e-9)
    try:
        static = static_output_feedback(plant, Cy, lower_bound=below)
    except DesignError:
        assert not is_stable(plant.A, plant.dt)  # of a stable plant no gain is one
        return
    assert static.certificate.failures == ()
    assert static.certificate.norm.value >= below.gamma * (1 - 1e-9)
    assert np.abs(static.gain).max() <= 1e5
    if static.two_steps is not None:
        assert static.certificate.norm.value <= static.two_steps.certificate.norm.value * (1 + 1e-9)


def test_full_order_next_to_the_bound(paper):
    """A full-order law for the held quarter-car at 10 ms comes within 0.1 % of what no controller beats."""
    plant = held(Designer(paper).plant, 1e-2)
    found = full_order_design(plant, MEASURED["II"])
    assert found.remark == ""
    assert found.certificate.norm.value < find_lower_bound(plant, MEASURED["II"]).gamma * (1 + 1e-3)
    assert found.stable


def test_a_mode_that_z_does_not_see_and_that_grows():
    """A mode at z = -1.2, which in differences is far left of the axis, is not left to itself where z does not see it."""
    A, B = np.array([[0.8, 0.0], [0.0, -1.2]]), np.array([[1.0], [1.0]])
    C, D = np.array([[1.0, 0.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    design = state_design(GeneralizedPlant(A, B, np.eye(2), C, D, np.zeros((2, 2)), dt=0.1))
    assert design.certificate.failures == ()
    assert np.abs(design.certificate.poles).max() < 1


@pytest.mark.attack
@pytest.mark.parametrize("orders", [("static",), ("static", "full")], ids=" ".join)
def test_a_pole_at_minus_one(orders):
    """A plant with a pole at z = -1 and another at 1 is designed, bounded and refined, also at full order: both are moved."""
    A, one = np.diag([-1.0, 1.0, 0.3]), np.ones((3, 1))
    C, D = np.vstack([np.eye(3), np.zeros((1, 3))]), np.array([[0.0], [0], [0], [1]])
    plant = GeneralizedPlant(A, one, np.eye(3), C, D, np.zeros((4, 3)), dt=0.1)
    Cy = np.array([[1.0, 0, 0], [0, 1, 1]])
    below = find_lower_bound(plant, Cy)
    found = static_output_feedback(plant, Cy, lower_bound=below)
    assert found.certificate.failures == ()
    assert 0 < below.gamma <= found.certificate.norm.value
    assert state_design(plant).certificate.norm.value <= found.certificate.norm.value * (1 + 1e-9)
    if "full" in orders:
        law = full_order_design(plant, Cy, lower_bound=below)
        assert law.certificate.failures == ()
        assert law.certificate.norm.value <= found.certificate.norm.value * (1 + 2e-3)  # a static gain is one of full order


def test_python_controls_sampled_system():
    """A sampled `control.StateSpace` comes in with its period, and its norm is python-control's."""
    A, B = np.array([[0.9, 0.2], [-0.1, 0.8]]), np.array([[0.0, 0.1], [0.2, 0.0]])
    system = control.ss(A, B, np.eye(2), np.zeros((2, 2)), 0.05, inputs=["force", "road"], outputs=["height", "rate"])
    plant, Cy = from_state_space(system, ["road"], {"height": 2.0, "rate": 1.0}, ["rate"])
    assert plant.dt == 0.05
    np.testing.assert_array_equal(Cy, [[0, 1]])
    weighted = control.ss(A, B[:, 1:], np.diag([2.0, 1.0]), np.zeros((2, 1)), 0.05)
    omega = np.linspace(0, np.pi / 0.05, 50)
    theirs = np.array([weighted(np.exp(1j * at * 0.05)) for at in omega])
    np.testing.assert_allclose(plant.frequency_response(omega), theirs.reshape(50, 2, 1), rtol=1e-12, atol=1e-13)  # rounding
    with pytest.raises(InputError, match=r"discrete, but has no sample period \(dt = True\); give dt in seconds"):
        from_state_space(control.ss(A, B, np.eye(2), np.zeros((2, 2)), True), ["u[0]"], {"y[0]": 1.0}, ["y[1]"])


def test_an_integrator_that_z_does_not_see():
    """If z does not see a mode on the circle there is no optimum, and it is said where that is."""
    A, B = np.array([[1.0, 0], [0, 0.5]]), np.array([[1.0], [1]])
    plant = GeneralizedPlant(A, B, np.eye(2), np.array([[0.0, 1], [0, 0]]), np.array([[0.0], [1]]), np.zeros((2, 2)), dt=0.1)
    with pytest.raises(DesignError, match="z does not contain the mode at z = 1, which does not decay"):
        state_design(plant)


def test_formulas_of_continuous_plants_refuse_discrete_ones(paper):
    """A formula of continuous plants refuses discrete ones, and not done as if they were continuous."""
    plant = held(Designer(paper).plant, 1e-2)
    with pytest.raises(InputError, match=r"the plant is discrete \(dt = 0.01\)"):
        invariant_limit(plant)
