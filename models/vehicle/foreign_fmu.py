"""FMUs of other tools (FMI 2 and 3, co-simulation) as controllers. FMPy runs each FMU in a child process.

A vehicle file names an FMU with `fmu = "their.fmu"`. The inputs of the FMU have the names and units of the measured signals,
and the outputs of the FMU are the control forces. If an FMU uses names that are not signal names, the keys `inputs = { In1 =
"suspension_deflection" }` and `outputs` assign signals to these names. At each sample, the FMU advances by one step, to the
time of the next sample. The outputs of the step are the control forces, which are held until the next sample.
"""

import hashlib
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from models.common.errors import InputError, list_names, short_repr
from models.kinds import signals
from models.laws.python_runtime import Sample

FORCE = signals.CONTROL_FORCE.name
KNOWN_SIGNALS = [one for one in vars(signals).values() if isinstance(one, signals.Signal)]
CORNERS = ("front", "rear", "left", "right", "front_left", "front_right", "rear_left", "rear_right")
GIVE = "give an FMU of FMI 2 or 3 for co-simulation"


def law_of(file: str, sha256: str, names: Mapping[str, str]) -> Callable[[Sample, "ForeignFmu | None"], Any]:
    """Returns a Python law that advances an FMU by one step at every sample.

    Args:
        file: path of the FMU.
        sha256: SHA-256 checksum that the file of the FMU must have.
        names: name of the signal for each variable of the FMU that does not have the name of a signal.
    """

    def step(sample: Sample, state: "ForeignFmu | None") -> Any:
        fmu = ForeignFmu(Path(file), sha256, sample, names) if state is None else state
        return fmu.step(sample), fmu

    return step


class ForeignFmu:
    """Instance of an FMU. When this object is deleted, the FMU is terminated."""

    def __init__(self, file: Path, sha256: str, sample: Sample, names: Mapping[str, str]) -> None:
        """Starts the FMU and initialises it with the first sample of the measured signals.

        Raises:
            InputError: FMPy is not installed, or the FMU cannot be read, does not fit the measured signals, or fails.
        """
        if find_spec("fmpy") is None:
            raise InputError("an FMU needs FMPy; run pip install 'roadproof[fmi]'")
        if hashlib.sha256(file.read_bytes()).hexdigest() != sha256:
            raise InputError("the FMU has changed since the vehicle file was read; run the command again")
        import fmpy  # pyright: ignore[reportMissingImports] - an extra

        self._folder = TemporaryDirectory(prefix="fmu", ignore_cleanup_errors=True)
        with self._errors(f"; {GIVE}"):
            description = fmpy.read_model_description(str(file))
            fmpy.extract(str(file), self._folder.name)
        self._inputs, self._forces = _variables(description, sample.measured, names)
        old, platforms = description.fmiMajorVersion == 2, [path.name for path in Path(self._folder.name, "binaries").glob("*")]
        needed = fmpy.platform if old else fmpy.platform_tuple
        if needed not in platforms:
            raise InputError(
                f"the FMU has binaries for {list_names(platforms)}, but not for {needed}; export the FMU for {needed}"
            )
        with self._errors():
            fmu: Any = fmpy.instantiate_fmu(self._folder.name, description, "CoSimulation", logger=_log)
            self._fmu, self._end = fmu, weakref.finalize(self, _end, fmu)
            if old:
                fmu.setupExperiment()
            fmu.enterInitializationMode()
            self._set_inputs(sample)
            fmu.exitInitializationMode()

    def step(self, sample: Sample) -> list[float]:
        """Returns the control forces for a sample of the measured signals [N].

        Raises:
            InputError: the FMU fails or ends the simulation.
        """
        with self._errors():
            self._set_inputs(sample)
            result = self._fmu.doStep(sample.time, sample.period)
            if result and result[1]:  # with this value, an FMU of FMI 3 reports that it has ended the simulation
                raise InputError("the FMU ended the simulation early; correct the FMU")
            return [getattr(self._fmu, f"get{one.type}")([one.valueReference])[0] for one in self._forces]

    def _set_inputs(self, sample: Sample) -> None:
        for one, value in zip(self._inputs, sample.y.tolist(), strict=True):
            getattr(self._fmu, f"set{one.type}")([one.valueReference], [value])

    @contextmanager
    def _errors(self, give: str = "") -> Iterator[None]:
        """Turns any error of FMPy or of the FMU into an InputError."""
        _messages.clear()
        try:
            yield
        except Exception as error:  # FMPy may raise many types of errors
            if hasattr(self, "_end"):
                self._end.detach()  # an FMU that has failed must not be terminated
            raise InputError(": ".join([str(error).rstrip("."), *_messages[-1:]]) + give) from error


# Error messages of the current call. FMPy sends the messages of all FMU instances to the logger of the last instance
_messages: list[str] = []


def _log(*arguments: Any) -> None:
    status, _, text = arguments[-3:]  # in FMI 2 and in FMI 3, these are the last three arguments
    if status > 1:
        _messages.append(text.decode(errors="replace"))


def _end(fmu: Any) -> None:
    with suppress(Exception):
        fmu.terminate()
        fmu.freeInstance()


def _variables(description: Any, measured: Sequence[str], names: Mapping[str, str]) -> tuple[list[Any], list[Any]]:
    """Returns the FMU's variables for the measured signals, and those for the control forces in the order of the corners.

    Raises:
        InputError: the FMU is not for co-simulation, or its inputs, outputs or units do not match the controller.
    """
    if description.fmiMajorVersion == 1 or description.coSimulation is None:
        raise InputError(
            f"the FMU uses FMI {description.fmiVersion}{'' if description.coSimulation else ', no co-simulation'}; {GIVE}"
        )
    # Only real variables are used; variables of other types keep their start values
    real = [one for one in description.modelVariables if one.type in ("Real", "Float64", "Float32")]
    inputs, outputs = (
        {names.get(one.name, one.name): one for one in real if one.causality == kind} for kind in ("input", "output")
    )
    if unknown := [name for name in names if name not in [one.name for one in real]]:
        raise InputError(
            f"the FMU has no variable {short_repr(unknown[0])}; give one of {list_names([one.name for one in real])}"
        )
    if {*inputs} != {*measured}:
        other = 'list the inputs in `measured`, or give their signals, as in inputs = { In1 = "suspension_deflection" }'
        raise InputError(
            f"the FMU has the inputs {list_names(inputs)}, but the controller measures {list_names(measured)}; {other}"
        )
    forces = [outputs[name] for name in (FORCE, *(f"{FORCE}_{corner}" for corner in CORNERS)) if name in outputs]
    if not forces:
        raise InputError(
            f"the FMU has the outputs {list_names(outputs)}, but none of these names is the name of a force; "
            f'rename the outputs to {FORCE} or {FORCE}_CORNER, or give outputs = {{ NAME = "control_force" }}'
        )
    for one in (*inputs.values(), *forces):
        name = names.get(one.name, one.name)
        unit = one.unit or (one.declaredType and one.declaredType.unit)
        signal = next(
            (known for known in KNOWN_SIGNALS if f"{name}_".startswith(f"{known.name}_")), None
        )  # the name of an FMU variable may end with the name of a corner
        if unit and signal and _plain(unit) != signal.unit:
            raise InputError(
                f"{one.name} of the FMU has the unit {short_repr(unit)} instead of {signal.unit}; export the variable in "
                f"{signal.unit}"
            )
    return [inputs[name] for name in measured], forces


def _plain(unit: str) -> str:
    """Returns a unit in the notation that the units of signals have."""
    plain = unit.replace("²", "2").replace("**", "").replace("^", "").replace("*", " ").replace(".", " ")
    return {"m s-1": "m/s", "m s-2": "m/s2", "rad s-1": "rad/s", "rad s-2": "rad/s2"}.get(plain, plain)
