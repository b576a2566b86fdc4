"""Bump height at which the linear regime ends, predicted by one linear response, and confirmed by one MuJoCo run below and one
above.

The linear regime ends when any signal reaches its limit in `REGIME_ENDS`. Up to the end of the linear regime, the response is
proportional to the bump height, so one response predicts the height of the end. MuJoCo simulates one bump slightly below the
predicted height, and one bump slightly above. Rotation of bodies, nonlinear springs and dampers, loads or noise can change the
height at which the regime ends. If the two runs do not enclose the correct height, the next height follows from the largest
signal of the highest run below the limit.

The analysis includes semi-active dampers, because at every height these dampers cannot apply some forces of a linear
controller.
"""

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.roads.loads.load import Load
from models.roads.road import HIGHEST, Bump, Road
from models.vehicle.vehicle import Vehicle
from sim.drive.case import Case
from sim.drive.regime import END_NAMES
from sim.drive.response import Response
from sim.observers.recorder import record
from sim.runs.agreement import first_loose
from sim.studies.validity.map_runs import MapRun, analysed_each, drive_bumps, largest_difference, shares, with_loads
from synth.controller.controller import Controller

WITHIN = 1.001  # MuJoCo simulates the predicted height divided by this factor, and multiplied by it
# because bodies rotate, another limit may be reached first if its height is within this factor of the predicted height
NEAR = 1.03
FURTHEST = 4.0  # largest bump height to try, relative to the predicted height
ROUNDS = 8  # largest number of times that MuJoCo runs are repeated at other heights
# Largest number of analyses to find the height at which a vehicle with nonlinear springs or dampers reaches a limit
ANALYSES = 20
# A run can be cut off early if, relative to the limits, all signals afterwards are below OVER times the largest one. The number
# of end times that are tried is CUTS.
OVER, CUTS = 0.8, 30


@dataclass(frozen=True)
class RegimeEnd:
    """End of the linear regime of one controller, for bumps of one length at one speed.

    Attributes:
        predicted: predicted bump height at which the first limit is reached [m].
        predicted_end: name of the limit in `REGIME_ENDS` that is predicted to be reached first.
        near: names of the limits that are predicted to be reached at heights up to `NEAR` times the predicted height.
        stays: height of the highest MuJoCo bump at which no limit is reached [m]; 0 if there is no such bump.
        leaves: height of the lowest MuJoCo bump at which a limit is reached [m]; infinite if there is no such bump.
        end: name of the limit that is reached first at the height `leaves`; empty if there is no such bump.
        error: largest difference between the run at height `stays` and the analysis, relative to the peak of the signal; 0 if
            the run is not compared. The comparison with the analysis ends when a tyre may lift off within a timestep.
    """

    predicted: float
    predicted_end: str
    near: tuple[str, ...]
    stays: float
    leaves: float
    end: str
    error: float = 0.0

    @property
    def confirmed(self) -> bool:
        """True if the limit that MuJoCo reaches first is the predicted limit, or any other limit of `near`."""
        return self.end in self.near and self.stays > 0

    @property
    def found(self) -> float:
        """Bump height at which MuJoCo reaches the first limit [m], taken as midway between the two runs."""
        return (self.stays + self.leaves) / 2


def regime_ends(vehicle: Vehicle, controllers: Sequence[Controller], bump: Bump, time: Array) -> list[RegimeEnd | None]:
    """Returns the end of the linear regime for each controller; None if no limit is reached at any allowed height.

    Args:
        vehicle: vehicle that the controllers control.
        controllers: controllers with stable loops.
        bump: bump with the length and speed of interest; the response over this bump predicts the responses at other heights.
        time: equidistant sample times from 0 [s], shape (T,).
    """
    ends = enclose_ends(vehicle, controllers, [bump] * len(controllers), time)
    below = [(i, end) for i, end in enumerate(ends) if end is not None and end.stays > 0]
    if not below:
        return ends
    cases = [Case(vehicle, controllers[i], replace(bump, height=end.stays)) for i, end in below]
    analyses = analysed_each(vehicle, [controllers[i] for i, _ in below], [one.road for one in cases], time)
    for (i, end), run, analysis in zip(below, record(cases, time), analyses, strict=True):
        until = first_loose(run.input, run.response)
        ends[i] = replace(end, error=largest_difference(vehicle, run.response.until(until), analysis.until(until)))
    return ends


@np.errstate(over="ignore", invalid="ignore")  # the signals of an unstable loop overflow
def enclose_ends(
    vehicle: Vehicle,
    controllers: Sequence[Controller],
    bumps: Sequence[Bump],
    time: Array,
    loads: tuple[Load, ...] = (),
    within: float = WITHIN,
) -> list[RegimeEnd | None]:
    """Finds the bump height at which the linear regime ends for each of N lengths and speeds; each height lies between two
    MuJoCo runs.

    Args:
        vehicle: vehicle that the controllers control.
        controllers: N controllers, one for each of the bumps.
        bumps: N bumps with the lengths and speeds of interest; the responses over these bumps predict the responses at other
            heights.
        time: equidistant sample times from 0 [s], shape (T,).
        loads: loads on the body that act over each bump.
        within: factor between the predicted height and the heights of the two MuJoCo runs, see `WITHIN`.

    Returns:
        End of the linear regime for each bump; None if no limit is reached at any allowed height.
    """
    ends, samples, tried = dict[int, RegimeEnd](), dict[int, int](), dict[int, list[tuple[float, MapRun]]]()
    for i, (response, used) in enumerate(_predict_ends(vehicle, controllers, bumps, loads, time)):
        if used.max() * HIGHEST >= FURTHEST:
            near = tuple(end for end, use in zip(END_NAMES, used, strict=True) if use * NEAR >= used.max())
            ends[i] = RegimeEnd(float(1 / used.max()), END_NAMES[int(used.argmax())], near, 0.0, math.inf, "")
            samples[i], tried[i] = _needed_samples(vehicle, controllers[i], response), []
    guess = {i: end.predicted for i, end in ends.items()}
    for _ in range(ROUNDS):
        todo = [i for i, end in ends.items() if _is_open(end, within)]
        heights = [(i, guess[i] * factor) for i in todo for factor in (1 / within, within)]
        roads = [with_loads(replace(bumps[i], height=math.copysign(height, bumps[i].height)), loads) for i, height in heights]
        runs = [(controllers[i], road, samples[i]) for (i, _), road in zip(heights, roads, strict=True)]
        for (i, height), result in zip(heights, drive_bumps(vehicle, runs, time), strict=True):
            tried[i].append((height, result))
        for i in todo:
            high, end = min(((height, result.end) for height, result in tried[i] if result.end), default=(math.inf, ""))
            whole = sorted((height, result.share) for height, result in tried[i] if not result.end and height < high)
            ends[i] = replace(ends[i], stays=whole[-1][0] if whole else 0.0, leaves=high, end=end)
            guess[i] = _next([(0.0, 0.0), *whole], high, within) if whole else high / NEAR ** len(tried[i])
    return [ends.get(i) for i in range(len(bumps))]


def _predict_ends(
    vehicle: Vehicle, controllers: Sequence[Controller], bumps: Sequence[Bump], loads: tuple[Load, ...], time: Array
) -> "list[PredictedResponse]":
    """Returns the predicted response of each controller over the bump that belongs to this controller. The responses of all
    searches are computed simultaneously.
    """
    searches = [_search(vehicle, *both, loads) for both in zip(controllers, bumps, strict=True)]
    results, roads = dict[int, PredictedResponse](), {i: next(search) for i, search in enumerate(searches)}
    while roads:
        responses = analysed_each(vehicle, [controllers[i] for i in roads], [*roads.values()], time)
        for i, response in zip([*roads], responses, strict=True):
            try:
                roads[i] = searches[i].send(response)
            except StopIteration as end:
                results[i] = end.value
                del roads[i]
    return [results[i] for i in range(len(searches))]


PredictedResponse = tuple[Response, Array]  # a response, and its values per metre of height, relative to each limit, shape (E,)


def _search(
    vehicle: Vehicle, controller: Controller, bump: Bump, loads: tuple[Load, ...]
) -> Generator[Road, Response, PredictedResponse]:
    """Returns a generator that yields roads, receives the computed responses over these roads, and finally returns the
    prediction.

    For a vehicle with linear springs and dampers, one response is sufficient. For any other vehicle, the analysis is nonlinear,
    and a loop may be unstable above some height. For a nonlinear analysis, the search finds the lowest height at which the
    analysis reaches a limit.
    """
    height, low, high, at_end, tried = abs(bump.height), 0.0, math.inf, None, 0
    while True:
        response = yield with_loads(replace(bump, height=math.copysign(height, bump.height)), loads)
        used = shares(vehicle, controller, response)
        share = float(used.max())
        if not (vehicle.parts.nonlinear and 0 < share < math.inf) or 1 / WITHIN < share < WITHIN:
            return response, used / height
        if share > 1:
            high, at_end = height, (response, used / (share * height))
        else:
            low = height
        tried += 1
        if high < low * WITHIN**2 or low >= HIGHEST or tried == ANALYSES:
            return at_end or (response, used / height)
        nearer, between = height / share, math.sqrt(low * high)
        height = nearer if not 0 < between < math.inf or (abs(share - 1) < 0.5 and low < nearer < high) else between
        height = min(height, HIGHEST)


def _is_open(end: RegimeEnd, within: float) -> bool:
    """Returns True if the end of the linear regime is not yet between two runs, but may be at an allowed height."""
    highest = min(FURTHEST * end.predicted, HIGHEST / within**2)
    return end.leaves > end.stays * within**2 * (1 + 1e-9) and end.stays < highest


def _next(whole: Sequence[tuple[float, float]], high: float, within: float) -> float:
    """Returns the next bump height to try [m].

    Args:
        whole: ascending bump heights at which no limit is reached [m], each with the largest signal relative to its limit.
        high: lowest bump height at which a limit is reached [m]; infinite if there is no such height.
        within: factor between the predicted height and the heights of the two MuJoCo runs.
    """
    (before, share_before), (low, share) = whole[-2:]
    height = low + (1 - share) * (low - before) / (share - share_before) if share > share_before else math.inf
    if low * within < height < high / within:
        return min(height, 2 * low)
    return math.sqrt(low * high) if math.isfinite(high) else low * within**2


def _needed_samples(vehicle: Vehicle, controller: Controller, response: Response) -> int:
    """Returns the number of samples after which all signals of a response stay too small to reach a limit."""
    count, most = len(response.time), shares(vehicle, controller, response).max()
    if vehicle.implementation.has_measurement_noise:  # measurement noise does not decay, so the run has no quiet end
        return count
    for cut in range(count // CUTS, count - 1, max(1, count // CUTS)):
        rest = Response(response.time[cut:], response.signals, response.values[cut:])
        if shares(vehicle, controller, rest).max() < OVER * most:
            return cut
    return count
