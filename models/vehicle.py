"""A vehicle file (TOML): the kind of vehicle, its parameters, the performance weights and the controllers. All a user writes."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError, listing, quoted
from models.common.read_file import TEXT, read_text
from models.common.toml import parse_toml
from models.controllers import IDEAL, RESERVED, ControllerEntry, Hardware, read_controllers
from models.curves.curve import Curve
from models.curves.fitted import Fitted, curvable, fitted, with_slopes
from models.curves.reading import read_curves
from models.curves.table_file import with_tables
from models.damping.adjustable import Adjustable, adjustable, check_measured
from models.damping.damper import Damper, read_actuators
from models.filters.filter import Filter
from models.filters.performance import read_performance
from models.formats.family_file import with_families
from models.formats.law_file import with_laws
from models.formats.road_name import named_file
from models.goals.goals import PeakBound, signals_of
from models.kind import HERE, VehicleKind
from models.kinds import kind, kinds, shipped
from models.law import check_period
from models.linear_model import LinearModel
from models.reality import Implementation, Limits, read_implementation, read_limits, read_sampled
from models.signals import of_dampers

SECTIONS = ("type", "parameters", "performance", "controllers", "limits", "implementation", "curves", "actuators")


@dataclass(frozen=True, eq=False)
class Vehicle:
    """A vehicle, as its file says.

    Attributes:
        kind: equations and MJCF.
        parameters: SI values by name.
        performance: weight of each signal in the controlled output z (34).
        controllers: by name, without `passive` and `state`, which always exist.
        text: the vehicle file, as read, with the matrices of laws in place of the files that it names; it goes into the logs.
            Laws in Python stay named.
        source: where it came from, for messages.
        limits: where the hardware ends.
        implementation: the controller as it would be built.
        law_files: the files with matrices, those with families, and those with tables.
        filters: what a weighted signal goes through on its way into z, by signal; those of a constant weight are not in it.
        road_filter: what the disturbance w goes through to the road's velocity under every wheel, where that is not w itself.
        sampled: whether designs are for the loop that the computer closes, `state` and all whose sections do not say otherwise.
        curves: of dampers and springs, by the parameter that each stands in for.
        dampers: the suspensions that have an adjustable damper where others have an actuator, by force.
    """

    kind: VehicleKind
    parameters: Mapping[str, float]
    performance: Mapping[str, float]
    controllers: Mapping[str, ControllerEntry]
    text: str = ""
    source: str = ""
    limits: Limits = field(default_factory=Limits)
    implementation: Implementation = field(default_factory=Implementation)
    law_files: tuple[Path, ...] = ()
    filters: Mapping[str, Filter] = field(default_factory=dict)
    road_filter: Filter | None = None
    sampled: bool = False
    curves: Mapping[str, Curve] = field(default_factory=dict)
    dampers: Mapping[str, Damper] = field(default_factory=dict)

    @cached_property
    def fitted(self) -> tuple[Fitted, ...]:
        """The curves of its suspensions, scaled to its parameters."""
        dampers = {self.kind.pushed(one.force): one.standing for one in self.adjustable}
        return fitted(self.kind.suspensions, self.curves, self.parameters, dampers)

    @property
    def straight(self) -> "Vehicle":
        """The vehicle of linear analysis: every curve is its line at rest."""
        dampers = {force: replace(one, pair=None) for force, one in self.dampers.items()}
        return replace(self, curves={}, dampers=dampers) if self.fitted else self

    @cached_property
    def linear_model(self) -> LinearModel:
        """The linear model of these parameters."""
        return self.kind.model(self.parameters)

    @cached_property
    def adjustable(self) -> tuple[Adjustable, ...]:
        """Its adjustable dampers, in the order of its forces."""
        return adjustable(self.dampers, self.kind.suspensions, self.parameters, self.curves)

    @cached_property
    def pushing(self) -> "Vehicle":
        """It with actuators that push in place of its adjustable dampers, so that every force is given that is asked for."""
        if not self.dampers:
            return self
        names = {name for one in self.adjustable for name in (one.coefficient, one.missing)}
        signals = tuple(signal for signal in self.kind.signals if signal.name not in names)
        of = {one.force: one.damping for one in self.kind.suspensions}
        curves = {of[one.force]: one.standing for one in self.adjustable if one.standing is not None}
        return replace(self, dampers={}, kind=replace(self.kind, signals=signals), curves={**self.curves, **curves})

    @property
    def filtered(self) -> bool:
        """Whether a weight of z or of the road depends on frequency, so that a design knows more states than the vehicle's."""
        return bool(self.filters) or self.road_filter is not None

    def weights(self, omega: Array) -> Array:
        """The weight of every output signal in the controlled output z (34) by frequency, complex, shape (F, p).

        Args:
            omega: angular frequencies [rad/s], shape (F,).
        """
        ones = np.ones(len(omega), dtype=complex)
        return np.stack(
            [
                self.performance.get(name, 0.0) * (self.filters[name].response(omega) if name in self.filters else ones)
                for name in self.linear_model.outputs
            ],
            axis=-1,
        )

    def road_shape(self, omega: Array) -> Array:
        """The road's velocity per disturbance w by frequency, complex, shape (F,); one without a filter.

        Args:
            omega: angular frequencies [rad/s], shape (F,).
        """
        return np.ones(len(omega), dtype=complex) if self.road_filter is None else self.road_filter.response(omega)

    @property
    def kind_files(self) -> tuple[Path, ...]:
        """The files that its kind was read from."""
        return self.kind.mjcf, self.kind.mjcf.with_suffix(".py")

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that are read for it: its own, unless it is text alone, those of laws and bounds' roads, and its kind's."""
        entries, own = self.controllers.values(), (Path(self.source),) if self.source else ()
        laws = (*self.law_files, *(entry.python.path for entry in entries if entry.python and entry.python.path))
        bounds = [bound for entry in entries if entry.goals for bound in entry.goals.bounds]
        named = (named_file(bound.road) for bound in bounds if isinstance(bound, PeakBound))
        roads = (Path(file[0]) for file in named if file)
        return (*own, *laws, *roads, *self.kind_files)

    @property
    def ideal(self) -> bool:
        """Whether the file says nothing of limits and of the controller as it would be built."""
        return self.limits == Limits() and self.implementation.ideal

    def checked(self) -> "Vehicle":
        """The same, its parameters and weights checked as a vehicle file's are: what `dataclasses.replace` was given was not.

        Raises:
            InputError: one is missing, unknown or not allowed.
        """
        parameters = self.kind.check(self.parameters)
        performance, filters, road_filter = read_performance(self.performance, self.kind.whole_model(parameters).outputs)
        sound = replace(self, kind=self.kind.naming(performance), parameters=parameters)
        adjustable(self.dampers, self.kind.suspensions, parameters, self.curves)
        filters = {signal: one for signal, one in {**self.filters, **filters}.items() if performance.get(signal)}
        return replace(sound, performance=performance, filters=filters, road_filter=road_filter or self.road_filter)

    @property
    def controller_names(self) -> tuple[str, ...]:
        """Every controller that can be asked for."""
        return (*RESERVED, *self.controllers)

    @property
    def linear_names(self) -> tuple[str, ...]:
        """Those of them of which linear analysis speaks: all but laws in Python and semi-active ones."""
        return (*RESERVED, *(name for name, entry in self.controllers.items() if entry.linear))

    def found_wrong(self, error: InputError) -> InputError:
        """What was found wrong of it when it was worked with, with the file that it stands in, as where it is read."""
        return InputError(f"vehicle file {self.source}: {error}" if self.source else str(error))

    def check_entry(self, entry: ControllerEntry) -> None:
        """Refuses a controller of another sample period than it is built with, or that measures what no sensor tells."""
        check_period(entry.name, entry.law, self.implementation)
        check_measured(entry.name, entry.measured, self.dampers)

    def hardware(self, name: str) -> Hardware:
        """What of sensors and actuators a controller of that name is designed for; of `passive` and `state` nothing."""
        return self.controllers[name].hardware if name in self.controllers else IDEAL

    def linear_entry(self, name: str) -> ControllerEntry:
        """What the file says of a controller, of which linear analysis speaks.

        Raises:
            InputError: the file has none of that name, or it is a law in Python.
        """
        if name not in self.controllers:
            raise InputError(f"unknown controller {name!r}; this vehicle has {listing(self.controller_names)}")
        entry = self.controllers[name]
        if not entry.linear:
            what = "law in Python, " + entry.python.law if entry.python else "semi-active law"
            raise InputError(
                f"controller {name!r} is a {what}, of which there is no linear claim, and here is nothing else; sim.bump, "
                "sim.drive, sim.sweep, sim.campaign and sim.report drive it: name another one here"
            )
        return entry


def read_vehicle(file: str | Path, own_kinds: bool = True) -> Vehicle:
    """Reads a vehicle file, or a vehicle that ships, by name (`quarter_car`).

    Args:
        file: its path, or name.
        own_kinds: whether it may be of a kind that does not ship, whose Python is then run.

    Raises:
        InputError: it is not there, not TOML, or something in it is missing, unknown or not allowed: file, key, what is.
    """
    path = Path(file)
    if str(file) in shipped() and not path.is_file():
        path = HERE / f"{file}.toml"
    text = read_text(path, "vehicle file", TEXT, f"give a TOML file or one of: {listing(shipped())}")
    try:
        if not own_kinds and (name := parse_toml(text).get("type")) not in kinds():
            raise InputError(
                f"type = {quoted(name)} is a kind of somebody's own, whose Python would be run, and that is not asked for"
            )
        (whole, families), folder = with_families(text, path.parent), path.parent
        whole, laws = with_laws(whole, folder)
        whole, tables = with_tables(whole, folder)
        return replace(parse_vehicle(whole, source=str(path), folder=folder), law_files=(*families, *laws, *tables))
    except InputError as error:
        raise InputError(f"vehicle file {path}: {error}") from error


def parse_vehicle(text: str, source: str = "", folder: Path | None = None) -> Vehicle:
    """A vehicle from the text of its file.

    Args:
        text: TOML.
        source: where it came from, for messages.
        folder: where a kind of vehicle of the user's own may lie, and laws in Python; without one, only those kinds that ship are
            known, and no such law can be run.

    Raises:
        InputError: see `read_vehicle`; or it names a file for a law, which is read for a vehicle file alone, not for text.
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
    curves = read_curves(data.get("curves", {}), curvable(vehicle_kind.suspensions))
    parameters = vehicle_kind.check(with_slopes(data["parameters"], curves))
    model = vehicle_kind.whole_model(parameters)
    limits, implementation = (
        read_limits(data.get("limits", {}), vehicle_kind.suspensions),
        read_implementation(data.get("implementation", {}), model.measurable),
    )
    sampled = read_sampled(data.get("implementation", {}))
    section = data.get("controllers", {})
    dampers = read_actuators(data.get("actuators", {}), vehicle_kind.corners, limits.of_actuators)
    adjusted = adjustable(dampers, vehicle_kind.suspensions, parameters, curves)
    endings = {one.force: one.ending for one in adjusted}
    controllers = read_controllers(section, model, limits, implementation, folder, sampled, vehicle_kind, endings)
    performance, filters, road_filter = read_performance(data["performance"], model.outputs)
    named = {signal for entry in controllers.values() for signal in (*entry.measured, *signals_of(entry.goals))}
    bent = {*curves, *(force for force, one in dampers.items() if one.pair is not None)}
    named |= {one.velocity.name for one in vehicle_kind.suspensions if {one.stiffness, one.damping, one.force} & bent}
    measured = vehicle_kind.naming(named.union(performance, implementation.noise, implementation.quantisation))
    found = Vehicle(
        kind=replace(measured, signals=(*measured.signals, *of_dampers([one.ending for one in adjusted]))),
        parameters=parameters,
        performance=performance,
        controllers=controllers,
        text=text,
        source=source,
        limits=limits,
        implementation=implementation,
        filters=filters,
        road_filter=road_filter,
        sampled=sampled,
        curves=curves,
        dampers=dampers,
    )
    for entry in controllers.values():
        found.check_entry(entry)
    return found
