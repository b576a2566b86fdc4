"""A band as a weight: a filter that is at least one in it and falls beside it, before w.

A bound on the weighted norm is one on the norm in the band. It is how a bound that is only known to hold for whole norms, as
that over a box of errors, is proved of a band. What it loses lies at the edges, where the filter takes some room to fall.
"""

from functools import reduce
from typing import cast

import numpy as np

from models.common.arrays import Array
from synth.design.multi_objective.band_norm import EVERYWHERE, Band
from synth.design.multi_objective.problem import MeasuredPlant
from synth.plant.augmented import System, append, gain, series, transfer_function, with_weights

ORDER = 4  # even: of a wide band an odd one has poles that no section of two can hold
RIPPLE = 0.02  # dB above one, in the band
BESIDE = 30.0  # dB below, beside it


def in_band(posed: MeasuredPlant, band: Band) -> MeasuredPlant:
    """The plant whose norm is at least that in the band; the plant itself for all frequencies.

    Args:
        band: from and to [rad/s].
    """
    if band == EVERYWHERE:
        return posed
    plant = posed.plant
    before = append(*[band_filter(band)] * plant.Bw.shape[1])
    wide = with_weights(plant, gain(np.eye(len(plant.C))), before)
    Dyw = np.zeros((len(posed.Cy), plant.Bw.shape[1])) if posed.Dyw is None else posed.Dyw
    Cy = np.hstack([posed.Cy, Dyw @ before.C])
    return MeasuredPlant(wide, Cy, None if posed.Dyw is None else Dyw @ before.D, posed.through)


def band_filter(band: Band) -> System:
    """At least one in the band [rad/s], at most `RIPPLE` above, and below `BESIDE` beside it: an elliptic filter."""
    from scipy import signal  # half a second

    low, high = band
    kind, edges = ("lowpass", high) if low == 0 else ("highpass", low) if np.isinf(high) else ("bandpass", [low, high])
    zpk = signal.ellip(ORDER, RIPPLE, BESIDE, edges, kind, analog=True, output="zpk")
    z, p, k = cast("tuple[Array, Array, float]", zpk)  # as `output` asks
    sections = signal.zpk2sos(z, p, k * 10 ** (RIPPLE / 20), analog=True)
    return reduce(series, (transfer_function(section[:3], section[3:]) for section in sections))
