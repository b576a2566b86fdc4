"""A road, and loads on the body of what drives on it. Both begin at the same time 0."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.common.errors import InputError
from models.kinds.kind import Parameters, Wheel
from models.kinds.signals import HEAVE_LOAD, PITCH_LOAD, ROLL_LOAD
from models.roads.load import Load
from models.roads.road import Road
from models.vehicle.names import PLUS
from models.vehicle.vehicle import Vehicle

WAYS = {HEAVE_LOAD.name: "goes up and down", PITCH_LOAD.name: "pitches", ROLL_LOAD.name: "rolls"}


@dataclass(frozen=True, eq=False)
class Loaded(Road):
    """A road with loads. It has no spectrum: what the loads do is the same over every road of its class.

    Attributes:
        road: the road.
        on_body: the loads.
    """

    road: Road
    on_body: Sequence[Load]

    @property
    def speed(self) -> float:  # pyright: ignore[reportIncompatibleVariableOverride]
        """That of the road [m/s]."""
        return self.road.speed

    @property
    def track(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """That of the road."""
        return self.road.track

    @property
    def laid(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Whether the road is."""
        return self.road.laid

    def met_by(self, wheel: Wheel) -> str:
        """What it meets of the road."""
        return self.road.met_by(wheel)

    def later(self, wheel: Wheel, parameters: Parameters) -> float:
        """How much later it meets the road [s]."""
        return self.road.later(wheel, parameters)

    @property
    def duration(self) -> float:
        """That of the road [s]."""
        return self.road.duration

    @property
    def points(self) -> bytes | None:
        """Those of the road."""
        return self.road.points

    @property
    def loaded(self) -> bool:
        """It is."""
        return True

    @property
    def load_kinks(self) -> tuple[float, ...]:
        """Those of all its loads."""
        return tuple(sorted({kink for load in self.on_body for kink in load.kinks}))

    def loads(self, vehicle: Vehicle, t: Array) -> Array:
        """See `Road`.

        Raises:
            InputError: the vehicle has no such motion.
        """
        names = [one.name for one in vehicle.kind.loads]
        total = np.zeros((len(t), len(names)))
        for load in self.on_body:
            for name in load.ways:
                if name not in names:
                    able = " and ".join(WAYS[one] for one in names) if names else "has no body that loads can push"
                    raise InputError(
                        f"load {load.label!r} is one for a vehicle that {WAYS[name]}, and a {vehicle.kind.name} only {able}; "
                        "take another load, or vehicle"
                    )
            for name, values in load.over(t, vehicle.parameters).items():
                total[:, names.index(name)] += values
        return total

    def displacement(self, t: Array, side: str = "") -> Array:
        """That of the road."""
        return self.road.displacement(t, side)

    def velocity(self, t: Array, side: str = "") -> Array:
        """That of the road."""
        return self.road.velocity(t, side)

    @property
    def kinks(self) -> tuple[float, ...]:
        """Those of the road."""
        return self.road.kinks

    def describe(self) -> dict[str, float | str]:
        """The road, and its loads in words that make them again."""
        return {**self.road.describe(), "loads": PLUS.join(load.text for load in self.on_body)}

    @property
    def words(self) -> str:
        """The same on a line for people."""
        return f"{self.road.words}, loads {PLUS.join(load.label for load in self.on_body)}"

    def scaled(self, factor: float) -> "Loaded":
        """The same road, higher or lower, with loads as much larger or smaller."""
        return Loaded(self.road.scaled(factor), tuple(load.scaled(factor) for load in self.on_body))

    def cost(self, samples: int) -> float:
        """That of the road."""
        return self.road.cost(samples)

    def check(self, vehicle: Vehicle, time: Array) -> None:
        """Whether the vehicle can be driven over the road, and its body pushed so.

        Raises:
            InputError: it cannot.
        """
        self.road.check(vehicle, time)
        self.loads(vehicle, time[:1])
