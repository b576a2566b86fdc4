"""Reports on the cost of low sample rates: as text, as JSON, and as a figure."""

import math
import re
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.printed import by_text, percent
from models.document.document import Detail, Document, Table, notes, statements
from models.document.field import Field, Record
from models.document.figure import Curve, Dash, Figure, Panel
from models.vehicle.limits_and_implementation import LONGEST_PERIOD, delay_text
from models.vehicle.vehicle import Vehicle
from synth.analysis.specification import SampledNorm
from synth.controller.report import LOWER_BOUND, NORM
from synth.controller.sampled_report import NORM_AS_IMPLEMENTED, PROOF, norm_failures
from synth.vehicle.sample_rate.cost import SHORTEST, AtRate, Cost

LITTLE = 1e-2  # a sample rate counts as cheap if the norm exceeds the continuous norm by at most this relative amount
SAME = 5e-9  # a norm counts as equal to the continuous norm if the relative difference is smaller than this
FEW = 2  # largest number of controllers for which separate tables are printed; more tables would not fit a terminal
Kind = Callable[[AtRate], SampledNorm | None]  # function that selects one of the norms computed at a sample rate
KINDS: dict[str, Kind] = {
    "at once": lambda at: at.undelayed_norm,
    "late": lambda at: at.delayed_norm,
    "designed": lambda at: at.designed_norm,
}


def describe(costs: Sequence[Cost], lag: str = "") -> Document:
    """Returns a document about the cost of low sample rates: a summary with a row for each controller, and a table for each
    controller.

    Args:
        costs: norms of each controller at several sample rates.
        lag: description of the actuator lag; empty if there is no lag.
    """
    kinds = [name for name in KINDS if name != "designed" or any(one.redesigned for one in costs)]
    fields = [
        Field[Cost]("controller", lambda one: one.controller.name),
        Field[Cost]("cheap [Hz]", lambda one: HERTZ.digits(1 / _cheap(one).period)),
        *(Field[Cost](name, lambda one, kind=KINDS[name]: _loss(one, kind, _cheap(one))) for name in kinds),
        Field[Cost]("lost [Hz]", lambda one: _highest_unstable_rate(one.unstable_period)),
        Field[Cost]("lost late", lambda one: _highest_unstable_rate(one.lost_late)),
    ]
    alone = [one.controller.name for one in costs if one.controller.preview is not None]
    texts = statements((name, "the norm describes the feedback without the preview") for name in alone)
    plain = lag and any(one.controller.hardware.bandwidth is None for one in costs)
    texts += [*notes(*(about(costs[0], lag if plain else "", "designed" in kinds) for _ in costs[:1]))]
    caption = (
        "The slowest sample rate at which the norm rises only a little, the change of the norm at this rate, and the highest "
        "sample rate at which the loop is unstable."
    )
    tables = [_table(one, lag, "normal" if len(costs) <= FEW else "full") for one in costs]
    return Document("Sample rates", (Table.of("rates", caption, fields, costs, detail="brief"), *texts, *tables))


def about(one: Cost, lag: str, designs: bool) -> str:
    """Returns notes that explain the columns of the table of sample rates.

    Args:
        one: norms of a controller at several sample rates.
        lag: description of the actuator lag, which the norms in the table of designs do not include; empty if there is no lag.
        designs: True if the table has a column for controllers that are designed for each sample rate.
    """
    designed = "designed: change with a gain designed for this rate. " if designs else ""
    text = (
        f"cheap: the slowest rate that raises the norm by at most {percent(LITTLE)}, or else the fastest rate. at once, late: "
        f"change of the norm if forces act at once, or {delay_text(one.delay)}. {designed}lost: the highest unstable rate, or "
        f"- if no unstable rate is found down to {1 / LONGEST_PERIOD:g} Hz."
    )
    return f"{text} Norms include {lag}; the norms of the design table do not." if lag else text


def _table(one: Cost, lag: str, detail: Detail) -> Document:
    """Returns a document about one controller, which contains the controller's norm at each sample rate."""
    ideal = NORM.digits(one.ideal) if math.isfinite(one.ideal) else "UNSTABLE"
    bound = f", lower bound {LOWER_BOUND.digits(one.lower_bound)}" if one.lower_bound is not None else ""
    name = one.controller.name
    title = f"controller {name}: norm in continuous time{', with ' if lag else ''}{lag} is {ideal}{bound}"
    fields = [RATE, *(Field[AtRate](label, partial(_cell, one, KINDS[label])) for label in [*KINDS][: 2 + one.redesigned])]
    table = Table.of(f"rates-{name}", "The norm at each rate, and its change relative to continuous time.", fields, one.rates)
    missing = by_text(
        (f"{1e3 * at.period:g} ms", re.split("[:;]", at.design_failure)[0]) for at in one.rates if at.design_failure
    )
    return Document(title, (table, *notes(*(f"no design at {rates}: {why}" for why, rates in missing.items()))), detail)


RATE = Field[AtRate]("sample", lambda at: f"{1e3 * at.period:g} ms ({HERTZ.text(1 / at.period)})")
HERTZ = Field[float]("rate", lambda rate: rate, ".4g", unit="Hz")


def _cheap(one: Cost) -> AtRate:
    """Returns the slowest sample rate at which the norm increases by at most `LITTLE`, or the fastest rate if there is no such
    rate.
    """
    cheap = [at for at in one.rates if at.undelayed_norm.stable and one.loss(at.undelayed_norm) <= LITTLE]
    return cheap[-1] if cheap else one.rates[0]


def _loss(one: Cost, kind: Kind, at: AtRate) -> str:
    """Formats the relative difference between a norm and the norm of the continuous loop; "UNSTABLE" if the loop is unstable."""
    norm = kind(at)
    if norm is None or not norm.stable:
        return "UNSTABLE" if norm is not None else "-"
    loss = one.loss(norm)
    sign = "-" if loss < -SAME else "+" if loss > SAME else ""
    return f"{sign}{percent(abs(loss) if sign else 0.0)}" if math.isfinite(loss) else ""


def _cell(one: Cost, kind: Kind, at: AtRate) -> str:
    """Formats a norm and its relative difference from the norm of the continuous loop."""
    norm, loss = kind(at), _loss(one, kind, at)
    if norm is None or not norm.stable:
        return loss
    return NORM_AS_IMPLEMENTED.cell(norm) + (f" ({loss})" if loss else "")


def _highest_unstable_rate(period: float) -> str | None:
    """Formats the highest sample rate at which the loop is unstable; None if the loop is stable at all rates. A period of 0
    means that the loop is unstable at all sample rates.
    """
    return None if math.isinf(period) else UNSTABLE_RATE.digits(1 / (period or SHORTEST))


UNSTABLE_RATE = Field[float]("rate", float, ".3g", unit="Hz")


def failures(one: Cost) -> list[str]:
    """Describes, as text, which checks of the norms failed."""
    name = one.controller.name
    return [
        f"controller {name} at {1e3 * at.period:g} ms, {how}: {text}"
        for at in one.rates
        for norm, how in (
            (at.undelayed_norm, "at once"),
            (at.delayed_norm, delay_text(one.delay)),
            (at.designed_norm, "designed for it"),
        )
        for text in norm_failures(norm)
    ]


def _norm(one: Cost, norm: SampledNorm | None) -> dict[str, Any] | None:
    """Returns, for JSON, a norm with its proof and its relative difference from the continuous norm; None if the loop is not
    stable.
    """
    if norm is None or not norm.stable:
        return None
    return {"value": norm.value, "loss": one.loss(norm), **PROOF(norm)}


AT_RATE = Record[tuple[Cost, AtRate]](
    sample_period=lambda of: of[1].period,
    **{
        f"{key}_norm": lambda of, kind=kind: _norm(of[0], kind(of[1]))
        for key, kind in zip(("sampled", "late", "designed"), KINDS.values(), strict=True)
    },
    not_designed=lambda of: of[1].design_failure or None,
)
RECORD = Record[Cost](
    name="controller.name",
    norm="ideal",
    lower_bound="lower_bound",
    delay="delay",
    rates=AT_RATE.all(lambda one: [(one, at) for at in one.rates]),
    unstable_from="unstable_period",
    late_unstable_from="lost_late",
)


POINTS = 60  # number of points of a curve in the figure
# largest norm that the figure shows, as a multiple of the continuous norm, because the norm grows without bound near the
# stability limit
HIGHEST = 1.5
MOST_TICKS = 9
PROMPT, LATE, DESIGNED_COLOUR, BEYOND = "#d62728", "#1f77b4", "#2ca02c", "#000000"


def drawn_periods(periods: Sequence[float]) -> list[float]:
    """Returns the sample periods of a curve in ascending order [s]: the requested periods, and additional periods between the
    requested ones.
    """
    between = np.geomspace(periods[0], periods[-1], POINTS) if len(periods) > 1 else []
    return sorted({*periods, *np.clip(between, periods[0], periods[-1]).tolist()})


def rates_figure(vehicle: Vehicle, costs: Sequence[Cost], periods: Sequence[float]) -> Figure:
    """Returns the figure of norms as a function of the sample period.

    Args:
        vehicle: vehicle of the controllers, for the title.
        costs: norms of each controller at `drawn_periods`.
        periods: requested sample periods, which are marked [s].
    """
    title = (
        f"{vehicle.kind.name.replace('_', ' ')}: norm of the sampled-data loop over its sample period; a curve ends where the "
        "loop is unstable"
    )
    panels = tuple(_panel(one, periods) for one in costs)
    return Figure("rates", title, panels, min(2, len(panels)))


def _panel(one: Cost, periods: Sequence[float]) -> Panel:
    marked = [at for at in one.rates if at.period in periods]
    ends = np.array([1e3 * one.rates[0].period, 1e3 * one.rates[-1].period])
    curves = []
    late = ("late", delay_text(one.delay), LATE, "dash", one.lost_late)
    kinds: list[tuple[str, str, str, Dash, float]] = [("at once", "at once", PROMPT, "solid", one.unstable_period), late]
    for kind, name, color, dash, lost in kinds:
        curves.append(Curve(*_norms(one.rates, KINDS[kind]), name, color, dash))
        curves.append(Curve(*_norms(marked, KINDS[kind]), "", color, "none", "o", name=f"{name}, requested"))
        if ends[0] <= 1e3 * lost <= ends[1]:
            curves.append(Curve(np.full(2, 1e3 * lost), np.array([0.0, 1e6]), "", color, "dot", width=0.8))
    designs = np.array(
        [(1e3 * at.period, at.designed_norm.value) for at in marked if at.designed_norm is not None and at.designed_norm.stable]
    )
    if len(designs):
        curves.append(Curve(designs[:, 0], designs[:, 1], "designed for the rate", DESIGNED_COLOUR, "none", "+"))
    if math.isfinite(one.ideal):
        curves.append(Curve(ends, np.full(2, one.ideal), "in continuous time", "#808080", "dashdot", width=1.0))
    if one.lower_bound is not None:
        curves.append(Curve(ends, np.full(2, one.lower_bound), "lower bound of any controller", BEYOND, "dot", width=1.0))
    low, high = _shown_range(one)
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


def _norms(rates: Sequence[AtRate], kind: Kind) -> tuple[Array, Array]:
    """Returns the sample periods [ms] and the norms of a curve; the norm of an unstable loop is NaN."""
    norms = [norm.value for at in rates if (norm := kind(at)) is not None]
    return np.array([1e3 * at.period for at in rates]), np.where(np.isfinite(norms), norms, np.nan)


def _shown_range(one: Cost) -> tuple[float, float]:
    """Returns the lower and upper limit of the axis for norms in the figure."""
    norms = [norm.value for at in one.rates for norm in (at.undelayed_norm, at.delayed_norm) if norm.stable]
    known = [value for value in (one.ideal, one.lower_bound) if value is not None and math.isfinite(value)]
    if not norms:
        return (0.0, max(known, default=1.0))
    highest = max(norms)
    return min([*norms, *known]), min(highest, HIGHEST * one.ideal) if known else highest
