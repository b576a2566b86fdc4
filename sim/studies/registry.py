"""All studies: name -> module and class, in the order of their sections on a page. Commands know them from this table."""

from functools import cache
from importlib.util import find_spec
from typing import Any

from models.common.lazy import named
from sim.studies.study import Study

STUDIES = {
    "sweep": "sim.studies.frequency.command:SweepStudy",
    "margins": "sim.studies.stability.command:MarginsStudy",
    "envelope": "sim.studies.validity.command:EnvelopeStudy",
    "gallery": "sim.studies.gallery.command:GalleryStudy",
}


@cache
def study(name: str) -> Study[Any]:
    """Returns the study of a name."""
    return named(STUDIES[name])()


def command_of(name: str) -> str:
    """Returns the command of a study, as after `python -m`: a module of its own, such as sim.margins, or `sim NAME`."""
    return f"sim.{name}" if find_spec(f"sim.{name}") else f"sim {name}"
