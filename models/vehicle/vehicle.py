"""Vehicle file (TOML): vehicle type, parameters, performance weights, controllers, and other sections."""

import importlib
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from models.common.arrays import Array
from models.common.checks import ReadOnly, check_fields
from models.common.errors import InputError, error_in, list_names, short_repr
from models.common.extensions import FEATURES, PARTS
from models.common.files import STDOUT, parse_toml, path_from, read_text
from models.common.schema import AnyTable, BySignal, Section, Text, keys, locate_errors, read
from models.document.document import Document
from models.document.text import ShownResult, facts
from models.kinds.kind import HERE, RidePoints, VehicleKind
from models.kinds.linear_model import LinearModel
from models.kinds.signals import names_of, of_dampers
from models.laws.law import Design, T
from models.parts.part import Parts
from models.vehicle.controllers import (
    NOMINAL,
    PUSHING_ACTUATORS,
    RESERVED_NAMES,
    ControllerEntry,
    DesignConditions,
    read_controllers,
)
from models.vehicle.limits_and_implementation import (
    Implementation,
    ImplementationSection,
    Limits,
    check_period,
    read_limits,
)
from models.vehicle.names import WITHOUT, named_files
from models.vehicle.performance import WeightedSum, check_weights, read_performance

if TYPE_CHECKING:
    from models.characteristics.adjustable_range import Damper
    from models.characteristics.curve import ForceCurve
    from models.document.figure import Figure
    from models.laws.filter import Filter
    from models.laws.python_law import PythonController
    from models.laws.semi_active import SemiActive
    from models.parts.element import Element


def kinds(folder: Path = HERE) -> list[str]:
    """Returns the sorted names of the vehicle types in a folder: all names with an equation file (`.py`) and an MJCF (`.xml`).

    Args:
        folder: the folder; by default, the folder of the built-in vehicle types.
    """
    return sorted(path.stem for path in folder.glob("*.xml") if path.with_suffix(".py").exists())


def shipped_vehicles() -> list[str]:
    """Returns the sorted names of the built-in vehicles. There is at least one vehicle of each built-in type."""
    return sorted(path.stem for path in HERE.glob("*.toml"))


def kind(name: str, folder: Path | None = None) -> VehicleKind:
    """Returns a vehicle type by name.

    Args:
        name: name of a built-in vehicle type, or of a custom type.
        folder: folder with the files `name.py` and `name.xml` of a custom type; None to allow only built-in types.

    Raises:
        InputError: the vehicle type does not exist, or the code of a custom vehicle type is wrong.
    """
    if name in kinds():
        return importlib.import_module(f"models.{name}").KIND
    own = kinds(folder) if folder else []
    if folder is None or name not in own:
        beside = f", or next to the vehicle file: {name}.py and {name}.xml" if folder else ""
        raise InputError(f"unknown vehicle type {name!r}; known: {list_names([*kinds(), *own])}{beside}")

    return FEATURES.load("vehicle types in Python").read_kind(folder, name)


Entries = Mapping[str, Any]
# Vehicle type by the `type` in a vehicle file, and by the plane of motion in the file
PLANES = {"half_car": {"pitch": "half_car", "roll": "half_car_roll"}}


def in_plane(name: str, plane: str) -> str:
    """Returns the vehicle type of a vehicle file that gives a plane of motion in addition to its `type`.

    Raises:
        InputError: the plane of motion is not available for the vehicle type.
    """
    planes = PLANES.get(name, {})
    if plane not in planes:
        repair = (
            f"give one of {list_names(planes)}" if planes else f"only the type {list_names(PLANES)} has a plane: omit the line"
        )
        raise InputError(f"plane = {short_repr(plane)} is not allowed for the type {short_repr(name)}; {repair}")
    return planes[plane]


@dataclass(frozen=True)
class VehicleFile(Section):
    """The sections of a vehicle file as tables that have not been checked. Each section is read by a function of its own."""

    type: Annotated[str, Text('vehicle type, above the first section: `type = "quarter_car"`', ', as in type = "quarter_car"')]
    parameters: Annotated[Entries, AnyTable("parameters of the vehicle type, as `roadproof new` writes them")]
    performance: Annotated[Entries, AnyTable("weights of signals, as `roadproof new` writes them")]
    controllers: Annotated[Entries, AnyTable("controllers by name")] = field(default_factory=dict)
    limits: Annotated[Entries, AnyTable("limits of the hardware")] = field(default_factory=dict)
    implementation: Annotated[Entries, AnyTable("sampling, delay and noise of controllers")] = field(default_factory=dict)
    curves: Annotated[Entries, AnyTable("curves of springs, dampers and motion ratios")] = field(default_factory=dict)
    actuators: Annotated[Entries, AnyTable("actuators, or semi-active dampers")] = field(default_factory=dict)
    payload: Annotated[Entries, AnyTable("point masses on the body")] = field(default_factory=dict)
    parts: Annotated[Entries, AnyTable("force elements of suspensions by name")] = field(default_factory=dict)
    start: Annotated[Entries, AnyTable("state at the start of runs, for drops and releases")] = field(default_factory=dict)
    seat: Annotated[Entries, AnyTable("a person on a seat above the body")] | None = None
    identified: Annotated[Entries, AnyTable("intervals of parameters, as roadproof identify writes them")] = field(
        default_factory=dict
    )
    plane: Annotated[str, Text("plane in which a half-car moves, below its type: pitch (default) or roll")] = ""


SECTIONS = tuple(keys(VehicleFile))
LIFTED, FASTEST = "height", 1e3  # key of the drop height in the section `[start]`; largest value that this section allows [SI]
PERSON = (
    " is the acceleration of a mass above the body, so its ride is evaluated like the ride of a person; list the points with "
    "a person under people in KIND of"
)


@dataclass(frozen=True, eq=False, repr=False)
class Vehicle(ShownResult):
    """Vehicle that a vehicle file describes: vehicle type, parameters, weights, controllers and hardware.

    The functions `read_vehicle` and `parse_vehicle` create vehicles.

    Attributes:
        kind: vehicle type, which contains the equations of motion and the MJCF.
        parameters: values of the parameters [SI], by name.
        performance: weight of each signal in the controlled output z (34).
        controllers: controllers by name, without `passive` and `state`, which always exist.
        text: text of the vehicle file. The matrices of control laws replace the names of the files that contain them, so the
            text can be stored in logs. For control laws in Python, the text still contains the file names.
        source: path of the vehicle file, for messages.
        limits: limits of actuators and suspensions.
        implementation: sampling, delay, noise and quantisation of the controller.
        named_files: files with matrices, vehicle families or tables that the vehicle file names.
        filters: filter from each weighted signal to z, by name of the signal; signals with a constant weight do not have a
            filter.
        road_filter: filter from the disturbance w to the road velocity under every wheel; None if w is the road velocity.
        sampled: True if `state` and, by default, all controllers are designed for the sampled loop.
        curves: characteristics of nonlinear dampers and springs, by the parameter that each characteristic replaces.
        dampers: semi-active dampers that replace actuators, by name of the control force.
        sums: weighted sums of signals in z (34); in z, the rows of sums follow the rows of single signals.
        elements: force elements of `[parts]`.
        force_limits: limits of the force actuators, for controllers with `actuators = "force"` on a vehicle with semi-active
            dampers; None for vehicles without semi-active dampers.
        start: initial state of runs relative to equilibrium, by name of the state; empty for a start in equilibrium. See
            `starting`.

    Raises:
        InputError: a parameter is missing, unknown or not allowed, a weight is not allowed, or a field has the wrong type.
    """

    kind: VehicleKind
    parameters: Mapping[str, float]
    performance: Mapping[str, float]
    controllers: Mapping[str, ControllerEntry]
    text: str = ""
    source: str = ""
    limits: Limits = field(default_factory=Limits)
    implementation: Implementation = field(default_factory=Implementation)
    named_files: tuple[Path, ...] = ()
    filters: Mapping[str, "Filter"] = field(default_factory=dict)
    road_filter: "Filter | None" = None
    sampled: bool = False
    curves: Mapping[str, "ForceCurve"] = field(default_factory=dict)
    dampers: Mapping[str, "Damper"] = field(default_factory=dict)
    sums: tuple[WeightedSum, ...] = ()
    force_limits: Limits | None = None
    elements: "tuple[Element, ...]" = ()
    start: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("parameters", "performance", "controllers"):
            object.__setattr__(self, name, ReadOnly(getattr(self, name)))
        self.kind.check_each(self.parameters)
        if self.elements or self.kind.of_parts:
            object.__setattr__(
                self,
                "kind",
                self.kind.with_states(FEATURES.load("parts in files").states_of(self.elements, self.kind.suspensions)),
            )
        names = {*self.performance}.union(*(one.terms for one in self.sums))
        object.__setattr__(self, "kind", self.kind.naming(names).with_wheel_loads(self.parameters))
        for name, weight in self.performance.items():
            if name not in self.kind.possible or weight < 0:
                known = list_names(signal.name for signal in self.kind.signals)
                raise InputError(f"performance: {name} = {weight:g} is not allowed; give weights of 0 or more for {known}")

    def starting(self, **start: float | str) -> "Vehicle":
        """Returns the vehicle with a new initial state for its runs, for drop and release tests.

        Args:
            start: initial values of states [SI], or texts with a unit, such as "20 mm". The names are states of the linear
                model, such as `suspension_deflection`, or `height`, the height by which the whole vehicle is lifted above the
                road. States that are not named start in equilibrium. Without arguments, the whole vehicle starts in
                equilibrium.

        Returns:
            A copy of the vehicle with the new initial state.

        Raises:
            InputError: a name is unknown, or a value is not a number in the unit of its state.

        Example:
            >>> from models import read_vehicle
            >>> read_vehicle("quarter_car").starting(height="50 mm").start_state
            array([0.  , 0.05, 0.  , 0.  ])
        """
        return replace(self, start=self._read_start(start))

    def _read_start(self, start: Mapping[str, Any]) -> dict[str, float]:
        units = {name: self.kind.signal(name).unit for name in self.linear_model.states} | {LIFTED: "m"}
        with locate_errors("[start]", []):
            return BySignal("", "states", -FASTEST, FASTEST).read(start, {"states": units}) if start else {}

    @cached_property
    def start_state(self) -> Array | None:
        """State from which runs start, relative to equilibrium, shape (n,); None for a start in equilibrium."""
        if not self.start:
            return None
        model = self.linear_model
        # A vehicle that is lifted is equivalent to a road that is lowered
        lifted = -self.start.get(LIFTED, 0.0) * model.jump.sum(axis=1)
        return lifted + [self.start.get(name, 0.0) for name in model.states]

    def with_parameters(self, **parameters: float | str) -> "Vehicle":
        """Returns the vehicle with new values of some parameters. The controllers of the vehicle do not change.

        Args:
            parameters: new values [SI], or texts with a unit, such as "450 kg". The method warns about improbable values.

        Returns:
            A copy of the vehicle with the new parameters.

        Raises:
            InputError: a parameter is unknown or not allowed, or the combination of parameters is not a valid vehicle.

        Example:
            >>> from models import read_vehicle
            >>> heavier = read_vehicle("quarter_car").with_parameters(sprung_mass=600.0)
            >>> heavier.parameters["sprung_mass"]
            600.0
        """
        vehicle, known = self.altered(self.kind.check_each({**self.parameters, **parameters})).checked(), self.warnings
        for doubt in vehicle.warnings:
            if doubt not in known:
                warnings.warn(doubt, stacklevel=2)
        return vehicle

    def altered(self, values: Mapping[str, float], **fields: Any) -> "Vehicle":
        """Returns the vehicle with new values of some parameters, without checks.

        Preloaded springs carry the static loads that belong to the new parameters.

        Args:
            values: new values [SI] by name of the parameter.
            fields: new values of further fields of the vehicle, by name of the field.
        """
        parameters = {**self.parameters, **values}
        if self.curves:
            rebalanced = FEATURES.load("curves of suspensions").rebalanced_curves
            fields |= {"curves": rebalanced(self.kind, self.curves, self.parameters, parameters)}
        return replace(self, parameters=parameters, **fields)

    def adjusted(self, force: str) -> bool:
        """Returns True if a semi-active damper replaces the passive damper of the suspension on which a control force acts."""
        return force in self.dampers and self.dampers[force].replaces

    @cached_property
    def parts(self) -> Parts:
        """Suspension forces at the wheels that act in addition to the forces of linear springs and dampers."""
        if not (self.curves or self.dampers or self.kind.ratios or self.limits.stopped or self.elements):
            return Parts()

        return FEATURES.load("parts").parts_of(self)

    @property
    def inertial(self) -> bool:
        """True if a suspension has a force that depends on the second derivative of its deflection."""
        return any(one.added_line.inertance for one in self.parts)

    @property
    def linearised(self) -> "Vehicle":
        """The vehicle for linear analysis, in which each characteristic is replaced by its tangent at equilibrium."""
        dampers = {force: replace(damper, pair=None) for force, damper in self.dampers.items()}
        straight = {name: replace(table, straight=True) for name, table in self.kind.ratios.items()}
        kind = replace(self.kind, ratios=straight) if straight else self.kind
        elements = tuple(one.straight for one in self.elements)
        return replace(self, kind=kind, curves={}, dampers=dampers, elements=elements) if self.parts.nonlinear else self

    @cached_property
    def linear_model(self) -> LinearModel:
        """Linear model of the vehicle, with the linearised forces of all parts."""
        return self._with_lines(self.kind.model(self.parameters))

    def _with_lines(self, model: LinearModel) -> LinearModel:
        """Returns a linear model of the vehicle type, to which the linearised forces of all parts are added."""
        more = [one for one in self.parts if one.added_line.sloped] if self.elements else []
        if not more:
            return model
        names, lines = [one.deflection for one in more], [one.added_line for one in more]
        slopes = ("stiffness", "damping", "inertance")
        stiffness, damping, inertance = (np.array([getattr(line, name) for line in lines]) for name in slopes)
        from models.kinds.at_wheels import force_effects

        rows, (push, shown) = model.rows(names)[0], force_effects(self.kind, self.parameters, names)
        # This force has no direct effect on the parts' internal states
        speeds, own = rows @ model.A, ((0, len(self.kind.of_parts)), (0, 0))
        model = FEATURES.load("lines of parts").with_own_states(
            model.with_lines(rows, push, shown, stiffness, damping), more, rows, speeds, push, shown
        )
        return model.with_inertance(np.pad(speeds, own[::-1]), np.pad(push, own), np.pad(shown, own), inertance)

    def force_effects(self, deflections: Sequence[str]) -> tuple[Array, Array]:
        """Returns the effect of suspension forces on the states and outputs of the linear model.

        A positive force pulls body and wheel together.

        Args:
            deflections: names of the deflection signals of e suspensions.

        Returns:
            Effects of a unit force on the derivatives of the n states, shape (n, e), and on the p outputs, shape (p, e). If a
            part has an inertance, a share of each force accelerates the inertance.
        """
        from models.kinds.at_wheels import force_effects

        push, shown = force_effects(self.kind, self.parameters, deflections)
        if not self.elements:
            return push, shown
        names = tuple(f"pull_{i}" for i in range(len(deflections)))
        model = self._with_lines(replace(self.kind.model(self.parameters), loads=names, Bl=push, Dl=shown))
        return model.Bl, model.Dl

    @property
    def sensed_signals(self) -> tuple[str, ...]:
        """Output signals of the linear model that have a MuJoCo sensor: all signals except the internal states of parts."""
        outputs = self.linear_model.outputs
        return outputs[: len(outputs) - len(self.kind.of_parts)]

    @cached_property
    def ride_points(self) -> RidePoints:
        """The points of the vehicle at which ride comfort is measured."""
        return self.kind.ride_points(self.linear_model)

    @cached_property
    def motion_ratios(self) -> Mapping[str, float]:
        """Motion ratio of every control force, in the order of the linear model's inputs."""
        return self.kind.motion_ratios(self.parameters, self.linear_model.inputs)

    @property
    def summary(self) -> Document:
        """Overview: a text with the vehicle type and file, then parameters, weights and controllers."""
        from models.kinds.at_wheels import ratio_notes

        units = {parameter.name: parameter.unit for parameter in self.kind.parameters}
        return facts(
            f"vehicle: {self.kind.name}{f', {self.source}' if self.source else ''}",
            {
                "parameters": ", ".join(f"{name} {value:g} {units[name]}".rstrip() for name, value in self.parameters.items()),
                **({"with motion ratios": "; ".join(notes)} if (notes := ratio_notes(self.kind, self.parameters)) else {}),
                "weights": ", ".join(f"{name} {weight:g}" for name, weight in self.performance.items() if weight),
                "controllers": ", ".join(("passive", "state", *self.controllers)),
            },
        )

    @property
    def figures(self) -> "tuple[Figure, ...]":
        """Figure of the gain from the road velocity to the weighted signals, for the vehicle without control."""

        model = self.linear_model
        weights = np.array([self.performance.get(name, 0.0) for name in model.outputs])[:, None]
        title = "Largest singular value without control, from the road's velocity to the weighted signals."
        return (
            FEATURES.load("figures in notebooks").gain_figure(title, model.A, model.Bw, weights * model.C, weights * model.Dw),
        )

    @cached_property
    def with_ideal_actuators(self) -> "Vehicle":
        """The vehicle with ideal force actuators instead of its semi-active dampers."""
        if not self.dampers:
            return self
        names = {name for damper in self.parts.adjustable for name in (damper.coefficient, damper.missing)}
        signals = tuple(signal for signal in self.kind.signals if signal.name not in names)
        damping = {suspension.force: suspension.damping for suspension in self.kind.suspensions}
        curves = {
            damping[damper.force]: damper.nominal_curve for damper in self.parts.adjustable if damper.nominal_curve is not None
        }
        return replace(self, dampers={}, kind=replace(self.kind, signals=signals), curves={**self.curves, **curves})

    @cached_property
    def with_force_actuators(self) -> "Vehicle":
        """The vehicle with the force actuators that controllers with `actuators = "force"` drive, limited by `[limits]`."""
        return replace(self.with_ideal_actuators, limits=self.force_limits or self.limits, force_limits=None)

    def with_actuators_of(self, name: str) -> "Vehicle":
        """Returns the vehicle with the actuators that a controller drives: its semi-active dampers, or force actuators."""
        forced = bool(self.dampers) and name in self.controllers and self.controllers[name].forced
        return self.with_force_actuators if forced else self

    def with_common_actuators(self, names: Sequence[str]) -> "Vehicle":
        """Returns the vehicle with the type of actuator that all named controllers drive.

        `passive` and `state` can be combined with both types of actuator.

        Raises:
            InputError: some of the controllers drive semi-active dampers, and some drive force actuators.
        """
        named = [name for name in names if name in self.controllers]
        pushing = [name for name in named if self.with_actuators_of(name) is not self]
        others = [name for name in named if name not in pushing]
        if pushing and others:
            raise InputError(
                f"{list_names(pushing)} drive force actuators, and {list_names(others)} drive semi-active dampers, "
                "but this command accepts only one kind of controller; use --controller to select controllers of one "
                "kind"
            )
        return self.with_force_actuators if pushing else self

    def without(self, part: str) -> "Vehicle":
        """Returns the vehicle without one part of its limits or implementation; a vehicle without this part is returned
        unchanged.

        Args:
            part: omitted part: `noise` (measurement noise and quantisation), `delay` (of the forces), `limits`
                (largest force and bump stops) or `lag` (of actuators or valves).

        Raises:
            InputError: `part` is not the name of a part.
        """
        if part not in WITHOUT:
            raise InputError(f"without: unknown part {part!r}; the parts are {list_names(WITHOUT)}")
        how, dampers = self.implementation, self.dampers
        how = how.without_noise if part == "noise" else replace(how, delay=0) if part == "delay" else how
        if part == "lag":
            dampers = {force: replace(damper, bandwidth=None) for force, damper in dampers.items()}
        pushing = self.force_limits and self.force_limits.without(part)
        parts = {"limits": self.limits.without(part), "force_limits": pushing, "implementation": how, "dampers": dampers}
        return self if all(getattr(self, name) == one for name, one in parts.items()) else replace(self, **parts)

    @property
    def filtered(self) -> bool:
        """True if a weight of z or of the road depends on frequency; such a weight adds states to the design plant."""
        return bool(self.filters) or self.road_filter is not None or any(one.filter is not None for one in self.sums)

    @cached_property
    def integrals(self) -> Mapping[str, Mapping[str, float]]:
        """Integrators that the weights of z add to the states of the design plant.

        The result maps the name of each integrator state to the factors of the signals that the state integrates.
        """
        different: dict[str, Mapping[str, float]] = {}
        for row in self.weighted:
            if row.filter is not None and row.filter.residue and row.terms not in different.values():
                different[f"integral_of_{row.name}"] = row.terms
        return different

    @property
    def weighted(self) -> tuple[WeightedSum, ...]:
        """Rows of z (34): every signal with a weight above 0, then the sums."""
        signals = [
            WeightedSum(name, weight, {name: 1.0}, self.filters.get(name))
            for name, weight in self.performance.items()
            if weight > 0
        ]
        return (*signals, *self.sums)

    @property
    def without_integrals(self) -> "Vehicle":
        """The vehicle without the integrators in the controlled output z. The pole at 0 of each filter is removed; all other
        poles of the filter remain.
        """
        if not self.integrals:
            return self
        rest = {name: one.without_integral for name, one in self.filters.items()}
        weights = {name: 0.0 if rest.get(name, name) is None else weight for name, weight in self.performance.items()}
        sums = [(one, one.filter and one.filter.without_integral) for one in self.sums]
        return replace(
            self,
            performance=weights,
            filters={name: one for name, one in rest.items() if one is not None},
            sums=tuple(replace(one, filter=left) for one, left in sums if left is not None or one.filter is None),
        )

    def summed(self, values: Array, axis: int = -1) -> Array:
        """Returns the values of the output signals, followed by the values of the unweighted sums of signals in z.

        Args:
            values: values of the p output signals along one axis.
            axis: axis of the output signals.
        """
        if not self.sums:
            return values
        outputs = self.linear_model.outputs
        mix = np.array([[one.terms.get(name, 0.0) for name in outputs] for one in self.sums])
        more = np.moveaxis(np.moveaxis(values, axis, -1) @ mix.T, -1, axis)
        return np.concatenate([values, more], axis=axis)

    def weights(self, omega: Array) -> Array:
        """Returns the frequency response of the weight of each output signal and sum in the controlled output z (34).

        Args:
            omega: angular frequencies [rad/s], shape (F,).

        Returns:
            Complex weights, shape (F, p), with a row per frequency, and with a column per output signal and then per sum.
        """
        ones = np.ones(len(omega), dtype=complex)
        return np.stack(
            [
                self.performance.get(name, 0.0) * (self.filters[name].response(omega) if name in self.filters else ones)
                for name in self.linear_model.outputs
            ]
            + [one.weight * (ones if one.filter is None else one.filter.response(omega)) for one in self.sums],
            axis=-1,
        )

    def road_shape(self, omega: Array) -> Array:
        """Returns the frequency response from the disturbance w to the road velocity, complex, shape (F,); 1 without a filter.

        Args:
            omega: angular frequencies [rad/s], shape (F,).
        """
        return np.ones(len(omega), dtype=complex) if self.road_filter is None else self.road_filter.response(omega)

    @property
    def files(self) -> tuple[Path, ...]:
        """All files that define the vehicle: vehicle file, control laws, roads in peak bounds, and vehicle type."""
        entries, own = self.controllers.values(), (Path(self.source),) if self.source else ()
        laws = (*self.named_files, *(entry.source.path for entry in entries if entry.source.path))
        roads = named_files(road for entry in entries if entry.goals is not None for road in entry.goals.roads)
        return (*own, *laws, *roads, self.kind.mjcf, self.kind.mjcf.with_suffix(".py"))

    @property
    def unladen(self) -> "Vehicle":
        """The vehicle without the payload in `[payload]` of the vehicle file; a vehicle without payload is unchanged."""
        toml_value = FEATURES.load("editing of TOML").toml_value
        data = parse_toml(self.text)
        if not data.pop("payload", None):
            return self
        text = "\n".join(f"{key} = {toml_value(value)}" for key, value in data.items())
        return parse_vehicle(text, self.source, Path(self.source).parent if self.source else None)

    def text_for(self, path: Path) -> str:
        """Returns the text of a vehicle file that describes this vehicle and will be saved at the given path.

        Paths of Python laws in the text are relative to the folder of the saved file.

        Raises:
            InputError: a vehicle file at this path could not be read, because a law or the vehicle type is in another folder.
        """

        laws = {name: entry.source for name, entry in self.controllers.items()}
        folder = Path(self.source).parent if path == STDOUT else path.parent
        try:
            text = FEATURES.load("files named in vehicle files").text_in(folder, self.text, laws)
            parse_vehicle(text, folder=folder)
        except InputError as error:
            raise InputError(
                f"--save {path}: a vehicle file at this path could not be read again ({error}), because the vehicle "
                "refers to files in another folder; give a path in the folder of the vehicle file that was read"
            ) from error
        return text

    @property
    def ideal(self) -> bool:
        """True if the vehicle file has neither limits nor an implementation."""
        return self.limits == Limits() and self.implementation.ideal

    def checked(self) -> "Vehicle":
        """Returns the vehicle after checking the combination of parameters and weights, unlike `dataclasses.replace`.

        Raises:
            InputError: the combination is not a valid vehicle, or does not fit its characteristics, dampers or filters.
        """
        parameters = self.kind.check(self.parameters)
        outputs = (*self.kind.full_model(parameters).outputs, *names_of(self.kind.of_parts))
        check_weights(self.performance, self.sums, outputs)
        filters = {signal: one for signal, one in self.filters.items() if self.performance.get(signal)}
        sound = replace(self, kind=self.kind.naming(self.performance), parameters=parameters, filters=filters)
        _ = sound.parts  # this line raises an InputError if the parameters do not fit the dampers
        return sound

    @cached_property
    def warnings(self) -> list[str]:
        """Warnings about characteristics, and about numbers that probably have a wrong unit or are swapped."""
        pairs = [damper.pair for damper in self.dampers.values() if damper.pair is not None]
        curves = {**self.curves, **{name: one for pair in pairs for name, one in (("c_min", pair.soft), ("c_max", pair.hard))}}
        about_numbers = FEATURES.load_if_known("doubts about numbers")
        doubts = about_numbers.vehicle_remarks(self) if about_numbers else []
        if curves or self.dampers or self.limits.stopped:
            doubts += FEATURES.load("doubts about parts").suspension_doubts(self)
        if curves:
            doubts += FEATURES.load("curves of suspensions").curve_notes(curves, self.kind, self.parameters)
        if self.kind.ratios:
            doubts += FEATURES.load("curves of suspensions").ratio_doubts(self.kind, self.parts.strokes)
        return [
            *doubts,
            *(f"{name}{PERSON} {self.kind.name}.py" for name in self.ride_points.people if not self.ride_points.named),
        ]

    @property
    def controller_names(self) -> tuple[str, ...]:
        """Names of all controllers of the vehicle."""
        return (*RESERVED_NAMES, *self.controllers)

    @property
    def linear_names(self) -> tuple[str, ...]:
        """Names of the controllers to which linear analysis applies: all except Python laws and semi-active laws."""
        return (*RESERVED_NAMES, *(name for name, entry in self.controllers.items() if entry.linear))

    def driver(self, name: str, design: Design[T], read: Callable[[], str] | None = None) -> "T | PythonController | SemiActive":
        """Returns the controller with the given name, which may also be `passive` or `state`.

        For arguments and errors, see `LawSource.driver`.
        """
        return self.controllers[name].driver(design, read) if name in self.controllers else design(name)

    def located(self, error: InputError) -> InputError:
        """Returns the error with a message that begins with the name of the vehicle file."""
        return InputError(f"vehicle file {self.source}: {error}" if self.source else str(error))

    def check_entry(self, entry: ControllerEntry) -> None:
        """Checks the sample period and the measured signals of a controller.

        Raises:
            InputError: the sample period differs from that of the implementation, or a measured force has no sensor.
        """
        check_period(entry.name, entry.source.sample_period, self.implementation)
        if (self.filters or self.sums) and self.integrals:
            FEATURES.load("weights with filters").check_integrals(entry, self.integrals, self.implementation.noise, self.sampled)
        if self.dampers and not entry.forced:
            PARTS.load("adjustable damper").check_measured(entry.name, entry.measured, self)

    def hardware(self, name: str) -> DesignConditions:
        """Returns sensor noise, actuator lag and loads for the design of a controller; for a built-in controller, the design
        uses none.
        """
        return self.controllers[name].hardware if name in self.controllers else NOMINAL

    def linear_entry(self, name: str) -> ControllerEntry:
        """Returns the entry of a controller to which linear analysis applies.

        Raises:
            InputError: the vehicle file has no controller with the name, or the controller's law is a Python law or a
                semi-active law.
        """
        if name not in self.controllers:
            raise InputError(f"unknown controller {name!r}; this vehicle has {list_names(self.controller_names)}")
        entry = self.controllers[name]
        if not entry.linear:
            raise InputError(
                f"controller {name!r} is {entry.source.title}, which has no linear loop; give a different controller, "
                "or simulate this one with sim.bump, sim.drive, sim.sweep, sim.campaign or sim.report"
            )
        return entry


def read_vehicle(file: str | Path) -> Vehicle:
    """Reads a vehicle file, or a built-in vehicle by name, such as "quarter_car".

    Args:
        file: path of a vehicle file, or name of a built-in vehicle.

    Returns:
        The vehicle that the file describes, with parameters in SI units.

    Raises:
        InputError: the file is missing or is not TOML, or a key is missing, unknown or not allowed. The message gives the file
            and the key.

    Example:
        >>> from models import read_vehicle
        >>> vehicle = read_vehicle("quarter_car")
        >>> vehicle.parameters["sprung_mass"], vehicle.linear_model.A.shape
        (504.5, (4, 4))
    """
    path = path_from(file)
    if str(file) in shipped_vehicles() and not path.is_file():
        path = HERE / f"{file}.toml"
    text = read_text(path, "vehicle file", f"give a TOML file or one of: {list_names(shipped_vehicles())}")
    with error_in(f"vehicle file {path}:"):
        whole, files = resolved_text(text, path.parent)
        return replace(parse_vehicle(whole, source=str(path), folder=path.parent), named_files=files)


def resolved_text(text: str, folder: Path) -> tuple[str, tuple[Path, ...]]:
    """Replaces the names of files in the text of a vehicle file by the contents of these files.

    Returns:
        The complete text, and the paths of the files whose contents it contains.

    Raises:
        InputError: the text is not TOML, or a file that it names is missing or invalid.
    """
    if not re.search(r"\bfamily\b|\b(file|stop)\b[\"']?\s*[=\]]", text):
        return text, ()

    return FEATURES.load("files named in vehicle files").with_contents(text, folder)


def parse_vehicle(text: str, source: str = "", folder: Path | None = None) -> Vehicle:
    """Returns a vehicle from the text of a vehicle file.

    Args:
        text, source: the text of a vehicle file in TOML, and the path of the vehicle file, for messages.
        folder: folder with custom vehicle types and Python laws; None allows only built-in types, and Python laws cannot run.

    Returns:
        The vehicle that the file describes, with parameters in SI units.

    Raises:
        InputError: the text names a file, which only `read_vehicle` would read, or is invalid for a reason that `read_vehicle`
            lists.

    Example:
        >>> from models import parse_vehicle, read_vehicle
        >>> parse_vehicle(read_vehicle("quarter_car").text.replace("= 504.5", "= 600")).parameters["sprung_mass"]
        600.0
    """
    given = read("", VehicleFile, parse_toml(text))
    vehicle_kind = kind(in_plane(given.type, given.plane) if given.plane else given.type, folder)
    numbers = given.parameters
    if given.seat is not None:
        vehicle_kind, numbers = FEATURES.load("seats").read_seat(given.seat, vehicle_kind, numbers)
    curves = dict[str, "ForceCurve"]()
    if given.curves:
        curves_and_parameters = FEATURES.load("curves of suspensions").curves_and_parameters
        curves, numbers, vehicle_kind = curves_and_parameters(given.curves, numbers, vehicle_kind)
    with error_in("[parameters]"):
        checked = vehicle_kind.check_each(numbers)
    parameters = vehicle_kind.check(checked)
    limits = read_limits(given.limits, vehicle_kind.suspensions) if given.limits else Limits()
    if given.payload:
        parameters, limits, vehicle_kind = FEATURES.load("payload").apply_payload(
            given.payload, vehicle_kind, parameters, limits, curves
        )
    model, elements = vehicle_kind.full_model(parameters), ()
    if given.parts:
        element = FEATURES.load("parts in files")
        elements = element.read_elements(given.parts, [part.corner for part in vehicle_kind.suspensions], parameters)
        if states := element.states_of(elements, vehicle_kind.suspensions):
            vehicle_kind = vehicle_kind.with_states(states)
            model = model.with_states(names_of(states), np.zeros((len(states), len(model.A))))
    implementation, sampled, corners = Implementation(), False, vehicle_kind.corners
    if given.implementation:
        units = {name: vehicle_kind.possible[name].unit for name in model.measurable}
        section = read("[implementation]", ImplementationSection, given.implementation, signals=units)
        implementation, sampled = section.implementation, section.sampled
    dampers = dict[str, "Damper"]()
    if given.actuators or elements:
        forced = any(isinstance(one, Mapping) and one.get("actuators") == PUSHING_ACTUATORS for one in given.controllers.values())
        limited = () if forced else limits.of_actuators
        dampers = FEATURES.load("adjustable dampers").read_actuators(given.actuators, corners, limited)
        if any(one.part.settable is not None for one in elements):
            dampers |= FEATURES.load("settable parts").element_dampers(
                elements, vehicle_kind.suspensions, given.actuators, limited
            )
    endings = {force: ending for force, ending in corners.items() if force in dampers}
    controllers = read_controllers(given.controllers, model, limits, implementation, vehicle_kind, folder, sampled, endings)
    weights = read_performance(given.performance, model.outputs)
    named = {*weights["performance"], *implementation.noise, *implementation.quantisation}
    for signals in (*(entry.named for entry in controllers.values()), *(one.terms for one in weights["sums"])):
        named.update(signals)
    for part in vehicle_kind.suspensions:
        curved = part.force in dampers and dampers[part.force].pair is not None
        placed = any(part.corner in one.corners for one in elements)
        if placed or curved or {part.stiffness, part.damping, part.ratio} & {*curves, *vehicle_kind.ratios}:
            named.add(part.velocity.name)
    vehicle_kind = vehicle_kind.naming(named)
    if dampers:
        own = of_dampers({ending: dampers[force].replaces for force, ending in endings.items()})
        vehicle_kind = replace(vehicle_kind, signals=(*vehicle_kind.signals, *own))
    vehicle = Vehicle(
        kind=vehicle_kind,
        parameters=parameters,
        **weights,
        controllers=controllers,
        text=text,
        source=source,
        limits=limits.without_actuators if dampers else limits,
        force_limits=limits if dampers else None,
        implementation=implementation,
        sampled=sampled,
        curves=curves,
        dampers=dampers,
        elements=elements,
    )
    if given.start:
        vehicle = vehicle.starting(**given.start)
    if dampers or vehicle_kind.ratios:
        # This line raises an InputError if the parts do not fit each other or have too many segments
        _ = vehicle.parts.with_curve
    for entry in controllers.values():
        vehicle.check_entry(entry)
    return vehicle
