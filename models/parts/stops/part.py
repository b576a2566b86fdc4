"""Bump stops of a suspension: `[limits] suspension_stroke` and `stop_stiffness`.

A stop makes contact when the suspension has travelled the stroke, and then pushes back; see `models.parts.stops.stop`. A spring
of MuJoCo can have a dead band and a polynomial force, so it can represent a stop without a table.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.characteristics import SIDES
from models.common.arrays import Array
from models.kinds.kind import Suspension
from models.parts.native import Tendon
from models.parts.part import BUMP_STOP, Limit, Part
from models.parts.stops.stop import SLACK, Stop, StopTable, pair_words


@dataclass(frozen=True)
class Stops(Part):
    """Bump stops of a suspension, at most one on each side."""

    contact = True
    stores = True
    native = True
    argument = "deflection"

    bump: Stop
    rebound: Stop

    @property
    def sides(self) -> dict[str, tuple[float, Stop]]:
        """Sign of the deflection, and the stop, for each side that has a stop; the keys are the names of the sides (`SIDES`)."""
        both = zip(SIDES, ((-1.0, self.bump), (1.0, self.rebound)), strict=True)
        return {side: (sign, stop) for side, (sign, stop) in both if math.isfinite(stop.stroke)}

    def at_wheel(self, ratio: float) -> "Stops":
        return self if ratio == 1 else Stops(self.bump.at_wheel(ratio), self.rebound.at_wheel(ratio))

    @property
    def is_nonlinear(self) -> bool:
        """True if any of the stops gives a force."""
        return self.bump.pushes or self.rebound.pushes

    def pull(self, d: Array, v: Array, z: Any = None, u: Any = 0.0) -> Array:
        return sum((sign * stop.acts(beyond) for sign, stop, beyond in self._squeezed(d)), np.zeros_like(d))

    def stored(self, d: Array, z: Any = None) -> Array:
        return sum((stop.work(beyond) for _, stop, beyond in self._squeezed(d)), np.zeros_like(d))

    def limits(self) -> Sequence[Limit]:
        """Returns the strokes of the stops as limits of the linear range."""
        return [Limit(BUMP_STOP, "deflection", sign, stop.stroke) for sign, stop in self.sides.values()]

    def _squeezed(self, deflection: Array) -> tuple[tuple[float, Stop, Array], ...]:
        """Returns the sign of the deflection, the stop and its compression [m], for each side that has a stop."""
        return tuple((sign, stop, np.maximum(sign * deflection - stop.stroke, 0.0)) for sign, stop in self.sides.values())

    def write(self, tendon: Tendon) -> None:
        """Writes the stops as springs whose dead band is the stroke, or as segments of a table. See `Part.write`.

        If the stops on both sides have the same odd force (no x^2 term), one spring represents both stops. Otherwise, each stop
        has a spring that is slack while the suspension is deflected to the other side.
        """
        bump, rebound = self.bump.stiffness, self.rebound.stiffness
        low, high = tendon.rest - self.bump.stroke, tendon.rest + self.rebound.stroke
        if bump == rebound and not isinstance(bump, StopTable) and not bump[1]:
            tendon.add_spring("stop", (low, high), bump)
            return
        for side, (sign, stop) in self.sides.items():
            if isinstance(stop.stiffness, StopTable):
                own = stop.stiffness.curve.pieces
                bounds = (own.low, own.high) if sign > 0 else (-own.high, -own.low)
                pieces = replace(own, start=sign * (own.start + stop.stroke), low=bounds[0], high=bounds[1])
                tendon.add_pieces(f"stop_{side}", pieces)
            else:
                first, second, third = stop.stiffness
                # Beyond the bump stroke, the MuJoCo spring has a negative argument x.
                slack = (low, SLACK) if sign < 0 else (-SLACK, high)
                tendon.add_spring(f"stop_{side}", slack, (first, sign * second, third))

    @property
    def words(self) -> str:
        return pair_words((self.bump, self.rebound))

    @classmethod
    def of(cls, vehicle: Any, place: Suspension) -> Iterator[tuple[Part, str]]:
        """Yields the part that represents the stops of a suspension in `[limits]`."""
        if (own := vehicle.limits.stops_at(place.corner)) is not None:
            yield cls(*own), ""
