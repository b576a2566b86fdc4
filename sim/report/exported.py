"""The section of a report on exported code: what was exported, and what it does in MuJoCo beside what is predicted of it."""

import numpy as np

from models.common.errors import InputError
from models.common.printed import as_name, cell
from models.figures.page import Section, State, Table
from models.vehicle.vehicle import Vehicle
from sim.linear.nonlinear_elements import at_rest
from sim.report.headline import Statement
from sim.report.scope import Exported, Scope
from sim.runs.report import verdict
from sim.runs.run import Run, run_controllers, sample_times
from sim.studies.stability.exported_margins import find_exported_margins
from synth.controller.controller import code_of
from synth.controller.export import cortex_m4
from synth.controller.export.c_law import ExportedLaw, PythonStep, random_inputs
from synth.controller.export.compiled import CompiledController
from synth.vehicle.exported_numbers import CHANGE, numbers_notes, numbers_object, numbers_rows

FEW, SEED = 1000, 1  # samples on a simulated processor
TITLE, TERM = "What was exported?", "code, its rounding, and the loop with its numbers"


def exported_section(scope: Scope) -> tuple[Section, list[Statement]]:
    """Returns the section on the folder of a report, and the sentences of the answer on it."""
    exported = scope.exported
    assert exported is not None, "a folder was given"
    driver, vehicle = exported.driver, scope.vehicle
    code = code_of(driver)
    time = sample_times(vehicle, scope.duration, scope.timestep)
    own = next(one for one in scope.driven if one.name == driver.name)
    ours, run = run_controllers(vehicle, [own, driver], scope.road, time)
    said = verdict(run)
    text = [
        f"Driven by the compiled code of this folder, in {code.law.numbers}, MuJoCo {said}, over {scope.where}. Its files are "
        "as they were exported, each by its content. Code of another law, vehicle or sample period drives nothing.",
    ]
    findings = [
        Statement(
            f"Over {scope.where} the exported code of {as_name(driver.name)}, in {code.law.numbers}, {said}.",
            _state(run.passed),
        )
    ]
    tables = [_facts(vehicle, exported)]
    if isinstance(driver, CompiledController) and not code.law.dampers:
        rounding = run.prediction.rounding
        if rounding is not None and not rounding.beyond:
            tables.append(_rounding(vehicle, ours, run))
        elif rounding is not None:
            text.append(f"{rounding.beyond[0]} leaves its range there and is clipped there; export it with a larger one.")
        else:
            text.append(f"In double it differs from our own law by {_apart(ours, run):.0e} of a signal's peak at most.")
        table, notes, agrees = _loop(scope, driver)
        tables.append(table)
        text += notes
        if not agrees:
            findings.append(
                Statement(f"Margins of {as_name(driver.name)} with its exported code DO NOT AGREE in MuJoCo.", "fails")
            )
    else:
        text.append("Linear analysis speaks of no law that sets dampers, so there is no norm or margin of its numbers.")
    return Section(TITLE, TERM, tuple(text), tuple(tables)), findings


def _facts(vehicle: Vehicle, exported: Exported) -> Table:
    """Returns what lies in the folder, and what the code takes on another processor."""
    law = code_of(exported.driver).law
    how = f"every {1e3 * law.period:g} ms" if law.period is not None else "at any period"
    rows = [
        ("folder", str(exported.folder)),
        ("controller", law.controller),
        ("format", f"C99 in {law.numbers}, {law.name}_step {how}"),
        ("SHA-256 of its manifest", code_of(exported.driver).sha256),
        ("files", "as exported: every one is compared with what is exported now, and with the manifest"),
        ("states, delay", f"{law.states}, {law.delay} samples"),
    ]
    if law.ranges is not None:
        for name, most, unit, source in zip(law.inputs, law.ranges, law.units, law.range_sources, strict=True):
            rows.append((f"range of {name.replace('_', ' ')}", f"±{most:.6g} {unit}, {source}"))
    return Table(
        "exported", "The folder, and its code.", ("what", "value"), (*rows, ("on a Cortex-M4", _elsewhere(law))), words=2
    )


def _elsewhere(law: ExportedLaw) -> str:
    """Returns what a simulated Cortex-M4 takes for a step, or why that is not known."""
    samples, step = list(random_inputs(law, FEW, SEED)), PythonStep(law)
    try:
        found = cortex_m4.run(law, samples)
    except InputError as error:
        return f"not measured: {error}"
    differ = sum([float(value) for value in step(row)] != given for row, given in zip(samples, found.outputs, strict=True))
    return (
        f"{found.least} to {found.most} instructions a step, {found.stack} bytes of stack, {found.size} of code and tables; "
        f"{differ} of {FEW} samples differ"
    )


def _apart(ours: Run, run: Run) -> float:
    """Returns the largest difference of two runs, over each signal's peak."""
    return max(
        float(np.abs(run.physics[name] - ours.physics[name]).max() / ours.physics.peak(name))
        for name in run.vehicle.linear_model.outputs
        if ours.physics.peak(name) > 0
    )


def _rounding(vehicle: Vehicle, ours: Run, run: Run) -> Table:
    """Returns what rounding moves each signal by: predicted, and as the run differs from that of our own law."""
    effect, rows = run.prediction.rounding, []
    assert effect is not None, "the code rounds"
    for name in vehicle.linear_model.outputs:
        off = run.physics[name] - ours.physics[name]
        numbers = effect.rms[name], float(np.sqrt(np.mean(off**2))), float(effect.most[name].max()), float(np.abs(off).max())
        rows.append((name.replace("_", " "), vehicle.kind.signal(name).unit, *(cell(number, ".2g") for number in numbers)))
    headings = ("signal", "unit", "rms, predicted", "rms, MuJoCo", "at most, predicted", "at most, MuJoCo")
    caption = (
        "What rounding does to the signals over the bump: predicted, and the difference of MuJoCo's runs by code and by our law."
    )
    return Table("exported-rounding", caption, headings, tuple(rows), words=2)


def _loop(scope: Scope, driver: CompiledController) -> tuple[Table, list[str], bool]:
    """Returns norm, margins and promises, ideal and with the numbers of the code, what is said of them, and if they agree."""
    law = code_of(driver).law
    caption = "The loop as implemented, with ideal numbers and with those of the code: margins are of all forces at once."
    if scope.quick or not any(one.name == driver.name for one in scope.active):
        about = numbers_object(scope.vehicle, driver, law, scope.timestep)
        rows, notes = tuple(numbers_rows(about)), numbers_notes(about)
        return Table("exported-loop", caption, ("what", "ideal", law.numbers, CHANGE), rows, words=4), _sentences(notes), True
    found = find_exported_margins(at_rest(scope.vehicle), driver, scope.margins_timestep, scope.progress)
    headings = ("what", "ideal", law.numbers, CHANGE, "MuJoCo, by the code")
    notes = [*numbers_notes(found.about), f"Margins with the code: {found.verdict}"]
    return Table("exported-loop", caption, headings, tuple(found.rows), words=5), _sentences(notes), found.agrees


def _state(holds: bool) -> State:
    return "holds" if holds else "fails"


def _sentences(notes: list[str]) -> list[str]:
    return [f"{note[0].upper()}{note[1:]}." for note in notes]
