"""The matrix of the Bounded Real Lemma, in the paper's variables: (20) for a closed loop, (21) for a design.

With a feed-through Dw from w to z (zero in the paper) the same Schur complement gives

    [ A X + X A' + B Y + Y' B' + eta Bw Bw'    *                  ]
    [ C X + D Y + eta Dw Bw'                   -I + eta Dw Dw'    ]  < 0,

which is still affine in X, Y and eta = gamma^-2.
"""

import numpy as np

from models.arrays import Array
from synth.plant import GeneralizedPlant


def bounded_real_matrix(plant: GeneralizedPlant, X: Array, Y: Array, eta: float) -> Array:
    """The left side of (21), shape (n + d, n + d). With Y = 0 it is (20) for the plant as it is.

    Args:
        plant: n states, m inputs, d controlled outputs.
        X: shape (n, n), symmetric.
        Y: shape (m, n).
        eta: gamma^-2.
    """
    top = plant.A @ X + plant.B @ Y
    low = plant.C @ X + plant.D @ Y
    disturbance = np.vstack([plant.Bw, plant.Dw])
    d = len(plant.C)
    return np.block([[top + top.T, low.T], [low, -np.eye(d)]]) + eta * disturbance @ disturbance.T
