"""How far a signal goes for a road of given energy as a term: its energy-to-peak norm, and how it moves with K."""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.goals.banded import BandLandscape
from synth.goals.terms import Support, Term


@dataclass(frozen=True, eq=False)
class Signal:
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


class EnergyPeak(Term):
    """root (c P c')^1/2 with A P + P A' + Bw Bw' = 0, by the bound on it."""

    def __init__(self, landscape: BandLandscape, signal: Signal, unit: float) -> None:
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

    def support(self, x: Array, value: float, depth: float) -> Support:
        """The function itself, which is smooth."""
        return self._made(x, touching=True)

    def again(self, x: Array, support: Support) -> Support:
        """Nothing else."""
        return self._made(x, touching=False)

    def _made(self, x: Array, touching: bool) -> Support:
        value, slope = self._solved(x)
        return Support(np.array([value]), slope[None], np.array([touching]), None)

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
        half = land.B.T @ Q @ P @ land.Cy.T + np.outer(self.signal.g, land.Cy @ P @ c) + land.B.T @ Q @ Bw @ land.Dyw.T
        value = self.signal.root * np.sqrt(square) / self.unit
        return value, (half * land.scale).ravel() * (value / square)
