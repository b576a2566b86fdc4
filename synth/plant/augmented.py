"""Plants with additional filters on outputs, disturbances or actuators, and with the states of a control law.

The states x_c of the law become integrators with their own inputs v (El Ghaoui, Oustry, AitRami 1997): x_c' = v, and

    [u; v] = [D_c, C_c; B_c, A_c] [C_y x; x_c].

For a discrete plant, the law is also discrete, with the states x_c[k+1] = v[k]. A measured disturbance passes directly through
the law. The effect of the measured disturbance through the law is therefore part of Bw and Dw of the larger plant.

A design can handle only constant weights. A weight that depends on frequency is therefore represented by a filter, whose states
are added to the plant. A filter in series with an output weights the output. A filter in series with a disturbance shapes the
spectrum of the disturbance. A filter in series with an input models the actuator. A filter is a `Plant` from w to z without
control inputs.

- `transfer_function`: system from a ratio of polynomials in s
- `series`, `append`: systems connected in series, or in parallel with separate signals
- `with_weights`: plant with one filter in series before w and a second filter in series after z

Source: Zhou, Doyle, Glover 1996, Robust and Optimal Control, section 3.6.
"""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.linear import LinearLaw
from synth.plant.generalized import Plant, real_matrix
from synth.plant.state_space import StateSpace


def closed_by(plant: Plant, law: LinearLaw) -> Plant:
    """Returns the closed loop of the plant and a law on y, from w to z and without an input.

    The result is the same as that of `Plant.closed`, but takes only a fifth of the time.

    Raises:
        InputError: the algebraic loop through the measurements has no solution.
    """
    law = law.fed_back(plant.Dyu)
    n, K, Cy, Dyw = len(plant.A), law.D, plant.Cy, plant.Dyw
    A = np.zeros((n + law.states, n + law.states))
    A[:n, :n], A[:n, n:], A[n:, :n], A[n:, n:] = plant.A + plant.B @ K @ Cy, plant.B @ law.C, law.B @ Cy, law.A
    return Plant.without_inputs(
        A=A,
        Bw=np.concatenate([plant.Bw + plant.B @ K @ Dyw, law.B @ Dyw]),
        C=np.concatenate([plant.C + plant.D @ K @ Cy, plant.D @ law.C], axis=1),
        Dw=plant.Dw + plant.D @ K @ Dyw,
        dt=plant.dt,
    )


def gain(D: object) -> StateSpace:
    """Returns a system e = D v without states. A number D counts as a matrix of shape (1, 1)."""
    matrix = np.atleast_2d(np.asarray(D, dtype=float))
    return StateSpace(np.zeros((0, 0)), np.zeros((0, matrix.shape[1])), np.zeros((len(matrix), 0)), matrix)


def transfer_function(numerator: Sequence[float], denominator: Sequence[float]) -> StateSpace:
    """Returns a filter for one signal, given the numerator and denominator polynomials in s.

    Args:
        numerator: coefficients of the numerator, highest power of s first.
        denominator: coefficients, highest power of s first; the degree is at least that of the numerator.

    Raises:
        InputError: a coefficient is not a number, the denominator is zero, or the degree of the denominator is too low.
    """
    above, below = (
        np.trim_zeros(real_matrix([list(part)], "a polynomial", "(1, k)")[0], "f") for part in (numerator, denominator)
    )
    if not len(below):
        raise InputError(
            "the denominator of a filter is zero; give the coefficients of the denominator, with the highest power of s first"
        )
    if len(above) > len(below):
        raise InputError(
            f"a filter has a numerator of degree {len(above) - 1} and a denominator of degree {len(below) - 1}, so "
            "the filter would differentiate; give a denominator of at least the same degree"
        )
    if len(below) == 1:
        return gain(above[0] / below[0] if len(above) else 0.0)
    from scipy.signal import tf2ss  # this import takes 0.5 s

    A, B, C, D = (np.asarray(part) for part in tf2ss(above if len(above) else [0.0], below))
    return StateSpace(A, B, C, D)


def series(first: StateSpace, second: StateSpace) -> StateSpace:
    """Returns the series connection of two systems: the outputs of the first system are the inputs of the second system.

    Raises:
        InputError: the number of outputs of the first system differs from the number of inputs of the second system.
    """
    if len(first.C) != second.B.shape[1]:
        raise InputError(
            f"a system with {len(first.C)} outputs cannot feed a system with {second.B.shape[1]} inputs; give systems "
            "in which these two numbers are equal"
        )
    n, k = len(first.A), len(second.A)
    return StateSpace(
        A=np.block([[first.A, np.zeros((n, k))], [second.B @ first.C, second.A]]),
        B=np.vstack([first.B, second.B @ first.D]),
        C=np.hstack([second.D @ first.C, second.C]),
        D=second.D @ first.D,
    )


def append(*systems: StateSpace) -> StateSpace:
    """Returns the parallel connection of systems with separate inputs and outputs, in the order of the arguments."""
    A, B, C, D = (_diagonal([getattr(one, name) for one in systems]) for name in "ABCD")
    return StateSpace(A, B, C, D)


def with_weights(plant: Plant, outputs: StateSpace, disturbances: StateSpace, beside: Array | None = None) -> Plant:
    """Returns the plant in series with two systems: one system after z, and a second system before w.

    The states of the plant come first, followed by the states of the system after z, and by the states of the system before w.
    The result keeps the measurements of the plant; these measurements contain the filtered w.

    Args:
        plant: plant with n states, r disturbances and d outputs.
        outputs: system with d inputs that is connected to z.
        disturbances: system with r outputs that is connected to w.
        beside: additional gain from the j states of `disturbances` to the input of `outputs`, shape (d, j); None for zero.
    """
    z, w = outputs, disturbances
    n, k, j = len(plant.A), len(z.A), len(w.A)
    through = plant.Dw @ w.C if beside is None else plant.Dw @ w.C + beside
    return Plant(
        A=np.block(
            [
                [plant.A, np.zeros((n, k)), plant.Bw @ w.C],
                [z.B @ plant.C, z.A, z.B @ through],
                [np.zeros((j, n + k)), w.A],
            ]
        ),
        B=np.vstack([plant.B, z.B @ plant.D, np.zeros((j, plant.B.shape[1]))]),
        Bw=np.vstack([plant.Bw @ w.D, z.B @ plant.Dw @ w.D, w.B]),
        C=np.hstack([z.D @ plant.C, z.C, z.D @ through]),
        D=z.D @ plant.D,
        Dw=z.D @ plant.Dw @ w.D,
        weights=k + j,
        Cy=np.hstack([plant.Cy, np.zeros((len(plant.Cy), k)), plant.Dyw @ w.C]),
        Dyu=plant.Dyu,
        Dyw=plant.Dyw @ w.D,
    )


def _diagonal(parts: Sequence[Array]) -> Array:
    """Returns a block-diagonal matrix.

    A block that has no rows still adds columns, and a block that has no columns still adds rows.
    """
    whole = np.zeros((sum(len(part) for part in parts), sum(part.shape[1] for part in parts)))
    i = j = 0
    for part in parts:
        whole[i : i + len(part), j : j + part.shape[1]] = part
        i, j = i + len(part), j + part.shape[1]
    return whole
