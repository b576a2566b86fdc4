"""Norm in a frequency band as a function of the gain, for loops that may contain gain errors of sensors and actuators.

This function is like the norm in `synth.design.descent.landscape`, but it includes only frequencies within the band and its
ends. A finite norm in a band does not imply stability, so stability is required separately.
"""

from functools import partial

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.analysis.norm import highest, level_crossings
from synth.design.descent.landscape import NEAR, Landscape, refine_maxima
from synth.plant.discrete import mapped_frequency
from synth.plant.generalized import Plant

EVERYWHERE = (0.0, np.inf)
Band = tuple[float, float]


class BandLandscape(Landscape):
    """Norm of the closed loops of one plant in one frequency band, as a function of the gain.

    Attributes:
        band: lower and upper frequency [rad/s]; for a discrete plant, frequencies of its continuous counterpart.
        own: number of states of the plant without its filters.
    """

    def __init__(self, plant: Plant, band: Band, like: Landscape | None = None) -> None:
        """Args:
        plant: generalised plant with n states, m inputs, r disturbances and q measurements.
        band: lower and upper frequency [rad/s].
        like: landscape whose scales are used, so that the same points represent the same gains; None to use the plant's own
            scales.
        """
        super().__init__(plant)
        self.band = band if plant.dt is None else (mapped_frequency(band[0], plant.dt), mapped_frequency(band[1], plant.dt))
        self.own = len(plant.A) - plant.weights
        if like is not None:
            self.scale = like.scale

    @property
    def narrow(self) -> bool:
        """True if the band excludes some frequencies."""
        return self.band != EVERYWHERE

    def norm(self, x: Array, above: float = np.inf) -> tuple[float, float]:
        """Returns the largest gain in the band and its frequency [rad/s]; the gain is infinite if the loop is unstable."""
        if not self.narrow:
            return super().norm(x, above)
        modes, (low, high) = self.modes(x), self.band
        if not np.all(np.real(modes.poles) < -1e-13 * np.abs(modes.poles).max()):
            return np.inf, np.nan
        upper = modes.poles[np.imag(modes.poles) >= 0]
        omega = self._inside(np.concatenate([np.imag(upper), np.abs(upper), self.peaks]))
        best, at = (modes.at_infinity, np.inf) if np.isinf(high) else (0.0, low)
        for turn in range(30):
            gain, i = highest(self._responses(modes, omega), best * (1 + NEAR))
            if gain > best * (1 + NEAR):
                best, at = gain, float(omega[i])
            elif turn:
                break
            if best > above or best == 0:
                break
            omega = self._inside(level_crossings(modes.loop, best * (1 + NEAR)))
            omega = np.concatenate([omega, (omega[:-1] + omega[1:]) / 2])
        if np.isfinite(at):
            self.peaks = [*self.peaks[-5:], at]
        return best, at

    def summits(self, x: Array, level: float) -> Array:
        """Returns the frequencies [rad/s] of the local maxima of the gain in the band that exceed a level, shape (P,), ascending.

        An end of the band counts as a maximum if the gain decreases from this end into the band.
        """
        if not self.narrow:
            return super().summits(x, level)
        modes = self.modes(x)
        if np.isinf(self.band[1]):
            level = max(level, modes.at_infinity * (1 + 1e-6))
        edges = self._inside(level_crossings(modes.loop, level))
        between = edges[:-1, None] + np.diff(edges)[:, None] * (np.arange(5) + 0.5) / 5
        omega = np.unique(np.concatenate([edges, between.ravel(), self._inside(np.array(self.peaks))]))
        gains = self._gains(modes, omega)
        around = np.concatenate([[0.0], gains, [0.0]])
        top = np.flatnonzero((gains >= level) & (gains >= around[:-2]) & (gains >= around[2:]))
        ends, top = omega[top[(top == 0) | (top == len(omega) - 1)]], top[(top > 0) & (top < len(omega) - 1)]
        sides = omega[top - 1], omega[top], omega[top + 1]
        inside = refine_maxima(partial(self._gains, modes), *sides, gains[top]) if len(top) else omega[:0]
        return np.unique(np.concatenate([ends, np.clip(inside, *self.band)]))

    def moving(self, omega: Array) -> Array:
        """Returns True for each frequency at which a peak moves if the gain changes.

        Peaks at the ends of the band do not move.
        """
        low, high = self.band
        return super().moving(omega) & (omega > low * (1 + NEAR)) & (omega < high * (1 - NEAR))

    def slowest(self, x: Array) -> float:
        """Returns the largest real part of the poles that the gain can change [rad/s]; infinite if the loop does not exist."""
        if self.own == len(self.plant.A):
            poles = self.modes(x).poles
        else:
            A = self.loop(x).A[: self.own, : self.own]
            poles = np.linalg.eigvals(A) if np.isfinite(A).all() else np.array([np.nan])
        largest = float(np.real(poles).max())
        return largest if np.isfinite(largest) else np.inf

    def decays(self, x: Array) -> tuple[Array, Array]:
        """Returns the real parts of the poles that the gain changes [rad/s], shape (P,), and their derivatives, shape (P, m q).

        A pair of conjugate poles counts once. Poles of filters are omitted, because no gain can change these poles. The filter
        states are the last states.
        """
        loop, own, known = self.loop(x), slice(self.own), self.modes(x) if self.own == len(self.plant.A) else None
        if known is not None and known.vectors is not None:
            poles, (right, left) = known.poles, known.vectors
            mask = np.imag(poles) >= 0
            left, right = left[mask], right[:, mask].T
        else:
            poles, left, right = (np.asarray(part) for part in linalg.eig(loop.A[own, own], left=True, right=True))
            mask = np.imag(poles) >= 0
            left, right = left[:, mask].conj().T, right[:, mask].T
        along = np.sum(left * right, axis=1)
        along = np.where(along == 0, np.finfo(float).tiny, along)  # the derivative is infinite where two poles coincide
        driven, seen = left @ loop.B[own], right @ loop.Cy[:, own].T
        slopes = np.real(driven[:, :, None] * seen[:, None, :] / along[:, None, None]) * self.scale
        return np.real(poles[mask]), slopes.reshape(len(slopes), -1)

    def _inside(self, omega: Array) -> Array:
        """Returns the frequencies within the band, with its finite ends, ascending."""
        low, high = self.band
        omega = omega[np.isfinite(omega) & (omega > low) & (omega < high)]
        return np.unique(np.concatenate([[low], omega, [high] if np.isfinite(high) else []]))
