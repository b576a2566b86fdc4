"""Plants augmented with filters of outputs, disturbances and actuators, and with the states of a law.

The law's states x_c become integrators with inputs of their own (El Ghaoui, Oustry, AitRami 1997): x_c' = v, and

    [u; v] = [D_c, C_c; B_c, A_c] [C_y x; x_c].

For a discrete plant the law is discrete, too, x_c[k+1] = v[k]. A measured disturbance passes through the law directly and is part
of Bw and Dw of the larger plant.

A design handles weights as numbers only. A weight that depends on frequency is a filter whose states join the plant's. In series
with an output it weights the output, in series with a disturbance it shapes its spectrum, in series with an input it is the
actuator.

    transfer_function system of a ratio of polynomials in s
    series, append    systems in series, systems in parallel with separate signals
    generalized       a system from [w; u] to [z; y] as a plant and its measurements
    with_weights      a plant between the filter of its w and that of its z

(Zhou, Doyle, Glover 1996, Robust and Optimal Control, section 3.6.)
"""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.linear import LinearLaw
from synth.plant.generalized import Feedback, GeneralizedPlant, real_matrix
from synth.plant.state_space import StateSpace


def on_larger_plant(
    plant: GeneralizedPlant, Cy: Array, law: LinearLaw, Dyw: Array | None = None
) -> tuple[GeneralizedPlant, Feedback]:
    """Returns the plant with a law's states, and the law as a static gain on it; a static law without noise changes nothing.

    Args:
        Cy: shape (q, n).
        law: law on y = C_y x + Dyw w with k states, continuous as the plant, or discrete.
        Dyw: shape (q, r); zero if it is not given.

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


def closed_by(plant: GeneralizedPlant, Cy: Array, law: LinearLaw, Dyw: Array) -> GeneralizedPlant:
    """Returns the closed loop of a law, without an input, from w to z; as a loop of `on_larger_plant`, in a fifth of its time.

    Args:
        Cy: shape (q, n).
        law: law on y = C_y x + Dyw w with k states, continuous as the plant, or discrete.
        Dyw: shape (q, r).
    """
    n, K = len(plant.A), law.D
    A = np.zeros((n + law.states, n + law.states))
    A[:n, :n], A[:n, n:], A[n:, :n], A[n:, n:] = plant.A + plant.B @ K @ Cy, plant.B @ law.C, law.B @ Cy, law.A
    return GeneralizedPlant(
        A=A,
        B=np.zeros((len(A), 0)),
        Bw=np.concatenate([plant.Bw + plant.B @ K @ Dyw, law.B @ Dyw]),
        C=np.concatenate([plant.C + plant.D @ K @ Cy, plant.D @ law.C], axis=1),
        D=np.zeros((len(plant.C), 0)),
        Dw=plant.Dw + plant.D @ K @ Dyw,
        dt=plant.dt,
    )


def gain(D: object) -> StateSpace:
    """Returns a system without states, e = D v; a number D counts as a matrix of shape (1, 1)."""
    matrix = np.atleast_2d(np.asarray(D, dtype=float))
    return StateSpace(np.zeros((0, 0)), np.zeros((0, matrix.shape[1])), np.zeros((len(matrix), 0)), matrix)


def transfer_function(numerator: Sequence[float], denominator: Sequence[float]) -> StateSpace:
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
    return StateSpace(A, B, C, D)


def series(first: StateSpace, second: StateSpace) -> StateSpace:
    """The second system fed by the first: e = second(first(v)).

    Raises:
        InputError: the first has not as many outputs as the second has inputs.
    """
    if len(first.D) != second.D.shape[1]:
        raise InputError(
            f"a system with {len(first.D)} outputs cannot feed one with {second.D.shape[1]} inputs; give equal numbers"
        )
    n, k = len(first.A), len(second.A)
    return StateSpace(
        A=np.block([[first.A, np.zeros((n, k))], [second.B @ first.C, second.A]]),
        B=np.vstack([first.B, second.B @ first.D]),
        C=np.hstack([second.D @ first.C, second.C]),
        D=second.D @ first.D,
    )


def append(*systems: StateSpace) -> StateSpace:
    """Systems beside each other: the inputs of all, and the outputs of all, in their order."""
    A, B, C, D = (_diagonal([getattr(system, name) for system in systems]) for name in "ABCD")
    return StateSpace(A, B, C, D)


def generalized(system: StateSpace, disturbances: int, controlled: int) -> tuple[GeneralizedPlant, Array, Array]:
    """A system from [w; u] to [z; y] as a plant with C_y (q, n) and Dyw (q, r): y = C_y x + Dyw w.

    Args:
        disturbances: r, how many of its inputs are w; they come first.
        controlled: d, how many of its outputs are z; they come first.

    Raises:
        InputError: u goes straight through to y.
    """
    r, d = disturbances, controlled
    if np.any(system.D[d:, r:]):
        raise InputError(
            "the force changes a measured signal instantly; give the actuator a lag, or measure signals that do not jump with it"
        )
    plant = GeneralizedPlant(system.A, system.B[:, r:], system.B[:, :r], system.C[:d], system.D[:d, r:], system.D[:d, :r])
    return plant, system.C[d:], system.D[d:, :r]


def with_weights(
    plant: GeneralizedPlant, outputs: StateSpace, disturbances: StateSpace, beside: Array | None = None
) -> GeneralizedPlant:
    """Returns the plant with one system behind its z and another before its w.

    Its states come first, then those of z, then those of w. Measurement matrices get columns of zeros for the others.

    Args:
        plant: n states, r disturbances, d outputs.
        outputs: system with d inputs.
        disturbances: system with r outputs.
        beside: additional gain from the j states of `disturbances` to the input of `outputs`, shape (d, j); None for zero.
    """
    z, w = outputs, disturbances
    n, k, j = len(plant.A), len(z.A), len(w.A)
    through = plant.Dw @ w.C if beside is None else plant.Dw @ w.C + beside
    return GeneralizedPlant(
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
    )


def _diagonal(parts: Sequence[Array]) -> Array:
    """Blocks on the diagonal; blocks without rows or columns count with the others they have."""
    whole = np.zeros((sum(len(part) for part in parts), sum(part.shape[1] for part in parts)))
    i = j = 0
    for part in parts:
        whole[i : i + len(part), j : j + part.shape[1]] = part
        i, j = i + len(part), j + part.shape[1]
    return whole
