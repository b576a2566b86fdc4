"""Plants in units in which all their numbers have size one: as Clarabel needs them, which else gives up on a car."""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from synth.plant import GeneralizedPlant
from synth.scaling import reachable, size


class Scaled:
    """Plants in the coordinates of [Q R], in units in which all numbers of the first have size one, and time in 1 / rate.

    Args:
        plants: continuous, alike in states and inputs.
        rate: the unit of time is one over it [rad/s].
        Q: shape (n, n - q).
        R: shape (n, q); [Q R] is regular.
        blocks: which columns of R no unit may mix, those where it is 0; of ones and zeros, shape (q, q).

    Attributes:
        plants: the same in these units.
        T: its states in the given ones, shape (n, n).
        measured: the unit of what R's columns answer to, y = C_y x, shape (q, q).
        rate: as given.
        force: what one of all inputs counts.
        disturbance: likewise of w.
        gain: of z over w, what one of these counts is one over it.
    """

    def __init__(self, plants: Sequence[GeneralizedPlant], rate: float, Q: Array, R: Array, blocks: Array) -> None:
        a, T = Q.shape[1], np.hstack([Q, R])
        scale = reachable(plants[0].in_coordinates(T), a)
        self.measured = scale[a:, a:] = np.linalg.cholesky(scale[a:, a:] @ scale[a:, a:].T * blocks)
        self.T, self.rate = T @ scale, rate
        turned = [plant.in_coordinates(self.T) for plant in plants]
        output = 1 / size(turned[0].C)
        self.force, self.disturbance = rate / size(turned[0].B), rate / size(turned[0].Bw)
        self.gain = self.disturbance * output
        self.plants = [
            GeneralizedPlant(
                A=plant.A / rate,
                B=plant.B * self.force / rate,
                Bw=plant.Bw * self.disturbance / rate,
                C=plant.C * output,
                D=plant.D * output * self.force,
                Dw=plant.Dw * self.gain,
            )
            for plant in turned
        ]
