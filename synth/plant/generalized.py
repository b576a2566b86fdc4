"""The generalized plant (15): x' = A x + B u + Bw w, z = C x + D u + Dw w; or x[k+1] = A x[k] + ..., every dt seconds."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from models.common import arrays
from models.common.arrays import Array
from models.common.checks import Index, Matrix, check, check_shape
from models.common.errors import InputError, quoted
from synth.plant.double_double import added, product

SMALLEST, LARGEST = 1e-50, 1e50  # of a matrix: beyond, squares of its entries under- or overflow where they meet

SHAPES = {"A": ("n", "n"), "B": ("n", "m"), "Bw": ("n", "r"), "C": ("d", "n"), "D": ("d", "m"), "Dw": ("d", "r")}


@dataclass(frozen=True, eq=False)
class Feedback:
    """A static gain u = K y from y = C_y x, held as two factors, so that their product is not rounded in a claim.

    A gain may weight the difference of two nearly dependent signals a million times. Then the nearest floats to K C_y are
    those of another controller.

    Attributes:
        K: shape (m, q).
        Cy: shape (q, n).

    Raises:
        InputError: a matrix is not one of real finite numbers, or the two do not fit.
    """

    K: Array
    Cy: Array

    def __post_init__(self) -> None:
        for name, value, shape in (("K", self.K, "(m, q)"), ("Cy", self.Cy, "(q, n)")):
            object.__setattr__(self, name, real_matrix(value, name, shape))
        if self.K.shape[1] != len(self.Cy):
            raise InputError(f"K has shape {self.K.shape} and Cy {self.Cy.shape}; give K a column for each row of Cy")


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
        beyond: rounding error of A and C of a closed loop, true value less float, shape (n + d, n); None if they are exact.
        weights: number of the last states that belong to weights: no control moves their poles, and they do not count for the
            plant's speed.
        dt: seconds from x[k] to x[k + 1] of a discrete plant; None for a continuous one.

    Raises:
        InputError: a matrix is not one of real finite numbers, has the wrong shape, too many rows or columns, or
            entries beyond `SMALLEST` or `LARGEST`; or dt or weights is no such number. The message names it.
    """

    A: Array
    B: Array
    Bw: Array
    C: Array
    D: Array
    Dw: Array
    beyond: Array | None = None
    weights: int = 0
    dt: float | None = None

    def __post_init__(self) -> None:
        if self.dt is not None:
            object.__setattr__(self, "dt", _sample_period(self.dt))
        for name in SHAPES:
            matrix, size = arrays.real_matrix(getattr(self, name), name, LARGEST, str(SHAPES[name]))
            if 0 < size < SMALLEST:
                raise InputError(
                    f"{name} has no entry above {SMALLEST:g} (the largest is {size:g}); give it in other units, or 0"
                )
            matrix.flags.writeable = False
            object.__setattr__(self, name, matrix)
        size = {"n": len(self.A), "m": self.B.shape[1], "r": self.Bw.shape[1], "d": len(self.C)}
        for name, (rows, columns) in SHAPES.items():
            matrix, shape = getattr(self, name), (size[rows], size[columns])
            if matrix.shape != shape:
                raise InputError(
                    f"{name} has shape {matrix.shape}, and must have {shape}: A has {size['n']} row(s), B {size['m']} column(s), "
                    f"Bw {size['r']} column(s) and C {size['d']} row(s)"
                )
        for name, count, needed in (("Bw has no columns", size["r"], "a disturbance"), ("C has no rows", size["d"], "an output")):
            if not count:
                raise InputError(f"{name}, so there is no norm from w to z; give {needed}, zeros if nothing acts there")
        object.__setattr__(self, "weights", check("weights", self.weights, Index))
        if self.weights > size["n"]:
            raise InputError(f"weights = {self.weights} exceed the {size['n']} states; give at most {size['n']}")
        if self.beyond is not None:
            check_shape("beyond", check("beyond", self.beyond, Array), (size["n"] + size["d"], size["n"]), "as A and C are")

    @property
    def system_matrix(self) -> Array:
        """[A B Bw; C D Dw], shape (n + d, n + m + r)."""
        return np.vstack([np.hstack([self.A, self.B, self.Bw]), np.hstack([self.C, self.D, self.Dw])])

    @cached_property
    def differences(self) -> "GeneralizedPlant":
        """The plant in differences, (x[k+1] - x[k]) / dt instead of x': its entries tend to the continuous ones as dt falls.

        The result has the form of a continuous plant, but other poles and norms; a continuous plant is its own.
        """
        if self.dt is None:
            return self
        A = (self.A - np.eye(len(self.A))) / self.dt
        return GeneralizedPlant(A, self.B / self.dt, self.Bw / self.dt, self.C, self.D, self.Dw, weights=self.weights)

    def closed_loop(self, G: Array | Feedback) -> "GeneralizedPlant":
        """Returns the plant under u = G x + (a new u), equations (16)-(17): A + B G and C + D G, rounded once, and the error.

        For a huge gain, or one that cancels much of A, that rounding error may decide the norm.

        Args:
            G: state gain, shape (m, n), or a gain from measurements.

        Raises:
            InputError: the gain does not fit the plant.
        """
        G = check("G", G, Matrix | Feedback)
        shape = (len(G.K), G.Cy.shape[1]) if isinstance(G, Feedback) else G.shape
        if shape != self.B.T.shape:
            raise InputError(f"G has shape {shape}; expected {self.B.T.shape}: a row for each input, a column for each state")
        high, beyond = fed_back(np.vstack([self.A, self.C]), np.vstack([self.B, self.D]), G, self.beyond)
        n = len(self.A)
        return GeneralizedPlant(high[:n], self.B, self.Bw, high[n:], self.D, self.Dw, beyond, dt=self.dt)

    def in_coordinates(self, T: Array) -> "GeneralizedPlant":
        """Returns the same plant with state T^-1 x, T regular, shape (n, n)."""
        inverse = np.linalg.inv(T)
        A, B, Bw = inverse @ self.A @ T, inverse @ self.B, inverse @ self.Bw
        return GeneralizedPlant(A, B, Bw, self.C @ T, self.D, self.Dw, dt=self.dt)

    def with_inputs(self, W: Array) -> "GeneralizedPlant":
        """Returns the plant with inputs v that act as u = W v, W of shape (m, k)."""
        return GeneralizedPlant(self.A, self.B @ W, self.Bw, self.C, self.D @ W, self.Dw, dt=self.dt)

    def independent_inputs(self) -> Array:
        """Returns W, shape (m, k): an orthonormal basis of the combinations of inputs that have an effect; I if all have."""
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
        """Returns T(j omega) from w to z without control, complex, shape (F, d, r), by (19); T(e^(j omega dt)) if discrete.

        Args:
            omega: angular frequencies [rad/s], shape (F,).
        """
        s = 1j * np.asarray(omega, dtype=float)[:, None, None]
        s = s if self.dt is None else np.exp(s * self.dt)
        resolvent = np.linalg.solve(s * np.eye(len(self.A)) - self.A, self.Bw.astype(complex)[None])
        return self.C @ resolvent + self.Dw


def fed_back(open_loop: Array, inputs: Array, G: Array | Feedback, beyond: Array | None = None) -> tuple[Array, Array]:
    """Returns [A; C] + [B; D] G, rounded once, and the rounding error.

    Args:
        open_loop: open loop [A; C], shape (n + d, n).
        inputs: inputs [B; D], shape (n + d, m).
        G: state gain, shape (m, n), or a gain from measurements.
        beyond: true A and C less their floats, shape (n + d, n); None if they are exact.
    """
    gain, rest = product(G.K, G.Cy) if isinstance(G, Feedback) else (G, np.zeros_like(G))
    moved, low = product(inputs, gain)
    low = low + inputs @ rest
    high, off = added(open_loop, moved)
    return added(high, off + low if beyond is None else off + (low + beyond))


def _sample_period(dt: object) -> float:
    """Returns the seconds between samples after a check: a number above zero, in range."""
    allowed = f"give the seconds between samples, from {SMALLEST:g} to {LARGEST:g}, or None for a continuous plant"
    try:
        if isinstance(dt, bool | np.bool_):
            raise TypeError
        period = float(dt)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"dt = {quoted(dt)} is not a number; {allowed}") from None
    if not SMALLEST <= period <= LARGEST:
        raise InputError(f"dt = {period:g} is not a sample period; {allowed}")
    return period


def real_matrix(value: object, name: str, expected: str) -> Array:
    """Returns a copy of a matrix after a check: real numbers, none beyond `LARGEST`, and not too many rows or columns.

    Args:
        value: the matrix, or nested lists.

    Raises:
        InputError: the matrix fails the check; the message names it.
    """
    return arrays.real_matrix(value, name, LARGEST, expected)[0]


def check_states(n: int) -> None:
    """Raises an InputError if a plant has no state; parts that are split off a plant need none."""
    if not n:
        raise InputError("A has shape (0, 0), a plant without states; give at least one")


def check_inputs(plant: GeneralizedPlant) -> None:
    """Raises an InputError if a plant has no state or no input, where nothing can be designed."""
    check_states(len(plant.A))
    if not plant.B.shape[1]:
        raise InputError("B has no columns, a plant without inputs; give one column for each force")


def check_continuous(plant: GeneralizedPlant) -> None:
    """Raises an InputError for a discrete plant, if a formula holds for continuous ones only."""
    if plant.dt is not None:
        raise InputError(f"the plant is discrete (dt = {plant.dt:g}), but this function needs a continuous plant; give one")


def check_posed(plant: GeneralizedPlant) -> None:
    """Checks that a plant has a disturbance and a controlled output.

    Raises:
        InputError: Bw and Dw are zero, or C and D are.
    """
    if not (np.any(plant.Bw) or np.any(plant.Dw)):
        raise InputError("the plant has no disturbance: Bw and Dw are zero; give at least one nonzero entry")
    if not (np.any(plant.C) or np.any(plant.D)):
        raise InputError("the controlled output z is zero, as C and D are zero; give at least one signal a weight above zero")


def on_all_rows(gain: Array, kept: Sequence[int] | Array, q: int) -> Array:
    """Returns a gain on some of q measurements as one on all, with zeros for the others, shape (m, q)."""
    whole = np.zeros((len(gain), q))
    whole[:, kept] = gain
    return whole


def measured_with(plant: GeneralizedPlant, Cy: object, Dyw: object | None) -> tuple[Array, Array | None]:
    """Returns checked C_y and Dyw like `measurement_matrices`, with Dyw None if it is not given."""
    states, noise = measurement_matrices(plant, Cy, Dyw)
    return states, None if Dyw is None else noise


def measurement_matrices(
    plant: GeneralizedPlant, Cy: object, Dyw: object = None, through: Array | None = None
) -> tuple[Array, Array]:
    """Returns C_y and Dyw of y = C_y x + Dyw w + `through` u after a check, shapes (q, n) and (q, r).

    Args:
        Cy: a row for each measured signal.
        Dyw: feedthrough from w to the measurements; zero if it is not given.
        through: feedthrough from the forces to the measurements, shape (q, m); zero if it is not given.

    Raises:
        InputError: the plant has no state, a matrix is not one of real finite numbers of its shape, no signal is measured, or one
            that is next to zero in all.
    """
    states = _measured(Cy, len(plant.A))
    shape = len(states), plant.Bw.shape[1]
    names, words, noise = ["Cy"], "state", np.zeros(shape)
    if Dyw is not None:
        noise = real_matrix(Dyw, "Dyw", str(shape))
        names, words = ["Cy", "Dyw"], "state or disturbance"
    if noise.shape != shape:
        raise InputError(
            f"Dyw has shape {noise.shape}; expected {shape}: a row for each measured signal, a column for each disturbance"
        )
    rows = [states, noise]
    if through is not None:
        names, words, rows = [*names, "Dyu"], f"{words} or force", [*rows, through]
    _refuse_silent(np.hstack(rows), f"[{' '.join(names)}]" if len(names) > 1 else names[0], words)
    return states, noise


def _measured(Cy: object, n: int) -> Array:
    check_states(n)
    matrix = real_matrix(Cy, "Cy", f"(q, {n})")
    if matrix.shape[1] != n:
        raise InputError(f"Cy has shape {matrix.shape}; expected (q, {n}), a row for each measured signal")
    if not len(matrix):
        raise InputError("Cy has no rows: nothing is measured; give at least one signal")
    return matrix


def _refuse_silent(rows: Array, name: str, of: str) -> None:
    sizes = np.abs(rows).max(axis=1)
    silent = np.flatnonzero(sizes < SMALLEST)
    if len(silent):
        what = "zero" if sizes[silent[0]] == 0 else f"below {SMALLEST:g}"
        raise InputError(f"row {silent[0]} of {name} is {what}: the signal contains no information on the {of}; omit the row")
