"""Full-order H-infinity output feedback: as many states as the plant, and a norm next to what no controller can beat.

Riccati equations lead there (`riccati.py`). Where what they lead to stays above it, or its proof is lost by rounding, descents
are tried beside them (`descended.py`); of all controllers the best that can be proved is taken.

A discrete plant is designed as the continuous one that it is mapped to.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.numbers import percent
from models.law import LinearLaw
from synth.certificate.bounding import certify_tightly
from synth.certificate.certificate import FASTEST, Certificate
from synth.certificate.lower_bound import LowerBound
from synth.certificate.stability import is_stable
from synth.discrete.bilinear import mapped
from synth.dynamic.loop import on_larger_plant
from synth.errors import DesignError, InfeasibleError
from synth.full.descended import descents
from synth.full.discrete import discrete_law
from synth.full.riccati import SHARES, WITHIN, Search, Traded, chosen, leading
from synth.lmi.full_order import find_lower_bound
from synth.modes import obstacles
from synth.numerics import numerics
from synth.plant import GeneralizedPlant, check_posed, measurement_matrices

DEADBEAT = 4.0  # over dt: so fast is z = -1/3 on the map, and z = 0 half as fast; whatever sets a force in each sample can follow


@dataclass(frozen=True, eq=False)
class FullOrderDesign:
    """A full-order controller, and what nearer ones would cost.

    Attributes:
        law: on y = C_y x + Dyw w; as many states as the plant, but for those that would do next to nothing.
        certificate: what is true of its loop; its matrices are those of the plant with the law's states (`on_larger_plant`).
        trade: the controllers that no other beats in norm and speed, the slowest first; empty where what was asked for was found.
            Of a discrete plant they are those for the continuous one that it is mapped to.
        remark: how near it came and why no nearer, in words; empty where it is as near as was asked for.
        stable: whether the law is, by itself; one that is not grows while its loop is open, as when a force is at its limit.
    """

    law: LinearLaw
    certificate: Certificate
    trade: tuple[Traded, ...]
    remark: str
    stable: bool


@numerics()
def full_order_design(
    plant: GeneralizedPlant,
    Cy: Array,
    Dyw: Array | None = None,
    lower_bound: LowerBound | None = None,
    states: Sequence[str] = (),
    fastest: float = FASTEST,
) -> FullOrderDesign:
    """A full-order controller within 0.1 % of what no controller beats, stable and slow if may be; else the nearest not too fast.

    Args:
        plant: n states, m inputs.
        Cy: shape (q, n).
        Dyw: shape (q, r); zero where it is not given.
        lower_bound: what no controller from these measurements beats, if known.
        states: names of the states, for messages.
        fastest: times the plant's own speed; faster loops are taken only where no slower one is stable. Of a discrete plant
            deadbeat is never too fast.

    Raises:
        InputError: a matrix does not fit the plant, nothing disturbs it, or nothing is weighed.
        InfeasibleError: the plant cannot be stabilised from what is measured; the message names the mode.
        DesignError: no law was found whose loop is stable beyond rounding.
    """
    Cy, Dyw = measurement_matrices(plant, Cy, Dyw)
    check_posed(plant)
    if reasons := "; ".join(obstacles(plant, Cy, states)):
        raise InfeasibleError(reasons)
    below = find_lower_bound(plant, Cy, Dyw=Dyw) if lower_bound is None else lower_bound
    where = mapped(plant, Cy, Dyw)
    search = Search(where.plant, where.Cy, where.Dyw, below.gamma)
    if plant.dt is not None:
        fastest = max(fastest, DEADBEAT / plant.dt / search.fastest)

    def proved(best: Traded, trade: Sequence[Traded]) -> FullOrderDesign:
        reduced = search.reduced(best)
        law = reduced.law if plant.dt is None else discrete_law(reduced.law, where, plant.dt)
        certificate = certify_tightly(*on_larger_plant(plant, Cy, law, Dyw), below, by_itself=plant)
        if certificate.failures:
            raise DesignError(f"its certificate fails: {'; '.join(certificate.failures)}")
        remark = _remark(reduced, trade, below.gamma, fastest)
        return FullOrderDesign(law, certificate, tuple(trade), remark, is_stable(law.A, plant.dt))

    lost = list[Exception]()
    near = search.near(fastest)
    if near is not None:
        try:
            return proved(near, ())
        except (InputError, np.linalg.LinAlgError) as error:
            lost.append(error)
    trade = leading(search.trade(fastest))
    best = chosen(trade, fastest)
    if lost or best is None or best.norm > below.gamma * (1 + WITHIN):
        trade = leading([*trade, *descents(search, best, fastest)])
    left = trade
    while (best := chosen(left, fastest)) is not None:
        try:
            return proved(best, trade)
        except (InputError, np.linalg.LinAlgError) as error:
            lost.append(error)
            left = [each for each in left if each is not best]
    if lost:
        raise DesignError(str(lost[0])) from lost[0]
    raise DesignError(
        "no full-order controller was found whose loop is stable beyond rounding, with noise and cost from "
        f"{SHARES[0]:.2g} to {SHARES[-1]:.0e} of the plant's own size; measure more signals, or give other units"
    )


def _remark(best: Traded, trade: Sequence[Traded], bound: float, limit: float) -> str:
    """How near a controller came to a bound, and what a nearer one would cost; empty where it is near."""
    if bound and best.norm <= bound * (1 + WITHIN):
        return ""
    above = f"{percent(best.norm / bound - 1)} above the lower bound" if bound else "no lower bound is proved"
    least = min((each.norm for each in trade), default=best.norm) * (1 + WITHIN)
    if best.norm <= least:
        return f"{above}: of faster controllers that were tried none comes nearer; the bound is not sharp, or none attains it"
    nearer = min((each for each in trade if each.norm <= least), key=lambda each: each.speed_up)
    return (
        f"{above}: the nearest that was found, of norm {nearer.norm:.4g}, has a pole {nearer.speed_up:.2g} times as fast as the "
        f"plant's, and this one's fastest is {best.speed_up:.2g} times; {limit:.3g} times is much"
    )
