"""Whatever the plant: a design, a bound or a certificate, or one line that says why there is none; and nothing on stderr."""

import math
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import linalg

import synth
from models.common.errors import InputError
from synth.analysis.bounding import certify_tightly
from synth.analysis.certificate import certify
from synth.design.descent.refine import refine, worth_refining
from synth.design.methods import design as design_for
from synth.design.problem import DesignProblem
from synth.design.static import static_output_feedback
from synth.design.two_step import state_design, two_step_design, zero_l_design
from synth.lmi.full_order_bound import find_lower_bound
from synth.plant.generalized import SHAPES, Feedback, GeneralizedPlant
from synth.plant.numerics import DesignError, numerics, up_to_rounding
from tests.support.commands import attacks

LONG = 20.0  # s of processor time, of one call for a plant of at most six states
FAMILIES = (
    *("stable", "unstable", "integrators", "undamped", "unseen", "zero"),
    *("dependent", "scales", "tiny", "huge", "sparse", "units"),
)
PARTS = ("A", "B", "Bw", "C", "D", "Dw", "Cy")


def drawn(seed: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """A random plant, of one family or of three at once, and what is measured."""
    rng = np.random.default_rng(seed)
    n, m, q, d, r = (int(rng.integers(low, high)) for low, high in ((1, 7), (1, 4), (1, 5), (1, 5), (1, 4)))
    shapes = ((n, n), (n, m), (n, r), (d, n), (d, m), (d, r), (q, n))
    parts = {name: rng.standard_normal(shape) for name, shape in zip(PARTS, shapes, strict=True)}
    parts["Dw"] *= 0.1 * (rng.random() < 0.3)
    parts["D"] *= rng.random() < 0.85
    if rng.random() < 0.3:
        parts["Cy"] = np.eye(n)[rng.integers(0, n, q)]
    chosen = [FAMILIES[seed % len(FAMILIES)]] if seed % 3 else list(rng.choice(FAMILIES, 3, replace=False))
    for family in chosen:
        made(family, parts, rng)
    Cy = parts.pop("Cy")
    return parts, Cy


def made(family: str, parts: dict[str, np.ndarray], rng: np.random.Generator) -> None:
    """Makes the parts of a plant those of a family."""
    A = parts["A"]
    n = len(A)
    match family:
        case "stable":
            parts["A"] = A - (np.abs(np.linalg.eigvals(A)).max() + 0.1) * np.eye(n)
        case "integrators":
            parts["A"] = np.triu(np.round(A), 1)
        case "undamped":
            parts["A"] = np.round(2 * A) - np.round(2 * A).T
        case "unseen":
            parts["C"][:, 0] = parts["A"][1:, 0] = 0
        case "zero":
            for name in rng.choice(PARTS, 2):
                parts[name] = 0 * parts[name]
        case "dependent":
            for name in rng.choice(PARTS, 3):
                parts[name][-1] = parts[name][0] + 10.0 ** rng.uniform(-16, -3) * parts[name][-1]
        case "scales":
            each = 10.0 ** rng.uniform(-12, 12, n)
            for name in ("A", "B", "Bw"):
                parts[name] = parts[name] / each[:, None]
            for name in ("A", "C", "Cy"):
                parts[name] = parts[name] * each
        case "tiny" | "huge":
            sizes = (1e-160, -1e-160, 1e-300, 5e-324, 1e-49, 1e-30, -1e-17) if family == "tiny" else (1e49, -1e30, 1e12, 1e20)
            for name in rng.choice(PARTS, 4):
                parts[name].flat[rng.integers(parts[name].size)] = rng.choice(sizes)
        case "sparse":
            for name in PARTS:
                parts[name] = np.round(parts[name]) * (rng.random(parts[name].shape) < 0.5)
        case "units":
            parts[str(rng.choice(PARTS))] *= 10.0 ** rng.choice([-50, -40, -20, 20, 40, 49])


def asked(what: Callable[[], Any]) -> Any:
    """Returns what a call returns, or None where it says in one line why it does not; anything else fails."""
    start, said, found = time.process_time(), "because", None
    try:
        found = what()
    except InputError as error:
        said = str(error)
    assert time.process_time() - start < LONG
    assert said
    assert "\n" not in said
    return found


def ask_everything(seed: int, search: bool) -> None:
    """Every public function, of one plant."""
    parts, Cy = drawn(seed)
    A, B, Bw, C, D, Dw = (parts[name] for name in SHAPES)
    plant = asked(lambda: GeneralizedPlant(A, B, Bw, C, D, Dw))
    if plant is None:
        return
    rng, m = np.random.default_rng(seed), plant.B.shape[1]
    asked(lambda: state_design(plant))
    design = asked(lambda: two_step_design(plant, Cy))
    asked(lambda: zero_l_design(plant.measured(Cy)))
    asked(lambda: find_lower_bound(plant))
    below = asked(lambda: find_lower_bound(plant, Cy))
    K = rng.standard_normal((m, len(Cy))) * 10.0 ** rng.uniform(-20, 12) if design is None else design.gain
    u = Feedback(K, Cy)
    for found in (asked(lambda: certify(plant, u)), asked(lambda: certify_tightly(plant, u, below))):
        assert found is None or found.failures or np.isfinite(found.norm.value)
    asked(lambda: refine(plant, Cy, K))
    asked(lambda: worth_refining(plant.measured(Cy), K))
    if search:
        asked(lambda: static_output_feedback(plant, Cy, lower_bound=below))
        asked(lambda: design_for(DesignProblem(plant.measured(Cy), alternatives=False)))


@pytest.mark.attack
@pytest.mark.parametrize("seed", [*range(10), *range(1000, 1000 + len(FAMILIES))])
def test_no_plant_is_too_odd(seed, capfd):
    """For a random plant, stable or not, in any units, with any zeros, every function answers in time, without a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ask_everything(seed, search=seed == 0)
    assert capfd.readouterr() == ("", "")


def every_function(plant: GeneralizedPlant, q: int, rng: np.random.Generator) -> Iterator[Callable[[], Any]]:
    """Calls of every public function of plants, with q measurements, as arrays and as lists."""
    (n, m), r = plant.B.shape, plant.Bw.shape[1]
    arrays: Any = rng.standard_normal((q, n)), -0.01 * rng.standard_normal((m, q)), rng.standard_normal((q, r)), np.ones((m, q))
    for Cy, K, Dyw, anywhere in (arrays, [each.tolist() for each in arrays]):
        yield lambda Cy=Cy: synth.design_feedback(plant, Cy)
        yield lambda Cy=Cy, Dyw=Dyw: synth.design_feedback(plant, Cy, Dyw, order="full")
        yield lambda Cy=Cy: synth.design_feedback(plant, Cy, sample_period=0.1)
        yield lambda Cy=Cy: synth.design_feedback(plant, Cy, bounds=[{"gain": 3.0}])
        yield lambda Cy=Cy: synth.two_step_design(plant, Cy)
        yield lambda Cy=Cy, Dyw=Dyw: synth.static_output_feedback(plant, Cy, Dyw=Dyw)
        yield lambda Cy=Cy, K=K: synth.refine(plant, Cy, K)
        yield lambda Cy=Cy: synth.design_feedback(plant, Cy, family=[plant.measured(Cy)])
        yield lambda Cy=Cy, Dyw=Dyw: synth.full_order_design(plant, Cy, Dyw)
        yield lambda: synth.lqr_design(plant)
        yield lambda Cy=Cy: synth.lqg_design(plant, Cy, [0.1] * q)
        yield lambda Cy=Cy, Dyw=Dyw: synth.h2_design(plant, Cy, Dyw)
        yield lambda Cy=Cy: synth.find_lower_bound(plant, Cy)
        yield lambda: synth.find_lower_bound(plant)
        yield lambda Cy=Cy, K=K: synth.certify(plant, synth.Feedback(K, Cy))
        yield lambda: synth.hinf_norm(plant)
        yield lambda: synth.norm_in_band(plant, 1.0, 2.0)
        yield lambda Cy=Cy, K=K: synth.worst_norm(plant, Cy, K, np.full(q, 0.1), np.full(m, 0.1))
        yield lambda Cy=Cy, anywhere=anywhere, K=K: synth.multi_objective_design(
            synth.MultiObjectiveProblem(
                (synth.FamilyMember((synth.MeasuredPlant(plant, Cy),)),),
                synth.NormSpecification(),
                synth.GainErrors(np.zeros(q), np.zeros(m)),
                anywhere,
                gain=3.0,
            ),
            starts=[K],
        )
        yield lambda: synth.sampled_norm(
            synth.SampledLoop(plant, (synth.HoldInterval(0.1, 0),), np.zeros((m, n)), np.zeros((0, n)), np.zeros((0, m))), 1.0
        )


@pytest.mark.parametrize(
    ("n", "m", "q", "dt"),
    [
        (2, 0, 1, None),
        (2, 1, 0, 0.1),
        (0, 1, 1, None),
        *attacks([(2, 0, 1, 0.1), (2, 1, 0, None), (0, 1, 1, 0.1), (0, 0, 0, None), (0, 0, 0, 0.1)]),
    ],
)
def test_what_is_missing_is_said(n, m, q, dt):
    """Without an input, a measurement or a state every public function answers, or says in one line what is missing."""
    rng = np.random.default_rng(1)
    A = 0.3 * rng.standard_normal((n, n)) - (dt is None) * np.eye(n)
    B, Bw, C, D = (rng.standard_normal(shape) for shape in ((n, m), (n, 1), (2, n), (2, m)))
    plant = GeneralizedPlant(A, B, Bw, C, D, np.zeros((2, 1)), dt=dt)
    for call in every_function(plant, q, rng):
        asked(call)


def test_a_plant_s_own_measurements():
    """Matrices of measurements that the plant contains count as if they were given to each function."""
    rng, (Cy, Dyw, K) = np.random.default_rng(2), (np.array([[0.0, 1.0]]), np.array([[0.0, 0.1]]), np.array([[-2.0]]))
    A, B, C, D = map(np.array, ([[0, 1], [-4, -0.1]], [[0], [1]], [[1, 0], [0, 0]], [[0], [1]]))
    plant = GeneralizedPlant(A, B, rng.standard_normal((2, 2)), C, D, 0 * np.eye(2))
    own = replace(plant, Cy=Cy, Dyw=Dyw)
    for call in (
        lambda one, *y: synth.full_order_design(one, *y).law.A,
        lambda one, *y: synth.h2_design(one, *y).law.A,
        lambda one, *y: synth.worst_norm(one, y[0] if y else None, K, 0.1, 0.0, *y[1:]).found,
        lambda one, *y: synth.find_lower_bound(one, *y[:1], **({"Dyw": y[1]} if y else {})).gamma,
    ):
        np.testing.assert_array_equal(call(plant, Cy, Dyw), call(own))


def test_without_an_input_the_lower_bound_is_the_norm():
    """What no input changes is the norm itself, of continuous and discrete plants."""
    for dt in (None, 0.1):
        A = np.array([[-1.0, 2.0], [0.0, -3.0]]) if dt is None else np.array([[0.5, 0.3], [0.0, 0.2]])
        plant = GeneralizedPlant(A, np.zeros((2, 0)), np.ones((2, 1)), np.eye(2), np.zeros((2, 0)), np.zeros((2, 1)), dt=dt)
        assert find_lower_bound(plant).gamma == pytest.approx(synth.hinf_norm(plant).value, rel=1e-4)  # the path's end


def test_what_does_not_fit_is_no_rounding():
    """A mistake of this package's own, as shapes that do not fit, is never said to be rounding, nor ends a search in silence."""
    wrong = (
        lambda: np.ones(12) + np.ones(4),
        lambda: np.ones((2, 3)) @ np.ones((2, 3)),
        lambda: np.linalg.inv(np.ones((2, 3))),
        lambda: np.linalg.eigvals(np.ones(3)),
        lambda: linalg.solve_continuous_lyapunov(np.eye(2), np.eye(3)),
        lambda: linalg.solve(np.eye(2), np.ones(3)),
        lambda: [*zip([1], [1, 2], strict=True)],
        lambda: float("nonsense"),
    )
    for mistake in wrong:
        for within in (numerics, up_to_rounding):
            with pytest.raises(ValueError) as raised, within():  # noqa: PT011 - whatever numpy says
                mistake()
            assert not isinstance(raised.value, InputError)
    with pytest.raises(InputError, match="Cy has no rows"), numerics():  # bad input stays what it is
        raise InputError("Cy has no rows")
    with numerics():
        assert np.array([1e300]) * 1e300 == np.inf  # overflow is silent
    for answer in (
        lambda: np.linalg.inv(np.zeros((2, 2))),
        lambda: np.linalg.cholesky(-np.eye(2)),
        lambda: linalg.eigvals(np.full((2, 2), np.nan)),
        lambda: linalg.solve(np.zeros((2, 2)), np.ones(2)),
        lambda: np.linalg.eigvals(np.full((2, 2), np.inf)),
        lambda: linalg.solve_continuous_are(np.eye(2), np.zeros((2, 1)), np.eye(2), np.eye(1)),
        lambda: math.log(-1.0),
        lambda: int(float("nan")),
    ):
        with up_to_rounding():
            answer()
        with pytest.raises(DesignError, match="rounding errors prevent a result"), numerics():
            answer()
