"""Seat with a person: the section `[seat]` of a vehicle file."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar

from models.common.schema import SI, Section, keys
from models.kinds.kind import Parameters

JOINT = "seat"  # name of the joint and of the body that represent the seat in the MJCF


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
    def of(cls, p: Parameters) -> "Seat":
        """Returns the seat of a vehicle, read from the vehicle's parameters."""
        return cls(**{key: p[f"seat_{key}"] for key in keys(cls) if f"seat_{key}" in p})

    @property
    def arms(self) -> tuple[float, float, float]:
        """Vertical displacement of the seat's mounting point per unit of heave, pitch and roll of the body."""
        return 1.0, -self.x, self.y
