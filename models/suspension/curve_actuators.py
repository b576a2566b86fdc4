"""Curves and adjustable dampers in MuJoCo: actuators on the suspension's tendon, evaluated in every stage of RK4.

An actuator with zero control, a bias that is affine in length and speed, and a `forcerange` that clips it, is one straight piece
of a curve. (Its gain stays 1: with the negative of the bias's slope over length, MuJoCo would read a positive slope over speed as
a damping ratio.) The suspension's own spring and damper stay, with the curve's slope at rest; the pieces add the deviation.

MuJoCo has no product of length and speed. A damper over velocity and deflection is one motor, which `sim.physics.part_steps`
controls in every stage of RK4. Where a motion ratio changes with travel, this motor also pulls for stops and actuators.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from models.common.errors import InputError
from models.suspension import PART
from models.suspension.adjustable_dampers import Adjustable
from models.suspension.curve import Pieces
from models.suspension.fitted_curves import SuspensionCurve

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.


UNBOUNDED = 1e9  # N; above any suspension's force, and below the limit at which MuJoCo reports a mistake
SAME = 1e-9  # relative rounding error of a parameter that a kind's own code has written


def fit_curves(spec: Any, curves: Sequence[SuspensionCurve], prefix: str, rest: Mapping[str, float]) -> None:
    """Adds the deviations of curves from their lines to an `MjSpec`.

    Args:
        spec: the model, its parameters written into it.
        prefix: beginning of the actuators' names.
        rest: the length at rest of every tendon [m].

    Raises:
        InputError: a tendon is missing, or has another stiffness or damping than its parameter.
    """
    tendons = {tendon.name: tendon for tendon in spec.tendons}
    for fit in curves:
        if fit.tendon not in tendons:
            raise InputError(f"the tendon {fit.tendon!r} of a suspension with a curve is missing; add it, or omit the curve")
        tendon, curve = tendons[fit.tendon], fit.curve
        own = float((tendon.damping if fit.damps else tendon.stiffness)[0])
        if not abs(own - curve.slope) <= SAME * max(abs(own), abs(curve.slope)):
            raise InputError(
                f"the tendon {fit.tendon!r} has the value {own:g}, but {fit.parameter} is {curve.slope:g}, so a curve cannot "
                "replace it; let write_mjcf write the parameter, or omit the curve"
            )
        if fit.surface is not None:
            motor = spec.add_actuator(name=f"{prefix}{PART}{fit.tendon}", target=fit.tendon)
            motor.trntype = mujoco.mjtTrn.mjTRN_TENDON
            motor.gainprm[0] = -1.0  # its control is the pull
            continue
        length = 0.0 if fit.damps else rest[fit.tendon]
        add_pieces(spec, f"{prefix}{fit.over.name}_{fit.tendon}", fit.tendon, curve.pieces, length, fit.damps)


def add_pieces(spec: Any, name: str, tendon: str, pieces: Pieces, length: float, damps: bool = False) -> None:
    """Adds pieces of a force that pulls a tendon's ends together to an `MjSpec`.

    Args:
        name: beginning of the actuators' names.
        length: length of the tendon from which the pieces are measured [m]; 0 if they are over its speed.
        damps: True if they are over its speed.
    """
    for i in range(len(pieces.slope)):
        actuator = spec.add_actuator(name=f"{name}_{i + 1}", target=tendon)
        actuator.trntype = mujoco.mjtTrn.mjTRN_TENDON
        actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        slope, start = float(pieces.slope[i]), float(pieces.start[i])
        # A curve pulls together where it is positive, and an actuator's force stretches its tendon.
        along = [0.0, -slope] if damps else [-slope, 0.0]
        actuator.biasprm[:3] = [slope * (start + length), *along]
        actuator.forcelimited = True
        actuator.forcerange = np.clip([-pieces.high[i], -pieces.low[i]], -UNBOUNDED, UNBOUNDED)


def sense_velocities(spec: Any, deflections: Sequence[tuple[str, str]]) -> None:
    """Adds velocity sensors for lengths that have sensors.

    Args:
        deflections: pairs of signals, velocity and length.

    Raises:
        InputError: a length is read by another sensor than one of a tendon or a joint.
    """
    kind, sensors = mujoco.mjtSensor, {sensor.name: sensor for sensor in spec.sensors}
    speeds = {kind.mjSENS_TENDONPOS: kind.mjSENS_TENDONVEL, kind.mjSENS_JOINTPOS: kind.mjSENS_JOINTVEL}
    for velocity, deflection in deflections:
        length = sensors.get(deflection)
        if length is None or length.type not in speeds:
            raise InputError(f"{velocity!r} needs a sensor {deflection!r} of the length of a tendon or joint; add this sensor")
        sensor = spec.add_sensor(name=velocity, type=speeds[length.type], objtype=length.objtype, objname=length.objname)
        sensor.userdata = list(length.userdata)


def write_dampers(spec: mujoco.MjSpec, dampers: Sequence[Adjustable], tendons: Mapping[str, str], mjcf: str, prefix: str) -> None:
    """Replaces actuators that push by adjustable dampers: the control is c - c_s, the force -(c - c_s) v.

    With curves, h(v) is a line and ramps that begin at its knots, one actuator each, with the same control. A ramp gives
    (c - c_min) a (v - k), which has one sign beyond its knot k, and is clipped to zero on the other side.

    Args:
        tendons: tendons of its suspensions, by force.
        prefix: prefix of the names of ramps.

    Raises:
        InputError: the actuator of a damper is not a motor of gear 1 on the tendon of its suspension.
    """
    actuators = {actuator.name: actuator for actuator in spec.actuators}
    for placed in dampers:
        actuator, tendon = actuators.get(placed.force), tendons[placed.force]
        if actuator is None or (actuator.target, float(actuator.gear[0])) != (tendon, 1.0):
            raise InputError(
                f"MJCF {mjcf}: for the damper of [actuators], the actuator {placed.force!r} must be a motor with gear 1 on "
                f"the tendon {tendon!r}; change this actuator, or omit [actuators]"
            )
        actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_AFFINE, mujoco.mjtBias.mjBIAS_NONE
        line, ramps = (1.0, ()) if placed.damper.pair is None else (placed.damper.pair.line, placed.damper.pair.ramps)
        if placed.over_travel:  # the motor of its parts pulls for it
            line, ramps = 0.0, ()
        actuator.gainprm[:3] = [0.0, 0.0, -line]
        parts = [actuator]
        for number, (knot, slope, side) in enumerate(ramps, 1):
            ramp = spec.add_actuator(name=f"{prefix}{placed.force}_{number}", target=tendon)
            ramp.trntype, ramp.gear[0] = mujoco.mjtTrn.mjTRN_TENDON, placed.ratio
            ramp.gaintype, ramp.biastype = mujoco.mjtGain.mjGAIN_AFFINE, mujoco.mjtBias.mjBIAS_AFFINE
            ramp.gainprm[:3] = [slope * knot, 0.0, -slope]
            ramp.biasprm[:3] = [-placed.low * slope * knot, 0.0, placed.low * slope]
            ramp.forcelimited = True
            ramp.forcerange = [-UNBOUNDED, 0.0] if slope * side > 0 else [0.0, UNBOUNDED]
            parts.append(ramp)
        if placed.damper.bandwidth is not None:
            for part in parts:
                part.dyntype = mujoco.mjtDyn.mjDYN_FILTER  # integrated with the rest by RK4
                part.dynprm[0] = 1 / placed.damper.bandwidth
