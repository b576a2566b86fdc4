"""A `Column` says once what a quantity is called, how it is written and where it is found; tables and JSON read it there."""

import math

import pytest

from models.common.printed import Column, cells, column_table, json_object, titles
from models.figures.page import Table
from sim.studies.ride.run_metrics import METRIC, MetricComparison

LENGTHS: tuple[Column[float | None], ...] = (
    Column("length [mm]", lambda x: x, ".1f", 1e3, "length"),
    Column("at least", lambda x: x, "{:.0e}".format),
    Column("is", lambda x: "none" if x is None else "some"),
)


def test_one_quantity_in_three_forms():
    """A table has the number in its own unit and digits, JSON the number itself under the key, and nothing without a key."""
    rows = (("1234.6", "1e+00", "some"),)
    assert cells(LENGTHS, [1.23456]) == rows
    assert column_table(LENGTHS, [1.23456]) == ["  length [mm]  at least    is", "  1234.6          1e+00  some"]
    assert Table.of("lengths", "", LENGTHS, [1.23456]) == Table("lengths", "", ("length [mm]", "at least", "is"), rows)
    assert json_object(LENGTHS, 1.23456) == {"length": 1.23456}


@pytest.mark.parametrize(("value", "row"), [(None, ("-", "-", "none")), (math.inf, ("-", "inf", "some"))])
def test_what_is_no_number(value, row):
    """It is a dash in a table, unless a form of its own writes it, and null in JSON."""
    assert cells(LENGTHS, [value]) == (row,)
    assert json_object(LENGTHS, value) == {"length": None}


def test_the_same_quantity_elsewhere():
    """What has a result has its quantities, under their title or another one."""

    def second(pair: tuple[str, float]) -> float:
        return pair[1]

    pair = LENGTHS[0].of(second, "its length [mm]"), LENGTHS[2].of(second)
    assert titles(pair) == ("its length [mm]", "is")
    assert cells(pair, [("a", 0.5)]) == (("500.0", "some"),)
    assert json_object(pair, ("a", 0.5)) == {"length": 0.5}


def test_a_metric_is_read_where_it_stands():
    """Each number of a metric stands under its own title and key."""
    one = MetricComparison("m", mujoco=1.0, sampled=2.0, expected=3.0, spread=4.0, approximate=False)
    assert json_object(METRIC, one) == {"unit": "m", "mujoco": 1.0, "linear": 2.0, "expected": 3.0, "spread": 4.0}
    said = dict(zip(titles(METRIC), cells(METRIC, [one])[0], strict=True))
    assert said == {"unit": "m", "MuJoCo": "1", "sampled": "2", "expected": "3", "+- by road": "4"}
