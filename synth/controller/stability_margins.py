"""The margins of a loop, predicted from where it is cut.

Cut as in `loop_transfer.py`, the loop L(s) = G (s I - A)^-1 B + H is on the verge of stability where an eigenvalue of L(j w)
is 1. No margin is read off a frequency grid. With M = B G, and H = 0:

- a gain factor k puts a pole of A + k M on the imaginary axis only if two poles of it add to zero, so only if
  (A + k M) (+) (A + k M) is singular, with X (+) Y = kron(X, I) + kron(I, Y): a linear eigenvalue problem in k;
- a phase lag z = exp(-j theta) does so only if (A + z M) (+) (A + conj(z) M) is singular, and conj(z) = 1 / z: a quadratic
  eigenvalue problem in z, whose solutions on the unit circle are all crossovers (Chen, Gu, Nett 1995). The delay theta / w makes
  that lag, and of all crossovers the one with the smallest delay is the delay margin;
- a phase lead is the rest of a whole turn: of all crossovers the one with the largest lag has the smallest lead;
- a sample period T puts an eigenvalue of exp(A T) + (integral of exp(A s) ds B) G on the unit circle.

With H these problems involve more than one matrix, and candidates come from a fine grid. All candidates are then refined on the
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
from synth.controller.loop_transfer import LoopTransfer

LARGEST_FACTOR = 1e4  # a loop that bears this much gain bears any: beyond, rounding decides on which side a pole is
FACTORS = np.geomspace(1.001 / LARGEST_FACTOR, LARGEST_FACTOR / 1.001, 4000)
SAME = 1e-6  # relative; two factors as close are one: a double eigenvalue is known to half the digits
ANGLES, FEWER_ANGLES = 4001, 501  # from no lag to a whole turn; odd, so that half a turn is among them
MOST_QUADRATIC = 18  # states; the quadratic problem of more has a matrix of above 500 rows, and a grid is quicker
FINER = 0.05  # radian that a pole turns by from one sample period that is tried to the next
TOGETHER = 128  # sample periods of one batch
SQUARED = 4  # times that a transition is, to see it contract
CONTRACTS = 0.4  # norm of a power that does: no eigenvalue comes near the unit circle within a step
SHALLOW = 0.2  # of the parabola's rise over a step: a minimum that lies higher is none of an instability
SMALL = 1e-3  # of a step: to so much a minimum is looked for
WIDEST = 1.0  # s; the largest step from one sample period to the next, where nothing turns any more
LONGEST = 100.0  # s; the longest sample period that is looked at where the vehicle does not settle without the loop


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


def margins(loop: LoopTransfer) -> Margins:
    """All margins of a loop that is stable when closed."""
    factors = gain_crossings(loop)
    return Margins(
        gain=min((factor for factor in factors if factor > 1), default=math.inf),
        gain_lower=max((factor for factor in factors if factor < 1), default=0.0),
        crossovers=crossovers(loop),
        sample_period=largest_sample_period(loop),
        disk=disk_margin(loop),
        all_sampled=loop.sampling is not None and loop.sampling.whole and len(loop.H) < len(loop.sampling.controller.law.D),
    )


def sampled_margins(Phi: Array, Gamma: Array, G: Array, period: float) -> Margins:
    """Returns the margins of a sampled loop that is stable when closed, without a sample period.

    The bilinear map z = (1 + s) / (1 - s) takes the unit circle to the imaginary axis, and the loop to one in continuous time
    with the same crossovers and the same disk margin, at other frequencies.

    Args:
        Phi, Gamma, G: loop from sample to sample, see `LoopModel.cut`.
        period: sample period [s].
    """
    inverse = np.linalg.inv(np.eye(len(Phi)) + Phi)
    mapped = LoopTransfer(inverse @ (Phi - np.eye(len(Phi))), inverse @ Gamma, 2 * G @ inverse, -G @ inverse @ Gamma)
    factors, disk = sampled_gain_crossings(Phi, Gamma, G), disk_margin(mapped)

    def frequency(mapped: float) -> float:
        return 2 * math.atan(mapped) / period

    return Margins(
        gain=min((factor for factor in factors if factor > 1), default=math.inf),
        gain_lower=max((factor for factor in factors if factor < 1), default=0.0),
        crossovers=_by_delay(
            [Crossover(frequency(one.frequency), one.phase) for one in _crossings_on_a_grid(mapped) if one is not None]
        ),
        sample_period=math.inf,
        disk=replace(disk, frequency=frequency(disk.frequency)),
    )


def gain_crossings(loop: LoopTransfer) -> list[float]:
    """Factors on the gain, between 0 and `LARGEST_FACTOR`, at which the loop changes between stable and unstable.

    Beyond the factor that makes the spectral radius of H one no loop that is built is stable, as the least delay shows. Where
    that is below 1 the loop is one on paper only, and factors are of that.
    """
    if np.any(loop.H):
        # A force that is in its own measurement, k H of it, grows by that at every turn once this takes any time at all.
        turned = 1 / max(loop.comes_back, 1 / LARGEST_FACTOR) if loop.comes_back < 1 else math.inf
        changes = _sign_changes(lambda k: float(np.linalg.eigvals(loop.closed(k)).real.max()), FACTORS)
        return [*(k for k in changes if k < turned), *([turned] if turned < LARGEST_FACTOR else [])]
    # From the closed loop, which is stable: with k = 1 + d, S + d T is singular where -1 / d is an eigenvalue of S^-1 T.
    S, T = (_kronecker_sum(X, X) for X in (loop.A + loop.M, loop.M))
    inverses = np.linalg.eigvals(np.linalg.solve(S, T))
    inverses = inverses[np.abs(inverses) > 1 / LARGEST_FACTOR]
    tried = 1 - 1 / inverses[np.abs(inverses.imag) < 1e-5 * np.abs(inverses)].real
    return _sign_changes(lambda k: float(np.linalg.eigvals(loop.A + k * loop.M).real.max()), tried)


def sampled_gain_crossings(Phi: Array, Gamma: Array, G: Array) -> list[float]:
    """The same for the loop that is sampled, and holds the force between; arguments as `LoopModel.cut` returns them."""
    M, n = Gamma @ G, len(Phi)
    if n > MOST_QUADRATIC:
        return _sign_changes(lambda k: float(np.abs(np.linalg.eigvals(Phi + k * M)).max() - 1), FACTORS)
    # kron(Phi + k M, Phi + k M) has the eigenvalue 1: with k = 1 + d, a quadratic problem in d.
    closed = Phi + M
    constant = np.kron(closed, closed) - np.eye(n * n)
    linear, square = np.kron(closed, M) + np.kron(M, closed), np.kron(M, M)
    first, second = np.linalg.solve(constant, linear), np.linalg.solve(constant, square)
    inverses = np.linalg.eigvals(np.block([[-first, -second], [np.eye(n * n), np.zeros((n * n, n * n))]]))
    inverses = inverses[np.abs(inverses) > 1 / LARGEST_FACTOR]
    tried = 1 + 1 / inverses[np.abs(inverses.imag) < 1e-5 * np.abs(inverses)].real
    return _sign_changes(lambda k: float(np.abs(np.linalg.eigvals(Phi + k * M)).max() - 1), tried)


def crossovers(loop: LoopTransfer) -> tuple[Crossover, ...]:
    """Every crossover at a frequency above zero, by the delay that it allows."""
    # The pencil has squares of the loop's numbers in it, so that states in unlike units, as a lagged force in N beside metres,
    # would hide solutions. A crossover is cheap to verify and a missing one is not, so a grid is searched, too.
    quadratic = not np.any(loop.H) and len(loop.A) <= MOST_QUADRATIC
    candidates = _of_the_pencil(loop.balanced()) if quadratic else []
    beyond = [Crossover(math.inf, 0.0)] if loop.comes_back >= 1 else []
    return _by_delay([*beyond, *candidates, *_crossings_on_a_grid(loop, FEWER_ANGLES if quadratic else ANGLES)])


def _of_the_pencil(loop: LoopTransfer) -> list[Crossover | None]:
    """Crossovers by the quadratic eigenvalue problem, see the top."""
    A, M, identity = loop.A, loop.M, np.eye(len(loop.A))
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
            candidates.append(_refined(loop, float(-np.angle(z)), complex(pole)))
    return candidates


def _by_delay(candidates: Sequence[Crossover | None]) -> tuple[Crossover, ...]:
    """Returns the distinct crossovers by increasing delay."""
    different: list[Crossover] = []
    for one in candidates:
        if one and not any(math.isclose(one.delay, other.delay, rel_tol=1e-7) for other in different):
            different.append(one)
    return tuple(sorted(different, key=lambda crossover: crossover.delay))


def _crossings_on_a_grid(loop: LoopTransfer, count: int = ANGLES) -> list[Crossover | None]:
    """Crossovers where, between two lags of a fine grid, another number of poles is unstable."""
    angles = np.linspace(0, 2 * np.pi, count)
    # A lag and what it lacks of a whole turn have poles that are each other's conjugates.
    half = np.linalg.eigvals(loop.closed(np.exp(-1j * angles[: count // 2 + 1])))
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
        crossings += [_refined(loop, float(angles[i]), complex(pole)) for pole in before[crossing] if pole.imag > 0]
    return crossings


def _refined(loop: LoopTransfer, theta: float, pole: complex) -> Crossover | None:
    """Returns the crossover next to a lag and a pole, to rounding, or None if the pole only comes near the axis."""

    def nearest(angle: float) -> complex:
        if not abs(angle - theta) < 1:  # a secant that is next to flat leads anywhere
            return complex(math.nan)
        poles = np.linalg.eigvals(loop.closed(np.exp(-1j * angle)))
        return complex(poles[np.argmin(np.abs(poles - pole))])

    root: Any = optimize.root_scalar(
        lambda angle: nearest(angle).real, method="secant", x0=theta, x1=theta + 1e-6, xtol=1e-13, maxiter=30
    )
    angle = float(root.root)
    reached = nearest(angle)
    if not root.converged or abs(reached.real) > 1e-9 * abs(reached) or abs(angle - theta) > 1e-2:
        return None
    return Crossover(reached.imag, angle % (2 * np.pi))


def largest_sample_period(loop: LoopTransfer) -> float:
    """Returns the shortest sample period at which the loop is unstable [s], or infinity.

    The search takes steps that turn no pole by more than a twentieth of a radian, until all motion has decayed. In between, the
    product of 1 - z_i z_j over all pairs of eigenvalues is smooth, and negative where the loop is unstable: its minima show
    instabilities over less than a step. The result is 0 if a force comes back as large through its own measurement.
    """
    if loop.comes_back >= 1:
        return 0.0
    poles = np.linalg.eigvals(loop.A)
    start = 0.0
    while start < LONGEST:
        alive = np.abs(poles[-poles.real * start < 25])  # of the others e^-25 is left
        if len(alive) == 0:
            break
        h = FINER / max(float(alive.max()), FINER / WIDEST)  # an integrator's pole at 0 turns nothing
        begun = max(start - 2 * h, 0.0)  # for minima between two batches
        count = min(TOGETHER, math.ceil((LONGEST - begun) / h))
        products = _products(loop.from_sample_to_sample(begun, h, count))
        for i in range(count):
            first = begun + h * (1 + i)
            if products[i] > 0:
                low = 0 < i < count - 1 and np.inf > products[i - 1] > products[i] <= products[i + 1] < np.inf
                first = _dip(loop, first, h, products[i - 1 : i + 2]) if low else None
            if first is not None and loop.sampled_growth(first) > 0:  # not by rounding alone
                before = max(first - h, 1e-3 * h)  # at zero itself every period is on the verge
                if loop.sampled_growth(before) >= 0:  # a loop far faster than the plant: its rounding, or unstable before
                    return before
                refined: Any = optimize.brentq(loop.sampled_growth, before, first, xtol=1e-13)
                return float(refined)
        start = begun + count * h
    return math.inf


def _dip(loop: LoopTransfer, period: float, h: float, products: Array) -> float | None:
    """Returns the period next to one [s] at which the product is least, or None if the parabola through three is far above 0."""
    bend = products[0] - 2 * products[1] + products[2]
    lowest = products[1] - (products[2] - products[0]) ** 2 / (8 * bend)
    if not lowest < SHALLOW * bend:
        return None

    def product(at: float) -> float:
        return max(float(_products(loop.from_sample_to_sample(0.0, at, 1))[0]), -bend)

    minimum: Any = optimize.minimize_scalar(
        product, bounds=(period - h, period + h), method="bounded", options={"xatol": SMALL * h}
    )
    return float(minimum.x)


def _products(transitions: Array) -> Array:
    """Returns the product of 1 - z_i z_j over all pairs i <= j of eigenvalues; infinite if the transition contracts soon.

    It is minus infinity if an eigenvalue lies outside the unit circle, and NaN if entries are not finite.
    """
    # A power that is smaller than 1 in norm has no such eigenvalue, and costs less than these.
    left, power = np.arange(len(transitions)), transitions
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(SQUARED):
            open_ = ~(np.linalg.norm(power, axis=(1, 2)) < CONTRACTS)
            left, power = left[open_], power[open_]
            power = power @ power
    products = np.full(len(transitions), np.inf)
    whole = np.isfinite(transitions[left]).all(axis=(1, 2))
    products[left[~whole]] = np.nan
    z = np.linalg.eigvals(transitions[left[whole]])
    i, j = np.triu_indices(z.shape[-1])
    outside = np.abs(z).max(axis=1, initial=0.0) > 1
    products[left[whole]] = np.where(outside, -np.inf, (1 - z[:, i] * z[:, j]).prod(axis=1).real)
    return products


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
