"""A campaign's results on disk: one Parquet file for each batch while it runs, and one for all runs when it is done.

The name of a batch's file has its first run and the run after its last. Files are complete or do not exist, so a campaign goes on
after any end: it runs what has no file. A file that is cut or empty is run again.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from models.common.arrays import Array
from models.common.files import whole_file
from sim.campaign.columns import Column
from sim.campaign.manifest import FULL, RESULTS

PART = re.compile(r"part-(\d{9})-(\d{9})\.parquet")
TYPES = {int: pa.int64(), float: pa.float64(), str: pa.string()}


@dataclass(frozen=True)
class Part:
    """The file of the runs from `start` to before `stop`."""

    start: int
    stop: int
    path: Path


class Store:
    """The results folder of one campaign, used by one process at a time.

    Attributes:
        folder: path of the folder.
        runs: number of runs of the campaign.
        schema: schema of the rows; its metadata describe what the numbers come from.
        damaged: a sentence for each file that is not complete, and whose runs are run again.
    """

    def __init__(self, folder: Path, columns: Mapping[str, Column], metadata: Mapping[str, str], runs: int) -> None:
        """Opens a folder, and changes nothing in it."""
        self.folder, self.runs = folder, runs
        fields = [pa.field(name, TYPES[one.kind], metadata=one.about or None) for name, one in columns.items()]
        self.schema = pa.schema(fields, metadata=dict(metadata))
        self.damaged: list[str] = []
        self._useless: list[Path] = []
        self._parts = [] if self.finished else list(self._complete_parts())

    @property
    def results(self) -> Path:
        """Returns the file with all runs, which exists when all are done."""
        return self.folder / RESULTS

    @property
    def finished(self) -> bool:
        """Returns True if all runs are done."""
        return self.results.exists()

    def tidy(self) -> None:
        """Removes files that are not complete, and files of batches that are in the results already."""
        for path in [*self._useless, *(self.folder.glob("part-*") if self.finished else ())]:
            with suppress(OSError):
                path.unlink()

    def missing(self) -> list[tuple[int, int]]:
        """Returns the runs without a row, as ascending (start, stop)."""
        if self.finished:
            return []
        gaps, at = [], 0
        for part in self._parts:
            if part.start > at:
                gaps.append((at, part.start))
            at = part.stop
        return [*gaps, (at, self.runs)] if at < self.runs else gaps

    def write(self, start: int, rows: Sequence[Mapping[str, Any]]) -> None:
        """Adds the rows of the runs from `start` on.

        Raises:
            InputError: the results cannot be written.
        """
        part = Part(start, start + len(rows), self.folder / f"part-{start:09d}-{start + len(rows):09d}.parquet")
        with whole_file(part.path, "results", FULL) as path, path.open("wb") as file:
            pq.write_table(pa.Table.from_pylist([dict(row) for row in rows], schema=self.schema), file)
        self._parts = sorted([*self._parts, part], key=lambda part: part.start)

    def finish(self) -> None:
        """Joins all parts into one file, in the order of their runs, and removes them.

        Raises:
            InputError: the file cannot be written.
        """
        if self.finished:
            return
        table = self.read(self.schema.names).combine_chunks()
        with whole_file(self.results, "results", FULL) as path, path.open("wb") as file:
            pq.write_table(table, file)
        for part in self._parts:
            part.path.unlink()
        self._parts = []

    def read(self, names: Sequence[str]) -> pa.Table:
        """Returns some columns of all rows so far."""
        paths = [self.results] if self.finished else [part.path for part in self._parts]
        return pa.concat_tables([_read(path, names) for path in paths] or [self.schema.empty_table().select(list(names))])

    def _complete_parts(self) -> Iterator[Part]:
        """Yields the parts that are complete, in the order of their runs."""
        at = 0
        for path in sorted(path for path in self.folder.glob("part-*") if PART.fullmatch(path.name)):
            start, stop = map(int, path.stem.split("-")[1:])
            if at <= start < stop <= self.runs and np.array_equal(_runs(path), np.arange(start, stop)):
                yield Part(start, stop, path)
                at = stop
            else:
                self.damaged.append(f"{path.name} is not complete, or not of this campaign: its runs are run again")
                self._useless.append(path)


def _read(path: Path, names: Sequence[str]) -> pa.Table:
    with path.open("rb") as file:  # Arrow takes a name with a colon for an address
        return pq.read_table(file, columns=list(names))


def _runs(path: Path) -> Array:
    """Returns the numbers of the runs in a file; none if it is not complete."""
    try:
        return _read(path, ["run"])["run"].to_numpy()
    except (pa.ArrowException, OSError, KeyError):
        return np.zeros(0)
