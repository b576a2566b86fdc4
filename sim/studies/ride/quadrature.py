"""Poles of a sampled loop, near which spectra must be integrated on a fine grid, and spectra computed from complex amplitudes."""

import math

import numpy as np

from models.common.arrays import Array
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.studies.ride.weighting import POLES
from synth.controller.controller import Controller
from synth.controller.loop_of import loop_of


def loop_poles(vehicle: Vehicle, controller: Controller, timestep: float, high: float) -> tuple[Array, float]:
    """Returns the poles that determine the peaks of the spectra, and the relative rounding error of the slowest pole.

    The result contains the poles of the sampled loop and of the frequency weighting. All poles are repeated at multiples of the
    sample rate.

    Args:
        vehicle: vehicle that the controller controls.
        controller: controller of this vehicle.
        timestep: timestep of the simulation [s].
        high: highest frequency for which repeated poles are returned [rad/s].

    Returns:
        Poles [1/s], and the relative rounding error of the slowest pole.
    """
    loop = loop_of(vehicle, controller, timestep).closed_loop.A
    period = timestep * steps_per_sample(vehicle.implementation, timestep)
    values = np.linalg.eigvals(loop)
    poles = np.log(values[np.abs(values) > 1e-12].astype(complex)) / period
    multiples = np.arange(0, math.ceil(high * period / (2 * np.pi)) + 1) * (2j * np.pi / period)
    weighting = [2 * np.pi * f * (-1 / (2 * q) + 1j * math.sqrt(1 - 1 / (4 * q**2))) for f, q in POLES]
    rounding = np.finfo(float).eps * len(loop) / (-float(poles.real.max()) * period)
    return np.add.outer(multiples, np.concatenate([poles, weighting, np.conj(weighting)])).ravel(), rounding


def power_of(amplitude: Array) -> Array:
    """Returns the spectrum of a signal, shape (...), from its complex amplitudes for both road sources, shape (..., 2)."""
    return np.sum(np.abs(amplitude) ** 2, axis=-1)
