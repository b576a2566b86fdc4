"""One vehicle, one road, some controllers: physics, its linear predictions, and the verdict on each."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, listing
from models.damping.laws import SemiActive
from models.own.python_law import Programmed
from models.roads.road import Road
from models.vehicle import Vehicle
from sim.linear.dampers import scaled_commands
from sim.linear.loop import largest_timestep
from sim.physics.energy import Energy, energy
from sim.physics.geometry import has_geometry
from sim.physics.python_laws import Driven, Played
from sim.physics.simulate import PhysicsRuns, simulate
from sim.response.regime import FLAT
from sim.response.response import Response
from sim.runs.agreement import SMALL, Agreement, compare, look_closer
from sim.runs.made import predict_made, reference_at, with_noise
from sim.runs.prediction import Prediction, predict
from synth.controller import Controller

MOST_SAMPLES = 1_000_000  # a run of these takes 0.4 GB and half a minute


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
    """One prediction beside its physics.

    Attributes:
        prediction: what linear analysis says of this vehicle, controller and road.
        physics: what MuJoCo did.
        agreement: physics against analysis.
        qpos: generalized positions of the physics, shape (T, nq), to draw it; None where MuJoCo has not run here, as of what is
            read from a log.
        energy: its balance; None there, too.
        half_step: how far the physics holds after a lift-off; None where no tyre lifted, the run broke off, or what is measured
            is noisy or quantised, which it would be otherwise at other steps.
    """

    prediction: Prediction
    physics: Response
    agreement: Agreement
    qpos: Array | None = None
    energy: Energy | None = None
    half_step: HalfStep | None = None

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle, with the limits and implementation of this run."""
        return self.prediction.vehicle

    @property
    def controller(self) -> Controller | Programmed | SemiActive:
        """Its controller."""
        return self.prediction.controller

    @property
    def road(self) -> Road:
        """The road."""
        return self.prediction.road

    @property
    def sampled(self) -> Response:
        """Exact linear response of the sampled loop."""
        return self.prediction.sampled

    @property
    def continuous(self) -> Response:
        """Exact linear response of the continuous closed loop."""
        return self.prediction.continuous

    @property
    def diverged(self) -> float:
        """When the physics diverged [s]; infinite where it did not."""
        return self.physics.diverged

    @property
    def broke_off(self) -> tuple[str, float] | None:
        """What ended the vehicle, and when [s]: from there on no number of the run means anything. None where it came through."""
        ends = {FLAT.name: self.agreement.ended[FLAT.name], "divergence": self.diverged}
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


def _check_noise(vehicle: Vehicle, controllers: Sequence[Controller | Programmed | SemiActive]) -> None:
    """Refuses noise or quantisation of a signal that no controller measures, of these or of the vehicle file.

    Raises:
        InputError: it names the signal, and those that are measured.
    """
    measured = {name for controller in (*controllers, *vehicle.controllers.values()) for name in controller.measured}
    how = vehicle.implementation
    for kind, values in {"noise": how.noise, "quantisation": how.quantisation}.items():
        for name in values:
            if measured and name not in measured:
                raise InputError(f"[implementation] {kind} of {name!r}, which is not measured; measured are: {listing(measured)}")


@np.errstate(over="ignore", invalid="ignore")  # an unstable loop overflows; its run says so
def run_all(vehicle: Vehicle, controllers: Sequence[Controller | Programmed | SemiActive], road: Road, time: Array) -> list[Run]:
    """Runs every controller over the road, from rest, and compares.

    Args:
        vehicle: the vehicle.
        controllers: its controllers.
        road: the road.
        time: equidistant sample times from 0 [s], see `sample_times`.
    """
    _check_noise(vehicle, controllers)
    ahead = not vehicle.dampers  # what those do follows from what physics has made of them
    known = [predict(vehicle, each, road, time) if ahead and isinstance(each, Controller) else each for each in controllers]
    made = simulate([vehicle] * len(controllers), controllers, [road] * len(controllers), time)
    predictions = [
        each if isinstance(each, Prediction) else predict_made(vehicle, each, road, time, made.run(i), made.asked[i])
        for i, each in enumerate(known)
    ]
    return balanced(judge(predictions, [made.run(i) for i in range(len(predictions))]), made)


def judge(predictions: Sequence[Prediction], physics: Sequence[Response]) -> list[Run]:
    """The verdict on each of some runs: its physics, of now or from a log, against its prediction.

    Args:
        predictions: over the same sample times, of vehicles of the same kind.
        physics: what MuJoCo made of each.
    """
    pairs = list(zip(predictions, physics, strict=True))
    runs = [Run(prediction, response, compare(prediction, response)) for prediction, response in pairs]
    doubtful = [i for i, run in enumerate(runs) if not run.agreement.agrees and has_geometry(run.vehicle)]
    if doubtful:
        again = [predictions[i] for i in doubtful]
        small = _simulated(again, again[0].time, partial(with_noise, SMALL), SMALL).response
        for k, i in enumerate(doubtful):
            reference = reference_at(SMALL, predictions[i], small.run(k))
            runs[i] = replace(runs[i], agreement=look_closer(runs[i].agreement, reference, small.run(k)))
    return runs


def balanced(runs: Sequence[Run], made: PhysicsRuns) -> list[Run]:
    """Runs with what MuJoCo's own states say of them: positions, energy, and what half the step changes after a lift-off.

    Args:
        runs: over the same sample times, of vehicles of the same kind.
        made: what MuJoCo makes of them.
    """
    runs = [
        replace(run, qpos=made.qpos[i], energy=energy(run.vehicle, made, i, run.road, until=run.agreement.ended[FLAT.name]))
        for i, run in enumerate(runs)
    ]
    lifted = [i for i, run in enumerate(runs) if run.agreement.lift_off and run.broke_off is None and not run.agreement.blurred]
    if lifted:
        again, timestep = [runs[i].prediction for i in lifted], runs[0].prediction.timestep
        halves = np.arange(2 * len(again[0].time) - 1) * (timestep / 2)
        finer = _simulated(again, halves, lambda vehicle: _sampled_as_before(vehicle, timestep)).response
        for k, i in enumerate(lifted):
            runs[i] = replace(runs[i], half_step=_half_step(runs[i], finer.run(k)))
    return runs


def _simulated(
    predictions: Sequence[Prediction],
    time: Array,
    vehicle: Callable[[Vehicle], Vehicle] = lambda same: same,
    share: float = 1.0,
) -> PhysicsRuns:
    """What MuJoCo makes of what is predicted, with other vehicles and a share of the road if asked; runs share what they shared.

    A law in Python is not run again: the forces that it asked for are, with the same share of them.
    """
    vehicles = {id(each.vehicle): vehicle(each.vehicle) for each in predictions}
    roads = {id(each.road): each.road if share == 1 else each.road.scaled(share) for each in predictions}
    return simulate(
        [vehicles[id(each.vehicle)] for each in predictions],
        [driven(each, time, share) for each in predictions],
        [roads[id(each.road)] for each in predictions],
        time,
    )


def driven(prediction: Prediction, time: Array, share: float = 1.0) -> Driven:
    """What drives a run when it is made again.

    Args:
        prediction: of the run.
        time: sample times of the run that is made [s], whose timestep divides that of the prediction.
        share: of the forces of a law in Python.
    """
    if not isinstance(prediction.controller, Programmed):
        return prediction.controller
    held = round(prediction.timestep / float(time[1]))
    asked = scaled_commands(prediction.vehicle, prediction.asked, share)
    return Played(prediction.controller.measured, np.repeat(asked, held, axis=0)[: len(time)])


def _sampled_as_before(vehicle: Vehicle, timestep: float) -> Vehicle:
    """The vehicle with the sample period that it has at a timestep, to be run at another."""
    period = vehicle.implementation.sample_period or timestep
    return replace(vehicle, implementation=replace(vehicle.implementation, sample_period=period))


def _half_step(run: Run, finer: Response) -> HalfStep:
    """The physics of a run against that at half the step, from its first lift-off on."""
    lifted = run.physics.time >= run.agreement.lift_off[0][0]
    apart = {
        name: float(np.abs(run.physics[name] - finer[name][::2])[lifted].max()) / (run.physics.scale(name) or 1.0)
        for name in run.vehicle.linear_model.outputs
    }
    apart = {name: far if math.isfinite(far) else math.inf for name, far in apart.items()}
    furthest = max(apart, key=lambda name: apart[name])
    return HalfStep(apart[furthest], furthest)
