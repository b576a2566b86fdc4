"""Search for a full-order controller by Riccati equations: a norm near the lower bound, or a trade-off between norm and speed
of the poles.

The equations are from Glover, Doyle 1988 and Zhou, Doyle, Glover 1996, Robust and Optimal Control, theorem 17.1. The names
follow the book of Zhou, Doyle and Glover: D11 = Dw, D12 = D, D21 = Dyw, and X, Y, F, H with and without hats. The equations
require D and Dyw of full rank, and no zero from u to z or from w to y on the imaginary axis. If D11 is not zero, the equations
require D12 = [0; I] and D21 = [0 I]. Therefore z and w are rotated, u and y are scaled, and the result is transformed back. If
gamma is close to the smallest value for which a solution exists, the solvers can return wrong solutions, so each solution is
checked.

The order of a law is reduced in two ways. Neither way of reduction guarantees a good loop, so the loop with the reduced law is
checked again.

- *Fast modes* follow their input almost immediately. Fast modes are replaced by their static gain in D_c (residualisation;
  Kokotovic, Khalil, O'Reilly 1986, Singular Perturbation Methods in Control, section 1.3).
- *Modes that cancel* have small Hankel singular values: the measurements hardly excite them, or they hardly affect the forces.
  Modes that cancel are removed if they decay (balanced truncation; Moore 1981), and kept otherwise.

The problem is singular if a measurement has no noise or a force has no cost. The best observer or the best gain is then
infinitely fast, and the Riccati equations have no solution. A small noise and a small cost are therefore added. The size of the
added noise and cost is a share of the plant's internal units, because in these units the same share suits all signals. Small
disturbances and weights are also added to all states. The norm of the regularised problem bounds the norm of the true loop,
which has fewer disturbances and outputs:

    norm of the true loop  <=  norm of the regularised loop  <  gamma,

If the share of noise and cost is larger, the controller is slower. The share is therefore reduced until the required gamma is
reached, which gives the slowest controller with this gamma. If no share reaches the required gamma with a controller that is
slow enough for an actuator, the search returns the trade-off between norm and speed. The trade-off consists of the smallest
gamma for each share.

If gamma approaches its smallest value, some poles of the central law tend to infinity, and the law without these poles is
equally good. Each law that is too fast is therefore also tried without its fast poles.
"""

import contextlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.errors import InputError
from models.laws.linear import LinearLaw
from synth.analysis.certificate import FASTEST
from synth.analysis.norm import Gain, largest_singular_values, level_set_norm
from synth.analysis.stability import beside_weights, is_stable
from synth.plant.augmented import closed_by
from synth.plant.generalized import Plant
from synth.plant.normalised import NormalisedPlant, missing
from synth.plant.numerics import InfeasibleError
from synth.plant.units import speed

RESIDUAL = 1e-6  # a Riccati equation counts as solved if its residual is smaller than this, relative to its largest term
NEGATIVE = 1e-9  # rounding may make a zero eigenvalue negative by this amount, relative to the largest eigenvalue
EDGE = 1e-9  # a spectral radius counts as too large if it is closer to gamma^2 than this relative distance


def central_law(plant: Plant, gamma: float) -> LinearLaw:
    """Returns a stabilising law that has as many states as the plant and a closed-loop norm below gamma.

    The law's state is an estimate of the plant's state, assuming the worst disturbance.

    Args:
        plant: generalised plant with n states, m inputs, r disturbances and d controlled outputs, where D has rank m.
        gamma: value that the norm of the closed loop must stay below.

    Raises:
        InfeasibleError: no law has a norm below gamma, or rounding prevents finding such a law.
    """
    A, n, (d, m), (q, r), square = plant.A, len(plant.A), plant.D.shape, plant.Dyw.shape, gamma**2
    turn_z, from_u = _last(plant.D)  # the product turn_z' D from_u is [0; I]
    turn_w, from_y = _last(plant.Dyw.T)  # the product turn_w' Dyw' from_y is [0; I]
    B1, B2, C1, C2 = plant.Bw @ turn_w, plant.B @ from_u, turn_z.T @ plant.C, from_y.T @ plant.Cy
    D11, i, j = turn_z.T @ plant.Dw @ turn_w, d - m, r - q
    D1111, D1112, D1121, D1122 = D11[:i, :j], D11[:i, j:], D11[i:, :j], D11[i:, j:]
    if max(_size(D11[:i]), _size(D11[:, :j])) >= gamma:
        raise InfeasibleError("the direct feedthrough from w to z exceeds gamma")
    B, C = np.hstack([B1, B2]), np.vstack([C1, C2])
    D1 = np.hstack([D11, np.eye(d)[:, i:]])
    E1 = np.vstack([D11, np.eye(r)[j:]])
    X, F = _stabilising_solution(A, B, C1, D1, D1.T @ D1 - square * np.diag([1.0] * r + [0.0] * m))
    Y, H = _stabilising_solution(A.T, C.T, B1.T, E1.T, E1 @ E1.T - square * np.diag([1.0] * d + [0.0] * q))
    if np.abs(np.linalg.eigvals(X @ Y)).max(initial=0.0) >= square * (1 - EDGE):
        raise InfeasibleError("the spectral radius of X Y reaches gamma^2")
    F12, F2, H12, H2 = F[j:r], F[r:], H[i:d].T, H[d:].T
    through = -D1121 @ D1111.T @ np.linalg.solve(square * np.eye(i) - D1111 @ D1111.T, D1112) - D1122
    B_law = np.linalg.solve(np.eye(n) - Y @ X / square, (B2 + H12) @ through - H2)
    seen = C2 + F12
    A_law, C_law = A + B @ F - B_law @ seen, F2 - through @ seen
    return LinearLaw(A_law, B_law @ from_y.T, from_u @ C_law, from_u @ through @ from_y.T)


def state_gain(plant: Plant, gamma: float, share: float = 0.0) -> Array:
    """Returns the saddle-point state feedback G, shape (m, n), for a level gamma. The norm of the loop with G is below gamma.

    Args:
        plant: generalised plant with n states, m inputs, r disturbances and d controlled outputs.
        gamma: level, which must exceed the smallest norm of a state feedback.
        share: smallest cost of every force (regularisation), relative to the larger of the norms of D and C.

    Raises:
        InfeasibleError: no state feedback has a norm below gamma, or rounding prevents finding such a state feedback.
    """
    (n, m), r = plant.B.shape, plant.Dw.shape[1]
    cost = missing(plant.D, share * max(_size(plant.D), _size(plant.C)))
    C, D1 = np.vstack([plant.C, np.zeros((m, n))]), np.block([[plant.Dw, plant.D], [np.zeros((m, r)), cost]])
    R = D1.T @ D1 - gamma**2 * np.diag([1.0] * r + [0.0] * m)
    return _stabilising_solution(plant.A, np.hstack([plant.Bw, plant.B]), C, D1, R)[1][r:]


def _last(D: Array) -> tuple[Array, Array]:
    """Returns an orthogonal T and a matrix S with T' D S = [0; I], for a matrix D of full column rank."""
    m = D.shape[1]
    turned, sizes, directions = np.linalg.svd(D)
    return np.hstack([turned[:, m:], turned[:, :m]]), directions.T / sizes


def _stabilising_solution(A: Array, B: Array, C: Array, D: Array, R: Array) -> tuple[Array, Array]:
    """Returns the stabilising solution X >= 0 of a Riccati equation, and its gain F.

    The equation is A'X + X A - (X B + C'D) R^-1 (..)' + C'C = 0, with F = -R^-1 (B'X + D'C) and A + B F stable.
    """
    try:
        X = _invariant(A, B, C.T @ C, R, C.T @ D)
        F = -np.linalg.solve(R, B.T @ X + D.T @ C)
        stable = np.linalg.eigvals(A + B @ F).real.max(initial=-1.0) < 0
        sizes = np.linalg.eigvalsh(X)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise InfeasibleError(f"a Riccati equation has no solution ({error})") from error
    terms = A.T @ X, C.T @ C, (X @ B + C.T @ D) @ F
    left = np.linalg.norm(terms[0] + terms[0].T + terms[1] + terms[2])
    if not (stable and left <= RESIDUAL * max(map(np.linalg.norm, terms)) and sizes[0] >= -NEGATIVE * sizes[-1]):
        raise InfeasibleError("a Riccati equation has no stabilising solution that is positive semidefinite")
    return X, F


def _invariant(A: Array, B: Array, Q: Array, R: Array, S: Array) -> Array:
    """Returns X = X' for which [I; X] spans the stable subspace of the Riccati equation's pencil.

    The method is the same as in `scipy.linalg.solve_continuous_are` (Arnold, Laub 1984, with a balanced pencil). The checks in
    the SciPy function are omitted, because they take most of the time for small equations. The caller checks every solution.

    Raises:
        LinAlgError: the dimension of the stable subspace is not n, or the first block of its basis is singular.
    """
    # without example arrays, scipy returns the routines for double precision
    gebal, gges = linalg.get_lapack_funcs(("gebal", "gges"))
    n, m = B.shape
    H, J = np.zeros((2 * n + m, 2 * n + m)), np.zeros((2 * n + m, 2 * n))
    H[:n, :n], H[:n, 2 * n :] = A, B
    H[n : 2 * n, :n], H[n : 2 * n, n : 2 * n], H[n : 2 * n, 2 * n :] = -Q, -A.T, -S
    H[2 * n :, :n], H[2 * n :, n : 2 * n], H[2 * n :, 2 * n :] = S.T, B.T, R
    J[np.arange(2 * n), np.arange(2 * n)] = 1
    sizes = np.abs(H)
    np.fill_diagonal(sizes, 0.0)
    powers = np.log2(gebal(sizes, scale=1, permute=0)[3])
    half = np.round((powers[n : 2 * n] - powers[:n]) / 2)
    scale = np.exp2(np.concatenate([half, -half, powers[2 * n :]]))
    H = scale[:, None] * H / scale
    basis, _ = np.linalg.qr(H[:, 2 * n :], mode="complete")
    left = basis[:, m:].T
    _, _, count, _, _, _, _, Z, _, info = gges(
        lambda real, _, over: bool(real * over < 0), left @ H[:, : 2 * n], left @ J, jobvsl=0, sort_t=1
    )
    if info not in (0, 2 * n + 2) or count != n:
        raise np.linalg.LinAlgError(f"{count} of {2 * n} directions are stable")
    X = np.linalg.solve(Z[:n, :n].T, Z[n:, :n].T) * scale[:n, None] * scale[:n]
    return (X + X.T) / 2


def _size(matrix: Array) -> float:
    return float(np.linalg.norm(matrix, 2)) if matrix.size else 0.0


# Hankel singular values below this fraction of the largest one are neglected, because only half of the digits of a Hankel
# singular value are accurate
CANCELS = 1e-6


def reduced_law(law: LinearLaw, fast: float) -> LinearLaw:
    """Returns a law without its fast modes and without modes that cancel. A law without fast modes and without modes that
    cancel is returned unchanged.

    Args:
        law: law in continuous time, in units in which its entries have similar magnitudes.
        fast: magnitude [rad/s] above which a stable mode counts as fast.

    Raises:
        LinAlgError: rounding prevents a separation of the modes.
    """
    slow, quick = split_modes(law, lambda real, imag: real >= 0 or np.hypot(real, imag) < fast)
    at_once = quick.C @ np.linalg.solve(quick.A, quick.B) if quick.states else np.zeros_like(law.D)
    growing, decaying = split_modes(slow, lambda real, imag: real >= 0)
    kept = _truncate_law(decaying)
    if growing.states + kept.states == law.states:
        return law
    return LinearLaw(
        A=np.asarray(linalg.block_diag(growing.A, kept.A)),
        B=np.vstack([growing.B, kept.B]),
        C=np.hstack([growing.C, kept.C]),
        D=law.D - at_once,
    )


def split_modes(law: LinearLaw, first: object) -> tuple[LinearLaw, LinearLaw]:
    """Splits a law into two parallel laws, one with the selected modes and one with the other modes. Neither contains D."""
    none = np.zeros_like(law.D)
    if not law.states:
        return LinearLaw(law.A, law.B, law.C, none), LinearLaw(law.A, law.B, law.C, none)
    triangle, basis, k = linalg.schur(law.A, sort=first)  # pyright: ignore[reportAssignmentType, reportArgumentType]
    B, C, n = basis.T @ law.B, law.C @ basis, law.states
    one, other = triangle[:k, :k], triangle[k:, k:]
    X = linalg.solve_sylvester(one, -other, -triangle[:k, k:]) if 0 < k < n else np.zeros((k, n - k))
    return LinearLaw(one, B[:k] - X @ B[k:], C[:, :k], none), LinearLaw(other, B[k:], C[:, k:] + C[:, :k] @ X, none)


def _truncate_law(law: LinearLaw) -> LinearLaw:
    """Returns a stable law without the modes that have negligible Hankel singular values (square-root method)."""
    if not law.states:
        return law
    reached, seen = _root(law.A, law.B), _root(law.A.T, law.C.T)
    left, sizes, right = np.linalg.svd(seen.T @ reached)
    k = int(np.sum(sizes > CANCELS * sizes[0])) if sizes[0] > 0 else 0
    if k == law.states:
        return law
    into, out = seen @ left[:, :k] / np.sqrt(sizes[:k]), reached @ right[:k].T / np.sqrt(sizes[:k])
    return LinearLaw(into.T @ law.A @ out, into.T @ law.B, law.C @ out, law.D)


def _root(A: Array, B: Array) -> Array:
    """Returns a matrix L such that L L' is the controllability Gramian of A and B."""
    gramian = linalg.solve_continuous_lyapunov(A, -B @ B.T)
    sizes, directions = np.linalg.eigh((gramian + gramian.T) / 2)
    return directions * np.sqrt(np.maximum(sizes, 0.0))


WITHIN = 1e-3  # the search ends if the relative gap between norm and lower bound is smaller than this
# Shares: power of the added noise relative to the disturbance of the states, and added cost relative to the weight of the
# states in z
SHARES = tuple(10.0 ** (-k / 2) for k in range(-1, 17))
STATES = 0.1  # disturbance and weight that are added to all states, as a multiple of the share of noise and cost that is added
# multiples of the first sufficient share that are also tried
AROUND = tuple(10.0 ** (k / 8) for k in range(-8, 13))
# relative amounts by which gamma may exceed the required norm, because the actual norm is often smaller than gamma
REACHES = (0.0, 2e-3, 1e-2, 3e-2)
MARGINS = (
    1e-3,
    1e-2,
    1e-1,
    1.0,
)  # relative margins of gamma above its smallest feasible value; a larger margin gives a controller with slower poles
SAME = 1e-6  # states of a law are omitted only if the norm rises by less than this relative amount
CLOSE = 1e-4  # relative accuracy to which the smallest feasible gamma is computed
GRAIN = 2.0**-14  # step to which `_coarse` rounds the base-2 logarithm of a number
PARTS = (1.0, 0.1)  # the poles of a law that exceed one of these multiples of `much` are removed
OWN_PART = 0.3  # in a further trial, the poles above this multiple of the law's own speed are removed
# above the speed `much`, a law may be ten times as fast only if its norm decreases by at least this relative amount
PRICE = 1e-3
HALVINGS = 4  # number of bisections between two shares that bring the law close to a speed limit
ROUNDING_OF_GAIN = 1e-8  # relative rounding error of a gain that is computed at one frequency
SMALLEST, LARGEST = 1e-6, 1e9  # smallest and largest gamma, in units in which the largest entries of the plant are one


@dataclass(frozen=True, eq=False)
class TradeOffPoint:
    """Controller at one point of the trade-off between norm and speed of the poles.

    Attributes:
        share: added noise and cost, as a share of the internal units; zero if the law was found by descent.
        law: control law in the units of the given plant.
        own: the same control law in the plant's internal units.
        search: search that found the law.
        least: lower estimate of the norm, which is the largest gain at the frequencies of the poles. Computing the estimate
            `least` takes a tenth of the time that a norm takes, and this estimate rules out most controllers.
        speed_up: magnitude of the loop's fastest pole, divided by the plant's speed without control.
    """

    share: float
    law: LinearLaw
    own: LinearLaw
    search: "RiccatiSearch"
    least: float
    speed_up: float

    @cached_property
    def stable(self) -> bool:
        """True if the law itself is stable."""
        return is_stable(self.own.A)

    @cached_property
    def norm(self) -> float:
        """Norm of the loop in the units of the given plant, computed by only one method."""
        own = self.search.own
        return level_set_norm(own.plant.closed(self.own))[0] / own.norm

    def within(self, most: float) -> bool:
        """Returns True if the norm of the loop is at most `most`."""
        return self.least <= most and self.norm <= most

    @property
    def pole(self) -> float:
        """Magnitude of the loop's fastest pole [rad/s]."""
        return self.speed_up * self.search.fastest

    @property
    def excess(self) -> float:
        """Speed of the loop relative to `much`, the highest speed that need not be justified; 1 if the loop is slower."""
        return max(1.0, self.speed_up / self.search.much)

    @property
    def trouble(self) -> tuple[float, float]:
        """Sort key for laws with similar norms: the excess speed of the loop, multiplied by ten if the law is unstable.

        An unstable law is worse because it does not tolerate saturation of a force. Among laws without excess speed, stable
        laws come first.
        """
        return self.excess * (1.0 if self.stable else 10.0), self.speed_up

    @property
    def cost(self) -> float:
        """Norm, increased by a penalty for excess speed."""
        return self.norm * (1 + PRICE * np.log10(self.excess))


def pareto_front(points: Sequence[TradeOffPoint]) -> list[TradeOffPoint]:
    """Returns the controllers to which no other controller is superior in both norm and speed, in ascending order of speed."""
    front = list[TradeOffPoint]()
    for each in sorted(points, key=lambda each: each.speed_up):
        if front and not (each.least < front[-1].norm and each.norm < front[-1].norm):
            continue
        if front and front[-1].speed_up == each.speed_up:
            front.pop()
        front.append(each)
    return front


def lowest(points: Iterable[TradeOffPoint]) -> TradeOffPoint | None:
    """Returns the controller with the smallest norm; None if there is no controller."""
    best = None
    for each in sorted(points, key=lambda each: each.least):
        if best is not None and each.least >= best.norm:
            break
        best = each if best is None or each.norm < best.norm else best
    return best


def select(trade: Sequence[TradeOffPoint], fastest: float, enough: float = 0.0) -> TradeOffPoint | None:
    """Returns the slow enough controller with the smallest `trouble` and nearly the smallest cost; None if all controllers are
    too fast.

    Args:
        trade: controllers in any order.
        fastest: limit on the speed of the loop, divided by the plant's own speed.
        enough: sufficient norm; controllers with at most this norm are preferred to all other controllers.
    """
    slow = [each for each in trade if each.speed_up <= fastest]
    if near := [each for each in slow if each.within(enough)]:
        return min(near, key=lambda each: each.trouble)
    most = min((each.cost for each in slow), default=0.0) * (1 + WITHIN)
    return min((each for each in slow if each.cost <= most), key=lambda each: each.trouble, default=None)


class RiccatiSearch:
    """Search for a full-order law for one plant.

    Attributes:
        fastest: speed of the plant without control [rad/s]; see `speed`.
        much: multiple of `fastest` above which the speed of a loop must be justified by a lower norm; see `PRICE`.
    """

    def __init__(self, plant: Plant, bound: float, quick: float = 0.0) -> None:
        """Args:
        quick: speed of a loop up to which its cost contains no penalty [rad/s].
        """
        self.given, self.own = plant, NormalisedPlant.of(plant)
        self.bound = bound * self.own.norm
        self.fastest, _ = speed(plant)
        self.much = max(FASTEST, quick / self.fastest)

    def near(self, fastest: float) -> TradeOffPoint | None:
        """Returns the slow enough controller with the smallest `trouble` and a norm within WITHIN of the lower bound; None if
        none exists.
        """
        target = _coarse(self.bound * (1 + WITHIN))
        if target < SMALLEST:
            return None
        most = target / self.own.norm
        shares = (each for share in SHARES if (each := self.traded(share, target)) is not None and each.within(most))
        first = next(shares, None)
        if first is None:
            return None
        around = (self.traded(first.share * part, target * (1 + reach)) for reach, part in product(REACHES, AROUND))
        points = [first, *(each for each in around if each is not None and each.least <= most)]

        def least_trouble(points: Sequence[TradeOffPoint]) -> TradeOffPoint | None:
            slow = sorted((each for each in points if each.speed_up <= fastest), key=lambda each: each.trouble)
            return next((each for each in slow if each.within(most)), None)

        best = least_trouble(points)
        if best is None or best.excess > 1:
            less = self.slower([each for each in points if each.within(most)], fastest)
            best = least_trouble(less if best is None else [best, *less])
        return best

    def trade(self, fastest: float) -> list[TradeOffPoint]:
        """Returns controllers for all shares of noise and cost and several values of gamma, also without their fastest poles."""
        points, gamma = list[TradeOffPoint](), LARGEST
        for share in SHARES:
            gamma = self.smallest(share, gamma)
            if gamma < LARGEST:
                points += self.of_share(share, gamma)
        return points + self.slower(points, fastest)

    def of_share(self, share: float, gamma: float) -> list[TradeOffPoint]:
        """Returns controllers for one share of noise and cost, for the smallest possible gamma and several larger values of
        gamma.
        """
        tried = (self.traded(share, gamma * (1 + margin)) for margin in MARGINS)
        return [each for each in tried if each is not None]

    def next_to(self, trade: Sequence[TradeOffPoint], fastest: float) -> list[TradeOffPoint]:
        """Returns controllers for intermediate shares of noise and cost, between neighbours on a Pareto front of which only one
        is slow enough.
        """
        slow, quick = (
            [each.share for each in trade if each.share and (each.speed_up <= fastest) is side] for side in (True, False)
        )
        if not slow or not quick:
            return []
        low, high, points = quick[0], slow[-1], list[TradeOffPoint]()
        for _ in range(HALVINGS):
            share = (low * high) ** 0.5
            found = self.of_share(share, self.smallest(share, LARGEST))
            points += found
            low, high = (low, share) if any(each.speed_up <= fastest for each in found) else (share, high)
        return points

    def slower(self, points: Sequence[TradeOffPoint], fastest: float) -> list[TradeOffPoint]:
        """Removes the fast poles from the laws of controllers that are too fast.

        Returns those of the resulting controllers whose loops are still stable.
        """
        left, much = list[TradeOffPoint](), min(fastest, self.much)
        for each in points:
            for limit in [*(part * much for part in PARTS), OWN_PART * each.speed_up] if each.speed_up > much else []:
                with contextlib.suppress(InputError, np.linalg.LinAlgError):
                    law = reduced_law(each.own, limit * self.fastest / self.own.rate)
                    less = self.judged(each.share, law) if law.states < each.own.states else None
                    left += [less] if less is not None else []
        return left

    def smallest(self, share: float, above: float) -> float:
        """Returns the smallest gamma for which the regularised problem has a solution, for a given share of noise and cost.

        The smallest gamma is at most `above`, which is the smallest possible gamma for a larger share.
        """
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

    def traded(self, share: float, gamma: float) -> TradeOffPoint | None:
        """Returns the controller for a gamma and a share of noise and cost; None if no controller gives a stable loop."""
        with contextlib.suppress(InputError):  # the problem has no solution, or an entry of the law is too large
            return self.judged(share, self.law(share, gamma))
        return None

    def judged(self, share: float, law: LinearLaw) -> TradeOffPoint | None:
        """Returns the trade-off point of a law in internal units; None if the loop with this law is not stable.

        Raises:
            InputError: an entry of the law is too large in the units of the given plant.
        """
        own, back = self.own, self.own.back(law)
        system = closed_by(own.plant, law)
        loop = Gain(system)
        if not loop.stable:
            return None
        poles = np.linalg.eigvals(beside_weights(self.given, system.A)) if self.given.weights else loop.poles
        speed_up = own.rate * float(np.abs(poles).max()) / self.fastest
        return TradeOffPoint(share, back, law, self, _gain_at_poles(loop) * (1 - ROUNDING_OF_GAIN) / own.norm, speed_up)

    def reduced(self, best: TradeOffPoint) -> TradeOffPoint:
        """Returns the controller without its negligible states if their removal neither changes the norm nor raises `trouble`."""
        with contextlib.suppress(InputError, np.linalg.LinAlgError):
            law = reduced_law(best.own, FASTEST * self.fastest / self.own.rate)
            less = self.judged(best.share, law) if law.states < best.own.states else None
            if less is not None and less.stable >= best.stable and less.within(best.norm * (1 + SAME)):
                return less
        return best

    def law(self, share: float, gamma: float) -> LinearLaw:
        """Returns the central law of the regularised problem, in internal units.

        Raises:
            InfeasibleError: the regularised problem has no law for the given gamma.
        """
        plant, Cy, Dyw = self.own.plant, self.own.plant.Cy, self.own.plant.Dyw
        n, (d, r) = len(plant.A), plant.Dw.shape
        cost, noise = missing(plant.D, share), missing(Dyw.T, share).T
        states = STATES * share * np.eye(n)
        m, q = len(cost), noise.shape[1]
        regular = Plant(
            A=plant.A,
            B=plant.B,
            Bw=np.hstack([plant.Bw, states, np.zeros((n, q))]),
            C=np.vstack([plant.C, states, np.zeros((m, n))]),
            D=np.vstack([plant.D, np.zeros((n, plant.B.shape[1])), cost]),
            Dw=np.block([[plant.Dw, np.zeros((d, n + q))], [np.zeros((n + m, r + n + q))]]),
            Cy=Cy,
            Dyw=np.hstack([Dyw, np.zeros((len(Cy), n)), noise]),
        )
        return central_law(regular, gamma)


def _coarse(gamma: float) -> float:
    """Rounds a number down so that numbers which differ only by rounding errors usually give the same result (see GRAIN).

    Without rounding down, results would depend on units, because bounds in different units have different rounding errors.
    """
    return float(np.exp2(np.floor(np.log2(gamma) / GRAIN) * GRAIN)) if gamma else 0.0


def _gain_at_poles(gain: Gain) -> float:
    """Returns the largest gain at infinity, at the ends of the interval and near the poles.

    The returned gain is a lower bound on the norm and close to the norm.
    """
    upper = gain.poles[np.imag(gain.poles) >= 0]
    omega = gain.within(np.concatenate([gain.edges, np.abs(upper), np.imag(upper)]))
    gains = largest_singular_values(gain.system.frequency_response(omega))
    return max(float(gains.max()), gain.at_infinity if gain.high == np.inf else 0.0)
