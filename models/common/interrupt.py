"""How a process begins and ends: in UTF-8, whatever the locale says, and told to end from the first import to the last line.

Ctrl-C, SIGTERM and the end of the terminal end a command alike: what was begun is cleaned up, and there are one word and the
exit code that a shell has for it, but no traceback. Wherever the code says Ctrl-C it means all of them.
"""

import _thread
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any


def speak_utf8() -> None:
    """Starts this Python again in its UTF-8 mode (PEP 540), if it is not in it and what it was given is UTF-8.

    In a locale of another encoding, such as C without coercion or ISO 8859-1, Python would take the bytes of a name for other
    letters, or for none, and could not name a file as a vehicle file does. What it was given in that encoding stays as it
    is. Where nothing but ASCII was given, output stays in the terminal's encoding: what that lacks is escaped.

    To be called before anything has begun.
    """
    if sys.getfilesystemencoding() == "utf-8" or os.environ.get("PYTHONUTF8") == "1" or sys.flags.ignore_environment:
        return
    given = b"".join(map(os.fsencode, sys.orig_argv))
    try:
        given.decode("utf-8")
    except UnicodeDecodeError:
        return
    environment = {**os.environ, "PYTHONUTF8": "1"}
    if given.isascii() and sys.stdout is not None:  # closed, as in `>&-`
        environment.setdefault("PYTHONIOENCODING", f"{sys.stdout.encoding}:backslashreplace")
    os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], environment)


WORDS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}  # what they are to a user; not all are everywhere
SIGNALS = {int(number): word for name, word in WORDS.items() if (number := getattr(signal, name, None)) is not None}
_heard = [int(signal.SIGINT)]  # the last one that came, Ctrl-C before
_raised: list[int] = []  # those that have been raised as a KeyboardInterrupt


def code() -> int:
    """The exit code of a command that was told to end: 130 by Ctrl-C, 143 by SIGTERM, 129 by the end of its terminal."""
    return 128 + _heard[0]


def word() -> str:
    """What has happened to it, in a word."""
    return SIGNALS[_heard[0]]


def came() -> int | None:
    """How often it has been told to end: a KeyboardInterrupt without that is some code's own. None where nobody counts."""
    return len(_raised) if signal.getsignal(signal.SIGINT) is _raise else None


def raised() -> int:
    """How often it has been told to end so that a KeyboardInterrupt was raised; at once, where `came` takes microseconds."""
    return len(_raised)


def quiet_start() -> None:
    """While `python -m` is still importing a command nothing has begun, so the process may simply end.

    An exception would not do: compiled packages turn it into errors of their own, or drop it. For a library that is imported by
    anything else this does nothing.
    """
    # Only until it knows where the module lies, `python -m` says "-m" there.
    if sys.argv[:1] == ["-m"] and threading.current_thread() is threading.main_thread():
        speak_utf8()
        _handle_all(_leave)
        # No command draws by MuJoCo, whatever is installed for that. Else it starts a second Python to look for GLFW, with
        # tracebacks of its own.
        os.environ["MUJOCO_GL"] = "disable"
        # A second thread of BLAS waits for the next product without sleeping: more work for the processor than the product's own.
        for library in ("OPENBLAS", "MKL"):
            os.environ.setdefault(f"{library}_NUM_THREADS", "1")


def raise_from_now_on() -> None:
    """From here on Ctrl-C is a KeyboardInterrupt, so that what was begun is cleaned up."""
    if threading.current_thread() is threading.main_thread():
        _handle_all(_raise)
        sys.unraisablehook = _unraisable


def caused(error: BaseException | None) -> bool:
    """Whether an error is Ctrl-C, or what a library made of it: a compiled module that is being imported says ImportError."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


class _Late:
    """A handler that notes the first Ctrl-C, and heeds the second."""

    def __init__(self) -> None:
        self.came = 0

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self.came:
            _raise(number, frame)
        self.came = number


@contextmanager
def finishing(work_goes_on: bool = False) -> Iterator[None]:
    """What is done here takes a moment, and half of it would be worse than all: a Ctrl-C comes too late; a second is heeded.

    Args:
        work_goes_on: after it, so that a Ctrl-C is only late: it is heard when this is done, whatever this finishes within.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: handler for number in SIGNALS if callable(handler := signal.getsignal(number))}
    late = _Late()
    for number in before:
        signal.signal(number, late)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if late.came and (work_goes_on or isinstance(before[late.came], _Late)):
        before[late.came](late.came, None)  # an outer one of these, or what raises KeyboardInterrupt


LATE = "the end"  # instead of a part that was whole


class Parts:
    """Work in parts, of which a Ctrl-C cuts one short: what that has done so far, and the others, are kept.

    Attributes:
        cut: the first that was cut short; empty where none was.
    """

    def __init__(self) -> None:
        self.cut, self._done = "", ""

    def done(self, name: str) -> None:
        """A part is whole: what is heard from now on, while it ends, came too late to cut it short."""
        self._done = name

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """One of them, in words."""
        try:
            yield
        except KeyboardInterrupt:
            self.cut = self.cut or (LATE if name == self._done else name)


def ignore_from_now_on() -> None:
    """The work is done; what is left takes a moment and is not worth a traceback."""
    # An interrupt inside an `exec` of text, as `dataclass` and `namedtuple` do, makes Python remember that it is to end by the
    # signal, even if the exception was caught; the next such `exec` forgets that (run_eval_code_obj in CPython's pythonrun.c).
    exec("")
    if threading.current_thread() is threading.main_thread():
        _handle_all(signal.SIG_IGN)


def _handle_all(handler: Any) -> None:
    """Handles every signal but those that whoever has started this wants ignored, as `nohup` does the end of the terminal."""
    for number in SIGNALS:
        if number == signal.SIGINT or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def _raise(number: int, frame: FrameType | None) -> None:
    _heard[0] = number
    _raised.append(number)
    raise KeyboardInterrupt


def _leave(number: int, frame: FrameType | None) -> None:
    _heard[0] = number
    with suppress(OSError):  # stderr may be closed
        os.write(2, f"roadproof: {word()}\n".encode())
    os._exit(code())


def _unraisable(unraisable: Any) -> None:
    """What Python can raise nowhere, as in a finaliser.

    An interrupt comes again a moment later. After one, an object that it cut short while it was being made may complain when it
    goes (pyparsing's do): that says nothing to a user.
    """
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        threading.Timer(0.005, _thread.interrupt_main, (_heard[0],)).start()
    elif not _raised:
        sys.__unraisablehook__(unraisable)
