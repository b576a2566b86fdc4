"""Recommendation of a controller for a vehicle: candidates are tuned by linear analysis, simulated in MuJoCo, and ranked."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Annotated

from models import USUAL_TIMESTEP
from models.common.checks import Must, PositiveTime, check_arguments
from models.common.errors import InputError, list_names
from models.common.printed import brief
from models.common.threads import one_thread
from models.roads.iso8608 import Iso8608, long_enough
from models.roads.road import Road, track_width
from models.vehicle.names import PASSIVE, without_copies
from models.vehicle.vehicle import Vehicle
from sim.studies.recommend import GOALS
from sim.studies.recommend.bound import lower_bound
from sim.studies.recommend.laws import semi_active
from sim.studies.recommend.optimal import certified
from sim.studies.recommend.rating import Rating, drive_candidates, rate_expected
from sim.studies.recommend.result import RankedContender, Recommendation
from sim.studies.recommend.search import Family, families
from sim.studies.recommend.task import SPEED, Contender, Task
from sim.studies.recommend.within import TAIL, Within, read_within
from synth.plant.numerics import DesignError

RESERVE = 0.1  # share of stroke and force that is kept in reserve for random roads that are not simulated
# Number of corrections of a family's limits; used share of the limits below which they are corrected; safety factor of a
# correction; smallest factor of a correction. After each correction except the last, the search is repeated.
ROUNDS, SLACK, TIGHTER, LEAST = 3, 0.75, 1.05, 0.3
HOPE = 1.1  # a search is not repeated for an active candidate whose value exceeds the best one by this factor
# limits whose used share in MuJoCo differs from the share that linear analysis expects
CALIBRATED = ("stroke", "force", "lift")
# share of the total time after which the first searches end, and after which the first simulations begin
OF_SEARCH, OF_DRIVES = 0.45, 0.6
Goal = Annotated[str, Must(f"one of {list_names(GOALS)}", lambda value: value in GOALS)]


@check_arguments
def recommend(
    vehicle: Vehicle,
    road: Road | None = None,
    goal: Goal = "ride",
    within: Within | str = "",
    timestep: PositiveTime = USUAL_TIMESTEP,
) -> Recommendation:
    """Recommends controllers for a vehicle: tunes candidates of several families, and compares these candidates in MuJoCo over
    the road.

    Args:
        road: road on which controllers are compared; for a random road, several random roads with the same spectrum are used.
            Default: class C at 20 m/s.
        goal: quantity to minimise: "ride" (weighted acceleration), "holding" (dynamic tyre load) or "travel" (suspension
            travel).
        within: limits that the controller must keep, as a `Within` object or as the text of `--within`.
        timestep: timestep of the MuJoCo simulation [s].

    Raises:
        InputError: the road or a limit is not allowed.

    Example:
        >>> from models import read_vehicle
        >>> from sim import recommend
        >>> recommend(read_vehicle("quarter_car"), within="disk=3")
        Traceback (most recent call last):
            ...
        models.common.errors.InputError: --within: disk=3 is not allowed; give a number from 1e-06 to 2, as in disk=0.3, or none
    """
    limits = read_within(within) if isinstance(within, str) else within
    usual = Iso8608(speed=SPEED, track_width=track_width(vehicle), length=long_enough(20 * SPEED))
    return recommendation(Task(vehicle, road or usual, goal, limits, timestep), lambda text: None)


@one_thread()
def recommendation(task: Task, progress: Callable[[str], None]) -> Recommendation:
    """Returns the recommendation for a task. After Ctrl-C, the recommendation contains only the candidates found before the
    interruption.

    Args:
        progress: function that receives lines about the progress.
    """
    work = _Work(task, progress)
    try:
        work.run()
    except KeyboardInterrupt:
        return work.result(interrupted=True)
    return work.result()


class _Work:
    """A recommendation in progress."""

    def __init__(self, task: Task, progress: Callable[[str], None]) -> None:
        self.task, self._show, self._start, self._share = task, progress, time.monotonic(), 0.0
        self.expected: dict[Contender, Rating | None] = {}
        self.driven: dict[Contender, Rating] = {}
        self.left_out: dict[str, str] = {}
        self.sensors: dict[tuple[str, ...], float] = {}
        self.bound: float | None = None
        self.reserve = RESERVE if task.random else 0.0

    def run(self) -> None:
        """Tunes all candidates, simulates them in MuJoCo, and certifies the best ones."""
        task, searched = self.task, list[Family]()
        self._add(Contender(PASSIVE, task.passive, task.vehicle, "of the file"))
        planned = sum(family.evaluations for family, _ in families(task))
        for family, groups in families(task):
            self._search(family, groups)
            searched.append(family)
            self._share += OF_SEARCH * family.evaluations / planned
        self._own()
        self._share = OF_DRIVES
        self.expected |= dict.fromkeys(semi_active(task))
        if not task.vehicle.dampers and task.random:
            bound = lower_bound(task)
            self.bound, why = (None, bound) if isinstance(bound, str) else (bound, "")
            self.left_out |= {"lower bound": why} if why else {}
        self._drive()
        for i in range(ROUNDS):
            for family in searched:
                self._repeat(family, i < ROUNDS - 1)
            self._drive()
            self._share = (1 + self._share) / 2
        self._certify()

    def _progress(self, text: str) -> None:
        known = [one.penalised(self.task) for one in self.expected.values() if one is not None]
        best = f", best {self.task.goal} {brief(min(known))}" if known else ""
        seconds = time.monotonic() - self._start
        left = f"{round(seconds * (1 / self._share - 1), -1):g} s left, " if self._share > 0 else ""
        self._show(f"{left}{text}{best}")

    def _search(self, family: Family, groups: tuple[str, ...] = (), again: str = "") -> None:
        """Searches a family of candidates and adds the best one. After Ctrl-C, the best candidate found before the interruption
        is added.
        """
        self._progress(f"{family.name}{again}")
        try:
            family.search(self.task)
        finally:
            self._take(family, groups)

    def _take(self, family: Family, groups: tuple[str, ...] = ()) -> None:
        """Adds the best candidate of a family to the results."""
        best = family.best(self.task)
        if best is None:
            self.left_out[family.name] = family.failure.split(":")[0]
        elif best[0] not in self.expected:
            self.expected[best[0]] = best[1]
            keeps = max(self.task.within.used(best[1].usage).values(), default=0.0) <= 1
            self.sensors |= {groups: best[1].value(self.task) if keeps else math.inf} if groups else {}

    def _add(self, one: Contender) -> None:
        """Adds a candidate to the results, unless its implemented loop is unstable."""
        linear = one.controller.linear is True and not one.vehicle.dampers
        rating = rate_expected(self.task, one) if linear else None
        if linear and rating is None:
            self.left_out[one.name] = "its implemented loop is unstable"
        else:
            self.expected[one] = rating

    def _own(self) -> None:
        """Adds the controllers of the vehicle file to the results."""
        vehicle = self.task.vehicle
        for name in without_copies(vehicle.controllers):
            self._progress(f"{name} of the file")
            try:
                controller = vehicle.driver(name, self.task.designer.design)
                self._add(Contender(f"{name} (file)", controller, vehicle.with_actuators_of(name), "of the file", own=True))
            except (DesignError, InputError) as error:
                self.left_out[f"{name} (file)"] = str(error).removeprefix(f"controller {name!r}: ")

    def _drive(self) -> None:
        """Simulates the candidates that have not been simulated yet."""
        new = [one for one in self.expected if one not in self.driven]
        for one, rating in zip(new, drive_candidates(self.task, new, self._progress), strict=True):
            # the first candidate to be simulated is the passive vehicle
            lifts = next(iter(self.driven.values()), rating).usage.off_ground
            self.driven[one] = replace(rating, usage=rating.usage._replace(passive_off_ground=lifts))

    def _repeat(self, family: Family, search: bool) -> None:
        """Corrects a family's limits if its best candidate exceeds limits in MuJoCo, or does not use these limits fully.

        If `search` is True, the family is then searched again. If `search` is False, the best candidate under the corrected
        limits is chosen from all candidates of the earlier search.
        """
        task, (last, rating, _) = self.task, family.best(self.task) or (None, None, None)
        if last not in self.driven or rating is None:
            return
        there = task.within.used(self.driven[last].usage, self.reserve)
        linear = {name: one * family.factors.get(name, 1.0) for name, one in task.within.used(rating.usage).items()}
        held = [name for name in CALIBRATED if max(there.get(name, 0.0), linear.get(name, 0.0)) > SLACK]
        most = max((there[name] for name in held), default=1.0)
        value = min((row.rating.value(task) for row in self.rows() if row.keeps and row.driven), default=math.inf)
        hopeless = last.controller.acts and self.driven[last].value(task) > HOPE * value
        if not held or SLACK <= most <= 1 or hopeless:
            return
        for name in held:
            least = LEAST ** (TAIL if name == "lift" else 1)
            factor = max(TIGHTER * there[name] / linear[name], least) if linear[name] else 1.0
            # If a force is clipped, its peak does not show how much force is missing
            factor = max(factor, TIGHTER) if there[name] > 1 else factor
            family.factors[name] = family.factors.get(name, 1.0) * min(factor, 1 / least)
        if search:
            self._search(family, again=" again")
        else:
            self._take(family)

    def _certify(self) -> None:
        """Computes the certificate of the best candidate of each family."""
        for one in [row.candidate for row in self.rows()]:
            law = one.controller
            if law.linear is True and law.acts and law.preview is None and not one.own:
                self._progress(f"certificate of {one.name}")
                changed = replace(one, controller=certified(self.task, law))
                self.expected[changed], self.driven[changed] = self.expected.pop(one), self.driven.pop(one)

    def rows(self) -> list[RankedContender]:
        """Returns the best candidate of each family, best first."""
        rows, best = list[RankedContender](), dict[str, RankedContender]()
        for one, expected in self.expected.items():
            rating, driven = self.driven.get(one, expected), one in self.driven
            if rating is not None and math.isfinite(rating.value(self.task)):
                used = self.task.within.used(rating.usage, self.reserve if driven else 0.0)
                rows.append(RankedContender(one, rating, driven, used))
        for row in sorted(rows, key=lambda row: (not row.keeps, row.rating.penalised(self.task))):
            best.setdefault(row.candidate.name, row)
        return list(best.values())

    def result(self, interrupted: bool = False) -> Recommendation:
        """Returns the recommendation that follows from the candidates found so far."""
        rows, left, task = self.rows(), dict(self.left_out), self.task
        named = {row.candidate.name for row in rows}
        left |= {one.name: "a run ends early in MuJoCo" for one in self.driven if one.name not in named}
        if not {*task.line.linear_model.states} <= {*task.sensors}:
            left["preview"] = f"the sensors do not measure all {len(task.line.linear_model.states)} states"
        if not task.vehicle.dampers:
            left["semi-active laws"] = "the file has no adjustable dampers"
        # A search with fewer sensors may have found a better value, which a law with more sensors can also reach.
        sensors = {some: min(one for other, one in self.sensors.items() if {*other} <= {*some}) for some in self.sensors}
        return Recommendation(task, tuple(rows), sensors, self.bound, left, self.reserve, interrupted)
