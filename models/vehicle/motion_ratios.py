"""Motion ratios of a vehicle's inputs over travel, and the words on all of its motion ratios."""

from collections.abc import Sequence

import numpy as np

from models.characteristics.ratio_table import RatioTable
from models.common.arrays import Array
from models.vehicle.vehicle import Vehicle


class MotionRatios:
    """Motion ratios of the inputs of N vehicles of one kind.

    Attributes:
        over_travel: names of the inputs whose ratio changes with travel.
    """

    def __init__(self, vehicles: Sequence[Vehicle]) -> None:
        """Takes N vehicles, or one for any number of runs."""
        first, self._at_rest = vehicles[0], dict[str, Array]()
        places = {place.force: place for place in first.kind.suspensions}
        self._tables: dict[str, list[tuple[RatioTable, Array, Array]]] = {}  # each with its runs and its factor in these
        for force in first.linear_model.inputs:
            ratios = self._at_rest[force] = np.array([one.motion_ratios[force] for one in vehicles])
            groups: dict[int, tuple[RatioTable, list[int]]] = {}
            for i, one in enumerate(vehicles):
                if force in places and (table := one.kind.table_of(places[force])) is not None:
                    groups.setdefault(id(table), (table, []))[1].append(i)
            if groups:
                self._tables[force] = [(table, np.array(runs), ratios[runs] / table.at_rest) for table, runs in groups.values()]
        self.over_travel = tuple(self._tables)

    def of(self, force: str, deflection: Array) -> Array:
        """Returns the ratio of an input at deflections of its suspension [m], shape (..., N)."""
        ratios = np.broadcast_to(self._at_rest[force], np.shape(deflection)).copy()
        for table, runs, factor in self._tables.get(force, ()):
            ratios[..., runs] = factor * table(deflection[..., runs])
        return ratios

    def turn(self, force: str, deflection: Array) -> Array:
        """Returns the same ratio over that at rest, shape (..., N)."""
        return self.of(force, deflection) / self._at_rest[force]


def ratio_at(vehicle: Vehicle, force: str, deflection: Array) -> Array:
    """Returns the motion ratio of an input of a vehicle at deflections of its suspension [m], shape (...)."""
    return MotionRatios([vehicle]).of(force, np.asarray(deflection)[..., None])[..., 0]


def travel_at(vehicle: Vehicle, force: str, deflection: Array) -> Array:
    """Returns the travel of an actuator [m], the integral of its motion ratio from rest, shape (...); arguments as above."""
    ratio, place = vehicle.motion_ratios[force], next((one for one in vehicle.kind.suspensions if one.force == force), None)
    table = None if place is None else vehicle.kind.table_of(place)
    return ratio * deflection if table is None else ratio / table.at_rest * table.travel(deflection)


def ratio_notes(vehicle: Vehicle) -> list[str]:
    """Returns the rates at the wheel of every motion ratio; empty without any."""
    kind, given, notes = vehicle.kind, vehicle.parameters, dict[str, None]()
    wheel = kind.at_wheels(given)
    for part in kind.suspensions:
        if part.ratio in given and wheel.get(part.ratio) != given[part.ratio]:
            units = ((part.stiffness, "N/m"), (part.damping, "N s/m"))
            rates = " and ".join(f"{wheel[name]:g} {unit}" for name, unit in units if name in wheel)
            where = " at equilibrium" if part.ratio in kind.ratios else ""
            notes[f"{part.ratio} {given[part.ratio]:g}{where}: {rates} at the wheel"] = None
    return list(notes)
