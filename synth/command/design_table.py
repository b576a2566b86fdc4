"""Design table of a vehicle file: designed or checked controllers, their performance, and limits for any controller."""

import math
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from models.common.command import print_json
from models.common.errors import InputError
from models.common.printed import DETAIL_LINES, Stages, as_name, by_text, fit_lines, percent, say, title_lines
from models.document.document import Block, Document, Statement, notes
from models.document.field import Field, Record
from models.document.outputs import check_outputs, output_paths, written_lines
from models.document.text import screen_lines, text_lines
from models.vehicle.names import without_copies
from models.vehicle.vehicle import Vehicle
from synth.analysis.lower_bounds.lower_bound import LowerBound
from synth.command.table import NOT_SHOWN, Row, answers, describe, details, lacks_damping, loop_table, record
from synth.controller.law_margins import direct_feedback, law_margins, warnings
from synth.controller.problem import measurements
from synth.controller.report import NORM
from synth.controller.report import notes as notes_on
from synth.controller.sampled_report import failures_of_sampled_loop, norm_or_failure, notes_on_sampled_loop
from synth.design.descent.flatness import free_moves
from synth.plant.generalized import Plant
from synth.plant.numerics import DesignError
from synth.vehicle.designer import Designer
from synth.vehicle.expected_ride import METHOD, ROAD_CLASS, SPEED, expected_ride, no_line

# last stage of the progress display: computing the limit for all controllers and finding gains that are not unique
FREE = "limits for every controller"
MORE = "-v explains the columns and prints poles, notes and laws."
# If one of these options is given, the results of this option are printed instead of gains and rides
ANSWER_OPTIONS = frozenset(("cross_check", "fragility", "prove", "refine"))
# allowed relative increase of gamma; `--json` shows how far each gain may change until gamma has increased by this amount
FLAT = 1e-4
# a ride is called worse if it exceeds the passive ride by more than this factor; rounding in the table hides smaller
# differences
WORSE = 1.005
RIDE = Field[Row]("expected ride", lambda row: row.ride, ".3g", key="expected_ride", unit="m/s2")
CHANGE = Field[float]("change", lambda ratio: ratio - 1, "+.0f", 100, unit="%")


@dataclass(frozen=True, eq=False)
class Designs:
    """Designed or checked controllers of a vehicle file, and limits that hold for all controllers.

    Attributes:
        vehicle: vehicle of the designed or checked controllers.
        rows: rows of the table, one for each controller.
        limit: part of the norm that no control force can change; this part is a lower bound for all controllers.
        plant: generalized plant for which `limit` holds.
        flat: changes of the gain of the state feedback on each state that hardly increase gamma; see `_flatness`.
        passive: expected ride (weighted acceleration) of the vehicle with passive suspension [m/s2]; None if no expected ride
            is defined.
        expected_rides: expected ride [m/s2] of a vehicle with persons, by point and by controller; points where a person sits
            come first.
        without: norm of the vehicle without control; infinite if the vehicle is not damped.
    """

    vehicle: Vehicle
    rows: tuple[Row, ...]
    limit: LowerBound
    plant: Plant
    flat: dict[str, list[float | None]]
    passive: float | None
    expected_rides: Mapping[str, Mapping[str, float | None]]
    without: float


def answer(vehicle: Vehicle, names: Sequence[str], options: Namespace) -> int:
    """Runs the command, which designs, checks, saves and prints controllers. Returns the exit code of the command.

    Args:
        vehicle: vehicle whose file defines the controllers.
        names: names of the requested controllers; empty for `--check`, which chooses the controllers itself.
        options: parsed options.

    Raises:
        InputError: an option does not apply to this vehicle, or a file cannot be written.
    """
    check_outputs(
        {"picture": options.picture, "save": options.save, "certificates": options.certificates}, vehicle.files, options.json
    )
    if options.save:
        _check_save(vehicle, names, options)
    designs = designs_of(vehicle, names, options)
    outputs = {"saved": options.save} | ({"picture": _draw_responses(designs, options.picture)} if options.picture else {})
    if options.save:
        from synth.command.save import save

        bounds = {row.name: row.sampled_below for row in designs.rows}
        save(options.save, vehicle, [row.controller for row in designs.rows if row.controller is not None], bounds)
    if options.certificates:
        from synth.command.certificates import write_certificates

        write_certificates(options.certificates, vehicle, [row.controller for row in designs.rows if row.controller is not None])
        outputs |= {"certificates": options.certificates}
    if options.json:
        print_json({**RECORD(designs), **output_paths(outputs)})
    else:
        say(answer_lines(designs, options, outputs))
    return 1 if any(row.failures for row in designs.rows) else 0


def designs_of(vehicle: Vehicle, names: Sequence[str], options: Namespace) -> Designs:
    """Designs or checks the controllers, and computes all results that the options request."""
    stages = ["saved claims"] if options.check else [f"controller {name}" for name in names]
    designer, stage = Designer(vehicle), Stages(*stages, FREE)
    if options.check:
        stage(stages[0])
        from synth.command.check import check

        rows = check(designer, options.controller)
    else:
        rows = [_design_row(designer, name, options, stage, alone=len(names) == 1) for name in names]
    if options.cross_check and not any(row.witness or row.controller is None for row in rows):
        raise InputError(
            "--cross-check needs a controller that is designed without filters, by LMI (22) or (25) of the paper; give "
            "such a controller, or omit --cross-check"
        )
    stage(FREE)
    flat = {} if options.check else _flatness(designer, rows)
    rows = tuple(_finish_row(vehicle, row, options.fragility) for row in rows)
    passive = designer.design("passive")
    limit = designer.beyond_control
    where, loops = vehicle.ride_points, {row.name: row.controller for row in rows if row.controller is not None}
    loops = {"passive": passive, **loops}
    felt = {at: {name: expected_ride(vehicle, one, [at]) for name, one in loops.items()} for at in where.all if where.people}
    stage.end()
    without = passive.certificate.norm.value
    return Designs(vehicle, rows, limit, designer.plant, flat, expected_ride(vehicle, passive), felt, without)


def _design_row(designer: Designer, name: str, options: Namespace, stage: Stages, alone: bool) -> Row:
    """Returns the table row of a designed controller, including the norm of its sampled-data loop.

    If the design fails and other controllers are also requested, the row contains the failure.
    """
    stage(f"controller {name}")
    try:
        row = _row(designer, name, options, stage)
    except InputError as error:  # an error in one section must not prevent the results of the other controllers
        if alone:
            raise
        row = Row(name, None, (), (str(error),))
    if row.controller is None:
        return row
    vehicle, certificate = designer.vehicle, row.controller.certificate
    norm, why = norm_or_failure(vehicle, row.controller)
    said = (*row.notes, *notes_on_sampled_loop(vehicle, certificate, norm))
    failures = (*failures_of_sampled_loop(vehicle, certificate, row.failures, norm), *why)
    return replace(row, sampled=norm, notes=said, failures=failures, sampled_below=designer.sampled_bound(row.controller))


def _row(designer: Designer, name: str, options: Namespace, stage: Stages) -> Row:
    """Returns the table row of a designed controller, or the row of a failed design."""
    if options.refine and name != "passive":
        return _refined_row(designer, name, options.zero_l)
    try:
        controller = designer.design(
            name, options.zero_l, lambda goal, within: stage(f"goal {NORM.digits(goal)}{'' if within else ', bounds not met'}")
        )
    except DesignError as error:
        return Row(name, None, (), (str(error),))
    said: tuple[str, ...] = ()
    witness = None
    if options.prove:
        from synth.command.check import prove_controller

        controller, said = prove_controller(designer, controller)
    # A vehicle without control may be undamped, which is not an error.
    excused = controller.certificate.stability.words if lacks_damping(controller) else ""
    failures = tuple(each for each in controller.failures if each != excused)
    if options.cross_check:
        from synth.command.cross_check import cross_check

        witness = cross_check(designer, controller, options.zero_l)
        failures += witness.failures if witness is not None else ()
    worth = designer.worth_refining(controller)
    return Row(name, controller, (*notes_on(controller), *said), failures, worth, witness, answers=said)


def _refined_row(designer: Designer, name: str, zero_l: bool) -> Row:
    """Returns the table row of the refined controller with its trade-off, or the row of the unrefined controller if refinement
    fails.
    """
    try:
        refined = designer.refine(name, zero_l)
    except DesignError as error:
        try:
            controller = designer.design(name, zero_l)
        except DesignError:
            return Row(name, None, (), ("the two-step method finds no gain", f"not refined: {error}"))
        not_refined = f"not refined: {str(error).removeprefix(f'controller {name!r}: ')}"
        return Row(name, controller, (*notes_on(controller), not_refined), controller.failures, answers=(not_refined,))
    said = notes_on(refined.start) if refined.start is not None else ("the two-step method finds no gain",)
    judged, traded = designer.judged(refined.controller), refined.trade_off_text.partition(";")[0]
    return Row(name, judged, (*said, *judged.remarks, refined.trade_off_text), judged.failures, answers=(traded,), refined=True)


def _finish_row(vehicle: Vehicle, row: Row, fragility: bool) -> Row:
    """Adds the expected ride and the stability margins of the law to a row of the table and, if requested, the tolerated gain
    errors.
    """
    controller = row.controller
    if controller is None:
        return row
    if fragility:
        from synth.command.fragility import fragility_report

        row = replace(row, fragile=fragility_report(vehicle, controller))
    return replace(row, ride=expected_ride(vehicle, controller), margins=law_margins(vehicle, controller))


def _flatness(designer: Designer, rows: Sequence[Row]) -> dict[str, list[float | None]]:
    """Returns how far each state-feedback gain can be changed without an increase of gamma by more than FLAT.

    If the table contains a state-feedback controller, the gain of this controller is used; otherwise a state feedback is
    designed. The gain is used even if the central path of this design ended early. The result is empty for a vehicle with
    integrals of measurements, because the state-feedback law then has states.

    Returns:
        For each state, the largest gain that acts on this state, and how far this gain may decrease and increase; None if
        without limit.
    """
    if designer.vehicle.integrals:
        return {}
    shown = [row.controller for row in rows if row.name == "state" and row.controller is not None]
    try:
        K = (shown or [designer.design("state")])[0].gain
    except DesignError:
        return {}
    states = designer.vehicle.linear_model.states
    moves = np.stack(free_moves(designer.plant.measured(measurements(designer.vehicle, states)[0]), K, FLAT))
    return {
        state: [float(value) if np.isfinite(value) else None for value in values]
        for state, values in zip(states, moves.T, strict=True)
        if values[1:].any()  # False if the gain on this state must not change at all
    }


def _check_save(vehicle: Vehicle, names: Sequence[str], options: Namespace) -> None:
    """Checks that the designed gains can be saved. Only gains that the command designs are saved."""
    from synth.command.save import check_save

    entries = vehicle.controllers
    new = [one for one in names if one != "passive" and (options.refine or one == "state" or entries[one].law is None)]
    check_save(options.save, vehicle, [name for name in new if name not in entries or not entries[name].request.preview] or new)


def _draw_responses(designs: Designs, path: Path) -> Path | None:
    """Draws the frequency responses of all stable loops. Returns the path of the figure, or None if no loop is stable."""
    from models.document.picture import write_picture
    from synth.command.responses import responses_figure

    figure = responses_figure(designs.vehicle, designs.rows)
    if figure is not None:
        write_picture(figure, path)
    return path if figure is not None else None


def _expected_ride(designs: Designs) -> dict[str, Any]:
    """Returns, as JSON, the expected ride of the passive vehicle, and the road class and the speed for which it is computed."""
    ride: dict[str, Any] = {"road_class": ROAD_CLASS, "speed": SPEED, "unit": RIDE.unit, "passive": designs.passive}
    ride |= {"method": METHOD, "without": _without_ride(designs)} if designs.vehicle.parts.nonlinear else {}
    return ride | ({"points": designs.expected_rides} if designs.expected_rides else {})


RECORD = Record[Designs](
    vehicle="vehicle.kind.name",
    controllers=lambda one: [record(row) for row in one.rows],
    invariant_limit=lambda one: {"norm": one.limit.gamma, "frequency": one.limit.limit_at} if one.limit.gamma else None,
    expected_ride=_expected_ride,
    flat=lambda one: {"gamma": FLAT, "gain_down_up": one.flat},
)


def answer_lines(designs: Designs, options: Namespace, outputs: Mapping[str, Path | None]) -> list[str]:
    """Returns the lines of text that the command prints: a short answer, or the full answer with `-v`."""
    vehicle, full = designs.vehicle, options.verbose
    files = written_lines(outputs)
    if outputs["saved"]:
        from synth.command.save import left_out_lines

        files += left_out_lines([row.name for row in designs.rows if row.controller is not None and row.controller.preview])
    if options.picture and not outputs["picture"]:
        files += ["no picture is written, because no loop is stable"]
    title, end = title_lines(vehicle.kind.name, vehicle.source), ["", verdict(designs.rows).text]
    lines = screen_lines(document(designs, options), full, [*title, *files, *end])
    if full and len(designs.rows) > 1 and len(fit_lines([*title, *lines, *files, *end])) > DETAIL_LINES:
        lines = text_lines(document(designs, options, in_table=True), "full")
    return [*title, *lines, *files, *end]


def document(designs: Designs, options: Namespace, in_table: bool = False) -> Document:
    """Returns the results of the command as a document.

    Args:
        designs: designed or checked controllers, with their results.
        options: options that the command's parser returned.
        in_table: True for a table of loops instead of a document about each controller.
    """
    vehicle, rows = designs.vehicle, designs.rows
    asked = bool(options.given & ANSWER_OPTIONS)
    margins = {row.name: row.margins for row in rows if row.margins is not None}
    felt = notes(*direct_feedback(margins), detail="brief")
    blocks: list[Block] = [*_worse(designs), *felt]
    if in_table or not options.verbose:
        gains = not in_table and (not asked or len(rows) == 1)
        blocks += answers(rows, gains, checked=bool(options.check))
        blocks += notes(*(warnings(margins) if not asked else ()), detail="brief")
    if options.fragility and (in_table or not options.verbose):
        from synth.command.fragility import describe as tolerated

        blocks += tolerated({row.name: row.fragile for row in rows if row.fragile is not None})
    blocks += describe(vehicle, rows, designs.limit, designs.plant).blocks
    if not asked:
        blocks += _rides(designs)
        shares = ", ".join(f"{as_name(row.name)} by at least {_at_least(row.worth)}" for row in rows if row.worth)
        blocks += notes(f"--refine can lower these norms: {shares}.") if shares else ()
    unnamed = [name for name in vehicle.controller_names if name not in vehicle.linear_names]
    if unnamed and not (options.controller or options.check):
        names = ", ".join(map(as_name, unnamed))
        blocks += notes(f"Linear analysis does not apply to {names}. `roadproof drive` and `roadproof campaign` simulate them.")
    own = [row.name for row in rows] if options.controller else without_copies(row.name for row in rows)
    if in_table:
        blocks += [loop_table([row for row in rows if row.controller is not None]), *notes(NOT_SHOWN)]
    else:
        blocks += [details(vehicle, row) for row in rows if row.name in own]
    return Document("", (*blocks, *([] if options.verbose else notes(MORE))))


def _worse(designs: Designs) -> tuple[Statement, ...]:
    """Returns a warning about designs that minimise the norm but whose norm is above that of the vehicle without control."""
    entries, norms = designs.vehicle.controllers, dict[str, float]()
    for row in designs.rows:
        entry, certificate = entries.get(row.name), row.certificate
        if certificate is not None and certificate.bound is not None and not (entry and entry.law is not None):
            norms[row.name] = certificate.norm.value
    worse = ", ".join(f"{as_name(name)} {NORM.digits(norm)}" for name, norm in norms.items() if norm > WORSE * designs.without)
    text = f"WARNING: the norm of these designs is above the norm without control, {NORM.digits(designs.without)}: {worse}"
    return notes(text, detail="brief") if worse else ()


def _rides(designs: Designs) -> list[Statement]:
    """Describes the expected ride of every controller; for a vehicle with persons, the ride at each point. See `_rides_at`."""
    rides = {"passive": designs.passive, **{row.name: row.ride for row in designs.rows}}
    without = [f"There is no expected ride for {as_name(name)}: {why}." for name, why in _without_ride(designs).items()]
    return [one for at, known in (designs.expected_rides or {"": rides}).items() for one in _rides_at(designs, at, known)] + [
        *notes(*without)
    ]


def _rides_at(designs: Designs, at: str, known: Mapping[str, float | None]) -> tuple[Statement, ...]:
    """Describes the expected ride of every controller at a point, and lists the controllers whose ride is worse than that of
    the passive vehicle.
    """
    rides, passive = {name: ride for name, ride in known.items() if ride is not None}, known["passive"]
    if not rides.keys() & {row.name for row in designs.rows}:
        return ()
    changes = {name: CHANGE.text(CHANGE.value(ride / passive)) for name, ride in rides.items() if passive and name != "passive"}
    rows = [(name, RIDE.digits(ride) + (f" ({changes[name]})" if name in changes else "")) for name, ride in rides.items()]
    listed = "; ".join(f"{names} {text}" for text, names in by_text(rows).items())
    given = ", if dampers could supply every force" if designs.vehicle.dampers else ""
    method = f", by {METHOD}" if designs.vehicle.parts.nonlinear else ""
    loop = f"Ride{f' at {at}' if at else ''} of the ideal loop on road class {ROAD_CLASS} at {SPEED:g} m/s{given}{method}"
    said = [f"{loop} [{RIDE.unit}]: {listed}"]
    worse = [as_name(name) for name, ride in rides.items() if passive and ride > WORSE * passive]
    if worse:
        said.append(f"The ride is WORSE than passive: {', '.join(worse)}. A small norm alone does not make a car comfortable.")
    return notes(*said, detail="brief")


def _without_ride(designs: Designs) -> dict[str, str]:
    """Returns, by name, the stable controllers for which no expected ride is defined, each with the reason."""
    some = {row.name: row.controller for row in designs.rows if row.controller is not None and row.ride is None}
    return {name: why for name, controller in some.items() if (why := no_line(designs.vehicle, controller))}


def _at_least(share: float) -> str:
    """Returns a fraction as a percentage, rounded down to two digits."""
    unit = 10.0 ** (math.floor(math.log10(share)) - 1)
    return percent(math.floor(share / unit) * unit)


def verdict(rows: Sequence[Row]) -> Statement:
    """Returns the verdict on the controllers: whose claims fail, and whose sampled-data loop is unstable."""
    wrong = [f"{row.name} {'is not designed' if row.controller is None else 'FAILS'}" for row in rows if row.failures]
    text = f"every claim holds for {len(rows)} controller{'s' * (len(rows) != 1)}"
    text = f"not every claim holds: {', '.join(wrong)}" if wrong else text
    judged = [row for row in rows if row.controller is not None and not lacks_damping(row.controller)]
    lost = [row.name for row in judged if row.sampled is not None and not row.sampled.stable]
    text += f"; UNSTABLE in the sampled-data loop: {', '.join(lost)}" if lost else ""
    grow = [row.name for row in rows if row.margins is not None and row.margins.growth]
    text += f"; control law UNSTABLE by itself: {', '.join(grow)}" if grow else ""
    return Statement(text, "fails" if wrong else "holds", "brief")
