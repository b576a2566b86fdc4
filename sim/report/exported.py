"""The section of a report on exported code: what was exported, and what the code changes in MuJoCo."""

from models.document.document import Document, Table, notes
from sim.report.scope import Exported, Scope
from sim.runs.report import code_notes, code_table, verdicts
from sim.runs.run import run_controllers, sample_times
from synth.controller.controller import code_of

TITLE = "Exported code"


def exported_section(scope: Scope) -> Document:
    """Returns the section on the folder of a report."""
    exported = scope.exported
    assert exported is not None, "a folder was given"
    time = sample_times(scope.vehicle, scope.duration, scope.timestep)
    (run,) = run_controllers(scope.vehicle, [exported.driver], scope.road, time)
    effect = run.prediction.code_effect
    assert effect is not None, "code drives the run"
    said = (*verdicts([run], f"Over {scope.where}, exported code of "), *notes(*code_notes(effect, scope.vehicle)))
    return Document(TITLE, (*said, _facts(exported), code_table(effect, scope.vehicle)))


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
