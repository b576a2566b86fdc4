"""How much of a road a run lets through: L2 gains from the disturbance w to the controlled output z of the vehicle file.

A weight that is a filter goes over the run from rest, on the straight lines between samples. Where the road has a filter, too, w
is what comes in there; of a sinusoid it is known, and of another road it would take the inverse of the filter, which may not be.
"""

import math

import numpy as np

from models.common.arrays import Array
from models.filters.filter import Filter
from models.law import LinearLaw
from models.reality import steps_per_sample
from models.vehicle import Vehicle
from sim.response.response import Response


def l2_gain(vehicle: Vehicle, response: Response) -> float | None:
    """||z|| / ||w|| of a run from rest, both over time and wheels; None where the road has a filter, so that w is not known."""
    if vehicle.road_filter is not None:
        return None
    period = float(response.time[1] - response.time[0])
    signals = np.stack([response[name] for name in vehicle.linear_model.outputs], axis=-1)
    sides = [signals]
    if steps_per_sample(vehicle.implementation, period) > 1:  # between leaps there are steps, over which z goes on
        forces = np.stack([response[name] for name in vehicle.linear_model.inputs], axis=-1)
        leaps = np.diff(forces, axis=0, prepend=np.zeros((1, forces.shape[1]))) @ _at_once(vehicle).T
        sides = beside_leaps(vehicle, signals, signals - leaps)
    sizes = [np.linalg.norm(_weighted(vehicle, side, period)) for side in sides]
    size = sizes[0] if len(sizes) == 1 else math.hypot(*sizes) / math.sqrt(2)
    return float(size / np.linalg.norm(_roads(vehicle, response)))


def settled_gain(vehicle: Vehicle, response: Response, omega: float) -> float:
    """The same of whole periods of a sinusoid, once all else has decayed.

    Args:
        vehicle: the vehicle.
        response: some periods and nothing else.
        omega: frequency of the road [rad/s].
    """
    if not vehicle.filtered:
        gain = l2_gain(vehicle, response)
        assert gain is not None, "the road has no filter"
        return gain
    signals = np.stack([response[name] for name in vehicle.linear_model.outputs], axis=-1)
    count, period = len(signals), float(response.time[1] - response.time[0])
    lines = 2 * np.pi * np.fft.rfftfreq(count, period)
    z = np.fft.irfft(vehicle.weights(lines) * np.fft.rfft(signals, axis=0), count, axis=0)
    shape = np.abs(vehicle.road_shape(np.array([omega]))[0])
    return float(shape * np.linalg.norm(z) / np.linalg.norm(_roads(vehicle, response)))


def mean_square(vehicle: Vehicle, response: Response) -> float:
    """Of z over the whole periods of a run's last samples, exact to the square of the step where forces are held.

    Args:
        vehicle: the vehicle.
        response: whole periods and one sample before them, which tells the first leap.
    """
    model = vehicle.linear_model
    signals = np.stack([response[name] for name in model.outputs], axis=-1)
    forces = np.stack([response[name] for name in model.inputs], axis=-1)
    sides = beside_leaps(vehicle, signals[1:], signals[1:] - np.diff(forces, axis=0) @ _at_once(vehicle).T)
    count, period = len(response.time) - 1, float(response.time[1] - response.time[0])
    weights = vehicle.weights(2 * np.pi * np.abs(np.fft.fftfreq(count, period)))
    return float(np.mean([np.sum(np.abs(weights * np.fft.fft(side, axis=0) / count) ** 2) for side in sides]))


def beside_leaps(vehicle: Vehicle, after: Array, before: Array) -> tuple[Array, Array]:
    """Signals on either side of the leaps that they make where forces are replaced, as the mean square of z needs them.

    A filter smooths a leap, and goes over what lies midway; shapes (..., p) of both.
    """
    through = np.array([name in vehicle.filters for name in vehicle.linear_model.outputs])
    midway = (after + before) / 2
    return np.where(through, midway, after), np.where(through, midway, before)


def _weighted(vehicle: Vehicle, signals: Array, period: float) -> Array:
    """z of the output signals, shape (T, p) both."""
    rows = []
    for name, values in zip(vehicle.linear_model.outputs, signals.T, strict=True):
        one = vehicle.filters.get(name)
        rows.append(vehicle.performance.get(name, 0.0) * (_filtered(one, values, period) if one is not None else values))
    return np.stack(rows, axis=-1)


def _at_once(vehicle: Vehicle) -> Array:
    """What the forces that are asked for do at once to the output signals, shape (p, m): nothing behind a lag."""
    D = vehicle.linear_model.D
    return D if vehicle.limits.actuator_bandwidth is None else np.zeros_like(D)


def _roads(vehicle: Vehicle, response: Response) -> Array:
    return np.stack([response[wheel.road_velocity] for wheel in vehicle.kind.wheels], axis=-1)


def _filtered(one: Filter, values: Array, period: float) -> Array:
    """A signal through a filter, from rest."""
    law = LinearLaw(*one.realisation).sampled(period)
    from scipy.signal import dlsim  # half a second

    return dlsim((law.A, law.B, law.C, law.D, period), values[:, None])[1][:, 0]
