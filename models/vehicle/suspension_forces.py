"""Forces of suspensions beyond the linear model, for runs side by side: the sum of their parts. Motion ratios of inputs."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.parts.part import Stack, alike
from models.vehicle.vehicle import Vehicle

if TYPE_CHECKING:
    from models.characteristics.ratio_table import RatioTable


class SuspensionForces:
    """Forces that pull suspensions together at the wheels, of N vehicles of one kind, beyond those of their linear models.

    The linear model has the line of each part, and the force of each actuator at its motion ratio at rest.

    Attributes:
        acts: True for each suspension that has a force beyond the linear model, shape (s,).
        states: number of the parts' own states, k.
        inertance: force of inertial parts over the second derivative of the deflection [kg], shape (N, s); None without any.
    """

    def __init__(self, vehicles: Sequence[Vehicle], by_motor: bool = False, whole: bool = True, contacts: bool = True) -> None:
        """Takes N vehicles, or one for any number of runs.

        Args:
            by_motor: True for parts alone that have no form native to MuJoCo.
            contacts: False leaves out parts without effect before an end of the linear regime.
            whole: True adds the lines of elements of `[parts]`, which are in linear models, but not in the kinds' equations.
        """
        first, inputs = vehicles[0], vehicles[0].linear_model.inputs
        places = {one.deflection: i for i, one in enumerate(first.kind.suspensions)}
        self.acts, self.states, self.inertance = np.zeros(len(places), dtype=bool), 0, None
        groups, self._stacks = list[tuple[list[int], bool]](), list[tuple[Array | slice, Array | None, slice, Stack]]()
        for k, one in enumerate(first.parts):
            line = whole and not one.parameter
            if not (one.part.acts or (line and one.acts)) or (by_motor and one.native) or (one.part.contact and not contacts):
                continue
            self.acts[places[one.deflection]] = True
            for some, own in groups:
                separate = one.deflection not in [first.parts[j].deflection for j in some]
                if own == line and separate and all(alike(each.parts[some[0]].part, each.parts[k].part) for each in vehicles):
                    some.append(k)
                    break
            else:
                groups.append(([k], line))
        for some, line in groups:
            chosen = [first.parts[k] for k in some]
            columns = np.array([places[one.deflection] for one in chosen])
            own = np.array([inputs.index(one.place.force) for one in chosen]) if chosen[0].part.inputs else None
            every = slice(None) if np.array_equal(columns, np.arange(len(places))) else columns
            kept = slice(self.states, self.states + len(some) * chosen[0].part.states)
            stack = Stack([[vehicle.parts[k].part for k in some] for vehicle in vehicles], line)
            self.states = kept.stop
            self._stacks.append((every, own, kept, stack))
            if any(one.part.inertance for one in chosen):
                self.inertance = np.zeros((len(vehicles), len(places))) if self.inertance is None else self.inertance
                self.inertance[:, columns] += [[vehicle.parts[k].part.inertance for k in some] for vehicle in vehicles]

    def __call__(self, d: Array, v: Array, inputs: Array, z: Array | None = None) -> Array:
        """Returns the forces without those of inertial parts [N], shape (..., N, s).

        Args:
            d, v: deflections [m] and their rates [m/s] at the wheels, shape (..., N, s).
            inputs: acting forces of actuators [N], and acting coefficients of adjustable dampers beyond the nominal ones
                [N s/m], shape (..., N, m).
            z: the parts' own states, shape (..., N, k).
        """
        pulls = None
        for columns, own, kept, parts in self._stacks:
            u, states = 0.0 if own is None else inputs[..., own], _of_columns(z, kept, parts)
            if isinstance(columns, slice):
                pull = parts.beyond(d, v, states, u)
                pulls = pull if pulls is None else pulls + pull
            else:
                pulls = np.zeros(d.shape) if pulls is None else pulls
                pulls[..., columns] += parts.beyond(d[..., columns], v[..., columns], states, u)
        return np.zeros(d.shape) if pulls is None else pulls

    def rates(self, d: Array, v: Array, inputs: Array, z: Array) -> Array:
        """Returns the rates of the parts' own states, shape (..., N, k); arguments as for the forces."""
        rates = np.empty(z.shape)
        for columns, own, kept, parts in self._stacks:
            if kept.stop > kept.start:
                u, states = 0.0 if own is None else inputs[..., own], z[..., kept].reshape(*z.shape[:-1], parts.columns, -1)
                rates[..., kept] = parts.rate(d[..., columns], v[..., columns], states, u).reshape(*z.shape[:-1], -1)
        return rates


def _of_columns(z: Array | None, kept: slice, parts: Stack) -> Array | None:
    """Returns the states of some parts, shape (..., N, columns, states); None for parts without."""
    if z is None or kept.stop == kept.start:
        return None
    return z[..., kept].reshape(*z.shape[:-1], parts.columns, -1)


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
