"""Frequency responses and L2 gains measured in MuJoCo, compared with linear analysis.

In gains a weight that is a filter goes over the run from rest, on the straight lines between samples. Where the road has a
filter, too, w is what comes in there; of a sinusoid it is known, and of another road it would take the inverse of the filter,
which may not be.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.checks import AT_LEAST_ONE, Length, PositiveSpeed, Time
from models.common.errors import InputError
from models.laws.filter import Filter
from models.roads.sinusoids import chirp
from models.roads.spectrum import as_met
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.drive.regime import ended_by
from sim.drive.response import SILENT, Response, loudest_alike
from sim.linear.frequency_response import continuous_frequency_response, sampled_frequency_response
from sim.linear.sampled_response import taylor4
from sim.runs.run import sample_times
from sim.studies.frequency.sinusoids import HIGHEST, PeriodicRoad, chirp_lines, drive_periodic
from synth.controller.controller import Controller, check_fits
from synth.controller.loop_of import loop_of, radius


def l2_gain(vehicle: Vehicle, response: Response) -> float | None:
    """Returns ||z|| / ||w|| of a run from rest, over time and wheels, or None if the road has a filter, so that w is unknown."""
    if vehicle.road_filter is not None:
        return None
    period = float(response.time[1] - response.time[0])
    z = [_weighted_outputs(vehicle, side, period) for side in _sides(vehicle, response, periodic=False)]
    return _size(z) / _road_size(vehicle, response)


def settled_gain(vehicle: Vehicle, response: Response, omega: float) -> float:
    """The same of whole periods of a sinusoid, once all else has decayed.

    Args:
        response: response over an integer number of periods.
        omega: frequency of the road [rad/s].
    """
    sides, shape = _sides(vehicle, response, periodic=True), 1.0
    count, period = len(response.time), float(response.time[1] - response.time[0])
    if vehicle.filtered:
        weights = vehicle.weights(2 * np.pi * np.fft.rfftfreq(count, period))
        z = [np.fft.irfft(weights * np.fft.rfft(side, axis=0), count, axis=0) for side in sides]
        shape = np.abs(vehicle.road_shape(np.array([omega]))[0])
    else:
        z = [_weighted_outputs(vehicle, side, period) for side in sides]
    return float(shape * _size(z) / _road_size(vehicle, response))


def _sides(vehicle: Vehicle, response: Response, periodic: bool) -> list[Array]:
    """Returns the output signals and sums, and again as they are before leaps if a force is held over several steps."""
    signals, period = _signals(vehicle, response), float(response.time[1] - response.time[0])
    several = steps_per_sample(vehicle.implementation, period) > 1  # between leaps there are steps, over which z goes on
    return [signals, _before_leaps(vehicle, response, signals, periodic)] if several else [signals]


def _size(sides: Sequence[Array]) -> float:
    """Returns the root mean square of the norms of z on the sides of its leaps."""
    return float(np.linalg.norm([np.linalg.norm(z) for z in sides])) / math.sqrt(len(sides))


def _before_leaps(vehicle: Vehicle, response: Response, signals: Array, periodic: bool) -> Array:
    """Returns the output signals and sums as they are before the forces of each sample replace those of the one before, shape
    (T, p); before the first sample are those of the last in periods, and none otherwise. Behind a lag they are the same.
    """
    if vehicle.limits.actuator_bandwidth is not None:
        return signals
    forces = _columns(response, vehicle.linear_model.inputs)
    before = forces[-1:] if periodic else np.zeros((1, forces.shape[1]))
    return signals - np.diff(forces, axis=0, prepend=before) @ vehicle.summed(vehicle.linear_model.D, axis=0).T


def _weighted_outputs(vehicle: Vehicle, signals: Array, period: float) -> Array:
    """Returns z for the output signals and sums, shape (T, p) both."""
    weighted = [(vehicle.performance.get(name, 0.0), vehicle.filters.get(name)) for name in vehicle.linear_model.outputs]
    weighted += [(one.weight, one.filter) for one in vehicle.sums]
    rows = [
        weight * (_filter_signal(one, values, period) if one is not None else values)
        for (weight, one), values in zip(weighted, signals.T, strict=True)
    ]
    return np.stack(rows, axis=-1)


def _signals(vehicle: Vehicle, response: Response) -> Array:
    """Returns the output signals of a run and the sums in z, shape (T, p)."""
    return vehicle.summed(_columns(response, vehicle.linear_model.outputs))


def _columns(response: Response, names: Iterable[str]) -> Array:
    """Returns some signals of a run, shape (T, number of them)."""
    return np.stack([response[name] for name in names], axis=-1)


def _road_size(vehicle: Vehicle, response: Response) -> float:
    """Returns the norm of the road's velocity under all wheels."""
    return float(np.linalg.norm(_columns(response, [wheel.road_velocity for wheel in vehicle.kind.wheels])))


def _filter_signal(one: Filter, values: Array, period: float) -> Array:
    """Returns a signal through a filter, from rest."""
    law = one.realisation.sampled(period)
    from scipy.signal import dlsim  # half a second

    return dlsim((law.A, law.B, law.C, law.D, period), values[:, None])[1][:, 0]


Controllers = Annotated[Sequence[Controller], AT_LEAST_ONE]
LINES = 60  # of the chirp, see `chirp_lines`


@dataclass(frozen=True, eq=False)
class Lines:
    """Frequency response of one controller, per road velocity under the first wheel.

    Attributes:
        controller: the controller.
        outputs: names of the p output signals.
        units: units of the signals.
        omega: lines [rad/s], shape (F,).
        measured: gains measured in MuJoCo, complex, shape (F, p).
        sampled: gains of the implemented (sampled-data) loop, exact.
        integrated: gains of the loop that RK4 integrates.
        continuous: gains of the continuous loop, exact.
        order: power of the timestep with which sampled tends to continuous; NaN if there is a delay or sample period.
        gain: L2 gain of the run, from w to z, or None if the road has a filter (`sim.studies.frequency.identification`).
        ended: ends of the linear regime.
    """

    controller: Controller
    outputs: tuple[str, ...]
    units: tuple[str, ...]
    omega: Array
    measured: Array
    sampled: Array
    integrated: Array
    continuous: Array
    order: float
    gain: float | None
    ended: tuple[str, ...]

    def error(self, reference: Array) -> Array:
        """Largest difference over the lines between measured and a reference, relative at each line, shape (p,)."""
        return difference(self.measured, reference, self.units).max(axis=0)


def difference(response: Array, reference: Array, units: Sequence[str]) -> Array:
    """Relative difference at every line, shape (F, p). A signal that symmetry keeps silent counts as `Response.scale` says."""
    size = np.abs(reference)
    scale = np.maximum(size, SILENT * loudest_alike(size, units))
    apart = np.abs(response - reference)
    return np.divide(apart, scale, out=np.where(apart > 0, np.inf, 0.0), where=scale > 0)


def ideal_measurements(vehicle: Vehicle) -> Vehicle:
    """The vehicle from rest, without noise and quantisation of `[implementation]`, which have no frequency response."""
    return replace(vehicle.starting(), implementation=vehicle.implementation.without_noise)


def measure_responses(
    vehicle: Vehicle, controllers: Controllers, amplitude: Length, timestep: Time, speed: PositiveSpeed
) -> list[Lines]:
    """Returns the frequency responses of controllers in MuJoCo, each from the last period of a repeated chirp.

    Args:
        amplitude: largest height of the road [m].
        timestep: step of the integration [s].
        speed: forward velocity [m/s]; it matters only to vehicles with several axles.

    Raises:
        InputError: a timestep too coarse for the highest line, an amplitude that is not allowed, a loop that is unstable.

    Example:
        >>> from models import read_vehicle
        >>> from sim import measure_responses
        >>> from synth import design_controllers
        >>> vehicle = read_vehicle("quarter_car")
        >>> [lines] = measure_responses(vehicle, design_controllers(vehicle, ["I"]), amplitude=1e-3, timestep=4e-3, speed=12.5)
        >>> lines.omega.shape
        (44,)
    """
    check(vehicle, controllers, amplitude, timestep)
    vehicle = ideal_measurements(vehicle)
    omega, period = chirp_lines(vehicle, timestep, LINES)
    road = chirp(omega, period * timestep, speed).to_height(amplitude, np.arange(period, 2 * period) * timestep)
    runs = drive_periodic(vehicle, controllers, [PeriodicRoad(road, omega, period)] * len(controllers), timestep)

    inputs, outputs = as_met(vehicle, omega, speed)[..., None], vehicle.linear_model.outputs
    units = tuple(vehicle.kind.signal(name).unit for name in outputs)
    identified = []
    for controller, run in zip(controllers, runs, strict=True):
        sampled, half, integrated = (
            (sampled_frequency_response(vehicle, controller, omega, step, exponential) @ inputs)[..., 0]
            for step, exponential in ((timestep, linalg.expm), (timestep / 2, linalg.expm), (timestep, taylor4))
        )
        continuous = (continuous_frequency_response(vehicle, controller, omega) @ inputs)[..., 0]
        far, near = (difference(one, continuous, units).max() for one in (sampled, half))
        lines = run.lines()
        driven = lines[vehicle.kind.wheels[0].road_velocity]
        measured = np.stack([lines[name] for name in outputs], axis=-1) / driven[:, None]
        gain, ended = l2_gain(vehicle, run.response), ended_by(vehicle, run.response, controller.has_anti_windup)
        order = math.log2(far / near) if vehicle.implementation.ideal else math.nan
        identified.append(Lines(controller, outputs, units, omega, measured, sampled, integrated, continuous, order, gain, ended))
    return identified


def check(vehicle: Vehicle, controllers: Sequence[Controller], amplitude: float, timestep: float) -> None:
    """Checks that these can be identified; raises InputError otherwise."""
    check_fits(vehicle, *controllers)
    sample_times(vehicle, 1.0, timestep)
    if timestep > 0.25 / HIGHEST:
        raise InputError(f"timestep = {timestep:g} s is too coarse for {HIGHEST:g} Hz; give at most {0.25 / HIGHEST:g} s")
    if not 1e-6 <= amplitude <= 1:
        raise InputError(f"amplitude = {amplitude:g} m is not allowed; give a number from 1e-06 to 1 m")
    for controller in controllers:
        growth = radius(loop_of(vehicle, controller, timestep))
        if growth >= 1:
            raise InputError(
                f"the loop with controller {controller.name!r} has no frequency response, because its motion does not decay (a "
                f"timestep multiplies it by {growth:.6g}); give another controller, or a smaller timestep"
            )
