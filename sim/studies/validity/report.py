"""Output of maps of validity, and of heights at which the linear regime ends, as documents, JSON, CSV and figures."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from models.characteristics import LEAVES
from models.common.arrays import Array
from models.common.printed import as_name, finite, percent
from models.document.document import Document, Statement, Table, apart, notes
from models.document.field import Field, Record, at_most
from models.document.figure import BLACK, Classes, Curve, Figure, Marker, Panel
from models.document.picture import level
from models.document.reading import write_rows
from models.document.text import names_text
from models.roads.road import Bump
from models.vehicle.names import PLUS
from models.vehicle.vehicle import Vehicle
from sim.drive.regime import CURVE, END_NAMES, LAW_OVERFLOW, REGIME_ENDS, End
from sim.linear.prediction import NONLINEAR
from sim.studies.validity.edges import HEIGHT, edge_document, edges
from sim.studies.validity.grid import UNITS, GridAxis
from sim.studies.validity.regime_end import WITHIN, RegimeEnd
from sim.studies.validity.regime_map import Cells
from synth.controller.controller import Controller
from synth.controller.sampled_report import built_words

OneEnd = tuple[Controller, RegimeEnd | None]


SHARE = Field[float]("share of cells", float, "{:.1f} %".format, 100.0)
HOLDS = Field[Cells]("linear analysis holds", lambda of: of.share(lambda one: one.error <= of.threshold), SHARE.form, 100.0)
FIRST = tuple(
    Field[Cells](name, lambda of, i=i: float(np.mean(of.predicted == i)), SHARE.form, 100.0, column=column)
    for i, (name, column) in enumerate([("no limit reached", "nothing breaks"), *((f"{end} first", "") for end in END_NAMES)], -1)
)
VALIDITY = (
    Field[Cells]("controller", lambda cells: cells.controller.name),
    HOLDS,
    *FIRST,
    Field[Cells]("as predicted", lambda cells: cells.agreement, "{:.2f} %".format, 100.0),
    Field[Cells]("of the others not at a boundary", lambda cells: cells.unexplained, ".0f"),
)
RUN_HEIGHT = Field[float]("height", float, ".5g")  # the height has enough digits to repeat the run
THRESHOLD = Field[Cells]("threshold", lambda cells: cells.threshold, "g", 100.0, unit="%")
ENDS: tuple[Field[OneEnd], ...] = (
    Field("controller", lambda of: of[0].name),
    Field("predicted end", lambda of: of[1].predicted_end if of[1] else "at no height"),
    Field("at", lambda of: of[1] and of[1].predicted, RUN_HEIGHT.form, unit="m"),
    Field("MuJoCo stays linear at", lambda of: of[1] and of[1].stays, RUN_HEIGHT.form, unit="m"),
    Field("error, relative to a peak", lambda of: of[1] and of[1].error, "{:.1e}".format, column="off by, of a peak"),
    Field("MuJoCo reaches a limit at", lambda of: of[1] and of[1].leaves, RUN_HEIGHT.form, unit="m", column="and not at [m]"),
    Field("ended by", lambda of: of[1] and (of[1].end or "nothing")),
)


def write_csv(path: Path, cells: Cells) -> None:
    """Writes a CSV file with a row for each cell, in SI units.

    Entries are empty for limits that are not reached, and, in cells that were not simulated, for MuJoCo results.
    """
    rows, shares = _cells(cells), [f"linear_share_of_{end.replace(' ', '_').replace('-', '_')}" for end in END_NAMES]
    last = [key for key in ("missing_force", "simulated") if key in rows[0]]
    first = [key for key in rows[0] if key not in last]
    pairs = zip(rows, cells.used.tolist(), strict=True)
    lines = ([*(row[key] for key in first), *used, *(row[key] for key in last), True] for row, used in pairs)
    write_rows(path, itertools.chain([[*first, *shares, *last, "map_complete"]], lines))


def _cells(cells: Cells) -> list[dict[str, Any]]:
    """Returns a JSON object for each cell; it contains the share of missing force only if the vehicle has semi-active dampers."""
    dampers = any(math.isfinite(one.missing) for one in cells.driven.values())
    return [
        {
            **{name: getattr(bump, name) for name in UNITS},
            "error": one and finite(one.error),
            "holds": one and one.error <= cells.threshold,
            "broke_first": END_NAMES[one.first] if one and one.first >= 0 else None,
            "at": one and finite(one.time),
            "predicted": cells.end_of(i) or None,
            "predicted_at": finite(cells.predicted_time[i]),
            "agrees": one and i not in cells.others,
            "simulated": one is not None,
            **({"missing_force": one and one.missing} if dampers else {}),
        }
        for i, bump in enumerate(cells.bumps)
        for one in [cells.driven.get(i)]
    ]


RECORD = Record[Cells](
    controller="controller.name",
    axes=lambda cells: {axis.name: axis.values for axis in cells.axes},
    threshold="threshold",
    agreement="agreement",
    unexplained="unexplained",
    done=lambda cells: len(cells.bumps),
    complete=lambda cells: True,
    cells=_cells,
    edges=edges,
)


def describe(cells: Cells) -> Document:
    """Returns the printed document about a map of validity."""
    rows = ((field.label.removesuffix(" first"), field.cell(cells)) for field in FIRST if field.value(cells))
    table = Table("shares", "", ("first limit, predicted", "cells"), tuple(rows))
    texts = [
        f"MuJoCo simulated {len(cells.driven)} of {len(cells.bumps)} cells. In {HOLDS.cell(cells)} of these, linear analysis"
        f"{' with the slopes at equilibrium' * cells.vehicle.parts.nonlinear} is within "
        f"{THRESHOLD.text(cells.threshold)} of every peak."
    ]
    if np.any(cells.predicted == END_NAMES.index(CURVE.name)):
        off = f"{100 * LEAVES:g} % of its largest force"
        texts.insert(
            0, f"The curve of a spring or damper counts as a limit as soon as the force differs from its linearisation by {off}."
        )
    if away := cells.share(lambda one: one.broke_off == LAW_OVERFLOW):
        texts.append(f"In {SHARE.text(away)} of these runs, the states of the law overflow, so the law requests no finite force.")
    if cells.short:
        texts.append(
            f"Linear analysis is not valid at any height: {cells.short}. The limits in the map are predicted with the "
            "semi-active dampers."
        )
    parts = Document("", notes(*_loop_texts(cells))), edge_document(cells), Document("", (table, *notes(*texts)))
    return Document("", apart(*parts, *verdicts([cells])))


def _loop_texts(cells: Cells) -> list[str]:
    """Returns sentences about how linear analysis and MuJoCo treat the implementation, and about an unstable loop."""
    how, stability, texts = cells.vehicle.implementation, cells.controller.certificate, list[str]()
    if cells.controller.law.acts and (linear := built_words(cells.vehicle)):
        texts.append(f"Linear analysis is of the implemented loop: {linear}.")
    if cells.controller.law.acts and how.has_measurement_noise:
        texts.append(f"MuJoCo also has {how.noise_text}, which causes most of the error over small bumps.")
    if not stability.stable:
        texts.append(f"UNSTABLE loop; every run grows: {stability.own.words.removeprefix('unstable: ')}.")
    return texts


def compare_maps(maps: Sequence[Cells], timestep: float, without: str) -> Document:
    """Returns the document about the validity maps of several controllers over the same bumps, with figures.

    Args:
        maps: maps of validity, one for each controller.
        timestep: timestep of the simulation [s].
        without: text that states that noise and quantisation are omitted, such as ", without its noise"; empty if the runs omit
            nothing.
    """
    size = " by ".join(f"{len(axis.values)} {axis.name}s" for axis in maps[0].axes)
    text = (
        f"Bumps with {maps[0].fixed_text}, {size}. Colours show the first limit that one linear response per speed predicts. "
        f"MuJoCo simulates cells all over the map, and two bumps around every limit, at {1e3 * timestep:g} ms{without}.",
        f"Linear analysis{' with the slopes at equilibrium' * maps[0].vehicle.parts.nonlinear} holds in a run if it is within "
        f"{THRESHOLD.text(maps[0].threshold)} of every peak.",
    )
    caption = (
        "Shares of cells by first predicted limit, and shares of MuJoCo's runs in which linear analysis holds, or which "
        "are as predicted."
    )
    figures = (replace(envelope_figure(one), name=f"map-{one.controller.name}") for one in maps)
    blocks = (*verdicts(maps), *notes(*text), *figures, Table.of("validity", caption, VALIDITY, maps))
    return Document("Range of linear analysis over height and speed", blocks)


def verdicts(maps: Sequence[Cells]) -> list[Statement]:
    """Returns statements about validity maps: one for all controllers whose map MuJoCo confirms, and one for the other
    controllers.
    """
    statements = list[Statement]()
    for right in (True, False):
        if not (some := [one for one in maps if one.as_predicted == right]):
            continue
        driven, others = sum(len(one.driven) for one in some), sum(len(one.others) for one in some)
        names = names_text(one.controller.name for one in some)
        text = f"the map{'s' * (len(some) > 1)} of {names}: in {driven - others} of {driven} cells"
        if others:
            text += f" ({others - sum(one.unexplained for one in some)} of the other {others} are next to a boundary)"
        if ends := [end for one in some for end in one.ends.values()]:
            text += f" and at {sum(end.confirmed for end in ends)} of {len(ends)} edges"
            text += f", within {percent(math.ceil(1e3 * max(one.furthest for one in some) - 1e-6) / 1e3)}" if right else ""
        text += ", the first limit is the predicted limit."
        agreement = "agrees" if right else "DOES NOT AGREE"
        statements.append(Statement(f"MuJoCo {agreement} with {text}", "holds" if right else "fails"))
    return statements


def describe_ends(vehicle: Vehicle, ends: Sequence[OneEnd], wrong: Sequence[str], bump: Bump, where: str, runs: str) -> Document:
    """Returns the document about the bump height up to which linear analysis is valid.

    Args:
        vehicle: vehicle that drives over the bump.
        ends: height at which the linear regime ends, for each controller.
        wrong: names of controllers whose runs disagree with linear analysis. No height is stated for the controllers in
            `wrong`.
        where: name of the road on which the runs of the controllers in `wrong` disagree with linear analysis.
        bump: bump with the length and speed for which the heights were found.
        runs: text that states the duration and the timestep of the runs over the bump.
    """
    noise = f", without its {vehicle.implementation.noise_text}," if vehicle.implementation.has_measurement_noise else ""
    claimed = [(as_name(one.name), end) for one, end in ends if one.name not in wrong]
    confirmed = [end for _, end in claimed if end and end.confirmed]
    heights = [
        f"{name} {HEIGHT.text(end.found)} ({end.end})" if end else f"{name} any height"
        for name, end in claimed
        if not end or end in confirmed
    ]
    failed = [
        f"MuJoCo DOES NOT leave the linear range of {name} as predicted ({end.predicted_end} at {HEIGHT.text(end.predicted)})."
        for name, end in claimed
        if end and end not in confirmed
    ]
    if wrong:
        failed.append(f"For {names_text(wrong)}, no height is claimed: MuJoCo differs from linear analysis over {where}.")
    which = "the analysis with semi-active dampers" if vehicle.dampers else "linear analysis"
    which += "" if vehicle.ideal else f" of the implemented loop{noise}"
    text = f"Over bumps of {bump.length:g} m at {bump.speed:g} m/s, {which} is valid up to a height of: {'; '.join(heights)}."
    if confirmed:
        off = at_most(max(end.error for end in confirmed))
        text += (
            f" MuJoCo{noise} simulated bumps that are {percent(WITHIN - 1)} lower and higher than these heights. Over the "
            "lower bumps, no limit is reached, "
        )
        which = NONLINEAR if vehicle.parts.nonlinear else "analysis"
        text += f"and {which} is within {off} of every peak. Over the higher bumps, this limit is reached."
    statements = [*([Statement(text, "holds")] if heights else []), *(Statement(one, "fails") for one in failed)]
    note = f"One linear run of the implemented loop{noise} predicts the height of the first limit. Each run lasts {runs}."
    caption = (
        "Height of a bump up to which no limit is reached: the prediction, and the heights of the two MuJoCo runs that enclose "
        "this limit."
    )
    table = Table.of("regime", caption, ENDS, ends, words=2)
    return Document("Range of linear analysis over bumps", (*statements, *notes(note), table))


LABELS = {"height": "bump height [m]", "length": "bump length [m]", "speed": "speed [m/s]"}
NOTHING = "#dcefdc"


def envelope_figure(cells: Cells) -> Figure:
    """Returns the figure that shows a map of validity over the bumps.

    Colours show the predicted first limit, a line shows the edge of the linear regime, and markers show the MuJoCo runs. For a
    map with one axis, the figure shows the largest response relative to each limit instead.
    """
    vehicle, axes = cells.vehicle, cells.axes
    if len(axes) == 1:
        return _line_figure(cells, axes[0])
    # The height is on the vertical axis, whatever the order of the options; if the height does not vary, the length is on this
    # axis.
    shape = (len(axes[0].values), len(axes[1].values))
    turned = axes[1].name == "height" or axes[0].name == "speed"
    vertical, horizontal = (axes[1], axes[0]) if turned else (axes[0], axes[1])

    def plane(values):
        return values.reshape(shape).T if turned else values.reshape(shape)

    x, y = np.array(horizontal.values), np.array(vertical.values)
    colors = (NOTHING, *(end.color for end in REGIME_ENDS))
    first = (f"{end.name} first{_at(vehicle, end)}" for end in REGIME_ENDS)
    nothing = "no limit is reached" + "; dampers lack force" * bool(cells.short)
    ground = Classes(x, y, plane(cells.predicted + 1), colors, (nothing, *first))

    curves, used = [], plane(cells.used.max(axis=-1))
    if np.nanmin(used) < 1 < np.nanmax(used):
        curves.append(Curve(*level(x, y, np.log(used), 0.0), "predicted limit", "#000000", width=1.8))
    places = np.array([[getattr(bump, axis.name) for axis in (horizontal, vertical)] for bump in cells.bumps])
    ends = {i: end for i, end in cells.ends.items() if end.end}
    at = [(places[i, 0], end.found if vertical.name == "height" else places[i, 1]) for i, end in ends.items()]
    curves += [_marks(np.array(at), ENCLOSED_HEIGHT, "D")] if at else []
    curves += _markers(cells, places)
    return _figure(cells, LABELS[horizontal.name], LABELS[vertical.name], curves, ground)


ENCLOSED_HEIGHT = "MuJoCo: height enclosed by two runs"


def _markers(cells: Cells, places: Array) -> list[Curve]:
    """Returns the markers of the simulated cells in the figure of the map. `places` contains the figure coordinates of all
    cells, shape (N, 2).
    """
    within, kinds = f"{THRESHOLD.text(cells.threshold)} of a peak", dict[tuple[str, Marker], list[int]]()
    for i, one in cells.driven.items():
        kind: tuple[str, Marker] = ("no limit", "o")
        if i in cells.others:
            kind = ("another limit than predicted", "^")
        elif one.end and one.error <= cells.threshold:
            kind = (f"limit reached, analysis within {within}", "+")
        elif one.end:
            kind = (f"limit reached, analysis not within {within}", "x")
        kinds.setdefault(kind, []).append(i)
    return [_marks(places[mine], f"MuJoCo: {label}", marker) for (label, marker), mine in kinds.items()]


def _marks(points: Array, label: str, marker: Marker) -> Curve:
    """Returns black markers at some points, shape (N, 2). Black is legible on all colours that a map contains."""
    return Curve(points[:, 0], points[:, 1], label, BLACK, "none", marker)


def _figure(cells: Cells, xlabel: str, ylabel: str, curves: Sequence[Curve], ground: Classes | None = None) -> Figure:
    panel = Panel("", xlabel, ylabel, tuple(curves), ground)
    which = f"{cells.vehicle.kind.name.replace('_', ' ')}, controller {cells.controller.name}, with {cells.fixed_text}"
    which += f", under {PLUS.join(load.label for load in cells.loads)}" if cells.loads else ""
    title = f"First limit over bumps: {which}. Colours and lines are predicted. Markers show MuJoCo in {len(cells.driven)} of "
    title += f"{len(cells.bumps)} cells, {SHARE.text(cells.agreement)} of them as predicted"
    finding = f"With {as_name(cells.controller.name)}, no limit is reached over {FIRST[0].cell(cells)} of these bumps."
    return Figure("envelope", title, (panel,), columns=1, finding=finding)


def _line_figure(cells: Cells, axis: GridAxis) -> Figure:
    """Returns the figure of a map with one axis, which shows the largest response relative to each limit, and markers of the
    MuJoCo runs.
    """
    x, used = np.array(axis.values), cells.used
    curves = [
        Curve(x, used[:, i], f"{end.name}, linear analysis", end.color, width=1.8)
        for i, end in enumerate(REGIME_ENDS)
        if np.any(used[:, i] > 0)
    ]
    curves.append(Curve(x[[0, -1]], np.ones(2), "limit", "#000000", "dash", width=1.0))
    if axis.name == "height" and (at := [(end.found, 1.0) for end in cells.ends.values() if end.end]):
        curves.append(_marks(np.array(at), ENCLOSED_HEIGHT, "D"))
    curves += _markers(cells, np.stack([x, used.max(axis=-1, initial=0.0)], axis=-1))
    return _figure(cells, LABELS[axis.name], "largest response as a fraction of each limit", curves)


def _at(vehicle: Vehicle, end: End) -> str:
    """Returns a text that states the value of a limit, if this limit is the same in both directions.

    For a nonlinear characteristic, the text states the largest allowed difference from the linearisation.
    """
    if end is CURVE:
        return f" (differs from its line by {100 * LEAVES:g} % of its largest force)"
    limits = [limit for limit in end.thresholds(vehicle) if not limit.sign]
    values = {(limit.value, vehicle.kind.signal(limit.signal).unit + "/s" * limit.of_rate) for limit in limits}
    return "".join(f" (at ±{value:g} {unit})" for value, unit in values)
