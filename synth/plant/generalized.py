"""Generalized plant (15): x' = A x + B u + Bw w, z = C x + D u + Dw w, y = Cy x + Dyu u + Dyw w.

In the equations of a discrete plant with sample period dt [s], x[k+1] replaces x'.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from models.common import arrays
from models.common.arrays import Array
from models.common.checks import Index, Matrix, check, check_shape
from models.common.errors import InputError, short_repr
from models.laws.linear import LinearLaw, static_law
from synth.plant.double_double import exact_sum, product

# Smallest and largest magnitude of a matrix entry. Outside these limits, products of entries may underflow or overflow
SMALLEST, LARGEST = 1e-50, 1e50

NOTHING: Any = None
SHAPES = {"A": ("n", "n"), "B": ("n", "m"), "Bw": ("n", "r"), "C": ("d", "n"), "D": ("d", "m"), "Dw": ("d", "r")}


@dataclass(frozen=True, eq=False)
class Feedback:
    """Static gain u = K y with y = C_y x, stored as two factors K and C_y.

    The factors are stored separately so that proofs do not depend on the rounding of their product. For example, a gain may
    multiply the difference of two nearly dependent signals by a million. Rounding the product K C_y would then change the
    controller.

    Attributes:
        K: gain, shape (m, q).
        Cy: matrix of the measurements, shape (q, n).

    Raises:
        InputError: a matrix contains entries that are not real finite numbers, or the shapes do not fit together.
    """

    K: Array
    Cy: Array

    def __post_init__(self) -> None:
        for name, value, shape in (("K", self.K, "(m, q)"), ("Cy", self.Cy, "(q, n)")):
            object.__setattr__(self, name, real_matrix(value, name, shape))
        if self.K.shape[1] != len(self.Cy):
            raise InputError(f"K has shape {self.K.shape} and Cy {self.Cy.shape}; give K one column for each row of Cy")


@dataclass(frozen=True, eq=False)
class Plant:
    """Linear plant with control inputs u, disturbances w, controlled outputs z and, if given, measurements y.

    In continuous time, x' = A x + B u + Bw w, z = C x + D u + Dw w, y = Cy x + Dyu u + Dyw w. A plant with a sample period `dt`
    is discrete: in its equations, x[k+1] replaces x'. Methods that return another plant keep the measurements unless their
    description states otherwise.

    Attributes:
        A: state matrix, shape (n, n).
        B: matrix from the m inputs to the states, shape (n, m).
        Bw: matrix from the r disturbances to the states, shape (n, r).
        C: matrix from the states to the d outputs, shape (d, n).
        D: feedthrough from the inputs to the outputs, shape (d, m).
        Dw: feedthrough from the disturbances to the outputs, shape (d, r); zero in the paper.
        beyond: rounding errors of [A; C] of a closed loop (true value minus float), shape (n + d, n); None if A and C are
            exact.
        weights: number of states that belong to weighting filters; they are the last states of the plant. Controllers cannot
            move the poles of these filters, so these poles are ignored in the speed of the plant.
        dt: sample period of a discrete plant [s]; None for a continuous plant.
        Cy: matrix from the states to the q measurements, shape (q, n). Default: no measurements.
        Dyu: feedthrough from the inputs to the measurements, shape (q, m). Default: zero.
        Dyw: feedthrough from the disturbances to the measurements, shape (q, r). Default: zero.

    Raises:
        InputError: a matrix has the wrong shape, too many rows or columns, or entries that are not real finite numbers between
            `SMALLEST` and `LARGEST`. The error is also raised if `dt` or `weights` is invalid.
    """

    public_name = "a GeneralizedPlant"

    A: Array
    B: Array
    Bw: Array
    C: Array
    D: Array
    Dw: Array
    beyond: Array | None = None
    weights: int = 0
    dt: float | None = None
    Cy: Array = field(default=NOTHING, kw_only=True)
    Dyu: Array = field(default=NOTHING, kw_only=True)
    Dyw: Array = field(default=NOTHING, kw_only=True)

    def __post_init__(self) -> None:
        if self.dt is not None:
            object.__setattr__(self, "dt", _sample_period(self.dt))
        for name in SHAPES:
            matrix, size = arrays.real_matrix(getattr(self, name), name, LARGEST, str(SHAPES[name]))
            if 0 < size < SMALLEST:
                raise InputError(
                    f"{name} has no entry above {SMALLEST:g} (the largest is {size:g}), so this matrix cannot be distinguished "
                    f"from 0; give {name} in other units, or set all entries to 0"
                )
            matrix.flags.writeable = False
            object.__setattr__(self, name, matrix)
        size = {"n": len(self.A), "m": self.B.shape[1], "r": self.Bw.shape[1], "d": len(self.C)}
        for name, (rows, columns) in SHAPES.items():
            matrix, shape = getattr(self, name), (size[rows], size[columns])
            if matrix.shape != shape:
                raise InputError(
                    f"{name} has shape {matrix.shape}, but must have the shape {shape}: A has {size['n']} row(s), B has "
                    f"{size['m']} column(s), Bw has {size['r']} column(s) and C has {size['d']} row(s)"
                )
        for name, count, needed in (("Bw has no columns", size["r"], "Bw a column"), ("C has no rows", size["d"], "C a row")):
            if not count:
                raise InputError(f"{name}, so there is no norm from w to z; give {needed}, which may consist of zeros")
        object.__setattr__(self, "weights", check("weights", self.weights, Index))
        if self.weights > size["n"]:
            raise InputError(
                f"weights is the number of states that belong to filters, and weights = {self.weights} is more than the "
                f"{size['n']} states of the plant; give at most {size['n']}"
            )
        if self.beyond is not None:
            check_shape("beyond", check("beyond", self.beyond, Array), (size["n"] + size["d"], size["n"]), "as A and C are")
        q = 0 if self.Cy is None else len(real_matrix(self.Cy, "Cy", f"(q, {size['n']})"))
        for name, of, what in (("Cy", "n", "state"), ("Dyu", "m", "input"), ("Dyw", "r", "disturbance")):
            shape, value = (q, size[of]), getattr(self, name)
            # The check is repeated because `replace` may have changed the shapes of the other matrices.
            none = value is None or (isinstance(value, np.ndarray) and value.ndim == 2 and not len(value))
            matrix = np.zeros(shape) if none else real_matrix(value, name, str(shape))
            if matrix.shape != shape:
                raise InputError(
                    f"{name} has shape {matrix.shape}; expected {shape if name != 'Cy' else f'(q, {shape[1]})'}: a row for each "
                    f"measured signal, a column for each {what}"
                )
            matrix.flags.writeable = False
            object.__setattr__(self, name, matrix)

    @classmethod
    def without_inputs(cls, A: Array, Bw: Array, C: Array, Dw: Array, dt: float | None = None) -> "Plant":
        """Returns a system from w to z without control inputs."""
        return cls(A, np.zeros((len(A), 0)), Bw, C, np.zeros((len(C), 0)), Dw, dt=dt)

    def unchecked(self, **parts: Any) -> "Plant":
        """Returns a copy of the plant in which some attributes have new values.

        The new values must fit the other attributes of the plant; the values are neither checked nor copied.
        """
        plant = object.__new__(Plant)
        plant.__dict__.update({each.name: getattr(self, each.name) for each in fields(self)} | parts)
        return plant

    def measured(self, Cy: object = None, Dyw: object = None, Dyu: object = None) -> "Plant":
        """Returns the plant with the measurements y = Cy x + Dyu u + Dyw w after a check.

        Args:
            Cy: matrix with a row for each measured signal, shape (q, n). By default, the measurements of the plant are kept.
            Dyw: feedthrough from w to the measurements, shape (q, r). Default: zero.
            Dyu: feedthrough from the inputs to the measurements, shape (q, m). Default: zero.

        Returns:
            The plant with the measurements y, as a `GeneralizedPlant`.

        Raises:
            InputError: the plant has no state, or no signal is measured. The error is also raised if a matrix has the wrong
                shape or entries that are not real finite numbers. Every measured signal must have at least one entry that is
                not nearly zero.
        """
        check_states(len(self.A))
        changed: dict[str, Any] = {"Cy": Cy, "Dyw": Dyw, "Dyu": Dyu}
        if Cy is None:
            changed = {name: each for name, each in changed.items() if each is not None}
        plant = replace(self, **changed) if changed else self
        if not len(plant.Cy):
            raise InputError("Cy has no rows, so no signal is measured; give at least one row")
        parts = {"Cy": "state", "Dyw": "disturbance", "Dyu": "force"}
        given = [name for name in parts if name == "Cy" or (name == "Dyw" and Dyw is not None) or np.any(getattr(plant, name))]
        sizes = np.abs(np.hstack([getattr(plant, name) for name in given])).max(axis=1)
        silent = np.flatnonzero(sizes < SMALLEST)
        if len(silent):
            what = "zero" if sizes[silent[0]] == 0 else f"below {SMALLEST:g}"
            whole = f"[{' '.join(given)}]" if len(given) > 1 else given[0]
            raise InputError(
                f"row {silent[0]} of {whole} is {what}: the signal contains no information on the "
                f"{' or '.join(parts[name] for name in given)}; omit the row"
            )
        return plant

    def acting(self, K: Array) -> Array:
        """Returns (I - K Dyu)^-1 K, the gain on C_y x + Dyw w with the same effect as K on the measurements, shape (m, q).

        Raises:
            InputError: the algebraic loop through the measurements has no solution.
        """
        return static_law(K).fed_back(self.Dyu).D

    def on_readings(self, G: Array) -> Array:
        """Returns the gain that, applied to the measurements y, gives the same force as G applied to C_y x + Dyw w.

        This method is the inverse of `acting`.
        """
        return static_law(G).fed_back(-self.Dyu).D

    @property
    def without_weighting(self) -> "Plant":
        """Plant without its weighting filters, whose states are the last states of the plant.

        A gain affects only the stability of this part, not the stability of the filters.
        """
        if not self.weights:
            return self
        own = slice(len(self.A) - self.weights)
        parts = {"A": self.A[own, own], "B": self.B[own], "Bw": self.Bw[own], "C": self.C[:, own], "Cy": self.Cy[:, own]}
        return replace(self, weights=0, **parts)

    @property
    def without_feedthrough(self) -> "Plant":
        """Plant with the measurements C_y x + Dyw w (without Dyu), for which control laws are designed."""
        return replace(self, Dyu=None) if np.any(self.Dyu) else self

    @property
    def unmeasured(self) -> "Plant":
        """Plant without measurements."""
        return replace(self, Cy=None, Dyu=None, Dyw=None) if len(self.Cy) else self

    @property
    def plant(self) -> "Plant":
        """Plant without measurements. Deprecated attribute that remains from the class `MeasuredPlant`; use the plant itself."""
        warnings.warn("`plant` will be removed in the next version; use the plant itself", DeprecationWarning, stacklevel=2)
        return self.unmeasured

    @property
    def through(self) -> Array:
        """Feedthrough Dyu. Deprecated attribute that remains from the class `MeasuredPlant`; use `Dyu`."""
        warnings.warn("`through` will be removed in the next version; use Dyu", DeprecationWarning, stacklevel=2)
        return self.Dyu

    def rows(self, kept: Sequence[int] | Array) -> "Plant":
        """Returns the plant with only some of its measurements, which are given by indices or by a mask."""
        return replace(self, Cy=self.Cy[kept], Dyu=self.Dyu[kept], Dyw=self.Dyw[kept])

    def with_disturbances(self, Dyw: Array) -> "Plant":
        """Returns the plant with k further disturbances that act on the measurements only.

        Args:
            Dyw: feedthrough from the further disturbances to the measurements, shape (q, k).
        """
        Bw, Dw = (np.hstack([matrix, np.zeros((len(matrix), Dyw.shape[1]))]) for matrix in (self.Bw, self.Dw))
        return replace(self, Bw=Bw, Dw=Dw, Dyw=np.hstack([self.Dyw, Dyw]))

    def with_states(self, k: int) -> "Plant":
        """Returns the plant with k more states, inputs and measurements, for the states of a control law.

        The additional states satisfy x_c' = v, or x_c[k+1] = v[k] for a discrete plant. A law u = C x_c + D y,
        v = A x_c + B y is then the static gain [D, C; B, A] of the larger plant.
        """
        if not k:
            return self
        (n, m), (q, r) = self.B.shape, self.Dyw.shape
        return Plant(
            A=np.block([[self.A, np.zeros((n, k))], [np.zeros((k, n + k))]]),
            B=np.block([[self.B, np.zeros((n, k))], [np.zeros((k, m)), np.eye(k)]]),
            Bw=np.vstack([self.Bw, np.zeros((k, r))]),
            C=np.hstack([self.C, np.zeros((len(self.C), k))]),
            D=np.hstack([self.D, np.zeros((len(self.D), k))]),
            Dw=self.Dw,
            dt=self.dt,
            Cy=np.block([[self.Cy, np.zeros((q, k))], [np.zeros((k, n)), np.eye(k)]]),
            Dyu=np.pad(self.Dyu, ((0, k), (0, k))),
            Dyw=np.pad(self.Dyw, ((0, k), (0, 0))),
        )

    def with_law(self, law: LinearLaw) -> "tuple[Plant, Feedback]":
        """Returns the plant with the states of a law on y, and the law as a static gain on the states of this larger plant.

        If y contains w, the larger plant also contains the effect of w through the law.

        Raises:
            InputError: the algebraic loop through the measurements has no solution.
        """
        law, larger = law.fed_back(self.Dyu), self.with_states(law.states)
        if np.any(self.Dyw):
            Bw = np.vstack([self.Bw + self.B @ law.D @ self.Dyw, law.B @ self.Dyw])
            larger = replace(larger, Bw=Bw, Dw=self.Dw + self.D @ law.D @ self.Dyw)
        return larger.unmeasured, Feedback(law_gain(law), larger.Cy)

    def closed(self, law: LinearLaw) -> "Plant":
        """Returns the closed loop of the plant and a law on y; see `with_law` and `closed_loop`."""
        larger, gain = self.with_law(law)
        return larger.closed_loop(gain)

    @property
    def transposed(self) -> "Plant":
        """Transposed plant, with w and z exchanged.

        State feedback for the transposed plant is output injection of y = C_y x + Dyw w for the original plant.
        """
        return Plant(self.A.T, self.Cy.T, self.C.T, self.Bw.T, self.Dyw.T, self.Dw.T, dt=self.dt)

    @property
    def system_matrix(self) -> Array:
        """Matrix [A B Bw; C D Dw], shape (n + d, n + m + r)."""
        return np.vstack([np.hstack([self.A, self.B, self.Bw]), np.hstack([self.C, self.D, self.Dw])])

    @cached_property
    def differences(self) -> "Plant":
        """Plant in difference form, in which (x[k+1] - x[k]) / dt replaces x'.

        As dt decreases, the entries of the plant in differences approach those of the continuous plant.

        The plant in differences has the form of a continuous plant, but its poles and norms differ from those of the discrete
        plant. A continuous plant is returned unchanged.
        """
        if self.dt is None:
            return self
        A = (self.A - np.eye(len(self.A))) / self.dt
        return replace(self, A=A, B=self.B / self.dt, Bw=self.Bw / self.dt, beyond=None, dt=None)

    def closed_loop(self, G: Array | Feedback) -> "Plant":
        """Returns the plant with the feedback u = G x + (new u), as in equations (16) and (17).

        A + B G and C + D G are rounded once, and `beyond` contains the rounding errors. For a very large gain, or a gain that
        cancels most of A, the rounding errors may determine the norm.

        Args:
            G: state gain, shape (m, n), or a gain from measurements.

        Returns:
            The closed loop, as a `GeneralizedPlant`.

        Raises:
            InputError: the shape of the gain does not fit the plant.
        """
        G = check("G", G, Matrix | Feedback)
        shape = (len(G.K), G.Cy.shape[1]) if isinstance(G, Feedback) else G.shape
        if shape != self.B.T.shape:
            raise InputError(f"G has shape {shape}; expected {self.B.T.shape}: a row for each input, a column for each state")
        high, beyond = fed_back(np.vstack([self.A, self.C]), np.vstack([self.B, self.D]), G, self.beyond)
        n, Cy = len(self.A), self.Cy
        if np.any(self.Dyu):
            Cy = Cy + self.Dyu @ (G.K @ G.Cy if isinstance(G, Feedback) else G)
        return replace(self, A=high[:n], C=high[n:], Cy=Cy, beyond=beyond, weights=0)

    def in_coordinates(self, T: Array) -> "Plant":
        """Returns the plant in terms of the new state T^-1 x, for an invertible matrix T of shape (n, n)."""
        inverse = np.linalg.inv(T)
        A, B, Bw = inverse @ self.A @ T, inverse @ self.B, inverse @ self.Bw
        return replace(self, A=A, B=B, Bw=Bw, C=self.C @ T, Cy=self.Cy @ T, beyond=None, weights=0)

    def with_inputs(self, W: Array) -> "Plant":
        """Returns the plant with new inputs v, where u = W v and W has shape (m, k)."""
        return replace(self, B=self.B @ W, D=self.D @ W, Dyu=self.Dyu @ W, beyond=None, weights=0)

    def independent_inputs(self) -> Array:
        """Returns an orthonormal basis W, shape (m, k), of the input combinations that affect the plant; I if k = m."""
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
        """Returns the frequency response T(j omega) from w to z without control (19); for a discrete plant T(e^(j omega dt)).

        Args:
            omega: angular frequencies [rad/s], shape (F,).

        Returns:
            The response at each frequency, complex, shape (F, d, r).
        """
        n, s = len(self.A), 1j * np.asarray(omega, dtype=float)[:, None]
        shifted = np.broadcast_to(-self.A, (len(s), n, n)).astype(complex)
        shifted[:, np.arange(n), np.arange(n)] += s if self.dt is None else np.exp(s * self.dt)
        return self.C @ np.linalg.solve(shifted, np.broadcast_to(self.Bw.astype(complex), (len(s), *self.Bw.shape))) + self.Dw


GeneralizedPlant = Plant  # name for the public interface


def law_gain(law: LinearLaw) -> Array:
    """Returns the matrix [D, C; B, A] of a law, shape (m + k, q + k), which is its static gain on the plant of
    `Plant.with_states`.
    """
    return np.block([[law.D, law.C], [law.B, law.A]]) if law.states else law.D


def gain_law(gain: Array, m: int, q: int, dt: float | None = None) -> LinearLaw:
    """Returns the law that has the static gain [D, C; B, A]. The function is the inverse of `law_gain`."""
    return LinearLaw(A=gain[m:, q:], B=gain[m:, :q], C=gain[:m, q:], D=gain[:m, :q], sample_period=dt)


def fed_back(open_loop: Array, inputs: Array, G: Array | Feedback, beyond: Array | None = None) -> tuple[Array, Array]:
    """Returns the matrix [A; C] + [B; D] G, rounded once, and the rounding error of this matrix.

    Args:
        open_loop: matrices [A; C], shape (n + d, n).
        inputs: matrices [B; D], shape (n + d, m).
        G: state gain, shape (m, n), or a gain from measurements.
        beyond: exact values of A and C minus their floats, shape (n + d, n); None if A and C are exact.
    """
    gain, rest = product(G.K, G.Cy) if isinstance(G, Feedback) else (G, np.zeros_like(G))
    moved, low = product(inputs, gain)
    low = low + inputs @ rest
    high, off = exact_sum(open_loop, moved)
    return exact_sum(high, off + low if beyond is None else off + (low + beyond))


def _sample_period(dt: object) -> float:
    """Checks that a sample period is a positive number within the limits, and returns it [s]."""
    allowed = f"give the seconds between samples, from {SMALLEST:g} to {LARGEST:g}, or None for a continuous plant"
    try:
        if isinstance(dt, bool | np.bool_):
            raise TypeError
        period = float(dt)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"dt = {short_repr(dt)} is not a number; {allowed}") from None
    if not SMALLEST <= period <= LARGEST:
        raise InputError(f"dt = {period:g} is not a sample period; {allowed}")
    return period


def real_matrix(value: object, name: str, expected: str) -> Array:
    """Returns a copy of a matrix after checks: its entries are real numbers up to `LARGEST`, and its size is allowed.

    Args:
        value: array or nested lists.
        name: name of the matrix, which is used in error messages.
        expected: description of the required shape, which is used in error messages.

    Raises:
        InputError: the matrix does not pass these checks.
    """
    return arrays.real_matrix(value, name, LARGEST, expected)[0]


def check_states(n: int) -> None:
    """Raises an InputError if a plant has no state.

    Only plants that the user supplies are checked, because a part of a plant may have no states.
    """
    if not n:
        raise InputError("A has shape (0, 0), so the plant has no states; give at least one state")


def check_inputs(plant: Plant) -> None:
    """Raises an InputError if a plant has no state or no input, because then no controller can be designed."""
    check_states(len(plant.A))
    if not plant.B.shape[1]:
        raise InputError("B has no columns, so the plant has no inputs; give one column for each force")


def check_continuous(plant: Plant) -> None:
    """Raises an InputError for a discrete plant, for functions whose formulas are valid only for continuous plants."""
    if plant.dt is not None:
        raise InputError(
            f"the plant is discrete (dt = {plant.dt:g}), but this function needs a continuous plant; give a continuous plant"
        )


def check_posed(plant: Plant) -> None:
    """Checks that a plant has a disturbance and a controlled output.

    Raises:
        InputError: Bw, Dw and Dyw are all zero, or both C and D are zero.
    """
    if not (np.any(plant.Bw) or np.any(plant.Dw) or np.any(plant.Dyw)):
        zero = "Bw, Dw and Dyw" if len(plant.Dyw) else "Bw and Dw"
        raise InputError(
            f"no disturbance acts on the plant, because all entries of {zero} are zero; give at least one nonzero entry"
        )
    if not (np.any(plant.C) or np.any(plant.D)):
        raise InputError(
            "the controlled output z is always zero, because C and D are zero; give at least one signal a weight above zero"
        )


def on_all_rows(gain: Array, kept: Sequence[int] | Array, q: int) -> Array:
    """Converts a gain on some of the q measurements to a gain on all q measurements, shape (m, q); the additional entries are
    zero.
    """
    whole = np.zeros((len(gain), q))
    whole[:, kept] = gain
    return whole
