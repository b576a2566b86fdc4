"""Lower bounds: proved by numpy, below every controller, close to the best one."""

import numpy as np
import pytest

from synth.limit import invariant_limit, uncontrolled
from synth.lower_bound import evaluate, lower_bound
from synth.state_feedback import state_feedback
from tests.test_static import random_plant


def test_paper_bound(designer):
    """On the paper's car the dual proves gamma* to 6e-5, and the invariant limit proves it to rounding."""
    best = designer.state_feedback.gamma
    dual = lower_bound(designer.plant, state_feedback(designer.plant, 1e-5)[-1])
    assert best * (1 - 6e-5) < dual.gamma < best  # (2 n + d) mu / 2 = 6e-5
    limit, at = invariant_limit(designer.plant)
    assert limit == pytest.approx(7.83645764, rel=1e-8)  # gamma*, given with 9 digits
    assert at == pytest.approx(63.757, abs=1e-3)  # where the norm of the printed G_s peaks


@pytest.mark.parametrize("feedthrough", [0.0, 0.2])
@pytest.mark.parametrize("seed", range(4))
def test_random_plants(seed, feedthrough):
    """On random plants the dual bound is within 2e-4 of the optimum of (22), from below, and above the invariant limit's."""
    plant, _ = random_plant(seed, feedthrough=feedthrough)
    best = state_feedback(plant, 1e-7)[-1].gamma
    bound = lower_bound(plant, state_feedback(plant, 1e-5)[-1])
    assert best * (1 - 2e-4) < bound.gamma <= best * (1 + 1e-9)  # (2 n + d) mu / 2 = 7e-5, and the projection
    assert invariant_limit(plant)[0] <= best * (1 + 1e-9)


def test_what_proves_nothing_is_zero(designer):
    """A dual matrix whose H is not positive semidefinite proves nothing, and the bound says 0."""
    n, d = len(designer.plant.A), len(designer.plant.C)
    Z = np.zeros((n + d, n + d))
    Z[:n, :n] = np.eye(n)
    Z[n:, n:] = np.eye(d)
    assert evaluate(designer.plant, Z).gamma == 0


@pytest.mark.parametrize("name", ["passive", "state", "I", "II"])
def test_no_controller_beats_the_limit_anywhere(designer, paper, name):
    """At every frequency every controller's gain is above what no control force changes."""
    omega = np.geomspace(0.1, 1e3, 300)
    loop = designer.plant.closed_loop(designer.design(name).state_gain(paper))
    gains = np.linalg.norm(loop.frequency_response(omega), 2, axis=(1, 2))
    assert np.all(gains >= uncontrolled(designer.plant, omega) * (1 - 1e-9))  # rounding
