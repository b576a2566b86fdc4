"""The largest norm that is met in a box of errors: at its corners first, then inside, for a maximum need not be at a corner."""

import numpy as np
from scipy import optimize

from models.common.arrays import Array
from synth.certificate.box import Box, ScaledGain
from synth.certificate.norm import hinf_norm
from synth.plant import GeneralizedPlant
from synth.search.landscape import Landscape

ALL = 8  # free factors up to which every corner is looked at; of more, those that flips lead to
BEGIN = 4  # corners at which flips begin beside the one that slopes lead to
CLIMBED = 2  # of the highest points met, those from which the search inside begins
TURNS = 30  # of one such search
SEED = 20261122


class Heights:
    """The norm over the factors of a gain; it remembers the highest that it met.

    Attributes:
        highest: the largest norm so far; infinite once a loop was unstable.
        at: its factors.
    """

    def __init__(self, gain: ScaledGain) -> None:
        self.gain = gain
        self.landscape = Landscape(gain.plant, gain.Cy, gain.Dyw)
        self.highest, self.at = 0.0, np.ones(sum(gain.K.shape))
        self._known: dict[bytes, tuple[float, float]] = {}

    def exceeds(self, factors: Array, level: float) -> bool:
        """Whether the norm under factors is above a level, or of an infinite one the loop unstable; it is not remembered."""
        try:
            point = self.landscape.point(self.gain.acting(factors))
        except np.linalg.LinAlgError:
            return True
        if np.isinf(level):
            return not self.landscape.abscissa(point)[0] < 0
        return self.landscape.norm(point, level)[0] > level

    def norm(self, factors: Array) -> float:
        """The norm under factors, shape (q + m,); infinite where the loop is unstable, or has no answer."""
        return self._peak(factors)[0]

    def _peak(self, factors: Array) -> tuple[float, float]:
        key = factors.tobytes()
        if key not in self._known:
            try:
                self._known[key] = self.landscape.norm(self.landscape.point(self.gain.acting(factors)))
            except np.linalg.LinAlgError:
                self._known[key] = np.inf, np.nan
            if not self._known[key][0] <= self.highest:
                self.highest, self.at = self._known[key][0], factors.copy()
        return self._known[key]

    def slope(self, factors: Array) -> Array:
        """Of the norm over the factors where it is finite, shape (q + m,)."""
        gain, landscape = self.gain, self.landscape
        K, q = gain.acting(factors), gain.K.shape[1]
        by_acting = landscape.slope(landscape.point(K), self._peak(factors)[1]).reshape(K.shape) / landscape.scale
        after = np.linalg.inv(gain.back(gain.scaled(factors)))
        by_scaled = after.T @ by_acting @ (np.eye(q) + gain.Dyu @ K).T * gain.K
        return np.concatenate([factors[q:] @ by_scaled, by_scaled @ factors[:q]])


def climb(heights: Heights, box: Box) -> None:
    """Looks for the largest norm in a box; `heights` remembers it. It ends where a loop is unstable."""
    free = box.free
    points = box.corners if len(free) <= ALL else by_flips(heights, box)
    points = np.concatenate([points, box.middle[None]])
    values = [heights.norm(point) for point in points]
    if not (len(free) and np.isfinite(heights.highest)):
        return
    generator = np.random.default_rng(SEED)
    inside = box.low + (box.high - box.low) * generator.random((2 * CLIMBED, len(box.low)))
    values += [heights.norm(point) for point in inside]
    points = np.concatenate([points, inside])
    for i in np.argsort(values)[-CLIMBED:][::-1]:
        _inside(heights, box, points[i])


def by_flips(heights: Heights, box: Box) -> Array:
    """Corners that no flip of one factor makes higher, or the middle of the box where its loop is unstable, shape (k, q + m)."""
    free, middle = box.free, box.middle
    if not np.isfinite(heights.norm(middle)):
        return middle[None]
    uphill = np.where(heights.slope(middle) >= 0, box.high, box.low)
    corners = [uphill, *np.where(np.random.default_rng(SEED).random((BEGIN, len(middle))) < 0.5, box.low, box.high)]
    for corner in corners:
        best, moved = heights.norm(corner), True
        while moved and np.isfinite(best):
            moved = False
            for axis in free:
                other = corner.copy()
                other[axis] = box.low[axis] if corner[axis] == box.high[axis] else box.high[axis]
                if heights.norm(other) > best:
                    best, moved = heights.norm(other), True
                    corner[axis] = other[axis]
    return np.array(corners)


def _inside(heights: Heights, box: Box, start: Array) -> None:
    """Up from a point as far as the box reaches."""
    free = box.free
    middle, half = box.middle, (box.high - box.low)[free] / 2

    def point(t: Array) -> Array:
        factors = middle.copy()
        factors[free] = np.clip(middle[free] + half * t, box.low[free], box.high[free])
        return factors

    def down(t: Array) -> tuple[float, Array]:
        factors = point(t)
        value = heights.norm(factors)
        if not np.isfinite(value):
            raise StopIteration  # nothing is higher
        return -np.log(value), -heights.slope(factors)[free] * half / value

    t = (start - middle)[free] / half
    slope = down(t)[1]
    if np.all(np.where(t >= 1, slope <= 0, True) & np.where(t <= -1, slope >= 0, True) & (np.abs(t) >= 1)):
        return  # a corner, and all ways into the box lead down
    try:
        optimize.minimize(down, t, jac=True, method="L-BFGS-B", bounds=[(-1, 1)] * len(free), options={"maxiter": TURNS})
    except StopIteration:
        return


def norm_at(gain: ScaledGain, factors: Array) -> float:
    """The norm under factors by two routes, infinite where the loop is unstable or has no answer."""
    try:
        A, Bw, C, Dw = gain.loops(factors)
    except np.linalg.LinAlgError:
        return np.inf
    return hinf_norm(GeneralizedPlant(A, np.zeros((len(A), 0)), Bw, C, np.zeros((len(C), 0)), Dw)).value
