"""The worst road of a loop that a computer closes: periodic, but no sinusoid, and the gain that MuJoCo makes of it.

What a disturbance of the frequency omega makes in a loop that is sampled every T seconds has the frequencies omega + 2 pi m / T,
and so has the disturbance that gains most: from sample to sample it turns by one angle, omega T. So it is a sum of sinusoids of
these frequencies under every wheel, of which a few are enough: what the others add falls with the square of their share. Of as
many of them as are driven the best is a singular vector.

All is computed and measured at a step that is small against the sample, with z on either side of the leap that it makes where a
force is replaced by the next: its mean square is then exact to the square of the step.
"""

import math
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from models.common.arrays import Array
from models.reality import steps_per_sample
from models.vehicle import Vehicle
from sim.frequency.apart import Apart
from sim.frequency.gain import beside_leaps, mean_square
from sim.linear.frequency import leaps_by_step, stepwise_frequency_response
from sim.physics.simulate import simulate
from sim.response.regime import ended_by
from sim.response.response import Response
from sim.runs.run import sample_times
from synth.controller import Controller
from synth.implemented.loop import sampled_radius
from synth.problem.problem import twists
from synth.sampled.norm import SampledNorm

FINE = 2.5e-4  # s, of a step at most: a wheel hop turns by a sixtieth of a radian in it, of which the square counts
FEWEST, FINEST = 8, 1e-4  # steps in a sample, where they need not be shorter than so [s]
MOST_LINES = 6  # of either sign beside the angle's own
NEAR = 3e-4  # relative: how far from the worst angle the one is that is driven, a hundredth of the least damped mode's width
SETTLED = 1e-6  # what is left of free motion when the gain is read


@dataclass(frozen=True)
class WorstRoad:
    """The worst road of a sampled loop.

    Attributes:
        angle: by which the road turns from sample to sample [rad].
        predicted: its gain, by analysis, held at its height midway through each step as MuJoCo holds it.
        gain: in MuJoCo.
        timestep: of its run [s].
        twisted: whether the vehicle's norm is over twists of the road that come beside its velocity, as none does that is driven.
        ended: what ended the linear regime.
    """

    angle: float
    predicted: float
    gain: float
    timestep: float
    twisted: bool
    ended: tuple[str, ...]


def worst_road(
    vehicle: Vehicle, controller: Controller, norm: SampledNorm, amplitude: float, timestep: float
) -> WorstRoad | None:
    """The worst road of a loop, driven; None where what happens within one sample decides, which no such road does.

    Args:
        vehicle: the vehicle, without noise and quantisation.
        controller: its controller, whose loop is stable.
        norm: of that loop as it is implemented.
        amplitude: largest height of the road [m].
        timestep: longest of the run [s]; the sample period, where the vehicle gives none.
    """
    if norm.inside:
        return None
    period, own = vehicle.implementation.sample_period or timestep, steps_per_sample(vehicle.implementation, timestep)
    wanted = period / max(min(timestep, FINE, period / FEWEST), FINEST) * (1 - 1e-9)
    steps = own * math.ceil(wanted / own)  # a delay that ends with a step does so with a part of one
    built = replace(vehicle, implementation=replace(vehicle.implementation, sample_period=period))
    return _driven(built, controller, norm, amplitude, period / steps)


def _driven(vehicle: Vehicle, controller: Controller, norm: SampledNorm, amplitude: float, h: float) -> WorstRoad:
    """A controller on its worst road, at a step of h seconds."""
    turn, steps = _turn(norm.angle), steps_per_sample(vehicle.implementation, h)
    angle, count = 2 * math.pi * float(turn), turn.denominator * steps
    predicted, waves, omega = _worst(vehicle, controller, angle, h)
    settling = h * math.log(SETTLED) / math.log(sampled_radius(vehicle, controller, h))
    time = sample_times(vehicle, settling + (count + 2) * h, h)
    road = Apart.under(vehicle, omega, waves, float(time[-1]))
    scale = amplitude / road.highest(time[: count + 1])
    response = simulate([vehicle], [controller], [road.scaled(scale)], time, threads=0).response.run(0)
    # The sample before the last periods tells the first leap. Of a sinusoid the mean square is half that of its amplitude, but
    # where every one is there twice.
    last = Response(time[-count - 1 :], response.signals, response.values[-count - 1 :])
    size = scale * (1.0 if turn == Fraction(1, 2) else math.sqrt(0.5))
    gain = math.sqrt(mean_square(vehicle, last)) / size
    twisted = len(twists(vehicle.linear_model)) > 0
    return WorstRoad(angle, predicted, gain, h, twisted, ended_by(vehicle, response))


def _turn(angle: float) -> Fraction:
    """The share of a turn that a road turns by from sample to sample, so that it has a period."""
    share, most = angle / (2 * math.pi), 64
    while True:
        turn = min(max(Fraction(share).limit_denominator(most), Fraction(1, most)), Fraction(1, 2))
        if abs(float(turn) - share) <= NEAR * share or most > 10 / NEAR:
            return turn
        most *= 2


def _worst(vehicle: Vehicle, controller: Controller, angle: float, h: float) -> tuple[float, Array, Array]:
    """The largest gain of sinusoids that turn by an angle [rad], what they are then, and their frequencies.

    Returns:
        The gain; the road's velocity under every wheel [m/s] of the disturbance of mean square 1, complex, shape (L, r); and the
        frequencies [rad/s], negative ones too, shape (L,).
    """
    steps, wheels = steps_per_sample(vehicle.implementation, h), len(vehicle.kind.wheels)
    most = max(0, min((steps - 2) // 4, MOST_LINES))
    sides = np.arange(-most - 1, most + 1) if most else np.zeros(1)
    omega = (angle + 2 * np.pi * sides) / (steps * h)
    positive, shape = np.abs(omega), vehicle.road_shape(np.abs(omega))[:, None]
    after = shape[..., None] * np.swapaxes(stepwise_frequency_response(vehicle, controller, positive, h)[:-1], 2, 3)
    before = after - shape[..., None] * np.swapaxes(leaps_by_step(vehicle, controller, positive, h), 2, 3)
    negative, around = (omega < 0)[:, None, None], beside_leaps(vehicle, after, before)
    rows = [_lines(vehicle, angle, np.where(negative, z.conj(), z), h) for z in around]

    # What is driven is measured by the velocities and, where heights act as such, by the twists that they make.
    model = vehicle.linear_model
    twist = model.twist_rate / positive[:, None, None] * twists(model)
    roots = np.linalg.cholesky(np.eye(wheels) + np.swapaxes(twist, 1, 2) @ twist)
    whitened = np.einsum("zlr,lrs->zls", np.concatenate(rows), np.swapaxes(np.linalg.inv(roots), 1, 2))
    _, sizes, best = np.linalg.svd(whitened.reshape(len(whitened), -1) / math.sqrt(2), full_matrices=False)
    w = np.swapaxes(np.linalg.inv(roots), 1, 2) @ best[0].conj().reshape(len(omega), wheels, 1)
    w = w[..., 0]
    if math.isclose(angle, math.pi):  # every sinusoid is there twice, and the two must not cancel
        w = w * np.exp(-0.5j * np.angle(np.sum(w * w[::-1])))
    return float(sizes[0]), np.where(omega[:, None] < 0, shape.conj(), shape) * w, omega


def _lines(vehicle: Vehicle, angle: float, signals: Array, h: float) -> Array:
    """Signals at the N steps of a period, shape (N, L, r, p), as lines of z, whose squares are its mean square: (N p, L, r)."""
    steps = len(signals)
    turned = np.exp(-1j * angle * np.arange(steps) / steps)[:, None, None, None] * signals
    omega = (angle + 2 * np.pi * np.fft.fftfreq(steps, 1 / steps)) / (steps * h)
    weights = vehicle.weights(np.abs(omega))
    weights = np.where(omega[:, None] < 0, weights.conj(), weights)
    lines = weights[:, None, None] * np.fft.fft(turned, axis=0) / steps
    return np.moveaxis(lines, 3, 1).reshape(-1, *signals.shape[1:3])
