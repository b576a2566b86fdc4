"""Structure of a law with states: a given order, one law for each force, or PI and PID; and a PID law of given numbers.

order = 2
structure = "corner"
structure = "pid"
pid = { kp = -8000.0, ki = -2000.0, kd = -900.0, filter = 0.01 }

A PID law is u = kp y + ki (integral of y) + kd s / (filter s + 1) y. Its integral is an exact integrator, a pole at 0. There is
no minus: a positive force lifts the body, so that negative gains on an extension work against it and positive ones with it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.checks import check_keys, is_finite, number_within, table_within
from models.common.errors import InputError, quoted
from models.common.printed import entry
from models.laws.combinations import PI, PID, is_order
from models.laws.goals import CORNER, read_structure
from models.laws.linear import LARGEST, MATRICES, LinearLaw

GAINS, FILTER = ("kp", "ki", "kd"), "filter"
ITS_GAINS = "designed gains: "  # begins the remark on a PI or PID law that is designed
SHORTEST, LONGEST = 1e-6, 1e3  # s, time constant of a derivative's low-pass
EXAMPLE = "pid = { kp = -8000.0, ki = -2000.0, kd = -900.0, filter = 0.01 }"


@dataclass(frozen=True)
class LawStructure:
    """Structure of a law that is designed.

    Attributes:
        order: number of its states; of each force's own law where there are `rows`. 0 for PI and PID, whose pattern has its own.
        rows: True if a measurement may act on a force, a row per force; each force then has a law of its own. None: one law.
        kind: "pi" or "pid"; empty for a law of a given order.
        filter: time constant of the derivative's low-pass [s]; 0 without a derivative.
    """

    order: int = 0
    rows: tuple[tuple[bool, ...], ...] | None = None
    kind: str = ""
    filter: float = 0.0

    @property
    def text(self) -> str:
        """The structure as in a vehicle file."""
        return f'structure = "{self.kind}"' if self.kind else f"order = {self.order}"

    def states(self, forces: int) -> int:
        """Returns how many states a law for so many forces has at most, without those of PI and PID."""
        return self.order * (forces if self.rows is not None else 1)


def pid_filter(kind: str, filter: float) -> LinearLaw:
    """Returns the system from y to [y; its integral], and the filtered derivative of a PID law, in continuous time."""
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
    """Returns as many copies of a system, one for each of as many signals."""
    return LinearLaw(
        *(np.kron(np.eye(count), getattr(one, name)) for name in ("A", "B", "C", "D")), sample_period=one.sample_period
    )


def read_law_structure(
    where: str, entry: Mapping[str, Any], measured: Sequence[str], corners: Mapping[str, str]
) -> LawStructure | None:
    """Reads the structure of a law that is designed; None if a section has none.

    Args:
        corners: suffix of the names at a force's suspension, by force.

    Raises:
        InputError: the structure is not allowed.
    """
    order, structure = entry.get("order"), entry.get("structure")
    if structure in (PI, PID):
        kind = PI if structure == PI else PID
        rows = _one_each(where, f'structure = "{kind}"', measured, corners)
        return LawStructure(rows=rows, kind=kind, filter=_filter(where, kind, entry))
    if not is_order(order) or not order:
        return None
    return LawStructure(order, read_structure(where, structure, measured, corners))


def read_pid(where: str, entry: Mapping[str, Any], measured: Sequence[str], corners: Mapping[str, str]) -> LinearLaw:
    """Reads a PID law of given numbers, without the states that do nothing.

    Raises:
        InputError: a number is missing or not allowed, or there is not one signal for each force.
    """
    table = table_within(f"{where} pid", entry["pid"], f"a table, as in {EXAMPLE}")
    if beside := [key for key in (*MATRICES, "sample_period") if key in entry]:
        raise InputError(f"{where} has both pid and {beside[0]}, but a controller has only one law; omit one of them")
    rows = np.array(_one_each(where, "pid", measured, corners), dtype=float)
    check_keys(f"{where} pid", table, (*GAINS, FILTER))
    m = len(corners)
    kp, ki, kd = (_gains(f"{where} pid.{name}", table.get(name, 0.0), m) for name in GAINS)
    if np.any(kd) and FILTER not in table:
        raise InputError(
            f"{where} pid has kd but no filter, so a step would cause an infinite force; give the time constant of the "
            "derivative's filter in seconds, as in filter = 0.01"
        )
    if FILTER in table and not np.any(kd):
        raise InputError(f"{where} pid has a filter, which acts only on the derivative, but no kd; give kd, or omit filter")
    filter = number_within(f"{where} pid.filter", table[FILTER], SHORTEST, LONGEST, "s") if FILTER in table else 1.0
    law = side_by_side(pid_filter(PID, filter), m)
    K = _block(kp, ki, kd)
    C, D = K @ law.C, K @ law.D
    kept = np.flatnonzero(np.any(C != 0, axis=0))  # the states are independent of one another
    return LinearLaw(law.A[kept][:, kept], (law.B @ rows)[kept], C[:, kept], D @ rows)


def pid_gains(law: LinearLaw) -> list[dict[str, float]]:
    """Returns the numbers of a PI or PID law as in `pid` of a vehicle file, for each force; empty for any other law.

    Its states are integrals and filtered signals, with the poles 0 and -1 / filter, and the inputs 1 and 1 / filter.
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
    """Returns a PI or PID law as in a vehicle file, a table for each force; empty for any other law."""
    return pid_tables(pid_gains(law))


def pid_tables(gains: Sequence[Mapping[str, float]]) -> str:
    """Returns gains by name as in a vehicle file, a table for each force."""
    tables = [", ".join(f"{name} = {entry(value)}" for name, value in each.items()) for each in gains]
    return ", ".join(f"pid = {{ {one} }}" for one in tables)


def _block(kp: Array, ki: Array, kd: Array) -> Array:
    """The gain on what the filters of all signals give, shape (m, 3 m)."""
    m = len(kp)
    K = np.zeros((m, 3 * m))
    for i, gains in enumerate(zip(kp, ki, kd, strict=True)):
        K[i, 3 * i : 3 * i + 3] = gains
    return K


def _one_each(where: str, written: str, measured: Sequence[str], corners: Mapping[str, str]) -> tuple[tuple[bool, ...], ...]:
    """Returns which measurement acts on which force, one on each."""
    m, q = len(corners), len(measured)
    if q == m and not any(corners.values()):
        return tuple(tuple(i == j for j in range(q)) for i in range(m))
    if q != m:
        raise InputError(
            f"{where} {written} needs one measured signal for each force, but measured has {q} signal(s) for {m} force(s); give "
            f"{m} signal(s)"
        )
    return read_structure(where, CORNER, measured, corners) or ()


def _filter(where: str, kind: str, entry: Mapping[str, Any]) -> float:
    """Returns the time constant of the derivative of a law that is designed [s]; 0 for PI."""
    table = table_within(f"{where} pid", entry.get("pid", {}), "a table, as in pid = { filter = 0.01 }")
    if given := [name for name in GAINS if name in table]:
        raise InputError(
            f'{where} structure = "{kind}" designs the gains, but pid already gives {given[0]}; omit structure to use the '
            "given gains, or give only filter in pid"
        )
    check_keys(f"{where} pid", table, (FILTER,))
    if kind == PI:
        if table:
            raise InputError(f'{where} structure = "{PI}" has no derivative, but the key pid sets a filter for one; omit pid')
        return 0.0
    if FILTER not in table:
        raise InputError(
            f'{where} structure = "{PID}" needs the time constant of the derivative\'s low-pass filter; give it in seconds, as '
            "in pid = { filter = 0.01 }"
        )
    return number_within(f"{where} pid.filter", table[FILTER], SHORTEST, LONGEST, "s")


def _gains(what: str, value: Any, m: int) -> Array:
    """Returns a gain for each force: one number for all, or a list."""
    several = value if isinstance(value, list) else [value] * m
    if len(several) != m or not all(is_finite(one) and abs(one) <= LARGEST for one in several):
        raise InputError(f"{what} = {quoted(value)} is not allowed; give a number, or a list of {m} number(s), one per force")
    return np.array(several, dtype=float)
