"""Stability margins of a loop, computed from the loop cut at some of its forces.

The cut loop (`Loop.cut`) is L(s) = C (s I - A)^-1 B + D. The closed loop reaches the limit of stability if an eigenvalue of L(j
w) is 1 at some frequency w. The margins are not read from a frequency grid. Let M = B C, and D = 0. With the Kronecker sum X
(+) Y = kron(X, I) + kron(I, Y), the margins are computed as follows:

- Gain: a gain factor k moves a pole of A + k M to the imaginary axis only if the sum of two poles is zero. The sum of two poles
  is zero only if (A + k M) (+) (A + k M) is singular, which is a linear eigenvalue problem in k.
- Phase lag: a phase lag theta, with the factor z = exp(-j theta), moves a pole to the axis only if
  (A + z M) (+) (A + conj(z) M) is singular. Since conj(z) = 1 / z, the condition is a quadratic eigenvalue problem in z. The
  solutions z on the unit circle give all crossovers (Chen, Gu, Nett 1995).
- Delay: a delay of theta / w causes the phase lag theta at the frequency w. The delay margin is the smallest of the delays at
  all crossovers.
- Phase lead: a phase lead is 2 pi minus the phase lag. The crossover with the largest lag therefore has the smallest lead.
- Sample period: a period T is a limit if exp(A T) + (integral of exp(A s) ds B) C has an eigenvalue on the unit circle; see
  `sample_period_margin.py`.

If D is not zero, the eigenvalue problems contain additional matrices, and the candidates for phase lags are found on a fine
grid. All candidates are then refined by means of the poles of the closed loop.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import linalg, optimize

from models.common.arrays import Array
from synth.controller.disk_margin import DiskMargin, disk_margin
from synth.controller.sample_period_margin import all_sampled, largest_sample_period
from synth.plant.loop import Loop
from synth.plant.state_space import StateSpace

# a loop that is stable with this gain factor counts as having no upper gain limit, because rounding affects larger factors
LARGEST_FACTOR = 1e4
FACTORS = np.geomspace(1.001 / LARGEST_FACTOR, LARGEST_FACTOR / 1.001, 4000)
# two factors count as equal if their relative difference is smaller than this; only half of the digits of a double eigenvalue
# are correct
SAME = 1e-6
ANGLES, FEWER_ANGLES = 4001, 501  # numbers of angles from 0 to 2 pi; the numbers are odd, so that pi is one of the angles
# Largest number of states for which the quadratic eigenvalue problem is solved. With more states, the matrix of this problem
# has over 500 rows, and searching a grid is faster
MOST_QUADRATIC = 18


@dataclass(frozen=True)
class Crossover:
    """Frequency w at which an eigenvalue of L(j w) has the magnitude 1.

    Attributes:
        frequency: frequency w [rad/s]; infinite if, with any delay, a force grows through its own measurement.
        phase: phase lag that makes an eigenvalue of L(j w) equal to 1, between 0 and 2 pi [rad].
    """

    frequency: float
    phase: float

    @property
    def delay(self) -> float:
        """Delay that causes the phase lag at the frequency of the crossover [s]."""
        return self.phase / self.frequency

    @property
    def lead(self) -> float:
        """Phase lead that makes an eigenvalue of L(j w) equal to 1 [rad]: 2 pi minus the phase lag."""
        return 2 * math.pi - self.phase


@dataclass(frozen=True)
class Margins:
    """Predicted stability margins of a loop; an unlimited margin is infinite.

    Attributes:
        gain: smallest factor above 1 on the cut forces at which the loop is unstable.
        gain_lower: largest factor below 1 on the cut forces at which the loop is unstable; 0 if no such factor exists.
        crossovers: all crossovers, ordered by increasing delay. The first crossover gives the delay margin.
        sample_period: shortest sample period at which the loop is unstable [s].
        disk: disk margin, for complex factors on the forces.
        all_sampled: True if `sample_period` applies to sampling of all forces, and not only of the forces at which the loop is
            cut.
    """

    gain: float
    gain_lower: float
    crossovers: tuple[Crossover, ...]
    sample_period: float
    disk: DiskMargin
    all_sampled: bool = False

    @property
    def delay(self) -> float:
        """Shortest delay at which the loop is unstable [s]; infinite if there is no crossover."""
        return self.crossovers[0].delay if self.crossovers else math.inf

    @property
    def phase(self) -> float:
        """Phase lag at the crossover with the shortest delay [rad]; infinite if there is no crossover."""
        return self.crossovers[0].phase if self.crossovers else math.inf

    @property
    def frequency(self) -> float:
        """Frequency of the crossover with the shortest delay [rad/s]; NaN if there is no crossover."""
        return self.crossovers[0].frequency if self.crossovers else math.nan

    @property
    def smallest_phase(self) -> float:
        """Smallest phase lag among all crossovers [rad].

        The smallest phase lag is below `phase` if a crossover at a lower frequency has a smaller lag but a longer delay.
        """
        return min((crossover.phase for crossover in self.crossovers), default=math.inf)

    @property
    def leading(self) -> Crossover | None:
        """Crossover with the smallest phase lead; None if there is no crossover."""
        return min((one for one in self.crossovers if math.isfinite(one.frequency)), key=lambda one: one.lead, default=None)

    @property
    def lead(self) -> float:
        """Smallest phase lead among all crossovers [rad]; infinite if there is no crossover."""
        return self.leading.lead if self.leading else math.inf

    @property
    def lead_frequency(self) -> float:
        """Frequency of the crossover with the smallest lead [rad/s]; NaN if there is no crossover."""
        return self.leading.frequency if self.leading else math.nan


def margins(loop: Loop, forces: Sequence[str] | None = None) -> Margins:
    """Returns all stability margins of a stable closed loop that is cut at some forces.

    For a sampled-data loop, the sample-period margin is not computed. The bilinear transform z = (1 + s) / (1 - s) turns the
    loop into a continuous loop, with the same phase lags at crossovers and the same disk margin, but at other frequencies.

    Args:
        loop: closed loop, continuous or sampled.
        forces: names of the forces at which the loop is cut. Default: all forces.
    """
    forces = loop.forces if forces is None else tuple(forces)
    cut = loop.cut(forces)
    factors, mapped = gain_crossings(cut), cut if cut.dt is None else bilinear(cut)
    found, disk = crossovers(mapped) if cut.dt is None else _by_delay(_crossings_on_a_grid(mapped)), disk_margin(mapped)
    if cut.dt is not None:
        period = cut.dt
        found = _by_delay([replace(one, frequency=2 * math.atan(one.frequency) / period) for one in found])
        disk = replace(disk, frequency=2 * math.atan(disk.frequency) / period)
    return Margins(
        gain=min((factor for factor in factors if factor > 1), default=math.inf),
        gain_lower=max((factor for factor in factors if factor < 1), default=0.0),
        crossovers=found,
        sample_period=largest_sample_period(loop, forces) if cut.dt is None else math.inf,
        disk=disk,
        all_sampled=cut.dt is None and len(forces) < len(loop.forces) and all_sampled(loop, forces),
    )


def bilinear(cut: StateSpace) -> StateSpace:
    """Returns the continuous system into which z = (1 + s) / (1 - s) transforms a discrete system without feedthrough."""
    inverse = np.linalg.inv(np.eye(len(cut.A)) + cut.A)
    A, B, C = inverse @ (cut.A - np.eye(len(cut.A))), inverse @ cut.B, 2 * cut.C @ inverse
    return replace(cut, A=A, B=B, C=C, D=-cut.C @ B, dt=None)


def gain_crossings(cut: StateSpace, tried: Array | None = None) -> list[float]:
    """Returns the factors on the cut forces, between 0 and `LARGEST_FACTOR`, at which the loop changes between stable and
    unstable.

    If `tried` is given, with shape (K,), only the intervals between these K factors are searched. If the loop has a
    feedthrough, the factor at which its spectral radius reaches 1 is also a limit, because with larger factors any delay causes
    instability. If the limit from the feedthrough is below 1, the loop itself is only theoretical, and factors beyond the limit
    are returned, too.
    """
    n = len(cut.A)
    if cut.dt is not None:

        def growth(k: float) -> float:
            return float(np.abs(np.linalg.eigvals(cut.loop_matrix(k))).max() - 1)
    else:

        def growth(k: float) -> float:
            return float(np.linalg.eigvals(cut.loop_matrix(k)).real.max())

    if np.any(cut.D):
        # If a measurement contains the force itself with the factor k D, the force grows with any delay as soon as k D reaches
        # 1.
        radius = cut.feedthrough_radius
        turned = 1 / max(radius, 1 / LARGEST_FACTOR) if radius < 1 else math.inf
        changes = _sign_changes(growth, FACTORS if tried is None else tried)
        return [*(k for k in changes if k < turned), *([turned] if turned < LARGEST_FACTOR else [])]
    if tried is not None or (cut.dt is not None and n > MOST_QUADRATIC):
        return _sign_changes(growth, FACTORS if tried is None else tried)
    closed, M = cut.loop_matrix(1.0), cut.B @ cut.C
    if cut.dt is None:
        # The computation starts from the stable closed loop. With k = 1 + d, the matrix S + d T is singular if -1 / d is an
        # eigenvalue of S^-1 T.
        S, T = (_kronecker_sum(X, X) for X in (closed, M))
        inverses = -np.linalg.eigvals(np.linalg.solve(S, T))
    else:
        # The matrix kron(A + k M, A + k M) must have the eigenvalue 1. With k = 1 + d, this condition is a quadratic eigenvalue
        # problem in d.
        constant = np.kron(closed, closed) - np.eye(n * n)
        linear, square = np.kron(closed, M) + np.kron(M, closed), np.kron(M, M)
        first, second = np.linalg.solve(constant, linear), np.linalg.solve(constant, square)
        inverses = np.linalg.eigvals(np.block([[-first, -second], [np.eye(n * n), np.zeros((n * n, n * n))]]))
    inverses = inverses[np.abs(inverses) > 1 / LARGEST_FACTOR]
    return _sign_changes(growth, 1 + 1 / inverses[np.abs(inverses.imag) < 1e-5 * np.abs(inverses)].real)


def crossovers(cut: StateSpace) -> tuple[Crossover, ...]:
    """Returns every crossover at a frequency above zero, ordered by delay."""
    # The pencil contains squares of the loop's entries. If the units of states differ (a lagged force in N, a position in m),
    # rounding may hide solutions. A false crossover is easy to detect, but a missing crossover is not. A grid of angles is
    # therefore searched, too.
    quadratic = not np.any(cut.D) and len(cut.A) <= MOST_QUADRATIC
    candidates = _of_the_pencil(_balance_loop(cut)) if quadratic else []
    beyond = [Crossover(math.inf, 0.0)] if cut.feedthrough_radius >= 1 else []
    return _by_delay([*beyond, *candidates, *_crossings_on_a_grid(cut, FEWER_ANGLES if quadratic else ANGLES)])


def _balance_loop(cut: StateSpace) -> StateSpace:
    """Returns a cut loop with other units of the states (powers of two), so that all entries of its matrices are similar in
    size.
    """
    _, (scale, _) = linalg.matrix_balance(np.abs(cut.A) + np.abs(cut.B @ cut.C), permute=False, separate=True)
    return replace(cut, A=cut.A * scale / scale[:, None], B=cut.B / scale[:, None], C=cut.C * scale)


def _of_the_pencil(cut: StateSpace) -> list[Crossover | None]:
    """Returns the crossovers from the quadratic eigenvalue problem that the module's docstring describes."""
    A, M, identity = cut.A, cut.B @ cut.C, np.eye(len(cut.A))
    # The matrix z^2 kron(M, I) + z (A (+) A) + kron(I, M) must be singular.
    S, size = _kronecker_sum(A, A), len(A) ** 2
    eye, zero = np.eye(size), np.zeros((size, size))
    pencil = np.block([[zero, eye], [-np.kron(identity, M), -S]]), np.block([[eye, zero], [zero, np.kron(M, identity)]])
    with np.errstate(divide="ignore", invalid="ignore"):  # some eigenvalues are infinite if M does not have full rank
        solutions = linalg.eigvals(*pencil)
    solutions = solutions[np.isfinite(solutions)]

    candidates: list[Crossover | None] = []
    fastest = float(np.abs(np.linalg.eigvals(A + M)).max())
    for z in solutions[np.abs(np.abs(solutions) - 1) < 1e-4]:
        poles = np.linalg.eigvals(A + z * M)
        for pole in poles[(np.abs(poles.real) < 1e-3 * np.abs(poles)) & (poles.imag > 1e-6 * fastest)]:
            candidates.append(_refine_crossover(cut, float(-np.angle(z)), complex(pole)))
    return candidates


def _by_delay(candidates: Sequence[Crossover | None]) -> tuple[Crossover, ...]:
    """Returns the distinct crossovers, ordered by increasing delay."""
    different: list[Crossover] = []
    for one in candidates:
        if one and not any(math.isclose(one.delay, other.delay, rel_tol=1e-7) for other in different):
            different.append(one)
    return tuple(sorted(different, key=lambda crossover: crossover.delay))


def _crossings_on_a_grid(cut: StateSpace, count: int = ANGLES) -> list[Crossover | None]:
    """Returns crossovers found on a fine grid of phase lags: each lies between two lags that give different numbers of unstable
    poles.
    """
    angles = np.linspace(0, 2 * np.pi, count)
    # The poles for the lag 2 pi - theta are the complex conjugates of the poles for the lag theta.
    half = np.linalg.eigvals(cut.loop_matrix(np.exp(-1j * angles[: count // 2 + 1])))
    poles = np.concatenate([half, half[-2::-1].conj()])
    unstable = np.sum(np.real(poles) > 0, axis=1)
    crossings = []
    for i in np.flatnonzero(np.diff(unstable)):
        before, after = poles[i], poles[i + 1]
        pairs = optimize.linear_sum_assignment(np.abs(before[:, None] - after))
        crossing = np.zeros(len(before), dtype=bool)
        crossing[pairs[0]] = (before[pairs[0]].real > 0) != (after[pairs[1]].real > 0)
        # Poles whose paths cross may be exchanged by mistake. The poles nearest to the axis are therefore candidates, too.
        crossing[np.argsort(np.abs(before.real))[: 1 + abs(int(unstable[i + 1] - unstable[i]))]] = True
        crossings += [_refine_crossover(cut, float(angles[i]), complex(pole)) for pole in before[crossing] if pole.imag > 0]
    return crossings


def _refine_crossover(cut: StateSpace, theta: float, pole: complex) -> Crossover | None:
    """Returns the exact crossover near a phase lag and a pole; None if the pole comes close to the imaginary axis but does not
    reach it.
    """

    def nearest(angle: float) -> complex:
        if not abs(angle - theta) < 1:  # the secant is nearly horizontal and would lead far away
            return complex(math.nan)
        poles = np.linalg.eigvals(cut.loop_matrix(np.exp(-1j * angle)))
        return complex(poles[np.argmin(np.abs(poles - pole))])

    root: Any = optimize.root_scalar(
        lambda angle: nearest(angle).real, method="secant", x0=theta, x1=theta + 1e-6, xtol=1e-13, maxiter=30
    )
    angle = float(root.root)
    reached = nearest(angle)
    if not root.converged or abs(reached.real) > 1e-9 * abs(reached) or abs(angle - theta) > 1e-2:
        return None
    return Crossover(reached.imag, angle % (2 * np.pi))


def _kronecker_sum(X: Array, Y: Array) -> Array:
    """Returns the Kronecker sum of X and Y.

    The eigenvalues of the Kronecker sum are all sums of an eigenvalue of X and an eigenvalue of Y.
    """
    identity = np.eye(len(X))
    return np.kron(X, identity) + np.kron(identity, Y)


def _sign_changes(growth: Callable[[float], float], tried: Array) -> list[float]:
    """Returns the positive candidates at which the growth rate of the loop changes its sign, refined to a relative accuracy of
    1e-13.
    """
    changes = []
    candidates = np.unique(tried[(tried > 1 / LARGEST_FACTOR) & (tried < LARGEST_FACTOR)])
    # A pair of poles gives the same factor twice, with different rounding errors. Between these two values, the growth is zero
    # up to rounding, so its sign is meaningless.
    candidates = candidates[np.diff(candidates, append=np.inf) > SAME * candidates]
    # The growth changes its sign only at candidates. Halfway between two neighbouring candidates, rounding does not affect the
    # sign.
    middles = [float(np.sqrt(a * b)) for a, b in itertools.pairwise(candidates)]
    edges = [candidates[0] * 0.9, *middles, candidates[-1] * 1.1] if len(candidates) else []
    for low, high in itertools.pairwise(edges):
        if growth(low) * growth(high) < 0:
            refined: Any = optimize.brentq(growth, low, high, xtol=1e-13)
            changes.append(float(refined))
    return changes
