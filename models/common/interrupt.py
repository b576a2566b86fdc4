"""Ctrl-C, from the first import to the last line: one word, exit code 130, no traceback."""

import _thread
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

from models.common.encoding import speak_utf8

CODE = 130


def quiet_start() -> None:
    """While `python -m` is still importing a command nothing has begun, so the process may simply end.

    An exception would not do: compiled packages turn it into errors of their own, or drop it. For a library that is imported by
    anything else this does nothing.
    """
    # Only until it knows where the module lies, `python -m` says "-m" there.
    if sys.argv[:1] == ["-m"] and threading.current_thread() is threading.main_thread():
        speak_utf8()
        signal.signal(signal.SIGINT, _leave)
        # No command draws by MuJoCo, whatever is installed for that. Else it starts a second Python to look for GLFW, with
        # tracebacks of its own.
        os.environ["MUJOCO_GL"] = "disable"


def raise_from_now_on() -> None:
    """From here on Ctrl-C is a KeyboardInterrupt, so that what was begun is cleaned up."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.unraisablehook = _again


def caused(error: BaseException | None) -> bool:
    """Whether an error is Ctrl-C, or what a library made of it: a compiled module that is being imported says ImportError."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


class _Late:
    """A handler that notes the first Ctrl-C, and heeds the second."""

    def __init__(self) -> None:
        self.came = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self.came:
            raise KeyboardInterrupt
        self.came = True


@contextmanager
def finishing(work_goes_on: bool = False) -> Iterator[None]:
    """What is done here takes a moment, and half of it would be worse than all: a Ctrl-C comes too late; a second is heeded.

    Args:
        work_goes_on: after it, so that a Ctrl-C is only late: it is heard when this is done, whatever this finishes within.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before in (None, signal.SIG_IGN):
        yield
        return
    late = _Late()
    signal.signal(signal.SIGINT, late)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if late.came and callable(before) and (work_goes_on or isinstance(before, _Late)):
        before(signal.SIGINT, None)  # an outer one of these, or what raises KeyboardInterrupt


def ignore_from_now_on() -> None:
    """The work is done; what is left takes a moment and is not worth a traceback."""
    # An interrupt inside an `exec` of text, as `dataclass` and `namedtuple` do, makes Python remember that it is to end by the
    # signal, even if the exception was caught; the next such `exec` forgets that (run_eval_code_obj in CPython's pythonrun.c).
    exec("")
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _leave(number: int, frame: FrameType | None) -> None:
    with suppress(OSError):  # stderr may be closed
        os.write(2, b"roadproof: interrupted\n")
    os._exit(CODE)


def _again(unraisable: Any) -> None:
    """Where Python can raise nothing, as in a finaliser, it drops an interrupt: it comes again a moment later."""
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        threading.Timer(0.005, _thread.interrupt_main).start()
    else:
        sys.__unraisablehook__(unraisable)
