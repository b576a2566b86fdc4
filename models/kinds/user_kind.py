"""Kinds of vehicles in the user's own Python: the code is run, and every mistake in its results becomes one line.

Every check returns the mistake as text, or an empty text. The caller names the file.
"""

import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import wraps
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from models.common.checks import is_finite
from models.common.errors import InputError, first_few, quoted
from models.common.files import read_text
from models.kinds.kind import MOST_SQUEEZE, VehicleKind
from models.kinds.linear_model import LinearModel
from models.kinds.signals import HEAVE_LOAD, KEPT, PITCH_LOAD, ROLL_LOAD
from models.laws.user_code import compiled, run_own

LARGEST = 1e30  # SI; of any entry. A ratio of two parameters is at most 1e18; a vehicle has no square of that
LONGEST = 60  # characters of a name
LOADS = (HEAVE_LOAD.name, PITCH_LOAD.name, ROLL_LOAD.name)


def wrong_parts(kind: VehicleKind) -> str:
    """Checks how the parts of a kind that are no functions go together; each by itself is `Checked`."""
    for what, parts in (("parameter", kind.parameters), ("signal", (*kind.signals, *kind.on_demand))):
        if wrong := _wrong_names(what, [part.name for part in parts]):
            return wrong
        for part in parts:
            if part.name.startswith(KEPT):
                return f"{what} {part.name!r}: names that begin with {KEPT} are of a controller's states; give it another"
    return _wrong_loads(kind) or _wrong_wheels(kind) or _wrong_sums(kind) or _wrong_suspensions(kind) or _wrong_invariants(kind)


def _wrong_wheels(kind: VehicleKind) -> str:
    for what in ("road_body", "road_displacement", "road_velocity", "tyre_deflection"):
        if wrong := _wrong_names(f"{what} of a wheel", [getattr(wheel, what) for wheel in kind.wheels]):
            return wrong
    names = {signal.name for signal in kind.signals}
    for wheel in kind.wheels:
        for what in ("road_displacement", "road_velocity", "tyre_deflection"):
            if getattr(wheel, what) not in names:
                return f"a wheel's {what} {getattr(wheel, what)!r} is none of its signals; add it to them"
    return ""


def _wrong_loads(kind: VehicleKind) -> str:
    for load in kind.loads:
        if load.name not in LOADS:
            return f"a load is {quoted(load)}; give BodyLoad(name, joint), with a name out of {first_few(LOADS)}"
    return _wrong_names("load", [load.name for load in kind.loads])


def _wrong_sums(kind: VehicleKind) -> str:
    names = {signal.name for signal in (*kind.signals, *kind.on_demand)}
    for name, parts in kind.combined.items():
        if name not in names:
            return f"combined {quoted(name)} is none of its signals; add it to them"
        if not parts or not all(is_finite(factor) and factor for factor in parts.values()):
            return f"combined {name!r} is {quoted(parts)}; give {{other signal: factor}}, finite factors that are not 0"
    return ""


def _wrong_suspensions(kind: VehicleKind) -> str:
    if kind.suspended is None:
        return ""
    forces = [suspension.force for suspension in kind.suspended if suspension.force != ""]
    for what, names in {
        "deflection": [suspension.deflection for suspension in kind.suspended],
        "tendon": [suspension.tendon for suspension in kind.suspended],
        "force": forces,
    }.items():
        if wrong := _wrong_names(f"{what} of a suspension", names):
            return wrong
    signals, parameters = {signal.name for signal in kind.signals}, {parameter.name for parameter in kind.parameters}
    for suspension in kind.suspended:
        for what, name in {"stiffness": suspension.stiffness, "damping": suspension.damping}.items():
            if name != "" and name not in parameters:
                return f"a suspension's {what} {quoted(name)} is none of its parameters; add it to them, or leave it out"
        if suspension.deflection not in signals:
            return f"a suspension's deflection {suspension.deflection!r} is none of its signals; add it to them"
    return ""


def _wrong_invariants(kind: VehicleKind) -> str:
    names = {signal.name for signal in kind.signals}
    for part in kind.invariants:
        if not part.name.isprintable() or not 0 < len(part.name) <= LONGEST:
            return f"an invariant is called {quoted(part.name)}; give a text on one line, at most {LONGEST} characters"
        if not part.signals or not names.issuperset(part.signals):
            return f"invariant {part.name!r} is of {quoted(part.signals)}; give a tuple of the kind's signals"
    return ""


def wrong_linear_model(model: Any, kind: VehicleKind) -> str:
    """Checks a linear model against its kind."""
    if not isinstance(model, LinearModel):
        return _of_type(model, "a LinearModel")
    for what in ("states", "inputs", "disturbances", "outputs"):
        if not getattr(model, what):
            return f"a model without {what}; give at least one"
    for name in ("A", "B", "Bw", "C", "D", "Br", "Cr", "Bl", "Dl"):
        for row, column in np.argwhere(np.abs(getattr(model, name)) > LARGEST)[:1]:
            return (
                f"{name}[{row}, {column}] = {getattr(model, name)[row, column]:g}, larger than any vehicle's; at most {LARGEST:g}"
            )

    if model.tyres_damp:
        return "Bt or Dw, of tyres that damp, which only the shipped kinds have in MuJoCo; leave them out"
    for suspension in kind.suspended or ():
        if suspension.force and suspension.force not in model.inputs:
            return f"no input {suspension.force!r}, a suspension's force; add it, or leave it out of the suspension"
    roads = tuple(wheel.road_velocity for wheel in kind.wheels)
    if tuple(model.disturbances) != roads:
        given, wanted = first_few(model.disturbances), first_few(roads)
        return f"the disturbances {given}; its wheels' road velocities, in their order, are {wanted}"
    if model.loads != tuple(load.name for load in kind.loads):
        own = first_few([load.name for load in kind.loads])
        return f"the loads {first_few(model.loads) or 'none'}; the kind's, in their order, are {own or 'none'}"
    driven = {*roads, *(wheel.road_displacement for wheel in kind.wheels)}
    own = [signal.name for signal in (*kind.signals, *kind.on_demand) if signal.name not in driven]
    for name in own:
        if name not in model.outputs:
            return f"no output {name!r}, which is one of the kind's signals; add it, or take it out of them"
    for name in model.outputs:
        if name not in own:
            return f"an output {name!r}, which is none of the kind's signals but the road's; add it to them"
    for what, names, own_part, others in (
        ("state", model.states, model.C, (model.D, model.Cr)),
        ("input", model.inputs, model.D, (model.C, model.Cr)),
    ):
        for i, name in enumerate(names):
            if name not in model.outputs:
                return f"the {what} {name!r}, which is none of its outputs; add it to them, it can then be measured"
            if name in kind.unnamed:
                return f"the {what} {name!r}, a signal on demand; every vehicle has its states and inputs: add it to signals"
            row, unit = model.outputs.index(name), np.eye(len(names))[i]
            if not np.array_equal(own_part[row], unit) or any(other[row].any() for other in others):
                return f"an output {name!r} that is not the {what} of that name; mend its rows of C, D and Cr"
    for wheel in kind.wheels:
        if wheel.tyre_deflection not in model.outputs:
            return f"no output {wheel.tyre_deflection!r}, a wheel's tyre; add it"
    return ""


def wrong_angles(angles: Any, kind: VehicleKind) -> str:
    """Checks the sums of signals that are the body's angles."""
    names = {signal.name for signal in kind.signals}
    for angle, parts in angles.items() if isinstance(angles, Mapping) else [("", None)]:
        sound = isinstance(parts, Mapping) and all(name in names and is_finite(share) for name, share in parts.items())
        if angle not in ("pitch_angle", "roll_angle") or not sound:
            return f"{quoted(angles)}; give {{'pitch_angle': {{signal: factor}}}}, 'roll_angle' likewise, of the kind's signals"
    return ""


def wrong_rest(squeezes: Any, kind: VehicleKind) -> str:
    """Checks the compressions of the tyres at rest."""
    if not isinstance(squeezes, Mapping):
        return _of_type(squeezes, "a mapping from each tyre's signal to metres")
    tyres = [wheel.tyre_deflection for wheel in kind.wheels]
    for tyre in tyres:
        if tyre not in squeezes:
            return f"nothing for {tyre!r}; give one number for each of {first_few(tyres)}"
    for tyre, squeeze in squeezes.items():
        if tyre not in tyres:
            return f"a number for {quoted(tyre)}, which is no wheel's tyre; give one for each of {first_few(tyres)}"
        if not is_finite(squeeze) or squeeze <= 0:
            return (
                f"{tyre} = {quoted(squeeze)}; give a number above 0 and at most {MOST_SQUEEZE} m: a tyre that carries nothing "
                "stands on no road"
            )
    return ""


def wrong_place(place: Any) -> str:
    """Checks the distance of a wheel behind the first, or to the left."""
    return "" if is_finite(place) and abs(place) <= LARGEST else f"{quoted(place)}; give a finite number of metres"


def wrong_size(size: Any) -> str:
    """Checks an invariant's frequency, or magnitude."""
    return "" if is_finite(size) and 0 < size <= LARGEST else f"{quoted(size)}; give a finite number above 0"


def wrong_distance(distance: Any) -> str:
    """Checks the distance of a wheel behind the first."""
    return wrong_place(distance) or (
        "" if distance >= 0 else f"{distance:g} m; the first wheel meets the road first, so give 0 or more"
    )


def _wrong_names(what: str, names: Iterable[Any]) -> str:
    seen: set[str] = set()
    for name in names:
        if not isinstance(name, str) or not name.isidentifier() or len(name) > LONGEST:
            return f"{what}: {quoted(name)} is no name; give letters, digits and '_', at most {LONGEST}, no digit first"
        if name in seen:
            return f"{what}: {name!r} is there twice; give each a name of its own"
        seen.add(name)
    return ""


def _of_type(value: Any, allowed: str) -> str:
    return f"a {type(value).__name__}, not {allowed}"


GIVE = "give the equations of the kind, as docs/how-to/your-own-kind.md shows them"


def read_kind(folder: Path, name: str) -> VehicleKind:
    """Runs `NAME.py` of a folder and returns its `KIND`.

    Raises:
        InputError: the file cannot be read, is no Python, fails, or has no such `KIND`. The kind's functions raise it, too, if
            they fail or their result is wrong.
    """
    path = folder / f"{name}.py"
    what, module = f"kind of vehicle {path}", ModuleType(f"roadproof_{name}")
    module.__file__ = str(path)
    vars(module)["print"] = _print
    text = read_text(path, "kind of vehicle", GIVE)
    code = compiled(what, path, text)
    _run(path, "the file", lambda: exec(code, vars(module)))
    kind = vars(module).get("KIND")
    if not isinstance(kind, VehicleKind):
        has = f"its KIND is a {type(kind).__name__}" if "KIND" in vars(module) else "it has no KIND"
        raise InputError(f"{what}: {has}; end it with KIND = VehicleKind(...), as docs/how-to/your-own-kind.md shows")
    if kind.name != name:
        raise InputError(f"{what}: its KIND is called {kind.name!r}; call it {name!r}, as its files are")
    if wrong := _run(path, "its KIND", lambda: wrong_parts(kind)):
        raise InputError(f"{what}: {wrong}")
    return _guarded_kind(path, replace(kind, folder=folder))


def _print(*values: object, **how: Any) -> None:
    """Prints to stderr, as the file of a kind does: stdout belongs to the command, and may be JSON."""
    print(*values, **{"file": sys.stderr, **how})


def _guarded_kind(path: Path, kind: VehicleKind) -> VehicleKind:
    """Returns the kind with functions that give correct results or raise InputError."""
    return replace(
        kind,
        wheels=tuple(
            _guarded_part(path, f"the wheel at {wheel.road_body!r}", wheel, behind=wrong_distance, lateral=wrong_place)
            for wheel in kind.wheels
        ),
        invariants=tuple(
            _guarded_part(path, f"the invariant {one.name!r}", one, omega=wrong_size, magnitude=wrong_size)
            for one in kind.invariants
        ),
        linear_model=_guarded(path, "linear_model", kind.linear_model, lambda model: wrong_linear_model(model, kind)),
        static_tyre_deflection=_guarded(
            path, "static_tyre_deflection", kind.static_tyre_deflection, lambda squeezes: wrong_rest(squeezes, kind)
        ),
        angles=_guarded(path, "angles", kind.angles, lambda angles: wrong_angles(angles, kind)),
        write_mjcf=_guarded(path, "write_mjcf", kind.write_mjcf, lambda nothing: ""),
        check_together=_guarded(path, "check_together", kind.check_together, lambda nothing: "", refuses=True),
    )


def _guarded_part(path: Path, what: str, part: Any, **wrong: Callable[[Any], str]) -> Any:
    """Returns a part of a kind with guarded functions; `wrong` has a check of the result for each, by name."""
    return replace(part, **{name: _guarded(path, f"{name} of {what}", getattr(part, name), said) for name, said in wrong.items()})


def _guarded(
    path: Path, name: str, function: Callable[..., Any], wrong: Callable[[Any], str], refuses: bool = False
) -> Callable[..., Any]:
    """Returns a function of the user's whose failures are reported as one line.

    Args:
        refuses: True if the function's purpose is an InputError about the parameters.
    """

    @wraps(function)
    def call(*arguments: Any) -> Any:
        *others, parameters = arguments
        result = _run(path, name, lambda: function(*others, dict(parameters)), refuses)
        if said := _run(path, name, lambda: wrong(result)):  # what it gives may have code of theirs as well
            raise InputError(f"kind of vehicle {path}: {name} gives {said}")
        return result

    return call


def _run(path: Path, name: str, code: Callable[[], Any], refuses: bool = False) -> Any:
    """Runs code of a kind; see `run_own`."""
    return run_own(f"kind of vehicle {path}", path, name, code, refuses)
