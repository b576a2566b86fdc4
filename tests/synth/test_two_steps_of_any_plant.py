"""The two steps for any plant: states that z does not see, slow modes, and descent where the two steps break off."""

import contextlib
import dataclasses
import json
import re

import numpy as np
import pytest

from models.vehicle.vehicle import read_vehicle
from synth.__main__ import main
from synth.analysis.certificate import certify
from synth.analysis.norm import hinf_norm
from synth.command.cross_check import cross_check
from synth.controller.report import notes
from synth.design.descent.refine import refine
from synth.design.problem import DesignResult
from synth.design.two_step import l_matrix, nullspace, r_matrix, state_design, state_path, two_step_design, well_posed
from synth.lmi.central_path import Basis, unknowns
from synth.lmi.full_order_bound import find_lower_bound
from synth.lmi.sdp import solve_lmi
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError, InfeasibleError, NoSolutionError, TooLargeError
from synth.vehicle.designer import Designer
from tests.support.commands import attacks, in_the_suite, prose
from tests.synth.test_discrete import held

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
        dt=plant.dt,
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


@pytest.mark.parametrize("driven", [(1, 1, 1), *attacks([((0, 0, 0),), ((1, 1, 0),), ((1, 0, 0),), ((0, 1, 0),), ((0, 0, 1),)])])
def test_a_state_that_z_does_not_see_changes_nothing(driven, designer):
    """Beside a plant it gets no gain, and the other gains, the bound and the norm are those of the plant without it."""
    rng = np.random.default_rng(1)
    car, Cy_of_I, A2 = designer.plant, np.eye(4)[[0, 2]], np.array([[-3.0, 1.0], [-1.0, -3.0]])
    for plant, Cy in ((README, np.array([[0.0, 1.0]])), (car, Cy_of_I), (held(car, 0.01), Cy_of_I)):
        n, m, r = len(plant.A), plant.B.shape[1], plant.Bw.shape[1]
        drives = [on * rng.standard_normal((2, size)) for on, size in zip(driven, (n, m, r), strict=True)]
        wide = beside(plant, A2 if plant.dt is None else np.eye(2) + plant.dt * A2, *drives)
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
    """z = 3 x1 + x2 + u: of y = z / 2 at u = 0 the gain is -2, w does not affect z, and so it says; of x1 alone it is not."""
    plant = GeneralizedPlant(
        np.diag([-1.0, -2.0]), np.array([[1.0], [0.0]]), np.ones((2, 1)), np.array([[3.0, 1.0]]), np.eye(1), np.zeros((1, 1))
    )
    design = two_step_design(plant, plant.C / 2)
    np.testing.assert_allclose(design.gain, [[-2.0]], rtol=1e-12)  # rounding
    assert design.case == "with this gain w does not affect z"
    assert design.certificate.norm.value <= 1e-12  # rounding
    partly = two_step_design(plant, np.eye(2)[:1])
    assert partly.case.startswith("with the right state feedback w does not affect z")
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
        ({"D": np.zeros((2, 1))}, "z weights only 0 of 1 independent control forces"),
        ({"A2": [[0.0]], "A21": [[1.0, 0.0]]}, "z does not contain the mode at 0 rad/s, which does not decay and .* in lag"),
        (
            {"A2": [[0.0]], "A21": [[0.0, 0.0]]},
            "no input acts on the mode at 0 rad/s, which does not decay and appears most in lag",
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


@pytest.mark.parametrize("seed", in_the_suite(range(len(FAMILIES)), range(25)))
def test_a_gain_or_the_truth(seed):
    """For every family: a certified gain, or a reason that an independent computation confirms."""
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


def assert_certified(design: DesignResult, plant: GeneralizedPlant, Cy: np.ndarray) -> None:
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
    if "no force is applied" in design.case:
        assert not np.any(design.gain)
    if "w does not affect z" in design.case and "right" not in design.case:
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
    if "no input acts on the mode" in reason:
        assert any(smallest(np.hstack([plant.A - pole * eye, plant.B])) < 1e-7 for pole in modes)
    elif "none of them contains the mode" in reason:
        assert any(smallest(np.vstack([plant.A - pole * eye, Cy])) < 1e-7 for pole in modes)
    elif "z weights only" in reason:
        assert np.linalg.matrix_rank(plant.D) < m == np.linalg.matrix_rank(np.vstack([plant.B, plant.D]))
    elif "z does not contain the mode" in reason:  # an invariant zero on the imaginary axis
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


# --- slow modes -------------------------------------------------------------------------------------------------------------


def scalar(pole: float, dt: float | None, state: float = 1.0, force: float = 1.0) -> GeneralizedPlant:
    """One state, pushed by u and w alike; z = [x, u]. `state` and `force` are what one of a unit counts in another."""
    column = np.array([[state]])
    return GeneralizedPlant(
        np.array([[pole]]),
        column * force,
        column,
        np.array([[1 / state], [0.0]]),
        np.array([[0.0], [force]]),
        np.zeros((2, 1)),
        dt=dt,
    )


def of_slow_modes(seed: int) -> tuple[GeneralizedPlant, np.ndarray]:
    """A discrete plant with one pole or all of them next to z = 1, in odd units, and what it measures."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    m, q = int(rng.integers(1, min(n, 2) + 1)), int(rng.integers(1, n + 1))
    poles = 1 - 10.0 ** -rng.permutation(np.arange(1, 9))[:n] * rng.choice([1, 1, -1], n)
    if rng.random() < 0.5:
        poles[1:] = rng.uniform(-0.9, 0.9, n - 1)
    V, states, forces = rng.normal(size=(n, n)), 10.0 ** rng.integers(-4, 5, n), 10.0 ** rng.integers(-4, 5, m)
    plant = GeneralizedPlant(
        A=(states[:, None] * (V * poles @ np.linalg.inv(V))) / states,
        B=states[:, None] * rng.normal(size=(n, m)) * forces,
        Bw=states[:, None] * rng.normal(size=(n, 1)),
        C=np.vstack([rng.normal(size=(1, n)) / states, np.zeros((m, n))]),
        D=np.vstack([np.zeros((1, m)), np.diag(forces)]),
        Dw=np.zeros((1 + m, 1)),
        dt=float(10.0 ** rng.integers(-3, 4)),
    )
    return plant, rng.normal(size=(q, n)) / states


@pytest.mark.parametrize("seed", [0, 2, *attacks([1, *range(3, 33), *range(183, 208)])])  # one has poles like each other's
def test_slow_discrete_plants(seed):
    """Poles 1 - 1e-1 to 1 - 1e-8, outside the circle too: a certified gain no better than the bound, or (25) has no solution."""
    plant, Cy = of_slow_modes(seed)
    try:
        design = two_step_design(plant, Cy)
    except DesignError as error:
        # Of all states that grow or hardly decay, next to each other, rounding may leave (14) no inverse, and that is said.
        if len(Cy) == len(plant.A) and str(error).startswith("L (14) could not be computed: C_y X C_y' is singular"):
            return
        # Nor may it leave one input more modes next to each other than it can tell apart: they stay where they are.
        alike = np.sum(np.abs(np.linalg.eigvals(plant.A) - 1) < 1e-4) > plant.B.shape[1]
        if alike and re.match(r"its certificate fails: marginal: a pole at .* is on the unit circle \(within", str(error)):
            return
        if not isinstance(error, NoSolutionError):
            raise
        # Of (25), but where one input tells several modes next to each other apart by no more than rounding.
        of_second = len(Cy) < len(plant.A) and str(error).startswith("problem (25) has no solution with eta > 0 for this L")
        if not of_second and not str(error).endswith("off the unit circle by more than rounding"):
            raise
        return
    certificate = design.certificate
    assert not certificate.failures
    norm = hinf_norm(plant.closed_loop(design.gain @ Cy))
    assert certificate.norm.value == pytest.approx(norm.value, rel=max(1e-9, norm.rounding))
    assert norm.value >= find_lower_bound(plant, Cy).gamma * (1 - 1e-9)  # rounding of the norm


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("digits", [15, *attacks((1, 3, 6, 12))])
def test_one_slow_discrete_mode(digits, sign):
    """For a scalar plant the optimum has a formula, and the gain meets it, to the last pole that is not 1, in odd units."""
    pole = 1 - sign * 10.0**-digits
    design = two_step_design(scalar(pole, 0.1, state=1e3, force=1e-2), np.eye(1))
    # The norm of u = k x is hypot(1, k) / (1 - |pole + k|), least where the loop's pole is 0; the path ends within
    # (2 n + d) mu / 2 = 2e-9 of it.
    assert design.certificate.norm.value == pytest.approx(np.hypot(1, pole), rel=5e-9)
    assert not design.certificate.failures


@pytest.mark.parametrize("digits", [1, 12, *attacks((2, 4, 6, 9))])
def test_one_slow_continuous_mode(digits):
    """x' = -e x + u + w, z = [x, u] has the optimum 1 / sqrt(1 + e^2), at u = -x / e: as slow as it is, it is come near to."""
    slow = 10.0**-digits
    design = two_step_design(scalar(-slow, None, state=1e3, force=1e-2), np.eye(1))
    assert not design.certificate.failures
    assert design.certificate.norm.value >= 1 / np.hypot(1, slow) * (1 - 1e-9)
    # Gains beyond actuators are left out: what they would save is below the share that `optimum_gap` tells.
    assert design.certificate.norm.value <= (1 + design.optimum_gap) / np.hypot(1, slow) * (1 + 1e-6)
    assert design.optimum_gap < 0.01


@pytest.mark.parametrize("seed", [13, *attacks([16])])  # of 13 the norm of the map is 1e-6 off
def test_what_a_refinement_says_is_the_norm(seed):
    """The norms that a refinement of a discrete plant tells are those of its own loop, not of the one it is mapped to."""
    plant, Cy = of_slow_modes(seed)
    K = two_step_design(plant, Cy).gain
    found = refine(plant, Cy, K)
    for gain, said in ((K, found.before), (found.gain, found.after)):
        assert said == pytest.approx(hinf_norm(plant.closed_loop(gain @ Cy)).value, rel=1e-10)  # the same number, rounded alike


# --- where the two steps break off ------------------------------------------------------------------------------------------


TOO_LARGE = (
    "the LMI problem has 15 unknowns, but the two-step method allows at most 14; remove states from the model"  # 10 + 4 + 1
)


def test_too_large_is_said_and_descent_goes_on(capsys, monkeypatch):
    """Beyond the limit of unknowns the table and JSON say how many there are, and give what descent finds, proved."""
    monkeypatch.setattr("synth.design.two_step.MOST", 14)
    assert main(["--controller", "I", "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["controllers"]
    note = next(note for note in row["notes"] if note.startswith("designed by descent on the norm from "))
    assert note.endswith(TOO_LARGE)
    assert row["failures"] == []
    assert row["lower_bound"] <= row["norm"] <= row["bound"]
    assert row["norm"] < 7.843188  # the two steps' own, which descent improves upon
    assert main(["--controller", "I", "-v"]) == 0
    assert note in prose(capsys.readouterr().out)


def test_at_the_limit_the_two_steps_are_gone(designer, monkeypatch):
    """15 unknowns fit a limit of 15: nothing is done instead."""
    monkeypatch.setattr("synth.design.two_step.MOST", 15)
    monkeypatch.setattr("synth.lmi.central_path.MOST", 15)
    controller = Designer(designer.vehicle).design("I")
    assert controller.fallback_method == ""
    np.testing.assert_array_equal(controller.gain, designer.design("I").gain)
    assert unknowns(designer.plant) == Basis.of(designer.plant, 0).size == 15
    assert unknowns(designer.plant, 2) == Basis.of(designer.plant, 2).size


def test_too_large_for_a_path(designer, monkeypatch):
    """State feedback has a limit of its own, and nothing to go on with."""
    monkeypatch.setattr("synth.lmi.central_path.MOST", 14)
    with pytest.raises(TooLargeError, match="the LMI problem has 15 unknowns, but the central path allows at most 14"):
        state_path(designer.plant)
    with pytest.raises(TooLargeError, match="controller 'state': the LMI problem has 15 unknowns"):
        Designer(designer.vehicle).design("state")
    assert "the central path allows at most 14" in Designer(designer.vehicle).design("I").fallback_method


@pytest.mark.attack
@pytest.mark.parametrize(
    ("performance", "reason", "best"),
    [
        ({"suspension_deflection": 1.0}, "z weights only", 0.1044),
        ({"sprung_acceleration": 1.0}, "z does not contain the mode at 0 rad/s", 7.836),  # with a weight on the force: 7.8364
    ],
)
def test_where_there_is_no_path_descent_goes_on(performance, reason, best):
    """A force that costs nothing, or a mode that z does not see: I is what descent on the norm finds, proved, and said."""
    designer = Designer(dataclasses.replace(read_vehicle("quarter_car"), performance=performance))
    controller = designer.design("I")
    certificate = controller.certificate
    assert certificate.failures == ()
    assert certificate.bound is not None
    assert designer.lower_bound(controller.measured).gamma * (1 - 1e-9) <= certificate.norm.value < best  # rounding
    assert np.abs(controller.gain).max() <= 1e5 * (1 + 1e-12)  # rounding of the scales
    note = notes(controller)[0]
    assert note.startswith("designed by descent on the norm from ")
    assert f"with gains up to 100000; reason: {reason}" in note
    assert cross_check(designer, controller) is None  # Clarabel would solve another problem
    with pytest.raises(DesignError, match=f"controller 'state': {reason}") as caught:
        designer.design("state")
    assert not isinstance(caught.value, InfeasibleError)


def test_a_gain_without_a_proof_is_said_to_be(designer, monkeypatch):
    """If rounding leaves no proof of a bound the gain comes with its norm, and that there is no bound is said."""
    monkeypatch.setattr("synth.design.two_step.MOST", 14)
    monkeypatch.setattr(
        "synth.design.static.certify_law", lambda plant, law, below: certify(*plant.with_law(law), lower_bound=below)
    )
    found = Designer(designer.vehicle).design("II")
    assert found.certificate.bound is None
    assert found.certificate.failures == ()
    assert (
        "rounding leaves no proof of a bound, but two methods agree on the norm; reason: the LMI problem" in found.fallback_method
    )


def test_one_broken_path_is_no_proof(monkeypatch, designer):
    """If (25) has no solution from some X and its path breaks off from another, there may be a gain: no InfeasibleError."""
    turns = iter([NoSolutionError("no solution"), DesignError("broke off")])

    def fails(*_):
        raise next(turns, NoSolutionError("no solution"))

    monkeypatch.setattr("synth.design.two_step.output_feedback", fails)
    with pytest.raises(DesignError, match="broke off") as caught:
        two_step_design(designer.plant, np.eye(4)[[0, 2]], designer.state_path)
    assert not isinstance(caught.value, InfeasibleError)
