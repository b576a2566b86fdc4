"""The section of a report on exported code: what was exported, and what the code changes in MuJoCo."""

from models.common.printed import as_name, cell
from models.document.document import Document, Statement, Table, notes
from sim.report.scope import Exported, Scope
from sim.runs.report import verdict
from sim.runs.run import Run, run_controllers, sample_times
from synth.controller.controller import code_of

TITLE = "Exported code"


def exported_section(scope: Scope) -> Document:
    """Returns the section on the folder of a report."""
    exported = scope.exported
    assert exported is not None, "a folder was given"
    driver, vehicle = exported.driver, scope.vehicle
    numbers, time = code_of(driver).law.numbers, sample_times(vehicle, scope.duration, scope.timestep)
    (run,) = run_controllers(vehicle, [driver], scope.road, time)
    said, effect = verdict(run), run.prediction.code_effect
    text = []
    if effect is not None and effect.clipped:
        text.append(f"{effect.clipped[0]} leaves its range there and is clipped there; export it with a larger one.")
    finding = Statement(
        f"Exported code of {as_name(driver.name)}, in {numbers}, over {scope.where}: {said}.",
        "holds" if run.passed else "fails",
    )
    return Document(TITLE, (finding, *notes(*text), _facts(exported), _changes(run)))


def _facts(exported: Exported) -> Table:
    """Returns what the folder contains."""
    code = code_of(exported.driver)
    law, how = code.law, f"every {1e3 * code.law.period:g} ms" if code.law.period is not None else "at any period"
    rows = [
        ("folder", str(exported.folder)),
        ("controller", law.controller),
        ("format", f"C99 in {law.numbers}, {law.name}_step {how}"),
        ("SHA-256 of its manifest", code.sha256),
        ("files", "each has the checksum of the manifest"),
        ("states, delay", f"{law.states}, {law.delay} samples"),
    ]
    if law.ranges is not None:
        for name, most, unit, source in zip(law.inputs, law.ranges, law.units, law.range_sources, strict=True):
            rows.append((f"range of {name.replace('_', ' ')}", f"±{most:.6g} {unit}, {source}"))
    return Table("exported", "The folder, and its code.", ("what", "value"), tuple(rows), words=2)


def _changes(run: Run) -> Table:
    """Returns the difference of every signal between the run with the code and the run with the law itself."""
    effect, kind, rows = run.prediction.code_effect, run.vehicle.kind, []
    assert effect is not None, "code drives the run"
    for name in effect.apart:
        numbers = cell(effect.rms(name), ".2g"), cell(effect.peak(name), ".2g")
        rows.append((name.replace("_", " "), kind.signal(name).unit, *numbers))
    caption = "Difference of MuJoCo's run with the code from its run with the law itself, over the same road."
    return Table("exported-rounding", caption, ("signal", "unit", "rms", "at most"), tuple(rows), words=2)
