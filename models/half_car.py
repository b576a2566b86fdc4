"""Half-car: heave and pitch of a body on two axles, one side of a symmetric car. Its equations: `kinds/rigid_body.py`."""

from typing import TYPE_CHECKING, Any

import numpy as np

from models.kinds import links, rigid_body, signals
from models.kinds.kind import BodyLoad, Parameter, Parameters, Variation, VehicleKind, Wheel, nowhere_else
from models.kinds.linear_model import LinearModel
from models.kinds.rigid_body import Corner, RigidBody
from models.kinds.strut_and_tyre import TYRE_DAMPING

if TYPE_CHECKING:
    from models.kinds.motion import Motion

CORNERS = rigid_body.AXLES
PARAMETERS = (
    Parameter("sprung_mass", "kg", "m_s, half of the body", varied=Variation("sprung mass", 0.7, 1.4)),
    Parameter("pitch_inertia", "kg m2", "I_y of that half about its centre of mass"),
    *rigid_body.per_axle("axle_distance", "m", "l, from the centre of mass to the axle"),
    *rigid_body.per_axle("unsprung_mass", "kg", "m_u, wheel, hub and brake"),
    *rigid_body.per_axle("suspension_stiffness", "N/m", "k_s; 0 for a purely active strut", positive=False),
    *rigid_body.per_axle("suspension_damping", "N s/m", "c_s", positive=False),
    *rigid_body.per_axle("tyre_stiffness", "N/m", "k_t (the paper's k_u)", varied=Variation("tyre stiffness", 0.75, 1.25)),
    *rigid_body.per_axle("tyre_damping", "N s/m", f"c_t, {TYRE_DAMPING}", positive=False, optional=True),
    rigid_body.CENTRE_HEIGHT,
    *links.LENGTHWAYS,
)


def _at_corners(signal: signals.Signal) -> tuple[signals.Signal, ...]:
    return tuple(signal.at(corner) for corner in CORNERS)


STATES = (
    *_at_corners(signals.SUSPENSION_DEFLECTION),
    *_at_corners(signals.TYRE_DEFLECTION),
    signals.HEAVE_VELOCITY,
    signals.PITCH_RATE,
    *_at_corners(signals.UNSPRUNG_VELOCITY),
)
FORCES = _at_corners(signals.CONTROL_FORCE)
ACCELERATIONS = (
    signals.HEAVE_ACCELERATION,
    signals.PITCH_ACCELERATION,
    *_at_corners(signals.SPRUNG_VELOCITY),
    *_at_corners(signals.SPRUNG_ACCELERATION),
)
OUTPUTS = (*STATES, *ACCELERATIONS, *FORCES)
HEIGHTS = (
    signals.HEAVE_DISPLACEMENT,
    *_at_corners(signals.SPRUNG_DISPLACEMENT),
    *_at_corners(signals.UNSPRUNG_DISPLACEMENT),
)
ON_DEMAND = (*_at_corners(signals.UNSPRUNG_ACCELERATION), *HEIGHTS)
ROAD_VELOCITIES = _at_corners(signals.ROAD_VELOCITY)


def _body(p: Parameters) -> RigidBody:
    pitch_arm, _ = links.arms(p)
    return RigidBody(
        tuple(Corner.on_axle(p, axle, axle, 0.0) for axle in CORNERS),
        p["sprung_mass"],
        p["pitch_inertia"],
        None,
        tyre_modes=np.eye(2),
        twist=np.zeros(2),
        pitch_arm=pitch_arm,
        wheel_loads=links.wheel_loads(p, CORNERS),
    )


def linear_model(p: Parameters) -> LinearModel:
    """Returns the linear model for parameters [SI]: 8 states, 2 inputs [N], 2 road velocities [m/s], 18 output signals."""
    return rigid_body.linear_model(_body(p), STATES, FORCES, ROAD_VELOCITIES, (*OUTPUTS, *ON_DEMAND))


def motion(p: Parameters) -> "Motion":
    """Returns the exact equations of motion."""
    from models.kinds.rigid_motion import rigid_motion

    return rigid_motion(_body(p), STATES, (*ACCELERATIONS, *ON_DEMAND))


def check(p: Parameters) -> None:
    """Refuses an impossible body."""
    rigid_body.check_inertia("pitch_inertia", p["pitch_inertia"], p["sprung_mass"], rigid_body.wheelbase(p), "wheelbase")
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
    name="half_car",
    parameters=PARAMETERS,
    signals=(*_at_corners(signals.ROAD_DISPLACEMENT), *ROAD_VELOCITIES, *OUTPUTS),
    wheels=tuple(
        Wheel(
            road_body=f"road_{corner}",
            road_displacement=f"road_displacement_{corner}",
            road_velocity=f"road_velocity_{corner}",
            tyre_deflection=f"tyre_deflection_{corner}",
            behind=rigid_body.wheelbase if corner == "rear" else nowhere_else,
        )
        for corner in CORNERS
    ),
    linear_model=linear_model,
    static_tyre_deflection=static_tyre_deflection,
    write_mjcf=write_mjcf,
    check_together=check,
    on_demand=ON_DEMAND,
    loads=rigid_body.LOADS[:2],
    wheel_loads=wheel_loads,
    carried=carried,
    angles=angles,
    motion=motion,
    lacking={
        "anti_roll": "an anti-roll bar acts where a body rolls, and a half-car only heaves and pitches: take a full_car",
        "roll_centre": "a body rolls about its roll centres, and a half-car only heaves and pitches: take a full_car",
    },
)
