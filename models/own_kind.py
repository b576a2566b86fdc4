"""A kind of vehicle of the user's own: its Python is run, and whatever is wrong with it, or with what it gives, is one line."""

from collections.abc import Callable
from dataclasses import replace
from functools import wraps
from pathlib import Path
from types import ModuleType
from typing import Any

from models.common.errors import InputError
from models.common.read_file import TEXT, read_text
from models.kind import VehicleKind
from models.own.code import compiled, run_own
from models.sound_kind import wrong_angles, wrong_distance, wrong_linear_model, wrong_parts, wrong_place, wrong_rest, wrong_size

GIVE = "give the equations of the kind, as models/README.md shows them"


def read_kind(folder: Path, name: str) -> VehicleKind:
    """Runs `NAME.py` of a folder and takes its `KIND`.

    Raises:
        InputError: it cannot be read, is no Python, fails, or has no such `KIND`; and so do the kind's functions where they fail,
            or give something else than they should.
    """
    path = folder / f"{name}.py"
    what, module = f"kind of vehicle {path}", ModuleType(f"roadproof_{name}")
    module.__file__ = str(path)
    text = read_text(path, "kind of vehicle", TEXT, GIVE)
    code = compiled(what, path, text)
    _run(path, "the file", lambda: exec(code, vars(module)))
    found = vars(module).get("KIND")
    if not isinstance(found, VehicleKind):
        has = f"its KIND is a {type(found).__name__}" if "KIND" in vars(module) else "it has no KIND"
        raise InputError(f"{what}: {has}; end it with KIND = VehicleKind(...), as models/README.md shows")
    if found.name != name:
        raise InputError(f"{what}: its KIND is called {found.name!r}; call it {name!r}, as its files are")
    if wrong := _run(path, "its KIND", lambda: wrong_parts(found)):
        raise InputError(f"{what}: {wrong}")
    return _guarded_kind(path, replace(found, folder=folder))


def _guarded_kind(path: Path, kind: VehicleKind) -> VehicleKind:
    """The same kind, whose functions give what they should or raise InputError."""
    for name in ("linear_model", "static_tyre_deflection", "write_mjcf", "check_together", "angles"):
        if not callable(getattr(kind, name)):
            raise InputError(f"kind of vehicle {path}: its {name} is no function; give one of the parameters")
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
    """A part of a kind, whose functions, by name with what is wrong with their results, are guarded."""
    return replace(part, **{name: _guarded(path, f"{name} of {what}", getattr(part, name), said) for name, said in wrong.items()})


def _guarded(
    path: Path, name: str, function: Callable[..., Any], wrong: Callable[[Any], str], refuses: bool = False
) -> Callable[..., Any]:
    """A function of the user's, whose failures are ours to tell.

    Args:
        path: its file.
        name: what a message calls it.
        function: the function; its last argument are the parameters, and it gets a copy of its own.
        wrong: result -> what is wrong with it, or nothing.
        refuses: whether an InputError of its own is what it is there for: it speaks of the parameters.
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
