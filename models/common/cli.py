"""Start and end of a command: whatever ends it is one line on stderr and an exit code.

The module of a command calls `run` before it imports anything else, so that Ctrl-C during its imports ends in one line, too.
"""

import os
import sys

TYPE_CHECKING = False  # the import of `typing` takes some milliseconds
if TYPE_CHECKING:
    from types import FrameType
    from typing import NoReturn

INTERRUPT_EXIT_CODE = 130
GARBAGE = 100_000  # objects between garbage collections, not 700: imports alone make some 50 000 that stay
# No command renders with MuJoCo, which would start a second Python to look for GLFW. A second BLAS thread waits for work without
# sleeping, and uses more of the processor than the small products do.
ENVIRONMENT = {"MUJOCO_GL": "disable", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def run(command: str, *arguments: str) -> "NoReturn":
    """Runs `main` of a command's module and exits with the code that it returns.

    An exception also ends the command: 2 for bad input, 1 for a failed design, 130 for Ctrl-C, else 1. After Ctrl-C, every
    exception counts as the interrupt, because compiled code can turn the interrupt into an error of another type. With
    `--traceback` the error is raised, which shows where it came from.

    Args:
        command: full name of the module, such as `sim.bump`.
        arguments: arguments of its `main`.
    """
    for name, value in ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    import signal

    received = list[int]()  # interrupts

    def interrupt(number: int, frame: "FrameType | None") -> None:
        received.append(number)
        signal.default_int_handler(number, frame)

    try:
        import gc
        import importlib
        import warnings

        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not ignored, as in a script's background
            signal.signal(signal.SIGINT, interrupt)
        gc.set_threshold(GARBAGE)
        sys.unraisablehook = _unraisable
        if not sys.warnoptions:
            warnings.simplefilter("ignore", RuntimeWarning)  # of numpy: the command says in words what overflows
        if (reconfigure := getattr(sys.stdout, "reconfigure", None)) is not None:
            reconfigure(errors="backslashreplace")  # names may contain letters that the terminal lacks
        code = importlib.import_module(command).main(*arguments)
        importlib.import_module("models.common.printed").show("")  # no thread counts seconds any more
        if sys.stdout:  # closed, as in `>&-`, it is None
            sys.stdout.flush()
    except (Exception, KeyboardInterrupt) as error:
        code = _exit_code(command, error, bool(received))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the work is done
    exec("")  # CPython remembers an interrupt inside an `exec`, as of a dataclass, and would end by the signal after all
    sys.exit(code)


def _unraisable(unraisable: "sys.UnraisableHookArgs") -> None:
    """Repeats a Ctrl-C that came while a finaliser ran, as in a garbage collection: Python would only print it."""
    if not isinstance(unraisable.exc_value, KeyboardInterrupt):
        return sys.__unraisablehook__(unraisable)
    import _thread
    import threading

    threading.Timer(0.01, _thread.interrupt_main).start()  # at once, the interrupt would end this hook


def _exit_code(command: str, error: BaseException, interrupted: bool) -> int:
    """Prints why a command ended, as one line, and returns its exit code."""
    from models.common.command import complain
    from models.common.errors import TRACEBACK, InputError

    if TRACEBACK in sys.argv and isinstance(error, Exception):
        raise error
    if isinstance(error, BrokenPipeError):  # the reader has gone, as in `| head`; Python would try to write once more as it exits
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return 0
    if interrupted or isinstance(error, KeyboardInterrupt):
        complain(str(error) if isinstance(error, KeyboardInterrupt) and str(error) else "interrupted")
        return INTERRUPT_EXIT_CODE
    if isinstance(error, InputError):
        complain(str(error))
        return error.exit_code
    name = command.removesuffix(".__main__")
    complain(f"{name} failed with an unexpected {type(error).__name__}: {error}; {TRACEBACK} shows where")
    return 1
