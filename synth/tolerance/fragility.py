"""How fragile a law is: by how much its readings and forces may be off, all alike and each by itself, and what that costs.

Each amount stands between two: a box of errors in which it is proved that all is well, and errors that were met, at which it is
not. A gain of one force is off in its entries: an error of that force is one of all readings at once. Of several forces each may
be off, too.
"""

from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from synth.certificate.box import MOST, Box, ScaledGain
from synth.numerics import numerics
from synth.tolerance.found import Heights, by_flips, climb
from synth.tolerance.proved import proof_below
from synth.tolerance.scaled import box_of, errors_of

SHARES = (0.01, 0.1)  # of the norm: what errors may cost of it
AMOUNTS = tuple(0.75**k for k in reversed(range(20)))  # looked at along a ray; at the last, 1, a reading may be missing
EACH = 3  # factors up to which a ray leads to every corner; of more, to those that flips lead to in boxes of these sizes
SIZES = (0.05, 0.25, 1.0)
EXACT = 1e-10  # relative; how closely an amount is found along a ray
WITHIN = 1e-3  # relative; in a box so much smaller it is looked for errors inside that do as much
TURNS = 4  # times, at most
CLOSE = (1e-3, 1e-2, 0.05, 0.15, 0.3, 0.5, 0.75, 0.9)  # relative; how much smaller boxes are in which stability is tried to prove
CLOSE_TO_LEVEL = (1e-2, 0.05, 0.15, 0.3, 0.5, 0.75, 0.9)  # likewise a norm
LOOSELY = 4.0  # times the largest norm met in a box: a bound on it is tried there to prove stability


@dataclass(frozen=True, eq=False)
class Borne:
    """How large errors may be, relative.

    Attributes:
        proved: errors up to this, in whatever combination, do no more than they may; 0 where nothing is proved.
        bound: what no norm exceeds up to there; infinite where nothing is proved.
        found: the smallest errors met that do more; infinite where none up to 1 do.
        readings, forces: those errors, relative, shapes (q,) and (m,); 1 and -1 where none do, along the worst way.
    """

    proved: float
    bound: float
    found: float
    readings: Array
    forces: Array


@dataclass(frozen=True, eq=False)
class Fragility:
    """How large errors of readings and forces a loop bears.

    Attributes:
        norm: without errors.
        stable: until it is unstable.
        within: by share of the norm, until it costs that.
    """

    norm: float
    stable: Borne
    within: dict[float, Borne]


@numerics()
def fragility(gain: ScaledGain) -> Fragility:
    """How large errors a loop bears that is stable without any.

    Raises:
        ValueError: it is not.
    """
    heights = Heights(gain)
    norm = heights.norm(_at(gain, 0.0))
    if not np.isfinite(norm):
        raise ValueError("the loop is unstable as it is")
    rays = _rays(heights)
    within = {share: _borne(heights, rays, norm * (1 + share)) for share in SHARES}
    return Fragility(norm, _borne(heights, rays, np.inf), within)


def box_of_all(gain: ScaledGain, amount: float) -> Box:
    """The factors of all readings, and of several forces, that are off by up to an amount, relative."""
    return box_of(gain, amount, amount if gain.forces > 1 else 0.0)


def worst_met(gain: ScaledGain, amount: float) -> float:
    """The largest norm met with errors of all readings, and of several forces, up to an amount; infinite where unstable."""
    heights = Heights(gain)
    climb(heights, box_of_all(gain, amount))
    return heights.highest


def _at(gain: ScaledGain, errors: Array | float) -> Array:
    return np.ones(sum(gain.K.shape)) + errors


def _rays(heights: Heights) -> Array:
    """The ways to corners of boxes that are looked along, of 1, -1 and 0, shape (k, q + m)."""
    whole = box_of_all(heights.gain, 1.0)
    if len(whole.free) <= EACH:
        corners = whole.corners
    else:
        corners = np.concatenate([by_flips(heights, box_of_all(heights.gain, size)) for size in SIZES])
    return np.unique(np.sign(corners - 1), axis=0)


def _borne(heights: Heights, rays: Array, level: float) -> Borne:
    """How large errors may be until a norm exceeds a level; of an infinite one, until the loop is unstable."""
    gain = heights.gain
    amount, errors = _along_rays(heights, rays, level)
    for _ in range(TURNS):
        inside = Heights(gain)
        climb(inside, box_of_all(gain, min(amount, 1.0) * (1 - WITHIN)))
        if not inside.highest > level * (1 + EXACT) and not np.isinf(inside.highest):
            break
        far = float(np.abs(inside.at - 1).max())
        ray = (inside.at - 1) / far
        amount = _edge(heights, ray, 0.0, far, level)
        errors = amount * ray
    found = errors_of(gain, _at(gain, errors))
    if len(box_of_all(gain, 1.0).free) > MOST:
        return Borne(0.0, np.inf, amount, *found)
    tried = CLOSE if np.isinf(level) else CLOSE_TO_LEVEL
    for smaller in tried if np.isfinite(amount) else (0.0, *tried):
        proved = min(amount, 1.0) * (1 - smaller)
        box, within = box_of_all(gain, proved), Heights(gain)
        if np.isinf(level):
            climb(within, box)
        bound = LOOSELY * within.highest if np.isinf(level) else level
        if np.isfinite(bound) and proof_below(within, box, bound) is not None:
            return Borne(proved, bound, amount, *found)
    return Borne(0.0, np.inf, amount, *found)


def _along_rays(heights: Heights, rays: Array, level: float) -> tuple[float, Array]:
    """The smallest amount along rays that exceeds a level, and the errors there; infinite, with the errors of the highest end."""
    best, at = np.inf, None
    for ray in rays:
        low = 0.0
        for high in AMOUNTS:
            if low >= best:
                break
            norm = heights.norm(_at(heights.gain, high * ray))
            if norm > level or np.isinf(norm):
                edge = _edge(heights, ray, low, high, level)
                if edge < best:
                    best, at = edge, edge * ray
                break
            low = high
    if at is None:
        at = max(rays, key=lambda ray: heights.norm(_at(heights.gain, ray)))
    return float(best), at


def _edge(heights: Heights, ray: Array, low: float, high: float, level: float) -> float:
    """Where between two amounts along a ray a level is exceeded, which is not at the first and is at the second."""
    while high - low > EXACT * high:
        middle = (low + high) / 2
        over = heights.exceeds(_at(heights.gain, middle * ray), level)
        low, high = (low, middle) if over else (middle, high)
    return high
