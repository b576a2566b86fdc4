"""The common part of `sim.bump` and `sim.drive`: controllers of vehicles over one road, in MuJoCo and in analysis."""

import json
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from models.common.arrays import Array
from models.common.command import chosen_of, complain
from models.common.errors import InputError
from models.common.printed import say, titled
from models.document.document import Document, Statement
from models.document.outputs import check_outputs, written, written_lines
from models.document.text import text_lines
from models.roads.road import Road
from models.vehicle.names import logged_variant, named_files, run_without, variant
from models.vehicle.vehicle import Vehicle, read_vehicle
from sim.command import comparison
from sim.command.road_options import end_lines, gaps, starts_later
from sim.response.response import Response
from sim.runs.report import FEW, half_step_object, run_object, shared, verdicts
from sim.runs.result import Run
from sim.runs.run import run_controllers, sample_times
from sim.studies.ride.standing import standing_lines, standings_object
from synth.controller.controller import Controller
from synth.vehicle.designer import Designer

if TYPE_CHECKING:
    from sim.studies.ride.run_metrics import RunMetrics
    from sim.studies.ride.step_response import SignalSteps


@dataclass(frozen=True, eq=False)
class Driven:
    """The runs of one vehicle file.

    Attributes:
        vehicle: vehicle of the file.
        title: title of the answer; empty if it is the only one.
        names: requested controllers.
        runs: runs of the implemented controllers, then of those without a part of the vehicle.
        without: omitted part for each run; empty as implemented.
        design: designs the vehicle's linear controllers.
        metrics: ride metrics of each run; empty if none are measured.
    """

    vehicle: Vehicle
    title: str
    names: Sequence[str]
    runs: Sequence[Run]
    without: Sequence[str]
    design: Callable[[str], Controller]
    metrics: "Sequence[RunMetrics]" = ()

    @property
    def built(self) -> list[Run]:
        """The runs of the implemented loops."""
        return [run for run, part in zip(self.runs, self.without, strict=True) if not part]

    @cached_property
    def shown(self) -> list[Run]:
        """The runs with the names that they have in the answer."""
        return [_named(run, f"{self.title}:{run.controller.name}{variant(part)}".removeprefix(":")) for run, part in self._pairs]

    @cached_property
    def passive(self) -> Response:
        """MuJoCo's response of the passive vehicle."""
        return comparison.passive_beside(self.built, self.design)

    def logged(self) -> dict[str, Run]:
        """Returns the runs by their names in a log."""
        return {f"{run.controller.name}{logged_variant(part)}": run for run, part in self._pairs}

    @property
    def objects(self) -> list[dict[str, Any]]:
        """The runs as JSON objects, with vehicle and part if there are several."""
        return [
            run_object(run)
            | {"half_step": half_step_object(run)}
            | ({"vehicle": self.title} if self.title else {})
            | ({"without": part} if part else {})
            for run, part in self._pairs
        ]

    @property
    def _pairs(self) -> list[tuple[Run, str]]:
        return list(zip(self.runs, self.without, strict=True))


def _named(run: Run, name: str) -> Run:
    if run.controller.name == name:
        return run
    controller: Any = run.controller  # each kind of driver is a dataclass with a name
    return replace(run, prediction=replace(run.prediction, controller=replace(controller, name=name)))


@dataclass(frozen=True, eq=False)
class Interval:
    """Samples between which the ride is measured.

    Attributes:
        samples: first measured sample, and the one after the last; None for the end of the runs.
        words: the interval in words.
        start, end: times of the first and last of these samples [s].
    """

    samples: tuple[int, int | None]
    words: str
    start: float
    end: float


def drive(
    options: Namespace, road_of: Callable[[Vehicle, Namespace, Array], Road], where: Callable[[Any], str], rides: bool = False
) -> int:
    """Runs the command; returns its exit code.

    Args:
        options: options from the command's parser.
        road_of: returns the requested road under a vehicle at its sample times [s].
        where: function that describes the road in words.
        rides: True to measure the ride, and the response to a step.

    Raises:
        InputError: bad options, vehicle file, road or logs folder.
    """
    vehicles = read_vehicles(options)
    names = chosen_of({title: vehicle.controller_names for title, vehicle in vehicles.items()}, options.controller)
    _check_variants(options, vehicles)
    times = {title: sample_times(vehicle, options.duration, options.timestep) for title, vehicle in vehicles.items()}
    roads = {title: road_of(vehicle, options, times[title]) for title, vehicle in vehicles.items()}
    time, road = next(iter(times.values())), next(iter(roads.values()))
    if rides:
        from sim.studies.ride.step_response import check_band

        check_band(road, options.band, "band" in options.given)
        for remark in gaps(road, options.duration):
            complain(remark)
    comparison.check_view(options)
    texts = (getattr(options, "road", None), *getattr(options, "loads", ()))  # of sim.drive
    files = [*(file for vehicle in vehicles.values() for file in vehicle.files), *named_files(texts)]
    check_outputs({"picture": options.picture, "csv": options.csv, "logs": options.logs}, files, options.json)

    driven = [_driven(options, vehicle, title, names[title], roads[title], times[title]) for title, vehicle in vehicles.items()]
    interval = None
    if rides:
        from sim.studies.ride.run_metrics import measure_run

        interval = _interval(options, [run for each in driven for run in each.runs], road, time)
        driven = [replace(each, metrics=[measure_run(run, *interval.samples) for run in each.runs]) for each in driven]
    runs = [run for each in driven for run in each.runs]
    shown = [run for each in driven for run in each.shown]
    results = [_result(options, each, interval) for each in driven]
    result = {**results[0], "runs": [run for one in results for run in one["runs"]]}
    if left := sorted({name for one in results for name in one.get("left_out", ())}):
        result["left_out"] = left
    logs = [
        comparison.recorded(
            options, each.vehicle, list(dict.fromkeys(run.controller.name for run in each.runs)), each.logged, one
        )
        for each, one in zip(driven, results, strict=True)
    ]
    steps = _steps(options, runs, road) if rides else []
    outputs = comparison.write_histories(options, shown, where(road))
    samples = interval.samples if interval is not None else (0, None)
    standings = [
        one
        for each in driven
        for one in comparison.standings_of(each.runs, each.passive, samples, each.metrics, each.without, each.title)
    ]
    if options.json:
        print(
            json.dumps(
                {
                    **result,
                    **({"step": _step_object(options, runs, steps)} if rides else {}),
                    "compared": standings_object(standings),
                    **written(outputs),
                    "logs": logs[0] if len(logs) == 1 else {each.title: one for each, one in zip(driven, logs, strict=True)},
                },
                allow_nan=False,
            )
        )
    else:
        kinds = " and ".join(dict.fromkeys(vehicle.kind.name for vehicle in vehicles.values()))
        on = f"a road: {where(road)}" if rides else where(road)
        sources = vehicles[""].source if "" in vehicles else ", ".join(options.vehicles)
        lines = titled(f"{kinds} over {on}; {options.duration:g} s at {options.timestep:g} s", sources)
        lines += _above(options, driven, interval, road)
        if steps and not options.brief:
            from sim.studies.ride.step_response import describe

            lines += ["", *text_lines(describe(shown, steps, options.band), "full" if options.verbose else "normal")]
        settled = ", when all have settled" if interval and road.spectrum and interval.start < options.duration / 2 else ""
        about = f"MuJoCo, {interval.words if interval else 'all of the run'}{settled}"
        if len(shown) > FEW and not (options.verbose or options.brief):
            about += "; -v: norms, expected ride, signals" if rides and road.spectrum else "; -v: norms, signals"
        lines += ["", *standing_lines(standings, about)]
        lines += [*written_lines(outputs), *comparison.log_lines(logs, options.brief, shown)]
        say([*lines, "", *text_lines(Document("", verdicts(shown)))])
    for one in logs:
        comparison.view(options, one)
    done = all({*each.names} == {run.controller.name for run in each.built} for each in driven)
    return 0 if done and all(run.passed for run in runs) else 1


def read_vehicles(options: Namespace) -> dict[str, Vehicle]:
    """Returns the vehicles of `--vehicle` by title: empty for one, else the name of the file, or its path if names are equal.

    Raises:
        InputError: a vehicle file, or one that is given twice.
    """
    given = options.vehicles
    vehicles = [read_vehicle(file) for file in given]
    if len(given) == 1:
        return {"": vehicles[0]}
    stems = [Path(file).stem for file in given]
    titles = stems if len({*stems}) == len(stems) else list(given)
    if len({*titles}) < len(titles):
        twice = next(title for title in titles if titles.count(title) > 1)
        raise InputError(f"--vehicle {twice} is given twice; give it once")
    return dict(zip(titles, vehicles, strict=True))


def _check_variants(options: Namespace, vehicles: Mapping[str, Vehicle]) -> None:
    for part in options.without:
        if options.without.count(part) > 1:
            raise InputError(f"--without {part} is given twice; give it once")
        if all(vehicle.without(part) is vehicle for vehicle in vehicles.values()):
            raise InputError(
                f"--without {part}: no vehicle file contains it in [limits], [implementation] or [actuators]; omit the option"
            )
    if options.exported is not None and (len(vehicles) > 1 or options.without):
        raise InputError("--as drives one vehicle as implemented; omit --without and give one --vehicle")
    if len(vehicles) > 1 and (options.open or options.serve):
        raise InputError("--open and --serve show the recording of one vehicle, and each has its own; give one --vehicle")


def _driven(options: Namespace, vehicle: Vehicle, title: str, names: list[str], road: Road, time: Array) -> Driven:
    """Runs the controllers of a vehicle file, and those of `--without`."""
    design = Designer(vehicle, search=False).design
    runs = list(comparison.run_named(vehicle, names, design, road, time, options.exported))
    drivers, parts = {run.controller.name: run.controller for run in runs}, [""] * len(runs)
    for part in options.without:
        own, some = vehicle.without(part), run_without(drivers, part)
        if own is not vehicle and some:
            runs += run_controllers(own, [drivers[name] for name in some], road, time)
            parts += [part] * len(some)
    return Driven(vehicle, title, names, runs, parts, design)


def _interval(options: Namespace, runs: Sequence[Run], road: Road, time: Array) -> Interval:
    """Returns the samples between which the ride of all runs is measured."""
    from sim.studies.ride.run_metrics import measured_samples, measured_words

    pairs = [(run.vehicle, run.controller) for run in runs]
    first, end = measured_samples(pairs, road, options.duration, options.timestep)
    words = measured_words(time, (first, end))
    return Interval((first, end), words, float(time[first]), float(time[-1 if end is None else end - 1]))


def _result(options: Namespace, each: Driven, interval: Interval | None) -> dict[str, Any]:
    """Returns the result of a vehicle for its log and JSON."""
    road, time = each.runs[0].road, each.runs[0].prediction.time
    result: dict[str, Any] = {"runs": each.objects, "road": road.describe(), "timestep": options.timestep}
    if interval is not None:
        from sim.studies.ride.metrics import DEFINITIONS
        from sim.studies.ride.run_metrics import driven_roughness, metrics_object, roughness_object

        rows = zip(each.objects, each.runs, each.metrics, strict=True)
        result |= {
            "runs": [one | metrics_object(run, of_run) for one, run, of_run in rows],
            "measured_from": interval.start,
            **({} if interval.samples[1] is None else {"measured_until": interval.end}),
            "definitions": DEFINITIONS,
            "iri": roughness_object(driven_roughness(each.vehicle, road, time)),
        }
    return result | comparison.left_out_object(each.names, [run.controller.name for run in each.built])


def _steps(options: Namespace, runs: Sequence[Run], road: Road) -> "list[dict[str, SignalSteps]]":
    """Returns the step responses of every run; empty on another road."""
    from sim.studies.ride.step_response import measure_step, step_of

    return [measure_step(run, options.band) for run in runs] if step_of(road) else []


def _step_object(options: Namespace, runs: Sequence[Run], steps: "list[dict[str, SignalSteps]]") -> dict[str, Any] | None:
    """Returns the step responses as a JSON object; None without."""
    from sim.studies.ride.step_response import step_object

    return {"band": options.band, "runs": [step_object(*pair) for pair in zip(runs, steps, strict=True)]} if steps else None


def _above(options: Namespace, driven: Sequence[Driven], interval: Interval | None, road: Road) -> list[str]:
    """Returns the lines above the table: with `-v` every run in full, else what is special about some."""
    shown, metrics = [run for each in driven for run in each.shown], [one for each in driven for one in each.metrics]
    lines = list[str]()
    if interval is not None:
        from sim.runs.start import start_lines

        lines += end_lines(road, options.duration)
        for each in driven:
            lines += start_lines(each.shown[: len(each.built)], starts_later(options))
    if options.verbose:
        from sim.studies.ride.run_metrics import describe, driven_roughness

        for each in driven:
            for run, own in zip(each.shown, each.metrics or [None] * len(each.shown), strict=True):
                lines += comparison.run_lines([run], each.passive)
                if interval is not None and own is not None:
                    rough = driven_roughness(run.vehicle, run.road, run.prediction.time)
                    lines += ["", *text_lines(describe(run, own, interval.start, interval.end, rough), "full")]
    elif not options.brief:
        lines += comparison.run_lines(shown)
        if interval is not None:
            from sim.studies.ride.run_metrics import broken, summary

            left = [(run.controller.name, Statement(line)) for run in shown for line in broken(run)]
            lines += text_lines(Document("", shared(left)))
            lines += ["", *told] if (told := text_lines(summary(shown, metrics))) else []
    return lines
