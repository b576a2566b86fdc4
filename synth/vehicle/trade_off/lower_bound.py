"""Joint lower bounds on two norms of the same loop.

The bounds are proved for all controllers, even for controllers that measure all states and the road.

Let v_i and v_j be the norms from the disturbance w to two outputs z_i and z_j. For any controller, the norm to the stacked
outputs [a z_i; b z_j] is at most (a^2 v_i^2 + b^2 v_j^2)^1/2. Let g be a lower bound on the norm to the stacked outputs for
some weights a and b. The norms of a controller therefore never lie in the ellipse

    a^2 v_i^2 + b^2 v_j^2 < g^2.

The bounds for many pairs of weights together form a lower-bound curve. The bound also holds for the norm in a frequency band
if, at a frequency in this band, no control force can change some component of z. The weights are powers of two, so that
multiplication by the weights does not round the entries of the plant's matrices. The exact proofs therefore apply to the plant
itself, not to a rounded plant.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from models.common.arrays import Array
from synth.analysis.lower_bounds.invariant_point import limit_at
from synth.design.descent.landscape import EVERYWHERE, Band
from synth.lmi.full_order_bound import bound_beyond_control, find_lower_bound
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError, numerics

RATIOS = range(-9, 10)  # base-2 logarithms of the ratio of the two weights; the unit of a weight depends on its axis
IN_BAND = 24  # number of frequencies in a band at which the lower bound is computed
DOWN = 1 - 1e-12  # factor that reduces the lower bound, to allow for rounding of the curve


@dataclass(frozen=True, eq=False)
class LowerBoundCurve:
    """Lower-bound curve for the norms on a pair of axes.

    Attributes:
        axes: indices of the two axes.
        weights: weights of the two outputs in each of M weighted stacks of both outputs, shape (M, 2).
        norms: lower bound on the norm of each weighted stack of both outputs, shape (M,).
    """

    axes: tuple[int, int]
    weights: Array
    norms: Array

    def lower_bound_on_second(self, first: Array) -> Array:
        """Returns the lower bound on the second norm for N values of the first norm, shape (N,); NaN for values that no
        controller attains.
        """
        with np.errstate(all="ignore"):
            left = (self.norms**2)[:, None] - (self.weights[:, :1] * first) ** 2
            of = np.where(self.weights[:, 1:] > 0, np.sqrt(np.maximum(left, 0.0)) / self.weights[:, 1:], 0.0)
        never = np.any((self.weights[:, 1:] == 0) & (left > 0), axis=0)
        return np.where(never, np.nan, of.max(axis=0, initial=0.0) * DOWN)

    def share(self, values: Array) -> Array:
        """Returns the position of N points relative to the curve, shape (N,): 1 for a point on the curve, more than 1 above the
        curve.

        Args:
            values: values of the N points on both axes, shape (N, 2).
        """
        reached = np.sqrt((np.asarray(values) ** 2) @ (self.weights**2).T)
        with np.errstate(all="ignore"):
            return np.min(np.where(self.norms > 0, reached / self.norms, np.inf), axis=1, initial=np.inf)


def limits(plants: list[Plant], bands: list[Band], units: Array) -> Iterator[LowerBoundCurve]:
    """Yields the lower-bound curves for all pairs of axes.

    Args:
        plants: plant for each axis; the plants differ only in the output z.
        bands: frequency band of each axis [rad/s].
        units: typical size of the norms on each axis, shape (K,).
    """
    return (_limit(plants, bands, units, pair) for pair in combinations(range(len(plants)), 2))


@numerics()
def _limit(plants: list[Plant], bands: list[Band], units: Array, pair: tuple[int, int]) -> LowerBoundCurve:
    one, other = (2.0 ** round(np.log2(1 / units[k])) for k in pair)
    weights = np.array([(one, 0.0), (0.0, other), *((one * 2.0 ** max(r, 0), other * 2.0 ** max(-r, 0)) for r in RATIOS)])
    norms = np.zeros(len(weights))  # the value stays 0 if no bound is found
    for i, weight in enumerate(weights):
        kept = [(plants[k], bands[k], own) for k, own in zip(pair, weight, strict=True) if own > 0]
        stack = replace(
            kept[0][0],
            C=np.vstack([own * plant.C for plant, _, own in kept]),
            D=np.vstack([own * plant.D for plant, _, own in kept]),
            Dw=np.vstack([own * plant.Dw for plant, _, own in kept]),
        )
        narrow = [band for _, band, _ in kept if band != EVERYWHERE]
        if narrow:
            norms[i] = max(limit_at(stack, float(omega)) for omega in np.linspace(*narrow[0], IN_BAND))
        else:
            with contextlib.suppress(DesignError):
                norms[i] = find_lower_bound(stack, beyond_control=bound_beyond_control(stack)).gamma
    return LowerBoundCurve(pair, weights, norms)
