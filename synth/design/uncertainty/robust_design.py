"""A law whose robust performance is better than that of the least norm: alternately scales for the law, and a law for the scales.

For a law the best scales of each error are a curve over frequency. A stable first-order filter with a stable inverse follows its
magnitude where mu is large. Between these filters the plant has a norm that bounds mu, and a design of the least norm lowers it
(D-K iteration; Doyle 1985; Zhou, Doyle, Glover 1996, Robust and Optimal Control, section 11.4). Either step is the best by itself
and not both together, so there is no promise of the best law. Each law is judged by its own proved bound, and the best is kept.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from models.common.arrays import Array
from models.laws.linear import LinearLaw
from synth.design.uncertainty.structured_bound import best_scales, structured_bound
from synth.design.uncertainty.structured_loop import StructuredLoop, StructuredPlant
from synth.plant.augmented import append, gain, with_weights
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError
from synth.plant.state_space import StateSpace

TURNS = 6
WORTH = 2e-3  # relative; a turn that lowers the bound by less is the last
STEEP = 4  # power of mu in the weight of a frequency

Design = Callable[[Plant], LinearLaw]


@dataclass(frozen=True, eq=False)
class RobustDesign:
    """A law with its robust performance.

    Attributes:
        law: law on y.
        gamma: bound on mu with performance.
        turns: number of designs that led to it.
    """

    law: LinearLaw
    gamma: float
    turns: int = 0


def robust_design(
    structured: StructuredPlant,
    design: Design,
    start: RobustDesign,
    on_turn: Callable[[RobustDesign], None] = lambda best: None,
    scaled: LinearLaw | None = None,
) -> RobustDesign:
    """Returns the law of the least robust performance among those that designs for the scales of one another lead to.

    Args:
        structured: the plant with its errors.
        design: returns a continuous law on the measurements of a plant; may raise a DesignError.
        start: law that stabilises the plant; it is the result if the search finds no better one.
        on_turn: callback that receives the best law so far after each turn.
        scaled: law whose scales are the first; the start by default.
    """
    best, loop = start, structured.closed_by(start.law if scaled is None else scaled)
    for turn in range(1, TURNS + 1):
        try:
            law = design(scaled_plant(structured, scaling_filters(loop)))
        except DesignError:
            break
        loop = structured.closed_by(law)
        gamma, before = structured_bound(loop).gamma, best.gamma
        if gamma < before:
            best = RobustDesign(law, gamma, turn)
        on_turn(best)
        if not gamma < before * (1 - WORTH):
            break
    return best


def scaled_plant(structured: StructuredPlant, filters: list[tuple[StateSpace, StateSpace]]) -> Plant:
    """Returns the plant between scales of its errors.

    Args:
        filters: filters for each error: the scale of q and its inverse, whose output is p.
    """
    plant, k = structured.plant, structured.errors
    outputs = append(gain(np.eye(len(plant.C) - k)), *(scale for scale, _ in filters))
    inputs = append(gain(np.eye(plant.Bw.shape[1] - k)), *(inverse for _, inverse in filters))
    return with_weights(plant, outputs, inputs)


def scaling_filters(loop: StructuredLoop) -> list[tuple[StateSpace, StateSpace]]:
    """Returns, for each error, a first-order filter that follows its best scale over frequency, and the filter's inverse."""
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
    """Returns g (s + a) / (s + b) whose magnitude follows a curve, and its inverse."""
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
    """Returns g (s + a) / (s + b)."""
    size = np.sqrt(abs(a - b))
    return StateSpace(np.array([[-b]]), np.array([[size]]), np.array([[g * np.sign(a - b) * size]]), np.array([[g]]))
