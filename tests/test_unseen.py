"""Plants with states that z does not see, and with nothing to be gained: a certified gain, or a reason that is true."""

import contextlib
import dataclasses

import numpy as np
import pytest

from synth.analysis.norm import hinf_norm
from synth.design.two_step import Design, state_design, state_path, two_step_design, well_posed
from synth.lmi.output_feedback import l_matrix, nullspace, r_matrix
from synth.lmi.sdp import solve_lmi
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError
from tests.commands import attacks

README = GeneralizedPlant(
    A=np.array([[0.0, 1], [-4, -0.1]]),
    B=np.array([[0.0], [1]]),
    Bw=np.array([[0.0], [1]]),
    C=np.array([[1.0, 0], [0, 0]]),
    D=np.array([[0], [0.1]]),
    Dw=np.zeros((2, 1)),
)


def beside(plant: GeneralizedPlant, A2, A21, B2, Bw2) -> GeneralizedPlant:
    """A plant with states beside it that it drives, as w and u do, and that z does not see."""
    n, k = len(plant.A), len(A2)
    return GeneralizedPlant(
        A=np.block([[plant.A, np.zeros((n, k))], [A21, A2]]),
        B=np.vstack([plant.B, B2]),
        Bw=np.vstack([plant.Bw, Bw2]),
        C=np.hstack([plant.C, np.zeros((len(plant.C), k))]),
        D=plant.D,
        Dw=plant.Dw,
    )


NAMES = ("position", "velocity", "lag")
FAMILIES = ("plain", "low-pass", "mixed", "no output", "w apart", "u apart", "free force", "integrator", "copies", "kept out")


def drawn(seed: int) -> tuple[str, GeneralizedPlant, np.ndarray]:
    """A random plant of one of the families, in random coordinates, and what is measured of it."""
    rng = np.random.default_rng([20261121, seed])
    family = FAMILIES[seed % len(FAMILIES)]
    n, m, r, k = (int(rng.integers(1, top)) for top in (5, 3, 3, 3))
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() - rng.choice([-0.5, 0.3])) * np.eye(n)  # stable or not
    C = np.vstack([rng.standard_normal((2, n)), np.zeros((m, n))])
    D = np.vstack([np.zeros((2, m)), np.eye(m)])
    plant = GeneralizedPlant(
        A,
        rng.standard_normal((n, m)),
        rng.standard_normal((n, r)),
        C,
        D,
        rng.choice([0.0, 0.2]) * rng.standard_normal((2 + m, r)),
    )
    A2 = rng.standard_normal((k, k))
    A2 -= (np.linalg.eigvals(A2).real.max() + rng.uniform(0.1, 3)) * np.eye(k)
    drives = [rng.choice([0.0, 1.0]) * rng.standard_normal((k, size)) for size in (n, m, r)]
    parts = {name: getattr(plant, name) for name in ("A", "B", "Bw", "C", "D", "Dw")}
    match family:
        case "mixed":  # z sees them unless the force hides them
            parts["D"] = plant.D + np.vstack([rng.standard_normal((2, m)), np.zeros((m, m))])
        case "no output":
            parts["C"] = np.zeros_like(C)
        case "w apart":
            parts["Bw"], parts["Dw"], drives[2] = np.zeros((n, r)), np.zeros((2 + m, r)), rng.standard_normal((k, r))
        case "u apart":
            parts["B"], parts["D"], drives[1] = np.zeros((n, m)), np.zeros((2 + m, m)), rng.standard_normal((k, m))
        case "free force":
            parts["D"] = D * (np.arange(m) > 0)
        case "integrator":
            A2 = np.zeros((k, k)) + np.diag(-rng.uniform(0, 2, k) * (np.arange(k) > 0))
        case "copies":
            A2, drives = plant.A, [np.zeros((n, n)), plant.B, plant.Bw]
        case "kept out":  # z is a force over what would hide the states
            parts["C"], parts["D"] = rng.standard_normal((m, n)), np.eye(m)
            parts["Dw"] = np.zeros((m, r))
    plant = GeneralizedPlant(**parts)
    if family != "plain":
        plant = beside(plant, A2, *drives)
    if family != "low-pass":
        plant = plant.in_coordinates(rng.standard_normal((len(plant.A),) * 2))
    return family, plant, rng.standard_normal((int(rng.integers(1, len(plant.A) + 1)), len(plant.A)))


@pytest.mark.parametrize("driven", [(0, 0, 0), (1, 1, 0), (1, 1, 1), *attacks([((1, 0, 0),), ((0, 1, 0),), ((0, 0, 1),)])])
def test_a_state_that_z_does_not_see_changes_nothing(driven, designer):
    """Beside a plant it gets no gain, and the other gains, the bound and the norm are those of the plant without it."""
    rng = np.random.default_rng(1)
    for plant, Cy in ((README, np.array([[0.0, 1.0]])), (designer.plant, np.eye(4)[[0, 2]])):
        n, m, r = len(plant.A), plant.B.shape[1], plant.Bw.shape[1]
        drives = [on * rng.standard_normal((2, size)) for on, size in zip(driven, (n, m, r), strict=True)]
        wide = beside(plant, np.array([[-3.0, 1.0], [-1.0, -3.0]]), *drives)
        path, without = state_path(wide), state_path(plant)
        assert path[-1].gamma == pytest.approx(without[-1].gamma, rel=1e-9)
        assert not np.any(path[-1].K[:, n:])
        np.testing.assert_allclose(
            path[-1].K[:, :n], without[-1].K, rtol=1e-4
        )  # where the path is stopped: 3e-6, relative to all
        found, alone = two_step_design(wide, np.hstack([Cy, np.zeros((len(Cy), 2))])), two_step_design(plant, Cy)
        np.testing.assert_allclose(found.gain, alone.gain, rtol=1e-4)  # likewise
        assert found.certificate.failures == ()
        assert found.certificate.bound == pytest.approx(alone.certificate.bound, rel=1e-7)


@pytest.mark.parametrize("measured", [[[0.0, 0, 1]], [[0.0, 1, 1]], [[0.0, 1, 0], [0, 0, 1]]])
def test_a_lag_that_is_measured(measured):
    """A sensor's own state, which z does not see but y does: the gain on it is certified and beats no control."""
    plant = beside(README, np.array([[-3.0]]), np.array([[0.0, 1.0]]), np.array([[0.0]]), np.array([[1.0]]))
    design = two_step_design(plant, np.array(measured))
    assert design.certificate.failures == ()
    assert design.certificate.norm.value < 0.5 * hinf_norm(plant).value


def test_a_force_that_hides_a_state():
    """z = (x1, u1, u2 + x2): u2 = -x2 hides x2, whatever else is best, and u1 is that of the plant without x2."""
    plant = GeneralizedPlant(
        A=np.diag([-1.0, -2.0]),
        B=np.eye(2),
        Bw=np.ones((2, 1)),
        C=np.array([[1.0, 0], [0, 0], [0, 1]]),
        D=np.array([[0.0, 0], [1, 0], [0, 1]]),
        Dw=np.zeros((3, 1)),
    )
    alone = GeneralizedPlant(
        plant.A[:1, :1], np.ones((1, 1)), np.ones((1, 1)), plant.C[:2, :1], plant.D[:2, :1], np.zeros((2, 1))
    )
    without = state_design(alone).gain[0, 0]
    for gain in (state_design(plant).gain, two_step_design(plant, np.eye(2)).gain):
        np.testing.assert_allclose(gain, [[without, 0], [0, -1]], rtol=1e-6, atol=1e-9)  # where the path is stopped; rounding


def test_a_gain_that_hides_all_is_made_of_measurements():
    """z = 3 x1 + x2 + u: of y = z / 2 at u = 0 the gain is -2, w reaches z in no way, and so it says; of x1 alone it is not."""
    plant = GeneralizedPlant(
        np.diag([-1.0, -2.0]), np.array([[1.0], [0.0]]), np.ones((2, 1)), np.array([[3.0, 1.0]]), np.eye(1), np.zeros((1, 1))
    )
    design = two_step_design(plant, plant.C / 2)
    np.testing.assert_allclose(design.gain, [[-2.0]], rtol=1e-12)  # rounding
    assert design.case == "with this gain w reaches z in no way"
    assert design.certificate.norm.value <= 1e-12  # rounding
    partly = two_step_design(plant, np.eye(2)[:1])
    assert partly.case.startswith("with the right state feedback w reaches z in no way")
    assert partly.certificate.norm.value > 0.1


def test_what_is_left_out_follows():
    """In the X that L (14) comes from, the states left out are as correlated with the others as the closed loop makes them."""
    plant = beside(README, np.array([[-3.0]]), np.array([[1.0, 2.0]]), np.array([[0.5]]), np.array([[1.0]]))
    point = state_path(plant)[-1]
    loop = plant.closed_loop(point.K)
    noise = -(loop.A @ point.X + point.X @ loop.A.T)
    driven = point.eta * loop.Bw @ loop.Bw.T
    np.testing.assert_allclose(noise[2, :2], driven[2, :2], atol=1e-9 * np.abs(noise).max())  # rounding
    assert noise[2, 2] == pytest.approx(driven[2, 2], rel=1e-3)  # a millionth of X is added


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"D": np.zeros((2, 1))}, "some control force costs nothing: z weighs 0 of 1 independent ones"),
        ({"A2": [[0.0]], "A21": [[1.0, 0.0]]}, "z does not see the mode at 0 rad/s, which does not decay and moves most in lag"),
        (
            {"A2": [[0.0]], "A21": [[0.0, 0.0]]},
            "no input reaches the mode at 0 rad/s, which does not decay and shows most in lag",
        ),
    ],
)
def test_reasons(change, reason):
    """Why there is none: a force that costs nothing, an integrator that z does not see, one that no force reaches."""
    plant = beside(README, np.array(change.get("A2", [[-3.0]])), np.array(change.get("A21", [[1.0, 0.0]])), [[0.0]], [[0.0]])
    plant = dataclasses.replace(plant, D=change.get("D", plant.D))
    for find in (lambda: state_path(plant, NAMES), lambda: two_step_design(plant, np.eye(3)[:2], states=NAMES)):
        with pytest.raises(DesignError, match=reason) as caught:
            find()
        assert "\n" not in str(caught.value)
        assert_true(str(caught.value), plant, np.eye(3))


@pytest.mark.parametrize("seed", range(len(FAMILIES)))
def test_a_gain_or_the_truth(seed):
    """For every family: a certified gain, or a reason that an independent computation confirms."""
    check(*drawn(seed))


@pytest.mark.attack
def test_many_plants():
    """So of 25 random plants."""
    for seed in range(25):
        check(*drawn(seed))


def check(family: str, plant: GeneralizedPlant, Cy: np.ndarray) -> None:
    """One plant: state feedback, and output feedback from what is measured."""
    for y, find in ((np.eye(len(plant.A)), lambda: state_design(plant)), (Cy, lambda: two_step_design(plant, Cy))):
        try:
            design = find()
        except DesignError as error:
            assert_true(str(error), plant, y)
        else:
            assert_certified(design, plant, y)


def assert_certified(design: Design, plant: GeneralizedPlant, Cy: np.ndarray) -> None:
    """Poles, a sweep below the bound, and what is said of the case."""
    assert design.certificate.failures == ()
    G = design.gain @ Cy
    loop = plant.closed_loop(G)
    assert np.linalg.eigvals(loop.A).real.max() < 0
    omega = np.geomspace(1e-3, 1e3, 400)
    heights, size = (np.linalg.norm(each.frequency_response(omega), 2, axis=(1, 2)) for each in (loop, plant))
    passed_on = np.linalg.norm(plant.C) * np.linalg.norm(plant.Bw) + np.linalg.norm(plant.Dw)
    if design.certificate.bound is not None:
        # The bound is of u = K y; the sweep rounds K C_y and the loop, some 1e-16 of what is passed on, which counts at 0.
        assert heights.max() <= design.certificate.bound + 1e-14 * passed_on
    nothing = 1e-9 * float(passed_on)  # rounding
    if "none is applied" in design.case:
        assert not np.any(design.gain)
    if "w reaches z in no way" in design.case and "right" not in design.case:
        assert (heights if "this gain" in design.case else size).max() <= nothing
    if "only through Dw" in design.case and "right" not in design.case:
        shown = heights if "this gain" in design.case else size
        np.testing.assert_allclose(shown, np.linalg.norm(plant.Dw, 2), atol=nothing)
    if "the same for every gain" in design.case:
        np.testing.assert_allclose(heights, size, atol=nothing)


def assert_true(reason: str, plant: GeneralizedPlant, Cy: np.ndarray) -> None:
    """The reason why there is no design, by the ranks of matrices and by Clarabel."""
    n, m = plant.B.shape
    eye = np.eye(n)
    modes = [pole for pole in np.linalg.eigvals(plant.A) if pole.real > -1e-6]
    if "no input reaches the mode" in reason:
        assert any(smallest(np.hstack([plant.A - pole * eye, plant.B])) < 1e-7 for pole in modes)
    elif "no measurement shows the mode" in reason:
        assert any(smallest(np.vstack([plant.A - pole * eye, Cy])) < 1e-7 for pole in modes)
    elif "costs nothing" in reason:
        assert np.linalg.matrix_rank(plant.D) < m == np.linalg.matrix_rank(np.vstack([plant.B, plant.D]))
    elif "z does not see the mode" in reason:  # an invariant zero on the imaginary axis
        zeros = np.linalg.eigvals(plant.A - plant.B @ np.linalg.pinv(plant.D) @ plant.C)
        system = [np.block([[plant.A - s * eye, plant.B], [plant.C, plant.D]]) for s in zeros if abs(s.real) < 1e-6]
        assert any(smallest(pencil) < 1e-7 for pencil in system)
    elif "problem (25) has no solution" in reason:
        Q, path = nullspace(Cy), state_path(plant)
        with contextlib.suppress(DesignError):
            solved = solve_lmi(well_posed(plant).plant, Q, r_matrix(Cy, Q, l_matrix(path[-1].X, Cy, Q)))
            G = solved.Y @ np.linalg.inv(solved.X)  # within Clarabel's tolerance, with an X that is singular to it
            assert np.linalg.eigvals(plant.A + plant.B @ G).real.max() > 0
    else:
        pytest.fail(f"unknown reason: {reason}")


def smallest(pencil: np.ndarray) -> float:
    """Smallest singular value of a matrix whose rows and columns have a length of about one."""
    for axis in (0, 1):
        lengths = np.linalg.norm(pencil, axis=axis, keepdims=True)
        pencil = pencil / np.maximum(lengths, 1e-6 * lengths.max())
    return float(np.linalg.svd(pencil, compute_uv=False)[min(pencil.shape) - 1])
