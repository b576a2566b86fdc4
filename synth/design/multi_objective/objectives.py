"""Objectives and bounds as functions of the gain: their values, and smooth functions that support them from below.

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

NEAR = 0.3  # of the rate: poles this close to the slowest one are looked at, too


@dataclass(frozen=True, eq=False)
class Linearisation:
    """F smooth functions that touch or support a term at a point.

    Attributes:
        values: there, shape (F,).
        slopes: shape (F, N).
        touching: which of them are its local maxima there, so that their curvature counts, shape (F,).
        cuts: what the term knows them by.
    """

    values: Array
    slopes: Array
    touching: Array
    cuts: Any


class Objective(ABC):
    """A function of the gain.

    Attributes:
        unit: the value that counts as one: a bound, or the best that is known.
        name: of what is bounded, in words.
    """

    unit: float
    name: str

    @abstractmethod
    def value(self, x: Array, above: float = np.inf) -> float:
        """In its unit; a lower bound, once it is known to exceed `above`. Infinite where the loop is unstable."""

    @abstractmethod
    def support(self, x: Array, value: float, depth: float) -> Linearisation:
        """Functions that come within a share `depth` of its value at a point."""

    @abstractmethod
    def reevaluate(self, x: Array, support: Linearisation) -> Linearisation:
        """The same functions at another point."""

    def curvature(self, x: Array, support: Linearisation, weights: Array) -> Array:
        """Weighted sum of the second derivatives of the functions that touch, shape (N, N); zero where they are not known.

        Args:
            x: where the support was made.
            weights: of all its functions, shape (F,).
        """
        return np.zeros((len(x), len(x)))


class NormObjective(Objective):
    """The largest gain from w to z in a band, of one plant."""

    def __init__(self, landscape: BandLandscape, unit: float, name: str = "") -> None:
        self.landscape, self.unit, self.name = landscape, unit, name

    def value(self, x: Array, above: float = np.inf) -> float:
        """The norm in the band."""
        return self.landscape.norm(x, above * self.unit)[0] / self.unit

    def support(self, x: Array, value: float, depth: float) -> Linearisation:
        """Cuts at all its summits within a share of the highest."""
        height = value * self.unit
        omega = self.landscape.summits(x, height * (1 - depth))
        return self._made(x, self.landscape.cuts(x, omega, height * (1 - 0.1 * depth)), touching=True)

    def reevaluate(self, x: Array, support: Linearisation) -> Linearisation:
        """The same cuts elsewhere, where they no longer touch."""
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
    """The largest real part of a pole, as 2 + re(pole) / rate: as of every term 1 is the bound, where it is -rate."""

    def __init__(self, landscape: BandLandscape, rate: float) -> None:
        self.landscape, self.rate, self.unit, self.name = landscape, rate, 1.0, f"a decay of {rate:g} rad/s"

    def value(self, x: Array, above: float = np.inf) -> float:
        """Returns the value of the slowest pole."""
        if not np.all(np.isfinite(self.landscape.loop(x)[0])):
            return np.inf
        return 2 + float(self.landscape.decays(x)[0].max()) / self.rate

    def support(self, x: Array, value: float, depth: float) -> Linearisation:
        """The real parts of all poles near the border."""
        return self._made(x, value - max(depth, NEAR), touching=True)

    def reevaluate(self, x: Array, support: Linearisation) -> Linearisation:
        """Poles move: those of the other point."""
        return self._made(x, self.value(x) - NEAR, touching=False)

    def _made(self, x: Array, above: float, touching: bool) -> Linearisation:
        real, slopes = self.landscape.decays(x)
        values = 2 + real / self.rate
        near = values >= above
        return Linearisation(values[near], slopes[near] / self.rate, np.full(int(near.sum()), touching), np.flatnonzero(near))


@dataclass(frozen=True, eq=False)
class BoundedSignal:
    """A signal c x + g u of a plant that w does not reach at once.

    Attributes:
        c: shape (n,).
        g: shape (m,).
        at_most: its largest magnitude for the energy that is asked about.
        root: of that energy, the integral of |w|^2.
        name: of the bound, in words.
    """

    c: Array
    g: Array
    at_most: float
    root: float
    name: str


class EnergyPeak(Objective):
    """root (c P c')^1/2 with A P + P A' + Bw Bw' = 0, by the bound on it."""

    def __init__(self, landscape: BandLandscape, signal: BoundedSignal, unit: float) -> None:
        """Args:
        landscape: of the plant.
        signal: what is bounded.
        unit: the bound.
        """
        self.landscape, self.signal, self.unit, self.name = landscape, signal, unit, signal.name
        self.c = signal.c * landscape.balancing  # in the coordinates of the landscape

    def value(self, x: Array, above: float = np.inf) -> float:
        """Infinite where the loop is unstable."""
        return self._solved(x)[0]

    def support(self, x: Array, value: float, depth: float) -> Linearisation:
        """The function itself, which is smooth."""
        return self._made(x, touching=True)

    def reevaluate(self, x: Array, support: Linearisation) -> Linearisation:
        """Nothing else."""
        return self._made(x, touching=False)

    def _made(self, x: Array, touching: bool) -> Linearisation:
        value, slope = self._solved(x)
        return Linearisation(np.array([value]), slope[None], np.array([touching]), None)

    def _solved(self, x: Array) -> tuple[float, Array]:
        """Value and slope, shape (m q,)."""
        land = self.landscape
        A, _ = land.loop(x)
        Bw, _ = land.disturbed(x)
        if not np.all(np.isfinite(A)) or not np.real(np.linalg.eigvals(A)).max() < 0:
            return np.inf, np.zeros(len(x))
        G = land.acting(x) @ land.Cy
        c = self.c + self.signal.g @ G
        P = linalg.solve_continuous_lyapunov(A, -Bw @ Bw.T)
        Q = linalg.solve_continuous_lyapunov(A.T, -np.outer(c, c))
        square = float(c @ P @ c)
        if not square > 0:
            return 0.0, np.zeros(len(x))
        # Half the slope of c P c': through the dynamics, through the signal, and through the noise of what is measured.
        ports = land.ports(x)
        moved = ports.B.T @ Q
        half = moved @ P @ ports.Cy.T + np.outer(self.signal.g @ ports.after, ports.Cy @ P @ c) + moved @ Bw @ ports.Dyw.T
        value = self.signal.root * np.sqrt(square) / self.unit
        return value, (half * land.scale).ravel() * (value / square)
