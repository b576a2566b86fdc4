"""The gallery as text and as JSON: the numbers of every entry, and which sources are there."""

from collections.abc import Sequence
from typing import Any

from models.common.printed import table, titled
from models.document.field import Field, json_object
from sim.studies.gallery.entries import PAPER, SOURCES, Entry
from sim.studies.gallery.numbers import ComparedNumber

Result = tuple[Entry, Sequence[ComparedNumber]]

BRACKETS = "in brackets: the source prints data or a formula, from which the number follows"
COLUMNS: tuple[Field[ComparedNumber], ...] = (
    Field("number", lambda one: one.printed.text, key="number"),
    Field("printed", lambda one: one.printed.shown),
    Field("exact", lambda one: one.shown_exact),
    Field("grid", lambda one: one.grid, ".7g", key="grid"),
    Field("MuJoCo", lambda one: one.mujoco, ".7g", key="mujoco"),
    Field("verdict", lambda one: one.verdict.partition(":")[0], key="verdict"),
)


def columns(numbers: Sequence[ComparedNumber]) -> list[Field[ComparedNumber]]:
    """Returns the columns of a table of numbers, that of grids only if one has a grid."""
    return [one for one in COLUMNS if one.title != "grid" or any(number.grid is not None for number in numbers)]


def entry_lines(entry: Entry, numbers: Sequence[ComparedNumber]) -> list[str]:
    """Returns an entry for the terminal."""
    lines = [*titled(f"{entry.name}: {entry.title}", entry.source)]
    if numbers:
        shown = columns(numbers)
        lines += table([[column.title for column in shown], *([column.cell(one) for column in shown] for one in numbers)])
    lines += [f"  {reason}" for reason in reasons(numbers)]
    lines += [f"  {BRACKETS}"] if any(one.printed.derived for one in numbers) else []
    return [*lines, *(f"  not expressible: {one.what}: {one.why}" for one in entry.missing), ""]


def reasons(numbers: Sequence[ComparedNumber]) -> list[str]:
    """Returns why numbers differ, each reason once."""
    return [*dict.fromkeys(one.verdict for one in numbers if not one.reproduced)]


def counts(entry: Entry, numbers: Sequence[ComparedNumber]) -> tuple[int, int, int, int]:
    """Returns how many numbers are reproduced, differ for a reason, are wrong, and are not expressible."""
    return (
        sum(one.reproduced for one in numbers),
        sum(not one.reproduced and one.explained for one in numbers),
        sum(one.wrong for one in numbers),
        len(entry.missing),
    )


def brief_lines(results: Sequence[Result]) -> list[str]:
    """Returns a table with a row for each entry."""
    rows = [(f"{entry.name}", *(str(one or "-") for one in counts(entry, numbers))) for entry, numbers in results]
    return table([("entry", "reproduced", "differ", "WRONG", "not expressible"), *rows])


def last_lines(results: Sequence[Result]) -> list[str]:
    """Returns how many numbers are reproduced, and which sources are there."""
    reproduced, differ, wrong, missing = (sum(each) for each in zip(*(counts(*one) for one in results), strict=True))
    derived = sum(one.printed.derived for _, numbers in results for one in numbers)
    last = f"{reproduced} numbers reproduced to all digits, {differ} differ for a reason, {wrong} NOT REPRODUCED"
    lines = [f"{last}; {missing} not expressible"]
    if derived:
        lines.append(f"{derived} of them follow from a source's data or formula, the others are printed")
    entries = [entry for entry, _ in results]
    if any(entry.name == PAPER for entry in entries):
        with_numbers, without = sources(entries)
        lines.append(
            f"of {len(SOURCES)} published sources {len(with_numbers) + len(without)} are here: {len(with_numbers)} with numbers, "
            f"{len(without)} with the reason why not ({', '.join(without)})"
        )
    return lines


def sources(entries: Sequence[Entry]) -> tuple[list[str], list[str]]:
    """Returns the sources of entries: those with numbers, and those that are not expressible."""
    with_numbers = {name for entry in entries for name in entry.sources}
    without = {lack.source for entry in entries for lack in entry.missing}
    return [one for one in SOURCES if one in with_numbers], [one for one in SOURCES if one in without - with_numbers]


def sources_object(entries: Sequence[Entry]) -> dict[str, Any]:
    """Returns for JSON which sources are there."""
    with_numbers, without = sources(entries)
    return {"sources": {"all": list(SOURCES), "with_numbers": with_numbers, "not_expressible": without}}


def entry_object(entry: Entry, numbers: Sequence[ComparedNumber]) -> dict[str, Any]:
    """Returns an entry for JSON."""
    return {
        "name": entry.name,
        "title": entry.title,
        "about": entry.about,
        "source": entry.source,
        "licence": entry.licence,
        "sources": list(entry.sources),
        "numbers": [
            {
                **json_object(COLUMNS, one),
                "exact": one.exact,
                "where": one.printed.where,
                "printed": one.printed.value,
                "digits": one.printed.digits,
                "unit": one.printed.unit,
                "reason": one.printed.reason,
                "derived": one.printed.derived,
            }
            for one in numbers
        ],
        "missing": [vars(one) for one in entry.missing],
    }
