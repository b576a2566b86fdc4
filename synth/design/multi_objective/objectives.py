"""Objectives other than norms: the decay rate of a loop, and the peak of a signal for a given energy of the disturbance."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.design.descent.terms import Linearisation, Term
from synth.design.multi_objective.band_norm import BandLandscape

# a pole is considered together with the slowest pole if its decay rate differs by less than this, relative to the required
# decay rate
NEAR = 0.3


class Decay(Term):
    """Decay rate of a loop: the value of the term is 2 + (largest real part of a pole) / rate.

    Every term has the bound 1. For the decay rate, the bound means that no pole has a real part above -rate.
    """

    def __init__(self, landscape: BandLandscape, rate: float) -> None:
        self.landscape, self.rate, self.unit, self.name = landscape, rate, 1.0, f"a decay of {rate:g} rad/s"

    def value(self, x: Array, above: float = np.inf) -> float:
        """Returns the value of the term for the slowest pole."""
        return 2 + self.landscape.slowest(x) / self.rate

    def support(self, x: Array, value: float, depth: float) -> Linearisation:
        """Returns the values of the term for all poles close to the slowest pole."""
        return self._made(x, value - max(depth, NEAR), touching=True)

    def reevaluate(self, x: Array, cuts: Any) -> Linearisation:
        """Returns the values of the term for the slowest poles at another point x."""
        return self._made(x, self.value(x) - NEAR, touching=False)

    def _made(self, x: Array, above: float, touching: bool) -> Linearisation:
        real, slopes = self.landscape.decays(x)
        values = 2 + real / self.rate
        near = values >= above
        return Linearisation(values[near], slopes[near] / self.rate, np.full(int(near.sum()), touching), np.flatnonzero(near))


@dataclass(frozen=True, eq=False)
class BoundedSignal:
    """Bounded signal c x + g u of a plant, without feedthrough from w.

    Attributes:
        c: row vector that multiplies the states, shape (n,).
        g: row vector that multiplies the inputs, shape (m,).
        at_most: largest allowed magnitude for the given energy.
        root: square root of the energy of the disturbance, which is the integral of |w|^2.
        name: description of the bound, used in messages.
    """

    public_name = "a bounded signal"

    c: Array
    g: Array
    at_most: float
    root: float
    name: str


class EnergyPeak(Term):
    """Energy-to-peak norm (E c P c')^1/2, divided by its bound; E is the energy, and P solves A P + P A' + Bw Bw' = 0."""

    def __init__(self, landscape: BandLandscape, signal: BoundedSignal, unit: float) -> None:
        self.landscape, self.signal, self.unit, self.name = landscape, signal, unit, signal.name
        self.c = signal.c * landscape.balancing  # the point is in the coordinates of the landscape

    def value(self, x: Array, above: float = np.inf) -> float:
        """Returns the energy-to-peak norm divided by its bound; infinite if the loop is unstable."""
        return self._solved(x)[0]

    def support(self, x: Array, value: float, depth: float) -> Linearisation:
        """Returns the term itself as the only function, because the term is smooth."""
        return self._made(x, touching=True)

    def reevaluate(self, x: Array, cuts: Any) -> Linearisation:
        """Returns the term itself, evaluated at another point."""
        return self._made(x, touching=False)

    def _made(self, x: Array, touching: bool) -> Linearisation:
        value, slope = self._solved(x)
        return Linearisation(np.array([value]), slope[None], np.array([touching]), None)

    def _solved(self, x: Array) -> tuple[float, Array]:
        """Returns the value of the term, and its derivatives with respect to the entries of the gain, shape (m q,)."""
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
        # Half the derivative of c P c'. The dynamics, the signal and the measurement noise contribute to this derivative.
        moved = loop.B.T @ Q
        half = moved @ P @ loop.Cy.T + np.outer(self.signal.g @ land.after(x), loop.Cy @ P @ c) + moved @ Bw @ loop.Dyw.T
        value = self.signal.root * np.sqrt(square) / self.unit
        return value, (half * land.scale).ravel() * (value / square)
