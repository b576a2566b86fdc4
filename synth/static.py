"""Static output feedback for any plant: the two steps where they lead to a gain, and what to do where they do not.

The paper's two steps take L (14) from the X of the *optimal* state feedback. That X often fits no output feedback. So:

1. X is also taken from the central path short of the optimum, where state feedback is less sharp.
2. The X of the second step is fed back into (14). For L from its own X, (25) has (X_Q, X_R, Y_R) = the X and K it came from as a
   solution: X = Q X_Q Q' + R X_R R' holds exactly. So the bound never grows, and any stabilising gain starts the iteration.
3. Where no X leads anywhere, a stabilising gain is searched for (`stabilise.py`).
4. From the gains of all starts the norm itself is minimised (`descent.py`).
"""

from dataclasses import dataclass

import numpy as np

from models.arrays import Array
from synth.central import CentralPoint, central_path
from synth.certificate import Certificate
from synth.descent import along_edges, quasi_newton
from synth.errors import DesignError
from synth.landscape import Landscape
from synth.output_feedback import l_matrix, nullspace, r_matrix
from synth.plant import GeneralizedPlant
from synth.riccati import proved
from synth.stabilise import stabilising_starts
from synth.state_feedback import state_feedback

SHORT_OF_OPTIMUM = (3.0, 1e-2, 1e-4)  # where on the path X is taken from, relative to eta
STARTS = 6  # random stabilising gains
MORE_STARTS = 18  # with those of before, where the first lead to none
LARGEST_GAIN = 1e5
AGREE = 1e-6  # relative; two starts that end this close have found the same minimum


@dataclass(frozen=True, eq=False)
class StaticDesign:
    """A static output-feedback gain for a plant, and where it comes from.

    Attributes:
        gain: K, shape (m, q).
        certificate: what is true of it.
        two_steps: the best of the two steps, with X from along the path; None where they find no gain.
        two_step_norm: the norm of its gain; None likewise.
        origin: the start that led to the gain, in words.
    """

    gain: Array
    certificate: Certificate
    two_steps: CentralPoint | None
    two_step_norm: float | None
    origin: str


def two_steps(plant: GeneralizedPlant, Cy: Array, mu: float, rounds: int = 1) -> CentralPoint:
    """The paper's two steps with X from the central path at mu, (14) iterated.

    Args:
        plant: n states, m inputs.
        Cy: shape (q, n), full row rank.
        mu: where on the path of (22) X is taken from, relative to eta; (25) is solved as closely.
        rounds: how often (25) is solved; from the second time on with the X of the time before.

    Raises:
        DesignError: (25) is infeasible with the first L, or a path could not be followed.
    """
    Q = nullspace(Cy)
    X = state_feedback(plant, mu)[-1].X
    point = None
    for _ in range(rounds):
        try:
            found = central_path(plant, Q, r_matrix(Cy, Q, l_matrix(X, Cy, Q)), max(mu, 1e-5))[-1]
        except DesignError:
            if point is None:
                raise
            break
        if point is not None and found.gamma > point.gamma * (1 - 1e-3):
            break
        point, X = found, found.X
    assert point is not None
    return point


@np.errstate(over="ignore", divide="ignore", invalid="ignore")  # a step too far; what is not finite is refused where it is tried
def static_output_feedback(plant: GeneralizedPlant, Cy: Array, largest_gain: float = LARGEST_GAIN) -> StaticDesign:
    """The best static gain that the whole strategy finds, no entry larger than `largest_gain`.

    Args:
        plant: n states, m inputs.
        Cy: shape (q, n), full row rank.
        largest_gain: bound on |K_ij|. Where the infimum lies at infinity, this is what keeps the gain finite.

    Raises:
        DesignError: no stabilising gain was found.
    """
    landscape = Landscape(plant, Cy)
    limit = landscape.point(np.full(landscape.shape, largest_gain))
    points = _along_the_path(plant, Cy)
    starts = [(landscape.point(point.K), f"two steps, X at mu = {mu:g}") for mu, point in points]
    starts = [(x, origin) for x, origin in starts if np.all(np.abs(x) <= limit) and np.isfinite(landscape.norm(x)[0])]
    norms = [landscape.norm(x)[0] for x, _ in starts]
    found = [(x, "a stabilising start") for x in stabilising_starts(landscape, limit, range(STARTS))]
    if not starts and not found:
        found = [(x, "a stabilising start") for x in _first(stabilising_starts(landscape, limit, range(STARTS, MORE_STARTS)), 2)]
    if not starts and not found:
        raise DesignError(
            f"no stabilising static gain was found from {MORE_STARTS} starts; measure more signals, or allow a larger gain "
            f"than {largest_gain:g}"
        )

    # Many quick descents, fewer and longer ones from the best.
    ranked = sorted((_quick(landscape, x, limit) + (origin,) for x, origin in starts + found), key=lambda each: each[1])
    for keep, rounds in ((3, 30), (1, 150)):
        ranked = [(*along_edges(landscape, x, limit, rounds), origin) for x, _, origin in ranked[:keep]]
        ranked.sort(key=lambda each: each[1])
        if len(ranked) > 1 and ranked[1][1] <= ranked[0][1] * (1 + AGREE):
            break
    x, _, origin = ranked[0]
    best = min(range(len(points)), key=lambda i: points[i][1].gamma) if norms else None
    K = landscape.gain(x)
    return StaticDesign(
        gain=K,
        certificate=proved(plant, K @ Cy),
        two_steps=points[best][1] if best is not None else None,
        two_step_norm=min(norms) if norms else None,
        origin=origin,
    )


def _along_the_path(plant: GeneralizedPlant, Cy: Array) -> list[tuple[float, CentralPoint]]:
    points = []
    for mu in SHORT_OF_OPTIMUM:
        try:
            points.append((mu, two_steps(plant, Cy, mu)))
        except (DesignError, ValueError, np.linalg.LinAlgError):  # this X leads nowhere; another, or another start, may
            continue
    return points


def _quick(landscape: Landscape, x: Array, limit: Array) -> tuple[Array, float]:
    """A quick descent of log norm."""

    def log_norm(x: Array, above: float) -> tuple[float, Array | None]:
        if np.any(np.abs(x) > limit):
            return np.inf, None
        norm, at = landscape.norm(x, float(np.exp(min(above, 700.0))))
        value = float(np.log(max(norm, 1e-300)))
        return value, landscape.slope(x, at) / norm if value <= above and norm > 0 else None

    if landscape.norm(x)[0] == 0:
        return x, 0.0
    x, value = quasi_newton(log_norm, x, 30)
    return x, float(np.exp(value))


def _first(items, count: int):
    return [item for item, _ in zip(items, range(count), strict=False)]
