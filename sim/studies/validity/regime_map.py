"""Map of validity: range of linear analysis over a grid of bumps, and the first event that ends it.

Before the first event physics *is* linear, so the event and its time follow from the linear response alone; and that is
proportional to the height of the bump. One linear run per length and speed predicts a whole column of heights. MuJoCo runs every
cell to check it.

With adjustable dampers a linear controller lacks force at once, at whatever height. The map therefore shows the share of missing
force, and the first event ends the analysis *with* its dampers, the switched response, which is also proportional to the height.
A curve departs from its line gradually: it counts from a stated share, `LEAVES`.
"""

import functools
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace

import numpy as np

from models.common.arrays import Array
from models.common.printed import percent
from models.common.threads import cores, side_by_side
from models.roads.load import Load
from models.roads.loaded import RoadWithLoads
from models.roads.obstacles import Flat
from models.roads.road import Bump, Road, RoadInput
from models.vehicle.vehicle import Vehicle
from sim.linear.dampers import is_linear, squarable
from sim.linear.sampled_response import sampled_response, sampled_responses
from sim.linear.switched_response import switched_response
from sim.physics.run_blocks import runs_at_once
from sim.physics.simulate import FEWEST, MonitoredBatch
from sim.response.regime import DAMPER, END_NAMES, REGIME_ENDS, EndDetector, first_end, scaled_reached, utilisation
from sim.response.response import Response
from synth.controller.controller import Controller, has_anti_windup
from synth.controller.open_loop import LoopModel

ENOUGH = 0.99  # of the cells have to break as predicted; the others lie at a boundary
MOST_AT_ONCE = 64  # runs in a batch: more hardly save time
EDGE = 0.01  # relative height; a cell whose prediction changes within that lies at a boundary


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells of the map, N of them, in the order of their bumps.

    Attributes:
        bumps: bumps, one for each cell.
        error: largest difference of physics from the linear prediction over the whole run, of any signal's peak, shape (N,).
        first: first end in physics, as an index into `REGIME_ENDS`, -1 for none, shape (N,).
        time: time of that end [s], infinite for none, shape (N,).
        predicted: first end in the linear response, shape (N,).
        predicted_time: time of that end [s], shape (N,).
        used: share of the way to each of `REGIME_ENDS` in the linear response, shape (N, E).
        edge: True if the prediction differs at a height 1 % lower or higher, shape (N,).
        ran_away: True if the run broke off because the states of its law diverged, shape (N,).
        missing: rms of the forces that adjustable dampers did not give in physics, over that of the requested ones at the
            samples; 0 if none was requested, NaN without such dampers, shape (N,).
        travel: largest deflection of any suspension in physics, either way [m], shape (N,).
    """

    bumps: tuple[Bump, ...]
    error: Array
    first: Array
    time: Array
    predicted: Array
    predicted_time: Array
    used: Array
    edge: Array
    ran_away: Array
    missing: Array
    travel: Array

    def counted(self, noun: str) -> str:
        """Describes the number of cells."""
        return f"{len(self.bumps)} {noun}"

    @property
    def short(self) -> str:
        """Describes the share of missing force of adjustable dampers; empty if no force is missing."""
        some = self.missing[self.missing > 0]
        if not len(some):
            return ""
        least, most = (percent(float(share)) for share in (some.min(), some.max()))
        much = most if least == most else f"{least} to {most}"
        return f"of the force asked of its adjustable dampers {much} (rms) is missing"

    @property
    def agrees(self) -> Array:
        """Returns True for cells whose first event in physics is the predicted one, shape (N,)."""
        return self.first == self.predicted

    @property
    def agreement(self) -> float:
        """Share of the cells whose prediction was right."""
        return float(self.agrees.mean())

    @property
    def unexplained(self) -> int:
        """Cells whose prediction was wrong though they lie at no boundary."""
        return int(np.sum(~self.agrees & ~self.edge))

    @property
    def as_predicted(self) -> bool:
        """Returns True if the first event is the predicted one in all but a few cells, and those are at a boundary."""
        return self.agreement >= ENOUGH and not self.unexplained


def validity(
    vehicle: Vehicle,
    controller: Controller,
    bumps: Sequence[Bump],
    time: Array,
    progress: Callable[[int], None] = lambda done: None,
    loads: tuple[Load, ...] = (),
    foretold: bool = True,
) -> Cells:
    """Runs every bump in MuJoCo, in a few large batches, and compares with the linear prediction.

    Args:
        time: equidistant sample times from 0 [s].
        progress: callback that receives the number of finished cells.
        loads: loads on the body over every bump.
        foretold: True to predict each cell, which is slow with curves or loads.
    """
    # One linear response serves all heights, so they lie side by side. Every core has batches as many and as large as the others,
    # unless a thread would have too few runs.
    order = sorted(range(len(bumps)), key=lambda i: (bumps[i].length, bumps[i].speed))
    at_once = min(MOST_AT_ONCE, runs_at_once(len(time), len(vehicle.kind.wheels)))
    fewest = -(-len(bumps) // at_once)
    batches = max(fewest, min(cores() * -(-fewest // cores()), len(bumps) // FEWEST))
    chunks = [chunk for chunk in np.array_split(order, batches) if len(chunk)]
    pieces = [functools.partial(_run, vehicle, controller, [bumps[i] for i in chunk], time, loads, foretold) for chunk in chunks]
    parts: list[Cells | None] = [None] * len(chunks)
    with closing(side_by_side(pieces, cores())) as results:
        for number, part in results:
            parts[number] = part
            progress(sum(len(part.bumps) for part in parts if part is not None))
    back = np.argsort(order)
    arrays = [name for name in Cells.__dataclass_fields__ if name != "bumps"]
    return Cells(tuple(bumps), **{name: np.concatenate([getattr(part, name) for part in parts])[back] for name in arrays})


@np.errstate(over="ignore", invalid="ignore")  # an unstable loop overflows; its cells say so
def _run(
    vehicle: Vehicle,
    controller: Controller,
    bumps: Sequence[Bump],
    time: Array,
    loads: tuple[Load, ...],
    foretold: bool,
    stopped: Callable[[], bool],
) -> Cells | None:
    """Some cells, in one batch that is compared with the linear response as it goes; None once it is stopped."""
    count, heights = len(bumps), np.array([bump.height for bump in bumps])
    keys = [(bump.length, bump.speed) for bump in bumps]
    columns = {key: i for i, key in enumerate(dict.fromkeys(keys))}
    column = np.array([columns[key] for key in keys])

    # Of bumps one metre high: all else is proportional to it.
    loop = LoopModel(vehicle.linearised, controller, float(time[1]))
    metres = [RoadInput(vehicle.linearised, Bump(1.0, *key), time) for key in columns]
    unit = sampled_responses(loop, metres)
    outputs = [i for i, name in enumerate(unit.names) if name in vehicle.linear_model.outputs]
    linear = np.moveaxis(unit.values, 0, 2)[:, outputs]
    short = not is_linear(vehicle, controller)
    if not foretold:
        used, times = np.zeros((count, len(END_NAMES))), np.full((count, 3, len(END_NAMES)), np.inf)
    elif vehicle.is_curved or loads:
        used, times = _one_by_one(vehicle, controller, bumps, time, loads)
    else:
        of_metre = switched_response(controller, [replace(one, vehicle=vehicle) for one in metres]) if short else unit
        used, times = _in_proportion(vehicle, of_metre, heights, column, has_anti_windup(controller))
    end = REGIME_ENDS.index(DAMPER)
    if short:
        used[:, end], times[..., end] = 0.0, np.inf
    predicted = first_end(times)
    inputs = [RoadInput(vehicle, loaded(bump, loads), time) for bump in bumps]
    flat = sampled_response(loop, RoadInput(vehicle.linearised, loaded(Flat(), loads), time))  # what loads alone do is added
    push = flat.values[:, outputs, None]

    watched, apart = MonitoredBatch([controller] * count, inputs), np.zeros((len(outputs), count))
    forces = [[unit.names.index(name) for name in (one.force, one.missing)] for one in vehicle.adjustable]
    moves = [unit.names.index(suspension.deflection) for suspension in vehicle.kind.suspensions]
    travel, squares = np.zeros(count), np.zeros((2, count))  # of what is missing, and of what was asked
    for block in watched.blocks():
        if stopped():
            return None
        some = slice(block.start, block.start + len(block.values))
        parts = zip(apart, outputs, np.moveaxis(linear[some], 1, 0), np.moveaxis(push[some], 1, 0), strict=True)
        for worst, i, response, more in parts:
            np.maximum(worst, np.abs(block.values[:, i] - heights * response[:, column] - more).max(axis=0), out=worst)
        np.maximum(travel, np.abs(block.values[:, moves]).max(axis=(0, 1), initial=0.0), out=travel)
        for given, missing in forces:
            lost = squarable(block.values[:, missing])
            squares += np.sum([lost**2, (block.values[:, given] + lost) ** 2], axis=1)

    scales = np.array([[unit.run(i).scale(unit.names[j]) or np.inf for j in outputs] for i in columns.values()])
    sizes = np.abs(heights) * scales[column].T
    if loads:
        whole = [replace(unit, values=height * unit.values[i] + flat.values) for height, i in zip(heights, column, strict=True)]
        sizes = np.array([[one.scale(unit.names[j]) or np.inf for one in whole] for j in outputs])
    error = (apart / sizes).max(axis=0)
    reached, diverged = watched.ends.times, watched.diverged
    if short:
        reached[:, end] = np.inf
    first = reached.min(axis=1)
    broken = first < diverged
    return Cells(
        bumps=tuple(bumps),
        error=np.where(np.isfinite(diverged), np.inf, error),
        first=np.where(broken, first_end(reached), -1),
        time=np.where(broken, first, np.inf),
        predicted=predicted[:, 0],
        predicted_time=times[:, 0].min(axis=-1),
        used=used,
        edge=np.any(predicted != predicted[:, :1], axis=1),
        ran_away=watched.ran_away,
        missing=np.sqrt(squares[0] / np.where(squares[1] > 0, squares[1], np.inf)) if forces else np.full(count, np.nan),
        travel=travel,
    )


def _in_proportion(vehicle: Vehicle, unit: Response, heights: Array, column: Array, anti_windup: bool) -> tuple[Array, Array]:
    """Returns the share of each end that bumps reach, shape (N, E), and the times, from responses to a bump of a metre.

    The times are for every bump as it is, and 1 % lower and higher, shape (N, 3, E).

    Args:
        heights: heights of the bumps [m], shape (N,).
        column: indices of their runs, shape (N,).
        anti_windup: True if the law has anti-windup.
    """
    hole, times = replace(unit, values=-unit.values), np.empty((len(heights), 3, len(END_NAMES)))
    used = np.abs(heights)[:, None] * np.where(
        heights[:, None] > 0, utilisation(vehicle, unit, anti_windup)[column], utilisation(vehicle, hole, anti_windup)[column]
    )
    for i in dict.fromkeys(column.tolist()):
        mine = np.flatnonzero(column == i)
        factors = heights[mine, None] * np.array([1, 1 - EDGE, 1 + EDGE])
        times[mine] = scaled_reached(vehicle, unit.run(i), factors.ravel(), anti_windup).reshape(len(mine), 3, -1)
    return used, times


def _one_by_one(
    vehicle: Vehicle, controller: Controller, bumps: Sequence[Bump], time: Array, loads: tuple[Load, ...]
) -> tuple[Array, Array]:
    """The same of responses with curves or loads, which are not proportional to the height."""
    factors = (1, 1 - EDGE, 1 + EDGE)
    near = [loaded(replace(bump, height=factor * bump.height), loads) for factor in factors for bump in bumps]
    inputs = [RoadInput(vehicle, road, time) for road in near]
    linear = is_linear(vehicle, controller)
    responses = (
        sampled_responses(LoopModel(vehicle, controller, inputs[0].timestep), inputs)
        if linear
        else switched_response(controller, inputs)
    )
    anti_windup = has_anti_windup(controller)
    detector = EndDetector([vehicle] * len(near), time, True, [anti_windup] * len(near))
    detector.update(0, np.moveaxis(responses.values, 0, 2))
    times = np.moveaxis(detector.times.reshape(3, len(bumps), len(END_NAMES)), 0, 1)
    return utilisation(vehicle, replace(responses, values=responses.values[: len(bumps)]), anti_windup), times


def loaded(bump: Road, loads: tuple[Load, ...]) -> Road:
    """Returns a bump with the loads on the body, if any."""
    return RoadWithLoads(bump, loads) if loads else bump
