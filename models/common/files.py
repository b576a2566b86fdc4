"""Reading and writing of files, and of TOML. Files appear whole or not at all; only plain files of limited size are read.

A file is written under a hidden name in the same folder, flushed to the disk, and renamed. A link stays a link: its target is
replaced. Of several hard links only the one that is written gets the new content: written in place, a full disk would destroy
all. The new file keeps the permissions of the old one, and its owner and group if the system allows it.
"""

import errno
import hashlib
import os
import re
import secrets
import shutil
import stat
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from io import BufferedReader
from pathlib import Path
from typing import Any, TypeVar

from models.common import interrupt
from models.common.errors import InputError


def parse_toml(text: str) -> dict[str, Any]:
    """Returns the tables of a TOML text.

    Raises:
        InputError: it is not TOML.
    """
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        comma = re.search(r"^[\w.]+ *= *(-?\d+),(\d+) *(#.*)?$", text, re.MULTILINE)
        instead = f"; write {comma[1]}.{comma[2]} for {comma[1]},{comma[2]}" if comma else ""
        raise InputError(f"not TOML: {error}{instead}") from error


STDOUT = Path("/dev/stdout")  # the only output path that need not be a plain file
Waiting = tuple[Path, Path, os.stat_result | None]  # temporary path, target, and status of the file that it replaces
# Whole files in a block of `together` that are not yet renamed; None outside it.
_waiting: ContextVar[list[Waiting] | None] = ContextVar("_waiting", default=None)
WRITABLE = stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH


@contextmanager
def whole_file(path: Path, what: str, instead: str = "give another") -> Iterator[Path]:
    """Yields a temporary path with the suffix of `path`, and renames it to `path` when the block ends without an error.

    Args:
        path: the file, a link to it, or `/dev/stdout`.
        instead: advice if it cannot be written, for the message.

    Raises:
        InputError: it cannot be written.
    """
    target, before = _target(path, what, instead)
    folder = Path(tempfile.gettempdir()) if target == STDOUT else target.parent
    beside = folder / f".{target.stem[:100]}.{secrets.token_hex(4)}.part{path.suffix}"
    try:
        yield beside
        if target == STDOUT:
            sys.stdout.flush()
            with beside.open("rb") as written:
                shutil.copyfileobj(written, sys.stdout.buffer)
            sys.stdout.buffer.flush()
            return
        with beside.open("rb+") as file:
            os.fsync(file.fileno())
        waiting = _waiting.get()
        if waiting is not None:
            waiting.append((beside, target, before))
            return
        with interrupt.uninterrupted():
            _name(beside, target, before)
    except BrokenPipeError:
        raise  # the reader of /dev/stdout has gone
    except OSError as error:
        raise _refused(path, what, f"cannot be written ({error.strerror or error})", instead) from error
    finally:
        if not any(beside == other for other, *_ in _waiting.get() or ()):
            _removed(beside)


@contextmanager
def together() -> Iterator[None]:
    """Renames all files that `whole_file` writes in this block at its end, or none of them.

    Raises:
        InputError: they cannot be renamed.
    """
    waiting: list[Waiting] = []
    token = _waiting.set(waiting)
    try:
        yield
        with interrupt.uninterrupted():
            _name_all(waiting)
    except OSError as error:
        raise InputError(f"the output files cannot be renamed ({error.strerror or error}); mend that and try again") from error
    finally:
        _waiting.reset(token)
        for beside, *_ in waiting:
            _removed(beside)


def _name_all(waiting: Sequence[Waiting]) -> None:
    """Renames whole files to their targets. If one fails, restores the files that the others replaced."""
    named: list[tuple[Path, Path | None]] = []
    try:
        for beside, target, before in waiting:
            kept = _kept(target) if before is not None else None
            named.append((target, kept))
            _name(beside, target, before)
    except OSError:
        for (target, kept), (beside, *_) in reversed(list(zip(named, waiting, strict=False))):
            with suppress(OSError):  # restores as many as possible
                if kept is not None:
                    kept.replace(target)
                elif not beside.exists():  # it was renamed
                    target.unlink()
        raise
    finally:
        for _, kept in named:
            if kept is not None:
                _removed(kept)


def _kept(target: Path) -> Path:
    """Returns a second, hidden name of a file; a copy if the system has no hard links."""
    kept = target.with_name(f".{secrets.token_hex(8)}.part")
    try:
        kept.hardlink_to(target)
    except OSError:
        shutil.copy2(target, kept)
    return kept


def _name(beside: Path, target: Path, before: os.stat_result | None) -> None:
    """Renames a whole file to its target, with the permissions of the file that it replaces."""
    if before is not None:
        _make_like(beside, before)
    beside.replace(target)
    _settle(target.parent)


def _removed(beside: Path) -> None:
    with interrupt.uninterrupted(), suppress(OSError):
        beside.unlink(missing_ok=True)


def check_file(path: Path, what: str, instead: str = "give another") -> None:
    """Checks that a file can be written, before a long run.

    Raises:
        InputError: it cannot be written.
    """
    target, _ = _target(path, what, instead)
    probe = target.with_name(f".{secrets.token_hex(8)}.part")
    if target == STDOUT:
        return
    try:  # permission bits do not decide (root, read-only mounts, quotas)
        probe.write_bytes(b"roadproof")
    except OSError as error:
        raise _refused(path, what, f"cannot be written ({error.strerror or error})", instead) from error
    finally:
        with suppress(OSError):
            probe.unlink(missing_ok=True)


def check_folder(path: Path, what: str, instead: str = "give another folder") -> None:
    """Checks that a folder exists or can be made, and that files can be written in it. Leaves nothing behind.

    Raises:
        InputError: it cannot be made, or files cannot be written in it.
    """
    try:
        for there in (path, *path.parents):
            with suppress(FileNotFoundError):
                is_folder = stat.S_ISDIR(there.stat().st_mode)
                break
            if there.is_symlink():
                raise _refused(path, what, f"{there} is a link to nothing" if there != path else "is a link to nothing", instead)
        else:
            raise _refused(path, what, "cannot be made", instead)
        if not is_folder:
            raise _refused(path, what, "is not a folder" if there == path else f"{there} is not a folder", instead)
        if there == path:
            check_file(path / ".probe", what, instead)
        else:
            probe = there / f".{secrets.token_hex(8)}.part"
            probe.mkdir()
            probe.rmdir()
    except NotADirectoryError as error:
        raise _refused(path, what, "is not a folder", instead) from error
    except OSError as error:
        raise _refused(path, what, f"cannot be made ({error.strerror or error})", instead) from error


@contextmanager
def made_folder(path: Path, what: str, instead: str = "give another folder") -> Iterator[None]:
    """Makes a folder and its missing parents. If the block fails, removes the empty ones among them.

    Raises:
        InputError: it cannot be made, or files cannot be written in it.
    """
    check_folder(path, what, instead)
    missing = [folder for folder in (path, *path.parents) if not folder.exists()]
    try:
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise _refused(path, what, f"cannot be made ({error.strerror or error})", instead) from error
        yield
    except BaseException:
        with interrupt.uninterrupted(), suppress(OSError):  # a folder that is not empty stays
            for folder in missing:
                folder.rmdir()
        raise


def _target(path: Path, what: str, instead: str) -> tuple[Path, os.stat_result | None]:
    """Returns the target of a path, links resolved, and its status, or None if it does not exist yet."""
    if path == STDOUT:
        return STDOUT, None
    try:
        target = Path(os.path.realpath(path))
        if not target.parent.is_dir():
            raise _refused(path, what, f"there is no folder {target.parent}", f"make it or {instead}")
        try:
            status = target.stat()
        except FileNotFoundError:
            return target, None
    except OSError as error:
        reason = "a loop of links" if error.errno == errno.ELOOP else error.strerror or str(error)
        raise _refused(path, what, f"cannot be written ({reason})", instead) from error
    if stat.S_ISDIR(status.st_mode):
        raise _refused(path, what, "is a folder", "give the name of a file")
    if not stat.S_ISREG(status.st_mode):
        raise _refused(path, what, f"is {kind_of(status.st_mode)}, not a plain file", instead)
    if not status.st_mode & WRITABLE or not os.access(target, os.W_OK):
        raise _refused(path, what, "is read-only", f"make it writable or {instead}")
    folder = target.parent.stat()
    user = getattr(os, "geteuid", int)()  # 0 on Windows, where folders have no sticky bit
    if folder.st_mode & stat.S_ISVTX and user not in (0, status.st_uid, folder.st_uid):
        raise _refused(path, what, "is another user's, and only they may replace it in this folder", instead)
    return target, status


def kind_of(mode: int) -> str:
    """Returns the kind of a file that is not a plain file, for a message."""
    if stat.S_ISDIR(mode):
        return "a folder"
    if stat.S_ISFIFO(mode):
        return "a pipe"
    if stat.S_ISSOCK(mode):
        return "a socket"
    return "a device"


def _make_like(beside: Path, before: os.stat_result) -> None:
    """Gives a new file the permissions of the file it replaces, and its owner and group if the system allows it."""
    mode = stat.S_IMODE(before.st_mode)
    with_owner = getattr(os, "chown", None)  # not on Windows
    if with_owner is not None:
        for owner, group in ((-1, before.st_gid), (before.st_uid, -1)):
            with suppress(PermissionError):
                with_owner(beside, owner, group)
        if beside.stat().st_gid != before.st_gid:  # another group gets the permissions of all others
            mode = mode & ~stat.S_IRWXG | (mode & stat.S_IRWXO) << 3
    beside.chmod(mode)


def identity(path: Path) -> tuple[int, int] | str:
    """Returns a value that is equal for all paths of one file or folder: links, hard links, other cases of letters."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return os.path.realpath(path)
    return status.st_dev, status.st_ino


def _settle(folder: Path) -> None:
    """Flushes a folder, with the new name in it, to the disk, if the system can."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _refused(path: Path, what: str, reason: str, instead: str) -> InputError:
    return InputError(f"{what} {path}: {reason}; {instead}")


MIB = 2**20
TEXT = 4 * MIB  # most bytes of a vehicle, campaign or MJCF file
TABLE = 64 * MIB  # of a measured road

Content = TypeVar("Content")


@contextmanager
def reading(path: Path, purpose: str, give: str = "give another file") -> Iterator[None]:
    """Turns any error that a library raises in this block into an InputError with the path, the purpose and the library's words.

    Args:
        path: the file that the block reads.
        purpose: what the file is for, such as "road profile".
        give: what to do instead, for the message.

    Raises:
        InputError: the block failed. An InputError of the block keeps its own words, after the purpose and the path.
    """
    try:
        yield
    except InputError as error:
        raise InputError(f"{purpose} {path}: {error}") from error
    except FileNotFoundError as error:
        reason = "is a link to nothing" if path.is_symlink() else "there is no such file"
        raise InputError(f"{purpose} {path}: {reason}; {give}") from error
    except IsADirectoryError as error:
        raise InputError(f"{purpose} {path}: is a folder, not a file; {give}") from error
    except OSError as error:
        raise InputError(f"{purpose} {path}: cannot be read ({error.strerror or error}); {give}") from error
    except UnicodeDecodeError as error:
        reason = f"not a text file in UTF-8 ({error.reason} at byte {error.start})"
        raise InputError(f"{purpose} {path}: {reason}; save it as UTF-8, or {give}") from error
    except Exception as error:
        raise InputError(f"{purpose} {path}: {error or type(error).__name__}; {give}") from error


def read_bytes(path: Path, what: str, most: int, give: str) -> bytes:
    """Returns the content of a plain file.

    Args:
        path: the file, or a link to it.
        most: allowed size [bytes].

    Raises:
        InputError: the file does not exist, is not a plain file, is too large, or cannot be read.
    """
    try:
        with open_plain(path, what, give) as stream:
            size = os.fstat(stream.fileno()).st_size
            content = stream.read(size + 1) if size <= most else b""  # not `most`, which may exceed the memory
            if len(content) > size:  # files in /proc report the size 0
                content += stream.read(most + 1 - len(content))
    except OSError as error:
        raise InputError(f"{what} {path}: cannot be read ({error.strerror or error}); {give}") from error
    if max(size, len(content)) > most:
        excess = f"{size / MIB:.0f} MiB" if size > most else "and does not end"
        raise InputError(f"{what} {path}: is too large, {excess}; at most {most / MIB:g} MiB is read: {give}")
    return content


def open_plain(path: Path, what: str, give: str) -> BufferedReader:
    """Opens a plain file for reading.

    Raises:
        InputError: the file does not exist, is not a plain file, or cannot be opened.
    """
    try:
        # Opening a pipe would block for ever without O_NONBLOCK; with it, the pipe is recognised.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        mode = os.fstat(handle).st_mode
        if not stat.S_ISREG(mode):
            os.close(handle)
            raise InputError(f"{what} {path}: is {kind_of(mode)}, not a plain file; {give}")
        return os.fdopen(handle, "rb")
    except OSError as error:
        reason = "is a folder, not a plain file" if path.is_dir() else _reason(path, error)  # Windows opens no folder
        raise InputError(f"{what} {path}: {reason}; {give}") from error
    except InputError:
        raise
    except ValueError as error:  # a NUL character in the name
        raise InputError(f"{what} {str(path)!r}: cannot be read ({error}); {give}") from error


def read_text(path: Path, what: str, most: int, give: str) -> str:
    """Returns the text of a plain file in UTF-8, with or without a byte order mark.

    Args:
        path, what, most, give: see `read_bytes`.

    Raises:
        InputError: see `read_bytes`; or it is not text.
    """
    return read_content(path, what, most, give, str)[0]


def read_content(path: Path, what: str, most: int, give: str, of: Callable[[str], Content]) -> tuple[Content, bytes]:
    """Returns the converted text of a plain file in UTF-8, and its bytes.

    Args:
        path, what, most, give: see `read_bytes`.
        of: converts the text; raises an InputError if it is wrong.

    Raises:
        InputError: see `read_bytes`; it is not text, or the text is wrong. The message names the file.
    """
    content, save = read_bytes(path, what, most, give), f"save it as UTF-8, or {give}"
    try:
        text = content.decode("utf-8-sig")
        if "\0" in text:
            raise InputError(f"not a text file in UTF-8 (a NUL character at byte {content.index(0)}, as in UTF-16); {save}")
        return of(text.replace("\r\n", "\n")), content
    except UnicodeDecodeError as error:
        reason = f"{error.reason} at byte {error.start}"
        raise InputError(f"{what} {path}: not a text file in UTF-8 ({reason}); {save}") from error
    except InputError as error:
        raise InputError(f"{what} {path}: {error}") from error


def origin(file: str, content: bytes) -> str:
    """Returns a comment line for a vehicle file that names the file whose content it includes."""
    return f"# from {file!a}, {len(content)} bytes, SHA-256 {hashlib.sha256(content).hexdigest()}"


def _reason(path: Path, error: OSError) -> str:
    """Returns why a file cannot be read, for a message."""
    if error.errno == errno.ENOENT:
        return "is a link to nothing" if path.is_symlink() else "there is no such file"
    if error.errno == errno.ELOOP:
        return "is a loop of links"
    if error.errno == errno.ENXIO:
        return "is a socket, not a plain file"
    return f"cannot be read ({error.strerror or error})"
