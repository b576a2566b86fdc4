"""`[controllers]` of a vehicle file: the measured signals of each, and its law or its method of design."""

import sys
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, listing, quoted
from models.common.printed import size
from models.kinds.kind import LARGEST, VehicleKind, is_number, is_within
from models.kinds.linear_model import LinearModel
from models.laws.linear import MATRICES, LinearLaw, static_law
from models.laws.python_law import PythonLaw, read_law
from models.laws.semi_active import SemiActiveLaw, read_semi_active
from models.vehicle import GOAL_KEYS
from models.vehicle.limits_and_implementation import LONGEST_PERIOD, Implementation, Limits
from models.vehicle.names import check_name
from models.vehicle.sections import designed_for_samples, goals_of, loads_of

if TYPE_CHECKING:
    from models.vehicle.goals import Goals

QUADRATIC = ("lqr", "lqg", "h2")  # values of `design`, all for the mean square; without it the paper's two steps
FULL = "full"  # value of `order`
CONTROLLER_KEYS = (
    *("measured", "gain", *MATRICES, "sample_period", "file", "law", "preview", "semi_active", "certificate"),  # the law
    *("order", "design", "noise", "lag", "sampled", "loads", *GOAL_KEYS),  # the design
)
RESERVED = ("passive", "state")  # these two always exist: u = 0, and full state feedback
SHORTEST, LONGEST = 1e-6, LONGEST_PERIOD  # s, of a discrete controller's sample period


class Method(Enum):
    """Origin of a controller's law; the value is a phrase about the controller."""

    GAIN = "has a gain of its own"
    LAW = "has a law with states of its own"
    TWO_STEPS = "is designed in two steps"
    NOISE = "is designed for noise, which (25) does not know"
    SAMPLED = "is designed for the sampled loop"
    GOALS = "is designed for goals"
    FULL_ORDER = "is designed at full order"
    QUADRATIC = "is designed for the mean square"
    PYTHON = "is a law in Python"
    SEMI_ACTIVE = "is a semi-active law"


@dataclass(frozen=True)
class Hardware:
    """Sensor noise, actuator lag and loads that a controller is designed for and verified with. Default: none.

    Attributes:
        noise: rms of the noise on each signal that it measures, in that signal's unit; empty for none.
        bandwidth: corner frequency of the lag of every actuator [rad/s]; None for forces that act at once.
        loads: on the body, with the size that counts as much as 1 m/s of w [N, N m]; disturbances beside the road.
    """

    noise: tuple[float, ...] = ()
    bandwidth: float | None = None
    loads: tuple[tuple[str, float], ...] = ()


IDEAL = Hardware()


@dataclass(frozen=True, eq=False)
class ControllerEntry:
    """Section `[controllers.NAME]` of a vehicle file.

    Attributes:
        name: its name.
        measured: signals it measures, q of them.
        law: from the q measurements to the m forces if the file gives it as numbers, else None: it is to be designed.
        certificate: the law's certificate, as `python -m synth --save` wrote it; None without one.
        design: method: "full" for the full-order H-infinity controller, or one of `QUADRATIC`; empty for the paper's two steps.
        python: the law in Python that the file names instead, without any claim; None for all others.
        hardware: sensor noise, actuator lag and loads that it is designed for and verified with.
        sampled: True if it is designed for the sampled loop.
        goals: goals of its design; None for the least norm.
        semi_active: its law for adjustable dampers, without any claim; None for all others.
    """

    name: str
    measured: tuple[str, ...]
    law: LinearLaw | None = None
    certificate: Mapping[str, Any] | None = None
    design: str = ""
    python: PythonLaw | None = None
    hardware: Hardware = IDEAL
    sampled: bool = False
    goals: "Goals | None" = None
    semi_active: SemiActiveLaw | None = None

    @property
    def named(self) -> tuple[str, ...]:
        """Signals that it names: the measured ones, and those of its goals."""
        return self.measured if self.goals is None else (*self.measured, *self.goals.signals)

    @property
    def linear(self) -> bool:
        """True if linear analysis applies."""
        return self.method not in (Method.PYTHON, Method.SEMI_ACTIVE)

    @property
    def method(self) -> Method:
        """Origin of its law; a law in the file takes precedence."""
        if self.law is not None:
            return Method.LAW if self.law.states else Method.GAIN
        if self.python is not None:
            return Method.PYTHON
        if self.semi_active is not None:
            return Method.SEMI_ACTIVE
        if self.design:
            return Method.QUADRATIC if self.design in QUADRATIC else Method.FULL_ORDER
        if self.goals is not None:
            return Method.GOALS
        if self.sampled:
            return Method.SAMPLED
        return Method.NOISE if any(self.hardware.noise) else Method.TWO_STEPS


def read_controllers(
    section: Mapping[str, Any],
    model: LinearModel,
    limits: Limits,
    implementation: Implementation,
    kind: VehicleKind,
    folder: Path | None = None,
    sampled: bool = False,
    dampers: Mapping[str, str] | None = None,
) -> dict[str, ControllerEntry]:
    """Reads `[controllers]`: entries by name in the normal form NFC, in which names that look alike are equal.

    Args:
        limits, implementation, kind: of the vehicle, for controllers that are designed for them.
        folder: of the vehicle file and of laws in Python; None for a vehicle file from text.
        sampled: default of `sampled` in a section.
        dampers: suffix of the names at every adjustable damper, by force.
    """
    controllers: dict[str, ControllerEntry] = {}
    for written, entry in section.items():
        name = unicodedata.normalize("NFC", written)
        if name in controllers:
            raise InputError(f"[controllers.{name}] is there twice, in two spellings that look alike; rename one")
        check_name(f"[controllers.{name}]", name, RESERVED)
        controller = _controller(name, entry, model, limits, implementation, folder, dampers or {})
        controller = replace(controller, goals=goals_of(f"[controllers.{name}]", entry, controller.measured, model.outputs, kind))
        two_steps = controller.method is Method.TWO_STEPS and not controller.hardware.loads
        for_samples = designed_for_samples(f"[controllers.{name}]", entry, two_steps, implementation, sampled)
        controllers[name] = replace(controller, sampled=for_samples)
    return controllers


def _controller(
    name: str,
    entry: Any,
    model: LinearModel,
    limits: Limits,
    implementation: Implementation,
    folder: Path | None,
    dampers: Mapping[str, str],
) -> ControllerEntry:
    where = f"[controllers.{name}]"
    if not isinstance(entry, dict):
        raise InputError(f"{where} is not a section with measured = [signals]")
    semi_active = read_semi_active(where, entry, model.outputs, model.inputs, dampers)
    if semi_active is not None:
        return ControllerEntry(name, semi_active.measured, semi_active=semi_active)
    for key in entry:
        if key not in CONTROLLER_KEYS:
            raise InputError(
                f"{where} unknown key {key!r}; a controller is a static gain on what it measures, u = K y, or a law with states, "
                f"x_c' = A x_c + B y, u = C x_c + D y, or a law in Python, and designed where none is given; known: "
                f"{listing(CONTROLLER_KEYS)}"
            )
    if "file" in entry:
        raise InputError(f"{where} its file is read beside a vehicle file, and this is text from elsewhere; give its matrices")
    given = any(key in entry for key in ("gain", *MATRICES))
    if "certificate" in entry and not (isinstance(entry["certificate"], dict) and given):
        raise InputError(f"{where} a certificate is a section of its own, beside the gain or law that it is about; take it out")

    design, python = _design(where, entry, given), read_law(where, entry, folder)
    if design == "lqr" and "measured" not in entry:
        entry = entry | {"measured": list(model.states)}
    measured = entry.get("measured")
    measurable = listing(model.measurable)
    if not isinstance(measured, list) or not measured or not all(isinstance(signal, str) for signal in measured):
        mistake = f"measured = {quoted(measured)} is no list of signals" if "measured" in entry else "measured is missing"
        raise InputError(f"{where} {mistake}; give a list of signals out of: {measurable}")
    for signal in measured:
        if signal not in model.outputs:
            raise InputError(f"{where} unknown signal {quoted(signal)}; it can measure {measurable}")
        if measured.count(signal) > 1:
            raise InputError(f"{where} measures {signal!r} twice; name it once")
        if signal not in model.measurable:
            raise InputError(
                f"{where} {signal!r} has the road's height in it beside the state, and loops are closed through the state alone; "
                f"give signals out of: {measurable}"
            )
        if signal in model.inputs and not (given or design or python or entry.get("lag")):
            raise InputError(
                f"{where} {signal!r} says nothing of the state, so no gain is designed on it; leave it out, or give "
                'order = "full", whose controller takes the force out of the accelerations that it measures'
            )
    if not given and python is None and set(measured) <= set(model.inputs):
        raise InputError(f"{where} control forces alone say nothing of the state; give measured = signals out of: {measurable}")
    if design == "lqr" and set(measured) != set(model.states):
        raise InputError(
            f'{where} measured = {quoted(measured)}: design = "lqr" is of the state, {listing(model.states)}; leave measured '
            'out, or give design = "lqg"'
        )
    hardware = _hardware(where, entry, measured, design, model.inputs, limits, implementation)
    hardware = replace(hardware, loads=loads_of(where, entry, model.loads))
    law = None if python else _law(where, entry, model, measured)
    return ControllerEntry(name, tuple(measured), law, entry.get("certificate"), design, python, hardware)


def _hardware(
    where: str,
    entry: Mapping[str, Any],
    measured: Sequence[str],
    design: str,
    inputs: Sequence[str],
    limits: Limits,
    implementation: Implementation,
) -> Hardware:
    """Returns sensor noise and actuator lag that a controller is designed for."""
    flags = {key: entry.get(key, False) for key in ("noise", "lag")}
    for key, value in flags.items():
        if not isinstance(value, bool):
            raise InputError(f"{where} {key} = {quoted(value)} is not allowed; give true or false: how much stands elsewhere")
        if value and (design == "lqr" or (design == "lqg" and key == "noise")):
            why = "is of the state itself" if design == "lqr" else "takes the noise of [implementation] by itself"
            raise InputError(f'{where} has {key} = true, and design = "{design}" {why}; leave {key} out')
    noise = tuple(implementation.noise.get(signal, 0.0) for signal in measured) if flags["noise"] else ()
    if flags["noise"] and not any(noise):
        raise InputError(
            f"{where} has noise = true, and [implementation] gives no noise of what it measures; give it, as in "
            f"noise = {{ {measured[0]} = 0.01 }}, an rms in the signal's unit, or leave noise = true out"
        )
    forces = [signal for signal, rms in zip(measured, noise, strict=bool(noise)) if rms and signal in inputs]
    if forces and design and not flags["lag"]:
        raise InputError(
            f"{where} has noise = true, and [implementation] a noise on {forces[0]!r}, which a design takes out of what is "
            "measured and knows no noise of; leave that noise out"
        )
    if flags["lag"] and limits.actuator_bandwidth is None:
        raise InputError(
            f"{where} has lag = true, and [limits] gives actuators no lag; give actuator_bandwidth [rad/s], or leave lag out"
        )
    return Hardware(noise, limits.actuator_bandwidth if flags["lag"] else None)


def _design(where: str, entry: Mapping[str, Any], given: bool) -> str:
    """Returns the method of design, see `ControllerEntry`."""
    for key, allowed in {"order": (FULL,), "design": QUADRATIC}.items():
        if key in entry and entry[key] not in allowed:
            raise InputError(f"{where} {key} = {quoted(entry[key])} is not known; known: {listing(allowed)}")
    keys = [key for key in ("order", "design") if key in entry]
    if len(keys) > 1:
        raise InputError(f"{where} has an order and a design; an H2, LQG or LQR controller has its order: leave order out")
    if keys and given:
        given_key = f"{keys[0]} = {quoted(entry[keys[0]])}"
        raise InputError(f"{where} has {given_key} and a law of its own, which is not designed; give one")
    return entry[keys[0]] if keys else ""


def _law(where: str, entry: Mapping[str, Any], model: LinearModel, measured: list[str]) -> LinearLaw | None:
    """Returns the law of an entry, or None if the entry has no matrices."""
    matrices = [key for key in MATRICES if key in entry]
    if "gain" in entry and (matrices or "sample_period" in entry):
        raise InputError(f"{where} has a gain and {listing(matrices or ['sample_period'])}; a static gain is whole by itself")
    if "gain" in entry:
        return static_law(_gain(where, entry["gain"], model, measured))
    if not matrices and "sample_period" not in entry:
        return None
    if missing := [key for key in MATRICES if key not in entry]:
        raise InputError(
            f"{where} {listing(missing)} is missing: a law with states is x_c' = A x_c + B y, u = C x_c + D y; give all four"
        )
    for key in MATRICES:
        rows = entry[key]
        if not (isinstance(rows, list) and all(isinstance(row, list) and all(map(_is_real, row)) for row in rows)):
            raise InputError(f"{where} {key} = {quoted(rows)} is not a matrix of numbers; give a list of rows")
    period = entry.get("sample_period")
    if period is not None and (not _is_real(period) or not SHORTEST <= period <= LONGEST):
        raise InputError(
            f"{where} sample_period = {quoted(period)} is not allowed; give seconds from {SHORTEST:g} to {LONGEST:g}"
        )
    k, m, q = len(entry["A"]) if any(entry["A"]) else 0, len(model.inputs), len(measured)
    shapes = {"A": (k, k), "B": (k, q), "C": (m, k), "D": (m, q)}
    for key, (rows, columns) in shapes.items():
        there = entry[key]
        if not any(there) and not rows * columns:
            continue  # of a law without states, however it is written down
        if len(there) != rows or any(len(row) != columns for row in there):
            raise InputError(
                f"{where} {key} has {size(there)}; give {rows} row(s) of {columns} number(s), as A has {k} row(s), this vehicle "
                f"{m} actuator(s), and {q} signal(s) are measured"
            )
    try:
        return LinearLaw(*(np.array(entry[key], dtype=float).reshape(shapes[key]) for key in MATRICES), sample_period=period)
    except InputError as error:
        raise InputError(f"{where} {error}") from error


def _gain(where: str, gain: Any, model: LinearModel, measured: list[str]) -> Array:
    m, q = len(model.inputs), len(measured)
    allowed = (
        f"give {m} row(s) (one per actuator) of {q} number(s) (one per measured signal) of at most {LARGEST:g}, as in "
        f"gain = {[[1.0] * q] * m}"
    )
    rows = gain if isinstance(gain, list) else [gain]
    if not all(isinstance(row, list) and all(is_number(entry) for entry in row) for row in rows):
        raise InputError(f"{where} gain = {quoted(gain)} is not a matrix of numbers; {allowed}")
    if len(rows) != m or any(len(row) != q for row in rows):
        raise InputError(f"{where} gain has {size(rows)}; {allowed}")
    return np.array(rows, dtype=float)


def _is_real(value: Any) -> bool:
    """Returns True for a number of any size: the law itself limits its entries, as these depend on its states' units."""
    return is_within(value, sys.float_info.max)
