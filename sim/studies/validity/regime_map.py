"""Map of validity: range of linear analysis over a grid of bumps, and the first event that ends it.

Before the first event physics *is* linear, so the event and its time follow from the linear response alone; and that is
proportional to the height of the bump. One linear response per length and speed predicts a whole column of heights, and the map
is drawn from these predictions. MuJoCo confirms them in a few cells, chosen at random, and along the edge of the linear
regime, which two runs enclose at each length and speed.

With adjustable dampers a linear controller lacks force at once, at whatever height. The map therefore shows the share of missing
force, and the first event ends the analysis *with* its dampers, the switched response, which is also proportional to the height.
A curve departs from its line gradually: it counts from a stated share, `LEAVES`. Responses with curves or loads are not
proportional to the height, so every cell has its own.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from models.common.arrays import Array
from models.common.printed import percent
from models.roads.loads.load import Load
from models.roads.road import Bump, Road
from models.vehicle.vehicle import Vehicle
from sim.drive.regime import DAMPER, END_NAMES, REGIME_ENDS, first_end, scaled_reached
from sim.studies.validity.grid import UNITS, GridAxis
from sim.studies.validity.map_runs import MapRun, analyse_bumps, drive_bumps, shares, with_loads
from sim.studies.validity.regime_end import RegimeEnd, enclose_ends
from synth.controller.controller import Controller, is_linear

BOUNDARY = 0.01  # relative height; a cell whose prediction changes within that lies at a boundary
AT_ONCE = 64  # responses side by side
FEWEST, IN_CELLS, AT_EDGES = 10, 1 / 40, 1 / 20  # cells and edges that are run at least; their shares of all cells
CLOSE = 1.1  # factor on the height
WITHIN = 1.004  # factor on the height, either way, between the runs that enclose an edge


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells of the map, N of them, in the order of their bumps.

    Attributes:
        vehicle: the vehicle.
        controller: the controller.
        loads: loads on the body over every bump.
        threshold: error with which linear analysis counts as valid, relative to the peak.
        bumps: bumps, one for each cell.
        used: share of the way to each of `REGIME_ENDS` by analysis, shape (N, E).
        predicted: first end by analysis, as an index into `REGIME_ENDS`, -1 for none, shape (N,).
        predicted_time: time of that end [s], infinite for none, shape (N,).
        travel: largest deflection of any suspension by analysis [m], shape (N,).
        driven: results of MuJoCo, by the index of the cell.
        boundary: indices of those of them whose prediction differs at a height 1 % lower or higher.
        ends: heights that MuJoCo encloses, by the index of a cell of their length and speed.
    """

    vehicle: Vehicle
    controller: Controller
    loads: tuple[Load, ...]
    threshold: float
    bumps: tuple[Bump, ...]
    used: Array
    predicted: Array
    predicted_time: Array
    travel: Array
    driven: Mapping[int, MapRun]
    boundary: frozenset[int]
    ends: Mapping[int, RegimeEnd]

    @property
    def axes(self) -> tuple[GridAxis, ...]:
        """Returns the axes of the map, the one that runs fastest last."""
        values = {name: tuple(sorted({getattr(bump, name) for bump in self.bumps})) for name in UNITS}
        first, second, *_ = self.bumps
        axes = [GridAxis(name, some) for name, some in values.items() if len(some) > 1]
        return tuple(sorted(axes, key=lambda axis: getattr(first, axis.name) != getattr(second, axis.name)))

    @property
    def fixed_text(self) -> str:
        """Describes the quantities that are the same for all bumps."""
        varied = [axis.name for axis in self.axes]
        fixed = {name: getattr(self.bumps[0], name) for name in UNITS if name not in varied}
        return " and ".join(f"a {name} of {value:g} {UNITS[name]}" for name, value in fixed.items())

    def end_of(self, i: int) -> str:
        """Returns the name of the predicted first end of a cell; empty without an end."""
        return END_NAMES[self.predicted[i]] if self.predicted[i] >= 0 else ""

    def share(self, holds: Callable[[MapRun], bool]) -> float:
        """Returns the share of the MuJoCo runs for which something holds."""
        return float(np.mean([holds(one) for one in self.driven.values()]))

    @property
    def short(self) -> str:
        """Describes the share of missing force of adjustable dampers; empty if no force is missing."""
        some = [one.missing for one in self.driven.values() if one.missing > 0]
        if not some:
            return ""
        least, most = percent(min(some)), percent(max(some))
        much = most if least == most else f"{least} to {most}"
        return f"the semi-active dampers lack {much} (rms) of the commanded force"

    @cached_property
    def others(self) -> frozenset[int]:
        """Returns the cells whose first event in MuJoCo is not the predicted one."""
        return frozenset(i for i, one in self.driven.items() if one.first != self.predicted[i])

    @property
    def agreement(self) -> float:
        """Share of the cells that MuJoCo ran whose prediction was right."""
        return 1 - len(self.others) / len(self.driven)

    @property
    def unexplained(self) -> int:
        """Cells whose prediction was wrong though they lie at no boundary."""
        return len(self.others - self.boundary)

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
    every: bool = False,
    threshold: float = 0.05,
) -> Cells:
    """Predicts the first end over every bump, and runs some of them in MuJoCo.

    Args:
        bumps: bumps of a grid.
        time: equidistant sample times from 0 [s].
        progress: callback that receives the number of predicted cells.
        loads: loads on the body over every bump.
        every: True to run every cell in MuJoCo.
        threshold: error with which linear analysis counts as valid, relative to the peak.
    """
    used, predicted, when, travel = _predict_cells(vehicle, controller, bumps, time, loads, progress)
    wanted = len(bumps) if every else min(len(bumps), max(FEWEST, round(len(bumps) * IN_CELLS)))
    borders = np.linspace(0, len(bumps), wanted + 1).astype(int)  # one at random out of so many parts of the grid
    chosen = np.random.default_rng(0).integers(borders[:-1], borders[1:])
    runs = drive_bumps(vehicle, [(controller, with_loads(bumps[i], loads), len(time)) for i in chosen], time)
    boundary = set[int]()
    for factor in (1 - BOUNDARY, 1 + BOUNDARY):
        moved = [replace(bumps[i], height=factor * bumps[i].height) for i in chosen]
        boundary |= {*chosen[_predict_cells(vehicle, controller, moved, time, loads)[1] != predicted[chosen]].tolist()}
    edges = _at_edges(bumps, used.max(axis=1))
    found = enclose_ends(vehicle, [controller] * len(edges), [bumps[i] for i in edges], time, loads, WITHIN)
    ends = {i: end for i, end in zip(edges, found, strict=True) if end is not None}
    results = dict(zip(chosen.tolist(), runs, strict=True))
    return Cells(
        vehicle, controller, loads, threshold, tuple(bumps), used, predicted, when, travel, results, frozenset(boundary), ends
    )


def _at_edges(bumps: Sequence[Bump], used: Array) -> list[int]:
    """Returns the indices of some cells at the edge of the linear regime, at most one of each length and speed, evenly spread.

    That is where cells of this length and speed are on both sides of it, or one is within `CLOSE`.
    """
    columns, edges = dict[tuple[float, float], list[int]](), list[int]()
    for i, bump in enumerate(bumps):
        columns.setdefault((bump.length, bump.speed), []).append(i)
    for mine in columns.values():
        nearest = min(mine, key=lambda i: abs(math.log(used[i])) if used[i] > 0 else math.inf)
        if 1 / CLOSE < used[nearest] < CLOSE or used[mine].min() < 1 <= used[mine].max():
            edges.append(nearest)
    most = min(len(edges), max(FEWEST, round(len(bumps) * AT_EDGES)))
    return [edges[k] for k in np.linspace(0, len(edges) - 1, most).round().astype(int)]


def _predict_cells(
    vehicle: Vehicle,
    controller: Controller,
    bumps: Sequence[Bump],
    time: Array,
    loads: tuple[Load, ...],
    progress: Callable[[int], None] = lambda done: None,
) -> tuple[Array, Array, Array, Array]:
    """Returns `used`, `predicted`, `predicted_time` and `travel` of `Cells`, from responses to a metre, to which all else is
    proportional, or from one of each bump.
    """
    heights, members = np.array([bump.height for bump in bumps]), dict[Road, list[int]]()
    proportional = not (vehicle.parts.nonlinear or loads)
    for i, bump in enumerate(bumps):
        members.setdefault(replace(bump, height=1.0) if proportional else with_loads(bump, loads), []).append(i)
    used, times = np.empty((2, len(bumps), len(REGIME_ENDS)))
    travel, moves = np.empty(len(bumps)), [suspension.deflection for suspension in vehicle.kind.suspensions]
    roads, done = list(members), 0
    for start in range(0, len(roads), AT_ONCE):
        some = roads[start : start + AT_ONCE]
        responses = analyse_bumps(vehicle, controller, some, time)
        for k, road in enumerate(some):
            mine, run = members[road], responses.run(k)
            factors = heights[mine] if proportional else np.ones(1)
            both = [shares(vehicle, controller, replace(run, values=sign * run.values)) for sign in (1.0, -1.0)]
            used[mine] = np.abs(factors)[:, None] * np.where(factors[:, None] > 0, both[0], both[1])
            times[mine] = scaled_reached(vehicle, run, factors, controller.has_anti_windup)
            travel[mine] = np.abs(factors) * max((float(run.peak(name)) for name in moves), default=0.0)
            done += len(mine)
        progress(done)
    if not is_linear(controller, vehicle):
        times[:, REGIME_ENDS.index(DAMPER)] = np.inf
    return used, first_end(times), times.min(axis=1), travel
