"""Twin: the exact linear response of each run, computed beside the run and compared with its signals."""

from dataclasses import replace
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np

from models.common.arrays import Array
from models.vehicle.limits_and_implementation import Implementation, steps_per_sample
from models.vehicle.vehicle import Vehicle
from sim.drive.case import Batch
from sim.drive.driver import RunDriver
from sim.drive.loop import DIVERGENCE_LIMIT, Block
from sim.drive.response import SILENT, loudest_alike
from sim.linear.outputs import forces_ahead
from sim.observers.ends import Ends
from synth.controller.loop_of import HEIGHT, HELD, MIDWAY, READ, SIGNAL, loop_of, pushes, with_ending
from synth.plant.state_space import StateSpace

if TYPE_CHECKING:
    from synth.controller.controller import Controller


class SignalMeter(Protocol):
    """Meter of blocks of signals, shape (B, S, N)."""

    def update(self, values: Array) -> None:
        """Takes the next block."""
        ...


class Twin:
    """Exact linear responses of N runs of linear laws, sampled as in `sim.linear.sampled_response`.

    With the state xi before the road jumps, and inputs v, xi' = A xi + sum of B v and y = C xi + sum of D v. Sums run over states
    one by one, which takes half the time of a product of small matrices.

    Attributes:
        meter: measures the responses; None to compare their states alone.
    """

    def __init__(self, batch: Batch, ends: Ends, meter: "SignalMeter | None" = None) -> None:
        """Prepares the runs of a batch, which `ends` observes before."""
        vehicle, self._batch, self._ends, self.meter, timestep = batch.vehicles[0], batch, ends, meter, batch.timestep
        self.outputs, road, held = vehicle.linear_model.outputs, vehicle.linear_model.disturbances, pushes(vehicle.linear_model)
        groups = [(batch.now, with_ending(road, HEIGHT)), (batch.midway, with_ending(road, MIDWAY))]
        if batch.held is not None:
            effects = {HELD: "held", SIGNAL: "in_signals", READ: "in_readings"}
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
        # By entry of the matrices, runs last: shapes (n, n, N) and (p, n, N); of each input (T, N, r), (n, r, N) and (p, r, N).
        self._A, self._C, B, D = (np.stack([getattr(one, name) for one in systems], axis=-1) for name in "ACBD")
        columns = [systems[0].columns(names) for _, names in groups]
        self._inputs = [(values, B[:, some], D[:, some]) for (values, _), some in zip(groups, columns, strict=True)]
        signals = [signal.name for signal in vehicle.kind.signals]
        self._index = [signals.index(name) for name in self.outputs]
        self._units = [vehicle.kind.signal(name).unit for name in self.outputs]
        self._xi = np.zeros((self._A.shape[0], len(systems)))
        for i, one in enumerate(batch.vehicles):
            if (start := one.start_state) is not None:
                self._xi[: len(start), i] = start
        self._off, self._peak = np.zeros((len(self.outputs), len(systems))), np.zeros((len(self.outputs), len(systems)))
        self._states = [i for i, name in enumerate(self.outputs) if name in vehicle.linear_model.states]

    def take(self, block: Block) -> None:
        """Compares the next block, and replaces its outputs by those of the linear response if these are measured."""
        values, some = block.values, slice(block.start, block.start + len(block.values))
        inputs = [(np.moveaxis(one[some], 1, 2), B, D) for one, B, D in self._inputs]
        push = np.stack([sum(_row(B[i], one) for one, B, _ in inputs) for i in range(len(self._xi))], axis=1)
        states, products = np.empty_like(push), np.empty_like(self._A)
        before, moving = self._batch.time[some, None] < self._ends.until, list(self._batch.steady(some))
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable loop overflows; its run says so
            for k in range(len(values)):
                states[k] = self._xi
                np.multiply(self._A, self._xi, out=products)
                np.add.reduce(products, axis=1, out=self._xi)
                self._xi += push[k]
            for i in self._states if self.meter is None else range(len(self.outputs)):
                output = _row(self._C[i], states) + sum(_row(D[i], one) for one, _, D in inputs)
                for run, steady in moving:
                    output[:, run] += steady[:, self._index[i]]
                apart, size = np.abs(values[:, self._index[i]] - output), np.abs(output)
                if not before.all():
                    apart, size = np.where(before, apart, 0.0), np.where(before, size, 0.0)
                self._off[i] = np.maximum(self._off[i], apart.max(axis=0))
                self._peak[i] = np.maximum(self._peak[i], size.max(axis=0))
                values[:, self._index[i]] = output
            if self.meter is not None:
                self.meter.update(np.clip(values, -DIVERGENCE_LIMIT, DIVERGENCE_LIMIT))

    def result(self) -> list[float]:
        """Returns the largest difference of any state from that of each run, over the peak of the linear response."""
        worst = np.zeros(self._off.shape[1])
        loudest = loudest_alike(self._peak[self._states].T, [self._units[i] for i in self._states])
        for k, i in enumerate(self._states):
            scale = np.maximum(self._peak[i], SILENT * loudest[:, k])
            worst = np.maximum(worst, np.divide(self._off[i], scale, out=np.zeros_like(scale), where=scale > 0))
        return worst.tolist()


def _closed_loop(vehicle: Vehicle, driver: RunDriver, timestep: float) -> StateSpace:
    """Returns the closed loop from step to step, of a law that acts at once or not at all."""
    law = cast("Controller", driver)  # it is linear
    return loop_of(replace(vehicle, implementation=Implementation()), law, timestep).closed_loop


def _row(row: Array, inputs: Array) -> Array:
    """Returns the product of a row of such a matrix, shape (r, N), and inputs (B, r, N), shape (B, N)."""
    total = np.zeros((len(inputs), row.shape[1]))
    for j in np.flatnonzero(row.any(axis=1)):
        total += row[j] * inputs[:, j]
    return total
