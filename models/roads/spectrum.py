"""Spectrum of a random road, coherency of its two tracks, and the road as every wheel of a vehicle meets it."""

import math
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.vehicle.vehicle import Vehicle


@dataclass(frozen=True)
class Spectrum:
    """Spectrum of a random road that is driven at constant speed.

    Attributes:
        density: one-sided, of the road's vertical velocity, which is white within the band [(m/s)^2/Hz].
        band: lowest and highest frequency [rad/s].
        speed: V [m/s].
        length: distance after which the road repeats: it is a sum of lines, 1 / length apart [m].
        track_width: lateral distance from the right track to the left [m].
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
        width: distance between the tracks, b [m].
    """
    from scipy import special  # a tenth of a second

    x = 2 * np.pi * np.asarray(n) * width
    return np.where(x > 0, x * special.k1(np.where(x > 0, x, 1.0)), 1.0)


def as_met(vehicle: Vehicle, omega: Array, speed: float) -> Array:
    """Returns the road under every wheel for a road exp(j omega t) under the first wheel, shape (F, r).

    Args:
        vehicle: r wheels.
        omega: angular frequencies [rad/s], shape (F,).
        speed: forward velocity [m/s].
    """
    later = np.array([wheel.behind(vehicle.parameters) / speed for wheel in vehicle.kind.wheels])
    return np.exp(-1j * np.multiply.outer(omega, later))


def tracks(vehicle: Vehicle, road: Spectrum, omega: Array) -> Array:
    """Returns the share of the two independent sources of a road in every wheel's track, shape (F, r, 2)."""
    alike = road.coherency(omega)
    left, right = np.stack([np.ones_like(alike), np.zeros_like(alike)]), np.stack([alike, np.sqrt(1 - alike**2)])
    return np.moveaxis(np.stack([right if wheel.side == "right" else left for wheel in vehicle.kind.wheels]), -1, 0)


def sources(vehicle: Vehicle, road: Spectrum, omega: Array) -> Array:
    """Returns the road under every wheel by the two independent sources, complex, shape (F, r, 2)."""
    return as_met(vehicle, omega, road.speed)[..., None] * tracks(vehicle, road, omega)


def longest_panel(vehicle: Vehicle, speed: float, ahead: float = 0.0) -> float:
    """Returns the largest spacing of frequencies that resolves the delay of the last axle, and what is known ahead [rad/s].

    Args:
        speed: vehicle speed [m/s].
        ahead: time by which the road is known ahead [s].
    """
    delay = max(wheel.behind(vehicle.parameters) for wheel in vehicle.kind.wheels) / speed + ahead
    return 2 * np.pi / delay if delay else math.inf
