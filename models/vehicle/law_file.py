"""Controllers in MATLAB files of versions 4 to 7, which SciPy reads.

A file contains A, B, C, D (or Ak, Bk, Ck, Dk), or a gain K, or num and den of a transfer function.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from models.common.arrays import Array, real_matrix
from models.common.errors import InputError, first_few, list_names, short_repr
from models.common.table import matlab_variables

MATRICES = ("A", "B", "C", "D")
OTHERS = {f"{name}k": name for name in MATRICES}  # names of the matrices in textbooks
TRANSFER = ("num", "den")  # names of numerator and denominator of a transfer function from one measurement to one force
PERIODS = ("Ts", "sample_period")
# Fields of the struct that MATLAB's get(sys) returns
DELAYS = ("InputDelay", "OutputDelay", "IODelay", "ioDelay", "InternalDelay")
SAVE = "save('FILE.mat', 'A', 'B', 'C', 'D', 'Ts', '-v7')"
# Descriptions of NumPy types, by the letter of the type
KINDS = {"U": "text", "O": "a cell array or an object", "V": "a struct"}


def read_law(content: bytes) -> tuple[dict[str, Any], float | None]:
    """Returns the only control law in a MATLAB file.

    Args:
        content: bytes of the file.

    Returns:
        The matrices or the gain by key, as in a vehicle file. The second value is the sample period [s]; None for a continuous
        or static law.

    Raises:
        InputError: the file is not a MATLAB file of versions 4 to 7, or does not contain exactly one controller.
    """
    where, values = _only_controller(matlab_variables(content))
    matrices = {
        name: value.toarray() if hasattr(value, "toarray") else value for name, value in values.items()
    }  # sparse matrices are converted to dense matrices
    if {"A", "B", "C"} & {*matrices}:
        missing = [name for name in MATRICES if name not in matrices]
        if missing:
            raise InputError(f"{list_names(missing)} is missing in {where}; give A, B, C and D, or K alone")
    if "K" in matrices and {*MATRICES} & {*matrices}:
        raise InputError(
            f"{where} has both K and {list_names({*MATRICES} & {*matrices})}; keep only K (a static gain), or only A, B, C and D"
        )
    _check_plain(matrices)
    if "A" not in matrices or not matrices["A"].size:
        gain = "K" if "K" in matrices else "D"
        return {"gain": _numbers(gain, matrices[gain]).tolist()}, None
    return {name: _numbers(name, matrices[name]).tolist() for name in MATRICES}, _period(matrices)


def _only_controller(variables: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Returns the only controller in a file: the controller's place in the file (for messages), and its variables or fields by
    name.
    """
    names = (*MATRICES, *OTHERS, "K", *TRANSFER, *PERIODS)
    places = {"the file": {name: value for name, value in variables.items() if name in names}}
    for name, value in variables.items():
        if getattr(value, "dtype", None) is not None and value.dtype.names and value.shape == (1, 1):
            places[f"the struct {name}"] = {field: value[field][0, 0] for field in value.dtype.names}
    holding = {where: values for where, values in places.items() if {*values} & {*MATRICES, *OTHERS, "K", *TRANSFER}}
    if len(holding) > 1:
        raise InputError(f"the file contains several controllers, in {' and '.join(holding)}; keep only one controller")
    for where, values in holding.items():
        return where, _as_matrices(where, values)
    # SciPy gives this name to MATLAB objects; each object is a row of four values, which include its name and class
    if "None" in variables:
        name, _, kind, _ = (part.decode() if isinstance(part, bytes) else part for part in variables["None"][0])
        raise InputError(
            f"{name} is a MATLAB object of class {kind}, which only MATLAB can read; for a system, call "
            f"[A, B, C, D, Ts] = ssdata({name}) and {SAVE} in MATLAB"
        )
    others = [name for name in variables if not name.startswith("__")]
    raise InputError(
        f"the file contains {first_few(others) or 'nothing'}, but neither K nor the matrices A, B, C and D; in MATLAB, "
        f"call {SAVE}"
    )


def _as_matrices(where: str, values: dict[str, Any]) -> dict[str, Any]:
    """Returns the matrices of a law by their usual names. A transfer function is converted to a controllable canonical form."""
    if both := [f"{other} and {name}" for other, name in OTHERS.items() if other in values and name in values]:
        raise InputError(f"{where} has both {both[0]}; keep only one of the two variables")
    values = {OTHERS.get(name, name): value for name, value in values.items()}
    if not {*TRANSFER} & {*values}:
        return values
    missing, more = [name for name in TRANSFER if name not in values], [name for name in (*MATRICES, "K") if name in values]
    if missing or more:
        raise InputError(
            f"{where} has a transfer function {'and ' + more[0] if more else 'without ' + missing[0]}; give only num "
            "and den, without matrices"
        )
    num, den = (np.trim_zeros(_numbers(name, values[name]).ravel(), "f") for name in TRANSFER)
    if not len(num) <= len(den) or not len(den):
        raise InputError(
            f"num has {len(num)} coefficients, but den has only {len(den)}; give den at least {len(num)} "
            "coefficients, with the highest power first"
        )
    n, num = len(den) - 1, np.pad(num, (len(den) - len(num), 0)) / den[0]
    a = den[1:] / den[0]
    matrices = (
        np.vstack([-a, np.eye(n)[:-1]]) if n else np.zeros((0, 0)),
        np.eye(n)[:, :1],
        (num[1:] - num[0] * a)[None],
        num[:1, None],
    )
    return {name: value for name, value in values.items() if name not in TRANSFER} | dict(zip(MATRICES, matrices, strict=True))


def _numbers(name: str, value: Any) -> Array:
    """Returns a matrix of real finite numbers. The size of the matrix is checked later, when the control law is created."""
    if value.dtype.kind in KINDS:
        raise InputError(f"{name} is {KINDS[value.dtype.kind]}, not a matrix of numbers; in MATLAB, call {SAVE}")
    return real_matrix(value, name, np.inf)[0]


def _check_plain(matrices: Mapping[str, Any]) -> None:
    """Raises InputError if the struct of a system has further fields that would change the law, such as delays."""
    E = _numbers("E", matrices["E"]) if "E" in matrices else np.zeros((0, 0))
    if E.size and not np.array_equal(E, np.eye(len(E))):
        raise InputError(
            "the matrix E is not the identity; in MATLAB, convert the system to x' = A x + B y with ss(sys, 'explicit')"
        )
    delayed = [name for name in DELAYS if np.any(matrices.get(name, 0))]
    if delayed:
        raise InputError(
            f"{', '.join(delayed)} is above 0, but a law in a file cannot have a delay; give the delay in "
            "[implementation], or approximate it in MATLAB with pade(sys, 3)"
        )
    unit = "".join(map(str, np.ravel(matrices.get("TimeUnit", ""))))
    if unit not in ("", "seconds"):
        raise InputError(
            f"TimeUnit is {short_repr(unit)} instead of seconds; in MATLAB, convert to seconds with chgTimeUnit(sys, 'seconds')"
        )


def _period(matrices: Mapping[str, Any]) -> float | None:
    """Returns the sample period [s]; None for a continuous law, whose period MATLAB writes as 0."""
    periods = {name: _numbers(name, matrices[name]) for name in PERIODS if name in matrices}
    for name, value in periods.items():
        if value.size != 1 or value.item() < 0:
            raise InputError(
                f"{name} = {short_repr(value)} is not a sample period; give the sample period in seconds, or 0 for a "
                "continuous law"
            )
    values = {value.item() for value in periods.values()}
    if len(values) > 1:
        raise InputError("the file has two different sample periods, Ts and sample_period; keep only one of the two")
    return max(values, default=0.0) or None
