"""Adjustable dampers in MuJoCo: its own actuators, whose force is proportional to speed, so that RK4's stages know them."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

from collections.abc import Mapping, Sequence

import mujoco

from models.common.errors import InputError
from models.damping.adjustable import Adjustable


def write_dampers(spec: mujoco.MjSpec, dampers: Sequence[Adjustable], tendons: Mapping[str, str], mjcf: str) -> None:
    """Adjustable dampers in place of actuators that push: what is asked of one is c - c_s, and it gives -(c - c_s) v.

    Args:
        spec: takes them.
        dampers: of a vehicle.
        tendons: of its suspensions, by force.
        mjcf: where the spec is from, for messages.

    Raises:
        InputError: the actuator of one is no motor of gear 1 on the tendon of its suspension.
    """
    actuators = {actuator.name: actuator for actuator in spec.actuators}
    for one in dampers:
        actuator, tendon = actuators.get(one.force), tendons[one.force]
        if actuator is None or (actuator.target, float(actuator.gear[0])) != (tendon, 1.0):
            raise InputError(
                f"MJCF {mjcf}: the actuator {one.force!r} is no motor of gear 1 on the tendon {tendon!r}, and cannot be the "
                "damper of [actuators]; make it one, or leave that section out"
            )
        actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_AFFINE, mujoco.mjtBias.mjBIAS_NONE
        actuator.gainprm[:3] = [0.0, 0.0, -1.0]
        if one.damper.bandwidth is not None:
            actuator.dyntype = mujoco.mjtDyn.mjDYN_FILTER  # integrated with the rest by RK4
            actuator.dynprm[0] = 1 / one.damper.bandwidth
