"""Full car: heave, pitch and roll of a body on four wheels. The equations are in `kinds/rigid_body.py`.

Instead of four tyre deflections, the fourteen states contain the three modes of the tyre deflections that a rigid body can
follow. The fourth mode, warp, follows from the suspension deflections and the warp of the road. If the axles have different
track widths, only the warp mode changes.
"""

import numpy as np

from models.kinds import links, rigid_body, signals
from models.kinds.car import Car, lateral
from models.kinds.kind import Parameter, Parameters, motion_ratio
from models.kinds.rigid_body import Bar, Corner, RigidBody
from models.kinds.strut_and_tyre import TYRE_DAMPING

AXLES = rigid_body.AXLES
SIDES = ("left", "right")
CORNERS = tuple(f"{axle}_{side}" for axle in AXLES for side in SIDES)

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
    *(
        Parameter(
            f"anti_roll_stiffness_{axle}",
            "N m/rad",
            f"k_phi, stiffness of the anti-roll bar: moment per roll angle of the body at the {axle} axle",
            positive=False,
            usual=0.0,
        )
        for axle in AXLES
    ),
    *links.ROLL_CENTRES,
    *links.LENGTHWAYS,
)


def _body(p: Parameters) -> RigidBody:
    corners = tuple(Corner.of(p, f"{axle}_{side}", axle, lateral(f"{axle}_{side}", p)) for axle in AXLES for side in SIDES)
    widths = np.repeat([links.track(axle, p) for axle in AXLES], 2)
    modes = np.stack(list(MODES.values()))
    bars = tuple(Bar(axle, 2 * i, 2 * i + 1, p[f"anti_roll_stiffness_{axle}"]) for i, axle in enumerate(AXLES))
    pitch_arm, roll_arm = links.arms(p)
    return RigidBody(
        corners,
        p["sprung_mass"],
        p["pitch_inertia"],
        p["roll_inertia"],
        tyre_modes=modes,
        twist=TWIST * (widths.max() / widths),
        bars=bars,
        pitch_arm=pitch_arm,
        roll_arm=roll_arm,
        wheel_loads=links.wheel_loads(p, CORNERS),
        seat_mass=p.get("seat_mass", 0.0),
        seat_x=p.get("seat_x", 0.0),
        seat_y=p.get("seat_y", 0.0),
    )


def check(p: Parameters) -> None:
    """Raises InputError if the parameters do not describe a possible body."""
    rigid_body.check_inertia("pitch_inertia", p["pitch_inertia"], p["sprung_mass"], rigid_body.wheelbase(p), "wheelbase")
    rigid_body.check_inertia(
        "roll_inertia", p["roll_inertia"], p["sprung_mass"], max(links.track(axle, p) for axle in AXLES), "track"
    )
    links.check_links(p)
    rigid_body.check_stands(_body(p))


TYRE_MODES = tuple(signals.TYRE_DEFLECTION.at(mode) for mode in MODES)
KIND = Car(
    _body,
    CORNERS,
    tyres=TYRE_MODES,
    rates=(signals.HEAVE_VELOCITY, signals.PITCH_RATE, signals.ROLL_RATE),
    accelerations=(signals.HEAVE_ACCELERATION, signals.PITCH_ACCELERATION, signals.ROLL_ACCELERATION),
).kind(
    "full_car",
    PARAMETERS,
    check,
    combined={
        mode.name: {f"tyre_deflection_{corner}": float(share) for corner, share in zip(CORNERS, pattern, strict=True)}
        for mode, pattern in zip(TYRE_MODES, MODES.values(), strict=True)
    },
)
