"""Half-car in the pitch plane: one side of a symmetric car, with heave and pitch on two axles.

The equations are in `kinds/rigid_body.py`.
"""

import numpy as np

from models.kinds import links, rigid_body
from models.kinds.car import Car
from models.kinds.kind import Parameter

CORNERS = rigid_body.AXLES
PARAMETERS = (
    Parameter("sprung_mass", "kg", "m_s, mass of half of the body"),
    Parameter("pitch_inertia", "kg m2", "I_y, pitch inertia of half of the body about its centre of mass"),
    *rigid_body.per_axle("axle_distance", "m", "l, distance from the centre of mass to the axle", largest=rigid_body.LONGEST),
    *rigid_body.of_half_car(CORNERS),
    rigid_body.CENTRE_HEIGHT,
    *links.LENGTHWAYS,
)

KIND = Car(PARAMETERS, CORNERS, dict(zip(CORNERS, np.eye(2), strict=True)), np.zeros(2)).kind(
    "half_car",
    lacking=dict.fromkeys(
        ("anti_roll", "roll", "track"), 'this half-car only heaves and pitches: use a full_car, or a half_car with plane = "roll"'
    ),
)
