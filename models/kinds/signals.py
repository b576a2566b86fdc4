"""Table of signals. Linear models, MJCF, vehicle files, logs and plots all use the signal names in this table."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

from models.common.checks import CheckedFields


@dataclass(frozen=True)
class Signal(CheckedFields):
    """Named quantity, measured relative to static equilibrium.

    Attributes:
        name: name of the quantity in all models, files and plots.
        symbol: symbol of the quantity in the paper, or its usual symbol.
        unit: SI unit of the quantity.
        meaning: one-line description of the quantity, with the sign convention.
    """

    public_name = "a signal, such as models.signals.CONTROL_FORCE"

    name: str
    symbol: str
    unit: str
    meaning: str

    def at(self, corner: str) -> "Signal":
        """Returns the signal at one corner of a vehicle with several corners, such as `tyre_deflection_front`."""
        return _at(self, corner)


@lru_cache(maxsize=256)  # a check of the fields of all signals would take longer than the rest of a car's linear model
def _at(signal: Signal, corner: str) -> Signal:
    where = corner.replace("_", " ")
    return replace(
        signal,
        name=f"{signal.name}_{corner}",
        symbol=f"{signal.symbol} {where}",
        meaning=f"{signal.meaning}, {where}",
    )


ROAD_DISPLACEMENT = Signal("road_displacement", "z_r", "m", "road height under the wheel, up")
ROAD_VELOCITY = Signal("road_velocity", "w", "m/s", "vertical velocity of the road under the wheel, up")
SUSPENSION_DEFLECTION = Signal("suspension_deflection", "z_s - z_u", "m", "suspension extension")
SUSPENSION_VELOCITY = Signal(
    "suspension_velocity", "z_s' - z_u'", "m/s", "extension velocity of the suspension, positive in extension"
)
TYRE_DEFLECTION = Signal("tyre_deflection", "z_u - z_r", "m", "tyre extension, negative in compression")
SPRUNG_VELOCITY = Signal("sprung_velocity", "z_s'", "m/s", "vertical velocity of the sprung mass, up")
UNSPRUNG_VELOCITY = Signal("unsprung_velocity", "z_u'", "m/s", "vertical velocity of the unsprung mass, up")
SPRUNG_ACCELERATION = Signal("sprung_acceleration", "z_s''", "m/s2", "vertical acceleration of the sprung mass, up")
SPRUNG_DISPLACEMENT = Signal("sprung_displacement", "z_s", "m", "height of the sprung mass above its equilibrium on a flat road")
UNSPRUNG_DISPLACEMENT = Signal(
    "unsprung_displacement", "z_u", "m", "height of the unsprung mass above its equilibrium on a flat road"
)
HEAVE_DISPLACEMENT = Signal(
    "heave_displacement", "z", "m", "height of the body's centre of mass above its equilibrium on a flat road"
)
UNSPRUNG_ACCELERATION = Signal("unsprung_acceleration", "z_u''", "m/s2", "vertical acceleration of the unsprung mass, up")
HEAVE_VELOCITY = Signal("heave_velocity", "z'", "m/s", "vertical velocity of the body's centre of mass, up")
PITCH_RATE = Signal("pitch_rate", "theta'", "rad/s", "pitch velocity of the body, nose down")
ROLL_RATE = Signal("roll_rate", "phi'", "rad/s", "roll velocity of the body, right side down")
HEAVE_ACCELERATION = Signal("heave_acceleration", "z''", "m/s2", "vertical acceleration of the body's centre of mass, up")
PITCH_ACCELERATION = Signal("pitch_acceleration", "theta''", "rad/s2", "pitch acceleration of the body, nose down")
ROLL_ACCELERATION = Signal("roll_acceleration", "phi''", "rad/s2", "roll acceleration of the body, right side down")
SEAT_TRAVEL = Signal("seat_travel", "z_p - z_s", "m", "extension of the seat's spring")
SEAT_VELOCITY = Signal("seat_velocity", "z_p'", "m/s", "vertical velocity of the person on the seat, up")
SEAT_ACCELERATION = Signal("seat_acceleration", "z_p''", "m/s2", "vertical acceleration of the person on the seat, up")
CONTROL_FORCE = Signal("control_force", "u", "N", "actuator force, positive if it lifts the body and presses the wheel down")
DAMPING = Signal("damping", "c", "N s/m", "damping coefficient of the semi-active damper")
VOLTAGE = Signal("voltage", "u", "V", "voltage of the semi-active damper")
MISSING_FORCE = Signal(
    "missing_force", "u* - u", "N", "part of the requested force that the semi-active damper could not supply at its sample"
)
HEAVE_LOAD = Signal("heave_load", "F", "N", "external force on the body at its centre of mass, up")
PITCH_LOAD = Signal("pitch_load", "M_theta", "N m", "external moment on the body, nose down")
ROLL_LOAD = Signal("roll_load", "M_phi", "N m", "external moment on the body, right side down")
WHEEL_LOAD = Signal("wheel_load", "F_u", "N", "force on the wheel from its links and from its own inertia, up")


def names_of(signals: Iterable[Signal]) -> tuple[str, ...]:
    """Returns the names of the supplied signals."""
    return tuple(signal.name for signal in signals)


OWN = "own"  # text that replaces the unit of a controller state, because only the control law defines the meaning of this state
STATE_PREFIX = "controller_"  # prefix of the names of controller states; no vehicle signal has this prefix


def of_dampers(endings: Mapping[str, bool]) -> tuple["Signal", ...]:
    """Returns the signals of semi-active dampers.

    Args:
        endings: mapping from the suffix of each damper's signal names to True for a damper with a coefficient, or False for a
            damper with a voltage.
    """
    corners = {ending.removeprefix("_"): DAMPING if own else VOLTAGE for ending, own in endings.items()}
    rows = [*((one, corner) for corner, one in corners.items()), *((MISSING_FORCE, corner) for corner in corners)]
    return tuple(signal.at(corner) if corner else signal for signal, corner in rows)


def load_signal(name: str) -> Signal:
    """Returns the signal that represents a load on the body or on a wheel."""
    body = {one.name: one for one in (HEAVE_LOAD, PITCH_LOAD, ROLL_LOAD)}
    return body[name] if name in body else WHEEL_LOAD.at(name.removeprefix(f"{WHEEL_LOAD.name}_"))


def kept_signals(names: Iterable[int | str]) -> tuple["Signal", ...]:
    """Returns one signal for each state of a controller."""
    about = "state of the controller at its last sample, in the controller's own coordinates"
    return tuple(Signal(f"{STATE_PREFIX}{name}", f"x_c {name}", OWN, about) for name in names)


def is_kept(signal: Signal) -> bool:
    """Returns True if a signal is the state of a controller."""
    return signal.name.startswith(STATE_PREFIX)
