"""`python -m synth --front`: trade-off between two goals, as a table, a figure, CSV, JSON or controllers in a vehicle file."""

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace

from models.common.command import one_chosen, print_json
from models.common.errors import InputError
from models.common.files import together
from models.common.printed import Stages, say, title_lines
from models.document.outputs import check_outputs, output_paths, written_lines
from models.document.picture import write_picture
from models.document.text import screen_lines
from models.vehicle.vehicle import Vehicle
from synth.command.save import check_save, save
from synth.plant.numerics import DesignError
from synth.vehicle.trade_off.axes import axes_of
from synth.vehicle.trade_off.continuation import rays_of
from synth.vehicle.trade_off.front import DESIGNS, MARKED_POINTS, Front, entry_of, front
from synth.vehicle.trade_off.report import RECORD, describe, front_figure, write_csv

USUAL = "I"  # default controller; the trade-off is computed with the measurements of this controller
SHOWN_POINTS = 3  # number of trade-off points that the short table shows
SAVED_NAME = "point"  # part of a saved design's name before the number, as in I_point_17


def answer(vehicle: Vehicle, options: Namespace) -> int:
    """Runs the command. Returns the exit code.

    Raises:
        InputError: an axis is invalid, no trade-off can be computed for the controller, a point does not exist, or a file
            cannot be written.
    """
    axes = axes_of(vehicle, options.front)
    name = _name(vehicle, options.controller)
    entry_of(vehicle, name)
    outputs = {"picture": options.picture, "csv": options.csv}
    check_outputs({**outputs, "save": options.save}, vehicle.files, options.json)
    if options.point and not options.save:
        raise InputError(
            "--point chooses the designs that --save writes, but --save is missing; give a file with --save, or omit --point"
        )
    if options.save:
        check_save(options.save, vehicle, [f"{name}_{SAVED_NAME}_{i}" for i in options.point or (1,)])
    stage = Stages("designs", "the picture")
    progress = stage.counted("designs", rays_of(len(axes), DESIGNS), "designs")
    try:
        trade_off = front(vehicle, name, axes, others_of(vehicle), DESIGNS, progress)
        if not trade_off.points:
            raise DesignError(f"none of {trade_off.design_count} designs has all its claims proved; give other axes")
    except DesignError as error:
        stage.end()
        if options.json:
            print_json({"vehicle": vehicle.kind.name, "controller": name, "reason": str(error)})
        else:
            say([f"controller {name}", f"  NOT DESIGNED: {error}"])
        return 1
    numbers = _numbers(trade_off, options.point) if options.save else []
    stage("the picture")
    with together():
        if options.picture:
            write_picture(front_figure(trade_off), options.picture)
        if options.csv:
            write_csv(trade_off, options.csv)
        if options.save:
            chosen = [replace(trade_off.points[i - 1].controller, name=f"{name}_{SAVED_NAME}_{i}") for i in numbers]
            save(options.save, vehicle, chosen)
    stage.end()
    outputs["saved"] = options.save
    if options.json:
        print_json({"vehicle": vehicle.kind.name, **RECORD(trade_off), **output_paths(outputs)})
    else:
        title = title_lines(vehicle.kind.name, vehicle.source)
        document = replace(describe(trade_off, most=MARKED_POINTS if options.verbose else SHOWN_POINTS), title="")
        some = f"not every claim holds: {trade_off.unproved} designs without proof are omitted"
        verdict = some if trade_off.unproved else f"every claim holds for {len(trade_off.points)} designs"
        end = [*written_lines(outputs), "", verdict]
        say([*title, *screen_lines(document, options.verbose, [*title, *end]), *end])
    return 1 if trade_off.unproved else 0


def others_of(vehicle: Vehicle) -> list[str]:
    """Returns the names of the linear controllers that are shown together with a trade-off front.

    Controllers that are designed for goals are omitted, because the design of each controller takes seconds.
    """
    return [
        name
        for name in vehicle.linear_names
        if name not in vehicle.controllers or vehicle.controllers[name].goals is None or vehicle.controllers[name].law is not None
    ]


def _name(vehicle: Vehicle, given: Sequence[str] | None) -> str:
    """Returns the name of the requested controller, or of the default controller."""
    if given is None:
        return usual(vehicle)
    if len(given) > 1:
        raise InputError(
            f"--front uses the measurements of a single controller, but --controller names {len(given)} controllers; name "
            "only one"
        )
    return one_chosen(vehicle.controller_names, given[0])


def usual(vehicle: Vehicle) -> str:
    """Returns the name of the default controller for a front: controller I if the file contains it, otherwise the first
    controller.
    """
    return USUAL if USUAL in vehicle.controllers else next(iter(vehicle.controllers), "state")


def _numbers(trade_off: Front, given: Sequence[int] | None) -> list[int]:
    """Returns the numbers of those points on the trade-off front that are saved."""
    for i in given or ():
        if i > len(trade_off.points):
            raise InputError(
                f"--point {i}: the front has only {len(trade_off.points)} points; give a number from 1 to {len(trade_off.points)}"
            )
    return sorted({*given}) if given else list(range(1, len(trade_off.points) + 1))
