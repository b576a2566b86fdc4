"""Result of a recommendation, also as text and JSON: ranked table, lower bound, value of each sensor, omitted candidates."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from string import ascii_lowercase
from typing import Any

from models.common.printed import about, as_name, three_digits
from models.document.document import Document, Statement, Table, notes
from models.document.field import Field, Record
from models.document.text import BEST, ShownResult, join_words
from models.roads.iso8608 import Iso8608
from models.vehicle.names import PASSIVE
from sim.studies.recommend import GOALS
from sim.studies.recommend.confirm import SEEDS
from sim.studies.recommend.rating import Rating
from sim.studies.recommend.task import Contender, Task
from sim.studies.recommend.within import MOST_GAIN, TAIL
from sim.studies.ride.scores import COLUMNS

MOST_ROWS = 14  # largest number of table rows, so that the printed answer has at most 24 lines
NEAR = 0.85  # a limit counts as binding if a larger share of it is used
WORDS = {"ride": "ride", "holding": "road holding", "travel": "travel"}
DECIBELS = Field[float]("margin", lambda factor: 20 * math.log10(factor) if factor < 0.99 * MOST_GAIN else None, ".1f")
SHARE, CHANGE = Field[float]("share", float, ".0f", 100.0, unit="%"), Field[float]("change", float, "+.0f", 100.0, unit="%")


@dataclass(frozen=True, eq=False)
class RankedContender:
    """A ranked candidate.

    Attributes:
        candidate: controller and vehicle of the row.
        rating: rating in MuJoCo, or the expected rating if the candidate was not simulated.
        driven: True if the candidate was simulated in MuJoCo.
        keeps: True if the candidate keeps all limits, including the reserve.
    """

    candidate: Contender
    rating: Rating
    driven: bool
    keeps: bool

    @property
    def proved(self) -> bool | None:
        """True if stability and norm of the ideal loop are proved; None if the controller has no forces or no linear law."""
        one = self.candidate.controller
        return None if one.linear is not True or not one.acts else not one.certificate.failures


@dataclass(frozen=True, eq=False, repr=False)
class Recommendation(ShownResult):
    """Ranked candidates for a vehicle on a road.

    Attributes:
        task: task of the recommendation.
        rows: best candidate of each family; candidates that keep all limits come first.
        sensors: expected value of the goal with LQG control, for each tried set of sensor groups.
        bound: lower bound on the expected ride of all active controllers with the same sensors; None if it is not computed.
        left_out: omitted families and controllers of the file, by name, each with the reason.
        reserve: share of stroke and force that is kept in reserve for roads that were not simulated.
        interrupted: True if the search was interrupted.
    """

    task: Task
    rows: tuple[RankedContender, ...]
    sensors: Mapping[tuple[str, ...], float]
    bound: float | None
    left_out: Mapping[str, str]
    reserve: float
    interrupted: bool = False

    @property
    def passive(self) -> RankedContender | None:
        """The row of the unchanged passive vehicle."""
        return next((row for row in self.rows if row.candidate.name == PASSIVE), None)

    @property
    def better(self) -> list[RankedContender]:
        """Controllers that keep all limits and are better than the passive vehicle, the best first."""
        least = math.inf if self.passive is None else self.passive.rating.value(self.task)
        acting = (row for row in self.rows if row.keeps and row.candidate.controller.acts)
        return [row for row in acting if row.rating.value(self.task) < least]

    @property
    def best(self) -> RankedContender | None:
        """The best controller that keeps all limits; None if none is better than the passive vehicle."""
        return next(iter(self.better), None)

    @property
    def saved(self) -> RankedContender | None:
        """The best of the better controllers that a vehicle file can contain, so without preview and without a law in Python."""
        each = ((row, row.candidate.controller) for row in self.better)
        return next((row for row, one in each if (one.preview is None if one.linear is True else not one.user_code)), None)

    @property
    def summary(self) -> Document:
        """The ranked table with its explanation."""
        return describe(self)


def roads_driven(task: Task) -> int:
    """Returns the number of roads on which each candidate is simulated."""
    return len(SEEDS) if isinstance(task.road, Iso8608) else 1


def road_words(task: Task) -> str:
    """Returns a text that describes the road and the speed."""
    return task.road.words.replace("random, ", "").replace(", seed 0", "")


def letters(task: Task) -> dict[str, str]:
    """Returns the letter of every group of sensors."""
    return dict(zip(task.groups, ascii_lowercase, strict=False))


def sensor_groups(task: Task, row: RankedContender) -> list[str]:
    """Returns the groups of the sensors that a candidate measures."""
    measured = row.candidate.controller.measured if row.candidate.controller.acts else ()
    return [group for group, signals in task.groups.items() if {*signals} & {*measured}]


def change(result: Recommendation, row: RankedContender) -> float | None:
    """Returns the change of the goal relative to the passive vehicle; None for the passive vehicle itself."""
    usual = result.passive and result.passive.rating.value(result.task)
    return row.rating.value(result.task) / usual - 1 if usual and row is not result.passive else None


def binding(result: Recommendation, row: RankedContender) -> str:
    """Returns the limit that a row uses most; "-" if it is not nearly reached, and with "!" if it is exceeded."""
    used = result.task.within.used(row.rating.usage, result.reserve if row.driven else 0.0)
    name = max(used, key=used.__getitem__, default="")
    return "-" if not name or used[name] < NEAR else f"{name}!" if used[name] > 1 else name


def table(result: Recommendation) -> Table:
    """Returns the ranked table, which always contains the passive vehicle."""
    task, known, goal, passive = result.task, letters(result.task), GOALS[result.task.goal], result.passive
    rows = list(result.rows[:MOST_ROWS])
    if passive is not None and passive not in rows:
        rows[-1] = passive

    def column(key: str, label: str) -> Field[RankedContender]:
        def shown(row: RankedContender) -> str | None:
            value = row.rating.values.get(key)
            value = value if row.candidate.controller.acts or not COLUMNS[key].label.startswith("force") else 0.0
            return (
                None if value is None else three_digits(COLUMNS[key].scale * value) + BEST * (key == goal and row is result.best)
            )

        return Field(label, shown, unit=COLUMNS[key].unit)

    def disk(row: RankedContender) -> float:
        size = row.rating.usage.disk
        return (2 + size) / (2 - size) if size < 2 else math.inf

    def margin(row: RankedContender, factor: float) -> str:
        return DECIBELS.cell(factor) if row.candidate.pushes else "-"

    columns = [
        Field[RankedContender]("candidate", lambda row: row.candidate.name),
        column("ride", "ride"),
        Field[RankedContender]("travel", lambda row: SHARE.cell(row.rating.usage.stroke), unit="%"),
        column("dynamic_load", "tyre load"),
        column("force_rms", "force"),
        column("force_peak", "peak"),
        Field[RankedContender]("gain", lambda row: margin(row, row.rating.usage.gain_margin), unit="dB"),
        Field[RankedContender]("disk", lambda row: margin(row, disk(row)), unit="dB"),
        Field[RankedContender]("sensors", lambda row: "".join(known[name] for name in sensor_groups(task, row)) or "-"),
        Field[RankedContender]("proof", lambda row: {True: "yes", False: "no", None: "-"}[row.proved]),
        Field[RankedContender]("binds", lambda row: binding(result, row)),
    ]
    place = {"ride": 2, "travel": 3, "holding": 4}[task.goal]
    changes = Field[RankedContender](
        f"{WORDS[task.goal]} change [%]", lambda row: None if (one := change(result, row)) is None else CHANGE.digits(one)
    )
    columns.insert(place, changes)
    return Table.of("recommended", f"Candidates by {WORDS[task.goal]}.", columns, rows)


def legend(result: Recommendation, shown: int) -> str:
    """Returns sentences that explain the numbers and letters of the table, of which `shown` rows are printed."""
    task, count, left = result.task, roads_driven(result.task), len(result.rows) - shown
    how = f"Numbers of MuJoCo over {f'{count} roads' if count > 1 else 'the road'}"
    how = how if all(row.driven for row in result.rows) else "Expected values"
    sensors = ", ".join(f"{letter} {name}" for name, letter in letters(task).items())
    more = f" {left} more candidates are in --json." * bool(left)
    return f"{how}; travel in % of the stroke. {BEST}: recommended; !: exceeds the limit. Sensors: {sensors}.{more}"


def verdict(result: Recommendation, best: RankedContender | None) -> Statement:
    """Returns a sentence with the recommendation."""
    task, what = result.task, WORDS[result.task.goal]
    if best is None:
        return Statement(f"No candidate has a better {what} than the passive vehicle within the limits.", "ends", "brief")
    column, relative = COLUMNS[GOALS[task.goal]], change(result, best)
    number = f"{three_digits(column.scale * best.rating.value(task))} {column.unit}".rstrip()
    number += "" if relative is None else f", {CHANGE.text(relative)} from passive"
    measures = f" It measures {join_words([as_name(one) for one in names])}." if (names := sensor_groups(task, best)) else ""
    text = f"Best {what}: {as_name(best.candidate.name)}, {number} ({best.candidate.setting}).{measures}"
    return Statement(text, "note" if result.interrupted else "holds", "brief")


def describe(result: Recommendation) -> Document:
    """Returns the recommendation as a document."""
    task, known, column, texts = result.task, letters(result.task), COLUMNS[GOALS[result.task.goal]], list[str]()
    if result.bound is not None:
        unit = 10.0 ** (math.floor(math.log10(result.bound)) - 1)
        floor = about(unit * math.floor(result.bound / unit))
        texts.append(
            f"In linear analysis without limits, no controller with active forces has an expected ride below {floor} m/s². "
            "This is the ride of LQG with the same sensors, sample period, delay and hold."
        )
    whole = result.sensors.get(tuple(known), math.nan)
    if len(result.sensors) > 1:
        each = [
            f"{''.join(known[one] for one in groups)} {three_digits(column.scale * value)}"
            + f" ({CHANGE.text(value / whole - 1)})" * (len(groups) < len(known))
            for groups, value in result.sensors.items()
        ]
        usual = "" if task.random else " on class C"
        texts.append(
            f"Expected {WORDS[task.goal]}{usual} of the best LQG with different sensors: {', '.join(each)} {column.unit}."
        )
    kept, lift = result.reserve, 1 - (1 - result.reserve) ** TAIL
    reserve = (
        f" A reserve is kept for other roads: {SHARE.text(kept)} of stroke and force, and {SHARE.text(lift)} of the "
        f"time off the ground."
    )
    texts += [*task.assumed, f"Limits: {task.within.text}.{reserve * bool(kept)}"]
    left = "; ".join(f"{name} ({reason.rstrip('.')})" for name, reason in result.left_out.items())
    texts += [f"Left out: {left}."] if left else []
    texts += ["The search was interrupted: these are the candidates so far."] if result.interrupted else []
    ranked = table(result)
    texts.insert(0, legend(result, len(ranked.rows)))
    return Document("", (ranked, Document("", (verdict(result, result.best), *notes(*texts)))))


ROW = Record[RankedContender](
    name="candidate.name",
    setting="candidate.setting",
    measured="candidate.controller.measured",
    values=lambda row: dict(row.rating.values),
    used=lambda row: row.rating.usage._asdict(),
    proved="proved",
    keeps="keeps",
    driven="driven",
)


def record(result: Recommendation) -> dict[str, Any]:
    """Returns the recommendation as a JSON object, in SI units."""
    task = result.task
    return {
        "goal": task.goal,
        "road": task.road.describe(),
        "within": vars(task.within),
        "best": None if result.best is None else result.best.candidate.name,
        "candidates": [ROW(row) for row in result.rows],
        "lower_bound": result.bound,
        "by_sensors": [{"sensors": list(groups), "value": value} for groups, value in result.sensors.items()],
        "left_out": dict(result.left_out),
        "reserve": result.reserve,
        "roads": roads_driven(task),
        "assumed": task.assumed,
        "interrupted": result.interrupted,
    }
