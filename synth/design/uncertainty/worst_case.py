"""Worst norm of a law with errors of measurements and forces: the largest norm found, and a bound for the box of errors.

The matrix X that proves the bound is found by Newton's method on a barrier function for the problem

    minimise t   so that   (20) of every loop  <=  t I,   X > 0,

The problem is solved in coordinates in which the first X is I. If t is below zero, X proves the bound. Usually, only a few
corners of the box determine the bound. The search starts with some corners, and adds the corners at which the current X
violates (20). If no X is found, the box is divided into parts, each with its own X. If the division into parts does not prove a
tight bound, multipliers (`multipliers.py`) are tried, because a common X is conservative for constant errors.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize

from models.common.arrays import Array
from models.common.checks import Matrix, Positive, check, check_shape
from models.laws.linear import LinearLaw
from synth.analysis.bounding import bounding_x
from synth.analysis.certificate import eta_of
from synth.analysis.norm import hinf_norm
from synth.analysis.uncertainty_box import MOST, Box, BoxProof, ScaledGain, lmi, proves
from synth.design.descent.landscape import Landscape
from synth.design.uncertainty.multipliers import NEAR, MultiplierProof, bound_in_band, stable_in_box
from synth.design.uncertainty.problem import box_of, errors_of, scaled_gain
from synth.lmi.least_unknown import lowest_last
from synth.lmi.stacked_barrier import StackedBarrier
from synth.plant.generalized import Plant
from synth.plant.numerics import numerics

ALL = 8  # largest number of free factors for which every corner is tried; with more factors, a vertex search is used
# number of random corners from which the vertex search starts; another start is the corner in the direction of the gradient
BEGIN = 4
REFINED_POINTS = 2  # number of highest points from which the search inside the box starts
TURNS = 30  # largest number of iterations of a search
SEED = 20261122


class WorstCaseNormFunction:
    """Norm as a function of the factors on measurements and forces. The object stores the largest norm computed so far.

    Attributes:
        highest: largest norm found so far; infinite if an unstable loop was found.
        at: factors for which the norm is `highest`, shape (q + m,).
    """

    def __init__(self, gain: ScaledGain) -> None:
        self.gain = gain
        self.landscape = Landscape(gain.plant.without_feedthrough)
        self.highest, self.at = 0.0, np.ones(sum(gain.K.shape))
        self._known: dict[bytes, tuple[float, float]] = {}

    def exceeds(self, factors: Array, level: float) -> bool:
        """Returns True if the norm exceeds a level; for an infinite level, returns True if the loop is unstable.

        The largest norm that is stored in the object is not updated.
        """
        try:
            point = self.landscape.point(self.gain.acting(factors))
        except np.linalg.LinAlgError:
            return True
        if np.isinf(level):
            return not self.landscape.abscissa(point)[0] < 0
        return self.landscape.norm(point, level)[0] > level

    def norm(self, factors: Array) -> float:
        """Returns the norm with given factors, shape (q + m,); infinite if the loop is unstable or not well-posed."""
        return self._peak(factors)[0]

    def _peak(self, factors: Array) -> tuple[float, float]:
        key = factors.tobytes()
        if key not in self._known:
            try:
                self._known[key] = self.landscape.norm(self.landscape.point(self.gain.acting(factors)))
            except np.linalg.LinAlgError:
                self._known[key] = np.inf, np.nan
            if not self._known[key][0] <= self.highest:
                self.highest, self.at = self._known[key][0], factors.copy()
        return self._known[key]

    def slope(self, factors: Array) -> Array:
        """Returns the gradient of a finite norm with respect to the factors, shape (q + m,)."""
        gain, landscape = self.gain, self.landscape
        K, q = gain.acting(factors), gain.K.shape[1]
        by_acting = landscape.slope(landscape.point(K), self._peak(factors)[1]).reshape(K.shape) / landscape.scale
        after = np.linalg.inv(gain.return_difference(gain.scaled(factors)))
        by_scaled = after.T @ by_acting @ (np.eye(q) + gain.plant.Dyu @ K).T * gain.K
        return np.concatenate([factors[q:] @ by_scaled, by_scaled @ factors[:q]])


def local_maximum(heights: WorstCaseNormFunction, box: Box) -> None:
    """Searches for the largest norm in a box of errors, and stores this norm in `heights`. The search ends if an unstable loop
    is found.
    """
    free = box.uncertain
    points = box.vertices if len(free) <= ALL else vertex_search(heights, box)
    points = np.concatenate([points, box.middle[None]])
    values = [heights.norm(point) for point in points]
    if not (len(free) and np.isfinite(heights.highest)):
        return
    generator = np.random.default_rng(SEED)
    inside = box.low + (box.high - box.low) * generator.random((2 * REFINED_POINTS, len(box.low)))
    values += [heights.norm(point) for point in inside]
    points = np.concatenate([points, inside])
    for i in np.argsort(values)[-REFINED_POINTS:][::-1]:
        _inside(heights, box, points[i])


def vertex_search(heights: WorstCaseNormFunction, box: Box) -> Array:
    """Returns k corners of the box at which changing any single factor does not increase the norm, shape (k, q + m).

    If the loop in the middle of the box is unstable, the middle is returned instead.
    """
    free, middle = box.uncertain, box.middle
    if not np.isfinite(heights.norm(middle)):
        return middle[None]
    uphill = np.where(heights.slope(middle) >= 0, box.high, box.low)
    corners = [uphill, *np.where(np.random.default_rng(SEED).random((BEGIN, len(middle))) < 0.5, box.low, box.high)]
    for corner in corners:
        best, moved = heights.norm(corner), True
        while moved and np.isfinite(best):
            moved = False
            for axis in free:
                other = corner.copy()
                other[axis] = box.low[axis] if corner[axis] == box.high[axis] else box.high[axis]
                if heights.norm(other) > best:
                    best, moved = heights.norm(other), True
                    corner[axis] = other[axis]
    return np.array(corners)


def _inside(heights: WorstCaseNormFunction, box: Box, start: Array) -> None:
    """Searches for a larger norm by moving through the box from a starting point."""
    free = box.uncertain
    middle, half = box.middle, (box.high - box.low)[free] / 2

    def point(t: Array) -> Array:
        factors = middle.copy()
        factors[free] = np.clip(middle[free] + half * t, box.low[free], box.high[free])
        return factors

    def down(t: Array) -> tuple[float, Array]:
        factors = point(t)
        value = heights.norm(factors)
        if not np.isfinite(value):
            raise StopIteration  # the norm is infinite, so there is no higher norm
        return -np.log(value), -heights.slope(factors)[free] * half / value

    t = (start - middle)[free] / half
    slope = down(t)[1]
    if np.all(np.where(t >= 1, slope <= 0, True) & np.where(t <= -1, slope >= 0, True) & (np.abs(t) >= 1)):
        return  # this corner is a local maximum: in all directions into the box, the norm decreases
    try:
        optimize.minimize(down, t, jac=True, method="L-BFGS-B", bounds=[(-1, 1)] * len(free), options={"maxiter": TURNS})
    except StopIteration:
        return


def norm_at(gain: ScaledGain, factors: Array) -> float:
    """Returns the norm of the loop with given factors, computed by two methods; infinite if the loop is unstable or not
    well-posed.
    """
    try:
        loop = gain.loop(factors)
    except np.linalg.LinAlgError:
        return np.inf
    return hinf_norm(loop).value


JOIN = 4  # number of corners of the box that are added in each round


def common_x(gain: ScaledGain, box: Box, start: Array, eta: float) -> Array | None:
    """Returns an X that fulfils (20) at all corners of a box, shape (n, n); None if (20) is infeasible or nearly infeasible.

    Args:
        box: box with at most `MOST` free factors (`uncertainty_box.py`).
        start: estimate of X > 0 from which the search starts, shape (n, n).
        eta: gamma^-2.

    Raises:
        LinAlgError: rounding prevents a solution.
    """
    everywhere, X = gain.loops(box.vertices), start
    among = np.zeros(0, dtype=int)
    while True:
        highest = _highest(everywhere, X, eta)
        # The first set contains all corners where the largest eigenvalue is reached, because rounding might otherwise prevent
        # the proof.
        failing = np.setdiff1d(np.flatnonzero(highest >= 0), among) if len(among) else np.arange(len(highest))
        if not len(failing):
            return X if highest.max() < 0 else None
        among = np.concatenate([among, failing[np.argsort(-highest[failing], kind="stable")[:JOIN]]])
        improved = _for_all(everywhere[among], X, eta)
        if improved is None:
            return None
        X = improved


def _highest(loops: Array, X: Array, eta: float) -> Array:
    """Returns the largest eigenvalue of (20) for each of V loops, in coordinates in which X is I, shape (V,)."""
    n = len(X)
    inverse = np.eye(loops.shape[-2])
    inverse[:n, :n] = np.linalg.inv(np.linalg.cholesky(X))
    return np.linalg.eigvalsh(inverse @ lmi(loops, X, eta) @ inverse.T)[:, -1]


def _for_all(loops: Array, start: Array, eta: float) -> Array | None:
    """Returns an X that fulfils (20) for every loop; None if no such X is found."""
    T = np.linalg.cholesky(start)
    n, k = len(T), loops.shape[-2]
    own = loops.copy()
    own[:, :n] = np.linalg.solve(T, own[:, :n])
    own[..., :n] = own[..., :n] @ T
    barrier = StackedBarrier(lmi(own, np.zeros((n, n)), eta), own[..., :n])
    least = float(np.linalg.eigvalsh(lmi(own, np.eye(n), eta)).max())
    p = np.append(barrier.unknowns(np.eye(n)), 1.5 * max(least, 1e-3))
    p = lowest_last(barrier, p, n + len(own) * k, 0.0)
    X = T @ barrier.matrix(p) @ T.T
    return (X + X.T) / 2 if p[-1] < 0 else None


CLOSEST = 1e-4  # smallest relative gap between a bound and the largest norm found for which a proof is tried
# relative gaps between a bound and the largest norm found, tried in turn if the box must be divided
CLOSER = (1e-2, 1e-3, CLOSEST)
# relative gaps between a bound and the largest norm found, tried if both the first gap in `CLOSER` and multipliers fail
LOOSE = (0.1, 1.0, 10.0)
TIGHT = 1e-3  # multipliers are not needed if the relative gap between a bound and the largest norm found is smaller than this
# largest number of attempts to find an X, for one state; the number is divided by the square of the number of states
TRIALS = 600
FEWEST = 4  # smallest allowed number of attempts to find an X
MANY = 6  # with more errors than this, finding multipliers takes less time than finding an X
# Factors on the number of attempts to find an X. `PATIENT` is for a bound that the user requests, `CHEAPLY` for each bound if
# many bounds are computed
PATIENT, CHEAPLY = 4.0, 1 / 3
SPARE = 1e-2  # margin for the first X, relative to the distance between the bound and the norm
FAR = 1e4  # bound for a loop that need only be stable, as a multiple of the norm
EVERYWHERE = 1e-4  # power of the disturbance that is added to all states for the first X, relative to the power of w

Parts = list[tuple[Box, Array | None]]  # parts of a box; for each part, an X that fulfils (20), if such an X is known
Proof = BoxProof | MultiplierProof


def _trials(heights: WorstCaseNormFunction) -> int:
    """Returns the largest number of attempts to find an X for one bound."""
    return max(FEWEST, TRIALS // len(heights.gain.plant.A) ** 2)


def search_bound(heights: WorstCaseNormFunction, box: Box) -> Proof | None:
    """Proves, for a box of errors, a bound just above the largest norm that was found. If the proof finds a larger norm, this
    norm is stored.
    """

    def tried(above: float, parts: Parts, left: int) -> tuple[Parts | None, int]:
        return _prove_parts(heights, parts, lambda: heights.highest * (1 + above), left)

    whole: Parts = [(box, None)]
    if (parts := tried(CLOSEST, whole, 1)[0]) is not None:
        return _proof(parts, heights.highest * (1 + CLOSEST))
    best: Proof | None = None
    parts, left = whole, _trials(heights)
    for above in CLOSER:
        filled, left = tried(above, parts, left)
        if filled is None:
            break
        parts, best = filled, _proof(filled, heights.highest * (1 + above))
    if best is None or best.bound > heights.highest * (1 + TIGHT):
        best = bound_in_band(heights.gain, box, 0.0, np.inf, heights.highest * (1 + NEAR)) or best
    for above in LOOSE if best is None else ():
        filled, _ = tried(above, whole, _trials(heights))
        if filled is not None:
            return _proof(filled, heights.highest * (1 + above))
    return best if np.isfinite(heights.highest) else None


def prove_bound(heights: WorstCaseNormFunction, box: Box, bound: float, patience: float = CHEAPLY) -> Proof | None:
    """Proves a given bound for a box of errors, with an X for each part of the box, or with multipliers. If the proof finds a
    larger norm, this norm is stored.

    Args:
        patience: factor on the usual number of attempts to find an X; if there are many errors, only one attempt is made. If
            `patience` is below 1 and there are many errors, multipliers are tried first.

    Returns:
        The proof, or None if no proof is found.
    """
    many = len(box.uncertain) > MANY

    def common() -> Proof | None:
        parts, _ = _prove_parts(heights, [(box, None)], lambda: bound, 1 if many else int(patience * _trials(heights)))
        return _proof(parts, bound) if parts is not None else None

    def multipliers() -> Proof | None:
        return bound_in_band(heights.gain, box, 0.0, np.inf, bound, tries=1) if heights.highest < bound else None

    return multipliers() or common() if many and patience < 1 else common() or multipliers()


def stable_with_errors(plant: Plant, K: Array | LinearLaw, d: Array, e: Array) -> Proof | None:
    """Returns a proof that the loop is stable for all errors; None if no proof is found. For the arguments, see `worst_norm`."""
    gain = scaled_gain(replace(plant, Dyw=None), K)
    box, heights = box_of(gain, d, e), WorstCaseNormFunction(gain)
    if not np.isfinite(norm := heights.norm(box.middle)):
        return None
    return prove_bound(heights, box, FAR * norm) or stable_in_box(gain, box)


def _proof(parts: Parts, bound: float) -> BoxProof:
    return BoxProof(eta_of(bound), [(part, X) for part, X in parts if X is not None])


def _prove_parts(heights: WorstCaseNormFunction, parts: Parts, bound: Callable[[], float], left: int) -> tuple[Parts | None, int]:
    """Divides a box of errors into parts, each with an X that proves a bound.

    Returns:
        The parts, and the number of attempts to find an X that remain. The parts are None if the division did not succeed.
    """
    todo, done = list(parts), Parts()
    if any(len(part.uncertain) > MOST for part, _ in parts):
        return None, 0
    while todo:
        part, X = todo.pop()
        if not heights.highest < bound():
            return None, left
        eta = eta_of(bound())
        if X is None or not proves(heights.gain, part, X, eta):
            if not left:
                return None, 0
            left, X = left - 1, _x_for(heights, part, eta)
        if X is not None:
            done.append((part, X))
        elif left and len(part.uncertain):
            todo += [(half, None) for half in part.bisect(_axis(heights, part))]
        else:
            return None, 0
    return done, left


def _x_for(heights: WorstCaseNormFunction, box: Box, eta: float) -> Array | None:
    """Returns an X that proves a bound for a box of errors; None if no X is found."""
    gain, level = heights.gain, eta**-0.5
    norm = heights.norm(box.middle)
    if not norm < level or not gain.well_posed(box):
        return None
    try:
        start = bounding_x(gain.loop(box.middle), level, SPARE * min(level / norm - 1, 1.0), EVERYWHERE)
        X = common_x(gain, box, start, eta)
    except (np.linalg.LinAlgError, ValueError):  # the bound is too close to the norm to be proved in floating point
        return None
    return X if X is not None and proves(gain, box, X, eta) else None


def _axis(heights: WorstCaseNormFunction, box: Box) -> int:
    """Returns the index of the factor that changes the norm most, from the middle of the box to its faces."""
    middle = heights.norm(box.middle)
    changes = []
    for axis in box.uncertain:
        ends = []
        for end in (box.low, box.high):
            point = box.middle
            point[axis] = end[axis]
            ends.append(heights.norm(point))
        changes.append(max(abs(np.log(value / middle)) if np.isfinite(value) else np.inf for value in ends))
    return int(box.uncertain[np.argmax(changes)])


@dataclass(frozen=True, eq=False)
class WorstNorm:
    """Worst norm over a box of gain errors: the largest norm found, and a proved upper bound.

    Attributes:
        found: largest norm found; infinite if a loop in the box is unstable.
        readings: relative errors of the measurements that cause the norm `found`, shape (q,).
        forces: relative errors of the forces that cause the norm `found`, shape (m,).
        proved: upper bound that is proved for all norms in the box, together with stability; infinite if nothing is proved.
        proof: proof of the bound, by a common X or by multipliers; None if nothing is proved.
    """

    found: float
    readings: Array
    forces: Array
    proved: float
    proof: Proof | None

    @property
    def gap(self) -> float:
        """Relative gap between the proved bound and the largest norm found; infinite if nothing is proved."""
        return self.proved / self.found - 1 if np.isfinite(self.proved) and self.found else np.inf

    @property
    def unstable(self) -> bool:
        """True if a loop in the box is unstable. If a loop is unstable, the attributes `readings` and `forces` are the errors
        of this loop.
        """
        return bool(np.isinf(self.found))


@numerics()
def worst_norm(
    plant: Plant,
    Cy: Array | None,
    K: Array | LinearLaw,
    d: Array | float,
    e: Array | float = 0.0,
    Dyw: Array | None = None,
    through: Array | None = None,
    enough: Positive | None = None,
) -> WorstNorm:
    """Searches for the largest H-infinity norm with relative gain errors of every measurement and force, and proves an upper
    bound on this norm.

    With errors, the gain K_ij becomes K_ij (1 + a_j) (1 + b_i). The errors |a_j| <= d_j and |b_i| <= e_i are independent of
    each other.

    Args:
        plant: generalised plant with n states and m inputs; continuous or discrete.
        Cy: measurement matrix, shape (q, n). Default: the Cy of the plant.
        K: gain of u = K y, shape (m, q); or a law with states, to whose measurements and forces the errors apply.
        d: largest relative error of all measurements, or of each measurement, shape (q,); 0.1 means 10 %.
        e: largest relative error of all forces, or of each force, shape (m,).
        Dyw: direct effect of w on the measurements, shape (q, r). Default: zero if Cy is given, otherwise the Dyw of the plant.
        through: direct effect of the forces on the measurements, shape (q, m); zero by default.
        enough: upper bound on the norm that is sufficient. If the proved bound is larger than `enough`, a separate proof of the
            bound `enough` is tried. None if no bound is known to be sufficient.

    Returns:
        The largest norm found, the errors that cause this norm, and the proved bound.

    Raises:
        InputError: a matrix has the wrong shape or entries that are not finite, or an error is not from 0 to 1.
        DesignError: rounding prevents a solution.

    Example:
        >>> from synth import GeneralizedPlant, worst_norm
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> worst = worst_norm(oscillator, Cy=[[0, 1]], K=[[-2.0]], d=0.1)
        >>> f"{worst.found:.4f} is met, at most {worst.proved:.4f}"
        '0.3099 is met, at most 0.3099'
    """
    if through is not None:
        shape = len(plant.Cy if Cy is None else Cy), plant.B.shape[1]
        check_shape("through", check("through", through, Matrix), shape, "signals, inputs")
    gain = scaled_gain(plant.measured(Cy, Dyw, through), K)
    return worst_in(gain, box_of(gain, d, e), enough)


def worst_in(gain: ScaledGain, box: Box, enough: float | None) -> WorstNorm:
    """Returns the largest norm over a box of factors, and a proved bound. For the arguments, see `worst_norm`."""
    heights = WorstCaseNormFunction(gain)
    local_maximum(heights, box)
    proof = search_bound(heights, box)
    if enough is not None and heights.highest < enough and (proof is None or proof.bound > enough):
        proof = prove_bound(heights, box, enough, PATIENT) or proof
    largest = norm_at(gain, heights.at)
    return WorstNorm(largest, *errors_of(gain, heights.at), proof.bound if proof is not None else np.inf, proof)
