"""`python -m sim.drive`: controllers over one road of any kind, in MuJoCo and in linear analysis, compared and measured."""

import json
from collections.abc import Sequence

from models.common.command import chosen, complain, run_command
from sim.command.drive_options import end_lines, gaps, parser, requested_road, starts_later


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options, vehicle file, road or logs folder.
    """
    options = parser().parse_args(arguments)
    from models.common.printed import say, titled
    from models.figures.outputs import check_outputs, written, written_lines
    from models.vehicle.vehicle import read_vehicle
    from sim.command import comparison
    from sim.runs.report import half_step_object, run_object, shared_lines, summary_lines
    from sim.runs.run import sample_times
    from sim.runs.start import start_lines
    from sim.studies.ride import run_metrics
    from sim.studies.ride.metrics import DEFINITIONS
    from sim.studies.ride.standing import standing_lines, standings_object
    from sim.studies.ride.step_response import check_band, measure_step, step_lines, step_object, step_of
    from synth.vehicle.designer import Designer

    vehicle = read_vehicle(options.vehicle)
    names = chosen(vehicle.controller_names, options.controller)
    time = sample_times(vehicle, options.duration, options.timestep)
    road = requested_road(vehicle, options, time)
    for remark in gaps(road, options.duration):
        complain(remark)
    check_band(road, options.band, "band" in options.given)
    comparison.check_view(options)
    check_outputs({"picture": options.picture, "logs": options.logs}, vehicle.files)

    design = Designer(vehicle, search=False).design
    runs = comparison.run_named(vehicle, names, design, road, time, options.exported)
    driven = [run.controller.name for run in runs]
    first = run_metrics.first_sample(vehicle, [run.controller for run in runs], road, options.duration, options.timestep)
    measured = [run_metrics.measure_run(run, first) for run in runs]
    roughness = run_metrics.driven_roughness(vehicle, road, time)
    result = {
        "runs": [
            run_object(run) | {"half_step": half_step_object(run)} | run_metrics.metrics_object(run, one)
            for run, one in zip(runs, measured, strict=True)
        ],
        "road": road.describe(),
        "timestep": options.timestep,
        "measured_from": float(time[first]),
        "definitions": DEFINITIONS,
        "iri": run_metrics.roughness_object(roughness),
        **comparison.left_out_object(names, driven),
    }
    steps = [measure_step(run, options.band) for run in runs] if step_of(road) else []
    logs = comparison.recorded(options, vehicle, driven, lambda: dict(zip(driven, runs, strict=True)), result)
    outputs = comparison.write_histories(options, runs, road.words)
    passive = comparison.passive_beside(runs, design)
    standings = comparison.standings_of(runs, passive, first, measured)
    exported = comparison.exported_object(vehicle, runs, options.timestep)
    if options.json:
        step = {"band": options.band, "runs": [step_object(*pair) for pair in zip(runs, steps, strict=True)]} if steps else None
        print(
            json.dumps(
                {**result, "step": step, **exported, "compared": standings_object(standings), **written(outputs), "logs": logs},
                allow_nan=False,
            )
        )
    else:
        lines = titled(
            f"{vehicle.kind.name} over a road: {road.words}; {options.duration:g} s at {options.timestep:g} s", vehicle.source
        )
        lines += [*end_lines(road, options.duration), *start_lines(runs, starts_later(options))]
        if options.verbose:
            for run, one, compared in zip(runs, measured, comparison.compared_lines(runs, passive), strict=True):
                lines += ["", *compared, ""]
                lines += run_metrics.metric_lines(run, one, float(time[first]), options.duration, roughness)
        elif not options.brief:
            lines += comparison.short_lines(runs)
            lines += shared_lines([(run.controller.name, line) for run in runs for line in run_metrics.broken_lines(run)])
            lines += run_metrics.angle_lines(runs, measured)
            lines += run_metrics.expected_lines(runs, measured)
        lines += comparison.exported_lines(exported, options.verbose) if not options.brief else []
        if steps and not options.brief:
            lines += ["", *step_lines(runs, steps, options.band, options.verbose)]
        settled = ", when all have settled" if 0 < time[first] < options.duration / 2 else ""
        about = comparison.table_note(runs, options, f"MuJoCo, from {time[first]:.4g} s on{settled}")
        lines += ["", *standing_lines(standings, about), *comparison.stop_lines(runs, options.verbose, first > 0)]
        say([*lines, *written_lines(outputs), *comparison.log_lines(logs, options.brief, runs), "", *summary_lines(runs)])
    comparison.view(options, logs)
    return 0 if all(run.passed for run in runs) and len(runs) == len(names) else 1


if __name__ == "__main__":
    run_command(main)
