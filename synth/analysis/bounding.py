"""The proof of a norm: an X for the bounded-real LMI (20), from a Riccati equation instead of an LMI solver."""

from dataclasses import replace
from itertools import product

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from synth.analysis.certificate import Certificate, certify, eta_of, prove_bound
from synth.analysis.lower_bound import LowerBound
from synth.analysis.stability import balance
from synth.plant.discrete import continuous_loop
from synth.plant.generalized import Feedback, GeneralizedPlant
from synth.plant.numerics import numerics
from synth.plant.units import size

MARGINS = (1e-6, 1e-4, 1e-2, 0.1)  # relative distance of the bound from the norm; the first that is proved counts
SMALL = (1e-9, 1e-6, 1e-3)  # relative to the size of the plant's matrices: bounds for norms that are nearly zero
TO_SPARE = (1e-1, 1e-3, 1e-6)  # share of the margin: added disturbance, which must exceed the rounding
EVERYWHERE = (1e-9, 1e-12, 1e-6, 1e-4, 1e-3)  # share of the disturbance added at all states, so that X > 0; rounding decides
LOOSE = (1.0, 10.0, 100.0)  # margins if rounding leaves no closer proof, as for a z in which large states cancel
LEAST_SEEN = (
    1e-2,
    1e-3,
    1e-4,
    1e-5,
)  # with LOOSE margins: share of z's power added at all states, more at those that are less observable in z
BLIND = 1e-14  # smallest observability that is told apart, relative to the largest: below lies rounding


@numerics()
def certify_tightly(
    plant: GeneralizedPlant,
    G: Array | Feedback,
    lower_bound: LowerBound | None = None,
    by_itself: GeneralizedPlant | None = None,
) -> Certificate:
    """Returns the certificate of a stabilising gain, with a bound just above its norm if one can be proved.

    For gains without an X, as from a descent. `certify` checks a given X, or leaves the gain without a bound.

    Args:
        G: the gain from measurements (6), or a state gain, shape (m, n).
        lower_bound: on the norm of any controller of the gain's kind.
        by_itself: as for `certify`.
    """
    plain = certify(plant, G, lower_bound=lower_bound, by_itself=by_itself)
    if not plain.stable or not np.isfinite(plain.norm.value):
        return plain
    # The peak of a discrete loop is mapped near 0: near infinity the Riccati equation's weight would be singular.
    late, over = plain.norm.peak_frequency * (plant.dt or 0.0) > np.pi / 2, plant.dt or 1.0
    loop = continuous_loop(plant.closed_loop(G), turned=late)
    above = [(plain.norm.value * (1 + margin), margin) for margin in (*MARGINS, *LOOSE) if plain.norm.value > 0]
    own = plant.differences
    unit = float(np.linalg.norm(own.Dw, 2)) + size(own.C) * size(own.Bw) / size(own.A)
    # If the norm is zero to rounding, an absolute bound can be proved.
    small = [(least * unit, 1.0) for least in SMALL if least * unit > 2 * plain.norm.value]
    close = above[: len(MARGINS)]
    for levels, everywhere, least_seen in ((close, EVERYWHERE, False), (above, LEAST_SEEN, True), (small, EVERYWHERE, False)):
        for (gamma, margin), share, strength in product(levels, TO_SPARE, everywhere):
            try:
                X = over * bounding_x(loop, gamma, share * margin, strength, least_seen)
            except (np.linalg.LinAlgError, ValueError):  # too close to the norm for the Riccati solver
                continue
            certificate = replace(plain, proof=prove_bound(plant, G, X, eta_of(gamma)))  # the rest is as it was
            if not certificate.failures:
                return certificate
    return plain


def bounding_x(loop: GeneralizedPlant, gamma: float, more: float, everywhere: float, least_seen: bool = False) -> Array:
    """Returns X > 0 that satisfies (20) for a stable loop whose norm is below gamma, shape (n, n).

    X solves A X + X A' + eta Bw~ Bw~' + (X C' + eta Bw Dw') (I - eta Dw Dw')^-1 (..)' = 0, the Schur complement of (20) with a
    margin (Zhou, Doyle, Glover 1996, section 13.5): Bw~ Bw~' is Bw Bw' and `more` times the noise. The equation is solved in
    coordinates in which the states under that noise are uncorrelated and of size one, so that no unit costs digits.

    Args:
        loop: continuous and stable.
        gamma: above its norm.
        more: relative; small against the relative distance of gamma from the norm.
        everywhere: share of the disturbance's power that is added at all states, also those that w does not reach.
        least_seen: scale the added power by each direction's observability in z: the less observable, the more.

    Raises:
        LinAlgError: rounding leaves no solution.
    """
    _, scale = balance(loop.A)
    loop = loop.in_coordinates(np.diag(scale))
    eta, d, n = gamma**-2, len(loop.C), len(loop.A)
    noise = loop.Bw @ loop.Bw.T
    if least_seen:
        seen = linalg.solve_continuous_lyapunov(loop.A.T, -loop.C.T @ loop.C)
        sizes, directions = np.linalg.eigh((seen + seen.T) / 2)
        power = float(np.trace(seen @ noise))
        noise += everywhere * power / n * (directions / np.maximum(sizes, BLIND * sizes[-1])) @ directions.T
    else:
        noise += everywhere * (float(np.trace(noise)) or 1.0) * np.eye(n)
    covariance = linalg.solve_continuous_lyapunov(loop.A, -noise)
    T = np.linalg.cholesky((covariance + covariance.T) / 2)
    loop = loop.in_coordinates(T)
    noise = np.linalg.solve(T, np.linalg.solve(T, noise).T)
    noise = (noise + noise.T) / 2  # rounding tells them apart, and the Riccati solver would refuse that
    constant = eta * (loop.Bw @ loop.Bw.T + more * noise)
    weight = -(np.eye(d) - eta * loop.Dw @ loop.Dw.T)
    X = linalg.solve_continuous_are(loop.A.T, loop.C.T, constant, weight, s=eta * loop.Bw @ loop.Dw.T)
    T = scale[:, None] * T
    return T @ (X + X.T) / 2 @ T.T
