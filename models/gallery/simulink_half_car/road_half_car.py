"""Half-car without wheels, whose suspensions touch the road directly: the second example of a custom vehicle type.

The equations are those of Simulink's demonstration of a half-car. The springs act between road and body. The forces of the
dampers depend only on the motion of the body.
"""

import numpy as np

from models import GRAVITY, BodyLoad, LinearModel, Parameter, Suspension, VehicleKind, Wheel, signals

AXLES = ("front", "rear")
GAPS = tuple(signals.SUSPENSION_DEFLECTION.at(axle) for axle in AXLES)
FORCES = tuple(signals.CONTROL_FORCE.at(axle) for axle in AXLES)
ROADS = tuple(signals.ROAD_DISPLACEMENT.at(axle) for axle in AXLES)
VELOCITIES = tuple(signals.ROAD_VELOCITY.at(axle) for axle in AXLES)
HEAVE = signals.Signal("heave_displacement", "z", "m", "height of the body's centre of mass over a level road, up")
STATES = (*GAPS, signals.HEAVE_VELOCITY, signals.PITCH_RATE)
OUTPUTS = (*STATES, signals.HEAVE_ACCELERATION, signals.PITCH_ACCELERATION, HEAVE, *FORCES)
FREE = 0.8  # height of the body above the road in equilibrium [m]


def arms(p):
    """Returns the forward positions of the axles relative to the centre of mass [m]."""
    return np.array([p["axle_distance_front"], -p["axle_distance_rear"]])


def wheelbase(p):
    """Returns the distance between the axles [m]."""
    return p["axle_distance_front"] + p["axle_distance_rear"]


def linear_model(p):
    """Returns the linear model with 4 states, 2 forces [N], 2 road velocities [m/s] and 9 output signals."""
    springs, dampers = (np.diag([2 * p[f"{part}_{axle}"] for axle in AXLES]) for part in ("stiffness", "damping"))
    # Matrix that converts heave and pitch (nose down) to the heights of the front and rear ends of the body
    ends = np.column_stack([[1, 1], -arms(p)])
    inverse = np.diag([1 / p["mass"], 1 / p["pitch_inertia"]])
    A = np.block([[np.zeros((2, 2)), ends], [-inverse @ ends.T @ springs, -inverse @ ends.T @ dampers @ ends]])
    B = np.vstack([np.zeros((2, 2)), inverse @ ends.T])
    Bw = np.vstack([-np.eye(2), np.zeros((2, 2))])
    share = np.linalg.inv(ends)[0]  # weights with which the two end heights add up to the height of the centre of mass
    height = np.concatenate([share, [0, 0]])
    C = np.vstack([np.eye(4), A[2:], height, np.zeros((2, 4))])
    D = np.vstack([np.zeros((4, 2)), B[2:], np.zeros((1, 2)), np.eye(2)])
    Cr = np.vstack([np.zeros((6, 2)), share, np.zeros((2, 2))])
    names = [tuple(one.name for one in some) for some in (STATES, FORCES, VELOCITIES, OUTPUTS)]
    loads = (signals.HEAVE_LOAD.name, signals.PITCH_LOAD.name)
    Bl = np.vstack([np.zeros((2, 2)), inverse])
    Dl = np.vstack([np.zeros((4, 2)), inverse, np.zeros((3, 2))])
    return LinearModel(A, B, Bw, C, D, *names, Br=np.zeros((4, 2)), Cr=Cr, loads=loads, Bl=Bl, Dl=Dl)


def static_tyre_deflection(p):
    """Returns the static compression of each axle's springs [m]."""
    front, rear = p["axle_distance_front"], p["axle_distance_rear"]
    weight = p["mass"] * GRAVITY / (front + rear)
    carried = {"front": weight * rear, "rear": weight * front}
    return {gap.name: carried[axle] / (2 * p[f"stiffness_{axle}"]) for gap, axle in zip(GAPS, AXLES, strict=True)}


def write_mjcf(spec, p):
    """Writes the parameters of the vehicle into the MJCF."""
    body = spec.body("sprung")
    body.mass, body.inertia = p["mass"], [p["pitch_inertia"]] * 3
    for axle, arm, rest in zip(AXLES, arms(p), static_tyre_deflection(p).values(), strict=True):
        spec.body(f"road_{axle}").pos[0] = spec.site(f"top_{axle}").pos[0] = arm
        spring = spec.tendon(f"suspension_{axle}")
        spring.stiffness[0], spring.damping[0] = 2 * p[f"stiffness_{axle}"], 2 * p[f"damping_{axle}"]
        spring.springlength[0] = FREE + rest


def per_axle(name, unit, meaning, positive=True):
    """Returns the declarations of a parameter that each axle has."""
    return tuple(Parameter(f"{name}_{axle}", unit, f"{meaning}, {axle}", positive=positive) for axle in AXLES)


KIND = VehicleKind(
    name="road_half_car",
    parameters=(
        Parameter("mass", "kg", "mass of the body"),
        Parameter("pitch_inertia", "kg m2", "pitch inertia of the body about its centre of mass"),
        *per_axle("axle_distance", "m", "distance from the centre of mass to the axle"),
        *per_axle("stiffness", "N/m", "stiffness of each of the axle's two springs"),
        *per_axle("damping", "N s/m", "damping of each of the axle's two dampers", positive=False),
    ),
    signals=(*ROADS, *VELOCITIES, *OUTPUTS),
    wheels=tuple(
        Wheel(f"road_{axle}", road.name, velocity.name, gap.name, behind=lambda p, rear=axle == "rear": rear * wheelbase(p))
        for axle, road, velocity, gap in zip(AXLES, ROADS, VELOCITIES, GAPS, strict=True)
    ),
    suspended=tuple(
        Suspension(gap.name, f"suspension_{axle}", force.name) for axle, gap, force in zip(AXLES, GAPS, FORCES, strict=True)
    ),
    loads=(BodyLoad(signals.HEAVE_LOAD.name, "heave"), BodyLoad(signals.PITCH_LOAD.name, "pitch")),
    linear_model=linear_model,
    static_tyre_deflection=static_tyre_deflection,
    write_mjcf=write_mjcf,
)
