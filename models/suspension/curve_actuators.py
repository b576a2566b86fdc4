"""Curves and adjustable dampers in MuJoCo: its own actuators, on the suspension's tendon, within every stage of RK4.

An actuator that is asked for nothing, whose bias is affine in length and speed and which its `forcerange` clips, is one straight
piece of a curve. (Its gain stays 1: where that is minus the bias's slope over length, MuJoCo takes a slope over speed that is
above 0 for a damping ratio.) The suspension's own spring and damper stay, with the curve's slope at rest, and the pieces are what
it has beyond.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from models.common.errors import InputError
from models.suspension.adjustable_dampers import Adjustable
from models.suspension.fitted_curves import Fitted

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.


UNBOUNDED = 1e9  # N; more than any suspension's, and less than MuJoCo takes for a mistake
SAME = 1e-9  # relative; what a kind's own code makes of a parameter


def fit_curves(spec: Any, curves: Sequence[Fitted], prefix: str, rest: Mapping[str, float]) -> None:
    """Adds what curves have beyond their lines to an `MjSpec`.

    Args:
        spec: the model, its parameters written into it.
        curves: of its suspensions.
        prefix: how the names of the actuators begin.
        rest: the length at rest of every tendon [m].

    Raises:
        InputError: it has not the tendons, or not with their parameters.
    """
    tendons = {tendon.name: tendon for tendon in spec.tendons}
    for one in curves:
        if one.tendon not in tendons:
            raise InputError(f"has no tendon {one.tendon!r}, whose suspension has a curve in [curves]; add it, or leave that out")
        tendon, curve = tendons[one.tendon], one.curve
        own = float((tendon.damping if one.damps else tendon.stiffness)[0])
        if not abs(own - curve.slope) <= SAME * max(abs(own), abs(curve.slope)):
            raise InputError(
                f"its tendon {one.tendon!r} has {own:g} where {one.parameter} is {curve.slope:g}, so no curve can stand in for "
                "it; have write_mjcf write the parameter, or leave the curve out"
            )
        length = 0.0 if one.damps else rest[one.tendon]
        pieces = curve.pieces
        for i in range(len(pieces.slope)):
            actuator = spec.add_actuator(name=f"{prefix}{one.over.name}_{one.tendon}_{i + 1}", target=one.tendon)
            actuator.trntype = mujoco.mjtTrn.mjTRN_TENDON
            actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            slope, start = float(pieces.slope[i]), float(pieces.start[i])
            # A curve pulls together where it is positive, and an actuator's force stretches its tendon.
            along = [0.0, -slope] if one.damps else [-slope, 0.0]
            actuator.biasprm[:3] = [slope * (start + length), *along]
            actuator.forcelimited = True
            actuator.forcerange = np.clip([-pieces.high[i], -pieces.low[i]], -UNBOUNDED, UNBOUNDED)


def sense_velocities(spec: Any, deflections: Sequence[tuple[str, str]]) -> None:
    """Adds sensors of how fast lengths change that have sensors themselves.

    Args:
        spec: the model.
        deflections: the signal of the velocity, and that of the length.

    Raises:
        InputError: a length is read by another sensor than one of a tendon or a joint.
    """
    kind, sensors = mujoco.mjtSensor, {sensor.name: sensor for sensor in spec.sensors}
    speeds = {kind.mjSENS_TENDONPOS: kind.mjSENS_TENDONVEL, kind.mjSENS_JOINTPOS: kind.mjSENS_JOINTVEL}
    for velocity, deflection in deflections:
        of = sensors.get(deflection)
        if of is None or of.type not in speeds:
            raise InputError(f"has no sensor {deflection!r} of a tendon's or joint's length, whose speed {velocity!r} would be")
        sensor = spec.add_sensor(name=velocity, type=speeds[of.type], objtype=of.objtype, objname=of.objname)
        sensor.userdata = list(of.userdata)


# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.


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
