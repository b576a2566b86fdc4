"""Exported code on another processor: a simulated Arm Cortex-M4 without a floating-point unit, instruction by instruction.

Zig's C compiler (`ziglang`) builds it, with its own routines for floating point; `unicorn` runs it. Both come with the extra
`[export]`. Instructions are counted, not cycles: a simulator has no memory that makes a processor wait.
"""

import ctypes
import importlib.util
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from models.common.errors import InputError
from synth.controller.export.c_law import ExportedLaw
from synth.controller.export.fixed_source import source_of

PACKAGES = ("ziglang", "unicorn")
TARGET = "-target thumb-freestanding-eabi -mcpu=cortex_m4+soft_float -fcompiler-rt -O ReleaseFast -fentry=entry"
STATE, INPUTS, OUTPUTS = 0x2000_0000, 0x2001_0000, 0x2006_0000  # where data lies
STACK, END = 0x2010_0000, 0x0FFF_0000  # where the stack begins, where a call returns to
PAGE = 0x1000
C_TYPES = {"double": ctypes.c_double, "float": ctypes.c_float, "int32": ctypes.c_int32, "int16": ctypes.c_int16}
PATIENCE = 30_000_000  # microseconds of a call; more, and it does not end
COUNTED = 20  # samples whose instructions are counted, which takes ten thousand times as long as running them
BLOCK = 500  # samples of the others that run without a stop
FUNCTION = 2  # type of a symbol in an ELF file


@dataclass(frozen=True)
class ProcessorRun:
    """Result of some samples on the simulated processor.

    Attributes:
        outputs: of every sample, in its order.
        least, most: instructions of a step, among the first `COUNTED` samples.
        stack: bytes of stack of a step, at most, among the same.
        size: bytes of code and tables.
    """

    outputs: list[list[float]]
    least: int
    most: int
    stack: int
    size: int


def is_available() -> bool:
    """Returns True if the packages of the extra `[export]` are installed."""
    return all(importlib.util.find_spec(name) is not None for name in PACKAGES)


def run(law: ExportedLaw, inputs: Sequence[Sequence[float]]) -> ProcessorRun:
    """Runs samples of an exported law on a simulated Cortex-M4.

    Args:
        law: the law.
        inputs: of every sample, in the order of the law's inputs.

    Raises:
        InputError: the extra is not installed, the code cannot be built, or a step does not end.
    """
    if not is_available():
        raise InputError("a Cortex-M4 is simulated by the extra [export]; pip install 'roadproof[export]'")
    with tempfile.TemporaryDirectory() as folder:
        machine = _Machine(law, _built(law, Path(folder)).read_bytes())
    machine.called("init", [STATE])
    outputs, counts = list[list[float]](), list[int]()
    with machine.counting():
        for row in inputs[:COUNTED]:
            outputs += machine.outputs([row])
            counts.append(machine.instructions)
    for i in range(COUNTED, len(inputs), BLOCK):
        outputs += machine.outputs(inputs[i : i + BLOCK])
    return ProcessorRun(outputs, min(counts), max(counts), STACK - machine.deepest, machine.size)


class _Machine:
    """Simulated processor with a law's program in its memory.

    Attributes:
        size: bytes of code and tables.
        instructions: of the last call, where they are counted.
        deepest: lowest address of the stack so far, where instructions are counted.
    """

    def __init__(self, law: ExportedLaw, program: bytes) -> None:
        import unicorn  # pyright: ignore[reportMissingImports] - an extra of few
        from unicorn import arm_const as arm  # pyright: ignore[reportMissingImports]

        self._law, self._program, self._number = law, program, C_TYPES[law.numbers]
        self._core = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
        self._core.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
        self._every_instruction = unicorn.UC_HOOK_CODE
        self._arguments = arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R1, arm.UC_ARM_REG_R2, arm.UC_ARM_REG_R3
        self._sp, self._lr, self._pc = arm.UC_ARM_REG_SP, arm.UC_ARM_REG_LR, arm.UC_ARM_REG_PC
        self.size, self.instructions, self.deepest = _loaded(self._core, program), 0, STACK
        self._core.mem_map(STATE, STACK - STATE + PAGE)
        self._core.mem_map(END, PAGE)

    def outputs(self, rows: Sequence[Sequence[float]]) -> list[list[float]]:
        """Returns the outputs of the next samples."""
        number, many = self._number, len(self._law.outputs)
        self._core.mem_write(INPUTS, bytes((number * (len(rows) * len(rows[0])))(*chain.from_iterable(rows))))
        if len(rows) == 1:
            self.called("step", [STATE, INPUTS, OUTPUTS])
        else:
            self.called("steps", [STATE, INPUTS, OUTPUTS, len(rows)])
        values = number * (len(rows) * many)
        found = list(values.from_buffer_copy(self._core.mem_read(OUTPUTS, ctypes.sizeof(values))))
        return [found[i : i + many] for i in range(0, len(found), many)]

    def called(self, name: str, arguments: Sequence[int]) -> None:
        """Calls a function of the law.

        Raises:
            InputError: it does not end.
        """
        for register, value in zip(self._arguments, arguments, strict=False):
            self._core.reg_write(register, value)
        self._core.reg_write(self._sp, STACK)
        self._core.reg_write(self._lr, END | 1)
        self.instructions = 0
        self._core.emu_start(_address(self._program, f"{self._law.name}_{name}"), END, timeout=PATIENCE)
        if self._core.reg_read(self._pc) != END:
            raise InputError(f"{self._law.name}_{name} does not end within {PATIENCE / 1e6:g} s")

    @contextmanager
    def counting(self) -> Iterator[None]:
        """Counts instructions, and measures the stack, of all calls inside."""

        def counted(core, address, length, user) -> None:
            self.instructions += 1
            self.deepest = min(self.deepest, core.reg_read(self._sp))

        hook = self._core.hook_add(self._every_instruction, counted)
        yield
        self._core.hook_del(hook)
        self._core.ctl_flush_tb()  # translated code would go on to call it


def _built(law: ExportedLaw, folder: Path) -> Path:
    """Returns the program: both functions of a law, and one that takes many steps, kept by a table that an endless loop reads."""
    source, p = source_of(law, "0" * 64), law.name
    entry = (
        f'#include "{p}.h"\n'
        f"void {p}_steps({p}_state *state, const {p}_in *in, {p}_out *out, int count);\n"
        f"void {p}_steps({p}_state *state, const {p}_in *in, {p}_out *out, int count)\n"
        f"{{\n    for (int i = 0; i < count; i++) {p}_step(state, in + i, out + i);\n}}\n"
        "typedef void (*function)(void);\nvolatile const function kept[3] = "
        f"{{(function){p}_init, (function){p}_step, (function){p}_steps}};\n"
        "void entry(void);\nvoid entry(void) { for (;;) { (void)kept[0]; } }\n"
    )
    texts = {f"{p}.h": source.header(), f"{p}.c": source.source(), f"{p}_data.h": source.data(), "entry.c": entry}
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8", newline="\n")
    flags = ["-femit-bin=program.elf", "-cflags", "-std=c99", "-ffp-contract=off", "--", f"{p}.c", "entry.c"]
    command = [sys.executable, "-m", "ziglang", "build-exe", *TARGET.split(), *flags]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise InputError(f"the code cannot be built for a Cortex-M4: {'; '.join(done.stderr.splitlines()[:1])}")
    return folder / "program.elf"


def _loaded(machine, program: bytes) -> int:
    """Maps the segments of a 32-bit ELF program into a machine; returns the bytes of them that are in the file."""
    start, entry_size, count = struct.unpack_from("<I", program, 28)[0], *struct.unpack_from("<HH", program, 42)
    total, mapped = 0, set[int]()
    for i in range(count):
        kind, offset, address, _, size, memory = struct.unpack_from("<6I", program, start + i * entry_size)
        if kind != 1 or not memory:  # PT_LOAD
            continue
        for page in range(address // PAGE, (address + memory - 1) // PAGE + 1):
            if page not in mapped:
                machine.mem_map(page * PAGE, PAGE)
                mapped.add(page)
        machine.mem_write(address, program[offset : offset + size])
        total += size
    return total


def _address(program: bytes, name: str) -> int:
    """Returns the address of a function of a 32-bit ELF program, its lowest bit set, as Thumb code has it."""
    start = struct.unpack_from("<I", program, 32)[0]
    size, count = struct.unpack_from("<HH", program, 46)
    sections = [struct.unpack_from("<10I", program, start + i * size) for i in range(count)]
    symbols = next(one for one in sections if one[1] == 2)  # SHT_SYMTAB
    names = sections[symbols[6]][4]
    for at in range(symbols[4], symbols[4] + symbols[5], 16):
        text, value, _, info = struct.unpack_from("<IIIB", program, at)
        end = program.index(b"\0", names + text)
        if program[names + text : end].decode() == name and info & 15 == FUNCTION:
            return value | 1
    raise InputError(f"the program for a Cortex-M4 has no function {name}")
