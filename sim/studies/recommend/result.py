"""Result of a recommendation, also as text, JSON and vehicle file: ranked table, lower bound, benefit of sensors, and omitted
candidates.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from models.common.errors import InputError
from models.common.files import whole_file
from models.common.printed import about, as_name, three_digits
from models.common.toml_edit import section_lines
from models.document.document import Document, Statement, Table, notes
from models.document.field import Field, Record
from models.document.text import BEST, CHANGE, ShownResult, names_text
from models.vehicle.in_place import with_sections
from models.vehicle.names import PASSIVE
from models.vehicle.vehicle import parse_vehicle
from sim.studies.recommend import GOALS
from sim.studies.recommend.rating import Rating
from sim.studies.recommend.task import Contender, Task
from sim.studies.recommend.within import LIFT_RESERVE, MOST_GAIN, Usage
from sim.studies.ride.scores import COLUMNS, FIELDS
from synth.command.save import controller_section
from synth.controller.disk_margin import DiskMargin

MOST_ROWS = 14  # largest number of table rows, so that the printed answer has at most 24 lines
NEAR = 0.85  # a limit counts as binding if a larger share of it is used than this
SECTION = "best"  # name of the controller in a saved vehicle file
WORDS = {"ride": "ride", "holding": "road holding", "travel": "travel"}
SHARE, CHANGED = Field[float]("share", float, ".0f", 100.0, unit="%"), Field[float]("change", float, "+.0f", 100.0, unit="%")


@dataclass(frozen=True, eq=False)
class RankedContender:
    """A ranked candidate.

    Attributes:
        candidate: ranked candidate, with its controller and its vehicle.
        rating: rating of the candidate in MuJoCo; the expected rating if the candidate was not simulated.
        driven: True if the candidate was simulated in MuJoCo.
        used: used share of each limit, including the reserve, by name of the limit; 1 if the limit is just reached.
    """

    candidate: Contender
    rating: Rating
    driven: bool
    used: Mapping[str, float]

    @property
    def keeps(self) -> bool:
        """True if the candidate keeps all limits, including the reserve."""
        return max(self.used.values(), default=0.0) <= 1

    @property
    def binds(self) -> str:
        """The name of the limit with the largest used share, followed by "!" if this limit is exceeded; "-" if no limit is
        nearly reached.
        """
        name = max(self.used, key=self.used.__getitem__, default="")
        return "-" if not name or self.used[name] < NEAR else f"{name}{'!' * (not self.keeps)}"

    @property
    def proved(self) -> bool | None:
        """True if stability and the norm bound of the ideal loop are proved; None if the controller has no forces or no linear
        law.
        """
        one = self.candidate.controller
        return None if one.linear is not True or not one.acts else not one.certificate.failures


@dataclass(frozen=True, eq=False, repr=False)
class Recommendation(ShownResult):
    """Ranked candidates for a vehicle on a road.

    Attributes:
        task: task for which the controllers are recommended.
        rows: best candidate of each family; candidates that keep all limits precede the other candidates.
        sensors: expected value of the goal with LQG control, for each set of sensor groups that was tried; infinite if no law
            keeps the limits.
        bound: lower bound on the expected ride value of all active controllers with the same sensors; None if no bound was
            computed.
        left_out: reason why a family of candidates or a controller of the vehicle file was omitted, by name.
        reserve: share of stroke and force that is kept in reserve for roads that were not simulated.
        interrupted: True if Ctrl-C interrupted the search.
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
        """The table row of the passive vehicle, which is not changed."""
        return next((row for row in self.rows if row.candidate.name == PASSIVE), None)

    @property
    def better(self) -> list[RankedContender]:
        """Controllers that keep all limits and are better than the passive vehicle, best first."""
        least = math.inf if self.passive is None else self.passive.rating.value(self.task)
        acting = (row for row in self.rows if row.keeps and row.candidate.controller.acts)
        return [row for row in acting if row.rating.value(self.task) < least]

    @property
    def best(self) -> RankedContender | None:
        """The best controller that keeps all limits; None if no such controller is better than the passive vehicle."""
        return next(iter(self.better), None)

    @property
    def saved(self) -> RankedContender | None:
        """The best controller of `better` that a vehicle file can contain, so without preview and without a law in Python."""
        each = ((row, row.candidate.controller) for row in self.better)
        return next((row for row, one in each if (one.preview is None if one.linear is True else not one.user_code)), None)

    def change(self, row: RankedContender) -> float | None:
        """Returns the relative change of the goal's value from the passive vehicle; None for the passive vehicle itself."""
        usual = self.passive and self.passive.rating.value(self.task)
        return row.rating.value(self.task) / usual - 1 if usual and row is not self.passive else None

    def measured(self, row: RankedContender) -> list[str]:
        """Returns the groups of sensors whose signals a candidate measures."""
        names = row.candidate.controller.measured if row.candidate.controller.acts else ()
        return [group for group, signals in self.task.groups.items() if {*signals} & {*names}]

    @property
    def summary(self) -> Document:
        """Document that contains the ranked table and explains the table."""
        ranked = table(self)
        return Document("", (ranked, Document("", (verdict(self, self.best), *notes(*explanations(self, len(ranked.rows)))))))


def table(result: Recommendation) -> Table:
    """Returns the ranked table of candidates, which always contains the passive vehicle."""
    task, goal, passive, letters = result.task, GOALS[result.task.goal], result.passive, result.task.letters
    rows = list(result.rows[:MOST_ROWS])
    if passive is not None and passive not in rows:
        rows[-1] = passive

    def starred(key: str, one: Field[RankedContender]) -> Field[RankedContender]:
        star = BEST if key == goal else ""
        return replace(one, value=lambda row: one.cell(row) + star * (row is result.best))

    def column(key: str, label: str) -> Field[RankedContender]:
        of_key = next(one for one in FIELDS if one.key == key)
        return starred(key, of_key.of(lambda row: row.rating, label))  # pyright: ignore[reportArgumentType, reportAttributeAccessIssue]

    def decibels(label: str, factor: Callable[[Usage], float]) -> Field[RankedContender]:
        def value(row: RankedContender) -> float | None:
            most = factor(row.rating.usage)
            return 20 * math.log10(most) if row.candidate.pushes and most < 0.99 * MOST_GAIN else None

        return Field(label, value, ".1f", unit="dB")

    columns = [
        Field[RankedContender]("candidate", lambda row: row.candidate.name),
        column("ride", "ride"),
        starred("peak_travel", Field("travel", lambda row: row.rating.usage.stroke, ".0f", 100.0, unit="%")),
        column("dynamic_load", "tyre load"),
        column("force_rms", "force"),
        column("force_peak", "peak"),
        decibels("gain", lambda usage: usage.gain_margin),
        decibels("disk", lambda usage: DiskMargin(usage.disk, math.nan).gain[1]),
        Field[RankedContender]("sensors", lambda row: "".join(letters[name] for name in result.measured(row)) or "-"),
        Field[RankedContender]("proof", lambda row: {True: "yes", False: "no", None: "-"}[row.proved]),
        Field[RankedContender]("binds", lambda row: row.binds),
    ]
    place = {"ride": 2, "travel": 3, "holding": 4}[task.goal]
    columns.insert(place, Field[RankedContender](f"{WORDS[task.goal]}{CHANGE}", result.change, "+.0f", 100.0))
    return Table.of("recommended", f"Candidates by {WORDS[task.goal]}.", columns, rows)


def verdict(result: Recommendation, best: RankedContender | None) -> Statement:
    """Returns a sentence with the recommendation."""
    task, what = result.task, WORDS[result.task.goal]
    if best is None:
        return Statement(f"No candidate within the limits has a better {what} than the passive vehicle.", "ends", "brief")
    column, relative = COLUMNS[GOALS[task.goal]], result.change(best)
    number = f"{three_digits(column.scale * best.rating.value(task))} {column.unit}".rstrip()
    number += "" if relative is None else f", {CHANGED.text(relative)} from passive"
    measures = f" It measures {names_text(names)}." if (names := result.measured(best)) else ""
    text = f"Best {what}: {as_name(best.candidate.name)}, {number} ({best.candidate.setting}).{measures}"
    return Statement(text, "note" if result.interrupted else "holds", "brief")


def explanations(result: Recommendation, shown: int) -> list[str]:
    """Returns the sentences that are printed below a table with `shown` rows."""
    task, what, known, column = result.task, WORDS[result.task.goal], result.task.letters, COLUMNS[GOALS[result.task.goal]]
    where = f"Numbers of MuJoCo over {f'{task.roads} roads' if task.roads > 1 else 'the road'}"
    more = f" Only with --json: {len(result.rows) - shown} more of the candidates." * (len(result.rows) > shown)
    texts = [
        f"{where if all(row.driven for row in result.rows) else 'Expected values'}; travel in % of the stroke. {BEST}: "
        f"recommended; !: exceeds the limit. Sensors: {', '.join(f'{letter} {name}' for name, letter in known.items())}.{more}"
    ]
    if result.bound is not None:
        unit = 10.0 ** (math.floor(math.log10(result.bound)) - 1)
        floor = about(unit * math.floor(result.bound / unit))
        texts.append(
            f"In linear analysis without limits, no controller with active forces has an expected ride below {floor} m/s². "
            "This is the ride of LQG with the same sensors, sample period, delay and hold."
        )
    if len(result.sensors) > 1:
        whole, each = result.sensors[tuple(known)], list[str]()
        for groups, value in result.sensors.items():
            part = f" ({CHANGED.text(value / whole - 1)})" * (len(groups) < len(known) and math.isfinite(whole))
            number = f"{three_digits(column.scale * value)}{part}" if math.isfinite(value) else "not within the limits"
            each.append(f"{''.join(known[one] for one in groups)} {number}")
        usual, unit = " on class C" * (not task.random), f" [{column.unit}]" * bool(column.unit)
        texts.append(f"Expected {what}{usual} of the best LQG with different sensors{unit}: {', '.join(each)}.")
    kept = result.reserve
    reserve = f"{SHARE.text(kept)} of stroke and force, and {SHARE.text(LIFT_RESERVE)} of the time off the ground"
    texts += [*task.assumed, f"Limits: {task.within.text}.{f' A reserve is kept for other roads: {reserve}.' * bool(kept)}"]
    left = "; ".join(f"{name} ({reason.rstrip('.')})" for name, reason in result.left_out.items())
    texts += [f"Left out: {left}."] if left else []
    return [*texts, *(["The search was interrupted: these are the candidates so far."] if result.interrupted else [])]


def save(path: Path, result: Recommendation) -> str:
    """Writes a vehicle file with the recommended controller; returns the name of the controller's section.

    A vehicle file cannot contain a controller with preview. If the best controller has preview, the next best controller is
    written. The section is named `best`, followed by a number if the file already has a controller of this name.

    Raises:
        InputError: no recommended controller can be part of a vehicle file, or the file cannot be written.
    """
    row, vehicle, taken = result.saved, result.task.vehicle, result.task.vehicle.controllers
    if row is None:
        raise InputError(
            "--save has nothing to write, because no controller that satisfies the limits is better than the passive "
            "vehicle; give wider limits, or omit --save"
        )
    name = next(one for i in range(1, len(taken) + 2) if (one := SECTION if i == 1 else f"{SECTION}_{i}") not in taken)
    one, usage = row.candidate.controller, row.rating.usage
    used = f", force {SHARE.text(usage.force)} of its limit, disk margin {usage.disk:g}" * row.candidate.pushes
    lines = [
        f"# roadproof recommend, {result.task.road_words}, within {result.task.within.text}",
        f"# {verdict(result, row).text}",
        f"# travel {SHARE.text(usage.stroke)} of the stroke{used}",
    ]
    if one.linear is True:
        lines += controller_section(vehicle, replace(one, name=name), name)
    else:
        lines += section_lines(("controllers", name), one.law.record)
    text = with_sections(vehicle.text_for(path), lines)
    parse_vehicle(text, folder=path.parent)  # checks that the written file can be read
    with whole_file(path, "save") as beside:
        beside.write_text(text, encoding="utf-8", newline="\n")
    return name


CANDIDATE = Record[RankedContender](
    "driven",
    "keeps",
    "proved",
    name="candidate.name",
    setting="candidate.setting",
    measured="candidate.controller.measured",
    values="rating.values",
    used=lambda row: row.rating.usage._asdict(),
)
RECORD = Record[Recommendation](
    "interrupted",
    "left_out",
    "reserve",
    goal="task.goal",
    road=lambda result: result.task.road.describe(),
    within="task.within",
    best=lambda result: result.best and result.best.candidate.name,
    candidates=CANDIDATE.all("rows"),
    lower_bound="bound",
    by_sensors=lambda result: [{"sensors": groups, "value": value} for groups, value in result.sensors.items()],
    roads="task.roads",
    assumed="task.assumed",
)
