"""The central path of the design problem, followed to its limit: the one optimal solution that is unique.

The optimum of (22) or (25) is attained on a whole face of pairs (X, Y): gamma is well defined, the gain is not, and an
interior-point solver returns whichever point of the face its scaling and tolerance lead to. The limit of

    maximise   eta / mu + log det X_Q + log det X_R + log det(-F(X_Q, X_R, Y_R, eta)),     mu -> 0,

is unique, and depends on no solver and no choice of state coordinates, input units or time unit: changing them only adds
constants to the logarithms. It is what the paper printed.

It is followed by Newton's method (Boyd, Vandenberghe, Convex Optimization, chapter 11) with a predictor along its tangent in
mu. Two changes of coordinates keep every number of order one. In the state coordinates T = [Q R], equation (12) reads
X = diag(X_Q, X_R) and Y = [0 Y_R]; state feedback is the case of an empty Q and R = I. And at every stage the coordinates are
moved to the current point, where X = I and, with the current gain absorbed in the plant, Y = 0.

Of a discrete plant log det of the bordered matrix of `bounded_real.py` takes the place of the last two logarithms, for it holds X
already: log det(-F) of the continuous limit, and log det X. So as the step falls this path becomes that of the continuous plant.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg
from scipy.linalg import lapack

from models.common.arrays import Array
from models.common.errors import InputError
from models.common.threads import one_thread
from synth.certificate.bounded_real import bounded_real_matrix
from synth.errors import DesignError, InfeasibleError, TooLargeError
from synth.lmi.barrier import Barrier, Derivatives, Factored, boundary, newton
from synth.lmi.basis import Basis, direction
from synth.lmi.structured import Constraint, StructuredBarrier, path_constraints, start_constraints
from synth.lmi.unseen import Unseen, unseen
from synth.plant import GeneralizedPlant, check_posed
from synth.scaling import reachable, size

LIMIT = 1e-9
"""Distance mu / eta at which the path counts as having arrived: gains are within 3e-6 of the limit for the paper's problem."""


CENTRED = 1e-6  # Newton decrement at the points of the path: close enough for the duals that prove lower bounds
RESTS = (1e-7, 1e-5, *(10.0**exponent for exponent in range(-3, 20)))  # mu over eta
AT_REST = 1e-7  # relative in eta; how close the path comes to where it is to rest
FIRST, LAST = 1.0, 1e-3  # rests that are kept exactly: before they are far from any optimum, after them eta hardly moves
CORRECTIONS = 20  # of mu; one or two do, but where the path is entered beyond FIRST
BACK = 3.0  # times mu at most, on the way back to FIRST
FROM = 1e3  # where the path is entered: mu over the eta of the first feasible point, far from any optimum
FAR = 1e5  # condition of X from which the coordinates, in which it was I, no longer fit
MOST_MOVES = 12  # to other coordinates off the path; a larger X grows without end, and there is no centre
DENSE = 200  # unknowns; up to so many a dense basis is quicker, for it takes fewer calls
MOST = 2000  # unknowns, 62 states with one input: half a minute for a path; time grows with the cube, memory with the square
MOST_BORDERED = 600  # likewise of a discrete plant, whose matrices are larger and have no structure that is made use of
LARGEST_Y = 10.0  # in the search for a feasible point
INSIDE = 0.95  # of the way to the boundary, where a step along the path would leave
BREAKS_OFF = (
    "rounding ends it there, as it does where the optimum is reached only by an infinite gain; weigh the control force more, or "
    "give other units"
)


@dataclass(frozen=True, eq=False)
class CentralPoint:
    """A strictly feasible point on the central path.

    Attributes:
        X: shape (n, n), by (12).
        K: gain Y_R X_R^-1, shape (m, q), by (13). It acts on the q coordinates that R spans.
        eta: gamma^-2 of the point; the optimum lies above it, by at most (2 n + d) mu.
        mu: the parameter of the path, relative to eta.
        proof: an X that proves the bound where X itself does not, for what z does not see only follows the rest in it; else None.
    """

    X: Array
    K: Array
    eta: float
    mu: float
    proof: Array | None = None

    @property
    def gamma(self) -> float:
        """The bound eta^-1/2 that this point proves, (23) and (26)."""
        return self.eta**-0.5

    def in_units(self, states: Array, inputs: Array, measured: Array) -> "CentralPoint":
        """The point of the same plant in other units.

        Args:
            states: what this plant's unit of each state counts in the other, shape (n,).
            inputs: likewise, shape (m,).
            measured: likewise of what K acts on, shape (q,); or S, where that is S times what K acts on here, shape (q, q).
        """
        square = np.outer(states, states)
        proof = None if self.proof is None else square * self.proof
        K = inputs[:, None] * self.K
        K = K / measured if measured.ndim == 1 else np.linalg.solve(measured.T, K.T).T
        return replace(self, X=square * self.X, K=K, proof=proof)


def central_path(plant: GeneralizedPlant, Q: Array, R: Array, mu: float = LIMIT) -> list[CentralPoint]:
    """Points along the central path of (25), or of (22) with an empty Q and R = I. The last, at mu, is the design.

    Args:
        plant: n states, m inputs; continuous or discrete.
        Q: shape (n, n - q).
        R: shape (n, q); [Q R] is regular.
        mu: where the path ends, relative to eta. The default is its limit; a larger one stays short of the optimum.

    Returns:
        Points with eta > 0, in the order of falling mu, each a tenth to a hundredth of the one before.

    Raises:
        InputError: nothing disturbs the plant, or nothing is weighed.
        InfeasibleError: there is no feasible point with eta > 0.
        TooLargeError: the problem has more than MOST unknowns.
        DesignError: Newton's method broke down short of mu.
    """
    return list(along_path(plant, Q, R, mu))


def along_path(plant: GeneralizedPlant, Q: Array, R: Array, mu: float = LIMIT) -> Iterator[CentralPoint]:
    """The same points one by one, for those who can use the first where the last cannot be reached."""
    if plant.dt is None:
        yield from _in_differences(plant, Q, R, mu, 0.0)
    else:
        for point in _in_differences(plant.differences, Q, R, mu, plant.dt):
            yield replace(point, X=plant.dt * point.X, proof=None if point.proof is None else plant.dt * point.proof)


def _in_differences(plant: GeneralizedPlant, Q: Array, R: Array, mu: float, step: float) -> Iterator[CentralPoint]:
    """The same of a plant in differences over a step; over a step of 0 of a continuous one."""
    check_posed(plant)
    if not len(plant.A):
        raise DesignError("z sees no state that a gain does not keep out of it: every such gain is an optimum")
    part = unseen(plant, Q, R, step)
    if part is not None:  # X may grow there without bound: the path is that of the rest
        for point in _in_differences(part.rest, part.Q, part.R, mu, step):
            yield _put_back(part, point)
        return
    fits(unknowns(plant, Q.shape[1]), MOST_BORDERED if step else MOST, "the central path is followed")
    with one_thread():
        try:
            path = _Path(plant, Q, R, step)
            path.find_feasible_point()
        except np.linalg.LinAlgError as error:
            raise InfeasibleError(
                f"the LMI problem has no feasible point that is one beyond rounding ({error}): at best a mode stays on the "
                f"{_border(step)}; measure more signals, or give other units"
            ) from error
        try:
            yield from path.follow(mu)
        except np.linalg.LinAlgError as error:
            raise DesignError(f"the central path could not be followed ({error}): {BREAKS_OFF}") from error


def _border(step: float) -> str:
    """Where modes lie that neither decay nor grow."""
    return "unit circle" if step else "imaginary axis"


def _put_back(part: Unseen, point: CentralPoint) -> CentralPoint:
    """A point of the path of what z sees as one of the whole plant.

    Raises:
        DesignError: rounding leaves no X of the whole.
    """
    try:
        proof = part.proof(point.K, point.X if point.proof is None else point.proof, point.eta)
        return CentralPoint(part.followed(point.K, point.X, point.eta), part.gain(point.K), point.eta, point.mu, proof)
    except (np.linalg.LinAlgError, ValueError) as error:  # scipy's word for what is not finite
        raise DesignError(f"rounding leaves no X of the states that z does not see ({error}); give other units") from error


def unknowns(plant: GeneralizedPlant, free: int = 0) -> int:
    """How many entries X, Y and eta of (12) have: of (22), or of (25) with as many columns of Q."""
    n, m = len(plant.A), plant.independent_inputs().shape[1]
    q = n - free
    return free * (free + 1) // 2 + q * (q + 1) // 2 + m * q + 1


def fits(count: int, most: int, what: str) -> None:
    """Raises a TooLargeError for more unknowns than `what` is done with."""
    if count > most:
        raise TooLargeError(f"the LMI problem has {count} unknowns, and {what} with at most {most}; take states out of the model")


class _Path:
    """A point that walks along the path. The only mutable thing in this package; it lives inside `central_path`."""

    def __init__(self, plant: GeneralizedPlant, Q: Array, R: Array, step: float) -> None:
        self.free = Q.shape[1]  # a = n - q
        T = np.hstack([Q, R])
        # Inputs that do nothing are left at zero, and those that do the same share it.
        self.inputs = plant.independent_inputs()
        plant = plant.with_inputs(self.inputs).in_coordinates(T)
        # Only numerics from here on: states scaled by what the inputs can reach, and units in which A, B, Bw, C have size one.
        scaling = reachable(plant, self.free)
        plant = plant.in_coordinates(scaling)
        # Without dynamics of its own a plant has the rate at which motion and force weigh alike in z.
        self.rate = size(plant.A) if plant.A.any() else size(plant.B) * size(plant.C) / size(plant.D)
        self.step = step * self.rate
        self.input_unit = self.rate / size(plant.B)
        self.disturbance_unit = self.rate / size(plant.Bw)
        self.output_unit = 1 / size(plant.C)
        self.plant = GeneralizedPlant(
            A=plant.A / self.rate,
            B=plant.B * self.input_unit / self.rate,
            Bw=plant.Bw * self.disturbance_unit / self.rate,
            C=plant.C * self.output_unit,
            D=plant.D * self.output_unit * self.input_unit,
            Dw=plant.Dw * self.output_unit * self.disturbance_unit,
        )
        self.start = T @ scaling  # from the scaled coordinates of the beginning to the user's
        self.block_start = scaling[self.free :, self.free :]
        self.V = np.eye(len(T))  # from the current coordinates to those of the beginning
        self.K = np.zeros((plant.B.shape[1], R.shape[1]))  # the gain absorbed so far, in those of the beginning
        self.eta = 0.0
        self.mu = np.inf
        self.basis = self._basis()

    def find_feasible_point(self) -> None:
        """A strictly feasible point, or the proof that there is none.

        Feasible points exist if and only if He(A X + B Y) < 0 has a solution of the structure (12): scaled down far enough, any
        such pair satisfies (24) with some eta > 0. So: minimise s over He(A X + B Y) < s I, 0 < X < I, |Y| < LARGEST_Y, until
        s < 0.
        """
        basis, n, m = self.basis, len(self.plant.A), self.plant.B.shape[1]
        p = basis.pack(np.eye(n) / 2, np.zeros((m, n)), 0.0)
        A = self.plant.A
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
                # On the path s exceeds its infimum by no more than (number of rows) mu, so the infimum is 0 to rounding.
                raise InfeasibleError(
                    f"the LMI problem is infeasible: no X > 0 of the required structure makes A X + B Y + (A X + B Y)' negative "
                    f"definite (smallest largest eigenvalue found: {p[-1]:.0e}, in units of |A||X|)"
                    + (
                        ". The measured signals may not suffice, or L does not fit the problem; measure more signals"
                        if self.free
                        else f": no gain from what is measured moves every mode off the {_border(self.step)} by more than "
                        "rounding"
                    )
                )

        p[-1] = 0.0
        X, Y, _ = basis.unpack(p)
        X, Y, largest = self._scaled(X, Y)
        self.eta = 0.5 * largest
        self.mu = FROM * self.eta
        self._move_to(X, Y)

    def _scaled(self, X: Array, Y: Array) -> tuple[Array, Array, float]:
        """A pair with He(A X + B Y) < 0, scaled to fit (24), and the largest eta that it then allows."""
        n, k = len(self.plant.A), len(self.plant.A) + len(self.plant.C)

        def inner() -> Array:
            """(24) without the border of a step, which is taken out by its Schur complement."""
            F = bounded_real_matrix(self.plant, X, Y, 0.0, self.step)
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
        disturbance = np.vstack([self.plant.Bw, self.plant.Dw])
        return X, Y, 1 / linalg.eigh(disturbance @ disturbance.T, -F, eigvals_only=True)[-1]

    def follow(self, mu_end: float) -> Iterator[CentralPoint]:
        """Walks along the path until mu = mu_end eta; yields the points it rests at."""
        n, m = len(self.plant.A), self.plant.B.shape[1]
        moves, rest, entered = 0, np.inf, False
        while True:
            basis, barrier = self.basis, self._barrier()
            start = basis.pack(np.eye(n), np.zeros((m, n)), self.eta)
            leave = self._far if entered else self._out_of_reach
            here = barrier.at(start)
            if here is None:  # to rounding, in coordinates that were left far away
                raise DesignError(f"the central path could not be entered: {BREAKS_OFF}")
            p, decrement, here = newton(barrier, start, direction(basis.size, -1 / self.mu), CENTRED, leave, here)
            if decrement > 0.5 and moves < MOST_MOVES and leave(p) and self._feasible_at(p):
                moves += 1
                if not entered:
                    self.mu = max(self.mu, FROM * self.eta)
                continue  # from there, in its own coordinates
            if decrement > 0.5:
                raise DesignError(
                    f"the central path could not be followed below mu = {self.mu / abs(p[-1]):.1e} (Newton decrement "
                    f"{decrement:.1e}): {BREAKS_OFF}"
                )
            entered = True
            if p[-1] > 0 and not np.isfinite(rest):
                rest = max(FIRST, mu_end, nearest_rest(self.mu / p[-1], mu_end))
            p, here, step = self._at_rest(barrier, p, here, rest)
            X, Y, self.eta = basis.unpack(p)
            if self.eta > 0:
                yield self.point(X, Y)
                if self.mu <= mu_end * self.eta * 1.001:
                    return
            rest = next_rest(self.mu / self.eta, mu_end) if self.eta > 0 else np.inf
            ratio = _shift(rest * self.eta / self.mu, step[-1] / self.eta if _moving(rest) else 0.0) if self.eta > 0 else 0.1
            # Along the tangent of the path in mu, but inside.
            length = min(1 - ratio, INSIDE * boundary(here, step))
            if not any(self._feasible_at(p + part * length * step) for part in (1.0, 0.5, 0.1, 0.0)):
                raise DesignError(
                    f"the central path could not be followed below mu = {self.mu / abs(self.eta):.1e}: {BREAKS_OFF}"
                )
            self.mu *= ratio

    def _at_rest(self, barrier: Derivatives, p: Array, here: Factored, rest: float) -> tuple[Array, Factored, Array]:
        """The point where mu over eta is what it is to be, the derivatives there, and the tangent over -log mu.

        eta grows as mu falls, so that it is met by Newton's method over log mu. Only so the points of a path are the same in
        whatever units and from wherever it is entered; some of them are designs, or where L (14) comes from.
        """
        back = BACK
        for _ in range(CORRECTIONS):
            step = here.solve(here.half(direction(self.basis.size, 1 / self.mu)))
            off = rest * p[-1] / self.mu
            if not (p[-1] > 0 and _moving(rest)) or abs(off - 1) * step[-1] <= AT_REST * p[-1]:
                return p, here, step
            mu = self.mu * min(_shift(off, step[-1] / p[-1]), back)
            moved, decrement, there = newton(barrier, p, direction(self.basis.size, -1 / mu), CENTRED, self._far, here)
            if decrement > 0.5 or moved[-1] <= 0:
                back = back**0.5
                continue
            p, here, self.mu = moved, there, mu
        return p, here, here.solve(here.half(direction(self.basis.size, 1 / self.mu)))

    def _feasible_at(self, p: Array) -> bool:
        """Moves to a point, unless rounding puts it outside the feasible set in the coordinates of its own."""
        before = self.plant, self.V, self.K, self.basis
        X, Y, eta = self.basis.unpack(p)
        try:
            self._move_to(X, Y)
        except (np.linalg.LinAlgError, InputError):  # or where numbers leave all range
            return False
        m, n = Y.shape
        if lapack.dpotrf(-bounded_real_matrix(self.plant, np.eye(n), np.zeros((m, n)), eta, self.step))[1] != 0:  # pyright: ignore[reportAttributeAccessIssue]
            self.plant, self.V, self.K, self.basis = before
            return False
        self.eta = eta
        return True

    def _far(self, p: Array) -> bool:
        """Whether X has become so different from I that other coordinates are needed."""
        sizes = lapack.dsyevd(self.basis.unpack(p)[0], compute_v=0)[0]  # pyright: ignore[reportAttributeAccessIssue]
        return bool(sizes[-1] > FAR * sizes[0])

    def _out_of_reach(self, p: Array) -> bool:
        """Whether that is so, or eta has outgrown mu on the way to the first centre.

        Then the first feasible point was much further from any optimum than its eta says, as it is where a plant hardly moves by
        itself, and the centre for its mu lies too far away: one for a larger mu does not.
        """
        return bool(p[-1] > self.mu) or self._far(p)

    def _barrier(self) -> Derivatives:
        """The barrier of (24) and X > 0."""
        basis, n = self.basis, len(self.plant.A)
        if self.step:
            return Barrier([(-basis.F0, -basis.F)])
        if basis.size > DENSE:
            return self._structured(path_constraints(self.plant))
        return Barrier([(-basis.F0, -basis.F), (np.zeros((n, n)), basis.X)])

    def _start_barrier(self) -> Derivatives:
        """The barrier of the search for a feasible point, in which the last unknown is s."""
        basis, n, m = self.basis, len(self.plant.A), self.plant.B.shape[1]
        if basis.size > DENSE and not self.step:
            return self._structured(start_constraints(self.plant, LARGEST_Y))
        inside = np.r_[:n, len(self.plant.system_matrix) : len(basis.F0)]  # all but z
        lyapunov = np.ascontiguousarray(basis.F[:, inside[:, None], inside])
        lyapunov[-1] = 0.0
        lyapunov[-1, :n, :n] = -np.eye(n)
        box = np.zeros((basis.size, m + n, m + n))
        box[:, :m, m:], box[:, m:, :m] = basis.Y, basis.Y.transpose(0, 2, 1)
        return Barrier(
            [
                (np.zeros((len(inside), len(inside))), -lyapunov),
                (np.zeros((n, n)), basis.X),
                (np.eye(n), -basis.X),
                (LARGEST_Y * np.eye(m + n), box),
            ]
        )

    def _structured(self, constraints: list[Constraint]) -> StructuredBarrier:
        n, m = self.plant.B.shape
        return StructuredBarrier(constraints, n, m, self.free)

    def point(self, X: Array, Y: Array) -> CentralPoint:
        """A pair of the current coordinates as a point in the user's coordinates and units."""
        T = self.start @ self.V
        return CentralPoint(
            X=T @ X @ T.T * (self.rate * self.output_unit**2),  # the units follow from (21)
            K=self.inputs @ self._gain(X, Y) @ np.linalg.inv(self.block_start) * self.input_unit,
            eta=self.eta * (self.disturbance_unit * self.output_unit) ** 2,
            mu=self.mu / self.eta,
        )

    def _move_to(self, X: Array, Y: Array) -> None:
        """Changes the coordinates so that X becomes I and Y becomes 0."""
        a = self.free
        S: Any = linalg.block_diag(np.linalg.cholesky(X[:a, :a]), np.linalg.cholesky(X[a:, a:]))
        plant = self.plant.closed_loop(Y @ np.linalg.inv(X)).in_coordinates(S)
        self.plant, self.K, self.V = plant, self._gain(X, Y), self.V @ S
        self.basis = self._basis()

    def _basis(self) -> "Basis":
        return Basis.of(self.plant, self.free, self.step)

    def _gain(self, X: Array, Y: Array) -> Array:
        """Y_R X_R^-1 with all the gain absorbed before, in the coordinates of the beginning."""
        a = self.free
        return self.K + Y[:, a:] @ np.linalg.inv(X[a:, a:]) @ np.linalg.inv(self.V[a:, a:])


def _moving(rest: float) -> bool:
    """Whether eta moves that much about a rest, and it is that close to the optimum, that it matters where exactly it is."""
    return LAST <= rest <= FIRST


def _shift(off: float, growth: float) -> float:
    """The factor of mu that changes mu / eta by `off`, where eta grows as mu^-growth."""
    return off ** (1 / (1 + max(growth, 0.0)))


def nearest_rest(mu: float, mu_end: float) -> float:
    """The rest that is nearest to where the path is entered."""
    rests = np.array([mu_end, *(rest for rest in RESTS if rest > mu_end)])
    return float(rests[np.abs(np.log(rests / mu)).argmin()])


def next_rest(mu: Any, mu_end: float) -> Any:
    """Where the path rests next, mu over eta: hundredfold steps where it is nearly straight, the same rests for every plant.

    Args:
        mu: relative to eta; one, or an array of them.
        mu_end: where the path ends, likewise.
    """
    rests = np.array([mu_end, *(rest for rest in RESTS if rest > mu_end)])
    below = np.maximum(np.searchsorted(rests, 0.5 * mu) - 1, 0)
    return np.minimum(rests[below], 0.5 * mu)
