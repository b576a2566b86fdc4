"""Two ways down a landscape that has edges.

- `quasi_newton`: BFGS with a weak Wolfe line search, which is known to work on functions with edges (Lewis, Overton 2013). It is
  quick from far away, and stalls on an edge.
- `along_edges`: the norm is modelled as the largest of its cuts, linearised, plus one curvature; the model's minimum is the step.
  (Sequential quadratic programming for a minimax problem; the cuts of a failed step join the model, as in bundle methods.) If the
  curvature is unknown or has the wrong sign, the step length is measured in the coordinates of `coordinates.py`.
"""

# pyright: reportAttributeAccessIssue=false
# scipy.linalg.lapack is made by f2py and carries no stubs.

from collections.abc import Callable, Iterator

import numpy as np
from scipy import optimize
from scipy.linalg import lapack

from models.common.arrays import Array
from synth.design.descent.coordinates import balanced_coordinates
from synth.design.descent.landscape import Landscape
from synth.plant.numerics import up_to_rounding

STALLED = 1e-4  # a fall over seven rounds that is none, of a function whose values are of order one

STAGE = 30  # rounds
WORTH_A_STAGE = 3e-5  # relative fall of the norm

NEAR = 0.7  # of a limit: what lies no further from it is held from the first

Function = Callable[[Array, float], tuple[float, Array | None]]


def quasi_newton(function: Function, x: Array, rounds: int, target: float = -np.inf) -> tuple[Array, float]:
    """BFGS from x, until the function is below the target or no longer falls.

    Args:
        function: (x, above) -> value and slope. Where the value exceeds `above` it may be any such number, and the slope None.
        x: starting point, with a finite value.
        rounds: largest number of rounds.
    """
    value, slope = function(x, np.inf)
    assert slope is not None
    inverse = np.eye(len(x)) * 0.1 / max(float(np.linalg.norm(slope)), 1e-300)
    recent = [value]
    for turn in range(rounds):
        if value < target or (len(recent) > 8 and recent[-8] - value < STALLED):
            break
        direction = -inverse @ slope
        fall = float(slope @ direction)
        if not fall < 0:
            break
        low, high, length, accepted = 0.0, np.inf, 1.0, None
        for _ in range(15):
            allowed = value + 1e-4 * length * fall
            there, its_slope = function(x + length * direction, allowed)
            if its_slope is None or not there <= allowed:
                high = length
            else:
                accepted = (length, there, its_slope)
                if its_slope @ direction >= 0.5 * fall:
                    break
                low = length
            length = (low + high) / 2 if np.isfinite(high) else 2 * length
        if accepted is None:
            break
        length, there, its_slope = accepted
        step, change = length * direction, its_slope - slope
        curvature = float(step @ change)
        if curvature > 0:
            if turn == 0:
                inverse = np.eye(len(x)) * curvature / float(change @ change)
            shift = np.eye(len(x)) - np.outer(step, change) / curvature
            inverse = shift @ inverse @ shift.T + np.outer(step, step) / curvature
        x, value, slope = x + step, there, its_slope
        recent.append(value)
    return x, value


def along_edges(landscape: Landscape, x: Array, limit: Array, rounds: int, enough: float = 0.0) -> tuple[Array, float]:
    """Minimises the norm from a stable x, |x_i| <= limit_i, until it is small enough or a stage gains next to nothing.

    Every stage has coordinates of its own and forgets the curvature: what the last one learnt on other edges only makes the steps
    of this one short.

    Returns:
        Where it ended, and the norm there.
    """
    height, _ = landscape.norm(x)
    for done in range(0, rounds, STAGE):
        x, reached = _stage(landscape, x, limit, min(STAGE, rounds - done), enough)
        if reached <= enough or reached > height * (1 - WORTH_A_STAGE):
            return x, reached
        height = reached
    return x, height


def _stage(landscape: Landscape, x: Array, limit: Array, rounds: int, enough: float) -> tuple[Array, float]:
    """Rounds of one stage: until ten of them gain less than a hundred thousandth, or rounding leaves no model of the norm."""
    height, at = landscape.norm(x)
    with up_to_rounding():
        for each in _rounds(landscape, x, height, at, limit, rounds):
            x, height = each
            if height <= enough:
                break
    return x, height


def _rounds(landscape: Landscape, x: Array, height: float, at: float, limit: Array, rounds: int) -> Iterator[tuple[Array, float]]:
    """The points of one stage, ever lower, and the norm there."""
    M = balanced_coordinates(landscape, x)
    steepest = float(np.linalg.norm(landscape.slope(x, at) @ M)) / height if height > 0 else 0.0
    M = M / (steepest or 1.0)  # a unit of t is of the size of a step
    hessian, damping = 0.1 * np.eye(len(x)), 1e-2
    recent, depth, failures = [height], 0.1, 0
    kept = landscape.cuts(x, np.array([at if np.isfinite(at) else 0.0]), height)[:0]
    omega = landscape.summits(x, height * (1 - depth))
    for _ in range(rounds):
        if height < 1e-12 or failures > 8 or (len(recent) > 10 and recent[-10] - height < 1e-5 * height):
            return
        peaks = landscape.cuts(x, omega, height * (1 - 0.1 * depth))
        cuts = peaks + kept
        moving = np.arange(len(cuts.omega)) < len(peaks.omega)
        values, slopes = landscape.heights(x, cuts)
        values, slopes = values / height - 1, slopes @ M / height
        useful = values > -2 * depth - 0.1
        cuts, values, slopes, moving = cuts[useful], values[useful], slopes[useful], moving[useful]

        _, weights = lowest_point(values, slopes, hessian, M, x, limit)
        active = moving & (weights > 1e-3 * weights.max())
        if active.any():
            curvature = landscape.curvature(x, cuts[active], weights[active] / weights[active].sum()) / height
            hessian = convex(M.T @ curvature @ M, damping)
        t, weights = lowest_point(values, slopes, hessian, M, x, limit)
        fall = -float(np.max(values + slopes @ t))
        step = M @ t
        if not fall > 1e-10:
            depth, failures = depth / 4, failures + 1
            continue
        beyond, length, corrected = cuts[:0], 1.0, False
        while length > 1e-3:
            allowed = height * (1 - 1e-2 * length * fall)
            there, where = landscape.norm(x + length * step, allowed)
            if there <= allowed:
                break
            if np.isfinite(there) and np.isfinite(where):  # what rose there is missing in the model
                beyond = beyond + landscape.cuts(x + length * step, np.array([where]), there)
                if not corrected:
                    # The edges are curved: where they stand beyond the step is modelled from there (a second-order correction).
                    corrected = True
                    better = _corrected(landscape, x, t, height, depth, hessian, M, limit)
                    there, _ = landscape.norm(x + better, allowed)
                    if there <= allowed:
                        step = better
                        break
            length *= 0.3
        else:
            damping, failures, kept = 10 * damping, failures + 1, kept + beyond
            hessian = hessian * 10
            continue

        while length >= 1 and np.all(np.abs(x + 3 * length * step) <= limit):  # a minimum far away, or at infinity
            further, _ = landscape.norm(x + 3 * length * step, there - 0.1 * length * fall * height)
            if further > there - 0.1 * length * fall * height:
                break
            length, there = 3 * length, further
        failures, kept = (0 if length > 0.05 else failures), beyond
        damping = max(damping / 4, 1e-8) if length >= 1 else damping * 2
        step = length * step
        omega = landscape.summits(x + step, there * (1 - depth))
        x, height = x + step, there
        recent.append(height)
        yield x, height


def _corrected(
    landscape: Landscape, x: Array, t: Array, height: float, depth: float, hessian: Array, M: Array, limit: Array
) -> Array:
    """The step M t again, with the peaks as they are at its end."""
    end = x + M @ t
    peaks = landscape.cuts(end, landscape.summits(end, height * (1 - depth)), height * (1 - 0.1 * depth))
    if not len(peaks.omega):
        return M @ t
    values, slopes = landscape.heights(end, peaks)
    values, slopes = values / height - 1, slopes @ M / height
    better, _ = lowest_point(values - slopes @ t, slopes, hessian, M, x, limit)
    return M @ better


def lowest_point(values: Array, slopes: Array, hessian: Array, M: Array, x: Array, limit: Array) -> tuple[Array, Array]:
    """Returns the t that minimises max_i (values_i + slopes_i t) + t' hessian t / 2, |x + M t| <= limit, and the cuts' weights.

    As a least-distance problem for non-negative least squares (Lawson, Hanson 1974, chapter 23): with h for the maximum, h +
    |y|^2 / 2 is the distance from a point far down the axis of h, up to a term that is too small to count. Only nearby limits
    count, and those that a solution without them violates.

    Raises:
        LinAlgError: there is no cut, or rounding leaves no solution.
    """
    if not len(values) or not all(np.isfinite(each).all() for each in (values, slopes, hessian, M, x)):
        raise np.linalg.LinAlgError("no cut is left")
    root = np.linalg.cholesky(hessian).T
    inverse = lapack.dtrtrs(root, np.eye(len(root)))[0]
    far = 10.0
    rows = np.hstack([-slopes @ inverse / far, np.ones((len(values), 1))])
    bounds = values / far + far
    moves = np.vstack([M, -M]) @ inverse  # up to the limits, and down to them
    room = np.concatenate([limit - x, limit + x])
    at_limit = room < NEAR * np.tile(limit, 2)
    while True:
        inward = np.hstack([-moves[at_limit], np.zeros((int(at_limit.sum()), 1))])
        all_rows, all_bounds = np.vstack([rows, inward]), np.append(bounds, -room[at_limit])
        sizes = np.linalg.norm(all_rows, axis=1)
        matrix = np.vstack([all_rows.T / sizes, all_bounds / sizes])
        target = np.append(np.zeros(len(root) + 1), 1.0)
        weights = _non_negative(matrix, target)
        residual = matrix @ weights - target
        y = -residual[:-2] / residual[-1]
        broken = ~at_limit & (moves @ y > room + 1e-9 * np.tile(limit, 2))
        if not broken.any():
            return inverse @ y, (weights / sizes)[: len(values)]
        at_limit |= broken


def _non_negative(matrix: Array, target: Array) -> Array:
    """Non-negative least squares, shape (k,) for a matrix of shape (N, k)."""
    try:
        return optimize.nnls(matrix, target, maxiter=30 * matrix.shape[1])[0]
    except (ValueError, RuntimeError) as error:  # what is not finite, and what does not come to an end
        raise np.linalg.LinAlgError(str(error)) from error


def convex(curvature: Array, damping: float) -> Array:
    """A positive definite matrix of the same curvatures, upwards in every direction."""
    values, vectors = np.linalg.eigh(curvature)
    return (vectors * (np.clip(np.abs(values), 1e-8, 1e8) + damping)) @ vectors.T
