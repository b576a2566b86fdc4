"""Reports on the cost of low sample rates: in words, as JSON, and as a figure."""

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import first_few
from models.common.printed import finite, percent, table, wrapped
from models.document.figure import Curve, Dash, Figure, Panel
from models.vehicle.limits_and_implementation import LONGEST_PERIOD, delay_text
from models.vehicle.vehicle import Vehicle
from synth.analysis.specification import SampledNorm
from synth.controller.report import norm_failures, proof_object
from synth.vehicle.sample_rate.cost import SHORTEST, AtRate, Cost

LITTLE = 1e-2  # relative: the slowest rate that costs no more is spoken of
SAME = 5e-9  # relative: what is nearer to the continuous norm is it


def cost_lines(one: Cost, lag: str = "") -> list[str]:
    """Returns a line for each rate of a controller; `lag` describes the lag of the actuators, or is empty."""
    ideal = f"norm {one.ideal:.7g}" if math.isfinite(one.ideal) else "UNSTABLE"
    bound = f", lower bound {one.lower_bound:.7g}" if one.lower_bound is not None else ""
    designs = _has_designs(one)
    rows: list[tuple[str, ...]] = [
        ("sample", "rate", "at once", "change", "late", "change", *("designed", "change")[: 2 * designs])
    ]
    for at in one.rates:
        norms = [at.undelayed_norm, at.late, *[at.designed][: int(designs)]]
        cells = [text for norm in norms for text in (_cells(one, norm) if norm is not None else ("-", ""))]
        rows.append((f"{1e3 * at.period:g} ms", f"{1 / at.period:.4g} Hz", *cells))
    loop = f"in continuous time{', with ' if lag else ''}{lag}"
    first = wrapped(f"controller {one.controller.name}: {loop}{':' if lag else ''} {ideal}{bound}", hang=4)
    return [*first, *table(rows), *_undesigned_lines(one), *_previews([one])]


def short_lines(costs: Sequence[Cost]) -> list[str]:
    """Returns a row for each of many controllers: what the slowest cheap rate costs, and at which rates the loop is lost."""
    designs = any(_has_designs(one) for one in costs)
    headings = ("controller", "norm", "cheap at", "change", "late", *("anew",) * designs, "lost at", "late")
    rows: list[tuple[str, ...]] = [headings]
    for one in costs:
        at = _spoken(one)
        norms = [at.undelayed_norm, at.late, *[at.designed][: int(designs)]]
        losses = [_cells(one, norm) if norm is not None else ("", "-") for norm in norms]
        lost = ["-" if math.isinf(period) else _highest_lost(period) for period in (one.lost, one.lost_late)]
        ideal = f"{one.ideal:.7g}" if math.isfinite(one.ideal) else "UNSTABLE"
        rows.append((one.controller.name, ideal, f"{1 / at.period:.4g} Hz", *(loss or norm for norm, loss in losses), *lost))
    about = (
        f"cheap at: the slowest of these rates that costs {percent(LITTLE)} or less at once, or else the fastest; "
        f"late: the forces act {late(costs[0])}; {'anew: designed for the loop of that rate, at once; ' if designs else ''}"
        f"%: of the norm in continuous time; lost at: the highest rate at which the loop is unstable, -: none down to "
        f"{1 / LONGEST_PERIOD:g} Hz; -v: every rate"
    )
    return [*table(rows), *wrapped(about, "  ", 2), *_previews(costs)]


def _previews(costs: Sequence[Cost]) -> list[str]:
    """Returns a line that lists the controllers whose norms ignore their preview; empty if there are none."""
    names = [one.controller.name for one in costs if one.controller.preview is not None]
    return [f"  {', '.join(names)}: of the feedback alone, without the road ahead"] if names else []


def _has_designs(one: Cost) -> bool:
    """Returns True if a design for any rate was made or tried."""
    return any(at.designed is not None or at.undesigned for at in one.rates)


def _undesigned_lines(one: Cost) -> list[str]:
    """Returns a line for each reason of missing designs: what happened, without cause and remedy."""
    missing: dict[str, list[AtRate]] = {}
    for at in one.rates:
        if at.undesigned:
            missing.setdefault(re.split("[:;]", at.undesigned)[0], []).append(at)
    return [line for why, rates in missing.items() for line in wrapped(f"  not designed for {_named(rates)}: {why}")]


def about_lines(costs: Sequence[Cost], lag: str = "") -> list[str]:
    """Returns the explanation of the columns; `lag` is that of the actuators in words, empty without."""
    designs = any(_has_designs(one) for one in costs)
    more = "; designed: anew, for the loop of that rate with forces that act at once" if designs else ""
    change = "change: by how much the norm lies above that in continuous time, with a minus below it"
    plain = any(one.controller.hardware.bandwidth is None for one in costs)
    table_is = "; the design table of `python -m synth` has norms without that lag" if lag and plain else ""
    return [line for one in costs[:1] for line in wrapped(f"late: the forces act {late(one)}{more}; {change}{table_is}", hang=2)]


def late(one: Cost) -> str:
    """Returns the delay of the late forces, in words."""
    return delay_text(one.delay)


def sentence(one: Cost) -> list[str]:
    """Returns the result as a sentence, wrapped into lines."""
    name = one.controller.name
    if not math.isfinite(one.ideal):
        stable = any(norm is not None and norm.stable for at in one.rates for norm in (at.undelayed_norm, at.late, at.designed))
        text = f"controller {name} is unstable {'' if stable else 'even '}in continuous time"
        return wrapped(f"{text}; {_ends(one)}" if stable else text, hang=4)
    if not one.controller.law.acts:
        return wrapped(f"controller {name} asks for no force, so that no rate changes anything", hang=4)
    at = _spoken(one)
    text = f"at {1 / at.period:.4g} Hz controller {name} {_costs(one, at.undelayed_norm)}, {late(one)} {_costs(one, at.late)}"
    if at.designed is not None:
        text += f"; designed for it {_costs(one, at.designed)}"
    return wrapped(f"{text}; {_ends(one)}", hang=4)


def failures(one: Cost) -> list[str]:
    """Returns the failures of the norms, in words."""
    name = one.controller.name
    return [
        f"controller {name} at {1e3 * at.period:g} ms, {how}: {text}"
        for at in one.rates
        for norm, how in ((at.undelayed_norm, "at once"), (at.late, late(one)), (at.designed, "designed for it"))
        for text in norm_failures(norm)
    ]


def cost_object(one: Cost) -> dict[str, Any]:
    """Returns a controller at all rates as a JSON object: SI units, None for infinite or missing values."""
    return {
        "name": one.controller.name,
        "norm": finite(one.ideal),
        "lower_bound": one.lower_bound,
        "delay": one.delay,
        "rates": [
            {
                "sample_period": at.period,
                "sampled_norm": _object(one, at.undelayed_norm),
                "late_norm": _object(one, at.late),
                "designed_norm": _object(one, at.designed) if at.designed is not None else None,
                "not_designed": at.undesigned or None,
            }
            for at in one.rates
        ],
        "unstable_from": finite(one.lost),
        "late_unstable_from": finite(one.lost_late),
    }


def _object(one: Cost, norm: SampledNorm) -> dict[str, Any] | None:
    """Returns a norm with its proof and its loss as JSON; None if the loop is not stable."""
    if not norm.stable:
        return None
    return {"value": norm.value, "loss": finite(one.loss(norm)), **proof_object(norm)}


def _cells(one: Cost, norm: SampledNorm) -> tuple[str, str]:
    """A norm, and by how much it is above the continuous one."""
    if not norm.stable:
        return "UNSTABLE", ""
    loss = one.loss(norm)
    if not math.isfinite(loss):
        return f"{norm.value:.7g}", ""
    return f"{norm.value:.7g}", f"{'-' if loss < -SAME else '+'}{percent(abs(loss))}" if abs(loss) > SAME else "0 %"


def _spoken(one: Cost) -> AtRate:
    """The slowest rate that costs little, or else the fastest."""
    cheap = [at for at in one.rates if at.undelayed_norm.stable and one.loss(at.undelayed_norm) <= LITTLE]
    return cheap[-1] if cheap else one.rates[0]


def _costs(one: Cost, norm: SampledNorm) -> str:
    if not norm.stable:
        return "is unstable"
    loss = one.loss(norm)
    return f"{'loses' if loss >= 0 else 'gains'} {percent(abs(loss) if abs(loss) > SAME else 0.0)}"


def _ends(one: Cost) -> str:
    """Returns the stability limits without and with delay, in words."""
    if math.isinf(one.lost) and math.isinf(one.lost_late):
        return f"late or not it is stable at every rate down to {1 / LONGEST_PERIOD:g} Hz"
    slower_prompt = [at for at in one.rates if at.period > one.lost and at.undelayed_norm.stable]
    slower_late = [at for at in one.rates if at.period > one.lost_late and at.late.stable]
    return f"at once it {_lost(one.lost, slower_prompt)}, {late(one)} it {_lost(one.lost_late, slower_late)}"


def _lost(period: float, again: Sequence[AtRate]) -> str:
    """Returns the highest unstable rate in words, and the slower rates of the table that are stable again."""
    if math.isinf(period):
        return f"is stable at every rate down to {1 / LONGEST_PERIOD:g} Hz"
    text = f"{'loses stability' if period else 'is unstable even'} at {_highest_lost(period)}"
    if not again:
        return text
    return f"{text} ({_named(again)} {'is' if len(again) == 1 else 'are'} stable again)"


def _highest_lost(period: float) -> str:
    """Returns the highest unstable rate, in words: the fastest of all if no rate is stable, as a period of 0 says."""
    return f"{1 / period:.3g} Hz" if period else f"{1e-3 / SHORTEST:g} kHz"


def _named(rates: Sequence[AtRate]) -> str:
    """Returns the sample periods of the first few rates, in words."""
    return first_few([f"{1e3 * at.period:g} ms" for at in rates])


POINTS = 60  # of a curve
HIGHEST = 1.5  # times the continuous norm: a loop that is nearly lost has no other end
MOST_TICKS = 9
PROMPT, LATE, DESIGNED, BEYOND = "#d62728", "#1f77b4", "#2ca02c", "#000000"


def drawn_periods(periods: Sequence[float]) -> list[float]:
    """Returns the sample periods of a curve [s], ascending: the requested ones, and others between them."""
    between = np.geomspace(periods[0], periods[-1], POINTS) if len(periods) > 1 else []
    return sorted({*periods, *np.clip(between, periods[0], periods[-1]).tolist()})


def rates_figure(vehicle: Vehicle, costs: Sequence[Cost], periods: Sequence[float]) -> Figure:
    """Returns the figure of norms over the sample period.

    Args:
        costs: cost of each controller, at `drawn_periods`.
        periods: requested ones [s], which are marked.
    """
    title = (
        f"{vehicle.kind.name.replace('_', ' ')}: norm of the loop as a computer closes it, over its sample period; a curve "
        "ends where the loop is unstable"
    )
    panels = tuple(_panel(one, periods) for one in costs)
    return Figure("rates", title, panels, min(2, len(panels)))


def _panel(one: Cost, periods: Sequence[float]) -> Panel:
    marked = [at for at in one.rates if at.period in periods]
    ends = np.array([1e3 * one.rates[0].period, 1e3 * one.rates[-1].period])
    curves = []
    kinds: list[tuple[str, str, Dash, float]] = [("at once", PROMPT, "solid", one.lost), (late(one), LATE, "dash", one.lost_late)]
    for k, (name, color, dash, lost) in enumerate(kinds):
        curves.append(Curve(*_norms(one.rates, k), name, color, dash))
        curves.append(Curve(*_norms(marked, k), "", color, "none", "o", name=f"{name}, asked for"))
        if ends[0] <= 1e3 * lost <= ends[1]:
            curves.append(Curve(np.full(2, 1e3 * lost), np.array([0.0, 1e6]), "", color, "dot", width=0.8))
    designs = np.array([(1e3 * at.period, at.designed.value) for at in marked if at.designed is not None and at.designed.stable])
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
    return at.undelayed_norm, at.late
