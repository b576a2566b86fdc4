"""Directions of a search in which all entries of a gain count alike, those that a structure leaves zero left out."""

import numpy as np

from models.common.arrays import Array
from synth.search.coordinates import alike
from synth.search.landscape import Landscape


def directions(landscape: Landscape, x: Array, free: Array) -> Array:
    """Shape (N, free).

    Args:
        landscape: whose points they are of.
        x: the point.
        free: which entries of a point may be other than zero, by index.
    """
    try:
        M = alike(landscape, x)
        inverse = np.linalg.inv(M)
    except np.linalg.LinAlgError:
        return np.eye(len(x))[:, free]
    if len(free) == len(x):
        return M
    metric = (inverse.T @ inverse)[free][:, free]
    sizes, vectors = np.linalg.eigh(metric)
    restricted = np.zeros((len(x), len(free)))
    restricted[free] = vectors / np.sqrt(np.maximum(sizes, 1e-12 * sizes[-1])) @ vectors.T
    return restricted
