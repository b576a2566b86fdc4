"""Describing function of a loop with a law in Python: the loop's response to one sinusoid at a time, measured in MuJoCo.

The control law may be nonlinear. For a nonlinear law, a chirp would mix the responses at different frequencies, and linear
analysis cannot predict these responses. For each output, the result contains the fundamental, which is the component of the
signal at the frequency of the road. The result also contains the share of the signal's energy at other frequencies, which is
due to harmonics, a mean value or transients. The describing function can depend on the height of the road.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.document.field import Record
from models.roads.sinusoids import sinusoid
from models.vehicle.vehicle import Vehicle
from sim.drive.regime import ended_by
from sim.drive.response import SILENT, STILL, Response, loudest_alike
from sim.studies.frequency.identification import check, ideal_measurements, settled_gain
from sim.studies.frequency.sinusoids import PeriodicRoad, chirp_lines, drive_periodic
from synth.controller.controller import AnyController

SINUSOIDS = 20  # number of sinusoid frequencies; their range is the same as that of the chirp for linear controllers
STEADY = 1e-3  # a note is printed if the fundamental changes by more than this share between successive periods


@dataclass(frozen=True, eq=False)
class DescribingFunction:
    """Describing function of one controller. Each frequency is measured in a separate MuJoCo run.

    Attributes:
        controller: controller whose law is measured.
        outputs: names of the vehicle's p output signals.
        units: units of the output signals.
        omega: frequencies of the sinusoidal roads [rad/s], shape (F,), one for each run.
        diverged: time at which each run diverged [s], shape (F,); infinite for a run that did not diverge. Nothing is measured
            in a diverged run.
        law_diverged: True for each run that diverged only because the states of the law overflowed, shape (F,).
        measured: complex amplitude of each output's fundamental, divided by the complex amplitude of the road velocity under
            the first wheel, shape (F, p).
        outside: share of each output's energy that is not in the fundamental, shape (F, p); NaN if the output does not move.
        gains: L2 gain from the disturbance w to the performance output z at each frequency, shape (F,).
        drift: largest relative change of any output's fundamental from one period of the lowest frequency to the next.
        without: text that names the noise and quantisation that the vehicle file defines but these runs omit; empty if the runs
            omit nothing.
        ended: names of the limits that ended the linear regime in any of the runs.
    """

    controller: AnyController
    outputs: tuple[str, ...]
    units: tuple[str, ...]
    omega: Array
    diverged: Array
    law_diverged: Array
    measured: Array
    outside: Array
    gains: Array
    drift: float
    without: str
    ended: tuple[str, ...]

    @property
    def moving(self) -> list[int]:
        """Indices of the outputs that move in at least one run."""
        return [i for i in range(len(self.outputs)) if not np.all(np.isnan(self.outside[:, i]))]

    @property
    def worst_omega(self) -> float:
        """Frequency at which the L2 gain is largest [rad/s]."""
        return float(self.omega[np.argmax(np.nan_to_num(self.gains))])


def describing_function(
    vehicle: Vehicle, controller: AnyController, amplitude: float, timestep: float, speed: float
) -> DescribingFunction:
    """Measures the describing function of a controller, with one run for each sinusoidal road.

    Each run lasts three periods of the lowest frequency. Transients decay during the first period. The arguments are those of
    `sim.studies.frequency.identification.measure_responses`, which may also raise the same errors. In addition, the control law
    itself may raise an error.
    """
    check(vehicle, (), amplitude, timestep)
    without, vehicle = vehicle.implementation.noise_text, ideal_measurements(vehicle)
    omega, period = chirp_lines(vehicle, timestep, SINUSOIDS)
    roads = [PeriodicRoad(sinusoid(each, speed).scaled(amplitude / 2), np.array([each]), period) for each in omega.tolist()]
    time, outputs = np.arange(period) * timestep, vehicle.linear_model.outputs
    units = tuple(vehicle.kind.signal(name).unit for name in outputs)
    parts, times, away, ended = [], list[float](), list[bool](), dict[str, None]()
    for run in drive_periodic(vehicle, [controller] * len(roads), roads, timestep):
        response, (each,) = run.response, run.on.omega.tolist()
        times.append(response.diverged)
        away.append(response.law_diverged)
        ended |= dict.fromkeys(ended_by(vehicle, response, controller.has_anti_windup))
        if np.isfinite(response.diverged):
            nothing = np.full(len(outputs), np.nan)
            parts.append((nothing * 1j, nothing, nothing * 1j, np.nan))
            continue
        before, last = (Response(time, response.signals, response.values[k * period : (k + 1) * period]) for k in (1, 2))
        earlier, _ = _fundamental(vehicle, units, before, each)
        parts.append((*_fundamental(vehicle, units, last, each), earlier, settled_gain(vehicle, last, each)))
    measured, outside, earlier, gains = (np.stack(column) for column in zip(*parts, strict=True))
    diverged = np.array(times)
    size = np.where(np.isfinite(diverged)[:, None], 0.0, np.abs(measured))
    scale = np.maximum(size, SILENT * size.max(axis=0))  # if a fundamental is almost zero, it need not be steady
    change = np.divide(np.abs(measured - earlier), scale, out=np.zeros_like(scale), where=scale > 0)
    drift = float(np.where(np.isnan(outside), 0.0, change).max())
    values = (measured, outside, gains, drift, without, tuple(ended))
    return DescribingFunction(controller, outputs, units, omega, diverged, np.array(away), *values)


def _fundamental(vehicle: Vehicle, units: Sequence[str], response: Response, omega: float) -> tuple[Array, Array]:
    """Returns the fundamental of each output divided by that of the road velocity, and the share of each output's energy at
    other frequencies, shapes (p,).

    Args:
        vehicle: vehicle of the run.
        units: units of the p outputs.
        response: response of the vehicle over an integer number of periods of the road.
        omega: frequency of the road [rad/s].
    """
    turning = 2 * np.exp(-1j * omega * response.time) / len(response.time)
    signals = np.stack([response[name] for name in vehicle.linear_model.outputs], axis=-1)
    lines, energy = turning @ signals, np.mean(signals**2, axis=0)
    moves = energy > SILENT**2 * loudest_alike(energy, units, STILL**2)
    inside = np.divide(np.abs(lines) ** 2 / 2, energy, out=np.full(len(energy), np.nan), where=moves)
    return lines / (turning @ response[vehicle.kind.wheels[0].road_velocity]), np.maximum(1 - inside, 0.0)


def describing_failures(one: DescribingFunction) -> list[str]:
    """Returns a list with one text if every run diverged, so that nothing was measured; otherwise an empty list."""
    if not np.all(np.isfinite(one.diverged)):
        return []
    return [f"every run {'ended early' if one.law_diverged.any() else 'diverged'}, so nothing is measured"]


RECORD = Record[DescribingFunction](
    Record(controller=lambda one: one.controller.name),
    lambda one: one.controller.law.record,
    without=lambda one: one.without or None,
    omega="omega",
    signals=lambda one: {
        name: {"measured": one.measured[:, i], "outside": one.outside[:, i]} for i, name in enumerate(one.outputs)
    },
    norm=lambda one: None,
    gains="gains",
    drift="drift",
    ended="ended",
    failures=describing_failures,
)
