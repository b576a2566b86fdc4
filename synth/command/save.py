"""Saves designs as controllers of a vehicle file, each with its law and its certificate."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from models.common.errors import InputError, list_names
from models.common.files import whole_file
from models.common.toml_edit import section_lines
from models.document.outputs import CHECKED_BY
from models.vehicle.in_place import with_sections
from models.vehicle.vehicle import Vehicle, parse_vehicle
from synth.analysis.lower_bounds.lower_bound import SampledBound
from synth.analysis.record import VEHICLE, bound_record, to_record
from synth.controller.controller import SUFFIX, Controller, check_feedback_alone
from synth.controller.report import norm_record
from synth.controller.sampled_report import norm_or_failure
from synth.vehicle.certified_vehicle import vehicle_record


def check_save(path: Path, vehicle: Vehicle, names: Sequence[str]) -> None:
    """Before the controllers are designed, checks that controllers with the new names can be added to a vehicle file.

    Args:
        path: path of the vehicle file to be written.
        vehicle: vehicle of the controllers.
        names: names of the designed controllers, without the suffix `_designed`.

    Raises:
        InputError: there is no designed controller, a name is already used, or the vehicle file would be unreadable if saved at
            `path`.
    """
    if not names:
        raise InputError(
            "--save has nothing to write, because this run designs no controller; choose a controller whose gain or "
            "law is not yet in the vehicle file"
        )
    for name in names:
        if name + SUFFIX in vehicle.controllers:
            raise InputError(
                f"--save: {vehicle.source} already has a controller {name + SUFFIX!r}, which --save would add; rename or "
                "remove this controller"
            )
    with_sections(vehicle.text_for(path), [])


def save(
    path: Path,
    vehicle: Vehicle,
    controllers: Sequence[Controller],
    sampled_bounds: Mapping[str, SampledBound | None] | None = None,
) -> None:
    """Writes a vehicle file in which each designed law is a controller with the name NAME_designed. All other commands can read
    the written file.

    Controllers with a preview are not saved if there are also controllers without a preview.

    Args:
        path: path of the vehicle file to be written.
        vehicle: vehicle of the controllers.
        controllers: controllers of the vehicle, of which only the designed controllers are written.
        sampled_bounds: lower bounds for sampled-data loops, by name of the controller.

    Raises:
        InputError: there is no designed controller, a name is already used, all controllers have a preview, or the file cannot
            be written.
    """
    text = saved_text(path, vehicle, controllers, sampled_bounds)
    with whole_file(path, "save") as beside:
        beside.write_text(text, encoding="utf-8", newline="\n")


def saved_text(
    path: Path,
    vehicle: Vehicle,
    controllers: Sequence[Controller],
    sampled_bounds: Mapping[str, SampledBound | None] | None = None,
) -> str:
    """Returns the text that `save` writes; for arguments and errors, see `save`."""
    given = [controller for controller in controllers if controller.designed and controller.measured]
    designed = [controller for controller in given if controller.preview is None] or given
    for controller in designed:
        check_feedback_alone(controller, "a saved section")
    check_save(path, vehicle, [controller.name for controller in designed])
    text = vehicle.text_for(path)
    for controller in designed:
        text = with_sections(
            text, controller_section(vehicle, controller, controller.name + SUFFIX, (sampled_bounds or {}).get(controller.name))
        )
    parse_vehicle(text, folder=path.parent)  # this call raises an error if the written text cannot be read again
    return text


def left_out_lines(names: Sequence[str]) -> list[str]:
    """Returns a line that lists the controllers with a preview, because these controllers are not saved; empty if there are
    none.
    """
    return [f"  omitted: {list_names(names)}, because this file cannot contain a preview of the road"] if names else []


def controller_section(
    vehicle: Vehicle, controller: Controller, name: str, sampled_bound: SampledBound | None = None
) -> list[str]:
    """Returns the section of a controller with its law and certificate, as lines of a vehicle file.

    Args:
        vehicle: vehicle of the controller.
        controller: controller to be written.
        name: name of the section in the vehicle file.
        sampled_bound: lower bound for the sampled-data loop; None if no such bound is known.
    """
    own = vehicle.with_actuators_of(controller.name)
    norm, _ = norm_or_failure(own, controller)
    record = to_record(controller.certificate) | norm_record(norm) | bound_record(sampled_bound) | {VEHICLE: vehicle_record(own)}
    asked = vehicle.controllers.get(controller.name)
    goals = asked.goals.record if asked is not None and asked.goals is not None else {}
    if asked is not None and asked.errors is not None:
        goals |= {"tolerance": goals.get("tolerance", {}) | asked.errors.record}
    section = {
        **({"actuators": "force"} if asked is not None and asked.forced else {}),
        "measured": list(controller.measured),
        **controller.law.record,
        **goals,
        **controller.hardware.record,
    }
    path = ("controllers", name)
    return [*section_lines(path, section), "", *section_lines((*path, "certificate"), record, CHECKED_BY)]
