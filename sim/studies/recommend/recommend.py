"""Recommendation of a controller for a vehicle: searched in linear analysis, confirmed in MuJoCo, ranked."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from models import USUAL_TIMESTEP
from models.common.checks import check_arguments
from models.common.errors import InputError
from models.common.threads import one_thread
from models.document.document import Document
from models.document.text import ShownResult
from models.roads.iso8608 import Iso8608, long_enough
from models.roads.road import Road, track_width
from models.vehicle.names import PASSIVE, without_copies
from models.vehicle.vehicle import Vehicle
from sim.studies.recommend.bound import lower_bound
from sim.studies.recommend.confirm import Confirmation
from sim.studies.recommend.optimal import certified
from sim.studies.recommend.rating import Rating, rate_expected, with_ideal_margins
from sim.studies.recommend.search import (
    MORE_SHARES,
    SHARES,
    Family,
    Search,
    families,
    optimal_laws,
    search,
    semi_active_laws,
    sensor_families,
)
from sim.studies.recommend.task import Candidate, Task
from sim.studies.recommend.within import Within, read_within
from synth.controller.controller import Controller
from synth.plant.numerics import DesignError

RESERVE = 0.1  # share of stroke and force that is kept for random roads that were not driven
SPEED = 20.0  # m/s, usual


@dataclass(frozen=True, eq=False)
class Row:
    """A ranked candidate.

    Attributes:
        candidate: the candidate.
        rating: its rating in MuJoCo, or the expected one if it was not driven.
        driven: True if it was driven in MuJoCo.
        keeps: True if it keeps all limits with the reserve.
    """

    candidate: Candidate
    rating: Rating
    driven: bool
    keeps: bool

    @property
    def certified(self) -> bool | None:
        """True if the stability and the norm of its ideal loop are proved; None for a law without a linear loop."""
        one = self.candidate.controller
        if one.linear is not True:
            return None
        return one.acts and one.certificate.stable and not one.certificate.failures


@dataclass(frozen=True, eq=False, repr=False)
class Recommendation(ShownResult):
    """Ranked candidates for a vehicle on a road.

    Attributes:
        task: the task.
        rows: candidates, the best first; those that keep all limits come before the others.
        sensors: expected value of the goal with the LQG of some sensors, by their groups.
        bound: expected ride that no active controller of the same sensors falls below in linear analysis without limits; None if
            it is not computed.
        left_out: reasons for which a family or a controller of the file is left out, by name.
        reserve: share of stroke and force that is kept for roads that were not driven.
        roads: number of roads that each candidate drove over.
        interrupted: True if the search was interrupted.
    """

    task: Task
    rows: tuple[Row, ...]
    sensors: Mapping[tuple[str, ...], float]
    bound: float | None
    left_out: Mapping[str, str]
    reserve: float
    roads: int
    interrupted: bool = False

    @property
    def best(self) -> Row | None:
        """The best controller that keeps all limits; None if none is better than the passive vehicle."""
        passive = self.passive
        acting = [row for row in self.rows if row.keeps and row.candidate.controller.acts]
        least = math.inf if passive is None else passive.rating.value(self.task)
        return acting[0] if acting and acting[0].rating.value(self.task) < least else None

    @property
    def passive(self) -> Row | None:
        """The passive vehicle as it is."""
        return next((row for row in self.rows if row.candidate.name == PASSIVE), None)

    @property
    def summary(self) -> Document:
        """The table, and what it means."""
        from sim.studies.recommend.report import describe

        return describe(self)


@check_arguments
def recommend(
    vehicle: Vehicle,
    road: Road | None = None,
    goal: Literal["ride", "holding", "travel"] = "ride",
    within: Within | str = "",
    timestep: float = USUAL_TIMESTEP,
) -> Recommendation:
    """Returns the best controllers for a vehicle: candidates of every family, searched and driven over the road in MuJoCo.

    Args:
        road: the road; a random one is driven with several seeds. Default: class C at 20 m/s.
        goal: what is minimised: "ride" (weighted acceleration), "holding" (dynamic tyre load) or "travel".
        within: limits, as `Within` or as the text of `--within`.
        timestep: timestep of MuJoCo [s].

    Raises:
        InputError: the road or a limit is not allowed.

    Example:
        >>> from models import read_vehicle
        >>> from sim import recommend
        >>> recommend(read_vehicle("quarter_car"), goal="speed")
        Traceback (most recent call last):
            ...
        ValueError: goal = 'speed' is not one of 'ride', 'holding', 'travel'; give one of these
    """
    limits = read_within(within) if isinstance(within, str) else within
    if road is None:
        road = Iso8608(speed=SPEED, track_width=track_width(vehicle), length=long_enough(SPEED * 20))
    return recommendation(Task(vehicle, road, goal, limits, timestep), lambda text: None)


@one_thread()
def recommendation(task: Task, progress: Callable[[str], None]) -> Recommendation:
    """Returns the recommendation of a task; after Ctrl-C with the candidates so far.

    Args:
        progress: callback that receives a line of progress.
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
        self.task, self._progress = task, progress
        self.expected: dict[Candidate, Rating | None] = {}
        self.driven: dict[Candidate, Rating] = {}
        self.left_out: dict[str, str] = {}
        self.sensors: dict[tuple[str, ...], float] = {}
        self.bound: float | None = None
        self.confirmation = Confirmation(task)
        exact = not self.confirmation.random
        self.reserve = 0.0 if exact else RESERVE
        self.shares = MORE_SHARES if exact or task.vehicle.dampers else SHARES

    def run(self) -> None:
        """Searches and drives all candidates."""
        self._families()
        if not self.task.vehicle.dampers:
            self._progress("lower bound")
            self.bound = lower_bound(self.task)
        candidates = list(self.expected)
        for one, rating in zip(candidates, self.confirmation.drive(candidates, self._progress), strict=True):
            self.driven[one] = rating
        self._certify()

    def _add(self, candidate: Candidate, rating: Rating | None) -> None:
        self.expected[candidate] = rating
        best = min((one.penalised(self.task) for one in self.expected.values() if one is not None), default=math.inf)
        if math.isfinite(best):
            self._progress(f"best expected {self.task.goal} so far: {best:.3g}")

    def _own(self) -> None:
        """Adds the controllers of the file."""
        task, vehicle = self.task, self.task.vehicle
        for name in without_copies(vehicle.controllers):
            self._progress(f"`{name}` of the file")
            car = vehicle.with_actuators_of(name)
            try:
                controller = vehicle.driver(name, task.designer.design)
                one = Candidate(f"{name} (file)", f"file {name}", controller, car, "of the file", own=True)
                rating = rate_expected(task, one) if isinstance(controller, Controller) and not car.dampers else None
            except (DesignError, InputError) as error:
                self.left_out[name] = str(error).removeprefix(f"controller {name!r}: ")
                continue
            if rating is None and isinstance(controller, Controller) and not car.dampers:
                self.left_out[name] = "its implemented loop is unstable"
                continue
            self._add(one, rating)

    def _families(self) -> None:
        task, start = self.task, None
        passive = Candidate(PASSIVE, PASSIVE, task.passive, task.vehicle, "as it is")
        self._add(passive, rate_expected(task, passive))
        for family in families(task):
            one = replace(family, start=family.begin(start)) if family.begin else family
            found = search(task, one, self._progress)
            self._take(family, found)
            best = found.best(task)
            start = best[2] if best is not None else None
        self._own()
        for candidate in semi_active_laws(task):
            self._add(candidate, None)
        for family, found in optimal_laws(task, self._progress):
            self._take(family, found)
            if family.name == "LQG":
                self._sensors(found)
        for name, reason in missing(task).items():
            self.left_out.setdefault(name, reason)

    def _take(self, family: Family, found: Search) -> None:
        if not found.rated:
            self.left_out[family.name] = found.failure or "no stable candidate"
        for candidate, rating in found.some(self.task, self.shares):
            self._add(candidate, rating)

    def _sensors(self, whole: Search) -> None:
        """Searches LQG with fewer sensors, and notes what each sensor adds."""
        task, best = self.task, whole.best(self.task)
        if best is not None:
            self.sensors[tuple(task.groups)] = best[1].penalised(task)
        for groups, family in sensor_families(task, None if best is None else best[2]):
            found = search(task, family, self._progress)
            if (one := found.best(task)) is None:
                continue
            self.sensors[groups] = one[1].penalised(task)
            self._take(family, found)

    def _certify(self) -> None:
        """Gives the best candidate of each family its certificate, and the margins of its ideal loop."""
        self._progress("certificates")
        for row in self.rows():
            one = row.candidate
            if (
                one.own
                or not isinstance(one.controller, Controller)
                or not one.controller.acts
                or one.controller.preview is not None
            ):
                continue
            changed = replace(one, controller=certified(self.task, one.controller))
            rating = self.driven.pop(one)
            usage = rating.usage if one.vehicle.dampers else with_ideal_margins(self.task, changed.controller, rating.usage)
            self.expected[changed], self.driven[changed] = self.expected.pop(one), replace(rating, usage=usage)

    def rows(self) -> list[Row]:
        """Returns the best candidate of each family, ranked."""
        rows = list[Row]()
        for one, expected in self.expected.items():
            rating, driven = self.driven.get(one, expected), one in self.driven
            if rating is not None and math.isfinite(rating.value(self.task)):
                rows.append(Row(one, rating, driven, rating.keeps(self.task, self.reserve if driven else 0.0)))
        rows.sort(key=lambda row: (not row.keeps, row.rating.penalised(self.task, 1 - self.reserve)))
        first = {family: next(each) for family, each in itertools.groupby(sorted(rows, key=_family), _family)}
        return [row for row in rows if first[_family(row)] is row]

    def result(self, interrupted: bool = False) -> Recommendation:
        """Returns the recommendation so far."""
        left = dict(self.left_out)
        for one, rating in self.driven.items():
            if not math.isfinite(rating.value(self.task)):
                left.setdefault(one.name, "a run breaks off in MuJoCo")
        roads = len(self.confirmation.seeds)
        return Recommendation(self.task, tuple(self.rows()), self.sensors, self.bound, left, self.reserve, roads, interrupted)


def _family(row: Row) -> str:
    return row.candidate.family if row.candidate.family != "passive" else row.candidate.name


def missing(task: Task) -> dict[str, str]:
    """Returns the reasons for which families do not exist for a task, by family."""
    reasons = dict[str, str]()
    states = set(task.line.linear_model.states)
    if not states <= set(task.sensors):
        reasons["preview"] = f"the sensors measure not all {len(states)} states"
    if not task.vehicle.dampers:
        reasons["semi-active laws"] = "the file has no adjustable dampers"
    return reasons


def sensor_names(task: Task, sensors: Sequence[str]) -> tuple[str, ...]:
    """Returns the groups of some sensors."""
    return tuple(group for group, signals in task.groups.items() if set(signals) & set(sensors))
