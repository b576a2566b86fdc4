"""Suspensions in the MJCF: a spring preloaded with the weight at rest; without a spring, a constant force that carries it.

A strut without a spring is purely active (Thompson 1976, Hrovat 1997). Its actuator then carries the weight at rest beside the
force u of the equations, which is measured from there. `[limits]` and the actuator's lag are of u alone.
"""

from typing import Any

STATIC_LOAD = "fitted_static_load_"  # prefix of the actuator with the constant force, before its tendon
TENDON, AFFINE = 3, 1  # mjTRN_TENDON, mjBIAS_AFFINE; no kind imports MuJoCo


def write_strut(spec: Any, tendon: Any, stiffness: float, damping: float, load: float, length: float = 0.0) -> None:
    """Writes a suspension into an MjSpec.

    Args:
        tendon: of the suspension.
        stiffness, damping: [N/m] and [N s/m].
        load: of the weight at rest [N].
        length: of the tendon at rest [m].
    """
    tendon.stiffness[0], tendon.damping[0] = stiffness, damping
    if stiffness:
        tendon.springlength = [length + load / stiffness] * 2
        return
    tendon.springlength = [length] * 2
    actuator = spec.add_actuator(name=f"{STATIC_LOAD}{tendon.name}", target=tendon.name)
    actuator.trntype, actuator.biastype, actuator.biasprm[0] = TENDON, AFFINE, load
