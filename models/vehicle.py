"""A vehicle file (TOML): the kind of vehicle, its parameters, the performance weights and the controllers. All a user writes."""

import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, listing, quoted
from models.common.read_file import TEXT, read_text
from models.common.toml import parse_toml
from models.kind import HERE, LARGEST, VehicleKind
from models.kinds import kind, kinds
from models.linear_model import LinearModel
from models.reality import Implementation, Limits, read_implementation, read_limits

SECTIONS = ("type", "parameters", "performance", "controllers", "limits", "implementation")
CONTROLLER_KEYS = ("measured", "gain", "certificate")
RESERVED = ("passive", "state")  # these two always exist: u = 0, and full state feedback
LONGEST_NAME = 60  # bytes; the names of three controllers go into a file name
SMALLEST_WEIGHT, LARGEST_WEIGHT = 1e-12, 1e12  # relative to one another; beyond these rounding decides


@dataclass(frozen=True, eq=False)
class ControllerEntry:
    """One `[controllers.NAME]` of a vehicle file.

    Attributes:
        name: its name.
        measured: signals it measures, q of them.
        gain: shape (m, q) if the file gives it, else None: it is to be designed.
        certificate: what is claimed of the gain, as `python -m synth --save` wrote it beside it; None without one.
    """

    name: str
    measured: tuple[str, ...]
    gain: Array | None = None
    certificate: Mapping[str, Any] | None = None


@dataclass(frozen=True, eq=False)
class Vehicle:
    """A vehicle, as its file says.

    Attributes:
        kind: equations and MJCF.
        parameters: SI values by name.
        performance: weight of each signal in the controlled output z (34).
        controllers: by name, without `passive` and `state`, which always exist.
        text: the vehicle file, as read; it goes into the logs.
        source: where it came from, for messages.
        limits: where the hardware ends.
        implementation: the controller as it would be built.
    """

    kind: VehicleKind
    parameters: Mapping[str, float]
    performance: Mapping[str, float]
    controllers: Mapping[str, ControllerEntry]
    text: str = ""
    source: str = ""
    limits: Limits = field(default_factory=Limits)
    implementation: Implementation = field(default_factory=Implementation)

    @cached_property
    def linear_model(self) -> LinearModel:
        """The linear model of these parameters."""
        return self.kind.linear_model(self.parameters)

    @property
    def kind_files(self) -> tuple[Path, ...]:
        """The files that its kind was read from."""
        return self.kind.mjcf, self.kind.mjcf.with_suffix(".py")

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that it was read from: its own, unless it is text alone, and its kind's."""
        return (*((Path(self.source),) if self.source else ()), *self.kind_files)

    @property
    def ideal(self) -> bool:
        """Whether the file says nothing of limits and of the controller as it would be built."""
        return self.limits == Limits() and self.implementation.ideal

    def checked(self) -> "Vehicle":
        """The same, its parameters and weights checked as a vehicle file's are: what `dataclasses.replace` was given was not.

        Raises:
            InputError: one is missing, unknown or not allowed.
        """
        sound = replace(self, parameters=self.kind.check(self.parameters))
        return replace(sound, performance=_performance(self.performance, sound.linear_model))

    @property
    def controller_names(self) -> tuple[str, ...]:
        """Every controller that can be asked for."""
        return (*RESERVED, *self.controllers)


def read_vehicle(file: str | Path) -> Vehicle:
    """Reads a vehicle file, or a vehicle that ships, by name (`quarter_car`).

    Raises:
        InputError: the file is not there, not TOML, or something in it is missing, unknown or not allowed. The message names
            the file, the key, what is allowed.
    """
    path = Path(file)
    if str(file) in kinds() and not path.is_file():
        path = HERE / f"{file}.toml"
    text = read_text(path, "vehicle file", TEXT, f"give a TOML file or one of: {listing(kinds())}")
    try:
        return parse_vehicle(text, source=str(path), folder=path.parent)
    except InputError as error:
        raise InputError(f"vehicle file {path}: {error}") from error


def parse_vehicle(text: str, source: str = "", folder: Path | None = None) -> Vehicle:
    """A vehicle from the text of its file.

    Args:
        text: TOML.
        source: where it came from, for messages.
        folder: where a kind of vehicle of the user's own may lie; without one, only those that ship are known.

    Raises:
        InputError: see `read_vehicle`.
    """
    data = parse_toml(text)
    for section in data:
        if section not in SECTIONS:
            what = "section" if isinstance(data[section], dict) else "key"
            raise InputError(f"unknown {what} {section!r}; known: {listing(SECTIONS)}")
    for section in SECTIONS[:3]:
        if section not in data:
            raise InputError(f"{section!r} is missing; a vehicle file has {listing(SECTIONS)}")
    for section in SECTIONS[1:]:
        if not isinstance(data.get(section, {}), dict):
            raise InputError(f"{section!r} is not a section; write it as [{section}]")
    if not isinstance(data["type"], str):
        raise InputError(f"type = {quoted(data['type'])} is not a name in quotes; known: {listing(kinds())}")

    vehicle_kind = kind(data["type"], folder)
    parameters = vehicle_kind.check(data["parameters"])
    model = vehicle_kind.linear_model(parameters)
    return Vehicle(
        kind=vehicle_kind,
        parameters=parameters,
        performance=_performance(data["performance"], model),
        controllers=_controllers(data.get("controllers", {}), model),
        text=text,
        source=source,
        limits=read_limits(data.get("limits", {})),
        implementation=read_implementation(data.get("implementation", {}), model.measurable),
    )


def _performance(section: Mapping[str, Any], model: LinearModel) -> dict[str, float]:
    weights = {}
    for signal, weight in section.items():
        if signal not in model.outputs:
            raise InputError(f"[performance] unknown signal {signal!r}; this vehicle has {listing(model.outputs)}")
        if not _is_number(weight) or not (weight == 0 or SMALLEST_WEIGHT <= weight <= LARGEST_WEIGHT):
            raise InputError(
                f"[performance] {signal} = {quoted(weight)} is not allowed; give 0 or a weight from {SMALLEST_WEIGHT:g} "
                f"to {LARGEST_WEIGHT:g}"
            )
        weights[signal] = float(weight)
    if not any(weights.values()):
        raise InputError(f"[performance] weighs nothing; give at least one weight above 0 to: {listing(model.outputs)}")
    return weights


def _controllers(section: Mapping[str, Any], model: LinearModel) -> dict[str, ControllerEntry]:
    """By name, each in the one spelling (NFC) of those that look alike: with letters and their marks composed."""
    found: dict[str, ControllerEntry] = {}
    for written, entry in section.items():
        name = unicodedata.normalize("NFC", written)
        if name in found:
            raise InputError(f"[controllers.{name}] is there twice, in two spellings that look alike; rename one")
        found[name] = _controller(name, entry, model)
    return found


def _is_name(name: str) -> bool:
    """Whether a controller may be called so; vowel signs, as in Hindi and Thai, are marks on letters."""
    kinds = ["L" if one.isalnum() else "-" if one in "_-" else unicodedata.category(one) for one in name]
    return "L" in kinds and {*kinds} <= {"L", "-", "Mn", "Mc"} and kinds[0] not in ("Mn", "Mc") and not name.startswith("-")


def _controller(name: str, entry: Any, model: LinearModel) -> ControllerEntry:
    where = f"[controllers.{name}]"
    if name in RESERVED or name == "all":
        raise InputError(f"{where} the name {name!r} is taken: passive, state and all always exist; rename it")
    if len(name.encode()) > LONGEST_NAME or not _is_name(name):
        raise InputError(
            f"{where} a controller's name has letters, digits, '_' and '-' only, at most {LONGEST_NAME} bytes of UTF-8, and no "
            "'-' first, as an option has"
        )
    if not isinstance(entry, dict):
        raise InputError(f"{where} is not a section with measured = [signals]")
    for key in entry:
        if key not in CONTROLLER_KEYS:
            raise InputError(
                f"{where} unknown key {key!r}; a controller is a static gain on what it measures, u = K y, designed where none "
                f"is given; known: {listing(CONTROLLER_KEYS)}"
            )
    if "certificate" in entry and not (isinstance(entry["certificate"], dict) and "gain" in entry):
        raise InputError(f"{where} a certificate is a section of its own, beside the gain that it is about; take it out")

    measured = entry.get("measured")
    measurable = listing(model.measurable)
    if not isinstance(measured, list) or not measured or not all(isinstance(signal, str) for signal in measured):
        found = f"measured = {quoted(measured)} is no list of signals" if "measured" in entry else "measured is missing"
        raise InputError(f"{where} {found}; give a list of signals out of: {measurable}")
    for signal in measured:
        if signal not in model.outputs:
            raise InputError(f"{where} unknown signal {quoted(signal)}; it can measure {measurable}")
        if measured.count(signal) > 1:
            raise InputError(f"{where} measures {signal!r} twice; name it once")
        if signal not in model.measurable:
            raise InputError(
                f"{where} {signal!r} contains the control force or the road itself, so a static controller cannot measure it; "
                f"give signals out of: {measurable}"
            )
    gain = _gain(where, entry["gain"], model, measured) if "gain" in entry else None
    return ControllerEntry(name, tuple(measured), gain, entry.get("certificate"))


def _gain(where: str, gain: Any, model: LinearModel, measured: list[str]) -> Array:
    m, q = len(model.inputs), len(measured)
    example = [[1.0] * q] * m
    allowed = (
        f"give {m} row(s) (one per actuator) of {q} number(s) (one per measured signal) of at most {LARGEST:g}, as in "
        f"gain = {example}"
    )
    rows = gain if isinstance(gain, list) else [gain]
    if not all(isinstance(row, list) and all(_is_number(entry) for entry in row) for row in rows):
        raise InputError(f"{where} gain = {quoted(gain)} is not a matrix of numbers; {allowed}")
    if len(rows) != m or any(len(row) != q for row in rows):
        lengths = " or ".join(str(length) for length in sorted({len(row) for row in rows})) or "no"
        raise InputError(f"{where} gain has {len(rows)} row(s) of {lengths} number(s); {allowed}")
    matrix = np.array(rows, dtype=float)
    matrix.flags.writeable = False
    return matrix


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and -LARGEST <= value <= LARGEST
