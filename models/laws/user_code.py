"""Execution of the user's own Python: every failure is one line that names its file."""

import traceback
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import CodeType
from typing import Any

import numpy as np

from models.common.errors import InputError, one_line


def compile_file(what: str, path: Path, text: str) -> CodeType:
    """Returns the compiled code of a file.

    Args:
        what: name of the file in messages.

    Raises:
        InputError: the text is not Python.
    """
    try:
        return compile(text, str(path), "exec")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:  # a NUL; too many nested brackets
        where = f", line {error.lineno}" if isinstance(error, SyntaxError) else ""
        raise InputError(f"{what}: its code is not valid Python ({getattr(error, 'msg', error)}{where}); correct it") from error


def run_own(what: str, path: Path, name: str, code: Callable[[], Any], refuses: bool = False) -> Any:
    """Runs code of the user's and returns its result.

    Args:
        what: name of the file in messages.
        name: name of the code in messages.
        code: calls the code.
        refuses: True if the code's purpose is to raise InputError.

    Raises:
        InputError: the code failed. The message has the last line of the user's file that ran.
    """
    try:
        with np.errstate(all="ignore"):  # non-finite results are found by the caller
            return code()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit too
        if refuses and isinstance(error, InputError):
            raise
        raise InputError(f"{what}: {name} fails ({reason(error, path)}); correct it") from error


def reason(error: BaseException, path: Path | None = None) -> str:
    """Describes an error: its type, its text, and the last line of the file that ran."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    said = "" if isinstance(error, InputError) else type(error).__name__
    with suppress(Exception):  # its text is user code as well
        said = ": ".join(text for text in (said, one_line(str(error))) if text)
    return said + (f", line {lines[-1]}" if lines else "")
