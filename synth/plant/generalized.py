"""The plant (15): x' = A x + B u + Bw w, z = C x + D u + Dw w, y = Cy x + Dyu u + Dyw w; or x[k+1] = ... every dt seconds."""

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

SMALLEST, LARGEST = 1e-50, 1e50  # of a matrix: beyond, squares of its entries under- or overflow where they meet

NOTHING: Any = None
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
class Plant:
    """A linear plant with a disturbance, a controlled output, and measurements if they are given.

    A plant that is made of another keeps its measurements.

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
        Cy: shape (q, n); without rows by default.
        Dyu: shape (q, m); zero by default.
        Dyw: shape (q, r); zero by default.

    Raises:
        InputError: a matrix is not one of real finite numbers, has the wrong shape, too many rows or columns, or
            entries beyond `SMALLEST` or `LARGEST`; or dt or weights is no such number. The message names it.
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
        q = 0 if self.Cy is None else len(real_matrix(self.Cy, "Cy", f"(q, {size['n']})"))
        for name, of, what in (("Cy", "n", "state"), ("Dyu", "m", "input"), ("Dyw", "r", "disturbance")):
            shape, value = (q, size[of]), getattr(self, name)
            # `replace` may have changed the shapes of others.
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
        """Returns a system from w to z alone."""
        return cls(A, np.zeros((len(A), 0)), Bw, C, np.zeros((len(C), 0)), Dw, dt=dt)

    def unchecked(self, **parts: Any) -> "Plant":
        """Returns the plant with some other parts that fit. They are neither checked nor copied, and may be NaN."""
        plant = object.__new__(Plant)
        plant.__dict__.update({each.name: getattr(self, each.name) for each in fields(self)} | parts)
        return plant

    def measured(self, Cy: object = None, Dyw: object = None, Dyu: object = None) -> "Plant":
        """Returns the plant with the measurements y = Cy x + Dyu u + Dyw w after a check; by default with its own.

        Args:
            Cy: a row for each measured signal.
            Dyw: feedthrough from w to the measurements; zero if it is not given.
            Dyu: feedthrough from the inputs to the measurements; zero if it is not given.

        Raises:
            InputError: the plant has no state, a matrix is not one of real finite numbers of its shape, no signal is measured, or
                one that is next to zero in all.
        """
        check_states(len(self.A))
        changed: dict[str, Any] = {"Cy": Cy, "Dyw": Dyw, "Dyu": Dyu}
        if Cy is None:
            changed = {name: each for name, each in changed.items() if each is not None}
        plant = replace(self, **changed) if changed else self
        if not len(plant.Cy):
            raise InputError("Cy has no rows: nothing is measured; give at least one signal")
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
        """Returns the gain on C_y x + Dyw w that acts as K on the measurements, (I - K Dyu)^-1 K, shape (m, q).

        Raises:
            InputError: the loop has no solution.
        """
        return static_law(K).fed_back(self.Dyu).D

    def on_readings(self, G: Array) -> Array:
        """Returns the gain on readings that acts as G acts on C_y x + Dyw w: the inverse of `acting`."""
        return static_law(G).fed_back(-self.Dyu).D

    @property
    def without_weighting(self) -> "Plant":
        """The plant without its filters, whose states are the last: a gain decides the stability of this part alone."""
        own = slice(len(self.A) - self.weights)
        parts = {"A": self.A[own, own], "B": self.B[own], "Bw": self.Bw[own], "C": self.C[:, own], "Cy": self.Cy[:, own]}
        return replace(self, weights=0, **parts)

    @property
    def without_feedthrough(self) -> "Plant":
        """The plant with the measurements C_y x + Dyw w, for a law that is designed on them."""
        return replace(self, Dyu=None) if np.any(self.Dyu) else self

    @property
    def unmeasured(self) -> "Plant":
        """The plant without measurements."""
        return replace(self, Cy=None, Dyu=None, Dyw=None) if len(self.Cy) else self

    @property
    def plant(self) -> "Plant":
        """The plant without measurements, as `MeasuredPlant` had it; use the plant itself."""
        warnings.warn("`plant` goes with the next version; a MeasuredPlant is a plant itself", DeprecationWarning, stacklevel=2)
        return self.unmeasured

    @property
    def through(self) -> Array:
        """The feedthrough Dyu under its name in `MeasuredPlant`."""
        warnings.warn("`through` goes with the next version; use Dyu", DeprecationWarning, stacklevel=2)
        return self.Dyu

    def rows(self, kept: Sequence[int] | Array) -> "Plant":
        """Returns the plant with some of its measurements, by index or mask."""
        return replace(self, Cy=self.Cy[kept], Dyu=self.Dyu[kept], Dyw=self.Dyw[kept])

    def with_disturbances(self, Dyw: Array) -> "Plant":
        """Returns the plant with further disturbances that act on the measurements alone, by Dyw of shape (q, k)."""
        Bw, Dw = (np.hstack([matrix, np.zeros((len(matrix), Dyw.shape[1]))]) for matrix in (self.Bw, self.Dw))
        return replace(self, Bw=Bw, Dw=Dw, Dyw=np.hstack([self.Dyw, Dyw]))

    def with_states(self, k: int) -> "Plant":
        """Returns the plant with the states of a law, x_c' = v or x_c[k+1] = v[k]: k more states, inputs and measurements.

        A law u = C x_c + D y, v = A x_c + B y is the static gain [D, C; B, A] of this plant.
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
        """Returns the plant with the states of a law on y, and the law as a static gain on it; w acts on it through the law.

        Raises:
            InputError: the loop through the measurements has no solution.
        """
        law, larger = law.fed_back(self.Dyu), self.with_states(law.states)
        if np.any(self.Dyw):
            Bw = np.vstack([self.Bw + self.B @ law.D @ self.Dyw, law.B @ self.Dyw])
            larger = replace(larger, Bw=Bw, Dw=self.Dw + self.D @ law.D @ self.Dyw)
        return larger.unmeasured, Feedback(law_gain(law), larger.Cy)

    def closed(self, law: LinearLaw) -> "Plant":
        """Returns the closed loop of a law on y, see `with_law` and `closed_loop`."""
        larger, gain = self.with_law(law)
        return larger.closed_loop(gain)

    @property
    def transposed(self) -> "Plant":
        """The transposed plant: its state feedback is the injection of y = C_y x + Dyw w, and w and z are exchanged."""
        return Plant(self.A.T, self.Cy.T, self.C.T, self.Bw.T, self.Dyw.T, self.Dw.T, dt=self.dt)

    @property
    def system_matrix(self) -> Array:
        """[A B Bw; C D Dw], shape (n + d, n + m + r)."""
        return np.vstack([np.hstack([self.A, self.B, self.Bw]), np.hstack([self.C, self.D, self.Dw])])

    @cached_property
    def differences(self) -> "Plant":
        """The plant in differences, (x[k+1] - x[k]) / dt instead of x': its entries tend to the continuous ones as dt falls.

        The result has the form of a continuous plant, but other poles and norms; a continuous plant is its own.
        """
        if self.dt is None:
            return self
        A = (self.A - np.eye(len(self.A))) / self.dt
        return replace(self, A=A, B=self.B / self.dt, Bw=self.Bw / self.dt, beyond=None, dt=None)

    def closed_loop(self, G: Array | Feedback) -> "Plant":
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
        n, Cy = len(self.A), self.Cy
        if np.any(self.Dyu):
            Cy = Cy + self.Dyu @ (G.K @ G.Cy if isinstance(G, Feedback) else G)
        return replace(self, A=high[:n], C=high[n:], Cy=Cy, beyond=beyond, weights=0)

    def in_coordinates(self, T: Array) -> "Plant":
        """Returns the same plant with state T^-1 x, T regular, shape (n, n)."""
        inverse = np.linalg.inv(T)
        A, B, Bw = inverse @ self.A @ T, inverse @ self.B, inverse @ self.Bw
        return replace(self, A=A, B=B, Bw=Bw, C=self.C @ T, Cy=self.Cy @ T, beyond=None, weights=0)

    def with_inputs(self, W: Array) -> "Plant":
        """Returns the plant with inputs v that act as u = W v, W of shape (m, k)."""
        return replace(self, B=self.B @ W, D=self.D @ W, Dyu=self.Dyu @ W, beyond=None, weights=0)

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
        n, s = len(self.A), 1j * np.asarray(omega, dtype=float)[:, None]
        shifted = np.broadcast_to(-self.A, (len(s), n, n)).astype(complex)
        shifted[:, np.arange(n), np.arange(n)] += s if self.dt is None else np.exp(s * self.dt)
        return self.C @ np.linalg.solve(shifted, np.broadcast_to(self.Bw.astype(complex), (len(s), *self.Bw.shape))) + self.Dw


GeneralizedPlant = Plant  # its public name


def law_gain(law: LinearLaw) -> Array:
    """Returns [D, C; B, A] of a law, its gain on the plant of `Plant.with_states`, shape (m + k, q + k)."""
    return np.block([[law.D, law.C], [law.B, law.A]]) if law.states else law.D


def gain_law(gain: Array, m: int, q: int, dt: float | None = None) -> LinearLaw:
    """Returns the law of a gain [D, C; B, A]: the inverse of `law_gain`."""
    return LinearLaw(A=gain[m:, q:], B=gain[m:, :q], C=gain[:m, q:], D=gain[:m, :q], sample_period=dt)


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
    high, off = exact_sum(open_loop, moved)
    return exact_sum(high, off + low if beyond is None else off + (low + beyond))


def _sample_period(dt: object) -> float:
    """Returns the seconds between samples after a check: a number above zero, in range."""
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


def check_inputs(plant: Plant) -> None:
    """Raises an InputError if a plant has no state or no input, where nothing can be designed."""
    check_states(len(plant.A))
    if not plant.B.shape[1]:
        raise InputError("B has no columns, a plant without inputs; give one column for each force")


def check_continuous(plant: Plant) -> None:
    """Raises an InputError for a discrete plant, if a formula holds for continuous ones only."""
    if plant.dt is not None:
        raise InputError(f"the plant is discrete (dt = {plant.dt:g}), but this function needs a continuous plant; give one")


def check_posed(plant: Plant) -> None:
    """Checks that a plant has a disturbance and a controlled output.

    Raises:
        InputError: Bw, Dw and Dyw are zero, or C and D are.
    """
    if not (np.any(plant.Bw) or np.any(plant.Dw) or np.any(plant.Dyw)):
        zero = "Bw, Dw and Dyw" if len(plant.Dyw) else "Bw and Dw"
        raise InputError(f"the plant has no disturbance: {zero} are zero; give at least one nonzero entry")
    if not (np.any(plant.C) or np.any(plant.D)):
        raise InputError("the controlled output z is zero, as C and D are zero; give at least one signal a weight above zero")


def on_all_rows(gain: Array, kept: Sequence[int] | Array, q: int) -> Array:
    """Returns a gain on some of q measurements as one on all, with zeros for the others, shape (m, q)."""
    whole = np.zeros((len(gain), q))
    whole[:, kept] = gain
    return whole
