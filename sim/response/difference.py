"""Where physics leaves the linear analysis, sample by sample: MuJoCo minus the sampled response, over each signal's peak."""

from dataclasses import replace

import numpy as np

from models.common.arrays import Array
from sim.response.response import Response


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # an unstable loop overflows
def difference(physics: Response, sampled: Response) -> Response:
    """The difference of two responses over the sampled one's peak, without a unit: what the verdict takes the largest of.

    Args:
        physics: a run in MuJoCo.
        sampled: its exact sampled response, at the same times.

    Returns:
        The signals that the vehicle makes, by their own names. Those of the road, which both are given, are left out.
    """
    made = tuple(signal for signal in sampled.signals if not signal.name.startswith("road_"))
    columns: list[Array] = []
    for signal in made:
        scale = sampled.scale(signal.name) or 1.0  # a vehicle that nothing moves
        apart = (physics[signal.name] - sampled[signal.name]) / scale
        columns.append(np.where(np.isnan(apart), np.nan, apart))  # of NaNs machines know several, and logs are compared by bytes
    about = "MuJoCo minus linear, over the peak"  # a log has these words, and logs that there are have them
    signals = tuple(replace(s, symbol=f"({s.symbol}) / peak", unit="1", meaning=f"{about}: {s.meaning}") for s in made)
    return Response(sampled.time, signals, np.stack(columns, axis=-1) if columns else np.zeros((len(sampled.time), 0)))
