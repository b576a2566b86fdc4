"""Runs of several controllers of one vehicle over one road: simulation, linear predictions and verdicts."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.common.checks import Time
from models.common.errors import InputError
from models.common.extensions import FEATURES, OBSERVERS
from models.document.document import Block, Document
from models.document.text import ShownResult, facts
from models.roads.road import Road
from models.vehicle.mjcf import has_geometry
from models.vehicle.names import PASSIVE
from models.vehicle.vehicle import Vehicle
from sim.drive.case import Case
from sim.drive.regime import FLAT
from sim.drive.response import Response
from sim.linear.prediction import Prediction, predict_run
from sim.linear.sampled_response import largest_timestep
from sim.observers.recorder import Recording, record
from sim.observers.results import Energy
from sim.runs.agreement import SMALL, compare
from sim.runs.result import HalfStep, RunResult
from synth.controller.controller import AnyController, Controller

if TYPE_CHECKING:
    from sim.drive.driver import RunDriver
    from sim.runs.code_effect import CodeEffect

RK4_REACH = 2.7  # largest product of rate and time step at which RK4 counts as stable for a first-order lag; exactly 2.785
MOST_SAMPLES = 1_000_000  # largest number of samples in a run; such a run takes 0.4 GB and half a minute
STIFF = 1e-4  # s; a vehicle that needs a shorter time step is probably not given in SI units


@dataclass(frozen=True, eq=False, repr=False)
class Run(RunResult, ShownResult):
    """Simulated run with its linear prediction, which can be displayed at a Python prompt and in a notebook.

    The attributes are those of `RunResult`.
    """

    @property
    def summary(self) -> Document:
        """Document that contains the verdict, the vehicle, the road and the times of the run."""
        from sim.runs.report import verdict

        rows = {
            "vehicle": self.vehicle.kind.name,
            "road": self.road.words,
            "time": f"{self.physics.time[-1]:g} s, step {1e3 * self.physics.time[1]:g} ms",
            **({"undecided": "; ".join(self.undecided)} if self.undecided else {}),
        }
        return facts(f"run of {self.controller.name}: {verdict(self).text}", rows)

    @property
    def figures(self) -> tuple[Block, ...]:
        """Table of the peak and rms of all signals, and a plot of the first signal with a weight over time."""
        from sim.runs.report import signal_table

        return (signal_table(self), *FEATURES.load("time histories").first_history(self))


def sample_times(vehicle: Vehicle, duration: Time, timestep: Time) -> Array:
    """Returns the sample times 0, h, 2 h, ... up to the duration [s].

    Args:
        vehicle: vehicle for which RK4 must be stable with the time step h.
        duration: duration of the run [s].
        timestep: time step h [s].

    Returns:
        The sample times [s], shape (T,).

    Raises:
        InputError: a time step or a duration is not positive, the time step is too large for RK4 with this vehicle, or there
            are too many samples.

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
        above = f"RK4 is unstable on this vehicle above {largest:.3g} s"
        lag = max((damper.bandwidth or 0.0 for damper in vehicle.dampers.values()), default=0.0)
        if lag * largest > RK4_REACH:
            raise InputError(
                f"timestep = {timestep} s is too large: {above}, because of [actuators] bandwidth = {lag:g} rad/s; give a "
                "smaller timestep or bandwidth"
            )
        own = {one.name: one.part.line.rates[:, : len(one.states)] for one in vehicle.parts if one.part.line.rates is not None}
        slow = {name: float(np.abs(np.linalg.eigvals(rates)).max()) for name, rates in own.items()}
        fastest = slow | {one.name: one.part.fastest for one in vehicle.parts if one.part.fastest > slow.get(one.name, 0.0)}
        if fastest and (rate := max(fastest.values())) * largest > RK4_REACH:
            name = max(fastest, key=lambda one: fastest[one])
            raise InputError(
                f"timestep = {timestep} s is too large: {above}, because a state of [parts.{name}] changes at a rate of "
                f"{rate:.4g} 1/s{' at 2 m/s' * (rate > slow.get(name, 0.0))}; give a smaller timestep, or change "
                f"[parts.{name}] to slow this state down"
            )
        units = ", and check that masses are in kg, stiffness in N/m and damping in N s/m"
        about_numbers = FEATURES.load_if_known("doubts about numbers")
        if about_numbers and (improbable := about_numbers.vehicle_remarks(vehicle)):
            raise InputError(f"timestep = {timestep} s is too large: {above}; {improbable[0]}")
        instead = "give 0.001, for example" if largest > 1e-3 else f"give a smaller timestep{units if largest < STIFF else ''}"
        raise InputError(f"timestep = {timestep} s is too large: {above}; {instead}")
    if duration < 2 * timestep:
        raise InputError(f"duration = {duration} s is shorter than two timesteps of {timestep} s; give a longer duration")
    if duration / timestep > MOST_SAMPLES:
        raise InputError(
            f"duration / timestep = {duration / timestep:.2g} samples are too many; give a shorter duration or a larger "
            f"timestep, for at most {MOST_SAMPLES} samples"
        )
    return np.arange(round(duration / timestep) + 1) * timestep


@np.errstate(over="ignore", invalid="ignore")  # the signals of an unstable loop overflow; the run records this
def run_controllers(
    vehicle: Vehicle, controllers: Sequence[AnyController], road: Road, time: Array, balanced: bool = True
) -> list[Run]:
    """Simulates each controller over a road, starting from equilibrium, and compares the responses with linear analysis.

    Args:
        time: equidistant sample times from 0 [s], see `sample_times`.
        balanced: False to omit the positions, the energy balance, and the comparison with a run at half the time step.
    """
    recordings = record([Case(vehicle.with_actuators_of(one.name), one, road) for one in controllers], time)
    each = zip(controllers, recordings, strict=True)
    runs = compare_runs([predict_run(controller, one.input, one.commands) for controller, one in each], recordings)
    return with_energy_balance(runs, recordings) if balanced else runs


def passive_beside(runs: Sequence[Run], design: Callable[[str], Controller]) -> Response:
    """Returns MuJoCo's response of the passive vehicle, from one of the runs if possible, otherwise from a new run.

    Args:
        runs: runs of several controllers over one road.
        design: function that returns the passive controller from its name.
    """
    made, on = next((run.physics for run in runs if run.controller.name == PASSIVE), None), runs[0].prediction.input
    if made is not None:
        return made
    (passive,) = record([Case(on.vehicle, design(PASSIVE), on.road, input=on)], on.time)
    return passive.response


def compare_runs(predictions: Sequence[Prediction], recordings: Sequence[Recording]) -> list[Run]:
    """Returns the runs with a verdict on each run. A run with exported code is also compared with a run in which the control
    law itself computes the forces. For a vehicle type with rotating bodies but without equations of motion, a run on a lower
    road is also compared with linear analysis. This function also simulates the additional runs with the control law itself and
    on the lower road.

    Args:
        predictions: predictions of the runs, which have the same sample times and vehicles of the same type.
        recordings: recordings of the simulated runs, in the order of the predictions.
    """
    effects = _code_effects(predictions, recordings)
    pairs = enumerate(zip(predictions, recordings, strict=True))
    runs = [Run(foreseen, made.response, compare(foreseen, made, effects.get(i))) for i, (foreseen, made) in pairs]
    unknown = [
        i for i, run in enumerate(runs) if run.agreement.steps is None and run.prediction.is_linear and has_geometry(run.vehicle)
    ]
    if unknown:
        made = _simulate_predictions(
            [runs[i].prediction for i in unknown],
            runs[0].prediction.time,
            lambda one: replace(one, implementation=one.implementation.without_noise),
            SMALL,
        )
        for k, i in enumerate(unknown):
            runs[i] = replace(runs[i], agreement=replace(runs[i].agreement, small=made[k].response))
    return runs


def _code_effects(predictions: Sequence[Prediction], recordings: Sequence[Recording]) -> "dict[int, CodeEffect]":
    """Returns the effect of exported code on each run with exported code, by index of the run."""
    coded = [i for i, one in enumerate(predictions) if one.controller.code is not None]
    if not coded:
        return {}
    ours = [replace(predictions[i], controller=replace(predictions[i].controller, code=None)) for i in coded]
    cases = [Case(one.vehicle, one.controller, one.road, input=one.input) for one in ours]
    made, effects = record(cases, predictions[0].time), {}
    for i, law_run in zip(coded, compare_runs(ours, made), strict=True):
        one, until = predictions[i], law_run.agreement.until
        names = one.vehicle.linear_model.outputs
        effect_of = FEATURES.load("effect of exported code").code_effect
        effects[i] = effect_of(one.controller, recordings[i].response, law_run.physics, names, until, law_run.agreement.agrees)
    return effects


def with_energy_balance(runs: Sequence[Run], recordings: Sequence[Recording]) -> list[Run]:
    """Adds to each run the positions, the energy balance and, after a lift-off, the change of the response if the time step is
    halved.

    A run whose energy balance has an unusually large residual is also repeated at half the time step. If a run has noise, the
    repeated run uses the same commands.

    Args:
        runs: runs with the same sample times and with vehicles of the same type.
        recordings: recordings of the runs, in the same order.
    """
    energy: Callable[..., Energy | None] = OBSERVERS.load_if_known("energy") or (lambda run, until: None)
    runs = [
        replace(run, qpos=one.qpos, energy=energy(one, until=run.agreement.end_times[FLAT.name]))
        for run, one in zip(runs, recordings, strict=True)
    ]
    lifted = [i for i, run in enumerate(runs) if run.agreement.lift_off and run.broke_off is None and not run.prediction.varies]
    doubtful = [i for i, run in enumerate(runs) if run.energy and run.energy.doubtful]
    if halved := sorted({*lifted, *doubtful}):
        timestep = runs[0].prediction.timestep
        again = [replace(runs[i].prediction, requested_force=recordings[i].commands) for i in halved]
        halves = np.arange(2 * len(again[0].time) - 1) * (timestep / 2)
        finer = _simulate_predictions(again, halves, lambda vehicle: _sampled_as_before(vehicle, timestep))
        for k, i in enumerate(halved):
            run, balance = runs[i], runs[i].energy
            if balance and balance.doubtful and (half := energy(finer[k], until=run.agreement.end_times[FLAT.name])):
                balance = balance.with_half_step(half)
            half_step = _half_step(run, finer[k].response) if i in lifted else None
            runs[i] = replace(run, energy=balance, half_step=half_step)
    return runs


def _simulate_predictions(
    predictions: Sequence[Prediction], time: Array, vehicle: Callable[[Vehicle], Vehicle], share: float = 1.0
) -> list[Recording]:
    """Simulates the runs to which predictions belong, with vehicles changed by the function `vehicle` and road heights
    multiplied by `share`.

    Runs that share a vehicle or a road object also share the changed object. If a run has noise or a Python control law, its
    recorded commands are repeated. The repeated forces are also multiplied by the factor `share`.
    """
    vehicles = {id(each.vehicle): vehicle(each.vehicle) for each in predictions}
    roads = {id(each.road): each.road if share == 1 else each.road.scaled(share) for each in predictions}
    return record(
        [
            Case(vehicles[id(one.vehicle)], replay_driver(one, time, share), roads[id(one.road)], earlier=one.input.earlier)
            for one in predictions
        ],
        time,
    )


def replay_driver(prediction: Prediction, time: Array, share: float = 1.0) -> "RunDriver":
    """Returns the driver that repeats a run: the control law or, if the law would respond differently at a different time step,
    the recorded commands.

    Args:
        time: sample times of the repeated run [s]. The time step of the prediction is an integer multiple of the time step of
            the repeated run.
        share: factor by which the forces of a Python control law are multiplied.
    """
    if not prediction.controller.user_code and (share != 1 or not prediction.varies):
        return prediction.controller
    steps = round(prediction.timestep / float(time[1]))
    from sim.drive.driver import RecordedForces

    return RecordedForces(
        prediction.controller.measured, share * np.repeat(prediction.requested_force, steps, axis=0)[: len(time)]
    )


def _sampled_as_before(vehicle: Vehicle, timestep: float) -> Vehicle:
    """Returns the vehicle with an explicit sample period, so that a different time step does not change the sample period."""
    period = vehicle.implementation.sample_period or timestep
    return replace(vehicle, implementation=replace(vehicle.implementation, sample_period=period))


def _half_step(run: Run, finer: Response) -> HalfStep:
    """Compares a simulated run, from the first lift-off on, with the same run at half the time step."""
    lifted = run.physics.time >= run.agreement.lift_off[0][0]
    apart = {
        name: float(np.abs(run.physics[name] - finer[name][::2])[lifted].max()) / (run.physics.scale(name) or 1.0)
        for name in run.vehicle.linear_model.outputs
    }
    apart = {name: far if math.isfinite(far) else math.inf for name, far in apart.items()}
    furthest = max(apart, key=lambda name: apart[name])
    return HalfStep(apart[furthest], furthest)
