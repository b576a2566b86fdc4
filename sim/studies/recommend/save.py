"""The recommended controller as a section of a vehicle file, ready for export."""

from dataclasses import replace
from pathlib import Path

from models.common.errors import InputError
from models.common.files import whole_file
from models.common.toml_edit import section_lines
from models.vehicle.in_place import with_sections
from models.vehicle.vehicle import Vehicle, parse_vehicle
from sim.studies.recommend.recommend import Recommendation, Row
from sim.studies.recommend.report import road_words, verdict
from synth.command.save import controller_section
from synth.controller.controller import Controller

NAME = "best"


def free_name(vehicle: Vehicle) -> str:
    """Returns the name of the saved section: `best`, or with a number if the file has a controller of this name."""
    taken = vehicle.controllers
    return next(name for i in range(1, len(taken) + 2) if (name := NAME if i == 1 else f"{NAME}_{i}") not in taken)


def saved_text(path: Path, result: Recommendation) -> str:
    """Returns the text of the vehicle file with the recommended controller.

    Raises:
        InputError: there is no such controller, or a file cannot have it.
    """
    row, vehicle = result.best, result.task.vehicle
    if row is None:
        raise InputError("--save has nothing to write: no controller is better than the passive vehicle within the limits")
    text = with_sections(vehicle.text_for(path), [*_comments(result, row), *_section(vehicle, row, free_name(vehicle))])
    parse_vehicle(text, folder=path.parent)  # what is written can be read
    return text


def save(path: Path, result: Recommendation) -> None:
    """Writes the vehicle file with the recommended controller.

    Raises:
        InputError: an error of `saved_text`, or the file cannot be written.
    """
    text = saved_text(path, result)
    with whole_file(path, "save") as beside:
        beside.write_text(text, encoding="utf-8", newline="\n")


def _comments(result: Recommendation, row: Row) -> list[str]:
    usage, task = row.rating.usage, result.task
    numbers = f"travel {100 * usage.stroke:.0f} % of the stroke"
    if row.candidate.controller.linear is True and not row.candidate.vehicle.dampers:
        numbers += f", force {100 * usage.force:.0f} % of its limit, disk margin {usage.disk:.2f}"
    return [
        f"# roadproof recommend, {road_words(task)}, within {task.within.text}",
        f"# {verdict(result).text}",
        f"# {numbers}",
    ]


def _section(vehicle: Vehicle, row: Row, name: str) -> list[str]:
    one = row.candidate.controller
    if not isinstance(one, Controller):
        source = getattr(one, "law", None)
        if one.user_code or source is None or not hasattr(source, "record"):
            raise InputError(f"--save: the best controller is {row.candidate.name}, which the file has already; omit --save")
        return section_lines(("controllers", name), source.record)
    if one.preview is not None:
        raise InputError(f"--save: the best controller is {row.candidate.name}, and a file contains no preview; omit --save")
    return controller_section(vehicle, replace(one, name=name), name)
