"""Roads combined with loads (external forces and moments) on the vehicle's body. Road and loads begin at time 0."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from models.common.arrays import Array
from models.common.checks import forwarded_attribute
from models.common.errors import InputError
from models.kinds.signals import HEAVE_LOAD, PITCH_LOAD, ROLL_LOAD
from models.roads.loads.load import Load
from models.roads.road import DerivedRoad
from models.vehicle.names import PLUS
from models.vehicle.vehicle import Vehicle

WAYS = {HEAVE_LOAD.name: "moves vertically", PITCH_LOAD.name: "pitches", ROLL_LOAD.name: "rolls"}


@dataclass(frozen=True, eq=False)
class RoadWithLoads(DerivedRoad):
    """Road with loads. A road with loads has no spectrum, because the loads are not random.

    Attributes:
        on_body: loads that act on the body of the vehicle.
    """

    on_body: Sequence[Load]

    displacement, velocity = forwarded_attribute("road.displacement"), forwarded_attribute("road.velocity")
    from_start, points = forwarded_attribute("road.from_start"), forwarded_attribute("road.points")  # pyright: ignore[reportIncompatibleMethodOverride]

    @property
    def loaded(self) -> bool:
        """True, because at least one load acts on the body."""
        return True

    @property
    def load_kinks(self) -> tuple[float, ...]:
        """Times of the kinks of all loads [s]."""
        return tuple(sorted({kink for load in self.on_body for kink in load.kinks}))

    def loads(self, vehicle: Vehicle, t: Array) -> Array:
        """Returns the sum of all loads on the body; see `Road`.

        Raises:
            InputError: the vehicle type lacks the motion (heave, pitch or roll) that a load acts on.
        """
        return self._sum(vehicle, t, lambda load: load.at(t, vehicle.parameters, vehicle.kind))

    def held_loads(self, vehicle: Vehicle, t: Array, timestep: float) -> Array:
        """Returns the sum of the loads that MuJoCo holds constant during each time step; see `Road`."""
        return self._sum(vehicle, t, lambda load: load.step_means(t, timestep, vehicle.parameters, vehicle.kind))

    def _sum(self, vehicle: Vehicle, t: Array, values_of: Callable[[Load], Mapping[str, Array]]) -> Array:
        names = [load.name for load in vehicle.kind.loads]
        total = np.zeros((len(t), len(names)))
        for load in self.on_body:
            for name in load.directions:
                if name not in names:
                    able = " and ".join(WAYS[way] for way in names) if names else "has no body on which loads act"
                    raise InputError(
                        f"load {load.label!r} needs a vehicle that {WAYS[name]}, but a {vehicle.kind.name} only "
                        f"{able}; choose a different load or vehicle"
                    )
            for name, values in values_of(load).items():
                total[:, names.index(name)] += values
        return total

    def describe(self) -> dict[str, float | str]:
        """Returns the description of the road, including the texts that define the loads."""
        return {**self.road.describe(), "loads": PLUS.join(load.text for load in self.on_body)}

    @property
    def words(self) -> str:
        """Description of road and loads as one line of text."""
        return f"{self.road.words}, loads {PLUS.join(load.label for load in self.on_body)}"

    def scaled(self, factor: float) -> "RoadWithLoads":
        """Returns the road and its loads, multiplied by a factor."""
        return RoadWithLoads(self.road.scaled(factor), tuple(load.scaled(factor) for load in self.on_body))

    def check(self, vehicle: Vehicle, time: Array) -> None:
        """Checks that the road suits the vehicle, and that the vehicle type has the motions that the loads act on.

        Raises:
            InputError: the road or a load does not fit the vehicle.
        """
        self.road.check(vehicle, time)
        self.loads(vehicle, time[:1])
