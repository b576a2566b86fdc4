"""Recommendation as text and JSON: one ranked table, the lower bound, what each sensor adds, and what was left out."""

import math
from string import ascii_lowercase
from typing import Any

from models.common.printed import about, as_name
from models.document.document import Document, Statement, Table, notes
from models.document.field import Field, Record
from models.document.text import BEST, join_words
from sim.studies.recommend.recommend import Recommendation, Row, roads_driven
from sim.studies.recommend.task import GOALS, Task
from sim.studies.recommend.within import MOST_GAIN
from sim.studies.ride.standing import COLUMNS, digits

MOST_ROWS = 14  # of the table, so that it has at most 24 lines
NEAR = 0.85  # share of a limit from which it binds
WORDS = {"ride": "ride", "holding": "road holding", "travel": "travel"}
DECIBELS = Field[float]("margin", lambda factor: 20 * math.log10(factor) if factor < 0.99 * MOST_GAIN else None, ".1f")
SHARE, CHANGE = Field[float]("share", float, ".0f", 100.0, unit="%"), Field[float]("change", float, "+.0f", 100.0, unit="%")


def road_words(task: Task) -> str:
    """Returns the road and the speed in words."""
    return task.road.words.replace("random, ", "").replace(", seed 0", "")


def letters(task: Task) -> dict[str, str]:
    """Returns the letter of every group of sensors."""
    return dict(zip(task.groups, ascii_lowercase, strict=False))


def sensor_groups(task: Task, row: Row) -> list[str]:
    """Returns the groups of the sensors that a candidate measures."""
    measured = row.candidate.controller.measured if row.candidate.controller.acts else ()
    return [group for group, signals in task.groups.items() if {*signals} & {*measured}]


def change(result: Recommendation, row: Row) -> float | None:
    """Returns the relative change of the goal from the passive vehicle; None for itself."""
    usual = result.passive and result.passive.rating.value(result.task)
    return row.rating.value(result.task) / usual - 1 if usual and row is not result.passive else None


def binding(result: Recommendation, row: Row) -> str:
    """Returns the limit that a row uses most, if it nearly reaches it, with an exclamation mark if it exceeds it."""
    used = result.task.within.used(row.rating.usage, result.reserve if row.driven else 0.0)
    name = max(used, key=used.__getitem__, default="")
    return "-" if not name or used[name] < NEAR else f"{name}!" if used[name] > 1 else name


def table(result: Recommendation) -> Table:
    """Returns the ranked table, with the passive vehicle in any case."""
    task, known, goal, passive = result.task, letters(result.task), GOALS[result.task.goal], result.passive
    rows = list(result.rows[:MOST_ROWS])
    if passive is not None and passive not in rows:
        rows[-1] = passive

    def column(key: str, label: str) -> Field[Row]:
        def shown(row: Row) -> str | None:
            value = row.rating.values.get(key)
            return None if value is None else digits(COLUMNS[key].scale * value) + BEST * (key == goal and row is result.best)

        return Field(label, shown, unit=COLUMNS[key].unit)

    def disk(row: Row) -> float:
        size = row.rating.usage.disk
        return (2 + size) / (2 - size) if size < 2 else math.inf

    def margin(row: Row, factor: float) -> str:
        return DECIBELS.cell(factor) if row.candidate.pushes else "-"

    columns = [
        Field[Row]("candidate", lambda row: row.candidate.name),
        column("ride", "ride"),
        Field[Row]("travel", lambda row: SHARE.cell(row.rating.usage.stroke), unit="%"),
        column("dynamic_load", "tyre load"),
        column("force_rms", "force"),
        column("force_peak", "peak"),
        Field[Row]("gain", lambda row: margin(row, row.rating.usage.gain_margin), unit="dB"),
        Field[Row]("disk", lambda row: margin(row, disk(row)), unit="dB"),
        Field[Row]("sensors", lambda row: "".join(known[name] for name in sensor_groups(task, row)) or "-"),
        Field[Row]("proof", lambda row: {True: "yes", False: "no", None: "-"}[row.proved]),
        Field[Row]("binds", lambda row: binding(result, row)),
    ]
    place = {"ride": 2, "travel": 3, "holding": 4}[task.goal]
    changes = Field[Row](
        f"{WORDS[task.goal]} change [%]", lambda row: None if (one := change(result, row)) is None else CHANGE.digits(one)
    )
    columns.insert(place, changes)
    count = roads_driven(task)
    how = (
        f"In MuJoCo over {f'{count} roads' if count > 1 else 'the road'}"
        if all(row.driven for row in rows)
        else "Expected values"
    )
    left = len(result.rows) - len(rows)
    sensors = ", ".join(f"{letter} {name}" for name, letter in known.items())
    caption = f"{how}; travel in % of the stroke. {BEST}: recommended; !: exceeds the limit. Sensors: {sensors}."
    return Table.of("recommended", caption + f" {left} more candidates are in --json." * bool(left), columns, rows)


def verdict(result: Recommendation) -> Statement:
    """Returns the answer in a sentence."""
    task, best, what = result.task, result.best, WORDS[result.task.goal]
    if best is None:
        return Statement(f"No candidate has a better {what} than the passive vehicle within the limits.", "ends", "brief")
    column, relative = COLUMNS[GOALS[task.goal]], change(result, best)
    number = f"{digits(column.scale * best.rating.value(task))} {column.unit}".rstrip()
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
            f"In linear analysis without limits, no controller has an expected ride below {floor} m/s² (LQG over the same "
            "sensors). This is for active laws only."
        )
    whole = result.sensors.get(tuple(known), math.nan)
    if len(result.sensors) > 1:
        each = [
            f"{''.join(known[one] for one in groups)} {digits(column.scale * value)}"
            + f" ({CHANGE.text(value / whole - 1)})" * (len(groups) < len(known))
            for groups, value in result.sensors.items()
        ]
        texts.append(f"Expected {WORDS[task.goal]} of the best LQG by its sensors: {', '.join(each)} {column.unit}.")
    kept = (
        f"; {SHARE.text(result.reserve)} of stroke and force are a reserve for roads that were not driven"
        if result.reserve
        else ""
    )
    texts += [*task.assumed, f"Limits: {task.within.text}{kept}."]
    left = "; ".join(f"{name} ({reason.rstrip('.')})" for name, reason in result.left_out.items())
    texts += [f"Left out: {left}."] if left else []
    texts += ["The search was interrupted: these are the candidates so far."] if result.interrupted else []
    return Document("", (table(result), Document("", (verdict(result), *notes(*texts)))))


ROW = Record[Row](
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
