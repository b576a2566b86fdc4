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
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from models.common.errors import InputError
from synth.controller.export.c_law import ExportedLaw
from synth.controller.export.fixed_source import source_of

PACKAGES = ("ziglang", "unicorn")
TARGET = "-target thumb-freestanding-eabi -mcpu=cortex_m4+soft_float -fcompiler-rt -O ReleaseFast -fentry=entry"
STACK, MEMORY, END = 0x2010_0000, 0x2000_0000, 0x0FFF_0000  # where the stack begins, where data lies, where a call returns to
PAGE = 0x1000
C_TYPES = {"double": ctypes.c_double, "float": ctypes.c_float, "int32": ctypes.c_int32, "int16": ctypes.c_int16}
MOST = 10_000_000  # instructions of a step; more, and it does not end
FUNCTION = 2  # type of a symbol in an ELF file


@dataclass(frozen=True)
class ProcessorRun:
    """Result of some samples on the simulated processor.

    Attributes:
        outputs: of every sample, in its order.
        least, most: instructions of a step.
        stack: bytes of stack of a step, at most.
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
    import unicorn  # pyright: ignore[reportMissingImports] - an extra of few
    from unicorn import arm_const as arm  # pyright: ignore[reportMissingImports]

    with tempfile.TemporaryDirectory() as folder:
        program = _built(law, Path(folder)).read_bytes()
    machine = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
    machine.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
    size = _loaded(machine, program)
    machine.mem_map(MEMORY, STACK - MEMORY + PAGE)
    machine.mem_map(END, PAGE)
    number = C_TYPES[law.numbers]
    width = ctypes.sizeof(number)
    state, seen = MEMORY, MEMORY + (law.states + law.delay * len(law.outputs)) * width + 64
    seen += -seen % 8
    given = seen + 8 * len(law.inputs)
    count, deepest = [0], [STACK]

    def counted(machine, address, length, user) -> None:
        count[0] += 1
        deepest[0] = min(deepest[0], machine.reg_read(arm.UC_ARM_REG_SP))

    machine.hook_add(unicorn.UC_HOOK_CODE, counted)

    def called(name: str, *arguments: int) -> int:
        count[0] = 0
        for register, value in zip((arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R1, arm.UC_ARM_REG_R2), arguments, strict=False):
            machine.reg_write(register, value)
        machine.reg_write(arm.UC_ARM_REG_SP, STACK)
        machine.reg_write(arm.UC_ARM_REG_LR, END | 1)
        machine.emu_start(_address(program, f"{law.name}_{name}"), END, count=MOST)
        if count[0] >= MOST:
            raise InputError(f"{law.name}_{name} does not end within {MOST} instructions")
        return count[0]

    called("init", state)
    outputs, counts = [], []
    deepest[0] = STACK
    for row in inputs:
        machine.mem_write(seen, bytes((number * len(row))(*row)))
        counts.append(called("step", state, seen, given))
        outputs.append(list((number * len(law.outputs)).from_buffer_copy(machine.mem_read(given, width * len(law.outputs)))))
    return ProcessorRun(outputs, min(counts), max(counts), STACK - deepest[0], size)


def _built(law: ExportedLaw, folder: Path) -> Path:
    """Returns the program: both functions of a law, kept by a table that an endless loop reads."""
    source, p = source_of(law, "0" * 64), law.name
    entry = (
        f'#include "{p}.h"\ntypedef void (*function)(void);\nvolatile const function kept[2] = '
        f"{{(function){p}_init, (function){p}_step}};\nvoid entry(void);\nvoid entry(void) {{ for (;;) {{ (void)kept[0]; }} }}\n"
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
