"""A `Field` says once what a quantity is called, how it is written and where it is found; tables and JSON read it there."""

import math

from models.document.document import Table
from models.document.field import Field, Record, cells
from models.document.text import table_lines

LENGTHS: tuple[Field[float | None], ...] = (
    Field("length [mm]", lambda x: x, ".1f", 1e3, "length"),
    Field("at least", lambda x: x, "{:.0e}".format),
    Field("is", lambda x: "none" if x is None else "some"),
)


def test_one_quantity_in_three_forms():
    """A table has the number in its own unit and digits, JSON the number itself; no number is a dash and null."""
    rows = (("1234.6", "1e+00", "some"),)
    assert cells(LENGTHS, [1.23456]) == rows
    table = Table.of("lengths", "", LENGTHS, [1.23456])
    assert table_lines(table) == ["  length [mm]  at least    is", "  1234.6          1e+00  some"]
    assert table == Table("lengths", "", ("length [mm]", "at least", "is"), rows)
    assert Record(*LENGTHS)(1.23456) == {"length": 1.23456}
    for value, row in ((None, ("-", "-", "none")), (math.inf, ("-", "inf", "some"))):
        assert cells(LENGTHS, [value]) == (row,)
        assert Record(*LENGTHS)(value) == {"length": None}
