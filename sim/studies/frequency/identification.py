"""Measurement of frequency responses and L2 gains in MuJoCo, and comparison with linear analysis.

Start with `measure_responses`. The L2 gain from the disturbance w to the performance output z includes the weights of z. If a
weight is a filter, the filter is applied to the signal of the run. Between samples, the signal is assumed to be linear, and at
the start of the run, the vehicle is assumed to be in equilibrium. If the vehicle file defines a road filter, w is the input of
this filter. The input w is known for a sinusoidal road, but to find w for other roads would require the inverse of the filter,
which may not exist.
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
    """Returns the L2 gain ||z|| / ||w|| of a run that starts from equilibrium; both norms extend over the whole run and all
    wheels.

    Returns None if the road has a filter, because w is then unknown.
    """
    if vehicle.road_filter is not None:
        return None
    period = float(response.time[1] - response.time[0])
    z = [_weighted_outputs(vehicle, side, period) for side in _sides(vehicle, response, periodic=False)]
    return _size(z) / _road_size(vehicle, response)


def settled_gain(vehicle: Vehicle, response: Response, omega: float) -> float:
    """Returns the gain ||z|| / ||w|| of a run over a sinusoidal road, after transients have decayed.

    Args:
        vehicle: vehicle of the run, with the weights of the performance output z.
        response: response of the vehicle over an integer number of periods of the road.
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
    """Returns the output signals, and the sums of signals that are part of the performance output z, shape (T, p). Forces that
    the controller holds over several timesteps jump at each sample.

    If forces are held over several timesteps, the returned list contains two arrays: signals after the jumps, and signals
    before the jumps.
    """
    signals, period = _signals(vehicle, response), float(response.time[1] - response.time[0])
    several = steps_per_sample(vehicle.implementation, period) > 1  # between jumps, z changes continuously from step to step
    return [signals, _before_leaps(vehicle, response, signals, periodic)] if several else [signals]


def _size(sides: Sequence[Array]) -> float:
    """Returns the norm of the performance output z; if the list contains z before and after jumps, the root mean square of both
    norms.
    """
    return float(np.linalg.norm([np.linalg.norm(z) for z in sides])) / math.sqrt(len(sides))


def _before_leaps(vehicle: Vehicle, response: Response, signals: Array, periodic: bool) -> Array:
    """Returns the output signals and sums just before the forces jump at each sample, shape (T, p).

    The force before the first sample counts as 0. In a periodic run, the force before the first sample equals the force at the
    last sample. If the actuators have a lag, forces do not jump, and the function returns the signals unchanged.
    """
    if vehicle.limits.actuator_bandwidth is not None:
        return signals
    forces = _columns(response, vehicle.linear_model.inputs)
    before = forces[-1:] if periodic else np.zeros((1, forces.shape[1]))
    return signals - np.diff(forces, axis=0, prepend=before) @ vehicle.summed(vehicle.linear_model.D, axis=0).T


def _weighted_outputs(vehicle: Vehicle, signals: Array, period: float) -> Array:
    """Returns the performance output z, shape (T, p), computed from the output signals and sums, shape (T, p)."""
    weighted = [(vehicle.performance.get(name, 0.0), vehicle.filters.get(name)) for name in vehicle.linear_model.outputs]
    weighted += [(one.weight, one.filter) for one in vehicle.sums]
    rows = [
        weight * (_filter_signal(one, values, period) if one is not None else values)
        for (weight, one), values in zip(weighted, signals.T, strict=True)
    ]
    return np.stack(rows, axis=-1)


def _signals(vehicle: Vehicle, response: Response) -> Array:
    """Returns the output signals of a run, and the sums of signals that are part of the performance output z, shape (T, p)."""
    return vehicle.summed(_columns(response, vehicle.linear_model.outputs))


def _columns(response: Response, names: Iterable[str]) -> Array:
    """Returns the named signals of a run as columns, shape (T, number of names)."""
    return np.stack([response[name] for name in names], axis=-1)


def _road_size(vehicle: Vehicle, response: Response) -> float:
    """Returns the L2 norm of the road velocity over time and all wheels."""
    return float(np.linalg.norm(_columns(response, [wheel.road_velocity for wheel in vehicle.kind.wheels])))


def _filter_signal(one: Filter, values: Array, period: float) -> Array:
    """Filters a signal and returns the result; the states of the filter are zero at the start. `period` is the time between
    samples [s].
    """
    law = one.realisation.sampled(period)
    from scipy.signal import dlsim  # imported here because the import takes half a second

    return dlsim((law.A, law.B, law.C, law.D, period), values[:, None])[1][:, 0]


Controllers = Annotated[Sequence[Controller], AT_LEAST_ONE]
LINES = 60  # number of frequencies of the chirp, before equal frequencies are merged; see `chirp_lines`


@dataclass(frozen=True, eq=False)
class Lines:
    """Frequency responses of the vehicle with one controller, from the road velocity under the first wheel to all outputs.

    All responses are complex, with a row for each frequency and a column for each output, shape (F, p).

    Attributes:
        controller: controller of the measured loop.
        outputs: names of the p output signals.
        units: units of the output signals.
        omega: frequencies at which the responses are measured [rad/s], shape (F,).
        measured: response that was measured in MuJoCo.
        sampled: exact response of the implemented (sampled-data) loop.
        integrated: response of the implemented loop if its equations of motion are integrated by RK4.
        continuous: exact response of the continuous loop.
        order: order at which `sampled` converges to `continuous` as the timestep decreases; NaN if the loop has a delay or a
            sample period.
        gain: L2 gain of the run from the disturbance w to the performance output z; None if the road has a filter, see
            `l2_gain`.
        ended: names of the limits that ended the linear regime.
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
        """Returns the largest relative difference of each output between `measured` and a reference, over all frequencies,
        shape (p,).
        """
        return difference(self.measured, reference, self.units).max(axis=0)


def difference(response: Array, reference: Array, units: Sequence[str]) -> Array:
    """Returns the relative difference between a response and its reference at each frequency, shape (F, p).

    If symmetry keeps a signal at zero, its difference is divided by the size of the other signals with the same unit, as in
    `Response.scale`.

    Args:
        response, reference: two complex frequency responses, shape (F, p).
        units: units of the p output signals.
    """
    size = np.abs(reference)
    scale = np.maximum(size, SILENT * loudest_alike(size, units))
    apart = np.abs(response - reference)
    return np.divide(apart, scale, out=np.where(apart > 0, np.inf, 0.0), where=scale > 0)


def ideal_measurements(vehicle: Vehicle) -> Vehicle:
    """Returns a copy of the vehicle that is in equilibrium and has exact measurements. Noise and quantisation are removed,
    because they have no frequency response.
    """
    return replace(vehicle.starting(), implementation=vehicle.implementation.without_noise)


def measure_responses(
    vehicle: Vehicle, controllers: Controllers, amplitude: Length, timestep: Time, speed: PositiveSpeed
) -> list[Lines]:
    """Measures the frequency responses of controllers in MuJoCo, from the last period of a run over a road with a periodic
    chirp.

    Args:
        vehicle: vehicle that is measured; noise and quantisation in its `[implementation]` section are omitted.
        controllers: linear controllers with stable loops.
        amplitude: largest height of the road [m].
        timestep: timestep of the simulation [s].
        speed: forward velocity [m/s]; it affects only vehicles with several axles.

    Returns:
        For each controller, the measured and the predicted frequency responses.

    Raises:
        InputError: the timestep is too large for the highest frequency, the amplitude is not allowed, or the loop of a
            controller is unstable.

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
    """Checks that frequency responses can be measured; arguments as in `measure_responses`.

    Raises:
        InputError: the timestep or the amplitude is not allowed, or the loop of a controller is unstable.
    """
    check_fits(vehicle, *controllers)
    sample_times(vehicle, 1.0, timestep)
    if timestep > 0.25 / HIGHEST:
        raise InputError(
            f"timestep = {timestep:g} s is too large for frequencies up to {HIGHEST:g} Hz; give a timestep of at most "
            f"{0.25 / HIGHEST:g} s"
        )
    if not 1e-6 <= amplitude <= 1:
        raise InputError(f"amplitude = {amplitude:g} m is not allowed; give a number from 1e-06 to 1 m")
    for controller in controllers:
        growth = radius(loop_of(vehicle, controller, timestep))
        if growth >= 1:
            raise InputError(
                f"the loop with controller {controller.name!r} has no frequency response, because its motion does not "
                f"decay (each timestep multiplies this motion by {growth:.6g}); give a different controller, or a "
                "smaller timestep"
            )
