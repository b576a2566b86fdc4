"""Output of the gallery as documents and as JSON: published numbers, computed numbers, and the list of sources."""

from collections.abc import Sequence
from operator import attrgetter
from typing import Any

from models.document.document import Document, Statement, Table, notes
from models.document.field import Field, Record
from models.document.text import join_words
from sim.studies.gallery.entries import SOURCES, Entry, names
from sim.studies.gallery.numbers import DIFFERS, ON_ITS_GRID, REPRODUCED, WRONG, ComparedNumber

Result = tuple[Entry, Sequence[ComparedNumber]]

NUMBERS: tuple[Field[ComparedNumber], ...] = (
    Field("number", lambda one: one.printed.text, key="number"),
    Field("where", lambda one: one.printed.where, key="where", detail="full"),
    Field("printed", lambda one: one.printed.shown),
    Field("exact", lambda one: f"{one.exact:.{17 if one.printed.digits > 12 else 9}g}"),
    Field("grid", lambda one: one.grid, ".7g", key="grid"),
    Field("MuJoCo", lambda one: one.mujoco, ".7g", key="mujoco"),
    Field("verdict", lambda one: one.verdict, key="verdict"),
)
COUNTS: tuple[Field[Result], ...] = (
    Field("entry", lambda of: of[0].name),
    Field("source", lambda of: of[0].title, detail="full"),
    Field(REPRODUCED, lambda of: str(sum(one.verdict in (REPRODUCED, ON_ITS_GRID) for one in of[1]))),
    *(Field[Result](word, lambda of, word=word: str(sum(one.verdict == word for one in of[1]))) for word in (DIFFERS, WRONG)),
    Field("not compared", lambda of: str(len(of[0].missing))),
)


def describe(entry: Entry, numbers: Sequence[ComparedNumber]) -> Document:
    """Returns the document about an entry: the source, reasons for differences, and a table of the numbers."""
    wrong, exact = [one for one in numbers if one.verdict == WRONG], NUMBERS[3]
    fails = [f"{one.printed.text} is {WRONG}: {exact.cell(one)}, not {one.printed.shown}." for one in wrong]
    origin = f"Entry `{entry.name}`.", entry.about, f"Source: {entry.source}. Licence: {entry.licence}."
    text = [" ".join(filter(None, origin))]
    text += dict.fromkeys(f"Reason for a difference: {one.printed.reason}." for one in numbers if one.verdict == DIFFERS)
    text += ["Numbers in brackets follow from data or a formula of the source."] * any(one.printed.derived for one in numbers)
    text += [f"This published result is not compared: {one.what}. Reason: {one.why}." for one in entry.missing]
    shown = [field for field in NUMBERS if field.key != "grid" or any(one.grid is not None for one in numbers)]
    tables = [Table.of(f"gallery-{entry.name}", "Published numbers and computed numbers.", shown, numbers, 2)] if numbers else []
    return Document(entry.title, (*(Statement(one, "fails") for one in fails), *notes(*text), *tables))


def summary(results: Sequence[Result]) -> Document:
    """Returns the document about several entries: the share of reproduced numbers, and the list of sources."""
    counts = [[int(field.cell(one)) for field in COUNTS[2:]] for one in results]
    reproduced, differ, wrong, missing = (sum(each) for each in zip(*counts, strict=True))
    derived = sum(one.printed.derived for _, numbers in results for one in numbers)
    text = f"{_numbers(reproduced)} reproduced to all digits"
    text += f", and {differ} differ{'s' * (differ == 1)} for a known reason" * bool(differ)
    text += f"; {_numbers(wrong)} {WRONG}." if wrong else "."
    more = [f"Published results that are not compared: {missing}."] if missing else []
    more += [f"{_numbers(derived)} from data or a formula of the source; the others are published."] if derived else []
    with_numbers, without = sources([entry for entry, _ in results])
    if {entry.name for entry, _ in results} == {*names()}:
        more.append(f"The gallery has numbers from {len(with_numbers)} of {len(SOURCES)} published sources.")
        more.append(f"The entries explain why {join_words(without)} have no numbers.")
    table = Table.of("gallery", "The entries, and how many of their numbers are reproduced.", COUNTS, results, 2, detail="brief")
    state = "fails" if wrong else "holds"
    return Document("", (table, Statement(text, state, "brief"), *notes(*more, detail="brief")), "brief")


def _numbers(count: int) -> str:
    return f"{count} number is" if count == 1 else f"{count} numbers are"


def sources(entries: Sequence[Entry]) -> tuple[list[str], list[str]]:
    """Returns two lists: sources with published numbers, and sources whose model no vehicle file can express."""
    with_numbers = {name for entry in entries for name in entry.sources}
    without = {lack.source for entry in entries for lack in entry.missing}
    return [one for one in SOURCES if one in with_numbers], [one for one in SOURCES if one in without - with_numbers]


NUMBER = Record[ComparedNumber](
    *NUMBERS,
    exact="exact",
    printed="printed.value",
    **{key: attrgetter(f"printed.{key}") for key in ("digits", "unit", "reason", "derived")},
)
ENTRY = Record[Result](
    **{key: lambda of, key=key: getattr(of[0], key) for key in ("name", "title", "about", "source", "licence", "sources")},
    numbers=NUMBER.all(lambda of: [*of[1]]),
    missing=lambda of: of[0].missing,
)


def record(results: Sequence[Result]) -> dict[str, Any]:
    """Returns the compared numbers as a JSON object."""
    with_numbers, without = sources([entry for entry, _ in results])
    known = {"all": list(SOURCES), "with_numbers": with_numbers, "not_expressible": without}
    return {"entries": [ENTRY(each) for each in results], "sources": known}
