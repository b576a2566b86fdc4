"""Runs over periodic roads: how long they take to settle, and the lines and whole periods at their end.

A run starts from rest, so its first seconds are its own free motion, and the passive car's takes a minute to die. Its *shape* is
known, as it is that of the loop's poles; only its size is not. So the last periods of a run are fitted, by least squares, with a
sine and a cosine at every line and with those decaying shapes. A wrong frequency response cannot hide there: nothing decaying
looks like a line over a whole period.
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

LOWEST, HIGHEST = 0.1, 25.0  # Hz
ALIASING_LIMIT = 0.98  # of half the controller's sample rate; a line above it has images that lie on other lines, or nearly
IMAGES = 8  # of a line on either side of so many multiples of the sample rate; later ones are smaller still
DEAD = 1e-12  # free motion that has decayed to this is none
LEFT, LEFT_IN_SIGNALS = 1e-7, 1e-6  # of free motion that is not fitted, where lines are fitted, and where signals are read
PATIENCE = 10.0  # s; free motion that takes longer, as that of integrators, is fitted and taken off
TOLD_APART = 5.0  # s at the end of a run whose signals are read, over which slow motion is told from the road's
ENTRIES = 2e7  # numbers in a batch's record: a full car's roads all at once would take gigabytes
FINEST = 2000  # samples of whole periods at least: their frequency is then within 0.03 % of the one that is given


@dataclass(frozen=True, eq=False)
class PeriodicRoad:
    """A periodic road, and what is read at the end of a run over it.

    Attributes:
        road: the road.
        omega: frequencies of the road [rad/s], shape (F,).
        samples: number of samples of the whole periods at the end.
        fitted: True to fit lines there, with free motion; False to read the signals, for which free motion must have decayed.
    """

    road: Road
    omega: Array
    samples: int
    fitted: bool = True


@dataclass(frozen=True, eq=False)
class PeriodicRun:
    """A run over a periodic road, from rest to the end of the whole periods that are read.

    Attributes:
        vehicle, controller: the loop.
        on: the road.
        response: the run, (T, S).
    """

    vehicle: Vehicle
    controller: AnyController
    on: PeriodicRoad
    response: Response

    @property
    def timestep(self) -> float:
        """The timestep [s]."""
        return float(self.response.time[1])

    @property
    def _loop(self) -> tuple[Controller, Loop]:
        assert self.controller.linear is True, "only a linear loop has a free motion that is known"
        return self.controller, loop_of(self.vehicle, self.controller, self.timestep)

    def last_periods(self) -> Response:
        """Returns the last whole periods of a linear loop, without slow motion."""
        _, loop = self._loop
        _, slow = settling_of(loop, LEFT_IN_SIGNALS)
        told = self.response.samples(slice(-_read(loop, slow, self.on.samples), None))
        steady = _without_slow_motion(loop, told, slow, self.on.omega * loop.period)
        return steady.samples(slice(-self.on.samples, None))

    def lines(self, with_images: bool = False) -> dict[str, Array]:
        """Returns the complex amplitude of every line of a linear loop in every signal, shape (F,) each.

        Args:
            with_images: True to fit the images of the lines, too, see `images`; over a whole period of a slower controller's
                samples they are other lines of the period.
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
    """Yields the MuJoCo runs of controllers over a periodic road each; each ends with its own whole periods.

    Args:
        vehicle: vehicle without noise and quantisation, from rest.
        controllers: N controllers; those that are linear have stable loops.
        roads: N roads.
        timestep: timestep of the physics [s].

    Raises:
        InputError: a timestep that is not allowed, or too many samples.
    """
    lengths = [_length(vehicle, *each, timestep) for each in zip(controllers, roads, strict=True)]
    time = sample_times(vehicle, max(lengths) * timestep, timestep)[:-1]
    runs = responses(vehicle, controllers, [on.road for on in roads], time)
    for controller, on, length, run in zip(controllers, roads, lengths, runs, strict=True):
        yield PeriodicRun(vehicle, controller, on, run.samples(slice(length)))


def responses(vehicle: Vehicle, controllers: Sequence[AnyController], roads: Sequence[Road], time: Array) -> Iterator[Response]:
    """Yields the MuJoCo responses of controllers over a road each, with as many runs in a batch as the memory allows."""
    at_once = max(1, int(ENTRIES / (len(time) * len(vehicle.kind.signals))))
    for first in range(0, len(roads), at_once):
        some = slice(first, first + at_once)
        cases = [Case(vehicle, *each) for each in zip(controllers[some], roads[some], strict=True)]
        yield from (one.response for one in record(cases, time, threads=0))


def _length(vehicle: Vehicle, controller: AnyController, on: PeriodicRoad, timestep: float) -> int:
    """Returns the number of samples of a run: those that are read, and before them those in which free motion decays.

    - Lines are fitted together with free motion that has not decayed in as many samples before them.
    - Between the samples of a slower controller its force makes lines besides those of the road, which resemble free motion.
      Free motion must then have decayed, but for slow motion, which is taken off. So it must if signals are read.
    - The free motion of other laws is not known. Before the samples that are read they have twice as many, of which the second
      half shows whether a run has settled.
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
    """Returns the number of samples that are evaluated where signals are read: many samples if slow modes are fitted."""
    return max(samples, math.ceil(TOLD_APART / loop.period) * len(loop.by_step)) if len(slow) else samples


def chirp_lines(vehicle: Vehicle, timestep: float, count: int) -> tuple[Array, int]:
    """Returns frequencies [rad/s] from `LOWEST` to `HIGHEST`, evenly on a logarithmic scale, and the samples of their period.

    A period has whole samples of the controller, so that images of the lines, which a slower controller makes, are other lines of
    the period. Equal frequencies of the `count` fall together, and those that are too high for the controller are left out.
    """
    steps = steps_per_sample(vehicle.implementation, timestep)
    period = round(1 / LOWEST / timestep / steps) * steps
    omega = 2 * np.pi / (period * timestep) * np.unique(np.round(np.geomspace(1, HIGHEST / LOWEST, count)))
    return omega[omega < ALIASING_LIMIT * np.pi / (steps * timestep)], period


def whole_periods(omega: float, timestep: float, finest: int = FINEST) -> tuple[int, int]:
    """Returns a number of periods near this frequency and their exact number of samples, `finest` or more in all."""
    periods = math.ceil(finest * timestep * omega / (2 * np.pi))
    return periods, round(periods * 2 * np.pi / (omega * timestep))


def settled_sinusoid(periods: int, count: int, height: float, timestep: float, speed: float) -> PeriodicRoad:
    """Returns a sinusoid of this height [m] whose signals are read over a number of periods with a number of samples."""
    omega = 2 * np.pi * periods / (count * timestep)
    return PeriodicRoad(sinusoid(omega, speed).scaled(height / 2), np.array([omega]), count, fitted=False)


def images(omega: Array, vehicle: Vehicle, timestep: float) -> Array:
    """Frequencies of the largest sinusoids that a controller makes besides the road's, as it samples every few steps [rad/s]."""
    steps = steps_per_sample(vehicle.implementation, timestep)
    rate = 2 * np.pi / (steps * timestep)
    orders = rate * np.arange(1, min(IMAGES, steps // 2) + 1)[:, None]
    frequencies = np.unique(np.abs(np.concatenate([orders - omega, orders + omega])).ravel())
    return frequencies[frequencies < np.pi / timestep]


def settling_of(loop: Loop, left: float) -> tuple[float, Array]:
    """Returns how long a run along a periodic road settles [s], and the poles of what is left then, from sample to sample."""
    poles = np.linalg.eigvals(loop.closed_loop.A)
    slow = poles[np.abs(poles) > left ** (loop.period / PATIENCE)]
    return (PATIENCE, slow) if len(slow) else (loop.period / len(loop.by_step) * math.log(left) / math.log(radius(loop)), slow)


def _free_motion(vehicle: Vehicle, controller: Controller, timestep: float, samples: int) -> Array:
    """Returns the free motions of the loop over some samples, shape (samples, k), without those that decay in as many before
    them.
    """
    if steps_per_sample(vehicle.implementation, timestep) > 1:
        if controller.measured:
            return np.zeros((samples, 0))  # see `_length`
        vehicle = replace(vehicle, implementation=Implementation())
    poles = np.linalg.eigvals(loop_of(vehicle, controller, timestep).closed_loop.A)
    poles = poles[np.abs(poles) > DEAD ** (1 / samples)].astype(complex)
    motion = np.exp(np.multiply.outer(np.arange(samples), np.log(poles)))
    return np.hstack([np.real(motion), np.imag(motion)])


def _without_slow_motion(loop: Loop, response: Response, poles: Array, turns: Array) -> Response:
    """Returns a run along a periodic road without its mean and its slowest modes, which are fitted by least squares.

    From sample to sample each line of the road turns by an angle, and a mode is multiplied by its pole, at each step of a sample
    alike. No such decay looks like turning over many samples.

    Args:
        response: end of the run, long enough to separate the two.
        poles: poles of the slow modes, from sample to sample.
        turns: phase angles of the road's lines from sample to sample [rad], shape (L,).
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
