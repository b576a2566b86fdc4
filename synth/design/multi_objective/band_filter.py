"""Filter that represents a frequency band as a weight on w: its gain is at least one in the band and small outside the band.

A bound on the norm with the filter is also a bound on the norm in the band. Some bounds, such as the norm over a box of gain
errors, can only be proved over all frequencies. With the filter, a bound over all frequencies also proves a bound for a band.
The bound is less tight near the edges of the band, because the gain of the filter decreases only gradually there.
"""

from functools import reduce
from typing import cast

import numpy as np

from models.common.arrays import Array
from synth.design.descent.landscape import EVERYWHERE, Band
from synth.plant.augmented import append, gain, series, transfer_function, with_weights
from synth.plant.generalized import Plant
from synth.plant.state_space import StateSpace

# the order is even, because second-order sections cannot always represent the poles of an odd order if the band is wide
ORDER = 4
RIPPLE = 0.02  # largest gain of the filter in the band [dB]
BESIDE = 30.0  # attenuation of the filter outside the band [dB]


def in_band(plant: Plant, band: Band) -> Plant:
    """Returns a plant whose norm over all frequencies is at least the norm of the given plant in a band [rad/s].

    If the band contains all frequencies, the plant is returned unchanged.
    """
    if band == EVERYWHERE:
        return plant
    before = append(*[band_filter(band)] * plant.Bw.shape[1])
    return with_weights(plant, gain(np.eye(len(plant.C))), before)


def band_filter(band: Band) -> StateSpace:
    """Returns an elliptic filter with a gain of at least one in the band [rad/s].

    In the band, the gain exceeds one by at most `RIPPLE` [dB]. Outside the band, the gain is at least `BESIDE` [dB] below one.
    """
    from scipy import signal  # this import takes half a second

    low, high = band
    kind, edges = ("lowpass", high) if low == 0 else ("highpass", low) if np.isinf(high) else ("bandpass", [low, high])
    zpk = signal.ellip(ORDER, RIPPLE, BESIDE, edges, kind, analog=True, output="zpk")
    z, p, k = cast("tuple[Array, Array, float]", zpk)  # the option `output` selects zeros, poles and gain
    sections = signal.zpk2sos(z, p, k * 10 ** (RIPPLE / 20), analog=True)
    return reduce(series, (transfer_function(section[:3], section[3:]) for section in sections))
