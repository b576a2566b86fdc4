"""The one door for files that are read: plain files up to a stated size, never a device, and never a wait."""

import errno
import hashlib
import os
import stat
from collections.abc import Callable
from io import BufferedReader
from pathlib import Path
from typing import TypeVar

from models.common.errors import InputError
from models.common.whole_file import kind_of

MIB = 2**20
TEXT = 4 * MIB  # most bytes of a vehicle, campaign or MJCF file
TABLE = 64 * MIB  # of a measured road

Content = TypeVar("Content")


def read_bytes(path: Path, what: str, most: int, give: str) -> bytes:
    """The content of a plain file.

    Args:
        path: the file, or a link to it.
        what: it is, for the message.
        most: bytes.
        give: what to give instead, for the message.

    Raises:
        InputError: there is none, it is no plain file, too large, or cannot be read.
    """
    try:
        with open_plain(path, what, give) as stream:
            size = os.fstat(stream.fileno()).st_size
            content = stream.read(most + 1) if size <= most else b""  # what /proc holds says that it is empty
    except OSError as error:
        raise InputError(f"{what} {path}: cannot be read ({error.strerror or error}); {give}") from error
    if max(size, len(content)) > most:
        found = f"{size / MIB:.0f} MiB" if size > most else "and does not end"
        raise InputError(f"{what} {path}: is too large, {found}; at most {most / MIB:g} MiB is read: {give}")
    return content


def open_plain(path: Path, what: str, give: str) -> BufferedReader:
    """A plain file, open to be read.

    Args:
        path, what, give: see `read_bytes`.

    Raises:
        InputError: there is none, it is no plain file, or cannot be opened.
    """
    try:
        # A pipe would be waited for, for ever; without waiting it can be opened, and seen for what it is.
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
    """The text of a plain file in UTF-8; some editors begin one with a byte order mark.

    Args:
        path, what, most, give: see `read_bytes`.

    Raises:
        InputError: see `read_bytes`; or it is not text.
    """
    try:
        content = read_bytes(path, what, most, give)
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        found = f"{error.reason} at byte {error.start}"
        raise InputError(f"{what} {path}: not a text file in UTF-8 ({found}); save it as UTF-8, or {give}") from error
    if "\0" in text:
        found = f"a NUL character at byte {content.index(0)}, as in UTF-16"
        raise InputError(f"{what} {path}: not a text file in UTF-8 ({found}); save it as UTF-8, or {give}")
    return text.replace("\r\n", "\n")


def read_content(path: Path, what: str, give: str, of: Callable[[str], Content]) -> tuple[Content, str]:
    """What a text file holds that goes into a vehicle file in place of its name, and the file's size and checksum in words.

    Args:
        path, what, give: see `read_bytes`.
        of: its text -> what it holds; raises InputError where that is none.

    Raises:
        InputError: see `read_bytes`; or it is no text, or holds nothing of the kind. The message names the file.
    """
    content = read_bytes(path, what, TEXT, give)
    try:
        found = of(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(f"{what} {path}: is no text in UTF-8; {give}") from error
    except InputError as error:
        raise InputError(f"{what} {path}: {error}") from error
    return found, f"{len(content)} bytes, SHA-256 {hashlib.sha256(content).hexdigest()}"


def _reason(path: Path, error: OSError) -> str:
    """Why a file cannot be read, in words."""
    if error.errno == errno.ENOENT:
        return "is a link to nothing" if path.is_symlink() else "there is no such file"
    if error.errno == errno.ELOOP:
        return "is a loop of links"
    if error.errno == errno.ENXIO:
        return "is a socket, not a plain file"
    return f"cannot be read ({error.strerror or error})"
