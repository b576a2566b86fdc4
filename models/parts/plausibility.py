"""Warnings about springs, dampers and stops that probably have the wrong unit or the wrong sign.

A warning appears if a number is about 30 times larger or smaller than its usual value. If mm and m, or N and kN, are confused,
the number is wrong by a factor of 1000.
"""

import math
from collections.abc import Iterator
from typing import Any

from models.characteristics import SIDES
from models.characteristics.curve import ForceCurve
from models.kinds.kind import GRAVITY
from models.parts.stops.stop import Stop, StopTable

WEAKEST, FIRMEST = 0.01, 10.0  # plausible range of the damping ratio that a measured damper gives
FASTEST = 5.0  # a table with velocities above this [m/s] is probably in inches, unless the damper is firm
# If the compression force divided by the extension force is above this ratio, the sign of the table is probably reversed
REVERSED_RATIO = 1.6
SHORTEST, LONGEST = 5e-3, 2.0  # plausible range of the largest deflection in a table [m]
# Plausible range of the largest force in a table, relative to the static load on the suspension
WEAKEST_STOP, FIRMEST_STOP = 1 / 30, 100.0


def damper_doubts(softest: ForceCurve, firmest: ForceCurve, critical: float | None) -> Iterator[str]:
    """Yields warnings about the characteristic of a damper, or about the two characteristics of a semi-active damper.

    Args:
        softest: characteristic at the softest setting of the damper.
        firmest: characteristic at the firmest setting of the damper; for a passive damper, equal to `softest`.
        critical: critical damping coefficient, converted to the damper's own ends [N s/m]; None if it is unknown.
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
            f"the force at {round(v, 3):g} m/s is {round(compression)} N in compression and {round(extension)} N in "
            "extension, but most dampers have the larger force in extension; check that the velocity is positive in extension"
        )


def length_doubts(length: float) -> Iterator[str]:
    """Yields a warning about the largest deflection [m] in the table of a spring or stop."""
    if not SHORTEST <= length <= LONGEST:
        yield f"the table ends at {round(length, 5):g} m; check that its deflections are in m"


def stop_doubts(stop: Stop, load: float | None) -> Iterator[str]:
    """Yields warnings about the table of a bump stop.

    Args:
        stop: bump stop whose table is checked.
        load: static load at the stop [N]; None if the load is unknown.
    """
    if isinstance(law := stop.stiffness, StopTable):
        yield from length_doubts(stop.stroke + law.compression[-1])
        if load and not WEAKEST_STOP <= max(law.force) / load <= FIRMEST_STOP:
            largest = f"the largest force is {round(max(law.force), 1):g} N, but the static load is {round(load)} N"
            yield f"{largest}; check that forces are in N"


def suspension_doubts(vehicle: Any) -> list[str]:
    """Returns warnings about tables of springs, dampers and stops that probably have the wrong unit or sign."""
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
