"""Vehicles with curves."""

import re

from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle

# An asymmetric, digressive damper, as cars have it: rebound some twice as hard as bump, both softer the faster.
DIGRESSIVE = "{ velocity = [-1.5, -0.6, -0.15, 0.0, 0.15, 0.6, 1.5], force = [-1350, -750, -262.5, 0, 262.5, 1000, 1900] }"
PROGRESSIVE = "{ deflection = [-0.1, -0.06, 0.0, 0.05, 0.1], force = [-2100, -920, 0, 655, 1350] }"
AXLES = {
    "suspension_damping_front": DIGRESSIVE,
    "suspension_damping_rear": DIGRESSIVE,
    "suspension_stiffness_rear": "{ deflection = [-0.1, -0.06, 0.0, 0.05, 0.1], force = [-3500, -1500, 0, 1100, 2300] }",
}


def with_curves(kind: str = "quarter_car", more: str = "", **curves: str) -> Vehicle:
    """A vehicle that ships, with curves in place of some of its parameters, and more sections."""
    return parse_vehicle(curved_text(kind, more, **curves))


def curved_text(kind: str = "quarter_car", more: str = "", **curves: str) -> str:
    """The text of its file."""
    text = read_vehicle(kind).text
    for name in curves:
        text, count = re.subn(rf"^{name} = .*\n", "", text, flags=re.M)
        assert count == 1, name
    return "\n".join([text, "[curves]", *(f"{name} = {table}" for name, table in curves.items()), more])
