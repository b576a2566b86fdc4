"""Full-order H-infinity output feedback: as many states as the plant, and a norm next to what no controller can beat.

Without noise on the measurements, or with a force that costs nothing, the problem is singular: the best observer, or the best
gain, is infinitely fast, and the Riccati equations have no solution. So a share of noise and of cost is added where there is
none, in the plant's own units, in which a share means the same for all signals, and all states are disturbed and weighed a
little. The norm that the regularised problem promises holds for the true loop, which has fewer disturbances and outputs:

    norm of the true loop  <=  norm of the regularised loop  <  gamma,

and the larger the share, the slower the controller. So shares fall until the gamma that is asked for is reached, and the slowest
controller that reaches it is taken. Where none does, or none that an actuator could follow, the trade between norm and speed is
walked: for each share the smallest gamma that its problem allows.
"""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.numbers import percent
from models.law import LinearLaw
from synth.certificate.bounding import certify_tightly
from synth.certificate.certificate import FASTEST, Certificate
from synth.certificate.lower_bound import LowerBound
from synth.certificate.norm import level_set_norm
from synth.certificate.stability import beside_weights, is_stable, stability
from synth.discrete.bilinear import mapped
from synth.dynamic.central import central_law
from synth.dynamic.discrete import discrete_law
from synth.dynamic.loop import on_larger_plant
from synth.dynamic.measured import Measured, missing
from synth.dynamic.reduction import reduced_law
from synth.errors import DesignError, InfeasibleError
from synth.lmi.full_order import find_lower_bound
from synth.modes import obstacles
from synth.numerics import numerics
from synth.plant import GeneralizedPlant, check_posed, measurement_matrices
from synth.scaling import speed

WITHIN = 1e-3  # relative; so close to what no controller beats, nothing is left to gain
SHARES = tuple(10.0 ** (-k / 2) for k in range(-1, 17))  # of noise and of cost, of what drives the states and of what z weighs
STATES = 0.1  # of a share: by how much all states are disturbed and weighed
AROUND = tuple(10.0 ** (k / 8) for k in range(-8, 13))  # times the first share that does, further ones that are looked at
REACHES = (0.0, 2e-3, 1e-2, 3e-2)  # relative; how far beyond what is asked for gamma is taken: what is reached is often less
MARGINS = (
    1e-3,
    1e-2,
    1e-1,
    1.0,
)  # relative; how far above the smallest gamma that a problem allows laws are taken: further, slower
SAME = 1e-6  # relative; what a norm may rise by where states are left out of a law
CLOSE = 1e-4  # relative; how closely that gamma is found
GRAIN = 2.0**-14  # of an exponent of two
SMALLEST, LARGEST = 1e-6, 1e9  # gamma, in units in which a plant's numbers have size one


@dataclass(frozen=True, eq=False)
class Traded:
    """A controller on the way to the best norm.

    Attributes:
        share: of noise and cost that it was designed with.
        law: in the units given.
        own: the same in the plant's own units.
        norm: of its loop, by one route.
        speed_up: of the loop's fastest pole, over the plant's speed without control.
        stable: whether the law is, by itself.
    """

    share: float
    law: LinearLaw
    own: LinearLaw
    norm: float
    speed_up: float
    stable: bool

    @property
    def trouble(self) -> tuple[bool, float]:
        """What is to be small where norms are alike: a law that grows by itself is worst, for a force may be cut off."""
        return not self.stable, self.speed_up


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
        fastest: times the plant's own speed; faster loops are taken only where no slower one is stable.

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
    if plant.dt is not None:
        where = mapped(plant, Cy, Dyw)
        found = full_order_design(where.plant, where.Cy, where.Dyw, below, states, fastest)
        law = discrete_law(found.law, where, plant.dt)
        larger, G = on_larger_plant(plant, Cy, law, Dyw)
        certificate = _without_failures(certify_tightly(larger, G, below, by_itself=plant))
        return replace(found, law=law, certificate=certificate, stable=is_stable(law.A, plant.dt))
    search = _Search(plant, Cy, Dyw, below.gamma)
    near = search.near(fastest)
    trade = () if near is not None else tuple(search.trade())
    best = near or search.chosen(trade, fastest)
    if best is None:
        raise DesignError(
            "no full-order controller was found whose loop is stable beyond rounding, with noise and cost from "
            f"{SHARES[0]:.2g} to {SHARES[-1]:.0e} of the plant's own size; measure more signals, or give other units"
        )
    best = search.reduced(best)
    larger, G = on_larger_plant(plant, Cy, best.law, Dyw)
    certificate = _without_failures(certify_tightly(larger, G, below, by_itself=plant))
    return FullOrderDesign(best.law, certificate, trade, _remark(best, trade, below.gamma, fastest), best.stable)


def _without_failures(certificate: Certificate) -> Certificate:
    """The certificate, or a DesignError for what of it does not hold."""
    if certificate.failures:
        raise DesignError(f"its certificate fails: {'; '.join(certificate.failures)}")
    return certificate


def _remark(best: Traded, trade: Sequence[Traded], bound: float, limit: float) -> str:
    """How near a controller came to a bound, and what a nearer one would cost; empty where it is near."""
    if bound and best.norm <= bound * (1 + WITHIN):
        return ""
    above = f"{percent(best.norm / bound - 1)} above the lower bound" if bound else "no lower bound is proved"
    least = min((each.norm for each in trade), default=best.norm) * (1 + WITHIN)
    if best.norm <= least:
        return f"{above}: faster controllers hardly come nearer, so that the bound is not sharp or no controller attains it"
    nearer = min((each for each in trade if each.norm <= least), key=lambda each: each.speed_up)
    return (
        f"{above}: a norm of {nearer.norm:.4g} takes a pole {nearer.speed_up:.2g} times as fast as the plant's, and this one's "
        f"fastest is {best.speed_up:.2g} times; {limit:.3g} times is much"
    )


class _Search:
    """The search for one plant."""

    def __init__(self, plant: GeneralizedPlant, Cy: Array, Dyw: Array, bound: float) -> None:
        self.given, self.own = plant, Measured.of(plant, Cy, Dyw)
        self.bound = bound * self.own.norm
        self.fastest, _ = speed(plant)

    def near(self, fastest: float) -> Traded | None:
        """The controller within WITHIN of the bound with the least trouble, and not too fast; None where there is none."""
        target = _coarse(self.bound * (1 + WITHIN))
        if target < SMALLEST:
            return None
        found = list[Traded]()
        first = next((share for share in SHARES if self.reaches(target, share, target, found)), None)
        if first is not None:
            for reach, part in product(REACHES, AROUND):
                self.reaches(target, first * part, target * (1 + reach), found)
        return min((each for each in found if each.speed_up <= fastest), key=lambda each: each.trouble, default=None)

    def reaches(self, target: float, share: float, gamma: float, found: list[Traded]) -> bool:
        """Whether the controller of a share for some gamma has a norm of at most the target; then it is among what was found."""
        each = self.traded(share, gamma)
        if each is None or each.norm * self.own.norm > target:
            return False
        found.append(each)
        return True

    def trade(self) -> list[Traded]:
        """The controllers that no other beats in norm and speed, the slowest first, of all shares and of some gamma."""
        found, gamma = list[Traded](), LARGEST
        for share in SHARES:
            gamma = self.smallest(share, gamma)
            if gamma < LARGEST:
                tried = [self.traded(share, gamma * (1 + margin)) for margin in MARGINS]
                found += [each for each in tried if each is not None]
        found.sort(key=lambda each: (each.speed_up, each.norm))
        norms = np.minimum.accumulate([np.inf, *(each.norm for each in found)])
        return [each for each, least in zip(found, norms, strict=False) if each.norm < least]

    def chosen(self, trade: Sequence[Traded], fastest: float) -> Traded | None:
        """The one with the least trouble of those next to the smallest norm, of all that are not too fast; None of none.

        Where all are, the slowest stands for the plant.
        """
        if not trade:
            return None
        slowest = trade[0].speed_up
        limit = fastest if slowest <= fastest else fastest * slowest
        slow = [each for each in trade if each.speed_up <= limit]
        return min((each for each in slow if each.norm <= slow[-1].norm * (1 + WITHIN)), key=lambda each: each.trouble)

    def smallest(self, share: float, above: float) -> float:
        """The smallest gamma that the problem of a share allows; what one of a larger share allows, this one does, too."""
        low = max(_coarse(self.bound), SMALLEST)
        high, guess = above, 2 * low
        while high > low * (1 + CLOSE):
            middle = guess if guess < high else (low * high) ** 0.5
            try:
                self.law(share, middle)
                high = middle
            except InputError:
                low, guess = middle, 4 * guess
        return high

    def traded(self, share: float, gamma: float) -> Traded | None:
        """The controller of a share for some gamma, with its loop's norm; None where that is not stable, or there is none."""
        with contextlib.suppress(InputError):  # infeasible, or an entry is too large for a law
            return self.judged(share, self.law(share, gamma))
        return None

    def judged(self, share: float, law: LinearLaw) -> Traded | None:
        """A law in own units with the norm of its loop; None where that is not stable.

        Raises:
            InputError: an entry is too large for a law in the units given.
        """
        own, back = self.own, self.own.back(law)
        larger, G = on_larger_plant(own.plant, own.Cy, law, own.Dyw)
        loop = larger.closed_loop(G)
        found = stability(loop.A)
        if not found.stable:
            return None
        poles = np.linalg.eigvals(beside_weights(self.given, loop.A)) if self.given.weights else found.poles
        speed_up = own.rate * float(np.abs(poles).max()) / self.fastest
        return Traded(share, back, law, level_set_norm(loop)[0] / own.norm, speed_up, is_stable(law.A))

    def reduced(self, best: Traded) -> Traded:
        """A controller without states that do next to nothing, if its norm stays as it is and it is no more trouble."""
        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            law = reduced_law(best.own, FASTEST * self.fastest / self.own.rate)
            less = self.judged(best.share, law) if law.states < best.own.states else None
            if less is not None and less.norm <= best.norm * (1 + SAME) and less.stable >= best.stable:
                return less
        return best

    def law(self, share: float, gamma: float) -> LinearLaw:
        """The central law of the regularised problem, in own units.

        Raises:
            InfeasibleError: it has none for this gamma.
        """
        plant, Cy, Dyw = self.own.plant, self.own.Cy, self.own.Dyw
        n, (d, r) = len(plant.A), plant.Dw.shape
        cost, noise = missing(plant.D, share), missing(Dyw.T, share).T
        states = STATES * share * np.eye(n)
        m, q = len(cost), noise.shape[1]
        regular = GeneralizedPlant(
            A=plant.A,
            B=plant.B,
            Bw=np.hstack([plant.Bw, states, np.zeros((n, q))]),
            C=np.vstack([plant.C, states, np.zeros((m, n))]),
            D=np.vstack([plant.D, np.zeros((n, plant.B.shape[1])), cost]),
            Dw=np.block([[plant.Dw, np.zeros((d, n + q))], [np.zeros((n + m, r + n + q))]]),
        )
        return central_law(regular, Cy, np.hstack([Dyw, np.zeros((len(Cy), n)), noise]), gamma)


def _coarse(gamma: float) -> float:
    """A number a little smaller, the same for all within GRAIN of each other: bounds differ by rounding from unit to unit."""
    return float(np.exp2(np.floor(np.log2(gamma) / GRAIN) * GRAIN)) if gamma else 0.0
