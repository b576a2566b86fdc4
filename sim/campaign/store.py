"""A campaign's results on disk: parts while it runs, one Parquet file when it is done, and never a half-written one.

A part's name says which runs it holds and, in a checksum of campaign, runs and content, that it is what was written: what has a
name is whole, whatever ended the campaign, `kill -9` or a power cut. A part that is damaged, cut, copied or of another campaign
has a name that is not its own, and its runs are run again; so are those of one with other runs in it. The finished checksum
stands in the manifest.
"""

import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from models.common.errors import InputError
from models.common.files import read_bytes, whole_file
from sim.campaign.columns import Column
from sim.campaign.manifest import FULL, FaultError, Manifest

RESULTS = "results.parquet"
PART = re.compile(r"part-(\d{9})-(\d{9})-([0-9a-f]{32})\.parquet")
TYPES = {int: pa.int64(), float: pa.float64(), str: pa.string()}
GROUP = 32768  # rows in a group of the finished file, however they were batched
JOINED = 64  # parts that lie side by side become one: a folder of a hundred thousand files is slow


@dataclass(frozen=True)
class Part:
    """Some runs that are there, from `start` to before `stop`."""

    start: int
    stop: int
    path: Path


class Store:
    """The results folder of one campaign, held by one process at a time.

    Attributes:
        folder: where it lies.
        schema: of a row; its metadata say what the numbers come from.
        manifest: what the campaign is.
        damaged: what was found in the folder that is not what was written, and so is run again; in words.
    """

    def __init__(self, folder: Path, columns: Mapping[str, Column], metadata: Mapping[str, str], manifest: Manifest) -> None:
        """Opens a folder, checks every file in it, and changes none.

        Raises:
            FaultError: the finished file is not what was written.
        """
        self.folder, self.manifest = folder, manifest
        fields = [pa.field(name, TYPES[one.kind], metadata=one.about or None) for name, one in columns.items()]
        self.schema = pa.schema(fields, metadata=dict(metadata))
        self.damaged: list[str] = []
        self._parts: list[Part] = []
        self._useless: list[Path] = []
        if self.finished:
            self.check_results()
            self._useless += folder.glob("part-*")  # the last start was ended between the finished file and their removal
        else:
            self._find_parts()

    def tidy(self) -> None:
        """Removes what is of no use any more; only who holds the folder may."""
        for path in self._useless:
            with suppress(OSError):
                path.unlink()
        self._useless = []

    @property
    def results(self) -> Path:
        """The one file that is there when all is done."""
        return self.folder / RESULTS

    @property
    def finished(self) -> bool:
        """Returns True if all runs are done."""
        return bool(self.manifest.results)

    def check_results(self) -> None:
        """Holds the finished file against its checksum.

        Raises:
            FaultError: it is not what was written.
        """
        try:
            with self.results.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
        except (InputError, OSError):
            digest = "nothing"
        if digest != self.manifest.results:
            raise FaultError(
                f"results {self.results}: is not the file that the campaign wrote (damaged, edited or gone); restore it, or "
                f"remove {self.folder} to run the campaign again"
            )

    def missing(self) -> list[tuple[int, int]]:
        """The runs that are not there yet, as ascending (start, stop)."""
        if self.finished:
            return []
        gaps, at = [], 0
        for part in self._parts:
            if part.start > at:
                gaps.append((at, part.start))
            at = part.stop
        return [*gaps, (at, self.manifest.runs)] if at < self.manifest.runs else gaps

    def write(self, start: int, rows: Sequence[Mapping[str, Any]]) -> None:
        """Adds the rows of runs from `start` on.

        Raises:
            InputError: they cannot be written.
        """
        self._add(pa.Table.from_pylist([dict(row) for row in rows], schema=self.schema), start, start + len(rows))
        side_by_side = self._side_by_side()
        if len(side_by_side) >= JOINED:
            table = pa.concat_tables([self._read(part) for part in side_by_side])
            self._add(table, side_by_side[0].start, side_by_side[-1].stop)
            for part in side_by_side:
                self._parts.remove(part)
                part.path.unlink()

    def finish(self) -> None:
        """Joins all parts, in the order of their runs, and removes them. The file's bytes do not depend on how runs were batched.

        Raises:
            InputError: the file cannot be written.
        """
        if self.finished:
            return
        with whole_file(self.results, "results", FULL) as path:
            with pa.OSFile(str(path), "wb") as file, pq.ParquetWriter(file, self.schema, write_page_checksum=True) as writer:
                for group in self._groups():
                    writer.write_table(group)
            with path.open("rb") as file:
                checksum = hashlib.file_digest(file, "sha256").hexdigest()
        self.manifest = replace(self.manifest, results=checksum)
        self.manifest.write(self.folder)
        for part in self._parts:
            part.path.unlink()
        self._parts = []

    def read(self, names: Sequence[str]) -> pa.Table:
        """Some columns of what is there so far."""
        if self.finished:
            with pa.OSFile(str(self.results)) as file:  # a name with a colon would be taken for an address elsewhere
                return pq.read_table(file, columns=list(names))
        tables = [self._read(part).select(list(names)) for part in self._parts]
        return pa.concat_tables(tables) if tables else self.schema.empty_table().select(list(names))

    def written_schema(self) -> pa.Schema:
        """Columns of the finished file, and what it says of itself."""
        with pa.OSFile(str(self.results)) as file:
            return pq.read_schema(file)

    def _add(self, table: pa.Table, start: int, stop: int) -> None:
        buffer = pa.BufferOutputStream()
        pq.write_table(table.combine_chunks(), buffer)
        content = buffer.getvalue()
        path = self.folder / f"part-{start:09d}-{stop:09d}-{self._checksum(start, stop, content)}.parquet"
        with whole_file(path, "results", FULL) as beside:
            beside.write_bytes(content)
        self._parts = sorted([*self._parts, Part(start, stop, path)], key=lambda part: part.start)

    def _side_by_side(self) -> list[Part]:
        """The longest row of small parts without a gap."""
        best: list[Part] = []
        some: list[Part] = []
        for part in self._parts:
            small = part.stop - part.start < GROUP
            some = [*some, part] if small and some and some[-1].stop == part.start else [part] if small else []
            best = some if len(some) > len(best) else best
        return best

    def _find_parts(self) -> None:
        """The parts that are what was written; of others it is said that their runs are run again."""
        parts = []
        for path in sorted(self.folder.glob("part-*")):
            match = PART.fullmatch(path.name)
            start, stop = (int(match[1]), int(match[2])) if match else (0, 0)
            part = Part(start, stop, path)
            if match and self._table(part, ["run"]) is not None:
                parts.append(part)
            else:
                self.damaged.append(f"{path.name} is damaged, or not of this campaign: its runs are run again")
                self._useless.append(path)
        # Parts that were joined may still be there beside what they became: the longer one counts.
        for part in sorted(parts, key=lambda part: (part.start, -part.stop)):
            if self._parts and part.start < self._parts[-1].stop:
                self._useless.append(part.path)
            else:
                self._parts.append(part)

    def _checksum(self, start: int, stop: int, content: Any) -> str:
        checksum = hashlib.sha256(f"{self.manifest.seal} {start} {stop} ".encode())
        checksum.update(content)
        return checksum.hexdigest()[:32]

    def _read(self, part: Part) -> pa.Table:
        """The rows of a part."""
        table = self._table(part, self.schema.names)
        if table is None:
            raise InputError(f"results {part.path}: was damaged while the campaign ran; start it again, and it goes on")
        return table

    def _table(self, part: Part, names: Sequence[str]) -> pa.Table | None:
        """Returns columns of a part, with the number of the run, or None if its content differs from the checksum in its name."""
        try:
            content = read_bytes(part.path, "results", "")
        except InputError:
            return None
        if self._checksum(part.start, part.stop, content) != part.path.stem.rpartition("-")[2]:
            return None
        try:
            schema = pa.schema([self.schema.field(name) for name in names], metadata=self.schema.metadata)
            table = pq.read_table(pa.BufferReader(content), schema=schema, columns=list(names))
        except (pa.ArrowException, OSError):
            return None
        return table if np.array_equal(table["run"].to_numpy(), np.arange(part.start, part.stop)) else None

    def _groups(self) -> Iterator[pa.Table]:
        """All rows in groups of one size, as how they are cut shows in a file's bytes."""
        pending = self.schema.empty_table()
        for part in self._parts:
            pending = pa.concat_tables([pending, self._read(part)])
            while len(pending) >= GROUP:
                yield pending.slice(0, GROUP).combine_chunks()
                pending = pending.slice(GROUP)
        if len(pending):
            yield pending.combine_chunks()
