"""Static designs against descents from many starts, independent of the project's searches, and what a search may cost."""

import numpy as np
import pytest

from models.common.arrays import Array
from synth.analysis.norm import hinf_norm
from synth.analysis.sampled_loop import HoldInterval, SampledDataProblem
from synth.analysis.sampled_norm import sampled_norm
from synth.design import static
from synth.design.descent.landscape import Work
from synth.design.feedback import FeedbackDesign, design_feedback
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError, InfeasibleError
from tests.claims.test_no_controller_beats_a_bound import of_lists
from tests.support.commands import attacks
from tests.support.multistart import Loops, best_of_many, random_case

BEHIND = 1.01  # of the lowest norm that the descents reach,
COMPARABLE = 2.0  # with gains and poles that are not larger than a design's by more than this factor

# Two measurements, which no L of the LMI stabilises the plant from, and a gain that does; sampled every 4.224 ms.
SAMPLED_STATIC = (
    of_lists(
        [
            [0.042, -1.571, 1.002, -0.098],
            [0.62, 1.837, 0.268, -1.074],
            [-0.681, 1.017, -1.457, 0.264],
            [0.375, -1.15, 0.169, 0.556],
        ],
        [[-0.773, -0.48], [0.544, -1.299], [-0.88, 0.954], [0.086, -1.416]],
        [[0.011, 1.941], [-1.513, 0.816], [0.759, -0.177], [0.605, -0.674]],
        [[1.545, 1.72, -0.88, -0.214], [0.132, -0.625, 0.353, -1.038], [0.577, -0.301, -0.049, 0.471], [0] * 4, [0] * 4],
        [[0, 0], [0, 0], [0, 0], [0.064, 0], [0, 0.064]],
    ),
    np.array([[0.926, -0.984, 0.789, 0.879], [-0.115, 1.538, -0.765, -0.545]]),
    0.004224,
)
ITS_GAIN, ITS_NORM = np.array([[-90.257, 54.303], [-177.667, 107.261]]), 26.7325


def sampled(plant: GeneralizedPlant, Cy: Array, period: float) -> SampledDataProblem:
    """The problem of a loop that is sampled without delay."""
    return SampledDataProblem(plant.measured(Cy), (HoldInterval(period, 0),))


@pytest.mark.attack
def test_a_sampled_gain_is_found_by_the_one_door():
    """A sampled static gain is designed where (25) has no solution, and ends at 6.3, a quarter of the norm of a known gain."""
    plant, Cy, period = SAMPLED_STATIC
    assert sampled_norm(sampled(*SAMPLED_STATIC).loop(ITS_GAIN), 20.0).value == pytest.approx(ITS_NORM, rel=1e-6)  # six digits
    found = design_feedback(plant, Cy, sample_period=period)
    assert found.value < 6.3  # 6.2774; 30 descents end at no less than 6.2773
    assert found.method == "descent on the sampled norm"


@pytest.mark.attack
def test_other_valleys_than_that_of_the_two_steps_are_searched():
    """If descent from the two steps ends far above the lower bound, others begin elsewhere: 10.08 before, and 0.2113 known."""
    plant, Cy, _ = random_case(44)
    known = np.array([[-8.0107316, -21.520972], [-1.7643859, -6.3957049], [-1.4781781, -4.0341964]])
    assert hinf_norm(plant.closed_loop(known @ Cy)).value == pytest.approx(0.211262, rel=1e-5)  # eight digits of the gain
    found = design_feedback(plant, Cy)
    assert found.value < 0.211262
    assert not found.certificate.beyond_actuators


def test_a_search_ends_at_a_count(monkeypatch):
    """A search that reaches its limit of work returns the best so far, the same each time, and what stopped it."""
    plant, Cy, _ = random_case(56)
    monkeypatch.setattr(static, "LIMIT", 12.0)
    found = [design_feedback(plant, Cy) for _ in range(2)]
    np.testing.assert_array_equal(found[0].gain, found[1].gain)
    assert found[0].certificate.failures == ()
    assert "the search stopped at its limit of 12 computed norms" in found[0].why


def test_a_law_with_states_ends_at_a_count(monkeypatch):
    """Of a law with states, too; and if none was found by then the message says what stopped the search."""
    plant, Cy, _ = random_case(16)
    monkeypatch.setattr(static, "LIMIT", 80.0)
    found = design_feedback(plant, Cy, order=2)
    assert found.certificate.failures == ()
    assert "the search stopped at its limit of" in found.remark


@pytest.mark.attack
@pytest.mark.parametrize(("m", "order", "seed", "period"), [(1, 6, 0, None), (3, 3, 1, None), (3, 6, 1, 0.02)])
def test_no_design_of_eight_states_takes_long(m, order, seed, period, monkeypatch):
    """A design of 8 unstable states ends at the limit of its work, and finds a law or says what stopped it."""
    made, begin = list[Work](), Work.__init__

    def counted(self: Work, limit: float = np.inf) -> None:
        begin(self, limit)
        made.append(self)

    monkeypatch.setattr(Work, "__init__", counted)
    g, said = np.random.default_rng(seed), ""
    A = g.standard_normal((8, 8))
    A = A - (np.linalg.eigvals(A).real.max() - 2.0) * np.eye(8)
    B, Bw = g.standard_normal((8, m)), g.standard_normal((8, 2))
    C = np.vstack([g.standard_normal((2, 8)), np.zeros((m, 8))])
    D = np.vstack([np.zeros((2, m)), 0.1 * np.eye(m)])
    plant = GeneralizedPlant(A, B, Bw, C, D, np.zeros((2 + m, 2)))
    try:
        design_feedback(plant, g.standard_normal((m, 8)), order=order, sample_period=period)
    except InfeasibleError:
        raise
    except DesignError as error:
        said = str(error)
    spent = sum(one.done for one in made)
    assert spent < 1.15 * static.LIMIT  # a descent that is under way is finished; 7 to 18 s of processor time
    assert not said or "stopped at its limit" in said or said.startswith("no static gain found")


def check_not_behind(plant: GeneralizedPlant, Cy: Array, found: FeedbackDesign | None, ends: list[tuple[float, Array]]) -> None:
    """Checks that a design is not behind gains that are not much larger, nor their loops much faster.

    Args:
        ends: norms and gains.
    """
    loops = Loops(plant, Cy)

    def size(K: Array) -> tuple[float, float]:
        return float(np.abs(K / loops.unit).max()), float(np.abs(np.linalg.eigvals(plant.A + plant.B @ K @ Cy)).max())

    for norm, K in ends:
        if found is not None:
            comparable = all(its <= COMPARABLE * own for its, own in zip(size(K), size(found.gain), strict=True))
            assert not comparable or found.value <= BEHIND * norm
        else:
            assert not np.isfinite(norm)


@pytest.mark.parametrize("seed", [1, *attacks(range(0, 60, 5))])
def test_no_static_design_is_behind_many_descents(seed):
    """No static design of a random plant is more than 1 % behind the best of 30 descents with comparable gains."""
    plant, Cy, _ = random_case(seed)
    ends = best_of_many(plant, Cy, seed)[:6]
    found = _found(plant, Cy)
    check_not_behind(plant, Cy, found, [(hinf_norm(plant.closed_loop(K @ Cy)).value, K) for K in ends])


@pytest.mark.attack
@pytest.mark.parametrize("seed", range(2, 60, 12))
def test_no_sampled_static_design_is_behind_many_descents(seed):
    """No static design for a sampled loop is more than 1 % behind the best of 30 descents with comparable gains."""
    plant, Cy, period = random_case(seed)
    problem, level, ends = sampled(plant, Cy, period), 1e4, list[tuple[float, Array]]()
    for starts in (30, 4):  # far above the norm the plant of a level has nearly that norm; then at the level reached
        at = problem.at(level)
        assert at is not None
        found = best_of_many(at, Cy, seed, starts, tuple(K for _, K in ends))[:6]
        ends = sorted([*ends, *((sampled_norm(problem.loop(K), 1.0).value, K) for K in found)], key=lambda end: end[0])
        if not ends or not np.isfinite(ends[0][0]):
            break
        level = 1.02 * ends[0][0]
    check_not_behind(plant, Cy, _found(plant, Cy, period), ends)


def _found(plant: GeneralizedPlant, Cy: Array, period: float | None = None) -> FeedbackDesign | None:
    try:
        return design_feedback(plant, Cy, sample_period=period)
    except DesignError:
        return None
