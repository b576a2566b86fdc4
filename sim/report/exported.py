"""The section of a report about exported code: what the code contains, and how runs with it differ from runs with the control
law.
"""

from collections.abc import Mapping

from models.common.printed import entry
from models.document.document import Document, Table, notes
from sim.runs.code_effect import code_notes, code_table
from sim.runs.report import verdicts
from sim.runs.run import run_controllers, sample_times
from sim.studies.study import Progress, Study
from sim.studies.subject import Subject

TITLE = "Exported code"


def exported_section(scope: Subject) -> Document:
    """Returns the section about exported code: its format and inputs, and the result of the code's run over the road."""
    assert scope.exported_controller is not None, "a folder was given"
    time = sample_times(scope.vehicle, scope.duration, scope.timestep)
    (run,) = run_controllers(scope.vehicle, [scope.exported_controller], scope.road, time)
    effect, code = run.agreement.code_effect, scope.exported_controller.code
    assert effect is not None, "code drives the run"
    law, how = code.law, f"every {1e3 * code.law.period:g} ms" if code.law.period is not None else "at any period"
    rows = [
        ("controller", law.controller),
        ("format", f"C99 in {law.numbers}, {law.name}_step {how}"),
        ("SHA-256 of its manifest, which every file matches", code.sha256),
        ("states, delay", f"{law.states}, {law.delay} samples"),
    ]
    if law.ranges is not None:
        ranges = zip(law.inputs, law.ranges, law.units, law.range_sources, strict=True)
        rows += [
            (f"range of {name.replace('_', ' ')}", f"±{entry(most)} {unit}, {source}") for name, most, unit, source in ranges
        ]
    facts = Table("exported", "Contents of the folder.", ("what", "value"), tuple(rows), words=2)
    said = (*verdicts([run], f"Over {scope.where}, exported code of "), *notes(*code_notes(effect, scope.vehicle)))
    return Document(TITLE, (*said, facts, code_table(effect, scope.vehicle)))


class ExportedStudy(Study[Document]):
    """Study that adds a section about exported code to the page of a report."""

    def requests(self, scope: Subject) -> Mapping[str, Subject]:
        """See `Study`."""
        return {} if scope.exported_controller is None else {"": scope}

    def run(self, request: Subject, progress: Progress) -> Document:
        """See `Study`."""
        return exported_section(request)
