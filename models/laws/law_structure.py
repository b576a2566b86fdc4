"""Structure of a dynamic law in a controller's section (order, one law per force, PI, PID), and PID laws whose numbers a file
gives.

order = 2
structure = "corner"
structure = "pid"
pid = { kp = -8000.0, ki = -2000.0, kd = -900.0, filter = 0.01 }

A PID law is u = kp y + ki (integral of y) + kd s / (filter s + 1) y, with the measurement y and the force u. The integral of a
PID law is an exact integrator with a pole at 0. The PID law has no minus sign: a positive force lifts the body, so negative
gains on an extension counteract it and positive gains amplify it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from models.common.checks import is_finite
from models.common.errors import InputError, short_repr
from models.common.printed import entry
from models.common.schema import HERE, SI, ReadBy, Section, Subsection
from models.laws.design_methods import FULL, PATTERNS, PI, PID, STATIC
from models.laws.design_request import LawStructure, is_order
from models.laws.goals import Goals, corner_rows
from models.laws.linear import LARGEST, MOST_STATES, LinearLaw

GAINS, FILTER = ("kp", "ki", "kd"), "filter"
ITS_GAINS = "designed gains: "  # beginning of the remark about a PI or PID law that Roadproof designs
ORDER = {"anyOf": [{"enum": [STATIC, FULL]}, {"type": "integer", "minimum": 0, "maximum": MOST_STATES}]}
GAIN = {"type": ["number", "array"]}
EXAMPLE = "pid = { kp = -8000.0, ki = -2000.0, kd = -900.0, filter = 0.01 }"


def pid_filter(kind: str, filter: float) -> LinearLaw:
    """Returns the continuous-time system from a measurement y to three signals: y, the integral of y, and the filtered
    derivative of y.

    For a PI law, the filtered derivative is omitted.
    """
    if kind == PI:
        return LinearLaw(np.zeros((1, 1)), np.ones((1, 1)), np.array([[0.0], [1.0]]), np.array([[1.0], [0.0]]))
    rate = 1 / filter
    return LinearLaw(
        np.diag([0.0, -rate]),
        np.array([[1.0], [rate]]),
        np.array([[0.0, 0.0], [1.0, 0.0], [0.0, -rate]]),
        np.array([[1.0], [0.0], [rate]]),
    )


def side_by_side(one: LinearLaw, count: int) -> LinearLaw:
    """Returns a system that consists of independent copies of a system, one copy for each signal."""
    return LinearLaw(
        *(np.kron(np.eye(count), getattr(one, name)) for name in ("A", "B", "C", "D")), sample_period=one.sample_period
    )


def _gains(value: Any, context: Mapping[str, Any]) -> tuple[float, ...]:
    """Returns one gain of a PI or PID law for each force. The vehicle file gives one number for all forces, or a list with one
    number per force.
    """
    m = len(context["corners"])
    several = value if isinstance(value, list | tuple) else [value] * m
    if len(several) != m or not all(is_finite(one) and abs(one) <= LARGEST for one in several):
        raise InputError(f"{HERE} = {short_repr(value)} is not allowed; give a number, or a list of {m} number(s), one per force")
    return tuple(float(one) for one in several)


@dataclass(frozen=True)
class PidSection(Section):
    """Section with the numbers of a PI or PID law."""

    kp: Annotated[tuple[float, ...], ReadBy("proportional gain, one for all forces, or one for each", _gains, allowed=GAIN)] = ()
    ki: Annotated[tuple[float, ...], ReadBy("integral gain", _gains, allowed=GAIN)] = ()
    kd: Annotated[tuple[float, ...], ReadBy("derivative gain", _gains, allowed=GAIN)] = ()
    filter: Annotated[float, SI("s", "time constant of the derivative's low-pass filter", high=1e3)] | None = None


def _order(value: Any, context: Mapping[str, Any]) -> str | int:
    """Returns the order in a law structure: the name of an allowed order, or a number of states."""
    if value not in (STATIC, FULL) and not is_order(value):
        raise InputError(
            f"{HERE} = {short_repr(value)} is unknown; give one of {FULL}, {STATIC}, or a number of states from 0 to "
            f"{MOST_STATES}"
        )
    return value


@dataclass(frozen=True, kw_only=True)
class StructureSection(Goals):
    """Keys of a controller's section that define the structure and the goals of a law."""

    order: Annotated[Any, ReadBy("`static`, `full`, or the number of states of the law", _order, allowed=ORDER)] | None = None
    pid: (
        Annotated[PidSection, Subsection("gains and filter of a PI or PID law", (PidSection,), f"a table, as in {EXAMPLE}")]
        | None
    ) = None

    def law_structure(self, measured: Sequence[str], corners: Mapping[str, str]) -> LawStructure | None:
        """Returns the structure of a law that is designed; None for a static gain, a full-order law, or a law whose numbers are
        given.

        Args:
            measured: names of the measured signals.
            corners: suffix of the signal names at the suspension on which each force acts.

        Raises:
            InputError: the structure does not fit the signals, or `pid` does not fit the structure.
        """
        if self.structure not in PATTERNS:
            return LawStructure(self.order, self.structure) if self.order and is_order(self.order) else None
        what, pid = f'structure = "{self.structure}"', self.pid or PidSection()
        rows = _one_each(what, measured, corners)
        if given := [name for name in GAINS if getattr(pid, name)]:
            raise InputError(
                f"{what} means that Roadproof designs the gains, but pid already gives {given[0]}; omit structure to "
                "use the given gains, or omit the gains in pid so that Roadproof designs them"
            )
        if self.structure == PI and pid.filter is not None:
            raise InputError(f"{what} has no derivative, but the key pid sets the filter of the derivative; omit pid")
        if self.structure == PID and pid.filter is None:
            raise InputError(
                f"{what} needs the time constant of the derivative's low-pass filter; give it in seconds, as in "
                "pid = { filter = 0.01 }"
            )
        return LawStructure(rows=rows, kind=self.structure, filter=pid.filter or 0.0)

    def pid_law(self, measured: Sequence[str], corners: Mapping[str, str]) -> LinearLaw | None:
        """Returns the PID law whose numbers the section gives, without states that have no effect; None for any other law.

        For the arguments and errors, see `law_structure`.
        """
        pid = self.pid
        if pid is None or self.structure in PATTERNS:
            return None
        m, rows = len(corners), np.array(_one_each("pid", measured, corners), dtype=float)
        if np.any(pid.kd) and pid.filter is None:
            raise InputError(
                "pid has kd but no filter, so a step would cause an infinite force; give the time constant of the derivative's "
                "filter in seconds, as in filter = 0.01"
            )
        if pid.filter is not None and not np.any(pid.kd):
            raise InputError(
                "pid has a filter, which acts only on the derivative, but pid has no derivative gain kd; give kd, or omit filter"
            )
        K = np.zeros((m, 3 * m))  # gains that multiply the outputs of the PID filters of all signals
        for part, gains in enumerate((pid.kp, pid.ki, pid.kd)):
            K[range(m), range(part, 3 * m, 3)] = gains or 0.0
        law = side_by_side(pid_filter(PID, pid.filter or 1.0), m)
        C, D = K @ law.C, K @ law.D
        # States that no output uses can be removed, because the states do not depend on each other
        kept = np.flatnonzero(np.any(C != 0, axis=0))
        return LinearLaw(law.A[kept][:, kept], (law.B @ rows)[kept], C[:, kept], D @ rows)


def pid_gains(law: LinearLaw) -> list[dict[str, float]]:
    """Returns the numbers of a PI or PID law for each force, as in `pid` of a vehicle file; empty for any other law.

    The states of a PI or PID law are integrals and low-pass-filtered signals. The poles of the law are 0 for integrals and -1 /
    filter for filtered signals. The input gains of the states are 1 for integrals and 1 / filter for filtered signals.
    """
    rates = -np.diag(law.A)
    signals, forces = np.nonzero(law.B), np.nonzero(law.C.T)
    states = np.arange(law.states)
    each_one = all(np.array_equal(rows, states) for rows, _ in (signals, forces))
    if law.sample_period is not None or not law.states or np.any(np.diag(-rates) != law.A) or not each_one:
        return []
    if np.any(law.B[signals] != np.where(rates == 0, 1.0, rates)) or np.any(rates < 0):
        return []
    found: list[dict[str, float]] = []
    for i, row in enumerate(law.D):
        mine = np.flatnonzero(forces[1] == i)
        integral, filtered = mine[rates[mine] == 0], mine[rates[mine] > 0]
        if len({*signals[1][mine].tolist(), *np.flatnonzero(row).tolist()}) > 1 or len(integral) > 1 or len(filtered) > 1:
            return []
        kd = float(sum(-law.C[i, j] / rates[j] for j in filtered))
        gains = {"kp": float(row.sum() - sum(kd * rates[j] for j in filtered))}
        if len(integral):
            gains["ki"] = float(law.C[i, integral[0]])
        if len(filtered):
            gains |= {"kd": kd, FILTER: float(1 / rates[filtered[0]])}
        found.append(gains)
    return found


def pid_text(law: LinearLaw) -> str:
    """Returns a PI or PID law as it is written in a vehicle file, with a table for each force; empty for any other law."""
    return pid_tables(pid_gains(law))


def pid_tables(gains: Sequence[Mapping[str, float]]) -> str:
    """Returns the gains as they are written in a vehicle file: for each force, a table of gains by name."""
    tables = [", ".join(f"{name} = {entry(value)}" for name, value in each.items()) for each in gains]
    return ", ".join(f"pid = {{ {one} }}" for one in tables)


def _one_each(what: str, measured: Sequence[str], corners: Mapping[str, str]) -> tuple[tuple[bool, ...], ...]:
    """Returns a row for each force, with True for the only measurement that acts on this force.

    The argument `what` is the name of the structure in messages.
    """
    m, q = len(corners), len(measured)
    if q == m and not any(corners.values()):
        return tuple(tuple(i == j for j in range(q)) for i in range(m))
    if q != m:
        raise InputError(
            f"{what} needs one measured signal for each force, but measured lists {q} signal(s) for {m} force(s); "
            f"list {m} signal(s) in measured"
        )
    return corner_rows(what, measured, corners)
