"""Spectrum of a random road, coherency of its two tracks, and the road under every wheel of a vehicle."""

import math
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.vehicle.vehicle import Vehicle

N0 = 0.1  # reference spatial frequency of road roughness [cycle/m]


@dataclass(frozen=True)
class Spectrum:
    """Spectrum of a random road that is driven at constant speed.

    Attributes:
        density: one-sided power spectral density of the vertical road velocity at `N0` [(m/s)^2/Hz]. For a waviness of 2, the
            road velocity is white noise.
        band: lowest and highest frequency [rad/s].
        speed: vehicle speed V [m/s].
        length: distance after which the road repeats [m]. The road is a sum of sinusoids whose spatial frequencies are 1 /
            length apart.
        track_width: lateral distance between the tracks [m].
        waviness: exponent w of the displacement spectrum, n^-w.
    """

    density: float
    band: tuple[float, float]
    speed: float
    length: float
    track_width: float
    waviness: float = 2.0

    def coherency(self, omega: Array) -> Array:
        """Returns the coherency of the two tracks at angular frequencies [rad/s], same shape as omega."""
        return coherency(omega / (2 * np.pi * self.speed), self.track_width, self.waviness)

    def slope(self, omega: Array) -> Array:
        """Returns the amplitude of the road velocity divided by its value at `N0`, same shape as omega; 1 for waviness 2."""
        return slope_power(omega / (2 * np.pi * self.speed), self.waviness) ** 0.5


def slope_power(n: Array, waviness: float) -> Array:
    """Returns the spectral density of a road's slope, divided by the density at `N0`: (n / n0)^(2 - w), for n in cycle/m."""
    return (np.asarray(n) / N0) ** (2 - waviness)


def coherency(n: Array, width: float, waviness: float = 2.0) -> Array:
    """Returns the coherency of two tracks on an isotropic surface (see `iso8608`), same shape as n.

    The coherency is 2 (x/2)^(w/2) K_{w/2}(x) / Gamma(w/2) with x = 2 pi n b and the modified Bessel function K. For w = 2, this
    is x K_1(x).

    Args:
        n: spatial frequencies [cycle/m].
        width: distance b between the tracks [m].
        waviness: exponent w of the road spectrum.
    """
    from scipy import special  # this import is delayed, because SciPy takes 0.1 s

    x = 2 * np.pi * np.asarray(n) * width
    half, there = waviness / 2, np.where(x > 0, x, 1.0)
    # With this formula, the numbers are the same, bit for bit, as in versions without the parameter `waviness`
    if waviness == 2:
        return np.where(x > 0, x * special.k1(there), 1.0)
    return np.where(x > 0, 2 / special.gamma(half) * (there / 2) ** half * special.kv(half, there), 1.0)


def as_met(vehicle: Vehicle, omega: Array, speed: float) -> Array:
    """Returns the complex amplitude of the road under every wheel, for a road exp(j omega t) under the first wheel, shape (F,
    r).

    Args:
        vehicle: vehicle with r wheels.
        omega: angular frequencies [rad/s], shape (F,).
        speed: forward velocity [m/s].
    """
    later = np.array([wheel.behind(vehicle.parameters) / speed for wheel in vehicle.kind.wheels])
    return np.exp(-1j * np.multiply.outer(omega, later))


def tracks(vehicle: Vehicle, road: Spectrum, omega: Array) -> Array:
    """Returns the shares of two independent random sources in the road velocity on every wheel's track, shape (F, r, 2).

    The shares are divided by the amplitude of the road velocity at `N0`.
    """
    alike = road.coherency(omega)
    left, right = np.stack([np.ones_like(alike), np.zeros_like(alike)]), np.stack([alike, np.sqrt(1 - alike**2)])
    shares = np.moveaxis(np.stack([right if wheel.side == "right" else left for wheel in vehicle.kind.wheels]), -1, 0)
    return shares if road.waviness == 2 else shares * road.slope(omega)[:, None, None]


def sources(vehicle: Vehicle, road: Spectrum, omega: Array) -> Array:
    """Returns the shares of two independent random sources in the road velocity under every wheel, with the wheel's delay,
    shape (F, r, 2).
    """
    return as_met(vehicle, omega, road.speed)[..., None] * tracks(vehicle, road, omega)


def longest_panel(vehicle: Vehicle, speed: float, ahead: float = 0.0) -> float:
    """Returns the largest frequency spacing that resolves the delay of the last axle and the preview time [rad/s].

    Args:
        vehicle: vehicle whose axle positions determine the delays.
        speed: vehicle speed [m/s].
        ahead: preview time, for which the road ahead is known [s].
    """
    delay = max(wheel.behind(vehicle.parameters) for wheel in vehicle.kind.wheels) / speed + ahead
    return 2 * np.pi / delay if delay else math.inf
