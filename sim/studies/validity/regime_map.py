"""Map of validity for a grid of bumps, which shows where linear analysis is valid, and which limit is reached first outside
this range.

The vehicle is linear until the first limit is reached. The first limit and its time can therefore be predicted from the linear
response, which is proportional to the bump height. One linear response for each length and speed predicts the cells for all
heights, and the map shows these predictions. MuJoCo confirms the predictions in a few random cells, and in cells along the edge
of the linear regime. For each length and speed, the height of the edge lies between two MuJoCo runs.

At any bump height, semi-active dampers cannot apply some of the forces of a linear controller. For a vehicle with semi-active
dampers, the map shows the share of the missing force. With semi-active dampers, the analysis includes these dampers, and the
computed response is still proportional to the height. The characteristic of a nonlinear spring or damper departs gradually from
its linearisation. A difference from the linearisation that is larger than the share `LEAVES` counts as a limit. With nonlinear
characteristics or loads, responses are not proportional to the height, so that each cell requires a separate response.
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
from sim.drive.regime import DAMPER, END_NAMES, REGIME_ENDS, first_end, scaled
from sim.studies.validity.grid import UNITS, GridAxis
from sim.studies.validity.map_runs import MapRun, analyse_bumps, drive_bumps, with_loads
from sim.studies.validity.regime_end import RegimeEnd, enclose_ends
from synth.controller.controller import Controller, is_linear

BOUNDARY = 0.01  # a cell is at a boundary if the prediction changes when the height is changed by this share
AT_ONCE = 64  # number of responses that are computed simultaneously
# Smallest number of random cells to simulate, and of cells at edges; share of all cells that is simulated at random, and at
# edges.
FEWEST, IN_CELLS, AT_EDGES = 10, 1 / 40, 1 / 20
CLOSE = 1.1  # a cell counts as near an edge if its height is within this factor of the height of the edge
WITHIN = 1.004  # factor between the height of the edge and the heights of the two runs, one below and one above the edge


@dataclass(frozen=True, eq=False)
class Cells:
    """The N cells of a map, in the order of their bumps.

    Attributes:
        vehicle: vehicle that the controller controls.
        controller: controller of this vehicle.
        loads: loads on the body that act over each bump.
        threshold: largest relative error, as a share of the peak, for which linear analysis counts as valid.
        bumps: the N bumps, one for each cell.
        used: largest signal values relative to the limits in `REGIME_ENDS`, computed by analysis for each cell, shape (N, E).
        predicted: limit that is predicted to be reached first, as an index into `REGIME_ENDS`, shape (N,); -1 if no limit is
            reached.
        predicted_time: time at which the predicted limit is reached [s], shape (N,); infinite if no limit is reached.
        travel: largest suspension deflection in each cell, computed by analysis [m], shape (N,).
        driven: results of the MuJoCo runs, by index of the simulated cell.
        boundary: indices of the simulated cells in which the prediction changes if the height is 1 % lower or higher.
        ends: bump height between two MuJoCo runs at which the linear regime ends, by index of a cell with the same length and
            speed.
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
        """Axes of the map of validity. The last axis changes fastest from cell to cell."""
        values = {name: tuple(sorted({getattr(bump, name) for bump in self.bumps})) for name in UNITS}
        first, second, *_ = self.bumps
        axes = [GridAxis(name, some) for name, some in values.items() if len(some) > 1]
        return tuple(sorted(axes, key=lambda axis: getattr(first, axis.name) != getattr(second, axis.name)))

    @property
    def fixed_text(self) -> str:
        """Text with the quantities that are the same for all bumps, such as "a length of 2.5 m"."""
        varied = [axis.name for axis in self.axes]
        fixed = {name: getattr(self.bumps[0], name) for name in UNITS if name not in varied}
        return " and ".join(f"a {name} of {value:g} {UNITS[name]}" for name, value in fixed.items())

    def end_of(self, i: int) -> str:
        """Returns the name of the limit that is predicted to be reached first in cell `i`; empty if no limit is reached."""
        return END_NAMES[self.predicted[i]] if self.predicted[i] >= 0 else ""

    def share(self, holds: Callable[[MapRun], bool]) -> float:
        """Returns the share of the MuJoCo runs for which the function `holds` returns True."""
        return float(np.mean([holds(one) for one in self.driven.values()]))

    @property
    def short(self) -> str:
        """Text that states which share of the requested force semi-active dampers cannot apply; empty if no force is missing."""
        some = [one.missing for one in self.driven.values() if one.missing > 0]
        if not some:
            return ""
        least, most = percent(min(some)), percent(max(some))
        much = most if least == most else f"{least} to {most}"
        return f"the semi-active dampers cannot supply {much} (rms) of the commanded force"

    @cached_property
    def others(self) -> frozenset[int]:
        """Indices of the cells in which the limit that MuJoCo reaches first is not the predicted limit."""
        return frozenset(i for i, one in self.driven.items() if one.first != self.predicted[i])

    @property
    def agreement(self) -> float:
        """Share of the simulated cells in which MuJoCo confirms the predicted limit."""
        return 1 - len(self.others) / len(self.driven)

    @property
    def unexplained(self) -> int:
        """Number of cells that are not at a boundary and in which MuJoCo contradicts the prediction."""
        return len(self.others - self.boundary)

    @property
    def furthest(self) -> float:
        """Largest relative distance between a predicted edge height and the two runs on both sides of the edge; 0 if there are
        no such runs.
        """
        both = [height / end.predicted for end in self.ends.values() for height in (end.stays, end.leaves)]
        return max((abs(share - 1) for share in both), default=0.0)

    @property
    def as_predicted(self) -> bool:
        """True if MuJoCo confirms the predicted limit in the runs along the edge, and in all simulated cells that are not at a
        boundary.
        """
        return not self.unexplained and all(end.confirmed for end in self.ends.values())


@np.errstate(over="ignore", invalid="ignore")  # signals of an unstable loop overflow, and the cells of the map show this
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
    """Predicts the first limit for each bump of a grid, and simulates some of the bumps in MuJoCo.

    Args:
        vehicle: vehicle that the controller controls.
        controller: controller of this vehicle.
        bumps: bumps of all cells of the grid.
        time: equidistant sample times from 0 [s], shape (T,).
        progress: callback that receives the number of predicted cells.
        loads: loads on the body that act over each bump.
        every: True to simulate the bumps of all cells in MuJoCo.
        threshold: largest relative error, as a share of the peak, for which linear analysis counts as valid.
    """
    used, predicted, when, travel = _predict_cells(vehicle, controller, bumps, time, loads, progress)
    wanted = len(bumps) if every else min(len(bumps), max(FEWEST, round(len(bumps) * IN_CELLS)))
    # From each of these parts of the grid, one random cell is simulated
    borders = np.linspace(0, len(bumps), wanted + 1).astype(int)
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
    """Returns the indices of evenly spread cells at the edge of the linear regime, at most one for each length and speed.

    A length and speed have an edge if cells lie on both sides of the edge, or if a cell is close to it (factor `CLOSE`).

    Args:
        bumps: bumps of all N cells.
        used: largest signal value relative to its limit in each cell, shape (N,).
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
    """Returns the attributes `used`, `predicted`, `predicted_time` and `travel` of `Cells`.

    If responses are proportional to the bump height, the response over a bump of 1 m predicts the responses for all heights.
    If responses are not proportional to the bump height, a separate response is computed for each bump.
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
            ends = scaled(vehicle, run, factors, controller.has_anti_windup)
            used[mine], times[mine] = ends.shares, ends.times
            travel[mine] = np.abs(factors) * max((float(run.peak(name)) for name in moves), default=0.0)
            done += len(mine)
        progress(done)
    if not is_linear(controller, vehicle):
        used[:, REGIME_ENDS.index(DAMPER)], times[:, REGIME_ENDS.index(DAMPER)] = 0.0, np.inf
    return used, first_end(times), times.min(axis=1), travel
