"""State feedback, problem (22): the best that any controller with full state information can do, and the X that L (14) needs."""

import numpy as np

from synth.central import LIMIT, CentralPoint, central_point
from synth.plant import GeneralizedPlant


def state_feedback(plant: GeneralizedPlant, mu: float = LIMIT) -> CentralPoint:
    """The optimal state-feedback controller u = G_s x: the central-path limit of (22), with G_s = Y X^-1 (3) as its K.

    Args:
        plant: n states, m inputs.
        mu: see `central_point`.

    Raises:
        InfeasibleError: the plant cannot be stabilised.
        DesignError: see `central_point`.
    """
    n = len(plant.A)
    return central_point(plant, Q=np.zeros((n, 0)), R=np.eye(n), mu=mu)
