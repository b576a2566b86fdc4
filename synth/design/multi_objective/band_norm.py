"""Norm in a frequency band as a function of the gain, and the decay rate of the loop.

A finite norm in a band does not imply stability, so stability is required separately. Loops may contain gain errors of sensors
and actuators.
"""

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.design.descent.landscape import Band, Landscape
from synth.plant.generalized import Plant


class BandLandscape(Landscape):
    """Norm of the closed loops of one plant in one frequency band, as a function of the gain.

    Attributes:
        own: number of states of the plant without its filters.
    """

    def __init__(self, plant: Plant, band: Band, like: Landscape | None = None) -> None:
        """Args:
        plant: generalised plant with n states, m inputs, r disturbances and q measurements.
        band: lower and upper frequency [rad/s].
        like: landscape whose scales of gain entries are used, so that equal points represent equal gains; None to use the
            plant's own scales.
        """
        super().__init__(plant, band=band)
        self.own = len(plant.A) - plant.weights
        if like is not None:
            self.scale = like.scale

    def slowest(self, x: Array) -> float:
        """Returns the largest real part of the poles that the gain can change [rad/s]; infinite if the loop is ill-posed."""
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
        states are the last states of the plant.
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
