"""Jumps of signals at samples where a piecewise-constant force, or the piecewise-constant coefficient of a semi-active damper,
changes.

A jump is called a decision if a semi-active damper causes it, or a force that is constant for more than one time step.
Peaks include the values on both sides of decisions and of vertical edges of the road (`Response.before`). Values are never
interpolated across a decision or an edge. A force that changes at every time step approximates a continuous force. For signals
that jump when a force changes at every time step, only the values just after the jumps are used.

The value of a signal at a sample is the value just after the jump, with the new force u[k]. The signal's value just before the
jump is smaller by D (u[k] - u[k-1]), where D is the feedthrough matrix of equation (28). The coefficient c of a semi-active
damper changes only at samples; its force u then jumps by -(c[k] - c[k-1]) v, where v is the suspension velocity. The force of
an actuator with a lag does not jump. A motion ratio that changes with travel causes no jump, but scales the velocity v and the
effect of the force u.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.common.arrays import Array
from models.common.extensions import FEATURES
from models.vehicle.limits_and_implementation import steps_per_sample
from models.vehicle.suspension_forces import MotionRatios
from models.vehicle.vehicle import Vehicle
from sim.drive.response import Response


def with_decisions(response: Response, vehicles: Sequence[Vehicle]) -> Response:
    """Returns the response; its attribute `before` then also contains the values just before decisions (see the module
    docstring).

    Values that `before` already contains for vertical edges of the road are kept.

    Args:
        response: response of N runs, or of a single run.
        vehicles: vehicles of the N runs, all of the same type.
    """
    timestep = float(response.time[1] - response.time[0])
    decides = np.array([bool(one.dampers) or steps_per_sample(one.implementation, timestep) > 1 for one in vehicles])
    if not decides.any():
        return response
    values = np.moveaxis(response.values.reshape(len(vehicles), *response.values.shape[-2:]), 0, -1)
    before = dict(response.before)
    for name, jump in Jumps(vehicles, vehicles[0].linear_model.outputs)(values).items():
        after = response[name]
        at_edges = before.get(name, after)
        before[name] = np.where(at_edges != after, at_edges, after - np.where(decides[:, None], jump, 0.0).reshape(after.shape))
    return replace(response, before=before)


class Jumps:
    """Computes the jumps of forces and accelerations for N runs of one vehicle type, block by block."""

    def __init__(self, vehicles: Sequence[Vehicle], signals: Sequence[str]) -> None:
        """Prepares the computation of the jumps of some output signals."""
        vehicle = vehicles[0]
        index = {signal.name: i for i, signal in enumerate(vehicle.kind.signals)}
        model, forces, outputs = vehicle.linear_model, vehicle.linear_model.inputs, vehicle.linear_model.outputs
        dampers = {one.force: one for one in vehicle.parts.adjustable}
        self.coefficient = {force: index[one.coefficient] for force, one in dampers.items()}
        self.shapes = {
            one.force: [other.parts.adjustable[i].shape for other in vehicles] for i, one in enumerate(vehicle.parts.adjustable)
        }
        self.elements = {}
        if dampers:
            range_of = FEATURES.load("damper ranges").range_of
            self.elements = {forces[one.column]: one for one in range_of(vehicles).elements}
        self.places = index
        # Each damper's suspension velocity is a sum of states times factors, which are stored by state index. All vehicles in a
        # batch have the same geometry.
        rows = {
            force: one.ratio * model.A[model.states.index(vehicle.kind.deflection_of(force))] for force, one in dampers.items()
        }
        self.rates = {force: {index[model.states[i]]: row[i] for i in np.flatnonzero(row)} for force, row in rows.items()}
        self.ratios = MotionRatios(vehicles)
        self.along = {force: index[vehicle.kind.deflection_of(force)] for force in self.ratios.over_travel}
        lagging = {force for force, one in dampers.items() if one.damper.bandwidth is not None}
        if vehicle.limits.actuator_bandwidth is not None:
            lagging |= set(forces) - set(dampers)
        D = np.stack([one.linear_model.D for one in vehicles], axis=-1)  # shape (p, m, N)
        # Change of each signal when a force jumps by one newton, shape (N, 1).
        self.shares = {
            name: {
                force: D[outputs.index(name), j][:, None]
                for j, force in enumerate(forces)
                if force not in lagging and np.any(D[outputs.index(name), j])
            }
            for name in signals
        }
        self.index = {force: index[force] for force in forces if any(force in shares for shares in self.shares.values())}
        self.before: dict[int, Array] = {}  # last sample of the previous block, by index of the signal, shape (N, 1)

    def __call__(self, values: Array) -> dict[str, Array]:
        """Returns the jumps of all signals that can jump, shape (N, B) each, for the next block of signals, shape (B, S, N)."""
        # Motion ratios of suspensions whose ratio changes with travel, relative to the ratio in equilibrium, shape (N, B).
        ratios = {force: self.ratios.turn(force, values[:, place]).T for force, place in self.along.items()}
        of_force = {force: self._jump(force, values, ratios.get(force, 1.0)) for force in self.index}
        jumps = {}
        for name, shares in self.shares.items():
            for force, share in shares.items():
                part = share * of_force[force]
                if name != force and force in ratios:
                    part *= ratios[force]
                jumps[name] = jumps[name] + part if name in jumps else part
        return jumps

    def _jump(self, force: str, values: Array, ratio: Array | float) -> Array:
        """Returns the jump of a force at every sample, shape (N, B); zero at the first sample of the run."""
        if force not in self.coefficient:
            return self._change(self.index[force], values)
        if force in self.elements:
            one, (now, last) = self.elements[force], self._pair(self.coefficient[force], values)
            return one.element.push(*one.motion(lambda name: values[:, self.places[name]]), now.T, last.T).T
        parts = [share * values[:, place].T for place, share in self.rates[force].items()]
        shaped = [shape(v) for shape, v in zip(self.shapes[force], ratio * np.sum(parts, axis=0), strict=True)]
        return -self._change(self.coefficient[force], values) * np.stack(shaped)

    def _change(self, place: int, values: Array) -> Array:
        """Returns the change of a signal from the previous sample to each sample, shape (N, B)."""
        now, last = self._pair(place, values)
        return now - last

    def _pair(self, place: int, values: Array) -> tuple[Array, Array]:
        """Returns the values of a signal at all samples, and the values one sample earlier, each of shape (N, B)."""
        now = values[:, place].T
        last = np.concatenate([self.before.get(place, now[:, :1]), now[:, :-1]], axis=1)
        self.before[place] = now[:, -1:].copy()
        return now, last
