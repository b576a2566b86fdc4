"""Maximum-likelihood estimate of a vehicle's parameters, with intervals and the combinations that the logs do not determine.

The residuals of each sensor are divided by the rms of its noise. If this rms is not given, it is estimated from the residuals,
alternately with the parameters. The unknowns are the logarithms of the free parameters, the delays and offsets of sensors, and
the state at the start of each experiment. `scipy.optimize.least_squares` minimises the sum of squares of the residuals.

Directions. J contains the derivatives of all residuals, and J'J is the information matrix. The columns of J for the parameters
are projected onto the complement of the columns for all other unknowns. The singular value decomposition of the result gives
the singular values s, and in V the directions in the space of the logarithms. A change of the logarithms along a direction with
s = 0 changes no signal. The motion of a quarter-car has one such direction: all masses, stiffnesses and dampings multiplied by
the same number. As many parameters as there are such directions are then held at their initial values. For each other
parameter, the logs determine the product of this parameter with powers of the held ones.

Intervals. The covariance of the logarithms is (J'J)^-1. If the residuals of a sensor are coloured, this covariance is too
small. (J'J)^-1 J'RJ (J'J)^-1 is then used, where R is the autocovariance of an autoregressive model of each sensor's residuals.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, list_names
from models.vehicle.vehicle import Vehicle
from sim.studies.identification.experiment import Experiment
from sim.studies.identification.part_prediction import PartPrediction
from sim.studies.identification.prediction import LogPrediction, PredictedSignals
from sim.studies.identification.whiteness import Whiteness, autoregressive, whiteness

NORMAL = 1.959963984540054  # half the width of a 95 % confidence interval, in standard deviations
CHI2 = NORMAL**2  # amount by which -2 log likelihood is larger at the ends of a 95 % confidence interval
SINGULAR = 1e-7  # smallest relative singular value of a direction that changes a signal; matrices are accurate to 1e-10
# a parameter counts as not determined if the standard deviation of its logarithm is larger: a factor of 7 up or down
WIDE = 1.0
SETTLED = 1e-4  # the noise rms has converged if its relative change is smaller than this
ROUNDS = 30  # largest number of times that noise and parameters are estimated in turn
SPREAD = 1.2  # half the range of logarithms from which further starting points are taken: a factor of 3 up or down
STARTS = 6
FAR = 100.0  # a search is skipped if the deviance at its starting point exceeds that of a known solution by more than this
FURTHEST = 9.0  # largest change of the logarithm of a parameter: a factor of 8000
TOLERANCES: Any = {"method": "trf", "x_scale": "jac", "ftol": 1e-10, "xtol": 1e-9, "gtol": 1e-12}
BLOCK = 50_000  # largest number of samples whose derivatives are kept in memory at the same time
# largest number of evaluations in the first search, and in a search from a further starting point or near a solution
MOST, FEW = 60, 10
WARM = 4  # number of rounds in a search that starts near a solution
# if the rms of the residuals is a smaller share of the signal's rms, the residuals contain no noise that could be tested
NOISELESS = 1e-3
POOR = 0.5  # if the fit explains a smaller share of a signal's mean square, other starting points are tried


@dataclass(frozen=True, eq=False)
class Known:
    """A combination of parameters that is known from elsewhere: a corner weight, or a weighed mass.

    Attributes:
        name: name of the combination in reports.
        of: function that computes the combination for a vehicle [SI].
        value: measured value.
        deviation: standard deviation of the measured value.
    """

    name: str
    of: Callable[[Vehicle], float]
    value: float
    deviation: float


@dataclass(frozen=True, eq=False)
class IdentificationProblem:
    """Parameters to identify, and the experiments that measured them.

    Attributes:
        vehicle: vehicle with the initial values of its parameters.
        change: function that returns the vehicle with other values of some parameters.
        first: initial values of all free parameters, by name; each is above 0.
        from_zero: names of the free parameters that may be zero; the unknowns of all others are logarithms.
        experiments: the experiments.
        known: combinations that are known from elsewhere.
        lowest: smallest allowed values of parameters that need a limit above 0, such as an exponent.
    """

    vehicle: Vehicle
    change: Callable[[Vehicle, Mapping[str, float]], Vehicle]
    first: Mapping[str, float]
    experiments: tuple[Experiment, ...]
    known: tuple[Known, ...] = ()
    from_zero: frozenset[str] = frozenset()
    lowest: Mapping[str, float] = field(default_factory=dict[str, float])

    @cached_property
    def predictions(self) -> tuple[LogPrediction, ...]:
        """The predictor of each experiment's signals."""
        kinds = (PartPrediction if one.part else LogPrediction for one in self.experiments)
        return tuple(
            kind(one, lambda values: self.change(self.vehicle, values)) for kind, one in zip(kinds, self.experiments, strict=True)
        )

    @cached_property
    def signals(self) -> tuple[str, ...]:
        """Names of all measured signals."""
        return tuple(dict.fromkeys(name for one in self.experiments for name in one.signals))

    @cached_property
    def delayed(self) -> tuple[str, ...]:
        """Names of the signals whose sensor's delay is estimated."""
        names = {one.signal for each in self.experiments for one in each.channels if one.delay_estimated}
        return tuple(name for name in self.signals if name in names)


@dataclass(frozen=True, eq=False)
class _Unknowns:
    """Indices of all unknowns in one vector: logarithms of parameters, delays, initial states and offsets."""

    free: tuple[str, ...]
    delayed: tuple[str, ...]
    starts: tuple[int, ...]
    offsets: tuple[tuple[int, ...], ...]

    @property
    def size(self) -> int:
        return len(self.free) + len(self.delayed) + sum(self.starts) + sum(map(len, self.offsets))

    def of_experiment(self, i: int) -> tuple[slice, slice]:
        """Returns the indices of an experiment's starting state, and of its offsets."""
        first = len(self.free) + len(self.delayed) + sum(self.starts[:i]) + sum(map(len, self.offsets[:i]))
        return slice(first, first + self.starts[i]), slice(first + self.starts[i], first + self.starts[i] + len(self.offsets[i]))


class _Residuals:
    """Residuals of all experiments, divided by the noise, and their derivatives, for one choice of free parameters."""

    def __init__(self, problem: IdentificationProblem, free: Sequence[str], fixed: Mapping[str, float]) -> None:
        self.problem, self.fixed = problem, {**problem.first, **fixed}
        starts = tuple(0 if one.experiment.from_rest else len(one.states(self.fixed)) for one in problem.predictions)
        offsets = tuple(
            tuple(i for i, channel in enumerate(one.channels) if channel.offset_estimated) for one in problem.experiments
        )
        self.unknowns = _Unknowns(tuple(free), problem.delayed, starts, offsets)
        self.measured = [np.stack([channel.values for channel in one.channels], axis=-1) for one in problem.experiments]
        self._at, self._now = None, list[PredictedSignals]()

    def values(self, x: Array) -> dict[str, float]:
        """Returns the values of all parameters."""
        values = dict(self.fixed)
        for name, number in zip(self.unknowns.free, x.tolist(), strict=False):
            values[name] *= (
                max(number, 0.0) if name in self.problem.from_zero else math.exp(min(max(number, -FURTHEST), FURTHEST))
            )
        return values

    def coordinate(self, name: str, value: float) -> float:
        """Returns a parameter's unknown: its ratio to the initial value if it may be zero, else the logarithm of this ratio."""
        ratio = value / self.fixed[name]
        return ratio if name in self.problem.from_zero else math.log(ratio)

    def sizes(self, values: Mapping[str, float]) -> dict[str, float]:
        """Returns the derivative of each free parameter with respect to its unknown, by name."""
        return {name: (self.fixed if name in self.problem.from_zero else values)[name] for name in self.unknowns.free}

    def delays(self, x: Array, experiment: Experiment) -> list[float]:
        """Returns the delays of an experiment's channels [s]."""
        first = len(self.unknowns.free)
        own = dict(zip(self.unknowns.delayed, x[first : first + len(self.unknowns.delayed)].tolist(), strict=True))
        return [own.get(one.signal, one.delay) for one in experiment.channels]

    def start(self, x: Array, i: int) -> Array | None:
        """Returns the state at the start of an experiment; None if the vehicle starts in equilibrium."""
        return x[self.unknowns.of_experiment(i)[0]] if self.unknowns.starts[i] else None

    def predicted(self, x: Array, derivatives: bool = True) -> list[PredictedSignals]:
        """Returns the predicted signals of all experiments, with offsets."""
        if self._at is not None and np.array_equal(self._at, x):
            return self._now
        values, all_signals = self.values(x), list[PredictedSignals]()
        for i, one in enumerate(self.problem.predictions):
            _, offset = self.unknowns.of_experiment(i)
            first = self.start(x, i)
            signals = one(values, self.sizes(values), first, self.delays(x, one.experiment), derivatives)
            shift = np.zeros(signals.values.shape[1])
            shift[list(self.unknowns.offsets[i])] = x[offset]
            all_signals.append(replace(signals, values=signals.values + shift))
        if derivatives:
            self._at, self._now = x.copy(), all_signals
        return all_signals

    def differences(self, x: Array, derivatives: bool = False) -> list[Array]:
        """Returns predicted minus measured signals of each experiment, shape (T, q); NaN where a measured value is missing."""
        return [one.values - measured for one, measured in zip(self.predicted(x, derivatives), self.measured, strict=True)]

    def residuals(self, x: Array, noise: Mapping[str, float], most: int | None = None) -> Array:
        """Returns all residuals divided by the noise, shape (N,), by channel, with at most `most` samples per experiment."""
        rows = list[Array]()
        for each, one in zip(self.differences(x, True), self.problem.experiments, strict=True):
            rows += [values[np.isfinite(values)] / noise[name] for name, values in zip(one.signals, each[:most].T, strict=True)]
        return np.concatenate([*rows, self._known(self.values(x))])

    def channel_columns(self, x: Array, noise: Mapping[str, float], i: int, channel: int, part: slice = slice(None)) -> Array:
        """Returns the derivatives of an experiment's residuals in one channel by all unknowns, shape (T, unknowns)."""
        u, signals, one = self.unknowns, self.predicted(x)[i], self.problem.experiments[i]
        name, size = one.signals[channel], noise[one.signals[channel]]
        columns = np.zeros((len(signals.values[part]), u.size))
        for j, scale in enumerate(self.sizes(self.values(x)).values()):
            columns[:, j] = signals.by_parameter[j, part, channel] * (scale / size)
        if name in u.delayed:
            columns[:, len(u.free) + u.delayed.index(name)] = signals.by_delay[part, channel] / size
        start, offset = u.of_experiment(i)
        columns[:, start] = signals.by_start[:, part, channel].T / size
        if channel in u.offsets[i]:
            columns[:, offset.start + u.offsets[i].index(channel)] = 1 / size
        return columns

    def jacobian(self, x: Array, noise: Mapping[str, float], most: int | None = None) -> Array:
        """Returns the derivatives of `residuals`, shape (N, unknowns)."""
        return np.concatenate([*(J for J, _ in self._blocks(x, noise, most)), self.known_columns(x)])

    def reduced(self, x: Array, noise: Mapping[str, float]) -> tuple[Array, Array]:
        """Returns R and c of a small least-squares problem with the same solution as the whole problem, by QR decomposition.

        The derivatives of a long log are never in memory all at the same time. R has the shape (unknowns + 1, unknowns), and c
        the shape (unknowns + 1,).
        """
        whole = np.column_stack([self.known_columns(x), self._known(self.values(x))])
        for J, residuals in self._blocks(x, noise):
            whole = np.linalg.qr(np.vstack([whole, np.column_stack([J, _finite(residuals)])])).R
        whole = np.pad(whole, ((0, max(0, whole.shape[1] - len(whole))), (0, 0)))
        return whole[:, :-1], whole[:, -1]

    def _blocks(self, x: Array, noise: Mapping[str, float], most: int | None = None) -> Iterator[tuple[Array, Array]]:
        for i, (each, one) in enumerate(zip(self.differences(x, True), self.problem.experiments, strict=True)):
            for channel, name in enumerate(one.signals):
                for first in range(0, len(each[:most]), BLOCK):
                    part = slice(first, min(first + BLOCK, most or len(each)))
                    values = each[part, channel]
                    counted = np.isfinite(values)
                    yield self.channel_columns(x, noise, i, channel, part)[counted], values[counted] / noise[name]

    def known_columns(self, x: Array) -> Array:
        """Returns the derivatives of the known combinations, each divided by its standard deviation, shape (k, unknowns)."""
        values, base = self.values(x), np.zeros((len(self.problem.known), self.unknowns.size))
        for j, (name, size) in enumerate(self.sizes(values).items() if self.problem.known else ()):
            base[:, j] = (self._known({**values, name: values[name] + 1e-6 * size}) - self._known(values)) / 1e-6
        return base

    def _known(self, values: Mapping[str, float]) -> Array:
        if not self.problem.known:
            return np.zeros(0)
        vehicle = self.problem.change(self.problem.vehicle, values)
        return np.array([(one.of(vehicle) - one.value) / one.deviation for one in self.problem.known])

    def noise(self, x: Array) -> dict[str, float]:
        """Returns the noise rms of each signal: the given value, or else the rms of its residuals."""
        squares, counts, given = dict[str, float](), dict[str, int](), dict[str, float]()
        for each, one in zip(self.differences(x, True), self.problem.experiments, strict=True):
            for channel, values in zip(one.channels, each.T, strict=True):
                values = values[np.isfinite(values)]
                squares[channel.signal] = squares.get(channel.signal, 0.0) + float(values @ values)
                counts[channel.signal] = counts.get(channel.signal, 0) + len(values)
                if channel.noise is not None:
                    given[channel.signal] = channel.noise
        least = {name: 1e-9 * self.scale[name] for name in counts}
        return {name: given.get(name) or max(np.sqrt(squares[name] / counts[name]), least[name]) for name in counts}

    @cached_property
    def scale(self) -> dict[str, float]:
        """Rms of each measured signal about its mean."""
        own = dict[str, list[Array]]()
        for one in self.problem.experiments:
            for channel in one.channels:
                own.setdefault(channel.signal, []).append(channel.values[channel.counted])
        return {name: float(np.concatenate(each).std()) or 1.0 for name, each in own.items()}


@dataclass(frozen=True, eq=False)
class Direction:
    """A direction in the space of the parameters' logarithms along which no signal changes.

    Attributes:
        powers: component of the direction along each parameter's logarithm, by name.
    """

    powers: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Estimate:
    """Result of an identification.

    Attributes:
        problem: parameters and experiments.
        values: values of all free parameters [SI], by name; the parameters in `held` have their initial values.
        free: names of the p parameters that were estimated.
        held: parameters that kept their initial values, because the signals determine only their products with others.
        directions: directions along which no signal changes.
        silent: parameters that affect no signal; they keep their initial values.
        delays: estimated delays [s], by signal.
        noise: noise rms of each signal.
        covariance: covariance of the logarithms of the free parameters if the residuals are white, shape (p, p).
        robust: covariance of the same logarithms, computed from the autocovariance of the residuals, shape (p, p).
        whiteness: result of the whiteness test of each experiment, by signal.
        differences: predicted minus measured signals of each experiment, shape (T, q).
        predicted: predicted signals of each experiment, shape (T, q).
        deviance: -2 log likelihood, up to a constant.
        residuals: the residuals for further analysis.
        x: the unknowns.
    """

    problem: IdentificationProblem
    values: Mapping[str, float]
    free: tuple[str, ...]
    held: tuple[str, ...]
    directions: tuple[Direction, ...]
    silent: tuple[str, ...]
    delays: Mapping[str, float]
    noise: Mapping[str, float]
    covariance: Array
    robust: Array
    whiteness: tuple[Mapping[str, Whiteness], ...]
    differences: tuple[Array, ...]
    predicted: tuple[Array, ...]
    deviance: float
    residuals: _Residuals = field(repr=False)
    x: Array = field(repr=False)

    @cached_property
    def noiseless(self) -> dict[str, float]:
        """Signals that are fitted almost exactly: by name, the largest ratio of the residuals' rms to the signal's rms."""
        shares = {name: max(1 - each[name] for each in self.fits if name in each) for name in self.problem.signals}
        return {name: share for name, share in shares.items() if share < NOISELESS}

    @property
    def white(self) -> bool:
        """True if the residuals of all signals are white; signals without noise are not counted."""
        return all(one.white or name in self.noiseless for each in self.whiteness for name, one in each.items())

    @property
    def coloured(self) -> bool:
        """True if the residuals of at least one signal are not white."""
        return not all(one.white for each in self.whiteness for one in each.values())

    @property
    def spread(self) -> Array:
        """Covariance from which intervals are computed: `robust` if residuals are coloured, else `covariance`."""
        return self.robust if self.coloured else self.covariance

    @cached_property
    def deviations(self) -> dict[str, float]:
        """Standard deviation of the logarithm of each free parameter."""
        return dict(zip(self.free, np.sqrt(np.diag(self.spread)).tolist(), strict=True))

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Free parameters whose interval is so wide that the logs do not determine them in practice."""
        return tuple(name for name, deviation in self.deviations.items() if not deviation < WIDE)

    def interval(self, name: str) -> tuple[float, float]:
        """Returns the 95 % interval of a free parameter."""
        value, width = self.values[name], NORMAL * self.deviations[name]
        return value * float(np.exp(-width)), value * float(np.exp(width))

    def combination(self, powers: Mapping[str, float]) -> tuple[float, float]:
        """Returns the value of a product of powers of parameters, and the standard deviation of its logarithm.

        Args:
            powers: power of each parameter. Held parameters count as known, because the product does not depend on their
                values.
        """
        weights = np.array([powers.get(name, 0.0) for name in self.free])
        value = float(np.exp(sum(power * np.log(self.values[name]) for name, power in powers.items())))
        return value, float(np.sqrt(weights @ self.spread @ weights))

    @property
    def fits(self) -> list[dict[str, float]]:
        """For each experiment, the fit of each signal: 1 - rms of the residuals / standard deviation of the signal."""
        return measured_fits(self.problem.experiments, self.differences)

    @cached_property
    def ratios(self) -> dict[str, dict[str, float]]:
        """For each free parameter, the product with powers of held parameters that the logs determine: powers by name."""
        if not self.directions:
            return {}
        N = np.array([[one.powers.get(name, 0.0) for one in self.directions] for name in (*self.free, *self.held)])
        own, held = N[: len(self.free)], N[len(self.free) :]
        # The powers fulfil own = shares @ held, so log(free parameters) - shares @ log(held parameters) is the same for any
        # held values
        shares = np.linalg.solve(held.T, own.T).T
        return {
            name: {name: 1.0, **{other: -_tidy(share) for other, share in zip(self.held, row, strict=True) if _tidy(share)}}
            for name, row in zip(self.free, shares, strict=True)
        }


def measured_fits(experiments: Sequence[Experiment], differences: Sequence[Array]) -> list[dict[str, float]]:
    """Returns for each experiment the fit of each signal: 1 - rms of the residuals / standard deviation of the signal."""
    each = list[dict[str, float]]()
    for one, difference in zip(experiments, differences, strict=True):
        each.append({})
        for channel, values in zip(one.channels, difference.T, strict=True):
            counted = np.isfinite(values)
            spread = float(channel.values[counted].std()) if counted.any() else 0.0
            each[-1][channel.signal] = 1 - float(np.sqrt(np.mean(values[counted] ** 2))) / spread if spread else 0.0
    return each


def start_and_offsets(problem: IdentificationProblem) -> list[Array]:
    """Returns predicted minus measured signals for the initial parameters, with the best fit of starting states and offsets."""
    residuals = _Residuals(problem, (), {})
    return residuals.differences(_first(residuals), True)


def _tidy(number: float) -> float:
    """Returns the nearest multiple of 1/12 if a number equals it up to rounding."""
    near = round(12 * number) / 12
    return near if abs(near - number) < 1e-4 else float(number)


def estimate(problem: IdentificationProblem, free: Sequence[str], seed: int = 0) -> Estimate:
    """Identifies parameters.

    Args:
        free: names of the parameters to estimate; the others keep their initial values.
        seed: random seed of further starting points, which are tried if the first one leads to a poor fit.

    Raises:
        InputError: there is nothing to estimate, or the search from every starting point fails.
    """
    if not free:
        raise InputError(f"no parameter is free; free one of {list_names(problem.first)} with --free")
    every = _Residuals(problem, free, {})
    x = _first(every)
    held, silent, directions = _structure(every, x)
    left = tuple(name for name in free if name not in (*held, *silent))
    if not left:
        raise InputError(
            "the signals determine neither a parameter nor a combination of parameters; measure a signal that depends on them"
        )
    some = _Residuals(problem, left, {})
    best = _solve(some, _first(some))
    if _poor(some, best[0]):
        rng = np.random.default_rng(seed)
        for _ in range(STARTS):
            with suppress(InputError, np.linalg.LinAlgError):  # parameters that no vehicle can have are skipped
                x = _least_squares(some, _first(some, rng.uniform(-SPREAD, SPREAD, len(left))), best[1], FEW)
                if _deviance(some, x, some.noise(x)) < best[2] - CHI2:
                    best = min(best, _solve(some, x), key=lambda one: one[2])
    return _estimate(some, best, held, silent, directions)


def standard_deviations(problem: IdentificationProblem) -> dict[str, float]:
    """Returns the Cramer-Rao bound on the standard deviation of each parameter's logarithm at the initial values.

    The bound is infinite for a parameter that the signals do not determine.
    """
    free = tuple(problem.first)
    of = _Residuals(problem, free, {})
    noise = {one.signal: one.noise or 1.0 for each in problem.experiments for one in each.channels}
    x = np.zeros(of.unknowns.size)
    x[: len(free)] = [of.coordinate(name, of.fixed[name]) for name in free]
    R, _ = _information(of.reduced(x, noise)[0], len(free))
    sizes = np.linalg.norm(R, axis=0)
    _, s, V = np.linalg.svd(R / np.where(sizes, sizes, 1.0))
    open_directions = V[s <= SINGULAR * s[0]]
    spread = np.sqrt(np.sum((V / np.maximum(s, 1e-300)[:, None]) ** 2, axis=0)) / np.where(sizes, sizes, 1e-300)
    unknown = np.abs(open_directions).max(axis=0, initial=0.0) > 1e-5
    return {name: float("inf" if lost else one) for name, one, lost in zip(free, spread, unknown, strict=True)}


def nearby(problem: IdentificationProblem, free: Sequence[str], deviance: float) -> dict[str, float] | None:
    """Returns the solution of a search from the initial values; None if its deviance is larger than the given one.

    If the starting point is far from a solution, the search is not run.
    """
    of = _Residuals(problem, free, {})
    x = _first(of)
    if _deviance(of, x, of.noise(x)) > deviance + FAR:
        return None
    solution = _solve(of, x)
    return of.values(solution[0]) if solution[2] <= deviance else None


def _first(of: _Residuals, shift: Array | None = None) -> Array:
    """Returns the initial unknowns: the given parameters, and the starting states and offsets that fit best with them."""
    u, x = of.unknowns, np.zeros(of.unknowns.size)
    p = len(u.free)
    x[:p] = [of.coordinate(name, of.fixed[name]) for name in u.free]
    if shift is not None:
        x[:p] += shift
    given = {one.signal: one.delay for each in of.problem.experiments for one in each.channels}
    x[p : p + len(u.delayed)] = [given[name] for name in u.delayed]
    if u.size == p + len(u.delayed):
        return x
    noise = of.scale
    R, c = of.reduced(x, noise)
    x[p + len(u.delayed) :] -= np.linalg.lstsq(R[:, p + len(u.delayed) :], c)[0]
    return x


def _solve(of: _Residuals, x: Array, rounds: int = ROUNDS, most: int = MOST) -> tuple[Array, dict[str, float], float]:
    """Returns the maximum-likelihood unknowns, the noise and the deviance. Unknowns and noise are estimated alternately.

    Args:
        rounds: largest number of rounds, each with a limited number of evaluations.
    """
    noise = of.noise(x)
    for _ in range(rounds):
        x = _least_squares(of, x, noise, most)
        before, noise = noise, of.noise(x)
        if all(abs(noise[name] - before[name]) <= SETTLED * noise[name] for name in noise):
            break
    return x, noise, _deviance(of, x, noise)


def _least_squares(of: _Residuals, x: Array, noise: Mapping[str, float], most: int = MOST) -> Array:
    """Returns the unknowns that minimise the squares of the residuals over the noise, after at most `most` evaluations."""
    from scipy.optimize import least_squares

    def jacobian(x: Array, noise: Mapping[str, float]) -> Array:
        return of.reduced(x, noise)[0]

    least = np.full(len(x), -np.inf)
    for i, name in enumerate(of.unknowns.free):
        if name in of.problem.from_zero:
            least[i] = 0.0
        elif name in of.problem.lowest:
            least[i] = of.coordinate(name, of.problem.lowest[name])
    bounds: Any = {"bounds": (least, np.inf)} if np.isfinite(least).any() else {}
    inside = np.maximum(x, least + 1e-3)  # the search does not start on a bound, because it would not move from there
    by_unknown: Any = jacobian
    return least_squares(
        lambda x, noise: of.reduced(x, noise)[1], inside, by_unknown, args=(noise,), max_nfev=most, **bounds, **TOLERANCES
    ).x


def _finite(residuals: Array) -> Array:
    """Returns the residuals with large numbers instead of overflows (unstable vehicles), so that the search turns back."""
    return np.nan_to_num(np.clip(residuals, -1e12, 1e12), nan=1e12)


def _deviance(of: _Residuals, x: Array, noise: Mapping[str, float]) -> float:
    _, c = of.reduced(x, noise)
    counts = dict[str, int]()
    for each, one in zip(of.differences(x, True), of.problem.experiments, strict=True):
        for name, values in zip(one.signals, each.T, strict=True):
            counts[name] = counts.get(name, 0) + int(np.isfinite(values).sum())
    return float(c @ c + 2 * sum(count * np.log(noise[name]) for name, count in counts.items()))


def _poor(of: _Residuals, x: Array) -> bool:
    """Returns True if a signal's residuals are not white, and the fit explains less than `POOR` of the signal's mean square."""
    for each, one in zip(of.differences(x, True), of.problem.experiments, strict=True):
        for name, values in zip(one.signals, each.T, strict=True):
            if np.nanmean(values**2) > (1 - POOR) * of.scale[name] ** 2 and not whiteness(values).white:
                return True
    return False


def _information(R: Array, p: int) -> tuple[Array, Array]:
    """Returns the information on the first p unknowns if all others are also unknown, and how the others compensate for them.

    Args:
        R: derivatives of all residuals by the u unknowns, or the factor R of their QR decomposition, shape (k, u).

    Returns:
        R, where R'R is the information, shape (p, p), and C, shape (u - p, p). The columns of the others times C are the part of
        the first p columns that the others can also produce.
    """
    own, others = R[:, :p], R[:, p:]
    C = np.linalg.lstsq(others, own)[0] if others.shape[1] else np.zeros((0, p))
    return np.linalg.qr(own - others @ C).R, C


def _structure(of: _Residuals, x: Array) -> tuple[tuple[str, ...], tuple[str, ...], tuple[Direction, ...]]:
    """Returns the parameters to hold, the parameters that affect no signal, and the directions along which no signal changes."""
    free, p = of.unknowns.free, len(of.unknowns.free)
    # At the initial values, the derivatives with respect to the logarithm of a parameter and to its unknown are equal, even if
    # the parameter may be zero.
    R, _ = _information(of.reduced(x, of.scale)[0], p)
    sizes = np.linalg.norm(R, axis=0)
    silent = tuple(name for name, size in zip(free, sizes, strict=True) if size <= SINGULAR * sizes.max(initial=0.0))
    felt = [i for i, name in enumerate(free) if name not in silent]
    if not felt:
        return (), silent, ()
    _, s, V = np.linalg.svd(R[:, felt] / sizes[felt])
    # To find the rank, the columns are scaled to length 1. The directions found are then converted back to logarithms.
    null = (V[s <= SINGULAR * s[0]] / sizes[felt]).T
    if not null.size:
        return (), silent, ()
    held, rows = list[int](), null.copy()
    order = sorted(range(len(felt)), key=lambda i: (not free[felt[i]].startswith("sprung_mass"), "mass" not in free[felt[i]], i))
    for _ in range(null.shape[1]):
        largest = np.abs(rows).max(axis=1)
        pivot = next(i for i in order if i not in held and largest[i] > 0.1 * largest.max())
        held.append(pivot)
        column = int(np.argmax(np.abs(rows[pivot])))
        rows = rows - np.outer(rows[:, column], rows[pivot]) / rows[pivot, column]
    basis = null @ np.linalg.inv(null[held])
    names = [free[i] for i in felt]
    directions = tuple(
        Direction({name: _tidy(power) for name, power in zip(names, column, strict=True) if abs(power) > 1e-5})
        for column in basis.T
    )
    return tuple(names[i] for i in held), silent, directions


def _estimate(
    of: _Residuals,
    solution: tuple[Array, dict[str, float], float],
    held: tuple[str, ...],
    silent: tuple[str, ...],
    directions: tuple[Direction, ...],
) -> Estimate:
    """Returns the estimate for a solution, with covariances and whiteness tests."""
    x, noise, deviance = solution
    u, p = of.unknowns, len(of.unknowns.free)
    whole, _ = of.reduced(x, noise)
    R, C = _information(whole, p)
    inverse, values = np.linalg.pinv(R), of.values(x)
    by_unknown = np.array([size / max(values[name], 1e-9 * size) for name, size in of.sizes(values).items()])
    covariance = inverse @ inverse.T
    differences, tests = of.differences(x, True), list[dict[str, Whiteness]]()
    middle = np.zeros((p, p))
    for i, (each, one) in enumerate(zip(differences, of.problem.experiments, strict=True)):
        tests.append({})
        for channel, name in enumerate(one.signals):
            scaled = each[:, channel] / noise[name]
            tests[-1][name] = whiteness(scaled)
            columns = of.channel_columns(x, noise, i, channel) * np.isfinite(scaled)[:, None]
            middle += autoregressive(scaled).sandwich(np.nan_to_num(columns[:, :p] - columns[:, p:] @ C))
    exact = of.known_columns(x)
    middle += (exact[:, :p] - exact[:, p:] @ C).T @ (exact[:, :p] - exact[:, p:] @ C)
    first = len(u.free)
    return Estimate(
        of.problem,
        {**{name: of.fixed[name] for name in (*held, *silent)}, **{name: values[name] for name in u.free}},
        u.free,
        held,
        directions,
        silent,
        dict(zip(u.delayed, x[first : first + len(u.delayed)].tolist(), strict=True)),
        noise,
        covariance * np.outer(by_unknown, by_unknown),
        covariance @ middle @ covariance * np.outer(by_unknown, by_unknown),
        tuple(tests),
        tuple(differences),
        tuple(one.values for one in of.predicted(x)),
        deviance,
        of,
        x,
    )


def profile(of: Estimate, name: str) -> tuple[float | None, float | None]:
    """Returns the 95 % interval of a parameter by profile likelihood; None for a side that is open.

    A side is open if the likelihood never falls to the level of an interval's end. The parameter is changed by a factor of up to
    8000, or to zero if it may be zero. If residuals are coloured, the required fall is larger, as in the robust covariance.
    """
    from scipy.optimize import brentq

    i, own = of.free.index(name), of.residuals
    others, warm = tuple(one for one in of.free if one != name), {0.0: np.delete(of.x, i)}
    rise = CHI2 * (of.spread[i, i] / of.covariance[i, i])
    levels = {0.0: -rise}
    size = own.sizes(of.values)[name]
    deviation = float(np.sqrt(of.spread[i, i])) * max(of.values[name], 1e-9 * size) / size  # standard deviation of the unknown
    from_zero, best = name in of.problem.from_zero, own.coordinate(name, of.values[name])

    def excess(shift: float) -> float:
        if shift in levels:
            return levels[shift]
        value = own.fixed[name] * (max(best + shift, 0.0) if from_zero else math.exp(best + shift))
        # The initial values are not replaced, because the unknowns of the other parameters are relative to them.
        fixed = _Residuals(replace(of.problem, first={**own.fixed, name: value}), others, {})
        solution = _solve(fixed, warm[min(warm, key=lambda one: abs(one - shift))], WARM, FEW)
        warm[shift] = solution[0]
        levels[shift] = solution[2] - of.deviance - rise
        return levels[shift]

    ends = list[float | None]()
    for sign in (-1, 1):
        low, high = 0.0, sign * min(NORMAL * deviation, FURTHEST)
        least = own.coordinate(name, of.problem.lowest[name]) if name in of.problem.lowest else -FURTHEST
        last = FURTHEST - best if sign > 0 else (0.0 if from_zero else least) - best
        high = high if abs(high) < abs(last) else last
        while (above := excess(high)) < 0 and high != last:
            low, high = high, sign * min(2 * abs(high), abs(last))
        if above < 0:
            ends.append(None)
            continue
        shift: Any = brentq(excess, low, high, xtol=1e-2 * deviation, rtol=np.float64(1e-4))
        ends.append(own.fixed[name] * (max(best + shift, 0.0) if from_zero else math.exp(best + shift)))
    return ends[0], ends[1]
