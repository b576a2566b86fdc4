"""Central path of the design problem, followed to its limit, which is a unique optimal solution.

The optimum of (22) or (25) is attained by all pairs (X, Y) on a face of the feasible set. The value gamma is therefore unique,
but the gain is not. An interior-point solver returns a point of this face that depends on the scaling and the tolerance of the
solver. The design is therefore defined as the limit, for mu -> 0, of the unique solution of the problem

    maximise   eta / mu + log det X_Q + log det X_R + log det(-F(X_Q, X_R, Y_R, eta))

The limit does not depend on a solver, nor on state coordinates or units of inputs and time, which only add constants to the
logarithms. The gains published in the paper are equal to the gains at this limit.

The path is followed by Newton's method (Boyd, Vandenberghe, Convex Optimization, chapter 11); each step starts with a predictor
along the tangent of the path in mu. Two changes of coordinates keep all numbers close to 1. In the state coordinates T = [Q R],
equation (12) becomes X = diag(X_Q, X_R) and Y = [0 Y_R]. State feedback is the case of an empty Q and R = I. At each point of
the path, the coordinates are changed again so that X = I and Y = 0. The gain at the current point then becomes part of the
plant.

For a discrete plant, log det of the larger matrix in `certificate.py` replaces the three logarithms, because the larger matrix
contains all constraints. As the sample period decreases, the path of the discrete plant approaches the path of the continuous
plant.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg
from scipy.linalg import lapack

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.extensions import FEATURES
from models.common.threads import one_thread
from synth.analysis.certificate import bounded_real_matrix
from synth.lmi.barrier import Barrier, Derivatives, FactoredDerivatives, WithLogTerm, boundary, newton
from synth.lmi.output_nulling import hides_stable_states
from synth.lmi.unknowns import Basis, direction
from synth.plant.generalized import Plant, check_posed, fed_back
from synth.plant.numerics import DesignError, NoSolutionError, TooLargeError
from synth.plant.units import reachable, size

if TYPE_CHECKING:
    from synth.lmi.unobservable import UnobservableReduction

LIMIT = 1e-9
"""Value of mu / eta at which the path ends. For the paper's problem, the gains are then within 3e-6 of the limit."""


# Newton decrement at the points of the path, chosen so small that the dual solutions prove lower bounds
CENTRE_DECREMENT = 1e-6
# values of mu / eta for which points of the path are computed
RESTS = (1e-7, 1e-5, *(10.0**exponent for exponent in range(-3, 20)))
FIRST = 1.0  # value of mu / eta at the first point of the path, which is far from the optimum
FAR = 1e5  # condition number of X above which new coordinates are chosen; directly after a change of coordinates, X = I
# largest number of coordinate changes at one point; if X still grows after these changes, the path has no point for this mu
MOST_MOVES = 12
DENSE = 200  # largest number of unknowns for which a dense basis is faster, because computations then need fewer calls
# Largest number of unknowns of an LMI problem; a plant with 61 states and one input is just below this limit. A path then takes
# half a minute. The time grows with the cube of the number of unknowns, and the memory with its square.
MOST = 2000
MOST_BORDERED = 600  # largest number of unknowns for a discrete plant; its matrices are larger, and they are treated as dense
LARGEST_Y = 10.0  # upper bound on |Y| in the search for a feasible point
INSIDE = 0.95  # longest predictor step, as a fraction of the distance to the boundary
BREAKS_OFF = (
    "rounding errors stop it, as happens if only an infinite gain reaches the optimum; weight the control force more, or give "
    "other units"
)


@dataclass(frozen=True, eq=False)
class CentralPoint:
    """Strictly feasible point that lies on the central path.

    Attributes:
        X: matrix X of the form (12), shape (n, n).
        K: gain Y_R X_R^-1 of (13), shape (m, q). The gain K acts on the q coordinates that R spans.
        eta: value of gamma^-2 at the point. The optimal eta is larger than the eta of this point by at most (2 n + d) mu.
        mu: path parameter mu of the point, divided by eta.
        proof: matrix that proves the bound if `X` itself does not prove it because of states that are unobservable in z;
            otherwise None.
    """

    public_name = "a point of a central path"

    X: Array
    K: Array
    eta: float
    mu: float
    proof: Array | None = None

    @property
    def gamma(self) -> float:
        """Bound gamma = eta^-1/2 that the point of the path proves, as in (23) and (26)."""
        return self.eta**-0.5

    def in_units(self, states: Array, inputs: Array, measured: Array) -> "CentralPoint":
        """Returns the point of the path, converted to other units.

        Args:
            states: present unit of each state, expressed in the new unit, shape (n,).
            inputs: present unit of each input, expressed in the new unit, shape (m,).
            measured: present unit of each of the q inputs of K, expressed in the new unit, shape (q,). The argument `measured`
                can also be a matrix S of shape (q, q), if the new inputs of K are S times the present inputs.
        """
        square = np.outer(states, states)
        proof = None if self.proof is None else square * self.proof
        K = inputs[:, None] * self.K
        K = K / measured if measured.ndim == 1 else np.linalg.solve(measured.T, K.T).T
        return replace(self, X=square * self.X, K=K, proof=proof)


def central_path(plant: Plant, Q: Array, R: Array, mu: float = LIMIT) -> list[CentralPoint]:
    """Returns points along the central path of (25), or of (22) if Q is empty and R = I. The last point of the path is the
    design.

    Args:
        plant: plant with n states and m inputs.
        Q: matrix of shape (n, n - q).
        R: matrix of shape (n, q) for which [Q R] is invertible.
        mu: value of mu / eta at which the path ends. The default is close to the limit; a larger value ends the path farther
            from the optimum.

    Returns:
        Points with eta > 0 in order of decreasing mu. Each mu is between a hundredth and a tenth of the previous mu.

    Raises:
        InputError: no disturbance acts on the plant, or no signal is weighted.
        NoSolutionError: there is no feasible point with eta > 0.
        TooLargeError: the problem has more than MOST unknowns.
        DesignError: Newton's method failed before mu / eta reached the value `mu`.
    """
    return list(along_path(plant, Q, R, mu))


def along_path(plant: Plant, Q: Array, R: Array, mu: float) -> Iterator[CentralPoint]:
    """Yields the points of `central_path` one by one.

    The first points are therefore available even if the path cannot be completed.
    """
    if plant.dt is None:
        yield from _in_differences(plant, Q, R, mu, 0.0)
    else:
        for point in _in_differences(plant.differences, Q, R, mu, plant.dt):
            yield replace(point, X=plant.dt * point.X, proof=None if point.proof is None else plant.dt * point.proof)


def _in_differences(plant: Plant, Q: Array, R: Array, mu: float, step: float) -> Iterator[CentralPoint]:
    """Yields the points for a plant in difference form with the period `step` [s], or a continuous plant if `step` is 0."""
    check_posed(plant.unmeasured)
    if not len(plant.A):
        raise DesignError("a gain can make all states unobservable in z, so every such gain is optimal; weight a state in z")
    part = None
    if hides_stable_states(plant, np.hstack([Q, R]), step):
        part = FEATURES.load("unobservable states").remove_unobservable(plant, Q, R, step)
    # X may grow without bound along states that are unobservable in z, so the path is computed for the other states only
    if part is not None:
        for point in _in_differences(part.rest, part.Q, part.R, mu, step):
            yield _put_back(part, point)
        return
    fits(unknowns(plant, Q.shape[1]), MOST_BORDERED if step else MOST, "the central path")
    with one_thread():
        try:
            path = PathPoint(plant, Q, R, step)
            path.find_feasible_point()
        except np.linalg.LinAlgError as error:
            raise NoSolutionError(
                f"the LMI problem has no feasible point beyond rounding ({error}): a mode stays on the {_border(step)}; measure "
                "more signals, or give other units"
            ) from error
        try:
            yield from path.follow(mu)
        except np.linalg.LinAlgError as error:
            raise DesignError(f"the central path could not be followed ({error}): {BREAKS_OFF}") from error


def _border(step: float) -> str:
    """Returns the name of the stability boundary: the imaginary axis or the unit circle."""
    return "unit circle" if step else "imaginary axis"


def _put_back(part: "UnobservableReduction", point: CentralPoint) -> CentralPoint:
    """Converts a point of the path for the plant without its unobservable states to a point for the whole plant."""
    try:
        proof = part.proof(point.K, point.X if point.proof is None else point.proof, point.eta)
        return CentralPoint(part.completed_x(point.K, point.X, point.eta), part.gain(point.K), point.eta, point.mu, proof)
    except (np.linalg.LinAlgError, ValueError) as error:  # scipy raises a ValueError if a value is NaN or infinite
        raise DesignError(f"rounding prevents an X for the states unobservable in z ({error}); give other units") from error


def unknowns(plant: Plant, free: int = 0) -> int:
    """Returns the number of unknowns of (22) or, if Q has `free` columns, of (25)."""
    n, m = len(plant.A), plant.independent_inputs().shape[1]
    q = n - free
    return free * (free + 1) // 2 + q * (q + 1) // 2 + m * q + 1


def fits(count: int, most: int, what: str) -> None:
    """Raises a TooLargeError if the number of unknowns exceeds the limit of the method that is named by `what`."""
    if count > most:
        raise TooLargeError(
            f"the LMI problem has {count} unknowns, but {what} allows at most {most}; remove states from the model"
        )


class PathPoint:
    """Current point of a central path that is being followed, and the coordinates in which this point is X = I and Y = 0."""

    def __init__(self, plant: Plant, Q: Array, R: Array, step: float) -> None:
        self.free = Q.shape[1]  # number a = n - q of columns of Q
        T = np.hstack([Q, R])
        # Inputs that have no effect stay zero, and linearly dependent inputs are combined.
        self.inputs = plant.independent_inputs()
        plant = plant.with_inputs(self.inputs).in_coordinates(T)
        # This scaling only improves the numerical accuracy. States are scaled by their controllability, and the units are
        # chosen so that A, B, Bw and C have size 1.
        scaling = reachable(plant, self.free)
        plant = plant.in_coordinates(scaling)
        # If A = 0, the rate is chosen so that the motion and the force have equal weight in z.
        self.rate = size(plant.A) if plant.A.any() else size(plant.B) * size(plant.C) / size(plant.D)
        self.step = step * self.rate
        self.input_unit = self.rate / size(plant.B)
        self.disturbance_unit = self.rate / size(plant.Bw)
        self.output_unit = 1 / size(plant.C)
        (n, m), system = plant.B.shape, plant.system_matrix
        system[:n] /= self.rate
        system[n:] *= self.output_unit
        system[:, n : n + m] *= self.input_unit
        system[:, n + m :] *= self.disturbance_unit
        # Unknowns, and their coefficients for the plant in the current coordinates
        self.basis = Basis(system, n, m, self.free, self.step)
        self.start = T @ scaling  # matrix that maps the initial coordinates of the path to the user's coordinates
        self.block_start = scaling[self.free :, self.free :]
        self.V = np.eye(len(T))  # matrix that maps the current coordinates to the initial coordinates
        # gain that has been absorbed into the plant so far, in the initial coordinates
        self.K = np.zeros((plant.B.shape[1], R.shape[1]))
        self.eta = 0.0

    @property
    def plant(self) -> Plant:
        """Plant in the current coordinates of the path."""
        return self.basis.plant

    def find_feasible_point(self) -> None:
        """Finds a strictly feasible point, at which the path can start.

        Feasible points exist if and only if He(A X + B Y) < 0, where He(M) = M + M', has a solution with the structure (12). If
        a solution (X, Y) is multiplied by a small enough factor, it satisfies (24) with some eta > 0. The method therefore
        minimises s subject to He(A X + B Y) < s I, 0 < X < I, |Y| < LARGEST_Y, until s < 0.

        Raises:
            NoSolutionError: there is no feasible point, up to rounding.
        """
        basis, n, m = self.basis, self.basis.n, self.basis.m
        p = basis.pack(np.eye(n) / 2, np.zeros((m, n)), 0.0)
        A = basis.system[:n, :n]
        s = np.linalg.eigvalsh((A + A.T) / 2 + self.step / 2 * A @ A.T if self.step else (A + A.T) / 2)[-1]
        mu = max(abs(s), 1e-3)
        p[-1] = s + mu
        barrier, here = self._start_barrier(), None
        while True:
            p, _, here = newton(barrier, p, direction(basis.size, 1 / mu), tolerance=0.3, here=here)
            if p[-1] < 0:
                break
            mu /= 10
            if mu < 1e-10:
                # On the path, s exceeds its infimum by at most mu times the number of rows. The infimum is therefore 0 up to
                # rounding.
                raise NoSolutionError(
                    f"the LMI problem is infeasible: no X > 0 of the required structure makes A X + B Y + (A X + B Y)' negative "
                    f"definite (its largest eigenvalue is at least {p[-1]:.0e}, in units of |A||X|)"
                    + (
                        ". The measured signals may not suffice, or L does not fit the problem; measure more signals"
                        if self.free
                        else f": no gain on these measurements moves every mode off the {_border(self.step)} by more than "
                        "rounding"
                    )
                )

        p[-1] = 0.0
        X, Y, _ = basis.unpack(p)
        X, Y, largest = self._scaled(X, Y)
        self.eta = 0.5 * largest
        self._move_to(X, Y)

    def _scaled(self, X: Array, Y: Array) -> tuple[Array, Array, float]:
        """Scales a pair (X, Y) with He(A X + B Y) < 0 so that it satisfies (24).

        Returns:
            The scaled X and Y, and the largest eta that (24) allows for these matrices.
        """
        plant, n, k = self.plant, self.basis.n, len(self.basis.system)

        def inner() -> Array:
            """Returns the matrix of (24). For a discrete plant, the additional rows of the matrix are eliminated by a Schur
            complement.
            """
            F = bounded_real_matrix(plant, X, Y, 0.0, self.step)
            return F[:k, :k] - F[:k, k:] @ np.linalg.solve(F[k:, k:], F[k:, :k]) if self.step else F

        F = inner()
        low = F[n:, :n]
        if self.step:
            needed = np.linalg.eigvalsh(F[n:, n:] + np.eye(k - n) - low @ np.linalg.solve(F[:n, :n], low.T))[-1]
        else:
            needed = linalg.eigh(low.T @ low, -F[:n, :n], eigvals_only=True)[-1]
        shrink = 0.5 / max(needed, 1e-12)
        X, Y = shrink * X, shrink * Y
        F = inner()
        disturbance = self.basis.system[:, n + self.basis.m :]
        return X, Y, 1 / linalg.eigh(disturbance @ disturbance.T, -F, eigvals_only=True)[-1]

    def follow(self, mu_end: float) -> Iterator[CentralPoint]:
        """Follows the path until mu / eta reaches `mu_end`, and yields the points at which mu / eta has a value in `RESTS`.

        At the points in `RESTS`, mu / eta is fixed instead of mu. To fix mu / eta, log(eta) eta / mu replaces eta / mu in the
        objective. The points are therefore independent of units and of the first point of the path. Some of the points in
        `RESTS` are designs, or define the matrix L of (14).
        """
        rest, moves = max(FIRST, mu_end), 0
        barrier, start, here = self._entered(rest)
        if here is None:  # only rounding can make the starting point infeasible
            raise DesignError(f"the central path could not be started: {BREAKS_OFF}")
        while True:
            p, decrement, here = newton(barrier, start, np.zeros(len(start)), CENTRE_DECREMENT, self._far, here)
            if decrement > 0.5 and moves < MOST_MOVES and self._far(p) and (moved := self._moved(p, rest)):
                moves += 1
                barrier, start, here = moved
                continue
            if decrement > 0.5:
                raise DesignError(
                    f"the central path could not be followed below mu = {rest:.1e} (Newton decrement {decrement:.1e}): "
                    f"{BREAKS_OFF}"
                )
            X, Y, self.eta = self.basis.unpack(p)
            yield self.point(X, Y, rest)
            if rest <= mu_end:
                return
            following = next_rest(rest, mu_end)
            # The step follows the tangent of the path in mu, and it is so short that the point stays feasible
            step = here.solve(here.half(direction(len(p), 1 / (rest * self.eta))))
            step = min(1 - following / rest, INSIDE * boundary(here, step)) * step
            moved = next(filter(None, (self._moved(p + part * step, following) for part in (1.0, 0.5, 0.1, 0.0))), None)
            if moved is None:
                raise DesignError(f"the central path could not be followed below mu = {rest:.1e}: {BREAKS_OFF}")
            rest, (barrier, start, here) = following, moved

    def _entered(self, rest: float) -> tuple[WithLogTerm, Array, FactoredDerivatives | None]:
        """Returns the barrier for a value of mu / eta, the current point, and the derivatives at this point (None if
        infeasible).
        """
        barrier, n, m = WithLogTerm(self._barrier(), 1 / rest), self.basis.n, self.basis.m
        start = self.basis.pack(np.eye(n), np.zeros((m, n)), self.eta)
        return barrier, start, barrier.at(start)

    def _moved(self, p: Array, rest: float) -> tuple[WithLogTerm, Array, FactoredDerivatives] | None:
        """Changes the coordinates to those of the point p, and returns the result of `_entered`.

        If rounding makes the point infeasible, returns None and leaves the coordinates unchanged.
        """
        before = self.V, self.K, self.basis, self.eta
        X, Y, self.eta = self.basis.unpack(p)
        # a matrix is singular, or a number is outside the range of floating point
        with contextlib.suppress(np.linalg.LinAlgError, InputError):
            self._move_to(X, Y)
            barrier, start, here = self._entered(rest)
            if here is not None:
                return barrier, start, here
        self.V, self.K, self.basis, self.eta = before
        return None

    def _far(self, p: Array) -> bool:
        """Returns True if X differs so much from I that new coordinates are needed."""
        sizes = lapack.dsyevd(self.basis.unpack(p)[0], compute_v=0)[0]  # pyright: ignore[reportAttributeAccessIssue]
        return bool(sizes[-1] > FAR * sizes[0])

    def _barrier(self) -> Derivatives:
        """Returns the barrier of the constraints (24) and X > 0."""
        basis, n = self.basis, self.basis.n
        if self.step:
            return Barrier([(-basis.F0, -basis.F)])
        if basis.size > DENSE:
            return FEATURES.load("large plants").path_barrier(self.plant, self.free)
        return Barrier([(-basis.F0, -basis.F), (np.zeros((n, n)), basis.X)])

    def _start_barrier(self) -> Derivatives:
        """Returns the barrier for the search that finds a feasible point. The last unknown of this barrier is s in He(A X + B
        Y) < s I.
        """
        basis, n, m = self.basis, self.basis.n, self.basis.m
        if basis.size > DENSE and not self.step:
            return FEATURES.load("large plants").start_barrier(self.plant, self.free, LARGEST_Y)
        without_z = np.r_[:n, len(basis.system) : len(basis.F0)]
        lyapunov = np.ascontiguousarray(basis.F[:, without_z[:, None], without_z])
        lyapunov[-1] = 0.0
        lyapunov[-1, :n, :n] = -np.eye(n)
        box = np.zeros((basis.size, m + n, m + n))
        box[:, :m, m:], box[:, m:, :m] = basis.Y, basis.Y.transpose(0, 2, 1)
        return Barrier(
            [
                (np.zeros((len(without_z), len(without_z))), -lyapunov),
                (np.zeros((n, n)), basis.X),
                (np.eye(n), -basis.X),
                (LARGEST_Y * np.eye(m + n), box),
            ]
        )

    def point(self, X: Array, Y: Array, rest: float) -> CentralPoint:
        """Converts a pair (X, Y) in the current coordinates to a point in the coordinates and units of the user."""
        T = self.start @ self.V
        return CentralPoint(
            X=T @ X @ T.T * (self.rate * self.output_unit**2),  # equation (21) determines the unit of X
            K=self.inputs @ self._gain(X, Y) @ np.linalg.inv(self.block_start) * self.input_unit,
            eta=self.eta * (self.disturbance_unit * self.output_unit) ** 2,
            mu=rest,
        )

    def _move_to(self, X: Array, Y: Array) -> None:
        """Changes the coordinates so that X becomes I and Y becomes 0."""
        a, n, m = self.free, self.basis.n, self.basis.m
        S = np.zeros_like(X)
        S[:a, :a], S[a:, a:] = np.linalg.cholesky(X[:a, :a]), np.linalg.cholesky(X[a:, a:])
        # The function `fed_back` preserves the digits of A + B G, even if the gain cancels most of A.
        system = self.basis.system.copy()
        system[:, :n] = fed_back(system[:, :n], system[:, n : n + m], Y @ np.linalg.inv(X))[0] @ S
        system[:n] = lapack.dtrtri(S, lower=1)[0] @ system[:n]  # pyright: ignore[reportAttributeAccessIssue]
        if not np.isfinite(system).all():
            raise np.linalg.LinAlgError("numbers are out of range")
        self.K, self.V = self._gain(X, Y), self.V @ S
        self.basis = Basis(system, n, m, a, self.step)

    def _gain(self, X: Array, Y: Array) -> Array:
        """Returns the gain at the current point, expressed in the coordinates in which the path started.

        The gain is Y_R X_R^-1 plus the gain that has become part of the plant so far.
        """
        a = self.free
        return self.K + Y[:, a:] @ np.linalg.inv(X[a:, a:]) @ np.linalg.inv(self.V[a:, a:])


def next_rest(mu: float, mu_end: float) -> float:
    """Returns the next value of mu / eta on the path, which is the next value in `RESTS` or a value on the way to mu_end.

    The values in `RESTS` are the same for all plants.
    """
    return min(max((rest for rest in RESTS if mu_end < rest < 0.5 * mu), default=mu_end), 0.5 * mu)
