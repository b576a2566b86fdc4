"""Linear control law from measurements to forces: x_c' = A x_c + B y, u = C x_c + D y. A static gain is a linear law without
states.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg

from models.common.arrays import Array, real_matrix
from models.common.checks import Positive, PositiveTime, check
from models.common.errors import InputError
from models.common.printed import entry, rough
from models.laws.law import LawSource

FEWER = "of at most"  # these words mark the remark about a law that has fewer states than the design allows
MATRICES = ("A", "B", "C", "D")
ENTRY = re.compile(r"(gain|[ABCD])\[(\d+)\]\[(\d+)\]")  # pattern of the key that sets a single number of a law
PREVIEW_MATRICES = ("A", "B", "H", "C")  # names of the matrices that `models.laws.preview` uses
MOST_STATES = 200  # largest number of states of a control law; a typical law has some dozens
LARGEST = 1e15  # largest magnitude of an entry of a law's matrices; with larger entries, rounding errors would dominate
# A growth rate below this share of the state matrix's largest entry counts as a rounding error, as for the poles of a double
# integrator
ROUNDING = 1e-7
# Smallest allowed relative singular value of the matrix of an algebraic loop through the measurements; below this value, no
# digit of the result is reliable
SINGULAR = 1e-12


@dataclass(frozen=True, eq=False)
class LinearLaw(LawSource):
    """Linear control law with k states, from q measurements to m forces.

    Attributes:
        A: state matrix, shape (k, k).
        B: gain from the measurements to the state, shape (k, q).
        C: gain from the state to the forces, shape (m, k).
        D: gain from the measurements to the forces [N per unit of the measurement], shape (m, q). If the law has no states, D
            is the static gain K.
        sample_period: sample period of a discrete law [s]; None for a continuous law. A discrete law is
            x_c[i+1] = A x_c[i] + B y[i], u[i] = C x_c[i] + D y[i].
        anti_windup: rate at which the states follow the actual forces while forces are clipped [1/s]; None without anti-windup.

    Raises:
        InputError: a matrix has the wrong shape, or has entries that are not real and finite or exceed `LARGEST`, or the law
            has too many states. The message of the error states which matrix is invalid.
    """

    request = None

    A: Array
    B: Array
    C: Array
    D: Array
    sample_period: float | None = None
    anti_windup: float | None = None

    def __post_init__(self) -> None:
        for name in MATRICES:
            matrix, _ = real_matrix(getattr(self, name), name, LARGEST)
            matrix.flags.writeable = False
            object.__setattr__(self, name, matrix)
        k, (m, q) = len(self.A), self.D.shape
        if k > MOST_STATES:
            raise InputError(
                f"a controller with {k} states is too large; reduce the order of the controller to at most {MOST_STATES}"
            )
        for name, shape in {"A": (k, k), "B": (k, q), "C": (m, k)}.items():
            given = getattr(self, name).shape
            if given != shape:
                raise InputError(
                    f"{name} has shape {given}; expected {shape}, because A has {k} row(s) and D has shape {(m, q)} "
                    "(D has one row for each force and one column for each measured signal)"
                )
        object.__setattr__(self, "sample_period", check("sample_period", self.sample_period, PositiveTime | None))
        object.__setattr__(self, "anti_windup", check("anti_windup", self.anti_windup, Positive | None))

    @property
    def states(self) -> int:
        """Number of states; 0 for a static gain."""
        return len(self.A)

    @property
    def record(self) -> dict[str, Any]:
        """The law as keys of JSON and TOML: the gain of a static law; for other laws, matrices, sample period and anti-windup."""
        if not self.states:
            return {"gain": self.D.tolist()}
        numbers = {"sample_period": self.sample_period, "anti_windup": self.anti_windup}
        given = {name: number for name, number in numbers.items() if number is not None}
        return {name: getattr(self, name).tolist() for name in MATRICES} | given

    @property
    def given(self) -> "LinearLaw":
        """See `LawSource`."""
        return self

    @property
    def values(self) -> dict[str, float | None]:
        """See `LawSource`."""
        matrices = {name: value for name, value in self.record.items() if isinstance(value, list)}
        rate: dict[str, float | None] = {"anti_windup": self.anti_windup} if self.anti_windup is not None else {}
        return rate | {f"{name}[{i}][{j}]": value for name, one in matrices.items() for (i, j), value in np.ndenumerate(one)}

    def with_values(self, measured: tuple[str, ...], values: Mapping[str, float]) -> dict[str, Any]:
        """See `LawSource`."""
        record: dict[str, Any] = {"measured": list(measured), **self.record}
        for key, value in values.items():
            if match := ENTRY.fullmatch(key):
                record[match[1]][int(match[2])][int(match[3])] = value
            else:
                record[key] = value
        return record

    @property
    def matrix(self) -> Array:
        """[D, C; B, A], shape (m + k, q + k).

        The columns of the matrix belong to the measurements and the states. The rows of the matrix belong to the forces,
        followed by the rates of the states (for a discrete law: the next states).
        """
        return np.block([[self.D, self.C], [self.B, self.A]])

    @property
    def acts(self) -> bool:
        """False if the force of the law is 0 for all measurements."""
        return bool(np.any(self.D) or (np.any(self.B) and np.any(self.C)))

    @property
    def growth(self) -> float:
        """Growth rate of the law's fastest growing state without feedback [1/s]; 0 if no state grows by more than rounding
        errors.
        """
        if not self.states:
            return 0.0
        poles, size = np.linalg.eigvals(self.A), float(np.abs(self.A).max())
        if self.sample_period is None:
            fastest, rounding = float(poles.real.max()), ROUNDING * size
        else:
            largest = max(float(np.abs(poles).max()), ROUNDING)
            fastest, rounding = np.log(largest) / self.sample_period, ROUNDING * max(size, 1.0) / self.sample_period
        return float(fastest) if fastest > rounding else 0.0

    def response(self, omega: float | Array) -> Array:
        """Returns the law's transfer matrix at one frequency, complex, shape (m, q), or at F frequencies, shape (F, m, q).

        Args:
            omega: angular frequency [rad/s]; for a discrete law, below pi divided by the sample period.
        """
        s = 1j * np.asarray(omega)[..., None, None]
        at = s if self.sample_period is None else np.exp(s * self.sample_period)
        return self.C @ np.linalg.solve(at * np.eye(self.states) - self.A, self.B) + self.D

    def of_state(self, period: float | None) -> float:
        """Returns the factor that converts the states of `sampled(period)` to the states of the law itself.

        Args:
            period: sample period [s]; None for the states of `continuous()`.
        """
        if self.sample_period is None or (period is not None and self._at(period)):
            return 1.0
        return 1 / np.sqrt(self.sample_period)

    def scaled(self, factors: Array | float) -> "LinearLaw":
        """Returns the law with its forces multiplied by factors.

        Args:
            factors: factor for all forces, or a factor for each force, shape (m,).
        """
        rows = np.broadcast_to(np.asarray(factors, dtype=float), len(self.D))[:, None]
        return replace(self, C=rows * self.C, D=rows * self.D)

    def only(self, forces: Array) -> "LinearLaw":
        """Returns the law with all forces set to 0, except selected forces.

        The methods `scaled` and `only` together open the loop at actuators.

        Args:
            forces: True for each force that remains, shape (m,).
        """
        rows = np.asarray(forces, dtype=bool)[:, None]
        return replace(self, C=np.where(rows, self.C, 0.0), D=np.where(rows, self.D, 0.0))

    def fed_back(self, through: Array) -> "LinearLaw":
        """Returns the equivalent law for measurements y0, where this law measures y = y0 + `through` u; this solves the
        algebraic loop.

        Args:
            through: feedthrough from the forces to the measurements, shape (q, m).

        Raises:
            InputError: I - D `through` is singular.
        """
        if not np.any(through):
            return self
        loop = without_loop(self.D @ through)
        C, D = np.linalg.solve(loop, self.C), np.linalg.solve(loop, self.D)
        B = self.B @ through
        return replace(self, A=self.A + B @ C, B=self.B + B @ D, C=C, D=D)

    def continuous(self) -> "LinearLaw":
        """Returns the law in continuous time.

        For a discrete law, the result is the continuous law whose bilinear (Tustin) transform is the discrete law.

        Raises:
            InputError: the law has a pole at -1, or the result has entries that exceed `LARGEST`.
        """
        if self.sample_period is None:
            return self
        if not self.states:
            return replace(self, sample_period=None)
        root, shifted = np.sqrt(self.sample_period), self.A + np.eye(self.states)
        if np.linalg.svd(shifted, compute_uv=False)[-1] < SINGULAR * max(1.0, np.abs(self.A).max()):
            raise InputError(
                "a discrete controller with a pole at z = -1 has no continuous counterpart; move this pole away from -1"
            )
        inverse = np.linalg.inv(shifted)
        try:
            return LinearLaw(
                2 / self.sample_period * (self.A - np.eye(self.states)) @ inverse,
                2 / root * inverse @ self.B,
                2 / root * self.C @ inverse,
                self.D - self.C @ inverse @ self.B,
                anti_windup=self.anti_windup,
            )
        except InputError as error:
            raise InputError(
                f"in the continuous counterpart (Tustin) of this controller, {error}; scale the states of the "
                "controller so that B and C have entries of similar size"
            ) from error

    @property
    def text(self) -> str:
        """The law as one line of text."""
        if not self.states:
            return f"gain {gain_text(self.D)}"
        if self.sample_period is None:
            return f"x_c' = A x_c + B y, u = C x_c + D y, with {states_text(self)}"
        return f"x_c[i+1] = A x_c[i] + B y[i], u[i] = C x_c[i] + D y[i], with {states_text(self)}"

    def sampled(self, period: float) -> "LinearLaw":
        """Returns the discrete law that a computer executes at a sample period.

        The sampled states of a continuous law are exact if the measurements change linearly between samples (ramp-invariant or
        first-order hold: Franklin, Powell, Workman 1998, section 6.3). Unlike a method that holds measurements between samples,
        the ramp-invariant method adds no delay. With the ramp-invariant method, a state that is fast relative to the period
        settles immediately; with Tustin's rule, it would oscillate. At its own sample period, a discrete law is returned
        unchanged.

        Args:
            period: sample period [s].

        Raises:
            InputError: a state grows by more than `LARGEST` within a period, or the result has entries that exceed `LARGEST`.
        """
        if not self.states or self._at(period):
            return replace(self, sample_period=period)
        law = self.continuous()
        if law.growth * period > np.log(LARGEST):
            raise InputError(
                f"the law has an unstable pole at +{law.growth:.4g} 1/s, which is too fast for a sample period of "
                f"{period:g} s; give a shorter sample period, or, if the law measures accelerations, also measure "
                "control_force"
            )
        k, q = law.B.shape
        augmented = np.zeros((k + 2 * q, k + 2 * q))
        augmented[:k, :k], augmented[:k, k : k + q] = period * law.A, period * law.B
        augmented[k : k + q, k + q :] = np.eye(q)
        step = linalg.expm(augmented)
        Phi, Gamma, ramp = step[:k, :k], step[:k, k : k + q], step[:k, k + q :]
        return LinearLaw(Phi, Gamma - ramp + Phi @ ramp, law.C, law.D + law.C @ ramp, period, self.anti_windup)

    def _at(self, period: float) -> bool:
        """Returns True if `period` equals the sample period for which the law is defined."""
        return self.sample_period is not None and bool(np.isclose(self.sample_period, period, rtol=1e-9, atol=0))


def without_loop(direct: Array) -> Array:
    """Returns I - `direct`, shape (m, m).

    The inverse of I - `direct` solves the algebraic loop that arises if forces act directly on measurements.

    Args:
        direct: feedthrough from the actual forces to the requested forces, shape (m, m).

    Raises:
        InputError: I - `direct` is singular.
    """
    loop = np.eye(len(direct)) - direct
    sizes = np.linalg.svd(loop, compute_uv=False)
    if len(sizes) and sizes[-1] < SINGULAR * max(1.0, sizes[0]):
        raise InputError(
            "the forces change the measurements instantly, and I - D_c D is singular, so this algebraic loop of "
            "forces has no solution; change the gain on the accelerations, or filter the accelerations"
        )
    return loop


def static_law(gain: Array) -> LinearLaw:
    """Returns the control law u = K y.

    Args:
        gain: K [N per unit of the measurement], shape (m, q).
    """
    m, q = np.shape(gain)
    return LinearLaw(np.zeros((0, 0)), np.zeros((0, q)), np.zeros((m, 0)), gain)


def unchecked_static_law(gain: Array) -> LinearLaw:
    """Returns the control law u = K y for a gain in any units, whose entries may exceed `LARGEST`."""
    m, q = np.shape(gain)
    law = static_law(np.zeros((m, q)))
    object.__setattr__(law, "D", gain)
    return law


def law_of(record: Mapping[str, Any]) -> LinearLaw:
    """Returns the law that a `LinearLaw.record` describes; the record may have additional keys.

    Raises:
        KeyError: a matrix is missing.
    """
    if "gain" in record:
        return static_law(record["gain"])
    numbers = {name: record.get(name) for name in ("sample_period", "anti_windup")}
    return LinearLaw(*(record[name] for name in MATRICES), **numbers)


def states_text(law: LinearLaw) -> str:
    """Describes the number of states of a law, and its poles."""
    poles = np.linalg.eigvals(law.A)
    count = f"{law.states} states" if law.states > 1 else "1 state"
    if law.sample_period is not None:
        pole = "its largest pole" if law.states > 1 else "its pole"
        return f"{count}, every {1e3 * law.sample_period:g} ms; {pole} {rough(np.abs(poles).max())}"
    least, most = (rough(rate) for rate in (np.abs(poles).min(), np.abs(poles).max()))
    where = f"poles of {least} to {most}" if least != most else f"{'poles' if law.states > 1 else 'its pole'} of {least}"
    unstable = ", not all stable" if poles.real.max() > 0 else ""
    return f"{count}; {where} rad/s{unstable}"


def gain_text(gain: Array) -> str:
    """Returns a gain matrix as one line of text, as in a vehicle file."""
    return "[" + ", ".join("[" + ", ".join(map(entry, row)) + "]" for row in gain) + "]"
