"""Writes the recommended controller as a section of a vehicle file, from which it can be exported."""

from dataclasses import replace
from pathlib import Path

from models.common.errors import InputError
from models.common.files import whole_file
from models.common.toml_edit import section_lines
from models.vehicle.in_place import with_sections
from models.vehicle.vehicle import parse_vehicle
from sim.studies.recommend.result import SHARE, Recommendation, road_words, verdict
from synth.command.save import controller_section

NAME = "best"


def save(path: Path, result: Recommendation) -> str:
    """Writes the vehicle file with the recommended controller; returns the name of its section.

    A file cannot contain a controller with preview. The next best controller is then written. The section is named `best`; a
    number is added if the file already has a controller of this name.

    Raises:
        InputError: no controller can be written to a file, or the file cannot be written.
    """
    row, vehicle, taken = result.saved, result.task.vehicle, result.task.vehicle.controllers
    if row is None:
        raise InputError("--save has nothing to write: no controller is better than the passive vehicle within the limits")
    name = next(one for i in range(1, len(taken) + 2) if (one := NAME if i == 1 else f"{NAME}_{i}") not in taken)
    one, usage = row.candidate.controller, row.rating.usage
    used = f"# travel {SHARE.text(usage.stroke)} of the stroke"
    used += f", force {SHARE.text(usage.force)} of its limit, disk margin {usage.disk:g}" * row.candidate.pushes
    lines = [
        f"# roadproof recommend, {road_words(result.task)}, within {result.task.within.text}",
        f"# {verdict(result, row).text}",
        used,
    ]
    if one.linear is True:
        lines += controller_section(vehicle, replace(one, name=name), name)
    else:
        lines += section_lines(("controllers", name), one.law.record)
    text = with_sections(vehicle.text_for(path), lines)
    parse_vehicle(text, folder=path.parent)  # checks that the written file can be read
    with whole_file(path, "save") as beside:
        beside.write_text(text, encoding="utf-8", newline="\n")
    return name
