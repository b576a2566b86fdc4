"""One vehicle, one road, some controllers: physics, its linear predictions, and the verdict on each."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, known
from models.vehicle import Vehicle
from sim.linear.loop import continuous_response, largest_timestep, noise_spread, sampled_radius, sampled_response, taylor4
from sim.physics.energy import Energy, energy
from sim.physics.simulate import simulate
from sim.response.response import Response
from sim.roads.road import Road, under_wheels
from sim.runs.agreement import SMALL, Agreement, compare, look_closer
from synth.controller import Controller

MOST_SAMPLES = 1_000_000  # a run of these takes 0.4 GB and half a minute
LOWEST = 1e-5  # m; what a lower road does to a vehicle is lost in the rounding of its weight


@dataclass(frozen=True)
class HalfStep:
    """What half the timestep, the controller sampled as before, makes of the physics after a tyre has left the road.

    There no linear response is exact, and RK4 steps over the moments at which a tyre leaves and lands.

    Attributes:
        difference: the largest of any signal, over its peak; infinite where one of the two runs diverged.
        signal: which it is.
    """

    difference: float
    signal: str


@dataclass(frozen=True, eq=False)
class Run:
    """One controller over one road.

    Attributes:
        controller: the controller.
        physics: what MuJoCo did.
        sampled: exact linear response of the sampled loop.
        continuous: exact linear response of the continuous closed loop.
        qpos: generalized positions of the physics, shape (T, nq).
        diverged: when the physics diverged [s]; infinite where it did not.
        sampled_radius: spectral radius of the sampled loop; above 1 it is unstable.
        agreement: physics against analysis.
        energy: its balance; None where it is not known, as of a part of a run that is read from a log.
        half_step: how far the physics holds after a lift-off; None where no tyre lifted, the run broke off, or what is measured
            is noisy or quantised, which it would be otherwise at other steps.
    """

    controller: Controller
    physics: Response
    sampled: Response
    continuous: Response
    qpos: Array
    diverged: float
    sampled_radius: float
    agreement: Agreement
    energy: Energy | None = None
    half_step: HalfStep | None = None

    @property
    def broke_off(self) -> tuple[str, float] | None:
        """What ended the vehicle, and when [s]: from there on no number of the run means anything. None where it came through."""
        ends = {"flat tyre": self.agreement.flat, "divergence": self.diverged}
        first = min(ends, key=lambda name: ends[name])
        return (first, ends[first]) if math.isfinite(ends[first]) else None

    @property
    def holds(self) -> bool:
        """Whether physics agrees with its analysis, and with itself: its energy balances, where that is known."""
        return self.agreement.agrees and (self.energy is None or self.energy.balances)


def sample_times(vehicle: Vehicle, duration: float, timestep: float) -> Array:
    """Sample times 0, h, 2 h, ... up to the duration [s].

    Raises:
        InputError: a timestep or duration that is not positive, too large for RK4 on this vehicle, or far too many samples.
    """
    for name, value in {"timestep": timestep, "duration": duration}.items():
        if not math.isfinite(value) or value <= 0:
            raise InputError(f"{name} = {value} s is not allowed; give a number above 0")
    largest = largest_timestep(vehicle)
    if timestep > largest:
        raise InputError(
            f"timestep = {timestep} s is too large: RK4 is unstable on this vehicle above {largest:.3g} s; 0.001 is usual"
        )
    if duration < 2 * timestep:
        raise InputError(f"duration = {duration} s is shorter than two timesteps of {timestep} s; give a longer one")
    if duration / timestep > MOST_SAMPLES:
        raise InputError(f"{duration / timestep:.2g} samples are too many; at most {MOST_SAMPLES} (duration / timestep)")
    return np.arange(round(duration / timestep) + 1) * timestep


def check_road(vehicle: Vehicle, road: Road, time: Array) -> None:
    """Whether a vehicle feels a road at these sample times. A flat one is fine.

    Raises:
        InputError: the road hardly moves during the run.
    """
    highest = float(np.abs(under_wheels(road.displacement, road, vehicle, time)).max())
    if 0 < highest < LOWEST:
        raise InputError(
            f"the road moves by only {highest:.2g} m in the {time[-1]:.4g} s of the run, and less than {LOWEST:g} m is lost in "
            "rounding; give a higher or shorter one, more speed, a longer duration, or 0 height"
        )


def _check_noise(vehicle: Vehicle, controllers: Sequence[Controller]) -> None:
    """Refuses noise or quantisation of a signal that none of the controllers measures.

    Raises:
        InputError: it names the signal, and those that are measured.
    """
    measured = {name for controller in controllers for name in controller.measured}
    how = vehicle.implementation
    for kind, values in {"noise": how.noise, "quantisation": how.quantisation}.items():
        for name in values:
            if measured and name not in measured:
                raise InputError(f"[implementation] {kind} of {name!r}, which is not measured; measured are: {known(measured)}")


@np.errstate(over="ignore", invalid="ignore")  # an unstable loop overflows; its run says so
def run_all(vehicle: Vehicle, controllers: Sequence[Controller], road: Road, time: Array) -> list[Run]:
    """Runs every controller over the road, from rest, and compares.

    Args:
        vehicle: the vehicle.
        controllers: its controllers.
        road: the road.
        time: equidistant sample times from 0 [s], see `sample_times`.
    """
    count, timestep = len(controllers), float(time[1] - time[0])
    _check_noise(vehicle, controllers)
    physics = simulate([vehicle] * count, controllers, [road] * count, time)
    runs = []
    for i, controller in enumerate(controllers):
        measured, diverged = physics.response.run(i), float(physics.diverged[i])
        sampled = sampled_response(vehicle, controller, road, time)
        integrated = sampled_response(vehicle, controller, road, time, exponential=taylor4)
        continuous = continuous_response(vehicle, controller, road, time)
        spread = noise_spread(vehicle, controller, timestep)
        agreement = compare(vehicle, measured, sampled, integrated, continuous, diverged, spread)
        runs.append(
            Run(
                controller=controller,
                physics=measured,
                sampled=sampled,
                continuous=continuous,
                qpos=physics.qpos[i],
                diverged=diverged,
                sampled_radius=sampled_radius(vehicle, controller, timestep),
                agreement=agreement,
                energy=energy(vehicle, physics, i, road, until=agreement.flat),
            )
        )
    doubtful = [i for i, run in enumerate(runs) if not run.agreement.agrees]
    if doubtful:
        again, quiet = [controllers[i] for i in doubtful], replace(vehicle, implementation=vehicle.implementation.scaled(SMALL))
        small = simulate([quiet] * len(again), again, [road.scaled(SMALL)] * len(again), time).response
        for k, i in enumerate(doubtful):
            runs[i] = replace(runs[i], agreement=look_closer(runs[i].agreement, small.run(k), runs[i].sampled))
    return halved(vehicle, runs, road, time)


def halved(vehicle: Vehicle, runs: Sequence[Run], road: Road, time: Array) -> list[Run]:
    """Runs with what half the step changes in those where a tyre lifted."""
    runs, timestep = list(runs), float(time[1] - time[0])
    lifted = [i for i, run in enumerate(runs) if run.agreement.lift_off and run.broke_off is None and not run.agreement.blurred]
    if lifted:
        again, halves = [runs[i].controller for i in lifted], np.arange(2 * len(time) - 1) * (timestep / 2)
        period = vehicle.implementation.sample_period or timestep
        held = replace(vehicle, implementation=replace(vehicle.implementation, sample_period=period))
        finer = simulate([held] * len(again), again, [road] * len(again), halves).response
        for k, i in enumerate(lifted):
            runs[i] = replace(runs[i], half_step=_half_step(vehicle, runs[i], finer.run(k)))
    return runs


def _half_step(vehicle: Vehicle, run: Run, finer: Response) -> HalfStep:
    """The physics of a run against that at half the step, from its first lift-off on."""
    lifted = run.physics.time >= run.agreement.lift_off[0][0]
    apart = {
        name: float(np.abs(run.physics[name] - finer[name][::2])[lifted].max()) / (run.physics.scale(name) or 1.0)
        for name in vehicle.linear_model.outputs
    }
    apart = {name: far if math.isfinite(far) else math.inf for name, far in apart.items()}
    furthest = max(apart, key=lambda name: apart[name])
    return HalfStep(apart[furthest], furthest)
