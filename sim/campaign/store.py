"""Results of a campaign on disk: one Parquet file per batch while the campaign runs, and one file with all runs at the end.

The file name of a batch contains the number of the first run, and the number of the last run plus 1. A file appears in the
results folder only when it is complete. After any interruption, a campaign can therefore continue, and simulates only the runs
that no file contains. If a file is damaged, its runs are simulated again.
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
    """Results folder of a campaign, or of one part of a campaign.

    Only one process at a time may use the folder of a campaign. Several processes may use the folder of a part.

    Attributes:
        folder: path of the results folder.
        schema: columns of the results, with type, unit and definition.
        share: run numbers that the finished results must contain, as ascending intervals (start, stop).
        parts: complete files of batches, by the number of the first run; each entry contains the last run's number plus 1, and
            the path.
        damaged: one sentence for each file that is incomplete or belongs to a different campaign, and whose runs are simulated
            again.
    """

    def __init__(self, folder: Path, schema: pa.Schema, share: Runs) -> None:
        """Reads which runs a results folder contains, without changing the folder."""
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
        """Path of the file with the results of all runs, which exists only when all runs are finished."""
        return self.folder / RESULTS

    @property
    def finished(self) -> bool:
        """True if all runs are finished."""
        return self.results.exists()

    def tidy(self) -> None:
        """Removes incomplete files, and files of batches whose rows the finished results already contain."""
        for path in {*self.folder.glob("part-*")} - {path for _, path in self.parts.values()}:
            with suppress(OSError):
                path.unlink()

    def missing(self) -> list[tuple[int, int]]:
        """Returns the numbers of the runs that have no row in the results yet, as ascending intervals (start, stop)."""
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
        """Number of runs in the finished results."""
        return sum(stop - start for start, stop in self.share)

    @property
    def left(self) -> int:
        """Number of runs that have no row in the results yet."""
        return sum(stop - start for start, stop in self.missing())

    def write(self, start: int, rows: Sequence[Mapping[str, Any]]) -> None:
        """Adds the rows of consecutive runs, beginning with number `start`.

        Raises:
            InputError: the results cannot be written.
        """
        stop = start + len(rows)
        path = self.folder / f"part-{start:09d}-{stop:09d}.parquet"
        self._write(path, pa.Table.from_pylist([dict(row) for row in rows], schema=self.schema))
        self.parts[start] = stop, path

    def finish(self) -> None:
        """Joins the files of all batches into one file, in the order of the runs, and removes the files of the batches.

        Raises:
            InputError: the file cannot be written.
        """
        if self.finished:
            return
        try:
            table = self.read(self.schema.names)
        except InputError:
            if self.finished:  # another process has meanwhile finished this part and removed the files of its batches
                return
            raise
        self._write(self.results, table.combine_chunks())
        for _, path in self.parts.values():
            path.unlink(missing_ok=True)
        self.parts = {}

    def gather(self, stores: Iterable["Store"]) -> None:
        """Writes the rows of all parts of the campaign to one file, in the order of the runs.

        Raises:
            InputError: a part cannot be read or contains the wrong runs, or the file cannot be written.
        """
        pieces: dict[int, pa.Table] = {}
        for store in stores:
            table, at = store.read(self.schema.names), 0
            if not _are_runs(table, store.share):
                raise InputError(
                    f"results {store.results}: this file does not contain the results of this part of the campaign; "
                    "remove the file, and run the part again"
                )
            for start, stop in store.share:
                pieces[start] = table.slice(at, stop - start).replace_schema_metadata(self.schema.metadata)
                at += stop - start
        self._write(self.results, pa.concat_tables(pieces[start] for start in sorted(pieces)).combine_chunks())

    def read(self, names: Sequence[str]) -> pa.Table:
        """Returns the columns with the requested names, for all rows of the results that exist so far.

        Raises:
            InputError: a file is damaged, or was written by a different version of Roadproof with different columns.
        """
        paths = [self.results] if self.finished else [self.parts[start][1] for start in sorted(self.parts)]
        return pa.concat_tables([_read(path, names) for path in paths] or [self.schema.empty_table().select(list(names))])

    def _has(self, path: Path, runs: Runs) -> bool:
        """Returns True if a file is complete, and contains exactly the expected runs and all columns."""
        try:
            return _are_runs(_read(path, ["run"], self.schema.names), runs)
        except InputError:
            return False

    def _write(self, path: Path, table: pa.Table) -> None:
        with whole_file(path, "results", FULL) as beside, beside.open("wb") as file:
            pq.write_table(table, file)


def _are_runs(table: pa.Table, runs: Runs) -> bool:
    """Returns True if the rows of a table belong to the runs `runs`, in the same order."""
    return np.array_equal(table["run"].to_numpy(), np.concatenate([np.zeros(0, int), *(np.arange(*some) for some in runs)]))


def _read(path: Path, names: Sequence[str], expected: Sequence[str] = ()) -> pa.Table:
    """Returns the columns `names` of a file, and checks that the file also contains the columns `expected`."""
    # Arrow opens the file instead of Python: otherwise, an Arrow thread that releases Python's memory while the interpreter
    # ends would abort the process. ParquetFile is not given the path itself, because it would read a path with a colon as an
    # address.
    with reading(path, "results", "remove it, and run the campaign again"), pa.OSFile(str(path)) as stream:
        file = pq.ParquetFile(stream)
        other = {*expected, *names} - {*file.schema_arrow.names}
        if other:
            raise InputError(
                f"these results lack the column(s) {first_few(sorted(other))}, because a different version of Roadproof wrote "
                f"the results; {ELSEWHERE}"
            )
        return file.read(list(names)).select(list(names))
