"""Start and end of a process: UTF-8 in any locale, no warnings of numpy, and a clean end on a signal at any time.

On Ctrl-C, SIGTERM and SIGHUP a command cleans up, prints one word, and exits with the shell's code for the signal, without a
traceback. "Ctrl-C" in the code means all three.
"""

import _thread
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any


def speak_utf8() -> None:
    """Restarts this Python in UTF-8 mode (PEP 540), unless it is in that mode or its arguments are not UTF-8.

    In a locale of another encoding, such as C without coercion or ISO 8859-1, Python could not find a file with a name in UTF-8.
    If all arguments are ASCII, output stays in the terminal's encoding, and letters that it lacks are escaped.

    Call it first: the process starts again.
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


def hide_numpy_warnings() -> None:
    """Keeps numpy's warnings off a command's stderr: its text says what overflows. They stay with `python -W`, and in tests."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore", RuntimeWarning)


WORDS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}  # printed; Windows has no SIGHUP
SIGNALS = {int(number): word for name, word in WORDS.items() if (number := getattr(signal, name, None)) is not None}
_last = [int(signal.SIGINT)]  # the last signal; SIGINT before any
_raised: list[int] = []  # signals that were raised as a KeyboardInterrupt


def code() -> int:
    """Returns the exit code of an interrupted command: 130 for SIGINT, 143 for SIGTERM, 129 for SIGHUP."""
    return 128 + _last[0]


def word() -> str:
    """Returns the word for the last signal."""
    return SIGNALS[_last[0]]


def interrupt_pending() -> int | None:
    """Returns the number of interrupts raised so far, or None if they are not counted.

    If it has not grown, a KeyboardInterrupt was raised by user code.
    """
    return len(_raised) if signal.getsignal(signal.SIGINT) is _raise else None


def interrupts_raise() -> int:
    """Returns the number of interrupts raised so far, without the check of `interrupt_pending`, which takes microseconds."""
    return len(_raised)


def quiet_start() -> None:
    """Lets the process end silently on a signal while `python -m` is still importing a command.

    An exception would not help: compiled packages turn it into other errors, or drop it. It has no effect if the package is
    imported as a library.
    """
    # `python -m` sets argv[0] to "-m" while it looks for the module.
    if sys.argv[:1] == ["-m"] and threading.current_thread() is threading.main_thread():
        speak_utf8()
        _handle_all(_leave)
        # No command renders with MuJoCo, which would start a second Python to look for GLFW.
        os.environ["MUJOCO_GL"] = "disable"
        # A second BLAS thread waits for work without sleeping, and uses more of the processor than the small products do.
        for library in ("OPENBLAS", "MKL"):
            os.environ.setdefault(f"{library}_NUM_THREADS", "1")


def enable_interrupts() -> None:
    """Turns Ctrl-C into a KeyboardInterrupt from now on, so that a command can clean up."""
    if threading.current_thread() is threading.main_thread():
        _handle_all(_raise)
        sys.unraisablehook = _unraisable


def is_interrupt(error: BaseException | None) -> bool:
    """Returns True if an error is a KeyboardInterrupt, or was caused by one.

    Compiled modules turn an interrupt during their import into an ImportError or a TypeError, some without a cause. So an import
    that fails after a Ctrl-C counts as caused by it.
    """
    if _raised and (isinstance(error, ImportError) or _importing(error)):
        return True
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _importing(error: BaseException | None) -> bool:
    """Returns True if an error comes out of a module's body."""
    frame = None if error is None else error.__traceback__
    while frame is not None and frame.tb_frame.f_code.co_name != "<module>":
        frame = frame.tb_next
    return frame is not None


class _Late:
    """Signal handler that records the first Ctrl-C and raises at the second."""

    def __init__(self) -> None:
        self.came = 0

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self.came:
            _raise(number, frame)
        self.came = number


@contextmanager
def uninterrupted(work_goes_on: bool = False) -> Iterator[None]:
    """Defers a Ctrl-C during a short block that must be completed; a second one is raised at once.

    Args:
        work_goes_on: True if work follows: the deferred Ctrl-C is then raised at the end of the block, else dropped.
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


LATE = "the end"  # in place of the name of a part that was complete


class Parts:
    """Work in parts: Ctrl-C interrupts one part, and keeps the others and the results so far.

    Attributes:
        cut: name of the first part that was interrupted, or empty.
    """

    def __init__(self) -> None:
        self.cut, self._done = "", ""

    def done(self, name: str) -> None:
        """Marks a part as complete: a later Ctrl-C no longer counts as its interruption."""
        self._done = name

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Runs one part of the work."""
        try:
            yield
        except KeyboardInterrupt:
            self.cut = self.cut or (LATE if name == self._done else name)


def ignore_from_now_on() -> None:
    """Ignores Ctrl-C from now on: the work is done, and the rest takes a moment."""
    # After an interrupt inside `exec` of a text, as in `dataclass`, Python exits by the signal even if the exception was caught.
    # The next such `exec` resets that (run_eval_code_obj in CPython's pythonrun.c).
    exec("")
    if threading.current_thread() is threading.main_thread():
        _handle_all(signal.SIG_IGN)


def _handle_all(handler: Any) -> None:
    """Sets the handler of all signals except those that the parent process set to be ignored, as `nohup` does for SIGHUP."""
    for number in SIGNALS:
        if number == signal.SIGINT or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def _raise(number: int, frame: FrameType | None) -> None:
    _last[0] = number
    _raised.append(number)
    raise KeyboardInterrupt


def _leave(number: int, frame: FrameType | None) -> None:
    _last[0] = number
    with suppress(OSError):  # stderr may be closed
        os.write(2, f"roadproof: {word()}\n".encode())
    os._exit(code())


def _unraisable(unraisable: Any) -> None:
    """Handles exceptions that Python cannot raise, as in a finaliser.

    An interrupt is raised again a moment later. After one, errors from finalisers of incomplete objects, as of pyparsing, are
    dropped.
    """
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        threading.Timer(0.005, _thread.interrupt_main, (_last[0],)).start()
    elif not _raised:
        sys.__unraisablehook__(unraisable)
