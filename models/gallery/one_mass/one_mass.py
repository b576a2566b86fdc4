"""Mass that is connected to the road by a spring and a force actuator.

Because the mass has only one degree of freedom, the formulas of optimal control laws have a closed form.
"""

import numpy as np

from models import GRAVITY, LinearModel, Parameter, Suspension, VehicleKind, Wheel, signals

FREE = 0.6  # height of the mass above the road in equilibrium [m]
STATES = (signals.SUSPENSION_DEFLECTION.name, signals.SPRUNG_VELOCITY.name)
OUTPUTS = (signals.SUSPENSION_DEFLECTION, signals.SPRUNG_VELOCITY, signals.SPRUNG_ACCELERATION, signals.CONTROL_FORCE)


def linear_model(p):
    """Returns the linear model with the deflection d, the velocity v, the road velocity w and the force u: d' = v - w, m v' =
    -k d + u.
    """
    A = np.array([[0, 1], [-p["stiffness"] / p["mass"], 0]])
    B = np.array([[0], [1 / p["mass"]]])
    C, D = np.vstack([np.eye(2), A[1], [0, 0]]), np.vstack([[0], [0], B[1], [1]])
    names = ((signals.CONTROL_FORCE.name,), (signals.ROAD_VELOCITY.name,), tuple(one.name for one in OUTPUTS))
    return LinearModel(A, B, np.array([[-1], [0]]), C, D, STATES, *names, Br=np.zeros((2, 1)), Cr=np.zeros((4, 1)))


def static_tyre_deflection(p):
    """Returns the static compression of the spring [m]."""
    return {STATES[0]: p["mass"] * GRAVITY / p["stiffness"]}


def write_mjcf(spec, p):
    """Writes the parameters of the vehicle into the MJCF."""
    spec.body("sprung").mass = p["mass"]
    spec.tendon("suspension").stiffness[0] = p["stiffness"]
    spec.tendon("suspension").springlength[0] = FREE + static_tyre_deflection(p)[STATES[0]]


KIND = VehicleKind(
    name="one_mass",
    parameters=(Parameter("mass", "kg", "mass of the whole vehicle"), Parameter("stiffness", "N/m", "stiffness of the spring")),
    signals=(signals.ROAD_DISPLACEMENT, signals.ROAD_VELOCITY, *OUTPUTS),
    wheels=(Wheel("road", signals.ROAD_DISPLACEMENT.name, signals.ROAD_VELOCITY.name, STATES[0]),),
    suspended=(Suspension(STATES[0], "suspension", signals.CONTROL_FORCE.name, stiffness="stiffness"),),
    linear_model=linear_model,
    static_tyre_deflection=static_tyre_deflection,
    write_mjcf=write_mjcf,
)
