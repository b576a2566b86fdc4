"""What no control force can change: at every frequency some of z answers to w alone.

With z = Gw w + Gu u at a frequency, the best u leaves (I - Gu Gu^+) Gw of it, whatever the controller knows, causal or not. Where
that is large lies a limit on every norm. For a suspension it is the invariant point of the wheel (Hedrick, Butsuen 1990).
"""

import numpy as np

from models.arrays import Array
from synth.norm import balance, transfer_matrix
from synth.plant import GeneralizedPlant


def invariant_limit(plant: GeneralizedPlant) -> tuple[float, float]:
    """The largest norm over frequencies that no control changes, and its frequency [rad/s]."""
    poles = np.abs(np.linalg.eigvals(balance(plant.A)[0]))
    largest = float(poles.max(initial=1.0))
    smallest = float(poles[poles > 1e-6 * largest].min(initial=largest))
    omega = np.geomspace(1e-2 * smallest, 1e2 * largest, 2000)
    best, at = 0.0, 0.0
    for _ in range(4):  # closer around the highest point
        left = uncontrolled(plant, omega)
        i = int(left.argmax())
        best, at = float(left[i]), float(omega[i])
        omega = np.linspace(omega[max(i - 1, 0)], omega[min(i + 1, len(omega) - 1)], 200)
    return best, at


def uncontrolled(plant: GeneralizedPlant, omega: Array) -> Array:
    """Largest singular value of (I - Gu Gu^+) Gw at frequencies [rad/s] of shape (F,)."""
    from_w = transfer_matrix(plant.A, plant.Bw, plant.C, plant.Dw, omega)
    from_u = transfer_matrix(plant.A, plant.B, plant.C, plant.D, omega)
    left = from_w - from_u @ (np.linalg.pinv(from_u) @ from_w)
    return np.linalg.norm(left, 2, axis=(1, 2))
