"""Running of the user's own Python: every failure is one line that names its file, and its output goes to stderr.

A child process that it forks ends where it would return. An interrupt is obeyed even if the user's code caught it.
"""

import os
import sys
import threading
import traceback
from collections.abc import Callable
from os import _exit as leave_at_once
from pathlib import Path
from types import CodeType
from typing import Any, NoReturn, TextIO

import numpy as np

from models.common import interrupt
from models.common.errors import InputError, one_line

_lock, _users, _stdout, _process = threading.Lock(), [0], list[TextIO](), [0]


def compiled(what: str, path: Path, text: str) -> CodeType:
    """Returns the compiled code of a file.

    Args:
        what: what a message calls the file.

    Raises:
        InputError: it is no Python.
    """
    try:
        return compile(text, str(path), "exec")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:  # a NUL; brackets in brackets in ...
        where = f", line {error.lineno}" if isinstance(error, SyntaxError) else ""
        raise InputError(f"{what}: is no Python ({getattr(error, 'msg', error)}{where}); mend that") from error


def run_own(what: str, path: Path, name: str, code: Callable[[], Any], refuses: bool = False) -> Any:
    """Runs code of the user's and returns its result. Its output goes to stderr: stdout is the command's, and may be JSON.

    Args:
        what: what a message calls the file.
        name: what a message calls the code.
        code: calls it.
        refuses: True if the code's purpose is to raise InputError.

    Raises:
        InputError: the code failed. The message has the last line of the user's file that ran.
        KeyboardInterrupt: the command was told to end, even if the code caught that.
    """
    before, failed, result = interrupt.interrupts_raise(), "", None
    try:
        with np.errstate(all="ignore"), _Guarded():  # what is not finite is found in the result
            result = _without_children(code)
    except BaseException as error:  # SystemExit too, and what a user derives from BaseException
        if isinstance(error, KeyboardInterrupt) and interrupt.interrupt_pending() is None:  # nobody counts: it may be the user's
            raise
        if refuses and isinstance(error, InputError) and interrupt.interrupts_raise() == before:
            raise
        failed = f"{what}: {name} fails ({reason(error, path)}); mend that"
    if interrupt.interrupts_raise() != before:
        raise KeyboardInterrupt
    if failed:
        raise InputError(failed)  # outside, so that a KeyboardInterrupt of theirs does not look as if it were the user's
    return result


def _without_children(code: Callable[[], Any]) -> Any:
    """Runs code and ends each child that it forks, which would else go on as a second command with the first one's files."""
    process = os.getpid()
    try:
        return code()
    finally:
        if os.getpid() != process:
            leave_at_once(0)  # no lock can be waited for: whoever held it is not in the child


def reason(error: BaseException, path: Path | None = None) -> str:
    """Describes an error: its type, its text, and the last line of the file that ran."""
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == str(path)]
    where = f", line {lines[-1]}" if lines else ""
    try:
        said = one_line(str(error))
    except BaseException:  # its text is the user's code as well
        said = ""
    kind = "" if isinstance(error, InputError) else type(error).__name__
    return ": ".join(text for text in (kind, said) if text) + where


def _kept_running(code: int) -> NoReturn:
    """Stands in for `os._exit` while user code runs, by which a command would end without its output, and with any exit code."""
    if os.getpid() != _process[0]:  # a child of theirs, which ends so
        leave_at_once(code)
    raise SystemExit(f"it ends the process by os._exit({code})")


class _Guarded:
    """Redirects output of all threads to stderr, and keeps the process, until the last such block has ended.

    Entered at every call.
    """

    def __enter__(self) -> None:
        with _lock:
            if not _users[0]:
                _stdout.append(sys.stdout)
                sys.stdout, os._exit = sys.stderr, _kept_running
                _process[0] = os.getpid()
            _users[0] += 1

    def __exit__(self, *error: object) -> None:
        with _lock:
            _users[0] -= 1
            if not _users[0]:
                sys.stdout, os._exit = _stdout.pop(), leave_at_once
