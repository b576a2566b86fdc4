"""`[parts.NAME]` of a vehicle file: a force element in parallel with the suspension's own spring and damper.

Each registered part that is also declared as a section of a vehicle file can be a force element. The fields of the part's class
are the keys of the section.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

from models.common.errors import InputError, alike, error_in, list_names, short_repr
from models.common.extensions import PARTS
from models.common.schema import SI, ListedValues, Section, Text, keys, read
from models.kinds.kind import Suspension
from models.kinds.signals import Signal
from models.parts.part import Part, Straight, state_signals
from models.parts.stops.stop import holds, places_of


@dataclass(frozen=True)
class PartSite(Section):
    """Keys that the sections of all force elements have in common."""

    kind: Annotated[str, Text("name of the part")]
    at: Annotated[tuple[str, ...], ListedValues("suspensions or axles with the element; default: all", Text())] = ()


@dataclass(frozen=True, eq=False)
class Element:
    """Force element of one or more suspensions.

    Attributes:
        name: name of the section `[parts.NAME]`.
        corners: names of the corners with the element; one empty name if the vehicle has a single suspension.
        part: part that represents the element, before its motion ratio is applied.
    """

    name: str
    corners: tuple[str, ...]
    part: Part

    @property
    def straight(self) -> "Element":
        """The linearised element; if the element is linear or acts only on contact, the unchanged element."""
        part = self.part
        return self if part.contact or not part.is_nonlinear else replace(self, part=Straight(part.line, part.states))

    def with_slope(self, slope: float, damps: bool) -> "Element":
        """Returns the linearised element after replacing its damping [N s/m] or stiffness [N/m].

        Args:
            slope: the new damping [N s/m] or stiffness [N/m].
            damps: True to replace the damping, False to replace the stiffness.
        """
        line = replace(self.part.line, damping=slope) if damps else replace(self.part.line, stiffness=slope)
        return replace(self, part=Straight(line, self.part.states))

    @property
    def numbers(self) -> dict[str, tuple[float, SI]]:
        """Numbers of the element that a campaign may vary, each with its unit and range; the keys have the form `NAME.key`."""
        section = type(self.part) if isinstance(self.part, Section) else Section
        own = {key: one for key, one in keys(section).items() if isinstance(one, SI)}
        return {
            f"{self.name}.{key}": (value, one) for key, one in own.items() if isinstance(value := getattr(self.part, key), float)
        }

    def sampled(self, values: Mapping[str, float]) -> "Element":
        """Returns the element with new values of its numbers; `values` contains the values by `NAME.key`, along with numbers of
        other elements.
        """
        own = {name.removeprefix(f"{self.name}."): value for name, value in values.items() if name in self.numbers}
        return replace(self, part=replace(self.part, **own)) if own else self  # pyright: ignore[reportArgumentType]


def states_of(elements: Sequence[Element], suspensions: Sequence[Suspension]) -> tuple[Signal, ...]:
    """Returns the signals of the elements' internal states, ordered by suspension like the parts of a vehicle."""
    here = [(one, place) for place in suspensions for one in elements if place.corner in one.corners]
    return tuple(signal for one, place in here for signal in state_signals(one.part, one.name, place))


def element_kinds() -> dict[str, type[Section]]:
    """Returns the parts that can be elements, by the value of `kind` in their section."""
    return {name: one for name, one in PARTS.load_all().items() if issubclass(one, Section)}


def read_elements(section: Mapping[str, Any], corners: Sequence[str], taken: Collection[str] = ()) -> tuple[Element, ...]:
    """Reads `[parts]`.

    Args:
        section: the section `[parts]`.
        corners: names of the corners that have suspensions.
        taken: names that elements must not have, because parameters already have them.

    Raises:
        InputError: a part or a place is unknown, or a key is missing, unknown or not allowed.
    """
    kinds, elements = element_kinds(), list[Element]()
    for name, given in section.items():
        where = f"[parts.{name}]"
        if not isinstance(given, Mapping):
            raise InputError(f"[parts] {name} is not a section; write [parts.NAME] with kind = ..., one of {list_names(kinds)}")
        common = {
            key: [one] if key == "at" and isinstance(one := given[key], str) else given[key]
            for key in keys(PartSite)
            if key in given
        }
        if "kind" not in given:
            raise InputError(f"{where} kind is missing; give kind = one of {list_names(kinds)}")
        place = read(where, PartSite, common)
        if place.kind not in kinds:
            raise InputError(f"{where} kind = {place.kind!r} is unknown; give one of {alike(place.kind, kinds)}")
        if unknown := [key for key in given if key not in (known := [*keys(PartSite), *keys(kinds[place.kind])])]:
            raise InputError(f"{where} unknown key {short_repr(unknown[0])}; known keys: {alike(unknown[0], known)}")
        if name in taken:
            raise InputError(f"{where} has the same name as a parameter of the vehicle; give the section a different name")
        with error_in(where):
            some = _places(place.at, corners)
        part: Any = read(where, kinds[place.kind], {key: one for key, one in given.items() if key not in keys(PartSite)})
        elements.append(Element(name, some, part))
    return tuple(elements)


def _places(at: Sequence[str], corners: Sequence[str]) -> tuple[str, ...]:
    """Returns the corners at the named suspensions or axles; all corners if no suspension or axle is named."""
    chosen = list[str]()
    for place in at:
        here = [corner for corner in corners if holds(place, corner)]
        if not here:
            known = f"it has {list_names(places_of(corners))}" if any(corners) else "omit at, as there is only one suspension"
            raise InputError(f"at = {place!r} is not a suspension or an axle of this vehicle; {known}")
        chosen += here
    return tuple(dict.fromkeys(chosen)) if at else tuple(corners)
