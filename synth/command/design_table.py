"""The design table of a vehicle file: every controller designed or checked, how good it is, and what no controller changes."""

import json
import math
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from models.common.errors import InputError
from models.common.printed import Stages, Whole, on_a_screen, say, table, titled
from models.document.outputs import check_outputs, written_lines
from models.vehicle.vehicle import Vehicle
from synth.analysis.invariant_point import UNCHANGED, is_pole, without_control
from synth.analysis.lower_bound import LowerBound
from synth.command.table import (
    Row,
    answer_lines,
    detail_lines,
    refine_lines,
    ride_lines,
    row_object,
    semi_active_lines,
    short_lines,
    table_lines,
    undamped,
    verdict_lines,
)
from synth.controller.law_margins import law_margins, names_of_warnings, warning_lines
from synth.controller.problem import measurements
from synth.controller.report import (
    failures_of_sampled_loop,
    filter_lines,
    ideal_lines,
    norm_or_failure,
    notes,
    notes_on_sampled_loop,
    sampled_lines,
    twist_lines,
)
from synth.design.descent.flatness import free_moves
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError
from synth.vehicle.designer import Designer
from synth.vehicle.expected_ride import ROAD_CLASS, SPEED, expected_ride

FREE = "what no controller decides"  # the stage after the designs: a limit for all, and gains that may be others
MORE = "-v adds poles, proofs, notes and laws in full, and which gains are not unique"
MORE_WITH_ABOUT = "-v explains the columns and adds poles, proofs, notes and laws in full"
ASKED = frozenset(("cross_check", "fragility", "prove", "refine"))  # options whose answer stands in place of gains and rides
FLAT = 1e-4  # of gamma: how far the gains may move for it is printed


def answer(vehicle: Vehicle, names: Sequence[str], options: Namespace) -> int:
    """Runs the command: designs, checks, saves and prints controllers. Returns the exit code.

    Args:
        names: names of the requested controllers; empty for `--check`, which chooses its own.

    Raises:
        InputError: options that do not apply to this vehicle, or files that cannot be written.
    """
    check_outputs({"picture": options.picture, "save": options.save}, vehicle.files, options.json)
    if options.save:
        from synth.command.save import check_save

        asked = [name for name in names if _designs(vehicle, name, options)]
        ahead = [name for name in asked if name in vehicle.controllers and vehicle.controllers[name].preview]
        check_save(options.save, vehicle, [name for name in asked if name not in ahead] or asked)
    designer = Designer(vehicle)
    stage = Stages(*(f"controller {name}" for name in names), FREE)
    if options.check:
        from synth.command.check import check

        rows = check(designer, options.controller)
    else:
        rows = []
        for name in names:
            stage(f"controller {name}")
            try:
                rows.append(_row(designer, name, options, stage))
            except InputError as error:  # of one section, which hides no other
                if len(names) == 1:
                    raise
                rows.append(Row(name, None, (), (str(error),)))
            rows[-1] = _bounded(designer, _built(vehicle, rows[-1]))
    if options.cross_check and not any(row.witness or row.controller is None for row in rows):
        raise InputError(
            "--cross-check has nothing to solve: no controller asked for comes from an LMI problem without filters; ask for one"
        )
    if options.fragility:
        from synth.command.fragility import fragility_report

        rows = [replace(row, fragile=fragility_report(vehicle, row.controller)) for row in rows]
    stage(FREE)
    moved = {} if options.check else _flatness(designer, rows)
    rows = [replace(row, ride=expected_ride(vehicle, row.controller)) if row.controller is not None else row for row in rows]
    rows = [replace(row, margins=law_margins(vehicle, row.controller)) if row.controller is not None else row for row in rows]
    passive = expected_ride(vehicle, designer.design("passive"))
    designs = [row.controller for row in rows if row.controller is not None]
    saved = bool(options.save)
    if saved:
        from synth.command.save import save

        save(options.save, vehicle, designs, {row.name: row.sampled_below for row in rows})
    drawn = bool(options.picture) and _drawn(vehicle, rows, options.picture)
    limit = designer.beyond_control
    stage.end()
    if options.json:
        result = {
            "vehicle": vehicle.kind.name,
            "controllers": [row_object(row) for row in rows],
            "invariant_limit": {"norm": limit.gamma, "frequency": limit.limit_at} if limit.gamma else None,
            "expected_ride": {"road_class": ROAD_CLASS, "speed": SPEED, "unit": "m/s2", "passive": passive},
            "flat": {"gamma": FLAT, "gain_down_up": moved},
            "saved": str(options.save) if saved else None,
            **({"picture": str(options.picture) if drawn else None} if options.picture else {}),
        }
        print(json.dumps(result, allow_nan=False))
    else:
        lines = titled(vehicle.kind.name, vehicle.source)
        full, asked = options.verbose, bool(options.given & ASKED)
        promised = any(row.controller is not None and row.controller.specifications for row in rows)
        if asked and len(rows) > 1 and not full:
            lines += answer_lines(rows, checked=bool(options.check))
        else:
            for row in rows:
                lines += (
                    ["", *detail_lines(row, vehicle)]
                    if full
                    else short_lines(row, gains=not promised, checked=bool(options.check))
                )
        margins = {row.name: row.margins for row in rows if row.margins is not None} if not (full or asked) else {}
        warnings, before = warning_lines(margins), lines
        lines = []
        if options.fragility and not full:
            from synth.command.fragility import short_lines as fragile_lines

            lines += fragile_lines({row.name: row.fragile for row in rows if row.fragile is not None})
        lines += [*([""] if full else []), _limit(limit, designer.plant)]
        if moved and full:
            of = "the ideal loop's gamma, which a sampled design is not for," if designer.vehicle.sampled else "gamma"
            share = f"{100 * FLAT:g} % more of {of}"
            lines.append(f"flat: for {share} the state feedback's largest gain on each state, by itself, may be")
            lines += table([(state, *_range(*values)) for state, values in moved.items()])
        refined, limits = refine_lines(rows, options.vehicle, full) if full or not asked else [], lines
        lines = []
        if saved:
            from synth.command.save import left_out_lines

            ahead = [one.name for one in designs if one.preview is not None]
            lines += ["", "saved", Whole(f"  {options.save}"), *left_out_lines(ahead)]
        if options.picture:
            lines += written_lines({"picture": options.picture}) if drawn else ["", "no picture: no loop is stable"]
        about = [*ideal_lines(vehicle, designs), *sampled_lines(vehicle), *filter_lines(vehicle), *twist_lines(vehicle)]
        given = ", every force given" if vehicle.dampers else ""
        rides = ride_lines(rows, passive, f"class {ROAD_CLASS}, {SPEED:g} m/s", given) if full or not asked else []
        unnamed = [] if options.controller or options.check else semi_active_lines(vehicle)
        shown = {
            "gains": before,
            "warnings": warnings,
            "limit": limits,
            "refine": refined,
            "files and table": [*lines, "", *table_lines(rows)],
            "about": about,
            "rides": [*rides, *unnamed],
            "more": [] if full else [MORE],
            "verdict": ["", *verdict_lines(rows)],
        }
        if not full:
            shorter = {"about": [], "more": [MORE_WITH_ABOUT]} if about else {}
            shown = on_a_screen(shown, (shorter, {"refine": []}, {"warnings": names_of_warnings(margins)}, {"more": []}))
        say([line for part in shown.values() for line in part])
    return 1 if any(row.failures for row in rows) else 0


def _designs(vehicle: Vehicle, name: str, options: Namespace) -> bool:
    """Returns True if this command designs a gain for the controller; only such gains can be saved."""
    if name == "passive":
        return False
    return options.refine or name == "state" or vehicle.controllers[name].law is None


def _row(designer: Designer, name: str, options: Namespace, stage: Stages) -> Row:
    """Returns the row of a designed controller, or of the failure."""
    if options.refine and name != "passive":
        return _refined_row(designer, name, options.zero_l)
    try:
        controller = designer.design(
            name, options.zero_l, lambda goal, within: stage(f"{goal:.5g}{'' if within else ', not within all bounds'}")
        )
    except DesignError as error:
        return Row(name, None, (), (str(error),))
    said: tuple[str, ...] = ()
    witness = None
    if options.prove:
        from synth.command.check import proved

        controller, said = proved(designer, controller)
    failures = (*controller.certificate.failures, *controller.unmet_specifications)
    if undamped(controller):  # of the vehicle alone nobody claims that it is damped
        failures = tuple(each for each in failures if each != controller.certificate.stability.words)
    if options.cross_check:
        from synth.command.cross_check import cross_check

        witness = cross_check(designer, controller, options.zero_l)
        failures += witness.failures if witness is not None else ()
    worth = designer.worth_refining(controller)
    return Row(name, controller, (*notes(controller), *said), failures, worth, witness, answers=said)


def _built(vehicle: Vehicle, row: Row) -> Row:
    """Returns a row with the norm as implemented, if the file defines it, or the reason why no computer can run the law."""
    if row.controller is None:
        return row
    (norm, why), certificate = norm_or_failure(vehicle, row.controller), row.controller.certificate
    said = (*row.notes, *notes_on_sampled_loop(vehicle, certificate, norm))
    failures = (*failures_of_sampled_loop(vehicle, certificate, row.failures, norm), *why)
    return replace(row, sampled=norm, notes=said, failures=failures)


def _bounded(designer: Designer, row: Row) -> Row:
    """A row with the lower bound of the sampled loop, if it was designed for that."""
    return replace(row, sampled_below=designer.sampled_bound(row.controller)) if row.controller is not None else row


def _refined_row(designer: Designer, name: str, zero_l: bool) -> Row:
    """Returns the row of a refined controller and its trade-off, or of the unrefined one if refining fails."""
    try:
        refined = designer.refine(name, zero_l)
    except DesignError as error:
        try:
            controller = designer.design(name, zero_l)
        except DesignError:
            return Row(name, None, (), ("the two steps find no gain", f"not refined: {error}"))
        not_refined = f"not refined: {str(error).removeprefix(f'controller {name!r}: ')}"
        failures = (*controller.certificate.failures, *controller.unmet_specifications)
        return Row(name, controller, (*notes(controller), not_refined), failures, answers=(not_refined,))
    said = notes(refined.start) if refined.start is not None else ("the two steps find no gain",)
    judged = designer.judged(refined.controller)
    failures = (*judged.certificate.failures, *judged.unmet_specifications)
    return Row(
        name,
        judged,
        (*said, *judged.remarks, refined.traded),
        failures,
        answers=(refined.traded.partition(";")[0],),
        refined=True,
    )


def _flatness(designer: Designer, rows: Sequence[Row]) -> dict[str, list[float | None]]:
    """Returns, by state, the largest gain on it and how far that gain may fall and rise for FLAT of gamma; None for any distance.

    The gain is the state feedback of the table if it has one, or the designed one, which need not be the end of its path. Nothing
    is said of one with an integral, which is more than a gain.
    """
    if designer.vehicle.integrals:
        return {}
    shown = [row.controller for row in rows if row.name == "state" and row.controller is not None]
    try:
        K = (shown or [designer.design("state")])[0].gain
    except DesignError:
        return {}
    states = designer.vehicle.linear_model.states
    moves = np.stack(free_moves(designer.plant, measurements(designer.vehicle, states)[0], K, FLAT))
    return {
        state: [float(value) if np.isfinite(value) else None for value in values]
        for state, values in zip(states, moves.T, strict=True)
        if values[1:].any()  # a gain that may not move at all is not flat
    }


def _limit(limit: LowerBound, plant: GeneralizedPlant) -> str:
    """Returns the bound that no control force lowers, in words; with a mode to be held, for stabilising forces only.

    At an invariant point z has that norm without control, too.
    """
    if limit.limit_at is None:
        return "limit: none; at every frequency control forces can change all of z's response to the road"
    if is_pole(plant, limit.limit_at):  # beside the mode a force may change all
        return (
            f"limit: at {limit.limit_at:.5g} rad/s, where a mode does not decay by itself, no control force that holds it brings "
            f"z's response to the road below {limit.gamma:.7g}"
        )
    free, said = without_control(plant, limit.limit_at), f"limit: {limit.gamma:.7g} at {limit.limit_at:.5g} rad/s"
    if free <= limit.gamma * (1 + UNCHANGED):
        return f"{said}, where no control changes z (invariant point)"
    return f"{said}, the limit at that frequency: no control brings z below it, and without control z is {free:.7g} there"


def _range(gain: float | None, down: float | None, up: float | None) -> tuple[str, str, str]:
    """A gain and the ends of the interval that it may move in, with digits enough to tell them apart."""
    assert gain is not None
    width = min((move for move in (down, up) if move), default=0.0)
    digits = math.ceil(math.log10(abs(gain) / width)) + 2 if gain and width else 0
    whole = math.floor(math.log10(abs(gain))) + 1 if gain else 0
    digits = min(max(digits, 4, whole if whole <= 6 else 0), 15)  # up to a million without a power of ten
    low = f"{gain - down:.{digits}g}" if down is not None else "any"
    high = f"{gain + up:.{digits}g}" if up is not None else "any"
    return f"{gain:.{digits + 1}g}", f"from {low}", f"to {high}"


def _drawn(vehicle: Vehicle, rows: Sequence[Row], picture: Path) -> bool:
    """Draws the responses of all loops that are stable; returns whether there is one."""
    from models.document.picture import write_picture
    from synth.command.responses import responses_figure

    figure = responses_figure(vehicle, rows)
    if figure is not None:
        write_picture(figure, picture)
    return figure is not None
