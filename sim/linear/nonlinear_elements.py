"""Nonlinear elements of a vehicle (characteristics and semi-active dampers), and the vehicle linearised at equilibrium.

In the linearised vehicle, ideal force actuators replace semi-active dampers. A characteristic that is a straight line near
equilibrium is kept, because the vehicle with this characteristic is linear on sufficiently low roads. A characteristic that
bends at equilibrium, due to a kink or friction, is replaced by a straight line, because it is nonlinear even on the lowest
road.
"""

from models.vehicle.vehicle import Vehicle


def bent_at_rest(vehicle: Vehicle) -> tuple[str, ...]:
    """Returns the names of parts whose characteristics bend at equilibrium, in the order of the suspensions."""
    return tuple(dict.fromkeys(fitted.name for fitted in vehicle.parts if fitted.part.kinked_at_rest))


def at_rest(vehicle: Vehicle) -> Vehicle:
    """Replaces all elements that are nonlinear even on very low roads; the returned vehicle is linear on sufficiently low
    roads.
    """
    return vehicle.with_ideal_actuators.linearised if bent_at_rest(vehicle) else vehicle.with_ideal_actuators


def at_rest_words(vehicle: Vehicle) -> str:
    """Describes, as text, which elements of a vehicle are replaced in the linearised vehicle; empty if no element is replaced."""
    bent, phrases = bent_at_rest(vehicle), []
    if vehicle.dampers:
        phrases.append("force actuators instead of the semi-active dampers, so that every requested force acts")
    if bent:
        whose = " and ".join(name.replace("_", " ") for name in bent)
        phrases.append(
            f"straight lines instead of the characteristics of {whose}, because these characteristics have a kink at equilibrium"
        )
    return f"In these runs, MuJoCo uses {' and '.join(phrases)}" if phrases else ""
