"""Half-car in the roll plane: heave and roll of a body on a left and a right wheel, seen from behind.

The equations are in `kinds/rigid_body.py`. Both wheels are in the same cross-section of the car. The left wheel drives on the
left track of the road, and the right wheel on the right track; neither wheel is behind the other. A full car with equal axles
moves like two half-cars in the roll plane if both axles drive over the same road. The axles of the full car must also have
equal distances from the centre of mass.
"""

import numpy as np

from models.kinds import links, rigid_body
from models.kinds.car import Car, anti_roll_bar
from models.kinds.kind import Parameter

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
    anti_roll_bar(),
    rigid_body.CENTRE_HEIGHT,
    links.ROLL_CENTRE,
    links.WHEEL_CENTRE,
)

KIND = Car(PARAMETERS, SIDES, dict(zip(SIDES, np.eye(2), strict=True)), np.zeros(2)).kind(
    "half_car_roll",
    lacking=dict.fromkeys(
        ("pitch", "axle_distance", "anti_dive", "anti_lift", "anti_squat"),
        "a half-car in the roll plane only heaves and rolls: omit plane, or use a full_car",
    ),
)
