"""The common part of `sim.bump` and `sim.drive`: simulates controllers over one road, and compares the runs with linear
analysis.
"""

from argparse import Namespace
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

from models.common.arrays import Array
from models.common.command import chosen_of, complain, print_json, print_remarks
from models.common.errors import InputError
from models.common.extensions import FEATURES
from models.common.printed import FEW, say
from models.document.document import Document
from models.document.outputs import check_outputs, output_paths, written_lines
from models.document.text import text_lines
from models.roads.road import Road
from models.vehicle.names import named_files, run_without, without_copies
from models.vehicle.vehicle import Vehicle, read_vehicle
from sim.command import comparison
from sim.command.driven import VehicleRuns
from sim.command.road_options import gaps, left_out_lines, with_start
from sim.runs.run import passive_beside, run_controllers, sample_times
from sim.studies.ride.scores import scores_of_runs, scores_record
from synth.vehicle.designer import Designer


def drive(
    options: Namespace, road_of: Callable[[Vehicle, Namespace, Array], Road], where: Callable[[Any], str], rides: bool = False
) -> int:
    """Runs the command; returns its exit code.

    Args:
        options: options from the command's parser.
        road_of: function that returns the requested road; its arguments are a vehicle, the options and the sample times [s].
        where: function that returns a text that describes the road.
        rides: True to measure the ride and, if the road is a step, the step response.

    Raises:
        InputError: an option, a vehicle file, the road or the logs folder is invalid.
    """
    vehicles = read_vehicles(options)
    known = {title: vehicle.controller_names for title, vehicle in vehicles.items()}
    usual = without_copies(dict.fromkeys(name for some in known.values() for name in some))
    names = chosen_of(known, options.controller, usual)
    _check_variants(options, vehicles)
    times = {title: sample_times(vehicle, options.duration, options.timestep) for title, vehicle in vehicles.items()}
    roads = {title: print_remarks(road_of(vehicle, options, times[title])) for title, vehicle in vehicles.items()}
    time, road = next(iter(times.values())), next(iter(roads.values()))
    if rides:
        FEATURES.load("step response").check_band(road, options.band, "band" in options.given)
        for remark in gaps(road, options.duration):
            complain(remark)
    viewers = FEATURES.load("viewers") if options.open or options.serve else None
    if viewers is not None:
        viewers.check_view(options)
    log = None
    if options.beside_column or any(name.startswith("beside") for name in options.given):
        log = FEATURES.load("comparison with a measured log").requested_log(options, vehicles.values())
    texts = (getattr(options, "road", None), *getattr(options, "loads", ()))  # texts of options that `sim.drive` accepts
    files = [*(file for vehicle in vehicles.values() for file in vehicle.files), *named_files(texts)]
    files += [options.beside] if log else []
    check_outputs({"picture": options.picture, "csv": options.csv, "logs": options.logs}, files, options.json)

    driven = [
        _drive_vehicle(options, vehicle, title, names[title], roads[title], times[title]) for title, vehicle in vehicles.items()
    ]
    runs = [run for each in driven for run in each.runs]
    shown = [run for each in driven for run in each.named_runs]
    measured, beside = None, {}
    if log is not None:
        measured = print_remarks(
            FEATURES.load("comparison with a measured log").compare_log(
                log, runs, options.beside_start, options.beside_remove_offset
            )
        )
        fits, beside = iter(measured.fits), {"beside": measured.record}
        driven = [replace(each, fits=[next(fits) for _ in each.runs]) for each in driven]
    samples, start, words, step, response = (0, None), 0.0, "over the whole run", {}, Document("")
    if rides:
        run_metrics = FEATURES.load("ride of a run")
        step_response = FEATURES.load("step response")
        pairs = [(run.vehicle, run.controller) for run in runs]
        samples = run_metrics.measured_samples(pairs, road, options.duration, options.timestep, options.settle)
        start, words = float(time[samples[0]]), run_metrics.measured_words(time, samples)
        words += run_metrics.end_words(road, options.duration)
        driven = [replace(each, metrics=[run_metrics.measure_run(run, *samples) for run in each.runs]) for each in driven]
        if road.spectrum and options.settle is None:
            words += run_metrics.start_reason(pairs, start, options.duration)
        step = {"step": None}
        if step_response.step_of(road):
            steps = [step_response.measure_step(run, options.band) for run in runs]
            objects = [
                {"controller": run.controller.name, "signals": {name: step_response.RECORD(one) for name, one in each.items()}}
                for run, each in zip(runs, steps, strict=True)
            ]
            step, response = {"step": {"band": options.band, "runs": objects}}, step_response.describe(shown, steps, options.band)
    unstable = [run.controller.name for run in shown if run.prediction.radius > 1]
    end = float(time[-1 if samples[1] is None else samples[1] - 1])
    logs, aligned = [], None if measured is None else measured.response

    @cache
    def result(title: str) -> dict[str, Any]:
        each = next(one for one in driven if one.title == title)
        return _result(options, each, (start, None if samples[1] is None else end))

    for each in driven:
        controllers = list(dict.fromkeys(run.controller.name for run in each.runs))
        of_log = partial(lambda title: result(title) | beside, each.title)
        logs.append(comparison.record_command_runs(options, each.vehicle, controllers, each.logged, of_log, aligned))
    outputs = comparison.write_histories(options, shown, where(road), aligned)
    scores = [
        one for each in driven for one in scores_of_runs(each.runs, each.passive, samples, each.metrics, each.without, each.title)
    ]
    if options.json:
        results = [result(each.title) for each in driven]
        whole = {**results[0], "runs": [run for one in results for run in one["runs"]], **beside}
        if left := sorted({name for one in results for name in one.get("left_out", ())}):
            whole["left_out"] = left
        paths = logs[0] if len(logs) == 1 else {each.title: one for each, one in zip(driven, logs, strict=True)}
        last = {"compared": scores_record(scores), "unstable": unstable, **output_paths(outputs), "logs": paths}
        print_json(whole | step | last)
    else:
        from sim.command.driven_lines import driven_lines

        below = ["", *text_lines(measured.describe([run.controller.name for run in shown]), "normal")] if measured else []
        below += [*written_lines(outputs), *comparison.log_lines(logs, options.brief, len(shown) <= FEW and not options.verbose)]
        omitted = dict.fromkeys(name for some in known.values() for name in some if name not in usual)
        below += left_out_lines([*omitted] if not options.controller else [])
        lines = driven_lines(options, driven, where(road), scores, words, response, below)
        if unstable and not options.allow_unstable:
            lines += [f"exit code 1, because a closed loop is unstable ({', '.join(unstable)}); --allow-unstable permits this"]
        say(lines)
    if viewers is not None:
        for one in logs:
            viewers.view(options, one)
    done = all({*each.names} == {run.controller.name for run in each.implemented_runs} for each in driven)
    return 0 if done and all(run.passed for run in runs) and (options.allow_unstable or not unstable) else 1


def read_vehicles(options: Namespace) -> dict[str, Vehicle]:
    """Returns the vehicles that `--vehicle` selects, by title.

    If the command has a single vehicle, its title is empty. For several vehicles, the title of each vehicle is its file name,
    or its path if two file names are equal.

    Raises:
        InputError: a vehicle file cannot be read, or the user gives it twice.
    """
    given = options.vehicles
    vehicles = [with_start(print_remarks(read_vehicle(file)), vars(options).get("start", ())) for file in given]
    if len(given) == 1:
        return {"": vehicles[0]}
    stems = [Path(file).stem for file in given]
    titles = stems if len({*stems}) == len(stems) else list(given)
    if len({*titles}) < len(titles):
        twice = next(title for title in titles if titles.count(title) > 1)
        raise InputError(f"--vehicle {twice} is given twice; give each vehicle once")
    return dict(zip(titles, vehicles, strict=True))


def _check_variants(options: Namespace, vehicles: Mapping[str, Vehicle]) -> None:
    for part in options.without:
        if options.without.count(part) > 1:
            raise InputError(f"--without {part} is given twice; give each part once")
        if all(vehicle.without(part) is vehicle for vehicle in vehicles.values()):
            raise InputError(
                f"--without {part}: no vehicle file gives this part in [limits], [implementation] or [actuators]; "
                f"omit --without {part}"
            )
    if options.exported is not None and (len(vehicles) > 1 or options.without):
        raise InputError(
            "--as simulates exported code, which needs one vehicle with its whole implementation; omit --without, and "
            "give only one --vehicle"
        )
    if len(vehicles) > 1 and (options.open or options.serve):
        raise InputError(
            "--open and --serve show the recording of one vehicle, but several vehicles are given; give only one --vehicle"
        )


def _drive_vehicle(options: Namespace, vehicle: Vehicle, title: str, names: list[str], road: Road, time: Array) -> VehicleRuns:
    """Simulates the controllers of a vehicle file with the whole vehicle, then again without each part that `--without` lists."""
    design = Designer(vehicle, search=False).design
    runs = list(comparison.run_named(vehicle, names, design, road, time, options.exported))
    drivers, parts = {run.controller.name: run.controller for run in runs}, [""] * len(runs)
    for part in options.without:
        own, some = vehicle.without(part), run_without(drivers, part)
        if own is not vehicle and some:
            runs += run_controllers(own, [drivers[name] for name in some], road, time)
            parts += [part] * len(some)
    return VehicleRuns(vehicle, title, names, runs, parts, passive_beside(runs[: parts.count("")], design))


def _result(options: Namespace, each: VehicleRuns, measured: tuple[float, float | None]) -> dict[str, Any]:
    """Returns the result for one vehicle, as its log and the output of `--json` contain it.

    Args:
        measured: first and last time of the ride measurement [s]; if the last time is None, the measurement ends with the run.
    """
    road, time = each.runs[0].road, each.runs[0].prediction.time
    result: dict[str, Any] = {"runs": each.objects, "road": road.describe(), "timestep": options.timestep}
    if each.metrics:
        from sim.studies.ride.metrics import DEFINITIONS

        ride = FEATURES.load("ride of a run")
        rows, (start, end) = zip(each.objects, each.runs, each.metrics, strict=True), measured
        result |= {
            "runs": [one | ride.record(run, of_run) for one, run, of_run in rows],
            "measured_from": start,
            "road_ends": ride.points_end(road, float(time[-1])),
            **({} if end is None else {"measured_until": end}),
            "definitions": DEFINITIONS,
            "iri": ride.roughness(ride.driven_roughness(each.vehicle, road, time)),
        }
    return result | comparison.left_out_object(each.names, [run.controller.name for run in each.implemented_runs])
