"""Begin and end of a process: UTF-8 in any locale, and a clean end on a signal from the first import to the last line.

Ctrl-C, SIGTERM and the end of the terminal end a command alike: it cleans up, prints one word, and exits with the code that a
shell has for the signal, without a traceback. "Ctrl-C" in the code means all of them.
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
    """Starts this Python again in its UTF-8 mode (PEP 540), if it is not in it and its arguments are UTF-8.

    In a locale of another encoding, such as C without coercion or ISO 8859-1, Python would misread the bytes of a name. It could
    then not find a file that a vehicle file names. Arguments in that encoding stay as they are. If all are ASCII, output stays in
    the terminal's encoding, and letters that it lacks are escaped.

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


WORDS = {
    "SIGINT": "interrupted",
    "SIGTERM": "terminated",
    "SIGHUP": "hung up",
}  # the word that is printed; not every system has all
SIGNALS = {int(number): word for name, word in WORDS.items() if (number := getattr(signal, name, None)) is not None}
_heard = [int(signal.SIGINT)]  # the last signal; Ctrl-C before any
_raised: list[int] = []  # signals that were raised as a KeyboardInterrupt


def code() -> int:
    """Returns the exit code of an interrupted command: 130 for Ctrl-C, 143 for SIGTERM, 129 for the end of its terminal."""
    return 128 + _heard[0]


def word() -> str:
    """Returns the word for the last signal."""
    return SIGNALS[_heard[0]]


def came() -> int | None:
    """Counts the interrupts raised so far: without one, a KeyboardInterrupt is some code's own. None if they are not counted."""
    return len(_raised) if signal.getsignal(signal.SIGINT) is _raise else None


def raised() -> int:
    """Counts the interrupts raised so far without the check of `came`, which takes microseconds."""
    return len(_raised)


def quiet_start() -> None:
    """Lets the process end silently on a signal while `python -m` is still importing a command.

    An exception would not do: compiled packages turn it into errors of their own, or drop it. Does nothing if the package is
    imported as a library.
    """
    # Only until it knows where the module lies, `python -m` says "-m" there.
    if sys.argv[:1] == ["-m"] and threading.current_thread() is threading.main_thread():
        speak_utf8()
        _handle_all(_leave)
        # No command draws by MuJoCo. Without this, MuJoCo starts a second Python to look for GLFW, with tracebacks of its own.
        os.environ["MUJOCO_GL"] = "disable"
        # A second thread of BLAS waits for the next product without sleeping: more work for the processor than the product's own.
        for library in ("OPENBLAS", "MKL"):
            os.environ.setdefault(f"{library}_NUM_THREADS", "1")


def raise_from_now_on() -> None:
    """Turns Ctrl-C into a KeyboardInterrupt from now on, so that a command can clean up."""
    if threading.current_thread() is threading.main_thread():
        _handle_all(_raise)
        sys.unraisablehook = _unraisable


def caused(error: BaseException | None) -> bool:
    """Returns True if an error is or stems from Ctrl-C: a compiled module turns it into ImportError during its import.

    Some of these modules drop the interrupt with its trace. So an import that fails after a Ctrl-C counts as broken by it.
    """
    if isinstance(error, ImportError) and _raised:
        return True
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


class _Late:
    """Signal handler that notes the first Ctrl-C and obeys the second."""

    def __init__(self) -> None:
        self.came = 0

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self.came:
            _raise(number, frame)
        self.came = number


@contextmanager
def finishing(work_goes_on: bool = False) -> Iterator[None]:
    """Defers a Ctrl-C during a short block that must not be left half done; a second one is obeyed.

    Args:
        work_goes_on: after the block; the deferred Ctrl-C is then raised at its end.
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
        before[late.came](late.came, None)  # an outer block of this kind, or the handler that raises KeyboardInterrupt


LATE = "the end"  # instead of a part that was whole


class Parts:
    """Work in parts, of which a Ctrl-C cuts one short and keeps the others and the results so far.

    Attributes:
        cut: name of the first part that was cut short, or empty.
    """

    def __init__(self) -> None:
        self.cut, self._done = "", ""

    def done(self, name: str) -> None:
        """Marks a part as whole: a Ctrl-C from now on comes too late to cut it short."""
        self._done = name

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Runs one part; `name` says what it does."""
        try:
            yield
        except KeyboardInterrupt:
            self.cut = self.cut or (LATE if name == self._done else name)


def ignore_from_now_on() -> None:
    """Ignores Ctrl-C from now on: the work is done, and the rest takes a moment."""
    # An interrupt inside an `exec` of text, as `dataclass` and `namedtuple` do, makes Python remember that it is to end by the
    # signal, even if the exception was caught; the next such `exec` forgets that (run_eval_code_obj in CPython's pythonrun.c).
    exec("")
    if threading.current_thread() is threading.main_thread():
        _handle_all(signal.SIG_IGN)


def _handle_all(handler: Any) -> None:
    """Sets the handler of all signals except those that the parent process ignores, as `nohup` does for SIGHUP."""
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
    """Handles exceptions that Python cannot raise, as in a finaliser.

    An interrupt is raised again a moment later. After one, half-made objects may complain when they are deleted (pyparsing's do):
    such complaints are dropped.
    """
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        threading.Timer(0.005, _thread.interrupt_main, (_heard[0],)).start()
    elif not _raised:
        sys.__unraisablehook__(unraisable)
