"""Signals of a vehicle over a measured road, and the signals' derivatives with respect to the parameters.

A vehicle with linear springs and dampers has the equations

    x' = A x + Bv v + Bd v',    y = C x + Dv v + Dd v',

where v contains the road heights and control forces. Heights and forces are interpolated linearly between samples, so that a
matrix exponential for [x; v; v'] gives the exact state at the next sample. The matrix exponential also gives the measurements
of a delayed sensor at any time between two samples.

The matrices of a step between samples are differentiated by central differences. With the derivatives of the matrices, the
recursion that computes the response also gives the derivatives of the response. The relative error of the response derivatives
is about 1e-10, as for the matrices, and does not grow with the length of the log.

A vehicle with force elements or tables is integrated by RK4 (`sim.linear.stepped`). For a vehicle with force elements or
tables, the derivatives are finite differences of responses.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from models.common.arrays import Array, recursion
from models.common.errors import InputError
from models.vehicle.vehicle import Vehicle
from sim.studies.identification.experiment import Channel, Experiment

DIFFERENCE = 1e-5  # relative step of finite differences of matrices; the relative error is about the square of the step
STEPPED_DIFFERENCE = 1e-4  # relative step of finite differences of responses
HUB, TYRE = "unsprung_velocity", "tyre_deflection"


@dataclass(frozen=True, eq=False)
class PredictedSignals:
    """Predicted measurements of an experiment with q channels, and their derivatives.

    Attributes:
        values: predicted measurements, shape (T, q); NaN before the first sample that a delayed sensor can measure.
        by_parameter: derivatives of the measurements with respect to p parameters, per SI unit, shape (p, T, q).
        by_start: derivatives of the measurements with respect to the n components of the starting state, shape (n, T, q); n = 0
            for a known state.
        by_delay: derivative of each channel's measurements with respect to the delay of its sensor, shape (T, q).
    """

    values: Array
    by_parameter: Array
    by_start: Array
    by_delay: Array


@dataclass(frozen=True, eq=False)
class _Step:
    """Matrices of a step, x[k+1] = Phi x[k] + Gamma [v; v'], and rows that multiply [x; v; v'] to give the channels and their
    rates.
    """

    Phi: Array
    Gamma: Array
    rows: Array
    rates: Array

    def __sub__(self, other: "_Step") -> "_Step":
        return _Step(*(getattr(self, name) - getattr(other, name) for name in ("Phi", "Gamma", "rows", "rates")))

    def __truediv__(self, number: float) -> "_Step":
        return _Step(self.Phi / number, self.Gamma / number, self.rows / number, self.rates / number)


class LogPrediction:
    """Predicts an experiment's signals for any parameter values.

    Args:
        experiment: experiment whose signals are predicted.
        vehicle: function that returns the vehicle for a set of parameter values, by name.
    """

    def __init__(self, experiment: Experiment, vehicle: Callable[[Mapping[str, float]], Vehicle]) -> None:
        self.experiment = experiment
        self.changed = vehicle

    def vehicle(self, values: Mapping[str, float]) -> Vehicle:
        """Returns the vehicle of this experiment, including the payload."""
        one = self.changed(values)
        return one.altered({name: one.parameters[name] + more for name, more in self.experiment.added.items()})

    @cached_property
    def _inputs(self) -> tuple[Array, Array]:
        """Inputs and their rates, over the step after each sample and at each sample, as two arrays of shape (T, 2 v).

        The rate at a sample is the mean of the rates over the steps before and after this sample. The mean is equal to the true
        rate if the road is smooth.
        """
        held = np.hstack([self.experiment.road, self.experiment.forces])
        rates = np.diff(held, axis=0, append=held[-1:]) / self.experiment.step
        at_samples = np.hstack([held, (rates + np.vstack([rates[:1], rates[:-1]])) / 2])
        wheels = self.experiment.road.shape[1]
        if self.experiment.forces_held:
            rates[:, wheels:] = 0.0
        # accelerations are smooth, so each straight line is shifted to the mean of a cubic through the samples
        if self.experiment.hubs:
            whole = padded(held[:, :wheels])
            held[:, :wheels] += (whole[1:-2] + whole[2:-1] - whole[:-3] - whole[3:]) / 24
        if self.experiment.road_held:
            held[:, :wheels] = midpoints(held[:, :wheels])
            rates[:, :wheels] = 0.0
        return np.hstack([held, rates]), at_samples

    def states(self, values: Mapping[str, float]) -> tuple[str, ...]:
        """Returns the names of the components of the starting state, if this state is unknown."""
        names = self.vehicle(values).linear_model.states
        return tuple(name for name in names if not (self.experiment.hubs and name.startswith(TYRE)))

    def __call__(
        self,
        values: Mapping[str, float],
        free: Mapping[str, float],
        start: Array | None,
        delays: Sequence[float],
        derivatives: bool = True,
    ) -> PredictedSignals:
        """Returns predicted signals.

        Args:
            values: values of all parameters [SI], by name.
            free: names of the p parameters with respect to which the signals are differentiated, each with its typical size.
            start: state of the vehicle at the first sample, shape (n,); None for equilibrium.
            delays: sensor delay of each channel [s].
            derivatives: False if derivatives are not needed; in this case, the result contains empty or zero derivatives.
        """
        if self.vehicle(values).parts.nonlinear:
            return self._stepped(values, free, start, delays, derivatives)
        step = self._step(values, delays)
        n, (inputs, _) = len(step.Phi), self._inputs
        first = np.zeros(n) if start is None else start
        x = recursion(step.Phi, inputs @ step.Gamma.T, first)
        value = self._read(step.rows, x, delays)
        none = np.zeros((0, *value.shape))
        if not derivatives:
            return PredictedSignals(value, none, none, np.zeros_like(value))
        by_parameter, by_start = np.zeros((len(free), *value.shape)), none
        for i, (name, size) in enumerate(free.items()):
            one = self._by_parameter(values, name, size, delays)
            dx = recursion(step.Phi, x @ one.Phi.T + inputs @ one.Gamma.T)
            by_parameter[i] = self._read(one.rows, x, delays) + self._read(step.rows, dx, delays, False)
        if start is not None:
            by_start = np.zeros((n, *value.shape))
            for i in range(n):  # computes the response to each initial state without input
                free_motion = recursion(step.Phi, np.zeros_like(x), np.eye(n)[i])
                by_start[i] = self._read(step.rows, free_motion, delays, False)
        return PredictedSignals(value, by_parameter, by_start, -self._read(step.rates, x, delays))

    def signals(self, names: Sequence[str], values: Mapping[str, float], start: Array | None) -> Array:
        """Returns the named signals of the vehicle at the samples, without sensor delay, shape (T, len(names))."""
        channels = tuple(Channel(name, np.zeros(len(self.experiment.road))) for name in names)
        other = LogPrediction(replace(self.experiment, channels=channels), self.changed)
        return other(values, {}, start, [0.0] * len(names), False).values

    def _read(self, rows: Array, x: Array, delays: Sequence[float], driven: bool = True) -> Array:
        """Returns the measurement of each channel at each sample, computed from [x; v; v'] at the last sample before the
        delayed time.

        Args:
            rows: matrix whose rows, one for each channel, multiply [x; v; v'], shape (q, n + 2 v).
            x: states of the vehicle at the samples, shape (T, n).
            driven: False if no inputs act on the vehicle.
        """
        h, n, values = self.experiment.step, x.shape[1], np.empty((len(x), len(rows)))
        for i, (row, delay) in enumerate(zip(rows, delays, strict=True)):
            before = math.ceil(delay / h - 1e-9)
            column = x @ row[:n]
            if driven:
                column += self._inputs[abs(before * h - delay) <= 1e-9 * h] @ row[n:]
            values[:before, i], values[before:, i] = np.nan, column[: len(column) - before]
        return values

    def _step(self, values: Mapping[str, float], delays: Sequence[float]) -> _Step:
        A, Bv, Bd, C, Dv, Dd = continuous_model(self.vehicle(values), self.experiment)
        n, v, h = len(A), Bv.shape[1], self.experiment.step
        M = np.zeros((n + 2 * v, n + 2 * v))
        M[:n] = np.hstack([A, Bv, Bd])
        M[n : n + v, n + v :] = np.eye(v)
        whole, direct = linalg.expm(M * h), np.hstack([C, Dv, Dd])
        rows, rates = np.empty_like(direct), np.empty_like(direct)
        for i, delay in enumerate(delays):
            # time from the last sample before the delayed time to the delayed time
            within = math.ceil(delay / h - 1e-9) * h - delay
            at = linalg.expm(M * within) if within > 1e-9 * h else np.eye(len(M))
            rows[i] = direct[i] @ at
            rates[i] = direct[i] @ M @ at
        return _Step(whole[:n, :n], whole[:n, n:], rows, rates)

    def _by_parameter(self, values: Mapping[str, float], name: str, size: float, delays: Sequence[float]) -> _Step:
        ahead, behind = _both_sides(values, name, DIFFERENCE * size)
        return (self._step(ahead, delays) - self._step(behind, delays)) / (ahead[name] - behind[name])

    def _stepped(
        self,
        values: Mapping[str, float],
        free: Mapping[str, float],
        start: Array | None,
        delays: Sequence[float],
        derivatives: bool,
    ) -> PredictedSignals:
        value = self._stepped_signals(values, start, delays)
        empty = np.zeros((0, *value.shape))
        if not derivatives:
            return PredictedSignals(value, empty, empty, np.zeros_like(value))
        by_parameter = list[Array]()
        for name, size in free.items():
            ahead, behind = _both_sides(values, name, STEPPED_DIFFERENCE * size)
            moved = [self._stepped_signals(one, start, delays) for one in (ahead, behind)]
            by_parameter.append((moved[0] - moved[1]) / (ahead[name] - behind[name]))
        by_start = []
        if start is not None:
            scales = 1e-3 * np.maximum(
                np.abs(start), np.where([HUB in s or "velocity" in s for s in self.states(values)], 0.1, 0.01)
            )
            for i, scale in enumerate(scales):
                moved = [np.where(np.arange(len(start)) == i, start + sign * scale, start) for sign in (1, -1)]
                ahead, behind = (self._stepped_signals(values, one, delays) for one in moved)
                by_start.append((ahead - behind) / (2 * scale))
        rate = np.gradient(value, self.experiment.step, axis=0)
        return PredictedSignals(
            value, np.stack(by_parameter) if free else empty, np.stack(by_start) if by_start else empty, -rate
        )

    def _stepped_signals(self, values: Mapping[str, float], start: Array | None, delays: Sequence[float]) -> Array:
        from models.roads.rig import Rig
        from models.roads.road import RoadInput
        from sim.linear.stepped import forced_run

        one, vehicle = self.experiment, self.vehicle(values)
        if one.hubs:
            raise InputError(
                "an estimate with an unknown road needs linear springs and dampers; give the road, or a vehicle with "
                "linear springs and dampers"
            )
        posts = tuple(wheel.road_displacement for wheel in vehicle.kind.wheels)
        if start is not None:
            vehicle = replace(vehicle, start=dict(zip(vehicle.linear_model.states, start.tolist(), strict=True)))
        time = one.step * np.arange(len(one.road))
        road = RoadInput(vehicle, Rig(time, one.road, posts), time)
        response = forced_run(one.forces, road).response
        each = [response[name][0] for name in one.signals]
        for i, delay in enumerate(delays):
            if delay:
                each[i] = np.interp(time - delay, time, each[i], left=np.nan)
        return np.stack(each, axis=-1)


def padded(values: Array) -> Array:
    """Returns the input values with one additional sample before and two after, by point reflection at both ends, shape (T + 3,
    r).
    """
    return np.pad(values, ((1, 2), (0, 0)), mode="reflect", reflect_type="odd")


def midpoints(values: Array) -> Array:
    """Returns the input values halfway to the next sample, by cubics through four samples, shape (T, r); the last value is
    unchanged.
    """
    whole = padded(values)
    middle = (9 * (whole[1:-2] + whole[2:-1]) - whole[:-3] - whole[3:]) / 16
    return np.vstack([middle[:-1], values[-1:]])


def _both_sides(values: Mapping[str, float], name: str, step: float) -> tuple[dict[str, float], dict[str, float]]:
    """Returns two sets of parameter values. In the first set, one parameter is larger by a step. In the second set, this
    parameter is smaller by a step, but not below zero.
    """
    return {**values, name: values[name] + step}, {**values, name: max(values[name] - step, 0.0)}


def continuous_model(vehicle: Vehicle, experiment: Experiment) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Returns the matrices A, Bv, Bd, C, Dv and Dd of an experiment, which the module docstring defines.

    If the road is unknown, the inputs are hub accelerations instead of road heights, and the tyres are not part of the model.

    Raises:
        InputError: the road is unknown, but an inerter couples the hubs with the body.
    """
    model = vehicle.linear_model
    rows = [model.outputs.index(name) for name in experiment.signals]
    r, m = len(model.disturbances), len(model.inputs)
    Bv, Bd = np.hstack([model.Br, model.B]), np.hstack([model.Bw, np.zeros((len(model.A), m))])
    C, Dv, Dd = model.C[rows], np.hstack([model.Cr, model.D])[rows], np.hstack([model.Dw, np.zeros((len(model.C), m))])[rows]
    if experiment.road_held:  # if the road height jumps, the states are replaced by x - Bd v, which do not jump
        return model.A, Bv + model.A @ Bd, np.zeros_like(Bd), C, Dv + C @ Bd, Dd
    if not experiment.hubs:
        return model.A, Bv, Bd, C, Dv, Dd
    if vehicle.inertial:
        raise InputError(
            "an estimate with an unknown road is not possible for a vehicle with an inerter; give the heights of the road"
        )
    hubs = [i for i, name in enumerate(model.states) if name.startswith(HUB)]
    kept = [i for i, name in enumerate(model.states) if not name.startswith(TYRE)]
    A, B = model.A.copy(), np.hstack([np.zeros((len(model.A), r)), model.B])
    A[hubs], B[hubs] = 0.0, 0.0
    B[hubs, range(r)] = 1.0
    return A[np.ix_(kept, kept)], B[kept], np.zeros((len(kept), r + m)), C[:, kept], np.hstack([0 * Dv[:, :r], Dv[:, r:]]), 0 * Dd
