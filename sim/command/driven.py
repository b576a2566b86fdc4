"""A controller as it is driven: designed, given, or a law in Python, of which nothing is claimed."""

import unicodedata

from models.common.errors import InputError
from models.own.python_law import Programmed
from synth.controller import Controller
from synth.designer import Designer


def driven(designer: Designer, name: str) -> Controller | Programmed:
    """The controller of that name; the file of a law in Python is read, and not run.

    Args:
        designer: of the vehicle.
        name: of the controller.

    Raises:
        InputError: see `Designer.design`; or the file of a law in Python cannot be read.
        DesignError: see `Designer.design`.
    """
    entry = designer.vehicle.controllers.get(unicodedata.normalize("NFC", str(name)))
    if entry is None or entry.python is None:
        return designer.design(name)
    try:
        return Programmed(entry.name, entry.measured, entry.python, entry.python.source())
    except InputError as error:
        raise InputError(f"controller {entry.name!r}: {error}") from error
