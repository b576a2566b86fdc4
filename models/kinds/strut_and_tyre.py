"""Suspensions and tyres in the MJCF.

A suspension is a spring preloaded with the weight at rest; without a spring, a constant force that carries it.

A strut without a spring is purely active (Thompson 1976, Hrovat 1997). Its actuator then carries the weight at rest beside the
force u of the equations, which is measured from there. `[limits]` and the actuator's lag are of u alone.

A tyre is a spring that pushes and never pulls, and its damping, which acts only while the tyre is on the road.

A tyre with damping pushes its hub up with

    F = max(0, k (l_0 - l) + c (z_r' - l')),

its length l on a road that MuJoCo holds over a step, and the road's velocity z_r', likewise held. A mocap body has no velocity of
its own, so l' is the hub's. The tyre leaves the road where its whole force ends. That is where its equivalent deflection
t + (c / k) t', which of a tyre without damping is its deflection, exceeds the static one. In the air it neither pulls nor damps:
its rubber is taken to return at once, without a force on the hub.
"""

from typing import Any

from models.kinds.signals import TYRE_DEFLECTION

STATIC_LOAD = "fitted_static_load_"  # prefix of the actuator with the constant force, before its tendon
TENDON, AFFINE = 3, 1  # mjTRN_TENDON, mjBIAS_AFFINE; no kind imports MuJoCo
TYRE_DAMPING = "damping of a tyre between hub and road; a tyre without contact has no damping"
DAMPER = "fitted_damped_"  # prefix of the actuator of a tyre with damping, after its tendon
MOST_FORCE = 1e9  # N; above any tyre's force, and below the limit at which MuJoCo reports a mistake


def write_strut(spec: Any, tendon: Any, stiffness: float, damping: float, load: float, length: float = 0.0) -> None:
    """Writes a suspension into an MjSpec.

    Args:
        stiffness, damping: stiffness [N/m] and damping [N s/m].
        load: load of the weight at equilibrium [N].
        length: length of the tendon at equilibrium [m].
    """
    tendon.stiffness[0], tendon.damping[0] = stiffness, damping
    if stiffness:
        tendon.springlength = [length + load / stiffness] * 2
        return
    tendon.springlength = [length] * 2
    actuator = spec.add_actuator(name=f"{STATIC_LOAD}{tendon.name}", target=tendon.name)
    actuator.trntype, actuator.biastype, actuator.biasprm[0] = TENDON, AFFINE, load


def actuator_of(tyre_deflection: str) -> str:
    """Returns the name of the actuator of a tyre with damping, from that of its signal."""
    return f"{DAMPER}tyre{tyre_deflection.removeprefix(TYRE_DEFLECTION.name)}"


def write_tyre(spec: Any, tendon: str, stiffness: float, damping: float, rest: float) -> None:
    """Writes a tyre into an MjSpec.

    Without damping its tendon is its spring. Else the tendon is only drawn, and an actuator on it has the whole force, which
    MuJoCo evaluates in every stage of a step. The actuator's control is the road's velocity.

    Args:
        stiffness, damping: k [N/m] and c [N s/m].
        rest: length above which it is slack [m].
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
