"""Adjustable dampers in MuJoCo: its own actuators, whose force is proportional to speed, so that RK4's stages know them."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

from collections.abc import Mapping, Sequence

import mujoco

from models.common.errors import InputError
from models.curves.actuators import UNBOUNDED
from models.damping.adjustable import Adjustable


def write_dampers(spec: mujoco.MjSpec, dampers: Sequence[Adjustable], tendons: Mapping[str, str], mjcf: str, prefix: str) -> None:
    """Adjustable dampers in place of actuators that push: what is asked of one is c - c_s, and it gives -(c - c_s) v.

    With curves, a h(v) that is not v is a line and ramps that begin at its knots, an actuator each, asked for the same. A ramp
    gives (c - c_min) a (v - k), which has one sign beyond its knot k, and is clipped to none on the other side.

    Args:
        spec: takes them.
        dampers: of a vehicle.
        tendons: of its suspensions, by force.
        mjcf: where the spec is from, for messages.
        prefix: how the names of ramps begin.

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
        line, ramps = (1.0, ()) if one.damper.pair is None else (one.damper.pair.line, one.damper.pair.ramps)
        actuator.gainprm[:3] = [0.0, 0.0, -line]
        parts = [actuator]
        for number, (knot, slope, side) in enumerate(ramps, 1):
            ramp = spec.add_actuator(name=f"{prefix}{one.force}_{number}", target=tendon)
            ramp.trntype = mujoco.mjtTrn.mjTRN_TENDON
            ramp.gaintype, ramp.biastype = mujoco.mjtGain.mjGAIN_AFFINE, mujoco.mjtBias.mjBIAS_AFFINE
            ramp.gainprm[:3] = [slope * knot, 0.0, -slope]
            ramp.biasprm[:3] = [-one.low * slope * knot, 0.0, one.low * slope]
            ramp.forcelimited = True
            ramp.forcerange = [-UNBOUNDED, 0.0] if slope * side > 0 else [0.0, UNBOUNDED]
            parts.append(ramp)
        if one.damper.bandwidth is not None:
            for part in parts:
                part.dyntype = mujoco.mjtDyn.mjDYN_FILTER  # integrated with the rest by RK4
                part.dynprm[0] = 1 / one.damper.bandwidth
