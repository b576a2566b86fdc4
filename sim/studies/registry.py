"""Studies by their names in `EXTENSIONS`: the object of each, and its command."""

from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from models.common.extensions import STUDIES

if TYPE_CHECKING:
    from sim.studies.study import Study


@cache
def study(name: str) -> "Study[Any]":
    """Returns the study of a name."""
    return STUDIES.load(name)(name)


def command_of(name: str) -> str:
    """Returns the command of a study, as after `python -m`: a module of its own, such as sim.margins, or `sim NAME`."""
    return f"sim.{name}" if find_spec(f"sim.{name}") else f"sim {name}"
