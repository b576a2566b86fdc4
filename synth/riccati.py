"""The proof of a norm: an X for the bounded-real LMI (20), from a Riccati equation instead of an LMI solver."""

import numpy as np
from scipy import linalg

from models.arrays import Array
from synth.certificate import Certificate, certify
from synth.lower_bound import LowerBound
from synth.norm import balance
from synth.plant import GeneralizedPlant

MARGINS = (1e-6, 1e-4, 1e-2)  # how far above the norm the bound lies, the first that can be proved in floating point


def proved(plant: GeneralizedPlant, G: Array, lower: LowerBound | None = None) -> Certificate:
    """The certificate of a stabilising state gain, with a bound just above its norm if one can be proved, else without.

    Args:
        plant: n states, m inputs.
        G: state gain K C_y (6), shape (m, n).
        lower: what no controller of the gain's kind can beat.
    """
    plain = certify(plant, G, lower=lower)
    if not plain.stable or not 0 < plain.norm.value < np.inf:
        return plain
    loop = plant.closed_loop(G)
    for margin in MARGINS:
        gamma = plain.norm.value * (1 + margin)
        try:
            X = bounding_x(loop, gamma, margin)
        except (np.linalg.LinAlgError, ValueError):  # too close to the norm for the Riccati solver
            continue
        certificate = certify(plant, G, X, gamma**-2, lower)
        if not certificate.failures:
            return certificate
    return plain


def bounding_x(loop: GeneralizedPlant, gamma: float, margin: float) -> Array:
    """X > 0 that satisfies (20) for a stable loop whose norm is below gamma, shape (n, n).

    It solves A X + X A' + eta Bw Bw' + (X C' + eta Bw Dw') (I - eta Dw Dw')^-1 (..)' + eps I = 0, the Schur complement of (20)
    with a little to spare (Zhou, Doyle, Glover 1996, section 13.5).
    """
    _, scale = balance(loop.A)
    loop = loop.in_coordinates(np.diag(scale))
    eta, d = gamma**-2, len(loop.C)
    constant = eta * loop.Bw @ loop.Bw.T
    constant += 1e-3 * margin * float(np.linalg.norm(constant)) * np.eye(len(loop.A))
    weight = -(np.eye(d) - eta * loop.Dw @ loop.Dw.T)
    X = linalg.solve_continuous_are(loop.A.T, loop.C.T, constant, weight, s=eta * loop.Bw @ loop.Dw.T)
    return scale[:, None] * (X + X.T) / 2 * scale
