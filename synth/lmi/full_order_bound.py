"""Lower bounds on output feedback of any order: the Gahinet-Apkarian LMIs, their central path, and the bound it proves.

    minimise t   over the plant's `SynthesisInequality` for (X, eta), that of the transposed plant for (S, t), and
                 [S J2 J1'; J1 J2' X] > 0,  [eta 1; 1 t] > 0

(`synthesis_inequality.py` and `lower_bound.py` derive them, and prove the bound). They are followed as in `central_path.py`, in
coordinates where X = S = I. For state feedback the second side is absent.
"""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import InputError
from synth.analysis.invariant_point import invariant_limit
from synth.analysis.lower_bound import DualCertificate, LowerBound, prove_from_inequalities
from synth.analysis.rigorous import floats
from synth.analysis.synthesis_inequality import SynthesisInequality, meeting, transposed
from synth.lmi.barrier import Barrier, Block, boundary, newton
from synth.lmi.central_path import CENTRED, INSIDE, CentralPoint, along_path
from synth.plant.generalized import GeneralizedPlant, measurement_matrices
from synth.plant.numerics import numerics, up_to_rounding
from synth.plant.units import nearest_power, own_units, size

STATE_END = 1e-5  # mu over eta; the bound for state feedback is then within (2 n + d) mu / 2 of the best
ENOUGH = 1e-8  # relative; closer to what state feedback reaches no bound need be
END = 1e-6  # mu over t; the bound is then within (2 n + d + n - q) mu / 2 of the best
SHARP = 1e-3  # relative; a proof this close to its point of the path has lost nothing to rounding
MOST = 1200  # unknowns of the joint path, 33 states: minutes, and a fifth of a gigabyte; beyond, state feedback's bound counts
MAPPED = 1e-9  # relative; what a discrete plant's bound is lowered by for the rounding of the map
ENTER = 1e2  # mu over t at the entry of the joint path, which starts far from its centre


@numerics()
def find_lower_bound(
    plant: GeneralizedPlant,
    Cy: Array | None = None,
    path: Sequence[CentralPoint] = (),
    beyond_control: LowerBound | None = None,
    Dyw: Array | None = None,
) -> LowerBound:
    """A norm that no controller reaches: the largest of what the dual, what no control force changes, and zeros prove.

    Where stable zeros let X grow at no price the dual problem has no point inside, and no path: then the zeros count.

    Of a discrete plant it is that of the continuous one that it is mapped to (`discrete.py`), and less by MAPPED: what is proved
    in exact arithmetic is proved of that one's numbers. So are witnesses and zeros.

    Args:
        plant: n states, m inputs.
        Cy: shape (q, n): the bound is for output feedback from y = C_y x + Dyw w, of any order. Without it, for state feedback
            and more: that bound holds for what knows less, too, and no bound that is returned lies below it.
        path: of `state_feedback` of the plant, if it is there already.
        beyond_control: the bound of that name, likewise.
        Dyw: shape (q, r); zero where it is not given.

    Returns:
        The bound; 0 with no witness where nothing is proved.

    Raises:
        InputError: C_y or Dyw does not fit the plant, see `measurement_matrices`.

    Example:
        >>> from synth import GeneralizedPlant, find_lower_bound
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> f"{find_lower_bound(oscillator, Cy=[[0, 1]]).gamma:.4f}"
        '0.1000'
    """
    if Cy is not None and len(Cy):  # of no row at all: a bound for what measures nothing
        Cy, Dyw = measurement_matrices(plant, Cy, Dyw)
    if plant.dt is not None:
        from synth.plant.discrete import mapped, true_frequency

        where = mapped(plant, np.eye(len(plant.A)) if Cy is None else Cy, Dyw)
        found = find_lower_bound(where.plant) if Cy is None else find_lower_bound(where.plant, where.Cy, Dyw=where.Dyw)
        at = None if found.limit_at is None else true_frequency(found.limit_at, plant.dt)
        return replace(found, gamma=found.gamma * (1 - MAPPED), limit_at=at)
    best = bound_beyond_control(plant) if beyond_control is None else beyond_control
    dual = transposed(plant, Cy, Dyw) if Cy is not None else None
    other = SynthesisInequality.of(dual) if dual is not None else None
    if other is not None and not len(other.J):
        other = Cy = None  # y shows, with its derivatives, all that state feedback knows
    reached = bool(path) and best.gamma >= path[-1].gamma * (1 - ENOUGH)
    if other is None and reached:
        return best
    from synth.analysis.interpolation import zero_limit

    one = SynthesisInequality.of(plant)
    gamma, zeros = zero_limit(plant, Cy, (one, other), Dyw)
    if gamma > best.gamma:
        best = LowerBound(gamma, zeros=zeros)
    if not reached:
        best = max(best, _for_state_feedback(plant, one, path), key=_gamma)
    if other is None:
        return best
    # The joint path ends a little short of its optimum, or where rounding ends it: what state feedback does not beat counts, too.
    return max(best, _along_the_walk(plant, dual, one, other), key=_gamma)


def _for_state_feedback(plant: GeneralizedPlant, one: SynthesisInequality, path: Sequence[CentralPoint]) -> LowerBound:
    """Returns the bound of the dual of (22), from the path of the inequality if it is smaller than (22), or (22) has no path."""
    found = _along_the_walk(plant, None, one, None) if len(one.J) < len(plant.A) or not path else LowerBound(0.0)
    return found if found.gamma else _sharpest(one, None, _of_state_feedback(plant, path))


def _along_the_walk(
    plant: GeneralizedPlant, dual: GeneralizedPlant | None, one: SynthesisInequality, other: SynthesisInequality | None
) -> LowerBound:
    """The best bound of `_walk`; 0 where the problem has no solution, or none at a finite gain."""
    points = []
    with contextlib.suppress(InputError), up_to_rounding(), np.errstate(all="ignore"):
        for point in _walk(plant, dual, one, other):
            points.append(point)
    return _sharpest(one, other, points)


def bound_beyond_control(plant: GeneralizedPlant) -> LowerBound:
    """Returns the bound from the invariant point, which no control force changes; 0 if control can change all."""
    limit = invariant_limit(plant)
    return LowerBound(limit[0], limit_at=limit[1]) if limit is not None else LowerBound(0.0)


def _of_state_feedback(plant: GeneralizedPlant, path: Sequence[CentralPoint]) -> list[tuple[DualCertificate, None, float]]:
    """The witnesses of the path of (22), also where its end cannot be reached."""
    points = [point for point in path if point.mu > 0.5 * STATE_END]
    if not path:
        n = len(plant.A)
        with contextlib.suppress(InputError, np.linalg.LinAlgError), np.errstate(all="ignore"):
            for point in along_path(plant, np.zeros((n, 0)), np.eye(n), STATE_END):
                points.append(point)
    return [(DualCertificate(point.X, point.eta), None, point.gamma) for point in points]


def _gamma(bound: LowerBound) -> float:
    return bound.gamma


def _sharpest(
    one: SynthesisInequality,
    other: SynthesisInequality | None,
    points: Sequence[tuple[DualCertificate, DualCertificate | None, float]],
) -> LowerBound:
    """The best bound that points of a path prove, from its end back to the first that loses nothing to rounding."""
    best = LowerBound(0.0)
    for state, observer, gamma in reversed(points):
        best = max(best, prove_from_inequalities(one, other, state, observer), key=_gamma)
        if best.gamma >= gamma * (1 - SHARP):
            break
    return best


def _walk(
    plant: GeneralizedPlant, dual: GeneralizedPlant | None, one: SynthesisInequality, other: SynthesisInequality | None
) -> Iterator[tuple[DualCertificate, DualCertificate | None, float]]:
    """Witnesses along the path with the gamma that it has come to, ever closer to the optimum, until it cannot be followed."""
    if sum(len(side.J) * (len(side.J) + 1) // 2 + 1 for side in (one, other) if side is not None) > MOST:
        return
    first, second, between = _Face(one, _inside(plant)), None, np.zeros((0, len(one.J)))
    eta = first.room()
    weight, grow = eta, 2.0
    if other is not None and dual is not None:
        second = _Face(other, _inside(dual))
        weight = second.room()
        second.T = second.T / weight**0.5
        whole, over = meeting(one, other)
        between = floats(whole, Fraction(1, over))
        # S and t grow together until [S J2 J1'; J1 J2' X] > 0 and eta t > 1.
        fits = float(np.linalg.norm(_met(first, second, between), 2)) ** 2 if between.size else 0.0
        grow = 2 * max(1.0, fits, weight / eta)
        second.T = second.T * grow**0.5
    t = grow / weight if weight else np.inf
    mu = ENTER * t
    while eta > 0 and np.isfinite(mu):
        blocks, k = _blocks(first, second, between)
        p = np.concatenate([first.start(eta), second.start(t) if second is not None else [t]])
        c = np.zeros(len(p))
        c[-1] = 1 / mu
        barrier = Barrier(blocks)
        if barrier.at(p) is None:
            return
        p, decrement, here = newton(barrier, p, c, CENTRED)
        if decrement > 0.5:
            return
        t = float(p[-1])
        yield first.witness(p[: k - 1], p[k - 1]), second.witness(p[k:-1] / t, 1 / t) if second is not None else None, t**0.5
        if mu <= END * t:
            return
        ratio = 0.1
        c[-1] *= -1
        step = here.solve(here.half(c))
        p = p + min(1 - ratio, INSIDE * boundary(here, step)) * step
        mu *= ratio
        eta, t = float(p[k - 1]), float(p[-1])
        first.move_to(p[: k - 1])
        if second is not None:
            second.move_to(p[k:-1])


def _inside(plant: GeneralizedPlant) -> Array:
    """Returns X that satisfies the plant's `SynthesisInequality`, for some eta.

    It is the inverse of the solution of a Riccati equation in which states and inputs join z, in the plant's own units. What is
    inside then is inside without them, too. It is the same in any units.
    """
    units = own_units(plant)
    own = units.into(plant)
    rate = nearest_power(size(own.A) if own.A.any() else units.rate)
    weight = nearest_power(size(own.C))
    A, B, C, D = own.A / rate, own.B / rate, own.C / weight, own.D / weight
    used = np.linalg.norm(B, axis=0)
    cost = size(C) / size(A) * np.where(used > 0, used, 1.0)
    states = C.T @ C + size(C) ** 2 * np.eye(len(A))
    P = weight**2 / rate * linalg.solve_continuous_are(A, B, states, D.T @ D + np.diag(cost**2), s=C.T @ D)
    X = np.linalg.inv(np.linalg.cholesky(P)) * units.states
    return X.T @ X


class _Face:
    """A side and where its X stands: X = T T', in coordinates in which it is I."""

    def __init__(self, side: SynthesisInequality, X: Array) -> None:
        J = floats(side.J) / floats(side.J[np.arange(len(side.J)), side.coordinates])[:, None]
        self.n, self.coordinates = len(X), side.coordinates
        self.U, self.Q, self.b, self.c = side.floats()
        self.T = np.linalg.cholesky(J @ X @ J.T) if len(J) else np.zeros((0, 0))
        self.rows, self.columns = np.triu_indices(len(J))

    def start(self, last: float) -> Array:
        """The unknowns: I, and the last."""
        return np.append((self.rows == self.columns).astype(float), last)

    def room(self) -> float:
        """Half the largest eta at X = I; 1 where any will do."""
        moved = (self.Q @ self.T) @ (self.U @ self.T).T
        inside = np.linalg.cholesky(self.c @ self.c.T - moved - moved.T)
        return 0.5 / (float(np.linalg.norm(np.linalg.solve(inside, self.b), 2)) ** 2 or 0.5)

    def steps(self) -> Array:
        """Returns the coefficients of the unknowns of X in -He(Q X U'), shape (N, k, k)."""
        U, Q = self.U @ self.T, self.Q @ self.T
        half = np.einsum("ki,li->ikl", Q[:, self.rows], U[:, self.columns])
        half[self.rows != self.columns] += np.einsum("ki,li->ikl", Q[:, self.columns], U[:, self.rows])[self.rows != self.columns]
        return -half - half.swapaxes(1, 2)

    def units(self) -> Array:
        """Returns the coefficients of the unknowns in X, shape (N, a, a)."""
        index, E = np.arange(len(self.rows)), np.zeros((len(self.rows), *self.T.shape))
        E[index, self.rows, self.columns] = E[index, self.columns, self.rows] = 1
        return E

    def witness(self, unknowns: Array, last: float) -> DualCertificate:
        X = np.zeros((self.n, self.n))
        X[np.ix_(self.coordinates, self.coordinates)] = self.T @ np.tensordot(unknowns, self.units(), 1) @ self.T.T
        return DualCertificate((X + X.T) / 2, float(last))

    def move_to(self, unknowns: Array) -> None:
        self.T = self.T @ np.linalg.cholesky(np.tensordot(unknowns, self.units(), 1))


def _met(first: _Face, second: _Face, between: Array) -> Array:
    """J2 J1' in the coordinates of both."""
    return np.linalg.solve(second.T, np.linalg.solve(first.T, between.T).T)


def _blocks(first: _Face, second: _Face | None, between: Array) -> tuple[list[Block], int]:
    """The constraints over the unknowns (X, eta, S, t), and how many of them are those of (X, eta)."""
    one = [first.steps(), -(first.b @ first.b.T)[None]]
    k = sum(map(len, one))
    none = np.zeros((0, len(between), len(between)))
    two = [second.steps() if second is not None else none, (second.c @ second.c.T)[None] if second is not None else none]
    size = k + (sum(map(len, two)) if second is not None else 1)

    def over_all(parts: list[tuple[int, Array]], rows: int) -> Array:
        whole = np.zeros((size, rows, rows))
        for at, part in parts:
            whole[at : at + len(part), : part.shape[1], : part.shape[1]] += part
        return whole

    corner = np.zeros((size, 2, 2))
    corner[k - 1, 0, 0] = corner[-1, 1, 1] = 1
    blocks = [
        (first.c @ first.c.T, over_all([(0, np.concatenate(one))], len(first.c))),
        (np.array([[0.0, 1.0], [1.0, 0.0]]), corner),
    ]
    a, b = len(first.T), len(between)
    joint, X = np.zeros((b + a, b + a)), np.zeros((size, b + a, b + a))
    X[: k - 1, b:, b:] = first.units()
    if second is not None:
        blocks.append((-(second.b @ second.b.T), over_all([(k, np.concatenate(two))], len(second.b))))
        X[k:-1, :b, :b] = second.units()
        joint[:b, b:] = _met(first, second, between)
        joint[b:, :b] = joint[:b, b:].T
    blocks.append((joint, X))
    return [block for block in blocks if len(block[0])], k
