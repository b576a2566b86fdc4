"""Adaptive quadrature over a frequency band.

The frequency band is divided into panels. The length of a panel is at most a fraction of the distance to the nearest pole in
the complex plane. A spectrum is therefore equally smooth on all panels; even a resonance with a damping of 1e-6 needs only a
few more panels. Each panel has Gauss-Legendre nodes, which are exact for polynomials up to degree 19. The error estimate is the
part of the integrand with polynomial degrees 8 and 9, which is far larger than the true error. Panels with a large error
estimate are split into halves.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array

SHARE = 0.7  # length of an integration panel, relative to its distance from the nearest pole
ORDER = 10  # number of nodes in an integration panel
NODES, WEIGHTS = np.polynomial.legendre.leggauss(ORDER)
# Weights that give the integrals of a function times the Legendre polynomials of degrees 8 and 9
LAST = WEIGHTS * np.polynomial.legendre.legvander(NODES, ORDER - 1)[:, -2:].T
ENOUGH = 1e-5  # allowed error estimate of an integration panel, relative to the integral
HALVINGS = 20  # largest number of rounds in which integration panels are halved
# largest number of integration panels, which have 200 000 frequencies; if more are needed, the error estimate is large
MOST_PANELS = 20_000
# An integral below this multiple of the largest integral is a rounding error, such as the roll of a car on equal tracks
NOTHING = 1e-24
FINEST = 1e-12  # length of the shortest integration panel, relative to its frequency


@dataclass(frozen=True, eq=False)
class Band:
    """Values of a function at the quadrature nodes of a frequency band.

    Attributes:
        omega: frequencies of the nodes in ascending order [rad/s], shape (F,).
        share: quadrature weights [Hz], shape (F,). The integral of a function over frequency is `share @ integrand`.
        values: values of the function at the nodes, shape (F, ...).
        error: largest estimated relative error among the integrals whose accuracy was checked.
    """

    omega: Array
    share: Array
    values: Array
    error: float

    def before(self, other: "Band") -> "Band":
        """Returns the frequency band of this object followed by the adjacent band `other`.

        The error of the result is the error of `other`, because the integrals over `other` dominate.
        """
        pairs = zip((self.omega, self.share, self.values), (other.omega, other.share, other.values), strict=True)
        return Band(*(np.concatenate(pair) for pair in pairs), error=other.error)

    def turning(self, time: float) -> Array:
        """Returns complex weights for Fourier integrals, shape (F,).

        The integral of f exp(j omega t) over frequency [Hz] is `turning(t) @ f`. The integral is accurate for any t [s],
        because f is treated as the polynomial through its nodes on each panel. The method uses the formula 2 j^l j_l(a) for the
        integral of P_l(x) exp(j a x) from -1 to 1, where P_l is a Legendre polynomial and j_l a spherical Bessel function.
        """
        from scipy import special  # this import takes 0.1 s

        share, middle = self.share.reshape(-1, ORDER), self.omega.reshape(-1, ORDER).mean(axis=1)
        half, degrees = np.pi * share.sum(axis=1), np.arange(ORDER)  # the sum of the Gauss-Legendre weights is 2
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
    """Samples a function at enough frequencies of a band to make integrals over the values of the function accurate.

    Args:
        function: function of frequencies [rad/s] of shape (F,), which returns values of shape (F, ...).
        checked: function of frequencies, shape (F,), and of the values that `function` has at these frequencies. `checked`
            returns c nonnegative integrands whose integrals must be accurate, shape (F, c).
        low, high: ends of the frequency band, above 0 [rad/s].
        poles: poles of the function [rad/s], complex, shape (n,). The panels near poles are short.
        longest: largest length of a panel [rad/s].
    """
    left, right = _panels(low, high, poles, longest)
    omega = _nodes(left, right)
    values = function(omega)
    integrands = checked(omega, values)
    for _ in range(HALVINGS):
        rough = _estimate(integrands, right - left) > ENOUGH
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
    """Returns the left and right ends of the panels [rad/s]."""
    ends, longest = [low], max(longest, (high - low) / MOST_PANELS)
    while ends[-1] < high:
        here = ends[-1]
        # The spectrum of a road has a pole at 0, so 0 counts as a pole. The length of a panel has a lower limit, because panels
        # shorter than rounding errors are useless.
        step = max(SHARE * min(here, float(np.abs(1j * here - poles).min(initial=np.inf))), FINEST * here)
        end = here + min(step, longest)
        ends.append(high if end + step / 5 >= high else end)
    return np.array(ends[:-1]), np.array(ends[1:])


def _nodes(left: Array, right: Array) -> Array:
    """Returns the nodes of P panels in ascending order [rad/s], shape (P ORDER,)."""
    return ((left + right)[:, None] / 2 + np.multiply.outer((right - left) / 2, NODES)).ravel()


def _estimate(integrands: Array, width: Array) -> Array:
    """Returns the relative error estimate of every panel, shape (P,): the largest of the estimates for all integrals."""
    by_panel = integrands.reshape(len(width), ORDER, -1)
    whole = np.einsum("k,pkc,p->c", WEIGHTS, by_panel, width)
    last = np.abs(np.einsum("lk,pkc,p->lpc", LAST, by_panel, width)).max(axis=0)
    counts = whole > NOTHING * whole.max(initial=0.0)
    return np.divide(last, whole, out=np.zeros_like(last), where=counts).max(axis=1, initial=0.0)
