"""Running of laws in Python: one call per sample of the controller. Laws in files are guarded and timed.

A law is a function `step(sample, state)` that returns force and next state, or `law(t, y)` that returns the force.

Every run executes the file anew, so that the file's global names, as its state, belong to one run: runs do not depend on each
other. A vectorised law is executed once for all the runs that it gets together.

A watchdog ends a call that takes too long by an exception in its thread. Python raises that between two instructions of its own:
a call that waits within code that is not Python (a sleep, a read, one huge product) cannot be ended so. A command is then left
as it is, by `os._exit`; a library goes on waiting, unless `leave_by` was given a way out. Once the command is told to end, every
running call counts as too long.

All calls of a run together have a limit, too: `SLOWEST` times the time on the road. Else ten thousand calls just below the limit
of one call would take hours.
"""

import ctypes
import inspect
import threading
from collections.abc import Callable, Mapping
from os import _exit as leave_at_once
from time import monotonic as clock
from time import sleep
from types import ModuleType
from typing import Any

import numpy as np

from models.common import interrupt
from models.common.arrays import Array, check_unmasked
from models.common.cli import BAD_INPUT
from models.common.command import complain
from models.common.errors import InputError, quoted
from models.laws.python_law import Programmed
from models.laws.user_code import compiled, reason, run_own

LONGEST = 10.0  # s, limit of a call; the law of a car has milliseconds
SLOWEST = 100.0  # limit of all calls of a run, over the time on the road; `LONGEST` is added to it
LONGEST_START = 60.0  # s, limit of executing the file: it may import large packages
GRACE = 5.0  # s from the exception in a call that is too long until the command exits without it
SLOW = f"is slower than {SLOWEST:g} times real time, and {LONGEST:g} s,"
PLAIN = "write it as def step(sample, state), with return force, state at its end"
TICK = 0.05  # s between two looks of the watchdog
JUMPS = 1000  # backward jumps in a loop; at the first of them Python raises a pending exception


class Sample:
    """Arguments of a law at a sample.

    Attributes:
        y: the measurements, in the order of `measured`, shape (q,); `sample["sprung_velocity"]` is one by name.
        time: since the start [s].
        period: until the next sample [s].
        preview: heights of the road [m], a row per wheel: under it now, and at each of the next samples, as far as `preview`
            says, shape (r, P); None if the vehicle file declares no preview.
        parameters: of the vehicle, by name, in SI units.

    A vectorised law gets N runs side by side: y has shape (N, q), `sample["sprung_velocity"]` (N,), preview (N, r, P), and
    every parameter (N,).
    """

    __slots__ = ("_index", "parameters", "period", "preview", "time", "y")

    def __init__(
        self, index: Mapping[str, int], y: Array, time: float, period: float, preview: Array | None, parameters: Mapping[str, Any]
    ) -> None:
        self._index, self.y, self.time, self.period = index, y, time, period
        self.preview, self.parameters = preview, parameters

    @property
    def measured(self) -> tuple[str, ...]:
        """The names of `y`, in its order."""
        return tuple(self._index)

    def __getitem__(self, signal: str) -> Any:
        if signal not in self._index:
            raise InputError(f"it measures no {quoted(signal)}, but {', '.join(self._index)}")
        return self.y[..., self._index[signal]]


class OwnLaw:
    """One execution of a law: its state, and its file's own names.

    Attributes:
        vectorised: True if one call serves many runs, as an attribute of that name of its function says.
    """

    def __init__(self, controller: Programmed, forces: int) -> None:
        """Executes its file, or resets its function if that has a method `reset`.

        Raises:
            InputError: the file fails, takes too long, or has no such function.
        """
        law, step = controller.law, controller.function
        self._path, self._forces = law.path or law.folder, forces
        self._fmu, self._name = law.is_fmu, law.function
        self._what = f"controller {controller.name!r}, {'FMU' if self._fmu else 'law'} {law.law}"
        self._index = {name: i for i, name in enumerate(controller.measured)}
        self._left = LONGEST  # s that calls may still take
        self._state: Any = None
        if step is None:
            assert self._path is not None, "code comes from files only"
            module = ModuleType("roadproof_law")
            module.__file__ = str(self._path)
            code = compiled(self._what, self._path, controller.source)
            self._run("the file", LONGEST_START, lambda: exec(code, vars(module)))
            step = vars(module).get(law.function)
        if not callable(step):
            raise InputError(
                f"{self._what}: the file has no function {law.function!r}; give it one: def {law.function}(sample, state)"
            )
        self._step: Callable[..., Any] = step
        name = f"{law.function}.vectorised"
        vectorised, returns, self._timed = self._run(
            name, LONGEST, lambda: (_flag(getattr(step, "vectorised", False)), _returns(step), _timed(step))
        )
        if not returns:
            raise InputError(f"{self._what}: {law.function} is async, or yields, and is called once a sample; {PLAIN}")
        if vectorised is None:
            raise InputError(f"{self._what}: {name} is neither true nor false; give {name} = True, or leave it out")
        self.vectorised = vectorised
        if controller.function is not None:
            self._what = f"controller {controller.name!r}"
            self._name += "(t, y)" if self._timed else "(sample, state)"
            self._run("reset()", LONGEST, getattr(step, "reset", lambda: None))

    def __call__(self, y: Array, time: float, period: float, preview: Array | None, parameters: Mapping[str, Any]) -> Array:
        """Returns the requested forces [N], shape (m,) or, for a vectorised law, (N, m).

        Raises:
            InputError: the law fails, takes too long, or returns something else than forces and a state.
        """
        sample = Sample(self._index, y.copy(), time, period, preview, dict(parameters))
        shape = (*y.shape[:-1], self._forces)
        self._left += SLOWEST * period * (len(y) if y.ndim > 1 else 1)
        began = clock()
        try:
            return self._run(self._name, min(LONGEST, self._left), lambda: self._called(sample, shape))
        except InputError as error:
            said = str(error).removesuffix("; mend that")
            if self._fmu:
                at = f", at {time:.6g} s" if time else ""
                raise InputError(f"{self._what}{at}: {said.removeprefix(f'{self._what}: ')}") from error.__cause__
            raise InputError(f"{said} at {time:.6g} s; mend that") from error.__cause__
        finally:
            self._left -= clock() - began

    def _called(self, sample: Sample, shape: tuple[int, ...]) -> Array:
        """Calls the law once and checks its result, whose methods may be user code as well."""
        given = (self._step(sample.time, sample.y), None) if self._timed else self._step(sample, self._state)
        if inspect.iscoroutine(given):
            given.close()  # else Python complains that nobody has awaited it
        if not isinstance(given, tuple) or len(given) != 2:
            raise InputError(f"it gives {_short(given)}, and not two things; end it with: return force, state")
        force, self._state = given
        check_unmasked("its force", force)
        forces = np.asarray(force)
        if forces.dtype.kind not in "bifu" and forces.dtype.kind != "O":
            raise InputError(f"its force is {_short(force)}, which is no real number; give newtons")
        try:
            forces = np.array(forces, dtype=float)
        except (TypeError, ValueError):
            raise InputError(f"its force is {_short(force)}, which is no real number; give newtons") from None
        scalar = shape[-1] == 1 and forces.shape == shape[:-1]  # one actuator: a number is enough
        if forces.shape != shape and not scalar:
            raise InputError(f"its force has shape {forces.shape}; expected {shape}, a number per actuator")
        if not np.all(np.isfinite(forces)):
            raise InputError("its force is not finite")
        return forces.reshape(shape)

    def _run(self, name: str, longest: float, code: Callable[[], Any]) -> Any:
        """Runs user code, that of a file with a time limit."""
        if self._path is None:  # a function of the caller's, in whose process it is at home
            try:
                return code()
            except Exception as error:
                raise InputError(f"{self._what}: {name} fails ({reason(error)}); mend that") from error
        over = f"takes longer than {longest:g} s" if longest in (LONGEST, LONGEST_START) else SLOW
        said = f"{self._what}: {name} {over}; mend that"
        raised = interrupt.interrupts_raise()
        try:
            with _watchdog.watching(said, longest) as watched:
                try:
                    return run_own(self._what, self._path, name, code, refuses=self._fmu)
                except InputError:
                    if not watched.late:
                        raise
        except _TooLong:  # raised a moment after their code had ended
            pass
        if interrupt.interrupts_raise() != raised:
            raise KeyboardInterrupt
        raise InputError(said)


class _TooLong(BaseException):
    """Exception that ends a call that takes too long. Not an Exception, so that `except Exception` does not swallow it."""


class _Watched:
    """One watched call, in the thread that makes it."""

    def __init__(self, watchdog: "_Watchdog", said: str, longest: float) -> None:
        self.said, self.thread = said, threading.get_ident()
        self.deadline, self.late, self.told = clock() + longest, False, interrupt.interrupts_raise()
        self._watchdog = watchdog

    def __enter__(self) -> "_Watched":
        self._watchdog.calls[self.thread] = self
        return self

    def __exit__(self, *error: object) -> None:
        while True:
            try:
                with self._watchdog.lock:
                    self._watchdog.calls.pop(self.thread, None)
                if self.late:  # the call may have ended by itself a moment ago: its pending exception is raised here
                    # Not taken back by PyThreadState_SetAsyncExc(id, NULL): CPython 3.11 then stays on the look-out for it for
                    # ever, and a function that is profiled never gets beyond its first instruction.
                    for _ in range(JUMPS):
                        pass
            except _TooLong:
                continue
            return


class _Watchdog:
    """Watchdog that ends calls that take too long, in any thread."""

    def __init__(self) -> None:
        self.calls: dict[int, _Watched] = {}
        self.lock = threading.Lock()
        self.leave: Callable[[str], None] | None = None
        self._thread: threading.Thread | None = None

    def watching(self, said: str, longest: float) -> _Watched:
        """Returns a context manager that watches its block."""
        if self._thread is None or not self._thread.is_alive():
            with self.lock:
                if self._thread is None or not self._thread.is_alive():
                    self._thread = threading.Thread(target=self._watch, daemon=True, name="roadproof-watchdog")
                    self._thread.start()
        return _Watched(self, said, longest)

    def _watch(self) -> None:
        while True:
            sleep(TICK)
            now = clock()
            for call in list(self.calls.values()):
                if interrupt.interrupts_raise() != call.told:  # and their code caught it, or was about to end
                    call.deadline = min(call.deadline, now)
                if now > call.deadline:
                    self._end(call, now)

    def _end(self, call: _Watched, now: float) -> None:
        with self.lock:
            if self.calls.get(call.thread) is not call:
                return
            leave = self.leave or (_leave_command if interrupt.interrupt_pending() is not None else None)
            if leave is not None and now > call.deadline + GRACE:
                leave(call.said)
            call.late = True
            ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(call.thread), ctypes.py_object(_TooLong))


_watchdog = _Watchdog()


def leave_by(leave: Callable[[str], None]) -> None:
    """Sets the function that leaves this process if a call cannot be ended; it gets the message and does not return."""
    _watchdog.leave = leave


def _leave_command(said: str) -> None:
    raised = interrupt.interrupts_raise() > 0
    complain(interrupt.word() if raised else said)
    leave_at_once(interrupt.code() if raised else BAD_INPUT)


def _flag(value: Any) -> bool | None:
    """Returns a user's value as a bool, or None if it is not true or false."""
    return bool(value) if isinstance(value, (bool, np.bool_)) else None


def _returns(function: Any) -> bool:
    """Returns True if a call of a user's function is complete when it returns: it is not async, and no generator."""
    kinds = (inspect.iscoroutinefunction, inspect.isgeneratorfunction, inspect.isasyncgenfunction)
    return not any(kind(code) for code in (function, type(function).__call__) for kind in kinds)


def _timed(function: Any) -> bool:
    """Returns True for a law of time and measurements, law(t, y), instead of a sample and a state."""
    try:
        return next(iter(inspect.signature(function).parameters), "") == "t"
    except (TypeError, ValueError):  # a function that is not Python has no signature
        return False


def _short(value: Any) -> str:
    """Returns a user's value as a message has it."""
    return quoted(value) if isinstance(value, (str, int, float, bool, type(None), list)) else f"a {type(value).__name__}"
