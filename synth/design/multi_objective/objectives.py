"""Objectives and bounds as functions of the gain: their values, and smooth functions that bound them from below.

A point x is a gain in the coordinates of a `Landscape`, the same for all terms of a problem.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.design.descent.landscape import Cuts
from synth.design.multi_objective.band_norm import BandLandscape

NEAR = 0.3  # share of the rate: poles this close to the slowest one also count


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


class Objective(ABC):
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
    def reevaluate(self, x: Array, support: Linearisation) -> Linearisation:
        """Returns the same functions at another point."""

    def curvature(self, x: Array, support: Linearisation, weights: Array) -> Array:
        """Returns the weighted sum of second derivatives of the touching functions, shape (N, N); unknown ones count as zero.

        Args:
            x: point of the support.
            weights: weights of all functions of the support, shape (F,).
        """
        return np.zeros((len(x), len(x)))


class NormObjective(Objective):
    """The largest gain from w to z in a band, of one plant."""

    def __init__(self, landscape: BandLandscape, unit: float, name: str = "") -> None:
        self.landscape, self.unit, self.name = landscape, unit, name

    def value(self, x: Array, above: float = np.inf) -> float:
        """Returns the norm in the band."""
        return self.landscape.norm(x, above * self.unit)[0] / self.unit

    def support(self, x: Array, value: float, depth: float) -> Linearisation:
        """Returns the gains at all local maxima within a share of the highest one."""
        height = value * self.unit
        omega = self.landscape.summits(x, height * (1 - depth))
        return self._made(x, self.landscape.cuts(x, omega, height * (1 - 0.1 * depth)), touching=True)

    def reevaluate(self, x: Array, support: Linearisation) -> Linearisation:
        """Returns the gains at the same frequencies for another point, where they need not be maxima."""
        return self._made(x, support.cuts, touching=False)

    def curvature(self, x: Array, support: Linearisation, weights: Array) -> Array:
        """Returns the curvature of the peaks that the cuts belong to."""
        active = support.touching & (weights > 1e-3 * weights.max(initial=0.0))
        if not active.any():
            return np.zeros((len(x), len(x)))
        return self.landscape.curvature(x, support.cuts[active], weights[active]) / self.unit

    def _made(self, x: Array, cuts: Cuts, touching: bool) -> Linearisation:
        values, slopes = self.landscape.heights(x, cuts)
        return Linearisation(values / self.unit, slopes / self.unit, np.full(len(values), touching), cuts)


class Decay(Objective):
    """The largest real part of a pole as 2 + re(pole) / rate: 1, the bound of every term, is a real part of -rate."""

    def __init__(self, landscape: BandLandscape, rate: float) -> None:
        self.landscape, self.rate, self.unit, self.name = landscape, rate, 1.0, f"a decay of {rate:g} rad/s"

    def value(self, x: Array, above: float = np.inf) -> float:
        """Returns the value of the slowest pole."""
        return 2 + self.landscape.slowest(x) / self.rate

    def support(self, x: Array, value: float, depth: float) -> Linearisation:
        """Returns the real parts of all poles near the bound."""
        return self._made(x, value - max(depth, NEAR), touching=True)

    def reevaluate(self, x: Array, support: Linearisation) -> Linearisation:
        """Returns the real parts of the poles at the other point."""
        return self._made(x, self.value(x) - NEAR, touching=False)

    def _made(self, x: Array, above: float, touching: bool) -> Linearisation:
        real, slopes = self.landscape.decays(x)
        values = 2 + real / self.rate
        near = values >= above
        return Linearisation(values[near], slopes[near] / self.rate, np.full(int(near.sum()), touching), np.flatnonzero(near))


@dataclass(frozen=True, eq=False)
class BoundedSignal:
    """A signal c x + g u of a plant without feedthrough from w.

    Attributes:
        c: shape (n,).
        g: shape (m,).
        at_most: largest magnitude that is allowed for the given energy.
        root: square root of that energy, the integral of |w|^2.
        name: description of the bound.
    """

    given_as = "a bounded signal"

    c: Array
    g: Array
    at_most: float
    root: float
    name: str


class EnergyPeak(Objective):
    """Energy-to-peak norm `root` (c P c')^1/2 with A P + P A' + Bw Bw' = 0, relative to its bound."""

    def __init__(self, landscape: BandLandscape, signal: BoundedSignal, unit: float) -> None:
        self.landscape, self.signal, self.unit, self.name = landscape, signal, unit, signal.name
        self.c = signal.c * landscape.balancing  # in the coordinates of the landscape

    def value(self, x: Array, above: float = np.inf) -> float:
        """Returns the value; infinite if the loop is unstable."""
        return self._solved(x)[0]

    def support(self, x: Array, value: float, depth: float) -> Linearisation:
        """Returns the function itself, which is smooth."""
        return self._made(x, touching=True)

    def reevaluate(self, x: Array, support: Linearisation) -> Linearisation:
        """Returns the function itself at the other point."""
        return self._made(x, touching=False)

    def _made(self, x: Array, touching: bool) -> Linearisation:
        value, slope = self._solved(x)
        return Linearisation(np.array([value]), slope[None], np.array([touching]), None)

    def _solved(self, x: Array) -> tuple[float, Array]:
        """Returns value and slope, shape (m q,)."""
        land = self.landscape
        loop = land.loop(x)
        A, Bw = loop.A, loop.Bw
        if not np.all(np.isfinite(A)) or not np.real(np.linalg.eigvals(A)).max() < 0:
            return np.inf, np.zeros(len(x))
        G = land.acting(x) @ land.plant.Cy
        c = self.c + self.signal.g @ G
        P = linalg.solve_continuous_lyapunov(A, -Bw @ Bw.T)
        Q = linalg.solve_continuous_lyapunov(A.T, -np.outer(c, c))
        square = float(c @ P @ c)
        if not square > 0:
            return 0.0, np.zeros(len(x))
        # Half the slope of c P c': by the dynamics, by the signal, and by measurement noise.
        moved = loop.B.T @ Q
        half = moved @ P @ loop.Cy.T + np.outer(self.signal.g @ land.after(x), loop.Cy @ P @ c) + moved @ Bw @ loop.Dyw.T
        value = self.signal.root * np.sqrt(square) / self.unit
        return value, (half * land.scale).ravel() * (value / square)
