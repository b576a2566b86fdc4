"""The search for a full-order controller by Riccati equations: near what no controller beats, or on the way there.

Without noise on the measurements, or with a force that costs nothing, the problem is singular: the best observer, or the best
gain, is infinitely fast, and the Riccati equations have no solution. So a share of noise and of cost is added where there is
none, in the plant's own units, in which a share means the same for all signals, and all states are disturbed and weighed a
little. The norm that the regularised problem promises holds for the true loop, which has fewer disturbances and outputs:

    norm of the true loop  <=  norm of the regularised loop  <  gamma,

and the larger the share, the slower the controller. So shares fall until the gamma that is asked for is reached, and the slowest
controller that reaches it is taken. Where none does, or none that an actuator could follow, the trade between norm and speed is
walked: for each share the smallest gamma that its problem allows.

Next to the best gamma the central law has poles that run away to the left, and what is left of it without them is as good: so of
each law that is too fast, one without its fast poles is tried, too.
"""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.law import LinearLaw
from synth.certificate.certificate import FASTEST
from synth.certificate.norm import level_set_norm
from synth.certificate.stability import beside_weights, is_stable, stability
from synth.dynamic.central import central_law
from synth.dynamic.loop import on_larger_plant
from synth.dynamic.measured import Measured, missing
from synth.dynamic.reduction import reduced_law
from synth.plant import GeneralizedPlant
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
PARTS = (1.0, 0.1)  # of the fastest that is allowed: poles of a law beyond it are left out
SMALLEST, LARGEST = 1e-6, 1e9  # gamma, in units in which a plant's numbers have size one


@dataclass(frozen=True, eq=False)
class Traded:
    """A controller on the way to the best norm.

    Attributes:
        share: of noise and cost that it was designed with; zero where it was found by descent.
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


def leading(found: Sequence[Traded]) -> list[Traded]:
    """The controllers that no other beats in norm and speed, the slowest first."""
    found = sorted(found, key=lambda each: (each.speed_up, each.norm))
    norms = np.minimum.accumulate([np.inf, *(each.norm for each in found)])
    return [each for each, least in zip(found, norms, strict=False) if each.norm < least]


def chosen(trade: Sequence[Traded], fastest: float) -> Traded | None:
    """The one with the least trouble of those next to the smallest norm, of all that are not too fast; None of none.

    Where all are, the slowest stands for the plant.

    Args:
        trade: the slowest first, each of a smaller norm than the one before.
        fastest: times the plant's own speed.
    """
    if not trade:
        return None
    slowest = trade[0].speed_up
    limit = fastest if slowest <= fastest else fastest * slowest
    slow = [each for each in trade if each.speed_up <= limit]
    return min((each for each in slow if each.norm <= slow[-1].norm * (1 + WITHIN)), key=lambda each: each.trouble)


class Search:
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
        slow = [each for each in found if each.speed_up <= fastest]
        if not slow:
            tried = self.slower(found, fastest)
            slow = [each for each in tried if each.norm * self.own.norm <= target and each.speed_up <= fastest]
        return min(slow, key=lambda each: each.trouble, default=None)

    def reaches(self, target: float, share: float, gamma: float, found: list[Traded]) -> bool:
        """Whether the controller of a share for some gamma has a norm of at most the target; then it is among what was found."""
        each = self.traded(share, gamma)
        if each is None or each.norm * self.own.norm > target:
            return False
        found.append(each)
        return True

    def trade(self, fastest: float) -> list[Traded]:
        """Controllers of all shares and of some gamma, and without their poles beyond the fastest where they have such."""
        found, gamma = list[Traded](), LARGEST
        for share in SHARES:
            gamma = self.smallest(share, gamma)
            if gamma < LARGEST:
                tried = [self.traded(share, gamma * (1 + margin)) for margin in MARGINS]
                found += [each for each in tried if each is not None]
        return found + self.slower(found, fastest)

    def slower(self, found: Sequence[Traded], fastest: float) -> list[Traded]:
        """Those that are too fast, without the poles of the law that make them so; none where the loop is lost by that."""
        left = list[Traded]()
        for each, part in product([each for each in found if each.speed_up > fastest], PARTS):
            with contextlib.suppress(InputError, np.linalg.LinAlgError):
                law = reduced_law(each.own, part * fastest * self.fastest / self.own.rate)
                less = self.judged(each.share, law) if law.states < each.own.states else None
                left += [less] if less is not None else []
        return left

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
