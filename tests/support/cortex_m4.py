"""Exported code on a simulated Arm Cortex-M4 without floating-point unit: Zig's compiler builds it, unicorn runs it.

Both, and pyelftools, come with the extra `[export-test]`.
"""

import ctypes
import io
import subprocess
import sys
from collections.abc import Sequence
from itertools import chain
from pathlib import Path

from synth.controller.export.c_law import ExportedLaw
from synth.controller.export.c_source import CSource

PACKAGES = ("ziglang", "unicorn", "elftools")
TARGET = "-target thumb-freestanding-eabi -mcpu=cortex_m4+soft_float -fcompiler-rt -O ReleaseFast -fentry=entry"
STATE, INPUTS, OUTPUTS = 0x2000_0000, 0x2001_0000, 0x2006_0000  # addresses of the data
STACK, END, PAGE = 0x2010_0000, 0x0FFF_0000, 0x1000  # where the stack begins, and where a call returns to
C_TYPES = {"double": ctypes.c_double, "float": ctypes.c_float, "int32": ctypes.c_int32, "int16": ctypes.c_int16}


def outputs(law: ExportedLaw, inputs: Sequence[Sequence[float]], folder: Path) -> list[list[float]]:
    """Returns the outputs of a law's code on the processor, for the inputs of each sample.

    Args:
        folder: an empty one, in which the program is built.
    """
    import unicorn  # pyright: ignore[reportMissingImports]
    from elftools.elf.elffile import ELFFile  # pyright: ignore[reportMissingImports]
    from unicorn import arm_const as arm  # pyright: ignore[reportMissingImports]

    core = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
    core.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
    core.mem_map(STATE, STACK - STATE + PAGE)
    core.mem_map(END, PAGE)
    program = ELFFile(io.BytesIO(_built(law, folder).read_bytes()))
    segments = [one for one in program.iter_segments() if one["p_type"] == "PT_LOAD" and one["p_memsz"]]
    pages = {page for one in segments for page in range(one["p_vaddr"] // PAGE, (one["p_vaddr"] + one["p_memsz"]) // PAGE + 1)}
    for page in pages:
        core.mem_map(page * PAGE, PAGE)
    for one in segments:
        core.mem_write(one["p_vaddr"], one.data())

    def call(name: str, *arguments: int) -> None:
        registers = arm.UC_ARM_REG_R0, arm.UC_ARM_REG_R1, arm.UC_ARM_REG_R2, arm.UC_ARM_REG_R3
        for register, value in zip(registers, arguments, strict=False):
            core.reg_write(register, value)
        core.reg_write(arm.UC_ARM_REG_SP, STACK)
        core.reg_write(arm.UC_ARM_REG_LR, END | 1)
        (symbol,) = program.get_section_by_name(".symtab").get_symbol_by_name(f"{law.name}_{name}")
        core.emu_start(symbol["st_value"] | 1, END)  # the lowest bit set: Thumb code

    number, m = C_TYPES[law.numbers], len(law.outputs)
    values = number * (len(inputs) * m)
    core.mem_write(INPUTS, bytes((number * (len(inputs) * len(inputs[0])))(*chain.from_iterable(inputs))))
    call("init", STATE)
    call("steps", STATE, INPUTS, OUTPUTS, len(inputs))
    found = list(values.from_buffer_copy(core.mem_read(OUTPUTS, ctypes.sizeof(values))))
    return [found[i : i + m] for i in range(0, len(found), m)]


def _built(law: ExportedLaw, folder: Path) -> Path:
    """Returns the program: the law's functions, and one that makes many steps."""
    p = law.name
    entry = (
        f'#include "{p}.h"\n'
        f"void {p}_steps({p}_state *state, const {p}_in *in, {p}_out *out, int count);\n"
        f"void {p}_steps({p}_state *state, const {p}_in *in, {p}_out *out, int count)\n"
        f"{{\n    for (int i = 0; i < count; i++) {p}_step(state, in + i, out + i);\n}}\n"
        "typedef void (*function)(void);\nvolatile const function kept[2] = "  # else the linker leaves them out
        f"{{(function){p}_init, (function){p}_steps}};\n"
        "void entry(void);\nvoid entry(void) { for (;;) { (void)kept[0]; } }\n"
    )
    for name, text in {**CSource(law, "0" * 64).files, "entry.c": entry}.items():
        (folder / name).write_text(text)
    flags = ["-femit-bin=program.elf", "-cflags", "-std=c99", "-ffp-contract=off", "--", f"{p}.c", "entry.c"]
    subprocess.run([sys.executable, "-m", "ziglang", "build-exe", *TARGET.split(), *flags], cwd=folder, check=True)
    return folder / "program.elf"
