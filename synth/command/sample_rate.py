"""`python -m synth --rates`: effect of slower sample rates on controllers, as a table, a figure and JSON."""

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace

from models.common.command import print_json
from models.common.errors import InputError
from models.common.printed import Stages, say, title_lines
from models.document.outputs import check_outputs, output_paths, written_lines
from models.document.picture import write_picture
from models.document.text import screen_lines
from models.vehicle.limits_and_implementation import LONGEST_PERIOD, Implementation
from models.vehicle.vehicle import Vehicle
from synth.controller.sampled_report import built_words
from synth.plant.numerics import DesignError
from synth.vehicle.designer import Designer
from synth.vehicle.sample_rate.cost import SHORTEST, cost
from synth.vehicle.sample_rate.report import RECORD, describe, drawn_periods, failures, rates_figure

MOST = 1000  # largest number of sample periods that `--rates` accepts


def periods_of(rates: Sequence[float]) -> list[float]:
    """Converts the sample periods in `--rates` from milliseconds to seconds, and sorts them in ascending order.

    Raises:
        InputError: a period is out of range or given twice, or there are too many periods.
    """
    for rate in rates:
        if not 1e3 * SHORTEST <= rate <= 1e3 * LONGEST_PERIOD:  # the condition is also true if the value is NaN
            raise InputError(
                f"--rates {rate:g} ms is not allowed; give sample periods from {1e3 * SHORTEST:g} to {1e3 * LONGEST_PERIOD:g} ms"
            )
        if list(rates).count(rate) > 1:
            raise InputError(f"--rates {rate:g} ms is given twice; give each sample period once")
    if len(rates) > MOST:
        raise InputError(f"--rates has {len(rates)} sample periods; give at most {MOST} of them")
    return sorted(rate / 1e3 for rate in rates)


def answer(vehicle: Vehicle, names: Sequence[str], options: Namespace) -> int:
    """Runs the command for the requested controllers. Returns the exit code.

    Raises:
        InputError: a sample period is not allowed, or the file of the figure cannot be written.
    """
    periods, outputs = periods_of(options.rates), {"picture": options.picture}
    check_outputs(outputs, vehicle.files)
    tried = drawn_periods(periods) if options.picture else periods
    stage = Stages(*(f"controller {name}" for name in names))
    designer, costs, undesigned = Designer(vehicle), [], {}
    for name in names:
        done = stage.counted(f"controller {name}", len(tried), "rates")
        try:
            costs.append(cost(vehicle, designer.design(name), tried, periods, done))
        except InputError as error:  # an error in one section must not prevent the results of the other controllers
            if len(names) == 1 and not isinstance(error, DesignError):
                raise
            undesigned[name] = str(error)
    stage.end()
    if options.picture and costs:
        write_picture(rates_figure(vehicle, costs, periods), options.picture)
    chosen = [replace(one, rates=tuple(at for at in one.rates if at.period in periods)) for one in costs]
    failed = [text for one in chosen for text in failures(one)]
    if options.json:
        rows = [RECORD(one) for one in chosen]
        rows += [{"name": name, "reason": reason} for name, reason in undesigned.items()]
        print_json({"vehicle": vehicle.kind.name, "controllers": rows, **output_paths(outputs)})
    else:
        document = describe(chosen, built_words(replace(vehicle, implementation=Implementation())))
        wrong = [f"controller {name} NOT DESIGNED: {reason}" for name, reason in undesigned.items()]
        wrong += [f"DOES NOT HOLD: {text}" for text in failed]
        holds = f"every claim holds for {len(chosen)} controller{'s' * (len(chosen) != 1)}"
        end = [*written_lines(outputs), "", *(wrong or [holds])]
        title = title_lines(vehicle.kind.name, vehicle.source)
        say([*title, *screen_lines(replace(document, title=""), options.verbose, [*title, *end]), *end])
    return 1 if failed or undesigned else 0
