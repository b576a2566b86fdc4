"""Lower bounds on the norm for output feedback of any order, from the central path of the Gahinet-Apkarian LMIs:

    minimise t   over the plant's `SynthesisInequality` for (X, eta), that of the transposed plant for (S, t), and
                 [S J2 J1'; J1 J2' X] > 0,  [eta 1; 1 t] > 0

The modules `synthesis_inequality.py` and `lower_bound.py` derive the LMIs and prove the bound. The path is followed as in
`central_path.py`, in coordinates in which X = S = I. For state feedback, only the inequality of the plant is used.
"""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.checks import Matrix
from models.common.errors import InputError
from synth.analysis.lower_bounds.invariant_point import invariant_limit, limit_at, limit_at_infinity
from synth.analysis.lower_bounds.lower_bound import CouplingMatrix, DualCertificate, LowerBound, prove_from_inequalities
from synth.analysis.lower_bounds.synthesis_inequality import SynthesisInequality
from synth.analysis.rigorous import floats
from synth.analysis.stabilisability import uncontrollable_modes
from synth.analysis.stability import pole_text
from synth.lmi.barrier import Barrier, Block, boundary, newton
from synth.lmi.central_path import CENTRE_DECREMENT, INSIDE, CentralPoint, along_path
from synth.plant.generalized import Plant
from synth.plant.numerics import numerics, up_to_rounding
from synth.plant.units import nearest_power, own_units, size

# Value of mu / eta at the end of the path; the bound for state feedback is then within (2 n + d) mu / 2 of the best bound
STATE_END = 1e-5
ENOUGH = 1e-8  # a bound is not improved further if its relative gap to the norm of the state feedback is smaller than this
END = 1e-6  # value of mu / t at the end of the joint path; the bound is then within (2 n + d + n - q) mu / 2 of the best bound
# a proof has lost no digits to rounding if the relative gap between the proved bound and the gamma of its point is smaller than
# this
SHARP = 1e-3
# Largest number of unknowns of the joint path (33 states take minutes and 200 MB). For larger plants, the bound for state
# feedback is used
MOST = 1200
ENTER = 1e2  # value of mu / t at the start of the joint path


@numerics()
def find_lower_bound(
    plant: Plant,
    Cy: Matrix | None = None,
    path: Sequence[CentralPoint] = (),
    beyond_control: LowerBound | None = None,
    Dyw: Array | None = None,
) -> LowerBound:
    """Returns the largest lower bound on the norm, for all controllers, that dual solutions, an invariant point or zeros prove.

    Args:
        plant: plant with n states and m inputs.
        Cy: matrix of the measurements y = C_y x + Dyw w, shape (q, n). The bound holds for output feedback of any order from y.
            Default: the measurements of the plant. If C_y is not given and the plant has no measurements, the bound is for
            state feedback. The bound for state feedback also holds for output feedback, but the bound for output feedback may
            be higher.
        path: points of the central path of `state_feedback` for this plant; empty if not computed yet.
        beyond_control: bound that the function `bound_beyond_control` returns; None if not computed yet.
        Dyw: feedthrough from w to the measurements, shape (q, r). Default: zero.

    Returns:
        The lower bound with its proof; `gamma` is 0 if nothing can be proved. If w acts on y, and there is a non-decaying mode
        on which w does not act, the LMIs do not have a strictly feasible point. Without a strictly feasible point, only zeros
        and the invariant point can prove a bound, and `reason` describes the mode.

    Raises:
        InputError: C_y or Dyw does not fit the plant; see `Plant.measured`.

    Example:
        >>> from synth import GeneralizedPlant, find_lower_bound
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> f"{find_lower_bound(oscillator, Cy=[[0, 1]]).gamma:.4f}"
        '0.2500'
    """
    measured = Cy is not None or bool(len(plant.Cy))
    if (Cy is not None and len(Cy)) or len(plant.Cy):  # if C_y has no rows, the bound is for open-loop control
        plant = plant.measured(Cy, Dyw)
    best = _largest_bound(plant, measured, path, beyond_control)
    if best.state is not None or not np.any(plant.Dyw):
        return best
    own = own_units(plant).into(plant.differences)
    undisturbed = [pole_text(pole, plant.dt) for pole, _ in uncontrollable_modes(own.A, own.Bw, plant.dt)]
    reason = f"w does not act on the mode at {' and '.join(undisturbed)}, so zeros alone prove a lower bound"
    return replace(best, reason=reason) if undisturbed else best


def _largest_bound(plant: Plant, measured: bool, path: Sequence[CentralPoint], beyond_control: LowerBound | None) -> LowerBound:
    """Returns the bound of `find_lower_bound` for output feedback, or for state feedback if the plant has no measurements."""
    best = bound_beyond_control(plant) if beyond_control is None else beyond_control
    dual = plant.transposed if measured else None
    observer = SynthesisInequality.of(dual) if dual is not None else None
    # None if y and the derivatives of y determine all states
    other = observer if observer is not None and len(observer.J) else None
    if dual is not None:
        best = max(best, _unmeasured_disturbance_bound(plant, dual), key=_gamma)
    reached = bool(path) and best.gamma >= path[-1].gamma * (1 - ENOUGH)
    if other is None and reached:
        return best
    from synth.analysis.lower_bounds.interpolation import zero_limit

    one = SynthesisInequality.of(plant)
    gamma, zeros = zero_limit(plant, (one, observer))
    if gamma > best.gamma:
        best = LowerBound(gamma, zeros=zeros)
    if not reached:
        best = max(best, _for_state_feedback(plant, one, path), key=_gamma)
    if other is None:
        return best
    # The joint path ends before its optimum, so the bound for state feedback may be larger.
    return max(best, _along_joint_path(plant, dual, one, other), key=_gamma)


def _for_state_feedback(plant: Plant, one: SynthesisInequality, path: Sequence[CentralPoint]) -> LowerBound:
    """Returns the lower bound for state feedback.

    The bound for state feedback comes from the dual problem of (22). If the plant's `SynthesisInequality` has fewer coordinates
    than (22), or if (22) has no path, the bound comes from the central path of this inequality.
    """
    bound = (
        _along_joint_path(plant, None, one, None)
        if len(one.J) < len(plant.A) or not path or plant.dt is not None
        else LowerBound(0.0)
    )
    return bound if bound.gamma else _sharpest(one, None, _of_state_feedback(plant, path))


def _along_joint_path(
    plant: Plant, dual: Plant | None, one: SynthesisInequality, other: SynthesisInequality | None
) -> LowerBound:
    """Returns the largest bound that points of `_joint_path` prove; 0 if the problem has no solution with a finite gain."""
    points = []
    with contextlib.suppress(InputError), up_to_rounding(), np.errstate(all="ignore"):
        for point in _joint_path(plant, dual, one, other):
            points.append(point)
    return _sharpest(one, other, points)


def bound_beyond_control(plant: Plant) -> LowerBound:
    """Returns the lower bound that the invariant point gives; 0 if the control can change every direction of z at every
    frequency.

    For a discrete plant, the frequency is found with the bilinear image of the plant, but the bound is computed for the plant
    itself.
    """
    if plant.dt is not None:
        from synth.plant.discrete import continuous_image, true_frequency

        limit = invariant_limit(continuous_image(plant.measured(np.eye(len(plant.A))))[0])
        at = true_frequency(limit[1], plant.dt) if limit is not None else 0.0
        best = max((LowerBound(limit_at(plant, each), limit_at=each) for each in (0.0, at)), key=_gamma)
        return best if best.gamma else LowerBound(0.0)
    limit = invariant_limit(plant)
    return LowerBound(limit[0], limit_at=limit[1]) if limit is not None else LowerBound(0.0)


def _unmeasured_disturbance_bound(plant: Plant, dual: Plant) -> LowerBound:
    """Returns the lower bound that follows from disturbances without effect on measurements, and outputs that no force changes.

    Disturbances are considered at zero and infinite frequency, and outputs at infinite frequency. For a discrete plant, the
    lower bound is 0.

    Zeros at other frequencies on the imaginary axis are not used, because floating-point numbers cannot represent these zeros
    exactly. Zeros that are only close to the axis do not give a bound.
    """
    if plant.dt is not None:
        return LowerBound(0.0)
    at_rest, at_infinity = limit_at(dual, 0.0), limit_at_infinity(plant)
    if max(at_rest, at_infinity) == 0:
        return LowerBound(0.0)
    return LowerBound(max(at_rest, at_infinity), zeros=((), (0j,) if at_rest > at_infinity else ()))


def _of_state_feedback(plant: Plant, path: Sequence[CentralPoint]) -> list[tuple[DualCertificate, None, float]]:
    """Returns dual certificates for points along the path of (22), even if the end of the path cannot be reached."""
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
    """Returns the largest lower bound that is proved by points of a path. The search starts at the last point of the path and
    goes back to earlier points.

    The search ends at the first point for which the proof loses no digits to rounding.
    """
    best = LowerBound(0.0)
    for state, observer, gamma in reversed(points):
        best = max(best, prove_from_inequalities(one, other, state, observer), key=_gamma)
        if best.gamma >= gamma * (1 - SHARP):
            break
    return best


def _joint_path(
    plant: Plant, dual: Plant | None, one: SynthesisInequality, other: SynthesisInequality | None
) -> Iterator[tuple[DualCertificate, DualCertificate | None, float]]:
    """Yields dual certificates and gamma at points that approach the optimum, until the path cannot be followed any further."""
    if sum(len(side.J) * (len(side.J) + 1) // 2 + 1 for side in (one, other) if side is not None) > MOST:
        return
    first, second = _ProjectedLmi(one, plant), None
    between = np.zeros((0, len(first.T)))
    eta = first.feasible_eta()
    weight, grow = eta, 2.0
    if other is not None and dual is not None:
        second = _ProjectedLmi(other, dual)
        weight = second.feasible_eta()
        second.T = second.T / weight**0.5
        between = CouplingMatrix.of(one, other).floats
        # S and t are increased together until [S J2 J1'; J1 J2' X] > 0 and eta t > 1.
        needed = float(np.linalg.norm(_coupling_matrix(first, second, between), 2)) ** 2 if between.size else 0.0
        grow = 2 * max(1.0, needed, weight / eta)
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
        p, decrement, here = newton(barrier, p, c, CENTRE_DECREMENT)
        if decrement > 0.5:
            return
        t = float(p[-1])
        observer = second.certificate(p[k:-1] / t, 1 / t) if second is not None else None
        yield first.certificate(p[: k - 1], p[k - 1]), observer, t**0.5
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


def _feasible(plant: Plant) -> Array:
    """Returns an X that satisfies the plant's `SynthesisInequality` for some eta, shape (n, n).

    X is the inverse of a matrix that solves a Riccati equation in the units of `own_units`. The output z in the Riccati
    equation also contains the states and the inputs. An X that is feasible with the larger z is also feasible with the z of the
    plant.
    """
    units = own_units(plant)
    own = units.into(plant)
    rate = nearest_power(size(own.A) if own.A.any() else units.rate) if plant.dt is None else 1.0
    weight = nearest_power(size(own.C))
    A, B, C, D = own.A / rate, own.B / rate, own.C / weight, own.D / weight
    if not B.shape[1]:  # without inputs (open-loop control), the Riccati equation becomes a Lyapunov equation
        lyapunov = linalg.solve_continuous_lyapunov if plant.dt is None else linalg.solve_discrete_lyapunov
        P = weight**2 / rate * lyapunov(A.T, (-1 if plant.dt is None else 1) * (C.T @ C + size(C) ** 2 * np.eye(len(A))))
        X = np.linalg.inv(np.linalg.cholesky((P + P.T) / 2)) * units.states
        return X.T @ X
    used = np.linalg.norm(B, axis=0)
    cost = size(C) / size(A) * np.where(used > 0, used, 1.0)
    states = C.T @ C + size(C) ** 2 * np.eye(len(A))
    riccati = linalg.solve_continuous_are if plant.dt is None else linalg.solve_discrete_are
    P = weight**2 / rate * riccati(A, B, states, D.T @ D + np.diag(cost**2), s=C.T @ D)
    X = np.linalg.inv(np.linalg.cholesky(P)) * units.states
    return X.T @ X


def _feasible_part(Q: Array, c: Array) -> Array:
    """Returns an X > 0 that satisfies the inequality of an `AntistablePart` for some eta, computed from Q X + X Q' = c c' / 2 -
    epsilon I.
    """
    if not len(Q):
        return Q
    most, margin = (linalg.solve_continuous_lyapunov(Q, right) for right in (c @ c.T, np.eye(len(Q))))
    epsilon = float(linalg.eigh(most, margin, eigvals_only=True)[0]) / 4
    return most / 2 - epsilon * margin


class _ProjectedLmi:
    """One of the two synthesis inequalities (of the plant or of the transposed plant), with its current solution X = T T'. In
    the coordinates of T, X is the identity.
    """

    def __init__(self, side: SynthesisInequality, plant: Plant) -> None:
        self.n, self.coordinates, self.part = len(plant.A), side.coordinates, side.antistable
        if self.part is None:
            self.U, self.Q, self.b, self.c = side.floats()
            J = floats(side.J) / floats(side.J[np.arange(len(side.J)), side.coordinates])[:, None]
            X = J @ _feasible(plant) @ J.T if len(J) else np.zeros((0, 0))
        else:
            self.U, self.Q, self.b, self.c = np.eye(len(self.part.Q)), self.part.Q, self.part.b, self.part.c
            X = _feasible_part(self.Q, self.c)
        self.T = np.linalg.cholesky(X)
        self.rows, self.columns = np.triu_indices(len(X))

    def start(self, last: float) -> Array:
        """Returns the vector of unknowns in which X = I and the last unknown is `last`."""
        return np.append((self.rows == self.columns).astype(float), last)

    def feasible_eta(self) -> float:
        """Returns half of the largest eta that is feasible for X = I; 1 if every eta is feasible."""
        half = (self.Q @ self.T) @ (self.U @ self.T).T
        factor = np.linalg.cholesky(self.c @ self.c.T - half - half.T)
        return 0.5 / (float(np.linalg.norm(np.linalg.solve(factor, self.b), 2)) ** 2 or 0.5)

    def steps(self) -> Array:
        """Returns the coefficients that the unknowns of X have in the matrix -He(Q X U'), shape (N, k, k), where He(M) = M +
        M'.
        """
        U, Q = self.U @ self.T, self.Q @ self.T
        half = np.einsum("ki,li->ikl", Q[:, self.rows], U[:, self.columns])
        half[self.rows != self.columns] += np.einsum("ki,li->ikl", Q[:, self.columns], U[:, self.rows])[self.rows != self.columns]
        return -half - half.swapaxes(1, 2)

    def units(self) -> Array:
        """Returns the coefficient matrices of those unknowns that are entries of X, shape (N, a, a)."""
        index, E = np.arange(len(self.rows)), np.zeros((len(self.rows), *self.T.shape))
        E[index, self.rows, self.columns] = E[index, self.columns, self.rows] = 1
        return E

    def certificate(self, unknowns: Array, last: float) -> DualCertificate:
        inner = self.T @ np.tensordot(unknowns, self.units(), 1) @ self.T.T
        X = np.zeros((self.n, self.n))
        X[np.ix_(self.coordinates, self.coordinates)] = inner if self.part is None else self.part.whole(inner)
        return DualCertificate((X + X.T) / 2, float(last))

    def move_to(self, unknowns: Array) -> None:
        self.T = self.T @ np.linalg.cholesky(np.tensordot(unknowns, self.units(), 1))


def _coupling_matrix(first: _ProjectedLmi, second: _ProjectedLmi, between: Array) -> Array:
    """Returns the matrix J2 J1' in the current coordinates of the two inequalities."""
    return np.linalg.solve(second.T, np.linalg.solve(first.T, between.T).T)


def _blocks(first: _ProjectedLmi, second: _ProjectedLmi | None, between: Array) -> tuple[list[Block], int]:
    """Returns the blocks of the constraints on the unknowns (X, eta, S, t), and the number of unknowns in (X, eta)."""
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
        joint[:b, b:] = _coupling_matrix(first, second, between)
        joint[b:, :b] = joint[:b, b:].T
    blocks.append((joint, X))
    return [block for block in blocks if len(block[0])], k
