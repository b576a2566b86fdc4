"""L2 gains in MuJoCo: the largest gain, which the worst sinusoidal road causes, and the gains over a bump and a random road.

The module also measures the transmissibilities that no suspension force can change, if the vehicle type has such invariants.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.roads.road import Bump
from models.roads.sinusoids import Multisine, random_road
from models.roads.spectrum import as_met
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.drive.regime import ended_by
from sim.linear.frequency_response import (
    WorstSinusoid,
    sampled_frequency_response,
    sinusoid_gains,
    stepwise_frequency_response,
    worst_sinusoid,
)
from sim.linear.sampled_response import taylor4
from sim.runs.run import sample_times
from sim.studies.frequency.identification import LINES, check, ideal_measurements, l2_gain, settled_gain
from sim.studies.frequency.sinusoids import (
    FINEST,
    HIGHEST,
    LOWEST,
    PeriodicRoad,
    PeriodicRun,
    drive_periodic,
    responses,
    settled_sinusoid,
    whole_periods,
)
from synth.controller.controller import Controller

DURATION = 20.0  # s, duration of all runs except the run over the worst sinusoid, whose duration depends on the settling time
# Largest allowed relative gap between the gain at the simulated frequency and the peak gain. Then the largest number of
# refinements that bring the frequency closer to the peak.
BESIDE, DOUBLINGS = 3e-4, 6


@dataclass(frozen=True)
class MeasuredInvariant:
    """A transmissibility from the road height that no suspension force can change, see `models.kinds.kind.Invariant`.

    Attributes:
        name: name of the quantity whose transmissibility is measured.
        omega: frequency at which the transmissibility is invariant [rad/s].
        expected: magnitude that the transmissibility must have at `omega`.
        measured: magnitude of the transmissibility in MuJoCo.
        allowed: allowed relative difference between `expected` and `measured`, which is twice (omega h)^2 / 24 for the timestep
            h. The error (omega h)^2 / 24 arises because MuJoCo keeps the road constant during each timestep h.
    """

    name: str
    omega: float
    expected: float
    measured: float
    allowed: float

    @property
    def error(self) -> float:
        """Relative difference between the measured and the expected magnitude of the transmissibility."""
        return abs(self.measured / self.expected - 1)


@dataclass(frozen=True)
class Extremes:
    """Largest L2 gains of one controller.

    Attributes:
        worst: discrete-time norm of the sampled loop, and the frequency of the sinusoidal road that reaches this norm. In
            contrast to `synth.analysis.sampled_norm`, the road is assumed to be constant during each timestep, as in MuJoCo.
        integrated: discrete-time norm of the loop if its equations of motion are integrated by RK4.
        tried: frequency of the simulated sinusoid [rad/s], which is near the worst frequency.
        predicted: gain at `tried` including all harmonics, once for the timestep and once for half the timestep; empty if `lti`
            is True.
        gains: L2 gains from the disturbance w to the performance output z, by road; only for the worst sinusoid if the road has
            a filter.
        invariants: transmissibilities of this vehicle that no suspension force can change.
        ended: names of the limits that ended the linear regime in any of the runs.
        lti: True if the sampled loop is time-invariant, because the controller samples at every timestep. If `lti` is False,
            `worst` omits the harmonics, so a gain can be larger than `worst`.
    """

    worst: WorstSinusoid
    integrated: float
    tried: float
    predicted: tuple[float, ...]
    gains: Mapping[str, float]
    invariants: tuple[MeasuredInvariant, ...]
    ended: tuple[str, ...]
    lti: bool


def extremes(
    vehicle: Vehicle, controllers: Sequence[Controller], amplitude: float, timestep: float, speed: float
) -> list[Extremes]:
    """Simulates each controller over a bump, a random road, a road with the frequencies of the invariants, and the worst
    sinusoidal road.

    Arguments and errors are those of `sim.studies.frequency.identification.measure_responses`.
    """
    check(vehicle, controllers, amplitude, timestep)
    vehicle = ideal_measurements(vehicle)
    time = sample_times(vehicle, DURATION, timestep)
    roads = {
        "random": random_road(2 * np.pi * np.geomspace(LOWEST, HIGHEST, LINES), 1, speed).to_height(amplitude, time),
        "bump": Bump(height=amplitude, speed=speed),
    }
    every = responses(vehicle, [one for one in controllers for _ in roads], [*roads.values()] * len(controllers), time)

    def worst_of(controller: Controller, exponential: Callable[[Array], Array]) -> WorstSinusoid:
        def response(omega: Array) -> Array:
            return sampled_frequency_response(vehicle, controller, omega, timestep, exponential)

        return worst_sinusoid(vehicle, response, np.pi / timestep, speed)

    worst = [worst_of(controller, linalg.expm) for controller in controllers]
    near = [_next_to(one, vehicle, each, timestep, speed) for one, each in zip(worst, controllers, strict=True)]
    sinusoids = [settled_sinusoid(*each, amplitude, timestep, speed) for each in near]
    special, lti = _invariants(vehicle, amplitude, time, speed), steps_per_sample(vehicle.implementation, timestep) == 1
    settled = drive_periodic(vehicle, controllers, sinusoids, timestep)
    others = drive_periodic(vehicle, controllers, [special] * len(controllers), timestep) if special else None
    results = []
    for controller, one, of_worst in zip(controllers, worst, settled, strict=True):
        runs, (tried,), periods = dict(zip(roads, every, strict=False)), of_worst.on.omega.tolist(), of_worst.last_periods()
        at_invariants = next(others) if others is not None else None
        seen = [periods, *runs.values(), *([at_invariants.response] if at_invariants is not None else [])]
        ended = dict.fromkeys(name for run in seen for name in ended_by(vehicle, run, controller.has_anti_windup))
        gains = {"worst sinusoid": settled_gain(vehicle, periods, tried)}
        gains |= {name: gain for name, run in runs.items() if (gain := l2_gain(vehicle, run)) is not None}
        predicted = tuple(_sinusoid_gain(vehicle, controller, tried, h, speed) for h in (timestep, timestep / 2) if not lti)
        invariants = () if at_invariants is None else _measure_invariants(at_invariants)
        integrated = worst_of(controller, taylor4).gain
        results.append(Extremes(one, integrated, tried, predicted, gains, invariants, tuple(ended), lti))
    return results


def _invariants(vehicle: Vehicle, amplitude: float, time: Array, speed: float) -> PeriodicRoad | None:
    """Returns a road with the frequencies of the vehicle's invariants, which is evaluated over the second half of a run; None
    if the vehicle has no invariants.
    """
    omega = [invariant.omega(vehicle.parameters) for invariant in vehicle.kind.invariants_of(vehicle.parameters)]
    if not omega:
        return None
    together = Multisine(tuple(omega), (1.0,) * len(omega), (0.0,) * len(omega), speed)
    return PeriodicRoad(together.to_height(amplitude, time), np.array(omega), len(time) // 2)


def _next_to(worst: WorstSinusoid, vehicle: Vehicle, controller: Controller, timestep: float, speed: float) -> tuple[int, int]:
    """Returns numbers of periods and samples, as `whole_periods` does, for a frequency at which the gain nearly reaches a
    narrow peak.
    """
    # The evaluated periods must also contain an integer number of controller samples
    steps = steps_per_sample(vehicle.implementation, timestep)
    finest = math.ceil(FINEST / steps)
    periods, count = whole_periods(worst.omega, timestep * steps, finest)
    for k in range(1, DOUBLINGS + 1):
        omega = np.array([2 * np.pi * periods / (count * steps * timestep)])
        gain = sinusoid_gains(vehicle, sampled_frequency_response(vehicle, controller, omega, timestep), omega, speed)[0]
        if gain >= worst.gain * (1 - BESIDE):
            break
        periods, count = whole_periods(worst.omega, timestep * steps, finest * 2**k)
    return periods, count * steps


def _measure_invariants(run: PeriodicRun) -> tuple[MeasuredInvariant, ...]:
    """Returns the invariant transmissibilities of a vehicle, measured at the end of a run over the road of `_invariants`."""
    p, kind = run.vehicle.parameters, run.vehicle.kind
    lines = run.lines(with_images=True)
    road = lines[kind.wheels[0].road_displacement]
    gains = []
    for i, (invariant, at) in enumerate(zip(kind.invariants_of(p), run.on.omega.tolist(), strict=True)):
        moved = np.sum([lines[name] for name in invariant.signals], axis=0)
        allowed = 2 * (at * run.timestep) ** 2 / 24
        gains.append(MeasuredInvariant(invariant.name, at, invariant.magnitude(p), float(np.abs(moved[i] / road[i])), allowed))
    return tuple(gains)


def _sinusoid_gain(vehicle: Vehicle, controller: Controller, omega: float, h: float, speed: float) -> float:
    """Returns the gain from the disturbance w to the performance output z over a sinusoidal road, with the harmonics that held
    forces cause.

    Args:
        vehicle: vehicle that the controller controls.
        controller: controller of this vehicle.
        omega: frequency of the road [rad/s].
        h: timestep [s].
        speed: forward velocity [m/s].
    """
    at = np.array([omega])
    values, leaps = stepwise_frequency_response(vehicle, controller, at, h)
    shape, angle = vehicle.road_shape(at)[:, None, None], math.remainder(omega * (len(values) - 1) * h, 2 * math.pi)
    after = shape * np.swapaxes(values[:-1], 2, 3)
    before = after - shape * np.swapaxes(leaps, 2, 3)
    rows = np.concatenate([_lines(vehicle, angle, vehicle.summed(z), h) for z in (after, before)])[:, 0]
    met = as_met(vehicle, at, speed)[0]
    return float(np.linalg.norm(rows @ met) / np.linalg.norm(met)) / math.sqrt(2)


def _lines(vehicle: Vehicle, angle: float, signals: Array, h: float) -> Array:
    """Returns the complex Fourier coefficients of the performance output z, shape (N p, L, r). The sum of the squared
    magnitudes of the coefficients is the mean square of z.

    Args:
        vehicle: the vehicle, with the weights of the performance output z.
        angle: phase advance of the road per sample period of the controller [rad].
        signals: signals at the N timesteps of a sample period, shape (N, L, r, p).
        h: timestep [s].
    """
    steps = len(signals)
    turned = np.exp(-1j * angle * np.arange(steps) / steps)[:, None, None, None] * signals
    omega = (angle + 2 * np.pi * np.fft.fftfreq(steps, 1 / steps)) / (steps * h)
    weights = vehicle.weights(np.abs(omega))
    weights = np.where(omega[:, None] < 0, weights.conj(), weights)
    lines = weights[:, None, None] * np.fft.fft(turned, axis=0) / steps
    return np.moveaxis(lines, 3, 1).reshape(-1, *signals.shape[1:3])
