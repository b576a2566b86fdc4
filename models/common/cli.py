"""Start and end of a command. Every command that fails prints one line to stderr and returns an exit code.

The module of a command calls `run` before any other import. If a user presses Ctrl-C during the imports, the command therefore
also ends with a one-line message.
"""

import os
import sys

TYPE_CHECKING = False  # the import of `typing` would take some milliseconds
if TYPE_CHECKING:
    from types import FrameType
    from typing import NoReturn

INTERRUPT_EXIT_CODE = 130
# Number of new objects after which Python collects garbage (by default 700); imports alone create about 50 000 permanent
# objects
GARBAGE = 100_000
# No command renders with MuJoCo. Without this setting, MuJoCo would start a second Python process to look for GLFW. A second BLAS
# thread would wait for work without sleeping, and use more processor time than the small matrix products need.
ENVIRONMENT = {"MUJOCO_GL": "disable", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def run(command: str, *arguments: str) -> "NoReturn":
    """Runs `main` of a command's module, and exits with the code that `main` returns.

    If an exception ends the command, the exit code is 2 for invalid input, 1 for a failed design, 130 for Ctrl-C, otherwise 1.
    After Ctrl-C, every exception counts as an interrupt, because compiled code can turn the interrupt into another type of
    error. With `--traceback`, the exception is raised again, so that Python prints where it was raised.

    Args:
        command: full name of the module, such as `sim.bump`.
        arguments: arguments with which `main` is called.
    """
    for name, value in ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    import signal

    received = list[int]()  # numbers of the signals that were received

    def interrupt(number: int, frame: "FrameType | None") -> None:
        received.append(number)
        signal.default_int_handler(number, frame)

    try:
        import gc
        import importlib
        import warnings

        # If interrupts were ignored before the command started, as in a background job of a script, they stay ignored
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, interrupt)
        gc.set_threshold(GARBAGE)
        sys.unraisablehook = _unraisable
        if not sys.warnoptions:
            # NumPy's warnings are not shown, because the command itself prints a message about overflows
            warnings.simplefilter("ignore", RuntimeWarning)
        if (reconfigure := getattr(sys.stdout, "reconfigure", None)) is not None:
            reconfigure(errors="backslashreplace")  # names may contain letters that the terminal cannot display
        code = importlib.import_module(command).main(*arguments)
        importlib.import_module("models.common.printed").show("")  # an empty text ends the thread that counts the seconds
        if sys.stdout:  # `sys.stdout` is None if stdout is closed, for example by `>&-`
            sys.stdout.flush()
    except (Exception, KeyboardInterrupt) as error:
        code = _exit_code(command, error, bool(received))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # interrupts are ignored from here on, because the command has finished
    # If an interrupt arrives inside `exec`, which dataclasses use, CPython remembers it, and would still end the process by the
    # signal
    exec("")
    sys.exit(code)


def _unraisable(unraisable: "sys.UnraisableHookArgs") -> None:
    """Interrupts the command again after a Ctrl-C that arrived while a finaliser ran, for example during garbage collection.

    Without this function, Python would print the interrupt, but would not end the command.
    """
    if not isinstance(unraisable.exc_value, KeyboardInterrupt):
        return sys.__unraisablehook__(unraisable)
    import _thread
    import threading

    threading.Timer(0.01, _thread.interrupt_main).start()  # if an interrupt acted immediately, it would end this hook


def _exit_code(command: str, error: BaseException, interrupted: bool) -> int:
    """Prints the reason why a command ended, as one line, and returns its exit code."""
    from models.common.command import complain
    from models.common.errors import TRACEBACK, InputError

    if TRACEBACK in sys.argv and isinstance(error, Exception):
        raise error
    # The reader has closed the pipe, as in `roadproof ... | head`. Python would try to write the rest again at exit
    if isinstance(error, BrokenPipeError):
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
