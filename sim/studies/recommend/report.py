"""Recommendation as text and JSON: one ranked table, the lower bound, what each sensor adds, and what was left out."""

import math
from collections.abc import Mapping, Sequence
from string import ascii_lowercase
from typing import Any

from models.common.printed import as_name
from models.document.document import Document, Statement, Table, notes
from models.document.field import Field, Record
from models.document.text import BEST, join_words
from models.roads.iso8608 import Iso8608
from sim.studies.recommend.recommend import Recommendation, Row, sensor_names
from sim.studies.recommend.task import GOALS, Goal, Task
from sim.studies.recommend.within import MOST_GAIN
from sim.studies.ride.standing import COLUMNS, digits

MOST_ROWS = 14  # of the table, so that it has at most 24 lines
NEAR = 0.85  # share of a limit from which it is said to bind
WORDS: dict[Goal, str] = {"ride": "ride", "holding": "road holding", "travel": "travel"}
DECIBELS = Field[float]("margin", float, ".1f")


def letters(task: Task) -> dict[str, str]:
    """Returns the letter of every group of sensors."""
    return dict(zip(task.groups, ascii_lowercase, strict=False))


def road_words(task: Task) -> str:
    """Returns the road and the speed in words."""
    road = task.road
    words = str(getattr(road, "words", "") or road.describe().get("type", "road"))
    if isinstance(road, Iso8608):
        words = words.replace(f", seed {road.seed}", "").replace("random, ", "")
    return words if "speed" in words else f"{words} at {road.speed:g} m/s"


def gain_of_disk(size: float) -> float:
    """Returns the factor on all forces, up or down, that a disk margin contains; infinite for 2."""
    return (2 + size) / (2 - size) if size < 2 else math.inf


def _margin(factor: float) -> str:
    return "-" if factor >= MOST_GAIN * 0.99 else DECIBELS.digits(20 * math.log10(factor))


def binding(row: Row, task: Task, reserve: float) -> str:
    """Returns the limit that a row uses most, if it nearly reaches it, with an exclamation mark if it exceeds it."""
    used = row.rating.used(task, reserve if row.driven else 0.0)
    name = max(used, key=used.__getitem__, default="")
    return "-" if not name or used[name] < NEAR else f"{name}!" if used[name] > 1 else name


def _fields(result: Recommendation) -> list[Field[Row]]:
    """Returns the columns of the table."""
    task, passive, known = result.task, result.passive, letters(result.task)
    goal = GOALS[task.goal]
    best = result.best

    def column(key: str, label: str = "") -> Field[Row]:
        one = COLUMNS[key]
        title = label or one.label

        def shown(row: Row) -> str | None:
            value = row.rating.values.get(key)
            mark = BEST if key == goal and row is best else ""
            return None if value is None else f"{digits(one.scale * value)}{mark}"

        return Field(title, shown, unit=one.unit)

    def change(row: Row) -> str | None:
        usual, value = (None if each is None else each.rating.value(task) for each in (passive, row))
        if not usual or value is None or row is passive:
            return None
        return f"{100 * (value / usual - 1):+.0f}"

    def sensors(row: Row) -> str:
        return "".join(known.get(name, "?") for name in sensor_names(task, row.candidate.sensors)) or "-"

    def proof(row: Row) -> str:
        return "-" if row.certified is None or not row.candidate.controller.acts else "yes" if row.certified else "no"

    changes = Field[Row](f"{WORDS[task.goal]} change [%]", change)

    def acting(row: Row) -> bool:
        return row.candidate.controller.acts and not row.candidate.vehicle.dampers

    own = [column("ride"), *([changes] if task.goal == "ride" else [])]
    holding = [column("dynamic_load", "tyre load"), *([changes] if task.goal == "holding" else [])]
    travel = [Field[Row]("travel", lambda row: f"{100 * row.rating.usage.stroke:.0f}", unit="%")]
    travel += [changes] if task.goal == "travel" else []
    return [
        Field("candidate", lambda row: row.candidate.name),
        *own,
        *travel,
        *holding,
        column("force_rms", "force"),
        column("force_peak", "peak"),
        Field("gain", lambda row: _margin(row.rating.usage.gain_margin) if acting(row) else "-", unit="dB"),
        Field("disk", lambda row: _margin(gain_of_disk(row.rating.usage.disk)) if acting(row) else "-", unit="dB"),
        Field("sensors", sensors),
        Field("proof", proof),
        Field("binds", lambda row: binding(row, task, result.reserve)),
    ]


def shown_rows(result: Recommendation) -> list[Row]:
    """Returns the rows of the table: the best ones, and the passive vehicle in any case."""
    rows = list(result.rows[:MOST_ROWS])
    passive = result.passive
    if passive is not None and passive not in rows:
        rows[-1] = passive
    return rows


def table(result: Recommendation) -> Table:
    """Returns the ranked table."""
    task, known = result.task, letters(result.task)
    driven = any(row.driven for row in result.rows)
    roads = f"{result.roads} roads" if isinstance(task.road, Iso8608) else "the road"
    how = f"In MuJoCo over {roads}" if driven else "Expected over the road; MuJoCo did not confirm these numbers"
    sensors = ", ".join(f"{letter} {name}" for letter, name in zip(known.values(), known, strict=True))
    rows = shown_rows(result)
    left = len(result.rows) - len(rows)
    more = f" {left} more candidates are in --json." if left else ""
    caption = f"{how}; travel in % of the stroke. {BEST}: recommended; !: exceeds the limit. Sensors: {sensors}.{more}"
    return Table.of("recommended", caption, _fields(result), rows)


def verdict(result: Recommendation) -> Statement:
    """Returns the answer in a sentence."""
    task, best, passive = result.task, result.best, result.passive
    what, unit = WORDS[task.goal], COLUMNS[GOALS[task.goal]].unit
    if best is None:
        return Statement(f"No candidate has a better {what} than the passive vehicle within the limits.", "ends", "brief")
    value, scale = best.rating.value(task), COLUMNS[GOALS[task.goal]].scale
    change = "" if passive is None else f", {100 * (value / passive.rating.value(task) - 1):+.0f} % from passive"
    number = f"{digits(scale * value)} {unit}".rstrip()
    sensors = join_words([as_name(name) for name in sensor_names(task, best.candidate.sensors)])
    measures = f" It measures {sensors}." if sensors else ""
    text = f"Best {what}: {as_name(best.candidate.name)}, {number}{change} ({best.candidate.setting}).{measures}"
    return Statement(text, "note" if result.interrupted else "holds", "brief")


def bound_sentence(result: Recommendation) -> list[str]:
    """Returns the sentence on the lower bound; empty without one."""
    if result.bound is None:
        return []
    unit = 10.0 ** (math.floor(math.log10(result.bound)) - 1)
    floor = f"{math.floor(result.bound / unit) * unit:.2g} m/s²"
    return [
        f"In linear analysis without limits, no controller has an expected ride below {floor} (LQG over the same sensors). This "
        "bound is for active laws only."
    ]


def sensor_sentence(result: Recommendation) -> list[str]:
    """Returns a sentence on what each sensor adds; empty for a single sensor."""
    task, values = result.task, result.sensors
    if len(values) < 2:
        return []
    one = COLUMNS[GOALS[task.goal]]
    whole = values.get(tuple(task.groups), math.nan)
    known = letters(task)
    each = [
        f"{''.join(known[group] for group in groups)} {digits(one.scale * value)}"
        + ("" if len(groups) == len(known) else f" ({100 * (value / whole - 1):+.0f} %)")
        for groups, value in values.items()
    ]
    unit = f" [{one.unit}]" if one.unit else ""
    return [f"Expected {WORDS[task.goal]} of the best LQG by its sensors{unit}: {'; '.join(each)}."]


def describe(result: Recommendation) -> Document:
    """Returns the recommendation as a document."""
    task = result.task
    about = [*bound_sentence(result), *sensor_sentence(result), *task.room.assumed]
    if result.reserve:
        about.append(
            f"Limits: {task.within.text}; {100 * result.reserve:.0f} % of stroke and force are a reserve for roads that were not driven."
        )
    else:
        about.append(f"Limits: {task.within.text}.")
    left = "; ".join(f"{name} ({reason.rstrip('.')})" for name, reason in result.left_out.items())
    about += [f"Left out: {left}."] if left else []
    if result.interrupted:
        about.append("The search was interrupted: these are the candidates so far.")
    return Document("", (table(result), Document("", (verdict(result), *notes(*about)))))


ROW = Record[Row](
    name=lambda row: row.candidate.name,
    family=lambda row: row.candidate.family,
    setting=lambda row: row.candidate.setting,
    measured=lambda row: list(row.candidate.sensors),
    values=lambda row: dict(row.rating.values),
    stroke=lambda row: row.rating.usage.stroke,
    force=lambda row: row.rating.usage.force,
    gain_margin=lambda row: row.rating.usage.gain_margin if row.rating.usage.gain_margin < MOST_GAIN else None,
    disk_margin=lambda row: row.rating.usage.disk,
    off_ground=lambda row: row.rating.usage.off_ground,
    certified=lambda row: row.certified,
    keeps=lambda row: row.keeps,
    driven=lambda row: row.driven,
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
        "by_sensors": _by_sensors(result.sensors),
        "left_out": dict(result.left_out),
        "reserve": result.reserve,
        "roads": result.roads,
        "assumed": list(task.room.assumed),
        "interrupted": result.interrupted,
    }


def _by_sensors(values: Mapping[Sequence[str], float]) -> list[dict[str, Any]]:
    return [{"sensors": list(groups), "value": value} for groups, value in values.items()]
