"""Exact linear responses of N runs with linear laws, computed together in blocks, as in `sim.linear.sampled_response`.

The equations are xi' = A xi + sum of B v and y = C xi + sum of D v, with inputs v. The state xi does not jump when the road
jumps. The matrix products are evaluated state by state, because this takes half the time of products of small matrices.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, cast

import numpy as np

from models.common.arrays import Array
from models.vehicle.limits_and_implementation import Implementation, steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.drive.case import Batch
from sim.drive.driver import RunDriver
from sim.linear.outputs import forces_ahead
from synth.controller.loop_of import HEIGHT, HELD, MIDWAY, READ, SIGNAL, loop_of, pushes, with_ending
from synth.plant.state_space import StateSpace

if TYPE_CHECKING:
    from synth.controller.controller import Controller


class ResponseBatch:
    """Linear responses of the runs of a batch.

    Attributes:
        outputs: names of the outputs of the linear model.
        index: index of each output among the signals of the vehicle.
    """

    def __init__(self, batch: Batch) -> None:
        vehicle, self._batch, timestep = batch.vehicles[0], batch, batch.timestep
        self.outputs, road, held = vehicle.linear_model.outputs, vehicle.linear_model.disturbances, pushes(vehicle.linear_model)
        groups = [(batch.now, with_ending(road, HEIGHT)), (batch.midway, with_ending(road, MIDWAY))]
        if batch.held_inputs is not None:
            effects = {HELD: "held_inputs", SIGNAL: "in_signals", READ: "in_readings"}
            for ending, values in effects.items():
                groups.append((np.stack([getattr(one, values) for one in batch.inputs], axis=1), with_ending(held, ending)))
        if any(one.preview is not None for one in batch.drivers):
            ahead = np.zeros((len(batch.now), len(batch.cases), len(vehicle.linear_model.inputs)))
            for i, (one, on) in enumerate(zip(batch.drivers, batch.inputs, strict=True)):
                if one.preview is not None:
                    ahead[:, i] = forces_ahead(one.preview, on, steps_per_sample(on.vehicle.implementation, timestep))
            groups.append((ahead, vehicle.linear_model.inputs))
        keys = [(id(one.vehicle), id(one.driver)) for one in batch.cases]
        distinct = dict(zip(keys, batch.cases, strict=True))
        loops = {key: _closed_loop(one.vehicle, one.driver, timestep) for key, one in distinct.items()}
        systems = [loops[key].part(self.outputs, loops[key].inputs) for key in keys]
        # Entries of the matrices for N runs: A with shape (n, n, N) and C with shape (p, n, N). Each input has values with
        # shape (T, N, r), B with shape (n, r, N), and D with shape (p, r, N).
        self._A, self._C, B, D = (np.stack([getattr(one, name) for one in systems], axis=-1) for name in "ACBD")
        columns = [systems[0].columns(names) for _, names in groups]
        self._inputs = [(values, B[:, some], D[:, some]) for (values, _), some in zip(groups, columns, strict=True)]
        signals = [signal.name for signal in vehicle.kind.signals]
        self.index = [signals.index(name) for name in self.outputs]
        self._xi = np.zeros((self._A.shape[0], len(systems)))
        for i, one in enumerate(batch.vehicles):
            if (start := one.start_state) is not None:
                self._xi[: len(start), i] = start

    def block(self, samples: slice) -> Callable[[int], Array]:
        """Advances all runs by the next block of samples. Returns a function that computes the values of an output, shape (B,
        N), from the index of this output.
        """
        inputs = [(np.moveaxis(one[samples], 1, 2), B, D) for one, B, D in self._inputs]
        push = np.stack([sum(_row(B[i], one) for one, B, _ in inputs) for i in range(len(self._xi))], axis=1)
        states, products, moving = np.empty_like(push), np.empty_like(self._A), list(self._batch.steady(samples))
        for k in range(len(push)):
            states[k] = self._xi
            np.multiply(self._A, self._xi, out=products)
            np.add.reduce(products, axis=1, out=self._xi)
            self._xi += push[k]

        def output(i: int) -> Array:
            values = _row(self._C[i], states) + sum(_row(D[i], one) for one, _, D in inputs)
            for run, steady in moving:
                values[:, run] += steady[:, self.index[i]]
            return values

        return output


def _closed_loop(vehicle: Vehicle, driver: RunDriver, timestep: float) -> StateSpace:
    """Returns the discrete-time model of the closed loop from one step to the next, for a law without delay."""
    law = cast("Controller", driver)  # the driver of each run is a linear controller
    return loop_of(replace(vehicle, implementation=Implementation()), law, timestep).closed_loop


def _row(row: Array, inputs: Array) -> Array:
    """Returns the product of one matrix row for each run, shape (r, N), and inputs, shape (B, r, N); the result has shape (B,
    N).
    """
    total = np.zeros((len(inputs), row.shape[1]))
    for j in np.flatnonzero(row.any(axis=1)):
        total += row[j] * inputs[:, j]
    return total
