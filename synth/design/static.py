"""Static output-feedback design by multi-start descent on the H-infinity norm.

The search returns the best gain that it finds within a fixed amount of work. No entry of the gain exceeds `largest_gain`. The
search cannot guarantee a global optimum, because the problem is not convex. Two measures reduce the risk of a poor local
minimum:

- Many starting gains (`descent/starts.py`): no control, random gains of every magnitude, and the refined result of the paper's
  two steps. If few random gains stabilise the loop, further stabilising gains are added. From all starting gains, the search
  descends for a few rounds. The search continues from the best results for more rounds, and from the best result of all until
  the descent converges. The descent (`descent/minimax.py`) handles the edges of the nonsmooth norm, uses its curvature, and
  scales the coordinates so that all directions have a similar effect.
- Additional descents that start near the best gain.

A result is never replaced by a worse result. The final norm is therefore not larger than the norm of the refined two-step gain
or the norm without control. If several multiples of a gain have the same norm, the search returns the smallest multiple. All
random gains have fixed seeds, so the same plant always gives the same gain.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from models.common.arrays import Array
from models.common.checks import Bound
from models.common.errors import InputError
from models.laws.linear import static_law
from synth.analysis.bounding import certify_law
from synth.analysis.lower_bounds.lower_bound import LowerBound
from synth.design.descent.landscape import Landscape, Work, price
from synth.design.descent.minimax import descend_norm
from synth.design.descent.refine import own_norm, refine
from synth.design.descent.starts import around, projected_starts, stabilising_starts, state_feedback_start, survey
from synth.design.problem import DESCENT, LARGEST_GAIN, DesignResult
from synth.design.two_step import independent_rows, no_gain, two_step_design, with_redundant_rows
from synth.plant.generalized import Plant, check_inputs
from synth.plant.numerics import DesignError, numerics, up_to_rounding
from synth.plant.units import size

# Number of decades of gain magnitude. If at least this many decades contain stable random gains, a few stabilising starts are
# enough
ENOUGH_SAMPLES = 4
# Numbers of stabilising starts. The first is used after enough stable random gains were found, the second after too few, and
# the third after no stable start was found
FEW, MANY, MOST = 2, 6, 18
LARGE = 30  # for a plant with more states, stabilising starts take minutes, so they are used only if no other start is stable
ALL = 100  # upper limit on the number of starts, which is never reached
# Each row begins with the number of rounds of a descent and the number of best starting points from which to descend. The
# search ends if the norm exceeds `rival` multiplied by the third entry.
HEATS = ((10, ALL, 1.1), (30, 5, 1.1), (60, 2, 1.03), (300, 2, 1.03))
# largest number of rounds of the last descent; a large plant has fewer rounds, because its rounds take longer
LAST_ROUNDS = 1200
AGAINST = 3  # number of starts if the argument `rival` is given
# number of starts for a plant with `LARGE` states; a larger plant has fewer starts, so that the total work stays the same
MOST_STARTS = 8
SAME = 1e-4  # two descents have found the same minimum if their norms differ by less than this relative amount
BOUND_TOLERANCE = 1e-4  # the search ends if the norm exceeds the lower bound by less than this relative amount
# Relative gap between the lower bound and the norm of the state feedback from which descent starts. A smaller gap gives a
# larger gain
NEAR = 1e-3
ZERO = 1e-9  # a norm below this multiple of the size of the plant's matrices counts as zero
SURROUNDINGS = (0.1, 0.3, 1.0)  # standard deviations of the logarithms of factors on the best gain, for further descents
AROUND = 60  # number of rounds of each descent that starts near the best gain
# norms count as equal if they differ by less than this relative amount, because the two methods for the norm round differently
EQUAL = 1e-9
SHARES = tuple(0.5**k for k in range(1, 41))  # multiples of a gain that are tried to find a smaller gain with the same norm
DIFFERENT_STARTS = 3  # the trials end after this many successive multiples with a different norm
HALVINGS = 10  # number of bisections that find the smallest multiple with the same norm, to a thousandth of the gain
# limit on the number of norms that are computed, for loops with 8 states; computing this many norms takes 7 to 18 s of
# processor time
LIMIT = 3e4


class Candidate(NamedTuple):
    """Point with a stable loop, norm of this loop, and starting point from which the search found it."""

    x: Array
    norm: float
    origin: str


def bounded_work(plant: Plant) -> Work:
    """Returns the limit on the computing work of a search for one controller of a plant.

    The limit is higher for plants with more than 8 states.
    """
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
    """Searches for the static gain with the smallest H-infinity norm whose entries are at most `largest_gain`.

    Args:
        plant: generalised plant with n states and m inputs.
        Cy: measurement matrix, shape (q, n). Default: the Cy of the plant. If a row of C_y depends linearly on other rows, the
            gain on this row is zero.
        largest_gain: largest allowed |K_ij|, in the units of the plant. The limit keeps the gain finite if the norm continues
            to decrease as the gain grows. The search works in balanced coordinates, but a change of units changes the meaning
            of the limit and may lead to another local minimum.
        lower_bound: lower bound on the norm with every static gain. The search ends early if the norm is close to the lower
            bound, and the certificate contains this bound.
        Dyw: direct effect of w on the measurements, y = C_y x + Dyw w, shape (q, r). Default: zero if Cy is given, otherwise
            the Dyw of the plant. The paper's two steps ignore Dyw. The result of the two steps is only one of the starting
            points.
        rival: norm that is reached by another design. The search ends early if the norms of the gains found stay far above
            `rival`. Default: infinity, if there is no other design.

    Returns:
        The law u = K y with K of shape (m, q), its certificate, and the starting point from which it was found.

    Raises:
        InputError: the plant has no state, or a matrix does not fit the plant.
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
    """Designs static gains by descent, with successive limits on the gain, until the poles are slow enough for an actuator.

    Args:
        plant, largest_gain, lower_bound, rival: arguments of `static_output_feedback`.
        two_steps: result of the two-step method, or the reason why it found no gain.
        limits: bounds on the entries of the gain in the units of `Landscape`. In the units of `Landscape`, a gain of 1 moves
            poles to about the speed of the plant's own poles.
        work: common counter of the computing work of all searches. Default: each search has its own `bounded_work`.

    Returns:
        One design for each limit that was tried.
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
    """Search for a static gain of one plant, optionally with a structure of the gain."""

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
        largest_gain: largest allowed |K_ij|, in the units of the plant.
        lower_bound: lower bound on the norm that the search can reach; 0 if no bound is known.
        structure: mask of the gain entries that may be nonzero, as in `Landscape`.
        alike: function that returns an equivalent point with the same closed loop. The entries of the equivalent point are
            compared with the limit.
        enough: relative gap between the norm and its lower bound below which the search ends.
        rival: norm that another design reaches, as in `static_output_feedback`.
        work: counter of the computing work of the search. A descent ends if the limit of this counter is exceeded. Default: no
            limit.
        """
        self.plant, self.rival = plant, rival
        self.landscape = Landscape(plant, structure, work)
        self.limit = self.landscape.point(np.full(self.landscape.shape, largest_gain))
        self.alike, own = alike, self.landscape.plant
        self.nothing = ZERO * (float(np.linalg.norm(own.Dw, 2)) + size(own.C) * size(own.Bw) / size(own.A))
        self.enough = max(lower_bound * (1 + enough), self.nothing)

    def refined(self, two_steps: DesignResult) -> list[Candidate]:
        """Returns the result of the two steps, refined by a descent if its norm is close to the norm `rival`."""
        if self.landscape.norm(self.landscape.point(two_steps.gain))[0] > self.rival * HEATS[0][2]:
            return self.feasible_candidates(self.landscape.point(two_steps.gain), "the two steps")
        try:
            gain = refine(self.plant, None, two_steps.gain).gain
        except DesignError:  # the start is stable according to a proof, but not in the landscape, because of rounding errors
            return []
        return self.feasible_candidates(self.landscape.point(gain), "the two steps, refined")

    def starts(self, most: int = MOST) -> list[Candidate]:
        """Returns stable starting points with gains of many magnitudes.

        If no stable point is found, more stabilising starting points are tried, up to `most`.
        """
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
        """Returns the point, clipped to the limit, as a list with one candidate; the list is empty if the loop is not stable."""
        x = np.clip(self.alike(self.landscape, x), -self.limit, self.limit)
        norm, _ = self.landscape.norm(x)
        return [Candidate(x, norm, origin)] if np.isfinite(norm) else []

    def smallest(self, best: Candidate) -> Array:
        """Returns the smallest multiple of a candidate's gain that has the same norm, accurate to a thousandth, shape (m, q).

        The norm is computed without `Landscape`, which is inaccurate for very large gains.
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
        """Returns the best candidate by successive halving: brief descents from all candidates, longer descents from the best
        candidates.
        """
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
        """Returns the best result of descents from the candidates and from points near the best candidate."""
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
        """Returns the result of a descent from a candidate, or the candidate itself if the norm did not decrease."""
        if self.reached(candidate) or self.landscape.work.over:
            return candidate
        moved: list[Candidate] = []
        with up_to_rounding():  # rounding errors may end the descent if a loop is near the stability limit
            x, _ = descend_norm(self.landscape, candidate.x, self.limit, rounds, self.enough)
            moved = self.feasible_candidates(x, candidate.origin)
        return min([candidate, *moved], key=lambda each: each.norm)

    def reached(self, candidate: Candidate) -> bool:
        """Returns True if a candidate's norm is close enough to the lower bound, or counts as zero."""
        return candidate.norm <= self.enough
