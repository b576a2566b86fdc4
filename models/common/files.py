"""Reading and writing of files, including TOML files.

A file is written under a temporary name and then renamed, so no program ever reads an incomplete file.

If the path of a file is a link, the target of the link is replaced. The new file has the same permissions as the file that it
replaces. A pipe, a device or standard output receives the content of the file when the content is complete.
"""

import hashlib
import os
import re
import secrets
import shutil
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from models.common.errors import InputError

UNQUOTED_QUANTITY = re.compile(
    r"[=\[,] *([+-]?[\d.]+(?:[eE][+-]?\d+)? *(?![eE][+-]?\d)[A-Za-z%][^,}\]#]*)"
)  # pattern of a number with a unit that is written without quotes


def parse_toml(text: str) -> dict[str, Any]:
    """Returns the tables of a TOML text.

    Raises:
        InputError: the text is not valid TOML.
    """
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        comma = re.search(r"^[\w.]+ *= *(-?\d+),(\d+) *(#.*)?$", text, re.MULTILINE)
        instead = f"; write {comma[1]}.{comma[2]} for {comma[1]},{comma[2]}" if comma else ""
        if spaced := re.search(r"^ *\[?([A-Za-z][\w.-]*(?: +[\w.-]+)+) *[]=]", text, re.MULTILINE):
            instead = f"; write {re.sub(' +', '_', spaced[1])} for {spaced[1]}"
        elif re.search("Cannot (overwrite|declare)", str(error)):
            instead = "; a key or a section appears twice, so omit one of the two"
        elif line := re.search(r"at line (\d+)", str(error)):
            unit = UNQUOTED_QUANTITY.search(text.splitlines()[int(line[1]) - 1])
            instead += f'; write a number with its unit in quotes, as in "{unit[1].strip()}"' if unit else ""
        raise InputError(f"this is not valid TOML: {error}{instead}") from error


def path_from(file: str | Path, folder: Path = Path()) -> Path:
    """Returns the path of a file whose name is relative to a folder. A leading `~` means the user's home folder."""
    return folder / os.path.expanduser(file)


# Output to this path is written to the open stream, because the shell has already opened the target of the stream
STDOUT = Path("/dev/stdout")
# Inside a block of `together`: files that are written completely but not yet renamed, each with its target path. Elsewhere:
# None.
_waiting_files: ContextVar[list[tuple[Path, Path]] | None] = ContextVar("_waiting", default=None)


@contextmanager
def whole_file(path: Path, what: str, instead: str = "give another path") -> Iterator[Path]:
    """Yields a temporary path with the suffix of `path`, and renames the file to `path` if the block ends without an error.

    Args:
        path: the file, a link to it, or `/dev/stdout`.
        what: purpose of the file, such as a report, for the error message.
        instead: advice that the error message gives if the file cannot be written.

    Raises:
        InputError: the file cannot be written.
    """
    target = _target(path, what, instead)
    stream = _is_stream(target)
    folder = Path(tempfile.gettempdir()) if stream else target.parent
    beside = folder / f".{target.stem[:100]}.{secrets.token_hex(4)}.part{path.suffix}"
    waiting = _waiting_files.get()
    try:
        with _system_errors(path, what, instead):
            yield beside
            if stream:
                sys.stdout.flush()
                content = beside.read_bytes()
                if target == STDOUT:
                    sys.stdout.buffer.write(content)
                    sys.stdout.buffer.flush()
                else:
                    target.write_bytes(content)
                return
            with beside.open("rb+") as file:
                os.fsync(file.fileno())
            if target.exists():
                shutil.copymode(target, beside)
            if waiting is None:
                beside.replace(target)
            else:
                waiting.append((beside, target))
    finally:
        if beside not in dict(waiting or ()):
            beside.unlink(missing_ok=True)


@contextmanager
def together() -> Iterator[None]:
    """At the end of the block, renames all files that `whole_file` wrote in the block; if the block fails, renames no file.

    Raises:
        InputError: the files cannot be renamed.
    """
    waiting: list[tuple[Path, Path]] = []
    token = _waiting_files.set(waiting)
    try:
        yield
        for beside, target in waiting:
            with _system_errors(target, "output", "fix the cause and run the command again"):
                beside.replace(target)
    finally:
        _waiting_files.reset(token)
        for beside, _ in waiting:
            beside.unlink(missing_ok=True)


def check_file(path: Path, what: str, instead: str = "give another path") -> None:
    """Checks before a long run that a file can be written.

    Raises:
        InputError: the file cannot be written.
    """
    target = _target(path, what, instead)
    if not _is_stream(target):
        _try_folder(target.parent, path, what, instead)


def check_folder(path: Path, what: str, instead: str = "give another folder") -> None:
    """Checks that a folder exists or can be created, and that files can be written in it. Leaves nothing behind.

    Raises:
        InputError: the folder cannot be created, or files cannot be written in it.
    """
    existing = next(folder for folder in (path.absolute(), *path.absolute().parents) if os.path.lexists(folder))
    if not existing.is_dir():
        which = "is" if existing == path.absolute() else f"{existing} is"
        raise InputError(f"{what} {path}: {which} not a folder; {instead}")
    _try_folder(existing, path, what, instead)


@contextmanager
def made_folder(path: Path, what: str, instead: str = "give another folder") -> Iterator[None]:
    """Creates a folder and its missing parents. If the block fails, the created folders that are still empty are removed.

    Raises:
        InputError: the folder cannot be created, or files cannot be written in it.
    """
    check_folder(path, what, instead)
    missing = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        with _system_errors(path, what, instead):
            path.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        with suppress(OSError):  # `rmdir` does not remove a folder that contains other files
            for folder in missing:
                folder.rmdir()
        raise


@contextmanager
def _system_errors(path: Path, what: str, instead: str) -> Iterator[None]:
    """Turns an error of the operating system into an InputError, except for the error that the reader of a pipe has ended."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise InputError(f"{what} {path}: cannot be written ({error.strerror or error}); {instead}") from error


def _target(path: Path, what: str, instead: str) -> Path:
    """Returns the target of a path after resolving links.

    Raises:
        InputError: the path is a folder or read-only, or its folder does not exist.
    """
    target = path if _is_stream(path) else Path(os.path.realpath(path))
    if target.is_dir():
        raise InputError(f"{what} {path}: this is a folder; give the name of a file")
    if not target.parent.is_dir():
        raise InputError(f"{what} {path}: there is no folder {target.parent}; create this folder, or {instead}")
    if target.exists() and not os.access(target, os.W_OK):
        raise InputError(f"{what} {path}: this file is read-only; make the file writable, or {instead}")
    return target


def _is_stream(path: Path) -> bool:
    """Returns True for standard output, a pipe or a device: a file that is written to, but not replaced."""
    return path == STDOUT or (path.exists() and not path.is_file() and not path.is_dir())


def _try_folder(folder: Path, path: Path, what: str, instead: str) -> None:
    """Checks a folder by writing and removing a file.

    A check of the permission bits is not sufficient, for example on read-only disks.
    """
    with _system_errors(path, what, instead), tempfile.TemporaryFile(dir=folder):
        pass


def identity(path: Path) -> tuple[int, int] | str:
    """Returns a value that is equal for all paths of the same file or folder. Different paths of the same file are links, hard
    links, or names that differ only in upper and lower case.
    """
    try:
        status = path.stat()
    except (OSError, ValueError):
        return os.path.realpath(path)
    return status.st_dev, status.st_ino


@contextmanager
def reading(path: Path, purpose: str, give: str = "give another file") -> Iterator[None]:
    """Turns any error that a library raises in the block into an InputError with path, purpose and the library's message.

    Args:
        path: the file that the block reads.
        purpose: purpose of the file, such as "road profile".
        give: advice for the error message on what the user can do instead.

    Raises:
        InputError: the library has raised an error in the block. If the block raises an InputError, the purpose and the path of
            the file are put in front of the message.
    """
    try:
        yield
    except InputError as error:
        raise InputError(f"{purpose} {path}: {error}") from error
    except FileNotFoundError as error:
        reason = "it is a link to a file that does not exist" if path.is_symlink() else "there is no such file"
        raise InputError(f"{purpose} {path}: {reason}; {give}") from error
    except IsADirectoryError as error:
        raise InputError(f"{purpose} {path}: this is a folder, not a file; {give}") from error
    except OSError as error:
        raise InputError(f"{purpose} {path}: the file cannot be read ({error.strerror or error}); {give}") from error
    except UnicodeDecodeError as error:
        reason = f"this is not a text file in UTF-8 ({error.reason} at byte {error.start})"
        raise InputError(f"{purpose} {path}: {reason}; save the file as UTF-8, or {give}") from error
    except Exception as error:
        raise InputError(f"{purpose} {path}: {str(error) or type(error).__name__}; {give}") from error


def read_bytes(path: Path, purpose: str, give: str = "give another file") -> bytes:
    """Returns the content of a file, of a link to a file, or of a pipe.

    Raises:
        InputError: the file does not exist, or cannot be read.
    """
    with reading(path, purpose, give):
        return path.read_bytes()


def read_text(path: Path, purpose: str, give: str = "give another file") -> str:
    """Returns the text of a UTF-8 file, with or without a byte order mark. Lines of the result end with a line feed.

    Raises:
        InputError: the file does not exist, cannot be read, or is not text in UTF-8.
    """
    content = read_bytes(path, purpose, give)
    with reading(path, purpose, give):
        text = content.decode("utf-8-sig")
        if "\0" in text:
            raise InputError(
                "this is not a text file in UTF-8, because it contains a NUL character (the file may be in UTF-16); "
                f"save the file as UTF-8, or {give}"
            )
    return text.replace("\r\n", "\n")


def origin(file: str, content: bytes) -> str:
    """Returns a comment about a file whose content is now in the vehicle file: the name, size and checksum of that file."""
    return f"# from {file!a}, {len(content)} bytes, SHA-256 {hashlib.sha256(content).hexdigest()}"
