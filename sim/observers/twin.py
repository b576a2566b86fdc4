"""Twin of a run: its exact linear response, which is computed during the run and compared with the simulated signals."""

from typing import Protocol

import numpy as np

from models.common.arrays import Array
from sim.drive.case import Batch
from sim.drive.loop import DIVERGENCE_LIMIT, Block
from sim.drive.response import SILENT, loudest_alike
from sim.linear.response_batch import ResponseBatch
from sim.observers.ends import Ends


class SignalMeter(Protocol):
    """Meter that receives blocks of signals of the shape (B, S, N)."""

    def update(self, values: Array) -> None:
        """Receives the next block of samples."""
        ...


class Twin:
    """Comparison of N runs of linear laws with their exact linear responses.

    Attributes:
        meter: meter that receives the outputs of the linear responses; None if only the states are compared.
    """

    def __init__(self, batch: Batch, ends: Ends, meter: "SignalMeter | None" = None) -> None:
        """Prepares the comparison for the runs of a batch. The observer `ends` must observe each block before the twin."""
        self._batch, self._ends, self.meter, self._responses = batch, ends, meter, ResponseBatch(batch)
        kind, model, outputs = batch.vehicles[0].kind, batch.vehicles[0].linear_model, self._responses.outputs
        self._units = [kind.signal(name).unit for name in outputs]
        self._off, self._peak = np.zeros((len(outputs), len(batch.cases))), np.zeros((len(outputs), len(batch.cases)))
        self._states = [i for i, name in enumerate(outputs) if name in model.states]

    def take(self, block: Block) -> None:
        """Compares the next block of samples with the linear responses. If `meter` is not None, the outputs in the block are
        replaced by those of the linear response.
        """
        values, some = block.values, slice(block.start, block.start + len(block.values))
        before, index = self._batch.time[some, None] < self._ends.until, self._responses.index
        with np.errstate(over="ignore", invalid="ignore"):  # the signals of an unstable loop overflow; the run records this
            output_of = self._responses.block(some)
            for i in self._states if self.meter is None else range(len(index)):
                output = output_of(i)
                apart, size = np.abs(values[:, index[i]] - output), np.abs(output)
                if not before.all():
                    apart, size = np.where(before, apart, 0.0), np.where(before, size, 0.0)
                self._off[i] = np.maximum(self._off[i], apart.max(axis=0))
                self._peak[i] = np.maximum(self._peak[i], size.max(axis=0))
                values[:, index[i]] = output
            if self.meter is not None:
                self.meter.update(np.clip(values, -DIVERGENCE_LIMIT, DIVERGENCE_LIMIT))

    def result(self) -> list[float]:
        """Returns the largest difference of each run's states from the linear response, relative to the peak of the linear
        response.
        """
        worst = np.zeros(self._off.shape[1])
        loudest = loudest_alike(self._peak[self._states].T, [self._units[i] for i in self._states])
        for k, i in enumerate(self._states):
            scale = np.maximum(self._peak[i], SILENT * loudest[:, k])
            worst = np.maximum(worst, np.divide(self._off[i], scale, out=np.zeros_like(scale), where=scale > 0))
        return worst.tolist()
