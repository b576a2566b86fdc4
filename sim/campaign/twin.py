"""The exact sampled responses of many runs, beside them and as fast."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import linalg

from models.common.arrays import Array
from models.vehicle import Vehicle
from sim.campaign.plan import PlannedRun
from sim.linear.curved import is_curved
from sim.linear.dampers import is_linear
from sim.linear.loop import readings_of_loads
from sim.physics.blocks import DIVERGED
from sim.physics.watched import Watched
from sim.response.response import SILENT
from sim.ride.metrics import Meter
from synth.controller import Controller
from synth.implemented.controlled import sampled
from synth.sampled.hold import held_inputs


class Twin:
    """The exact linear responses of the runs, sampled as in `sim.linear.loop`, beside them and as fast.

    Sums run over states one by one, as in `sim.physics.simulate`. A controller that is more than a gain, a vehicle with curves,
    and one with adjustable dampers that are asked for forces, which is no linear one then, have no twin here.
    """

    def __init__(self, runs: Sequence[PlannedRun], watched: Watched, first: int | None, loaded: bool) -> None:
        """Of runs that are watched, measured from sample `first` on, as a `Meter` does; not at all, if that is None."""
        vehicle = runs[0].vehicle
        self.signals, self.now, self.midway, self.loads = vehicle.kind.signals, watched.now, watched.midway, watched.loads
        timestep = watched.timestep
        linear = all(is_linear(run.vehicle, run.controller) for run in runs if isinstance(run.controller, Controller))
        self.ideal = vehicle.implementation.ideal and linear and not is_curved(vehicle)
        systems: dict[Any, Any] = {}
        for run in runs:
            if run.system not in systems:
                assert isinstance(run.controller, Controller), "it is linear"
                systems[run.system] = _system(run.vehicle, run.controller, timestep)
        # By entry of the matrices, runs last: shapes (n, n, N), (n, r, N), (n, r, N), (n, r, N), (p, n, N), (p, r, N); and of
        # loads (n, l, N), (n, l, N), (p, l, N), (p, l, N).
        self.loop, self.of_now, self.of_midway, self.jump, self.C, self.Cr, self.of_loads, self.of_felt, self.Dl, self.D_felt = (
            np.stack([systems[run.system][i] for run in runs], axis=-1) for i in range(10)
        )
        self.outputs = vehicle.linear_model.outputs
        place = [signal.name for signal in self.signals]
        self.index = [place.index(name) for name in self.outputs]
        self.xi = np.zeros((self.loop.shape[0], len(runs)))
        self.off, self.peak = np.zeros((len(self.outputs), len(runs))), np.zeros((len(self.outputs), len(runs)))
        self.known = [i for i, name in enumerate(self.outputs) if name in vehicle.linear_model.states]
        pushed = [run.road.loaded for run in runs]
        self.meter = None if first is None else Meter([run.vehicle for run in runs], timestep, first, loaded, pushed)

    def update(self, start: int, values: Array, until: Array, times: Array) -> None:
        """Compares the next block of signals, shape (B, S, N), before the times [s] until which it is linear, shape (N,)."""
        if not self.ideal:
            return
        some = slice(start, start + len(values))
        now, midway = np.moveaxis(self.now[some], 1, 2), np.moveaxis(self.midway[some], 1, 2)
        push, jump = _applied(self.of_now, now) + _applied(self.of_midway, midway), _applied(self.jump, now)
        loads = felt = None
        if self.loads is not None:  # an acceleration is measured before a new load acts
            before = self.loads[start - 1 : start] if start else np.zeros_like(self.loads[:1])
            loads, felt = (np.moveaxis(one, 1, 2) for one in (self.loads[some], np.concatenate([before, self.loads[some]])[:-1]))
            push += _applied(self.of_loads, loads) + _applied(self.of_felt, felt)
        states = np.empty_like(push)
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable loop overflows; its run says so
            for k in range(len(values)):
                states[k] = self.xi
                self.xi = (self.loop * self.xi).sum(axis=1) + push[k]
            states += jump
            linear = times[-1] < until
            for i in self.known if self.meter is None else range(len(self.outputs)):
                output = states[:, i] if self.meter is None else _row(self.C[i], states) + _row(self.Cr[i], now)
                if self.meter is not None and loads is not None and felt is not None:
                    output = output + _row(self.Dl[i], loads) + _row(self.D_felt[i], felt)
                apart = np.abs(values[:, self.index[i]] - output)
                size = np.abs(output)
                if not linear.all():
                    before = times[:, None] < until
                    apart, size = np.where(before, apart, 0.0), np.where(before, size, 0.0)
                self.off[i] = np.maximum(self.off[i], apart.max(axis=0))
                self.peak[i] = np.maximum(self.peak[i], size.max(axis=0))
                if self.meter is not None:
                    values[:, self.index[i]] = output
            if self.meter is not None:
                self.meter.update(np.clip(values, -DIVERGED, DIVERGED))

    def errors(self) -> Array:
        """Largest difference of any state from its twin, over the twin's peak, shape (N,); NaN where there is no twin."""
        if not self.ideal:
            return np.full(self.off.shape[1], np.nan)
        units = [next(signal.unit for signal in self.signals if signal.name == name) for name in self.outputs]
        worst = np.zeros(self.off.shape[1])
        for i in self.known:
            loudest = np.max([self.peak[j] for j in self.known if units[j] == units[i]], axis=0)
            scale = np.maximum(self.peak[i], SILENT * loudest)
            worst = np.maximum(worst, np.divide(self.off[i], scale, out=np.zeros_like(scale), where=scale > 0))
        return worst

    def metrics(self) -> Mapping[str, Array]:
        """The twin's metrics, where a road that is not random asks for them."""
        return self.meter.result() if self.meter is not None and self.ideal else {}


def _system(vehicle: Vehicle, controller: Controller, timestep: float) -> tuple[Array, ...]:
    """The sampled loop as `sim.linear.loop` has it: xi' = loop xi + of_now z_r + of_midway z_r(h/2), x = xi + jump z_r.

    Loads f add of_loads f, and of_felt times those of the step before, by way of measured accelerations; so do they to outputs.
    """
    cut = sampled(vehicle, controller, timestep)
    model, G = cut.model, cut.inputs(cut.asked)
    felt = cut.inputs(*np.split(readings_of_loads(cut, controller), [cut.forces]))
    Phi, Gamma_u, Gamma_r = held_inputs(model.A, timestep, linalg.expm, model.B, model.A @ model.Bw + model.Br)
    Gamma_l = held_inputs(model.A, timestep, linalg.expm, model.Bl)[1]
    of_road = (Gamma_u @ G @ model.Bw, Gamma_r, model.Bw, model.C + model.D @ G, model.Cr)
    return Phi + Gamma_u @ G, *of_road, Gamma_l, Gamma_u @ felt, model.Dl, model.D @ felt


def _applied(matrix: Array, inputs: Array) -> Array:
    """A matrix per run, shape (n, r, N), on inputs (B, r, N), shape (B, n, N)."""
    total = np.zeros((len(inputs), matrix.shape[0], matrix.shape[2]))
    for i in range(matrix.shape[0]):
        total[:, i] = _row(matrix[i], inputs)
    return total


def _row(row: Array, inputs: Array) -> Array:
    """One row of such a matrix, shape (r, N), on inputs (B, r, N), shape (B, N)."""
    total = np.zeros((len(inputs), row.shape[1]))
    for j in np.flatnonzero(row.any(axis=1)):
        total += row[j] * inputs[:, j]
    return total
