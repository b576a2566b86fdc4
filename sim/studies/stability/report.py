"""Output of margins: text and JSON."""

import math
from collections.abc import Sequence
from typing import Any

from models.common.printed import WIDTH, finite, wrapped
from models.vehicle.vehicle import Vehicle
from sim.studies.stability.edge import SLOWEST, StabilityEdge
from sim.studies.stability.fragility import FragilityFound
from sim.studies.stability.margin_search import GainMargin, LoopMargins
from sim.studies.stability.robustness import Robustness, varied_text
from synth.controller.controller import Controller
from synth.controller.disk_margin import DiskMargin
from synth.design.uncertainty.fragility import errors_text, fragility_object, proved_text, rounding_text, whose

UNDECIDED = "not found: the slowest mode creeps"
TOO_LONG = f"longer ones than {SLOWEST:g} s are not run"
NAME, CELL = 24, 12  # columns of a table of margins
IMPLEMENTED = "gain", "phase", "disk"  # margins of the implemented loop
COUNTERPART = "the law is discrete: all numbers are of the continuous law whose Tustin transform it is"


def margins_object(
    vehicle: Vehicle,
    controller: Controller,
    margins: dict[str, LoopMargins],
    built: dict[str, LoopMargins],
    fragile: FragilityFound,
    box: Robustness | None,
) -> dict[str, Any]:
    """Returns the result as a JSON object: SI units, None for infinite or missing values.

    With `built`, margins of gain, phase and disk are those of the implemented loop, and `ideal` has the ideal ones.
    """
    objects = {name: _loop_object(one) for name, one in margins.items()}
    for name, one in built.items():
        ideal = {key: objects[name][key] for key in IMPLEMENTED}
        objects[name] |= {key: value for key, value in _loop_object(one).items() if key in IMPLEMENTED} | {"ideal": ideal}
    whole = objects.pop("")
    result = {"controller": controller.name, **whole, "loops": objects}
    names = controller.measured, vehicle.linear_model.inputs
    edge = {
        "mujoco": finite(fragile.edge.found),
        "extrapolated": fragile.edge.extrapolated,
        "sampled": _sampled_object(fragile.edge, fragile.timestep),
    }
    weighted = {"weighted_errors": [promise.record for promise in controller.robustness]} if controller.robustness else {}
    result["fragility"] = fragility_object(fragile.predicted, fragile.rounding, *names) | edge | weighted
    if box is None:
        return {**result, "robustness": None}
    varied = {one.name: [one.smallest, one.largest] for one in box.varied}
    corners = [
        {**corner.parameters, "norm": finite(corner.norm), "stable": corner.decays, "agrees": corner.agrees}
        for corner in box.corners
    ]
    result["robustness"] = {
        "varied": varied,
        "computed": box.computed,
        "worst_norm": finite(box.norm),
        "at": box.at,
        "corners": corners,
    }
    return result


def _loop_object(one: LoopMargins) -> dict[str, Any]:
    predicted = one.predicted
    gain = {
        "predicted": finite(predicted.gain),
        "found": finite(one.gain.found),
        "lower": {"predicted": predicted.gain_lower or None, "found": finite(one.found_gain_lower) or None},
        "extrapolated": one.gain.extrapolated,
        "sampled": _sampled_object(one.gain, one.timestep),
    }
    phase = {  # lag: what a delay makes
        "predicted": finite(predicted.phase),
        "found": finite(one.found_phase),
        "frequency": finite(predicted.frequency),
        "smallest_lag": finite(predicted.smallest_phase),
        "lead": {"predicted": finite(predicted.lead), "frequency": finite(predicted.lead_frequency)},
        "smallest": finite(min(predicted.smallest_phase, predicted.lead)),
    }
    disk = predicted.disk
    return {
        "gain": gain,
        "phase": phase,
        "disk": {
            "margin": disk.size,
            "gain": [disk.gain[0], finite(disk.gain[1])],
            "phase": disk.phase,
            "frequency": finite(disk.frequency),
        },
        "delay": {"predicted": finite(predicted.delay), "found": finite(one.found_delay)},
        "sample_period": {"predicted": finite(predicted.sample_period), "found": finite(one.found_sample_period)},
    }


def _sampled_object(margin: GainMargin, timestep: float) -> list[dict[str, Any]]:
    """Returns the margin of the sampled loop at each timestep that physics ran with."""
    return [
        {"timestep": timestep / k, "predicted": finite(at), "found": finite(search.found)}
        for k, at, search in zip((1, 2), margin.sampled, (margin.search, margin.finer), strict=True)
        if search.searched
    ]


OF_FEEDBACK = "all of its feedback alone; the road ahead changes no margin"


def margins_lines(
    vehicle: Vehicle,
    controller: Controller,
    margins: dict[str, LoopMargins],
    built: dict[str, LoopMargins],
    fragile: FragilityFound,
    box: Robustness | None,
    verbose: bool,
) -> list[str]:
    """Returns the margins of a loop, predicted and found, in lines for a terminal.

    Without `verbose` a part that agrees is short: loops beside the first, norms with errors and rounding, other vehicles.
    """
    law = controller.law
    fixed = law.sample_period if law.states else None
    lines, brief = [COUNTERPART] if fixed is not None else [], []
    whose = [(name, one, " as implemented") for name, one in built.items()]
    for name, one, of in [*whose, *((name, one, ", ideal" if built else "") for name, one in margins.items())]:
        if name and one.agrees and not verbose:
            brief += _brief_lines(f"{name}{of}", one)
            continue
        lines += ["", *_loop_lines(f"{_called(name, len(margins))}{of}", one, fixed)]
        lines += _agreement(one.agrees, verbose)
    headings = ("gain", "MuJoCo", "delay, ms", "MuJoCo")
    lines += ["", f"{'the others closed':{NAME + 2}}{''.join(f'{one:>{CELL}}' for one in headings)}", *brief] if brief else []
    lines += ["", *_fragile_lines(vehicle, controller, fragile, verbose), *_agreement(fragile.agrees, verbose)]
    lines += [OF_FEEDBACK] if controller.preview is not None else []
    if box is None:
        return [*lines, "", f"other vehicles: {varied_text(vehicle.kind)}"]
    at = ", ".join(f"{name} {value:.6g}" for name, value in box.at.items())
    worst = f"{box.text}: worst norm {box.norm:.6g}"
    sure = f"of {box.computed} vehicles computed, not proved between"
    lines += ["", f"{worst} at {at}; the largest {sure}"] if verbose else [f"{worst} {sure}; -v: at which, and more"]
    for corner in box.corners:
        if corner.agrees and corner.decays and not verbose:
            continue
        at = ", ".join(f"{name} {value:.6g}" for name, value in corner.parameters.items())
        physics = f"MuJoCo {'settles' if corner.decays else 'GROWS'}, {'agrees' if corner.agrees else 'DOES NOT AGREE'}"
        lines.append(f"  {at}: norm {corner.norm:.6g}; {physics}")
    return lines


def _brief_lines(name: str, one: LoopMargins) -> list[str]:
    """Returns a loop's gain and delay in a line."""
    numbers = one.predicted.gain, one.gain.found, 1e3 * one.predicted.delay, 1e3 * one.found_delay
    return [f"  {name:{NAME + 2}}{''.join(map(_cell, numbers))[2:]}"]


def _agreement(agrees: bool, verbose: bool) -> list[str]:
    """Returns whether a part of the margins agrees; that it does is left to the verdict without `verbose`."""
    if agrees:
        return ["  agrees"] if verbose else []
    return ["  DOES NOT AGREE; where the timestep is too coarse, give a smaller one"]


def _fragile_lines(vehicle: Vehicle, controller: Controller, fragile: FragilityFound, verbose: bool) -> list[str]:
    """Returns lines on the loop's margin for errors of its readings and forces."""
    predicted, edge, h = fragile.predicted, fragile.edge, fragile.timestep
    names = controller.measured, vehicle.linear_model.inputs
    worst = errors_text(predicted.stable, *names) if math.isfinite(edge.own) else "none up to 100 % ends it"
    told = verbose or len(worst) <= WIDTH - 6
    rows = [(f"of {whose(predicted)}", 100 * edge.own, 100 * edge.found, _noted(edge, worst if told else ""))]
    rows += [(name, 100 * at, 100 * seen, note) for name, at, seen, note in _sampled_rows(edge, h, 1)]
    details = [f"  {proved_text(predicted, norms=verbose)}"]
    details += [f"  {rounding_text(controller.certificate.norm.value, fragile.rounding)}"] if verbose else []
    for promise in controller.robustness:
        details += wrapped(promise.text, "  ", 4)
    return [*_table("bears errors up to, %", rows), *details]


def verdict(
    margins: dict[str, LoopMargins], built: dict[str, LoopMargins], fragile: FragilityFound, box: Robustness | None
) -> str:
    """Returns the verdict on the predicted margins."""
    wrong = [f"{_called(name, len(margins))} as implemented" for name, one in built.items() if not one.agrees]
    wrong += [_called(name, len(margins)) for name, one in margins.items() if not one.agrees]
    if not fragile.agrees:
        wrong.append(f"errors of {whose(fragile.predicted)}")
    if box is not None and not box.holds:
        wrong.append("other vehicles")
    if wrong:
        return f"DOES NOT AGREE: {'; '.join(wrong)}"
    others = f", {len(box.corners)} other vehicles too" if box is not None else ""
    edges = [one for loop in margins.values() for one in (loop.gain.found, loop.found_gain_lower, loop.found_delay)]
    edges += [*(loop.found_sample_period for loop in margins.values()), fragile.edge.found]
    decided = ", where its runs decide" if any(map(math.isnan, edges)) else ""
    return f"agrees: the loop bears in MuJoCo what is predicted{decided}{others}"


def _called(name: str, count: int) -> str:
    """Returns the name of a loop, one of so many."""
    return f"the loop of {name}, the others closed" if name else ("all loops at once" if count > 1 else "the loop")


def _loop_lines(title: str, one: LoopMargins, fixed: float | None) -> list[str]:
    """A loop's margins as a table; `fixed` is the sample period of a discrete law [s]."""
    predicted, h = one.predicted, one.timestep
    lower = predicted.gain_lower or one.found_gain_lower
    rows = [
        ("gain, factor", predicted.gain, one.gain.found, _noted(one.gain, "" if lower else "down to 0, too")),
        *_sampled_rows(one.gain, h, 1),
    ]
    if lower:
        rows.append(("gain, lower factor", predicted.gain_lower, one.found_gain_lower, _noted(one.gain_lower)))
        rows += _sampled_rows(one.gain_lower, h, -1)
    where = f"at {predicted.frequency:.5g} rad/s" if predicted.crossovers else ""
    if predicted.smallest_phase < predicted.phase * (1 - 1e-9):
        rows.append(("phase lag, rad", predicted.smallest_phase, math.nan, "at another crossover than that of the delay"))
        rows.append(("  of the delay", predicted.phase, one.found_phase, where))
    else:
        rows.append(("phase lag, rad", predicted.phase, one.found_phase, where))
    where = f"at {predicted.lead_frequency:.5g} rad/s" if predicted.leading else ""
    rows += [("phase lead, rad", predicted.lead, math.nan, where), _disk_row(predicted.disk)]
    if one.delay.searched:
        samples = ""
        if math.isfinite(one.delay.unstable) and one.delay.decided:
            samples = f"{round(one.delay.stable / h)} samples decay, {round(one.delay.unstable / h)} grow"
        name = "delay, ms" if one.sample_period.searched else "more delay, ms"
        note = _noted_edge(one.delay, one.found_delay, samples)
        rows.append((name, 1e3 * one.predicted_delay, 1e3 * one.found_delay, note))
    if not one.sample_period.searched:
        return _table(title, rows)
    own = "" if fixed is None else f"fixed by the law: {1e3 * fixed:g} ms"
    if predicted.all_sampled:
        own = "; ".join(filter(None, (own, "all forces sampled")))
    if own and math.isinf(predicted.sample_period) and math.isinf(one.found_sample_period):
        return [*_table(title, rows), f"  sample period: {own}"]
    own = _noted_edge(one.sample_period, one.found_sample_period, own)
    rows.append(("sample period, ms", 1e3 * predicted.sample_period, 1e3 * one.found_sample_period, own))
    return _table(title, rows)


def _noted_edge(edge: StabilityEdge, found: float, note: str) -> str:
    """Returns a note on a time at which a loop is lost, with the reason if no run decides it."""
    if not edge.decided:
        return "; ".join(filter(None, (note, UNDECIDED)))
    return "; ".join(filter(None, (note, f"none up to {edge.stable:g} s; {TOO_LONG}" if math.isnan(found) else "")))


def _disk_row(disk: DiskMargin) -> tuple[str, float, float, str]:
    """Returns the disk margin as a row: which factors, and which turns, are on its edge."""
    low, high = disk.gain
    factors = f"{low:.3g} to {high:.3g}" if math.isfinite(high) else "any factor"
    return "disk margin", disk.size, math.nan, f"{factors}; or {disk.phase:.3g} rad"


def _table(title: str, rows: Sequence[tuple[str, float, float, str]]) -> list[str]:
    """Returns rows of name, predicted value, value found, and a note to the right, or below if it does not fit."""
    heading = f"{'predicted':>{CELL}}{'MuJoCo':>{CELL}}"
    room = NAME + 2
    lines = [f"{title:{room}}{heading}"] if len(title) <= room else [title, f"{'':{room}}{heading}"]
    for name, first, second, note in rows:
        row = f"  {name:{NAME}}{_cell(first)}{_cell(second)}"
        beside = f"{row}  {note}".rstrip()
        lines += [beside] if len(beside) <= WIDTH else [row, *wrapped(note, "      ")]
    return lines


def _noted(gain: GainMargin, note: str = "") -> str:
    """Returns a note on a margin; it begins with the word for one that is extrapolated from MuJoCo's runs."""
    undecided = UNDECIDED if math.isnan(gain.found) else ""
    return "; ".join(filter(None, ("extrapolated" if gain.extrapolated else undecided, note)))


def _sampled_rows(gain: GainMargin, h: float, power: int) -> list[tuple[str, float, float, str]]:
    """Returns the sampled loop's margin at both timesteps, if it differs from the loop's own; power -1 for a lower factor."""
    searches = zip((h, h / 2), gain.sampled, (gain.search, gain.finer), strict=True)
    return [
        (f"  sampled every {1e3 * step:g} ms", at**power, search.found**power, "" if step == h else "above: what these tend to")
        for step, at, search in searches
        if gain.finer.searched
    ]


def _cell(value: float) -> str:
    """Returns a number in its column: `any` of an infinite one, and nothing of one that no run can show."""
    return f"{'any' if math.isinf(value) else '-' if math.isnan(value) else format(value, '.6g'):>{CELL}}"
