"""The complete strategy: descent on the norm, stabilising starts, proofs, bounded refinement."""

import json

import numpy as np
import pytest

from models.common.errors import InputError
from models.laws.linear import static_law
from synth.analysis.bounding import certify_tightly
from synth.analysis.certificate import certify
from synth.analysis.norm import hinf_norm
from synth.design.descent.landscape import Landscape
from synth.design.descent.minimax import descend_norm
from synth.design.descent.refine import refine
from synth.design.descent.starts import stabilise
from synth.design.static import static_output_feedback
from synth.design.two_step import l_matrix, nullspace, r_matrix
from synth.lmi.central_path import central_path
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError
from tests.benchmarks.compleib import held
from tests.benchmarks.compleib import main as compleib
from tests.support.commands import attacks
from tests.synth.test_discrete import random_plant as discrete_plant
from tests.synth.test_noise import noisy

Posed = tuple[GeneralizedPlant, np.ndarray, np.ndarray | None]
CY = {"I": np.eye(4)[[0, 2]], "II": np.eye(4)[[2]]}


def random_plant(seed: int, n=5, m=2, r=2, feedthrough=0.0) -> tuple[GeneralizedPlant, np.ndarray]:
    """A random plant, a little unstable, with a penalty on u, and what two of its sensors see."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    plant = GeneralizedPlant(
        A=A - (np.linalg.eigvals(A).real.max() - 0.1) * np.eye(n),
        B=rng.standard_normal((n, m)),
        Bw=rng.standard_normal((n, r)),
        C=np.vstack([rng.standard_normal((2, n)), np.zeros((m, n))]),
        D=np.vstack([np.zeros((2, m)), np.eye(m)]),
        Dw=feedthrough * rng.standard_normal((2 + m, r)),
    )
    return plant, rng.standard_normal((2, n))


def stable_point(plant: GeneralizedPlant, Cy: np.ndarray) -> tuple[Landscape, np.ndarray]:
    landscape = Landscape(plant.measured(Cy))
    x = stabilise(landscape, np.zeros(Cy.shape[0] * plant.B.shape[1]), np.full(4, 1e6), patient=False)
    assert x is not None
    return landscape, x


def continuous(seed: int, feedthrough: float) -> Posed:
    """A random plant without noise."""
    return *random_plant(seed, feedthrough=feedthrough), None


def sampled(seed: int, noise: float) -> Posed:
    """A discrete random plant, whose measurements see the disturbance if `noise` is one."""
    plant, Cy = discrete_plant(seed, radius=0.9)
    return plant, Cy, noise * np.random.default_rng(seed).standard_normal((len(Cy), plant.Bw.shape[1]))


@pytest.mark.parametrize(
    ("pose", "seed", "more"),
    [
        *((continuous, seed, feedthrough) for seed, feedthrough in ((0, 0.0), (3, 0.3))),
        *((noisy, seed, 0.7) for seed in (0, 4)),
        *((sampled, seed, seed % 2) for seed in (2, 3)),
        *attacks(
            [(continuous, 4, 0.3), *((noisy, seed, 0.7) for seed in (2, 6, 8)), *((sampled, s, s % 2) for s in range(4, 8))]
        ),
    ],
)
def test_landscape(pose, seed, more):
    """Height is the norm of the loop, slope and curvature are difference quotients, and no cut exceeds it: of every plant."""
    plant, Cy, Dyw = pose(seed, more)
    landscape, rng = Landscape(plant.measured(Cy, Dyw)), np.random.default_rng(seed)
    start = landscape.point(0.02 * rng.standard_normal(landscape.shape))
    x = stabilise(landscape, start, np.full(len(start), 1e6), patient=False)
    assert x is not None
    larger, gain = plant.measured(Cy, Dyw).with_law(static_law(landscape.gain(x)))
    height, at = landscape.norm(x)
    assert height == pytest.approx(hinf_norm(larger.closed_loop(gain)).value, rel=1e-8)  # where each stops
    slope, steps = landscape.slope(x, at), np.eye(len(x))
    quotients = [(landscape.norm(x + 1e-5 * step)[0] - landscape.norm(x - 1e-5 * step)[0]) / 2e-5 for step in steps]
    np.testing.assert_allclose(slope, quotients, atol=1e-3 * float(np.linalg.norm(slope)))  # 1e-9 / 1e-5
    summits = landscape.summits(x, 0.5 * height)
    cuts = landscape.cuts(x, summits[np.isfinite(summits)], 0.0)
    assert landscape.heights(x, cuts)[0].max() == pytest.approx(height, rel=1e-6)  # a flat top, found by parabolas
    for step in 0.01 * rng.standard_normal((5, len(x))):  # as functions of the gain, too, they stay below it
        assert np.all(landscape.heights(x + step, cuts)[0] <= landscape.norm(x + step)[0] * (1 + 1e-8))
    if np.isinf(at):  # z = -1 of a discrete plant
        return
    # The second derivative of the norm, whose peak moves with the gain, is the difference quotient of its slope.
    curvature = landscape.curvature(x, landscape.cuts(x, np.array([at]), 2 * height), np.ones(1))
    slopes = [[landscape.slope(x + h * step, landscape.norm(x + h * step)[1]) for h in (1e-4, -1e-4)] for step in steps]
    bends = [(up - down) / 2e-4 for up, down in slopes]
    np.testing.assert_allclose(curvature, bends, atol=5e-2 * float(np.abs(curvature).max()))  # the peak's frequency, 1e-5 / 1e-4


@pytest.mark.parametrize("seed", [4, *attacks((0, 3))])
def test_state_feedback_by_descent_is_the_lmi_optimum(seed):
    """With every state measured, static output feedback is state feedback: the descent reaches the optimum of (22), or above."""
    plant, _ = random_plant(seed)
    n = len(plant.A)
    optimum = central_path(plant, np.zeros((n, 0)), np.eye(n), 1e-6)[-1].gamma
    landscape = Landscape(plant.measured(np.eye(n)))
    start = landscape.point(central_path(plant, np.zeros((n, 0)), np.eye(n), 1.0)[-1].K)
    _, norm = descend_norm(landscape, start, np.full(len(start), 1e4), 150)
    assert norm == pytest.approx(optimum, rel=2e-3)  # the infimum of two of them lies at infinite gain; measured 4e-5 to 1e-3
    assert norm > optimum * (1 - 1e-5)  # mu = 1e-6 leaves (2 n + d) 1e-6 in eta


@pytest.mark.parametrize("seed", range(5))
def test_a_stabilising_gain_starts_the_iteration_of_14(seed):
    """With L (14) from the X that proves any stabilising gain, (25) is feasible and its bound no worse."""
    plant, Cy = random_plant(seed)
    try:
        landscape, x = stable_point(plant, Cy)
    except AssertionError:
        pytest.skip("this start leads to no stabilising gain")
    certificate = certify_tightly(plant, landscape.gain(x) @ Cy)
    assert certificate.proof is not None
    assert certificate.bound is not None
    Q = nullspace(Cy)
    point = central_path(plant, Q, r_matrix(Cy, Q, l_matrix(certificate.proof.X, Cy, Q)), 1e-4)[-1]
    assert point.gamma <= certificate.bound * (1 + 2e-3)  # the path stops (2 n + d) mu short in eta


@pytest.mark.parametrize("feedthrough", [0.0, 0.3])
def test_proof_by_riccati(feedthrough):
    """The norm of a given gain is proved by an X from a Riccati equation, to a millionth."""
    plant, Cy = random_plant(3, feedthrough=feedthrough)
    landscape, x = stable_point(plant, Cy)
    certificate = certify_tightly(plant, landscape.gain(x) @ Cy)
    assert certificate.failures == ()
    assert certificate.bound == pytest.approx(certificate.norm.value, rel=2e-6)  # the first of MARGINS


@pytest.mark.parametrize(("name", "norm"), [("I", 7.83699), ("II", 7.83690)])
def test_refinement_is_bounded(designer, name, norm):
    """Refinement of the paper's controllers comes within 7e-5 of the best any controller could do, and the gain hardly grows.

    The same descent without the stages walks controller I to [-72240, -82631].
    """
    K = designer.design(name).gain
    refined = refine(designer.plant, CY[name], K)
    certificate = certify(designer.plant, refined.gain @ CY[name])
    assert certificate.failures == ()
    assert certificate.norm.value == pytest.approx(refined.after, rel=1e-8)
    assert designer.state_feedback.gamma * (1 - 1e-8) <= refined.after <= norm
    assert np.abs(refined.gain).max() <= 2 * np.abs(K).max()
    assert "gamma" in refined.trade_off_text


def test_what_is_unstable_is_not_refined(designer):
    """A gain that does not stabilise is refused."""
    with pytest.raises(DesignError, match="does not stabilise"):
        refine(designer.plant, CY["II"], np.array([[1e5]]))


def test_no_stabilising_gain_is_said():
    """x'' = x + u with only x' measured: u = k x' cannot stabilise it, and the strategy says that it found nothing."""
    plant = GeneralizedPlant(
        A=np.array([[0.0, 1.0], [1.0, 0.0]]),
        B=np.array([[0.0], [1.0]]),
        Bw=np.array([[0.0], [1.0]]),
        C=np.eye(2),
        D=np.zeros((2, 1)),
        Dw=np.zeros((2, 1)),
    )
    with pytest.raises(DesignError, match=r"^no static gain found; measure more signals"):
        static_output_feedback(plant, np.array([[0.0, 1.0]]))


def test_table_of_plants(tmp_path, capsys):
    """The benchmark's table and JSON: each plant of a file with its bounds, gain and time; one with D21 is left out."""
    plants = {}
    for name, seed in (("first", 0), ("second", 3), ("with_d21", 4)):
        plant, _ = random_plant(seed, n=3, m=1)
        Cy = np.eye(3)[:2]
        D21 = np.zeros((2, 2)) if name != "with_d21" else np.eye(2)
        plants[name] = {
            "A": plant.A, "B": plant.B, "B1": plant.Bw, "C1": plant.C, "D12": plant.D, "D11": plant.Dw, "C": Cy, "D21": D21,
        }  # fmt: skip
    file = tmp_path / "plants.json"
    file.write_text(json.dumps({name: {key: matrix.tolist() for key, matrix in data.items()} for name, data in plants.items()}))
    assert compleib([str(file), "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["plants"]
    assert [row["plant"] for row in rows] == ["first", "second"]
    for row in rows:
        assert set(row) >= {
            "plant",
            "two_step_norm",
            "norm",
            "bound",
            "lower_bound",
            "gap",
            "origin",
            "gain",
            "seconds",
            "reason",
        }
        assert row["norm"] <= row["bound"] <= row["norm"] * (1 + 1e-5)  # the first margin of the proof, or the next
        assert row["gap"] == pytest.approx(row["norm"] / row["lower_bound"] - 1)
        assert row["lower_bound"] * (1 - 1e-9) <= row["norm"] <= (row["two_step_norm"] or np.inf) * (1 + 1e-9)
    assert compleib([str(file), "--only", "second"]) == 0
    printed = capsys.readouterr().out
    assert "1 of 1 with a certified gain" in printed
    for key in ("two_step_norm", "norm", "bound", "lower_bound"):
        assert f" {rows[1][key]:.7g} " in printed
    assert f"from {rows[1]['origin']}" in printed
    with pytest.raises(InputError, match="unknown plant 'third'"):
        compleib([str(file), "--only", "third"])


@pytest.mark.attack
def test_table_of_held_plants(tmp_path, capsys):
    """With --dt a plant is held and designed as a discrete one: the norm is that of its gain there, bad periods are refused."""
    plant, _ = random_plant(3, n=3, m=1)
    named = {"A": plant.A, "B": plant.B, "B1": plant.Bw, "C1": plant.C, "D12": plant.D, "D11": plant.Dw, "C": np.eye(3)[:2]}
    data = {key: matrix.tolist() for key, matrix in named.items()} | {"D21": np.zeros((2, plant.Bw.shape[1])).tolist()}
    file = tmp_path / "plants.json"
    file.write_text(json.dumps({"one": data}))
    assert compleib([str(file), "--dt", "0.02", "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["plants"]
    loop = held(plant, 0.02).closed_loop(np.array(row["gain"]) @ np.eye(3)[:2])
    assert loop.dt == 0.02
    assert hinf_norm(loop).value == pytest.approx(row["norm"], rel=1e-9)
    assert row["lower_bound"] * (1 - 1e-9) <= row["norm"] <= row["bound"]
    for bad in (["0"], ["-1"], ["nan"], ["often"], []):
        with pytest.raises(InputError, match=r"is not a sample period; give seconds above 0"):
            compleib([str(file), "--dt", *bad])


def test_plant_that_fails_is_a_row(tmp_path, capsys):
    """A plant whose matrices do not fit, or are no numbers, has a row that says why; the others have theirs as ever."""
    matrix = {"A": [[-1.0]], "B": [[1.0]], "B1": [[1.0]], "C1": [[1.0], [0.0]], "D12": [[0.0], [1.0]], "D11": [[0.0], [0.0]]}
    good = {**matrix, "C": [[1.0]], "D21": [[0.0]]}
    file = tmp_path / "plants.json"
    file.write_text(json.dumps({"good": good, "misfit": {**good, "B": [[1.0], [2.0]]}, "words": {**good, "C": [["much"]]}}))
    assert compleib([str(file), "--json"]) == 1
    fine, *failed = json.loads(capsys.readouterr().out)["plants"]
    assert fine["norm"] == pytest.approx(0.5**0.5, rel=1e-3)  # |s + 1 - k|^-1 and |k| times it: k = -1, where they are equal
    assert fine["reason"] is None
    assert [row["norm"] for row in failed] == [None, None]
    assert "B has shape (2, 1)" in failed[0]["reason"]
    assert "could not convert" in failed[1]["reason"]
    assert compleib([str(file)]) == 1
    assert "1 of 3 with a certified gain" in capsys.readouterr().out
    file.write_text(json.dumps({"good": {key: good[key] for key in good if key != "D21"}}))
    with pytest.raises(InputError, match="plant 'good' has no D21"):
        compleib([str(file)])
