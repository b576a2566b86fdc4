"""The height of a bump at which the linear regime ends: predicted by one linear response, and enclosed by two MuJoCo runs.

Before anything breaks the response is proportional to the height, so the height is one over the share of the way to the end per
metre. MuJoCo runs a bump just below it and one just above. Where they do not enclose the end, as with rotating bodies, curves,
loads or noise, the share that the highest run without an end has reached tells where to look next.

With adjustable dampers it is the end of the analysis that has them: dampers leave a linear controller short at any height.
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

WITHIN = 1.001  # factor on the height, either way, within which MuJoCo runs enclose an end
NEAR = 1.03  # factor within which another end may come first: a body that rotates moves an end by so much
FURTHEST = 4.0  # factor on the predicted height, more than any vehicle should need
ROUNDS = 8  # of runs, for an end that is not where it is predicted
ANALYSES = 20  # of bumps, to find the height at which a vehicle with curves reaches an end
OVER, CUTS = 0.8, 30  # share of the largest one from which on the rest of a run is left out, looked for at so many times


@dataclass(frozen=True)
class RegimeEnd:
    """End of the linear regime of one controller, over bumps of one length and speed.

    Attributes:
        predicted: height of the end by analysis [m].
        predicted_end: name of the predicted end in `REGIME_ENDS`.
        near: names of the ends within `NEAR` of that height.
        stays: highest bump in MuJoCo without an end [m]; 0 if every bump had one.
        leaves: lowest bump in MuJoCo with an end [m], or infinity.
        end: first end there, of `REGIME_ENDS`; empty without an end.
        error: largest difference of the run at `stays` from the analysis, over any signal's peak, until a tyre may leave the road
            within a step; 0 if it is not compared.
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
        """Returns True if MuJoCo has an end, and it is the predicted one, or one as near."""
        return self.end in self.near and self.stays > 0

    @property
    def found(self) -> float:
        """Returns the height of the end in MuJoCo [m], midway between the two runs."""
        return (self.stays + self.leaves) / 2


def regime_ends(vehicle: Vehicle, controllers: Sequence[Controller], bump: Bump, time: Array) -> list[RegimeEnd | None]:
    """Returns where the linear regime ends over bumps of this length and speed, or None if no allowed height has an end.

    Args:
        controllers: controllers whose loops are stable.
        bump: bump from whose response all others are predicted.
        time: equidistant sample times from 0 [s].
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


@np.errstate(over="ignore", invalid="ignore")  # an unstable loop overflows
def enclose_ends(
    vehicle: Vehicle,
    controllers: Sequence[Controller],
    bumps: Sequence[Bump],
    time: Array,
    loads: tuple[Load, ...] = (),
    within: float = WITHIN,
) -> list[RegimeEnd | None]:
    """Returns the ends of the linear regime over bumps of N lengths and speeds, each enclosed by MuJoCo runs.

    Args:
        controllers: N controllers.
        bumps: bumps from whose responses all others are predicted.
        time: equidistant sample times from 0 [s].
        loads: loads on the body over every bump.
        within: factor on the height, either way, between the runs.

    Returns:
        An end for each bump, or None if no allowed height has one.
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
    """Returns the prediction of each controller over its bump. All searches take their next heights side by side."""
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


PredictedResponse = tuple[Response, Array]  # a response, and the share of the way to each end per metre of height, shape (E,)


def _search(
    vehicle: Vehicle, controller: Controller, bump: Bump, loads: tuple[Load, ...]
) -> Generator[Road, Response, PredictedResponse]:
    """Yields the roads of which it needs the response of the analysis, and returns the prediction.

    Curves make the analysis nonlinear, and a loop may lose its stability beyond some height. So with curves the lowest height is
    looked for at which the analysis reaches an end.
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
    """Returns True if an end is not enclosed yet, and may be at an allowed height."""
    highest = min(FURTHEST * end.predicted, HIGHEST / within**2)
    return end.leaves > end.stays * within**2 * (1 + 1e-9) and end.stays < highest


def _next(whole: Sequence[tuple[float, float]], high: float, within: float) -> float:
    """Returns the height to be looked at next [m].

    Args:
        whole: heights of bumps without an end, ascending, and the shares of the way to an end that they reached.
        high: lowest height with an end [m], or infinity.
    """
    (before, share_before), (low, share) = whole[-2:]
    height = low + (1 - share) * (low - before) / (share - share_before) if share > share_before else math.inf
    if low * within < height < high / within:
        return min(height, 2 * low)
    return math.sqrt(low * high) if math.isfinite(high) else low * within**2


def _needed_samples(vehicle: Vehicle, controller: Controller, response: Response) -> int:
    """Returns the number of samples after which a response is so much smaller than before that no end comes any more."""
    count, most = len(response.time), shares(vehicle, controller, response).max()
    if vehicle.implementation.has_measurement_noise:  # which is as large later
        return count
    for cut in range(count // CUTS, count - 1, max(1, count // CUTS)):
        rest = Response(response.time[cut:], response.signals, response.values[cut:])
        if shares(vehicle, controller, rest).max() < OVER * most:
            return cut
    return count
