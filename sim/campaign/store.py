"""A campaign's results on disk: one Parquet file for each batch while it runs, and one for all runs when it is done.

The name of a batch's file has its first run and the run after its last. Files are complete or do not exist, so a campaign goes on
after any end: it runs what has no file. A file that is cut or empty is run again.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from models.common.errors import InputError, first_few
from models.common.files import reading, whole_file
from sim.campaign.manifest import ELSEWHERE, FULL, RESULTS
from sim.campaign.plan import Runs

PART = re.compile(r"part-(\d{9})-(\d{9})\.parquet")


class Store:
    """The results folder of one campaign, used by one process at a time, or of a part of a campaign, used by any number.

    Attributes:
        folder: folder of the results.
        schema: columns of the results.
        share: the runs whose rows the folder has in the end.
        parts: complete files of batches by their first run, with the run after their last.
        damaged: a sentence for each file that is not complete, and whose runs are run again.
    """

    def __init__(self, folder: Path, schema: pa.Schema, share: Runs) -> None:
        """Opens a folder, and changes nothing in it."""
        self.folder, self.schema, self.share = folder, schema, share
        self.parts: dict[int, tuple[int, Path]] = {}
        self.damaged: list[str] = []
        found, at = [] if self.finished else sorted(path for path in folder.glob("part-*") if PART.fullmatch(path.name)), 0
        for path in found:
            start, stop = map(int, path.stem.split("-")[1:])
            planned = any(first <= start and stop <= last for first, last in share)
            if at <= start < stop and planned and self._has(path, [(start, stop)]):
                self.parts[start], at = (stop, path), stop
            else:
                self.damaged.append(f"{path.name} is incomplete, or belongs to another campaign; its runs are simulated again")

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
        for path in {*self.folder.glob("part-*")} - {path for _, path in self.parts.values()}:
            with suppress(OSError):
                path.unlink()

    def missing(self) -> list[tuple[int, int]]:
        """Returns the runs without a row, as ascending (start, stop)."""
        if self.finished:
            return []
        gaps, done = list[tuple[int, int]](), sorted(self.parts)
        for first, last in self.share:
            within = [start for start in done if first <= start < last]
            starts, stops = [*within, last], [first, *(self.parts[start][0] for start in within)]
            gaps += [(stop, start) for stop, start in zip(stops, starts, strict=True) if stop < start]
        return gaps

    @property
    def runs(self) -> int:
        """Returns the number of all runs."""
        return sum(stop - start for start, stop in self.share)

    @property
    def left(self) -> int:
        """Returns how many runs have no row."""
        return sum(stop - start for start, stop in self.missing())

    def write(self, start: int, rows: Sequence[Mapping[str, Any]]) -> None:
        """Adds the rows of the runs from `start` on.

        Raises:
            InputError: the results cannot be written.
        """
        stop = start + len(rows)
        path = self.folder / f"part-{start:09d}-{stop:09d}.parquet"
        self._write(path, pa.Table.from_pylist([dict(row) for row in rows], schema=self.schema))
        self.parts[start] = stop, path

    def finish(self) -> None:
        """Joins all parts into one file, in the order of their runs, and removes them.

        Raises:
            InputError: the file cannot be written.
        """
        if self.finished:
            return
        try:
            table = self.read(self.schema.names)
        except InputError:
            if self.finished:  # by another process that ran this part, and has removed its files
                return
            raise
        self._write(self.results, table.combine_chunks())
        for _, path in self.parts.values():
            path.unlink(missing_ok=True)
        self.parts = {}

    def gather(self, stores: Iterable["Store"]) -> None:
        """Writes the rows of all parts of the campaign into one file, in the order of their runs.

        Raises:
            InputError: a part cannot be read, has other rows than its share, or the file cannot be written.
        """
        pieces: dict[int, pa.Table] = {}
        for store in stores:
            table, at = store.read(self.schema.names), 0
            if not _are_runs(table, store.share):
                raise InputError(
                    f"results {store.results}: these are not the rows of this part; remove it, and run the part again"
                )
            for start, stop in store.share:
                pieces[start] = table.slice(at, stop - start).replace_schema_metadata(self.schema.metadata)
                at += stop - start
        self._write(self.results, pa.concat_tables(pieces[start] for start in sorted(pieces)).combine_chunks())

    def read(self, names: Sequence[str]) -> pa.Table:
        """Returns some columns of all rows so far.

        Raises:
            InputError: a file is cut or empty, or another version wrote it, with other columns.
        """
        paths = [self.results] if self.finished else [self.parts[start][1] for start in sorted(self.parts)]
        return pa.concat_tables([_read(path, names) for path in paths] or [self.schema.empty_table().select(list(names))])

    def _has(self, path: Path, runs: Runs) -> bool:
        """Returns True if a file is complete, and has these runs and all columns."""
        try:
            return _are_runs(_read(path, ["run"], self.schema.names), runs)
        except InputError:
            return False

    def _write(self, path: Path, table: pa.Table) -> None:
        with whole_file(path, "results", FULL) as beside, beside.open("wb") as file:
            pq.write_table(table, file)


def _are_runs(table: pa.Table, runs: Runs) -> bool:
    """Returns True if the rows of a table are those of these runs, in order."""
    return np.array_equal(table["run"].to_numpy(), np.concatenate([np.zeros(0, int), *(np.arange(*some) for some in runs)]))


def _read(path: Path, names: Sequence[str], expected: Sequence[str] = ()) -> pa.Table:
    """Returns some columns of a file, which has them, and all `expected` ones."""
    # Arrow opens the file: its threads release what they read, and one that releases memory of Python while the interpreter ends
    # aborts the process. A path may have a colon, so it is not passed to ParquetFile, which would take it for an address.
    with reading(path, "results", "remove it, and run the campaign again"), pa.OSFile(str(path)) as stream:
        file = pq.ParquetFile(stream)
        other = {*expected, *names} - {*file.schema_arrow.names}
        if other:
            raise InputError(
                f"another version of Roadproof wrote these results, without columns {first_few(sorted(other))}; {ELSEWHERE}"
            )
        return file.read(list(names)).select(list(names))
