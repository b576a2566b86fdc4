"""Integrals over frequency of a vehicle's signals: a road's spectrum, a loop's poles, frequencies that stand for a band.

The band is cut into panels no longer than a share of the way to the nearest pole in the complex plane. On such a panel a spectrum
is as smooth as on any other, so a resonance of damping 1e-6 takes some more panels and no other care. A panel has the nodes of
Gauss and Legendre, exact for polynomials up to degree 19. What the integrand has of degree 9 and 8 there is the estimate, far
more than the true error; a panel that has too much of it is halved.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import special

from models.common.arrays import Array
from models.roads.spectrum import Spectrum
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.linear.frequency_response import as_met
from sim.studies.ride.weighting import POLES
from synth.controller.controller import Controller
from synth.controller.open_loop import LoopModel

SHARE = 0.7  # of the way to the nearest pole
ORDER = 10  # nodes of a panel
NODES, WEIGHTS = np.polynomial.legendre.leggauss(ORDER)
LAST = WEIGHTS * np.polynomial.legendre.legvander(NODES, ORDER - 1)[:, -2:].T  # moments with the last two polynomials
ENOUGH = 1e-5  # what the estimate of a panel may be, of the whole integral
HALVINGS = 20
MOST_PANELS = 20_000  # 200 000 frequencies; where they do not do, the estimate says so
FINEST = 1e-12  # of a frequency, for a panel's length


@dataclass(frozen=True, eq=False)
class Band:
    """Frequencies that stand for a band.

    Attributes:
        omega: ascending [rad/s], shape (F,).
        share: of the band, that each stands for [Hz], shape (F,): an integral over frequency is `share @ integrand`.
        values: of the function, at them, shape (F, ...).
        error: estimate of the largest error of a checked integral, relative.
    """

    omega: Array
    share: Array
    values: Array
    error: float

    def before(self, other: "Band") -> "Band":
        """Concatenates two adjacent bands. The error is that of `other`, whose integrals dominate."""
        pairs = zip((self.omega, self.share, self.values), (other.omega, other.share, other.values), strict=True)
        return Band(*(np.concatenate(pair) for pair in pairs), error=other.error)

    def turning(self, time: float) -> Array:
        """Complex weights, shape (F,): `turning(t) @ f` is the integral of f exp(j omega t) over frequency, however late t [s].

        On a panel f is the polynomial through its nodes, and of a Legendre polynomial that integral is a spherical Bessel
        function: that of P_l(x) exp(j a x) over -1..1 is 2 j^l j_l(a).
        """
        share, middle = self.share.reshape(-1, ORDER), self.omega.reshape(-1, ORDER).mean(axis=1)
        half, degrees = np.pi * share.sum(axis=1), np.arange(ORDER)  # the weights' sum is 2
        moments = (2 * degrees + 1) * 1j**degrees * special.spherical_jn(degrees, half[:, None] * time)
        turned = moments @ np.polynomial.legendre.legvander(NODES, ORDER - 1).T
        return (share * turned * np.exp(1j * middle * time)[:, None]).ravel()


def sample_band(
    function: Callable[[Array], Array],
    checked: Callable[[Array, Array], Array],
    low: float,
    high: float,
    poles: Array,
    longest: float,
) -> Band:
    """A function at as many frequencies of a band as are needed for integrals of what is made of it.

    Args:
        function: of frequencies [rad/s], (F,) to (F, ...).
        checked: of frequencies, shape (F,), and the function's values there: the integrands, none below 0, shape (F, c).
        low, high: the band's ends, above 0 [rad/s].
        poles: of the function [rad/s], complex, shape (n,); at omega it is as smooth as they are far from j omega.
        longest: of panels [rad/s].
    """
    left, right = _panels(low, high, poles, longest)
    omega = _nodes(left, right)
    values = function(omega)
    integrands = checked(omega, values)
    for _ in range(HALVINGS):
        apart = _estimate(integrands, right - left)
        rough = apart > ENOUGH
        if not rough.any() or len(left) > MOST_PANELS:
            break
        middle = (left[rough] + right[rough]) / 2
        left, right = (
            np.concatenate([left[~rough], left[rough], middle]),
            np.concatenate([right[~rough], middle, right[rough]]),
        )
        kept, new = np.repeat(~rough, ORDER), _nodes(left, right)[np.count_nonzero(~rough) * ORDER :]
        more = function(new)
        omega, values = np.concatenate([omega[kept], new]), np.concatenate([values[kept], more])
        integrands = np.concatenate([integrands[kept], checked(new, more)])
    share = (np.outer((right - left) / 2, WEIGHTS) / (2 * np.pi)).ravel()
    order = np.argsort(omega)
    error = float(_estimate(integrands, right - left).sum())
    return Band(omega[order], share[order], values[order], error)


def _panels(low: float, high: float, poles: Array, longest: float) -> tuple[Array, Array]:
    """Left and right ends of the panels."""
    ends, longest = [low], max(longest, (high - low) / MOST_PANELS)
    while ends[-1] < high:
        here = ends[-1]
        # 0 counts as a pole: spectra of roads have one there. Closer to a pole than rounding there is nothing to resolve.
        step = max(SHARE * min(here, float(np.abs(1j * here - poles).min(initial=np.inf))), FINEST * here)
        end = here + min(step, longest)
        ends.append(high if end + step / 5 >= high else end)
    return np.array(ends[:-1]), np.array(ends[1:])


def _nodes(left: Array, right: Array) -> Array:
    """Frequencies of the panels, one after the other, shape (P ORDER,)."""
    return ((left + right)[:, None] / 2 + np.multiply.outer((right - left) / 2, NODES)).ravel()


def _estimate(integrands: Array, width: Array) -> Array:
    """Returns the largest relative error estimate of any integral, for every panel, shape (P,)."""
    by_panel = integrands.reshape(len(width), ORDER, -1)
    whole = np.einsum("k,pkc,p->c", WEIGHTS, by_panel, width)
    apart = np.abs(np.einsum("lk,pkc,p->lpc", LAST, by_panel, width)).max(axis=0)
    return np.divide(apart, whole, out=np.zeros_like(apart), where=whole > 0).max(axis=1, initial=0.0)


def tracks(vehicle: Vehicle, road: Spectrum, omega: Array) -> Array:
    """Returns the share of the two independent sources of a road in every wheel's track, shape (F, r, 2)."""
    alike = road.coherency(omega)
    left, right = np.stack([np.ones_like(alike), np.zeros_like(alike)]), np.stack([alike, np.sqrt(1 - alike**2)])
    return np.moveaxis(np.stack([right if wheel.side == "right" else left for wheel in vehicle.kind.wheels]), -1, 0)


def sources(vehicle: Vehicle, road: Spectrum, omega: Array) -> Array:
    """Returns the road under every wheel by the two independent sources, complex, shape (F, r, 2)."""
    return as_met(vehicle, omega, road.speed)[..., None] * tracks(vehicle, road, omega)


def longest_panel(vehicle: Vehicle, speed: float) -> float:
    """Returns the largest spacing of frequencies that resolves the delay of the last axle [rad/s]."""
    delay = max(wheel.behind(vehicle.parameters) for wheel in vehicle.kind.wheels) / speed
    return 2 * np.pi / delay if delay else math.inf


def loop_poles(vehicle: Vehicle, controller: Controller, timestep: float, high: float) -> tuple[Array, float]:
    """Poles of the sampled loop and of the weighting up to a frequency [rad/s], and what rounding leaves open of the slowest.

    A loop that is sampled has every pole again at every multiple of its sampling frequency, and so has the weighting of images.
    """
    loop = LoopModel(vehicle, controller, timestep).closed_loop.transition
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
