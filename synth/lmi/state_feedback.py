"""State feedback, problem (22): the best that any controller with full state information can do, and the X that L (14) needs."""

import numpy as np

from synth.lmi.central import LIMIT, CentralPoint, central_path
from synth.plant import GeneralizedPlant


def state_feedback(plant: GeneralizedPlant, mu: float = LIMIT) -> list[CentralPoint]:
    """The central path of (22). Its last point is the optimal state-feedback controller u = G_s x, with G_s = Y X^-1 (3) as K.

    Args:
        plant: n states, m inputs.
        mu: see `central_path`.

    Raises:
        InfeasibleError: the plant cannot be stabilised.
        DesignError: see `central_path`.
    """
    n = len(plant.A)
    return central_path(plant, Q=np.zeros((n, 0)), R=np.eye(n), mu=mu)
