"""The matrix of the Bounded Real Lemma, in the paper's variables: (20) for a closed loop, (21) for a design.

With a feed-through Dw from w to z (zero in the paper) the same Schur complement gives

    [ A X + X A' + B Y + Y' B' + eta Bw Bw'    *                  ]
    [ C X + D Y + eta Dw Bw'                   -I + eta Dw Dw'    ]  < 0,

which is still affine in X, Y and eta = gamma^-2.

Of a discrete plant it is, for a closed loop,

    [ A X A' - X + eta Bw Bw'    A X C' + eta Bw Dw'       ]
    [ *                          C X C' - I + eta Dw Dw'   ]  < 0,

which is not affine in a gain. For a design stands, with the plant in differences over a step T (`GeneralizedPlant.differences`)
and X T in the place of X, what it is the Schur complement of: the continuous matrix, bordered,

    [ He(A X + B Y) + eta Bw Bw'          *                 *   ]
    [ C X + D Y + eta Dw Bw'              -I + eta Dw Dw'   *   ]
    [ sqrt(T) (A X + B Y)'        sqrt(T) (C X + D Y)'     -X   ]  < 0.

It tends to the continuous one as T falls, and so do the numbers in it: at 1 kHz nothing cancels.
"""

from fractions import Fraction

import numpy as np

from models.common.arrays import Array
from synth.certificate.exact import floats, integers, product, zeros
from synth.plant import Feedback, GeneralizedPlant


def bounded_real_matrix(plant: GeneralizedPlant, X: Array, Y: Array, eta: float, step: float = 0.0) -> Array:
    """The left side of (21), shape (n + d, n + d); bordered by n with a step. With Y = 0 it is (20) for the plant as it is.

    Args:
        plant: n states, m inputs, d controlled outputs.
        X: shape (n, n), symmetric.
        Y: shape (m, n).
        eta: gamma^-2.
        step: of differences; 0 of a continuous plant.
    """
    top = plant.A @ X + plant.B @ Y
    low = plant.C @ X + plant.D @ Y
    disturbance = np.vstack([plant.Bw, plant.Dw])
    d = len(plant.C)
    F = np.block([[top + top.T, low.T], [low, -np.eye(d)]]) + eta * disturbance @ disturbance.T
    if not step:
        return F
    border = step**0.5 * np.vstack([top, low])
    return np.block([[F, border], [border.T, -X]])


def bounded_real_exactly(plant: GeneralizedPlant, G: Array | Feedback, X: Array, eta: float) -> Array:
    """The left side of (20) for the loop A + B G, C + D G, or of the discrete one; by integers, every entry rounded once.

    Args:
        plant: n states, m inputs, d controlled outputs.
        G: shape (m, n), or a gain from measurements.
        X: shape (n, n), symmetric.
        eta: gamma^-2.

    Raises:
        OverflowError: an entry is too large for a float.
    """
    n, m = plant.B.shape
    (system, unit), (gain, per), (unknown, over) = integers(plant.system_matrix), _gain(G), integers(X)
    eta_top, eta_bottom = float(eta).as_integer_ratio()
    loop = system[:, :n] * per + product(system[:, n : n + m], gain)  # over unit * per
    F = product(loop, unknown)
    if plant.dt is None:
        one, half = unit * per * over, zeros(len(system), len(system))
        half[:, :n] = F
        F = half + half.T
    else:
        one = (unit * per) ** 2 * over
        F = product(F, loop.T)
        F[:n, :n] -= unknown * (unit * per) ** 2
    F[np.arange(n, len(F)), np.arange(n, len(F))] -= one
    other, from_w = eta_bottom * unit**2, system[:, n + m :]
    # What the terms with X, and those with eta, are integers over.
    return floats(F * other + eta_top * one * product(from_w, from_w.T), Fraction(1, one * other))


def _gain(G: Array | Feedback) -> tuple[Array, int]:
    """Integers and what they are over, as `integers`."""
    if not isinstance(G, Feedback):
        return integers(G)
    (gain, per), (rows, over) = integers(G.K), integers(G.Cy)
    return product(gain, rows), per * over
