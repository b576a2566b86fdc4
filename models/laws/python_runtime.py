"""Execution of Python control laws: one call per sample of the controller.

A law is a function `step(sample, state)` that returns the force and the next state, or `law(t, y)` that returns the force.

Every run executes the file of the law again. Therefore, every run has its own global variables of the law's file and its own
state of the law. Runs do not affect each other. A vectorised law is executed only once for all runs of a batch.

A law in a file runs in a child process (`FileRuns`). The child process is terminated if one call of the law, or all calls in a
run together, take too long. The time limit of a run is `SLOWEST` times its simulated time, plus `LONGEST`. A function passed by
the caller runs in the caller's process, without time limits (`LawRuns`).
"""

import inspect
import os
import sys
import weakref
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import cached_property
from time import monotonic as clock
from types import ModuleType
from typing import Any

import numpy as np

from models.common.arrays import Array, check_unmasked
from models.common.children import Child, EndedError
from models.common.errors import InputError, short_repr
from models.laws.python_law import PythonController
from models.laws.user_code import compile_file, reason

LONGEST = 10.0  # time limit for the calls of a law in one sample [s]; a typical law takes microseconds
SLOWEST = 100.0  # time limit for all calls of a law in a run, relative to the simulated time of the run; `LONGEST` is added
LONGEST_START = 60.0  # time limit for executing a law's file [s], which may import large packages
SLOW = f"takes more than {LONGEST:g} s plus {SLOWEST:g} times the simulated time"


class Sample:
    """Arguments that a law receives at a sample.

    Attributes:
        y: measurements in the order of `measured`, shape (q,). The expression `sample["sprung_velocity"]` returns a single
            measurement by its name.
        time: time since the start of the run [s].
        period: time until the next sample of the controller [s].
        preview: road heights [m], shape (r, P): a row for each wheel, and a column for the present sample and for each of the
            next samples within the preview time. The heights are None if the vehicle file does not define a preview time.
        parameters: parameters of the vehicle in SI units, by name.

    A vectorised law receives N simultaneous runs: y has shape (N, q), `sample["sprung_velocity"]` has shape (N,), preview has
    shape (N, r, P), and every parameter has shape (N,).
    """

    __slots__ = ("_index", "parameters", "period", "preview", "time", "y")

    def __init__(
        self, index: Mapping[str, int], y: Array, time: float, period: float, preview: Array | None, parameters: Mapping[str, Any]
    ) -> None:
        self._index, self.y, self.time, self.period = index, y, time, period
        self.preview, self.parameters = preview, parameters

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the measurements, in the order of `y`."""
        return tuple(self._index)

    def __getitem__(self, signal: str) -> Any:
        if signal not in self._index:
            raise InputError(f"the controller does not measure {short_repr(signal)}; it measures {', '.join(self._index)}")
        return self.y[..., self._index[signal]]


class OwnLaw:
    """One execution of a law, with the state of the law and the global variables of its file.

    Attributes:
        vectorised: True if one call of the law computes the forces of all runs. The function of a vectorised law has the
            attribute `vectorised`.
    """

    def __init__(self, controller: PythonController, forces: int) -> None:
        """Executes the file of the law.

        A function of the caller is reset if it has a method `reset`; otherwise, the function is copied with its state.

        Args:
            controller: controller that contains the law.
            forces: number of forces that the law must return.

        Raises:
            InputError: the file fails, or does not contain the function.
        """
        law, step = controller.law, anew(controller.function)
        self._path, self._forces, self._fmu, self._name = law.path, forces, law.is_fmu, law.function
        self._what, self._state = describe_law(controller), None
        self._index = {name: i for i, name in enumerate(controller.measured)}
        if step is None:
            assert self._path is not None, "code comes from files only"
            module = ModuleType("roadproof_law")
            module.__file__ = str(self._path)
            code = compile_file(self._what, self._path, controller.source)
            self._run("the file", lambda: exec(code, vars(module)))
            step = vars(module).get(law.function)
        if not callable(step):
            raise InputError(
                f"{self._what}: the file has no function {law.function!r}; define the function as def "
                f"{law.function}(sample, state)"
            )
        self._step: Callable[..., Any] = step
        self._timed, name, self.vectorised = _takes_time(step), f"{law.function}.vectorised", getattr(step, "vectorised", False)
        if not isinstance(self.vectorised, (bool, np.bool_)):
            raise InputError(f"{self._what}: {name} is neither True nor False; set {name} = True, or omit it")
        if controller.function is not None:
            self._what = f"controller {controller.name!r}"
            self._name += "(t, y)" if self._timed else "(sample, state)"
            self._run("reset()", getattr(step, "reset", lambda: None))

    def __call__(self, y: Array, time: float, period: float, preview: Array | None, parameters: Mapping[str, Any]) -> Array:
        """Returns the requested forces [N], shape (m,), or (N, m) for a vectorised law.

        Args:
            y: measurements, shape (q,), or (N, q) for a vectorised law.
            time: time since the start of the run [s].
            period: time until the next sample of the controller [s].
            preview: road heights, as in `Sample`.
            parameters: parameters of the vehicle [SI], by name.

        Raises:
            InputError: the law fails, or does not return forces and a state.
        """
        sample = Sample(self._index, y.copy(), time, period, preview, dict(parameters))
        return self._run(self._name, lambda: self._called(sample, (*y.shape[:-1], self._forces)), time)

    def _called(self, sample: Sample, shape: tuple[int, ...]) -> Array:
        """Calls the law once and checks its result.

        The check is treated as part of the call, because methods of the result may be user code, too.
        """
        given = (self._step(sample.time, sample.y), None) if self._timed else self._step(sample, self._state)
        if not isinstance(given, tuple) or len(given) != 2:
            raise InputError(f"the law returns {_short(given)}, not two values; end its function with: return force, state")
        force, self._state = given
        check_unmasked("the returned force", force)
        forces = np.asarray(force)
        if forces.dtype.kind not in "bifu" and forces.dtype.kind != "O":
            raise InputError(f"the returned force is {_short(force)}, which is not a real number; return a real number in N")
        try:
            forces = np.array(forces, dtype=float)
        except (TypeError, ValueError):
            raise InputError(
                f"the returned force is {_short(force)}, which is not a real number; return a real number in N"
            ) from None
        # For a single actuator, a law may return a number instead of an array
        scalar = shape[-1] == 1 and forces.shape == shape[:-1]
        if forces.shape != shape and not scalar:
            raise InputError(f"the returned force has shape {forces.shape}; expected {shape}, one number for each actuator")
        if not np.all(np.isfinite(forces)):
            raise InputError("the returned force is not finite; return finite numbers")
        return forces.reshape(shape)

    def _run(self, name: str, code: Callable[[], Any], time: float | None = None) -> Any:
        """Executes code of the law. Every failure of the code becomes a one-line message, which states the simulated time [s]
        of the call.
        """
        try:
            return code()
        except BaseException as error:
            # In the caller's own process, an exit or Ctrl-C is passed on
            if self._path is None and not isinstance(error, Exception):
                raise
            if self._fmu and isinstance(error, InputError):
                raise InputError(f"{self._what}{f', at {time:.6g} s' if time else ''}: {error}") from error
            said = f"{name} fails ({reason(error, self._path)}){'' if time is None else f' at {time:.6g} s'}"
            raise InputError(f"{self._what}: {said}; correct the law") from error


def anew(function: Any) -> Any:
    """Returns a copy of a function with copies of its closure, attributes, object and global variables.

    Functions that have a method `reset`, or that cannot be copied, are returned unchanged.
    """
    if function is None or callable(getattr(function, "reset", None)):
        return function
    import cloudpickle  # unlike `copy`, cloudpickle can also copy functions

    with suppress(Exception):  # objects that the function refers to may raise any error while they are copied
        return cloudpickle.loads(cloudpickle.dumps(function))
    return function


class LawRuns:
    """Runs in which the Python law of one controller is executed. Every run executes the law separately, but runs of a
    vectorised law share one execution.

    Attributes:
        vectorised: True if one call of the law computes the forces of all runs.
    """

    vectorised = False

    def __init__(self, controller: PythonController, forces: int) -> None:
        """Prepares runs of a law that returns the number of forces in `forces`; the method `add` adds the runs."""
        self._controller, self._forces = controller, forces
        self._laws, self._parameters = list[OwnLaw](), list[Mapping[str, float]]()

    def add(self, parameters: Mapping[str, float]) -> bool:
        """Adds a run of a vehicle with the supplied parameters. Returns `vectorised`.

        Raises:
            InputError: `OwnLaw` raises an InputError, in which case the run is not added.
        """
        if not self.vectorised:
            self._laws.append(OwnLaw(self._controller, self._forces))
            self.vectorised = self._laws[-1].vectorised
        self._parameters.append(parameters)
        return self.vectorised

    def call(
        self, gone: Array, y: Array, time: float, period: float, preview: Array | None
    ) -> tuple[Array, dict[int, InputError]]:
        """Returns the requested forces of N runs [N], shape (N, m), and the errors, by the number of the run that failed.

        Args:
            gone: True for each run whose law is no longer called, shape (N,). The forces of runs whose law is no longer called
                are 0.
            y: measurements, shape (N, q).
            time: time since the start of the run [s].
            period: time until the next sample of the controller [s].
            preview: road heights ahead [m], shape (N, r, P); None without preview.

        Raises:
            InputError: the call of a vectorised law fails.
        """
        if self.vectorised:
            rows = gone[:, None]
            called = self._laws[0](np.where(rows, 0.0, y), time, period, preview, self._side_by_side)
            return np.where(rows, 0.0, called), {}
        forces, errors = np.zeros((len(y), self._forces)), dict[int, InputError]()
        for i in np.flatnonzero(~gone).tolist():
            ahead = None if preview is None else preview[i]
            try:
                forces[i] = self._laws[i](y[i], time, period, ahead, self._parameters[i])
            except InputError as error:
                errors[i] = error
        return forces, errors

    @cached_property
    def _side_by_side(self) -> dict[str, Array]:
        """Parameters of all runs by name, each of shape (N,)."""
        return {name: np.array([one[name] for one in self._parameters]) for name in self._parameters[0]}


class FileRuns:
    """`LawRuns` for a law in a file, which is executed in a child process. If the child process ends, all runs in it fail."""

    def __init__(self, controller: PythonController, forces: int) -> None:
        """Prepares runs of a law that returns the number of forces in `forces`; the method `add` adds the runs."""
        self._what, self._name, self._left, self._count = describe_law(controller), controller.law.function, LONGEST, 0
        self._error: InputError | None = None
        self._child = _child()
        weakref.finalize(self, _idle[os.getpid()].append, self._child).atexit = False
        self._child.send(("begin", os.getcwd(), sys.path, controller, forces))

    def add(self, parameters: Mapping[str, float]) -> bool:
        """See `LawRuns.add`. The execution of the file also fails if it takes too long."""
        self._count += 1
        return self._answer("the file", LONGEST_START, "", "add", parameters)

    def call(
        self, gone: Array, y: Array, time: float, period: float, preview: Array | None
    ) -> tuple[Array, dict[int, InputError]]:
        """See `LawRuns.call`.

        Raises:
            InputError: `LawRuns.call` raises an InputError, a call takes too long, or the code ends the process.
        """
        self._left += SLOWEST * period * self._count
        began = clock()
        try:
            arrays = _pack_array(gone), _pack_array(y), None if preview is None else _pack_array(preview)
            longest, when = min(LONGEST, self._left), f" at {time:.6g} s"
            forces, errors = self._answer(self._name, longest, when, "call", time, period, *arrays)
            return _unpack_array(*forces), errors
        finally:
            self._left -= clock() - began

    def _answer(self, name: str, longest: float, when: str, *message: Any) -> Any:
        """Returns the answer of the child process. After the child process has ended, every further call raises the error that
        reports this end.
        """
        if self._error is None:
            try:
                return self._child.ask(message, longest)
            except TimeoutError:
                said = f"takes longer than {longest:g} s" if longest in (LONGEST, LONGEST_START) else SLOW
            except EndedError as error:
                said = f"ends its process ({error})"
            self._error = InputError(f"{self._what}: {name} {said}{when}; correct {name}")
        raise self._error


# Child processes that no run uses at present, grouped by the process that started them; a forked process must not use the
# children of its parent
_idle: dict[int, list[Child]] = {}


def _child() -> Child:
    idle = _idle.setdefault(os.getpid(), [])
    with suppress(IndexError):  # the list of idle children may be empty
        while (child := idle.pop()).ended:
            pass
        return child
    return Child(_serve_laws)


def _serve_laws(messages: Iterator[Any]) -> Iterator[Any]:
    """Executes laws in a child process, for one controller at a time."""
    np.seterr(all="ignore")  # `OwnLaw` finds results that are not finite, so NumPy's warnings are not needed
    runs: Any = None
    for what, *message in messages:
        try:
            if what == "call":
                time, period, gone, y, preview = message
                ahead = None if preview is None else _unpack_array(*preview)
                forces, errors = runs.call(_unpack_array(*gone), _unpack_array(*y), time, period, ahead)
                yield _pack_array(forces), errors
            elif what == "add":
                yield runs.add(*message)
            else:
                folder, sys.path[:], controller, forces = message
                os.chdir(folder)
                runs = LawRuns(controller, forces)
        except InputError as error:
            yield error


def _pack_array(array: Array) -> tuple[str, tuple[int, ...], bytes]:
    """Returns the type, shape and content of a small array; pickling these takes a tenth of the time of pickling the array."""
    return array.dtype.char, array.shape, array.tobytes()


def _unpack_array(dtype: str, shape: tuple[int, ...], content: bytes) -> Array:
    """Returns the array with the supplied type, shape and content."""
    return np.frombuffer(content, dtype).reshape(shape).copy()


def runs_of(controller: PythonController, forces: int) -> LawRuns | FileRuns:
    """Returns the object that runs a law. A law in a file runs in a child process; a function of the caller runs in the
    caller's process.
    """
    return (FileRuns if controller.function is None else LawRuns)(controller, forces)


def describe_law(controller: PythonController) -> str:
    """Returns a text for messages: the name of a controller, followed by its Python law or FMU."""
    return f"controller {controller.name!r}, {'FMU' if controller.law.is_fmu else 'law'} {controller.law.law}"


def _takes_time(function: Any) -> bool:
    """Returns True if the function of a law takes a time and measurements, law(t, y), instead of a sample and a state."""
    try:
        return next(iter(inspect.signature(function).parameters), "") == "t"
    except (TypeError, ValueError):  # a function that is not written in Python has no signature
        return False


def _short(value: Any) -> str:
    """Returns a value from user code as text for a message."""
    return short_repr(value) if isinstance(value, (str, int, float, bool, type(None), list)) else f"a {type(value).__name__}"
