"""Nonlinear suspension forces (sums of the forces of all parts) and motion ratios of inputs, for simultaneous runs."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from models.common.arrays import Array
from models.common.extensions import FEATURES
from models.parts.part import Part, Stack, alike
from models.vehicle.vehicle import Vehicle

if TYPE_CHECKING:
    from models.characteristics.ratio_table import RatioTable


class SuspensionForces:
    """Suspension forces of N vehicles of one type that act in addition to the forces in the linear models of these vehicles.

    The forces act between body and wheel, and are positive if they pull body and wheel together. The linear model contains the
    linearised force of each part, and the force of each actuator multiplied by the motion ratio in equilibrium.

    Attributes:
        acts: True for each suspension that has a force in addition to those in the linear model, shape (s,).
        states: number k of internal states of parts; the states are in the order of `VehicleKind.of_parts`.
        moves: True if the time derivative of an internal state differs from its value in the linear model.
        inertial: True if a part has an inertance that is not in the linear model.
    """

    def __init__(self, vehicles: Sequence[Vehicle], by_motor: bool = False, whole: bool = True, contacts: bool = True) -> None:
        """Prepares the computation of the forces for N vehicles, or for one vehicle in any number of runs.

        Args:
            vehicles: the N vehicles, or one vehicle for any number of runs.
            by_motor: True to include only parts that MuJoCo cannot represent with its own elements.
            contacts: False to omit parts that have no effect within the linear range, such as bump stops.
            whole: True to add the linearised forces of the elements of `[parts]`. Linear models contain the linearised forces,
                but the equations of motion of the vehicle types do not. If `whole` is True, the time derivatives of internal
                states are complete; otherwise, they are deviations from the linear model.
        """
        suspensions, inputs = vehicles[0].kind.suspensions, vehicles[0].linear_model.inputs
        rows = [_forces(vehicle, by_motor, whole, contacts) for vehicle in vehicles]
        self.acts, self.states, self.inertial = np.zeros(len(suspensions), dtype=bool), len(vehicles[0].kind.of_parts), False
        groups, self._stacks = list[list[int]](), list[tuple[Array | slice, Array | None, Array, Stack]]()
        for k, (place, _, line, _) in enumerate(rows[0]):
            self.acts[place] = True
            for some in groups:
                its_line = rows[0][some[0]][2]
                elsewhere = place not in [rows[0][j][0] for j in some]
                if line == its_line and elsewhere and all(alike(row[some[0]][1], row[k][1]) for row in rows):
                    some.append(k)
                    break
            else:
                groups.append([k])
        for some in groups:
            columns, (_, part, line, _) = np.array([rows[0][k][0] for k in some]), rows[0][some[0]]
            own = np.array([inputs.index(suspensions[i].force) for i in columns]) if part.inputs else None
            every = slice(None) if np.array_equal(columns, np.arange(len(suspensions))) else columns
            kept = np.array([rows[0][k][3] + i for k in some for i in range(len(part.states))], dtype=int)
            parts = [[row[k][1] for k in some] for row in rows]
            self._stacks.append((every, own, kept, Stack(parts, line)))
            self.inertial |= any(one.line.inertance and (line or one.is_nonlinear) for row in parts for one in row)

    @property
    def moves(self) -> bool:
        """True if the time derivative of a part's internal state differs from its value in the linear model."""
        return any(len(kept) for _, _, kept, _ in self._stacks)

    def __call__(self, d: Array, v: Array, inputs: Array, z: Array | None = None) -> Array:
        """Returns the suspension forces without the forces of inertial parts [N], shape (..., N, s).

        Args:
            d: suspension deflections at the wheels [m], shape (..., N, s).
            v: time derivatives of the suspension deflections at the wheels [m/s], shape (..., N, s).
            inputs: actuator forces [N], and coefficients of semi-active dampers relative to the nominal coefficients [N s/m],
                shape (..., N, m).
            z: internal states of the parts, shape (..., N, k).
        """
        pulls = None
        for columns, _, parts, at in self._at(d, v, inputs, z):
            pull = parts.beyond(*at)
            if isinstance(columns, slice):
                pulls = pull if pulls is None else pulls + pull
            else:
                pulls = np.zeros(d.shape) if pulls is None else pulls
                pulls[..., columns] += pull
        return np.zeros(d.shape) if pulls is None else pulls

    def inertance(self, d: Array) -> Array:
        """Returns the forces of inertial parts divided by the second derivatives of the deflections [kg], shape (..., N, s)."""
        total = np.zeros(d.shape)
        for columns, _, _, parts in self._stacks:
            total[..., columns] += parts.inertance(d[..., columns])
        return total

    def rates(self, d: Array, v: Array, inputs: Array, z: Array) -> Array:
        """Returns the time derivatives of the parts' internal states, shape (..., N, k). For the arguments, see `__call__`."""
        rates = np.zeros(z.shape)
        for _, kept, parts, at in self._at(d, v, inputs, z) if self.states else ():
            if len(kept):
                rates[..., kept] = parts.rate(*at).reshape(*z.shape[:-1], -1)
        return rates

    def _at(self, d: Array, v: Array, inputs: Array, z: Array | None) -> Iterator[tuple[Array | slice, Array, Stack, Any]]:
        """Yields groups of parts that are evaluated together, each with its suspensions, internal states and the arguments of
        its forces.
        """
        for columns, own, kept, parts in self._stacks:
            states = None
            if z is not None and len(kept):
                states = z[..., kept].reshape(*z.shape[:-1], parts.columns, -1)
            yield columns, kept, parts, (d[..., columns], v[..., columns], states, 0.0 if own is None else inputs[..., own])


def _forces(vehicle: Vehicle, by_motor: bool, whole: bool, contacts: bool) -> list[tuple[int, Part, bool, int]]:
    """Returns a row for each part of a vehicle.

    A row contains the index of the suspension, the part, and a flag that is True if the linearised force of the part is
    included. The last entry of a row is the index of the part's first internal state.
    """
    forces = list[tuple[int, Part, bool, int]]()
    if not vehicle.parts:
        return forces
    together = FEATURES.load("parts at motion ratios").together
    starts = np.cumsum([0, *(len(one.part.states) for one in vehicle.parts)]).tolist()
    first = {id(one): start for one, start in zip(vehicle.parts, starts, strict=False)}
    for i, place in enumerate(vehicle.kind.suspensions):
        here = [one for one in vehicle.parts if one.deflection == place.deflection and (contacts or not one.part.contact)]
        acting = [one for one in here if (one.acts if whole else one.part.acts) and not (by_motor and one.native)]
        own = [one for one in acting if not (whole and one.element)]
        joined = together([one.part for one in own]) if len(own) > 1 else None
        forces += [(i, one.part, False, first[id(one)]) for one in own] if joined is None else [(i, joined, False, 0)]
        forces += [(i, one.part, True, first[id(one)]) for one in acting if whole and one.element]
    return forces


class MotionRatios:
    """Motion ratios of the inputs of N vehicles of one type, or of one vehicle for any number of runs.

    Attributes:
        over_travel: names of the inputs whose motion ratio changes with suspension travel.
    """

    def __init__(self, vehicles: Sequence[Vehicle]) -> None:
        """Stores the motion ratios of the vehicles."""
        first, self._tables = vehicles[0], dict[str, "list[tuple[RatioTable, Array | slice, Array]]"]()
        self._inputs, self._places = first.linear_model.inputs, {one.force: i for i, one in enumerate(first.kind.suspensions)}
        self._at_rest = {force: np.array([one.motion_ratios[force] for one in vehicles]) for force in self._inputs}
        for force in self._inputs:
            place = first.kind.suspensions[self._places[force]] if force in self._places else None
            tables = [None if place is None else one.kind.table_of(place) for one in vehicles]
            for table in {id(one): one for one in tables if one is not None}.values():
                own = np.array([one is table for one in tables])
                runs = slice(None) if own.all() else own
                self._tables.setdefault(force, []).append((table, runs, self._at_rest[force][runs] / table.at_rest))
        self.over_travel = tuple(self._tables)

    def of(self, force: str, deflection: Array) -> Array:
        """Returns the motion ratio of an input at the deflections of the input's suspension [m], shape (..., N)."""
        ratios = np.broadcast_to(self._at_rest[force], deflection.shape).copy()
        for table, runs, factor in self._tables.get(force, ()):
            ratios[..., runs] = factor * table(deflection[..., runs])
        return ratios

    def travel(self, force: str, deflection: Array) -> Array:
        """Returns the travel of an actuator from equilibrium [m], which is the integral of the actuator's motion ratio over the
        deflection.

        For the arguments, see `of`.
        """
        travels = self._at_rest[force] * deflection
        for table, runs, factor in self._tables.get(force, ()):
            travels[..., runs] = factor * table.travel(deflection[..., runs])
        return travels

    def turn(self, force: str, deflection: Array) -> Array:
        """Returns the motion ratio of an input divided by the ratio in equilibrium, shape (..., N)."""
        return self.of(force, deflection) / self._at_rest[force]

    def turns(self, travels: Array) -> Array:
        """Returns the motion ratio of every input divided by the ratio in equilibrium, shape (..., N, m).

        Args:
            travels: deflections of the suspensions [m], shape (..., N, s).
        """
        turned = np.ones((*travels.shape[:-1], len(self._inputs)))
        for force in self.over_travel:
            turned[..., self._inputs.index(force)] = self.turn(force, travels[..., self._places[force]])
        return turned
