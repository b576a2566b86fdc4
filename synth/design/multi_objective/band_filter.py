"""Filter before w whose gain is at least one in a band and falls outside: a band as a weight.

A bound on the norm with this filter is also a bound on the norm in the band. Some bounds are only known for norms over all
frequencies, such as that over a box of errors; this filter proves them for a band. The bound is looser at the edges, where the
filter needs some room to fall.
"""

from functools import reduce
from typing import cast

import numpy as np

from models.common.arrays import Array
from synth.design.multi_objective.band_norm import EVERYWHERE, Band
from synth.plant.augmented import append, gain, series, transfer_function, with_weights
from synth.plant.generalized import Plant
from synth.plant.state_space import StateSpace

ORDER = 4  # even: for a wide band an odd order has poles that no second-order section can represent
RIPPLE = 0.02  # dB above one, in the band
BESIDE = 30.0  # dB below, beside it


def in_band(plant: Plant, band: Band) -> Plant:
    """Returns a plant whose norm is at least the norm in the band [rad/s]; for a band of all frequencies, the plant itself."""
    if band == EVERYWHERE:
        return plant
    before = append(*[band_filter(band)] * plant.Bw.shape[1])
    return with_weights(plant, gain(np.eye(len(plant.C))), before)


def band_filter(band: Band) -> StateSpace:
    """Returns an elliptic filter with a gain from one to `RIPPLE` above in the band [rad/s], and below `BESIDE` outside."""
    from scipy import signal  # half a second

    low, high = band
    kind, edges = ("lowpass", high) if low == 0 else ("highpass", low) if np.isinf(high) else ("bandpass", [low, high])
    zpk = signal.ellip(ORDER, RIPPLE, BESIDE, edges, kind, analog=True, output="zpk")
    z, p, k = cast("tuple[Array, Array, float]", zpk)  # the form that `output` asks for
    sections = signal.zpk2sos(z, p, k * 10 ** (RIPPLE / 20), analog=True)
    return reduce(series, (transfer_function(section[:3], section[3:]) for section in sections))
