"""What the sections of a report share: what it is about, and how it writes a number."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from models.vehicle import Vehicle
from synth.controller import Controller, Designer

BUMP_DURATION = 3.0  # s
AMPLITUDE = 1e-4  # m, of the roads that frequency responses are identified on


@dataclass(frozen=True, eq=False)
class Scope:
    """What a report is about.

    Attributes:
        vehicle: the vehicle.
        designer: its designs.
        controllers: those that are reported.
        timestep: of the physics [s].
        quick: without margins, map and ride.
        progress: is told what is being done.
    """

    vehicle: Vehicle
    designer: Designer
    controllers: tuple[Controller, ...]
    timestep: float
    quick: bool
    progress: Callable[[str], None]

    @property
    def active(self) -> list[Controller]:
        """Those that do something, and are stable."""
        return [one for one in self.controllers if np.any(one.gain) and one.certificate.stable]


def number(value: float | None, form: str) -> str:
    """A number as a table has it; - where there is none."""
    return format(value, form) if value is not None and math.isfinite(value) else "-"
