"""Every number that the paper prints of its designs, (40)-(60): ours, the paper's, the digits it printed."""

import dataclasses

import numpy as np
import pytest

from synth.certificate import certify
from synth.output_feedback import l_matrix, output_feedback, r_matrix

# The bases (47) and (57) that the paper chose; L depends on them, K does not.
CY = {"I": np.eye(4)[[0, 2]], "II": np.eye(4)[[2]]}  # (46), (55)
Q = {"I": np.eye(4)[:, [1, 3]], "II": np.eye(4)[:, [1, 0, 3]]}  # (47), (57)

SHORT = "the paper's solver stopped a little short of the limit of the central path, 2e-4 away in X"
EXACT = ""

# (equation, quantity, entry, the paper's value, unit of its last printed digit, why ours differs in that digit)
ROWS = [
    ("(40)", "G_s", (0, 0), 1.1810e4, 1e0, EXACT),
    ("(40)", "G_s", (0, 1), 0.2333e4, 1e0, EXACT),
    ("(40)", "G_s", (0, 2), -0.1096e4, 1e0, SHORT),
    ("(40)", "G_s", (0, 3), 0.0109e4, 1e0, EXACT),
    ("(41)", "gamma_Gs", None, 7.8365, 1e-4, EXACT),
    ("(42)", "X_s", (0, 0), 0.5965, 1e-4, SHORT),
    ("(42)", "X_s", (0, 1), -0.0020, 1e-4, EXACT),
    ("(42)", "X_s", (0, 2), -0.5075, 1e-4, SHORT),
    ("(42)", "X_s", (0, 3), -0.0085, 1e-4, EXACT),
    ("(42)", "X_s", (1, 1), 0.0020, 1e-4, EXACT),
    ("(42)", "X_s", (1, 2), 0.0020, 1e-4, EXACT),
    ("(42)", "X_s", (1, 3), -0.0081, 1e-4, EXACT),
    ("(42)", "X_s", (2, 2), 0.7659, 1e-4, SHORT),
    ("(42)", "X_s", (2, 3), -0.0015, 1e-4, EXACT),
    ("(42)", "X_s", (3, 3), 8.0713, 1e-4, SHORT),
    ("(48)", "L_I", (0, 0), -0.0025, 1e-4, EXACT),
    ("(48)", "L_I", (0, 1), 0.0009, 1e-4, EXACT),
    ("(48)", "L_I", (1, 0), -0.0364, 1e-4, EXACT),
    ("(48)", "L_I", (1, 1), -0.0261, 1e-4, SHORT),
    ("(49)", "R_I", (0, 0), 1.0, 1e-4, EXACT),
    ("(49)", "R_I", (0, 1), 0.0, 1e-4, EXACT),
    ("(49)", "R_I", (1, 0), -0.0025, 1e-4, EXACT),
    ("(49)", "R_I", (1, 1), 0.0009, 1e-4, EXACT),
    ("(49)", "R_I", (2, 0), 0.0, 1e-4, EXACT),
    ("(49)", "R_I", (2, 1), 1.0, 1e-4, EXACT),
    ("(49)", "R_I", (3, 0), -0.0364, 1e-4, EXACT),
    ("(49)", "R_I", (3, 1), -0.0261, 1e-4, SHORT),
    ("(50)", "K_I", (0, 0), 1.0824e4, 1e0, SHORT),
    ("(50)", "K_I", (0, 1), -0.2071e4, 1e0, SHORT),
    ("(51)", "G_I", (0, 0), 1.0824e4, 1e0, SHORT),
    ("(51)", "G_I", (0, 1), 0.0, 1e0, EXACT),
    ("(51)", "G_I", (0, 2), -0.2071e4, 1e0, SHORT),
    ("(51)", "G_I", (0, 3), 0.0, 1e0, EXACT),
    ("(52)", "gamma_GI", None, 7.8432, 1e-4, EXACT),
    ("(56)", "L_II", (0, 0), 0.0026, 1e-4, EXACT),
    ("(56)", "L_II", (1, 0), -0.6627, 1e-4, SHORT),
    ("(56)", "L_II", (2, 0), -0.0019, 1e-4, EXACT),
    ("(57)", "R_II", (0, 0), -0.6627, 1e-4, SHORT),
    ("(57)", "R_II", (1, 0), 0.0026, 1e-4, EXACT),
    ("(57)", "R_II", (2, 0), 1.0, 1e-4, EXACT),
    ("(57)", "R_II", (3, 0), -0.0019, 1e-4, EXACT),
    ("(58)", "K_II", (0, 0), -8.9703e3, 1e-1, SHORT),
    ("(59)", "G_II", (0, 2), -8.9703e3, 1e-1, SHORT),
    ("(60)", "gamma_GII", None, 7.9068, 1e-4, EXACT),
]
# How far a number may be off that the paper's early stop moved: 2e-4 of X carries to 1e-3 of the smaller entry of K_I; or, for
# small numbers, one unit of the last printed digit.
SHORT_RELATIVE = 1e-3


@pytest.fixture(scope="module")
def ours(designer):
    found = {"G_s": designer.state_feedback.K, "X_s": designer.state_feedback.X}
    found["gamma_Gs"] = designer.state_feedback.gamma
    for name in ("I", "II"):
        L = l_matrix(designer.state_feedback.X, CY[name], Q[name])
        point = output_feedback(designer.plant, CY[name], L, Q[name])[-1]
        found |= {f"L_{name}": L, f"R_{name}": r_matrix(CY[name], Q[name], L), f"K_{name}": point.K}
        found[f"G_{name}"] = point.K @ CY[name]
        found[f"gamma_G{name}"] = certify(designer.plant, point.K @ CY[name]).norm.value
    return found


@pytest.mark.parametrize(("equation", "quantity", "entry", "printed", "digit", "reason"), ROWS)
def test_printed_number(ours, equation, quantity, entry, printed, digit, reason):
    """The paper's number, to every digit it printed, or a reason and a bound on the difference."""
    value = ours[quantity] if entry is None else ours[quantity][entry]
    rounding = 0.5 * digit * (1 + 1e-9)  # half a unit of the last printed digit
    if reason:
        assert abs(value - printed) > rounding, f"{equation} now agrees: drop the reason"
        assert abs(value - printed) <= max(SHORT_RELATIVE * abs(printed), digit)
    else:
        assert abs(value - printed) <= rounding


# The limit of the central path, computed independently of this code before it was written.
LIMIT_GS = [[11810.24, 2333.38, -1095.49, 109.11]]


def test_state_feedback_is_the_limit_of_the_central_path(designer):
    """G_s and gamma are the limit of the central path."""
    point = designer.state_feedback
    np.testing.assert_allclose(point.K, LIMIT_GS, rtol=1e-4)  # given with 6 digits
    assert point.gamma == pytest.approx(7.83645764, rel=1e-7)  # the path stops 1e-9 short in eta


@pytest.mark.parametrize(
    ("name", "gain", "norm", "bound"),
    [("I", [[10825.2, -2069.5]], 7.843188, 7.87149), ("II", [[-8968.5]], 7.906842, 7.90768)],
)
def test_output_feedback_is_the_limit_of_the_central_path(designer, name, gain, norm, bound):
    """K, the norm it reaches and the bound that (25) proves are those of the limit."""
    controller = designer.design(name)
    np.testing.assert_allclose(controller.gain, gain, rtol=1e-5)  # given with 5 digits
    assert controller.certificate.norm.value == pytest.approx(norm, abs=1e-6)  # given with 7 digits
    assert controller.certificate.bound == pytest.approx(bound, abs=1e-5)  # given with 6 digits


@pytest.mark.parametrize(
    ("name", "norm", "peak"),
    [
        ("passive", 35.07201, 4.9711),
        ("state_printed", 7.8364576, 63.757),
        ("I_printed", 7.843188, 63.629),
        ("II_printed", 7.906789, 64.221),
    ],
)
def test_norm_of_given_gains(designer, name, norm, peak):
    """The norms of the passive car and of the printed gains are SLICOT's."""
    found = designer.design(name).certificate.norm
    assert found.value == pytest.approx(norm, abs=1e-6)  # SLICOT's value, given with 7 digits
    assert found.peak_frequency == pytest.approx(peak, abs=5e-3)  # flat at the peak: the frequency has half the digits


def test_passive_poles(designer):
    """The passive car's poles are the quarter-car's body and wheel modes."""
    poles = designer.design("passive").certificate.poles
    expected = [-3.26397 - 65.28199j, -3.26397 + 65.28199j, -0.35827 - 4.95727j, -0.35827 + 4.95727j]
    np.testing.assert_allclose(poles, expected, atol=1e-5)  # given with 5 decimals


def test_invariant_point(paper, designer):
    """At sqrt(k_u / m_u) every controller gives |z_s'' / z_r'| = sqrt(k_u m_u) / m_s: no design can get below it."""
    p, model = paper.parameters, paper.linear_model
    omega = np.sqrt(p["tyre_stiffness"] / p["unsprung_mass"])
    expected = np.sqrt(p["tyre_stiffness"] * p["unsprung_mass"]) / p["sprung_mass"]
    C, D = model.rows(["sprung_acceleration"])
    plant = dataclasses.replace(designer.plant, C=C, D=D, Dw=np.zeros((1, 1)))
    for name in ("passive", "state", "I", "II"):
        loop = plant.closed_loop(designer.design(name).state_gain(paper))
        assert abs(loop.frequency_response(np.array([omega])).item()) == pytest.approx(expected, rel=1e-10)  # rounding
