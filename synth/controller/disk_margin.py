"""Symmetric disk margin of a loop that is cut at its actuators (see `Loop.cut`).

The margin is 1 / ||S - I / 2|| with S = (I - L)^-1, where L is the loop transfer function. Each force may be multiplied by its
own complex factor f. The loop is stable as long as |f - 1| / |f + 1| is below half the margin for every factor (Seiler,
Packard, Gahinet 2020).
"""

import math
from dataclasses import dataclass

import numpy as np

from synth.analysis.norm import hinf_norm
from synth.plant.generalized import Plant
from synth.plant.state_space import StateSpace


@dataclass(frozen=True)
class DiskMargin:
    """Symmetric disk margin: how far all forces may change at the same time, each by its own complex factor.

    Attributes:
        size: margin from 0 to 2. For a single force, the margin is exact. For several forces with independent factors, the
            computed margin is a lower bound.
        frequency: frequency at which the loop is closest to instability [rad/s].
    """

    size: float
    frequency: float

    @property
    def gain(self) -> tuple[float, float]:
        """Smallest and largest real factor by which the forces can be multiplied while the loop remains stable."""
        return (2 - self.size) / (2 + self.size), (2 + self.size) / (2 - self.size) if self.size < 2 else math.inf

    @property
    def phase(self) -> float:
        """Largest phase lead or lag of the forces for which the loop is stable [rad]."""
        return 2 * math.atan(self.size / 2)


def disk_margin(cut: StateSpace) -> DiskMargin:
    """Returns the symmetric disk margin of a cut loop. The closed loop must be stable."""
    inverse, half = np.linalg.inv(np.eye(len(cut.D)) - cut.D), np.eye(len(cut.D)) / 2
    # The system is x' = A x + B u with u = v + d and z = u - d / 2.
    norm = hinf_norm(Plant.without_inputs(cut.loop_matrix(1.0), cut.B @ inverse, inverse @ cut.C, inverse - half))
    return DiskMargin(min(1 / norm.value, 2.0), norm.peak_frequency)
