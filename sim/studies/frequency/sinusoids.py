"""Runs over periodic roads: their duration, and the evaluation of an integer number of periods at the end of each run.

A *line* is one of the frequencies of the road. A run starts from equilibrium, so the response begins with a transient (free
motion), which takes a minute to decay for a passive car. The poles of the loop determine the shapes of the free motion, so that
only the amplitudes are unknown. A least-squares fit of the last periods therefore contains a sine and a cosine for each line,
and the decaying shapes of the free motion. The fit cannot hide a wrong frequency response, because no decaying motion resembles
a line over a whole period.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.roads.road import Road
from models.roads.sinusoids import sinusoid
from models.vehicle.limits_and_implementation import Implementation, steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.drive.case import Case
from sim.drive.response import Response
from sim.observers.recorder import record
from sim.runs.run import sample_times
from synth.controller.controller import AnyController, Controller
from synth.controller.loop_of import loop_of, radius
from synth.plant.loop import Loop

LOWEST, HIGHEST = 0.1, 25.0  # Hz, lowest and highest frequency of the road
# Highest line relative to half the controller's sample rate; aliases (images) of a higher line could be near another line
ALIASING_LIMIT = 0.98
# Images of a line are fitted around this many multiples of the sample rate; images at higher multiples are smaller
IMAGES = 8
DEAD = 1e-12  # free motion counts as decayed if its relative size is smaller than this
# Relative size below which remaining free motion is not fitted. The first value applies if lines are fitted, the second if the
# signals themselves are used.
LEFT, LEFT_IN_SIGNALS = 1e-7, 1e-6
# s, longest time to wait until free motion has decayed; slower free motion, such as that of integrators, is fitted and
# subtracted
PATIENCE = 10.0
# s, smallest length of the evaluated end of a run; over this length, a fit separates slow free motion from the lines
TOLD_APART = 5.0
ENTRIES = 2e7  # largest number of values in a batch; the roads of a full car in a single batch would take gigabytes
# Smallest number of evaluated samples, which contain an integer number of periods; the frequency is then within 0.03 % of the
# requested one
FINEST = 2000


@dataclass(frozen=True, eq=False)
class PeriodicRoad:
    """A periodic road, and the method that evaluates the end of a run over this road.

    Attributes:
        road: periodic road over which the run drives.
        omega: frequencies of the road [rad/s], shape (F,).
        samples: number of samples that are evaluated at the end of the run; they contain an integer number of periods.
        fitted: True to fit lines and free motion to the evaluated samples; False to use the signals without a fit, after free
            motion has decayed.
    """

    road: Road
    omega: Array
    samples: int
    fitted: bool = True


@dataclass(frozen=True, eq=False)
class PeriodicRun:
    """A run over a periodic road, from equilibrium to the end of the evaluated periods.

    Attributes:
        vehicle, controller: vehicle and controller of the run.
        on: periodic road of the run, with the method of evaluation.
        response: signals of the run, one column for each of S signals, shape (T, S).
    """

    vehicle: Vehicle
    controller: AnyController
    on: PeriodicRoad
    response: Response

    @property
    def timestep(self) -> float:
        """Timestep of the simulation [s]."""
        return float(self.response.time[1])

    @property
    def _loop(self) -> tuple[Controller, Loop]:
        assert self.controller.linear is True, "only a linear loop has a free motion that is known"
        return self.controller, loop_of(self.vehicle, self.controller, self.timestep)

    def last_periods(self) -> Response:
        """Returns the evaluated periods at the end of the run, from which slow free motion is subtracted. The controller must
        be linear.
        """
        _, loop = self._loop
        _, slow = settling_of(loop, LEFT_IN_SIGNALS)
        told = self.response.samples(slice(-_read(loop, slow, self.on.samples), None))
        steady = _without_slow_motion(loop, told, slow, self.on.omega * loop.period)
        return steady.samples(slice(-self.on.samples, None))

    def lines(self, with_images: bool = False) -> dict[str, Array]:
        """Returns the complex amplitude of each line, shape (F,), by name of the signal. The controller must be linear.

        Args:
            with_images: True to fit also the images of the lines, see `images`. If the samples contain an integer number of
                periods of both road and controller sampling, images are orthogonal to the lines and need no fit.
        """
        (controller, loop), omega = self._loop, self.on.omega
        response = self.response.samples(slice(-self.on.samples, None))
        if len(loop.by_step) > 1 and controller.measured:
            response = _without_slow_motion(loop, response, settling_of(loop, LEFT)[1], omega * loop.period)
        time, samples = response.time, len(response.time)
        if not np.all(np.isfinite(response.values)):
            return {name: np.full(len(omega), np.nan + 0j) for name in response.names}
        besides = images(omega, self.vehicle, self.timestep) if with_images else []
        angle = np.multiply.outer(time, np.concatenate([omega, besides]))
        free = _free_motion(self.vehicle, controller, float(time[1] - time[0]), samples)
        shapes = np.hstack([np.ones((samples, 1)), np.cos(angle), -np.sin(angle), free])
        coefficients = np.linalg.lstsq(shapes, response.values)[0]
        count = angle.shape[1]
        lines = coefficients[1 : 1 + count] + 1j * coefficients[1 + count : 1 + 2 * count]
        return dict(zip(response.names, lines[: len(omega)].T, strict=True))


def drive_periodic(
    vehicle: Vehicle, controllers: Sequence[AnyController], roads: Sequence[PeriodicRoad], timestep: float
) -> Iterator[PeriodicRun]:
    """Yields the MuJoCo runs of N controllers, each over the periodic road of its controller. The evaluated samples at the end
    of each run contain an integer number of periods of the run's road.

    Args:
        vehicle: vehicle in equilibrium, without noise and quantisation of the measurements.
        controllers: N controllers; the loops of linear controllers must be stable.
        roads: periodic roads, one for each of the N controllers.
        timestep: timestep of the simulation [s].

    Raises:
        InputError: the timestep is not allowed, or a run has too many samples.
    """
    lengths = [_length(vehicle, *each, timestep) for each in zip(controllers, roads, strict=True)]
    time = sample_times(vehicle, max(lengths) * timestep, timestep)[:-1]
    runs = responses(vehicle, controllers, [on.road for on in roads], time)
    for controller, on, length, run in zip(controllers, roads, lengths, runs, strict=True):
        yield PeriodicRun(vehicle, controller, on, run.samples(slice(length)))


def responses(vehicle: Vehicle, controllers: Sequence[AnyController], roads: Sequence[Road], time: Array) -> Iterator[Response]:
    """Yields the MuJoCo responses of controllers, each over the road of its controller. The runs are divided into batches that
    fit into memory.
    """
    at_once = max(1, int(ENTRIES / (len(time) * len(vehicle.kind.signals))))
    for first in range(0, len(roads), at_once):
        some = slice(first, first + at_once)
        cases = [Case(vehicle, *each) for each in zip(controllers[some], roads[some], strict=True)]
        yield from (one.response for one in record(cases, time, threads=0))


def _length(vehicle: Vehicle, controller: AnyController, on: PeriodicRoad, timestep: float) -> int:
    """Returns the number of samples of a run: the evaluated samples, and the earlier samples in which free motion decays.

    - If lines are fitted, free motion that has not yet decayed is fitted, too. The evaluated samples are then preceded by an
      equal number of samples.
    - If the controller's sample period is longer than the timestep, the signals contain additional lines, which resemble free
      motion. Free motion must therefore decay before the evaluated samples begin, except slow motion, which is subtracted.
      Free motion must also decay if the signals are used without a fit.
    - For a nonlinear law, the shape of the free motion is unknown. The evaluated samples are therefore preceded by twice as
      many samples. The second half of these preceding samples shows whether the run has settled.
    """
    steps = steps_per_sample(vehicle.implementation, timestep)
    if controller.linear is not True:
        return 3 * on.samples
    if on.fitted and (steps == 1 or not controller.measured):
        return 2 * on.samples
    loop = loop_of(vehicle, controller, timestep)
    settling, slow = settling_of(loop, LEFT if on.fitted else LEFT_IN_SIGNALS)
    if on.fitted:
        return max(on.samples, steps * math.ceil(settling / (steps * timestep))) + on.samples
    return round(settling / timestep) + 1 + _read(loop, slow, on.samples)


def _read(loop: Loop, slow: Array, samples: int) -> int:
    """Returns the number of samples that are evaluated if the signals are used without a fit; slow modes of the loop require
    more samples.
    """
    return max(samples, math.ceil(TOLD_APART / loop.period) * len(loop.by_step)) if len(slow) else samples


def chirp_lines(vehicle: Vehicle, timestep: float, count: int) -> tuple[Array, int]:
    """Returns the frequencies of a chirp and the number of samples in one period of the chirp.

    The frequencies are evenly spaced on a logarithmic scale from `LOWEST` to `HIGHEST`. Each frequency is an integer multiple
    of the lowest frequency. The period contains an integer number of the controller's sample periods, so aliases (images) of
    the lines do not disturb the fit.

    Args:
        vehicle: vehicle with the sample period of the controller.
        timestep: timestep of the simulation [s].
        count: number of frequencies, before duplicates are merged and frequencies that are too high for the sample period are
            omitted.

    Returns:
        Frequencies of the chirp [rad/s], shape (F,), and the number of samples in one period.
    """
    steps = steps_per_sample(vehicle.implementation, timestep)
    period = round(1 / LOWEST / timestep / steps) * steps
    omega = 2 * np.pi / (period * timestep) * np.unique(np.round(np.geomspace(1, HIGHEST / LOWEST, count)))
    return omega[omega < ALIASING_LIMIT * np.pi / (steps * timestep)], period


def whole_periods(omega: float, timestep: float, finest: int = FINEST) -> tuple[int, int]:
    """Returns a number of periods, and the number of samples over which these periods extend exactly, so that the frequency is
    near `omega`.

    Args:
        omega: requested frequency [rad/s].
        timestep: timestep of the simulation [s].
        finest: smallest allowed total number of samples.
    """
    periods = math.ceil(finest * timestep * omega / (2 * np.pi))
    return periods, round(periods * 2 * np.pi / (omega * timestep))


def settled_sinusoid(periods: int, count: int, height: float, timestep: float, speed: float) -> PeriodicRoad:
    """Returns a sinusoidal road for which the signals at the end of a run are used without a fit.

    Args:
        periods: number of periods that are evaluated at the end of the run.
        count: total number of samples in the evaluated periods.
        height: height of the road from trough to crest [m].
        timestep: timestep of the simulation [s].
        speed: forward velocity [m/s].
    """
    omega = 2 * np.pi * periods / (count * timestep)
    return PeriodicRoad(sinusoid(omega, speed).scaled(height / 2), np.array([omega]), count, fitted=False)


def images(omega: Array, vehicle: Vehicle, timestep: float) -> Array:
    """Returns the frequencies [rad/s] of the largest aliases (images) of the lines, which are near multiples of the
    controller's sample rate.

    Images exist only if the sample period of the controller is longer than the timestep.
    """
    steps = steps_per_sample(vehicle.implementation, timestep)
    rate = 2 * np.pi / (steps * timestep)
    orders = rate * np.arange(1, min(IMAGES, steps // 2) + 1)[:, None]
    frequencies = np.unique(np.abs(np.concatenate([orders - omega, orders + omega])).ravel())
    return frequencies[frequencies < np.pi / timestep]


def settling_of(loop: Loop, left: float) -> tuple[float, Array]:
    """Returns the settling time over a periodic road [s], and the discrete-time poles of the motion that remains after this
    time.

    Args:
        loop: loop of the vehicle that drives over the road.
        left: largest size of the free motion at the end of the settling time, relative to its initial size.
    """
    poles = np.linalg.eigvals(loop.closed_loop.A)
    slow = poles[np.abs(poles) > left ** (loop.period / PATIENCE)]
    return (PATIENCE, slow) if len(slow) else (loop.period / len(loop.by_step) * math.log(left) / math.log(radius(loop)), slow)


def _free_motion(vehicle: Vehicle, controller: Controller, timestep: float, samples: int) -> Array:
    """Returns the shapes of the free motion during the evaluated samples, shape (samples, k), a column for each of k shapes.

    Modes that have already decayed when the evaluated samples begin are omitted.
    """
    if steps_per_sample(vehicle.implementation, timestep) > 1:
        if controller.measured:
            return np.zeros((samples, 0))  # no free motion is fitted, see `_length`
        vehicle = replace(vehicle, implementation=Implementation())
    poles = np.linalg.eigvals(loop_of(vehicle, controller, timestep).closed_loop.A)
    poles = poles[np.abs(poles) > DEAD ** (1 / samples)].astype(complex)
    motion = np.exp(np.multiply.outer(np.arange(samples), np.log(poles)))
    return np.hstack([np.real(motion), np.imag(motion)])


def _without_slow_motion(loop: Loop, response: Response, poles: Array, turns: Array) -> Response:
    """Returns the signals at the end of a run over a periodic road, minus their mean and slowest modes, which are fitted by
    least squares.

    From one sample to the next, the phase of each line advances by a constant angle, and each mode is multiplied by its pole.
    A fit over many samples can therefore separate a decaying mode from a line.

    Args:
        loop: loop of the vehicle that drives over the road.
        response: response at the end of the run, long enough to separate modes from lines.
        poles: discrete-time poles of the slow modes, for one sample period of the controller.
        turns: phase advance of each line per sample period [rad], shape (L,).
    """
    if not len(poles) or not np.all(np.isfinite(response.values)):
        return response
    steps = len(loop.by_step)
    count = len(response.time) // steps
    whole = response.values[-count * steps :]
    k = np.arange(count)
    decay = np.exp(np.multiply.outer(k, np.log(poles.astype(complex))))
    slow = np.hstack([np.ones((count, 1)), np.real(decay), np.imag(decay)])
    angle = np.multiply.outer(k, turns)
    shapes = np.hstack([slow, np.cos(angle), np.sin(angle)])
    coefficients = np.linalg.lstsq(shapes, whole.reshape(count, -1))[0]
    steady = whole - (slow @ coefficients[: slow.shape[1]]).reshape(whole.shape)
    return Response(response.time[-len(whole) :], response.signals, steady)
