"""A campaign's results on disk: parts while it runs, one Parquet file when it is done, and never a half-written one.

A part is written beside its name, flushed to the disk, then renamed. So whatever ends a campaign, `kill -9` or a power cut, what
has a name is whole: the names say which runs are there, and the next start does the others.
"""

import contextlib
import fcntl
import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from models.errors import InputError
from models.whole_file import whole_file
from synth.controller import Controller

MANIFEST, RESULTS = "campaign.json", "results.parquet"
PART = re.compile(r"part-(\d{9})-(\d{9})\.parquet")
TYPES = {int: pa.int64(), float: pa.float64(), str: pa.string()}
FULL = "free some space or name another folder with --results; what is done is kept"


class Store:
    """The results folder of one campaign, held by one process at a time.

    Attributes:
        folder: where it lies.
        schema: of a row; its metadata say what the numbers come from.
        count: runs of the whole campaign.
    """

    def __init__(self, folder: Path, columns: Mapping[str, type], metadata: Mapping[str, str], count: int) -> None:
        self.folder, self.count = folder, count
        fields = [pa.field(name, TYPES[kind]) for name, kind in columns.items()]
        self.schema = pa.schema(fields, metadata=dict(metadata))

    @property
    def results(self) -> Path:
        """The one file that is there when all is done."""
        return self.folder / RESULTS

    def missing(self) -> list[tuple[int, int]]:
        """The runs that are not there yet, as ascending (start, stop)."""
        if self.results.exists():
            return []
        gaps, at = [], 0
        for start, stop, _ in self._parts():
            if start > at:
                gaps.append((at, start))
            at = max(at, stop)
        return [*gaps, (at, self.count)] if at < self.count else gaps

    def write(self, start: int, rows: Sequence[Mapping[str, Any]]) -> None:
        """Adds the rows of runs from `start` on.

        Raises:
            InputError: they cannot be written.
        """
        table = pa.Table.from_pylist([dict(row) for row in rows], schema=self.schema)
        with whole_file(self.folder / f"part-{start:09d}-{start + len(rows):09d}.parquet", "results", FULL) as path:
            pq.write_table(table, path)

    def finish(self) -> None:
        """Joins all parts, in the order of their runs, and removes them.

        Raises:
            InputError: the file cannot be written.
        """
        if not self.results.exists():
            with whole_file(self.results, "results", FULL) as path, pq.ParquetWriter(path, self.schema) as writer:
                for _, _, part in self._parts():
                    writer.write_table(pq.read_table(part, schema=self.schema))
        for _, _, part in self._parts():
            part.unlink()

    def read(self, names: Sequence[str]) -> pa.Table:
        """Some columns of what is there so far."""
        files = [self.results] if self.results.exists() else [part for _, _, part in self._parts()]
        tables = [pq.read_table(file, columns=list(names)) for file in files]
        return pa.concat_tables(tables) if tables else self.schema.empty_table().select(list(names))

    def _parts(self) -> list[tuple[int, int, Path]]:
        found = []
        for path in sorted(self.folder.glob("part-*.parquet")):
            match = PART.fullmatch(path.name)
            if match:
                found.append((int(match[1]), int(match[2]), path))
        return found


def controllers_text(controllers: Mapping[str, Mapping[str, Controller]]) -> dict[str, dict[str, Any]]:
    """The gains, by vehicle and controller, as JSON has them, every digit of them."""
    return {
        vehicle: {name: {"measured": list(one.measured), "gain": one.gain.tolist()} for name, one in some.items()}
        for vehicle, some in controllers.items()
    }


@contextlib.contextmanager
def held(folder: Path) -> Iterator[None]:
    """Makes the folder and holds it; the system lets go of it however the process ends.

    Raises:
        InputError: it cannot be made or written, or another campaign is running in it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = open(folder / ".lock", "w")  # noqa: SIM115 - held as long as the campaign
    except OSError as error:
        raise InputError(f"cannot write results in {folder}: {error.strerror}; name another folder with --results") from error
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InputError(
                f"another campaign is running in {folder}; wait for it, or name another folder with --results"
            ) from error
        for left in folder.glob(".*.part*"):
            left.unlink()
        yield


def begun(folder: Path, sources: str, versions: Mapping[str, str]) -> dict[str, Any] | None:
    """What was written down when the campaign in a folder began; None in an empty one.

    Raises:
        InputError: the folder holds another campaign, one by other versions, or something else altogether.
    """
    path = folder / MANIFEST
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        others = sorted(other.name for other in folder.iterdir() if other.name != ".lock")
        if others:
            raise InputError(
                f"{folder} holds no campaign, but {others[0]}; name an empty or a new folder with --results"
            ) from None
        return None
    except (OSError, ValueError) as error:
        raise InputError(f"{path} cannot be read ({error}); name another folder with --results") from error
    if manifest.get("digest") != digest(sources):
        raise InputError(
            f"{folder} holds another campaign, of other files than these; name another folder with --results, or remove it"
        )
    changed = [name for name, version in versions.items() if manifest["versions"].get(name) != version]
    if changed:
        name = changed[0]
        raise InputError(
            f"the campaign in {folder} was begun with {name} {manifest['versions'].get(name)}, and here is {versions[name]}: its "
            "numbers could differ; go on with that, or name another folder with --results"
        )
    return manifest


def begin(folder: Path, sources: str, versions: Mapping[str, str], text: str, controllers: Mapping[str, Any]) -> dict[str, Any]:
    """Writes down what campaign a folder holds."""
    manifest = {"digest": digest(sources), "versions": dict(versions), "campaign": text, "controllers": controllers}
    with whole_file(folder / MANIFEST, "results", FULL) as path:
        path.write_text(json.dumps(manifest, indent=1), encoding="utf-8")
    return manifest


def digest(sources: str) -> str:
    """What tells one campaign from another."""
    return hashlib.sha256(sources.encode()).hexdigest()
