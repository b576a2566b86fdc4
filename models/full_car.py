"""Full car: heave, pitch and roll of a body on four wheels. The equations are in `kinds/rigid_body.py`.

Instead of four tyre deflections, the fourteen states contain only those three modes of the tyre deflections that a rigid body
can follow. The fourth mode, warp, follows from the suspension deflections and the warp of the road. If the axles have different
track widths, only the warp mode changes.
"""

import numpy as np

from models.kinds import links, rigid_body
from models.kinds.car import Car, anti_roll_bar
from models.kinds.kind import Parameter, motion_ratio
from models.kinds.strut_and_tyre import TYRE_DAMPING

AXLES = rigid_body.AXLES
CORNERS = tuple(f"{axle}_{side}" for axle in AXLES for side in links.SIDES)

# Modes of four wheels (front left, front right, rear left, rear right). The signs are those of the body's motion: nose down and
# right side down are positive.
MODES = {
    "heave": np.array([1.0, 1.0, 1.0, 1.0]) / 4,
    "pitch": np.array([-1.0, -1.0, 1.0, 1.0]) / 4,
    "roll": np.array([1.0, -1.0, 1.0, -1.0]) / 4,
}
TWIST = np.array([1.0, -1.0, -1.0, 1.0])  # warp of four wheels if both axles have the same track width


PARAMETERS = (
    Parameter("sprung_mass", "kg", "m_s, mass of the body"),
    Parameter("pitch_inertia", "kg m2", "I_y, pitch inertia of the body about its centre of mass"),
    Parameter("roll_inertia", "kg m2", "I_x, roll inertia of the body about its centre of mass"),
    Parameter("track", "m", "b, distance of left and right wheels, on both axles", optional=True, largest=rigid_body.LONGEST),
    *rigid_body.per_axle(
        "track", "m", "b, distance of the wheels on this axle, instead of `track`", optional=True, largest=rigid_body.LONGEST
    ),
    *rigid_body.per_axle("axle_distance", "m", "l, distance from the centre of mass to the axle", largest=rigid_body.LONGEST),
    *rigid_body.per_axle("unsprung_mass", "kg", "m_u, mass of one wheel with hub and brake"),
    *rigid_body.per_axle("suspension_stiffness", "N/m", "k_s at one wheel; 0 for a purely active strut", positive=False),
    *rigid_body.per_axle("suspension_damping", "N s/m", "c_s, damping coefficient at one wheel", positive=False),
    *rigid_body.per_axle("tyre_stiffness", "N/m", "k_t, stiffness of one tyre"),
    *rigid_body.per_axle("tyre_damping", "N s/m", f"c_t, {TYRE_DAMPING}", positive=False, optional=True),
    *(motion_ratio(f"motion_ratio_{axle}") for axle in rigid_body.AXLES),
    rigid_body.CENTRE_HEIGHT,
    *map(anti_roll_bar, AXLES),
    *links.ROLL_CENTRES,
    *links.LENGTHWAYS,
)

KIND = Car(PARAMETERS, CORNERS, MODES, TWIST).kind("full_car")
