"""A law with states as a static gain on a larger plant, so that whatever is proved of a gain is proved of it.

The law's states x_c become integrators with inputs of their own (El Ghaoui, Oustry, AitRami 1997): x_c' = v, and

    [u; v] = [D_c, C_c; B_c, A_c] [C_y x; x_c].

Of a discrete plant the law is discrete, too, x_c[k+1] = v[k], and all else is the same.

What of the disturbance is measured goes through the law at once, and is part of how w enters the larger plant.
"""

import numpy as np

from models.common.arrays import Array
from models.law import LinearLaw
from synth.plant import Feedback, GeneralizedPlant


def on_larger_plant(
    plant: GeneralizedPlant, Cy: Array, law: LinearLaw, Dyw: Array | None = None
) -> tuple[GeneralizedPlant, Feedback]:
    """The plant with a law's states, and the law as a static gain on it: both are as they were for a static law without noise.

    Args:
        plant: n states, m inputs, r disturbances.
        Cy: shape (q, n).
        law: continuous as the plant, or discrete, k states, on y = C_y x + Dyw w.
        Dyw: shape (q, r); zero where it is not given.

    Returns:
        The plant, of n + k states and m + k inputs, and the gain, from q + k measurements.
    """
    k, (n, m) = law.states, plant.B.shape
    noisy = Dyw is not None and np.any(Dyw)
    if not k and not noisy:
        return plant, Feedback(law.D, Cy)
    if Dyw is not None and noisy:
        Bw, kept, Dw = plant.Bw + plant.B @ law.D @ Dyw, law.B @ Dyw, plant.Dw + plant.D @ law.D @ Dyw
    else:
        Bw, kept, Dw = plant.Bw, np.zeros((k, plant.Bw.shape[1])), plant.Dw
    larger = GeneralizedPlant(
        A=np.block([[plant.A, np.zeros((n, k))], [np.zeros((k, n + k))]]),
        B=np.block([[plant.B, np.zeros((n, k))], [np.zeros((k, m)), np.eye(k)]]),
        Bw=np.vstack([Bw, kept]),
        C=np.hstack([plant.C, np.zeros((len(plant.C), k))]),
        D=np.hstack([plant.D, np.zeros((len(plant.D), k))]),
        Dw=Dw,
        dt=plant.dt,
    )
    rows = np.block([[Cy, np.zeros((len(Cy), k))], [np.zeros((k, n)), np.eye(k)]])
    return larger, Feedback(np.block([[law.D, law.C], [law.B, law.A]]), rows)
