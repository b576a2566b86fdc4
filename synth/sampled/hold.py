"""What a step does to a linear system whose inputs are held over it."""

import itertools
from collections.abc import Callable

import numpy as np

from models.common.arrays import Array


def held_inputs(A: Array, h: float, exponential: Callable[[Array], Array], *inputs: Array) -> list[Array]:
    """Phi and one Gamma per input matrix: the step of x' = A x + sum B_i u_i with every u_i held."""
    n = len(A)
    columns = np.cumsum([n, *(B.shape[1] for B in inputs)])
    augmented = np.zeros((columns[-1], columns[-1]))
    augmented[:n] = np.hstack([A, *inputs])
    step = exponential(augmented * h)
    return [step[:n, :n], *(step[:n, a:b] for a, b in itertools.pairwise(columns))]
