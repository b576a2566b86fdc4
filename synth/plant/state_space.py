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
    """x' = A x + B u, y = C x + D u; with dt, x[k+1] = A x[k] + B u[k].

    Attributes:
        A: shape (n, n).
        B: shape (n, k).
        C: shape (p, n).
        D: shape (p, k).
        inputs: names of the k inputs; empty for signals without names.
        outputs: names of the p outputs; likewise.
        dt: time from one sample to the next [s]; None in continuous time.
        states: names of the n states, or empty.

    Raises:
        InputError: a matrix does not fit the others.
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
        """Returns a law, or a filter, as a system without names."""
        return cls(law.A, law.B, law.C, law.D, dt=law.sample_period)

    def rows(self, outputs: Sequence[str]) -> list[int]:
        """Returns the positions of some outputs."""
        return [self.outputs.index(name) for name in outputs]

    def columns(self, inputs: Sequence[str]) -> list[int]:
        """Returns the positions of some inputs."""
        return [self.inputs.index(name) for name in inputs]

    def part(self, outputs: Sequence[str], inputs: Sequence[str]) -> "StateSpace":
        """Returns the system from some inputs to some outputs, by name."""
        rows, columns = self.rows(outputs), self.columns(inputs)
        D = self.D[np.ix_(rows, columns)]
        return replace(self, B=self.B[:, columns], C=self.C[rows], D=D, inputs=tuple(inputs), outputs=tuple(outputs))

    def with_inputs(self, names: Sequence[str], B: Array, D: Array) -> "StateSpace":
        """Returns the system with more inputs, by their columns of B and D, shapes (n, j) and (p, j)."""
        return replace(self, B=np.hstack([self.B, B]), D=np.hstack([self.D, D]), inputs=(*self.inputs, *names))

    def closed(self, outputs: Sequence[str], inputs: Sequence[str]) -> "StateSpace":
        """Returns the system whose outputs add to inputs, one to one; the inputs are then what adds to these from outside.

        Raises:
            InputError: an output that is fed back acts on itself at once, and that loop has no solution.
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
        """Direct gain from the inputs of a cut loop through its outputs; from 1 on the closed loop has no delay margin."""
        return spectral_radius(self.D)

    def loop_matrix(self, factor: Array | complex) -> Array:
        """Returns A of a cut loop that is closed by u = factor y, shape (..., n, n), for factors of any shape."""
        factor = np.asarray(factor)[..., None, None]
        if not np.any(self.D):
            return self.A + factor * (self.B @ self.C)
        return self.A + self.B @ np.linalg.solve(np.eye(len(self.D)) - factor * self.D, factor * self.C)

    def hold_matrices(self, duration: float, exponential: Exponential = linalg.expm) -> tuple[Array, Array]:
        """Returns Phi and Gamma of a duration [s] with held inputs: they take states and inputs to the states at its end.

        Args:
            exponential: the matrix exponential; not used for a system in discrete time, which takes steps.
        """
        n, k = self.B.shape
        if self.dt is None:
            whole = exponential(np.vstack([np.hstack([self.A, self.B]), np.zeros((k, n + k))]) * duration)
        else:
            step = np.vstack([np.hstack([self.A, self.B]), np.eye(k, n + k, n)])
            whole = np.linalg.matrix_power(step, round(duration / self.dt))
        return whole[:n, :n], whole[:n, n:]

    def response(self, at: Array) -> Array:
        """Returns C (s - A)^-1 B + D at s, or at z of a system in discrete time, shape (F,); complex, shape (F, p, k)."""
        k = self.D.shape[1]
        return self.driven(at, np.broadcast_to(np.eye(k), (len(at), k, k)))

    def driven(self, at: Array, amplitudes: Array) -> Array:
        """Returns the outputs under inputs that are multiples of exp(s t), or of z^k, complex, shape (F, p, c).

        Args:
            at: s, or z of a system in discrete time, shape (F,).
            amplitudes: amplitudes of all inputs, shape (F, k, c).
        """
        states = np.linalg.solve(at[:, None, None] * np.eye(len(self.A)) - self.A, self.B @ amplitudes)
        return self.C @ states + self.D @ amplitudes


def spectral_radius(matrix: Array) -> float:
    """Returns the largest magnitude of the eigenvalues of a square matrix; 0 for one without rows."""
    return float(np.abs(np.linalg.eigvals(matrix)).max(initial=0.0))
