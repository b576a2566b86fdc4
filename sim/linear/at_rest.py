"""The vehicle that linear analysis speaks of, as MuJoCo can run it: what margins and frequency responses are held against.

Adjustable dampers have actuators that push in their places, so that every force is given that is asked for. A curve that is
straight about rest stays, and a small enough road meets its line alone. Of one that bends at rest, by a kink or by friction, no
road is small enough: there the line has the curve's place.
"""

from models.vehicle import Vehicle


def bent_at_rest(vehicle: Vehicle) -> tuple[str, ...]:
    """The parameters whose curves are not straight about rest, in the order of the suspensions."""
    return tuple(dict.fromkeys(one.parameter for one in vehicle.fitted if (one.curve.pieces.start == 0).any()))


def at_rest(vehicle: Vehicle) -> Vehicle:
    """The vehicle that is linear on roads that are small enough."""
    return vehicle.pushing.straight if bent_at_rest(vehicle) else vehicle.pushing


def at_rest_words(vehicle: Vehicle) -> str:
    """What of a vehicle MuJoCo runs otherwise there; empty where nothing."""
    bent, words = bent_at_rest(vehicle), []
    if vehicle.dampers:
        words.append("actuators that push in place of the adjustable dampers, so that every force is given")
    if bent:
        one = "curve of" if len(bent) == 1 else "curves of"
        whose = " and ".join(name.replace("_", " ") for name in bent)
        words.append(f"lines in place of the {one} {whose}, which {'bends' if len(bent) == 1 else 'bend'} at rest")
    return f"MuJoCo has {' and '.join(words)}" if words else ""
