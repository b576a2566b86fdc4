"""Suspensions and tyres in the MJCF.

A suspension is a spring that is preloaded with the static load. If a suspension has no spring, a constant force carries the
static load.

A strut without a spring is purely active (Thompson 1976, Hrovat 1997). The actuator of a strut without a spring applies the
static load, in addition to the force u of the equations. The limits and the lag in `[limits]` apply only to the force u.

A tyre is a spring that can push but not pull. The damping of a tyre acts only while the tyre touches the road. A tyre with
damping pushes its hub upward with

    F = max(0, k (l_0 - l) + c (z_r' - l')),

where l is the tyre length and z_r' the road velocity. In MuJoCo, the road height and the road velocity z_r' are both held
constant during a time step. A mocap body has no velocity, so l' is the velocity of the hub. The tyre leaves the road when its
total force is 0. When the total force reaches 0, the equivalent deflection t + (c / k) t' of the tyre reaches the static
deflection. Without damping, the equivalent deflection is the tyre deflection t. While a wheel is in the air, its tyre exerts no
force. The rubber of the tyre is assumed to return immediately to its free shape, without a force on the hub.
"""

from typing import Any

from models.kinds.signals import TYRE_DEFLECTION

# Beginning of the name of the actuator that applies a constant force; the name of its tendon follows
STATIC_LOAD = "fitted_static_load_"
TENDON, AFFINE = 3, 1  # values of MuJoCo's constants mjTRN_TENDON and mjBIAS_AFFINE, because vehicle types do not import MuJoCo
TYRE_DAMPING = "damping of a tyre between hub and road; a tyre without contact has no damping"
# Beginning of the name of the actuator that represents a tyre with damping; the name of its tendon follows
DAMPER = "fitted_damped_"
MOST_FORCE = 1e9  # this force [N] is larger than any tyre force, but smaller than the limit at which MuJoCo reports an error


def write_strut(spec: Any, tendon: Any, stiffness: float, damping: float, load: float, length: float = 0.0) -> None:
    """Writes a suspension into an MjSpec.

    Args:
        spec: MuJoCo model of the vehicle.
        tendon: tendon of the suspension.
        stiffness: spring stiffness [N/m].
        damping: damping coefficient [N s/m].
        load: static load [N].
        length: length of the tendon in equilibrium [m].
    """
    tendon.stiffness[0], tendon.damping[0] = stiffness, damping
    if stiffness:
        tendon.springlength = [length + load / stiffness] * 2
        return
    tendon.springlength = [length] * 2
    actuator = spec.add_actuator(name=f"{STATIC_LOAD}{tendon.name}", target=tendon.name)
    actuator.trntype, actuator.biastype, actuator.biasprm[0] = TENDON, AFFINE, load


def actuator_of(tyre_deflection: str) -> str:
    """Returns the name of the actuator of a tyre with damping, from the name of the tyre deflection signal."""
    return f"{DAMPER}tyre{tyre_deflection.removeprefix(TYRE_DEFLECTION.name)}"


def write_tyre(spec: Any, tendon: str, stiffness: float, damping: float, rest: float) -> None:
    """Writes a tyre into an MjSpec.

    Without damping, the spring of the tendon represents the tyre. With damping, the tendon only draws the tyre; an actuator on
    the tendon applies the tyre force, which MuJoCo evaluates in every stage of a step. The control input of the tyre's
    actuator is the road velocity.

    Args:
        spec: MuJoCo model of the vehicle.
        tendon: name of the tyre's tendon.
        stiffness: k [N/m].
        damping: c [N s/m].
        rest: length of the tendon above which the tyre is slack [m].
    """
    tyre = spec.tendon(tendon)
    tyre.springlength[0] = rest
    if not damping:
        tyre.stiffness[0] = stiffness
        return
    tyre.stiffness[0] = 0.0
    actuator = spec.add_actuator(name=f"{DAMPER}{tendon}", target=tendon, forcelimited=True, forcerange=[0.0, MOST_FORCE])
    actuator.trntype, actuator.biastype = TENDON, AFFINE
    actuator.gainprm[0] = damping
    actuator.biasprm[:3] = [stiffness * rest, -stiffness, -damping]
