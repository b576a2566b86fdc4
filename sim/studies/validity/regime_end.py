"""The height of a bump at which the linear regime ends: predicted by one linear response, and enclosed by two MuJoCo runs.

Before anything breaks the response is proportional to the height, so the height is one over the share of the way to the end per
metre. MuJoCo runs a bump just below it and one just above. Where they do not enclose the end, as with rotating
bodies, curves, loads or noise, the share that the highest run without an end has reached tells where to look next.

With adjustable dampers it is the end of the analysis that has them: dampers leave a linear controller short at any height.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.roads.load import Load
from models.roads.loaded import RoadWithLoads
from models.roads.road import LIMITS, Bump, Road, RoadInput
from models.vehicle.vehicle import Vehicle
from sim.linear.dampers import is_linear
from sim.linear.sampled_response import sampled_responses
from sim.linear.switched_response import switched_response
from sim.physics.run_blocks import runs_at_once
from sim.physics.simulate import simulate
from sim.response.regime import DAMPER, DIVERGENCE, END_NAMES, LAW_OVERFLOW, REGIME_ENDS, first_end, reached, utilisation
from sim.response.response import Response, difference
from synth.controller.controller import Controller, has_anti_windup
from synth.controller.open_loop import LoopModel

WITHIN = 1.001  # factor on the height, either way, within which MuJoCo runs enclose an end
NEAR = 1.03  # factor within which another end may come first: a body that rotates moves an end by so much
FURTHEST = 4.0  # factor on the predicted height, more than any vehicle should need
ROUNDS = 8  # of runs, for an end that is not where it is predicted
OVER, CUTS = 0.8, 30  # share of the largest one from which on the rest of a run is left out, looked for at so many times
AT_ONCE = 16  # runs in a batch: more would wait for the longest


@dataclass(frozen=True)
class RegimeEnd:
    """End of the linear regime of one controller, over bumps of one length and speed.

    Attributes:
        predicted: height of the end by linear analysis [m].
        predicted_end: name of the predicted end in `REGIME_ENDS`.
        near: names of the ends within `NEAR` of that height.
        stays: highest bump in MuJoCo without an end [m]; 0 if every bump had one.
        leaves: lowest bump in MuJoCo with an end [m], or infinity.
        end: first end there, of `REGIME_ENDS`; empty without an end.
        error: largest difference of the run at `stays` from the analysis, over any signal's peak; 0 if it is not compared.
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
    def words(self) -> str:
        """Describes the two MuJoCo runs."""
        if not self.end:
            return f"nothing up to {self.stays:.4g} m"
        return f"nothing at {self.stays:.4g} m, {self.end} at {self.leaves:.4g} m"

    @property
    def found(self) -> float:
        """Returns the height of the end in MuJoCo [m], midway between the two runs."""
        return (self.stays + self.leaves) / 2


def loaded(bump: Road, loads: tuple[Load, ...]) -> Road:
    """Returns a bump with the loads on the body, if any."""
    return RoadWithLoads(bump, loads) if loads else bump


def analysed(vehicle: Vehicle, controller: Controller, roads: Sequence[Road], time: Array) -> Response:
    """Returns the responses of the analysis with its curves and adjustable dampers, values of shape (N, T, S)."""
    inputs = [RoadInput(vehicle, road, time) for road in roads]
    if is_linear(vehicle, controller):
        return sampled_responses(LoopModel(vehicle, controller, inputs[0].timestep), inputs)
    return switched_response(controller, inputs)


def largest_difference(vehicle: Vehicle, physics: Response, analysis: Response) -> float:
    """Returns the largest difference of a run from the analysis, of any output signal's peak."""
    return float(np.abs(difference(physics, analysis.only(vehicle.linear_model.outputs)).values).max())


def shares(vehicle: Vehicle, controller: Controller, response: Response) -> Array:
    """Returns the share of each of `REGIME_ENDS` that a response reaches, shape (..., E), without missing force of dampers."""
    used = utilisation(vehicle, response, has_anti_windup(controller))
    if not is_linear(vehicle, controller):
        used[..., REGIME_ENDS.index(DAMPER)] = 0.0
    return used


def first_in_physics(vehicle: Vehicle, controller: Controller, response: Response, diverged: Array) -> tuple[Array, Array]:
    """Returns the first end in MuJoCo, an index into `REGIME_ENDS` or -1, and its time [s] or infinity; each of shape (...).

    Args:
        response: response of MuJoCo, values of shape (..., T, S).
        diverged: time at which each run diverged [s], shape (...).
    """
    times = reached(vehicle, response, has_anti_windup(controller))
    if not is_linear(vehicle, controller):
        times[..., REGIME_ENDS.index(DAMPER)] = np.inf
    first = times.min(axis=-1)
    return np.where(first < diverged, first_end(times), -1), np.where(first < diverged, first, np.inf)


@dataclass(frozen=True, eq=False)
class Column:
    """Bumps of one length and speed, and what linear analysis says of them.

    Attributes:
        controller: the controller.
        bump: one of the bumps.
        used: shares of the ends by linear analysis, per metre of height, shape (E,).
        samples: number of samples after which no end comes any more.
    """

    controller: Controller
    bump: Bump
    used: Array
    samples: int


def needed(vehicle: Vehicle, controller: Controller, response: Response) -> int:
    """Returns the number of samples after which a response is so much smaller than before that no end comes any more."""
    count, most = len(response.time), shares(vehicle, controller, response).max()
    if vehicle.implementation.has_measurement_noise:  # which is as large later
        return count
    for cut in range(count // CUTS, count - 1, count // CUTS):
        rest = Response(response.time[cut:], response.signals, response.values[cut:])
        if shares(vehicle, controller, rest).max() < OVER * most:
            return cut
    return count


def regime_ends(vehicle: Vehicle, controllers: Sequence[Controller], bump: Bump, time: Array) -> list[RegimeEnd | None]:
    """Returns where the linear regime ends over bumps of this length and speed, or None if no allowed height has an end.

    Args:
        controllers: controllers whose loops are stable.
        bump: a bump of any height.
        time: equidistant sample times from 0 [s].
    """
    metre = replace(bump, height=1.0)
    units = [analysed(vehicle.linearised, one, [metre], time).run(0) for one in controllers]
    used = [shares(vehicle, one, unit) for one, unit in zip(controllers, units, strict=True)]
    some = [i for i, one in enumerate(used) if one.max() * LIMITS["height"][1] >= FURTHEST]
    columns = [Column(controllers[i], bump, used[i], needed(vehicle, controllers[i], units[i])) for i in some]
    found = enclosed(vehicle, columns, time)
    roads = [replace(bump, height=end.stays) for end in found]
    physics = simulate([column.controller for column in columns], [RoadInput(vehicle, road, time) for road in roads])
    ends: list[RegimeEnd | None] = [None] * len(controllers)
    for k, (i, end, road) in enumerate(zip(some, found, roads, strict=True)):
        ends[i] = replace(
            end, error=largest_difference(vehicle, physics.run(k), analysed(vehicle, controllers[i], [road], time).run(0))
        )
    return ends


@np.errstate(over="ignore", invalid="ignore")  # an unstable loop overflows
def enclosed(
    vehicle: Vehicle, columns: Sequence[Column], time: Array, loads: tuple[Load, ...] = (), within: float = WITHIN
) -> list[RegimeEnd]:
    """Returns the ends of the linear regime over bumps of N lengths and speeds, each enclosed by MuJoCo runs.

    Args:
        time: equidistant sample times from 0 [s].
        loads: loads on the body over every bump.
        within: factor on the height, either way, between the runs.
    """
    predicted = [1 / float(column.used.max()) for column in columns]
    guess, tried = [*predicted], [list[tuple[float, float, str]]() for _ in columns]  # heights, shares and ends
    for _ in range(ROUNDS):
        todo = [i for i in range(len(columns)) if _open(tried[i], predicted[i], within)]
        if not todo:
            break
        heights = [(i, guess[i] * factor) for i in todo for factor in (1 / within, within)]
        runs = [
            (columns[i], loaded(replace(columns[i].bump, height=math.copysign(height, columns[i].bump.height)), loads))
            for i, height in heights
        ]
        for (i, height), (share, end) in zip(heights, _driven(vehicle, runs, time), strict=True):
            tried[i].append((height, share, end))
        for i in todo:
            guess[i] = _next(tried[i], within)
    ends = []
    for height, column, runs in zip(predicted, columns, tried, strict=True):
        most = column.used.max()
        near = tuple(end for end, use in zip(END_NAMES, column.used, strict=True) if use * NEAR >= most)
        ends.append(RegimeEnd(height, END_NAMES[int(column.used.argmax())], near, *_enclosure(runs)))
    return ends


Tried = Sequence[tuple[float, float, str]]


def _enclosure(tried: Tried) -> tuple[float, float, str]:
    """Returns the highest bump without an end below the lowest with one [m], the latter, and its end."""
    high, end = min(((height, end) for height, _, end in tried if end), default=(math.inf, ""))
    return max((height for height, _, end in tried if not end and height < high), default=0.0), high, end


def _open(tried: Tried, predicted: float, within: float) -> bool:
    """Returns True if an end is not enclosed yet, and may be at an allowed height."""
    low, high, _ = _enclosure(tried)
    return high > low * within**2 * (1 + 1e-9) and low < min(FURTHEST * predicted, LIMITS["height"][1] / within**2)


def _next(tried: Tried, within: float) -> float:
    """Returns the height to be looked at next [m]: where the shares of the runs without an end would reach 1."""
    low, high, _ = _enclosure(tried)
    if not low:
        return high / NEAR ** (2 ** (len(tried) / 2))
    (x, y), (x1, y1) = sorted({(0.0, 0.0), *((height, share) for height, share, end in tried if not end)})[-2:]
    height = x1 + (1 - y1) * (x1 - x) / (y1 - y) if y1 > y else low * NEAR
    if low * within < height < high / within:
        return height
    return min(low * FURTHEST, math.sqrt(low * high)) if math.isfinite(high) else max(low * within**2, min(height, low * 2))


def _driven(vehicle: Vehicle, runs: Sequence[tuple[Column, Road]], time: Array) -> list[tuple[float, str]]:
    """Returns the largest share of an end that each MuJoCo run reaches, and its first end, or an empty text."""
    order = sorted(range(len(runs)), key=lambda i: runs[i][0].samples)
    at_once = min(AT_ONCE, runs_at_once(len(time), len(vehicle.kind.wheels)))
    results = dict[int, tuple[float, str]]()
    for chunk in np.array_split(order, math.ceil(len(runs) / at_once)):
        some = [runs[i] for i in chunk]
        until = time[: some[-1][0].samples]
        physics = simulate([of.controller for of, _ in some], [RoadInput(vehicle, road, until) for _, road in some], threads=0)
        for k, (i, (of, _)) in enumerate(zip(chunk.tolist(), some, strict=True)):
            response = physics.response.run(k)
            first, _ = first_in_physics(vehicle, of.controller, response, physics.diverged[k])
            end = END_NAMES[first] if first >= 0 else ""
            if not end and math.isfinite(physics.diverged[k]):
                end = LAW_OVERFLOW if physics.ran_away[k] else DIVERGENCE
            results[i] = float(np.nanmax(shares(vehicle, of.controller, response))), end
    return [results[i] for i in range(len(runs))]
