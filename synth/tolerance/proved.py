"""A bound that holds on a whole box of errors: one X of (20) for all of it, or for each of the parts into which it falls."""

from collections.abc import Callable

import numpy as np

from models.common.arrays import Array
from synth.certificate.bounding import bounding_x
from synth.certificate.box import MOST, Box, BoxProof, proves
from synth.certificate.certificate import eta_of
from synth.plant import GeneralizedPlant
from synth.tolerance.common import common_x
from synth.tolerance.found import Heights

CLOSEST = 1e-4  # relative; how far above the largest norm met a bound is tried, and no closer
CLOSER = (0.1, 1e-2, 1e-3, CLOSEST)  # likewise in turn, where the box has to fall into parts for it
LOOSE = (1.0, 10.0)  # where the first of these fails
TRIALS = 600  # over the square of the number of states: how often an X is looked for at most
FEWEST = 4  # of them at least
PATIENT = 4  # times the trials, for a bound that is asked about
CHEAPLY = 3  # times fewer trials where a bound is one of many
SPARE = 1e-2  # of how far a bound is above a norm: what of it the first X leaves unused
EVERYWHERE = 1e-4  # of the disturbance's power: what disturbs states for the first X that w does not reach

Parts = list[tuple[Box, Array | None]]  # of a box, each with an X of (20) if one is known


def _trials(heights: Heights) -> int:
    """How often an X is looked for at most, for one bound."""
    return max(FEWEST, TRIALS // len(heights.gain.plant.A) ** 2)


def proof_near(heights: Heights, box: Box) -> BoxProof | None:
    """A bound on a box just above the largest norm met, if one can be proved; what is met on the way is remembered, too."""

    def level(above: float) -> Callable[[], float]:
        return lambda: heights.highest * (1 + above)

    whole: Parts = [(box, None)]
    if (parts := _filled(heights, whole, level(CLOSEST), 1)[0]) is not None:
        return _proof(parts, level(CLOSEST))
    tried, left, best = whole, _trials(heights), None
    for above in CLOSER:
        parts, left = _filled(heights, tried, level(above), left)
        if parts is None:
            break
        tried, best = parts, _proof(parts, level(above))
    for above in LOOSE if best is None else ():
        parts, _ = _filled(heights, whole, level(above), _trials(heights))
        if parts is not None:
            return _proof(parts, level(above))
    return best if np.isfinite(heights.highest) else None


def proof_below(heights: Heights, box: Box, bound: float) -> BoxProof | None:
    """The proof of a bound on a box, if one is found at little cost; what is met on the way is remembered."""
    parts, _ = _filled(heights, [(box, None)], lambda: bound, _trials(heights) // CHEAPLY)
    return _proof(parts, lambda: bound) if parts is not None else None


def proof_at(heights: Heights, box: Box, bound: float) -> BoxProof | None:
    """The proof of a bound that is asked about, looked for patiently."""
    parts, _ = _filled(heights, [(box, None)], lambda: bound, PATIENT * _trials(heights))
    return _proof(parts, lambda: bound) if parts is not None else None


def _proof(parts: Parts, bound: Callable[[], float]) -> BoxProof:
    return BoxProof(eta_of(bound()), [(part, X) for part, X in parts if X is not None])


def _filled(heights: Heights, parts: Parts, bound: Callable[[], float], left: int) -> tuple[Parts | None, int]:
    """Parts with an X each that proves a bound; None where there is none, or that took too many trials.

    Args:
        heights: they know the largest norm met.
        parts: that fill the box, some with an X.
        bound: what it is now; it may grow with what is met.
        left: how often an X may be looked for.

    Returns:
        The parts, and how often an X may still be looked for.
    """
    todo, done = list(parts), Parts()
    if any(len(part.free) > MOST for part, _ in parts):
        return None, 0
    while todo:
        part, X = todo.pop()
        if not heights.highest < bound():
            return None, left
        eta = eta_of(bound())
        if X is None or not proves(heights.gain, part, X, eta):
            if not left:
                return None, 0
            left, X = left - 1, _x_for(heights, part, eta)
        if X is not None:
            done.append((part, X))
        elif left and len(part.free):
            todo += [(half, None) for half in part.halves(_axis(heights, part))]
        else:
            return None, 0
    return done, left


def _x_for(heights: Heights, box: Box, eta: float) -> Array | None:
    """An X that proves a bound on a box; None where none is found."""
    gain, level = heights.gain, eta**-0.5
    norm = heights.norm(box.middle)
    if not norm < level or not gain.posed(box):
        return None
    A, Bw, C, Dw = gain.loops(box.middle)
    loop = GeneralizedPlant(A, np.zeros((len(A), 0)), Bw, C, np.zeros((len(C), 0)), Dw)
    try:
        start = bounding_x(loop, level, SPARE * min(level / norm - 1, 1.0), EVERYWHERE)
        X = common_x(gain, box, start, eta)
    except (np.linalg.LinAlgError, ValueError):  # too close to the norm for floats
        return None
    return X if X is not None and proves(gain, box, X, eta) else None


def _axis(heights: Heights, box: Box) -> int:
    """The factor along which the norm changes most from the middle of a box to its faces."""
    middle = heights.norm(box.middle)
    changes = []
    for axis in box.free:
        ends = []
        for end in (box.low, box.high):
            point = box.middle
            point[axis] = end[axis]
            ends.append(heights.norm(point))
        changes.append(max(abs(np.log(value / middle)) if np.isfinite(value) else np.inf for value in ends))
    return int(box.free[np.argmax(changes)])
