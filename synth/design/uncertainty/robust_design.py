"""D-K iteration: design of a law with better robust performance (smaller mu) than the law with the smallest norm.

For a given law, the best scale of each error is a function of frequency. A stable first-order filter with a stable inverse
approximates the magnitude of the best scale at frequencies where mu is large. If the filters for all errors are added at inputs
and outputs of the loop, the norm of the loop bounds mu from above. A design that minimises the norm lowers the bound on mu (D-K
iteration; Doyle 1985; Zhou, Doyle, Glover 1996, Robust and Optimal Control, section 11.4). Each of the two steps, scaling and
design, is nearly optimal, but alternating between the steps need not find the best law. Each law is evaluated by a separately
proved bound on mu, and the best law is kept.
"""

from dataclasses import replace

import numpy as np
from scipy import optimize

from models.common.arrays import Array
from models.common.printed import digits
from models.laws.design_methods import FULL
from models.laws.linear import LinearLaw
from synth.analysis.lower_bounds.lower_bound import LowerBound
from synth.design.methods import design
from synth.design.problem import MU, DesignProblem, DesignResult, Progress
from synth.design.uncertainty.structured_bound import best_scales, structured_bound
from synth.design.uncertainty.structured_loop import StructuredLoop
from synth.plant.augmented import append, gain, with_weights
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError
from synth.plant.state_space import StateSpace

TURNS = 6
WORTH = 2e-3  # the iteration ends if the bound decreases by less than this relative amount
STEEP = 4  # in the fit of a filter, the weight of a frequency is mu to this power


def mu(problem: DesignProblem, progress: Progress) -> DesignResult:
    """Designs a law with better robust performance than the result of the previous method.

    If no better law is found, the previous result is returned.

    For a law with fewer states than the plant, the iteration begins with the scales of a full-order law.
    """
    start, errors, structure = problem.start, problem.errors, problem.structure
    assert start is not None, "a design for the norm comes first"
    assert errors is not None, "weighted errors"
    first = replace(start, value=structured_bound(errors.closed_by(problem.as_run(start.law))).gamma, criterion=MU)
    best = [first]

    def turns(problem: DesignProblem, law: LinearLaw) -> DesignResult:
        """Computes the scales for a law, designs a law for these scales, and repeats both steps several times. Returns the law
        with the smallest bound on mu.
        """
        lowest, loop = first, errors.closed_by(problem.as_run(law))
        of_state = np.any(errors.plant.Cy != 0, axis=1)
        for _ in range(TURNS):
            plant = scaled_plant(errors.plant, errors.errors, scaling_filters(loop)).rows(of_state).without_feedthrough
            try:
                found = design(replace(problem, plant=plant))
            except DesignError:
                break
            own = problem.as_run(found.law)
            loop = errors.closed_by(own)
            gamma, before = structured_bound(loop).gamma, lowest.value
            if gamma < before:
                lowest = replace(found, value=gamma, criterion=MU)
                if structure is None or own.states <= structure.order:
                    best[:] = [lowest]
            progress(lowest.value, True)
            if not gamma < before * (1 - WORTH):
                break
        return lowest

    unbounded = replace(problem, errors=None, start=None, lower_bound=LowerBound(0.0), states=(), certify=None)
    full = turns(replace(unbounded, order=FULL, structure=None), start.law)
    if structure is not None:
        turns(unbounded, full.law)
    if best[0] is first:
        return start
    remark = (
        "designed for the smallest robust performance (mu), by design and scaling of errors in turn; the law with the smallest "
        f"norm, {digits(start.certificate.norm.value)}, has mu = {digits(first.value)}"
    )
    return replace(best[0], certificate=problem.certified(best[0].law), remarks=(remark,))


def scaled_plant(plant: Plant, k: int, filters: list[tuple[StateSpace, StateSpace]]) -> Plant:
    """Returns the plant with scaling filters at the inputs and outputs of the k errors.

    Args:
        filters: two filters for each error: the filter that scales q, and the inverse filter, whose output is p.
    """
    outputs = append(gain(np.eye(len(plant.C) - k)), *(scale for scale, _ in filters))
    inputs = append(gain(np.eye(plant.Bw.shape[1] - k)), *(inverse for _, inverse in filters))
    return with_weights(plant, outputs, inputs)


def scaling_filters(loop: StructuredLoop) -> list[tuple[StateSpace, StateSpace]]:
    """Returns two filters for each error: a first-order fit to the best scale as a function of frequency, and the inverse
    filter.
    """
    k, grid, units = loop.errors, loop.grid, loop.units
    M = loop.at(grid)
    M[:, -k:] *= units[:, None]
    M[:, :, -k:] /= units
    values, scales, last = np.zeros(len(grid)), np.zeros((len(grid), k)), np.zeros(k)
    for i, one in enumerate(M):
        values[i], last = best_scales(one, k, last)
        scales[i] = last
    weight = (values / values.max()) ** STEEP
    return [_first_order(grid, scales[:, i] + np.log(units[i]), weight) for i in range(k)]


def _first_order(grid: Array, logarithms: Array, weight: Array) -> tuple[StateSpace, StateSpace]:
    """Returns the filter g (s + a) / (s + b), fitted to a magnitude as a function of frequency, and the inverse filter."""
    low, high = np.log(grid[[0, -1]])

    def off(x: Array) -> Array:
        a, b = np.exp(2 * x[1:])
        return weight * (x[0] + (np.log(grid**2 + a) - np.log(grid**2 + b)) / 2 - logarithms)

    level, middle = float(np.average(logarithms, weights=weight)), float(np.average(np.log(grid), weights=weight))
    best = min(
        (
            optimize.least_squares(off, [level, *start], bounds=([-np.inf, low, low], [np.inf, high, high]))
            for start in ((middle - 1, middle + 1), (middle + 1, middle - 1))
        ),
        key=lambda one: one.cost,
    )
    g, (a, b) = np.exp(best.x[0]), np.exp(best.x[1:])
    return _system(g, a, b), _system(1 / g, b, a)


def _system(g: float, a: float, b: float) -> StateSpace:
    """Returns the filter g (s + a) / (s + b)."""
    size = np.sqrt(abs(a - b))
    return StateSpace(np.array([[-b]]), np.array([[size]]), np.array([[g * np.sign(a - b) * size]]), np.array([[g]]))
