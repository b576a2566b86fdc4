"""Half-car in the roll plane: heave and roll of a body on a left and a right wheel, seen from behind.

The equations are in `kinds/rigid_body.py`. Both wheels are in the same cross-section. No wheel is behind another wheel, and
each wheel drives on its own track of the road. A full car with equal axles moves like two of these half-cars if both axles
drive over the same road. The axles must have equal distances from the centre of mass.
"""

import numpy as np

from models.common.errors import InputError
from models.kinds import links, rigid_body, signals
from models.kinds.car import Car, lateral
from models.kinds.kind import Parameter, Parameters
from models.kinds.rigid_body import Bar, Corner, RigidBody

SIDES = links.SIDES
PARAMETERS = (
    Parameter("sprung_mass", "kg", "m_s, mass of the body on these two wheels"),
    Parameter("roll_inertia", "kg m2", "I_x, roll inertia of this part of the body about its centre of mass"),
    Parameter("track", "m", "b, distance of left and right wheel", largest=rigid_body.LONGEST),
    Parameter(
        "centre_offset",
        "m",
        "position of the centre of mass, to the left of the middle between the wheels",
        smallest=-5.0,
        largest=5.0,
        optional=True,
    ),
    *rigid_body.of_half_car(SIDES),
    Parameter(
        "anti_roll_stiffness",
        "N m/rad",
        "k_phi, stiffness of the anti-roll bar: moment per roll angle of the body",
        positive=False,
        usual=0.0,
    ),
    rigid_body.CENTRE_HEIGHT,
    links.ROLL_CENTRE,
    links.WHEEL_CENTRE,
)


def _body(p: Parameters) -> RigidBody:
    return RigidBody(
        tuple(Corner.of(p, side, side, lateral(side, p)) for side in SIDES),
        p["sprung_mass"],
        None,
        p["roll_inertia"],
        tyre_modes=np.eye(2),
        twist=np.zeros(2),
        bars=(Bar("axle", 0, 1, p["anti_roll_stiffness"]),),
        roll_arm=links.arms(p)[1],
        wheel_loads=links.wheel_loads(p, SIDES),
        seat_mass=p.get("seat_mass", 0.0),
        seat_y=p.get("seat_y", 0.0),
    )


def check(p: Parameters) -> None:
    """Raises InputError if the parameters do not describe a possible body."""
    # Many published models of this type use `track` for the distance between the springs, which lie far inside the wheels.
    rigid_body.check_inertia("roll_inertia", p["roll_inertia"], p["sprung_mass"], 2 * p["track"], "doubled track")
    if abs(offset := p.get("centre_offset", 0.0)) >= p["track"] / 2:
        raise InputError(
            f"centre_offset = {offset:g} m is not between the wheels, which are {p['track'] / 2:g} m from the middle; give a "
            "smaller offset"
        )
    rigid_body.check_stands(_body(p))


KIND = Car(
    _body,
    SIDES,
    tyres=tuple(signals.TYRE_DEFLECTION.at(side) for side in SIDES),
    rates=(signals.HEAVE_VELOCITY, signals.ROLL_RATE),
    accelerations=(signals.HEAVE_ACCELERATION, signals.ROLL_ACCELERATION),
).kind(
    "half_car_roll",
    PARAMETERS,
    check,
    lacking=dict.fromkeys(
        ("pitch", "axle_distance", "anti_dive", "anti_lift", "anti_squat"),
        "a half-car in the roll plane only heaves and rolls: omit plane, or use a full_car",
    ),
)
