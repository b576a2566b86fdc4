"""Proof of a norm bound: a Riccati equation, not an LMI solver, gives a matrix X that satisfies the bounded-real LMI (20)."""

from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.extensions import FEATURES
from models.laws.linear import LinearLaw
from synth.analysis.certificate import Certificate, certify, eta_of, prove_bound
from synth.analysis.stability import balance
from synth.plant.generalized import Feedback, Plant
from synth.plant.numerics import numerics
from synth.plant.units import size

if TYPE_CHECKING:
    from synth.analysis.lower_bounds.lower_bound import LowerBound

MARGINS = (1e-6, 1e-4, 1e-2, 0.1)  # relative gaps between bound and norm, tried in this order until a bound is proved
# if the norm is nearly zero, these bounds are tried; they are relative to a gain that is estimated from the size of the
# matrices
SMALL = (1e-9, 1e-6, 1e-3)
# noise power that is added to Bw Bw', as a fraction of the gap between bound and norm; small, but larger than rounding errors
ADDED_NOISE = (1e-1, 1e-3, 1e-6)
# power of the noise that is added to every state so that X > 0, relative to the power of the disturbance
EVERYWHERE = (1e-9, 1e-12, 1e-6, 1e-4, 1e-3)
# larger relative gaps between bound and norm, tried if rounding prevents a proof with a smaller gap, for example if large
# states cancel in z
LOOSE = (1.0, 10.0, 100.0)
# power of the noise that is added to the states if a gap of `LOOSE` is tried, relative to the power of z. States that are
# less observable in z receive more noise
LEAST_SEEN = (1e-2, 1e-3, 1e-4, 1e-5)
# a state whose observability, relative to the most observable state, is smaller than this counts as unobservable
UNOBSERVABLE = 1e-14


@numerics()
def certify_tightly(
    plant: Plant,
    G: Array | Feedback,
    lower_bound: "LowerBound | None" = None,
    plant_without_law: Plant | None = None,
) -> Certificate:
    """Returns the certificate of a stabilising gain, with a proved bound just above the norm if a proof succeeds.

    In contrast, `certify` does not compute a matrix X: it checks a given X, or returns a certificate without a bound.

    Args:
        plant: plant with n states and m inputs.
        G: gain from the measurements, as in (6) of the paper, or a state gain of shape (m, n).
        lower_bound: lower bound on the norm for all controllers with the same measurements as G.
        plant_without_law: plant without the states of the controller; see `certify`.
    """
    plain = certify(plant, G, lower_bound=lower_bound, plant_without_law=plant_without_law)
    if not plain.stable or not np.isfinite(plain.norm.value):
        return plain
    # If the peak is near z = -1, the loop is mapped so that z = -1 becomes 0 instead of infinity. At infinity, the weight in
    # the Riccati equation would be singular.
    near_nyquist, step = plain.norm.peak_frequency * (plant.dt or 0.0) > np.pi / 2, plant.dt or 1.0
    loop = FEATURES.load("discrete plants").continuous_loop(plant.closed_loop(G), turned=near_nyquist)
    above = [(plain.norm.value * (1 + margin), margin) for margin in (*MARGINS, *LOOSE) if plain.norm.value > 0]
    rates = plant.differences
    unit = float(np.linalg.norm(rates.Dw, 2)) + size(rates.C) * size(rates.Bw) / size(rates.A)
    # If the norm is zero up to rounding, an absolute bound is proved instead of a relative one.
    small = [(least * unit, 1.0) for least in SMALL if least * unit > 2 * plain.norm.value]
    close = above[: len(MARGINS)]
    for levels, everywhere, least_seen in ((close, EVERYWHERE, False), (above, LEAST_SEEN, True), (small, EVERYWHERE, False)):
        for (gamma, margin), share, strength in product(levels, ADDED_NOISE, everywhere):
            try:
                X = step * bounding_x(loop, gamma, share * margin, strength, least_seen)
            except (np.linalg.LinAlgError, ValueError):  # the Riccati solver fails if the bound is too close to the norm
                continue
            certificate = replace(plain, proof=prove_bound(plant, G, X, eta_of(gamma)))
            if not certificate.failures:
                return certificate
    return plain


def certify_law(plant: Plant, law: LinearLaw, lower_bound: "LowerBound | None" = None) -> Certificate:
    """Returns the certificate of a control law on the measurements of a plant; see `certify_tightly` and `Plant.with_law`."""
    return certify_tightly(*plant.with_law(law), lower_bound, plant_without_law=plant)


def bounding_x(loop: Plant, gamma: float, more: float, everywhere: float, least_seen: bool = False) -> Array:
    """Returns a matrix X > 0 that satisfies LMI (20) for a stable loop whose norm is below gamma, shape (n, n).

    The matrix X solves A X + X A' + eta Bw~ Bw~' + (X C' + eta Bw Dw') (I - eta Dw Dw')^-1 (..)' = 0, which is the Schur
    complement of (20) with a margin (Zhou, Doyle, Glover 1996, section 13.5). Bw~ Bw~' is Bw Bw' plus `more` times the
    covariance of a small noise. The equation is solved in coordinates in which the states have the covariance I (identity
    matrix) if only this noise drives them. The accuracy therefore does not depend on the units of the states.

    Args:
        loop: stable loop in continuous time.
        gamma: bound, which must be larger than the norm.
        more: factor that multiplies the noise; the factor should be small compared with the relative gap between gamma and the
            norm.
        everywhere: relative power of the noise that acts on every state, including states that are not controllable from w.
        least_seen: True to make the noise stronger in those directions of the state space that are less observable in z.

    Raises:
        LinAlgError: the equation has no solution because of rounding errors.
    """
    _, scale = balance(loop.A)
    loop = loop.in_coordinates(np.diag(scale))
    eta, d, n = gamma**-2, len(loop.C), len(loop.A)
    noise = loop.Bw @ loop.Bw.T
    if least_seen:
        observability = linalg.solve_continuous_lyapunov(loop.A.T, -loop.C.T @ loop.C)
        sizes, directions = np.linalg.eigh((observability + observability.T) / 2)
        power = float(np.trace(observability @ noise))
        noise += everywhere * power / n * (directions / np.maximum(sizes, UNOBSERVABLE * sizes[-1])) @ directions.T
    else:
        noise += everywhere * (float(np.trace(noise)) or 1.0) * np.eye(n)
    covariance = linalg.solve_continuous_lyapunov(loop.A, -noise)
    T = np.linalg.cholesky((covariance + covariance.T) / 2)
    loop = loop.in_coordinates(T)
    noise = np.linalg.solve(T, np.linalg.solve(T, noise).T)
    noise = (noise + noise.T) / 2  # the Riccati solver rejects a matrix that rounding made slightly unsymmetric
    constant = eta * (loop.Bw @ loop.Bw.T + more * noise)
    weight = -(np.eye(d) - eta * loop.Dw @ loop.Dw.T)
    X = linalg.solve_continuous_are(loop.A.T, loop.C.T, constant, weight, s=eta * loop.Bw @ loop.Dw.T)
    T = scale[:, None] * T
    return T @ (X + X.T) / 2 @ T.T
