"""What the residuals contain, by name: a delay, a factor, a sign, friction, a tyre's damping, lift-off, a resonance.

A cause moves the predicted signals in a known direction g. Its size is the least-squares coefficient of the residuals on the part
of g that the unknowns do not explain, and the share of the residuals' squares that it explains says how much of a misfit it is.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from models.common.arrays import Array, recursion
from models.common.errors import InputError
from models.vehicle.vehicle import Vehicle
from sim.studies.identification.estimate import Estimate, IdentificationProblem
from sim.studies.identification.experiment import Channel
from sim.studies.identification.prediction import Prediction, continuous_model
from sim.studies.identification.whiteness import autoregressive

FACTORS: Mapping[float, str] = {
    1000.0: "in thousandths of its unit, such as mm",
    0.001: "in thousands of its unit, such as km",
    1 / 9.80665: "in g instead of m/s2",
    9.80665: "in m/s2 although its unit says g",
    57.29577951308232: "in degrees",
    39.37007874015748: "in inches",
    100.0: "in hundredths of its unit, such as cm",
}
NEAR = 0.2  # relative: a factor this near to one of these has a name
ALIKE = 0.8  # correlation from which a column is a signal but for its factor
EXPLAINED = 0.03  # share of the squares from which a cause is named
SURE = 5.0  # standard deviations from which it is
SHARP = 0.9  # magnitude of a pole of the residuals' model that is a resonance


@dataclass(frozen=True)
class Cause:
    """A cause of a misfit.

    Attributes:
        words: the cause and its size.
        share: share of the squares of all residuals that it explains.
        deviations: its size in standard deviations.
    """

    words: str
    share: float
    deviations: float


FULL = 0.01  # of the largest speed: below it friction is a straight line, so that noise has none


def check_columns(problem: IdentificationProblem) -> list[str]:
    """Compares the columns with the first vehicle before anything is fitted; returns remarks.

    Raises:
        InputError: a column is a signal with another unit, or with the opposite sign.
    """
    remarks = list[str]()
    for one, prediction in zip(problem.experiments, problem.predictions, strict=True):
        start = None if one.from_rest else np.zeros(len(prediction.states(problem.first)))
        delays = [channel.delay for channel in one.channels]
        predicted = prediction(problem.first, {}, start, delays, False).values
        correlations = np.array([[_correlation(channel.values, column) for column in predicted.T] for channel in one.channels])
        units = [problem.vehicle.kind.possible[channel.signal].unit for channel in one.channels]
        for i, channel in enumerate(one.channels):
            own, both = correlations[i, i], channel.counted & np.isfinite(predicted[:, i])
            ratio = float(channel.values[both].std() / max(predicted[both, i].std(), 1e-300)) if both.any() else 1.0
            named = next((words for factor, words in FACTORS.items() if abs(ratio / factor - 1) < NEAR), "")
            if own > ALIKE and named:
                raise InputError(
                    f"{one.name}: {channel.signal} is {ratio:.4g} times what this vehicle would do; the column seems to be "
                    f"{named}: write its unit in the map"
                )
            if own < -ALIKE:
                raise InputError(
                    f"{one.name}: {channel.signal} has the opposite sign of what this vehicle would do (correlation {own:.2f}); "
                    f"write sign = -1 below [signals.{channel.signal}] in the map"
                )
            others = [j for j in range(len(units)) if j != i and units[j] == units[i]]
            for j in others:
                if j > i and min(correlations[i, j], correlations[j, i]) > max(ALIKE, own + 0.1, correlations[j, j] + 0.1):
                    remarks.append(f"{one.name}: the columns of {channel.signal} and {one.channels[j].signal} seem to be swapped")
    return remarks


def _correlation(a: Array, b: Array) -> float:
    both = np.isfinite(a) & np.isfinite(b)
    if both.sum() < 3 or not a[both].std() or not b[both].std():
        return 0.0
    return float(np.corrcoef(a[both], b[both])[0, 1])


def causes(of: Estimate) -> tuple[Cause, ...]:
    """Returns the causes that the residuals contain, the largest first; those of white residuals are none."""
    if of.white:
        return ()
    residuals, J = of.residuals.residuals(of.x, of.noise), of.residuals.jacobian(of.x, of.noise)
    Q, _ = np.linalg.qr(J)
    own = residuals - Q @ (Q.T @ residuals)
    total, found = float(own @ own), list[Cause]()
    for words, unit, scale, direction in _directions(of):
        g = direction - Q @ (Q.T @ direction)
        size = float(g @ g)
        if not size > 1e-12 * float(direction @ direction):
            continue
        coefficient = -float(g @ own) / size
        share = coefficient**2 * size / total
        deviations = abs(coefficient) * np.sqrt(size) / np.sqrt(total * (1 - share) / len(own))
        if share >= EXPLAINED and deviations >= SURE:
            found.append(Cause(words.format(f"{scale * coefficient:.3g} {unit}".strip()), share, deviations))
    return tuple(sorted(found, key=lambda one: -one.share))


def _directions(of: Estimate) -> Iterator[tuple[str, str, float, Array]]:
    """Yields the words of causes, the unit and scale of their size, and how they move all residuals."""
    experiments, problem = of.problem.experiments, of.problem
    for signal in problem.signals:
        rows = [np.zeros_like(one) for one in of.predicted]
        gains = [np.zeros_like(one) for one in of.predicted]
        for k, (one, predicted) in enumerate(zip(experiments, of.predicted, strict=True)):
            if signal in one.signals:
                i = one.signals.index(signal)
                rows[k][:, i] = -np.gradient(np.nan_to_num(predicted[:, i]), one.step)
                gains[k][:, i] = predicted[:, i] - np.nanmean(predicted[:, i])
        if signal not in problem.delayed:
            yield f"{signal} is later by {{}} than in the map", "ms", 1e3, _weighted(of, rows)
        yield f"{signal} is larger by {{}} than its unit says", "%", 100.0, _weighted(of, gains)
    vehicles = [one.vehicle(of.values) for one in problem.predictions]
    for place in vehicles[0].kind.suspensions:
        pushed = [_friction(one, vehicle, place.force) for one, vehicle in zip(problem.predictions, vehicles, strict=True)]
        yield f"friction of {{}} in the suspension{place.ending.replace('_', ' ')}", "N", 1.0, _weighted(of, pushed)
    parameters = {one.name for one in problem.vehicle.kind.parameters}
    for name in sorted(one for one in parameters if one.startswith("tyre_damping")):
        if name not in of.free and not problem.vehicle.parts.nonlinear:
            yield f"{name} of {{}} more than in the file", "N s/m", 1.0, _weighted(of, _by_parameter(of, name))


def _weighted(of: Estimate, moved: list[Array]) -> Array:
    rows = []
    for one, each, difference in zip(of.problem.experiments, moved, of.differences, strict=True):
        rows.append((np.nan_to_num(each) / [of.noise[name] for name in one.signals])[np.isfinite(difference)])
    return np.concatenate([*rows, np.zeros(len(of.problem.known))])


def _friction(prediction: Prediction, vehicle: Vehicle, force: str) -> Array:
    """Returns the signals under 1 N of friction in a suspension, shape (T, q)."""
    one, model = prediction.experiment, vehicle.linear_model
    deflection = vehicle.kind.deflection_of(force)
    from dataclasses import replace

    from sim.studies.identification.experiment import Channel

    alone = Prediction(replace(one, channels=(Channel(deflection, np.zeros(len(one.road))),)), lambda _: vehicle)
    travel = alone({}, {}, None if one.from_rest else np.zeros(len(alone.states({}))), [0.0], False).values[:, 0]
    speed = np.gradient(travel, one.step)
    # The force pulls the ends together as they move apart.
    pull = np.clip(speed / max(FULL * float(np.abs(speed).max()), 1e-12), -1.0, 1.0)
    A, Bv, _, C, Dv, _ = continuous_model(vehicle, one)
    column = one.road.shape[1] + model.inputs.index(force)
    n = len(A)
    M = np.zeros((n + 1, n + 1))
    M[:n, :n], M[:n, n] = A, Bv[:, column]
    whole = linalg.expm(M * one.step)
    x = recursion(whole[:n, :n], np.outer(-pull, whole[:n, n]))
    return x @ C.T + np.outer(-pull, Dv[:, column])


def _by_parameter(of: Estimate, name: str) -> list[Array]:
    """Returns the derivative of all signals by a parameter that may be zero."""
    value = of.problem.vehicle.parameters[name]
    step, each = max(1.0, 1e-3 * value), list[Array]()
    for i, one in enumerate(of.problem.predictions):
        start, _ = of.residuals.unknowns.of_experiment(i)
        first = of.x[start] if of.residuals.unknowns.starts[i] else None
        delays = of.residuals.delays(of.x, one.experiment)
        moved = [one({**of.values, name: value + more}, {}, first, delays, False).values for more in (step, 0.0)]
        each.append((moved[0] - moved[1]) / step)
    return each


def resonances(of: Estimate) -> list[str]:
    """Returns remarks on resonances that the residuals of a signal contain."""
    remarks = list[str]()
    for one, difference, tests in zip(of.problem.experiments, of.differences, of.whiteness, strict=True):
        for i, name in enumerate(one.signals):
            if tests[name].white:
                continue
            poles = np.roots(autoregressive(difference[:, i] / of.noise[name]).coefficients)
            for pole in sorted(poles, key=lambda pole: -abs(pole))[:1]:
                frequency = abs(float(np.angle(pole))) / (2 * np.pi * one.step)
                if abs(pole) > SHARP and 0.05 < frequency * one.step < 0.45:
                    remarks.append(f"the residuals of {name} oscillate at {frequency:.3g} Hz: a resonance that the vehicle lacks")
    return remarks


def airborne(of: Estimate) -> list[tuple[int, Array]]:
    """Returns the experiments in which a wheel leaves the road, by number, with True for the samples in the air."""
    each = list[tuple[int, Array]]()
    for i, one in enumerate(of.problem.predictions):
        if one.experiment.hubs:
            continue
        vehicle = one.vehicle(of.values)
        limits = vehicle.kind.static_tyre_deflection(vehicle.parameters)
        names = [name for name in limits if name in vehicle.linear_model.outputs]
        channels = tuple(Channel(name, np.zeros(len(one.experiment.road))) for name in names)
        alone = Prediction(replace(one.experiment, channels=channels), lambda _, vehicle=vehicle: vehicle)
        start, _ = of.residuals.unknowns.of_experiment(i)
        first = of.x[start] if of.residuals.unknowns.starts[i] else None
        if first is not None and not len(first):
            first = None
        values = alone({}, {}, first, [0.0] * len(names), False).values
        air = np.asarray((values > [abs(limits[name]) for name in names]).any(axis=1))
        if air.any():
            each.append((i, air))
    return each
