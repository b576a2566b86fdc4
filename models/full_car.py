"""Full car: heave, pitch and roll of a body on four wheels. Its equations are in `kinds/rigid_body.py`.

Its fourteen states hold the tyre deflections as three modes, which a rigid body can follow, and not as four wheels: the fourth
mode, the twist, is fixed by the suspension deflections and the twist of the road.
"""

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from models.kinds import links, rigid_body, signals
from models.kinds.kind import BodyLoad, Parameter, Parameters, Variation, VehicleKind, Wheel, nowhere_else
from models.kinds.linear_model import LinearModel
from models.kinds.rigid_body import Bar, Corner, RigidBody
from models.kinds.strut_and_tyre import TYRE_DAMPING

if TYPE_CHECKING:
    from models.kinds.motion import Motion

AXLES = rigid_body.AXLES
SIDES = ("left", "right")
CORNERS = tuple(f"{axle}_{side}" for axle in AXLES for side in SIDES)

# Modes of four wheels, front left, front right, rear left, rear right, signed as the body's: nose down, right side down.
MODES = {
    "heave": np.array([1.0, 1.0, 1.0, 1.0]) / 4,
    "pitch": np.array([-1.0, -1.0, 1.0, 1.0]) / 4,
    "roll": np.array([1.0, -1.0, 1.0, -1.0]) / 4,
}
TWIST = np.array([1.0, -1.0, -1.0, 1.0])


PARAMETERS = (
    Parameter("sprung_mass", "kg", "m_s, the body", varied=Variation("sprung mass", 0.7, 1.4)),
    Parameter("pitch_inertia", "kg m2", "I_y of the body about its centre of mass"),
    Parameter("roll_inertia", "kg m2", "I_x of the body about its centre of mass"),
    Parameter("track", "m", "b, from a left wheel to the right one"),
    *rigid_body.per_axle("axle_distance", "m", "l, from the centre of mass to the axle"),
    *rigid_body.per_axle("unsprung_mass", "kg", "m_u of one wheel with hub and brake"),
    *rigid_body.per_axle("suspension_stiffness", "N/m", "k_s at one wheel; 0 for a purely active strut", positive=False),
    *rigid_body.per_axle("suspension_damping", "N s/m", "c_s at one wheel", positive=False),
    *rigid_body.per_axle("tyre_stiffness", "N/m", "k_t of one tyre", varied=Variation("tyre stiffness", 0.75, 1.25)),
    *rigid_body.per_axle("tyre_damping", "N s/m", f"c_t, {TYRE_DAMPING}", positive=False, optional=True),
    rigid_body.CENTRE_HEIGHT,
    *(
        Parameter(
            f"anti_roll_stiffness_{axle}",
            "N m/rad",
            f"k_phi, of the anti-roll bar, moment per angle by which the body rolls over the {axle} axle",
            positive=False,
            usual=0.0,
        )
        for axle in AXLES
    ),
    *links.ROLL_CENTRES,
    *links.LENGTHWAYS,
)


def _at_corners(signal: signals.Signal) -> tuple[signals.Signal, ...]:
    return tuple(signal.at(corner) for corner in CORNERS)


TYRE_MODES = tuple(signals.TYRE_DEFLECTION.at(mode) for mode in MODES)
STATES = (
    *_at_corners(signals.SUSPENSION_DEFLECTION),
    *TYRE_MODES,
    signals.HEAVE_VELOCITY,
    signals.PITCH_RATE,
    signals.ROLL_RATE,
    *_at_corners(signals.UNSPRUNG_VELOCITY),
)
FORCES = _at_corners(signals.CONTROL_FORCE)
ACCELERATIONS = (
    signals.HEAVE_ACCELERATION,
    signals.PITCH_ACCELERATION,
    signals.ROLL_ACCELERATION,
    *_at_corners(signals.SPRUNG_VELOCITY),
    *_at_corners(signals.SPRUNG_ACCELERATION),
)
OUTPUTS = (*STATES, *_at_corners(signals.TYRE_DEFLECTION), *ACCELERATIONS, *FORCES)
HEIGHTS = (
    signals.HEAVE_DISPLACEMENT,
    *_at_corners(signals.SPRUNG_DISPLACEMENT),
    *_at_corners(signals.UNSPRUNG_DISPLACEMENT),
)
ON_DEMAND = (*_at_corners(signals.UNSPRUNG_ACCELERATION), *HEIGHTS)
ROAD_VELOCITIES = _at_corners(signals.ROAD_VELOCITY)


def _body(p: Parameters) -> RigidBody:
    corners = tuple(Corner.on_axle(p, f"{axle}_{side}", axle, _side(side, p)) for axle in AXLES for side in SIDES)
    modes = np.stack(list(MODES.values()))
    bars = tuple(Bar(axle, 2 * i, 2 * i + 1, p[f"anti_roll_stiffness_{axle}"]) for i, axle in enumerate(AXLES))
    pitch_arm, roll_arm = links.arms(p)
    return RigidBody(
        corners,
        p["sprung_mass"],
        p["pitch_inertia"],
        p["roll_inertia"],
        tyre_modes=modes,
        twist=TWIST,
        bars=bars,
        pitch_arm=pitch_arm,
        roll_arm=roll_arm,
        wheel_loads=links.wheel_loads(p, CORNERS),
    )


def _side(side: str, p: Parameters) -> float:
    return p["track"] / 2 if side == "left" else -p["track"] / 2


def linear_model(p: Parameters) -> LinearModel:
    """Returns the linear model for parameters [SI]: 14 states, 4 inputs [N], 4 road velocities [m/s], 37 output signals."""
    return rigid_body.linear_model(_body(p), STATES, FORCES, ROAD_VELOCITIES, (*OUTPUTS, *ON_DEMAND))


def motion(p: Parameters) -> "Motion":
    """Returns the exact equations of motion, which have every tyre's own deflection."""
    from models.kinds.rigid_motion import rigid_motion

    lengths = (*_at_corners(signals.SUSPENSION_DEFLECTION), *_at_corners(signals.TYRE_DEFLECTION))
    rates = (signals.HEAVE_VELOCITY, signals.PITCH_RATE, signals.ROLL_RATE)
    return rigid_motion(_body(p), (*lengths, *rates, *_at_corners(signals.UNSPRUNG_VELOCITY)), (*ACCELERATIONS, *ON_DEMAND))


def check(p: Parameters) -> None:
    """Refuses an impossible body."""
    rigid_body.check_inertia("pitch_inertia", p["pitch_inertia"], p["sprung_mass"], rigid_body.wheelbase(p), "wheelbase")
    rigid_body.check_inertia("roll_inertia", p["roll_inertia"], p["sprung_mass"], p["track"], "track")
    links.check_links(p)
    rigid_body.check_stands(_body(p))


def static_tyre_deflection(p: Parameters) -> dict[str, float]:
    """Returns the compression of each tyre at rest [m], by tyre deflection signal."""
    return _body(p).static_tyre_deflection()


def write_mjcf(spec: Any, p: Parameters) -> None:
    """Writes the parameters into the MJCF."""
    rigid_body.write_mjcf(spec, _body(p))


def wheel_loads(p: Parameters) -> tuple[BodyLoad, ...]:
    """Returns the loads on the wheels."""
    return links.wheel_loads(p, CORNERS)


def carried(p: Parameters, way: str, force: float, acceleration: float) -> dict[str, float]:
    """Returns the loads that links and the wheels' own mass add to a force's moment on the body, by name [N, N m]."""
    return links.carried(p, CORNERS, way, force, acceleration)


def angles(p: Parameters) -> dict[str, dict[str, float]]:
    """Returns the body's angles [rad] as sums of signals."""
    return rigid_body.angles(_body(p))


KIND = VehicleKind(
    name="full_car",
    parameters=PARAMETERS,
    signals=(*_at_corners(signals.ROAD_DISPLACEMENT), *ROAD_VELOCITIES, *OUTPUTS),
    wheels=tuple(
        Wheel(
            road_body=f"road_{corner}",
            road_displacement=f"road_displacement_{corner}",
            road_velocity=f"road_velocity_{corner}",
            tyre_deflection=f"tyre_deflection_{corner}",
            behind=rigid_body.wheelbase if corner.startswith("rear") else nowhere_else,
            side=corner.split("_")[1],
            lateral=partial(_side, corner.split("_")[1]),
        )
        for corner in CORNERS
    ),
    linear_model=linear_model,
    static_tyre_deflection=static_tyre_deflection,
    write_mjcf=write_mjcf,
    check_together=check,
    combined={
        mode.name: {f"tyre_deflection_{corner}": float(share) for corner, share in zip(CORNERS, pattern, strict=True)}
        for mode, pattern in zip(TYRE_MODES, MODES.values(), strict=True)
    },
    on_demand=ON_DEMAND,
    loads=rigid_body.LOADS,
    wheel_loads=wheel_loads,
    carried=carried,
    angles=angles,
    motion=motion,
)
