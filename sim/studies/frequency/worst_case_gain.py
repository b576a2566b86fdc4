"""The largest L2 gain in MuJoCo, by a sinusoid, or by a periodic road for a sampled-data loop.

With the largest gain of a sinusoid come the transmissibilities that no suspension force can change, of kinds of vehicle that have
such.

The worst road of a sampled-data loop is periodic. In a loop that is sampled every T seconds, the response to a disturbance of
frequency omega has the frequencies omega + 2 pi m / T. So has the worst disturbance, whose phase turns by omega T from sample to
sample. It is a sum of sinusoids of these frequencies under every wheel. A few are enough, as the contribution of the others falls
with the square of their share. For a given number of sinusoids the worst road is a singular vector.

Everything is computed and measured at a step that is small compared with the sample period, with z on either side of the jump at
each new force. Its mean square is then exact to the square of the step.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.common.printed import finite_pairs
from models.roads.road import Bump, Road, RoadInput
from models.roads.sinusoids import Multisine, random_road, sinusoid
from models.roads.spectrum import as_met
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.drive.case import Case
from sim.drive.regime import ended_by
from sim.drive.response import Response
from sim.linear.frequency_response import (
    WorstSinusoid,
    sampled_frequency_response,
    sinusoid_gains,
    stepwise_frequency_response,
    worst_sinusoid,
)
from sim.linear.sampled_response import taylor4
from sim.observers.recorder import record
from sim.runs.run import sample_times
from sim.studies.frequency.identification import (
    HIGHEST,
    LINES,
    LOWEST,
    check,
    fit,
    ideal_measurements,
    images,
    l2_gain,
    mean_square,
    settled_gain,
    settling_of,
    without_slow_motion,
)
from synth.analysis.specification import SampledNorm
from synth.controller.controller import Controller
from synth.controller.loop_of import loop_of
from synth.controller.problem import road_twist_inputs
from synth.plant.loop import Loop


@dataclass(frozen=True)
class PerWheelRoad(Road):
    """A sum of sinusoids under each wheel that starts at height zero.

    The road is one: under the rear wheels lies at the beginning what the front ones have passed long before, and a run is over
    before any wheel is where the next one began.

    Attributes:
        omega: w_i [rad/s], none of them zero.
        waves: velocity of the road under every wheel, the real part of the sum of c_i exp(j w_i t) [m/s], by side and by how much
            later than the first wheel it is where that one was [s]; the last wheel first.
        speed: forward velocity [m/s].
    """

    omega: tuple[float, ...]
    waves: tuple[tuple[str, float, tuple[complex, ...]], ...]
    speed: float

    @classmethod
    def under(cls, vehicle: Vehicle, omega: Array, waves: Array, duration: float) -> "PerWheelRoad":
        """Returns a road for a vehicle.

        Args:
            vehicle: r wheels.
            omega: shape (L,).
            waves: amplitudes c, shape (L, r).
            duration: duration of the run [s].
        """
        wheels = vehicle.kind.wheels
        behind = [wheel.behind(vehicle.parameters) for wheel in wheels]
        speed = min(np.diff(sorted({*behind})).tolist(), default=duration) / (2 * duration)
        each = [(wheel.side, at / speed, tuple(c)) for wheel, at, c in zip(wheels, behind, waves.T.tolist(), strict=True)]
        return cls(tuple(omega.tolist()), tuple(sorted(each, key=lambda one: -one[1])), speed)

    def displacement(self, t: Array, side: str = "") -> Array:
        """The sum under the wheel of that side that is there at the time."""
        return self._sum(t, side, 1j * np.array(self.omega))

    def velocity(self, t: Array, side: str = "") -> Array:
        """Returns the exact derivative of the displacement."""
        return self._sum(t, side, None)

    def highest(self, time: Array) -> float:
        """The largest height under any wheel in these times of a run [m]."""
        return max(float(np.abs(self.displacement(time - late, side)).max()) for side, late, _ in self.waves)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Returns the times at which each wheel begins."""
        return tuple(sorted({-late for _, late, _ in self.waves}))

    def describe(self) -> dict[str, Any]:
        """Returns the frequencies, and each wheel's amplitudes."""
        waves = [{"side": side, "late": late, "amplitudes": finite_pairs(c)} for side, late, c in self.waves]
        return {"type": "apart", "omega": list(self.omega), "waves": waves, "speed": self.speed}

    def scaled(self, factor: float) -> "PerWheelRoad":
        """The same road, higher or lower."""
        return replace(self, waves=tuple((side, late, tuple(factor * x for x in c)) for side, late, c in self.waves))

    def _sum(self, t: Array, side: str, integral: Array | None) -> Array:
        """The velocity, or the height, which begins at zero."""
        total = np.zeros(np.shape(t))
        for own, late, c in self.waves:  # the last wheel first: its road ends where that of the next one begins
            here = (t >= -late) & (side == own)
            turning = np.exp(1j * np.multiply.outer(t[here] + late, np.array(self.omega)))
            total[here] = np.real(turning @ np.array(c) if integral is None else (turning - 1) @ (np.array(c) / integral))
        return total


DURATION = 20.0  # s, of all roads but the worst sinusoid, which takes as long as it needs to settle
SETTLED = 1e-6  # what is left of free motion when its gain is read; the gain is then within about as much
TOLD_APART = 5.0  # s at the end of a run, over which it is told from the road's
ENTRIES = 2e7  # numbers in a batch's record: a full car's roads all at once would take gigabytes
FINEST = 2000  # samples of the worst sinusoid at least: its frequency is then within 0.03 % of the peak's
BESIDE, DOUBLINGS = 3e-4, 6  # relative; how far below its peak it may be, and how often it has twice the samples for that at most


@dataclass(frozen=True)
class MeasuredInvariant:
    """A transmissibility from the road's displacement that no suspension force can change, see `models.kinds.kind.Invariant`.

    Attributes:
        name: name of the quantity.
        omega: frequency [rad/s].
        expected: expected magnitude.
        measured: magnitude in MuJoCo.
        allowed: twice the relative difference due to holding the road over a step, (omega h)^2 / 24.
    """

    name: str
    omega: float
    expected: float
    measured: float
    allowed: float

    @property
    def error(self) -> float:
        """Relative difference."""
        return abs(self.measured / self.expected - 1)


@dataclass(frozen=True)
class Extremes:
    """Largest gains of one controller.

    Attributes:
        worst: gain and frequency of the worst sinusoid of the sampled loop over a road that is held over every step, as MuJoCo
            holds it: its held-road norm, which `synth.analysis.sampled_norm` does not hold it for.
        integrated: gain of the worst sinusoid of the loop as RK4 makes it.
        tried: the frequency that was driven [rad/s], next to it.
        predicted: gain at that frequency with all harmonics, at the run's step and at half of it; empty if `lti`.
        gains: L2 gains from w to z, measured in MuJoCo, by road; of the worst sinusoid alone if the road has a filter.
        invariants: transmissibilities of this vehicle that no suspension force can change.
        ended: ends of the linear regime in any of the runs.
        lti: True if the sampled loop is time-invariant, because the controller samples at every step. Otherwise its norm here
            leaves out the harmonics, and bounds no gain.
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
    """Drives every controller over a bump, a random road, its invariants' frequencies and its worst sinusoid.

    Arguments and errors as for `sim.studies.frequency.identification.identify`.
    """
    check(vehicle, controllers, amplitude, timestep)
    vehicle = ideal_measurements(vehicle)
    time = sample_times(vehicle, DURATION, timestep)
    roads = {
        "random": random_road(2 * np.pi * np.geomspace(LOWEST, HIGHEST, LINES), 1, speed).to_height(amplitude, time),
        "bump": Bump(height=amplitude, speed=speed),
    }
    special = [invariant.omega(vehicle.parameters) for invariant in vehicle.kind.invariants_of(vehicle.parameters)]
    if special:
        together = Multisine(tuple(special), (1.0,) * len(special), (0.0,) * len(special), speed)
        roads["invariants"] = together.to_height(amplitude, time)
    every = driven(
        [controller for controller in controllers for _ in roads],
        [RoadInput(vehicle, road, time) for _ in controllers for road in roads.values()],
    )

    def worst_of(controller: Controller, exponential: Callable[[Array], Array]) -> WorstSinusoid:
        def response(omega: Array) -> Array:
            return sampled_frequency_response(vehicle, controller, omega, timestep, exponential)

        return worst_sinusoid(vehicle, response, np.pi / timestep, speed)

    worst = [worst_of(controller, linalg.expm) for controller in controllers]
    driven_worst = _drive_worst(vehicle, controllers, worst, amplitude, timestep, speed)
    lti = steps_per_sample(vehicle.implementation, timestep) == 1
    results = []
    for controller, one, (settled, tried) in zip(controllers, worst, driven_worst, strict=True):
        runs, winds_up = dict(zip(roads, every, strict=False)), controller.has_anti_windup  # the next ones, of this controller
        ended = dict.fromkeys(name for run in (settled, *runs.values()) for name in ended_by(vehicle, run, winds_up))
        invariants = _measured(vehicle, controller, runs.pop("invariants"), len(time) // 2, timestep) if special else ()
        gains = {"worst sinusoid": settled_gain(vehicle, settled, tried)}
        gains |= {name: gain for name, run in runs.items() if (gain := l2_gain(vehicle, run)) is not None}
        steps = () if lti else (timestep, timestep / 2)
        predicted = tuple(_sinusoid_gain(vehicle, controller, tried, h, speed) for h in steps)
        integrated = worst_of(controller, taylor4).gain
        results.append(Extremes(one, integrated, tried, predicted, gains, invariants, tuple(ended), lti))
    return results


def driven(controllers: Sequence[Controller], inputs: Sequence[RoadInput]) -> Iterator[Response]:
    """Yields the MuJoCo responses of controllers over a road each, with as many runs in a batch as the memory allows."""
    at_once = max(1, int(ENTRIES / (len(inputs[0].time) * len(inputs[0].vehicle.kind.signals))))
    for first in range(0, len(inputs), at_once):
        some = slice(first, first + at_once)
        cases = [Case(on.vehicle, one, on.road) for one, on in zip(controllers[some], inputs[some], strict=True)]
        yield from (one.response for one in record(cases, inputs[0].time, threads=0))


def _drive_worst(
    vehicle: Vehicle,
    controllers: Sequence[Controller],
    worst: Sequence[WorstSinusoid],
    amplitude: float,
    timestep: float,
    speed: float,
) -> Iterator[tuple[Response, float]]:
    """Yields, for every controller, its worst sinusoid's last whole periods, once it has settled, and its frequency [rad/s]."""
    samples = [_next_to(one, vehicle, each, timestep, speed) for one, each in zip(worst, controllers, strict=True)]
    tried = [2 * np.pi * periods / (count * timestep) for periods, count in samples]
    loops = [loop_of(vehicle, controller, timestep) for controller in controllers]
    settling, slow = zip(*(settling_of(loop, SETTLED) for loop in loops), strict=True)
    lengths = [_told(loop, poles, count) for loop, poles, (_, count) in zip(loops, slow, samples, strict=True)]
    time = sample_times(vehicle, max(settling) + timestep * max(lengths), timestep)
    roads = [sinusoid(omega, speed).scaled(amplitude / 2) for omega in tried]
    runs = record([Case(vehicle, *each) for each in zip(controllers, roads, strict=True)], time, threads=0)
    for run, loop, poles, omega, length, (_, count) in zip(runs, loops, slow, tried, lengths, samples, strict=True):
        steady = _steady(loop, run.response, length, poles, omega * loop.period)
        yield steady.samples(slice(-count, None)), omega


def _steady(loop: Loop, response: Response, length: int, poles: Array, turn: float) -> Response:
    """Returns the last samples of a run along a road that turns by an angle [rad] from sample to sample, without slow motion."""
    return without_slow_motion(loop, response.samples(slice(-length, None)), poles, np.array([turn]))


def _told(loop: Loop, poles: Array, count: int) -> int:
    """Returns the number of steps evaluated at the end of a run: many samples if slow modes are fitted."""
    return max(count, math.ceil(TOLD_APART / loop.period) * len(loop.by_step)) if len(poles) else count


def _next_to(worst: WorstSinusoid, vehicle: Vehicle, controller: Controller, timestep: float, speed: float) -> tuple[int, int]:
    """Returns whole periods, as `whole_periods`, so near the worst sinusoid that a narrow peak is met, too."""
    steps = steps_per_sample(vehicle.implementation, timestep)  # whole samples, too, so that every run of them is the same
    finest = math.ceil(FINEST / steps)
    periods, count = whole_periods(worst.omega, timestep * steps, finest)
    for k in range(1, DOUBLINGS + 1):
        omega = np.array([2 * np.pi * periods / (count * steps * timestep)])
        gain = sinusoid_gains(vehicle, sampled_frequency_response(vehicle, controller, omega, timestep), omega, speed)[0]
        if gain >= worst.gain * (1 - BESIDE):
            break
        periods, count = whole_periods(worst.omega, timestep * steps, finest * 2**k)
    return periods, count * steps


def whole_periods(omega: float, timestep: float, finest: int = FINEST) -> tuple[int, int]:
    """Returns a number of periods near this frequency and their exact number of samples, `finest` or more in all."""
    periods = math.ceil(finest * timestep * omega / (2 * np.pi))
    return periods, round(periods * 2 * np.pi / (omega * timestep))


def _measured(
    vehicle: Vehicle, controller: Controller, response: Response, samples: int, timestep: float
) -> tuple[MeasuredInvariant, ...]:
    """The invariants of a vehicle, measured over the last samples of a run along them."""
    p, kind = vehicle.parameters, vehicle.kind
    known = kind.invariants_of(p)
    omega = np.array([invariant.omega(p) for invariant in known])
    lines = fit(vehicle, controller, response, omega, samples, images(omega, vehicle, timestep))
    road = lines[kind.wheels[0].road_displacement]
    gains = []
    for i, (invariant, at) in enumerate(zip(known, omega.tolist(), strict=True)):
        moved = np.sum([lines[name] for name in invariant.signals], axis=0)
        allowed = 2 * (at * timestep) ** 2 / 24
        gains.append(MeasuredInvariant(invariant.name, at, invariant.magnitude(p), float(np.abs(moved[i] / road[i])), allowed))
    return tuple(gains)


FINE = 2.5e-4  # s, of a step at most: a wheel hop turns by a sixtieth of a radian in it, of which the square counts
FEWEST, SHORTEST_STEP = 8, 1e-4  # steps in a sample, unless they would be shorter than this [s]
MOST_LINES = 6  # of either sign in addition to the angle's own
NEAR = 3e-4  # relative distance of the driven angle from the worst one: a hundredth of the least damped mode's width


@dataclass(frozen=True)
class WorstRoad:
    """The worst road of a sampled loop.

    Attributes:
        angle: phase angle of the road from sample to sample [rad].
        predicted: gain predicted for the road as MuJoCo holds it, at its height midway through each step.
        finer: the largest gain of the same sinusoids at half the step.
        gain: gain in MuJoCo.
        timestep: timestep of its run [s].
        twisted: True if the norm also covers the warp of the road, which this road does not contain.
        ended: events that ended the linear regime.
    """

    angle: float
    predicted: float
    finer: float
    gain: float
    timestep: float
    twisted: bool
    ended: tuple[str, ...]


def worst_roads(
    vehicle: Vehicle, controllers: Sequence[Controller], norms: Sequence[SampledNorm | None], amplitude: float, timestep: float
) -> list[WorstRoad | None]:
    """Drives the worst roads of loops side by side; None for a loop without a norm, or whose norm depends on motion within one
    sample, which no such road excites.

    Args:
        vehicle: the vehicle, without noise and quantisation.
        controllers: controllers whose loops are stable.
        norms: norms of these loops as implemented, or None.
        amplitude: largest height of the road [m].
        timestep: longest timestep of the runs [s]; the sample period if the vehicle gives none.
    """
    period, own = vehicle.implementation.sample_period or timestep, steps_per_sample(vehicle.implementation, timestep)
    wanted = period / max(min(timestep, FINE, period / FEWEST), SHORTEST_STEP) * (1 - 1e-9)
    steps = own * math.ceil(wanted / own)  # a delay that ends with a step does so with a part of one
    vehicle, h = replace(vehicle, implementation=replace(vehicle.implementation, sample_period=period)), period / steps
    plans, until = dict[int, tuple[Loop, Fraction, Array, int]](), 0.0  # loop, turn, slow poles, samples that are read
    for i, (controller, norm) in enumerate(zip(controllers, norms, strict=True)):
        if norm is not None and not norm.inside:
            loop, turn = loop_of(vehicle, controller, h), _turn(norm.angle)
            settling, slow = settling_of(loop, SETTLED)
            plans[i] = loop, turn, slow, _told(loop, slow, turn.denominator * steps + 1)
            until = max(until, settling + (plans[i][-1] + 1) * h)
    roads, inputs = list[WorstRoad | None]([None] * len(controllers)), list[RoadInput]()
    if not plans:
        return roads
    time, twisted = sample_times(vehicle, until, h), len(road_twist_inputs(vehicle.linear_model)) > 0
    most = max(0, min((steps - 2) // 4, MOST_LINES))
    sizes = []
    for i, (_, turn, *_) in plans.items():
        predicted, waves, omega = _worst(vehicle, controllers[i], 2 * math.pi * float(turn), h, most)
        road = PerWheelRoad.under(vehicle, omega, waves, float(time[-1]))
        sizes.append((predicted, amplitude / road.highest(time[: turn.denominator * steps + 1])))
        inputs.append(RoadInput(vehicle, road.scaled(sizes[-1][1]), time))
    runs = driven([controllers[i] for i in plans], inputs)
    for (i, (loop, turn, slow, length)), (predicted, scale), response in zip(plans.items(), sizes, runs, strict=True):
        angle, count = 2 * math.pi * float(turn), turn.denominator * steps
        # The sample before the last periods gives the first leap. The mean square of a sinusoid is half that of its amplitude,
        # unless every sinusoid is there twice.
        last = _steady(loop, response, length, slow, angle).samples(slice(-count - 1, None))
        gain = math.sqrt(mean_square(vehicle, last)) / (scale * (1.0 if turn == Fraction(1, 2) else math.sqrt(0.5)))
        finer, _, _ = _worst(vehicle, controllers[i], angle, h / 2, most)
        ended = ended_by(vehicle, response, controllers[i].has_anti_windup)
        roads[i] = WorstRoad(angle, predicted, finer, gain, h, twisted, ended)
    return roads


def _turn(angle: float) -> Fraction:
    """The share of a turn that a road turns by from sample to sample, so that it has a period."""
    share, most = angle / (2 * math.pi), 64
    while True:
        turn = min(max(Fraction(share).limit_denominator(most), Fraction(1, most)), Fraction(1, 2))
        if abs(float(turn) - share) <= NEAR * share or most > 10 / NEAR:
            return turn
        most *= 2


def _worst(vehicle: Vehicle, controller: Controller, angle: float, h: float, most: int) -> tuple[float, Array, Array]:
    """The largest gain of sinusoids that turn by an angle [rad], what they are then, and their frequencies.

    Args:
        most: sinusoids of either sign beside the angle's own.

    Returns:
        The gain; the road's velocity under every wheel [m/s] of the disturbance of mean square 1, complex, shape (L, r); and the
        frequencies [rad/s], negative ones too, shape (L,).
    """
    steps, wheels = steps_per_sample(vehicle.implementation, h), len(vehicle.kind.wheels)
    sides = np.arange(-most - 1, most + 1) if most else np.zeros(1)
    omega = (angle + 2 * np.pi * sides) / (steps * h)
    positive, shape = np.abs(omega), vehicle.road_shape(np.abs(omega))[:, None]
    rows = _either_side(vehicle, controller, omega, angle, h)

    # What is driven is measured by the velocities and, where heights act as such, by the twists that they make.
    model = vehicle.linear_model
    twist = model.twist_rate / positive[:, None, None] * road_twist_inputs(model)
    roots = np.linalg.cholesky(np.eye(wheels) + np.swapaxes(twist, 1, 2) @ twist)
    whitened = np.einsum("zlr,lrs->zls", rows, np.swapaxes(np.linalg.inv(roots), 1, 2))
    _, sizes, best = np.linalg.svd(whitened.reshape(len(whitened), -1) / math.sqrt(2), full_matrices=False)
    w = np.swapaxes(np.linalg.inv(roots), 1, 2) @ best[0].conj().reshape(len(omega), wheels, 1)
    w = w[..., 0]
    if math.isclose(angle, math.pi):  # every sinusoid is there twice, and the two must not cancel
        w = w * np.exp(-0.5j * np.angle(np.sum(w * w[::-1])))
    return float(sizes[0]), np.where(omega[:, None] < 0, shape.conj(), shape) * w, omega


def _sinusoid_gain(vehicle: Vehicle, controller: Controller, omega: float, h: float, speed: float) -> float:
    """Returns the gain of one road under all wheels from w to z, with all frequencies that held forces add."""
    turn = omega * steps_per_sample(vehicle.implementation, h) * h
    rows = _either_side(vehicle, controller, np.array([omega]), math.remainder(turn, 2 * math.pi), h)[:, 0]
    met = as_met(vehicle, np.array([omega]), speed)[0]
    return float(np.linalg.norm(rows @ met) / np.linalg.norm(met)) / math.sqrt(2)


def _either_side(vehicle: Vehicle, controller: Controller, omega: Array, angle: float, h: float) -> Array:
    """Returns lines of z after leaps and before, by `_lines`, per disturbance under every wheel, shape (2 N p, L, r)."""
    positive, negative = np.abs(omega), (omega < 0)[:, None, None]
    shape = vehicle.road_shape(positive)[:, None, None]
    values, leaps = stepwise_frequency_response(vehicle, controller, positive, h)
    after = shape * np.swapaxes(values[:-1], 2, 3)
    before = after - shape * np.swapaxes(leaps, 2, 3)
    sides = [vehicle.summed(z) for z in (after, before)]
    return np.concatenate([_lines(vehicle, angle, np.where(negative, z.conj(), z), h) for z in sides])


def _lines(vehicle: Vehicle, angle: float, signals: Array, h: float) -> Array:
    """Signals at the N steps of a period, shape (N, L, r, p), as lines of z, whose squares are its mean square: (N p, L, r)."""
    steps = len(signals)
    turned = np.exp(-1j * angle * np.arange(steps) / steps)[:, None, None, None] * signals
    omega = (angle + 2 * np.pi * np.fft.fftfreq(steps, 1 / steps)) / (steps * h)
    weights = vehicle.weights(np.abs(omega))
    weights = np.where(omega[:, None] < 0, weights.conj(), weights)
    lines = weights[:, None, None] * np.fft.fft(turned, axis=0) / steps
    return np.moveaxis(lines, 3, 1).reshape(-1, *signals.shape[1:3])
