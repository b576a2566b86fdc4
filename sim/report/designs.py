"""The sections of a report on what was designed: gains, certificates, frequency responses, and the paper's numbers."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.common.printed import as_name
from models.document.document import Document, Table, notes
from models.document.field import Field, cells, titles
from models.laws.linear import gain_text, states_text
from models.laws.semi_active import SemiActive
from models.vehicle.vehicle import Vehicle
from sim.report.scope import NAME, Scope
from synth.analysis.specification import Specification, digits
from synth.controller.controller import Controller
from synth.controller.report import (
    BOUND,
    GAP,
    LOWER_BOUND,
    NORM,
    PEAK,
    SLOWEST_POLE,
    failures_of_sampled_loop,
    judged_lines,
    notes_on_sampled_loop,
    relative_difference_text,
)
from synth.vehicle.designer import Designer
from synth.vehicle.paper import BOX, PRINTED, SEED, Way, WithoutL, entry_of, ours, remark_4, remark_5

FREQUENCIES = (0.1, 1.0, 3.0, 10.0, 25.0)  # Hz, from a body's to above a wheel's


def design_section(scope: Scope) -> Document:
    """Every controller: gain, certificate, and how good that is."""
    proved = (BOUND, NORM, replace(PEAK, label="peak", unit="Hz", scale=1 / (2 * np.pi)), LOWER_BOUND, GAP, SLOWEST_POLE)
    headings = ("controller", "measures", *titles(proved)[:-1], "slowest pole [1/s]", "certificate")
    rows = []
    for one in scope.controllers:
        *numbers, pole = cells(proved, [one.certificate])[0]
        pole = pole if one.certificate.stable else one.certificate.stability.verdict
        rows.append((one.name, ", ".join(one.measured).replace("_", " ") or "nothing", *numbers, pole, _held(scope, one)))
    for one in scope.laws:
        rows.append((one.name, ", ".join(one.measured).replace("_", " "), *["-"] * 6, f"no linear claim: {one.kind}"))
    text = (
        "The bound is the gamma that the linear matrix inequality proves for this very law; the norm is recomputed by two other "
        "routes. A certificate holds if all poles are stable, X > 0, the inequality (20) is negative definite and norm <= bound, "
        "checked without the solver that found it. No controller of its kind, of whatever order, can have a norm below "
        "its lower bound.",
    )
    if scope.laws:
        text = (
            *text,
            f"What {scope.kind_of_laws} asks for is {_known(scope)}, so that nothing is proved of it, and its columns are empty.",
        )
    if not scope.is_ideal:
        text = (*text, "All of this is of the ideal loop: continuous, with no limits and no computer.")
    said = [(one.name, line) for one in scope.controllers for line in judged_lines(one)]
    text = (*text, *(f"{as_name(name)}: {line}." for name, line in said))
    tables = [Table("designs", "Every controller, how good it is, and whether that is proved.", headings, tuple(rows), words=2)]
    if scope.laws:
        described = tuple(
            (one.name, one.text.partition(" (")[0], one.text.partition(" (")[2].removesuffix(")")) for one in scope.laws
        )
        tables.append(
            Table("laws", "Description of the laws without a proof.", ("controller", "law", "what it does"), described, 3)
        )
    if scope.built_norms:

        def above(one: Controller) -> str:
            return (
                relative_difference_text(scope.built_norms[one.name].value, one.certificate.norm.value)
                if one.certificate.stable
                else "-"
            )

        columns: tuple[Field[Controller], ...] = (
            NAME,
            NORM.of(lambda one: one.certificate, "norm, ideal loop"),
            Field("norm, as built", lambda one: scope.built_norms[one.name].value, digits),
            Field("that is", above),
            Field("reached by a road", lambda one: scope.built_norms[one.name].reached, digits),
        )
        caption = (
            f"The norm of the ideal loop, and of the loop as built{scope.noise_qualifier}, with what a road reaches of that."
        )
        tables.append(Table.of("norms", caption, columns, scope.stable))
        built = (
            f"As built, the loop has {scope.implementation_text}; its norm is that of its linear part{scope.noise_qualifier}: "
            "the L2 gain from the "
            "road's velocity to z, both of which go on while a force is held. It is exact, between two levels 1e-8 apart."
        )
        text = (*text, built)
    if goals := goals_table(scope.controllers):
        tables.append(goals)
        text = (
            *text,
            "Some controllers have goals of their own in the vehicle file. Each is held against what is proved of it, or against "
            "its value where that is exact; what is minimised has nothing that it may be at most.",
        )
    tables += [table for one in scope.controllers if (table := gain_table(scope.vehicle, one)) is not None]
    return Document("Designs and certificates", (*notes(*text), *tables))


def _known(scope: Scope) -> str:
    """Describes the extent to which the requests of nonlinear laws are known."""
    if all(isinstance(one, SemiActive) for one in scope.laws):
        return "no linear function of what it measures"
    return "known only of the measurements that it was called with"


def goals_table(controllers: Sequence[Controller]) -> Table | None:
    """Returns the table of controllers' goals, with the numbers of `python -m synth`, or None without goals."""
    columns: tuple[Field[tuple[str, Specification]], ...] = (
        Field("controller", lambda of: of[0]),
        Field("goal", lambda of: f"{of[1].what} ({of[1].where})" if of[1].where else of[1].what),
        Field("unit", lambda of: of[1].unit or "-"),
        Field("value", lambda of: of[1].value, digits),
        Field("proved to be at most", lambda of: of[1].proved_text),
        Field("allowed", lambda of: of[1].at_most, digits),
        Field("kept", lambda of: "yes" if of[1].holds else "NO"),
    )
    promises = [(one.name, promise) for one in controllers for promise in one.specifications]
    caption = "What controllers keep of the goals that the vehicle file has for them."
    return Table.of("goals", caption, columns, promises, words=3) if promises else None


def _held(scope: Scope, controller: Controller) -> str:
    """Describes the parts of a certificate that fail, or hold only with the computer."""
    certificate, norm = controller.certificate, scope.built_norms.get(controller.name)
    failures = failures_of_sampled_loop(scope.vehicle, certificate, certificate.failures, norm)
    return "; ".join(failures or notes_on_sampled_loop(scope.vehicle, certificate, norm)) or "holds"


def gain_table(vehicle: Vehicle, controller: Controller) -> Table | None:
    """Returns the table of a controller's gains, a row per measured signal, or None if it measures nothing.

    A static gain has a column per force, K transposed. A law with states has a column per frequency, as on a Bode plot: the
    magnitude of all its forces together.
    """
    if not controller.measured:
        return None
    kind, forces, law = vehicle.kind, vehicle.linear_model.inputs, controller.law
    if law.states:
        at = [f for f in FREQUENCIES if law.sample_period is None or 2 * f * law.sample_period < 1]
        entries = np.stack([np.linalg.norm(law.response(2 * np.pi * f), axis=0) for f in at])
        headings = [f"{f:g} Hz" for f in at]
        together = ", of all forces together" if len(vehicle.linear_model.inputs) > 1 else ""
        caption = (
            f"The law of controller {as_name(controller.name)}, of {states_text(law)}: the amplitude of the force that it asks "
            f"for{together}, per unit of each signal that it measures, at some frequencies."
        )
    else:
        entries, headings = controller.gain, [force.replace("_", " ") for force in forces]
        caption = (
            f"The gain of controller {as_name(controller.name)}: the force it asks for, per unit of each signal that it measures."
        )
    rows = tuple(
        (
            name.replace("_", " "),
            per_unit(kind.signal(forces[0]).unit, kind.signal(name).unit),
            *(f"{entry:.6g}" for entry in row),
        )
        for name, row in zip(controller.measured, entries.T.tolist(), strict=True)
    )
    return Table(f"gain-{controller.name}", caption, ("for each", "unit", *headings), rows, words=2)


def per_unit(unit: str, other: str) -> str:
    """The unit of a quotient: N/m, N·s/m."""
    over, _, under = other.partition("/")
    return f"{unit}·{under}/{over}" if under else f"{unit}/{other}"


def paper_section(scope: Scope) -> Document:
    """Does it reproduce the paper?"""
    values = ours(scope.designer)
    rows = []
    for row in PRINTED:
        entry = f"[{row.entry[0] + 1}, {row.entry[1] + 1}]" if row.entry is not None else ""
        digits = max(0, -math.floor(math.log10(row.digit)))
        mine = entry_of(values[row.quantity], row.entry)
        same = round(mine / row.digit) == round(row.value / row.digit)
        rows.append(
            (
                row.equation,
                f"{row.quantity}{entry}",
                "same" if same else row.reason,
                f"{row.value:.{digits}f}",
                f"{mine:.{digits + 2}f}",
            )
        )
    text = ("Every number that the paper prints of its designs, and ours from scratch, to two digits more.",)
    headings = ("equation", "quantity", "to the digits printed", "paper", "ours")
    tables = [
        Table("paper", "The paper's printed numbers beside ours.", headings, tuple(rows), words=3),
        without_l(scope.designer),
    ]
    if not scope.quick:
        scope.progress("a genetic algorithm")
        tables.append(other_ways(scope.designer))
    return Document("Numbers of the paper", (*notes(*text), *tables))


def without_l(designer: Designer) -> Table:
    """Remark 4: what becomes of L = 0."""
    columns: tuple[Field[WithoutL], ...] = (
        Field("controller", lambda one: f"{one.controller}, states {one.states}"),
        Field("gain", lambda one: "none" if one.gain is None else gain_text(one.gain)),
        Field("bound", lambda one: "none" if one.bound is None else one.bound, ".5g"),
        Field("state feedback", lambda one: one.best, ".5g"),
    )
    caption = (
        "Remark 4: controllers by (25) with L = 0, in one step. With the states (30) there are none. With the car's absolute "
        "motion as states, as in [33], and the road's height as w, (25) has a solution for I, whose gain grows without bound as "
        "the optimum is approached, and none for II."
    )
    return Table.of("without-l", caption, columns, remark_4(designer), detail="full")


def other_ways(designer: Designer) -> Table:
    """Remark 5: the two steps beside a genetic algorithm."""
    columns: tuple[Field[Way], ...] = (
        Field("controller", lambda one: f"{one.controller}, {one.how}"),
        Field("work", lambda one: one.work),
        Field("gain", lambda one: gain_text(one.gain)),
        Field("norm", lambda one: one.norm, ".6f"),
        Field("processor time [s]", lambda one: one.seconds, ".2f"),
    )
    caption = (
        "Remark 5: the two steps beside a genetic algorithm (differential evolution on the norm itself, every entry of the gain "
        f"from {-BOX:g} to {BOX:g}, seed {SEED}). The times are of one run on the machine that made this page."
    )
    return Table.of("other-ways", caption, columns, remark_5(designer), words=2, detail="full")
