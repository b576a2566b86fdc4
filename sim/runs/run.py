"""Runs of some controllers of one vehicle over one road: physics, linear predictions, verdicts, and their view in a notebook."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from models import USUAL_TIMESTEP
from models.common.arrays import Array
from models.common.errors import InputError, listing
from models.common.printed import Shown
from models.laws.python_law import Programmed
from models.roads.road import Road, RoadInput
from models.vehicle.mjcf import has_geometry
from models.vehicle.vehicle import Vehicle
from sim.linear.sampled_response import largest_timestep, sampled_response
from sim.physics.energy import Energy, energy
from sim.physics.simulate import PhysicsRuns, simulate
from sim.response.regime import FLAT
from sim.response.response import Response
from sim.runs.agreement import SMALL, Agreement, compare, look_closer
from sim.runs.prediction import Prediction, predict, predict_replayed, reference_at, with_noise
from synth.controller.controller import Controller, Driver
from synth.controller.open_loop import LoopModel

if TYPE_CHECKING:
    from models.figures.figure import Panel
    from sim.physics.drivers import RunDriver


STYLE = """<style>
.roadproof {max-width: 600px}
.roadproof .area, .roadproof .line, .roadproof .point {fill: none}
.roadproof .grid {stroke: #ddd}
.roadproof text {font: 12px sans-serif; fill: currentColor}
.roadproof .s-d62728 {stroke: #d62728}
.roadproof .s-1f77b4 {stroke: #1f77b4}
</style>"""
POINTS = 1000  # of a curve, at most about


class ShownRun(Shown):
    """Notebook view of a run."""

    prediction: Prediction
    physics: Response
    agreement: Agreement
    energy: Energy | None

    @property
    def shown(self) -> tuple[str, dict[str, str]]:
        """Returns the verdict, and the vehicle, road and times as text."""
        until, name = self.agreement.until, self.prediction.controller.name
        when = f"until {until:.4g} s" if math.isfinite(until) else "throughout"
        verdict = f"{'agrees' if self.agreement.agrees else 'DOES NOT AGREE'} {when}"
        if self.energy is not None:
            verdict += f"; energy {'balances' if self.energy.balances else 'DOES NOT BALANCE'}"
        road, time = self.prediction.road.describe(), self.physics.time
        return f"run of {name}: {verdict}", {
            "vehicle": self.prediction.vehicle.kind.name,
            "road": ", ".join(f"{what} {value}" for what, value in road.items()),
            "time": f"{time[-1]:g} s at {time[1]:g} s",
        }

    def _repr_html_(self) -> str:
        from models.figures.svg import svg

        drawn = svg(self._panel(), "run", wide=True)
        return f'{super()._repr_html_()}{STYLE}<div class="roadproof">{drawn}</div>'

    def _panel(self) -> "Panel":
        """The signal whose weighted peak is largest: MuJoCo, red, over the sampled response, blue."""
        from models.figures.figure import Curve, Panel

        physics, sampled = self.physics, self.prediction.sampled
        weights = {name: weight for name, weight in self.prediction.vehicle.performance.items() if weight}
        most = max(weights, key=lambda name: weights[name] * float(np.nan_to_num(sampled.peak(name), posinf=0.0)))
        unit = next(signal.unit for signal in physics.signals if signal.name == most)
        every = -(-len(physics.time) // POINTS)
        curves = tuple(
            Curve(
                response.time[::every],
                np.where(np.isfinite(response[most][::every]), response[most][::every], np.nan),
                label=label,
                color=color,
                width=width,
            )
            for response, label, color, width in ((sampled, "sampled", "#1f77b4", 3.0), (physics, "MuJoCo", "#d62728", 1.2))
        )
        title = f"{self.prediction.controller.name}: MuJoCo (red) over the sampled response (blue)"
        return Panel(title, "time [s]", f"{most.replace('_', ' ')} [{unit}]", curves)


MOST_SAMPLES = 1_000_000  # a run of these takes 0.4 GB and half a minute


@dataclass(frozen=True)
class HalfStep:
    """Change of the physics by half the timestep, with the same sampling of the controller, after a tyre has left the road.

    After a lift-off no linear response is exact, and RK4 steps over the moments at which a tyre leaves and lands.

    Attributes:
        difference: largest difference of any signal, over its peak; infinite if one of the two runs diverged.
        signal: name of that signal.
    """

    difference: float
    signal: str


@dataclass(frozen=True, eq=False, repr=False)
class Run(ShownRun):
    """Run of physics with its prediction.

    Attributes:
        prediction: linear analysis of this vehicle, controller and road.
        physics: the response in MuJoCo.
        agreement: physics against analysis.
        qpos: generalized positions of the physics, shape (T, nq), to draw it, or None for a run that is read from a log.
        energy: energy balance, or None for such a run.
        half_step: accuracy of the physics after a lift-off. None if no tyre lifted, the run broke off, or the measurements are
            noisy or quantised, which differs at other steps.
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
    def controller(self) -> Driver:
        """Returns the controller of the run."""
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
        """Returns the event that ended the vehicle and its time [s], after which all numbers are meaningless, or None."""
        ends = {FLAT.name: self.agreement.ended[FLAT.name], "divergence": self.diverged}
        first = min(ends, key=lambda name: ends[name])
        return (first, ends[first]) if math.isfinite(ends[first]) else None

    @property
    def agrees(self) -> bool:
        """Returns True if physics agrees with its analysis, for as long as that applies."""
        return self.agreement.agrees

    @property
    def holds(self) -> bool:
        """Returns True if physics agrees with its analysis, and its energy balances, if that is known."""
        return self.agrees and (self.energy is None or self.energy.balances)


def sample_times(vehicle: Vehicle, duration: float, timestep: float) -> Array:
    """Returns the sample times 0, h, 2 h, ... up to the duration [s].

    Args:
        vehicle: the vehicle, on which RK4 has to be stable.
        duration: of the run [s].
        timestep: h [s].

    Raises:
        InputError: a timestep or duration that is not positive, too large for RK4 on this vehicle, or far too many samples.

    Example:
        >>> from models import read_vehicle
        >>> from sim import sample_times
        >>> sample_times(read_vehicle("quarter_car"), duration=3.0, timestep=1e-3).shape
        (3001,)
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


def _check_noise(vehicle: Vehicle, controllers: Sequence[Driver]) -> None:
    """Refuses noise or quantisation of a signal that no controller measures, of these or of the vehicle file."""
    measured = {name for controller in (*controllers, *vehicle.controllers.values()) for name in controller.measured}
    how = vehicle.implementation
    for kind, values in {"noise": how.noise, "quantisation": how.quantisation}.items():
        for name in values:
            if measured and name not in measured:
                raise InputError(f"[implementation] {kind} of {name!r}, which is not measured; measured are: {listing(measured)}")


@np.errstate(over="ignore", invalid="ignore")  # an unstable loop overflows; its run says so
def run_all(vehicle: Vehicle, controllers: Sequence[Driver], road: Road, time: Array) -> list[Run]:
    """Runs every controller over the road, from rest, and compares.

    Args:
        time: equidistant sample times from 0 [s], see `sample_times`.
    """
    _check_noise(vehicle, controllers)
    ahead = not vehicle.dampers  # what those do follows from what physics has made of them
    met = RoadInput(vehicle, road, time)
    known = [
        predict(LoopModel(vehicle, each, met.timestep), met) if ahead and isinstance(each, Controller) else each
        for each in controllers
    ]
    made = simulate(controllers, [met] * len(controllers))
    predictions = [
        each if isinstance(each, Prediction) else predict_replayed(each, met, made.run(i), made.asked[i])
        for i, each in enumerate(known)
    ]
    return balanced(judge(predictions, [made.run(i) for i in range(len(predictions))]), made)


@dataclass(frozen=True, eq=False)
class Reference:
    """Run for comparison in tables, without a verdict.

    Attributes:
        physics: response in MuJoCo.
        sampled: exact linear response of the sampled loop.
    """

    physics: Response
    sampled: Response


@np.errstate(over="ignore", invalid="ignore")
def reference(vehicle: Vehicle, controller: Controller, road: Road, time: Array) -> Reference:
    """Runs a linear controller as `run_all` does, without verdict. Arguments as there."""
    met = RoadInput(vehicle, road, time)
    made = simulate([controller], [met])
    if vehicle.dampers:
        return Reference(made.run(0), predict_replayed(controller, met, made.run(0), made.asked[0]).sampled)
    return Reference(made.run(0), sampled_response(LoopModel(vehicle, controller, met.timestep), met))


def judge(predictions: Sequence[Prediction], physics: Sequence[Response]) -> list[Run]:
    """Compares the physics of some runs, new or from a log, with their predictions.

    Args:
        predictions: over the same sample times, of vehicles of the same kind.
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
    """Adds the results of MuJoCo's own states to runs: positions, energy, and the change by half the step after a lift-off.

    Args:
        runs: over the same sample times, of vehicles of the same kind.
        made: the same runs with their states.
    """
    runs = [
        replace(run, qpos=made.qpos[i], energy=energy(made, i, run.prediction.input, until=run.agreement.ended[FLAT.name]))
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
    vehicle: Callable[[Vehicle], Vehicle],
    share: float = 1.0,
) -> PhysicsRuns:
    """Simulates the runs of some predictions, with other vehicles and a share of the road on request.

    Vehicles and roads that runs share remain shared. A law in Python is not run again: the same share of its forces is
    replayed.
    """
    vehicles = {id(each.vehicle): vehicle(each.vehicle) for each in predictions}
    roads = {id(each.road): each.road if share == 1 else each.road.scaled(share) for each in predictions}
    met = [RoadInput(vehicles[id(each.vehicle)], roads[id(each.road)], time) for each in predictions]
    return simulate([driver_again(each, time, share) for each in predictions], met)


def driver_again(prediction: Prediction, time: Array, share: float = 1.0) -> "RunDriver":
    """Returns the driver that repeats a run.

    Args:
        time: sample times of the repeated run [s], whose timestep divides that of the prediction.
        share: of the forces of a law in Python.
    """
    if not isinstance(prediction.controller, Programmed):
        return prediction.controller
    held = round(prediction.timestep / float(time[1]))
    from sim.linear.dampers import scaled_commands
    from sim.physics.drivers import RecordedForces

    asked = scaled_commands(prediction.vehicle, prediction.asked, share)
    return RecordedForces(prediction.controller.measured, np.repeat(asked, held, axis=0)[: len(time)])


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


def run(
    vehicle: Vehicle,
    controllers: Sequence[Driver],
    road: Road,
    duration: float = 3.0,
    timestep: float = USUAL_TIMESTEP,
) -> list[Run]:
    """Returns a run for each controller, over the road from rest: MuJoCo, the linear prediction, and whether they agree.

    Args:
        vehicle: the vehicle.
        controllers: its controllers, as `synth.design_controllers` makes them.
        road: the road, such as `models.Bump(height=0.1)`.
        duration: of the run [s].
        timestep: of MuJoCo [s], and the controllers' sample period where the vehicle file says none.

    Raises:
        InputError: the road cannot be driven by this vehicle, a time is not allowed, or noise is of what nobody measures.

    Example:
        >>> from models import Bump, read_vehicle
        >>> from sim import run
        >>> from synth import design_controllers
        >>> vehicle = read_vehicle("quarter_car")
        >>> [passive] = run(vehicle, design_controllers(vehicle, ["passive"]), Bump(height=0.05), duration=1.0)
        >>> passive.agrees, passive.physics["tyre_deflection"].shape
        (True, (1001,))
    """
    time = sample_times(vehicle, duration, timestep)
    road.check(vehicle, time)
    return run_all(vehicle, controllers, road, time)
