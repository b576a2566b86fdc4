"""The symmetric disk margin of a loop that is cut at its actuators, as in `loop_transfer.py`.

It is 1 / ||S - I / 2|| with S = (I - L)^-1: each force may have a complex factor f of its own with |f - 1| / |f + 1| below half
of it (Seiler, Packard, Gahinet 2020).
"""

import math
from dataclasses import dataclass

import numpy as np

from synth.analysis.norm import hinf_norm
from synth.controller.loop_transfer import LoopTransfer
from synth.plant.generalized import Plant


@dataclass(frozen=True)
class DiskMargin:
    """Symmetric disk margin: the complex factors that all forces tolerate simultaneously, each its own.

    Attributes:
        size: margin from 0 to 2; exact for one force, a bound for several, whose factors may depend on each other.
        frequency: frequency at which the loop is closest to instability [rad/s].
    """

    size: float
    frequency: float

    @property
    def gain(self) -> tuple[float, float]:
        """The smallest and the largest real factor."""
        return (2 - self.size) / (2 + self.size), (2 + self.size) / (2 - self.size) if self.size < 2 else math.inf

    @property
    def phase(self) -> float:
        """The largest turn, either way [rad]."""
        return 2 * math.atan(self.size / 2)


def disk_margin(loop: LoopTransfer) -> DiskMargin:
    """Returns the symmetric disk margin of a loop that is stable when closed."""
    inverse, half = np.linalg.inv(np.eye(len(loop.H)) - loop.H), np.eye(len(loop.H)) / 2
    n, k = loop.B.shape
    # x' = A x + B u, u = v + d, and z = u - d / 2.
    sensitivity = Plant(
        A=loop.closed(1.0),
        B=np.zeros((n, 1)),
        Bw=loop.B @ inverse,
        C=inverse @ loop.G,
        D=np.zeros((k, 1)),
        Dw=inverse - half,
    )
    norm = hinf_norm(sensitivity)
    return DiskMargin(min(1 / norm.value, 2.0), norm.peak_frequency)
