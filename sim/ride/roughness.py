"""How rough a road is that was driven, in words and as JSON: its IRI, whoever drives."""

from collections.abc import Sequence
from typing import Any

from models.common.arrays import Array
from models.common.numbers import cell
from models.roads.iri import TRACKS, Roughness, roughness_of
from models.roads.road import Road, track_width
from models.vehicle import Vehicle

UNIT = "m/km"
ABOUT_IRI = "iri is of the road alone, all of it that the first wheel meets, at 80 km/h whatever the speed"


def driven_roughness(vehicle: Vehicle, road: Road, time: Array) -> tuple[Roughness, ...]:
    """Every IRI of what a vehicle drives over in a run.

    Args:
        vehicle: its track width counts.
        road: of a distance, or of time.
        time: of the samples, from 0 [s], shape (T,).
    """
    return roughness_of(road, vehicle, road.speed * float(time[-1]))


def roughness_rows(found: Sequence[Roughness], random: bool) -> list[tuple[str, ...]]:
    """Rows of the table of metrics: name, unit, what MuJoCo drove over, what the sampled response did; what is expected."""
    rows = []
    for one in found:
        spread = cell(one.spread, ".4g") if one.spread is not None else ""
        expected = (cell(one.expected, ".4g"), spread) if random else ()
        rows.append((f"  {_name(one, found)}", UNIT, *(2 * (cell(one.iri, ".4g"),)), *expected))
    return rows


def roughness_object(found: Sequence[Roughness]) -> dict[str, Any]:
    """The same as JSON has it; empty for a road that has no IRI."""
    return {_name(one, found): {"unit": UNIT, "road": one.iri, "expected": one.expected, "spread": one.spread} for one in found}


def roughness_names(vehicle: Vehicle) -> tuple[str, ...]:
    """What the IRIs of a road are called that a vehicle drives over, of those that have some."""
    return tuple(f"iri_{track}" for track in TRACKS) if track_width(vehicle) else ("iri",)


def _name(one: Roughness, found: Sequence[Roughness]) -> str:
    return f"iri_{one.name}" if len(found) > 1 else "iri"
