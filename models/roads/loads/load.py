"""Loads on the body as functions of time: external forces and moments.

The vehicle model drives straight ahead. Braking, cornering, payload and wind therefore act as equivalent loads at the centre of
mass of the body (d'Alembert forces): a vertical force F, a pitch moment M_pitch and a roll moment M_roll. Positive directions
are up, nose down and right side down. For a sprung mass m_s whose centre of mass has the height h above the ground, the loads
are:

    braking at a:          M_pitch = m_s a h,     cornering left at a:   M_roll = m_s a h
    payload m at (x, y):   F = -m g,   M_pitch = m g x,   M_roll = -m g y

The payload position (x forward, y to the left) is relative to the centre of mass. A payload adds weight but no inertia. By
default, springs and tyres carry each moment M; with their rotational stiffness K, the body turns by M / K. A vehicle file can
define suspension links that carry a share of the loads (`models/kinds/links.py`). With suspension links, the links' share of
braking, cornering and gust loads, and the inertia of the wheels, act as loads on the wheels.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, ClassVar, Self

import numpy as np

from models.common.arrays import Array
from models.common.checks import check_fields
from models.common.errors import InputError
from models.common.schema import SI, Section
from models.kinds.kind import GRAVITY, Parameters, VehicleKind
from models.kinds.signals import HEAVE_LOAD, PITCH_LOAD, ROLL_LOAD

HEAVE, PITCH, ROLL = HEAVE_LOAD.name, PITCH_LOAD.name, ROLL_LOAD.name
Start = Annotated[float, SI("s", "start of the rise", 0.0, 1e6)]
Rise = Annotated[
    float, SI("s", "duration of the rise, and of the fall; above 0, because no timestep can follow a jump", 1e-3, 1e6)
]
Hold = Annotated[float, SI("s", "time between rise and fall; infinite for a load that stays", 0.0, math.inf)]
X = Annotated[float, SI("m", "position, forward of the body's centre of mass", -20.0, 20.0)]
Y = Annotated[float, SI("m", "position, to the left of the body's centre of mass", -20.0, 20.0)]


class Load(ABC):
    """Load as a function of time that can act on any vehicle."""

    @property
    @abstractmethod
    def text(self) -> str:
        """Text that defines the load, with exact numbers."""

    @property
    def content(self) -> str:
        """The text that defines the load, without the name of a file."""
        return self.text

    @property
    def label(self) -> str:
        """The text that commands print for the load; for a load from a file, only the file name."""
        return self.text

    @property
    @abstractmethod
    def kinks(self) -> tuple[float, ...]:
        """Times [s] at which the load or one of its derivatives jumps."""

    @property
    @abstractmethod
    def directions(self) -> tuple[str, ...]:
        """Names of the body loads (force or moments) to which the load contributes."""

    @abstractmethod
    def at(self, t: Array, p: Parameters, kind: VehicleKind | None = None) -> Mapping[str, Array]:
        """Returns the force [N] and the moments [N m] of the load at times t [s], by the names of the body loads.

        Args:
            t: times [s].
            p: parameters of the vehicle [SI], by name.
            kind: vehicle type, whose links may transmit part of the load to the wheels; None to return only the force and its
                moments, without the share of the links.
        """

    def step_means(self, t: Array, timestep: float, p: Parameters, kind: VehicleKind | None = None) -> Mapping[str, Array]:
        """Returns the load that MuJoCo holds constant during each time step: by default, the values in the middle of the step.

        Args:
            t: middle times of the steps [s].
            timestep: length of a step [s].
            p: parameters of the vehicle [SI], by name.
            kind: vehicle type, as for the method `at`.
        """
        return self.at(t, p, kind)

    @abstractmethod
    def scaled(self, factor: float) -> "Load":
        """Returns the load multiplied by a factor."""


@dataclass(frozen=True)
class RampedLoad(Section, Load):
    """Load that rises, stays constant for a time, and falls. The rise and the fall of the load have the shape of half a period
    of a cosine.

    Raises:
        InputError: a number is out of its range, or has a unit of another dimension.
    """

    kind: ClassVar[str]
    size: ClassVar[str]  # name of the field that the method `scaled` multiplies

    def __post_init__(self) -> None:
        check_fields(self, f"{self.kind} ")

    def scaled(self, factor: float) -> Self:
        """Returns the load multiplied by a factor."""
        return replace(self, **{self.size: getattr(self, self.size) * factor})

    @property
    def _history(self) -> tuple[float, float, float]:
        values = vars(self)
        return values["start"], values["rise"], values["hold"]

    @abstractmethod
    def amplitudes(self, p: Parameters) -> Mapping[str, float]:
        """Returns the largest values of the load [N, N m], by the names of the body loads."""

    @property
    def text(self) -> str:
        """Text with the type and the numbers of the load; an infinite hold time is omitted."""
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        return ":".join([self.kind, *(f"{name}={value!r}" for name, value in given.items() if value != math.inf)])

    @property
    def kinks(self) -> tuple[float, ...]:
        """Times at which the rise and the fall begin and end [s]."""
        start, rise, hold = self._history
        going = start + rise + hold
        return (start, start + rise, *((going, going + rise) if math.isfinite(hold) else ()))

    def horizontal(self, p: Parameters) -> tuple[str, float, float] | None:
        """Returns the horizontal force that causes the load, because suspension links transmit a share of this force.

        Returns:
            Name of the body load, force on the body [N], and acceleration of the wheels [m/s2], as `VehicleKind.carried` takes
            them. None if the suspension links do not transmit any share of the load.
        """
        return None

    def at(self, t: Array, p: Parameters, kind: VehicleKind | None = None) -> Mapping[str, Array]:
        """Returns the amplitudes of the load, multiplied by the load's function of time; see `Load`."""
        full, pushing = dict(self.amplitudes(p)), self.horizontal(p)
        if kind is not None and pushing is not None:
            for name, value in kind.carried(p, *pushing).items():
                full[name] = full.get(name, 0.0) + value
        start, rise, hold = self._history
        share = (1 - np.cos(np.pi * np.clip((t - start) / rise, 0, 1))) / 2
        if math.isfinite(hold):
            share -= (1 - np.cos(np.pi * np.clip((t - start - rise - hold) / rise, 0, 1))) / 2
        return {name: amplitude * share for name, amplitude in full.items()}


MOMENT_PARAMETERS = ("sprung_mass", "centre_height")  # parameters on which the moment that an acceleration causes depends


def _mass(p: Parameters) -> float:
    """Returns the mass of the body and of a seat [kg]. The seat is at the height of the body's centre of mass."""
    return p["sprung_mass"] + p.get("seat_mass", 0.0)


class _Inertial(RampedLoad):
    """Load due to the vehicle's own acceleration: the inertial force of the body, acting at its centre of mass."""

    way: ClassVar[str]
    size: ClassVar[str] = "g"
    g: float

    @property
    def directions(self) -> tuple[str, ...]:
        """Name of the moment that the load exerts on the body."""
        return (self.way,)

    def amplitudes(self, p: Parameters) -> Mapping[str, float]:
        """Returns the moment m_s a h [N m]."""
        if absent := [name for name in MOMENT_PARAMETERS if name not in p]:
            raise InputError(
                f"the moment of load {self.kind} is computed from {' and '.join(map(repr, MOMENT_PARAMETERS))}, but "
                f"this vehicle has no {absent[0]!r}; choose a different load"
            )
        return {self.way: _mass(p) * GRAVITY * self.g * p["centre_height"]}

    def horizontal(self, p: Parameters) -> tuple[str, float, float] | None:
        """Returns the name of the moment, the inertial force of the body [N] and the acceleration of the vehicle [m/s2]."""
        return self.way, _mass(p) * GRAVITY * self.g, GRAVITY * self.g


@dataclass(frozen=True)
class Brake(_Inertial):
    """Braking. A negative deceleration is an acceleration, during which the body squats."""

    kind: ClassVar[str] = "brake"
    way: ClassVar[str] = PITCH
    g: Annotated[float, SI("g", "deceleration, in multiples of the acceleration of gravity", -2.0, 2.0)] = 0.5
    start: Start = 0.5
    rise: Rise = 0.2
    hold: Hold = math.inf


@dataclass(frozen=True)
class Cornering(_Inertial):
    """Cornering to the left, which rolls the body to the right. A negative lateral acceleration means cornering to the right."""

    kind: ClassVar[str] = "corner"
    way: ClassVar[str] = ROLL
    g: Annotated[float, SI("g", "lateral acceleration, in multiples of the acceleration of gravity", -2.0, 2.0)] = 0.3
    start: Start = 0.5
    rise: Rise = 0.5
    hold: Hold = math.inf


def _vertical_force(force: float, x: float, y: float) -> dict[str, float]:
    """Returns a vertical force [N], and the moments [N m] that the force causes about the centre of mass.

    Moments that are 0 are omitted, so that the force can also act on vehicles without pitch or roll.
    """
    return {HEAVE: force} | ({PITCH: -force * x} if x else {}) | ({ROLL: force * y} if y else {})


class _PlacedLoad(RampedLoad):
    """Load due to a vertical force at a position on the body."""

    x: float
    y: float

    @property
    def directions(self) -> tuple[str, ...]:
        """Names of the vertical force, and of the moments that the force causes."""
        return tuple(_vertical_force(1.0, self.x, self.y))


@dataclass(frozen=True)
class Payload(_PlacedLoad):
    """Payload: additional weight on the body."""

    kind: ClassVar[str] = "payload"
    size: ClassVar[str] = "mass"
    mass: Annotated[float, SI("kg", "mass of the payload; a negative value removes mass", -1e5, 1e5)] = 100.0
    x: X = 0.0
    y: Y = 0.0
    start: Start = 0.5
    rise: Rise = 0.5
    hold: Hold = math.inf

    def amplitudes(self, p: Parameters) -> Mapping[str, float]:
        """Returns the weight of the payload as a downward force [N], and its moments [N m]."""
        return _vertical_force(-self.mass * GRAVITY, self.x, self.y)


@dataclass(frozen=True)
class Lift(_PlacedLoad):
    """Aerodynamic lift that acts on the body."""

    kind: ClassVar[str] = "lift"
    size: ClassVar[str] = "force"
    force: Annotated[float, SI("N", "upward force; a negative force is downforce", -1e6, 1e6)] = 500.0
    x: X = 0.0
    y: Y = 0.0
    start: Start = 0.5
    rise: Rise = 0.5
    hold: Hold = math.inf

    def amplitudes(self, p: Parameters) -> Mapping[str, float]:
        """Returns the lift as an upward force [N], and its moments [N m]."""
        return _vertical_force(self.force, self.x, self.y)


@dataclass(frozen=True)
class Gust(RampedLoad):
    """Gust of wind from the left, which rolls the body to the right.

    By default, the gust has the shape of one period of a cosine.
    """

    kind: ClassVar[str] = "gust"
    size: ClassVar[str] = "force"
    force: Annotated[float, SI("N", "force to the right; a negative force acts to the left", -1e6, 1e6)] = 1000.0
    height: Annotated[float, SI("m", "height above the ground at which the force acts", 0.0, 20.0)] = 0.8
    start: Start = 0.5
    rise: Rise = 0.3
    hold: Hold = 0.0

    @property
    def directions(self) -> tuple[str, ...]:
        """Name of the moment that the load exerts on the body."""
        return (ROLL,)

    def amplitudes(self, p: Parameters) -> Mapping[str, float]:
        """Returns the roll moment of the load [N m]."""
        return {ROLL: self.force * self.height}

    def horizontal(self, p: Parameters) -> tuple[str, float, float] | None:
        """Returns the name of the moment, the force of the wind [N], and the acceleration 0. The wind acts on the body, not on
        the wheels.
        """
        return ROLL, self.force, 0.0


LOADS: Mapping[str, type[RampedLoad]] = {load.kind: load for load in (Brake, Cornering, Payload, Lift, Gust)}
