"""Terms of a minimax problem as functions of the gain: their values, and smooth functions that bound them from below.

A point x is a gain in the coordinates of a `Landscape`, the same for all terms of a problem.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.arrays import Array
from synth.design.descent.landscape import Cuts, Landscape


@dataclass(frozen=True, eq=False)
class Linearisation:
    """F smooth functions that bound a term from below near a point.

    Attributes:
        values: values at the point, shape (F,).
        slopes: slopes at the point, shape (F, N).
        touching: True for functions that are local maxima of the term at the point, whose curvature counts, shape (F,).
        cuts: the term's own identification of the functions.
    """

    values: Array
    slopes: Array
    touching: Array
    cuts: Any


class Term(ABC):
    """A function of the gain.

    Attributes:
        unit: the value that counts as one: a bound, or the best known value.
        name: description of the bounded quantity.
    """

    unit: float
    name: str

    @abstractmethod
    def value(self, x: Array, above: float = np.inf) -> float:
        """Returns the value in its unit, or a lower bound once that exceeds `above`; infinite if the loop is unstable."""

    @abstractmethod
    def support(self, x: Array, value: float, depth: float) -> Linearisation:
        """Returns the functions that come within a share `depth` of the term's value at a point."""

    @abstractmethod
    def reevaluate(self, x: Array, cuts: Any) -> Linearisation:
        """Returns the functions of `Linearisation.cuts` at another point."""

    def cut(self, x: Array, value: float) -> Any:
        """Returns the cuts of the functions that reach the value last returned by `value`, at its point x."""
        return self.support(x, value, 0.0).cuts

    def curvature(self, x: Array, support: Linearisation, weights: Array) -> Array:
        """Returns the weighted sum of second derivatives of the touching functions, shape (N, N); unknown ones count as zero.

        Args:
            x: point of the support.
            weights: weights of all functions of the support, shape (F,).
        """
        return np.zeros((len(x), len(x)))


class NormTerm(Term):
    """The largest gain from w to z of one plant, in the band of a landscape."""

    def __init__(self, landscape: Landscape, unit: float = 1.0, name: str = "") -> None:
        self.landscape, self.unit, self.name = landscape, unit, name
        self.peak = np.inf  # rad/s, at the last point

    def value(self, x: Array, above: float = np.inf) -> float:
        """Returns the norm."""
        height, self.peak = self.landscape.norm(x, above * self.unit)
        return height / self.unit

    def support(self, x: Array, value: float, depth: float) -> Linearisation:
        """Returns the gains at all local maxima within a share of the highest one."""
        height = value * self.unit
        omega = self.landscape.summits(x, height * (1 - depth))
        return self._made(x, self.landscape.cuts(x, omega, height * (1 - 0.1 * depth)), touching=True)

    def cut(self, x: Array, value: float) -> Cuts:
        """Returns the cut of the peak that was found last; none if the peak is at an infinite frequency."""
        omega = np.array([self.peak])
        return self.landscape.cuts(x, omega[np.isfinite(omega)], value * self.unit)

    def reevaluate(self, x: Array, cuts: Cuts) -> Linearisation:
        """Returns the gains at the same frequencies for another point, where they need not be maxima."""
        return self._made(x, cuts, touching=False)

    def curvature(self, x: Array, support: Linearisation, weights: Array) -> Array:
        """Returns the curvature of the peaks that the cuts belong to."""
        active = support.touching & (weights > 1e-3 * weights.max(initial=0.0))
        if not active.any():
            return np.zeros((len(x), len(x)))
        return self.landscape.curvature(x, support.cuts[active], weights[active]) / self.unit

    def _made(self, x: Array, cuts: Cuts, touching: bool) -> Linearisation:
        values, slopes = self.landscape.heights(x, cuts)
        return Linearisation(values / self.unit, slopes / self.unit, np.full(len(values), touching), cuts)
