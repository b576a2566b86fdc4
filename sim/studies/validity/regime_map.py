"""Map of validity: range of linear analysis over a grid of bumps, and the first event that ends it.

Before the first event physics *is* linear, so the event and its time follow from the linear response alone; and that is
proportional to the height of the bump. One linear response per length and speed predicts a whole column of heights, and the map
is drawn from these predictions. MuJoCo confirms them in a few cells, which are spread evenly, and along the edge of the linear
regime, which two runs enclose at each length and speed.

With adjustable dampers a linear controller lacks force at once, at whatever height. The map therefore shows the share of missing
force, and the first event ends the analysis *with* its dampers, the switched response, which is also proportional to the height.
A curve departs from its line gradually: it counts from a stated share, `LEAVES`. Responses with curves or loads are not
proportional to the height, so every cell has its own.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from models.common.arrays import Array
from models.common.printed import percent
from models.roads.load import Load
from models.roads.road import Bump, Road, RoadInput
from models.vehicle.vehicle import Vehicle
from sim.linear.dampers import is_linear, squarable
from sim.linear.sampled_response import sampled_responses
from sim.physics.run_blocks import runs_at_once
from sim.physics.simulate import simulate
from sim.response.regime import DAMPER, END_NAMES, REGIME_ENDS, first_end, scaled_reached
from sim.studies.validity.regime_end import (
    Column,
    RegimeEnd,
    analysed,
    enclosed,
    first_in_physics,
    largest_difference,
    loaded,
    needed,
    shares,
)
from synth.controller.controller import Controller, has_anti_windup
from synth.controller.open_loop import LoopModel

BOUNDARY = 0.01  # relative height; a cell whose prediction changes within that lies at a boundary
MOST_AT_ONCE = 64  # runs in a batch: more hardly save time
FEWEST, IN_CELLS, AT_EDGES = 10, 1 / 40, 1 / 20  # cells and edges that are run at least; their shares of all cells
SPREAD = np.array([0.7548776662466927, 0.5698402909980532])  # 1 / g and 1 / g^2, where g^3 = g + 1: they fill a plane evenly
WITHIN = 1.004  # factor on the height, either way, between the runs that enclose an edge


@dataclass(frozen=True, eq=False)
class Predicted:
    """What analysis says of N bumps.

    Attributes:
        used: share of the way to each of `REGIME_ENDS`, shape (N, E).
        first: first end as an index into `REGIME_ENDS`, -1 for none, shape (N,).
        time: time of that end [s], infinite for none, shape (N,).
        travel: largest deflection of any suspension [m], shape (N,).
    """

    used: Array
    first: Array
    time: Array
    travel: Array


@dataclass(frozen=True, eq=False)
class Driven:
    """What MuJoCo says of M bumps.

    Attributes:
        error: largest difference of physics from the linear prediction over the whole run, of any signal's peak, shape (M,).
        first: first end, as an index into `REGIME_ENDS`, -1 for none, shape (M,).
        time: time of that end [s], infinite for none, shape (M,).
        diverged: time at which the run broke off [s], infinite if it did not, shape (M,).
        ran_away: True if the run broke off because the states of its law diverged, shape (M,).
        missing: rms of the forces that adjustable dampers did not give, over that of the requested ones at the samples; 0 if none
            was requested, NaN without such dampers, shape (M,).
    """

    error: Array
    first: Array
    time: Array
    diverged: Array
    ran_away: Array
    missing: Array


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells of the map, N of them, in the order of their bumps.

    Attributes:
        bumps: bumps, one for each cell.
        predicted: predictions of all cells.
        cells: indices of the cells that MuJoCo ran, ascending, shape (M,).
        driven: results of those.
        boundary: True for those of them whose prediction differs at a height 1 % lower or higher, shape (M,).
        ends: heights that MuJoCo encloses, by the index of a cell of their length and speed.
    """

    bumps: tuple[Bump, ...]
    predicted: Predicted
    cells: Array
    driven: Driven
    boundary: Array
    ends: Mapping[int, RegimeEnd]

    def end_of(self, i: int) -> str:
        """Returns the name of the predicted first end of a cell; empty without an end."""
        return END_NAMES[self.predicted.first[i]] if self.predicted.first[i] >= 0 else ""

    @property
    def short(self) -> str:
        """Describes the share of missing force of adjustable dampers; empty if no force is missing."""
        some = self.driven.missing[self.driven.missing > 0]
        if not len(some):
            return ""
        least, most = (percent(float(share)) for share in (some.min(), some.max()))
        much = most if least == most else f"{least} to {most}"
        return f"of the force asked of its adjustable dampers {much} (rms) is missing"

    @property
    def agrees(self) -> Array:
        """Returns True for cells that MuJoCo ran whose first event is the predicted one, shape (M,)."""
        return self.driven.first == self.predicted.first[self.cells]

    @property
    def agreement(self) -> float:
        """Share of the cells that MuJoCo ran whose prediction was right."""
        return float(self.agrees.mean())

    @property
    def unexplained(self) -> int:
        """Cells whose prediction was wrong though they lie at no boundary."""
        return int(np.sum(~self.agrees & ~self.boundary))

    @property
    def furthest(self) -> float:
        """Returns the largest relative distance from a predicted end to a run that encloses it; 0 without any."""
        both = [height / end.predicted for end in self.ends.values() for height in (end.stays, end.leaves)]
        return max((abs(share - 1) for share in both), default=0.0)

    @property
    def as_predicted(self) -> bool:
        """Returns True if every end along the edge is the predicted one, and every first event away from a boundary."""
        return not self.unexplained and all(end.confirmed for end in self.ends.values())


@np.errstate(over="ignore", invalid="ignore")  # an unstable loop overflows; its cells say so
def validity(
    vehicle: Vehicle,
    controller: Controller,
    bumps: Sequence[Bump],
    time: Array,
    progress: Callable[[int], None] = lambda done: None,
    loads: tuple[Load, ...] = (),
    shape: tuple[int, ...] = (),
    every: bool = False,
) -> Cells:
    """Predicts the first end over every bump, and runs some of them in MuJoCo.

    Args:
        bumps: bumps of a grid, the last axis running fastest.
        time: equidistant sample times from 0 [s].
        progress: callback that receives the number of predicted cells.
        loads: loads on the body over every bump.
        shape: cells along each axis of the grid; empty for one axis.
        every: True to run every cell in MuJoCo.
    """
    predicted = _predicted(vehicle, controller, bumps, time, loads, progress)
    chosen = np.arange(len(bumps)) if every else _spread(shape or (len(bumps),))
    some = [bumps[i] for i in chosen]
    near = [
        _predicted(vehicle, controller, [replace(bump, height=factor * bump.height) for bump in some], time, loads).first
        for factor in (1 - BOUNDARY, 1 + BOUNDARY)
    ]
    boundary = np.any([one != predicted.first[chosen] for one in near], axis=0)
    at_once = min(MOST_AT_ONCE, runs_at_once(len(time), len(vehicle.kind.wheels)))
    parts = [_driven(vehicle, controller, some[k : k + at_once], time, loads) for k in range(0, len(some), at_once)]
    driven = Driven(*(np.concatenate([getattr(part, one.name) for part in parts]) for one in fields(Driven)))
    edges, columns = _at_edges(bumps, predicted.used.max(axis=1), shape or (len(bumps),)), list[Column]()
    for i in edges:
        response = analysed(vehicle, controller, [loaded(bumps[i], loads)], time).run(0)
        samples = needed(vehicle, controller, response)
        columns.append(Column(controller, bumps[i], predicted.used[i] / abs(bumps[i].height), samples))
    ends = enclosed(vehicle, columns, time, loads, WITHIN)
    return Cells(tuple(bumps), predicted, chosen, driven, boundary, dict(zip(edges, ends, strict=True)))


def _spread(shape: tuple[int, ...]) -> Array:
    """Returns the indices of a few cells of a grid that fill it evenly."""
    count = int(np.prod(shape))
    wanted = max(FEWEST, round(count * IN_CELLS))
    if wanted >= count:
        return np.arange(count)
    places = (0.5 + np.multiply.outer(np.arange(wanted), SPREAD[: len(shape)])) % 1
    return np.unique(np.ravel_multi_index(tuple((places * shape).astype(int).T), shape))


def _at_edges(bumps: Sequence[Bump], used: Array, shape: tuple[int, ...]) -> list[int]:
    """Returns the indices of some cells at the edge of the linear regime, at most one of each length and speed, evenly spread.

    At an edge a neighbour lies on its other side. Where the height varies, that is the neighbour with another height.
    """
    beyond, size, edges = (used >= 1).reshape(shape), np.abs(np.log(used)).reshape(shape), np.zeros(shape, dtype=bool)
    heights = np.array([bump.height for bump in bumps]).reshape(shape)
    varied = [axis for axis in range(len(shape)) if np.ptp(heights, axis=axis).max() > 0]
    for axis in varied or range(len(shape)):
        differ, nearer = np.diff(beyond, axis=axis), np.diff(size, axis=axis) < 0
        first, second = (np.moveaxis(edges, axis, 0)[part] for part in (slice(None, -1), slice(1, None)))
        first |= np.moveaxis(differ & ~nearer, axis, 0)
        second |= np.moveaxis(differ & nearer, axis, 0)
    found = {(bumps[i].length, bumps[i].speed): int(i) for i in np.flatnonzero(edges)}
    most = max(FEWEST, round(len(bumps) * AT_EDGES))
    return [list(found.values())[k] for k in sorted({*np.linspace(0, len(found) - 1, min(most, len(found))).round().astype(int)})]


def _predicted(
    vehicle: Vehicle,
    controller: Controller,
    bumps: Sequence[Bump],
    time: Array,
    loads: tuple[Load, ...],
    progress: Callable[[int], None] = lambda done: None,
) -> Predicted:
    """Predicts the ends over bumps: from responses to a metre, to which all else is proportional, or from one of each bump."""
    heights, members = np.array([bump.height for bump in bumps]), dict[Road, list[int]]()
    proportional = not (vehicle.is_curved or loads)
    for i, bump in enumerate(bumps):
        members.setdefault(replace(bump, height=1.0) if proportional else loaded(bump, loads), []).append(i)
    used, times = np.empty((2, len(bumps), len(REGIME_ENDS)))
    travel, moves = np.empty(len(bumps)), [suspension.deflection for suspension in vehicle.kind.suspensions]
    roads, done = list(members), 0
    for start in range(0, len(roads), MOST_AT_ONCE):
        some = roads[start : start + MOST_AT_ONCE]
        responses = analysed(vehicle, controller, some, time)
        for k, road in enumerate(some):
            mine, run = members[road], responses.run(k)
            factors = heights[mine] if proportional else np.ones(1)
            both = [shares(vehicle, controller, replace(run, values=sign * run.values)) for sign in (1.0, -1.0)]
            used[mine] = np.abs(factors)[:, None] * np.where(factors[:, None] > 0, both[0], both[1])
            times[mine] = scaled_reached(vehicle, run, factors, has_anti_windup(controller))
            travel[mine] = np.abs(factors) * max(float(run.peak(name)) for name in moves)
            done += len(mine)
        progress(done)
    if not is_linear(vehicle, controller):
        times[:, REGIME_ENDS.index(DAMPER)] = np.inf
    return Predicted(used, first_end(times), times.min(axis=1), travel)


def _driven(vehicle: Vehicle, controller: Controller, bumps: Sequence[Bump], time: Array, loads: tuple[Load, ...]) -> Driven:
    """Runs bumps in MuJoCo, and compares them with the response of the linear loop, without curves and adjustable dampers."""
    roads = [loaded(bump, loads) for bump in bumps]
    physics = simulate([controller] * len(bumps), [RoadInput(vehicle, road, time) for road in roads], threads=0)
    linear = sampled_responses(
        LoopModel(vehicle.linearised, controller, float(time[1])), [RoadInput(vehicle.linearised, road, time) for road in roads]
    )
    first, when = first_in_physics(vehicle, controller, physics.response, physics.diverged)
    error = [
        np.inf if np.isfinite(diverged) else largest_difference(vehicle, physics.response.run(i), linear.run(i))
        for i, diverged in enumerate(physics.diverged)
    ]
    squares = np.zeros((2, len(bumps)))  # of what is missing, and of what was requested
    for one in vehicle.adjustable:
        missing = squarable(np.nan_to_num(physics.response[one.missing]))
        given = np.nan_to_num(physics.response[one.force])
        squares += np.sum([missing**2, (given + missing) ** 2], axis=-1)
    missing = np.sqrt(squares[0] / np.where(squares[1] > 0, squares[1], np.inf))
    return Driven(
        np.array(error),
        first,
        when,
        physics.diverged,
        physics.ran_away,
        missing if vehicle.adjustable else np.full(len(bumps), np.nan),
    )
