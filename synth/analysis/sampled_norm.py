"""L2 gain of a sampled-data loop from w to z, both in continuous time: the exact value and a lower bound.

The first method tests values of the L2 gain, which are called levels. A level exceeds the gain if the discrete plant of this
level (`sampled_loop.py`), with the controller, gives a stable closed loop with an l2 norm below 1. The bilinear transform maps
the closed discrete loop to a continuous loop with the same gains. The eigenvalues of the Hamiltonian matrix of the continuous
loop give the angles on the unit circle at which some gain is 1. The gain is evaluated at these angles and at angles between
them. At the angle of the largest gain, the level is changed until the largest gain is 1. The resulting level is the L2 gain for
a disturbance whose phase advances by the angle of the largest gain per sample.

The second method gives a lower bound and does not use levels. The second method considers disturbances that are polynomials of
low degree over each part of the period. From sample to sample, the phase of the polynomial disturbances advances by a fixed
angle. For these disturbances, matrix exponentials give the states x and the energy of z exactly. The largest gain among the
polynomial disturbances is therefore the largest singular value of one matrix, and an actual disturbance reaches this gain. The
second method is a form of fast lifting (Keller, Anderson 1992), but it uses z itself instead of samples of z. The worst
disturbance is smooth, and small changes of this disturbance do not affect the gain to first order. The error of the lower bound
therefore decreases with the power 2 (degree + 1) of the length of the parts.
"""

import math

import numpy as np
from numpy.polynomial import legendre
from scipy import linalg

from models.common.arrays import Array
from models.common.checks import Positive
from models.common.threads import one_thread
from synth.analysis.norm import largest_singular_values, level_crossings
from synth.analysis.sampled_loop import LiftedPlant, SampledLoop, in_own_units, lift_plant, with_inputs
from synth.analysis.specification import ABOVE, BELOW, SampledNorm
from synth.analysis.stability import balance, sampled_growth
from synth.plant.generalized import Plant

DEGREE = 3  # degree of the polynomials in a part of a hold interval
FEWEST, MOST = 4, 64  # smallest and largest initial number of parts into which each hold interval is divided
LONGEST = 1.0  # largest length of a part of a hold interval, as a multiple of the time constant of the plant's fastest rate
NODES = 12  # number of nodes of a quadrature; for exp(2 t), the least accurate integrand, the error is 1e-30
MOST_COLUMNS = 1200  # largest number of columns of the matrix; a larger matrix would take seconds
SHORT = 1e-7  # a lower bound within this relative distance of the norm is not refined further


def reached_near(loop: SampledLoop, angle: float, norm: float) -> float:
    """Returns `reached_gain` at an angle; the number of parts grows until the gain is near the norm or the number reaches its
    limit.
    """
    fastest = np.abs(np.linalg.eigvals(balance(loop.plant.A)[0])).max(initial=0.0)
    each = len(loop.pieces) * (DEGREE + 1) * loop.plant.Bw.shape[1]
    most = max(FEWEST, MOST_COLUMNS // each)
    parts = int(min(max(FEWEST, np.ceil(loop.period * fastest / LONGEST)), MOST, most))
    largest = 0.0
    while True:
        largest = max(largest, reached_gain(loop, angle, parts))
        if largest >= norm * (1 - SHORT) or 2 * parts > most:
            return largest
        parts *= 2


def reached_gain(loop: SampledLoop, angle: float, parts: int, degree: int = DEGREE) -> float:
    """Returns the largest gain of a piecewise polynomial disturbance, which is a lower bound on the gain of the loop.

    Args:
        loop: stable loop.
        angle: phase advance of the disturbance per sample [rad]; NaN for a disturbance that acts in one period only.
        parts: number of parts into which each hold interval of the period is divided.
        degree: degree of the polynomials in each part.
    """
    plant, alone = loop.plant, math.isnan(angle)
    n = len(plant.A)
    width = n + len(loop.input_selections) * len(loop.K)

    # The current [x; held inputs] is `free` times the values at the sample, plus `forced` times the coefficients of all
    # polynomials so far
    free, forced = np.eye(width), np.zeros((width, 0))
    seen_free, seen_forced = [], []
    for duration, acting in loop.input_selections:
        step, through, energy = _part(*with_inputs(plant, acting), plant.Dw, n, duration / parts, degree)
        for _ in range(parts):
            seen_free.append(energy[:, :width] @ free)
            seen_forced.append(np.hstack([energy[:, :width] @ forced, energy[:, width:]]))
            free, forced = step @ free, np.hstack([step @ forced, through])
    columns = forced.shape[1]
    padded = [np.hstack([rows, np.zeros((len(rows), columns - rows.shape[1]))]) for rows in seen_forced]
    direct = np.vstack(padded)
    if alone:
        return float(np.linalg.norm(direct, 2))
    reached = _reached(*loop.at_angles(free - np.eye(width), np.array([angle])), forced[:n], 1.0)[0]
    whole = np.vstack(seen_free) @ reached + np.pad(direct, ((0, 0), (0, reached.shape[1] - columns)))
    return float(largest_singular_values(whole[None])[0])


def _reached(matrix: Array, start: Array, into: Array, level: float) -> Array:
    """Returns the vectors [x; held inputs] at the samples that disturbances and noise cause, complex, shape (F, n + i, c + j).

    Args:
        matrix, start: matrices of the loop at F angles; see `SampledLoop.at_angles`.
        into: matrix from the disturbances within one period to x at the end of the period, shape (n, c).
        level: level of the L2 gain; the noise is divided by this level.
    """
    (F, known, columns), (n, c) = matrix.shape, into.shape
    driven = np.zeros((F, known, c + columns - known), dtype=complex)
    driven[:, :n, :c], driven[:, :, c:] = into, -matrix[:, :, known:] / level
    reached = start[:, :, :known] @ np.linalg.solve(matrix[:, :, :known], driven)
    reached[:, :, c:] += start[:, :, known:] / level
    return reached


def _part(A: Array, Bw: Array, C: Array, Dw: Array, n: int, h: float, degree: int) -> tuple[Array, Array, Array]:
    """Returns matrices for h seconds: state transition, effect of polynomial disturbances on the state, and a square root of
    the energy matrix of z.

    The energy matrix itself is never computed: if the units of the states differ a lot, rounding would destroy the small
    entries of this matrix. The root consists of the values of z at the nodes of a quadrature formula. An orthogonal
    transformation compresses the root without loss of digits in any column.

    Each polynomial is represented by its coefficients in a basis of Legendre polynomials of energy 1. Only the first n states
    have dynamics; the other states are constant.
    """
    size, r, k = len(A), Bw.shape[1], degree + 1
    A, Bw, C, scale = in_own_units(A, Bw, C, n)
    # w is the first signal of a chain of k integrators. The initial values of the integrators are the derivatives of w, in
    # units of the part's length.
    derivatives = np.zeros((k, k))
    for j in range(k):
        polynomial = legendre.Legendre.basis(j, domain=[0, 1]) * math.sqrt((2 * j + 1) / h)
        derivatives[:, j] = [polynomial.deriv(i)(0.0) if i else polynomial(0.0) for i in range(k)]
    larger = np.zeros((size + k * r, size + k * r))
    larger[:size, :size], larger[:size, size : size + r] = A, Bw
    larger[size:, size:] = np.kron(np.eye(k, k=1), np.eye(r)) / h
    seen = np.hstack([C, Dw, np.zeros((len(C), (k - 1) * r))])
    # Over a short time, z is nearly a polynomial, so the quadrature gives the energy of z exactly. The time is then doubled
    # repeatedly.
    doublings = max(0, math.ceil(math.log2(max(h * float(np.linalg.norm(A, 1)), 1e-300))))
    short = h / 2**doublings
    nodes, weights = legendre.leggauss(NODES)
    there = linalg.expm(short * np.append((1 + nodes) / 2, 1.0)[:, None, None] * larger)
    step = there[-1]
    root = _small(np.vstack(np.sqrt(short * weights / 2)[:, None, None] * (seen @ there[:-1])))
    for _ in range(doublings):
        step, root = step @ step, _small(np.vstack([root, root @ step]))
    into = np.asarray(linalg.block_diag(np.diag(1 / scale), np.kron(derivatives, np.eye(r))))
    moved = scale[:, None] * step[:size] @ into
    return moved[:, :size], moved[:, size:], root @ into


def _small(root: Array) -> Array:
    """Returns a matrix R that has no more rows than columns and satisfies R' R = root' root."""
    return np.asarray(np.linalg.qr(root, mode="r"))


CLOSE = 1e-11  # a gain counts as 1 if its relative distance from 1 is smaller than this
ROUNDS = 100  # largest number of iterations of a search; most searches need fewer than ten
ZOOMS = 4  # number of sevenfold refinements of the interval around a peak, before the level crossings are computed
NOTHING = 1e-15  # a gain below this multiple of the first level counts as zero
AT_ONCE = 4096  # number of frequencies that are computed together; a larger number would need hundreds of megabytes


@one_thread()
def sampled_norm(loop: SampledLoop, near: Positive = 1.0) -> SampledNorm:
    """Returns the L2 gain of a sampled-data loop from w to z, with a relative error of at most 1e-8.

    If the loop contains measurement noise, this noise counts as an additional disturbance.

    Args:
        loop: sampled-data loop, stable or not.
        near: positive estimate of the gain, from which the search starts.

    Returns:
        The L2 gain, a level just below it, a level just above it, and the gain of an actual disturbance, as a `SampledNorm`.
        All returned values are infinite if the loop is not stable.

    Example:
        >>> from synth import GeneralizedPlant, SampledLoop, sampled_norm
        >>> oscillator = GeneralizedPlant(
        ...     A=[[0, 1], [-4, -0.1]], B=[[0], [1]], Bw=[[0], [1]], C=[[1, 0], [0, 0]], D=[[0], [0.1]], Dw=[[0], [0]]
        ... )
        >>> loop = SampledLoop.of_gain(oscillator, K=[[-2.0]], Cy=[[0, 1]], sample_period=0.01)
        >>> f"{sampled_norm(loop).value:.4f}"
        '0.2894'
    """
    poles = _poles(loop)
    return SampledNorm(np.inf, np.inf, np.inf, np.nan, np.inf) if poles is None else _Search(loop, poles).run(near)


def stable(loop: SampledLoop) -> bool:
    """Returns True if the sampled-data loop is stable."""
    return _poles(loop) is not None


def _poles(loop: SampledLoop) -> Array | None:
    """Returns the poles of the transition matrix from one sample to the next; None if the loop is not stable."""
    change, _ = loop.closed(loop.increment)
    transition = np.eye(len(change)) + change[:, : len(change)]
    return np.linalg.eigvals(transition) if sampled_growth(transition) < 1 else None


class _Level:
    """Closed loop of the controller and the discrete plant that belongs to a level of the L2 gain."""

    def __init__(self, loop: SampledLoop, plant: LiftedPlant, level: float) -> None:
        self.loop, self.plant, self.level = loop, plant, level
        self.Bd, self.Cd = plant.Bd[: len(loop.plant.A)], plant.Cd

    def gains(self, angles: Array) -> Array:
        """Returns the largest singular value from w_d to z_d at each of F angles on the unit circle [rad], shape (F,)."""
        if len(angles) > AT_ONCE:
            return np.concatenate([self.gains(some) for some in np.array_split(angles, len(angles) // AT_ONCE + 1)])
        reached = _reached(*self.loop.at_angles(self.plant.increment, angles), self.Bd, self.level)
        return largest_singular_values(self.Cd @ reached)

    def crossings(self) -> Array:
        """Returns angles [rad] in ascending order from 0, including all angles at which a singular value is 1."""
        change, start = self.loop.closed(self.plant.increment)
        T, N = self.loop.period, len(change)
        own, of_noise = change[:, :N], change[:, N:] / self.level
        inverse = np.linalg.inv(2 * np.eye(N) + own)
        A, scale = balance(2 / T * own @ inverse)
        B, C = np.hstack([inverse[:, : len(self.Bd)] @ self.Bd, inverse @ of_noise]), self.Cd @ start[:, :N]
        direct = np.hstack([np.zeros((len(C), self.Bd.shape[1])), self.Cd @ start[:, N:] / self.level])
        into, out = 2 / math.sqrt(T) * B / scale[:, None], 2 / math.sqrt(T) * C @ inverse * scale
        return 2 * np.arctan(T / 2 * level_crossings(Plant.without_inputs(A, into, out, direct - C @ B), 1.0))

    def climbed(self, angles: Array, widths: Array) -> tuple[float, float]:
        """Returns the highest gain near the given angles, within the distances `widths`, and the angle of this gain [rad]."""
        steps = np.linspace(-1, 1, 15)[:, None]
        for _ in range(ZOOMS):
            near = np.clip(angles + widths * steps, 0.0, np.pi)
            gains = self.gains(near.ravel()).reshape(near.shape)
            angles, widths = near[gains.argmax(axis=0), np.arange(len(angles))], widths / 7
        gains = self.gains(angles)
        return float(gains.max()), float(angles[gains.argmax()])


class _Search:
    """Search for the level of the L2 gain at which the largest gain of the discrete loop is 1."""

    def __init__(self, loop: SampledLoop, poles: Array) -> None:
        """Prepares the search for the L2 gain of a stable loop.

        Args:
            loop: stable sampled-data loop.
            poles: poles of the transition matrix from one sample to the next, complex.
        """
        self.loop = loop
        self.poles = np.log(poles[poles != 0].astype(complex))  # poles of the equivalent continuous loop [1/sample]

    def run(self, near: float) -> SampledNorm:
        """Runs the search for the gain, starting at the level `near`."""
        level, below, there = self._first(near)
        _, angle = self._highest(there)
        for _ in range(ROUNDS):
            level, below, inside = self._gain_at(angle, level, below)
            if not level:
                return SampledNorm(0.0, 0.0, 0.0, np.nan, 0.0)
            upper = level if inside else level * (1 + ABOVE)
            there = self._at(upper)
            assert there is not None, "every level above a level with a discrete plant has a discrete plant, too"
            gain, higher = self._above(there)
            if gain <= 1:
                lower = self._at(level * (1 - BELOW))
                if lower is None or lower.gains(np.array([angle]))[0] > 1:
                    below = max(below, level * (1 - BELOW))
                angle = np.nan if inside else angle
                return SampledNorm(level, below, upper, angle, reached_near(self.loop, angle, level), inside)
            angle, level, below = higher, upper, upper
        raise ArithmeticError("the search for the norm of the sampled-data loop did not converge")

    def _at(self, level: float) -> _Level | None:
        lifted_loop = lift_plant(self.loop.plant, self.loop.input_selections, level)
        return None if lifted_loop is None else _Level(self.loop, lifted_loop, level)

    def _first(self, level: float) -> tuple[float, float, _Level]:
        """Returns a level that has a discrete plant, a lower level that has none (or 0), and the discrete loop of the higher
        level.
        """
        below = 0.0
        for _ in range(ROUNDS):
            there = self._at(level)
            if there is not None:
                return level, below, there
            below, level = level, 2 * level
        raise ArithmeticError("no bound was found on the gain of the sampled-data loop within one period")

    def _highest(self, there: _Level) -> tuple[float, float]:
        """Returns the largest gain of the discrete loop that belongs to a level, and the angle of this gain [rad].

        The search evaluates a grid of angles that is dense near every pole, and then refines the highest points of the gain.
        """
        turn, damping = np.abs(np.imag(self.poles)), np.abs(np.real(self.poles))
        about = (turn[:, None] + damping[:, None] * np.linspace(-3, 3, 13)).ravel()
        angles = np.unique(np.concatenate([[0.0, np.pi], np.clip(about, 0.0, np.pi)]))
        gains = there.gains(angles)
        padded = np.concatenate([angles[:1], angles, angles[-1:]])
        left, right = np.append(-np.inf, gains[:-1]), np.append(gains[1:], -np.inf)
        tops = np.flatnonzero((gains >= left) & (gains >= right) & (gains >= 0.9 * gains.max()))
        return there.climbed(angles[tops], np.maximum(padded[tops + 2] - angles[tops], angles[tops] - padded[tops]))

    def _above(self, there: _Level) -> tuple[float, float]:
        """Returns the largest gain at the angles where a gain is 1 and between these angles, and the angle [rad] of the largest
        gain.

        If the largest gain does not exceed 1, the returned angle is 0.
        """
        crossings = there.crossings()
        proposed = np.concatenate([crossings, (crossings[:-1] + crossings[1:]) / 2, [np.pi]])
        apart = np.concatenate([np.zeros(len(crossings)), np.diff(crossings) / 2, [0.0]])
        gains = there.gains(proposed)
        best = gains.argsort()[-2:]
        return (float(gains.max()), 0.0) if gains.max() <= 1 else there.climbed(proposed[best], apart[best])

    def _gain_at(self, angle: float, level: float, below: float) -> tuple[float, float, bool]:
        """Returns the level at which the gain of the discrete loop at an angle [rad] is 1, and a lower level.

        The third returned value is True if the lower level has no discrete plant. The search is a secant iteration in the
        logarithms of level and gain; it keeps one level below the result and one level above.
        """
        above, last, first = np.inf, None, level
        for _ in range(ROUNDS):
            there = self._at(level)
            gain = float(there.gains(np.array([angle]))[0]) if there is not None else np.inf
            if abs(gain - 1) <= CLOSE:
                return level, below, False
            below, above = (max(below, level), above) if gain > 1 else (below, min(above, level))
            if above <= below * (1 + BELOW):
                return above, below, self._at(below) is None
            if above <= NOTHING * first:
                return 0.0, 0.0, False
            at, height = math.log(level), math.log(gain) if 0 < gain < np.inf else math.nan
            slope = (height - last[1]) / (at - last[0]) if last is not None and at != last[0] else -1.0
            last = (at, height) if math.isfinite(height) else None
            move = -height / slope if math.isfinite(height) and slope < 0 else math.nan
            level = math.exp(min(at + move, at + 1.0)) if math.isfinite(move) else math.nan
            if not below < level < above:
                level = 2 * below if math.isinf(above) else math.sqrt(below * above) if below else above / 4
        raise ArithmeticError(f"the search for the norm of the sampled-data loop did not converge at {angle:g} rad per sample")
