"""Python of the user's own, run: whatever is wrong with it is one line that names its file, and what it prints goes to stderr.

It has no second way back: a child that it forks ends where it would return, and being told to end is heard though it caught that.
"""

import os
import sys
import threading
import traceback
from collections.abc import Callable
from pathlib import Path
from types import CodeType
from typing import Any, TextIO

import numpy as np

from models.common import interrupt
from models.common.command import keep_stdout
from models.common.errors import InputError, one_line

_lock, _users, _stdout = threading.Lock(), [0], list[TextIO]()


def compiled(what: str, path: Path, text: str) -> CodeType:
    """The code of a file.

    Args:
        what: what a message calls the file.
        path: of the file, for messages.
        text: of it.

    Raises:
        InputError: it is no Python.
    """
    try:
        return compile(text, str(path), "exec")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:  # a NUL; brackets in brackets in ...
        where = f", line {error.lineno}" if isinstance(error, SyntaxError) else ""
        raise InputError(f"{what}: is no Python ({getattr(error, 'msg', error)}{where}); mend that") from error


def run_own(what: str, path: Path, name: str, code: Callable[[], Any], refuses: bool = False) -> Any:
    """Runs code of the user's; what it gives. What it prints goes to stderr: stdout is the command's, and may be JSON.

    Args:
        what: what a message calls the file.
        path: of the file.
        name: what a message calls the code.
        code: calls it.
        refuses: whether an InputError of its own is what it is there for.

    Raises:
        InputError: it failed. The message has the last line of theirs that ran.
        KeyboardInterrupt: the command was told to end, whatever their code made of it.
    """
    before, failed, found = interrupt.raised(), "", None
    try:
        with np.errstate(all="ignore"), _PrintingToStderr():  # what is not finite is found in the result
            found = _without_children(code)
    except BaseException as error:  # SystemExit too, and what a user derives from BaseException
        if isinstance(error, KeyboardInterrupt) and interrupt.came() is None:  # nobody counts: it may be the user's
            raise
        if refuses and isinstance(error, InputError) and interrupt.raised() == before:
            raise
        failed = f"{what}: {name} fails ({_reason(error, path)}); mend that"
    if interrupt.raised() != before:
        raise KeyboardInterrupt
    if failed:
        raise InputError(failed)  # outside, so that a KeyboardInterrupt of theirs does not look as if it were the user's
    return found


def _without_children(code: Callable[[], Any]) -> Any:
    """Runs code; a child that it forks ends here, where it would go on as a second command, with the first one's files."""
    process = os.getpid()
    try:
        return code()
    finally:
        if os.getpid() != process:
            os._exit(0)  # no lock can be waited for: whoever held it is not in the child


def _reason(error: BaseException, path: Path) -> str:
    """What was raised, what it says, and the last line of the file that ran."""
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == str(path)]
    where = f", line {lines[-1]}" if lines else ""
    try:
        said = one_line(str(error))
    except BaseException:  # its text is the user's code as well
        said = ""
    kind = "" if isinstance(error, InputError) else type(error).__name__
    return ": ".join(text for text in (kind, said) if text) + where


class _PrintingToStderr:
    """What is printed goes to stderr, from whatever thread, until the last of these has ended. Entered at every call."""

    def __enter__(self) -> None:
        with _lock:
            if not _users[0]:
                keep_stdout()  # also from what does not go through Python's own
                _stdout.append(sys.stdout)
                sys.stdout = sys.stderr
            _users[0] += 1

    def __exit__(self, *error: object) -> None:
        with _lock:
            _users[0] -= 1
            if not _users[0]:
                sys.stdout = _stdout.pop()
