"""Spectrum of a random road, and coherency of its two tracks."""

from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array


@dataclass(frozen=True)
class Spectrum:
    """Spectrum of a random road that is driven at constant speed.

    Attributes:
        density: one-sided, of the road's vertical velocity, which is white within the band [(m/s)^2/Hz].
        band: its ends [rad/s].
        speed: V [m/s].
        length: distance after which the road repeats: it is a sum of lines, 1 / length apart [m].
        track_width: from the right track to the left [m].
    """

    density: float
    band: tuple[float, float]
    speed: float
    length: float
    track_width: float

    def coherency(self, omega: Array) -> Array:
        """Returns the coherency of the two tracks at angular frequencies [rad/s], shape like omega."""
        return coherency(omega / (2 * np.pi * self.speed), self.track_width)


def coherency(n: Array, width: float) -> Array:
    """Returns the coherency of two tracks of an isotropic surface, x K_1(x) with x = 2 pi n b (see `iso8608`), shape like n.

    Args:
        n: spatial frequencies [cycle/m].
        width: between the tracks, b [m].
    """
    from scipy import special  # a tenth of a second

    x = 2 * np.pi * np.asarray(n) * width
    return np.where(x > 0, x * special.k1(np.where(x > 0, x, 1.0)), 1.0)
