"""Summary of a report: the gain by control, and the range of the analysis, in one figure and one table."""

import math
from collections.abc import Sequence

import numpy as np

from models.common.printed import Column, cell
from models.figures.figure import Bars, Curve, Figure, Panel
from models.figures.page import Section, Table
from sim.report.headline import unclaimed
from sim.report.regime_end import RegimeEnd
from sim.report.ride import AVERAGE, SEEDS, SPEED, Ride
from sim.report.scope import Scope, percents
from sim.runs.run import Run
from sim.studies.ride.standing import Standing, compared_columns
from synth.controller.controller import Controller

NO_CLAIM = "no linear claim"
LEAST = 1e-4  # relative; less is below the digits that stand beside it


def summary(
    scope: Scope,
    runs: Sequence[Run],
    ends: Sequence[tuple[Controller, RegimeEnd | None]],
    rides: Sequence[Ride],
    compared: Sequence[Standing],
) -> Section:
    """Figure and tables, controller by controller.

    Args:
        scope: what the report is about.
        rides: over random roads; none in a quick report.
        compared: the controllers' standings, over random roads or, without rides, over the bump.
    """
    norms = {one.name: one.certificate.norm.value for one in scope.controllers if one.certificate.stable}
    passive = scope.designer.design("passive").certificate.norm.value
    roughness, label, unit, where = _roughness(scope, runs, rides)
    wrong = unclaimed(ends, runs)
    heights = {one.name: _height(end) for one, end in ends if end is not None and one.name not in wrong}

    shake = _bars(scope, norms, {}, {name: f"{value:.4g}{_against(value, passive)}" for name, value in norms.items()}, "unstable")
    words = {
        name: f"{cell(pair[0], '.3g')} {unit}{_against(pair[0], _passive(roughness))}"
        if math.isfinite(pair[0])
        else f"{cell(pair[1], '.3g')} {unit} in MuJoCo"
        for name, pair in roughness.items()
    }
    rough = _bars(
        scope,
        {name: pair[0] for name, pair in roughness.items()},
        {name: pair[1] for name, pair in roughness.items()},
        words,
        "unstable",
    )
    panels = [
        Panel(
            f"How hard can a road shake it?\nH-infinity norm of the ideal loop{scope.loop_qualifier}: shorter is better",
            "norm",
            "",
            *shake,
        ),
        Panel(f"How rough is the ride?\n{label}, {where}: shorter is better", f"{label} [{unit}]", "", *rough),
    ]
    stated = dict.fromkeys(wrong, "none claimed")
    for one, end in ends:
        if one.name not in wrong:
            stated[one.name] = "at any height" if end is None else _metres(heights[one.name])
    if ends:
        predicted, seen = ({name: pair[i] for name, pair in heights.items()} for i in (0, 1))
        tall = _bars(scope, predicted, seen, stated, "nowhere: unstable")
        panels.append(
            Panel(
                f"Up to which bump is the analysis true?\nheight at which it ends{scope.noise_qualifier}{_with(scope)}",
                "height [m]",
                "",
                *tall,
            )
        )
    title = (
        "What control gains, and until where the analysis is true. Bars: linear analysis. "
        f"Points: MuJoCo at {1e3 * scope.timestep:g} ms. Percentages are against the passive suspension."
    )
    figure = Figure("summary", title, tuple(panels), columns=len(panels))
    neither = (None, None)
    columns: tuple[Column[Run], ...] = (
        Column("controller", lambda run: run.controller.name),
        Column("H-infinity norm", lambda run: norms.get(run.controller.name), ".4g"),
        Column(f"{label} [{unit}], predicted", lambda run: roughness.get(run.controller.name, neither)[0], ".3g"),
        Column("in MuJoCo", lambda run: roughness.get(run.controller.name, neither)[1], ".3g"),
        Column(f"analysis true up to{scope.noise_qualifier}", lambda run: stated.get(run.controller.name, "-")),
        Column("over the paper's bump", lambda run: _verdict(scope, run)),
    )
    caption = "Each controller in short. How it is found out, and with which reservations, is said below."
    return Section("", "", (), (Table.of("summary", caption, columns, runs), compared_table(compared, bool(rides))), (figure,))


def compared_on(compared: Sequence[Standing], rides: bool) -> str:
    """Describes the roads that controllers are compared on: random ones or, without rides, the bump."""
    where = f"{len(SEEDS)} roads of class {AVERAGE} at {SPEED:g} m/s, largest peaks" if rides else "the paper's bump"
    absent = "; -: unstable, or a run broke off" if any(not any(one.values.values()) for one in compared) else ""
    return f"MuJoCo, {where}{absent}"


def compared_table(compared: Sequence[Standing], rides: bool) -> Table:
    """Returns the table of who is best at what."""
    columns, legend = compared_columns(compared)
    cells: dict[str, Sequence[str]] = {"controller": [one.controller for one in compared]}
    for column in columns:
        cells[column.measure.heading] = [number.rstrip() for number in column.numbers]
        if column.changes is not None:
            cells[f"{column.measure.title}, %"] = [change or "-" for change in column.changes]
    caption = f"Who is best at what, at the vehicle's worst point. {legend}{compared_on(compared, rides)}."
    return Table("compared", caption, tuple(cells), tuple(zip(*cells.values(), strict=True)))


def _roughness(scope: Scope, runs: Sequence[Run], rides: Sequence[Ride]) -> tuple[dict[str, tuple[float, float]], str, str, str]:
    """Returns the body's acceleration with stable loops, predicted and in MuJoCo: of the ride if there is one, else over the
    bump.
    """
    if rides:
        metric, unit = rides[0].metric, rides[0].unit
        some = [one for one in rides if (one.road_class, one.metric) == (AVERAGE, metric)]
        values = {one.controller: (one.predicted, one.measured) for one in some}
        return values, metric, unit.replace("s2", "s²"), f"road of class {AVERAGE} at {SPEED:g} m/s"
    vehicle = scope.vehicle
    name = next((name for name in vehicle.performance if name.endswith("acceleration")), next(iter(vehicle.performance)))
    values = {
        run.controller.name: (
            float(run.sampled.rms(name)) if isinstance(run.controller, Controller) else math.nan,
            float(run.physics.rms(name)),
        )
        for run in runs
        if not scope.unstable(run.controller)
    }
    unit = vehicle.kind.signal(name).unit.replace("s2", "s²")
    return values, f"{name.replace('_', ' ')}, rms", unit, "over the paper's bump"


def _with(scope: Scope) -> str:
    return ", with its dampers" if scope.vehicle.dampers else ""


def _metres(height: tuple[float, float]) -> str:
    """A height as MuJoCo has it; where that is not the predicted one, this is said."""
    predicted, measured = height
    return f"{measured:.3g} m" if math.isfinite(measured) else f"NOT as predicted, {predicted:.3g} m"


def _height(end: RegimeEnd) -> tuple[float, float]:
    """Returns the height of the end of a linear regime, predicted and in MuJoCo [m]."""
    return end.predicted, (end.stays + end.leaves) / 2 if end.confirmed else math.nan


def _passive(heights: dict[str, tuple[float, float]]) -> float:
    return heights["passive"][0] if "passive" in heights else math.nan


def _against(value: float, passive: float) -> str:
    """By how much it is more or less than the passive suspension's."""
    if not (math.isfinite(value) and math.isfinite(passive) and passive > 0) or value == passive:
        return ""
    share = value / passive - 1
    return f" ({'+' if share > 0 else '−'}{percents(share)} %)" if abs(share) >= LEAST else ""


def _bars(
    scope: Scope, values: dict[str, float], seen: dict[str, float], words: dict[str, str], none: str
) -> tuple[tuple[Curve, ...], Bars]:
    """A panel's points, which are MuJoCo's, and its bars."""
    names = tuple(scope.styles)
    lengths = np.array([values.get(name, math.nan) for name in names], dtype=float)
    lengths[~np.isfinite(lengths)] = math.nan
    said = {one.name: NO_CLAIM for one in scope.laws} | words
    bars = Bars(names, lengths, tuple(said.get(name, none) for name in names), tuple(scope.styles[name][0] for name in names))
    points = tuple(
        Curve(np.array([seen[name]]), np.array([float(k)]), "", "#000000", "none", "o", name=f"{name}, MuJoCo")
        for k, name in enumerate(names)
        if math.isfinite(seen.get(name, math.nan))
    )
    return points, bars


def _verdict(scope: Scope, run: Run) -> str:
    """Describes the agreement of physics and analysis in a few words."""
    until = run.agreement.until
    agrees = "agrees throughout" if until == math.inf else f"agrees until {until:.3g} s"
    unstable = "; the loop is UNSTABLE" if scope.unstable(run.controller) else ""
    return f"{agrees if run.passed else 'DOES NOT AGREE'}{unstable}"
