"""Runs over the bumps of a map of validity, computed by linear analysis and in MuJoCo."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.roads.loads.load import Load
from models.roads.loads.road_with_loads import RoadWithLoads
from models.roads.road import Road, RoadInput
from models.vehicle.vehicle import Vehicle
from sim.drive.case import Case
from sim.drive.loop import runs_at_once
from sim.drive.regime import DAMPER, DIVERGENCE, END_NAMES, LAW_OVERFLOW, REGIME_ENDS, end_times, first_end, utilisation
from sim.drive.response import Response, difference
from sim.linear.dampers import squarable
from sim.linear.sampled_response import sampled_responses
from sim.linear.stepped import stepped_runs
from sim.observers.recorder import Recording, record
from synth.controller.controller import Controller, is_linear

AT_ONCE = 32  # largest number of runs in a batch; in a larger batch, short runs would wait for the longest run


@dataclass(frozen=True)
class MapRun:
    """Result of one MuJoCo run over a bump.

    Attributes:
        share: largest value of any signal relative to its limit in `REGIME_ENDS`.
        first: first limit that was reached in the run, as an index into `REGIME_ENDS`; -1 if no limit was reached.
        time: time at which the first limit was reached [s]; infinite if no limit was reached.
        broke_off: reason why the run was aborted, `DIVERGENCE` or `LAW_OVERFLOW`; empty if the run was not aborted.
        error: largest difference of any signal from linear analysis with linearised springs and dampers, relative to the
            signal's peak.
        missing: rms of the part of the requested force that semi-active dampers could not apply, relative to the rms of the
            requested force. `missing` is 0 if no force was requested, and NaN if there are no semi-active dampers.
    """

    share: float
    first: int
    time: float
    broke_off: str
    error: float
    missing: float

    @property
    def end(self) -> str:
        """Name of the first limit that was reached, or the reason why the run was aborted; empty if neither happened."""
        return END_NAMES[self.first] if self.first >= 0 else self.broke_off


def with_loads(bump: Road, loads: tuple[Load, ...]) -> Road:
    """Returns a bump combined with loads on the body; if there are no loads, the unchanged bump."""
    return RoadWithLoads(bump, loads) if loads else bump


def analyse_bumps(vehicle: Vehicle, controller: Controller, roads: Sequence[Road], time: Array) -> Response:
    """Returns the responses of one controller over N roads, computed by analysis; the values of the responses have the shape
    (N, T, S).

    The analysis takes account of nonlinear springs and dampers, and of semi-active dampers.
    """
    inputs = [RoadInput(vehicle, road, time) for road in roads]
    if is_linear(controller, vehicle):
        return sampled_responses(controller, inputs)
    return stepped_runs([controller] * len(inputs), inputs).response


def analysed_each(vehicle: Vehicle, controllers: Sequence[Controller], roads: Sequence[Road], time: Array) -> list[Response]:
    """Returns the response of each controller over the road that belongs to this controller, computed by analysis. All
    nonlinear responses are computed simultaneously.
    """
    bent = [i for i, one in enumerate(controllers) if vehicle.parts.nonlinear or not is_linear(one, vehicle)]
    responses = dict[int, Response]()
    for some in (bent[k : k + AT_ONCE] for k in range(0, len(bent), AT_ONCE)):
        runs = stepped_runs([controllers[i] for i in some], [RoadInput(vehicle, roads[i], time) for i in some]).response
        responses |= {i: runs.run(k) for k, i in enumerate(some)}
    linear = [i for i in range(len(roads)) if i not in responses]
    responses |= {i: analyse_bumps(vehicle, controllers[i], [roads[i]], time).run(0) for i in linear}
    return [responses[i] for i in range(len(roads))]


def shares(vehicle: Vehicle, controller: Controller, response: Response) -> Array:
    """Returns the largest values of a response's signals, relative to the limits in `REGIME_ENDS`, shape (..., E).

    The entry for the missing force of semi-active dampers is 0, because the analysis includes these dampers.
    """
    used = utilisation(vehicle, response, controller.has_anti_windup)
    if not is_linear(controller, vehicle):
        used[..., REGIME_ENDS.index(DAMPER)] = 0.0
    return used


def largest_difference(vehicle: Vehicle, physics: Response, analysis: Response) -> float:
    """Returns the largest difference of any output signal from analysis, relative to the signal's peak; infinite if the run
    diverged.
    """
    apart = float(np.abs(difference(physics, analysis.only(vehicle.linear_model.outputs)).values).max())
    return math.inf if math.isnan(apart) else apart


def drive_bumps(vehicle: Vehicle, runs: Sequence[tuple[Controller, Road, int]], time: Array) -> list[MapRun]:
    """Simulates runs over roads in MuJoCo.

    Args:
        vehicle: vehicle that is simulated.
        runs: controller, road and requested number of samples of each run. A run may be longer than requested, because all runs
            of a batch have the same length.
        time: sample times of the longest run [s], shape (T,).
    """
    order = sorted(range(len(runs)), key=lambda i: runs[i][2])
    at_once = min(AT_ONCE, runs_at_once(len(time), len(vehicle.kind.wheels)))
    results = dict[int, MapRun]()
    for chunk in np.array_split(order, math.ceil(len(runs) / at_once)) if runs else ():
        controllers, roads, samples = zip(*(runs[i] for i in chunk), strict=True)
        until = time[: max(samples)]
        cases = [Case(vehicle, controller, road) for controller, road in zip(controllers, roads, strict=True)]
        results |= zip(chunk.tolist(), map(_result, controllers, record(cases, until, threads=0)), strict=True)
    return [results[i] for i in range(len(runs))]


def _result(controller: Controller, run: Recording) -> MapRun:
    """Returns the result of a MuJoCo run that was recorded."""
    vehicle, response, diverged = run.vehicle, run.response, run.diverged
    times, missing = end_times(vehicle, response, controller.has_anti_windup), math.nan
    if not is_linear(controller, vehicle):
        times[REGIME_ENDS.index(DAMPER)] = np.inf
    if vehicle.parts.adjustable:
        lost = squarable(np.nan_to_num([response[one.missing] for one in vehicle.parts.adjustable]))
        requested = np.sum((np.nan_to_num([response[one.force] for one in vehicle.parts.adjustable]) + lost) ** 2)
        missing = math.sqrt(np.sum(lost**2) / requested) if requested > 0 else 0.0
    ended = float(times.min()) < diverged
    broke_off = "" if math.isinf(diverged) else LAW_OVERFLOW if response.law_diverged else DIVERGENCE
    linear = sampled_responses(controller, [RoadInput(vehicle.linearised, run.case.road, run.input.time)]).run(0)
    return MapRun(
        float(np.nanmax(shares(vehicle, controller, response))),
        int(first_end(times)) if ended else -1,
        float(times.min()) if ended else math.inf,
        broke_off,
        largest_difference(vehicle, response, linear),
        missing,
    )
