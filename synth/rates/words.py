"""What slower computers cost, in words and as `--json` has it."""

import math
import re
from collections.abc import Sequence
from typing import Any

from models.common.errors import some
from models.common.numbers import finite, percent
from models.common.printed import table, wrapped
from models.reality import LONGEST_PERIOD, samples_late
from synth.implemented.claims import norm_failures, proof_object
from synth.rates.cost import AtRate, Cost
from synth.rates.lost import SHORTEST
from synth.sampled.norm import SampledNorm

LITTLE = 1e-2  # relative: the slowest rate that costs no more is spoken of
SAME = 5e-9  # relative: what is nearer to the continuous norm is it


def cost_lines(one: Cost) -> list[str]:
    """A controller at all rates, a line each."""
    ideal = f"norm {one.ideal:.7g}" if math.isfinite(one.ideal) else "UNSTABLE"
    bound = f", lower bound {one.lower_bound:.7g}" if one.lower_bound is not None else ""
    designs = _has_designs(one)
    rows: list[tuple[str, ...]] = [("sample", "rate", "at once", "loses", "late", "loses", *("designed", "loses")[: 2 * designs])]
    for at in one.rates:
        norms = [at.prompt, at.late, *[at.designed][: int(designs)]]
        cells = [text for norm in norms for text in (_cells(one, norm) if norm is not None else ("-", ""))]
        rows.append((f"{1e3 * at.period:g} ms", f"{1 / at.period:.4g} Hz", *cells))
    return [f"controller {one.controller.name}: in continuous time {ideal}{bound}", *table(rows), *_undesigned_lines(one)]


def _has_designs(one: Cost) -> bool:
    """Whether it was designed anew for any rate, or that was tried."""
    return any(at.designed is not None or at.undesigned for at in one.rates)


def _undesigned_lines(one: Cost) -> list[str]:
    """Why a design is missing, a line for each reason: what happened, without what causes it and what to do."""
    missing: dict[str, list[AtRate]] = {}
    for at in one.rates:
        if at.undesigned:
            missing.setdefault(re.split("[:;]", at.undesigned)[0], []).append(at)
    return [line for why, rates in missing.items() for line in wrapped(f"  not designed for {_named(rates)}: {why}")]


def about_lines(costs: Sequence[Cost]) -> list[str]:
    """What the columns are."""
    designs = any(_has_designs(one) for one in costs)
    more = "; designed: anew, for the loop of that rate" if designs else ""
    loses = "loses: by how much the norm lies above that in continuous time"
    return [line for one in costs[:1] for line in wrapped(f"late: the forces act {late(one)}{more}; {loses}", hang=2)]


def late(one: Cost) -> str:
    """How late forces are that are late, in words."""
    return samples_late(one.delay)


def sentence(one: Cost) -> list[str]:
    """What it comes to, in a sentence that goes over some lines."""
    name = one.controller.name
    if not math.isfinite(one.ideal):
        held = any(norm is not None and norm.stable for at in one.rates for norm in (at.prompt, at.late, at.designed))
        said = f"controller {name} is unstable {'' if held else 'even '}in continuous time"
        return wrapped(f"{said}; {_ends(one)}" if held else said, hang=4)
    if not one.controller.law.acts:
        return wrapped(f"controller {name} asks for no force, so that no rate changes anything", hang=4)
    at = _spoken(one)
    said = f"at {1 / at.period:.4g} Hz controller {name} {_costs(one, at.prompt)}, {late(one)} {_costs(one, at.late)}"
    if at.designed is not None:
        said += f"; designed for it {_costs(one, at.designed)}"
    return wrapped(f"{said}; {_ends(one)}", hang=4)


def failures(one: Cost) -> list[str]:
    """What does not hold of the norms, in words."""
    name = one.controller.name
    return [
        f"controller {name} at {1e3 * at.period:g} ms, {how}: {text}"
        for at in one.rates
        for norm, how in ((at.prompt, "at once"), (at.late, late(one)), (at.designed, "designed for it"))
        for text in norm_failures(norm)
    ]


def cost_object(one: Cost) -> dict[str, Any]:
    """A controller at all rates as JSON has it: SI units, None for what is infinite or does not exist."""
    return {
        "name": one.controller.name,
        "norm": finite(one.ideal),
        "lower_bound": one.lower_bound,
        "delay": one.delay,
        "rates": [
            {
                "sample_period": at.period,
                "sampled_norm": _object(one, at.prompt),
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
    """A norm, what proves it, and what it loses; None where the loop is not stable."""
    if not norm.stable:
        return None
    return {
        "value": norm.value,
        "loss": finite(one.loss(norm)),
        **proof_object(norm),
    }


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
    cheap = [at for at in one.rates if at.prompt.stable and one.loss(at.prompt) <= LITTLE]
    return cheap[-1] if cheap else one.rates[0]


def _costs(one: Cost, norm: SampledNorm) -> str:
    if not norm.stable:
        return "is unstable"
    loss = one.loss(norm)
    return f"{'loses' if loss >= 0 else 'gains'} {percent(abs(loss) if abs(loss) > SAME else 0.0)}"


def _ends(one: Cost) -> str:
    """Where the loop is lost, at once and late."""
    if math.isinf(one.lost) and math.isinf(one.lost_late):
        return f"late or not it is stable at every rate down to {1 / LONGEST_PERIOD:g} Hz"
    slower_prompt = [at for at in one.rates if at.period > one.lost and at.prompt.stable]
    slower_late = [at for at in one.rates if at.period > one.lost_late and at.late.stable]
    return f"at once it {_lost(one.lost, slower_prompt)}, {late(one)} it {_lost(one.lost_late, slower_late)}"


def _lost(period: float, again: Sequence[AtRate]) -> str:
    """Where a loop is lost on the way from fast computers to slow ones, and which slower ones of the table keep it."""
    if math.isinf(period):
        return f"is stable at every rate down to {1 / LONGEST_PERIOD:g} Hz"
    said = f"loses stability at {1 / period:.3g} Hz" if period else f"is unstable even at {1e-3 / SHORTEST:g} kHz"
    if not again:
        return said
    return f"{said} ({_named(again)} {'is' if len(again) == 1 else 'are'} stable again)"


def _named(rates: Sequence[AtRate]) -> str:
    """Some rates by their sample periods, the first of many."""
    return some([f"{1e3 * at.period:g} ms" for at in rates])
