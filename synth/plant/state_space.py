"""Linear systems with named inputs and outputs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.linear import LinearLaw, without_loop

Exponential = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class StateSpace:
    """Linear system x' = A x + B u, y = C x + D u; if dt is given, x[k+1] = A x[k] + B u[k] replaces the first equation.

    Attributes:
        A: state matrix, shape (n, n).
        B: input matrix, shape (n, k).
        C: output matrix, shape (p, n).
        D: feedthrough, shape (p, k).
        inputs: names of the k inputs; empty if they have no names.
        outputs: names of the p outputs; empty if they have no names.
        dt: sample period [s]; None for a system in continuous time.
        states: names of the n states; may be empty.

    Raises:
        InputError: the shapes of the matrices do not fit together.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    dt: float | None = None
    states: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n, (p, k) = len(self.A), self.D.shape
        for name, expected in (("A", (n, n)), ("B", (n, k)), ("C", (p, n))):
            shape = getattr(self, name).shape
            if shape != expected:
                raise InputError(f"{name} has shape {shape}; expected {expected}, as A has {n} rows and D is {p} by {k}")

    @classmethod
    def of_law(cls, law: LinearLaw) -> "StateSpace":
        """Returns a control law or a filter as a system without signal names."""
        return cls(law.A, law.B, law.C, law.D, dt=law.sample_period)

    def rows(self, outputs: Sequence[str]) -> list[int]:
        """Returns the indices of the outputs with the given names."""
        return [self.outputs.index(name) for name in outputs]

    def columns(self, inputs: Sequence[str]) -> list[int]:
        """Returns the indices of the inputs with the given names."""
        return [self.inputs.index(name) for name in inputs]

    def part(self, outputs: Sequence[str], inputs: Sequence[str]) -> "StateSpace":
        """Returns the system with only the inputs and outputs that are named."""
        rows, columns = self.rows(outputs), self.columns(inputs)
        D = self.D[np.ix_(rows, columns)]
        return replace(self, B=self.B[:, columns], C=self.C[rows], D=D, inputs=tuple(inputs), outputs=tuple(outputs))

    def with_inputs(self, names: Sequence[str], B: Array, D: Array) -> "StateSpace":
        """Returns the system with j more inputs, given the names of these inputs and their columns of B and D, shapes (n, j)
        and (p, j).
        """
        return replace(self, B=np.hstack([self.B, B]), D=np.hstack([self.D, D]), inputs=(*self.inputs, *names))

    def closed(self, outputs: Sequence[str], inputs: Sequence[str]) -> "StateSpace":
        """Returns the system with feedback: each output in `outputs` is added to the input at the same position in `inputs`.

        In the result, the inputs named in `inputs` are external signals that are added to the feedback.

        Raises:
            InputError: the feedback has an algebraic loop without a solution.
        """
        rows, columns = self.rows(outputs), self.columns(inputs)
        C, D = self.C[rows], self.D[rows]
        if D[:, columns].any():
            loop = without_loop(D[:, columns])
            C, D = np.linalg.solve(loop, C), np.linalg.solve(loop, D)
        B, direct = self.B[:, columns], self.D[:, columns]
        return replace(self, A=self.A + B @ C, B=self.B + B @ D, C=self.C + direct @ C, D=self.D + direct @ D)

    @property
    def feedthrough_radius(self) -> float:
        """Spectral radius of the feedthrough of a loop that is cut open. If the spectral radius is 1 or more, the closed loop
        has no delay margin.
        """
        return spectral_radius(self.D)

    def loop_matrix(self, factor: Array | complex) -> Array:
        """Returns the state matrix of a loop that was cut and is closed by u = factor y, for an array of factors, shape (...,
        n, n).
        """
        factor = np.asarray(factor)[..., None, None]
        if not np.any(self.D):
            return self.A + factor * (self.B @ self.C)
        return self.A + self.B @ np.linalg.solve(np.eye(len(self.D)) - factor * self.D, factor * self.C)

    def hold_matrices(self, duration: float, exponential: Exponential = linalg.expm) -> tuple[Array, Array]:
        """Returns Phi and Gamma for inputs that are held constant for a duration [s].

        The states at the end of the duration are Phi x + Gamma u.

        Args:
            duration: time during which the inputs are held constant [s].
            exponential: function that computes the matrix exponential. In discrete time, this function is not used, because the
                steps of the system are repeated instead.
        """
        n, k = self.B.shape
        if self.dt is None:
            whole = exponential(np.vstack([np.hstack([self.A, self.B]), np.zeros((k, n + k))]) * duration)
        else:
            step = np.vstack([np.hstack([self.A, self.B]), np.eye(k, n + k, n)])
            whole = np.linalg.matrix_power(step, round(duration / self.dt))
        return whole[:n, :n], whole[:n, n:]

    def response(self, at: Array) -> Array:
        """Returns the transfer matrix C (s - A)^-1 B + D, complex, shape (F, p, k), at F points s (or z in discrete time)."""
        k = self.D.shape[1]
        return self.driven(at, np.broadcast_to(np.eye(k), (len(at), k, k)))

    def driven(self, at: Array, amplitudes: Array) -> Array:
        """Returns the outputs for inputs proportional to exp(s t), or to z^k in discrete time, complex, shape (F, p, c).

        Args:
            at: points s, or points z in discrete time, shape (F,).
            amplitudes: complex amplitudes of all inputs, shape (F, k, c).
        """
        states = np.linalg.solve(at[:, None, None] * np.eye(len(self.A)) - self.A, self.B @ amplitudes)
        return self.C @ states + self.D @ amplitudes


def spectral_radius(matrix: Array) -> float:
    """Returns the largest magnitude of the eigenvalues of a square matrix; 0 for an empty matrix."""
    return float(np.abs(np.linalg.eigvals(matrix)).max(initial=0.0))
