"""The kinds of vehicle that there are, by name: those that ship, and those that lie beside a vehicle file."""

import importlib
from pathlib import Path

from models.common.errors import InputError, listing
from models.kind import HERE, VehicleKind
from models.own_kind import read_kind


def kinds(folder: Path = HERE) -> list[str]:
    """The kinds of vehicle in a folder: those with equations and an MJCF. By default, those that ship."""
    return sorted(path.stem for path in folder.glob("*.xml") if path.with_suffix(".py").exists())


def shipped() -> list[str]:
    """The vehicles that ship: a file of every kind, and some more."""
    return sorted(path.stem for path in HERE.glob("*.toml"))


def kind(name: str, folder: Path | None = None) -> VehicleKind:
    """The kind of vehicle of that name: one that ships, or one whose `.py` and `.xml` lie in a folder of the user's.

    Raises:
        InputError: there is none, or it is one of the user's own that does not work.
    """
    if name in kinds():
        return importlib.import_module(f"models.{name}").KIND
    own = kinds(folder) if folder else []
    if folder is None or name not in own:
        beside = f", or beside the vehicle file: {name}.py and {name}.xml" if folder else ""
        raise InputError(f"unknown vehicle type {name!r}; known: {listing([*kinds(), *own])}{beside}")
    return read_kind(folder, name)
