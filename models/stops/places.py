"""Where bump stops are: `[limits]` says it of every suspension, `[limits.rear]` of an axle or a corner, which then has those.

A section is named as corners are, or as all whose names begin so: `rear` is of rear_left and rear_right. What it leaves out is
what is said of more corners, so that `[limits.rear]` may have a stroke of its own and the stiffness of all.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from models.common.errors import InputError, listing
from models.stops.stops import Sides, Stiffness, Stops, read_stiffness, read_stroke, stops

KEYS = {"suspension_stroke": read_stroke, "stop_stiffness": read_stiffness}


@dataclass(frozen=True)
class Place:
    """What is said of the stops of an axle, or of a corner.

    Attributes:
        name: of it.
        suspension_stroke: travel either way before the bump stop [m], or one for each side; None: that of more corners.
        stop_stiffness: stiffness of the stop [N/m], or the coefficients of a progressive one, or these for each side; likewise.
    """

    name: str
    suspension_stroke: float | Sides | None = None
    stop_stiffness: Stiffness | Sides | None = None

    def holds(self, corner: str) -> bool:
        """Whether a corner is of it; every one is of the place without a name."""
        return not self.name or f"{corner}_".startswith(f"{self.name}_")


def read_places(section: Mapping[str, Any], corners: Sequence[str]) -> tuple[Place, ...]:
    """The stops of `[limits]`: first those of all suspensions, without a name, then those of sections of their own.

    Args:
        section: as it was read, of stops alone.
        corners: names of the suspensions' corners; empty for one that is alone.

    Raises:
        InputError: a section or key that is unknown, a value that is not allowed, a corner with a stroke and no stiffness or the
            other way round.
    """
    if section and not corners:
        raise InputError(f"[limits] {next(iter(section))}: this kind of vehicle has no suspension to stop; leave it out")
    common, known = {name: value for name, value in section.items() if name in KEYS}, places_of(corners)
    found = [_place("[limits]", "", common)]
    for name, value in section.items():
        if name in KEYS:
            continue
        if name not in known:
            has = f"sections {listing(known)}" if known else "no sections, for there is one suspension"
            raise InputError(f"[limits.{name}] is no suspension of this vehicle; it has {has}")
        for key in value:
            if key not in KEYS:
                raise InputError(f"[limits.{name}] unknown key {key!r}; known: {listing(KEYS)}; the rest is of all suspensions")
        found.append(_place(f"[limits.{name}]", name, value))
    for corner in corners:
        stroke, stiffness = (_said(found, corner, key) for key in KEYS)
        if (stroke is None) != (stiffness is None):
            where = f" of {corner}" if corner and len(found) > 1 else ""
            raise InputError(
                f"[limits] suspension_stroke [m] and stop_stiffness [N/m]{where} make a bump stop together; give both or neither"
            )
    return tuple(found)


def places_of(corners: Sequence[str]) -> tuple[str, ...]:
    """The names that sections may have: of corners, and of all that begin alike."""
    parts = [corner.split("_") for corner in corners if corner]
    return tuple(dict.fromkeys("_".join(part[:k]) for part in parts for k in range(1, len(part) + 1)))


def stops_at(places: Sequence[Place], corner: str) -> Stops | None:
    """The stops of a corner; None where it has none. Those of a stroke alone, of which nothing is run, push back with nothing."""
    stroke, stiffness = (_said(places, corner, key) for key in KEYS)
    return None if stroke is None else stops(stroke, stiffness or 0.0)


def stop_words(found: Mapping[str, Stops | None]) -> list[str]:
    """Stops in words, by corner, a phrase for all that are alike."""
    alike: dict[Stops, list[str]] = {}
    for corner, one in found.items():
        if one is not None:
            alike.setdefault(one, []).append(corner)
    return [one.words + _where(corners, list(found)) for one, corners in alike.items()]


def _where(corners: Sequence[str], every: Sequence[str]) -> str:
    """Some corners in words: the shortest names that are theirs alone."""
    if len(corners) == len(every):
        return ""
    names = []
    for name in places_of(every):
        held = [corner for corner in every if Place(name).holds(corner)]
        if {*held} <= {*corners} and not any(Place(other).holds(name) for other in names):
            names.append(name)
    return f" ({', '.join(names)})"


def _place(where: str, name: str, section: Mapping[str, Any]) -> Place:
    said = f"{where} " if name else ""
    return Place(name, **{key: KEYS[key](f"{said}{key}", value) for key, value in section.items()})


def _said(places: Sequence[Place], corner: str, key: str) -> Any:
    """What is said of a corner, by the section of fewest corners that says it; None where none does."""
    said = [one for one in places if one.holds(corner) and getattr(one, key) is not None]
    return getattr(max(said, key=lambda one: len(one.name)), key) if said else None
