"""Recordings with several clocks as one table: MCAP files with channels in JSON, and MDF4 files of measuring systems.

All columns of the table use the times of the clock that has the most samples. Columns that were recorded with another clock are
interpolated linearly between samples, and have no value outside the time range of that clock.
"""

import json
import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, first_few, list_names

MDF_SUFFIXES = (".mf4", ".mdf")
TIME = "time [s]"
CLOCKS = frozenset(("time", "timestamp", "stamp", "t"))  # names of the fields that may contain the time of a message [s]


def mdf_rows(path: Path) -> list[Sequence[Any]]:
    """Returns the headings with units, and the recorded values, of all channels in an MDF4 file.

    Raises:
        InputError: the package for MDF4 files is not installed, or the file is not an MDF4 file or has no numbers.
    """
    try:
        from asammdf import MDF  # pyright: ignore[reportMissingImports] - an extra
    except ImportError:
        raise InputError(
            "an MDF4 file needs asammdf; run pip install 'roadproof[mdf]', or export the recording as .csv or .parquet"
        ) from None
    columns = dict[str, tuple[Array, Array]]()
    try:
        with MDF(path) as file:
            for i, group in enumerate(file.groups):
                for j in range(len(group.channels)):
                    one = file.get(group=i, index=j)
                    if j != file.masters_db.get(i) and one.samples.dtype.kind in "fiu" and one.samples.ndim == 1 and len(one):
                        name = one.name.replace("/", ".")
                        key = f"{name} [{one.unit}]" if one.unit else name
                        columns.setdefault(key, (one.timestamps, one.samples.astype(float)))
    except Exception as error:  # a parser of the package may raise its own type of error
        raise InputError(f"this is not an MDF4 file, or it is damaged ({error}); export the file again") from error
    return _rows(columns, "the file has no channel of numbers; export channels over time")


def mcap_rows(path: Path) -> list[Sequence[Any]]:
    """Returns the headings `topic.field`, and the recorded values, of all JSON channels in an MCAP file.

    If every channel has a field `time`, `timestamp`, `stamp` or `t` [s], the times are taken from the fields. If a channel
    lacks a field of time, the log times of all messages are used.

    Raises:
        InputError: the file is not MCAP, is damaged, or has no numbers in JSON.
    """
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    logged, own = defaultdict[str, list[int]](list), defaultdict[str, list[float]](list)
    fields, others = defaultdict[str, dict[str, list[float]]](dict), dict[str, str]()
    try:
        with path.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages():
                topic = channel.topic.strip("/").replace("/", ".")
                if channel.message_encoding != "json":
                    others[topic] = channel.message_encoding
                    continue
                content = dict(_numbers(json.loads(message.data)))
                own[topic].append(next((content.pop(name) for name in CLOCKS & content.keys()), math.nan))
                for name, number in content.items():
                    fields[topic].setdefault(name, [math.nan] * len(logged[topic])).append(number)
                logged[topic].append(message.log_time)
                for numbers in fields[topic].values():
                    numbers += [math.nan] * (len(logged[topic]) - len(numbers))
    except (McapError, ValueError) as error:
        raise InputError(
            f"this is not an MCAP file with JSON messages, or it is damaged ({error}); write the file again"
        ) from error
    stamped = all(np.isfinite(one).all() for one in own.values())
    first = min((one[0] for one in logged.values()), default=0)
    columns = dict[str, tuple[Array, Array]]()
    for topic, each in fields.items():
        time = np.array(own[topic]) if stamped else 1e-9 * (np.array(logged[topic]) - first)
        columns |= {f"{topic}.{name}": (time, np.array(numbers)) for name, numbers in each.items()}
    found = first_few([f"{topic}: {encoding}" for topic, encoding in others.items()], 5)
    what = f"channels in {list_names({*others.values()})} cannot be read ({found})" if others else "no channel has numbers"
    return _rows(columns, f"{what}; write channels in JSON, or export a table (.csv, .parquet)")


def _numbers(content: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Yields the numbers in a JSON message, each with a name such as `acceleration.z` or `wheel.0`."""
    if isinstance(content, dict | list):
        for key, one in content.items() if isinstance(content, dict) else enumerate(content):
            yield from _numbers(one, f"{path}.{key}" if path else str(key))
    elif isinstance(content, int | float) and not isinstance(content, bool):
        yield path, float(content)


def _rows(columns: dict[str, tuple[Array, Array]], without: str) -> list[Sequence[Any]]:
    """Combines columns that were recorded at different times into one table: headings, then rows. `without` is the error
    message for the case that there are no columns.
    """
    if not columns:
        raise InputError(without)
    clock = np.unique(max((time for time, _ in columns.values()), key=len))
    table = [clock]
    for time, values in columns.values():
        here = np.isfinite(values)
        same = len(time) == len(clock) and np.array_equal(time, clock)
        table.append(values if same or not here.any() else np.interp(clock, time[here], values[here], left=np.nan, right=np.nan))
    return [[TIME, *columns], *zip(*(np.broadcast_to(one, clock.shape).tolist() for one in table), strict=True)]
