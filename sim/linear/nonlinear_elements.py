"""Nonlinear elements of a vehicle: curved dampers and springs, and adjustable dampers. The vehicle that is linear at rest.

At rest: ideal force actuators replace adjustable dampers. A curve that is straight about rest stays: a small enough road meets
its line alone. A line replaces a curve that bends at rest, by a kink or by friction: no road is small enough for that one.
"""

from models.vehicle.vehicle import Vehicle


def bent_at_rest(vehicle: Vehicle) -> tuple[str, ...]:
    """Returns the names of parts that are not straight about rest, in the order of the suspensions."""
    return tuple(dict.fromkeys(fitted.name for fitted in vehicle.parts if fitted.part.kinked_at_rest))


def at_rest(vehicle: Vehicle) -> Vehicle:
    """Returns the vehicle that is linear on small enough roads."""
    return vehicle.with_ideal_actuators.linearised if bent_at_rest(vehicle) else vehicle.with_ideal_actuators


def at_rest_words(vehicle: Vehicle) -> str:
    """Describes the elements that MuJoCo runs otherwise in that vehicle; empty if there are none."""
    bent, phrases = bent_at_rest(vehicle), []
    if vehicle.dampers:
        phrases.append("force actuators instead of the adjustable dampers, so that every requested force acts")
    if bent:
        whose = " and ".join(name.replace("_", " ") for name in bent)
        phrases.append(f"straight lines instead of the characteristics of {whose}, which have a kink at equilibrium")
    return f"Here, MuJoCo has {' and '.join(phrases)}" if phrases else ""
