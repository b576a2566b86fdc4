"""Exported code as a compiled library, called once per sample.

The library is built by the C compiler of this machine, or by the Zig compiler, which the extra `[export]` installs. In
simulations, the compiled code computes the outputs of the controller. The analysis is the same with and without exported code.
"""

import ctypes
import functools
import importlib.util
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import AnyController
from synth.controller.export.c_law import NUMBERS, ExportedLaw, exported_law
from synth.controller.export.c_source import FLAGS, CSource

# bytes for the integers and the padding in the state struct; the other numbers of the struct need additional bytes
INTEGER = 64


def own_compiler() -> str | None:
    """Returns the path of the C compiler of this machine; None without a compiler."""
    return shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


def compiler() -> list[str]:
    """Returns the command of a C compiler.

    Raises:
        InputError: no compiler is installed.
    """
    own = own_compiler()
    if own is not None:
        return [own]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc"]
    raise InputError(
        "there is no C compiler on this machine; install cc, or install the compiler of Zig with pip install 'roadproof[export]'"
    )


@dataclass(frozen=True, eq=False)
class ExportedCode:
    """Code of an exported folder.

    Attributes:
        law: exported law with the tables of the folder.
        texts: texts of NAME.c, NAME.h and NAME_data.h, by file name.
        sha256: checksum of the folder's manifest.
    """

    law: ExportedLaw
    texts: dict[str, str]
    sha256: str

    @property
    def record(self) -> dict[str, Any]:
        """JSON object with the checksum, and with the number format, prefix and ranges from which the code can be generated
        again.
        """
        law = self.law
        return {"numbers": law.numbers, "name": law.name, "ranges": law.largest, "manifest_sha256": self.sha256}

    def start(self) -> "CompiledStep":
        """Returns the code with its initial state; the code is compiled when it is first used.

        Raises:
            InputError: there is no compiler, or the compiler rejects the code.
        """
        return CompiledStep(self)


@functools.lru_cache(maxsize=16)
def _library(name: str, texts: tuple[tuple[str, str], ...]) -> ctypes.PyDLL:
    command = compiler()
    # Windows cannot delete a library that is still loaded
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as beside:
        for file, text in texts:
            (Path(beside) / file).write_text(text, encoding="utf-8", newline="\n")
        library = Path(beside) / f"{name}.so"
        arguments = [*FLAGS.split(), "-shared", "-fPIC", str(Path(beside) / f"{name}.c"), "-o", str(library)]
        built = subprocess.run([*command, *arguments], capture_output=True, text=True, check=False)
        if built.returncode:
            raise InputError(f"the compiler {Path(command[0]).name} rejects {name}.c: {'; '.join(built.stderr.splitlines()[:1])}")
        # CDLL would release the lock so that other threads can run, which would take longer than a step
        return ctypes.PyDLL(str(library))


class CompiledStep:
    """Controller that runs compiled code. A call of `step()` computes the outputs `given` from the inputs `seen`.

    Attributes:
        seen: array of input values, in the order of the law's inputs; the caller fills it before each step.
        given: array of output values that the last call of `step()` computed.
        x: array of the law's states after the last call of `step()`.
        step: function that computes `given` and the next states from `seen`.
        state: bytes of the C struct that stores the state.
    """

    def __init__(self, code: ExportedCode) -> None:
        """Initialises the controller state in the compiled code."""
        law, number = code.law, NUMBERS[code.law.numbers]
        kept = (law.states + (law.delay + 1) * len(law.outputs) + len(law.inputs)) * np.dtype(number).itemsize
        self.state = np.zeros(kept + INTEGER, dtype=np.uint8)
        self.seen, self.given = np.zeros(len(law.inputs), number), np.zeros(len(law.outputs), number)
        self.x: Array = self.state[: law.states * np.dtype(number).itemsize].view(number)
        state, seen, given = (ctypes.c_void_p(one.ctypes.data) for one in (self.state, self.seen, self.given))
        library = _library(law.name, tuple(code.texts.items()))
        library[f"{law.name}_init"](state)
        step = library[f"{law.name}_step"]
        step.restype = None
        self.step = functools.partial(step, state, seen, given)
        self.fixed = law.fixed

    def read(self, seen: Array) -> None:
        """Writes the i inputs to the compiled code; the inputs are in physical units, shape (i,).

        For fixed point, the inputs are rounded and clipped, as by an analogue-to-digital converter.
        """
        if self.fixed is None:
            self.seen[...] = seen
        else:
            most = self.fixed.largest
            self.seen[...] = np.minimum(np.maximum(np.rint(seen / self.fixed.seen), -most), most)

    @property
    def forces(self) -> Array:
        """Outputs of the last step in physical units (N or N s/m), shape (m,)."""
        return self.given.astype(float) if self.fixed is None else self.given * self.fixed.given

    @property
    def states(self) -> Array:
        """States after the last step in the units of the law, shape (k,)."""
        return self.x.astype(float) if self.fixed is None else self.x * self.fixed.state_units


def code_again(vehicle: Vehicle, driver: AnyController, record: Mapping[str, Any]) -> ExportedCode:
    """Generates the exported code of a controller again, from a record of its number format, prefix and ranges.

    Args:
        vehicle: vehicle of the controller.
        driver: controller whose code is generated.
        record: description of the exported code, from `ExportedCode.record`.

    Raises:
        InputError: the controller cannot be exported with the settings in the record.
    """
    law = exported_law(vehicle, driver, record["numbers"], record["name"], record["ranges"])
    return ExportedCode(law, CSource(law, "0" * 64).files, record["manifest_sha256"])
