"""A kind of vehicle of the user's own: its Python is run, and whatever that stumbles over is said in one line."""

import traceback
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import wraps
from pathlib import Path
from types import ModuleType
from typing import Any

from models.errors import InputError
from models.kind import VehicleKind
from models.linear_model import LinearModel
from models.read_file import TEXT, read_text

GIVE = "give the equations of the kind, as README.md shows them"


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
    try:
        exec(compile(text, str(path), "exec"), vars(module))
    except SyntaxError as error:
        raise InputError(f"{what}: is no Python ({error.msg}, line {error.lineno}); mend that") from error
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        raise _failed(path, "fails", error) from error
    found = vars(module).get("KIND")
    if not isinstance(found, VehicleKind):
        has = f"its KIND is a {type(found).__name__}" if "KIND" in vars(module) else "it has no KIND"
        raise InputError(f"{what}: {has}; end it with KIND = VehicleKind(...), as README.md shows")
    if found.name != name:
        raise InputError(f"{what}: its KIND is called {found.name!r}; call it {name!r}, as its files are")
    functions: dict[str, Any] = {
        "linear_model": LinearModel,
        "static_tyre_deflection": Mapping,
        "write_mjcf": object,
        "check_together": object,
    }
    guarded = {key: _guarded(path, key, getattr(found, key), kind) for key, kind in functions.items()}
    return replace(found, folder=folder, **guarded)


def _guarded(path: Path, name: str, function: Callable[..., Any], kind: type) -> Callable[..., Any]:
    """A function of the user's, whose failures are ours to tell."""

    @wraps(function)
    def call(*arguments: Any) -> Any:
        try:
            result = function(*arguments)
        except InputError:
            raise
        except (Exception, SystemExit) as error:
            raise _failed(path, f"{name} fails", error) from error
        if not isinstance(result, kind):
            raise InputError(f"kind of vehicle {path}: {name} gives a {type(result).__name__}, not a {kind.__name__}; mend that")
        return result

    return call


def _failed(path: Path, what: str, error: BaseException) -> InputError:
    """What went wrong in the user's code, with its last line there."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    where = f", line {lines[-1]}" if lines else ""
    said = " ".join(str(error).split())
    return InputError(f"kind of vehicle {path}: {what} ({type(error).__name__}{f': {said}' if said else ''}{where}); mend that")
