"""Smallest value of the last unknown of a matrix inequality, by the central path of its barrier."""

import numpy as np

from models.common.arrays import Array
from synth.lmi.barrier import Derivatives, boundary, newton

FASTER = 8.0  # factor by which the weight of the last unknown grows from one point of the path to the next
CENTRES = 24  # largest number of points that are computed on the path
LOOSE_DECREMENT = 0.1  # a point counts as a point of the central path if its Newton decrement is below this
WITHIN = 0.95  # largest step along the tangent of the path, as a fraction of the distance to the boundary
SHORTEST = 1e-10  # shortest step along the tangent, as a fraction of the full step
SURE = 1.1  # safety factor on the distance between the last unknown, at a point of the path, and its smallest possible value


def lowest_last(barrier: Derivatives, p: Array, rows: int, enough: float, close: float = np.inf) -> Array:
    """Minimises the last unknown by following the central path.

    The path ends when the last unknown is below `enough`, or when the smallest possible value of this unknown is certainly
    above `enough`.

    Args:
        barrier: barrier of the constraints.
        p: feasible point whose last unknown is above `enough`.
        rows: total number of rows in all blocks of the barrier.
        enough: value of the last unknown below which the path ends.
        close: distance of the last unknown from its smallest possible value at which the path ends, if that value is certainly
            above `enough`.

    Returns:
        The last point of the path that was reached.

    Raises:
        LinAlgError: the starting point is infeasible because of rounding.
    """
    c, along = np.zeros(len(p)), np.zeros(len(p))
    along[-1], weight, here = 1.0, rows / (p[-1] - enough), barrier.at(p)
    if here is None:
        raise np.linalg.LinAlgError("rounding leaves no feasible point")
    for _ in range(CENTRES):
        c[-1] = weight
        p, _, here = newton(barrier, p, c, LOOSE_DECREMENT, lambda p: p[-1] < enough, here)
        gap = SURE * rows / weight
        if p[-1] < enough or (gap <= close and p[-1] - gap > enough):
            break
        # The step is along the tangent of the path, and so short that the point stays feasible. If rounding makes the point
        # infeasible near the boundary, the step is halved.
        step = -(1 - 1 / FASTER) * weight * here.solve(here.half(along))
        length, start, here = min(1.0, WITHIN * boundary(here, step)), p, None
        while here is None and length > SHORTEST:
            p, length = start + length * step, length / 2
            here = barrier.at(p)
        if here is None:
            return start
        if p[-1] < enough:
            break
        weight *= FASTER
    return p
