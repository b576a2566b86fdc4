"""A road's spectrum and a loop's poles: what integrals over frequency of a linear vehicle's signals are made of."""

import math

import numpy as np

from models.common.arrays import Array
from models.reality import steps_per_sample
from models.roads.spectrum import Spectrum
from models.vehicle import Vehicle
from sim.linear.frequency import as_met
from sim.ride.weighting import POLES
from synth.controller import Controller
from synth.implemented.loop import implemented_loop


def tracks(vehicle: Vehicle, road: Spectrum, omega: Array) -> Array:
    """What every wheel's track has of the two independent sources of a road, shape (F, r, 2)."""
    alike = road.coherency(omega)
    left, right = np.stack([np.ones_like(alike), np.zeros_like(alike)]), np.stack([alike, np.sqrt(1 - alike**2)])
    return np.moveaxis(np.stack([right if wheel.side == "right" else left for wheel in vehicle.kind.wheels]), -1, 0)


def sources(vehicle: Vehicle, road: Spectrum, omega: Array) -> Array:
    """What every wheel meets of the two independent sources of a road, complex, shape (F, r, 2)."""
    return as_met(vehicle, omega, road.speed)[..., None] * tracks(vehicle, road, omega)


def longest_panel(vehicle: Vehicle, speed: float) -> float:
    """How far frequencies may be apart that see how much later the last axle meets the road [rad/s]."""
    delay = max(wheel.behind(vehicle.parameters) for wheel in vehicle.kind.wheels) / speed
    return 2 * np.pi / delay if delay else math.inf


def loop_poles(vehicle: Vehicle, controller: Controller, timestep: float, high: float) -> tuple[Array, float]:
    """Poles of the sampled loop and of the weighting up to a frequency [rad/s], and what rounding leaves open of the slowest.

    A loop that is sampled has every pole again at every multiple of its sampling frequency, and so has the weighting of images.
    """
    loop = implemented_loop(vehicle, controller, timestep).transition
    period = timestep * steps_per_sample(vehicle.implementation, timestep)
    values = np.linalg.eigvals(loop)
    found = np.log(values[np.abs(values) > 1e-12].astype(complex)) / period
    again = np.arange(0, math.ceil(high * period / (2 * np.pi)) + 1) * (2j * np.pi / period)
    weighting = [2 * np.pi * f * (-1 / (2 * q) + 1j * math.sqrt(1 - 1 / (4 * q**2))) for f, q in POLES]
    doubt = np.finfo(float).eps * len(loop) / (-float(found.real.max()) * period)
    return np.add.outer(again, np.concatenate([found, weighting, np.conj(weighting)])).ravel(), doubt


def power_of(amplitude: Array) -> Array:
    """Spectrum of a signal from its amplitudes by source, shape (..., 2) to (...)."""
    return np.sum(np.abs(amplitude) ** 2, axis=-1)
