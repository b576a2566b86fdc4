"""Half-car in the pitch plane: one side of a symmetric car, with heave and pitch on two axles.

The equations are in `kinds/rigid_body.py`.
"""

import numpy as np

from models.kinds import links, rigid_body, signals
from models.kinds.car import Car
from models.kinds.kind import Parameter, Parameters
from models.kinds.rigid_body import Corner, RigidBody

CORNERS = rigid_body.AXLES
PARAMETERS = (
    Parameter("sprung_mass", "kg", "m_s, mass of half of the body"),
    Parameter("pitch_inertia", "kg m2", "I_y, pitch inertia of half of the body about its centre of mass"),
    *rigid_body.per_axle("axle_distance", "m", "l, distance from the centre of mass to the axle", largest=rigid_body.LONGEST),
    *rigid_body.of_half_car(CORNERS),
    rigid_body.CENTRE_HEIGHT,
    *links.LENGTHWAYS,
)


def _body(p: Parameters) -> RigidBody:
    pitch_arm, _ = links.arms(p)
    return RigidBody(
        tuple(Corner.of(p, axle, axle, 0.0) for axle in CORNERS),
        p["sprung_mass"],
        p["pitch_inertia"],
        None,
        tyre_modes=np.eye(2),
        twist=np.zeros(2),
        pitch_arm=pitch_arm,
        wheel_loads=links.wheel_loads(p, CORNERS),
        seat_mass=p.get("seat_mass", 0.0),
        seat_x=p.get("seat_x", 0.0),
    )


def check(p: Parameters) -> None:
    """Raises InputError if the parameters do not describe a possible body."""
    rigid_body.check_inertia("pitch_inertia", p["pitch_inertia"], p["sprung_mass"], rigid_body.wheelbase(p), "wheelbase")
    rigid_body.check_stands(_body(p))


KIND = Car(
    _body,
    CORNERS,
    tyres=tuple(signals.TYRE_DEFLECTION.at(corner) for corner in CORNERS),
    rates=(signals.HEAVE_VELOCITY, signals.PITCH_RATE),
    accelerations=(signals.HEAVE_ACCELERATION, signals.PITCH_ACCELERATION),
).kind(
    "half_car",
    PARAMETERS,
    check,
    lacking=dict.fromkeys(
        ("anti_roll", "roll", "track"), 'this half-car only heaves and pitches: use a full_car, or a half_car with plane = "roll"'
    ),
)
