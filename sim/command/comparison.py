"""Functions that commands for the simulation of controllers share: choice of controllers, warnings and logs."""

import argparse
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from models.common.arrays import Array
from models.common.command import complain
from models.common.errors import InputError
from models.common.extensions import FEATURES, RECORDINGS
from models.common.printed import Whole, pasted_path, show
from models.roads.road import Road
from models.vehicle.vehicle import Vehicle
from sim.drive.response import Response
from sim.runs.run import Run, run_controllers
from synth.controller.controller import AnyController, Controller
from synth.controller.loop_of import loop_of


def controllers_of(
    vehicle: Vehicle, names: Sequence[str], design: Callable[[str], Controller], exported: Path | None = None
) -> list[AnyController]:
    """Returns the controllers with the names in `names`, without executing any Python law.

    A controller that cannot be designed is omitted, and a warning is printed.

    Args:
        vehicle: vehicle to which the controllers belong.
        names: names of the controllers.
        design: function that designs a linear controller, see `runnable`.
        exported: folder with exported code that replaces one of the controllers; None without exported code.

    Raises:
        InputError: no controller can be designed, the file of a law cannot be read, or the exported code does not match.
    """
    drivers: list[AnyController] = []
    errors: dict[str, InputError] = {}
    for name in names:
        show(f"controller {name}")
        try:
            drivers.append(vehicle.driver(name, design))
        except InputError as error:
            if name not in vehicle.linear_names or len(names) == 1:
                raise
            errors[name] = error
    show("")
    if not drivers:
        raise next(iter(errors.values()))
    for name, error in errors.items():
        complain(f"controller {name!r} is not simulated: {str(error).removeprefix(f'controller {name!r}: ')}")
    if exported is None:
        return drivers
    export = FEATURES.load("exported code")
    from synth.vehicle.designer import driver_of

    return export.as_exported(export.read_folder(exported, driver_of), vehicle, drivers)


def runnable(vehicle: Vehicle, design: Callable[[str], Controller], timestep: float) -> Callable[[str], Controller]:
    """Returns a function that designs a controller by name.

    The returned function raises InputError if the controller cannot run at its sample period.
    """

    def designed(name: str) -> Controller:
        controller = design(name)
        _ = loop_of(vehicle, controller, timestep)
        return controller

    return designed


def left_out_object(names: Iterable[str], driven: Iterable[str]) -> dict[str, list[str]]:
    """Returns a JSON object that lists the requested controllers that could not be simulated; empty if all were simulated."""
    left = sorted({*names} - {*driven})
    return {"left_out": left} if left else {}


def warn_invalid_certificates(controllers: Iterable[AnyController]) -> None:
    """Prints a warning to stderr for each controller with an invalid certificate or missed goals.

    The command still simulates the controllers with a warning.
    """
    for one in controllers:
        if one.false_claims:
            complain(
                f"the certificate of controller {one.name!r} in the vehicle file does not hold ({_first(one.false_claims)}); "
                "the gain is used nevertheless; roadproof synth --check explains this"
            )
        if missed := [promise.text for promise in one.specifications if not promise.holds]:
            complain(
                f"controller {one.name!r} does not meet its goals in the vehicle file ({_first(missed)}); it is "
                "used nevertheless; roadproof synth explains this"
            )


def _first(claims: Sequence[str]) -> str:
    """Returns a text with the first of several claims that do not hold, and the number of further claims that do not hold."""
    return f"{claims[0]}, and {len(claims) - 1} more" if len(claims) > 1 else claims[0]


LOGS = "logs for Rerun and for Foxglove or Lichtblick, which import the .layout.json"


def record_command_runs(
    options: argparse.Namespace,
    vehicle: Vehicle,
    controllers: Sequence[str],
    runs: Callable[[], Mapping[str, Run]],
    result: Callable[[], Mapping[str, Any]],
    measured: Response | None = None,
) -> dict[str, str | None]:
    """Records the runs of a command with `record_runs`.

    Args:
        options: options from the command's parser, including `--logs`.
        vehicle: vehicle of the runs.
        controllers: names of the controllers that were simulated.
        runs: function that returns the runs to record, by their names in the log; called only if logs are written.
        result: function that returns the result of the command, as for `--json`; called only if logs are written.
        measured: signals of a measured log during the time of the runs; None without a measured log.

    Returns:
        Paths of the recorded files by type. All paths of files are None with `--no-logs`.
    """
    nothing: dict[str, str | None] = dict.fromkeys(("mcap", *RECORDINGS))
    if options.logs is None:
        return nothing
    from sim.recording.run_records import record_runs

    return {**nothing, **record_runs(options.logs, options.command_line, vehicle, controllers, runs(), result(), measured)}


def write_histories(
    options: argparse.Namespace, runs: Sequence[Run], where: str, measured: Response | None = None
) -> dict[str, Path | None]:
    """Writes the files of `--picture` and `--csv`; returns their paths by option name.

    Args:
        options: values of the options from the command's parser.
        runs: runs to draw and to write.
        where: description of the road, which follows the word "over" in the title of the picture.
        measured: signals of a measured log during the time of the runs, which the picture also shows; None without a measured
            log.
    """
    outputs: dict[str, Path | None] = {}
    if options.picture is not None:
        figure = FEATURES.load("time histories").history_figure(runs, where, measured)
        outputs["picture"] = options.picture if figure is not None else None
        if figure is not None:
            FEATURES.load("pictures").write_picture(figure, options.picture)
    if options.csv is not None:
        FEATURES.load("signals as CSV").write_runs(options.csv, runs)
        outputs["csv"] = options.csv
    return outputs


def log_lines(logs: Sequence[Mapping[str, str | None]], brief: bool = False, heading: bool = True) -> list[str]:
    """Returns the printed lines that list the recorded files and explain how to open them; empty if nothing was recorded.

    Args:
        logs: paths of the recorded files by type of file, one mapping for each vehicle. For several vehicles, the function
            returns a single line with the folder.
        brief: True if the command prints only short results; in this case, no lines are returned.
        heading: True to print an empty line and a heading above the paths of the files.
    """
    paths = [{name: Path(path) for name, path in one.items() if path} for one in logs]
    if brief or not any(paths):
        return []
    if len(paths) > 1:
        return [Whole(f"  a log for each vehicle: {pasted_path(paths[0]['mcap'].parent)}")]
    shown = [Whole(f"  rerun {pasted_path(paths[0]['rerun'])}")] if "rerun" in paths[0] else []
    return [*(["", LOGS] if heading else []), *shown, Whole(f"  {pasted_path(paths[0]['mcap'])}")]


def run_named(
    vehicle: Vehicle,
    names: Sequence[str],
    design: Callable[[str], Controller],
    road: Road,
    time: Array,
    exported: Path | None = None,
) -> list[Run]:
    """Simulates the controllers `names` over a road; returns the runs in the order of these names.

    Controllers that cannot be designed are omitted. Warnings about controllers are printed before the runs start. For the
    arguments and errors, see `controllers_of` and `run_controllers`.
    """
    controllers = controllers_of(vehicle, names, runnable(vehicle, design, float(time[1])), exported)
    warn_invalid_certificates(controllers)
    return run_controllers(vehicle, controllers, road, time)
