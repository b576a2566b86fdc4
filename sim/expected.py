"""What a random road is expected to do to a linear vehicle: every metric, from the road's spectrum through the closed loop.

The road's vertical velocity is white within its band: the one-sided spectrum (2 pi n0)^2 G_d(n0) V per Hz. Rear wheels meet it
later, the other track shares of it what the coherency says, so wheel j meets e_j(omega) of two independent white sources. With
the frequency response H of the loop as it is implemented,

    S_ik(omega) = G_v sum over sources of (H e)_i conj(H e)_k,    cov(i, k) = integral of Re S_ik df.

Signals are Gaussian, and the rest follows: shares of time beyond a threshold, the VDV by E a^4 = 3 sigma^4, the energy by the
mean positive part of a product of two Gaussians. Largest values over the window T are Davenport's, with the rate of independent
crossings of A. Der Kiureghian (1980), Earthq. Eng. Struct. Dyn. 8, 583-587; the largest running mean square is taken to be that
of 3 T / (1 s) independent gamma variates. Those two are approximations, good to some 5 %; the others are exact for a linear run
that has forgotten its beginning.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from models.arrays import Array
from models.vehicle import Vehicle
from sim.frequency import as_met, sampled_frequency_response
from sim.iso8608 import HIGHEST, LOWEST, N0, Iso8608, coherency, roughness
from sim.linear import driven, sampled_radius
from sim.metrics import RUNNING, dynamic_load, energy, off_ground, points, power
from sim.weighting import wk
from synth.controller import Controller

LINES = 1500  # on a logarithmic scale: 0.5 % apart, where vehicles' resonances are 5 % wide or more
FORGOTTEN = 0.01  # share of its variance that a vehicle from rest may still miss when measuring begins


@dataclass(frozen=True, eq=False)
class Expected:
    """Expected metrics of one run over roads of a kind.

    Attributes:
        mean: by metric; for those that are roots of mean squares, the root of the expected mean square.
        spread: standard deviation of the metric from road to road over the window, for those roots; by metric.
    """

    mean: dict[str, float]
    spread: dict[str, float]


def settling_time(vehicle: Vehicle, controller: Controller) -> float:
    """When a vehicle from rest has all but `FORGOTTEN` of its variance [s]; infinite where the loop is unstable."""
    model, G = driven(vehicle, controller)
    slowest = float(np.linalg.eigvals(model.A + model.B @ G).real.max())
    return math.log(FORGOTTEN) / (2 * slowest) if slowest < 0 else math.inf


def sources(vehicle: Vehicle, road: Iso8608, omega: Array) -> Array:
    """What every wheel meets of the two independent sources of a road, complex, shape (F, r, 2)."""
    alike = coherency(omega / (2 * np.pi * road.speed), road.track_width)
    left, right = np.stack([np.ones_like(alike), np.zeros_like(alike)]), np.stack([alike, np.sqrt(1 - alike**2)])
    tracks = np.stack([right if wheel.side == "right" else left for wheel in vehicle.kind.wheels])
    return as_met(vehicle, omega, road.speed)[..., None] * np.moveaxis(tracks, -1, 0)


def expect(vehicle: Vehicle, controller: Controller, road: Iso8608, timestep: float, window: float) -> Expected | None:
    """The expected metrics; None where the loop is unstable and has no variance.

    Args:
        vehicle: the vehicle.
        controller: its controller.
        road: of which kind; its seed does not matter.
        timestep: of the sampled loop [s].
        window: how long is measured [s].
    """
    if sampled_radius(vehicle, controller, timestep) >= 1:
        return None
    omega = 2 * np.pi * road.speed * np.geomspace(LOWEST, HIGHEST, LINES)
    response = sampled_frequency_response(vehicle, controller, omega, timestep)
    density = (2 * np.pi * N0) ** 2 * roughness(road.road_class) * road.factor**2 * road.speed
    amplitudes = math.sqrt(density) * (response @ sources(vehicle, road, omega))
    index = {name: i for i, name in enumerate(vehicle.linear_model.outputs)}
    share = np.gradient(np.log(omega)) * omega / (2 * np.pi)  # df of every line; the trapezoidal rule in log omega
    share[[0, -1]] /= 2

    def amplitude(name: str) -> Array:
        return amplitudes[:, index[name]]

    mean, spread = {}, {}

    # A road's lines have fixed amplitudes: over its whole length it has no spread.
    rest = max(1 - window * road.speed / road.length, 0.0)

    def root(metric: str, spectrum: Array, scale: float = 1.0) -> _Moments:
        moments = _Moments(spectrum, omega, share)
        mean[metric] = moments.sigma * scale
        # The variance of a mean square over T is the integral of S^2 df / T, and half of it, relatively, that of the root.
        spread[metric] = mean[metric] * math.sqrt(rest * moments.relative_variance(window)) / 2
        return moments

    where, static = points(vehicle), vehicle.kind.static_tyre_deflection(vehicle.parameters)
    for name in where.accelerations:
        spectrum = _power(amplitude(name))
        root(f"{name}_rms", spectrum)
        weighted = root(f"{name}_weighted", np.abs(wk(omega)) ** 2 * spectrum)
        mean[f"{name}_vdv"] = (3 * window) ** 0.25 * weighted.sigma
        mean[f"{name}_mtvv"] = weighted.largest_running(window)
        mean[f"{name}_crest"] = weighted.largest(window)
    for name in where.suspensions:
        moments = root(f"{name}_rms", _power(amplitude(name)))
        mean[f"{name}_peak"] = moments.largest(window) * moments.sigma
        if vehicle.limits.suspension_stroke is not None:
            mean[f"{name}_at_stops"] = 2 * moments.beyond(vehicle.limits.suspension_stroke)
    for name in where.tyres:
        moments = root(dynamic_load(name), _power(amplitude(name)), 1 / static[name])
        mean[off_ground(name)] = moments.beyond(static[name])
    for name, *ends in where.actuators:
        force = amplitude(name)
        moments = root(f"{name}_rms", _power(force))
        mean[f"{name}_peak"] = moments.largest(window) * moments.sigma
        if ends:
            closing = amplitude(ends[0]) - amplitude(ends[1])
            net = float(share @ np.sum(np.real(force * np.conj(closing)), axis=-1))
            size = moments.sigma * _Moments(_power(closing), omega, share).sigma
            mean[power(name)], mean[energy(name)] = net, _positive_part(net, size) * window
    return Expected(mean, spread)


@dataclass(frozen=True, eq=False)
class _Moments:
    """A Gaussian signal of one-sided spectrum S(omega) per Hz, shape (F,), at lines of `share` Hz each."""

    spectrum: Array
    omega: Array
    share: Array

    @property
    def sigma(self) -> float:
        return float(self.share @ self.spectrum) ** 0.5

    def relative_variance(self, window: float) -> float:
        """Of the mean square over a window [s], relative to its square. No slower than a constant, whose square varies by 2."""
        return min(float(self.share @ self.spectrum**2) / (window * (self.sigma or 1.0) ** 4), 2.0)

    def beyond(self, threshold: float) -> float:
        """Share of time above a threshold."""
        return float(special.erfc(threshold / (self.sigma * math.sqrt(2)))) / 2 if self.sigma else 0.0

    def largest(self, window: float) -> float:
        """Expected largest magnitude within a window [s], over sigma."""
        if not self.sigma:
            return 0.0
        m0, m1, m2 = (float(self.share @ (self.omega**k * self.spectrum)) for k in range(3))
        width = math.sqrt(max(1 - m1**2 / (m0 * m2), 0.0))
        crossings = math.sqrt(m2 / m0) / math.pi * window
        if width < 0.69:
            crossings *= 1.63 * max(width, 0.1) ** 0.45 - 0.38
        level = math.sqrt(2 * math.log(max(crossings, 2.0)))
        return level + 0.5772 / level

    def largest_running(self, window: float) -> float:
        """Expected root of the largest running mean square."""
        if not self.sigma:
            return 0.0
        # The exponential mean over 1 s varies as the plain one over twice as long.
        shape = 1 / self.relative_variance(2 * RUNNING)
        count = 3 * max(
            window / RUNNING, 1.0
        )  # it comes back about so often: with the square of the level, in sigmas, that it reaches
        likely = math.exp(-math.exp(-0.5772) / count)
        return self.sigma * math.sqrt(float(special.gammaincinv(shape, likely)) / shape)


def _power(amplitude: Array) -> Array:
    """Spectrum of a signal from its amplitudes by source, shape (F, 2) to (F,)."""
    return np.sum(np.abs(amplitude) ** 2, axis=-1)


def _positive_part(covariance: float, size: float) -> float:
    """E max(x y, 0) of two Gaussians of this covariance and this product of standard deviations."""
    r = min(max(covariance / size, -1.0), 1.0) if size else 0.0
    return size * (math.sqrt(1 - r**2) + r * math.acos(-r)) / math.pi
