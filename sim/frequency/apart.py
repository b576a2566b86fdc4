"""A road of its own under every wheel, of a vehicle that drives so slowly that no wheel comes to where another one was."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.common.arrays import Array
from models.roads.road import Road
from models.vehicle import Vehicle


@dataclass(frozen=True)
class Apart(Road):
    """A sum of sinusoids under each wheel that starts at height zero.

    The road is one: under the rear wheels lies at the beginning what the front ones have passed long before, and a run is over
    before any wheel is where the next one began.

    Attributes:
        omega: w_i [rad/s], none of them zero.
        waves: velocity of the road under every wheel, the real part of the sum of c_i exp(j w_i t) [m/s], by side and by how much
            later than the first wheel it is where that one was [s]; the last wheel first.
        speed: forward velocity [m/s].
    """

    omega: tuple[float, ...]
    waves: tuple[tuple[str, float, tuple[complex, ...]], ...]
    speed: float

    @classmethod
    def under(cls, vehicle: Vehicle, omega: Array, waves: Array, duration: float) -> "Apart":
        """A road for a vehicle.

        Args:
            vehicle: r wheels.
            omega: shape (L,).
            waves: c, shape (L, r).
            duration: of the run [s].
        """
        wheels = vehicle.kind.wheels
        behind = sorted({wheel.behind(vehicle.parameters) for wheel in wheels})
        speed = min((float(gap) for gap in np.diff(behind)), default=duration) / (2 * duration)
        each = [
            (wheel.side, wheel.behind(vehicle.parameters) / speed, tuple(c.tolist()))
            for wheel, c in zip(wheels, waves.T, strict=True)
        ]
        return cls(tuple(omega.tolist()), tuple(sorted(each, key=lambda one: -one[1])), speed)

    def displacement(self, t: Array, side: str = "") -> Array:
        """The sum under the wheel of that side that is there at the time."""
        return self._sum(t, side, 1j * np.array(self.omega))

    def velocity(self, t: Array, side: str = "") -> Array:
        """Its exact derivative."""
        return self._sum(t, side, None)

    def highest(self, time: Array) -> float:
        """The largest height under any wheel in these times of a run [m]."""
        return max(float(np.abs(self.displacement(time - late, side)).max()) for side, late, _ in self.waves)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Where each wheel begins."""
        return tuple(sorted({-late for _, late, _ in self.waves}))

    def describe(self) -> dict[str, Any]:
        """Its frequencies, and what each wheel has of them."""
        waves = [
            {"side": side, "late": late, "real": np.real(c).tolist(), "imag": np.imag(c).tolist()} for side, late, c in self.waves
        ]
        return {"type": "apart", "omega": list(self.omega), "waves": waves, "speed": self.speed}

    def scaled(self, factor: float) -> "Apart":
        """The same road, higher or lower."""
        return replace(self, waves=tuple((side, late, tuple(factor * x for x in c)) for side, late, c in self.waves))

    def _sum(self, t: Array, side: str, integral: Array | None) -> Array:
        """The velocity, or the height, which begins at zero."""
        found = np.zeros(np.shape(t))
        for own, late, c in self.waves:  # the last wheel first: where the next one is its road ends
            here = (t >= -late) & (side == own)
            waves = np.array(c) if integral is None else np.array(c) / integral
            turning = np.exp(1j * np.multiply.outer(t[here] + late, np.array(self.omega)))
            found[here] = np.real((turning if integral is None else turning - 1) @ waves)
        return found
