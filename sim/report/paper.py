"""The section of a report on the paper itself: its printed numbers beside ours, and other ways to a gain of which it speaks."""

import math

from models.figures.page import Section, Table
from sim.report.scope import Scope
from synth.designer import Designer
from synth.paper.printed import PRINTED, entry_of, ours
from synth.paper.remarks import BOX, SEED, remark_4, remark_5
from synth.words import gain_text


def paper_section(scope: Scope) -> Section:
    """Does it reproduce the paper?"""
    found = ours(scope.designer)
    rows = []
    for row in PRINTED:
        entry = f"[{row.entry[0] + 1}, {row.entry[1] + 1}]" if row.entry is not None else ""
        digits = max(0, -math.floor(math.log10(row.digit)))
        mine = entry_of(found[row.quantity], row.entry)
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
    return Section("Does it reproduce the paper?", "every printed number, and ours", text, tuple(tables))


def without_l(designer: Designer) -> Table:
    """Remark 4: what becomes of L = 0."""
    rows = [
        (
            f"{one.controller}, states {one.states}",
            "none" if one.gain is None else gain_text(one.gain),
            "none" if one.bound is None else f"{one.bound:.5g}",
            f"{one.best:.5g}",
        )
        for one in remark_4(designer)
    ]
    caption = (
        "Remark 4: controllers by (25) with L = 0, in one step. With the states (30) there are none. With the car's absolute "
        "motion as states, as in [33], and the road's height as w, (25) has a solution for I, whose gain grows without bound as "
        "the optimum is approached, and none for II."
    )
    return Table("without-l", caption, ("controller", "gain", "bound", "state feedback"), tuple(rows))


def other_ways(designer: Designer) -> Table:
    """Remark 5: the two steps beside a genetic algorithm."""
    rows = [
        (f"{one.controller}, {one.how}", one.work, gain_text(one.gain), f"{one.norm:.6f}", f"{one.seconds:.2f}")
        for one in remark_5(designer)
    ]
    caption = (
        "Remark 5: the two steps beside a genetic algorithm (differential evolution on the norm itself, every entry of the gain "
        f"from {-BOX:g} to {BOX:g}, seed {SEED}). The times are of one run on the machine that made this page."
    )
    headings = ("controller", "work", "gain", "norm", "processor time [s]")
    return Table("other-ways", caption, headings, tuple(rows), words=2)
