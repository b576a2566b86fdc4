"""`[controllers]` of a vehicle file: the measured signals of each, and its law or its method of design."""

import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from models.common.arrays import Array
from models.common.checks import flag_within, is_finite
from models.common.errors import InputError, alike, error_in, listing, quoted
from models.common.printed import size
from models.kinds.kind import LARGEST, Parameter, VehicleKind, is_number
from models.kinds.linear_model import LinearModel
from models.laws import GOAL_KEYS
from models.laws.combinations import (
    FULL,
    PATTERNS,
    PREVIEW,
    QUADRATIC,
    STATIC,
    check_together,
    goes,
    is_order,
    section_parts,
)
from models.laws.linear import MATRICES, MOST_STATES, LinearLaw, static_law
from models.laws.python_law import Programmed, PythonLaw, checked_preview, read_law
from models.laws.semi_active import SemiActive, SemiActiveLaw, read_semi_active
from models.vehicle.limits_and_implementation import LONGEST_PERIOD, Implementation, Limits
from models.vehicle.names import check_name
from models.vehicle.sections import PUSHING, goals_of, loads_of, read_sampled, weighted_errors_of, without_weighted_errors

if TYPE_CHECKING:
    from models.laws.goals import Goals
    from models.laws.law_structure import LawStructure
    from models.vehicle.weighted_errors import WeightedErrors

CONTROLLER_KEYS = (
    *("measured", "gain", *MATRICES, "sample_period", "pid", "file", "semi_active", "certificate"),  # the law
    *("law", "preview", "fmu", "inputs", "outputs"),  # what is run as it is
    *("study", "actuators"),
    "anti_windup",
    *("order", "stable", "fastest_pole", "design", "noise", "lag", "sampled", "loads", *GOAL_KEYS),  # the design
)
RESERVED = ("passive", "state")  # these two always exist: u = 0, and full state feedback
FASTEST_TRACKING = 1e6  # 1/s, of anti-windup
FASTEST_LIMIT = 1e9  # rad/s, of a loop's poles
SHORTEST, LONGEST = 1e-6, LONGEST_PERIOD  # s, of a discrete controller's sample period


@dataclass(frozen=True)
class DesignConditions:
    """Sensor noise, actuator lag and loads that a controller is designed for and verified with. Default: none.

    Attributes:
        noise: rms of the noise on each signal that it measures, in that signal's unit; empty for none.
        bandwidth: corner frequency of the lag of every actuator [rad/s]; None for forces that act at once.
        loads: loads on the body, with the size that counts as much as 1 m/s of w [N, N m]; disturbances in addition to the road.
    """

    given_as = "design conditions, such as vehicle.hardware(name) returns"

    noise: tuple[float, ...] = ()
    bandwidth: float | None = None
    loads: tuple[tuple[str, float], ...] = ()

    @property
    def record(self) -> dict[str, Any]:
        """Keys of a controller's section, as in TOML."""
        given = {"noise": any(self.noise), "loads": dict(self.loads), "lag": self.bandwidth is not None}
        return {key: value for key, value in given.items() if value}


NOMINAL = DesignConditions()


@dataclass(frozen=True, eq=False)
class ControllerEntry:
    """Section `[controllers.NAME]` of a vehicle file.

    Attributes:
        name: name of the controller.
        measured: signals it measures, q of them.
        law: law from the q measurements to the m forces if the file contains its numbers; None if the law is to be designed.
        certificate: the law's certificate, as `python -m synth --save` wrote it; None without one.
        design: method: "full" for the full-order H-infinity controller, "order" and "pid" for a law of a `structure`, or one of
            `QUADRATIC` or `PREVIEW`; empty for the paper's two steps.
        python: the law in Python that the file names instead, without any claim; None for all others.
        hardware: sensor noise, actuator lag and loads that it is designed for and verified with.
        sampled: True if it is designed for the sampled loop.
        goals: goals of its design; None for the least norm.
        semi_active: semi-active law for dampers, without any linear claim; None for all other controllers.
        stable: True if its law of full order is to be stable by itself.
        fastest_pole: largest magnitude of the poles of the loop of its law of full order [rad/s]; None without a limit.
        anti_windup: rate of its law's anti-windup [1/s], see `models.laws.anti_windup`; None without it.
        structure: structure of the law that is designed; None for no restriction, or for a static gain.
        errors: errors of its readings and forces that are weighted by frequency; None without any.
        preview: time by which the design `PREVIEW` knows the road ahead [s]; 0 for all others.
        forced: True if it drives actuators that push, also in a vehicle file with adjustable dampers (`actuators = "force"`).
        study: True if it may measure heights over the datum of a flat road, which no sensor on a car has; then it does.
    """

    given_as = "an entry of vehicle.controllers"

    name: str
    measured: tuple[str, ...]
    law: LinearLaw | None = None
    certificate: Mapping[str, Any] | None = None
    design: str = ""
    python: PythonLaw | None = None
    hardware: DesignConditions = NOMINAL
    sampled: bool = False
    goals: "Goals | None" = None
    semi_active: SemiActiveLaw | None = None
    stable: bool = False
    fastest_pole: float | None = None
    anti_windup: float | None = None
    structure: "LawStructure | None" = None
    errors: "WeightedErrors | None" = None
    preview: float = 0.0
    forced: bool = False
    study: bool = False

    @property
    def named(self) -> tuple[str, ...]:
        """Signals that it names: the measured ones, and those of its goals."""
        return self.measured if self.goals is None else (*self.measured, *self.goals.signals)

    @property
    def linear(self) -> bool:
        """True if linear analysis applies."""
        return self.python is None and self.semi_active is None

    @property
    def parts(self) -> dict[str, str]:
        """Its law or design, and its options, each as in a vehicle file: rows of the table of compatible options."""
        parts: dict[str, str] = {}
        if self.law is not None:
            parts |= {"states": "a law with states"} if self.law.states else {"gain": "gain"}
        elif self.python is not None:
            parts["law"] = "law"
        elif self.semi_active is not None:
            parts["semi_active"] = "semi_active"
        elif self.structure is not None:
            parts[self.design] = self.structure.text
        elif self.design:
            parts[self.design] = f'order = "{FULL}"' if self.design == FULL else f'design = "{self.design}"'
        elif self.goals is None:
            parts["steps"] = "the default two-step design"
        flags = {
            "stable": self.stable,
            "noise": any(self.hardware.noise),
            "lag": self.hardware.bandwidth is not None,
            "sampled": self.sampled,
            "study": self.study,
        }
        parts |= {key: f"{key} = true" for key, value in flags.items() if value}
        if self.goals is not None:
            parts |= {"goals": "goals"} | {key: key for key in ("tolerance", "family") if getattr(self.goals, key)}
        parts |= {key: key for key in ("fastest_pole", "anti_windup") if getattr(self, key) is not None}
        parts |= {"weights": "a weight in tolerance"} if self.errors is not None else {}
        return parts | ({"loads": "loads"} if self.hardware.loads else {})

    def driver(self) -> Programmed | SemiActive:
        """Returns the controller of a law in Python, whose file is read and not run, or of a semi-active law.

        Raises:
            InputError: the file cannot be read.
        """
        if self.semi_active is not None:
            return SemiActive(self.name, self.semi_active)
        assert self.python is not None, "any other law is linear"
        with error_in(f"controller {self.name!r}:"):
            return Programmed(self.name, self.measured, self.python, self.python.source())


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
        limits, implementation, kind: properties of the vehicle, for controllers that are designed for them.
        folder: folder of the vehicle file and of laws in Python; None for a vehicle file from text.
        sampled: default of `sampled` in a section.
        dampers: suffix of the names at every adjustable damper, by force.
    """
    controllers: dict[str, ControllerEntry] = {}
    for written, given in section.items():
        name = unicodedata.normalize("NFC", written)
        if name in controllers:
            raise InputError(f"[controllers.{name}] appears twice, in two spellings that look the same; rename one of the two")
        check_name(f"[controllers.{name}]", name, RESERVED)
        forced, entry = _forced(f"[controllers.{name}]", given)
        entry, weights = without_weighted_errors(entry)
        own, pushing = ({}, limits) if forced or not dampers else (dampers, limits.without_actuators)
        controller = _controller(name, entry, model, pushing, implementation, folder, own, kind.corners)
        controller = replace(controller, forced=forced)
        asked = entry if controller.structure is None else {key: entry[key] for key in entry if key != "structure"}
        controller = replace(controller, goals=goals_of(f"[controllers.{name}]", asked, controller.measured, model.outputs, kind))
        others = entry.get("tolerance", ())
        errors = weighted_errors_of(f"[controllers.{name}]", weights, controller.parts, controller.measured, model.inputs, others)
        controller = replace(controller, errors=errors)
        usual = sampled and goes("sampled", controller.parts)
        for_samples = read_sampled(f"[controllers.{name}]", entry, usual, implementation.sample_period)
        controllers[name] = replace(controller, sampled=for_samples)
    return controllers


def _forced(where: str, section: Any) -> tuple[bool, Any]:
    """Returns whether a controller drives actuators that push, and its section without that key."""
    if not isinstance(section, Mapping) or "actuators" not in section:
        return False, section
    if section["actuators"] != PUSHING:
        raise InputError(
            f'{where} actuators = {quoted(section["actuators"])} is not allowed; give "{PUSHING}" for force actuators, or '
            "omit actuators to use those of [actuators]"
        )
    return True, {key: value for key, value in section.items() if key != "actuators"}


def _controller(
    name: str,
    entry: Any,
    model: LinearModel,
    limits: Limits,
    implementation: Implementation,
    folder: Path | None,
    dampers: Mapping[str, str],
    corners: Mapping[str, str],
) -> ControllerEntry:
    where = f"[controllers.{name}]"
    if not isinstance(entry, dict):
        raise InputError(f"{where} is not a section; write {where} once, and below it keys such as measured = [signals]")
    design = _design(where, entry)  # a value that is none is no part, and what is beside it is right
    check_together(where, section_parts(entry, model.inputs))
    semi_active = read_semi_active(where, entry, model.outputs, model.inputs, dampers)
    if semi_active is not None:
        return ControllerEntry(name, semi_active.measured, semi_active=semi_active)
    for key in entry:
        if key not in CONTROLLER_KEYS:
            raise InputError(
                f"{where} unknown key {key!r}; a controller is a gain, a law with states (A, B, C, D), a law in Python, or a "
                f"design, and its keys are {listing(CONTROLLER_KEYS)}"
            )
    if "file" in entry:
        raise InputError(f"{where} file needs a vehicle file next to it, but this vehicle is read from text; give the matrices")
    structured = entry.get("structure") in PATTERNS
    given = any(key in entry for key in ("gain", *MATRICES, *["pid"] * (not structured)))
    if "certificate" in entry and not (isinstance(entry["certificate"], dict) and given):
        raise InputError(f"{where} certificate needs a section with a gain or a law, and must be a table; remove it here")

    python = read_law(where, entry, folder)
    of_state = design in ("lqr", PREVIEW)
    if of_state and "measured" not in entry:
        entry = entry | {"measured": list(model.states)}
    measured = entry.get("measured")
    study, measurable = flag_within(where, entry, "study"), listing(model.measurable)
    if not isinstance(measured, list) or not measured or not all(isinstance(signal, str) for signal in measured):
        mistake = f"measured = {quoted(measured)} is not a list of signals" if "measured" in entry else "measured is missing"
        raise InputError(f"{where} {mistake}; give a list of signals from {measurable}")
    for signal in measured:
        if signal not in model.outputs:
            raise InputError(f"{where} unknown signal {quoted(signal)}; measurable are {alike(signal, model.measurable)}")
        if measured.count(signal) > 1:
            raise InputError(f"{where} measures {signal!r} twice; list this signal once")
        if signal not in model.measurable:
            if signal in model.heights and study:
                continue
            if signal in model.heights:
                raise InputError(
                    f"{where} {signal!r} is a height above a flat datum, which no sensor on a car measures; give study = true "
                    f"for a theoretical study, or choose signals from {measurable}"
                )
            raise InputError(
                f"{where} {signal!r} depends on the road's height, but feedback may use only the state; choose signals from "
                f"{measurable}"
            )
    if study and not model.over_datum(measured):
        raise InputError(f"{where} has study = true, but measures no height above a flat datum; omit study")
    if not given and python is None and set(measured) <= set(model.inputs):
        raise InputError(f"{where} control forces alone do not determine the state; add signals from {measurable}")
    if of_state and set(measured) != set(model.states):
        instead = ', or give design = "lqg"' if design == "lqr" else ""
        raise InputError(
            f'{where} measured = {quoted(measured)} is not allowed, because design = "{design}" uses the full state, '
            f"{listing(model.states)}; omit measured{instead}"
        )
    structure = pid = None
    if structured or "pid" in entry or is_order(entry.get("order")):
        from models.laws.law_structure import read_law_structure, read_pid

        structure = read_law_structure(where, entry, measured, corners)
        pid = read_pid(where, entry, measured, corners) if "pid" in entry and not structured else None
        design = design if structure is None else "pid" if structure.kind else "order"
    takes_out = "" if structure is not None and structure.rows is not None else design  # others read forces as all else
    hardware = _hardware(where, entry, measured, takes_out, model.inputs, limits, implementation)
    hardware = replace(hardware, loads=loads_of(where, entry, model.loads))
    law = None if python else pid or _law(where, entry, model, measured)
    clipped = bool(dampers) or limits.actuator_force is not None
    anti_windup = _anti_windup(where, entry, law, clipped)
    law = law if law is None or anti_windup is None else replace(law, anti_windup=anti_windup)
    claims = entry.get("certificate")
    rest = {
        "stable": flag_within(where, entry, "stable"),
        "fastest_pole": _rate(where, entry, Parameter("fastest_pole", "rad/s", "of the loop", largest=FASTEST_LIMIT)),
        "anti_windup": anti_windup,
        "structure": structure,
        "preview": _preview(where, entry, dampers),
        "study": study,
    }
    return ControllerEntry(name, tuple(measured), law, claims, design, python, hardware, **rest)


def _preview(where: str, entry: Mapping[str, Any], dampers: Mapping[str, str]) -> float:
    """Returns how far ahead a design knows the road [s]; 0 if it is another design."""
    if entry.get("design") != PREVIEW:
        return 0.0
    if "preview" not in entry:
        raise InputError(
            f'{where} design = "{PREVIEW}" needs the time for which it knows the road ahead; give it in seconds, as in '
            "preview = 0.5. This is the range of the road sensor divided by the speed"
        )
    if dampers:
        raise InputError(
            f'{where} design = "{PREVIEW}" acts before the road does, but semi-active dampers only resist motion; choose another '
            "design, or omit [actuators]"
        )
    return checked_preview(where, entry["preview"])


def _hardware(
    where: str,
    entry: Mapping[str, Any],
    measured: Sequence[str],
    design: str,
    inputs: Sequence[str],
    limits: Limits,
    implementation: Implementation,
) -> DesignConditions:
    """Returns sensor noise and actuator lag that a controller is designed for."""
    flags = {key: flag_within(where, entry, key, more=" (other sections define the amount)") for key in ("noise", "lag")}
    noise = tuple(implementation.noise.get(signal, 0.0) for signal in measured) if flags["noise"] else ()
    if flags["noise"] and not any(noise):
        raise InputError(
            f"{where} has noise = true, but [implementation] gives no noise on its measured signals; give the rms in the "
            f"signal's unit, as in noise = {{ {measured[0]} = 0.01 }}, or omit noise = true"
        )
    forces = [signal for signal, rms in zip(measured, noise, strict=bool(noise)) if rms and signal in inputs]
    if forces and design and not flags["lag"]:
        raise InputError(
            f"{where} has noise = true, but [implementation] has noise on {forces[0]!r}, and a design cannot account for noise "
            f"on a measured force; omit the noise on {forces[0]!r}"
        )
    if flags["lag"] and limits.actuator_bandwidth is None:
        raise InputError(
            f"{where} has lag = true, but [limits] has no actuator_bandwidth; give actuator_bandwidth [rad/s], or omit lag"
        )
    return DesignConditions(noise, limits.actuator_bandwidth if flags["lag"] else None)


def _design(where: str, entry: Mapping[str, Any]) -> str:
    """Returns the method of design, see `ControllerEntry`."""
    for key, allowed in {"order": (STATIC, FULL), "design": (*QUADRATIC, PREVIEW)}.items():
        if key in entry and entry[key] not in allowed and not (key == "order" and is_order(entry[key])):
            states = f", or a number of states from 0 to {MOST_STATES}" if key == "order" else ""
            raise InputError(f"{where} {key} = {quoted(entry[key])} is unknown; give one of {listing(allowed)}{states}")
    return FULL if entry.get("order") == FULL else entry.get("design", "")


def _rate(where: str, entry: Mapping[str, Any], parameter: Parameter) -> float | None:
    """Returns a number above 0 of a section, or None without it."""
    with error_in(where):
        return parameter.check(entry[parameter.name]) if parameter.name in entry else None


def _anti_windup(where: str, entry: Mapping[str, Any], law: LinearLaw | None, clipped: bool) -> float | None:
    """Returns the rate of a law's anti-windup [1/s], or None without it.

    Args:
        clipped: True if something limits the forces.
    """
    rate = _rate(where, entry, Parameter("anti_windup", "1/s", "of its states", largest=FASTEST_TRACKING))
    if rate is None:
        return None
    if law is not None and not law.states:
        raise InputError(f"{where} has anti_windup, but its law has no states that can wind up; omit anti_windup")
    if not clipped:
        raise InputError(
            f"{where} has anti_windup, but no limit clips its forces; omit anti_windup, or give [limits] actuator_force, or "
            '[actuators] kind = "damper"'
        )
    return rate


def _law(where: str, entry: Mapping[str, Any], model: LinearModel, measured: list[str]) -> LinearLaw | None:
    """Returns the law of an entry, or None if the entry has no matrices."""
    matrices = [key for key in MATRICES if key in entry]
    if "gain" in entry:
        return static_law(_gain(where, entry["gain"], model, measured))
    if not matrices and "sample_period" not in entry:
        return None
    if missing := [key for key in MATRICES if key not in entry]:
        raise InputError(
            f"{where} {listing(missing)} is missing, but x_c' = A x_c + B y, u = C x_c + D y needs A, B, C and D; give all four"
        )
    for key in MATRICES:
        rows = entry[key]
        if not (isinstance(rows, list) and all(isinstance(row, list) and all(map(is_finite, row)) for row in rows)):
            raise InputError(f"{where} {key} = {quoted(rows)} is not a matrix of numbers; give a list of rows")
    period = entry.get("sample_period")
    if period is not None and (not is_finite(period) or not SHORTEST <= period <= LONGEST):
        raise InputError(
            f"{where} sample_period = {quoted(period)} is not allowed; give a number from {SHORTEST:g} to {LONGEST:g} s"
        )
    k, m, q = len(entry["A"]) if any(entry["A"]) else 0, len(model.inputs), len(measured)
    shapes = {"A": (k, k), "B": (k, q), "C": (m, k), "D": (m, q)}
    for key, (rows, columns) in shapes.items():
        there = entry[key]
        if not any(there) and not rows * columns:
            continue  # of a law without states, however it is written down
        if len(there) != rows or any(len(row) != columns for row in there):
            raise InputError(
                f"{where} {key} has {size(there)}; give {rows} row(s) of {columns} number(s), because A has {k} row(s), this "
                f"vehicle has {m} actuator(s), and the controller measures {q} signal(s)"
            )
    with error_in(where):
        return LinearLaw(*(np.array(entry[key], dtype=float).reshape(shapes[key]) for key in MATRICES), sample_period=period)


def _gain(where: str, gain: Any, model: LinearModel, measured: list[str]) -> Array:
    m, q = len(model.inputs), len(measured)
    allowed = (
        f"give {m} row(s), one for each actuator, of {q} number(s), one for each measured signal, of at most "
        f"{LARGEST:g} in magnitude, as in gain = {[[1.0] * q] * m}"
    )
    rows = gain if isinstance(gain, list) else [gain]
    if not all(isinstance(row, list) and all(is_number(entry) for entry in row) for row in rows):
        raise InputError(f"{where} gain = {quoted(gain)} is not a matrix of numbers; {allowed}")
    if len(rows) != m or any(len(row) != q for row in rows):
        raise InputError(f"{where} gain has {size(rows)}; {allowed}")
    return np.array(rows, dtype=float)
