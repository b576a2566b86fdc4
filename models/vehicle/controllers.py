"""`[controllers]` of a vehicle file: the measured signals of each controller, and its control law or design method."""

import unicodedata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from models.common.checks import is_finite
from models.common.errors import InputError, alike, error_in, list_names, short_repr
from models.common.extensions import FEATURES
from models.common.printed import size
from models.common.schema import HERE, AnyTable, BySignal, Choice, Flag, ReadBy, keys, read
from models.kinds.kind import LARGEST, SMALLEST, VehicleKind
from models.kinds.linear_model import LinearModel
from models.kinds.signals import HEAVE_LOAD
from models.laws.design_methods import FULL, OF_STATE, PREVIEW
from models.laws.design_request import Demands, DesignRequest, LawStructure
from models.laws.law import Design, T, no_design
from models.laws.linear import LinearLaw, static_law
from models.vehicle.limits_and_implementation import NO_PERIOD, Implementation, Limits
from models.vehicle.names import check_name

if TYPE_CHECKING:
    from models.laws.goals import Goals
    from models.laws.python_law import PythonController, PythonLaw
    from models.laws.semi_active import SemiActive, SemiActiveLaw
    from models.laws.weighted_errors import WeightedErrors

OTHERWISE = " for force actuators, or omit actuators to use those of [actuators]"
RESERVED_NAMES = ("passive", "state")  # every vehicle has these two controllers: zero force, and full state feedback
KEYS_WITHOUT_OPTIONS = {"gain", "measured", "certificate", "actuators"}  # a section of these keys has no options to combine
PUSHING_ACTUATORS = "force"  # value of the key `actuators` in a controller's section


@dataclass(frozen=True)
class DesignConditions:
    """Sensor noise, actuator lag and loads for which a controller is designed and certified.

    By default, a design assumes exact measurements, actuators without lag, and no loads.

    Attributes:
        noise: rms value of the noise of each measured signal, in the unit of the signal; empty for exact measurements.
        bandwidth: corner frequency of the first-order lag of every actuator [rad/s]; None for actuators without lag.
        loads: loads on the body as additional disturbances, by name. Each value [N, N m] is the load to which a design gives
            the same weight as to a disturbance w of 1 m/s.
    """

    public_name = "design conditions, such as vehicle.hardware(name) returns"

    noise: tuple[float, ...] = ()
    bandwidth: float | None = None
    loads: tuple[tuple[str, float], ...] = ()

    @property
    def record(self) -> dict[str, Any]:
        """The design conditions (noise, loads and lag) as keys of a controller's section."""
        given = {"noise": any(self.noise), "loads": dict(self.loads), "lag": self.bandwidth is not None}
        return {key: value for key, value in given.items() if value}


NOMINAL = DesignConditions()


@dataclass(frozen=True, eq=False)
class ControllerEntry:
    """Controller that a vehicle file describes, created from a `ControllerSection`.

    Attributes:
        name: name of the controller.
        measured: names of the q measured signals.
        source: source of the control law: a `LinearLaw`, a `DesignRequest`, a `PythonLaw` or a `SemiActiveLaw`.
        certificate: certificate of a law whose numbers are in the file, as written by `roadproof synth --save`; None without a
            certificate.
        hardware: sensor noise, actuator lag and loads for which the controller is designed and certified.
        goals: goals for the design or evaluation of a gain; None for a design that minimises the norm.
        errors: uncertainties of measurements and forces with a frequency-dependent weight; None for a controller without these
            uncertainties.
        study: True for a theoretical study, in which the control law may measure heights above a flat datum.
        forced: True if the controller drives force actuators (`actuators = "force"`), even on a vehicle with semi-active
            dampers.
    """

    public_name = "an entry of vehicle.controllers"

    name: str
    measured: tuple[str, ...]
    source: "LinearLaw | DesignRequest | PythonLaw | SemiActiveLaw" = field(default_factory=DesignRequest)
    certificate: Mapping[str, Any] | None = None
    hardware: DesignConditions = NOMINAL
    goals: "Goals | None" = None
    errors: "WeightedErrors | None" = None
    study: bool = False
    forced: bool = False

    @property
    def named(self) -> tuple[str, ...]:
        """Signals that the controller uses: the measured signals, and the signals in the controller's goals."""
        return self.measured if self.goals is None else (*self.measured, *self.goals.signals)

    @property
    def linear(self) -> bool:
        """True if linear analysis applies to the control law."""
        return self.source.linear

    @property
    def law(self) -> LinearLaw | None:
        """The linear law if the file contains the numbers of the law; None otherwise."""
        return self.source.given

    @property
    def request(self) -> DesignRequest:
        """The design that the section requests; the default request for a law that is not designed."""
        return self.source.request or DesignRequest()

    @property
    def parts(self) -> dict[str, str]:
        """The source and the options of the controller, with keys and values as in a vehicle file.

        Each key of the result is also a row in the table that shows which options can be combined.
        """
        given = self.source.record | self.hardware.record | (self.goals.record if self.goals is not None else {})
        if self.errors is not None:
            given["tolerance"] = given.get("tolerance", {}) | self.errors.record
        parts = FEATURES.load("combinations of options").section_parts(given | {"study": self.study}, ())
        return parts | ({"states": "a law with states"} if "states" in parts else {})

    def driver(self, design: Design[T] = no_design, read: Callable[[], str] | None = None) -> "T | PythonController | SemiActive":
        """Returns the controller. For arguments and errors, see `LawSource.driver`."""
        return self.source.driver(self.name, self.measured, design, read)


def _measured_signals(value: Any, context: Mapping[str, Any]) -> tuple[str, ...]:
    """Returns the names of the measured signals after checking that the vehicle can measure these signals."""
    measurable, study = list_names(context["measurable"]), context.get("study", False)
    if not isinstance(value, list | tuple) or not value or not all(isinstance(signal, str) for signal in value):
        raise InputError(
            f'{HERE} = {short_repr(value)} is not a list of signals; give a list, as in ["NAME"], of signals from {measurable}'
        )
    for signal in value:
        if signal not in context["signals"]:
            raise InputError(
                f"{HERE}: unknown signal {short_repr(signal)}; measurable signals are {alike(signal, context['measurable'])}"
            )
        if value.count(signal) > 1:
            raise InputError(f"{HERE} contains {signal!r} twice; list this signal once")
        if signal in context["heights"] and not study:
            raise InputError(
                f"{HERE}: {signal!r} is an absolute height (above the datum of a flat road), which no sensor on a car "
                f"can measure; give study = true for a theoretical study, or choose signals from {measurable}"
            )
        if signal not in (*context["measurable"], *context["heights"]):
            raise InputError(
                f"{HERE}: {signal!r} depends on the road's height, but feedback may use only the state of the "
                f"vehicle; choose signals from {measurable}"
            )
    if study and not set(value) & set(context["heights"]):
        raise InputError(
            f"{HERE} contains no absolute height (above the datum of a flat road), but study = true affects only such "
            "heights; omit study"
        )
    return tuple(value)


def matrix_rows(value: Any, give: str, largest: float = np.inf) -> tuple[tuple[float, ...], ...]:
    """Returns the rows of a matrix of numbers.

    Args:
        value: a number, a row of numbers or rows of numbers.
        give: end of the error message for an invalid value, which describes a valid value.
        largest: largest allowed magnitude of an entry.
    """
    rows = value if isinstance(value, list | tuple) else [value]
    if not all(isinstance(row, list | tuple) and all(is_finite(x) and abs(x) <= largest for x in row) for row in rows):
        raise InputError(f"{HERE} = {short_repr(value)} is not a matrix of numbers; {give}")
    return tuple(tuple(float(x) for x in row) for row in rows)


def _gain(value: Any, context: Mapping[str, Any]) -> tuple[tuple[float, ...], ...]:
    """Returns the rows of a gain: one row for each force, with one number for each measured signal."""
    m, q = len(context["corners"]), len(context.get("measured", ()))
    give = f"give {m} row(s), one for each actuator, of {q} number(s), one for each measured signal, of at most {LARGEST:g} in "
    give += f"magnitude, as in gain = {[[1.0] * q] * m}"
    rows = matrix_rows(value, give, LARGEST)
    if len(rows) != m or any(len(row) != q for row in rows):
        raise InputError(f"{HERE} has {size(rows)}; {give}")
    return rows


NAMES = {"type": "array", "items": {"type": "string"}, "minItems": 1}
ROWS = {"type": "array", "items": {"type": "array", "items": {"type": "number"}}}


@dataclass(frozen=True, kw_only=True)
class SignalSection(Demands):
    """Keys that list the measured signals of a controller. The other keys of a controller's section refer to its measured
    signals.
    """

    study: Annotated[bool, Flag("for a study: the law measures heights above a flat datum, which no sensor measures")] = False
    measured: Annotated[tuple[str, ...], ReadBy("signals that the controller measures", _measured_signals, allowed=NAMES)] = ()


@dataclass(frozen=True, kw_only=True)
class GivenSection(SignalSection):
    """Keys of `[controllers.NAME]` for a static gain that the file contains, or that is designed in two steps.

    `ControllerSection` also has all other keys.
    """

    # Only other types of control laws have values for these keys and properties
    order = design = preview = goals = errors = None

    gain: Annotated[Any, ReadBy("static gain, one row for each force", _gain, allowed=ROWS)] = None
    certificate: Annotated[Mapping[str, Any], AnyTable("certificate of the law, by `roadproof synth --save`")] | None = None
    noise: Annotated[bool, Flag("design for the noise of `[implementation]`", " (other sections define the amount)")] = False
    lag: Annotated[bool, Flag("design for the lag of `[limits]`", " (other sections define the amount)")] = False
    sampled: Annotated[bool, Flag("whether to design for the sampled-data loop; default: as in `[implementation]`")] | None = None
    loads: (
        Annotated[Mapping[str, float], BySignal("loads that count as much as a road velocity of 1 m/s", "loads", SMALLEST)] | None
    ) = None
    actuators: (
        Annotated[str, Choice("force actuators instead of semi-active dampers", (PUSHING_ACTUATORS,), OTHERWISE)] | None
    ) = None

    def __post_init__(self) -> None:
        if self.certificate is not None and not self.given:
            raise InputError(
                "certificate is allowed only in a section that gives the certified gain or law; omit certificate, or give "
                "this gain or law"
            )
        if self.loads is not None and not self.loads:
            raise InputError(
                "loads = {} names no load; give each load with a size that the design weights like 1 m/s of road "
                "velocity, or omit loads"
            )

    @property
    def given(self) -> bool:
        """True if the section contains the numbers of a linear law, which are a gain here."""
        return self.gain is not None

    def linear_law(self, measured: Sequence[str], corners: Mapping[str, str]) -> LinearLaw | None:
        """Returns the linear law in the section; None if the section does not contain the numbers of a linear law.

        For the arguments, see `law_structure`.
        """
        return None if self.gain is None else static_law(np.array(self.gain))

    def law_structure(self, measured: Sequence[str], corners: Mapping[str, str]) -> LawStructure | None:
        """Returns the structure of a law that is designed; see `StructureSection`."""
        return None

    def program(self, folder: Path | None) -> "PythonLaw | None":
        """Returns the Python law or the FMU; see `ProgramSection`."""
        return None

    def semi_active_law(
        self, given: Sequence[str], outputs: Sequence[str], inputs: Sequence[str], endings: Mapping[str, str]
    ) -> "SemiActiveLaw | None":
        """Returns the semi-active law; see `SemiActiveSection`."""
        return None


def _section_class(given: Any) -> type[GivenSection]:
    """Returns the class that reads a section: `GivenSection`, or `ControllerSection` if the section has a key that
    `GivenSection` lacks.
    """
    few = not isinstance(given, Mapping) or {*given} <= {*keys(GivenSection)}
    return GivenSection if few else FEATURES.load("all keys of controllers").ControllerSection


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
    """Reads `[controllers]` and returns the controllers by name.

    Names are in the Unicode normal form NFC, in which names that look alike are equal.

    Args:
        section: the section `[controllers]`.
        model: linear model of the vehicle.
        limits: limits of the vehicle, for controllers that are designed for these limits.
        implementation: implementation of the controllers, for controllers that are designed for this implementation.
        kind: vehicle type.
        folder: folder of the vehicle file and of Python laws; None if the vehicle file was given as text.
        sampled: default of the key `sampled` in a controller's section.
        dampers: suffix of the signal names at the suspension of each semi-active damper, by name of the damper's control force.
    """
    controllers: dict[str, ControllerEntry] = {}
    facts: dict[str, Any] = {
        "signals": {name: kind.possible[name].unit for name in model.outputs},
        "measurable": model.measurable,
        "heights": model.heights,
        "corners": {force: kind.corners.get(force, "") for force in model.inputs},
        "parameters": {parameter.name: "1" for parameter in kind.parameters},
        "loads": {name: "N" if name.startswith(HEAVE_LOAD.name) else "N m" for name in model.loads},
    }
    for written, given in section.items():
        name = unicodedata.normalize("NFC", written)
        where = f"[controllers.{name}]"
        if name in controllers:
            raise InputError(
                f"{where} appears twice, with different Unicode characters that look the same; rename one of the two controllers"
            )
        check_name(where, name, RESERVED_NAMES)
        if not isinstance(given, Mapping) and written in keys(FEATURES.load("all keys of controllers").ControllerSection):
            raise InputError(
                f"[controllers] {written} is a key of a single controller; move {written} into a section [controllers.NAME]"
            )
        parts = _parts_together(where, given, model.inputs)
        asked = read(where, _section_class(given), given, **facts)
        with_samples = asked.sampled
        if with_samples is None:
            with_samples = sampled and FEATURES.load("combinations of options").goes("sampled", parts)
        with error_in(where):
            if with_samples and implementation.sample_period is None:
                raise InputError(NO_PERIOD)
            entry = _entry(
                name, asked, given, model, limits, implementation, facts["corners"], folder, dampers or {}, with_samples
            )
            goals = asked.goals if "goals" in parts else None
        if goals is not None and entry.request.structure is not None:
            goals = replace(goals, structure=None)
        controllers[name] = replace(entry, goals=goals, errors=asked.errors)
    return controllers


def _parts_together(where: str, given: Any, inputs: Sequence[str]) -> Mapping[str, str]:
    """Returns the parts of a controller's section after checking that they can be combined; see `models.laws.combinations`.

    A gain, or the two-step design, without options has nothing to be combined with, so no table of combinations is loaded.
    """
    if not isinstance(given, Mapping):
        return {}
    measured = given.get("measured")
    if {*given} <= KEYS_WITHOUT_OPTIONS and not (isinstance(measured, list) and any(name in inputs for name in measured)):
        return {"gain": "gain"} if "gain" in given else {"steps": "the default two-step design"}
    combinations = FEATURES.load("combinations of options")
    parts = combinations.section_parts(given, inputs)
    combinations.check_together(where, parts)
    return parts


def _entry(
    name: str,
    asked: GivenSection,
    given: Mapping[str, Any],
    model: LinearModel,
    limits: Limits,
    implementation: Implementation,
    corners: Mapping[str, str],
    folder: Path | None,
    dampers: Mapping[str, str],
    sampled: bool,
) -> ControllerEntry:
    """Returns the controller that a section describes.

    `read_controllers` later checks that the controller fits the other sections of the file.
    """
    forced = asked.actuators is not None
    dampers, limits = ({}, limits) if forced or not dampers else (dampers, limits.without_actuators)
    semi_active = asked.semi_active_law([key for key in given if key != "actuators"], model.outputs, model.inputs, dampers)
    if semi_active is not None:
        return ControllerEntry(name, semi_active.measured, semi_active, forced=forced)
    of_state, python, measurable = asked.design in OF_STATE, asked.program(folder), list_names(model.measurable)
    measured = asked.measured or (model.states if of_state else ())
    if not measured:
        raise InputError(f"measured is missing; give a list of signals from {measurable}")
    if not asked.given and python is None and set(measured) <= set(model.inputs):
        raise InputError(
            f"the measured control forces alone do not determine the state of the vehicle; add signals from {measurable}"
        )
    if of_state and set(measured) != set(model.states):
        instead = ', or give design = "lqg"' if asked.design == "lqr" else ""
        raise InputError(
            f'measured = {short_repr([*measured])} is not allowed, because design = "{asked.design}" uses the full state, '
            f"{list_names(model.states)}; omit measured{instead}"
        )
    if asked.design == PREVIEW and dampers:
        raise InputError(
            f'design = "{PREVIEW}" applies forces before the wheels reach a bump, but semi-active dampers can only '
            "resist motion, so they cannot apply these forces; choose a different design, or omit [actuators]"
        )
    request = DesignRequest(
        design=FULL if asked.order == FULL else asked.design or "",
        structure=asked.law_structure(measured, corners),
        preview=asked.preview or 0.0 if asked.design == PREVIEW else 0.0,
        sampled=sampled,
        **{key: getattr(asked, key) for key in keys(Demands)},
    )
    law = asked.linear_law(measured, corners)
    if asked.anti_windup is not None and law is not None:
        if not law.states:
            raise InputError("has anti_windup, but the law has no states that could wind up; omit anti_windup")
        law = replace(law, anti_windup=asked.anti_windup)
    if asked.anti_windup is not None and not dampers and limits.actuator_force is None and limits.force_rate is None:
        raise InputError(
            "has anti_windup, which acts only when forces are clipped, but no limit clips the forces; omit "
            'anti_windup, or give [limits] actuator_force or force_rate, or [actuators] kind = "damper"'
        )
    return ControllerEntry(
        name,
        measured,
        law or python or request,
        asked.certificate,
        _hardware(asked, measured, request, model.inputs, limits, implementation),
        study=asked.study,
        forced=forced,
    )


def _hardware(
    asked: GivenSection,
    measured: Sequence[str],
    request: DesignRequest,
    inputs: Sequence[str],
    limits: Limits,
    implementation: Implementation,
) -> DesignConditions:
    """Returns the sensor noise, actuator lag and loads for which a controller is designed."""
    noise = tuple(implementation.noise.get(signal, 0.0) for signal in measured) if asked.noise else ()
    if asked.noise and not any(noise):
        raise InputError(
            "has noise = true, but [implementation] gives no noise of the measured signals; give the rms in the "
            f"signal's unit, as in noise = {{ {measured[0]} = 0.01 }}, or omit noise = true"
        )
    forces = [signal for signal, rms in zip(measured, noise, strict=bool(noise)) if rms and signal in inputs]
    # A law that has separate gains for each force may measure forces like any other signal.
    by_force = request.structure is not None and request.structure.rows is not None
    if forces and not (asked.lag or by_force or request.two_steps):
        raise InputError(
            f"has noise = true, and [implementation] gives noise on {forces[0]!r}, but a design cannot account for "
            f"noise on a measured force; omit the noise on {forces[0]!r}"
        )
    if asked.lag and limits.actuator_bandwidth is None:
        raise InputError("has lag = true, but [limits] has no actuator_bandwidth; give actuator_bandwidth [rad/s], or omit lag")
    return DesignConditions(noise, limits.actuator_bandwidth if asked.lag else None, tuple((asked.loads or {}).items()))
