"""What slower computers cost, drawn: the norm over the sample period, a panel for each controller."""

import math
from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.figures.figure import Curve, Dash, Figure, Panel
from models.vehicle import Vehicle
from synth.rates.cost import AtRate, Cost
from synth.rates.words import late
from synth.sampled.norm import SampledNorm

POINTS = 60  # of a curve
HIGHEST = 1.5  # times the continuous norm: a loop that is nearly lost has no other end
MOST_TICKS = 9
PROMPT, LATE, DESIGNED, BEYOND = "#d62728", "#1f77b4", "#2ca02c", "#000000"


def drawn_periods(periods: Sequence[float]) -> list[float]:
    """Sample periods that a curve is drawn through: those asked for [s], ascending, and others between them."""
    between = np.geomspace(periods[0], periods[-1], POINTS) if len(periods) > 1 else []
    return sorted({*periods, *np.clip(between, periods[0], periods[-1]).tolist()})


def rates_figure(vehicle: Vehicle, costs: Sequence[Cost], periods: Sequence[float]) -> Figure:
    """The figure.

    Args:
        vehicle: the vehicle.
        costs: one per controller, at `drawn_periods`.
        periods: those that were asked for [s], which are marked.
    """
    title = (
        f"{vehicle.kind.name.replace('_', ' ')}: norm of the loop as a computer closes it, over its sample period; a curve "
        "ends where the loop is unstable"
    )
    panels = tuple(_panel(one, periods) for one in costs)
    return Figure("rates", title, panels) if len(panels) > 1 else Figure("rates", title, panels, 1, (6.5, 4.0))


def _panel(one: Cost, periods: Sequence[float]) -> Panel:
    asked = [at for at in one.rates if at.period in periods]
    ends = np.array([1e3 * one.rates[0].period, 1e3 * one.rates[-1].period])
    curves = []
    kinds: list[tuple[str, str, Dash, float]] = [("at once", PROMPT, "solid", one.lost), (late(one), LATE, "dash", one.lost_late)]
    for k, (name, color, dash, lost) in enumerate(kinds):
        curves.append(Curve(*_norms(one.rates, k), name, color, dash))
        curves.append(Curve(*_norms(asked, k), "", color, "none", "o", name=f"{name}, asked for"))
        if ends[0] <= 1e3 * lost <= ends[1]:
            curves.append(Curve(np.full(2, 1e3 * lost), np.array([0.0, 1e6]), "", color, "dot", width=0.8))
    designs = np.array([(1e3 * at.period, at.designed.value) for at in asked if at.designed is not None and at.designed.stable])
    if len(designs):
        curves.append(Curve(designs[:, 0], designs[:, 1], "designed for the rate", DESIGNED, "none", "+"))
    if math.isfinite(one.ideal):
        curves.append(Curve(ends, np.full(2, one.ideal), "in continuous time", "#808080", "dashdot", width=1.0))
    if one.lower_bound is not None:
        curves.append(Curve(ends, np.full(2, one.lower_bound), "lower bound of any controller", BEYOND, "dot", width=1.0))
    low, high = _shown(one)
    ticks = tuple(1e3 * period for period in periods) if len(periods) <= MOST_TICKS else ()
    room = 0.04 * (high - low) or 0.01 * high
    return Panel(
        f"controller {one.controller.name}",
        "sample period [ms]",
        "norm of the sampled loop",
        tuple(curves),
        xlog=True,
        xticks=ticks,
        ylim=(low - room, high + room),
    )


def _norms(rates: Sequence[AtRate], kind: int) -> tuple[Array, Array]:
    """Sample periods [ms], and norms, NaN where there are none."""
    norms = [_both(at)[kind].value for at in rates]
    return np.array([1e3 * at.period for at in rates]), np.where(np.isfinite(norms), norms, np.nan)


def _shown(one: Cost) -> tuple[float, float]:
    """The range that is shown."""
    norms = [norm.value for at in one.rates for norm in _both(at) if norm.stable]
    known = [value for value in (one.ideal, one.lower_bound) if value is not None and math.isfinite(value)]
    if not norms:
        return (0.0, max(known, default=1.0))
    highest = max(norms)
    return min([*norms, *known]), min(highest, HIGHEST * one.ideal) if known else highest


def _both(at: AtRate) -> tuple[SampledNorm, SampledNorm]:
    return at.prompt, at.late
