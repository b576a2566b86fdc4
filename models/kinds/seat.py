"""Seat with a person: its numbers, `[seat]` of a vehicle file."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from models.common.arrays import Array
from models.common.schema import SI, Section, keys
from models.kinds.kind import GRAVITY, Parameters

JOINT = "seat"  # its joint in the MJCF, and its body
ADVICE = {"seat": "a seat has a section of its own: write [seat] with mass, stiffness and damping"}  # see VehicleKind.lacking


@dataclass(frozen=True)
class Seat(Section):
    """A person on a seat above the body."""

    hints: ClassVar[Mapping[str, str]] = {"z": "is not allowed, as the seat is at the height of the body's centre of mass"}

    mass: Annotated[float, SI("kg", "m_p, mass of seat and person above the seat's spring", high=1e5)]
    stiffness: Annotated[float, SI("N/m", "k_p, stiffness of the seat's spring")]
    damping: Annotated[float, SI("N s/m", "c_p, damping coefficient of the seat", 0.0)]
    x: Annotated[float, SI("m", "position of the seat, forward of the body's centre of mass", -20.0, 20.0)] = 0.0
    y: Annotated[float, SI("m", "position of the seat, to the left of the body's centre of mass", -20.0, 20.0)] = 0.0

    @classmethod
    def of(cls, p: Parameters) -> "Seat | None":
        """Returns the seat of a vehicle with these parameters, or None."""
        own = {key: p[f"seat_{key}"] for key in keys(cls) if f"seat_{key}" in p}
        return cls(**own) if own else None

    @property
    def arms(self) -> tuple[float, float, float]:
        """Height of its point per heave, pitch and roll of the body."""
        return 1.0, -self.x, self.y

    @property
    def load(self) -> Array:
        """Its weight as force and moments on heave, pitch and roll [N, N m], shape (3,)."""
        return self.mass * GRAVITY * np.array(self.arms)
