"""Diagnosis of a misfit: a delay, a wrong factor, sign or offset, friction, tyre damping, wheel lift-off, or a resonance.

Signals and forces are compared with the initial vehicle before the fit. Forces are tested again after the fit, because a force
of the wrong sign then appears as masses, stiffnesses and dampings that grow without limit.

Each possible cause changes the predicted signals in a known direction g. The part of g that changes of the unknowns, such as
the parameters, could also produce is removed. The rest of g is fitted to the residuals by least squares, and the fit gives the
size of the cause. The share of a cause is the part of the residuals' sum of squares that the cause explains. The share of a
cause is the score (Lagrange multiplier) statistic for one additional parameter, divided by the number of residuals. First, the
cause with the largest statistic is selected. The other causes are then tested again on the residuals that the selected cause
does not explain.

Friction builds up over a displacement, as in the Dahl model. Several displacements are tried, and the best one is used, because
a short displacement alone does not detect friction that small motion fails to overcome.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import linalg

from models.common.arrays import Array, recursion
from models.common.errors import InputError, list_names
from models.common.printed import brief, rough
from sim.studies.identification.estimation.estimate import WIDE, Estimate, estimate
from sim.studies.identification.estimation.problem import IdentificationProblem
from sim.studies.identification.experiment import signal_units
from sim.studies.identification.prediction import LogPrediction, continuous_model
from sim.studies.identification.whiteness import autoregressive

FACTORS: Mapping[float, str] = {
    1000.0: "in thousandths of its unit, such as mm",
    0.001: "in thousands of its unit, such as km or kN",
    1 / 9.80665: "in g instead of m/s2",
    9.80665: "in m/s2 although its unit is g",
    57.29577951308232: "in degrees",
    39.37007874015748: "in inches",
    100.0: "in hundredths of its unit, such as cm",
}
NEAR = 0.2  # a factor is reported as one of the `FACTORS` if its relative distance from that factor is smaller than this
ALIKE = 0.8  # correlation above which a column counts as the signal multiplied by a factor
EXPLAINED = 0.03  # a cause is reported if it explains a larger share of the residuals' sum of squares than this
SURE = 5.0  # a cause is reported if its size is more than this many standard deviations
LAGS = 25  # largest delay to try, in samples
MOST_CAUSES = 3
SCALED = frozenset(["kg", "kg m2", "N/m", "N s/m", "N m/rad"])  # units of the parameters that are proportional to a force
APART = 1.2  # values of a parameter in two logs count as a contradiction if they differ by a larger factor than this
UNLIKELY = 10.0  # a remark is printed if the scale of all parameters changes by a larger factor than this
# The unknowns can also produce a part of a cause's effect. If the rest is a smaller share of the effect than this, the size of
# the cause cannot be determined.
LEFT = 0.01
MOST_SAMPLES = 50_000  # largest number of samples of an experiment that are used to search for causes
SHARP = 0.9  # a pole of the residuals' model with a larger magnitude is a resonance


@dataclass(frozen=True)
class Cause:
    """A cause of a misfit.

    Attributes:
        words: text that names the cause and its size.
        share: share of the sum of squares of all residuals that the cause explains.
        deviations: estimated size of the cause, divided by the standard deviation of this estimate.
    """

    words: str
    share: float
    deviations: float


SETS_IN = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)  # displacements over which friction builds up, as shares of the largest travel


def check_columns(problem: IdentificationProblem) -> list[str]:
    """Compares the measured columns with the signals that the initial vehicle predicts, before the fit; returns remarks.

    Raises:
        InputError: the unit or the sign of a column seems to differ from the map.
    """
    remarks = list[str]()
    for one, prediction in zip(problem.experiments, problem.predictions, strict=True):
        start = None if one.from_rest else np.zeros(len(prediction.states(problem.first)))
        delays = [channel.delay for channel in one.channels]
        predicted = prediction(problem.first, {}, start, delays, False).values
        correlations = np.array([[_correlation(channel.values, column) for column in predicted.T] for channel in one.channels])
        units = [signal_units(problem.vehicle.kind)[channel.signal] for channel in one.channels]
        for i, channel in enumerate(one.channels):
            own, both = correlations[i, i], channel.counted & np.isfinite(predicted[:, i])
            ratio = float(channel.values[both].std() / max(predicted[both, i].std(), 1e-300)) if both.any() else 1.0
            named = next((words for factor, words in FACTORS.items() if abs(ratio / factor - 1) < NEAR), "")
            if own > ALIKE and named:
                raise InputError(
                    f"{one.name}: {channel.signal} is {ratio:.4g} times as large as the vehicle model predicts, so the "
                    f"column of this signal seems to be {named}; write the unit of the column in the map"
                )
            if own < -ALIKE:
                raise InputError(
                    f"{one.name}: the sign of {channel.signal} is opposite to the sign that the vehicle model predicts "
                    f"(correlation {own:.2f}); {_reverse(channel.signal)}"
                )
            others = [j for j in range(len(units)) if j != i and units[j] == units[i]]
            for j in others:
                if j > i and min(correlations[i, j], correlations[j, i]) > max(ALIKE, own + 0.1, correlations[j, j] + 0.1):
                    remarks.append(f"{one.name}: the columns of {channel.signal} and {one.channels[j].signal} seem to be swapped")
        for j, name in enumerate(problem.vehicle.linear_model.inputs):
            if one.part or not one.forces[:, j].any():
                continue
            without = replace(one, forces=one.forces * (np.arange(one.forces.shape[1]) != j))
            unforced = LogPrediction(without, prediction.changed)(problem.first, {}, start, delays, False).values
            pairs = zip(one.channels, predicted.T, unforced.T, strict=True)
            if all(_correlation(channel.values - rest, whole - rest) < -ALIKE for channel, whole, rest in pairs):
                raise InputError(
                    f"{one.name}: the sign of {name} is opposite to the sign of this force in the vehicle model; {_reverse(name)}"
                )
    return remarks


def _reverse(signal: str) -> str:
    return f"write sign = -1 below [signals.{signal}] in the map"


def check_forces(of: Estimate) -> list[str]:
    """Tests the measured forces after the fit; returns remarks.

    A force determines the scale of all masses, stiffnesses and dampings. If the scale is multiplied by a number, the response to
    the force is divided by this number. A force of the wrong sign therefore fits best with an infinite scale. The search stops
    at a finite one, and the next Gauss-Newton step still reverses the response to the force.

    Raises:
        InputError: all forces together seem to have the opposite sign.
    """
    problem, kind, forces = of.problem, of.problem.vehicle.kind, [*_measured_forces(of).values()]
    given = {one.name for one in kind.parameters if one.unit in SCALED and problem.vehicle.parameters.get(one.name)}
    if not forces or problem.known or not given or not given <= {*of.free}:
        return []
    scaled = [i for i, name in enumerate(of.free) if name in given]
    R, c = of.residuals.reduced(of.x, of.noise)
    steps = -np.linalg.lstsq(R, c)[0][scaled]
    if np.all(steps > 1 + SURE * np.sqrt(np.diag(of.spread)[scaled])):
        raise InputError(
            f"{list_names(forces)} seems to have the opposite sign, because the estimated masses, stiffnesses and "
            f"dampings grow so much that the force has no effect; {_reverse(forces[0])}"
        )
    names = [of.free[i] for i in scaled]
    scale = float(np.exp(np.mean([np.log(of.values[name] / problem.first[name]) for name in names])))
    if max(scale, 1 / scale) < UNLIKELY:
        return []
    named = next((f" (it seems to be {words})" for factor, words in FACTORS.items() if abs(scale / factor - 1) < 0.5), "")
    return [
        f"masses, stiffnesses and dampings are on average {rough(scale)} times their first values, in proportion to "
        f"{list_names(forces)}; check the unit of the force{named}"
    ]


def _correlation(a: Array, b: Array) -> float:
    both = np.isfinite(a) & np.isfinite(b)
    if both.sum() < 3 or not a[both].std() or not b[both].std():
        return 0.0
    return float(np.corrcoef(a[both], b[both])[0, 1])


def _measured_forces(of: Estimate) -> dict[int, str]:
    """Returns the names of the control forces that the logs contain, by index of the force."""
    driven = [one.forces for one in of.problem.experiments if not one.part]
    names = enumerate(of.problem.vehicle.linear_model.inputs)
    return {j: name for j, name in names if any(forces[:, j].any() for forces in driven)}


def contradictions(of: Estimate) -> list[str]:
    """Returns a remark for the parameter that differs most between the logs if each log is identified alone.

    The logs are only compared if residuals are coloured, because logs without a common vehicle cannot have white residuals.
    """
    problem, alone = of.problem, list[tuple[str, Estimate]]()
    if of.white or len(problem.experiments) < 2:
        return []
    for one in problem.experiments:
        with suppress(InputError, np.linalg.LinAlgError):  # a log alone may determine no parameter
            own = replace(problem, first={**problem.first, **of.values}, experiments=(one,))
            alone.append((one.name, estimate(own, of.free, several=False)))
    largest, words = 0.0, ""
    for name in of.free:
        each = [(log, one) for log, one in alone if name in one.free and set(one.ratios.get(name, {name})) == {name}]
        each = sorted((pair for pair in each if pair[1].deviations[name] < WIDE), key=lambda pair: pair[1].values[name])
        if len(each) < 2:
            continue
        (least, a), (most, b) = each[0], each[-1]
        factor = b.values[name] / a.values[name]
        sure = np.log(factor) > SURE * float(np.hypot(a.deviations[name], b.deviations[name]))
        if sure and factor > max(largest, APART):
            largest = factor
            words = (
                f"the logs contradict each other: {name} is {rough(a.values[name])} in {least}, and {rough(b.values[name])} in "
                f"{most}, if each log is identified alone; the intervals do not include this difference"
            )
    return [words] if words else []


def causes(of: Estimate) -> tuple[Cause, ...]:
    """Returns the causes of a misfit between logs and prediction, the largest first; empty if the residuals are white."""
    if of.white:
        return ()
    J, residuals = of.residuals.whole(of.x, of.noise, MOST_SAMPLES)
    explained = np.linalg.qr(J).Q
    own = residuals - explained @ (explained.T @ residuals)
    total, listed = float(own @ own), list[Cause]()
    directions = list(_directions(of))
    while directions and len(listed) < MOST_CAUSES:
        each = list[tuple[float, float, int, Array]]()
        for i, (_, direction) in enumerate(directions):
            g = direction - explained @ (explained.T @ direction)
            size = float(g @ g)
            if size > LEFT * float(direction @ direction):
                coefficient = -float(g @ own) / size
                each.append((coefficient**2 * size, coefficient, i, g))
        if not each:
            break
        squares, coefficient, i, g = max(each, key=lambda one: one[0])
        words, _ = directions.pop(i)
        left = max(float(own @ own) - squares, 1e-300)
        deviations = float(np.sqrt(squares * len(own) / left))
        if squares < EXPLAINED * total or deviations < SURE:
            break
        listed.append(Cause(words(coefficient), squares / total, deviations))
        own = own + coefficient * g
        explained = np.column_stack([explained, g / np.linalg.norm(g)])
    return tuple(listed)


def _directions(of: Estimate) -> Iterator[tuple[Callable[[float], str], Array]]:
    """Yields a pair for each possible cause: a function that describes the cause's size, and the change of all residuals per
    unit of size.
    """
    experiments, problem = of.problem.experiments, of.problem
    for signal in problem.signals:
        late = [np.zeros_like(one) for one in of.predicted]
        gains, shifts = ([np.zeros_like(one) for one in of.predicted] for _ in range(2))
        lag = _lag(of, signal)
        for k, (one, predicted) in enumerate(zip(experiments, of.predicted, strict=True)):
            if signal in one.signals:
                i = one.signals.index(signal)
                values = np.nan_to_num(predicted[:, i])
                late[k][:, i] = np.interp(one.time - lag, one.time, values) - values
                gains[k][:, i], shifts[k][:, i] = values - values.mean(), 1.0
        if signal not in problem.delayed and lag:
            yield (
                partial(
                    "{} is {} ms {} than in the map".format, signal, brief(1e3 * abs(lag)), "later" if lag > 0 else "earlier"
                ),
                _weighted(of, late),
            )
        yield partial(_gain_words, signal), _weighted(of, gains)
        if not all(one.offset_estimated for each in experiments for one in each.channels if one.signal == signal):
            unit = signal_units(problem.vehicle.kind)[signal]
            yield partial(_size_words, f"{signal} with an offset of {{}} {unit}"), _weighted(of, shifts)
    for j, name in _measured_forces(of).items() if not problem.vehicle.parts.nonlinear else ():
        yield partial(_gain_words, name), _weighted(of, [_by_force(of, i, j) for i in range(len(experiments))])
    for place in problem.vehicle.kind.suspensions:
        words = partial(_size_words, f"friction of {{}} N in the suspension{place.ending.replace('_', ' ')}")
        each = [_friction(of, i, place.force) for i in range(len(problem.predictions))]
        yield from ((words, _weighted(of, list(pulled))) for pulled in zip(*each, strict=True))
    parameters = {one.name for one in problem.vehicle.kind.parameters}
    for name in sorted(one for one in parameters if one.startswith("tyre_damping")):
        if name not in of.free and not problem.vehicle.parts.nonlinear:
            words = f"{name} of {{}} N s/m more than in the file"
            yield partial(_size_words, words), _weighted(of, _by_parameter(of, name))


def _size_words(words: str, coefficient: float) -> str:
    return words.format(brief(coefficient))


def _gain_words(signal: str, coefficient: float) -> str:
    factor = 1 + coefficient
    if abs(factor + 1) < NEAR:
        return f"{signal} with the opposite sign"
    named = next((f" (it seems to be {words})" for one, words in FACTORS.items() if abs(factor / one - 1) < NEAR), "")
    return f"{signal} scaled by a factor of {brief(factor)}{named}"


def _lag(of: Estimate, signal: str) -> float:
    """Returns the delay [s] at which a measured signal has the largest correlation with the predicted signal, interpolated by a
    parabola.
    """
    total, step = np.zeros(2 * LAGS + 1), of.problem.experiments[0].step
    for one, predicted in zip(of.problem.experiments, of.predicted, strict=True):
        if signal not in one.signals or one.step != step or len(predicted) <= 4 * LAGS:
            continue
        i = one.signals.index(signal)
        measured = one.channels[i].values
        m, p = (np.nan_to_num(values - np.nanmean(values)) for values in (measured, predicted[:, i]))
        inner = slice(LAGS, len(m) - LAGS)
        total += [float(m[inner] @ p[LAGS - k : len(p) - LAGS - k]) for k in range(-LAGS, LAGS + 1)]
    k = int(np.argmax(total))
    if not 0 < k < 2 * LAGS:
        return 0.0
    before, here, after = total[k - 1 : k + 2]
    return step * (k - LAGS + 0.5 * (before - after) / min(before - 2 * here + after, -1e-300))


def _weighted(of: Estimate, moved: list[Array]) -> Array:
    rows = []
    for one, each, difference in zip(of.problem.experiments, moved, of.differences, strict=True):
        for name, values, left in zip(one.signals, each[:MOST_SAMPLES].T, difference[:MOST_SAMPLES].T, strict=True):
            rows.append(np.nan_to_num(values[np.isfinite(left)]) / of.noise[name])
    return np.concatenate([*rows, np.zeros(len(of.problem.known))])


def _friction(of: Estimate, i: int, force: str) -> list[Array]:
    """Returns the change of the q signals caused by 1 N of friction in a suspension, shape (T, q), for each displacement of
    `SETS_IN`.
    """
    prediction = of.problem.predictions[i]
    one, vehicle = prediction.experiment, prediction.vehicle(of.values)
    if one.part:  # on a dyno, the model of the part already includes its friction
        return [np.zeros_like(of.predicted[i]) for _ in SETS_IN]
    model, deflection = vehicle.linear_model, vehicle.kind.deflection_of(force)
    travel = prediction.signals([deflection], of.values, of.residuals.start(of.x, i))[:, 0]
    A, Bv, _, C, Dv, _ = continuous_model(vehicle, one)
    column = one.road.shape[1] + model.inputs.index(force)
    n = len(A)
    M = np.zeros((n + 1, n + 1))
    M[:n, :n], M[:n, n] = A, Bv[:, column]
    whole = linalg.expm(M * one.step)
    each = list[Array]()
    for pull in dahl_friction(travel, max(float(np.abs(travel).max()), 1e-12) * np.array(SETS_IN)).T:
        # While the ends of the suspension move apart, a friction force pulls them together.
        x = recursion(whole[:n, :n], np.outer(-pull, whole[:n, n]))
        each.append(x @ C.T + np.outer(-pull, Dv[:, column]))
    return each


def dahl_friction(travel: Array, lengths: Array) -> Array:
    """Returns the friction w relative to its largest value, shape (T, m); w' = (v - |v| w) / length, where v is the travel
    rate.

    Args:
        travel: suspension travel at each sample, shape (T,).
        lengths: m displacements over which the friction builds up, in the unit of the travel, shape (m,).
    """
    sign = np.sign(np.diff(travel))
    pull, first = np.zeros((len(travel), len(lengths))), 0
    # the solution is exact between two reversals of the motion
    for last in (*(np.flatnonzero(np.diff(sign)) + 1).tolist(), len(sign)):
        moved = np.abs(travel[first + 1 : last + 1, None] - travel[first])
        pull[first + 1 : last + 1] = sign[first] + (pull[first] - sign[first]) * np.exp(-moved / lengths)
        first = last
    return pull


def _by_force(of: Estimate, i: int, j: int) -> Array:
    """Returns the signals of an experiment that control force j alone causes, shape (T, q)."""
    one = of.problem.experiments[i]
    if one.part:
        return np.zeros_like(of.predicted[i])
    own = one.forces * (np.arange(one.forces.shape[1]) == j)
    alone = replace(one, road=np.zeros_like(one.road), forces=own, from_rest=True)
    delays = of.residuals.delays(of.x, one)
    return LogPrediction(alone, of.problem.predictions[i].changed)(of.values, {}, None, delays, False).values


def _by_parameter(of: Estimate, name: str) -> list[Array]:
    """Returns the derivative of all signals with respect to a parameter that may be zero."""
    value = of.problem.vehicle.parameters.get(name, 0.0)
    step, each = max(1.0, 1e-3 * value), list[Array]()
    for i, one in enumerate(of.problem.predictions):
        first = of.residuals.start(of.x, i)
        delays = of.residuals.delays(of.x, one.experiment)
        moved = [one({**of.values, name: value + more}, {}, first, delays, False).values for more in (step, 0.0)]
        each.append((moved[0] - moved[1]) / step)
    return each


def resonances(of: Estimate) -> list[str]:
    """Returns remarks on resonances that appear in the residuals of signals."""
    remarks = list[str]()
    for one, difference, tests in zip(of.problem.experiments, of.differences, of.whiteness, strict=True):
        for i, name in enumerate(one.signals):
            if tests[name].white:
                continue
            poles = np.roots(autoregressive(difference[:, i] / of.noise[name]).coefficients)
            for pole in sorted(poles, key=lambda pole: -abs(pole))[:1]:
                frequency = abs(float(np.angle(pole))) / (2 * np.pi * one.step)
                if abs(pole) > SHARP and 0.05 < frequency * one.step < 0.45:
                    remarks.append(f"the residuals of {name} oscillate at {brief(frequency)} Hz, but the vehicle model does not")
    return remarks


def airborne(of: Estimate) -> list[tuple[int, Array]]:
    """Returns the index of each experiment in which a wheel leaves the ground, with an array that is True for samples in the
    air.
    """
    each = list[tuple[int, Array]]()
    for i, one in enumerate(of.problem.predictions):
        if one.experiment.hubs or one.experiment.part:
            continue
        vehicle = one.vehicle(of.values)
        limits = vehicle.kind.static_tyre_deflection(vehicle.parameters)
        names = [name for name in limits if name in vehicle.linear_model.outputs]
        values = one.signals(names, of.values, of.residuals.start(of.x, i))
        air = np.asarray((values > [abs(limits[name]) for name in names]).any(axis=1))
        if air.any():
            each.append((i, air))
    return each
