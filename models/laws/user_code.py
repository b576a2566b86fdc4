"""Execution of the user's Python code. Every failure of the code becomes a one-line message with the name of the file."""

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
        what: name of the file, for messages.
        path: path of the file with the code.
        text: content of the file.

    Raises:
        InputError: the text is not valid Python.
    """
    try:
        return compile(text, str(path), "exec")
    # The text may not be compilable, for example because of a NUL character or too many nested brackets
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        where = f", line {error.lineno}" if isinstance(error, SyntaxError) else ""
        raise InputError(f"{what}: its code is not valid Python ({getattr(error, 'msg', error)}{where}); correct it") from error


def run_own(what: str, path: Path, name: str, code: Callable[[], Any], refuses: bool = False) -> Any:
    """Executes code of the user and returns its result.

    Args:
        what: name of the file, for messages.
        path: path of the file with the code.
        name: name of the user's code, for messages.
        code: function that calls the user's code.
        refuses: True if the code may raise InputError on purpose.

    Raises:
        InputError: the user's code failed. The message of the error gives the last executed line of the user's file.
    """
    try:
        # NumPy's warnings are not needed, because the caller checks for results that are not finite
        with np.errstate(all="ignore"):
            return code()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # user code may raise any exception, even SystemExit
        if refuses and isinstance(error, InputError):
            raise
        raise InputError(f"{what}: {name} fails ({reason(error, path)}); correct it") from error


def reason(error: BaseException, path: Path | None = None) -> str:
    """Describes an error in the user's code: its type, its text, and the last executed line of the file."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
    said = "" if isinstance(error, InputError) else type(error).__name__
    with suppress(Exception):  # user code may also define the text of an exception, and may fail while it creates the text
        said = ": ".join(text for text in (said, one_line(str(error))) if text)
    return said + (f", line {lines[-1]}" if lines else "")
