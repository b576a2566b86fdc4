"""The H-infinity norm as a physical fact: the largest L2 gain from the road to the weighted output that MuJoCo can be driven to.

With it, the transmissibilities that no suspension force can change, of kinds of vehicle that have such.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.reality import steps_per_sample
from models.roads.road import Bump, Road
from models.roads.sinusoids import Multisine, random_road, sinusoid
from models.vehicle import Vehicle
from sim.frequency.gain import l2_gain, settled_gain
from sim.frequency.identification import HIGHEST, LINES, LOWEST, check, fit, ideal_measurements, images
from sim.linear.frequency import Worst, sampled_frequency_response, worst_sinusoid
from sim.linear.loop import taylor4
from sim.physics.simulate import simulate
from sim.response.regime import ended_by
from sim.response.response import Response
from sim.runs.run import sample_times
from synth.controller import Controller
from synth.implemented.loop import sampled_radius

DURATION = 20.0  # s, of all roads but the worst sinusoid, which takes as long as it needs to settle
SETTLED = 1e-6  # what is left of free motion when its gain is read; the gain is then within about as much
ENTRIES = 2e7  # numbers in a batch's record: a full car's roads all at once would take gigabytes
FINEST = 2000  # samples of the worst sinusoid at least: its frequency is then within 0.03 % of the peak's


@dataclass(frozen=True)
class MeasuredInvariant:
    """A transmissibility from the road's displacement that no suspension force can change, see `models.kind.Invariant`.

    Attributes:
        name: of which quantity.
        omega: at which frequency [rad/s].
        expected: its magnitude.
        measured: in MuJoCo.
        allowed: relative difference that the road makes by being held over a step, (omega h)^2 / 24, twice over.
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
    """What one controller lets through at most.

    Attributes:
        worst: gain and frequency of the worst sinusoid of the sampled loop over a road that is held over every step, as MuJoCo
            holds it: its held-road norm, which `synth.sampled.norm` does not hold it for.
        integrated: gain of the worst sinusoid of the loop as RK4 makes it.
        tried: the frequency that was driven [rad/s], next to it.
        gains: L2 gains from w to z, measured in MuJoCo, by road; of the worst sinusoid alone where the road has a filter.
        invariants: those that this vehicle has.
        ended: what ended the linear regime, in whichever run.
        lti: whether the sampled loop is time-invariant, as it is where the controller samples at every step; else its norm here
            is without the harmonics that it makes, and bounds no gain.
    """

    worst: Worst
    integrated: float
    tried: float
    gains: Mapping[str, float]
    invariants: tuple[MeasuredInvariant, ...]
    ended: tuple[str, ...]
    lti: bool


def extremes(
    vehicle: Vehicle, controllers: Sequence[Controller], amplitude: float, timestep: float, speed: float
) -> list[Extremes]:
    """Drives every controller over a bump, a random road, its invariants' frequencies and its worst sinusoid.

    Arguments and errors as for `sim.frequency.identification.identify`.
    """
    check(vehicle, controllers, amplitude, timestep)
    vehicle = ideal_measurements(vehicle)
    time = sample_times(vehicle, DURATION, timestep)
    roads = {
        "random": random_road(2 * np.pi * np.geomspace(LOWEST, HIGHEST, LINES), 1, speed).to_height(amplitude, time),
        "bump": Bump(height=amplitude, speed=speed),
    }
    special = [invariant.omega(vehicle.parameters) for invariant in vehicle.kind.invariants]
    if special:
        together = Multisine(tuple(special), (1.0,) * len(special), (0.0,) * len(special), speed)
        roads["invariants"] = together.to_height(amplitude, time)
    responses = _responses(vehicle, controllers, roads, time)
    worst, integrated = (
        [
            worst_sinusoid(
                vehicle,
                lambda omega, c=c, e=exponential: sampled_frequency_response(vehicle, c, omega, timestep, e),
                np.pi / timestep,
                speed,
            )
            for c in controllers
        ]
        for exponential in (linalg.expm, taylor4)
    )
    settled, tried = _drive_worst(vehicle, controllers, worst, amplitude, timestep, speed)

    lti = steps_per_sample(vehicle.implementation, timestep) == 1
    found = []
    for i, controller in enumerate(controllers):
        runs = {name: of_each[i] for name, of_each in responses.items()}
        ended = dict.fromkeys(name for run in (settled[i], *runs.values()) for name in ended_by(vehicle, run))
        invariants = _measured(vehicle, controller, runs["invariants"], len(time) // 2, timestep) if special else ()
        gains = {"worst sinusoid": settled_gain(vehicle, settled[i], tried[i])}
        others = {name: l2_gain(vehicle, run) for name, run in runs.items() if name != "invariants"}
        gains |= {name: gain for name, gain in others.items() if gain is not None}
        found.append(Extremes(worst[i], integrated[i].gain, tried[i], gains, invariants, tuple(ended), lti))
    return found


def _responses(
    vehicle: Vehicle, controllers: Sequence[Controller], roads: Mapping[str, Road], time: Array
) -> dict[str, list[Response]]:
    """The responses of all controllers over each road, as many roads in a batch as memory is asked for."""
    count = len(controllers)
    together = max(1, int(ENTRIES / (count * len(time) * len(vehicle.kind.signals))))
    names, found = list(roads), {}
    for first in range(0, len(names), together):
        some = names[first : first + together]
        on = [roads[name] for name in some for _ in controllers]
        response = simulate([vehicle] * len(on), [*controllers] * len(some), on, time, threads=0).response
        found |= {name: [response.run(k * count + i) for i in range(count)] for k, name in enumerate(some)}
    return found


def _drive_worst(
    vehicle: Vehicle, controllers: Sequence[Controller], worst: Sequence[Worst], amplitude: float, timestep: float, speed: float
) -> tuple[list[Response], list[float]]:
    """The worst sinusoid of every controller, its last whole periods once it has settled, and the frequencies [rad/s]."""
    samples = [whole_periods(one.omega, timestep) for one in worst]
    tried = [2 * np.pi * periods / (count * timestep) for periods, count in samples]
    slowest = max(sampled_radius(vehicle, controller, timestep) for controller in controllers)
    settling = timestep * math.log(SETTLED) / math.log(slowest)
    time = sample_times(vehicle, settling + timestep * max(count for _, count in samples), timestep)
    roads = [sinusoid(omega, speed).scaled(amplitude / 2) for omega in tried]
    response = simulate([vehicle] * len(controllers), controllers, roads, time, threads=0).response
    last = [Response(time[-count:], response.signals, response.values[i, -count:]) for i, (_, count) in enumerate(samples)]
    return last, tried


def whole_periods(omega: float, timestep: float) -> tuple[int, int]:
    """How many periods of about this frequency are exactly how many samples, `FINEST` of them or more."""
    periods = math.ceil(FINEST * timestep * omega / (2 * np.pi))
    return periods, round(periods * 2 * np.pi / (omega * timestep))


def _measured(
    vehicle: Vehicle, controller: Controller, response: Response, samples: int, timestep: float
) -> tuple[MeasuredInvariant, ...]:
    """The invariants of a vehicle, measured over the last samples of a run along them."""
    p, kind = vehicle.parameters, vehicle.kind
    omega = np.array([invariant.omega(p) for invariant in kind.invariants])
    lines = fit(vehicle, controller, response, omega, samples, images(omega, vehicle, timestep))
    road = lines[kind.wheels[0].road_displacement]
    found = []
    for i, (invariant, at) in enumerate(zip(kind.invariants, omega.tolist(), strict=True)):
        moved = np.sum([lines[name] for name in invariant.signals], axis=0)
        allowed = 2 * (at * timestep) ** 2 / 24
        found.append(MeasuredInvariant(invariant.name, at, invariant.magnitude(p), float(np.abs(moved[i] / road[i])), allowed))
    return tuple(found)
