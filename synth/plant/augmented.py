"""Plants augmented with filters of outputs, disturbances and actuators, and with the states of a law.

The law's states x_c become integrators with inputs of their own (El Ghaoui, Oustry, AitRami 1997): x_c' = v, and

    [u; v] = [D_c, C_c; B_c, A_c] [C_y x; x_c].

For a discrete plant the law is discrete, too, x_c[k+1] = v[k]. A measured disturbance passes through the law directly and is part
of Bw and Dw of the larger plant.

A design handles weights as numbers only. A weight that depends on frequency is a filter whose states join the plant's. In series
with an output it weights the output, in series with a disturbance it shapes its spectrum, in series with an input it is the
actuator. A filter is a `Plant` without inputs, from w to z.

    transfer_function system of a ratio of polynomials in s
    series, append    systems in series, systems in parallel with separate signals
    with_weights      a plant between the filter of its w and that of its z

(Zhou, Doyle, Glover 1996, Robust and Optimal Control, section 3.6.)
"""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.linear import LinearLaw
from synth.plant.generalized import Plant, real_matrix


def closed_by(plant: Plant, law: LinearLaw) -> Plant:
    """Returns the closed loop of a law on y, without an input, from w to z; as `Plant.closed`, in a fifth of its time.

    Raises:
        InputError: the loop through the measurements has no solution.
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


def gain(D: object) -> Plant:
    """Returns a system without states, e = D v; a number D counts as a matrix of shape (1, 1)."""
    matrix = np.atleast_2d(np.asarray(D, dtype=float))
    return Plant.without_inputs(np.zeros((0, 0)), np.zeros((0, matrix.shape[1])), np.zeros((len(matrix), 0)), matrix)


def transfer_function(numerator: Sequence[float], denominator: Sequence[float]) -> Plant:
    """Returns the filter of one signal with a ratio of polynomials in s.

    Args:
        numerator: coefficients, highest power of s first.
        denominator: coefficients, of at least the numerator's degree.

    Raises:
        InputError: a coefficient is not a number, the denominator is zero, or its degree is too low.
    """
    above, below = (
        np.trim_zeros(real_matrix([list(part)], "a polynomial", "(1, k)")[0], "f") for part in (numerator, denominator)
    )
    if not len(below):
        raise InputError("the denominator of a filter is zero; give its coefficients, of the highest power of s first")
    if len(above) > len(below):
        raise InputError(
            f"a filter has a numerator of degree {len(above) - 1} and a denominator of {len(below) - 1}: it would differentiate; "
            "give it a denominator of no lower degree"
        )
    if len(below) == 1:
        return gain(above[0] / below[0] if len(above) else 0.0)
    from scipy.signal import tf2ss  # half a second

    A, B, C, D = (np.asarray(part) for part in tf2ss(above if len(above) else [0.0], below))
    return Plant.without_inputs(A, B, C, D)


def series(first: Plant, second: Plant) -> Plant:
    """Returns the second system fed by the first.

    Raises:
        InputError: the first has not as many outputs as the second has inputs.
    """
    if len(first.C) != second.Bw.shape[1]:
        raise InputError(
            f"a system with {len(first.C)} outputs cannot feed one with {second.Bw.shape[1]} inputs; give equal numbers"
        )
    n, k = len(first.A), len(second.A)
    return Plant.without_inputs(
        A=np.block([[first.A, np.zeros((n, k))], [second.Bw @ first.C, second.A]]),
        Bw=np.vstack([first.Bw, second.Bw @ first.Dw]),
        C=np.hstack([second.Dw @ first.C, second.C]),
        Dw=second.Dw @ first.Dw,
    )


def append(*systems: Plant) -> Plant:
    """Returns systems in parallel: the inputs of all, and the outputs of all, in their order."""
    A, Bw, C, Dw = (_diagonal([getattr(one, name) for one in systems]) for name in ("A", "Bw", "C", "Dw"))
    return Plant.without_inputs(A, Bw, C, Dw)


def with_weights(plant: Plant, outputs: Plant, disturbances: Plant, beside: Array | None = None) -> Plant:
    """Returns the plant with one system behind its z and another before its w.

    Its states come first, then those of z, then those of w. It keeps its measurements, which contain the filtered w.

    Args:
        plant: n states, r disturbances, d outputs.
        outputs: system with d inputs.
        disturbances: system with r outputs.
        beside: additional gain from the j states of `disturbances` to the input of `outputs`, shape (d, j); None for zero.
    """
    z, w = outputs, disturbances
    n, k, j = len(plant.A), len(z.A), len(w.A)
    through = plant.Dw @ w.C if beside is None else plant.Dw @ w.C + beside
    return Plant(
        A=np.block(
            [
                [plant.A, np.zeros((n, k)), plant.Bw @ w.C],
                [z.Bw @ plant.C, z.A, z.Bw @ through],
                [np.zeros((j, n + k)), w.A],
            ]
        ),
        B=np.vstack([plant.B, z.Bw @ plant.D, np.zeros((j, plant.B.shape[1]))]),
        Bw=np.vstack([plant.Bw @ w.Dw, z.Bw @ plant.Dw @ w.Dw, w.Bw]),
        C=np.hstack([z.Dw @ plant.C, z.C, z.Dw @ through]),
        D=z.Dw @ plant.D,
        Dw=z.Dw @ plant.Dw @ w.Dw,
        weights=k + j,
        Cy=np.hstack([plant.Cy, np.zeros((len(plant.Cy), k)), plant.Dyw @ w.C]),
        Dyu=plant.Dyu,
        Dyw=plant.Dyw @ w.Dw,
    )


def _diagonal(parts: Sequence[Array]) -> Array:
    """Blocks on the diagonal; blocks without rows or columns count with the others they have."""
    whole = np.zeros((sum(len(part) for part in parts), sum(part.shape[1] for part in parts)))
    i = j = 0
    for part in parts:
        whole[i : i + len(part), j : j + part.shape[1]] = part
        i, j = i + len(part), j + part.shape[1]
    return whole
