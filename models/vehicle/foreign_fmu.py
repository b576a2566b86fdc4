"""Somebody else's FMU (FMI 2.0, co-simulation) as a controller, in a process of its own, which may crash or never answer.

A vehicle file names it as `fmu = "their.fmu"`. Its inputs are what is measured, by name, in the same units; its outputs are the
control forces. Its step from a sample to the next gives the forces that are held meanwhile.
"""

import hashlib
import json
import platform
import queue
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import weakref
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Any
from xml.etree import ElementTree

from models.common.errors import InputError, listing, quoted
from models.common.files import MIB, read_bytes
from models.kinds import signals
from models.laws.python_runtime import Sample

PROCESS = Path(__file__).with_name("fmu_process.py")
LONGEST = 5.0  # s, limit of a step; below the limit of a law's call, so that this line is said
LONGEST_START = 8.0  # s, limit of loading and initialization, which are within the first call
MOST_INSIDE, MOST_FILES, MOST_XML = 512 * MIB, 10_000, 16 * MIB  # unpacked
FORCE = signals.CONTROL_FORCE
CORNERS = ("", "front", "rear", "front_left", "front_right", "rear_left", "rear_right")
GIVE = "give an FMU of FMI 2.0 for co-simulation"
TOOL = "Roadproof"  # whose FMUs have the delay of their computer in them, and say so in an annotation
DAMAGED = (zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, EOFError, OSError)


@dataclass(frozen=True)
class Variable:
    """Scalar variable of an FMU: its value reference, and its unit, or empty."""

    reference: int
    unit: str


@dataclass(frozen=True)
class Description:
    """modelDescription.xml, as far as it is needed.

    Attributes:
        guid: its token.
        identifier: name of its library.
        inputs, outputs: Real variables by name.
        delay: samples by which its outputs are late, as Roadproof's export notes them; 0 for FMUs of other tools.
    """

    guid: str
    identifier: str
    inputs: dict[str, Variable]
    outputs: dict[str, Variable]
    delay: int


def law_of(file: str, sha256: str) -> Callable[[Sample, "ForeignFmu | None"], Any]:
    """Returns a law in Python that steps an FMU.

    Args:
        file: its path.
        sha256: checksum that it must have.
    """

    def step(sample: Sample, state: "ForeignFmu | None") -> Any:
        one = ForeignFmu(Path(file), sha256, [*sample.measured]) if state is None else state
        return one.step(sample.time, sample.period, sample.y.tolist()), one

    return step


class ForeignFmu:
    """An instance of an FMU in a process of its own, which ends with it."""

    def __init__(self, file: Path, sha256: str, measured: Sequence[str]) -> None:
        """Unpacks and starts it.

        Raises:
            InputError: it is no such FMU, it is damaged or hostile, or its inputs are not what is measured.
        """
        content = read_bytes(file, "FMU", GIVE)
        if hashlib.sha256(content).hexdigest() != sha256:
            raise InputError("the FMU has changed since the vehicle file was read")
        folder = tempfile.mkdtemp(prefix="fmu")
        self._end = weakref.finalize(self, _ended, None, folder)
        description, library = unpacked(file, Path(folder))
        inputs, outputs = _matched(description, measured)
        process = subprocess.Popen(
            [sys.executable, "-I", str(PROCESS)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert process.stdin is not None, "it is a pipe"
        assert process.stdout is not None, "it is a pipe"
        self._end.detach()
        self._end = weakref.finalize(self, _ended, process, folder)
        self._process, self._write, self._answers = process, process.stdin, queue.Queue[str]()
        threading.Thread(target=_read, args=(process.stdout, self._answers), daemon=True, name="roadproof-fmu").start()
        resources = (Path(folder) / "resources").as_uri()
        about = {"library": str(library), "guid": description.guid, "resources": resources, "inputs": inputs, "outputs": outputs}
        self._ask(about, LONGEST_START, "the start")

    def step(self, time: float, period: float, seen: Sequence[float]) -> list[float]:
        """Returns the forces of a sample [N].

        Raises:
            InputError: the step is refused, takes too long, or ends the process.
        """
        return self._ask({"time": time, "period": period, "inputs": list(seen)}, LONGEST, "the step")

    def _ask(self, asked: dict[str, Any], longest: float, what: str) -> list[float]:
        try:
            self._write.write(json.dumps(asked) + "\n")
            self._write.flush()
            line = self._answers.get(timeout=longest)
        except queue.Empty:
            self._end()
            raise InputError(f"{what} took longer than {longest:g} s") from None
        except OSError:
            line = ""
        if not line:
            code = self._process.wait(LONGEST)
            raise InputError(f"{what} ended the process of the FMU ({f'signal {-code}' if code < 0 else f'exit code {code}'})")
        answer = json.loads(line)
        if "error" in answer:
            raise InputError(f"{what} failed: {answer['error']}")
        return answer["outputs"]


def _read(stream: IO[str], into: "queue.Queue[str]") -> None:
    for line in stream:
        into.put(line)
    into.put("")


def _ended(process: "subprocess.Popen[str] | None", folder: str) -> None:
    """Ends a process, and removes what was unpacked for it."""
    if process is not None:
        process.kill()
        process.wait(LONGEST)
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                try:
                    pipe.close()
                except OSError:
                    continue
    shutil.rmtree(folder, ignore_errors=True)


def unpacked(file: Path, folder: Path) -> tuple[Description, Path]:
    """Unpacks an FMU, and returns its description and the path of its library.

    Raises:
        InputError: it is no FMU, damaged, too large, has names that lead out of its folder, or no binary for this machine.
    """
    try:
        with zipfile.ZipFile(file) as archive:
            description, names = _described(archive), set(archive.namelist())
            suffix = {"windows": ".dll", "darwin": ".dylib"}.get(platform.system().lower(), ".so")
            own = f"binaries/{_platform()}/{description.identifier}{suffix}"
            if own not in names:
                there = sorted({name.split("/")[1] for name in names if re.fullmatch(r"binaries/[^/]+/.+", name)})
                raise InputError(
                    f"the FMU has binaries for {listing(there) if there else 'no platform'}, and none for {_platform()}; "
                    f"export it for {_platform()}"
                )
            archive.extractall(folder, [name for name in names if name.startswith(("binaries/", "resources/"))])
    except DAMAGED as error:
        raise InputError(f"the file is not an FMU, or is damaged ({error}); {GIVE}") from error
    (folder / "resources").mkdir(exist_ok=True)
    return description, folder / own


def own_delay(file: Path) -> int:
    """Returns the delay of an FMU's own outputs [samples]; 0 for a file that is not a valid FMU, whose first step is refused."""
    try:
        with zipfile.ZipFile(file) as archive:
            return _described(archive).delay
    except (InputError, *DAMAGED):
        return 0


def _described(archive: zipfile.ZipFile) -> Description:
    _check_entries(archive.infolist())
    if "modelDescription.xml" not in archive.namelist():
        raise InputError(f"the file has no modelDescription.xml; {GIVE}")
    return read_description(archive.read("modelDescription.xml"))


def _check_entries(entries: Sequence[zipfile.ZipInfo]) -> None:
    for one in entries:
        parts = PurePosixPath(one.filename).parts
        if ".." in parts or one.filename.startswith("/") or "\\" in one.orig_filename or ":" in one.filename:
            raise InputError(f"the name of its file {quoted(one.orig_filename)} leads out of its folder; {GIVE}")
        if one.external_attr >> 28 == 0xA:
            raise InputError(f"it contains a link, {quoted(one.filename)}; {GIVE} without links")
    if len(entries) > MOST_FILES or sum(one.file_size for one in entries) > MOST_INSIDE:
        raise InputError(f"it unpacks to more than {MOST_FILES} files or {MOST_INSIDE // MIB} MiB; export it with less inside")


def read_description(content: bytes) -> Description:
    """Returns what modelDescription.xml says.

    Raises:
        InputError: it is no description of FMI 2.0 for co-simulation that runs by itself.
    """
    if len(content) > MOST_XML or b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise InputError(f"its modelDescription.xml is too large, or defines entities; {GIVE}")
    try:
        root = ElementTree.fromstring(content)
        if root.get("fmiVersion") != "2.0":
            raise InputError(f"its version is FMI {quoted(root.get('fmiVersion'))}; {GIVE}")
        kind = root.find("CoSimulation")
        if kind is None:
            raise InputError(f"it is for model exchange only; {GIVE}")
        if kind.get("needsExecutionTool") in ("true", "1"):
            raise InputError("it needs the program that exported it; export it so that it runs without that program")
        identifier = kind.get("modelIdentifier", "")
        if not re.fullmatch(r"\w+", identifier):
            raise InputError(f"its modelIdentifier, {quoted(identifier)}, is not a name in C; {GIVE}")
        found: dict[str, dict[str, Variable]] = {"input": {}, "output": {}}
        for one in root.iter("ScalarVariable"):
            real, causality = one.find("Real"), one.get("causality")
            if causality in found and real is None:
                raise InputError(f"its {causality} {one.get('name')!r} is not of type Real; export its signals as Real")
            if causality in found and real is not None:
                found[causality][one.attrib["name"]] = Variable(int(one.attrib["valueReference"]), real.get("unit", ""))
        computer = root.find(f"VendorAnnotations/Tool[@name='{TOOL}']/Implementation")
        delay = 0 if computer is None else int(computer.attrib["delay"])
        return Description(root.attrib["guid"], identifier, found["input"], found["output"], delay)
    except (ElementTree.ParseError, KeyError, ValueError, LookupError) as error:
        raise InputError(f"its modelDescription.xml is damaged ({error}); {GIVE}") from error


def _matched(description: Description, measured: Sequence[str]) -> tuple[list[int], list[int]]:
    """Returns the value references of what is measured, and of the forces in the order of the corners.

    Raises:
        InputError: an input is not measured, or the other way round, a unit is another, or there are no forces.
    """
    if {*description.inputs} != {*measured}:
        raise InputError(
            f"its inputs are {listing(sorted(description.inputs)) or 'none'}, and the controller measures {listing(measured)}; "
            "list the inputs in `measured`"
        )
    named = {(f"{FORCE.name}_{corner}" if corner else FORCE.name): corner for corner in CORNERS}
    forces = [name for name in named if name in description.outputs]
    if not forces:
        outputs = listing(sorted(description.outputs)) or "none"
        raise InputError(f"its outputs are {outputs}; name its forces {FORCE.name}, or {FORCE.name}_CORNER")
    for name, one in {**description.inputs, **{name: description.outputs[name] for name in forces}}.items():
        unit = _unit(name)
        if unit and one.unit and _plain(one.unit) != unit:
            raise InputError(f"the unit of its {name} is {quoted(one.unit)}; export it in {unit}")
    return [description.inputs[name].reference for name in measured], [description.outputs[name].reference for name in forces]


def _unit(name: str) -> str:
    """Returns the unit of a signal by its name, or empty for a name that only its vehicle knows."""
    known = {one.name: one.unit for one in vars(signals).values() if isinstance(one, signals.Signal)}
    fitting = [one for one in known if name == one or name.startswith(f"{one}_")]
    return known[max(fitting, key=len)] if fitting else ""


def _plain(unit: str) -> str:
    """Returns a unit in the spelling of signals."""
    plain = unit.replace("²", "2").replace("**", "").replace("^", "").replace("*", " ").replace(".", " ")
    return {"m s-1": "m/s", "m s-2": "m/s2", "rad s-1": "rad/s", "rad s-2": "rad/s2"}.get(plain, plain)


def _platform() -> str:
    system, wide = platform.system().lower(), sys.maxsize > 2**32
    return {"windows": "win", "darwin": "darwin"}.get(system, system) + ("64" if wide else "32")
