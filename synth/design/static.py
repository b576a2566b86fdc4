"""Static output-feedback design by multi-start descent on the H-infinity norm.

The search returns the best gain that it finds with a fixed amount of work, with every entry at most `largest_gain`. It cannot
guarantee a global optimum, because the problem is not convex. Two measures reduce the risk of a poor local minimum:

- Many starts (`descent/starts.py`): no control, samples of every size, stabilising gains if few samples are stable, and the
  refined result of the paper's two steps. All of them descend for a few rounds, the best of these for more rounds, and the best
  of all until it converges. The descent (`descent/minimax.py`) uses edges and curvature, in coordinates in which all directions
  have similar effect.
- Further descents from the surroundings of the best.

A result is never replaced by a worse one, so the norm is at most that of the refined two steps, and that without control. If
several gains have the same norm, the search returns the smallest multiple. All samples have fixed seeds, so the same plant always
gives the same gain.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from models.common.arrays import Array
from models.common.checks import Bound
from models.common.errors import InputError
from models.laws.linear import static_law
from synth.analysis.bounding import certify_law
from synth.analysis.lower_bound import LowerBound
from synth.design.descent.landscape import Landscape, Work, price
from synth.design.descent.minimax import descend_norm
from synth.design.descent.refine import own_norm, refine
from synth.design.descent.starts import around, projected_starts, stabilising_starts, state_feedback_start, survey
from synth.design.problem import DESCENT, LARGEST_GAIN, DesignResult
from synth.design.two_step import independent_rows, no_gain, two_step_design, with_redundant_rows
from synth.plant.generalized import Plant, check_inputs
from synth.plant.numerics import DesignError, numerics, up_to_rounding
from synth.plant.units import size

ENOUGH_SAMPLES = 4  # decades of size with a stable sample; then a few stabilising starts will do
FEW, MANY, MOST = 2, 6, 18  # stabilising starts: with enough samples, with fewer, and where nothing else is found
LARGE = 30  # states; with more a stabilising start takes minutes, and is for where a Riccati equation leads to none
ALL = 100  # starts; there are never so many
# Rounds of descent, from how many of the best starts, and the share of a rival's norm above which the search ends.
HEATS = ((10, ALL, 1.1), (30, 5, 1.1), (60, 2, 1.03), (300, 2, 1.03))
LAST_ROUNDS = 1200  # rounds of the last descent; a large plant, whose rounds take long, has fewer
AGAINST = 3  # starts against a rival
MOST_STARTS = 8  # starts of a plant of `LARGE` states; a larger plant has fewer, so that all cost the same
SAME = 1e-4  # relative; two descents that end this close have found the same minimum
BOUND_TOLERANCE = 1e-4  # relative; this close to what no controller beats, the search ends
NEAR = 1e-3  # relative; how far above that a state feedback begins: the nearer its norm, the larger its gain
ZERO = 1e-9  # of the size of the plant's matrices; a norm this small is zero
SURROUNDINGS = (0.1, 0.3, 1.0)  # how far from the winner further descents start, in logarithms
AROUND = 60  # rounds of each of these descents
EQUAL = 1e-9  # relative; norms this close are the same to the rounding of two routes
SHARES = tuple(0.5**k for k in range(1, 41))  # of a gain, tried for the same norm,
DIFFERENT_STARTS = 3  # until so many in a row have another,
HALVINGS = 10  # and then halved to the smallest that has it, to a thousandth
LIMIT = 3e4  # norms of loops of 8 states: 7 to 18 s of processor time


class Candidate(NamedTuple):
    """A stable point, its norm, and the start that led to it."""

    x: Array
    norm: float
    origin: str


def bounded_work(plant: Plant) -> Work:
    """Returns the work that the search for one controller of a plant may do; more for plants of more than 8 states."""
    return Work(LIMIT * max(1.0, price(len(plant.A), 0)))


@numerics()
def static_output_feedback(
    plant: Plant,
    Cy: Array | None = None,
    largest_gain: Bound = LARGEST_GAIN,
    lower_bound: LowerBound | None = None,
    Dyw: Array | None = None,
    rival: float = np.inf,
) -> DesignResult:
    """The best static gain that the search finds, no entry larger than `largest_gain`.

    Args:
        plant: n states, m inputs.
        Cy: shape (q, n), the plant's own if it is not given; rows that follow from others get a gain of zero.
        largest_gain: bound on |K_ij|, in the units given: another unit is another problem. Where the infimum lies at infinity,
            this is what keeps the gain finite. (The search itself is made in balanced coordinates, and of two that differ by
            units one may end in another valley; what is proved of either is true.)
        lower_bound: lower bound on the norm of any such controller: ends the search early, and is part of the certificate.
        Dyw: shape (q, r), for y = C_y x + Dyw w; zero where it is not given. The two steps know no noise, and are where one
            descent starts.
        rival: a norm that is reached otherwise; a gain that stays far above it is not followed further. Infinite without one.

    Raises:
        InputError: the plant has no state, or a matrix does not fit it.
        DesignError: no stabilising gain was found.

    Example:
        >>> from synth import GeneralizedPlant, static_output_feedback
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> design = static_output_feedback(oscillator, Cy=[[0, 1]])
        >>> design.gain.shape, f"{design.certificate.norm.value:.4f}"
        ((1, 1), '0.2500')
    """
    check_inputs(plant)
    plant = plant.measured(Cy, Dyw)
    rows = independent_rows(plant)
    independent = plant.rows(rows)
    try:
        two_steps = two_step_design(independent)
    except InputError as error:
        two_steps = str(error)
    (found,) = design_by_descent(independent, two_steps, largest_gain, lower_bound, rival)
    return with_redundant_rows(found, rows, len(plant.Cy), 0.0)


@numerics()
def design_by_descent(
    plant: Plant,
    two_steps: DesignResult | str,
    largest_gain: float = LARGEST_GAIN,
    lower_bound: LowerBound | None = None,
    rival: float = np.inf,
    limits: Sequence[float] = (np.inf,),
    work: Work | None = None,
) -> list[DesignResult]:
    """Designs static gains by descents within one limit after the other, until poles are not beyond any actuator.

    Args:
        plant, largest_gain, lower_bound, rival: arguments of `static_output_feedback`.
        two_steps: result of the two steps, or the reason why they found no gain.
        limits: bounds on the entries of a gain in the landscape's units, in which 1 moves poles as fast as the plant's.
        work: counts the norms of all searches; each has its own `bounded_work` if it is not given.
    """
    steps, instead = (two_steps, "") if isinstance(two_steps, DesignResult) else (None, two_steps)
    ends = list[DesignResult]()
    for limit in limits:
        counted, below = work or bounded_work(plant), lower_bound.gamma if lower_bound is not None else 0.0
        search = GainSearch(plant, largest_gain, below, rival=rival, work=counted)
        search.limit = np.minimum(search.limit, limit)
        candidates = search.starts()
        starts = len(candidates)
        candidates += search.refined(steps) if steps is not None else []
        if not candidates:
            tried = f"descent on the norm from {MOST} starts{f', {counted.text}' if counted.over else ''}"
            raise DesignError(no_gain(tried, f"allow a larger gain than {largest_gain:g}, "))
        best = search.best(candidates)
        law = static_law(search.smallest(best))
        certificate, remarks = certify_law(plant, law, lower_bound), (counted.text,) * counted.over
        given = law, certificate, DESCENT
        ends.append(DesignResult(*given, remarks=remarks, instead=instead, origin=best.origin, two_steps=steps, starts=starts))
        if not certificate.beyond_actuators:
            break
    return ends


class GainSearch:
    """The search for one plant, and for one structure of its gain."""

    def __init__(
        self,
        plant: Plant,
        largest_gain: float,
        lower_bound: float,
        structure: Array | None = None,
        alike: Callable[[Landscape, Array], Array] = lambda landscape, x: x,
        enough: float = BOUND_TOLERANCE,
        rival: float = np.inf,
        work: Work | None = None,
    ) -> None:
        """Args:
        largest_gain: bound on |K_ij|, in the units given.
        lower_bound: lower bound for controllers of this kind; 0 for none.
        structure: argument of `Landscape`.
        alike: returns the point whose entries count for the limit, among the points of gains that make the same loop.
        enough: relative; this close to what no controller beats, the search ends.
        rival: argument of `static_output_feedback`.
        work: counts the norms; where it is over each descent ends where it is. Without a limit if it is not given.
        """
        self.plant, self.rival = plant, rival
        self.landscape = Landscape(plant, structure, work)
        self.limit = self.landscape.point(np.full(self.landscape.shape, largest_gain))
        self.alike, own = alike, self.landscape.plant
        self.nothing = ZERO * (float(np.linalg.norm(own.Dw, 2)) + size(own.C) * size(own.Bw) / size(own.A))
        self.enough = max(lower_bound * (1 + enough), self.nothing)

    def refined(self, two_steps: DesignResult) -> list[Candidate]:
        """The two steps, refined where they are near the rival."""
        if self.landscape.norm(self.landscape.point(two_steps.gain))[0] > self.rival * HEATS[0][2]:
            return self.feasible_candidates(self.landscape.point(two_steps.gain), "the two steps")
        try:
            gain = refine(self.plant, None, two_steps.gain).gain
        except DesignError:  # stable by its proof, but for the landscape's rounding not
            return []
        return self.feasible_candidates(self.landscape.point(gain), "the two steps, refined")

    def starts(self, most: int = MOST) -> list[Candidate]:
        """Returns stable points of many sizes; if there are none, the results of a limited number of stabilising starts."""
        sampled = survey(self.landscape, self.limit)
        candidates = self.feasible_candidates(np.zeros_like(self.limit), "no control")
        for x in state_feedback_start(self.landscape, (1 + NEAR) * self.enough):
            candidates += self.feasible_candidates(x, "a Riccati equation of the state feedback")
        candidates += [
            each
            for x in sampled
            for each in self.feasible_candidates(x, f"a random gain of {10 ** np.floor(np.log10(abs(x).max())):.0e}")
        ]
        alone = np.isinf(self.rival)
        numbers = range(MANY if alone and len(sampled) < ENOUGH_SAMPLES else FEW)
        if len(self.plant.A) > LARGE:
            for x in projected_starts(self.landscape):
                candidates += self.feasible_candidates(x, "a projected state feedback")
            numbers = range(0 if candidates else MANY)
        while True:
            for x in stabilising_starts(self.landscape, self.limit, numbers):
                candidates += self.feasible_candidates(x, "a stabilising gain")
            if candidates or numbers.stop >= most or not alone:
                return candidates
            numbers = range(numbers.stop, most)

    def feasible_candidates(self, x: Array, origin: str) -> list[Candidate]:
        """A candidate, if the point is stable within the limit."""
        x = np.clip(self.alike(self.landscape, x), -self.limit, self.limit)
        norm, _ = self.landscape.norm(x)
        return [Candidate(x, norm, origin)] if np.isfinite(norm) else []

    def smallest(self, best: Candidate) -> Array:
        """The smallest multiple of a candidate's gain whose loop has the same norm, to a thousandth, shape (m, q).

        The landscape loses digits where a gain is huge, and does not decide it.
        """
        K = self.landscape.gain(best.x)
        most = max(own_norm(self.plant, K) * (1 + EQUAL), self.nothing)
        least, refused, missed = 1.0, 0.0, 0
        for share in SHARES:
            if own_norm(self.plant, share * K) <= most:
                least, missed = share, 0
            else:
                refused, missed = (share, 1) if not missed else (refused, missed + 1)
            if missed == DIFFERENT_STARTS:
                break
        for _ in range(HALVINGS if least < 1 else 0):
            middle = (least + refused) / 2
            least, refused = (middle, refused) if own_norm(self.plant, middle * K) <= most else (least, middle)
        return least * K

    def successive_halving(self, candidates: list[Candidate]) -> Candidate:
        """Returns the best of the candidates after descents of several lengths, the longest from the best ends alone."""
        n, best = len(self.plant.A), sorted(candidates, key=lambda each: each.norm)
        most = AGAINST if np.isfinite(self.rival) else ALL if n <= LARGE else max(1, int(MOST_STARTS * (LARGE / n) ** 3))
        for rounds, count, behind in HEATS:
            ends = list[Candidate]()
            for each in best[: min(count, most)]:
                ends.append(self.step(each, rounds))
                if self.reached(ends[-1]):
                    return ends[-1]
            ends.sort(key=lambda each: each.norm)
            best = [end for end, last in zip(ends, [None, *ends], strict=False) if not last or end.norm > last.norm * (1 + SAME)]
            if best[0].norm > self.rival * behind:
                break
        return best[0]

    def best(self, candidates: list[Candidate]) -> Candidate:
        """Returns the best end of the descents from the candidates, and from the surroundings of the best."""
        n, best = len(self.plant.A), self.successive_halving(candidates)
        if best.norm > self.rival * HEATS[-1][2]:
            return best
        best = self.step(best, converged := int(LAST_ROUNDS * min(1.0, (LARGE / n) ** 2)))
        for number, factor in enumerate(SURROUNDINGS if n <= LARGE else ()):
            if self.reached(best) or self.landscape.work.over or best.norm > self.rival * HEATS[-1][2]:
                break
            near = around(self.landscape, best.x, self.limit, factor, number)
            if near is not None:
                end = self.step(Candidate(near, self.landscape.norm(near)[0], best.origin), AROUND)
                best = self.step(end, converged) if end.norm < best.norm * (1 - SAME) else best
        return best

    def step(self, candidate: Candidate, rounds: int) -> Candidate:
        """Returns a candidate after a descent, or the candidate itself if the norm did not decrease."""
        if self.reached(candidate) or self.landscape.work.over:
            return candidate
        moved: list[Candidate] = []
        with up_to_rounding():  # of a loop on the border of stability
            x, _ = descend_norm(self.landscape, candidate.x, self.limit, rounds, self.enough)
            moved = self.feasible_candidates(x, candidate.origin)
        return min([candidate, *moved], key=lambda each: each.norm)

    def reached(self, candidate: Candidate) -> bool:
        """Returns True if a candidate is close enough to the lower bound, or next to zero."""
        return candidate.norm <= self.enough
