"""What no control force can change: at every frequency some of z answers to w alone.

With z = Gw w + Gu u at a frequency, the best u leaves (I - Gu Gu^+) Gw of it, whatever the controller knows, causal or not. Where
that is large lies a limit on every norm. For a suspension it is the invariant point of the wheel (Hedrick, Butsuen 1990).
"""

import numpy as np

from models.arrays import Array
from synth.norm import balance, transfer_matrix
from synth.plant import GeneralizedPlant

PEAKS = 6  # local maxima that are looked at closely


def invariant_limit(plant: GeneralizedPlant) -> tuple[float, float]:
    """The largest norm over frequencies that no control changes, and its frequency [rad/s]."""
    poles = np.abs(np.linalg.eigvals(balance(plant.A)[0]))
    largest = float(poles.max(initial=1.0))
    smallest = float(poles[poles > 1e-6 * largest].min(initial=largest))
    omega = np.geomspace(1e-2 * smallest, 1e2 * largest, 500)
    left = uncontrolled(plant, omega)
    tops = np.flatnonzero((left[1:-1] >= left[:-2]) & (left[1:-1] >= left[2:])) + 1
    tops = np.unique([*tops[np.argsort(left[tops])[-PEAKS:]], left.argmax()])
    middle, height, width = omega[tops], left[tops], omega[1] / omega[0] - 1
    for _ in range(9):  # closer around the highest points, all at once
        near = middle * (1 + width * np.linspace(-1, 1, 11)[:, None])
        there = uncontrolled(plant, near.ravel()).reshape(near.shape)
        highest = there.argmax(axis=0)
        index = np.arange(len(middle))
        middle, height, width = near[highest, index], there[highest, index], width / 5
    return float(height.max()), float(middle[height.argmax()])


def uncontrolled(plant: GeneralizedPlant, omega: Array) -> Array:
    """Largest singular value of (I - Gu Gu^+) Gw at frequencies [rad/s] of shape (F,)."""
    from_w = transfer_matrix(plant.A, plant.Bw, plant.C, plant.Dw, omega)
    from_u = transfer_matrix(plant.A, plant.B, plant.C, plant.D, omega)
    left = from_w - from_u @ (np.linalg.pinv(from_u) @ from_w)
    return np.linalg.norm(left, 2, axis=(1, 2))
