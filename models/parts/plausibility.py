"""Springs, dampers and stops that are probably in another unit or of the other sign.

A number is remarked if it is about 30 times what is usual, or a thirtieth. Mistakes between mm and m or N and kN are larger.
"""

import math
from collections.abc import Iterator
from typing import Any

from models.characteristics import SIDES
from models.characteristics.curve import ForceCurve
from models.kinds.kind import GRAVITY
from models.parts.stops.stop import Stop, StopTable

WEAKEST, FIRMEST = 0.01, 10.0  # damping ratio of a measured damper
FASTEST = 5.0  # m/s: a table beyond it is of a firm damper, or in inches
REVERSED_RATIO = 1.6  # compression force over extension force, as of a table with the other sign
SHORTEST, LONGEST = 5e-3, 2.0  # m, of a table
WEAKEST_STOP, FIRMEST_STOP = 1 / 30, 100.0  # largest force of a table over the load on the suspension


def damper_doubts(softest: ForceCurve, firmest: ForceCurve, critical: float | None) -> Iterator[str]:
    """Yields remarks on a damper's curve, or on the two of a semi-active one.

    Args:
        critical: critical damping at the damper [N s/m]; None if it is unknown.
    """
    v = min(-firmest.x[0], firmest.x[-1])
    if critical:
        least = min(softest.slope, *(softest.force[[0, -1]] / softest.x[[0, -1]])) / critical
        most = max(firmest.slope, *(firmest.force[[0, -1]] / firmest.x[[0, -1]])) / critical
        weak = most < WEAKEST * (10 if v > FASTEST else 1)
        if weak or least > FIRMEST:
            ratio = most if weak else least
            yield f"the damping ratio is about {round(ratio, 4):g}; check that forces are in N, and velocities in m/s"
    compression, extension = (abs(float(firmest(x))) for x in (-v, v))
    if compression > REVERSED_RATIO * extension:
        yield (
            f"the force at {round(v, 3):g} m/s is {round(compression)} N in compression and {round(extension)} N in extension, "
            "where most dampers have the larger one; check that the velocity is positive in extension"
        )


def length_doubts(length: float) -> Iterator[str]:
    """Yields a remark on the largest deflection of a spring's or a stop's table [m]."""
    if not SHORTEST <= length <= LONGEST:
        yield f"the table ends at {round(length, 5):g} m; check that its deflections are in m"


def stop_doubts(stop: Stop, load: float | None) -> Iterator[str]:
    """Yields remarks on the table of a bump stop.

    Args:
        load: static load at the stop [N]; None if it is unknown.
    """
    if isinstance(law := stop.stiffness, StopTable):
        yield from length_doubts(stop.stroke + law.compression[-1])
        if load and not WEAKEST_STOP <= max(law.force) / load <= FIRMEST_STOP:
            largest = f"the largest force is {round(max(law.force), 1):g} N, but the static load is {round(load)} N"
            yield f"{largest}; check that forces are in N"


def suspension_doubts(vehicle: Any) -> list[str]:
    """Returns remarks on tables of springs, dampers and stops that are probably in another unit or of the other sign."""
    kind, parameters, curves, dampers = vehicle.kind, vehicle.parameters, vehicle.curves, vehicle.dampers
    loads, wheel, stops = kind.static_loads(parameters), kind.at_wheels(parameters), vehicle.limits.stops(kind.suspensions)
    doubts = dict[str, None]()
    for part in kind.suspensions:
        load, k, ratio = loads.get(part.deflection), wheel.get(part.stiffness), part.motion_ratio(parameters)
        critical = 2 * math.sqrt(k * load / GRAVITY) / ratio**2 if k and load else None
        pair = dampers[part.force].pair if part.force in dampers else None
        pairs = {"[actuators]": (pair.soft, pair.hard)} if pair is not None else {}
        pairs |= {part.damping: (one, one)} if (one := curves.get(part.damping)) is not None else {}
        for name, both in pairs.items():
            doubts |= dict.fromkeys(f"{name}: {said}" for said in damper_doubts(*both, critical))
        if (spring := curves.get(part.stiffness)) is not None:
            doubts |= dict.fromkeys(f"{part.stiffness}: {said}" for said in length_doubts(max(-spring.x[0], spring.x[-1])))
        for side, stop in zip(SIDES, stops.get(part.deflection, ()), strict=False):
            doubts |= dict.fromkeys(f"[limits] {side} stop: {said}" for said in stop_doubts(stop, load and load / ratio))
    return list(doubts)
