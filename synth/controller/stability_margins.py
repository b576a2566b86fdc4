"""The margins of a loop, predicted from where it is cut.

Cut at some forces (`Loop.cut`), the loop L(s) = C (s I - A)^-1 B + D is on the verge of stability where an eigenvalue of L(j w)
is 1. No margin is read off a frequency grid. With M = B C, and D = 0:

- a gain factor k puts a pole of A + k M on the imaginary axis only if two poles of it add to zero, so only if
  (A + k M) (+) (A + k M) is singular, with X (+) Y = kron(X, I) + kron(I, Y): a linear eigenvalue problem in k;
- a phase lag z = exp(-j theta) does so only if (A + z M) (+) (A + conj(z) M) is singular, and conj(z) = 1 / z: a quadratic
  eigenvalue problem in z, whose solutions on the unit circle are all crossovers (Chen, Gu, Nett 1995). The delay theta / w makes
  that lag, and of all crossovers the one with the smallest delay is the delay margin;
- a phase lead is the rest of a whole turn: of all crossovers the one with the largest lag has the smallest lead;
- a sample period T puts an eigenvalue of exp(A T) + (integral of exp(A s) ds B) C on the unit circle, see
  `sample_period_margin.py`.

With D these problems involve more than one matrix, and candidates come from a fine grid. All candidates are then refined on the
poles themselves.
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

LARGEST_FACTOR = 1e4  # a loop that bears this much gain bears any: beyond, rounding decides on which side a pole is
FACTORS = np.geomspace(1.001 / LARGEST_FACTOR, LARGEST_FACTOR / 1.001, 4000)
SAME = 1e-6  # relative; two factors as close are one: a double eigenvalue is known to half the digits
ANGLES, FEWER_ANGLES = 4001, 501  # from no lag to a whole turn; odd, so that half a turn is among them
MOST_QUADRATIC = 18  # states; the quadratic problem of more has a matrix of above 500 rows, and a grid is quicker


@dataclass(frozen=True)
class Crossover:
    """Frequency at which an eigenvalue of L(j w) has magnitude one.

    Attributes:
        frequency: w [rad/s]; infinite for a force that is in its own measurement and grows with any delay.
        phase: lag that makes the eigenvalue 1, between 0 and 2 pi [rad].
    """

    frequency: float
    phase: float

    @property
    def delay(self) -> float:
        """The delay that makes this lag [s]."""
        return self.phase / self.frequency

    @property
    def lead(self) -> float:
        """The lead that makes the eigenvalue 1, too: the rest of a whole turn [rad]."""
        return 2 * math.pi - self.phase


@dataclass(frozen=True)
class Margins:
    """Predicted margins of a loop; infinite if any amount is stable.

    Attributes:
        gain: smallest factor above 1 at which the loop is unstable.
        gain_lower: largest factor below 1 at which the loop is unstable; 0 if there is no such factor.
        crossovers: all crossovers, by increasing delay; the first is the margin.
        sample_period: shortest period at which the loop is unstable [s].
        disk: disk margin: the complex factors that the loop tolerates.
        all_sampled: True if that is with all forces sampled, and not only those at which the loop is cut.
    """

    gain: float
    gain_lower: float
    crossovers: tuple[Crossover, ...]
    sample_period: float
    disk: DiskMargin
    all_sampled: bool = False

    @property
    def delay(self) -> float:
        """The shortest delay at which it is unstable [s]."""
        return self.crossovers[0].delay if self.crossovers else math.inf

    @property
    def phase(self) -> float:
        """The lag that this delay makes at its crossover [rad]."""
        return self.crossovers[0].phase if self.crossovers else math.inf

    @property
    def frequency(self) -> float:
        """Returns the first crossover's frequency [rad/s], or NaN without a crossover."""
        return self.crossovers[0].frequency if self.crossovers else math.nan

    @property
    def smallest_phase(self) -> float:
        """The smallest lag of all crossovers [rad]: less than `phase` where a slower one needs less lag, but more delay."""
        return min((crossover.phase for crossover in self.crossovers), default=math.inf)

    @property
    def leading(self) -> Crossover | None:
        """The crossover with the smallest lead, or None without a crossover."""
        return min((one for one in self.crossovers if math.isfinite(one.frequency)), key=lambda one: one.lead, default=None)

    @property
    def lead(self) -> float:
        """The smallest lead of all crossovers [rad]; infinite without one."""
        return self.leading.lead if self.leading else math.inf

    @property
    def lead_frequency(self) -> float:
        """Returns the frequency of that crossover [rad/s], or NaN without one."""
        return self.leading.frequency if self.leading else math.nan


def margins(loop: Loop, forces: Sequence[str] | None = None) -> Margins:
    """Returns all margins of a loop that is stable when closed, cut at some forces, by default at all.

    A loop that is sampled has no sample period among them. The bilinear map z = (1 + s) / (1 - s) takes the unit circle to the
    imaginary axis, and the loop to one in continuous time with the same crossovers and disk margin, at other frequencies.
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
    """Returns the image of a system from sample to sample under z = (1 + s) / (1 - s), which has no direct path."""
    inverse = np.linalg.inv(np.eye(len(cut.A)) + cut.A)
    A, B, C = inverse @ (cut.A - np.eye(len(cut.A))), inverse @ cut.B, 2 * cut.C @ inverse
    return replace(cut, A=A, B=B, C=C, D=-cut.C @ B, dt=None)


def gain_crossings(cut: StateSpace) -> list[float]:
    """Factors on the gain, between 0 and `LARGEST_FACTOR`, at which the loop changes between stable and unstable.

    Beyond the factor that makes the spectral radius of the direct path one, no loop that is built is stable, as the least delay
    shows. Where that is below 1 the loop is one on paper only, and factors are of that.
    """
    n = len(cut.A)
    if cut.dt is not None:

        def growth(k: float) -> float:
            return float(np.abs(np.linalg.eigvals(cut.loop_matrix(k))).max() - 1)
    else:

        def growth(k: float) -> float:
            return float(np.linalg.eigvals(cut.loop_matrix(k)).real.max())

    if np.any(cut.D):
        # A force that is in its own measurement, k D of it, grows by that at every turn once this takes any time at all.
        radius = cut.feedthrough_radius
        turned = 1 / max(radius, 1 / LARGEST_FACTOR) if radius < 1 else math.inf
        changes = _sign_changes(growth, FACTORS)
        return [*(k for k in changes if k < turned), *([turned] if turned < LARGEST_FACTOR else [])]
    if cut.dt is not None and n > MOST_QUADRATIC:
        return _sign_changes(growth, FACTORS)
    closed, M = cut.loop_matrix(1.0), cut.B @ cut.C
    if cut.dt is None:
        # From the closed loop, which is stable: with k = 1 + d, S + d T is singular where -1 / d is an eigenvalue of S^-1 T.
        S, T = (_kronecker_sum(X, X) for X in (closed, M))
        inverses = -np.linalg.eigvals(np.linalg.solve(S, T))
    else:
        # kron(A + k M, A + k M) has the eigenvalue 1: with k = 1 + d, a quadratic problem in d.
        constant = np.kron(closed, closed) - np.eye(n * n)
        linear, square = np.kron(closed, M) + np.kron(M, closed), np.kron(M, M)
        first, second = np.linalg.solve(constant, linear), np.linalg.solve(constant, square)
        inverses = np.linalg.eigvals(np.block([[-first, -second], [np.eye(n * n), np.zeros((n * n, n * n))]]))
    inverses = inverses[np.abs(inverses) > 1 / LARGEST_FACTOR]
    return _sign_changes(growth, 1 + 1 / inverses[np.abs(inverses.imag) < 1e-5 * np.abs(inverses)].real)


def crossovers(cut: StateSpace) -> tuple[Crossover, ...]:
    """Every crossover at a frequency above zero, by the delay that it allows."""
    # The pencil has squares of the loop's numbers in it, so that states in unlike units, as a lagged force in N beside metres,
    # would hide solutions. A crossover is cheap to verify and a missing one is not, so a grid is searched, too.
    quadratic = not np.any(cut.D) and len(cut.A) <= MOST_QUADRATIC
    candidates = _of_the_pencil(_balance_loop(cut)) if quadratic else []
    beyond = [Crossover(math.inf, 0.0)] if cut.feedthrough_radius >= 1 else []
    return _by_delay([*beyond, *candidates, *_crossings_on_a_grid(cut, FEWER_ANGLES if quadratic else ANGLES)])


def _balance_loop(cut: StateSpace) -> StateSpace:
    """Returns a cut loop with its states in units that make its numbers of a like size, powers of two."""
    _, (scale, _) = linalg.matrix_balance(np.abs(cut.A) + np.abs(cut.B @ cut.C), permute=False, separate=True)
    return replace(cut, A=cut.A * scale / scale[:, None], B=cut.B / scale[:, None], C=cut.C * scale)


def _of_the_pencil(cut: StateSpace) -> list[Crossover | None]:
    """Crossovers by the quadratic eigenvalue problem, see the top."""
    A, M, identity = cut.A, cut.B @ cut.C, np.eye(len(cut.A))
    # z^2 kron(M, I) + z (A (+) A) + kron(I, M) is singular.
    S, size = _kronecker_sum(A, A), len(A) ** 2
    eye, zero = np.eye(size), np.zeros((size, size))
    pencil = np.block([[zero, eye], [-np.kron(identity, M), -S]]), np.block([[eye, zero], [zero, np.kron(M, identity)]])
    with np.errstate(divide="ignore", invalid="ignore"):  # infinite eigenvalues: M has no full rank
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
    """Returns the distinct crossovers by increasing delay."""
    different: list[Crossover] = []
    for one in candidates:
        if one and not any(math.isclose(one.delay, other.delay, rel_tol=1e-7) for other in different):
            different.append(one)
    return tuple(sorted(different, key=lambda crossover: crossover.delay))


def _crossings_on_a_grid(cut: StateSpace, count: int = ANGLES) -> list[Crossover | None]:
    """Crossovers where, between two lags of a fine grid, another number of poles is unstable."""
    angles = np.linspace(0, 2 * np.pi, count)
    # A lag and what it lacks of a whole turn have poles that are each other's conjugates.
    half = np.linalg.eigvals(cut.loop_matrix(np.exp(-1j * angles[: count // 2 + 1])))
    poles = np.concatenate([half, half[-2::-1].conj()])
    unstable = np.sum(np.real(poles) > 0, axis=1)
    crossings = []
    for i in np.flatnonzero(np.diff(unstable)):
        before, after = poles[i], poles[i + 1]
        pairs = optimize.linear_sum_assignment(np.abs(before[:, None] - after))
        crossing = np.zeros(len(before), dtype=bool)
        crossing[pairs[0]] = (before[pairs[0]].real > 0) != (after[pairs[1]].real > 0)
        # Two poles that meet on their way may be taken for each other: they are then next to the axis.
        crossing[np.argsort(np.abs(before.real))[: 1 + abs(int(unstable[i + 1] - unstable[i]))]] = True
        crossings += [_refine_crossover(cut, float(angles[i]), complex(pole)) for pole in before[crossing] if pole.imag > 0]
    return crossings


def _refine_crossover(cut: StateSpace, theta: float, pole: complex) -> Crossover | None:
    """Returns the crossover next to a lag and a pole, to rounding, or None if the pole only comes near the axis."""

    def nearest(angle: float) -> complex:
        if not abs(angle - theta) < 1:  # a secant that is next to flat leads anywhere
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
    """X (+) Y: its eigenvalues are all sums of one of X and one of Y."""
    identity = np.eye(len(X))
    return np.kron(X, identity) + np.kron(identity, Y)


def _sign_changes(growth: Callable[[float], float], tried: Array) -> list[float]:
    """The positive ones of the candidates at which a growth really changes its sign, refined to 1e-13."""
    changes = []
    candidates = np.unique(tried[(tried > 1 / LARGEST_FACTOR) & (tried < LARGEST_FACTOR)])
    # A pair of poles gives one twice, which rounding may tell apart: midway between those the growth is none, and has no sign.
    candidates = candidates[np.diff(candidates, append=np.inf) > SAME * candidates]
    # Between two neighbours nothing changes, so midway between them the sign is safe from rounding.
    middles = [float(np.sqrt(a * b)) for a, b in itertools.pairwise(candidates)]
    edges = [candidates[0] * 0.9, *middles, candidates[-1] * 1.1] if len(candidates) else []
    for low, high in itertools.pairwise(edges):
        if growth(low) * growth(high) < 0:
            refined: Any = optimize.brentq(growth, low, high, xtol=1e-13)
            changes.append(float(refined))
    return changes
