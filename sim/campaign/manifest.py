"""Manifest of a results folder: sources of the campaign, the gains that are driven, and the results; under a seal.

The seal is a checksum: it shows damage or edits by hand, not the author. `sim.campaign --verify` is there for that.
"""

import contextlib
import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import filelock

from models.common.errors import InputError, first_few, quoted
from models.common.files import made_folder, read_text, whole_file
from models.laws.linear import MATRICES, PREVIEW_MATRICES
from synth.controller.controller import Driver

NAME, LOCK = "campaign.json", ".lock"
FULL = "free some space or name another folder with --results; what is done is kept"
ELSEWHERE = "name another folder, empty or new, with --results, or remove what is there"


class FaultError(InputError):
    """Folder contents that differ from those that a campaign wrote: damaged, or edited."""


# Of every vehicle's controllers: what they measure, and the gain, or which law in Python, and the checksum of its file.
Gains = Mapping[str, Mapping[str, Mapping[str, Any]]]


@dataclass(frozen=True)
class Manifest:
    """Data of a campaign at its beginning and, with its results, at its end.

    Attributes:
        file: absolute path of the campaign file when the campaign began.
        digest: of everything that decides the numbers; see `digest`.
        versions: of the packages that do.
        campaign: the campaign file's text.
        controllers: the gains.
        columns: description of each column of the results, by name; see `sim.campaign.columns.described`.
        runs: number of runs.
        results: checksum of the finished file (SHA-256); empty before.
    """

    file: str
    digest: str
    versions: Mapping[str, str]
    campaign: str
    controllers: Gains
    columns: Mapping[str, Mapping[str, str]]
    runs: int
    results: str = ""

    @property
    def seal(self) -> str:
        """Checksum of all that does not change from the beginning to the end."""
        content = asdict(replace(self, results=""))
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

    def write(self, folder: Path) -> None:
        """Writes it down, whole or not at all.

        Raises:
            InputError: it cannot be written.
        """
        whole = asdict(self)
        whole["seal"] = _sealed(whole)
        with whole_file(folder / NAME, "results", FULL) as path:
            path.write_text(json.dumps(whole, indent=1), encoding="utf-8", newline="\n")


def read_manifest(folder: Path, instead: str = ELSEWHERE) -> Manifest | None:
    """Returns the manifest of a folder, or None if the folder is empty.

    Args:
        instead: advice of the message, if the folder has no readable campaign.

    Raises:
        InputError: it holds something else, a campaign of another format, or a damaged or edited manifest.
    """
    path = folder / NAME
    if not path.is_symlink() and not path.exists():
        others = sorted(other.name for other in folder.iterdir() if other.name != LOCK)
        if others:
            raise InputError(f"{folder} holds no campaign, but {others[0]}; {instead}")
        return None
    text = read_text(path, "results", instead)
    try:
        whole = json.loads(text)
    except (ValueError, RecursionError):
        whole = None
    if isinstance(whole, dict) and "seal" not in whole:
        raise InputError(
            f"results {path}: has no seal; it is of an older Roadproof, or was edited; go on with that version, or {instead}"
        )
    if not isinstance(whole, dict) or whole.pop("seal") != _sealed(whole):
        raise FaultError(f"results {path}: was changed since the campaign began, or is damaged; restore it, or {instead}")
    entries = {field.name for field in fields(Manifest)}
    if set(whole) != entries:
        differences = ", ".join([f"no {name}" for name in sorted(entries - set(whole))] + sorted(set(whole) - entries))
        raise InputError(
            f"results {path}: is of another version of Roadproof ({differences}); go on with that version, or {instead}"
        )
    for name, value in whole.items():
        if not _is_its_kind(name, value):
            raise FaultError(f"results {path}: {name} = {quoted(value)} is not what a campaign writes; restore it, or {instead}")
    return Manifest(**whole)


def _is_its_kind(name: str, value: Any) -> bool:
    """Returns True if a manifest's entry and its parts have the required types."""

    def by_text(value: Any, of: Callable[[Any], bool]) -> bool:
        return isinstance(value, dict) and all(of(each) for each in value.values())

    def text(value: Any) -> bool:
        return isinstance(value, str)

    def texts(value: Any) -> bool:
        return isinstance(value, list) and all(text(each) for each in value)

    def row(value: Any) -> bool:
        return isinstance(value, list) and all(type(each) in (int, float) for each in value)

    def matrix(value: Any) -> bool:
        return isinstance(value, list) and all(row(each) for each in value)

    def code(value: Any) -> bool:
        if not isinstance(value, dict) or set(value) != {"numbers", "name", "ranges", "manifest_sha256"}:
            return False
        ranges = value["ranges"] is None or by_text(value["ranges"], lambda most: type(most) is float)
        return ranges and all(text(value[key]) for key in ("numbers", "name", "manifest_sha256"))

    def law(value: Any) -> bool:
        numbers = ("sample_period", "anti_windup")
        if not isinstance(value, dict) or not texts(value.get("measured")) or not row([value.get(key, 0) for key in numbers]):
            return False
        if "code" in value:
            return code(value["code"]) and law({key: each for key, each in value.items() if key != "code"})
        if key := next((key for key in ("law", "fmu") if key in value), None):
            return set(value) - {"preview"} == {"measured", key, "sha256"} and text(value[key]) and text(value["sha256"])
        if "semi_active" in value:
            numbers = [value[key] for key in set(value) - {"measured", "semi_active"}]
            return text(value["semi_active"]) and row(numbers)
        if isinstance(ahead := value.get("preview"), dict):  # beside a gain
            seconds, *parts = (ahead.get(name) for name in ("seconds", *PREVIEW_MATRICES))
            known = set(ahead) == {"seconds", *PREVIEW_MATRICES} and type(seconds) is float and all(map(matrix, parts))
            return known and law({key: each for key, each in value.items() if key != "preview"})
        matrices = set(value) - {"measured", *numbers}
        return matrices in ({"gain"}, set(MATRICES)) and all(matrix(value[each]) for each in matrices)

    if name == "runs":
        return type(value) is int
    if name == "versions":
        return by_text(value, text)
    if name == "columns":
        return by_text(value, lambda column: by_text(column, text))
    if name == "controllers":
        return by_text(value, lambda some: by_text(some, law))
    return text(value)


def check_same(
    manifest: Manifest,
    folder: Path,
    sources: str,
    versions: Mapping[str, str],
    columns: Mapping[str, Mapping[str, str]],
    instead: str = ELSEWHERE,
) -> None:
    """Checks that a campaign can continue in a folder; `instead` is the advice of the message.

    Raises:
        InputError: the folder holds another campaign, one by other versions, or one whose results have other columns.
    """
    if manifest.digest != digest(sources):
        raise InputError(f"{folder} holds another campaign, of other files than these; {instead}")
    for name, version in versions.items():
        if manifest.versions.get(name) != version:
            raise InputError(
                f"the campaign in {folder} was begun with {name} {manifest.versions.get(name)}, and here is {version}: its "
                "numbers could differ; go on with that, or {instead}"
            )
    other = [name for name in dict.fromkeys([*manifest.columns, *columns]) if manifest.columns.get(name) != columns.get(name)]
    if other:
        raise InputError(
            f"the campaign in {folder} was begun by another version of Roadproof, with other columns ({first_few(other)}); go on "
            f"with that version, or {instead}"
        )


def digest(sources: str) -> str:
    """Returns the checksum that identifies a campaign."""
    return hashlib.sha256(sources.encode()).hexdigest()


def gains_of(
    controllers: Mapping[str, Mapping[str, Driver]],
) -> dict[str, dict[str, dict[str, Any]]]:
    """The gains, by vehicle and controller, as JSON has them, every digit; of a law in Python its checksum, and no code."""

    return {
        vehicle: {name: {key: value for key, value in one.record.items() if key != "name"} for name, one in some.items()}
        for vehicle, some in controllers.items()
    }


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Makes the folder and holds it; the system lets go of it however the process ends. Where no campaign began nothing is left.

    Raises:
        InputError: it cannot be made or written, or another campaign is running in it.
    """
    with made_folder(folder, "results", "name another folder with --results"):
        lock = filelock.FileLock(folder / LOCK, timeout=0)
        try:
            lock.acquire()
        except filelock.Timeout:
            raise InputError(
                f"another campaign is running in {folder}; wait for it, or name another folder with --results"
            ) from None
        except OSError as error:
            raise InputError(
                f"results {folder}: cannot be locked ({error.strerror or error}); name another folder with --results"
            ) from error
        try:
            for left in folder.glob(".*.part*"):
                left.unlink()
            yield
        finally:
            lock.release()
            with contextlib.suppress(OSError):
                if not (folder / NAME).exists():
                    (folder / LOCK).unlink()


def _sealed(whole: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()
