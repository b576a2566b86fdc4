"""Terms of a minimax problem as functions of the gain. Each term has a value, and smooth functions that bound it from below.

A point x is a gain in the coordinates of a `Landscape`. All terms of a problem use the same coordinates.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.arrays import Array
from synth.design.descent.landscape import Cuts, Landscape


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Set of F smooth functions that bound a term from below near a point, with their values and derivatives.

    Attributes:
        values: values of the functions at the point, shape (F,).
        slopes: derivatives of the functions at the point with respect to its N entries, shape (F, N).
        touching: True for each function that equals a local maximum of the term at the point, shape (F,). Only functions that
            equal a local maximum contribute to the curvature.
        cuts: data that identifies the functions; each type of term has its own format.
    """

    values: Array
    slopes: Array
    touching: Array
    cuts: Any


class Term(ABC):
    """Function of the gain with a scalar value that is minimised or bounded.

    Attributes:
        unit: reference value by which all values are divided: a bound, or the best known value.
        name: description of the bounded quantity.
    """

    unit: float
    name: str

    @abstractmethod
    def value(self, x: Array, above: float = np.inf) -> float:
        """Returns the value of the term at the point x, divided by `unit`.

        If the value exceeds `above`, the method may return a lower bound. The value is infinite if the loop is unstable.
        """

    @abstractmethod
    def support(self, x: Array, value: float, depth: float) -> Linearisation:
        """Returns those functions whose values at x are at least (1 - depth) times the value of the term."""

    @abstractmethod
    def reevaluate(self, x: Array, cuts: Any) -> Linearisation:
        """Returns the functions that `Linearisation.cuts` identifies, evaluated at another point x."""

    def cut(self, x: Array, value: float) -> Any:
        """Returns the cuts of those functions that equal the last result of `value`, which was computed at the same point x."""
        return self.support(x, value, 0.0).cuts

    def curvature(self, x: Array, support: Linearisation, weights: Array) -> Array:
        """Returns the weighted sum of the second derivatives of the touching functions, shape (N, N); zero if the derivatives
        are unknown.

        Args:
            x: point at which the functions in `support` were computed.
            weights: weights of all functions in `support`, shape (F,).
        """
        return np.zeros((len(x), len(x)))


class NormTerm(Term):
    """Largest gain from w to z of one closed loop, in the frequency band of a landscape."""

    def __init__(self, landscape: Landscape, unit: float = 1.0, name: str = "") -> None:
        self.landscape, self.unit, self.name = landscape, unit, name
        self.peak = np.inf  # frequency of the peak at the last point [rad/s]

    def value(self, x: Array, above: float = np.inf) -> float:
        """Returns the norm, divided by `unit`."""
        height, self.peak = self.landscape.norm(x, above * self.unit)
        return height / self.unit

    def support(self, x: Array, value: float, depth: float) -> Linearisation:
        """Returns the gains at all local maxima over frequency that are close to the highest peak."""
        height = value * self.unit
        omega = self.landscape.summits(x, height * (1 - depth))
        return self._made(x, self.landscape.cuts(x, omega, height * (1 - 0.1 * depth)), touching=True)

    def cut(self, x: Array, value: float) -> Cuts:
        """Returns the cut at the last peak; no cut if the peak is at infinite frequency."""
        omega = np.array([self.peak])
        return self.landscape.cuts(x, omega[np.isfinite(omega)], value * self.unit)

    def reevaluate(self, x: Array, cuts: Cuts) -> Linearisation:
        """Returns the gains at the frequencies of the cuts for a new point x, where the gain may have its maxima at other
        frequencies.
        """
        return self._made(x, cuts, touching=False)

    def curvature(self, x: Array, support: Linearisation, weights: Array) -> Array:
        """Returns the curvature of the peaks to which the cuts belong."""
        active = support.touching & (weights > 1e-3 * weights.max(initial=0.0))
        if not active.any():
            return np.zeros((len(x), len(x)))
        return self.landscape.curvature(x, support.cuts[active], weights[active]) / self.unit

    def _made(self, x: Array, cuts: Cuts, touching: bool) -> Linearisation:
        values, slopes = self.landscape.heights(x, cuts)
        return Linearisation(values / self.unit, slopes / self.unit, np.full(len(values), touching), cuts)
