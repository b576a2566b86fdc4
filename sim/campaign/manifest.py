"""The plan of a campaign, stored in the results folder: a copy of the campaign file, the designed gains and the versions of
packages.
"""

import contextlib
import json
import secrets
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import filelock

from models.common.errors import InputError
from models.common.files import made_folder, reading, whole_file
from synth.controller.controller import AnyController

NAME, RESULTS, LOCK, PARTS = "plan.json", "results.parquet", ".lock", "parts"
PARTIAL_FILES = ".*.part*"  # pattern of incomplete files, which remain if a process is killed while it writes, see `whole_file`
EARLIER = "campaign.json"  # file name that Roadproof 0.1 used for the plan of a campaign
FULL = "free some space, or give another folder with --results; finished runs are kept"
ELSEWHERE = "give a new or empty folder with --results"


# Controllers by vehicle and controller name. Each entry has measurements and gain or, for a law in Python, the name of the law
# and the checksum of its file.
Gains = Mapping[str, Mapping[str, Mapping[str, Any]]]


@dataclass(frozen=True)
class Manifest:
    """Plan of a campaign, which does not change after the campaign has begun.

    Attributes:
        file: absolute path that the campaign file had when the campaign began.
        digest: checksum of all files on which the results depend, see `Campaign.digest`.
        versions: versions of the packages that affect the results, by name.
        campaign: text of the campaign file.
        controllers: gains of the designed controllers, by vehicle and controller.
        runs: number of runs in the campaign.
        earlier: True for a campaign that was begun with an earlier version of Roadproof, see `RoadInput.earlier`.
        part: part of the campaign that the folder contains, such as 3/40; empty if the folder is for the whole campaign.
    """

    file: str
    digest: str
    versions: Mapping[str, str]
    campaign: str
    controllers: Gains
    runs: int
    earlier: bool = False
    part: str = ""

    def write(self, folder: Path) -> "Manifest":
        """Writes the plan of the campaign to the results folder, and returns the plan.

        Raises:
            InputError: the file cannot be written.
        """
        with whole_file(folder / NAME, "results", FULL) as path:
            path.write_text(json.dumps(asdict(self), indent=1), encoding="utf-8", newline="\n")
        return self

    def publish(self, folder: Path) -> "Manifest":
        """Creates a folder with this plan, unless another process creates the folder first; returns the plan that the folder
        then contains.

        Raises:
            InputError: the folder cannot be created.
        """
        beside = folder.with_name(f".{folder.name}.{secrets.token_hex(4)}")
        with made_folder(beside, "results", FULL):
            self.write(beside)
        try:
            beside.rename(folder)  # renaming fails if the folder exists and contains files
        except OSError as error:
            shutil.rmtree(beside, ignore_errors=True)
            if not (folder / NAME).exists():
                raise InputError(f"results {folder}: cannot be written ({error.strerror or error}); {FULL}") from error
        return read_manifest(folder) or self

    def check(self, folder: Path, digest: str, versions: Mapping[str, str], instead: str = ELSEWHERE) -> None:
        """Checks that the plan in a folder belongs to the present campaign and to the installed versions of packages.

        Args:
            folder: results folder, whose path the error message contains.
            digest: checksum of the campaign, see `Campaign.digest`.
            versions: installed versions of packages, by name.
            instead: advice to the user at the end of the error message.

        Raises:
            InputError: the checksum of the campaign or the version of a package differs from that in the plan.
        """
        if self.digest != digest:
            raise InputError(
                f"{folder} contains the results of another campaign, or the files of this campaign have changed; {instead}"
            )
        for name, version in versions.items():
            if self.versions.get(name) != version:
                raise InputError(
                    f"the campaign in {folder} was started with {name} {self.versions.get(name)}, but {version} is "
                    f"installed now, so new results could differ from the earlier results; install "
                    f"{self.versions.get(name)}, or {instead}"
                )


def read_manifest(folder: Path, instead: str = ELSEWHERE) -> Manifest | None:
    """Returns the plan in a folder; None if the folder is empty.

    Args:
        folder: results folder.
        instead: advice to the user at the end of the error message, if the folder contains no readable campaign.

    Raises:
        InputError: the folder contains other files, an unfinished campaign of Roadproof 0.1, or a plan that cannot be read.
    """
    path = folder / NAME
    if not path.exists() and (folder / EARLIER).exists():
        path = folder / EARLIER
        if not (folder / RESULTS).exists():
            raise InputError(f"the campaign in {folder} was started by Roadproof 0.1; finish it with Roadproof 0.1, or {instead}")
    if not path.exists():
        if (folder / PARTS).exists():
            raise InputError(f"{folder} contains parts of a campaign; merge the parts with --merge, or {instead}")
        others = sorted(other.name for other in folder.iterdir() if other.name != LOCK and not other.match(PARTIAL_FILES))
        if others:
            raise InputError(f"{folder} contains no campaign, but other files such as {others[0]}; {instead}")
        return None
    with reading(path, "campaign plan", instead):
        whole = {"earlier": True, "part": "", **json.loads(path.read_text(encoding="utf-8"))}
        names = [field.name for field in fields(Manifest)]
        if not {*names} <= {*whole}:
            raise InputError(
                f"this record of the campaign lacks at least one of the entries {', '.join(names)}; restore the record file, "
                f"or {instead}"
            )
        return Manifest(**{name: whole[name] for name in names})


def gains_of(controllers: Mapping[str, Mapping[str, AnyController]]) -> dict[str, dict[str, dict[str, Any]]]:
    """Returns each controller's gain with all digits as a JSON object, by vehicle and controller; a law in Python has a
    checksum instead.
    """
    return {
        vehicle: {name: {key: value for key, value in one.record.items() if key != "name"} for name, one in some.items()}
        for vehicle, some in controllers.items()
    }


@contextlib.contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Creates a results folder, and locks this folder for other processes while the context is active.

    The operating system releases the lock when the process ends, even after a crash. The lock file is removed if no campaign
    has begun while the folder was locked.

    Raises:
        InputError: the folder cannot be created or written, or another campaign is running in it.
    """
    with made_folder(folder, "results", "give another folder with --results"):
        lock = filelock.FileLock(folder / LOCK, timeout=0)
        try:
            lock.acquire()
        except OSError as error:  # OSError includes filelock.Timeout, which means that another process holds the lock
            # A finished campaign is only read. Reading requires no lock, and some network file systems do not support locks.
            if isinstance(error, filelock.Timeout) or not (folder / RESULTS).exists():
                raise InputError(
                    f"another campaign is running in {folder}, or this folder cannot be locked "
                    f"({error.strerror or 'locked'}); wait until the other campaign ends, or give a different folder "
                    "with --results"
                ) from error
        try:
            for left in folder.glob(PARTIAL_FILES):
                left.unlink()
            yield
        finally:
            lock.release()
            with contextlib.suppress(OSError):
                if not (folder / NAME).exists():
                    (folder / LOCK).unlink()
