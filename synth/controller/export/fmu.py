"""FMUs (FMI 2.0 and 3.0): zip files with description, sources, documentation and binaries, reproducible byte for byte."""

import hashlib
import html
import importlib.util
import io
import platform
import re
import struct
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from synth.controller.export.c_source import FLAGS
from synth.controller.export.compiled import own_compiler
from synth.controller.export.fmu_description import build_description, description
from synth.controller.export.fmu_model import FmuModel

HERE = Path(__file__).parent / "fmi"
ZIG = "ziglang"
NAMES_OF_FMI_2 = {
    "^Instance": "Component",
    "Float64": "Real",
    "FMUState": "FMUstate",
    "^Deserialize": "DeSerialize",
    "ContinuousStateDerivatives": "Derivatives",
}  # each key is a name in FMI 3, and its value is the name in FMI 2
# Names of Zig's compilation targets, by version of FMI and by the folder of the binary. In FMI 2, a single binary for the Mac
# serves both types of processors.
TARGETS = {
    2: {
        "linux64": ("x86_64-linux-gnu.2.17",),
        "win64": ("x86_64-windows-gnu",),
        "darwin64": ("x86_64-macos", "aarch64-macos"),
    },
    3: {
        "x86_64-linux": ("x86_64-linux-gnu.2.17",),
        "aarch64-linux": ("aarch64-linux-gnu.2.17",),
        "x86_64-windows": ("x86_64-windows-gnu",),
        "x86_64-darwin": ("x86_64-macos",),
        "aarch64-darwin": ("aarch64-macos",),
    },
}
# numbers that denote the type and the subtype of the processor in a Mach-O file
PROCESSORS = {"x86_64-macos": (0x0100_0007, 3), "aarch64-macos": (0x0100_000C, 0)}
# number at the start of a Mach-O file for several processors, whose parts are aligned to 2**14 bytes
FAT, ALIGNED = 0xCAFE_BABE, 14
LIBRARY = "-shared -fPIC -fvisibility=hidden"
PAGE = "<!DOCTYPE html>\n<html><head><title>{title}</title></head><body><pre>{about}</pre></body></html>\n"
EPOCH = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class Fmu:
    """FMU as it is written to a file.

    Attributes:
        content: bytes of the file.
        token: GUID (FMI 2) or instantiation token (FMI 3).
        platforms: folders of the binaries in the FMU.
        missing: reason why the file contains no binaries for some platforms; empty if no platform is missing.
    """

    content: bytes
    token: str
    platforms: tuple[str, ...]
    missing: str


def fmu(model: FmuModel, version: int, resources: Mapping[str, str], about: str) -> Fmu:
    """Returns the FMU of a model, with binaries for every platform for which a compiler is available.

    Args:
        model: content of the FMU.
        version: version of FMI, 2 or 3.
        resources: texts of additional files in the FMU, by file name.
        about: documentation of the FMU as plain text.
    """
    parts = ["fmu.h", *(["linear.c"] if "linear.c" in model.sources else [])]
    sources = {**model.sources, **{name: (HERE / name).read_text(encoding="utf-8") for name in parts}}
    sources[f"fmi{version}.c"] = functions_of(version)
    compiled = sorted(name for name in sources if name.endswith(".c"))
    page = PAGE.format(title=html.escape(model.title), about=html.escape(about))
    texts = {f"sources/{name}": text for name, text in sources.items()}
    texts |= {f"resources/{name}": text for name, text in resources.items()} | {"documentation/index.html": page}
    texts |= {"sources/buildDescription.xml": build_description(model, compiled)} if version == 3 else {}
    blank = description(model, version, "", compiled)
    digest = hashlib.sha256("".join(f"{name}\0{texts[name]}\0" for name in sorted(texts)).encode() + blank.encode()).hexdigest()
    token = "{" + "-".join(digest[a:b] for a, b in ((0, 8), (8, 12), (12, 16), (16, 20), (20, 32))) + "}"
    texts["sources/fmu_model.h"] = texts["sources/fmu_model.h"].replace("@TOKEN@", token)
    texts["modelDescription.xml"] = description(model, version, token, compiled)
    own = {name.removeprefix("sources/"): text for name, text in texts.items() if name.startswith("sources/")}
    binaries, missing = _binaries(own, compiled, version)
    files = {name: text.encode() for name, text in texts.items()}
    for folder, content in binaries.items():
        suffix = ".dylib" if "darwin" in folder else ".dll" if "win" in folder else ".so"
        files[f"binaries/{folder}/{model.identifier}{suffix}"] = content
    return Fmu(zip_files(files), token, tuple(binaries), missing)


def functions_of(version: int) -> str:
    """Returns the C source of all functions of a version of FMI. The template uses the function names of FMI 3, which are
    replaced if the version is 2.
    """

    def named(found: re.Match[str]) -> str:
        name = found[1]
        if version == 2:
            for new, old in NAMES_OF_FMI_2.items():
                name = re.sub(new, old, name)
        return f"fmi{version}{name}"

    return re.sub(r"\bN\b", str(version), re.sub(r"fmiN(\w+)", named, (HERE / "fmi.c").read_text(encoding="utf-8")))


def zip_files(files: Mapping[str, bytes]) -> bytes:
    """Returns the bytes of a zip file. The bytes depend only on the names and contents of the files."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, EPOCH)
            entry.compress_type, entry.create_system, entry.external_attr = zipfile.ZIP_DEFLATED, 3, 0o644 << 16
            archive.writestr(entry, files[name])
    return whole.getvalue()


def _binaries(sources: Mapping[str, str], compiled: Sequence[str], version: int) -> tuple[dict[str, bytes], str]:
    """Returns the bytes of the binaries by folder, and a text that lists the platforms for which no binary could be built."""
    with tempfile.TemporaryDirectory(prefix="fmu") as folder:
        place = Path(folder)
        for name, text in sources.items():
            (place / name).write_text(text, encoding="utf-8", newline="\n")
        if importlib.util.find_spec(ZIG) is not None:
            zig = [sys.executable, "-m", ZIG, "cc"]
            built = {
                folder: [_build_library([*zig, "-target", target, "-s"], place, compiled, target) for target in targets]
                for folder, targets in TARGETS[version].items()
            }
            return {folder: _universal(TARGETS[version][folder], parts) for folder, parts in built.items()}, ""
        compiler, host = own_compiler(), _host(version)
        if compiler is None or host is None:
            return {}, "no binaries, as there is no C compiler; install the extra [export] to build for Linux, Windows and macOS"
        only = {host: _build_library([compiler, "-s"], place, compiled, host)}
        return only, f"a binary for {host} only; install the extra [export] to build for Linux, Windows and macOS"


def _host(version: int) -> str | None:
    """Returns the name of the folder for binaries of this machine; None if FMI defines no name for this type of machine."""
    system, processor = (
        platform.system().lower(),
        platform.machine().lower().replace("amd64", "x86_64").replace("arm64", "aarch64"),
    )
    if version == 3:
        return f"{processor}-{system}" if f"{processor}-{system}" in TARGETS[3] else None
    return {"linux": "linux64", "darwin": "darwin64"}.get(system) if processor == "x86_64" or system == "darwin" else None


def _build_library(compiler: Sequence[str], place: Path, compiled: Sequence[str], name: str) -> bytes:
    """Compiles the sources in a folder, and returns the bytes of the shared library."""
    library = place / f"{name}.library"
    command = [*compiler, *FLAGS.split(), *LIBRARY.split(), *compiled, "-o", library.name]
    if "windows" in name:
        command.remove("-fPIC")
    ran = subprocess.run(command, cwd=place, capture_output=True, text=True, check=False)
    if ran.returncode:
        raise RuntimeError(f"the compiler rejects the sources of an FMU for {name}: {ran.stderr[:500]}")
    return library.read_bytes()


def _universal(targets: Sequence[str], parts: Sequence[bytes]) -> bytes:
    """Returns a Mach-O file that contains the library once for each type of processor. If there is only one library, this
    library is returned unchanged.
    """
    if len(parts) == 1:
        return parts[0]
    whole = bytearray(struct.pack(">II", FAT, len(parts)))
    at = 1 << ALIGNED
    for target, part in zip(targets, parts, strict=True):
        whole += struct.pack(">5I", *PROCESSORS[target], at, len(part), ALIGNED)
        at += -(-len(part) // (1 << ALIGNED)) << ALIGNED
    for part in parts:
        whole += bytes(-len(whole) % (1 << ALIGNED)) + part
    return bytes(whole)
