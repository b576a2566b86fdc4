"""All studies: name -> module and class, purpose and main options; in the order of their sections on a page.

Commands and pages know studies from this table. A study without a purpose is a section of a page, and no command.
"""

from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from models.common.lazy import named

if TYPE_CHECKING:
    from sim.studies.study import Study

FREQUENCY, VALIDITY = "sim.studies.frequency.command", "sim.studies.validity.command"
STUDIES = {
    "designs": ("sim.report.designs:DesignsStudy", "", ""),
    "sweep": (f"{FREQUENCY}:SweepStudy", "measure frequency responses and the H-infinity norm", "--amplitude --picture"),
    "response": ("sim.report.agreement:ResponseStudy", "", ""),
    "agreement": ("sim.report.agreement:AgreementStudy", "", ""),
    "ends": (f"{VALIDITY}:EndsStudy", "", ""),
    "margins": ("sim.studies.stability.command:MarginsStudy", "find the gain, delay and sample-period margins", "--picture"),
    "envelope": (f"{VALIDITY}:EnvelopeStudy", "map the bumps over which linear analysis is valid", "--vary --picture --csv"),
    "ride": ("sim.studies.ride.over_roads:RideStudy", "", ""),
    "workshop": (f"{FREQUENCY}:WorkshopStudy", "", ""),
    "loads": ("sim.studies.ride.loads:LoadsStudy", "", ""),
    "exported": ("sim.report.exported:ExportedStudy", "", ""),
    "front": (f"{FREQUENCY}:FrontStudy", "", ""),
    "paper": ("sim.report.designs:PaperStudy", "", ""),
    "gallery": ("sim.studies.gallery.command:GalleryStudy", "compare with published results", "NAME"),
}


@cache
def study(name: str) -> "Study[Any]":
    """Returns the study of a name."""
    return named(STUDIES[name][0])(name)


def command_of(name: str) -> str:
    """Returns the command of a study, as after `python -m`: a module of its own, such as sim.margins, or `sim NAME`."""
    return f"sim.{name}" if find_spec(f"sim.{name}") else f"sim {name}"
