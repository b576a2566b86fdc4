"""The generalized plant (15): x' = A x + B u + Bw w, z = C x + D u + Dw w."""

from dataclasses import dataclass

import numpy as np

from models.arrays import Array
from models.errors import InputError

SHAPES = {"A": ("n", "n"), "B": ("n", "m"), "Bw": ("n", "r"), "C": ("d", "n"), "D": ("d", "m"), "Dw": ("d", "r")}


@dataclass(frozen=True, eq=False)
class GeneralizedPlant:
    """A linear plant with a disturbance and a controlled output.

    Attributes:
        A: shape (n, n).
        B: shape (n, m).
        Bw: shape (n, r).
        C: shape (d, n).
        D: shape (d, m).
        Dw: shape (d, r). Zero in the paper.

    Raises:
        InputError: a matrix has the wrong shape or an entry that is not finite; the message names it.
    """

    A: Array
    B: Array
    Bw: Array
    C: Array
    D: Array
    Dw: Array

    def __post_init__(self) -> None:
        for name in SHAPES:
            try:
                matrix = np.array(getattr(self, name), dtype=float)
            except (TypeError, ValueError) as error:
                raise InputError(f"{name} is not a matrix of numbers ({error}); give an array of floats") from None
            if matrix.ndim != 2:
                raise InputError(f"{name} has shape {matrix.shape}; expected a matrix of shape {SHAPES[name]}")
            matrix.flags.writeable = False
            object.__setattr__(self, name, matrix)
        size = {"n": len(self.A), "m": self.B.shape[1], "r": self.Bw.shape[1], "d": len(self.C)}
        for name, (rows, columns) in SHAPES.items():
            matrix, shape = getattr(self, name), (size[rows], size[columns])
            if matrix.shape != shape:
                raise InputError(
                    f"{name} has shape {matrix.shape}; expected {shape}, as A says n = {size['n']}, B says m = {size['m']}, Bw "
                    f"says r = {size['r']} and C says d = {size['d']}"
                )
            if not np.isfinite(matrix).all():
                raise InputError(f"{name} has an entry that is not finite; give numbers")

    @property
    def system_matrix(self) -> Array:
        """[A B Bw; C D Dw], shape (n + d, n + m + r)."""
        return np.vstack([np.hstack([self.A, self.B, self.Bw]), np.hstack([self.C, self.D, self.Dw])])

    def closed_loop(self, G: Array) -> "GeneralizedPlant":
        """The plant under u = G x + (a new u), equations (16)-(17).

        Args:
            G: state gain, shape (m, n).
        """
        return GeneralizedPlant(self.A + self.B @ G, self.B, self.Bw, self.C + self.D @ G, self.D, self.Dw)

    def in_coordinates(self, T: Array) -> "GeneralizedPlant":
        """The same plant with state T^-1 x.

        Args:
            T: shape (n, n), regular.
        """
        inverse = np.linalg.inv(T)
        return GeneralizedPlant(inverse @ self.A @ T, inverse @ self.B, inverse @ self.Bw, self.C @ T, self.D, self.Dw)

    def with_inputs(self, W: Array) -> "GeneralizedPlant":
        """The plant whose inputs v act as u = W v.

        Args:
            W: shape (m, k).
        """
        return GeneralizedPlant(self.A, self.B @ W, self.Bw, self.C, self.D @ W, self.Dw)

    def independent_inputs(self) -> Array:
        """W, shape (m, k), whose orthonormal columns are the combinations of inputs that do something; I where all inputs do."""
        m = self.B.shape[1]
        sizes = [float(np.linalg.norm(part, 2)) or 1.0 for part in (self.B, self.D)]
        together = np.vstack([self.B / sizes[0], self.D / sizes[1]])
        columns = np.linalg.norm(together, axis=0)
        columns[columns <= np.finfo(float).eps] = np.inf
        _, strengths, directions = np.linalg.svd(together / columns)
        k = int(np.sum(strengths > 1e-10))
        if k == m:
            return np.eye(m)
        return np.linalg.qr((directions[:k] / columns).T)[0]

    def frequency_response(self, omega: Array) -> Array:
        """T(j omega) from w to z without control, complex, shape (F, d, r), by (19).

        Args:
            omega: angular frequencies [rad/s], shape (F,).
        """
        s = 1j * np.asarray(omega, dtype=float)[:, None, None]
        resolvent = np.linalg.solve(s * np.eye(len(self.A)) - self.A, self.Bw.astype(complex)[None])
        return self.C @ resolvent + self.Dw
