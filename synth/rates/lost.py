"""The slowest computer that keeps a loop stable: where, from the fastest one on, its sampled loop is lost.

Stability is that of the sampled loop itself. From one period that is tried to the next no mode of the vehicle or of the law turns
by more than a tenth of a radian, as long as anything is left of it. Between the last that is stable and the first that is not the
interval is halved until it is nothing.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from models.common.arrays import Array
from models.reality import LONGEST_PERIOD, Implementation
from models.vehicle import Vehicle
from synth.controller import Controller
from synth.implemented.controlled import sampled
from synth.implemented.norm import sampled_loop
from synth.sampled.norm import stable

SHORTEST = 1e-5  # s; a computer of 100 kHz is the fastest that is asked about
TURN = 0.1  # rad that a mode turns by from one period that is tried to the next
GONE = 25.0  # time constants, after which e^-25 is left of a mode
CLOSE = 1e-12  # relative, of two periods


def lost_from(vehicle: Vehicle, controller: Controller, delay: float) -> float:
    """The shortest sample period at which a loop is not stable [s]; infinite where there is none up to `LONGEST_PERIOD`.

    Args:
        vehicle: the vehicle; what its `[implementation]` says of sampling and delay does not count.
        controller: its controller.
        delay: from a measurement to the force computed from it, in samples.

    Returns:
        0 where not even the fastest computer keeps it.
    """

    def kept(period: float) -> bool:
        return stable(sampled_loop(replace(vehicle, implementation=Implementation(period, delay)), controller))

    if not kept(SHORTEST):
        return 0.0
    modes, before = _modes(vehicle, controller), SHORTEST
    while before < LONGEST_PERIOD:
        alive = modes[-np.real(modes) * before < GONE]
        fastest = float(np.abs(alive).max(initial=1 / LONGEST_PERIOD))
        after = min(before + TURN / fastest / (1 + delay), LONGEST_PERIOD)
        if not kept(after):
            return _between(kept, before, after)
        before = after
    return np.inf


def _between(kept: Callable[[float], bool], before: float, after: float) -> float:
    """Where a loop is lost between a period at which it is kept and one at which it is not."""
    while after - before > CLOSE * after:
        middle = (before + after) / 2
        before, after = (middle, after) if kept(middle) else (before, middle)
    return after


def _modes(vehicle: Vehicle, controller: Controller) -> Array:
    """Poles of the vehicle, its actuators and the law, by themselves [rad/s]."""
    law = controller.law.continuous()
    of_car = np.linalg.eigvals(sampled(vehicle, controller, SHORTEST).model.A)
    return np.concatenate([of_car, np.linalg.eigvals(law.A)])
