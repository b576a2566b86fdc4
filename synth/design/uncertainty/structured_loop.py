"""Loop with frequency-weighted uncertainties of measurements and forces, as a system M from [w; p] to [z; q].

A force u acts as (1 + W Delta) u, and a measurement y is received as (1 + W Delta) y. Each force and each measurement has its
own weight W and its own Delta. A Delta is any stable linear system with a norm of at most one (Zhou, Doyle, Glover 1996, Robust
and Optimal Control, sections 9.1 and 11.2). If the loop is opened at the Deltas, it has the additional inputs p = Delta q and
the additional outputs q = W u or W y.

The output z contains the requested forces u, without errors. In contrast, a measured force contains the error of this force.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from models.common.arrays import Array
from models.laws.linear import LinearLaw
from synth.plant.augmented import append, closed_by, gain, with_weights
from synth.plant.generalized import Plant
from synth.plant.state_space import StateSpace

ROUNDS = 50  # number of balancing iterations; each iteration halves the remaining distance of the logarithms
COARSE = 120  # number of frequencies at which the magnitudes of the entries of M are compared


@dataclass(frozen=True, eq=False)
class StructuredLoop:
    """Loop M with k errors. The last k inputs of the loop are p, and the last k outputs are q.

    Attributes:
        loop: system M from [w; p] to [z; q], shape (d + k, r + k); only from p to q if there is no performance block.
        errors: number k of errors.
    """

    loop: Plant
    errors: int

    @property
    def of_errors(self) -> "StructuredLoop":
        """Part of the loop from p to q, which alone determines stability."""
        M, k = self.loop, self.errors
        return StructuredLoop(Plant.without_inputs(M.A, M.Bw[:, -k:], M.C[-k:], M.Dw[-k:, -k:]), k)

    @property
    def performance(self) -> bool:
        """True if there is a performance block from w to z."""
        return len(self.loop.C) > self.errors

    def at(self, omega: Array) -> Array:
        """Returns the complex frequency response M(j omega) of the loop, shape (F, d + k, r + k), at finite frequencies
        [rad/s], shape (F,).
        """
        return self.loop.frequency_response(omega)

    def scaled(self, scales: Array) -> Plant:
        """Returns the scaled loop D M D^-1 for positive scales of shape (k,). The scales D multiply each q, and their inverses
        multiply each p.
        """
        M, k = self.loop, self.errors
        C, Dw, Bw = M.C.copy(), M.Dw.copy(), M.Bw.copy()
        C[-k:] *= scales[:, None]
        Dw[-k:] *= scales[:, None]
        Bw[:, -k:] /= scales
        Dw[:, -k:] /= scales
        return Plant.without_inputs(M.A, Bw, C, Dw)

    @cached_property
    def units(self) -> Array:
        """Scales for which the entries of M have similar magnitudes over all frequencies, shape (k,)."""
        T = np.abs(self.at(self.grid))
        k = self.errors
        blocks = np.zeros((k + 1, k + 1))
        blocks[1:, 1:] = T[:, -k:, -k:].max(axis=0)
        if self.performance:
            blocks[0, 1:] = np.linalg.norm(T[:, :-k, -k:], axis=1).max(axis=0)
            blocks[1:, 0] = np.linalg.norm(T[:, -k:, :-k], axis=2).max(axis=0)
        blocks = np.maximum(blocks - np.diag(np.diagonal(blocks)), 1e-12 * blocks.max(initial=1e-300))
        x = np.zeros(k + 1)
        for _ in range(ROUNDS):
            balanced = np.exp(x)[:, None] * blocks / np.exp(x)
            x += 0.25 * np.log(balanced.sum(axis=0) / balanced.sum(axis=1))
        return np.exp(x[1:] - x[0])

    @cached_property
    def grid(self) -> Array:
        """Frequencies around and between the poles [rad/s], in ascending order, shape (F,)."""
        poles = np.linalg.eigvals(self.loop.A)
        size = np.abs(poles)
        size = size[size > 0] if np.any(size) else np.ones(1)
        even = np.geomspace(size.min() / 10, size.max() * 10, COARSE)
        return np.unique(np.concatenate([even, size, np.abs(np.imag(poles))[np.imag(poles) != 0]]))


@dataclass(frozen=True, eq=False)
class StructuredPlant:
    """Plant from [w; p; u] to [z; q; y] with k weighted errors.

    Attributes:
        plant: plant with n states, m inputs, r + k disturbances, d + k controlled outputs and q measurements.
        errors: number k of errors.
    """

    plant: Plant
    errors: int

    def closed_by(self, law: LinearLaw) -> StructuredLoop:
        """Returns the loop of the plant with a continuous law on y.

        Raises:
            InputError: the algebraic loop through the measurements has no solution.
        """
        return StructuredLoop(closed_by(self.plant, law), self.errors)


def plant_with_errors(
    plant: Plant,
    of_errors: tuple[Array, Array],
    weights: tuple[Sequence[StateSpace | None], Sequence[StateSpace | None]],
) -> StructuredPlant:
    """Returns the plant with weighted errors of its forces and measurements.

    Args:
        plant: plant in continuous time with n states, m inputs, r disturbances, d controlled outputs and q measurements.
        of_errors: effect of an additional force on the states and on z, shapes (n, m) and (d, m).
        weights: weight of each force and of each measurement; None for a force or measurement without error.
    """
    (q, n), (d, m), r = plant.Cy.shape, plant.D.shape, plant.Bw.shape[1]
    forces, readings = ([i for i, one in enumerate(some) if one is not None] for some in weights)
    k = len(forces) + len(readings)
    noise = np.hstack([plant.Dyw, plant.Dyu[:, forces]])  # the measurements also contain the errors of the forces
    wide = Plant(
        A=plant.A,
        B=plant.B,
        Bw=np.hstack([plant.Bw, of_errors[0][:, forces], np.zeros((n, len(readings)))]),
        C=np.vstack([plant.C, np.zeros((len(forces), n)), plant.Cy[readings]]),
        D=np.vstack([plant.D, np.eye(m)[forces], plant.Dyu[readings]]),
        Dw=np.vstack(
            [
                np.hstack([plant.Dw, of_errors[1][:, forces], np.zeros((d, len(readings)))]),
                np.zeros((len(forces), r + k)),
                np.hstack([noise[readings], np.zeros((len(readings), len(readings)))]),
            ]
        ),
        Cy=plant.Cy,
        Dyu=plant.Dyu,
        Dyw=np.hstack([noise, np.eye(q)[:, readings]]),
    )
    filters = [one for some in weights for one in some if one is not None]
    return StructuredPlant(with_weights(wide, append(gain(np.eye(d)), *filters), gain(np.eye(r + k))), k)
