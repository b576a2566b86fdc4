"""The page of the gallery: published and computed results of each source, with figures of the responses."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.common.arrays import Array
from models.document.document import Document, Table
from models.document.figure import BLACK, BLUE, VERMILLION, Curve, Figure, Panel, drawn_indices
from models.document.page import VERDICTS, Page
from sim.linear.frequency_response import continuous_frequency_response
from sim.runs.run import Run
from sim.studies.gallery.entries import Entry, PrintedNumber
from sim.studies.gallery.numbers import OF_A_RUN, ComparedNumber, designer_of, run_of_number
from sim.studies.gallery.report import Result, describe, summary
from synth.analysis.norm import largest_singular_values

POINTS, MARKS = 800, 25  # approximate number of points of a drawn line, and of markers that show MuJoCo
BAND = 30.0  # the frequency axis reaches from 1 / `BAND` to `BAND` times the published frequency
LOW, HIGH, ABOUT = 0.1, 100.0, 400  # lowest and highest frequency of a singular value plot [Hz], and number of its points


def gallery_page(results: Sequence[Result], about: dict[str, str]) -> Page:
    """Returns the page of the gallery.

    Args:
        results: entries of the gallery, each with its published and computed results.
        about: texts that state how the page was made, such as time and command; the keys are the titles of the texts.
    """
    found = summary(results)
    headline, *said = found.statements
    table = Table("provenance", "Origin of this page.", ("what", "value"), tuple(about.items()), words=2)
    return Page(
        "Published results of suspensions, reproduced or refuted",
        Document("", (*said, *found.tables)),
        (*(_section(*each) for each in results), Document("Provenance", (table,))),
        headline.text,
        {**VERDICTS, "holds": "every number is reproduced, or differs for a reason", "fails": "numbers are NOT REPRODUCED"},
    )


def _section(entry: Entry, numbers: Sequence[ComparedNumber]) -> Document:
    """Returns the section of a gallery entry: its document, with a figure of the responses from which its numbers are read."""
    found, first = describe(entry, numbers), dict[tuple, PrintedNumber]()
    for one in (number.printed for number in numbers):
        first.setdefault((one.what in OF_A_RUN, one.vehicle, one.controller, one.signal, str(one.road), one.hertz), one)
    panels = [panel for one in first.values() if (panel := _panel(entry, numbers, one)) is not None]
    if not panels:
        return found
    title = "Lines: linear analysis. Markers: MuJoCo. Dashed: the published number."
    figure = Figure(f"gallery-{entry.name}", title, tuple(panels), columns=min(len(panels), 3))
    return replace(found, blocks=(figure, *found.blocks))


def _panel(entry: Entry, numbers: Sequence[ComparedNumber], one: PrintedNumber) -> Panel | None:
    """Returns a panel with the response that contains a published number; None if the number is not part of a response."""
    designer = designer_of(entry, one)
    if one.what in OF_A_RUN:
        run, peaks = run_of_number(designer, one), [each.printed for each in numbers if each.printed.what == "peak"]
        same = [peak for peak in peaks if peak.signal == one.signal and run_of_number(designer_of(entry, peak), peak) is run]
        return _over_time(run, same, one)
    if one.what == "ratio":
        hertz = np.geomspace(one.hertz / BAND, one.hertz * BAND, ABOUT)
        response = continuous_frequency_response(designer.vehicle, designer.design(one.controller), 2 * np.pi * hertz)
        gain = np.abs(response[:, designer.vehicle.linear_model.outputs.index(one.signal), 0])
        at = np.array([one.hertz]), np.array([one.value / one.scale])
        printed = Curve(*at, "printed", BLACK, "none", "D", name="printed")
        name = f"{one.signal.replace('_', ' ')} over the road's velocity"
        return Panel(name, "frequency [Hz]", "ratio [-]", (_line(hertz, gain), printed), xlog=True, ylog=True)
    if one.what == "norm":
        loop, hertz = designer.design(one.controller).loop(designer.vehicle), np.geomspace(LOW, HIGH, ABOUT)
        gain = largest_singular_values(loop.frequency_response(2 * np.pi * hertz))
        curves = _line(hertz, gain), _level(hertz, one.value)
        return Panel(f"{one.text}: largest singular value", "frequency [Hz]", "gain [-]", curves, xlog=True, ylog=True)
    return None


def _over_time(run: Run, peaks: Sequence[PrintedNumber], one: PrintedNumber) -> Panel:
    """Returns a panel of a signal over time. Published peaks are drawn with the sign of the largest peak of the response.

    Args:
        run: run from which the signal is taken.
        peaks: published peaks of the signal in the run.
        one: published number, which defines the signal, its unit and the scale of the axis.
    """
    time, exact = run.continuous.time, one.scale * run.continuous[one.signal]
    some, marks = drawn_indices(exact, max(len(time) // POINTS, 1)), slice(None, None, max(len(time) // MARKS, 1))
    unit = one.unit or (run.vehicle.kind.signal(one.signal).unit if one.scale == 1 else "-")
    side = math.copysign(1.0, float(exact[np.abs(exact).argmax()]))
    physics = one.scale * run.physics[one.signal]
    curves = [_line(time[some], exact[some])]
    curves.append(Curve(time[marks], physics[marks], "MuJoCo", VERMILLION, "none", "o", name="MuJoCo"))
    curves += [_level(time, side * peak.value) for peak in peaks]
    for peak in peaks:
        if peak.grid and time[-1] <= POINTS * peak.grid:
            seen, name = np.arange(0, time[-1], peak.grid), "the source's grid"
            curves.append(Curve(seen, np.interp(seen, time, exact), name, BLACK, "none", "x", name=name))
    label = f"{one.signal.replace('_', ' ')} [{unit.replace('s2', 's²')}]"
    return Panel(one.signal.replace("_", " "), "time [s]", label, tuple(curves))


def _line(x: Array, y: Array) -> Curve:
    return Curve(x, y, "linear", BLUE, "solid", name="linear")


def _level(x: Array, value: float) -> Curve:
    return Curve(x[[0, -1]], np.array([value, value]), "printed", BLACK, "dash", name="printed", width=1.0)
