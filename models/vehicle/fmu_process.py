"""The process that runs somebody else's FMU (FMI 2.0, co-simulation), a line of JSON for each step; it is run as a script.

Nothing of this project is imported: what the FMU breaks, it breaks here alone. What it prints goes to stderr.
"""

import ctypes
import json
import os
import sys
from typing import Any, TextIO

STATUS = ("fmi2OK", "fmi2Warning", "fmi2Discard", "fmi2Error", "fmi2Fatal", "fmi2Pending")
LOGGER = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)
ALLOCATE = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_size_t, ctypes.c_size_t)
FREE = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
CO_SIMULATION = 1


class Callbacks(ctypes.Structure):
    """The callback functions of FMI 2.0."""

    _fields_ = (
        ("logger", LOGGER),
        ("allocate", ALLOCATE),
        ("free", FREE),
        ("finished", ctypes.c_void_p),
        ("environment", ctypes.c_void_p),
    )


class Slave:
    """An instance of an FMU."""

    def __init__(self, about: dict[str, Any]) -> None:
        """Loads and initializes it.

        Args:
            about: library, guid, resources (URI), inputs and outputs (value references).
        """
        self.said = ""
        self._library = ctypes.CDLL(about["library"])
        libc = ctypes.CDLL(None if os.name != "nt" else "msvcrt")
        libc.calloc.restype, libc.calloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t, ctypes.c_size_t]
        libc.free.argtypes = [ctypes.c_void_p]
        self._callbacks = Callbacks(LOGGER(self._log), ALLOCATE(libc.calloc), FREE(libc.free), None, None)
        self._inputs, self._outputs = ((ctypes.c_uint * len(about[name]))(*about[name]) for name in ("inputs", "outputs"))
        self._seen, self._given = (ctypes.c_double * len(self._inputs))(), (ctypes.c_double * len(self._outputs))()
        begin = self._library.fmi2Instantiate
        begin.restype = ctypes.c_void_p
        texts = [about[name].encode() for name in ("guid", "resources")]
        one = begin(b"controller", CO_SIMULATION, *texts, ctypes.byref(self._callbacks), 0, 0)
        if not one:
            raise RuntimeError(f"fmi2Instantiate returned no instance{self._why()}")
        self._one = ctypes.c_void_p(one)
        real = ctypes.c_double
        self._call("fmi2SetupExperiment", 0, real(0.0), real(0.0), 0, real(0.0))
        self._call("fmi2EnterInitializationMode")
        self._call("fmi2ExitInitializationMode")

    def step(self, time: float, period: float, seen: list[float]) -> list[float]:
        """Returns the outputs after a step."""
        self._seen[:] = seen
        self._call("fmi2SetReal", self._inputs, ctypes.c_size_t(len(self._seen)), self._seen)
        self._call("fmi2DoStep", ctypes.c_double(time), ctypes.c_double(period), 1)
        self._call("fmi2GetReal", self._outputs, ctypes.c_size_t(len(self._given)), self._given)
        return list(self._given)

    def _log(self, _environment: int, _name: bytes, status: int, _category: bytes, said: bytes) -> None:
        if status > 1 and said:
            self.said = " ".join(said.decode(errors="replace").split())[:200]

    def _why(self) -> str:
        return f" ({self.said})" if self.said else ""

    def _call(self, function: str, *arguments: Any) -> None:
        self.said = ""
        status = getattr(self._library, function)(self._one, *arguments)
        if status not in (0, 1):
            raise RuntimeError(f"{function} returned {STATUS[status] if 0 <= status < 6 else status}{self._why()}")


def serve(lines: TextIO, answers: TextIO) -> None:
    """Answers a line that says what to load, then a line for each step, until there are no more."""
    slave: Slave | None = None
    for line in lines:
        asked = json.loads(line)
        try:
            if slave is None:
                slave, answer = Slave(asked), {"outputs": []}
            else:
                answer = {"outputs": slave.step(asked["time"], asked["period"], asked["inputs"])}
        except (RuntimeError, OSError, AttributeError) as error:
            answer = {"error": " ".join(str(error).split())[:300]}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


if __name__ == "__main__":
    private = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    serve(sys.stdin, private)
