"""Quarter-car of the paper, section 3.1: a sprung and an unsprung mass, a spring, a damper, an actuator and a tyre.

The equations are (28)-(32). All displacements are relative to static equilibrium, so gravity does not appear in the equations.
The MJCF includes gravity: preloads support the masses, and the tyre can leave the road.
"""

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from models.kinds import signals
from models.kinds.kind import (
    GRAVITY,
    SEAT_POINTS,
    BodyLoad,
    Invariant,
    Parameter,
    Parameters,
    VehicleKind,
    Wheel,
    motion_ratio,
)
from models.kinds.linear_model import LinearModel
from models.kinds.strut_and_tyre import TYRE_DAMPING, write_strut, write_tyre

if TYPE_CHECKING:
    from models.kinds.motion import Motion

PARAMETERS = (
    Parameter("sprung_mass", "kg", "m_s, mass of the body that one wheel carries"),
    Parameter("unsprung_mass", "kg", "m_u, mass of wheel, hub and brake"),
    Parameter("suspension_stiffness", "N/m", "k_s, spring stiffness; 0 for a purely active strut", positive=False),
    Parameter("suspension_damping", "N s/m", "c_s, damping coefficient", positive=False),
    Parameter("tyre_stiffness", "N/m", "k_t, called k_u in the paper"),
    Parameter("tyre_damping", "N s/m", f"c_t, {TYRE_DAMPING}", positive=False, optional=True),
    motion_ratio("motion_ratio"),
)

STATES = (
    signals.SUSPENSION_DEFLECTION,
    signals.TYRE_DEFLECTION,
    signals.SPRUNG_VELOCITY,
    signals.UNSPRUNG_VELOCITY,
)
OUTPUTS = (*STATES, signals.SPRUNG_ACCELERATION, signals.CONTROL_FORCE)
HEIGHTS = (signals.SPRUNG_DISPLACEMENT, signals.UNSPRUNG_DISPLACEMENT)
ON_DEMAND = (signals.UNSPRUNG_ACCELERATION, *HEIGHTS)


def linear_model(p: Parameters) -> LinearModel:
    """Returns the linear model, equations (29)-(32) of the paper.

    Args:
        p: parameters by name [SI].

    Returns:
        The model with 4 states (30), 1 input [N], 1 disturbance (the road velocity) [m/s] and 9 output signals.
    """
    m_s, m_u = p["sprung_mass"], p["unsprung_mass"]
    k_s, c_s = p["suspension_stiffness"], p["suspension_damping"]
    k_u, c_u = p["tyre_stiffness"], p.get("tyre_damping", 0.0)

    A = np.array(
        [
            [0, 0, 1, -1],
            [0, 0, 0, 1],
            [-k_s / m_s, 0, -c_s / m_s, c_s / m_s],
            [k_s / m_u, -k_u / m_u, c_s / m_u, -c_s / m_u],
        ]
    )  # the matrix A of equation (31)
    B = np.array([[0], [0], [1 / m_s], [-1 / m_u]])  # the matrix B of equation (32)
    Bw = np.array([[0.0], [-1.0], [0.0], [0.0]])  # the matrix Bw of equation (32)
    Bt = np.array([[0.0], [0.0], [0.0], [c_u / m_u]])
    if c_u:
        A[3, 3] -= c_u / m_u
        Bw = Bw + Bt

    # The rows of C are the four states, z_s'' from the first equation of (28), the input u, and z_u'' from the second equation
    # of (28). The last two rows are heights, which are sums of deflections and the road height.
    C = np.vstack([np.eye(4), A[2], np.zeros(4), A[3], [1, 1, 0, 0], [0, 1, 0, 0]])
    D = np.vstack([np.zeros((4, 1)), B[2], [[1]], B[3], np.zeros((2, 1))])

    # A vertical force on the body acts in the first equation of (28) in the same way as u, but does not act on the wheel.
    Bl = np.array([[0], [0], [1 / m_s], [0]])
    Dl = np.vstack([np.zeros((4, 1)), Bl[2], [[0]], Bl[3], np.zeros((2, 1))])

    return LinearModel(
        A=A,
        B=B,
        Bw=Bw,
        C=C,
        D=D,
        states=tuple(signal.name for signal in STATES),
        inputs=(signals.CONTROL_FORCE.name,),
        disturbances=(signals.ROAD_VELOCITY.name,),
        outputs=tuple(signal.name for signal in (*OUTPUTS, *ON_DEMAND)),
        Br=np.zeros((4, 1)),
        Cr=np.vstack([np.zeros((7, 1)), np.ones((2, 1))]),
        loads=(signals.HEAVE_LOAD.name,),
        Bl=Bl,
        Dl=Dl,
        Bt=Bt,
        Dw=np.vstack([np.zeros((6, 1)), Bt[3], np.zeros((2, 1))]),
        heights=tuple(signal.name for signal in HEIGHTS),
    )


def static_tyre_deflection(p: Parameters) -> dict[str, float]:
    """Returns the static compression of the tyre [m]: the weight of all masses divided by k_u."""
    weight = (p["sprung_mass"] + p.get("seat_mass", 0.0) + p["unsprung_mass"]) * GRAVITY
    return {signals.TYRE_DEFLECTION.name: weight / p["tyre_stiffness"]}


def static_loads(p: Parameters) -> dict[str, float]:
    """Returns the static load that the suspension spring carries [N]."""
    return {signals.SUSPENSION_DEFLECTION.name: (p["sprung_mass"] + p.get("seat_mass", 0.0)) * GRAVITY}


def write_mjcf(spec: Any, p: Parameters) -> None:
    """Writes the parameters into the MjSpec of `quarter_car.xml`.

    Two preloads make qpos = 0 the static equilibrium: the suspension spring carries m_s g, the tyre carries (m_s + m_u) g. The
    tyre's rest length is the length in the drawing plus the static compression of the tyre. Above the rest length, the tyre is
    slack (dead band), so the wheel can lift off.
    """
    spec.body("sprung").mass = p["sprung_mass"]
    spec.body("unsprung").mass = p["unsprung_mass"]

    suspension, weight = spec.tendon("suspension"), static_loads(p)[signals.SUSPENSION_DEFLECTION.name]
    write_strut(spec, suspension, p["suspension_stiffness"], p["suspension_damping"], weight)

    radius = spec.body("unsprung").pos[2] - spec.body("road").pos[2]
    rest = radius + static_tyre_deflection(p)[signals.TYRE_DEFLECTION.name]
    write_tyre(spec, "tyre", p["tyre_stiffness"], p.get("tyre_damping", 0.0), rest)


def motion(p: Parameters) -> "Motion":
    """Returns the equations of motion of a body that only heaves on one strut; the tyre can push but not pull."""
    from models.kinds.rigid_body import Corner, RigidBody
    from models.kinds.rigid_motion import rigid_motion

    corner = Corner(
        name="",
        x=0.0,
        y=0.0,
        unsprung_mass=p["unsprung_mass"],
        suspension_stiffness=p["suspension_stiffness"],
        suspension_damping=p["suspension_damping"],
        tyre_stiffness=p["tyre_stiffness"],
        tyre_damping=p.get("tyre_damping", 0.0),
    )
    seat = p.get("seat_mass", 0.0)
    body = RigidBody((corner,), p["sprung_mass"], None, None, tyre_modes=np.eye(1), twist=np.zeros(1), seat_mass=seat)
    return rigid_motion(body, STATES, (signals.SPRUNG_ACCELERATION, *ON_DEMAND))


def hub_frequency(p: Parameters) -> float:
    """Returns the natural frequency of the unsprung mass on the tyre if there were no suspension [rad/s]."""
    return math.sqrt(p["tyre_stiffness"] / p["unsprung_mass"])


def mass_ratio(p: Parameters) -> float:
    """Returns the unsprung mass divided by the sprung mass."""
    return p["unsprung_mass"] / p["sprung_mass"]


def rigid_frequency(p: Parameters) -> float:
    """Returns the natural frequency on the tyre if both masses were rigidly connected [rad/s]."""
    return math.sqrt(p["tyre_stiffness"] / (p["sprung_mass"] + p["unsprung_mass"]))


def whole_ratio(p: Parameters) -> float:
    """Returns the total mass divided by the sprung mass."""
    return (p["sprung_mass"] + p["unsprung_mass"]) / p["sprung_mass"]


# The invariants follow from m_s z_s'' + m_u z_u'' = -k_u (z_u - z_r), which does not contain the suspension force.
INVARIANTS = (
    Invariant(
        name="z_s/z_r",
        signals=(signals.SUSPENSION_DEFLECTION.name, signals.TYRE_DEFLECTION.name, signals.ROAD_DISPLACEMENT.name),
        omega=hub_frequency,
        magnitude=mass_ratio,
    ),
    Invariant(
        name="(z_s-z_u)/z_r",
        signals=(signals.SUSPENSION_DEFLECTION.name,),
        omega=rigid_frequency,
        magnitude=whole_ratio,
    ),
)

KIND = VehicleKind(
    name="quarter_car",
    parameters=PARAMETERS,
    signals=(signals.ROAD_DISPLACEMENT, signals.ROAD_VELOCITY, *OUTPUTS),
    wheels=(
        Wheel(
            road_body="road",
            road_displacement=signals.ROAD_DISPLACEMENT.name,
            road_velocity=signals.ROAD_VELOCITY.name,
            tyre_deflection=signals.TYRE_DEFLECTION.name,
        ),
    ),
    linear_model=linear_model,
    static_tyre_deflection=static_tyre_deflection,
    write_mjcf=write_mjcf,
    static_loads=static_loads,
    invariants=INVARIANTS,
    on_demand=ON_DEMAND,
    loads=(BodyLoad(signals.HEAVE_LOAD.name, "sprung"),),
    motion=motion,
    lacking=SEAT_POINTS
    | {"anti_roll": "an anti-roll bar needs a body that rolls, but a quarter-car only moves vertically: use a full_car"},
)
