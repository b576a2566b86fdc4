"""Custom vehicle types that are defined in the user's Python code.

Python executes the file that defines the vehicle type. The equations of the type are checked once for the parameters of each
vehicle.
"""

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import wraps
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from models.common.checks import NotNegative, Positive, check
from models.common.errors import InputError, error_in, first_few, list_names
from models.common.files import read_text
from models.kinds.kind import VehicleKind
from models.kinds.linear_model import LinearModel
from models.kinds.signals import HEAVE_LOAD, PITCH_LOAD, ROLL_LOAD, STATE_PREFIX
from models.laws.user_code import compile_file, run_own

LOADS = (HEAVE_LOAD.name, PITCH_LOAD.name, ROLL_LOAD.name)
ROAD = ("road_displacement", "road_velocity", "tyre_deflection")  # signals that every wheel has
EQUATIONS = ("linear_model", "static_tyre_deflection", "angles", "write_mjcf")
GIVE = "give the equations of the vehicle type as in docs/how-to/custom-vehicle-type.md"


def read_kind(folder: Path, name: str) -> VehicleKind:
    """Executes `NAME.py` in a folder and returns its `KIND`.

    Args:
        folder: folder that contains `NAME.py`.
        name: name of the vehicle type.

    Raises:
        InputError: the file cannot be read, is not Python code, fails, or has no valid `KIND`. The functions of the vehicle
            type also raise an InputError if they fail. The function `check_together` also raises an InputError if results of
            the vehicle type's functions are wrong.
    """
    path = folder / f"{name}.py"
    what, module = f"vehicle type {path}", ModuleType(f"roadproof_{name}")
    module.__dict__.update(__file__=str(path), print=print_to_stderr)
    code = compile_file(what, path, read_text(path, "vehicle type", GIVE))
    run_own(what, path, "the file", lambda: exec(code, vars(module)))
    kind = vars(module).get("KIND")
    with _locate_errors(path):
        if not isinstance(kind, VehicleKind):
            has = f"KIND is a {type(kind).__name__}" if "KIND" in vars(module) else "the file defines no KIND"
            raise InputError(
                f"{has}; end the file of the vehicle type with KIND = VehicleKind(...), as in docs/how-to/custom-vehicle-type.md"
            )
        if kind.name != name:
            raise InputError(
                f"KIND has the name {kind.name!r}, but the files of this vehicle type are named {name!r}; use the same "
                "name for both"
            )
        check_parts(kind)
    return _guarded_kind(path, replace(kind, folder=folder))


def print_to_stderr(*values: Any, file: Any = None, **options: Any) -> None:
    """Prints to stderr.

    This function replaces the `print` of custom vehicle types, because stdout is reserved for the output of the command, which
    may be JSON.
    """
    print(*values, file=file or sys.stderr, **options)


def check_parts(kind: VehicleKind) -> None:
    """Checks that the parts of a vehicle type, except its functions, fit together. `CheckedFields` checks each part separately.

    Raises:
        InputError: a name is used twice, or a part refers to a name that is not in the vehicle type.
    """
    suspended = kind.suspended or ()
    names = {
        "parameter": [part.name for part in kind.parameters],
        "signal": [part.name for part in (*kind.signals, *kind.on_demand)],
        "load": [load.name for load in kind.loads],
        "force of a suspension": [part.force for part in suspended if part.force],
    }
    names |= {f"{part} of a wheel": [getattr(wheel, part) for wheel in kind.wheels] for part in ("road_body", *ROAD)}
    names |= {f"{part} of a suspension": [getattr(one, part) for one in suspended] for part in ("deflection", "tendon")}
    for what, given in names.items():
        for name in given:
            if not name.isidentifier() or name.startswith(STATE_PREFIX):
                rule = f"use letters, digits and '_', without a digit first or {STATE_PREFIX} at the beginning"
                raise InputError(f"{what}: {name!r} is not allowed; {rule}")
            if given.count(name) > 1:
                raise InputError(f"{what}: the name {name!r} is used twice; give different names")
    signals = [signal.name for signal in kind.signals]
    accelerations = [signal.name for signal in kind.signals if signal.unit == "m/s2"]
    for what, name, known in (
        *((f"a wheel's {part}", getattr(wheel, part), signals) for wheel in kind.wheels for part in ROAD),
        *(("a load", name, LOADS) for name in names["load"]),
        *(("a point in people", name, accelerations) for name in kind.people or ()),
        *(("combined", name, names["signal"]) for name in kind.combined),
        *(("a suspension's deflection", part.deflection, signals) for part in suspended),
        *(("a suspension's stiffness", part.stiffness, names["parameter"]) for part in suspended if part.stiffness),
        *(("a suspension's damping", part.damping, names["parameter"]) for part in suspended if part.damping),
        *(("a suspension's ratio", part.ratio, names["parameter"]) for part in suspended if part.ratio),
        *((f"a signal of the invariant {one.name!r}", name, signals) for one in kind.invariants for name in one.signals),
    ):
        if name not in known:
            raise InputError(f"{what} is {name!r}, which is unknown; give one of {list_names(known)}")
    ratios: dict[str, str] = {}
    for part in kind.suspensions:
        for name in filter(None, (part.stiffness, part.damping)):
            if ratios.setdefault(name, part.ratio) != part.ratio:
                raise InputError(
                    f"suspensions with different motion ratios cannot share the parameter {name}; give each "
                    "suspension its own parameter"
                )


def check_equations(kind: VehicleKind, parameters: Mapping[str, float]) -> None:
    """Checks that the results of a vehicle type's functions fit its names.

    Raises:
        InputError: a result has the wrong type, or the names in a result differ from those of the vehicle type.
    """
    model, rest, angles = (of(parameters) for of in (kind.linear_model, kind.static_tyre_deflection, kind.angles))
    numbers = [("behind of a wheel", wheel.behind(parameters), NotNegative) for wheel in kind.wheels]
    numbers += [("lateral of a wheel", wheel.lateral(parameters), float) for wheel in kind.wheels]
    for one in kind.invariants:
        numbers += [(f"{part} of {one.name!r}", getattr(one, part)(parameters), Positive) for part in ("omega", "magnitude")]
    with _locate_errors(kind.mjcf.with_suffix(".py")):
        for name, value, annotation in numbers:
            check(name, value, annotation)
        _check_model(check("linear_model(parameters)", model, LinearModel), kind)
        tyres = [wheel.tyre_deflection for wheel in kind.wheels]
        if check("static_tyre_deflection(parameters)", rest, Mapping[str, Positive]).keys() != set(tyres):
            raise InputError(
                f"static_tyre_deflection returns {list_names(rest)}; return one number for each of {list_names(tyres)}"
            )
        signals = {signal.name for signal in kind.signals}
        for angle, parts in check("angles(parameters)", angles, Mapping[str, Mapping[str, float]]).items():
            if angle not in ("pitch_angle", "roll_angle") or not signals.issuperset(parts):
                raise InputError(
                    f"angles returns {angle!r} as a sum of {list_names(parts)}, which is not allowed; return only "
                    "'pitch_angle' and 'roll_angle', each as {signal: factor} with signals of the vehicle type"
                )


def _check_model(model: LinearModel, kind: VehicleKind) -> None:
    """Raises InputError if a linear model lacks names of its vehicle type, or has states or inputs that are not also outputs."""
    roads = tuple(wheel.road_velocity for wheel in kind.wheels)
    driven = {*roads, *(wheel.road_displacement for wheel in kind.wheels)}
    signals = {signal.name for signal in (*kind.signals, *kind.on_demand)} - driven
    forces = {suspension.force for suspension in kind.suspended or () if suspension.force}
    if model.tyres_damp:
        raise InputError(
            "linear_model returns Bt or Dw for tyre damping, but only built-in vehicle types have tyre damping; omit Bt and Dw"
        )
    for what, given, wanted in (
        ("disturbances", model.disturbances, roads),
        ("loads", model.loads, tuple(load.name for load in kind.loads)),
    ):
        if given != wanted:
            names = f"{first_few(given) or 'none'}; return, in this order, {first_few(wanted) or 'none'}"
            raise InputError(f"linear_model returns the {what} {names}")
    for what, names in {
        "no states; return at least one": () if model.states else ("",),
        "no input {}, which is the force of a suspension; add this input": forces - {*model.inputs},
        "no output {}, which is a signal of the vehicle type; add the output, or remove the signal": signals - {*model.outputs},
        "an output {}, which is not a signal of the vehicle type; add it to the signals": {*model.outputs} - signals,
        "a state or input {} that is not an output; add it to the outputs": {*model.states, *model.inputs} - {*model.outputs},
        "a state or input {} that is in on_demand; list it in signals instead": {*model.states, *model.inputs} & {*kind.unnamed},
    }.items():
        if names:
            raise InputError(f"linear_model returns {what.format(repr(min(names)))}")
    for names, own, others in ((model.states, model.C, (model.D, model.Cr)), (model.inputs, model.D, (model.C, model.Cr))):
        rows = [model.outputs.index(name) for name in names]
        wrong = np.any(own[rows] != np.eye(len(names)), axis=1) | np.any([other[rows].any(axis=1) for other in others], axis=0)
        if wrong.any():
            name = names[int(np.argmax(wrong))]
            raise InputError(
                f"linear_model: output {name!r} differs from the state or input with the same name; correct the rows of "
                "this output in the output matrices"
            )


def _guarded_kind(path: Path, kind: VehicleKind) -> VehicleKind:
    """Returns the vehicle type with functions whose results are checked, and which raise InputError if they fail.

    The function `check_together` of the returned type checks the results of the other functions.
    """

    def guarded(name: str, function: Callable[..., Any], refuses: bool = False) -> Callable[..., Any]:
        @wraps(function)
        def call(*arguments: Any) -> Any:
            *others, parameters = arguments
            return run_own(f"vehicle type {path}", path, name, lambda: function(*others, dict(parameters)), refuses)

        return call

    def part(of: Any, what: str, *names: str) -> Any:
        return replace(of, **{name: guarded(f"{name} of {what}", getattr(of, name)) for name in names})

    own = replace(
        kind,
        wheels=tuple(part(wheel, f"the wheel at {wheel.road_body!r}", "behind", "lateral") for wheel in kind.wheels),
        invariants=tuple(part(one, f"the invariant {one.name!r}", "omega", "magnitude") for one in kind.invariants),
        **{name: guarded(name, getattr(kind, name)) for name in EQUATIONS},
    )
    refuse = guarded("check_together", kind.check_together, refuses=True)

    def check_together(parameters: Mapping[str, float]) -> None:
        refuse(parameters)
        check_equations(own, parameters)

    return replace(own, check_together=check_together)


@contextmanager
def _locate_errors(path: Path) -> Iterator[None]:
    """Adds the name of the file to the text of an InputError."""
    with error_in(f"vehicle type {path}:"):
        yield
