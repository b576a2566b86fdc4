"""The sections of a report about designs: gains, certificates, goals, and the published results of the paper."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from models.common.printed import as_name, digits, entry
from models.document.document import Block, Document, Statement, Table, notes
from models.document.document import statements as statements_on
from models.document.field import Field
from models.document.text import names_text
from models.laws.linear import gain_text, states_text
from models.vehicle.vehicle import Vehicle
from sim.studies.study import Progress, Study
from sim.studies.subject import Subject
from synth.analysis.specification import Specification
from synth.command.table import Row, describe
from synth.controller.controller import Controller
from synth.controller.report import BOUND, NORM, study_notes
from synth.controller.sampled_report import failures_of_sampled_loop
from synth.vehicle.designer import Designer
from synth.vehicle.paper import BOX, PRINTED_NUMBERS, SEED, Way, WithoutL, entry_of, is_the_papers, ours, remark_4, remark_5

# Hz; the frequencies range from below the natural frequency of the body to above that of the wheel
FREQUENCIES = (0.1, 1.0, 3.0, 10.0, 25.0)


def design_section(scope: Subject) -> Document:
    """Returns the section about designs: norms, bounds and certificates as `roadproof synth` prints them, goals and gains."""
    rows, designer, vehicle = [_row(scope, one) for one in scope.controllers], scope.designer, scope.vehicle
    document = describe(vehicle, rows, designer.beyond_control, designer.plant, apart=True)
    blocks: list[Block] = [*_loops(scope), *document.blocks]
    if scope.laws:
        (table,) = (one for one in document.tables if one.name == "designs")
        blocks[blocks.index(table)] = _with_laws(scope, table)
        described = tuple((one.name, *one.text.removesuffix(")").partition(" (")[::2]) for one in scope.laws)
        caption = "Description of the laws without a proof."
        blocks.append(Table("laws", caption, ("controller", "law", "what it does"), described, 3))
    promises = [(one.name, promise) for one in scope.controllers for promise in one.specifications]
    if promises:
        caption = "Goals of the vehicle file, and what each controller is proved to keep."
        blocks.append(Table.of("goals", caption, GOALS, promises, words=3))
    gains = (gain_table(vehicle, one) for one in scope.controllers)
    return Document(document.title, (*blocks, *(table for table in gains if table is not None)))


def _loops(scope: Subject) -> list[Statement]:
    """Returns statements about the implementation, unstable loops, missed goals, and laws to which linear analysis does not
    apply.
    """
    statements, vehicle = list[Statement](), scope.vehicle
    built = (*vehicle.limits.phrases(vehicle.kind.suspensions), *vehicle.implementation.phrases)
    if built:
        text = f"Designs and certificates describe the ideal loop. MuJoCo runs the implemented loop: {', '.join(built)}."
        statements.append(Statement(text, "holds"))
    for one in scope.controllers:
        stable, ideal = one in scope.stable, one.certificate.stable
        if not (stable and ideal):
            words = "stable ideally and UNSTABLE as implemented, so only its design and its run are reported"
            if not ideal:
                words = "UNSTABLE, so only its run is reported"
            if stable:
                words = "stable as implemented and UNSTABLE ideally, so it has no ideal norm and no margins"
            statements.append(Statement(f"The loop of {as_name(one.name)} is {words}.", "holds" if stable else "ends"))
        if broken := [promise for promise in one.specifications if not promise.holds]:
            more = f", and {len(broken) - 1} more" if len(broken) > 1 else ""
            text = f"{as_name(one.name)} DOES NOT KEEP the goals of the vehicle file: {broken[0].text}{more}."
            statements.append(Statement(text, "ends"))
    studied = [(one.name, f"{text}.") for one in scope.driven_controllers for text in study_notes(vehicle, one)]
    statements += [replace(one, state="holds") for one in statements_on(studied)]
    if scope.laws:
        names, kinds = names_text(one.name for one in scope.laws), " or ".join(dict.fromkeys(one.kind for one in scope.laws))
        text = f"Linear analysis does not apply to {names} ({kinds}), so that there is no norm, bound or margin."
        statements.append(Statement(text, "holds"))
    return statements


def _row(scope: Subject, one: Controller) -> Row:
    """Returns the row of the table of designs that belongs to a linear controller."""
    certificate, norm = one.certificate, scope.built_norms.get(one.name)
    return Row(one.name, one, (), failures_of_sampled_loop(scope.vehicle, certificate, certificate.failures, norm), sampled=norm)


def _with_laws(scope: Subject, table: Table) -> Table:
    """Returns the table of designs, extended by a row for each law without a proof."""
    empty = ["-"] * (len(table.headings) - 3)
    rows = ((one.name, ", ".join(one.measured).replace("_", " "), *empty, f"no linear claim ({one.kind})") for one in scope.laws)
    return replace(table, rows=(*table.rows, *rows))


GOALS: tuple[Field[tuple[str, Specification]], ...] = (
    Field("controller", lambda of: of[0]),
    Field("goal", lambda of: f"{of[1].what} ({of[1].where})" if of[1].where else of[1].what),
    Field("unit", lambda of: of[1].unit or "-"),
    Field("value", lambda of: of[1].value, digits),
    Field("proved to be at most", lambda of: of[1].proved_text),
    Field("allowed", lambda of: of[1].at_most, digits),
    Field("kept", lambda of: "yes" if of[1].holds else "NO"),
)


def gain_table(vehicle: Vehicle, controller: Controller) -> Table | None:
    """Returns the table of a controller's gains, with a row for each measured signal; None if the controller measures nothing.

    The table of a static gain K has a column for each force. The table of a dynamic controller has a column for each frequency.
    The cells of a dynamic controller's table contain the amplitude of the force, or of all forces together, as in a Bode plot.
    """
    if not controller.measured:
        return None
    kind, forces, law = vehicle.kind, vehicle.linear_model.inputs, controller.law
    unit, entries, headings = kind.signal(forces[0]).unit, law.D, [force.replace("_", " ") for force in forces]
    caption = f"Gain of {as_name(controller.name)}: force per unit of each measured signal."
    if law.states:
        at = [f for f in FREQUENCIES if law.sample_period is None or 2 * f * law.sample_period < 1]
        entries, headings = np.linalg.norm(law.response(2 * np.pi * np.array(at)), axis=1), [f"{f:g} Hz" for f in at]
        together = " of all forces together" if len(forces) > 1 else ""
        caption = f"Law of {as_name(controller.name)}, {states_text(law)}: force amplitude{together} per unit of each signal."
    rows = tuple(
        (name.replace("_", " "), per_unit(unit, kind.signal(name).unit), *map(entry, row))
        for name, row in zip(controller.measured, entries.T.tolist(), strict=True)
    )
    return Table(f"gain-{controller.name}", caption, ("for each", "unit", *headings), rows, words=2)


def per_unit(unit: str, other: str) -> str:
    """Returns the unit of a quotient of two quantities, such as N/m or N·s/m."""
    over, _, under = other.partition("/")
    return f"{unit}·{under}/{over}" if under else f"{unit}/{other}"


def paper_section(scope: Subject, progress: Progress) -> Document:
    """Returns the section that compares the published results of the paper with results that Roadproof computes from scratch."""
    values, rows = ours(scope.designer), []
    for row in PRINTED_NUMBERS:
        entry = f"[{row.entry[0] + 1}, {row.entry[1] + 1}]" if row.entry is not None else ""
        decimals, mine = max(0, -math.floor(math.log10(row.digit))), entry_of(values[row.quantity], row.entry)
        same = round(mine / row.digit) == round(row.value / row.digit)
        numbers = f"{row.value:.{decimals}f}", f"{mine:.{decimals + 2}f}"
        rows.append((row.equation, f"{row.quantity}{entry}", "same" if same else row.reason, *numbers))
    headings = ("equation", "quantity", "to the digits printed", "paper", "ours")
    caption = "All numbers of the designs in the paper, and the same numbers computed here, with two more digits."
    texts = [
        "Remark 4: With L = 0 and the states (30), problem (25) has no solution. With the absolute motion of the car as "
        "states and the road height as w, as in [33], (25) has a solution for `I`, whose gain grows without bound near the "
        "optimum, and no solution for `II`."
    ]
    tables = [Table("paper", caption, headings, tuple(rows), words=3), without_l(scope.designer)]
    if not scope.quick:
        progress("a genetic algorithm")
        tables.append(other_ways(scope.designer))
        texts.append("Remark 5: differential evolution minimises the norm itself. Times are measured on this machine.")
    return Document("Numbers of the paper", (*notes(*texts), *tables))


def without_l(designer: Designer) -> Table:
    """Returns the table about remark 4 of the paper, which is about designs with L = 0."""
    columns: tuple[Field[WithoutL], ...] = (
        Field("controller", lambda one: f"{one.controller}, states {one.states}"),
        Field("gain", lambda one: "none" if one.gain is None else gain_text(one.gain)),
        Field("bound", lambda one: "none" if one.bound is None else one.bound, BOUND.form),
        Field("state feedback", lambda one: one.best, BOUND.form),
    )
    caption = "Remark 4: controllers by (25) with L = 0, in one step, with the states (30) and with those of [33]."
    return Table.of("without-l", caption, columns, remark_4(designer), detail="full")


def other_ways(designer: Designer) -> Table:
    """Returns the table about remark 5 of the paper, which compares the two-step design with a genetic algorithm."""
    columns: tuple[Field[Way], ...] = (
        Field("controller", lambda one: f"{one.controller}, {one.how}"),
        Field("work", lambda one: one.work),
        Field("gain", lambda one: gain_text(one.gain)),
        Field("norm", lambda one: one.norm, NORM.form),
        Field("processor time [s]", lambda one: one.seconds, ".2f"),
    )
    caption = f"Remark 5: the two steps and a genetic algorithm with gain entries from {-BOX:g} to {BOX:g}, seed {SEED}."
    return Table.of("other-ways", caption, columns, remark_5(designer), words=2, detail="full")


class DesignsStudy(Study[None]):
    """Study that adds a section about the designs of all controllers to the page of a report."""

    def sections(self, scope: Subject, results: Mapping[str, Mapping[str, Any]]) -> list[Document]:
        """See `Study`."""
        return [design_section(scope)]


class PaperStudy(Study[Document]):
    """Study that adds a section with the paper's published results and computed results to the page about the paper's vehicle."""

    seconds = 2.0

    def requests(self, scope: Subject) -> Mapping[str, Subject]:
        """See `Study`."""
        return {"": scope} if is_the_papers(scope.vehicle) else {}

    def run(self, request: Subject, progress: Progress) -> Document:
        """See `Study`."""
        return paper_section(request, progress)
