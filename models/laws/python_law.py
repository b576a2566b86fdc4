"""Controllers in the user's Python code: `law = "my_law.py:step"` in `[controllers.NAME]`, or a function passed to `sim.run`.

The module reads the code of a Python law but does not execute it. Linear analysis does not apply to Python laws. The files of
Python laws must be in the folder of the vehicle file, or in a folder below it. A log, a result, or a vehicle file that is
passed as text cannot refer to the file of a law.
"""

import hashlib
import inspect
import os
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal
from xml.etree import ElementTree

from models.common.checks import AT_LEAST_ONE, check
from models.common.errors import InputError, alike, error_in, list_names, short_repr
from models.common.files import origin, read_bytes, read_text
from models.common.schema import HERE, SI, TEXT, ReadBy, Section
from models.laws.law import ControlLaw, Design, DriverKey, LawSource

LAW = re.compile(r"(?P<file>[^:\\\x00-\x1f\x7f-\x9f\u2028\u2029]+\.(?i:py)):(?P<function>[^\W\d]\w*)")
FMU = re.compile(r"(?P<file>[^:\\\x00-\x1f\x7f-\x9f\u2028\u2029]+\.(?i:fmu))")
GIVE = 'give a file next to the vehicle file and a function in this file, as in law = "my_law.py:step"'
GIVE_FMU = 'give a file next to the vehicle file, as in fmu = "their.fmu"'
AHEAD = SI("s", "time for which a law in Python or a preview design knows the road ahead", 0.0, 60.0)
TOOL = "Roadproof"  # name of the tool in FMUs that Roadproof exports; an annotation of the FMU gives the delay of the outputs


@dataclass(frozen=True)
class PythonLaw(LawSource):
    """Reference to a Python law or an FMU, as in a vehicle file.

    Attributes:
        law: `FILE.py:FUNCTION`, or `FILE.fmu`.
        preview: time for which the law knows the road ahead [s]; None if the law does not receive the road.
        folder: folder of the vehicle file; None for a vehicle file that is passed as text, whose Python laws and FMUs cannot
            run.
        inputs: signal that each input variable of an FMU receives; variables whose name is the name of a signal are omitted.
        outputs: force that each output variable of an FMU gives; variables whose name is the name of a signal are omitted.
    """

    linear = False
    given = request = None

    law: str
    preview: float | None = None
    folder: Path | None = None
    inputs: Mapping[str, str] = field(default_factory=dict)
    outputs: Mapping[str, str] = field(default_factory=dict)

    @property
    def file(self) -> str:
        """Path of the law's file relative to the folder of the vehicle file."""
        return self.law if self.is_fmu else self.law.rpartition(":")[0]

    @property
    def is_fmu(self) -> bool:
        """True if the law is an FMU."""
        return FMU.fullmatch(self.law) is not None

    @property
    def kind(self) -> str:
        """Type of the law: "FMU" or "law in Python"."""
        return "FMU" if self.is_fmu else "law in Python"

    @property
    def with_article(self) -> str:
        """Type of the law with an article, such as "an FMU"."""
        return f"{'an' if self.is_fmu else 'a'} {self.kind}"

    @property
    def title(self) -> str:
        """See `LawSource`."""
        return f"{self.with_article}, {self.law}"

    @property
    def function(self) -> str:
        """Name of the function that is called at each sample."""
        return "step" if self.is_fmu else self.law.rpartition(":")[2]

    @property
    def record(self) -> dict[str, Any]:
        """The law as keys of JSON and TOML."""
        names = {key: dict(value) for key, value in (("inputs", self.inputs), ("outputs", self.outputs)) if value}
        preview = {"preview": self.preview} if self.preview is not None else {}
        return {"fmu" if self.is_fmu else "law": self.law} | preview | names

    @property
    def path(self) -> Path | None:
        """Path of the law's file; None for a vehicle file that is passed as text."""
        return None if self.folder is None else self.folder / self.file

    def record_from(self, folder: Path) -> dict[str, Any]:
        """See `LawSource`."""
        if self.path is None:
            return {}
        place = os.path.relpath(os.path.realpath(self.path), os.path.realpath(folder))
        if place.startswith(os.pardir):
            raise InputError(
                f"the file of the law {self.law} is outside the folder {folder}, in which the vehicle file is saved; "
                "move the file of the law into this folder"
            )
        return {"fmu": Path(place).as_posix()} if self.is_fmu else {"law": f"{Path(place).as_posix()}:{self.function}"}

    def driver(
        self, name: str, measured: tuple[str, ...], design: Design[Any], read: Callable[[], str] | None = None
    ) -> "PythonController":
        """See `LawSource`."""
        with error_in(f"controller {name!r}:"):
            return PythonController(name, measured, self, (read or self.source)())

    def source(self) -> str:
        """Returns the text of the law's file without executing it.

        For an FMU, the text is Python code that simulates the FMU step by step, and that contains the checksum of the FMU.

        Raises:
            InputError: the file does not exist, is too large, or is not text.
        """
        path = self.path
        if path is None:
            raise InputError(
                f"law {self.law}: the code of this law is not available, because the vehicle was read from text; read "
                "the vehicle from a file instead"
            )
        if self.is_fmu:
            content = read_bytes(path, "FMU", GIVE_FMU)
            digest, names = hashlib.sha256(content).hexdigest(), {**self.inputs, **self.outputs}
            steps = f'from models.vehicle.foreign_fmu import law_of\n\nstep = law_of(__file__, "{digest}", {names!r})\n'
            return f"{origin(self.law, content)}\n{steps}"
        return read_text(path, "law", GIVE)


@dataclass(frozen=True, eq=False)
class PythonController(ControlLaw):
    """Controller with a Python law, and the text of this law, which is executed. Linear analysis does not apply to a controller
    with a Python law.

    Attributes:
        name: name of the controller in the vehicle file.
        measured: names of the q measured signals y.
        law: reference to the law, as in the vehicle file.
        source: text of the law's file, or of the function if Python can find the text of the function.
        function: the function or `sim.Driver` of the caller, which runs in the caller's process; None for a law in a file.
    """

    linear: ClassVar[Literal[False]] = False
    user_code: ClassVar[Literal[True]] = True

    name: str
    measured: tuple[str, ...]
    law: PythonLaw
    source: str = field(repr=False)
    function: Any = None

    @property
    def law_key(self) -> DriverKey:
        """See `ControlLaw`."""
        return ("python", id(self))

    @property
    def kind(self) -> str:
        """Type of the law with an article: "a law in Python" or "an FMU"."""
        return self.law.with_article

    serial = True

    @property
    def own_delay(self) -> float:
        """See `ControlLaw`. Only FMUs that Roadproof exported have a delay."""
        if not self.law.is_fmu or self.law.path is None:
            return 0
        from zipfile import BadZipFile, ZipFile

        with suppress(OSError, KeyError, BadZipFile, ElementTree.ParseError), ZipFile(self.law.path) as archive:
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
            if root.get("generationTool") == TOOL and (computer := root.find(".//Implementation[@delay]")) is not None:
                return int(computer.attrib["delay"])
        return 0  # the first step reports an error if the file is not an FMU

    def preview_samples(self, period: float) -> int:
        """See `ControlLaw`."""
        if is_driver(self.function):
            return int(getattr(self.function, "ahead", 0))
        return 0 if self.law.preview is None else samples_ahead(self.law.preview, period)

    @property
    def sha256(self) -> str:
        """Checksum of the text of the law."""
        return sha256(self.source)

    @property
    def text(self) -> str:
        """The law as one line of text."""
        preview = self.law.preview
        ahead = "" if preview is None else f", with {preview:g} s of road preview"
        known = f"; SHA-256 of its {'source' if self.function else 'file'} {self.sha256[:16]}..." if self.source else ""
        return f"{self.law.kind} {self.law.law}{ahead}{known}"

    @property
    def record(self) -> dict[str, Any]:
        """Name, signals and law of the controller as keys of JSON."""
        return {"name": self.name, "measured": list(self.measured), **self.law.record, "sha256": self.sha256}


def is_driver(given: object) -> bool:
    """Returns True for an object with the methods of `sim.Driver`."""
    return callable(getattr(given, "start", None)) and callable(getattr(given, "step", None))


def of_function(function: Any, measurable: Sequence[str]) -> PythonController:
    """Returns the controller whose forces a Python function or driver computes.

    The function may have the attributes `measured` and `preview` [s], which have the same meaning as in a vehicle file.

    Args:
        function: function or driver of the caller, which computes the forces.
        measurable: names of the signals that a controller can measure. A function without an attribute `measured` receives all
            signals that a controller can measure.

    Raises:
        InputError: an attribute of the function is not allowed.
    """
    # A function that was defined as a lambda has the name "<lambda>"
    name = getattr(function, "__name__", type(function).__name__).strip("<>")
    preview, signals = getattr(function, "preview", None), getattr(function, "measured", measurable)
    measured: tuple[str, ...] = check(f"{name}.measured", signals, Annotated[tuple[str, ...], AT_LEAST_ONE])
    for signal in measured:
        if signal not in measurable:
            raise InputError(
                f"{name}.measured: unknown signal {short_repr(signal)}; measurable signals are {alike(signal, measurable)}"
            )
    try:
        source = inspect.getsource(function)
    except (OSError, TypeError):  # the function was typed at a prompt, or it is an object
        source = ""
    ahead = None if preview is None else AHEAD.number(f"{name} preview", preview)
    return PythonController(name, measured, PythonLaw(name, ahead), source, function)


def sha256(text: str) -> str:
    """Returns the SHA-256 checksum of the text of a law, encoded in UTF-8."""
    return hashlib.sha256(text.encode()).hexdigest()


def _beside(pattern: re.Pattern[str], expected: str, value: Any, context: Mapping[str, Any]) -> str:
    """Returns the text of a file, which must be in the folder of the vehicle file or in a folder below it. Opens no
    file.
    """
    match = pattern.fullmatch(value) if isinstance(value, str) else None
    if match is None or Path(match["file"]).is_absolute() or value.startswith("~") or ".." in Path(match["file"]).parts:
        raise InputError(f"{HERE} = {short_repr(value)} is not {expected}")
    return value


def _variables(value: Any, context: Mapping[str, Any]) -> dict[str, str]:
    """Returns the signals by the names of the FMU variables that correspond to them."""
    if not isinstance(value, Mapping) or not all(isinstance(signal, str) for signal in value.values()):
        example = '{ In1 = "suspension_deflection" } for inputs, or { Out1 = "control_force" } for outputs'
        raise InputError(f"{HERE} = {short_repr(value)} is not allowed; give a signal for each variable, as in {example}")
    return {str(name): signal for name, signal in value.items()}


@dataclass(frozen=True, kw_only=True)
class ProgramSection(Section):
    """Keys of a controller's section that contains a Python law or an FMU."""

    law: (
        Annotated[
            str,
            ReadBy("law in Python, `FILE.py:NAME`", partial(_beside, LAW, f"a law in Python; {GIVE}"), allowed=TEXT),
        ]
        | None
    ) = None
    preview: Annotated[float, AHEAD] | None = None
    fmu: Annotated[str, ReadBy("FMU that is a law", partial(_beside, FMU, f"an FMU; {GIVE_FMU}"), allowed=TEXT)] | None = None
    inputs: Annotated[Mapping[str, str], ReadBy("signals by the names of an FMU's inputs", _variables)] | None = None
    outputs: Annotated[Mapping[str, str], ReadBy("forces by the names of an FMU's outputs", _variables)] | None = None

    def __post_init__(self) -> None:
        if self.fmu is not None and (others := [key for key in ("law", "preview") if getattr(self, key) is not None]):
            raise InputError(
                f"has both fmu and {list_names(others)}, but an FMU is already a complete law and cannot use preview; "
                f"omit fmu or {list_names(others)}"
            )
        if self.fmu is None and (named := [key for key in ("inputs", "outputs") if getattr(self, key) is not None]):
            raise InputError(
                f"{named[0]} describes variables of an FMU, but the section names no FMU; give the FMU as fmu, or omit {named[0]}"
            )

    def program(self, folder: Path | None) -> PythonLaw | None:
        """Returns the Python law or the FMU; None for a section with a different type of law. Opens no file.

        Args:
            folder: folder of the vehicle file; None for a vehicle file that is passed as text.
        """
        law = self.law or self.fmu
        return None if law is None else PythonLaw(law, self.preview, folder, self.inputs or {}, self.outputs or {})


def samples_ahead(preview: float, period: float) -> int:
    """Returns how many samples a preview time [s] contains, including the present sample."""
    return int(preview / period * (1 + 1e-9)) + 1
